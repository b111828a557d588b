//! Bonds between units.

use super::state::Simulator;
use crate::error::BondError;
use crate::kernels::in_own_environment;
use crate::scene::{UnitId, UnitSlot};
use crate::structure::bonds::{Bond, Bonds, Seam, group};
use crate::structure::breaking::seam;

impl Simulator<'_, '_> {
    /// Makes pairs of units hold together rigidly, in all copies of the scene, from the next step on: free units of one
    /// [body](crate::Unit::body). Units that bonds connect, directly or through others, are a cluster, which moves as one rigid
    /// body (docs/MODEL.md, section 7). Units hold where they are: what is bonded while it moves goes on with the mean motion.
    ///
    /// A bond holds until it [is broken](Self::break_bond), one of the two is removed or another scene is observed. Models of format
    /// version 7 break bonds too, in a step, each copy its own; [`bonds`](Self::bonds) says which hold after it.
    ///
    /// ```
    /// use nalgebra::{Isometry3, Point3};
    /// use rigidformer_core::{Limits, Model, Physics, Posed, Simulator, SlabSizes, Slabs, Unit, UnitSlot};
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
    /// let brick = Physics { mass_kg: 2.0, friction: 0.6, restitution: 0.1 };
    /// let half = Unit::new(&corners, brick).body(1);
    /// let at = |x| Posed { unit: half, previous: Isometry3::translation(x, 0.0, 0.52), current: Isometry3::translation(x, 0.0, 0.5) };
    /// simulator.observe_poses(1.0 / 60.0, [at(0.0), at(0.2)])?;
    /// let [one, other] = [0, 1].map(|number| simulator.unit(number).map(|unit| unit.id()));
    /// let pair = [one.ok_or("no unit")?, other.ok_or("no unit")?];
    /// simulator.bond(&[pair])?;
    /// for _ in 0..30 {
    ///     simulator.step()?; // they fall and land as one brick
    /// }
    /// let [one, other] = pair.map(|id| simulator.pose(id));
    /// let (one, other) = (one.ok_or("no unit")?, other.ok_or("no unit")?);
    /// assert!(((one.inverse() * other).translation.x - 0.2).abs() < 1e-5);
    ///
    /// assert!(simulator.break_bond(pair)?); // from here on they are bodies of their own
    /// assert!(simulator.bonds().all(|bond| !bond.holds));
    /// simulator.step()?;
    /// # Ok(())
    /// # }
    /// ```
    ///
    /// # Errors
    /// [`BondError`]; the bonds are what they were.
    pub fn bond(&mut self, pairs: &[[UnitId; 2]]) -> Result<(), BondError> {
        in_own_environment(|| self.bond_here(pairs))
    }

    fn bond_here(&mut self, pairs: &[[UnitId; 2]]) -> Result<(), BondError> {
        let (found, limit) = (self.bonds.len().saturating_add(pairs.len()), self.bonds.room());
        if self.sizes.solved == 0 {
            return Err(BondError::Motion);
        }
        if found > limit {
            return Err(BondError::TooMany { found, limit });
        }
        for (place, pair) in pairs.iter().enumerate() {
            let numbers = self.pair(pair)?;
            let again = |other: &[UnitId; 2]| self.pair(other) == Ok(numbers);
            let is_kept = self.bonds.of(0).any(|bond| bond.pair == numbers);
            if is_kept || pairs.iter().take(place).any(again) {
                return Err(BondError::Twice { pair: *pair });
            }
            self.check_bond(pair)?;
        }
        let (per_copy, copies) = (self.scene.per_copy, self.scene.copies());
        for pair in pairs {
            if let Ok(numbers) = self.pair(pair) {
                let (scene, model) = (&self.scene, self.model);
                // Other models do not read where units meet.
                self.bonds.add(numbers, copies, |copy| match model.breaking {
                    Some(_) => seam(scene, copy, numbers),
                    None => Seam::default(),
                });
            }
        }
        for copy in 0..copies {
            group_copy(self.scene.units_mut(), per_copy, &self.bonds, copy);
        }
        Ok(())
    }

