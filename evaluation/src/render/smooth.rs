//! Errors of depth cameras that are smooth over the image, and the steps of their parallax.

use rayon::prelude::*;
use rigidformer_perception::camera::Camera;
use rigidformer_runtime::noise::Noise;

/// Nodes of the wave along the image's longer side.
// 40 pixels apart in 640 columns: far more than a body's edge, less than most bodies.
const NODES: f32 = 16.0;
/// Mean, over a span, of the sum of squares of a cubic B-spline's four weights.
// Along two axes: the variance that its smoothing leaves.
const KEPT: f32 = 151.0 / 315.0;

/// How a depth camera errs beyond noise: real errors are smooth over many pixels, so that a mean over pixels does not lessen them.
///
/// ```
/// use rigidformer_evaluation::render::SmoothErrors;
/// let errors = SmoothErrors { bowl: 0.005, step_at_1m_m: 0.003, wave_at_1m_m: 0.002, seed: 1 };
/// assert_eq!(errors.step_m(2.0), 0.012);
/// assert_eq!(SmoothErrors::default().step_m(2.0), 0.0);
/// ```
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct SmoothErrors {
    /// Share by which depths are too large in the farthest corner; it grows with the square of the distance from the principal point. From
    /// 0 to 1, typically .005.
    pub bowl: f32,
    /// Step between the depths that can be measured at 1 m, metres, from 0 to 1; it grows with the square of the depth, as that of
    /// structured light.
    pub step_at_1m_m: f32,
    /// Standard deviation at 1 m, metres, from 0 to 1, of an error that changes over a sixteenth of the image. It grows with the square of
    /// the depth, and is the same in each image.
    pub wave_at_1m_m: f32,
    /// Another seed, another wave.
    pub seed: u64,
}

impl SmoothErrors {
    /// Step between the depths that can be measured, metres.
    pub fn step_m(&self, depth_m: f32) -> f32 {
        self.step_at_1m_m * depth_m * depth_m
    }

    pub(super) fn is_sound(&self) -> bool {
        let numbers = [self.bowl, self.step_at_1m_m, self.wave_at_1m_m];
        numbers.iter().all(|number| (0.0..=1.0).contains(number))
    }

    /// The depth that is measured for one, metres: parallax, which is inverse to it, comes in steps. Infinite where it rounds to 0.
    pub(super) fn stepped_m(&self, depth_m: f32) -> f32 {
        if self.step_at_1m_m <= 0.0 || depth_m <= 0.0 {
            return depth_m;
        }
        // d(1 / z) = dz / z^2.
        1.0 / ((1.0 / depth_m / self.step_at_1m_m).round() * self.step_at_1m_m)
    }

    /// Adds bowl and wave to true inverse depths, 1/m. (height * width)
    pub(super) fn bend(&self, inverse: &mut [f32], camera: &Camera) {
        if self.bowl <= 0.0 && self.wave_at_1m_m <= 0.0 {
            return;
        }
        let [width, height] = camera.size();
        let [cx, cy] = camera.centre();
        let farthest =
            |centre: f32, side: u32| centre.abs().max((side as f32 - 1.0 - centre).abs());
        let (x, y) = (farthest(cx, width), farthest(cy, height));
        let corner = (x * x + y * y).max(f32::MIN_POSITIVE);
        let wave = (self.wave_at_1m_m > 0.0).then(|| Wave::new(self.seed, [width, height]));
        let rows = inverse.par_chunks_mut((width as usize).max(1)).enumerate();
        rows.for_each(|(row, inverse)| {
            for (column, inverse) in inverse.iter_mut().enumerate().filter(|(_, here)| **here > 0.0)
            {
                let (u, v) = (column as f32 - cx, row as f32 - cy);
                let bowl = 1.0 + self.bowl * (u * u + v * v) / corner;
                let true_m = 1.0 / *inverse;
                let off = wave.as_ref().map_or(0.0, |wave| wave.at(column as f32, row as f32));
                let depth_m = true_m * bowl + self.wave_at_1m_m * true_m * true_m * off;
                // What bends behind the camera is not measured.
                *inverse = if depth_m > 0.0 { 1.0 / depth_m } else { 0.0 };
            }
        });
    }
}

/// Normal numbers at nodes, a cubic B-spline between them; deviation 1 on average over the image.
struct Wave {
    apart: f32,
    columns: usize,
    nodes: Vec<f32>,
}

impl Wave {
    fn new(seed: u64, [width, height]: [u32; 2]) -> Self {
        let apart = (width.max(height) as f32 / NODES).max(1.0);
        // A span has a node before it, and two after it.
        let [columns, rows] = [width, height].map(|side| (side as f32 / apart) as usize + 4);
        let node = |at: usize| Noise::new(seed, at as u64).normal() / KEPT;
        Wave { apart, columns, nodes: (0..columns * rows).map(node).collect() }
    }

