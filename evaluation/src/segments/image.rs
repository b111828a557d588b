//! A labelled image, its labels numbered from 0.

use std::collections::BTreeMap;

/// Segments or bodies of an image, at most.
// The assignment takes the third power of their number.
pub const MOST: usize = 512;

/// Why images cannot be compared.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum SegmentsError {
    /// Images of different sizes.
    #[error("{given} {what} for {pixels} pixels: give one a pixel")]
    Size {
        /// Labels or depths.
        what: &'static str,
        /// As given.
        given: usize,
        /// Of the image.
        pixels: usize,
    },
    /// More labels than are assigned.
    #[error(
        "{given} {what} in an image, more than {MOST}: give labels of bodies, 0 for what is none"
    )]
    TooMany {
        /// Segments or true bodies.
        what: &'static str,
        /// In the image.
        given: usize,
    },
}

/// Segments of an image.
pub(super) struct Image {
    pub(super) width: usize,
    pub(super) height: usize,
    /// (height * width)
    segment: Vec<Option<usize>>,
    /// Pixels. (segments)
    areas: Vec<u64>,
}

/// Pixels that a segment of one image shares with one of another.
pub(super) struct Overlaps {
    columns: usize,
    pixels: Vec<u64>,
}

impl Overlaps {
    pub(super) fn at(&self, row: usize, column: usize) -> u64 {
        self.pixels.get(row * self.columns + column).copied().unwrap_or(0)
    }
}

impl Image {
    pub(super) fn new(
        what: &'static str,
        labels: &[u16],
        is_measured: impl Fn(usize) -> bool,
        [width, height]: [u32; 2],
    ) -> Result<Self, SegmentsError> {
        let label =
            |at: usize| labels.get(at).copied().filter(|label| *label > 0 && is_measured(at));
        let mut numbers = BTreeMap::new();
        for label in (0..labels.len()).filter_map(label) {
            let next = numbers.len();
            numbers.entry(label).or_insert(next);
        }
        if numbers.len() > MOST {
            return Err(SegmentsError::TooMany { what, given: numbers.len() });
        }
        let number = |at| label(at).and_then(|label| numbers.get(&label).copied());
        let segment: Vec<Option<usize>> = (0..labels.len()).map(number).collect();
        let mut areas = vec![0; numbers.len()];
        for number in segment.iter().flatten() {
            areas[*number] += 1;
        }
        Ok(Image { width: width as usize, height: height as usize, segment, areas })
    }

    /// Segments.
    pub(super) fn count(&self) -> usize {
        self.areas.len()
    }

    /// Pixels of a segment.
    pub(super) fn area(&self, segment: usize) -> u64 {
        self.areas.get(segment).copied().unwrap_or(0)
    }

    /// Pixels of all segments.
    pub(super) fn labelled(&self) -> u64 {
        self.areas.iter().sum()
    }

    pub(super) fn at(&self, column: usize, row: usize) -> Option<usize> {
        self.segment.get(row * self.width + column).copied().flatten()
    }

    pub(super) fn overlaps(&self, other: &Image) -> Overlaps {
        let columns = other.count();
        let mut pixels = vec![0; self.count() * columns];
        for (own, other) in self.segment.iter().zip(&other.segment) {
            if let (Some(own), Some(other)) = (own, other) {
                pixels[own * columns + other] += 1;
            }
        }
        Overlaps { columns, pixels }
    }

    /// Measured pixels without a segment in both images, and in the other one.
    pub(super) fn unlabelled_in(
        &self,
        other: &Image,
        is_measured: impl Fn(usize) -> bool,
    ) -> (u64, u64) {
        let pairs = self.segment.iter().zip(&other.segment).enumerate();
        let free = pairs.filter(|(at, (_, other))| other.is_none() && is_measured(*at));
        free.fold((0, 0), |(both, one), (_, (own, _))| (both + u64::from(own.is_none()), one + 1))
    }
}
