//! An encoder of H.264 (ITU-T H.264) whose pictures decode to the very samples that it was given.
//!
//! The first picture is an IDR picture, all others refer to the one before. A macroblock is the first of these that fits:
//! - P_Skip: it is that of the picture before;
//! - Intra_16x16 without a residual: every row repeats the row above, or the sample on its left;
//! - I_PCM: its samples, as they are.
//!
//! There is no transform and no deblocking, so nothing is rounded. With 4:2:0 the stream is of the Constrained Baseline profile.

use super::bits::Bits;
use super::kind::{Kind, Rate};
use super::planes::{Colours, Place, Planes, blocks};

/// Of the Constrained Baseline profile, and of High 4:4:4 Predictive.
const BASELINE: [u8; 2] = [66, 0xC0];
const HIGH_444: [u8; 2] = [244, 0];
/// The level that has room for pictures of I_PCM alone at 720 x 480, and its macroblocks a picture and a second.
const LEVEL: (u8, u64, u64) = (51, 36_864, 983_040);
/// The highest level.
const HIGHEST_LEVEL: u8 = 62;

// Headers: how much others depend on a unit, and its type.
const SEQUENCE: u8 = 0x67;
const PICTURE: u8 = 0x68;
const IDR_SLICE: u8 = 0x65;
const SLICE: u8 = 0x41;

/// Of numbers of pictures.
const NUMBER_BITS: u32 = 8;
/// Types of macroblocks in pictures that refer to none. In others five types come before them.
const I_16X16: u32 = 1;
const I_PCM: u32 = 25;
const P_TYPES: u32 = 5;

// Colour primaries of BT.709, the transfer of sRGB; the matrix of BT.601, or none: red, green, blue.
const PRIMARIES: u8 = 1;
const TRANSFER: u8 = 13;
const BT601: u8 = 6;
const RGB: u8 = 0;

/// What a decoder must know before the first picture.
pub(super) struct Parameters {
    /// Profile, its constraints, and the level.
    pub(super) profile: [u8; 3],
    pub(super) sequence: Vec<u8>,
    pub(super) picture: Vec<u8>,
}

/// Primaries, transfer and matrix of colours, and whether they take the full range.
pub(super) fn colour_codes(colours: Colours) -> ([u8; 3], bool) {
    match colours {
        Colours::Shared => ([PRIMARIES, TRANSFER, BT601], false),
        Colours::Exact => ([PRIMARIES, TRANSFER, RGB], true),
    }
}

pub(super) struct Encoder {
    colours: Colours,
    /// Macroblocks a row, and rows of them.
    blocks: [usize; 2],
    parameters: Parameters,
    previous: Option<Planes>,
    /// Of the next picture.
    number: u32,
}

/// A picture that is being encoded.
struct Slice<'p> {
    bits: Bits,
    planes: &'p Planes,
    colours: Colours,
    /// Macroblocks a row.
    columns: usize,
    /// What its types begin with.
    types: u32,
    /// (macroblocks so far) Whether they are I_PCM.
    stored: Vec<bool>,
}

impl Encoder {
    pub(super) fn new(kind: &Kind) -> Encoder {
        let blocks = blocks(kind.size);
        let profile = profile(kind, blocks);
        let parameters =
            Parameters { profile, sequence: sequence(kind, blocks, profile), picture: picture() };
        Encoder { colours: kind.colours, blocks, parameters, previous: None, number: 0 }
    }

    pub(super) fn parameters(&self) -> &Parameters {
        &self.parameters
    }

