//! Changes of a scene through the C functions: the bits of the core, and what a C program can do wrong.
// Handles are NULL or live here, and arrays as long as they say, unless a comment says otherwise.
#![allow(unsafe_code, clippy::undocumented_unsafe_blocks)]
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use crate::common::*;
use nalgebra::{Isometry3, Point3, Vector3};
use rigidformer_capi::edit::*;
use rigidformer_capi::ffi::*;
use rigidformer_capi::joints::*;
use rigidformer_capi::state::*;
use rigidformer_capi::types::rf_status::*;
use rigidformer_capi::types::*;
use rigidformer_core::{
    Compliance, ContactLaw, FrictionLimit, Joint, Limits, Model, Observed, Physics, Pieces, Plane,
    Posed, Role, Simulator, SlabSizes, Slabs, Unit, UnitSlot,
};
use rigidformer_weights::{FeatureSet, ModelConfig, Motion};
use std::ptr::{null, null_mut};

const RUBBER: rf_physics = rf_physics { mass_kg: 0.5, friction: 0.8, restitution: 0.7 };
const STEEL: rf_physics = rf_physics { mass_kg: 2.0, friction: 0.3, restitution: 0.1 };
const WALL: rf_plane =
    rf_plane { normal: [-1.0, 0.0, 0.0], offset_m: -2.0, friction: 0.5, restitution: 0.25 };

/// Corners of a box about the origin.
fn corners([x, y, z]: [f32; 3]) -> [[f32; 3]; 8] {
    std::array::from_fn(|i| {
        let sign = |bit: usize| if i & bit == 0 { -1.0 } else { 1.0 };
        [x * sign(1), y * sign(2), z * sign(4)]
    })
}

fn unit(points: &[[f32; 3]]) -> rf_unit {
    rf_unit {
        physics: RUBBER,
        role: RF_ROLE_FREE,
        body: RF_OWN_BODY,
        points: points.as_ptr().cast(),
        point_count: points.len(),
        inertia_kg_m2: [0.0; 3],
        piece_points: null(),
        piece_counts: null(),
        piece_count: 0,
    }
}

/// Room for four units of eight points.
fn room(file: &[u8]) -> rf_config {
    config(file, 4, 32)
}

/// A table that is fixed, a box on it and a pusher that is driven, the latter two parts of bodies: in memory of their
/// own.
fn scene(file: &[u8]) -> (Workspace, *mut rf_simulator) {
    let limits = room(file);
    let mut workspace = Workspace::of(&limits);
    let handle = workspace.init(&limits);
    let points = [corners([0.5, 0.5, 0.1]), corners([0.1; 3]), corners([0.05, 0.1, 0.1])];
    let units = rf_units {
        unit_count: 3,
        physics: [STEEL, RUBBER, RUBBER].as_ptr(),
        point_counts: [8; 3].as_ptr(),
        point_count: 24,
        roles: [RF_ROLE_FIXED, RF_ROLE_FREE, RF_ROLE_DRIVEN].as_ptr(),
        bodies: [RF_OWN_BODY, 0, RF_MAX_BODY].as_ptr(),
        inertias_kg_m2: null(),
        unit_pieces: null(),
        piece_counts: null(),
        piece_count: 0,
        piece_points: null(),
        piece_point_count: 0,
        young_pa: null(),
        rest_points: null(),
    };
    let (table, cube, pusher) = (at(0.0, 0.0, 0.1), at(0.0, 0.0, 0.3), at(-0.2, 0.0, 0.31));
    let poses = [table, cube, pusher];
    let (points, poses) = (points.as_ptr().cast(), poses.as_ptr());
    let status =
        unsafe { rf_observe_poses(handle, DT_S, &units, points, poses, poses, null_mut()) };
    assert_eq!(status, RF_OK);
    (workspace, handle)
}

/// A simulator of the core.
fn with_simulator(file: &[u8], limits: Limits, body: impl FnOnce(&mut Simulator<'_, '_>)) {
    let model = Model::load(file).expect("loads");
    let sizes = SlabSizes::new(model.config(), limits);
    let (mut f32, mut i8) = (vec![0.0; sizes.f32], vec![0; sizes.i8]);
    let mut points = vec![Point3::origin(); sizes.points];
    let mut units = vec![UnitSlot::EMPTY; sizes.units];
    let slabs = Slabs { f32: &mut f32, i8: &mut i8, points: &mut points, units: &mut units };
    body(&mut Simulator::new(&model, limits, slabs).expect("makes"));
}

/// The same scene in the core.
fn with_core(file: &[u8], body: impl FnOnce(&mut Simulator<'_, '_>)) {
    let [table, cube, pusher] =
        [[0.5, 0.5, 0.1], [0.1; 3], [0.05, 0.1, 0.1]].map(|half| corners(half).map(Point3::from));
    let resting = |unit, pose| Posed { unit, previous: pose, current: pose };
    let units = [
        resting(Unit::new(&table, physics(STEEL)).role(Role::Fixed), isometry(0.0, 0.1)),
        resting(Unit::new(&cube, physics(RUBBER)).body(0), isometry(0.0, 0.3)),
        resting(
            Unit::new(&pusher, physics(RUBBER)).role(Role::Driven).body(65534),
            isometry(-0.2, 0.31),
        ),
    ];
    with_simulator(file, Limits { units: 4, points: 32 }, |simulator| {
        simulator.observe_poses(DT_S, units).expect("observes");
        body(simulator);
    });
}

fn physics(p: rf_physics) -> Physics {
    Physics { mass_kg: p.mass_kg, friction: p.friction, restitution: p.restitution }
}

