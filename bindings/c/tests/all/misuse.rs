//! What a C program can do wrong gives a code, and leaves everything as it was.
// Handles are NULL or live here, and arrays as long as they say, unless a comment says otherwise.
#![allow(unsafe_code, clippy::undocumented_unsafe_blocks)]
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use crate::common::*;
use rigidformer_capi::ffi::*;
use rigidformer_capi::types::rf_status::*;
use rigidformer_capi::types::*;
use rigidformer_weights::AlignedBuffer;
use std::ffi::CStr;
use std::ptr::null_mut;

/// A simulator that observed two units and went a step, in memory of its own.
fn running(file: &[u8]) -> (Workspace, *mut rf_simulator) {
    let config = config(file, 2, 10);
    let mut workspace = Workspace::of(&config);
    let handle = workspace.init(&config);
    assert_eq!(Scene::new(2).observe(handle), RF_OK);
    assert_eq!(step(handle), RF_OK);
    (workspace, handle)
}

#[test]
fn a_workspace_must_be_as_large_as_was_asked_for() {
    let file = smallest();
    let config = config(file, 2, 10);
    let needed = Workspace::of(&config).bytes;
    assert_eq!(needed % RF_ALIGNMENT, 0);
    for bytes in [0, 1, 64, needed / 2, needed - 1] {
        let (_, detail) = Workspace::new(bytes).try_init(&config);
        assert_eq!((detail.code, detail.found), (RF_ERROR_MEMORY, bytes as u64));
        assert_eq!(detail.expected, needed as u64);
    }
    let mut exact = Workspace::new(needed);
    let handle = exact.init(&config);
    assert_eq!(Scene::new(2).observe(handle), RF_OK);
    assert_eq!(step(handle), RF_OK);
    assert!(exact.rim_is_whole());
}

#[test]
fn a_workspace_must_be_aligned_and_apart_from_the_model() {
    let file = smallest();
    let config = config(file, 2, 10);
    let mut workspace = Workspace::of(&config);
    let (mut handle, bytes) = (null_mut(), workspace.bytes);
    for off in [1, 4, 8] {
        let memory = unsafe { workspace.pointer().add(off) };
        let status =
            unsafe { rf_init(&config, memory.cast(), bytes - off, &mut handle, null_mut()) };
        assert_eq!((status, handle.is_null()), (RF_ERROR_ALIGNMENT, true));
    }
    // Refused before anything is written: the model is not writable here.
    let memory = file.as_ptr().cast_mut().cast();
    let status = unsafe { rf_init(&config, memory, bytes, &mut handle, null_mut()) };
    assert_eq!((status, handle.is_null()), (RF_ERROR_OVERLAP, true));
}

/// Handle and detail are written to: not into a simulator that goes on.
#[test]
fn what_init_writes_must_lie_outside_the_workspace() {
    let file = smallest();
    let (mut workspace, running) = running(file);
    let before = poses(running);
    let bytes = workspace.bytes;
    let memory = workspace.pointer();
    let config = config(file, 2, 10);
    let mut handle = null_mut();
    unsafe {
        let status = rf_init(&config, memory.cast(), bytes, memory.cast(), null_mut());
        assert_eq!(status, RF_ERROR_OVERLAP);
        let last = memory.add(bytes - 16);
        assert_eq!(
            rf_init(&config, memory.cast(), bytes, &mut handle, last.cast()),
            RF_ERROR_OVERLAP
        );
    }
    assert_eq!(poses(running), before);
    assert_eq!(step(running), RF_OK);
}

