//! The pose of a unit from points without correspondences: trimmed point-to-plane ICP with a covariance.
//!
//! Each point that was seen goes with the surfel of the unit's surface nearest to it. The distance along that surfel's normal is to be
//! 0. Gauss-Newton steps minimise the sum of squares, with the predicted pose and its covariance as one more observation. So what points
//! cannot tell, such as how a ball has turned, stays as predicted. Points whose distance is an outlier are left out.
//!
//! Why this step is our own: modern-icp has no covariance and no prior, and brings five crates; kornia-3d fits points to points and
//! depends on crates for images; threecrate's point-to-plane ICP has neither trimming by residuals nor a covariance, and brings ndarray,
//! rstar and two trees. The search for the nearest surfel, which is most of the work, is kiddo's.

use nalgebra::{Matrix6, Point3, Vector3, Vector6};

use super::motion::{Motion, matrix};
use super::sampling::Sample;
use super::surface::Surface;

/// Gauss-Newton steps, at most.
const MOST_STEPS: usize = 14;
/// A step that moves less ends the search: m, rad.
const SMALL: f64 = 2e-5;
/// Pairs that are needed for a pose.
const LEAST_PAIRS: usize = 8;
/// Normals of a pair are nearer to each other than this cosine says.
const FACING: f32 = 0.5;
/// A point is beside its surfel by less than this many cells.
const BESIDE_CELLS: f32 = 1.2;
/// Deviations beyond which a distance is an outlier.
const OUTLIER: f64 = 3.0;
/// Of a surfel beside what its information says, metres: surfaces are not made of planes.
const ROUGH_M: f64 = 2e-4;
/// A direction that has less than this part of all information is not told by the points: the square of what normals are off.
const UNTOLD: f64 = 0.008;
/// A point that lies beyond the rim of what is known, by more than this many cells and fewer than [`FARTHEST_CELLS`], draws the rim to
/// it: a side that slides along itself would leave nothing else to see.
const BEYOND_CELLS: f32 = 0.8;
const FARTHEST_CELLS: f32 = 4.0;
/// How well rims are known, cells.
const RIM_CELLS: f64 = 1.0;
/// Points beyond a rim are not independent: so much each counts.
const RIM_SHARE: f64 = 0.1;
/// Pairs count as so many independent ones at most: errors of the surface are the same from capture to capture.
const INDEPENDENT: f64 = 150.0;

/// A pose that was found.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Registered {
    /// Of the prior's pose, in the world's axes about the centre: metres, then radians. The most likely one, the prior counted.
    pub(super) delta: Vector6<f64>,
    /// Of the points alone.
    pub(super) information: Matrix6<f64>,
    /// Points that have a surfel within bounds, of all.
    pub(super) share: f64,
    /// How far points are from the surface, in the deviations that they should have.
    pub(super) residual: f64,
}

/// A pair of a point and a surfel, at a pose.
struct Pair {
    /// Distance along the normal, metres.
    distance: f64,
    /// Its change with the pose.
    gradient: Vector6<f64>,
    /// Inverse of the variance that it should have.
    weight: f64,
    /// Whether it draws a rim: it counts in directions that the others do not tell.
    is_rim: bool,
}

/// Normal equations.
#[derive(Clone, Copy)]
struct Equations {
    h: Matrix6<f64>,
    b: Vector6<f64>,
}

impl Equations {
    fn none() -> Self {
        Equations { h: Matrix6::zeros(), b: Vector6::zeros() }
    }

    fn times(&self, factor: f64) -> Self {
        Equations { h: self.h * factor, b: self.b * factor }
    }

    fn add(&mut self, pair: &Pair) {
        self.h += pair.gradient * pair.gradient.transpose() * pair.weight;
        self.b += pair.gradient * (pair.distance * pair.weight);
    }
}

/// Where the mean of a unit's samples should be, as seen from its centre, and how well that is known. It counts in directions that
/// nothing else tells: a side that slides along itself takes the middle of what is seen with it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Middle {
    pub(super) from_centre: Vector3<f64>,
    pub(super) deviation_m: f64,
}

impl Middle {
    /// Adds the distance of the samples' mean from there.
    fn add_to(&self, equations: &mut Equations, mean: &Vector3<f64>, at: &Motion) {
        let off = mean - at.centre - self.from_centre;
        let weight = 1.0 / (self.deviation_m * self.deviation_m);
        for axis in 0..3 {
            equations.h[(axis, axis)] += weight;
            equations.b[axis] += weight * off[axis];
        }
    }
}

