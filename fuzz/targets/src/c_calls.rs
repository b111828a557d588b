//! Sequences of calls of the C interface, as a caller with mistakes makes them: NULL, misaligned and short pointers, ids of units that
//! have gone, handles that have ended, two simulators in turn. AddressSanitizer watches each byte that is read or written. A call that
//! fails leaves the poses as they were. An `rf_init` that fails says the same in its detail; details of other calls are not looked at.
#![allow(unsafe_code)]

use crate::structured::structured;
use arbitrary::Arbitrary;
use rigidformer_capi::edit::*;
use rigidformer_capi::ffi::*;
use rigidformer_capi::health::*;
use rigidformer_capi::types::*;
use rigidformer_tests::bits::{PRECISIONS, quantised};
use rigidformer_tests::hostile::{
    SMALLEST, SMALLEST_BONDS, SMALLEST_IMPACT, SMALLEST_NEAR, SMALLEST_SOFT, random_model,
};
use rigidformer_weights::{AlignedBuffer, ModelConfig};
use std::ffi::{CStr, c_char};
use std::mem::MaybeUninit;
use std::ptr::{null, null_mut};
use std::sync::LazyLock;

static MODELS: LazyLock<Vec<AlignedBuffer>> = LazyLock::new(|| {
    let sources = [
        random_model(SMALLEST, 1),
        random_model(ModelConfig { command_size: 2, ..SMALLEST }, 2),
        random_model(SMALLEST_IMPACT, 3),
        random_model(SMALLEST_SOFT, 4),
        random_model(SMALLEST_BONDS, 5),
        random_model(SMALLEST_NEAR, 6),
    ];
    let each =
        |source: &AlignedBuffer| PRECISIONS.map(|(_, precision)| quantised(source, precision));
    sources.iter().flat_map(each).collect()
});

/// Mostly of the size of a scene, sometimes what numbers should not be.
#[derive(Arbitrary, Clone, Copy, Debug)]
struct Number(i16);

impl Number {
    fn value(self) -> f32 {
        match self.0 {
            i16::MIN => f32::NAN,
            -32767 => f32::NEG_INFINITY,
            -32766 => f32::MIN,
            32764 => 1e-42,
            32765 => 1e6,
            32766 => f32::MAX,
            i16::MAX => f32::INFINITY,
            x => f32::from(x) / 4096.0,
        }
    }
}

#[derive(Arbitrary, Clone, Debug)]
struct Pose {
    numbers: [Number; 7],
    is_sound: bool,
}

impl Pose {
    fn value(&self) -> rf_pose {
        let [x, y, z, mut q @ ..] = self.numbers.map(Number::value);
        let length = q.iter().map(|number| number * number).sum::<f32>().sqrt();
        if self.is_sound && length.is_finite() && length > 0.0 {
            q = q.map(|number| number / length);
        }
        rf_pose { position: [x, y, z], quaternion: q }
    }
}

/// What is wrong with the pointers of a call: mostly nothing.
#[derive(Arbitrary, Clone, Copy, Debug)]
struct Mistake {
    kind: u8,
    which: u8,
}

impl Mistake {
    /// A pointer as the call gets it, if it is pointer number `which` of the call.
    fn of<T>(self, which: u8, pointer: *const T) -> *const T {
        match self.kind {
            1 if self.which == which => null(),
            // Never followed: the library must see that it is misaligned.
            2 if self.which == which && align_of::<T>() > 1 => pointer.wrapping_byte_add(1),
            _ => pointer,
        }
    }
}

#[derive(Arbitrary, Clone, Debug)]
struct FuzzUnit {
    physics: [Number; 3],
    usual: bool,
    points: Vec<[Number; 3]>,
    shift: [Number; 3],
    role: u8,
    body: i8,
    poses: [Pose; 2],
    inertia: Option<[Number; 3]>,
    pieces: Vec<u8>,
    young: u8,
}

impl FuzzUnit {
    fn physics(&self) -> rf_physics {
        physics(self.physics, self.usual)
    }

    /// Exactly as long as it says, so that reading behind it is seen.
    fn points(&self) -> Box<[[f32; 3]]> {
        self.points.iter().map(|row| row.map(Number::value)).collect()
    }

    fn role(&self) -> u32 {
        role(self.role)
    }

    fn pieces(&self) -> Box<[u16]> {
        self.pieces.iter().map(|count| u16::from(*count) % 24).collect()
    }
}

