//! Finds the pose of an object whose shape is known in the observed surface of a unit, without a first guess.
//!
//! Registration starts from 60 rotations, those of an icosahedron, with the object's front where the surface is. The best few are refined
//! with all of the surface. A pose is good where the surface lies on the object, and where the sides of the object that face the sensor have
//! been seen.

use nalgebra::{Isometry3, Point3, Unit, UnitQuaternion, Vector3};

use crate::known::KnownObject;
use crate::motion::{Deviations, Motion};
use crate::registration::{moved, register};
use crate::sampling::Sample;
use crate::surface::Surface;

/// Elements of the observed surface with which starts are compared.
const COARSE_SAMPLES: usize = 90;
/// Starts that are refined.
const REFINED: usize = 6;
/// Distance from the object at which an element of the surface counts as off, in radii of the object.
const OFF_RADII: f32 = 0.06;
/// Least cosine between normals of an element and of the object there.
const MIN_COSINE: f32 = 0.4;
/// Share of squares that may be off, and of facing sides that may be unseen.
const MAX_OFF: f32 = 0.12;
const MAX_UNSEEN: f32 = 0.5;
/// Weight of unseen sides beside elements that are off.
const UNSEEN_WEIGHT: f32 = 0.4;
/// Cosine from which a side faces the sensors as the surface does on average.
const FACING: f32 = 0.35;
/// Radii of a surface that may be an object's, in the object's.
const SIZES: std::ops::RangeInclusive<f32> = 0.45..=1.2;

/// A pose of an object.
#[derive(Clone, Copy, Debug)]
pub(super) struct Fit {
    /// Of the object's frame in the unit's.
    pub(super) place: Isometry3<f32>,
    /// 0 is a perfect one.
    pub(super) cost: f32,
}

/// The best pose of an object in a surface; none that is not good. `object_surface` is the object's.
pub(super) fn fit(object: &KnownObject, object_surface: &Surface, seen: &Surface) -> Option<Fit> {
    let samples: Vec<Sample> = seen
        .surfels()
        .iter()
        .map(|surfel| Sample {
            point: surfel.point,
            normal: surfel.normal,
            deviation_m: surfel.information.max(1.0).sqrt().recip(),
            cluster: 0,
        })
        .collect();
    if !SIZES.contains(&(radius_m(&samples) / object.radius_m())) {
        return None;
    }
    let sum: Vector3<f32> = samples.iter().map(|sample| sample.normal).sum();
    let facing = (sum / samples.len() as f32).try_normalize(0.05);
    let middle = centroid(samples.iter().map(|sample| &sample.point))?;
    let step = samples.len().div_ceil(COARSE_SAMPLES).max(1);
    let coarse: Vec<Sample> = samples.iter().step_by(step).copied().collect();
    let radius = f64::from(object.radius_m());
    let place_of = |start: &Motion, wide: f64, samples: &[Sample]| {
        let deviations = Deviations {
            position_m: 0.3 * wide * radius,
            turn_rad: 0.5 * wide,
            linear_m_s: 1.0,
            angular_rad_s: 1.0,
        };
        let prior =
            Motion { rotation: start.rotation, ..Motion::at_rest(start.centre, deviations) };
        let found = register(object_surface, &object.centre(), samples, None, &prior)?;
        Some(moved(&prior, &found.delta))
    };
    let rated = |motion: Motion, samples: &[Sample]| {
        let fit = rate(object, object_surface, samples, facing.as_ref(), &motion)?;
        Some((fit, motion))
    };
    let mut starts: Vec<((Fit, [f32; 2]), Motion)> = rotations()
        .into_iter()
        .filter_map(|rotation| {
            let start = start(object, &rotation, facing.as_ref(), &middle)?;
            rated(place_of(&start, 1.0, &coarse)?, &coarse)
        })
        .collect();
    // A stable sort: of equal ones the first stays first.
    starts.sort_by(|a, b| a.0.0.cost.total_cmp(&b.0.0.cost));
    let refined = starts
        .into_iter()
        .take(REFINED)
        .filter_map(|(_, motion)| rated(place_of(&motion, 0.3, &samples)?, &samples));
    let best = refined.min_by(|a, b| a.0.0.cost.total_cmp(&b.0.0.cost))?;
    let ((fit, [off, unseen]), _) = best;
    (off < MAX_OFF && unseen < MAX_UNSEEN).then_some(fit)
}

