//! Where boundaries of segments agree.

use super::image::Image;
use super::rates::{Rates, rates as of_counts};

/// Distance at which boundaries agree, in diagonals of the image.
// The field's number, of the DAVIS benchmark.
pub const BOUNDARY_TOLERANCE: f64 = 0.0075;

/// Rates of boundary pixels: one is right within the tolerance of the boundary of the body that its segment is assigned to.
pub(super) fn rates(found: &Image, truth: &Image, pairs: &[[usize; 2]]) -> Rates {
    let diagonal = (found.width as f64).hypot(found.height as f64);
    // At least a pixel, as the field rounds.
    let reach = (diagonal * BOUNDARY_TOLERANCE).ceil() as i64;
    let [found, truth] = [found, truth].map(boundaries);
    let empty: &[Pixel] = &[];
    let all = |of: &[Vec<Pixel>]| of.iter().map(|pixels| pixels.len() as u64).sum::<u64>();
    let (mut right, mut met) = (0, 0);
    for [a, b] in pairs {
        let own = found.get(*a).map_or(empty, Vec::as_slice);
        let other = truth.get(*b).map_or(empty, Vec::as_slice);
        right += near(own, other, reach);
        met += near(other, own, reach);
    }
    of_counts(right, all(&found), met, all(&truth))
}

/// Row and column.
type Pixel = [i64; 2];

/// Pixels of each segment with another one, or none, beside them; by rows. The image's edge is no boundary.
fn boundaries(image: &Image) -> Vec<Vec<Pixel>> {
    let mut all = vec![Vec::new(); image.count()];
    for row in 0..image.height {
        for column in 0..image.width {
            let Some(segment) = image.at(column, row) else { continue };
            let differs = |column: usize, row: usize| image.at(column, row) != Some(segment);
            let is_boundary = (column > 0 && differs(column - 1, row))
                || (column + 1 < image.width && differs(column + 1, row))
                || (row > 0 && differs(column, row - 1))
                || (row + 1 < image.height && differs(column, row + 1));
            if let Some(pixels) = all.get_mut(segment).filter(|_| is_boundary) {
                pixels.push([row as i64, column as i64]);
            }
        }
    }
    all
}

/// How many pixels have one of the others within so many pixels. The others are in the order of rows, so each row of the disc is one
/// binary search.
fn near(pixels: &[Pixel], others: &[Pixel], reach: i64) -> u64 {
    let is_near = |[row, column]: &Pixel| {
        (-reach..=reach).any(|down| {
            let across = (((reach * reach - down * down) as f64).sqrt()) as i64;
            let first = [row + down, column - across];
            let at = others.partition_point(|other| *other < first);
            others.get(at).is_some_and(|other| *other <= [row + down, column + across])
        })
    };
    pixels.iter().filter(|pixel| is_near(pixel)).count() as u64
}
