//! Long rollouts as hashes, so that builds and processors can be compared bit for bit.
//!
//! `docs/BITS.md` tells how the equality is kept and how `tests/data/bits.txt` is regenerated.

use crate::{Golden, Inputs, Room, Seen, data, packed_model};
use rigidformer_core::{
    Compliance, Limits, Model, Simulator, SlabSizes, StepError, StepReport, UnitView,
};
use rigidformer_evaluation::models::{Precision, quantise};
use rigidformer_runtime::engine::Engine;
use rigidformer_runtime::models::LoadedModel;
use rigidformer_runtime::world::World;
use rigidformer_weights::AlignedBuffer;
use std::fmt;
use std::path::Path;

/// Steps of every rollout.
// Errors of one bit grow from step to step, and a hundred make them show.
pub const STEPS: usize = 100;

/// Steps between two snapshots.
pub const HANDED_ON: usize = 25;

/// Units of the edge model's scene that take part.
// Emulated processors take a minute for four units of this model.
const EDGE_UNITS: [usize; 4] = [0, 1, 2, 3];

/// FNV-1a with 64 bits: each byte is xored in, then the hash is multiplied by the prime.
#[derive(Clone, Copy, Debug)]
pub struct Fnv1a(pub u64);

impl Default for Fnv1a {
    fn default() -> Self {
        Fnv1a(0xcbf2_9ce4_8422_2325)
    }
}

impl Fnv1a {
    /// The four bytes of a number, least significant first.
    pub fn add(&mut self, value: f32) {
        value.to_bits().to_le_bytes().iter().for_each(|byte| self.add_byte(*byte));
    }

    /// A byte.
    pub fn add_byte(&mut self, byte: u8) {
        self.0 = (self.0 ^ u64::from(byte)).wrapping_mul(0x0100_0000_01b3);
    }

    /// A unit's internal pose: rotation row by row, then the centre. Then its points, where it is soft.
    pub fn add_unit(&mut self, unit: &UnitView<'_>) {
        let pose = unit.internal_pose();
        // `transpose` because nalgebra keeps columns together.
        pose.rotation.transpose().iter().chain(&pose.centre).for_each(|v| self.add(*v));
        for (_, point) in unit.soft_points() {
            point.iter().for_each(|v| self.add(*v));
        }
    }
}

/// What a rollout came to: a line of `bits.txt`.
#[derive(Clone, Debug, PartialEq)]
pub struct Outcome {
    /// Name of the model, such as `tiny-i8`.
    pub name: String,
    /// Checksum of the packed tensors: where this differs, packing does.
    pub payload: u32,
    /// Hash of every step's internal poses: rotation row by row, then centre, unit by unit, and points of soft units.
    pub poses: u64,
    /// Hash of the bytes of all snapshots on the way.
    pub snapshots: u64,
    /// Steps that succeeded.
    pub steps: usize,
    /// Predictions of the network that took effect: units near something, over all steps.
    pub active: u32,
}

impl fmt::Display for Outcome {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Outcome { name, payload, poses, snapshots, steps, active } = self;
        write!(
            f,
            "{name} model {payload:08x} poses {poses:016x} snapshots {snapshots:016x} steps {steps} active {active}"
        )
    }
}

/// The models that are compared, by name, packed and quantised here and now.
pub fn models() -> Vec<(String, AlignedBuffer)> {
    let sources = [
        ("tiny", packed_model("tiny")),
        ("tiny-paper-inputs", packed_model("tiny-paper-inputs")),
        ("tiny-carried", packed_model("tiny-carried")),
        ("tiny-breaking", packed_model("tiny-breaking")),
        (SOFT, packed_model(SOFT)),
        ("edge", AlignedBuffer::copy_of(rigidformer_weights::EDGE)),
    ];
    let mut models = Vec::new();
    for (name, packed) in &sources {
        for (suffix, precision) in PRECISIONS {
            models.push((format!("{name}-{suffix}"), quantised(packed, precision)));
        }
    }
    // Contact is the same for each kind of storage.
    let edge = AlignedBuffer::copy_of(rigidformer_weights::EDGE);
    models.push((format!("edge{GIVING}-i8"), quantised(&edge, Precision::I8)));
    models
}

/// What follows the name of a scene whose contact gives way.
pub const GIVING: &str = "-giving";

/// The model of soft bodies, whose scene is a file of scenes.
pub const SOFT: &str = "tiny-soft";