    /// The next picture, as one unit.
    pub(super) fn encode(&mut self, planes: Planes) -> Vec<u8> {
        let [columns, rows] = self.blocks;
        let is_first = self.previous.is_none();
        let bits = slice_header(is_first, self.number);
        let types = if is_first { 0 } else { P_TYPES };
        let stored = Vec::with_capacity(columns * rows);
        let colours = self.colours;
        let mut slice = Slice { bits, planes: &planes, colours, columns, types, stored };
        let mut skipped = 0;
        for at in 0..columns * rows {
            let place = Place { column: at % columns, row: at / columns };
            if let Some(previous) = &self.previous {
                let pairs = planes.all.iter().zip(&previous.all);
                if pairs.into_iter().all(|(now, before)| now.is_like(before, place)) {
                    slice.stored.push(false);
                    skipped += 1;
                    continue;
                }
                slice.bits.number(skipped);
                skipped = 0;
            }
            slice.block(place);
        }
        if skipped > 0 {
            slice.bits.number(skipped);
        }
        let unit = slice.bits.unit(if is_first { IDR_SLICE } else { SLICE });
        self.previous = Some(planes);
        self.number = (self.number + 1) % (1 << NUMBER_BITS);
        unit
    }
}

impl Slice<'_> {
    /// A macroblock that the picture before does not have.
    fn block(&mut self, place: Place) {
        let Some(modes) = self.modes(place) else { return self.store(place) };
        self.bits.number(self.types + I_16X16 + modes.luma);
        if let Some(chroma) = modes.chroma {
            self.bits.number(chroma);
        }
        // The quantiser stays: a signed 0.
        self.bits.number(0);
        // There is no residual: no plane that is predicted like luma has a coefficient in its first 4 x 4 block. The code of that 0 depends
        // on how many the neighbours have: I_PCM counts as 16, all others have none.
        let neighbours = [(place.column > 0).then_some(1), (place.row > 0).then_some(self.columns)];
        let at = self.stored.len();
        let is_stored = |back: usize| self.stored.get(at - back).copied().unwrap_or_default();
        let is_any_stored = neighbours.into_iter().flatten().any(is_stored);
        let planes = if self.colours == Colours::Exact { 3 } else { 1 };
        for _ in 0..planes {
            if is_any_stored { self.bits.put(0b00_0011, 6) } else { self.bits.put(1, 1) }
        }
        self.stored.push(false);
    }

    fn store(&mut self, place: Place) {
        self.bits.number(self.types + I_PCM);
        // The first row goes to the next whole byte.
        for plane in &self.planes.all {
            for row in plane.rows(place) {
                self.bits.bytes(row);
            }
        }
        self.stored.push(true);
    }

    /// How the neighbours predict all of a macroblock, if they do.
    fn modes(&self, place: Place) -> Option<Modes> {
        const ABOVE: u32 = 0;
        const LEFT: u32 = 1;
        let [luma, chroma @ ..] = &self.planes.all;
        let all = |above: bool| {
            let mut chroma = chroma.iter();
            match above {
                true => chroma.all(|plane| plane.repeats_above(place)),
                false => chroma.all(|plane| plane.repeats_left(place)),
            }
        };
        let (above, left) = (luma.repeats_above(place), luma.repeats_left(place));
        match self.colours {
            Colours::Exact if above && all(true) => Some(Modes { luma: ABOVE, chroma: None }),
            Colours::Exact if left && all(false) => Some(Modes { luma: LEFT, chroma: None }),
            Colours::Exact => None,
            Colours::Shared => {
                let luma = above.then_some(ABOVE).or(left.then_some(LEFT))?;
                // Chroma has other numbers: 2 is from above.
                let chroma = all(true).then_some(2).or(all(false).then_some(1))?;
                Some(Modes { luma, chroma: Some(chroma) })
            }
        }
    }
}

/// Numbers of modes of prediction.
struct Modes {
    luma: u32,
    /// With 4:2:0.
    chroma: Option<u32>,
}

fn profile(kind: &Kind, [columns, rows]: [usize; 2]) -> [u8; 3] {
    let count = (columns * rows) as u64;
    let (level, picture, second) = LEVEL;
    let fits = count <= picture && count * u64::from(kind.rate.thousandths) <= second * 1000;
    let [profile, constraints] = match kind.colours {
        Colours::Shared => BASELINE,
        Colours::Exact => HIGH_444,
    };
    [profile, constraints, if fits { level } else { HIGHEST_LEVEL }]
}

