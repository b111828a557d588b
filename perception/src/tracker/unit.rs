//! A tracked unit.

use std::collections::{BTreeMap, HashMap};

use nalgebra::{Isometry3, Matrix6, Point3, UnitQuaternion, Vector3, Vector6};
use rigidformer_core::Plane;

use super::errors::Errors;
use super::options::TrackerOptions;
use super::rest::{Anchor, Seeing, Suspect, Verdict};
use crate::estimate::{Rest, UnitEstimate, Visibility};
use crate::known::KnownObject;
use crate::motion::{Candidate, Deviations, Motion};
use crate::planes::{Planes, height_m};
use crate::registration::{CentroidPrior, Registered};
use crate::sampling::Sample;
use crate::shape::Shape;
use crate::surface::Surface;

/// Standard deviations of position (m) and rotation (rad) of a new unit.
// Its first pose defines its frame, and is nearly exact.
const FIRST_DEVIATIONS: [f64; 2] = [1e-4, 1e-4];
/// Normalised squared innovation above which something hit the unit.
// A correct prediction has 1 on average, and exceeds 4 in one of 2,000 captures.
const MAX_NORMALISED_INNOVATION: f64 = 4.0;

/// Share of a cluster on a unit's surface below which it is of another body.
const MIN_FIT: f32 = 0.4;
/// Distance from the surface of an inlier, in cells, beside three deviations.
const INLIER_CELLS: f32 = 0.06;
/// Standard deviation of the visible centroid from capture to capture, radii.
const CENTROID_DEVIATION: f32 = 0.05;
/// Ratio of samples between captures, or its inverse, below which the centroid is not used.
// Another number of samples shows another part of the unit, whose centroid is elsewhere.
const MIN_SAMPLE_RATIO: f32 = 0.85;
/// Largest distance of a new side from the known surface, cells.
// Farther points are of another body.
const MAX_GROWTH_CELLS: f32 = 2.5;
/// Largest distance of a new side from a completed one, radii.
const COMPLETED_RADII: f32 = 0.2;

/// Standard deviations of an object's first pose: position in its radii, and rotation in rad.
// Captures after it are weighed by these.
const FOUND_DEVIATIONS: [f64; 2] = [0.03, 0.06];

/// The object that a unit is.
pub(super) struct Known {
    /// Its place in the options.
    pub(super) number: usize,
    pub(super) object: KnownObject,
}

/// Where a capture shows a unit.
pub(super) struct Found {
    /// The likeliest prediction; of a unit at rest the likeliest one that it moves.
    pub(super) prior: Candidate,
    /// Relative to that.
    pub(super) registered: Registered,
    /// The pose that was measured.
    pub(super) at: Motion,
    /// (a unit at rest) How badly its samples fit the place where it rests, over how badly they fit where they were found.
    pub(super) misfit_at_rest: f64,
}

pub(super) struct TrackedUnit {
    /// From its confirmation on.
    pub(super) id: Option<u32>,
    pub(super) motion: Motion,
    pub(super) surface: Surface,
    pub(super) shape: Option<Shape>,
    /// Whose frame, surface and shape are these, if that is known. They do not change then.
    pub(super) known: Option<Known>,
    /// In its own frame: what `motion` is about.
    pub(super) centre: Point3<f32>,
    /// Captures that show it.
    pub(super) seen: u32,
    /// Consecutive captures that miss it.
    pub(super) missed: u32,
    pub(super) hidden_s: f64,
    pub(super) visibility: Visibility,
    /// Difference of the simulator's velocity from the filter's ([`MovingUnit`](crate::forecast::MovingUnit)).
    pub(super) velocity_lag_m_s2: Vector3<f32>,
    /// Whether `motion` is predicted by rest.
    pub(super) predicted_still: bool,
    /// Other predictions than `motion`.
    pub(super) others: Vec<Candidate>,
    /// Where it rests.
    pub(super) anchor: Anchor,
    /// Where it rests if this capture does not show it.
    pub(super) unseen: Option<(Motion, Anchor)>,
    pub(super) rest: Rest,
    /// What it does if it left its place in the last capture.
    pub(super) suspect: Option<Suspect>,
    /// What captures of it share.
    errors: Errors,
    /// Variance of where it was before, in directions in which captures are only compared with each other.
    drift: Matrix6<f64>,
    /// Covariance of its pose in the last capture that shows it, with the drift.
    last_covariance: Matrix6<f64>,
    /// Distance of a matched cluster's centroid from the predicted one, in this capture.
    pub(super) centroid_shift: Option<Vector3<f64>>,
    /// Centroid of its samples in the last capture that shows it, relative to its centre.
    pub(super) visible_centroid: Vector3<f64>,
    /// Samples of it in that capture.
    pub(super) visible_samples: usize,
    /// Whether it was occluded in part then.
    was_occluded: bool,
}

