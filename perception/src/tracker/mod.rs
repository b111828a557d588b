//! Follows units from capture to capture.
//!
//! Of each capture the tracker predicts where units are, gives what was seen to them, finds their poses, and looks for new ones:
//!
//! 1. The model predicts each unit's pose at the capture's time: one step as long as the time since the last capture, or several equal
//!    ones where that is more than 1/20 s. Without a model, units fly freely.
//! 2. Support planes are found and refined ([`planes`](super::planes)), and the rest is sampled in clusters ([`sampling`](super::sampling)).
//! 3. Samples are given to units, by distance from the predicted surfaces. A cluster that covers two units that touch is split.
//! 4. Each unit's pose is found by ICP from the prediction, with a covariance. A Kalman filter over the poses gives velocities.
//! 5. What was seen is added to the units' surfaces. Reference points grow with them.
//! 6. Clusters that are no unit's are new units. They are told of when they have been seen in several captures.
//! 7. Units that were not seen go on as predicted: hidden where something is in front of them or they are out of view, else missed. They are
//!    given up after a bounded time.
//!
//! ```
//! use nalgebra::{Isometry3, Point3};
//! use rigidformer_perception::camera::Camera;
//! use rigidformer_perception::capture::{Capture, DepthView, View};
//! use rigidformer_perception::tracker::{Tracker, TrackerOptions};
//!
//! // A camera half a metre above a floor looks down at the top of a box, 20 cm high, that slides along.
//! let down = Isometry3::face_towards(&Point3::new(0.0, 0.0, 0.5), &Point3::origin(), &nalgebra::Vector3::y());
//! let camera = Camera::new([160, 120], [140.0; 2], [80.0, 60.0], down)?;
//! let image = |left: usize| -> Vec<u16> {
//!     let is_box = |at: usize| (left..left + 50).contains(&(at % 160)) && (40..90).contains(&(at / 160));
//!     (0..160 * 120).map(|at| if is_box(at) { 300 } else { 500 }).collect()
//! };
//! let mut tracker = Tracker::new(TrackerOptions::default())?;
//! for frame in 0..4 {
//!     let view = DepthView::new(camera, 0.001, image(40 + frame), None)?;
//!     tracker.observe(&Capture { time_s: frame as f64 / 30.0, views: vec![View::Depth(view)] })?;
//! }
//! assert_eq!(tracker.estimate().units.len(), 1);
//! assert_eq!(tracker.planes().len(), 1);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod association;
mod options;
mod sight;
#[cfg(test)]
mod tests;
mod unit;

use std::collections::HashMap;

use nalgebra::{Point3, Vector3};
use rayon::prelude::*;
use rigidformer_core::{MAX_PLANES, Physics, Plane};
use rigidformer_runtime::engine::Engine;

use super::capture::{Capture, View};
use super::cloud::sample_cloud;
use super::depth_noise::DepthNoise;
use super::estimate::{Estimate, Sight, UnitEstimate};
use super::forecast::{Forecaster, Moving};
use super::motion::{Motion, Unrest};
use super::planes::{Planes, Spot};
use super::registration::{Registered, moved, register};
use super::sampling::{Bounds, Sample, Sampler};
use association::{Cluster, NOBODY, Owners, associate, bodies};
use unit::TrackedUnit;

pub use super::forecast::ForecastError;
pub use super::sampling::Segmentation;
pub use super::shape::{Completion, volume_m3};
pub use options::{Forecast, LeftOut, Report, TrackError, TrackerOptions};

