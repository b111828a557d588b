//! What goes wrong on a controller: damaged flash, a broken camera, more than there is room for. Every time an
//! error that says what to do, and the firmware goes on: the rollout in between is that of an undisturbed one.
#![no_std]
#![no_main]

use core::fmt::Display;

use defmt::Display2Format;
use nalgebra::{Isometry3, Point3, Vector3};
use rigidformer_core::{
    EditError, MAX_PLANES, Model, Observed, Physics, Plane, Role, Simulator, Unit, UnitId,
};
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
    // The middle of the file is weights, which only a checksum guards.
    bytes[N / 2] ^= 0x10;
    bytes
}

/// Physics that nothing is wrong with.
const SOUND: Physics = Physics { mass_kg: 1.0, friction: 0.5, restitution: 0.5 };

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
    refused("a unit before a time step", add(&mut board, &Isometry3::identity()))?;

    let scene = Scene::read(CONTACT).ok_or("the scene is damaged")?;
    observe(&mut board, &scene)?;
    observations(&mut board, &scene)?;
    changes(&mut board)?;
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

/// Adds a unit of four points at rest.
fn add(board: &mut Board<'_>, pose: &Isometry3<f32>) -> Result<UnitId, EditError> {
    let points = [[0.0; 3], [0.1, 0.0, 0.0], [0.0, 0.1, 0.0], [0.0, 0.0, 0.1]].map(Point3::from);
    board.add(&Unit::new(&points, SOUND), pose, pose)
}

fn observations(board: &mut Board<'_>, scene: &Scene) -> Result<(), &'static str> {
    let (time, seen) = (scene.seconds(), scene.units());
    // The scene with one unit changed.
    let with = |number: usize, change: fn(&mut Observed<'_>)| {
        let mut seen = seen;
        change(&mut seen[number]);
        seen
    };
    // The camera lost a point.
    let mut points = [Point3::origin(); 64];
    points.copy_from_slice(scene.current[3].get(..64).ok_or("the scene has fewer points")?);
    points[17].y = f32::NAN;
    let mut broken: [Observed<'_>; UNITS] = seen;
    broken[3].current = &points;
    refused("a point that is not a number", board.observe(time, broken))?;

    let more = seen.iter().chain(&seen[..1]);
    refused("a unit too many", board.observe(time, more))?;

    // Two units of 64 points lie behind each other in flash; one of them is 640 points long.
    let all: &[Point3<f32>] = bytemuck::cast_slice(&CONTACT[12 + UNITS * 12..]);
    let mut longer = seen;
    longer[9].current = all.get(..65).ok_or("the scene has fewer points")?;
    longer[9].unit.points = longer[9].current;
    refused("a point too many", board.observe(time, longer))?;

    let fewer = with(2, |unit| unit.current = &unit.current[..63]);
    refused("a point that is gone", board.observe(time, fewer))?;
    let three = with(6, |unit| unit.unit.points = &unit.unit.points[..3]);
    refused("a unit of three points", board.observe(time, three))?;
    refused("nothing at all", board.observe(time, &[]))?;
    refused("no time between frames", board.observe(0.0, seen))?;

    let weightless = with(5, |unit| unit.unit.physics.mass_kg = 0.0);
    refused("a unit without mass", board.observe(time, weightless))?;
    let mut flat: [Observed<'_>; UNITS] = seen;
    let point = [scene.previous[7][0]; 64];
    flat[7].unit.points = &point;
    refused("a unit without extent", board.observe(time, flat))?;
    refused("a command that the model does not take", board.set_command(&[1.0]))
}

/// Changes of the scene that must not come about.
fn changes(board: &mut Board<'_>) -> Result<(), &'static str> {
    let id = board.unit(4).ok_or("the scene has fewer units")?.id();
    let nobody = UnitId::from_bits(u64::MAX);
    let here = Isometry3::identity();
    let nowhere = Isometry3::translation(0.0, f32::NAN, 0.0);

    refused("a unit without room", add(board, &here))?;
    refused("a free unit that is driven", board.drive(id, &here))?;
    refused("a command to nobody", board.drive(nobody, &here))?;
    refused("poses of nobody", board.set_poses(nobody, &here, &here))?;
    refused("a pose that is nowhere", board.set_poses(id, &here, &nowhere))?;
    refused("nobody's physics", board.set_physics(nobody, SOUND))?;
    refused("a negative mass", board.set_physics(id, Physics { mass_kg: -1.0, ..SOUND }))?;
    refused("nobody's role", board.set_role(nobody, Role::Fixed))?;
    refused("nobody to remove", board.remove(nobody))?;

    let ground = Plane::ground(0.3, 0.5);
    let long = Plane { normal: Vector3::new(0.0, 0.0, 2.0), ..ground };
    refused("a normal of length 2", board.set_planes(&[ground, long]))?;
    refused("a plane too many", board.set_planes(&[ground; MAX_PLANES + 1]))?;
    refused("gravity without end", board.set_gravity(Vector3::repeat(f32::INFINITY)))?;
    refused("a time step backwards", board.set_dt(-0.01))
}
