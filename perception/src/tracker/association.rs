//! Which unit each sample is of.
//!
//! A sample votes for the unit whose predicted surface it is nearest to. A cluster in which one unit has the votes is that unit's as a whole,
//! so that sides that come into view belong to it. A cluster with votes for several units is split between them, sample by sample: units
//! that touch stay apart.

use std::ops::Range;

use nalgebra::Vector3;
use rayon::prelude::*;

use super::unit::{TrackedUnit, bounds};
use crate::sampling::Sample;

/// A unit has a part in a cluster from this share of the votes on.
const PART: f32 = 0.12;
/// And from so many votes on.
const LEAST_VOTES: usize = 5;
/// How near samples without votes have to be to the guessed side of a unit, in its radii.
const GUESSED: f32 = 0.3;
/// Clusters of two views are one body where so many of the looked at samples are near each other.
const MEETING: usize = 3;
const LOOKED_AT: usize = 48;

/// A cluster of a view.
#[derive(Clone, Debug)]
pub(super) struct Cluster {
    pub(super) view: usize,
    /// Its samples.
    pub(super) samples: Range<usize>,
    pub(super) middle: Vector3<f32>,
    pub(super) extent_m: f32,
    low: Vector3<f32>,
    high: Vector3<f32>,
    /// What it was given where labels are.
    pub(super) label: Option<u32>,
    /// Something nearer, or the border of the image, hides what is beside it.
    pub(super) is_cut: bool,
}

impl Cluster {
    pub(super) fn new(
        view: usize,
        all: &[Sample],
        samples: Range<usize>,
        label: Option<u32>,
        is_cut: bool,
    ) -> Option<Self> {
        let own = all.get(samples.clone())?;
        let (low, high) = bounds(own)?;
        let sum: Vector3<f64> = own.iter().map(|sample| sample.point.coords.cast::<f64>()).sum();
        let middle = (sum / own.len() as f64).cast();
        let extent_m = (high - low).norm();
        Some(Cluster { view, samples, middle, extent_m, low, high, label, is_cut })
    }

    fn overlaps(&self, other: &Cluster, margin_m: f32) -> bool {
        (0..3).all(|axis| {
            self.low[axis] - margin_m < other.high[axis]
                && other.low[axis] - margin_m < self.high[axis]
        })
    }
}

/// What is nobody's.
pub(super) const NOBODY: u32 = u32::MAX;

/// Which unit has what.
pub(super) struct Owners {
    /// (samples)
    pub(super) samples: Vec<u32>,
    /// (clusters) The unit that has all of it.
    pub(super) clusters: Vec<u32>,
    /// (clusters) Whether no unit has any of it.
    pub(super) free: Vec<bool>,
}

/// How far off a unit's surface may be at its predicted pose, metres.
fn gate_m(unit: &TrackedUnit, radius: f32) -> f32 {
    let (place, turn) = unit.motion.spread();
    let off = 1.7 * (place as f32 + radius * turn as f32);
    (off + unit.surface.cell_m()).min(0.5 * radius + unit.surface.cell_m())
}

/// The units' bounding spheres and gates.
struct Reach<'u> {
    unit: &'u TrackedUnit,
    inverse: nalgebra::Isometry3<f32>,
    middle: Vector3<f32>,
    radius: f32,
    gate: f32,
}

impl<'u> Reach<'u> {
    fn of(unit: &'u TrackedUnit) -> Self {
        let radius = unit.radius_m();
        let (mut pose, gate) = (unit.pose(), gate_m(unit, radius));
        pose.translation.vector += unit.guess.unwrap_or_default().cast::<f32>();
        let middle = (pose * unit.centre).coords;
        Reach { unit, inverse: pose.inverse(), middle, radius, gate }
    }

    /// Distance of a sample from the surface, metres; none beyond `within_m`.
    fn distance_m(&self, sample: &Sample, within_m: f32) -> Option<f32> {
        let reach = self.radius + within_m;
        if (sample.point.coords - self.middle).norm_squared() > reach * reach {
            return None;
        }
        let near = self.unit.surface.nearest(&(self.inverse * sample.point))?;
        let limit = within_m + 3.0 * sample.deviation_m;
        (near.square_m2 < limit * limit).then(|| near.square_m2.sqrt())
    }
}

/// Gives samples to units.
pub(super) fn associate(units: &[TrackedUnit], samples: &[Sample], clusters: &[Cluster]) -> Owners {
    let reaches: Vec<Reach<'_>> = units.iter().map(Reach::of).collect();
    let shared: Vec<(Vec<u32>, u32)> =
        clusters.par_iter().map(|cluster| share(&reaches, samples, cluster)).collect();
    let mut owners = Owners {
        samples: vec![NOBODY; samples.len()],
        clusters: Vec::with_capacity(clusters.len()),
        free: Vec::with_capacity(clusters.len()),
    };
    for (cluster, (shares, whole)) in clusters.iter().zip(shared) {
        owners.free.push(shares.iter().all(|owner| *owner == NOBODY));
        owners.clusters.push(whole);
        if let Some(slots) = owners.samples.get_mut(cluster.samples.clone()) {
            slots.copy_from_slice(&shares);
        }
    }
    owners
}

