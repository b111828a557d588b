//! STL, by mesh-loader.

use nalgebra::Point3;

use super::error::MeshError;
use super::triangles::{Group, TriangleMesh};

/// Bytes before the number of triangles in a binary file.
const HEADER: usize = 80;
/// Bytes of a binary triangle.
const TRIANGLE: u64 = 50;

pub(super) fn read(bytes: &[u8]) -> Result<Vec<Group>, MeshError> {
    let broken = |problem: String| MeshError::broken("STL", problem);
    let scene = match is_text(bytes) {
        // The reader takes ASCII in lower case alone, and a name, if an empty one, after `solid`.
        true => {
            let mut text = bytes.to_ascii_lowercase();
            text.iter_mut().filter(|byte| !byte.is_ascii()).for_each(|byte| *byte = b'?');
            mesh_loader::stl::from_slice(&named(&text))
        }
        false => mesh_loader::stl::from_slice(&binary(bytes)?),
    };
    let scene = scene.map_err(|error| broken(error.to_string()))?;
    let groups = scene.meshes.into_iter().map(|mesh| Group {
        name: mesh.name,
        mesh: TriangleMesh {
            points: mesh.vertices.into_iter().map(Point3::from).collect(),
            triangles: mesh.faces,
        },
    });
    Ok(groups.collect())
}

/// Solids of a file, at most: each ends with its word.
pub(super) fn solids(bytes: &[u8]) -> u64 {
    let words = bytes.windows(b"endsolid".len());
    words.filter(|word| word.eq_ignore_ascii_case(b"endsolid")).count() as u64
}

/// Whether a file is text: it begins so and has a face or nothing. Some programs begin binary files with `solid` too.
fn is_text(bytes: &[u8]) -> bool {
    let count = bytes.get(HEADER..HEADER + 4).and_then(|said| said.try_into().ok());
    let is_binary = count.is_some_and(|said| {
        let triangles = u64::from(u32::from_le_bytes(said));
        (HEADER as u64 + 4) + triangles * TRIANGLE == bytes.len() as u64
    });
    let has = |word: &[u8]| bytes.windows(word.len()).any(|at| at.eq_ignore_ascii_case(word));
    starts_solid(bytes) && !is_binary && (bytes.is_ascii() || has(b"facet") && has(b"vertex"))
}

fn starts_solid(bytes: &[u8]) -> bool {
    let word = bytes.trim_ascii_start().get(..5);
    word.is_some_and(|word| word.eq_ignore_ascii_case(b"solid"))
}

/// The text with a space after each `solid` that ends its line.
fn named(text: &[u8]) -> Vec<u8> {
    let mut named = Vec::with_capacity(text.len() + 1);
    for line in text.split_inclusive(|byte| *byte == b'\n') {
        let word = line.trim_ascii();
        named.extend_from_slice(if word == b"solid" { b"solid \n" } else { line });
    }
    named
}

/// A binary file as the reader takes it: it counts the triangles that are there, and takes those that begin with `solid` for text
/// where bytes follow the last triangle.
fn binary(bytes: &[u8]) -> Result<Vec<u8>, MeshError> {
    let Some(said) = bytes.get(HEADER..HEADER + 4).and_then(|said| said.try_into().ok()) else {
        return Err(MeshError::broken("STL", "it has no header"));
    };
    let said = u64::from(u32::from_le_bytes(said));
    let found = (bytes.len() - HEADER - 4) as u64 / TRIANGLE;
    if found < said {
        return Err(MeshError::CutOff { found, said });
    }
    let mut whole = bytes.to_vec();
    whole.truncate(HEADER + 4 + (said * TRIANGLE) as usize);
    // What a header says besides is for people.
    whole.iter_mut().take(HEADER).for_each(|byte| *byte = b' ');
    Ok(whole)
}
