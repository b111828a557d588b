//! Units on ground of varying height, by impulses.
#![allow(missing_docs, clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use nalgebra::{Isometry3, Point3, UnitQuaternion, Vector3};
use rigidformer_core::{
    EditError, HeightField, HeightFieldError, Joint, JointAxis, JointKind, Limits, Physics, Pieces,
    Plane, Role, SnapshotError, Unit, UnitId, Velocity,
};
use rigidformer_runtime::engine::Engine;
use rigidformer_runtime::futures::{BatchSimulator, Start};
use rigidformer_runtime::kernels::Kernel;
use rigidformer_runtime::models::LoadedModel;
use rigidformer_runtime::terrain::HeightFieldBuf;
use rigidformer_runtime::threads::Threads;
use rigidformer_runtime::world::World;

const WOOD: Physics = Physics { mass_kg: 1.0, friction: 0.7, restitution: 0.0 };
const DT_S: f32 = 1.0 / 60.0;

fn model() -> LoadedModel {
    LoadedModel::embedded("edge", rigidformer_weights::EDGE).unwrap()
}

fn cuboid(x: f32, y: f32, z: f32) -> Vec<Point3<f32>> {
    let side = |i: usize, bit, half: f32| if i & bit == 0 { -half } else { half };
    (0..8).map(|i| Point3::new(side(i, 1, x), side(i, 2, y), side(i, 4, z))).collect()
}

fn ball(radius: f32) -> Vec<Point3<f32>> {
    let place = |k: i32| {
        let (z, around) = (1.0 - (2 * k + 1) as f32 / 160.0, 2.4 * k as f32);
        let across = (1.0 - z * z).sqrt();
        Point3::new(across * around.cos(), across * around.sin(), z) * radius
    };
    (0..160).map(place).collect()
}

/// A square of cells about the origin.
fn ground(cells: usize, spacing: f32, height: impl Fn(f32, f32) -> f32) -> HeightFieldBuf {
    let low = -0.5 * cells as f32 * spacing;
    let place = |i: usize| low + i as f32 * spacing;
    let across = cells + 1;
    HeightFieldBuf {
        heights_m: (0..across * across)
            .map(|i| height(place(i % across), place(i / across)))
            .collect(),
        columns: across,
        spacing_m: [spacing; 2],
        corner_m: Vector3::new(low, low, 0.0),
        friction: 0.7,
        restitution: 0.0,
    }
}

fn on(engine: Engine, field: &HeightFieldBuf) -> World {
    let mut world = World::on(engine, &model(), Limits { units: 12, points: 2000 }, 1).unwrap();
    world.set_dt(DT_S).unwrap();
    world.set_planes(&[]).unwrap();
    world.set_height_field(Some(field)).unwrap();
    world
}

fn world(field: &HeightFieldBuf) -> World {
    on(Engine::new().unwrap(), field)
}

fn run(world: &mut World, steps: usize) {
    (0..steps).try_for_each(|_| world.step().map(drop)).unwrap();
}

fn place(world: &World, id: UnitId) -> Vector3<f32> {
    world.pose(id).unwrap().translation.vector
}

fn moving(linear_m_s: Vector3<f32>, angular_rad_s: Vector3<f32>) -> Velocity {
    Velocity { linear_m_s, angular_rad_s }
}

fn fastest(world: &World) -> f32 {
    let units = world.simulator().units();
    let speed = |id| world.velocity(id).unwrap().linear_m_s.norm();
    units.map(|unit| speed(unit.id())).fold(0.0, f32::max)
}

fn bits(world: &World) -> Vec<u32> {
    let poses = world.simulator().units().map(|unit| unit.internal_pose());
    poses
        .flat_map(|pose| {
            pose.rotation.iter().chain(&pose.centre).map(|v| v.to_bits()).collect::<Vec<_>>()
        })
        .collect()
}

