//! The pose of a unit from points without correspondences: trimmed point-to-plane ICP with a covariance.
//!
//! Each measured point corresponds to the nearest surfel of the unit's surface, and its residual is the distance along that surfel's normal.
//! Gauss-Newton steps minimise the sum of squares, with the predicted pose and its covariance as one more observation. Unobservable
//! directions, such as the rotation of a ball, therefore stay as predicted. Outliers are trimmed.
//!
//! No crate fits: modern-icp has no covariance and no prior, and brings five crates. kornia-3d fits points to points and depends on
//! crates for images. threecrate's point-to-plane ICP has neither trimming by residuals nor a covariance, and brings ndarray, rstar and
//! two trees. kiddo searches the nearest surfels, which is most of the work.

use nalgebra::{Matrix6, Point3, Vector3, Vector6};

use super::motion::{Motion, matrix};
use super::sampling::Sample;
use super::surface::{Remembered, Surface};

/// Gauss-Newton steps, at most.
const MAX_STEPS: usize = 14;
/// Change of the pose at which the iteration has converged: m, rad.
const CONVERGED: f64 = 2e-5;
/// Correspondences that a pose needs.
// Six determine a pose; two more leave a residual.
const MIN_CORRESPONDENCES: usize = 8;
/// Least cosine between the normals of a correspondence.
// The nearest surfel of a thin body may be on the other side, whose normal is opposite.
const MIN_NORMAL_COSINE: f32 = 0.5;
/// Largest distance of a point from its surfel along the surface, cells.
// Surfels are about a cell apart. A point farther off lies beyond the known surface.
const MAX_TANGENTIAL_CELLS: f32 = 1.2;
/// Standard deviations beyond which a residual is an outlier.
const OUTLIER_DEVIATIONS: f64 = 3.0;
/// Deviation of a surfel beside that of its observations, metres.
// Surfels are planar, and surfaces are not.
const SURFACE_ROUGHNESS_M: f64 = 2e-4;
/// Share of the information below which a direction is unobservable.
// Errors of normals make a slide look observable. Their square, .09 rad squared, is the bound.
const MIN_OBSERVABLE_SHARE: f64 = 0.008;
/// Distance beyond the boundary of the known surface from which a point pulls the boundary towards it, up to [`MAX_BEYOND_CELLS`], cells.
// A side that slides along itself shows in its boundary alone.
const MIN_BEYOND_CELLS: f32 = 0.8;
const MAX_BEYOND_CELLS: f32 = 4.0;
/// Standard deviation of the boundary's position, cells.
// A cell is the resolution of the surface.
const BOUNDARY_CELLS: f64 = 1.0;
/// Weight of a point beyond the boundary.
// Neighbouring points show the same part of the boundary, and are not independent.
const BOUNDARY_WEIGHT: f64 = 0.1;
/// Square of a distance, in deviations, from which a sample is off.
const MAX_SQUARE: f64 = 20.0;
/// Largest number of correspondences that count as independent.
// Errors of the surface are the same from capture to capture, so more correspondences add no information.
const MAX_EFFECTIVE_CORRESPONDENCES: f64 = 150.0;

/// A registered pose.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Registered {
    /// Maximum a posteriori change of the prior's pose, in the world's axes about the centre: metres, then radians.
    pub(super) delta: Vector6<f64>,
    /// Of the points alone.
    pub(super) information: Matrix6<f64>,
    /// Directions that only a comparison with the capture before observes.
    pub(super) compared: Compared,
    /// Share of points with a correspondence.
    pub(super) share: f64,
    /// Root mean square of the residuals, in their expected deviations.
    pub(super) residual: f64,
}

/// Directions of the pose in which the surface matches itself. Outlines tell there how far a unit went since the capture before. Where it
/// was then stays as uncertain as it was.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Compared {
    /// Projects on them, where rotations are times the lever.
    directions: Matrix6<f64>,
    lever_m: f64,
}

