//! The world that the solver works in, and units as it moves them.

use crate::contact::ground::Plane;
#[cfg(feature = "terrain")]
use crate::contact::height_field::Surface;
use crate::contact::law::FrictionLimit;
use crate::contact::pieces::Piece;
#[cfg(feature = "robot")]
use crate::geometry::squared;
use crate::geometry::{
    POSE, Pose, STATE, State, dot, norm, read_pose, rotate, rotate_back, swing, turned, write_pose,
};
use crate::math;
use crate::scene::{Compliance, Role, Scene, UnitSlot, members};
use nalgebra::{Matrix3, Point3, Vector3};

/// Slower approaches do not bounce, in sqrt(gravity x radius); the network corrects motion this fast in full. Else what
/// lands would bounce on for ever.
const BOUNCE: f32 = 0.1;
/// Below SLOW x BOUNCE the network's correction is zero, so that bodies about to rest can rest.
const SLOW: f32 = 0.25;
/// Contact that lasts changes up to this, in gravity x dt, and the network corrects little of it: small errors would add
/// up step after step.
const LASTING: f32 = 1.5;
/// Approaches that gravity gives within half a step and a solver's substep do not bounce, with 5 % to spare. Two frames
/// cannot tell rest from half a step's fall, and gravity acts for a substep before contacts are found.
const STILL: f32 = 1.05;
/// What moved slower between the two observed frames lay still, in gravity x dt. Sensors and rounding make rest look like
/// slow motion.
const HELD: f32 = 0.1;
/// What touches something held, is slower at both ends of a step and stays within its skin rests, in gravity x dt: its pose then
/// stays to the bit.
const REST: f32 = 0.02;
/// Times as fast as what rests elsewhere on ground of varying height.
#[cfg(feature = "terrain")]
const ROCKING: f32 = 2.0;
/// Of the speed of what rests: so slow that it makes no difference to rest.
const SLIGHT: f32 = 1.0 / 64.0;
/// Parts of a substep that it may be cut by: a power of two, so that a whole one is a share of the step to the bit.
pub(super) const TICKS: u16 = 16;
/// Share of an overlap that a substep pushes away. All at once would throw stacks that several contacts hold. More substeps push less
/// each.
const PUSHED: f32 = 0.5;
/// Radians of a contact's spring in a substep: more would cost it energy.
#[cfg(feature = "compliance")]
const PHASE: f32 = 0.25;
/// Substeps of a step where contact gives way, at most: a bound on its time.
#[cfg(feature = "compliance")]
const MOST_GIVING_SUBSTEPS: u8 = 64;
/// Substeps a second where units hang together, at least: the error of joints falls with the square.
#[cfg(feature = "robot")]
const JOINED_HZ: f32 = 600.0;
/// A step may be longer by this share of such a substep: 20 / 600 s are 20 of them in f32 too.
#[cfg(feature = "robot")]
const JOINED_SLACK: f32 = 0.01;
/// Such substeps of a step, at most: a bound on its time.
#[cfg(feature = "robot")]
const MOST_JOINED_SUBSTEPS: u8 = 96;
/// Weight of a unit by that of a corner of a box, about.
#[cfg(feature = "compliance")]
const CORNERS: f32 = 4.0;
/// Of a coordinate: what a gap may be off. Units that fall into that in a step rest too, if they are not too fast.
const ROUNDING: f32 = 4.0 * f32::EPSILON;
/// Units keep this distance, in radii: hulls that do not overlap have an exact normal.
const SKIN: f32 = 0.002;
/// Level of what touches nothing that is held: above every level that is counted.
pub(super) const FAR: f32 = 1000.0;

/// Numbers of a unit's velocity and spin, and of what moves it.
pub(super) const MOVER: usize = 13;
/// Numbers of a unit's level, touches and speed.
pub(super) const MARKS: usize = 3;
/// Numbers of the shift and the turn that push a unit out of others.
pub(super) const SHIFT: usize = 6;
/// Numbers of the ball that a unit stays in for a substep, and of the box. Microcontrollers have none: they look at all pairs, for less
/// memory.
pub(super) const BALL: usize = if cfg!(rigidformer_host) { 7 } else { 0 };
/// Numbers of a unit's range for the step, of what becomes of it there and of its contacts. Microcontrollers have none,
/// as above.
pub(super) const RANGE: usize = if cfg!(rigidformer_host) { 7 } else { 0 };
/// Substeps look at the unit.
#[cfg(rigidformer_host)]
const AWAKE: f32 = 0.0;
/// The unit can touch nothing in the step, so no substep looks at it.
#[cfg(rigidformer_host)]
const FLIES: f32 = 1.0;
/// The unit stays as it is to the bit, so no substep looks at it.
#[cfg(rigidformer_host)]
const STAYS: f32 = 2.0;
/// The unit is fixed, and wakes nothing.
#[cfg(rigidformer_host)]
const FIXED: f32 = 3.0;
/// Times that what is awake wakes what it can touch. A longer chain wakes all: a bound on time.
#[cfg(rigidformer_host)]
const WAKES: usize = 8;
/// Numbers that [`solve`](super::solve) tells of a unit: its next state, and how much the network corrects.
pub(crate) const PRIOR: usize = STATE + 1;
/// Numbers of a unit in the scratch. Its velocity, its spin and how far it has moved are in its row of the result, which is
/// written when they are of no more use: memory is dear.
pub(super) const BODY: usize = POSE + MARKS + SHIFT;
/// Units of a copy that boxes are found for, at least.
#[cfg(rigidformer_host)]
const FEWEST_BOXED: usize = 16;
/// Points of a unit that one is found for, at most.
#[cfg(rigidformer_host)]
const MOST_BOXED: usize = 16;
/// Rounding may take this share of a ball's radius: a ball that is too small would hide a contact.
#[cfg(rigidformer_host)]
const BALL_SLACK: f32 = 1e-4;

/// What does not change in a step.
#[derive(Clone, Copy)]
pub(super) struct World<'s> {
    /// Those of the copy.
    pub(super) units: &'s [UnitSlot],
    pub(super) scene: &'s Scene<'s>,
    /// Gravity without its direction, m/s^2.
    gravity_size: f32,
    /// Substeps of the step.
    pub(super) substeps: u8,
    /// Of the one at hand.
    pub(super) ticks: u16,
    /// Its seconds.
    pub(super) substep_s: f32,
    /// Share of an overlap that is pushed away in one.
    pub(super) pushes: f32,
    /// Whether any contact gives way.
    #[cfg(feature = "compliance")]
    gives_way: bool,
    /// Whether units hang together.
    #[cfg(feature = "robot")]
    pub(super) has_trees: bool,
    #[cfg(feature = "terrain")]
    pub(super) terrain: Option<MeasuredTerrain<'s>>,
}

/// Ground of varying height in the scene's measure.
#[cfg(feature = "terrain")]
#[derive(Clone, Copy)]
pub(super) struct MeasuredTerrain<'s> {
    pub(super) surface: Surface<'s>,
    pub(super) highest: f32,
    pub(super) friction: f32,
    pub(super) restitution: f32,
}

#[cfg(feature = "terrain")]
impl<'s> MeasuredTerrain<'s> {
    fn of(scene: &Scene<'s>) -> Option<Self> {
        let crate::scene::Terrain { field, highest_m, .. } = scene.terrain?;
        let surface = Surface::new(&field, &scene.measure);
        let highest = surface.highest(highest_m);
        let (friction, restitution) = (field.friction, field.restitution);
        Some(MeasuredTerrain { surface, highest, friction, restitution })
    }
}

/// How a pair gives way.
#[derive(Clone, Copy)]
pub(super) struct Give {
    /// 1 / stiffness, m/N; 0: it does not.
    compliance: f32,
    /// Times the dissipation, s/N.
    lost: f32,
}

