//! The network as motion model of the tracker.

use nalgebra::{Isometry3, Point3, Translation3, UnitQuaternion, Vector3};
use rigidformer_core::{
    EditError, Limits, ObserveError, Physics, Pieces, Plane, Posed, Role, StepError, Unit,
};
use rigidformer_runtime::engine::Engine;
use rigidformer_runtime::models::LoadedModel;
use rigidformer_runtime::world::{World, WorldError};

/// Difference between the gain of velocity in a step and gravity's, in the latter, from which a unit is supported.
const MIN_SUPPORTED_DIFFERENCE: f32 = 0.3;

/// State of a unit before the first step.
#[derive(Clone, Copy, Debug)]
pub(super) struct MovingUnit<'u> {
    pub(super) points: &'u [Point3<f32>],
    pub(super) pieces: Pieces<'u>,
    pub(super) physics: Physics,
    /// Principal moments, where they are known.
    pub(super) inertia_kg_m2: Option<[f32; 3]>,
    pub(super) pose: Isometry3<f32>,
    /// Of the unit's centre, m/s.
    pub(super) linear: Vector3<f32>,
    /// rad/s
    pub(super) angular: Vector3<f32>,
    /// In the unit's frame.
    pub(super) centre: Point3<f32>,
    /// Mean velocity over the simulator's last step less the velocity now, over the step's duration, m/s^2. It is half of gravity upwards for
    /// a unit in free flight, and about 0 for a unit at rest.
    pub(super) velocity_lag_m_s2: Vector3<f32>,
    /// Whether it is held still: it rests, and nothing is seen to carry it.
    pub(super) is_held: bool,
}

/// State of a unit after a step.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct PredictedUnit {
    pub(super) pose: Isometry3<f32>,
    pub(super) linear: Vector3<f32>,
    pub(super) angular: Vector3<f32>,
    /// As [`MovingUnit::velocity_lag_m_s2`], for the next step.
    pub(super) velocity_lag_m_s2: Vector3<f32>,
}

/// Why nothing was predicted.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum ForecastError {
    /// There is no world for so many units.
    #[error(transparent)]
    World(#[from] WorldError),
    /// The model refused the units.
    #[error(transparent)]
    Observe(#[from] ObserveError),
    /// The model refused planes or gravity.
    #[error(transparent)]
    Edit(#[from] EditError),
    /// A step was refused.
    #[error(transparent)]
    Step(#[from] StepError),
}

/// A world that is reused for one scene after the other.
pub(super) struct Forecaster {
    engine: Engine,
    model: LoadedModel,
    /// Whether the network corrects motion.
    network: bool,
    world: Option<World>,
    limits: Limits,
}

impl Forecaster {
    pub(super) fn new(engine: Engine, model: LoadedModel, network: bool) -> Self {
        Forecaster { engine, model, network, world: None, limits: Limits { units: 0, points: 0 } }
    }

    /// Predicts `steps` steps of `dt_s`; (steps, units).
    pub(super) fn steps(
        &mut self,
        units: &[MovingUnit<'_>],
        planes: &[Plane],
        gravity: &Vector3<f32>,
        dt_s: f32,
        steps: usize,
    ) -> Result<Vec<Vec<PredictedUnit>>, ForecastError> {
        // A world needs a unit.
        if units.is_empty() {
            return Ok(vec![Vec::new(); steps]);
        }
        let points = units.iter().map(|unit| unit.as_unit().room()).sum();
        let engine = self.engine;
        let world = self.world(units.len(), points)?;
        world.set_planes(planes)?;
        world.set_gravity(*gravity)?;
        let posed = units.iter().map(|unit| {
            let role = if unit.is_held { Role::Fixed } else { Role::Free };
            Posed {
                unit: Unit { role, ..unit.as_unit() },
                previous: if unit.is_held { unit.pose } else { unit.previous_pose(dt_s) },
                current: unit.pose,
            }
        });
        world.edit(|simulator| simulator.observe_poses(dt_s, posed))?;
        engine.enter(|| {
            let mut all: Vec<Vec<PredictedUnit>> = Vec::with_capacity(steps);
            for _ in 0..steps {
                world.step()?;
                let views = world.simulator().units().zip(units).enumerate();
                let moved = views.map(|(number, (view, unit))| {
                    let last = all.last().and_then(|moved| moved.get(number));
                    let start =
                        last.map_or((unit.pose, unit.linear), |last| (last.pose, last.linear));
                    unit.after_step(start, [view.previous_pose(), view.pose()], gravity, dt_s)
                });
                let moved = moved.collect();
                all.push(moved);
            }
            Ok(all)
        })
    }

    /// A world with enough room: the present one if it suffices.
    fn world(&mut self, units: usize, points: usize) -> Result<&mut World, WorldError> {
        let Limits { units: most, points: most_points } = self.limits;
        if units > most || points > most_points {
            // The old world's memory is freed before the larger one is allocated.
            self.world = None;
            // Twice the need, so that one more unit needs no new world.
            self.limits = Limits { units: (2 * units).max(8), points: (2 * points).max(512) };
        }
        match self.world.take() {
            Some(world) => Ok(self.world.insert(world)),
            None => {
                let mut world = World::on(self.engine, &self.model, self.limits, 1)?;
                world.set_network(self.network);
                Ok(self.world.insert(world))
            }
        }
    }
}

impl MovingUnit<'_> {
    fn as_unit(&self) -> Unit<'_> {
        Unit {
            inertia_kg_m2: self.inertia_kg_m2,
            ..Unit::new(self.points, self.physics).pieces(self.pieces)
        }
    }

    /// The pose of a step ago that gives a simulator this velocity.
    fn previous_pose(&self, dt_s: f32) -> Isometry3<f32> {
        let back = UnitQuaternion::from_scaled_axis(self.angular * -dt_s);
        let centre = self.pose * self.centre;
        let rotation = back * self.pose.rotation;
        let way = (self.linear + self.velocity_lag_m_s2 * dt_s) * dt_s;
        let place = centre.coords - way - rotation * self.centre.coords;
        Isometry3::from_parts(Translation3::from(place), rotation)
    }

    /// State after a step. `previous` is the simulator's pose of a step ago for its motion at the end: under gravity the difference is the
    /// velocity of half a step ago.
    fn after_step(
        &self,
        (start, linear): (Isometry3<f32>, Vector3<f32>),
        [previous, pose]: [Isometry3<f32>; 2],
        gravity: &Vector3<f32>,
        dt_s: f32,
    ) -> PredictedUnit {
        if self.is_held {
            let still = Vector3::zeros();
            let pose = self.pose;
            return PredictedUnit { pose, linear: still, angular: still, velocity_lag_m_s2: still };
        }
        let [before, late, now] = [start, previous, pose].map(|pose| pose * self.centre);
        let (mean, late) = ((now - before) / dt_s, (now - late) / dt_s);
        let angular = (pose.rotation * previous.rotation.inverse()).scaled_axis() / dt_s;
        let gain = gravity * dt_s;
        let falling = late + gain * 0.5;
        let flies = (falling - linear - gain).norm() < MIN_SUPPORTED_DIFFERENCE * gain.norm();
        // A slow unit that does not fall is supported, and its mean velocity is its velocity.
        let linear = if flies || mean.norm() > gain.norm() { falling } else { mean };
        PredictedUnit { pose, linear, angular, velocity_lag_m_s2: (late - linear) / dt_s }
    }
}
