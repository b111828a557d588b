//! Bytes that may be a snapshot, for `Simulator`, `World` and C: all three say the same of them. What is refused leaves the scene; what is
//! taken is written and taken again, and steps to the same bits on the portable kernels and on the host's.
#![allow(unsafe_code)]

use crate::structured::structured;
use crate::{observe_step, soft_step};
use arbitrary::Arbitrary;
use rigidformer_capi::ffi::{rf_init, rf_release, rf_step, rf_workspace_bytes};
use rigidformer_capi::state::{rf_load, rf_save, rf_state_bytes};
use rigidformer_capi::types::{RF_ABI_VERSION, rf_config, rf_simulator, rf_status};
use rigidformer_core::{Limits, Simulator, SlabSizes, UnitId};
use rigidformer_runtime::engine::Engine;
use rigidformer_runtime::kernels::Kernel;
use rigidformer_runtime::models::LoadedModel;
use rigidformer_runtime::threads::Threads;
use rigidformer_runtime::world::{Snapshot, World};
use rigidformer_tests::Room;
use rigidformer_weights::AlignedBuffer;
use std::mem::MaybeUninit;
use std::ptr::{null_mut, without_provenance_mut};
use std::sync::LazyLock;

const LIMITS: Limits = Limits { units: 4, points: 36 };
const STEPS: usize = 3;

/// The host's fastest kernels.
static ENGINE: LazyLock<Engine> = LazyLock::new(|| {
    let kernel = Kernel::available().pop().expect("the portable kernels");
    Engine { kernel, threads: Threads::ONE }
});

/// A model, and the same one loaded.
type Loaded = (&'static AlignedBuffer, LoadedModel);

fn loaded(models: &'static [AlignedBuffer]) -> Vec<Loaded> {
    let copy = |model| LoadedModel::copy_of("fuzzed", model).expect("sound");
    models.iter().map(|model| (model, copy(model))).collect()
}

static RIGID: LazyLock<Vec<Loaded>> = LazyLock::new(|| loaded(&observe_step::MODELS));
static SOFT: LazyLock<Vec<Loaded>> = LazyLock::new(|| loaded(&soft_step::MODELS));

#[derive(Arbitrary, Debug)]
enum Calls {
    Rigid(u8, Vec<observe_step::Call>),
    Soft(u8, Vec<soft_step::Call>),
}

impl Calls {
    fn model(&self) -> &'static Loaded {
        match self {
            Calls::Rigid(which, _) => &RIGID[usize::from(*which) % RIGID.len()],
            Calls::Soft(which, _) => &SOFT[usize::from(*which) % SOFT.len()],
        }
    }

    /// Makes the calls.
    fn make(&self, simulator: &mut Simulator<'_, '_>) {
        let mut known: Vec<UnitId> = Vec::new();
        let mut make = |call: &dyn Fn(&mut Simulator<'_, '_>, &[UnitId]) -> bool| {
            known.extend(simulator.units().map(|unit| unit.id()));
            call(simulator, &known);
        };
        match self {
            Calls::Rigid(_, calls) => calls.iter().take(6).for_each(|next| {
                make(&|simulator, known| observe_step::call(simulator, known, next))
            }),
            Calls::Soft(_, calls) => calls
                .iter()
                .take(4)
                .for_each(|next| make(&|simulator, known| soft_step::call(simulator, known, next))),
        }
    }
}

/// A change of a snapshot, at a word.
#[derive(Arbitrary, Debug)]
enum Change {
    Set(u16, u32),
    /// The same from another word.
    Copy(u16, u16),
    Flip(u16, u8),
    Add(u16, i8),
    /// A number that is of a scene's size, or should not be one.
    Number(u16, u8),
    Insert(u16, u32),
    Remove(u16, u8),
    Cut(u16),
}

/// Numbers at the ends of what is allowed.
const NUMBERS: [f32; 16] = [
    f32::NAN,
    f32::INFINITY,
    f32::NEG_INFINITY,
    f32::MAX,
    f32::MIN_POSITIVE,
    1e-42,
    0.0,
    -0.0,
    1.0,
    -1.0,
    1e6,
    1.000_001e6,
    -1e9,
    1e12,
    1e-12,
    0.5,
];