impl Give {
    /// Of one of a pair.
    #[inline(always)]
    fn of(compliance: Compliance) -> Self {
        if compliance.is_rigid() {
            return Give { compliance: 0.0, lost: 0.0 };
        }
        let own = 1.0 / compliance.stiffness_n_m;
        Give { compliance: own, lost: compliance.dissipation_s_m * own }
    }

    /// Two in series.
    #[inline(always)]
    fn and(self, other: Give) -> Self {
        Give { compliance: self.compliance + other.compliance, lost: self.lost + other.lost }
    }
}

/// A spring and a damper in the scene's measure.
pub(super) struct Spring {
    /// N/m
    pub(super) stiffness: f32,
    /// s/m
    pub(super) dissipation: f32,
}

impl<'s> World<'s> {
    /// Whether contacts that bounce have pyramids of friction.
    #[inline(always)]
    pub(super) fn has_pyramids(&self) -> bool {
        self.scene.contact_law.friction == FrictionLimit::Pyramid
    }

    pub(super) fn new(scene: &'s Scene<'s>, first: usize, substeps: u8) -> Self {
        let (_, units) = scene.around(first);
        let substep_s = scene.dt / f32::from(substeps);
        let gravity_size = norm(&scene.gravity);
        World {
            units,
            scene,
            gravity_size,
            substeps,
            ticks: TICKS,
            substep_s,
            pushes: PUSHED,
            #[cfg(feature = "compliance")]
            gives_way: false,
            #[cfg(feature = "robot")]
            has_trees: units.iter().any(|unit| unit.link.above.is_some()),
            #[cfg(feature = "terrain")]
            terrain: MeasuredTerrain::of(scene),
        }
        .finer()
        .with_trees()
    }

    /// In as many substeps as joints want.
    #[cfg(feature = "robot")]
    fn with_trees(self) -> Self {
        let mut substeps = self.substeps;
        while self.has_trees
            && substeps < MOST_JOINED_SUBSTEPS
            && f32::from(substeps) < self.scene.dt * JOINED_HZ - JOINED_SLACK
        {
            substeps += 1;
        }
        if substeps == self.substeps {
            return self;
        }
        let pushes = self.pushes * f32::from(self.substeps) / f32::from(substeps);
        World { substeps, substep_s: self.scene.dt / f32::from(substeps), pushes, ..self }
    }

    /// As they are.
    #[cfg(not(feature = "robot"))]
    #[inline(always)]
    fn with_trees(self) -> Self {
        self
    }

    /// Whether units hang together.
    #[inline(always)]
    pub(super) fn has_trees(&self) -> bool {
        #[cfg(feature = "robot")]
        return self.has_trees;
        #[cfg(not(feature = "robot"))]
        false
    }

    /// Seconds of so many of the step's ticks.
    pub(super) fn seconds(&self, ticks: u16) -> f32 {
        f32::from(ticks) * (self.scene.dt / f32::from(TICKS * u16::from(self.substeps)))
    }

    /// What gravity adds to a velocity in half a substep, m/s.
    #[cfg(feature = "robot")]
    pub(super) fn half_gravity(&self) -> Vector3<f32> {
        self.scene.gravity * (0.5 * self.substep_s)
    }

    /// The most that takes a joint to its target, in the scene's measure; infinite without a limit.
    #[cfg(feature = "robot")]
    pub(super) fn force(&self, above: &crate::structure::link::Above) -> f32 {
        let measure = &self.scene.measure;
        let (second, length) = (self.scene.second.get().copied().unwrap_or(1.0), measure.length());
        let newtons = above.guide.force * ((second * second) / (measure.mass() * length));
        match above.guide.way {
            crate::structure::link::Way::Slides => newtons,
            _ => newtons / length,
        }
    }

    /// The world of a substep of so many [`TICKS`].
    pub(super) fn part(&self, ticks: u16) -> Self {
        let Self { scene, substeps, .. } = *self;
        let substep_s = f32::from(ticks) * (scene.dt / f32::from(TICKS * u16::from(substeps)));
        let pushes = self.pushes * (f32::from(ticks) / f32::from(TICKS));
        Self { substep_s, ticks, pushes, ..*self }
    }

    /// Of so many sweeps those of the substep at hand.
    pub(super) fn share_of(&self, sweeps: u8) -> u8 {
        (u16::from(sweeps) * self.ticks / TICKS) as u8
    }

    /// In as many substeps as the springs of contact want.
    #[cfg(feature = "compliance")]
    fn finer(self) -> Self {
        let World { units, scene, .. } = self;
        let own = |unit: &UnitSlot| self.stiffness(&Give::of(unit.compliance()));
        let planes = (0..scene.planes.len())
            .map(|plane| self.stiffness(&Give::of(scene.plane_compliance(plane))));
        let stiffest = units.iter().map(own).chain(planes).fold(0.0, f32::max);
        if stiffest == 0.0 {
            return self;
        }
        // Of each free unit against the stiffest that it may touch: rad/s, squared.
        let fastest = units.iter().filter(|unit| unit.is_free()).fold(0.0_f32, |fastest, unit| {
            let own = own(unit);
            fastest.max(CORNERS * if own > 0.0 { own } else { stiffest } / unit.mass)
        });
        let mut substeps = self.substeps;
        let time = scene.dt / PHASE;
        let wanted = fastest * (time * time);
        while substeps < MOST_GIVING_SUBSTEPS && f32::from(substeps) * f32::from(substeps) < wanted
        {
            substeps += 1;
        }
        let substep_s = scene.dt / f32::from(substeps);
        let pushes = PUSHED * f32::from(self.substeps) / f32::from(substeps);
        World { substeps, substep_s, pushes, gives_way: true, ..self }
    }

    /// As they are.
    #[cfg(not(feature = "compliance"))]
    #[inline(always)]
    fn finer(self) -> Self {
        self
    }

    /// Whether any contact gives way.
    #[inline(always)]
    pub(super) fn gives_way(&self) -> bool {
        #[cfg(feature = "compliance")]
        return self.gives_way;
        #[cfg(not(feature = "compliance"))]
        false
    }

    /// How two units give way where they touch.
    #[inline(always)]
    pub(super) fn give(&self, unit: &UnitSlot, other: &UnitSlot) -> Give {
        Give::of(unit.compliance()).and(Give::of(other.compliance()))
    }

    /// Whether a unit and a plane give way.
    #[inline(always)]
    pub(super) fn gives_way_on(&self, unit: &UnitSlot, plane: usize) -> bool {
        unit.gives_way_on(self.scene, plane)
    }

    /// How a unit and a plane give way.
    #[inline(always)]
    pub(super) fn give_on(&self, unit: &UnitSlot, plane: usize) -> Give {
        Give::of(unit.compliance()).and(Give::of(self.scene.plane_compliance(plane)))
    }

    /// How a unit on rigid ground gives way.
    #[cfg(feature = "terrain")]
    #[inline(always)]
    pub(super) fn give_alone(&self, unit: &UnitSlot) -> Give {
        Give::of(unit.compliance())
    }

    /// Whether a place is farther than this from all ground.
    #[cfg(rigidformer_host)]
    fn is_high(&self, centre: &Vector3<f32>, reach: f32) -> bool {
        #[cfg(feature = "terrain")]
        let is_near = |above: f32| above <= reach || above.is_nan();
        if self.terrain.is_some_and(|terrain| is_near(centre.z - terrain.highest)) {
            return false;
        }
        self.planes().iter().all(|plane| plane.height_here(centre) > reach)
    }

    /// N/m in the scene's measure; 0: it does not give way.
    #[inline(always)]
    fn stiffness(&self, give: &Give) -> f32 {
        let Some(second) = self.scene.second.get().filter(|_| give.compliance > 0.0) else {
            return 0.0;
        };
        (second * second) / (self.scene.measure.mass() * give.compliance)
    }