/// The longest step of the motion model, seconds.
const LONGEST_STEP_S: f64 = 0.05;
/// Steps to the next capture, at most. A longer time is gone through in longer steps.
const MOST_STEPS: usize = 40;
/// Samples that make a unit.
const LEAST_SAMPLES: usize = 20;
/// Samples that are needed to look for a unit.
const LEAST_SEEN: usize = 10;
/// Samples of which a larger share lies on a unit's surface are no new unit.
const KNOWN: f32 = 0.5;
/// Spots of a view that planes are looked for among.
const SPOTS: f32 = 3000.0;
/// Coordinates beyond this are refused, metres.
const FARTHEST_M: f32 = 1e6;
/// A place that is less certain than this part of the radius is looked for by the clusters' middles first.
const UNCERTAIN: f64 = 0.35;
/// What a cluster's middle says has to fit by so much better than the prediction.
const BETTER: f64 = 1.15;
/// A unit whose place in so many seconds is a guess is not predicted.
const AHEAD_S: f64 = 0.2;
/// Captures in which a unit was seen until its velocity counts as known while it is in view: covariances allow for hits at any time.
const SETTLED: u32 = 4;
/// How sure the model is of what it says of a contact: share of its change against free motion.
const CONTACT: f64 = 0.5;
/// Motion with a model to predict it, and without one.
const WITH_MODEL: Unrest = Unrest { linear: 0.15, angular: 0.4 };
const WITHOUT: Unrest = Unrest { linear: 2.0, angular: 4.0 };

/// Follows the units of a scene.
pub struct Tracker {
    options: TrackerOptions,
    forecaster: Option<Forecaster>,
    planes: Planes,
    samplers: Vec<(Sampler, DepthNoise)>,
    units: Vec<TrackedUnit>,
    estimate: Estimate,
    report: Report,
    /// Captures so far.
    captures: u64,
    last_s: Option<f64>,
    next_id: u32,
    samples: Vec<Sample>,
}

impl Tracker {
    /// A tracker that has seen nothing yet.
    ///
    /// # Errors
    /// [`TrackError::Options`].
    pub fn new(options: TrackerOptions) -> Result<Self, TrackError> {
        check(&options)?;
        let forecaster = match &options.model {
            Some(model) => {
                let what = "the environment asks for kernels that this processor lacks";
                let engine = Engine::new().map_err(|_| TrackError::Options { what })?;
                Some(Forecaster::new(engine, model.clone()))
            }
            None => None,
        };
        let planes = match &options.planes {
            Some(planes) => Planes::given(planes.clone(), options.gravity_m_s2, options.seed),
            None => Planes::new(options.plane_physics, options.gravity_m_s2, options.seed),
        };
        Ok(Tracker {
            options,
            forecaster,
            planes,
            samplers: Vec::new(),
            units: Vec::new(),
            estimate: Estimate { time_s: 0.0, units: Vec::new() },
            report: Report::default(),
            captures: 0,
            last_s: None,
            next_id: 1,
            samples: Vec::new(),
        })
    }

    /// Takes the next capture, and gives what is believed of the units at its time.
    ///
    /// # Errors
    /// [`TrackError`] for a capture that cannot be one; the tracker is what it was.
    pub fn observe(&mut self, capture: &Capture) -> Result<&Estimate, TrackError> {
        self.check(capture)?;
        self.report = Report::default();
        let dt_s = self.last_s.map_or(0.0, |last| capture.time_s - last);
        self.predict_to(dt_s);
        let clusters = self.sample(capture);
        let (samples, gravity) = (&self.samples, &self.options.gravity_m_s2);
        self.units.par_iter_mut().for_each(|unit| unit.prefer_free_motion(samples, gravity));
        self.place_by_middles(&clusters);
        let mut owners = associate(&self.units, &self.samples, &clusters);
        let strangers = self.register_all(&clusters, &owners, capture, dt_s);
        for (number, cluster) in clusters.iter().enumerate() {
            let first = self.samples.get(cluster.samples.start).map(|sample| sample.cluster);
            if first.is_some_and(|first| strangers.contains(&first))
                && let Some(free) = owners.free.get_mut(number)
            {
                *free = true;
            }
        }
        self.give_birth(&clusters, &owners);
        self.give_up();
        self.captures += 1;
        self.last_s = Some(capture.time_s);
        let mut units: Vec<UnitEstimate> =
            self.units.iter().filter_map(TrackedUnit::estimate).collect();
        units.sort_by_key(|unit| unit.id);
        self.estimate = Estimate { time_s: capture.time_s, units };
        Ok(&self.estimate)
    }

