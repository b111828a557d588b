//! Parts that stay together: pivots that a unit shares with the unit that it hangs from (docs/MODEL.md, section 7).

use crate::geometry::{Pose, STATE, State, dot, read_pose, rotate, rotate_back};
use crate::kernels::Schedule;
use crate::scene::{Scene, UnitId, UnitSlot};
use crate::slices::{rows, rows_mut};
use crate::structure::hinge::Hinge;
use crate::structure::link::{Above, Guide, Link, Way};
use crate::structure::stage::{Attempt, Structure};
use nalgebra::{Point3, Quaternion, UnitQuaternion, Vector3};
use rigidformer_weights::Motion;

/// An axis that a joint turns about or slides along, its limits, and the force that takes it to a target.
///
/// ```
/// use nalgebra::Vector3;
/// use rigidformer_core::JointAxis;
/// let knee = JointAxis::new(Vector3::y()).limits(-2.0, 0.0).max_force(80.0);
/// assert_eq!(knee.limits, Some([-2.0, 0.0]));
/// ```
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct JointAxis {
    /// In the unit's reference frame, of any length but 0. The parent's follows from the [rest](Joint::rest).
    pub axis: Vector3<f32>,
    /// Least and greatest position: radians within half a turn to either side, or metres. `None`: it has no ends.
    pub limits: Option<[f32; 2]>,
    /// The most that takes it to a target: N m or N, above 0. `None`: whatever that takes.
    pub max_force: Option<f32>,
}

impl JointAxis {
    /// An axis in the unit's reference frame, without limits.
    pub const fn new(axis: Vector3<f32>) -> Self {
        JointAxis { axis, limits: None, max_force: None }
    }

    /// The same axis between two positions, radians or metres.
    pub const fn limits(self, least: f32, greatest: f32) -> Self {
        JointAxis { limits: Some([least, greatest]), ..self }
    }

    /// The same axis, whose target is reached with so much, N m or N.
    pub const fn max_force(self, max_force: f32) -> Self {
        JointAxis { max_force: Some(max_force), ..self }
    }
}

/// What a joint lets a unit do beside its parent.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[non_exhaustive]
pub enum JointKind {
    /// It turns about the pivot.
    #[default]
    Ball,
    /// It turns about an axis through the pivot.
    Revolute(JointAxis),
    /// It slides along an axis, and does not turn.
    Prismatic(JointAxis),
    /// It stays where it is in the parent's frame.
    Fixed,
}

/// What a unit shares with its parent: a pivot, one place that is fixed in the reference frames of both, and perhaps an axis.
///
/// Models that move units by impulses move joined ones by the dynamics of their joints, and balance the network's
/// corrections after that. Others know ball joints alone: steps end with moves that bring the two images of the pivot together.
///
/// ```
/// use nalgebra::{Isometry3, Point3};
/// use rigidformer_core::{Joint, Limits, Model, Physics, Posed, Simulator, SlabSizes, Slabs, Unit, UnitSlot};
/// # fn main() -> Result<(), Box<dyn std::error::Error>> {
/// let model = Model::load(rigidformer_weights::EDGE)?;
/// let limits = Limits { units: 2, points: 16 };
/// let sizes = SlabSizes::new(model.config(), limits);
/// # let (mut numbers, mut bytes) = (vec![0.0; sizes.f32], vec![0; sizes.i8]);
/// # let mut points = vec![Point3::origin(); sizes.points];
/// # let mut units = vec![UnitSlot::EMPTY; sizes.units];
/// # let slabs = Slabs { f32: &mut numbers, i8: &mut bytes, points: &mut points, units: &mut units };
/// let mut simulator = Simulator::new(&model, limits, slabs)?;
/// let corners = [0, 1, 2, 3, 4, 5, 6, 7].map(|i| {
///     let corner = |bit: i32| if i & bit == 0 { -0.1 } else { 0.1 };
///     Point3::new(corner(1), corner(2), corner(4))
/// });
/// let wood = Physics { mass_kg: 1.0, friction: 0.4, restitution: 0.3 };
/// let link = Unit::new(&corners, wood).body(1); // parts of one body do not collide
/// let at = |x| Posed { unit: link, previous: Isometry3::translation(x, 0.0, 0.5), current: Isometry3::translation(x, 0.0, 0.48) };
/// simulator.observe_poses(1.0 / 24.0, [at(0.0), at(0.2)])?;
/// let [parent, unit] = [0, 1].map(|number| simulator.unit(number).map(|unit| unit.id()));
/// let (parent, unit) = (parent.ok_or("no parent")?, unit.ok_or("no unit")?);
/// let (pivot, parent_pivot) = (Point3::new(-0.1, 0.0, 0.0), Point3::new(0.1, 0.0, 0.0));
/// simulator.join(&Joint::ball(unit, parent, pivot, parent_pivot))?;
/// for _ in 0..6 {
///     simulator.step()?;
/// }
/// let own = simulator.pose(unit).ok_or("no unit")? * pivot;
/// let parents = simulator.pose(parent).ok_or("no parent")? * parent_pivot;
/// assert!((own - parents).norm() < 1e-6);
/// # Ok(())
/// # }
/// ```
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Joint {
    /// The unit that hangs.
    pub unit: UnitId,
    /// The unit that it hangs from.
    pub parent: UnitId,
    /// The pivot in the unit's reference frame, metres.
    pub pivot: Point3<f32>,
    /// The pivot in the parent's reference frame, metres.
    pub parent_pivot: Point3<f32>,
    /// What it lets the unit do.
    pub kind: JointKind,
    /// The unit's rotation in the parent's reference frame at position 0. `None`: as the two are when they are joined. Balls have none.
    pub rest: Option<UnitQuaternion<f32>>,
}

