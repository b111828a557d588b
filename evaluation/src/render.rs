//! What depth cameras would see of a recorded scene, and their errors.
//!
//! Units are the convex hulls of their points, or their convex pieces; soft units are the triangles that the scene has for them. Planes
//! are seen from their free side, as far as they go. The label of a pixel is the number of the unit that is seen there, counted from 1;
//! 0 for planes and for nothing. Between recorded frames units are where [`RecordedScene::pose_at`] has them.
//!
//! ```
//! use nalgebra::{Isometry3, Point3, Vector3};
//! use rigidformer_core::{Physics, Plane};
//! use rigidformer_evaluation::render::{DepthNoise, Renderer, cameras};
//! use rigidformer_evaluation::scenes::{RecordedScene, RecordedUnit, Split};
//!
//! let corner = |k: u8, bit: u8| if k & bit == 0 { -0.1 } else { 0.1 };
//! let points = (0..8).map(|k| Point3::new(corner(k, 1), corner(k, 2), corner(k, 4))).collect();
//! let physics = Physics { mass_kg: 1.0, friction: 0.4, restitution: 0.3 };
//! let unit = RecordedUnit::new("cube", points, physics, vec![Isometry3::translation(0.0, 0.0, 0.1)]);
//! let scene = RecordedScene::new("cube", 1, Split::Test, 240.0, Vector3::zeros(), vec![unit])?
//!     .with_planes(vec![Plane::ground(0.4, 0.3)])?;
//!
//! let renderer = Renderer::new(&scene)?;
//! let noise = DepthNoise { deviation_at_1m_m: 0.001, edge_loss: 0.2, seed: 1 };
//! let camera = cameras(&scene, [64, 48], 1)?[0];
//! let view = renderer.view(&camera, 0.0, 0.001, &noise, 0)?;
//! let labels = view.labels.ok_or("no labels")?;
//! assert_eq!((labels[24 * 64 + 32], labels[0]), (1, 0));
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod cameras;
mod raster;
mod sensor;
mod smooth;

use nalgebra::{Isometry3, Point3};
use rigidformer_perception::camera::Camera;
use rigidformer_perception::capture::{DepthError, DepthView};
use rigidformer_runtime::hull::ConvexHull;

use crate::scenes::{RecordedScene, RecordedUnit};

use raster::Canvas;

pub use cameras::{cameras, distance_m};
pub use sensor::DepthNoise;
pub use smooth::SmoothErrors;

/// Why a scene cannot be seen.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum RenderError {
    /// A unit that has no surface.
    #[error(
        "unit {unit} ({shape}) has no surface: {what}; give the scene without it, or with more of its shape"
    )]
    NoSurface {
        /// Its number.
        unit: usize,
        /// Its shape's name.
        shape: String,
        /// What is missing.
        what: &'static str,
    },
    /// More units than labels of 16 bits.
    #[error("{units} units: labels have 16 bits, so a scene may have 65534")]
    Units {
        /// In the scene.
        units: usize,
    },
    /// A time that was not recorded.
    #[error("nothing was recorded at {time_s} s: the record goes from 0 to {duration_s} s")]
    Time {
        /// As given.
        time_s: f64,
        /// Of the record.
        duration_s: f64,
    },
    /// Noise out of range.
    #[error("noise of {0:?}: a deviation and a share of lost edges must be from 0 to 1")]
    Noise(DepthNoise),
    /// Smooth errors out of range.
    #[error("smooth errors of {0:?}: shares and metres must be from 0 to 1")]
    Smooth(SmoothErrors),
    /// A scale that is none.
    #[error(transparent)]
    Depth(#[from] DepthError),
}

/// Points and triangles of a rigid unit, in its body frame.
struct Solid {
    unit: usize,
    label: u16,
    points: Vec<Point3<f32>>,
    triangles: Vec<[usize; 3]>,
}

/// Triangles of a soft unit, as rows of the scene's soft points.
struct Sheet {
    label: u16,
    triangles: Vec<[usize; 3]>,
}

/// A scene's surfaces, made once for all images.
pub struct Renderer<'s> {
    scene: &'s RecordedScene,
    solids: Vec<Solid>,
    sheets: Vec<Sheet>,
}

impl<'s> Renderer<'s> {
    /// Makes the units' surfaces.
    ///
    /// # Errors
    /// [`RenderError::NoSurface`] for points in one plane and for soft units without triangles; [`RenderError::Units`].
    pub fn new(scene: &'s RecordedScene) -> Result<Self, RenderError> {
        let (mut solids, mut sheets) = (Vec::new(), Vec::new());
        let mut soft_points = 0;
        for (unit, recorded) in scene.units().iter().enumerate() {
            // 0 is the label of planes and of nothing.
            let label = u16::try_from(unit + 1)
                .map_err(|_| RenderError::Units { units: scene.units().len() })?;
            let missing = |what| {
                let shape = recorded.shape.clone();
                Err(RenderError::NoSurface { unit, shape, what })
            };
            if recorded.soft.is_none() {
                // A unit without a surface would be missing in the images and in no figure.
                let Some((points, triangles)) = surface(recorded) else {
                    return missing("its points enclose no volume");
                };
                solids.push(Solid { unit, label, points, triangles });
                continue;
            }
            let own = soft_points..soft_points + recorded.points.len();
            soft_points = own.end;
            let faces = scene.mesh().faces.iter();
            // A face lies in one body, so one corner tells whose it is.
            let triangles: Vec<_> = faces.filter(|face| own.contains(&face[0])).copied().collect();
            // A soft unit is no hull: its surface may be hollow.
            if triangles.is_empty() {
                return missing("it is soft and the scene has no triangles of it");
            }
            sheets.push(Sheet { label, triangles });
        }
        Ok(Renderer { scene, solids, sheets })
    }

