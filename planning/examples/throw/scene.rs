//! A ball in the hand, a wall, and another ball that falls behind it, in materials of the lab's scenes.

use std::f32::consts::PI;

use nalgebra::{Isometry3, Point3, Vector3};
use rigidformer_core::{Physics, Posed, Role, Unit};
use rigidformer_planning::planner::{Cost, Trial};
use rigidformer_runtime::futures::Start;

pub(crate) const BALL: usize = 0;
pub(crate) const TARGET: usize = 2;
/// Native frames a step.
pub(crate) const STEP: u32 = 10;
/// Seconds of a step.
pub(crate) const DT_S: f32 = STEP as f32 / 240.0;
/// The wall stands.
const ROLES: [Role; 3] = [Role::Free, Role::Fixed, Role::Free];
/// Steps that a throw is followed: 1 s.
pub(crate) const STEPS: usize = 24;

const BALL_RADIUS_M: f32 = 0.35;
const WALL_HALF_M: [f32; 3] = [0.24, 0.80, 0.50];
const METAL: (f32, Physics) = (2.7, Physics { mass_kg: 0.0, friction: 0.4, restitution: 0.3 });
const RUBBER: (f32, Physics) = (1.1, Physics { mass_kg: 0.0, friction: 0.8, restitution: 0.7 });

/// Where the target shall go: away from the ball and to its left.
const WANTED: [f32; 2] = [std::f32::consts::FRAC_1_SQRT_2; 2];
/// Metres of miss that a metre of push is worth.
const PUSH_WORTH: f32 = 1.0;

/// The scene before the throw.
pub(crate) struct ThrowScene {
    /// (units) points in the body frame, and what they are made of.
    bodies: Vec<(Vec<Point3<f32>>, Physics)>,
    /// (units)
    pub(crate) poses: Vec<Isometry3<f32>>,
}

impl ThrowScene {
    pub(crate) fn new() -> ThrowScene {
        let of = |points, volume: f32, (density, physics): (f32, Physics)| {
            (points, Physics { mass_kg: density * volume, ..physics })
        };
        let ball =
            |material| of(sphere(BALL_RADIUS_M), 4.0 / 3.0 * PI * BALL_RADIUS_M.powi(3), material);
        let wall_volume = 8.0 * WALL_HALF_M.iter().product::<f32>();
        ThrowScene {
            bodies: vec![ball(METAL), of(grid(WALL_HALF_M), wall_volume, METAL), ball(RUBBER)],
            poses: vec![
                Isometry3::translation(0.0, 0.0, 1.0),
                Isometry3::translation(1.9, 0.0, WALL_HALF_M[2]),
                Isometry3::translation(3.6, 0.0, 3.1),
            ],
        }
    }

    pub(crate) fn units(&self) -> Vec<Unit<'_>> {
        let units = self.bodies.iter().map(|(points, physics)| Unit::new(points, *physics));
        units.zip(ROLES).map(|(unit, role)| unit.role(role)).collect()
    }

    /// At rest; the target is let go with the ball.
    pub(crate) fn posed(&self) -> Vec<Posed<'_>> {
        let units = self.units().into_iter().zip(&self.poses);
        units.map(|(unit, pose)| Posed { unit, previous: *pose, current: *pose }).collect()
    }

    /// Futures begin with [`posed`](Self::posed) units.
    pub(crate) fn start<'s>(units: &'s [Posed<'s>]) -> Start<'s> {
        Start { dt_s: DT_S, units, ..Start::default() }
    }

    /// How near the ball comes to the target, centre to centre, metres. Between steps both move straight.
    pub(crate) fn miss_m(&self, trial: &Trial<'_>) -> f32 {
        let apart = |poses: &[Isometry3<f32>]| match (poses.get(BALL), poses.get(TARGET)) {
            (Some(ball), Some(target)) => target.translation.vector - ball.translation.vector,
            _ => Vector3::repeat(f32::NAN),
        };
        let mut before = apart(&self.poses);
        let mut least = before.norm();
        for poses in trial.iter() {
            let now = apart(poses);
            let way = now - before;
            let length = way.norm_squared();
            let part =
                if length > 0.0 { (-before.dot(&way) / length).clamp(0.0, 1.0) } else { 0.0 };
            least = least.min((before + way * part).norm());
            before = now;
        }
        least
    }

    /// How far the target was moved, metres over the ground.
    pub(crate) fn moved_m(&self, trial: &Trial<'_>) -> [f32; 2] {
        match (trial.last().get(TARGET), self.poses.get(TARGET)) {
            (Some(now), Some(before)) => {
                let moved = now.translation.vector - before.translation.vector;
                [moved.x, moved.y]
            }
            _ => [0.0; 2],
        }
    }

    /// How far it was moved the way it shall go, metres.
    pub(crate) fn pushed_m(&self, trial: &Trial<'_>) -> f32 {
        self.moved_m(trial).iter().zip(WANTED).map(|(moved, wanted)| moved * wanted).sum()
    }
}

impl Cost for ThrowScene {
    fn cost(&self, trial: &Trial<'_>) -> f32 {
        self.miss_m(trial) - PUSH_WORTH * self.pushed_m(trial)
    }
}

/// The outer points of a 4 x 4 x 4 grid: 56.
fn grid(half: [f32; 3]) -> Vec<Point3<f32>> {
    let outer = |i: usize| matches!(i, 0 | 3);
    let cells = (0..64).map(|at| [at / 16, at / 4 % 4, at % 4]);
    let shell = cells.filter(|cell: &[usize; 3]| cell.iter().any(|i| outer(*i)));
    let place = |i: usize, half: f32| half * (i as f32 * 2.0 / 3.0 - 1.0);
    shell
        .map(|[x, y, z]| Point3::new(place(x, half[0]), place(y, half[1]), place(z, half[2])))
        .collect()
}

/// 64 points evenly over a sphere, along a spiral.
fn sphere(radius: f32) -> Vec<Point3<f32>> {
    let golden_angle = PI * (3.0 - 5f32.sqrt());
    let point = |index: usize| {
        let z = 1.0 - (2 * index + 1) as f32 / 64.0;
        let across = (1.0 - z * z).sqrt();
        let (sin, cos) = (golden_angle * index as f32).sin_cos();
        Point3::new(across * cos, across * sin, z) * radius
    };
    (0..64).map(point).collect()
}