#[test]
fn a_level_field_is_a_plane() {
    // Heights of a plane that leans, in cells that are not square to it, far from the origin, beside that plane.
    let lean = |x: f32, y: f32| 0.2 * x - 0.1 * y;
    for far in [Vector3::zeros(), Vector3::new(4096.0, -2048.0, 64.0)] {
        let mut field = ground(40, 0.0625, lean);
        field.corner_m += far;
        let normal = Vector3::new(-0.2, 0.1, 1.0).normalize();
        let plane = Plane { normal, offset_m: normal.dot(&far), friction: 0.7, restitution: 0.0 };
        for points in [cuboid(0.1, 0.15, 0.05), ball(0.1)] {
            let start = |x: f32| {
                Isometry3::new(far + Vector3::new(x, 0.1, 0.25), Vector3::new(0.1, 0.2, x))
            };
            let ends = [true, false].map(|is_field| {
                let mut world = world(&field);
                if !is_field {
                    world.set_height_field(None).unwrap();
                    world.set_planes(&[plane]).unwrap();
                    world.set_network(false);
                }
                let id = world.add(&Unit::new(&points, WOOD), &start(0.1)).unwrap();
                run(&mut world, 60);
                place(&world, id) - far
            });
            assert!((ends[0] - ends[1]).norm() < 2e-3, "{far}: {ends:?}");
        }
    }
}

#[test]
fn what_slides_over_level_cells_is_not_stopped_by_their_edges() {
    let field = ground(200, 0.02, |_, _| 0.0);
    let ice = Physics { friction: 0.0, ..WOOD };
    for points in [cuboid(0.07, 0.05, 0.03), ball(0.05)] {
        let mut world = world(&field);
        let low = points.iter().fold(0.0_f32, |low, point| low.min(point.z));
        let id =
            world.add(&Unit::new(&points, ice), &Isometry3::translation(-1.0, 0.0, -low)).unwrap();
        let velocity = Vector3::new(1.0, 0.37, 0.0);
        world
            .edit(|simulator| simulator.set_velocity(id, &moving(velocity, Vector3::zeros())))
            .unwrap();
        run(&mut world, 60);
        let way = place(&world, id) - Vector3::new(-1.0, 0.0, -low);
        // The radius of sampled points is a little off.
        assert!((way - velocity).xy().norm() < 1e-4 && way.z.abs() < 1e-3, "{way}");
    }
}

#[test]
fn units_come_to_rest_above_ridges_peaks_and_in_ditches() {
    // A ridge that a box lies across, a peak under its middle, a ditch that a ball and a box lie in.
    let ridge = ground(8, 0.5, |x, _| -0.4 * x.abs());
    let peak = ground(8, 0.5, |x, y| if x == 0.0 && y == 0.0 { 0.2 } else { 0.0 });
    let ditch = ground(8, 0.5, |x, _| x.abs());
    let (slab, cube, marble) = (cuboid(0.3, 0.2, 0.05), cuboid(0.1, 0.1, 0.1), ball(0.1));
    let root = std::f32::consts::SQRT_2;
    let turned = UnitQuaternion::from_euler_angles(0.0, std::f32::consts::FRAC_PI_4, 0.0);
    let cases = [
        (&ridge, &slab, UnitQuaternion::identity(), 0.05),
        (&peak, &slab, UnitQuaternion::identity(), 0.25),
        (&ditch, &marble, UnitQuaternion::identity(), 0.1 * root),
        (&ditch, &cube, turned, 0.1 * root),
    ];
    for (number, (field, points, turn, height)) in cases.into_iter().enumerate() {
        let mut world = world(field);
        let start = Isometry3::from_parts(Vector3::new(0.0, 0.0, height + 0.02).into(), turn);
        let id = world.add(&Unit::new(points, WOOD), &start).unwrap();
        run(&mut world, 90);
        let end = place(&world, id);
        // On a peak it balances.
        let aside = if number == 1 { 0.03 } else { 1e-3 };
        assert!(end.xy().norm() < aside && (end.z - height).abs() < 3e-3, "case {number}: {end}");
    }
}

#[test]
fn large_units_lie_on_smooth_hills() {
    // Of five metres, in cells of five centimetres: a box on its crest, and a ball over a corner of a cell.
    let hill = ground(80, 0.05, |x, y| -(x * x + y * y) / 10.0);
    for (points, height) in [(cuboid(0.5, 0.5, 0.5), 0.5), (ball(1.0), 1.0)] {
        let mut world = world(&hill);
        let id = world
            .add(&Unit::new(&points, WOOD), &Isometry3::translation(0.0, 0.0, height + 0.02))
            .unwrap();
        for _ in 0..60 {
            run(&mut world, 1);
            let end = place(&world, id);
            let on_crest = end.xy().norm() > 0.05 || (end.z - height).abs() < 0.02 + 2e-3;
            assert!(on_crest && end.z > height - 0.02, "{end}");
        }
    }
}

