//! `strip.png` of `rigidformer track`: what was seen, what is followed, and what is predicted.

use std::collections::BTreeMap;

use nalgebra::{Isometry3, Point3, UnitQuaternion, Vector3};
use rigidformer_core::{Plane, Role};

use super::camera::Camera;
use super::colours::colour;
use super::mesh::Mesh;
use super::page::{Align, FAINT, Font, Page};
use super::raster::{Body, render};

const PANEL: (usize, usize) = (400, 324);
const GAP: u32 = 12;
/// Room for the rows' names.
const LEFT: u32 = 136;
const TOP: u32 = 122;
const ROWS: [&str; 3] = ["seen", "followed", "predicted"];
/// Directions to choose the view from.
const VIEWS: u32 = 16;

/// What the picture shows.
pub(crate) struct Strip<'s> {
    pub(crate) title: String,
    pub(crate) planes: &'s [Plane],
    /// Points of each unit, in its frame.
    pub(crate) shapes: &'s BTreeMap<u32, Vec<Point3<f32>>>,
    pub(crate) instants: &'s [Instant],
    /// The way up, which is up on the picture.
    pub(crate) up: Vector3<f32>,
    /// Why nothing was followed, where that is so.
    pub(crate) reason: Option<String>,
}

/// An instant.
#[derive(Clone, Debug, Default)]
pub(crate) struct Instant {
    pub(crate) time_s: f64,
    /// Points that were seen, in the world.
    pub(crate) seen: Vec<Point3<f32>>,
    pub(crate) followed: Vec<(u32, Isometry3<f32>)>,
    /// So many seconds later.
    pub(crate) ahead_s: f64,
    pub(crate) predicted: Vec<(u32, Isometry3<f32>)>,
}

/// Draws a row each of what was seen, followed and predicted, upright; a PNG file.
pub(crate) fn tracks(strip: &Strip<'_>) -> anyhow::Result<Vec<u8>> {
    let turn = upright(&strip.up);
    let instants: Vec<Instant> = strip.instants.iter().map(|one| one.turned(&turn)).collect();
    let planes = strip.planes.iter().map(|plane| Plane { normal: turn * plane.normal, ..*plane });
    let planes: Vec<Plane> = planes.collect();
    let (title, reason) = (strip.title.clone(), strip.reason.clone());
    let up = Vector3::z();
    let shapes = strip.shapes;
    drawn(&Strip { title, planes: &planes, shapes, instants: &instants, up, reason })
}

/// The turn that makes `up` the z of the picture.
fn upright(up: &Vector3<f32>) -> UnitQuaternion<f32> {
    // Upside down, any axis will do.
    let over = || UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f32::consts::PI);
    UnitQuaternion::rotation_between(up, &Vector3::z()).unwrap_or_else(over)
}

impl Instant {
    fn turned(&self, turn: &UnitQuaternion<f32>) -> Instant {
        let poses = |poses: &[(u32, Isometry3<f32>)]| -> Vec<(u32, Isometry3<f32>)> {
            poses.iter().map(|(id, pose)| (*id, turn * pose)).collect()
        };
        Instant {
            seen: self.seen.iter().map(|point| turn * point).collect(),
            followed: poses(&self.followed),
            predicted: poses(&self.predicted),
            ..*self
        }
    }
}

