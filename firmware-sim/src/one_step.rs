//! Single steps of both models from the same recorded states: anchors and layers.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::atomic::Ordering;

use nalgebra::{Isometry3, Point3, Vector3};
use rigidformer_evaluation::figures::LAST_FRAME;
use rigidformer_evaluation::rollout::{Replay, RolloutError};
use rigidformer_evaluation::scenes::{RecordedScene, clusters};
use rigidformer_runtime::core::{ANCHORS, Layer, Role};
use rigidformer_runtime::engine::Engine;
use rigidformer_runtime::progress::Progress;
use rigidformer_runtime::world::World;

use crate::drift::spread;
use crate::pair::Pair;
use crate::report::{Bonds, LayerNoise, OneStep};
use crate::trace::{Content, Record, Recorder};

/// The frames whose states single steps start from: the two frames observed and the one predicted are among the first
/// 100.
pub(crate) fn frames(step: u32, every: u32) -> impl Iterator<Item = u32> {
    (step..=LAST_FRAME.saturating_sub(step)).step_by(every.max(1) as usize)
}

/// Sums over units and states.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Anchors {
    /// Units, counted once a state.
    units: u64,
    /// Squared distances between the models.
    difference: f64,
    /// Squared distances of the float model from the truth.
    error: f64,
}

/// What single steps add up to.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct Sums {
    all: Anchors,
    /// Units that the two models moved differently: those that the network moved.
    active: Anchors,
    largest_m: f64,
    /// Bonds that held before steps, counted once a state.
    bonds: u64,
    /// Those that one model broke and the other did not.
    bonds_apart: u64,
    /// Units of the clusters that those belonged to, which are in no other sum.
    units_of_bonds: u64,
    /// Difference over error of every active unit.
    ratios: Vec<f64>,
    /// Squares of the float model's values and of the differences, by layer and scale.
    layers: BTreeMap<(Content, usize), (f64, f64)>,
}

impl Sums {
    pub(crate) fn add(&mut self, other: &Sums) {
        for (sum, more) in [(&mut self.all, other.all), (&mut self.active, other.active)] {
            sum.units += more.units;
            sum.difference += more.difference;
            sum.error += more.error;
        }
        self.largest_m = self.largest_m.max(other.largest_m);
        self.bonds += other.bonds;
        self.bonds_apart += other.bonds_apart;
        self.units_of_bonds += other.units_of_bonds;
        self.ratios.extend(&other.ratios);
        for (layer, (signal, noise)) in &other.layers {
            let sums = self.layers.entry(*layer).or_default();
            *sums = (sums.0 + signal, sums.1 + noise);
        }
    }

    pub(crate) fn one_step(&self) -> OneStep {
        let rms = |sum: f64, units: u64| (sum / (units.max(1) as f64 * ANCHORS as f64)).sqrt();
        let ratio = |sums: &Anchors| {
            // Two models that agree have the ratio 0, also where the float model has no error.
            if sums.difference > 0.0 { (sums.difference / sums.error).sqrt() } else { 0.0 }
        };
        OneStep {
            units: self.all.units,
            active_units: self.active.units,
            difference_m: rms(self.active.difference, self.active.units),
            largest_difference_m: self.largest_m,
            float_error_m: rms(self.active.error, self.active.units),
            ratio: ratio(&self.active),
            ratio_all: ratio(&self.all),
            median_ratio: spread(self.ratios.clone()).median,
            bonds: (self.bonds > 0).then(|| Bonds {
                held: self.bonds,
                apart: self.bonds_apart,
                share: self.bonds_apart as f64 / self.bonds as f64,
                units: self.units_of_bonds,
            }),
        }
    }

    pub(crate) fn layers(&self) -> Vec<LayerNoise> {
        let row =
            |(&(layer, scale), &(signal, noise)): (&(Content, usize), &(f64, f64))| LayerNoise {
                layer: layer.label(scale),
                sqnr_db: (noise != 0.0).then(|| 10.0 * (signal / noise).log10()),
            };
        self.layers.iter().map(row).collect()
    }

