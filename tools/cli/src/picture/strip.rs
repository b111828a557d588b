//! `strip.png`: predicted above recorded units at four instants.

use nalgebra::{Isometry3, Point3};
use rigidformer_core::{Plane, Role};

use super::camera::{Camera, Seen};
use super::mesh::Mesh;
use super::page::{Align, FAINT, Font, Page, Rgb, WHITE};
use super::raster::{Body, render};
use crate::comparison::Comparison;

const INSTANTS: u32 = 4;
const PANEL: (usize, usize) = (520, 420);
const GAP: u32 = 12;
/// Directions to choose the view from.
const VIEWS: u32 = 16;
const LEFT: u32 = 44;
const TOP: u32 = 122;

/// Colours that are told apart also without colour vision for the first eight; then they repeat.
const COLOURS: [Rgb; 10] = [
    [0.26, 0.53, 0.84],
    [0.95, 0.58, 0.20],
    [0.25, 0.66, 0.44],
    [0.87, 0.33, 0.36],
    [0.58, 0.45, 0.78],
    [0.96, 0.80, 0.30],
    [0.30, 0.72, 0.80],
    [0.90, 0.52, 0.72],
    [0.62, 0.47, 0.36],
    [0.60, 0.63, 0.68],
];

const DRIVEN: Rgb = [0.24, 0.26, 0.30];
const FIXED: Rgb = [0.76, 0.76, 0.74];

/// A colour of their own for free units; driven ones are dark, fixed ones grey.
pub(super) fn colour(unit: usize, role: Role) -> Rgb {
    match role {
        Role::Driven => DRIVEN,
        Role::Fixed => FIXED,
        _ => COLOURS[unit % COLOURS.len()],
    }
}

/// What [`colour`] means, for scenes in which not all units are free.
fn legend(roles: impl Iterator<Item = Role>) -> &'static str {
    let (mut driven, mut fixed) = (false, false);
    for role in roles {
        driven |= role == Role::Driven;
        fixed |= role == Role::Fixed;
    }
    match (driven, fixed) {
        (true, true) => "driven units are dark, fixed ones grey",
        (true, false) => "driven units are dark",
        (false, true) => "fixed units are grey",
        (false, false) => "",
    }
}

/// Draws the film strip; a PNG file.
pub(crate) fn strip(comparison: &Comparison<'_>) -> anyhow::Result<Vec<u8>> {
    let (scene, predicted) = (comparison.scene, &comparison.predicted);
    let frames = instants(predicted.step(), predicted.last_frame());
    let columns = frames.len() as u32;
    let (width, height) = (PANEL.0 as u32, PANEL.1 as u32);
    let mut page = Page::new(LEFT + columns * (width + GAP) + GAP, TOP + 2 * (height + GAP) + 8)?;
    let title =
        format!("{}: {} units, step {}", scene.name(), scene.units().len(), predicted.step());
    page.text(&title, (LEFT as f32, 18.0), Align::Left, Font::TITLE);
    let note = legend(scene.units().iter().map(|unit| unit.role));
    let font = Font::PLAIN.coloured(FAINT);
    let after = LEFT as f32 + Font::TITLE.width(&title) + 24.0;
    page.text(note, (after, 24.0), Align::Left, font);

    let meshes: Vec<Mesh> = scene.units().iter().map(|unit| Mesh::new(&unit.points)).collect();
    let truth = |frame: u32, unit: usize| scene.pose(frame as usize, unit).copied();
    let prediction = |frame: u32, unit: usize| predicted.pose(frame, unit);
    let camera = best_camera(comparison, &frames);
    let ground = [Plane::ground(0.0, 0.0)];
    let planes = scene.planes().unwrap_or(&ground);
    for (column, frame) in frames.iter().enumerate() {
        let x = LEFT + column as u32 * (width + GAP);
        let label = format!("{:.3} s", comparison.time_s(*frame));
        page.text(&label, (x as f32 + 2.0, TOP as f32 - 60.0), Align::Left, Font::BOLD);
        if let Some(row) = comparison.row(*frame) {
            let errors = format!(
                "frame {frame}, off by {:.1} cm, {:.1}\u{b0}",
                row.model.position_m * 100.0,
                row.model.orientation_rms_deg
            );
            page.text(
                &errors,
                (x as f32 + 2.0, TOP as f32 - 32.0),
                Align::Left,
                Font::PLAIN.coloured(FAINT),
            );
        }
        let rows: [&dyn Fn(u32, usize) -> Option<Isometry3<f32>>; 2] = [&prediction, &truth];
        for (row, pose) in rows.into_iter().enumerate() {
            let bodies: Vec<Body<'_>> = meshes
                .iter()
                .zip(scene.units())
                .enumerate()
                .filter_map(|(unit, (mesh, body))| {
                    let colour = colour(unit, body.role);
                    Some(Body { mesh, points: &body.points, pose: pose(*frame, unit)?, colour })
                })
                .collect();
            let y = TOP + row as u32 * (height + GAP);
            page.image((x, y), PANEL.0, &render(&bodies, planes, &camera, PANEL.0, PANEL.1));
        }
    }
    for (row, name) in ["predicted", "recorded"].into_iter().enumerate() {
        label_row(&mut page, name, TOP + row as u32 * (height + GAP));
    }
    page.png()
}

/// The row's name in a tag in the corner of its first panel.
fn label_row(page: &mut Page, name: &str, y: u32) {
    let font = Font::PLAIN.coloured(FAINT);
    page.fill([LEFT as f32, y as f32, font.width(name) + 24.0, 36.0], WHITE);
    page.text(name, (LEFT as f32 + 12.0, y as f32 + 7.0), Align::Left, font);
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
    fn legends_name_the_roles_that_there_are() {
        let of = |roles: &[Role]| legend(roles.iter().copied());
        assert_eq!(of(&[Role::Free, Role::Free]), "");
        assert_eq!(of(&[Role::Free, Role::Fixed]), "fixed units are grey");
        assert_eq!(of(&[Role::Driven, Role::Fixed]), "driven units are dark, fixed ones grey");
    }

    #[test]
    fn instants_are_predicted_frames() {
        assert_eq!(instants(10, 120), [30, 60, 90, 120]);
        assert_eq!(instants(5, 10), [5, 10]);
        assert_eq!(instants(7, 14), [7, 14]);
        assert_eq!(instants(1, 100), [25, 50, 75, 100]);
    }
}
