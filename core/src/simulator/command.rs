//! Changes of the scene between steps. One that is refused changes nothing.

use super::measure::{Census, Time, check_dt};
use super::observe::{check_pose, place_of};
use super::state::Simulator;
use crate::contact::ground::Plane;
use crate::error::{CommandError, EditError, ObserveError};
use crate::kernels::in_own_environment;
use crate::limits::{ANCHORS, MAX_DRIVEN_M_S, MAX_PLANES};
use crate::measure::{Pace, is_similar};
use crate::scene::{Compliance, Physics, Quarantine, Role, Unit, UnitId, UnitSlot};
use crate::slices::{copy_slice, rows_mut, slice_at_mut};
use crate::stand_in::OfCompliance;
use nalgebra::{Isometry3, Vector3};

/// The largest component of gravity, m/s^2.
pub(super) const MAX_GRAVITY_M_S2: f32 = 1e4;

impl Simulator<'_, '_> {
    /// Adds a unit behind the others, given its poses a step ago and now; the same twice for a unit at rest, whose velocity is 0
    /// now, not in the mean of the step. The other units go on as if nothing had happened to them. Models that measure scenes in their own length take that of the first unit,
    /// and once more that of the first free one (docs/MODEL.md, section 1).
    ///
    /// # Errors
    /// [`EditError`]; the scene is what it was. `unit` in it is the number that the unit would have had.
    pub fn add(
        &mut self,
        unit: &Unit<'_>,
        previous: &Isometry3<f32>,
        current: &Isometry3<f32>,
    ) -> Result<UnitId, EditError> {
        in_own_environment(|| self.add_here(unit, previous, current))
    }

    fn add_here(
        &mut self,
        unit: &Unit<'_>,
        previous: &Isometry3<f32>,
        current: &Isometry3<f32>,
    ) -> Result<UnitId, EditError> {
        self.one_copy()?;
        if self.given.dt_s <= 0.0 {
            return Err(EditError::NoTimestep);
        }
        let number = self.scene.per_copy;
        #[cfg(feature = "deform")]
        if unit.soft.is_some() {
            return Err(ObserveError::SoftPose { unit: number }.into());
        }
        let mut room = self.room_left();
        room.take(number, unit)?;
        room.taken()?;
        check_pose(number, previous)?;
        check_pose(number, current)?;
        let place = place_of(unit, current);
        let is_held = |other: &UnitSlot| other.given_role() != Role::Free;
        let is_first = unit.role == Role::Free && self.scene.units().iter().all(is_held);
        if is_similar(self.model.config()) && (number == 0 || is_first) {
            let mut census = Census::default();
            census.take(self.model.config(), unit);
            let (measure, time) = self.measured(self.given.dt_s, &census, &place)?;
            // Of another unit's measure only the length counts: places are counted from where they were.
            let origin = if number == 0 { measure } else { self.scene.measure }.origin();
            let measure = measure.from(origin);
            // There is no free unit for gravity to matter to.
            self.retime(&time, &Vector3::zeros())?;
            self.rescale(&measure);
            self.set_measure(measure);
            self.set_time(time);
        } else if number == 0 {
            self.set_measure(self.about(&self.scene.measure, &place));
        }
        self.come_nearer(&place);
        Ok(self.add_posed(unit, previous, current))
    }

