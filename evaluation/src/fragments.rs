//! How well rollouts of bonded units, such as the pieces of a body that breaks, agree with records: where pieces are, and which bonds are
//! broken in the end.

use nalgebra::{Isometry3, Matrix3, Point3, Vector3};
use rigidformer_core::Role;
use rigidformer_core::geometry::kabsch_f64;
use rigidformer_runtime::models::LoadedModel;
use rigidformer_runtime::poses::free_fall;
use rigidformer_runtime::progress::Progress;

use crate::predicted::predict_many;
use crate::rollout::{RolloutError, Trajectory};
use crate::scenes::{RecordedScene, SceneError};
use crate::soft::{FRAMES, LAST_FRAME, vertex_error_m};

/// What a model is measured beside.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Baseline {
    /// All pieces stay where they were last seen.
    Still,
    /// Each piece falls freely on, with the velocity and the turn between the two frames seen.
    FreeFall,
    /// The rigid motion of the whole body that is nearest to what was recorded, frame by frame. It is told the truth: no prediction in
    /// which the body stays whole can be better.
    BestRigid,
}

impl Baseline {
    /// All of them.
    pub const ALL: [Baseline; 3] = [Baseline::Still, Baseline::FreeFall, Baseline::BestRigid];

    /// As tables call it.
    pub fn name(self) -> &'static str {
        match self {
            Baseline::Still => "still",
            Baseline::FreeFall => "free fall",
            Baseline::BestRigid => "best rigid motion (told the truth)",
        }
    }

    /// Poses of all units at a frame, seen at frames 0 and `step`; `None` where frames are not recorded.
    pub fn poses(
        self,
        scene: &RecordedScene,
        step: u32,
        frame: u32,
    ) -> Option<Vec<Isometry3<f32>>> {
        let (before, now) = (scene.poses_at(0)?, scene.poses_at(step as usize)?);
        match self {
            Baseline::Still => Some(now),
            Baseline::FreeFall => {
                let gap_s = f64::from(step) / f64::from(scene.frame_rate_hz());
                let gaps = (f64::from(frame) - f64::from(step)) / f64::from(step);
                let gravity = scene.gravity_m_s2();
                let falls = |(a, b)| free_fall(a, b, &gravity, gap_s, gaps);
                Some(before.iter().zip(&now).map(falls).collect())
            }
            Baseline::BestRigid => {
                let truth = scene.poses_at(frame as usize)?;
                let (from, to) = (points(scene, &now), points(scene, &truth));
                let pairs = from.iter().zip(&to).map(|(a, b)| (&a.coords, &b.coords));
                // One motion for all pieces is what a body that never breaks could do at best.
                let motion = kabsch_f64(pairs, &Matrix3::identity()).pose;
                let motion = motion.isometry(&Point3::origin());
                Some(now.iter().map(|pose| motion * pose).collect())
            }
        }
    }
}

/// Errors of a predictor at a frame, means over scenes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PieceErrors {
    /// Frame after the last one observed.
    pub frame: u32,
    /// Mean distance of the pieces' points from where they were recorded, metres.
    pub vertex_m: f64,
    /// That, as a share of the body's [size](size_m).
    pub vertex_share: f64,
    /// Mean distance of the pieces' origins, metres.
    pub position_m: f64,
    /// Mean angle between the pieces' rotations, degrees.
    pub orientation_deg: f64,
    /// Scenes that were recorded to that frame.
    pub scenes: usize,
}

/// How many bonds of all scenes are broken at the last predicted frame, in the rollouts and in the record.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct BrokenBonds {
    /// In both.
    pub both: usize,
    /// In the rollout alone.
    pub rollout: usize,
    /// In the record alone.
    pub record: usize,
    /// In neither.
    pub neither: usize,
}

impl BrokenBonds {
    /// Harmonic mean of precision and recall of what is broken; 1 where nothing is.
    pub fn f1(&self) -> f64 {
        f1(self.both, self.rollout + self.record)
    }

    /// The same of what holds.
    pub fn f1_of_holding(&self) -> f64 {
        f1(self.neither, self.rollout + self.record)
    }

