//! Points of a unit for the model: its observed surface, completed by hidden sides.

use nalgebra::{Isometry3, Point3, Vector3};
use rigidformer_core::Plane;
use rigidformer_core::geometry::{centre_of_mass, farthest_point_order};
use rigidformer_core::kernels::in_own_environment;
use rigidformer_runtime::hull::ConvexHull;

use super::planes::height_m;
use super::primitive::Form;
use super::surface::Surface;

/// How the hidden sides of a unit are completed.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Completion {
    /// They are not: the model gets the observed surface.
    Seen,
    /// The observed surface is reflected in a point, because many bodies are symmetric. Across the view the point is the middle of the
    /// surface. Along the view the unit is as deep as it is wide on average, or as deep as the surface if that is more. Points below a
    /// support plane are moved onto it.
    Mirrored,
    /// Where four fifths of the surface lie on a box, a cylinder or a ball, the unit is that. Hidden sides end where the sides beside them
    /// end. Other units are mirrored.
    #[default]
    Fitted,
}

/// Length of the mean normal below which a surface is closed.
// Normals of a closed surface cancel, so that no side is hidden.
const CLOSED_NORMAL: f32 = 0.08;
/// Height over a plane up to which a unit stands on it, beside a cell and a half of the surface, metres.
// The planes' threshold takes the last millimetres of a standing body for the plane.
const STANDING_M: f32 = 0.008;
/// Least distance of a reflected point from the observed surface, in radii.
// The surface itself is more certain than its reflection.
const MIN_MIRRORED_DISTANCE: f32 = 0.18;

/// Points of a unit in its own frame, and its centre.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Shape {
    /// At most `most`, in farthest-point order.
    pub(super) points: Vec<Point3<f32>>,
    /// Centroid of their hull.
    pub(super) centre: Point3<f32>,
    /// Of their hull.
    pub(super) volume_m3: f32,
}

impl Shape {
    /// From the surface of a unit at a pose, above these planes.
    pub(super) fn new(
        surface: &Surface,
        completion: Completion,
        pose: &Isometry3<f32>,
        planes: &[Plane],
        most: usize,
    ) -> Option<Self> {
        let surfels = surface.surfels().iter();
        // Fewer than four points have no hull.
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
            Some(form) => {
                form.points().iter().map(|point| above_planes(point, pose, planes)).collect()
            }
            None => surfels.map(|surfel| surfel.point).collect(),
        };
        if form.is_none() && completion != Completion::Seen {
            let guessed = mirrored(surface, &points);
            points.extend(guessed.into_iter().map(|point| above_planes(&point, pose, planes)));
        }
        if completion != Completion::Seen {
            snap_to_planes(&mut points, pose, planes, surface.cell_m());
        }
        let centre = centre_of_mass(&mut points);
        let mut distances = vec![0.0; points.len()];
        farthest_point_order(&mut points, &centre, &mut distances);
        points.truncate(most);
        // The truncated points have another hull, and the model computes the centre from these.
        let centre = centre_of_mass(&mut points.clone());
        let volume_m3 = volume_m3(&points);
        let is_sound = centre.iter().all(|number| number.is_finite());
        is_sound.then_some(Shape { points, centre, volume_m3 })
    }
}

/// Volume of the points' hull. Coplanar points have a hundredth of the volume of a ball of their extent, because a unit needs a mass.
pub fn volume_m3(points: &[Point3<f32>]) -> f32 {
    in_own_environment(|| volume_here(points))
}

fn volume_here(points: &[Point3<f32>]) -> f32 {
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

/// The point, or its projection onto a plane that it is below.
fn above_planes(point: &Point3<f32>, pose: &Isometry3<f32>, planes: &[Plane]) -> Point3<f32> {
    let mut world = pose * point;
    for plane in planes {
        let height = height_m(plane, &world.coords);
        if height < 0.0 {
            world -= plane.normal * height;
        }
    }
    pose.inverse_transform_point(&world)
}

/// Moves the lowest points of a unit just above a plane onto the plane. The last millimetres of a standing body count as the plane's, and a
/// unit slightly above the ground would fall in every step of the model.
fn snap_to_planes(
    points: &mut [Point3<f32>],
    pose: &Isometry3<f32>,
    planes: &[Plane],
    cell_m: f32,
) {
    for plane in planes {
        let height = |point: &Point3<f32>| height_m(plane, &(pose * point).coords);
        let lowest = points.iter().map(height).fold(f32::MAX, f32::min);
        // A unit higher up is in the air or on another body.
        if !(0.0..1.5 * cell_m + STANDING_M).contains(&lowest) {
            continue;
        }
        let down = pose.rotation.inverse_transform_vector(&plane.normal) * lowest;
        for point in points.iter_mut() {
            // The foot alone moves: the other sides are observed.
            if height(point) < lowest + 0.5 * cell_m {
                *point -= down;
            }
        }
    }
}

/// The observed surface, reflected in a point.
fn mirrored(surface: &Surface, points: &[Point3<f32>]) -> Vec<Point3<f32>> {
    let sum: Vector3<f32> = surface.surfels().iter().map(|surfel| surfel.normal).sum();
    let mean = sum / surface.surfels().len().max(1) as f32;
    let Some(front) = mean.try_normalize(CLOSED_NORMAL) else { return Vec::new() };
    let across = front.cross(&axis_beside(&front)).normalize();
    let up = front.cross(&across);
    let range = |axis: &Vector3<f32>| {
        let along = points.iter().map(|point| axis.dot(&point.coords));
        along.fold((f32::MAX, f32::MIN), |(low, high), at| (low.min(at), high.max(at)))
    };
    let (a, b, depth) = (range(&across), range(&up), range(&front));
    let width = |(low, high): (f32, f32)| high - low;
    let middle = |(low, high): (f32, f32)| 0.5 * (low + high);
    // Most bodies are about as deep as wide.
    let deep = width(depth).max(0.5 * (width(a) + width(b)));
    let centre = across * middle(a) + up * middle(b) + front * (depth.1 - 0.5 * deep);
    let radius = 0.5 * width(a).max(width(b)).max(deep);
    let least = (MIN_MIRRORED_DISTANCE * radius).powi(2);
    let opposite = points.iter().map(|point| Point3::from(2.0 * centre - point.coords));
    let is_new = |point: &Point3<f32>| {
        surface.nearest(point).is_none_or(|nearest| nearest.square_m2 > least)
    };
    opposite.filter(is_new).collect()
}

/// The coordinate axis that is most nearly perpendicular to a direction.
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
