//! Models and scene files of unknown quality, through `inspect` and through the files for viewers: what is written can be read again.

use crate::files::{command, folder, model_file, written};
use rigidformer_perception::recording;

/// Handles an input.
pub fn run(data: &[u8]) {
    let Some((kind, rest)) = data.split_first() else { return };
    let words: &[&str] = if kind & 8 == 0 { &["inspect"] } else { &["inspect", "--json"] };
    match kind % 4 {
        0 => drop(command(words, &[("", &written("model.rfm", rest))])),
        1 => drop(command(words, &[("", &written("scene.safetensors", rest))])),
        _ => {
            let (scene, model) = (written("scene.safetensors", rest), model_file());
            let [mcap, glb, html] = ["s.mcap", "s.glb", "s.html"].map(|name| folder().join(name));
            for file in [&mcap, &glb, &html] {
                let _ = std::fs::remove_file(file);
            }
            let out = folder().join("rollout");
            let named = [
                ("--model", &model),
                ("--mcap", &mcap),
                ("--gltf", &glb),
                ("--html", &html),
                ("--out", &out),
                ("", &scene),
            ];
            let done = command(&["rollout", "--frames", "4", "--step", "2", "--show", "2"], &named);
            if done.is_ok() {
                recording::poses(&mcap).expect("poses of what was written");
                let glb = std::fs::read(glb).expect("a file");
                assert!(glb.starts_with(b"glTF") && html.exists());
            }
        }
    }
}
