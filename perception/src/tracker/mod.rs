//! Follows units from capture to capture.
//!
//! For each capture the tracker predicts the units, associates samples with them, registers their poses, and starts new tracks:
//!
//! 1. The model predicts each unit's pose at the capture's time: one step as long as the time since the last capture, or several equal
//!    ones where that is more than 1/20 s. Without a model, units fly freely.
//! 2. Support planes are found and refined ([`planes`](super::planes)), and the rest is sampled in clusters ([`sampling`](super::sampling)).
//! 3. Samples are associated with units by distance from the predicted surfaces. A cluster that covers two touching units is split.
//! 4. Each unit's pose is found by ICP from the prediction, with a covariance. A Kalman filter over the poses gives velocities.
//! 5. Samples are added to the units' surfaces. Reference points grow with them.
//! 6. Clusters of no unit start tracks, which are reported once several captures confirm them. Objects whose mesh is known are found in
//!    them ([`known`](super::known)).
//! 7. Units without a registration stay as predicted: hidden where they are occluded or out of view, else missed. Their tracks end after a
//!    bounded time.
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
mod errors;
mod fit;
mod hypotheses;
mod options;
mod rest;
mod support;
#[cfg(test)]
mod tests;
mod unit;
mod visibility;

use std::collections::HashMap;

use nalgebra::{Point3, Vector3};
use rayon::prelude::*;
use rigidformer_core::kernels::in_own_environment;
use rigidformer_core::{MAX_PLANES, Physics, Pieces, Plane};
use rigidformer_runtime::engine::Engine;
use rigidformer_runtime::memory::{self, Budget, TooLarge};
use rigidformer_runtime::pool;

use super::capture::{Capture, View};
use super::cloud::sample_cloud;
use super::depth_noise::DepthNoise;
use super::estimate::{Estimate, Rest, UnitEstimate, Visibility};
use super::forecast::{Forecaster, MovingUnit};
use super::known::KnownObject;
use super::motion::{Motion, ProcessNoise};
use super::planes::{Measurement, Planes};
use super::sampling::{Bounds, Sample, Sampled, Sampler, bytes_to_sample};
use super::surface::Surface;
use association::{Cluster, Owners, UNOWNED, associate, bodies};
use fit::{Fit, fit};
use hypotheses::{leave_rest, prefer, register_unit};
use rest::Seeing;
use unit::{Found, Known, TrackedUnit};

pub use super::forecast::ForecastError;
pub use super::sampling::Segmentation;
pub use super::shape::{Completion, volume_m3};
pub use options::{Forecast, LeftOut, Report, TrackError, TrackerOptions};

/// Longest step of the motion model, seconds.
const MAX_STEP_S: f64 = 0.05;
/// Steps to the next capture, at most. A longer gap takes longer steps.
// It bounds the time of a capture after a pause.
const MAX_STEPS: usize = 40;
/// Samples that start a track.
const MIN_NEW_SAMPLES: usize = 20;
/// Share of a cluster on a unit's surface from which it starts no track.
// It is a part of that unit which association missed.
const MAX_KNOWN_SHARE: f32 = 0.5;
/// Measurements of a view among which planes are searched, about.
// Planes are large, so a hundredth of an image suffices.
const PLANE_MEASUREMENTS: f32 = 3000.0;
/// Deviations of a lost object's place, beside its radius, within which it is found again.
// Beyond them it is another object of the same mesh, until its track ends.
const REACHED_DEVIATIONS: f32 = 3.0;
/// Objects that are known, at most.
// The search at the first sight grows with their number times that of the units.
const MAX_OBJECTS: usize = 64;
/// Coordinates beyond this are refused, metres.
const MAX_COORDINATE_M: f32 = 1e6;
/// Deviation of a position, in radii, from which the centroid of a cluster is another start of registration.
// ICP converges from errors well below the size of the body alone.
const MIN_MATCHED_DEVIATION: f64 = 0.35;
/// Horizon at which a forecast's uncertainty is checked, seconds.
const FORECAST_CHECK_S: f64 = 0.2;
/// Captures from which the velocity of a visible unit counts as known.
// Covariances allow for impacts at any time, and never fall below the bound of the check.
const SETTLED_CAPTURES: u32 = 4;
/// Process noise with a model and without one.
// Without a model every contact is process noise.
const MODEL_NOISE: ProcessNoise = ProcessNoise { linear: 0.15, angular: 0.4 };
const FREE_MOTION_NOISE: ProcessNoise = ProcessNoise { linear: 2.0, angular: 4.0 };