    /// Removes a unit. The others keep their names and their order, and go on as if it had never been there.
    ///
    /// # Errors
    /// [`EditError`]; the scene is what it was.
    pub fn remove(&mut self, id: UnitId) -> Result<(), EditError> {
        self.one_copy()?;
        let number = self.number(id).ok_or(EditError::NoSuchUnit { id })?;
        let unit = *self.slot(0, id)?.0;
        let (start, count) = (unit.start, unit.count);
        let behind = self.scene.points_per_copy().saturating_sub(start + count);
        move_down(self.scene.points, start, count, behind);
        move_down(self.lasting.avp_weights, start * ANCHORS, count * ANCHORS, behind * ANCHORS);
        let (hull_start, rows) = (unit.hull_start, unit.hull_rows());
        let behind = self.scene.hull_rows_per_copy().saturating_sub(hull_start + rows);
        move_down(self.scene.hulls, hull_start, rows, behind);
        let later = self.scene.per_copy.saturating_sub(number + 1);
        move_down(self.scene.slots, number, 1, later);
        self.scene.per_copy = self.scene.per_copy.saturating_sub(1);
        self.scene.count = self.scene.per_copy;
        for unit in self.scene.units_mut().iter_mut().skip(number) {
            unit.start = unit.start.saturating_sub(count);
            unit.hull_start = unit.hull_start.saturating_sub(rows);
        }
        #[cfg(feature = "robot")]
        crate::structure::joints::forget(self.scene.units_mut(), id);
        #[cfg(feature = "deform")]
        crate::structure::bonds::forget(self.scene.units_mut(), &mut self.bonds, number);
        self.index_from(number);
        self.forget_still();
        Ok(())
    }

    /// Tells a driven unit where to be after the next step, in the first copy of the scene. It stays there until it is
    /// told again. Along each axis it goes at most [`MAX_DRIVEN_M_S`](crate::MAX_DRIVEN_M_S).
    ///
    /// # Errors
    /// [`EditError`]; the unit is what it was.
    pub fn drive(&mut self, id: UnitId, pose: &Isometry3<f32>) -> Result<(), EditError> {
        self.drive_in(0, id, pose)
    }

    /// As [`drive`](Self::drive), in one of the [copies](Self::replicate).
    ///
    /// # Errors
    /// As [`drive`](Self::drive).
    pub fn drive_in(
        &mut self,
        copy: usize,
        id: UnitId,
        pose: &Isometry3<f32>,
    ) -> Result<(), EditError> {
        in_own_environment(|| self.drive_here(copy, id, pose))
    }

    fn drive_here(
        &mut self,
        copy: usize,
        id: UnitId,
        pose: &Isometry3<f32>,
    ) -> Result<(), EditError> {
        let (measure, dt_s) = (self.scene.measure, self.given.dt_s);
        let (unit, number) = self.slot(copy, id)?;
        if unit.role != Role::Driven {
            return Err(EditError::NotDriven { id });
        }
        check_pose(number, pose)?;
        let target = measure.inward_isometry(pose, &unit.offset);
        let way_m = (target.centre - unit.current.centre) * measure.length();
        if dt_s > 0.0 && way_m.amax() > MAX_DRIVEN_M_S * dt_s {
            return Err(EditError::Jump { id, limit_m_s: MAX_DRIVEN_M_S });
        }
        unit.target = target;
        Ok(())
    }

    /// Changes where a unit was a step ago and is now, in the first copy of the scene; the same pose twice is rest. The first frame,
    /// which the inputs' offsets count from, stays the observed one. A driven unit forgets its target and stays. A unit in
    /// quarantine is free again.
    ///
    /// # Errors
    /// [`EditError`]; the unit is what it was.
    pub fn set_poses(
        &mut self,
        id: UnitId,
        previous: &Isometry3<f32>,
        current: &Isometry3<f32>,
    ) -> Result<(), EditError> {
        self.set_poses_in(0, id, previous, current)
    }

    /// As [`set_poses`](Self::set_poses), in one of the [copies](Self::replicate).
    ///
    /// # Errors
    /// As [`set_poses`](Self::set_poses).
    pub fn set_poses_in(
        &mut self,
        copy: usize,
        id: UnitId,
        previous: &Isometry3<f32>,
        current: &Isometry3<f32>,
    ) -> Result<(), EditError> {
        in_own_environment(|| self.set_poses_here(copy, id, previous, current))
    }

