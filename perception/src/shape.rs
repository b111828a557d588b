//! The points of a unit that the model gets: what has been seen, and a guess at what has not.

use nalgebra::{Isometry3, Point3, Vector3};
use rigidformer_core::Plane;
use rigidformer_core::geometry::{centre_of_mass, farthest_point_order};
use rigidformer_runtime::hull::ConvexHull;

use super::primitive::Form;
use super::surface::Surface;

/// How the sides of a unit that nobody has seen are guessed.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Completion {
    /// They are not: the model gets what was seen.
    Seen,
    /// What was seen is reflected in a point: many bodies look the same from the other side. The point is the middle of what was seen
    /// across the view. Along the view the unit is taken to be as deep as it is wide on average, or as deep as was seen if that is more.
    /// What comes to lie below a support plane is put on it.
    Mirrored,
    /// Where four fifths of what was seen lie on a box, a cylinder or a ball, the unit is that. Sides that were not seen end where the sides
    /// beside them end. Other units are mirrored.
    #[default]
    Fitted,
}

/// Below this length of the mean normal a surface has been seen from all sides.
const CLOSED: f32 = 0.08;
/// Below this height over a plane, and a cell and a half of the surface more, a unit stands on it, metres.
const NEAR_M: f32 = 0.008;
/// A reflected point is dropped where a seen one is nearer than this part of the radius.
const NEAR: f32 = 0.18;

/// Points of a unit in its own frame, and its centre.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Shape {
    /// At most as many as asked for.
    pub(super) points: Vec<Point3<f32>>,
    /// Centroid of their hull.
    pub(super) centre: Point3<f32>,
    /// Of their hull.
    pub(super) volume_m3: f32,
}

impl Shape {
    /// Of what was seen of a unit at a pose, above these planes.
    pub(super) fn new(
        surface: &Surface,
        completion: Completion,
        pose: &Isometry3<f32>,
        planes: &[Plane],
        most: usize,
    ) -> Option<Self> {
        let surfels = surface.surfels().iter();
        if surfels.len() < 4 {
            return None;
        }
        let form = match completion {
            Completion::Fitted => {
                Form::fit(&surfels.clone().map(|s| (s.point, s.normal)).collect::<Vec<_>>())
            }
            Completion::Mirrored | Completion::Seen => None,
        };
        let mut points: Vec<Point3<f32>> = match form {
            Some(form) => form.points().iter().map(|point| lifted(point, pose, planes)).collect(),
            None => surfels.map(|surfel| surfel.point).collect(),
        };
        if form.is_none() && completion != Completion::Seen {
            let guessed = mirrored(surface, &points);
            points.extend(guessed.into_iter().map(|point| lifted(&point, pose, planes)));
        }
        if completion != Completion::Seen {
            settle(&mut points, pose, planes, surface.cell_m());
        }
        let centre = centre_of_mass(&mut points);
        let mut distances = vec![0.0; points.len()];
        farthest_point_order(&mut points, &centre, &mut distances);
        points.truncate(most);
        let centre = centre_of_mass(&mut points.clone());
        let volume_m3 = volume_m3(&points);
        let is_sound = centre.iter().all(|number| number.is_finite());
        is_sound.then_some(Shape { points, centre, volume_m3 })
    }
}

/// Volume of the hull of points. Of points in a plane it is that of a ball of their extent times a hundredth: a unit has a mass.
pub fn volume_m3(points: &[Point3<f32>]) -> f32 {
    let middle =
        points.iter().map(|point| point.coords).sum::<Vector3<f32>>() / points.len().max(1) as f32;
    let Some(hull) = ConvexHull::new(points) else {
        let radius = points.iter().map(|point| (point.coords - middle).norm());
        return 0.04 * radius.fold(0.0, f32::max).powi(3);
    };
    let tetrahedra = hull.faces().iter().map(|face| {
        let [a, b, c] = face.map(|corner| points[corner].coords - middle);
        a.cross(&b).dot(&c) / 6.0
    });
    tetrahedra.sum::<f32>().abs()
}

/// A point above all planes; where it is.
fn lifted(point: &Point3<f32>, pose: &Isometry3<f32>, planes: &[Plane]) -> Point3<f32> {
    let mut world = pose * point;
    for plane in planes {
        let height = plane.height_m(&world.coords);
        if height < 0.0 {
            world -= plane.normal * height;
        }
    }
    pose.inverse_transform_point(&world)
}

