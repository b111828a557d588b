//! The interval of an identified parameter.

use std::fmt;

/// A credible interval of a parameter, with a probability of 90 %.
///
/// A parameter is seen if the middle 90 % of its posterior are less than half as wide as those of its prior. Otherwise it may have one bound. It
/// has a lower one where the largest tenth of the prior keeps half of its probability, and the bound lies above the first quarter. An upper
/// bound is found likewise. A parameter with neither is not seen.
///
/// ```
/// use rigidformer_planning::identify::Interval;
/// let friction = Interval::Between { low: 0.15, middle: 0.17, high: 0.19 };
/// assert!(friction.holds(0.16) && !friction.holds(0.2));
/// assert_eq!(friction.to_string(), "0.170 (0.150 to 0.190)");
/// assert!(Interval::AtLeast { low: 0.4 }.holds(0.9));
/// assert_eq!(Interval::NotSeen.middle(), None);
/// ```
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum Interval {
    /// The motion hardly depends on it.
    #[default]
    NotSeen,
    /// With 90 % from `low` to `high`; as likely above as below `middle`.
    Between {
        /// 5 % are below.
        low: f64,
        /// The median.
        middle: f64,
        /// 5 % are above.
        high: f64,
    },
    /// With 90 % at least this: sticking gives no more.
    AtLeast {
        /// 10 % are below.
        low: f64,
    },
    /// With 90 % at most this.
    AtMost {
        /// 10 % are above.
        high: f64,
    },
}

impl Interval {
    /// Whether it contains a value; an unseen parameter's contains none.
    pub fn holds(&self, value: f64) -> bool {
        match *self {
            Interval::NotSeen => false,
            Interval::Between { low, high, .. } => (low..=high).contains(&value),
            Interval::AtLeast { low } => value >= low,
            Interval::AtMost { high } => value <= high,
        }
    }

    /// The median, where there are two bounds.
    pub fn middle(&self) -> Option<f64> {
        match *self {
            Interval::Between { middle, .. } => Some(middle),
            _ => None,
        }
    }

    /// All bounds times `factor`, which is above 0.
    pub fn times(&self, factor: f64) -> Self {
        self.map(|bound| bound * factor)
    }

    /// The interval of an increasing function of the parameter.
    pub(crate) fn map(&self, rising: impl Fn(f64) -> f64) -> Self {
        match *self {
            Interval::NotSeen => Interval::NotSeen,
            Interval::Between { low, middle, high } => {
                Interval::Between { low: rising(low), middle: rising(middle), high: rising(high) }
            }
            Interval::AtLeast { low } => Interval::AtLeast { low: rising(low) },
            Interval::AtMost { high } => Interval::AtMost { high: rising(high) },
        }
    }

    /// From samples of the posterior and of the prior, (value, weight) each.
    pub(crate) fn of(posterior: &mut [(f64, f64)], prior: &mut [(f64, f64)]) -> Self {
        posterior.sort_by(|a, b| a.0.total_cmp(&b.0));
        prior.sort_by(|a, b| a.0.total_cmp(&b.0));
        let (Some([low, middle, high]), Some([least, most])) =
            (quantiles(posterior, [0.05, 0.5, 0.95]), quantiles(prior, [0.05, 0.95]))
        else {
            return Interval::NotSeen;
        };
        let Some([tenth, quarter, upper_quarter, last]) = quantiles(prior, [0.1, 0.25, 0.75, 0.9])
        else {
            return Interval::NotSeen;
        };
        let mass = |inside: &dyn Fn(f64) -> bool| {
            let all: f64 = posterior.iter().map(|(_, weight)| weight).sum();
            let fraction: f64 = posterior.iter().filter(|(v, _)| inside(*v)).map(|(_, w)| w).sum();
            fraction / all
        };
        // A flat likelihood up to the prior's end has no upper bound, as for friction under sticking.
        let is_open_above = mass(&|value| value > last) > 0.5 * 0.1;
        if is_open_above && let Some([low]) = quantiles(posterior, [0.1]) {
            return if low > quarter { Interval::AtLeast { low } } else { Interval::NotSeen };
        }
        if high - low < 0.5 * (most - least) {
            return Interval::Between { low, middle, high };
        }
        if mass(&|value| value < tenth) > 0.5 * 0.1
            && let Some([high]) = quantiles(posterior, [0.9])
        {
            return if high < upper_quarter {
                Interval::AtMost { high }
            } else {
                Interval::NotSeen
            };
        }
        Interval::NotSeen
    }
}

/// Quantiles of sorted (value, weight); none without weight.
fn quantiles<const N: usize>(sorted: &[(f64, f64)], fractions: [f64; N]) -> Option<[f64; N]> {
    let all: f64 = sorted.iter().map(|(_, weight)| weight).sum();
    // Weights that vanish or overflow define no distribution.
    if !(all.is_finite() && all > 0.0) {
        return None;
    }
    let find = |fraction: f64| {
        // Each sample stands at the middle of its weight, so that quantiles interpolate.
        let (mut below, mut last) = (0.0, None);
        for &(value, weight) in sorted.iter().filter(|(_, weight)| *weight > 0.0) {
            let at = (below + 0.5 * weight) / all;
            if at >= fraction {
                let Some((before, earlier)) = last else { return Some(value) };
                let share = (fraction - earlier) / (at - earlier);
                return Some(before + (value - before) * share);
            }
            below += weight;
            last = Some((value, at));
        }
        last.map(|(value, _)| value)
    };
    let mut found = [0.0; N];
    for (slot, fraction) in found.iter_mut().zip(fractions) {
        *slot = find(fraction)?;
    }
    Some(found)
}

impl fmt::Display for Interval {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let text = match self {
            Interval::NotSeen => "not seen".to_owned(),
            Interval::Between { low, middle, high } => {
                format!("{middle:.3} ({low:.3} to {high:.3})")
            }
            Interval::AtLeast { low } => format!("at least {low:.3}"),
            Interval::AtMost { high } => format!("at most {high:.3}"),
        };
        f.pad(&text)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn even(from: f64, to: f64) -> Vec<(f64, f64)> {
        (0..1000).map(|i| (from + (to - from) * (f64::from(i) + 0.5) / 1000.0, 1.0)).collect()
    }

    #[test]
    fn what_motion_says_is_told_from_what_was_believed() {
        let of = |mut posterior: Vec<(f64, f64)>| Interval::of(&mut posterior, &mut even(0.0, 1.0));
        assert_eq!(of(even(0.0, 1.0)), Interval::NotSeen);
        assert_eq!(of(even(0.05, 1.0)), Interval::NotSeen);
        let Interval::Between { low, middle, high } = of(even(0.2, 0.3)) else { panic!() };
        assert!(
            (low - 0.205).abs() < 1e-3
                && (middle - 0.25).abs() < 1e-3
                && (high - 0.295).abs() < 1e-3
        );
        let Interval::AtLeast { low } = of(even(0.4, 1.0)) else { panic!() };
        assert!((low - 0.46).abs() < 1e-3);
        let Interval::AtMost { high } = of(even(0.0, 0.7)) else { panic!() };
        assert!((high - 0.63).abs() < 1e-3);
        assert!(matches!(of(even(0.0, 0.1)), Interval::Between { .. }));
        assert_eq!(of(vec![(0.3, 0.0)]), Interval::NotSeen);
        assert_eq!(of(Vec::new()), Interval::NotSeen);
        assert_eq!(of(vec![(f64::NAN, f64::NAN)]), Interval::NotSeen);
    }
}
