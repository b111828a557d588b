//! The C functions compute what the core computes.
// Handles are NULL or live here, and arrays as long as they say, unless a comment says otherwise.
#![allow(unsafe_code, clippy::undocumented_unsafe_blocks)]
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use crate::common::*;
use nalgebra::{Point3, Quaternion, UnitQuaternion};
use rigidformer_capi::ffi::*;
use rigidformer_capi::types::rf_status::*;
use rigidformer_capi::types::*;
use rigidformer_core::{
    Limits, Model, Observed, Physics, Simulator, SlabSizes, Slabs, Unit, UnitSlot,
};
use std::ptr::null_mut;

/// Runs `body` with a simulator of the core that observed the scene.
fn with_core(file: &[u8], scene: &Scene, body: impl FnOnce(&mut Simulator<'_, '_>)) {
    let model = Model::load(file).expect("loads");
    let limits = Limits { units: 64, points: 320 };
    let sizes = SlabSizes::new(model.config(), limits);
    let (mut f32, mut i8) = (vec![0.0; sizes.f32], vec![0; sizes.i8]);
    let mut points = vec![Point3::origin(); sizes.points];
    let mut units = vec![UnitSlot::EMPTY; sizes.units];
    let slabs = Slabs { f32: &mut f32, i8: &mut i8, points: &mut points, units: &mut units };
    let mut simulator = Simulator::new(&model, limits, slabs).expect("makes");
    let physics: Vec<Physics> = scene
        .physics
        .iter()
        .map(|p| Physics { mass_kg: p.mass_kg, friction: p.friction, restitution: p.restitution })
        .collect();
    let points = |frame: &[[f32; 3]]| frame.iter().map(|p| Point3::from(*p)).collect::<Vec<_>>();
    let (previous, current) = (points(&scene.previous), points(&scene.current));
    let frames = previous.chunks(5).zip(current.chunks(5));
    let units: Vec<_> = frames
        .zip(physics)
        .map(|((points, current), physics)| Observed { unit: Unit::new(points, physics), current })
        .collect();
    simulator.observe(DT_S, &units).expect("observes");
    body(&mut simulator);
}

#[test]
fn a_rollout_has_the_bits_of_the_core() {
    let file = smallest();
    for (units, limit) in [(2, 2), (3, 17), (20, 64), (64, 300)] {
        if cfg!(miri) && units > 2 {
            continue;
        }
        let scene = Scene::new(units);
        let config = config(file, limit, 5 * limit);
        let mut workspace = Workspace::of(&config);
        let handle = workspace.init(&config);
        assert_eq!(scene.observe(handle), RF_OK);
        with_core(file, &scene, |core| {
            for _ in 0..if cfg!(miri) { 1 } else { 3 } {
                let mut report = rf_step_report::default();
                assert_eq!(unsafe { rf_step(handle, &mut report) }, RF_OK);
                let done = core.step().expect("steps");
                assert_eq!(report.active_units, done.active_units);
                assert!(report.active_units > 0);
            }
            let of_core = core.units().map(|unit| {
                let pose = unit.internal_pose();
                let mut numbers = pose
                    .rotation
                    .transpose()
                    .iter()
                    .chain(&pose.centre)
                    .copied()
                    .collect::<Vec<_>>()
                    .into_iter();
                std::array::from_fn(|_| numbers.next().unwrap().to_bits())
            });
            assert_eq!(poses(handle), of_core.collect::<Vec<[u32; 12]>>());

            let mut poses = vec![rf_pose { position: [0.0; 3], quaternion: [0.0; 4] }; units];
            assert_eq!(unsafe { rf_poses(handle, poses.as_mut_ptr(), units) }, RF_OK);
            let mut points = vec![[0.0_f32; 3]; 5];
            for (unit, pose) in poses.iter().enumerate() {
                let view = core.unit(unit).unwrap();
                let expected = view.pose();
                assert_eq!(pose.position, <[f32; 3]>::from(expected.translation.vector));
                let [x, y, z, w] = pose.quaternion;
                let quaternion = UnitQuaternion::new_unchecked(Quaternion::new(w, x, y, z));
                assert_eq!(quaternion, expected.rotation);
                let mut count = 0;
                let status = unsafe {
                    rf_points(handle, unit as u32, points.as_mut_ptr().cast(), 5, &mut count)
                };
                assert_eq!((status, count), (RF_OK, 5));
                assert!(view.points().eq(points.iter().map(|p| Point3::from(*p))));
            }
        });
        assert!(workspace.rim_is_whole());
    }
}

