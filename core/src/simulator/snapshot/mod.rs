//! The state of a simulator as bytes, to go on from later: the same bits as going on without.
//!
//! A snapshot is made of words of 32 bits, least byte first, and the same on all targets:
//!
//! | part | holds |
//! |---|---|
//! | head | magic, version, the model's identity, copies, the next name |
//! | scene | counts, flags, time step, gravity, measure, contact law, planes; units, pairs of bonds, points and hulls, which all copies share |
//! | copies | a copy each: physics, poses and targets of its units, its bonds, its command, its soft points |
//! | end | a checksum of all |
//!
//! What follows from these is not in it: modulations, weights of pooling, the index of points, clusters, springs.

mod check;
mod identity;
mod layout;
mod restore;
mod words;

use super::state::Simulator;
use crate::error::SnapshotError;
use crate::kernels::in_own_environment;
use crate::scene::{Compliance, UnitSlot};
use crate::slices::slice_at;
use core::ops::Range;
use layout::{
    BALL, COMMANDED, END, GIVES_WAY, GUIDED, HEAD, LAWFUL, MAGIC, NO_NETWORK, ON_TERRAIN, PATCH,
    PIECES, QUARANTINES, VERSION, code_of, code_of_limit,
};
#[cfg(feature = "robot")]
use layout::{GUIDE, code_of_way};
use nalgebra::Vector3;
use words::{Compare, Count, Sink, WORD, Writer};

impl Simulator<'_, '_> {
    /// Bytes that [`snapshot`](Self::snapshot) writes now: about 300 for each unit of each copy, and 12 for each point.
    pub fn snapshot_bytes(&self) -> usize {
        self.bytes_of(0..self.kept_copies())
    }

    /// Writes the whole state of the scene to the caller's bytes: units with their points, poses in both frames, targets, joints,
    /// bonds, points of soft units, commands, planes, contact law, gravity and time step, in all copies. How many bytes it took.
    /// Whoever goes on from it by [`restore`](Self::restore), in this simulator or in another one of the same model, gets
    /// the same bits as this simulator, whatever its kernels, threads, limits and target. Its length is that of
    /// [`snapshot_bytes`](Self::snapshot_bytes).
    ///
    /// ```
    /// use nalgebra::{Isometry3, Point3};
    /// use rigidformer_core::{Limits, Model, Physics, Simulator, SlabSizes, Slabs, Unit, UnitSlot};
    /// # fn main() -> Result<(), Box<dyn std::error::Error>> {
    /// # let model = Model::load(rigidformer_weights::EDGE)?;
    /// # let limits = Limits { units: 2, points: 16 };
    /// # let sizes = SlabSizes::new(model.config(), limits);
    /// # let (mut numbers, mut bytes) = (vec![0.0; sizes.f32], vec![0; sizes.i8]);
    /// # let mut points = vec![Point3::origin(); sizes.points];
    /// # let mut units = vec![UnitSlot::EMPTY; sizes.units];
    /// # let slabs = Slabs { f32: &mut numbers, i8: &mut bytes, points: &mut points, units: &mut units };
    /// # let mut simulator = Simulator::new(&model, limits, slabs)?;
    /// simulator.set_dt(1.0 / 24.0)?;
    /// let corner = |i: usize, bit| if i & bit == 0 { -0.2 } else { 0.2 };
    /// let cube: Vec<_> = (0..8).map(|i| Point3::new(corner(i, 1), corner(i, 2), corner(i, 4))).collect();
    /// let rubber = Physics { mass_kg: 1.0, friction: 0.5, restitution: 0.5 };
    /// let above = Isometry3::translation(0.0, 0.0, 0.4);
    /// let id = simulator.add(&Unit::new(&cube, rubber), &above, &above)?;
    /// simulator.step()?;
    ///
    /// let mut state = [0; 1024];
    /// let length = simulator.snapshot(&mut state)?;
    /// simulator.step()?;
    /// let first = simulator.pose(id);
    /// simulator.restore(&state[..length])?;
    /// simulator.step()?;
    /// assert_eq!(simulator.pose(id), first);
    /// # Ok(())
    /// # }
    /// ```
    ///
    /// # Errors
    /// [`SnapshotError::Room`] where there are fewer bytes than that; then none is written.
    pub fn snapshot(&self, bytes: &mut [u8]) -> Result<usize, SnapshotError> {
        self.write(0..self.kept_copies(), bytes)
    }

