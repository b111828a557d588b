//! The structs and numbers of the tracker's border. Their names are those of the header.
#![allow(non_camel_case_types)]

use crate::types::{rf_plane, rf_pose};
use core::ffi::c_char;

/// Planes and gaps between clusters of the other pixels separate bodies.
pub const RF_SEGMENTATION_FOUND: u32 = 0;

/// Labels of the capture separate bodies. Captures without labels are segmented as with
/// RF_SEGMENTATION_FOUND.
pub const RF_SEGMENTATION_GIVEN: u32 = 1;

/// The model gets the observed surface of a unit alone.
pub const RF_COMPLETION_SEEN: u32 = 0;

/// Hidden sides are those that are seen, reflected in a point.
pub const RF_COMPLETION_MIRRORED: u32 = 1;

/// A unit that four fifths of its surface make a box, a cylinder or a ball is that; others are
/// mirrored.
pub const RF_COMPLETION_FITTED: u32 = 2;

/// Points of the last capture are the unit's own.
pub const RF_TRACK_SEEN: u32 = 1;

/// The unit is out of view or occluded: its pose is predicted.
pub const RF_TRACK_HIDDEN: u32 = 2;

/// The unit should be visible and is not: its pose is predicted, and its track ends soon.
pub const RF_TRACK_MISSED: u32 = 4;

/// The unit rests on a plane, a tabletop or another unit.
pub const RF_TRACK_SUPPORTED: u32 = 8;

/// The unit rests, and nothing is seen that it stands on: it is held still, in predictions too.
pub const RF_TRACK_HELD: u32 = 16;

/// Fewer than 4 points of the unit have been seen.
pub const RF_LEFT_OUT_POINTS: u32 = 1;

/// The unit was not seen for so long that its place is not known to within its own size.
pub const RF_LEFT_OUT_LOST: u32 = 2;

/// The velocity of the unit is not known well enough.
pub const RF_LEFT_OUT_UNCERTAIN: u32 = 3;

/// The longest horizon of rf_tracker_predict, seconds.
pub const RF_MAX_HORIZON_S: u32 = 10;

/// A tracker in memory of its own. The handle is a number, and no address.
pub struct rf_tracker {
    _opaque: [u8; 0],
}

/// What a tracker is made from. rf_tracker_defaults fills it.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct rf_tracker_options {
    /// As rf_tracker_defaults wrote it.
    pub abi_version: u32,
    /// RF_SEGMENTATION_...
    pub segmentation: u32,
    /// A packed model (.rfm) for rigid units, of any alignment; it is copied. NULL: that of
    /// model_path, or without both none, and then nothing is predicted.
    pub model: *const u8,
    /// Its length, bytes.
    pub model_bytes: usize,
    /// Path of a packed model, a text that ends with a zero; or NULL.
    pub model_path: *const c_char,
    /// (plane_count) the planes of the scene, at most RF_MAX_PLANES; they are copied. NULL: up to four
    /// are found.
    pub planes: *const rf_plane,
    /// How many. 0 with planes that are not NULL: the scene has none.
    pub plane_count: usize,
    /// Acceleration of free fall, m/s^2.
    pub gravity_m_s2: [f32; 3],
    /// Assumed density of units, kg/m^3, from 0.001 to 1e6. Ratios of masses alone matter.
    pub density_kg_m3: f32,
    /// Assumed friction of units, from 0 to 1000.
    pub unit_friction: f32,
    /// Assumed restitution of units, from 0 to 1000.
    pub unit_restitution: f32,
    /// Friction of planes that are found, from 0 to 1000.
    pub plane_friction: f32,
    /// Restitution of planes that are found, from 0 to 1000.
    pub plane_restitution: f32,
    /// Least diameter of a unit, metres: smaller clusters are noise.
    pub min_extent_m: f32,
    /// Largest diameter of a unit, metres: larger clusters are scenery.
    pub max_extent_m: f32,
    /// Standard deviation of a new unit's velocity, m/s.
    pub first_speed_m_s: f32,
    /// Standard deviation of a new unit's spin, rad/s.
    pub first_spin_rad_s: f32,
    /// Seconds that a unit may be hidden before its track ends, at least 0.
    pub hidden_s: f64,
    /// Captures that show a unit before it is reported, at least 1.
    pub confirm: u32,
    /// Consecutive captures that may miss a unit before its track ends.
    pub missed: u32,
    /// Units that are tracked, at most.
    pub max_units: u32,
    /// Clusters of a capture that are looked at, at most.
    pub max_clusters: u32,
    /// Points of a unit that the model gets, at most: 8 to 256.
    pub model_points: u32,
    /// How hidden sides are completed: RF_COMPLETION_...
    pub completion: u32,
    /// Seed of the search for planes.
    pub seed: u64,
}

