//! Units, their roles and bodies, planes, gravity and time: the state that a rollout carries.

use crate::contact::ground::Plane;
use crate::contact::law::ContactLaw;
use crate::contact::pieces::{self, Piece, Pieces};
use crate::geometry::{Course, Pose, State, norm, rotate, turn_between};
use crate::limits::{ANCHORS, MAX_PLANES};
use crate::math;
use crate::measure::Measure;
use crate::stand_in::{OfCompliance, OfForce, OfHealth};
use nalgebra::{Matrix3, Point3, Vector3};

/// What a unit is made of.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Physics {
    /// Mass, kg, from 1e-9 to 1e9. Nothing moves a [`Role::Driven`] or [`Role::Fixed`] unit, whatever its mass.
    pub mass_kg: f32,
    /// Friction coefficient, from 0 to 1000.
    pub friction: f32,
    /// Restitution coefficient, from 0 to 1000.
    pub restitution: f32,
}

impl Physics {
    pub(crate) fn is_sound(&self) -> bool {
        (1e-9..=1e9).contains(&self.mass_kg)
            && (0.0..=1e3).contains(&self.friction)
            && (0.0..=1e3).contains(&self.restitution)
    }
}

/// How contact with a unit or a plane gives way: as a spring and a damper at each contact point (Hunt and Crossley). At a
/// depth d that changes by d' a second, a point pushes with `k d (1 + c d')` newtons, and never pulls.
///
/// Two that touch give way in series: the pair has `1 / k = 1 / k1 + 1 / k2`, and `c / k = c1 / k1 + c2 / k2`. Where both are
/// rigid, contact stops approaches at once, and restitution says how it bounces. Where either gives way, `k` and `c` say
/// that, and restitution counts for nothing. It is for models that move units by impulses; others have no springs.
///
/// ```
/// use rigidformer_core::Compliance;
/// let acrylic = Compliance { stiffness_n_m: 10_000.0, dissipation_s_m: 4.0 };
/// assert!(Compliance::default().is_rigid() && !acrylic.is_rigid());
/// ```
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Compliance {
    /// Stiffness k at a contact point, N/m, from 1e-3 to 1e12; 0 or infinite: rigid.
    pub stiffness_n_m: f32,
    /// Dissipation c, s/m, from 0 to 1e6.
    pub dissipation_s_m: f32,
}

impl Compliance {
    /// Contact that does not give way: the default.
    pub const RIGID: Compliance = Compliance { stiffness_n_m: 0.0, dissipation_s_m: 0.0 };

    /// Whether contact does not give way.
    pub const fn is_rigid(&self) -> bool {
        self.stiffness_n_m == 0.0 || self.stiffness_n_m == f32::INFINITY
    }

    /// Whether both numbers are in range.
    pub fn is_sound(&self) -> bool {
        (self.is_rigid() || (1e-3..=1e12).contains(&self.stiffness_n_m))
            && (0.0..=1e6).contains(&self.dissipation_s_m)
    }
}

/// Who moves a unit.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
#[non_exhaustive]
pub enum Role {
    /// The model moves it.
    #[default]
    Free,
    /// It goes exactly where it is told in the next step. The network sees that motion and never moves it.
    Driven,
    /// Scenery: it never moves.
    Fixed,
}

/// Whether a unit has diverged, and is held while the others go on.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) enum Quarantine {
    /// No.
    #[default]
    None,
    /// In the step under way: it is undone where the step fails.
    Now,
    /// In an earlier step.
    Held,
}

/// What makes a unit soft: a patch of a body that deforms.
#[cfg(feature = "deform")]
#[derive(Clone, Copy, Debug)]
pub struct Soft<'a> {
    /// Its points at rest, metres, in the order of the unit's points: all patches of a body in one frame. Points of two patches that
    /// are in the same place at rest are one.
    pub rest: &'a [Point3<f32>],
    /// Young's modulus, Pa, from 1e-3 to 1e15.
    pub young_pa: f32,
}

