//! A unit that is followed.

use std::collections::{BTreeMap, HashMap};

use nalgebra::{Isometry3, Point3, Vector3};

use super::options::TrackerOptions;
use crate::estimate::{Sight, UnitEstimate};
use crate::motion::{Deviations, Motion};
use crate::planes::Planes;
use crate::registration::{Middle, Registered};
use crate::sampling::Sample;
use crate::shape::Shape;
use crate::surface::Surface;

/// How well place and turn of a unit that is new are known: they define its frame.
const FIRST: [f64; 2] = [1e-4, 1e-4];
/// A correction that is less likely than this, in deviations squared, says that the prediction was wrong.
const SURPRISE: f64 = 4.0;

/// A cluster of which a smaller share lies on a unit's surface is something else,
const LEAST_FIT: f32 = 0.4;
/// where lying on it means this part of a cell, and three deviations.
const LIES_CELLS: f32 = 0.06;
/// How well the middle of what is seen is known from capture to capture, radii,
const MIDDLE: f32 = 0.05;
/// where the number of samples is the same but for this share.
const SAME: f32 = 0.85;
/// New sides begin so many cells from what is known at most,
const GROWTH_CELLS: f32 = 2.5;
/// or so many radii from where they were guessed.
const GUESSED: f32 = 0.2;

/// Free motion counts where so many times as many samples are near the surface,
const FREE: f32 = 1.3;
/// and at least so many.
const FREE_LEAST: usize = 10;

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
    /// How a simulator's velocities of it differ from the filter's, as [`Moving`](crate::forecast::Moving) has it.
    pub(super) lag_m_s2: Vector3<f32>,
    /// Where it would be had nothing touched it.
    pub(super) free: Option<Motion>,
    /// By how much a cluster says that its predicted place is off, in this capture.
    pub(super) guess: Option<Vector3<f64>>,
    /// From its centre to the mean of what was seen of it last.
    pub(super) seen_at: Vector3<f64>,
    /// Samples of it in that capture.
    pub(super) seen_as: usize,
    /// Something hid a part of it then.
    was_cut: bool,
}