    /// What is believed since the last capture.
    pub fn estimate(&self) -> &Estimate {
        &self.estimate
    }

    /// What came of the last capture.
    pub fn report(&self) -> &Report {
        &self.report
    }

    /// Support planes.
    pub fn planes(&self) -> &[Plane] {
        self.planes.all()
    }

    /// Points of the last capture that are of no plane, with normals.
    pub fn samples(&self) -> &[Sample] {
        &self.samples
    }

    /// Points of a unit that the model gets, in the unit's frame, metres: what has been seen, and a guess at what has not.
    pub fn shape(&self, id: u32) -> Option<&[Point3<f32>]> {
        let unit = self.units.iter().find(|unit| unit.id == Some(id))?;
        unit.shape.as_ref().map(|shape| shape.points.as_slice())
    }

    /// The centre that a unit's velocity and covariances are about, in the unit's frame, metres.
    pub fn centre(&self, id: u32) -> Option<Point3<f32>> {
        self.units.iter().find(|unit| unit.id == Some(id)).map(|unit| unit.centre)
    }

    /// What the model takes a unit to be made of: its mass is that of the hull of its [`shape`](Self::shape).
    pub fn physics(&self, id: u32) -> Option<Physics> {
        let unit = self.units.iter().find(|unit| unit.id == Some(id))?;
        Some(self.options.physics_of(unit.shape.as_ref()?.volume_m3))
    }

    /// Where the model has the units in the time to come, from the last capture on: in equal steps of about 1/24 s, of which the last
    /// ends at `horizon_s`.
    ///
    /// # Errors
    /// [`ForecastError`] where the model refuses the scene, or a step. Without a model there is no forecast: nothing is predicted.
    pub fn predict(&mut self, horizon_s: f64) -> Result<Forecast, ForecastError> {
        let steps = (horizon_s * 24.0).ceil().clamp(1.0, 4800.0);
        let step_s = horizon_s / steps;
        let mut forecast = Forecast { step_s, ..Forecast::default() };
        let Some(forecaster) = &mut self.forecaster else { return Ok(forecast) };
        if !(step_s.is_finite() && step_s > 0.0) {
            return Ok(forecast);
        }
        let mut ids = Vec::new();
        let mut moving = Vec::new();
        for unit in &self.units {
            let Some(id) = unit.id else { continue };
            let (place, _) = unit.motion.spread();
            if place as f32 > unit.radius_m() && unit.sight != Sight::Seen {
                forecast.left_out.push((id, LeftOut::Lost));
                continue;
            }
            let is_vague = unit.sight != Sight::Seen || unit.seen < SETTLED;
            if is_vague && unit.motion.spread_after(AHEAD_S) as f32 > 0.5 * unit.radius_m() {
                forecast.left_out.push((id, LeftOut::Uncertain));
                continue;
            }
            match moves(unit, &self.options) {
                Some(one) => {
                    ids.push(id);
                    moving.push(one);
                }
                None => forecast.left_out.push((id, LeftOut::TooFewPoints)),
            }
        }
        let (planes, gravity) = (self.planes.all(), &self.options.gravity_m_s2);
        let all = forecaster.steps(&moving, planes, gravity, step_s as f32, steps as usize)?;
        let named = |moved: Vec<super::forecast::Moved>| {
            let mut poses: Vec<_> =
                ids.iter().zip(moved).map(|(id, moved)| (*id, moved.pose)).collect();
            poses.sort_by_key(|(id, _)| *id);
            poses
        };
        forecast.poses = all.into_iter().map(named).collect();
        Ok(forecast)
    }

