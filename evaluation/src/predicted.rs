//! All that a rollout of a recorded scene predicts, and that as a scene.

use nalgebra::Point3;
use rigidformer_core::Role;
use rigidformer_core::kernels::in_own_environment;
use rigidformer_runtime::engine::Engine;
use rigidformer_runtime::models::LoadedModel;
use rigidformer_runtime::progress::Progress;

use crate::rollout::{RolloutError, Trajectory, on_all_threads, rollout_seen};
use crate::scenes::{RecordedBond, RecordedScene, RecordedUnit, SceneError, clusters};

/// Points of all soft units of a scene at evenly spaced frames.
#[derive(Clone, Debug, PartialEq)]
pub struct PointTrajectory {
    /// Frame of the first sample.
    pub first_frame: u32,
    /// Frames between samples, at least 1.
    pub step: u32,
    /// (samples, points) In the order of the scene's soft units and of their points, metres.
    pub samples: Vec<Vec<Point3<f32>>>,
}

impl PointTrajectory {
    /// The points at a frame, if that is one of a sample.
    pub fn at(&self, frame: u32) -> Option<&[Point3<f32>]> {
        let since = frame.checked_sub(self.first_frame)?;
        let sample = (since / self.step.max(1)) as usize;
        let points = self.samples.get(sample)?;
        since.is_multiple_of(self.step.max(1)).then_some(points)
    }

    /// The points at a frame; between samples on the straight lines from one to the next. `None` outside the trajectory.
    pub fn between(&self, frame: u32) -> Option<Vec<Point3<f32>>> {
        let since = frame.checked_sub(self.first_frame)?;
        // The fields are public, so a step of 0 may come from outside.
        let (sample, rest) = ((since / self.step.max(1)) as usize, since % self.step.max(1));
        let before = self.samples.get(sample)?;
        if rest == 0 {
            return Some(before.clone());
        }
        let after = self.samples.get(sample + 1)?;
        let share = in_own_environment(|| rest as f32 / self.step as f32);
        let points = before.iter().zip(after).map(|(a, b)| a + (b - a) * share);
        Some(in_own_environment(|| points.collect()))
    }
}

/// Recorded points of all soft units at a frame; `None` where it is not recorded.
pub fn recorded(scene: &RecordedScene, frame: usize) -> Option<Vec<Point3<f32>>> {
    let mut all = Vec::new();
    for frames in scene.units().iter().filter_map(|unit| unit.soft.as_ref()) {
        all.extend_from_slice(frames.get(frame)?);
    }
    Some(all)
}

/// What a rollout predicts of a scene.
#[derive(Clone, Debug, PartialEq)]
pub struct Predicted {
    /// Poses of all units; of soft ones, the rigid poses that fit their points best.
    pub poses: Trajectory,
    /// Points of the soft units, at the same frames; `None` in a scene without soft units.
    pub points: Option<PointTrajectory>,
    /// (samples, bonds) Whether the scene's bonds hold, at the same frames. Empty where the rollout held none: the scene has none, or
    /// the model cannot.
    pub holding: Vec<Vec<bool>>,
}

/// Rolls one scene out as [`rollout_on`](crate::rollout::rollout_on) does, and keeps the points of its soft units and its bonds.
///
/// # Errors
/// As [`rollout_on`](crate::rollout::rollout_on).
pub fn predict(
    engine: Engine,
    model: &LoadedModel,
    scene: &RecordedScene,
    step: u32,
    last_frame: u32,
    progress: Progress<'_>,
) -> Result<Predicted, RolloutError> {
    let observed = [0, step as usize].map(|frame| recorded(scene, frame).unwrap_or_default());
    let (mut samples, mut holding) = (Vec::from(observed), Vec::new());
    let mut steps = 0u64;
    let holds_at = |frame: usize| scene.bonds().iter().map(|bond| bond.holds(frame)).collect();
    let poses = rollout_seen(engine, model, scene, step, last_frame, progress, &mut |replay| {
        // The first call comes after both frames are observed, and frame 0 needs a sample as well.
        match (replay.holding(), holding.is_empty()) {
            (Some(now), true) => holding.extend([holds_at(0), now]),
            (Some(now), false) => holding.push(now),
            (None, _) => {}
        }
        // Samples begin with both observed frames.
        if steps > 0 {
            samples.push(replay.soft_points());
        }
        steps += 1;
    })?;
    // No soft unit differs from soft units without points.
    let is_soft = scene.units().iter().any(|unit| unit.soft.is_some());
    let points = is_soft.then_some(PointTrajectory { first_frame: 0, step, samples });
    Ok(Predicted { poses, points, holding })
}

