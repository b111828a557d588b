//! Units of models that know their hulls end no step below the ground (docs/MODEL.md, section 7).
#![allow(missing_docs, clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use nalgebra::{Isometry3, Point3, Translation3, Vector3};
use rigidformer_core::{Physics, UnitView};
use rigidformer_tests::{Inputs, Random, packed_model, seconds, with_simulator};
use rigidformer_weights::{AlignedBuffer, EDGE};

/// Boxes in random poses, the lowest corner of each at `height` in both frames, metres.
fn boxes(random: &mut Random, count: usize, height: f32) -> Inputs {
    let corner = |i: i32| Vector3::new((i & 1) as f32, (i >> 1 & 1) as f32, (i >> 2) as f32);
    let mut inputs = Inputs { points: vec![], physics: vec![], previous: vec![], current: vec![] };
    for unit in 0..count {
        let size = Vector3::repeat(0.5) + random.vector() * 0.3;
        let points: Vec<_> = (0..8)
            .map(|i| Point3::from((corner(i) - Vector3::repeat(0.5)).component_mul(&size)))
            .collect();
        let rotation = random.rotation();
        let low = points.iter().map(|p| (rotation * p).z).fold(f32::INFINITY, f32::min);
        let at = Vector3::new(unit as f32 * 1.5, 0.0, height - low);
        let pose = Isometry3::from_parts(Translation3::from(at), rotation);
        inputs.previous.push(pose);
        inputs.current.push(pose);
        inputs.physics.push(Physics { mass_kg: 2.0, friction: 0.5, restitution: 0.5 });
        inputs.points.push(points);
    }
    inputs
}

fn lowest(unit: &UnitView<'_>) -> f32 {
    unit.points().map(|point| point.z).fold(f32::INFINITY, f32::min)
}

/// `check` gets each unit's lowest point after each step, metres.
fn roll(file: &[u8], inputs: &Inputs, step: u32, mut check: impl FnMut(usize, f32)) {
    with_simulator(file, 128, |simulator| {
        simulator.observe_poses(seconds(step), inputs.posed()).unwrap();
        for _ in 0..200 {
            simulator.step().unwrap();
            simulator.units().enumerate().for_each(|(number, unit)| check(number, lowest(&unit)));
        }
    });
}

#[test]
fn falling_boxes_stay_above() {
    // The second one's weights are random: it knows nothing of the ground.
    for (name, file) in
        [("edge", AlignedBuffer::copy_of(EDGE)), ("tiny-impact", packed_model("tiny-impact"))]
    {
        for (seed, step) in [(1, 1), (2, 5), (3, 10)] {
            let inputs = boxes(&mut Random(seed), 6, 0.2);
            let mut deepest = 0.0_f32;
            roll(&file, &inputs, step, |_, height| deepest = deepest.min(height));
            assert!(deepest > -1e-4, "{name}, step {step}: {deepest} m");
        }
    }
}

/// Points observed below the ground are not thrown out of it: that would be a velocity.
#[test]
fn boxes_seen_below_go_no_deeper_and_are_not_thrown_out() {
    let file = AlignedBuffer::copy_of(EDGE);
    for step in [1, 5, 10] {
        let inputs = boxes(&mut Random(4), 6, -0.03);
        roll(&file, &inputs, step, |unit, height| {
            assert!(height > -0.0301, "step {step}, unit {unit}: {height} m");
            assert!(height < 0.5, "step {step}, unit {unit}: {height} m");
        });
    }
}
