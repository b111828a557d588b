//! Gated attention of single queries, and the rotations of ARoPE.

use super::{copy, part_mut, rows, rows_mut};
use crate::kernels::Kernels;
use crate::math;

/// Cosines, then sines, of `frequency * coordinate`, axis by axis, into (2, angles).
pub(crate) fn turns(position: [f32; 3], frequencies: &[f32], out: &mut [f32]) {
    let (cos, sin) = out.split_at_mut(out.len() / 2);
    let angles = position.iter().flat_map(|p| frequencies.iter().map(move |w| p * w));
    for ((cos, sin), angle) in cos.iter_mut().zip(sin).zip(angles) {
        (*sin, *cos) = math::sin_cos(angle);
    }
}

/// Normalises each head of a row (heads, head_dim) and rotates its channel pairs
/// (2j, 2j + 1) by the angles of `turns` (2, angles); the other channels pass through.
pub(crate) fn norm_and_rotate<K: Kernels>(
    kernels: K,
    row: &mut [f32],
    weight: &[f32],
    turns: &[f32],
) {
    let (cos, sin) = turns.split_at(turns.len() / 2);
    for head in rows_mut(row, weight.len()) {
        super::rms_norm_in_place(kernels, head, weight);
        kernels.rotate(head, cos, sin);
    }
}

/// Keys and values of an attention: rows of `matrix` (tokens, stride) hold a token's keys
/// at `key` and values at `value`, each (heads, head_dim).
pub(crate) struct KeysValues<'a> {
    pub(crate) matrix: &'a [f32],
    pub(crate) stride: usize,
    pub(crate) key: usize,
    pub(crate) value: usize,
}

/// One query (heads, head_dim) against all tokens, times sigmoid(gate), into `out`.
/// `scores` is scratch of one number a token.
pub(crate) fn attend<K: Kernels>(
    kernels: K,
    query: &[f32],
    gate: &[f32],
    context: &KeysValues<'_>,
    head_dim: usize,
    scores: &mut [f32],
    out: &mut [f32],
) {
    let scale = 1.0 / math::sqrt(head_dim as f32);
    let scores = part_mut(scores, 0, context.matrix.len() / context.stride.max(1));
    let heads = rows(query, head_dim).zip(rows(gate, head_dim)).zip(rows_mut(out, head_dim));
    for (h, ((query, gate), out)) in heads.enumerate() {
        let from = |start: usize| context.matrix.get(start + h * head_dim..).unwrap_or_default();
        kernels.scores(query, from(context.key), context.stride, scale, scores);
        let total = kernels.softmax(scores);
        kernels.mix(scores, from(context.value), context.stride, out);
        let share = 1.0 / total;
        kernels.gate(out, share, gate);
    }
}

/// Copies a register or token row into its place.
pub(crate) fn place(rows: &[f32], start: usize, matrix: &mut [f32]) {
    copy(rows, part_mut(matrix, start, rows.len()));
}