/// The sequence parameter set.
fn sequence(kind: &Kind, [columns, rows]: [usize; 2], profile: [u8; 3]) -> Vec<u8> {
    let mut bits = Bits::default();
    bits.bytes(&profile);
    bits.number(0);
    if kind.colours == Colours::Exact {
        // 4:4:4 in one unit, 8 bits, with the transform, without scaling lists.
        bits.number(3);
        bits.put(0, 1);
        bits.number(0);
        bits.number(0);
        bits.put(0, 2);
    }
    bits.number(NUMBER_BITS - 4);
    // Pictures are shown as they come; one is referred to; no numbers are missing.
    bits.number(2);
    bits.number(1);
    bits.put(0, 1);
    bits.number(columns as u32 - 1);
    bits.number(rows as u32 - 1);
    // Frames, not fields; direct prediction by 8 x 8.
    bits.put(0b11, 2);
    let [right, below] = [(columns, kind.size[0]), (rows, kind.size[1])]
        .map(|(count, side)| count as u32 * 16 - side);
    let is_cut = right + below > 0;
    bits.put(u32::from(is_cut), 1);
    if is_cut {
        // In samples of chroma.
        let unit = if kind.colours == Colours::Shared { 2 } else { 1 };
        for pixels in [0, right, 0, below] {
            bits.number(pixels / unit);
        }
    }
    bits.put(1, 1);
    usability(&mut bits, kind);
    bits.unit(SEQUENCE)
}

/// How pictures are shown.
fn usability(bits: &mut Bits, kind: &Kind) {
    // Square pixels.
    bits.put(1, 1);
    bits.put(1, 8);
    // Nothing of overscan; colours of no video standard's.
    bits.put(0, 1);
    bits.put(1, 1);
    bits.put(5, 3);
    let (codes, is_full) = colour_codes(kind.colours);
    bits.put(u32::from(is_full), 1);
    bits.put(1, 1);
    for code in codes {
        bits.put(code.into(), 8);
    }
    // Chroma is the mean of four pixels, so it lies between them.
    let is_shared = kind.colours == Colours::Shared;
    bits.put(u32::from(is_shared), 1);
    if is_shared {
        bits.number(1);
        bits.number(1);
    }
    // A frame has two fields, though nobody shows them.
    let Rate { thousandths } = kind.rate;
    bits.put(1, 1);
    bits.put(1000, 32);
    bits.put(2 * thousandths, 32);
    bits.put(1, 1);
    // No buffering model, no structure; no motion, no limits, nothing out of order, one picture kept.
    bits.put(0, 3);
    bits.put(1, 1);
    bits.put(0, 1);
    for limit in [0, 0, 0, 0, 0, 1] {
        bits.number(limit);
    }
}

/// The picture parameter set: CAVLC, one slice, no weights; slices say that nothing is deblocked.
fn picture() -> Vec<u8> {
    let mut bits = Bits::default();
    bits.number(0);
    bits.number(0);
    bits.put(0, 2);
    for _ in 0..3 {
        bits.number(0);
    }
    bits.put(0, 3);
    for _ in 0..3 {
        bits.number(0);
    }
    bits.put(0b100, 3);
    bits.unit(PICTURE)
}

fn slice_header(is_first: bool, number: u32) -> Bits {
    let mut bits = Bits::default();
    bits.number(0);
    // All slices are I, or P.
    bits.number(if is_first { 7 } else { 5 });
    bits.number(0);
    bits.put(number, NUMBER_BITS);
    if is_first {
        // Its own number; it keeps nothing before it, and not for long.
        bits.number(0);
        bits.put(0, 2);
    } else {
        // One picture to refer to, in its usual place, kept as usual.
        bits.put(0, 3);
    }
    // The usual quantiser, and no deblocking.
    bits.number(0);
    bits.number(1);
    bits
}