    /// The spring of a pair; none where it does not give way.
    #[inline(always)]
    pub(super) fn spring(&self, give: &Give) -> Option<Spring> {
        let stiffness = self.stiffness(give);
        let second = self.scene.second.get().filter(|_| stiffness > 0.0)?;
        let dissipation = (give.lost / give.compliance) * (self.scene.measure.length() / second);
        Some(Spring { stiffness, dissipation })
    }

    pub(super) fn planes(&self) -> &'s [Plane] {
        &self.scene.planes
    }

    /// What the solver moves: units alone, and the first one of each cluster, which stands for all of it.
    fn moved(&self) -> impl Iterator<Item = (usize, &'s UnitSlot)> + use<'s> {
        let is_moved = |(number, unit): &(usize, &UnitSlot)| {
            unit.cluster_root().is_none_or(|cluster_root| cluster_root == *number)
        };
        self.units.iter().enumerate().filter(is_moved)
    }

    /// The units of the cluster that a unit is in.
    fn around(&self, cluster_root: usize) -> impl Iterator<Item = (usize, &'s UnitSlot)> + use<'s> {
        members(self.units, cluster_root)
    }

    /// 1 / mass of what moves with a unit, kg^-1; 0 where nothing moves it.
    pub(super) fn lightness(&self, unit: &UnitSlot) -> f32 {
        match unit.cluster_root() {
            None => unit.lightness(),
            Some(cluster_root) => {
                1.0 / self.around(cluster_root).fold(0.0, |mass, (_, unit)| mass + unit.mass)
            }
        }
    }

    /// Convex pieces of a unit.
    pub(super) fn pieces(&self, unit: &UnitSlot) -> usize {
        usize::from(unit.pieces.max(1))
    }

    /// One of them, grown by [`round`](Self::round).
    pub(super) fn piece(&self, unit: &UnitSlot, number: usize) -> Piece<'s> {
        if unit.pieces > 0 {
            return self.scene.piece_of(unit, number);
        }
        let (points, radius) = (self.hull_of(unit), unit.radius);
        Piece { points, middle: Vector3::zeros(), radius }
    }

    /// The points whose hull a unit is, grown by [`round`](Self::round).
    pub(super) fn hull_of(&self, unit: &UnitSlot) -> &'s [Point3<f32>] {
        const MIDDLE: &[Point3<f32>] = &[Point3::new(0.0, 0.0, 0.0)];
        if unit.is_ball { MIDDLE } else { self.scene.hull_of(unit) }
    }

    /// Half the sides of a box along the world's axes that holds a unit turned so, about its centre, metres. Where units are few or have
    /// many points, the box of its ball: finding it would take longer than it saves.
    #[cfg(rigidformer_host)]
    fn half_sides(&self, unit: &UnitSlot, rotation: &Matrix3<f32>) -> Vector3<f32> {
        let points = self.hull_of(unit);
        if unit.is_ball || points.len() > MOST_BOXED || self.units.len() < FEWEST_BOXED {
            return Vector3::repeat(unit.radius);
        }
        // What is not a number stays, and keeps nothing apart.
        let farther = |most: f32, way: f32| if way.abs() <= most { most } else { way.abs() };
        let sides = |most: Vector3<f32>, point: &Point3<f32>| {
            most.zip_map(&rotate(rotation, &point.coords), farther)
        };
        points.iter().fold(Vector3::zeros(), sides)
    }

    /// How far a unit's surface is from its hull, metres.
    pub(super) fn round(&self, unit: &UnitSlot) -> f32 {
        if unit.is_ball { unit.radius } else { 0.0 }
    }

    /// Speed after a fall over a two-hundredth of a radius, m/s.
    fn brisk(&self, radius: f32) -> f32 {
        BOUNCE * math::sqrt(self.gravity_size * radius)
    }

    /// Faster approaches bounce, m/s.
    pub(super) fn bounces(&self, radius: f32) -> f32 {
        let still = STILL * self.gravity_size * (0.5 * self.scene.dt + self.substep_s);
        self.brisk(radius).max(still)
    }

    /// The gap that two units keep whose smaller radius is this, metres.
    pub(super) fn skin(&self, radius: f32) -> f32 {
        SKIN * radius
    }

    /// What contact changed of a unit's motion in the step, less where that is slow in the end or no more than contact that
    /// lasts changes, m/s. `arm` is from the centre of the cluster that the motion is of, where it is one's.
    #[cfg_attr(rigidformer_dsp, inline(never))]
    pub(super) fn share(&self, unit: &UnitSlot, mover: &Mover, arm: Option<&Vector3<f32>>) -> f32 {
        let [velocity, spin] = self.incoming_motion(unit);
        let velocity = mover.velocity - (velocity + self.scene.gravity * self.scene.dt);
        let changed = Mover { velocity, spin: mover.spin - spin, ..Mover::STILL };
        let (changed, mover) = match arm {
            None => (changed, *mover),
            Some(arm) => (changed.at(arm), mover.at(arm)),
        };
        let (changed, speed) = (changed.speed(unit.radius), mover.speed(unit.radius));
        let brisk = self.brisk(unit.radius);
        let mut share = changed;
        // What is slow in the end is about to rest, and a correction would keep it from that.
        if speed < brisk {
            share *= (speed - SLOW * brisk).max(0.0) / ((1.0 - SLOW) * brisk);
        }
        let lasting = LASTING * self.gravity_size * self.scene.dt;
        // Faded in, so that no small change of the motion makes a large one of the correction.
        if share < 2.0 * lasting {
            share *= (share - lasting).max(0.0) / lasting;
        }
        share
    }

    /// What rounding may make of a gap between units as far along its normal as this, metres; 0 where units that fall into such gaps in a
    /// step are much slower than those that rest. Units of a radius stay nearer than they touch.
    pub(super) fn gap_rounding(&self, most: f32, radius: f32) -> f32 {
        let (rounding, dt) = (ROUNDING * most, self.scene.dt);
        match rounding > SLIGHT * REST * self.gravity_size * dt * dt {
            true => rounding.min(self.skin(radius)),
            false => 0.0,
        }
    }

    /// Whether a unit is near ground of varying height.
    #[cfg(feature = "terrain")]
    fn is_over_terrain(&self, unit: &UnitSlot) -> bool {
        let (centre, radius) = (&unit.current.centre, 2.0 * unit.radius);
        self.terrain.is_some_and(|terrain| {
            centre.z - terrain.highest <= radius && terrain.surface.is_under(centre, radius)
        })
    }

    /// Slower units rest, m/s.
    pub(super) fn rest(&self, unit: &UnitSlot) -> f32 {
        let (slow, dt) = (REST * self.gravity_size * self.scene.dt, self.scene.dt);
        let most = match unit.cluster_root() {
            None => unit.current.centre.amax(),
            Some(cluster_root) => self
                .around(cluster_root)
                .fold(0.0_f32, |most, (_, unit)| most.max(unit.current.centre.amax())),
        };
        let slow = slow + slow.min(ROUNDING * most / dt);
        // On uneven ground a unit stands on other points in each substep, and rocks a little.
        #[cfg(feature = "terrain")]
        if self.is_over_terrain(unit) {
            return ROCKING * slow;
        }
        slow
    }

    /// As [`own_motion`](Self::own_motion), of the cluster that a unit is in, at its centre of mass: means by mass.
    #[cfg_attr(rigidformer_dsp, inline(never))]
    fn incoming_motion(&self, unit: &UnitSlot) -> [Vector3<f32>; 2] {
        let Some(cluster_root) = unit.cluster_root() else { return self.own_motion(unit) };
        let (mut mass, mut sums) = (0.0, [Vector3::zeros(); 2]);
        for (_, unit) in self.around(cluster_root) {
            mass += unit.mass;
            for (sum, own) in sums.iter_mut().zip(self.own_motion(unit)) {
                *sum += own * unit.mass;
            }
        }
        sums.map(|sum| sum / mass)
    }

    /// Velocity (m/s) and spin (rad/s) with which a unit comes into the step.
    #[cfg_attr(rigidformer_dsp, inline(never))]
    fn own_motion(&self, unit: &UnitSlot) -> [Vector3<f32>; 2] {
        let dt = self.scene.dt;
        let way = match unit.role {
            Role::Free => unit.course.way,
            Role::Driven => unit.target.centre - unit.current.centre,
            Role::Fixed => return [Vector3::zeros(); 2],
        };
        let mut velocity = way / dt;
        // A way tells the mean velocity of the last step; gravity has acted for half a step since its middle.
        if unit.is_free() {
            velocity += self.scene.gravity * (0.5 * dt);
        }
        [velocity, unit.coming_turn() / dt]
    }

    /// What gravity adds to the velocity of free units in a substep, m/s.
    fn gravity_velocity_change(&self) -> Vector3<f32> {
        self.scene.gravity * self.substep_s
    }

    /// How far a step's mean velocity is from that at its end, as a way, metres.
    fn gravity_lag_m(&self) -> Vector3<f32> {
        self.scene.gravity * (0.5 * self.scene.dt * self.scene.dt)
    }

    /// The way and the turn of a step with this motion at its end.
    pub(super) fn motion(&self, mover: &Mover) -> [Vector3<f32>; 2] {
        let dt = self.scene.dt;
        [mover.velocity * dt - self.gravity_lag_m(), mover.spin * dt]
    }

    /// A unit at rest: the same each time, so that a state at rest stays to the bit.
    pub(super) fn lying(&self, unit: &UnitSlot) -> State {
        let course = unit.course.moving(-self.gravity_lag_m(), Vector3::zeros());
        State { pose: unit.current, course }
    }
}