/// The object turned, with the middle of its front at the middle of the surface.
fn start(
    object: &KnownObject,
    rotation: &UnitQuaternion<f32>,
    facing: Option<&Vector3<f32>>,
    middle: &Point3<f32>,
) -> Option<Motion> {
    let front = object
        .elements()
        .iter()
        .filter(|(_, normal)| facing.is_none_or(|facing| (rotation * normal).dot(facing) > FACING));
    let front = centroid(front.map(|(point, _)| point)).unwrap_or(object.centre());
    let centre = middle + rotation * (object.centre() - front);
    let still = Deviations { position_m: 1.0, turn_rad: 1.0, linear_m_s: 1.0, angular_rad_s: 1.0 };
    let motion = Motion::at_rest(centre.coords.cast(), still);
    Some(Motion { rotation: rotation.cast(), ..motion })
}

/// How good a pose is: its cost, the share of squares that is off, and of the facing sides that no element is near.
fn rate(
    object: &KnownObject,
    surface: &Surface,
    samples: &[Sample],
    facing: Option<&Vector3<f32>>,
    motion: &Motion,
) -> Option<(Fit, [f32; 2])> {
    let place = motion.pose(&object.centre());
    let inverse = place.inverse();
    let limit = OFF_RADII * object.radius_m();
    let squares = samples.iter().map(|sample| {
        let point = inverse * sample.point;
        let Some(near) = surface.nearest(&point) else { return 1.0 };
        let is_same = near.surfel.normal.dot(&(inverse * sample.normal)) > MIN_COSINE;
        let off = near.surfel.normal.dot(&(point - near.surfel.point)).abs();
        // Beyond the edge of a side the plane of that side says nothing.
        let aside = (near.square_m2 - off * off).max(0.0).sqrt() - surface.cell_m();
        let off = off.max(aside) / limit;
        if is_same { (off * off).min(1.0) } else { 1.0 }
    });
    let off = squares.sum::<f32>() / samples.len().max(1) as f32;
    let seen: Vec<[f32; 3]> = samples.iter().map(|sample| sample.point.into()).collect();
    let tree = kiddo::ImmutableKdTree::<f32, 3>::new_from_slice(&seen).ok()?;
    let spacing = spacing_m(samples) + surface.cell_m();
    let (mut all, mut unseen) = (0, 0);
    for (point, normal) in object.elements().iter().step_by(3) {
        if facing.is_some_and(|facing| (place * normal).dot(facing) < FACING) {
            continue;
        }
        all += 1;
        let query: [f32; 3] = (place * point).into();
        let near = tree.query(&query).nearest_one::<kiddo::SquaredEuclidean<f32>>().execute();
        unseen += usize::from(near.distance > spacing * spacing);
    }
    let unseen = unseen as f32 / all.max(1) as f32;
    let cost = off + UNSEEN_WEIGHT * unseen;
    cost.is_finite().then_some((Fit { place, cost }, [off, unseen]))
}

/// Distance of neighbouring samples, about: that of a disc of the bounding box's diagonal.
fn spacing_m(samples: &[Sample]) -> f32 {
    extent_m(samples) / (samples.len().max(1) as f32).sqrt()
}

fn extent_m(samples: &[Sample]) -> f32 {
    super::unit::bounds(samples).map_or(0.0, |(low, high)| (high - low).norm())
}

/// Largest distance of a sample from the middle of them all.
fn radius_m(samples: &[Sample]) -> f32 {
    let Some((low, high)) = super::unit::bounds(samples) else { return 0.0 };
    let middle = (low + high) * 0.5;
    let squares = samples.iter().map(|sample| (sample.point.coords - middle).norm_squared());
    squares.fold(0.0, f32::max).sqrt()
}

fn centroid<'p>(points: impl Iterator<Item = &'p Point3<f32>>) -> Option<Point3<f32>> {
    let (sum, count) = points
        .fold((Vector3::zeros(), 0.0), |(sum, count), point| (sum + point.coords, count + 1.0));
    (count > 0.0).then(|| Point3::from(sum / count))
}

/// The 60 rotations of an icosahedron: any rotation is within 45 degrees of one.
fn rotations() -> Vec<UnitQuaternion<f32>> {
    let golden = 0.5 * (1.0 + 5.0_f32.sqrt());
    let axes: Vec<Vector3<f32>> = [1.0, -1.0]
        .into_iter()
        .flat_map(|sign| {
            let corner = Vector3::new(0.0, sign, golden);
            [corner, Vector3::new(corner.y, corner.z, 0.0), Vector3::new(corner.z, 0.0, corner.y)]
        })
        .collect();
    let fifth = |axis: &Vector3<f32>| {
        UnitQuaternion::from_axis_angle(&Unit::new_normalize(*axis), std::f32::consts::TAU / 5.0)
    };
    // Products of turns by a fifth reach all of them.
    let mut all = vec![UnitQuaternion::identity()];
    let mut at = 0;
    while let Some(from) = all.get(at).copied() {
        at += 1;
        for axis in &axes {
            let next = fifth(axis) * from;
            let is_new = all.iter().all(|known| known.angle_to(&next) > 0.1);
            if is_new && all.len() < 60 {
                all.push(next);
            }
        }
    }
    all
}

