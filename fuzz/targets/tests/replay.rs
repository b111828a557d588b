//! Every input that fuzzing keeps, and a change of each, through what its target does with it. `cargo xtask fuzz` makes new ones.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use rigidformer_fuzz_targets as targets;
use rigidformer_tests::Random;
use std::fs::File;
use std::io::Read;
use std::path::{Path, PathBuf};
use zip::ZipArchive;

fn folder(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("..").join(name)
}

/// The sound inputs of a target that fuzzing begins with, and those that it kept.
fn inputs(target: &str) -> Vec<Vec<u8>> {
    let mut inputs = Vec::new();
    if let Ok(seeds) = std::fs::read_dir(folder("seeds").join(target)) {
        let mut seeds: Vec<PathBuf> = seeds.map(|entry| entry.unwrap().path()).collect();
        seeds.sort();
        inputs.extend(seeds.iter().map(|seed| std::fs::read(seed).unwrap()));
    }
    let kept = File::open(folder("corpus").join(format!("{target}.zip"))).unwrap();
    let mut kept = ZipArchive::new(kept).unwrap();
    for index in 0..kept.len() {
        let mut input = Vec::new();
        kept.by_index(index).unwrap().read_to_end(&mut input).unwrap();
        inputs.push(input);
    }
    inputs
}

/// The stack of a main thread, on which libFuzzer runs targets. Tests have a quarter of it.
const STACK: usize = 8 << 20;

fn replay(target: &'static str, run: fn(&[u8])) {
    let replayed = std::thread::Builder::new().stack_size(STACK).spawn(move || {
        let inputs = inputs(target);
        assert!(inputs.len() > 100, "{target} keeps {} inputs", inputs.len());
        let mut random = Random(1);
        for mut input in inputs {
            run(&input);
            for _ in 0..3 {
                let at = random.bits() as usize % input.len().max(1);
                if let Some(byte) = input.get_mut(at) {
                    *byte = random.bits() as u8;
                }
            }
            run(&input);
        }
    });
    assert!(replayed.unwrap().join().is_ok(), "{target} found something");
}

macro_rules! replays {
    ($($target:ident)*) => {
        $(#[test]
        fn $target() {
            replay(stringify!($target), targets::$target::run);
        })*
    };
}

replays! { c_calls export_file model_file observe_step scene_file soft_step }

#[cfg(feature = "files")]
replays! { recording trace_file }

#[cfg(feature = "program")]
replays! { own_files }

#[test]
fn every_target_is_replayed() {
    let mut kept = Vec::new();
    for entry in std::fs::read_dir(folder("fuzz_targets")).unwrap() {
        kept.push(entry.unwrap().path().file_stem().unwrap().to_str().unwrap().to_owned());
    }
    kept.sort();
    let text = include_str!("replay.rs");
    let listed =
        text.lines().filter_map(|line| line.strip_prefix("replays! { ")?.strip_suffix(" }"));
    let mut listed: Vec<&str> = listed.flat_map(|names| names.split(' ')).collect();
    listed.sort();
    assert_eq!(kept, listed);
}
