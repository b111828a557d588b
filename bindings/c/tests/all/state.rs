//! The state of a simulator and velocities of its units through the C functions.
// Handles are NULL or live here, and arrays as long as they say, unless a comment says otherwise.
#![allow(unsafe_code, clippy::undocumented_unsafe_blocks)]
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use crate::common::*;
use rigidformer_capi::edit::*;
use rigidformer_capi::ffi::*;
use rigidformer_capi::state::*;
use rigidformer_capi::types::rf_status::*;
use rigidformer_capi::types::*;
use std::ptr::{null, null_mut};

const DT_S: f32 = 1.0 / 24.0;

fn at(z: f32) -> rf_pose {
    rf_pose { position: [0.0, 0.0, z], quaternion: [0.0, 0.0, 0.0, 1.0] }
}

/// Two cubes, one of which falls onto the other.
fn scene(file: &[u8]) -> (Workspace, *mut rf_simulator, [rf_unit_id; 2]) {
    let limits = config(file, 4, 32);
    let mut workspace = Workspace::of(&limits);
    let handle = workspace.init(&limits);
    let points: [[f32; 3]; 8] =
        std::array::from_fn(|i| [1, 2, 4].map(|bit| if i & bit == 0 { -0.1 } else { 0.1 }));
    let unit = rf_unit {
        physics: rf_physics { mass_kg: 0.5, friction: 0.8, restitution: 0.7 },
        role: RF_ROLE_FREE,
        body: RF_OWN_BODY,
        points: points.as_ptr().cast(),
        point_count: points.len(),
        inertia_kg_m2: [0.0; 3],
        piece_points: null(),
        piece_counts: null(),
        piece_count: 0,
    };
    assert_eq!(unsafe { rf_set_dt(handle, DT_S) }, RF_OK);
    let ids = [0.1, 3.0].map(|z| {
        let mut id = 0;
        assert_eq!(unsafe { rf_add(handle, &unit, &at(z), &at(z), &mut id) }, RF_OK);
        id
    });
    (workspace, handle, ids)
}

fn bits(handle: *mut rf_simulator) -> Vec<u32> {
    let mut poses = [rf_internal_pose { rotation: [0.0; 9], centre: [0.0; 3] }; 4];
    assert_eq!(unsafe { rf_internal_poses(handle, poses.as_mut_ptr(), 4) }, RF_OK);
    poses
        .iter()
        .flat_map(|pose| {
            pose.rotation.map(f32::to_bits).into_iter().chain(pose.centre.map(f32::to_bits))
        })
        .collect()
}

fn go_on(handle: *mut rf_simulator) -> Vec<u32> {
    for _ in 0..if cfg!(miri) { 2 } else { 20 } {
        assert_eq!(unsafe { rf_step(handle, null_mut()) }, RF_OK);
    }
    bits(handle)
}

fn detail(handle: *mut rf_simulator) -> rf_detail {
    let mut detail =
        rf_detail { code: RF_OK, unit: 0, index: 0, reserved: 0, found: 0, expected: 0 };
    assert_eq!(unsafe { rf_last_error_detail(handle, &mut detail) }, RF_OK);
    detail
}

#[test]
fn a_state_goes_on_as_it_would_have() {
    let file = smallest();
    let (_first, handle, _) = scene(file);
    let (mut bytes, mut written) = (0, 0);
    unsafe {
        assert_eq!(rf_step(handle, null_mut()), RF_OK);
        assert_eq!(rf_state_bytes(handle, &mut bytes), RF_OK);
        let mut state = vec![0xa5_u8; bytes + 1];
        assert_eq!(rf_save(handle, state.as_mut_ptr(), bytes - 1, &mut written), RF_ERROR_BUFFER);
        assert!(state.iter().all(|byte| *byte == 0xa5) && written == 0);
        let room = detail(handle);
        assert_eq!((room.found, room.expected), (bytes as u64 - 1, bytes as u64));
        assert_eq!(rf_save(handle, state.as_mut_ptr(), bytes, &mut written), RF_OK);
        assert_eq!((written, state[bytes]), (bytes, 0xa5));
        state.truncate(bytes);
        let expected = go_on(handle);
        assert_eq!(rf_load(handle, state.as_ptr(), bytes), RF_OK);
        assert_eq!(go_on(handle), expected);
        // Another simulator, which has no units yet.
        let limits = config(file, 6, 64);
        let mut second = Workspace::of(&limits);
        let other = second.init(&limits);
        assert_eq!(rf_load(other, state.as_ptr(), bytes), RF_OK);
        assert_eq!(go_on(other), expected);
        // What cannot be changes nothing.
        let refused = |state: &[u8], code| {
            assert_eq!(rf_load(handle, state.as_ptr(), state.len()), code);
            assert_eq!(bits(handle), expected);
        };
        let stride = if cfg!(miri) { 61 } else { 1 };
        for length in (0..bytes).step_by(stride) {
            refused(&state[..length], RF_ERROR_STATE);
        }
        for byte in (8..bytes).step_by(stride) {
            let mut damaged = state.clone();
            damaged[byte] ^= 1;
            refused(&damaged, RF_ERROR_STATE);
        }
        let mut newer = state.clone();
        newer[4] += 1;
        refused(&newer, RF_ERROR_STATE_VERSION);
        assert_eq!((detail(handle).found, detail(handle).expected), (3, 2));
        let small = config(file, 1, 32);
        let mut third = Workspace::of(&small);
        let small = third.init(&small);
        assert_eq!(rf_load(small, state.as_ptr(), bytes), RF_ERROR_TOO_MANY_UNITS);
        // Making a model takes an interpreter long.
        if !cfg!(miri) {
            let another = model(SMALLEST_OF_ANOTHER);
            let limits = config(&another, 4, 32);
            let mut fourth = Workspace::of(&limits);
            let another = fourth.init(&limits);
            assert_eq!(rf_load(another, state.as_ptr(), bytes), RF_ERROR_STATE_MODEL);
        }
        assert_eq!(rf_save(handle, null_mut(), bytes, null_mut()), RF_ERROR_NULL);
        assert_eq!(rf_load(handle, null(), bytes), RF_ERROR_NULL);
        assert_eq!(rf_state_bytes(handle, null_mut()), RF_ERROR_NULL);
        assert_eq!(rf_save(handle, handle.cast(), bytes, null_mut()), RF_ERROR_OVERLAP);
    }
}

