//! Precision, recall and F.

/// Precision, recall and F, all from 0 to 1. Where nothing is there and nothing is found, all are 1.
#[derive(Clone, Copy, Debug, Default, PartialEq, serde::Serialize)]
pub struct Rates {
    /// Share of what is found that is right.
    pub precision: f64,
    /// Share of what is there that is found.
    pub recall: f64,
    /// Their harmonic mean.
    pub f: f64,
}

/// 1 of nothing.
pub(super) fn share(part: u64, whole: u64) -> f64 {
    if whole == 0 { 1.0 } else { part as f64 / whole as f64 }
}

/// Of what is found, so much is right; of what is there, so much is met.
pub(super) fn rates(right: u64, found: u64, met: u64, there: u64) -> Rates {
    if found == 0 && there == 0 {
        return Rates { precision: 1.0, recall: 1.0, f: 1.0 };
    }
    // Nothing found, or nothing to find: neither is right.
    let part = |part: u64, whole: u64| if whole == 0 { 0.0 } else { share(part, whole) };
    let (precision, recall) = (part(right, found), part(met, there));
    let sum = precision + recall;
    let f = if sum > 0.0 { 2.0 * precision * recall / sum } else { 0.0 };
    Rates { precision, recall, f }
}