fn compliance(c: rf_compliance) -> Compliance {
    Compliance { stiffness_n_m: c.stiffness_n_m, dissipation_s_m: c.dissipation_s_m }
}

fn isometry(x: f32, z: f32) -> Isometry3<f32> {
    Isometry3::translation(x, 0.0, z)
}

fn bits(simulator: &Simulator<'_, '_>) -> Vec<[u32; 12]> {
    let of = |pose: rigidformer_core::geometry::Pose| {
        let rotation = pose.rotation.transpose();
        let mut numbers = rotation.iter().chain(&pose.centre);
        std::array::from_fn(|_| numbers.next().unwrap().to_bits())
    };
    simulator.units().map(|unit| of(unit.internal_pose())).collect()
}

/// Every change of the interface, with steps between, against the same calls of the core.
#[test]
fn changes_have_the_bits_of_the_core() {
    let file = smallest();
    let (workspace, handle) = scene(file);
    with_core(file, |core| {
        let [table, cube, pusher] = ids(handle)[..] else { panic!("three units") };
        let named: Vec<_> = core.units().map(|unit| unit.id()).collect();
        assert_eq!(named.iter().map(|id| id.to_bits()).collect::<Vec<_>>(), ids(handle));
        let both = |core: &mut Simulator<'_, '_>| {
            assert_eq!(step(handle), RF_OK);
            core.step().expect("steps");
            assert_eq!(poses(handle), bits(core));
            assert_eq!(
                core.units().map(|unit| unit.id().to_bits()).collect::<Vec<_>>(),
                ids(handle)
            );
        };
        unsafe {
            both(core);
            assert_eq!(rf_drive(handle, pusher, &at(-0.15, 0.0, 0.31)), RF_OK);
            core.drive(named[2], &isometry(-0.15, 0.31)).unwrap();
            both(core);
            let mut pose = at(7.0, 7.0, 7.0);
            assert_eq!(rf_unit_pose(handle, pusher, &mut pose), RF_OK);
            assert!((pose.position[0] + 0.15).abs() < 1e-6, "{pose:?}");

            let points = corners([0.1; 3]);
            let inertia_kg_m2 = [2e-3, 3e-3, 4e-3];
            let more = rf_unit { role: RF_ROLE_DRIVEN, body: 0, inertia_kg_m2, ..unit(&points) };
            let mut id = 0;
            let (there, here) = (at(0.0, 0.0, 1.0), at(0.0, 0.0, 0.98));
            assert_eq!(rf_add(handle, &more, &there, &here, &mut id), RF_OK);
            let local = points.map(Point3::from);
            let added = Unit::new(&local, physics(RUBBER)).role(Role::Driven).body(0);
            let added = added.inertia(inertia_kg_m2);
            let added = core.add(&added, &isometry(0.0, 1.0), &isometry(0.0, 0.98)).unwrap();
            assert_eq!(added.to_bits(), id);
            both(core);

            assert_eq!(rf_set_role(handle, id, RF_ROLE_FREE), RF_OK);
            core.set_role(added, Role::Free).unwrap();
            assert_eq!(rf_set_physics(handle, cube, &STEEL), RF_OK);
            core.set_physics(named[1], physics(STEEL)).unwrap();
            both(core);

            assert_eq!(rf_remove(handle, table), RF_OK);
            core.remove(named[0]).unwrap();
            assert_eq!(ids(handle), [cube, pusher, id]);
            both(core);

            let ramp = rf_plane { normal: [-0.6, 0.0, 0.8], offset_m: -0.5, ..WALL };
            assert_eq!(rf_set_planes(handle, [WALL, ramp].as_ptr(), 2), RF_OK);
            let plane = |plane: rf_plane| Plane {
                normal: Vector3::from(plane.normal),
                offset_m: plane.offset_m,
                friction: plane.friction,
                restitution: plane.restitution,
            };
            core.set_planes(&[plane(WALL), plane(ramp)]).unwrap();
            both(core);

            let mat = rf_compliance { stiffness_n_m: 2e3, dissipation_s_m: 1.0 };
            assert_eq!(rf_set_plane_compliance(handle, 1, &mat), RF_OK);
            core.set_plane_compliance(1, compliance(mat)).unwrap();
            let foam = rf_compliance { stiffness_n_m: 5e2, dissipation_s_m: 0.5 };
            assert_eq!(rf_set_compliance(handle, cube, &foam), RF_OK);
            core.set_compliance(named[1], compliance(foam)).unwrap();
            both(core);

            assert_eq!(rf_set_gravity(handle, [0.5, 0.0, -3.0].as_ptr()), RF_OK);
            core.set_gravity(Vector3::new(0.5, 0.0, -3.0)).unwrap();
            assert_eq!(rf_set_dt(handle, 0.03), RF_OK);
            core.set_dt(0.03).unwrap();
            both(core);

            assert_eq!(rf_set_network(handle, 0), RF_OK);
            core.set_network(false);
            both(core);
            assert_eq!(rf_set_network(handle, 1), RF_OK);
            core.set_network(true);

            let (mut offset, mut pyramid) = (9.0, 9);
            assert_eq!(rf_contact_law(handle, &mut offset, &mut pyramid), RF_OK);
            assert_eq!((offset, pyramid), (0.0, 0));
            assert_eq!(rf_set_contact_law(handle, 0.25, 1), RF_OK);
            let friction = FrictionLimit::Pyramid;
            core.set_contact_law(ContactLaw { restitution_offset: 0.25, friction }).unwrap();
            both(core);
            assert_eq!(rf_contact_law(handle, &mut offset, &mut pyramid), RF_OK);
            assert_eq!((offset, pyramid), (0.25, 1));

            let (there, here) = (at(0.1, 0.0, 0.5), at(0.11, 0.0, 0.5));
            assert_eq!(rf_set_poses(handle, cube, &there, &here), RF_OK);
            core.set_poses(named[1], &isometry(0.1, 0.5), &isometry(0.11, 0.5)).unwrap();
            assert_eq!(rf_set_planes(handle, nothing(), 0), RF_OK);
            core.set_planes(&[]).unwrap();
            both(core);
        }
    });
    assert!(workspace.rim_is_whole());
}

