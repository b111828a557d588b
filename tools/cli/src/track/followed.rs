//! What came of a recording.

use std::collections::{BTreeMap, BTreeSet};
use std::time::{Duration, Instant as Clock};

use nalgebra::Point3;
use rigidformer_core::Plane;
use rigidformer_evaluation::score::Prediction;
use rigidformer_evaluation::segments::{self, SegmentsScore};
use rigidformer_perception::capture::{Capture, Facts, View};
use rigidformer_perception::estimate::{Estimate, Rest, UnitEstimate, Visibility};
use rigidformer_perception::tracker::{Report, Tracker};

use crate::picture::Instant;

/// How far ahead predictions are scored, seconds: the last, and in the middle.
pub(super) const SCORED_S: f64 = 0.4;
/// How far ahead the picture looks, seconds.
const SHOWN_S: f64 = 1.0;
/// Predictions are scored from every so many captures.
const EVERY: u64 = 3;
/// Instants of the picture.
const INSTANTS: usize = 4;
/// Instants that are kept for the picture while nobody knows how many captures come.
const KEPT: usize = 16;
/// Points of an instant that are drawn.
const DRAWN: usize = 4000;

/// What came of a recording.
#[derive(Default)]
pub(super) struct Followed {
    pub(super) estimates: Vec<Estimate>,
    /// Points of each unit that the model got last, in the unit's frame.
    pub(super) shapes: BTreeMap<u32, Vec<Point3<f32>>>,
    /// Names of the units that are known objects.
    pub(super) objects: BTreeMap<u32, String>,
    pub(super) planes: Vec<Plane>,
    pub(super) predictions: Vec<Prediction>,
    /// Of every so many captures.
    pub(super) instants: Vec<Instant>,
    pub(super) every: usize,
    pub(super) took: Duration,
    pub(super) slowest: Duration,
    pub(super) clusters_left_out: usize,
    pub(super) blind: usize,
    pub(super) without_forecast: usize,
    pub(super) left_out: usize,
    pub(super) facts: Facts,
    /// Of each depth image with labels, where they are the truth.
    pub(super) segments: Vec<SegmentsScore>,
    /// Samples of all captures, clusters that are too large or too small for units, and the clusters of the capture with most.
    pub(super) samples: usize,
    pub(super) of_other_sizes: usize,
    pub(super) most_clusters: usize,
}

impl Followed {
    /// Follows a capture further; `predicts` what is scored.
    pub(super) fn take(
        &mut self,
        tracker: &mut Tracker,
        capture: &Capture,
        predicts: bool,
    ) -> anyhow::Result<()> {
        self.facts.add(capture);
        let started = Clock::now();
        let estimate = tracker.observe(capture)?.clone();
        let took = started.elapsed();
        self.took += took;
        self.slowest = self.slowest.max(took);
        self.note(tracker.report());
        for unit in &estimate.units {
            if let Some(points) = tracker.shape(unit.id) {
                self.shapes.insert(unit.id, points.to_vec());
            }
            if let Some(object) = tracker.object(unit.id) {
                self.objects.entry(unit.id).or_insert_with(|| object.name().to_owned());
            }
        }
        let number = self.estimates.len() as u64;
        if predicts && number.is_multiple_of(EVERY) {
            self.predict(tracker, estimate.time_s)?;
        }
        self.show(tracker, &estimate)?;
        self.estimates.push(estimate);
        Ok(())
    }

    /// Scores the segments of the capture that the tracker took last by its labels.
    pub(super) fn score_segments(
        &mut self,
        tracker: &Tracker,
        capture: &Capture,
    ) -> anyhow::Result<()> {
        for (number, view) in capture.views.iter().enumerate() {
            if let View::Depth(view) = view {
                self.segments.extend(segments::of_view(view, &tracker.segments(number))?);
            }
        }
        Ok(())
    }