    fn at(&self, column: f32, row: f32) -> f32 {
        let (x, y) = (column / self.apart, row / self.apart);
        let (across, down) = (weights(x.fract()), weights(y.fract()));
        let mut sum = 0.0;
        for (line, down) in down.iter().enumerate() {
            let first = (y as usize + line) * self.columns + x as usize;
            let nodes = self.nodes.get(first..first + 4).unwrap_or_default();
            sum += down * nodes.iter().zip(across).map(|(node, weight)| node * weight).sum::<f32>();
        }
        sum
    }
}

/// Of a cubic B-spline's four nodes around a span, at a share of it.
fn weights(t: f32) -> [f32; 4] {
    let s = 1.0 - t;
    let (t2, t3) = (t * t, t * t * t);
    let middle = (3.0 * t3 - 6.0 * t2 + 4.0) / 6.0;
    [s * s * s / 6.0, middle, (-3.0 * t3 + 3.0 * t2 + 3.0 * t + 1.0) / 6.0, t3 / 6.0]
}

#[cfg(test)]
mod tests {
    use nalgebra::Isometry3;

    use super::*;

    const SIZE: [u32; 2] = [161, 121];

    fn camera() -> Camera {
        Camera::new(SIZE, [123.0; 2], [80.0, 60.0], Isometry3::identity()).unwrap()
    }

    /// Depths of a wall at 2 m.
    fn bent(errors: &SmoothErrors) -> Vec<f32> {
        let mut inverse = vec![0.5; 161 * 121];
        errors.bend(&mut inverse, &camera());
        inverse.into_iter().map(|inverse| 1.0 / inverse).collect()
    }

    #[test]
    fn a_bowl_is_deepest_in_the_corners() {
        let depths = bent(&SmoothErrors { bowl: 0.005, ..SmoothErrors::default() });
        for corner in [0, 160, 161 * 120, 161 * 121 - 1] {
            assert!((depths[corner] - 2.01).abs() < 1e-5, "{}", depths[corner]);
        }
        assert_eq!(depths[60 * 161 + 80], 2.0);
        // Half way to a corner: a quarter.
        assert!((depths[30 * 161 + 40] - 2.0025).abs() < 1e-5);
    }

    #[test]
    fn a_wave_has_its_deviation_and_is_smooth() {
        // The mean over seeds: an image has few waves.
        let (mut squares, mut steps) = (0.0, 0.0_f32);
        for seed in 0..20 {
            let depths =
                bent(&SmoothErrors { wave_at_1m_m: 0.002, seed, ..SmoothErrors::default() });
            let mean = |of: f32| of / (161.0 * 121.0);
            squares += mean(depths.iter().map(|depth| (depth - 2.0).powi(2)).sum::<f32>()) / 20.0;
            let beside = depths.chunks(161).flat_map(|row| row.windows(2));
            steps = beside.map(|two| (two[1] - two[0]).abs()).fold(steps, f32::max);
        }
        assert!((squares.sqrt() - 0.008).abs() < 0.0008, "{}", squares.sqrt());
        // White noise of this deviation has steps of 5 deviations.
        assert!(steps < 0.6 * 0.008, "{steps}");
        let [one, other] = [1, 2].map(|seed| SmoothErrors {
            wave_at_1m_m: 0.002,
            seed,
            ..SmoothErrors::default()
        });
        assert_ne!(bent(&one), bent(&other));
        let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
        assert_eq!(bent(&one), pool.install(|| bent(&one)));
    }

    #[test]
    fn steps_grow_with_the_square_of_the_depth() {
        let errors = SmoothErrors { step_at_1m_m: 0.003, ..SmoothErrors::default() };
        for (depth_m, step_m) in [(1.0_f32, 0.003), (2.0, 0.012)] {
            let span = (0..4000).map(|at| errors.stepped_m(depth_m + 0.0001 * at as f32 * depth_m));
            let mut levels: Vec<f32> = span.collect();
            levels.dedup();
            assert!((levels[1] - levels[0] - step_m).abs() < 0.1 * step_m, "{:?}", &levels[..2]);
        }
        assert_eq!(SmoothErrors::default().stepped_m(1.2345), 1.2345);
        assert!(errors.stepped_m(1e9).is_infinite());
    }

    #[test]
    fn nothing_and_no_errors_stay_as_they_are() {
        let all = SmoothErrors { bowl: 0.1, step_at_1m_m: 0.1, wave_at_1m_m: 0.1, seed: 0 };
        let mut inverse = vec![0.0; 161 * 121];
        all.bend(&mut inverse, &camera());
        assert!(inverse.iter().all(|inverse| *inverse == 0.0));
        assert!(bent(&SmoothErrors::default()).iter().all(|depth| *depth == 2.0));
        assert!(!SmoothErrors { bowl: f32::NAN, ..all }.is_sound());
        assert!(!SmoothErrors { wave_at_1m_m: -1.0, ..all }.is_sound() && all.is_sound());
    }
}
