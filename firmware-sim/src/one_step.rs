//! Single steps of both models from the same recorded states: anchors and layers.

use std::collections::BTreeMap;
use std::sync::atomic::Ordering;

use nalgebra::{Isometry3, Point3, Vector3};
use rigidformer_runtime::core::{ANCHORS, Layer, Role};
use rigidformer_runtime::engine::Engine;
use rigidformer_runtime::evaluation::LAST_FRAME;
use rigidformer_runtime::rollout::{Progress, Replay, RolloutError};
use rigidformer_runtime::scenes::RecordedScene;
use rigidformer_runtime::world::World;

use crate::drift::spread;
use crate::pair::Pair;
use crate::report::{LayerNoise, OneStep};
use crate::trace::{Content, Gathering, Part};

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
        self.ratios.extend(&other.ratios);
        for (layer, (signal, noise)) in &other.layers {
            let sums = self.layers.entry(*layer).or_default();
            *sums = (sums.0 + signal, sums.1 + noise);
        }
    }

    pub(crate) fn one_step(&self) -> OneStep {
        let rms = |sum: f64, units: u64| (sum / (units.max(1) as f64 * ANCHORS as f64)).sqrt();
        let ratio = |sums: &Anchors| {
            // Without a difference there is none, however good the float model is.
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

    fn add_layers(&mut self, float: &[Part], quantised: &[Part]) {
        // Positions are what `one_step` measures.
        let of_network = |part: &Part| part.content < Content::Layer(Layer::Advanced);
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
    // On one thread: scenes are on threads of their own.
    let engine = Engine::new()?.single();
    let mut float = Replay::new(engine, models.float, scene)?;
    let mut quantised = Replay::new(engine, models.quantised, scene)?;
    let mut layers =
        (Gathering::new(models.float.model()), Gathering::new(models.quantised.model()));
    for frame in frames(step, every) {
        if progress.cancelled.load(Ordering::Relaxed) {
            return Err(RolloutError::Cancelled);
        }
        let state = State { scene, step, frame };
        let (expected, a) = state.advance(&mut float, &mut layers.0)?;
        let (_, b) = state.advance(&mut quantised, &mut layers.1)?;
        for ((expected, a), b) in expected.iter().zip(&a).zip(&b) {
            sums.add_unit(expected, a, b);
        }
        sums.add_layers(&layers.0.parts, &layers.1.parts);
        (progress.stepped)();
    }
    Ok(sums)
}

type UnitAnchors = [Vector3<f64>; ANCHORS];

impl Sums {
    fn add_unit(&mut self, truth: &UnitAnchors, float: &UnitAnchors, quantised: &UnitAnchors) {
        let squared = |a: &UnitAnchors, b: &UnitAnchors| -> f64 {
            a.iter().zip(b).map(|(a, b)| (a - b).norm_squared()).sum()
        };
        let (difference, error) = (squared(float, quantised), squared(float, truth));
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
    /// Where the record has the anchors of free units a step later, and where the model puts them.
    fn advance(
        &self,
        replay: &mut Replay<'_>,
        layers: &mut Gathering,
    ) -> Result<(Vec<UnitAnchors>, Vec<UnitAnchors>), RolloutError> {
        let Self { scene, step, frame } = *self;
        let next = frame.saturating_add(step);
        replay.observe(step, frame)?;
        replay.command(frame, step)?;
        let recorded = |unit: usize, frame: u32| -> Isometry3<f64> {
            scene.pose(frame as usize, unit).copied().unwrap_or_default().cast()
        };
        let expected = free_anchors(&replay.world).map(|(unit, anchors)| {
            let soft = scene.units().get(unit).and_then(|unit| unit.soft.as_ref());
            if let Some(points) = soft.and_then(|frames| frames.get(next as usize)) {
                let truth = |number: usize| points.get(number).copied().unwrap_or_default();
                return anchors.map(|(number, _)| truth(number).coords.cast::<f64>());
            }
            let onward = recorded(unit, next) * recorded(unit, frame).inverse();
            anchors.map(|(_, anchor)| (onward * anchor.cast::<f64>()).coords)
        });
        let expected = expected.collect();
        layers.clear();
        replay.world.step_traced(layers).map_err(|source| RolloutError::Step {
            scene: scene.name().into(),
            frame: next,
            source,
        })?;
        let places = free_anchors(&replay.world);
        let places =
            places.map(|(_, anchors)| anchors.map(|(_, anchor)| anchor.coords.cast::<f64>()));
        Ok((expected, places.collect()))
    }
}

/// Numbers of the free units and world positions of their anchors; of soft units each with its number among the unit's points, else
/// with 0.
fn free_anchors(world: &World) -> impl Iterator<Item = (usize, [(usize, Point3<f32>); ANCHORS])> {
    let units = world.simulator().units().enumerate();
    units.filter(|(_, unit)| unit.role() == Role::Free).map(|(number, unit)| {
        let mut anchors = [(0, Point3::origin()); ANCHORS];
        // The farthest-point order, in which points are kept, begins with the anchors.
        if unit.is_soft() {
            for (slot, place) in anchors.iter_mut().zip(unit.places()) {
                *slot = place;
            }
        } else {
            for ((_, slot), point) in anchors.iter_mut().zip(unit.points()) {
                *slot = point;
            }
        }
        (number, anchors)
    })
}
