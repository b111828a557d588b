//! A simulator of any capacity, behind one interface.

use crate::types::rf_status::{
    RF_ERROR_NO_SUCH_UNIT, RF_ERROR_POINT_COUNTS, RF_ERROR_TOO_MANY_UNITS,
};
use crate::types::{rf_detail, rf_internal_pose, rf_physics, rf_pose};
use nalgebra::{Isometry3, Point3, Quaternion, Translation3, UnitQuaternion};
use rigidformer_core::{Native, Observation, Physics, Simulator, StepReport, Unit};

/// The kernels of the target, and a simulator that has its model and slabs for as long as it wants:
/// `handle` sees to that.
pub(crate) type Sim<const UNITS: usize> = Simulator<'static, 'static, UNITS, Native>;

/// The units of an observation: unit i has the next `counts[i]` points of each frame.
#[derive(Clone, Copy)]
pub(crate) struct Units<'a> {
    pub(crate) physics: &'a [rf_physics],
    pub(crate) counts: &'a [u32],
}

/// What the C functions ask of a simulator.
pub(crate) trait Engine {
    fn observe(
        &mut self,
        step: u32,
        units: Units<'_>,
        previous: &[Point3<f32>],
        current: &[Point3<f32>],
    ) -> Result<Observation, rf_detail>;

    fn observe_poses(
        &mut self,
        step: u32,
        units: Units<'_>,
        points: &[Point3<f32>],
        previous: &[rf_pose],
        current: &[rf_pose],
    ) -> Result<Observation, rf_detail>;

    fn set_command(&mut self, command: &[f32]) -> Result<(), rf_detail>;

    fn step(&mut self) -> Result<StepReport, rf_detail>;

    fn len(&self) -> usize;

    fn pose(&self, unit: usize) -> Option<rf_pose>;

    fn internal_pose(&self, unit: usize) -> Option<rf_internal_pose>;

    /// How many points a unit has.
    fn point_count(&self, unit: usize) -> Result<usize, rf_detail>;

    /// Shows a unit's points to `put`, in the order of the simulator.
    fn points(&self, unit: usize, put: &mut dyn FnMut(usize, [f32; 3]));
}

impl<const UNITS: usize> Engine for Sim<UNITS> {
    fn observe(
        &mut self,
        step: u32,
        units: Units<'_>,
        previous: &[Point3<f32>],
        current: &[Point3<f32>],
    ) -> Result<Observation, rf_detail> {
        let mut physics = [NOTHING; UNITS];
        let physics = units.physics(&mut physics)?;
        let (mut before, mut now) = ([NO_POINTS; UNITS], [NO_POINTS; UNITS]);
        let before = units.split(previous, &mut before)?;
        let now = units.split(current, &mut now)?;
        Ok(Simulator::observe(self, step, physics, before, now)?)
    }

    fn observe_poses(
        &mut self,
        step: u32,
        units: Units<'_>,
        points: &[Point3<f32>],
        previous: &[rf_pose],
        current: &[rf_pose],
    ) -> Result<Observation, rf_detail> {
        let mut whole = [Unit { points: NO_POINTS, physics: NOTHING }; UNITS];
        let mut by_unit = [NO_POINTS; UNITS];
        let by_unit = units.split(points, &mut by_unit)?;
        let whole = whole.get_mut(..by_unit.len()).unwrap_or_default();
        for ((unit, points), physics) in whole.iter_mut().zip(by_unit).zip(units.physics) {
            *unit = Unit { points, physics: (*physics).into() };
        }
        let (mut before, mut now) =
            ([Isometry3::identity(); UNITS], [Isometry3::identity(); UNITS]);
        let before = isometries(previous, &mut before);
        let now = isometries(current, &mut now);
        Ok(Simulator::observe_poses(self, step, whole, before, now)?)
    }

    fn set_command(&mut self, command: &[f32]) -> Result<(), rf_detail> {
        Ok(Simulator::set_command(self, command)?)
    }

    fn step(&mut self) -> Result<StepReport, rf_detail> {
        Ok(Simulator::step(self)?)
    }

    fn len(&self) -> usize {
        Simulator::len(self)
    }

