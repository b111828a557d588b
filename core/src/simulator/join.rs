//! Joints between units.

use super::state::Simulator;
use crate::error::JoinError;
use crate::kernels::in_own_environment;
use crate::limits::MAX_COORDINATE_M;
use crate::scene::{UnitId, UnitSlot};
use crate::structure::joints::{Joint, hangs_from};
use crate::structure::link::Link;

impl Simulator<'_, '_> {
    /// Hangs a unit from another by a pivot, in all copies of the scene: from the next step on the two stay together there.
    /// A unit that hangs already hangs from the new parent alone.
    ///
    /// Each step ends with pushes at the pivots, which move and turn both units, and then moves centres until the images meet
    /// (docs/MODEL.md, section 7). Units that hang together keep their centre of mass. Where driven or fixed ones are among
    /// them, those stay, and the others hang from them. Joints outlast all changes but
    /// [`unjoin`](Self::unjoin), the removal of one of the two and another observation. A unit that has just been joined jumps to its
    /// place in the next step, and gets the velocity of that.
    ///
    /// # Errors
    /// [`JoinError`]; the joints are what they were.
    pub fn join(&mut self, joint: &Joint) -> Result<(), JoinError> {
        in_own_environment(|| self.join_here(joint))
    }

    fn join_here(&mut self, joint: &Joint) -> Result<(), JoinError> {
        for id in [joint.unit, joint.parent] {
            self.number(id).ok_or(JoinError::NoSuchUnit { id })?;
        }
        let is_bonded = |unit: &&UnitSlot| {
            unit.cluster_root().is_some() && [joint.unit, joint.parent].contains(&unit.id)
        };
        if let Some(unit) = self.scene.units().iter().find(is_bonded) {
            return Err(JoinError::Bonded { id: unit.id });
        }
        #[cfg(feature = "deform")]
        for id in [joint.unit, joint.parent] {
            if self.get(id).is_some_and(|unit| unit.is_soft()) {
                return Err(JoinError::Deforms { id });
            }
        }
        // A NaN compares as not within the limit.
        let is_near = |v: &f32| v.abs() <= MAX_COORDINATE_M;
        if !joint.pivot.iter().chain(joint.parent_pivot.iter()).all(is_near) {
            return Err(JoinError::BadPivot { id: joint.unit });
        }
        let copy = self.scene.units().get(..self.scene.per_copy).unwrap_or_default();
        if hangs_from(copy, joint.parent, joint.unit) {
            return Err(JoinError::Circle { id: joint.unit, parent: joint.parent });
        }
        self.link(joint.unit, joint.link());
        Ok(())
    }

    /// Lets a unit go from its parent, in all copies of the scene: the joint that it had, none if it hung from no unit.
    ///
    /// # Errors
    /// [`JoinError::NoSuchUnit`]
    pub fn unjoin(&mut self, id: UnitId) -> Result<Option<Joint>, JoinError> {
        self.number(id).ok_or(JoinError::NoSuchUnit { id })?;
        let joint = self.joints().find(|joint| joint.unit == id);
        self.link(id, Link::NONE);
        Ok(joint)
    }

    /// Joints in the order of the units that hang.
    pub fn joints(&self) -> impl Iterator<Item = Joint> {
        self.scene.units().iter().take(self.scene.per_copy).filter_map(Joint::of)
    }

    fn link(&mut self, id: UnitId, link: Link) {
        for unit in self.scene.units_mut().iter_mut().filter(|unit| unit.id == id) {
            unit.link = link;
        }
    }
}