/// A depth image and its camera, a pinhole without distortion: x to the right, y down, z forward.
/// Pixel (0, 0) is the top left one, and its middle is at (0, 0).
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct rf_depth_view {
    /// Pixels a row, from 1 to 8192.
    pub width: u32,
    /// Rows, from 1 to 8192.
    pub height: u32,
    /// Focal lengths along rows and columns, pixels, above 0.
    pub focal: [f32; 2],
    /// The principal point, pixels, within one image's size of the image.
    pub centre: [f32; 2],
    /// Carries the camera's frame to the world at that instant.
    pub camera: rf_pose,
    /// Metres a step of `depth`, from 1e-6 to 10: 0.001 where depths are millimetres.
    pub scale_m: f32,
    /// Zero.
    pub reserved: u32,
    /// (height, width) distance of the visible surface from the camera's plane, by rows from the top;
    /// 0: not measured.
    pub depth: *const u16,
    /// (height, width) label of the visible body, 0 for none. NULL: there are no labels.
    pub labels: *const u16,
}

/// Points of a scanner, or of several.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct rf_cloud_view {
    /// (point_count, 3) x, y, z in metres, in the world; each within 1e6 m.
    pub points: *const f32,
    /// How many points.
    pub point_count: usize,
    /// (point_count) label of each point's body, 0 for none. NULL: there are no labels.
    pub labels: *const u16,
    /// Where the sensor was, in the world, metres: surfaces face it.
    pub sensor: [f32; 3],
    /// 1 where `sensor` is known, else 0.
    pub has_sensor: u32,
}

/// The measurements of all sensors at one instant: their times differ by less than a millisecond.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct rf_capture {
    /// Seconds since any instant that all captures share; above that of the capture before.
    pub time_s: f64,
    /// (depth_count) depth images.
    pub depths: *const rf_depth_view,
    /// How many.
    pub depth_count: usize,
    /// (cloud_count) clouds.
    pub clouds: *const rf_cloud_view,
    /// How many.
    pub cloud_count: usize,
}

/// A unit that is followed. Matrices are by rows. Covariances are about the unit's centre.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct rf_track {
    /// Its own: no other unit of the tracker has it, or will have.
    pub id: u32,
    /// RF_TRACK_..., added up: one of the first three, and whether it rests.
    pub flags: u32,
    /// Carries its frame to the world.
    pub pose: rf_pose,
    /// Its centre, in its frame, metres.
    pub centre: [f32; 3],
    /// Its mass by its shape and the assumed density, kg; 0 before it has a shape.
    pub mass_kg: f32,
    /// Of the centre, m/s, then the spin, rad/s, in the world's axes.
    pub velocity: [f32; 6],
    /// Of the pose: translation, metres, then rotation, radians, in the world's axes.
    pub pose_covariance: [f32; 36],
    /// Of the velocity.
    pub velocity_covariance: [f32; 36],
}

/// What a capture was like.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct rf_capture_report {
    /// Units that are reported.
    pub units: u32,
    /// Units that the capture shows, with those that are not confirmed yet.
    pub seen: u32,
    /// Units that it confirmed.
    pub appeared: u32,
    /// Units whose tracks ended.
    pub given_up: u32,
    /// Clusters that were used.
    pub clusters: u32,
    /// Clusters that were left out because there were too many.
    pub clusters_left_out: u32,
    /// 1 where below a hundredth of an image's pixels have a depth.
    pub is_blind: u32,
    /// 1 where the model refused to predict the units, and free motion stood in for it.
    pub is_without_model: u32,
}

/// A forecast from the last capture on.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct rf_forecast {
    /// Seconds between steps.
    pub step_s: f64,
    /// Steps; the last one ends at the horizon.
    pub steps: u32,
    /// Units that are predicted.
    pub units: u32,
    /// Units that are not.
    pub left_out: u32,
    /// Zero.
    pub reserved: u32,
}

/// Where a unit will be.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct rf_prediction {
    /// Which unit.
    pub id: u32,
    /// After which step, from 1.
    pub step: u32,
    /// Carries the unit's frame to the world.
    pub pose: rf_pose,
}

/// A unit that is not predicted.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct rf_left_out {
    /// Which unit.
    pub id: u32,
    /// Why: RF_LEFT_OUT_...
    pub reason: u32,
}
