//! Units that diverge, held while the others go on.

use super::report::StepReport;
use super::state::Simulator;
use crate::scene::{Quarantine, Role, UnitSlot};
#[cfg(feature = "health")]
use crate::stand_in::OfHealth;

impl UnitSlot {
    /// Whether quarantine takes it: a cluster moves as one, and a patch has no pose to be held at.
    fn can_be_held(&self) -> bool {
        self.is_free() && !self.is_soft() && self.cluster_root().is_none()
    }

    fn hold(&mut self) {
        self.set_quarantine(Quarantine::Now, Role::Fixed);
    }
}

#[cfg(feature = "health")]
impl Simulator<'_, '_> {
    /// Says what becomes of a free unit that diverges: whose next pose is not finite, or beyond 1e6 m. Without quarantine, as at
    /// first, the step fails, and the scene is what it was. With it the unit is held where it was, and the others go
    /// on. From then on it counts as [`Role::Fixed`]: others see it and touch it as they do scenery, in the same bits. It says
    /// [`is_quarantined`](crate::UnitView::is_quarantined) until [`set_poses`](Self::set_poses) gives it poses.
    ///
    /// A unit whose own motion leads nowhere is held before the network sees it. One that the network sends nowhere is held in that
    /// step, in which the others go where they would have gone beside it. A step takes as long as before, but for moving the units
    /// once more for each one that it holds.
    ///
    /// Units that a bond holds, and all units of a scene with soft ones, are not held: there a step fails as it does without quarantine.
    /// Units that are held stay so where quarantine is switched off.
    ///
    /// ```
    /// use nalgebra::{Isometry3, Point3};
    /// use rigidformer_core::{Limits, Model, Physics, Simulator, SlabSizes, Slabs, StepError, Unit, UnitSlot};
    /// # fn main() -> Result<(), Box<dyn std::error::Error>> {
    /// # let model = Model::load(rigidformer_weights::EDGE)?;
    /// # let limits = Limits { units: 2, points: 16 };
    /// # let sizes = SlabSizes::new(model.config(), limits);
    /// # let (mut numbers, mut bytes) = (vec![0.0; sizes.f32], vec![0; sizes.i8]);
    /// # let mut points = vec![Point3::origin(); sizes.points];
    /// # let mut units = vec![UnitSlot::EMPTY; sizes.units];
    /// # let slabs = Slabs { f32: &mut numbers, i8: &mut bytes, points: &mut points, units: &mut units };
    /// # let mut simulator = Simulator::new(&model, limits, slabs)?;
    /// # simulator.set_dt(1.0 / 24.0)?;
    /// # let corner = |i: usize, bit| if i & bit == 0 { -0.2 } else { 0.2 };
    /// # let cube: Vec<_> = (0..8).map(|i| Point3::new(corner(i, 1), corner(i, 2), corner(i, 4))).collect();
    /// # let rubber = Physics { mass_kg: 1.0, friction: 0.5, restitution: 0.5 };
    /// let at = |x, z| Isometry3::translation(x, 0.0, z);
    /// let lost = simulator.add(&Unit::new(&cube, rubber), &at(-9e5, 0.2), &at(9e5, 0.2))?; // a sensor's nonsense
    /// let falls = simulator.add(&Unit::new(&cube, rubber), &at(0.0, 1.0), &at(0.0, 1.0))?;
    /// assert_eq!(simulator.step(), Err(StepError::Diverged { unit: 0 }));
    /// simulator.set_quarantine(true);
    /// assert_eq!(simulator.step()?.quarantined_units, 1);
    /// assert!(simulator.get(lost).is_some_and(|unit| unit.is_quarantined()));
    /// assert!(simulator.pose(falls).is_some_and(|pose| pose.translation.z < 1.0));
    /// simulator.set_poses(lost, &at(1.0, 0.2), &at(1.0, 0.2))?;
    /// assert_eq!(simulator.step()?.quarantined_units, 0);
    /// # Ok(())
    /// # }
    /// ```
    pub fn set_quarantine(&mut self, holds: bool) {
        self.quarantines = OfHealth::new(holds);
    }

    /// Whether units that diverge are held: see [`set_quarantine`](Self::set_quarantine).
    pub fn quarantine(&self) -> bool {
        self.holds_lost()
    }
}

impl Simulator<'_, '_> {
    /// Whether units that diverge are held.
    fn holds_lost(&self) -> bool {
        self.quarantines.get().is_some_and(|holds| *holds)
    }

    /// Units of a copy that a step may hold at most.
    pub(super) fn most_held(&self) -> usize {
        if self.holds_lost() { self.scene.per_copy } else { 0 }
    }

    /// Holds the units whose own motion leads nowhere, before anything is computed of them.
    pub(super) fn hold_lost(&mut self) {
        if !self.holds_lost() || self.sizes.is_soft() {
            return;
        }
        let (fall, measure) = (self.scene.fall(), self.scene.measure);
        let units = self.scene.units_mut().iter_mut().filter(|unit| unit.can_be_held());
        for unit in units.filter(|unit| !measure.allows(&unit.free(&fall))) {
            unit.hold();
        }
    }

    /// Holds a unit of a copy in the step under way; whether it could.
    pub(super) fn hold(&mut self, copy: usize, unit: usize) -> bool {
        let number = copy * self.scene.per_copy + unit;
        let is_soft = self.sizes.is_soft();
        match self.scene.units_mut().get_mut(number) {
            Some(unit) if unit.can_be_held() && !is_soft => {
                unit.hold();
                true
            }
            _ => false,
        }
    }

    /// Ends a step of a copy: what it held stays so, or is as before where it failed.
    pub(super) fn end_holding(&mut self, copy: usize, has_failed: bool) {
        let per_copy = self.scene.per_copy;
        let units = self.scene.units_mut().iter_mut().skip(copy * per_copy).take(per_copy);
        let mut any = false;
        for unit in units.filter(|unit| unit.quarantine() == Quarantine::Now) {
            any = true;
            match has_failed {
                true => unit.set_quarantine(Quarantine::None, Role::Free),
                false => unit.set_quarantine(Quarantine::Held, unit.role),
            }
        }
        if any {
            self.forget_still();
        }
    }

    /// A report of a copy with its units in quarantine.
    pub(super) fn with_quarantined(&self, copy: usize, report: StepReport) -> StepReport {
        let per_copy = self.scene.per_copy;
        let units = self.scene.units().iter().skip(copy * per_copy).take(per_copy);
        // No more than there are units.
        let quarantined = units.filter(|unit| unit.is_quarantined()).count() as u32;
        report.with_quarantined(quarantined)
    }
}
