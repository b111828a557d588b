//! The tracker of C is that of Rust, and refuses what a C program can do wrong.
#![cfg(not(miri))]
// Arrays are as long as they say, unless a comment says otherwise. Handles are numbers, and never read.
#![allow(unsafe_code, clippy::undocumented_unsafe_blocks)]
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use nalgebra::{Isometry3, Point3, Vector3};
use rigidformer_capi::tracker::ffi::*;
use rigidformer_capi::tracker::types::*;
use rigidformer_capi::types::rf_status::*;
use rigidformer_capi::types::*;
use rigidformer_perception::camera::Camera;
use rigidformer_perception::capture::{Capture, Cloud, DepthView, View};
use rigidformer_perception::estimate::{Rest, Visibility};
use rigidformer_perception::tracker::{Tracker, TrackerOptions};
use rigidformer_runtime::models::LoadedModel;
use rigidformer_weights::EDGE;
use std::ffi::{CStr, CString};
use std::ptr::{null, null_mut};

const SIZE: [u32; 2] = [160, 120];

/// A camera a metre above a floor looks straight down.
pub(crate) fn camera() -> Camera {
    let down =
        Isometry3::face_towards(&Point3::new(0.0, 0.0, 1.0), &Point3::origin(), &Vector3::y());
    Camera::new(SIZE, [140.0; 2], [80.0, 60.0], down).unwrap()
}

/// Tops of two boxes, 10 and 15 cm high: one slides, and one stands.
pub(crate) fn image(frame: usize) -> Vec<u16> {
    let inside = |at: usize, columns: std::ops::Range<usize>, rows: std::ops::Range<usize>| {
        columns.contains(&(at % 160)) && rows.contains(&(at / 160))
    };
    let depth = |at| match () {
        () if inside(at, 20 + frame..50 + frame, 40..75) => 900,
        () if inside(at, 100..130, 50..85) => 850,
        () => 1000,
    };
    (0..160 * 120).map(depth).collect()
}

pub(crate) fn view(camera: &Camera, depth: &[u16]) -> rf_depth_view {
    let pose = camera.pose();
    let q = pose.rotation.as_ref().coords;
    rf_depth_view {
        width: camera.size()[0],
        height: camera.size()[1],
        focal: camera.focal(),
        centre: camera.centre(),
        camera: rf_pose {
            position: pose.translation.vector.into(),
            quaternion: [q.x, q.y, q.z, q.w],
        },
        scale_m: 0.001,
        reserved: 0,
        depth: depth.as_ptr(),
        labels: null(),
    }
}

fn capture(time_s: f64, depths: &[rf_depth_view], clouds: &[rf_cloud_view]) -> rf_capture {
    rf_capture {
        time_s,
        depths: depths.as_ptr(),
        depth_count: depths.len(),
        clouds: clouds.as_ptr(),
        cloud_count: clouds.len(),
    }
}

/// A capture from arrays that last as long as the call.
pub(crate) fn observe(
    handle: *mut rf_tracker,
    time_s: f64,
    depths: &[rf_depth_view],
    clouds: &[rf_cloud_view],
) -> rf_status {
    unsafe { rf_tracker_observe(handle, &capture(time_s, depths, clouds), null_mut()) }
}

fn options() -> rf_tracker_options {
    let mut options = std::mem::MaybeUninit::uninit();
    assert_eq!(unsafe { rf_tracker_defaults(RF_ABI_VERSION, options.as_mut_ptr()) }, RF_OK);
    unsafe { options.assume_init() }
}

pub(crate) fn with_model() -> rf_tracker_options {
    rf_tracker_options { model: EDGE.as_ptr(), model_bytes: EDGE.len(), ..options() }
}

/// What comes of making one, with its text.
fn create(options: &rf_tracker_options) -> (*mut rf_tracker, rf_status, String) {
    let (mut handle, mut text) = (null_mut(), [1; 300]);
    let status = unsafe { rf_tracker_create(options, &mut handle, text.as_mut_ptr(), text.len()) };
    assert_eq!(handle.is_null(), status != RF_OK);
    let text = unsafe { CStr::from_ptr(text.as_ptr()) };
    (handle, status, text.to_str().unwrap().into())
}