/// One rigid object or part, in its reference frame; or a patch of a soft body.
///
/// ```
/// use nalgebra::Point3;
/// use rigidformer_core::{Physics, Role, Unit};
/// let points = [[0.0, 0.0, 0.0], [0.1, 0.0, 0.0], [0.0, 0.1, 0.0], [0.0, 0.0, 0.1]].map(Point3::from);
/// let steel = Physics { mass_kg: 0.5, friction: 0.4, restitution: 0.3 };
/// let finger = Unit::new(&points, steel).role(Role::Driven).body(1);
/// assert_eq!((finger.role, finger.body), (Role::Driven, Some(1)));
/// let hollow = Unit::new(&points, steel).inertia([2e-3, 2e-3, 1e-3]);
/// assert_eq!((finger.inertia_kg_m2, hollow.inertia_kg_m2), (None, Some([2e-3, 2e-3, 1e-3])));
/// ```
#[derive(Clone, Copy, Debug)]
pub struct Unit<'a> {
    /// Points in the reference frame, metres, at least 4, in any order.
    pub points: &'a [Point3<f32>],
    /// What it is made of.
    pub physics: Physics,
    /// Who moves it.
    pub role: Role,
    /// The body that it is a part of: parts of one body do not collide with each other. `None` is a body of its own.
    pub body: Option<u16>,
    /// Principal moments of inertia, kg m^2, through the unit's centre about axes along those of the points' frame, each
    /// from 1e-18 to 1e18 and at most the sum of the other two. `None`: those of a uniform box around the points, or
    /// of a uniform ball for about 120 points or more on a sphere.
    /// A moment below 1e-6 m^2 times the mass counts as that, in metres of the scene's own for models that measure in those.
    /// With another mass ([`Simulator::set_physics`](crate::Simulator::set_physics)) the moments change by the same share.
    pub inertia_kg_m2: Option<[f32; 3]>,
    /// Convex pieces that it touches with, where it is hollow: [`Pieces::NONE`] is the hull of its points.
    pub pieces: Pieces<'a>,
    /// How contact with it gives way.
    #[cfg(feature = "compliance")]
    pub compliance: Compliance,
    /// What it is like at rest, where it deforms. `None`: it is rigid.
    #[cfg(feature = "deform")]
    pub soft: Option<Soft<'a>>,
}

impl<'a> Unit<'a> {
    /// A free unit that is a body of its own, with the inertia of the box around its points.
    pub const fn new(points: &'a [Point3<f32>], physics: Physics) -> Self {
        let (role, body, inertia_kg_m2) = (Role::Free, None, None);
        Unit {
            points,
            physics,
            role,
            body,
            inertia_kg_m2,
            pieces: Pieces::NONE,
            #[cfg(feature = "compliance")]
            compliance: Compliance::RIGID,
            #[cfg(feature = "deform")]
            soft: None,
        }
    }

    /// The same unit with another role.
    pub const fn role(self, role: Role) -> Self {
        Unit { role, ..self }
    }

    /// The same unit as a part of a body.
    pub const fn body(self, body: u16) -> Self {
        Unit { body: Some(body), ..self }
    }

    /// The same unit with known moments of inertia, kg m^2: see [`inertia_kg_m2`](Self::inertia_kg_m2).
    pub const fn inertia(self, inertia_kg_m2: [f32; 3]) -> Self {
        Unit { inertia_kg_m2: Some(inertia_kg_m2), ..self }
    }

    /// The same unit, which touches with convex pieces.
    pub const fn pieces(self, pieces: Pieces<'a>) -> Self {
        Unit { pieces, ..self }
    }

    /// The same unit, with contact that gives way.
    #[cfg(feature = "compliance")]
    pub const fn compliance(self, compliance: Compliance) -> Self {
        Unit { compliance, ..self }
    }

    /// The same unit as a patch that deforms: see [`Soft`]. Models of elastic motion alone move it.
    #[cfg(feature = "deform")]
    pub const fn soft(self, rest: &'a [Point3<f32>], young_pa: f32) -> Self {
        Unit { soft: Some(Soft { rest, young_pa }), ..self }
    }

    /// Points of [`Limits::points`](crate::Limits::points) that it takes: its own, or those of its pieces and two a piece,
    /// whichever are more.
    pub fn room(&self) -> usize {
        self.points.len().max(self.pieces.room())
    }

