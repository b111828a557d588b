//! What the network is told about a point (docs/MODEL.md, section 2).

use crate::contact::ground::{NOWHERE_M, Plane};
use crate::geometry::{Nearest, dot, norm};
use crate::kernels::Kernels;
use crate::network::nearest::{Search, Target};
use crate::scene::{Scene, UnitSlot};
use crate::structure::heading::{self, ROBOT};
use nalgebra::Vector3;
use rigidformer_weights::{FeatureSet, ModelConfig};

/// Normalised features are clamped to this: what training did not see cannot drive the network without bound.
pub(crate) const CLAMP: f32 = 10.0;
/// The direction to the nearest point counts half at this distance, metres. Far points fade instead of switching off.
const PROXIMITY_M: f32 = 0.1;
/// Half width of the ramp from "will miss" to "will touch", metres: a switch would jump with the last digit of a gap.
const RAMP_M: f32 = 0.05;
/// Gaps are told apart up to this, metres: nothing farther is touched in a step, and its gap says nothing.
pub(crate) const GAP_CLAMP_M: f32 = 0.5;
/// Shorter distances have no direction, metres: the division would blow rounding up.
const TINY_M: f32 = 1e-6;

/// Writes numbers one after another into a row.
pub(crate) struct Row<'r> {
    slots: core::slice::IterMut<'r, f32>,
    /// The unit from whose frame vectors are seen.
    seen_from: Option<&'r UnitSlot>,
}

impl<'r> Row<'r> {
    pub(crate) fn new(row: &'r mut [f32]) -> Self {
        Row { slots: row.iter_mut(), seen_from: None }
    }

    /// Of a unit, for a model.
    fn of(config: &ModelConfig, unit: &'r UnitSlot, row: &'r mut [f32]) -> Self {
        let seen_from = if heading::is_robot(config) { Some(unit) } else { None };
        Row { seen_from, ..Row::new(row) }
    }

    pub(crate) fn scalar(&mut self, value: f32) {
        if let Some(slot) = self.slots.next() {
            *slot = value;
        }
    }

    pub(crate) fn vector(&mut self, v: Vector3<f32>) {
        let v = match self.seen_from {
            Some(unit) if ROBOT => heading::inward(unit, &v),
            _ => v,
        };
        self.as_it_is(v);
    }

    fn as_it_is(&mut self, v: Vector3<f32>) {
        self.scalar(v.x);
        self.scalar(v.y);
        self.scalar(v.z);
    }
}

/// What a point may touch.
enum Other<'s> {
    /// A plane, and the point's height above it, metres.
    Plane(&'s Plane, f32),
    /// A unit, and the velocity of its nearest point, m/s.
    Unit(&'s UnitSlot, Vector3<f32>),
}

/// The nearest thing to a point.
struct Contact<'s> {
    displacement: Vector3<f32>,
    other: Other<'s>,
}

/// Raw features of one local point of unit `index` into `row` (features). Schedules with an index
/// have `found` what is nearest to it.
pub(crate) fn raw<K: Kernels>(
    kernels: K,
    config: &ModelConfig,
    scene: &Scene<'_>,
    found: Option<Nearest>,
    (index, unit): (usize, &UnitSlot),
    number: usize,
    row: &mut [f32],
) {
    let Some(local) = scene.points_of(unit).get(number).map(|point| &point.coords) else { return };
    let point = unit.current.apply(local);
    let increment = scene.increment(unit, (number, local));
    let offset = match heading::is_robot(config) {
        true => unit.first.local(&point) - local,
        false if config.features.is_soft() => scene.bend(unit, (number, &point)),
        false => unit.current.displacement_from(&unit.first, local),
    };
    let found = found.unwrap_or_else(|| look(kernels, scene, (index, unit), &point));
    let contact = contact(scene, found, &point);
    let mut row = Row::of(config, unit, row);
    row.vector(contact.displacement);
    match config.features {
        FeatureSet::Paper => {
            // The paper tells displacements, not velocities: they hold at one time step.
            row.vector(increment);
            row.as_it_is(offset);
            row.scalar(unit.mass);
            row.scalar(unit.physics.friction);
            row.scalar(unit.physics.restitution);
        }
        _ => {
            row.vector(increment / scene.dt);
            row.as_it_is(offset);
            row.scalar(unit.ln_mass);
            row.scalar(unit.physics.friction);
            row.scalar(unit.physics.restitution);
            derived(scene, unit, &point, increment / scene.dt, &contact, &mut row);
            // Models of rigid units are not told.
            let told = match config.features.is_soft() {
                true => scene.soft_inputs(unit, number),
                false => None,
            };
            if let Some(told) = told {
                row.scalar(told.ln_young);
                told.changes.into_iter().for_each(|change| row.vector(change));
            }
        }
    }
}

