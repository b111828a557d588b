//! The sampling distribution: samples around a mean, and the next mean from their costs. Sums are in f64 and in the futures' order, so that
//! they have the same bits everywhere.

use rigidformer_core::math;
use rigidformer_runtime::noise::Noise;

use super::settings::{Method, Parameter, elites};

/// A normal distribution, each parameter on its own.
#[derive(Clone, Debug, Default)]
pub(super) struct Search {
    pub(super) mean: Vec<f32>,
    pub(super) deviations: Vec<f32>,
    /// Usable futures; the best first for the cross-entropy method.
    order: Vec<usize>,
    weights: Vec<f64>,
}

impl Search {
    pub(super) fn begin(&mut self, mean: &[f32], parameters: &[Parameter]) {
        self.mean.clear();
        self.mean.extend_from_slice(mean);
        self.deviations.clear();
        self.deviations.extend(parameters.iter().map(|parameter| parameter.deviation));
    }

    /// (futures, parameters) The mean, then samples around it. `stream` is the first future's stream of noise.
    pub(super) fn sample(
        &self,
        seed: u64,
        stream: u64,
        futures: usize,
        parameters: &[Parameter],
        out: &mut Vec<f32>,
    ) {
        out.clear();
        // The mean itself is the first sample, so that a plan is never worse than its mean.
        out.extend_from_slice(&self.mean);
        for future in 1..futures as u64 {
            let mut noise = Noise::new(seed, stream.wrapping_add(future));
            let spread = self.mean.iter().zip(&self.deviations);
            out.extend(spread.zip(parameters).map(|((mean, deviation), parameter)| {
                within(mean + deviation * noise.normal(), parameter)
            }));
        }
    }

    /// Updates mean and deviations by (futures) costs, which may be fewer than the samples. Without a finite cost they are unchanged.
    pub(super) fn update(
        &mut self,
        method: Method,
        samples: &[f32],
        costs: &[f32],
        parameters: &[Parameter],
    ) {
        self.order.clear();
        self.order.extend((0..costs.len()).filter(|future| costs[*future].is_finite()));
        let Some(least) = self.order.iter().map(|future| costs[*future]).reduce(f32::min) else {
            return;
        };
        self.weights.clear();
        match method {
            Method::Mppi { temperature, narrowing } => {
                // Relative to the least cost, so that the best sample has weight 1 and nothing overflows.
                let weight =
                    |future: &usize| f64::from(math::exp((least - costs[*future]) / temperature));
                self.weights.extend(self.order.iter().map(weight));
                for (index, parameter) in parameters.iter().enumerate() {
                    let (mean, _) = self.moments(samples, index, parameters.len());
                    self.mean[index] = within(mean as f32, parameter);
                    // MPPI has no estimate of the spread, so a schedule narrows it.
                    self.deviations[index] *= narrowing;
                }
            }
            Method::Cem { elite, smoothing } => {
                self.order.sort_by(|a, b| costs[*a].total_cmp(&costs[*b]).then(a.cmp(b)));
                // At least two, for a deviation, even where a cut left few costs.
                self.order.truncate(elites(elite, costs.len()).max(2));
                self.weights.resize(self.order.len(), 1.0);
                let blend = |old: f32, new: f64| {
                    let old_weight = f64::from(smoothing);
                    (old_weight * f64::from(old) + (1.0 - old_weight) * new) as f32
                };
                for (index, parameter) in parameters.iter().enumerate() {
                    let (mean, deviation) = self.moments(samples, index, parameters.len());
                    self.mean[index] = within(blend(self.mean[index], mean), parameter);
                    // A single sample has no deviation.
                    if self.order.len() > 1 {
                        self.deviations[index] = blend(self.deviations[index], deviation);
                    }
                }
            }
        }
    }

    /// Weighted mean and deviation of a parameter over the futures in `order`.
    fn moments(&self, samples: &[f32], index: usize, width: usize) -> (f64, f64) {
        let value = |future: &usize| f64::from(samples[future * width + index]);
        let pairs = || self.order.iter().map(value).zip(&self.weights);
        let total: f64 = self.weights.iter().sum();
        let mean = pairs().map(|(value, weight)| value * weight).sum::<f64>() / total;
        let squares = pairs().map(|(value, weight)| (value - mean) * (value - mean) * weight);
        (mean, (squares.sum::<f64>() / total).sqrt())
    }
}

fn within(value: f32, parameter: &Parameter) -> f32 {
    value.clamp(parameter.low, parameter.high)
}
