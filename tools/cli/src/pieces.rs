//! `rigidformer pieces`

use std::fmt::Write;
use std::panic;
use std::path::Path;

use nalgebra::Point3;
use parry3d::math::Vector;
use parry3d::transformation::vhacd::{VHACD, VHACDParameters};
use rigidformer_evaluation::convex_pieces::ConvexPieces;
use rigidformer_runtime::files;
use rigidformer_runtime::hull::ConvexHull;
use rigidformer_runtime::memory::Budget;
use serde_json::json;
use tobj::LoadOptions;

use crate::arguments::{PieceFormat, PieceSource, Pieces};
use crate::{interrupt, output};

/// A mesh whose hull is larger by no more than this is one piece.
const CONVEX: f64 = 1.01;

/// Bytes that a byte of a mesh's file takes in memory.
// A group with a face, `g\nf 1 1 1\n`, has ten bytes and takes about 300 as a model of the reader.
const MESH_GROWTH: u64 = 30;
/// Groups that become pieces, at most: the time grows with their square.
const MOST_GROUPS: usize = 512;

/// A closed mesh.
struct Mesh {
    points: Vec<Point3<f32>>,
    triangles: Vec<[u32; 3]>,
}

pub(crate) fn run(arguments: &Pieces) -> anyhow::Result<()> {
    interrupt::watch();
    if let Some(out) = &arguments.out {
        output::apart("--out", out, [arguments.mesh.as_path()])?;
    }
    let groups = read(&arguments.mesh, arguments.scale)?;
    let number = groups.len();
    anyhow::ensure!(
        number <= MOST_GROUPS || arguments.split == PieceSource::Vhacd,
        "{}: has {number} groups, more than {MOST_GROUPS}; join some, or give --split vhacd",
        arguments.mesh.display()
    );
    let groups_decide = match arguments.split {
        PieceSource::Groups => true,
        PieceSource::Vhacd => false,
        PieceSource::Auto => groups.len() > 1,
    };
    let found = if groups_decide {
        solid(groups)
    } else {
        decompose(&arguments.mesh, &joined(groups), arguments)?
    };
    let pieces = ConvexPieces::merged(found, usize::from(arguments.most));
    let pieces = pieces.thinned(usize::from(arguments.points));
    let all: Vec<_> = pieces.points().to_vec();
    let hull = ConvexPieces::merged(vec![all], 1);
    anyhow::ensure!(
        hull.volume_m3() > 0.0,
        "{}: its points lie in one plane; give a mesh that encloses a volume",
        arguments.mesh.display()
    );
    let text = match arguments.format {
        PieceFormat::Json => json_text(&pieces)?,
        PieceFormat::Rust => rust_text(&arguments.mesh, &pieces)?,
        PieceFormat::C => c_text(&arguments.mesh, &pieces)?,
    };
    match &arguments.out {
        Some(out) => output::write_whole(out, text.as_bytes())?,
        None => output::data(text.trim_end())?,
    }
    output::note(&format!(
        "{} of {} points, {:.3} of the volume of their hull; the unit takes {} of Limits::points",
        if pieces.len() == 1 {
            "1 convex piece".to_owned()
        } else {
            format!("{} convex pieces", pieces.len())
        },
        pieces.points().len(),
        pieces.volume_m3() / hull.volume_m3(),
        pieces.points().len() + 2 * pieces.len(),
    ));
    Ok(())
}

/// Points of the groups that enclose a volume; of no others can a unit have pieces.
fn solid(groups: Vec<Mesh>) -> Vec<Vec<Point3<f32>>> {
    let number = groups.len();
    let solid: Vec<_> = groups
        .into_iter()
        .map(|group| group.points)
        .filter(|points| ConvexHull::new(points).is_some())
        .collect();
    let flat = number - solid.len();
    if flat > 0 {
        output::note(&format!("{flat} of {number} groups lie in one plane, and are left out"));
    }
    solid
}

/// The groups of an OBJ file, at least one; each has its own points.
fn read(path: &Path, scale: f32) -> anyhow::Result<Vec<Mesh>> {
    let text = files::read_whole(path)?;
    Budget::default().take((text.len() as u64).saturating_mul(MESH_GROWTH)).map_err(|large| {
        anyhow::anyhow!(
            "{}: {large}; thin the mesh out, or allow more with --memory",
            path.display()
        )
    })?;
    let options = LoadOptions { triangulate: true, single_index: true, ..LoadOptions::default() };
    let loaded = tobj::load_obj_buf(&mut &text[..], &options, |_| {
        // Materials say nothing of a shape.
        Ok((Vec::new(), Default::default()))
    });
    let (models, _) = loaded.map_err(|error| {
        anyhow::anyhow!(
            "{}: is no Wavefront OBJ mesh ({}); export it as OBJ",
            path.display(),
            files::shown(&error.to_string(), 80)
        )
    })?;
    let mut groups = Vec::new();
    for model in models {
        let (coordinates, _) = model.mesh.positions.as_chunks::<3>();
        let points: Vec<_> = coordinates.iter().map(|p| Point3::from(*p) * scale).collect();
        let triangles = model.mesh.indices.as_chunks::<3>().0.to_vec();
        let number = points.len() as u32;
        anyhow::ensure!(
            triangles.iter().flatten().all(|corner| *corner < number)
                && points.iter().flat_map(|point| point.iter()).all(|v| v.is_finite()),
            "{}: group {:?} has a corner that is not finite, or a face with a corner that is not there; export the mesh \
             again",
            path.display(),
            files::shown(&model.name, 80)
        );
        if !triangles.is_empty() {
            groups.push(Mesh { points, triangles });
        }
    }
    anyhow::ensure!(
        !groups.is_empty(),
        "{}: has no faces; export the mesh with its faces",
        path.display()
    );
    Ok(groups)
}