impl Joint {
    /// One that a unit turns about freely.
    pub const fn ball(
        unit: UnitId,
        parent: UnitId,
        pivot: Point3<f32>,
        parent_pivot: Point3<f32>,
    ) -> Self {
        Joint { unit, parent, pivot, parent_pivot, kind: JointKind::Ball, rest: None }
    }

    /// The same joint of another kind.
    pub const fn kind(self, kind: JointKind) -> Self {
        Joint { kind, ..self }
    }

    /// The joint that a unit hangs by.
    pub(crate) fn of(unit: &UnitSlot) -> Option<Joint> {
        let Above { parent, pivot, parent_pivot, guide } = unit.link.above?;
        let Guide { way, axis, limits, force, .. } = guide;
        let [least, most] = limits;
        let limits = (least.is_finite() || most.is_finite()).then_some(limits);
        let axis = JointAxis { axis, limits, max_force: force.is_finite().then_some(force) };
        let kind = match way {
            Way::Ball => JointKind::Ball,
            Way::Turns => JointKind::Revolute(axis),
            Way::Slides => JointKind::Prismatic(axis),
            Way::Fixed => JointKind::Fixed,
        };
        let rest = (way != Way::Ball).then(|| rest_of(&guide));
        let parent = UnitId::from_bits(parent);
        Some(Joint { unit: unit.id, parent, pivot, parent_pivot, kind, rest })
    }

    /// What the unit keeps of it, with the rotation at position 0 where that is not given. Its axis is of length 1.
    pub(crate) fn link(&self, rest: UnitQuaternion<f32>) -> Link {
        let Joint { parent, pivot, parent_pivot, kind, .. } = *self;
        let way = match kind {
            JointKind::Ball => Way::Ball,
            JointKind::Revolute(_) => Way::Turns,
            JointKind::Prismatic(_) => Way::Slides,
            JointKind::Fixed => Way::Fixed,
        };
        let mut guide = Guide { way, ..Guide::BALL };
        if way != Way::Ball {
            guide.rest = rest.coords.into();
        }
        if let Some(JointAxis { axis, limits, max_force }) = kind.axis() {
            guide.axis = axis;
            guide.limits = limits.unwrap_or(guide.limits);
            guide.force = max_force.unwrap_or(guide.force);
        }
        let parent = parent.to_bits();
        Link { above: Some(Above { parent, pivot, parent_pivot, guide }), ..Link::NONE }
    }
}

impl JointKind {
    /// The axis, if it has one.
    pub const fn axis(&self) -> Option<JointAxis> {
        match self {
            JointKind::Revolute(axis) | JointKind::Prismatic(axis) => Some(*axis),
            JointKind::Ball | JointKind::Fixed => None,
        }
    }
}

/// The rotation of a unit in its parent's frame at position 0.
fn rest_of(guide: &Guide) -> UnitQuaternion<f32> {
    UnitQuaternion::new_unchecked(Quaternion::from(guide.rest))
}