    /// Breaks the bond of a pair for good, in the first copy of the scene. Of a cluster that parts by that, what holds together with
    /// its first unit keeps the body; the rest is a body of its own from then on, which touches the others. Whether the bond held
    /// until then.
    ///
    /// # Errors
    /// [`BondError::NoSuchUnit`], [`BondError::Itself`], [`BondError::NoSuchBond`] or [`BondError::NoSuchCopy`]; the bonds are what they were.
    pub fn break_bond(&mut self, pair: [UnitId; 2]) -> Result<bool, BondError> {
        self.break_bond_in(0, pair)
    }

    /// As [`break_bond`](Self::break_bond), in one of the [copies](Self::replicate).
    ///
    /// # Errors
    /// As [`break_bond`](Self::break_bond).
    pub fn break_bond_in(&mut self, copy: usize, pair: [UnitId; 2]) -> Result<bool, BondError> {
        let numbers = self.pair(&pair)?;
        let (per_copy, copies) = (self.scene.per_copy, self.scene.copies());
        if copy >= copies {
            return Err(BondError::NoSuchCopy { copy, copies });
        }
        let held = self.bonds.separate(copy, numbers).ok_or(BondError::NoSuchBond { pair })?;
        if held {
            group_copy(self.scene.units_mut(), per_copy, &self.bonds, copy);
        }
        Ok(held)
    }

    /// All bonds, those of the first copy, in the order in which they were made, and whether they hold.
    pub fn bonds(&self) -> impl Iterator<Item = Bond> {
        self.bonds_in(0)
    }

    /// As [`bonds`](Self::bonds), in one of the [copies](Self::replicate); none where there is no such copy.
    pub fn bonds_in(&self, copy: usize) -> impl Iterator<Item = Bond> {
        let units = self.scene.units().get(..self.scene.per_copy).unwrap_or_default();
        let is_there = copy < self.scene.copies();
        self.bonds.of(copy).filter(move |_| is_there).filter_map(|bond| {
            let [a, b] = bond.pair.map(|number| units.get(number).map(|unit| unit.id));
            Some(Bond { units: [a?, b?], holds: bond.holds })
        })
    }

    /// Numbers in a copy of the two units of a bond, the lower one first.
    fn pair(&self, pair: &[UnitId; 2]) -> Result<[usize; 2], BondError> {
        let [a, b] = pair.map(|id| self.number(id).ok_or(BondError::NoSuchUnit { id }));
        let (a, b) = (a?, b?);
        match a == b {
            true => {
                let [id, _] = *pair;
                Err(BondError::Itself { id })
            }
            false => Ok([a.min(b), a.max(b)]),
        }
    }

    /// Whether two units can hold together, in all copies.
    fn check_bond(&self, pair: &[UnitId; 2]) -> Result<(), BondError> {
        let [a, b] = self.pair(pair)?;
        let units = self.scene.units();
        for copy in units.chunks_exact(self.scene.per_copy.max(1)) {
            let (Some(one), Some(other)) = (copy.get(a), copy.get(b)) else { continue };
            for unit in [one, other] {
                let id = unit.id;
                if !unit.is_free() || unit.is_soft() {
                    return Err(BondError::NotFree { id });
                }
                if is_joined(copy, unit) {
                    return Err(BondError::Joined { id });
                }
            }
            if one.body == 0 || one.body != other.body {
                return Err(BondError::Apart { pair: *pair });
            }
        }
        Ok(())
    }
}

/// Finds the clusters of a copy.
fn group_copy(units: &mut [UnitSlot], per_copy: usize, bonds: &Bonds<'_>, copy: usize) {
    let units = units.chunks_exact_mut(per_copy.max(1)).nth(copy).unwrap_or_default();
    group(units, bonds.of(copy));
}

/// Whether a unit hangs from another of its copy, or another from it.
#[cfg(feature = "robot")]
fn is_joined(copy: &[UnitSlot], unit: &UnitSlot) -> bool {
    let hangs_from =
        |other: &UnitSlot| other.link.above.is_some_and(|above| above.parent == unit.id.to_bits());
    unit.link.above.is_some() || copy.iter().any(hangs_from)
}

/// As above, without joints.
#[cfg(not(feature = "robot"))]
fn is_joined(_: &[UnitSlot], _: &UnitSlot) -> bool {
    false
}
