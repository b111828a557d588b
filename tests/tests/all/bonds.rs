//! Units that bonds hold together move as one body until the bonds break, with the trained models.
#![allow(missing_docs, clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use nalgebra::{Isometry3, Point3, UnitQuaternion, Vector3};
use rigidformer_core::{
    BondError, EditError, JoinError, Joint, Limits, Model, NoTrace, Physics, Portable, Posed, Role,
    Serial, Simulator, SlabSizes, Unit, UnitId,
};
use rigidformer_runtime::engine::Engine;
use rigidformer_runtime::kernels::Kernel;
use rigidformer_runtime::models::LoadedModel;
use rigidformer_runtime::world::World;
use rigidformer_tests::{Room, packed_model, with_simulator};

const DT_S: f32 = 1.0 / 60.0;
const STEPS: usize = 60;
const STONE: Physics = Physics { mass_kg: 1.0, friction: 0.6, restitution: 0.2 };

/// The corners of a box and the middles of its faces.
fn cuboid(x: f32, y: f32, z: f32) -> Vec<Point3<f32>> {
    let corner = |i: i32, bit| if i & bit == 0 { -1.0 } else { 1.0 };
    let corners = (0..8).map(|i| Point3::new(x * corner(i, 1), y * corner(i, 2), z * corner(i, 4)));
    let faces = [Vector3::x() * x, Vector3::y() * y, Vector3::z() * z];
    let faces = faces.into_iter().flat_map(|face| [Point3::from(face), Point3::from(-face)]);
    corners.chain(faces).collect()
}

fn with_scene<R>(body: impl FnOnce(&mut Simulator<'_, '_>) -> R) -> R {
    with_simulator(rigidformer_weights::EDGE, 16 * 28, |simulator| {
        simulator.set_dt(DT_S).unwrap();
        body(simulator)
    })
}

fn run(simulator: &mut Simulator<'_, '_>, steps: usize) {
    for _ in 0..steps {
        simulator.step().unwrap();
    }
}

fn break_all(simulator: &mut Simulator<'_, '_>, pairs: &[[UnitId; 2]]) {
    for pair in pairs {
        assert!(simulator.break_bond(*pair).unwrap());
    }
}

/// The eight cells of a cube of .2 m that moves and turns as one, and another cube below.
fn cells(simulator: &mut Simulator<'_, '_>) -> Vec<UnitId> {
    let (cell, cube) = (cuboid(0.05, 0.05, 0.05), cuboid(0.1, 0.1, 0.1));
    let rotation = UnitQuaternion::from_scaled_axis(Vector3::new(0.5, -0.3, 0.2));
    let now = Isometry3::from_parts(Vector3::new(0.02, 0.05, 0.55).into(), rotation);
    let spin = UnitQuaternion::from_scaled_axis(Vector3::new(1.0, 2.0, -1.5) * -DT_S);
    let velocity = Vector3::new(0.3, -0.1, -1.0);
    let before =
        Isometry3::from_parts((now.translation.vector - velocity * DT_S).into(), spin * rotation);
    let mut ids: Vec<_> = (0..8)
        .map(|k| {
            let side = |bit: usize| if k & bit == 0 { -0.05 } else { 0.05 };
            let place = Isometry3::translation(side(1), side(2), side(4));
            let unit = Unit::new(&cell, Physics { mass_kg: 0.125, ..STONE }).body(3);
            simulator.add(&unit, &(before * place), &(now * place)).unwrap()
        })
        .collect();
    let still = Isometry3::translation(0.0, 0.0, 0.1);
    ids.push(simulator.add(&Unit::new(&cube, STONE), &still, &still).unwrap());
    ids
}

/// All pairs of cells that share a face.
fn faces(ids: &[UnitId]) -> Vec<[UnitId; 2]> {
    let pairs = (0..8).flat_map(|a| [1, 2, 4].map(|bit| (a, a | bit)));
    pairs.filter(|(a, b)| a != b).map(|(a, b)| [ids[a], ids[b]]).collect()
}

/// How far cells are from where they were in the first one's frame, metres, and turned, radians.
fn looseness(
    simulator: &Simulator<'_, '_>,
    ids: &[UnitId],
    began: &[Isometry3<f32>],
) -> (f32, f32) {
    let first = simulator.pose(ids[0]).unwrap().inverse();
    let each = ids.iter().zip(began).map(|(id, began)| {
        let now = first * simulator.pose(*id).unwrap();
        let away = (now.translation.vector - began.translation.vector).norm();
        (away, now.rotation.angle_to(&began.rotation))
    });
    each.fold((0.0, 0.0), |(a, b), (c, d)| (f32::max(a, c), f32::max(b, d)))
}

