//! What mechanics says of single bodies, by the committed int8 models: stacks, ramps, balls. `docs/ACCURACY.md` has the table
//! that this prints:
//!
//! ```sh
//! cargo test --release -p rigidformer-tests contact:: -- --nocapture
//! ```
#![allow(missing_docs, clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use std::path::Path;

use nalgebra::{Isometry3, Point3, UnitQuaternion, Vector3};
use rigidformer_core::{Compliance, Limits, Physics, Plane, Unit, UnitId};
use rigidformer_runtime::models::LoadedModel;
use rigidformer_runtime::world::World;

const GRAVITY: f32 = 9.81;
/// Half an edge of the boxes and the balls' radius, metres.
const SIDE: f32 = 0.05;
const MODELS: [&str; 2] = ["edge-i8", "nano"];
const CODES: [f32; 3] = [1.0, 5.0, 10.0];

fn loaded(name: &str) -> LoadedModel {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join(format!("../weights/models/{name}.rfm"));
    LoadedModel::open(&path).unwrap()
}

/// Over planes, each with a friction of 1 and no bounce.
fn world(model: &LoadedModel, code: f32, planes: &[Vector3<f32>]) -> World {
    let mut world = World::new(model, Limits { units: 8, points: 1024 }).unwrap();
    let plane = |normal: &Vector3<f32>| Plane { normal: *normal, ..Plane::ground(1.0, 0.0) };
    let planes: Vec<_> = planes.iter().map(plane).collect();
    world.set_planes(&planes).unwrap();
    world.set_gravity(Vector3::new(0.0, 0.0, -GRAVITY)).unwrap();
    world.set_dt(code / 240.0).unwrap();
    world
}

fn run(world: &mut World, code: f32, seconds: f32) {
    for _ in 0..(seconds * 240.0 / code).round() as usize {
        world.step().unwrap();
    }
}

fn place(world: &World, id: UnitId) -> Vector3<f32> {
    world.pose(id).unwrap().translation.vector
}

/// The 26 outer points of a 3 x 3 x 3 grid.
fn cube() -> Vec<Point3<f32>> {
    let at = |k: usize| (k % 3) as f32 - 1.0;
    let grid = (0..27).filter(|k| *k != 13).map(|k| [at(k), at(k / 3), at(k / 9)]);
    grid.map(|point| Point3::from(point.map(|x| x * SIDE))).collect()
}

fn ball() -> Vec<Point3<f32>> {
    let point = |k: usize| {
        let z = 1.0 - (2 * k + 1) as f32 / 160.0;
        let (sine, cosine) = (k as f32 * 2.399_963).sin_cos();
        let across = (1.0 - z * z).sqrt();
        Point3::from([across * cosine, across * sine, z].map(|x| x * SIDE))
    };
    (0..160).map(point).collect()
}

fn made_of(friction: f32) -> Physics {
    Physics { mass_kg: 0.5, friction, restitution: 0.3 }
}

/// Prints a row and gives the worst of it.
fn row(what: &str, values: &[f32]) -> f32 {
    let numbers: Vec<_> = values.iter().map(|value| format!("{value:8.4}")).collect();
    println!("{what:60} {}", numbers.join(" "));
    values.iter().fold(0.0, |worst, value| worst.max(value.abs()))
}

fn each(model: &LoadedModel, measure: impl Fn(&LoadedModel, f32) -> f32) -> Vec<f32> {
    CODES.iter().map(|code| measure(model, *code)).collect()
}

#[test]
fn five_boxes_stand_for_ten_seconds() {
    for name in MODELS {
        let stack = |model: &LoadedModel, code: f32| {
            let mut world = world(model, code, &[Vector3::z()]);
            let (points, rubber) = (cube(), made_of(0.5));
            let ids: Vec<_> = (0..5)
                .map(|k| {
                    let aside = if k % 2 == 1 { 0.1 * SIDE } else { 0.0 };
                    let pose = Isometry3::translation(aside, 0.0, SIDE * (1 + 2 * k) as f32);
                    world.add(&Unit::new(&points, rubber), &pose).unwrap()
                })
                .collect();
            let began: Vec<_> = ids.iter().map(|id| place(&world, *id)).collect();
            run(&mut world, code, 9.0);
            let late: Vec<_> = ids.iter().map(|id| world.pose(*id)).collect();
            run(&mut world, code, 1.0);
            let last: Vec<_> = ids.iter().map(|id| world.pose(*id)).collect();
            assert_eq!(late, last, "{name}, code {code}: still in the last second");
            let moved =
                ids.iter().zip(began).map(|(id, began)| (place(&world, *id) - began).norm());
            moved.fold(0.0, f32::max) / SIDE
        };
        let moved = row(
            &format!("{name}: five boxes, moved in 10 s, half edges"),
            &each(&loaded(name), stack),
        );
        assert!(moved < 0.1, "{name}: {moved}");
    }
}

