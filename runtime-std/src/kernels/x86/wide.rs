//! Products of f32 and f16 matrices, and other loops that hold sums in registers.
//!
//! Every sum has the order of `LANES`: either a register holds the eight lanes of one sum, and registers are added across
//! at the end, or eight registers hold a lane each of as many sums as a register has numbers.

use std::arch::x86_64::*;
use std::mem::MaybeUninit;

use half::f16;
use rigidformer_core::kernels::LANES;
use rigidformer_core::{ANCHORS, math};

/// A register of f32.
pub(super) trait Wide: Copy {
    /// Numbers.
    const WIDTH: usize;
    /// Lanes of a sum that fit into the registers at a time, for [`ROWS`] rows of two registers.
    const LANES: usize;
    /// Rows whose weights fit into the registers beside the sums of [`weigh`].
    const WEIGHED: usize;

    /// So many zeros.
    unsafe fn zero() -> Self;
    /// One number everywhere.
    unsafe fn splat(x: *const f32) -> Self;
    /// Numbers from memory.
    unsafe fn load(from: *const f32) -> Self;
    /// Numbers to memory.
    unsafe fn store(self, to: *mut f32);
    /// Sums.
    unsafe fn add(self, other: Self) -> Self;
    /// Products.
    unsafe fn mul(self, other: Self) -> Self;
}

/// A stored weight.
pub(super) trait Weight: Copy {
    /// What fills up.
    const ZERO: Self;

    /// Eight of them, widened.
    unsafe fn load8(from: *const Self) -> __m256;
}

impl Weight for f32 {
    const ZERO: f32 = 0.0;

    #[inline(always)]
    unsafe fn load8(from: *const f32) -> __m256 {
        // SAFETY: the caller has AVX and eight numbers.
        unsafe { _mm256_loadu_ps(from) }
    }
}

impl Weight for f16 {
    const ZERO: f16 = f16::ZERO;

    #[inline(always)]
    unsafe fn load8(from: *const f16) -> __m256 {
        // SAFETY: the caller has F16C and eight numbers.
        unsafe { _mm256_cvtph_ps(_mm_loadu_si128(from.cast())) }
    }
}

/// Numbers of a slice, at most eight, and zeros behind them.
#[inline(always)]
unsafe fn load_some<W: Weight>(from: &[W]) -> __m256 {
    let mut eight = [W::ZERO; LANES];
    for (to, from) in eight.iter_mut().zip(from) {
        *to = *from;
    }
    // SAFETY: the caller has F16C; eight numbers.
    unsafe { W::load8(eight.as_ptr()) }
}

/// Sums across each of eight registers, in the order of `LANES`.
#[inline(always)]
unsafe fn add_across(sums: [__m256; 8]) -> __m256 {
    let [a, b, c, d, e, f, g, h] = sums;
    // SAFETY: the caller has AVX.
    unsafe {
        // Lanes j and j + 4 of two sums: [first; second].
        let halves = |x: __m256, y: __m256| {
            _mm256_add_ps(
                _mm256_permute2f128_ps::<0x20>(x, y),
                _mm256_permute2f128_ps::<0x31>(x, y),
            )
        };
        // [x02 x13 y02 y13], the same of the second half.
        let pairs = |x: __m256, y: __m256| {
            _mm256_add_ps(_mm256_shuffle_ps::<0x44>(x, y), _mm256_shuffle_ps::<0xee>(x, y))
        };
        let singles = |x: __m256, y: __m256| {
            _mm256_add_ps(_mm256_shuffle_ps::<0x88>(x, y), _mm256_shuffle_ps::<0xdd>(x, y))
        };
        let (ae, bf, cg, dh) = (halves(a, e), halves(b, f), halves(c, g), halves(d, h));
        singles(pairs(ae, bf), pairs(cg, dh))
    }
}

/// As `Kernels::dot_f32`.
#[inline(always)]
pub(super) unsafe fn dot(lhs: &[f32], rhs: &[f32]) -> f32 {
    let length = lhs.len().min(rhs.len());
    // SAFETY: both slices have so many numbers; the caller has F16C.
    unsafe {
        let [sum] = dots::<f32, 1>(&lhs[..length], [rhs.as_ptr()]);
        let sum = _mm_add_ps(_mm256_castps256_ps128(sum), _mm256_extractf128_ps::<1>(sum));
        let sum = _mm_add_ps(sum, _mm_movehl_ps(sum, sum));
        _mm_cvtss_f32(_mm_add_ss(sum, _mm_shuffle_ps::<1>(sum, sum)))
    }
}

