//! Estimates the noise of a depth camera from its own images.

use super::capture::DepthView;

/// Depth steps of a bin, of 65,536.
// Noise grows with depth, so each of 32 ranges has an estimate.
const BIN: usize = 2048;
const BINS: usize = 65_536 / BIN;
/// Differences that a median needs.
const MIN_DIFFERENCES: usize = 60;
/// Differences of a bin, at most.
// More of them hardly change the median.
const MAX_DIFFERENCES: usize = 400;
/// Weight of a new estimate in the exponential mean over captures.
// A capture has few differences in some bins, so single estimates scatter.
const SMOOTHING: f32 = 0.1;
/// Median of absolute second differences, in standard deviations of a value.
// .6745 deviations are the median of a normal distribution, and a second difference has 6 times the variance.
const MEDIAN_OF_SECOND_DIFFERENCES: f32 = 0.674_5 * 2.449_49;

/// Standard deviation of a camera's depths, by depth.
///
/// On a plane 1 / z is linear in pixels, so second differences of 1 / z along a row are noise. Edges hardly change their median. A bin
/// without differences takes the deviation of 1 / z of the nearest bin that has one.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct DepthNoise {
    /// (bins) Standard deviation of 1 / z, 1/m; 0: not known.
    inverse: [f32; BINS],
    /// (bins) metres
    deviation: [f32; BINS],
}

impl Default for DepthNoise {
    fn default() -> Self {
        DepthNoise { inverse: [0.0; BINS], deviation: [0.001; BINS] }
    }
}

impl DepthNoise {
    /// Standard deviation along the camera's axis at a depth, metres.
    pub(super) fn deviation_m(&self, steps: u16) -> f32 {
        self.deviation[usize::from(steps) / BIN]
    }

    /// Updates the estimates with an image.
    pub(super) fn update(&mut self, view: &DepthView) {
        let width = view.camera.size()[0] as usize;
        let mut differences: Vec<Vec<f32>> = vec![Vec::new(); BINS];
        // Every third row and every second triple suffice for a median.
        for row in view.depth.chunks_exact(width.max(3)).step_by(3) {
            for three in row.chunks_exact(3).step_by(2) {
                // 0 and the largest number stand for no measurement.
                if three.contains(&0) || three.contains(&u16::MAX) {
                    continue;
                }
                let bin = &mut differences[usize::from(three[1]) / BIN];
                if bin.len() < MAX_DIFFERENCES {
                    let [a, b, c] =
                        [0, 1, 2].map(|pixel| 1.0 / (f32::from(three[pixel]) * view.scale_m));
                    bin.push((a - 2.0 * b + c).abs());
                }
            }
        }
        for (known, bin) in self.inverse.iter_mut().zip(&mut differences) {
            if bin.len() < MIN_DIFFERENCES {
                continue;
            }
            let middle = bin.len() / 2;
            let (_, median, _) = bin.select_nth_unstable_by(middle, f32::total_cmp);
            let measured = *median / MEDIAN_OF_SECOND_DIFFERENCES;
            *known = if *known > 0.0 { *known + SMOOTHING * (measured - *known) } else { measured };
        }
        // A uniform distribution over a step has a deviation of 1 / sqrt(12) steps.
        let rounding = view.scale_m * 0.288_7;
        for bin in 0..BINS {
            let near = (0..BINS).filter(|other| self.inverse[*other] > 0.0);
            let near = near.min_by_key(|other| other.abs_diff(bin));
            let z = (bin as f32 + 0.5) * BIN as f32 * view.scale_m;
            // dz = z^2 d(1 / z).
            let deviation = near.map_or(0.001, |near| self.inverse[near] * z * z);
            self.deviation[bin] = deviation.max(rounding);
        }
    }
}
