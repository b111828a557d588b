//! Soft units, bonds and joints, to be linked and weighed: `runtime_whole` with everything that deforms, holds together or breaks.
//! Needs the feature `deform`.
//!
//! Its panic handler calls a function that does not exist, as that of `runtime_only`.
#![no_std]
#![no_main]

use core::hint::black_box;

use nalgebra::{Isometry3, Point3};
use rigidformer_core::{Joint, Model, Observed, Posed, Role, Simulator, UnitId};
use rigidformer_weights::SHELL;

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
    let model = Model::load(black_box(SHELL)).ok()?;
    let mut simulator = Simulator::new(black_box(&model), black_box(LIMITS), slabs).ok()?;
    let (patches, known) = (bare::patches(), bare::known());
    let (seen, known): (&[Observed<'_>], &[Posed<'_>]) = (black_box(&patches), black_box(&known));
    black_box(simulator.observe(black_box(0.02), seen)).ok()?;
    loop {
        change(&mut simulator, known);
        black_box(simulator.step()).ok()?;
        look(&simulator);
    }
}

/// Every change of what deforms and of what holds together. What it returns is the caller's: a refusal here is no reason to stop.
fn change(simulator: &mut Simulator<'_, '_>, known: &[Posed<'_>]) {
    let pose = black_box(Isometry3::identity());
    let _ = black_box(simulator.observe_poses(black_box(0.02), known));
    for Posed { unit, previous, current } in known {
        let _ = black_box(simulator.add(unit, previous, current));
    }
    let [id, other] = black_box([UnitId::from_bits(1), UnitId::from_bits(2)]);
    let pairs = [[id, other]];
    let pairs: &[[UnitId; 2]] = black_box(&pairs);
    let _ = black_box(simulator.bond(pairs));
    let _ = black_box(simulator.break_bond(black_box([id, other])));
    let pivot = black_box(Point3::origin());
    let joint = Joint::ball(id, other, pivot, pivot);
    let _ = black_box(simulator.join(black_box(&joint)));
    let _ = black_box(simulator.unjoin(id));
    let _ = black_box(simulator.set_role(id, black_box(Role::Driven)));
    let _ = black_box(simulator.set_poses(id, &pose, &pose));
    let _ = black_box(simulator.set_dt(black_box(0.01)));
    let _ = black_box(simulator.remove(black_box(id)));
}

/// Every look.
fn look(simulator: &Simulator<'_, '_>) {
    for unit in simulator.units() {
        black_box((unit.id(), unit.pose(), unit.body(), unit.is_soft()));
        unit.soft_points().for_each(|place| {
            black_box(place);
        });
    }
    simulator.bonds().for_each(|bond| {
        black_box(bond);
    });
    simulator.joints().for_each(|joint| {
        black_box(joint);
    });
}
