//! Whether bytes are a snapshot of this model that this simulator has room for. Nothing is taken before all of it is checked.

use super::identity::identity;
use super::layout::{
    BALL, COMMANDED, COMPLIANCE, COPY_BOND, COPY_COURSE, COPY_UNIT, END, GIVES_WAY, GUIDE, GUIDED,
    HEAD, LAW, LAWFUL, MAGIC, NO_NETWORK, ON_TERRAIN, PAIR, PATCH, PIECES, PLANE, QUARANTINES,
    REST, SCENE, SOFT, TARGET, TERRAIN, UNIT, VERSION, limit_of, role_of,
};
use super::words::{WORD, Words};
use crate::contact::ground::Plane;
use crate::contact::law::ContactLaw;
use crate::error::SnapshotError;
use crate::geometry::{COURSE, POSE, dot};
use crate::limits::{ANCHORS, MAX_COORDINATE_M, MAX_PIECES, MAX_PLANES};
use crate::measure::{Measure, is_similar};
use crate::scene::{Compliance, Physics, Role};
use crate::simulator::command::MAX_GRAVITY_M_S2;
use crate::simulator::measure::Time;
use crate::simulator::state::Simulator;
use core::ops::Range;
use nalgebra::Vector3;

/// Poses may be so far, metres or the scene's own: what a step takes a unit from may be beyond the largest coordinate.
const FAR: f32 = 1e9;
/// The columns of a rotation differ from unit vectors at right angles by less: long rollouts round.
const SKEW: f32 = 0.1;
/// Greater turns of a step are none, radians along an axis: longer steps of what spins fast have more than one.
const MOST_TURN: f32 = 1e5;
/// The second f32 of a place is at most this share of the first.
const LOW: f32 = f32::EPSILON;
/// The greatest next name: units that are added later have room for theirs.
const MOST_ID: u64 = 1 << 62;
/// Bodies of their own behind the last that a caller can name.
const MOST_BODY: usize = 1 << 16;

/// A snapshot that was checked, and where its parts begin, in words.
pub(super) struct Checked<'b> {
    pub(super) words: Words<'b>,
    pub(super) copies: usize,
    pub(super) units: usize,
    pub(super) planes: usize,
    pub(super) bonds: usize,
    command: usize,
    /// Points of a copy, those of its soft units, and rows of hulls.
    points: usize,
    soft_points: usize,
    pub(super) measure: Measure,
    /// None where the scene has no time step, or no unit to measure it by.
    pub(super) time: Option<Time>,
    start_of_points: usize,
    pub(super) start_of_copies: usize,
}

/// A unit's record.
pub(super) struct Record {
    pub(super) at: usize,
    pub(super) count: usize,
    pub(super) hull: usize,
    pub(super) role: Role,
    pub(super) is_ball: bool,
    pub(super) is_patch: bool,
    pub(super) pieces: u8,
    /// One more than the number of the unit that it hangs from, or 0.
    pub(super) parent: usize,
}

impl Record {
    /// Rows of hulls.
    pub(super) fn rows(&self) -> usize {
        crate::contact::pieces::rows(self.hull, self.pieces)
    }

    /// Words of its points.
    pub(super) fn point_words(&self) -> usize {
        self.count.saturating_mul(if self.is_patch { REST } else { 3 })
    }
}

impl<'b> Checked<'b> {
    pub(super) fn flags(&self) -> u32 {
        self.words.word(HEAD + 4)
    }

    pub(super) fn next_id(&self) -> u64 {
        self.words.long(5)
    }

    pub(super) fn dt_s(&self) -> f32 {
        self.words.number(HEAD + 5)
    }

    pub(super) fn gravity(&self) -> Vector3<f32> {
        self.words.vector(HEAD + 6)
    }

    pub(super) fn plane(&self, number: usize) -> Plane {
        let at = self.start_of_plane(number);
        let [offset_m, friction, restitution] = [3, 4, 5].map(|n| self.words.number(at + n));
        Plane { normal: self.words.vector(at), offset_m, friction, restitution }
    }

