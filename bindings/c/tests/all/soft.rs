//! Soft units and bonds through the C functions: what the core computes, and a code for all that cannot be.
// Handles are NULL or live here, and arrays as long as they say, unless a comment says otherwise.
#![allow(unsafe_code, clippy::undocumented_unsafe_blocks)]
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]
#![cfg(not(miri))] // makes models

use crate::common::{self, *};
use nalgebra::Point3;
use rigidformer_capi::edit::*;
use rigidformer_capi::ffi::*;
use rigidformer_capi::types::rf_status::*;
use rigidformer_capi::types::*;
use rigidformer_core::{
    Limits, Model, Observed, Physics, Role, Simulator, SlabSizes, Slabs, Unit, UnitSlot,
};
use rigidformer_weights::{AlignedBuffer, Elastic, FeatureSet, ModelConfig, Motion};
use std::ptr::{null, null_mut};

const SOFT: ModelConfig = ModelConfig {
    features: FeatureSet::Soft,
    motion: Motion::Soft,
    gate: false,
    elastic: Elastic {
        neighbours: 4,
        falloff: 1,
        thickness_m: 0.0,
        stiffness: 1.0,
        damping_s: 0.01,
        skin_m: 0.005,
        rate_hz: 240.0,
        strain_sweeps: 2,
        strain_limit: 0.1,
    },
    ..SMALLEST
};
const CLOTH: rf_physics = rf_physics { mass_kg: 0.1, friction: 0.5, restitution: 0.0 };
const LIMITS: Limits = Limits { units: 3, points: 20 };
const COUNTS: [u32; 3] = [6, 6, 8];

/// Two patches of a sheet of 3 x 3 points that share its middle row, over a box that is fixed.
struct Sheet {
    rest: Vec<[f32; 3]>,
    points: Vec<[f32; 3]>,
    young_pa: [f32; 3],
    roles: [u32; 3],
    bodies: [i32; 3],
    /// Of one unit or none.
    unit_pieces: Option<[u16; 3]>,
}

impl Sheet {
    fn new() -> Self {
        let place = |i: usize, j: usize| [0.1 * i as f32 - 0.1, 0.1 * j as f32 - 0.1, 0.0];
        let patch = |first: usize| (0..6).map(move |k| place(first + k / 3, k % 3));
        let corner = |k: usize, bit| if k & bit == 0 { -0.1 } else { 0.1 };
        let cube = (0..8).map(|k| [corner(k, 1), corner(k, 2), corner(k, 4)]);
        let rest: Vec<_> = patch(0).chain(patch(1)).chain(cube).collect();
        let lifted = rest.iter().enumerate();
        let points =
            lifted.map(|(k, [x, y, z])| [*x, *y, z + if k < 12 { 0.25 } else { 0.1 }]).collect();
        Sheet {
            rest,
            points,
            young_pa: [1e4, 1e4, 0.0],
            roles: [RF_ROLE_FREE, RF_ROLE_FREE, RF_ROLE_FIXED],
            bodies: [0, 0, RF_OWN_BODY],
            unit_pieces: None,
        }
    }

    fn observe(&self, handle: *mut rf_simulator) -> rf_status {
        let pieces = self.unit_pieces.as_ref();
        let units = rf_units {
            unit_count: 3,
            physics: [CLOTH; 3].as_ptr(),
            point_counts: COUNTS.as_ptr(),
            point_count: 20,
            roles: self.roles.as_ptr(),
            bodies: self.bodies.as_ptr(),
            inertias_kg_m2: null(),
            unit_pieces: pieces.map_or(null(), |pieces| pieces.as_ptr()),
            piece_counts: [4].as_ptr(),
            piece_count: pieces.map_or(0, |_| 1),
            piece_points: self.points.as_ptr().cast(),
            piece_point_count: pieces.map_or(0, |_| 4),
            young_pa: self.young_pa.as_ptr(),
            rest_points: self.rest.as_ptr().cast(),
        };
        let points = self.points.as_ptr().cast();
        unsafe { rf_observe(handle, DT_S, &units, points, points, null_mut()) }
    }
}

