//! A robot's workplace, 20 steps: a fixed table, a driven finger that pushes a box, a ramp, a wall, units of one body,
//! a unit that comes and one that goes. Poses as bits.
#![no_std]
#![no_main]

use defmt::Display2Format;
use rigidformer_core::{EditError, Simulator};
use rigidformer_firmware::counter::Counter;
use rigidformer_firmware::image;
use rigidformer_firmware::memory::{LIMITS, slabs};
use rigidformer_firmware::rollout::{Board, Rollout, load};
use rigidformer_firmware::snapshot::go_back;
use rigidformer_firmware::workcell::{STEPS, Workcell};
use rigidformer_weights::NANO;

#[cortex_m_rt::entry]
fn main() -> ! {
    image::run(case)
}

fn refused(error: EditError) -> &'static str {
    defmt::error!("edit: {}", Display2Format(&error));
    "a change was refused"
}

fn case(counter: Counter) -> Result<(), &'static str> {
    let model = load(NANO)?;
    let slabs = slabs().ok_or("the slabs are taken")?;
    let mut board: Board<'_> =
        Simulator::new(&model, LIMITS, slabs).map_err(|_| "the slabs are too short")?;
    let mut workcell = Workcell::observe(&mut board).map_err(refused)?;
    let mut rollout = Rollout::new(counter);
    for step in 0..STEPS {
        workcell.prepare(&mut board, step).map_err(refused)?;
        if step == STEPS / 2 {
            go_back(&mut board, "robot")?;
        }
        rollout.step(&mut board)?;
        workcell.check(&board)?;
    }
    rollout.end(&board, "robot").report("robot");
    Ok(())
}
