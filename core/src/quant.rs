//! Quantisation: the one definition that the core, the packer and every kernel share.
//!
//! - Weights: int8, symmetric, one scale per output channel, stored.
//! - Activations: int8, symmetric, one scale per row, measured as the row comes.
//! - Products: exact in i32; one f32 epilogue, `accumulator * (row scale * channel scale) + bias`.
//!
//! These functions compute as the thread is set; [`in_own_environment`](crate::kernels::in_own_environment) runs them to nearest.

/// The largest int8 that is used: -128 is not, so that negation is exact.
pub const LIMIT: f32 = 127.0;

/// A row whose numbers are all smaller is zero to every reader: the inverse would overflow.
pub const DUST: f32 = 1e-30;

/// Scales of a row whose largest magnitude is `largest`: what one quantum stands for, and
/// its inverse. A row of zeros has quantum 0.
pub fn quantum(largest: f32) -> (f32, f32) {
    if largest < DUST {
        return (0.0, 0.0);
    }
    (largest / LIMIT, LIMIT / largest)
}

/// Nearest integer within +-127, ties to even.
///
/// Adding 1.5 * 2^23 leaves no bits behind the point, so the sum rounds as f32 addition
/// does on every target: to nearest, ties to even.
pub fn round(x: f32) -> i8 {
    const SHIFT: f32 = 12_582_912.0;
    let rounded = (x.clamp(-LIMIT, LIMIT) + SHIFT) - SHIFT;
    rounded as i8
}

/// Largest magnitude of a row.
pub fn largest(row: &[f32]) -> f32 {
    row.iter().fold(0.0_f32, |m, x| m.max(x.abs()))
}

/// Quantises a row into `out` and returns what one quantum stands for: NaN for a row that is
/// not finite, so that what follows is NaN and cannot pass for a prediction.
///
/// ```
/// let mut out = [0; 3];
/// let scale = rigidformer_core::quant::quantise_row(&[0.5, -2.0, 1.0], &mut out);
/// assert_eq!(out, [32, -127, 64]);
/// assert_eq!(scale, 2.0 / 127.0);
/// ```
pub fn quantise_row(row: &[f32], out: &mut [i8]) -> f32 {
    // 0 x is 0 for what is finite and NaN for what is not.
    let flaw = row.iter().fold(0.0_f32, |sum, x| sum + 0.0 * x);
    let (scale, inverse) = quantum(largest(row));
    for (q, x) in out.iter_mut().zip(row) {
        *q = round(x * inverse);
    }
    scale + flaw
}

/// Rows that small kernels quantise at a time.
pub const TILE: usize = 32;

/// Scratch of a quantised layer: a tile of rows and their scales, in a layout that is the
/// kernels' own.
pub struct Scratch<'s> {
    /// At least [`scratch_bytes`].
    pub values: &'s mut [i8],
    /// As many as the kernels' [`Tiles::rows`](crate::Tiles::rows).
    pub scales: &'s mut [f32],
}

impl<'s> Scratch<'s> {
    /// Two parts, the left one of so many shares: each has room for its share of the rows.
    pub(crate) fn split(self, (left, of): (usize, usize)) -> [Scratch<'s>; 2] {
        let rows = self.scales.len() / of.max(1) * left;
        // As many bytes a row as before, so that each part has room for all of its rows.
        let bytes = self.values.len() / self.scales.len().max(1) * rows;
        let values = self.values.split_at_mut(bytes.min(self.values.len()));
        let scales = self.scales.split_at_mut(rows.min(self.scales.len()));
        let [left, right] = [(values.0, scales.0), (values.1, scales.1)];
        [left, right].map(|(values, scales)| Scratch { values, scales })
    }
}

/// Bytes that any kernels need for a tile of so many rows of so many inputs: values of 16 bits,
/// inputs by fours, two channels of weights beside the rows, a scale or a sum a row, and alignment to
/// words.
pub const fn scratch_bytes(inputs: usize, rows: usize) -> usize {
    let inputs = inputs.div_ceil(4).saturating_mul(4);
    let values = inputs.saturating_mul(rows.saturating_add(2).saturating_mul(2));
    values.saturating_add(rows.saturating_mul(4)).saturating_add(4)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rounding_is_to_nearest_ties_to_even_and_saturates() {
        for i in -130_000..=130_000 {
            let x = i as f32 / 1000.0;
            let expected = x.clamp(-127.0, 127.0).round_ties_even() as i8;
            assert_eq!(round(x), expected, "{x}");
        }
        assert_eq!(round(f32::NAN), 0);
    }

    #[test]
    fn a_row_of_zeros_or_dust_is_zero() {
        for row in [[0.0, -0.0], [1e-31, -1e-38]] {
            let mut out = [7; 2];
            assert_eq!(quantise_row(&row, &mut out), 0.0);
            assert_eq!(out, [0, 0]);
        }
    }

    #[test]
    fn a_row_that_is_not_finite_says_so() {
        for bad in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
            assert!(quantise_row(&[1.0, bad, -2.0], &mut [0; 3]).is_nan());
        }
    }

    #[test]
    fn the_error_is_at_most_half_a_quantum() {
        let row = core::array::from_fn::<f32, 64, _>(|i| ((i * 37 % 64) as f32 - 31.0) * 0.013);
        let mut out = [0; 64];
        let scale = quantise_row(&row, &mut out);
        for (x, q) in row.iter().zip(out) {
            assert!((x - f32::from(q) * scale).abs() <= scale * 0.5001);
        }
    }
}
