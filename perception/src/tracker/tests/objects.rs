//! Objects whose mesh is known.

use nalgebra::Matrix3;

use super::*;
use crate::known::{KnownObject, ObjectMesh};

const HALF: [f32; 3] = [0.06, 0.05, 0.04];

/// A box of half a kilogram.
fn boxed(name: &str, half: [f32; 3]) -> KnownObject {
    let points: Vec<Point3<f32>> = (0..8)
        .map(|k| {
            Point3::from([0, 1, 2].map(|at| if k >> at & 1 == 0 { -half[at] } else { half[at] }))
        })
        .collect();
    let quads =
        [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]];
    let triangles: Vec<[u32; 3]> =
        quads.iter().flat_map(|[a, b, c, d]| [[*a, *b, *c], [*a, *c, *d]]).collect();
    let square = half.map(|half| f64::from(half * half));
    let moments = [square[1] + square[2], square[0] + square[2], square[0] + square[1]];
    let inertia_kg_m2 = Matrix3::from_diagonal(&(Vector3::from(moments) * (0.5 / 3.0)));
    object(name, &points, &triangles, inertia_kg_m2)
}

fn object(
    name: &str,
    points: &[Point3<f32>],
    triangles: &[[u32; 3]],
    inertia_kg_m2: Matrix3<f64>,
) -> KnownObject {
    let mesh = ObjectMesh {
        name,
        points,
        triangles,
        pieces: &[],
        mass_kg: 0.5,
        centre_m: Point3::origin(),
        inertia_kg_m2,
    };
    KnownObject::new(&mesh).unwrap()
}

/// The box that is thrown.
fn brick() -> KnownObject {
    boxed("brick", HALF)
}

fn with_brick() -> TrackerOptions {
    TrackerOptions { objects: vec![brick()], ..TrackerOptions::default() }
}

/// How far the corners of an estimated box are from those of the true one, whichever of its turns on itself it has.
fn corners_off_m(found: &UnitEstimate, truth: &Isometry3<f32>, half: [f32; 3]) -> f32 {
    let corner = |pose: &Isometry3<f32>, signs: [f32; 3]| {
        pose * Point3::from([0, 1, 2].map(|at| half[at] * signs[at]))
    };
    let signs = (0..8).map(|k| [0, 1, 2].map(|at| if k >> at & 1 == 0 { -1.0 } else { 1.0 }));
    let off = signs.clone().map(|own| {
        let own = corner(&found.pose, own);
        let others = signs.clone().map(|other| (corner(truth, other) - own).norm());
        others.fold(f32::MAX, f32::min)
    });
    off.fold(0.0, f32::max)
}

#[test]
fn a_known_box_is_found_and_followed_with_its_hidden_sides() {
    // One camera sees a side or two of it in 50 x 50 pixels.
    for (eyes, most_m) in [(&EYES[..1], 0.009), (&EYES[..], 0.004)] {
        let (tracker, estimates) = follow(with_brick(), eyes, 12, thrown);
        let id =
            estimates.last().unwrap().units.iter().find(|unit| tracker.object(unit.id).is_some());
        let id = id.expect("the box is known").id;
        assert_eq!(tracker.physics(id).unwrap().mass_kg, 0.5);
        assert_eq!(tracker.object(id).unwrap().name(), "brick");
        for (frame, estimate) in estimates.iter().enumerate().skip(3) {
            let found = estimate.units.iter().find(|unit| unit.id == id).unwrap();
            let (_, truth) = thrown(frame as f32 / 30.0)[0];
            let off = corners_off_m(found, &truth, HALF);
            assert!(off < most_m, "{frame} of {} cameras: {off}", eyes.len());
        }
        let corners = tracker.shape(id).unwrap().iter().map(|point| point.coords.abs());
        let most = corners.fold(Vector3::zeros(), |most, corner| most.sup(&corner));
        assert!((most - Vector3::from(HALF)).norm() < 1e-6, "hidden sides are there: {most}");
        // The ball is none of it.
        let others = estimates.last().unwrap().units.iter().filter(|unit| unit.id != id);
        assert!(
            others.clone().count() == 1
                && others.clone().all(|unit| tracker.object(unit.id).is_none())
        );
    }
}

/// The box is thrown, taken away after .3 s, and lies at another place from .8 s on.
fn taken_away(t: f32) -> Vec<(Body, Isometry3<f32>)> {
    let lying = Isometry3::new(Vector3::new(0.3, 0.2, HALF[2]), Vector3::z() * 0.7);
    let mut bodies = thrown(t);
    match t {
        t if t < 0.3 => {}
        t if t < 0.8 => drop(bodies.remove(0)),
        _ => bodies[0].1 = lying,
    }
    bodies
}

