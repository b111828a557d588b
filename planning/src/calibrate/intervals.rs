//! A quadratic around an end of a search, and where it is least for resampled scenes.

use nalgebra::{DMatrix, DVector};
use rigidformer_runtime::noise::Noise;

/// Between which bounds 90 % of the resampled fits are.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Bounds {
    /// The lower bound.
    pub low: f32,
    /// The upper one.
    pub high: f32,
    /// Whether it goes on below, and above: fits ended where the quadratic does.
    pub open: [bool; 2],
}

pub(super) fn mean(costs: &[f64]) -> f64 {
    costs.iter().sum::<f64>() / costs.len().max(1) as f64
}

/// Scenes that can be resampled, at least.
pub(super) const LEAST_SCENES: usize = 5;
/// How far the quadratic goes to either side, in spreads.
const REACH: f64 = 3.0;
/// Places for each of its coefficients.
const PLACES: usize = 3;
/// Keeps coefficients that no place tells at 0.
const RIDGE: f64 = 1e-6;
/// Sweeps over all numbers in search of where the quadratic is least.
const SWEEPS: usize = 100;
/// Streams of random numbers: searches have the lower ones.
const DESIGN: u64 = 1 << 32;
const RESAMPLES: u64 = 1 << 33;

/// Coefficients of a quadratic in so many numbers.
fn coefficients(numbers: usize) -> usize {
    1 + numbers + numbers * (numbers + 1) / 2
}

/// Places that a quadratic is fitted to.
pub(super) fn designs(numbers: usize) -> usize {
    PLACES * coefficients(numbers)
}

/// Places around one, itself the first.
pub(super) fn design(around: &[f64], seed: u64) -> Vec<Vec<f64>> {
    let mut noise = Noise::new(seed, DESIGN);
    let mut own = |at: f64| at + REACH * (2.0 * f64::from(noise.uniform()) - 1.0);
    let others = (1..designs(around.len())).map(|_| around.iter().map(|at| own(*at)).collect());
    std::iter::once(around.to_vec()).chain(others.collect::<Vec<_>>()).collect()
}

/// A quadratic that is fitted to costs at places.
pub(super) struct Fit {
    around: Vec<f64>,
    /// (coefficients, places) From costs to coefficients.
    solve: DMatrix<f64>,
}

impl Fit {
    /// None where places tell nothing.
    pub(super) fn new(around: &[f64], places: &[Vec<f64>]) -> Option<Self> {
        let row = |place: &Vec<f64>| {
            let from: Vec<f64> = place.iter().zip(around).map(|(at, around)| at - around).collect();
            let mut terms = vec![1.0];
            terms.extend(&from);
            for (index, one) in from.iter().enumerate() {
                terms.extend(from.iter().skip(index).map(|other| one * other));
            }
            terms
        };
        let rows: Vec<f64> = places.iter().flat_map(row).collect();
        let matrix = DMatrix::from_row_slice(places.len(), coefficients(around.len()), &rows);
        let square = matrix.transpose() * &matrix
            + DMatrix::identity(matrix.ncols(), matrix.ncols()) * RIDGE;
        let solve = square.cholesky()?.inverse() * matrix.transpose();
        Some(Fit { around: around.to_vec(), solve })
    }