#[test]
fn a_box_on_a_ramp_stays_or_slides_as_friction_says() {
    let friction = 0.5_f32; // holds to 26.57 degrees
    for name in MODELS {
        for (degrees, speed) in [(15.0_f32, 0.0), (24.0, 0.0), (29.0, 1.0), (35.0, 1.0)] {
            let slide = |model: &LoadedModel, code: f32| {
                let (sine, cosine) = degrees.to_radians().sin_cos();
                let (normal, down) =
                    (Vector3::new(sine, 0.0, cosine), Vector3::new(cosine, 0.0, -sine));
                let mut world = world(model, code, &[normal]);
                let turn =
                    UnitQuaternion::from_axis_angle(&Vector3::y_axis(), degrees.to_radians());
                let pose = Isometry3::from_parts((normal * SIDE).into(), turn);
                let points = cube();
                let id = world.add(&Unit::new(&points, made_of(friction)), &pose).unwrap();
                let began = place(&world, id);
                run(&mut world, code, 2.0);
                let way = (place(&world, id) - began).dot(&down);
                let due = 0.5 * GRAVITY * (sine - friction * cosine) * 4.0;
                if speed > 0.0 { way / due - 1.0 } else { way / SIDE }
            };
            let what = if speed > 0.0 { "way over the law's, less 1" } else { "way in half edges" };
            let what = format!("{name}: ramp of {degrees} degrees, {what}");
            let worst = row(&what, &each(&loaded(name), slide));
            assert!(worst < if speed > 0.0 { 0.05 } else { 0.02 }, "{what}: {worst}");
        }
    }
}

#[test]
fn a_ball_rolls_on_and_down_and_comes_to_roll() {
    for name in MODELS {
        // (what, tilt of the ground in degrees, first speed m/s, first spin over that of rolling, way in 2 s)
        let slope = 0.5 * (5.0 / 7.0) * GRAVITY * 10.0_f32.to_radians().sin() * 4.0;
        // Slides for 2/7 v / (mu g), at 5/7 of the speed in the end.
        let time = 2.0 / 7.0 * 1.0 / (0.4 * GRAVITY);
        let comes = time * 6.0 / 7.0 + (2.0 - time) * 5.0 / 7.0;
        for (what, degrees, speed, spin, due) in [
            ("rolls on", 0.0_f32, 1.0, 1.0, 2.0),
            ("slides, then rolls", 0.0, 1.0, 0.0, comes),
            ("rolls down 10 degrees", 10.0, 0.0, 0.0, slope),
        ] {
            let roll = |model: &LoadedModel, code: f32| {
                let (sine, cosine) = degrees.to_radians().sin_cos();
                let (normal, down) =
                    (Vector3::new(sine, 0.0, cosine), Vector3::new(cosine, 0.0, -sine));
                let mut world = world(model, code, &[normal]);
                let points = ball();
                let pose =
                    Isometry3::from_parts((normal * SIDE).into(), UnitQuaternion::identity());
                let id = world.add(&Unit::new(&points, made_of(0.4)), &pose).unwrap();
                let turn = Vector3::new(0.0, spin * speed / SIDE, 0.0);
                world.set_velocity(id, &(down * speed), &turn).unwrap();
                let began = place(&world, id);
                run(&mut world, code, 2.0);
                (place(&world, id) - began).dot(&down) / due - 1.0
            };
            let what = format!("{name}: ball {what}, way over the law's, less 1");
            let worst = row(&what, &each(&loaded(name), roll));
            assert!(worst < 0.05, "{what}: {worst}");
        }
    }
}

/// In newtons and metres, whatever length and mass the model measures by.
#[test]
fn what_lies_on_springs_sinks_as_its_weight_says() {
    let model = LoadedModel::embedded("edge", rigidformer_weights::EDGE).unwrap();
    for (side, gravity) in [(0.05_f32, 9.81), (0.5, 9.81), (0.1, 1.6)] {
        let mass_kg = 1000.0 * side.powi(3);
        let sag = 0.005 * side;
        let compliance = Compliance {
            stiffness_n_m: mass_kg * gravity / (4.0 * sag),
            dissipation_s_m: 4.0 / (gravity * side).sqrt(),
        };
        let corner = |i: i32| [1, 2, 4].map(|bit| if i & bit == 0 { -0.5 } else { 0.5 } * side);
        let corners: Vec<_> = (0..8).map(|i| Point3::from(corner(i))).collect();
        let wood = Physics { mass_kg, friction: 0.5, restitution: 0.5 };
        let mut world = World::new(&model, Limits { units: 1, points: 8 }).unwrap();
        world.set_gravity(Vector3::new(0.0, 0.0, -gravity)).unwrap();
        world.set_planes(&[Plane::ground(1.0, 1.0)]).unwrap();
        world.set_dt(1.0 / 24.0).unwrap();
        let unit = Unit::new(&corners, wood).compliance(compliance);
        let cube = world.add(&unit, &Isometry3::translation(0.0, 0.0, 0.5 * side)).unwrap();
        for _ in 0..72 {
            world.step().unwrap();
        }
        let sunk = 0.5 * side - world.pose(cube).unwrap().translation.z;
        assert!((sunk / sag - 1.0).abs() < 0.1, "{side} {gravity}: {sunk} {sag}");
    }
}
