//! Segments of one body: the inside of a hollow one, and what an occluder cuts in two.

use std::collections::BTreeMap;

use nalgebra::{Point3, Vector3};

use super::image::{Image, NONE};
use super::surface::Surface;

/// Segments that are compared, at most: those with the most pixels.
// It bounds the time of an image: segments are compared in pairs.
const MAX_SEGMENTS: usize = 48;
/// Pixels of a segment that is compared, at least.
// Normals of smaller ones are too uncertain.
const MIN_PIXELS: usize = 60;
/// Points of a segment that are compared, at most.
const MAX_SAMPLES: usize = 96;
/// Difference of two normals from which their points tell the curvature.
const MIN_TURN: f32 = 0.25;
/// Share of the pairs of points that must tell it.
const MIN_TURNED: f32 = 0.1;
/// Mean cosine between the way from point to point and the turn of the normal below which a surface is hollow: -1 in a ball's inside.
const HOLLOW: f32 = -0.3;
/// Pixels from the border of a hollow surface within which its rim is.
const RIM_PIXELS: i64 = 6;
/// Share of the border that a rim must have.
const MIN_RIM: f32 = 0.1;
/// Cosine between normals that are alike: 12 degrees.
const ALIKE: f32 = 0.978;
/// Distance from a point's tangent plane: metres, and share of the distance between the points.
// A normal that is two degrees off leads 3.5 % astray.
const TANGENT: [f32; 2] = [0.003, 0.04];
/// Shares of the samples of two segments that lie in tangent planes of the other: of one, and of both.
const MATCHED: [f32; 2] = [0.5, 0.25];
/// Partners that a matched sample has, at least.
const MIN_PARTNERS: usize = 2;
/// Shares of the pixels between two segments: that are behind their common surface, at most, and in front of it, at least.
const BEHIND: f32 = 0.1;
const IN_FRONT: f32 = 0.2;
/// Lines between two segments along which pixels are looked at, at most, and pixels of a line.
const MAX_LINES: usize = 64;
const LINE_PIXELS: usize = 32;
/// Depth by which a pixel is off a surface: metres, and share of the depth.
const OFF: [f32; 2] = [0.006, 0.01];

/// A segment that is compared.
struct Part {
    segment: u32,
    pixels: Vec<u32>,
    samples: Vec<u32>,
    /// Point and normal of each sample.
    elements: Vec<(Point3<f32>, Vector3<f32>)>,
    low: Vector3<f32>,
    high: Vector3<f32>,
}

/// Gives segments of one body one number.
pub(super) fn join(image: &Image<'_>, surface: &Surface, segments: &mut [u32]) {
    let parts = parts(surface, segments);
    let mut owner: Vec<usize> = (0..parts.len()).collect();
    for (number, part) in parts.iter().enumerate() {
        if is_hollow(part)
            && let Some(outside) = outside(image, segments, &parts, part)
        {
            unite(&mut owner, number, outside);
        }
    }
    for a in 0..parts.len() {
        for b in a + 1..parts.len() {
            if of(&owner, a) != of(&owner, b)
                && is_cut_in_two(image, segments, [&parts[a], &parts[b]])
            {
                unite(&mut owner, a, b);
            }
        }
    }
    for (number, part) in parts.iter().enumerate() {
        let segment = parts[of(&owner, number)].segment;
        for at in &part.pixels {
            segments[*at as usize] = segment;
        }
    }
}

fn of(owner: &[usize], mut at: usize) -> usize {
    while owner[at] != at {
        at = owner[at];
    }
    at
}

fn unite(owner: &mut [usize], a: usize, b: usize) {
    let (a, b) = (of(owner, a), of(owner, b));
    owner[a.max(b)] = a.min(b);
}

/// The largest segments, in the order of their first pixels.
fn parts(surface: &Surface, segments: &[u32]) -> Vec<Part> {
    let mut pixels: BTreeMap<u32, Vec<u32>> = BTreeMap::new();
    let numbered = segments.iter().enumerate().filter(|(_, segment)| **segment != NONE);
    // Pixels of a row are mostly of one segment.
    let mut run: (u32, Vec<u32>) = (NONE, Vec::new());
    for (at, segment) in numbered {
        if *segment != run.0 {
            pixels.entry(run.0).or_default().append(&mut run.1);
            run.0 = *segment;
        }
        run.1.push(at as u32);
    }
    pixels.entry(run.0).or_default().append(&mut run.1);
    pixels.remove(&NONE);
    let mut all: Vec<(u32, Vec<u32>)> =
        pixels.into_iter().filter(|(_, pixels)| pixels.len() >= MIN_PIXELS).collect();
    all.sort_by_key(|(_, pixels)| std::cmp::Reverse(pixels.len()));
    all.truncate(MAX_SEGMENTS);
    all.sort_by_key(|(segment, _)| *segment);
    let part = |(segment, pixels): (u32, Vec<u32>)| {
        let sound: Vec<u32> =
            pixels.iter().copied().filter(|at| surface.normal(*at as usize).is_some()).collect();
        let step = sound.len().div_ceil(MAX_SAMPLES).max(1);
        let samples: Vec<u32> = sound.into_iter().step_by(step).collect();
        let element = |at: &u32| {
            (surface.point(*at as usize), surface.normal(*at as usize).unwrap_or_default())
        };
        let elements: Vec<_> = samples.iter().map(element).collect();
        let points = elements.iter().map(|(point, _)| point.coords);
        let bounds = |(low, high): (Vector3<f32>, Vector3<f32>), point: Vector3<f32>| {
            (low.inf(&point), high.sup(&point))
        };
        let (low, high) =
            points.fold((Vector3::repeat(f32::MAX), Vector3::repeat(f32::MIN)), bounds);
        Part { segment, pixels, samples, elements, low, high }
    };
    all.into_iter().map(part).filter(|part| part.samples.len() >= 8).collect()
}

