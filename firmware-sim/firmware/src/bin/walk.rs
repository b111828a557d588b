//! A Unitree G1 of 31 links walks for ten steps of a third of a second under two commands, its links held together. Poses as
//! bits. Needs the feature `walk`.
#![no_std]
#![no_main]

use defmt::Display2Format;
use rigidformer_core::Simulator;
use rigidformer_firmware::counter::Counter;
use rigidformer_firmware::memory::{LIMITS, SIZES, slabs};
use rigidformer_firmware::rollout::{Board, Rollout, load};
use rigidformer_firmware::snapshot::go_back;
use rigidformer_firmware::walk::{STEPS, Walk};
use rigidformer_firmware::{image, scene};
use rigidformer_weights::G1;

#[cortex_m_rt::entry]
fn main() -> ! {
    image::run(case)
}

/// What a controller may get wrong: each is refused, and the robot stays as it was.
fn wrong(board: &mut Board<'_>) {
    if let Err(error) = board.set_command(&[0.5, 0.0]) {
        defmt::info!("a number too few: {}", Display2Format(&error));
    }
    if let Err(error) = board.set_command(&[f32::NAN, 0.0, 0.0]) {
        defmt::info!("no number: {}", Display2Format(&error));
    }
}

fn case(counter: Counter) -> Result<(), &'static str> {
    let model = load(G1)?;
    let slabs = slabs().ok_or("the slabs are taken")?;
    let mut board: Board<'_> =
        Simulator::new(&model, LIMITS, slabs).map_err(|_| "the slabs are too short")?;
    let walk = Walk::read(scene::WALK).ok_or("the walk in flash is damaged")?;
    walk.observe(&mut board)?;
    // A model that takes commands must not step without one.
    if let Err(error) = board.step() {
        defmt::info!("no command: {}", Display2Format(&error));
    }
    let mut rollout = Rollout::new(counter);
    for step in 0..STEPS {
        walk.prepare(&mut board, step)?;
        // In the middle, so that the poses at the end show that nothing has changed.
        if step == STEPS / 2 {
            wrong(&mut board);
            go_back(&mut board, "walk")?;
        }
        rollout.step(&mut board)?;
    }
    rollout.end(&board, "walk").report("walk");
    defmt::info!("measured workspace {=usize}", SIZES.bytes());
    Ok(())
}
