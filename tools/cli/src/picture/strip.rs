//! `strip.png`: predicted above recorded units at a few instants.

use nalgebra::{Isometry3, Point3};
use rigidformer_core::Plane;
use rigidformer_evaluation::predicted::recorded;
use rigidformer_evaluation::scenes::RecordedScene;

use super::camera::{Camera, Seen};
use super::colours::legend;
use super::film::{Column, Film, draw};
use super::surface::Surface;
use crate::comparison::Comparison;

const INSTANTS: u32 = 4;
const PANEL: (usize, usize) = (400, 324);
/// Directions to choose the view from.
const VIEWS: u32 = 16;
/// A prediction that is farther from the record need not be in view, metres.
const ASTRAY_M: f32 = 2.0;
/// Azimuth and elevation that soft bodies are seen from: from above, as folds lie on top.
const SOFT_VIEW: (f32, f32) = (-0.9, 0.5);

/// Draws the strip at these frames, four evenly spaced ones without any; a PNG file. Of bodies that bend or break the record is
/// above, else the prediction.
pub(crate) fn strip(comparison: &Comparison<'_>, frames: &[u32]) -> anyhow::Result<Vec<u8>> {
    let (scene, predicted) = (comparison.scene, &comparison.predicted.poses);
    let frames = match frames {
        [] => instants(predicted.step(), predicted.last_frame()),
        frames => frames.to_vec(),
    };
    let truth_first = comparison.is_soft() || !scene.bonds().is_empty();
    let rows = if truth_first { ["recorded", "predicted"] } else { ["predicted", "recorded"] };
    let ground = [Plane::ground(0.0, 0.0)];
    draw(&Film {
        title: format!(
            "{}: {} units, step {}",
            scene.name(),
            scene.units().len(),
            predicted.step()
        ),
        note: note(scene),
        units: scene.units(),
        planes: scene.planes().unwrap_or(&ground),
        terrain: scene.height_field(),
        columns: frames.iter().map(|frame| column(comparison, *frame, truth_first)).collect(),
        rows: rows.to_vec(),
        camera: best_camera(comparison, &frames),
        surface: Surface::new(scene),
    })
}

/// What colours mean.
fn note(scene: &RecordedScene) -> &'static str {
    if scene.bonds().is_empty() {
        legend(scene.units().iter().map(|unit| unit.role))
    } else {
        "units that hold together have one colour"
    }
}

/// An instant: predicted and recorded, or the other way round.
fn column(comparison: &Comparison<'_>, frame: u32, truth_first: bool) -> Column {
    let (scene, predicted) = (comparison.scene, &comparison.predicted);
    let units = 0..scene.units().len();
    let truth = |unit| scene.pose(frame as usize, unit).copied();
    let prediction = |unit| predicted.poses.pose(frame, unit);
    let points = predicted.points.as_ref().and_then(|points| points.between(frame));
    let mut column = Column {
        time_s: comparison.time_s(frame),
        text: off(comparison, frame),
        poses: vec![units.clone().map(prediction).collect(), units.map(truth).collect()],
        soft: vec![points.unwrap_or_default(), recorded(scene, frame as usize).unwrap_or_default()],
        clusters: clusters(comparison, frame),
    };
    if truth_first {
        column.poses.reverse();
        column.soft.reverse();
        column.clusters.reverse();
    }
    column
}

/// Which units hang together at a frame, as predicted and as recorded: each unit's colour is that of the unit that is named for it.
/// None where nothing holds together, and each unit has a colour of its own.
fn clusters(comparison: &Comparison<'_>, frame: u32) -> Vec<Vec<usize>> {
    let scene = comparison.scene;
    if scene.bonds().is_empty() {
        return Vec::new();
    }
    vec![comparison.predicted.clusters_at(scene, frame), scene.clusters_at(frame as usize)]
}

/// How far the prediction is from the record.
fn off(comparison: &Comparison<'_>, frame: u32) -> String {
    let metres = |metres: f64| match metres {
        ..1.0 => format!("{:.1} cm", metres * 100.0),
        _ => format!("{metres:.2} m"),
    };
    if let Some(row) = comparison.points_row(frame) {
        return format!("frame {frame}, points off by {}", metres(row.model.mean_m));
    }
    let row = comparison.row(frame).map(|row| {
        let degrees = row.model.orientation_rms_deg;
        format!("frame {frame}, off by {}, {degrees:.1}\u{b0}", metres(row.model.position_m))
    });
    row.unwrap_or_default()
}

