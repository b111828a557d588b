//! Copies of a scene that advance in lockstep: weights are read once for all of them.

use super::{Simulator, StepReport};
use crate::error::{CommandError, ObserveError, StepError};
use crate::geometry::Pose;
use crate::kernels::Kernels;
use crate::layers::{copy, part_mut};
use crate::projection::Projection;
use crate::scene::Physics;
use crate::trace::Trace;
use crate::workspace::command_places;
use crate::{config::MAX_COORDINATE_M, math};
use nalgebra::{Isometry3, Point3};

impl<const UNITS: usize, K: Kernels, P: Projection> Simulator<'_, '_, UNITS, K, P> {
    /// Copies of the scene: 1 after an observation, 0 before.
    pub fn copies(&self) -> usize {
        self.scene.copies()
    }

    /// Makes the first copy of the scene, as it is now, into so many; the others are dropped. The
    /// number of copies that there are now: less than `copies` where the limits have no room, 0
    /// before an observation. Each copy's result is that of the scene alone, bit for bit.
    pub fn replicate(&mut self, copies: usize) -> usize {
        let per_copy = self.scene.per_copy;
        self.scene.units.truncate(per_copy);
        for _ in 1..copies.min(self.sizes.copies) {
            for unit in 0..per_copy {
                // `with_kernels` saw to the room.
                let Some(state) = self.scene.units.get(unit).copied() else { continue };
                let _ = self.scene.units.push(state);
            }
        }
        self.scene.copies()
    }

    /// Drops the copies for which `keep`, called in ascending order, is false; those that stay
    /// move up.
    pub fn retain_copies(&mut self, mut keep: impl FnMut(usize) -> bool) {
        let per_copy = self.scene.per_copy;
        let film = command_places(&self.sizes) * 2 * self.sizes.width;
        let mut kept = 0;
        for from in 0..self.scene.copies() {
            if !keep(from) {
                continue;
            }
            if kept < from {
                for unit in 0..per_copy {
                    self.scene.units.swap(kept * per_copy + unit, from * per_copy + unit);
                }
                let (to, rest) = self.workspace.commands.split_at_mut(from * film);
                copy(rest, part_mut(to, kept * film, film));
            }
            kept += 1;
        }
        self.scene.units.truncate(kept * per_copy);
    }

    /// Gives one copy a command of its own, after [`set_command`](Self::set_command) has given
    /// one to all. `false` where there is no such copy.
    ///
    /// # Errors
    /// As [`set_command`](Self::set_command).
    pub fn set_copy_command(&mut self, copy: usize, command: &[f32]) -> Result<bool, CommandError> {
        self.check_command(command)?;
        let there = copy < self.scene.copies();
        if there {
            self.apply_command(copy, command);
        }
        Ok(there)
    }

    /// Changes where a unit of a copy was and is, as
    /// [`observe_poses`](Self::observe_poses) gives it; the first frame, which the inputs' offsets
    /// count from, stays the observed one. `false` where there is no such unit.
    ///
    /// # Errors
    /// [`ObserveError::BadPose`]; the unit is what it was.
    pub fn set_poses(
        &mut self,
        copy: usize,
        unit: usize,
        previous: &Isometry3<f32>,
        current: &Isometry3<f32>,
    ) -> Result<bool, ObserveError> {
        super::check_pose(unit, previous)?;
        super::check_pose(unit, current)?;
        let per_copy = self.scene.per_copy;
        let state = self.scene.units.get_mut(copy * per_copy + unit).filter(|_| unit < per_copy);
        let Some(state) = state else { return Ok(false) };
        let offset: Point3<f32> = state.offset;
        state.previous = Pose::from_isometry(previous, &offset);
        state.current = Pose::from_isometry(current, &offset);
        Ok(true)
    }

    /// Changes what a unit of a copy is made of. `false` where there is no such unit.
    ///
    /// # Errors
    /// [`ObserveError::BadPhysics`]; the unit is what it was.
    pub fn set_physics(
        &mut self,
        copy: usize,
        unit: usize,
        physics: Physics,
    ) -> Result<bool, ObserveError> {
        if !physics.is_sound() {
            return Err(ObserveError::BadPhysics { unit });
        }
        let per_copy = self.scene.per_copy;
        let state = self.scene.units.get_mut(copy * per_copy + unit).filter(|_| unit < per_copy);
        let Some(state) = state else { return Ok(false) };
        state.physics = physics;
        state.ln_mass = math::ln(physics.mass_kg);
        Ok(true)
    }

    /// Advances every copy by one step and tells `report` of each, in order. A copy that fails is
    /// what it was; the others go on. Layers go to `trace`, [`NoTrace`](crate::NoTrace) if nobody
    /// looks.
    ///
    /// # Errors
    /// [`StepError::NotObserved`] or [`StepError::NoCommand`]: nothing was advanced.
    pub fn step_copies<T: Trace>(
        &mut self,
        trace: &mut T,
        mut report: impl FnMut(usize, Result<StepReport, StepError>),
    ) -> Result<(), StepError> {
        self.predict(trace)?;
        for copy in 0..self.scene.copies() {
            let outcome = self.advance(copy, trace);
            report(copy, outcome);
        }
        Ok(())
    }
}

/// Whether a pose is a rotation and a place that an observation accepts.
pub(super) fn is_sound(isometry: &Isometry3<f32>) -> bool {
    let q = isometry.rotation.as_ref().coords;
    let length = (q.x * q.x + q.y * q.y) + (q.z * q.z + q.w * q.w);
    let sound = Pose::from_isometry(isometry, &Point3::origin());
    sound.is_sound(MAX_COORDINATE_M) && (length - 1.0).abs() <= 1e-3
}