/// A unit's motion and what an impulse changes of it. Zeros: nothing moves it.
#[derive(Clone, Copy)]
pub(super) struct Mover {
    /// m/s
    pub(super) velocity: Vector3<f32>,
    /// rad/s, in the world's axes
    pub(super) spin: Vector3<f32>,
    /// 1 / kg
    pub(super) lightness: f32,
    /// Inverse of the inertia in the world's axes, 1 / (kg m^2): xx, yy, zz, xy, xz, yz.
    pub(super) inverse: [f32; 6],
}

impl Mover {
    /// A plane.
    pub(super) const STILL: Mover = Mover {
        velocity: Vector3::new(0.0, 0.0, 0.0),
        spin: Vector3::new(0.0, 0.0, 0.0),
        lightness: 0.0,
        inverse: [0.0; 6],
    };

    #[inline]
    fn read(row: &[f32; MOVER]) -> Self {
        let [a, b, c, d, e, f, lightness, inverse @ ..] = *row;
        let (velocity, spin) = (Vector3::new(a, b, c), Vector3::new(d, e, f));
        Mover { velocity, spin, lightness, inverse }
    }

    #[inline]
    fn write(&self, row: &mut [f32; MOVER]) {
        let Mover { velocity: v, spin: w, lightness, inverse: [xx, yy, zz, xy, xz, yz] } = *self;
        *row = [v.x, v.y, v.z, w.x, w.y, w.z, lightness, xx, yy, zz, xy, xz, yz];
    }

    pub(super) fn is_moved(&self) -> bool {
        self.lightness > 0.0
    }

    /// The motion at an arm.
    pub(super) fn at(&self, arm: &Vector3<f32>) -> Self {
        Mover { velocity: self.speed_at(arm), ..*self }
    }

    /// From here on nothing moves it.
    #[inline]
    pub(super) fn hold(&mut self) {
        (self.lightness, self.inverse) = (0.0, [0.0; 6]);
    }

    /// How fast a point at an arm moves, m/s.
    #[inline]
    pub(super) fn speed_at(&self, arm: &Vector3<f32>) -> Vector3<f32> {
        self.velocity + self.spin.cross(arm)
    }

    #[inline]
    fn turns(&self, torque: &Vector3<f32>) -> Vector3<f32> {
        let [xx, yy, zz, xy, xz, yz] = self.inverse;
        let t = torque;
        Vector3::new(
            (xx * t.x + xy * t.y) + xz * t.z,
            (xy * t.x + yy * t.y) + yz * t.z,
            (xz * t.x + yz * t.y) + zz * t.z,
        )
    }

    /// What an impulse (N s) at an arm adds to velocity and spin.
    #[inline]
    pub(super) fn apply_impulse(&mut self, arm: &Vector3<f32>, impulse: &Vector3<f32>) {
        self.velocity += impulse * self.lightness;
        self.spin += self.turns(&arm.cross(impulse));
    }

    /// Velocity along a direction that a unit impulse there gives the point at an arm, 1 / kg.
    pub(super) fn inverse_mass_at(&self, arm: &Vector3<f32>, along: &Vector3<f32>) -> f32 {
        let lever = arm.cross(along);
        // Not negative but for rounding.
        self.lightness + dot(&lever, &self.turns(&lever)).max(0.0)
    }

    /// Spin along a direction that a unit angular impulse about it gives, 1 / (kg m^2).
    pub(super) fn turn_along(&self, along: &Vector3<f32>) -> f32 {
        dot(along, &self.turns(along)).max(0.0)
    }

    /// Adds what an angular impulse (N m s) changes of the spin.
    #[inline]
    pub(super) fn twist(&mut self, impulse: &Vector3<f32>) {
        self.spin += self.turns(impulse);
    }

    /// What an angular impulse (N m s) changes of the velocity at an arm, m/s.
    #[inline]
    pub(super) fn turned_at(&self, impulse: &Vector3<f32>, arm: &Vector3<f32>) -> Vector3<f32> {
        self.turns(impulse).cross(arm)
    }

    /// Metres a second that no point of the unit is faster than.
    pub(super) fn speed(&self, radius: f32) -> f32 {
        norm(&self.velocity) + norm(&self.spin) * radius
    }
}

/// What the solver knows of a unit besides.
#[derive(Clone, Copy)]
pub(super) struct Marks {
    /// Contacts that it is from what does not move; [`FAR`]: it touches nothing that is held.
    pub(super) level: f32,
    pub(super) touched: Touched,
    /// At the start of the step, m/s.
    pub(super) speed: f32,
}

/// Whether something has pushed a unit.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(super) enum Touched {
    Never,
    /// In a substep of this step before the one under way.
    Before,
    /// In the substep under way.
    Now,
}

impl Marks {
    fn read(row: &[f32; MARKS]) -> Self {
        let [level, touched, speed] = *row;
        let touched = match touched {
            2.0 => Touched::Now,
            1.0 => Touched::Before,
            _ => Touched::Never,
        };
        Marks { level, touched, speed }
    }

    fn write(&self, row: &mut [f32; MARKS]) {
        let touched = match self.touched {
            Touched::Never => 0.0,
            Touched::Before => 1.0,
            Touched::Now => 2.0,
        };
        *row = [self.level, touched, self.speed];
    }
}

/// A cluster as it lies.
pub(super) struct Cluster {
    mass: f32,
    /// Of mass.
    pub(super) centre: Vector3<f32>,
    /// About that, metres.
    pub(super) radius: f32,
}

/// The units of a copy. Rows that are not there read as units that nothing moves. What moves a cluster, and what is known of
/// it besides its units' poses, is in the row of its first unit. The other units' rows have where those two are in place of a motion:
/// from the cluster's centre to their own, and from it to that of the first unit.
pub(super) struct Bodies<'r> {
    #[cfg(feature = "deform")]
    units: &'r [UnitSlot],
    /// The mover, then the way and the turn since the step began.
    motions: &'r mut [[f32; PRIOR]],
    poses: &'r mut [[f32; POSE]],
    marks: &'r mut [[f32; MARKS]],
    shifts: &'r mut [[f32; SHIFT]],
    /// Centre and radius, and half the sides of a box about that centre.
    #[cfg(rigidformer_host)]
    balls: &'r mut [[f32; BALL]],
    /// Centre and radius for the step, what becomes of the unit, its contacts in a substep and the most there were.
    #[cfg(rigidformer_host)]
    ranges: &'r mut [[f32; RANGE]],
}

