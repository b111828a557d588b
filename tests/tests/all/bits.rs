//! The same bits as the committed ones, whatever the build, the threads and the room.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use nalgebra::Vector3;
use rayon::ThreadPoolBuilder;
use rigidformer_evaluation::rollout::{Trajectory, rollout as run, rollout_many};
use rigidformer_evaluation::scenes::{RecordedScene, RecordedUnit, Split};
use rigidformer_runtime::engine::Engine;
use rigidformer_runtime::kernels::Kernel;
use rigidformer_runtime::models::LoadedModel;
use rigidformer_runtime::progress::Progress;
use rigidformer_runtime::threads::Threads;
use rigidformer_tests::bits::{Fnv1a, golden, models, rollout, rollout_on, rollout_within};
use rigidformer_tests::{Golden, Inputs};

/// `cargo xtask bits` says the same of debug and release builds and of other processors, and
/// `cargo xtask bits --bless` writes the file.
#[test]
fn rollouts_equal_the_committed_hashes() {
    let found: Vec<String> =
        models().iter().map(|(name, file)| rollout(name, file).to_string()).collect();
    assert_eq!(found, golden(), "docs/BITS.md tells what to do");
    assert!(found.iter().all(|line| line.contains("steps 100 active ") && line.len() > 60));
}

/// Every kernel of this processor, shared out over any number of threads, alone and in a batch.
#[test]
fn kernels_threads_and_batches_equal_the_committed_hashes() {
    let (golden, all) = (golden(), models());
    let check = |kernel, threads, copies, models: &str| {
        let engine = Engine { kernel, threads };
        let models_and_lines = all.iter().zip(&golden);
        for ((name, file), golden) in
            models_and_lines.filter(|((name, _), _)| name.starts_with(models))
        {
            for outcome in rollout_on(engine, copies, name, file) {
                assert_eq!(outcome.to_string(), *golden, "{engine:?}, {copies} copies");
            }
        }
    };
    for kernel in Kernel::available() {
        check(kernel, Threads::ONE, 2, "tiny");
        check(kernel, Threads::ONE, 1, "edge-i8");
        check(kernel, Threads::ONE, 1, "edge-giving-i8");
    }
    let fastest = Kernel::available().pop().unwrap();
    check(fastest, Threads::ONE, 1, "edge");
    // Sharing out work that is too small for it takes long.
    check(fastest, Threads::new(2).eager_layers(), 2, "tiny-paper-inputs-i8");
    check(fastest, Threads::new(3).eager_layers(), 1, "tiny-paper-inputs-f16");
    for (threads, copies) in [(2, 3), (5, 1)] {
        check(fastest, Threads::new(threads).eager(), copies, "tiny");
    }
}

#[test]
fn room_to_spare_changes_nothing() {
    for (name, file) in models().iter().filter(|(name, _)| name.starts_with("tiny")) {
        let tight = rollout(name, file);
        assert_eq!(tight, rollout_within(name, file, 64, 1000), "{name}");
    }
}

/// A golden scene without some of its units, as a recording.
fn scene(golden: &Golden, inputs: &Inputs, without: usize) -> RecordedScene {
    let units = (without..inputs.points.len()).map(|i| {
        let pose = |frame| if frame == 0 { inputs.previous[i] } else { inputs.current[i] };
        let poses = (0..=golden.step).map(pose).collect();
        RecordedUnit::new("golden", inputs.points[i].clone(), inputs.physics[i], poses)
    });
    let gravity = Vector3::new(0.0, 0.0, -10.0);
    RecordedScene::new("golden", 0, Split::Test, 240.0, gravity, units.collect()).unwrap()
}

fn hash(trajectory: &Trajectory) -> u64 {
    let mut hash = Fnv1a::default();
    for pose in trajectory.iter().flat_map(|(_, poses)| poses) {
        pose.translation.vector.iter().for_each(|v| hash.add(*v));
        pose.rotation.coords.iter().for_each(|v| hash.add(*v));
    }
    hash.0
}

#[test]
fn threads_change_nothing() {
    for (name, file) in models().iter().filter(|(name, _)| name.starts_with("tiny-paper")) {
        let golden = Golden::read("tiny-paper-inputs");
        let inputs = golden.inputs();
        let model = LoadedModel::copy_of(name, file).unwrap();
        let scenes: Vec<_> = (0..8).map(|without| scene(&golden, &inputs, without)).collect();
        let last = golden.step * 21;
        let alone = scenes.iter().map(|s| run(&model, s, golden.step, last, Progress::none()));
        let alone: Vec<u64> = alone.map(|trajectory| hash(&trajectory.unwrap())).collect();
        for threads in [1, 2, 4] {
            let pool = ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            let many =
                pool.install(|| rollout_many(&model, &scenes, golden.step, last, Progress::none()));
            let many: Vec<u64> = many.unwrap().iter().map(hash).collect();
            assert_eq!(alone, many, "{name} on {threads} threads");
        }
    }
}