fn drawn(strip: &Strip<'_>) -> anyhow::Result<Vec<u8>> {
    let (wide, high) = (PANEL.0 as u32, PANEL.1 as u32);
    let columns = strip.instants.len().max(1) as u32;
    let rows = ROWS.len() as u32;
    let mut page = Page::new(LEFT + columns * (wide + GAP) + GAP, TOP + rows * (high + GAP) + 8)?;
    page.text(&strip.title, (LEFT as f32, 18.0), Align::Left, Font::TITLE);
    let faint = Font::PLAIN.coloured(FAINT);

    let meshes: BTreeMap<u32, Mesh> =
        strip.shapes.iter().map(|(id, points)| (*id, Mesh::new(points))).collect();
    let nothing = Mesh { triangles: Vec::new() };
    let camera = best_camera(strip);
    for (number, instant) in strip.instants.iter().enumerate() {
        let x = LEFT + number as u32 * (wide + GAP);
        let left = x as f32 + 2.0;
        let label = format!("{:.3} s", instant.time_s);
        page.text(&label, (left, TOP as f32 - 60.0), Align::Left, Font::BOLD);
        let text = match instant.predicted.is_empty() {
            true => format!("{} units", instant.followed.len()),
            false => format!(
                "{} units; predicted: {:.1} s later",
                instant.followed.len(),
                instant.ahead_s
            ),
        };
        page.text(&text, (left, TOP as f32 - 32.0), Align::Left, faint);
        let cloud = Body {
            mesh: &nothing,
            points: &instant.seen,
            pose: Isometry3::identity(),
            colour: colour(0, Role::Fixed),
            sheet: None,
        };
        let bodies = |poses: &[(u32, Isometry3<f32>)]| -> Vec<Body<'_>> {
            let posed = poses.iter().filter_map(|(id, pose)| {
                let mesh = meshes.get(id)?;
                let points: &[Point3<f32>] = strip.shapes.get(id)?;
                let colour = colour(*id as usize - 1, Role::Free);
                Some(Body { mesh, points, pose: *pose, colour, sheet: None })
            });
            posed.collect()
        };
        let shown = [vec![cloud], bodies(&instant.followed), bodies(&instant.predicted)];
        for (row, shown) in shown.iter().enumerate() {
            let y = TOP + row as u32 * (high + GAP);
            let pixels = render(shown, strip.planes, &camera, PANEL.0, PANEL.1);
            page.image((x, y), PANEL.0, &pixels);
            if let Some(why) = why_empty(instant, row) {
                page.text(why, (left + 8.0, y as f32 + 16.0), Align::Left, faint);
            }
        }
    }
    if let Some(reason) = &strip.reason {
        let row = TOP + high + GAP;
        page.text(reason, (LEFT as f32 + 8.0, row as f32 + 44.0), Align::Left, faint);
    }
    for (row, name) in ROWS.iter().enumerate() {
        let middle = (TOP + row as u32 * (high + GAP) + high / 2) as f32;
        page.text(name, ((LEFT - GAP) as f32, middle - 10.0), Align::Right, faint);
    }
    page.png()
}

/// Why a row shows no unit.
fn why_empty(instant: &Instant, row: usize) -> Option<&'static str> {
    match row {
        0 if instant.seen.is_empty() => Some("no points beside the planes"),
        1 if instant.followed.is_empty() => Some("no unit is followed here"),
        2 if instant.predicted.is_empty() && !instant.followed.is_empty() => {
            Some("no unit's motion is known well enough, or there is no model")
        }
        2 if instant.predicted.is_empty() => Some("nothing is followed"),
        _ => None,
    }
}

/// Of a ring of views the one in which units are farthest from each other on the picture.
fn best_camera(strip: &Strip<'_>) -> Camera {
    let placed = |poses: &[(u32, Isometry3<f32>)]| -> Vec<Point3<f32>> {
        let of = |(id, pose): &(u32, Isometry3<f32>)| {
            let points = strip.shapes.get(id).map(Vec::as_slice).unwrap_or_default();
            points.iter().map(|point| pose * point).collect::<Vec<_>>()
        };
        poses.iter().flat_map(of).collect()
    };
    let mut points: Vec<Point3<f32>> =
        strip.instants.iter().flat_map(|instant| placed(&instant.followed)).collect();
    points.extend(strip.instants.iter().flat_map(|instant| instant.seen.iter().copied()));
    let azimuths = (0..VIEWS).map(|view| view as f32 / VIEWS as f32 * std::f32::consts::TAU);
    let cameras = azimuths.map(|azimuth| Camera::fit(&points, azimuth, PANEL.0, PANEL.1));
    let nearest = |camera: &Camera| {
        let mut least = f32::MAX;
        for instant in strip.instants {
            let seen: Vec<_> = instant
                .followed
                .iter()
                .filter_map(|(_, pose)| camera.see(&Point3::from(pose.translation.vector)))
                .collect();
            for (number, a) in seen.iter().enumerate() {
                for b in &seen[..number] {
                    least = least.min((a.x - b.x).hypot(a.y - b.y));
                }
            }
        }
        least
    };
    let best = cameras.max_by(|a, b| nearest(a).total_cmp(&nearest(b)));
    best.unwrap_or_else(|| Camera::fit(&points, 0.0, PANEL.0, PANEL.1))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn up_is_up_in_any_frame() {
        for up in [Vector3::z(), -Vector3::z(), -Vector3::y(), Vector3::new(0.6, 0.0, -0.8)] {
            assert!((upright(&up) * up - Vector3::z()).norm() < 1e-5, "{up}");
        }
    }

    #[test]
    fn an_empty_row_says_why() {
        let seen = vec![Point3::origin()];
        let instant = Instant { seen, ..Instant::default() };
        let rows = [0, 1, 2].map(|row| why_empty(&instant, row).is_some());
        assert_eq!(rows, [false, true, true]);
    }
}
