//! What was followed, for viewers.

use rigidformer_core::{Physics, Unit};
use rigidformer_evaluation::scenes::RecordedScene;

use super::followed::Followed;
use crate::viewers::{Frame, Moving, MovingUnit};

/// Units that were followed, and beside them the true ones where they are known. Those are units of their own: nobody knows
/// which frame of a body the tracker chose.
pub(super) fn moving(name: &str, followed: &Followed, scene: Option<&RecordedScene>) -> Moving {
    // Masses are guesses, which nobody asked for.
    let physics = Physics { mass_kg: 0.0, friction: 0.0, restitution: 0.0 };
    let tracks = followed.shapes.iter().map(|(id, points)| {
        let unit =
            MovingUnit::new(*id as usize, format!("track-{id}"), &Unit::new(points, physics));
        MovingUnit { mass_kg: None, ..unit }
    });
    let mut units: Vec<MovingUnit> = tracks.collect();
    units.extend(scene.into_iter().flat_map(MovingUnit::of_scene));
    let frames = followed.estimates.iter().map(|estimate| {
        let pose =
            |id: &u32| estimate.units.iter().find(|unit| unit.id == *id).map(|unit| unit.pose);
        let unknown = followed.shapes.keys().map(|_| None);
        let truth = scene.into_iter().flat_map(|scene| {
            (0..scene.units().len()).map(|unit| scene.pose_at(estimate.time_s, unit))
        });
        Frame {
            time_s: estimate.time_s,
            poses: followed.shapes.keys().map(pose).collect(),
            truth: unknown.chain(truth).collect(),
        }
    });
    Moving::new(name, "followed", "true", &followed.planes, units).with(frames)
}
