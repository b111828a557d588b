//! Copies one scene of a scene file into a file of its own. The default scene of the `rigidformer` program is
//!
//! `cargo run -p rigidformer-evaluation --example extract_scene -- primitives.safetensors 259 121 default.safetensors`

use std::path::Path;

use rigidformer_evaluation::scenes::{Dataset, SceneNotes, write_scene};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let arguments: Vec<String> = std::env::args().collect();
    let [_, input, index, frames, output] = arguments.as_slice() else {
        return Err("usage: extract_scene IN INDEX FRAMES OUT".into());
    };
    let dataset = Dataset::open(Path::new(input))?;
    let scene = dataset.scene(index.parse()?, Some(frames.parse()?))?;
    let notes = SceneNotes {
        dataset: dataset.name().into(),
        provenance: dataset.provenance().into(),
        licence: dataset.licence().into(),
    };
    write_scene(Path::new(output), &scene, &notes)?;
    println!(
        "{output}: {}, {} units, {} frames",
        scene.name(),
        scene.units().len(),
        scene.frames()
    );
    Ok(())
}