fn arrangement(simulator: &Simulator<'_, '_>, ids: &[UnitId]) -> Vec<Isometry3<f32>> {
    let first = simulator.pose(ids[0]).unwrap().inverse();
    ids.iter().map(|id| first * simulator.pose(*id).unwrap()).collect()
}

fn bits(simulator: &Simulator<'_, '_>, copy: usize) -> Vec<u32> {
    let units = copy * simulator.len()..(copy + 1) * simulator.len();
    let poses = units.map(|unit| simulator.unit(unit).unwrap().internal_pose());
    let numbers = poses
        .flat_map(|pose| pose.rotation.iter().chain(&pose.centre).copied().collect::<Vec<_>>());
    numbers.map(f32::to_bits).collect()
}

#[test]
fn bonded_units_stay_together_for_five_hundred_steps() {
    with_scene(|simulator| {
        let ids = cells(simulator);
        simulator.bond(&faces(&ids)).unwrap();
        let began = arrangement(simulator, &ids[..8]);
        let mut active = 0;
        for step in 0..500 {
            active += simulator.step().unwrap().active_units;
            let (away, turn) = looseness(simulator, &ids[..8], &began);
            assert!(away < 1e-5 && turn < 2e-5, "step {step}: {away} m, {turn} rad");
        }
        assert!(active > 20, "the network corrects it: {active}");
        let (last, place) = (bits(simulator, 0), simulator.pose(ids[0]).unwrap());
        simulator.step().unwrap();
        assert_eq!(bits(simulator, 0), last, "at rest");
        assert!(place.translation.vector.norm() < 2.0);
        for unit in simulator.units() {
            let low = unit.points().map(|point| point.z).fold(f32::INFINITY, f32::min);
            assert!(low > -1e-4, "{low}");
        }
    });
}

/// The cube of one unit, with the cells' mass and inertia, falls on the ground as the cells do.
#[test]
fn cells_fall_as_their_cube() {
    // Small differences of the motion grow in the landing: the median counts.
    let mut off: Vec<_> = [0.3, 0.4, 0.5, 0.6, 0.7, 0.8]
        .into_iter()
        .map(|z| {
            let centre = |bonded: bool| {
                with_scene(|simulator| {
                    let (cell, cube) = (cuboid(0.05, 0.05, 0.05), cuboid(0.1, 0.1, 0.1));
                    let at = |x: f32, y: f32, z: f32| Isometry3::translation(x, y, z);
                    let ids: Vec<_> = (0..if bonded { 8 } else { 1 })
                        .map(|k| {
                            let side = |bit: usize| if k & bit == 0 { -0.05 } else { 0.05 };
                            let place = if bonded {
                                at(side(1), side(2), side(4))
                            } else {
                                at(0.0, 0.0, 0.0)
                            };
                            let mass_kg = if bonded { 0.125 } else { 1.0 };
                            let unit = Unit::new(
                                if bonded { &cell } else { &cube },
                                Physics { mass_kg, ..STONE },
                            );
                            let pose = at(0.0, 0.0, z) * place;
                            simulator.add(&unit.body(1), &pose, &pose).unwrap()
                        })
                        .collect();
                    if bonded {
                        simulator.bond(&faces(&ids)).unwrap();
                    }
                    run(simulator, 60);
                    let sum: Vector3<f32> =
                        ids.iter().map(|id| simulator.pose(*id).unwrap().translation.vector).sum();
                    sum / ids.len() as f32
                })
            };
            let (cells, cube) = (centre(true), centre(false));
            println!("from {z} m: cells {cells:?}, cube {cube:?}");
            let away = cells - cube;
            assert!(away.z.abs() < 1e-4 && away.norm() < 2e-2, "{cells} {cube}");
            away.norm()
        })
        .collect();
    off.sort_by(f32::total_cmp);
    assert!(off[off.len() / 2 - 1].midpoint(off[off.len() / 2]) < 1e-2, "{off:?}");
}