#[test]
fn null_is_refused_everywhere() {
    let file = smallest();
    let limits = config(file, 2, 10);
    let (mut workspace, handle) = running(file);
    let before = poses(handle);
    let (memory, bytes) = (workspace.pointer(), workspace.bytes);
    let (scene, mut size, mut out) = (Scene::new(2), 0, null_mut());
    let units = scene.units();
    let points: *const f32 = scene.previous.as_ptr().cast();
    let pose = [rf_pose { position: [0.0; 3], quaternion: [0.0, 0.0, 0.0, 1.0] }; 2];
    let null = null_mut;
    // SAFETY: handles are NULL or live, arrays NULL or as long as they say.
    unsafe {
        assert_eq!(rf_workspace_bytes(nothing(), &mut size), RF_ERROR_NULL);
        assert_eq!(rf_workspace_bytes(&limits, null_mut()), RF_ERROR_NULL);
        let no_model = rf_config { model: nothing(), ..limits };
        assert_eq!(rf_workspace_bytes(&no_model, &mut size), RF_ERROR_NULL);
        assert_eq!(rf_init(nothing(), memory.cast(), bytes, &mut out, null()), RF_ERROR_NULL);
        assert_eq!(rf_init(&no_model, memory.cast(), bytes, &mut out, null()), RF_ERROR_NULL);
        assert_eq!(rf_init(&limits, null_mut(), bytes, &mut out, null()), RF_ERROR_NULL);
        assert_eq!(rf_init(&limits, memory.cast(), bytes, null_mut(), null()), RF_ERROR_NULL);
        assert_eq!(rf_release(null_mut()), RF_ERROR_NULL);
        assert_eq!(rf_step(null_mut(), null_mut()), RF_ERROR_NULL);
        assert_eq!(scene.observe(null_mut()), RF_ERROR_NULL);
        assert_eq!(rf_observe(handle, DT_S, nothing(), points, points, null_mut()), RF_ERROR_NULL);
        for (a, b) in [(nothing(), points), (points, nothing())] {
            assert_eq!(rf_observe(handle, DT_S, &units, a, b, null_mut()), RF_ERROR_NULL);
        }
        for bad in [
            rf_units { physics: nothing(), ..units },
            rf_units { point_counts: nothing(), ..units },
        ] {
            assert_eq!(rf_observe(handle, DT_S, &bad, points, points, null_mut()), RF_ERROR_NULL);
        }
        for (a, b) in [(nothing(), pose.as_ptr()), (pose.as_ptr(), nothing())] {
            let status = rf_observe_poses(handle, DT_S, &units, points, a, b, null_mut());
            assert_eq!(status, RF_ERROR_NULL);
        }
        assert_eq!(rf_set_command(handle, nothing(), 1), RF_ERROR_NULL);
        assert_eq!(rf_unit_count(handle, null_mut()), RF_ERROR_NULL);
        assert_eq!(rf_poses(handle, null_mut(), 2), RF_ERROR_NULL);
        assert_eq!(rf_internal_poses(handle, null_mut(), 2), RF_ERROR_NULL);
        assert_eq!(rf_points(handle, 0, null_mut(), 5, &mut size), RF_ERROR_NULL);
        assert_eq!(rf_points(handle, 0, null_mut(), 0, null_mut()), RF_ERROR_NULL);
        assert_eq!(rf_last_error_detail(handle, null_mut()), RF_ERROR_NULL);
        let id = ids(handle)[0];
        assert_eq!(rf_unit_ids(handle, null_mut(), 2), RF_ERROR_NULL);
        assert_eq!(rf_unit_pose(handle, id, null_mut()), RF_ERROR_NULL);
        assert_eq!(rf_points(handle, 0, null_mut(), 0, &mut size), RF_ERROR_BUFFER);
        assert_eq!(size, 5, "what there would have been");
    }
    assert_eq!(poses(handle), before, "a refused call changes nothing, not even rf_init's");
}

#[test]
fn what_is_no_simulator_is_told_from_one() {
    let file = smallest();
    let (mut workspace, handle) = running(file);
    // Zeros.
    let mut zeros = Workspace::new(512);
    unsafe { zeros.pointer().write_bytes(0, 512) };
    assert_eq!(step(zeros.pointer().cast()), RF_ERROR_HANDLE);
    // Not where a workspace can be.
    assert_eq!(step(handle.wrapping_byte_add(4)), RF_ERROR_HANDLE);
    // Released, and made again in the same place.
    assert_eq!(step(handle), RF_OK);
    assert_eq!(unsafe { rf_release(handle) }, RF_OK);
    assert_eq!(step(handle), RF_ERROR_HANDLE);
    assert_eq!(unsafe { rf_release(handle) }, RF_ERROR_HANDLE);
    let handle = workspace.init(&config(file, 2, 10));
    assert_eq!(step(handle), RF_ERROR_NOT_OBSERVED);
    assert_eq!(detail(handle).code, RF_ERROR_NOT_OBSERVED);
    // A copy: its parts would refer to the original. Last, since nobody else may touch a
    // workspace that is in use.
    let mut copy = Workspace::new(workspace.bytes);
    unsafe { copy.pointer().copy_from_nonoverlapping(workspace.pointer(), workspace.bytes) };
    assert_eq!(step(copy.pointer().cast()), RF_ERROR_HANDLE);
}