/// Finds the pose at which samples lie on the surface, from `prior` on. `centre` is that of `prior`, in the unit's frame. None where
/// too few of them do.
pub(super) fn register(
    surface: &Surface,
    centre: &Point3<f32>,
    samples: &[Sample],
    middle: Option<&Middle>,
    prior: &Motion,
) -> Option<Registered> {
    let whole = prior.pose_covariance().try_inverse()?;
    let mut delta = Vector6::<f64>::zeros();
    let (place, turn) = prior.spread();
    // At first as far as the prior may be off.
    let lever = f64::from(surface.radius_m());
    let mut gate = Gate { extra_m: (2.0 * (place + lever * turn)).min(0.5 * lever), scale: 1.0 };
    let sum: Vector3<f64> = samples.iter().map(|sample| sample.point.coords.cast::<f64>()).sum();
    let mean = sum / samples.len().max(1) as f64;
    let mut pairs = Vec::with_capacity(samples.len());
    let mut last = None;
    for step in 0..MOST_STEPS {
        let at = moved(prior, &delta);
        find_pairs(surface, centre, samples, &at, &gate, &mut pairs);
        let own = pairs.iter().filter(|pair| !pair.is_rim).count();
        if own < LEAST_PAIRS.min(samples.len()) || own < 4 {
            return last;
        }
        let scale = median_scale(&mut pairs);
        let limit = OUTLIER * scale;
        let (mut all, mut rims) = (Equations::none(), Equations::none());
        let (mut square, mut kept) = (0.0, 0.0);
        for pair in &pairs {
            if pair.is_rim {
                rims.add(pair);
                continue;
            }
            let deviations = pair.distance.abs() * pair.weight.sqrt();
            // While the pose may be off, a side that is off may be one of several: the others' distances say nothing of it.
            if deviations > limit + gate.extra_m * pair.weight.sqrt() {
                continue;
            }
            all.add(pair);
            square += deviations * deviations;
            kept += 1.0;
        }
        let residual = (square / f64::max(kept - 6.0, 1.0)).sqrt();
        // Less certain by as much as distances are larger than they should be, and by what they have in common.
        let trust = f64::min(1.0, INDEPENDENT / kept) / residual.max(1.0).powi(2);
        let mut rims = rims.times(RIM_SHARE);
        if let Some(middle) = middle {
            middle.add_to(&mut rims, &mean, &at);
        }
        let Equations { h, b } = told(&all.times(trust), &rims, 0.5 * lever);
        let change = (h + whole).cholesky()?.solve(&(b - whole * delta));
        // A step that turns by more than the linear part holds for is shortened.
        let share = (0.3 / change.fixed_rows::<3>(3).norm()).min(1.0);
        delta += change * share;
        if !delta.iter().all(|number| number.is_finite()) {
            return None;
        }
        last = Some(Registered {
            delta,
            information: h,
            share: kept / samples.len() as f64,
            residual,
        });
        let (moves, turns) = (change.fixed_rows::<3>(0).norm(), change.fixed_rows::<3>(3).norm());
        if step > 1 && moves < SMALL && turns < SMALL {
            break;
        }
        gate.extra_m *= 0.5;
        gate.scale = scale.clamp(1.0, 3.0);
    }
    last
}

/// Leaves out of the normal equations what the points say nothing of: a flat side may slide. Normals are not exact, so that a slide looks
/// as if it were seen a little. With turns at a lever in metres all six directions have one scale.
fn told(all: &Equations, rims: &Equations, lever: f64) -> Equations {
    let turn = 1.0 / lever.max(1e-6);
    let scale = Matrix6::from_diagonal(&Vector6::new(1.0, 1.0, 1.0, turn, turn, turn));
    let scaled = scale * all.h * scale;
    let least = UNTOLD * scaled.fixed_view::<3, 3>(0, 0).trace();
    let eigen = scaled.symmetric_eigen();
    let mut kept = Matrix6::zeros();
    for (value, axis) in eigen.eigenvalues.iter().zip(eigen.eigenvectors.column_iter()) {
        if *value > least {
            kept += axis * axis.transpose();
        }
    }
    let rest = Matrix6::identity() - kept;
    let back = Matrix6::from_diagonal(&Vector6::new(1.0, 1.0, 1.0, lever, lever, lever));
    let h = kept * scaled * kept + rest * scale * rims.h * scale * rest;
    let h = back * h * back;
    let b = back * (kept * (scale * all.b) + rest * (scale * rims.b));
    Equations { h: (h + h.transpose()) * 0.5, b }
}