impl TrackedUnit {
    /// A unit whose first samples these are.
    pub(super) fn new(
        samples: &[Sample],
        (capture, time_s): (u64, f64),
        planes: &Planes,
        options: &TrackerOptions,
    ) -> Option<Self> {
        let (low, high) = bounds(samples)?;
        let middle = Point3::from((low + high) * 0.5);
        let [linear_m_s, angular_rad_s] = options.first_velocity.map(f64::from);
        let [position_m, turn_rad] = FIRST_DEVIATIONS;
        let first = Deviations { position_m, turn_rad, linear_m_s, angular_rad_s };
        let motion = Motion::at_rest(middle.coords.cast(), first);
        let last_covariance = motion.pose_covariance();
        let surface = Surface::new((high - low).norm());
        let anchor = Anchor::new(&motion, &Point3::origin(), time_s);
        let mut unit = TrackedUnit {
            id: None,
            motion,
            surface,
            shape: None,
            known: None,
            centre: Point3::origin(),
            seen: 1,
            missed: 0,
            hidden_s: 0.0,
            visibility: Visibility::Seen,
            velocity_lag_m_s2: Vector3::zeros(),
            predicted_still: false,
            others: Vec::new(),
            anchor,
            unseen: None,
            rest: Rest::Moving,
            suspect: None,
            errors: Errors::shared(f64::from(0.5 * (high - low).norm()), 0.0),
            drift: Matrix6::zeros(),
            last_covariance,
            centroid_shift: None,
            visible_centroid: Vector3::zeros(),
            visible_samples: 0,
            was_occluded: false,
        };
        let local = samples.iter().map(|s| (s.point - middle.coords, s.normal, s.deviation_m));
        unit.surface.add(capture, local);
        unit.record_view(samples, false);
        unit.complete_shape(planes, options);
        Some(unit)
    }

    pub(super) fn pose(&self) -> Isometry3<f32> {
        self.motion.pose(&self.centre)
    }

    /// Radius of its bounding sphere about the centre, metres.
    pub(super) fn radius_m(&self) -> f32 {
        let surfels = self.surface.surfels().iter();
        let square = surfels.map(|surfel| (surfel.point - self.centre).norm_squared());
        square.fold(0.0, f32::max).sqrt()
    }

    /// The expected centroid of its samples, where as much of it is visible as in the capture before.
    pub(super) fn expected_centroid(&self, samples: &[Sample]) -> Option<CentroidPrior> {
        let share = samples.len() as f32 / self.visible_samples.max(1) as f32;
        let deviation_m = f64::from(CENTROID_DEVIATION * self.radius_m());
        let is_same =
            !self.was_occluded && (MIN_SAMPLE_RATIO..1.0 / MIN_SAMPLE_RATIO).contains(&share);
        let from_centre = self.visible_centroid;
        (is_same && deviation_m > 0.0).then_some(CentroidPrior { from_centre, deviation_m })
    }

    /// Where it rests, if it is believed to.
    pub(super) fn place_at_rest(&self) -> Option<&Motion> {
        self.unseen.as_ref().filter(|_| self.anchor.holds).map(|(place, _)| place)
    }