#[test]
fn units_on_gravel_touch_each_other_too() {
    let gravel = |x: f32, y: f32| ((x * 917.3 + y * 331.7) as i32).rem_euclid(7) as f32 * 5e-4;
    let mut world = world(&ground(80, 0.05, gravel));
    let cube = cuboid(0.3, 0.3, 0.3);
    let ids: Vec<_> = (0..4)
        .map(|k| {
            let start = Isometry3::translation(0.61 * k as f32 - 1.0, 0.0, 0.31);
            world.add(&Unit::new(&cube, WOOD), &start).unwrap()
        })
        .collect();
    run(&mut world, 30);
    let velocity = Vector3::new(3.0, 0.0, 0.0);
    world
        .edit(|simulator| simulator.set_velocity(ids[0], &moving(velocity, Vector3::zeros())))
        .unwrap();
    for _ in 0..60 {
        run(&mut world, 1);
        let places: Vec<_> = ids.iter().map(|id| place(&world, *id)).collect();
        assert!(places.windows(2).all(|pair| pair[1].x - pair[0].x > 0.59), "{places:?}");
        assert!(places.iter().all(|place| place.z > 0.295), "{places:?}");
    }
    assert!(place(&world, ids[3]).x > 0.85, "the push went through");
}

#[test]
fn borders_carry_and_what_is_far_below_is_let_be() {
    // A slab on a square of one cell, and a box of which more than half is on it.
    let square = ground(1, 1.0, |_, _| 0.5);
    for (points, x) in [(cuboid(1.0, 1.0, 0.05), 0.0), (cuboid(0.5, 0.5, 0.05), 0.3)] {
        let mut world = world(&square);
        let id =
            world.add(&Unit::new(&points, WOOD), &Isometry3::translation(x, 0.0, 0.57)).unwrap();
        run(&mut world, 60);
        let end = place(&world, id);
        assert!((end.z - 0.55).abs() < 5e-3 && (end.x - x).abs() < 0.02, "{end}");
    }
    // A ball on a plane five metres under the field rolls there.
    let mut world = world(&ground(8, 0.5, |_, _| 5.0));
    world.set_planes(&[Plane::ground(0.7, 0.0)]).unwrap();
    let id =
        world.add(&Unit::new(&ball(0.2), WOOD), &Isometry3::translation(-2.5, 0.0, 0.2)).unwrap();
    let velocity = Vector3::new(2.0, 0.0, 0.0);
    world
        .edit(|simulator| simulator.set_velocity(id, &moving(velocity, Vector3::zeros())))
        .unwrap();
    run(&mut world, 90);
    let end = place(&world, id);
    assert!(end.x > -1.0 && (end.z - 0.2).abs() < 1e-3, "{end}");
}

#[test]
fn wide_fields_have_no_gaps_between_cells() {
    // Thousands of columns of a centimetre: balls over corners and edges of far cells.
    let columns = 8000;
    let field = HeightFieldBuf {
        heights_m: vec![0.0; 2 * columns].into(),
        columns,
        spacing_m: [0.01, 4.0],
        corner_m: Vector3::new(0.0, -2.0, 0.0),
        friction: 0.7,
        restitution: 0.0,
    };
    let mut world = world(&field);
    let small = ball(0.02);
    let ids: Vec<_> = (0..8)
        .map(|k| {
            let x = 79.5 + 0.05 * k as f32 + 0.00125 * k as f32;
            world.add(&Unit::new(&small, WOOD), &Isometry3::translation(x, 0.0, 0.021)).unwrap()
        })
        .collect();
    run(&mut world, 60);
    assert!(ids.iter().all(|id| (place(&world, *id).z - 0.02).abs() < 1e-4));
}