impl Change {
    fn apply(&self, words: &mut Vec<u32>) {
        let length = words.len().max(1);
        let at = |place: &u16| usize::from(*place) % length;
        let word = |place: &u16| words.get(at(place)).copied().unwrap_or_default();
        let (place, value) = match self {
            Change::Set(place, value) => (place, *value),
            Change::Copy(place, from) => (place, word(from)),
            Change::Flip(place, bit) => (place, word(place) ^ 1 << (bit % 32)),
            Change::Add(place, more) => (place, word(place).wrapping_add_signed((*more).into())),
            Change::Number(place, which) => {
                (place, NUMBERS[usize::from(*which) % NUMBERS.len()].to_bits())
            }
            Change::Insert(place, value) => {
                return words.insert(at(place).min(words.len()), *value);
            }
            Change::Remove(place, count) => {
                let from = at(place).min(words.len());
                let to = (from + usize::from(*count)).min(words.len());
                return drop(words.drain(from..to));
            }
            Change::Cut(place) => return words.truncate(at(place)),
        };
        let place = at(place);
        if let Some(slot) = words.get_mut(place) {
            *slot = value;
        }
    }
}

#[derive(Arbitrary, Debug)]
struct Input {
    /// What the scene was when it was written.
    before: Calls,
    changes: Vec<Change>,
    /// Whether the checksum is one of a hostile writer, which fits.
    sealed: bool,
    /// What the simulator holds that restores it: nothing, or that scene some steps later.
    later: Option<u8>,
    /// Whether it is offered to one copy of two.
    copy: Option<bool>,
    /// The bytes instead of a snapshot and its changes.
    bytes: Option<Vec<u8>>,
}

/// The checksum that fits: FNV-1a over the words before it.
fn seal(words: &mut [u32]) {
    let Some((body, end)) = words.split_last_chunk_mut::<2>() else { return };
    let add = |hash: u64, word: &u32| (hash ^ u64::from(*word)).wrapping_mul(0x0100_0000_01b3);
    let hash = body.iter().fold(0xcbf2_9ce4_8422_2325, add);
    *end = [hash as u32, (hash >> 32) as u32];
}

fn words(bytes: &[u8]) -> Vec<u32> {
    bytes.as_chunks().0.iter().map(|word| u32::from_le_bytes(*word)).collect()
}

fn taken(simulator: &Simulator<'_, '_>) -> Vec<u8> {
    let mut bytes = vec![0; simulator.snapshot_bytes()];
    assert_eq!(simulator.snapshot(&mut bytes), Ok(bytes.len()));
    bytes
}

/// The bytes that are restored.
fn offered(input: &Input, snapshot: &[u8]) -> Vec<u8> {
    if let Some(bytes) = &input.bytes {
        return bytes.clone();
    }
    let mut words = words(snapshot);
    seal(&mut words);
    assert!(
        words == self::words(snapshot),
        "this target makes another checksum than snapshots have"
    );
    input.changes.iter().take(8).for_each(|change| change.apply(&mut words));
    if input.sealed {
        seal(&mut words);
    }
    words.into_iter().flat_map(u32::to_le_bytes).collect()
}

/// A simulator of C in memory of its own.
struct InC {
    handle: *mut rf_simulator,
    /// What the handle points into.
    #[expect(dead_code, reason = "kept for the handle")]
    memory: Vec<MaybeUninit<u128>>,
}

impl InC {
    fn new(model: &[u8]) -> Self {
        let config = rf_config {
            abi_version: RF_ABI_VERSION,
            max_units: LIMITS.units as u32,
            max_points: LIMITS.points as u32,
            threads: 0,
            model: model.as_ptr(),
            model_bytes: model.len(),
        };
        let (mut bytes, mut handle) = (0, null_mut());
        // SAFETY: here and below, pointers are to what their lengths say; the model stays.
        unsafe {
            assert_eq!(rf_workspace_bytes(&config, &mut bytes), rf_status::RF_OK);
            let mut memory = vec![MaybeUninit::uninit(); bytes.div_ceil(16)];
            let room = memory.as_mut_ptr().cast();
            let begun = rf_init(&config, room, bytes, &mut handle, null_mut());
            assert_eq!(begun, rf_status::RF_OK);
            InC { handle, memory }
        }
    }

