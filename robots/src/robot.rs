//! Robots: links, joints, and where links are.

use std::path::PathBuf;

use nalgebra::{Isometry3, Point3, Quaternion, Translation3, UnitQuaternion, UnitVector3, Vector3};
use rigidformer_runtime::mesh::TriangleMesh;

use crate::error::RobotError;
use crate::inertia::Inertia;

/// A robot, as its file describes it: metres, kilograms, radians.
#[derive(Clone, Debug, PartialEq)]
pub struct Robot {
    /// Its name.
    pub name: String,
    /// Its links. Of MJCF the first is `world`, which never moves.
    pub links: Vec<Link>,
    /// Its joints: each link but the first hangs from one. Parents stand before their children.
    pub joints: Vec<RobotJoint>,
    /// Whether the first link is the world.
    pub is_in_world: bool,
    /// Planes of the world that it stands on: normal, offset, friction.
    pub planes: Vec<([f64; 3], f64, f64)>,
    /// What was passed over, or mended.
    pub notes: Vec<String>,
    /// Files that it was read from: meshes, and what its file includes. The file itself is not among them.
    pub files: Vec<PathBuf>,
}

/// A rigid part of a robot. Lengths are in its own frame.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Link {
    /// Its name.
    pub name: String,
    /// Mass, centre of mass and inertia; a mass of 0 where the file has none.
    pub inertia: Inertia,
    /// Triangles of its collision geometry, or of its visual geometry where it has no other.
    pub surface: TriangleMesh,
    /// Points of the convex hulls of its geometries, one by one.
    pub pieces: Vec<Vec<Point3<f32>>>,
    /// Friction coefficient, where the file has one.
    pub friction: Option<f64>,
}

/// How a child moves against its parent.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub enum JointKind {
    /// Not at all.
    Fixed,
    /// Turns about an axis, radians, within limits.
    Revolute {
        /// Axis, in the child's frame.
        axis: UnitVector3<f64>,
        /// Least and greatest position, rad.
        limits: [f64; 2],
    },
    /// Turns about an axis without limits.
    Continuous {
        /// Axis, in the child's frame.
        axis: UnitVector3<f64>,
    },
    /// Slides along an axis, metres.
    Prismatic {
        /// Axis, in the child's frame.
        axis: UnitVector3<f64>,
        /// Least and greatest position, m; none: it slides without end.
        limits: Option<[f64; 2]>,
    },
    /// Turns in all ways about the anchor: a quaternion w, x, y, z.
    Ball,
    /// Moves in all ways: x, y, z and a quaternion w, x, y, z of the child in its parent.
    Free,
}

impl JointKind {
    /// Numbers of a position: 0, 1, 4 or 7.
    pub const fn positions(&self) -> usize {
        match self {
            JointKind::Fixed => 0,
            JointKind::Revolute { .. }
            | JointKind::Continuous { .. }
            | JointKind::Prismatic { .. } => 1,
            JointKind::Ball => 4,
            JointKind::Free => 7,
        }
    }

    /// The axis that it turns about or slides along, in the child's frame.
    pub const fn axis(&self) -> Option<UnitVector3<f64>> {
        match self {
            JointKind::Revolute { axis, .. }
            | JointKind::Continuous { axis }
            | JointKind::Prismatic { axis, .. } => Some(*axis),
            _ => None,
        }
    }
}

/// A joint that follows another: its position is `multiplier * other + offset`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Mimic {
    /// Number of the joint that it follows.
    pub joint: usize,
    /// Factor.
    pub multiplier: f64,
    /// Offset, rad or m.
    pub offset: f64,
}

