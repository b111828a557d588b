//! Several worlds in one space, such as robots with a command and a model each, and the boxes that they push.

mod error;
mod gaps;
mod id;
mod member;
mod presence;

use std::collections::BTreeSet;

use rayon::prelude::*;
use rigidformer_core::kernels::in_own_environment;
use rigidformer_core::nalgebra::Point3;
use rigidformer_core::{Compliance, Limits, Physics, Role, StepError, StepReport, Unit, UnitId};

pub use error::GroupError;
pub use gaps::Gap;
pub use id::MemberId;
use member::Member;
use presence::Presence;

use crate::pool;
use crate::threads::Threads;
use crate::world::{Undo, World};

/// Neighbour distance of members whose models take no command, metres, beyond what both move in a step.
// Contact looks 0.03 m ahead (docs/MODEL.md, section 6); gravity adds to the way of what falls.
const USUAL_DISTANCE_M: f32 = 0.1;
/// Times of a step that differ by a smaller share are one: 1 / 3 is not 10 / 30 to the bit.
const SAME_TIME: f32 = 1e-5;

/// What a step did to a member.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct MemberReport {
    /// The member.
    pub id: MemberId,
    /// What its world reports, of its own units and its neighbours.
    pub report: StepReport,
    /// Units of other members that were so near that its world took them in.
    pub neighbours: usize,
}

/// Several worlds in one space, which step together: robots, each with its model and command, and what they push.
///
/// Each member keeps its model, command, units, planes and network, on or off ([`World::set_network`]). All have one time step. A
/// member's world takes in its **neighbours**, units of others within its neighbour distance, as driven units, in this step alone;
/// between steps it has its own units and nothing else. Nothing pushes back.
///
/// | order | members | where their neighbours go |
/// |---|---|---|
/// | first | those whose model takes a command | driven ones where they are told to; others on as in the last step, a robot's links with its heading |
/// | then | those without | those of the first order where this step takes them, without delay; others as above |
///
/// Members of one order are independent within a step, so that threads share them, and no result depends on the threads. Bodies that
/// push each other both ways belong in one world. A neighbour is the hull of its points, also where it has pieces.
/// Members with commands have no neighbours unless [`set_neighbour_distance`](Self::set_neighbour_distance) says so: robots' models are
/// trained alone, and walk worse beside others (docs/ROBOTS.md). They do not avoid each other, and walk through each other where their
/// commands cross. [`gaps`](Self::gaps) says who touches whom.
///
/// ```
/// use nalgebra::{Isometry3, Point3};
/// use rigidformer_runtime::core::{Limits, Physics, Role, Unit};
/// use rigidformer_runtime::group::Group;
/// use rigidformer_runtime::models::LoadedModel;
/// use rigidformer_runtime::world::World;
///
/// let model = LoadedModel::embedded("edge", rigidformer_weights::EDGE)?;
/// let corner = |i: usize, bit| if i & bit == 0 { -0.1 } else { 0.1 };
/// let corners: Vec<_> = (0..8).map(|i| Point3::new(corner(i, 1), corner(i, 2), corner(i, 4))).collect();
/// let wood = Physics { mass_kg: 1.0, friction: 0.5, restitution: 0.1 };
/// let world = |role, x| -> Result<_, Box<dyn std::error::Error>> {
///     let mut world = World::new(&model, Limits { units: 4, points: 64 })?;
///     world.set_dt(1.0 / 24.0)?;
///     let id = world.add(&Unit::new(&corners, wood).role(role), &Isometry3::translation(x, 0.0, 0.1))?;
///     Ok((world, id))
/// };
/// let ((hand, pusher), (table, cube)) = (world(Role::Driven, -0.3)?, world(Role::Free, 0.0)?);
///
/// let mut group = Group::new();
/// let hand = group.add("hand", hand)?;
/// let table = group.add("table", table)?;
/// for step in 1..=12 {
///     let target = Isometry3::translation(-0.3 + 0.02 * step as f32, 0.0, 0.1);
///     group.world_mut(hand).ok_or("no hand")?.drive(pusher, &target)?;
///     group.step()?;
/// }
/// let pushed = group.world(table).and_then(|world| world.pose(cube)).ok_or("no cube")?;
/// assert!(pushed.translation.x > 0.1, "{pushed}");
/// let gap = group.gaps(0.1)?[0];
/// assert!(gap.units == [pusher, cube] && gap.gap_m.abs() < 0.05, "{gap:?}");
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub struct Group {
    threads: Threads,
    members: Vec<Member>,
    next: u64,
}