/// Whether normals turn towards each other, as in a cup.
fn is_hollow(part: &Part) -> bool {
    let (mut sum, mut turned, mut pairs) = (0.0f32, 0.0f32, 0.0f32);
    for (number, a) in part.elements.iter().enumerate() {
        for b in &part.elements[number + 1..] {
            let (across, turn) = (a.0 - b.0, a.1 - b.1);
            pairs += 1.0;
            if turn.norm() > MIN_TURN {
                turned += 1.0;
                sum += across.dot(&turn) / (across.norm() * turn.norm()).max(1e-9);
            }
        }
    }
    turned > MIN_TURNED * pairs && sum < HOLLOW * turned
}

/// The part in front of most of a hollow part's rim.
fn outside(image: &Image<'_>, segments: &[u32], parts: &[Part], part: &Part) -> Option<usize> {
    let (width, height) = (image.width, segments.len() / image.width.max(1));
    let mut votes = vec![0u32; parts.len()];
    let mut rays = 0u32;
    for at in &part.pixels {
        let at = *at as usize;
        let (u, v) = ((at % width) as i64, (at / width) as i64);
        let z = image.depth_m[at];
        for (du, dv) in [(1, 0), (-1, 0), (0, 1), (0, -1)] {
            let along = (1..=RIM_PIXELS).map_while(|step| {
                let (x, y) = (u + du * step, v + dv * step);
                let is_inside = x >= 0 && y >= 0 && x < width as i64 && y < height as i64;
                is_inside.then(|| y as usize * width + x as usize)
            });
            let mut along = along.peekable();
            if along.peek().is_none_or(|next| segments[*next] == part.segment) {
                continue;
            }
            rays += 1;
            let met = along.find(|at| segments[*at] != NONE);
            let Some(met) = met.filter(|at| image.depth_m[*at] < z + (image.gap)(z)) else {
                continue;
            };
            let segment = segments[met];
            if let Ok(number) = parts.binary_search_by_key(&segment, |part| part.segment)
                && segment != part.segment
            {
                votes[number] += 1;
            }
        }
    }
    let most =
        (0..parts.len()).max_by_key(|number| (votes[*number], std::cmp::Reverse(*number)))?;
    (votes[most] as f32 > MIN_RIM * rays as f32).then_some(most)
}

/// Whether two parts are one surface that something in front hides in between.
fn is_cut_in_two(image: &Image<'_>, segments: &[u32], [a, b]: [&Part; 2]) -> bool {
    // Halves of a body are seldom farther apart than they are large.
    let apart = (a.low - b.high).sup(&(b.low - a.high)).sup(&Vector3::zeros()).norm();
    if apart > (a.high - a.low).norm() + (b.high - b.low).norm() {
        return false;
    }
    let mut pairs = Vec::new();
    let mut partners = [vec![0usize; a.samples.len()], vec![0usize; b.samples.len()]];
    for (i, (p, n)) in a.elements.iter().enumerate() {
        for (j, (q, m)) in b.elements.iter().enumerate() {
            if n.dot(m) < ALIKE {
                continue;
            }
            let across = q - p;
            let within = TANGENT[0] + TANGENT[1] * across.norm();
            if across.dot(n).abs() < within && across.dot(m).abs() < within {
                partners[0][i] += 1;
                partners[1][j] += 1;
                pairs.push([*p, *q]);
            }
        }
    }
    let shares = partners.map(|counts| {
        let matched = counts.iter().filter(|count| **count >= MIN_PARTNERS).count();
        matched as f32 / counts.len().max(1) as f32
    });
    if shares[0].max(shares[1]) < MATCHED[0] || shares[0].min(shares[1]) < MATCHED[1] {
        return false;
    }
    let step = pairs.len().div_ceil(MAX_LINES).max(1);
    let (mut behind, mut in_front, mut all) = (0.0f32, 0.0f32, 0.0f32);
    for ends in pairs.into_iter().step_by(step) {
        for step in 1..LINE_PIXELS {
            let share = step as f32 / LINE_PIXELS as f32;
            let Some((at, z)) = between(image, ends, share) else { continue };
            let (segment, seen) = (segments[at], image.all_m[at]);
            if segment == a.segment || segment == b.segment {
                continue;
            }
            let off = OFF[0] + OFF[1] * z;
            all += 1.0;
            behind += f32::from(u8::from(seen > z + off));
            in_front += f32::from(u8::from(seen > 0.0 && seen < z - off));
        }
    }
    all > 0.0 && behind < BEHIND * all && in_front > IN_FRONT * all
}

/// The pixel that sees a point of the line between two points, and the depth of that point.
fn between(image: &Image<'_>, [from, to]: [Point3<f32>; 2], share: f32) -> Option<(usize, f32)> {
    let point = from + (to - from) * share;
    let ([fx, fy], [cx, cy]) = (image.focal, image.centre);
    let (u, v) = ((fx * point.x / point.z + cx).round(), (fy * point.y / point.z + cy).round());
    let is_inside = u >= 0.0 && v >= 0.0 && u < image.width as f32;
    let at = v.max(0.0) as usize * image.width + u.max(0.0) as usize;
    (is_inside && at < image.all_m.len()).then_some((at, point.z))
}