/// Position of the joint of a unit among those of a copy, rad or m; none without an axis.
pub(crate) fn position(units: &[UnitSlot], unit: &UnitSlot, length: f32) -> Option<f32> {
    let above = unit.link.above.as_ref().filter(|above| above.guide.way.has_axis())?;
    let parent = units.get(number(units, UnitId::from_bits(above.parent))?)?;
    let states = [unit.state(), parent.state()];
    let hinge = hinge(above, &states, [unit, parent], length);
    Some(if above.guide.way == Way::Slides { hinge.position * length } else { hinge.position })
}

/// A joint where its unit and its parent are in these states.
fn hinge(
    above: &Above,
    [own, parents]: &[State; 2],
    [unit, parent]: [&UnitSlot; 2],
    length: f32,
) -> Hinge {
    let low = own.course.centre_low - parents.course.centre_low;
    let apart = (own.pose.centre - parents.pose.centre) + low;
    let rotations = [own.pose.rotation, parents.pose.rotation];
    Hinge::of(above, &rotations, ([&unit.offset, &parent.offset], length), &apart)
}

/// Joints in a step.
pub(crate) struct Joints;

impl Structure for Joints {
    fn constrain<S: Schedule>(_: S, attempt: Attempt<'_, '_>) -> Result<(), usize> {
        let Attempt { model, scene, copy, next, .. } = attempt;
        let first = copy * scene.per_copy;
        let motion = model.config().motion;
        hold_together(scene, first, (sweeps(motion), motion.has_impulses()), next);
        // What is held stays, wherever that is.
        let is_lost = |(state, unit): (&[f32], &UnitSlot)| {
            !unit.is_quarantined() && !scene.measure.allows(&State::read(state))
        };
        let mut units = rows(next, STATE).zip(scene.units().iter().skip(first));
        units.position(is_lost).map_or(Ok(()), Err)
    }
}

/// Sweeps over the joints that also turn units: what they leave of a gap, centres close exactly.
const TURNS: usize = 4;

/// What impulses leave of a gap, in levers.
const CLOSED: f32 = 1e-6;

/// How many of them a model takes. Models of robots predict how links turn, and better than pushes at pivots do: there
/// centres alone move.
fn sweeps(motion: Motion) -> usize {
    if motion.is_robot() { 0 } else { TURNS }
}

/// Forgets joints to a unit that is no more.
pub(crate) fn forget(units: &mut [UnitSlot], id: UnitId) {
    for unit in units {
        if unit.link.above.is_some_and(|above| above.parent == id.to_bits()) {
            unit.link = Link::NONE;
        }
    }
}

/// Whether a unit hangs from another, directly or through others; also whether it is that one.
pub(crate) fn hangs_from(units: &[UnitSlot], mut id: UnitId, other: UnitId) -> bool {
    // A way up that is longer than that would be a circle.
    for _ in 0..=units.len() {
        if id == other {
            return true;
        }
        let joint = number(units, id).and_then(|number| Joint::of(units.get(number)?));
        let Some(joint) = joint else { return false };
        id = joint.parent;
    }
    true
}

/// Number of a unit among those of a copy: names rise.
fn number(units: &[UnitSlot], id: UnitId) -> Option<usize> {
    units.binary_search_by_key(&id, |unit| unit.id).ok()
}

