//! A cloud as its sensor saw it: an image of depths, in which bodies are told apart as in a depth camera's.

use std::num::NonZero;

use kiddo::{ImmutableKdTree, SquaredEuclidean};
use nalgebra::{Point3, Rotation3, Vector3};

use crate::planes::SmoothError;
use crate::segmentation::{Image, NONE, Segmenter, Tabletops};

/// Least cosine between a ray and the middle one: wider clouds, as of scanners that turn, are no image.
const MIN_COSINE: f32 = 0.5;
/// Points whose neighbours tell how far rays are apart, about.
const SPACINGS: usize = 500;
/// Spacings of rays in a pixel.
// With fewer, pixels between rays stay empty.
const SPACINGS_A_PIXEL: f32 = 1.5;
/// Pixels a side, at most.
const MAX_SIDE: f32 = 800.0;
/// Pixels a side, at least.
// In fewer nothing has a surface.
const MIN_SIDE: f32 = 8.0;
/// Change of depth between neighbouring pixels from which they are of two surfaces, in footprints of a pixel.
// As of depth cameras; a pixel holds rays that are up to one more apart.
const MAX_SLOPE: f32 = 5.0;
/// Share of points behind another one in their pixel, at most.
// Pixels at edges show a body and what is behind it.
const MAX_BEHIND: f32 = 0.05;
/// Deviations of depths, and of smooth errors, in that change.
const NOISE: f32 = 6.0;
const SMOOTH: f32 = 3.0;

/// Clusters of `points`, which are those of no plane among `all`, as seen from `eye`: each has the number of a pixel. None where the
/// points do not fit into an image.
pub(super) fn clusters(
    segmenter: &mut Segmenter,
    eye: &Point3<f32>,
    all: impl Iterator<Item = Point3<f32>>,
    points: &[[f32; 3]],
    deviation_m: f32,
    smooth: SmoothError,
) -> Option<Vec<u32>> {
    let all: Vec<Vector3<f32>> = all.map(|point| point - eye).collect();
    let middle: Vector3<f32> = all.iter().filter_map(|way| way.try_normalize(1e-6)).sum();
    let rotation = Rotation3::rotation_between(&middle, &Vector3::z())?;
    let is_wide = |way: &Vector3<f32>| way.z < MIN_COSINE * way.norm();
    let turned: Vec<Vector3<f32>> = all.iter().map(|way| rotation * way).collect();
    // A hundredth may be strays.
    if turned.is_empty() || turned.iter().filter(|way| is_wide(way)).count() * 100 > turned.len() {
        return None;
    }
    let rays: Vec<[f32; 2]> = turned
        .iter()
        .filter(|way| !is_wide(way))
        .map(|way| [way.x / way.z, way.y / way.z])
        .collect();
    let bound = |axis: usize, pick: fn(f32, f32) -> f32, first: f32| {
        rays.iter().map(|ray| ray[axis]).fold(first, pick)
    };
    let low = [0, 1].map(|axis| bound(axis, f32::min, f32::MAX));
    let high = [0, 1].map(|axis| bound(axis, f32::max, f32::MIN));
    let widest = (high[0] - low[0]).max(high[1] - low[1]);
    let focal = (1.0 / (SPACINGS_A_PIXEL * spacing(&rays)?)).min((MAX_SIDE - 2.0) / widest);
    let sides = [0, 1].map(|axis| (focal * (high[axis] - low[axis])).floor() + 1.0);
    if !sides.iter().all(|side| (MIN_SIDE..=MAX_SIDE).contains(side)) {
        return None;
    }
    let [width, height] = sides.map(|side| side as usize);
    let pixel = |way: &Vector3<f32>| {
        let [u, v] = [way.x / way.z - low[0], way.y / way.z - low[1]].map(|at| at * focal);
        let is_inside = !is_wide(way) && u >= 0.0 && v >= 0.0 && u < sides[0] && v < sides[1];
        is_inside.then(|| v as usize * width + u as usize)
    };
    let draw = |ways: &mut dyn Iterator<Item = Vector3<f32>>| {
        let mut depths = vec![0.0f32; width * height];
        for way in ways {
            if let Some(depth) = pixel(&way).and_then(|at| depths.get_mut(at))
                && (*depth == 0.0 || way.z < *depth)
            {
                *depth = way.z;
            }
        }
        depths
    };
    let all_m = draw(&mut turned.iter().copied());
    let ways: Vec<Vector3<f32>> =
        points.iter().map(|point| rotation * (Point3::from(*point) - eye)).collect();
    let depth_m = draw(&mut ways.iter().copied());
    // Of a cloud that several scanners made, far sides are seen behind near ones: it is no image.
    let is_behind = |way: &&Vector3<f32>| {
        let front = pixel(way).and_then(|at| all_m.get(at)).copied().unwrap_or(way.z);
        way.z - front > MAX_SLOPE * way.z / focal + NOISE * deviation_m
    };
    if turned.iter().filter(is_behind).count() as f32 > MAX_BEHIND * turned.len() as f32 {
        return None;
    }
    let image = Image {
        width,
        focal: [focal; 2],
        // The middle of a pixel is at whole numbers.
        centre: [0, 1].map(|axis| -low[axis] * focal - 0.5),
        depth_m: &depth_m,
        tabletops: Tabletops { up: Vector3::zeros(), above: &[], level: &[] },
        all_m: &all_m,
        gap: &|z_m| {
            MAX_SLOPE * z_m / focal + NOISE * deviation_m + SMOOTH * smooth.deviation_m(z_m)
        },
    };
    let mut segments = Vec::new();
    segmenter.segment(&image, &mut segments);
    // A point behind another one in its pixel is of the same body, or a stray.
    let segment = |way: &Vector3<f32>| pixel(way).and_then(|at| segments.get(at)).copied();
    Some(ways.iter().map(|way| segment(way).unwrap_or(NONE)).collect())
}

/// The median distance of rays to their nearest neighbour.
fn spacing(rays: &[[f32; 2]]) -> Option<f32> {
    let tree = ImmutableKdTree::<f32, 2>::new_from_slice(rays).ok()?;
    let two = NonZero::new(2)?;
    let step = rays.len().div_ceil(SPACINGS).max(1);
    let mut squares: Vec<f32> = rays
        .iter()
        .step_by(step)
        .filter_map(|ray| {
            let near = tree.query(ray).nearest_n::<SquaredEuclidean<f32>>(two).execute();
            near.iter().map(|found| found.distance).find(|square| *square > 0.0)
        })
        .collect();
    squares.sort_by(f32::total_cmp);
    squares.get(squares.len() / 2).map(|square| square.sqrt())
}