fn physics(row: [Number; 3], usual: bool) -> rf_physics {
    let [mass_kg, friction, restitution] = row.map(Number::value);
    if usual {
        return rf_physics { mass_kg: 1.0, friction: 0.5, restitution: 0.5 };
    }
    rf_physics { mass_kg, friction, restitution }
}

fn role(code: u8) -> u32 {
    match code {
        200.. => u32::from(code),
        code => u32::from(code % 3),
    }
}

#[derive(Arbitrary, Debug)]
struct Observation {
    units: Vec<FuzzUnit>,
    dt: u8,
    with: u8,
    count: i8,
    mistake: Mistake,
}

#[derive(Arbitrary, Debug)]
enum Call {
    Init { model: u8, units: u8, points: u8, short: u8, cut: Option<u16>, mistake: Mistake },
    Release,
    Other,
    Observe(Observation),
    ObservePoses(Observation),
    Command(Vec<Number>, Mistake),
    Step(u8, Mistake),
    Add(FuzzUnit, Mistake),
    Remove(u8),
    Drive(u8, Pose, Mistake),
    SetPoses(u8, [Pose; 2], Mistake),
    SetPhysics(u8, [Number; 3], bool, Mistake),
    SetRole(u8, u8),
    SetPlanes(Vec<[Number; 6]>, bool, Mistake),
    SetGravity([Number; 3], Mistake),
    SetDt(Number),
    Join([u8; 2], [[Number; 3]; 2], Mistake),
    Unjoin(u8),
    Bond(Vec<[u8; 2]>, Mistake),
    BreakBond([u8; 2], Mistake),
    Read { what: u8, unit: u8, capacity: u8, mistake: Mistake },
    Innovation([Pose; 2], [Number; 6], Mistake),
    Quarantine(u32),
    Text(i32),
}

/// A simulator in memory of exactly the length that was asked for.
struct Slot {
    /// What the handle points into.
    #[expect(dead_code, reason = "kept for the handle")]
    memory: Vec<MaybeUninit<Block>>,
    handle: *mut rf_simulator,
    /// Ids that once were.
    ids: Vec<rf_unit_id>,
}

#[repr(C, align(16))]
#[derive(Clone, Copy)]
struct Block([u8; 16]);

const ZERO_POSE: rf_internal_pose = rf_internal_pose { rotation: [0.0; 9], centre: [0.0; 3] };

impl Slot {
    fn new() -> Self {
        Slot { memory: Vec::new(), handle: null_mut(), ids: Vec::new() }
    }

    fn id(&self, number: u8) -> rf_unit_id {
        match number {
            250.. => u64::from(number) << 20,
            number => {
                self.ids.get(usize::from(number) % self.ids.len().max(1)).copied().unwrap_or(0)
            }
        }
    }

    /// Ids and poses to the bit; nothing where there is no simulator.
    fn state(&mut self) -> Option<(Vec<rf_unit_id>, Vec<u32>)> {
        let mut count = 0;
        // SAFETY: here and in all calls below, pointers are NULL, misaligned or point to what their lengths say.
        if unsafe { rf_unit_count(self.handle, &mut count) } != rf_status::RF_OK {
            return None;
        }
        let count = count as usize;
        let (mut ids, mut poses) = (vec![0; count], vec![ZERO_POSE; count]);
        unsafe {
            assert_eq!(rf_unit_ids(self.handle, ids.as_mut_ptr(), count), rf_status::RF_OK);
            let read = rf_internal_poses(self.handle, poses.as_mut_ptr(), count);
            assert_eq!(read, rf_status::RF_OK);
        }
        for id in &ids {
            if !self.ids.contains(id) {
                self.ids.push(*id);
            }
        }
        let numbers = poses.iter().flat_map(|pose| pose.rotation.iter().chain(&pose.centre));
        let bits: Vec<u32> = numbers
            .inspect(|number| assert!(number.is_finite(), "a pose that is not finite"))
            .map(|number| number.to_bits())
            .collect();
        Some((ids, bits))
    }
}