    fn check(&self, capture: &Capture) -> Result<(), TrackError> {
        let time_s = capture.time_s;
        if !time_s.is_finite() {
            return Err(TrackError::Time);
        }
        if let Some(before_s) = self.last_s.filter(|last| time_s <= *last) {
            return Err(TrackError::Order { time_s, before_s });
        }
        if capture.views.is_empty() {
            return Err(TrackError::Empty { time_s });
        }
        capture.views.iter().enumerate().try_for_each(|(number, view)| check_view(number, view))
    }

    /// Moves all units to a capture's time.
    fn predict_to(&mut self, dt_s: f64) {
        if dt_s <= 0.0 || self.units.is_empty() {
            return;
        }
        let gravity = self.options.gravity_m_s2;
        let moved = self.forecaster.as_mut().and_then(|forecaster| {
            let steps = (dt_s / LONGEST_STEP_S).ceil().clamp(1.0, MOST_STEPS as f64) as usize;
            let step_s = (dt_s / steps as f64) as f32;
            let with: Vec<usize> = (0..self.units.len())
                .filter(|at| moves(&self.units[*at], &self.options).is_some())
                .collect();
            let moving: Vec<Moving<'_>> =
                with.iter().filter_map(|at| moves(&self.units[*at], &self.options)).collect();
            match forecaster.steps(&moving, self.planes.all(), &gravity, step_s, steps) {
                Ok(all) => all.into_iter().last().map(|moved| (with, moved)),
                Err(error) => {
                    self.report.forecast = Some(error);
                    None
                }
            }
        });
        let unrest = if moved.is_some() { WITH_MODEL } else { WITHOUT };
        let gravity = gravity.cast();
        self.units.iter_mut().for_each(|unit| unit.motion.fly(dt_s, &gravity, unrest));
        let Some((with, moved)) = moved else {
            return;
        };
        for (at, moved) in with.into_iter().zip(moved) {
            let Some(unit) = self.units.get_mut(at) else { continue };
            let predicted = Motion {
                centre: (moved.pose * unit.centre).coords.cast(),
                rotation: moved.pose.rotation.cast(),
                linear: moved.linear.cast(),
                angular: moved.angular.cast(),
                covariance: unit.motion.covariance,
            };
            unit.free = Some(unit.motion.clone());
            unit.motion.take(&predicted, CONTACT, dt_s);
            unit.lag_m_s2 = moved.lag_m_s2;
        }
    }

    /// Finds planes, and samples what is left.
    fn sample(&mut self, capture: &Capture) -> Vec<Cluster> {
        while self.samplers.len() < capture.views.len() {
            self.samplers.push((Sampler::default(), DepthNoise::default()));
        }
        let mut spots = Vec::new();
        for (view, (_, noise)) in capture.views.iter().zip(&mut self.samplers) {
            if let View::Depth(view) = view {
                noise.look(view);
            }
            add_spots(view, noise, &mut spots);
        }
        self.planes.look(&spots);
        self.samples.clear();
        let mut clusters = Vec::new();
        let mut next = 0;
        for (number, (view, (sampler, noise))) in
            capture.views.iter().zip(&mut self.samplers).enumerate()
        {
            let first = self.samples.len();
            let bounds = Bounds { clusters: self.options.clusters, next };
            let planes = &self.planes;
            let (options, samples) = (&self.options, &mut self.samples);
            let (sampled, labelled) = match view {
                View::Depth(view) => {
                    let labelled =
                        options.segmentation == Segmentation::Given && view.labels.is_some();
                    let how = options.segmentation;
                    (sampler.sample(view, planes, noise, how, bounds, samples), labelled)
                }
                View::Cloud(cloud) => {
                    let labelled =
                        options.segmentation == Segmentation::Given && cloud.labels.is_some();
                    (
                        sample_cloud(cloud, planes.all(), options.segmentation, bounds, samples),
                        labelled,
                    )
                }
            };
            next += sampled.clusters;
            self.report.clusters += sampled.clusters as usize;
            self.report.clusters_left_out += sampled.left_out as usize;
            self.report.measured.push(sampled.measured);
            let own = self.samples.get_mut(first..).unwrap_or_default();
            own.sort_by_key(|sample| sample.cluster);
            let mut start = first;
            while start < self.samples.len() {
                let cluster = self.samples[start].cluster;
                let rest = self.samples[start..].iter();
                let end = start + rest.take_while(|sample| sample.cluster == cluster).count();
                let label = labelled.then_some(cluster);
                let is_cut = sampled.cut.binary_search(&cluster).is_ok();
                clusters.extend(Cluster::new(number, &self.samples, start..end, label, is_cut));
                start = end;
            }
        }
        self.report.samples = self.samples.len();
        clusters
    }