#[cfg(test)]
mod tests {
    use nalgebra::Matrix3;
    use rigidformer_runtime::noise::Noise;

    use super::*;
    use crate::known::ObjectMesh;

    #[test]
    fn there_are_60_rotations_of_an_icosahedron() {
        let all = rotations();
        assert_eq!(all.len(), 60);
        for (at, a) in all.iter().enumerate() {
            let nearest = all.iter().enumerate().filter(|(other, _)| *other != at);
            let nearest = nearest.map(|(_, b)| a.angle_to(b)).fold(f32::MAX, f32::min);
            assert!((nearest.to_degrees() - 72.0).abs() < 0.1, "{nearest}");
        }
    }

    /// A box with sides of these lengths, and a smaller one on top at a corner: no two rotations of it look alike.
    fn stepped([a, b, c]: [f32; 3]) -> KnownObject {
        let (mut points, mut triangles) = (Vec::new(), Vec::new());
        let mut add = |low: [f32; 3], high: [f32; 3]| {
            let first = points.len() as u32;
            for k in 0..8 {
                let side = |axis: usize| if k >> axis & 1 == 0 { low[axis] } else { high[axis] };
                points.push(Point3::new(side(0), side(1), side(2)));
            }
            for [a, b, c, d] in
                [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]]
            {
                triangles.push([a, b, c].map(|k: u32| k + first));
                triangles.push([a, c, d].map(|k: u32| k + first));
            }
        };
        add([0.0; 3], [a, b, c]);
        add([0.0, 0.0, c], [0.4 * a, 0.3 * b, 1.6 * c]);
        let mesh = ObjectMesh {
            name: "stepped",
            points: &points,
            triangles: &triangles,
            pieces: &[],
            mass_kg: 1.0,
            centre_m: Point3::new(0.5 * a, 0.5 * b, 0.6 * c).cast(),
            inertia_kg_m2: Matrix3::identity() * 1e-3,
        };
        KnownObject::new(&mesh).unwrap()
    }

    /// What a sensor in this direction sees of an object at a pose, with noise.
    fn seen(
        object: &KnownObject,
        at: &Isometry3<f32>,
        from: &Vector3<f32>,
        noise: &mut Noise,
    ) -> Surface {
        let mut surface = Surface::new(1.6 * object.radius_m());
        let front = object.elements().iter().filter(|(_, normal)| (at * normal).dot(from) > 0.2);
        let front = front.map(|(point, normal)| {
            (at * point + at * normal * (noise.normal() * 0.001), at * normal, 0.001)
        });
        surface.add(0, front.collect::<Vec<_>>().into_iter());
        surface
    }

    #[test]
    fn an_object_is_found_however_it_lies() {
        let object = stepped([0.1, 0.16, 0.06]);
        let known = Surface::known(object.elements(), object.spacing_m());
        let mut noise = Noise::new(3, 1);
        let mut found = 0;
        for _ in 0..12 {
            let mut normal = || Vector3::new(noise.normal(), noise.normal(), noise.normal());
            let turn = UnitQuaternion::from_scaled_axis(normal() * 2.0);
            let at = Isometry3::from_parts((normal() * 0.5).into(), turn);
            let from = (turn * (normal() + Vector3::z() * 1.5)).normalize();
            let surface = seen(&object, &at, &from, &mut noise);
            let fit = fit(&object, &known, &surface);
            let off = fit.map(|fit| {
                let place = fit.place * object.centre() - at * object.centre();
                (fit.place.rotation.angle_to(&turn), place.norm())
            });
            found += usize::from(off.is_some_and(|(turn, place)| turn < 0.1 && place < 0.005));
        }
        assert!(found >= 10, "{found}");
        // Another one is none of it.
        let other = stepped([0.1, 0.1, 0.1]);
        let other_known = Surface::known(other.elements(), other.spacing_m());
        let surface =
            seen(&object, &Isometry3::identity(), &Vector3::new(0.5, 0.4, 0.7), &mut noise);
        assert!(fit(&other, &other_known, &surface).is_none());
    }
}
