//! A film strip: units at several instants, such as predicted and recorded, one row above the other.

use nalgebra::{Isometry3, Point3};
use rigidformer_core::{Plane, Role};
use rigidformer_evaluation::scenes::RecordedUnit;
use rigidformer_runtime::terrain::HeightFieldBuf;

use super::camera::Camera;
use super::colours::colour;
use super::mesh::Mesh;
use super::page::{Align, FAINT, Font, Page};
use super::raster::{Body, GROUND, render};
use super::surface::{Shown, Surface};

const GAP: u32 = 12;
/// Room for the rows' names.
const LEFT: u32 = 136;
const TOP: u32 = 122;

/// What a strip shows. Soft units are drawn as the surface says, all others as the hulls of their points.
pub(super) struct Film<'f> {
    pub(super) title: String,
    /// After the title.
    pub(super) note: &'f str,
    pub(super) units: &'f [RecordedUnit],
    pub(super) planes: &'f [Plane],
    pub(super) terrain: Option<&'f HeightFieldBuf>,
    pub(super) columns: Vec<Column>,
    /// Names of the rows.
    pub(super) rows: Vec<&'static str>,
    pub(super) camera: Camera,
    /// Of a scene with soft units.
    pub(super) surface: Option<Surface>,
}

/// An instant.
#[derive(Default)]
pub(super) struct Column {
    pub(super) time_s: f64,
    /// Under the time.
    pub(super) text: String,
    /// (rows, units); a unit without a pose is not drawn.
    pub(super) poses: Vec<Vec<Option<Isometry3<f32>>>>,
    /// (rows, soft points); rows that there are not have none.
    pub(super) soft: Vec<Vec<Point3<f32>>>,
    /// (rows, units) Number of the unit that gives a unit its colour, which is the cluster's that it is in; rows that there are not
    /// have each unit in its own.
    pub(super) clusters: Vec<Vec<usize>>,
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

    let terrain = film.terrain.map(|field| Mesh::flat(field.triangles()));
    let meshes: Vec<Mesh> = film.units.iter().map(|unit| Mesh::new(&unit.points)).collect();
    for (number, column) in film.columns.iter().enumerate() {
        let x = LEFT + number as u32 * (wide + GAP);
        let left = x as f32 + 2.0;
        let label = format!("{:.3} s", column.time_s);
        page.text(&label, (left, TOP as f32 - 60.0), Align::Left, Font::BOLD);
        page.text(&column.text, (left, TOP as f32 - 32.0), Align::Left, faint);
        for (row, poses) in column.poses.iter().enumerate() {
            let clusters = column.clusters.get(row);
            let lead = |unit| clusters.and_then(|leads| leads.get(unit)).copied().unwrap_or(unit);
            let bodies = meshes.iter().zip(film.units).zip(poses).enumerate();
            let rigid = bodies.filter(|(_, ((_, body), _))| body.soft.is_none());
            let mut bodies: Vec<Body<'_>> = rigid
                .filter_map(|(unit, ((mesh, body), pose))| {
                    let colour = colour(lead(unit), body.role);
                    // Beside soft bodies points are what bends, so those of rigid ones are left out.
                    let points: &[_] = if film.surface.is_some() { &[] } else { &body.points };
                    Some(Body { mesh, points, pose: (*pose)?, colour, sheet: None })
                })
                .collect();
            let shown: Vec<Shown> = match (&film.surface, column.soft.get(row)) {
                (Some(surface), Some(points)) => surface.at(points),
                _ => Vec::new(),
            };
            bodies.extend(shown.iter().map(|body| Body {
                mesh: &body.mesh,
                points: &body.points,
                pose: Isometry3::identity(),
                colour: colour(lead(body.unit), Role::Free),
                sheet: Some(body.lift_m),
            }));
            bodies.extend(terrain.iter().map(|mesh| Body {
                mesh,
                points: &[],
                pose: Isometry3::identity(),
                colour: GROUND,
                sheet: None,
            }));
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