/// Frames to show: multiples of the step, evenly spaced up to the last, without repeats.
fn instants(step: u32, last_frame: u32) -> Vec<u32> {
    let samples = last_frame / step;
    let mut frames: Vec<u32> =
        (1..=INSTANTS).map(|k| ((samples * k + INSTANTS / 2) / INSTANTS).max(1) * step).collect();
    frames.dedup();
    frames
}

/// Of a ring of views the one in which recorded units hide each other least.
fn best_camera(comparison: &Comparison<'_>, frames: &[u32]) -> Camera {
    let points = in_view(comparison, frames);
    if comparison.is_soft() {
        // Patches of one body hide nothing of each other that a picture should show.
        return Camera::fit_from(&points, SOFT_VIEW, PANEL.0, PANEL.1);
    }
    let azimuths = (0..VIEWS).map(|view| view as f32 / VIEWS as f32 * std::f32::consts::TAU);
    let cameras = azimuths.map(|azimuth| Camera::fit(&points, azimuth, PANEL.0, PANEL.1));
    let best = cameras
        .min_by(|a, b| hidden(comparison, frames, a).total_cmp(&hidden(comparison, frames, b)));
    best.unwrap_or_else(|| Camera::fit(&points, 0.0, PANEL.0, PANEL.1))
}

/// How much of units' discs lies over each other in a view, in parts of the smaller disc's radius, summed up.
fn hidden(comparison: &Comparison<'_>, frames: &[u32], camera: &Camera) -> f32 {
    let scene = comparison.scene;
    let mut sum = 0.0;
    for frame in frames {
        let discs: Vec<(Seen, f32)> = scene
            .units()
            .iter()
            .filter_map(|unit| {
                let seen = camera.see(&(unit.poses.get(*frame as usize)? * Point3::origin()))?;
                let radius =
                    unit.points.iter().map(|point| point.coords.norm()).fold(0.0, f32::max);
                Some((seen, camera.pixels(radius, seen)))
            })
            .collect();
        for (index, (a, radius_a)) in discs.iter().enumerate() {
            for (b, radius_b) in &discs[..index] {
                let apart = (a.x - b.x).hypot(a.y - b.y);
                // Bodies fill about half of their spheres: touching discs hide nothing yet.
                let overlap = 0.8 * (radius_a + radius_b) - apart;
                sum += (overlap / radius_a.min(*radius_b).max(1.0)).clamp(0.0, 2.0).powi(2);
            }
        }
    }
    sum
}

/// All recorded points at the instants, and the predicted ones that are not far from them.
fn in_view(comparison: &Comparison<'_>, frames: &[u32]) -> Vec<Point3<f32>> {
    let (scene, predicted) = (comparison.scene, &comparison.predicted.poses);
    let mut points = Vec::new();
    for frame in frames {
        for (unit, body) in scene.units().iter().enumerate().filter(|(_, unit)| unit.soft.is_none())
        {
            let Some(truth) = scene.pose(*frame as usize, unit) else { continue };
            points.extend(body.points.iter().map(|point| truth * point));
            // A prediction gone astray must not shrink everything else.
            let near = |pose: &Isometry3<f32>| {
                (pose.translation.vector - truth.translation.vector).norm() < ASTRAY_M
            };
            if let Some(pose) = predicted.pose(*frame, unit).filter(near) {
                points.extend(body.points.iter().map(|point| pose * point));
            }
        }
        let truth = recorded(scene, *frame as usize).unwrap_or_default();
        let soft = comparison.predicted.points.as_ref();
        let soft = soft.and_then(|points| points.between(*frame)).unwrap_or_default();
        let near = soft.iter().zip(&truth).filter(|(a, b)| (*a - *b).norm() < ASTRAY_M);
        points.extend(near.map(|(point, _)| *point));
        points.extend(truth.iter());
    }
    points
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn instants_are_predicted_frames() {
        assert_eq!(instants(10, 120), [30, 60, 90, 120]);
        assert_eq!(instants(5, 10), [5, 10]);
        assert_eq!(instants(7, 14), [7, 14]);
        assert_eq!(instants(1, 100), [25, 50, 75, 100]);
    }
}
