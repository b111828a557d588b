//! Robots under command: how well their motion is predicted, beside motions that anyone could guess, and how they follow.
//!
//! A scene is one robot: links that the model moves, of one body. The **heading** of a robot is that of docs/MODEL.md,
//! section 1: the turn of its leader about the vertical, and the point of the ground below it.

use nalgebra::{Isometry3, Point3, Quaternion, Translation3, UnitQuaternion, Vector3, Vector4};
use rayon::prelude::*;
use rigidformer_core::Role;
use rigidformer_runtime::poses::{heading, heaviest_free};

use crate::metrics::{FrameErrors, frame_errors, mean};
use crate::rollout::Trajectory;
use crate::scenes::RecordedScene;

/// Recorded scenes that [`Neighbours`] averages.
pub const NEIGHBOURS: usize = 3;

/// Number of the link whose heading is the robot's: the heaviest free one, the first of equals; of all units where none is
/// free.
pub fn leader(scene: &RecordedScene) -> Option<usize> {
    let units = || scene.units().iter().map(|unit| (unit.role, unit.physics.mass_kg));
    // Scenes of scenery alone have no free unit, and figures still ask for a heading.
    heaviest_free(units()).or_else(|| heaviest_free(units().map(|(_, mass)| (Role::Free, mass))))
}

/// Two scenes whose commands differ by 1 all the time are as far apart as if all their links were so many metres apart.
// Commands are m/s and rad/s and positions are metres, so a sum of both needs a weight.
const COMMAND_WEIGHT: f32 = 0.3;

/// What a robot does between two instants, in the heading of the first.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Pace {
    /// Along the heading, m/s.
    pub forward_m_s: f32,
    /// To the left of it, m/s.
    pub left_m_s: f32,
    /// About the vertical, to the left, rad/s.
    pub turn_rad_s: f32,
}

/// The mean pace of a link over a stretch of a trajectory, in its heading at the start of each sample. `None` outside the
/// trajectory.
pub fn pace(
    trajectory: &Trajectory,
    link: usize,
    frames: std::ops::Range<u32>,
    frame_rate_hz: f32,
) -> Option<Pace> {
    let step = trajectory.step();
    let mut sum = Pace::default();
    let mut count = 0.0;
    let mut frame = frames.start;
    while frame < frames.end {
        let from = trajectory.pose(frame, link)?;
        let to = trajectory.pose(frame.checked_add(step)?, link)?;
        let way = heading(&from).inverse() * heading(&to);
        let seconds = step as f32 / frame_rate_hz;
        // A robot that turns walks an arc, whose chord points half the turn aside of its start.
        let turn = way.rotation.scaled_axis().z;
        let along = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), -0.5 * turn);
        let way = along * way.translation.vector;
        sum.forward_m_s += way.x / seconds;
        sum.left_m_s += way.y / seconds;
        sum.turn_rad_s += turn / seconds;
        count += 1.0;
        // Frames near the greatest number would wrap round and never end.
        frame = frame.checked_add(step)?;
    }
    (count > 0.0).then(|| Pace {
        forward_m_s: sum.forward_m_s / count,
        left_m_s: sum.left_m_s / count,
        turn_rad_s: sum.turn_rad_s / count,
    })
}

/// Every link goes on at its own velocity and spin of the two observed frames, without gravity. `None` where frames 0 and
/// `step` are not recorded.
pub fn constant_velocity(scene: &RecordedScene, step: u32, last_frame: u32) -> Option<Trajectory> {
    repeated(scene, step, last_frame, |previous, current, _| {
        let turn = current.rotation * previous.rotation.inverse() * current.rotation;
        let position = current.translation.vector * 2.0 - previous.translation.vector;
        Isometry3::from_parts(Translation3::from(position), turn)
    })
}

/// All links go on as the robot's heading did between the two observed frames. `None` as for [`constant_velocity`].
pub fn rigid_carry(scene: &RecordedScene, step: u32, last_frame: u32) -> Option<Trajectory> {
    repeated(scene, step, last_frame, |_, current, stride| stride * current)
}

/// Steps by a rule from a link's last two poses and the stride of the heading in the first step.
fn repeated(
    scene: &RecordedScene,
    step: u32,
    last_frame: u32,
    rule: impl Fn(&Isometry3<f32>, &Isometry3<f32>, &Isometry3<f32>) -> Isometry3<f32>,
) -> Option<Trajectory> {
    let leader = leader(scene)?;
    let (mut previous, mut current) = (scene.poses_at(0)?, scene.poses_at(step as usize)?);
    let stride = heading(current.get(leader)?) * heading(previous.get(leader)?).inverse();
    let mut trajectory = Trajectory::new(0, step, previous.clone());
    trajectory.push(current.clone());
    while trajectory.last_frame() < last_frame {
        let pairs = previous.iter().zip(&current);
        let mut next: Vec<_> = pairs.map(|(before, now)| rule(before, now, &stride)).collect();
        // Products of rotations drift from length 1 exponentially.
        for pose in &mut next {
            pose.rotation.renormalize();
        }
        (previous, current) = (current, next);
        trajectory.push(current.clone());
    }
    Some(trajectory)
}

/// Recorded scenes in which a robot's future is looked up: what the three that began most alike, under commands most alike,
/// went on to do, turned to the heading and averaged.
pub struct Neighbours<'s> {
    scenes: &'s [RecordedScene],
    step: u32,
    last_frame: u32,
    /// (windows) Scene and first frame, and where all links are at both observed frames, in the heading.
    windows: Vec<(usize, usize, Vec<f32>)>,
}