    /// Updates the filter with a registration from a prediction. Whether that was possible.
    pub(super) fn correct(&mut self, found: Found, dt_s: f64, seeing: Seeing) -> bool {
        let radius_m = f64::from(self.radius_m());
        let errors = Errors::shared(radius_m, seeing.shift_m);
        let place = self.place_at_rest().cloned();
        let suspect = self.suspect.take();
        let Found { prior, registered, at, misfit_at_rest } = found;
        let compared = registered.compared;
        let is_done = match place {
            None => self.follow(prior, &registered, errors, dt_s, seeing),
            Some(mut place) => {
                let off = place.difference_to(&at);
                let measured = (&off, &registered.information);
                let suspect = suspect.as_ref();
                match self.anchor.judge(measured, misfit_at_rest, suspect, radius_m, seeing) {
                    Verdict::Rests => self.average(place, measured, errors, dt_s, seeing),
                    Verdict::Suspected => {
                        self.suspect = corrected(prior, &registered, dt_s)
                            .map(|moving| Suspect { moving, off });
                        self.motion = place;
                        self.velocity_lag_m_s2 = Vector3::zeros();
                        self.suspect.is_some()
                    }
                    Verdict::Drifts => {
                        let way = [0, 3].map(|at| off.fixed_rows::<3>(at).norm());
                        place.add_pose_noise(way[0], way[1]);
                        let is_done = self.average(place, measured, errors, dt_s, seeing);
                        self.anchor.rest_at(&self.motion, &self.centre, seeing.now_s);
                        is_done
                    }
                    Verdict::Moves => self.follow(prior, &registered, errors, dt_s, seeing),
                }
            }
        };
        if is_done {
            self.errors = errors;
            let now = self.moving().0.pose_covariance();
            self.drift = compared.lacks(&now, &self.last_covariance);
            self.last_covariance = now + self.drift;
            self.seen = self.seen.saturating_add(1);
            (self.missed, self.hidden_s, self.visibility) = (0, 0.0, Visibility::Seen);
        }
        is_done
    }

    /// At rest what is measured are errors: the place is their mean.
    fn average(
        &mut self,
        mut place: Motion,
        (off, information): (&Vector6<f64>, &Matrix6<f64>),
        errors: Errors,
        dt_s: f64,
        seeing: Seeing,
    ) -> bool {
        let information = errors.widen(information);
        let delta = place.posterior(off, &information);
        if delta.and_then(|delta| place.correct(&delta, &information)).is_none() {
            return false;
        }
        place.stop(self.anchor.since_s(seeing.now_s).max(dt_s));
        self.motion = place;
        self.velocity_lag_m_s2 = Vector3::zeros();
        true
    }

    /// Updates the motion of a unit that is not known to rest.
    fn follow(
        &mut self,
        prior: Candidate,
        found: &Registered,
        errors: Errors,
        dt_s: f64,
        seeing: Seeing,
    ) -> bool {
        let Some(Candidate { mut motion, velocity_lag_m_s2, .. }) = corrected(prior, found, dt_s)
        else {
            return false;
        };
        self.velocity_lag_m_s2 = velocity_lag_m_s2;
        self.anchor.see(&motion, &self.centre, f64::from(self.radius_m()), seeing);
        if self.anchor.holds {
            motion.stop(self.anchor.since_s(seeing.now_s).max(dt_s));
            // From here on the place is a mean, which begins with this pose.
            motion.add_pose_noise(errors.position_m, errors.turn_rad);
            self.velocity_lag_m_s2 = Vector3::zeros();
        }
        self.motion = motion;
        true
    }

    /// A capture that does not show it says nothing against its rest.
    pub(super) fn stay_unseen(&mut self, dt_s: f64) {
        self.suspect = None;
        if let Some((mut motion, anchor)) = self.unseen.take() {
            motion.stay_unseen(dt_s);
            (self.motion, self.anchor) = (motion, anchor);
            self.velocity_lag_m_s2 = Vector3::zeros();
            self.predicted_still = true;
        }
    }

    /// Records the visible samples for the next capture.
    pub(super) fn record_view(&mut self, samples: &[Sample], is_occluded: bool) {
        let sum: Vector3<f64> = samples.iter().map(|s| s.point.coords.cast::<f64>()).sum();
        // Without samples the last view stays the reference.
        if !samples.is_empty() {
            self.visible_centroid = sum / samples.len() as f64 - self.motion.centre;
            self.visible_samples = samples.len();
            self.was_occluded = is_occluded;
        }
    }