/// A table: a plate and two walls under it, eight points each.
fn table() -> [[f32; 3]; 24] {
    let boxes = [
        ([0.2, 0.1, 0.01], [0.0, 0.0, 0.1]),
        ([0.01, 0.1, 0.045], [-0.19, 0.0, 0.045]),
        ([0.01, 0.1, 0.045], [0.19, 0.0, 0.045]),
    ];
    let boxes = boxes.map(|(half, [a, b, c])| corners(half).map(|[x, y, z]| [x + a, y + b, z + c]));
    std::array::from_fn(|i| boxes[i / 8][i % 8])
}

/// A table over a box, observed, and another that falls onto it, added: with their pieces, and as hulls. The first comes
/// by its poses or by frames of points.
#[test]
#[cfg_attr(miri, ignore = "makes models")]
fn pieces_have_the_bits_of_the_core() {
    let impulses =
        ModelConfig { features: FeatureSet::Impact, motion: Motion::Impulses, ..SMALLEST };
    let file = model(impulses);
    // No more than they take: of a table its points and two a piece.
    let limits = Limits { units: 3, points: 8 + 2 * (24 + 2 * 3) };
    let (table, counts) = (table(), [8_u16; 3]);
    let points = [&corners([0.03; 3])[..], &table].concat();
    let (low, high) = (at(0.0, 0.0, 0.0), at(0.05, 0.0, 0.2));
    let run = |in_pieces: bool, by_poses: bool| {
        let given = config(&file, limits.units as u32, limits.points as u32);
        let mut workspace = Workspace::of(&given);
        let handle = workspace.init(&given);
        let number = if in_pieces { 3 } else { 0 };
        let units = rf_units {
            unit_count: 2,
            physics: [RUBBER, STEEL].as_ptr(),
            point_counts: [8, 24].as_ptr(),
            point_count: 32,
            roles: null(),
            bodies: null(),
            inertias_kg_m2: null(),
            unit_pieces: if in_pieces { [0, 3].as_ptr() } else { null() },
            piece_counts: counts.as_ptr(),
            piece_count: number,
            piece_points: table.as_ptr().cast(),
            piece_point_count: 8 * number,
            young_pa: null(),
            rest_points: null(),
        };
        let added = rf_unit {
            piece_points: table.as_ptr().cast(),
            piece_counts: counts.as_ptr(),
            piece_count: number,
            ..unit(&table)
        };
        let (given, there) = (points.as_ptr().cast(), [low; 2]);
        unsafe {
            let (there, none) = (there.as_ptr(), null_mut());
            assert_eq!(
                match by_poses {
                    true => rf_observe_poses(handle, DT_S, &units, given, there, there, none),
                    false => rf_observe(handle, DT_S, &units, given, given, none),
                },
                RF_OK
            );
            assert_eq!(rf_add(handle, &added, &high, &high, null_mut()), RF_OK);
        }
        let (local, counts) = (table.map(Point3::from), &counts[..number]);
        let cube = corners([0.03; 3]).map(Point3::from);
        let pieces = Pieces::new(&local[..8 * number], counts);
        let hollow = |made| Unit::new(&local, physics(made)).pieces(pieces);
        let units = [Unit::new(&cube, physics(RUBBER)), hollow(STEEL)];
        with_simulator(&file, limits, |core| {
            let here = isometry(0.0, 0.0);
            if by_poses {
                let posed = units.map(|unit| Posed { unit, previous: here, current: here });
                core.observe_poses(DT_S, posed).unwrap();
            } else {
                core.observe(DT_S, units.map(|unit| Observed { unit, current: unit.points }))
                    .unwrap();
            }
            let above = isometry(0.05, 0.2);
            core.add(&hollow(RUBBER), &above, &above).unwrap();
            for _ in 0..8 {
                assert_eq!(poses(handle), bits(core));
                assert_eq!(step(handle), RF_OK);
                core.step().expect("steps");
            }
            assert_eq!(poses(handle), bits(core));
        });
        assert!(workspace.rim_is_whole());
        poses(handle)
    };
    for by_poses in [true, false] {
        assert_ne!(run(true, by_poses), run(false, by_poses));
    }
}

#[test]
fn fixed_units_stay_and_driven_units_go_where_they_are_sent() {
    let file = smallest();
    let (_workspace, handle) = scene(file);
    let [table, _, pusher] = ids(handle)[..] else { panic!("three units") };
    let before = poses(handle);
    for step_number in 1..4 {
        let target = at(-0.2 + 0.25 * step_number as f32, 0.0, 0.5);
        assert_eq!(unsafe { rf_drive(handle, pusher, &target) }, RF_OK);
        assert_eq!(step(handle), RF_OK);
        assert_eq!(poses(handle)[0], before[0]);
        let mut pose = at(0.0, 0.0, 0.0);
        assert_eq!(unsafe { rf_unit_pose(handle, pusher, &mut pose) }, RF_OK);
        for (found, sent) in pose.position.iter().zip(target.position) {
            assert!((found - sent).abs() < 1e-6, "{pose:?}");
        }
    }
    // Nowhere else: it stays.
    let there = poses(handle)[2];
    assert_eq!(step(handle), RF_OK);
    assert_eq!(poses(handle)[2], there);
    let mut pose = at(7.0, 7.0, 7.0);
    assert_eq!(unsafe { rf_unit_pose(handle, table, &mut pose) }, RF_OK);
    assert!((pose.position[2] - 0.1).abs() < 1e-6);
}