    /// Whether it has how contact gives way.
    pub(super) fn gives_way(&self) -> bool {
        self.flags() & GIVES_WAY != 0
    }

    /// Words of how contact gives way, a plane and a unit.
    fn compliance_words(&self) -> usize {
        if self.gives_way() { COMPLIANCE } else { 0 }
    }

    /// Whether it has what joints let units do.
    pub(super) fn is_guided(&self) -> bool {
        self.flags() & GUIDED != 0
    }

    /// Words of a unit.
    fn unit_words(&self) -> usize {
        if self.is_guided() { UNIT + GUIDE } else { UNIT }
    }

    /// Words of a unit in a copy.
    fn copy_unit_words(&self) -> usize {
        COPY_UNIT + self.compliance_words() + if self.is_guided() { TARGET } else { 0 }
    }

    /// Where a joint is wanted, whose unit's numbers a copy has there.
    #[cfg(feature = "robot")]
    pub(super) fn target(&self, at: usize) -> Option<f32> {
        let target = self.words.number(at + COPY_UNIT + self.compliance_words());
        Some(target).filter(|target| self.is_guided() && *target != f32::INFINITY)
    }

    /// What a joint lets the unit with a record there do; none where that is nothing sound.
    #[cfg(feature = "robot")]
    pub(super) fn guide(&self, at: usize) -> Option<crate::structure::link::Guide> {
        use crate::structure::link::{Guide, Way};
        if !self.is_guided() {
            return Some(Guide::BALL);
        }
        let (words, at) = (&self.words, at + UNIT);
        let way = super::layout::way_of(words.word(at))?;
        let number = |place: usize| words.number(at + place);
        let guide = Guide {
            way,
            axis: words.vector(at + 1),
            rest: [4, 5, 6, 7].map(number),
            limits: [8, 9].map(number),
            force: number(10),
            target: None,
        };
        if way == Way::Ball {
            return Some(Guide::BALL);
        }
        // As `Simulator::join` leaves them, but for rounding.
        let is_one = |sum: f32| (sum - 1.0).abs() < 1e-5;
        let [x, y, z, w] = guide.rest;
        let axis = crate::geometry::dot(&guide.axis, &guide.axis);
        let is_axis = if way.has_axis() { is_one(axis) } else { axis == 0.0 };
        let [least, greatest] = guide.limits;
        let is_sound = is_axis
            && is_one((x * x + y * y) + (z * z + w * w))
            && least <= greatest
            && guide.force > 0.0;
        is_sound.then_some(guide)
    }

    /// Whether it says how contacts that bounce differ from rigid ones.
    fn is_lawful(&self) -> bool {
        self.flags() & LAWFUL != 0
    }

    /// How they differ.
    pub(super) fn contact_law(&self) -> ContactLaw {
        if !self.is_lawful() {
            return ContactLaw::RIGID;
        }
        let restitution_offset = self.words.number(HEAD + SCENE);
        // Checked to be one.
        let friction = limit_of(self.words.word(HEAD + SCENE + 1)).unwrap_or_default();
        ContactLaw { restitution_offset, friction }
    }

    fn start_of_plane(&self, number: usize) -> usize {
        let terrain = if self.terrain_digest().is_some() { TERRAIN } else { 0 };
        self.start_of_terrain() + terrain + number * (PLANE + self.compliance_words())
    }

    fn start_of_terrain(&self) -> usize {
        HEAD + SCENE + if self.is_lawful() { LAW } else { 0 }
    }

    /// Which height field the scene is on.
    fn terrain_digest(&self) -> Option<u64> {
        (self.flags() & ON_TERRAIN != 0).then(|| self.words.long(self.start_of_terrain()))
    }

    /// How contact with a plane gives way.
    pub(super) fn plane_compliance(&self, number: usize) -> Compliance {
        self.compliance(self.start_of_plane(number) + PLANE)
    }

