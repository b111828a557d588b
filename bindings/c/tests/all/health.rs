//! What C is told of how far a unit's prediction may be believed.
// Handles are NULL or live here, and arrays as long as they say.
#![allow(unsafe_code, clippy::undocumented_unsafe_blocks)]
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use crate::common::*;
use rigidformer_capi::edit::*;
use rigidformer_capi::ffi::*;
use rigidformer_capi::health::*;
use rigidformer_capi::types::rf_status::*;
use rigidformer_capi::types::*;
use rigidformer_weights::{AlignedBuffer, ModelFile, ModelWriter, Quantity, Ranges};
use std::ffi::CStr;
use std::ptr::{null, null_mut};

/// The smallest model, which says that training saw speeds up to 1 m/s and nothing else of note.
fn ranged() -> AlignedBuffer {
    let file = ModelFile::parse(smallest()).unwrap();
    let mut ranges = Ranges { of: [[-1e6, 1e6]; Quantity::COUNT] };
    ranges.of[Quantity::Speed as usize] = [0.0, 1.0];
    let mut writer = ModelWriter::new("ranged", *file.config()).ranges(Some(ranges));
    for tensor in file.tensors() {
        writer = writer.tensor(tensor.name, tensor.shape, tensor.data);
    }
    AlignedBuffer::copy_of(&writer.finish().unwrap())
}

fn pose(x: f32) -> rf_pose {
    rf_pose { position: [x, 0.0, 5.0], quaternion: [0.0, 0.0, 0.0, 1.0] }
}

fn health(handle: *const rf_simulator, id: rf_unit_id) -> rf_health {
    let mut health = rf_health { known: 7, ..Default::default() };
    assert_eq!(unsafe { rf_unit_health(handle, id, &mut health) }, RF_OK);
    health
}

fn ids(handle: *const rf_simulator) -> [rf_unit_id; 3] {
    let mut ids = [0; 3];
    assert_eq!(unsafe { rf_unit_ids(handle, ids.as_mut_ptr(), 3) }, RF_OK);
    ids
}

#[test]
fn a_unit_that_is_too_fast_is_told_from_the_others() {
    let file = ranged();
    let config = config(&file, 3, 15);
    let mut workspace = Workspace::of(&config);
    let handle = workspace.init(&config);
    assert_eq!(Scene::new(3).observe(handle), RF_OK);
    let ids = ids(handle);
    let step = |speed: f32| unsafe {
        rf_set_poses(handle, ids[1], &pose(20.0 - speed * DT_S), &pose(20.0))
    };
    assert_eq!(step(0.5), RF_OK);
    let slow = health(handle, ids[1]);
    assert_eq!((slow.known, slow.outside, slow.quarantined), (1, 0, 0));
    assert!(slow.beyond < 0.0);
    assert_eq!(step(10.0), RF_OK);
    let fast = health(handle, ids[1]);
    assert_eq!((fast.known, fast.outside, fast.quantity), (1, 1, Quantity::Speed as u32));
    assert!((fast.value - 10.0).abs() < 1e-2 && (fast.beyond - 9.0).abs() < 1e-2);
    let name = unsafe { CStr::from_ptr(rf_quantity_string(fast.quantity)) };
    assert_eq!(name.to_str(), Ok("speed"));
    let unknown = unsafe { CStr::from_ptr(rf_quantity_string(RF_QUANTITIES)) };
    assert_eq!(unknown.to_str(), Ok("unknown quantity"));
}

#[test]
fn a_model_without_ranges_says_that_nothing_is_known() {
    let config = config(smallest(), 3, 15);
    let mut workspace = Workspace::of(&config);
    let handle = workspace.init(&config);
    assert_eq!(Scene::new(3).observe(handle), RF_OK);
    assert_eq!(health(handle, ids(handle)[0]), rf_health::default());
}

#[test]
fn quarantine_holds_what_diverges() {
    let config = config(smallest(), 3, 15);
    let mut workspace = Workspace::of(&config);
    let handle = workspace.init(&config);
    assert_eq!(Scene::new(3).observe(handle), RF_OK);
    let ids = ids(handle);
    let mut report = rf_step_report::default();
    assert_eq!(unsafe { rf_set_poses(handle, ids[1], &pose(-9e5), &pose(9e5)) }, RF_OK);
    assert_eq!(unsafe { rf_step(handle, &mut report) }, RF_ERROR_DIVERGED);
    assert_eq!(unsafe { rf_set_quarantine(handle, 1) }, RF_OK);
    assert_eq!(unsafe { rf_step(handle, &mut report) }, RF_OK);
    assert_eq!(report.quarantined_units, 1);
    assert_eq!(ids.map(|id| health(handle, id).quarantined), [0, 1, 0]);
    assert_eq!(unsafe { rf_set_poses(handle, ids[1], &pose(20.0), &pose(20.0)) }, RF_OK);
    assert_eq!(unsafe { rf_step(handle, &mut report) }, RF_OK);
    assert_eq!(report.quarantined_units, 0);
}

#[test]
fn innovation_counts_standard_deviations() {
    let (predicted, observed) = (pose(1.0), pose(1.002));
    let variances = [1e-6_f32; 6];
    let mut distance = -1.0;
    let call = |p: *const rf_pose, o: *const rf_pose, v: *const f32, d: *mut f32| unsafe {
        rf_innovation(p, o, v, d)
    };
    let v = variances.as_ptr();
    assert_eq!(call(&predicted, &observed, v, &mut distance), RF_OK);
    assert!((distance - 2.0).abs() < 1e-3, "{distance}");
    for at in 0..6 {
        for bad in [0.0, -1.0, f32::NAN, f32::INFINITY] {
            let mut variances = variances;
            variances[at] = bad;
            let status = call(&predicted, &observed, variances.as_ptr(), &mut distance);
            assert_eq!(status, RF_ERROR_BAD_VARIANCE);
        }
    }
    for bad in [f32::NAN, f32::INFINITY] {
        assert_eq!(call(&pose(bad), &observed, v, &mut distance), RF_ERROR_BAD_POSE);
        assert_eq!(call(&predicted, &pose(bad), v, &mut distance), RF_ERROR_BAD_POSE);
    }
    assert_eq!(call(null(), &observed, v, &mut distance), RF_ERROR_NULL);
    assert_eq!(call(&predicted, null(), v, &mut distance), RF_ERROR_NULL);
    assert_eq!(call(&predicted, &observed, null(), &mut distance), RF_ERROR_NULL);
    assert_eq!(call(&predicted, &observed, v, null_mut()), RF_ERROR_NULL);
}

#[test]
fn misuse_is_refused() {
    let config = config(smallest(), 3, 15);
    let mut workspace = Workspace::of(&config);
    let handle = workspace.init(&config);
    let mut found = rf_health::default();
    assert_eq!(unsafe { rf_unit_health(handle, 1, &mut found) }, RF_ERROR_NO_SUCH_ID);
    assert_eq!(unsafe { rf_unit_health(null(), 1, &mut found) }, RF_ERROR_NULL);
    assert_eq!(Scene::new(3).observe(handle), RF_OK);
    assert_eq!(unsafe { rf_unit_health(handle, ids(handle)[0], null_mut()) }, RF_ERROR_NULL);
    assert_eq!(unsafe { rf_set_quarantine(null_mut(), 1) }, RF_ERROR_NULL);
}