#[test]
fn a_broken_bond_lets_a_cell_go() {
    with_scene(|simulator| {
        let ids = cells(simulator);
        let pairs = faces(&ids);
        simulator.bond(&pairs).unwrap();
        run(simulator, 3);
        let body =
            |simulator: &Simulator<'_, '_>, unit: usize| simulator.get(ids[unit]).unwrap().body();
        // All bonds of the last cell, one after the other: only the last one lets it go.
        for (left, pair) in pairs.iter().filter(|pair| pair.contains(&ids[7])).enumerate() {
            assert_eq!(body(simulator, 7), Some(3), "{left}");
            assert_eq!(simulator.break_bond([pair[1], pair[0]]), Ok(true));
            assert_eq!(simulator.break_bond(*pair), Ok(false), "it is broken");
        }
        assert_eq!((body(simulator, 7), body(simulator, 0)), (Some(0), Some(3)));
        assert_eq!(simulator.bonds().filter(|bond| bond.holds).count(), 9);
        assert_eq!(simulator.bonds().count(), 12);
        assert_eq!(simulator.bond(&pairs[..1]), Err(BondError::Twice { pair: pairs[0] }));
        let began = arrangement(simulator, &ids[..8]);
        for _ in 0..STEPS {
            simulator.step().unwrap();
        }
        let (away, turn) = looseness(simulator, &ids[..7], &began);
        assert!(away < 1e-5 && turn < 1e-5, "{away} {turn}");
        let (away, _) = looseness(simulator, &ids[..8], &began);
        assert!(away > 0.01, "{away}");
    });
}

/// Until something touches the two, they go on as they did.
#[test]
fn what_breaks_in_flight_flies_on() {
    with_scene(|simulator| {
        simulator.set_planes(&[]).unwrap();
        // They do not touch when they turn about their own centres.
        let cell = cuboid(0.03, 0.03, 0.03);
        let at = |x: f32| Isometry3::translation(x, 0.0, 0.0);
        let ids = [-0.05, 0.06]
            .map(|x| simulator.add(&Unit::new(&cell, STONE).body(1), &at(x), &at(x)).unwrap());
        let spin = |angle: f32| {
            let turn = UnitQuaternion::from_scaled_axis(Vector3::new(0.0, 0.0, angle));
            Isometry3::from_parts(Vector3::zeros().into(), turn)
        };
        for (id, x) in ids.iter().zip([-0.05, 0.06]) {
            simulator.set_poses(*id, &(spin(-0.1) * at(x)), &at(x)).unwrap();
        }
        simulator.bond(&[ids]).unwrap();
        run(simulator, 5);
        let place = |simulator: &Simulator<'_, '_>| ids.map(|id| simulator.pose(id).unwrap());
        let [a, b] = place(simulator);
        let turned = [a, b].map(|pose| pose.rotation.angle());
        assert!(turned.iter().all(|turn| (turn - 0.5).abs() < 2e-3), "{turned:?}");
        simulator.break_bond(ids).unwrap();
        run(simulator, 10);
        let [c, d] = place(simulator);
        // Of a spin of .1 a step at an arm of .055 m, ten steps along the tangent.
        let apart = (d.translation.vector - c.translation.vector).norm();
        let expected = 0.11 * 2.0_f32.sqrt();
        assert!((apart - expected).abs() < 2e-3, "{apart} {expected}");
        assert!((c.rotation.angle() - 1.5).abs() < 2e-3, "{}", c.rotation.angle());
    });
}

#[test]
fn bonds_go_with_their_units_and_scenes() {
    with_scene(|simulator| {
        let ids = cells(simulator);
        // A row: the third holds both halves together.
        let row: Vec<_> = ids[..8].windows(2).map(|pair| [pair[0], pair[1]]).collect();
        simulator.bond(&row).unwrap();
        let kept = |simulator: &Simulator<'_, '_>| -> Vec<_> {
            simulator.bonds().map(|bond| bond.units).collect()
        };
        let body =
            |simulator: &Simulator<'_, '_>, unit: usize| simulator.get(ids[unit]).unwrap().body();
        assert_eq!(kept(simulator), row);
        simulator.remove(ids[2]).unwrap();
        assert_eq!(kept(simulator), [&row[..1], &row[3..]].concat());
        assert_eq!([0, 1].map(|unit| body(simulator, unit)), [Some(3); 2]);
        assert_eq!([3, 7].map(|unit| body(simulator, unit)), [Some(0); 2]);
        // What stays after the first one keeps the body.
        simulator.remove(ids[3]).unwrap();
        assert_eq!([4, 7].map(|unit| body(simulator, unit)), [Some(0); 2]);
        let began = arrangement(simulator, &ids[4..8]);
        run(simulator, 20);
        let (away, turn) = looseness(simulator, &ids[4..8], &began);
        assert!(away < 1e-5 && turn < 1e-5, "{away} {turn}");
        simulator.remove(ids[0]).unwrap();
        assert_eq!(kept(simulator), row[4..]);
        let points = cuboid(0.05, 0.05, 0.05);
        let pose = Isometry3::translation(0.0, 0.0, 0.6);
        let still = Posed { unit: Unit::new(&points, STONE), previous: pose, current: pose };
        simulator.observe_poses(DT_S, [still, still]).unwrap();
        assert_eq!(simulator.bonds().count(), 0);
        simulator.step().unwrap();
    });
}