/// A unit of another member, as a world takes it in for a step.
struct Neighbour {
    presence: Presence,
    /// Number of its member.
    of: usize,
    body: Option<u16>,
    unit: OwnUnit,
}

/// What a unit is, in memory of its own.
struct OwnUnit {
    points: Vec<Point3<f32>>,
    physics: Physics,
    compliance: Compliance,
}

/// A member's part in a step.
struct Job<'g> {
    member: &'g mut Member,
    neighbours: Vec<&'g Neighbour>,
    names: &'g [String],
    outcome: Option<Result<MemberReport, GroupError>>,
}

impl Default for Group {
    fn default() -> Self {
        Group::new()
    }
}

impl Group {
    /// Nobody, on all threads.
    pub fn new() -> Self {
        Group::on(Threads::all())
    }

    /// Nobody, on so many threads: they share the members of a step, and what is left of them the work of each, within its own
    /// engine's threads. No result depends on it.
    pub fn on(threads: Threads) -> Self {
        Group { threads, members: Vec::new(), next: 0 }
    }

    /// Takes a world in as a member, behind the others. One whose model takes a command has no neighbours, nor one of soft bodies; others
    /// have those that they may touch.
    ///
    /// # Errors
    /// [`GroupError`], where the name is taken or empty, or the world has no time step, another one or copies.
    pub fn add(&mut self, name: &str, world: World) -> Result<MemberId, GroupError> {
        if name.is_empty() {
            return Err(GroupError::NoName);
        }
        if self.find(name).is_some() {
            return Err(GroupError::NameTaken { name: name.to_owned() });
        }
        self.check_time(name, Member::check(name, &world)?, None)?;
        let id = MemberId::new(self.next);
        let mut member =
            Member { id, name: name.to_owned(), world, distance_m: None, undo: Undo::default() };
        if !member.is_commanded() && !is_soft(&member.world) {
            member.distance_m = Some(USUAL_DISTANCE_M);
        }
        self.members.push(member);
        self.next += 1;
        Ok(id)
    }

    /// Takes a member out of the group; the others go on as if it had never been there.
    ///
    /// # Errors
    /// [`GroupError::NoSuchMember`].
    pub fn remove(&mut self, id: MemberId) -> Result<World, GroupError> {
        let number = self.number(id)?;
        Ok(self.members.remove(number).world)
    }

    /// Members.
    pub fn len(&self) -> usize {
        self.members.len()
    }

    /// Whether there is no member.
    pub fn is_empty(&self) -> bool {
        self.members.is_empty()
    }

    /// All members, in the order in which they came.
    pub fn ids(&self) -> impl Iterator<Item = MemberId> {
        self.members.iter().map(|member| member.id)
    }

    /// The member of a name.
    pub fn find(&self, name: &str) -> Option<MemberId> {
        self.members.iter().find(|member| member.name == name).map(|member| member.id)
    }

    /// What a member is called.
    pub fn name(&self, id: MemberId) -> Option<&str> {
        self.member(id).map(|member| member.name.as_str())
    }

    /// A member's world, with its own units alone.
    pub fn world(&self, id: MemberId) -> Option<&World> {
        self.member(id).map(|member| &member.world)
    }

    /// A member's world, to change it between steps. Stepping it lets it go ahead of the others.
    pub fn world_mut(&mut self, id: MemberId) -> Option<&mut World> {
        let member = self.members.iter_mut().find(|member| member.id == id);
        member.map(|member| &mut member.world)
    }