/// Brings the two images of each pivot together, by `sweeps` of pushes that also turn units and then exactly by moving centres:
/// `next`, (units of the copy, [`STATE`]), has where they go. A tree of free units keeps its centre of mass. Units that nothing moves stay: what hangs from
/// them, directly or through free units, hangs from the nearest one; the rest of the tree from the first such unit that hangs
/// from no other. Where impulses `hold` joints already, that is no velocity, and axes come together too.
fn hold_together(
    scene: &mut Scene<'_>,
    first: usize,
    (sweeps, hold): (usize, bool),
    next: &mut [f32],
) {
    let (length, count) = (scene.measure.length(), scene.per_copy);
    let units = scene.units_mut().get_mut(first..first + count).unwrap_or_default();
    // Most scenes have no joints.
    if units.iter().all(|unit| unit.link.above.is_none()) {
        return;
    }
    for _ in 0..sweeps {
        for number in 0..count {
            turn(units, number, (length, hold), &mut *next);
        }
    }
    for (number, unit) in units.iter_mut().enumerate() {
        let root = unit.link.above.is_none().then_some(number);
        let held = (!unit.is_free()).then_some(number);
        unit.link = Link { above: unit.link.above, root, held, ..Link::NONE };
    }
    // Parents may stand behind the units that hang from them.
    for _ in 0..count {
        let mut is_done = true;
        for number in 0..count {
            let Some(link) = hung(units, number, (length, hold), next) else { continue };
            is_done = false;
            if let Some(unit) = units.get_mut(number) {
                unit.link = link;
            }
            if let Some(root) = link.root.and_then(|root| units.get_mut(root)) {
                root.link.carries = true;
            }
        }
        // Each round finds at least one link more, so there are no more rounds than units.
        if is_done {
            break;
        }
    }
    for root in 0..count {
        if !units.get(root).is_some_and(|unit| unit.link.carries) {
            continue;
        }
        // The tree as a whole must not jump: it moves against what joints moved in it.
        let stays = stay(units, root);
        for (number, row) in rows_mut(next, STATE).enumerate() {
            let Some(unit) = units.get(number).filter(|unit| unit.link.root == Some(root)) else {
                continue;
            };
            let from = match unit.link.held {
                Some(held) => units.get(held).map_or(stays, |unit| unit.link.way),
                None => stays,
            };
            let way = unit.link.way - from;
            // Adding a zero would change the sign of another.
            if way != Vector3::zeros() {
                let mut state = State::read(row);
                if hold {
                    state.shift(&way);
                } else {
                    state.push(&way);
                }
                state.write(row);
            }
        }
    }
}

/// What moves at a pivot.
struct Side {
    number: usize,
    state: State,
    /// From the centre to the pivot.
    arm: Vector3<f32>,
    /// 1 / mass, in the lighter unit's, and those of the principal moments; 0 where nothing moves the unit.
    lightness: f32,
    yields: Vector3<f32>,
}

impl Side {
    fn new(
        (number, unit): (usize, &UnitSlot),
        (pivot, mass): (&Point3<f32>, f32),
        (length, next): (f32, &[f32]),
    ) -> Option<Side> {
        let state = State::read(next.get(number * STATE..)?.get(..STATE)?);
        let pose = state.pose;
        let arm = rotate(&pose.rotation, &((pivot - unit.offset) / length));
        let lightness = unit.lightness() * mass;
        let yields = unit.inertia_m2.map(|moment| lightness / moment);
        Some(Side { number, state, arm, lightness, yields })
    }

    fn image(&self) -> Vector3<f32> {
        self.state.pose.centre + self.arm
    }

    /// The turn that a push at the pivot makes.
    fn turn(&self, push: &Vector3<f32>) -> Vector3<f32> {
        let rotation = &self.state.pose.rotation;
        let about = rotate_back(rotation, &self.arm.cross(push));
        rotate(rotation, &about.component_mul(&self.yields))
    }

    /// How far a push at the pivot moves it.
    fn way(&self, push: &Vector3<f32>) -> Vector3<f32> {
        push * self.lightness + self.turn(push).cross(&self.arm)
    }

    /// Moves the unit by a push at the pivot, which is no velocity where impulses `hold` joints.
    fn moved(&self, push: &Vector3<f32>, hold: bool) -> State {
        let (mut state, turn) = (self.state, self.turn(push));
        if hold {
            state.shift(&(push * self.lightness));
            state.turn(&turn);
        } else {
            state.push(&(push * self.lightness));
            state.push_turn(&turn);
        }
        state
    }
}

