//! Motion without contact is exact, and contact is the same, at any time step and any place: `docs/MODEL.md`, section 6.
#![allow(missing_docs, clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use nalgebra::{Isometry3, Point3, Translation3, UnitQuaternion, Vector3};
use rigidformer_core::{Observed, Physics, Plane, Posed, Role, Simulator, Unit, UnitId, Velocity};
use rigidformer_tests::with_simulator;

/// Exact at a million metres too.
const HALF_M: f32 = 0.125;
const WOOD: Physics = Physics { mass_kg: 1.0, friction: 0.5, restitution: 0.3 };
const STEPS_S: [f32; 7] = [1e-6, 1e-5, 1e-4, 1e-3, 1e-2, 1.0 / 24.0, 0.1];
/// Places of a scene count from near its unit: the last three are as far from that as the first.
const HEIGHTS_M: [f32; 5] = [0.0, 10.0, 1024.0, 102_400.0, 999_936.0];
const G: f32 = 9.81;

fn cube() -> Vec<Point3<f32>> {
    let side = |k: i32, bit: i32| if k & bit == 0 { -HALF_M } else { HALF_M };
    (0..8).map(|k| Point3::new(side(k, 1), side(k, 2), side(k, 4))).collect()
}

/// A cube so high over a plane that is so high, with a velocity along x.
fn with_cube<R>(
    (dt_s, ground_m): (f32, f32),
    (height_m, speed_m_s): (f32, f32),
    body: impl FnOnce(&mut Simulator<'_, '_>, UnitId) -> R,
) -> R {
    with_simulator(rigidformer_weights::EDGE, 64, |simulator| {
        simulator.set_dt(dt_s).unwrap();
        simulator.set_gravity(Vector3::new(0.0, 0.0, -G)).unwrap();
        let plane = Plane { offset_m: ground_m, ..Plane::ground(1.0, 1.0) };
        simulator.set_planes(&[plane]).unwrap();
        let pose = Isometry3::translation(3.0, 2.0, ground_m + height_m);
        let id = simulator.add(&Unit::new(&cube(), WOOD), &pose, &pose).unwrap();
        let linear_m_s = Vector3::new(speed_m_s, 0.0, 0.0);
        simulator.set_velocity(id, &Velocity { linear_m_s, ..Velocity::default() }).unwrap();
        body(simulator, id)
    })
}

fn centre(simulator: &Simulator<'_, '_>, id: UnitId) -> Point3<f64> {
    simulator.get(id).unwrap().centre()
}

/// Steps of so many seconds, at most, and the time that they take.
fn run(simulator: &mut Simulator<'_, '_>, seconds: f32, most: usize) -> f64 {
    let dt_s = simulator.dt_s().unwrap();
    let steps = ((seconds / dt_s).round() as usize).clamp(1, most);
    for _ in 0..steps {
        simulator.step().unwrap();
    }
    steps as f64 * f64::from(dt_s)
}

#[test]
fn free_fall_is_the_parabola_at_any_step_and_height() {
    for dt_s in STEPS_S {
        for height_m in HEIGHTS_M {
            with_cube((dt_s, height_m), (16.0, 0.5), |simulator, id| {
                let began = centre(simulator, id);
                let time = run(simulator, 0.2, 20_000);
                let found = centre(simulator, id) - began;
                let exact = Vector3::new(0.5 * time, 0.0, -f64::from(G) * time * time / 2.0);
                let error = ((found.z - exact.z) / exact.z).abs();
                let aside = (found.x - exact.x).hypot(found.y) / exact.x;
                println!("fall, {dt_s:.0e} s, {height_m} m: {error:.1e}, aside {aside:.1e}");
                assert!(error < 1e-6 && aside < 1e-6, "{dt_s} {height_m}: {error} {aside}");
                let speed = simulator.velocity(id).unwrap().linear_m_s.z;
                let error = f64::from(speed) / (-f64::from(G) * time) - 1.0;
                assert!(error.abs() < 1e-5, "{dt_s} {height_m}: {speed} m/s");
            });
        }
    }
}