/// The prior's pose, moved.
pub(super) fn moved(prior: &Motion, delta: &Vector6<f64>) -> Motion {
    let turn = nalgebra::UnitQuaternion::from_scaled_axis(delta.fixed_rows::<3>(3).into_owned());
    Motion {
        centre: prior.centre + delta.fixed_rows::<3>(0),
        rotation: turn * prior.rotation,
        ..prior.clone()
    }
}

/// How far a point may be from its surfel.
struct Gate {
    extra_m: f64,
    scale: f64,
}

fn find_pairs(
    surface: &Surface,
    centre: &Point3<f32>,
    samples: &[Sample],
    at: &Motion,
    gate: &Gate,
    pairs: &mut Vec<Pair>,
) {
    pairs.clear();
    let rotation = matrix(&at.rotation);
    let inverse = rotation.transpose().cast::<f32>();
    let middle = at.centre.cast::<f32>();
    let beside = BESIDE_CELLS * surface.cell_m() + gate.extra_m as f32;
    for sample in samples {
        let local = Point3::from(inverse * (sample.point.coords - middle)) + centre.coords;
        let Some(near) = surface.nearest(&local) else { return };
        let surfel = near.surfel;
        if (inverse * sample.normal).dot(&surfel.normal) < FACING {
            continue;
        }
        let distance = f64::from(surfel.normal.dot(&(local - surfel.point)));
        let aside = f64::from(near.square_m2) - distance * distance;
        let variance = f64::from(sample.deviation_m).powi(2)
            + 1.0 / f64::from(surfel.information)
            + ROUGH_M * ROUGH_M;
        let limit = OUTLIER * 1.5 * gate.scale * variance.sqrt() + gate.extra_m;
        if distance.abs() > limit {
            continue;
        }
        let lever: Vector3<f64> = rotation * (surfel.point - centre).cast::<f64>();
        let pair = |direction: Vector3<f64>, distance: f64, weight: f64, is_rim: bool| {
            let (along, turning) = (direction, lever.cross(&direction));
            let gradient = [along.x, along.y, along.z, turning.x, turning.y, turning.z];
            Pair { distance, gradient: Vector6::from(gradient), weight, is_rim }
        };
        let aside = aside.max(0.0).sqrt();
        if aside < f64::from(beside) {
            pairs.push(pair(
                rotation * surfel.normal.cast::<f64>(),
                distance,
                1.0 / variance,
                false,
            ));
        }
        let cell = surface.cell_m();
        if aside > f64::from(BEYOND_CELLS * cell) && aside < f64::from(FARTHEST_CELLS * cell) {
            let off = (local - surfel.point).cast::<f64>() - surfel.normal.cast::<f64>() * distance;
            let deviation = RIM_CELLS * f64::from(cell);
            let over = aside - 0.5 * f64::from(cell);
            pairs.push(pair(rotation * (off / aside), over, 1.0 / (deviation * deviation), true));
        }
    }
}