impl<'r> Bodies<'r> {
    /// In a slab of [`BODY`] numbers a unit, and one of [`PRIOR`].
    pub(super) fn new(slab: &'r mut [f32], prior: &'r mut [f32], units: &'r [UnitSlot]) -> Self {
        let (mut rest, mut prior, count) = (slab, prior, units.len());
        Bodies {
            #[cfg(feature = "deform")]
            units,
            motions: rows(&mut prior, count),
            poses: rows(&mut rest, count),
            marks: rows(&mut rest, count),
            shifts: rows(&mut rest, count),
            #[cfg(rigidformer_host)]
            balls: &mut [],
            #[cfg(rigidformer_host)]
            ranges: &mut [],
        }
    }

    /// With balls and ranges, where there is room for them.
    #[cfg(rigidformer_host)]
    pub(super) fn with_ranges(self, extra: &mut &'r mut [f32]) -> Self {
        let count = self.poses.len();
        let (balls, ranges) = (rows(extra, count), rows(extra, count));
        Bodies { balls, ranges, ..self }
    }

    /// Velocity and spin of every unit first in its row.
    #[cfg(rigidformer_host)]
    pub(super) fn motions(&mut self) -> &mut [[f32; PRIOR]] {
        self.motions
    }

    #[inline]
    fn mover_row(&self, number: usize) -> Option<&[f32; MOVER]> {
        self.motions.get(number)?.first_chunk()
    }

    #[inline]
    fn mover_row_mut(&mut self, number: usize) -> Option<&mut [f32; MOVER]> {
        self.motions.get_mut(number)?.first_chunk_mut()
    }

    #[inline]
    fn moved_row_mut(&mut self, number: usize) -> Option<&mut [f32; SHIFT]> {
        const { assert!(MOVER + SHIFT <= PRIOR, "a row of the result has room for the motion") };
        self.motions.get_mut(number)?.split_at_mut(MOVER).1.first_chunk_mut()
    }

    /// The unit whose row has a unit's motion.
    #[cfg(feature = "deform")]
    #[inline]
    pub(super) fn root_of(&self, unit: usize) -> usize {
        self.units.get(unit).and_then(UnitSlot::cluster_root).unwrap_or(unit)
    }

    /// As [`root_of`](Self::root_of).
    #[cfg(not(feature = "deform"))]
    #[inline(always)]
    pub(super) fn root_of(&self, unit: usize) -> usize {
        unit
    }

    /// From the centre of a unit's cluster to its own; none of a unit alone.
    #[cfg(feature = "deform")]
    #[inline]
    pub(super) fn arm(&self, unit: usize) -> Option<Vector3<f32>> {
        let slot = self.units.get(unit)?;
        let arms = if slot.cluster_root()? == unit {
            let [_, _, _, arm @ .., _, _, _, _, _, _, _] = self.mover_row(slot.next_member()?)?;
            arm
        } else {
            self.mover_row(unit)?.first_chunk()?
        };
        Some(Vector3::from(*arms))
    }

    /// As [`arm`](Self::arm).
    #[cfg(not(feature = "deform"))]
    #[inline(always)]
    pub(super) fn arm(&self, _: usize) -> Option<Vector3<f32>> {
        None
    }

    /// The cluster of a first unit, as its units lie.
    #[cfg_attr(rigidformer_dsp, inline(never))]
    pub(super) fn cluster(&self, world: &World<'_>, cluster_root: usize) -> Cluster {
        // In levers from the first unit, so that nothing is lost far from the origin.
        let origin = self.pose(cluster_root).centre;
        let (mut mass, mut sum) = (0.0, Vector3::zeros());
        for (number, unit) in world.around(cluster_root) {
            mass += unit.mass;
            sum += (self.pose(number).centre - origin) * unit.mass;
        }
        let centre = origin + sum / mass;
        let radius = world.around(cluster_root).fold(0.0_f32, |radius, (number, unit)| {
            radius.max(norm(&(self.pose(number).centre - centre)) + unit.radius)
        });
        Cluster { mass, centre, radius }
    }

    /// Radius of what a unit's row stands for, metres.
    fn radius(&self, world: &World<'_>, (number, unit): (usize, &UnitSlot)) -> f32 {
        match unit.cluster_root() {
            None => unit.radius,
            Some(cluster_root) if cluster_root == number => {
                self.cluster(world, cluster_root).radius
            }
            Some(_) => 0.0,
        }
    }

    /// Keeps where the units of a cluster are in it.
    #[cfg_attr(rigidformer_dsp, inline(never))]
    fn keep_arms(&mut self, world: &World<'_>, cluster_root: usize) -> Cluster {
        let cluster = self.cluster(world, cluster_root);
        let first = self.pose(cluster_root).centre - cluster.centre;
        for (number, _) in world.around(cluster_root).filter(|(number, _)| *number != cluster_root)
        {
            let own = self.pose(number).centre - cluster.centre;
            if let Some([a, b, c, d, e, f, ..]) = self.mover_row_mut(number) {
                [*a, *b, *c] = own.into();
                [*d, *e, *f] = first.into();
            }
        }
        cluster
    }

    #[inline]
    pub(super) fn mover(&self, unit: usize) -> Mover {
        self.find(unit).unwrap_or(Mover::STILL)
    }

    /// None: there is no such unit.
    #[inline]
    pub(super) fn find(&self, unit: usize) -> Option<Mover> {
        self.mover_row(self.root_of(unit)).map(Mover::read)
    }

    /// As [`mover`](Self::mover), at the unit's own centre.
    pub(super) fn mover_there(&self, unit: usize) -> Mover {
        let mover = self.mover(unit);
        self.arm(unit).map_or(mover, |arm| mover.at(&arm))
    }

    /// How fast a point at an arm of a unit moves, m/s.
    #[inline]
    pub(super) fn speed_at(&self, unit: usize, arm: &Vector3<f32>) -> Vector3<f32> {
        let unit = self.root_of(unit);
        let Some([a, b, c, d, e, f, ..]) = self.mover_row(unit) else { return Vector3::zeros() };
        Vector3::new(*a, *b, *c) + Vector3::new(*d, *e, *f).cross(arm)
    }

    /// Keeps velocity and spin.
    #[inline]
    pub(super) fn moves(&mut self, unit: usize, mover: &Mover) {
        let unit = self.root_of(unit);
        if let Some([a, b, c, d, e, f, ..]) = self.mover_row_mut(unit) {
            [*a, *b, *c] = mover.velocity.into();
            [*d, *e, *f] = mover.spin.into();
        }
    }

    pub(super) fn pose(&self, unit: usize) -> Pose {
        self.poses.get(unit).map_or_else(Pose::default, |row| read_pose(row))
    }

    fn set_pose(&mut self, unit: usize, pose: &Pose) {
        if let Some(row) = self.poses.get_mut(unit) {
            write_pose(pose, row);
        }
    }

    pub(super) fn marks(&self, unit: usize) -> Marks {
        let nothing = Marks { level: FAR, touched: Touched::Never, speed: 0.0 };
        self.marks.get(self.root_of(unit)).map_or(nothing, Marks::read)
    }

    fn set_marks(&mut self, unit: usize, marks: &Marks) {
        let unit = self.root_of(unit);
        if let Some(row) = self.marks.get_mut(unit) {
            marks.write(row);
        }
    }

    pub(super) fn set_level(&mut self, unit: usize, level: f32) {
        self.set_marks(unit, &Marks { level, ..self.marks(unit) });
    }