/// Owners of a cluster's samples, and the unit that has all of it.
fn share(reaches: &[Reach<'_>], samples: &[Sample], cluster: &Cluster) -> (Vec<u32>, u32) {
    let own = samples.get(cluster.samples.clone()).unwrap_or_default();
    let near: Vec<usize> = (0..reaches.len())
        .filter(|at| {
            let reach = &reaches[*at];
            let around = Vector3::repeat(reach.radius + reach.gate);
            (0..3).all(|axis| {
                reach.middle[axis] - around[axis] < cluster.high[axis]
                    && reach.middle[axis] + around[axis] > cluster.low[axis]
            })
        })
        .collect();
    let mut votes = vec![0usize; near.len()];
    let mut shares: Vec<u32> = own
        .iter()
        .map(|sample| {
            let distances = near.iter().enumerate().filter_map(|(place, at)| {
                Some((place, reaches[*at].distance_m(sample, reaches[*at].gate)?))
            });
            let best = distances.min_by(|(_, a), (_, b)| a.total_cmp(b));
            best.map_or(NOBODY, |(place, _)| {
                votes[place] += 1;
                near[place] as u32
            })
        })
        .collect();
    let cast: usize = votes.iter().sum();
    let needed = ((PART * cast as f32) as usize).max(LEAST_VOTES.min(own.len() / 3));
    let parts: Vec<usize> = (0..near.len())
        .filter(|place| votes[*place] >= needed.max(1))
        .map(|place| near[place])
        .collect();
    match parts.as_slice() {
        [] => {
            let guess = guessed(reaches, &near, own);
            (vec![guess; own.len()], guess)
        }
        // Few votes in a large cluster: something else touches the unit.
        [one] if cast * 4 >= own.len() => {
            let reach = &reaches[*one];
            let within = 1.6 * reach.radius + reach.gate;
            let is_near = |sample: &Sample| {
                (sample.point.coords - reach.middle).norm_squared() < within * within
            };
            let shares = own.iter().map(|s| if is_near(s) { *one as u32 } else { NOBODY });
            (shares.collect(), *one as u32)
        }
        parts => {
            for (slot, sample) in shares.iter_mut().zip(own) {
                if *slot != NOBODY && parts.contains(&(*slot as usize)) {
                    continue;
                }
                let distances = parts.iter().filter_map(|at| {
                    let reach = &reaches[*at];
                    Some((*at, reach.distance_m(sample, 0.4 * reach.radius + reach.gate)?))
                });
                let best = distances.min_by(|(_, a), (_, b)| a.total_cmp(b));
                *slot = best.map_or(NOBODY, |(at, _)| at as u32);
            }
            (shares, NOBODY)
        }
    }
}

/// The unit whose guessed side a cluster is, if it is one: another camera sees the other side of a body first.
fn guessed(reaches: &[Reach<'_>], near: &[usize], own: &[Sample]) -> u32 {
    let step = own.len().div_ceil(LOOKED_AT).max(1);
    let off = |at: &usize| {
        let reach = &reaches[*at];
        let points = &reach.unit.shape.as_ref()?.points;
        let mut distances: Vec<f32> = own
            .iter()
            .step_by(step)
            .map(|sample| {
                let local = reach.inverse * sample.point;
                let squares = points.iter().map(|point| (point - local).norm_squared());
                squares.fold(f32::MAX, f32::min).sqrt()
            })
            .collect();
        distances.sort_by(f32::total_cmp);
        let middle = distances.get(distances.len() / 2)?;
        let limit = GUESSED * reach.radius + reach.gate;
        (*middle < limit).then_some((*at, middle / limit))
    };
    let best = near.iter().filter_map(off).min_by(|(_, a), (_, b)| a.total_cmp(b));
    best.map_or(NOBODY, |(at, _)| at as u32)
}

/// Clusters of several views that show one body, as lists of clusters. A cluster that meets two of another view is in no list: it
/// shows two bodies that the other view tells apart.
pub(super) fn bodies(samples: &[Sample], clusters: &[Cluster], free: &[bool]) -> Vec<Vec<usize>> {
    let count = clusters.len();
    let mut group: Vec<usize> = (0..count).collect();
    let mut met: Vec<Vec<usize>> = vec![Vec::new(); count];
    for a in 0..count {
        for b in 0..a {
            if clusters[a].view != clusters[b].view && meet(samples, &clusters[a], &clusters[b]) {
                met[a].push(b);
                met[b].push(a);
            }
        }
    }
    let is_mixed = |at: usize| {
        let views = met[at].iter().map(|other| clusters[*other].view);
        let mut views: Vec<usize> = views.collect();
        views.sort_unstable();
        clusters[at].label.is_none() && views.windows(2).any(|pair| pair[0] == pair[1])
    };
    let mixed: Vec<bool> = (0..count).map(is_mixed).collect();
    for a in 0..count {
        for b in met[a].iter().filter(|b| **b < a && !mixed[a] && !mixed[**b]) {
            let (from, to) = (group[a].max(group[*b]), group[a].min(group[*b]));
            group.iter_mut().filter(|group| **group == from).for_each(|group| *group = to);
        }
    }
    let mut lists: Vec<Vec<usize>> = vec![Vec::new(); count];
    for at in (0..count).filter(|at| !mixed[*at]) {
        lists[group[at]].push(at);
    }
    // A body of which some is a unit's already is that unit's.
    lists.retain(|list| !list.is_empty() && list.iter().all(|at| free.get(*at) == Some(&true)));
    lists
}

fn meet(samples: &[Sample], a: &Cluster, b: &Cluster) -> bool {
    if a.label.is_some() || b.label.is_some() {
        return a.label == b.label;
    }
    let margin = 0.12 * a.extent_m.min(b.extent_m);
    if !a.overlaps(b, margin) {
        return false;
    }
    let [a, b] = [a, b].map(|cluster| samples.get(cluster.samples.clone()).unwrap_or_default());
    let step = a.len().div_ceil(LOOKED_AT).max(1);
    let limit = margin * margin;
    let near = a
        .iter()
        .step_by(step)
        .filter(|sample| b.iter().any(|other| (other.point - sample.point).norm_squared() < limit));
    near.take(MEETING).count() >= MEETING.min(a.len())
}
