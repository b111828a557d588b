//! One toss, recorded above predicted.

use nalgebra::{Isometry3, Point3};
use rigidformer_core::Plane;
use rigidformer_evaluation::metrics::angle_deg;
use rigidformer_evaluation::rollout::Trajectory;
use rigidformer_evaluation::scenes::RecordedScene;

use super::camera::Camera;
use super::colours::legend;
use super::film::{Column, Film, draw};

const INSTANTS: usize = 8;
const PANEL: (usize, usize) = (252, 190);

/// What the picture shows.
pub(crate) struct Toss<'t> {
    pub(crate) title: String,
    pub(crate) scene: &'t RecordedScene,
    /// In frames of `native_hz`.
    pub(crate) predicted: &'t Trajectory,
    pub(crate) native_hz: f64,
}

/// Draws a toss at eight instants, evenly spaced and the last one its end; a PNG file.
pub(crate) fn toss(toss: &Toss<'_>) -> anyhow::Result<Vec<u8>> {
    let scene = toss.scene;
    let units = 0..scene.units().len();
    let columns = instants(scene.frames() - 1).into_iter().map(|frame| {
        let time_s = frame as f64 / f64::from(scene.frame_rate_hz());
        let recorded: Vec<_> = units.clone().map(|unit| scene.pose(frame, unit).copied()).collect();
        let predicted: Vec<_> = units
            .clone()
            .map(|unit| toss.predicted.pose_at(time_s * toss.native_hz, unit))
            .collect();
        let text = off(&recorded, &predicted);
        Column { time_s, text, poses: vec![recorded, predicted], ..Column::default() }
    });
    let columns: Vec<Column> = columns.collect();
    let ground = [Plane::ground(0.0, 0.0)];
    draw(&Film {
        title: toss.title.clone(),
        note: legend(scene.units().iter().map(|unit| unit.role)),
        units: scene.units(),
        planes: scene.planes().unwrap_or(&ground),
        terrain: scene.height_field(),
        camera: across(scene, &columns),
        columns,
        rows: vec!["recorded", "predicted"],
        surface: None,
    })
}

/// Frames to show, without repeats.
fn instants(last: usize) -> Vec<usize> {
    let mut frames: Vec<usize> = (1..=INSTANTS).map(|k| (last * k).div_ceil(INSTANTS)).collect();
    frames.dedup();
    frames
}

/// How far the first unit's prediction is from its record.
fn off(recorded: &[Option<Isometry3<f32>>], predicted: &[Option<Isometry3<f32>>]) -> String {
    let (Some(Some(truth)), Some(Some(found))) = (recorded.first(), predicted.first()) else {
        return String::new();
    };
    let metres = (found.translation.vector - truth.translation.vector).norm();
    format!("{:.1} cm, {:.0}\u{b0}", metres * 100.0, angle_deg(found, truth))
}

/// From where the first unit flies from left to right, all instants in view.
fn across(scene: &RecordedScene, columns: &[Column]) -> Camera {
    let centre = |column: Option<&Column>| {
        let pose = column?.poses.first()?.first().copied()??;
        Some(pose.translation.vector)
    };
    let way = scene
        .pose(0, 0)
        .and_then(|first| Some(centre(columns.last())? - first.translation.vector))
        .unwrap_or_default();
    let azimuth = f32::atan2(-way.x, way.y);
    let placed = |poses: &[Option<Isometry3<f32>>]| -> Vec<Point3<f32>> {
        let posed = scene.units().iter().zip(poses);
        let posed = posed.filter_map(|(unit, pose)| Some((unit, (*pose)?)));
        posed.flat_map(|(unit, pose)| unit.points.iter().map(move |point| pose * point)).collect()
    };
    let points: Vec<Point3<f32>> =
        columns.iter().flat_map(|column| &column.poses).flat_map(|row| placed(row)).collect();
    Camera::fit(&points, azimuth, PANEL.0, PANEL.1)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn instants_are_evenly_spaced_up_to_the_last() {
        assert_eq!(instants(96), [12, 24, 36, 48, 60, 72, 84, 96]);
        assert_eq!(instants(3), [1, 2, 3]);
        assert_eq!(instants(101).last(), Some(&101));
    }
}