    pub(super) fn touch(&mut self, unit: usize) {
        self.set_marks(unit, &Marks { touched: Touched::Now, ..self.marks(unit) });
    }

    /// Changes what all units' touches are.
    pub(super) fn mark_all(&mut self, touched: impl Fn(Touched) -> Touched) {
        for unit in 0..self.marks.len() {
            if self.root_of(unit) != unit {
                continue;
            }
            let marks = self.marks(unit);
            self.set_marks(unit, &Marks { touched: touched(marks.touched), ..marks });
        }
    }

    /// A unit's way (m) and turn (rad) out of others.
    #[inline]
    fn shift(&self, unit: usize) -> [Vector3<f32>; 2] {
        let unit = self.root_of(unit);
        let Some([a, b, c, d, e, f]) = self.shifts.get(unit) else { return Default::default() };
        [Vector3::new(*a, *b, *c), Vector3::new(*d, *e, *f)]
    }

    /// How far that takes the point at an arm, metres.
    #[inline]
    pub(super) fn shift_at(&self, unit: usize, arm: &Vector3<f32>) -> Vector3<f32> {
        let [way, turn] = self.shift(unit);
        way + turn.cross(arm)
    }

    /// Keeps that a unit moves nearer to its velocity after the substep's impulses, by a share of 1, as rigid contact has it.
    pub(super) fn hasten(&mut self, unit: usize, share: f32) {
        let (mut before, after) = (self.shifted(unit), self.mover(unit));
        before.velocity += (after.velocity - before.velocity) * share;
        before.spin += (after.spin - before.spin) * share;
        self.shifts(unit, &before);
    }

    /// The unit as one whose velocity and spin are its way and turn out of others.
    pub(super) fn shifted(&self, unit: usize) -> Mover {
        let [velocity, spin] = self.shift(unit);
        Mover { velocity, spin, ..self.mover(unit) }
    }

    /// Keeps way and turn.
    pub(super) fn shifts(&mut self, unit: usize, mover: &Mover) {
        let Mover { velocity: v, spin: w, .. } = mover;
        let unit = self.root_of(unit);
        if let Some(row) = self.shifts.get_mut(unit) {
            *row = [v.x, v.y, v.z, w.x, w.y, w.z];
        }
    }

    /// Takes all units as they come into the step.
    #[cfg_attr(rigidformer_dsp, inline(never))]
    pub(super) fn begin(&mut self, world: &World<'_>) {
        for (number, unit) in world.units.iter().enumerate() {
            self.set_pose(number, &unit.current);
        }
        for number in 0..self.motions.len() {
            if let Some(row) = self.moved_row_mut(number) {
                row.fill(0.0);
            }
        }
        for (number, unit) in world.moved() {
            let [velocity, spin] = world.incoming_motion(unit);
            // An impulse adds 0 to what nothing moves, which would make a 0 of -0.
            let [velocity, spin] = [velocity, spin].map(|motion| motion + Vector3::zeros());
            let mover = Mover { velocity, spin, ..Mover::STILL };
            let speed = mover.speed(self.radius(world, (number, unit)));
            self.moves(number, &mover);
            self.set_marks(number, &Marks { level: FAR, touched: Touched::Never, speed });
        }
    }

    /// Takes back what gravity has added for more than a substep that is cut.
    #[cfg_attr(rigidformer_dsp, inline(never))]
    pub(super) fn shorten(&mut self, world: &World<'_>, by_s: f32) {
        let more = world.scene.gravity * by_s;
        for (number, unit) in world.moved() {
            if unit.is_free() && !self.is_left_out(number) {
                let mut mover = self.mover(number);
                mover.velocity -= more;
                self.moves(number, &mover);
            }
        }
    }

    /// Begins a substep: inertia as the units now lie, and gravity.
    #[cfg_attr(rigidformer_dsp, inline(never))]
    pub(super) fn begin_substep(&mut self, world: &World<'_>) {
        for (number, unit) in world.moved() {
            if self.is_left_out(number) {
                continue;
            }
            let mut mover = self.mover(number);
            let mut marks = self.marks(number);
            self.shifts(number, &mover);
            mover.lightness = unit.lightness();
            if unit.cluster_root().is_some() {
                let cluster = self.keep_arms(world, number);
                mover.lightness = 1.0 / cluster.mass;
                mover.inverse = self.inverse_inertia(world, (number, &cluster));
                mover.velocity += world.gravity_velocity_change();
            } else if unit.is_free() {
                mover.inverse = inverse_inertia(unit, &self.pose(number).rotation);
                mover.velocity += world.gravity_velocity_change();
            } else {
                mover.inverse = [0.0; 6];
            }
            if let Some(row) = self.mover_row_mut(number) {
                mover.write(row);
            }
            if marks.touched == Touched::Now {
                marks.touched = Touched::Before;
            }
            marks.level = if unit.is_free() { FAR } else { 0.0 };
            self.set_marks(number, &marks);
        }
    }

    /// Finds the balls that units stay in for the substep that has begun, but for what pushes them apart; units come no closer than `face`,
    /// in radii.
    #[cfg(rigidformer_host)]
    pub(super) fn enclose(&mut self, world: &World<'_>, face: f32) {
        for (number, unit) in world.units.iter().enumerate() {
            if self.is_left_out(number) {
                continue;
            }
            let (mover, Pose { centre, rotation }) = (self.mover_there(number), self.pose(number));
            let reach = unit.radius * (1.0 + face) + mover.speed(unit.radius) * world.substep_s;
            let sides = world.half_sides(unit, &rotation) + Vector3::repeat(reach - unit.radius);
            let [a, b, c] = (sides * (1.0 + BALL_SLACK)).into();
            if let Some(ball) = self.balls.get_mut(number) {
                *ball = [centre.x, centre.y, centre.z, reach * (1.0 + BALL_SLACK), a, b, c];
            }
        }
    }

    /// Finds the units that the substeps have not to look at: what can touch nothing flies as it does without contact, and
    /// what the last step left as it was stays so, where nothing else can come near. Contacts of the latter; none where all units are
    /// looked at, as with `may_rest` false.
    #[cfg(rigidformer_host)]
    pub(super) fn range(&mut self, world: &World<'_>, face: f32, may_rest: bool) -> Option<usize> {
        let dt = world.scene.dt;
        let all_alone = world.units.iter().all(UnitSlot::is_alone);
        // Members of clusters have arms from here on.
        for (cluster_root, _) in world.moved().filter(|(_, unit)| unit.cluster_root().is_some()) {
            self.keep_arms(world, cluster_root);
        }
        for (number, unit) in world.units.iter().enumerate() {
            let (mover, Pose { centre, .. }) = (self.mover_there(number), self.pose(number));
            let speed = mover.speed(unit.radius) + world.gravity_size * dt;
            let reach = (unit.radius * (1.0 + face) + speed * dt) * (1.0 + 2.0 * BALL_SLACK);
            // Each substep rounds its place.
            let reach = reach + f32::EPSILON * 32.0 * centre.amax();
            let reach = if may_rest { reach } else { f32::INFINITY };
            // False where the numbers are none.
            let is_high = world.is_high(&centre, reach);
            let state = match unit.role {
                Role::Fixed => FIXED,
                Role::Free if may_rest && all_alone && unit.is_still_in(world.substeps) => STAYS,
                Role::Free if may_rest && unit.is_alone() && is_high => FLIES,
                _ => AWAKE,
            };
            if let Some(range) = self.ranges.get_mut(number) {
                *range = [centre.x, centre.y, centre.z, reach, state, 0.0, 0.0];
            }
        }
        if may_rest {
            spread(self.ranges);
        }
        let still = world.units.iter().zip(self.ranges.iter()).filter(|(_, range)| is_still(range));
        let contacts = still.map(|(unit, _)| usize::from(unit.still).saturating_sub(1)).sum();
        (0..world.units.len()).any(|unit| self.is_left_out(unit)).then_some(contacts)
    }