/// Lanes of the products of a row with `N` others, all as long.
#[inline(always)]
unsafe fn dots<W: Weight, const N: usize>(x: &[f32], others: [*const W; N]) -> [__m256; N] {
    // SAFETY: the caller says that all are as long as `x`, and has F16C.
    unsafe {
        let mut sums = [_mm256_setzero_ps(); N];
        let whole = x.len() / LANES * LANES;
        let mut at = 0;
        while at < whole {
            let x = _mm256_loadu_ps(x.as_ptr().add(at));
            for (sum, other) in sums.iter_mut().zip(others) {
                *sum = _mm256_add_ps(*sum, _mm256_mul_ps(x, W::load8(other.add(at))));
            }
            at += LANES;
        }
        let rest = x.len() - whole;
        if rest > 0 {
            // A lane is never -0, so adding 0 x 0 leaves it as it is.
            let x = load_some(&x[whole..]);
            for (sum, other) in sums.iter_mut().zip(others) {
                let other = load_some(std::slice::from_raw_parts(other.add(whole), rest));
                *sum = _mm256_add_ps(*sum, _mm256_mul_ps(x, other));
            }
        }
        sums
    }
}

/// Products of `x` with rows that begin `stride` apart, each through `end`.
#[inline(always)]
unsafe fn dots_each<W: Weight>(
    x: &[f32],
    rows: &[W],
    stride: usize,
    out: &mut [f32],
    end: impl Fn(usize, f32) -> f32,
) {
    let spare = rows.len().saturating_sub(x.len());
    let whole = if x.len() <= rows.len() { spare / stride + 1 } else { 0 };
    let count = whole.min(rows.len().div_ceil(stride)).min(out.len());
    // SAFETY: `count` rows are as long as `x`; the last of them stand in for those of a group that are missing. The caller
    // has F16C.
    unsafe {
        for (group, out) in out[..count].chunks_mut(8).enumerate() {
            let row = |i: usize| rows.as_ptr().add((group * 8 + i).min(count - 1) * stride);
            let sums =
                dots::<W, 8>(x, [row(0), row(1), row(2), row(3), row(4), row(5), row(6), row(7)]);
            let mut eight = [0.0; 8];
            _mm256_storeu_ps(eight.as_mut_ptr(), add_across(sums));
            for (i, (out, sum)) in out.iter_mut().zip(eight).enumerate() {
                *out = end(group * 8 + i, sum);
            }
        }
    }
    for (i, out) in out.iter_mut().enumerate().skip(count) {
        if i * stride < rows.len() {
            *out = end(i, 0.0);
        }
    }
}

/// As `Kernels::scores`.
#[inline(always)]
pub(super) unsafe fn scores(
    query: &[f32],
    keys: &[f32],
    stride: usize,
    scale: f32,
    out: &mut [f32],
) {
    let stride = stride.max(1);
    if stride < query.len() {
        // Rows that overlap, which the definition takes for short ones.
        for (out, key) in out.iter_mut().zip(keys.chunks(stride)) {
            // SAFETY: the caller has F16C.
            *out = unsafe { dot(query, key.get(..query.len()).unwrap_or_default()) } * scale;
        }
        return;
    }
    // SAFETY: the caller has F16C.
    unsafe { dots_each(query, keys, stride, out, |_, sum| sum * scale) }
}

/// As `Kernels::rms_norm`.
#[inline(always)]
pub(super) unsafe fn rms_norm(x: &mut [f32], weight: &[f32], eps: f32) {
    // SAFETY: the caller has F16C.
    let mean = unsafe { dot(x, x) } / weight.len() as f32;
    let scale = 1.0 / math::sqrt(mean + eps);
    for (x, w) in x.iter_mut().zip(weight) {
        *x = (*x * scale) * w;
    }
}

/// Inputs up to which weights are put in columns.
const DEEP: usize = 1024;
/// Rows of x that go through the registers together.
const ROWS: usize = 3;
/// Rows from which putting weights in columns is worth it.
const MANY: usize = 4;
/// Numbers of the columns of two registers.
const BUFFER: usize = DEEP * 32;

