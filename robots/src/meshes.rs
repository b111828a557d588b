//! Meshes of robots: where they are, and what they weigh.

use std::collections::HashMap;
use std::path::{Path, PathBuf};
use std::rc::Rc;

use nalgebra::{Isometry3, Matrix3, Point3, Vector3};
use rigidformer_runtime::files::{self, shown};
use rigidformer_runtime::memory::{Budget, TooLarge};
use rigidformer_runtime::mesh::{self, Format, Group, MeshError, TriangleMesh};

use crate::error::{Problem, SHOWN};
use crate::inertia::{Inertia, symmetric};
use crate::options::LoadOptions;

/// Folders above the robot's own that packages and meshes may lie in.
const UPWARDS: usize = 4;
/// Bytes that a point and a triangle of a link take, with copies for pieces and while its surface is sampled.
const POINT_BYTES: u64 = 48;
const TRIANGLE_BYTES: u64 = 40;
/// Groups of a mesh that are looked at, whether each is convex.
const MOST_GROUPS: usize = 64;
/// Volumes below this part of the diagonal's cube enclose nothing.
const NOTHING: f64 = 1e-9;

/// A mesh's file, as it is.
pub(crate) struct MeshFile {
    pub(crate) groups: Vec<Group>,
    /// Whether each group is a convex piece of its own.
    pub(crate) is_of_pieces: bool,
}

/// Finds and reads meshes for one robot.
pub(crate) struct Meshes {
    packages: Vec<PathBuf>,
    /// The folder of the robot's file, and those above.
    above: Vec<PathBuf>,
    read: HashMap<PathBuf, Rc<MeshFile>>,
    pub(crate) budget: Budget,
}

impl Meshes {
    pub(crate) fn new(robot: &Path, options: &LoadOptions) -> Self {
        let mut packages = options.package_paths.clone();
        if let Some(paths) = std::env::var_os("ROS_PACKAGE_PATH") {
            packages.extend(std::env::split_paths(&paths).filter(|path| path.is_absolute()));
        }
        // The names of folders that are given as `.` or `..` count too. What is not there holds nothing.
        let packages = packages.iter().filter_map(|package| package.canonicalize().ok());
        let above = folder_of(robot);
        // All files lie below the root.
        let above = above.ancestors().filter(|folder| folder.parent().is_some());
        Self {
            packages: packages.collect(),
            above: above.take(UPWARDS + 1).map(Path::to_path_buf).collect(),
            read: HashMap::new(),
            budget: Budget::default(),
        }
    }

    /// The file that a reference means, `folder` being that of the file with the reference.
    pub(crate) fn find(&self, uri: &str, folder: &Path) -> Result<PathBuf, Problem> {
        let uri = uri.trim().replace('\\', "/");
        let packaged = uri.strip_prefix("package://").or(uri.strip_prefix("model://"));
        let mut places = Vec::new();
        match packaged {
            Some(rest) => {
                let (name, inner) = rest.split_once('/').unwrap_or((rest, ""));
                for base in self.packages.iter().chain(&self.above) {
                    if base.file_name().is_some_and(|own| own == name) {
                        places.push(base.join(inner));
                    }
                    places.push(base.join(rest));
                }
            }
            None => {
                let plain = uri.strip_prefix("file://").unwrap_or(&uri);
                places.push(folder.join(plain));
                places.extend(self.packages.iter().map(|base| base.join(plain)));
            }
        }
        let is_there = |place: &PathBuf| place.is_file();
        let Some(found) =
            places.into_iter().find(is_there).and_then(|place| place.canonicalize().ok())
        else {
            return Err(Problem::NoMesh { uri: shown(&uri, SHOWN) });
        };
        // What a file from elsewhere names is read within these folders alone.
        match self.packages.iter().chain(&self.above).any(|base| found.starts_with(base)) {
            true => Ok(found),
            false => Err(Problem::Outside { uri: shown(&uri, SHOWN) }),
        }
    }

    pub(crate) fn read(&mut self, path: &Path, uri: &str) -> Result<Rc<MeshFile>, Problem> {
        if let Some(read) = self.read.get(path) {
            return Ok(read.clone());
        }
        let end = path.extension().and_then(|end| end.to_str()).map(str::to_ascii_lowercase);
        if !matches!(end.as_deref(), Some("stl" | "obj" | "dae" | "msh")) {
            let what = "a mesh that is no STL, OBJ, COLLADA or MSH";
            return Err(Problem::Unsupported { what, remedy: "convert it to STL or OBJ" });
        }
        let failed = |problem: MeshError| Problem::Mesh { uri: shown(uri, SHOWN), problem };
        let bytes =
            files::read_whole(path).map_err(|error| Problem::Unreadable(error.to_string()))?;
        let groups = match end.as_deref() {
            Some("msh") => {
                let mesh = msh(&bytes).filter(TriangleMesh::is_sound).ok_or_else(|| {
                    failed(MeshError::Broken {
                        format: "MSH",
                        problem: "its counts or corners are wrong".into(),
                    })
                })?;
                vec![Group { name: String::new(), mesh }]
            }
            // What reading takes is free again after it.
            _ => mesh::read(&bytes, Format::of(path), &mut Budget::default()).map_err(failed)?,
        };
        for group in &groups {
            self.count(&group.mesh)?;
        }
        let is_of_pieces = (2..=MOST_GROUPS).contains(&groups.len())
            && groups.iter().all(|group| group.mesh.welded().is_convex());
        let read = Rc::new(MeshFile { groups, is_of_pieces });
        self.read.insert(path.into(), read.clone());
        Ok(read)
    }

    /// The files of all meshes that were read.
    pub(crate) fn files(&self) -> impl Iterator<Item = PathBuf> {
        self.read.keys().cloned()
    }

