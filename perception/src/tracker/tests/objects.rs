//! Objects whose mesh is known.

use nalgebra::Matrix3;

use super::*;
use crate::known::{KnownObject, ObjectMesh};

const HALF: [f32; 3] = [0.06, 0.05, 0.04];

/// The box that is thrown, of half a kilogram.
fn brick() -> KnownObject {
    let points: Vec<Point3<f32>> = (0..8)
        .map(|k| {
            Point3::from([0, 1, 2].map(|at| if k >> at & 1 == 0 { -HALF[at] } else { HALF[at] }))
        })
        .collect();
    let quads =
        [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]];
    let triangles: Vec<[u32; 3]> =
        quads.iter().flat_map(|[a, b, c, d]| [[*a, *b, *c], [*a, *c, *d]]).collect();
    let square = HALF.map(|half| f64::from(half * half));
    let moments = [square[1] + square[2], square[0] + square[2], square[0] + square[1]];
    let mesh = ObjectMesh {
        name: "brick",
        points: &points,
        triangles: &triangles,
        pieces: &[],
        mass_kg: 0.5,
        centre_m: Point3::origin(),
        inertia_kg_m2: Matrix3::from_diagonal(&(Vector3::from(moments) * (0.5 / 3.0))),
    };
    KnownObject::new(&mesh).unwrap()
}

fn with_brick() -> TrackerOptions {
    TrackerOptions { objects: vec![brick()], ..TrackerOptions::default() }
}

/// How far the corners of an estimated box are from those of the true one, whichever of its turns on itself it has.
fn corners_off_m(found: &UnitEstimate, truth: &Isometry3<f32>) -> f32 {
    let corner = |pose: &Isometry3<f32>, signs: [f32; 3]| {
        pose * Point3::from([0, 1, 2].map(|at| HALF[at] * signs[at]))
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
            let off = corners_off_m(found, &truth);
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
    let off = corners_off_m(found, &taken_away(1.0)[0].1);
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