    /// Whether its moments of inertia, if it has any, are those of a body: of a plate the greatest is the sum of the others.
    pub(crate) fn has_sound_inertia(&self) -> bool {
        self.inertia_kg_m2.is_none_or(|[x, y, z]| {
            let greatest = x.max(y).max(z);
            [x, y, z].iter().all(|moment| (1e-18..=1e18).contains(moment))
                && greatest <= 1.001 * (((x + y) + z) - greatest)
        })
    }
}

/// Name of a unit in a simulator: stays valid until that unit is removed or another scene is observed, and is never
/// given to another unit of that simulator. Interfaces to other languages may rely on it being a 64-bit number in memory.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
#[repr(transparent)]
pub struct UnitId(u64);

impl UnitId {
    /// As a number: for interfaces that know no Rust types.
    pub const fn to_bits(self) -> u64 {
        self.0
    }

    /// From [`to_bits`](Self::to_bits). A number that no simulator gave names no unit.
    pub const fn from_bits(bits: u64) -> Self {
        UnitId(bits)
    }
}

impl core::fmt::Display for UnitId {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        write!(f, "unit id {}", self.0)
    }
}

/// A unit as a simulator keeps it: the caller owns the memory, the simulator the contents.
#[derive(Clone, Copy, Debug)]
pub struct UnitSlot {
    pub(crate) id: UnitId,
    /// Its points in the scene's point slab: relative to the centre, in farthest-point
    /// order, so that the first [`ANCHORS`] are the anchors.
    pub(crate) start: usize,
    pub(crate) count: usize,
    /// As the caller gave it.
    pub(crate) physics: Physics,
    pub(crate) compliance: OfCompliance<Compliance>,
    pub(crate) role: Role,
    /// Whether it diverged and waits for a pose: a free unit that is held as if it were fixed.
    pub(crate) quarantine: OfHealth<Quarantine>,
    /// Whether the solver takes it for a ball about its centre.
    pub(crate) is_ball: bool,
    /// Convex pieces that it is made of; 0: it is the hull of its extreme points.
    pub(crate) pieces: u8,
    /// One more than the body's number; 0 for a body of its own.
    pub(crate) body: u32,
    #[cfg(feature = "robot")]
    pub(crate) link: crate::structure::link::Link,
    #[cfg(feature = "deform")]
    pub(crate) member: crate::structure::member::Member,
    /// Whether it is a patch of a soft body.
    #[cfg(feature = "deform")]
    pub(crate) is_patch: bool,
    /// Natural logarithm of Young's modulus, Pa; 0 for rigid units.
    #[cfg(feature = "deform")]
    pub(crate) ln_young: f32,
    /// Mass, in the scene's measure as all that follows, but for the offset.
    pub(crate) mass: f32,
    /// Its natural logarithm.
    pub(crate) ln_mass: f32,
    /// Radius about the centre, metres.
    pub(crate) radius: f32,
    /// The centre in the caller's reference frame, in the caller's metres.
    pub(crate) offset: Point3<f32>,
    /// Its extreme points in the scene's slab of those, piece after piece, from `hull_start` on; behind them, what says
    /// where each piece is. 0 for models without impacts.
    pub(crate) hull: usize,
    pub(crate) hull_start: usize,
    /// Principal moments of inertia of a kilogram, along the axes of the points, m^2.
    pub(crate) inertia_m2: Vector3<f32>,
    /// Pose in the first frame, which the offset feature refers to; of models of robots the frame of the heading,
    /// from which they see all.
    pub(crate) first: Pose,
    pub(crate) current: Pose,
    /// What the current pose leaves out, and the motion in the last substep.
    pub(crate) course: Course,
    /// Where a driven unit goes in the next step.
    pub(crate) target: Pose,
    /// One more than the contacts of a unit that the last step left as it was to the bit, with all that it can touch; 0 of others.
    #[cfg(rigidformer_host)]
    pub(crate) still: u16,
    /// The solver's substeps of that step: in others it may not stay.
    #[cfg(rigidformer_host)]
    pub(crate) still_substeps: u8,
}

/// What the network is told of a point of a soft unit besides.
pub(crate) struct SoftInputs {
    /// Natural logarithm of Young's modulus, Pa; 0 of rigid units.
    pub(crate) ln_young: f32,
    /// What springs and contact change of its way and of its velocity, m/s.
    pub(crate) changes: [Vector3<f32>; 2],
}