fn message(handle: *const rf_tracker) -> String {
    let mut text = [1; 300];
    assert_eq!(unsafe { rf_tracker_message(handle, text.as_mut_ptr(), text.len()) }, RF_OK);
    unsafe { CStr::from_ptr(text.as_ptr()) }.to_str().unwrap().into()
}

/// A tracker that is destroyed at the end.
pub(crate) struct Owned(pub(crate) *mut rf_tracker);

impl Drop for Owned {
    fn drop(&mut self) {
        assert_eq!(rf_tracker_destroy(self.0), RF_OK);
    }
}

pub(crate) fn made(options: &rf_tracker_options) -> Owned {
    let (handle, status, text) = create(options);
    assert_eq!(status, RF_OK, "{text}");
    Owned(handle)
}

/// All that a function writes, read as a program would: how many first.
fn all<T: Clone>(read: impl Fn(*mut T, usize, *mut usize) -> rf_status, empty: T) -> Vec<T> {
    let mut count = 7;
    let status = read(null_mut(), 0, &mut count);
    assert_eq!(status, if count == 0 { RF_OK } else { RF_ERROR_BUFFER });
    let mut slots = vec![empty; count];
    assert_eq!(read(slots.as_mut_ptr(), count, &mut count), RF_OK);
    assert_eq!(slots.len(), count);
    slots
}

pub(crate) fn units(handle: *const rf_tracker) -> Vec<rf_track> {
    let empty = unsafe { std::mem::zeroed() };
    all(|slots, capacity, count| unsafe { rf_tracker_units(handle, slots, capacity, count) }, empty)
}

fn pose_of(pose: &Isometry3<f32>) -> rf_pose {
    let q = pose.rotation.as_ref().coords;
    rf_pose { position: pose.translation.vector.into(), quaternion: [q.x, q.y, q.z, q.w] }
}

/// Everything that can be read of the tracker equals what Rust's has.
fn assert_same(handle: *mut rf_tracker, rust: &mut Tracker) {
    let estimate = rust.estimate().clone();
    let units = units(handle);
    assert_eq!(units.len(), estimate.units.len());
    for (found, expected) in units.iter().zip(&estimate.units) {
        let mut flags = match expected.visibility {
            Visibility::Seen => RF_TRACK_SEEN,
            Visibility::Hidden => RF_TRACK_HIDDEN,
            Visibility::Missed => RF_TRACK_MISSED,
        };
        flags |= match expected.rest {
            Rest::Moving => 0,
            Rest::Supported => RF_TRACK_SUPPORTED,
            Rest::Held => RF_TRACK_HELD,
        };
        assert_eq!((found.id, found.flags), (expected.id, flags));
        assert_eq!(found.pose, pose_of(&expected.pose));
        assert_eq!(found.centre, <[f32; 3]>::from(rust.centre(found.id).unwrap()));
        assert_eq!(found.mass_kg, rust.physics(found.id).map_or(0.0, |physics| physics.mass_kg));
        assert_eq!(found.velocity, <[f32; 6]>::from(expected.velocity));
        for (found, expected) in [
            (&found.pose_covariance, &expected.covariance),
            (&found.velocity_covariance, &expected.velocity_covariance),
        ] {
            for (at, number) in found.iter().enumerate() {
                assert_eq!(number.to_bits(), expected[(at / 6, at % 6)].to_bits());
            }
        }
        let points = all(
            |slots: *mut [f32; 3], capacity, count| unsafe {
                rf_tracker_points(handle, found.id, slots.cast(), capacity, count)
            },
            [0.0; 3],
        );
        assert!(points.iter().eq(expected.points.iter().map(|point| &point.coords.data.0[0])));
        let shape = all(
            |slots: *mut [f32; 3], capacity, count| unsafe {
                rf_tracker_shape(handle, found.id, slots.cast(), capacity, count)
            },
            [0.0; 3],
        );
        let expected = rust.shape(found.id).unwrap_or_default();
        assert!(shape.iter().eq(expected.iter().map(|point| &point.coords.data.0[0])));
    }
    let planes = all(
        |slots, capacity, count| unsafe { rf_tracker_planes(handle, slots, capacity, count) },
        rf_plane { normal: [0.0; 3], offset_m: 0.0, friction: 0.0, restitution: 0.0 },
    );
    assert_eq!(planes.len(), rust.planes().len());
    for (found, expected) in planes.iter().zip(rust.planes()) {
        assert_eq!(found.normal, <[f32; 3]>::from(expected.normal));
        assert_eq!(
            [found.offset_m, found.friction, found.restitution],
            [expected.offset_m, expected.friction, expected.restitution]
        );
    }
    let expected = rust.predict(1.0).unwrap();
    let mut forecast = rf_forecast::default();
    assert_eq!(unsafe { rf_tracker_predict(handle, 1.0, &mut forecast) }, RF_OK);
    assert_eq!(forecast.step_s, expected.step_s);
    assert_eq!(forecast.steps as usize, expected.poses.len());
    assert_eq!(forecast.left_out as usize, expected.left_out.len());
    let empty = rf_prediction { id: 0, step: 0, pose: pose_of(&Isometry3::identity()) };
    let predictions = all(
        |slots, capacity, count| unsafe { rf_tracker_predictions(handle, slots, capacity, count) },
        empty,
    );
    let expected_poses = (1..).zip(&expected.poses).flat_map(|(step, poses)| {
        poses.iter().map(move |(id, pose)| rf_prediction { id: *id, step, pose: pose_of(pose) })
    });
    assert_eq!(predictions, expected_poses.collect::<Vec<_>>());
    assert_eq!(predictions.len(), forecast.steps as usize * forecast.units as usize);
    let left_out = all(
        |slots, capacity, count| unsafe { rf_tracker_left_out(handle, slots, capacity, count) },
        rf_left_out { id: 0, reason: 0 },
    );
    assert_eq!(left_out.len(), expected.left_out.len());
    assert!(left_out.iter().zip(&expected.left_out).all(|(one, (id, _))| one.id == *id));
}