    /// Counts a link's copy of a mesh.
    pub(crate) fn count(&mut self, mesh: &TriangleMesh) -> Result<(), Problem> {
        let bytes =
            mesh.points.len() as u64 * POINT_BYTES + mesh.triangles.len() as u64 * TRIANGLE_BYTES;
        self.budget.take(bytes).map_err(|error| {
            Problem::Unreadable(format!("its meshes: {error}; {}", TooLarge::REMEDY))
        })
    }
}

/// The folder of a robot's file, which need not be there: a robot in memory may have any name.
fn folder_of(robot: &Path) -> PathBuf {
    let file = robot.canonicalize().or_else(|_| std::path::absolute(robot)).unwrap_or_default();
    let folder = file.parent().unwrap_or(Path::new(""));
    folder.canonicalize().unwrap_or_else(|_| folder.into())
}

/// MuJoCo's own format: counts of points, normals, texture coordinates and triangles, then those.
fn msh(bytes: &[u8]) -> Option<TriangleMesh> {
    let (words, []) = bytes.as_chunks::<4>() else { return None };
    let (counts, words) = words.split_at_checked(4)?;
    let mut counts = counts.iter().map(|word| usize::try_from(i32::from_le_bytes(*word)).ok());
    let [points, normals, texture, triangles] = [(); 4].map(|()| counts.next().flatten());
    let (points, rest) = words.split_at_checked(points?.checked_mul(3)?)?;
    let (_, rest) = rest.split_at_checked(normals?.checked_mul(3)?)?;
    let (_, rest) = rest.split_at_checked(texture?.checked_mul(2)?)?;
    let (triangles, []) = rest.split_at_checked(triangles?.checked_mul(3)?)? else { return None };
    Some(TriangleMesh {
        points: points
            .as_chunks::<3>()
            .0
            .iter()
            .map(|p| Point3::from(p.map(f32::from_le_bytes)))
            .collect(),
        triangles: triangles.as_chunks::<3>().0.iter().map(|t| t.map(u32::from_le_bytes)).collect(),
    })
    .filter(|mesh: &TriangleMesh| !mesh.triangles.is_empty())
}

/// The mesh with its lengths multiplied along each axis, and then moved. None where a length is no number any more.
pub(crate) fn placed(
    mesh: &TriangleMesh,
    scale: &Vector3<f64>,
    pose: &Isometry3<f64>,
) -> Option<TriangleMesh> {
    let place = |point: &Point3<f32>| {
        let scaled = Point3::from(point.coords.cast::<f64>().component_mul(scale));
        (pose * scaled).cast::<f32>()
    };
    let points: Vec<Point3<f32>> = mesh.points.iter().map(place).collect();
    let mut triangles = mesh.triangles.clone();
    // A mirrored mesh keeps its outside.
    if scale.product() < 0.0 {
        triangles.iter_mut().for_each(|face| face.swap(1, 2));
    }
    let mesh = TriangleMesh { points, triangles };
    let is_near = |point: &Point3<f32>| point.iter().all(|v| v.abs() <= 1e6);
    mesh.points.iter().all(is_near).then_some(mesh)
}

/// How MuJoCo finds what a mesh weighs.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub(crate) enum MeshInertia {
    /// Pyramids from the middle of the faces, all of them added: right for meshes that are star-shaped.
    #[default]
    Legacy,
    /// That of what the faces enclose.
    Exact,
    /// That of the hull.
    Convex,
}

/// What a mesh weighs at 1 kg/m3. None where it encloses nothing.
pub(crate) fn mesh_inertia(mesh: &TriangleMesh, way: MeshInertia) -> Option<Inertia> {
    let hull;
    let mesh = match way {
        MeshInertia::Convex => {
            hull = TriangleMesh::hull(&mesh.points)?;
            &hull
        }
        _ => mesh,
    };
    let corners = || {
        let point = |corner: u32| -> Vector3<f64> {
            mesh.points.get(corner as usize).map_or(Vector3::zeros(), |point| point.coords.cast())
        };
        mesh.triangles.iter().map(move |face| face.map(point))
    };
    let sign = |volume: f64| if way == MeshInertia::Legacy { volume.abs() } else { volume };
    let (mut area, mut middle) = (0.0, Vector3::zeros());
    for [a, b, c] in corners() {
        let part = (b - a).cross(&(c - a)).norm() / 2.0;
        area += part;
        middle += (a + b + c) * (part / 3.0);
    }
    let middle = (area > 0.0).then(|| middle / area)?;
    let (mut volume, mut centre) = (0.0, Vector3::zeros());
    for [a, b, c] in corners() {
        let part = sign((a - middle).dot(&(b - middle).cross(&(c - middle))) / 6.0);
        volume += part;
        centre += ((a + b + c) / 4.0 + middle / 4.0) * part;
    }
    let size = f64::from(mesh.size_m());
    if !(volume > NOTHING * size.powi(3) && volume.is_finite()) {
        return None;
    }
    let centre = centre / volume;
    let mut second = Matrix3::zeros();
    // Pyramids to the centre have another volume than those to the middle, where they are all added.
    let mut volume = 0.0;
    for corners in corners() {
        let [a, b, c] = corners.map(|corner| corner - centre);
        let part = sign(a.dot(&b.cross(&c)) / 6.0);
        volume += part;
        let sum = a + b + c;
        let squares = a * a.transpose() + b * b.transpose() + c * c.transpose();
        second += (squares + sum * sum.transpose()) * (part / 20.0);
    }
    let about = Matrix3::identity() * second.trace() - second;
    Some(Inertia {
        mass_kg: volume,
        centre_m: Point3::from(centre),
        about_centre: symmetric(&about),
    })
}
