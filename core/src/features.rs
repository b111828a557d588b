//! What the network is told about a point (docs/MODEL.md, section 2).

use crate::geometry::{Nearest, Pose, Search, Target, dot, norm};
use crate::kernels::Kernels;
use crate::scene::{Scene, UnitState};
use nalgebra::Vector3;
use rigidformer_weights::{FeatureSet, ModelConfig};

/// Normalised features are clamped to this, so that nothing unseen in training can
/// saturate the network without bound.
pub(crate) const CLAMP: f32 = 10.0;
/// Distance at which the direction to the nearest point counts half, metres.
const PROXIMITY_M: f32 = 0.1;
/// Half width of the ramp from "will miss" to "will touch", metres.
const RAMP_M: f32 = 0.05;
/// Gaps are told apart up to this, metres.
pub(crate) const GAP_CLAMP_M: f32 = 0.5;
/// Shortest distance that has a direction, metres.
const TINY_M: f32 = 1e-6;

/// Writes numbers one after another into a row.
pub(crate) struct Row<'r>(core::slice::IterMut<'r, f32>);

impl<'r> Row<'r> {
    pub(crate) fn new(row: &'r mut [f32]) -> Self {
        Row(row.iter_mut())
    }

    pub(crate) fn scalar(&mut self, value: f32) {
        if let Some(slot) = self.0.next() {
            *slot = value;
        }
    }

    pub(crate) fn vector(&mut self, v: Vector3<f32>) {
        self.scalar(v.x);
        self.scalar(v.y);
        self.scalar(v.z);
    }
}

/// The nearest thing to a point and how it moves.
struct Contact {
    displacement: Vector3<f32>,
    /// The other unit's index and velocity (m/s), or none for the ground.
    other: Option<(usize, Vector3<f32>)>,
}

/// Raw features of one local point of unit `index` into `row` (features). Kernels with an index
/// have found what is nearest to it: a point of a unit, or else the ground.
pub(crate) fn raw<K: Kernels, const UNITS: usize>(
    kernels: K,
    config: &ModelConfig,
    scene: &Scene<'_, UNITS>,
    found: Option<(usize, usize)>,
    (index, unit): (usize, &UnitState),
    local: &Vector3<f32>,
    row: &mut [f32],
) {
    let point = unit.current.apply(local);
    let increment = unit.current.displacement_from(&unit.previous, local);
    let offset = unit.current.displacement_from(&unit.first, local);
    let contact = nearest(kernels, scene, found, index, &point);
    let mut row = Row::new(row);
    row.vector(contact.displacement);
    match config.features {
        FeatureSet::Paper => {
            row.vector(increment);
            row.vector(offset);
            row.scalar(unit.physics.mass_kg);
            row.scalar(unit.physics.friction);
            row.scalar(unit.physics.restitution);
        }
        FeatureSet::Contact | FeatureSet::Impact => {
            row.vector(increment / scene.dt);
            row.vector(offset);
            row.scalar(unit.ln_mass);
            row.scalar(unit.physics.friction);
            row.scalar(unit.physics.restitution);
            derived(config, scene, unit, &point, increment / scene.dt, &contact, &mut row);
        }
    }
}

/// The 22 quantities beyond the paper's 12, all from the same observation.
fn derived<const UNITS: usize>(
    config: &ModelConfig,
    scene: &Scene<'_, UNITS>,
    unit: &UnitState,
    point: &Vector3<f32>,
    velocity: Vector3<f32>,
    contact: &Contact,
    row: &mut Row<'_>,
) {
    let lever = point - unit.current.centre;
    let length = norm(&contact.displacement).max(TINY_M);
    let other = contact.other.and_then(|(j, v)| scene.units.get(j).map(|unit| (unit, v)));
    let (normal, distance, relative, share, friction, restitution) = match other {
        None => (
            // Downwards even from below the plane, where the displacement points up.
            Vector3::new(0.0, 0.0, -1.0),
            point.z,
            velocity + Vector3::from(config.gravity_m_s2) * scene.dt,
            1.0,
            config.ground_friction,
            config.ground_restitution,
        ),
        Some((other, other_velocity)) => (
            contact.displacement / length,
            length,
            velocity - other_velocity,
            other.physics.mass_kg / (unit.physics.mass_kg + other.physics.mass_kg),
            other.physics.friction,
            other.physics.restitution,
        ),
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

fn nearest<'s, K: Kernels, const UNITS: usize>(
    kernels: K,
    scene: &'s Scene<'_, UNITS>,
    found: Option<(usize, usize)>,
    index: usize,
    point: &Vector3<f32>,
) -> Contact {
    let target = |unit: &'s UnitState| {
        let points = scene.points_of(unit);
        Target { pose: &unit.current, points, radius: unit.radius }
    };
    let found = if K::INDEX {
        let point = |(unit, number): (usize, usize)| {
            let local = scene.points_of(scene.units.get(unit)?).get(number)?.coords;
            Some(Nearest::Point { unit, local })
        };
        found.and_then(point).unwrap_or(Nearest::Ground)
    } else {
        let mut search = Search::new(*point);
        let (first, around) = scene.around(index);
        for (j, unit) in (first..).zip(around) {
            if j != index {
                search.visit(kernels, j, &target(unit));
            }
        }
        search.nearest(kernels, |unit| scene.units.get(unit).map(target))
    };
    match found {
        Nearest::Ground => Contact { displacement: Vector3::new(0.0, 0.0, -point.z), other: None },
        Nearest::Point { unit, local } => {
            let pose =
                |at: fn(&UnitState) -> Pose| scene.units.get(unit).map(at).unwrap_or_default();
            let now = pose(|u| u.current);
            let increment = now.displacement_from(&pose(|u| u.previous), &local);
            Contact {
                displacement: now.apply(&local) - point,
                other: Some((unit, increment / scene.dt)),
            }
        }
    }
}