    /// Moves units whose place is not certain to the cluster that is where they should be.
    fn place_by_middles(&mut self, clusters: &[Cluster]) {
        let mut pairs = Vec::new();
        for (number, unit) in self.units.iter().enumerate() {
            let radius = f64::from(unit.radius_m());
            let (place, _) = unit.motion.spread();
            if place < UNCERTAIN * radius {
                continue;
            }
            let expected = unit.motion.centre + unit.seen_at;
            let reach = (2.0 * place).min(2.0 * radius);
            for (at, cluster) in clusters.iter().enumerate() {
                let off = cluster.middle.cast::<f64>() - expected;
                let sizes = f64::from(cluster.extent_m) / (2.0 * radius).max(1e-9);
                if off.norm() < reach && (0.5..1.6).contains(&sizes) {
                    pairs.push((off.norm(), number, at, off));
                }
            }
        }
        pairs.sort_by(|a, b| a.0.total_cmp(&b.0));
        let mut taken = vec![false; clusters.len()];
        let mut placed: Vec<Vec<(usize, Vector3<f64>)>> = vec![Vec::new(); self.units.len()];
        for (_, number, at, off) in pairs {
            let view = clusters[at].view;
            if !taken[at] && placed[number].iter().all(|(other, _)| *other != view) {
                taken[at] = true;
                placed[number].push((view, off));
            }
        }
        for (unit, offs) in self.units.iter_mut().zip(placed) {
            if offs.is_empty() {
                continue;
            }
            let mean = offs.iter().map(|(_, off)| off).sum::<Vector3<f64>>() / offs.len() as f64;
            unit.guess = Some(mean);
        }
    }

