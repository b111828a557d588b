//! Joints with axes, limits and targets, by impulses alone, against closed forms.
#![allow(missing_docs, clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use nalgebra::{Isometry3, Point3, UnitQuaternion, Vector3};
use rigidformer_core::{
    JoinError, Joint, JointAxis, JointKind, Limits, NoTrace, Physics, Portable, Role, Serial,
    Simulator, Unit, UnitId, Velocity,
};
use rigidformer_runtime::engine::Engine;
use rigidformer_runtime::kernels::Kernel;
use rigidformer_runtime::models::LoadedModel;
use rigidformer_runtime::world::World;
use rigidformer_tests::{packed_model, with_simulator};

const G: f64 = 9.81;
const WOOD: Physics = Physics { mass_kg: 1.0, friction: 0.5, restitution: 0.0 };

fn at(x: f32, y: f32, z: f32) -> Isometry3<f32> {
    Isometry3::translation(x, y, z)
}

/// The corners of a box of these half sides.
fn cuboid(x: f32, y: f32, z: f32) -> Vec<Point3<f32>> {
    let side = |i: i32, bit, half: f32| if i & bit == 0 { -half } else { half };
    (0..8).map(|i| Point3::new(side(i, 1, x), side(i, 2, y), side(i, 4, z))).collect()
}

/// Impulses alone, in steps of so many seconds, without ground.
fn scene<R>(dt_s: f32, body: impl FnOnce(&mut Simulator<'_, '_>) -> R) -> R {
    with_simulator(rigidformer_weights::EDGE, 16 * 8, |simulator| {
        simulator.set_dt(dt_s).unwrap();
        simulator.set_network(false);
        simulator.set_planes(&[]).unwrap();
        simulator.set_gravity(Vector3::new(0.0, 0.0, -G as f32)).unwrap();
        body(simulator)
    })
}

/// A link: a box of so many kg about a place, turned by a pose.
struct Link {
    half: [f32; 3],
    mass: f32,
    pose: Isometry3<f32>,
    role: Role,
}

fn add(simulator: &mut Simulator<'_, '_>, link: &Link) -> UnitId {
    let [x, y, z] = link.half;
    let points = cuboid(x, y, z);
    let unit = Unit::new(&points, Physics { mass_kg: link.mass, ..WOOD });
    let moment = |a: f32, b: f32| link.mass * (a * a + b * b) / 3.0;
    let unit = unit.inertia([moment(y, z), moment(x, z), moment(x, y)]);
    simulator.add(&unit.role(link.role).body(1), &link.pose, &link.pose).unwrap()
}

fn rod(mass: f32, pose: Isometry3<f32>) -> Link {
    Link { half: [0.25, 0.03, 0.03], mass, pose, role: Role::Free }
}

fn post(pose: Isometry3<f32>) -> Link {
    Link { half: [0.05; 3], mass: 1.0, pose, role: Role::Fixed }
}

/// Kinetic and potential energy of rods, J.
fn energy(simulator: &Simulator<'_, '_>) -> f64 {
    let free = simulator.units().filter(|unit| unit.role() == Role::Free);
    free.map(|unit| {
        let (pose, velocity) = (unit.pose(), simulator.velocity(unit.id()).unwrap());
        let mass = f64::from(unit.physics().mass_kg);
        let spin = pose.rotation.inverse() * velocity.angular_rad_s;
        let [x, y, z] = [[0.03, 0.03], [0.25, 0.03], [0.25, 0.03]]
            .map(|[a, b]: [f64; 2]| mass * (a * a + b * b) / 3.0);
        let turning = x * f64::from(spin.x).powi(2)
            + y * f64::from(spin.y).powi(2)
            + z * f64::from(spin.z).powi(2);
        let speed = velocity.linear_m_s.cast::<f64>().norm_squared();
        let gravity = f64::from(simulator.gravity_m_s2().z);
        0.5 * (mass * speed + turning) - mass * gravity * f64::from(pose.translation.z)
    })
    .sum()
}

