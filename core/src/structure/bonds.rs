//! Units that hold together: bonds between pairs, and the clusters that they make (docs/MODEL.md, section 7).

use crate::contact::prior;
use crate::geometry::{
    Pose, STATE, State, orthonormal, product, read_pose, rotate, turn_that_fits,
};
use crate::scene::{Scene, UnitId, UnitSlot, members};
use crate::structure::member::Member;
use nalgebra::{Matrix3, Vector3};

/// Bonds that there is room for, a unit of the limits: the workspace has a size that is known ahead.
pub(crate) const BONDS: usize = 8;
/// Numbers of a bond.
const BOND: usize = 8;
/// Numbers of a unit's share of the room for bonds.
pub(crate) const ROOM: usize = BONDS * BOND;

/// A pair of units that hold together, or did.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Bond {
    /// The units, the one that was observed or added first before the other.
    pub units: [UnitId; 2],
    /// Whether the bond holds: once it is broken it never holds again.
    pub holds: bool,
}

/// Where two units that hold together meet.
#[derive(Clone, Copy, Default, PartialEq)]
pub(crate) struct Seam {
    /// How far the pairs of points that touch are spread, m^2.
    pub(crate) spread_m2: f32,
    /// How many pairs there are.
    pub(crate) touches: f32,
    /// Their middle, from the first unit's centre and in its axes, metres.
    pub(crate) middle: [f32; 3],
}

/// A bond as it is kept: the lower number of a unit in the copy, the higher one, whether it holds, and where the two meet.
#[derive(Clone, Copy, PartialEq)]
pub(crate) struct Kept {
    pub(crate) pair: [usize; 2],
    pub(crate) holds: bool,
    /// Whether it held until the step under way, which may still fail.
    pub(crate) breaks: bool,
    pub(crate) seam: Seam,
}

impl Kept {
    fn read([a, b, holds, spread_m2, touches, middle @ ..]: &[f32; BOND]) -> Kept {
        let seam = Seam { spread_m2: *spread_m2, touches: *touches, middle: *middle };
        Kept { pair: [*a as usize, *b as usize], holds: *holds > 0.0, breaks: *holds < 0.0, seam }
    }

    fn write(&self, row: &mut [f32; BOND]) {
        // Exact for the first 16 million units of a copy.
        let [a, b] = self.pair.map(|unit| unit as f32);
        let holds = match (self.holds, self.breaks) {
            (true, _) => 1.0,
            (false, true) => -1.0,
            (false, false) => 0.0,
        };
        let Seam { spread_m2, touches, middle: [x, y, z] } = self.seam;
        *row = [a, b, holds, spread_m2, touches, x, y, z];
    }
}

/// The bonds of all copies. Which pairs there are is the same in each, which of them hold is not.
pub(crate) struct Bonds<'s> {
    rows: &'s mut [[f32; BOND]],
    /// Of a copy.
    room: usize,
    count: usize,
}

impl<'s> Bonds<'s> {
    /// None yet, in a slab with room for so many a copy.
    pub(crate) fn new(slab: &'s mut [f32], room: usize) -> Self {
        Bonds { rows: slab.as_chunks_mut().0, room, count: 0 }
    }

    /// How many a copy has room for.
    pub(crate) fn room(&self) -> usize {
        self.room.min(self.rows.len())
    }

    /// How many a copy has.
    pub(crate) fn len(&self) -> usize {
        self.count
    }

    /// Those of a copy.
    pub(crate) fn of(&self, copy: usize) -> impl Iterator<Item = Kept> {
        let rows = self.rows.get(copy * self.room..).unwrap_or_default();
        rows.iter().take(self.count).map(Kept::read)
    }

    fn of_mut(&mut self, copy: usize) -> impl Iterator<Item = &mut [f32; BOND]> {
        self.rows.get_mut(copy * self.room..).unwrap_or_default().iter_mut().take(self.count)
    }

    /// Forgets all.
    pub(crate) fn clear(&mut self) {
        self.count = 0;
    }

    /// Adds a pair that holds to so many copies, with where it meets in each; none where there is no room.
    pub(crate) fn add(&mut self, pair: [usize; 2], copies: usize, seam: impl Fn(usize) -> Seam) {
        // The caller has checked the room.
        if self.count >= self.room() {
            return;
        }
        for copy in 0..copies {
            if let Some(row) = self.rows.get_mut(copy * self.room + self.count) {
                Kept { pair, holds: true, breaks: false, seam: seam(copy) }.write(row);
            }
        }
        self.count += 1;
    }