    /// What a camera sees `time_s` after the first frame, in steps of `scale_m` metres, with labels. The errors are those of the noise's
    /// seed and of `stream`: give each image of a recording another one. The same arguments give the same bits.
    ///
    /// # Errors
    /// [`RenderError::Time`] outside of the record, [`RenderError::Noise`], [`RenderError::Depth`] for a scale that is no number above 0.
    pub fn view(
        &self,
        camera: &Camera,
        time_s: f64,
        scale_m: f32,
        noise: &DepthNoise,
        stream: u64,
    ) -> Result<DepthView, RenderError> {
        self.view_with(camera, time_s, scale_m, (noise, &SmoothErrors::default()), stream)
    }

    /// What a camera sees that has smooth errors too; see [`Renderer::view`]. Those of a camera are the same in all of its images: give
    /// each camera a seed of its own.
    ///
    /// # Errors
    /// Those of [`Renderer::view`], and [`RenderError::Smooth`].
    pub fn view_with(
        &self,
        camera: &Camera,
        time_s: f64,
        scale_m: f32,
        (noise, smooth): (&DepthNoise, &SmoothErrors),
        stream: u64,
    ) -> Result<DepthView, RenderError> {
        if !noise.is_sound() {
            return Err(RenderError::Noise(*noise));
        }
        if !smooth.is_sound() {
            return Err(RenderError::Smooth(*smooth));
        }
        if !(scale_m.is_finite() && scale_m > 0.0) {
            return Err(DepthError::Scale { scale_m }.into());
        }
        let missing = || RenderError::Time { time_s, duration_s: self.scene.duration_s() };
        let mut canvas = Canvas::new(camera);
        for plane in self.scene.planes().unwrap_or_default() {
            // Planes come first, but the order does not matter: the nearest surface wins.
            canvas.plane(plane, 0);
        }
        for solid in &self.solids {
            let pose = self.scene.pose_at(time_s, solid.unit).ok_or_else(missing)?;
            canvas.triangles(&solid.points, &solid.triangles, &pose, true, solid.label);
        }
        if !self.sheets.is_empty() {
            let points = self.soft_points(time_s).ok_or_else(missing)?;
            for sheet in &self.sheets {
                // Soft points are in the world already.
                let here = Isometry3::identity();
                canvas.triangles(&points, &sheet.triangles, &here, false, sheet.label);
            }
        }
        let Canvas { mut inverse, mut labels, .. } = canvas;
        smooth.bend(&mut inverse, camera);
        let width = camera.size()[0] as usize;
        let depth =
            sensor::measured(&inverse, &mut labels, width, scale_m, (noise, smooth), stream);
        Ok(DepthView::new(*camera, scale_m, depth, Some(labels))?)
    }

    /// World positions of all soft points; between frames on the straight way.
    fn soft_points(&self, time_s: f64) -> Option<Vec<Point3<f32>>> {
        let frames = self.scene.frames();
        let at = time_s * f64::from(self.scene.frame_rate_hz());
        // Scenes of soft units alone have not asked for a pose, which would have refused this time.
        let at = (at >= -1e-4 && at <= frames as f64 - 1.0 + 1e-4).then_some(at.max(0.0))?;
        let (frame, share) = (at as usize, at.fract() as f32);
        let soft = self.scene.units().iter().filter_map(|unit| unit.soft.as_ref());
        let mut all = Vec::new();
        for record in soft {
            let before = record.get(frame)?;
            // The last frame has no successor and needs none.
            let after = record.get(frame + 1).unwrap_or(before);
            let between = |(a, b): (&Point3<f32>, &Point3<f32>)| a + (b - a) * share;
            all.extend(before.iter().zip(after).map(between));
        }
        Some(all)
    }
}

/// Points, and triangles of them.
type Mesh = (Vec<Point3<f32>>, Vec<[usize; 3]>);

/// The surface of a rigid unit's hull, or of its pieces.
fn surface(unit: &RecordedUnit) -> Option<Mesh> {
    if unit.pieces.is_empty() {
        let hull = ConvexHull::new(&unit.points)?;
        return Some((unit.points.clone(), hull.faces().to_vec()));
    }
    let (mut points, mut triangles) = (Vec::new(), Vec::new());
    for piece in unit.pieces.iter() {
        let first = points.len();
        let hull = ConvexHull::new(piece)?;
        triangles.extend(hull.faces().iter().map(|face| face.map(|corner| corner + first)));
        points.extend_from_slice(piece);
    }
    Some((points, triangles))
}

#[cfg(test)]
mod tests;
