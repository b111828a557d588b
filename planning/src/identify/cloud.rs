//! Population Monte Carlo: weighted samples of parameters, and proposals from them.

use nalgebra::{Cholesky, DMatrix, DVector, Dyn};
use rigidformer_runtime::noise::Noise;

/// Share of samples from the prior.
// They bound the importance weights, and find modes that the proposal misses.
const PRIOR_SHARE: f64 = 0.1;
/// Deviation of the kernel around each sample, in deviations of the cloud.
const KERNEL_WIDTH: f64 = 0.5;
/// The same for the first round with another window.
// The new likelihood may move the posterior.
const WIDE_KERNEL: f64 = 1.5;
/// Least effective share of the samples after weighing.
// Fewer samples give a useless covariance for the next proposal, so the likelihood is tempered.
const MIN_EFFECTIVE_SHARE: f64 = 0.2;
/// Least variance.
// It keeps the covariance of a collapsed cloud invertible.
const MIN_VARIANCE: f64 = 1e-8;

/// Samples of parameters. Each number x has the logistic distribution as prior, so that 1 / (1 + exp(-x)) is uniform from 0 to 1.
#[derive(Clone, Debug)]
pub(crate) struct Cloud {
    pub(crate) dims: usize,
    /// (samples, dims)
    pub(crate) samples: Vec<Vec<f64>>,
    /// (samples) They sum to 1.
    pub(crate) weights: Vec<f64>,
}

/// Samples without weights.
pub(crate) struct Proposal {
    /// (samples, dims)
    pub(crate) samples: Vec<Vec<f64>>,
    /// (samples) Logarithm of prior over proposal.
    log_ratios: Vec<f64>,
}

/// The logistic function, from 0 to 1.
pub(crate) fn logistic(x: f64) -> f64 {
    1.0 / (1.0 + (-x).exp())
}

/// Logarithm of the logistic density.
fn log_prior(x: f64) -> f64 {
    let x = x.abs();
    -x - 2.0 * (-x).exp().ln_1p()
}

fn log_priors(sample: &[f64]) -> f64 {
    sample.iter().map(|x| log_prior(*x)).sum()
}

/// A sample of the logistic distribution.
fn draw(noise: &mut Noise) -> f64 {
    // 0 and 1 have infinite logits.
    let fraction = f64::from(noise.uniform()).clamp(1e-6, 1.0 - 1e-6);
    (fraction / (1.0 - fraction)).ln()
}

impl Cloud {
    /// Stratified samples of the prior: one in each of `count` equally likely parts of each parameter.
    pub(crate) fn prior(dims: usize, count: usize, seed: u64, stream: u64) -> Self {
        let mut noise = Noise::new(seed, stream);
        let mut samples = vec![vec![0.0; dims]; count];
        for dim in 0..dims {
            let mut order: Vec<usize> = (0..count).collect();
            for at in (1..count).rev() {
                order.swap(at, (noise.uniform() * (at + 1) as f32) as usize % (at + 1));
            }
            for (sample, cell) in samples.iter_mut().zip(order) {
                let fraction = (cell as f64 + f64::from(noise.uniform())) / count as f64;
                let fraction = fraction.clamp(1e-6, 1.0 - 1e-6);
                sample[dim] = (fraction / (1.0 - fraction)).ln();
            }
        }
        Cloud { dims, samples, weights: vec![1.0 / count.max(1) as f64; count] }
    }

    /// Mean of each parameter.
    pub(crate) fn mean(&self) -> Vec<f64> {
        let mut mean = vec![0.0; self.dims];
        for (sample, weight) in self.samples.iter().zip(&self.weights) {
            mean.iter_mut().zip(sample).for_each(|(mean, x)| *mean += weight * x);
        }
        mean
    }

    /// Its samples as a proposal; correct for samples of the prior.
    pub(crate) fn as_proposal(&self) -> Proposal {
        Proposal { samples: self.samples.clone(), log_ratios: vec![0.0; self.samples.len()] }
    }