/// Tracks the units of a scene.
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
    /// (objects) Their surfaces, and the numbers of their units so far.
    objects: Vec<(Surface, Option<u32>)>,
}

impl Tracker {
    /// A tracker without units.
    ///
    /// # Errors
    /// [`TrackError::Options`].
    pub fn new(options: TrackerOptions) -> Result<Self, TrackError> {
        in_own_environment(|| Self::new_here(options))
    }

    fn new_here(options: TrackerOptions) -> Result<Self, TrackError> {
        check(&options)?;
        let forecaster = match &options.model {
            Some(model) => {
                let what = "the environment asks for kernels that this processor lacks";
                let engine = Engine::new().map_err(|_| TrackError::Options { what })?;
                Some(Forecaster::new(engine, model.clone(), options.network))
            }
            None => None,
        };
        let planes = match &options.planes {
            Some(planes) => Planes::given(planes.clone(), options.gravity_m_s2, options.seed),
            None => Planes::new(options.plane_physics, options.gravity_m_s2, options.seed),
        };
        let objects = options.objects.iter();
        let objects = objects.map(|one| (Surface::known(one.elements(), one.spacing_m()), None));
        Ok(Tracker {
            objects: objects.collect(),
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

    /// Updates the tracker with the next capture, and returns the estimate at its time.
    ///
    /// # Errors
    /// [`TrackError`] for a capture that cannot be one; the tracker is what it was.
    pub fn observe(&mut self, capture: &Capture) -> Result<&Estimate, TrackError> {
        if !pool::is_there() {
            return Err(TrackError::Threads);
        }
        pool::enter(|| in_own_environment(|| self.update(capture)))?;
        Ok(&self.estimate)
    }

    fn update(&mut self, capture: &Capture) -> Result<(), TrackError> {
        // A refused capture must change nothing, so all checks come first.
        self.check(capture)?;
        self.report = Report::default();
        let dt_s = self.last_s.map_or(0.0, |last| capture.time_s - last);
        self.predict_to(dt_s);
        let clusters = self.sample(capture);
        let samples = &self.samples;
        // A worker has what the thread had set that began the pool.
        let prefer = |unit: &mut TrackedUnit| prefer(unit, samples);
        self.units.par_iter_mut().for_each(|unit| in_own_environment(|| prefer(unit)));
        self.match_centroids(&clusters);
        let mut owners = associate(&self.units, &self.samples, &clusters);
        let foreign = self.register_all(&clusters, &owners, capture, dt_s);
        for (number, cluster) in clusters.iter().enumerate() {
            let first = self.samples.get(cluster.samples.start).map(|sample| sample.cluster);
            if first.is_some_and(|first| foreign.contains(&first))
                && let Some(free) = owners.free.get_mut(number)
            {
                *free = true;
            }
        }
        self.start_tracks(&clusters, &owners, capture.time_s);
        self.find_objects();
        self.confirm();
        self.end_tracks();
        self.find_supports();
        self.captures += 1;
        self.last_s = Some(capture.time_s);
        let mut units: Vec<UnitEstimate> =
            self.units.iter().filter_map(TrackedUnit::estimate).collect();
        units.sort_by_key(|unit| unit.id);
        self.estimate = Estimate { time_s: capture.time_s, units };
        Ok(())
    }

    /// The estimate of the last capture.
    pub fn estimate(&self) -> &Estimate {
        &self.estimate
    }

    /// The report of the last capture.
    pub fn report(&self) -> &Report {
        &self.report
    }

    /// Which of [`TrackerOptions::objects`] a unit is.
    pub fn object(&self, id: u32) -> Option<&KnownObject> {
        let unit = self.units.iter().find(|unit| unit.id == Some(id))?;
        unit.known.as_ref().map(|known| &known.object)
    }

    /// Support planes.
    pub fn planes(&self) -> &[Plane] {
        self.planes.all()
    }

    /// Points of the last capture that are of no plane, with normals.
    pub fn samples(&self) -> &[Sample] {
        &self.samples
    }

    /// The segments of a depth image of the last capture, by rows from the top: 0 where there is no body, a plane or no depth. Segments
    /// have numbers from 1 on. Empty for a cloud, and for a view that the capture does not have. (height * width)
    pub fn segments(&self, view: usize) -> Vec<u16> {
        let Some((sampler, _)) = self.samplers.get(view) else { return Vec::new() };
        let mut numbers: HashMap<u32, u16> = HashMap::new();
        let mut number = |cluster: u32| {
            let next = (numbers.len() + 1).min(usize::from(u16::MAX)) as u16;
            *numbers.entry(cluster).or_insert(next)
        };
        sampler.clusters().map(|cluster| cluster.map_or(0, &mut number)).collect()
    }

    /// Points of a unit for the model, in the unit's frame, metres: its observed surface, completed by hidden sides.
    pub fn shape(&self, id: u32) -> Option<&[Point3<f32>]> {
        let unit = self.units.iter().find(|unit| unit.id == Some(id))?;
        unit.shape.as_ref().map(|shape| shape.points.as_slice())
    }

    /// The centre that a unit's velocity and covariances are about, in the unit's frame, metres.
    pub fn centre(&self, id: u32) -> Option<Point3<f32>> {
        self.units.iter().find(|unit| unit.id == Some(id)).map(|unit| unit.centre)
    }

    /// The physics of a unit for the model: its mass is that of the hull of its [`shape`](Self::shape), or that of the object that it is.
    pub fn physics(&self, id: u32) -> Option<Physics> {
        let unit = self.units.iter().find(|unit| unit.id == Some(id))?;
        in_own_environment(|| physics_of(unit, &self.options))
    }

    /// Forecast of the units from the last capture on, in equal steps of about 1/24 s. The last step ends at `horizon_s`.
    ///
    /// # Errors
    /// [`ForecastError`] where the model refuses the scene, or a step. Without a model there is no forecast: nothing is predicted.
    pub fn predict(&mut self, horizon_s: f64) -> Result<Forecast, ForecastError> {
        in_own_environment(|| self.forecast(horizon_s))
    }

    fn forecast(&mut self, horizon_s: f64) -> Result<Forecast, ForecastError> {
        let steps = (horizon_s * 24.0).ceil().clamp(1.0, 4800.0);
        let step_s = horizon_s / steps;
        let mut forecast = Forecast { step_s, ..Forecast::default() };
        let Some(forecaster) = &mut self.forecaster else { return Ok(forecast) };
        // A horizon of 0 has no steps.
        if !(step_s.is_finite() && step_s > 0.0) {
            return Ok(forecast);
        }
        let mut ids = Vec::new();
        let mut frames = Vec::new();
        let mut moving = Vec::new();
        for unit in &self.units {
            let Some(id) = unit.id else { continue };
            let (position, _) = unit.motion.pose_deviation();
            // Beyond its own size the prediction may be of another place altogether.
            if position as f32 > unit.radius_m() && unit.visibility != Visibility::Seen {
                forecast.left_out.push((id, LeftOut::Lost));
                continue;
            }
            // A track that is hidden or new has a velocity by assumption.
            let is_vague = unit.visibility != Visibility::Seen || unit.seen < SETTLED_CAPTURES;
            if is_vague
                && unit.motion.position_deviation_after(FORECAST_CHECK_S) as f32
                    > 0.5 * unit.radius_m()
            {
                forecast.left_out.push((id, LeftOut::Uncertain));
                continue;
            }
            match as_moving(unit, &self.options) {
                Some(one) => {
                    ids.push(id);
                    frames.push(unit.model_frame().inverse());
                    moving.push(one);
                }
                None => forecast.left_out.push((id, LeftOut::TooFewPoints)),
            }
        }
        let (planes, gravity) = (self.planes.all(), &self.options.gravity_m_s2);
        let all = forecaster.steps(&moving, planes, gravity, step_s as f32, steps as usize)?;
        let named = |moved: Vec<super::forecast::PredictedUnit>| {
            let mut poses: Vec<_> = ids
                .iter()
                .zip(moved)
                .zip(&frames)
                .map(|((id, moved), frame)| (*id, moved.pose * frame))
                .collect();
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
        capture.views.iter().enumerate().try_for_each(|(number, view)| check_view(number, view))?;
        let mut budget = Budget::default();
        capture
            .views
            .iter()
            .try_for_each(|view| budget.take(bytes_to_sample(view)))
            .map_err(|TooLarge { needed, most }| TrackError::Memory { time_s, needed, most })
    }

    /// Moves all units to a capture's time.
    fn predict_to(&mut self, dt_s: f64) {
        if dt_s <= 0.0 || self.units.is_empty() {
            return;
        }
        let gravity = self.options.gravity_m_s2;
        let moved = self.forecaster.as_mut().and_then(|forecaster| {
            let steps = (dt_s / MAX_STEP_S).ceil().clamp(1.0, MAX_STEPS as f64) as usize;
            let step_s = (dt_s / steps as f64) as f32;
            let with: Vec<usize> = (0..self.units.len())
                .filter(|at| as_suspected(&self.units[*at], &self.options).is_some())
                .collect();
            let moving: Vec<MovingUnit<'_>> = with
                .iter()
                .filter_map(|at| as_suspected(&self.units[*at], &self.options))
                .collect();
            match forecaster.steps(&moving, self.planes.all(), &gravity, step_s, steps) {
                Ok(all) => all.into_iter().last().map(|moved| (with, moved)),
                Err(error) => {
                    self.report.forecast = Some(error);
                    None
                }
            }
        });
        let process_noise = if moved.is_some() { MODEL_NOISE } else { FREE_MOTION_NOISE };
        let (with, moved) = moved.unwrap_or_default();
        let mut moved = with.into_iter().zip(moved).peekable();
        let last_s = self.last_s.unwrap_or_default();
        for (at, unit) in self.units.iter_mut().enumerate() {
            let model = moved.next_if(|(number, _)| *number == at).map(|(_, moved)| moved);
            unit.predict(dt_s, last_s, &gravity, process_noise, model.as_ref());
        }
    }

    /// Says of all units whether they rest, and on what.
    fn find_supports(&mut self) {
        let planes = &self.planes;
        let under = |unit: &TrackedUnit| unit.planes_under(planes);
        let rests = support::rests(&self.units, under, &self.options.gravity_m_s2);
        for (unit, rest) in self.units.iter_mut().zip(rests) {
            unit.rest = rest;
        }
    }

    /// Updates the planes, and samples the other points.
    fn sample(&mut self, capture: &Capture) -> Vec<Cluster> {
        while self.samplers.len() < capture.views.len() {
            self.samplers.push((Sampler::default(), DepthNoise::default()));
        }
        // Buffers keep their memory, which an earlier capture with other large images may have asked for.
        let views = capture.views.iter().map(bytes_to_sample).chain(std::iter::repeat(0));
        let kept = self.samplers.iter().zip(views);
        let bytes: u64 = kept.map(|((sampler, _), now)| sampler.bytes().max(now)).sum();
        if bytes > memory::limit() {
            self.samplers.iter_mut().for_each(|(sampler, _)| *sampler = Sampler::default());
        }
        let mut measurements = Vec::new();
        for (view, (_, noise)) in capture.views.iter().zip(&mut self.samplers) {
            if let View::Depth(view) = view {
                noise.update(view);
            }
            add_measurements(view, noise, &mut measurements);
        }
        self.planes.update(&measurements);
        self.samples.clear();
        let (planes, options) = (&self.planes, &self.options);
        let all =
            capture.views.par_iter().zip(&mut self.samplers).map(|(view, (sampler, noise))| {
                in_own_environment(|| {
                    let mut own = Vec::new();
                    let how = options.segmentation;
                    let has_labels = match view {
                        View::Depth(view) => view.labels.is_some(),
                        View::Cloud(cloud) => cloud.labels.is_some(),
                    };
                    let labelled = how == Segmentation::Given && has_labels;
                    let most = Bounds { clusters: options.clusters, next: 0 };
                    let sampled = match view {
                        View::Depth(view) => {
                            sampler.sample(view, planes, noise, how, most, &mut own)
                        }
                        View::Cloud(cloud) => {
                            sample_cloud(cloud, planes, &mut sampler.segmenter, how, most, &mut own)
                        }
                    };
                    (sampled, own, labelled)
                })
            });
        let all: Vec<(Sampled, Vec<Sample>, bool)> = all.collect();
        let mut clusters = Vec::new();
        let mut next = 0;
        for (number, (mut sampled, mut own, labelled)) in all.into_iter().enumerate() {
            // Views are sampled side by side, and each begins to count at 0. Labels are the same in all views.
            if !labelled {
                own.iter_mut().for_each(|sample| sample.cluster += next);
                sampled.occluded.iter_mut().for_each(|cluster| *cluster += next);
                if let Some((sampler, _)) = self.samplers.get_mut(number) {
                    sampler.add_to_numbers(next);
                }
            }
            let first = self.samples.len();
            self.samples.extend(own);
            next += sampled.clusters;
            self.report.clusters += sampled.clusters as usize;
            self.report.clusters_left_out += sampled.left_out as usize;
            self.report.measured.push(sampled.measured);
            debug_assert!(first <= self.samples.len(), "{first} of {}", self.samples.len());
            let own = self.samples.get_mut(first..).unwrap_or_default();
            // Clusters become ranges of samples.
            own.sort_by_key(|sample| sample.cluster);
            let mut start = first;
            while start < self.samples.len() {
                let cluster = self.samples[start].cluster;
                let rest = self.samples[start..].iter();
                let end = start + rest.take_while(|sample| sample.cluster == cluster).count();
                let label = labelled.then_some(cluster);
                let is_occluded = sampled.occluded.binary_search(&cluster).is_ok();
                clusters.extend(Cluster::new(
                    number,
                    &self.samples,
                    start..end,
                    label,
                    is_occluded,
                ));
                start = end;
            }
        }
        self.report.samples = self.samples.len();
        clusters
    }

    /// Matches units of uncertain position with clusters by their centroids, nearest pairs first.
    fn match_centroids(&mut self, clusters: &[Cluster]) {
        let mut pairs = Vec::new();
        for (number, unit) in self.units.iter().enumerate() {
            let radius = f64::from(unit.radius_m());
            let (position, _) = unit.motion.pose_deviation();
            if position < MIN_MATCHED_DEVIATION * radius {
                continue;
            }
            let expected = unit.motion.centre + unit.visible_centroid;
            let reach = (2.0 * position).min(2.0 * radius);
            for (at, cluster) in clusters.iter().enumerate() {
                let off = cluster.centroid.cast::<f64>() - expected;
                // A cluster of about the unit's size may be the whole unit.
                let sizes = f64::from(cluster.extent_m) / (2.0 * radius).max(1e-9);
                if off.norm() < reach && (0.5..1.6).contains(&sizes) {
                    pairs.push((off.norm(), number, at, off));
                }
            }
        }
        pairs.sort_by(|a, b| a.0.total_cmp(&b.0));
        let mut taken = vec![false; clusters.len()];
        let mut shifts: Vec<Vec<(usize, Vector3<f64>)>> = vec![Vec::new(); self.units.len()];
        for (_, number, at, off) in pairs {
            let view = clusters[at].view;
            // A unit has at most one cluster of a view, and a cluster one unit.
            if !taken[at] && shifts[number].iter().all(|(other, _)| *other != view) {
                taken[at] = true;
                shifts[number].push((view, off));
            }
        }
        for (unit, offs) in self.units.iter_mut().zip(shifts) {
            if offs.is_empty() {
                continue;
            }
            let mean = offs.iter().map(|(_, off)| off).sum::<Vector3<f64>>() / offs.len() as f64;
            unit.centroid_shift = Some(mean);
        }
    }

    /// Registers all units, and adds their samples to their surfaces. Returns the clusters that turn out to belong to no unit.
    fn register_all(
        &mut self,
        clusters: &[Cluster],
        owners: &Owners,
        capture: &Capture,
        dt_s: f64,
    ) -> Vec<u32> {
        let mut own: Vec<Vec<Sample>> = vec![Vec::new(); self.units.len()];
        let mut grows = vec![true; self.units.len()];
        let mut is_occluded = vec![false; self.units.len()];
        for (number, cluster) in clusters.iter().enumerate() {
            let is_whole = owners.clusters.get(number).is_some_and(|owner| *owner != UNOWNED);
            for at in cluster.samples.clone() {
                let Some(owner) = owners.samples.get(at).filter(|owner| **owner != UNOWNED) else {
                    continue;
                };
                if let Some(own) = own.get_mut(*owner as usize) {
                    own.push(self.samples[at]);
                    grows[*owner as usize] &= is_whole;
                    is_occluded[*owner as usize] |= cluster.is_occluded;
                }
            }
        }
        // Near another unit, samples of new sides may belong to either.
        let spheres: Vec<(Vector3<f64>, f64)> = self
            .units
            .iter()
            .map(|unit| {
                (unit.motion.centre, f64::from(unit.radius_m()) + unit.motion.pose_deviation().0)
            })
            .collect();
        for (number, (centre, radius)) in spheres.iter().enumerate() {
            let touches = |(other, (position, reach)): (usize, &(Vector3<f64>, f64))| {
                other != number && (position - centre).norm() < radius + reach
            };
            grows[number] &= !spheres.iter().enumerate().any(touches);
        }
        let shift_m = f64::from(self.planes.shift_m());
        let now_s = capture.time_s;
        let seeing = |is_occluded: bool| Seeing { now_s, is_occluded, shift_m };
        for (unit, (own, (alone, is_occluded))) in
            self.units.iter_mut().zip(own.iter().zip(grows.iter().zip(&is_occluded)))
        {
            if *alone && !is_occluded {
                leave_rest(unit, own, dt_s, seeing(false));
            }
        }
        let found: Vec<Option<Found>> = self
            .units
            .par_iter()
            .zip(&own)
            .zip(grows.par_iter().zip(&is_occluded))
            .map(|((unit, own), (alone, is_occluded))| {
                in_own_environment(|| register_unit(unit, own, *alone && !is_occluded, shift_m))
            })
            .collect();
        let (planes, options, captures) = (&self.planes, &self.options, self.captures);
        let view_of: HashMap<u32, usize> = clusters
            .iter()
            .filter_map(|cluster| {
                let first = self.samples.get(cluster.samples.start)?;
                Some((first.cluster, cluster.view))
            })
            .collect();
        let work = self
            .units
            .par_iter_mut()
            .zip(found)
            .zip(own)
            .zip(grows.into_par_iter().zip(is_occluded));
        let foreign = work.map(|(((unit, found), mut own), (grows, is_occluded))| {
            in_own_environment(|| {
                unit.centroid_shift = None;
                unit.others.clear();
                let is_found =
                    found.is_some_and(|found| unit.correct(found, dt_s, seeing(is_occluded)));
                if !is_found {
                    unit.stay_unseen(dt_s);
                    let pose = unit.pose();
                    unit.visibility = visibility::visibility(&unit.surface, &pose, &capture.views);
                    match unit.visibility {
                        Visibility::Hidden => unit.hidden_s += dt_s,
                        _ => unit.missed = unit.missed.saturating_add(1),
                    }
                    return Vec::new();
                }
                // Where it is now is not known: its samples would lie beside its surface.
                if unit.suspect.is_some() {
                    return Vec::new();
                }
                let foreign_here = unit.foreign_clusters(&own, &view_of);
                if !foreign_here.is_empty() {
                    let inverse = unit.pose().inverse();
                    let removed: Vec<Point3<f32>> = own
                        .iter()
                        .filter(|sample| foreign_here.contains(&sample.cluster))
                        .map(|sample| inverse * sample.point)
                        .collect();
                    own.retain(|sample| !foreign_here.contains(&sample.cluster));
                    if unit.known.is_none() {
                        unit.surface.remove_near(&removed);
                    }
                }
                let (position, turn) = unit.motion.pose_deviation();
                // The far side of the surface moves by the rotation too.
                let off_m = position + f64::from(unit.radius_m()) * turn;
                let is_certain = off_m < 0.7 * f64::from(unit.surface.cell_m());
                unit.record_view(&own, is_occluded);
                // Points at an uncertain pose would smear the surface; a new unit has no surface yet.
                if unit.known.is_none() && (is_certain || unit.seen <= 3) {
                    unit.add(&own, captures, grows);
                    let pose = unit.pose();
                    let margin = 1.5 * unit.surface.cell_m();
                    unit.surface.remove_free_space(|surfel| {
                        visibility::is_in_free_space(surfel, &pose, &capture.views, margin)
                    });
                }
                unit.complete_shape(planes, options);
                foreign_here
            })
        });
        let foreign: Vec<Vec<u32>> = foreign.collect();
        self.report.seen =
            self.units.iter().filter(|unit| unit.visibility == Visibility::Seen).count();
        foreign.into_iter().flatten().collect()
    }

    /// Starts tracks of clusters without an owner.
    fn start_tracks(&mut self, clusters: &[Cluster], owners: &Owners, time_s: f64) {
        let [least, most] = self.options.extents_m;
        for body in bodies(&self.samples, clusters, &owners.free) {
            let ranges = body.iter().filter_map(|at| clusters.get(*at));
            let own: Vec<Sample> = ranges
                .flat_map(|cluster| self.samples.get(cluster.samples.clone()).unwrap_or_default())
                .copied()
                .collect();
            let extent = unit::bounds(&own).map_or(0.0, |(low, high)| (high - low).norm());
            // Clusters larger than any unit are scenery, and smaller ones are noise.
            if own.len() < MIN_NEW_SAMPLES || !(least..=most).contains(&extent) {
                self.report.clusters_of_other_sizes += 1;
                continue;
            }
            // An occluded cluster may be a hidden unit that reappears: it needs half of its size to be recognised.
            let is_occluded =
                body.iter().filter_map(|at| clusters.get(*at)).any(|one| one.is_occluded);
            if is_occluded && self.units.iter().any(|unit| unit.may_reappear_as(&own)) {
                continue;
            }
            // A cluster on the surface of a registered unit is a part of it.
            let is_known = |unit: &TrackedUnit| {
                unit.visibility == Visibility::Seen && unit.inlier_share(&own) > MAX_KNOWN_SHARE
            };
            if self.units.iter().any(is_known) {
                continue;
            }
            if self.units.len() >= self.options.units {
                self.report.clusters_left_out += 1;
                continue;
            }
            let planes = &self.planes;
            let now = (self.captures, time_s);
            self.units.extend(TrackedUnit::new(&own, now, planes, &self.options));
        }
    }

    /// Finds objects in units that are none yet. What is found becomes the object; where it had a number of its own, that ends.
    fn find_objects(&mut self) {
        let is_free = |number: &usize| {
            let is_seen = |unit: &TrackedUnit| unit.visibility == Visibility::Seen;
            !self.units.iter().any(|unit| unit.is_object(*number) && is_seen(unit))
        };
        let free: Vec<usize> = (0..self.objects.len()).filter(is_free).collect();
        // A surface that has not grown much is not searched again.
        let is_due = |unit: &TrackedUnit| {
            unit.known.is_none()
                && unit.visibility == Visibility::Seen
                && unit.seen.is_power_of_two()
        };
        let due: Vec<usize> = (0..self.units.len()).filter(|at| is_due(&self.units[*at])).collect();
        let pairs: Vec<(usize, usize)> =
            due.iter().flat_map(|unit| free.iter().map(move |object| (*unit, *object))).collect();
        let search = |(unit, number): &(usize, usize)| {
            let (object, (surface, _)) =
                (self.options.objects.get(*number)?, self.objects.get(*number)?);
            in_own_environment(|| fit(object, surface, &self.units.get(*unit)?.surface))
        };
        let found: Vec<Option<Fit>> = pairs.par_iter().map(search).collect();
        let found = pairs.into_iter().zip(found).filter_map(|(pair, fit)| Some((pair, fit?)));
        let mut found: Vec<((usize, usize), Fit, f32)> =
            found.filter_map(|(pair, fit)| Some((pair, fit, self.way_to(pair, &fit)?))).collect();
        // A stable sort: of equal ones the first stays first. Objects of one mesh fit alike, and each is sought where it was predicted.
        found.sort_by(|a, b| a.1.cost.total_cmp(&b.1.cost).then(a.2.total_cmp(&b.2)));
        let mut taken = vec![false; self.objects.len()];
        for ((unit, number), fit, _) in found {
            let object = self.options.objects.get(number).filter(|_| !taken[number]);
            let is_unknown = self.units.get(unit).is_some_and(|unit| unit.known.is_none());
            let Some(object) = object.filter(|_| is_unknown) else { continue };
            taken[number] = true;
            // It is here, and not where it was lost.
            self.units.iter_mut().filter(|unit| unit.is_object(number)).for_each(TrackedUnit::end);
            let Some(unit) = self.units.get_mut(unit) else { continue };
            unit.become_known(Known { number, object: object.clone() }, &fit.place);
            // Its frame is another one from here on.
            self.report.given_up.extend(unit.id.take());
        }
    }

    /// How far a fit of an object to a unit is from where that object is predicted, in how far it may be; 1 where nothing is predicted. None
    /// beyond that: it is another object.
    fn way_to(&self, (unit, number): (usize, usize), fit: &Fit) -> Option<f32> {
        let here = self.units.get(unit)?.pose() * fit.place;
        let Some(lost) = self.units.iter().find(|unit| unit.is_object(number)) else {
            return Some(1.0);
        };
        let off = (here * lost.centre).coords - lost.motion.centre.cast::<f32>();
        let reach = lost.radius_m() + REACHED_DEVIATIONS * lost.motion.pose_deviation().0 as f32;
        Some(off.norm() / reach).filter(|share| *share <= 1.0)
    }

    /// Gives numbers to units that enough captures show. An object that is found again has the number that it had.
    fn confirm(&mut self) {
        for unit in &mut self.units {
            if unit.id.is_none() && unit.seen >= self.options.confirm {
                let of_object = unit.known.as_ref().and_then(|k| self.objects.get_mut(k.number));
                let before = of_object.as_ref().and_then(|(_, id)| *id);
                let id = before.unwrap_or(self.next_id);
                unit.id = Some(id);
                self.report.appeared.push(id);
                if let Some((_, known)) = of_object {
                    *known = Some(id);
                }
                if before.is_none() {
                    self.next_id = self.next_id.saturating_add(1);
                }
            }
        }
    }

    /// Ends the tracks of units that are hidden or missed for too long.
    fn end_tracks(&mut self) {
        let (missed, hidden_s) = (self.options.missed, self.options.hidden_s);
        let given_up = &mut self.report.given_up;
        self.units.retain(|unit| {
            // Unconfirmed units are often noise, and end sooner.
            let is_new = unit.id.is_none();
            let is_missed_too_often = unit.missed > if is_new { 1 } else { missed };
            let is_hidden_too_long = unit.hidden_s > if is_new { 0.1 } else { hidden_s };
            let is_sound =
                unit.motion.centre.iter().all(|number| number.abs() < f64::from(MAX_COORDINATE_M));
            let stays = !is_missed_too_often && !is_hidden_too_long && is_sound;
            if !stays {
                given_up.extend(unit.id);
            }
            stays
        });
    }
}

/// A unit as the forecaster takes it; none without four points.
fn as_moving<'u>(unit: &'u TrackedUnit, options: &TrackerOptions) -> Option<MovingUnit<'u>> {
    let state = (&unit.motion, unit.velocity_lag_m_s2);
    as_in(unit, state, unit.rest == Rest::Held, options)
}

/// The same of a unit that left its place if it may have.
fn as_suspected<'u>(unit: &'u TrackedUnit, options: &TrackerOptions) -> Option<MovingUnit<'u>> {
    as_in(unit, unit.moving(), unit.rest == Rest::Held && unit.suspect.is_none(), options)
}