/// Lets down to a plane what is just above it: the last millimetres of a body that stands on a plane are taken for the plane's. A unit that
/// the model has a little above the ground would fall in every step.
fn settle(points: &mut [Point3<f32>], pose: &Isometry3<f32>, planes: &[Plane], cell_m: f32) {
    for plane in planes {
        let height = |point: &Point3<f32>| plane.height_m(&(pose * point).coords);
        let lowest = points.iter().map(height).fold(f32::MAX, f32::min);
        if !(0.0..1.5 * cell_m + NEAR_M).contains(&lowest) {
            continue;
        }
        let down = pose.rotation.inverse_transform_vector(&plane.normal) * lowest;
        for point in points.iter_mut() {
            if height(point) < lowest + 0.5 * cell_m {
                *point -= down;
            }
        }
    }
}

/// The other side of what was seen from one.
fn mirrored(surface: &Surface, points: &[Point3<f32>]) -> Vec<Point3<f32>> {
    let sum: Vector3<f32> = surface.surfels().iter().map(|surfel| surfel.normal).sum();
    let mean = sum / surface.surfels().len().max(1) as f32;
    let Some(front) = mean.try_normalize(CLOSED) else { return Vec::new() };
    let across = front.cross(&axis_beside(&front)).normalize();
    let up = front.cross(&across);
    let range = |axis: &Vector3<f32>| {
        let along = points.iter().map(|point| axis.dot(&point.coords));
        along.fold((f32::MAX, f32::MIN), |(low, high), at| (low.min(at), high.max(at)))
    };
    let (a, b, depth) = (range(&across), range(&up), range(&front));
    let width = |(low, high): (f32, f32)| high - low;
    let middle = |(low, high): (f32, f32)| 0.5 * (low + high);
    let deep = width(depth).max(0.5 * (width(a) + width(b)));
    let centre = across * middle(a) + up * middle(b) + front * (depth.1 - 0.5 * deep);
    let radius = 0.5 * width(a).max(width(b)).max(deep);
    let least = (NEAR * radius).powi(2);
    let opposite = points.iter().map(|point| Point3::from(2.0 * centre - point.coords));
    let is_new = |point: &Point3<f32>| {
        surface.nearest(point).is_none_or(|nearest| nearest.square_m2 > least)
    };
    opposite.filter(is_new).collect()
}

/// The axis that a direction is least along.
fn axis_beside(direction: &Vector3<f32>) -> Vector3<f32> {
    let mut axis = Vector3::zeros();
    axis[direction.iamin()] = 1.0;
    axis
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Half of a sphere of radius .1 about (.3, 0, 0), seen from +x.
    fn half() -> Surface {
        let mut surface = Surface::new(0.2);
        let seen = (0..800).filter_map(|i| {
            let z = 1.0 - 2.0 * (i as f32 + 0.5) / 800.0;
            let (sin, cos) = (i as f32 * 2.399_963).sin_cos();
            let r = (1.0 - z * z).sqrt();
            let normal = Vector3::new(r * cos, r * sin, z);
            let point = Point3::from(normal * 0.1 + Vector3::new(0.3, 0.0, 0.0));
            (normal.x > 0.05).then_some((point, normal, 0.0005))
        });
        surface.add(0, seen);
        surface
    }

    #[test]
    fn half_a_ball_is_completed() {
        let here = Isometry3::identity();
        let seen = Shape::new(&half(), Completion::Seen, &here, &[], 96).unwrap();
        let whole = Shape::new(&half(), Completion::Mirrored, &here, &[], 96).unwrap();
        assert!(seen.centre.x > 0.325, "{}", seen.centre);
        assert!((whole.centre - Point3::new(0.3, 0.0, 0.0)).norm() < 0.006, "{}", whole.centre);
        assert!(whole.points.len() <= 96);
        let ball = 4.0 / 3.0 * std::f32::consts::PI * 1e-3;
        assert!((whole.volume_m3 / ball - 0.9).abs() < 0.12, "{}", whole.volume_m3 / ball);
        let ground = [Plane { offset_m: -0.05, ..Plane::ground(0.5, 0.5) }];
        let whole = Shape::new(&half(), Completion::Mirrored, &here, &ground, 96).unwrap();
        let below = whole.points.iter().filter(|point| point.x < 0.29 && point.z < -0.051);
        assert_eq!(below.count(), 0);
    }
}
