//! Robots under command: how well their motion is predicted, beside motions that anyone could guess, and how they follow.
//!
//! A scene is one robot: parts that the model moves, of one body. The **heading** of a robot is that of docs/MODEL.md,
//! section 1: the turn of its heaviest part about the vertical, and the point of the ground below that part.

use nalgebra::{Isometry3, Point3, Quaternion, Translation3, UnitQuaternion, Vector3, Vector4};
use rayon::prelude::*;
use rigidformer_core::Role;
use rigidformer_runtime::poses::{heading, heaviest_free};

use crate::metrics::{FrameErrors, frame_errors, mean};
use crate::rollout::Trajectory;
use crate::scenes::RecordedScene;

/// Walks that [`Neighbours`] averages.
pub const NEIGHBOURS: usize = 3;

/// Number of the part whose heading is the robot's: the heaviest free one, the first of equals; of all units where none is
/// free.
pub fn leader(scene: &RecordedScene) -> Option<usize> {
    let units = || scene.units().iter().map(|unit| (unit.role, unit.physics.mass_kg));
    heaviest_free(units()).or_else(|| heaviest_free(units().map(|(_, mass)| (Role::Free, mass))))
}

/// Two walks whose commands differ by 1 all the time are as much apart as if all their parts were so many metres apart.
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

/// The mean pace of a part over a stretch of a trajectory, seen from its heading at the start of each sample. `None` outside
/// the trajectory.
pub fn pace(
    walk: &Trajectory,
    part: usize,
    frames: std::ops::Range<u32>,
    frame_rate_hz: f32,
) -> Option<Pace> {
    let step = walk.step();
    let mut sum = Pace::default();
    let mut count = 0.0;
    let mut frame = frames.start;
    while frame < frames.end {
        let (from, to) = (walk.pose(frame, part)?, walk.pose(frame.checked_add(step)?, part)?);
        let way = heading(&from).inverse() * heading(&to);
        let seconds = step as f32 / frame_rate_hz;
        // A stretch is an arc: its chord leads half the turn aside.
        let turn = way.rotation.scaled_axis().z;
        let along = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), -0.5 * turn);
        let way = along * way.translation.vector;
        sum.forward_m_s += way.x / seconds;
        sum.left_m_s += way.y / seconds;
        sum.turn_rad_s += turn / seconds;
        count += 1.0;
        frame = frame.checked_add(step)?;
    }
    (count > 0.0).then(|| Pace {
        forward_m_s: sum.forward_m_s / count,
        left_m_s: sum.left_m_s / count,
        turn_rad_s: sum.turn_rad_s / count,
    })
}

/// Every part goes on at its own velocity and spin of the two observed frames, without gravity. `None` where frames 0 and
/// `step` are not recorded.
pub fn constant_velocity(scene: &RecordedScene, step: u32, last_frame: u32) -> Option<Trajectory> {
    repeated(scene, step, last_frame, |previous, current, _| {
        let turn = current.rotation * previous.rotation.inverse() * current.rotation;
        let place = current.translation.vector * 2.0 - previous.translation.vector;
        Isometry3::from_parts(Translation3::from(place), turn)
    })
}

/// All parts go on as the robot's heading did between the two observed frames. `None` as for [`constant_velocity`].
pub fn rigid_carry(scene: &RecordedScene, step: u32, last_frame: u32) -> Option<Trajectory> {
    repeated(scene, step, last_frame, |_, current, stride| stride * current)
}

/// Steps by a rule from a part's last two poses and the stride of the heading in the first step.
fn repeated(
    scene: &RecordedScene,
    step: u32,
    last_frame: u32,
    rule: impl Fn(&Isometry3<f32>, &Isometry3<f32>, &Isometry3<f32>) -> Isometry3<f32>,
) -> Option<Trajectory> {
    let leader = leader(scene)?;
    let (mut previous, mut current) = (scene.poses_at(0)?, scene.poses_at(step as usize)?);
    let stride = heading(current.get(leader)?) * heading(previous.get(leader)?).inverse();
    let mut walk = Trajectory::new(0, step, previous.clone());
    walk.push(current.clone());
    while walk.last_frame() < last_frame {
        let pairs = previous.iter().zip(&current);
        let mut next: Vec<_> = pairs.map(|(before, now)| rule(before, now, &stride)).collect();
        // Products of products leave the sphere of rotations exponentially.
        for pose in &mut next {
            pose.rotation.renormalize();
        }
        (previous, current) = (current, next);
        walk.push(current.clone());
    }
    Some(walk)
}

/// Walks to look a robot's future up in: what the three that began most alike, under commands most alike,
/// went on to do, turned to the heading and
/// averaged.
pub struct Neighbours<'s> {
    walks: &'s [RecordedScene],
    step: u32,
    last_frame: u32,
    /// (windows) Scene and first frame, and where all parts are at both observed frames, seen from the heading.
    windows: Vec<(usize, usize, Vec<f32>)>,
}