#[test]
fn a_box_rests_at_any_step_and_height() {
    for dt_s in STEPS_S {
        for height_m in HEIGHTS_M {
            with_cube((dt_s, height_m), (HALF_M, 0.0), |simulator, id| {
                let began = centre(simulator, id);
                run(simulator, 1.0, 2000);
                let moved = (centre(simulator, id) - began).norm();
                let speed = simulator.velocity(id).unwrap().linear_m_s.norm();
                println!("rest, {dt_s:.0e} s, {height_m} m: {moved:.1e} m, {speed:.1e} m/s");
                assert!(moved < 1e-3, "{dt_s} {height_m}: {moved} m");
            });
        }
    }
}

#[test]
fn a_box_slides_as_friction_says_at_any_step_and_height() {
    for dt_s in STEPS_S {
        for height_m in HEIGHTS_M {
            with_cube((dt_s, height_m), (HALF_M, 1.0), |simulator, id| {
                let began = centre(simulator, id);
                let time = run(simulator, 0.1, 20_000);
                let lost = time - (centre(simulator, id) - began).x;
                // Friction .5 takes half of gravity.
                let exact = f64::from(0.5 * G) * time * time / 2.0;
                let error = lost / exact - 1.0;
                println!("slide, {dt_s:.0e} s, {height_m} m: {error:+.4}");
                // Velocities are f32 in contact; longer steps find it late.
                let most = if dt_s < 2e-3 { 0.05 } else { 0.5 };
                // 10 m from there the gaps of short steps are rounded.
                let is_near = height_m != 10.0 || dt_s > 2e-4;
                assert!(!is_near || error.abs() < most, "{dt_s} {height_m}: {error}");
            });
        }
    }
}

/// Where the step or gravity changes, velocities last: what falls goes on along its parabola, and what rests goes on resting.
#[test]
fn velocities_last_where_the_step_or_gravity_changes() {
    with_cube((0.01, 0.0), (64.0, 0.5), |simulator, id| {
        let (mut place, mut speed) = (centre(simulator, id).z, 0.0);
        for (number, dt_s) in [0.1, 1e-3, 0.02, 1e-4, 1.0 / 24.0].into_iter().enumerate() {
            let gravity = f64::from(G) * [1.0, 1.0, 0.25][number % 3];
            simulator.set_dt(dt_s).unwrap();
            simulator.set_gravity(Vector3::new(0.0, 0.0, -gravity as f32)).unwrap();
            let time = run(simulator, 0.5, 2000);
            place += speed * time - gravity * time * time / 2.0;
            speed -= gravity * time;
            let error = centre(simulator, id).z - place;
            assert!(error.abs() < 2e-5, "{dt_s}: {error} m");
            let found = simulator.velocity(id).unwrap().linear_m_s;
            assert!((f64::from(found.z) - speed).abs() < 2e-5, "{dt_s}: {} {speed}", found.z);
            assert!((found.x - 0.5).abs() < 1e-6, "{dt_s}: {}", found.x);
        }
    });
    with_cube((0.01, 0.0), (HALF_M, 0.0), |simulator, id| {
        run(simulator, 1.0, 100);
        let began = centre(simulator, id);
        for dt_s in [0.1, 1e-3, 1.0 / 24.0, 1e-4] {
            simulator.set_dt(dt_s).unwrap();
            run(simulator, 0.5, 500);
            let speed = simulator.velocity(id).unwrap().linear_m_s.norm();
            assert!(speed < 1e-6, "{dt_s}: {speed} m/s");
            let moved = (centre(simulator, id) - began).norm();
            assert!(moved < 1e-6, "{dt_s}: {moved} m");
        }
    });
}

/// What is put somewhere without motion stays there without gravity, and rests on the ground, whatever the step becomes.
#[test]
fn what_is_put_down_has_no_motion_at_another_step_or_gravity() {
    let put = |height_m: f32, gravity: f32, dt_s: f32| {
        with_simulator(rigidformer_weights::EDGE, 64, |simulator| {
            simulator.set_dt(1.0 / 24.0).unwrap();
            simulator.set_planes(&[Plane::ground(1.0, 1.0)]).unwrap();
            let pose = Isometry3::translation(0.0, 0.0, height_m);
            let id = simulator.add(&Unit::new(&cube(), WOOD), &pose, &pose).unwrap();
            let began = centre(simulator, id);
            simulator.set_gravity(Vector3::new(0.0, 0.0, gravity)).unwrap();
            simulator.set_dt(dt_s).unwrap();
            run(simulator, 0.5, 1000);
            (centre(simulator, id) - began).norm()
        })
    };
    for (height_m, gravity, dt_s) in
        [(5.0, 0.0, 1.0 / 24.0), (5.0, 0.0, 1e-3), (HALF_M, -G, 1.0 / 240.0), (HALF_M, -1.62, 0.1)]
    {
        let moved = put(height_m, gravity, dt_s);
        assert!(moved < 1e-3, "{gravity} m/s^2, {dt_s} s: {moved} m");
    }
}

