//! How contacts that bounce differ from rigid ones.

use super::state::Simulator;
use crate::contact::law::ContactLaw;
use crate::error::EditError;

impl Simulator<'_, '_> {
    /// Says how contacts that bounce differ from rigid ones, in all copies of the scene: the law of whatever recorded it. Contacts are
    /// rigid until told otherwise, with the network and without it. It lasts beyond observations. It is for models that move units by
    /// impulses; with others it has no effect.
    ///
    /// ```
    /// use nalgebra::{Isometry3, Point3};
    /// use rigidformer_core::{ContactLaw, Limits, Model, Physics, Simulator, SlabSizes, Slabs, Unit, UnitSlot};
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
    /// # simulator.set_network(false);
    /// let at = |z| Isometry3::translation(0.0, 0.0, z);
    /// let falls = simulator.add(&Unit::new(&cube, rubber), &at(0.3), &at(0.25))?;
    /// let mut start = [0; 1024];
    /// let length = simulator.snapshot(&mut start)?;
    /// simulator.step()?;
    /// let rigid = simulator.velocity(falls).ok_or("no such unit")?.linear_m_s.z;
    ///
    /// simulator.restore(&start[..length])?;
    /// simulator.set_contact_law("0.03,pyramid".parse()?)?;
    /// simulator.step()?;
    /// // It bounced higher.
    /// assert!(simulator.velocity(falls).is_some_and(|v| v.linear_m_s.z > rigid));
    /// # Ok(())
    /// # }
    /// ```
    ///
    /// # Errors
    /// [`EditError::BadContactLaw`]; the law is what it was.
    pub fn set_contact_law(&mut self, law: ContactLaw) -> Result<(), EditError> {
        if !law.is_sound() {
            return Err(EditError::BadContactLaw);
        }
        self.scene.contact_law = law.plain();
        self.forget_still();
        Ok(())
    }

    /// How contacts that bounce differ from rigid ones: see [`set_contact_law`](Self::set_contact_law).
    pub fn contact_law(&self) -> ContactLaw {
        self.scene.contact_law
    }
}
