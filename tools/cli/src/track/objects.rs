//! Objects whose meshes are given, and masks.

use std::path::{Path, PathBuf};

use anyhow::Context;
use nalgebra::Point3;
use rigidformer_core::Role;
use rigidformer_evaluation::convex_pieces::ConvexPieces;
use rigidformer_evaluation::scenes::{RecordedScene, RecordedUnit};
use rigidformer_perception::capture::{Capture, View};
use rigidformer_perception::known::{KnownObject, ObjectError, ObjectMesh};
use rigidformer_perception::recording;
use rigidformer_runtime::mesh::{Group, MassProperties, TriangleMesh};

use crate::arguments::Track;
use crate::usage::Usage;
use crate::{meshes, output};

/// Pieces of an object, and points of a piece, at most.
const MOST_PIECES: usize = 8;
const MOST_POINTS: usize = 48;

/// The objects of `--object`.
pub(super) fn read(arguments: &Track, density_kg_m3: f32) -> anyhow::Result<Vec<KnownObject>> {
    let one = |text: &String| {
        let (path, mass_kg) = path_and_mass(text)?;
        object(&path, arguments.object_scale, mass_kg, density_kg_m3)
    };
    arguments.object.iter().map(one).collect()
}

/// Hulls of a scene's free units, with their true masses.
pub(super) fn of_scene(scene: &RecordedScene) -> anyhow::Result<Vec<KnownObject>> {
    let is_body = |unit: &&RecordedUnit| unit.role == Role::Free && unit.soft.is_none();
    let free = scene.units().iter().enumerate().filter(|(_, unit)| is_body(unit));
    free.map(|(number, unit)| {
        let what = || format!("unit {number}, {}", unit.shape);
        let hull =
            TriangleMesh::hull(&unit.points).with_context(|| format!("{}: is flat", what()))?;
        let mass =
            hull.mass_properties().with_context(|| format!("{}: encloses no volume", what()))?;
        let pieces: Vec<Vec<Point3<f32>>> = unit.pieces.iter().map(<[_]>::to_vec).collect();
        let name = format!("{}-{number}", unit.shape);
        known(&name, &hull, &pieces, &mass, f64::from(unit.physics.mass_kg)).with_context(what)
    })
    .collect()
}

/// `mug.obj` or `mug.obj=0.35`.
fn path_and_mass(text: &str) -> Result<(PathBuf, Option<f64>), Usage> {
    let Some((path, mass)) = text.rsplit_once('=').filter(|_| !Path::new(text).exists()) else {
        return Ok((text.into(), None));
    };
    let mass: Option<f64> = mass.parse().ok().filter(|mass| (1e-6..=1e6).contains(mass));
    match mass {
        Some(mass_kg) => Ok((path.into(), Some(mass_kg))),
        None => Err(Usage(format!("--object {text}: write FILE or FILE=KG, from 1e-6 to 1e6 kg"))),
    }
}

fn object(
    path: &Path,
    scale: f32,
    mass_kg: Option<f64>,
    density_kg_m3: f32,
) -> anyhow::Result<KnownObject> {
    let groups = meshes::read(path, scale)?;
    let pieces = pieces(path, &groups)?;
    let mesh = TriangleMesh::joined(groups.into_iter().map(|group| group.mesh)).welded().outward();
    let mass = match mesh.mass_properties() {
        Some(mass) => Some(mass),
        None => {
            output::note(&format!(
                "{}: is not closed; its mass and inertia are those of its convex pieces",
                path.display()
            ));
            let hulls = pieces.iter().filter_map(TriangleMesh::hull);
            MassProperties::sum(hulls.filter_map(|hull| hull.mass_properties()))
        }
    };
    let mass = mass.with_context(|| format!("{}: encloses no volume", path.display()))?;
    let mass_kg = mass_kg.unwrap_or(mass.volume_m3 * f64::from(density_kg_m3));
    let pieces: Vec<Vec<Point3<f32>>> = pieces.iter().map(<[_]>::to_vec).collect();
    let name = path.file_stem().unwrap_or_default().to_string_lossy();
    let object = known(&name, &mesh, &pieces, &mass, mass_kg);
    object.map_err(|error| anyhow::anyhow!("{}: {error}", path.display()))
}

fn known(
    name: &str,
    mesh: &TriangleMesh,
    pieces: &[Vec<Point3<f32>>],
    mass: &MassProperties,
    mass_kg: f64,
) -> Result<KnownObject, ObjectError> {
    KnownObject::new(&ObjectMesh {
        name,
        points: &mesh.points,
        triangles: &mesh.triangles,
        pieces,
        mass_kg,
        centre_m: mass.centre_m,
        inertia_kg_m2: mass.inertia_m5 * (mass_kg / mass.volume_m3),
    })
}

#[cfg(feature = "pieces")]
fn pieces(path: &Path, groups: &[Group]) -> anyhow::Result<ConvexPieces> {
    use crate::arguments::PieceSource;
    /// Voxels of V-HACD along the longest side.
    const RESOLUTION: u32 = 64;
    let found = crate::decomposed::pieces(path, groups, PieceSource::Auto, RESOLUTION)?;
    Ok(ConvexPieces::merged(found, MOST_PIECES).thinned(MOST_POINTS))
}

/// The hull: V-HACD is in a feature.
#[cfg(not(feature = "pieces"))]
fn pieces(path: &Path, groups: &[Group]) -> anyhow::Result<ConvexPieces> {
    let mesh = TriangleMesh::joined(groups.iter().map(|group| group.mesh.clone())).welded();
    if !mesh.is_convex() {
        output::note(&format!(
            "{}: is not convex, and is followed as its hull; {}",
            path.display(),
            crate::usage::missing("pieces", "pieces")
        ));
    }
    Ok(ConvexPieces::merged(vec![mesh.points], MOST_PIECES).thinned(MOST_POINTS))
}

/// Puts the labels of `--mask` on the first view of the first capture, and takes those of others away.
pub(super) fn mask(path: &Path, capture: &mut Capture, is_first: bool) -> anyhow::Result<()> {
    for (number, view) in capture.views.iter_mut().enumerate() {
        match view {
            View::Depth(view) if is_first && number == 0 => {
                view.labels = Some(recording::read_labels(path, view.camera.size())?);
            }
            View::Depth(view) => view.labels = None,
            View::Cloud(_) if is_first && number == 0 => {
                let text = format!(
                    "--mask {}: the recording has clouds; masks are of depth images",
                    path.display()
                );
                return Err(Usage(text).into());
            }
            View::Cloud(cloud) => cloud.labels = None,
        }
    }
    Ok(())
}