pub(crate) fn rust_options(model: bool) -> TrackerOptions {
    let mut options = TrackerOptions::default();
    if model {
        options.model = Some(LoadedModel::embedded("edge", EDGE).unwrap().for_host().unwrap());
    }
    options
}

fn rust(model: bool) -> Tracker {
    Tracker::new(rust_options(model)).unwrap()
}

#[test]
fn depth_images_are_followed_as_rust_follows_them() {
    let (tracker, mut rust, camera) = (made(&with_model()), rust(true), camera());
    let mut most = 0;
    for frame in 0..12 {
        let (time_s, depth) = (frame as f64 / 30.0, image(frame));
        let mut report = rf_capture_report::default();
        let views = [view(&camera, &depth)];
        let capture = capture(time_s, &views, &[]);
        assert_eq!(unsafe { rf_tracker_observe(tracker.0, &capture, &mut report) }, RF_OK);
        let depth = DepthView::new(camera, 0.001, depth, None).unwrap();
        rust.observe(&Capture { time_s, views: vec![View::Depth(depth)] }).unwrap();
        assert_eq!(report.units as usize, rust.estimate().units.len());
        assert_eq!(report.seen as usize, rust.report().seen);
        assert_eq!((report.is_blind, report.is_without_model), (0, 0));
        assert_same(tracker.0, &mut rust);
        most = most.max(report.units);
    }
    assert!(most >= 2);
}

#[test]
fn clouds_are_followed_as_rust_follows_them() {
    let (tracker, mut rust, camera) = (made(&options()), rust(false), camera());
    for frame in 0..6 {
        let (time_s, depth) = (frame as f64 / 10.0, image(frame));
        let depth = DepthView::new(camera, 0.001, depth, None).unwrap();
        let pixels = (0..120).flat_map(|row| (0..160).map(move |column| (column, row)));
        let points: Vec<_> =
            pixels.step_by(3).map(|(column, row)| depth.point(column, row).unwrap()).collect();
        let cloud = rf_cloud_view {
            points: points.as_ptr().cast(),
            point_count: points.len(),
            labels: null(),
            sensor: [0.0, 0.0, 1.0],
            has_sensor: 1,
        };
        assert_eq!(observe(tracker.0, time_s, &[], &[cloud]), RF_OK);
        let sensor = Some(Point3::new(0.0, 0.0, 1.0));
        let cloud = Cloud { points, sensor, labels: None };
        rust.observe(&Capture { time_s, views: vec![View::Cloud(cloud)] }).unwrap();
        assert_same(tracker.0, &mut rust);
    }
    assert!(!units(tracker.0).is_empty());
}