    fn note(&mut self, report: &Report) {
        self.clusters_left_out += report.clusters_left_out;
        self.samples += report.samples;
        self.of_other_sizes += report.clusters_of_other_sizes;
        self.most_clusters = self.most_clusters.max(report.clusters);
        self.blind += usize::from(report.is_blind());
        self.without_forecast += usize::from(report.forecast.is_some());
    }

    /// Predictions that are scored.
    fn predict(&mut self, tracker: &mut Tracker, made_at_s: f64) -> anyhow::Result<()> {
        let forecast = tracker.predict(SCORED_S)?;
        self.left_out += forecast.left_out.len();
        let count = forecast.poses.len();
        for (sample, poses) in forecast.poses.into_iter().enumerate() {
            if 2 * (sample + 1) == count || sample + 1 == count {
                let time_s = made_at_s + forecast.step_s * (sample + 1) as f64;
                self.predictions.push(Prediction { made_at_s, time_s, poses });
            }
        }
        Ok(())
    }

    /// Keeps an instant for the picture; half of them go when there are too many.
    fn show(&mut self, tracker: &mut Tracker, estimate: &Estimate) -> anyhow::Result<()> {
        self.every = self.every.max(1);
        if !self.estimates.len().is_multiple_of(self.every) {
            return Ok(());
        }
        if self.instants.len() == KEPT {
            let mut number = 0;
            self.instants.retain(|_| {
                number += 1;
                number % 2 == 1
            });
            self.every *= 2;
            if !self.estimates.len().is_multiple_of(self.every) {
                return Ok(());
            }
        }
        let samples = tracker.samples();
        let step = samples.len().div_ceil(DRAWN).max(1);
        let seen = samples.iter().step_by(step).map(|sample| sample.point).collect();
        let forecast = tracker.predict(SHOWN_S)?;
        self.instants.push(Instant {
            time_s: estimate.time_s,
            seen,
            followed: estimate.units.iter().map(|unit| (unit.id, unit.pose)).collect(),
            ahead_s: SHOWN_S,
            predicted: forecast.poses.into_iter().last().unwrap_or_default(),
        });
        Ok(())
    }

    /// Instants that are drawn: evenly spaced, the last one the last.
    pub(super) fn shown(&self) -> Vec<Instant> {
        let last = self.instants.len().saturating_sub(1);
        let mut chosen: Vec<usize> =
            (1..=INSTANTS).map(|k| (last * k).div_ceil(INSTANTS)).collect();
        chosen.dedup();
        chosen.into_iter().filter_map(|at| self.instants.get(at).cloned()).collect()
    }

    pub(super) fn milliseconds(&self) -> f64 {
        self.took.as_secs_f64() * 1e3 / self.estimates.len().max(1) as f64
    }

    /// The last estimate of a unit.
    pub(super) fn last_of(&self, id: u32) -> Option<&UnitEstimate> {
        let of = |estimate: &'_ Estimate| estimate.units.iter().position(|unit| unit.id == id);
        let mut newest = self.estimates.iter().rev();
        newest.find_map(|estimate| estimate.units.get(of(estimate)?))
    }

    /// Units that were held still at some time because nothing was seen that carries them.
    pub(super) fn held(&self) -> usize {
        let all = self.estimates.iter().flat_map(|estimate| &estimate.units);
        let held = all.filter(|unit| unit.rest == Rest::Held).map(|unit| unit.id);
        held.collect::<BTreeSet<_>>().len()
    }

    /// Units that were followed: number, first and last time, captures in which each was seen.
    pub(super) fn units(&self) -> Vec<(u32, f64, f64, usize)> {
        let mut units: BTreeMap<u32, (f64, f64, usize)> = BTreeMap::new();
        for estimate in &self.estimates {
            for unit in &estimate.units {
                let entry = units.entry(unit.id).or_insert((estimate.time_s, 0.0, 0));
                entry.1 = estimate.time_s;
                entry.2 += usize::from(unit.visibility == Visibility::Seen);
            }
        }
        units.into_iter().map(|(id, (first, last, seen))| (id, first, last, seen)).collect()
    }
}
