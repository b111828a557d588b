//! What driven and fixed units, bodies and planes do, with the trained model.
#![allow(missing_docs, clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use nalgebra::{Isometry3, Point3, Translation3, UnitQuaternion, Vector3};
use rigidformer_core::{EditError, Physics, Plane, Role, Simulator, Unit, UnitId};
use rigidformer_tests::with_simulator;

const DT_S: f32 = 10.0 / 240.0;
const WOOD: Physics = Physics { mass_kg: 1.0, friction: 0.4, restitution: 0.3 };
const HALF_M: f32 = 0.2;

/// The outer points of a grid of 4 x 4 x 4.
fn block(half: [f32; 3]) -> Vec<Point3<f32>> {
    let outer = |i: usize| i == 0 || i == 3;
    let cells = (0..64).map(|at| [at / 16, at / 4 % 4, at % 4]);
    let shell = cells.filter(|cell: &[usize; 3]| cell.iter().any(|i| outer(*i)));
    let place = |i: usize, half: f32| half * (i as f32 * 2.0 / 3.0 - 1.0);
    shell.map(|cell| Point3::from([0, 1, 2].map(|axis| place(cell[axis], half[axis])))).collect()
}

fn at(x: f32, y: f32, z: f32) -> Isometry3<f32> {
    Isometry3::translation(x, y, z)
}

fn with_scene<R>(body: impl FnOnce(&mut Simulator<'_, '_>) -> R) -> R {
    with_simulator(rigidformer_weights::EDGE, 16 * 56, |simulator| {
        simulator.set_dt(DT_S).unwrap();
        body(simulator)
    })
}

/// Adds a unit at rest.
fn add(simulator: &mut Simulator<'_, '_>, unit: Unit<'_>, pose: Isometry3<f32>) -> UnitId {
    simulator.add(&unit, &pose, &pose).unwrap()
}

/// Rotation and centre as bits.
fn bits(simulator: &Simulator<'_, '_>, id: UnitId) -> Vec<u32> {
    let pose = simulator.get(id).unwrap().internal_pose();
    pose.rotation.iter().chain(&pose.centre).map(|v| v.to_bits()).collect()
}

/// Height of the lowest point above a plane, metres.
fn lowest(simulator: &Simulator<'_, '_>, id: UnitId, plane: &Plane) -> f32 {
    let unit = simulator.get(id).unwrap();
    unit.points().map(|point| plane.height_m(&point.coords)).fold(f32::INFINITY, f32::min)
}

#[test]
fn driven_units_go_exactly_where_told_and_push() {
    let cube = block([HALF_M; 3]);
    let run = |pushes: bool| {
        with_scene(|simulator| {
            let free = add(simulator, Unit::new(&cube, WOOD), at(0.0, 0.0, HALF_M));
            let start = at(-0.5, 0.0, HALF_M);
            let hand = add(simulator, Unit::new(&cube, WOOD).role(Role::Driven), start);
            for step in 1..=16 {
                let speed = if pushes { 1.0 } else { -1.0 };
                let turn = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), 0.01 * step as f32);
                let place = Translation3::new(-0.5 + speed * DT_S * step as f32, 0.0, HALF_M);
                let target = Isometry3::from_parts(place, turn);
                simulator.drive(hand, &target).unwrap();
                simulator.step().unwrap();
                let reached = bits(simulator, hand);
                // What the same pose is where nothing but the caller says it.
                let alone = with_scene(|other| {
                    let id = add(other, Unit::new(&cube, WOOD).role(Role::Driven), target);
                    bits(other, id)
                });
                assert_eq!(reached, alone, "step {step}");
            }
            simulator.pose(free).unwrap().translation.x
        })
    };
    let (pushed, left) = (run(true), run(false));
    // The hand went 0.67 m, the last 0.57 m of it with the cube before it.
    assert!(pushed > 0.3, "{pushed}");
    assert!(left.abs() < 0.1, "{left}");
}