/// A tracker that has followed some captures, and the time of the last.
fn running() -> (Owned, f64) {
    let (tracker, camera) = (made(&with_model()), camera());
    for frame in 0..4 {
        let depth = image(frame);
        let views = [view(&camera, &depth)];
        assert_eq!(observe(tracker.0, frame as f64 / 30.0, &views, &[]), RF_OK);
    }
    (tracker, 3.0 / 30.0)
}

#[test]
fn a_capture_that_cannot_be_changes_nothing() {
    let (tracker, last_s) = running();
    let (before, camera, depth) = (units(tracker.0), camera(), image(5));
    assert!(!before.is_empty());
    let good = view(&camera, &depth);
    let with = |change: &dyn Fn(&mut rf_depth_view)| {
        let mut view = good;
        change(&mut view);
        view
    };
    let images = [
        (with(&|view| view.width = 0), RF_ERROR_CAPTURE_CAMERA),
        (with(&|view| view.height = u32::MAX), RF_ERROR_CAPTURE_CAMERA),
        (with(&|view| view.focal[1] = 0.0), RF_ERROR_CAPTURE_CAMERA),
        (with(&|view| view.centre[0] = f32::NAN), RF_ERROR_CAPTURE_CAMERA),
        (with(&|view| view.camera.position[2] = f32::INFINITY), RF_ERROR_CAPTURE_CAMERA),
        (with(&|view| view.camera.quaternion = [0.0; 4]), RF_ERROR_CAPTURE_CAMERA),
        (with(&|view| view.camera.quaternion[0] = f32::NAN), RF_ERROR_CAPTURE_CAMERA),
        (with(&|view| view.scale_m = 0.0), RF_ERROR_CAPTURE_SCALE),
        (with(&|view| view.scale_m = f32::NAN), RF_ERROR_CAPTURE_SCALE),
        (with(&|view| view.depth = null()), RF_ERROR_NULL),
        (with(&|view| view.depth = view.depth.wrapping_byte_add(1)), RF_ERROR_ALIGNMENT),
    ];
    for (view, code) in images {
        // The second of two: the first is taken back, too.
        assert_eq!(observe(tracker.0, last_s + 0.1, &[good, view], &[]), code, "{view:?}");
        assert!(message(tracker.0).len() > 10);
    }
    let mut points = vec![[0.1_f32, 0.2, 0.3]; 40];
    points[7][1] = f32::NAN;
    let bad = |points: *const f32, point_count, has_sensor| rf_cloud_view {
        points,
        point_count,
        labels: null(),
        sensor: [f32::NAN; 3],
        has_sensor,
    };
    let start: *const f32 = points.as_ptr().cast();
    for (cloud, code) in [
        (bad(start, 40, 0), RF_ERROR_CAPTURE_POINT),
        (bad(start, 4, 1), RF_ERROR_CAPTURE_POINT),
        (bad(null(), 4, 0), RF_ERROR_NULL),
        (bad(start, usize::MAX / 8, 0), RF_ERROR_LENGTH),
    ] {
        assert_eq!(observe(tracker.0, last_s + 0.1, &[], &[cloud]), code);
    }
    for (time_s, views, code) in [
        (f64::NAN, &[good][..], RF_ERROR_CAPTURE_TIME),
        (last_s, &[good], RF_ERROR_CAPTURE_TIME),
        (-1.0, &[good], RF_ERROR_CAPTURE_TIME),
        (last_s + 0.1, &[], RF_ERROR_CAPTURE_EMPTY),
    ] {
        assert_eq!(observe(tracker.0, time_s, views, &[]), code);
    }
    let views = [good];
    let one = rf_capture { depths: null(), ..capture(last_s + 0.1, &views, &[]) };
    assert_eq!(unsafe { rf_tracker_observe(tracker.0, &one, null_mut()) }, RF_ERROR_NULL);
    assert_eq!(unsafe { rf_tracker_observe(tracker.0, null(), null_mut()) }, RF_ERROR_NULL);
    let mut forecast = rf_forecast::default();
    for horizon_s in [0.0, -1.0, 10.5, f64::NAN, f64::INFINITY] {
        let status = unsafe { rf_tracker_predict(tracker.0, horizon_s, &mut forecast) };
        assert_eq!(status, RF_ERROR_HORIZON);
        assert!(message(tracker.0).contains("at most 10"), "{}", message(tracker.0));
    }
    assert_eq!(units(tracker.0), before);
    // And it goes on.
    assert_eq!(observe(tracker.0, last_s + 1.0 / 30.0, &views, &[]), RF_OK);
}