impl Compared {
    /// What a covariance of the pose lacks of that of the capture before, in these directions.
    pub(super) fn lacks(&self, now: &Matrix6<f64>, before: &Matrix6<f64>) -> Matrix6<f64> {
        let scale =
            |lever: f64| Matrix6::from_diagonal(&Vector6::new(1.0, 1.0, 1.0, lever, lever, lever));
        let there = self.directions * scale(self.lever_m);
        let eigen = (there * (before - now) * there.transpose()).symmetric_eigen();
        let mut lack = Matrix6::zeros();
        for (value, axis) in eigen.eigenvalues.iter().zip(eigen.eigenvectors.column_iter()) {
            lack += axis * axis.transpose() * value.max(0.0);
        }
        let back = scale(1.0 / self.lever_m);
        back * lack * back
    }
}

/// A point and a surfel, linearised at a pose.
struct Correspondence {
    /// Distance along the normal, metres.
    distance: f64,
    /// Derivative of the distance by the pose.
    gradient: Vector6<f64>,
    /// Inverse of the expected variance.
    weight: f64,
    /// Whether it pulls the boundary: it counts in directions that other correspondences do not observe.
    is_boundary: bool,
}

/// Normal equations of the Gauss-Newton step.
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

    fn add(&mut self, correspondence: &Correspondence) {
        let Correspondence { gradient, weight, .. } = correspondence;
        // The matrix is symmetric: the other triangle is filled in the end.
        for column in 0..6 {
            for row in column..6 {
                self.h[(row, column)] += gradient[row] * gradient[column] * weight;
            }
        }
        self.b += gradient * (correspondence.distance * weight);
    }

    /// With the upper triangle as the lower one.
    fn filled(mut self) -> Self {
        self.h.fill_upper_triangle_with_lower_triangle();
        self
    }
}

/// Expected centroid of a unit's samples, relative to its centre. It counts in directions that nothing else observes: a side that slides
/// along itself takes the centroid of its samples with it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct CentroidPrior {
    pub(super) from_centre: Vector3<f64>,
    pub(super) deviation_m: f64,
}

impl CentroidPrior {
    /// Adds the distance of the samples' centroid from the expected one.
    fn add_to(&self, equations: &mut Equations, mean: &Vector3<f64>, at: &Motion) {
        let off = mean - at.centre - self.from_centre;
        let weight = 1.0 / (self.deviation_m * self.deviation_m);
        for axis in 0..3 {
            equations.h[(axis, axis)] += weight;
            equations.b[axis] += weight * off[axis];
        }
    }
}

/// Finds the pose at which samples lie on the surface, starting from `prior`. `centre` is that of `prior`, in the unit's frame. None where
/// too few samples have a correspondence.
pub(super) fn register(
    surface: &Surface,
    centre: &Point3<f32>,
    samples: &[Sample],
    centroid: Option<&CentroidPrior>,
    prior: &Motion,
) -> Option<Registered> {
    search(surface, centre, samples, centroid, (prior, false))
}

/// The same of a unit that rests: most of its samples are on its surface, and what is farther off is of something else.
pub(super) fn register_at_rest(
    surface: &Surface,
    centre: &Point3<f32>,
    samples: &[Sample],
    centroid: Option<&CentroidPrior>,
    prior: &Motion,
) -> Option<Registered> {
    search(surface, centre, samples, centroid, (prior, true))
}