/// Points of both patches, in the order in which they were given.
fn points(handle: *mut rf_simulator) -> Vec<[f32; 3]> {
    let mut all = vec![[f32::NAN; 3]; 12];
    for (unit, patch) in all.chunks_exact_mut(6).enumerate() {
        let mut count = 0;
        let out = patch.as_mut_ptr().cast();
        assert_eq!(unsafe { rf_soft_points(handle, unit as u32, out, 6, &mut count) }, RF_OK);
        assert_eq!(count, 6);
    }
    all
}

fn with_core(file: &[u8], body: impl FnOnce(&mut Simulator<'_, '_>)) {
    let model = Model::load(file).unwrap();
    let sizes = SlabSizes::new(model.config(), LIMITS);
    let (mut f32, mut i8) = (vec![0.0; sizes.f32], vec![0; sizes.i8]);
    let mut points = vec![Point3::origin(); sizes.points];
    let mut units = vec![UnitSlot::EMPTY; sizes.units];
    let slabs = Slabs { f32: &mut f32, i8: &mut i8, points: &mut points, units: &mut units };
    body(&mut Simulator::new(&model, LIMITS, slabs).unwrap());
}

#[test]
fn a_sheet_has_the_bits_of_the_core() {
    let file = model(SOFT);
    let sheet = Sheet::new();
    let limits = config(&file, 3, 20);
    let mut workspace = Workspace::of(&limits);
    let handle = workspace.init(&limits);
    assert_eq!(sheet.observe(handle), RF_OK);
    assert_eq!(points(handle), sheet.points[..12]);
    let of = |list: &[[f32; 3]]| list.iter().map(|p| Point3::from(*p)).collect::<Vec<_>>();
    let (rest, seen) = (of(&sheet.rest), of(&sheet.points));
    let rf_physics { mass_kg, friction, restitution } = CLOTH;
    let physics = Physics { mass_kg, friction, restitution };
    with_core(&file, |core| {
        let units = [(0, 6), (6, 12), (12, 20)].map(|(from, to)| {
            let unit = Unit::new(&seen[from..to], physics);
            let unit = match from {
                12 => unit.role(Role::Fixed),
                _ => unit.body(0).soft(&rest[from..to], 1e4),
            };
            Observed { unit, current: &seen[from..to] }
        });
        core.observe(DT_S, units).unwrap();
        for _ in 0..3 {
            assert_eq!(step(handle), RF_OK);
            core.step().unwrap();
        }
        let mut expected = vec![[0.0; 3]; 12];
        for (unit, patch) in core.units().zip(expected.chunks_exact_mut(6)) {
            unit.soft_points().for_each(|(number, point)| patch[number] = point.into());
        }
        assert_eq!(points(handle), expected);
        assert_ne!(points(handle), sheet.points[..12]);
    });
    assert!(workspace.rim_is_whole());
}