/// A sensor's nonsense among the units takes no digits from the others, whichever comes first.
#[test]
fn a_unit_far_away_takes_nothing_from_the_others() {
    let (near, far) =
        (Isometry3::translation(0.3, 0.2, 1.0), Isometry3::translation(1e5, 0.0, 1.0));
    let rollout = |poses: &[Isometry3<f32>], near: usize| {
        with_simulator(rigidformer_weights::EDGE, 64, |simulator| {
            simulator.set_dt(0.01).unwrap();
            let ids: Vec<_> = poses
                .iter()
                .map(|pose| simulator.add(&Unit::new(&cube(), WOOD), pose, pose).unwrap())
                .collect();
            let began = centre(simulator, ids[near]);
            for _ in 0..10 {
                simulator.step().unwrap();
            }
            (began, centre(simulator, ids[near]))
        })
    };
    let (began, alone) = rollout(&[near], 0);
    for (poses, number) in [([far, near], 1), ([near, far], 0)] {
        let (began_here, here) = rollout(&poses, number);
        assert_eq!(began_here, began);
        assert!((here - alone).norm() < 1e-6, "{here} {alone}");
    }
}

/// Beside a unit near the world's origin: what falls far away lands on the ground there, and does not fly up from it.
#[test]
fn what_falls_far_away_lands_on_the_ground() {
    for x in [1e2, 1e4, 1e5] {
        with_simulator(rigidformer_weights::EDGE, 64, |simulator| {
            simulator.set_dt(1.0 / 60.0).unwrap();
            simulator.set_planes(&[Plane::ground(1.0, 1.0)]).unwrap();
            let [near, far] = [0.0, x].map(|x| {
                let pose = Isometry3::translation(x, 0.0, 0.2);
                simulator.add(&Unit::new(&cube(), WOOD), &pose, &pose).unwrap()
            });
            let mut last = [0.0; 2];
            for _ in 0..90 {
                simulator.step().unwrap();
                last = [near, far].map(|id| centre(simulator, id).z);
            }
            assert!(last.iter().all(|z| (z - f64::from(HALF_M)).abs() < 1e-3), "{x}: {last:?}");
        });
    }
}

/// Poses that are set near the world's origin keep their digits, wherever the scene was before.
#[test]
fn poses_that_are_set_near_the_origin_keep_their_digits() {
    with_simulator(rigidformer_weights::EDGE, 64, |simulator| {
        simulator.set_dt(0.01).unwrap();
        let parked = Isometry3::translation(1e5, 0.0, 1.0);
        let ids: Vec<_> = (0..2)
            .map(|_| simulator.add(&Unit::new(&cube(), WOOD), &parked, &parked).unwrap())
            .collect();
        let pose = Isometry3::translation(0.1, 0.0, 0.125);
        simulator.set_poses(ids[0], &pose, &pose).unwrap();
        assert_eq!(simulator.pose(ids[0]).unwrap().translation, pose.translation);
        let other = simulator.pose(ids[1]).unwrap();
        assert_eq!(other.translation, parked.translation);
    });
}

/// A scene may lie on both sides of the world's origin.
#[test]
fn a_scene_on_both_sides_of_the_origin_steps() {
    with_simulator(rigidformer_weights::EDGE, 64, |simulator| {
        simulator.set_dt(0.01).unwrap();
        for x in [-1e5, 2.5e5] {
            let pose = Isometry3::translation(x, 0.0, 1.0);
            simulator.add(&Unit::new(&cube(), WOOD), &pose, &pose).unwrap();
        }
        simulator.step().unwrap();
        simulator.set_dt(0.02).unwrap();
        simulator.step().unwrap();
    });
}