    /// Says that a unit may have been anywhere in the step.
    #[cfg(rigidformer_host)]
    pub(super) fn unbound_ranges(&mut self) {
        self.ranges.iter_mut().for_each(|[_, _, _, reach, ..]| *reach = f32::INFINITY);
    }

    /// Counts the contacts of a substep, each with the second of its units.
    #[cfg(rigidformer_host)]
    pub(super) fn count(&mut self, contacts: impl Iterator<Item = usize>) {
        for [.., now, _] in self.ranges.iter_mut() {
            *now = 0.0;
        }
        for unit in contacts {
            if let Some([.., now, most]) = self.ranges.get_mut(unit) {
                *now += 1.0;
                *most = most.max(*now);
            }
        }
    }

    /// Keeps how many substeps the step has had, for [`mark_still`].
    #[cfg(rigidformer_host)]
    pub(super) fn end(&mut self, substeps: u8) {
        for [.., now, _] in self.ranges.iter_mut() {
            *now = substeps.into();
        }
    }

    /// Whether a unit stays as it is in the step.
    #[cfg(rigidformer_host)]
    pub(super) fn is_still(&self, unit: usize) -> bool {
        self.ranges.get(unit).is_some_and(is_still)
    }

    /// Whether units are left out because they stay as they are.
    #[cfg(rigidformer_host)]
    pub(super) fn leaves_still(&self) -> bool {
        self.ranges.iter().any(is_still)
    }

    /// Whether two units may come so close in the substep that they touch.
    #[cfg(rigidformer_host)]
    #[inline]
    pub(super) fn may_meet(&self, unit: usize, other: usize) -> bool {
        let (Some(own), Some(ball)) = (self.balls.get(unit), self.balls.get(other)) else {
            return true;
        };
        let ([x, y, z, reach, own_sides @ ..], [a, b, c, far, sides @ ..]) = (*own, *ball);
        let ([x, y, z], sum) = ([a - x, b - y, c - z], reach + far);
        // Also where the numbers are none.
        let apart = (x * x + y * y) + z * z > sum * sum;
        let sides = own_sides.into_iter().zip(sides).map(|(own, other)| own + other);
        let beside = || [x, y, z].into_iter().zip(sides).any(|(way, sides)| way.abs() > sides);
        !apart && !beside() && !self.is_left_out(other)
    }

    /// Whether no substep of the step has to look at a unit.
    #[cfg(rigidformer_host)]
    #[inline]
    pub(super) fn is_left_out(&self, unit: usize) -> bool {
        self.ranges.get(unit).is_some_and(|[.., state, _, _]| [FLIES, STAYS].contains(state))
    }

    /// Microcontrollers look at all.
    #[cfg(not(rigidformer_host))]
    #[inline(always)]
    pub(super) fn is_left_out(&self, _: usize) -> bool {
        false
    }

    /// Whether all units that are looked at are in their ranges for the substep that has begun.
    #[cfg(rigidformer_host)]
    pub(super) fn are_in_range(&self) -> bool {
        self.balls.iter().zip(self.ranges.iter()).all(|(ball, range)| {
            let ([a, b, c, reach, ..], [x, y, z, far, state, ..]) = (ball, range);
            let ([x, y, z], room) = ([a - x, b - y, c - z], far - reach);
            *state != AWAKE || (room >= 0.0 && (x * x + y * y) + z * z <= room * room)
        })
    }

    /// What lay still between the two frames and is held has not begun to fall in the middle of it either: takes that from
    /// its velocity.
    #[cfg_attr(rigidformer_dsp, inline(never))]
    pub(super) fn hold(&mut self, world: &World<'_>) {
        let (gravity, dt) = (&world.scene.gravity, world.scene.dt);
        // What swings on springs is as slow at times.
        let held = if world.gives_way() { HELD * SLIGHT } else { HELD };
        for (number, unit) in world.moved() {
            if self.is_left_out(number) {
                continue;
            }
            let [velocity, spin] = world.incoming_motion(unit);
            let velocity = velocity - gravity * (0.5 * dt);
            let radius = self.radius(world, (number, unit));
            let slow = Mover { velocity, spin, ..Mover::STILL }.speed(radius)
                < held * world.gravity_size * dt;
            let marks = self.marks(number);
            if marks.level >= FAR {
                // At the top of a bounce it is slow, and does not rest.
                self.set_marks(number, &Marks { speed: f32::INFINITY, ..marks });
            }
            if unit.is_free() && marks.level < FAR && slow {
                let mut mover = self.mover(number);
                mover.velocity -= gravity * (0.5 * dt);
                self.moves(number, &mover);
                let mut before = self.shifted(number);
                before.velocity -= gravity * (0.5 * dt);
                self.shifts(number, &before);
            }
        }
    }

    /// Forgets how units moved before the substep.
    pub(super) fn forget(&mut self) {
        self.shifts.as_flattened_mut().fill(0.0);
    }

    /// Moves all units by their velocities over a substep, but for those that hang together.
    #[cfg_attr(rigidformer_dsp, inline(never))]
    pub(super) fn advance(&mut self, world: &World<'_>, hangs: impl Fn(usize) -> bool) {
        let time = world.substep_s;
        for (number, unit) in world.units.iter().enumerate() {
            if self.is_left_out(number) || hangs(number) {
                continue;
            }
            let mover = self.mover(number);
            let (mut way, mut turn) = (mover.velocity * time, mover.spin * time);
            if world.gives_way() {
                let [velocity, spin] = self.shift(number);
                let half = 0.5 * time;
                (way, turn) = ((mover.velocity + velocity) * half, (mover.spin + spin) * half);
                // A step may be as long as a swing, which is slow at both ends of it.
                let (marks, speed) = (self.marks(number), mover.speed(unit.radius));
                if unit.is_free() && speed > marks.speed {
                    self.set_marks(number, &Marks { speed, ..marks });
                }
            } else if unit.is_free() && self.marks(number).touched != Touched::Now {
                // A parabola, exactly.
                way -= world.gravity_velocity_change() * (0.5 * time);
            }
            if let Some(arm) = self.arm(number) {
                way += swing(&turn, &arm);
            }
            self.advance_by(number, unit, [way, turn]);
        }
        if world.gives_way() {
            // They have been the velocities before.
            self.forget();
        }
    }

    /// Moves all units by what pushes them out of others.
    #[cfg_attr(rigidformer_dsp, inline(never))]
    pub(super) fn shift_all(&mut self, world: &World<'_>) {
        for (cluster_root, _) in world.moved().filter(|(_, unit)| unit.cluster_root().is_some()) {
            // They have moved since.
            self.keep_arms(world, cluster_root);
        }
        for (number, unit) in world.units.iter().enumerate() {
            if self.is_left_out(number) {
                continue;
            }
            let [mut way, turn] = self.shift(number);
            if way.amax() > 0.0 || turn.amax() > 0.0 {
                if let Some(arm) = self.arm(number) {
                    way += swing(&turn, &arm);
                }
                self.advance_by(number, unit, [way, turn]);
            }
        }
    }

    /// Moves and turns a unit.
    #[cfg_attr(rigidformer_dsp, inline(never))]
    pub(super) fn advance_by(
        &mut self,
        number: usize,
        unit: &UnitSlot,
        [way, turn]: [Vector3<f32>; 2],
    ) {
        let Some(row) = self.moved_row_mut(number) else { return };
        let more = [way.x, way.y, way.z, turn.x, turn.y, turn.z];
        row.iter_mut().zip(more).for_each(|(sum, more)| *sum += more);
        let [x, y, z, ..] = *row;
        // From where it began, so that rounding does not add up.
        let way = Vector3::new(x, y, z) + unit.course.centre_low;
        let rotation = turned(&self.pose(number).rotation, &turn);
        self.set_pose(number, &Pose { rotation, centre: unit.current.centre + way });
    }

