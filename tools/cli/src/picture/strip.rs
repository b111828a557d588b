//! `strip.png`: predicted above recorded units at a few instants.

use nalgebra::{Isometry3, Point3};
use rigidformer_core::Plane;

use super::camera::{Camera, Seen};
use super::colours::legend;
use super::film::{Column, Film, draw};
use crate::comparison::Comparison;

const INSTANTS: u32 = 4;
const PANEL: (usize, usize) = (400, 324);
/// Directions to choose the view from.
const VIEWS: u32 = 16;

/// Draws the strip at these frames, four evenly spaced ones without any; a PNG file.
pub(crate) fn strip(comparison: &Comparison<'_>, frames: &[u32]) -> anyhow::Result<Vec<u8>> {
    let (scene, predicted) = (comparison.scene, &comparison.predicted);
    let frames = match frames {
        [] => instants(predicted.step(), predicted.last_frame()),
        frames => frames.to_vec(),
    };
    let units = 0..scene.units().len();
    let column = |frame: &u32| {
        let text = comparison.row(*frame).map(|row| {
            let (metres, degrees) = (row.model.position_m, row.model.orientation_rms_deg);
            let metres = match metres {
                ..1.0 => format!("{:.1} cm", metres * 100.0),
                _ => format!("{metres:.2} m"),
            };
            format!("frame {frame}, off by {metres}, {degrees:.1}\u{b0}")
        });
        let truth = |unit| scene.pose(*frame as usize, unit).copied();
        let prediction = |unit| predicted.pose(*frame, unit);
        Column {
            time_s: comparison.time_s(*frame),
            text: text.unwrap_or_default(),
            poses: vec![
                units.clone().map(prediction).collect(),
                units.clone().map(truth).collect(),
            ],
        }
    };
    let ground = [Plane::ground(0.0, 0.0)];
    draw(&Film {
        title: format!(
            "{}: {} units, step {}",
            scene.name(),
            scene.units().len(),
            predicted.step()
        ),
        note: legend(scene.units().iter().map(|unit| unit.role)),
        units: scene.units(),
        planes: scene.planes().unwrap_or(&ground),
        columns: frames.iter().map(column).collect(),
        rows: vec!["predicted", "recorded"],
        camera: best_camera(comparison, &frames),
    })
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
    let (scene, predicted) = (comparison.scene, &comparison.predicted);
    let mut points = Vec::new();
    for frame in frames {
        for (unit, body) in scene.units().iter().enumerate() {
            let Some(truth) = scene.pose(*frame as usize, unit) else { continue };
            points.extend(body.points.iter().map(|point| truth * point));
            // A prediction gone astray must not shrink everything else.
            let near = |pose: &Isometry3<f32>| {
                (pose.translation.vector - truth.translation.vector).norm() < 2.0
            };
            if let Some(pose) = predicted.pose(*frame, unit).filter(near) {
                points.extend(body.points.iter().map(|point| pose * point));
            }
        }
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