/// A scene built unit by unit, then emptied.
#[test]
fn scenes_can_begin_empty() {
    let file = smallest();
    let limits = room(file);
    let mut workspace = Workspace::of(&limits);
    let handle = workspace.init(&limits);
    let points = corners([0.1; 3]);
    let (unit, pose) = (unit(&points), at(0.0, 0.0, 0.5));
    let mut id = 7;
    unsafe {
        assert_eq!(rf_add(handle, &unit, &pose, &pose, &mut id), RF_ERROR_NO_TIMESTEP);
        assert_eq!(id, 7);
        assert_eq!(rf_set_dt(handle, DT_S), RF_OK);
        assert_eq!(rf_add(handle, &unit, &pose, &pose, &mut id), RF_OK);
        assert_eq!(ids(handle), [id]);
        assert_eq!(step(handle), RF_OK);
        assert_eq!(rf_remove(handle, id), RF_OK);
        assert_eq!(step(handle), RF_ERROR_NOT_OBSERVED);
        // Names are not used again.
        let old = id;
        assert_eq!(rf_add(handle, &unit, &pose, &pose, &mut id), RF_OK);
        assert_ne!(id, old);
        assert_eq!(rf_remove(handle, old), RF_ERROR_NO_SUCH_ID);
        // An observation ends them.
        assert_eq!(Scene::new(2).observe(handle), RF_OK);
        assert_eq!(rf_remove(handle, id), RF_ERROR_NO_SUCH_ID);
        assert_eq!(rf_add(handle, &unit, &pose, &pose, null_mut()), RF_OK);
        assert_eq!(ids(handle).len(), 3);
    }
}

/// Runs calls that must be refused, and shows that the scene goes on as one that they never reached.
fn refused(calls: impl FnOnce(*mut rf_simulator, [rf_unit_id; 3])) {
    let file = smallest();
    let ((_a, handle), (_b, other)) = (scene(file), scene(file));
    for handle in [handle, other] {
        assert_eq!(step(handle), RF_OK);
        let pusher = ids(handle)[2];
        assert_eq!(unsafe { rf_drive(handle, pusher, &at(-0.1, 0.0, 0.31)) }, RF_OK);
    }
    let before = (poses(handle), ids(handle));
    calls(handle, ids(handle).try_into().unwrap());
    assert_eq!((poses(handle), ids(handle)), before);
    for _ in 0..2 {
        assert_eq!((step(handle), step(other)), (RF_OK, RF_OK));
        assert_eq!(poses(handle), poses(other));
    }
}

#[test]
fn null_and_odd_pointers_are_refused() {
    refused(|handle, [table, cube, pusher]| {
        let points = corners([0.1; 3]);
        let (unit, pose) = (unit(&points), at(0.0, 0.0, 1.0));
        let odd = (&raw const pose).wrapping_byte_add(1);
        unsafe {
            assert_eq!(rf_add(handle, nothing(), &pose, &pose, null_mut()), RF_ERROR_NULL);
            assert_eq!(rf_add(handle, &unit, nothing(), &pose, null_mut()), RF_ERROR_NULL);
            assert_eq!(rf_add(handle, &unit, &pose, nothing(), null_mut()), RF_ERROR_NULL);
            let none = rf_unit { points: nothing(), ..unit };
            assert_eq!(rf_add(handle, &none, &pose, &pose, null_mut()), RF_ERROR_NULL);
            let long = rf_unit { point_count: usize::MAX / 2, ..unit };
            assert_eq!(rf_add(handle, &long, &pose, &pose, null_mut()), RF_ERROR_LENGTH);
            let inside = handle.wrapping_byte_add(64).cast();
            assert_eq!(rf_add(handle, &unit, &pose, &pose, inside), RF_ERROR_OVERLAP);
            let counts = [4_u16; 2];
            let (c, p) = (counts.as_ptr(), unit.points);
            for (piece_counts, piece_points, piece_count, expected) in [
                (nothing(), p, 1, RF_ERROR_NULL),
                (nothing(), p, 33, RF_ERROR_NULL),
                (c, nothing(), 1, RF_ERROR_NULL),
                (c, p, usize::MAX, RF_ERROR_LENGTH),
                (c, p, usize::MAX / 2, RF_ERROR_LENGTH),
                (c.wrapping_byte_add(1), p, 1, RF_ERROR_ALIGNMENT),
                (c, p.wrapping_byte_add(2), 1, RF_ERROR_ALIGNMENT),
                (inside.cast_const().cast(), p, 1, RF_ERROR_OVERLAP),
                (c, inside.cast_const().cast(), 1, RF_ERROR_OVERLAP),
            ] {
                let odd = rf_unit { piece_counts, piece_points, piece_count, ..unit };
                assert_eq!(rf_add(handle, &odd, &pose, &pose, null_mut()), expected);
            }
            assert_eq!(rf_drive(handle, pusher, nothing()), RF_ERROR_NULL);
            assert_eq!(rf_drive(handle, pusher, odd), RF_ERROR_ALIGNMENT);
            assert_eq!(rf_drive(handle, pusher, handle.cast()), RF_ERROR_OVERLAP);
            assert_eq!(rf_set_poses(handle, cube, nothing(), &pose), RF_ERROR_NULL);
            assert_eq!(rf_set_poses(handle, cube, &pose, nothing()), RF_ERROR_NULL);
            assert_eq!(rf_set_physics(handle, cube, nothing()), RF_ERROR_NULL);
            assert_eq!(rf_set_planes(handle, nothing(), 1), RF_ERROR_NULL);
            assert_eq!(rf_set_gravity(handle, nothing()), RF_ERROR_NULL);
            let mut short = [7; 2];
            assert_eq!(rf_unit_ids(handle, short.as_mut_ptr(), 2), RF_ERROR_BUFFER);
            assert_eq!(short, [7; 2]);
            for status in [
                rf_add(null_mut(), &unit, &pose, &pose, null_mut()),
                rf_remove(null_mut(), table),
                rf_drive(null_mut(), pusher, &pose),
                rf_set_poses(null_mut(), cube, &pose, &pose),
                rf_set_physics(null_mut(), cube, &RUBBER),
                rf_set_role(null_mut(), cube, RF_ROLE_FIXED),
                rf_set_planes(null_mut(), &WALL, 1),
                rf_set_gravity(null_mut(), [0.0; 3].as_ptr()),
                rf_set_network(null_mut(), 0),
                rf_set_contact_law(null_mut(), 0.0, 0),
                rf_contact_law(null_mut(), &mut 0.0, &mut 0),
                rf_contact_law(handle, null_mut(), &mut 0),
                rf_contact_law(handle, &mut 0.0, null_mut()),
                rf_set_dt(null_mut(), DT_S),
            ] {
                assert_eq!(status, RF_ERROR_NULL);
            }
        }
    });
}

