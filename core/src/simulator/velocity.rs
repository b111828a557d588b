//! Velocities, which the simulator keeps as the way and the turn of a substep.

use super::state::Simulator;
use crate::error::{EditError, ObserveError};
use crate::geometry::{Course, State, rotate};
use crate::kernels::in_own_environment;
use crate::limits::MAX_COORDINATE_M;
use crate::scene::{Quarantine, Role, UnitId, UnitSlot};
use crate::structure::heading::is_robot;
use core::borrow::Borrow;
use nalgebra::Vector3;

/// Greater turns of a substep are refused, radians: half a turn may have gone either way.
const MOST_TURN: f32 = 3.1;

/// How a unit moves now, at the end of its last step.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Velocity {
    /// Of the origin of the unit's reference frame, m/s.
    pub linear_m_s: Vector3<f32>,
    /// Along the world's axes, rad/s.
    pub angular_rad_s: Vector3<f32>,
}

impl Simulator<'_, '_> {
    /// How a unit moves now, in the first copy: a free one, at the end of its last step, in which gravity has acted to the end, also
    /// where two poses told its motion. A driven one, as in the last step; a fixed one not at all. A soft one, as the mean of its
    /// points, without a turn. In models of robots, where gravity is an input alone, the mean of the last step.
    ///
    /// ```
    /// use nalgebra::{Isometry3, Point3, Vector3};
    /// use rigidformer_core::{Limits, Model, Physics, Simulator, SlabSizes, Slabs, Unit, UnitSlot, Velocity};
    /// # fn main() -> Result<(), Box<dyn std::error::Error>> {
    /// # let model = Model::load(rigidformer_weights::EDGE)?;
    /// # let limits = Limits { units: 2, points: 16 };
    /// # let sizes = SlabSizes::new(model.config(), limits);
    /// # let (mut numbers, mut bytes) = (vec![0.0; sizes.f32], vec![0; sizes.i8]);
    /// # let mut points = vec![Point3::origin(); sizes.points];
    /// # let mut units = vec![UnitSlot::EMPTY; sizes.units];
    /// # let slabs = Slabs { f32: &mut numbers, i8: &mut bytes, points: &mut points, units: &mut units };
    /// # let mut simulator = Simulator::new(&model, limits, slabs)?;
    /// # let corner = |i: usize, bit| if i & bit == 0 { -0.2 } else { 0.2 };
    /// # let cube: Vec<_> = (0..8).map(|i| Point3::new(corner(i, 1), corner(i, 2), corner(i, 4))).collect();
    /// # let rubber = Physics { mass_kg: 1.0, friction: 0.5, restitution: 0.5 };
    /// simulator.set_dt(0.02)?;
    /// simulator.set_gravity(Vector3::new(0.0, 0.0, -9.81))?;
    /// let above = Isometry3::translation(0.0, 0.0, 5.0);
    /// let cube = simulator.add(&Unit::new(&cube, rubber), &above, &above)?;
    /// let thrown = Velocity { linear_m_s: Vector3::new(1.0, 0.0, 2.0), ..Velocity::default() };
    /// simulator.set_velocity(cube, &thrown)?;
    /// for _ in 0..10 {
    ///     simulator.step()?;
    /// }
    /// // 2 m/s upwards, and 0.2 s of gravity: the parabola of the books.
    /// let speed = simulator.velocity(cube).ok_or("no unit")?.linear_m_s;
    /// assert!((speed - Vector3::new(1.0, 0.0, 2.0 - 0.2 * 9.81)).norm() < 1e-3);
    /// let height = simulator.pose(cube).ok_or("no unit")?.translation.z;
    /// assert!((height - (5.0 + 2.0 * 0.2 - 9.81 * 0.2 * 0.2 / 2.0)).abs() < 1e-4);
    /// # Ok(())
    /// # }
    /// ```
    pub fn velocity(&self, id: UnitId) -> Option<Velocity> {
        self.velocity_in(0, id)
    }

    /// As [`velocity`](Self::velocity), in one of the [copies](Self::replicate).
    pub fn velocity_in(&self, copy: usize, id: UnitId) -> Option<Velocity> {
        let number = copy.checked_mul(self.scene.per_copy)?.checked_add(self.number(id)?)?;
        let unit = self.scene.units().get(number)?;
        Some(in_own_environment(|| self.velocity_of(unit)))
    }

    /// How all units move, in their order, those of the first copy.
    pub fn velocities(&self) -> impl Iterator<Item = Velocity> {
        let units = self.scene.units().iter().take(self.scene.per_copy);
        units.map(|unit| in_own_environment(|| self.velocity_of(unit)))
    }

    /// Says how a unit moves from now on, in the first copy, where it is: its velocity is what [`velocity`](Self::velocity) tells then,
    /// and without contact it flies as a thrown body does. A driven unit forgets its target, and a fixed one stays, without motion. A unit
    /// in quarantine is free again.
    ///
    /// # Errors
    /// [`EditError`], such as [`EditError::Spin`] beyond half a turn a step or substep; the unit is what it was.
    pub fn set_velocity(&mut self, id: UnitId, velocity: &Velocity) -> Result<(), EditError> {
        self.set_velocity_in(0, id, velocity)
    }

