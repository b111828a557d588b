//! Whether the network corrects motion.

use super::state::Simulator;
#[cfg(rigidformer_host)]
use crate::contact::prior::{self, Solved};
#[cfg(rigidformer_host)]
use crate::kernels::in_own_environment;
#[cfg(rigidformer_host)]
use crate::scene::UnitId;
#[cfg(rigidformer_host)]
use nalgebra::{Matrix3, Point3, Vector3};

/// Where the last substep took a unit before the network's correction, with its motion at the end. Training learns what is left.
#[cfg(rigidformer_host)]
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Uncorrected {
    /// Of the unit's internal frame, about its centre: see [`UnitView::internal_pose`](crate::UnitView::internal_pose).
    pub rotation: Matrix3<f32>,
    /// Metres.
    pub centre: Point3<f64>,
    /// Of the centre in a substep at the velocity of the end, metres.
    pub way_m: Vector3<f32>,
    /// In a substep at the spin of the end, radians along the world's axes.
    pub turn_rad: Vector3<f32>,
    /// What a correction of 1 is, m/s. 0: nothing touches the unit; below 0: it rests, and nothing corrects it.
    pub share_m_s: f32,
}

impl Simulator<'_, '_> {
    /// Lets the network correct motion, as it does at first, or leaves it out: what a model is worth shows beside the same motion without it.
    ///
    /// Without the network its output is 0. Models that move units by impulses then move them by impulses alone, by the scene's
    /// [contact law](Self::set_contact_law).
    ///
    /// ```
    /// use nalgebra::{Isometry3, Point3};
    /// use rigidformer_core::{Limits, Model, Physics, Simulator, SlabSizes, Slabs, Unit, UnitSlot};
    /// # fn main() -> Result<(), Box<dyn std::error::Error>> {
    /// # let model = Model::load(rigidformer_weights::EDGE)?;
    /// # let limits = Limits { units: 1, points: 8 };
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
    /// let at = |z| Isometry3::translation(0.0, 0.0, z);
    /// let falls = simulator.add(&Unit::new(&cube, rubber), &at(0.3), &at(0.25))?;
    /// let before = simulator.velocity(falls).ok_or("no such unit")?;
    /// simulator.set_network(false);
    /// simulator.step()?;
    /// // It bounced, by impulses alone.
    /// assert!(simulator.velocity(falls).is_some_and(|v| before.linear_m_s.z < 0.0 && v.linear_m_s.z > 0.0));
    /// # Ok(())
    /// # }
    /// ```
    pub fn set_network(&mut self, corrects: bool) {
        self.has_network = corrects;
    }

    /// Whether the network corrects motion: see [`set_network`](Self::set_network). Models that have
    /// [`most_units`](rigidformer_weights::ModelConfig::most_units) leave copies of more units, and scenes whose
    /// [contact law](Self::set_contact_law) is not rigid, alone all the same. So does every model on a height field.
    pub fn has_network(&self) -> bool {
        self.has_network
    }

    /// Where the last substep took a unit of the first copy before the network's correction. `None`: there is no such unit, or the model
    /// does not move units by impulses. Before the first step, and after a change of the units, the numbers say nothing.
    ///
    /// ```
    /// use nalgebra::{Isometry3, Point3};
    /// use rigidformer_core::{Limits, Model, Physics, Simulator, SlabSizes, Slabs, Unit, UnitSlot};
    /// # fn main() -> Result<(), Box<dyn std::error::Error>> {
    /// # let model = Model::load(rigidformer_weights::EDGE)?;
    /// # let limits = Limits { units: 1, points: 8 };
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
    /// let at = |z| Isometry3::translation(0.0, 0.0, z);
    /// let falls = simulator.add(&Unit::new(&cube, rubber), &at(3.0), &at(3.0))?;
    /// simulator.step()?;
    /// // It touches nothing: nothing is left to correct.
    /// assert_eq!(simulator.uncorrected(falls).map(|u| u.share_m_s), Some(0.0));
    /// # Ok(())
    /// # }
    /// ```
    #[cfg(rigidformer_host)]
    pub fn uncorrected(&self, id: UnitId) -> Option<Uncorrected> {
        if self.sizes.solved == 0 {
            return None;
        }
        let index = self.number(id)?;
        in_own_environment(|| {
            let Solved { next, share } = prior::solved(&self.scene, index, self.lasting.solved);
            let measure = &self.scene.measure;
            let second = self.scene.second.get().copied().unwrap_or(1.0);
            Some(Uncorrected {
                rotation: next.pose.rotation,
                centre: measure.centre(&next),
                way_m: next.course.way * measure.length(),
                turn_rad: next.course.turn(),
                share_m_s: share * measure.length() / second,
            })
        })
    }

    /// Whether it does in a copy of as many units as there are, under the scene's contact law.
    pub(super) fn corrects(&self) -> bool {
        let most = self.model.config().most_units as usize;
        let is_known = self.scene.per_copy <= most && self.scene.contact_law.is_rigid();
        // No network has seen a height field.
        self.has_network && (most == 0 || is_known) && self.scene.terrain_digest().is_none()
    }
}
