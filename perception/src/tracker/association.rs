//! Data association: the unit of each sample.
//!
//! A sample votes for the unit with the nearest predicted surface. A cluster with votes for one unit belongs to it as a whole, so that sides
//! that come into view do too. A cluster with votes for several units is split between them, sample by sample: touching units stay apart.

use std::ops::Range;

use nalgebra::Vector3;
use rayon::prelude::*;
use rigidformer_core::kernels::in_own_environment;

use super::unit::{TrackedUnit, bounds};
use crate::sampling::Sample;

/// Share of the votes from which a unit takes part in a cluster.
// Noise at the contact of two units gives some votes to the wrong one.
const MIN_VOTE_SHARE: f32 = 0.12;
/// Votes from which a unit takes part in a cluster.
const MIN_VOTES: usize = 5;
/// Largest distance of samples without votes from a completed side of a unit, in its radii.
const COMPLETED_RADII: f32 = 0.3;
/// Near samples from which clusters of two views show one body.
const MIN_NEAR_SAMPLES: usize = 3;
const MAX_COMPARED_SAMPLES: usize = 48;

/// A cluster of a view.
#[derive(Clone, Debug)]
pub(super) struct Cluster {
    pub(super) view: usize,
    /// Its samples.
    pub(super) samples: Range<usize>,
    pub(super) centroid: Vector3<f32>,
    pub(super) extent_m: f32,
    low: Vector3<f32>,
    high: Vector3<f32>,
    /// Its label, where labels are given.
    pub(super) label: Option<u32>,
    /// Something nearer, or the border of the image, occludes a part of it.
    pub(super) is_occluded: bool,
}

impl Cluster {
    pub(super) fn new(
        view: usize,
        all: &[Sample],
        samples: Range<usize>,
        label: Option<u32>,
        is_occluded: bool,
    ) -> Option<Self> {
        let own = all.get(samples.clone())?;
        let (low, high) = bounds(own)?;
        let sum: Vector3<f64> = own.iter().map(|sample| sample.point.coords.cast::<f64>()).sum();
        let centroid = (sum / own.len() as f64).cast();
        let extent_m = (high - low).norm();
        Some(Cluster { view, samples, centroid, extent_m, low, high, label, is_occluded })
    }

    fn overlaps(&self, other: &Cluster, margin_m: f32) -> bool {
        (0..3).all(|axis| {
            self.low[axis] - margin_m < other.high[axis]
                && other.low[axis] - margin_m < self.high[axis]
        })
    }
}

/// Owner of samples and clusters that belong to no unit.
pub(super) const UNOWNED: u32 = u32::MAX;

/// Owners of samples and clusters.
pub(super) struct Owners {
    /// (samples)
    pub(super) samples: Vec<u32>,
    /// (clusters) The unit that owns all of it.
    pub(super) clusters: Vec<u32>,
    /// (clusters) Whether no unit owns any of it.
    pub(super) free: Vec<bool>,
}

/// Largest distance of a sample from a unit's surface at its predicted pose, metres.
fn gate_m(unit: &TrackedUnit, radius: f32) -> f32 {
    let (index, turn) = unit.motion.pose_deviation();
    let off = 1.7 * (index as f32 + radius * turn as f32);
    // Beyond half a radius, samples of neighbours would fit too.
    (off + unit.surface.cell_m()).min(0.5 * radius + unit.surface.cell_m())
}

/// The units' bounding spheres and gates.
struct Reach<'u> {
    unit: &'u TrackedUnit,
    inverse: nalgebra::Isometry3<f32>,
    centroid: Vector3<f32>,
    radius: f32,
    gate: f32,
}

impl<'u> Reach<'u> {
    fn of(unit: &'u TrackedUnit) -> Self {
        let radius = unit.radius_m();
        let (mut pose, gate) = (unit.pose(), gate_m(unit, radius));
        pose.translation.vector += unit.centroid_shift.unwrap_or_default().cast::<f32>();
        let centroid = (pose * unit.centre).coords;
        Reach { unit, inverse: pose.inverse(), centroid, radius, gate }
    }

