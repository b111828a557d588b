//! Processor time of a step: `rf_step` beside Rust's `World` on one thread, in turns, of a pile of cubes.
//!
//! ```sh
//! cargo bench -p rigidformer-capi
//! ```
// Handles live here, and arrays are as long as they say.
#![allow(unsafe_code, clippy::undocumented_unsafe_blocks)]
#![allow(missing_docs, clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use std::mem::MaybeUninit;
use std::path::Path;
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

const CUBES: usize = 5;
/// From the start to rest, at 24 steps a second.
const STEPS: usize = 11;
const TURNS: usize = 201;
const PHYSICS: [f32; 3] = [1.0, 0.5, 0.4];

fn main() {
    // Cargo hands `--bench` in, and tests run it without.
    let turns = if std::env::args().any(|word| word == "--bench") { TURNS } else { 1 };
    println!("{:<12} {:>9} {:>9} {:>6}", "model", "C us", "Rust us", "ratio");
    for name in ["nano", "edge-i8", "edge"] {
        let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../weights/models");
        let file = LoadedModel::open(&path.join(format!("{name}.rfm"))).unwrap();
        let (mut c, mut rust) = (C::new(&file), Rust::new(&file));
        let (mut of_c, mut of_rust) = (Vec::new(), Vec::new());
        for _ in 0..turns {
            of_c.push(c.turn());
            of_rust.push(rust.turn());
        }
        let [of_c, of_rust] = [of_c, of_rust].map(median);
        println!("{name:<12} {of_c:>9.1} {of_rust:>9.1} {:>6.3}", of_c / of_rust);
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

fn corners() -> [[f32; 3]; 8] {
    std::array::from_fn(|i| [i & 4, i & 2, i & 1].map(|bit| if bit == 0 { -0.2 } else { 0.2 }))
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
    fn new(model: &LoadedModel) -> Self {
        let config = rf_config {
            abi_version: RF_ABI_VERSION,
            max_units: CUBES as u32,
            max_points: 8 * CUBES as u32,
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
        let corners = corners();
        let unit = rf_unit {
            physics: rf_physics { mass_kg, friction, restitution },
            role: RF_ROLE_FREE,
            body: RF_OWN_BODY,
            points: corners.as_ptr().cast(),
            point_count: 8,
            inertia_kg_m2: [0.0; 3],
            piece_points: null(),
            piece_counts: null(),
            piece_count: 0,
        };
        let ids = (0..CUBES).map(|i| {
            let (mut id, pose) = (0, at(poses(i)[1]));
            assert_eq!(unsafe { rf_add(handle, &unit, &pose, &pose, &mut id) }, RF_OK);
            id
        });
        C { ids: ids.collect(), handle, _workspace: workspace, _model: model.clone() }
    }

    fn turn(&mut self) -> f64 {
        for (i, id) in self.ids.iter().enumerate() {
            let [before, now] = poses(i).map(at);
            assert_eq!(unsafe { rf_set_poses(self.handle, *id, &before, &now) }, RF_OK);
        }
        let start = now_us();
        for _ in 0..STEPS {
            assert_eq!(unsafe { rf_step(self.handle, null_mut()) }, RF_OK);
        }
        (now_us() - start) / STEPS as f64
    }
}

struct Rust {
    world: World,
    ids: Vec<UnitId>,
}

impl Rust {
    fn new(model: &LoadedModel) -> Self {
        let engine = Engine { kernel: Kernel::chosen().unwrap(), threads: Threads::ONE };
        let limits = Limits { units: CUBES, points: 8 * CUBES };
        let model = model.clone().for_host().unwrap();
        let mut world = World::on(engine, &model, limits, 1).unwrap();
        world.set_dt(1.0 / 24.0).unwrap();
        let [mass_kg, friction, restitution] = PHYSICS;
        let corners = corners().map(Point3::from);
        let unit = Unit::new(&corners, Physics { mass_kg, friction, restitution });
        let ids = (0..CUBES).map(|i| {
            let [x, y, z] = poses(i)[1];
            world.add(&unit, &Isometry3::translation(x, y, z)).unwrap()
        });
        Rust { ids: ids.collect(), world }
    }

    fn turn(&mut self) -> f64 {
        for (i, id) in self.ids.iter().enumerate() {
            let [before, now] = poses(i).map(|[x, y, z]| Isometry3::translation(x, y, z));
            self.world.edit(|simulator| simulator.set_poses(*id, &before, &now)).unwrap();
        }
        let start = now_us();
        for _ in 0..STEPS {
            self.world.step().unwrap();
        }
        (now_us() - start) / STEPS as f64
    }
}
