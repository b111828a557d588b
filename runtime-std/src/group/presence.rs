//! Units of a member as they are to others: where they are, where a step takes them, and how near they are.
//!
//! Plain arithmetic and square roots alone: other functions of the platform would give other bits on other machines.

use nalgebra::{Isometry3, Point3, Quaternion, Translation3, UnitQuaternion, Vector3};
use rigidformer_core::{Role, UnitId, UnitView};

use crate::poses::heaviest_free;
use crate::world::World;

/// A unit of a member, about to step.
#[derive(Clone, Copy, Debug)]
pub(super) struct Presence {
    pub(super) id: UnitId,
    pub(super) role: Role,
    /// A step ago, now, and after the step.
    pub(super) before: Isometry3<f32>,
    pub(super) now: Isometry3<f32>,
    pub(super) next: Isometry3<f32>,
    /// A ball around it, in the world.
    pub(super) middle: Point3<f32>,
    pub(super) radius: f32,
}

impl Presence {
    /// As it is, and as it goes on if nothing says otherwise. None of a soft unit, whose points have no pose.
    fn of(world: &World, unit: &UnitView<'_>) -> Option<Presence> {
        if unit.is_soft() {
            return None;
        }
        let centre = unit.centre().cast::<f32>();
        let far = |most: f32, point: Point3<f32>| most.max((point - centre).norm_squared());
        let radius = unit.points().fold(0.0, far).sqrt();
        let now = unit.pose();
        // From its state alone, so that whoever goes on from a snapshot of it gets the same bits. A pose of a step ago has the fall of
        // what rests in it; a velocity has not.
        let velocity = world.velocity(unit.id()).unwrap_or_default();
        let way = velocity.linear_m_s * world.simulator().dt_s().unwrap_or_default();
        let before = Isometry3::from_parts(
            Translation3::from(now.translation.vector - way),
            unit.previous_pose().rotation,
        );
        let next = match unit.role() {
            Role::Fixed => now,
            // Where it was told to go.
            _ => unit.target().unwrap_or_else(|| on(&before, &now)),
        };
        Some(Presence {
            id: unit.id(),
            role: unit.role(),
            before,
            now,
            next,
            middle: centre,
            radius,
        })
    }

    /// Metres that none of its points moves beyond in the step.
    pub(super) fn reach_m(&self) -> f32 {
        let turn = self.next.rotation * self.now.rotation.inverse();
        let there = self.next * self.now.inverse_transform_point(&self.middle);
        // The chord of the turn at the radius.
        (there - self.middle).norm() + 2.0 * turn.imag().norm() * self.radius
    }

    /// Metres between the balls of two units at their nearest in the step; negative where they may touch.
    pub(super) fn room_m(&self, other: &Presence) -> f32 {
        let apart = (self.middle - other.middle).norm();
        apart - (self.radius + other.radius) - (self.reach_m() + other.reach_m())
    }
}

/// All rigid units of a member in their order. Links of a robot go on with its heading, as its model has them before it
/// corrects that; other units by themselves.
pub(super) fn presences(world: &World) -> Vec<Presence> {
    let units = world.simulator().units();
    let mut all: Vec<Presence> = units.filter_map(|unit| Presence::of(world, &unit)).collect();
    if !world.model().model().config().motion.is_robot() {
        return all;
    }
    let masses = world.simulator().units().filter(|unit| !unit.is_soft());
    let masses = masses.map(|unit| (unit.role(), unit.physics().mass_kg));
    let Some(leader) = heaviest_free(masses).and_then(|leader| all.get(leader)) else { return all };
    let stride = heading(&leader.now) * heading(&leader.before).inverse();
    for unit in all.iter_mut().filter(|unit| unit.role == Role::Free) {
        unit.next = whole(&(stride * unit.now));
    }
    all
}

/// Where a step has taken the units.
pub(super) fn arrive(presences: &mut [Presence], world: &World) {
    for unit in presences {
        unit.next = world.simulator().pose(unit.id).unwrap_or(unit.next);
    }
}

/// The balls of all units, and of their ways, as one: its middle and radius.
pub(super) fn around(presences: &[Presence]) -> Option<(Point3<f32>, f32)> {
    let first = presences.first()?;
    let (mut low, mut high) = (first.middle, first.middle);
    for unit in presences {
        (low, high) = (low.inf(&unit.middle), high.sup(&unit.middle));
    }
    let middle = low + (high - low) * 0.5;
    let far = |most: f32, unit: &Presence| {
        most.max((unit.middle - middle).norm() + unit.radius + unit.reach_m())
    };
    Some((middle, presences.iter().fold(0.0, far)))
}

/// The pose after a second step like the one from `before` to `now`.
fn on(before: &Isometry3<f32>, now: &Isometry3<f32>) -> Isometry3<f32> {
    let position = now.translation.vector * 2.0 - before.translation.vector;
    let turn = now.rotation * before.rotation.inverse() * now.rotation;
    whole(&Isometry3::from_parts(Translation3::from(position), turn))
}

/// The pose with a rotation of length 1, which products of rotations lose.
fn whole(pose: &Isometry3<f32>) -> Isometry3<f32> {
    Isometry3::from_parts(
        pose.translation,
        UnitQuaternion::new_normalize(pose.rotation.into_inner()),
    )
}

/// The turn about the vertical and the point of the ground below.
fn heading(pose: &Isometry3<f32>) -> Isometry3<f32> {
    let turn = Quaternion::new(pose.rotation.w, 0.0, 0.0, pose.rotation.k);
    let turn = UnitQuaternion::try_new(turn, 1e-6).unwrap_or_else(UnitQuaternion::identity);
    let ground = Vector3::new(pose.translation.x, pose.translation.y, 0.0);
    Isometry3::from_parts(Translation3::from(ground), turn)
}

/// The pose at a share of a step, straight on and evenly.
pub(super) fn between(unit: &Presence, share: f32) -> Isometry3<f32> {
    // The ends to the bit.
    if share >= 1.0 {
        return unit.next;
    }
    let position = unit.now.translation.vector.lerp(&unit.next.translation.vector, share);
    Isometry3::from_parts(
        Translation3::from(position),
        unit.now.rotation.nlerp(&unit.next.rotation, share),
    )
}