fn search(
    surface: &Surface,
    centre: &Point3<f32>,
    samples: &[Sample],
    centroid: Option<&CentroidPrior>,
    (prior, rests): (&Motion, bool),
) -> Option<Registered> {
    let prior_information = prior.pose_covariance().try_inverse()?;
    let mut delta = Vector6::<f64>::zeros();
    let (position, turn) = prior.pose_deviation();
    // A rotation moves the surface by about its radius times the angle.
    let lever = f64::from(surface.radius_m());
    // The first iterations accept residuals up to twice the deviation of the prediction.
    let mut gate = Gate { extra_m: (2.0 * (position + lever * turn)).min(0.5 * lever), scale: 1.0 };
    let sum: Vector3<f64> = samples.iter().map(|sample| sample.point.coords.cast::<f64>()).sum();
    let mean = sum / samples.len().max(1) as f64;
    let mut correspondences = Vec::with_capacity(samples.len());
    let mut nearest = vec![Remembered::NONE; samples.len()];
    let mut last = None;
    for step in 0..MAX_STEPS {
        let at = moved(prior, &delta);
        let matched = (samples, nearest.as_mut_slice());
        find_correspondences(surface, centre, matched, &at, &gate, &mut correspondences);
        let on_surface =
            correspondences.iter().filter(|correspondence| !correspondence.is_boundary).count();
        if on_surface < MIN_CORRESPONDENCES.min(samples.len()) || on_surface < 4 {
            return last;
        }
        let scale = median_scale(&mut correspondences);
        let limit = OUTLIER_DEVIATIONS * scale;
        let (mut all, mut boundary) = (Equations::none(), Equations::none());
        let (mut square, mut kept) = (0.0, 0.0);
        for correspondence in &correspondences {
            if correspondence.is_boundary {
                boundary.add(correspondence);
                continue;
            }
            let deviations = correspondence.distance.abs() * correspondence.weight.sqrt();
            // Trimming alone would drop a whole side that is off while all others fit, so early iterations accept more.
            if deviations > limit + gate.extra_m * correspondence.weight.sqrt() {
                continue;
            }
            all.add(correspondence);
            square += deviations * deviations;
            kept += 1.0;
        }
        let residual = (square / f64::max(kept - 6.0, 1.0)).sqrt();
        // Larger residuals than expected, and errors that neighbours share, lower the information.
        let confidence =
            f64::min(1.0, MAX_EFFECTIVE_CORRESPONDENCES / kept) / residual.max(1.0).powi(2);
        let mut boundary = boundary.filled().times(BOUNDARY_WEIGHT);
        if let Some(centroid) = centroid {
            centroid.add_to(&mut boundary, &mean, &at);
        }
        let (Equations { h, b }, compared) =
            observable_part(&all.filled().times(confidence), &boundary, (0.5 * lever).max(1e-6));
        let change = (h + prior_information).cholesky()?.solve(&(b - prior_information * delta));
        // Rotations are linearised, which holds up to about .3 rad: larger steps are shortened.
        let share = (0.3 / change.fixed_rows::<3>(3).norm()).min(1.0);
        delta += change * share;
        // Degenerate normals make the equations overflow: no pose is better than a wrong one.
        if !delta.iter().all(|number| number.is_finite()) {
            return None;
        }
        last = Some(Registered {
            delta,
            information: h,
            compared,
            share: kept / samples.len() as f64,
            residual,
        });
        let (moves, turns) = (change.fixed_rows::<3>(0).norm(), change.fixed_rows::<3>(3).norm());
        // The gate shrinks in the first steps, so that small ones are no sign of convergence yet.
        if step > 1 && moves < CONVERGED && turns < CONVERGED {
            if !rests || gate.extra_m <= 0.0 {
                break;
            }
            // With an allowance for motion, what is beside the unit would count as on its surface, and far off.
            gate.extra_m = 0.0;
        }
        // Each step halves the allowance: the pose approaches the optimum.
        gate.extra_m *= 0.5;
        gate.scale = scale.clamp(1.0, 3.0);
    }
    last
}

/// How badly samples fit the surface at a pose: the mean square of their distances in expected deviations. Those that are off count as
/// [`MAX_SQUARE`].
pub(super) fn misfit(
    surface: &Surface,
    centre: &Point3<f32>,
    samples: &[Sample],
    at: &Motion,
) -> f64 {
    let mut correspondences = Vec::with_capacity(samples.len());
    let gate = Gate { extra_m: 0.0, scale: 1.0 };
    let mut nearest = vec![Remembered::NONE; samples.len()];
    let matched = (samples, nearest.as_mut_slice());
    find_correspondences(surface, centre, matched, at, &gate, &mut correspondences);
    let on = correspondences.iter().filter(|one| !one.is_boundary);
    let squares: Vec<f64> =
        on.map(|one| (one.distance * one.distance * one.weight).min(MAX_SQUARE)).collect();
    let off = samples.len().saturating_sub(squares.len()) as f64;
    (squares.iter().sum::<f64>() + MAX_SQUARE * off) / samples.len().max(1) as f64
}