impl<'s> Neighbours<'s> {
    /// Takes every frame of the scenes from which `last_frame` more are recorded.
    pub fn new(scenes: &'s [RecordedScene], step: u32, last_frame: u32) -> Self {
        let of = |scene: usize| {
            let recorded = &scenes[scene];
            let starts = recorded.frames().saturating_sub(last_frame as usize);
            let window =
                move |start| Some((scene, start, signature(recorded, start, step, last_frame)?));
            (0..starts).filter_map(window).collect::<Vec<_>>()
        };
        let windows = (0..scenes.len()).into_par_iter().flat_map_iter(of).collect();
        Neighbours { scenes, step, last_frame, windows }
    }

    /// What the neighbours of a scene's two observed frames went on to do: of each scene at most one. `None` where there are
    /// fewer than three, or of other links.
    pub fn trajectory(&self, scene: &RecordedScene) -> Option<Trajectory> {
        let wanted = signature(scene, 0, self.step, self.last_frame)?;
        let leader = leader(scene)?;
        let mut nearest = vec![(f32::INFINITY, 0); self.scenes.len()];
        for (number, start, found) in &self.windows {
            // Robots with other links or commands have no distance to this one.
            if found.len() != wanted.len() {
                return None;
            }
            let distance = found.iter().zip(&wanted).map(|(a, b)| (a - b) * (a - b)).sum::<f32>();
            // One window a scene: neighbouring windows are nearly equal, and three of them would be
            // one neighbour.
            if distance < nearest[*number].0 {
                nearest[*number] = (distance, *start);
            }
        }
        let mut order: Vec<usize> = (0..nearest.len()).collect();
        order.sort_by(|a, b| nearest[*a].0.total_cmp(&nearest[*b].0));
        let best = order.get(..NEIGHBOURS)?;
        // A scene that is too short has no window.
        if best.iter().any(|number| nearest[*number].0.is_infinite()) {
            return None;
        }
        let here = heading(scene.pose(self.step as usize, leader)?);
        let mut trajectory = Trajectory::new(0, self.step, scene.poses_at(0)?);
        trajectory.push(scene.poses_at(self.step as usize)?);
        while trajectory.last_frame() < self.last_frame {
            let frame = trajectory.last_frame().saturating_add(self.step) as usize;
            let next = (0..scene.units().len()).map(|link| {
                let poses = best.iter().map(|number| {
                    let (other, start) = (&self.scenes[*number], nearest[*number].1);
                    let there = heading(other.pose(start + self.step as usize, leader)?);
                    // Headings carry the future over, so that it does not matter where the other
                    // robot walked.
                    Some(here * there.inverse() * other.pose(start + frame, link)?)
                });
                poses.collect::<Option<Vec<_>>>().map(|poses| mean_pose(&poses))
            });
            trajectory.push(next.collect::<Option<Vec<_>>>()?);
        }
        Some(trajectory)
    }
}

/// Where all links are at a frame and a step later, in the heading of the later one, and the commands of the steps that
/// follow.
fn signature(scene: &RecordedScene, start: usize, step: u32, last_frame: u32) -> Option<Vec<f32>> {
    let now = start + step as usize;
    let from = heading(scene.pose(now, leader(scene)?)?).inverse();
    let mut numbers = Vec::new();
    for frame in [start, now] {
        for link in 0..scene.units().len() {
            let position = Point3::from(scene.pose(frame, link)?.translation.vector);
            numbers.extend((from * position).iter());
        }
    }
    let steps = (last_frame / step).saturating_sub(1).max(1);
    // Two frames of all links and all commands count alike, however many of either there are.
    let weight = COMMAND_WEIGHT * (2.0 * scene.units().len() as f32 / steps as f32).sqrt();
    for number in 1..=steps {
        let from = start + (number * step) as usize;
        let command = scene.command_of_step(from, from + step as usize).unwrap_or_default();
        numbers.extend(command.iter().map(|number| number * weight));
    }
    Some(numbers)
}

/// The mean of poses that are near each other.
fn mean_pose(poses: &[Isometry3<f32>]) -> Isometry3<f32> {
    let Some(first) = poses.first() else { return Isometry3::identity() };
    let share = 1.0 / poses.len() as f32;
    let position = poses.iter().map(|pose| pose.translation.vector).sum::<Vector3<f32>>() * share;
    let alike = |pose: &Isometry3<f32>| {
        let (one, other) = (first.rotation.coords, pose.rotation.coords);
        // q and -q are one rotation, and their sum would cancel.
        if one.dot(&other) < 0.0 { -other } else { other }
    };
    // For rotations that are near each other the normalised sum is their mean.
    let turn = poses.iter().map(alike).sum::<Vector4<f32>>();
    let turn = UnitQuaternion::from_quaternion(Quaternion::from_vector(turn));
    Isometry3::from_parts(Translation3::from(position), turn)
}

/// Errors of predictions, one of each scene, at every predicted frame that is recorded: means over the scenes.
pub fn curve(predicted: &[Trajectory], scenes: &[RecordedScene]) -> Vec<(u32, FrameErrors)> {
    let Some(first) = predicted.first() else { return Vec::new() };
    let frames = first.iter().map(|(frame, _)| frame);
    let at = |frame: u32| {
        let each = predicted.iter().zip(scenes);
        let each = each.map(|(trajectory, scene)| frame_errors(trajectory, scene, frame));
        Some((frame, mean(&each.collect::<Option<Vec<_>>>()?)))
    };
    frames.map_while(at).collect()
}

/// A published row of a robot, at frame 100 of 30 a second in steps of ten frames (RigidFormer, section IV): position m,
/// orientation degrees, and what it was measured on.
pub fn published(dataset: &str) -> Option<(f64, f64, &'static str)> {
    match dataset {
        "g1" => Some((0.072, 16.26, "31 parts, command of 3")),
        "humanoid" => Some((0.062, 14.47, "its 17 parts, command of 5")),
        _ => None,
    }
}