#[test]
fn a_handle_that_is_none_is_refused() {
    let mut count = 0;
    let mut numbers = [0_u64; 64];
    // An array of the program, a number, a workspace's magic: none is looked into.
    let made_up =
        [numbers.as_mut_ptr().cast(), std::ptr::without_provenance_mut(3), usize::MAX as _];
    let dead = {
        let owned = made(&options());
        owned.0
    };
    for handle in made_up.into_iter().chain([dead]) {
        let handle: *mut rf_tracker = handle;
        assert_eq!(unsafe { rf_tracker_units(handle, null_mut(), 0, &mut count) }, RF_ERROR_HANDLE);
        assert_eq!(unsafe { rf_tracker_observe(handle, null(), null_mut()) }, RF_ERROR_HANDLE);
        assert_eq!(rf_tracker_destroy(handle), RF_ERROR_HANDLE);
    }
    assert_eq!(rf_tracker_destroy(null_mut()), RF_ERROR_NULL);
    assert_eq!(unsafe { rf_tracker_planes(null(), null_mut(), 0, &mut count) }, RF_ERROR_NULL);
}

#[test]
fn outputs_are_checked() {
    let (tracker, _) = running();
    let count: *mut usize = null_mut();
    assert_eq!(unsafe { rf_tracker_units(tracker.0, null_mut(), 0, count) }, RF_ERROR_NULL);
    let mut count = 0;
    assert_eq!(unsafe { rf_tracker_units(tracker.0, null_mut(), 1, &mut count) }, RF_ERROR_NULL);
    let slot: *mut rf_track = std::ptr::without_provenance_mut(6);
    assert_eq!(unsafe { rf_tracker_units(tracker.0, slot, 1, &mut count) }, RF_ERROR_ALIGNMENT);
    let status = unsafe { rf_tracker_points(tracker.0, 999, null_mut(), 0, &mut count) };
    assert_eq!(status, RF_ERROR_NO_SUCH_TRACK);
    assert!(message(tracker.0).contains("999"));
    let status = unsafe { rf_tracker_shape(tracker.0, 0, null_mut(), 0, &mut count) };
    assert_eq!(status, RF_ERROR_NO_SUCH_TRACK);
    // A text is cut, and ends with a zero.
    for capacity in 0..12 {
        let mut text = [7; 16];
        let status = unsafe { rf_tracker_message(tracker.0, text.as_mut_ptr(), capacity) };
        assert_eq!(status, RF_OK);
        assert!(text[capacity..].iter().all(|byte| *byte == 7));
        if let Some(last) = capacity.checked_sub(1) {
            assert_eq!(text[last], 0);
        }
    }
}