    /// Adds samples to the surface. `grows`: all of them are the unit's, those of new sides too. New sides begin beside the known surface or
    /// near completed sides. Farther samples are of another body.
    pub(super) fn add(&mut self, samples: &[Sample], capture: u64, grows: bool) {
        if self.known.is_some() {
            return;
        }
        let pose = self.pose();
        let cell = self.surface.cell_m();
        let surface = &self.surface;
        let completed =
            self.shape.as_ref().map(|shape| shape.points.as_slice()).unwrap_or_default();
        let least = (COMPLETED_RADII * self.radius_m()).powi(2);
        let is_completed = |point: &Point3<f32>| {
            completed.iter().any(|other| (other - point).norm_squared() < least)
        };
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
                && (near.square_m2 < (MAX_GROWTH_CELLS * cell).powi(2) || is_completed(&point));
            (is_known || is_new).then_some((point, normal, sample.deviation_m))
        });
        let local: Vec<_> = local.collect();
        self.surface.add(capture, local.into_iter());
    }

    /// Whether it is hidden, and the samples are within reach of its prediction.
    pub(super) fn may_reappear_as(&self, samples: &[Sample]) -> bool {
        let radius = f64::from(self.radius_m());
        let reach = radius + (2.0 * self.motion.pose_deviation().0).min(2.0 * radius);
        let sum: Vector3<f64> = samples.iter().map(|s| s.point.coords.cast::<f64>()).sum();
        let middle = sum / samples.len().max(1) as f64;
        self.visibility == Visibility::Hidden && (middle - self.motion.centre).norm() < reach
    }

    /// Share of samples on its surface. A body that stands on it has few.
    pub(super) fn inlier_share(&self, samples: &[Sample]) -> f32 {
        let inverse = self.pose().inverse();
        let is_on_surface =
            samples.iter().filter(|sample| self.is_on_surface(sample, &inverse)).count();
        is_on_surface as f32 / samples.len().max(1) as f32
    }

    /// Whether a sample lies on its surface; `inverse` is the inverse of its pose.
    fn is_on_surface(&self, sample: &Sample, inverse: &Isometry3<f32>) -> bool {
        let (point, cell) = (inverse * sample.point, self.surface.cell_m());
        let limit = 3.0 * sample.deviation_m + INLIER_CELLS * cell;
        self.surface.nearest(&point).is_some_and(|near| {
            let off = near.surfel.normal.dot(&(point - near.surfel.point)).abs();
            off < limit && near.square_m2 < 2.0 * cell * cell
        })
    }

    /// Clusters of its samples off its surface, where another cluster of the same view lies on it: two bodies that were one unit separate.
    pub(super) fn foreign_clusters(
        &self,
        own: &[Sample],
        view_of: &HashMap<u32, usize>,
    ) -> Vec<u32> {
        let mut counts: BTreeMap<u32, (usize, usize)> = BTreeMap::new();
        let inverse = self.pose().inverse();
        for sample in own {
            let is_on_surface = self.is_on_surface(sample, &inverse);
            let (on, all) = counts.entry(sample.cluster).or_default();
            *on += usize::from(is_on_surface);
            *all += 1;
        }
        // A single cluster has nothing to be compared with.
        if counts.len() < 2 {
            return Vec::new();
        }
        let share = |(on, all): (usize, usize)| on as f32 / all.max(1) as f32;
        let is_foreign = |(cluster, count): (&u32, &(usize, usize))| {
            // Only within a view: clusters of another view show other sides, which need not be on the surface yet.
            let beside = counts.iter().any(|(other, found)| {
                other != cluster
                    && view_of.get(other) == view_of.get(cluster)
                    && share(*found) > 2.0 * MIN_FIT
            });
            beside && count.1 >= 20 && share(*count) < MIN_FIT
        };
        counts
            .iter()
            .filter(|entry| is_foreign((entry.0, entry.1)))
            .map(|(cluster, _)| *cluster)
            .collect()
    }

    /// Planes that it may stand on.
    pub(super) fn planes_under(&self, planes: &Planes) -> Vec<Plane> {
        let pose = self.pose();
        let surfels = self.surface.surfels().iter();
        planes.under(&(pose * self.centre).coords, |plane| {
            let heights =
                surfels.clone().map(|surfel| height_m(plane, &(pose * surfel.point).coords));
            heights.fold(f32::MAX, f32::min)
        })
    }

    /// Completes the shape for the model, and moves the centre to the shape's.
    pub(super) fn complete_shape(&mut self, planes: &Planes, options: &TrackerOptions) {
        if self.known.is_some() {
            return;
        }
        let pose = self.pose();
        let (completion, most) = (options.completion, options.model_points);
        let planes = self.planes_under(planes);
        let Some(shape) = Shape::new(&self.surface, completion, &pose, &planes, most) else {
            return;
        };
        let lever = pose.rotation * (shape.centre - self.centre);
        self.motion.move_centre(&lever.cast());
        if let Some(suspect) = &mut self.suspect {
            suspect.moving.motion.move_centre(&lever.cast());
        }
        self.visible_centroid -= lever.cast::<f64>();
        self.centre = shape.centre;
        self.shape = Some(shape);
    }

    /// From here on it is an object, which is at `place` in its frame.
    pub(super) fn become_known(&mut self, known: Known, place: &Isometry3<f32>) {
        // Its displacement is about another centre from here on.
        self.suspect = None;
        let object = &known.object;
        let centre = object.centre();
        let lever = self.pose() * (place * centre) - self.pose() * self.centre;
        self.motion.move_centre(&lever.cast());
        self.motion.rotation *= place.rotation.cast::<f64>();
        let [position, turn] = FOUND_DEVIATIONS;
        self.motion.add_pose_noise(position * f64::from(object.radius_m()), turn);
        self.visible_centroid -= lever.cast::<f64>();
        self.centre = centre;
        self.surface = Surface::known(object.elements(), object.spacing_m());
        let turned = |point: &Point3<f32>| object.principal() * point;
        self.shape = Some(Shape {
            points: object.points().iter().map(turned).collect(),
            centre,
            volume_m3: object.volume_m3(),
        });
        self.known = Some(known);
    }

    /// Whether it is that object.
    pub(super) fn is_object(&self, number: usize) -> bool {
        self.known.as_ref().is_some_and(|known| known.number == number)
    }

    /// Makes its track end with this capture. Its number is free.
    pub(super) fn end(&mut self) {
        (self.id, self.seen, self.missed) = (None, 0, u32::MAX);
    }

    /// Carries the frame in which the model has it to its own: that of principal axes, where those are known.
    pub(super) fn model_frame(&self) -> UnitQuaternion<f32> {
        self.known.as_ref().map_or_else(UnitQuaternion::identity, |known| known.object.principal())
    }

    /// Its estimate, once it is confirmed.
    pub(super) fn estimate(&self) -> Option<UnitEstimate> {
        let [_, velocity_covariance] = self.motion.covariances();
        let mut covariance = self.motion.pose_covariance() + self.errors.covariance() + self.drift;
        // It may be where the last capture shows it.
        if let Some(suspect) = &self.suspect {
            covariance += suspect.off * suspect.off.transpose();
        }
        Some(UnitEstimate {
            id: self.id?,
            pose: self.pose(),
            covariance: covariance.cast(),
            velocity: self.motion.velocity(),
            velocity_covariance,
            points: self.surface.points().clone(),
            visibility: self.visibility,
            rest: self.rest,
        })
    }
}

/// A prediction that a registration corrects. None where that is not possible.
fn corrected(prior: Candidate, found: &Registered, dt_s: f64) -> Option<Candidate> {
    let Candidate { mut motion, velocity_lag_m_s2, is_still } = prior;
    let surprise = match is_still {
        true => motion.surprise(&found.delta, &found.information),
        false => motion.normalised_innovation(&found.delta),
    };
    if surprise.is_some_and(|squared| squared > MAX_NORMALISED_INNOVATION) {
        motion.widen_for_impact(&found.delta, dt_s.max(1e-3));
    }
    let delta = match is_still {
        true => motion.posterior(&found.delta, &found.information)?,
        false => found.delta,
    };
    motion.correct(&delta, &found.information)?;
    Some(Candidate { motion, velocity_lag_m_s2, is_still })
}

/// Axis-aligned bounds of samples.
pub(super) fn bounds(samples: &[Sample]) -> Option<(Vector3<f32>, Vector3<f32>)> {
    let first = samples.first()?.point.coords;
    Some(samples.iter().fold((first, first), |(low, high), sample| {
        (low.inf(&sample.point.coords), high.sup(&sample.point.coords))
    }))
}