#[test]
fn bad_soft_units_are_refused() {
    let file = model(SOFT);
    let limits = config(&file, 3, 20);
    let mut workspace = Workspace::of(&limits);
    let handle = workspace.init(&limits);
    assert_eq!(Sheet::new().observe(handle), RF_OK);
    assert_eq!(step(handle), RF_OK);
    let before = points(handle);
    let refused = |change: &dyn Fn(&mut Sheet), code, unit: u32| {
        let mut sheet = Sheet::new();
        change(&mut sheet);
        assert_eq!(sheet.observe(handle), code);
        assert_eq!((detail(handle).code, detail(handle).unit), (code, unit));
        assert_eq!(points(handle), before);
    };
    for young_pa in [-1.0, f32::NAN, f32::INFINITY, 1e16, 1e-4] {
        refused(&|sheet| sheet.young_pa[1] = young_pa, RF_ERROR_BAD_SOFT, 1);
    }
    refused(&|sheet| sheet.rest[7][1] = f32::NAN, RF_ERROR_BAD_SOFT, 1);
    refused(&|sheet| sheet.rest[3] = sheet.rest[4], RF_ERROR_BAD_SOFT, 0);
    refused(&|sheet| sheet.rest[..6].fill([0.0; 3]), RF_ERROR_BAD_SOFT, 0);
    refused(&|sheet| sheet.roles[0] = RF_ROLE_FIXED, RF_ERROR_BAD_SOFT, 0);
    refused(&|sheet| sheet.unit_pieces = Some([0, 1, 0]), RF_ERROR_BAD_SOFT, 1);
    refused(&|sheet| sheet.points[8][0] = f32::INFINITY, RF_ERROR_BAD_POINT, 1);
    refused(&|sheet| sheet.points[..6].fill([0.0; 3]), RF_ERROR_COINCIDENT, 0);
    // What is not soft has no Young's modulus, and its points at rest are not looked at.
    let mut sheet = Sheet::new();
    sheet.rest[12..].fill([f32::NAN; 3]);
    assert_eq!(sheet.observe(handle), RF_OK);

    let ids = ids(handle);
    let pose = rf_pose { position: [0.0; 3], quaternion: [0.0, 0.0, 0.0, 1.0] };
    let pivot = [0.0_f32; 3].as_ptr();
    unsafe {
        assert_eq!(rf_remove(handle, ids[2]), RF_ERROR_DEFORMS);
        assert_eq!(rf_set_poses(handle, ids[0], &pose, &pose), RF_ERROR_DEFORMS);
        assert_eq!(rf_set_role(handle, ids[0], RF_ROLE_DRIVEN), RF_ERROR_DEFORMS);
        assert_eq!(rf_join(handle, ids[2], ids[0], pivot, pivot), RF_ERROR_DEFORMS);
        assert_eq!(detail(handle).found, ids[0]);
        assert_eq!(rf_bond(handle, [ids[0], ids[1]].as_ptr(), 1), RF_ERROR_BOND_MOTION);
        let (mut out, mut count) = ([[0.0_f32; 3]; 6], 0);
        let out: *mut f32 = out.as_mut_ptr().cast();
        assert_eq!(rf_soft_points(handle, 2, out, 6, &mut count), RF_ERROR_NOT_SOFT);
        assert_eq!(detail(handle).unit, 2);
        assert_eq!(rf_soft_points(handle, 3, out, 6, &mut count), RF_ERROR_NO_SUCH_UNIT);
        assert_eq!((rf_soft_points(handle, 0, out, 5, &mut count), count), (RF_ERROR_BUFFER, 6));
        assert_eq!(rf_soft_points(handle, 0, null_mut(), 6, &mut count), RF_ERROR_NULL);
        assert_eq!(rf_soft_points(handle, 0, out, 6, null_mut()), RF_ERROR_NULL);
        assert_eq!(rf_soft_points(null_mut(), 0, out, 6, &mut count), RF_ERROR_NULL);
        let inside: *mut f32 = handle.cast::<u8>().wrapping_add(256).cast();
        assert_eq!(rf_soft_points(handle, 0, inside, 6, &mut count), RF_ERROR_OVERLAP);
        let sheet = Sheet::new();
        let units = rf_units {
            unit_count: 1,
            physics: &CLOTH,
            point_counts: [6].as_ptr(),
            point_count: 6,
            young_pa: sheet.young_pa.as_ptr(),
            rest_points: null(),
            ..Scene::new(1).units()
        };
        let cloud: *const f32 = sheet.points.as_ptr().cast();
        assert_eq!(rf_observe(handle, DT_S, &units, cloud, cloud, null_mut()), RF_ERROR_NULL);
        let units = rf_units { rest_points: sheet.rest.as_ptr().cast(), ..units };
        let observed = rf_observe_poses(handle, DT_S, &units, cloud, &pose, &pose, null_mut());
        assert_eq!((observed, detail(handle).unit), (RF_ERROR_SOFT_POSE, 0));
        assert_eq!(rf_observe(handle, DT_S, &units, cloud, cloud, null_mut()), RF_OK);
    }

    // A model of rigid units takes none.
    let file = smallest();
    let limits = config(file, 3, 20);
    let mut workspace = Workspace::of(&limits);
    let handle = workspace.init(&limits);
    assert_eq!((Sheet::new().observe(handle), detail(handle).unit), (RF_ERROR_NOT_SOFT, 0));
}