/// Snapshots of scenes whose length changed, and of what spins more than once a step, are read again.
#[test]
fn snapshots_of_any_scene_are_read_again() {
    let block = |half: f32| -> Vec<_> { cube().iter().map(|p| p * (half / HALF_M)).collect() };
    with_simulator(rigidformer_weights::EDGE, 64, |simulator| {
        simulator.set_dt(0.01).unwrap();
        let (small, large) = (block(0.04), block(0.4));
        let fixed = Unit { role: rigidformer_core::Role::Fixed, ..Unit::new(&small, WOOD) };
        let at = |x: f32| Isometry3::translation(x, 0.0, 10.0);
        simulator.add(&fixed, &at(100.0), &at(100.0)).unwrap();
        let id = simulator.add(&Unit::new(&large, WOOD), &at(97.0), &at(97.0)).unwrap();
        let angular_rad_s = Vector3::new(0.0, 0.0, 150.0);
        simulator.set_velocity(id, &Velocity { angular_rad_s, ..Velocity::default() }).unwrap();
        simulator.set_dt(0.05).unwrap();
        assert_eq!(simulator.pose(id).unwrap().translation, at(97.0).translation);
        let mut state = vec![0; simulator.snapshot_bytes()];
        simulator.snapshot(&mut state).unwrap();
        simulator.restore(&state).unwrap();
    });
}