/// As `Kernels::linear_f32` and `Kernels::linear_f16`.
#[inline(always)]
pub(super) unsafe fn linear<V: Wide, W: Weight>(
    x: &[f32],
    weight: &[W],
    bias: &[f32],
    inputs: usize,
    out: &mut [f32],
) {
    let inputs = inputs.max(1);
    let outputs = (weight.len() / inputs).max(1);
    let rows = (x.len() / inputs).min(out.len().div_ceil(outputs));
    let bias_of = |n: usize| bias.get(n).copied().unwrap_or(0.0);
    if weight.len() < inputs {
        return;
    }
    if rows < MANY || outputs < V::WIDTH || inputs > DEEP || out.len() < rows * outputs {
        for (x, out) in x.chunks_exact(inputs).zip(out.chunks_mut(outputs)) {
            // SAFETY: the caller has F16C.
            unsafe { dots_each(x, weight, inputs, out, |n, sum| sum + bias_of(n)) };
        }
        return;
    }
    let mut columns = [const { MaybeUninit::<f32>::uninit() }; BUFFER];
    let columns = columns.as_mut_ptr().cast::<f32>();
    let width = 2 * V::WIDTH;
    for first in (0..outputs).step_by(width) {
        let count = width.min(outputs - first);
        let mut biases = [0.0_f32; 32];
        for (n, to) in biases.iter_mut().enumerate().take(count) {
            *to = bias_of(first + n);
        }
        // SAFETY: the buffer has room for `inputs` times `width` numbers, `weight` has `count` rows from `first` on, `x` and
        // `out` have `rows` rows. The caller has F16C and the instructions of V.
        unsafe {
            let weight = weight.as_ptr().add(first * inputs);
            for n in (0..width).step_by(8) {
                let there = count.saturating_sub(n).min(8);
                to_columns(
                    weight.add(n.min(count - 1) * inputs),
                    there,
                    inputs,
                    columns.add(n),
                    width,
                );
            }
            let mut row = 0;
            while row < rows {
                let here = ROWS.min(rows - row);
                // Rows that are missing are computed as the last one again.
                let x: [*const f32; ROWS] =
                    std::array::from_fn(|i| x.as_ptr().add((row + i.min(here - 1)) * inputs));
                let sums = column_products::<V>(x, columns, inputs);
                for (i, sums) in sums.into_iter().enumerate().take(here) {
                    let to = out.as_mut_ptr().add((row + i) * outputs + first);
                    let mut numbers = [0.0_f32; 32];
                    let full = count == width;
                    let direct = if full { to } else { numbers.as_mut_ptr() };
                    for (j, sum) in sums.into_iter().enumerate() {
                        let bias = V::load(biases.as_ptr().add(j * V::WIDTH));
                        sum.add(bias).store(direct.add(j * V::WIDTH));
                    }
                    if !full {
                        std::ptr::copy_nonoverlapping(numbers.as_ptr(), to, count);
                    }
                }
                row += here;
            }
        }
    }
}

/// Puts eight rows of weights, of which `there` are there, in columns that begin `stride` apart.
#[inline(always)]
unsafe fn to_columns<W: Weight>(
    weight: *const W,
    there: usize,
    inputs: usize,
    to: *mut f32,
    stride: usize,
) {
    // SAFETY: the caller has so many rows, room for `inputs` columns of eight, and F16C.
    unsafe {
        let mut at = 0;
        while at < inputs {
            let count = (inputs - at).min(8);
            let mut rows = [_mm256_setzero_ps(); 8];
            for (i, row) in rows.iter_mut().enumerate() {
                if i < there {
                    let from = weight.add(i * inputs + at);
                    *row = if count == 8 {
                        W::load8(from)
                    } else {
                        load_some(std::slice::from_raw_parts(from, count))
                    };
                }
            }
            for (i, column) in transpose(rows).into_iter().enumerate() {
                if i < count {
                    _mm256_storeu_ps(to.add((at + i) * stride), column);
                }
            }
            at += 8;
        }
    }
}

