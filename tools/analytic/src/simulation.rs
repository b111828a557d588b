//! A recorded scene in Rapier.

use std::time::{Duration, Instant};

use nalgebra::{Isometry3, UnitQuaternion, Vector3};
use rapier3d::dynamics::{CoefficientCombineRule, FrictionModel};
use rapier3d::math::Vector;
use rapier3d::prelude::{
    ColliderBuilder, PhysicsWorld, RigidBodyBuilder, RigidBodyHandle, SharedShape,
};
use rigidformer_evaluation::rollout::Trajectory;
use rigidformer_evaluation::scenes::RecordedScene;
use rigidformer_runtime::core::Role;

use crate::arguments::Inertia;
use crate::bodies::{Hull, from_pose, mass_properties, to_pose, vector};

/// Half the width of the ground. It is no half-space, because with one the engine looks at 4 corners of the lowest face
/// only, and a cylinder sinks in with the others; with a slab it looks at the deepest point as well.
const GROUND_M: f32 = 100.0;
const GROUND_THICKNESS_M: f32 = 20.0;
/// Contacts are made from where a time step at this speed can bring units together. The engine's own 2 cm are for 60 Hz:
/// at 2400 Hz contacts would be made long before the touch, on faces that have turned away by then.
const APPROACH_M_S: f32 = 5.0;

/// How to simulate.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Settings {
    /// Time steps of the engine per recorded frame.
    pub(crate) sub_steps: u32,
    pub(crate) inertia: Inertia,
    /// Whether what is round is a ball.
    pub(crate) balls: bool,
}

/// Simulates a scene from its frames 0 and `step` on until `last_frame` is reached or passed. Samples are `every` frames
/// apart, the first at `step`.
pub(crate) fn simulate(
    scene: &RecordedScene,
    step: u32,
    every: u32,
    last_frame: u32,
    settings: Settings,
) -> anyhow::Result<Trajectory> {
    simulate_timed(scene, step, every, last_frame, settings).map(|(trajectory, _)| trajectory)
}

/// As [`simulate`], with how long the engine's steps took, without the building of the scene.
pub(crate) fn simulate_timed(
    scene: &RecordedScene,
    step: u32,
    every: u32,
    last_frame: u32,
    settings: Settings,
) -> anyhow::Result<(Trajectory, Duration)> {
    let too_few = || {
        let recorded = scene.frames();
        anyhow::anyhow!(
            "{}: step {step} starts from frames 0 and {step}, {recorded} frames are recorded; use a smaller step",
            scene.name()
        )
    };
    let before = scene.poses_at(0).ok_or_else(too_few)?;
    let now = scene.poses_at(step as usize).ok_or_else(too_few)?;
    // The slab below is the plane z = 0, and other planes are not built.
    let ground = scene.ground().ok_or_else(|| {
        anyhow::anyhow!(
            "{}: its only plane is not a ground z = 0 whose friction and restitution are known; give a scene that has such",
            scene.name()
        )
    })?;
    // Such units would fall as free rigid ones and give figures of another scene.
    if scene.units().iter().any(|unit| unit.role != Role::Free || unit.soft.is_some()) {
        anyhow::bail!(
            "{}: has driven, fixed or soft units, which are not simulated here; give a scene of free rigid units",
            scene.name()
        );
    }

    let frame_s = 1.0 / f64::from(scene.frame_rate_hz());
    let mut world = world(scene.gravity_m_s2(), (frame_s / f64::from(settings.sub_steps)) as f32);
    let material = |shape, friction, restitution| {
        ColliderBuilder::new(shape)
            .friction(friction)
            .restitution(restitution)
            // Bullet multiplies coefficients, and the record was made by Bullet.
            .friction_combine_rule(CoefficientCombineRule::Multiply)
            .restitution_combine_rule(CoefficientCombineRule::Multiply)
    };
    let slab = SharedShape::cuboid(GROUND_M, GROUND_M, GROUND_THICKNESS_M / 2.0);
    // The slab's upper face is the plane z = 0.
    let below = Vector::new(0.0, 0.0, -GROUND_THICKNESS_M / 2.0);
    let ground = material(slab, ground.friction, ground.restitution).translation(below);
    world.insert_collider(ground, None);

    let mut hulls = Hull::of_scene(scene)?;
    if settings.balls {
        let units = scene.units().iter();
        hulls = hulls.into_iter().zip(units).map(|(hull, unit)| hull.or_ball(unit)).collect();
    }
    let observed = before.iter().zip(&now);
    let bodies: Vec<RigidBodyHandle> = scene
        .units()
        .iter()
        .zip(&hulls)
        .zip(observed)
        .map(|((unit, hull), (before, now))| {
            let observed_s = f64::from(step) * frame_s;
            let (velocity, spin) = velocities(before, now, &scene.gravity_m_s2(), observed_s);
            let body = RigidBodyBuilder::dynamic()
                .pose(to_pose(now))
                .linvel(vector(&velocity))
                .angvel(vector(&spin))
                // A body that sleeps ignores slow motion, and would rest where the record does not.
                .can_sleep(false)
                // The engine caps spin for its continuous collisions, which steps so small do not
                // need.
                .allow_fast_rotation(true);
            let physics = unit.physics;
            let collider = material(hull.shape.clone(), physics.friction, physics.restitution)
                .mass_properties(mass_properties(unit, hull, settings.inertia));
            world.insert(body, collider).0
        })
        .collect();

    let mut trajectory = Trajectory::new(step, every, now);
    let begun = Instant::now();
    while trajectory.last_frame() < last_frame {
        for _ in 0..u64::from(settings.sub_steps) * u64::from(trajectory.step()) {
            world.step();
        }
        let poses = bodies.iter().filter_map(|body| world.bodies.get(*body));
        trajectory.push(poses.map(|body| from_pose(body.position())));
    }
    Ok((trajectory, begun.elapsed()))
}