    fn pose(&self, unit: usize) -> Option<rf_pose> {
        let pose = Simulator::pose(self, unit)?;
        let (p, q) = (pose.translation.vector, pose.rotation.as_ref().coords);
        Some(rf_pose { position: [p.x, p.y, p.z], quaternion: [q.x, q.y, q.z, q.w] })
    }

    fn internal_pose(&self, unit: usize) -> Option<rf_internal_pose> {
        let pose = Simulator::internal_pose(self, unit)?;
        let (r, c) = (pose.rotation, pose.centre);
        Some(rf_internal_pose {
            rotation: [r.m11, r.m12, r.m13, r.m21, r.m22, r.m23, r.m31, r.m32, r.m33],
            centre: [c.x, c.y, c.z],
        })
    }

    fn point_count(&self, unit: usize) -> Result<usize, rf_detail> {
        let units = Simulator::len(self);
        if unit >= units {
            let detail = rf_detail::numbers(RF_ERROR_NO_SUCH_UNIT, 0, units as u64);
            return Err(rf_detail { unit: unit as u32, ..detail });
        }
        Ok(Simulator::points(self, unit).count())
    }

    fn points(&self, unit: usize, put: &mut dyn FnMut(usize, [f32; 3])) {
        for (at, point) in Simulator::points(self, unit).enumerate() {
            put(at, [point.x, point.y, point.z]);
        }
    }
}

const NOTHING: Physics = Physics { mass_kg: 0.0, friction: 0.0, restitution: 0.0 };
const NO_POINTS: &[Point3<f32>] = &[];

impl From<rf_physics> for Physics {
    fn from(physics: rf_physics) -> Self {
        let rf_physics { mass_kg, friction, restitution } = physics;
        Physics { mass_kg, friction, restitution }
    }
}

impl Units<'_> {
    /// The first so many slots, filled.
    fn physics<'o>(&self, slots: &'o mut [Physics]) -> Result<&'o [Physics], rf_detail> {
        let capacity = slots.len();
        let slots = slots.get_mut(..self.physics.len()).ok_or_else(|| self.too_many(capacity))?;
        for (slot, physics) in slots.iter_mut().zip(self.physics) {
            *slot = (*physics).into();
        }
        Ok(slots)
    }

    /// The first so many slots, each with the points of its unit.
    fn split<'p, 'o>(
        &self,
        points: &'p [Point3<f32>],
        slots: &'o mut [&'p [Point3<f32>]],
    ) -> Result<&'o [&'p [Point3<f32>]], rf_detail> {
        let capacity = slots.len();
        let slots = slots.get_mut(..self.counts.len()).ok_or_else(|| self.too_many(capacity))?;
        let sum = self.counts.iter().fold(0_u64, |sum, count| sum.saturating_add((*count).into()));
        if sum != points.len() as u64 {
            return Err(rf_detail::numbers(RF_ERROR_POINT_COUNTS, sum, points.len() as u64));
        }
        let mut rest = points;
        for (slot, count) in slots.iter_mut().zip(self.counts) {
            // The counts add up to the length.
            let (unit, after) = rest.split_at_checked(*count as usize).unwrap_or((rest, NO_POINTS));
            (*slot, rest) = (unit, after);
        }
        Ok(slots)
    }

    fn too_many(&self, capacity: usize) -> rf_detail {
        let found = self.physics.len() as u64;
        rf_detail::numbers(RF_ERROR_TOO_MANY_UNITS, found, capacity as u64)
    }
}

fn isometries<'o>(poses: &[rf_pose], slots: &'o mut [Isometry3<f32>]) -> &'o [Isometry3<f32>] {
    // As many as there are units, of which `split` found not too many.
    let slots = slots.get_mut(..poses.len()).unwrap_or_default();
    for (slot, pose) in slots.iter_mut().zip(poses) {
        let ([x, y, z], [i, j, k, w]) = (pose.position, pose.quaternion);
        // Its length is the simulator's to check.
        let rotation = UnitQuaternion::new_unchecked(Quaternion::new(w, i, j, k));
        *slot = Isometry3::from_parts(Translation3::new(x, y, z), rotation);
    }
    slots
}
