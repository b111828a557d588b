//! Nothing but the runtime, to be linked and weighed: load, observe, step, pose. No logger, no formatting.
//!
//! Its panic handler calls a function that does not exist. The image links because the optimiser proves that
//! nothing can panic, so that the handler goes away; `cargo xtask firmware` also looks for symbols of an allocator.
#![no_std]
#![no_main]

use core::hint::black_box;
use core::panic::PanicInfo;

use nalgebra::{Isometry3, Point3};
use rigidformer_core::{Model, Native, Physics, Simulator, Unit};
use rigidformer_weights::NANO;

#[path = "../memory.rs"]
mod memory;
use memory::{LIMITS, UNITS, slabs};

unsafe extern "C" {
    fn the_runtime_must_not_be_able_to_panic() -> !;
}

#[panic_handler]
fn panic(_: &PanicInfo<'_>) -> ! {
    // SAFETY: does not exist, so whatever links cannot come here.
    unsafe { the_runtime_must_not_be_able_to_panic() }
}

/// What a program of this size would be given from outside; the optimiser must not know it.
static PHYSICS: [Physics; UNITS] =
    [Physics { mass_kg: 1.0, friction: 0.5, restitution: 0.5 }; UNITS];
static POINTS: [Point3<f32>; 64] = [Point3::new(0.0, 0.0, 0.0); 64];

#[cortex_m_rt::entry]
fn main() -> ! {
    let done = run();
    black_box(done);
    loop {
        cortex_m::asm::wfi();
    }
}

fn run() -> Option<()> {
    let slabs = slabs()?;
    let model = Model::load(black_box(NANO)).ok()?;
    let mut simulator: Simulator<'_, '_, UNITS, Native> =
        Simulator::new(black_box(&model), black_box(LIMITS), slabs).ok()?;
    let physics: &[Physics] = black_box(&PHYSICS);
    let points: &[Point3<f32>] = black_box(&POINTS);
    let frame = [points; UNITS];
    let frame: &[&[Point3<f32>]] = black_box(&frame);
    black_box(simulator.observe(black_box(5), physics, frame, frame)).ok()?;
    let units = [Unit { points, physics: *physics.first()? }; UNITS];
    let poses = [Isometry3::identity(); UNITS];
    let (units, poses): (&[Unit<'_>], &[Isometry3<f32>]) = (black_box(&units), black_box(&poses));
    black_box(simulator.observe_poses(black_box(5), units, poses, poses)).ok()?;
    black_box(simulator.set_command(black_box(&[]))).ok()?;
    loop {
        black_box(simulator.step()).ok()?;
        for unit in 0..simulator.len() {
            black_box(simulator.pose(unit));
            black_box(simulator.internal_pose(unit));
            simulator.points(unit).for_each(|point| {
                black_box(point);
            });
        }
    }
}