impl TrackedUnit {
    /// A unit that is first seen as these samples.
    pub(super) fn new(
        samples: &[Sample],
        capture: u64,
        planes: &Planes,
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
            lag_m_s2: options.gravity_m_s2 * -0.5,
            free: None,
            guess: None,
            seen_at: Vector3::zeros(),
            seen_as: 0,
            was_cut: false,
        };
        let local = samples.iter().map(|s| (s.point - middle.coords, s.normal, s.deviation_m));
        unit.surface.add(capture, local);
        unit.remember(samples, false);
        unit.reshape(planes, options);
        Some(unit)
    }

    pub(super) fn pose(&self) -> Isometry3<f32> {
        self.motion.pose(&self.centre)
    }

    /// Of its bounding sphere about the centre, metres.
    pub(super) fn radius_m(&self) -> f32 {
        let surfels = self.surface.surfels().iter();
        let square = surfels.map(|surfel| (surfel.point - self.centre).norm_squared());
        square.fold(0.0, f32::max).sqrt()
    }

    /// Where the mean of its samples should be, where as much of it is seen as in the capture before.
    pub(super) fn middle(&self, samples: &[Sample]) -> Option<Middle> {
        let share = samples.len() as f32 / self.seen_as.max(1) as f32;
        let deviation_m = f64::from(MIDDLE * self.radius_m());
        let is_same = !self.was_cut && (SAME..1.0 / SAME).contains(&share);
        let from_centre = self.seen_at;
        (is_same && deviation_m > 0.0).then_some(Middle { from_centre, deviation_m })
    }

    /// Takes what registration found. Gives whether the filter did.
    pub(super) fn correct(&mut self, found: &Registered, dt_s: f64) -> bool {
        let mut motion = self.motion.clone();
        if motion.surprise(&found.delta).is_some_and(|surprise| surprise > SURPRISE) {
            motion.doubt(&found.delta, dt_s.max(1e-3));
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
    pub(super) fn remember(&mut self, samples: &[Sample], is_cut: bool) {
        let sum: Vector3<f64> = samples.iter().map(|s| s.point.coords.cast::<f64>()).sum();
        if !samples.is_empty() {
            self.seen_at = sum / samples.len() as f64 - self.motion.centre;
            self.seen_as = samples.len();
            self.was_cut = is_cut;
        }
    }

    /// Adds samples to the surface. `grows`: all of them are the unit's, those of new sides too. New sides begin beside what is known,
    /// or where they were guessed: what is farther away is something else.
    pub(super) fn add(&mut self, samples: &[Sample], capture: u64, grows: bool) {
        let pose = self.pose();
        let cell = self.surface.cell_m();
        let surface = &self.surface;
        let guess = self.shape.as_ref().map(|shape| shape.points.as_slice()).unwrap_or_default();
        let least = (GUESSED * self.radius_m()).powi(2);
        let is_guessed =
            |point: &Point3<f32>| guess.iter().any(|other| (other - point).norm_squared() < least);
        let local = samples.iter().filter_map(|sample| {
            let point = pose.inverse_transform_point(&sample.point);
            let normal = pose.inverse_transform_vector(&sample.normal);
            let near = surface.nearest(&point)?;
            let off = near.surfel.normal.dot(&(point - near.surfel.point));
            let aside = (near.square_m2 - off * off).max(0.0).sqrt();
            let faces = normal.dot(&near.surfel.normal) > 0.5;
            let is_known =
                aside < cell && faces && off.abs() < 4.0 * sample.deviation_m + 0.3 * cell;
            let is_new = grows
                && (aside > 0.6 * cell || !faces)
                && (near.square_m2 < (GROWTH_CELLS * cell).powi(2) || is_guessed(&point));
            (is_known || is_new).then_some((point, normal, sample.deviation_m))
        });
        let local: Vec<_> = local.collect();
        self.surface.add(capture, local.into_iter());
    }

    /// Takes it to fly freely where that is what was seen rather than the contact that the model predicts. A guessed side may be hit where
    /// there is none, and then the unit would be looked for far from where it is.
    pub(super) fn prefer_free_motion(&mut self, samples: &[Sample], gravity_m_s2: &Vector3<f32>) {
        let Some(free) = &self.free else { return };
        let (cell, radius) = (self.surface.cell_m(), self.radius_m());
        let (place, turn) = {
            let off = self.motion.to(free);
            (off.fixed_rows::<3>(0).norm(), off.fixed_rows::<3>(3).norm())
        };
        if place + f64::from(radius) * turn < f64::from(cell) {
            return;
        }
        let near = |motion: &Motion| {
            let (inverse, middle) = (motion.pose(&self.centre).inverse(), motion.centre.cast());
            let reach = (radius + cell).powi(2);
            let beside = samples
                .iter()
                .filter(|sample| (sample.point.coords - middle).norm_squared() < reach)
                .filter_map(|sample| self.surface.nearest(&(inverse * sample.point)));
            beside.filter(|near| near.square_m2 < cell * cell).count()
        };
        let (with, without) = (near(&self.motion), near(free));
        if without as f32 > FREE * with as f32 && without >= FREE_LEAST {
            self.motion = Motion { covariance: self.motion.covariance, ..free.clone() };
            self.lag_m_s2 = gravity_m_s2 * -0.5;
            self.free = None;
        }
    }

    /// Whether it is hidden, and samples are where it may be.
    pub(super) fn may_come_out_as(&self, samples: &[Sample]) -> bool {
        let radius = f64::from(self.radius_m());
        let reach = radius + (2.0 * self.motion.spread().0).min(2.0 * radius);
        let sum: Vector3<f64> = samples.iter().map(|s| s.point.coords.cast::<f64>()).sum();
        let middle = sum / samples.len().max(1) as f64;
        self.sight == Sight::Hidden && (middle - self.motion.centre).norm() < reach
    }

    /// Share of samples that lie on its surface. What stands on it does not.
    pub(super) fn fits(&self, samples: &[Sample]) -> f32 {
        let inverse = self.pose().inverse();
        let lies = samples.iter().filter(|sample| self.lies(sample, &inverse)).count();
        lies as f32 / samples.len().max(1) as f32
    }

    /// Whether a sample lies on its surface; `inverse` is that of its pose.
    fn lies(&self, sample: &Sample, inverse: &Isometry3<f32>) -> bool {
        let (point, cell) = (inverse * sample.point, self.surface.cell_m());
        let limit = 3.0 * sample.deviation_m + LIES_CELLS * cell;
        self.surface.nearest(&point).is_some_and(|near| {
            let off = near.surfel.normal.dot(&(point - near.surfel.point)).abs();
            off < limit && near.square_m2 < 2.0 * cell * cell
        })
    }

    /// Clusters among its samples that do not lie on its surface although another one of the same view does: two bodies that were
    /// first seen as one go apart.
    pub(super) fn strangers(&self, own: &[Sample], view_of: &HashMap<u32, usize>) -> Vec<u32> {
        let mut counts: BTreeMap<u32, (usize, usize)> = BTreeMap::new();
        let inverse = self.pose().inverse();
        for sample in own {
            let lies = self.lies(sample, &inverse);
            let (on, all) = counts.entry(sample.cluster).or_default();
            *on += usize::from(lies);
            *all += 1;
        }
        if counts.len() < 2 {
            return Vec::new();
        }
        let share = |(on, all): (usize, usize)| on as f32 / all.max(1) as f32;
        let is_strange = |(cluster, count): (&u32, &(usize, usize))| {
            let beside = counts.iter().any(|(other, found)| {
                other != cluster
                    && view_of.get(other) == view_of.get(cluster)
                    && share(*found) > 2.0 * LEAST_FIT
            });
            beside && count.1 >= 20 && share(*count) < LEAST_FIT
        };
        counts
            .iter()
            .filter(|entry| is_strange((entry.0, entry.1)))
            .map(|(cluster, _)| *cluster)
            .collect()
    }

    /// The model's points, and the centre that goes with them.
    pub(super) fn reshape(&mut self, planes: &Planes, options: &TrackerOptions) {
        let pose = self.pose();
        let (completion, most) = (options.completion, options.model_points);
        let middle = (pose * self.centre).coords;
        let planes = planes.under(&middle, |plane| {
            let heights = self
                .surface
                .surfels()
                .iter()
                .map(|surfel| plane.height_m(&(pose * surfel.point).coords));
            heights.fold(f32::MAX, f32::min)
        });
        let Some(shape) = Shape::new(&self.surface, completion, &pose, &planes, most) else {
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