    /// Gives a member another world, whole; the one that it had.
    ///
    /// # Errors
    /// As [`add`](Self::add), or [`GroupError::NoSuchMember`]; the member keeps its world.
    pub fn set_world(&mut self, id: MemberId, world: World) -> Result<World, GroupError> {
        let number = self.number(id)?;
        let name = &self.members[number].name;
        self.check_time(name, Member::check(name, &world)?, Some(id))?;
        let member = &mut self.members[number];
        // Scenes of soft units take no others.
        member.distance_m = member.distance_m.filter(|_| !is_soft(&world));
        Ok(std::mem::replace(&mut member.world, world))
    }

    /// Seconds of a step; none before there is a member.
    pub fn dt_s(&self) -> Option<f32> {
        self.members.first()?.world.simulator().dt_s()
    }

    /// Gives a member the command of all following steps.
    ///
    /// ```
    /// use nalgebra::{Isometry3, Point3};
    /// use rigidformer_runtime::core::{Limits, Physics, Posed, Unit};
    /// use rigidformer_runtime::group::{Group, GroupError};
    /// use rigidformer_runtime::models::LoadedModel;
    /// use rigidformer_runtime::world::World;
    /// # let corner = |i: usize, bit| if i & bit == 0 { -0.1 } else { 0.1 };
    /// # let points: Vec<_> = (0..8).map(|i| Point3::new(corner(i, 1), corner(i, 2), corner(i, 4))).collect();
    /// # let plastic = Physics { mass_kg: 30.0, friction: 0.5, restitution: 0.1 };
    /// let model = LoadedModel::embedded("g1", rigidformer_weights::G1)?;
    /// let mut group = Group::new();
    /// for (name, x) in [("one", 0.0), ("other", 3.0)] {
    ///     let mut world = World::new(&model, Limits { units: 31, points: 992 })?;
    ///     let at = |x| Isometry3::translation(x, 0.0, 0.8);
    ///     // All links of a robot: here one alone.
    ///     let links = [Posed { unit: Unit::new(&points, plastic), previous: at(x), current: at(x + 0.1) }];
    ///     world.edit(|simulator| simulator.observe_poses(1.0 / 3.0, &links))?;
    ///     let id = group.add(name, world)?;
    ///     group.set_command(id, &[0.5, 0.0, 0.3])?; // m/s forwards and to the left, rad/s
    /// }
    /// let one = group.find("one").ok_or("none")?;
    /// assert!(matches!(group.set_command(one, &[0.5, f32::NAN, 0.0]), Err(GroupError::Command { .. })));
    /// group.step()?;
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    ///
    /// # Errors
    /// [`GroupError::NoSuchMember`], or [`GroupError::Command`] where the model takes no such command; the command is what it was.
    pub fn set_command(&mut self, id: MemberId, command: &[f32]) -> Result<(), GroupError> {
        let number = self.number(id)?;
        let Member { name, world, .. } = &mut self.members[number];
        let set = world.edit(|simulator| simulator.set_command(command));
        set.map_err(|source| GroupError::Command { name: name.clone(), source })
    }

    /// Within which distance units of others are a member's neighbours, metres; none where it has no neighbours.
    ///
    /// # Errors
    /// [`GroupError::NoSuchMember`].
    pub fn neighbour_distance(&self, id: MemberId) -> Result<Option<f32>, GroupError> {
        Ok(self.members[self.number(id)?].distance_m)
    }

    /// Says which units of others are a member's neighbours, from the next step on: those whose bounding balls come so near its own units'
    /// in the step, metres; with none it goes as it would alone. Its world needs room for them ([`Limits`]), and each costs more than
    /// one of its own.
    ///
    /// # Errors
    /// [`GroupError::NoSuchMember`], [`GroupError::Distance`] or [`GroupError::Soft`]; the distance is what it was.
    pub fn set_neighbour_distance(
        &mut self,
        id: MemberId,
        distance_m: Option<f32>,
    ) -> Result<(), GroupError> {
        let number = self.number(id)?;
        let member = &mut self.members[number];
        if let Some(distance_m) = distance_m {
            check_distance(distance_m)?;
            if is_soft(&member.world) {
                return Err(GroupError::Soft { name: member.name.clone() });
            }
        }
        member.distance_m = distance_m;
        Ok(())
    }

