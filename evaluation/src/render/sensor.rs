//! What a sensor makes of true depths.

use rayon::prelude::*;
use rigidformer_runtime::noise::Noise;

use super::smooth::SmoothErrors;

/// Neighbours whose depths differ by more than this share of the nearer one are at an edge.
// Slanted surfaces differ from pixel to pixel by less.
const EDGE: f32 = 0.03;

/// How a depth camera errs.
///
/// The depth of each pixel is off by a normally distributed error whose deviation grows with the square of the depth, as that of
/// cameras that measure parallax. Pixels at an edge, next to one whose depth differs by more than 3 %, are lost with a probability.
/// Pixels are independent of each other.
///
/// ```
/// use rigidformer_evaluation::render::DepthNoise;
/// let noise = DepthNoise { deviation_at_1m_m: 0.001, edge_loss: 0.3, seed: 1 };
/// assert_eq!(noise.deviation_m(2.0), 0.004);
/// assert_eq!(DepthNoise::default().deviation_m(2.0), 0.0);
/// ```
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct DepthNoise {
    /// Standard deviation of a depth of 1 m, metres; from 0 to 1.
    pub deviation_at_1m_m: f32,
    /// Share of the pixels at edges that are lost, from 0 to 1.
    pub edge_loss: f32,
    /// Another seed, other errors.
    pub seed: u64,
}

impl DepthNoise {
    /// Standard deviation of a depth, metres.
    pub fn deviation_m(&self, depth_m: f32) -> f32 {
        self.deviation_at_1m_m * depth_m * depth_m
    }

    pub(super) fn is_sound(&self) -> bool {
        let numbers = [self.deviation_at_1m_m, self.edge_loss];
        numbers.iter().all(|number| (0.0..=1.0).contains(number))
    }
}

/// Depths in steps of `scale_m`, 0 for what is not measured or too far for the number's 16 bits, and the labels of what is measured.
/// `inverse` has 1/m, (height * width), 0 for nothing, and is bent already. The errors are those of the noise's seed and a `stream`, such as the number of
/// the image.
pub(super) fn measured(
    inverse: &[f32],
    labels: &mut [u16],
    width: usize,
    scale_m: f32,
    (noise, smooth): (&DepthNoise, &SmoothErrors),
    stream: u64,
) -> Vec<u16> {
    let mut depths = vec![0_u16; inverse.len()];
    let rows = inverse.len() / width.max(1);
    let empty: &[f32] = &[];
    let row_of = |row: Option<usize>| {
        row.and_then(|row| inverse.get(row * width..(row + 1) * width)).unwrap_or(empty)
    };
    let images = depths.par_chunks_mut(width.max(1)).zip(labels.par_chunks_mut(width.max(1)));
    images.enumerate().for_each(|(row, (depths, labels))| {
        let (above, own, below) =
            (row_of(row.checked_sub(1)), row_of(Some(row)), row_of(Some(row + 1)));
        // A stream a row, so that rows run on any thread and give the same bits.
        let mut random =
            Noise::new(noise.seed, stream.wrapping_mul(rows as u64).wrapping_add(row as u64));
        for (column, (depth, label)) in depths.iter_mut().zip(labels).enumerate() {
            let here = own.get(column).copied().unwrap_or(0.0);
            let mut steps = 0.0;
            if here > 0.0 {
                let beside = [
                    column.checked_sub(1).and_then(|left| own.get(left)),
                    own.get(column + 1),
                    above.get(column),
                    below.get(column),
                ];
                let is_edge = beside.into_iter().flatten().any(|there| {
                    let (far, near) = (here.min(*there), here.max(*there));
                    // Inverse depths: beside nothing, which is 0, every pixel is at an edge.
                    near - far > EDGE * far.max(f32::MIN_POSITIVE)
                });
                // Without loss no number is drawn, so that the noise of depths does not depend on
                // it.
                let is_lost =
                    noise.edge_loss > 0.0 && is_edge && random.uniform() < noise.edge_loss;
                if !is_lost {
                    let true_m = 1.0 / here;
                    let off_m = match noise.deviation_at_1m_m > 0.0 {
                        true => noise.deviation_m(true_m) * random.normal(),
                        false => 0.0,
                    };
                    steps = (smooth.stepped_m(true_m + off_m) / scale_m).round();
                }
            }
            // 0 means not measured, and 16 bits hold no greater depth.
            *depth = if (1.0..=f32::from(u16::MAX)).contains(&steps) { steps as u16 } else { 0 };
            // A label without a depth would tell a tracker what its sensor did not see.
            if *depth == 0 {
                *label = 0;
            }
        }
    });
    depths
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Without smooth errors.
    fn measured(
        inverse: &[f32],
        labels: &mut [u16],
        width: usize,
        scale_m: f32,
        noise: &DepthNoise,
        stream: u64,
    ) -> Vec<u16> {
        let errors = (noise, &SmoothErrors::default());
        super::measured(inverse, labels, width, scale_m, errors, stream)
    }

    /// A wall at 2 m with a box at 1 m in the middle.
    fn wall() -> Vec<f32> {
        let is_box = |at: usize| (20..44).contains(&(at % 64)) && (20..44).contains(&(at / 64));
        (0..64 * 64).map(|at| if is_box(at) { 1.0 } else { 0.5 }).collect()
    }

    #[test]
    fn errors_have_the_deviation_that_is_asked_for() {
        let noise = DepthNoise { deviation_at_1m_m: 0.003, edge_loss: 0.0, seed: 3 };
        let mut labels = vec![1; 64 * 64];
        let depths = measured(&wall(), &mut labels, 64, 0.0001, &noise, 7);
        let deviation = |at_1m: bool, mean: f64| {
            let of = depths.iter().zip(wall()).filter(|(_, inverse)| (*inverse == 1.0) == at_1m);
            let squares: Vec<f64> =
                of.map(|(depth, _)| (f64::from(*depth) * 1e-4 - mean).powi(2)).collect();
            (squares.iter().sum::<f64>() / squares.len() as f64).sqrt()
        };
        assert!((deviation(true, 1.0) - 0.003).abs() < 0.0003);
        assert!((deviation(false, 2.0) - 0.012).abs() < 0.0006);
        let again = measured(&wall(), &mut labels, 64, 0.0001, &noise, 7);
        assert_eq!(depths, again);
        assert_ne!(depths, measured(&wall(), &mut labels, 64, 0.0001, &noise, 8));
    }

    #[test]
    fn edges_are_lost_and_nothing_else() {
        let noise = DepthNoise { edge_loss: 0.5, ..DepthNoise::default() };
        let mut labels = vec![1; 64 * 64];
        let depths = measured(&wall(), &mut labels, 64, 0.001, &noise, 0);
        let lost = depths.iter().filter(|depth| **depth == 0).count();
        // Two rings of about 95 pixels.
        assert!((60..130).contains(&lost), "{lost}");
        assert_eq!(depths[0], 2000);
        assert!(depths.iter().zip(&labels).all(|(depth, label)| (*depth == 0) == (*label == 0)));
    }

    #[test]
    fn what_is_too_far_or_nothing_is_0() {
        let mut labels = vec![5; 4];
        let exact = DepthNoise::default();
        let depths = measured(&[0.0, 1e-9, 0.01, f32::MAX], &mut labels, 4, 0.001, &exact, 0);
        assert_eq!((depths.as_slice(), labels.as_slice()), (&[0, 0, 0, 0][..], &[0; 4][..]));
        assert!(measured(&[], &mut [], 4, 0.001, &exact, 0).is_empty());
    }
}
