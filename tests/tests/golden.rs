//! Block by block and over 20 steps, the core against PyTorch (f64).
#![allow(missing_docs, clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use nalgebra::{Isometry3, Matrix3, Rotation3, Translation3, UnitQuaternion};
use rigidformer_core::{Layer, Trace};
use rigidformer_tests::{Golden, packed_model, pose_difference, poses, seconds, with_simulator};
use std::collections::BTreeMap;

/// Values by layer and index, tiles of a unit appended.
#[derive(Default)]
struct Recording(BTreeMap<(Layer, usize), Vec<f32>>);

impl Trace for Recording {
    fn record(&mut self, layer: Layer, index: usize, values: &[f32]) {
        self.0.entry((layer, index)).or_default().extend_from_slice(values);
    }
}

impl Recording {
    /// All indices of a layer, one after another.
    fn layer(&self, layer: Layer) -> Vec<f32> {
        let parts = self.0.iter().filter(|((l, _), _)| *l == layer);
        parts.flat_map(|(_, values)| values.iter().copied()).collect()
    }
}

fn assert_close(name: &str, mine: &[f32], theirs: &[f32], tolerance: f32) {
    assert_eq!(mine.len(), theirs.len(), "{name}: length");
    let scale = theirs.iter().fold(0.0_f32, |m, v| m.max(v.abs()));
    let error = mine.iter().zip(theirs).map(|(a, b)| (a - b).abs()).fold(0.0_f32, f32::max);
    println!("{name}: relative error {:.1e}", error / scale);
    assert!(error <= tolerance * scale, "{name}: {error} of {scale}");
}

fn golden_poses(golden: &Golden) -> Vec<Vec<Isometry3<f32>>> {
    let (values, shape) = golden.tensor("rollout");
    let frame = |rows: &[f32]| {
        let unit = |m: &[f32]| {
            // (3, 4): a column of translation, then three of rotation.
            let rotation = Matrix3::from_fn(|i, j| m[i * 4 + 1 + j]);
            Isometry3::from_parts(
                Translation3::new(m[0], m[4], m[8]),
                UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(rotation)),
            )
        };
        rows.chunks_exact(12).map(unit).collect()
    };
    values.chunks_exact(shape[1] * 12).map(frame).collect()
}

fn check(name: &str, file: &[u8], blocks: bool) {
    let golden = Golden::read(name);
    let inputs = golden.inputs();
    let points = inputs.points.iter().map(Vec::len).sum();
    with_simulator(file, points, |simulator| {
        if let Some(command) = golden.command() {
            simulator.set_command(&command).unwrap();
        }
        simulator.observe_poses(seconds(golden.step), inputs.posed()).unwrap();
        let mut trace = Recording::default();
        let report = simulator.step_traced(&mut trace).unwrap();
        let active: i64 = golden.integers("active").iter().sum();
        assert_eq!(i64::from(report.active_units), active, "active units");
        let compare = |layer: &str, mine: &[f32]| {
            assert_close(&format!("{name} {layer}"), mine, &golden.tensor(layer).0, 1e-5);
        };
        if blocks {
            compare("features", &trace.layer(Layer::Features));
            if golden.has("impacts") {
                compare("impacts", &trace.layer(Layer::Impacts));
            }
            compare("point_features", &trace.layer(Layer::PointFeatures));
        }
        for i in (0..5).filter(|i| golden.has(&format!("tokens_{i}"))) {
            compare(&format!("tokens_{i}"), &trace.0[&(Layer::Tokens, i)]);
        }
        compare("head", &trace.layer(Layer::Head));
        compare("advanced", &trace.layer(Layer::Advanced));
        for (step, expected) in golden_poses(&golden).iter().enumerate() {
            if step > 0 {
                simulator.step().unwrap();
            }
            let (position, angle) = pose_difference(&poses(simulator), expected);
            if step == 19 {
                println!("{name} after 20 steps: {position:.1e} m, {angle:.1e} rad");
            }
            assert!(position <= 1e-4 && angle <= 1e-3, "step {step}: {position} m, {angle} rad");
        }
    });
}

#[test]
fn tiny_model_with_commands_and_free_motion() {
    check("tiny", &packed_model("tiny"), true);
}

#[test]
fn tiny_model_with_the_papers_inputs_and_verlet() {
    check("tiny-paper-inputs", &packed_model("tiny-paper-inputs"), true);
}

#[test]
fn tiny_model_with_impacts() {
    check("tiny-impact", &packed_model("tiny-impact"), true);
}

#[test]
fn embedded_edge_model() {
    check("edge", rigidformer_weights::EDGE, false);
}
