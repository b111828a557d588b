//! `strip.png` of `rigidformer track`: what was seen, what is followed, and what is predicted.

use std::collections::BTreeMap;

use nalgebra::{Isometry3, Point3};
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

/// Draws a row each of what was seen, followed and predicted; a PNG file.
pub(crate) fn tracks(strip: &Strip<'_>) -> anyhow::Result<Vec<u8>> {
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
        }
    }
    for (row, name) in ROWS.iter().enumerate() {
        let middle = (TOP + row as u32 * (high + GAP) + high / 2) as f32;
        page.text(name, ((LEFT - GAP) as f32, middle - 10.0), Align::Right, faint);
    }
    page.png()
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