/// Removes unobservable directions from the normal equations, and takes the boundary's there: a flat side may slide. Errors of normals
/// make a slide look slightly observable. Rotations times a lever have the same scale as translations, so that eigenvalues compare.
fn observable_part(all: &Equations, boundary: &Equations, lever: f64) -> (Equations, Compared) {
    let turn = 1.0 / lever;
    let scale = Matrix6::from_diagonal(&Vector6::new(1.0, 1.0, 1.0, turn, turn, turn));
    let scaled = scale * all.h * scale;
    let least = MIN_OBSERVABLE_SHARE * scaled.fixed_view::<3, 3>(0, 0).trace();
    let eigen = scaled.symmetric_eigen();
    let mut kept = Matrix6::zeros();
    for (value, axis) in eigen.eigenvalues.iter().zip(eigen.eigenvectors.column_iter()) {
        if *value > least {
            kept += axis * axis.transpose();
        }
    }
    let rest = Matrix6::identity() - kept;
    let back = Matrix6::from_diagonal(&Vector6::new(1.0, 1.0, 1.0, lever, lever, lever));
    let h = kept * scaled * kept + rest * scale * boundary.h * scale * rest;
    let h = back * h * back;
    let b = back * (kept * (scale * all.b) + rest * (scale * boundary.b));
    let compared = Compared { directions: rest, lever_m: lever };
    (Equations { h: (h + h.transpose()) * 0.5, b }, compared)
}

/// The prior with its pose changed by `delta`.
pub(super) fn moved(prior: &Motion, delta: &Vector6<f64>) -> Motion {
    let turn = nalgebra::UnitQuaternion::from_scaled_axis(delta.fixed_rows::<3>(3).into_owned());
    Motion {
        centre: prior.centre + delta.fixed_rows::<3>(0),
        rotation: turn * prior.rotation,
        ..prior.clone()
    }
}

/// Largest accepted distance of a point from its surfel.
struct Gate {
    extra_m: f64,
    scale: f64,
}

fn find_correspondences(
    surface: &Surface,
    centre: &Point3<f32>,
    (samples, nearest): (&[Sample], &mut [Remembered]),
    at: &Motion,
    gate: &Gate,
    correspondences: &mut Vec<Correspondence>,
) {
    correspondences.clear();
    let rotation = matrix(&at.rotation);
    let inverse = rotation.transpose().cast::<f32>();
    let origin = at.centre.cast::<f32>();
    let max_tangential = MAX_TANGENTIAL_CELLS * surface.cell_m() + gate.extra_m as f32;
    for (sample, remembered) in samples.iter().zip(nearest) {
        let local = Point3::from(inverse * (sample.point.coords - origin)) + centre.coords;
        // An empty surface has no correspondences.
        let Some(near) = surface.nearest_from(&local, remembered) else { return };
        let surfel = near.surfel;
        if (inverse * sample.normal).dot(&surfel.normal) < MIN_NORMAL_COSINE {
            continue;
        }
        let distance = f64::from(surfel.normal.dot(&(local - surfel.point)));
        let tangential = f64::from(near.square_m2) - distance * distance;
        let variance = f64::from(sample.deviation_m).powi(2)
            + 1.0 / f64::from(surfel.information)
            + SURFACE_ROUGHNESS_M * SURFACE_ROUGHNESS_M;
        let limit = OUTLIER_DEVIATIONS * 1.5 * gate.scale * variance.sqrt() + gate.extra_m;
        if distance.abs() > limit {
            continue;
        }
        // The derivative of a distance by a rotation is its moment about the centre.
        let arm = if surface.is_ball() { Vector3::zeros() } else { surfel.point - centre };
        let lever: Vector3<f64> = rotation * arm.cast::<f64>();
        let correspondence =
            |direction: Vector3<f64>, distance: f64, weight: f64, is_boundary: bool| {
                let (along, turning) = (direction, lever.cross(&direction));
                let gradient = [along.x, along.y, along.z, turning.x, turning.y, turning.z];
                Correspondence { distance, gradient: Vector6::from(gradient), weight, is_boundary }
            };
        let tangential = tangential.max(0.0).sqrt();
        if tangential < f64::from(max_tangential) {
            correspondences.push(correspondence(
                rotation * surfel.normal.cast::<f64>(),
                distance,
                1.0 / variance,
                false,
            ));
        }
        let cell = surface.cell_m();
        if tangential > f64::from(MIN_BEYOND_CELLS * cell)
            && tangential < f64::from(MAX_BEYOND_CELLS * cell)
        {
            let off = (local - surfel.point).cast::<f64>() - surfel.normal.cast::<f64>() * distance;
            let deviation = BOUNDARY_CELLS * f64::from(cell);
            let over = tangential - 0.5 * f64::from(cell);
            correspondences.push(correspondence(
                rotation * (off / tangential),
                over,
                1.0 / (deviation * deviation),
                true,
            ));
        }
    }
}