    /// Finds the poses of all units, and adds what was seen to them. Gives the clusters that turned out to be of none.
    fn register_all(
        &mut self,
        clusters: &[Cluster],
        owners: &Owners,
        capture: &Capture,
        dt_s: f64,
    ) -> Vec<u32> {
        let mut own: Vec<Vec<Sample>> = vec![Vec::new(); self.units.len()];
        let mut grows = vec![true; self.units.len()];
        let mut is_cut = vec![false; self.units.len()];
        for (number, cluster) in clusters.iter().enumerate() {
            let is_whole = owners.clusters.get(number).is_some_and(|owner| *owner != NOBODY);
            for at in cluster.samples.clone() {
                let Some(owner) = owners.samples.get(at).filter(|owner| **owner != NOBODY) else {
                    continue;
                };
                if let Some(own) = own.get_mut(*owner as usize) {
                    own.push(self.samples[at]);
                    grows[*owner as usize] &= is_whole;
                    is_cut[*owner as usize] |= cluster.is_cut;
                }
            }
        }
        // Beside another unit nothing is certain to be the one's and not the other's.
        let spheres: Vec<(Vector3<f64>, f64)> = self
            .units
            .iter()
            .map(|unit| (unit.motion.centre, f64::from(unit.radius_m()) + unit.motion.spread().0))
            .collect();
        for (number, (centre, radius)) in spheres.iter().enumerate() {
            let touches = |(other, (place, reach)): (usize, &(Vector3<f64>, f64))| {
                other != number && (place - centre).norm() < radius + reach
            };
            grows[number] &= !spheres.iter().enumerate().any(touches);
        }
        let found: Vec<Option<(Motion, Registered)>> = self
            .units
            .par_iter()
            .zip(&own)
            .zip(grows.par_iter().zip(&is_cut))
            .map(|((unit, own), (alone, is_cut))| find(unit, own, *alone && !is_cut))
            .collect();
        let (planes, options, captures) = (&self.planes, &self.options, self.captures);
        let view_of: HashMap<u32, usize> = clusters
            .iter()
            .filter_map(|cluster| {
                let first = self.samples.get(cluster.samples.start)?;
                Some((first.cluster, cluster.view))
            })
            .collect();
        let work =
            self.units.par_iter_mut().zip(found).zip(own).zip(grows.into_par_iter().zip(is_cut));
        let strangers = work.map(|(((unit, found), mut own), (grows, is_cut))| {
            unit.guess = None;
            unit.free = None;
            let is_found = found.is_some_and(|(prior, found)| {
                unit.motion = prior;
                unit.correct(&found, dt_s)
            });
            if !is_found {
                let pose = unit.pose();
                unit.sight = sight::sight(&unit.surface, &pose, &capture.views);
                match unit.sight {
                    Sight::Hidden => unit.hidden_s += dt_s,
                    _ => unit.missed = unit.missed.saturating_add(1),
                }
                return Vec::new();
            }
            let strange = unit.strangers(&own, &view_of);
            if !strange.is_empty() {
                let inverse = unit.pose().inverse();
                let gone: Vec<Point3<f32>> = own
                    .iter()
                    .filter(|sample| strange.contains(&sample.cluster))
                    .map(|sample| inverse * sample.point)
                    .collect();
                own.retain(|sample| !strange.contains(&sample.cluster));
                unit.surface.drop_near(&gone);
            }
            let (place, turn) = unit.motion.spread();
            let off_m = place + f64::from(unit.radius_m()) * turn;
            let is_certain = off_m < 0.7 * f64::from(unit.surface.cell_m());
            unit.remember(&own, is_cut);
            if is_certain || unit.seen <= 3 {
                unit.add(&own, captures, grows);
                let pose = unit.pose();
                let margin = 1.5 * unit.surface.cell_m();
                unit.surface
                    .carve(|surfel| sight::is_seen_through(surfel, &pose, &capture.views, margin));
            }
            unit.reshape(planes, options);
            strange
        });
        let strangers: Vec<Vec<u32>> = strangers.collect();
        self.report.seen = self.units.iter().filter(|unit| unit.sight == Sight::Seen).count();
        strangers.into_iter().flatten().collect()
    }

    /// Makes units of what is nobody's.
    fn give_birth(&mut self, clusters: &[Cluster], owners: &Owners) {
        let [least, most] = self.options.extents_m;
        for body in bodies(&self.samples, clusters, &owners.free) {
            let ranges = body.iter().filter_map(|at| clusters.get(*at));
            let own: Vec<Sample> = ranges
                .flat_map(|cluster| self.samples.get(cluster.samples.clone()).unwrap_or_default())
                .copied()
                .collect();
            let extent = unit::bounds(&own).map_or(0.0, |(low, high)| (high - low).norm());
            // What is larger than any unit is scenery.
            if own.len() < LEAST_SAMPLES || !(least..=most).contains(&extent) {
                self.report.clusters_of_other_sizes += 1;
                continue;
            }
            // What comes out from behind something may be a unit that is hidden. Half of it has to be out to be known by its size.
            let is_cut = body.iter().filter_map(|at| clusters.get(*at)).any(|one| one.is_cut);
            if is_cut && self.units.iter().any(|unit| unit.may_come_out_as(&own)) {
                continue;
            }
            // What lies on a unit that was just found is a part of it.
            let is_known =
                |unit: &TrackedUnit| unit.sight == Sight::Seen && unit.fits(&own) > KNOWN;
            if self.units.iter().any(is_known) {
                continue;
            }
            if self.units.len() >= self.options.units {
                self.report.clusters_left_out += 1;
                continue;
            }
            let planes = &self.planes;
            self.units.extend(TrackedUnit::new(&own, self.captures, planes, &self.options));
        }
        for unit in &mut self.units {
            if unit.id.is_none() && unit.seen >= self.options.confirm {
                unit.id = Some(self.next_id);
                self.report.appeared.push(self.next_id);
                self.next_id = self.next_id.saturating_add(1);
            }
        }
    }