#[inline(always)]
unsafe fn transpose(rows: [__m256; 8]) -> [__m256; 8] {
    let [a, b, c, d, e, f, g, h] = rows;
    // SAFETY: the caller has AVX.
    unsafe {
        let quads = |a, b, c, d| {
            let (ab, cd) = (_mm256_unpacklo_ps(a, b), _mm256_unpacklo_ps(c, d));
            let (ab2, cd2) = (_mm256_unpackhi_ps(a, b), _mm256_unpackhi_ps(c, d));
            [
                _mm256_shuffle_ps::<0x44>(ab, cd),
                _mm256_shuffle_ps::<0xee>(ab, cd),
                _mm256_shuffle_ps::<0x44>(ab2, cd2),
                _mm256_shuffle_ps::<0xee>(ab2, cd2),
            ]
        };
        let [a, b, c, d] = quads(a, b, c, d);
        let [e, f, g, h] = quads(e, f, g, h);
        let low = |x, y| _mm256_permute2f128_ps::<0x20>(x, y);
        let high = |x, y| _mm256_permute2f128_ps::<0x31>(x, y);
        [low(a, e), low(b, f), low(c, g), low(d, h), high(a, e), high(b, f), high(c, g), high(d, h)]
    }
}

/// Products of rows with two registers' columns.
#[inline(always)]
unsafe fn column_products<V: Wide>(
    x: [*const f32; ROWS],
    columns: *const f32,
    inputs: usize,
) -> [[V; 2]; ROWS] {
    // SAFETY: as the caller says.
    unsafe {
        let add = |a: [[V; 2]; ROWS], b: [[V; 2]; ROWS]| {
            std::array::from_fn(|r| std::array::from_fn(|j| a[r][j].add(b[r][j])))
        };
        if V::LANES == 4 {
            let [a, e, c, g] = lanes([0, 4, 2, 6], x, columns, inputs);
            let even: [[V; 2]; ROWS] = add(add(a, e), add(c, g));
            let [b, f, d, h] = lanes([1, 5, 3, 7], x, columns, inputs);
            add(even, add(add(b, f), add(d, h)))
        } else {
            let [a, e] = lanes([0, 4], x, columns, inputs);
            let ae: [[V; 2]; ROWS] = add(a, e);
            let [c, g] = lanes([2, 6], x, columns, inputs);
            let even: [[V; 2]; ROWS] = add(ae, add(c, g));
            let [b, f] = lanes([1, 5], x, columns, inputs);
            let bf: [[V; 2]; ROWS] = add(b, f);
            let [d, h] = lanes([3, 7], x, columns, inputs);
            add(even, add(bf, add(d, h)))
        }
    }
}

/// Some of the eight lanes of those products.
#[inline(always)]
unsafe fn lanes<V: Wide, const N: usize>(
    which: [usize; N],
    x: [*const f32; ROWS],
    columns: *const f32,
    inputs: usize,
) -> [[[V; 2]; ROWS]; N] {
    // SAFETY: `x` has `inputs` numbers, `columns` that times two registers, says the caller, who has the instructions of V.
    unsafe {
        let mut sums = [[[V::zero(); 2]; ROWS]; N];
        let step = |sums: &mut [[V; 2]; ROWS], k: usize| {
            let from = columns.add(k * 2 * V::WIDTH);
            let weights = [V::load(from), V::load(from.add(V::WIDTH))];
            for (sums, x) in sums.iter_mut().zip(x) {
                let x = V::splat(x.add(k));
                for (sum, weight) in sums.iter_mut().zip(weights) {
                    *sum = sum.add(x.mul(weight));
                }
            }
        };
        let whole = inputs / LANES * LANES;
        let mut at = 0;
        while at < whole {
            for (sums, lane) in sums.iter_mut().zip(which) {
                step(sums, at + lane);
            }
            at += LANES;
        }
        for (sums, lane) in sums.iter_mut().zip(which) {
            if whole + lane < inputs {
                step(sums, whole + lane);
            }
        }
        sums
    }
}

