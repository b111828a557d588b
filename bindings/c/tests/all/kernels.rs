//! With each kernel of this processor C has the bits of Rust. The environment chooses kernels for a whole process, so
//! each has one of its own.
// Handles live here, and arrays are as long as they say.
#![cfg(not(miri))]
#![allow(unsafe_code, clippy::undocumented_unsafe_blocks)]
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use crate::common::*;
use nalgebra::Point3;
use rigidformer_capi::ffi::*;
use rigidformer_capi::types::rf_status::*;
use rigidformer_capi::types::{RF_MAX_THREADS, rf_config};
use rigidformer_core::{Limits, Observed, Physics, Unit};
use rigidformer_runtime::engine::Engine;
use rigidformer_runtime::kernels::{Kernel, VARIABLE};
use rigidformer_runtime::models::LoadedModel;
use rigidformer_runtime::threads::Threads;
use rigidformer_runtime::world::World;
use std::process::Command;
use std::ptr::null_mut;

/// Says to a process that it is to print what C computes.
const CHILD: &str = "RIGIDFORMER_TEST_CHILD";
const UNITS: usize = 9;
const STEPS: usize = 4;

fn models() -> [(&'static str, &'static [u8]); 3] {
    use rigidformer_weights::{EDGE, NANO};
    [("nano", NANO), ("edge", EDGE), ("smallest", smallest())]
}

/// What C computes in this process: a line a model.
fn of_c() -> String {
    let scene = Scene::new(UNITS);
    let line = |(name, model): (&str, &[u8])| {
        let config = config(model, UNITS as u32, 5 * UNITS as u32);
        let mut workspace = Workspace::of(&config);
        let handle = workspace.init(&config);
        assert_eq!(scene.observe(handle), RF_OK);
        for _ in 0..STEPS {
            assert_eq!(step(handle), RF_OK);
        }
        assert!(workspace.rim_is_whole());
        format!("bits of {name}: {:?}\n", poses(handle))
    };
    models().into_iter().map(line).collect()
}

/// What Rust computes with these kernels on so many threads.
fn of_rust(kernel: Kernel, threads: usize) -> String {
    let scene = Scene::new(UNITS);
    let points = |frame: &[[f32; 3]]| frame.iter().map(|p| Point3::from(*p)).collect::<Vec<_>>();
    let (previous, current) = (points(&scene.previous), points(&scene.current));
    let line = |(name, model): (&str, &'static [u8])| {
        let model = LoadedModel::embedded(name, model).unwrap().for_host().unwrap();
        let engine = Engine { kernel, threads: Threads::new(threads) };
        let limits = Limits { units: UNITS, points: 5 * UNITS };
        let mut world = World::on(engine, &model, limits, 1).unwrap();
        let units = previous.chunks(5).zip(current.chunks(5)).zip(&scene.physics);
        let units = units.map(|((points, current), p)| {
            let physics =
                Physics { mass_kg: p.mass_kg, friction: p.friction, restitution: p.restitution };
            Observed { unit: Unit::new(points, physics), current }
        });
        let units: Vec<_> = units.collect();
        world.edit(|simulator| simulator.observe(DT_S, &units)).unwrap();
        for _ in 0..STEPS {
            world.step().unwrap();
        }
        let poses = world.simulator().units().map(|unit| {
            let pose = unit.internal_pose();
            let rows = pose.rotation.transpose();
            let mut numbers = rows.iter().chain(&pose.centre);
            std::array::from_fn(|_| numbers.next().unwrap().to_bits())
        });
        format!("bits of {name}: {:?}\n", poses.collect::<Vec<[u32; 12]>>())
    };
    models().into_iter().map(line).collect()
}

/// What a process of its own prints that runs one test under this value of the variable.
fn child(test: &str, kernel: &str) -> String {
    let mut command = Command::new(std::env::current_exe().unwrap());
    command.args(["--exact", test, "--nocapture", "--test-threads=1"]);
    let output = command.env(VARIABLE, kernel).env(CHILD, "1").output().unwrap();
    let text = String::from_utf8(output.stdout).unwrap();
    assert!(output.status.success(), "{text}\n{}", String::from_utf8_lossy(&output.stderr));
    text
}

