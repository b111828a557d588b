//! Two scenes, a hundred steps each: poses as bits, instructions by stage.
#![no_std]
#![no_main]

use defmt::Display2Format;
use rigidformer_core::{Kernels, Native, Simulator};
use rigidformer_firmware::counter::Counter;
use rigidformer_firmware::memory::{LIMITS, SIZES, slabs};
use rigidformer_firmware::rollout::{Board, load, observe_bodies, roll_out};
use rigidformer_firmware::scene::{BODIES, Bodies, SCENES};
use rigidformer_firmware::{MODEL, image};

#[cortex_m_rt::entry]
fn main() -> ! {
    image::run(case)
}

fn case(counter: Counter) -> Result<(), &'static str> {
    let model = load(MODEL)?;
    let slabs = slabs().ok_or("the slabs are taken")?;
    let mut board: Board<'_> = Simulator::new(&model, LIMITS, slabs).map_err(|error| {
        defmt::error!("workspace: {}", Display2Format(&error));
        "the slabs are too short"
    })?;
    defmt::info!("kernels {=str}", Native::NAME);
    // They lie on the stack here and could be statics.
    defmt::info!("measured views {=usize}", size_of_val(&model) + size_of_val(&board));
    defmt::info!("measured workspace {=usize}", SIZES.bytes());
    // A step should take as long in a heap as in the air, so both are measured.
    let bodies = Bodies::read(BODIES).ok_or("the bodies are damaged")?;
    for (number, name) in SCENES.into_iter().enumerate() {
        observe_bodies(&mut board, &bodies, number)?;
        roll_out(&mut board, name, 100, counter)?.report(name);
    }
    Ok(())
}
