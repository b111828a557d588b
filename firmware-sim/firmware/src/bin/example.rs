//! The example of docs/FIRMWARE.md: what follows is there, word for word.
#![no_std]
#![no_main]
use rigidformer_core::{Limits, Model, Observed, Physics, Simulator, Unit};
use rigidformer_firmware::{image, memory, scene}; // logger and panic handler, static slabs, a recording
use rigidformer_weights::NANO;

#[cortex_m_rt::entry]
fn main() -> ! {
    image::run(|_| predict().ok_or("refused"))
}

fn predict() -> Option<()> {
    let model = Model::load(NANO).ok()?; // checks everything, copies nothing out of flash
    let limits = Limits { units: 10, points: 640 };
    let mut simulator = Simulator::new(&model, limits, memory::slabs()?).ok()?;
    let camera = scene::Scene::read(scene::CONTACT)?;
    let rubber = Physics { mass_kg: 0.5, friction: 0.8, restitution: 0.7 };
    let frames = camera.previous.iter().zip(&camera.current);
    let units =
        frames.map(|(before, now)| Observed { unit: Unit::new(before, rubber), current: now });
    simulator.observe(5.0 / 240.0, units).ok()?; // s between the frames, and of a step
    for _ in 0..12 {
        simulator.step().ok()?;
    }
    let corner = simulator.unit(0)?.pose() * camera.previous[0][0]; // a pose carries the frame before along
    defmt::info!("from {=f32} m to {=f32} m", camera.current[0][0].z, corner.z);
    Some(())
}