    fn add_layers(&mut self, float: &[Record], quantised: &[Record]) {
        // From there on records are positions, which `one_step` measures in metres.
        let of_network = |record: &Record| record.content < Content::Layer(Layer::Advanced);
        for (a, b) in float.iter().zip(quantised).filter(|(a, _)| of_network(a)) {
            let scale = a.content.scale(a.index);
            let sums = self.layers.entry((a.content, scale)).or_default();
            for (x, y) in a.values.iter().zip(&b.values) {
                let (x, y) = (f64::from(*x), f64::from(*y));
                *sums = (sums.0 + x * x, sums.1 + (x - y) * (x - y));
            }
        }
    }
}

/// All states of one scene.
pub(crate) fn of_scene(
    models: &Pair<'_>,
    scene: &RecordedScene,
    step: u32,
    every: u32,
    progress: Progress<'_>,
) -> Result<Sums, RolloutError> {
    let mut sums = Sums::default();
    // Scenes run side by side, so each takes one thread.
    let engine = Engine::new()?.single();
    let mut float = Replay::new(engine, models.float, scene)?;
    let mut quantised = Replay::new(engine, models.quantised, scene)?;
    let mut layers = (Recorder::new(models.float.model()), Recorder::new(models.quantised.model()));
    for frame in frames(step, every) {
        if progress.cancelled.load(Ordering::Relaxed) {
            return Err(RolloutError::Cancelled);
        }
        let state = State { scene, step, frame };
        let a = state.advance(&mut float, &mut layers.0)?;
        let b = state.advance(&mut quantised, &mut layers.1)?;
        let excluded = sums.add_bonds(scene.units().len(), &a, &b);
        for (((unit, expected), (_, a)), (_, b)) in a.expected.iter().zip(&a.found).zip(&b.found) {
            match excluded.contains(unit) {
                // Another broken bond moves a unit far, which says nothing of how finely layers are
                // kept.
                true => sums.units_of_bonds += 1,
                false => sums.add_unit(expected, a, b),
            }
        }
        // Where other bonds hold, the layers are those of another scene and no noise.
        if excluded.is_empty() {
            sums.add_layers(&layers.0.records, &layers.1.records);
        }
        (progress.stepped)();
    }
    Ok(sums)
}

type UnitAnchors = [Vector3<f64>; ANCHORS];

/// What one model made of a recorded state: units by their numbers in the scene.
struct Step {
    /// Where the record has the anchors of free units a step later.
    expected: Vec<(usize, UnitAnchors)>,
    /// Where the model puts them.
    found: Vec<(usize, UnitAnchors)>,
    /// Units of each bond, and whether it held before the step and after it.
    bonds: Vec<([usize; 2], [bool; 2])>,
}

impl Sums {
    /// Counts the bonds, and finds the units of each cluster, as it was before the step, of which the models broke different bonds.
    fn add_bonds(&mut self, units: usize, float: &Step, quantised: &Step) -> BTreeSet<usize> {
        let held = |step: &Step| step.bonds.clone().into_iter().filter(|(_, [held, _])| *held);
        // Clusters are those before the step, in which both models agree.
        let cluster = clusters(units, held(float).map(|(pair, _)| pair));
        let mut differing: BTreeSet<usize> = BTreeSet::new();
        for ((pair, [_, holds]), (_, [_, other])) in held(float).zip(held(quantised)) {
            self.bonds += 1;
            if holds != other {
                self.bonds_apart += 1;
                differing.extend(cluster.get(pair[0]));
            }
        }
        let members = cluster.iter().enumerate().filter(|(_, root)| differing.contains(root));
        members.map(|(unit, _)| unit).collect()
    }

    fn add_unit(&mut self, truth: &UnitAnchors, float: &UnitAnchors, quantised: &UnitAnchors) {
        let squared = |a: &UnitAnchors, b: &UnitAnchors| -> f64 {
            a.iter().zip(b).map(|(a, b)| (a - b).norm_squared()).sum()
        };
        let (difference, error) = (squared(float, quantised), squared(float, truth));
        // Units that can touch nothing move freely in both models, bit for bit.
        let differs = float != quantised;
        if differs {
            self.ratios.push((difference / error).sqrt());
        }
        let of_active = if differs { Some(&mut self.active) } else { None };
        for sums in std::iter::once(&mut self.all).chain(of_active) {
            sums.units += 1;
            sums.difference += difference;
            sums.error += error;
        }
        let apart = float.iter().zip(quantised).map(|(a, b)| (a - b).norm());
        self.largest_m = apart.fold(self.largest_m, f64::max);
    }
}

/// A recorded state to start from.
struct State<'s> {
    scene: &'s RecordedScene,
    step: u32,
    frame: u32,
}

