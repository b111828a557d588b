//! Joints between units.

use super::state::Simulator;
use crate::error::JoinError;
use crate::geometry::direction;
use crate::kernels::in_own_environment;
use crate::limits::MAX_COORDINATE_M;
use crate::scene::{UnitId, UnitSlot};
use crate::structure::joints::{self, Joint, JointKind, hangs_from};
use crate::structure::link::Link;
use nalgebra::UnitQuaternion;

impl Simulator<'_, '_> {
    /// Hangs a unit from another by a joint, in all copies of the scene: from the next step on the two stay together there.
    /// A unit that hangs already hangs from the new parent alone.
    ///
    /// Models that move units by impulses move what is joined by the dynamics of its joints, in steps of at most 1/600 s (docs/MODEL.md,
    /// section 7): nothing damps them. A unit that has just been joined jumps to its place in the next step. With other models each
    /// step ends with pushes at the pivots, which the network has not foreseen: they know ball joints alone. Units that hang
    /// together keep their centre of mass. Where driven or fixed ones are among them, those stay, and the others hang from them. Units of
    /// different bodies collide also where they are joined. Joints outlast all changes but [`unjoin`](Self::unjoin), the removal of
    /// one of the two and another observation.
    ///
    /// ```
    /// use nalgebra::{Isometry3, Point3, Vector3};
    /// use rigidformer_core::{Joint, JointAxis, JointKind, Limits, Model, Physics, Role, Simulator, SlabSizes, Slabs, Unit, UnitSlot};
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
    /// # let wood = Physics { mass_kg: 1.0, friction: 0.5, restitution: 0.0 };
    /// simulator.set_dt(1.0 / 30.0)?;
    /// simulator.set_network(false);
    /// let [post, door] = [Isometry3::translation(0.0, 0.0, 1.0), Isometry3::translation(0.5, 0.0, 1.0)];
    /// let post = simulator.add(&Unit::new(&cube, wood).role(Role::Fixed).body(1), &post, &post)?;
    /// let door = simulator.add(&Unit::new(&cube, wood).body(1), &door, &door)?;
    /// let hinge = JointKind::Revolute(JointAxis::new(Vector3::z()).limits(0.0, 1.5));
    /// let [own, posts] = [Point3::new(-0.25, 0.0, 0.0), Point3::new(0.25, 0.0, 0.0)];
    /// simulator.join(&Joint::ball(door, post, own, posts).kind(hinge))?;
    /// simulator.set_joint_target(door, Some(0.4))?;
    /// simulator.step()?;
    /// assert!(simulator.joint_position(door).is_some_and(|angle| (angle - 0.4).abs() < 1e-3));
    /// # Ok(())
    /// # }
    /// ```
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
        let kind = self.sound_kind(joint)?;
        let copy = self.scene.units().get(..self.scene.per_copy).unwrap_or_default();
        if hangs_from(copy, joint.parent, joint.unit) {
            return Err(JoinError::Circle { id: joint.unit, parent: joint.parent });
        }
        let rotation =
            |id| self.pose(id).map_or_else(UnitQuaternion::identity, |pose| pose.rotation);
        let rest = match joint.rest {
            Some(rest) => rest,
            None => rotation(joint.parent).inverse() * rotation(joint.unit),
        };
        let rest = unit_length(&rest).ok_or(JoinError::BadRest { id: joint.unit })?;
        self.link(joint.unit, Joint { kind, ..*joint }.link(rest));
        Ok(())
    }

    /// The kind of a joint with an axis of length 1.
    fn sound_kind(&self, joint: &Joint) -> Result<JointKind, JoinError> {
        let id = joint.unit;
        if joint.kind != JointKind::Ball && !self.model.config().motion.has_impulses() {
            return Err(JoinError::NotByImpulses { id });
        }
        let Some(mut axis) = joint.kind.axis() else { return Ok(joint.kind) };
        // The largest part first: squares of others may be beyond f32.
        let size = axis.axis.amax();
        if !(axis.axis.iter().all(|v| v.is_finite()) && size > 0.0) {
            return Err(JoinError::BadAxis { id });
        }
        let scaled = axis.axis / size;
        axis.axis = direction(&scaled).ok_or(JoinError::BadAxis { id })?;
        let slides = matches!(joint.kind, JointKind::Prismatic(_));
        let most = if slides { MAX_COORDINATE_M } else { core::f32::consts::PI };
        if let Some([least, greatest]) = axis.limits
            && !(least <= greatest && least >= -most && greatest <= most)
        {
            return Err(JoinError::BadLimits { id });
        }
        if axis.max_force.is_some_and(|force| !(force > 0.0 && force.is_finite())) {
            return Err(JoinError::BadForce { id });
        }
        Ok(if slides { JointKind::Prismatic(axis) } else { JointKind::Revolute(axis) })
    }

    /// Takes a joint to a position by the end of the next step, in all copies of the scene, and holds it there: radians, the shorter way
    /// round, or metres. Beyond a limit that is the limit. A joint with a [`max_force`](crate::JointAxis::max_force) may come later, no
    /// faster than that can brake what it moves. `None`: from then on the joint is free. See [`join`](Self::join) for an example.
    ///
    /// # Errors
    /// [`JoinError::NoSuchUnit`]; [`JoinError::NoAxis`], of a unit that hangs by no joint with an axis; [`JoinError::BadTarget`], of a
    /// position that is not finite or beyond 1e6. The target is what it was.
    pub fn set_joint_target(&mut self, id: UnitId, target: Option<f32>) -> Result<(), JoinError> {
        let number = self.number(id).ok_or(JoinError::NoSuchUnit { id })?;
        let above = self.scene.units().get(number).and_then(|unit| unit.link.above);
        if !above.is_some_and(|above| above.guide.way.has_axis()) {
            return Err(JoinError::NoAxis { id });
        }
        // A NaN compares as not within the limit.
        let is_near = |target: f32| target.abs() <= MAX_COORDINATE_M;
        if !target.is_none_or(is_near) {
            return Err(JoinError::BadTarget { id });
        }
        for unit in self.scene.units_mut().iter_mut().filter(|unit| unit.id == id) {
            if let Some(above) = &mut unit.link.above {
                above.guide.target = target;
            }
        }
        Ok(())
    }

    /// Where the caller wants a joint, radians or metres: see [`set_joint_target`](Self::set_joint_target).
    pub fn joint_target(&self, id: UnitId) -> Option<f32> {
        self.scene.units().get(self.number(id)?)?.link.above?.guide.target
    }

    /// Position of the joint that a unit of the first copy hangs by: radians from minus half a turn to half a turn, or metres, 0 at its
    /// [rest](Joint::rest). `None`: there is no such unit, or it hangs by no joint with an axis.
    pub fn joint_position(&self, id: UnitId) -> Option<f32> {
        in_own_environment(|| {
            let copy = self.scene.units().get(..self.scene.per_copy).unwrap_or_default();
            joints::position(copy, copy.get(self.number(id)?)?, self.scene.measure.length())
        })
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

/// A quaternion of length 1; none where it has no direction.
fn unit_length(rest: &UnitQuaternion<f32>) -> Option<UnitQuaternion<f32>> {
    let q = rest.as_ref();
    let size = q.coords.amax();
    if !(q.coords.iter().all(|v| v.is_finite()) && size > 0.0) {
        return None;
    }
    let q = q / size;
    let length = crate::math::sqrt((q.i * q.i + q.j * q.j) + (q.k * q.k + q.w * q.w));
    Some(UnitQuaternion::new_unchecked(q / length))
}