/// The largest distance of the two images of a pivot.
fn apart(simulator: &Simulator<'_, '_>) -> f32 {
    let distance = |joint: Joint| {
        let own = simulator.pose(joint.unit).unwrap() * joint.pivot;
        (own - simulator.pose(joint.parent).unwrap() * joint.parent_pivot).norm()
    };
    simulator.joints().map(distance).fold(0.0, f32::max)
}

fn hinge(unit: UnitId, parent: UnitId, pivots: [[f32; 3]; 2], axis: JointKind) -> Joint {
    let [own, parents] = pivots.map(Point3::from);
    Joint::ball(unit, parent, own, parents).kind(axis)
}

fn revolute(axis: Vector3<f32>) -> JointKind {
    JointKind::Revolute(JointAxis::new(axis))
}

/// A rod that hangs from a post, from an angle below the horizontal on, about y.
fn pendulum(simulator: &mut Simulator<'_, '_>, angle: f32) -> UnitId {
    let post = add(simulator, &post(at(0.0, 0.0, 2.0)));
    let turn = UnitQuaternion::from_axis_angle(&Vector3::y_axis(), angle);
    let pose =
        at(0.0, 0.0, 2.0) * Isometry3::from_parts(Default::default(), turn) * at(0.25, 0.0, 0.0);
    let unit = add(simulator, &rod(1.0, pose));
    let joint = hinge(unit, post, [[-0.25, 0.0, 0.0], [0.0; 3]], revolute(Vector3::y()));
    simulator.join(&joint).unwrap();
    unit
}

/// Moment about the end of the rod, over mass, g and the lever: a pendulum's length.
fn length() -> f64 {
    let (half, width) = (0.25_f64, 0.03_f64);
    ((half * half + width * width) / 3.0 + half * half) / half
}

#[test]
fn a_pendulum_swings_in_its_period() {
    for dt in [1.0 / 30.0, 1.0 / 60.0, 1.0 / 240.0] {
        scene(dt, |simulator| {
            let start = 0.05;
            let unit = pendulum(simulator, std::f32::consts::FRAC_PI_2 - start);
            let frequency = (G / length()).sqrt() * (1.0 - f64::from(start).powi(2) / 16.0);
            let mut worst = 0.0_f64;
            for step in 1..=(2.0 / dt) as u32 {
                simulator.step().unwrap();
                let time = f64::from(step) * f64::from(dt);
                let angle = f64::from(simulator.joint_position(unit).unwrap());
                let wanted = f64::from(start) - f64::from(start) * (frequency * time).cos();
                worst = worst.max((angle - wanted).abs());
            }
            println!("dt {dt}: worst angle {worst:.2e} rad of {start}");
            // A period off by 0.1 % shows as 0.05 * 2 pi * 1.7 swings * 0.1 %.
            assert!(worst < 5e-4, "{worst}");
        });
    }
}

#[test]
fn energy_and_pivots_hold() {
    for dt in [1.0 / 30.0, 1.0 / 60.0] {
        for links in [1, 2, 4, 12] {
            for ball in [false, true] {
                scene(dt, |simulator| {
                    let mut above = add(simulator, &post(at(0.0, 0.0, 2.0)));
                    let mut pivot = [0.0; 3];
                    for link in 0..links {
                        let place = at(0.25 + 0.5 * link as f32, 0.0, 2.0);
                        let unit = add(simulator, &rod(1.0, place));
                        let kind = if ball { JointKind::Ball } else { revolute(Vector3::y()) };
                        let joint = hinge(unit, above, [[-0.25, 0.0, 0.0], pivot], kind);
                        simulator.join(&joint).unwrap();
                        (above, pivot) = (unit, [0.25, 0.0, 0.0]);
                    }
                    let start = energy(simulator);
                    // What a link's fall turns over.
                    let scale = G * 0.25 * f64::from(links) * f64::from(links);
                    let (mut drift, mut gap) = (0.0_f64, 0.0_f32);
                    let clock = std::time::Instant::now();
                    for _ in 0..(2.0 / dt) as u32 {
                        simulator.step().unwrap();
                        drift = drift.max((energy(simulator) - start).abs() / scale);
                        gap = gap.max(apart(simulator));
                    }
                    let ms = clock.elapsed().as_secs_f64() * 1e3 / f64::from((2.0 / dt) as u32);
                    println!(
                        "dt {dt:.4} links {links} ball {ball}: drift {:.4} % gap {gap:.1e} m, {ms:.2} ms a step",
                        drift * 100.0
                    );
                    assert!(drift < 0.01 && gap < 1e-4);
                });
            }
        }
    }
}

