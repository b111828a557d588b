//! How far units are from what training saw, before and after one is tampered with, and quarantine. Needs the feature `health`.
#![no_std]
#![no_main]

use rigidformer_core::Simulator;
use rigidformer_firmware::counter::Counter;
use rigidformer_firmware::health::{RANGES, tell};
use rigidformer_firmware::image;
use rigidformer_firmware::memory::{LIMITS, slabs};
use rigidformer_firmware::rollout::{Board, load, observe};
use rigidformer_firmware::scene::{CONTACT, Scene};
use rigidformer_weights::NANO;

#[cortex_m_rt::entry]
fn main() -> ! {
    image::run(case)
}

fn case(counter: Counter) -> Result<(), &'static str> {
    let model = load(NANO)?;
    let slabs = slabs().ok_or("the slabs are taken")?;
    let mut board: Board<'_> =
        Simulator::new(&model, LIMITS, slabs).map_err(|_| "the slabs are too short")?;
    let scene = Scene::read(CONTACT).ok_or("the scene is damaged")?;
    observe(&mut board, &scene)?;
    let id = board.unit(0).ok_or("there is no unit")?.id();
    let start = counter.now();
    let health = board.health_within(id, Some(&RANGES)).ok_or("there is no unit")?;
    defmt::info!("measured unit {=u32}", counter.since(start));
    if !health.is_known() {
        return Err("nothing is known");
    }
    tell(&mut board, |what, [a, b, c, d]| {
        defmt::info!("{=str}: {=u32} {=u32:08x} {=u32} {=u32:08x}", what, a, b, c, d);
    })?;
    Ok(())
}