fn observe(slot: &Slot, given: &Observation, is_of_poses: bool) -> rf_status {
    let Observation { units, mistake, .. } = given;
    let units = &units[..units.len().min(8)];
    let physics: Box<[_]> = units.iter().map(FuzzUnit::physics).collect();
    let counts: Box<[u32]> = units.iter().map(|unit| unit.points.len() as u32).collect();
    let roles: Box<[u32]> = units.iter().map(FuzzUnit::role).collect();
    let bodies: Box<[i32]> = units.iter().map(|unit| i32::from(unit.body)).collect();
    let inertias: Box<[f32]> = units
        .iter()
        .flat_map(|unit| unit.inertia.unwrap_or([Number(0); 3]))
        .map(Number::value)
        .collect();
    let pieces: Vec<Box<[u16]>> = units.iter().map(FuzzUnit::pieces).collect();
    let unit_pieces: Box<[u16]> = pieces.iter().map(|pieces| pieces.len() as u16).collect();
    let piece_counts: Box<[u16]> = pieces.iter().flatten().copied().collect();
    let piece_points: usize = piece_counts.iter().map(|count| usize::from(*count)).sum();
    let piece_points: Box<[[f32; 3]]> = (0..piece_points)
        .map(|i| [(i % 3) as f32, (i % 5) as f32, (i % 7) as f32].map(|x| x / 10.0))
        .collect();
    let points: Box<[[f32; 3]]> = units.iter().flat_map(FuzzUnit::points).collect();
    let young: Box<[f32]> = units.iter().map(|unit| 1e3 * f32::from(unit.young)).collect();
    let current: Box<[[f32; 3]]> = units
        .iter()
        .flat_map(|unit| {
            let shift = unit.shift.map(|number| number.value() / 8.0);
            unit.points()
                .into_iter()
                .map(move |row| std::array::from_fn(|axis| row[axis] + shift[axis]))
        })
        .collect();
    let poses: [Box<[rf_pose]>; 2] =
        [0, 1].map(|frame| units.iter().map(|unit| unit.poses[frame].value()).collect());
    let with = |bit: u8| given.with & (1 << bit) != 0;
    // NULL where the caller has none of it.
    fn optional<T>(is_given: bool, list: &[T]) -> *const T {
        if is_given { list.as_ptr() } else { null() }
    }
    // A sum that does not fit must be refused before anything behind it is read.
    let wrong = usize::try_from(given.count).ok().filter(|count| *count >= 120);
    let point_count = wrong.unwrap_or(points.len());
    let asked = rf_units {
        unit_count: units.len(),
        physics: mistake.of(0, physics.as_ptr()),
        point_counts: mistake.of(1, counts.as_ptr()),
        point_count,
        roles: mistake.of(2, optional(with(0), &roles)),
        bodies: mistake.of(3, optional(with(1), &bodies)),
        inertias_kg_m2: mistake.of(4, optional(with(2), &inertias)),
        unit_pieces: mistake.of(5, optional(with(3), &unit_pieces)),
        piece_counts: mistake.of(6, optional(with(3), &piece_counts)),
        piece_count: if with(3) { piece_counts.len() } else { 0 },
        piece_points: mistake.of(7, optional(with(3), &piece_points).cast()),
        piece_point_count: if with(3) { piece_points.len() } else { 0 },
        young_pa: mistake.of(12, optional(with(5), &young)),
        rest_points: mistake.of(13, optional(with(5), &points).cast()),
    };
    let dt_s = f32::from(given.dt) / 240.0;
    let mut seen = rf_observation::default();
    let seen: *mut rf_observation = if with(4) { &mut seen } else { null_mut() };
    let (units, points) = (mistake.of(8, &asked), mistake.of(9, points.as_ptr().cast::<f32>()));
    unsafe {
        if is_of_poses {
            let (before, now) =
                (mistake.of(10, poses[0].as_ptr()), mistake.of(11, poses[1].as_ptr()));
            rf_observe_poses(slot.handle, dt_s, units, points, before, now, seen)
        } else {
            let current = mistake.of(10, current.as_ptr().cast::<f32>());
            rf_observe(slot.handle, dt_s, units, points, current, seen)
        }
    }
}

