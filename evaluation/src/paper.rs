//! Published figures: position RMSE in metres and orientation RMSE in degrees on the MOVi test splits, 120 scenes
//! each, at frames 50, 75 and 100.

/// Errors of one predictor on one data set, at frames 50, 75 and 100.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Published {
    /// Data set as scene files name it.
    pub dataset: &'static str,
    /// Whose figures: `paper` (RigidFormer) or `HopNet`.
    pub predictor: &'static str,
    /// Step code, for predictors that have one.
    pub step: Option<u32>,
    /// (position m, orientation degrees) at each frame.
    pub errors: [(f64, f64); 3],
}

const fn row(dataset: &'static str, step: u32, errors: [(f64, f64); 3]) -> Published {
    Published { dataset, predictor: "paper", step: Some(step), errors }
}

const fn hopnet(dataset: &'static str, errors: [(f64, f64); 3]) -> Published {
    Published { dataset, predictor: "HopNet", step: None, errors }
}

/// Every published row.
pub const PUBLISHED: [Published; 12] = [
    row("movi-a", 1, [(0.049, 5.06), (0.103, 10.90), (0.177, 18.32)]),
    row("movi-a", 5, [(0.035, 3.33), (0.083, 8.55), (0.148, 15.08)]),
    row("movi-a", 10, [(0.018, 1.47), (0.068, 6.98), (0.118, 11.93)]),
    hopnet("movi-a", [(0.054, 5.64), (0.115, 11.84), (0.196, 18.83)]),
    row("movi-b", 1, [(0.050, 3.97), (0.095, 8.51), (0.161, 15.33)]),
    row("movi-b", 5, [(0.040, 3.06), (0.078, 7.25), (0.136, 13.55)]),
    row("movi-b", 10, [(0.029, 1.51), (0.069, 5.89), (0.115, 10.85)]),
    hopnet("movi-b", [(0.047, 4.91), (0.101, 10.35), (0.176, 17.91)]),
    row("movi-sphere", 1, [(0.026, 3.00), (0.057, 6.48), (0.099, 11.19)]),
    row("movi-sphere", 5, [(0.021, 2.11), (0.047, 5.23), (0.086, 9.58)]),
    row("movi-sphere", 10, [(0.014, 1.09), (0.045, 4.30), (0.076, 7.47)]),
    hopnet("movi-sphere", [(0.034, 4.05), (0.073, 8.21), (0.124, 13.68)]),
];

/// The paper's row for a data set and step code, if it published one.
///
/// ```
/// let row = rigidformer_evaluation::paper::rigidformer("movi-a", 10).ok_or("no such row")?;
/// assert_eq!(row.errors[2], (0.118, 11.93));
/// # Ok::<(), &str>(())
/// ```
pub fn rigidformer(dataset: &str, step: u32) -> Option<&'static Published> {
    PUBLISHED.iter().find(|row| row.dataset == dataset && row.step == Some(step))
}

/// HopNet's row for a data set.
pub fn hop_net(dataset: &str) -> Option<&'static Published> {
    PUBLISHED.iter().find(|row| row.dataset == dataset && row.step.is_none())
}