#[test]
fn a_wall_stops_what_slides_into_it_and_what_leaves_the_field_falls() {
    let field = ground(200, 0.02, |x, _| if x > 0.5 { 0.3 } else { 0.0 });
    let ice = Physics { friction: 0.0, ..WOOD };
    for (velocity, points) in [(2.0, cuboid(0.1, 0.1, 0.1)), (2.0, ball(0.1)), (10.0, ball(0.1))] {
        let mut world = world(&field);
        let id =
            world.add(&Unit::new(&points, ice), &Isometry3::translation(-0.5, 0.0, 0.1)).unwrap();
        let velocity = Vector3::new(velocity, 0.0, 0.0);
        world
            .edit(|simulator| simulator.set_velocity(id, &moving(velocity, Vector3::zeros())))
            .unwrap();
        run(&mut world, 60);
        let end = place(&world, id);
        // Its foot meets the wall first, which leans a little: it may tip back.
        assert!((0.2..0.43).contains(&end.x) && (end.z - 0.1).abs() < 5e-3, "{end}");
    }
    let mut world = world(&field);
    let id =
        world.add(&Unit::new(&ball(0.1), WOOD), &Isometry3::translation(-2.2, 0.0, 0.3)).unwrap();
    run(&mut world, 60);
    assert!(place(&world, id).z < -1.0);
}

/// A heap of boxes, a ball and a hollow table on hills.
fn heap(engine: Engine) -> World {
    let field = ground(40, 0.1, |x, y| 0.1 * (3.0 * x).sin() * (2.0 * y).cos());
    let mut world = on(engine, &field);
    let cube = cuboid(0.08, 0.08, 0.08);
    for number in 0..8 {
        let (x, y, z) = (number % 2, number / 2 % 2, number / 4);
        let start = Isometry3::translation(0.17 * x as f32, 0.17 * y as f32, 0.3 + 0.18 * z as f32);
        world.add(&Unit::new(&cube, WOOD), &start).unwrap();
    }
    world.add(&Unit::new(&ball(0.1), WOOD), &Isometry3::translation(-0.4, 0.1, 0.4)).unwrap();
    let top: Vec<_> = cuboid(0.2, 0.1, 0.02);
    let legs = [-0.18, 0.18]
        .map(|x| cuboid(0.02, 0.1, 0.1).into_iter().map(move |p| p + Vector3::new(x, 0.0, -0.12)));
    let points: Vec<_> = top.into_iter().chain(legs.into_iter().flatten()).collect();
    let table = Unit::new(&points, WOOD).pieces(Pieces::new(&points, &[8, 8, 8]));
    world.add(&table, &Isometry3::translation(0.1, -0.6, 0.4)).unwrap();
    world
}

#[test]
fn all_kernels_and_threads_have_the_same_bits() {
    let ends: Vec<_> = Kernel::available()
        .into_iter()
        .flat_map(|kernel| [1, 2].map(|count| Engine { kernel, threads: Threads::new(count) }))
        .map(|engine| {
            let mut world = heap(engine);
            run(&mut world, 60);
            bits(&world)
        })
        .collect();
    assert!(ends.windows(2).all(|pair| pair[0] == pair[1]));
}

#[test]
fn a_heap_on_hills_comes_to_rest_and_stays() {
    let mut world = heap(Engine::new().unwrap());
    // A ball rolls on.
    let ball = world.simulator().units().nth(8).unwrap().id();
    world.edit(|simulator| simulator.remove(ball)).unwrap();
    run(&mut world, 400);
    let places = |world: &World| -> Vec<_> {
        world.simulator().units().map(|unit| place(world, unit.id())).collect()
    };
    let before = places(&world);
    run(&mut world, 60);
    let after = places(&world);
    let moved = before.iter().zip(&after).map(|(a, b)| (a - b).norm()).fold(0.0, f32::max);
    assert!(moved < 2e-3 && fastest(&world) < 0.02, "{moved} m, {} m/s", fastest(&world));
}

