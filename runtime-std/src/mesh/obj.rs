//! Wavefront OBJ, by tobj. mesh-loader's reader gives up where a name is missing, and knows no continued lines either.

use nalgebra::Point3;
use tobj::LoadOptions;

use super::error::MeshError;
use super::triangles::{Group, TriangleMesh};

pub(super) fn read(bytes: &[u8]) -> Result<Vec<Group>, MeshError> {
    let text = prepared(bytes);
    let options = LoadOptions { triangulate: true, single_index: true, ..LoadOptions::default() };
    let loaded =
        tobj::load_obj_buf(&mut &text[..], &options, |_| Ok((Vec::new(), Default::default())));
    let (models, _) = loaded.map_err(|error| MeshError::broken("Wavefront OBJ", error))?;
    let groups = models.into_iter().map(|model| Group {
        name: model.name,
        mesh: TriangleMesh {
            points: model
                .mesh
                .positions
                .as_chunks::<3>()
                .0
                .iter()
                .map(|p| Point3::from(*p))
                .collect(),
            triangles: model.mesh.indices.as_chunks::<3>().0.to_vec(),
        },
    });
    Ok(groups.collect())
}

/// The text as tobj takes it: with continued lines joined, and without materials, which say nothing of a shape and may lack a name.
fn prepared(bytes: &[u8]) -> Vec<u8> {
    let mut text = Vec::with_capacity(bytes.len() + 1);
    let mut is_continued = false;
    for line in bytes.split(|byte| *byte == b'\n') {
        let line = line.strip_suffix(b"\r").unwrap_or(line);
        let word = line.trim_ascii_start();
        if !is_continued && [&b"usemtl"[..], b"mtllib"].iter().any(|name| word.starts_with(name)) {
            continue;
        }
        let continued = line.trim_ascii_end().strip_suffix(b"\\");
        is_continued = continued.is_some();
        text.extend_from_slice(continued.unwrap_or(line));
        text.push(if is_continued { b' ' } else { b'\n' });
    }
    text
}
