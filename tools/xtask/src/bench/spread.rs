//! Medians, and how far numbers lie apart.

use serde_json::{Value, json};

/// Of some numbers, at least one.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Spread {
    pub(crate) least: f64,
    pub(crate) tenth: f64,
    pub(crate) median: f64,
    pub(crate) ninetieth: f64,
    pub(crate) most: f64,
}

impl Spread {
    /// None of none.
    pub(crate) fn of(numbers: &[f64]) -> Option<Self> {
        let at = |share| quantile(numbers, share);
        Some(Spread {
            least: at(0.0)?,
            tenth: at(0.1)?,
            median: at(0.5)?,
            ninetieth: at(0.9)?,
            most: at(1.0)?,
        })
    }

    pub(crate) fn json(&self) -> Value {
        json!({"median": self.median, "p10": self.tenth, "p90": self.ninetieth, "min": self.least, "max": self.most})
    }
}

/// The number below which such a share of them is; between two of them where the share ends there.
pub(crate) fn quantile(numbers: &[f64], share: f64) -> Option<f64> {
    let mut sorted = numbers.to_vec();
    sorted.sort_by(f64::total_cmp);
    let place = (sorted.len().checked_sub(1)? as f64) * share.clamp(0.0, 1.0);
    let (below, above) = (sorted.get(place.floor() as usize)?, sorted.get(place.ceil() as usize)?);
    Some(below + (above - below) * place.fract())
}

/// Ratios of one to the other in each round that both took part in.
pub(crate) fn ratios(one: &[(usize, f64)], other: &[(usize, f64)]) -> Vec<f64> {
    let in_round = |round| other.iter().find(|(at, _)| *at == round).map(|(_, time)| *time);
    one.iter().filter_map(|(round, time)| Some(time / in_round(*round)?)).collect()
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;

    #[test]
    fn quantiles_lie_between_numbers() {
        assert_eq!(quantile(&[], 0.5), None);
        assert_eq!(quantile(&[3.0], 0.9), Some(3.0));
        assert_eq!(quantile(&[4.0, 1.0], 0.5), Some(2.5));
        assert_eq!(quantile(&[5.0, 1.0, 3.0], 0.5), Some(3.0));
        let eleven: Vec<f64> = (0..11).map(f64::from).collect();
        let spread = Spread::of(&eleven).unwrap();
        assert_eq!((spread.least, spread.tenth, spread.median), (0.0, 1.0, 5.0));
        assert_eq!((spread.ninetieth, spread.most), (9.0, 10.0));
        assert_eq!(Spread::of(&[]), None);
    }

    #[test]
    fn a_machine_that_halves_its_speed_does_not_change_a_ratio() {
        let ours: Vec<_> = [1.0, 2.0, 1.0, 2.1].into_iter().enumerate().collect();
        let theirs: Vec<_> = [3.0, 6.0, 3.0].into_iter().enumerate().collect();
        assert_eq!(ratios(&theirs, &ours), [3.0, 3.0, 3.0]);
        assert_eq!(ratios(&theirs[2..], &ours), [3.0]);
        assert!(ratios(&ours, &[]).is_empty());
    }
}