/// What a rollout begins with.
enum Start {
    Rigid(Golden, Inputs),
    /// As `Rigid`, with contact that gives way.
    Giving(Golden, Inputs),
    Soft(Box<Seen>),
}

impl Start {
    /// That of a model such as `tiny-i8`.
    fn of(name: &str) -> Self {
        let (full, _) = name.rsplit_once('-').expect("a name such as tiny-i8");
        let scene = full.strip_suffix(GIVING).unwrap_or(full);
        if scene == SOFT {
            return Start::Soft(Box::new(Seen::golden()));
        }
        let golden = Golden::read(scene);
        let mut inputs = golden.inputs();
        if scene == "edge" {
            // An emulator needs a minute for four units of this model.
            inputs = inputs.permuted(&EDGE_UNITS);
        }
        if scene == full { Start::Rigid(golden, inputs) } else { Start::Giving(golden, inputs) }
    }

    /// Units, and points of all of them.
    fn room(&self) -> (usize, usize) {
        match self {
            Start::Rigid(_, inputs) | Start::Giving(_, inputs) => {
                (inputs.points.len(), inputs.points.iter().map(Vec::len).sum())
            }
            Start::Soft(seen) => (seen.scene.units().len(), seen.scene.points()),
        }
    }

    fn observe(&self, simulator: &mut Simulator<'_, '_>) {
        match self {
            Start::Rigid(golden, inputs) | Start::Giving(golden, inputs) => {
                if let Some(command) = golden.command() {
                    simulator.set_command(&command).expect("command");
                }
                let mut posed = inputs.posed();
                if golden.has("bonds") {
                    for (posed, body) in posed.iter_mut().zip(golden.integers("body")) {
                        posed.unit.body = u16::try_from(body).ok();
                    }
                }
                simulator.observe_poses(golden.dt_s(), posed).expect("observation");
                golden.bond(simulator);
                if matches!(self, Start::Giving(..)) {
                    give_way(simulator);
                }
            }
            Start::Soft(seen) => seen.observe(simulator).expect("observation"),
        }
    }
}

/// Makes contact with all units and planes give way.
fn give_way(simulator: &mut Simulator<'_, '_>) {
    let compliance = |unit: usize| Compliance {
        stiffness_n_m: 2e4 * (unit + 1) as f32,
        dissipation_s_m: 0.5 * unit as f32,
    };
    let ids: Vec<_> = simulator.units().map(|unit| unit.id()).collect();
    for (number, id) in ids.into_iter().enumerate() {
        simulator.set_compliance(id, compliance(number)).expect("compliance");
    }
    for plane in 0..simulator.planes().len() {
        simulator.set_plane_compliance(plane, compliance(plane + 9)).expect("compliance");
    }
}

/// Every kind of storage.
// Each storage has kernels of its own, whose bits are compared.
pub const PRECISIONS: [(&str, Precision); 3] =
    [("f32", Precision::F32), ("f16", Precision::F16), ("i8", Precision::I8)];

/// A packed f32 model in another storage.
pub fn quantised(packed: &[u8], precision: Precision) -> AlignedBuffer {
    let file = quantise(Path::new("memory"), packed, &precision.into()).expect("quantises").file;
    AlignedBuffer::copy_of(&file)
}

/// Rolls the scene of a model out, `STEPS` steps from the golden file's two frames. The scene of
/// `tiny-i8` is `tiny.golden.safetensors`. A step that fails ends the rollout and counts. Every [`HANDED_ON`] steps another
/// simulator goes on from a snapshot, which changes no bit.
pub fn rollout(name: &str, file: &[u8]) -> Outcome {
    rollout_within(name, file, 16, 0)
}

