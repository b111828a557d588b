//! What is believed of the units at an instant.

use std::sync::Arc;

use nalgebra::{Isometry3, Matrix6, Point3, Vector6};

/// What is believed of all units at an instant.
#[derive(Clone, Debug, PartialEq)]
pub struct Estimate {
    /// Of the capture, seconds.
    pub time_s: f64,
    /// By ascending number.
    pub units: Vec<UnitEstimate>,
}

/// What is believed of a unit.
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
    /// Points of its surface that have been seen so far, in its reference frame, metres. A unit whose sides come into view one after
    /// another gets more of them; none is moved.
    pub points: Arc<[Point3<f32>]>,
    /// How it was found in this capture.
    pub sight: Sight,
}

/// How a unit was found in a capture.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Sight {
    /// Points were seen that are its own.
    Seen,
    /// It lies outside of all views, or behind something: its pose is predicted.
    Hidden,
    /// It should have been seen and was not: its pose is predicted, and it is given up soon.
    Missed,
}
