//! Times steps of the scene that comes with the program: what `bindings/python/bench/step.py` compares with.
//!
//! `step edge|nano TURNS THREADS` prints microseconds a step, a line for each turn of eleven steps.

use std::env;
use std::error::Error;
use std::path::Path;
use std::time::Instant;

use rigidformer_evaluation::scenes::Dataset;
use rigidformer_runtime::core::{Limits, Posed};
use rigidformer_runtime::engine::Engine;
use rigidformer_runtime::models::LoadedModel;
use rigidformer_runtime::threads::Threads;
use rigidformer_runtime::world::World;

/// Frames of the scene in a step.
const STEP: usize = 10;
/// Steps of a turn.
const STEPS: usize = 11;

fn main() -> Result<(), Box<dyn Error>> {
    let [name, turns, threads]: [String; 3] = env::args()
        .skip(1)
        .collect::<Vec<_>>()
        .try_into()
        .map_err(|_| "step MODEL TURNS THREADS")?;
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("..");
    let model = LoadedModel::open(&root.join(format!("weights/models/{name}.rfm")))?.for_host()?;
    let scene =
        Dataset::open(&root.join("tools/cli/scenes/default.safetensors"))?.scene(0, None)?;
    let [previous, current] =
        [0, STEP].map(|frame| scene.poses_at(frame).ok_or("the scene is too short"));
    let poses = previous?.into_iter().zip(current?);
    let units: Vec<Posed<'_>> = scene
        .units()
        .iter()
        .zip(poses)
        .map(|(unit, (previous, current))| Posed { unit: unit.as_unit(), previous, current })
        .collect();
    let engine = Engine { threads: Threads::new(threads.parse()?), ..Engine::new()? };
    let mut world = World::on(engine, &model, Limits { units: 64, points: 8192 }, 1)?;
    world.set_gravity(scene.gravity_m_s2())?;
    world.set_contact_law(scene.contact_law())?;
    for _ in 0..turns.parse()? {
        let dt_s = STEP as f32 / scene.frame_rate_hz();
        world.edit(|simulator| simulator.observe_poses(dt_s, &units))?;
        let begin = Instant::now();
        for _ in 0..STEPS {
            world.step()?;
        }
        println!("{}", begin.elapsed().as_secs_f64() * 1e6 / STEPS as f64);
    }
    Ok(())
}