/// What a link hangs by.
#[derive(Clone, Debug, PartialEq)]
pub struct RobotJoint {
    /// Its name; it may be empty for fixed joints of MJCF.
    pub name: String,
    /// Number of the parent link.
    pub parent: usize,
    /// Number of the child link.
    pub child: usize,
    /// The child's frame in the parent's, where the position is `reference`.
    pub origin: Isometry3<f64>,
    /// How the child moves.
    pub kind: JointKind,
    /// The point that the child turns about, in its frame.
    pub anchor: Point3<f64>,
    /// The position at `origin`: MJCF's `ref`.
    pub reference: f64,
    /// The joint that it follows.
    pub mimic: Option<Mimic>,
}

impl RobotJoint {
    /// The anchor in the parent's frame, where the position is `reference`.
    pub fn parent_anchor(&self) -> Point3<f64> {
        self.origin * self.anchor
    }

    /// The child's frame in the parent's at a position.
    fn pose(&self, position: &[f64]) -> Option<Isometry3<f64>> {
        let about = |turn: UnitQuaternion<f64>| {
            let anchor = Translation3::from(self.anchor);
            self.origin
                * (anchor
                    * Isometry3::from_parts(Translation3::identity(), turn)
                    * anchor.inverse())
        };
        match (self.kind, position) {
            (JointKind::Fixed, []) => Some(self.origin),
            (JointKind::Revolute { axis, .. } | JointKind::Continuous { axis }, [angle]) => {
                Some(about(UnitQuaternion::from_axis_angle(&axis, angle - self.reference)))
            }
            (JointKind::Prismatic { axis, .. }, [way]) => {
                Some(self.origin * Translation3::from(axis.into_inner() * (way - self.reference)))
            }
            (JointKind::Ball, [w, x, y, z]) => Some(about(turn([*w, *x, *y, *z])?)),
            (JointKind::Free, [x, y, z, turned @ ..]) => {
                let turn = turn(<[f64; 4]>::try_from(turned).ok()?)?;
                Some(Isometry3::from_parts(Translation3::new(*x, *y, *z), turn))
            }
            _ => None,
        }
    }
}

/// The rotation of w, x, y, z of any length above 0.
pub(crate) fn turn([w, x, y, z]: [f64; 4]) -> Option<UnitQuaternion<f64>> {
    UnitQuaternion::try_new(Quaternion::new(w, x, y, z), 1e-12)
}

fn is_finite(pose: &Isometry3<f64>) -> bool {
    let numbers = pose.translation.vector.iter().chain(pose.rotation.coords.iter());
    numbers.copied().all(f64::is_finite)
}

impl Robot {
    /// How many numbers a vector of joint positions has: those of joints that follow no other, in their order.
    pub fn positions(&self) -> usize {
        self.joints
            .iter()
            .filter(|joint| joint.mimic.is_none())
            .map(|joint| joint.kind.positions())
            .sum()
    }

    /// Positions at rest: as the file has the links. MJCF's `qpos0`; zeros in URDF.
    pub fn rest(&self) -> Vec<f64> {
        let mut rest = Vec::new();
        for joint in self.joints.iter().filter(|joint| joint.mimic.is_none()) {
            let (t, q) = (joint.origin.translation.vector, joint.origin.rotation);
            match joint.kind {
                JointKind::Fixed => {}
                JointKind::Ball => rest.extend([1.0, 0.0, 0.0, 0.0]),
                JointKind::Free => rest.extend([t.x, t.y, t.z, q.w, q.i, q.j, q.k]),
                _ => rest.push(joint.reference),
            }
        }
        rest
    }