/// What another step or gravity makes of ways.
pub(crate) struct Retimed {
    /// Time of the substep to come by that of the last one.
    pub(crate) share: f32,
    /// What gravity adds in half a substep, before and from now on, metres.
    pub(crate) halves: [Vector3<f32>; 2],
}

impl Retimed {
    /// The way of what falls, metres.
    pub(crate) fn way(&self, way: &Vector3<f32>) -> Vector3<f32> {
        let [before, now] = self.halves;
        (way + before) * self.share - now
    }
}

/// The motion of a unit in a step, but for what gravity adds.
#[cfg(feature = "health")]
#[derive(Clone, Copy)]
pub(crate) struct Coming {
    /// Of the centre, metres.
    pub(crate) way: Vector3<f32>,
    /// What the step adds to the rotation.
    pub(crate) change: Matrix3<f32>,
}

impl UnitSlot {
    /// No unit. Zeros alone, so that a static of them is not in a firmware's flash.
    pub const EMPTY: UnitSlot = {
        let zero = Vector3::new(0.0, 0.0, 0.0);
        let nowhere = Pose {
            rotation: Matrix3::new(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0),
            centre: zero,
        };
        UnitSlot {
            id: UnitId(0),
            start: 0,
            count: 0,
            physics: Physics { mass_kg: 0.0, friction: 0.0, restitution: 0.0 },
            compliance: OfCompliance::new(Compliance::RIGID),
            role: Role::Free,
            quarantine: OfHealth::new(Quarantine::None),
            is_ball: false,
            pieces: 0,
            body: 0,
            #[cfg(feature = "robot")]
            link: crate::structure::link::Link::NONE,
            #[cfg(feature = "deform")]
            member: crate::structure::member::Member::ALONE,
            #[cfg(feature = "deform")]
            is_patch: false,
            #[cfg(feature = "deform")]
            ln_young: 0.0,
            mass: 0.0,
            ln_mass: 0.0,
            radius: 0.0,
            offset: Point3::new(0.0, 0.0, 0.0),
            hull: 0,
            hull_start: 0,
            inertia_m2: zero,
            first: nowhere,
            current: nowhere,
            course: Course::NONE,
            target: nowhere,
            #[cfg(rigidformer_host)]
            still: 0,
            #[cfg(rigidformer_host)]
            still_substeps: 0,
        }
    };

    /// Takes what it is made of, in a scene's measure.
    pub(crate) fn set_physics(&mut self, physics: Physics, measure: &Measure) {
        self.physics = physics;
        self.mass = physics.mass_kg / measure.mass();
        self.ln_mass = math::ln(self.mass);
    }

    /// How contact with it gives way.
    #[inline(always)]
    pub(crate) fn compliance(&self) -> Compliance {
        self.compliance.get().copied().unwrap_or_default()
    }

    /// Whether contact with a plane gives way.
    #[inline(always)]
    pub(crate) fn gives_way_on(&self, scene: &Scene<'_>, plane: usize) -> bool {
        !(self.compliance().is_rigid() && scene.plane_compliance(plane).is_rigid())
    }

    /// Rows of the slab of extreme points that are its own.
    pub(crate) fn hull_rows(&self) -> usize {
        pieces::rows(self.hull, self.pieces)
    }

    /// Whether it deforms.
    #[cfg(feature = "deform")]
    pub(crate) fn is_soft(&self) -> bool {
        self.is_patch
    }

    /// As [`is_soft`](Self::is_soft).
    #[cfg(not(feature = "deform"))]
    pub(crate) fn is_soft(&self) -> bool {
        false
    }

    /// The number in the copy of the first unit of the cluster that it is in; none of a unit alone.
    #[cfg(feature = "deform")]
    pub(crate) fn cluster_root(&self) -> Option<usize> {
        self.member.cluster_root()
    }

    /// As [`cluster_root`](Self::cluster_root).
    #[cfg(not(feature = "deform"))]
    #[inline(always)]
    pub(crate) fn cluster_root(&self) -> Option<usize> {
        None
    }

