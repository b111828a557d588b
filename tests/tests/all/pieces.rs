//! Hollow units, made of convex pieces, in the committed models: what is under a table, at any size, whoever comes and goes,
//! on any kernels and threads.
#![allow(missing_docs, clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use std::path::Path;

use nalgebra::{Isometry3, Point3, Vector3};
use rigidformer_core::{
    EditError, Limits, ObserveError, Physics, Pieces, Posed, Role, Unit, UnitId,
};
use rigidformer_runtime::engine::Engine;
use rigidformer_runtime::kernels::Kernel;
use rigidformer_runtime::models::LoadedModel;
use rigidformer_runtime::threads::Threads;
use rigidformer_runtime::world::World;

const WOOD: Physics = Physics { mass_kg: 1.0, friction: 0.7, restitution: 0.4 };
const COUNTS: [u16; 3] = [8; 3];
/// A table's points are those of its pieces; each piece takes two more.
const TABLE: usize = 24 + 2 * 3;

fn loaded(name: &str) -> LoadedModel {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join(format!("../weights/models/{name}.rfm"));
    LoadedModel::open(&path).unwrap()
}

fn cuboid(half: [f32; 3], middle: [f32; 3]) -> Vec<Point3<f32>> {
    let at = |k: usize, axis: usize| {
        middle[axis] + if k >> axis & 1 == 0 { -half[axis] } else { half[axis] }
    };
    (0..8).map(|k| Point3::new(at(k, 0), at(k, 1), at(k, 2))).collect()
}

/// A plate on two walls, 30 cm wide and 20 cm high, of which 22 x 16 are free.
fn table(scale: f32) -> Vec<Point3<f32>> {
    let wall = |x: f32| cuboid([0.02, 0.1, 0.08], [x, 0.0, 0.08]);
    let pieces = [cuboid([0.15, 0.1, 0.02], [0.0, 0.0, 0.18]), wall(-0.13), wall(0.13)];
    pieces.concat().iter().map(|point| point * scale).collect()
}

fn cube(scale: f32) -> Vec<Point3<f32>> {
    cuboid([0.04 * scale; 3], [0.0; 3])
}

fn at(x: f32, z: f32) -> Isometry3<f32> {
    Isometry3::translation(x, 0.0, z)
}

/// Exactly the room that three tables and three cubes take.
fn limits() -> Limits {
    Limits { units: 6, points: 3 * TABLE + 3 * 8 }
}

/// A table that falls to the ground, a cube under it, and one that slides over it: all `scale` times as large, with times of
/// the root of that.
fn fill(world: &mut World, scale: f32, in_pieces: bool) -> [UnitId; 3] {
    let (table, cube) = (table(scale), cube(scale));
    let hollow = Unit::new(&table, WOOD);
    let hollow = if in_pieces { hollow.pieces(Pieces::new(&table, &COUNTS)) } else { hollow };
    let posed = |unit, x: f32, z: f32, way: f32| {
        let [previous, current] = [x - way, x].map(|x| at(x * scale, z * scale));
        Posed { unit, previous, current }
    };
    let units = [
        posed(hollow, 0.0, 0.01, 0.0),
        posed(Unit::new(&cube, WOOD), 0.03, 0.06, 0.0),
        posed(Unit::new(&cube, WOOD), -0.05, 0.27, 0.02),
    ];
    let dt_s = scale.sqrt() / 24.0;
    world.edit(|simulator| simulator.observe_poses(dt_s, units)).unwrap();
    let ids: Vec<_> = world.simulator().units().map(|unit| unit.id()).collect();
    ids.try_into().unwrap()
}

fn run(world: &mut World, steps: usize) {
    for _ in 0..steps {
        world.step().unwrap();
    }
}

/// Rotations and centres, these over a length.
fn bits(world: &World, scale: f32) -> Vec<u32> {
    let poses = world.simulator().units().map(|unit| unit.internal_pose());
    let numbers = poses.flat_map(|pose| {
        pose.rotation
            .iter()
            .copied()
            .chain((pose.centre / scale).iter().copied())
            .collect::<Vec<_>>()
    });
    numbers.map(f32::to_bits).collect()
}

#[test]
fn a_cube_lies_under_a_table_and_one_on_it() {
    for name in ["edge-i8", "nano"] {
        let model = loaded(name);
        let mut world = World::new(&model, limits()).unwrap();
        let [legs, under, above] = fill(&mut world, 1.0, true);
        run(&mut world, 48);
        let place = |id| world.pose(id).unwrap().translation.vector;
        assert!(place(legs).norm() < 0.02, "{name}: {}", place(legs));
        assert!(
            (place(under) - Vector3::new(0.03, 0.0, 0.04)).norm() < 5e-3,
            "{name}: {}",
            place(under)
        );
        assert!((place(above).z - 0.24).abs() < 5e-3, "{name}: {}", place(above));
        // To a hull there is no room for the cube.
        let [legs, under, _] = fill(&mut world, 1.0, false);
        run(&mut world, 48);
        let place = |id| world.pose(id).unwrap().translation.vector;
        assert!(
            (place(under) - place(legs) - Vector3::new(0.03, 0.0, 0.04)).norm() > 0.05,
            "{name}"
        );
    }
}