#[test]
fn poses_can_be_handed_in() {
    let file = smallest();
    let (scene, limits) = (Scene::new(2), config(file, 2, 10));
    let (mut a, mut b) = (Workspace::of(&limits), Workspace::of(&limits));
    let (a, b) = (a.init(&limits), b.init(&limits));
    assert_eq!(scene.observe(a), RF_OK);
    assert_eq!(step(a), RF_OK);
    // Reference points are those of the previous frame; from there both units move alike.
    let still = rf_pose { position: [0.0; 3], quaternion: [0.0, 0.0, 0.0, 1.0] };
    let moved = rf_pose { position: [0.01, 0.0, -0.03], ..still };
    let mut observation = rf_observation { residual_m: 1.0, degenerate_units: 1, reserved: [1; 2] };
    let status = unsafe {
        rf_observe_poses(
            b,
            DT_S,
            &scene.units(),
            scene.previous.as_ptr().cast(),
            [still; 2].as_ptr(),
            [moved; 2].as_ptr(),
            &mut observation,
        )
    };
    assert_eq!((status, observation), (RF_OK, rf_observation::default()));
    assert_eq!(step(b), RF_OK);
    let metres = |bits: &[u32; 12]| bits.map(f32::from_bits);
    for (a, b) in poses(a).iter().zip(&poses(b)) {
        let near = metres(a).iter().zip(metres(b)).all(|(a, b)| (a - b).abs() < 1e-4);
        assert!(near, "{:?} {:?}", metres(a), metres(b));
    }
}

/// The recorded model is no secret; `BLESS=1 cargo test -p rigidformer-capi` records it again.
#[test]
#[cfg_attr(miri, ignore = "makes models")]
fn the_small_model_is_as_recorded() {
    let made = model(SMALLEST);
    if std::env::var_os("BLESS").is_some() {
        std::fs::write(concat!(env!("CARGO_MANIFEST_DIR"), "/tests/data/smallest.rfm"), &*made)
            .unwrap();
    } else {
        assert!(*made == *smallest());
    }
}

#[test]
#[cfg_attr(miri, ignore = "makes models")]
fn a_command_is_heard() {
    let file = model(rigidformer_weights::ModelConfig { command_size: 2, ..SMALLEST });
    let (scene, limits) = (Scene::new(2), config(&file, 2, 10));
    let mut workspace = Workspace::of(&limits);
    let handle = workspace.init(&limits);
    assert_eq!(scene.observe(handle), RF_OK);
    assert_eq!(step(handle), RF_ERROR_NO_COMMAND);
    assert_eq!(detail(handle).expected, 2);
    let command =
        |numbers: &[f32]| unsafe { rf_set_command(handle, numbers.as_ptr(), numbers.len()) };
    assert_eq!(command(&[0.0; 3]), RF_ERROR_COMMAND_SIZE);
    assert_eq!(command(&[0.0, f32::NAN]), RF_ERROR_COMMAND_NUMBER);
    assert_eq!(detail(handle).index, 1);
    let after = |numbers: &[f32]| {
        assert_eq!(command(numbers), RF_OK);
        assert_eq!(scene.observe(handle), RF_OK);
        assert_eq!(step(handle), RF_OK);
        poses(handle)
    };
    assert_ne!(after(&[0.0, 5.0]), after(&[5.0, 0.0]));
    assert_eq!(unsafe { rf_set_command(handle, null_mut(), 2) }, RF_ERROR_NULL);
}