/// A slider on a rail that leans: g sin a along it, and it stops at its end.
#[test]
fn a_slider_runs_down_its_rail_and_stops_at_a_limit() {
    scene(1.0 / 30.0, |simulator| {
        let rail = add(simulator, &post(at(0.0, 0.0, 2.0)));
        let unit = add(simulator, &rod(2.0, at(0.5, 0.0, 2.0)));
        let angle = 0.4_f32;
        let axis = Vector3::new(angle.cos(), 0.0, -angle.sin());
        let kind = JointKind::Prismatic(JointAxis::new(axis).limits(-0.1, 1.0));
        simulator.join(&hinge(unit, rail, [[0.0; 3], [0.5, 0.0, 0.0]], kind)).unwrap();
        let mut last = 0.0;
        for step in 1..=60 {
            simulator.step().unwrap();
            let time = f64::from(step) / 30.0;
            let free = 0.5 * G * f64::from(angle).sin() * time * time;
            let place = f64::from(simulator.joint_position(unit).unwrap());
            assert!((place - free.min(1.0)).abs() < 1e-4, "{step}: {place} {free}");
            let pose = simulator.pose(unit).unwrap();
            let there = at(0.5, 0.0, 2.0).translation.vector + axis * place as f32;
            assert!((pose.translation.vector - there).norm() < 1e-5);
            assert!(pose.rotation.angle() < 1e-5);
            last = place;
        }
        assert!((last - 1.0).abs() < 1e-5, "{last}");
        assert!(simulator.velocity(unit).unwrap().linear_m_s.norm() < 1e-4);
    });
}

/// A pendulum that falls onto its limit stays there, and leaves it when gravity turns.
#[test]
fn a_limit_stops_and_lets_go() {
    scene(1.0 / 60.0, |simulator| {
        let post = add(simulator, &post(at(0.0, 0.0, 2.0)));
        let unit = add(simulator, &rod(1.0, at(0.25, 0.0, 2.0)));
        let kind = JointKind::Revolute(JointAxis::new(Vector3::y()).limits(-0.5, 0.7));
        simulator.join(&hinge(unit, post, [[-0.25, 0.0, 0.0], [0.0; 3]], kind)).unwrap();
        for step in 0..60 {
            simulator.step().unwrap();
            let angle = simulator.joint_position(unit).unwrap();
            assert!(angle < 0.7 + 1e-4 && (step < 40 || angle > 0.7 - 1e-4), "{step} {angle}");
        }
        simulator.set_gravity(Vector3::new(0.0, 0.0, G as f32)).unwrap();
        for step in 0..90 {
            simulator.step().unwrap();
            let angle = simulator.joint_position(unit).unwrap();
            assert!(angle > -0.5 - 1e-4 && (step < 60 || angle < -0.5 + 1e-4), "{step} {angle}");
        }
    });
}