    /// So many samples of equal weight.
    pub(crate) fn resampled(&self, count: usize, noise: &mut Noise) -> Vec<Vec<f64>> {
        let offset = f64::from(noise.uniform());
        let mut chosen: Vec<Vec<f64>> = self
            .picks(count, offset)
            .into_iter()
            .filter_map(|index| self.samples.get(index).cloned())
            .collect();
        for at in (1..chosen.len()).rev() {
            chosen.swap(at, (noise.uniform() * (at + 1) as f32) as usize % (at + 1));
        }
        chosen
    }

    /// Systematic resampling: indices by weight.
    fn picks(&self, count: usize, offset: f64) -> Vec<usize> {
        let (mut picks, mut sum, mut index) = (Vec::with_capacity(count), 0.0, 0);
        for number in 0..count {
            let until = (number as f64 + offset) / count as f64;
            while index + 1 < self.weights.len() && sum + self.weights[index] < until {
                sum += self.weights[index];
                index += 1;
            }
            picks.push(index);
        }
        picks
    }

    /// Mean of the logarithms of the deviations.
    pub(crate) fn spread(&self) -> f64 {
        let variances = self.covariance(&self.mean());
        let logs = (0..self.dims).map(|dim| 0.5 * variances[(dim, dim)].ln());
        logs.sum::<f64>() / self.dims.max(1) as f64
    }

    fn covariance(&self, mean: &[f64]) -> DMatrix<f64> {
        let mut all = DMatrix::zeros(self.dims, self.dims);
        for (sample, weight) in self.samples.iter().zip(&self.weights) {
            let away =
                DVector::from_iterator(self.dims, sample.iter().zip(mean).map(|(x, m)| x - m));
            all.ger(*weight, &away, &away, 1.0);
        }
        for dim in 0..self.dims {
            all[(dim, dim)] += MIN_VARIANCE;
        }
        all
    }

    /// Samples of a kernel density about this cloud, and of the prior.
    pub(crate) fn propose(&self, count: usize, fresh: bool, noise: &mut Noise) -> Proposal {
        let width = if fresh { WIDE_KERNEL } else { KERNEL_WIDTH };
        let mean = self.mean();
        let Some(shape) = Cholesky::new(self.covariance(&mean)) else {
            // Weights that are not finite carry no information, so all samples are of the prior.
            let samples: Vec<Vec<f64>> =
                (0..count).map(|_| (0..self.dims).map(|_| draw(noise)).collect()).collect();
            return Proposal { log_ratios: vec![0.0; samples.len()], samples };
        };
        // Shrinking the centres towards the mean keeps the cloud's covariance under the kernel (Liu and West).
        let shrinkage = (1.0 - (width * width).min(1.0)).sqrt();
        let centres: Vec<Vec<f64>> = self
            .samples
            .iter()
            .map(|sample| sample.iter().zip(&mean).map(|(x, m)| m + shrinkage * (x - m)).collect())
            .collect();
        let from_prior = ((count as f64 * PRIOR_SHARE).round() as usize).min(count);
        // Systematic resampling has less variance than independent draws.
        let picks = self.picks(count - from_prior, f64::from(noise.uniform()));
        let mut samples: Vec<Vec<f64>> = Vec::with_capacity(count);
        for pick in picks {
            let normal = DVector::from_fn(self.dims, |_, _| f64::from(noise.normal()));
            let step = shape.l() * normal * width;
            let Some(centre) = centres.get(pick) else { continue };
            samples.push(centre.iter().zip(step.iter()).map(|(c, s)| c + s).collect());
        }
        while samples.len() < count {
            samples.push((0..self.dims).map(|_| draw(noise)).collect());
        }
        let log_ratios =
            samples.iter().map(|x| -self.log_proposal(x, &centres, &shape, width)).collect();
        Proposal { samples, log_ratios }
    }

    /// Logarithm of the proposal's density over the prior's.
    fn log_proposal(
        &self,
        sample: &[f64],
        centres: &[Vec<f64>],
        shape: &Cholesky<f64, Dyn>,
        width: f64,
    ) -> f64 {
        let log_det: f64 = (0..self.dims).map(|dim| shape.l_dirty()[(dim, dim)].ln()).sum();
        let constant = -0.5 * self.dims as f64 * std::f64::consts::TAU.ln()
            - log_det
            - self.dims as f64 * width.ln();
        let logs = centres.iter().zip(&self.weights).map(|(centre, weight)| {
            let mut away =
                DVector::from_iterator(self.dims, sample.iter().zip(centre).map(|(x, c)| x - c));
            shape.l_dirty().solve_lower_triangular_mut(&mut away);
            weight.ln() + constant - 0.5 * away.norm_squared() / (width * width)
        });
        let around = log_sum(logs) - log_priors(sample);
        log_sum([(1.0 - PRIOR_SHARE).ln() + around, PRIOR_SHARE.ln()].into_iter())
    }
}