    fn set_poses_here(
        &mut self,
        copy: usize,
        id: UnitId,
        previous: &Isometry3<f32>,
        current: &Isometry3<f32>,
    ) -> Result<(), EditError> {
        let (unit, number) = self.slot(copy, id)?;
        #[cfg(feature = "deform")]
        if unit.is_soft() {
            return Err(EditError::Deforms);
        }
        check_pose(number, previous)?;
        check_pose(number, current)?;
        let (role, offset) = (unit.given_role(), unit.offset);
        self.come_nearer(&(current * offset).coords);
        let measure = self.scene.measure;
        let pose = |isometry| measure.inward_isometry(isometry, &offset);
        let (previous, current) = (pose(previous), pose(current));
        let course = self.course_between(role, &previous, &current);
        let (unit, _) = self.slot(copy, id)?;
        (unit.current, unit.course, unit.target) = (current, course, current);
        unit.set_quarantine(Quarantine::None, role);
        self.forget_still();
        Ok(())
    }

    /// Changes what a unit is made of, in the first copy of the scene. Its moments of inertia change as its mass does.
    ///
    /// # Errors
    /// [`EditError`]; the unit is what it was.
    pub fn set_physics(&mut self, id: UnitId, physics: Physics) -> Result<(), EditError> {
        self.set_physics_in(0, id, physics)
    }

    /// As [`set_physics`](Self::set_physics), in one of the [copies](Self::replicate).
    ///
    /// # Errors
    /// As [`set_physics`](Self::set_physics).
    pub fn set_physics_in(
        &mut self,
        copy: usize,
        id: UnitId,
        physics: Physics,
    ) -> Result<(), EditError> {
        in_own_environment(|| self.set_physics_here(copy, id, physics))
    }

    fn set_physics_here(
        &mut self,
        copy: usize,
        id: UnitId,
        physics: Physics,
    ) -> Result<(), EditError> {
        let measure = self.scene.measure;
        let (unit, number) = self.slot(copy, id)?;
        if !physics.is_sound() {
            return Err(ObserveError::BadPhysics { unit: number }.into());
        }
        unit.set_physics(physics, &measure);
        // A patch shares its mass out among its points, and each point has its friction.
        #[cfg(feature = "deform")]
        if unit.is_soft() {
            self.bind(copy);
        }
        self.forget_still();
        Ok(())
    }

    /// Changes how contact with a unit gives way, in the first copy of the scene.
    ///
    /// # Errors
    /// [`EditError`]; the unit is what it was.
    #[cfg(feature = "compliance")]
    pub fn set_compliance(&mut self, id: UnitId, compliance: Compliance) -> Result<(), EditError> {
        self.set_compliance_in(0, id, compliance)
    }

    /// As [`set_compliance`](Self::set_compliance), in one of the [copies](Self::replicate).
    ///
    /// # Errors
    /// As [`set_compliance`](Self::set_compliance).
    #[cfg(feature = "compliance")]
    pub fn set_compliance_in(
        &mut self,
        copy: usize,
        id: UnitId,
        compliance: Compliance,
    ) -> Result<(), EditError> {
        let (unit, number) = self.slot(copy, id)?;
        if !compliance.is_sound() {
            return Err(ObserveError::BadCompliance { unit: number }.into());
        }
        unit.compliance = OfCompliance::new(compliance);
        self.forget_still();
        Ok(())
    }

    /// Changes how contact with a plane gives way, in all copies of the scene.
    ///
    /// # Errors
    /// [`EditError`]; the plane is what it was.
    #[cfg(feature = "compliance")]
    pub fn set_plane_compliance(
        &mut self,
        plane: usize,
        compliance: Compliance,
    ) -> Result<(), EditError> {
        let planes = self.given.planes.len();
        let all = self.scene.plane_compliance.get_mut();
        let place = all.and_then(|all| all.get_mut(..planes)?.get_mut(plane));
        let place = place.ok_or(EditError::NoSuchPlane { plane, planes })?;
        if !compliance.is_sound() {
            return Err(EditError::BadPlaneCompliance { plane });
        }
        *place = compliance;
        self.forget_still();
        Ok(())
    }