fn init(slot: &mut Slot, call: &Call) -> rf_status {
    let Call::Init { model, units, points, short, cut, mistake } = call else {
        return rf_status::RF_OK;
    };
    let model = &MODELS[usize::from(*model) % MODELS.len()];
    let length = cut.map_or(model.len(), |cut| model.len().saturating_sub(usize::from(cut)));
    let config = rf_config {
        abi_version: RF_ABI_VERSION + u32::from(mistake.kind == 3),
        max_units: u32::from(*units % 9),
        max_points: u32::from(*points % 65),
        threads: 0,
        model: mistake.of(0, model.as_ptr()),
        model_bytes: length,
    };
    let config = mistake.of(1, &config);
    let mut bytes = 0_usize;
    let out = mistake.of(2, &raw mut bytes as *const usize).cast_mut();
    let status = unsafe { rf_workspace_bytes(config, out) };
    if status != rf_status::RF_OK {
        // rf_init must find the same.
        bytes = 4096;
    }
    let given = bytes.saturating_sub(usize::from(*short));
    let mut memory = vec![MaybeUninit::uninit(); bytes.div_ceil(16)];
    let (mut handle, mut detail) = (null_mut(), MaybeUninit::<rf_detail>::uninit());
    let workspace = mistake.of(3, memory.as_mut_ptr() as *const Block).cast_mut();
    let done =
        unsafe { rf_init(config, workspace.cast(), given, &mut handle, detail.as_mut_ptr()) };
    // SAFETY: rf_init writes the detail whatever it says.
    assert_eq!(unsafe { detail.assume_init_ref() }.code, done);
    assert_eq!(handle.is_null(), done != rf_status::RF_OK);
    if done == rf_status::RF_OK {
        *slot = Slot { memory, handle, ids: Vec::new() };
    }
    done
}

fn read(slot: &Slot, what: u8, unit: u8, capacity: u8, mistake: Mistake) {
    let (handle, capacity) = (slot.handle, usize::from(capacity % 80));
    let id = slot.id(unit);
    fn room<T>(capacity: usize) -> Vec<MaybeUninit<T>> {
        (0..capacity).map(|_| MaybeUninit::uninit()).collect()
    }
    unsafe {
        match what % 10 {
            0 => {
                let mut out = room::<rf_unit_id>(capacity);
                rf_unit_ids(
                    handle,
                    mistake.of(0, out.as_mut_ptr() as *const rf_unit_id).cast_mut(),
                    capacity,
                );
            }
            1 => {
                let mut out = room::<rf_pose>(capacity);
                rf_poses(
                    handle,
                    mistake.of(0, out.as_mut_ptr() as *const rf_pose).cast_mut(),
                    capacity,
                );
            }
            2 => {
                let mut out = room::<rf_internal_pose>(capacity);
                let out = out.as_mut_ptr() as *const rf_internal_pose;
                rf_internal_poses(handle, mistake.of(0, out).cast_mut(), capacity);
            }
            3 | 4 => {
                let (mut out, mut count) = (room::<[f32; 3]>(capacity), 0_usize);
                let out = mistake.of(0, out.as_mut_ptr() as *const f32).cast_mut();
                let count = mistake.of(1, &raw mut count as *const usize).cast_mut();
                match what % 10 {
                    3 => rf_points(handle, unit.into(), out, capacity, count),
                    _ => rf_soft_points(handle, unit.into(), out, capacity, count),
                };
            }
            5 => {
                let (mut out, mut count) = (room::<rf_bonded>(capacity), 0_usize);
                let out = mistake.of(0, out.as_mut_ptr() as *const rf_bonded).cast_mut();
                rf_bonds(
                    handle,
                    out,
                    capacity,
                    mistake.of(1, &raw mut count as *const usize).cast_mut(),
                );
            }
            6 => {
                let mut out = MaybeUninit::uninit();
                rf_unit_pose(
                    handle,
                    id,
                    mistake.of(0, out.as_mut_ptr() as *const rf_pose).cast_mut(),
                );
            }
            7 => {
                let mut out = MaybeUninit::uninit();
                rf_unit_health(
                    handle,
                    id,
                    mistake.of(0, out.as_mut_ptr() as *const rf_health).cast_mut(),
                );
            }
            8 => {
                let mut out = MaybeUninit::uninit();
                rf_last_error_detail(
                    handle,
                    mistake.of(0, out.as_mut_ptr() as *const rf_detail).cast_mut(),
                );
            }
            _ => {
                let mut out = 0_u32;
                rf_unit_count(handle, mistake.of(0, &raw mut out as *const u32).cast_mut());
            }
        }
    }
}