/// What is welded falls and spins as one body.
#[test]
fn a_weld_keeps_the_relative_pose() {
    scene(1.0 / 30.0, |simulator| {
        simulator.set_gravity(Vector3::zeros()).unwrap();
        let one = add(simulator, &rod(1.0, at(0.0, 0.0, 5.0)));
        let turn = UnitQuaternion::from_euler_angles(0.3, -0.5, 1.0);
        let place = Isometry3::from_parts(at(0.3, 0.2, 5.1).translation, turn);
        let two = add(simulator, &rod(3.0, place));
        let before = simulator.pose(one).unwrap().inverse() * simulator.pose(two).unwrap();
        let pivot = Point3::from(before.translation.vector);
        let joint = Joint::ball(two, one, Point3::origin(), pivot).kind(JointKind::Fixed);
        simulator.join(&joint).unwrap();
        let start = energy(simulator);
        let spin = Velocity { angular_rad_s: Vector3::new(3.0, -2.0, 5.0), ..Velocity::default() };
        simulator.set_velocity(one, &spin).unwrap();
        simulator.step().unwrap();
        let spun = energy(simulator);
        assert!(spun > start + 0.01);
        for _ in 0..60 {
            simulator.step().unwrap();
            let now = simulator.pose(one).unwrap().inverse() * simulator.pose(two).unwrap();
            assert!((now.translation.vector - before.translation.vector).norm() < 2e-6);
            assert!(now.rotation.angle_to(&before.rotation) < 2e-5);
        }
        let drift = (energy(simulator) - spun).abs() / (spun - start);
        println!("weld: energy of the spin drifts by {:.4} %", drift * 100.0);
        assert!(drift < 0.01, "{drift}");
    });
}

/// Targets are where the joint is at the end of the step; with little force it comes later, and does not overshoot.
#[test]
fn targets_are_reached() {
    for dt in [1.0 / 30.0, 1.0 / 240.0] {
        scene(dt, |simulator| {
            let unit = pendulum(simulator, 0.0);
            let start = simulator.joint_position(unit).unwrap();
            for step in 1..=40 {
                let target = start + 1.2 * (0.3 * step as f32).sin();
                simulator.set_joint_target(unit, Some(target)).unwrap();
                simulator.step().unwrap();
                let error = simulator.joint_position(unit).unwrap() - target;
                assert!(error.abs() < 1e-5 && apart(simulator) < 1e-6, "{step} {error}");
            }
            assert!(simulator.joint_target(unit).is_some());
            // Held still, it stays.
            for _ in 0..30 {
                simulator.step().unwrap();
            }
            assert!(simulator.velocity(unit).unwrap().angular_rad_s.norm() < 1e-4);
            // Let go, it swings.
            simulator.set_joint_target(unit, None).unwrap();
            for _ in 0..10 {
                simulator.step().unwrap();
            }
            assert!(simulator.velocity(unit).unwrap().angular_rad_s.norm() > 1e-2);
        });
    }
    // Gravity asks for 2.45 N m at the most.
    for (most, reaches) in [(5.0, true), (3.0, true), (1.0, false)] {
        scene(1.0 / 60.0, |simulator| {
            let post = add(simulator, &post(at(0.0, 0.0, 2.0)));
            let unit = add(simulator, &rod(1.0, at(0.25, 0.0, 2.0)));
            let axis = JointAxis::new(Vector3::y()).max_force(most);
            let kind = JointKind::Revolute(axis);
            simulator.join(&hinge(unit, post, [[-0.25, 0.0, 0.0], [0.0; 3]], kind)).unwrap();
            simulator.set_joint_target(unit, Some(-0.8)).unwrap();
            let mut least = 0.0_f32;
            for _ in 0..240 {
                simulator.step().unwrap();
                least = least.min(simulator.joint_position(unit).unwrap());
            }
            let end = simulator.joint_position(unit).unwrap();
            println!("most {most} N m: least {least}, end {end}");
            assert_eq!((end + 0.8).abs() < 1e-3, reaches, "{end}");
            assert!(least > -0.85, "{least}");
        });
    }
}