#[test]
fn each_kernel_has_the_bits_of_rust() {
    if std::env::var_os(CHILD).is_some() {
        // Behind the name of the test, which the harness prints.
        return print!("\n{}", of_c());
    }
    let available = Kernel::available();
    assert!(available.contains(&Kernel::Portable));
    for kernel in available {
        let printed = child("kernels::each_kernel_has_the_bits_of_rust", kernel.name());
        let of_c: String =
            printed.split_inclusive('\n').filter(|l| l.starts_with("bits of ")).collect();
        for threads in [1, 3] {
            assert!(of_c == of_rust(kernel, threads), "{kernel}, {threads} threads:\n{of_c}");
        }
    }
    assert_eq!(of_c(), of_rust(Kernel::Portable, 1), "what this process chose");
}

#[test]
fn kernels_that_are_not_there_are_refused() {
    if std::env::var_os(CHILD).is_none() {
        for name in ["sse2", "AVX2"] {
            assert!(
                child("kernels::kernels_that_are_not_there_are_refused", name).contains("refused")
            );
        }
        return;
    }
    let config = config(smallest(), 2, 10);
    let mut bytes = 7;
    assert_eq!(unsafe { rf_workspace_bytes(&config, &mut bytes) }, RF_ERROR_KERNEL);
    assert_eq!(bytes, 7);
    let mut workspace = Workspace::new(1 << 20);
    let mut handle = null_mut();
    let memory = workspace.pointer().cast();
    let status = unsafe { rf_init(&config, memory, 1 << 20, &mut handle, null_mut()) };
    assert_eq!((status, handle.is_null()), (RF_ERROR_KERNEL, true));
    println!("\nrefused");
}

/// The model is read from the workspace alone where that holds it in panels, and wherever that begins.
#[test]
fn a_workspace_may_begin_at_any_multiple_of_16() {
    let scene = Scene::new(2);
    for (name, model) in models() {
        let config = config(model, 2, 10);
        let mut bytes = 0;
        assert_eq!(unsafe { rf_workspace_bytes(&config, &mut bytes) }, RF_OK);
        let mut all = Vec::new();
        for shift in [0, 16, 32, 48] {
            let mut memory = Workspace::new(bytes + shift);
            let (start, mut handle) = (memory.pointer(), null_mut());
            let start = unsafe { start.add(shift) }.cast();
            assert_eq!(unsafe { rf_init(&config, start, bytes, &mut handle, null_mut()) }, RF_OK);
            assert_eq!(scene.observe(handle), RF_OK);
            assert_eq!(step(handle), RF_OK);
            assert!(memory.rim_is_whole(), "{name} from {shift}");
            all.push(poses(handle));
        }
        assert!(all.iter().all(|poses| *poses == all[0]), "{name}");
    }
}

/// Threads that share a step change no bit, and have a bound.
#[test]
fn threads_have_the_bits_of_one() {
    const MANY: usize = 60;
    let scene = Scene::new(MANY);
    for (name, model) in models() {
        let poses = |threads| {
            let config = rf_config { threads, ..config(model, MANY as u32, 5 * MANY as u32) };
            let mut workspace = Workspace::of(&config);
            let handle = workspace.init(&config);
            assert_eq!(scene.observe(handle), RF_OK);
            for _ in 0..STEPS {
                assert_eq!(step(handle), RF_OK);
            }
            assert!(workspace.rim_is_whole());
            (poses(handle), workspace.bytes)
        };
        let (alone, bytes) = poses(0);
        assert_eq!(poses(1), (alone.clone(), bytes));
        for threads in [2, 3, RF_MAX_THREADS] {
            let (found, more) = poses(threads);
            assert_eq!(found, alone, "{name} on {threads} threads");
            assert!(more >= bytes);
        }
    }
    let (_, model) = models()[0];
    let many = rf_config { threads: RF_MAX_THREADS + 1, ..config(model, 2, 10) };
    let mut bytes = 0;
    assert_eq!(unsafe { rf_workspace_bytes(&many, &mut bytes) }, RF_ERROR_THREADS);
    let mut workspace = Workspace::of(&config(model, 2, 10));
    let (_, detail) = workspace.try_init(&many);
    assert_eq!((detail.code, detail.found, detail.expected), (RF_ERROR_THREADS, 17, 16));
}