    /// Another group in the same state, to look ahead in: worlds with memory of their own, and the same ids.
    ///
    /// ```
    /// # use nalgebra::{Isometry3, Point3};
    /// # use rigidformer_runtime::core::{Limits, Physics, Role, Unit};
    /// # use rigidformer_runtime::models::LoadedModel;
    /// # use rigidformer_runtime::world::World;
    /// use rigidformer_runtime::group::Group;
    /// # let model = LoadedModel::embedded("edge", rigidformer_weights::EDGE)?;
    /// # let corner = |i: usize, bit| if i & bit == 0 { -0.1 } else { 0.1 };
    /// # let corners: Vec<_> = (0..8).map(|i| Point3::new(corner(i, 1), corner(i, 2), corner(i, 4))).collect();
    /// # let wood = Physics { mass_kg: 1.0, friction: 0.5, restitution: 0.1 };
    /// # let world = |x| -> Result<_, Box<dyn std::error::Error>> {
    /// #     let mut world = World::new(&model, Limits { units: 4, points: 64 })?;
    /// #     world.set_dt(0.1)?;
    /// #     let id = world.add(&Unit::new(&corners, wood).role(Role::Driven), &Isometry3::translation(x, 0.0, 0.5))?;
    /// #     Ok((world, id))
    /// # };
    /// # let ((left, hand), (right, _)) = (world(0.0)?, world(1.0)?);
    /// let mut group = Group::new();
    /// let (left, right) = (group.add("left", left)?, group.add("right", right)?);
    /// group.set_neighbour_distance(left, Some(0.5))?;
    /// let mut ahead = group.try_clone()?;
    /// ahead.world_mut(left).ok_or("none")?.drive(hand, &Isometry3::translation(0.9, 0.0, 0.5))?;
    /// ahead.step()?;
    /// if ahead.gaps_in_step(0.05)?.is_empty() {
    ///     group.world_mut(left).ok_or("none")?.drive(hand, &Isometry3::translation(0.9, 0.0, 0.5))?;
    /// }
    /// assert_eq!(group.step()?[0].neighbours, 0); // it has stayed
    /// assert_eq!((group.name(right), group.find("left")), (Some("right"), Some(left)));
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    ///
    /// # Errors
    /// [`GroupError::World`] where there is no memory for it.
    pub fn try_clone(&self) -> Result<Self, GroupError> {
        let copy = |member: &Member| {
            let failed = |source| GroupError::World { name: member.name.clone(), source };
            let world = member.world.try_clone().map_err(failed)?;
            let (id, name, distance_m) = (member.id, member.name.clone(), member.distance_m);
            Ok(Member { id, name, world, distance_m, undo: Undo::default() })
        };
        let members = self.members.iter().map(copy).collect::<Result<_, _>>()?;
        Ok(Group { threads: self.threads, members, next: self.next })
    }

    /// Advances all members by one step, and reports of each in their order.
    ///
    /// # Errors
    /// [`GroupError`], of the first member that cannot step: all members are what they were.
    pub fn step(&mut self) -> Result<Vec<MemberReport>, GroupError> {
        in_own_environment(|| self.step_here())
    }

    fn step_here(&mut self) -> Result<Vec<MemberReport>, GroupError> {
        // Worlds may have been changed since they came.
        for member in &self.members {
            let dt_s = Member::check(&member.name, &member.world)?;
            self.check_time(&member.name, dt_s, Some(member.id))?;
        }
        let looks = |member: &Member| member.distance_m.is_some();
        let is_looked_at = self.members.len() > 1 && self.members.iter().any(looks);
        let mut presences: Vec<Vec<Presence>> = match is_looked_at {
            true => self.members.iter().map(|member| presence::presences(&member.world)).collect(),
            false => vec![Vec::new(); self.members.len()],
        };
        // A world alone undoes its own step.
        let undoes = self.members.len() > 1;
        for member in self.members.iter_mut().filter(|_| undoes) {
            member.world.remember(&mut member.undo);
        }
        let mut outcomes: Vec<Option<Result<MemberReport, GroupError>>> =
            self.members.iter().map(|_| None).collect();
        for commanded in [true, false] {
            let failed = self.step_some(commanded, &presences, &mut outcomes);
            if failed {
                for (member, outcome) in self.members.iter_mut().zip(&outcomes) {
                    // Also one that failed: it may have taken others' units in.
                    if undoes && outcome.is_some() {
                        member.world.undo(&member.undo);
                    }
                }
                break;
            }
            for (member, presences) in self.members.iter().zip(&mut presences) {
                if member.is_commanded() == commanded {
                    presence::arrive(presences, &member.world);
                }
            }
        }
        outcomes.into_iter().flatten().collect()
    }