/// The smallest model at another frame rate.
const SMALLEST_OF_ANOTHER: rigidformer_weights::ModelConfig =
    rigidformer_weights::ModelConfig { frame_rate_hz: 120.0, ..SMALLEST };

#[test]
fn velocities_are_read_and_set() {
    let (_workspace, handle, [lower, upper]) = scene(smallest());
    let velocity = |linear_m_s, angular_rad_s| rf_velocity { linear_m_s, angular_rad_s };
    let none = velocity([0.0; 3], [0.0; 3]);
    let mut found = none;
    let near = |a: rf_velocity, b: rf_velocity| {
        let numbers = |v: rf_velocity| v.linear_m_s.into_iter().chain(v.angular_rad_s);
        numbers(a).zip(numbers(b)).all(|(a, b)| (a - b).abs() < 1e-3)
    };
    unsafe {
        let given =
            [velocity([0.5, 0.0, 1.0], [0.0, 2.0, 0.0]), velocity([0.0; 3], [1.0, 0.0, 0.0])];
        assert_eq!(rf_set_velocities(handle, given.as_ptr(), 2), RF_OK);
        let mut all = [none; 3];
        assert_eq!(rf_velocities(handle, all.as_mut_ptr(), 1), RF_ERROR_BUFFER);
        assert_eq!(rf_velocities(handle, all.as_mut_ptr(), 3), RF_OK);
        assert!(near(all[0], given[0]) && near(all[1], given[1]), "{all:?}");
        let up = velocity([0.0, 0.0, 3.0], [0.0; 3]);
        assert_eq!(rf_set_velocity(handle, upper, &up), RF_OK);
        assert_eq!(rf_unit_velocity(handle, upper, &mut found), RF_OK);
        assert!(near(found, up), "{found:?}");
        assert_eq!(rf_step(handle, null_mut()), RF_OK);
        assert_eq!(rf_unit_velocity(handle, upper, &mut found), RF_OK);
        // The model's gravity is 10 m/s^2.
        assert!(near(found, velocity([0.0, 0.0, 3.0 - 10.0 * DT_S], [0.0; 3])), "{found:?}");
        let whirl = velocity([0.0; 3], [0.0, 0.0, 80.0]);
        assert_eq!(rf_set_velocity(handle, lower, &whirl), RF_ERROR_BAD_VELOCITY);
        assert_eq!(detail(handle).found, lower);
        assert_eq!(rf_set_velocities(handle, given.as_ptr(), 1), RF_ERROR_BAD_VELOCITY);
        let nothing = velocity([f32::NAN, 0.0, 0.0], [0.0; 3]);
        assert_eq!(rf_set_velocity(handle, lower, &nothing), RF_ERROR_BAD_POSE);
        assert_eq!(rf_set_velocity(handle, 99, &up), RF_ERROR_NO_SUCH_ID);
        assert_eq!(rf_unit_velocity(handle, 99, &mut found), RF_ERROR_NO_SUCH_ID);
        assert_eq!(rf_set_velocity(handle, lower, null()), RF_ERROR_NULL);
        assert_eq!(rf_velocities(handle, null_mut(), 2), RF_ERROR_NULL);
        let mut centres = [rf_centre::default(); 2];
        assert_eq!(rf_centres(handle, centres.as_mut_ptr(), 1), RF_ERROR_BUFFER);
        assert_eq!(rf_centres(handle, null_mut(), 2), RF_ERROR_NULL);
        assert_eq!(rf_centres(handle, centres.as_mut_ptr(), 2), RF_OK);
        let mut poses = [rf_internal_pose { rotation: [0.0; 9], centre: [0.0; 3] }; 2];
        assert_eq!(rf_internal_poses(handle, poses.as_mut_ptr(), 2), RF_OK);
        for (rf_centre { x, y, z }, pose) in centres.into_iter().zip(poses) {
            assert_eq!([x, y, z].map(|v| v as f32), pose.centre);
        }
    }
}

#[test]
fn poses_with_w_first_are_taken_and_written() {
    let numbers = [1.0, 2.0, 3.0, 0.5, 0.1, 0.2, 0.3];
    let mut pose = rf_pose { position: [0.0; 3], quaternion: [0.0; 4] };
    let mut back = [0.0; 7];
    unsafe {
        assert_eq!(rf_pose_from_wxyz(numbers.as_ptr(), &mut pose), RF_OK);
        assert_eq!(rf_pose_to_wxyz(&pose, back.as_mut_ptr()), RF_OK);
        assert_eq!(rf_pose_from_wxyz(null(), &mut pose), RF_ERROR_NULL);
        assert_eq!(rf_pose_to_wxyz(&pose, null_mut()), RF_ERROR_NULL);
        let odd = numbers.as_ptr().cast::<u8>().add(1).cast();
        assert_eq!(rf_pose_from_wxyz(odd, &mut pose), RF_ERROR_ALIGNMENT);
    }
    assert_eq!((pose.position, pose.quaternion), ([1.0, 2.0, 3.0], [0.1, 0.2, 0.3, 0.5]));
    assert_eq!(back, numbers);
}