impl State<'_> {
    fn advance(
        &self,
        replay: &mut Replay<'_>,
        layers: &mut Recorder,
    ) -> Result<Step, RolloutError> {
        let Self { scene, step, frame } = *self;
        let next = frame.saturating_add(step);
        replay.observe(step, frame)?;
        replay.command(frame, step)?;
        let recorded = |unit: usize, frame: u32| -> Isometry3<f64> {
            scene.pose(frame as usize, unit).copied().unwrap_or_default().cast()
        };
        let expected = free_anchors(&replay.world).map(|(unit, anchors)| {
            let soft = scene.units().get(unit).and_then(|unit| unit.soft.as_ref());
            // A soft unit's anchors are points of its own, which the record has.
            if let Some(points) = soft.and_then(|frames| frames.get(next as usize)) {
                let truth = |number: usize| points.get(number).copied().unwrap_or_default();
                return (unit, anchors.map(|(number, _)| truth(number).coords.cast::<f64>()));
            }
            // A rigid unit's anchors are in no record, so its recorded motion carries them.
            let motion = recorded(unit, next) * recorded(unit, frame).inverse();
            (unit, anchors.map(|(_, anchor)| (motion * anchor.cast::<f64>()).coords))
        });
        let expected = expected.collect();
        let before = bonds(&replay.world);
        layers.clear();
        replay.world.step_traced(layers).map_err(|source| RolloutError::Step {
            scene: scene.name().into(),
            frame: next,
            source,
        })?;
        let moved = free_anchors(&replay.world);
        let found = moved
            .map(|(unit, anchors)| (unit, anchors.map(|(_, anchor)| anchor.coords.cast::<f64>())));
        let after = bonds(&replay.world);
        let bonds = before.iter().zip(after);
        let bonds = bonds.map(|((pair, held), (_, holds))| (*pair, [*held, holds])).collect();
        Ok(Step { expected, found: found.collect(), bonds })
    }
}

/// All bonds, as numbers of units, and whether they hold.
fn bonds(world: &World) -> Vec<([usize; 2], bool)> {
    let simulator = world.simulator();
    let number = |id| simulator.number(id).unwrap_or(usize::MAX);
    simulator.bonds().map(|bond| (bond.units.map(number), bond.holds)).collect()
}

/// Numbers of the free units and world positions of their anchors; of soft units each with its number among the unit's points, else
/// with 0.
fn free_anchors(world: &World) -> impl Iterator<Item = (usize, [(usize, Point3<f32>); ANCHORS])> {
    let units = world.simulator().units().enumerate();
    units.filter(|(_, unit)| unit.role() == Role::Free).map(|(number, unit)| {
        let mut anchors = [(0, Point3::origin()); ANCHORS];
        // Points are kept in farthest-point order, which begins with the anchors.
        if unit.is_soft() {
            for (slot, point) in anchors.iter_mut().zip(unit.soft_points()) {
                *slot = point;
            }
        } else {
            for ((_, slot), point) in anchors.iter_mut().zip(unit.points()) {
                *slot = point;
            }
        }
        (number, anchors)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn step(bonds: &[([usize; 2], [bool; 2])]) -> Step {
        Step { expected: Vec::new(), found: Vec::new(), bonds: bonds.to_vec() }
    }

    #[test]
    fn clusters_of_bonds_that_one_model_breaks_are_left_out() {
        // Units 0, 1, 2 hold together, 3 and 4 too; 5 was apart before.
        let held = |a, b, after| ([a, b], [true, after]);
        let broken = ([4, 5], [false, false]);
        let float = step(&[held(1, 0, true), held(1, 2, true), held(3, 4, false), broken]);
        let other = step(&[held(1, 0, true), held(1, 2, false), held(3, 4, false), broken]);
        let mut sums = Sums::default();
        assert_eq!(sums.add_bonds(6, &float, &other), BTreeSet::from([0, 1, 2]));
        assert_eq!(sums.add_bonds(6, &float, &float), BTreeSet::new());
        assert_eq!((sums.bonds, sums.bonds_apart), (6, 1));
        let mut all = Sums::default();
        all.add(&sums);
        all.add(&sums);
        let bonds = all.one_step().bonds.unwrap();
        assert_eq!((bonds.held, bonds.apart), (12, 2));
        assert_eq!(Sums::default().one_step().bonds, None);
    }
}
