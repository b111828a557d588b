//! Links that fixed joints hold together, as one.

use nalgebra::{Isometry3, Point3};
use rigidformer_runtime::mesh::TriangleMesh;

use crate::inertia::Inertia;
use crate::robot::{JointKind, Link, Robot, RobotJoint};

/// The robot with each link that a fixed joint holds made a part of its parent. What is fixed to the world stays.
pub(crate) fn fixed(robot: Robot) -> Robot {
    let mut poses = vec![Isometry3::identity(); robot.links.len()];
    // (links) The link that it is a part of, and its frame there.
    let mut owner: Vec<usize> = (0..robot.links.len()).collect();
    for joint in &robot.joints {
        let (Some(above), Some(frame)) =
            (owner.get(joint.parent).copied(), poses.get(joint.parent).copied())
        else {
            continue;
        };
        // The world itself is no body that others may become a part of.
        let merges = joint.kind == JointKind::Fixed && !(robot.is_in_world && above == 0);
        if let (true, Some(own), Some(pose)) =
            (merges, owner.get_mut(joint.child), poses.get_mut(joint.child))
        {
            *own = above;
            *pose = frame * joint.origin;
        }
    }
    let mut number = vec![0; robot.links.len()];
    let mut links: Vec<Link> = Vec::new();
    let mut bodies: Vec<Vec<Inertia>> = Vec::new();
    // Parents may stand behind their parts.
    for (at, link) in robot.links.iter().enumerate() {
        if owner.get(at) == Some(&at) {
            if let Some(slot) = number.get_mut(at) {
                *slot = links.len();
            }
            links.push(Link { inertia: Inertia::default(), ..link.clone() });
            bodies.push(vec![link.inertia]);
        }
    }
    let place =
        |link: usize| owner.get(link).and_then(|own| number.get(*own)).copied().unwrap_or_default();
    for (at, link) in robot.links.into_iter().enumerate() {
        if owner.get(at) == Some(&at) {
            continue;
        }
        let pose = poses.get(at).copied().unwrap_or_default();
        let moved = |point: &Point3<f32>| (pose * point.cast::<f64>()).cast::<f32>();
        let into = place(at);
        if let (Some(whole), Some(parts)) = (links.get_mut(into), bodies.get_mut(into)) {
            parts.push(link.inertia.moved(&pose));
            let mut surface = link.surface;
            surface.points.iter_mut().for_each(|point| *point = moved(point));
            whole.surface = TriangleMesh::joined([std::mem::take(&mut whole.surface), surface]);
            whole.pieces.extend(link.pieces.iter().map(|piece| piece.iter().map(moved).collect()));
            whole.friction = [whole.friction, link.friction].into_iter().flatten().reduce(f64::max);
        }
    }
    for (link, parts) in links.iter_mut().zip(&bodies) {
        link.inertia = Inertia::sum(parts);
    }
    let mut kept = Vec::new();
    let mut places = vec![None; robot.joints.len()];
    for (at, joint) in robot.joints.into_iter().enumerate() {
        if owner.get(joint.child) != Some(&joint.child) {
            continue;
        }
        if let Some(slot) = places.get_mut(at) {
            *slot = Some(kept.len());
        }
        let frame = poses.get(joint.parent).copied().unwrap_or_default();
        let (parent, child) = (place(joint.parent), place(joint.child));
        kept.push(RobotJoint { parent, child, origin: frame * joint.origin, ..joint });
    }
    for joint in &mut kept {
        joint.mimic = joint.mimic.and_then(|mimic| {
            let joint = places.get(mimic.joint).copied().flatten()?;
            Some(crate::robot::Mimic { joint, ..mimic })
        });
    }
    Robot { links, joints: kept, ..robot }
}