/// As `Kernels::mix`.
#[inline(always)]
pub(super) unsafe fn mix<V: Wide>(weights: &[f32], values: &[f32], stride: usize, out: &mut [f32]) {
    let stride = stride.max(1);
    let count = weights.len().min(values.len().div_ceil(stride));
    let width = out.len();
    let whole = count == 0 || (width <= stride && (count - 1) * stride + width <= values.len());
    let done = if whole { width / V::WIDTH * V::WIDTH } else { 0 };
    let mut at = 0;
    // SAFETY: every value that is read has `width` numbers. The caller has the instructions of V.
    unsafe {
        while at < done {
            let registers = (done - at) / V::WIDTH;
            let (from, to) = (values.as_ptr().add(at), out.as_mut_ptr().add(at));
            if registers >= 4 {
                mix_columns::<V, 4>(&weights[..count], from, stride, to);
                at += 4 * V::WIDTH;
            } else {
                mix_columns::<V, 1>(&weights[..count], from, stride, to);
                at += V::WIDTH;
            }
        }
    }
    let out = &mut out[done..];
    out.fill(0.0);
    for (weight, value) in weights.iter().zip(values.chunks(stride)) {
        for (out, value) in out.iter_mut().zip(value.get(done..).unwrap_or_default()) {
            *out += weight * value;
        }
    }
}

#[inline(always)]
unsafe fn mix_columns<V: Wide, const N: usize>(
    weights: &[f32],
    values: *const f32,
    stride: usize,
    out: *mut f32,
) {
    // SAFETY: as the caller says.
    unsafe {
        let mut sums = [V::zero(); N];
        for (row, weight) in weights.iter().enumerate() {
            let weight = V::splat(weight);
            let from = values.add(row * stride);
            for (i, sum) in sums.iter_mut().enumerate() {
                *sum = sum.add(weight.mul(V::load(from.add(i * V::WIDTH))));
            }
        }
        for (i, sum) in sums.into_iter().enumerate() {
            sum.store(out.add(i * V::WIDTH));
        }
    }
}

/// As `Kernels::weigh`.
#[inline(always)]
pub(super) unsafe fn weigh<V: Wide>(x: &[f32], weights: &[[f32; ANCHORS]], out: &mut [f32]) {
    let channels = (out.len() / ANCHORS).max(1);
    if out.len() < ANCHORS {
        // No whole channel: as the definition, channel by channel.
        for (x, weights) in x.iter().zip(weights) {
            for (out, weight) in out.iter_mut().zip(weights) {
                *out += weight * x;
            }
        }
        return;
    }
    let rows = (x.len() / channels).min(weights.len());
    let mut row = 0;
    // SAFETY: there are `rows` rows of `channels` channels, and four rows of `out`. The caller has the instructions of V.
    unsafe {
        while row < rows {
            let (from, to) = (x.as_ptr().add(row * channels), out.as_mut_ptr());
            if V::WEIGHED == 4 && rows - row >= 4 {
                weigh_rows::<V, 4>(from, &weights[row..], channels, to);
                row += 4;
            } else if rows - row >= 2 {
                weigh_rows::<V, 2>(from, &weights[row..], channels, to);
                row += 2;
            } else {
                weigh_rows::<V, 1>(from, &weights[row..], channels, to);
                row += 1;
            }
        }
    }
}

/// Weighs `N` rows.
#[inline(always)]
unsafe fn weigh_rows<V: Wide, const N: usize>(
    x: *const f32,
    weights: &[[f32; ANCHORS]],
    channels: usize,
    out: *mut f32,
) {
    // SAFETY: as the caller says.
    unsafe {
        let mut wide = [[V::zero(); ANCHORS]; N];
        for (wide, weights) in wide.iter_mut().zip(weights) {
            for (wide, weight) in wide.iter_mut().zip(weights) {
                *wide = V::splat(weight);
            }
        }
        let mut at = 0;
        while at + V::WIDTH <= channels {
            let mut sums = [V::zero(); ANCHORS];
            for (anchor, sum) in sums.iter_mut().enumerate() {
                *sum = V::load(out.add(anchor * channels + at));
            }
            for (row, wide) in wide.iter().enumerate() {
                let x = V::load(x.add(row * channels + at));
                for (sum, weight) in sums.iter_mut().zip(wide) {
                    *sum = sum.add(weight.mul(x));
                }
            }
            for (anchor, sum) in sums.into_iter().enumerate() {
                sum.store(out.add(anchor * channels + at));
            }
            at += V::WIDTH;
        }
        while at < channels {
            for (row, weights) in weights.iter().enumerate().take(N) {
                for (anchor, weight) in weights.iter().enumerate() {
                    *out.add(anchor * channels + at) += weight * *x.add(row * channels + at);
                }
            }
            at += 1;
        }
    }
}
