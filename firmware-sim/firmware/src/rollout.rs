//! The rollout that boards and this machine are compared by.

use defmt::Display2Format;
use rigidformer_core::{Model, Observation, ObserveError, Simulator, UnitView};

use crate::counter::Counter;
use crate::memory::CONFIG;
use crate::scene::{Bodies, Scene};
use crate::stages::{NAMES, Stages};

/// The simulator of these images.
pub type Board<'m> = Simulator<'m, 'static>;

/// Loads a model from flash, if it is one that the memory was made for.
pub fn load(file: &'static [u8]) -> Result<Model<'static>, &'static str> {
    match Model::load(file) {
        // Slabs are as long as CONFIG asks, so another model might not fit.
        Ok(model) if *model.config() == CONFIG => Ok(model),
        Ok(_) => Err("the model in flash has another configuration than memory::CONFIG"),
        Err(error) => {
            defmt::error!("model: {}", Display2Format(&error));
            Err("the model in flash is damaged")
        }
    }
}

/// Observes a scene.
pub fn observe(board: &mut Board<'_>, scene: &Scene) -> Result<(), &'static str> {
    observed(board.observe(scene.seconds(), scene.units()))
}

/// Observes bodies in a scene, by its number.
pub fn observe_bodies(
    board: &mut Board<'_>,
    bodies: &Bodies,
    scene: usize,
) -> Result<(), &'static str> {
    let units = bodies.units(scene).ok_or("there is no such scene")?;
    observed(board.observe_poses(bodies.seconds(), units))
}

fn observed(observation: Result<Observation, ObserveError>) -> Result<(), &'static str> {
    match observation {
        Ok(_) => Ok(()),
        Err(error) => {
            defmt::error!("observe: {}", Display2Format(&error));
            Err("the observation was refused")
        }
    }
}

/// FNV-1a with 64 bits, as `tests/src/bits.rs` has it.
pub struct Hash(u64);

impl Default for Hash {
    fn default() -> Self {
        Hash(0xcbf2_9ce4_8422_2325)
    }
}

impl Hash {
    /// What all numbers came to.
    pub fn value(&self) -> u64 {
        self.0
    }

    /// The four bytes of a number, least significant first.
    pub fn add(&mut self, value: f32) {
        value.to_le_bytes().iter().for_each(|byte| self.add_byte(*byte));
    }

    /// A byte.
    pub fn add_byte(&mut self, byte: u8) {
        self.0 = (self.0 ^ u64::from(byte)).wrapping_mul(0x0100_0000_01b3);
    }
}

/// Rotation row by row, then the centre.
fn numbers(unit: UnitView<'_>) -> [f32; 12] {
    let mut all = [0.0; 12];
    let pose = unit.internal_pose();
    // nalgebra keeps columns together, and reports have rows.
    let rotation = pose.rotation.transpose();
    for (to, from) in all.iter_mut().zip(rotation.iter().chain(&pose.centre)) {
        *to = *from;
    }
    all
}

/// What a step cost, over a rollout.
#[derive(Clone, Copy, Debug)]
pub struct Cost {
    steps: u32,
    stages: Stages,
    least: u32,
    most: u32,
}

impl Cost {
    /// Reports instructions a step.
    pub fn report(&self, name: &'static str) {
        let per_step = |spent: u64| spent / u64::from(self.steps.max(1));
        for (stage, spent) in NAMES.iter().zip(self.stages.spent) {
            defmt::info!("measured {=str} {=str} {=u64}", name, stage, per_step(spent));
        }
        let step = per_step(self.stages.spent.iter().sum());
        defmt::info!("measured {=str} step {=u64}", name, step);
        defmt::info!("measured {=str} least {=u32}", name, self.least);
        defmt::info!("measured {=str} most {=u32}", name, self.most);
    }
}

/// Steps that are counted and hashed.
pub struct Rollout {
    counter: Counter,
    cost: Cost,
    hash: Hash,
    active: u32,
}

impl Rollout {
    /// Before the first step.
    pub fn new(counter: Counter) -> Rollout {
        let cost = Cost { steps: 0, stages: Stages::new(counter), least: u32::MAX, most: 0 };
        Rollout { counter, cost, hash: Hash::default(), active: 0 }
    }

    /// Takes a step.
    pub fn step(&mut self, board: &mut Board<'_>) -> Result<(), &'static str> {
        let cost = &mut self.cost;
        cost.stages.begin();
        let start = self.counter.now();
        let result = board.step_traced(&mut cost.stages);
        let spent = self.counter.since(start);
        cost.stages.end();
        // Real time asks for the longest step, not for the mean.
        (cost.least, cost.most) = (cost.least.min(spent), cost.most.max(spent));
        cost.steps += 1;
        match result {
            Ok(report) => self.active += report.active_units,
            Err(error) => {
                defmt::error!("step: {}", Display2Format(&error));
                return Err("a step was refused");
            }
        }
        for unit in board.units() {
            numbers(unit).iter().for_each(|value| self.hash.add(*value));
            // Rigid units have no points of their own, and the other images save the code.
            #[cfg(feature = "drape")]
            for (_, point) in unit.soft_points() {
                point.iter().for_each(|value| self.hash.add(*value));
            }
        }
        Ok(())
    }

    /// Reports poses as bits, and the hash.
    pub fn end(self, board: &Board<'_>, name: &'static str) -> Cost {
        for (number, unit) in board.units().enumerate() {
            let bits = numbers(unit).map(f32::to_bits);
            defmt::info!("{=str}: unit {=usize} {:08x}", name, number, bits);
        }
        defmt::info!(
            "{=str}: {=u32} steps, active {=u32}, poses {=u64:016x}",
            name,
            self.cost.steps,
            self.active,
            self.hash.0
        );
        self.cost
    }
}

/// Takes steps and reports poses as bits.
pub fn roll_out(
    board: &mut Board<'_>,
    name: &'static str,
    steps: u32,
    counter: Counter,
) -> Result<Cost, &'static str> {
    let mut rollout = Rollout::new(counter);
    for _ in 0..steps {
        rollout.step(board)?;
    }
    Ok(rollout.end(board, name))
}