    /// Broken in the record, of all that the rollout broke; 1 where it broke none.
    pub fn precision(&self) -> f64 {
        share(self.both, self.both + self.rollout)
    }

    /// Broken in the rollout, of all that are in the record; 1 where none are.
    pub fn recall(&self) -> f64 {
        share(self.both, self.both + self.record)
    }

    fn add(&mut self, rollout: bool, record: bool) {
        let count = match (rollout, record) {
            // Four counts, because precision and recall need all of them.
            (true, true) => &mut self.both,
            (true, false) => &mut self.rollout,
            (false, true) => &mut self.record,
            (false, false) => &mut self.neither,
        };
        *count += 1;
    }
}

fn share(count: usize, all: usize) -> f64 {
    // Nothing to find and nothing found is a perfect score, not 0 / 0.
    if all == 0 { 1.0 } else { count as f64 / all as f64 }
}

fn f1(right: usize, wrong: usize) -> f64 {
    share(2 * right, 2 * right + wrong)
}

/// Figures of a predictor over scenes.
#[derive(Clone, Debug, PartialEq)]
pub struct Figures {
    /// At each predicted frame to [`LAST_FRAME`] that a scene reaches.
    pub errors: Vec<PieceErrors>,
    /// Bonds at the end; `None` for what has none.
    pub bonds: Option<BrokenBonds>,
}

impl Figures {
    /// Errors at the frames of tables.
    pub fn at_frames(&self) -> [Option<PieceErrors>; 3] {
        FRAMES.map(|frame| self.errors.iter().find(|errors| errors.frame == frame).copied())
    }
}

/// Rolls all scenes out by a model, on all threads.
///
/// # Errors
/// The first scene's that has one.
pub fn model(
    model: &LoadedModel,
    scenes: &[RecordedScene],
    step: u32,
    progress: Progress<'_>,
) -> Result<Figures, RolloutError> {
    let all = predict_many(model, scenes, step, step.saturating_add(LAST_FRAME), progress)?;
    let mut bonds = BrokenBonds::default();
    for (scene, predicted) in scenes.iter().zip(&all) {
        // Bonds are compared at a frame that both the rollout and the record have.
        let end = (predicted.poses.last_frame() as usize).min(scene.frames().saturating_sub(1));
        let since = end as u32 / predicted.poses.step().max(1);
        let holding = predicted.holding.get(since as usize);
        for (number, bond) in scene.bonds().iter().enumerate() {
            // A rollout holds no bonds where all are broken before it begins.
            let holds = holding.is_some_and(|holding| holding.get(number) == Some(&true));
            bonds.add(!holds, !bond.holds(end));
        }
    }
    let poses: Vec<Trajectory> = all.into_iter().map(|predicted| predicted.poses).collect();
    let errors = errors(scenes, step, |index, frame| at(poses.get(index)?, frame));
    // Scenes without bonds have no such figure, rather than one of zeros.
    Ok(Figures { errors, bonds: (bonds != BrokenBonds::default()).then_some(bonds) })
}

/// The scenes with no bonds, and each piece a body of its own that touches the others: what a model of rigid bodies sees in them.
///
/// # Errors
/// [`SceneError`] never, for scenes that are sound.
pub fn separated(scenes: &[RecordedScene]) -> Result<Vec<RecordedScene>, SceneError> {
    scenes.iter().map(RecordedScene::separated).collect()
}

/// Figures of a baseline.
pub fn baseline(baseline: Baseline, scenes: &[RecordedScene], step: u32) -> Figures {
    let poses = |index: usize, frame| baseline.poses(scenes.get(index)?, step, frame);
    Figures { errors: errors(scenes, step, poses), bonds: None }
}

/// Which bonds would be broken in the end if a predictor broke all of them, or none.
pub fn all_broken(scenes: &[RecordedScene], step: u32, are_broken: bool) -> BrokenBonds {
    let mut bonds = BrokenBonds::default();
    for scene in scenes {
        // Rollouts end at the first multiple of the step that reaches the last frame.
        let last = (step.saturating_add(LAST_FRAME)).div_ceil(step.max(1)) * step.max(1);
        let end = (last as usize).min(scene.frames().saturating_sub(1));
        scene.bonds().iter().for_each(|bond| bonds.add(are_broken, !bond.holds(end)));
    }
    bonds
}

