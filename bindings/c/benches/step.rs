//! Processor time of a step: `rf_step` beside Rust's `World` and Python's, on one thread, in turns, of piles of cubes: five of 8
//! points, and ten of 64 as W-edge has.
//!
//! ```sh
//! cargo bench -p rigidformer-capi
//! cargo bench -p rigidformer-capi --bench step -- --python target/python/venv/bin/python    # after `cargo xtask python`
//! ```
// Handles live here, and arrays are as long as they say.
#![allow(unsafe_code, clippy::undocumented_unsafe_blocks)]
#![allow(missing_docs, clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use std::io::{BufRead, BufReader, Write};
use std::mem::MaybeUninit;
use std::path::Path;
use std::process::{Child, ChildStdout, Command, Stdio};
use std::ptr::{null, null_mut};

use nalgebra::{Isometry3, Point3};
use rigidformer_capi::edit::{rf_add, rf_set_dt, rf_set_poses};
use rigidformer_capi::ffi::{rf_init, rf_step, rf_workspace_bytes};
use rigidformer_capi::types::rf_status::RF_OK;
use rigidformer_capi::types::*;
use rigidformer_runtime::core::{Limits, Physics, Unit, UnitId};
use rigidformer_runtime::engine::Engine;
use rigidformer_runtime::kernels::Kernel;
use rigidformer_runtime::models::LoadedModel;
use rigidformer_runtime::threads::Threads;
use rigidformer_runtime::world::World;
use rustix::time::{ClockId, clock_gettime};

/// Units and points along a cube's edge.
const PILES: [(usize, usize); 2] = [(5, 2), (10, 4)];
/// From the start to rest, at 24 steps a second.
const STEPS: usize = 11;
const TURNS: usize = 101;
const PHYSICS: [f32; 3] = [1.0, 0.5, 0.4];

fn main() {
    let words: Vec<String> = std::env::args().collect();
    // Cargo hands `--bench` in, and tests run it without.
    let turns = if words.iter().any(|word| word == "--bench") { TURNS } else { 1 };
    let python = words.windows(2).find(|pair| pair[0] == "--python").map(|pair| &*pair[1]);
    println!(
        "{:<8} {:<10} {:>9} {:>9} {:>9} {:>8} {:>10}",
        "model", "units", "C us", "Rust us", "Python us", "C / Rust", "C / Python"
    );
    for name in ["nano", "edge-i8", "edge"] {
        let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../weights/models");
        let path = path.join(format!("{name}.rfm"));
        let file = LoadedModel::open(&path).unwrap();
        for pile in PILES {
            let (mut c, mut rust) = (C::new(&file, pile), Rust::new(&file, pile));
            let mut python = python.map(|python| Python::new(python, &path, pile));
            let (mut of_c, mut of_rust, mut of_python) = (Vec::new(), Vec::new(), Vec::new());
            for _ in 0..turns {
                of_c.push(c.turn());
                of_rust.push(rust.turn());
                of_python.push(python.as_mut().map_or(f64::NAN, Python::turn));
            }
            // A shared machine changes its speed from turn to turn, which each turn's ratio leaves out.
            let ratio = |of: &[f64]| median(of_c.iter().zip(of).map(|(c, x)| c / x).collect());
            let (to_rust, to_python) = (ratio(&of_rust), ratio(&of_python));
            let [of_c, of_rust, of_python] = [of_c, of_rust, of_python].map(median);
            let units = format!("{} x {}", pile.0, pile.1.pow(3));
            println!(
                "{name:<8} {units:<10} {of_c:>9.1} {of_rust:>9.1} {of_python:>9.1} {to_rust:>8.3} {to_python:>10.3}"
            );
        }
    }
    println!("kernels: {}", Kernel::chosen().unwrap());
}

fn median(mut all: Vec<f64>) -> f64 {
    all.sort_by(f64::total_cmp);
    all[all.len() / 2]
}

/// Processor time, microseconds.
fn now_us() -> f64 {
    let now = clock_gettime(ClockId::ProcessCPUTime);
    1e6 * now.tv_sec as f64 + 1e-3 * now.tv_nsec as f64
}

/// The second of two runs: the first finds caches that others have filled, and whoever follows Python has more of that.
fn warm(mut run: impl FnMut() -> f64) -> f64 {
    run();
    run()
}

/// A cube's lattice of so many points along each edge.
fn lattice(side: usize) -> Vec<[f32; 3]> {
    let at = |k: usize| 0.4 * k as f32 / (side - 1) as f32 - 0.2;
    (0..side.pow(3)).map(|i| [i / (side * side), i / side % side, i % side].map(at)).collect()
}

/// Where a cube is a step ago and now.
fn poses(i: usize) -> [[f32; 3]; 2] {
    let (column, row) = ((i % 3) as f32, (i / 3) as f32);
    [[0.45 * column, 0.05, 0.25 + 0.45 * row], [0.43 * column, 0.0, 0.21 + 0.42 * row]]
}

struct C {
    handle: *mut rf_simulator,
    ids: Vec<rf_unit_id>,
    _workspace: Vec<MaybeUninit<Block>>,
    _model: LoadedModel,
}

