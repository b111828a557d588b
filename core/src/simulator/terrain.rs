//! Ground of varying height.

use super::state::Simulator;
use crate::contact::height_field::{HeightField, HeightFieldError};
use crate::error::EditError;
use crate::kernels::in_own_environment;
use crate::scene::Terrain;

impl<'s> Simulator<'_, 's> {
    /// Puts the scene, in all its copies, on ground of varying height, besides its planes; `None` takes it away. It lasts beyond
    /// observations, and is borrowed as long as the simulator lives. Contact with it is rigid on its side.
    ///
    /// Impulses alone move units there: no network has seen such ground ([`has_network`](Self::has_network)). Snapshots do not
    /// hold it: what goes on from one is on the same field.
    ///
    /// ```
    /// use nalgebra::{Isometry3, Point3, Vector3};
    /// use rigidformer_core::{HeightField, Limits, Model, Physics, Simulator, SlabSizes, Slabs, Unit, UnitSlot};
    /// # fn main() -> Result<(), Box<dyn std::error::Error>> {
    /// # let model = Model::load(rigidformer_weights::EDGE)?;
    /// # let limits = Limits { units: 1, points: 8 };
    /// # let sizes = SlabSizes::new(model.config(), limits);
    /// # let (mut numbers, mut bytes) = (vec![0.0; sizes.f32], vec![0; sizes.i8]);
    /// # let mut points = vec![Point3::origin(); sizes.points];
    /// # let mut units = vec![UnitSlot::EMPTY; sizes.units];
    /// // Ground that is half a metre higher beyond y = 0.
    /// let heights_m = [0.0, 0.0, 0.0, 0.0, 0.5, 0.5, 0.5, 0.5];
    /// let step = HeightField {
    ///     heights_m: &heights_m,
    ///     columns: 2,
    ///     spacing_m: [4.0, 1.0],
    ///     corner_m: Vector3::new(-2.0, -1.5, 0.0),
    ///     friction: 0.8,
    ///     restitution: 0.1,
    /// };
    /// # let slabs = Slabs { f32: &mut numbers, i8: &mut bytes, points: &mut points, units: &mut units };
    /// # let mut simulator = Simulator::new(&model, limits, slabs)?;
    /// # simulator.set_dt(1.0 / 24.0)?;
    /// # let corner = |i: usize, bit| if i & bit == 0 { -0.2 } else { 0.2 };
    /// # let cube: Vec<_> = (0..8).map(|i| Point3::new(corner(i, 1), corner(i, 2), corner(i, 4))).collect();
    /// # let wood = Physics { mass_kg: 1.0, friction: 0.5, restitution: 0.1 };
    /// simulator.set_height_field(Some(step))?;
    /// let above = Isometry3::translation(0.0, 1.0, 0.75);
    /// let cube = simulator.add(&Unit::new(&cube, wood), &above, &above)?;
    /// (0..24).try_for_each(|_| simulator.step().map(drop))?;
    /// // It lies half a metre higher than on the plane z = 0.
    /// assert!(simulator.pose(cube).is_some_and(|pose| (pose.translation.z - 0.7).abs() < 1e-3));
    /// # Ok(())
    /// # }
    /// ```
    ///
    /// # Errors
    /// [`EditError::HeightField`]; the ground is what it was.
    pub fn set_height_field(&mut self, field: Option<HeightField<'s>>) -> Result<(), EditError> {
        let terrain = match field {
            None => None,
            Some(_) if self.sizes.solved == 0 => return Err(HeightFieldError::Model.into()),
            Some(field) => Some(in_own_environment(|| {
                field.check()?;
                Ok::<_, HeightFieldError>(Terrain {
                    field,
                    highest_m: field.highest_m(),
                    digest: field.digest(),
                })
            })?),
        };
        self.scene.terrain = terrain;
        self.forget_still();
        Ok(())
    }

    /// The ground of varying height: see [`set_height_field`](Self::set_height_field).
    pub fn height_field(&self) -> Option<HeightField<'s>> {
        self.scene.terrain.map(|terrain| terrain.field)
    }
}