#[test]
fn ids_that_name_nothing_are_refused() {
    refused(|handle, [_, _, pusher]| {
        let mut pose = at(0.0, 0.0, 1.0);
        for id in [0, pusher + 1, u64::MAX] {
            unsafe {
                for status in [
                    rf_remove(handle, id),
                    rf_drive(handle, id, &pose),
                    rf_set_poses(handle, id, &pose, &pose),
                    rf_set_physics(handle, id, &RUBBER),
                    rf_set_role(handle, id, RF_ROLE_FIXED),
                    rf_unit_pose(handle, id, &mut pose),
                ] {
                    assert_eq!(status, RF_ERROR_NO_SUCH_ID);
                    assert_eq!(detail(handle).found, id);
                }
            }
        }
        assert_eq!(pose, at(0.0, 0.0, 1.0));
    });
}

#[test]
fn bad_changes_are_refused() {
    refused(|handle, [table, cube, pusher]| {
        let check = |status: rf_status, expected: rf_status| {
            assert_eq!((status, detail(handle).code), (expected, expected));
            detail(handle)
        };
        let pose = at(0.0, 0.0, 1.0);
        let bad = rf_pose { quaternion: [0.0; 4], ..pose };
        let far = at(2e6, 0.0, 0.0);
        unsafe {
            for id in [table, cube] {
                let numbers = check(rf_drive(handle, id, &pose), RF_ERROR_NOT_DRIVEN);
                assert_eq!(numbers.found, id);
            }
            for bad in [&bad, &far] {
                assert_eq!(check(rf_drive(handle, pusher, bad), RF_ERROR_BAD_POSE).unit, 2);
                let numbers = check(rf_set_poses(handle, cube, &pose, bad), RF_ERROR_BAD_POSE);
                assert_eq!(numbers.unit, 1);
                check(rf_set_poses(handle, cube, bad, &pose), RF_ERROR_BAD_POSE);
            }
            let heavy = rf_physics { mass_kg: 1e10, ..RUBBER };
            let numbers = check(rf_set_physics(handle, cube, &heavy), RF_ERROR_BAD_PHYSICS);
            assert_eq!(numbers.unit, 1);
            for (stiffness_n_m, dissipation_s_m) in
                [(-1.0, 0.0), (1e-4, 0.0), (1e13, 0.0), (f32::NAN, 0.0), (1e4, -1.0), (0.0, 1e7)]
            {
                let bad = rf_compliance { stiffness_n_m, dissipation_s_m };
                let numbers = check(rf_set_compliance(handle, cube, &bad), RF_ERROR_BAD_COMPLIANCE);
                assert_eq!(numbers.unit, 1);
                let status = rf_set_plane_compliance(handle, 0, &bad);
                assert_eq!(check(status, RF_ERROR_BAD_COMPLIANCE).index, 0);
            }
            let soft = rf_compliance { stiffness_n_m: 1e4, dissipation_s_m: 4.0 };
            let numbers = check(rf_set_plane_compliance(handle, 1, &soft), RF_ERROR_NO_SUCH_PLANE);
            assert_eq!((numbers.found, numbers.expected), (1, 1));
            check(rf_set_compliance(handle, cube, core::ptr::null()), RF_ERROR_NULL);
            let numbers = check(rf_set_role(handle, cube, 3), RF_ERROR_BAD_ROLE);
            assert_eq!((numbers.found, numbers.unit), (3, RF_NONE));
            let nine =
                check(rf_set_planes(handle, [WALL; 9].as_ptr(), 9), RF_ERROR_TOO_MANY_PLANES);
            assert_eq!((nine.found, nine.expected), (9, RF_MAX_PLANES as u64));
            for bad in [
                rf_plane { normal: [0.0, 0.0, 1.1], ..WALL },
                rf_plane { offset_m: f32::NAN, ..WALL },
                rf_plane { friction: -1.0, ..WALL },
                rf_plane { restitution: f32::INFINITY, ..WALL },
            ] {
                let planes = [WALL, bad];
                let status = rf_set_planes(handle, planes.as_ptr(), 2);
                assert_eq!(check(status, RF_ERROR_BAD_PLANE).index, 1);
            }
            for gravity in [[f32::NAN, 0.0, 0.0], [0.0, 2e4, 0.0], [0.0, 0.0, -f32::INFINITY]] {
                check(rf_set_gravity(handle, gravity.as_ptr()), RF_ERROR_BAD_GRAVITY);
            }
            for offset in [-0.1, 1.5, f32::NAN, f32::INFINITY] {
                check(rf_set_contact_law(handle, offset, 1), RF_ERROR_BAD_CONTACT_LAW);
            }
            for dt in [0.0, -1.0, f32::NAN, f32::INFINITY] {
                check(rf_set_dt(handle, dt), RF_ERROR_BAD_TIMESTEP);
            }
        }
    });
}