    /// How contact with a unit gives way, whose numbers a copy has there.
    pub(super) fn unit_compliance(&self, at: usize) -> Compliance {
        self.compliance(at + COPY_UNIT)
    }

    fn compliance(&self, at: usize) -> Compliance {
        if self.compliance_words() == 0 {
            return Compliance::RIGID;
        }
        let [stiffness_n_m, dissipation_s_m] = [at, at + 1].map(|at| self.words.number(at));
        Compliance { stiffness_n_m, dissipation_s_m }
    }

    fn start_of_units(&self) -> usize {
        self.start_of_plane(self.planes)
    }

    pub(super) fn unit(&self, number: usize) -> Record {
        let (words, at) = (&self.words, self.start_of_units() + number * self.unit_words());
        let packed = words.word(at + 4);
        // Checked to be one.
        let role = role_of(packed & 3).unwrap_or_default();
        Record {
            at,
            count: words.count(at + 2),
            hull: words.count(at + 3),
            role,
            is_ball: packed & BALL != 0,
            is_patch: packed & PATCH != 0,
            // Checked to be no more than `MAX_PIECES`.
            pieces: (packed >> PIECES) as u8,
            parent: words.count(at + 12),
        }
    }

    pub(super) fn records(&self) -> impl Iterator<Item = Record> + use<'_, 'b> {
        (0..self.units).map(|number| self.unit(number))
    }

    /// Points of a copy.
    pub(super) fn points(&self) -> usize {
        self.points
    }

    /// The numbers of two bonded units.
    pub(super) fn pair(&self, bond: usize) -> [usize; 2] {
        let at = self.start_of_units() + self.units * self.unit_words() + bond * PAIR;
        [self.words.count(at), self.words.count(at + 1)]
    }

    /// Where the points of units begin, and then those of hulls.
    pub(super) fn start_of_points(&self) -> usize {
        self.start_of_points
    }

    fn words_of_copy(&self) -> usize {
        let unit = self.copy_unit_words();
        let (units, bonds) = (self.units * unit, self.bonds * COPY_BOND);
        units
            .saturating_add(bonds)
            .saturating_add(self.command)
            .saturating_add(self.soft_points.saturating_mul(SOFT))
    }

    /// Where a copy has the numbers of a unit.
    pub(super) fn copy_unit(&self, copy: usize, unit: usize) -> usize {
        self.start_of_copies + copy * self.words_of_copy() + unit * self.copy_unit_words()
    }

    pub(super) fn physics(&self, at: usize) -> Physics {
        let [mass_kg, friction, restitution] = [0, 1, 2].map(|n| self.words.number(at + n));
        Physics { mass_kg, friction, restitution }
    }

    /// Where a copy has the numbers of a bond.
    pub(super) fn copy_bond(&self, copy: usize, bond: usize) -> usize {
        self.copy_unit(copy, self.units) + bond * COPY_BOND
    }

    /// Where a copy has its command.
    pub(super) fn copy_command(&self, copy: usize) -> usize {
        self.copy_bond(copy, self.bonds)
    }

    /// Where a copy has the points of its soft units.
    pub(super) fn copy_soft(&self, copy: usize) -> usize {
        self.copy_command(copy) + self.command
    }
}

/// An error about a word.
fn unsound(at: usize) -> SnapshotError {
    SnapshotError::Unsound { byte: at.saturating_mul(WORD) }
}

/// Whether something is so; a word to blame where it is not.
fn ensure(is_so: bool, at: usize) -> Result<(), SnapshotError> {
    if is_so { Ok(()) } else { Err(unsound(at)) }
}

/// Whether all of some words are numbers within a limit.
fn within(words: &Words<'_>, range: Range<usize>, limit: f32) -> Result<(), SnapshotError> {
    words.first_beyond(range, limit).map_or(Ok(()), |at| Err(unsound(at)))
}

/// Whether so many are no more than there is room for.
fn fits(
    found: usize,
    limit: usize,
    error: fn(usize, usize) -> SnapshotError,
) -> Result<(), SnapshotError> {
    if found <= limit { Ok(()) } else { Err(error(found, limit)) }
}

