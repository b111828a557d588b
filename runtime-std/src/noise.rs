//! Random numbers that depend on a seed and a stream alone, not on threads, order or platform.

use rigidformer_core::kernels::in_own_environment;
use rigidformer_core::math;

/// SplitMix64's output function: inputs that differ in one bit give unrelated outputs.
pub fn mix(mut z: u64) -> u64 {
    z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^ (z >> 31)
}

/// Random numbers of one seed and stream, such as a future's index.
///
/// ```
/// use rigidformer_runtime::noise::Noise;
/// let numbers = |stream| { let mut noise = Noise::new(7, stream); [noise.uniform(), noise.normal()] };
/// assert_eq!(numbers(3), numbers(3));
/// assert_ne!(numbers(3), numbers(4));
/// ```
#[derive(Clone, Debug)]
pub struct Noise {
    state: u64,
}

impl Noise {
    /// The numbers of a seed and a stream.
    pub fn new(seed: u64, stream: u64) -> Self {
        Noise { state: mix(mix(seed.wrapping_add(0x9e37_79b9_7f4a_7c15)) ^ stream) }
    }

    /// From 0 to 1, 1 excluded.
    pub fn uniform(&mut self) -> f32 {
        self.state = self.state.wrapping_add(0x9e37_79b9_7f4a_7c15);
        // 24 bits are as many as an f32 holds, so that the conversion is exact.
        (mix(self.state) >> 40) as f32 / (1_u64 << 24) as f32
    }

    /// Normally distributed with mean 0 and deviation 1 (Box and Muller); at most 5.8.
    pub fn normal(&mut self) -> f32 {
        in_own_environment(|| {
            // 1 - uniform is never 0, whose logarithm is infinite.
            let radius = math::sqrt(-2.0 * math::ln(1.0 - self.uniform()));
            let (sin, _) = math::sin_cos(std::f32::consts::TAU * self.uniform());
            radius * sin
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn normal_numbers_have_their_moments() {
        let numbers: Vec<f32> = (0..20_000).map(|stream| Noise::new(1, stream).normal()).collect();
        let mean = numbers.iter().sum::<f32>() / 20_000.0;
        let variance = numbers.iter().map(|x| (x - mean) * (x - mean)).sum::<f32>() / 20_000.0;
        assert!(mean.abs() < 0.03 && (variance - 1.0).abs() < 0.05, "{mean} {variance}");
    }
}
