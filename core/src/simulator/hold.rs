//! Units of single copies that are held where their caller puts them.

use super::state::Simulator;
use crate::error::EditError;
use crate::scene::{Quarantine, Role, UnitId};
use nalgebra::Isometry3;

impl Simulator<'_, '_> {
    /// Puts a unit of one of the [copies](Self::replicate) at a pose, where it stays: a free one is held as by
    /// [quarantine](Self::set_quarantine), until [`set_poses_in`](Self::set_poses_in) lets it go.
    ///
    /// # Errors
    /// [`EditError`]; the unit is what it was.
    pub fn hold_in(
        &mut self,
        copy: usize,
        id: UnitId,
        pose: &Isometry3<f32>,
    ) -> Result<(), EditError> {
        let (unit, _) = self.slot(copy, id)?;
        if unit.cluster_root().is_some() {
            return Err(EditError::Bonded { id });
        }
        self.set_poses_in(copy, id, pose, pose)?;
        let (unit, _) = self.slot(copy, id)?;
        if unit.is_free() {
            unit.set_quarantine(Quarantine::Held, Role::Fixed);
            unit.course = unit.resting().course;
        }
        Ok(())
    }
}
