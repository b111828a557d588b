//! Predictions of a unit that exclude each other: it stays, it moves as the model says, or it flies freely. Captures tell which.

use nalgebra::Vector3;

use super::errors::Errors;
use super::rest::{Anchor, Seeing};
use super::unit::{Found, TrackedUnit};
use crate::forecast::PredictedUnit;
use crate::motion::{Candidate, Motion, ProcessNoise};
use crate::registration::{CentroidPrior, Registered, misfit, moved, register, register_at_rest};
use crate::sampling::Sample;

/// Samples that registration needs.
const MIN_REGISTERED_SAMPLES: usize = 10;
/// Ratio of scores from which a cluster's centroid replaces the prediction as start.
// The prediction is likelier where both fit about as well.
const MIN_SCORE_RATIO: f64 = 1.15;
/// Another prediction replaces the first where this many times as many samples are near the surface.
// A completed side may predict a contact that does not happen.
const OTHER_RATIO: f32 = 1.3;
/// Samples that another prediction needs for that.
const MIN_OTHER_SAMPLES: usize = 10;
/// Standard deviation of a predicted contact's effect, as a share of its difference from free motion.
const CONTACT_UNCERTAINTY: f64 = 0.5;

/// Deviations within which a unit that rested is searched: metres, radians.
const REACH: [f64; 2] = [0.03, 0.1];
/// Share of samples on a unit's surface below which registration also starts from their centroid.
// What slides along itself has few samples on it, and those fit.
const MIN_SHARE: f64 = 0.85;
/// The same of a unit that nothing touches or occludes: all of its samples are its own.
const MIN_OWN_SHARE: f64 = 0.95;
/// Deviation of a rotation that is searched from the centroid, radians.
const SEARCHED_TURN: f64 = 0.3;

impl TrackedUnit {
    /// Predicts its motion over `dt_s` from the capture at `last_s` on: stillness first where it rests, else the model's.
    pub(super) fn predict(
        &mut self,
        dt_s: f64,
        last_s: f64,
        gravity_m_s2: &Vector3<f32>,
        process_noise: ProcessNoise,
        model: Option<&PredictedUnit>,
    ) {
        let mut still = self.motion.clone();
        still.propagate_still(dt_s, self.anchor.since_s(last_s));
        let gravity = f64::from(gravity_m_s2.norm());
        // A body that falls is faster. Of captures that are far apart, registration does not reach from one end of a fall to the other.
        let may_stay = self.anchor.holds
            || 0.5 * gravity * dt_s * dt_s > REACH[0]
                && self.motion.linear.norm() < 0.5 * gravity * dt_s;
        self.unseen = may_stay.then(|| {
            let anchor = match self.anchor.holds {
                true => self.anchor.clone(),
                false => Anchor::new(&still, &self.centre, last_s),
            };
            (still.clone(), anchor)
        });
        let still = Candidate::still(still);
        let mut free = self.moving().0.clone();
        free.propagate_freely(dt_s, &gravity_m_s2.cast(), process_noise);
        let mut all = Vec::with_capacity(3);
        if let Some(moved) = model {
            let pose = moved.pose * self.model_frame().inverse();
            let predicted = Motion {
                centre: (pose * self.centre).coords.cast(),
                rotation: pose.rotation.cast(),
                linear: moved.linear.cast(),
                angular: moved.angular.cast(),
                covariance: free.covariance,
            };
            let mut motion = free.clone();
            motion.adopt_prediction(&predicted, CONTACT_UNCERTAINTY, dt_s);
            let velocity_lag_m_s2 = moved.velocity_lag_m_s2;
            all.push(Candidate { motion, velocity_lag_m_s2, is_still: false });
        }
        let velocity_lag_m_s2 = gravity_m_s2 * -0.5;
        all.push(Candidate { motion: free, velocity_lag_m_s2, is_still: false });
        if self.anchor.holds {
            all.insert(0, still);
        } else if may_stay {
            all.push(still);
        }
        let first = all.remove(0);
        self.motion = first.motion;
        self.velocity_lag_m_s2 = first.velocity_lag_m_s2;
        self.predicted_still = first.is_still;
        self.others = all;
    }