    /// As [`snapshot_bytes`](Self::snapshot_bytes), of one copy alone.
    pub fn copy_snapshot_bytes(&self) -> usize {
        self.bytes_of(0..1)
    }

    /// As [`snapshot`](Self::snapshot), of one of the [copies](Self::replicate) alone: what it would be as a scene of its own.
    ///
    /// # Errors
    /// As [`snapshot`](Self::snapshot); [`SnapshotError::NoSuchCopy`].
    pub fn snapshot_copy(&self, copy: usize, bytes: &mut [u8]) -> Result<usize, SnapshotError> {
        let copies = self.scene.copies();
        if copy >= copies {
            return Err(SnapshotError::NoSuchCopy { copy, copies });
        }
        self.write(copy..copy + 1, bytes)
    }

    /// Goes on from a snapshot: the scene with all its copies is what it was then. Units have the names that they had. Names that this
    /// simulator gave since then are given to no other unit, so that units added later may have others than they had.
    ///
    /// # Errors
    /// [`SnapshotError`]; the scene is what it was.
    pub fn restore(&mut self, bytes: &[u8]) -> Result<(), SnapshotError> {
        in_own_environment(|| self.restore_here(bytes))
    }

    fn restore_here(&mut self, bytes: &[u8]) -> Result<(), SnapshotError> {
        let checked = self.checked(bytes)?;
        self.take_scene(&checked);
        for copy in 0..checked.copies {
            self.take_copy(&checked, copy, copy);
        }
        self.derive();
        Ok(())
    }

    /// Goes on with one copy from a [snapshot of one copy](Self::snapshot_copy), of the same scene: planes, contact law, gravity, time step, units,
    /// joints and pairs of bonds are those of the other copies.
    ///
    /// # Errors
    /// [`SnapshotError`]; the copy is what it was.
    pub fn restore_copy(&mut self, copy: usize, bytes: &[u8]) -> Result<(), SnapshotError> {
        in_own_environment(|| self.restore_copy_here(copy, bytes))
    }

    fn restore_copy_here(&mut self, copy: usize, bytes: &[u8]) -> Result<(), SnapshotError> {
        let checked = self.checked(bytes)?;
        let copies = self.scene.copies();
        if copy >= copies {
            return Err(SnapshotError::NoSuchCopy { copy, copies });
        }
        let mut compare = Compare { words: checked.words, at: HEAD, is_same: true };
        // Units of the other copies may give way where those of this one do not.
        let gives_way = checked.gives_way();
        self.write_scene(&mut compare, gives_way);
        compare.is_same &= gives_way || !self.planes_give_way();
        if checked.copies != 1 || !compare.is_same || compare.at != checked.start_of_copies {
            return Err(SnapshotError::OtherScene);
        }
        self.take_copy(&checked, 0, copy);
        self.derive_copy(copy);
        Ok(())
    }

    /// Copies in a snapshot: a scene without units has one, which has a command.
    fn kept_copies(&self) -> usize {
        if self.scene.units().is_empty() { 1 } else { self.scene.copies() }
    }