/// Bonds of a scene: both ids, and whether they hold.
fn bonds(handle: *mut rf_simulator) -> Vec<([u64; 2], u32)> {
    let none = rf_bonded { units: [0; 2], holds: 7, reserved: 7 };
    let (mut all, mut count) = ([none; 8], 0);
    assert_eq!(unsafe { rf_bonds(handle, all.as_mut_ptr(), 8, &mut count) }, RF_OK);
    assert!(all[..count].iter().all(|bond| bond.reserved == 0));
    all[..count].iter().map(|bond| (bond.units, bond.holds)).collect()
}

/// Three units of five points, the first two of one body.
fn cells(file: &[u8]) -> (Workspace, *mut rf_simulator) {
    let limits = config(file, 3, 15);
    let mut workspace = Workspace::of(&limits);
    let handle = workspace.init(&limits);
    let scene = Scene::new(3);
    let units = rf_units { bodies: [0, 0, RF_OWN_BODY].as_ptr(), ..scene.units() };
    let frames = [&scene.previous, &scene.current].map(|frame| frame.as_ptr().cast());
    let seen = unsafe { rf_observe(handle, DT_S, &units, frames[0], frames[1], null_mut()) };
    assert_eq!(seen, RF_OK);
    (workspace, handle)
}

fn impulses() -> AlignedBuffer {
    model(ModelConfig { features: FeatureSet::Impact, motion: Motion::Impulses, ..SMALLEST })
}

#[test]
fn bonds_hold_until_they_break() {
    let file = impulses();
    let (_workspace, handle) = cells(&file);
    let ids = ids(handle);
    let pair = [ids[1], ids[0]];
    assert_eq!(unsafe { rf_bond(handle, pair.as_ptr(), 1) }, RF_OK);
    assert_eq!(bonds(handle), [([ids[0], ids[1]], 1)]);
    // Where the second one is, seen from the first one's frame.
    let lever = |handle| {
        let pose = |id| {
            let mut pose = rf_pose { position: [0.0; 3], quaternion: [0.0, 0.0, 0.0, 1.0] };
            assert_eq!(unsafe { rf_unit_pose(handle, id, &mut pose) }, RF_OK);
            let [x, y, z, w] = pose.quaternion;
            let rotation =
                nalgebra::UnitQuaternion::new_normalize(nalgebra::Quaternion::new(w, x, y, z));
            nalgebra::Isometry3::from_parts(pose.position.into(), rotation)
        };
        (pose(ids[0]).inverse() * pose(ids[1])).translation.vector
    };
    let began = lever(handle);
    for _ in 0..4 {
        assert_eq!(step(handle), RF_OK);
    }
    assert!((lever(handle) - began).norm() < 1e-4, "{}", lever(handle));
    let mut held = 7;
    unsafe {
        assert_eq!(rf_set_role(handle, ids[0], RF_ROLE_FIXED), RF_ERROR_BONDED);
        assert_eq!(detail(handle).found, ids[0]);
        let pivot = [0.0_f32; 3].as_ptr();
        assert_eq!(rf_join(handle, ids[2], ids[1], pivot, pivot), RF_ERROR_BONDED);
        assert_eq!((rf_break_bond(handle, ids[0], ids[1], &mut held), held), (RF_OK, 1));
        assert_eq!((rf_break_bond(handle, ids[1], ids[0], &mut held), held), (RF_OK, 0));
        assert_eq!(rf_break_bond(handle, ids[1], ids[0], null_mut()), RF_OK);
    }
    assert_eq!(bonds(handle), [([ids[0], ids[1]], 0)]);
}

