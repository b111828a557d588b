//! `rigidformer pieces`

use std::fmt::Write;
use std::path::Path;

use nalgebra::Point3;
use rigidformer_evaluation::convex_pieces::ConvexPieces;
use rigidformer_runtime::mesh::{Group, MassProperties, TriangleMesh};
use serde_json::json;

use crate::arguments::{PieceFormat, Pieces};
use crate::{decomposed, interrupt, meshes, output};

pub(crate) fn run(arguments: &Pieces) -> anyhow::Result<()> {
    interrupt::watch();
    if let Some(out) = &arguments.out {
        output::apart("--out", out, [arguments.mesh.as_path()])?;
    }
    let groups = meshes::read(&arguments.mesh, arguments.scale)?;
    let found =
        decomposed::pieces(&arguments.mesh, &groups, arguments.split, arguments.resolution)?;
    let pieces = ConvexPieces::merged(found, usize::from(arguments.most));
    let pieces = pieces.thinned(usize::from(arguments.points));
    let all: Vec<_> = pieces.points().to_vec();
    let hull = ConvexPieces::merged(vec![all], 1);
    anyhow::ensure!(
        hull.volume_m3() > 0.0,
        "{}: its points lie in one plane; give a mesh that encloses a volume",
        arguments.mesh.display()
    );
    let (mass, is_closed) = mass(groups, &pieces);
    let text = match arguments.format {
        PieceFormat::Json => json_text(&pieces, mass.as_ref(), is_closed)?,
        PieceFormat::Rust => rust_text(&arguments.mesh, &pieces)?,
        PieceFormat::C => c_text(&arguments.mesh, &pieces)?,
    };
    match &arguments.out {
        Some(out) => output::write_whole(out, text.as_bytes())?,
        None => output::data(text.trim_end())?,
    }
    if !is_closed {
        output::note(
            "the mesh is not closed: volume, centre of mass and inertia are those of its pieces",
        );
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

/// Mass properties of the mesh, or of its pieces where it is not closed; and whether it is closed.
fn mass(groups: Vec<Group>, pieces: &ConvexPieces) -> (Option<MassProperties>, bool) {
    let mesh = TriangleMesh::joined(groups.into_iter().map(|group| group.mesh));
    if let Some(mass) = mesh.mass_properties() {
        return (Some(mass), true);
    }
    let hulls = pieces.iter().filter_map(TriangleMesh::hull);
    (MassProperties::sum(hulls.filter_map(|hull| hull.mass_properties())), false)
}

fn json_text(
    pieces: &ConvexPieces,
    mass: Option<&MassProperties>,
    is_closed: bool,
) -> anyhow::Result<String> {
    let piece = |points: &[Point3<f32>]| points.iter().map(|p| [p.x, p.y, p.z]).collect::<Vec<_>>();
    let pieces: Vec<_> = pieces.iter().map(piece).collect();
    let rows = |mass: &MassProperties| {
        [0, 1, 2].map(|row| <[f64; 3]>::from(mass.inertia_m5.column(row).into_owned()))
    };
    let document = json!({
        "pieces": pieces,
        "closed": is_closed,
        "volume_m3": mass.map(|mass| mass.volume_m3),
        "centre_of_mass_m": mass.map(|mass| <[f64; 3]>::from(mass.centre_m)),
        "inertia_m5": mass.map(rows),
    });
    Ok(serde_json::to_string(&document)? + "\n")
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
