//! How well a segmentation finds the bodies of an image: the scores of unseen-object segmentation.
//!
//! Segments and true bodies are assigned one to one, so that the sum of their overlaps' F is greatest (Xie et al., "Unseen Object Instance
//! Segmentation for Robotic Environments", 2021). Label 0 is no body: support, background and what was not measured.
//!
//! ```
//! use rigidformer_evaluation::segments::score;
//! let truth = [0, 1, 1, 0, 0, 1, 1, 0];
//! let found = [0, 7, 7, 7, 0, 7, 7, 0];
//! let score = score(&found, &truth, None, [4, 2])?;
//! assert_eq!((score.overlap.recall, score.overlap.precision), (1.0, 0.8));
//! assert_eq!((score.objects, score.found_50, score.found_75), (1, 1, 1));
//! # Ok::<(), rigidformer_evaluation::segments::SegmentsError>(())
//! ```

mod boundary;
mod image;
mod rates;

use pathfinding::kuhn_munkres::kuhn_munkres;
use pathfinding::matrix::Matrix;
use rigidformer_perception::capture::DepthView;

use image::Image;
use rates::{rates, share};

pub use boundary::BOUNDARY_TOLERANCE;
pub use image::{MOST, SegmentsError};
pub use rates::Rates;

/// Steps of an overlap's F in the assignment, which is exact in whole numbers.
const F_STEPS: f64 = 1e9;

/// How well the segments of an image, or of several, fit its bodies.
#[derive(Clone, Copy, Debug, Default, PartialEq, serde::Serialize)]
pub struct SegmentsScore {
    /// Of pixels.
    pub overlap: Rates,
    /// Of pixels at the boundaries, within [`BOUNDARY_TOLERANCE`].
    pub boundary: Rates,
    /// True bodies.
    pub objects: usize,
    /// Segments.
    pub segments: usize,
    /// Bodies whose segment has an intersection over union of at least .5.
    pub found_50: usize,
    /// Of at least .75.
    pub found_75: usize,
    /// Share of the measured pixels on no body that no segment has; 1 where there are none.
    pub support: f64,
}

impl SegmentsScore {
    /// Share of the bodies that are found with an intersection over union of at least .5 and .75; 1 without bodies.
    pub fn found_shares(&self) -> [f64; 2] {
        [self.found_50, self.found_75].map(|found| share(found as u64, self.objects as u64))
    }
}

/// Compares labels of one image, by rows. (height * width) With `depths`, pixels of depth 0 count as unlabelled and not as support.
///
/// # Errors
/// [`SegmentsError`] for images of different sizes or with more than [`MOST`] labels.
pub fn score(
    found: &[u16],
    truth: &[u16],
    depths: Option<&[u16]>,
    size: [u32; 2],
) -> Result<SegmentsScore, SegmentsError> {
    let pixels = size.map(|side| side as usize).iter().product();
    let is_measured = |at: usize| depths.is_none_or(|depths| depths.get(at) != Some(&0));
    for (what, given) in [
        ("labels", found.len()),
        ("true labels", truth.len()),
        ("depths", depths.map_or(pixels, <[u16]>::len)),
    ] {
        if given != pixels {
            return Err(SegmentsError::Size { what, given, pixels });
        }
    }
    let found = Image::new("segments", found, is_measured, size)?;
    let truth = Image::new("bodies", truth, is_measured, size)?;
    let overlaps = found.overlaps(&truth);
    let pairs = assigned(&found, &truth, &overlaps);
    let (mut same, mut found_50, mut found_75) = (0, 0, 0);
    for [a, b] in &pairs {
        let both = overlaps.at(*a, *b);
        let union = found.area(*a) + truth.area(*b) - both;
        same += both;
        found_50 += usize::from(2 * both >= union);
        found_75 += usize::from(4 * both >= 3 * union);
    }
    let (free, of) = found.unlabelled_in(&truth, is_measured);
    Ok(SegmentsScore {
        overlap: rates(same, found.labelled(), same, truth.labelled()),
        boundary: boundary::rates(&found, &truth, &pairs),
        objects: truth.count(),
        segments: found.count(),
        found_50,
        found_75,
        support: share(free, of),
    })
}

/// Compares segments with the view's labels, where it has some; see [`score`].
///
/// # Errors
/// Those of [`score`].
pub fn of_view(view: &DepthView, found: &[u16]) -> Result<Option<SegmentsScore>, SegmentsError> {
    let size = view.camera.size();
    let of = view.labels.as_deref();
    of.map(|truth| score(found, truth, Some(&view.depth), size)).transpose()
}

/// Means of the rates over images, and sums of the counts; none without images.
pub fn mean(scores: &[SegmentsScore]) -> Option<SegmentsScore> {
    let of = |number: fn(&SegmentsScore) -> f64| {
        scores.iter().map(number).sum::<f64>() / scores.len() as f64
    };
    let sum = |number: fn(&SegmentsScore) -> usize| scores.iter().map(number).sum();
    (!scores.is_empty()).then(|| SegmentsScore {
        overlap: Rates {
            precision: of(|score| score.overlap.precision),
            recall: of(|score| score.overlap.recall),
            f: of(|score| score.overlap.f),
        },
        boundary: Rates {
            precision: of(|score| score.boundary.precision),
            recall: of(|score| score.boundary.recall),
            f: of(|score| score.boundary.f),
        },
        objects: sum(|score| score.objects),
        segments: sum(|score| score.segments),
        found_50: sum(|score| score.found_50),
        found_75: sum(|score| score.found_75),
        support: of(|score| score.support),
    })
}

/// Pairs of a segment and a body that overlap, by the best one-to-one assignment.
fn assigned(found: &Image, truth: &Image, overlaps: &image::Overlaps) -> Vec<[usize; 2]> {
    let (rows, columns) = (found.count(), truth.count());
    if rows == 0 || columns == 0 {
        return Vec::new();
    }
    // It wants at least as many columns as rows.
    let is_turned = rows > columns;
    let pair = |[row, column]: [usize; 2]| if is_turned { [column, row] } else { [row, column] };
    let [rows, columns] = pair([rows, columns]);
    let weights = Matrix::from_fn(rows, columns, |(row, column)| {
        let [a, b] = pair([row, column]);
        let f = 2.0 * overlaps.at(a, b) as f64 / (found.area(a) + truth.area(b)).max(1) as f64;
        (f * F_STEPS).round() as i64
    });
    let (_, column_of) = kuhn_munkres(&weights);
    let pairs = column_of.into_iter().enumerate().map(|(row, column)| pair([row, column]));
    pairs.filter(|[a, b]| overlaps.at(*a, *b) > 0).collect()
}

#[cfg(test)]
mod tests;
