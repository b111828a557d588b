//! Geometries: what touches, what is seen, and what they weigh.

use std::path::Path;
use std::rc::Rc;

use nalgebra::{Isometry3, Point3, Translation3, Unit, UnitQuaternion, Vector3};
use rigidformer_runtime::mesh::{Group, TriangleMesh};

use super::body::{Loaded, Parts, Reader};
use super::compiler::from_z;
use super::defaults::MAIN;
use crate::error::{Problem, RobotError};
use crate::inertia::{BELOW_0, Inertia};
use crate::meshes::{MeshFile, MeshInertia, mesh_inertia, placed};
use crate::robot::turn;
use crate::solid::Solid;
use crate::tree::MOST_GEOMETRIES;
use crate::xml::{Element, some_numbers};

/// kg/m3 where a geometry has neither mass nor density.
const DENSITY: f64 = 1000.0;
/// Friction of MuJoCo's geometries.
const FRICTION: f64 = 1.0;
/// Numbers of a mesh in the file itself, at most.
const MOST_NUMBERS: usize = 3_000_000;

/// When a geometry is looked at.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(super) enum Pass {
    First,
    Later,
}

impl<'f> Reader<'f> {
    /// Adds geometries, those for pictures alone where no others touch.
    pub(super) fn add_all(
        &mut self,
        parts: &mut Parts<'f>,
        of: (bool, bool),
    ) -> Result<(), RobotError> {
        for (element, class, frame) in &std::mem::take(&mut parts.geometries) {
            self.geometry(element, class, (frame, parts), of, Pass::First)?;
        }
        for (element, class, frame) in &std::mem::take(&mut parts.later) {
            if parts.touching.is_empty() {
                self.geometry(element, class, (frame, parts), of, Pass::Later)?;
            }
        }
        Ok(())
    }