#[test]
fn four_times_as_large_is_twice_as_slow_to_the_bit() {
    for name in ["edge-i8", "nano"] {
        let model = loaded(name);
        let ends: Vec<_> = [1.0, 4.0, 0.25]
            .into_iter()
            .map(|scale| {
                let mut world = World::new(&model, limits()).unwrap();
                fill(&mut world, scale, true);
                run(&mut world, 20);
                bits(&world, scale)
            })
            .collect();
        assert!(ends.iter().all(|end| *end == ends[0]), "{name}");
    }
}

/// Rows of pieces lie behind each other: one that goes leaves none behind, and one that comes finds its own. A scene
/// that is measured anew has its pieces in the new measure.
#[test]
fn tables_come_and_go() {
    let model = loaded("nano");
    let make = |with_more: bool| {
        let mut world = World::new(&model, limits()).unwrap();
        world.set_dt(1.0 / 24.0).unwrap();
        let (table, cube) = (table(1.0), cube(1.0));
        let hollow = Unit::new(&table, WOOD).pieces(Pieces::new(&table, &COUNTS));
        // The first free unit of a scene is what it is measured by, when it comes.
        let shelf = hollow.role(Role::Fixed);
        let shelf = with_more.then(|| world.add(&shelf, &at(2.0, 0.0)).unwrap());
        world.add(&hollow, &at(0.0, 0.01)).unwrap();
        let more = with_more.then(|| world.add(&hollow, &at(1.0, 0.0)).unwrap());
        world.add(&Unit::new(&cube, WOOD), &at(0.03, 0.06)).unwrap();
        let full = world.add(&hollow, &at(3.0, 0.0));
        assert_eq!(full.is_err(), with_more);
        if let Ok(last) = full {
            world.remove(last).unwrap();
        }
        for id in shelf.into_iter().chain(more) {
            world.remove(id).unwrap();
        }
        world.add(&Unit::new(&cube, WOOD), &at(-0.05, 0.3)).unwrap();
        run(&mut world, 20);
        bits(&world, 1.0)
    };
    assert_eq!(make(true), make(false));
}

#[test]
fn bad_pieces_are_refused_and_change_nothing() {
    let model = loaded("nano");
    let mut world = World::new(&model, limits()).unwrap();
    fill(&mut world, 1.0, true);
    let before = bits(&world, 1.0);
    let (table, cube) = (table(1.0), cube(1.0));
    let mut foul = table.clone();
    foul[17].y = f32::NAN;
    let mut far = table.clone();
    far[3].x = 2e6;
    let many = cube[..4].repeat(33);
    let few = [4_u16; 33];
    let large = table.repeat(11);
    let bad = |piece| ObserveError::BadPiece { unit: 3, piece };
    let cases = [
        (Pieces::new(&foul, &COUNTS), bad(2)),
        (Pieces::new(&far, &COUNTS), bad(0)),
        (Pieces::new(&table, &[8, 3]), bad(1)),
        (Pieces::new(&table, &[8, 8]), bad(2)),
        (Pieces::new(&table, &[8, 8, 8, 4]), bad(3)),
        (Pieces::new(&table, &[]), bad(0)),
        (Pieces::new(&[], &[4]), bad(0)),
        (Pieces::new(&large, &[8, 256]), bad(1)),
        (Pieces::new(&many, &few), ObserveError::TooManyPieces { unit: 3, found: 33, limit: 32 }),
        (
            Pieces::new(&large, &[132, 132]),
            ObserveError::TooManyPoints { found: TABLE + 2 * 8 + 268, limit: limits().points },
        ),
    ];
    for (pieces, expected) in cases {
        let unit = Unit::new(&cube, WOOD).pieces(pieces);
        let error = world.add(&unit, &at(1.0, 1.0)).unwrap_err();
        assert_eq!(error, EditError::Unit(expected), "{error}");
        assert_eq!(bits(&world, 1.0), before);
    }
    run(&mut world, 2);
}

#[test]
fn threads_kernels_and_copies_agree() {
    let model = loaded("nano");
    let mut engines: Vec<_> = Kernel::available()
        .into_iter()
        .map(|kernel| Engine { kernel, threads: Threads::ONE })
        .collect();
    let kernel = engines[engines.len() - 1].kernel;
    engines.push(Engine { kernel, threads: Threads::new(3).eager() });
    let ends: Vec<_> = engines
        .iter()
        .map(|engine| {
            let mut world = World::on(*engine, &model, limits(), 3).unwrap();
            fill(&mut world, 1.0, true);
            assert_eq!(world.edit(|simulator| simulator.replicate(3)), 3);
            for _ in 0..20 {
                world.step_copies(&mut |_, outcome| assert!(outcome.is_ok())).unwrap();
            }
            let copies: Vec<_> = (0..3)
                .map(|copy| {
                    let units = (0..3).filter_map(|k| world.simulator().unit(copy * 3 + k));
                    units.map(|unit| unit.internal_pose()).collect::<Vec<_>>()
                })
                .collect();
            assert!(copies.iter().all(|copy| *copy == copies[0] && copy.len() == 3));
            bits(&world, 1.0)
        })
        .collect();
    assert!(ends.iter().all(|end| *end == ends[0]));
}