    /// Says what a bond of a copy is, by its number.
    pub(crate) fn set(&mut self, copy: usize, number: usize, bond: &Kept) {
        if let Some(row) = self.of_mut(copy).nth(number) {
            bond.write(row);
        }
    }

    /// Lets a bond of a copy, which holds, break in the step under way.
    pub(crate) fn strain(&mut self, copy: usize, number: usize) {
        if let Some(row) = self.of_mut(copy).nth(number) {
            Kept { holds: false, breaks: true, ..Kept::read(row) }.write(row);
        }
    }

    /// Ends the step under way for a copy: what breaks in it is broken, or holds on where the step failed. How many there were.
    pub(crate) fn confirm(&mut self, copy: usize, has_failed: bool) -> u32 {
        let mut count = 0;
        for row in self.of_mut(copy) {
            let bond = Kept::read(row);
            if bond.breaks {
                Kept { holds: has_failed, breaks: false, ..bond }.write(row);
                count += 1;
            }
        }
        count
    }

    /// Breaks a pair's bond in a copy: whether it held until then; none where the pair has none.
    pub(crate) fn separate(&mut self, copy: usize, pair: [usize; 2]) -> Option<bool> {
        for row in self.of_mut(copy) {
            let bond = Kept::read(row);
            if bond.pair == pair {
                Kept { holds: false, ..bond }.write(row);
                return Some(bond.holds);
            }
        }
        None
    }

    /// Forgets the bonds of a unit of the only copy that is no more, and counts those behind it anew.
    fn forget(&mut self, unit: usize) {
        let mut kept = 0;
        for number in 0..self.count {
            let Some(bond) = self.rows.get(number).map(Kept::read) else { break };
            // A bond needs both of its units.
            if bond.pair.contains(&unit) {
                continue;
            }
            let pair = bond.pair.map(|own| if own > unit { own - 1 } else { own });
            if let Some(row) = self.rows.get_mut(kept) {
                Kept { pair, ..bond }.write(row);
            }
            kept += 1;
        }
        self.count = kept;
    }

    /// Makes a copy's bonds those of another one.
    pub(crate) fn copy(&mut self, from: usize, to: usize) {
        for number in 0..self.count {
            let row = self.rows.get(from * self.room + number).copied();
            if let (Some(row), Some(to)) = (row, self.rows.get_mut(to * self.room + number)) {
                *to = row;
            }
        }
    }
}

/// Forgets a unit that is no more, of the only copy: `units` are the others, and it was before the one that has its number
/// now. What was held together by it alone parts.
pub(crate) fn forget(units: &mut [UnitSlot], bonds: &mut Bonds<'_>, unit: usize) {
    bonds.forget(unit);
    let gone = u32::try_from(unit).unwrap_or(u32::MAX).saturating_add(1);
    let heir = units.iter().position(|other| other.member.cluster_root == gone);
    for other in units.iter_mut() {
        let cluster_root = &mut other.member.cluster_root;
        if *cluster_root == gone {
            *cluster_root = heir.map_or(0, |heir| heir as u32 + 1);
        } else if *cluster_root > gone {
            *cluster_root -= 1;
        }
    }
    group(units, bonds.of(0));
}

/// Finds the clusters of a copy: units that bonds which hold connect. Of a cluster that has parted, the one with the first
/// unit keeps the body; each other one becomes a body of its own, with the least number that none has.
pub(crate) fn group(units: &mut [UnitSlot], bonds: impl Iterator<Item = Kept>) {
    for (number, unit) in units.iter_mut().enumerate() {
        unit.member.root = number as u32;
    }
    for Kept { pair: [a, b], .. } in bonds.filter(|bond| bond.holds) {
        let (a, b) = (root(units, a), root(units, b));
        if let Some(unit) = units.get_mut(a.max(b)) {
            unit.member.root = a.min(b) as u32;
        }
    }
    for number in 0..units.len() {
        let root = root(units, number);
        if let Some(unit) = units.get_mut(number) {
            unit.member.root = root as u32;
        }
    }
    // Numbers up to this one are in use, and stay so: what parts leaves its lead behind, who keeps the number.
    let mut used = 0;
    for number in 0..units.len() {
        let Some(unit) = units.get(number).filter(|unit| unit.member.root as usize == number)
        else {
            continue;
        };
        let has_parted =
            unit.member.cluster_root().is_some_and(|cluster_root| cluster_root != number);
        if has_parted {
            let body = unused_body(units, used);
            used = body;
            for unit in units.iter_mut().filter(|unit| unit.member.root as usize == number) {
                unit.body = body;
            }
        }
    }
    for number in 0..units.len() {
        let Some(root) = units.get(number).map(|unit| unit.member.root) else { break };
        let others = || units.iter().enumerate().filter(|(_, unit)| unit.member.root == root);
        let next = others().find(|(other, _)| *other > number);
        let next = next.map_or(root, |(other, _)| other as u32);
        let cluster_root = if next as usize == number { 0 } else { root + 1 };
        if let Some(unit) = units.get_mut(number) {
            unit.member = Member { cluster_root, next, root, ..unit.member };
        }
    }
}

