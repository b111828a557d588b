//! Folders of meshes, each a body of its own.

use std::collections::HashSet;
use std::path::{Path, PathBuf};

use nalgebra::{Isometry3, Point3, Translation3, UnitQuaternion, Vector3};

use crate::error::{Problem, RobotError};
use crate::inertia::Inertia;
use crate::meshes::{MeshInertia, Meshes, mesh_inertia};
use crate::options::LoadOptions;
use crate::robot::{JointKind, Link, Robot, RobotJoint};
use crate::tree::{MOST_LINKS, Shapes};
use rigidformer_runtime::files::FileError;
use rigidformer_runtime::mesh::TriangleMesh;

/// Room between meshes of a row, as a share of the larger one's size.
const ROOM: f64 = 0.25;
/// Least and greatest density and scale that masses and places stay finite with.
const DENSITIES: [f64; 2] = [1e-3, 1e6];
const SCALES: [f64; 2] = [1e-10, 1e6];

/// How a folder's meshes are read.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct MeshSetOptions {
    /// Density, kg/m^3, 0.001 to a million: 1000.
    pub density_kg_m3: f64,
    /// Metres that a length of 1 in the files stands for, 1e-10 to a million: 1.
    pub scale: f64,
}

impl Default for MeshSetOptions {
    fn default() -> Self {
        Self { density_kg_m3: 1000.0, scale: 1.0 }
    }
}

/// Reads all meshes of a folder (STL, OBJ, COLLADA, MSH), by name: each a free link of a world, with the mass and inertia of what it
/// encloses, in a row along x, the lowest point of each at z = 0. Meshes that are not closed have those of their hull, and a note.
///
/// ```
/// use rigidformer_robots::{MeshSetOptions, SceneOptions, load_meshes};
/// let folder = tempfile::tempdir()?;
/// let cube = "v 0 0 0\nv 0 0 1\nv 0 1 0\nv 0 1 1\nv 1 0 0\nv 1 0 1\nv 1 1 0\nv 1 1 1\n\
///             f 1 2 4 3\nf 5 7 8 6\nf 1 5 6 2\nf 3 4 8 7\nf 1 3 7 5\nf 2 6 8 4\n";
/// std::fs::write(folder.path().join("cube.obj"), cube)?;
/// let mut options = MeshSetOptions::default();
/// (options.scale, options.density_kg_m3) = (0.1, 500.0);
/// let set = load_meshes(folder.path(), &options)?;
/// assert!((set.mass_kg() - 0.5).abs() < 1e-6);
/// assert_eq!(set.scene(&SceneOptions::default())?.scene.units().len(), 1);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
///
/// # Errors
/// [`RobotError`]: a folder or mesh that cannot be read, a mesh that encloses nothing, or an option out of range.
pub fn load_meshes(folder: &Path, options: &MeshSetOptions) -> Result<Robot, RobotError> {
    let unreadable = |source| {
        RobotError::File(FileError {
            path: folder.into(),
            action: "cannot be read",
            remedy: "name a folder of meshes",
            source,
        })
    };
    let fail = |path: &Path, problem: Problem| RobotError::Element {
        path: path.into(),
        line: 0,
        element: "mesh".into(),
        problem: Box::new(problem),
    };
    for (attribute, number, [least, most], expected) in [
        ("density", options.density_kg_m3, DENSITIES, "0.001 to a million kg/m^3"),
        ("scale", options.scale, SCALES, "1e-10 to a million"),
    ] {
        if !(least..=most).contains(&number) {
            let (attribute, found) = (attribute.to_owned(), number.to_string());
            return Err(fail(folder, Problem::Number { attribute, found, expected }));
        }
    }
    let mut paths: Vec<PathBuf> = Vec::new();
    for entry in std::fs::read_dir(folder).map_err(unreadable)? {
        let path = entry.map_err(unreadable)?.path();
        let end = path.extension().and_then(|end| end.to_str()).map(str::to_ascii_lowercase);
        if matches!(end.as_deref(), Some("stl" | "obj" | "dae" | "msh")) && path.is_file() {
            paths.push(path);
        }
    }
    paths.sort();
    if paths.is_empty() {
        let what = "a folder without meshes";
        return Err(fail(
            folder,
            Problem::Unsupported { what, remedy: "give one with STL, OBJ or COLLADA files" },
        ));
    }
    if paths.len() >= MOST_LINKS {
        return Err(fail(folder, Problem::TooMany { what: "meshes", most: MOST_LINKS }));
    }
    let mut meshes = Meshes::new(&folder.join("meshes"), &LoadOptions::default());
    let mut robot = Robot {
        name: folder.file_name().unwrap_or_default().to_string_lossy().into_owned(),
        links: vec![Link { name: "world".into(), ..Link::default() }],
        joints: Vec::new(),
        is_in_world: true,
        planes: Vec::new(),
        notes: Vec::new(),
        files: Vec::new(),
    };
    let mut names = HashSet::from(["world".to_owned()]);
    let mut end = 0.0;
    for path in paths {
        let stem = path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
        // Files of one name and several formats stay apart.
        let name = match names.contains(&stem) {
            true => path.file_name().unwrap_or_default().to_string_lossy().into_owned(),
            false => stem,
        };
        names.insert(name.clone());
        let mut shapes = Shapes::default();
        let read = meshes.read(&path, &name).and_then(|file| {
            let scale = Vector3::repeat(options.scale);
            shapes.add_mesh(&file, (&scale, &Isometry3::identity()), true, &mut meshes)
        });
        read.map_err(|problem| fail(&path, problem))?;
        let mut link = shapes.link(name, Inertia::default(), None);
        let (inertia, is_closed) = weight(&link.surface).ok_or_else(|| {
            fail(&path, Problem::Inertia("it encloses no volume; give a mesh of a body"))
        })?;
        if !is_closed {
            robot.notes.push(format!(
                "{} is not closed: its mass and inertia are those of its hull",
                link.name
            ));
        }
        link.inertia = inertia.scaled(options.density_kg_m3);
        let (low, high) = bounds(&link.surface);
        let room = (high - low).amax() * ROOM;
        let place = Vector3::new(end + room - low.x, -(low.y + high.y) / 2.0, -low.z);
        end += room + high.x - low.x;
        robot.joints.push(RobotJoint {
            name: link.name.clone(),
            parent: 0,
            child: robot.links.len(),
            origin: Isometry3::from_parts(Translation3::from(place), UnitQuaternion::identity()),
            kind: JointKind::Free,
            anchor: Point3::origin(),
            reference: 0.0,
            mimic: None,
        });
        robot.links.push(link);
    }
    robot.files = meshes.files().collect();
    Ok(robot)
}

/// At 1 kg/m3, of what it encloses, or of its hull; and whether it is closed.
fn weight(mesh: &TriangleMesh) -> Option<(Inertia, bool)> {
    if let Some(own) = mesh.mass_properties() {
        let about_centre = own.inertia_m5;
        return Some((
            Inertia { mass_kg: own.volume_m3, centre_m: own.centre_m, about_centre },
            true,
        ));
    }
    Some((mesh_inertia(mesh, MeshInertia::Convex)?, false))
}

fn bounds(mesh: &TriangleMesh) -> (Vector3<f64>, Vector3<f64>) {
    let first = mesh.points.first().copied().unwrap_or_default().coords;
    let (low, high) = mesh.points.iter().fold((first, first), |(low, high), point| {
        (low.inf(&point.coords), high.sup(&point.coords))
    });
    (low.cast(), high.cast())
}