    /// Distance of a sample from the surface, metres; none beyond `within_m`.
    fn distance_m(&self, sample: &Sample, within_m: f32) -> Option<f32> {
        let reach = self.radius + within_m;
        if (sample.point.coords - self.centroid).norm_squared() > reach * reach {
            return None;
        }
        let near = self.unit.surface.nearest(&(self.inverse * sample.point))?;
        let limit = within_m + 3.0 * sample.deviation_m;
        (near.square_m2 < limit * limit).then(|| near.square_m2.sqrt())
    }
}

/// Assigns samples to units.
pub(super) fn associate(units: &[TrackedUnit], samples: &[Sample], clusters: &[Cluster]) -> Owners {
    let reaches: Vec<Reach<'_>> = units.iter().map(Reach::of).collect();
    let shared: Vec<(Vec<u32>, u32)> = clusters
        .par_iter()
        .map(|cluster| in_own_environment(|| split_cluster(&reaches, samples, cluster)))
        .collect();
    let mut owners = Owners {
        samples: vec![UNOWNED; samples.len()],
        clusters: Vec::with_capacity(clusters.len()),
        free: Vec::with_capacity(clusters.len()),
    };
    for (cluster, (shares, whole)) in clusters.iter().zip(shared) {
        owners.free.push(shares.iter().all(|owner| *owner == UNOWNED));
        owners.clusters.push(whole);
        if let Some(slots) = owners.samples.get_mut(cluster.samples.clone()) {
            slots.copy_from_slice(&shares);
        }
    }
    owners
}