#[test]
fn options_that_cannot_be_are_refused_with_a_remedy() {
    let missing = CString::new("/nowhere/at all.rfm").unwrap();
    let planes =
        [rf_plane { normal: [0.0, 0.0, 2.0], offset_m: 0.0, friction: 0.5, restitution: 0.0 }; 9];
    // A model that takes commands.
    let walking = concat!(env!("CARGO_MANIFEST_DIR"), "/../../weights/models/g1.rfm");
    let walking = CString::new(walking).unwrap();
    let good = options();
    let cut = rf_tracker_options { model_bytes: EDGE.len() - 1, ..with_model() };
    for (options, code, text) in [
        (rf_tracker_options { confirm: 0, ..good }, RF_ERROR_TRACKER_OPTION, "at least 1"),
        (rf_tracker_options { model_points: 7, ..good }, RF_ERROR_TRACKER_OPTION, "8 to 256"),
        (rf_tracker_options { hidden_s: f64::NAN, ..good }, RF_ERROR_TRACKER_OPTION, "hidden_s"),
        (rf_tracker_options { density_kg_m3: 0.0, ..good }, RF_ERROR_TRACKER_OPTION, "density"),
        (rf_tracker_options { min_extent_m: 9.0, ..good }, RF_ERROR_TRACKER_OPTION, "extents"),
        (rf_tracker_options { segmentation: 2, ..good }, RF_ERROR_TRACKER_OPTION, "segmentation"),
        (rf_tracker_options { completion: 3, ..good }, RF_ERROR_TRACKER_OPTION, "completion"),
        (
            rf_tracker_options { gravity_m_s2: [f32::NAN; 3], ..good },
            RF_ERROR_TRACKER_OPTION,
            "gravity",
        ),
        (
            rf_tracker_options { planes: planes.as_ptr(), plane_count: 9, ..good },
            RF_ERROR_TRACKER_OPTION,
            "8 or fewer",
        ),
        (
            rf_tracker_options { planes: planes.as_ptr(), plane_count: 1, ..good },
            RF_ERROR_TRACKER_OPTION,
            "length 1",
        ),
        (rf_tracker_options { plane_count: 1, ..good }, RF_ERROR_NULL, ""),
        (rf_tracker_options { abi_version: 0, ..good }, RF_ERROR_ABI, "RF_ABI_VERSION"),
        (cut, RF_ERROR_MODEL_LENGTH, "model"),
        (
            rf_tracker_options { model_path: walking.as_ptr(), ..good },
            RF_ERROR_TRACKER_OPTION,
            "commands",
        ),
        (
            rf_tracker_options { model_path: missing.as_ptr(), ..good },
            RF_ERROR_MODEL_FILE,
            "at all.rfm",
        ),
        (
            rf_tracker_options { model_path: missing.as_ptr(), ..with_model() },
            RF_ERROR_TRACKER_OPTION,
            "not both",
        ),
    ] {
        let (_, status, said) = create(&options);
        assert_eq!(status, code, "{said}");
        assert!(said.contains(text), "{said}");
    }
    let status = unsafe { rf_tracker_create(null(), null_mut(), null_mut(), 0) };
    assert_eq!(status, RF_ERROR_NULL);
    let mut options = options();
    assert_eq!(unsafe { rf_tracker_defaults(4, &mut options) }, RF_ERROR_ABI);
    assert_eq!(unsafe { rf_tracker_defaults(RF_ABI_VERSION, null_mut()) }, RF_ERROR_NULL);
    // No planes at all are something else than planes that are to be found.
    drop(made(&rf_tracker_options { planes: planes.as_ptr(), plane_count: 0, ..good }));
}

/// A model from a path, and from memory of any alignment, which need not stay.
#[test]
fn a_model_is_copied() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a model ä.rfm");
    std::fs::write(&path, &**EDGE).unwrap();
    let name = CString::new(path.to_str().unwrap()).unwrap();
    let from_file = made(&rf_tracker_options { model_path: name.as_ptr(), ..options() });
    drop((folder, name));
    let from_memory = {
        let bytes: Vec<u8> = std::iter::once(0).chain(EDGE.iter().copied()).collect();
        let model = bytes[1..].as_ptr();
        made(&rf_tracker_options { model, model_bytes: EDGE.len(), ..options() })
    };
    let camera = camera();
    let predicted = [from_file, from_memory].map(|tracker| {
        for frame in 0..5 {
            let depth = image(frame);
            let views = [view(&camera, &depth)];
            assert_eq!(observe(tracker.0, frame as f64 / 30.0, &views, &[]), RF_OK);
        }
        let mut forecast = rf_forecast::default();
        assert_eq!(unsafe { rf_tracker_predict(tracker.0, 0.5, &mut forecast) }, RF_OK);
        assert!(forecast.steps == 12 && forecast.units > 0, "{forecast:?}");
        units(tracker.0)
    });
    assert_eq!(predicted[0], predicted[1]);
}