fn at(trajectory: &Trajectory, frame: u32) -> Option<Vec<Isometry3<f32>>> {
    trajectory.iter().find(|(other, _)| *other == frame).map(|(_, poses)| poses.to_vec())
}

/// Twice the greatest distance of a scene's free points from their mean at frame 0, metres: what shares are of.
pub fn size_m(scene: &RecordedScene) -> f64 {
    let all = scene.poses_at(0).map(|poses| points(scene, &poses)).unwrap_or_default();
    let sum = all.iter().fold(Vector3::<f64>::zeros(), |sum, p| sum + p.coords.cast::<f64>());
    // Shares are of the unbroken body, which frame 0 shows.
    let middle = sum / all.len().max(1) as f64;
    let far = all.iter().map(|point| (point.coords.cast::<f64>() - middle).norm());
    2.0 * far.fold(0.0, f64::max)
}

/// Points of all free units under poses of all units.
fn points(scene: &RecordedScene, poses: &[Isometry3<f32>]) -> Vec<Point3<f32>> {
    let units = scene.units().iter().zip(poses).filter(|(unit, _)| unit.role == Role::Free);
    units.flat_map(|(unit, pose)| unit.points.iter().map(move |point| pose * point)).collect()
}

fn errors(
    scenes: &[RecordedScene],
    step: u32,
    poses: impl Fn(usize, u32) -> Option<Vec<Isometry3<f32>>>,
) -> Vec<PieceErrors> {
    let mut all = Vec::new();
    for frame in (step..=LAST_FRAME).step_by(step.max(1) as usize) {
        let mut sum = PieceErrors {
            frame,
            vertex_m: 0.0,
            vertex_share: 0.0,
            position_m: 0.0,
            orientation_deg: 0.0,
            scenes: 0,
        };
        for (index, scene) in scenes.iter().enumerate() {
            let at = step.saturating_add(frame);
            let (Some(own), Some(truth)) = (poses(index, at), scene.poses_at(at as usize)) else {
                continue;
            };
            let Some(vertex_m) = vertex_error_m(&points(scene, &own), &points(scene, &truth))
            else {
                continue;
            };
            let free = scene.units().iter().map(|unit| unit.role == Role::Free);
            let pieces: Vec<_> =
                own.iter().zip(&truth).zip(free).filter(|(_, free)| *free).collect();
            // Each scene counts alike, however many pieces it has.
            let count = pieces.len().max(1) as f64;
            for ((a, b), _) in pieces {
                let way = a.translation.vector.cast::<f64>() - b.translation.vector.cast::<f64>();
                let turn = a.rotation.cast::<f64>().angle_to(&b.rotation.cast::<f64>());
                sum.position_m += way.norm() / count;
                sum.orientation_deg += turn.to_degrees() / count;
            }
            sum.vertex_m += vertex_m;
            sum.vertex_share += vertex_m / size_m(scene);
            sum.scenes += 1;
        }
        if sum.scenes > 0 {
            let n = sum.scenes as f64;
            all.push(PieceErrors {
                vertex_m: sum.vertex_m / n,
                vertex_share: sum.vertex_share / n,
                position_m: sum.position_m / n,
                orientation_deg: sum.orientation_deg / n,
                ..sum
            });
        }
    }
    all
}

#[cfg(test)]
mod tests {
    use super::BrokenBonds;

    #[test]
    fn f1_is_of_precision_and_recall() {
        let bonds = BrokenBonds { both: 6, rollout: 2, record: 4, neither: 8 };
        assert_eq!((bonds.precision(), bonds.recall()), (0.75, 0.6));
        assert!((bonds.f1() - 2.0 * 0.75 * 0.6 / 1.35).abs() < 1e-12);
        assert!((bonds.f1_of_holding() - 16.0 / 22.0).abs() < 1e-12);
        assert_eq!(BrokenBonds::default().f1(), 1.0);
    }
}
