//! Units, anchors and poses: the state that a rollout carries.

use crate::config::ANCHORS;
use crate::geometry::Pose;
use nalgebra::{Point3, Vector3};

/// What a unit is made of.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Physics {
    /// Mass, kg, from 1e-9 to 1e9.
    pub mass_kg: f32,
    /// Friction coefficient, from 0 to 1000.
    pub friction: f32,
    /// Restitution coefficient, from 0 to 1000.
    pub restitution: f32,
}

impl Physics {
    pub(crate) fn is_sound(&self) -> bool {
        (1e-9..=1e9).contains(&self.mass_kg)
            && (0.0..=1e3).contains(&self.friction)
            && (0.0..=1e3).contains(&self.restitution)
    }
}

/// Who moves a unit.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
#[non_exhaustive]
pub enum Role {
    /// The model moves it.
    #[default]
    Free,
    /// It goes exactly where it is told in the next step. The network sees that motion and never moves it.
    Driven,
    /// Scenery: it never moves.
    Fixed,
}

/// One rigid object or part, in its reference frame.
#[derive(Clone, Copy, Debug)]
pub struct Unit<'a> {
    /// Points in the reference frame, metres, at least 4, in any order.
    pub points: &'a [Point3<f32>],
    /// What it is made of.
    pub physics: Physics,
}

/// A unit as the scene keeps it.
#[derive(Clone, Copy, Debug)]
pub(crate) struct UnitState {
    /// Its points in the scene's point slab: relative to the centre, in farthest-point
    /// order, so that the first [`ANCHORS`] are the anchors.
    pub(crate) start: usize,
    pub(crate) count: usize,
    pub(crate) physics: Physics,
    /// Natural logarithm of the mass in kg.
    pub(crate) ln_mass: f32,
    /// Radius about the centre, metres.
    pub(crate) radius: f32,
    /// The centre in the caller's reference frame.
    pub(crate) offset: Point3<f32>,
    /// Its extreme points in the scene's slab of those, from `start` on; 0 for models without impacts.
    pub(crate) hull: usize,
    /// Principal moments of inertia of a kilogram that fills the box around the points, m^2.
    pub(crate) inertia_m2: Vector3<f32>,
    /// Pose in the first frame, which the offset feature refers to.
    pub(crate) first: Pose,
    pub(crate) previous: Pose,
    pub(crate) current: Pose,
}

/// The state of a rollout: up to `UNITS` units, of one scene or of several copies of it.
pub(crate) struct Scene<'s, const UNITS: usize> {
    /// Copy after copy; all copies have the same units.
    pub(crate) units: heapless::Vec<UnitState, UNITS>,
    /// Units of a copy.
    pub(crate) per_copy: usize,
    pub(crate) points: &'s mut [Point3<f32>],
    /// Extreme points of the units; empty for models without impacts.
    pub(crate) hulls: &'s mut [Point3<f32>],
    /// Step code.
    pub(crate) step: u32,
    /// Seconds.
    pub(crate) dt: f32,
}

impl<const UNITS: usize> Scene<'_, UNITS> {
    /// Copies of the scene.
    pub(crate) fn copies(&self) -> usize {
        if cfg!(not(rigidformer_host)) {
            return 1;
        }
        self.units.len().checked_div(self.per_copy).unwrap_or_default()
    }

    /// The units that a unit meets, itself among them: the first one's index, and all of them.
    pub(crate) fn around(&self, unit: usize) -> (usize, &[UnitState]) {
        if cfg!(not(rigidformer_host)) {
            return (0, &self.units);
        }
        let per_copy = self.per_copy.max(1);
        let first = unit / per_copy * per_copy;
        (first, self.units.get(first..first + per_copy).unwrap_or_default())
    }

    /// Points of a copy.
    pub(crate) fn points_per_copy(&self) -> usize {
        let last = match self.per_copy.checked_sub(1) {
            Some(last) if cfg!(rigidformer_host) => self.units.get(last),
            _ => self.units.last(),
        };
        last.map_or(0, |last| last.start + last.count)
    }

    /// A unit's points in its local frame.
    pub(crate) fn points_of(&self, unit: &UnitState) -> &[Point3<f32>] {
        self.points.get(unit.start..unit.start + unit.count).unwrap_or_default()
    }

    /// A unit's extreme points in its local frame.
    pub(crate) fn hull_of(&self, unit: &UnitState) -> &[Point3<f32>] {
        self.hulls.get(unit.start..unit.start + unit.hull).unwrap_or_default()
    }

    /// A unit's anchors in its local frame.
    pub(crate) fn anchors_of(&self, unit: &UnitState) -> [Vector3<f32>; ANCHORS] {
        let mut anchors = [Vector3::zeros(); ANCHORS];
        for (anchor, point) in anchors.iter_mut().zip(self.points_of(unit)) {
            *anchor = point.coords;
        }
        anchors
    }
}