#[test]
fn bad_units_are_not_added() {
    refused(|handle, _| {
        let points = corners([0.1; 3]);
        let flat = [[1.0_f32; 3]; 8];
        let mut odd = points;
        odd[5][1] = f32::NAN;
        let pose = at(0.0, 0.0, 1.0);
        let bad = rf_pose { position: [f32::NAN; 3], ..pose };
        let mut id = 7;
        let mut add = |unit: rf_unit, previous: &rf_pose, current: &rf_pose| unsafe {
            let status = rf_add(handle, &unit, previous, current, &mut id);
            assert_eq!((detail(handle).code, id), (status, 7));
            (status, detail(handle))
        };
        let sound = unit(&points);
        let number = |(status, numbers): (rf_status, rf_detail)| (status, numbers.unit);
        let thin = rf_unit { point_count: 3, ..sound };
        assert_eq!(number(add(thin, &pose, &pose)), (RF_ERROR_TOO_FEW_POINTS, 3));
        assert_eq!(number(add(unit(&flat), &pose, &pose)), (RF_ERROR_COINCIDENT, 3));
        let (status, numbers) = add(unit(&odd), &pose, &pose);
        assert_eq!((status, numbers.unit, numbers.index), (RF_ERROR_BAD_POINT, 3, 5));
        let light = rf_unit { physics: rf_physics { mass_kg: 0.0, ..RUBBER }, ..sound };
        assert_eq!(number(add(light, &pose, &pose)), (RF_ERROR_BAD_PHYSICS, 3));
        for inertia_kg_m2 in [[1.0, 0.0, 1.0], [1.0, 1.0, 2.1], [f32::NAN; 3], [-1.0; 3]] {
            let odd = rf_unit { inertia_kg_m2, ..sound };
            assert_eq!(number(add(odd, &pose, &pose)), (RF_ERROR_BAD_INERTIA, 3));
        }
        let many = [[0.1; 3]; 300];
        let mut far = many;
        far[7][2] = -1.1e6;
        let mut none = many;
        none[270][0] = f32::NAN;
        let pieces = |counts: &[u16], points: &[[f32; 3]]| rf_unit {
            piece_points: points.as_ptr().cast(),
            piece_counts: counts.as_ptr(),
            piece_count: counts.len(),
            ..sound
        };
        let (status, numbers) = add(pieces(&[4; 33], &many), &pose, &pose);
        assert_eq!((status, numbers.unit), (RF_ERROR_TOO_MANY_PIECES, 3));
        assert_eq!((numbers.found, numbers.expected), (33, RF_MAX_PIECES as u64));
        for (counts, points, index) in [
            (&[3_u16, 8][..], &many, 0),
            (&[8, 3], &many, 1),
            (&[0, 0], &many, 0),
            (&[8, 8, 256], &many, 2),
            (&[4, 4], &far, 1),
            (&[8, 4], &far, 0),
            (&[7, 255, 9], &none, 2),
        ] {
            let (status, numbers) = add(pieces(counts, points), &pose, &pose);
            let found = (status, numbers.unit, numbers.index);
            assert_eq!(found, (RF_ERROR_BAD_PIECE, 3, index), "{counts:?}");
        }
        // Eight points are left: the unit's own fit, its piece's and two do not.
        let (status, numbers) = add(pieces(&[8], &many), &pose, &pose);
        let found = (status, numbers.found, numbers.expected);
        assert_eq!(found, (RF_ERROR_TOO_MANY_POINTS, 34, 32));
        for (previous, current) in [(&bad, &pose), (&pose, &bad)] {
            assert_eq!(number(add(sound, previous, current)), (RF_ERROR_BAD_POSE, 3));
        }
        let (status, numbers) = add(rf_unit { role: 9, ..sound }, &pose, &pose);
        assert_eq!((status, numbers.found), (RF_ERROR_BAD_ROLE, 9));
        for body in [-2, 65535] {
            let (status, numbers) = add(rf_unit { body, ..sound }, &pose, &pose);
            assert_eq!((status, numbers.found as i64), (RF_ERROR_BAD_BODY, body.into()));
        }
        let many = [points; 2].concat();
        let (status, numbers) = add(unit(&many), &pose, &pose);
        let found = (status, numbers.found, numbers.expected);
        assert_eq!(found, (RF_ERROR_TOO_MANY_POINTS, 40, 32));
    });
    // No room for another unit.
    let (_workspace, handle) = scene(smallest());
    let points = &corners([0.1; 3])[..4];
    let (four, pose) = (unit(points), at(0.0, 0.0, 1.0));
    unsafe {
        assert_eq!(rf_add(handle, &four, &pose, &pose, null_mut()), RF_OK);
        assert_eq!(rf_add(handle, &four, &pose, &pose, null_mut()), RF_ERROR_TOO_MANY_UNITS);
    }
    assert_eq!((detail(handle).found, detail(handle).expected), (5, 4));
    assert_eq!(ids(handle).len(), 4);
}

