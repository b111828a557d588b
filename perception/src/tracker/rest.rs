//! Rest: a hypothesis that is held until motion is measured.

use nalgebra::{Isometry3, Matrix6, Point3, Translation3, Vector3, Vector6};

use super::errors::{Errors, SHARED_ERROR_M, shared_m};
use crate::motion::{Candidate, Motion};
use crate::sampling::Sample;

/// Square of a displacement in its deviations beyond which a unit that rests may have left its place.
// Of errors as large as expected, one in a thousand is.
const LEFT_SQUARE: f64 = 22.0;
/// Share of the shared errors that is a deviation of theirs there.
const LEFT_SHARE: f64 = 0.25;
/// How much worse samples fit the place where a unit rests than where it was found, if it left.
// Where both fit, other pixels were taken to be its own, or a side slid along itself.
const MIN_MISFIT: f64 = 1.25;
/// Least cosine between the displacements of two captures that agree.
const AGREEING: f64 = 0.5;
/// Deviations that a displacement exceeds where it is motion.
const MOTION_DEVIATIONS: f64 = 3.0;
/// Deviation of a rotation from which it is unknown, radians.
const MAX_TURN_DEVIATION: f64 = 0.05;
/// A slower displacement is drift of the sensor, m/s.
const DRIFT_M_S: f64 = 2e-3;
/// Seconds and captures from which a unit that moved rests.
// At the top of a throw a body moves by a centimetre in this time.
const REST_S: f64 = 0.1;
const REST_CAPTURES: u32 = 2;
/// As `REST_S`, of a unit that is seen in part.
// What goes behind something else seems to stand at its edge.
const OCCLUDED_REST_S: f64 = 0.5;
/// Distance of an outline from where the unit came to rest beyond which it slides, radii.
// A side that slides along itself looks the same everywhere, and only its outline moves. Lost pixels at edges move it too.
const SLIDE_RADII: f64 = 0.08;
/// Ratios of samples between which outlines are of the same sides.
const SAME_OUTLINE: [f64; 2] = [0.85, 1.18];

/// How a capture sees a unit.
#[derive(Clone, Copy, Debug)]
pub(super) struct Seeing {
    pub(super) now_s: f64,
    /// In part, by something nearer or by the border of the image.
    pub(super) is_occluded: bool,
    /// How far the capture is from the planes of those before.
    pub(super) shift_m: f64,
}

/// The motion of a unit that rested, if the last capture is right. One capture is not enough: segments flicker.
#[derive(Clone, Debug)]
pub(super) struct Suspect {
    pub(super) moving: Candidate,
    /// Its displacement.
    pub(super) off: Vector6<f64>,
}

/// What a capture says of a unit that rested.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Verdict {
    Rests,
    /// It left its place if the next capture agrees.
    Suspected,
    /// It rests, and the sensor drifts.
    Drifts,
    Moves,
}

/// Where a unit rests, or last was when its displacement was motion.
#[derive(Clone, Debug)]
pub(super) struct Anchor {
    /// Carries the unit's points to the world.
    place: Isometry3<f64>,
    time_s: f64,
    /// Captures since then that agree.
    captures: u32,
    /// Whether rest is believed.
    pub(super) holds: bool,
    /// Whether the unit was seen to move.
    moved: bool,
    /// The centroid of the samples that showed all of it first, and how many they were.
    outline: Option<(Vector3<f64>, usize)>,
    /// How far the last capture shows it to have slid, beyond the limit.
    slid: Option<Vector3<f64>>,
}

impl Anchor {
    /// Where a unit is first seen. One capture says nothing about motion, and rest is likelier.
    pub(super) fn new(motion: &Motion, centre: &Point3<f32>, time_s: f64) -> Self {
        Anchor {
            place: place(motion, centre),
            time_s,
            captures: 0,
            holds: true,
            moved: false,
            outline: None,
            slid: None,
        }
    }

    /// Decides whether a unit that rests left its place, by the displacement that was measured and its information.
    pub(super) fn judge(
        &mut self,
        (off, information): (&Vector6<f64>, &Matrix6<f64>),
        misfit_at_rest: f64,
        suspect: Option<&Suspect>,
        radius_m: f64,
        Seeing { now_s, shift_m, .. }: Seeing,
    ) -> Verdict {
        // Of a unit that was seen once, nothing says that it ever rested.
        let is_new = self.captures == 0 && !self.moved;
        self.captures = self.captures.saturating_add(1);
        let limit_m = shared_m(radius_m, shift_m);
        let lengths = |off: &Vector6<f64>| {
            let turn = off.fixed_rows::<3>(3) * radius_m;
            Vector6::from_iterator(off.fixed_rows::<3>(0).iter().chain(turn.iter()).copied())
        };
        let errors = Errors::new(LEFT_SHARE * limit_m, radius_m);
        let left = errors.square(off, information) > LEFT_SQUARE && lengths(off).norm() > limit_m;
        if !left || misfit_at_rest < MIN_MISFIT {
            return Verdict::Rests;
        }
        let agrees = suspect.is_some_and(|suspect| {
            let (before, now) = (lengths(&suspect.off), lengths(off));
            before.dot(&now) > AGREEING * before.norm() * now.norm()
        });
        if !agrees && !is_new {
            return Verdict::Suspected;
        }
        // Sensors drift as they warm: the unit stays where it is seen.
        if lengths(off).norm() < DRIFT_M_S * self.since_s(now_s) {
            return Verdict::Drifts;
        }
        self.end(now_s);
        Verdict::Moves
    }

