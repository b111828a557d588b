//! Figures of a predictor over scenes.

use rayon::prelude::*;
use rigidformer_runtime::engine::Engine;
use rigidformer_runtime::models::LoadedModel;
use rigidformer_runtime::progress::Progress;

use crate::free_fall;
use crate::metrics::{
    Apart, FrameErrors, Penetration, PenetrationProbe, apart, frame_errors, mean, rigidity,
};
use crate::pivots;
use crate::rollout::{RolloutError, Trajectory, rollout_on};
use crate::scenes::RecordedScene;

/// Frames that the published tables read.
pub const FRAMES: [u32; 3] = [50, 75, 100];
/// The last of [`FRAMES`].
pub const LAST_FRAME: u32 = 100;

/// The greatest step code that has figures: its first prediction is the first of [`FRAMES`]. Of a greater one, frames would be observed.
pub const GREATEST_STEP: u32 = FRAMES[0] / 2;

/// Figures of a predictor over scenes.
#[derive(Clone, Debug, PartialEq)]
pub struct Figures {
    /// Scenes that were averaged.
    pub scenes: usize,
    /// Errors at each of [`FRAMES`], means over scenes.
    pub errors: [FrameErrors; 3],
    /// Errors at each predicted frame to [`LAST_FRAME`], means over scenes.
    pub curve: Vec<(u32, FrameErrors)>,
    /// Largest relative change of a distance within a unit, over all scenes and frames.
    pub rigidity: f64,
    /// Deepest penetration of each scene over its predicted frames to 100, mean over scenes.
    pub penetration_mean: Penetration,
    /// The same, of the worst scene.
    pub penetration_max: Penetration,
    /// How far links of a body come apart at the predicted frames to 100, by pivots of all recorded frames
    /// ([`pivots::recorded`]); `None` where no body has several free parts.
    pub apart: Option<Apart>,
    /// Figures of each scene, in the order of the scenes.
    pub by_scene: Vec<SceneFigures>,
}

/// Figures of a predictor for one scene.
#[derive(Clone, Debug, PartialEq)]
pub struct SceneFigures {
    /// Errors at each of [`FRAMES`].
    pub errors: [FrameErrors; 3],
    /// Errors at each predicted frame to [`LAST_FRAME`].
    pub curve: Vec<(u32, FrameErrors)>,
    /// Largest relative change of a distance within a unit, over all frames.
    pub rigidity: f64,
    /// Deepest penetration over the predicted frames to 100.
    pub penetration: Penetration,
}

/// Figures of the model at a step code, scenes in parallel. Of one above [`GREATEST_STEP`] some are of frames that were observed.
pub fn model(
    model: &LoadedModel,
    scenes: &[RecordedScene],
    step: u32,
    progress: Progress<'_>,
) -> Result<Figures, RolloutError> {
    // Scenes run side by side already, so each takes one thread.
    let engine = Engine::new()?.single();
    figures(scenes, |scene| rollout_on(engine, model, scene, step, LAST_FRAME, progress))
}

/// Figures of free fall from frames 2 and 3, as in the published-split baseline.
pub fn free_falling(scenes: &[RecordedScene]) -> Result<Figures, RolloutError> {
    let (previous, current) = free_fall::TABLE_FRAMES;
    figures(scenes, |scene| {
        free_fall::trajectory(scene, previous, current, LAST_FRAME).ok_or_else(|| too_short(scene))
    })
}

/// Mean and maximum over scenes of how deep the record itself penetrates until frame 100, looked at every `step`
/// frames.
pub fn recorded_penetration(scenes: &[RecordedScene], step: u32) -> (Penetration, Penetration) {
    let deepest = |scene: &RecordedScene| {
        let frames = (0..=LAST_FRAME).step_by(step.max(1) as usize);
        // Short records end the look early instead of failing it.
        let poses = frames.map_while(|frame| scene.poses_at(frame as usize));
        let probe = PenetrationProbe::new(scene);
        poses.map(|poses| probe.measure(&poses)).fold(Penetration::default(), Penetration::max)
    };
    let depths: Vec<Penetration> = scenes.par_iter().map(deepest).collect();
    mean_and_max(&depths)
}

fn figures<P>(scenes: &[RecordedScene], predict: P) -> Result<Figures, RolloutError>
where
    P: Fn(&RecordedScene) -> Result<Trajectory, RolloutError> + Sync,
{
    let results: Vec<Result<(SceneFigures, Vec<f64>), RolloutError>> = scenes
        .par_iter()
        .map(|scene| {
            let predicted = predict(scene)?;
            let mut errors = [FrameErrors::default(); 3];
            for (errors, frame) in errors.iter_mut().zip(FRAMES) {
                *errors = frame_errors(&predicted, scene, frame).ok_or_else(|| too_short(scene))?;
            }
            let frames = predicted.iter().map(|(frame, _)| frame).take_while(|f| *f <= LAST_FRAME);
            let curve = frames.filter_map(|f| Some((f, frame_errors(&predicted, scene, f)?)));
            let curve = curve.collect();
            let probe = PenetrationProbe::new(scene);
            let sampled = predicted.iter().take_while(|(frame, _)| *frame <= LAST_FRAME);
            let penetration = sampled
                .map(|(_, poses)| probe.measure(poses))
                .fold(Penetration::default(), Penetration::max);
            // The first two samples are observed, where nothing can come apart.
            let first = predicted.step() + 1;
            let apart = apart(&predicted, &pivots::recorded(scene), first, LAST_FRAME);
            let rigidity = rigidity(&predicted, scene);
            Ok((SceneFigures { errors, curve, rigidity, penetration }, apart))
        })
        .collect();
    // The order of the scenes fixes the order of the sums, whatever the threads do.
    let (scenes, distances): (Vec<_>, Vec<_>) =
        results.into_iter().collect::<Result<Vec<_>, _>>()?.into_iter().unzip();
    let (penetration_mean, penetration_max) =
        mean_and_max(&scenes.iter().map(|scene| scene.penetration).collect::<Vec<_>>());
    let at =
        |frame: usize| mean(&scenes.iter().map(|scene| scene.errors[frame]).collect::<Vec<_>>());
    // All scenes have the same frames, and the shortest is safe in any case.
    let frames = scenes.iter().map(|scene| scene.curve.len()).min().unwrap_or_default();
    let curve = (0..frames).filter_map(|i| {
        let (frame, _) = scenes.first()?.curve[i];
        Some((frame, mean(&scenes.iter().map(|scene| scene.curve[i].1).collect::<Vec<_>>())))
    });
    Ok(Figures {
        scenes: scenes.len(),
        curve: curve.collect(),
        errors: [at(0), at(1), at(2)],
        rigidity: scenes.iter().map(|scene| scene.rigidity).fold(0.0, f64::max),
        penetration_mean,
        penetration_max,
        apart: Apart::of(distances.concat()),
        by_scene: scenes,
    })
}

fn too_short(scene: &RecordedScene) -> RolloutError {
    RolloutError::TooFewFrames {
        scene: scene.name().into(),
        step: LAST_FRAME,
        recorded: scene.frames(),
    }
}

fn mean_and_max(depths: &[Penetration]) -> (Penetration, Penetration) {
    // No scenes have a mean of 0, not of NaN.
    let count = depths.len().max(1) as f64;
    let of = |depth: fn(&Penetration) -> f64| depths.iter().map(depth).sum::<f64>() / count;
    let mean =
        Penetration { ground_m: of(|depth| depth.ground_m), units_m: of(|depth| depth.units_m) };
    (mean, depths.iter().copied().fold(Penetration::default(), Penetration::max))
}
