//! Bonds that a rollout holds: until the model breaks them, or, with a model that breaks none, until the record does.

use rigidformer_core::{BondError, UnitId};
use rigidformer_runtime::world::World;

use crate::scenes::{RecordedBond, RecordedScene};

/// The bonds of a world that hold so far.
#[derive(Default)]
pub(crate) struct HeldBonds {
    bonds: Vec<([UnitId; 2], RecordedBond)>,
}

impl HeldBonds {
    /// Makes those that hold at a frame in a world that has just observed the scene; none with a model that cannot move units
    /// that hold together.
    pub(crate) fn make(
        world: &mut World,
        scene: &RecordedScene,
        frame: usize,
    ) -> Result<HeldBonds, BondError> {
        // Other motions have no impulse between two units, so nothing could hold them together.
        if scene.bonds().is_empty() || !world.model().model().config().motion.has_impulses() {
            return Ok(HeldBonds::default());
        }
        let ids: Vec<UnitId> = world.simulator().units().map(|unit| unit.id()).collect();
        let with_ids = |bond: &RecordedBond| {
            let [a, b] = bond.units.map(|unit| ids.get(unit).copied());
            Some(([a?, b?], *bond))
        };
        let holding = scene.bonds().iter().filter(|bond| bond.holds(frame));
        let bonds: Vec<_> = holding.filter_map(with_ids).collect();
        let pairs: Vec<[UnitId; 2]> = bonds.iter().map(|(pair, _)| *pair).collect();
        // All at once: a bond that is refused refuses all, and the world stays as it was.
        world.edit(|simulator| simulator.bond(&pairs))?;
        Ok(HeldBonds { bonds })
    }

    /// Breaks those that the record has broken at a frame, with a model that breaks none.
    pub(crate) fn break_recorded(
        &mut self,
        world: &mut World,
        frame: usize,
    ) -> Result<(), BondError> {
        // A model that breaks bonds decides by itself; the record must not tell it.
        if world.model().model().config().bonds > 0 {
            return Ok(());
        }
        for (pair, _) in self.bonds.iter().filter(|(_, bond)| !bond.holds(frame)) {
            world.edit(|simulator| simulator.break_bond(*pair))?;
        }
        self.bonds.retain(|(_, bond)| bond.holds(frame));
        Ok(())
    }
}

/// (bonds) Whether each of the scene's bonds holds in a world; `None` where the world has no bonds.
pub(crate) fn holding(world: &World, scene: &RecordedScene) -> Option<Vec<bool>> {
    let simulator = world.simulator();
    let number = |id: UnitId| simulator.number(id);
    let pairs: Vec<[usize; 2]> = simulator
        .bonds()
        .filter(|bond| bond.holds)
        .filter_map(|bond| Some([number(bond.units[0])?, number(bond.units[1])?]))
        .collect();
    // No bond at all differs from bonds that are all broken.
    simulator.bonds().next()?;
    let holds = |bond: &RecordedBond| {
        let [a, b] = bond.units;
        // A simulator orders the units of a bond, and files need not.
        pairs.contains(&[a.min(b), a.max(b)])
    };
    Some(scene.bonds().iter().map(holds).collect())
}
