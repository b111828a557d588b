//! Scene files of unknown quality, through `identify`: a result, or an error.

use crate::files::{command, model_file, written};

/// Handles an input.
pub fn run(data: &[u8]) {
    let Some((kind, rest)) = data.split_first() else { return };
    let (scene, model) = (written("scene.safetensors", rest), model_file());
    let mut words = vec!["identify", "--particles", "16", "--limit", "1", "--split", "test"];
    if kind & 1 == 0 {
        words.truncate(3);
        words.extend(["--index", "0"]);
    }
    if kind & 2 == 0 {
        words.extend(["--noise-mm", "0.5", "--noise-mrad", "10"]);
    }
    if kind & 4 == 0 {
        words.push("--json");
    }
    let _ = command(&words, &[("--model", &model), ("", &scene)]);
}
