//! From a cloud of points to samples: normals from neighbours, clusters from gaps.

use std::collections::BTreeMap;
use std::num::NonZero;

use kiddo::{ImmutableKdTree, SquaredEuclidean};
use nalgebra::{Matrix3, Point3, Vector3};
use rayon::prelude::*;
use rigidformer_core::Plane;
use rigidformer_core::kernels::in_own_environment;

use super::capture::Cloud;
use super::planes::{Planes, height_m};
use super::sampling::{Bounds, Sample, Sampled, Segmentation};
use super::segmentation::{NONE, Segmenter};

mod image;

/// Points of a cloud that are used, at most.
// It bounds the time of a capture: each point searches its neighbours.
const MAX_POINTS: usize = 20_000;
/// Points of a normal's fit: the point and its nearest neighbours.
const NEIGHBOURS: usize = 12;
/// Gap between clusters, in median distances to the second neighbour.
// Scanners sample unevenly, so a gap must be well above the usual spacing.
const CLUSTER_GAP: f32 = 3.0;
/// Points of a cluster, at least.
// Smaller clusters are noise.
const MIN_POINTS: usize = 12;
/// Samples of a cluster, at most.
// As of depth images: it bounds the time of registration.
const MAX_SAMPLES: usize = 400;
/// Distance from a plane up to which a point belongs to it, metres.
const PLANE_M: f32 = 0.004;
/// Standard deviations that separate a point from a plane.
const DEVIATIONS: f32 = 3.0;

/// Adds the samples of a cloud. Points on planes or behind them are left out, unless labels assign them to a body.
pub(super) fn sample_cloud(
    cloud: &Cloud,
    planes: &Planes,
    segmenter: &mut Segmenter,
    segmentation: Segmentation,
    bounds: Bounds,
    samples: &mut Vec<Sample>,
) -> Sampled {
    let smooth = planes.smooth_error();
    let is_off = |plane: &Plane, point: &Point3<f32>| {
        let smooth_m = cloud.sensor.map_or(0.0, |eye| smooth.deviation_m((point - eye).norm()));
        height_m(plane, &point.coords) > DEVIATIONS * smooth_m + PLANE_M
    };
    let labels = match segmentation {
        Segmentation::Given => cloud.labels.as_deref(),
        Segmentation::Found => None,
    };
    let step = cloud.points.len().div_ceil(MAX_POINTS).max(1);
    let kept = |at: &usize| {
        let (Some(point), label) = (cloud.points.get(*at), labels.and_then(|l| l.get(*at))) else {
            return false;
        };
        if !cloud.is_return(point) {
            return false;
        }
        match label {
            Some(label) => *label > 0,
            None => planes.all().iter().all(|plane| is_off(plane, point)),
        }
    };
    let chosen: Vec<usize> = (0..cloud.points.len()).step_by(step).filter(kept).collect();
    let points: Vec<[f32; 3]> = chosen.iter().map(|at| cloud.points[*at].into()).collect();
    let nothing = Sampled { clusters: 0, left_out: 0, measured: 1.0, occluded: Vec::new() };
    if points.len() < MIN_POINTS {
        return nothing;
    }
    let Ok(tree) = ImmutableKdTree::<f32, 3>::new_from_slice(&points) else { return nothing };
    let fits: Vec<PlaneFit> = points
        .par_iter()
        .map(|point| in_own_environment(|| PlaneFit::new(&tree, &points, point)))
        .collect();
    let spacing = median(fits.iter().map(|fit| fit.spacing_m));
    // One deviation for all points: single fits over twelve points scatter.
    let deviation_m = median(fits.iter().map(|fit| fit.deviation_m)).clamp(2e-4, 0.1);
    let cluster_of: Vec<u32> = match labels {
        Some(labels) => chosen.iter().map(|at| u32::from(labels[*at])).collect(),
        None => {
            let by_gaps = connected(&points, CLUSTER_GAP * spacing.max(1e-5));
            let seen = cloud.sensor.and_then(|eye| {
                let all = cloud.points.iter().step_by(step).copied();
                let all = all.filter(|point| cloud.is_return(point));
                image::clusters(segmenter, &eye, all, &points, deviation_m, smooth)
            });
            seen.unwrap_or(by_gaps)
        }
    };
    let mut clusters: BTreeMap<u32, Vec<usize>> = BTreeMap::new();
    for (at, cluster) in cluster_of.iter().enumerate() {
        // What the image does not reach is of no body.
        if labels.is_none() && *cluster == NONE {
            continue;
        }
        clusters.entry(*cluster).or_default().push(at);
    }
    let mut kept: Vec<(u32, Vec<usize>)> =
        clusters.into_iter().filter(|(_, own)| own.len() >= MIN_POINTS).collect();
    let all = kept.len();
    kept.sort_by_key(|(_, own)| std::cmp::Reverse(own.len()));
    kept.truncate(bounds.clusters);
    // Numbers follow the order of the cloud, not of sizes.
    kept.sort_by_key(|(cluster, _)| *cluster);
    for (number, (label, own)) in kept.iter().enumerate() {
        let cluster = if labels.is_some() { *label } else { bounds.next + number as u32 };
        let middle = own.iter().map(|at| Vector3::from(points[*at])).sum::<Vector3<f32>>()
            / own.len() as f32;
        for at in own.iter().step_by(own.len().div_ceil(MAX_SAMPLES).max(1)) {
            let point = Point3::from(points[*at]);
            // Visible surfaces face the sensor. Without its position they face away from the centroid.
            let out = cloud.sensor.map_or(point.coords - middle, |eye| eye - point);
            let Some(normal) = fits[*at].normal else { continue };
            let normal = if normal.dot(&out) < 0.0 { -normal } else { normal };
            samples.push(Sample { point, normal, deviation_m, cluster });
        }
    }
    Sampled {
        clusters: kept.len() as u32,
        left_out: (all - kept.len()) as u32,
        measured: 1.0,
        occluded: Vec::new(),
    }
}