    /// Steps the members that have a command, or those that have none; whether any failed.
    fn step_some(
        &mut self,
        commanded: bool,
        presences: &[Vec<Presence>],
        outcomes: &mut [Option<Result<MemberReport, GroupError>>],
    ) -> bool {
        let balls: Vec<_> = presences.iter().map(|units| presence::around(units)).collect();
        let near: Vec<Vec<(usize, usize)>> = self
            .members
            .iter()
            .enumerate()
            .map(|(number, member)| match member.is_commanded() == commanded {
                true => near_to(number, member.distance_m, presences, &balls),
                false => Vec::new(),
            })
            .collect();
        // Each unit once, however many it is near to.
        let wanted: BTreeSet<(usize, usize)> = near.iter().flatten().copied().collect();
        let neighbours: Vec<((usize, usize), Neighbour)> = wanted
            .into_iter()
            .filter_map(|(of, unit)| {
                let found = neighbour(of, presences[of][unit], &self.members[of].world)?;
                Some(((of, unit), found))
            })
            .collect();
        let names: Vec<String> = self.members.iter().map(|member| member.name.clone()).collect();
        let find = |place: &(usize, usize)| {
            let at = neighbours.binary_search_by_key(place, |(place, _)| *place).ok()?;
            Some(&neighbours[at].1)
        };
        let mut jobs: Vec<Job<'_>> = self
            .members
            .iter_mut()
            .zip(&near)
            .filter(|(member, _)| member.is_commanded() == commanded)
            .map(|(member, near)| Job {
                member,
                neighbours: near.iter().filter_map(find).collect(),
                names: &names,
                outcome: None,
            })
            .collect();
        run(&mut jobs, self.threads);
        let done: Vec<_> = jobs.into_iter().map(|job| (job.member.id, job.outcome)).collect();
        let mut failed = false;
        for (id, outcome) in done {
            failed |= matches!(outcome, Some(Err(_)));
            let number = self.members.iter().position(|member| member.id == id);
            if let Some(slot) = number.and_then(|number| outcomes.get_mut(number)) {
                *slot = outcome;
            }
        }
        failed
    }

    /// All pairs of units of different members whose convex hulls are at most so far apart now, the nearest first; overlaps have
    /// negative gaps. Links of a robot go where its model says, whatever is there: who plans asks here, and refuses.
    ///
    /// # Errors
    /// [`GroupError::Distance`].
    pub fn gaps(&self, within_m: f32) -> Result<Vec<Gap>, GroupError> {
        check_distance(within_m)?;
        Ok(in_own_environment(|| gaps::gaps(&self.members, within_m, false)))
    }