/// Robust standard deviation of the residuals by their median, in expected deviations; at least 1.
fn median_scale(correspondences: &mut [Correspondence]) -> f64 {
    let on_surface =
        correspondences.iter().filter(|correspondence| !correspondence.is_boundary).count();
    let size = |correspondence: &Correspondence| match correspondence.is_boundary {
        true => f64::MAX,
        false => correspondence.distance.abs() * correspondence.weight.sqrt(),
    };
    let middle = on_surface / 2;
    if on_surface == 0 {
        return 1.0;
    }
    let (_, median, _) =
        correspondences.select_nth_unstable_by(middle, |a, b| size(a).total_cmp(&size(b)));
    // 1.4826 medians of absolute values are a standard deviation of a normal distribution.
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
        Deviations { position_m: 0.02, turn_rad: 0.2, linear_m_s: 1.0, angular_rad_s: 2.0 };

    #[test]
    fn a_moved_box_is_found_with_an_honest_covariance() {
        let mut squares = 0.0;
        for seed in 0..40 {
            let mut noise = Noise::new(seed, 1);
            let surface = surface(&mut noise, 0.001);
            let turn = UnitQuaternion::from_scaled_axis(Vector3::new(0.08, -0.05, 0.1));
            let position = Vector3::new(0.3, 0.012, -0.009);
            let mut seen = sides(&mut noise, 300, 0.001);
            for sample in &mut seen {
                sample.point =
                    Point3::from(turn.cast::<f32>() * sample.point.coords + position.cast());
                sample.normal = turn.cast::<f32>() * sample.normal;
            }
            // A tenth of what is seen is something else.
            for sample in seen.iter_mut().take(30) {
                sample.point.z += 0.02 * noise.uniform();
            }
            let prior = Motion::at_rest(Vector3::new(0.3, 0.0, 0.0), PRIOR);
            let found = register(&surface, &Point3::origin(), &seen, None, &prior).unwrap();
            let at = moved(&prior, &found.delta);
            let off = at.centre - position;
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
        let centroid = CentroidPrior { from_centre, deviation_m: 0.003 };
        let mut slid = flat.clone();
        slid.iter_mut().for_each(|sample| sample.point.x += 0.015);
        let prior = Motion::at_rest(Vector3::zeros(), PRIOR);
        let found = register(&surface, &Point3::origin(), &slid, Some(&centroid), &prior).unwrap();
        assert!((found.delta[0] - 0.015).abs() < 0.003, "{}", found.delta);
    }

    #[test]
    fn where_only_outlines_tell_a_place_is_as_uncertain_as_before() {
        let mut noise = Noise::new(1, 1);
        let flat: Vec<Sample> =
            sides(&mut noise, 2000, 0.0005).into_iter().filter(|s| s.normal.z > 0.5).collect();
        let mut surface = Surface::new(0.14);
        surface.add(0, flat.iter().map(|s| (s.point, s.normal, s.deviation_m)));
        let sum: Vector3<f64> = flat.iter().map(|sample| sample.point.coords.cast::<f64>()).sum();
        let from_centre = sum / flat.len() as f64;
        let centroid = CentroidPrior { from_centre, deviation_m: 0.003 };
        let mut motion = Motion::at_rest(Vector3::zeros(), PRIOR);
        let before = motion.pose_covariance();
        let found = register(&surface, &Point3::origin(), &flat, Some(&centroid), &motion).unwrap();
        motion.correct(&found.delta, &found.information).unwrap();
        let now = motion.pose_covariance();
        assert!(now[(0, 0)].sqrt() < 0.005, "{}", now[(0, 0)].sqrt());
        let all = now + found.compared.lacks(&now, &before);
        // Along the side it is where it was taken to be; off the side it is measured.
        for (axis, most) in [(0, 0.022), (1, 0.022), (2, 0.001)] {
            let sd = all[(axis, axis)].sqrt();
            assert!((axis == 2 || sd > 0.018) && sd < most, "{axis} {sd}");
        }
        // What is more uncertain than before lacks nothing.
        assert!(found.compared.lacks(&(before * 2.0), &before).norm() < 1e-9);
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