/// Models that are none.
#[test]
fn bad_models_are_named() {
    let sound = smallest();
    let limits = config(sound, 2, 10);
    let (mut workspace, handle) = running(sound);
    let before = poses(handle);
    let mut refused = |bytes: &[u8], code: rf_status| {
        let bad = rf_config { model: bytes.as_ptr(), model_bytes: bytes.len(), ..limits };
        let (_, detail) = workspace.try_init(&bad);
        assert_eq!(detail.code, code, "{detail:?}");
        let mut size = 7;
        assert_eq!(unsafe { rf_workspace_bytes(&bad, &mut size) }, code);
        assert_eq!(size, 7);
        detail
    };
    let changed = |change: &dyn Fn(&mut [u8])| {
        let mut bytes = sound.to_vec();
        change(&mut bytes);
        AlignedBuffer::copy_of(&bytes)
    };
    refused(&AlignedBuffer::copy_of(b"This is not a model."), RF_ERROR_MODEL_MAGIC);
    refused(&[], RF_ERROR_MODEL_LENGTH);
    let newer = refused(&changed(&|bytes| bytes[8] = 11), RF_ERROR_MODEL_VERSION);
    // 1 in the library itself; tests are built with what hosts read.
    assert_eq!((newer.found, newer.expected), (11, rigidformer_weights::VERSION.into()));
    let cut = refused(&sound[..sound.len() - 64], RF_ERROR_MODEL_LENGTH);
    assert_eq!((cut.found + 64, cut.expected), (sound.len() as u64, sound.len() as u64));
    refused(&changed(&|bytes| *bytes.last_mut().unwrap() ^= 1), RF_ERROR_MODEL_CHECKSUM);
    let mut shifted = Workspace::new(sound.len() + 16);
    let shifted = unsafe {
        let at = shifted.pointer().add(4);
        at.copy_from_nonoverlapping(sound.as_ptr(), sound.len());
        std::slice::from_raw_parts(at, sound.len())
    };
    assert_eq!(refused(shifted, RF_ERROR_MODEL_ALIGNMENT).found, 4);
    assert_eq!(poses(handle), before, "the simulator that was there goes on");
    assert_eq!(step(handle), RF_OK);
}

#[test]
fn limits_and_versions_are_checked() {
    let file = smallest();
    let limits = config(file, 2, 10);
    let mut size = 0;
    let mut status = |config| unsafe { rf_workspace_bytes(&config, &mut size) };
    assert_eq!(status(rf_config { abi_version: 1, ..limits }), RF_ERROR_ABI);
    // As many units as there is memory for.
    assert_eq!(status(rf_config { max_units: 1000, ..limits }), RF_OK);
    let huge = status(rf_config { max_units: u32::MAX, ..limits });
    assert_eq!(huge, if usize::BITS == 32 { RF_ERROR_LENGTH } else { RF_OK });
    let huge = status(rf_config { max_points: u32::MAX, ..limits });
    assert_eq!(huge, if usize::BITS == 32 { RF_ERROR_LENGTH } else { RF_OK });
    assert_eq!(status(rf_config { model_bytes: usize::MAX, ..limits }), RF_ERROR_LENGTH);
    assert_eq!(rf_abi_version(), RF_ABI_VERSION);
    assert_eq!(unsafe { CStr::from_ptr(rf_version()) }.to_str(), Ok(env!("CARGO_PKG_VERSION")));
    for (code, text) in [(0, "ok"), (-1, "unknown error code"), (99, "unknown error code")] {
        assert_eq!(unsafe { CStr::from_ptr(rf_error_string(code)) }.to_str(), Ok(text));
    }
}

/// A change to a sound observation, the error that it gives, and the unit, index and numbers of it.
type Case = (fn(&mut Scene), rf_status, [u64; 4]);

