//! How noisy a depth camera is, from its own images.

use super::capture::DepthView;

/// Depths that share an estimate: so many steps of 65,536.
const BIN: usize = 2048;
const BINS: usize = 65_536 / BIN;
/// Differences that an estimate needs.
const LEAST: usize = 60;
/// Differences of a bin that are looked at, at most.
const MOST: usize = 400;
/// Part of a new estimate in the mean over captures.
const FRESH: f32 = 0.1;
/// The median of absolute values, in deviations of a normal distribution; a second difference has 6 times the variance.
const MEDIAN: f32 = 0.674_5 * 2.449_49;

/// Standard deviation of a camera's depths, by depth.
///
/// On a plane 1 / z is linear in pixels, so second differences of 1 / z along a row are noise. Their median is not moved by edges.
/// Depths that nothing is seen at have the deviation of the nearest ones that have, times the square of the distance.
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

    /// Looks at an image; estimates are means over those that were looked at.
    pub(super) fn look(&mut self, view: &DepthView) {
        let width = view.camera.size()[0] as usize;
        let mut differences: Vec<Vec<f32>> = vec![Vec::new(); BINS];
        for row in view.depth.chunks_exact(width.max(3)).step_by(3) {
            for three in row.chunks_exact(3).step_by(2) {
                if three.contains(&0) || three.contains(&u16::MAX) {
                    continue;
                }
                let bin = &mut differences[usize::from(three[1]) / BIN];
                if bin.len() < MOST {
                    let [a, b, c] =
                        [0, 1, 2].map(|place| 1.0 / (f32::from(three[place]) * view.scale_m));
                    bin.push((a - 2.0 * b + c).abs());
                }
            }
        }
        for (known, bin) in self.inverse.iter_mut().zip(&mut differences) {
            if bin.len() < LEAST {
                continue;
            }
            let middle = bin.len() / 2;
            let (_, median, _) = bin.select_nth_unstable_by(middle, f32::total_cmp);
            let seen = *median / MEDIAN;
            *known = if *known > 0.0 { *known + FRESH * (seen - *known) } else { seen };
        }
        let rounding = view.scale_m * 0.288_7;
        for bin in 0..BINS {
            let near = (0..BINS).filter(|other| self.inverse[*other] > 0.0);
            let near = near.min_by_key(|other| other.abs_diff(bin));
            let z = (bin as f32 + 0.5) * BIN as f32 * view.scale_m;
            let deviation = near.map_or(0.001, |near| self.inverse[near] * z * z);
            self.deviation[bin] = deviation.max(rounding);
        }
    }
}
