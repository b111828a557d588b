//! Rest: a hypothesis that is held until motion is measured.

use nalgebra::{Isometry3, Point3, Translation3};

use crate::motion::Motion;

/// Errors of poses that neighbouring pixels and captures share, beside the covariance: metres, and radii.
const SHARED_ERROR_M: f64 = 1.5e-3;
const SHARED_ERROR_RADII: f64 = 1e-2;
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
}

impl Anchor {
    /// Where a unit is first seen. One capture says nothing about motion, and rest is likelier.
    pub(super) fn new(motion: &Motion, centre: &Point3<f32>, time_s: f64) -> Self {
        Anchor { place: place(motion, centre), time_s, captures: 0, holds: true, moved: false }
    }

    /// Decides with one more pose that was measured.
    pub(super) fn see(
        &mut self,
        motion: &Motion,
        centre: &Point3<f32>,
        radius_m: f64,
        (now_s, is_occluded): (f64, bool),
    ) {
        let (off_m, since_s) = (self.off_m(motion, centre, radius_m), now_s - self.time_s);
        let (position, turn) = motion.pose_deviation();
        let shared = SHARED_ERROR_M + SHARED_ERROR_RADII * radius_m;
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