/// A hinged lid falls on the ground, and lies there.
#[test]
fn a_box_on_a_hinge_lands() {
    for dt in [1.0 / 30.0, 1.0 / 60.0] {
        with_simulator(rigidformer_weights::EDGE, 64, |simulator| {
            simulator.set_dt(dt).unwrap();
            simulator.set_network(false);
            let post = add(simulator, &post(at(0.0, 0.0, 0.2)));
            let mut lid = rod(1.0, at(0.2, 0.0, 0.25));
            lid.half = [0.2, 0.1, 0.05];
            let lid = add(simulator, &lid);
            let joint =
                hinge(lid, post, [[-0.2, 0.0, 0.0], [0.0, 0.0, 0.05]], revolute(Vector3::y()));
            simulator.join(&joint).unwrap();
            let mut lowest = 1.0_f32;
            let mut last = 0.0_f32;
            for step in 0..(3.0 / dt) as u32 {
                simulator.step().unwrap();
                let pose = simulator.pose(lid).unwrap();
                let corners = cuboid(0.2, 0.1, 0.05);
                let low = corners.iter().map(|p| (pose * p).z).fold(f32::MAX, f32::min);
                lowest = lowest.min(low);
                let angle = simulator.joint_position(lid).unwrap();
                if step as f32 * dt > 2.5 {
                    assert!((angle - last).abs() < 1e-4, "{angle} {last}");
                }
                last = angle;
                assert!(apart(simulator) < 1e-5);
            }
            let pose = simulator.pose(lid).unwrap();
            let low = cuboid(0.2, 0.1, 0.05).iter().map(|p| (pose * p).z).fold(f32::MAX, f32::min);
            println!("lid: lowest {lowest} m, at the end {low} m, angle {last}");
            assert!(lowest > -2e-3 && low.abs() < 1e-3, "{lowest} {low}");
        });
    }
}

/// A chain of all kinds that falls on the ground, with a target and limits.
fn of_all_kinds(simulator: &mut Simulator<'_, '_>) -> Vec<UnitId> {
    let place = |x: f32| at(x, 0.0, 0.4);
    let ids: Vec<_> =
        (0..6).map(|k| add(simulator, &rod(1.0 + k as f32, place(0.5 * k as f32)))).collect();
    let limited = JointAxis::new(Vector3::new(0.0, 3.0, 0.0)).limits(-0.3, 0.4);
    let kinds = [
        JointKind::Ball,
        JointKind::Revolute(limited),
        JointKind::Prismatic(JointAxis::new(Vector3::x()).limits(-0.1, 0.1).max_force(300.0)),
        JointKind::Fixed,
        JointKind::Revolute(JointAxis::new(Vector3::new(0.1, 1.0, 0.0)).max_force(40.0)),
    ];
    for (pair, kind) in ids.windows(2).zip(kinds) {
        let pivots = [[-0.25, 0.0, 0.0], [0.25, 0.0, 0.0]];
        simulator.join(&hinge(pair[1], pair[0], pivots, kind)).unwrap();
    }
    simulator.set_joint_target(ids[5], Some(-0.6)).unwrap();
    simulator.set_joint_target(ids[3], Some(0.05)).unwrap();
    ids
}

fn bits(simulator: &Simulator<'_, '_>) -> Vec<u32> {
    let units = simulator.units().flat_map(|unit| {
        let (pose, moved) = (unit.internal_pose(), simulator.velocity(unit.id()).unwrap());
        let numbers = pose.rotation.iter().chain(&pose.centre).copied();
        numbers.chain(moved.linear_m_s.iter().copied()).collect::<Vec<_>>()
    });
    units.map(f32::to_bits).collect()
}