    /// Where it is least for the costs of scenes at each place, (places, scenes); `drawn` are the scenes that count, each as often as it
    /// is named.
    pub(super) fn least(&self, costs: &[Vec<f64>], drawn: Option<&[usize]>) -> Vec<f64> {
        let mean = |of: &Vec<f64>| match drawn {
            Some(drawn) => {
                drawn.iter().filter_map(|scene| of.get(*scene)).sum::<f64>() / drawn.len() as f64
            }
            None => mean(of),
        };
        let values = DVector::from_iterator(costs.len(), costs.iter().map(mean));
        let found = &self.solve * values;
        let count = self.around.len();
        let slope = |index: usize| found[1 + index];
        let curve = |one: usize, other: usize| {
            let (one, other) = (one.min(other), one.max(other));
            let before: usize = (0..one).map(|row| count - row).sum();
            found[1 + count + before + (other - one)]
        };
        let mut at = vec![0.0_f64; count];
        for _ in 0..SWEEPS {
            for index in 0..count {
                let others = (0..count).filter(|other| *other != index);
                let slope = slope(index) + others.map(|o| curve(index, o) * at[o]).sum::<f64>();
                let own = curve(index, index);
                at[index] = match own > 0.0 {
                    true => (-slope / (2.0 * own)).clamp(-REACH, REACH),
                    // Of a hill the lower end.
                    false => {
                        if slope > 0.0 {
                            -REACH
                        } else {
                            REACH
                        }
                    }
                };
            }
        }
        at.iter().zip(&self.around).map(|(from, around)| from + around).collect()
    }

    /// Where it is least for each of so many sets of scenes that are drawn with repetition.
    pub(super) fn resampled(
        &self,
        costs: &[Vec<f64>],
        resamples: usize,
        seed: u64,
    ) -> Vec<Vec<f64>> {
        let scenes = costs.first().map_or(0, Vec::len);
        let end = |resample: usize| {
            let mut noise = Noise::new(seed, RESAMPLES + resample as u64);
            let mut draw = || {
                // From 0 to 1, 1 excluded.
                let at = f64::from(noise.uniform()) * scenes as f64;
                (at as usize).min(scenes.saturating_sub(1))
            };
            let drawn: Vec<usize> = (0..scenes).map(|_| draw()).collect();
            self.least(costs, Some(&drawn))
        };
        (0..resamples).map(end).collect()
    }

    /// Where the quadratic ends along a number.
    pub(super) fn reach(&self, index: usize) -> [f64; 2] {
        let around = self.around.get(index).copied().unwrap_or_default();
        [around - REACH, around + REACH]
    }

    /// Whether an interval reaches either end of the quadratic.
    pub(super) fn open(&self, index: usize, low: f64, high: f64) -> [bool; 2] {
        let [first, last] = self.reach(index);
        let near = 0.02 * REACH;
        [low <= first + near, high >= last - near]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_quadratic_is_least_where_it_is() {
        let around = [1.0, -2.0, 0.5];
        // Scenes whose bottoms are spread about one place.
        let bottoms: Vec<[f64; 3]> = (0..60)
            .map(|scene| {
                let mut noise = Noise::new(9, scene);
                let mut off = || 0.8 * f64::from(noise.normal());
                [1.3 + off(), -2.4 + off(), 0.6 + off()]
            })
            .collect();
        let cost = |at: &[f64], bottom: &[f64; 3]| {
            let d: Vec<f64> = at.iter().zip(bottom).map(|(at, bottom)| at - bottom).collect();
            3.0 + d[0] * d[0] + 2.0 * d[1] * d[1] + 0.5 * d[2] * d[2] + 0.6 * d[0] * d[1]
        };
        let places = design(&around, 3);
        let costs: Vec<Vec<f64>> = places
            .iter()
            .map(|place| bottoms.iter().map(|bottom| cost(place, bottom)).collect())
            .collect();
        let fit = Fit::new(&around, &places).unwrap();
        let least = fit.least(&costs, None);
        for index in 0..3 {
            let mean = bottoms.iter().map(|bottom| bottom[index]).sum::<f64>() / 60.0;
            assert!((least[index] - mean).abs() < 1e-3, "{least:?} {mean}");
            let mut ends: Vec<f64> =
                fit.resampled(&costs, 400, 5).iter().map(|end| end[index]).collect();
            ends.sort_by(f64::total_cmp);
            // The mean of 60 with a deviation of .8 has .10; 90 % are within 1.64 of those.
            let width = ends[380] - ends[20];
            assert!((0.2..0.5).contains(&width), "{width}");
        }
    }
}