fn as_in<'u>(
    unit: &'u TrackedUnit,
    (motion, velocity_lag_m_s2): (&Motion, Vector3<f32>),
    is_held: bool,
    options: &TrackerOptions,
) -> Option<MovingUnit<'u>> {
    let shape = unit.shape.as_ref().filter(|shape| shape.points.len() >= 4)?;
    let velocity = motion.velocity();
    let object = unit.known.as_ref().map(|known| &known.object);
    let frame = unit.model_frame();
    Some(MovingUnit {
        points: object.map_or(&shape.points, |object| object.points()),
        pieces: object.map_or(Pieces::NONE, |object| object.pieces()),
        physics: physics_of(unit, options)?,
        inertia_kg_m2: object.map(|object| object.moments_kg_m2()),
        pose: motion.pose(&unit.centre) * frame,
        linear: velocity.fixed_rows::<3>(0).into_owned(),
        angular: velocity.fixed_rows::<3>(3).into_owned(),
        centre: frame.inverse() * unit.centre,
        velocity_lag_m_s2,
        is_held,
    })
}

/// What a unit is made of: an object has its own mass.
fn physics_of(unit: &TrackedUnit, options: &TrackerOptions) -> Option<Physics> {
    let physics = options.physics_of(unit.shape.as_ref()?.volume_m3);
    let mass_kg = unit.known.as_ref().map_or(physics.mass_kg, |known| known.object.mass_kg());
    Some(Physics { mass_kg, ..physics })
}

