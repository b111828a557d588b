//! Settings of a planner, and their errors.

/// How a planner searches.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Settings {
    /// How the next iteration follows from the last.
    pub method: Method,
    /// Futures an iteration, at least 1; for [`Method::Cem`] at least as many as make two elites.
    pub futures: usize,
    /// At least 1.
    pub iterations: usize,
    /// Steps that each future is followed, at least 1.
    pub steps: usize,
    /// Another seed, other samples.
    pub seed: u64,
}

impl Default for Settings {
    /// The cross-entropy method with 4 iterations of 256 futures, 10 steps each.
    fn default() -> Self {
        Settings { method: Method::cem(), futures: 256, iterations: 4, steps: 10, seed: 1 }
    }
}

/// How the next iteration's mean and deviations follow from the last one's costs.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Method {
    /// Model predictive path integral control: the mean of all samples, weighted by exp(-cost / temperature).
    Mppi {
        /// In the cost's unit, above 0: the scale of differences that matter. At a low one, only the best samples count.
        temperature: f32,
        /// Deviations are multiplied by it after each iteration; above 0, at most 1, which leaves them.
        narrowing: f32,
    },
    /// The cross-entropy method: mean and deviations of the elite, those that cost least.
    Cem {
        /// Share of the futures that is the elite, above 0, at most 1.
        elite: f32,
        /// Weight of the old mean and deviations, from 0 to below 1.
        smoothing: f32,
    },
}

impl Method {
    /// MPPI at this temperature; deviations narrow to 0.7 from iteration to iteration.
    pub fn mppi(temperature: f32) -> Self {
        Method::Mppi { temperature, narrowing: 0.7 }
    }

    /// The cross-entropy method with an elite of a tenth, and a weight of a fifth for the old distribution.
    pub fn cem() -> Self {
        Method::Cem { elite: 0.1, smoothing: 0.2 }
    }
}

/// One number to choose.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Parameter {
    /// Around which the first iteration tries; within the bounds.
    pub mean: f32,
    /// How far around, as a standard deviation; 0 keeps the parameter at its mean.
    pub deviation: f32,
    /// Least value; minus infinity for none. Samples beyond a bound are put on it.
    pub low: f32,
    /// Greatest value; infinity for none.
    pub high: f32,
}

impl Parameter {
    /// A parameter without bounds.
    pub fn new(mean: f32, deviation: f32) -> Self {
        Parameter { mean, deviation, low: f32::NEG_INFINITY, high: f32::INFINITY }
    }

    /// The same between bounds.
    pub fn within(self, low: f32, high: f32) -> Self {
        Parameter { low, high, ..self }
    }

    pub(super) fn check(&self, index: usize) -> Result<(), SettingsError> {
        let Parameter { mean, deviation, low, high } = *self;
        if !deviation.is_finite() || deviation < 0.0 {
            return Err(SettingsError::Deviation { index, deviation });
        }
        // Comparisons with NaN are false, so that NaN is an error.
        if !(mean.is_finite() && low <= mean && mean <= high) {
            return Err(SettingsError::Bounds { index, mean, low, high });
        }
        Ok(())
    }
}

/// A setting or parameter that is refused, and its range.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum SettingsError {
    /// Something is 0 that is counted from 1.
    #[error("{what} is 0; give at least 1")]
    Zero {
        /// `futures`, `iterations`, `steps` or `parameters`.
        what: &'static str,
    },
    /// A number is out of its range.
    #[error("{what} is {found}; it must be {range}")]
    Range {
        /// Which.
        what: &'static str,
        /// Given.
        found: f32,
        /// Allowed.
        range: &'static str,
    },
    /// An elite of fewer than two has no deviation.
    #[error(
        "an elite of {elite} of {futures} futures is fewer than two; raise `elite` or `futures`"
    )]
    Elite {
        /// Share of the futures.
        elite: f32,
        /// Futures an iteration.
        futures: usize,
    },
    /// A deviation is negative or not finite.
    #[error("parameter {index}: its deviation is {deviation}; it must be finite and at least 0")]
    Deviation {
        /// Which parameter.
        index: usize,
        /// Given.
        deviation: f32,
    },
    /// A mean is not between its bounds, or something is not a number.
    #[error("parameter {index}: its mean is {mean}; it must be finite and from {low} to {high}")]
    Bounds {
        /// Which parameter.
        index: usize,
        /// Given.
        mean: f32,
        /// Lower bound.
        low: f32,
        /// Upper bound.
        high: f32,
    },
    /// Another number of parameters.
    #[error("{found} parameters, {expected} are needed")]
    Length {
        /// Needed.
        expected: usize,
        /// Given.
        found: usize,
    },
}

impl Settings {
    pub(super) fn check(&self, parameters: &[Parameter]) -> Result<(), SettingsError> {
        let counts = [
            ("futures", self.futures),
            ("iterations", self.iterations),
            ("steps", self.steps),
            ("parameters", parameters.len()),
        ];
        if let Some((what, _)) = counts.into_iter().find(|(_, count)| *count == 0) {
            return Err(SettingsError::Zero { what });
        }
        let range = |what, found: f32, fits: bool, range| match fits {
            true => Ok(()),
            false => Err(SettingsError::Range { what, found, range }),
        };
        let is_share = |x: f32| x > 0.0 && x <= 1.0;
        match self.method {
            Method::Mppi { temperature, narrowing } => {
                let fits = temperature.is_finite() && temperature > 0.0;
                range("temperature", temperature, fits, "finite and above 0")?;
                range("narrowing", narrowing, is_share(narrowing), "above 0, at most 1")?;
            }
            Method::Cem { elite, smoothing } => {
                range("elite", elite, is_share(elite), "above 0, at most 1")?;
                let fits = (0.0..1.0).contains(&smoothing);
                range("smoothing", smoothing, fits, "from 0 to below 1")?;
                // One elite has no deviation, and the search would stop at once.
                if elites(elite, self.futures) < 2 {
                    return Err(SettingsError::Elite { elite, futures: self.futures });
                }
            }
        }
        parameters.iter().enumerate().try_for_each(|(index, parameter)| parameter.check(index))
    }
}

/// Number of elites among `futures`.
pub(super) fn elites(share: f32, futures: usize) -> usize {
    (share * futures as f32).round() as usize
}