    /// Adds a geometry: to what touches or to what is seen, and to what a body weighs where that counts.
    fn geometry(
        &mut self,
        element: &'f Element,
        class: &'f str,
        (frame, parts): (&Isometry3<f64>, &mut Parts<'f>),
        (is_world, weighs): (bool, bool),
        pass: Pass,
    ) -> Result<(), RobotError> {
        self.geometries += usize::from(pass == Pass::First);
        if self.geometries > MOST_GEOMETRIES {
            return Err(
                element.fail(Problem::TooMany { what: "geometries", most: MOST_GEOMETRIES })
            );
        }
        let own = self.defaults.filled(element, "geom", class)?;
        let kind = own.get("type").unwrap_or("sphere").to_owned();
        let collides =
            |name: &str| -> Result<bool, RobotError> { Ok(own.number(name)? != Some(0.0)) };
        let touches = collides("contype")? || collides("conaffinity")?;
        // Most meshes are for pictures alone, and large: they are read where nothing else shows the body.
        let counts = weighs && self.weighs(&own)?;
        if pass == Pass::First && kind == "mesh" && !touches && !counts {
            parts.later.push((element, class, *frame));
            return Ok(());
        }
        let friction = own.up_to::<3>("friction")?.and_then(|all| all.first().copied());
        let friction = friction.unwrap_or(FRICTION).clamp(0.0, 1e3);
        let (fit, size) = self.fitted(&own)?;
        let pose = frame * fit.map_or_else(|| self.compiler.pose(&own), Ok)?;
        match kind.as_str() {
            "plane" if is_world && !touches => {
                self.note("a plane of the world touches nothing, and is passed over".into());
                return Ok(());
            }
            "plane" if is_world => {
                let normal = pose.rotation * Vector3::z();
                self.planes.push((normal.into(), normal.dot(&pose.translation.vector), friction));
                return Ok(());
            }
            "plane" | "hfield" => {
                self.note(format!(
                    "a {kind} of {} is passed over",
                    if is_world { "the world" } else { "a body" }
                ));
                return Ok(());
            }
            "sdf" => {
                let what = "a geometry of a plugin";
                return Err(own.fail(Problem::Unsupported { what, remedy: "give a mesh of it" }));
            }
            "mesh" => {
                let Some(Loaded { file, scale }) = self.mesh(&own)? else { return Ok(()) };
                if weighs && let Some(weight) = self.weight_of_mesh(&own, &file, (&scale, &pose))? {
                    parts.weights.push(weight);
                }
                let shapes = if touches { &mut parts.touching } else { &mut parts.seen };
                let added = shapes.add_mesh(&file, (&scale, &pose), false, &mut self.meshes);
                added.map_err(|problem| own.fail(problem))?;
            }
            _ => {
                if own.get("mesh").is_some() {
                    let what = "a solid that is fitted to a mesh";
                    return Err(own.fail(Problem::Unsupported {
                        what,
                        remedy: "give it a size, or type=\"mesh\"",
                    }));
                }
                let side = |n: usize| -> Result<f64, RobotError> {
                    size.get(n)
                        .copied()
                        .ok_or_else(|| own.fail(Problem::Missing("size of so many numbers")))
                };
                let solid = match kind.as_str() {
                    "sphere" => Solid::Ellipsoid([side(0)?; 3]),
                    "capsule" => Solid::Capsule(side(0)?, side(1)?),
                    "cylinder" => Solid::Cylinder(side(0)?, side(1)?),
                    "box" => Solid::Box([side(0)?, side(1)?, side(2)?]),
                    "ellipsoid" => Solid::Ellipsoid([side(0)?, side(1)?, side(2)?]),
                    _ => {
                        let expected = "sphere, capsule, cylinder, box, ellipsoid, mesh or plane";
                        return Err(own.fail(Problem::word("type", &kind, expected)));
                    }
                };
                if weighs && self.weighs(&own)? {
                    self.not_a_shell(&own)?;
                    let (mass, density) = masses(&own)?;
                    let mass_kg = mass.unwrap_or(solid.volume_m3() * density);
                    parts.weights.push(solid.inertia(mass_kg).moved(&pose));
                }
                let shapes = if touches { &mut parts.touching } else { &mut parts.seen };
                let lengths = "give half sides, or radius and half of the length, in metres";
                let added = shapes.add_solid(&solid, (&pose, lengths), &mut self.meshes);
                added.map_err(|problem| own.fail(problem))?;
            }
        }
        if touches {
            parts.friction = Some(parts.friction.map_or(friction, |known| known.max(friction)));
        }
        Ok(())
    }

    /// Whether its group counts in a body's mass.
    fn weighs(&self, own: &Element) -> Result<bool, RobotError> {
        let group = own.number("group")?.unwrap_or(0.0);
        let [low, high] = self.compiler.groups;
        Ok((low..=high).contains(&group))
    }

    fn not_a_shell(&self, own: &Element) -> Result<(), RobotError> {
        match own.flag("shellinertia")? {
            Some(true) => {
                let what = "shellinertia";
                Err(own.fail(Problem::Unsupported { what, remedy: "give the body an <inertial>" }))
            }
            _ => Ok(()),
        }
    }

    /// The pose that `fromto` says, if there is one, and the size.
    fn fitted(&self, own: &Element) -> Result<(Option<Isometry3<f64>>, Vec<f64>), RobotError> {
        let mut size = own.up_to::<3>("size")?.unwrap_or_default();
        let Some([a, b, c, d, e, f]) = own.numbers::<6>("fromto")? else { return Ok((None, size)) };
        let (from, to) = (Vector3::new(a, b, c), Vector3::new(d, e, f));
        let way = Unit::try_new(from - to, 1e-10).ok_or_else(|| {
            let found = "two equal points".to_owned();
            own.fail(Problem::Number { attribute: "fromto".into(), found, expected: "a line" })
        })?;
        let half = (from - to).norm() / 2.0;
        match own.get("type") {
            Some("capsule" | "cylinder") => {
                size.truncate(1);
                size.push(half);
            }
            Some("box" | "ellipsoid") => {
                // The first number stands for both sides across, also where there are more.
                size.truncate(1);
                size.extend(size.first().copied());
                size.push(half);
            }
            other => {
                let expected = "capsule, cylinder, box or ellipsoid with fromto";
                return Err(own.fail(Problem::word("type", other.unwrap_or("sphere"), expected)));
            }
        }
        let middle = Translation3::from((from + to) / 2.0);
        Ok((Some(Isometry3::from_parts(middle, from_z(&way))), size))
    }

    /// A geometry's mesh, which others may have too: it is read once.
    fn mesh(&mut self, own: &Element) -> Result<Option<Loaded>, RobotError> {
        let name = own.need("mesh")?;
        if let Some(known) = self.loaded.get(name) {
            return Ok(known.clone());
        }
        let loaded = self.load(own, name)?;
        self.loaded.insert(name.to_owned(), loaded.clone());
        Ok(loaded)
    }

    fn load(&mut self, own: &Element, name: &str) -> Result<Option<Loaded>, RobotError> {
        let asset =
            *self.assets.get(name).ok_or_else(|| own.fail(Problem::unknown("mesh", name)))?;
        let asset = self.defaults.filled(asset, "mesh", MAIN)?;
        let scale = Vector3::from(asset.numbers("scale")?.unwrap_or([1.0; 3]));
        let back = asset.numbers::<3>("refpos")?.unwrap_or([0.0; 3]);
        let turned = match asset.numbers("refquat")? {
            Some(quat) => {
                turn(quat).ok_or_else(|| asset.fail(Problem::Missing("refquat of length 1")))?
            }
            None => UnitQuaternion::identity(),
        };
        let file = match asset.get("file") {
            Some(uri) => {
                let uri = self.uri(uri);
                let found = self.meshes.find(&uri, &self.folder);
                let path = match found {
                    Err(Problem::NoMesh { uri }) if self.options.skip_missing_meshes => {
                        self.note(format!("the mesh {uri:?} is not found, and passed over"));
                        return Ok(None);
                    }
                    found => found.map_err(|problem| asset.fail(problem))?,
                };
                self.meshes.read(&path, &uri).map_err(|problem| asset.fail(problem))?
            }
            None => {
                let file = inline(&asset)?;
                for group in &file.groups {
                    self.meshes.count(&group.mesh).map_err(|problem| asset.fail(problem))?;
                }
                Rc::new(file)
            }
        };
        // The reference is taken off before the scale.
        let reference =
            Isometry3::from_parts(Translation3::from(Vector3::from(back)), turned).inverse();
        if reference == Isometry3::identity() {
            return Ok(Some(Loaded { file, scale }));
        }
        let far = || asset.fail(Problem::Inertia("its mesh is too far away; give another refpos"));
        let mut groups = Vec::new();
        for group in &file.groups {
            let mesh = placed(&group.mesh, &Vector3::repeat(1.0), &reference).ok_or_else(far)?;
            self.meshes.count(&mesh).map_err(|problem| asset.fail(problem))?;
            groups.push(Group { name: group.name.clone(), mesh });
        }
        let file = Rc::new(MeshFile { groups, is_of_pieces: false });
        Ok(Some(Loaded { file, scale }))
    }

    /// A mesh's file, in the folder of meshes.
    fn uri(&self, file: &str) -> String {
        let file = match self.compiler.strips_path {
            true => file.rsplit(['/', '\\']).next().unwrap_or(file),
            false => file,
        };
        match self.compiler.mesh_folder.as_str() {
            "" => file.to_owned(),
            _ if Path::new(file).is_absolute() => file.to_owned(),
            folder => format!("{}/{file}", folder.trim_end_matches('/')),
        }
    }

    /// What a mesh weighs; none where it does not count.
    fn weight_of_mesh(
        &mut self,
        own: &Element,
        file: &MeshFile,
        (scale, pose): (&Vector3<f64>, &Isometry3<f64>),
    ) -> Result<Option<Inertia>, RobotError> {
        if !self.weighs(own)? {
            return Ok(None);
        }
        let (mass, density) = masses(own)?;
        if mass.unwrap_or(density) == 0.0 {
            return Ok(None);
        }
        self.not_a_shell(own)?;
        let name = own.need("mesh")?.to_owned();
        let asset =
            *self.assets.get(&name).ok_or_else(|| own.fail(Problem::unknown("mesh", &name)))?;
        let asset = self.defaults.filled(asset, "mesh", MAIN)?;
        let ways = [
            ("legacy", Some(MeshInertia::Legacy)),
            ("exact", Some(MeshInertia::Exact)),
            ("convex", Some(MeshInertia::Convex)),
            ("shell", None),
        ];
        let usual =
            if self.compiler.exact_meshes { MeshInertia::Exact } else { MeshInertia::Legacy };
        let way = asset.word("inertia", &ways, "legacy, exact or convex")?.unwrap_or(Some(usual));
        let Some(way) = way else {
            let what = "inertia=\"shell\"";
            return Err(
                asset.fail(Problem::Unsupported { what, remedy: "give the body an <inertial>" })
            );
        };
        let unit = match self.inertias.get(&(name.clone(), way)) {
            Some(known) => *known,
            None => {
                let all = TriangleMesh::joined(file.groups.iter().map(|group| group.mesh.clone()));
                let scaled = placed(&all, scale, &Isometry3::identity());
                let found = scaled.and_then(|mesh| mesh_inertia(&mesh, way));
                self.inertias.insert((name, way), found);
                found
            }
        };
        let hollow = Problem::Inertia(
            "its mesh encloses no volume; give the body an <inertial>, or close the mesh",
        );
        let unit = unit.ok_or_else(|| own.fail(hollow))?;
        let mass_kg = mass.unwrap_or(unit.mass_kg * density);
        Ok(Some(unit.scaled(mass_kg / unit.mass_kg).moved(pose)))
    }
}

/// Mass and density of a geometry that weighs.
fn masses(own: &Element) -> Result<(Option<f64>, f64), RobotError> {
    let (mass, density) = (own.number("mass")?, own.number("density")?.unwrap_or(DENSITY));
    match mass.is_some_and(|mass| mass < 0.0) || density < 0.0 {
        true => Err(own.fail(BELOW_0)),
        false => Ok((mass, density)),
    }
}

/// A mesh whose corners are in the file of the robot itself; without faces, their hull.
fn inline(asset: &Element) -> Result<MeshFile, RobotError> {
    let Some(text) = asset.get("vertex") else {
        let what = "a mesh without a file and without corners";
        return Err(asset.fail(Problem::Unsupported { what, remedy: "give its file" }));
    };
    let bad = |attribute: &str, expected: &'static str| {
        let (attribute, found) = (attribute.to_owned(), "its numbers".to_owned());
        asset.fail(Problem::Number { attribute, found, expected })
    };
    let read = |text: &str| {
        some_numbers(text, MOST_NUMBERS).filter(|numbers| numbers.len().is_multiple_of(3))
    };
    let rows = "rows of three finite numbers";
    let points = read(text).ok_or_else(|| bad("vertex", rows))?;
    let (points, _) = points.as_chunks::<3>();
    let points: Vec<Point3<f32>> = points.iter().map(|row| Point3::from(*row).cast()).collect();
    let corners = "rows of three numbers of corners, from 0";
    let mesh = match asset.get("face") {
        Some(text) => {
            let faces = read(text).ok_or_else(|| bad("face", corners))?;
            let is_corner = |n: &f64| *n >= 0.0 && *n < points.len() as f64 && n.fract() == 0.0;
            if !faces.iter().all(is_corner) {
                return Err(bad("face", corners));
            }
            let (faces, _) = faces.as_chunks::<3>();
            let triangles = faces.iter().map(|row| row.map(|corner| corner as u32)).collect();
            Some(TriangleMesh { points, triangles })
        }
        None => TriangleMesh::hull(&points),
    };
    let sound = mesh.filter(|mesh| mesh.is_sound() && !mesh.triangles.is_empty());
    let mesh = sound.ok_or_else(|| bad("vertex", "the corners of a body, with faces if any"))?;
    Ok(MeshFile { groups: vec![Group { name: String::new(), mesh }], is_of_pieces: false })
}