#[test]
fn bonds_that_cannot_be_are_refused() {
    with_scene(|simulator| {
        let ids = cells(simulator);
        let hand = cuboid(0.05, 0.05, 0.05);
        let far = Isometry3::translation(5.0, 0.0, 1.0);
        let driven = Unit::new(&hand, STONE).role(Role::Driven).body(3);
        let driven = simulator.add(&driven, &far, &far).unwrap();
        let good = [ids[0], ids[1]];
        simulator.bond(&[good]).unwrap();
        let nobody = UnitId::from_bits(77);
        let all: Vec<_> = (0..16 * 8).map(|_| good).collect();
        for (pairs, error) in [
            (vec![[ids[0], nobody]], BondError::NoSuchUnit { id: nobody }),
            (vec![[ids[2], ids[2]]], BondError::Itself { id: ids[2] }),
            (vec![[ids[1], ids[0]]], BondError::Twice { pair: [ids[1], ids[0]] }),
            (vec![[ids[1], ids[2]], [ids[2], ids[1]]], BondError::Twice { pair: [ids[2], ids[1]] }),
            (vec![[ids[1], ids[2]], [ids[2], ids[8]]], BondError::Apart { pair: [ids[2], ids[8]] }),
            (vec![[ids[0], driven]], BondError::NotFree { id: driven }),
            (all, BondError::TooMany { found: 129, limit: 128 }),
        ] {
            assert_eq!(simulator.bond(&pairs), Err(error), "{error}");
            assert_eq!(simulator.bonds().count(), 1, "{error}");
            assert_eq!(
                simulator.break_bond([ids[1], ids[2]]),
                Err(BondError::NoSuchBond { pair: [ids[1], ids[2]] })
            );
        }
        let error = BondError::NoSuchCopy { copy: 1, copies: 1 };
        assert_eq!(simulator.break_bond_in(1, good), Err(error));
        assert_eq!(simulator.bonds_in(1).count(), 0);
        assert_eq!(simulator.set_role(ids[0], Role::Fixed), Err(EditError::Bonded { id: ids[0] }));
        let pivot = Point3::origin();
        let joint = |unit, parent| Joint::ball(unit, parent, pivot, pivot);
        assert_eq!(simulator.join(&joint(ids[1], ids[2])), Err(JoinError::Bonded { id: ids[1] }));
        simulator.join(&joint(ids[3], ids[4])).unwrap();
        assert_eq!(simulator.bond(&[[ids[4], ids[5]]]), Err(BondError::Joined { id: ids[4] }));
        assert_eq!(simulator.break_bond(good), Ok(true));
        simulator.set_role(ids[0], Role::Fixed).unwrap();
    });
    let model = packed_model("tiny");
    with_simulator(&model, 64, |simulator| {
        assert_eq!(simulator.bond(&[]), Err(BondError::Motion));
    });
}

/// Of each copy the bits of all steps. Some bonds break in the middle, in the copies that `breaks` says.
fn of_world(
    engine: Engine,
    model: &LoadedModel,
    copies: usize,
    breaks: impl Fn(usize) -> bool,
) -> Vec<Vec<u32>> {
    let limits = Limits { units: 9, points: 9 * 28 };
    let mut world = World::on(engine, model, limits, copies).unwrap();
    let mut pairs = Vec::new();
    world.edit(|simulator| {
        simulator.set_dt(DT_S).unwrap();
        let ids = cells(simulator);
        pairs = faces(&ids);
        simulator.bond(&pairs).unwrap();
        simulator.break_bond(pairs[0]).unwrap();
        assert_eq!(simulator.replicate(copies), copies);
        assert!(
            (0..copies)
                .all(|copy| simulator.bonds_in(copy).filter(|bond| bond.holds).count() == 11)
        );
    });
    let mut steps = vec![Vec::new(); copies];
    for step in 0..STEPS {
        if step == STEPS / 4 {
            world.edit(|simulator| {
                for copy in (0..copies).filter(|copy| breaks(*copy)) {
                    for pair in &pairs[2..9] {
                        simulator.break_bond_in(copy, *pair).unwrap();
                    }
                }
            });
        }
        world.step_copies(&mut |_, outcome| assert!(outcome.is_ok())).unwrap();
        for (copy, steps) in steps.iter_mut().enumerate() {
            steps.extend(bits(world.simulator(), copy));
        }
    }
    steps
}

