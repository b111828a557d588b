//! Convex pieces of a mesh: its groups where each is closed and convex, else by V-HACD.

use std::panic;
use std::path::Path;

use nalgebra::{Point3, Vector3};
use parry3d::math::Vector;
use parry3d::transformation::vhacd::{VHACD, VHACDParameters};
use rigidformer_runtime::hull::ConvexHull;
use rigidformer_runtime::mesh::{Group, TriangleMesh};

use crate::arguments::PieceSource;
use crate::{interrupt, output};

/// Groups that become pieces, at most: the time grows with their square.
const MOST_GROUPS: usize = 512;
/// Parts that V-HACD splits one by one, at most. More are split as one.
const MOST_PARTS: usize = 64;

/// Points of convex pieces, at least one; each encloses a volume.
pub(crate) fn pieces(
    path: &Path,
    groups: &[Group],
    source: PieceSource,
    resolution: u32,
) -> anyhow::Result<Vec<Vec<Point3<f32>>>> {
    let shown = path.display();
    let number = groups.len();
    anyhow::ensure!(
        number <= MOST_GROUPS || source == PieceSource::Vhacd,
        "{shown}: has {number} groups, more than {MOST_GROUPS}; join some, or give --split vhacd"
    );
    let all = || TriangleMesh::joined(groups.iter().map(|group| group.mesh.clone())).welded();
    let found = match source {
        PieceSource::Vhacd => vhacd(path, &all(), resolution)?,
        PieceSource::Groups => {
            let welded: Vec<TriangleMesh> =
                groups.iter().map(|group| group.mesh.welded()).collect();
            let solid = solid(&welded);
            let filled = solid.iter().filter(|mesh| !mesh.is_convex()).count();
            if filled > 0 {
                output::note(&format!(
                    "{filled} of {number} groups are not closed and convex; their hulls are their pieces"
                ));
            }
            solid.into_iter().map(|mesh| mesh.points.clone()).collect()
        }
        PieceSource::Auto => of_parts(path, groups, resolution)?,
    };
    anyhow::ensure!(
        !found.is_empty(),
        "{shown}: its points lie in one plane; give a mesh that encloses a volume"
    );
    Ok(found)
}

/// The meshes that enclose a volume; of no others can a unit have pieces.
fn solid(groups: &[TriangleMesh]) -> Vec<&TriangleMesh> {
    let solid: Vec<_> =
        groups.iter().filter(|mesh| ConvexHull::new(&mesh.points).is_some()).collect();
    let (number, flat) = (groups.len(), groups.len() - solid.len());
    if flat > 0 && !solid.is_empty() {
        output::note(&format!("{flat} of {number} groups lie in one plane, and are left out"));
    }
    solid
}

/// The groups, if each that is not flat is closed and convex. Else the parts that share no point: those that are closed and convex, and what
/// V-HACD makes of the others.
fn of_parts(
    path: &Path,
    groups: &[Group],
    resolution: u32,
) -> anyhow::Result<Vec<Vec<Point3<f32>>>> {
    let welded: Vec<TriangleMesh> = groups.iter().map(|group| group.mesh.welded()).collect();
    let is_flat = |mesh: &TriangleMesh| ConvexHull::new(&mesh.points).is_none();
    let are_pieces = welded.iter().all(|mesh| mesh.is_convex() || is_flat(mesh))
        && welded.iter().any(TriangleMesh::is_convex);
    if groups.len() > 1 && are_pieces {
        return Ok(solid(&welded).into_iter().map(|mesh| mesh.points.clone()).collect());
    }
    // Sides of one body may be groups each: together they are closed.
    let (closed, open): (Vec<_>, Vec<_>) = welded.into_iter().partition(TriangleMesh::is_closed);
    let rest = TriangleMesh::joined(open).welded();
    let mut parts: Vec<TriangleMesh> = closed.iter().flat_map(TriangleMesh::parts).collect();
    parts.extend(few(rest.parts(), rest));
    parts.retain(|part| ConvexHull::new(&part.points).is_some());
    let (convex, hollow): (Vec<_>, Vec<_>) = parts.into_iter().partition(TriangleMesh::is_convex);
    let whole = TriangleMesh::joined(hollow.clone());
    let hollow = few(hollow, whole);
    if groups.len() > 1 {
        output::note(&format!(
            "its {} groups are not all closed and convex; of the parts that touch nothing, {} are convex, and V-HACD splits {}",
            groups.len(),
            convex.len(),
            hollow.len(),
        ));
    }
    let mut found: Vec<_> = convex.into_iter().map(|part| part.points).collect();
    for part in hollow {
        interrupt::check()?;
        found.extend(vhacd(path, &part, resolution)?);
    }
    Ok(found)
}

/// The parts, or what they are parts of where they are many.
fn few(parts: Vec<TriangleMesh>, whole: TriangleMesh) -> Vec<TriangleMesh> {
    if parts.len() <= MOST_PARTS { parts } else { vec![whole] }
}

/// Points of the convex parts of a mesh, by V-HACD.
fn vhacd(
    path: &Path,
    mesh: &TriangleMesh,
    resolution: u32,
) -> anyhow::Result<Vec<Vec<Point3<f32>>>> {
    let TriangleMesh { points, triangles } = mesh;
    let first = points.first().copied().unwrap_or_default();
    anyhow::ensure!(
        ConvexHull::new(points).is_some(),
        "{}: its points lie in one plane; give a mesh that encloses a volume",
        path.display()
    );
    // V-HACD counts in lengths of about one.
    let size = points.iter().map(|point| (point - first).amax()).fold(0.0, f32::max);
    let unit = |point: &Point3<f32>| {
        let [x, y, z] = ((point - first) / size).into();
        Vector::new(x, y, z)
    };
    let vertices: Vec<Vector> = points.iter().map(unit).collect();
    let parameters =
        VHACDParameters { resolution, max_convex_hulls: 64, ..VHACDParameters::default() };
    // What the library does not expect of a mesh ends in a panic there.
    let found = quietly(|| {
        VHACD::decompose(&parameters, &vertices, triangles, true)
            .compute_exact_convex_hulls(&vertices, triangles)
    });
    let back = |v: &Vector| first + Vector3::new(v.x, v.y, v.z) * size;
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
