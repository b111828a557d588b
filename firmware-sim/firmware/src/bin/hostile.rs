//! What goes wrong on a controller: damaged flash, a broken camera, more than there is room for. Every time an
//! error that says what to do, and the firmware goes on: the rollout in between is that of an undisturbed one.
#![no_std]
#![no_main]

use core::fmt::Display;

use defmt::Display2Format;
use nalgebra::Point3;
use rigidformer_core::{Model, Physics, Simulator};
use rigidformer_firmware::counter::Counter;
use rigidformer_firmware::image;
use rigidformer_firmware::memory::{LIMITS, UNITS, slabs};
use rigidformer_firmware::rollout::{Board, load, observe, roll_out};
use rigidformer_firmware::scene::{CONTACT, Scene};
use rigidformer_weights::{Aligned, NANO};

/// Something else than a model, where the model should be: flash that was erased.
static ERASED: &Aligned<[u8]> = &Aligned([0xff; 4096]);
/// The model with one bit turned over, far behind its header.
static FLIPPED: &Aligned<[u8]> =
    &Aligned(flipped(*include_bytes!("../../../../weights/models/nano.rfm")));

const fn flipped<const N: usize>(mut bytes: [u8; N]) -> [u8; N] {
    bytes[N / 2] ^= 0x10;
    bytes
}

#[cortex_m_rt::entry]
fn main() -> ! {
    image::run(case)
}

/// Reports the error that must come.
fn refused<T, E: Display>(what: &'static str, result: Result<T, E>) -> Result<(), &'static str> {
    match result {
        Ok(_) => Err(what),
        Err(error) => {
            defmt::error!("{=str}: {}", what, Display2Format(&error));
            Ok(())
        }
    }
}

fn case(counter: Counter) -> Result<(), &'static str> {
    models()?;
    let model = load(NANO)?;
    let slabs = slabs().ok_or("the slabs are taken")?;
    let mut board: Board<'_> =
        Simulator::new(&model, LIMITS, slabs).map_err(|_| "the slabs are too short")?;
    refused("a step before an observation", board.step())?;

    let scene = Scene::read(CONTACT).ok_or("the scene is damaged")?;
    observe(&mut board, &scene)?;
    observations(&mut board, &scene)?;
    // The scene is still the one that was observed before all those.
    roll_out(&mut board, "contact", 10, counter)?;
    observe(&mut board, &scene)?;
    roll_out(&mut board, "contact", 10, counter)?;
    Ok(())
}

fn models() -> Result<(), &'static str> {
    refused("erased flash", Model::load(ERASED))?;
    refused("a cut model", Model::load(NANO.get(..NANO.len() / 2).unwrap_or_default()))?;
    refused("no model at all", Model::load(&[]))?;
    refused("a model elsewhere", Model::load(NANO.get(1..).unwrap_or_default()))?;
    refused("a flipped bit", Model::load(FLIPPED))
}

fn observations(board: &mut Board<'_>, scene: &Scene) -> Result<(), &'static str> {
    let Scene { step, physics, previous, current } = *scene;
    // The camera lost a point.
    let mut points = [Point3::origin(); 64];
    points.copy_from_slice(current[3].get(..64).ok_or("the scene has fewer points")?);
    points[17].y = f32::NAN;
    let mut broken = current;
    broken[3] = &points;
    refused("a point that is not a number", board.observe(step, &physics, &previous, &broken))?;

    let (mut more, mut more_physics) = ([previous[0]; UNITS + 1], [physics[0]; UNITS + 1]);
    more[..UNITS].copy_from_slice(&previous);
    more_physics[..UNITS].copy_from_slice(&physics);
    refused("a unit too many", board.observe(step, &more_physics, &more, &more))?;

    // Two units of 64 points lie behind each other in flash; one of them is 640 points long.
    let all: &[Point3<f32>] = bytemuck::cast_slice(&CONTACT[12 + UNITS * 12..]);
    let mut longer = previous;
    longer[9] = all.get(..65).ok_or("the scene has fewer points")?;
    refused("a point too many", board.observe(step, &physics, &longer, &longer))?;

    let mut fewer = current;
    fewer[2] = &current[2][..63];
    refused("a point that is gone", board.observe(step, &physics, &previous, &fewer))?;
    refused("frames of different units", board.observe(step, &physics, &previous[..9], &current))?;
    refused("nothing at all", board.observe(step, &[], &[], &[]))?;
    refused("no time between frames", board.observe(0, &physics, &previous, &current))?;

    let mut weightless = physics;
    weightless[5] = Physics { mass_kg: 0.0, ..physics[5] };
    refused("a unit without mass", board.observe(step, &weightless, &previous, &current))?;
    let mut flat = previous;
    let point = [previous[7][0]; 64];
    flat[7] = &point;
    refused("a unit without extent", board.observe(step, &physics, &flat, &current))?;
    refused("a command that the model does not take", board.set_command(&[1.0]))
}