#[test]
fn boxes_on_hills_come_to_rest() {
    let field = ground(40, 0.1, |x, y| 0.1 * (3.0 * x).sin() * (2.0 * y).cos());
    let (mut worst, mut still) = ((0.0_f32, 0.0_f32), 0);
    for friction in [0.7, 1.0] {
        for number in 0..16 {
            let field = HeightFieldBuf { friction, ..field.clone() };
            let mut world = world(&field);
            let k = number % 8;
            let start =
                Isometry3::translation(0.4 * k as f32 - 1.2, 0.3 * (k % 3) as f32 - 0.3, 0.3);
            let points =
                if number < 8 { cuboid(0.08, 0.08, 0.08) } else { cuboid(0.12, 0.1, 0.06) };
            let id = world.add(&Unit::new(&points, WOOD), &start).unwrap();
            run(&mut world, 300);
            let before = place(&world, id);
            let (mut most, mut turn) = (0.0_f32, 0.0_f32);
            for _ in 0..60 {
                run(&mut world, 1);
                let velocity = world.velocity(id).unwrap();
                most = most.max(velocity.linear_m_s.norm());
                turn = turn.max(velocity.angular_rad_s.norm());
            }
            let moved = (place(&world, id) - before).norm();
            if moved == 0.0 {
                still += 1;
            } else {
                println!("{friction} {number}: {most} m/s {turn} rad/s, {moved} m");
            }
            worst = (worst.0.max(most), worst.1.max(moved));
        }
    }
    // They rock by thousandths of their size at most, and do not creep away.
    assert!(worst.0 < 0.01 && worst.1 < 2e-3 && still >= 28, "{worst:?}, {still} of 32 still");
}

#[test]
fn copies_snapshots_and_futures_go_on_on_the_same_ground() {
    let mut world = heap(Engine::new().unwrap());
    run(&mut world, 5);
    let (snapshot, state) = (world.snapshot(), world.start().unwrap());
    let mut other = world.try_clone().unwrap();
    let mut poses = vec![Isometry3::identity(); 10 * 10];
    let simulator = BatchSimulator::new(Engine::new().unwrap(), world.model());
    simulator.run(&Start::of(&state), 10, &(), &mut poses).unwrap();
    for world in [&mut world, &mut other] {
        run(world, 10);
    }
    assert_eq!(bits(&world), bits(&other));
    let ends: Vec<_> = world.simulator().units().map(|unit| unit.pose()).collect();
    assert_eq!(poses[90..], ends);
    world.restore(&snapshot).unwrap();
    run(&mut world, 10);
    assert_eq!(bits(&world), bits(&other));
    // A snapshot does not hold the ground, and says so.
    let field = world.height_field().unwrap();
    for ground in [None, Some(HeightFieldBuf { friction: 0.1, ..field })] {
        world.set_height_field(ground.as_ref()).unwrap();
        let before = bits(&world);
        assert_eq!(world.restore(&snapshot), Err(SnapshotError::OtherHeightField));
        assert_eq!(bits(&world), before);
    }
}

#[test]
fn a_pendulum_swings_into_a_hill() {
    let field = ground(40, 0.1, |x, _| if x > 0.3 { 0.5 } else { 0.0 });
    let mut world = world(&field);
    let rod = cuboid(0.02, 0.02, 0.3);
    let post = world
        .add(
            &Unit::new(&rod, WOOD).role(Role::Fixed).body(1),
            &Isometry3::translation(0.0, 0.0, 1.0),
        )
        .unwrap();
    let side = UnitQuaternion::from_euler_angles(0.0, std::f32::consts::FRAC_PI_2, 0.0);
    // It hangs from the post's lower end, and begins on the side away from the hill.
    let start = Isometry3::from_parts(Vector3::new(-0.3, 0.0, 0.7).into(), side);
    let hangs = world.add(&Unit::new(&rod, WOOD).body(1), &start).unwrap();
    let joint = Joint::ball(hangs, post, Point3::new(0.0, 0.0, 0.3), Point3::new(0.0, 0.0, -0.3))
        .kind(JointKind::Revolute(JointAxis::new(Vector3::y())));
    world.edit(|simulator| simulator.join(&joint)).unwrap();
    let mut most = f32::NEG_INFINITY;
    for _ in 0..90 {
        run(&mut world, 1);
        let end = world.pose(hangs).unwrap() * Point3::new(0.0, 0.0, -0.3);
        most = most.max(end.x);
        assert!(end.z > 0.05, "{end}");
    }
    assert!((0.28..0.36).contains(&most), "the hill begins at 0.3 m: {most}");
}