#[test]
fn bad_bonds_are_refused() {
    let file = impulses();
    let (_workspace, handle) = cells(&file);
    let ids = ids(handle);
    let refused = |pairs: &[[u64; 2]], code: rf_status, numbers: [u64; 2]| {
        let before = (bonds(handle), poses(handle));
        assert_eq!(unsafe { rf_bond(handle, pairs.as_ptr().cast(), pairs.len()) }, code);
        let found = detail(handle);
        assert_eq!((found.code, [found.found, found.expected]), (code, numbers));
        assert_eq!((bonds(handle), poses(handle)), before);
    };
    let [a, b, c] = ids[..] else { panic!("three units") };
    for nobody in [0, 77, u64::MAX] {
        refused(&[[a, b], [a, nobody]], RF_ERROR_NO_SUCH_ID, [nobody, 0]);
    }
    refused(&[[a, a]], RF_ERROR_BOND_ITSELF, [a, 0]);
    refused(&[[a, b], [b, a]], RF_ERROR_BOND_TWICE, [b, a]);
    refused(&[[a, c]], RF_ERROR_BOND_APART, [a, c]);
    refused(&[[a, b]; 25], RF_ERROR_TOO_MANY_BONDS, [25, 24]);
    unsafe {
        assert_eq!(rf_set_role(handle, b, RF_ROLE_DRIVEN), RF_OK);
        refused(&[[a, b]], RF_ERROR_BOND_NOT_FREE, [b, 0]);
        assert_eq!(rf_set_role(handle, b, RF_ROLE_FREE), RF_OK);
        let pivot = [0.0_f32; 3].as_ptr();
        assert_eq!(rf_join(handle, b, c, pivot, pivot), RF_OK);
        refused(&[[a, b]], RF_ERROR_BOND_JOINED, [b, 0]);
        assert_eq!(rf_unjoin(handle, b), RF_OK);
        let mut held = 7;
        for (other, code) in
            [(b, RF_ERROR_NO_SUCH_BOND), (a, RF_ERROR_BOND_ITSELF), (9, RF_ERROR_NO_SUCH_ID)]
        {
            assert_eq!((rf_break_bond(handle, a, other, &mut held), held), (code, 7));
        }
        assert_eq!(rf_bond(handle, null(), 1), RF_ERROR_NULL);
        assert_eq!(rf_bond(handle, null(), 0), RF_OK);
        assert_eq!(rf_bond(null_mut(), [a, b].as_ptr(), 1), RF_ERROR_NULL);
        let inside: *const u64 = handle.cast::<u8>().wrapping_add(256).cast();
        assert_eq!(rf_bond(handle, inside, 1), RF_ERROR_OVERLAP);
        assert_eq!(rf_bond(handle, [a, b].as_ptr(), usize::MAX / 4), RF_ERROR_LENGTH);
        assert_eq!(rf_bond(handle, [a, b].as_ptr(), 1), RF_OK);
        let mut count = 0;
        assert_eq!((rf_bonds(handle, null_mut(), 0, &mut count), count), (RF_ERROR_BUFFER, 1));
        assert_eq!(rf_bonds(handle, null_mut(), 1, &mut count), RF_ERROR_NULL);
        assert_eq!(rf_bonds(handle, null_mut(), 0, null_mut()), RF_ERROR_NULL);
    }
    refused(&[[b, a]], RF_ERROR_BOND_TWICE, [b, a]);
    let file = smallest();
    let (_workspace, handle) = cells(file);
    let ids = common::ids(handle);
    assert_eq!(unsafe { rf_bond(handle, [ids[0], ids[1]].as_ptr(), 1) }, RF_ERROR_BOND_MOTION);
}
