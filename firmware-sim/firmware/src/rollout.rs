//! The rollout that boards and this machine are compared by.

use defmt::Display2Format;
use rigidformer_core::{Model, Native, Simulator};

use crate::counter::Counter;
use crate::memory::{CONFIG, UNITS};
use crate::scene::Scene;
use crate::stages::{NAMES, Stages};

/// The simulator of these images.
pub type Board<'m> = Simulator<'m, 'static, UNITS, Native>;

/// Loads a model from flash, if it is one that the memory was made for.
pub fn load(file: &'static [u8]) -> Result<Model<'static>, &'static str> {
    match Model::load(file) {
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
    match board.observe(scene.step, &scene.physics, &scene.previous, &scene.current) {
        Ok(_) => Ok(()),
        Err(error) => {
            defmt::error!("observe: {}", Display2Format(&error));
            Err("the observation was refused")
        }
    }
}

/// FNV-1a with 64 bits over the poses of all steps, as `tests/src/bits.rs` has it.
struct Hash(u64);

impl Hash {
    fn add(&mut self, value: f32) {
        for byte in value.to_le_bytes() {
            self.0 = (self.0 ^ u64::from(byte)).wrapping_mul(0x0100_0000_01b3);
        }
    }
}

/// Rotation row by row, then the centre.
fn numbers(board: &Board<'_>, unit: usize) -> [f32; 12] {
    let mut all = [0.0; 12];
    if let Some(pose) = board.internal_pose(unit) {
        let rotation = pose.rotation.transpose();
        for (to, from) in all.iter_mut().zip(rotation.iter().chain(&pose.centre)) {
            *to = *from;
        }
    }
    all
}

/// Takes steps and reports poses as bits, and what the steps cost.
pub fn roll_out(
    board: &mut Board<'_>,
    name: &'static str,
    steps: u32,
    counter: Counter,
) -> Result<(), &'static str> {
    let mut stages = Stages::new(counter);
    let mut hash = Hash(0xcbf2_9ce4_8422_2325);
    let (mut active, mut least, mut most) = (0, u32::MAX, 0);
    for _ in 0..steps {
        stages.begin();
        let start = counter.now();
        let result = board.step_traced(&mut stages);
        let spent = counter.since(start);
        stages.end();
        (least, most) = (least.min(spent), most.max(spent));
        match result {
            Ok(report) => active += report.active_units,
            Err(error) => {
                defmt::error!("step: {}", Display2Format(&error));
                return Err("a step was refused");
            }
        }
        (0..board.len()).for_each(|unit| numbers(board, unit).iter().for_each(|v| hash.add(*v)));
    }
    for unit in 0..board.len() {
        let bits = numbers(board, unit).map(f32::to_bits);
        defmt::info!("{=str}: unit {=usize} {:08x}", name, unit, bits);
    }
    defmt::info!(
        "{=str}: {=u32} steps, active {=u32}, poses {=u64:016x}",
        name,
        steps,
        active,
        hash.0
    );
    for (stage, spent) in NAMES.iter().zip(stages.spent) {
        defmt::info!("measured {=str} {=str} {=u64}", name, stage, spent / u64::from(steps.max(1)));
    }
    let step = stages.spent.iter().sum::<u64>() / u64::from(steps.max(1));
    defmt::info!("measured {=str} step {=u64}", name, step);
    defmt::info!("measured {=str} least {=u32}", name, least);
    defmt::info!("measured {=str} most {=u32}", name, most);
    Ok(())
}