    /// Its motion if it moves: that which the last capture suspects, or its own.
    pub(super) fn moving(&self) -> (&Motion, Vector3<f32>) {
        match &self.suspect {
            Some(suspect) => (&suspect.moving.motion, suspect.moving.velocity_lag_m_s2),
            None => (&self.motion, self.velocity_lag_m_s2),
        }
    }

    fn candidate(&self) -> Candidate {
        Candidate {
            motion: self.motion.clone(),
            velocity_lag_m_s2: self.velocity_lag_m_s2,
            is_still: self.predicted_still,
        }
    }
}

/// Starts registration from another prediction where the samples fit that better. A completed side may cause a contact that does not
/// happen, and registration would then start far from the unit.
pub(super) fn prefer(unit: &mut TrackedUnit, samples: &[Sample]) {
    let (cell, radius) = (unit.surface.cell_m(), unit.radius_m());
    let is_elsewhere = |other: &Candidate| {
        let off = unit.motion.difference_to(&other.motion);
        let (place, turn) = (off.fixed_rows::<3>(0).norm(), off.fixed_rows::<3>(3).norm());
        // Predictions that agree to within a cell need no decision.
        place + f64::from(radius) * turn >= f64::from(cell)
    };
    let near = |motion: &Motion| {
        let (inverse, middle) = (motion.pose(&unit.centre).inverse(), motion.centre.cast());
        // Samples beyond the bounding sphere need no search.
        let reach = (radius + cell).powi(2);
        let beside = samples
            .iter()
            .filter(|sample| (sample.point.coords - middle).norm_squared() < reach)
            .filter_map(|sample| unit.surface.nearest(&(inverse * sample.point)));
        beside.filter(|near| near.square_m2 < cell * cell).count()
    };
    let elsewhere: Vec<usize> =
        (0..unit.others.len()).filter(|at| is_elsewhere(&unit.others[*at])).collect();
    if elsewhere.is_empty() {
        return;
    }
    let own = near(&unit.motion) as f32;
    let mut best: Option<(usize, usize)> = None;
    for at in elsewhere {
        let count = near(&unit.others[at].motion);
        if count as f32 > OTHER_RATIO * own
            && count >= MIN_OTHER_SAMPLES
            && best.is_none_or(|(_, most)| count > most)
        {
            best = Some((at, count));
        }
    }
    if let Some((at, _)) = best {
        let other = unit.others.swap_remove(at);
        // What was predicted is wrong: the first prediction's uncertainty counts its contact.
        let covariance = match unit.predicted_still || other.is_still {
            true => other.motion.covariance,
            false => unit.motion.covariance,
        };
        unit.motion = Motion { covariance, ..other.motion };
        unit.velocity_lag_m_s2 = other.velocity_lag_m_s2;
        unit.predicted_still = other.is_still;
        unit.others.clear();
    }
}

/// Ends the rest of a unit whose outline slides away, though its surface looks the same.
pub(super) fn leave_rest(
    unit: &mut TrackedUnit,
    own: &[Sample],
    dt_s: f64,
    Seeing { now_s, shift_m, .. }: Seeing,
) {
    let radius_m = f64::from(unit.radius_m());
    if !unit.predicted_still
        || own.len() < MIN_REGISTERED_SAMPLES
        || unit.others.is_empty()
        || !unit.anchor.slides(own, radius_m, shift_m)
    {
        return;
    }
    unit.anchor.end(now_s);
    let other = unit.others.remove(0);
    unit.motion = other.motion;
    unit.velocity_lag_m_s2 = other.velocity_lag_m_s2;
    unit.predicted_still = false;
    // How fast it slides is not known.
    let mut off = nalgebra::Vector6::zeros();
    off.fixed_rows_mut::<3>(0).fill(0.1 * radius_m);
    unit.motion.widen_for_impact(&off, dt_s.max(1e-3));
}

