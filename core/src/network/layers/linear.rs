//! Linear layers over any storage, and the small networks made of them.

use crate::kernels::{Schedule, Storage};
use crate::quant::Scratch;
use crate::stand_in::IS_HOST;

/// y = x Wᵀ + b
#[derive(Clone, Copy, Debug)]
pub(crate) struct Linear<'w> {
    pub(crate) weight: Storage<'w>,
    /// (outputs), or empty
    pub(crate) bias: &'w [f32],
    pub(crate) inputs: usize,
}

impl Linear<'_> {
    /// (rows, inputs) -> (rows, outputs)
    pub(crate) fn apply<S: Schedule>(
        &self,
        schedule: S,
        x: &[f32],
        out: &mut [f32],
        scratch: &mut Scratch<'_>,
    ) {
        self.weight.apply(schedule, x, self.bias, self.inputs.max(1), out, scratch);
    }
}

/// Linear, SiLU, linear.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Mlp<'w> {
    pub(crate) first: Linear<'w>,
    pub(crate) second: Linear<'w>,
}

impl Mlp<'_> {
    /// (rows, inputs) -> (rows, outputs), with the hidden rows in `hidden`.
    #[inline(never)]
    pub(crate) fn apply<S: Schedule>(
        &self,
        schedule: S,
        x: &[f32],
        hidden: &mut [f32],
        out: &mut [f32],
        scratch: &mut Scratch<'_>,
    ) {
        self.first.apply(schedule, x, hidden, scratch);
        schedule.silu(hidden);
        self.second.apply(schedule, hidden, out, scratch);
    }
}

/// Two or three linear layers, SiLU after each.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Chain<'w> {
    pub(crate) first: Linear<'w>,
    /// Only in files of version 2.
    pub(crate) middle: Option<Linear<'w>>,
    pub(crate) last: Linear<'w>,
}

impl Chain<'_> {
    /// (rows, inputs) -> (rows, outputs), with hidden rows in `hidden`.
    pub(crate) fn apply<S: Schedule>(
        &self,
        schedule: S,
        x: &[f32],
        [hidden, second]: [&mut [f32]; 2],
        out: &mut [f32],
        scratch: &mut Scratch<'_>,
    ) {
        self.first.apply(schedule, x, hidden, scratch);
        schedule.silu(hidden);
        let last = match &self.middle {
            // Only files with panels have one, or other hidden widths.
            Some(middle) if IS_HOST => {
                middle.apply(schedule, hidden, second, scratch);
                schedule.silu(second);
                second
            }
            _ => hidden,
        };
        self.last.apply(schedule, last, out, scratch);
        schedule.silu(out);
    }
}

/// Feature-wise modulation: its network gives gains, then biases.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Film<'w> {
    pub(crate) mlp: Mlp<'w>,
}
