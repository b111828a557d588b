//! Norms and elementwise layers.

use crate::kernels::Kernels;
use crate::slices::{copy_slice, rows, rows_mut};

/// Added to the mean square: a row of zeros stays zeros instead of becoming no numbers.
const EPS: f32 = 1e-6;

/// Each row of `x` (rows, width) divided by its root mean square, times `weight` (width).
#[inline(never)]
pub(crate) fn rms_norm<K: Kernels>(kernels: K, x: &[f32], weight: &[f32], out: &mut [f32]) {
    for (x, out) in rows(x, weight.len()).zip(rows_mut(out, weight.len())) {
        copy_slice(x, out);
        rms_norm_in_place(kernels, out, weight);
    }
}

/// As [`rms_norm`], one row in place.
pub(crate) fn rms_norm_in_place<K: Kernels>(kernels: K, x: &mut [f32], weight: &[f32]) {
    kernels.rms_norm(x, weight, EPS);
}

/// (rows, 2 hidden) gate and up -> (rows, hidden) silu(gate) * up
pub(crate) fn swiglu<K: Kernels>(kernels: K, gate_up: &[f32], hidden: usize, out: &mut [f32]) {
    for (row, out) in rows(gate_up, 2 * hidden).zip(rows_mut(out, hidden)) {
        let (gate, up) = row.split_at(hidden.min(row.len()));
        copy_slice(gate, out);
        kernels.silu(out);
        for (out, up) in out.iter_mut().zip(up) {
            *out *= up;
        }
    }
}

/// Each row h of (rows, width) becomes h (1 + gain) + bias; `film` is (2, width).
#[inline(never)]
pub(crate) fn modulate(h: &mut [f32], film: &[f32]) {
    let width = film.len() / 2;
    let (gain, bias) = film.split_at(width);
    for row in rows_mut(h, width) {
        for ((h, gain), bias) in row.iter_mut().zip(gain).zip(bias) {
            *h = *h * (1.0 + gain) + bias;
        }
    }
}

/// h += x
#[inline(never)]
pub(crate) fn add(h: &mut [f32], x: &[f32]) {
    for (h, x) in h.iter_mut().zip(x) {
        *h += x;
    }
}