/// One mesh of all groups.
fn joined(groups: Vec<Mesh>) -> Mesh {
    let mut all = Mesh { points: Vec::new(), triangles: Vec::new() };
    for group in groups {
        let first = all.points.len() as u32;
        all.points.extend(group.points);
        all.triangles.extend(group.triangles.iter().map(|face| face.map(|corner| corner + first)));
    }
    all
}

/// Points of the convex parts of a mesh, by V-HACD; of a mesh that is nearly convex, its own.
fn decompose(
    path: &Path,
    mesh: &Mesh,
    arguments: &Pieces,
) -> anyhow::Result<Vec<Vec<Point3<f32>>>> {
    let Mesh { points, triangles } = mesh;
    let hull = ConvexPieces::merged(vec![points.clone()], 1).volume_m3();
    anyhow::ensure!(
        ConvexHull::new(points).is_some(),
        "{}: its points lie in one plane; give a mesh that encloses a volume",
        path.display()
    );
    if arguments.split == PieceSource::Auto && hull < CONVEX * enclosed(mesh) {
        return Ok(vec![points.clone()]);
    }
    // V-HACD counts in lengths of about one.
    let first = points[0];
    let size = points.iter().map(|point| (point - first).amax()).fold(0.0, f32::max);
    let unit = |point: &Point3<f32>| {
        let [x, y, z] = ((point - first) / size).into();
        Vector::new(x, y, z)
    };
    let vertices: Vec<Vector> = points.iter().map(unit).collect();
    let parameters = VHACDParameters {
        resolution: arguments.resolution,
        max_convex_hulls: 64,
        ..VHACDParameters::default()
    };
    // What the library does not expect of a mesh ends in a panic there.
    let found = quietly(|| {
        VHACD::decompose(&parameters, &vertices, triangles, true)
            .compute_exact_convex_hulls(&vertices, triangles)
    });
    let back = |v: &Vector| first + nalgebra::Vector3::new(v.x, v.y, v.z) * size;
    let parts: Vec<Vec<Point3<f32>>> = found
        .unwrap_or_default()
        .iter()
        .map(|(corners, _)| corners.iter().map(back).collect())
        .filter(|corners: &Vec<Point3<f32>>| ConvexHull::new(corners).is_some())
        .collect();
    anyhow::ensure!(
        !parts.is_empty(),
        "{}: V-HACD found no parts; the mesh must be closed and its faces whole: mend it in a mesh editor, or give a \
         mesh of convex groups with --split groups",
        path.display()
    );
    Ok(parts)
}

/// What a call gives, none where it panics; the panic's text is not shown.
fn quietly<T>(call: impl FnOnce() -> T) -> Option<T> {
    let hook = panic::take_hook();
    panic::set_hook(Box::new(|_| {}));
    let found = panic::catch_unwind(panic::AssertUnwindSafe(call));
    panic::set_hook(hook);
    found.ok()
}

/// Volume within a closed mesh, m^3.
fn enclosed(mesh: &Mesh) -> f64 {
    let Some(first) = mesh.points.first() else { return 0.0 };
    let corner =
        |corner: u32| -> nalgebra::Vector3<f64> { (mesh.points[corner as usize] - first).cast() };
    let parts = mesh.triangles.iter().map(|face| {
        let [a, b, c] = face.map(corner);
        a.dot(&b.cross(&c)) / 6.0
    });
    parts.sum::<f64>().abs()
}

fn json_text(pieces: &ConvexPieces) -> anyhow::Result<String> {
    let piece = |points: &[Point3<f32>]| points.iter().map(|p| [p.x, p.y, p.z]).collect::<Vec<_>>();
    let pieces: Vec<_> = pieces.iter().map(piece).collect();
    Ok(serde_json::to_string(&json!({ "pieces": pieces }))? + "\n")
}

fn rust_text(mesh: &Path, pieces: &ConvexPieces) -> anyhow::Result<String> {
    let mut text = String::new();
    let name = name_of(mesh);
    let (points, counts) = (pieces.points(), pieces.counts());
    writeln!(text, "/// Convex pieces of {name}, metres: `Pieces::new(&POINTS, &COUNTS)`.")?;
    writeln!(text, "pub const POINTS: [nalgebra::Point3<f32>; {}] = [", points.len())?;
    for p in points {
        writeln!(text, "    nalgebra::Point3::new({:?}, {:?}, {:?}),", p.x, p.y, p.z)?;
    }
    writeln!(
        text,
        "];\n/// Points of each.\npub const COUNTS: [u16; {}] = {counts:?};",
        counts.len()
    )?;
    Ok(text)
}

fn c_text(mesh: &Path, pieces: &ConvexPieces) -> anyhow::Result<String> {
    let mut text = String::new();
    let name = name_of(mesh);
    let counts: Vec<String> = pieces.counts().iter().map(u16::to_string).collect();
    writeln!(
        text,
        "/* Convex pieces of {name}, metres: piece_points, piece_counts and piece_count of rf_unit. */\n#include <stdint.h>"
    )?;
    writeln!(text, "static const float piece_points[{}][3] = {{", pieces.points().len())?;
    for p in pieces.points() {
        writeln!(text, "    {{{:?}f, {:?}f, {:?}f}},", p.x, p.y, p.z)?;
    }
    writeln!(
        text,
        "}};\nstatic const uint16_t piece_counts[{}] = {{{}}};",
        counts.len(),
        counts.join(", ")
    )?;
    Ok(text)
}

/// A file's name, fit for a comment.
fn name_of(mesh: &Path) -> String {
    let name = mesh.file_name().unwrap_or_default().to_string_lossy();
    name.chars().filter(|c| c.is_alphanumeric() || ". -_".contains(*c)).collect()
}
