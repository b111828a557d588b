//! Recordings of sensors of unknown quality: clouds, depth images with their list, MCAP files. All captures are read.

use crate::files::{Packing, folder, mcap, packed_mcap, parts, repair_png, written};
use rigidformer_perception::capture::View;
use rigidformer_perception::recording;
use std::path::Path;

fn read(path: &Path) {
    if let Ok(captures) = recording::open_at(path, 30.0) {
        follow(captures);
    }
}

/// From a file, and as a pipe gives it.
fn read_both(path: &Path) {
    read(path);
    let Ok(file) = std::fs::File::open(path) else { return };
    if let Ok(captures) = recording::stream(file, &recording::Options::default()) {
        follow(captures);
    }
}

fn follow(captures: recording::Captures) {
    let mut last_s = f64::NEG_INFINITY;
    for capture in captures.take(64).flatten() {
        assert!(capture.time_s.is_finite() && capture.time_s >= last_s, "time ran back");
        last_s = capture.time_s;
        for view in &capture.views {
            if let View::Cloud(cloud) = view {
                let mut numbers = cloud.points.iter().flat_map(|point| point.iter());
                assert!(numbers.all(|number| number.is_finite()), "a point that is not finite");
            }
        }
    }
}

/// Handles an input.
pub fn run(data: &[u8]) {
    let Some((kind, rest)) = data.split_first() else { return };
    let packing = [None, Some(Packing::Zstd), Some(Packing::Lz4)][usize::from(kind / 8) % 3];
    match kind % 8 {
        0 => read(&written("cloud.ply", &[b"ply".as_slice(), rest].concat())),
        1 => read(&written("cloud.pcd", rest)),
        kind @ 2..=4 if let Some(packing) = packing => {
            read_both(&written("drive.mcap", &packed_mcap(rest, packing, kind == 2)));
        }
        2 => read_both(&written("drive.mcap", &[b"\x89MCAP0\r\n".as_slice(), rest].concat())),
        3 | 4 => read_both(&written("drive.mcap", &mcap(rest))),
        // A folder: its list, then one image for all names.
        list => {
            let place = folder().join(if list == 5 { "clouds" } else { "depth" });
            std::fs::create_dir_all(&place).expect("a folder");
            let [list, image] = parts(rest, 1)[..] else { return };
            let mut image = image.to_vec();
            if kind % 8 == 7 {
                repair_png(&mut image);
            }
            for name in ["a.png", "b.png", "a.ply", "b.pcd"] {
                std::fs::write(place.join(name), &image).expect("room");
            }
            std::fs::write(place.join("frames.json"), list).expect("room");
            read(&place);
        }
    }
}
