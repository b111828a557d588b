//! Gated attention of several queries to the same tokens: what is attended to, and the memory that takes.

use crate::math;

/// Queries that [`attend_together`](super::attend_together) takes side by side.
pub const TOGETHER: usize = 16;

/// Queries, and the keys and values that they attend to; all heads stand side by side.
#[derive(Clone, Copy, Debug)]
pub struct Attention<'a> {
    /// (queries, `query_stride`): a row's query begins at 0, its gate at `gate`.
    pub queries: &'a [f32],
    /// Numbers from a query to the next.
    pub query_stride: usize,
    /// Where the gate of a query begins.
    pub gate: usize,
    /// (tokens, `stride`): a row's keys begin at `key`, its values at `value`.
    pub tokens: &'a [f32],
    /// Numbers from a token to the next.
    pub stride: usize,
    /// Where the keys of a token begin.
    pub key: usize,
    /// Where the values of a token begin.
    pub value: usize,
    /// Channels of a head.
    pub head_dim: usize,
    /// Channels of all heads.
    pub inner: usize,
    /// Numbers from an output to the next; it is written from `out_start` on.
    pub out_stride: usize,
    /// Where an output's channels begin.
    pub out_start: usize,
}

impl Attention<'_> {
    /// Tokens.
    pub(super) fn count(&self) -> usize {
        self.tokens.len() / self.stride.max(1)
    }

    /// Factor of the scores.
    pub(super) fn scale(&self) -> f32 {
        1.0 / math::sqrt(self.head_dim as f32)
    }
}

/// Numbers of scratch that [`attend_together`](super::attend_together) needs.
pub const fn scratch_numbers(tokens: usize, head_dim: usize) -> usize {
    // One row more, so that the others can begin where a cache line does.
    tokens.saturating_add(head_dim).saturating_add(1).saturating_mul(TOGETHER)
}

/// A number for each of the queries that attend together.
pub type Lanes = [f32; TOGETHER];
