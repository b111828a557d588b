//! MJCF, MuJoCo's format: the part that says where links are, how they move and what they weigh.
//!
//! Taken: `include`, `compiler`, `default`, `asset/mesh` and of `worldbody` `body`, `frame`, `inertial`, `joint`, `freejoint` and
//! `geom`. Passed over: actuators, tendons, sensors, sites, contacts, keyframes, and equality constraints, which are noted. Refused:
//! `replicate`, `attach`, `composite`, `flexcomp`, and geometries that are fitted to meshes.

mod body;
mod compiler;
mod defaults;
mod geometry;

use std::collections::{HashMap, HashSet};
use std::path::{Path, PathBuf};

use crate::error::{Problem, RobotError};
use crate::inertia::Inertia;
use crate::meshes::Meshes;
use crate::options::LoadOptions;
use crate::robot::{Link, Robot};
use crate::tree::ordered;
use crate::xml::{self, Element, MOST_DEPTH};

use body::Reader;
use compiler::Compiler;
use defaults::Defaults;

/// Included files, at most.
const MOST_INCLUDES: usize = 256;

pub(crate) fn robot(
    path: &Path,
    root: &Element,
    options: &LoadOptions,
) -> Result<Robot, RobotError> {
    let meshes = Meshes::new(path, options);
    let mut included = HashSet::new();
    let mut whole = root.clone();
    include(&mut whole, &meshes, path.parent().unwrap_or(Path::new(".")), (&mut included, 0))?;
    // The elements of an error stay those of the file.
    let root = &whole;
    let compiler = Compiler::read(root)?;
    let mut assets: HashMap<String, &Element> = HashMap::new();
    for asset in root.all("asset") {
        for mesh in asset.all("mesh") {
            let name = mesh_name(mesh)?;
            if assets.insert(name.clone(), mesh).is_some() {
                return Err(mesh.fail(Problem::duplicate("mesh", &name)));
            }
        }
    }
    let mut reader = Reader {
        compiler,
        defaults: Defaults::read(root)?,
        assets,
        folder: path.parent().unwrap_or(Path::new(".")).into(),
        meshes,
        options,
        links: Vec::new(),
        joints: Vec::new(),
        names: HashSet::new(),
        joint_names: HashSet::new(),
        planes: Vec::new(),
        notes: Vec::new(),
        geometries: 0,
        inertias: HashMap::new(),
        loaded: HashMap::new(),
    };
    reader.world(root)?;
    for equality in root.all("equality").flat_map(|equality| &equality.children) {
        reader.note(format!("the equality constraint {} is not taken", equality.tag));
    }
    let Reader { mut links, joints, planes, notes, compiler, meshes, .. } = reader;
    weigh(&mut links, &compiler).map_err(|problem| root.fail(problem))?;
    let circle = Problem::Loop("some bodies hang from each other, in a circle");
    let joints = ordered(&joints, links.len(), 0).ok_or_else(|| root.fail(circle))?;
    let name = root.get("model").unwrap_or("robot").to_owned();
    let files = included.into_iter().chain(meshes.files()).collect();
    Ok(Robot { name, links, joints, is_in_world: true, planes, notes, files })
}

/// Bounds, and the mass of all, as MuJoCo's compiler sets them.
fn weigh(links: &mut [Link], compiler: &Compiler) -> Result<(), Problem> {
    let total: f64 = links.iter().skip(1).map(|link| link.inertia.mass_kg).sum();
    if let Some(wanted) = compiler.total_mass.filter(|_| total > 0.0) {
        let scaled = |link: &mut Link| link.inertia = link.inertia.scaled(wanted / total);
        links.iter_mut().for_each(scaled);
        let are_finite = |own: &Inertia| {
            own.mass_kg.is_finite() && own.about_centre.iter().all(|moment| moment.is_finite())
        };
        if !links.iter().all(|link| are_finite(&link.inertia)) {
            return Err(Problem::Inertia(
                "its masses are too small for settotalmass; give masses in kg, or leave it out",
            ));
        }
    }
    // The world has no mass.
    if let Some(world) = links.first_mut() {
        world.inertia = Inertia::default();
    }
    Ok(())
}

/// The name of a mesh: that of its file where it has none.
fn mesh_name(mesh: &Element) -> Result<String, RobotError> {
    if let Some(name) = mesh.get("name") {
        return Ok(name.to_owned());
    }
    let file = mesh.get("file").ok_or_else(|| mesh.fail(Problem::Missing("name or file")))?;
    let stem = Path::new(file).file_stem().and_then(|stem| stem.to_str()).unwrap_or(file);
    Ok(stem.to_owned())
}

/// Puts the children of included files in the place of `<include>`.
fn include(
    element: &mut Element,
    meshes: &Meshes,
    folder: &Path,
    (included, depth): (&mut HashSet<PathBuf>, usize),
) -> Result<(), RobotError> {
    // Files within files add up.
    if depth > MOST_DEPTH {
        return Err(
            element.fail(Problem::TooMany { what: "elements within each other", most: MOST_DEPTH })
        );
    }
    let mut children = Vec::new();
    for mut child in std::mem::take(&mut element.children) {
        if child.tag != "include" {
            include(&mut child, meshes, folder, (included, depth + 1))?;
            children.push(child);
            continue;
        }
        let file = child.need("file")?;
        let beside = child.file.parent().unwrap_or(folder);
        let found = meshes.find(file, folder).or_else(|_| meshes.find(file, beside));
        let found = found.map_err(|_| child.fail(Problem::unknown("file", file)))?;
        if !included.insert(found.clone()) {
            return Err(child.fail(Problem::duplicate("include", file)));
        }
        if included.len() > MOST_INCLUDES {
            return Err(child.fail(Problem::TooMany { what: "includes", most: MOST_INCLUDES }));
        }
        let mut root = xml::read(&found)?;
        include(&mut root, meshes, folder, (included, depth + 1))?;
        children.append(&mut root.children);
    }
    element.children = children;
    Ok(())
}