    /// As [`gaps`](Self::gaps), the least of each pair in the last step, in which units go straight from where they were to where they
    /// are, and turn evenly. A step of 1/3 s is long enough to walk through somebody. Looks are at most 2 cm of motion apart, up to 64 of them.
    ///
    /// ```
    /// # use nalgebra::{Isometry3, Point3};
    /// # use rigidformer_runtime::core::{Limits, Physics, Role, Unit};
    /// # use rigidformer_runtime::models::LoadedModel;
    /// # use rigidformer_runtime::world::World;
    /// use rigidformer_runtime::group::Group;
    /// # let model = LoadedModel::embedded("edge", rigidformer_weights::EDGE)?;
    /// # let corner = |i: usize, bit| if i & bit == 0 { -0.1 } else { 0.1 };
    /// # let corners: Vec<_> = (0..8).map(|i| Point3::new(corner(i, 1), corner(i, 2), corner(i, 4))).collect();
    /// # let wood = Physics { mass_kg: 1.0, friction: 0.5, restitution: 0.1 };
    /// # let world = |x| -> Result<_, Box<dyn std::error::Error>> {
    /// #     let mut world = World::new(&model, Limits { units: 4, points: 64 })?;
    /// #     world.set_dt(0.1)?;
    /// #     let id = world.add(&Unit::new(&corners, wood).role(Role::Driven), &Isometry3::translation(x, 0.0, 0.5))?;
    /// #     Ok((world, id))
    /// # };
    /// # let ((left, hand), (right, _)) = (world(0.0)?, world(1.0)?);
    /// let mut group = Group::new();
    /// let left = group.add("left", left)?; // a cube of 0.2 m
    /// group.add("right", right)?; // another one, a metre ahead
    /// group.world_mut(left).ok_or("none")?.drive(hand, &Isometry3::translation(2.0, 0.0, 0.5))?;
    /// group.step()?;
    /// assert!(group.gaps(0.0)?.is_empty()); // it is beyond
    /// let through = group.gaps_in_step(0.0)?[0];
    /// assert!(through.gap_m < -0.19 && (through.share - 0.5).abs() < 0.1);
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    ///
    /// # Errors
    /// As [`gaps`](Self::gaps).
    pub fn gaps_in_step(&self, within_m: f32) -> Result<Vec<Gap>, GroupError> {
        check_distance(within_m)?;
        Ok(in_own_environment(|| gaps::gaps(&self.members, within_m, true)))
    }

    fn member(&self, id: MemberId) -> Option<&Member> {
        self.members.iter().find(|member| member.id == id)
    }

    fn number(&self, id: MemberId) -> Result<usize, GroupError> {
        let number = self.members.iter().position(|member| member.id == id);
        number.ok_or(GroupError::NoSuchMember { id })
    }

    /// Whether steps of a member take as long as those of the first other one.
    fn check_time(&self, name: &str, dt_s: f32, id: Option<MemberId>) -> Result<(), GroupError> {
        let first = self.members.iter().find(|member| Some(member.id) != id);
        let Some(group_dt_s) = first.and_then(|member| member.world.simulator().dt_s()) else {
            return Ok(());
        };
        if (dt_s - group_dt_s).abs() <= SAME_TIME * group_dt_s {
            return Ok(());
        }
        Err(GroupError::OtherTimestep { name: name.to_owned(), dt_s, group_dt_s })
    }
}

fn is_soft(world: &World) -> bool {
    world.model().model().config().motion.is_soft()
}

fn check_distance(distance_m: f32) -> Result<(), GroupError> {
    match distance_m.is_finite() && distance_m >= 0.0 {
        true => Ok(()),
        false => Err(GroupError::Distance { distance_m }),
    }
}

/// Units of others that are near a member's, by their members' numbers and their own, in that order.
fn near_to(
    number: usize,
    distance_m: Option<f32>,
    presences: &[Vec<Presence>],
    balls: &[Option<(Point3<f32>, f32)>],
) -> Vec<(usize, usize)> {
    let (Some(distance_m), Some((middle, radius))) = (distance_m, balls[number]) else {
        return Vec::new();
    };
    let mut near = Vec::new();
    for (of, units) in presences.iter().enumerate().filter(|(of, _)| *of != number) {
        let Some((place, reach)) = balls[of] else { continue };
        // Members that are far away cost no more than this.
        if (middle - place).norm() - (radius + reach) > distance_m {
            continue;
        }
        for (unit, other) in units.iter().enumerate() {
            if presences[number].iter().any(|own| own.room_m(other) <= distance_m) {
                near.push((of, unit));
            }
        }
    }
    near
}

/// A unit of a member as others take it in; none where it is gone.
fn neighbour(of: usize, presence: Presence, world: &World) -> Option<Neighbour> {
    let unit = world.simulator().get(presence.id)?;
    let pose = unit.pose();
    let points = unit.points().map(|point| pose.inverse_transform_point(&point)).collect();
    let (physics, compliance) = (unit.physics(), unit.compliance());
    let (body, unit) = (unit.body(), OwnUnit { points, physics, compliance });
    Some(Neighbour { presence, of, body, unit })
}

