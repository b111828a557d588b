//! A simplex that goes downhill.

use std::cell::RefCell;

use argmin::core::{CostFunction, Error, Executor};
use argmin::solver::neldermead::NelderMead;
use rigidformer_runtime::noise::Noise;

use super::error::CalibrateError;

/// A simplex whose corners cost alike within this goes nowhere.
const FLAT: f64 = 1e-3;
/// Spreads that the first simplex is wide: a small one lies in the dents of rough ground.
const FIRST: f64 = 2.0;
/// Spreads that a start other than the first is away from what the scenes have, a standard deviation.
const FAR: f64 = 1.5;

/// Where a search ended.
pub(super) struct End {
    pub(super) at: Vec<f64>,
    pub(super) evaluations: usize,
}

/// Corners of a start's simplex: the first start's begins where the scenes are.
pub(super) fn simplex(numbers: usize, seed: u64, start: u64) -> Vec<Vec<f64>> {
    let mut noise = Noise::new(seed, start);
    let mut sign = || if noise.uniform() < 0.5 { -FIRST } else { FIRST };
    let signs: Vec<f64> = (0..numbers).map(|_| sign()).collect();
    let mut away = || if start == 0 { 0.0 } else { FAR * f64::from(noise.normal()) };
    let first: Vec<f64> = (0..numbers).map(|_| away()).collect();
    around(&first, &signs)
}

/// A place, and from it a step along each number.
fn around(first: &[f64], steps: &[f64]) -> Vec<Vec<f64>> {
    let corner = |along: usize| {
        let mut corner = first.to_vec();
        if let (Some(own), Some(step)) = (corner.get_mut(along), steps.get(along)) {
            *own += step;
        }
        corner
    };
    // The last one's number is none, so it stays where it is.
    (0..=first.len()).rev().map(corner).collect()
}

/// The best place that Nelder and Mead find. Where a simplex has shrunk to nothing another one starts, as long as that helps: on rough
/// ground the first one soon lies in a dent.
pub(super) fn downhill(
    simplex: Vec<Vec<f64>>,
    most: usize,
    cost: impl FnMut(&[f64]) -> Result<f64, CalibrateError>,
) -> Result<End, CalibrateError> {
    let walk = RefCell::new(Walk { cost, most, evaluations: 0, best: None, failed: None });
    let (mut simplex, mut step, mut before) = (simplex, FIRST, f64::MAX);
    loop {
        // An error of the solver's own is the end of its way: what counts is the best place on it.
        if let Ok(solver) = NelderMead::new(simplex).with_sd_tolerance(FLAT) {
            let executor = Executor::new(Costs(&walk), solver).timer(false);
            let _ = executor.configure(|state| state.max_iters(most as u64)).run();
        }
        let Walk { evaluations, best, failed, .. } = &*walk.borrow();
        let Some((at, found)) = best.as_ref().filter(|_| failed.is_none()) else { break };
        if *evaluations >= most || before - found < FLAT {
            break;
        }
        before = *found;
        // To the other side, and nearer.
        step *= -0.5;
        simplex = around(at, &vec![step; at.len()]);
    }
    let Walk { evaluations, best, failed, .. } = walk.into_inner();
    match (failed, best) {
        (Some(error), _) => Err(error),
        (None, Some((at, _))) => Ok(End { at, evaluations }),
        (None, None) => Err(CalibrateError::NoScenes),
    }
}

struct Walk<C> {
    cost: C,
    most: usize,
    evaluations: usize,
    best: Option<(Vec<f64>, f64)>,
    failed: Option<CalibrateError>,
}

struct Costs<'w, C>(&'w RefCell<Walk<C>>);

impl<C: FnMut(&[f64]) -> Result<f64, CalibrateError>> CostFunction for Costs<'_, C> {
    type Param = Vec<f64>;
    type Output = f64;

    fn cost(&self, at: &Vec<f64>) -> Result<f64, Error> {
        let walk = &mut *self.0.borrow_mut();
        // The solver takes no error in its first steps, so that it is told of a steep place and the error is kept.
        if walk.failed.is_some() || walk.evaluations >= walk.most {
            return Ok(f64::MAX);
        }
        walk.evaluations += 1;
        match (walk.cost)(at) {
            Ok(cost) => {
                if walk.best.as_ref().is_none_or(|(_, best)| cost < *best) {
                    walk.best = Some((at.clone(), cost));
                }
                Ok(cost)
            }
            Err(error) => {
                walk.failed = Some(error);
                Ok(f64::MAX)
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_simplex_finds_the_bottom_of_a_bowl() {
        let bottom = [1.5, -0.5, 3.0];
        let cost = |at: &[f64]| {
            Ok(at.iter().zip(bottom).map(|(own, least)| 4.0 * (own - least) * (own - least)).sum())
        };
        for start in 0..3 {
            let end = downhill(simplex(3, 7, start), 400, cost).unwrap();
            let off = end.at.iter().zip(bottom).map(|(own, least)| (own - least).abs());
            assert!(off.fold(0.0, f64::max) < 0.05, "{:?} in {}", end.at, end.evaluations);
            assert!(end.evaluations < 200, "{}", end.evaluations);
        }
        let few = downhill(simplex(3, 7, 0), 10, cost).unwrap();
        assert_eq!(few.evaluations, 10);
    }

    #[test]
    fn an_error_ends_the_search() {
        for at in [1, 3, 9] {
            let mut count = 0;
            let cost = |_: &[f64]| {
                count += 1;
                if count < at { Ok(f64::from(count)) } else { Err(CalibrateError::Cancelled) }
            };
            assert!(matches!(downhill(simplex(3, 1, 0), 99, cost), Err(CalibrateError::Cancelled)));
            assert_eq!(count, at);
        }
    }
}