/// A simulator made here steps and changes in another thread, and comes back.
#[test]
fn handles_go_to_another_thread() {
    struct Sent(*mut rf_simulator);
    // SAFETY: what this test shows.
    unsafe impl Send for Sent {}
    impl Sent {
        fn into_inner(self) -> *mut rf_simulator {
            self.0
        }
    }
    let file = smallest();
    let ((_a, here), (_b, there)) = (scene(file), scene(file));
    let run = |handle: *mut rf_simulator| {
        let pusher = ids(handle)[2];
        assert_eq!(unsafe { rf_drive(handle, pusher, &at(-0.1, 0.0, 0.31)) }, RF_OK);
        assert_eq!(step(handle), RF_OK);
        poses(handle)
    };
    let sent = Sent(there);
    let moved = std::thread::spawn(move || run(sent.into_inner())).join().expect("ends");
    assert_eq!(run(here), moved);
    assert_eq!((step(here), step(there)), (RF_OK, RF_OK));
    assert_eq!(poses(here), poses(there));
}

/// A box hangs from a pusher that goes up, and is let go: against the core.
#[test]
fn joints_have_the_bits_of_the_core() {
    let file = smallest();
    let ((_a, handle), (_b, free)) = (scene(file), scene(file));
    // Not one place yet, and not the same numbers: a joint that does nothing or takes the wrong pivot would show.
    let (own, parents) = ([-0.1_f32, 0.0, 0.1], [0.1_f32, 0.02, 0.07]);
    with_core(file, |core| {
        let [_, cube, pusher] = ids(handle)[..] else { panic!("three units") };
        let (own_at, parents_at) = (own.as_ptr(), parents.as_ptr());
        assert_eq!(unsafe { rf_join(handle, cube, pusher, own_at, parents_at) }, RF_OK);
        let [unit, parent] = [1, 2].map(|number| core.unit(number).unwrap().id());
        let [pivot, parent_pivot] = [own, parents].map(Point3::from);
        core.join(&Joint::ball(unit, parent, pivot, parent_pivot)).unwrap();
        for count in 1..=4_u8 {
            let height = 0.31 + 0.05 * f32::from(count);
            if count == 4 {
                assert_eq!(unsafe { rf_unjoin(handle, cube) }, RF_OK);
                assert!(core.unjoin(unit).unwrap().is_some());
            }
            for handle in [handle, free] {
                let target = at(-0.2, 0.0, height);
                assert_eq!(unsafe { rf_drive(handle, ids(handle)[2], &target) }, RF_OK);
                assert_eq!(step(handle), RF_OK);
            }
            core.drive(parent, &isometry(-0.2, height)).unwrap();
            core.step().unwrap();
            assert_eq!(poses(handle), bits(core));
            assert_ne!(poses(handle)[1], poses(free)[1], "the box hangs, or did");
            let pivot = core.pose(unit).unwrap() * pivot;
            let parents = core.pose(parent).unwrap() * parent_pivot;
            assert_eq!((pivot - parents).norm() < 1e-5, count < 4, "{pivot} {parents}");
        }
    });
}

/// A door that goes to its target, and what is refused with it.
#[test]
fn joints_with_axes() {
    let (_a, handle) = scene(rigidformer_weights::EDGE);
    let [table, cube, _] = ids(handle)[..] else { panic!("three units") };
    let hinge = rf_joint {
        kind: RF_JOINT_REVOLUTE,
        pivot: [-0.1, 0.0, 0.1],
        parent_pivot: [0.0, 0.0, 0.2],
        axis: [0.0, 0.0, 2.0],
        limits: [-1.0, 1.0],
        max_force: 0.0,
    };
    let mut angle = f32::NAN;
    unsafe {
        assert_eq!(rf_joint_position(handle, cube, &mut angle), RF_ERROR_BAD_JOINT);
        assert_eq!(rf_set_joint_target(handle, cube, 0.5), RF_ERROR_BAD_JOINT);
        for bad in [
            rf_joint { kind: 4, ..hinge },
            rf_joint { axis: [0.0; 3], ..hinge },
            rf_joint { axis: [f32::NAN, 0.0, 1.0], ..hinge },
            rf_joint { limits: [1.0, -1.0], ..hinge },
            rf_joint { max_force: -1.0, ..hinge },
        ] {
            assert_eq!(rf_join_by(handle, cube, table, &bad), RF_ERROR_BAD_JOINT, "{bad:?}");
        }
        assert_eq!(rf_join_by(handle, cube, table, null()), RF_ERROR_NULL);
        assert_eq!(rf_join_by(handle, cube, table, &hinge), RF_OK);
        assert_eq!(rf_set_joint_target(handle, cube, f32::NAN), RF_ERROR_BAD_JOINT);
        assert_eq!(rf_set_joint_target(handle, cube, 0.25), RF_OK);
        assert_eq!(step(handle), RF_OK);
        assert_eq!(rf_joint_position(handle, 77, &mut angle), RF_ERROR_NO_SUCH_ID);
        assert_eq!(rf_joint_position(handle, cube, null_mut()), RF_ERROR_NULL);
        assert_eq!(rf_joint_position(handle, cube, &mut angle), RF_OK);
        assert!((angle - 0.25).abs() < 1e-3, "{angle}");
        assert_eq!(rf_set_joint_target(handle, cube, f32::INFINITY), RF_OK);
    }
}