#[test]
fn a_field_that_is_none_is_refused_and_the_ground_stays() {
    let field = ground(4, 0.5, |_, _| 0.0);
    let mut world = world(&field);
    let bad = |cause| Err(EditError::HeightField(cause));
    let cases = [
        (
            HeightFieldBuf { columns: 7, ..field.clone() },
            HeightFieldError::Shape { heights: 25, columns: 7 },
        ),
        (
            HeightFieldBuf { columns: 0, ..field.clone() },
            HeightFieldError::Shape { heights: 25, columns: 0 },
        ),
        (HeightFieldBuf { spacing_m: [0.5, 0.0], ..field.clone() }, HeightFieldError::Spacing),
        (HeightFieldBuf { spacing_m: [f32::NAN, 1.0], ..field.clone() }, HeightFieldError::Spacing),
        (
            HeightFieldBuf { corner_m: Vector3::new(0.0, f32::NAN, 0.0), ..field.clone() },
            HeightFieldError::Place,
        ),
        (
            HeightFieldBuf { corner_m: Vector3::new(1e6, 0.0, 0.0), ..field.clone() },
            HeightFieldError::Place,
        ),
        (HeightFieldBuf { friction: -1.0, ..field.clone() }, HeightFieldError::Coefficient),
        (
            HeightFieldBuf { restitution: f32::INFINITY, ..field.clone() },
            HeightFieldError::Coefficient,
        ),
    ];
    for (wrong, cause) in cases {
        assert_eq!(world.set_height_field(Some(&wrong)), bad(cause), "{wrong:?}");
        assert_eq!(world.height_field().as_ref(), Some(&field));
    }
    let heights: Vec<_> = (0..25).map(|i| if i == 11 { f32::NAN } else { 0.0 }).collect();
    let wrong = HeightFieldBuf { heights_m: heights.into(), ..field.clone() };
    assert_eq!(world.set_height_field(Some(&wrong)), bad(HeightFieldError::Height { height: 11 }));
    // Models of soft bodies and robots know planes alone.
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../weights/models/g1.rfm");
    let robot = LoadedModel::open(path.as_ref()).unwrap();
    let mut other = World::new(&robot, Limits { units: 2, points: 100 }).unwrap();
    assert_eq!(other.set_height_field(Some(&field)), bad(HeightFieldError::Model));
}

#[test]
fn wild_scenes_stay_finite() {
    // Heights with needles and pits, cells smaller and larger than units, fast spinning units of all shapes.
    for (cells, spacing) in [(64, 0.02), (8, 0.6)] {
        let wild = |x: f32, y: f32| {
            let number = ((x * 917.3 + y * 331.7) as i32).wrapping_mul(40503) & 255;
            if number < 8 { 0.4 } else { number as f32 * 4e-4 }
        };
        let field = ground(cells, spacing, wild);
        for (number, points) in
            [cuboid(0.1, 0.02, 0.3), ball(0.07), cuboid(0.01, 0.01, 0.01)].iter().enumerate()
        {
            let mut world = world(&field);
            for k in 0..6 {
                let angle = (k + 7 * number) as f32;
                let start = Isometry3::new(
                    Vector3::new(0.1 * angle.sin(), 0.1 * angle.cos(), 0.6 + 0.65 * k as f32),
                    Vector3::new(angle, 1.0, 0.3),
                );
                let id = world.add(&Unit::new(points, WOOD), &start).unwrap();
                let velocity = Vector3::new(angle.cos(), angle.sin(), -3.0) * 3.0;
                world
                    .edit(|simulator| {
                        simulator
                            .set_velocity(id, &moving(velocity, Vector3::new(20.0, angle, -5.0)))
                    })
                    .unwrap();
            }
            run(&mut world, 120);
            let speed = fastest(&world);
            assert!(speed < 40.0, "{speed}");
        }
    }
}

#[test]
fn a_borrowed_field_is_the_callers() {
    let heights_m = [0.0; 4];
    let spacing_m = [2.0, 2.0];
    let corner_m = Vector3::new(-1.0, -1.0, 0.0);
    let field = HeightField {
        heights_m: &heights_m,
        columns: 2,
        spacing_m,
        corner_m,
        friction: 1.0,
        restitution: 0.0,
    };
    let copy = HeightFieldBuf::copy_of(&field).unwrap();
    assert_eq!(copy.view(), field);
    assert_eq!(field.height_m(0.3, -0.9), Some(0.0));
}