#[test]
fn fixed_units_never_move_to_the_bit() {
    let (cube, shelf) = (block([HALF_M; 3]), block([0.5, 0.5, 0.1]));
    let heavy = Physics { mass_kg: 100.0, ..WOOD };
    with_scene(|simulator| {
        let fixed = add(simulator, Unit::new(&shelf, WOOD).role(Role::Fixed), at(0.0, 0.0, 0.6));
        let falling = add(simulator, Unit::new(&cube, heavy), at(0.1, 0.0, 1.5));
        let side = Unit::new(&cube, heavy);
        let [far, near] = [at(-1.5, 0.0, 0.7), at(-1.3, 0.0, 0.7)];
        simulator.add(&side, &far, &near).unwrap();
        let before = bits(simulator, fixed);
        for step in 0..24 {
            simulator.step().unwrap();
            assert_eq!(before, bits(simulator, fixed), "step {step}");
        }
        let height = simulator.pose(falling).unwrap().translation.z;
        assert!(height > 0.5, "it fell through the shelf: {height} m");
        assert_eq!(
            simulator.drive(fixed, &at(0.0, 0.0, 1.0)),
            Err(EditError::NotDriven { id: fixed })
        );
    });
}

#[test]
fn parts_of_one_body_do_not_collide() {
    const STEPS: usize = 8;
    let (cube, shelf) = (block([HALF_M; 3]), block([0.5, 0.5, 0.1]));
    let height = |body: Option<u16>| {
        with_scene(|simulator| {
            let fixed = Unit { body, ..Unit::new(&shelf, WOOD).role(Role::Fixed) };
            add(simulator, fixed, at(0.0, 0.0, 1.2));
            let falling = Unit { body, ..Unit::new(&cube, WOOD) };
            let falling = add(simulator, falling, at(0.0, 0.0, 1.6));
            for _ in 0..STEPS {
                simulator.step().unwrap();
            }
            simulator.pose(falling).unwrap().translation.z
        })
    };
    // Free fall ends at 1.6 m less g t (t + dt) / 2, which is 0.63 m.
    let fallen = 1.6 - 5.0 * DT_S * DT_S * (STEPS * (STEPS + 1)) as f32;
    assert!((height(Some(3)) - fallen).abs() < 0.1, "one body: {} of {fallen} m", height(Some(3)));
    assert!(height(None) > fallen + 0.25, "two bodies: {} of {fallen} m", height(None));
}

#[test]
fn a_slope_carries_units_downhill() {
    let cube = block([HALF_M; 3]);
    let angle = 0.5_f32;
    let normal = Vector3::new(angle.sin(), 0.0, angle.cos());
    let slope = Plane { normal, ..Plane::ground(0.05, 0.3) };
    let lying = Isometry3::from_parts(
        Translation3::from(normal * (HALF_M + 0.01)),
        UnitQuaternion::from_axis_angle(&Vector3::y_axis(), angle),
    );
    with_scene(|simulator| {
        simulator.set_planes(&[slope]).unwrap();
        let smooth = Physics { friction: 0.05, ..WOOD };
        let id = add(simulator, Unit::new(&cube, smooth), lying);
        for step in 0..16 {
            simulator.step().unwrap();
            let height = lowest(simulator, id, &slope);
            assert!(height > -1e-3, "step {step}: {height} m");
        }
        // Without friction it were 0.5 g sin^2 t^2 along x, and so much down.
        let place = simulator.pose(id).unwrap().translation.vector;
        assert!(place.x > 0.15 && place.z < HALF_M, "{place}");
    });
}

#[test]
fn nothing_goes_through_a_wall() {
    let cube = block([HALF_M; 3]);
    let wall =
        Plane { normal: Vector3::new(-1.0, 0.0, 0.0), offset_m: -1.0, ..Plane::ground(0.3, 0.5) };
    with_scene(|simulator| {
        simulator.set_planes(&[Plane::ground(0.3, 0.5), wall]).unwrap();
        let [before, now] = [at(-0.2, 0.0, 1.0), at(0.0, 0.0, 1.0)];
        let id = simulator.add(&Unit::new(&cube, WOOD), &before, &now).unwrap();
        let mut most = f32::NEG_INFINITY;
        for step in 0..16 {
            simulator.step().unwrap();
            for plane in simulator.planes() {
                let height = lowest(simulator, id, plane);
                assert!(height > -1e-3, "step {step}: {height} m");
            }
            most = most.max(simulator.pose(id).unwrap().translation.x);
        }
        let after = simulator.pose(id).unwrap().translation.x;
        assert!(most > 0.5, "it reached the wall: {most} m");
        assert!(after < most - 0.05, "it came back: {after} of {most} m");
    });
}
