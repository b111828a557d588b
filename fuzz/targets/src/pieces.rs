//! Meshes through `pieces`, which decomposes them by V-HACD: a failed command leaves no file.

use crate::files::{command, folder, written};
use crate::structured::structured;
use arbitrary::Arbitrary;
use std::fmt::Write;

/// A mesh: boxes, and then whatever corners and faces.
#[derive(Arbitrary, Debug)]
struct Mesh {
    boxes: Vec<([i8; 3], [u8; 3])>,
    corners: Vec<[i16; 3]>,
    faces: Vec<[u8; 3]>,
    wrong: Option<u8>,
    exponent: i8,
}

/// Faces of a box whose corners have x in bit 0, y in bit 1 and z in bit 2.
const FACES: [[usize; 4]; 6] =
    [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]];

impl Mesh {
    fn text(&self) -> String {
        let mut text = String::new();
        let scale = 10_f64.powi(i32::from(self.exponent / 4));
        let mut corner = |p: [f64; 3]| {
            let _ = writeln!(text, "v {} {} {}", p[0] * scale, p[1] * scale, p[2] * scale);
        };
        let boxes = &self.boxes[..self.boxes.len().min(6)];
        for (place, size) in boxes {
            for bits in 0..8 {
                corner(std::array::from_fn(|axis| {
                    let side = if bits >> axis & 1 == 1 { size[axis] } else { 0 };
                    f64::from(place[axis]) + f64::from(side)
                }));
            }
        }
        for row in self.corners.iter().take(64) {
            corner(row.map(f64::from));
        }
        if let Some(wrong) = self.wrong {
            let words = ["nan", "inf", "1e39", "-1e38", "1e-45", "0"];
            let _ = writeln!(text, "v {} 0 0", words[usize::from(wrong) % words.len()]);
        }
        for first in (0..boxes.len()).map(|number| 8 * number + 1) {
            for face in FACES {
                let [a, b, c, d] = face.map(|corner| corner + first);
                let _ = writeln!(text, "f {a} {b} {c} {d}");
            }
        }
        for [a, b, c] in self.faces.iter().take(128) {
            let _ = writeln!(text, "f {a} {b} {c}");
        }
        text
    }
}

/// Handles an input.
pub fn run(data: &[u8]) {
    let Some((kind, rest)) = data.split_first() else { return };
    // Of files as they are there are three formats; what is made here is OBJ.
    let mut name = "mesh.obj";
    let mesh = match kind % 4 {
        0 => {
            name = ["mesh.obj", "mesh.obj", "mesh.stl", "mesh.dae"][usize::from(kind >> 6)];
            rest.to_vec()
        }
        _ => match structured::<Mesh>(rest) {
            Some(mesh) => mesh.text().into_bytes(),
            None => return,
        },
    };
    let out = folder().join("pieces.json");
    let _ = std::fs::remove_file(&out);
    let resolution = if kind & 16 == 0 { "8" } else { "20" };
    let words = ["pieces", "--split", "vhacd", "--resolution", resolution];
    let done = command(&words, &[("--out", &out), ("", &written(name, &mesh))]);
    assert_eq!(done.is_ok(), out.exists(), "{done:?}");
}