/// As [`predict`], of scenes on all threads; the results are in the order of the scenes and do not depend on the threads.
///
/// # Errors
/// That of the first scene, in that order, that has one.
pub fn predict_many(
    model: &LoadedModel,
    scenes: &[RecordedScene],
    step: u32,
    last_frame: u32,
    progress: Progress<'_>,
) -> Result<Vec<Predicted>, RolloutError> {
    on_all_threads(scenes, |engine, scene| {
        predict(engine, model, scene, step, last_frame, progress)
    })
}

impl Predicted {
    /// (units) Which units hang together at a frame, as [`clusters`] says: through bonds that hold in the rollout, or, where the
    /// rollout has no bonds, in the record. Between samples those of the sample before count.
    pub fn clusters_at(&self, scene: &RecordedScene, frame: u32) -> Vec<usize> {
        let since = frame.saturating_sub(self.poses.first_frame()) / self.poses.step();
        match self.holding.get(since as usize) {
            // A rollout that holds no bonds follows the record's, which it is drawn beside.
            None => scene.clusters_at(frame as usize),
            Some(holding) => {
                let held = scene.bonds().iter().zip(holding).filter(|(_, holds)| **holds);
                clusters(scene.units().len(), held.map(|(bond, _)| bond.units))
            }
        }
    }

    /// The rollout as a scene of its own, which [`write_scene`](crate::scenes::write_scene) writes: a frame a sample, the two observed ones first.
    /// Shapes, planes, meshes and what units are made of are those of the scene; commands and velocities are left out.
    ///
    /// # Errors
    /// [`SceneError`] where a prediction is not finite.
    pub fn as_scene(&self, scene: &RecordedScene) -> Result<RecordedScene, SceneError> {
        let mut start = 0;
        let mut units = Vec::with_capacity(scene.units().len());
        for (number, unit) in scene.units().iter().enumerate() {
            let own = start..start + unit.points.len();
            let soft = self.points.as_ref().filter(|_| unit.soft.is_some()).map(|points| {
                start = own.end;
                let of = |sample: &Vec<Point3<f32>>| {
                    sample.get(own.clone()).unwrap_or_default().to_vec()
                };
                points.samples.iter().map(of).collect::<Vec<_>>()
            });
            // Files demand that every pose of a fixed unit equals the first to the bit.
            let still = unit.poses.first().filter(|_| unit.role == Role::Fixed);
            let pose = |(_, poses): (u32, &[_])| still.or(poses.get(number)).copied();
            let poses = self.poses.iter().filter_map(pose).collect();
            // Velocities are those of the record's frame 0, which a prediction does not have.
            units.push(RecordedUnit { poses, soft, velocity: None, ..unit.clone() });
        }
        // A frame a sample: the samples are `step` frames apart.
        let rate = scene.frame_rate_hz() / self.poses.step() as f32;
        let (name, gravity) = (scene.name(), scene.gravity_m_s2());
        let made = RecordedScene::new(name, scene.seed(), scene.split(), rate, gravity, units)?;
        let made = made.with_mesh(scene.mesh().clone())?.with_bonds(self.bonds(scene))?;
        let made = made.with_contact_law(scene.contact_law())?;
        let made = made.with_height_field(scene.height_field().cloned())?;
        match scene.planes() {
            Some(planes) => made
                .with_planes(planes.to_vec())?
                .with_plane_compliance(scene.plane_compliance().to_vec()),
            None => Ok(made),
        }
    }

    /// The scene's bonds, broken from the first sample on in which they do not hold.
    fn bonds(&self, scene: &RecordedScene) -> Vec<RecordedBond> {
        let breaks = |(number, bond): (usize, &RecordedBond)| {
            let breaks_at = match self.holding.is_empty() {
                // Rounded up: at the sample before, the bond still holds.
                true => bond.breaks_at.map(|frame| frame.div_ceil(self.poses.step() as usize)),
                false => self.holding.iter().position(|holds| holds.get(number) == Some(&false)),
            };
            RecordedBond { breaks_at, ..*bond }
        };
        scene.bonds().iter().enumerate().map(breaks).collect()
    }
}