    /// The number of the next unit of its cluster; behind the last comes the first. None of a unit alone.
    pub(crate) fn next_member(&self) -> Option<usize> {
        #[cfg(feature = "deform")]
        return self.cluster_root().map(|_| self.member.next());
        #[cfg(not(feature = "deform"))]
        None
    }

    /// Whether nothing but contact moves it: neither a pivot nor a cluster.
    #[cfg(rigidformer_host)]
    pub(crate) fn is_alone(&self) -> bool {
        #[cfg(feature = "robot")]
        let hangs = self.link.above.is_some();
        #[cfg(not(feature = "robot"))]
        let hangs = false;
        !hangs && self.cluster_root().is_none()
    }

    /// Whether a step of so many of the solver's substeps leaves it as it is.
    #[cfg(rigidformer_host)]
    pub(crate) fn is_still_in(&self, substeps: u8) -> bool {
        self.still > 0 && self.still_substeps == substeps
    }

    /// Whether the model moves it.
    pub(crate) fn is_free(&self) -> bool {
        self.role == Role::Free
    }

    /// Whether it diverged, and since when.
    pub(crate) fn quarantine(&self) -> Quarantine {
        self.quarantine.get().copied().unwrap_or_default()
    }

    /// Holds it as if it were fixed, or ends that, with the role that it has from now on.
    pub(crate) fn set_quarantine(&mut self, quarantine: Quarantine, role: Role) {
        if let Some(own) = self.quarantine.get_mut() {
            (self.role, *own) = (role, quarantine);
        }
    }

    /// Whether it diverged and waits for a pose.
    #[inline(always)]
    pub(crate) fn is_quarantined(&self) -> bool {
        self.quarantine() != Quarantine::None
    }

    /// The role that its caller gave it.
    pub(crate) fn given_role(&self) -> Role {
        // Free units alone diverge.
        if self.is_quarantined() { Role::Free } else { self.role }
    }

    /// 1 / mass, kg^-1; 0 where nothing moves the unit.
    pub(crate) fn lightness(&self) -> f32 {
        if self.is_free() { 1.0 / self.mass } else { 0.0 }
    }

    /// Where it is and how it moves.
    #[inline(always)]
    pub(crate) fn state(&self) -> State {
        State { pose: self.current, course: self.course }
    }

    /// Its centre with all its digits.
    pub(crate) fn centre(&self) -> Vector3<f64> {
        self.current.centre.cast::<f64>() + self.course.centre_low.cast::<f64>()
    }

    /// Puts its centre elsewhere.
    pub(crate) fn set_centre(&mut self, centre: &Vector3<f64>) {
        self.current.centre = centre.map(|v| v as f32);
        self.course.centre_low = (centre - self.current.centre.cast::<f64>()).map(|v| v as f32);
    }

    /// Ends a step: `row` has the state that it goes to.
    #[inline(always)]
    pub(crate) fn go_to(&mut self, row: &[f32]) {
        // Nothing that is done to all units may move it.
        if self.is_quarantined() {
            self.course = self.course.moving(Vector3::zeros(), Vector3::zeros());
            return;
        }
        let next = State::read(row);
        #[cfg(rigidformer_host)]
        (self.still = if next.has_bits_of(&self.state()) { self.still.max(1) } else { 0 });
        (self.current, self.course) = (next.pose, next.course);
    }

    /// Where a free unit goes without contact: ballistic centre, the last step's rotation again. `fall` is what gravity adds
    /// to a step's way, metres.
    #[cfg_attr(rigidformer_dsp, inline(never))]
    pub(crate) fn free(&self, fall: &Vector3<f32>) -> State {
        self.state().free(fall)
    }

    /// Where it stays, without motion.
    #[cfg_attr(rigidformer_dsp, inline(never))]
    pub(crate) fn resting(&self) -> State {
        let course = self.course.moving(Vector3::zeros(), Vector3::zeros());
        State { pose: self.current, course }
    }

    /// Where its caller takes it in the next step.
    #[cfg_attr(rigidformer_dsp, inline(never))]
    pub(crate) fn driven(&self) -> State {
        // It keeps its digits.
        if self.target == self.current {
            return self.resting();
        }
        let turn = turn_between(&self.current.rotation, &self.target.rotation);
        let course = Course::REST.moving(self.way_to_target(), turn);
        State { pose: self.target, course }
    }