/// Steps all, on so many threads at most.
fn run(jobs: &mut [Job<'_>], threads: Threads) {
    let (count, sharers) = (threads.count(), jobs.len());
    let each = threads.shared_by(sharers);
    if count < 2 || sharers < 2 || !pool::is_there() {
        return jobs.iter_mut().for_each(|job| job.run(each));
    }
    // rayon would use all threads of the pool, so shares bound how many work at a time.
    let chunk = if count < Threads::all().count() { sharers.div_ceil(count) } else { 1 };
    pool::enter(|| {
        jobs.par_chunks_mut(chunk).for_each(|jobs| {
            // A thread of the pool has what its creator had set.
            in_own_environment(|| jobs.iter_mut().for_each(|job| job.run(each)));
        });
    });
}

impl Job<'_> {
    fn run(&mut self, threads: Threads) {
        self.outcome = Some(self.step(threads));
    }

    fn step(&mut self, threads: Threads) -> Result<MemberReport, GroupError> {
        let neighbours = self.neighbours.len();
        let taken_in = self.take_in()?;
        let Member { id, name, world, .. } = &mut *self.member;
        let stepped = world.step_within(threads);
        // The last first: no other unit moves in memory.
        for unit in taken_in.into_iter().rev() {
            let removed = world.remove(unit);
            debug_assert_eq!(removed, Ok(()), "it was taken in for this step");
        }
        match stepped {
            Ok(report) => Ok(MemberReport { id: *id, report, neighbours }),
            Err(source) => Err(GroupError::Step { name: name.clone(), source }),
        }
    }

    /// Adds the neighbours to the world, behind its own units.
    fn take_in(&mut self) -> Result<Vec<UnitId>, GroupError> {
        let needed = self.needed();
        let Member { name, world, .. } = &mut *self.member;
        let limits = world.simulator().limits();
        if needed.units > limits.units || needed.points > limits.points {
            return Err(GroupError::Room { name: name.clone(), needed, limits });
        }
        if world.simulator().is_empty() {
            let source = StepError::NoUnits;
            return Err(GroupError::Step { name: name.clone(), source });
        }
        let mut bodies = Bodies::of(world);
        let mut taken = Vec::with_capacity(self.neighbours.len());
        for neighbour in &self.neighbours {
            let Neighbour { presence, of, body, unit } = neighbour;
            let mut shown = Unit::new(&unit.points, unit.physics).compliance(unit.compliance);
            shown.role = if presence.role == Role::Fixed { Role::Fixed } else { Role::Driven };
            shown.body = body.and_then(|body| bodies.numbered(*of, body));
            let shown = world.edit(|simulator| {
                let id = simulator.add(&shown, &presence.before, &presence.now)?;
                if shown.role == Role::Driven {
                    simulator.drive(id, &presence.next)?;
                }
                Ok(id)
            });
            let failed = |source| GroupError::Neighbour {
                name: name.clone(),
                of: self.names[*of].clone(),
                source,
            };
            taken.push(shown.map_err(failed)?);
        }
        Ok(taken)
    }

    /// Units and points that the world has to hold.
    fn needed(&self) -> Limits {
        let simulator = self.member.world.simulator();
        let own: usize = simulator.units().map(|unit| unit.point_count()).sum();
        let theirs: usize = self.neighbours.iter().map(|other| other.unit.points.len()).sum();
        Limits { units: simulator.len() + self.neighbours.len(), points: own + theirs }
    }
}

/// Numbers of bodies in a world with neighbours.
struct Bodies {
    taken: BTreeSet<u16>,
    /// Member, its number of the body, and the number here.
    known: Vec<(usize, u16, u16)>,
}

impl Bodies {
    fn of(world: &World) -> Self {
        let taken = world.simulator().units().filter_map(|unit| unit.body()).collect();
        Bodies { taken, known: Vec::new() }
    }

    /// The number of another member's body: links of one robot are parts of one body here too, and of no body of the world's own.
    fn numbered(&mut self, of: usize, body: u16) -> Option<u16> {
        let known = self.known.iter().find(|(member, number, _)| (*member, *number) == (of, body));
        if let Some((_, _, here)) = known {
            return Some(*here);
        }
        let here = (0..=u16::MAX).rev().find(|number| !self.taken.contains(number))?;
        self.taken.insert(here);
        self.known.push((of, body, here));
        Some(here)
    }
}