#[test]
fn bad_observations_leave_the_scene() {
    const NONE: u64 = RF_NONE as u64;
    let file = smallest();
    let (_workspace, handle) = running(file);
    let before = poses(handle);
    let cases: [Case; 12] = [
        (|s| s.current[7][1] = f32::NAN, RF_ERROR_BAD_POINT, [1, 2, 0, 0]),
        (|s| s.previous[0][2] = f32::INFINITY, RF_ERROR_BAD_POINT, [0, 0, 0, 0]),
        (|s| s.previous[9][0] = -1.1e6, RF_ERROR_BAD_POINT, [1, 4, 0, 0]),
        (|s| s.physics[1].mass_kg = 0.0, RF_ERROR_BAD_PHYSICS, [1, NONE, 0, 0]),
        (|s| s.physics[0].friction = f32::NAN, RF_ERROR_BAD_PHYSICS, [0, NONE, 0, 0]),
        (|s| s.current[5..].fill([1.0; 3]), RF_ERROR_COINCIDENT, [1, NONE, 0, 0]),
        (|s| *s = Scene::new(3), RF_ERROR_TOO_MANY_UNITS, [NONE, NONE, 3, 2]),
        (|s| *s = Scene::new(300), RF_ERROR_TOO_MANY_UNITS, [NONE, NONE, 300, 2]),
        (|s| *s = Scene::new(0), RF_ERROR_NO_UNITS, [NONE, NONE, 0, 0]),
        (|s| s.counts = vec![7, 3], RF_ERROR_TOO_FEW_POINTS, [1, NONE, 3, 4]),
        (|s| s.counts = vec![5, 4], RF_ERROR_POINT_COUNTS, [NONE, NONE, 9, 10]),
        (
            |s| s.counts = vec![u32::MAX; 2],
            RF_ERROR_POINT_COUNTS,
            [NONE, NONE, u32::MAX as u64 * 2, 10],
        ),
    ];
    for (at, (change, code, [unit, index, found, expected])) in cases.into_iter().enumerate() {
        let mut scene = Scene::new(2);
        change(&mut scene);
        assert_eq!(scene.observe(handle), code, "case {at}");
        let detail = detail(handle);
        assert_eq!(detail.code, code);
        assert_eq!((detail.unit.into(), detail.index.into()), (unit, index), "case {at}");
        assert_eq!((detail.found, detail.expected), (found, expected), "case {at}");
        assert_eq!(poses(handle), before, "case {at}");
    }
    let mut scene = Scene::new(2);
    for frame in [&mut scene.previous, &mut scene.current] {
        frame.push([0.3; 3]);
    }
    scene.counts[1] = 6;
    assert_eq!(scene.observe(handle), RF_ERROR_TOO_MANY_POINTS);
    let scene = Scene::new(2);
    let points: *const f32 = scene.previous.as_ptr().cast();
    for dt in [0.0, -0.1, f32::NAN, f32::INFINITY] {
        let status = unsafe { rf_observe(handle, dt, &scene.units(), points, points, null_mut()) };
        assert_eq!(status, RF_ERROR_BAD_TIMESTEP);
    }
    let with = |roles: *const u32, bodies: *const i32| {
        let units = rf_units { roles, bodies, ..scene.units() };
        let status = unsafe { rf_observe(handle, DT_S, &units, points, points, null_mut()) };
        (status, detail(handle))
    };
    let (status, numbers) = with([RF_ROLE_FIXED, 3].as_ptr(), nothing());
    assert_eq!((status, numbers.unit, numbers.found), (RF_ERROR_BAD_ROLE, 1, 3));
    for body in [-2, RF_MAX_BODY + 1, i32::MIN, i32::MAX] {
        let (status, numbers) = with(nothing(), [body, 0].as_ptr());
        assert_eq!((status, numbers.unit), (RF_ERROR_BAD_BODY, 0));
        assert_eq!(numbers.found as i64, i64::from(body));
    }
    for moments in [[f32::NAN, 1.0, 1.0], [1.0, 0.0, 1.0], [1.0, 1.0, 3.0], [-1.0; 3]] {
        let inertias = [[0.0; 3], moments];
        let units = rf_units { inertias_kg_m2: inertias.as_ptr().cast(), ..scene.units() };
        let status = unsafe { rf_observe(handle, DT_S, &units, points, points, null_mut()) };
        assert_eq!((status, detail(handle).unit), (RF_ERROR_BAD_INERTIA, 1));
    }
    bad_pieces_are_refused(handle, &scene);
    let mut poses_in = [rf_pose { position: [0.0; 3], quaternion: [0.0, 0.0, 0.0, 1.0] }; 2];
    poses_in[1].quaternion = [0.0; 4];
    let p = poses_in.as_ptr();
    let status =
        unsafe { rf_observe_poses(handle, DT_S, &scene.units(), points, p, p, null_mut()) };
    assert_eq!((status, detail(handle).unit), (RF_ERROR_BAD_POSE, 1));
    assert_eq!(poses(handle), before);
    assert_eq!(step(handle), RF_OK);
}