    /// Forgets units that have not been seen for too long.
    fn give_up(&mut self) {
        let (missed, hidden_s) = (self.options.missed, self.options.hidden_s);
        let given_up = &mut self.report.given_up;
        self.units.retain(|unit| {
            let is_new = unit.id.is_none();
            let lost = unit.missed > if is_new { 1 } else { missed };
            let gone = unit.hidden_s > if is_new { 0.1 } else { hidden_s };
            let is_sound =
                unit.motion.centre.iter().all(|number| number.abs() < f64::from(FARTHEST_M));
            let stays = !lost && !gone && is_sound;
            if !stays {
                given_up.extend(unit.id);
            }
            stays
        });
    }
}

/// Finds a unit among its samples: from where it is predicted, and from where a cluster's middle says it is.
fn find(unit: &TrackedUnit, own: &[Sample], is_plain: bool) -> Option<(Motion, Registered)> {
    if own.len() < LEAST_SEEN {
        return None;
    }
    let mut best: Option<(Motion, Registered)> = None;
    // Beside another unit, or behind something, the middle of what is seen may be anywhere.
    let middle = if is_plain { unit.middle(own) } else { None };
    let shifts = [Some(Vector3::zeros()), unit.guess];
    for shift in shifts.into_iter().flatten() {
        let start = Motion { centre: unit.motion.centre + shift, ..unit.motion.clone() };
        let Some(mut found) = register(&unit.surface, &unit.centre, own, middle.as_ref(), &start)
        else {
            continue;
        };
        // The filter counts from its own prediction.
        for axis in 0..3 {
            found.delta[axis] += shift[axis];
        }
        let is_better = best.as_ref().is_none_or(|(_, best)| worth(&found) > BETTER * worth(best));
        if is_better {
            best = Some((unit.motion.clone(), found));
        }
    }
    let (prior, found) = best.filter(|(_, found)| found.share > 0.3 && found.residual < 6.0)?;
    // A contact that the model predicts may not happen: what has not been seen of a body is a guess. Free motion counts where it fits
    // better.
    let Some(free) = &unit.free else { return Some((prior, found)) };
    let at = moved(&prior, &found.delta);
    let delta = free.to(&at);
    if free.likelihood(&delta, &found.information)
        > prior.likelihood(&found.delta, &found.information)
    {
        return Some((free.clone(), Registered { delta, ..found }));
    }
    Some((prior, found))
}

fn worth(found: &Registered) -> f64 {
    found.share / found.residual.max(1.0)
}

/// A unit as the model takes it.
fn moves<'u>(unit: &'u TrackedUnit, options: &TrackerOptions) -> Option<Moving<'u>> {
    let shape = unit.shape.as_ref().filter(|shape| shape.points.len() >= 4)?;
    let velocity = unit.motion.velocity();
    Some(Moving {
        points: &shape.points,
        physics: options.physics_of(shape.volume_m3),
        pose: unit.pose(),
        linear: velocity.fixed_rows::<3>(0).into_owned(),
        angular: velocity.fixed_rows::<3>(3).into_owned(),
        centre: unit.centre,
        lag_m_s2: unit.lag_m_s2,
    })
}