impl Simulator<'_, '_> {
    /// Checks all of a snapshot.
    pub(super) fn checked<'b>(&self, bytes: &'b [u8]) -> Result<Checked<'b>, SnapshotError> {
        let words = Words::new(bytes).filter(|words| words.len() >= HEAD + SCENE + END);
        let words = words.filter(|words| words.word(0) == MAGIC);
        let words = words.ok_or(SnapshotError::NotASnapshot)?;
        let found = words.word(1);
        if found != VERSION {
            return Err(SnapshotError::Version { found, supported: VERSION });
        }
        let end = words.len() - END;
        if words.hash(end).number() != words.long(end) {
            return Err(SnapshotError::Checksum);
        }
        if words.long(2) != identity(self.model) {
            return Err(SnapshotError::OtherModel);
        }
        let checked = self.laid_out(words)?;
        self.check_names(&checked)?;
        self.check_bonds(&checked)?;
        self.check_points(&checked)?;
        for copy in 0..checked.copies {
            self.check_copy(&checked, copy)?;
        }
        Ok(checked)
    }

    /// Finds where everything is, and whether there is room for it.
    fn laid_out<'b>(&self, words: Words<'b>) -> Result<Checked<'b>, SnapshotError> {
        let (sizes, limits) = (&self.sizes, self.limits);
        let [copies, units, planes, bonds, command] =
            [4, HEAD, HEAD + 1, HEAD + 2, HEAD + 3].map(|at| words.count(at));
        fits(units, limits.units, |found, limit| SnapshotError::TooManyUnits { found, limit })?;
        fits(copies, sizes.copies, |found, limit| SnapshotError::TooManyCopies { found, limit })?;
        ensure(copies > 0 && (units > 0 || copies == 1), 4)?;
        ensure(planes <= MAX_PLANES, HEAD + 1)?;
        ensure(command == sizes.command, HEAD + 3)?;
        #[cfg(feature = "deform")]
        fits(bonds, self.bonds.room(), |found, limit| SnapshotError::TooManyBonds {
            found,
            limit,
        })?;
        #[cfg(not(feature = "deform"))]
        if bonds > 0 {
            return Err(SnapshotError::LeftOut);
        }
        let [length, mass] = [HEAD + 9, HEAD + 10].map(|at| words.number(at));
        let measure = Measure::new(length, mass).from(words.vector(HEAD + 11));
        let mut checked = Checked {
            words,
            copies,
            units,
            planes,
            bonds,
            command,
            points: 0,
            soft_points: 0,
            measure,
            time: None,
            start_of_points: 0,
            start_of_copies: 0,
        };
        // Lengths come first: what is not there counts as 0.
        let end = words.len() - END;
        let behind = checked.start_of_units() + units * checked.unit_words() + bonds * PAIR;
        let length = |expected: usize| SnapshotError::Length {
            found: words.len().saturating_mul(WORD),
            expected: expected.saturating_add(END).saturating_mul(WORD),
        };
        if behind > end {
            return Err(length(behind));
        }
        let (mut points, mut soft, mut rows, mut at) = (0_usize, 0_usize, 0_usize, behind);
        for unit in checked.records() {
            let pieces = words.word(unit.at + 4) >> PIECES;
            let packed = words.word(unit.at + 4);
            let flags = packed & ((1 << PIECES) - 1);
            let is_known = flags <= (3 | BALL | PATCH) && role_of(packed & 3).is_some();
            ensure(is_known && pieces as usize <= MAX_PIECES, unit.at + 4)?;
            points = points.saturating_add(unit.count);
            soft = soft.saturating_add(if unit.is_patch { unit.count } else { 0 });
            rows = rows.saturating_add(unit.hull.saturating_add(2 * pieces as usize));
            at = at.saturating_add(unit.point_words());
            fits(points.max(rows), limits.points, |found, limit| SnapshotError::TooManyPoints {
                found,
                limit,
            })?;
        }
        (checked.points, checked.soft_points) = (points, soft);
        checked.start_of_points = behind;
        checked.start_of_copies = at.saturating_add(rows.saturating_mul(3));
        let copies_end =
            checked.words_of_copy().saturating_mul(copies).saturating_add(checked.start_of_copies);
        if copies_end != end {
            return Err(length(copies_end));
        }
        #[cfg(feature = "deform")]
        if sizes.is_soft() {
            let most = crate::structure::soft_points::MAX_ROWS / points.max(1);
            fits(copies, most, |found, limit| SnapshotError::TooManyCopies { found, limit })?;
        }
        self.check_world(&mut checked)?;
        Ok(checked)
    }

    /// Planes, gravity, the measure and the time step.
    fn check_world(&self, checked: &mut Checked<'_>) -> Result<(), SnapshotError> {
        let config = self.model.config();
        Self::check_flags(checked)?;
        if checked.terrain_digest() != self.scene.terrain_digest() {
            return Err(SnapshotError::OtherHeightField);
        }
        for plane in 0..checked.planes {
            let at = checked.start_of_plane(plane);
            ensure(checked.plane(plane).is_sound_here(), at)?;
            ensure(checked.plane_compliance(plane).is_sound(), at + PLANE)?;
        }
        let gravity = checked.gravity();
        ensure(gravity.iter().all(|g| g.abs() <= MAX_GRAVITY_M_S2), HEAD + 6)?;
        let measure = checked.measure;
        // A measure that no units can have would make numbers that are none.
        let is_sound = match is_similar(config) {
            true => [measure.length(), measure.mass()].iter().all(|v| (1e-12..=1e12).contains(v)),
            false => measure.from(Vector3::zeros()) == Measure::SI,
        };
        ensure(is_sound, HEAD + 9)?;
        let origin = measure.origin();
        // Soft bodies and robots are where the world has them. Others may be counted from near any place, in another length's steps.
        let most = if self.keeps_origin() { 0.0 } else { 2.0 * MAX_COORDINATE_M };
        ensure(origin.iter().all(|v| v.abs() <= most), HEAD + 11)?;
        let dt_s = checked.dt_s();
        if dt_s == 0.0 {
            return ensure(checked.units == 0 && dt_s.is_sign_positive(), HEAD + 5);
        }
        ensure((f32::MIN_POSITIVE..=f32::MAX).contains(&dt_s), HEAD + 5)?;
        // Scenes without units have no measure of their own yet.
        if checked.units > 0 || !is_similar(config) {
            let time = Time::new(dt_s, &measure, &gravity, config);
            checked.time = Some(time.map_err(|_| unsound(HEAD + 5))?);
        }
        Ok(())
    }

    /// Flags, and what follows from them.
    fn check_flags(checked: &Checked<'_>) -> Result<(), SnapshotError> {
        #[cfg(not(feature = "health"))]
        if checked.flags() & QUARANTINES != 0 {
            return Err(SnapshotError::LeftOut);
        }
        if cfg!(not(feature = "compliance")) && checked.gives_way() {
            return Err(SnapshotError::LeftOut);
        }
        if checked.is_lawful() {
            let law = checked.contact_law();
            // A law of rigid contacts is none, and a zero has no sign.
            let is_plain = law.restitution_offset.is_sign_positive() && !law.is_rigid();
            ensure(law.is_sound() && is_plain, HEAD + SCENE)?;
            ensure(limit_of(checked.words.word(HEAD + SCENE + 1)).is_some(), HEAD + SCENE + 1)?;
        }
        if cfg!(not(feature = "terrain")) && checked.terrain_digest().is_some() {
            return Err(SnapshotError::LeftOut);
        }
        if cfg!(not(feature = "robot")) && checked.is_guided() {
            return Err(SnapshotError::LeftOut);
        }
        let known = COMMANDED | QUARANTINES | GIVES_WAY | NO_NETWORK | LAWFUL | GUIDED | ON_TERRAIN;
        ensure(checked.flags() <= known, HEAD + 4)
    }

    /// Names, and what hangs from what.
    fn check_names(&self, checked: &Checked<'_>) -> Result<(), SnapshotError> {
        let mut last = 0;
        ensure((1..=MOST_ID).contains(&checked.next_id()), 5)?;
        for unit in checked.records() {
            let id = checked.words.long(unit.at);
            // Names rise.
            ensure(last < id && id < checked.next_id(), unit.at)?;
            last = id;
            if unit.parent == 0 {
                continue;
            }
            if cfg!(not(feature = "robot")) {
                return Err(SnapshotError::LeftOut);
            }
            let mut above = unit.parent;
            // A longer way up would go round.
            for _ in 0..checked.units {
                let Some(number) = above.checked_sub(1) else { break };
                ensure(number < checked.units, unit.at + 12)?;
                let parent = checked.unit(number);
                ensure(!parent.is_patch && !unit.is_patch, unit.at + 12)?;
                above = parent.parent;
            }
            ensure(above == 0, unit.at + 12)?;
            let pivots = unit.at + 13..unit.at + 19;
            within(&checked.words, pivots, MAX_COORDINATE_M)?;
            #[cfg(feature = "robot")]
            {
                let guide = checked.guide(unit.at);
                let is_ball =
                    guide.is_some_and(|guide| guide.way == crate::structure::link::Way::Ball);
                let may_be = is_ball || self.model.config().motion.has_impulses();
                ensure(guide.is_some() && may_be, unit.at + UNIT)?;
            }
        }
        Ok(())
    }

    /// Which units have bonds.
    fn check_bonds(&self, checked: &Checked<'_>) -> Result<(), SnapshotError> {
        for bond in 0..checked.bonds {
            let ([a, b], at) =
                (checked.pair(bond), checked.start_of_points() - (checked.bonds - bond) * PAIR);
            ensure(a < b && b < checked.units, at)?;
            ensure([a, b].iter().all(|unit| !checked.unit(*unit).is_patch), at)?;
        }
        Ok(())
    }

    /// Units' shapes, and their points.
    fn check_points(&self, checked: &Checked<'_>) -> Result<(), SnapshotError> {
        let (words, sizes) = (&checked.words, &self.sizes);
        let mut at = checked.start_of_points();
        for unit in checked.records() {
            ensure(unit.count >= ANCHORS, unit.at + 2)?;
            if unit.is_patch {
                if !sizes.is_soft() {
                    return Err(SnapshotError::LeftOut);
                }
                ensure(unit.role == Role::Free && unit.pieces == 0, unit.at + 4)?;
            }
            // e^40 Pa is more than any.
            ensure(words.number(unit.at + 5).abs() <= 40.0, unit.at + 5)?;
            within(words, unit.at + 6..unit.at + 9, MAX_COORDINATE_M)?;
            let moments = words.vector(unit.at + 9);
            ensure(moments.iter().all(|v| (1e-12..=f32::MAX).contains(v)), unit.at + 9)?;
            let end = at.saturating_add(unit.point_words());
            if unit.is_patch {
                for row in 0..unit.count {
                    let (row, given) = (at + row * REST, at + row * REST + 3);
                    within(words, row..given, MAX_COORDINATE_M)?;
                    ensure(words.count(given) < unit.count, given)?;
                }
            } else {
                within(words, at..end, FAR)?;
            }
            at = end;
        }
        for unit in checked.records() {
            ensure(if sizes.impacts == 0 { unit.rows() == 0 } else { unit.hull > 0 }, unit.at + 3)?;
            let end = at + unit.rows() * 3;
            within(words, at..end, FAR)?;
            for piece in 0..usize::from(unit.pieces) {
                // Behind a middle and a radius: the first point, and how many.
                let place = at + (unit.hull + piece * 2) * 3 + 4;
                let [first, count] = [place, place + 1].map(|at| words.number(at));
                let is_whole = |number: f32| number == (number as u32) as f32;
                let end = (first as usize).saturating_add(count as usize);
                ensure(
                    is_whole(first) && is_whole(count) && count >= 1.0 && end <= unit.hull,
                    place,
                )?;
            }
            at = end;
        }
        Ok(())
    }

    /// What a copy has for itself.
    fn check_copy(&self, checked: &Checked<'_>, copy: usize) -> Result<(), SnapshotError> {
        let words = &checked.words;
        for (number, unit) in checked.records().enumerate() {
            let at = checked.copy_unit(copy, number);
            ensure(checked.physics(at).is_sound(), at)?;
            ensure(checked.unit_compliance(at).is_sound(), at + COPY_UNIT)?;
            #[cfg(feature = "robot")]
            if let Some(target) = checked.target(at) {
                ensure(target.abs() <= MAX_COORDINATE_M, at + COPY_UNIT)?;
            }
            ensure(words.count(at + 3) <= MOST_BODY.max(checked.units + 1), at + 3)?;
            let is_held = words.word(at + 4);
            // Free units alone diverge.
            ensure(
                is_held == 0 || (is_held == 1 && unit.role == Role::Free && !unit.is_patch),
                at + 4,
            )?;
            if is_held > 0 && cfg!(not(feature = "health")) {
                return Err(SnapshotError::LeftOut);
            }
            let radius = words.number(at + 5);
            ensure(radius > 0.0 && radius <= FAR, at + 5)?;
            for pose in 0..3 {
                let place = at + 6 + pose * POSE;
                let pose = words.pose(place);
                ensure(pose.is_sound(FAR), place)?;
                let [x, y, z]: [Vector3<f32>; 3] = pose.rotation.data.0.map(Into::into);
                let lengths = [&x, &y, &z].map(|v| (dot(v, v) - 1.0).abs());
                let cosines = [dot(&x, &y).abs(), dot(&y, &z).abs(), dot(&z, &x).abs()];
                let is_rotation = lengths.iter().chain(&cosines).all(|v| *v <= SKEW);
                ensure(is_rotation && dot(&x.cross(&y), &z) > 0.0, place)?;
            }
            let course = at + COPY_COURSE;
            within(words, course..course + COURSE, FAR)?;
            within(words, course + COURSE - 3..course + COURSE, MOST_TURN)?;
            let centre = words.pose(at + 6 + POSE).centre;
            within(words, course..course + 3, LOW * centre.amax())?;
            // What a rotation rounds off.
            within(words, course + 3..course + 6, SKEW)?;
        }
        let has_joints = checked.records().any(|unit| unit.parent > 0);
        for bond in 0..checked.bonds {
            let at = checked.copy_bond(copy, bond);
            ensure(words.word(at) <= 1, at)?;
            within(words, at + 1..at + COPY_BOND, FAR)?;
            if words.word(at) == 1 {
                check_holding(checked, copy, bond, has_joints)?;
            }
        }
        let (command, soft) = (checked.copy_command(copy), checked.copy_soft(copy));
        within(words, command..soft, f32::MAX)?;
        let end = soft + checked.soft_points * SOFT;
        within(words, soft..end, FAR)
    }
}

/// Whether two units can hold together in a copy.
fn check_holding(
    checked: &Checked<'_>,
    copy: usize,
    bond: usize,
    has_joints: bool,
) -> Result<(), SnapshotError> {
    let (words, pair) = (&checked.words, checked.pair(bond));
    let [a, b] = pair.map(|unit| checked.copy_unit(copy, unit));
    let body = words.word(a + 3);
    let can_hold = |number: usize| {
        let unit = checked.unit(number);
        let hangs = |other: Record| other.parent == number + 1;
        let is_joined = has_joints && (unit.parent > 0 || checked.records().any(hangs));
        let is_held = words.word(checked.copy_unit(copy, number) + 4) == 1;
        unit.role == Role::Free && !is_held && !is_joined
    };
    ensure(body > 0 && body == words.word(b + 3), b + 3)?;
    ensure(pair.into_iter().all(can_hold), checked.copy_bond(copy, bond))
}