#[test]
fn bits_are_the_same_for_kernels_threads_and_copies() {
    for bytes in [rigidformer_weights::EDGE, rigidformer_weights::NANO] {
        let model = LoadedModel::embedded("model", bytes).unwrap();
        let alone = [true, false].map(|breaks| {
            with_simulator(bytes, 16 * 28, |simulator| {
                simulator.set_dt(DT_S).unwrap();
                let ids = cells(simulator);
                let pairs = faces(&ids);
                simulator.bond(&pairs).unwrap();
                simulator.break_bond(pairs[0]).unwrap();
                let step = |step| {
                    if step == STEPS / 4 && breaks {
                        break_all(simulator, &pairs[2..9]);
                    }
                    simulator.step_on(Serial(Portable), &mut NoTrace).unwrap();
                    bits(simulator, 0)
                };
                (0..STEPS).flat_map(step).collect::<Vec<_>>()
            })
        });
        assert_ne!(alone[0], alone[1]);
        for threads in [1, 2] {
            for kernel in [Kernel::Portable, Kernel::chosen().unwrap()] {
                let engine = Engine { kernel, ..Engine::new().unwrap() };
                let engine = if threads == 1 { engine.single() } else { engine };
                for copies in [1, 3] {
                    let found = of_world(engine, &model, copies, |copy| copy != 1);
                    for (copy, found) in found.iter().enumerate() {
                        let expected = &alone[usize::from(copy == 1)];
                        assert!(found == expected, "{kernel:?} {threads} {copies}: {copy}");
                    }
                }
            }
        }
    }
}

#[test]
fn copies_that_stay_keep_their_bonds() {
    let model = LoadedModel::embedded("nano", rigidformer_weights::NANO).unwrap();
    let limits = Limits { units: 9, points: 9 * 28 };
    let mut world = World::on(Engine::new().unwrap(), &model, limits, 3).unwrap();
    world.edit(|simulator| {
        simulator.set_dt(DT_S).unwrap();
        let ids = cells(simulator);
        let pairs = faces(&ids);
        simulator.bond(&pairs).unwrap();
        assert_eq!(simulator.replicate(3), 3);
        simulator.break_bond_in(2, pairs[4]).unwrap();
        simulator.retain_copies(|copy| copy != 1);
        let held = |copy| simulator.bonds_in(copy).map(|bond| bond.holds).collect::<Vec<_>>();
        assert_eq!(held(0), [true; 12]);
        assert_eq!(held(1).iter().position(|holds| !holds), Some(4));
    });
}

/// Bonds change nothing of units that have none.
#[test]
fn units_alone_keep_their_bits() {
    let last = |bond: bool| {
        with_scene(|simulator| {
            let ids = cells(simulator);
            if bond {
                simulator.bond(&faces(&ids)).unwrap();
            }
            // A ball is thrown past them.
            let ball = cuboid(0.05, 0.04, 0.06);
            let [before, now] = [1.05, 1.0].map(|x| Isometry3::translation(x, 1.0, 0.2));
            simulator.add(&Unit::new(&ball, STONE), &before, &now).unwrap();
            let step = |_| {
                simulator.step().unwrap();
                bits(simulator, 0)[9 * 12..].to_vec()
            };
            // It lands, and is what a network corrects then, which sees the cells; what it does in the air is its own.
            (0..8).map(step).collect::<Vec<_>>()
        })
    };
    assert_eq!(last(true), last(false));
}

#[test]
fn nothing_is_allocated() {
    let model = Model::load(rigidformer_weights::NANO).unwrap();
    let limits = Limits { units: 9, points: 9 * 28 };
    let mut room = Room::new(SlabSizes::new(model.config(), limits));
    let mut simulator = Simulator::new(&model, limits, room.slabs()).unwrap();
    simulator.set_dt(DT_S).unwrap();
    let ids = cells(&mut simulator);
    let pairs = faces(&ids);
    let count = allocation_counter::measure(|| {
        simulator.bond(&pairs).unwrap();
        run(&mut simulator, 20);
        simulator.break_bond(pairs[0]).unwrap();
        assert_eq!(simulator.bonds().filter(|bond| bond.holds).count(), 11);
        assert!(simulator.bond(&pairs).is_err());
        run(&mut simulator, 20);
        simulator.remove(ids[3]).unwrap();
        simulator.step().unwrap();
    });
    assert_eq!(count.count_total, 0);
}