/// As [`rollout`], in a simulator with room for so many units and `spare` more points than needed.
pub fn rollout_within(name: &str, file: &[u8], units: usize, spare: usize) -> Outcome {
    let start = Start::of(name);
    let model = Model::load(file).expect("model loads");
    let limits = Limits { units, points: start.room().1 + spare };
    let mut rooms: Vec<_> = (0..=STEPS / HANDED_ON)
        .map(|_| Room::new(SlabSizes::new(model.config(), limits)))
        .collect();
    let mut simulators = rooms
        .iter_mut()
        .map(|room| Simulator::new(&model, limits, room.slabs()).expect("simulator"));
    let mut simulator = simulators.next().expect("a simulator");
    start.observe(&mut simulator);
    let (mut hash, mut snapshots) = (Fnv1a::default(), Fnv1a::default());
    let (mut steps, mut active) = (0, 0);
    while steps < STEPS {
        if steps % HANDED_ON == HANDED_ON / 2 {
            let mut bytes = vec![0; simulator.snapshot_bytes()];
            simulator.snapshot(&mut bytes).expect("a snapshot");
            simulator = simulators.next().expect("a simulator");
            simulator.restore(&bytes).expect("its own snapshot");
            bytes.iter().for_each(|byte| snapshots.add_byte(*byte));
        }
        // A model of random weights may diverge, and must do so at the same step everywhere.
        let Ok(report) = simulator.step() else { break };
        // Rollouts in which nothing touches would compare free fall alone, and this count shows it.
        (steps, active) = (steps + 1, active + report.active_units);
        simulator.units().for_each(|unit| hash.add_unit(&unit));
    }
    Outcome {
        name: name.into(),
        payload: model.file().payload_crc(),
        poses: hash.0,
        snapshots: snapshots.0,
        steps,
        active,
    }
}

/// The outcome of each of so many copies of the scene that [`rollout`] rolls out, on an engine of
/// the runtime, with int8 matrices in panels.
pub fn rollout_on(engine: Engine, copies: usize, name: &str, file: &[u8]) -> Vec<Outcome> {
    let start = Start::of(name);
    let loaded = LoadedModel::copy_of(name, file).expect("model loads");
    let payload = loaded.model().file().payload_crc();
    // Hosts multiply panels, and a panel must give the bits of a row.
    let loaded = loaded.for_host().expect("panels");
    let (units, points) = start.room();
    let limits = Limits { units, points };
    let mut world = World::on(engine, &loaded, limits, copies).expect("world");
    world.edit(|simulator| {
        start.observe(simulator);
        assert_eq!(simulator.replicate(copies), copies);
    });
    let outcome =
        Outcome { name: name.into(), payload, poses: 0, snapshots: 0, steps: 0, active: 0 };
    let mut outcomes = vec![(outcome, Fnv1a::default(), Fnv1a::default()); copies];
    engine.enter(|| {
        for step in 0..STEPS {
            if step % HANDED_ON == HANDED_ON / 2 {
                let simulator = world.simulator();
                for (copy, (_, _, hash)) in outcomes.iter_mut().enumerate() {
                    let mut bytes = vec![0; simulator.copy_snapshot_bytes()];
                    simulator.snapshot_copy(copy, &mut bytes).expect("a snapshot");
                    bytes.iter().for_each(|byte| hash.add_byte(*byte));
                }
            }
            let mut note = |copy: usize, report: Result<StepReport, StepError>| {
                let outcome: &mut Outcome = &mut outcomes[copy].0;
                let report = report.expect("a step");
                (outcome.steps, outcome.active) =
                    (outcome.steps + 1, outcome.active + report.active_units);
            };
            world.step_copies(&mut note).expect("steps");
            let simulator = world.simulator();
            for (copy, (_, hash, _)) in outcomes.iter_mut().enumerate() {
                let units = copy * simulator.len()..(copy + 1) * simulator.len();
                units.filter_map(|unit| simulator.unit(unit)).for_each(|unit| hash.add_unit(&unit));
            }
        }
    });
    let finished = |(outcome, poses, snapshots): (Outcome, Fnv1a, Fnv1a)| Outcome {
        poses: poses.0,
        snapshots: snapshots.0,
        ..outcome
    };
    outcomes.into_iter().map(finished).collect()
}

/// The committed lines, without comments.
pub fn golden() -> Vec<String> {
    let text = std::fs::read_to_string(data("bits.txt")).expect("tests/data/bits.txt");
    text.lines().filter(|line| !line.starts_with('#')).map(str::to_owned).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Test vectors of the hash's authors: the empty text, and four zero bytes.
    #[test]
    fn the_hash_is_fnv_1a() {
        assert_eq!(Fnv1a::default().0, 0xcbf2_9ce4_8422_2325);
        let mut hash = Fnv1a::default();
        hash.add(f32::from_bits(u32::from_le_bytes(*b"foob")));
        hash.0 = (hash.0 ^ u64::from(b'a')).wrapping_mul(0x0100_0000_01b3);
        hash.0 = (hash.0 ^ u64::from(b'r')).wrapping_mul(0x0100_0000_01b3);
        assert_eq!(hash.0, 0x8594_4171_f739_67e8, "foobar");
    }
}