    /// From where a driven unit is to where it goes, metres.
    fn way_to_target(&self) -> Vector3<f32> {
        self.target.centre - self.current.centre
    }

    /// The turn of the next step, but for what contact adds: the last step's once more, the command, or none. Radians.
    pub(crate) fn coming_turn(&self) -> Vector3<f32> {
        match self.role {
            Role::Free => self.course.turn(),
            Role::Driven => turn_between(&self.current.rotation, &self.target.rotation),
            Role::Fixed => Vector3::zeros(),
        }
    }

    /// As [`coming_turn`](Self::coming_turn), the way of a local point; but for what gravity adds. Metres.
    #[cfg_attr(rigidformer_dsp, inline(never))]
    pub(crate) fn coming_way(&self, local: &Vector3<f32>) -> Vector3<f32> {
        match self.role {
            // No network has said yet that it changes.
            Role::Free => self.course.way_at(&rotate(&self.current.rotation, local)),
            Role::Driven => self.target.displacement_from(&self.current, local),
            Role::Fixed => Vector3::zeros(),
        }
    }

    /// The motion of the next step, but for what gravity adds: the last step's once more, the command, or none.
    #[cfg(feature = "health")]
    pub(crate) fn coming(&self) -> Coming {
        match self.role {
            Role::Free => Coming { way: self.course.way, change: self.state().turned_by() },
            Role::Driven => Coming {
                way: self.way_to_target(),
                change: self.target.rotation - self.current.rotation,
            },
            Role::Fixed => Coming { way: Vector3::zeros(), change: Matrix3::zeros() },
        }
    }
}

/// The units of the cluster of its first one, in their order, with their numbers in the copy; of a unit alone that one.
pub(crate) fn members(
    units: &[UnitSlot],
    cluster_root: usize,
) -> impl Iterator<Item = (usize, &UnitSlot)> {
    let mut at = Some(cluster_root);
    // A list that is longer would go round.
    (0..units.len()).map_while(move |_| {
        let number = at?;
        let unit = units.get(number)?;
        at = unit.next_member().filter(|next| *next != cluster_root);
        Some((number, unit))
    })
}

/// Ground of varying height, and what is found of it once.
#[cfg(feature = "terrain")]
#[derive(Clone, Copy, Debug)]
pub(crate) struct Terrain<'s> {
    pub(crate) field: crate::contact::height_field::HeightField<'s>,
    /// Its greatest height above its corner, metres.
    pub(crate) highest_m: f32,
    pub(crate) digest: u64,
}

/// The state of a rollout: units of one scene, or of several copies of it.
pub(crate) struct Scene<'s> {
    /// Copy after copy; all copies have the same units. Those from `count` on are empty.
    pub(crate) slots: &'s mut [UnitSlot],
    /// Units of all copies.
    pub(crate) count: usize,
    /// Units of a copy.
    pub(crate) per_copy: usize,
    pub(crate) points: &'s mut [Point3<f32>],
    /// Extreme points of the units; empty for models without impacts.
    pub(crate) hulls: &'s mut [Point3<f32>],
    pub(crate) planes: heapless::Vec<Plane, MAX_PLANES>,
    #[cfg(feature = "terrain")]
    pub(crate) terrain: Option<Terrain<'s>>,
    /// How contact with each of them gives way.
    pub(crate) plane_compliance: OfCompliance<[Compliance; MAX_PLANES]>,
    pub(crate) measure: Measure,
    /// Seconds that count as one.
    pub(crate) second: OfForce<f32>,
    /// m/s^2
    pub(crate) gravity: Vector3<f32>,
    /// Of contacts that impulses act at.
    pub(crate) contact_law: ContactLaw,
    /// Seconds of a step, or of its substeps.
    pub(crate) dt: f32,
    /// Substeps that a step is taken in, at least 1.
    pub(crate) substeps: u32,
    /// Numbers of a unit that impulses take besides: [`extra`](crate::contact::prior::extra) or 0.
    #[cfg(rigidformer_host)]
    pub(crate) extra: usize,
    #[cfg(feature = "deform")]
    pub(crate) soft: crate::structure::soft_points::SoftPoints<'s>,
}