/// Keeps the bodies of a copy's units, for [`restore`].
pub(crate) fn keep_bodies(units: &mut [UnitSlot]) {
    for unit in units {
        unit.member.body = unit.body;
    }
}

/// Takes the units of a copy back to the clusters and bodies that they had at [`keep_bodies`], once their bonds hold again.
pub(crate) fn restore(units: &mut [UnitSlot], bonds: impl Iterator<Item = Kept>) {
    for unit in units.iter_mut() {
        unit.body = unit.member.body;
    }
    group(units, bonds);
}

/// The first unit that a unit hangs together with, as far as that is known.
fn root(units: &[UnitSlot], mut number: usize) -> usize {
    // Roots go down: a way that is longer would not end.
    for _ in 0..units.len() {
        match units.get(number).map(|unit| unit.member.root as usize) {
            Some(root) if root < number => number = root,
            _ => break,
        }
    }
    number
}

/// The least number of a body above `used` that no unit has.
fn unused_body(units: &[UnitSlot], used: u32) -> u32 {
    let is_free = |body: &u32| units.iter().all(|unit| unit.body != *body);
    // Of one more number than there are units, one is free.
    (used + 1..=units.len() as u32).find(is_free).unwrap_or(units.len() as u32 + 1)
}

/// Puts the units of each cluster of a copy together again after the network's correction, and out of planes as a whole: `next`,
/// (units of the copy, [`STATE`]), has where they go, `solved` what impulses made of the step. Whether
/// there are clusters that do not rest.
pub(crate) fn hold_together(
    scene: &Scene<'_>,
    first: usize,
    solved: &[f32],
    next: &mut [f32],
) -> bool {
    let (_, units) = scene.around(first);
    let mut any = false;
    let (rows, _) = next.as_chunks_mut();
    for (number, unit) in units.iter().enumerate() {
        // What rests does so as a whole, and stays to the bit.
        let rests = || prior::solved(scene, first + number, solved).share < 0.0;
        if unit.cluster_root() != Some(number) || rests() {
            continue;
        }
        any = true;
        let [way, turn] = motion(units, number, rows);
        fit(scene, units, number, rows);
        let middle = middle(units, number, |number| pose_at(rows, number));
        for (number, _) in members(units, number) {
            let Some(row) = rows.get_mut(number) else { continue };
            let State { pose, course } = State::read(row);
            let way = way + turn.cross(&(pose.centre - middle));
            State { pose, course: course.moving(way, turn) }.write(row);
        }
        lift(scene, units, number, rows);
    }
    any
}

/// A pose of a unit's row.
fn pose_at(rows: &[[f32; STATE]], number: usize) -> Pose {
    rows.get(number).map_or_else(Pose::default, |row| read_pose(row))
}

/// A cluster's centre of mass, by where its units are: in levers from the first one, so that nothing is lost far from the origin.
fn middle(units: &[UnitSlot], cluster_root: usize, pose: impl Fn(usize) -> Pose) -> Vector3<f32> {
    let origin = pose(cluster_root).centre;
    let (mut mass, mut sum) = (0.0, Vector3::zeros());
    for (number, unit) in members(units, cluster_root) {
        mass += unit.mass;
        sum += (pose(number).centre - origin) * unit.mass;
    }
    origin + sum / mass
}