    /// Pairs of units that have bonds.
    fn pairs(&self) -> impl Iterator<Item = [usize; 2]> + use<'_> {
        #[cfg(feature = "deform")]
        return self.bonds.of(0).map(|bond| bond.pair);
        #[cfg(not(feature = "deform"))]
        core::iter::empty()
    }

    fn bytes_of(&self, copies: Range<usize>) -> usize {
        let mut count = Count(HEAD);
        self.write_scene(&mut count, self.gives_way());
        copies.for_each(|copy| self.write_copy(copy, &mut count));
        count.0.saturating_add(END).saturating_mul(WORD)
    }

    fn write(&self, copies: Range<usize>, bytes: &mut [u8]) -> Result<usize, SnapshotError> {
        let (needed, found) = (self.bytes_of(copies.clone()), bytes.len());
        if found < needed {
            return Err(SnapshotError::Room { needed, found });
        }
        let mut writer = Writer::new(bytes);
        writer.words([MAGIC, VERSION]);
        writer.long(identity::identity(self.model));
        writer.word(copies.len() as u32);
        writer.long(self.next_id);
        self.write_scene(&mut writer, self.gives_way());
        copies.for_each(|copy| self.write_copy(copy, &mut writer));
        writer.long(writer.hash.number());
        Ok(needed)
    }

    /// Whether contact of any plane or unit gives way, in any copy.
    fn gives_way(&self) -> bool {
        self.planes_give_way()
            || self.scene.units().iter().any(|unit| !unit.compliance().is_rigid())
    }

    fn planes_give_way(&self) -> bool {
        let Self { scene, given, .. } = self;
        (0..given.planes.len()).any(|plane| !scene.plane_compliance(plane).is_rigid())
    }

    /// Whether joints are more than pivots.
    fn is_guided(&self) -> bool {
        #[cfg(feature = "robot")]
        return self.scene.units().iter().any(|unit| {
            unit.link
                .above
                .is_some_and(|above| above.guide.way != crate::structure::link::Way::Ball)
        });
        #[cfg(not(feature = "robot"))]
        false
    }

    /// What all copies share.
    fn write_scene<S: Sink>(&self, to: &mut S, gives_way: bool) {
        let Self { scene, given, sizes, .. } = self;
        let units = scene.units().get(..scene.per_copy).unwrap_or_default();
        let counts = [units.len(), given.planes.len(), self.pairs().count(), sizes.command];
        to.words(counts.map(|count| count as u32));
        let quarantines = self.quarantines.get().is_some_and(|holds| *holds);
        let commanded = if self.commanded { COMMANDED } else { 0 };
        let giving = if gives_way { GIVES_WAY } else { 0 };
        let network = if self.has_network { 0 } else { NO_NETWORK };
        let law = scene.contact_law;
        let lawful = if law.is_rigid() { 0 } else { LAWFUL };
        let guided = if self.is_guided() { GUIDED } else { 0 };
        let quarantines = if quarantines { QUARANTINES } else { 0 };
        let terrain = scene.terrain_digest();
        let on_terrain = if terrain.is_some() { ON_TERRAIN } else { 0 };
        to.word(commanded | quarantines | giving | network | lawful | guided | on_terrain);
        to.number(given.dt_s);
        to.vector(&given.gravity);
        to.number(scene.measure.length());
        to.number(scene.measure.mass());
        to.vector(&scene.measure.origin());
        if !law.is_rigid() {
            to.number(law.restitution_offset);
            to.word(code_of_limit(law.friction));
        }
        if let Some(digest) = terrain {
            to.long(digest);
        }
        for (number, plane) in given.planes.iter().enumerate() {
            to.vector(&plane.normal);
            to.numbers([plane.offset_m, plane.friction, plane.restitution]);
            if gives_way {
                write_compliance(&scene.plane_compliance(number), to);
            }
        }
        let is_guided = self.is_guided();
        for unit in units {
            self.write_unit(units, unit, to);
            if is_guided {
                write_guide(unit, to);
            }
        }
        self.pairs().for_each(|pair| to.words(pair.map(|unit| unit as u32)));
        for unit in units {
            self.write_points(unit, to);
        }
        for unit in units {
            let rows = unit.hull_start..unit.hull_start + unit.hull_rows();
            let rows = scene.hulls.get(rows).unwrap_or_default();
            rows.iter().for_each(|row| to.vector(&row.coords));
        }
    }

    /// What does not change of a unit.
    fn write_unit<S: Sink>(&self, units: &[UnitSlot], unit: &UnitSlot, to: &mut S) {
        to.long(unit.id.to_bits());
        to.words([unit.count as u32, unit.hull as u32]);
        let ball = if unit.is_ball { BALL } else { 0 };
        let patch = if unit.is_soft() { PATCH } else { 0 };
        to.word(code_of(unit.given_role()) | ball | patch | u32::from(unit.pieces) << PIECES);
        #[cfg(feature = "deform")]
        to.number(unit.ln_young);
        #[cfg(not(feature = "deform"))]
        to.number(0.0);
        to.vector(&unit.offset.coords);
        to.vector(&unit.inertia_m2);
        #[cfg(feature = "robot")]
        if let Some(above) = unit.link.above {
            let parent = units.iter().position(|other| other.id.to_bits() == above.parent);
            to.word(parent.map_or(0, |parent| parent as u32 + 1));
            to.vector(&above.pivot.coords);
            to.vector(&above.parent_pivot.coords);
            return;
        }
        let _ = units;
        to.word(0);
        to.vector(&Vector3::zeros());
        to.vector(&Vector3::zeros());
    }

    /// Of a rigid unit its points, of a soft one where they are at rest and which ones they were.
    fn write_points<S: Sink>(&self, unit: &UnitSlot, to: &mut S) {
        #[cfg(feature = "deform")]
        if unit.is_soft() {
            for row in unit.start..unit.start + unit.count {
                to.vector(&self.scene.soft.rest(row));
                to.word(self.scene.soft.numbered_point(row).0 as u32);
            }
            return;
        }
        self.scene.points_of(unit).iter().for_each(|point| to.vector(&point.coords));
    }

    /// What a copy has for itself.
    fn write_copy<S: Sink>(&self, copy: usize, to: &mut S) {
        let Self { scene, lasting, sizes, .. } = self;
        let units = || scene.units().iter().skip(copy * scene.per_copy).take(scene.per_copy);
        let gives_way = self.gives_way();
        #[cfg(feature = "robot")]
        let is_guided = self.is_guided();
        for unit in units() {
            let physics = unit.physics;
            to.numbers([physics.mass_kg, physics.friction, physics.restitution]);
            to.words([unit.body, u32::from(unit.is_quarantined())]);
            to.number(unit.radius);
            for pose in [&unit.first, &unit.current, &unit.target] {
                to.pose(pose);
            }
            to.numbers(unit.course.row());
            if gives_way {
                write_compliance(&unit.compliance(), to);
            }
            #[cfg(feature = "robot")]
            if is_guided {
                let target = unit.link.above.and_then(|above| above.guide.target);
                to.number(target.unwrap_or(f32::INFINITY));
            }
        }
        #[cfg(feature = "deform")]
        for bond in self.bonds.of(copy) {
            to.word(u32::from(bond.holds));
            to.number(bond.seam.spread_m2);
            to.number(bond.seam.touches);
            to.numbers(bond.seam.middle);
        }
        let command = slice_at(lasting.command_inputs, copy * sizes.command, sizes.command);
        // What was not set may be anything.
        command.iter().for_each(|number| to.number(if self.commanded { *number } else { 0.0 }));
        #[cfg(feature = "deform")]
        for unit in units().filter(|unit| unit.is_soft()) {
            for row in unit.start..unit.start + unit.count {
                to.vector(&scene.soft.increment(row));
                to.vector(&scene.soft.current(row));
            }
        }
    }
}

/// Writes how contact gives way.
fn write_compliance<S: Sink>(compliance: &Compliance, to: &mut S) {
    to.numbers([compliance.stiffness_n_m, compliance.dissipation_s_m]);
}

/// Writes what a joint lets a unit do.
#[cfg(feature = "robot")]
fn write_guide<S: Sink>(unit: &UnitSlot, to: &mut S) {
    let Some(above) = unit.link.above else { return to.words([0; GUIDE]) };
    let guide = above.guide;
    to.word(code_of_way(guide.way));
    to.vector(&guide.axis);
    to.numbers(guide.rest);
    to.numbers(guide.limits);
    to.number(guide.force);
}

/// Nothing hangs.
#[cfg(not(feature = "robot"))]
fn write_guide<S: Sink>(_: &UnitSlot, _: &mut S) {}
