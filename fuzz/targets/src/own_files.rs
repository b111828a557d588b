//! Files that people bring: poses in CSV, npz and MCAP, points in CSV, meshes in OBJ. A command that fails must leave no file, and
//! what it writes must open.

use crate::files::{folder, mcap, parts, written};
use rigidformer_evaluation::scenes::Dataset;
use std::io::{Cursor, Write};
use std::path::Path;
use zip::write::SimpleFileOptions;

/// A sound archive around arrays of unknown quality.
fn npz(data: &[u8]) -> Vec<u8> {
    let mut archive = zip::ZipWriter::new(Cursor::new(Vec::new()));
    let options = SimpleFileOptions::default().compression_method(zip::CompressionMethod::Stored);
    let names = ["poses.npy", "time.npy", "fps.npy", "points_a.npy"];
    for (name, array) in names.iter().zip(parts(data, 3)) {
        // An array that is left out.
        if array.is_empty() {
            continue;
        }
        archive.start_file(*name, options).expect("memory");
        archive.write_all(array).expect("memory");
    }
    archive.finish().expect("memory").into_inner()
}

fn import(recording: &Path, more: &[&str]) {
    let out = folder().join("imported.safetensors");
    let _ = std::fs::remove_file(&out);
    let words = ["rigidformer", "import"].map(Into::into);
    let named = [recording.into(), "--out".into(), out.as_os_str().to_owned()];
    let line = words.into_iter().chain(named).chain(more.iter().map(Into::into));
    match rigidformer_cli::run(line) {
        Ok(()) => {
            let dataset = Dataset::open(&out).expect("what was written opens");
            assert_eq!(dataset.len(), 1);
        }
        Err(error) => {
            assert!(!error.is::<clap::Error>(), "the target's own command line: {error}");
            assert!(!out.exists(), "left a file: {error:#}");
        }
    }
}

/// Handles an input.
pub fn run(data: &[u8]) {
    let Some((kind, rest)) = data.split_first() else { return };
    // What the commands say would hide what tests and fuzzers say.
    rigidformer_cli::silence();
    let boxes = ["--box", "*=0.1,0.2,0.3"];
    match kind % 10 {
        0 | 1 => import(&written("poses.csv", rest), &boxes),
        2 => import(
            &written("poses.csv", rest),
            &["--sphere", "*=0.1", "--fps", "60", "--open-loop"],
        ),
        3 => {
            let poses = b"time_s,unit,x,y,z,qw,qx,qy,qz\n0,a,0,0,1,1,0,0,0\n.1,a,0,0,1,1,0,0,0\n.2,a,0,0,1,1,0,0,0\n";
            let points = written("points.csv", rest);
            let points = points.to_str().expect("a plain name");
            import(&written("poses.csv", poses), &["--points", points]);
        }
        4 => import(&written("poses.npz", rest), &boxes),
        5 => import(&written("poses.npz", &npz(rest)), &boxes),
        6 => import(&written("poses.npz", &npz(rest)), &[]),
        7 | 8 => import(&written("poses.mcap", &mcap(rest)), &boxes),
        _ => {
            let mesh = written("mesh.obj", rest);
            let out = folder().join("pieces.json");
            let _ = std::fs::remove_file(&out);
            let words = ["rigidformer", "pieces", "--split", "groups", "--out"].map(Into::into);
            let line = words.into_iter().chain([out.as_os_str().to_owned(), mesh.into()]);
            let done = rigidformer_cli::run(line);
            assert_eq!(done.is_ok(), out.exists(), "{done:?}");
        }
    }
}