    /// A unit's rotation, and its way and turn since the step began.
    #[cfg(feature = "robot")]
    pub(super) fn start(&self, number: usize) -> (Matrix3<f32>, [f32; 6]) {
        let [v, w] = self.moved(number);
        (self.pose(number).rotation, [v.x, v.y, v.z, w.x, w.y, w.z])
    }

    /// Puts a unit where a way and a turn since the step began take it.
    #[cfg(feature = "robot")]
    pub(super) fn put(
        &mut self,
        number: usize,
        unit: &UnitSlot,
        (rotation, moved): (&Matrix3<f32>, &[f32; 6]),
    ) {
        if let Some(row) = self.moved_row_mut(number) {
            *row = *moved;
        }
        let [x, y, z, ..] = *moved;
        let way = Vector3::new(x, y, z) + unit.course.centre_low;
        self.set_pose(number, &Pose { rotation: *rotation, centre: unit.current.centre + way });
    }

    /// Takes out of a unit's rotation what rounding has added.
    #[cfg(feature = "robot")]
    pub(super) fn square(&mut self, number: usize) {
        let pose = self.pose(number);
        self.set_pose(number, &Pose { rotation: squared(&pose.rotation), ..pose });
    }

    /// From the centre of one unit to that of another: differences of near numbers, so that nothing is lost far from the origin.
    #[cfg(feature = "robot")]
    pub(super) fn apart(&self, world: &World<'_>, from: usize, to: usize) -> Vector3<f32> {
        let [Some(here), Some(there)] = [from, to].map(|unit| world.units.get(unit)) else {
            return Vector3::zeros();
        };
        let [[mine, _], [theirs, _]] = [from, to].map(|unit| self.moved(unit));
        let low = (there.course.centre_low + theirs) - (here.course.centre_low + mine);
        (there.current.centre - here.current.centre) + low
    }

    /// The way and the turn of a unit since the step began.
    pub(super) fn moved(&self, number: usize) -> [Vector3<f32>; 2] {
        let row = self.motions.get(number).map(|row| row.split_at(MOVER).1);
        let Some([a, b, c, d, e, f, ..]) = row else { return Default::default() };
        [Vector3::new(*a, *b, *c), Vector3::new(*d, *e, *f)]
    }

    /// Ends the step: writes the row of a unit's result. Its motion is gone then.
    pub(super) fn tell(&mut self, number: usize, next: &State, share: f32) {
        let Some(row) = self.motions.get_mut(number) else { return };
        let (state, rest) = row.split_at_mut(STATE);
        next.write(state);
        rest.fill(share);
    }

    /// Of a cluster, in the world's axes: as [`inverse_inertia`], of the units' inertia with that of their masses at their arms.
    #[cfg_attr(rigidformer_dsp, inline(never))]
    fn inverse_inertia(
        &self,
        world: &World<'_>,
        (cluster_root, cluster): (usize, &Cluster),
    ) -> [f32; 6] {
        // A row of units is a thousand times easier to turn about itself than across: digits for that are cheap here.
        let mut sum = Matrix3::<f64>::zeros();
        for (number, unit) in world.around(cluster_root) {
            let Pose { rotation, centre } = self.pose(number);
            let (turn, arm) = (rotation.cast::<f64>(), (centre - cluster.centre).cast::<f64>());
            let own = Matrix3::from_diagonal(&unit.inertia_m2.cast::<f64>());
            let far = Matrix3::from_diagonal_element(arm.norm_squared()) - arm * arm.transpose();
            sum += (turn * own * turn.transpose() + far) * f64::from(unit.mass);
        }
        let [x, y, z]: [Vector3<f64>; 3] = sum.data.0.map(Into::into);
        let (u, v, w) = (y.cross(&z), z.cross(&x), x.cross(&y));
        let volume = x.dot(&u);
        let inverse = |number: f64| (number / volume) as f32;
        [u.x, v.y, w.z, v.x, w.x, w.y].map(inverse)
    }
}

/// Whether a unit stays as it is in the step.
#[cfg(rigidformer_host)]
fn is_still([.., state, _, _]: &[f32; RANGE]) -> bool {
    *state == STAYS
}

/// Wakes what can touch what is awake, and what flies where anything is: a few times, then all that is still.
#[cfg(rigidformer_host)]
fn spread(ranges: &mut [[f32; RANGE]]) {
    for _ in 0..WAKES {
        let mut changes = false;
        let mut rest = &mut *ranges;
        while let Some((range, others)) = core::mem::take(&mut rest).split_first_mut() {
            let [x, y, z, reach, state, ..] = range;
            for [a, b, c, far, other, ..] in others.iter_mut() {
                let is_settled = *state == *other && *state != FLIES
                    || state.max(*other) == FIXED && *state != FLIES && *other != FLIES;
                let ([x, y, z], sum) = ([*a - *x, *b - *y, *c - *z], *reach + *far);
                // Also where the numbers are none.
                let apart = (x * x + y * y) + z * z > sum * sum;
                if is_settled || apart {
                    continue;
                }
                for state in [&mut *state, other] {
                    *state = if *state == FIXED { FIXED } else { AWAKE };
                }
                changes = true;
            }
            rest = others;
        }
        if !changes {
            return;
        }
    }
    for [.., state, _, _] in ranges {
        *state = if *state == FIXED { FIXED } else { AWAKE };
    }
}

/// Says of each unit whether it stays as it is until something changes, after a step that has left so those that are said to, which also
/// rest: what can touch no unit that does not. Without ranges none does.
#[cfg(rigidformer_host)]
pub(super) fn mark_still(
    units: &mut [UnitSlot],
    rests: impl Iterator<Item = bool>,
    ranges: &mut [[f32; RANGE]],
) {
    let all_alone = units.iter().all(UnitSlot::is_alone);
    let Some(ranges) = ranges.get_mut(..units.len()) else {
        return units.iter_mut().for_each(|unit| unit.still = 0);
    };
    for ((unit, rests), range) in units.iter_mut().zip(rests).zip(ranges.iter_mut()) {
        let stays = unit.still > 0 && rests && all_alone && unit.is_free();
        if !is_still(range) {
            let [.., substeps, most] = *range;
            // Fewer than there are units, times a few.
            unit.still = (most as u16).saturating_add(1);
            unit.still_substeps = substeps as u8;
        }
        let [.., state, _, _] = range;
        *state = match unit.role {
            Role::Fixed => FIXED,
            _ if stays => STAYS,
            _ => AWAKE,
        };
    }
    spread(ranges);
    for (unit, range) in units.iter_mut().zip(ranges.iter()) {
        unit.still = if is_still(range) { unit.still } else { 0 };
    }
}

/// The first rows of a slab, which then is the rest.
pub(super) fn rows<'r, const N: usize>(
    slab: &mut &'r mut [f32],
    count: usize,
) -> &'r mut [[f32; N]] {
    let rest = core::mem::take(slab);
    let (head, rest) = rest.split_at_mut((count * N).min(rest.len()));
    *slab = rest;
    head.as_chunks_mut().0
}

/// Of a free unit, in the world's axes: xx, yy, zz, xy, xz, yz.
#[cfg_attr(rigidformer_dsp, inline(never))]
fn inverse_inertia(unit: &UnitSlot, rotation: &Matrix3<f32>) -> [f32; 6] {
    let column = |axis: Vector3<f32>| {
        let own = rotate_back(rotation, &axis).component_div(&(unit.inertia_m2 * unit.mass));
        rotate(rotation, &own)
    };
    let [x, y, z] = [Vector3::x(), Vector3::y(), Vector3::z()].map(column);
    [x.x, y.y, z.z, y.x, z.x, z.y]
}