impl Scene<'_> {
    /// A number of the height field, other than those of other ones; `None` where there is none.
    pub(crate) fn terrain_digest(&self) -> Option<u64> {
        #[cfg(feature = "terrain")]
        return self.terrain.map(|terrain| terrain.digest);
        #[cfg(not(feature = "terrain"))]
        None
    }

    /// How contact with a plane gives way, by its number.
    #[inline(always)]
    pub(crate) fn plane_compliance(&self, plane: usize) -> Compliance {
        let all = self.plane_compliance.get();
        all.and_then(|all| all.get(plane)).copied().unwrap_or_default()
    }

    /// Units of all copies.
    pub(crate) fn units(&self) -> &[UnitSlot] {
        self.slots.get(..self.count).unwrap_or_default()
    }

    /// As [`units`](Self::units).
    pub(crate) fn units_mut(&mut self) -> &mut [UnitSlot] {
        self.slots.get_mut(..self.count).unwrap_or_default()
    }

    /// Copies of the scene.
    pub(crate) fn copies(&self) -> usize {
        // Controllers have one copy, and the compiler leaves loops over copies out.
        if cfg!(not(rigidformer_host)) {
            return 1;
        }
        self.count.checked_div(self.per_copy).unwrap_or_default()
    }

    /// The units of the copy that a unit is of: the first one's index, and all of them.
    pub(crate) fn around(&self, unit: usize) -> (usize, &[UnitSlot]) {
        if cfg!(not(rigidformer_host)) {
            return (0, self.units());
        }
        let per_copy = self.per_copy.max(1);
        let first = unit / per_copy * per_copy;
        (first, self.units().get(first..first + per_copy).unwrap_or_default())
    }

    /// The units that a unit can touch, with their indices: those of its copy that are not of its body.
    pub(crate) fn others<'a>(
        &'a self,
        index: usize,
        unit: &'a UnitSlot,
    ) -> impl Iterator<Item = (usize, &'a UnitSlot)> {
        let (first, around) = self.around(index);
        // No unit has the number that stands for no body here.
        let body = if unit.body == 0 { u32::MAX } else { unit.body };
        (first..).zip(around).filter(move |(j, other)| *j != index && other.body != body)
    }

    /// The last unit of a copy.
    fn last_of_copy(&self) -> Option<&UnitSlot> {
        match self.per_copy.checked_sub(1) {
            Some(last) if cfg!(rigidformer_host) => self.units().get(last),
            _ => self.units().last(),
        }
    }

    /// Points of a copy.
    pub(crate) fn points_per_copy(&self) -> usize {
        self.last_of_copy().map_or(0, |last| last.start + last.count)
    }

    /// Rows of the slab of extreme points that a copy takes.
    pub(crate) fn hull_rows_per_copy(&self) -> usize {
        self.last_of_copy().map_or(0, |last| last.hull_start + last.hull_rows())
    }

    /// A unit's points in its local frame.
    pub(crate) fn points_of(&self, unit: &UnitSlot) -> &[Point3<f32>] {
        self.points.get(unit.start..unit.start + unit.count).unwrap_or_default()
    }

    /// A unit's extreme points in its local frame.
    pub(crate) fn hull_of(&self, unit: &UnitSlot) -> &[Point3<f32>] {
        self.hulls.get(unit.hull_start..unit.hull_start + unit.hull).unwrap_or_default()
    }

    /// A convex piece of a unit that has several, by its number.
    #[cfg_attr(rigidformer_dsp, inline(never))]
    pub(crate) fn piece_of(&self, unit: &UnitSlot, number: usize) -> Piece<'_> {
        Piece::of(self.hulls.get(unit.hull_start..).unwrap_or_default(), unit.hull, number)
    }

    /// Measures a unit's points by another length.
    #[cfg_attr(rigidformer_dsp, inline(never))]
    pub(crate) fn rescale(&mut self, unit: &UnitSlot, share: f32) {
        let own = self.points.get_mut(unit.start..unit.start + unit.count).unwrap_or_default();
        own.iter_mut().for_each(|point| *point *= share);
        let rows = unit.hull_start..unit.hull_start + unit.hull_rows();
        pieces::rescale(self.hulls.get_mut(rows).unwrap_or_default(), unit.hull, share);
    }

    /// The way of a unit's point in the coming motion, by its number and its place in the unit: of a soft one that of the last step.
    pub(crate) fn increment(
        &self,
        unit: &UnitSlot,
        (number, local): (usize, &Vector3<f32>),
    ) -> Vector3<f32> {
        #[cfg(feature = "deform")]
        if unit.is_soft() {
            return self.soft.increment(unit.start + number);
        }
        let _ = number;
        unit.coming_way(local)
    }

    /// How far a point of a soft unit is from where it would be if the unit were rigid; nothing for rigid units.
    pub(crate) fn bend(
        &self,
        unit: &UnitSlot,
        (number, point): (usize, &Vector3<f32>),
    ) -> Vector3<f32> {
        #[cfg(feature = "deform")]
        if unit.is_soft() {
            return point - unit.first.apply(&self.soft.rest(unit.start + number));
        }
        let _ = (unit, number, point);
        Vector3::zeros()
    }

    /// What the network of soft bodies is told of a unit's point besides; none in builds without soft bodies.
    pub(crate) fn soft_inputs(&self, unit: &UnitSlot, number: usize) -> Option<SoftInputs> {
        #[cfg(feature = "deform")]
        {
            let changes = self.soft.changes(self.dt, &self.gravity, unit.start + number);
            // Rigid units have no springs.
            let changes = changes.map(|v| if unit.is_soft() { v } else { Vector3::zeros() });
            Some(SoftInputs { ln_young: unit.ln_young, changes })
        }
        #[cfg(not(feature = "deform"))]
        {
            let _ = (unit, number);
            None
        }
    }

    /// A unit's anchors in its local frame.
    pub(crate) fn anchors_of(&self, unit: &UnitSlot) -> [Vector3<f32>; ANCHORS] {
        let mut anchors = [Vector3::zeros(); ANCHORS];
        for (anchor, point) in anchors.iter_mut().zip(self.points_of(unit)) {
            *anchor = point.coords;
        }
        anchors
    }

    /// What gravity adds to a free unit's way in a step, metres.
    pub(crate) fn fall(&self) -> Vector3<f32> {
        self.gravity * (self.dt * self.dt)
    }

    /// Substeps that a step is taken in, at least 1.
    pub(crate) fn substeps(&self) -> u32 {
        self.substeps
    }

    /// The way of a unit's centre in the next step, seen from a frame that falls: there gravity is nothing to free
    /// units, and what stands still rises. Metres.
    pub(crate) fn travel(&self, unit: &UnitSlot) -> Vector3<f32> {
        match unit.role {
            Role::Free => unit.course.way,
            Role::Driven => unit.way_to_target() - self.fall(),
            Role::Fixed => Vector3::zeros() - self.fall(),
        }
    }

    /// Whether a unit's motion may touch another unit's in the next step, by bounding spheres: negative where it may,
    /// metres. `travel` is the unit's.
    pub(crate) fn room_to_unit(
        &self,
        (unit, travel): (&UnitSlot, &Vector3<f32>),
        other: &UnitSlot,
    ) -> f32 {
        let apart = norm(&(unit.current.centre - other.current.centre));
        let gap = (apart - unit.radius) - other.radius;
        let towards = norm(&(travel - self.travel(other)));
        gap - (towards * REACH_FACTOR + REACH_MARGIN_M)
    }

    /// As [`room_to_unit`](Self::room_to_unit), for a plane and a free unit.
    #[cfg_attr(rigidformer_dsp, inline(never))]
    pub(crate) fn room_to_plane(
        &self,
        (unit, travel): (&UnitSlot, &Vector3<f32>),
        plane: &Plane,
    ) -> f32 {
        let rise = crate::geometry::dot(&plane.normal, travel)
            + crate::geometry::dot(&plane.normal, &self.fall());
        let height = plane.height_here(&unit.current.centre);
        ((height - unit.radius) + rise.min(0.0) * REACH_FACTOR) - REACH_MARGIN_M
    }
}

/// Allowance on the distance that units travel towards each other: a unit that is left out wrongly gets no correction.
const REACH_FACTOR: f32 = 1.05;
/// Allowance on every gap, metres, for the same reason.
const REACH_MARGIN_M: f32 = 0.03;