/// Who gives a pose twice, or lets go of what stands still, means rest: it falls as from rest, whatever the step.
#[test]
fn what_begins_at_rest_falls_from_rest() {
    type Begin = fn(&mut Simulator<'_, '_>, &Unit<'_>, &Isometry3<f32>, f32);
    let begins: [(&str, Begin); 7] = [
        ("added", |simulator, unit, pose, _| {
            simulator.add(unit, pose, pose).unwrap();
        }),
        ("observed", |simulator, unit, pose, dt_s| {
            let posed = Posed { unit: *unit, previous: *pose, current: *pose };
            simulator.observe_poses(dt_s, [posed]).unwrap();
        }),
        ("observed by its points", |simulator, unit, pose, dt_s| {
            let turn = UnitQuaternion::from_euler_angles(0.3, 0.7, -1.1);
            let turned = pose * Isometry3::from_parts(Translation3::identity(), turn);
            let points: Vec<_> = unit.points.iter().map(|point| turned * point).collect();
            let seen = Observed { unit: Unit::new(&points, WOOD), current: &points };
            simulator.observe(dt_s, [seen]).unwrap();
        }),
        ("held and let go", |simulator, unit, pose, _| {
            let id = simulator.add(unit, &Isometry3::translation(1.0, 0.0, 9.0), pose).unwrap();
            simulator.hold_in(0, id, pose).unwrap();
            let held = simulator.unit(0).unwrap();
            assert_eq!(held.previous_pose(), held.pose());
            simulator.set_role(id, Role::Driven).unwrap();
            assert_eq!(simulator.velocity(id).unwrap().linear_m_s, Vector3::zeros());
            simulator.set_role(id, Role::Free).unwrap();
        }),
        ("put back", |simulator, unit, pose, _| {
            let id = simulator.add(unit, &Isometry3::translation(1.0, 0.0, 9.0), pose).unwrap();
            simulator.set_poses(id, pose, pose).unwrap();
        }),
        ("let go by what drives it", |simulator, unit, pose, _| {
            let id = simulator.add(&unit.role(Role::Driven), pose, pose).unwrap();
            simulator.step().unwrap();
            simulator.set_role(id, Role::Free).unwrap();
        }),
        ("fixed before", |simulator, unit, pose, _| {
            let id = simulator.add(&unit.role(Role::Fixed), pose, pose).unwrap();
            simulator.step().unwrap();
            simulator.set_role(id, Role::Free).unwrap();
        }),
    ];
    for (how, begin) in begins {
        for dt_s in [1e-4, 1e-3, 1.0 / 240.0, 1.0 / 24.0, 0.1] {
            with_simulator(rigidformer_weights::EDGE, 64, |simulator| {
                simulator.set_dt(dt_s).unwrap();
                simulator.set_gravity(Vector3::new(0.0, 0.0, -G)).unwrap();
                let (points, pose) = (cube(), Isometry3::translation(3.0, 2.0, 16.0));
                begin(simulator, &Unit::new(&points, WOOD), &pose, dt_s);
                let id = simulator.unit(0).unwrap().id();
                assert!(simulator.velocity(id).unwrap().linear_m_s.norm() < 1e-7, "{how}");
                let began = centre(simulator, id);
                let time = run(simulator, 0.4, 1000);
                let exact = -f64::from(G) * time * time / 2.0;
                let error = (centre(simulator, id).z - began.z) / exact - 1.0;
                // Centres have digits down to 1e-9 m.
                assert!(error.abs() < 1e-6, "{how}, {dt_s}: {error}");
            });
        }
    }
}

/// What is let go of flies on as fast as it was led, and what is taken hold of keeps its velocity.
#[test]
fn velocities_last_where_the_role_changes() {
    with_cube((0.01, 0.0), (16.0, 0.5), |simulator, id| {
        for role in [Role::Driven, Role::Free] {
            let before = simulator.velocity(id).unwrap().linear_m_s;
            simulator.set_role(id, role).unwrap();
            let after = simulator.velocity(id).unwrap().linear_m_s;
            assert!((after - before).norm() < 1e-6, "{role:?}: {before} {after}");
        }
    });
}

/// What begins in the ground comes out of it, and carries what stands on it.
#[test]
fn what_begins_in_the_ground_comes_out_and_rests() {
    for deep_m in [0.0, 0.0005, 0.005, 0.02] {
        with_simulator(rigidformer_weights::EDGE, 64, |simulator| {
            simulator.set_dt(1.0 / 48.0).unwrap();
            let ids = [HALF_M - deep_m, 3.0 * HALF_M - deep_m + 0.01].map(|z| {
                let pose = Isometry3::translation(0.0, 0.0, z);
                simulator.add(&Unit::new(&cube(), WOOD), &pose, &pose).unwrap()
            });
            run(simulator, 1.0, 48);
            let rest = ids.map(|id| centre(simulator, id));
            let off = [rest[0].z - f64::from(HALF_M), rest[1].z - f64::from(3.0 * HALF_M)];
            assert!(off.iter().all(|off| off.abs() < 1e-3), "{deep_m}: {off:?}");
            run(simulator, 1.0, 48);
            assert_eq!(ids.map(|id| centre(simulator, id)), rest, "{deep_m}");
        });
    }
}

/// What is bonded comes out of the ground together.
#[test]
fn a_cluster_that_begins_in_the_ground_comes_out_and_rests() {
    with_simulator(rigidformer_weights::EDGE, 64, |simulator| {
        simulator.set_dt(1.0 / 48.0).unwrap();
        let ids = [0.0, 1.0, 2.0].map(|number: f32| {
            // The last one is deepest.
            let z = HALF_M - 0.004 * number;
            let pose = Isometry3::translation(2.0 * HALF_M * number, 0.0, z);
            simulator.add(&Unit::new(&cube(), WOOD).body(1), &pose, &pose).unwrap()
        });
        let between = |simulator: &Simulator<'_, '_>| {
            let poses = ids.map(|id| simulator.pose(id).unwrap());
            [1, 2].map(|number: usize| poses[0].inv_mul(&poses[number]))
        };
        simulator.bond(&[[ids[0], ids[1]], [ids[1], ids[2]]]).unwrap();
        let began = between(simulator);
        run(simulator, 1.0, 48);
        let rest = ids.map(|id| centre(simulator, id));
        let poses = ids.map(|id| simulator.pose(id).unwrap());
        let corners = cube();
        let heights = poses.iter().flat_map(|pose| corners.iter().map(move |c| (pose * c).z));
        let deepest = heights.fold(f32::INFINITY, f32::min);
        assert!(deepest.abs() < 1e-3, "{deepest} m, {rest:?}");
        for (now, began) in between(simulator).iter().zip(&began) {
            let off = (now.translation.vector - began.translation.vector).norm();
            let turned = now.rotation.angle_to(&began.rotation);
            assert!(off < 1e-4 && turned < 1e-3, "{off} m, {turned} rad");
        }
        run(simulator, 1.0, 48);
        assert_eq!(ids.map(|id| centre(simulator, id)), rest);
    });
}
