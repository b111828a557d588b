//! Estimated state of the units at an instant.

use std::sync::Arc;

use nalgebra::{Isometry3, Matrix6, Point3, Vector6};

/// Estimated state of all units at an instant.
#[derive(Clone, Debug, PartialEq)]
pub struct Estimate {
    /// Of the capture, seconds.
    pub time_s: f64,
    /// By ascending number.
    pub units: Vec<UnitEstimate>,
}

/// Estimated state of a unit.
#[derive(Clone, Debug, PartialEq)]
pub struct UnitEstimate {
    /// Its own: no other unit has it, or will have.
    pub id: u32,
    /// Carries its reference points to the world.
    pub pose: Isometry3<f32>,
    /// Of the pose: translation in metres, then rotation in radians, both in the world's axes about the unit's centre.
    pub covariance: Matrix6<f32>,
    /// Of its centre in m/s, then spin in rad/s, in the world's axes.
    pub velocity: Vector6<f32>,
    /// Of the velocity.
    pub velocity_covariance: Matrix6<f32>,
    /// Points of its observed surface, in its reference frame, metres. Sides that come into view add points; none is moved.
    pub points: Arc<[Point3<f32>]>,
    /// Whether this capture shows it.
    pub visibility: Visibility,
    /// Whether it rests, and on what.
    pub rest: Rest,
}

/// Whether a unit rests. Rest is a hypothesis: it is held until the unit's motion is measured beyond its covariance.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Rest {
    /// It moves, or nothing tells yet.
    #[default]
    Moving,
    /// It rests on a plane, a tabletop or another unit.
    Supported,
    /// It rests, and nothing is seen that it stands on. It is held still, in predictions too.
    Held,
}

/// Whether a capture shows a unit.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Visibility {
    /// Points of the capture are its own.
    Seen,
    /// It is out of view or occluded: its pose is predicted.
    Hidden,
    /// It should be visible and is not: its pose is predicted, and its track ends soon.
    Missed,
}