/// Registers a unit with its samples, from its prediction and from the matched cluster's centroid.
pub(super) fn register_unit(
    unit: &TrackedUnit,
    own: &[Sample],
    is_unobstructed: bool,
    shift_m: f64,
) -> Option<Found> {
    if own.len() < MIN_REGISTERED_SAMPLES {
        return None;
    }
    // Occlusion, or a neighbour, moves the centroid of the samples.
    let centroid = if is_unobstructed { unit.expected_centroid(own) } else { None };
    let mut prior = unit.candidate();
    let mut start = prior.motion.clone();
    if prior.is_still {
        // The search must reach a unit that begins to move. What the prediction claims counts afterwards.
        let reach = unit.others.iter().filter(|other| !other.is_still);
        start.covariance =
            reach.map(|other| other.motion.covariance).fold(start.covariance, |wide, other| {
                match wide.trace() < other.trace() {
                    true => other,
                    false => wide,
                }
            });
        for axis in 0..6 {
            start.covariance[(axis, axis)] += REACH[axis / 3].powi(2);
        }
    }
    let mut found = registered(unit, &start, own, centroid.as_ref(), is_unobstructed)?;
    if shift_m > 0.0 {
        let shift = Errors { position_m: shift_m, turn_rad: 0.0 };
        found.information = shift.widen(&found.information);
    }
    // A predicted contact may not happen, because hidden sides are completed by assumption. Another prediction replaces it where it is
    // likelier.
    let at = moved(&start, &found.delta);
    let place = unit.place_at_rest();
    // Whether it still rests is decided by other means.
    let is_told = |candidate: &Candidate| place.is_some() && candidate.is_still;
    let mut most = match is_told(&prior) {
        true => f64::NEG_INFINITY,
        false => prior.motion.likelihood(&found.delta, &found.information),
    };
    for other in unit.others.iter().filter(|other| !is_told(other)) {
        let delta = other.motion.difference_to(&at);
        let likelihood = other.motion.likelihood(&delta, &found.information);
        if likelihood > most {
            most = likelihood;
            (prior, found) = (other.clone(), Registered { delta, ..found });
        }
    }
    let misfit_of = |motion: &Motion| misfit(&unit.surface, &unit.centre, own, motion);
    let misfit_at_rest = place.map_or(0.0, |place| misfit_of(place) / misfit_of(&at).max(1e-3));
    Some(Found { prior, registered: found, at, misfit_at_rest })
}

/// A registration that starts at a prediction.
fn registered(
    unit: &TrackedUnit,
    prior: &Motion,
    own: &[Sample],
    centroid: Option<&CentroidPrior>,
    is_unobstructed: bool,
) -> Option<Registered> {
    let from = |shift: Vector3<f64>, start: &Motion| {
        let register = if unit.predicted_still { register_at_rest } else { register };
        let mut found = register(&unit.surface, &unit.centre, own, centroid, start)?;
        // The filter's prior is its own prediction, not the shifted start.
        for axis in 0..3 {
            found.delta[axis] += shift[axis];
        }
        Some(found)
    };
    let shifted = |shift: Vector3<f64>| Motion { centre: prior.centre + shift, ..prior.clone() };
    let starts = [Some(Vector3::zeros()), unit.centroid_shift].into_iter().flatten();
    let better = |ratio: f64| {
        move |first: Registered, second: Registered| {
            if score(&second) > ratio * score(&first) { second } else { first }
        }
    };
    let first = starts.filter_map(|shift| from(shift, &shifted(shift)));
    let mut best = first.reduce(better(MIN_SCORE_RATIO));
    let (least, ratio) = match is_unobstructed {
        true => (MIN_OWN_SHARE, 1.0),
        false => (MIN_SHARE, MIN_SCORE_RATIO),
    };
    if best.as_ref().is_none_or(|best| best.share < least) {
        let sum: Vector3<f64> = own.iter().map(|sample| sample.point.coords.cast::<f64>()).sum();
        let shift = sum / own.len() as f64 - (prior.centre + unit.visible_centroid);
        let mut start = shifted(shift);
        start.add_pose_noise(shift.norm(), SEARCHED_TURN);
        best = best.into_iter().chain(from(shift, &start)).reduce(better(ratio));
    }
    best.filter(|found| found.share > 0.3 && found.residual < 6.0)
}

fn score(found: &Registered) -> f64 {
    found.share / found.residual.max(1.0)
}