impl<'s> Neighbours<'s> {
    /// Looks at every frame of the walks from which `last_frame` more are recorded.
    pub fn new(walks: &'s [RecordedScene], step: u32, last_frame: u32) -> Self {
        let of = |scene: usize| {
            let walk = &walks[scene];
            let starts = walk.frames().saturating_sub(last_frame as usize);
            let window = move |start| Some((scene, start, seen(walk, start, step, last_frame)?));
            (0..starts).filter_map(window).collect::<Vec<_>>()
        };
        let windows = (0..walks.len()).into_par_iter().flat_map_iter(of).collect();
        Neighbours { walks, step, last_frame, windows }
    }

    /// What the neighbours of a scene's two observed frames went on to do: of each walk at most one. `None` where there are
    /// fewer than three, or of other parts.
    pub fn trajectory(&self, scene: &RecordedScene) -> Option<Trajectory> {
        let wanted = seen(scene, 0, self.step, self.last_frame)?;
        let leader = leader(scene)?;
        let mut nearest = vec![(f32::INFINITY, 0); self.walks.len()];
        for (walk, start, found) in &self.windows {
            if found.len() != wanted.len() {
                return None;
            }
            let apart = found.iter().zip(&wanted).map(|(a, b)| (a - b) * (a - b)).sum::<f32>();
            if apart < nearest[*walk].0 {
                nearest[*walk] = (apart, *start);
            }
        }
        let mut order: Vec<usize> = (0..nearest.len()).collect();
        order.sort_by(|a, b| nearest[*a].0.total_cmp(&nearest[*b].0));
        let best = order.get(..NEIGHBOURS)?;
        if best.iter().any(|walk| nearest[*walk].0.is_infinite()) {
            return None;
        }
        let here = heading(scene.pose(self.step as usize, leader)?);
        let mut walk = Trajectory::new(0, self.step, scene.poses_at(0)?);
        walk.push(scene.poses_at(self.step as usize)?);
        while walk.last_frame() < self.last_frame {
            let frame = walk.last_frame().saturating_add(self.step) as usize;
            let next = (0..scene.units().len()).map(|part| {
                let poses = best.iter().map(|number| {
                    let (other, start) = (&self.walks[*number], nearest[*number].1);
                    let there = heading(other.pose(start + self.step as usize, leader)?);
                    Some(here * there.inverse() * other.pose(start + frame, part)?)
                });
                poses.collect::<Option<Vec<_>>>().map(|poses| middle(&poses))
            });
            walk.push(next.collect::<Option<Vec<_>>>()?);
        }
        Some(walk)
    }
}

/// Where all parts are at a frame and a step later, seen from the heading of the later one, and the commands of the steps
/// that follow.
fn seen(scene: &RecordedScene, start: usize, step: u32, last_frame: u32) -> Option<Vec<f32>> {
    let now = start + step as usize;
    let from = heading(scene.pose(now, leader(scene)?)?).inverse();
    let mut places = Vec::new();
    for frame in [start, now] {
        for part in 0..scene.units().len() {
            let place = Point3::from(scene.pose(frame, part)?.translation.vector);
            places.extend((from * place).iter());
        }
    }
    let steps = (last_frame / step).saturating_sub(1).max(1);
    let weight = COMMAND_WEIGHT * (2.0 * scene.units().len() as f32 / steps as f32).sqrt();
    for number in 1..=steps {
        let from = start + (number * step) as usize;
        let command = scene.command_of_step(from, from + step as usize).unwrap_or_default();
        places.extend(command.iter().map(|number| number * weight));
    }
    Some(places)
}

/// The mean of poses that are near each other.
fn middle(poses: &[Isometry3<f32>]) -> Isometry3<f32> {
    let Some(first) = poses.first() else { return Isometry3::identity() };
    let share = 1.0 / poses.len() as f32;
    let place = poses.iter().map(|pose| pose.translation.vector).sum::<Vector3<f32>>() * share;
    let alike = |pose: &Isometry3<f32>| {
        let (one, other) = (first.rotation.coords, pose.rotation.coords);
        if one.dot(&other) < 0.0 { -other } else { other }
    };
    let turn = poses.iter().map(alike).sum::<Vector4<f32>>();
    let turn = UnitQuaternion::from_quaternion(Quaternion::from_vector(turn));
    Isometry3::from_parts(Translation3::from(place), turn)
}

/// Errors of predictions, one of each scene, at every predicted frame that is recorded: means over the scenes.
pub fn curve(predicted: &[Trajectory], scenes: &[RecordedScene]) -> Vec<(u32, FrameErrors)> {
    let Some(first) = predicted.first() else { return Vec::new() };
    let frames = first.iter().map(|(frame, _)| frame);
    let at = |frame: u32| {
        let each = predicted.iter().zip(scenes);
        let each = each.map(|(walk, scene)| frame_errors(walk, scene, frame));
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
