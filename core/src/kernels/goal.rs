//! What impulses of a sweep aim at.

/// What a sweep is for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Goal {
    /// No approach that gaps do not allow.
    Stop,
    /// The same, with lower units held.
    Settle,
    /// The speeds after a bounce.
    Bounce,
}