    /// Changes who moves a unit, in all copies of the scene. A unit that becomes free goes on with the motion of its
    /// last step; one that becomes driven stays where it is until it is told where to go. A unit in quarantine that
    /// becomes driven or fixed leaves it.
    ///
    /// # Errors
    /// [`EditError::NoSuchUnit`], [`EditError::Bonded`]; of a soft unit, which is free, `EditError::Deforms`
    pub fn set_role(&mut self, id: UnitId, role: Role) -> Result<(), EditError> {
        self.number(id).ok_or(EditError::NoSuchUnit { id })?;
        let is_bonded = |unit: &UnitSlot| unit.id == id && unit.cluster_root().is_some();
        if role != Role::Free && self.scene.units().iter().any(is_bonded) {
            return Err(EditError::Bonded { id });
        }
        #[cfg(feature = "deform")]
        if role != Role::Free && self.get(id).is_some_and(|unit| unit.is_soft()) {
            return Err(EditError::Deforms);
        }
        in_own_environment(|| self.set_role_here(id, role));
        self.forget_still();
        Ok(())
    }

    fn set_role_here(&mut self, id: UnitId, role: Role) {
        let changed = |unit: &&mut UnitSlot| unit.id == id && unit.given_role() != role;
        let half_fall = self.half_fall();
        for unit in self.scene.units_mut().iter_mut().filter(changed) {
            // A free unit's way is that of the middle of a substep, others' have no gravity in them: the velocity lasts.
            let free = |role: Role| f32::from(u8::from(role == Role::Free));
            unit.course.way += half_fall * (free(unit.role) - free(role));
            unit.role = role;
            unit.target = unit.current;
            unit.set_quarantine(Quarantine::None, role);
        }
    }

    /// Changes the planes that the scene stands on or between; none is allowed. Contact with them is rigid until told otherwise.
    ///
    /// # Errors
    /// [`EditError`]; the planes are what they were.
    pub fn set_planes(&mut self, planes: &[Plane]) -> Result<(), EditError> {
        in_own_environment(|| self.set_planes_here(planes))
    }

    fn set_planes_here(&mut self, planes: &[Plane]) -> Result<(), EditError> {
        if planes.len() > MAX_PLANES {
            return Err(EditError::TooManyPlanes { found: planes.len(), limit: MAX_PLANES });
        }
        if let Some(plane) = planes.iter().position(|plane| !plane.is_sound_here()) {
            return Err(EditError::BadPlane { plane });
        }
        self.given.planes.clear();
        let _ = self.given.planes.extend_from_slice(planes);
        self.scene.plane_compliance = OfCompliance::new([Compliance::RIGID; MAX_PLANES]);
        self.set_measure(self.scene.measure);
        Ok(())
    }

    /// Changes gravity, m/s^2. Units keep their velocities.
    ///
    /// # Errors
    /// [`EditError::BadGravity`]; [`ObserveError::BadTimestep`], as an [`EditError`], where a unit would come from beyond the largest
    /// coordinate, and for models that measure time by gravity also [`ObserveError::LongTimestep`]. Gravity is what it was.
    pub fn set_gravity(&mut self, gravity_m_s2: Vector3<f32>) -> Result<(), EditError> {
        in_own_environment(|| self.set_gravity_here(gravity_m_s2))
    }

    fn set_gravity_here(&mut self, gravity_m_s2: Vector3<f32>) -> Result<(), EditError> {
        // A NaN compares as not within the limit.
        if !gravity_m_s2.iter().all(|g| g.abs() <= MAX_GRAVITY_M_S2) {
            return Err(EditError::BadGravity);
        }
        let (measure, dt_s) = (self.scene.measure, self.given.dt_s);
        if self.scene.count > 0 {
            let config = self.model.config();
            let time = Time::new(dt_s, &measure, &gravity_m_s2, config)?;
            let factor = Pace::new(config, &measure, &gravity_m_s2).gravity_factor;
            self.retime(&time, &(gravity_m_s2 * factor))?;
            self.set_time(time);
        }
        self.given.gravity = gravity_m_s2;
        self.set_measure(measure);
        Ok(())
    }