#[test]
fn all_kinds_hold_on_the_ground() {
    for network in [false, true] {
        with_simulator(rigidformer_weights::EDGE, 16 * 8, |simulator| {
            simulator.set_dt(1.0 / 30.0).unwrap();
            simulator.set_network(network);
            let ids = of_all_kinds(simulator);
            let weld = simulator.pose(ids[3]).unwrap().inverse() * simulator.pose(ids[4]).unwrap();
            let [mut gap, mut low] = [0.0_f32; 2];
            for _ in 0..90 {
                simulator.step().unwrap();
                // Slides are no gaps.
                for joint in simulator.joints().filter(|joint| joint.unit != ids[3]) {
                    let own = simulator.pose(joint.unit).unwrap() * joint.pivot;
                    let parents = simulator.pose(joint.parent).unwrap() * joint.parent_pivot;
                    gap = gap.max((own - parents).norm());
                }
                for unit in simulator.units() {
                    let corners = cuboid(0.25, 0.03, 0.03);
                    low = corners.iter().map(|p| (unit.pose() * p).z).fold(low, f32::min);
                }
                let angle = simulator.joint_position(ids[2]).unwrap();
                assert!(angle > -0.3 - 2e-3 && angle < 0.4 + 2e-3, "{angle}");
            }
            let now = simulator.pose(ids[3]).unwrap().inverse() * simulator.pose(ids[4]).unwrap();
            let slide = simulator.joint_position(ids[3]).unwrap();
            let angle = simulator.joint_position(ids[5]).unwrap();
            println!("network {network}: gap {gap:.1e} low {low:.1e} slide {slide} angle {angle}");
            assert!(gap < 1e-4 && low > -5e-3, "{gap} {low}");
            assert!((now.translation.vector - weld.translation.vector).norm() < 1e-4);
            assert!(now.rotation.angle_to(&weld.rotation) < 1e-3);
            assert!((slide - 0.05).abs() < 1e-3 && (angle + 0.6).abs() < 0.02);
        });
    }
}

#[test]
fn snapshots_keep_joints() {
    with_simulator(rigidformer_weights::EDGE, 16 * 8, |simulator| {
        simulator.set_dt(1.0 / 30.0).unwrap();
        simulator.set_network(false);
        of_all_kinds(simulator);
        (0..10).for_each(|_| assert!(simulator.step().is_ok()));
        let mut state = vec![0; simulator.snapshot_bytes()];
        simulator.snapshot(&mut state).unwrap();
        let joints: Vec<_> = simulator.joints().collect();
        let go_on = |simulator: &mut Simulator<'_, '_>| {
            (0..20).for_each(|_| assert!(simulator.step().is_ok()));
            bits(simulator)
        };
        let wanted = go_on(simulator);
        with_simulator(rigidformer_weights::EDGE, 16 * 8, |other| {
            other.restore(&state).unwrap();
            assert_eq!(other.joints().collect::<Vec<_>>(), joints);
            let mut again = vec![0; other.snapshot_bytes()];
            other.snapshot(&mut again).unwrap();
            assert_eq!(again, state);
            assert_eq!(go_on(other), wanted);
        });
        // Targets are a copy's own.
        simulator.restore_copy(0, &state).unwrap();
        assert_eq!(go_on(simulator), wanted);
        state.truncate(state.len() - 4);
        assert!(simulator.restore(&state).is_err());
        assert_eq!(bits(simulator), wanted);
    });
}

