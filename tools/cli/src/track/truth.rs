//! Scores against what truly happened.

use std::collections::BTreeMap;
use std::sync::Arc;

use nalgebra::{Isometry3, Matrix6, Vector6};
use rigidformer_core::{Compliance, Limits, Plane, Posed, Role};
use rigidformer_evaluation::scenes::{Dataset, RecordedScene};
use rigidformer_evaluation::score::{Prediction, Score, Seen, Settings, score};
use rigidformer_perception::capture::Capture;
use rigidformer_perception::estimate::{Estimate, Rest, UnitEstimate, Visibility};
use rigidformer_perception::tracker::{TrackerOptions, volume_m3};
use rigidformer_runtime::models::LoadedModel;
use rigidformer_runtime::world::World;

use super::followed::{Followed, SCORED_S};
use super::source::Source;
use crate::arguments::Track;

/// Steps of a prediction that is scored, as the tracker takes them.
const STEPS: usize = 10;

/// Scores of the tracker, and of the same model that was told the truth.
pub(super) struct Scores {
    pub(super) tracker: Score,
    /// True poses and points; true masses, frictions and restitutions.
    pub(super) told: Score,
    /// True poses and points; masses, frictions and restitutions as the tracker takes them to be.
    pub(super) told_poses: Score,
}

pub(super) struct Truth {
    scene: RecordedScene,
    seen: Vec<Seen>,
    /// Whether all captures so far had labels.
    labelled: bool,
}

impl Truth {
    pub(super) fn open(arguments: &Track, source: &mut Source) -> anyhow::Result<Option<Truth>> {
        let scene = match (&arguments.truth, source.scene()) {
            (Some(path), _) => Dataset::open(path)?.scene(arguments.index, None)?,
            (None, Some(scene)) => scene.clone(),
            (None, None) => return Ok(None),
        };
        Ok(Some(Truth { scene, seen: Vec::new(), labelled: true }))
    }

    pub(super) fn scene(&self) -> &RecordedScene {
        &self.scene
    }

    /// Counts the pixels that show each unit.
    pub(super) fn see(&mut self, capture: &Capture) {
        match Seen::of(capture, self.scene.units().len()) {
            Some(seen) => self.seen.push(seen),
            None => self.labelled = false,
        }
    }

    pub(super) fn scores(
        &self,
        options: &TrackerOptions,
        followed: &Followed,
    ) -> anyhow::Result<Scores> {
        let seen: &[Seen] = if self.labelled { &self.seen } else { &[] };
        let settings = Settings::default();
        let tracker =
            score(&self.scene, seen, &followed.estimates, &followed.predictions, &settings)?;
        // The model that is told the truth predicts the same units at the same times.
        let mut unit_of: BTreeMap<u32, usize> = BTreeMap::new();
        for unit in &tracker.by_unit {
            unit_of.extend(unit.tracks.iter().map(|id| (*id, unit.unit)));
        }
        let mut wanted: BTreeMap<u64, (f64, Vec<usize>)> = BTreeMap::new();
        for prediction in &followed.predictions {
            let units = prediction.poses.iter().filter_map(|(id, _)| unit_of.get(id).copied());
            let key = prediction.made_at_s.to_bits();
            wanted.insert(key, (prediction.made_at_s, units.collect()));
        }
        let tracks: Vec<Estimate> =
            followed.estimates.iter().filter_map(|estimate| self.exact(estimate.time_s)).collect();
        let told = |physics: Option<&TrackerOptions>| -> anyhow::Result<Score> {
            let mut predictions = Vec::new();
            if let Some(model) = &options.model {
                let mut world = self.world(model, physics)?;
                world.set_network(options.network);
                for (made_at_s, units) in wanted.values() {
                    predictions.extend(self.predict(&mut world, physics, *made_at_s, units)?);
                }
            }
            Ok(score(&self.scene, &[], &tracks, &predictions, &settings)?)
        };
        Ok(Scores { told: told(None)?, told_poses: told(Some(options))?, tracker })
    }

    /// The truth as an estimate.
    fn exact(&self, time_s: f64) -> Option<Estimate> {
        let units = self.scene.units().iter().enumerate().map(|(number, unit)| {
            Some(UnitEstimate {
                id: number as u32,
                pose: self.scene.pose_at(time_s, number)?,
                covariance: Matrix6::zeros(),
                velocity: Vector6::zeros(),
                velocity_covariance: Matrix6::zeros(),
                points: Arc::from(unit.points.as_slice()),
                visibility: Visibility::Seen,
                rest: Rest::Moving,
            })
        });
        Some(Estimate { time_s, units: units.collect::<Option<_>>()? })
    }

    fn world(
        &self,
        model: &LoadedModel,
        physics: Option<&TrackerOptions>,
    ) -> anyhow::Result<World> {
        let units = self.scene.units();
        let points = units.iter().map(|unit| unit.as_unit().room()).sum();
        let mut world = World::new(model, Limits { units: units.len(), points })?;
        world.set_gravity(self.scene.gravity_m_s2())?;
        if physics.is_none() {
            world.set_contact_law(self.scene.contact_law())?;
        }
        world.set_height_field(self.scene.height_field())?;
        if let Some(planes) = self.scene.planes() {
            let planes: Vec<Plane> = planes
                .iter()
                .map(|plane| match physics {
                    None => *plane,
                    Some(options) => {
                        let [friction, restitution] = options.plane_physics;
                        Plane { friction, restitution, ..*plane }
                    }
                })
                .collect();
            world.set_planes(&planes)?;
            if physics.is_none() {
                let mut all = self.scene.plane_compliance().iter().enumerate();
                world.edit(|simulator| {
                    all.try_for_each(|(plane, own)| simulator.set_plane_compliance(plane, *own))
                })?;
            }
        }
        Ok(world)
    }

    /// Predictions of the model from true poses at a time and a step before.
    fn predict(
        &self,
        world: &mut World,
        physics: Option<&TrackerOptions>,
        made_at_s: f64,
        wanted: &[usize],
    ) -> anyhow::Result<Vec<Prediction>> {
        let step_s = SCORED_S / STEPS as f64;
        let at = |time_s: f64| -> Option<Vec<Isometry3<f32>>> {
            (0..self.scene.units().len()).map(|unit| self.scene.pose_at(time_s, unit)).collect()
        };
        let (Some(before), Some(now)) = (at(made_at_s - step_s), at(made_at_s)) else {
            return Ok(Vec::new());
        };
        let units = self.scene.units().iter().zip(before.iter().zip(&now));
        let posed = units.map(|(unit, (before, now))| {
            let mut own = unit.as_unit();
            if let Some(options) = physics {
                own.physics = options.physics_of(volume_m3(&unit.points));
                own.inertia_kg_m2 = None;
                own.compliance = Compliance::RIGID;
            }
            own.role = if own.role == Role::Driven { Role::Free } else { own.role };
            Posed { unit: own, previous: *before, current: *now }
        });
        world.edit(|simulator| simulator.observe_poses(step_s as f32, posed))?;
        let mut predictions = Vec::new();
        for step in 1..=STEPS {
            world.step()?;
            if step != STEPS && 2 * step != STEPS {
                continue;
            }
            let poses = world.simulator().units().enumerate();
            let poses = poses.filter(|(number, _)| wanted.contains(number));
            predictions.push(Prediction {
                made_at_s,
                time_s: made_at_s + step_s * step as f64,
                poses: poses.map(|(number, unit)| (number as u32, unit.pose())).collect(),
            });
        }
        Ok(predictions)
    }
}