/// The way (m) and the turn (rad) in a step that have the momentum and the spin of a cluster's units together.
fn motion(units: &[UnitSlot], cluster_root: usize, rows: &[[f32; STATE]]) -> [Vector3<f32>; 2] {
    let middle = middle(units, cluster_root, |number| pose_at(rows, number));
    let (mut mass, mut ways) = (0.0, Vector3::<f64>::zeros());
    let (mut inertia, mut spin) = (Matrix3::<f64>::zeros(), Vector3::<f64>::zeros());
    for (number, unit) in members(units, cluster_root) {
        let Some(State { pose: next, course }) = rows.get(number).map(|row| State::read(row))
        else {
            continue;
        };
        let (own, arm) = (f64::from(unit.mass), (next.centre - middle).cast::<f64>());
        let (way, turn) = (course.way.cast::<f64>(), course.turn().cast::<f64>());
        let axes = next.rotation.cast::<f64>();
        let alone = axes * Matrix3::from_diagonal(&unit.inertia_m2.cast()) * axes.transpose();
        let far = Matrix3::from_diagonal_element(arm.norm_squared()) - arm * arm.transpose();
        mass += own;
        ways += way * own;
        inertia += (alone + far) * own;
        spin += (arm.cross(&way) + alone * turn) * own;
    }
    let [x, y, z]: [Vector3<f64>; 3] = inertia.data.0.map(Into::into);
    let (u, v, w) = (y.cross(&z), z.cross(&x), x.cross(&y));
    let turn = Vector3::new(u.dot(&spin), v.dot(&spin), w.dot(&spin)) / x.dot(&u);
    [ways / mass, turn].map(|vector| vector.map(|number| number as f32))
}

/// Makes the ways of a cluster's units to their next poses one rigid motion: its centre of mass goes where theirs does, and it
/// turns as fits their anchors best.
fn fit(scene: &Scene<'_>, units: &[UnitSlot], cluster_root: usize, rows: &mut [[f32; STATE]]) {
    let now = |number: usize| units.get(number).map_or_else(Pose::default, |unit| unit.current);
    let middle = middle(units, cluster_root, now);
    let (mut mass, mut moved) = (0.0, Vector3::zeros());
    for (number, unit) in members(units, cluster_root) {
        mass += unit.mass;
        moved += (pose_at(rows, number).centre - unit.current.centre) * unit.mass;
    }
    let moved = moved / mass;
    let mut covariance = Matrix3::<f64>::zeros();
    for (number, unit) in members(units, cluster_root) {
        let (now, next) = (unit.current, pose_at(rows, number));
        let arm = now.centre - middle;
        let after = ((next.centre - now.centre) - moved) + arm;
        for anchor in &scene.anchors_of(unit) {
            let from = (rotate(&now.rotation, anchor) + arm).cast::<f64>();
            let to = (rotate(&next.rotation, anchor) + after).cast::<f64>();
            covariance += to * from.transpose() * f64::from(unit.mass);
        }
    }
    let turn = turn_that_fits(&covariance);
    for (number, unit) in members(units, cluster_root) {
        let now = unit.current;
        let swing = rotate(&(turn - Matrix3::identity()), &(now.centre - middle));
        let mut next = unit.resting();
        next.shift(&(moved + swing));
        next.pose.rotation = orthonormal(&product(&turn, &now.rotation));
        next.course.turn_low = Vector3::zeros();
        if let Some(row) = rows.get_mut(number) {
            next.write(row);
        }
    }
}

/// Lifts a cluster out of planes, by the most that a unit of it has to be.
fn lift(scene: &Scene<'_>, units: &[UnitSlot], cluster_root: usize, rows: &mut [[f32; STATE]]) {
    for (place, plane) in scene.planes.iter().enumerate() {
        let most = members(units, cluster_root).fold(0.0_f32, |most, (number, unit)| {
            if unit.gives_way_on(scene, place) {
                return most;
            }
            let pose = rows.get(number).map_or(unit.current, |row| read_pose(row));
            let points = scene.hull_of(unit);
            most.max(plane.lift_m(points, unit.radius, &unit.current, &pose))
        });
        if most > 0.0 {
            shift(units, cluster_root, &(plane.normal * most), rows);
        }
    }
}

/// Moves a cluster. That is no velocity.
fn shift(units: &[UnitSlot], cluster_root: usize, way: &Vector3<f32>, rows: &mut [[f32; STATE]]) {
    for (number, _) in members(units, cluster_root) {
        let Some(row) = rows.get_mut(number) else { continue };
        let mut state = State::read(row);
        state.shift(way);
        state.write(row);
    }
}
