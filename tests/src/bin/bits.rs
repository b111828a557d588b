//! Prints a line a model: its name and a hash over the bits of a 100-step rollout.
//!
//! `bits` packs and rolls out the models of `tests/data`, some of them also on the fastest kernels of
//! the processor; `bits tiny-i8.rfm ...` rolls out packed
//! files, each in the scene that its name begins with; `bits --pack FOLDER` writes those files.
#![allow(clippy::expect_used)]

use rigidformer_runtime::engine::Engine;
use rigidformer_tests::bits::{models, rollout, rollout_on};
use rigidformer_weights::AlignedBuffer;
use std::path::Path;

fn main() {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    match arguments.as_slice() {
        [] => {
            let engine = Engine::new().expect("a kernel of this processor").single();
            for (name, file) in models() {
                let outcome = rollout(&name, &file);
                println!("{outcome}");
                // What the runtime would run here; an emulator needs its time for each.
                if name.starts_with("tiny-paper-inputs") {
                    assert_eq!(
                        rollout_on(engine, 2, &name, &file),
                        [(); 2].map(|()| outcome.clone())
                    );
                }
            }
        }
        [option, folder] if option == "--pack" => {
            for (name, file) in models() {
                let path = Path::new(folder).join(name).with_extension("rfm");
                std::fs::write(path, &*file).expect("the folder can be written");
            }
        }
        files => {
            for path in files {
                let file = AlignedBuffer::read(path.as_ref()).expect("the file can be read");
                let name = Path::new(path).file_stem().and_then(|name| name.to_str());
                println!("{}", rollout(name.expect("a name in UTF-8"), &file));
            }
        }
    }
}