impl Proposal {
    /// Weights the samples by their likelihoods to the largest power up to 1 that leaves enough effective samples. Returns the power too.
    pub(crate) fn weigh(self, dims: usize, log_likelihoods: &[f64]) -> (Cloud, f64) {
        let Proposal { samples, log_ratios } = self;
        // The power applies to the whole importance weight. A tempered likelihood alone would favour the samples of the prior where the
        // proposal is much narrower.
        let weights = |power: f64| {
            let logs: Vec<f64> = log_likelihoods
                .iter()
                .zip(&log_ratios)
                .map(|(log, ratio)| power * (log + ratio))
                .collect();
            let all = log_sum(logs.iter().copied());
            logs.into_iter().map(|log| (log - all).exp()).collect::<Vec<f64>>()
        };
        let effective = |weights: &[f64]| 1.0 / weights.iter().map(|w| w * w).sum::<f64>();
        let enough = MIN_EFFECTIVE_SHARE * samples.len() as f64;
        let (mut low, mut high) = (0.0, 1.0);
        if effective(&weights(1.0)) >= enough {
            low = 1.0;
        } else {
            // Fifty halvings reach the resolution of f64.
            for _ in 0..50 {
                let middle = 0.5 * (low + high);
                if effective(&weights(middle)) >= enough { low = middle } else { high = middle }
            }
        }
        (Cloud { dims, weights: weights(low), samples }, low)
    }
}

/// Effective number of samples.
pub(crate) fn effective(cloud: &Cloud) -> f64 {
    1.0 / cloud.weights.iter().map(|weight| weight * weight).sum::<f64>()
}

/// Logarithm of the sum of exponentials.
fn log_sum(logs: impl Iterator<Item = f64> + Clone) -> f64 {
    let most = logs.clone().fold(f64::NEG_INFINITY, f64::max);
    // All logarithms are negative infinity, or one is not a number: the difference below would be NaN.
    if !most.is_finite() {
        return most;
    }
    most + logs.map(|log| (log - most).exp()).sum::<f64>().ln()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Rounds of proposals come to the posterior of a bent valley.
    #[test]
    fn rounds_come_to_the_posterior() {
        let log = |x: &[f64]| {
            let (a, b) = ((x[0] - 1.0) / 0.02, (x[1] + x[0]) / 0.5);
            -0.5 * (a * a + b * b)
        };
        let mut cloud = Cloud::prior(2, 64, 1, 0);
        let (mut powers, mut pooled) = (Vec::new(), Vec::new());
        for round in 1..12 {
            let proposal = cloud.propose(64, false, &mut Noise::new(1, round));
            let logs: Vec<f64> = proposal.samples.iter().map(|x| log(x)).collect();
            let (next, power) = proposal.weigh(2, &logs);
            cloud = next;
            powers.push(power);
            if round > 6 {
                pooled.push(cloud.mean());
            }
        }
        assert!(powers.iter().rev().take(4).all(|power| *power == 1.0), "{powers:?}");
        let mean = |dim: usize| pooled.iter().map(|mean| mean[dim]).sum::<f64>() / 5.0;
        assert!((mean(0) - 1.0).abs() < 0.01, "{pooled:?}");
        // The prior pulls a little towards 0.
        assert!((mean(1) + 0.9).abs() < 0.2, "{pooled:?}");
    }

    #[test]
    fn likelihoods_that_are_no_numbers_leave_a_cloud() {
        let cloud = Cloud::prior(1, 16, 1, 0);
        let (bad, _) =
            cloud.propose(16, false, &mut Noise::new(1, 1)).weigh(1, &[f64::NEG_INFINITY; 16]);
        let proposal = bad.propose(16, false, &mut Noise::new(1, 2));
        assert!(proposal.samples.iter().flatten().all(|x| x.is_finite()));
    }
}