    fn load(&mut self, bytes: &[u8]) -> bool {
        // No slice of nothing has a pointer that C could have.
        let none = without_provenance_mut::<u8>(1).cast_const();
        let pointer = if bytes.is_empty() { none } else { bytes.as_ptr() };
        unsafe { rf_load(self.handle, pointer, bytes.len()) == rf_status::RF_OK }
    }

    fn taken(&self) -> Vec<u8> {
        let (mut length, mut written) = (0, 0);
        unsafe {
            assert_eq!(rf_state_bytes(self.handle, &mut length), rf_status::RF_OK);
            let mut bytes = vec![0; length];
            let saved = rf_save(self.handle, bytes.as_mut_ptr(), length, &mut written);
            assert_eq!((saved, written), (rf_status::RF_OK, length));
            bytes
        }
    }

    fn step(&mut self) -> bool {
        unsafe { rf_step(self.handle, null_mut()) == rf_status::RF_OK }
    }
}

impl Drop for InC {
    fn drop(&mut self) {
        unsafe { rf_release(self.handle) };
    }
}

/// Offers the bytes to one of two copies, and steps.
fn offer_to_a_copy(model: &LoadedModel, whole: Vec<u8>, copy: usize, bytes: Vec<u8>) {
    let mut world = World::on(*ENGINE, model, LIMITS, 2).expect("memory");
    if world.restore(&Snapshot::from_bytes(whole)).is_err() {
        return;
    }
    world.edit(|simulator| simulator.replicate(2));
    let before = world.snapshot();
    if world.restore_copy(copy, &Snapshot::from_bytes(bytes)).is_err() {
        assert_eq!(world.snapshot(), before, "a refused snapshot changed a copy");
        return;
    }
    let after = world.snapshot();
    world.restore(&after).expect("its own snapshot");
    assert_eq!(world.snapshot(), after);
    let _ = world.step();
}

/// Handles an input.
pub fn run(data: &[u8]) {
    let Some(input) = structured::<Input>(data) else { return };
    let (file, model) = input.before.model();
    let mut room = Room::new(SlabSizes::new(model.model().config(), LIMITS));
    let mut simulator = Simulator::new(model.model(), LIMITS, room.slabs()).expect("slabs");
    input.before.make(&mut simulator);
    let written = taken(&simulator);
    let bytes = offered(&input, &written);
    if let Some(copy) = input.copy {
        return offer_to_a_copy(model, written, copy.into(), bytes);
    }
    match input.later {
        Some(steps) => (0..steps % 4).for_each(|_| {
            let _ = simulator.step();
        }),
        None => {
            room = Room::new(SlabSizes::new(model.model().config(), LIMITS));
            simulator = Simulator::new(model.model(), LIMITS, room.slabs()).expect("slabs");
        }
    }
    let before = taken(&simulator);
    let mut world = World::on(*ENGINE, model, LIMITS, 1).expect("memory");
    let mut c = InC::new(file);
    world.restore(&Snapshot::from_bytes(before.clone())).expect("a simulator's own snapshot");
    assert!(c.load(&before), "a simulator's own snapshot");
    let is_taken = simulator.restore(&bytes);
    let by_world = world.restore(&Snapshot::from_bytes(bytes.clone()));
    assert_eq!(by_world, is_taken, "a world says otherwise");
    assert_eq!(c.load(&bytes), is_taken.is_ok(), "C says otherwise than {is_taken:?}");
    let same = |simulator: &Simulator<'_, '_>, world: &World, c: &InC| {
        let now = taken(simulator);
        assert!(world.snapshot().as_bytes() == now, "the host's kernels have other bits");
        assert!(c.taken() == now, "C has other bits");
        now
    };
    let mut now = same(&simulator, &world, &c);
    if is_taken.is_err() {
        assert!(now == before, "a refused snapshot changed the scene");
        return;
    }
    simulator.restore(&now).expect("its own snapshot");
    assert!(taken(&simulator) == now, "what was taken is written as something else");
    for _ in 0..STEPS {
        let stepped = simulator.step();
        assert_eq!(world.step().is_ok(), stepped.is_ok(), "a world says otherwise");
        assert_eq!(c.step(), stepped.is_ok(), "C says otherwise");
        let after = same(&simulator, &world, &c);
        assert!(stepped.is_ok() || after == now, "a step that failed changed the scene");
        now = after;
    }
}