    /// Poses of all links, in the frame of the first one, at joint positions: see [`rest`](Self::rest).
    ///
    /// # Errors
    /// For positions of another number, or that are none.
    pub fn poses(&self, positions: &[f64]) -> Result<Vec<Isometry3<f64>>, RobotError> {
        let expected = self.positions();
        if positions.len() != expected {
            let robot = self.name.clone();
            return Err(RobotError::Positions { robot, found: positions.len(), expected });
        }
        if let Some(index) = positions.iter().position(|position| !position.is_finite()) {
            return Err(RobotError::Position { index });
        }
        // (joints) Where the numbers of each begin.
        let mut starts = Vec::new();
        let mut next = 0;
        for joint in &self.joints {
            starts.push(next);
            next += if joint.mimic.is_some() { 0 } else { joint.kind.positions() };
        }
        let own = |number: usize| -> Option<&[f64]> {
            let (start, count) = (*starts.get(number)?, self.joints.get(number)?.kind.positions());
            positions.get(start..start + count)
        };
        let mut poses = vec![Isometry3::identity(); self.links.len()];
        for (number, joint) in self.joints.iter().enumerate() {
            let followed = self.followed(number).and_then(|(leader, factor, offset)| {
                let position = own(leader)?.first()?;
                Some([factor * position + offset])
            });
            let position = match (&joint.mimic, &followed) {
                (Some(_), Some(position)) => Some(&position[..]),
                (Some(_), None) => None,
                (None, _) => own(number),
            };
            let wrong =
                RobotError::Position { index: starts.get(number).copied().unwrap_or_default() };
            let parent = poses.get(joint.parent).copied().unwrap_or_default();
            let pose = position.and_then(|position| joint.pose(position));
            // Products of large numbers are none any more.
            let pose = pose.map(|pose| parent * pose).filter(is_finite).ok_or(wrong)?;
            if let Some(child) = poses.get_mut(joint.child) {
                *child = pose;
            }
        }
        Ok(poses)
    }

    /// Where a joint with an axis is, at positions of all.
    pub(crate) fn position_of(&self, joint: &RobotJoint, positions: &[f64]) -> Option<f64> {
        let number = self.joints.iter().position(|other| std::ptr::eq(other, joint))?;
        let (leader, factor, offset) = self.followed(number)?;
        let before = self.joints.iter().take(leader).filter(|joint| joint.mimic.is_none());
        let start: usize = before.map(|joint| joint.kind.positions()).sum();
        Some(factor * positions.get(start)? + offset)
    }

    /// The joint that a joint follows in the end, with factor and offset.
    fn followed(&self, number: usize) -> Option<(usize, f64, f64)> {
        let (mut at, mut factor, mut offset) = (number, 1.0, 0.0);
        for _ in 0..=self.joints.len() {
            let Some(mimic) = self.joints.get(at)?.mimic else { return Some((at, factor, offset)) };
            (at, offset) = (mimic.joint, offset + factor * mimic.offset);
            factor *= mimic.multiplier;
        }
        None
    }

    /// Number of a link.
    pub fn link(&self, name: &str) -> Option<usize> {
        self.links.iter().position(|link| link.name == name)
    }

    /// The joint that a link hangs by; none for the first one.
    pub fn joint_of(&self, link: usize) -> Option<&RobotJoint> {
        self.joints.iter().find(|joint| joint.child == link)
    }

    /// Mass of all links but the world, kg.
    pub fn mass_kg(&self) -> f64 {
        self.links.iter().skip(usize::from(self.is_in_world)).map(|link| link.inertia.mass_kg).sum()
    }

    /// Whether a link never moves in the world: fixed joints alone lead to it from the world's link.
    pub fn is_static(&self, link: usize) -> bool {
        let mut at = link;
        // A way up that is longer than that would be a circle.
        for _ in 0..self.links.len() {
            match self.joint_of(at) {
                None => return self.is_in_world && at == 0,
                Some(joint) if joint.kind == JointKind::Fixed => at = joint.parent,
                Some(_) => return false,
            }
        }
        false
    }

    /// A direction for a test of axes: each joint's axis in the frame of the first link, at joint positions.
    ///
    /// # Errors
    /// As [`poses`](Self::poses).
    pub fn axes(&self, positions: &[f64]) -> Result<Vec<Option<Vector3<f64>>>, RobotError> {
        let poses = self.poses(positions)?;
        let axis = |joint: &RobotJoint| {
            Some(poses.get(joint.child)?.rotation * joint.kind.axis()?.into_inner())
        };
        Ok(self.joints.iter().map(axis).collect())
    }
}