/// Moves and turns a unit and its parent by a push and its counterpart at their pivot, so that its images meet.
fn turn(
    units: &[UnitSlot],
    number: usize,
    (length, hold): (f32, bool),
    next: &mut [f32],
) -> Option<()> {
    let unit = units.get(number)?;
    let joint = Joint::of(unit)?;
    let above = self::number(units, joint.parent)?;
    let parent = units.get(above)?;
    // Products of three weights stay within f32, whatever the masses.
    let mass = unit.mass.min(parent.mass);
    let own = Side::new((number, unit), (&joint.pivot, mass), (length, next))?;
    let parents = Side::new((above, parent), (&joint.parent_pivot, mass), (length, next))?;
    let mut gap = parents.image() - own.image();
    if hold {
        let above = unit.link.above.as_ref()?;
        gap = hinge(above, &[own.state, parents.state], [unit, parent], length).gap;
        // Impulses have closed it, and nothing has moved it since.
        if gap.amax() <= CLOSED * (own.arm.amax() + parents.arm.amax()) {
            return None;
        }
    }
    let [x, y, z] =
        [Vector3::x(), Vector3::y(), Vector3::z()].map(|push| own.way(&push) + parents.way(&push));
    let volume = dot(&x, &y.cross(&z));
    // Nothing moves either.
    if volume <= 0.0 {
        return None;
    }
    let push =
        Vector3::new(dot(&y.cross(&z), &gap), dot(&z.cross(&x), &gap), dot(&x.cross(&y), &gap))
            / volume;
    for (side, push) in [(&own, push), (&parents, -push)] {
        if side.lightness > 0.0 {
            side.moved(&push, hold).write(next.get_mut(side.number * STATE..)?.get_mut(..STATE)?);
        }
    }
    Some(())
}

/// The link of a unit whose parent's way is known and whose own is not.
fn hung(
    units: &[UnitSlot],
    number: usize,
    (length, hold): (f32, bool),
    next: &mut [f32],
) -> Option<Link> {
    let unit = units.get(number).filter(|unit| unit.link.root.is_none())?;
    let joint = Joint::of(unit)?;
    let above = self::number(units, joint.parent)?;
    let parent = units.get(above)?;
    let root = parent.link.root?;
    if hold {
        return hung_here(units, [number, above], length, next);
    }
    let pose = |number: usize| -> Option<Pose> { Some(read_pose(next.get(number * STATE..)?)) };
    let (own, parents) = (pose(number)?, pose(above)?);
    let arm = |pose: &Pose, pivot: &Point3<f32>, unit: &UnitSlot| {
        rotate(&pose.rotation, &((pivot - unit.offset) / length))
    };
    let arms = arm(&parents, &joint.parent_pivot, parent) - arm(&own, &joint.pivot, unit);
    let way = parent.link.way + ((parents.centre - own.centre) + arms);
    Some(Link {
        above: unit.link.above,
        way,
        root: Some(root),
        held: unit.link.held.or(parent.link.held),
        carries: false,
    })
}

/// As [`hung`], of a unit and its parent where impulses hold joints: turns the unit to where its joint wants it.
fn hung_here(
    units: &[UnitSlot],
    [number, above]: [usize; 2],
    length: f32,
    next: &mut [f32],
) -> Option<Link> {
    let (unit, parent) = (units.get(number)?, units.get(above)?);
    let joint = unit.link.above.as_ref()?;
    let state = |next: &[f32], number: usize| Some(State::read(next.get(number * STATE..)?));
    let parents = state(next, above)?;
    let mut own = state(next, number)?;
    let mut lacks = hinge(joint, &[own, parents], [unit, parent], length);
    if unit.is_free() && lacks.tilt.amax() > CLOSED {
        own.turn(&lacks.tilt);
        own.write(next.get_mut(number * STATE..)?);
        lacks = hinge(joint, &[own, parents], [unit, parent], length);
    }
    Some(Link {
        above: unit.link.above,
        way: parent.link.way + lacks.gap,
        root: parent.link.root,
        held: unit.link.held.or(parent.link.held),
        carries: false,
    })
}

/// The way of what stays in a tree, if its root did: the first unit that nothing moves and that hangs from no other such, or
/// the centre of mass.
fn stay(units: &[UnitSlot], root: usize) -> Vector3<f32> {
    let tree = || units.iter().enumerate().filter(|(_, unit)| unit.link.root == Some(root));
    let is_first = |(number, unit): &(usize, &UnitSlot)| {
        let parent =
            Joint::of(unit).and_then(|joint| units.get(self::number(units, joint.parent)?));
        unit.link.held == Some(*number) && parent.is_none_or(|parent| parent.link.held.is_none())
    };
    if let Some((_, held)) = tree().find(is_first) {
        return held.link.way;
    }
    let (mut mass, mut sum) = (0.0, Vector3::zeros());
    for (_, unit) in tree() {
        mass += unit.mass;
        sum += unit.link.way * unit.mass;
    }
    sum / mass
}