/// The 22 quantities beyond the paper's 12, all from the same observation.
fn derived(
    scene: &Scene<'_>,
    unit: &UnitSlot,
    point: &Vector3<f32>,
    velocity: Vector3<f32>,
    contact: &Contact<'_>,
    row: &mut Row<'_>,
) {
    let lever = point - unit.current.centre;
    // What lies on a point has no direction to it.
    let length = norm(&contact.displacement).max(TINY_M);
    // Gravity acts on free units alone; between two of them it cancels.
    let (normal, distance, mut relative, other_is_free, friction, restitution) =
        match &contact.other {
            // Into the plane even from below it, where the displacement points out.
            Other::Plane(plane, height) => {
                (-plane.normal, *height, velocity, false, plane.friction, plane.restitution)
            }
            Other::Unit(other, other_velocity) => (
                contact.displacement / length,
                length,
                velocity - other_velocity,
                other.is_free(),
                other.physics.friction,
                other.physics.restitution,
            ),
        };
    if unit.is_free() != other_is_free {
        let falls = if unit.is_free() { scene.dt } else { -scene.dt };
        relative += scene.gravity * falls;
    }
    let share = match &contact.other {
        // Nothing changes the motion of what is driven or fixed.
        _ if !unit.is_free() => 0.0,
        Other::Unit(other, _) if other_is_free => other.mass / (unit.mass + other.mass),
        _ => 1.0,
    };
    let pair_friction = unit.physics.friction * friction;
    let pair_restitution = unit.physics.restitution * restitution;
    let approach = dot(&relative, &normal);
    let gap = (distance - approach * scene.dt).clamp(-GAP_CLAMP_M, GAP_CLAMP_M);
    let ramp = (0.5 - gap * (0.5 / RAMP_M)).clamp(0.0, 1.0);
    let closing = approach.max(0.0) * ramp;
    let push = normal * -(closing * share);
    row.vector(lever);
    row.vector(normal * (PROXIMITY_M / (PROXIMITY_M + length)));
    row.vector(relative);
    row.scalar(share);
    row.scalar(pair_friction);
    row.scalar(pair_restitution);
    row.scalar(approach);
    row.scalar(gap);
    row.scalar(ramp);
    row.vector(push);
    row.vector(lever.cross(&push));
    row.scalar(pair_restitution * closing);
}

/// Looks at all planes, and at all points of units of other bodies.
fn look<K: Kernels>(
    kernels: K,
    scene: &Scene<'_>,
    (index, unit): (usize, &UnitSlot),
    point: &Vector3<f32>,
) -> Nearest {
    let mut search = Search::new(*point, &scene.planes);
    for (j, other) in scene.others(index, unit) {
        search.visit(kernels, j, &target_of(scene, other));
    }
    search.nearest(kernels, |j| scene.units().get(j).map(|other| target_of(scene, other)))
}

fn target_of<'s>(scene: &'s Scene<'_>, unit: &'s UnitSlot) -> Target<'s> {
    Target { pose: &unit.current, points: scene.points_of(unit), radius: unit.radius }
}

/// The way to what was found, and what that is.
fn contact<'s>(scene: &'s Scene<'_>, found: Nearest, point: &Vector3<f32>) -> Contact<'s> {
    let of_plane = |plane: &'s Plane| {
        let height = plane.height_here(point);
        Contact { displacement: plane.normal * -height, other: Other::Plane(plane, height) }
    };
    let nothing = || {
        let (plane, height) = Plane::nowhere(point);
        let displacement = Vector3::new(0.0, 0.0, -NOWHERE_M);
        Contact { displacement, other: Other::Plane(plane, height) }
    };
    match found {
        Nearest::Nothing => nothing(),
        Nearest::Plane(number) => scene.planes.get(number).map_or_else(nothing, of_plane),
        Nearest::Point { unit, point: number } => {
            let Some(unit) = scene.units().get(unit) else { return nothing() };
            let Some(local) = scene.points_of(unit).get(number) else { return nothing() };
            let increment = scene.increment(unit, (number, &local.coords));
            Contact {
                displacement: unit.current.apply(&local.coords) - point,
                other: Other::Unit(unit, increment / scene.dt),
            }
        }
    }
}
