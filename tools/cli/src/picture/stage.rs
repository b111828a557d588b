//! A scene as a camera sees it: shaded units between planes.

use nalgebra::{Isometry3, Point3};
use rigidformer_core::{Plane, Role};
use rigidformer_evaluation::scenes::RecordedScene;
use rigidformer_perception::camera::Camera as Pinhole;

use super::camera::Camera;
use super::colours::colour;
use super::mesh::Mesh;
use super::raster::{Body, render};
use super::surface::{Shown, Surface};

/// A scene's looks, made once for all pictures.
pub(crate) struct Stage<'s> {
    scene: &'s RecordedScene,
    /// (units)
    meshes: Vec<Mesh>,
    surface: Option<Surface>,
    planes: Vec<Plane>,
    camera: Camera,
}

impl<'s> Stage<'s> {
    /// As a camera sees it whose focal lengths are one, and whose axis goes through the middle; `away_m` is how far off the units are.
    pub(crate) fn new(scene: &'s RecordedScene, camera: &Pinhole, away_m: f32) -> Stage<'s> {
        let mesh = |unit: &rigidformer_evaluation::scenes::RecordedUnit| {
            if unit.pieces.is_empty() {
                return Mesh::new(&unit.points);
            }
            let pieces = unit.pieces.iter().map(Mesh::new);
            Mesh { triangles: pieces.flat_map(|piece| piece.triangles).collect() }
        };
        let ground = [Plane::ground(0.0, 0.0)];
        Stage {
            scene,
            meshes: scene.units().iter().map(mesh).collect(),
            surface: Surface::new(scene),
            planes: scene.planes().unwrap_or(&ground).to_vec(),
            camera: Camera::pinhole(camera, away_m),
        }
    }

    /// (height, width) The units in these poses, and the points of soft ones, in the world.
    pub(crate) fn pixels(&self, poses: &[Isometry3<f32>], soft: &[Point3<f32>]) -> Vec<[u8; 3]> {
        let units = self.scene.units().iter().zip(&self.meshes).zip(poses).enumerate();
        let rigid = units.filter(|(_, ((unit, _), _))| unit.soft.is_none());
        let mut bodies: Vec<Body<'_>> = rigid
            .map(|(number, ((unit, mesh), pose))| {
                // What has no surface is its points.
                let points: &[_] = if mesh.triangles.is_empty() { &unit.points } else { &[] };
                Body { mesh, points, pose: *pose, colour: colour(number, unit.role), sheet: None }
            })
            .collect();
        let shown: Vec<Shown> =
            self.surface.as_ref().map(|surface| surface.at(soft)).unwrap_or_default();
        bodies.extend(shown.iter().map(|body| Body {
            mesh: &body.mesh,
            points: &body.points,
            pose: Isometry3::identity(),
            colour: colour(body.unit, Role::Free),
            sheet: Some(body.lift_m),
        }));
        let (width, height) = self.camera.pixels_across();
        let pixels = render(&bodies, &self.planes, &self.camera, width, height);
        pixels.into_iter().map(|pixel| pixel.map(|part| (255.0 * part).round() as u8)).collect()
    }
}