/// Makes a call that may change the scene.
fn change(slot: &mut Slot, call: &Call) -> rf_status {
    let handle = slot.handle;
    let list = |numbers: &[Number]| -> Box<[f32]> {
        numbers.iter().map(|number| number.value()).collect()
    };
    unsafe {
        match call {
            Call::Observe(given) => observe(slot, given, false),
            Call::ObservePoses(given) => observe(slot, given, true),
            Call::Command(numbers, mistake) => {
                let numbers = list(numbers);
                rf_set_command(handle, mistake.of(0, numbers.as_ptr()), numbers.len())
            }
            Call::Step(_, mistake) => {
                let report = MaybeUninit::<rf_step_report>::uninit();
                rf_step(handle, mistake.of(0, report.as_ptr()).cast_mut())
            }
            Call::Add(unit, mistake) => {
                let (points, pieces) = (unit.points(), unit.pieces());
                let piece_points: usize = pieces.iter().map(|count| usize::from(*count)).sum();
                let piece_points: Box<[[f32; 3]]> = (0..piece_points)
                    .map(|i| [(i % 3) as f32, (i % 5) as f32, (i % 7) as f32])
                    .collect();
                let given = rf_unit {
                    physics: unit.physics(),
                    role: unit.role(),
                    body: unit.body.into(),
                    points: mistake.of(0, points.as_ptr().cast()),
                    point_count: points.len(),
                    inertia_kg_m2: unit
                        .inertia
                        .map_or([0.0; 3], |moments| moments.map(Number::value)),
                    piece_points: mistake.of(1, piece_points.as_ptr().cast()),
                    piece_counts: mistake.of(2, pieces.as_ptr()),
                    piece_count: pieces.len(),
                };
                let [before, now] = [0, 1].map(|frame| unit.poses[frame].value());
                let mut id: rf_unit_id = 0;
                let id = mistake.of(6, &raw mut id as *const rf_unit_id).cast_mut();
                rf_add(
                    handle,
                    mistake.of(3, &given),
                    mistake.of(4, &before),
                    mistake.of(5, &now),
                    id,
                )
            }
            Call::Remove(unit) => rf_remove(handle, slot.id(*unit)),
            Call::Drive(unit, pose, mistake) => {
                rf_drive(handle, slot.id(*unit), mistake.of(0, &pose.value()))
            }
            Call::SetPoses(unit, [before, now], mistake) => {
                let (before, now) = (before.value(), now.value());
                rf_set_poses(handle, slot.id(*unit), mistake.of(0, &before), mistake.of(1, &now))
            }
            Call::SetPhysics(unit, row, usual, mistake) => {
                rf_set_physics(handle, slot.id(*unit), mistake.of(0, &physics(*row, *usual)))
            }
            Call::SetRole(unit, code) => rf_set_role(handle, slot.id(*unit), role(*code)),
            Call::SetPlanes(rows, is_ground, mistake) => {
                let planes: Box<[rf_plane]> = rows
                    .iter()
                    .map(|row| {
                        let [x, y, z, offset_m, friction, restitution] = row.map(Number::value);
                        let normal = if *is_ground { [0.0, 0.0, 1.0] } else { [x, y, z] };
                        rf_plane { normal, offset_m, friction, restitution }
                    })
                    .collect();
                rf_set_planes(handle, mistake.of(0, planes.as_ptr()), planes.len())
            }
            Call::SetGravity(row, mistake) => {
                let row: Box<[f32]> = list(row);
                rf_set_gravity(handle, mistake.of(0, row.as_ptr()))
            }
            Call::SetDt(seconds) => rf_set_dt(handle, seconds.value()),
            Call::Join(units, pivots, mistake) => {
                let [unit, parent] = units.map(|unit| slot.id(unit));
                let [pivot, parent_pivot] = pivots.map(|pivot| list(&pivot));
                rf_join(
                    handle,
                    unit,
                    parent,
                    mistake.of(0, pivot.as_ptr()),
                    mistake.of(1, parent_pivot.as_ptr()),
                )
            }
            Call::Unjoin(unit) => rf_unjoin(handle, slot.id(*unit)),
            Call::Bond(pairs, mistake) => {
                let pairs: Box<[rf_unit_id]> =
                    pairs.iter().flatten().map(|unit| slot.id(*unit)).collect();
                rf_bond(handle, mistake.of(0, pairs.as_ptr()), pairs.len() / 2)
            }
            Call::BreakBond([unit, other], mistake) => {
                let mut held = 0_u32;
                let held = mistake.of(0, &raw mut held as *const u32).cast_mut();
                rf_break_bond(handle, slot.id(*unit), slot.id(*other), held)
            }
            Call::Quarantine(holds) => rf_set_quarantine(handle, *holds),
            _ => rf_status::RF_OK,
        }
    }
}