#[repr(align(64))]
struct Block(#[allow(dead_code)] [u8; 64]);

fn at(position: [f32; 3]) -> rf_pose {
    rf_pose { position, quaternion: [0.0, 0.0, 0.0, 1.0] }
}

impl C {
    fn new(model: &LoadedModel, (cubes, side): (usize, usize)) -> Self {
        let points = lattice(side);
        let config = rf_config {
            abi_version: RF_ABI_VERSION,
            max_units: cubes as u32,
            max_points: (points.len() * cubes) as u32,
            threads: 0,
            model: model.bytes().as_ptr(),
            model_bytes: model.len(),
        };
        let (mut bytes, mut handle) = (0, null_mut());
        assert_eq!(unsafe { rf_workspace_bytes(&config, &mut bytes) }, RF_OK);
        let mut workspace = Vec::new();
        workspace.resize_with(bytes.div_ceil(64), MaybeUninit::uninit);
        let memory = workspace.as_mut_ptr().cast();
        assert_eq!(unsafe { rf_init(&config, memory, bytes, &mut handle, null_mut()) }, RF_OK);
        assert_eq!(unsafe { rf_set_dt(handle, 1.0 / 24.0) }, RF_OK);
        let [mass_kg, friction, restitution] = PHYSICS;
        let unit = rf_unit {
            physics: rf_physics { mass_kg, friction, restitution },
            role: RF_ROLE_FREE,
            body: RF_OWN_BODY,
            points: points.as_ptr().cast(),
            point_count: points.len(),
            inertia_kg_m2: [0.0; 3],
            piece_points: null(),
            piece_counts: null(),
            piece_count: 0,
        };
        let ids = (0..cubes).map(|i| {
            let (mut id, pose) = (0, at(poses(i)[1]));
            assert_eq!(unsafe { rf_add(handle, &unit, &pose, &pose, &mut id) }, RF_OK);
            id
        });
        C { ids: ids.collect(), handle, _workspace: workspace, _model: model.clone() }
    }

    fn turn(&mut self) -> f64 {
        warm(|| {
            for (i, id) in self.ids.iter().enumerate() {
                let [before, now] = poses(i).map(at);
                assert_eq!(unsafe { rf_set_poses(self.handle, *id, &before, &now) }, RF_OK);
            }
            let start = now_us();
            for _ in 0..STEPS {
                assert_eq!(unsafe { rf_step(self.handle, null_mut()) }, RF_OK);
            }
            (now_us() - start) / STEPS as f64
        })
    }
}

struct Rust {
    world: World,
    ids: Vec<UnitId>,
}

impl Rust {
    fn new(model: &LoadedModel, (cubes, side): (usize, usize)) -> Self {
        let points: Vec<_> = lattice(side).into_iter().map(Point3::from).collect();
        let engine = Engine { kernel: Kernel::chosen().unwrap(), threads: Threads::ONE };
        let limits = Limits { units: cubes, points: points.len() * cubes };
        let model = model.clone().for_host().unwrap();
        let mut world = World::on(engine, &model, limits, 1).unwrap();
        world.set_dt(1.0 / 24.0).unwrap();
        let [mass_kg, friction, restitution] = PHYSICS;
        let unit = Unit::new(&points, Physics { mass_kg, friction, restitution });
        let ids = (0..cubes).map(|i| {
            let [x, y, z] = poses(i)[1];
            world.add(&unit, &Isometry3::translation(x, y, z)).unwrap()
        });
        Rust { ids: ids.collect(), world }
    }

    fn turn(&mut self) -> f64 {
        warm(|| {
            for (i, id) in self.ids.iter().enumerate() {
                let [before, now] = poses(i).map(|[x, y, z]| Isometry3::translation(x, y, z));
                self.world.edit(|simulator| simulator.set_poses(*id, &before, &now)).unwrap();
            }
            let start = now_us();
            for _ in 0..STEPS {
                self.world.step().unwrap();
            }
            (now_us() - start) / STEPS as f64
        })
    }
}

/// A process with Python's `World`, which takes a turn for each line that it reads.
struct Python {
    child: Child,
    answers: BufReader<ChildStdout>,
}

impl Python {
    fn new(python: &str, model: &Path, (cubes, side): (usize, usize)) -> Self {
        let mut child = Command::new(python)
            .arg(Path::new(env!("CARGO_MANIFEST_DIR")).join("benches/step.py"))
            .arg(model)
            .args([cubes, side, STEPS].map(|count| count.to_string()))
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .spawn()
            .unwrap();
        let answers = BufReader::new(child.stdout.take().unwrap());
        Python { child, answers }
    }

    fn turn(&mut self) -> f64 {
        let questions = self.child.stdin.as_mut().unwrap();
        questions.write_all(b"\n").unwrap();
        questions.flush().unwrap();
        let mut answer = String::new();
        self.answers.read_line(&mut answer).unwrap();
        answer.trim().parse().expect("a time; is rigidformer installed for that Python?")
    }
}

impl Drop for Python {
    fn drop(&mut self) {
        drop(self.child.stdin.take());
        let _ = self.child.wait();
    }
}