/// Half of the distances are smaller than this many deviations, times what makes it a normal distribution's; at least 1.
fn median_scale(pairs: &mut [Pair]) -> f64 {
    let own = pairs.iter().filter(|pair| !pair.is_rim).count();
    let size = |pair: &Pair| match pair.is_rim {
        true => f64::MAX,
        false => pair.distance.abs() * pair.weight.sqrt(),
    };
    let middle = own / 2;
    if own == 0 {
        return 1.0;
    }
    let (_, median, _) = pairs.select_nth_unstable_by(middle, |a, b| size(a).total_cmp(&size(b)));
    (1.4826 * size(median)).max(1.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::motion::Deviations;
    use nalgebra::UnitQuaternion;
    use rigidformer_runtime::noise::Noise;

    /// Points on three sides of a box of .1 x .08 x .06 m, with noise along their normals.
    fn sides(noise: &mut Noise, count: usize, deviation_m: f32) -> Vec<Sample> {
        let half = [0.05, 0.04, 0.03];
        (0..count)
            .map(|i| {
                let axis = i % 3;
                let mut at = [0, 1, 2].map(|k| (noise.uniform() * 2.0 - 1.0) * half[k]);
                at[axis] = half[axis] + noise.normal() * deviation_m;
                let mut normal = Vector3::zeros();
                normal[axis] = 1.0;
                Sample { point: Point3::from(at), normal, deviation_m, cluster: 0 }
            })
            .collect()
    }

    fn surface(noise: &mut Noise, deviation_m: f32) -> Surface {
        let mut surface = Surface::new(0.14);
        for capture in 0..3 {
            let seen = sides(noise, 900, deviation_m);
            surface.add(capture, seen.iter().map(|s| (s.point, s.normal, s.deviation_m)));
        }
        surface
    }

    const PRIOR: Deviations =
        Deviations { place_m: 0.02, turn_rad: 0.2, linear_m_s: 1.0, angular_rad_s: 2.0 };

    #[test]
    fn a_moved_box_is_found_with_an_honest_covariance() {
        let mut squares = 0.0;
        for seed in 0..40 {
            let mut noise = Noise::new(seed, 1);
            let surface = surface(&mut noise, 0.001);
            let turn = UnitQuaternion::from_scaled_axis(Vector3::new(0.08, -0.05, 0.1));
            let place = Vector3::new(0.3, 0.012, -0.009);
            let mut seen = sides(&mut noise, 300, 0.001);
            for sample in &mut seen {
                sample.point =
                    Point3::from(turn.cast::<f32>() * sample.point.coords + place.cast());
                sample.normal = turn.cast::<f32>() * sample.normal;
            }
            // A tenth of what is seen is something else.
            for sample in seen.iter_mut().take(30) {
                sample.point.z += 0.02 * noise.uniform();
            }
            let prior = Motion::at_rest(Vector3::new(0.3, 0.0, 0.0), PRIOR);
            let found = register(&surface, &Point3::origin(), &seen, None, &prior).unwrap();
            let at = moved(&prior, &found.delta);
            let off = at.centre - place;
            let turned = (at.rotation * turn.inverse()).scaled_axis();
            assert!(off.norm() < 1e-3 && turned.norm() < 0.015, "{off} {turned}");
            let error = Vector6::new(off.x, off.y, off.z, turned.x, turned.y, turned.z);
            squares += error.dot(&(found.information * error)) / 6.0;
        }
        let mean: f64 = squares / 40.0;
        assert!((0.3..3.0).contains(&mean), "{mean}");
    }

    #[test]
    fn what_cannot_be_seen_stays_as_predicted() {
        let mut noise = Noise::new(1, 1);
        // One side alone: it may slide and turn about its normal.
        let flat: Vec<Sample> =
            sides(&mut noise, 2000, 0.0005).into_iter().filter(|s| s.normal.z > 0.5).collect();
        let mut surface = Surface::new(0.14);
        for capture in 0..2 {
            surface.add(capture, flat.iter().map(|s| (s.point, s.normal, s.deviation_m)));
        }
        let prior = Motion::at_rest(Vector3::new(0.0, 0.0, 0.005), PRIOR);
        let found = register(&surface, &Point3::origin(), &flat, None, &prior).unwrap();
        assert!((found.delta[2] + 0.005).abs() < 5e-4, "{}", found.delta);
        assert!(found.delta.fixed_rows::<2>(0).norm() < 3e-3, "{}", found.delta);
        let mut motion = prior.clone();
        motion.correct(&found.delta, &found.information).unwrap();
        assert!(motion.covariance[(0, 0)].sqrt() > 0.015);
        assert!(motion.covariance[(2, 2)].sqrt() < 0.001);
    }

    #[test]
    fn a_side_that_slides_along_itself_takes_its_middle_along() {
        let mut noise = Noise::new(1, 1);
        let flat: Vec<Sample> =
            sides(&mut noise, 2000, 0.0005).into_iter().filter(|s| s.normal.z > 0.5).collect();
        let mut surface = Surface::new(0.14);
        for capture in 0..2 {
            surface.add(capture, flat.iter().map(|s| (s.point, s.normal, s.deviation_m)));
        }
        let sum: Vector3<f64> = flat.iter().map(|sample| sample.point.coords.cast::<f64>()).sum();
        let from_centre = sum / flat.len() as f64;
        let middle = Middle { from_centre, deviation_m: 0.003 };
        let mut slid = flat.clone();
        slid.iter_mut().for_each(|sample| sample.point.x += 0.015);
        let prior = Motion::at_rest(Vector3::zeros(), PRIOR);
        let found = register(&surface, &Point3::origin(), &slid, Some(&middle), &prior).unwrap();
        assert!((found.delta[0] - 0.015).abs() < 0.003, "{}", found.delta);
    }

    #[test]
    fn nothing_and_something_else_give_no_pose() {
        let mut noise = Noise::new(2, 1);
        let surface = surface(&mut noise, 0.001);
        let prior = Motion::at_rest(Vector3::zeros(), PRIOR);
        assert!(register(&surface, &Point3::origin(), &[], None, &prior).is_none());
        let mut far = sides(&mut noise, 200, 0.001);
        far.iter_mut().for_each(|sample| sample.point.x += 5.0);
        assert!(register(&surface, &Point3::origin(), &far, None, &prior).is_none());
        let empty = Surface::new(0.1);
        assert!(register(&empty, &Point3::origin(), &far, None, &prior).is_none());
    }
}