/// Velocity and spin, in the world frame, at the second of two poses so many seconds apart.
pub(crate) fn velocities(
    before: &Isometry3<f32>,
    now: &Isometry3<f32>,
    gravity_m_s2: &Vector3<f32>,
    apart_s: f64,
) -> (Vector3<f32>, Vector3<f32>) {
    // Poses are 1/240 s apart, so their f32 difference has few digits.
    let (before, now): (Isometry3<f64>, Isometry3<f64>) = (before.cast(), now.cast());
    // The difference is the velocity half-way, and half a gap of gravity makes it that of the end.
    let velocity = (now.translation.vector - before.translation.vector) / apart_s
        + gravity_m_s2.cast::<f64>() * (apart_s / 2.0);
    let turn =
        UnitQuaternion::new_normalize((now.rotation * before.rotation.inverse()).into_inner());
    (velocity.cast(), (turn.scaled_axis() / apart_s).cast())
}

fn world(gravity_m_s2: Vector3<f32>, step_s: f32) -> PhysicsWorld {
    let mut world = PhysicsWorld::new();
    world.gravity = vector(&gravity_m_s2);
    let parameters = &mut world.integration_parameters;
    parameters.dt = step_s;
    // Both cost time and are more accurate, which a yardstick should be.
    parameters.friction_model = FrictionModel::Coulomb;
    parameters.contact_recycling = false;
    parameters.normalized_prediction_distance = APPROACH_M_S * step_s;
    world
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Point3, Translation3};
    use rigidformer_core::{Physics, Plane};
    use rigidformer_evaluation::scenes::{RecordedUnit, Split};

    use crate::bodies::tests::cube;

    const SETTINGS: Settings = Settings { sub_steps: 10, inertia: Inertia::Hull, balls: false };

    /// Points spread evenly over a sphere.
    fn sphere(radius_m: f32) -> Vec<Point3<f32>> {
        let point = |i: u32| {
            let z = 1.0 - (2 * i + 1) as f32 / 256.0;
            let (across, turn) = ((1.0 - z * z).sqrt(), 2.399_963 * i as f32);
            Point3::new(across * turn.cos(), across * turn.sin(), z) * radius_m
        };
        (0..256).map(point).collect()
    }

    fn scene(
        points: Vec<Point3<f32>>,
        restitution: f32,
        gravity_m_s2: f32,
        pose: impl Fn(f32) -> Isometry3<f32>,
    ) -> RecordedScene {
        let physics = Physics { mass_kg: 2.0, friction: 0.5, restitution };
        let poses = (0..=1).map(|frame| pose(frame as f32 / 240.0)).collect();
        let unit = RecordedUnit::new("body", points, physics, poses);
        let gravity = Vector3::new(0.0, 0.0, -gravity_m_s2);
        RecordedScene::new("made", 1, Split::Test, 240.0, gravity, vec![unit])
            .unwrap()
            .with_planes(vec![Plane::ground(0.3, 0.5)])
            .unwrap()
    }

    #[test]
    fn a_sphere_bounces_to_the_square_of_the_product_of_restitutions() {
        let (radius, height) = (0.35, 2.0);
        // Together with the ground's 0.5: 0.4.
        let drop = scene(sphere(radius), 0.8, 10.0, |t| {
            Isometry3::translation(0.0, 0.0, height + radius - 5.0 * t * t)
        });
        let path = simulate(&drop, 1, 1, 300, SETTINGS).unwrap();
        let heights: Vec<f32> =
            path.iter().map(|(_, poses)| poses[0].translation.z - radius).collect();
        let landed = heights.iter().position(|height| *height < 0.02).unwrap();
        // Falls for sqrt(2 h / g).
        assert!((landed as f32 / 240.0 - 0.632).abs() < 0.02, "{landed}");
        let apex = heights[landed..].iter().copied().fold(0.0, f32::max);
        assert!((apex / height - 0.16).abs() < 0.02, "{}", apex / height);
    }

    #[test]
    fn a_free_body_keeps_its_spin_and_falls() {
        let spin = Vector3::new(0.0, 3.0, 0.0);
        let truth = |t: f32| {
            let at = Translation3::new(0.5 * t, 0.0, 9.0 - 5.0 * t * t);
            Isometry3::from_parts(at, UnitQuaternion::from_scaled_axis(spin * t))
        };
        let scene = scene(cube(0.5), 0.5, 10.0, truth);
        let path = simulate(&scene, 1, 1, 121, SETTINGS).unwrap();
        let (found, expected) = (path.pose(121, 0).unwrap(), truth(121.0 / 240.0));
        assert!((found.translation.vector - expected.translation.vector).norm() < 0.01);
        assert!(found.rotation.angle_to(&expected.rotation) < 0.01);
    }

    #[test]
    fn a_cylinder_stands_on_all_of_its_rim() {
        let rim = |i: u32| {
            let (turn, z) = (0.393 * (i / 2) as f32, if i.is_multiple_of(2) { -0.3 } else { 0.3 });
            Point3::new(0.4 * turn.cos(), 0.4 * turn.sin(), z)
        };
        let points: Vec<_> = (0..32).map(rim).collect();
        let leaning = UnitQuaternion::from_scaled_axis(Vector3::new(0.1, 0.05, 0.0));
        let at = Translation3::new(0.0, 0.0, 0.4);
        let scene = scene(points.clone(), 0.5, 10.0, |_| Isometry3::from_parts(at, leaning));
        let path = simulate(&scene, 1, 1, 240, SETTINGS).unwrap();
        for (_, poses) in path.iter() {
            assert!(crate::bodies::lowest_m(&points, &poses[0]) > -5e-3);
        }
    }

    #[test]
    fn a_resting_cube_stays() {
        let scene = scene(cube(0.5), 0.5, 10.0, |_| Isometry3::translation(0.0, 0.0, 0.25));
        // Observed at rest, corrected for gravity it comes with 2 cm/s: it may settle, not travel.
        let path = simulate(&scene, 1, 1, 240, SETTINGS).unwrap();
        let last = path.pose(240, 0).unwrap();
        assert!((last.translation.vector - Vector3::new(0.0, 0.0, 0.25)).norm() < 2e-3);
        assert!(last.rotation.angle() < 0.01);
    }

    #[test]
    fn samples_are_as_far_apart_as_asked_and_reach_the_last_frame() {
        let scene = scene(cube(0.5), 0.5, 10.0, |_| Isometry3::translation(0.0, 0.0, 0.25));
        let (fine, coarse) =
            (simulate(&scene, 1, 1, 9, SETTINGS), simulate(&scene, 1, 4, 8, SETTINGS));
        let (fine, coarse) = (fine.unwrap(), coarse.unwrap());
        assert_eq!((coarse.step(), coarse.last_frame()), (4, 9));
        for frame in [1, 5, 9] {
            assert_eq!(fine.pose(frame, 0), coarse.pose(frame, 0));
        }
    }

    #[test]
    fn too_few_frames_are_an_error() {
        let scene = scene(cube(0.5), 0.5, 10.0, |_| Isometry3::translation(0.0, 0.0, 0.25));
        let error = simulate(&scene, 2, 1, 10, SETTINGS).unwrap_err().to_string();
        assert!(error.contains("use a smaller step"), "{error}");
    }
}
