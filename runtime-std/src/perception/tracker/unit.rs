//! A unit that is followed.

use nalgebra::{Isometry3, Point3, Vector3};
use rigidformer_core::Plane;

use super::options::TrackerOptions;
use crate::perception::estimate::{Sight, UnitEstimate};
use crate::perception::motion::{Deviations, Motion};
use crate::perception::registration::Registered;
use crate::perception::sampling::Sample;
use crate::perception::shape::Shape;
use crate::perception::surface::Surface;

/// How well place and turn of a unit that is new are known: they define its frame.
const FIRST: [f64; 2] = [1e-4, 1e-4];
/// A correction that is less likely than this, in deviations squared, says that the prediction was wrong.
const SURPRISE: f64 = 4.0;

pub(super) struct TrackedUnit {
    /// From its confirmation on.
    pub(super) id: Option<u32>,
    pub(super) motion: Motion,
    pub(super) surface: Surface,
    pub(super) shape: Option<Shape>,
    /// In its own frame: what `motion` is about.
    pub(super) centre: Point3<f32>,
    /// Captures in which it was seen.
    pub(super) seen: u32,
    /// Captures in which it was missed, one after another.
    pub(super) missed: u32,
    pub(super) hidden_s: f64,
    pub(super) sight: Sight,
    /// By how much a cluster says that its predicted place is off, in this capture.
    pub(super) guess: Option<Vector3<f64>>,
    /// From its centre to the mean of what was seen of it last.
    pub(super) seen_at: Vector3<f64>,
}

impl TrackedUnit {
    /// A unit that is first seen as these samples.
    pub(super) fn new(
        samples: &[Sample],
        capture: u64,
        planes: &[Plane],
        options: &TrackerOptions,
    ) -> Option<Self> {
        let (low, high) = bounds(samples)?;
        let middle = Point3::from((low + high) * 0.5);
        let [linear_m_s, angular_rad_s] = options.first_velocity.map(f64::from);
        let [place_m, turn_rad] = FIRST;
        let first = Deviations { place_m, turn_rad, linear_m_s, angular_rad_s };
        let motion = Motion::at_rest(middle.coords.cast(), first);
        let surface = Surface::new((high - low).norm());
        let mut unit = TrackedUnit {
            id: None,
            motion,
            surface,
            shape: None,
            centre: Point3::origin(),
            seen: 1,
            missed: 0,
            hidden_s: 0.0,
            sight: Sight::Seen,
            guess: None,
            seen_at: Vector3::zeros(),
        };
        let local = samples.iter().map(|s| (s.point - middle.coords, s.normal, s.deviation_m));
        unit.surface.add(capture, local);
        unit.remember(samples);
        unit.reshape(planes, options);
        Some(unit)
    }

    pub(super) fn pose(&self) -> Isometry3<f32> {
        self.motion.pose(&self.centre)
    }

    /// Of its bounding sphere about the centre, metres.
    pub(super) fn radius_m(&self) -> f32 {
        let pieces = self.surface.pieces().iter();
        let square = pieces.map(|piece| (piece.point - self.centre).norm_squared());
        square.fold(0.0, f32::max).sqrt()
    }

    /// Takes what registration found. Gives whether the filter did.
    pub(super) fn correct(&mut self, found: &Registered) -> bool {
        let mut motion = self.motion.clone();
        if let Some(surprise) = motion.surprise(&found.delta).filter(|s| *s > SURPRISE) {
            motion.doubt((surprise / SURPRISE).min(100.0));
        }
        if motion.correct(&found.delta, &found.information).is_none() {
            return false;
        }
        self.motion = motion;
        self.seen = self.seen.saturating_add(1);
        (self.missed, self.hidden_s, self.sight) = (0, 0.0, Sight::Seen);
        true
    }

    /// Where what was seen lies, for the next capture.
    pub(super) fn remember(&mut self, samples: &[Sample]) {
        let sum: Vector3<f64> = samples.iter().map(|s| s.point.coords.cast::<f64>()).sum();
        if !samples.is_empty() {
            self.seen_at = sum / samples.len() as f64 - self.motion.centre;
        }
    }

    /// Adds samples to the surface. `grows`: all of them are the unit's, new sides too.
    pub(super) fn add(&mut self, samples: &[Sample], capture: u64, grows: bool) {
        let pose = self.pose();
        let cell = self.surface.cell_m();
        let surface = &self.surface;
        let local = samples.iter().filter_map(|sample| {
            let point = pose.inverse_transform_point(&sample.point);
            let normal = pose.inverse_transform_vector(&sample.normal);
            let near = surface.nearest(&point)?;
            let off = near.piece.normal.dot(&(point - near.piece.point));
            let aside = (near.square_m2 - off * off).max(0.0).sqrt();
            let faces = normal.dot(&near.piece.normal) > 0.5;
            let is_known =
                aside < cell && faces && off.abs() < 4.0 * sample.deviation_m + 0.3 * cell;
            let is_new = grows && (aside > 0.6 * cell || !faces);
            (is_known || is_new).then_some((point, normal, sample.deviation_m))
        });
        let local: Vec<_> = local.collect();
        self.surface.add(capture, local.into_iter());
    }

    /// The model's points, and the centre that goes with them.
    pub(super) fn reshape(&mut self, planes: &[Plane], options: &TrackerOptions) {
        let pose = self.pose();
        let (completion, most) = (options.completion, options.model_points);
        let Some(shape) = Shape::new(&self.surface, completion, &pose, planes, most) else {
            return;
        };
        let lever = pose.rotation * (shape.centre - self.centre);
        self.motion.about(&lever.cast());
        self.seen_at -= lever.cast::<f64>();
        self.centre = shape.centre;
        self.shape = Some(shape);
    }

    /// As it is told of, once it is confirmed.
    pub(super) fn estimate(&self) -> Option<UnitEstimate> {
        let [covariance, velocity_covariance] = self.motion.covariances();
        Some(UnitEstimate {
            id: self.id?,
            pose: self.pose(),
            covariance,
            velocity: self.motion.velocity(),
            velocity_covariance,
            points: self.surface.points().clone(),
            sight: self.sight,
        })
    }
}

/// The box around samples.
pub(super) fn bounds(samples: &[Sample]) -> Option<(Vector3<f32>, Vector3<f32>)> {
    let first = samples.first()?.point.coords;
    Some(samples.iter().fold((first, first), |(low, high), sample| {
        (low.inf(&sample.point.coords), high.sup(&sample.point.coords))
    }))
}
