//! Nothing but a rollout, to be linked and weighed: load, observe, step, pose. No logger, no formatting.
//!
//! Its panic handler calls a function that does not exist. The image links because the optimiser proves that
//! nothing can panic, so that the handler goes away; `cargo xtask firmware` also looks for symbols of an allocator.
#![no_std]
#![no_main]

use core::hint::black_box;

use rigidformer_core::{Model, Observed, Posed, Simulator};
use rigidformer_weights::NANO;

#[path = "../bare.rs"]
mod bare;
#[path = "../memory.rs"]
mod memory;
use memory::{LIMITS, slabs};

#[cortex_m_rt::entry]
fn main() -> ! {
    let done = run();
    // A result that nobody uses would let the optimiser drop the whole rollout.
    black_box(done);
    loop {
        cortex_m::asm::wfi();
    }
}

fn run() -> Option<()> {
    let slabs = slabs()?;
    // A file that the optimiser knows would be checked at compile time, without the code for it.
    let model = Model::load(black_box(NANO)).ok()?;
    let mut simulator = Simulator::new(black_box(&model), black_box(LIMITS), slabs).ok()?;
    let known = bare::known();
    let (seen, known): (&[Observed<'_>], &[Posed<'_>]) =
        (black_box(&bare::SEEN), black_box(&known));
    black_box(simulator.observe(black_box(0.02), seen)).ok()?;
    black_box(simulator.observe_poses(black_box(0.02), known)).ok()?;
    black_box(simulator.set_command(black_box(&[]))).ok()?;
    loop {
        black_box(simulator.step()).ok()?;
        for unit in simulator.units() {
            black_box(unit.pose());
            black_box(unit.internal_pose());
            unit.points().for_each(|point| {
                black_box(point);
            });
        }
    }
}
