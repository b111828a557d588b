//! The baseline of articulated tosses that knows no joint: the parts of each scene as one rigid body, in their first poses.
//!
//! ```sh
//! cargo run --release -p rigidformer-evaluation --example rigid_body -- MODEL.rfm TOSSES.safetensors [STEP]
//! ```
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use std::error::Error;

use nalgebra::{Isometry3, Matrix3, Point3, Rotation3, Translation3, UnitQuaternion, Vector3};
use rigidformer_core::Physics;
use rigidformer_evaluation::convex_pieces::ConvexPieces;
use rigidformer_evaluation::open_loop::errors;
use rigidformer_evaluation::rollout::{Trajectory, open_loop_on};
use rigidformer_evaluation::scenes::{Dataset, RecordedScene, RecordedUnit, Split, Velocity};
use rigidformer_runtime::engine::Engine;
use rigidformer_runtime::models::LoadedModel;
use rigidformer_runtime::progress::Progress;

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [model, tosses, step @ ..] = &arguments[..] else {
        return Err("usage: rigid_body MODEL.rfm TOSSES.safetensors [STEP]".into());
    };
    let step = step.first().map_or(Ok(2), |step| step.parse())?;
    let loaded = LoadedModel::open(model.as_ref())?.for_host()?;
    let native_hz = f64::from(loaded.model().config().frame_rate_hz);
    let dataset = Dataset::open(tosses.as_ref())?;
    let (mut position_m, mut rotation_deg, mut count) = (0.0, 0.0, 0.0);
    for index in dataset.scenes_of(Split::Test) {
        let scene = dataset.scene(index, None)?;
        let (merged, own) = merge(&scene)?;
        let moved = open_loop_on(Engine::new()?, &loaded, &merged, step, Progress::none())?;
        let mut samples = moved.iter().map(|(_, poses)| {
            own.iter().map(|own| poses[0] * own).collect::<Vec<Isometry3<f32>>>()
        });
        let mut parts = Trajectory::new(0, step, samples.next().ok_or("no poses")?);
        samples.for_each(|poses| parts.push(poses));
        let found = errors(&parts, &scene, native_hz).ok_or("a toss of one frame")?;
        position_m += found.position_m;
        rotation_deg += found.rotation_deg;
        count += 1.0;
    }
    println!("{count} tosses: {:.4} m, {:.1} deg", position_m / count, rotation_deg / count);
    Ok(())
}

/// A scene of one unit, and where the parts are in it.
type Merged = (RecordedScene, Vec<Isometry3<f32>>);

/// The parts as one unit about their common centre of mass, along its principal axes, and where the parts are in it.
fn merge(scene: &RecordedScene) -> Result<Merged, Box<dyn Error>> {
    let units = scene.units();
    let mass: f32 = units.iter().map(|unit| unit.physics.mass_kg).sum();
    let weighted = |of: &dyn Fn(&RecordedUnit) -> Vector3<f32>| {
        units.iter().map(|unit| of(unit) * unit.physics.mass_kg).sum::<Vector3<f32>>() / mass
    };
    let centre = weighted(&|unit| unit.poses[0].translation.vector);
    let velocity = |unit: &RecordedUnit| unit.velocity.unwrap_or_default();
    let linear = weighted(&|unit| velocity(unit).linear_m_s);
    let (mut inertia, mut momentum) = (Matrix3::zeros(), Vector3::zeros());
    for unit in units {
        let turn = unit.poses[0].rotation.to_rotation_matrix().into_inner();
        let arm = unit.poses[0].translation.vector - centre;
        let own = turn
            * Matrix3::from_diagonal(&unit.inertia.ok_or("no inertia")?.into())
            * turn.transpose();
        let kg = unit.physics.mass_kg;
        inertia += own + (Matrix3::identity() * arm.norm_squared() - arm * arm.transpose()) * kg;
        let Velocity { linear_m_s, angular_rad_s } = velocity(unit);
        momentum += own * angular_rad_s + arm.cross(&((linear_m_s - linear) * kg));
    }
    let axes = inertia.symmetric_eigen();
    let mut turn = axes.eigenvectors;
    if turn.determinant() < 0.0 {
        turn.set_column(2, &-turn.column(2));
    }
    let turn = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(turn));
    let body = Isometry3::from_parts(Translation3::from(centre), turn);
    let own: Vec<_> = units.iter().map(|unit| body.inverse() * unit.poses[0]).collect();
    let pieces: Vec<Vec<Point3<f32>>> = units
        .iter()
        .zip(&own)
        .map(|(unit, own)| unit.points.iter().map(|point| own * point).collect())
        .collect();
    let angular = inertia.try_inverse().ok_or("no inertia")? * momentum;
    let physics = Physics { mass_kg: mass, ..units[0].physics };
    let mut merged = RecordedUnit::new("all", pieces.concat(), physics, vec![body; scene.frames()])
        .with_velocity(Velocity { linear_m_s: linear, angular_rad_s: angular })
        .with_inertia(axes.eigenvalues.into());
    merged =
        merged.with_pieces(ConvexPieces::merged(pieces, 2)).with_compliance(units[0].compliance);
    let (name, gravity) = (scene.name(), scene.gravity_m_s2());
    let rate = scene.frame_rate_hz();
    let rigid = RecordedScene::new(name, scene.seed(), scene.split(), rate, gravity, vec![merged])?;
    let planes = scene.planes().map(<[_]>::to_vec).unwrap_or_default();
    let compliance = scene.plane_compliance().to_vec();
    let rigid = rigid.with_contact_law(scene.contact_law())?;
    Ok((rigid.with_planes(planes)?.with_plane_compliance(compliance)?, own))
}
