//! Meshes of bodies: Wavefront OBJ, STL and COLLADA; whether they are closed and convex, and what they weigh.
//!
//! ```
//! use nalgebra::Point3;
//! use rigidformer_runtime::memory::Budget;
//! use rigidformer_runtime::mesh::{Format, TriangleMesh, read};
//! let cube = "v 0 0 0\nv 0 0 1\nv 0 1 0\nv 0 1 1\nv 1 0 0\nv 1 0 1\nv 1 1 0\nv 1 1 1\n\
//!             f 1 2 4 3\nf 5 7 8 6\nf 1 5 6 2\nf 3 4 8 7\nf 1 3 7 5\nf 2 6 8 4\n";
//! let groups = read(cube.as_bytes(), Format::Obj, &mut Budget::default())?;
//! let mesh = TriangleMesh::joined(groups.into_iter().map(|group| group.mesh)).scaled(0.1);
//! let mass = mesh.mass_properties().ok_or("not closed")?;
//! assert!((mass.volume_m3 - 1e-3).abs() < 1e-9);
//! assert!((mass.centre_m - Point3::new(0.05, 0.05, 0.05)).norm() < 1e-6);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod collada;
mod error;
mod mass;
mod obj;
mod orient;
mod stl;
mod triangles;

use std::path::Path;

use rigidformer_core::kernels::in_own_environment;

use crate::memory::Budget;

pub use error::MeshError;
pub use mass::MassProperties;
pub use triangles::{Group, TriangleMesh};

/// Bytes that a byte of an OBJ file takes in memory.
// A group with a face, `g\nf 1 1 1\n`, has ten bytes and takes about 300 as a model of the reader.
const OBJ_GROWTH: u64 = 30;
/// Bytes that a byte of an STL file takes in memory.
// A binary triangle has 50 bytes, takes 84 with its normals as the reader gives it, 48 as a group, and as much again for each step of
// welding and taking apart.
const STL_GROWTH: u64 = 12;
/// Bytes of an STL file's solid.
// Without faces it has 16 bytes in the file, and a mesh with a material of its own in a growing list.
const SOLID_BYTES: u64 = 2000;
/// Bytes that a byte, a tag and an attribute of a COLLADA file take in memory, without its faces.
// A number has two bytes, and takes 8 in a growing list. A tag makes two nodes of 72 bytes in a growing tree, with the text behind it.
const COLLADA_GROWTH: u64 = 8;
const TAG_BYTES: u64 = 300;
const ATTRIBUTE_BYTES: u64 = 130;

/// How a mesh is written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum Format {
    /// Wavefront OBJ.
    Obj,
    /// STL, in text or in binary.
    Stl,
    /// COLLADA.
    Collada,
}

impl Format {
    /// By the end of a file's name: `.stl` and `.dae`; others are taken for OBJ.
    pub fn of(path: &Path) -> Self {
        let end = path.extension().and_then(|end| end.to_str()).map(str::to_ascii_lowercase);
        match end.as_deref() {
            Some("stl") => Format::Stl,
            Some("dae") => Format::Collada,
            _ => Format::Obj,
        }
    }
}

/// The groups of a mesh's file that have faces, at least one, in the order of the file: groups and objects of OBJ, solids of STL,
/// geometries of COLLADA with the transforms of their nodes, in metres if the file tells its unit. Axes are those of the file.
///
/// # Errors
/// [`MeshError`]: what the file lacks.
pub fn read(bytes: &[u8], format: Format, budget: &mut Budget) -> Result<Vec<Group>, MeshError> {
    in_own_environment(|| read_here(bytes, format, budget))
}

fn read_here(bytes: &[u8], format: Format, budget: &mut Budget) -> Result<Vec<Group>, MeshError> {
    budget.take(room(bytes, format))?;
    let mut groups = match format {
        Format::Obj => obj::read(bytes)?,
        Format::Stl => stl::read(bytes)?,
        Format::Collada => collada::read(bytes, budget)?,
    };
    if let Some(group) = groups.iter().find(|group| !group.mesh.is_sound()) {
        return Err(MeshError::Corner { group: group.name.clone() });
    }
    groups.retain(|group| !group.mesh.triangles.is_empty());
    if groups.is_empty() { Err(MeshError::NoFaces) } else { Ok(groups) }
}

/// Bytes that reading takes in memory, at most.
fn room(bytes: &[u8], format: Format) -> u64 {
    let count = |wanted: u8| bytes.iter().filter(|byte| **byte == wanted).count() as u64;
    let times = |growth: u64| (bytes.len() as u64).saturating_mul(growth);
    match format {
        Format::Obj => times(OBJ_GROWTH),
        Format::Stl => times(STL_GROWTH).saturating_add(stl::solids(bytes) * SOLID_BYTES),
        Format::Collada => {
            times(COLLADA_GROWTH) + count(b'<') * TAG_BYTES + count(b'=') * ATTRIBUTE_BYTES
        }
    }
}

#[cfg(test)]
mod tests;
