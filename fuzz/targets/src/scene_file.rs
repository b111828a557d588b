//! Scene files of unknown quality: what opens gives every scene, or says why not.

use rigidformer_evaluation::scenes::Dataset;

/// Handles an input.
pub fn run(data: &[u8]) {
    let Ok(dataset) = Dataset::from_bytes("fuzzed", data.to_vec()) else { return };
    // A few bytes can claim many scenes that share what they are of.
    for index in 0..dataset.len().min(8) {
        for frames in [None, Some(1), Some(3), Some(usize::MAX)] {
            let Ok(scene) = dataset.scene(index, frames) else { continue };
            assert!(scene.frames() >= 1, "a scene without a frame");
            let frames = scene.frames();
            for frame in [0, frames / 2, frames - 1] {
                let poses = scene.poses_at(frame).expect("a frame that is there");
                assert_eq!(poses.len(), scene.units().len());
                let mut numbers = poses.iter().flat_map(|pose| {
                    pose.translation
                        .vector
                        .iter()
                        .chain(pose.rotation.coords.iter())
                        .copied()
                        .collect::<Vec<_>>()
                });
                assert!(numbers.all(f32::is_finite), "a pose that is not finite was read");
            }
        }
    }
}
