//! What a recording does not say itself.

use std::path::Path;

use super::error::{CaptureError, CaptureProblem};

/// How a recording is read, where it does not say so itself.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Options {
    /// Clouds a second, from 0.001 to 1000, of a folder without `frames.json` whose files' names are no times.
    pub rate_hz: Option<f64>,
    /// How much later the stamps of images and clouds are than what they show, against the stamps of transforms, seconds; at most 10 either
    /// way. A camera that is stamped as its images arrive has about 0.04; transforms that come late have it with a minus.
    pub latency_s: f64,
    /// Topics of an MCAP file that are read; empty: depth images, or clouds where there are none.
    pub topics: Vec<String>,
}

impl Options {
    /// Whether all numbers are within their ranges.
    pub(super) fn check(&self, path: &Path) -> Result<(), CaptureError> {
        let fail = |problem| Err(CaptureError::of(path, problem));
        // Captures are at least a millisecond apart, or they are one.
        if let Some(rate_hz) = self.rate_hz.filter(|rate_hz| !(0.001..=1000.0).contains(rate_hz)) {
            return fail(CaptureProblem::Rate(rate_hz));
        }
        if !(-10.0..=10.0).contains(&self.latency_s) {
            return fail(CaptureProblem::Latency(self.latency_s));
        }
        Ok(())
    }
}