#[test]
fn what_was_taken_away_is_found_again_with_its_number() {
    let (tracker, estimates) = follow(with_brick(), &EYES, 34, taken_away);
    let of = |estimate: &Estimate| -> Vec<u32> {
        let units = estimate.units.iter().filter(|unit| unit.visibility == Visibility::Seen);
        units.map(|unit| unit.id).collect()
    };
    let id = estimates.last().unwrap().units.iter().find(|unit| tracker.object(unit.id).is_some());
    let id = id.expect("it is found again").id;
    assert!(of(&estimates[7]).contains(&id) && !of(&estimates[20]).contains(&id));
    let found = estimates.last().unwrap().units.iter().find(|unit| unit.id == id).unwrap();
    let off = corners_off_m(found, &taken_away(1.0)[0].1, HALF);
    assert!(off < 0.004, "{off}");
}

#[test]
fn objects_are_found_the_same_on_any_number_of_threads() {
    let on = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| follow(with_brick(), &EYES, 6, thrown).1)
    };
    assert_eq!(on(1), on(3));
}

#[test]
fn what_flies_along_its_own_axis_does_not_slide_along_its_surface() {
    let bar = boxed("bar", [0.14, 0.03, 0.03]);
    let options = TrackerOptions::default();
    let planes = Planes::new([0.5, 0.4], options.gravity_m_s2, 1);
    let from = Vector3::new(0.4, -0.5, 0.7).normalize();
    // Three of its sides, so far along its axis.
    let seen = |along_m: f32| -> Vec<Sample> {
        let front = bar.elements().iter().filter(|(_, normal)| normal.dot(&from) > 0.2);
        let sample = |(point, normal): &(Point3<f32>, Vector3<f32>)| Sample {
            point: point + Vector3::x() * along_m,
            normal: *normal,
            deviation_m: 0.001,
            cluster: 0,
        };
        front.map(sample).collect()
    };
    let first = seen(0.0);
    let mut unit = TrackedUnit::new(&first, (0, 0.0), &planes, &options).unwrap();
    let place = unit.pose().inverse();
    unit.become_known(Known { number: 0, object: bar.clone() }, &place);
    unit.record_view(&first, false);
    unit.anchor.holds = false;
    // It was predicted to stay, within 5 mm, and was thrown.
    for axis in 0..3 {
        unit.motion.covariance[(axis, axis)] = 0.005_f64.powi(2);
    }
    for along_m in [0.01, 0.06, 0.12, -0.1] {
        let found = register_unit(&unit, &seen(along_m), true, 0.0).unwrap();
        let off = found.at.centre - Vector3::new(f64::from(along_m), 0.0, 0.0);
        assert!(off.norm() < 0.002, "{along_m} m: {off}");
    }
}

#[test]
fn facets_of_a_ball_tell_no_turn() {
    const RADIUS: f32 = 0.05;
    // 64 corners, as meshes of simulators have: facets are 4 % of the radius inside.
    let corner = |k: usize| {
        let z = 1.0 - (2 * k + 1) as f32 / 64.0;
        let (sin, cos) = (k as f32 * 2.399_963).sin_cos();
        let r = (1.0 - z * z).sqrt();
        Point3::from(Vector3::new(r * cos, r * sin, z) * RADIUS)
    };
    let points: Vec<Point3<f32>> = (0..64).map(corner).collect();
    let hull = rigidformer_runtime::hull::ConvexHull::new(&points).unwrap();
    let triangles: Vec<[u32; 3]> =
        hull.faces().iter().map(|face| face.map(|at| at as u32)).collect();
    let square = f64::from(RADIUS * RADIUS);
    let objects = vec![object("ball", &points, &triangles, Matrix3::identity() * 0.2 * square)];
    let options = TrackerOptions { objects, ..TrackerOptions::default() };
    let (tracker, estimates) = follow(options, &EYES, 12, thrown);
    let last = estimates.last().unwrap();
    let id = last.units.iter().find(|unit| tracker.object(unit.id).is_some()).unwrap().id;
    for (frame, estimate) in estimates.iter().enumerate().skip(3) {
        let found = estimate.units.iter().find(|unit| unit.id == id).unwrap();
        let off = (found.pose.translation.vector
            - thrown(frame as f32 / 30.0)[1].1.translation.vector)
            .norm();
        assert!(off < 0.003, "{frame}: {off}");
        let spin = found.velocity.fixed_rows::<3>(3).norm();
        let deviation = found.velocity_covariance[(3, 3)].sqrt();
        assert!(deviation > 1.0 && spin < 2.0 * deviation, "{frame}: {spin} rad/s, {deviation}");
    }
}
