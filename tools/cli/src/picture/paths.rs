//! The paths that a planner tried for a unit that is thrown, and the one that it chose.

use nalgebra::{Isometry3, Point3};
use rigidformer_core::{Plane, Unit};

use super::camera::Camera;
use super::colours::colour;
use super::mesh::Mesh;
use super::page::{Align, FAINT, Font, Page, Rgb, WHITE};
use super::raster::{Body, render};

const WIDE: (usize, usize) = (840, 400);
const SMALL: (usize, usize) = (414, 250);
const GAP: usize = 12;
const TOP: usize = 64;
const LABEL: usize = 42;
const INSTANTS: usize = 4;
/// From the ball's right: it is thrown from left to right.
const AZIMUTH_RAD: f32 = -1.35;
const TRIED: Rgb = [0.45, 0.60, 0.80];
const CHOSEN: Rgb = [0.85, 0.20, 0.16];
/// The target's path.
const HIT: Rgb = [0.13, 0.50, 0.30];

/// What the picture shows.
pub struct Drawing<'d> {
    /// Its units.
    pub units: &'d [Unit<'d>],
    /// Number of the unit that is thrown.
    pub thrown: usize,
    /// Number of the unit that it is to hit.
    pub hit: usize,
    /// Its planes.
    pub planes: &'d [Plane],
    /// (units) before the throw
    pub start: &'d [Isometry3<f32>],
    /// (steps, units)
    pub best: &'d [Isometry3<f32>],
    /// Of the first and the last iteration: title and the ball's paths.
    pub iterations: Vec<(String, Vec<Vec<Isometry3<f32>>>)>,
    /// Of a step.
    pub seconds: f32,
    /// Above all.
    pub title: String,
}

/// Draws paths above, instants below; a PNG file.
pub fn paths(drawing: &Drawing<'_>) -> anyhow::Result<Vec<u8>> {
    let units = drawing.units.len().max(1);
    let width = 2 * WIDE.0 + 3 * GAP;
    let height = TOP + 2 * LABEL + WIDE.1 + SMALL.1 + 3 * GAP;
    let mut page = Page::new(width as u32, height as u32)?;
    page.text(&drawing.title, (GAP as f32 + 2.0, 20.0), Align::Left, Font::TITLE);

    let meshes: Vec<Mesh> = drawing.units.iter().map(|unit| Mesh::new(unit.points)).collect();
    let bodies = |poses: &[Isometry3<f32>]| -> Vec<Body<'_>> {
        let parts = meshes.iter().zip(drawing.units).zip(poses).enumerate();
        parts
            .map(|(number, ((mesh, unit), pose))| Body {
                mesh,
                points: unit.points,
                pose: *pose,
                colour: colour(number, unit.role),
                sheet: None,
            })
            .collect()
    };
    let instants: Vec<&[Isometry3<f32>]> = drawing.best.chunks_exact(units).collect();
    let shown: Vec<Point3<f32>> = [drawing.start]
        .into_iter()
        .chain(instants.iter().copied())
        .flat_map(|poses| poses.iter().zip(drawing.units))
        .flat_map(|(pose, unit)| unit.points.iter().map(move |point| pose * point))
        .collect();
    let of_best = |unit| path(drawing, unit, drawing.best.iter().skip(unit).step_by(units));
    let (chosen, hit) = (of_best(drawing.thrown), of_best(drawing.hit));

    let y = TOP + LABEL;
    let camera = Camera::fit(&shown, AZIMUTH_RAD, WIDE.0, WIDE.1);
    let pixels = render(&bodies(drawing.start), drawing.planes, &camera, WIDE.0, WIDE.1);
    for (column, (title, paths)) in drawing.iterations.iter().take(2).enumerate() {
        let x = GAP + column * (WIDE.0 + GAP);
        let font = Font::BOLD;
        page.text(title, (x as f32 + 2.0, (y - 32) as f32), Align::Left, font);
        let text =
            format!("{} of its throws; the one chosen; what it does to the target", paths.len());
        let after = x as f32 + 2.0 + font.width(title) + 24.0;
        page.text(&text, (after, (y - 32) as f32), Align::Left, Font::PLAIN.coloured(FAINT));
        page.image((x as u32, y as u32), WIDE.0, &pixels);
        let mut draw = |points: &[Point3<f32>], width, colour| {
            line(&mut page, &camera, (x, y), points, width, colour);
        };
        for poses in paths {
            draw(&path(drawing, drawing.thrown, poses.iter()), 1.2, TRIED);
        }
        for (path, colour) in [(&hit, HIT), (&chosen, CHOSEN)] {
            draw(path, 6.0, WHITE);
            draw(path, 3.5, colour);
        }
    }

    let y = y + WIDE.1 + GAP + LABEL;
    let camera = Camera::fit(&shown, AZIMUTH_RAD, SMALL.0, SMALL.1);
    for column in 0..INSTANTS {
        let Some(step) = (instants.len() * (column + 1) / INSTANTS).checked_sub(1) else {
            continue;
        };
        let x = GAP + column * (SMALL.0 + GAP);
        let label = format!("{:.2} s", (step + 1) as f32 * drawing.seconds);
        page.text(&label, (x as f32 + 2.0, (y - 32) as f32), Align::Left, Font::BOLD);
        let pixels = render(&bodies(instants[step]), drawing.planes, &camera, SMALL.0, SMALL.1);
        page.image((x as u32, y as u32), SMALL.0, &pixels);
        for (path, colour) in [(&hit, HIT), (&chosen, CHOSEN)] {
            let flown = &path[..(step + 2).min(path.len())];
            line(&mut page, &camera, (x, y), flown, 2.5, colour);
        }
    }
    page.png()
}

/// Where a unit's centre is, from its start on.
fn path<'p>(
    drawing: &Drawing<'_>,
    unit: usize,
    poses: impl Iterator<Item = &'p Isometry3<f32>>,
) -> Vec<Point3<f32>> {
    let centre = |pose: &Isometry3<f32>| pose * Point3::origin();
    let first = drawing.start.get(unit).map(centre);
    first.into_iter().chain(poses.map(centre)).collect()
}

/// A line through points, as far as it is within the panel at `(x, y)`.
fn line(
    page: &mut Page,
    camera: &Camera,
    (x, y): (usize, usize),
    points: &[Point3<f32>],
    width: f32,
    colour: Rgb,
) {
    let (wide, high) = camera.size();
    let inside = |point: &Point3<f32>| {
        let seen = camera.see(point)?;
        let fits =
            (width..wide - width).contains(&seen.x) && (width..high - width).contains(&seen.y);
        fits.then_some((x as f32 + seen.x, y as f32 + seen.y))
    };
    let seen: Vec<Option<(f32, f32)>> = points.iter().map(inside).collect();
    for part in seen.split(Option::is_none).filter(|part| part.len() > 1) {
        page.line(part.iter().flatten().copied(), width, colour);
    }
}