    /// As [`set_velocity`](Self::set_velocity), in one of the [copies](Self::replicate).
    ///
    /// # Errors
    /// As [`set_velocity`](Self::set_velocity).
    pub fn set_velocity_in(
        &mut self,
        copy: usize,
        id: UnitId,
        velocity: &Velocity,
    ) -> Result<(), EditError> {
        let (unit, number) = self.slot(copy, id)?;
        let unit = *unit;
        let course = in_own_environment(|| self.course_at((number, &unit), velocity))?;
        let (slot, _) = self.slot(copy, id)?;
        slot.move_on(course);
        self.forget_still();
        Ok(())
    }

    /// Says how all units of the first copy move from now on, in their order: as [`set_velocity`](Self::set_velocity).
    ///
    /// # Errors
    /// [`EditError::Velocities`] unless there is one a unit; else as [`set_velocity`](Self::set_velocity). All units are what they were.
    pub fn set_velocities<I>(&mut self, velocities: I) -> Result<(), EditError>
    where
        I: IntoIterator<Item: Borrow<Velocity>, IntoIter: Clone>,
    {
        let velocities = velocities.into_iter();
        let (found, units) = (velocities.clone().count(), self.scene.per_copy);
        if found != units {
            return Err(EditError::Velocities { found, units });
        }
        // All are tried before any is changed.
        for changes in [false, true] {
            for (number, velocity) in velocities.clone().enumerate() {
                let Some(unit) = self.scene.units().get(number).copied() else { break };
                let velocity = velocity.borrow();
                let course = in_own_environment(|| self.course_at((number, &unit), velocity))?;
                if let Some(slot) = self.scene.units_mut().get_mut(number).filter(|_| changes) {
                    slot.move_on(course);
                }
            }
        }
        self.forget_still();
        Ok(())
    }

    /// Seconds of a step or of its substeps; 0 before there is a time step.
    fn substep_s(&self) -> f32 {
        self.given.dt_s / self.scene.substeps() as f32
    }

    /// What gravity changes of a free unit's velocity from the middle of its last substep to the end, m/s.
    fn half_fall_m_s(&self, role: Role) -> Vector3<f32> {
        match role {
            // What a robot's gravity does is the network's to say.
            Role::Free if !is_robot(self.model.config()) => {
                self.given.gravity * (0.5 * self.substep_s())
            }
            _ => Vector3::zeros(),
        }
    }

    fn velocity_of(&self, unit: &UnitSlot) -> Velocity {
        let (seconds, length) = (self.substep_s(), self.scene.measure.length());
        // What is held does not move either.
        if unit.role == Role::Fixed || seconds <= 0.0 {
            return Velocity::default();
        }
        let angular_rad_s = unit.course.turn() / seconds;
        let of_centre = unit.course.way * length / seconds + self.half_fall_m_s(unit.role);
        Velocity { linear_m_s: of_centre - angular_rad_s.cross(&lever(unit)), angular_rad_s }
    }

    /// The course of a unit that moves so now.
    fn course_at(
        &self,
        (number, unit): (usize, &UnitSlot),
        velocity: &Velocity,
    ) -> Result<Course, EditError> {
        #[cfg(feature = "deform")]
        if unit.is_soft() {
            return Err(EditError::Deforms);
        }
        let (seconds, length) = (self.substep_s(), self.scene.measure.length());
        let Velocity { linear_m_s, angular_rad_s } = velocity;
        let turn = angular_rad_s * seconds;
        if crate::geometry::norm(&turn) > MOST_TURN {
            return Err(EditError::Spin { id: unit.id, limit_rad_s: MOST_TURN / seconds });
        }
        if unit.given_role() == Role::Fixed {
            return Ok(unit.resting().course);
        }
        let of_centre = linear_m_s + angular_rad_s.cross(&lever(unit));
        let way = (of_centre - self.half_fall_m_s(unit.given_role())) * seconds;
        let course = unit.course.moving(way / length, turn);
        let before = State { pose: State { pose: unit.current, course }.before(), course };
        match self.scene.measure.outward(&before).is_sound(MAX_COORDINATE_M) {
            true => Ok(course),
            false => Err(ObserveError::BadPose { unit: number }.into()),
        }
    }
}

impl UnitSlot {
    /// Goes on from where it is, with another motion.
    fn move_on(&mut self, course: Course) {
        (self.course, self.target) = (course, self.current);
        self.set_quarantine(Quarantine::None, self.given_role());
    }
}

/// From the origin of a unit's reference frame to its centre, metres.
fn lever(unit: &UnitSlot) -> Vector3<f32> {
    rotate(&unit.current.rotation, &unit.offset.coords)
}
