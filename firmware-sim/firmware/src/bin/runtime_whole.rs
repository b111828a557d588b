//! All that a simulator on one thread offers, to be linked and weighed: `runtime_only`, and every change of the scene.
//!
//! Its panic handler calls a function that does not exist, as that of `runtime_only`.
#![no_std]
#![no_main]

use core::hint::black_box;

use nalgebra::{Isometry3, Vector3};
use rigidformer_core::{Model, Observed, Physics, Plane, Posed, Role, Simulator, UnitId};
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
    let model = Model::load(black_box(NANO)).ok()?;
    let mut simulator = Simulator::new(black_box(&model), black_box(LIMITS), slabs).ok()?;
    let known = bare::known();
    let (seen, known): (&[Observed<'_>], &[Posed<'_>]) =
        (black_box(&bare::SEEN), black_box(&known));
    black_box(simulator.observe(black_box(0.02), seen)).ok()?;
    black_box(simulator.observe_poses(black_box(0.02), known)).ok()?;
    black_box(simulator.set_command(black_box(&[]))).ok()?;
    loop {
        change(&mut simulator, known);
        black_box(simulator.step()).ok()?;
        look(&simulator);
    }
}

/// Every change. What it returns is the caller's: a refusal here is no reason to stop.
fn change(simulator: &mut Simulator<'_, '_>, known: &[Posed<'_>]) {
    let pose = black_box(Isometry3::identity());
    for Posed { unit, previous, current } in known {
        let _ = black_box(simulator.add(unit, previous, current));
    }
    let id = black_box(UnitId::from_bits(1));
    let _ = black_box(simulator.set_role(id, black_box(Role::Driven)));
    let _ = black_box(simulator.drive(id, &pose));
    let _ = black_box(simulator.set_poses(id, &pose, &pose));
    let physics = Physics { mass_kg: 1.0, friction: 0.5, restitution: 0.5 };
    let _ = black_box(simulator.set_physics(id, black_box(physics)));
    let planes = [Plane::ground(0.5, 0.5)];
    let planes: &[Plane] = black_box(&planes);
    let _ = black_box(simulator.set_planes(planes));
    let _ = black_box(simulator.set_gravity(black_box(Vector3::zeros())));
    let _ = black_box(simulator.set_dt(black_box(0.01)));
    let _ = black_box(simulator.remove(black_box(id)));
}

/// Every look.
fn look(simulator: &Simulator<'_, '_>) {
    for unit in simulator.units() {
        black_box((unit.id(), unit.role(), unit.body(), unit.physics(), unit.point_count()));
        black_box((unit.pose(), unit.previous_pose(), unit.internal_pose()));
        unit.points().for_each(|point| {
            black_box(point);
        });
    }
    let id = black_box(UnitId::from_bits(2));
    black_box((simulator.pose(id), simulator.number(id), simulator.get(id).is_some()));
    black_box(simulator.unit(black_box(1)).map(|unit| unit.pose()));
    black_box((simulator.len(), simulator.is_empty(), simulator.dt_s()));
    black_box((simulator.planes(), simulator.gravity_m_s2(), simulator.limits()));
}