#[test]
fn joints_that_cannot_be_are_refused() {
    scene(1.0 / 30.0, |simulator| {
        let [one, two] = [0.0, 0.5].map(|x| add(simulator, &rod(1.0, at(x, 0.0, 1.0))));
        let ball = hinge(two, one, [[-0.25, 0.0, 0.0], [0.25, 0.0, 0.0]], JointKind::Ball);
        let id = two;
        for axis in [Vector3::zeros(), Vector3::new(0.0, f32::NAN, 1.0), Vector3::x() / 0.0] {
            let bad = ball.kind(revolute(axis));
            assert_eq!(simulator.join(&bad), Err(JoinError::BadAxis { id }), "{axis}");
        }
        let axis = JointAxis::new(Vector3::y());
        for [least, most] in [[1.0, -1.0], [-4.0, 0.0], [f32::NAN, 1.0], [0.0, f32::INFINITY]] {
            let bad = ball.kind(JointKind::Revolute(axis.limits(least, most)));
            assert_eq!(simulator.join(&bad), Err(JoinError::BadLimits { id }), "{least} {most}");
        }
        for force in [0.0, -1.0, f32::NAN, f32::INFINITY] {
            let bad = ball.kind(JointKind::Prismatic(axis.max_force(force)));
            assert_eq!(simulator.join(&bad), Err(JoinError::BadForce { id }), "{force}");
        }
        let nothing = UnitQuaternion::new_unchecked(nalgebra::Quaternion::new(0.0, 0.0, 0.0, 0.0));
        let bad = Joint { rest: Some(nothing), ..ball.kind(JointKind::Fixed) };
        assert_eq!(simulator.join(&bad), Err(JoinError::BadRest { id }));
        assert_eq!(simulator.joints().count(), 0);
        assert_eq!(simulator.set_joint_target(id, Some(0.1)), Err(JoinError::NoAxis { id }));
        // Of any length: tiny, and beyond what f32 square.
        for size in [1e-30, 1e30] {
            simulator.join(&ball.kind(revolute(Vector3::new(0.0, size, 0.0)))).unwrap();
            let joint = simulator.joints().next().unwrap();
            assert_eq!(joint.kind.axis().map(|axis| axis.axis), Some(Vector3::y()));
        }
        for target in [f32::NAN, f32::INFINITY, 2e6] {
            let refused = simulator.set_joint_target(id, Some(target));
            assert_eq!(refused, Err(JoinError::BadTarget { id }));
        }
        assert_eq!((simulator.joint_target(id), simulator.joint_position(one)), (None, None));
        let circle = simulator.join(&hinge(one, two, [[0.0; 3]; 2], JointKind::Fixed));
        assert_eq!(circle, Err(JoinError::Circle { id: one, parent: two }));
    });
    with_simulator(&packed_model("tiny-similar"), 16, |simulator| {
        simulator.set_dt(1.0 / 24.0).unwrap();
        let [one, two] = [0.0, 0.5].map(|x| add(simulator, &rod(1.0, at(x, 0.0, 1.0))));
        let joint = hinge(two, one, [[-0.25, 0.0, 0.0], [0.25, 0.0, 0.0]], JointKind::Fixed);
        assert_eq!(simulator.join(&joint), Err(JoinError::NotByImpulses { id: two }));
        simulator.join(&joint.kind(JointKind::Ball)).unwrap();
    });
}

#[test]
fn bits_are_the_same_for_kernels_threads_and_copies() {
    let model = LoadedModel::embedded("edge", rigidformer_weights::EDGE).unwrap();
    let alone = with_simulator(rigidformer_weights::EDGE, 16 * 8, |simulator| {
        simulator.set_dt(1.0 / 30.0).unwrap();
        simulator.set_network(false);
        of_all_kinds(simulator);
        for _ in 0..30 {
            simulator.step_on(Serial(Portable), &mut NoTrace).unwrap();
        }
        bits(simulator)
    });
    for threads in [1, 2] {
        for kernel in [Kernel::Portable, Kernel::chosen().unwrap()] {
            let engine = Engine { kernel, ..Engine::new().unwrap() };
            let engine = if threads == 1 { engine.single() } else { engine };
            let copies = 3;
            let limits = Limits { units: 6, points: 48 };
            let mut world = World::on(engine, &model, limits, copies).unwrap();
            world.edit(|simulator| {
                simulator.set_dt(1.0 / 30.0).unwrap();
                simulator.set_network(false);
                of_all_kinds(simulator);
                assert_eq!(simulator.replicate(copies), copies);
            });
            for _ in 0..30 {
                world.step_copies(&mut |_, outcome| assert!(outcome.is_ok())).unwrap();
            }
            for unit in 0..copies * 6 {
                let pose = world.simulator().unit(unit).unwrap().internal_pose();
                let numbers = pose.rotation.iter().chain(&pose.centre);
                let pose: Vec<_> = numbers.map(|v| v.to_bits()).collect();
                let wanted = &alone[unit % 6 * 15..][..12];
                assert_eq!(pose, wanted, "{kernel:?} {threads} {unit}");
            }
        }
    }
}