/// Pieces of an observation of two units of five points, where there is room for ten.
fn bad_pieces_are_refused(handle: *mut rf_simulator, scene: &Scene) {
    const NONE: u32 = RF_NONE;
    let points: *const f32 = scene.previous.as_ptr().cast();
    let observe = |units: rf_units| {
        let status = unsafe { rf_observe(handle, DT_S, &units, points, points, null_mut()) };
        let rf_detail { code, unit, index, found, expected, .. } = detail(handle);
        assert_eq!(status, code);
        (status, [unit, index], [found, expected])
    };
    let mut corners = [[0.1_f32; 3]; 300];
    corners[299][1] = f32::NAN;
    let given = |units: &[u16], counts: &[u16], points: usize| {
        observe(rf_units {
            unit_pieces: if units.is_empty() { nothing() } else { units.as_ptr() },
            piece_counts: counts.as_ptr(),
            piece_count: counts.len(),
            piece_points: corners.as_ptr().cast(),
            piece_point_count: points,
            ..scene.units()
        })
    };
    for (units, counts, points, sums) in [
        (&[][..], &[4_u16][..], 4, [0, 1]),
        (&[0, 0], &[4], 4, [0, 1]),
        (&[0, 2], &[4], 4, [2, 1]),
        (&[u16::MAX; 2], &[4], 4, [2 * u64::from(u16::MAX), 1]),
        (&[0, 1], &[4], 5, [4, 5]),
        (&[1, 1], &[u16::MAX; 2], 300, [2 * u64::from(u16::MAX), 300]),
        (&[0, 0], &[], 7, [0, 7]),
    ] {
        let expected = (RF_ERROR_POINT_COUNTS, [NONE; 2], sums);
        assert_eq!(given(units, counts, points), expected, "{units:?} {counts:?}");
    }
    let many = given(&[1, 33], &[4; 34], 4 * 34);
    assert_eq!(many, (RF_ERROR_TOO_MANY_PIECES, [1, NONE], [33, RF_MAX_PIECES as u64]));
    for (units, counts, at) in [
        ([1, 2], &[4_u16, 4, 3][..], [1, 1]),
        ([1, 2], &[3, 4, 4], [0, 0]),
        ([0, 1], &[0], [1, 0]),
        ([0, 2], &[4, 256], [1, 1]),
        ([2, 1], &[255, 41, 4], [1, 0]),
    ] {
        let sum = counts.iter().map(|count| usize::from(*count)).sum();
        let expected = (RF_ERROR_BAD_PIECE, at, [0, 0]);
        assert_eq!(given(&units, counts, sum), expected, "{units:?} {counts:?}");
    }
    // Five points of the first, and four and two of the other's piece.
    assert_eq!(given(&[0, 1], &[4], 4), (RF_ERROR_TOO_MANY_POINTS, [NONE; 2], [11, 10]));
    let (units, counts) = ([0_u16, 1], [4_u16]);
    let sound = rf_units {
        unit_pieces: units.as_ptr(),
        piece_counts: counts.as_ptr(),
        piece_count: 1,
        piece_points: corners.as_ptr().cast(),
        piece_point_count: 4,
        ..scene.units()
    };
    let inside = handle.wrapping_byte_add(64).cast_const();
    for (odd, code) in [
        (rf_units { piece_counts: nothing(), ..sound }, RF_ERROR_NULL),
        (rf_units { piece_points: nothing(), ..sound }, RF_ERROR_NULL),
        (rf_units { piece_count: usize::MAX, ..sound }, RF_ERROR_LENGTH),
        (rf_units { piece_point_count: usize::MAX / 4, ..sound }, RF_ERROR_LENGTH),
        (
            rf_units { unit_pieces: sound.unit_pieces.wrapping_byte_add(1), ..sound },
            RF_ERROR_ALIGNMENT,
        ),
        (
            rf_units { piece_counts: sound.piece_counts.wrapping_byte_add(1), ..sound },
            RF_ERROR_ALIGNMENT,
        ),
        (
            rf_units { piece_points: sound.piece_points.wrapping_byte_add(2), ..sound },
            RF_ERROR_ALIGNMENT,
        ),
        (rf_units { unit_pieces: inside.cast(), ..sound }, RF_ERROR_OVERLAP),
        (rf_units { piece_counts: inside.cast(), ..sound }, RF_ERROR_OVERLAP),
        (rf_units { piece_points: inside.cast(), ..sound }, RF_ERROR_OVERLAP),
    ] {
        assert_eq!(observe(odd).0, code);
    }
}

