//! A robot while it is read: links by name, joints, and geometries.

use nalgebra::{Isometry3, Point3, Vector3};
use rigidformer_runtime::mesh::TriangleMesh;

use crate::error::Problem;
use crate::inertia::Inertia;
use crate::meshes::{MeshFile, Meshes, placed};
use crate::robot::{Link, RobotJoint};
use crate::solid::Solid;

/// Links of a robot, at most.
pub(crate) const MOST_LINKS: usize = 2000;
/// Geometries of a robot, at most.
pub(crate) const MOST_GEOMETRIES: usize = 20_000;

/// Bytes of a link's name, at most: links between joints, and notes, repeat it.
const MOST_NAME: usize = 1024;

/// Refuses long names.
pub(crate) fn is_short(name: &str) -> Result<(), Problem> {
    match name.len() <= MOST_NAME {
        true => Ok(()),
        false => Err(Problem::Unsupported {
            what: "a name of more than 1024 bytes",
            remedy: "give a shorter one",
        }),
    }
}

/// A link's geometries while they are collected.
#[derive(Default)]
pub(crate) struct Shapes {
    meshes: Vec<TriangleMesh>,
    pieces: Vec<Vec<Point3<f32>>>,
}

impl Shapes {
    pub(crate) fn is_empty(&self) -> bool {
        self.meshes.is_empty()
    }

    /// A solid; `lengths` tells which ones its format takes.
    pub(crate) fn add_solid(
        &mut self,
        solid: &Solid,
        (pose, lengths): (&Isometry3<f64>, &'static str),
        meshes: &mut Meshes,
    ) -> Result<(), Problem> {
        if solid.is_flat() {
            let what = "a solid with a length that is not above 0";
            return Err(Problem::Unsupported { what, remedy: lengths });
        }
        let what = "a solid that is larger than 1000 km, or farther away";
        let far = Problem::Unsupported { what, remedy: "give its lengths and its place in metres" };
        let mesh =
            solid.is_sound().then(|| placed(&solid.mesh(), &Vector3::repeat(1.0), pose)).flatten();
        let mesh = mesh.ok_or(far)?;
        meshes.count(&mesh)?;
        self.pieces.push(mesh.points.clone());
        self.meshes.push(mesh);
        Ok(())
    }

    /// A mesh, as one piece, or as its groups where `by_groups` and each is convex.
    pub(crate) fn add_mesh(
        &mut self,
        file: &MeshFile,
        (scale, pose): (&Vector3<f64>, &Isometry3<f64>),
        by_groups: bool,
        meshes: &mut Meshes,
    ) -> Result<(), Problem> {
        let what = "a mesh that is more than 1000 km away";
        let far = || Problem::Unsupported { what, remedy: "give a smaller scale" };
        let mut own = Vec::new();
        for group in &file.groups {
            let mesh = placed(&group.mesh, scale, pose).ok_or_else(far)?;
            meshes.count(&mesh)?;
            own.push(mesh);
        }
        match by_groups && file.is_of_pieces {
            true => self.pieces.extend(own.iter().map(|mesh| mesh.points.clone())),
            false => self.pieces.push(own.iter().flat_map(|mesh| &mesh.points).copied().collect()),
        }
        self.meshes.extend(own);
        Ok(())
    }

    pub(crate) fn link(self, name: String, inertia: Inertia, friction: Option<f64>) -> Link {
        Link {
            name,
            inertia,
            surface: TriangleMesh::joined(self.meshes),
            pieces: self.pieces,
            friction,
        }
    }
}

/// The joints with parents first, depth first in the order of the file, from a root. None where one of `count` links is not reached,
/// or two joints reach it.
pub(crate) fn ordered(joints: &[RobotJoint], count: usize, root: usize) -> Option<Vec<RobotJoint>> {
    let mut of_parent: Vec<Vec<usize>> = vec![Vec::new(); count];
    for (number, joint) in joints.iter().enumerate() {
        of_parent.get_mut(joint.parent)?.push(number);
    }
    let mut children = |link: usize| {
        let own = of_parent.get_mut(link).map(std::mem::take).unwrap_or_default();
        own.into_iter().rev()
    };
    let mut order: Vec<usize> = Vec::new();
    let mut open: Vec<usize> = children(root).collect();
    while let Some(number) = open.pop() {
        order.push(number);
        open.extend(children(joints.get(number)?.child));
    }
    if order.len() + 1 != count || order.len() != joints.len() {
        return None;
    }
    let mut places = vec![0; joints.len()];
    for (place, number) in order.iter().enumerate() {
        *places.get_mut(*number)? = place;
    }
    let mut all: Vec<RobotJoint> =
        order.iter().filter_map(|number| joints.get(*number).cloned()).collect();
    for mimic in all.iter_mut().filter_map(|joint| joint.mimic.as_mut()) {
        mimic.joint = *places.get(mimic.joint)?;
    }
    Some(all)
}
