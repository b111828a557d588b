//! A robot as a JSON document.

use nalgebra::{Isometry3, Matrix3};
use serde_json::{Value, json};

use crate::error::RobotError;
use crate::robot::{JointKind, Robot, RobotJoint};

impl Robot {
    /// Links and joints at rest, for other programs: `links` with `name`, `mass_kg`, `centre_of_mass_m`, `inertia_kg_m2` (rows),
    /// `pose` (x, y, z, then a quaternion w, x, y, z, in the first link's frame), `friction`, `triangles` and `pieces`; `joints` with
    /// `name`, `kind`, `parent`, `child`, `axis` and `anchor` (in the child's frame), `axis_at_rest` (in the first link's frame),
    /// `limits` and `mimic`.
    ///
    /// # Errors
    /// None for robots that were read.
    pub fn describe(&self) -> Result<Value, RobotError> {
        let rest = self.rest();
        let (poses, axes) = (self.poses(&rest)?, self.axes(&rest)?);
        let links = self.links.iter().zip(&poses).map(|(link, pose)| {
            json!({
                "name": link.name,
                "mass_kg": link.inertia.mass_kg,
                "centre_of_mass_m": <[f64; 3]>::from(link.inertia.centre_m),
                "inertia_kg_m2": rows(&link.inertia.about_centre),
                "pose": numbers(pose),
                "friction": link.friction,
                "triangles": link.surface.triangles.len(),
                "pieces": link.pieces.len(),
            })
        });
        let joints = self.joints.iter().zip(&axes).map(|(joint, axis)| {
            json!({
                "name": joint.name,
                "kind": joint.kind.name(),
                "parent": self.link_name(joint.parent),
                "child": self.link_name(joint.child),
                "axis": joint.kind.axis().map(|axis| <[f64; 3]>::from(axis.into_inner())),
                "axis_at_rest": axis.map(<[f64; 3]>::from),
                "anchor": <[f64; 3]>::from(joint.anchor),
                "limits": joint.limits(),
                "mimic": joint.mimic.map(|mimic| json!({
                    "joint": self.joints.get(mimic.joint).map(|joint| &joint.name),
                    "multiplier": mimic.multiplier,
                    "offset": mimic.offset,
                })),
            })
        });
        Ok(json!({
            "name": self.name,
            "links": links.collect::<Vec<_>>(),
            "joints": joints.collect::<Vec<_>>(),
            "rest": rest,
            "notes": self.notes,
        }))
    }

    fn link_name(&self, link: usize) -> &str {
        self.links.get(link).map_or("", |link| link.name.as_str())
    }
}

impl RobotJoint {
    /// Least and greatest position, where there are such, rad or m.
    pub const fn limits(&self) -> Option<[f64; 2]> {
        match self.kind {
            JointKind::Revolute { limits, .. } => Some(limits),
            JointKind::Prismatic { limits, .. } => limits,
            _ => None,
        }
    }
}

impl JointKind {
    /// Its name: "fixed", "revolute", "continuous", "prismatic", "ball" or "free".
    pub const fn name(&self) -> &'static str {
        match self {
            JointKind::Fixed => "fixed",
            JointKind::Revolute { .. } => "revolute",
            JointKind::Continuous { .. } => "continuous",
            JointKind::Prismatic { .. } => "prismatic",
            JointKind::Ball => "ball",
            JointKind::Free => "free",
        }
    }
}

fn rows(matrix: &Matrix3<f64>) -> [[f64; 3]; 3] {
    matrix.transpose().into()
}

fn numbers(pose: &Isometry3<f64>) -> [f64; 7] {
    let (t, q) = (pose.translation.vector, pose.rotation);
    [t.x, t.y, t.z, q.w, q.i, q.j, q.k]
}