#[test]
fn arrays_are_checked() {
    let file = smallest();
    let (mut workspace, handle) = running(file);
    let before = poses(handle);
    let inside = unsafe { workspace.pointer().add(workspace.bytes - 64) };
    let mut poses_out = [rf_pose { position: [7.0; 3], quaternion: [7.0; 4] }; 2];
    let mut count = 0;
    unsafe {
        // Too short: nothing is written.
        assert_eq!(rf_poses(handle, poses_out.as_mut_ptr(), 1), RF_ERROR_BUFFER);
        assert_eq!(poses_out[0].position, [7.0; 3]);
        assert_eq!((detail(handle).found, detail(handle).expected), (1, 2));
        assert_eq!(rf_points(handle, 2, null_mut(), 0, &mut count), RF_ERROR_NO_SUCH_UNIT);
        assert_eq!((detail(handle).unit, detail(handle).expected), (2, 2));
        // Into the simulator's own memory, and out of it.
        assert_eq!(rf_poses(handle, inside.cast(), 2), RF_ERROR_OVERLAP);
        assert_eq!(rf_step(handle, handle.cast()), RF_ERROR_OVERLAP);
        let scene = Scene::new(2);
        let units = scene.units();
        let points: *const f32 = inside.cast();
        assert_eq!(rf_observe(handle, DT_S, &units, points, points, null_mut()), RF_ERROR_OVERLAP);
        // Addresses and lengths that cannot be.
        let odd = poses_out.as_mut_ptr().wrapping_byte_add(1);
        assert_eq!(rf_poses(handle, odd, 1), RF_ERROR_ALIGNMENT);
        assert_eq!(rf_unit_count(handle, std::ptr::without_provenance_mut(2)), RF_ERROR_ALIGNMENT);
        assert_eq!(
            rf_set_command(handle, poses_out.as_ptr().cast(), usize::MAX / 2),
            RF_ERROR_LENGTH
        );
        assert_eq!(rf_set_command(handle, null_mut(), usize::MAX / 2), RF_ERROR_NULL);
    }
    assert_eq!(poses(handle), before);
}

/// A handle shared by two threads: each call is done or refused, and none is torn.
#[test]
fn calls_at_a_time_are_refused() {
    struct Shared(*mut rf_simulator);
    // SAFETY: what this test shows.
    unsafe impl Sync for Shared {}
    let file = smallest();
    let (_workspace, handle) = running(file);
    let shared = Shared(handle);
    let shared = &shared;
    let steps = if cfg!(miri) { 3 } else { 2000 };
    std::thread::scope(|scope| {
        for _ in 0..2 {
            scope.spawn(move || {
                let (mut done, mut refused) = (0, 0);
                while done < steps {
                    match step(shared.0) {
                        RF_OK | RF_ERROR_DIVERGED => done += 1,
                        RF_ERROR_BUSY => refused += 1,
                        other => panic!("{other:?}"),
                    }
                    if refused % 16 == 15 {
                        std::thread::yield_now();
                    }
                }
            });
        }
    });
    let last = step(handle);
    assert!(matches!(last, RF_OK | RF_ERROR_DIVERGED), "{last:?}");
}