/// Points of a view for planes to be looked for among.
fn add_spots(view: &View, noise: &DepthNoise, spots: &mut Vec<Spot>) {
    match view {
        View::Depth(view) => {
            let [width, height] = view.camera.size();
            let eye = view.camera.pose().translation.vector;
            let step = ((width * height) as f32 / SPOTS).sqrt().max(1.0) as usize;
            for row in (0..height).step_by(step) {
                for column in (0..width).step_by(step) {
                    let at = row as usize * width as usize + column as usize;
                    let Some(steps) = view.depth.get(at).filter(|d| **d > 0 && **d < u16::MAX)
                    else {
                        continue;
                    };
                    let Some(point) = view.point(column, row) else { continue };
                    let towards = eye - point.coords;
                    spots.push(Spot { point, towards, deviation_m: noise.deviation_m(*steps) });
                }
            }
        }
        View::Cloud(cloud) => {
            let step = (cloud.points.len() as f32 / SPOTS).ceil().max(1.0) as usize;
            let eye = cloud.sensor.map(|eye| eye.coords);
            for point in cloud.points.iter().step_by(step) {
                // From above, where nobody says from where.
                let towards = eye.map_or_else(Vector3::z, |eye| eye - point.coords);
                spots.push(Spot { point: *point, towards, deviation_m: 0.003 });
            }
        }
    }
}

fn check(options: &TrackerOptions) -> Result<(), TrackError> {
    let numbers = options.first_velocity.iter().chain(&options.extents_m);
    let is_positive = |number: &f32| number.is_finite() && *number > 0.0;
    let coefficient = |number: &f32| (0.0..=1e3).contains(number);
    let what = if options.planes.as_ref().is_some_and(|planes| planes.len() > MAX_PLANES) {
        "planes must be 8 or fewer"
    } else if options.planes.iter().flatten().any(|plane| !plane.is_sound()) {
        "a plane must have a normal of length 1 and finite numbers"
    } else if !numbers.clone().all(is_positive) || options.extents_m[0] >= options.extents_m[1] {
        "first_velocity and extents_m must be above 0, and the extents must rise"
    } else if !options.gravity_m_s2.iter().all(|g| g.is_finite()) {
        "gravity_m_s2 must be finite"
    } else if !(8..=256).contains(&options.model_points) {
        "model_points must be 8 to 256"
    } else if options.confirm == 0 || options.units == 0 || options.clusters == 0 {
        "confirm, units and clusters must be at least 1"
    } else if options.hidden_s.is_nan() || options.hidden_s < 0.0 {
        "hidden_s must be at least 0"
    } else if !options.plane_physics.iter().all(coefficient)
        || !options.unit_physics.iter().all(coefficient)
        || !(1e-3..=1e6).contains(&options.density_kg_m3)
    {
        "density_kg_m3 must be 0.001 to 1e6, frictions and restitutions 0 to 1000"
    } else {
        return Ok(());
    };
    Err(TrackError::Options { what })
}

fn check_view(number: usize, view: &View) -> Result<(), TrackError> {
    let wrong = |expected: usize, given: Option<usize>| match given {
        Some(given) if given != expected => Err(TrackError::Size { view: number, expected, given }),
        _ => Ok(()),
    };
    match view {
        View::Depth(view) => {
            let [width, height] = view.camera.size();
            let pixels = width as usize * height as usize;
            wrong(pixels, Some(view.depth.len()))?;
            wrong(pixels, view.labels.as_ref().map(Vec::len))?;
            let scale_m = view.scale_m;
            match scale_m.is_finite() && scale_m > 0.0 {
                true => Ok(()),
                false => Err(TrackError::Scale { view: number, scale_m }),
            }
        }
        View::Cloud(cloud) => {
            wrong(cloud.points.len(), cloud.labels.as_ref().map(Vec::len))?;
            let is_bad =
                |point: &Point3<f32>| !point.iter().all(|number| number.abs() <= FARTHEST_M);
            match cloud.points.iter().position(is_bad) {
                Some(point) => Err(TrackError::Point { view: number, point }),
                None => Ok(()),
            }
        }
    }
}