    /// Changes the time that a step takes, seconds. Units keep their velocities and spins: what rests goes on resting, and what falls, falling.
    ///
    /// # Errors
    /// [`ObserveError::BadTimestep`], [`ObserveError::LongTimestep`] or [`ObserveError::ShortTimestep`], as an [`EditError`], also
    /// where a unit would come from beyond the largest coordinate; the scene is what it was.
    pub fn set_dt(&mut self, dt_s: f32) -> Result<(), EditError> {
        in_own_environment(|| self.set_dt_here(dt_s))
    }

    fn set_dt_here(&mut self, dt_s: f32) -> Result<(), EditError> {
        if is_similar(self.model.config()) && self.scene.count == 0 {
            // Its measure is that of the unit to come.
            check_dt(dt_s, self.model.config())?;
            self.given.dt_s = dt_s;
            return Ok(());
        }
        let gravity = self.scene.gravity;
        let time = Time::new(dt_s, &self.scene.measure, &self.given.gravity, self.model.config())?;
        self.retime(&time, &gravity)?;
        self.set_time(time);
        Ok(())
    }

    /// Sets the command that conditions all following steps of all copies, for models that take
    /// one.
    ///
    /// # Errors
    /// [`CommandError`] when the size is not the model's `command_size` or a number is not
    /// finite; the previous command stays.
    pub fn set_command(&mut self, command: &[f32]) -> Result<(), CommandError> {
        self.check_command(command)?;
        for row in rows_mut(self.lasting.command_inputs, command.len()) {
            copy_slice(command, row);
        }
        (self.commanded, self.commands_stale) = (true, true);
        Ok(())
    }

    /// Gives one copy a command of its own, after [`set_command`](Self::set_command) has given
    /// one to all. `false` where there is no such copy.
    ///
    /// # Errors
    /// As [`set_command`](Self::set_command).
    pub fn set_copy_command(
        &mut self,
        copy_index: usize,
        command: &[f32],
    ) -> Result<bool, CommandError> {
        self.check_command(command)?;
        let there = copy_index < self.scene.copies();
        if there {
            let row = slice_at_mut(
                self.lasting.command_inputs,
                copy_index * command.len(),
                command.len(),
            );
            copy_slice(command, row);
            self.commands_stale = true;
        }
        Ok(there)
    }

    fn check_command(&self, command: &[f32]) -> Result<(), CommandError> {
        let expected = self.sizes.command;
        if command.len() != expected {
            return Err(CommandError::Size { expected, found: command.len() });
        }
        match in_own_environment(|| command.iter().position(|v| !v.is_finite())) {
            Some(index) => Err(CommandError::NotFinite { index }),
            None => Ok(()),
        }
    }

    fn one_copy(&self) -> Result<(), EditError> {
        #[cfg(feature = "deform")]
        if self.scene.units().iter().any(UnitSlot::is_soft) {
            return Err(EditError::Deforms);
        }
        match self.scene.copies() {
            copies @ 2.. => Err(EditError::Replicated { copies }),
            _ => Ok(()),
        }
    }

    /// A unit of a copy by its name, and its number in the copy.
    pub(super) fn slot(
        &mut self,
        copy: usize,
        id: UnitId,
    ) -> Result<(&mut UnitSlot, usize), EditError> {
        let number = self.number(id).ok_or(EditError::NoSuchUnit { id })?;
        let (copies, per_copy) = (self.scene.copies(), self.scene.per_copy);
        let slot = match copy < copies {
            true => self.scene.units_mut().get_mut(copy * per_copy + number),
            false => None,
        };
        slot.map(|slot| (slot, number)).ok_or(EditError::NoSuchCopy { copy, copies })
    }
}

/// Moves `behind` elements that begin `gap` after `at` down to `at`.
fn move_down<T: Copy>(slice: &mut [T], at: usize, gap: usize, behind: usize) {
    for to in at..at.saturating_add(behind) {
        let from = slice.get(to.saturating_add(gap)).copied();
        if let (Some(to), Some(from)) = (slice.get_mut(to), from) {
            *to = from;
        }
    }
}