/// A least-squares plane through a point's neighbours.
struct PlaneFit {
    normal: Option<Vector3<f32>>,
    deviation_m: f32,
    /// To the second nearest neighbour.
    spacing_m: f32,
}

impl PlaneFit {
    fn new(tree: &ImmutableKdTree<f32, 3>, points: &[[f32; 3]], point: &[f32; 3]) -> Self {
        let count = NonZero::new(NEIGHBOURS).unwrap_or(NonZero::<usize>::MIN);
        let near = tree.query(point).nearest_n::<SquaredEuclidean<f32>>(count).execute();
        let origin = Vector3::from(*point);
        let own = || {
            let at = near.iter().filter_map(|found| points.get(found.item as usize));
            at.map(|other| Vector3::from(*other) - origin)
        };
        let number = near.len().max(1) as f32;
        let mean = own().sum::<Vector3<f32>>() / number;
        let spread: Matrix3<f32> =
            own().map(|offset| (offset - mean) * (offset - mean).transpose()).sum::<Matrix3<f32>>()
                / number;
        let eigen = spread.symmetric_eigen();
        let least = eigen.eigenvalues.imin();
        let normal: Vector3<f32> = eigen.eigenvectors.column(least).into_owned();
        // Three parameters of the plane are fitted, so the unbiased variance has three degrees of freedom less.
        let rest = number / (number - 3.0).max(1.0);
        let spacing = near.iter().map(|found| found.distance).nth(2).unwrap_or(0.0);
        PlaneFit {
            normal: normal.try_normalize(1e-6).filter(|n| n.iter().all(|v| v.is_finite())),
            deviation_m: (eigen.eigenvalues[least].max(0.0) * rest).sqrt(),
            spacing_m: spacing.max(0.0).sqrt(),
        }
    }
}

fn median(numbers: impl Iterator<Item = f32>) -> f32 {
    let mut numbers: Vec<f32> = numbers.collect();
    numbers.sort_by(f32::total_cmp);
    numbers.get(numbers.len() / 2).copied().unwrap_or(0.0)
}

/// Clusters of points: those in adjacent cells are one. Each has the number of its first point.
fn connected(points: &[[f32; 3]], cell_m: f32) -> Vec<u32> {
    let cell = |point: &[f32; 3]| point.map(|at| (at / cell_m).floor() as i64);
    let mut cells: BTreeMap<[i64; 3], Vec<u32>> = BTreeMap::new();
    for (at, point) in points.iter().enumerate() {
        cells.entry(cell(point)).or_default().push(at as u32);
    }
    let mut cluster = vec![u32::MAX; points.len()];
    for (at, point) in points.iter().enumerate() {
        if cluster[at] != u32::MAX {
            continue;
        }
        // Flood fill over occupied cells; `remove` marks a cell as visited.
        let mut open = vec![cell(point)];
        while let Some(index) = open.pop() {
            let Some(own) = cells.remove(&index) else { continue };
            own.iter().for_each(|other| cluster[*other as usize] = at as u32);
            for dx in -1..=1 {
                for dy in -1..=1 {
                    for dz in -1..=1 {
                        open.push([index[0] + dx, index[1] + dy, index[2] + dz]);
                    }
                }
            }
        }
    }
    cluster
}

#[cfg(test)]
mod tests {
    use super::*;
    use rigidformer_runtime::noise::Noise;

    /// Points on two balls of radius .05 m whose centres are .3 m apart, over a floor.
    fn balls() -> Cloud {
        let mut noise = Noise::new(1, 1);
        let mut points = Vec::new();
        for i in 0..1200 {
            let way = Vector3::new(noise.normal(), noise.normal(), noise.normal()).normalize();
            let x = if i % 2 == 0 { 0.0 } else { 0.3 };
            points.push(Point3::from(way * 0.05 + Vector3::new(x, 0.0, 0.1)));
        }
        let floor = (0..2000).map(|_| Point3::new(noise.uniform(), noise.uniform(), 0.0));
        points.extend(floor);
        Cloud { points, ..Cloud::default() }
    }

    #[test]
    fn two_balls_are_two_clusters_with_outward_normals() {
        let mut samples = Vec::new();
        let bounds = Bounds { clusters: 8, next: 5 };
        let down = Vector3::new(0.0, 0.0, -9.81);
        let planes = Planes::given(vec![Plane::ground(0.5, 0.5)], down, 1);
        let mut segmenter = Segmenter::default();
        let found = Segmentation::Found;
        let sampled = sample_cloud(&balls(), &planes, &mut segmenter, found, bounds, &mut samples);
        assert_eq!((sampled.clusters, sampled.left_out), (2, 0));
        for sample in &samples {
            let centre = Vector3::new(if sample.cluster == 5 { 0.0 } else { 0.3 }, 0.0, 0.1);
            let out = (sample.point.coords - centre).normalize();
            assert!(out.dot(&sample.normal) > 0.9, "{sample:?}");
        }
        let few = Bounds { clusters: 1, next: 0 };
        let sampled = sample_cloud(&balls(), &planes, &mut segmenter, found, few, &mut samples);
        assert_eq!((sampled.clusters, sampled.left_out), (1, 1));
    }
}