    /// Decides with one more pose that was measured.
    pub(super) fn see(
        &mut self,
        motion: &Motion,
        centre: &Point3<f32>,
        radius_m: f64,
        Seeing { now_s, is_occluded, shift_m }: Seeing,
    ) {
        let (off_m, since_s) = (self.off_m(motion, centre, radius_m), now_s - self.time_s);
        let (position, turn) = motion.pose_deviation();
        let shared = shared_m(radius_m, shift_m);
        let limit_m = shared + MOTION_DEVIATIONS * position.hypot(turn * radius_m).min(shared);
        if off_m <= limit_m {
            self.captures = self.captures.saturating_add(1);
            let needed_s = if is_occluded { OCCLUDED_REST_S } else { REST_S };
            let is_long = self.captures >= REST_CAPTURES && since_s >= needed_s;
            self.holds |= !self.moved || is_long;
            return;
        }
        // Sensors drift as they warm: the unit stays where it is seen.
        let drifts = self.holds && off_m < DRIFT_M_S * since_s;
        let fresh = Anchor::new(motion, centre, now_s);
        *self = Anchor { holds: drifts, moved: true, ..fresh };
    }

    /// Whether the samples of a unit that is seen as a whole have left the place where it rests.
    pub(super) fn slides(&mut self, own: &[Sample], radius_m: f64, shift_m: f64) -> bool {
        let sum: Vector3<f64> = own.iter().map(|sample| sample.point.coords.cast::<f64>()).sum();
        let mean = sum / own.len().max(1) as f64;
        let Some((first, count)) = self.outline else {
            self.outline = Some((mean, own.len()));
            return false;
        };
        let ratio = own.len() as f64 / count.max(1) as f64;
        // Neighbouring samples share most of their noise, so that their mean has about that of one.
        let noise = own.iter().map(|sample| f64::from(sample.deviation_m)).sum::<f64>();
        let noise_m = MOTION_DEVIATIONS * noise / own.len().max(1) as f64;
        let limit_m = SHARED_ERROR_M + SLIDE_RADII * radius_m + shift_m + noise_m;
        let off = mean - first;
        let is_off = (SAME_OUTLINE[0]..SAME_OUTLINE[1]).contains(&ratio) && off.norm() > limit_m;
        let before = std::mem::replace(&mut self.slid, is_off.then_some(off));
        is_off
            && before.is_some_and(|before| before.dot(&off) > AGREEING * before.norm() * off.norm())
    }

    /// Ends a rest. It begins again no sooner than after [`REST_S`].
    pub(super) fn end(&mut self, now_s: f64) {
        self.holds = false;
        self.captures = 0;
        self.time_s = now_s;
        self.moved = true;
        (self.outline, self.slid) = (None, None);
    }

    /// Rests where it is now. That it rested before counts.
    pub(super) fn rest_at(&mut self, motion: &Motion, centre: &Point3<f32>, now_s: f64) {
        *self = Anchor { moved: true, ..Anchor::new(motion, centre, now_s) };
    }

    /// Displacement of the centre, and of the surface by the rotation, metres.
    fn off_m(&self, motion: &Motion, centre: &Point3<f32>, radius_m: f64) -> f64 {
        let from = self.place * centre.cast::<f64>();
        // Of a ball no turn is seen.
        let is_seen = motion.pose_deviation().1 < MAX_TURN_DEVIATION;
        let turn = if is_seen { motion.rotation.angle_to(&self.place.rotation) } else { 0.0 };
        (motion.centre - from.coords).norm().hypot(turn * radius_m)
    }

    /// Seconds for which the unit has been here.
    pub(super) fn since_s(&self, now_s: f64) -> f64 {
        now_s - self.time_s
    }
}

fn place(motion: &Motion, centre: &Point3<f32>) -> Isometry3<f64> {
    let offset = motion.rotation * centre.coords.cast::<f64>();
    Isometry3::from_parts(Translation3::from(motion.centre - offset), motion.rotation)
}