/// Adds the points of a view among which planes are searched.
pub(super) fn add_measurements(
    view: &View,
    noise: &DepthNoise,
    measurements: &mut Vec<Measurement>,
) {
    match view {
        View::Depth(view) => {
            let [width, height] = view.camera.size();
            let eye = view.camera.pose().translation.vector;
            let step = ((width * height) as f32 / PLANE_MEASUREMENTS).sqrt().max(1.0) as usize;
            for row in (0..height).step_by(step) {
                for column in (0..width).step_by(step) {
                    let at = row as usize * width as usize + column as usize;
                    let Some(steps) = view.depth.get(at).filter(|d| **d > 0 && **d < u16::MAX)
                    else {
                        continue;
                    };
                    let Some(point) = view.point(column, row) else { continue };
                    let towards = eye - point.coords;
                    measurements.push(Measurement {
                        point,
                        towards,
                        deviation_m: noise.deviation_m(*steps),
                    });
                }
            }
        }
        View::Cloud(cloud) => {
            let step = (cloud.points.len() as f32 / PLANE_MEASUREMENTS).ceil().max(1.0) as usize;
            let eye = cloud.sensor.map(|eye| eye.coords);
            let points = cloud.points.iter().step_by(step);
            for point in points.filter(|point| cloud.is_return(point)) {
                // Without the sensor's position the vertical is the likeliest direction.
                let towards = eye.map_or_else(Vector3::z, |eye| eye - point.coords);
                measurements.push(Measurement { point: *point, towards, deviation_m: 0.003 });
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
    } else if options.objects.len() > MAX_OBJECTS {
        "objects must be 64 or fewer"
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
            match crate::capture::SCALES_M.contains(&scale_m) {
                true => Ok(()),
                false => Err(TrackError::Scale { view: number, scale_m }),
            }
        }
        View::Cloud(cloud) => {
            wrong(cloud.points.len(), cloud.labels.as_ref().map(Vec::len))?;
            let is_bad =
                |point: &Point3<f32>| !point.iter().all(|number| number.abs() <= MAX_COORDINATE_M);
            match cloud.points.iter().position(is_bad) {
                Some(point) => Err(TrackError::Point { view: number, point }),
                None => Ok(()),
            }
        }
    }
}