/// What a C program can do wrong with joints. The joint that there is stays, and the scene goes on as one that the calls never
/// reached.
#[test]
fn bad_joints_are_refused() {
    let file = smallest();
    let ((_a, handle), (_b, other)) = (scene(file), scene(file));
    let (own, parents) = ([-0.1_f32, 0.0, 0.1], [0.1_f32, 0.02, 0.07]);
    let (own, parents) = (own.as_ptr(), parents.as_ptr());
    let points = corners([0.1; 3]);
    let (pose, mut gone) = (at(0.0, 0.0, 1.0), 0);
    for handle in [other, handle] {
        let [_, cube, pusher] = ids(handle)[..] else { panic!("three units") };
        unsafe {
            assert_eq!(rf_add(handle, &unit(&points), &pose, &pose, &mut gone), RF_OK);
            assert_eq!(rf_remove(handle, gone), RF_OK);
            assert_eq!(rf_join(handle, cube, pusher, own, parents), RF_OK);
        }
    }
    let [table, cube, pusher] = ids(handle)[..] else { panic!("three units") };
    let before = poses(handle);
    let check = |status: rf_status, expected: rf_status| {
        let numbers = detail(handle);
        assert_eq!((status, numbers.code), (expected, expected));
        (numbers.found, numbers.expected)
    };
    unsafe {
        let inside = handle.cast_const().wrapping_byte_add(64).cast();
        for (bad, expected) in [
            (nothing(), RF_ERROR_NULL),
            (own.wrapping_byte_add(1), RF_ERROR_ALIGNMENT),
            (inside, RF_ERROR_OVERLAP),
        ] {
            check(rf_join(handle, cube, table, bad, parents), expected);
            check(rf_join(handle, cube, table, own, bad), expected);
        }
        assert_eq!(rf_join(null_mut(), cube, table, own, parents), RF_ERROR_NULL);
        assert_eq!(rf_unjoin(null_mut(), cube), RF_ERROR_NULL);
        for id in [gone, 0, u64::MAX] {
            let found = check(rf_join(handle, id, table, own, parents), RF_ERROR_NO_SUCH_ID);
            assert_eq!(found, (id, 0));
            let found = check(rf_join(handle, cube, id, own, parents), RF_ERROR_NO_SUCH_ID);
            assert_eq!(found, (id, 0));
            assert_eq!(check(rf_unjoin(handle, id), RF_ERROR_NO_SUCH_ID), (id, 0));
        }
        for (id, parent) in [(cube, cube), (pusher, cube)] {
            let found = check(rf_join(handle, id, parent, own, parents), RF_ERROR_BAD_JOINT);
            assert_eq!(found, (id, parent), "a circle");
        }
        for bad in [[f32::NAN, 0.0, 0.0], [0.0, -f32::INFINITY, 0.0], [0.0, 0.0, 2e6]] {
            let bad = bad.as_ptr();
            for (own, parents) in [(bad, parents), (own, bad)] {
                let found = check(rf_join(handle, cube, table, own, parents), RF_ERROR_BAD_JOINT);
                assert_eq!(found, (cube, 0), "a pivot");
            }
        }
        // No error, and no change: it hangs from nothing.
        assert_eq!(rf_unjoin(handle, table), RF_OK);
    }
    assert_eq!(poses(handle), before);
    for height in [0.36, 0.41] {
        for handle in [handle, other] {
            let target = at(-0.2, 0.0, height);
            assert_eq!(unsafe { rf_drive(handle, ids(handle)[2], &target) }, RF_OK);
            assert_eq!(step(handle), RF_OK);
        }
        assert_eq!(poses(handle), poses(other));
    }
}

/// Ground of varying height: the core's bits, and what is refused with it.
#[test]
fn height_fields() {
    let (_a, handle) = scene(rigidformer_weights::EDGE);
    // A step of 30 cm under the box.
    let heights = [0.3, 0.3, 0.3, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0_f32];
    let field = rf_height_field {
        heights_m: heights.as_ptr(),
        rows: 3,
        columns: 3,
        spacing_m: [1.0, 1.0],
        corner_m: [-1.0, -1.0, 0.0],
        friction: 0.5,
        restitution: 0.0,
    };
    let check = |status: rf_status, expected: rf_status| {
        assert_eq!((status, detail(handle).code), (expected, expected));
        detail(handle)
    };
    unsafe {
        let set = |field: &rf_height_field| rf_set_height_field(handle, field);
        for bad in [
            rf_height_field { rows: 1, columns: 9, ..field },
            rf_height_field { rows: 0, ..field },
            rf_height_field { spacing_m: [0.0, 1.0], ..field },
            rf_height_field { corner_m: [f32::NAN, 0.0, 0.0], ..field },
            rf_height_field { friction: -1.0, ..field },
        ] {
            assert_eq!(check(set(&bad), RF_ERROR_BAD_HEIGHT_FIELD).index, RF_NONE, "{bad:?}");
        }
        check(set(&rf_height_field { heights_m: null(), ..field }), RF_ERROR_NULL);
        let odd = heights.as_ptr().cast::<u8>().add(1).cast();
        check(
            set(&rf_height_field { heights_m: odd, rows: 2, columns: 2, ..field }),
            RF_ERROR_ALIGNMENT,
        );
        let wrong = [0.0, 0.0, f32::INFINITY, 0.0];
        let wrong = rf_height_field { heights_m: wrong.as_ptr(), rows: 2, columns: 2, ..field };
        assert_eq!(check(set(&wrong), RF_ERROR_BAD_HEIGHT_FIELD).index, 2);
        let (mut bytes, mut length) = (0, 0);
        assert_eq!(rf_state_bytes(handle, &mut bytes), RF_OK);
        let mut state = vec![0; bytes];
        assert_eq!(rf_save(handle, state.as_mut_ptr(), state.len(), &mut length), RF_OK);
        assert_eq!(set(&field), RF_OK);
        check(rf_load(handle, state.as_ptr(), length), RF_ERROR_STATE_HEIGHT_FIELD);
        assert_eq!(step(handle), RF_OK);
        assert_eq!(rf_set_height_field(handle, null()), RF_OK);
        assert_eq!(rf_load(handle, state.as_ptr(), length), RF_OK);
    }
}