/// A pendulum whose pivot goes along at a steady speed swings as at rest, Galileo says.
#[test]
fn a_driven_pivot_carries_its_pendulum() {
    let run = |speed: f32| {
        scene(1.0 / 30.0, |simulator| {
            let held = post(at(0.0, 0.0, 2.0));
            let pivot = add(simulator, &Link { role: Role::Driven, ..held });
            let unit = add(simulator, &rod(1.0, at(0.25, 0.0, 2.0)));
            let motion =
                Velocity { linear_m_s: Vector3::new(speed, 0.0, 0.0), ..Velocity::default() };
            simulator.set_velocity(unit, &motion).unwrap();
            let joint = hinge(unit, pivot, [[-0.25, 0.0, 0.0], [0.0; 3]], revolute(Vector3::y()));
            simulator.join(&joint).unwrap();
            let step = |number| {
                let place = at(speed * number as f32 / 30.0, 0.0, 2.0);
                simulator.drive(pivot, &place).unwrap();
                simulator.step().unwrap();
                simulator.joint_position(unit).unwrap()
            };
            (1..=60).map(step).collect::<Vec<_>>()
        })
    };
    let (rest, moving) = (run(0.0), run(2.0));
    let off = rest.iter().zip(&moving).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
    assert!(off < 1e-4, "{off}");
}

/// Long chains, heavy ends, far away, and what cannot be met.
#[test]
fn hard_cases_hold() {
    for (links, heavy, ball) in [
        (14, 1.0, false),
        (14, 1000.0, false),
        (3, 1000.0, true),
        (14, 1000.0, true),
        (4, 0.001, true),
    ] {
        scene(1.0 / 60.0, |simulator| {
            let mut above = add(simulator, &post(at(1000.0, 0.0, 2.0)));
            let mut pivot = [0.0; 3];
            for link in 0..links {
                let mass = if link + 1 == links { heavy } else { 1.0 };
                let unit = add(simulator, &rod(mass, at(1000.25 + 0.5 * link as f32, 0.0, 2.0)));
                let axis = if link % 2 == 0 { Vector3::y() } else { Vector3::z() };
                let kind = if ball { JointKind::Ball } else { revolute(axis) };
                let joint = hinge(unit, above, [[-0.25, 0.0, 0.0], pivot], kind);
                simulator.join(&joint).unwrap();
                (above, pivot) = (unit, [0.25, 0.0, 0.0]);
            }
            let start = energy(simulator);
            for _ in 0..120 {
                simulator.step().unwrap();
            }
            let scale = (heavy + links as f32) * G as f32 * 0.5 * links as f32;
            let drift = (energy(simulator) - start).abs() / f64::from(scale);
            assert!(drift < 0.01, "{links} {heavy}: {drift}");
            // A coordinate of 1,000 m has digits of 0.06 mm.
            assert!(apart(simulator) < 2e-4, "{links} {heavy}: {}", apart(simulator));
        });
    }
    scene(1.0 / 60.0, |simulator| {
        let ids = [0.0, 0.25, 0.7].map(|x| {
            let held = Link { role: Role::Fixed, ..rod(1.0, at(x, 0.0, 2.0)) };
            let free = rod(1.0, at(x, 0.0, 2.0));
            add(simulator, if x == 0.25 { &free } else { &held })
        });
        let ball = JointKind::Ball;
        simulator.join(&hinge(ids[1], ids[0], [[-0.25, 0.0, 0.0], [0.0; 3]], ball)).unwrap();
        simulator.join(&hinge(ids[2], ids[1], [[0.0; 3], [0.25, 0.0, 0.0]], ball)).unwrap();
        for _ in 0..120 {
            simulator.step().unwrap();
            let speed = simulator.velocity(ids[1]).unwrap().linear_m_s.norm();
            assert!(speed < 5.0 && (0.15..1.3).contains(&apart(simulator)), "{speed}");
        }
    });
}