/// Two bodies of five points, which a sound observation has; of one body, so that they can be bonded.
fn usual_scene(slot: &mut Slot, model: u8) {
    let mistake = Mistake { kind: 0, which: 0 };
    let sound = Call::Init { model, units: 5, points: 40, short: 0, cut: None, mistake };
    assert_eq!(init(slot, &sound), rf_status::RF_OK);
    let number = |value: f32| Number((value * 4096.0) as i16);
    let rows = [[0.0; 3], [0.1, 0.0, 0.0], [0.0, 0.1, 0.0], [0.0, 0.0, 0.1], [0.1, 0.1, 0.1]];
    let pose = Pose { numbers: [0, 0, 0, 0, 0, 0, 4096].map(Number), is_sound: true };
    let unit = |x: f32| FuzzUnit {
        physics: [Number(4096); 3],
        usual: true,
        points: rows.iter().map(|[a, b, c]| [a + x, *b, c + 0.1].map(number)).collect(),
        shift: [0, 0, -40].map(Number),
        role: 0,
        body: 0,
        poses: [pose.clone(), pose.clone()],
        inertia: None,
        pieces: Vec::new(),
        young: 0,
    };
    let given =
        Observation { units: vec![unit(0.0), unit(0.2)], dt: 10, with: 2, count: 0, mistake };
    assert_eq!(observe(slot, &given, false), rf_status::RF_OK);
    let nothing = [0.5_f32; 2];
    // SAFETY: as long as it says; refused by models without a command.
    unsafe { rf_set_command(slot.handle, nothing.as_ptr(), nothing.len()) };
}

#[derive(Arbitrary, Debug)]
struct Program {
    start: u8,
    calls: Vec<Call>,
}

/// Makes the calls that an input stands for.
pub fn run(data: &[u8]) {
    let Some(program) = structured::<Program>(data) else { return };
    let mut slots = [Slot::new(), Slot::new()];
    let mut now = 0;
    // Mostly something is there to be damaged.
    if program.start >= 64 {
        usual_scene(&mut slots[0], program.start);
    }
    let calls = program.calls;
    for call in calls.iter().take(48) {
        let [one, two] = &mut slots;
        let (slot, other) = if now == 0 { (one, two) } else { (two, one) };
        let (before, beside) = (slot.state(), other.state());
        match call {
            Call::Other => now = 1 - now,
            Call::Init { .. } => {
                if init(slot, call) != rf_status::RF_OK {
                    assert_eq!(slot.state(), before, "{call:?}");
                }
            }
            Call::Release => {
                let released = unsafe { rf_release(slot.handle) };
                if released == rf_status::RF_OK {
                    assert_eq!(slot.state(), None, "a handle that has ended");
                }
            }
            Call::Read { what, unit, capacity, mistake } => {
                read(slot, *what, *unit, *capacity, *mistake);
                assert_eq!(slot.state(), before, "{call:?}");
            }
            Call::Innovation(poses, variances, mistake) => unsafe {
                let [predicted, observed] = poses.each_ref().map(Pose::value);
                let variances: Box<[f32]> = variances.iter().map(|number| number.value()).collect();
                let mut distance = 0.0_f32;
                let out = mistake.of(3, &raw mut distance as *const f32).cast_mut();
                let (predicted, observed) = (mistake.of(0, &predicted), mistake.of(1, &observed));
                rf_innovation(predicted, observed, mistake.of(2, variances.as_ptr()), out);
            },
            Call::Text(code) => {
                let text: *const c_char = rf_error_string(*code);
                // SAFETY: a text that is never freed.
                assert!(!unsafe { CStr::from_ptr(text) }.is_empty());
            }
            Call::Step(count, _) => {
                for _ in 0..=count % 4 {
                    let before = slot.state();
                    if change(slot, call) != rf_status::RF_OK {
                        assert_eq!(slot.state(), before, "{call:?}");
                    }
                }
            }
            call => {
                if change(slot, call) != rf_status::RF_OK {
                    assert_eq!(slot.state(), before, "{call:?}");
                }
            }
        }
        let [one, two] = &mut slots;
        let other = if matches!(call, Call::Other) != (now == 0) { two } else { one };
        assert_eq!(other.state(), beside, "a call that another simulator noticed: {call:?}");
    }
}