/// Owners of a cluster's samples, and the unit that owns all of it.
fn split_cluster(reaches: &[Reach<'_>], samples: &[Sample], cluster: &Cluster) -> (Vec<u32>, u32) {
    debug_assert!(
        cluster.samples.end <= samples.len(),
        "{:?} of {}",
        cluster.samples,
        samples.len()
    );
    let own = samples.get(cluster.samples.clone()).unwrap_or_default();
    let near: Vec<usize> = (0..reaches.len())
        .filter(|at| {
            let reach = &reaches[*at];
            // Bounding boxes exclude most units before the search for surfels.
            let around = Vector3::repeat(reach.radius + reach.gate);
            (0..3).all(|axis| {
                reach.centroid[axis] - around[axis] < cluster.high[axis]
                    && reach.centroid[axis] + around[axis] > cluster.low[axis]
            })
        })
        .collect();
    let mut votes = vec![0usize; near.len()];
    let mut shares: Vec<u32> = own
        .iter()
        .map(|sample| {
            let distances = near.iter().enumerate().filter_map(|(index, at)| {
                Some((index, reaches[*at].distance_m(sample, reaches[*at].gate)?))
            });
            let best = distances.min_by(|(_, a), (_, b)| a.total_cmp(b));
            best.map_or(UNOWNED, |(index, _)| {
                votes[index] += 1;
                near[index] as u32
            })
        })
        .collect();
    let cast: usize = votes.iter().sum();
    // Small clusters cannot have many votes, so a third of them suffices.
    let needed = ((MIN_VOTE_SHARE * cast as f32) as usize).max(MIN_VOTES.min(own.len() / 3));
    // Too small a share of the votes is noise.
    let candidates: Vec<usize> = (0..near.len())
        .filter(|index| votes[*index] >= needed.max(1))
        .map(|index| near[index])
        .collect();
    match candidates.as_slice() {
        [] => {
            let owner = nearest_completed_unit(reaches, &near, own);
            (vec![owner; own.len()], owner)
        }
        // Fewer votes than a quarter mean that another body touches the unit: that cluster is split below.
        [one] if cast * 4 >= own.len() => {
            let reach = &reaches[*one];
            let within = 1.6 * reach.radius + reach.gate;
            let is_near = |sample: &Sample| {
                (sample.point.coords - reach.centroid).norm_squared() < within * within
            };
            let shares = own.iter().map(|s| if is_near(s) { *one as u32 } else { UNOWNED });
            (shares.collect(), *one as u32)
        }
        candidates => {
            for (slot, sample) in shares.iter_mut().zip(own) {
                if *slot != UNOWNED && candidates.contains(&(*slot as usize)) {
                    continue;
                }
                let distances = candidates.iter().filter_map(|at| {
                    let reach = &reaches[*at];
                    Some((*at, reach.distance_m(sample, 0.4 * reach.radius + reach.gate)?))
                });
                let best = distances.min_by(|(_, a), (_, b)| a.total_cmp(b));
                *slot = best.map_or(UNOWNED, |(at, _)| at as u32);
            }
            (shares, UNOWNED)
        }
    }
}

/// The unit near whose completed side a cluster lies, if any: another camera shows the other side of a body first.
fn nearest_completed_unit(reaches: &[Reach<'_>], near: &[usize], own: &[Sample]) -> u32 {
    let step = own.len().div_ceil(MAX_COMPARED_SAMPLES).max(1);
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
        // The median ignores samples beyond the completed side.
        distances.sort_by(f32::total_cmp);
        let centroid = distances.get(distances.len() / 2)?;
        let limit = COMPLETED_RADII * reach.radius + reach.gate;
        (*centroid < limit).then_some((*at, centroid / limit))
    };
    let best = near.iter().filter_map(off).min_by(|(_, a), (_, b)| a.total_cmp(b));
    best.map_or(UNOWNED, |(at, _)| at as u32)
}

/// Clusters of several views that show one body, as lists of clusters. A cluster that overlaps two of another view is in no list: it shows
/// two bodies that the other view separates.
pub(super) fn bodies(samples: &[Sample], clusters: &[Cluster], free: &[bool]) -> Vec<Vec<usize>> {
    let count = clusters.len();
    let mut group: Vec<usize> = (0..count).collect();
    let mut overlaps: Vec<Vec<usize>> = vec![Vec::new(); count];
    for a in 0..count {
        for b in 0..a {
            // Within a view clusters are separate bodies already.
            if clusters[a].view != clusters[b].view && overlap(samples, &clusters[a], &clusters[b])
            {
                overlaps[a].push(b);
                overlaps[b].push(a);
            }
        }
    }
    let is_ambiguous = |at: usize| {
        let views = overlaps[at].iter().map(|other| clusters[*other].view);
        let mut views: Vec<usize> = views.collect();
        views.sort_unstable();
        clusters[at].label.is_none() && views.windows(2).any(|pair| pair[0] == pair[1])
    };
    let ambiguous: Vec<bool> = (0..count).map(is_ambiguous).collect();
    for a in 0..count {
        for b in overlaps[a].iter().filter(|b| **b < a && !ambiguous[a] && !ambiguous[**b]) {
            let (from, to) = (group[a].max(group[*b]), group[a].min(group[*b]));
            group.iter_mut().filter(|group| **group == from).for_each(|group| *group = to);
        }
    }
    let mut lists: Vec<Vec<usize>> = vec![Vec::new(); count];
    for at in (0..count).filter(|at| !ambiguous[*at]) {
        lists[group[at]].push(at);
    }
    // A body with a cluster that a unit owns belongs to that unit.
    lists.retain(|list| !list.is_empty() && list.iter().all(|at| free.get(*at) == Some(&true)));
    lists
}

fn overlap(samples: &[Sample], a: &Cluster, b: &Cluster) -> bool {
    // Labels decide, whatever the distance.
    if a.label.is_some() || b.label.is_some() {
        return a.label == b.label;
    }
    // Clusters of two views need not show the same points of a body.
    let margin = 0.12 * a.extent_m.min(b.extent_m);
    if !a.overlaps(b, margin) {
        return false;
    }
    debug_assert!([a, b].iter().all(|cluster| cluster.samples.end <= samples.len()));
    let [a, b] = [a, b].map(|cluster| samples.get(cluster.samples.clone()).unwrap_or_default());
    let step = a.len().div_ceil(MAX_COMPARED_SAMPLES).max(1);
    let limit = margin * margin;
    let near = a
        .iter()
        .step_by(step)
        .filter(|sample| b.iter().any(|other| (other.point - sample.point).norm_squared() < limit));
    near.take(MIN_NEAR_SAMPLES).count() >= MIN_NEAR_SAMPLES.min(a.len())
}
