//! Which pixels the tabletops part from those below.
//!
//! Small and distant bodies meet a tabletop in no crease that is seen: their height tells them apart. Bodies beside a box, and taller than
//! it, are above its top too, and are whole.

use std::collections::BTreeMap;

use super::image::{Image, NONE};
use super::surface::Surface;

/// Cosine between a level face's normal and the vertical, at least: 25 degrees, as for creases.
const LEVEL_COSINE: f32 = 0.906;
/// Share of a face's pixels from which a segment has it.
// What stands on a face may cut it in several.
const MIN_FACE_SHARE: f32 = 0.1;
/// Share of a segment's pixels above a face, or level with it, from which it may stand on it.
const MIN_ON_SHARE: f32 = 0.9;
/// Tabletops, at most.
const MOST: usize = u8::BITS as usize;

/// Pixels of a segment: all, and by tabletop those on its face, and those above it or at its height.
#[derive(Clone, Copy, Default)]
struct Counts {
    all: u32,
    face: [u32; MOST],
    on: [u32; MOST],
}

/// (height * width) The tabletops that a pixel is above, where its segment has their face or may stand on it. Without normals all is
/// a face that is at its height. None where no pixel is above any.
pub(super) fn above(image: &Image<'_>, surface: &Surface, segments: &[u32]) -> Option<Vec<u8>> {
    let tabletops = &image.tabletops;
    if tabletops.above.iter().all(|bits| *bits == 0) {
        return None;
    }
    let is_level = |at: usize| {
        !surface.is_there()
            || surface.normal(at).is_some_and(|normal| normal.dot(&tabletops.up) > LEVEL_COSINE)
    };
    let mut all = Counts::default();
    let mut counts: BTreeMap<u32, Counts> = BTreeMap::new();
    let mut last = (NONE, Counts::default());
    let bits = tabletops.above.iter().zip(tabletops.level);
    for (at, ((above, level), segment)) in bits.zip(segments).enumerate() {
        if *segment == NONE {
            continue;
        }
        // Pixels of a row are mostly of one segment.
        if *segment != last.0 {
            counts.insert(last.0, last.1);
            last = (*segment, counts.get(segment).copied().unwrap_or_default());
        }
        let own = &mut last.1;
        own.all += 1;
        if above | level == 0 {
            continue;
        }
        let is_face = *level > 0 && is_level(at);
        for number in 0..MOST {
            let bit = 1u8 << number;
            let face = u32::from(is_face && level & bit > 0);
            own.face[number] += face;
            all.face[number] += face;
            own.on[number] += u32::from((above | level) & bit > 0);
        }
    }
    counts.insert(last.0, last.1);
    let holds = |own: &Counts| {
        (0..MOST).fold(0u8, |bits, number| {
            let has_face = own.face[number] as f32 > MIN_FACE_SHARE * all.face[number] as f32;
            let is_on = own.on[number] as f32 > MIN_ON_SHARE * own.all as f32;
            bits | u8::from(has_face || is_on) << number
        })
    };
    let holds: BTreeMap<u32, u8> =
        counts.iter().map(|(segment, own)| (*segment, holds(own))).collect();
    let mut last = (NONE, 0);
    let mut of = |segment: u32| {
        if segment != last.0 {
            last = (segment, holds.get(&segment).copied().unwrap_or(0));
        }
        last.1
    };
    let mut held = vec![0; segments.len()];
    for ((held, above), segment) in held.iter_mut().zip(tabletops.above).zip(segments) {
        if *above > 0 && *segment != NONE {
            *held = above & of(*segment);
        }
    }
    Some(held)
}
