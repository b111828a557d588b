//! A film strip: units at several instants, such as predicted and recorded, one row above the other.

use nalgebra::Isometry3;
use rigidformer_core::Plane;
use rigidformer_runtime::scenes::RecordedUnit;

use super::camera::Camera;
use super::colours::colour;
use super::mesh::Mesh;
use super::page::{Align, FAINT, Font, Page};
use super::raster::{Body, render};

const GAP: u32 = 12;
/// Room for the rows' names.
const LEFT: u32 = 136;
const TOP: u32 = 122;

/// What a strip shows.
pub(super) struct Film<'f> {
    pub(super) title: String,
    /// After the title.
    pub(super) note: &'f str,
    pub(super) units: &'f [RecordedUnit],
    pub(super) planes: &'f [Plane],
    pub(super) columns: Vec<Column>,
    /// Names of the rows.
    pub(super) rows: Vec<&'static str>,
    pub(super) camera: Camera,
}

/// An instant.
pub(super) struct Column {
    pub(super) time_s: f64,
    /// Under the time.
    pub(super) text: String,
    /// (rows, units); a unit without a pose is not drawn.
    pub(super) poses: Vec<Vec<Option<Isometry3<f32>>>>,
}

/// Draws the strip in panels of the camera's size; a PNG file.
pub(super) fn draw(film: &Film<'_>) -> anyhow::Result<Vec<u8>> {
    let (width, height) = film.camera.pixels_across();
    let (wide, high) = (width as u32, height as u32);
    let columns = film.columns.len() as u32;
    let mut page = Page::new(
        LEFT + columns * (wide + GAP) + GAP,
        TOP + film.rows.len() as u32 * (high + GAP) + 8,
    )?;
    page.text(&film.title, (LEFT as f32, 18.0), Align::Left, Font::TITLE);
    let faint = Font::PLAIN.coloured(FAINT);
    let after = LEFT as f32 + Font::TITLE.width(&film.title) + 24.0;
    page.text(film.note, (after, 24.0), Align::Left, faint);

    let meshes: Vec<Mesh> = film.units.iter().map(|unit| Mesh::new(&unit.points)).collect();
    for (number, column) in film.columns.iter().enumerate() {
        let x = LEFT + number as u32 * (wide + GAP);
        let left = x as f32 + 2.0;
        let label = format!("{:.3} s", column.time_s);
        page.text(&label, (left, TOP as f32 - 60.0), Align::Left, Font::BOLD);
        page.text(&column.text, (left, TOP as f32 - 32.0), Align::Left, faint);
        for (row, poses) in column.poses.iter().enumerate() {
            let bodies = meshes.iter().zip(film.units).zip(poses).enumerate();
            let bodies: Vec<Body<'_>> = bodies
                .filter_map(|(unit, ((mesh, body), pose))| {
                    let colour = colour(unit, body.role);
                    Some(Body { mesh, points: &body.points, pose: (*pose)?, colour })
                })
                .collect();
            let y = TOP + row as u32 * (high + GAP);
            let pixels = render(&bodies, film.planes, &film.camera, width, height);
            page.image((x, y), width, &pixels);
        }
    }
    for (row, name) in film.rows.iter().enumerate() {
        let middle = (TOP + row as u32 * (high + GAP) + high / 2) as f32;
        page.text(name, ((LEFT - GAP) as f32, middle - 10.0), Align::Right, faint);
    }
    page.png()
}
