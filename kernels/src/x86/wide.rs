//! Products of f32 and f16 matrices, and other loops that hold sums in registers.
//!
//! Every sum has the order of `LANES`: either a register holds the eight lanes of one sum, and registers are added across
//! at the end, or eight registers hold a lane each of as many sums as a register has numbers.

use std::arch::x86_64::*;
use std::mem::MaybeUninit;

use half::f16;
use rigidformer_core::ANCHORS;
use rigidformer_core::kernels::LANES;

/// A register of f32.
///
/// Each implementation names its instructions, which are "the instructions of `V`" in contracts;
/// AVX and F16C are among them. Pointers are aligned as their type demands, not as a register.
pub(super) trait Wide: Copy {
    /// Numbers.
    const WIDTH: usize;
    /// Lanes of a sum that fit into the registers at a time, for [`ROWS`] rows of two registers.
    const LANES: usize;
    /// Rows whose weights fit into the registers beside the sums of [`weigh`].
    const WEIGHED: usize;

    /// [`tile`], apart from its caller, so that the registers are its own.
    ///
    /// # Safety
    /// As for the function [`tile`] with `Self` for `V`.
    unsafe fn tile(tile: Tile);

    /// [`by_columns`], apart from its caller, whose stack is the buffer's.
    ///
    /// # Safety
    /// As for the function [`by_columns`] with `Self` for `V`.
    unsafe fn columns<W: Weight>(columns: *mut f32, of: Matrices<'_, W>);

    /// So many zeros.
    ///
    /// # Safety
    /// The processor has the instructions of `Self`.
    unsafe fn zero() -> Self;
    /// One number everywhere.
    ///
    /// # Safety
    /// The processor has the instructions of `Self`, and `x` may be read.
    unsafe fn splat(x: *const f32) -> Self;
    /// Numbers from memory.
    ///
    /// # Safety
    /// The processor has the instructions of `Self`, and [`WIDTH`](Self::WIDTH) numbers may be read
    /// from `from` on.
    unsafe fn load(from: *const f32) -> Self;
    /// Numbers to memory.
    ///
    /// # Safety
    /// The processor has the instructions of `Self`, and [`WIDTH`](Self::WIDTH) numbers may be
    /// written from `to` on.
    unsafe fn store(self, to: *mut f32);
    /// `count` numbers from memory, others from `fill`.
    ///
    /// # Safety
    /// The processor has the instructions of `Self`. `count` is less than [`WIDTH`](Self::WIDTH),
    /// and `count` numbers may be read from `from` on.
    unsafe fn load_some(from: *const f32, count: usize, fill: Self) -> Self;
    /// The first `count` numbers to memory.
    ///
    /// # Safety
    /// The processor has the instructions of `Self`. `count` is less than [`WIDTH`](Self::WIDTH),
    /// and `count` numbers may be written from `to` on.
    unsafe fn store_some(self, to: *mut f32, count: usize);
    /// Sums.
    ///
    /// # Safety
    /// The processor has the instructions of `Self`.
    unsafe fn add(self, other: Self) -> Self;
    /// Differences.
    ///
    /// # Safety
    /// The processor has the instructions of `Self`.
    unsafe fn sub(self, other: Self) -> Self;
    /// Products.
    ///
    /// # Safety
    /// The processor has the instructions of `Self`.
    unsafe fn mul(self, other: Self) -> Self;
    /// Quotients.
    ///
    /// # Safety
    /// The processor has the instructions of `Self`.
    unsafe fn div(self, other: Self) -> Self;
    /// The other sign.
    ///
    /// # Safety
    /// The processor has the instructions of `Self`.
    unsafe fn negative(self) -> Self;
    /// The larger of each; of `self` where one is not a number.
    ///
    /// # Safety
    /// The processor has the instructions of `Self`.
    unsafe fn most(self, other: Self) -> Self;
    /// The smaller of each; of `self` where one is not a number.
    ///
    /// # Safety
    /// The processor has the instructions of `Self`.
    unsafe fn least(self, other: Self) -> Self;
    /// The largest of numbers.
    ///
    /// # Safety
    /// The processor has the instructions of `Self`.
    unsafe fn largest(self) -> f32;
    /// The power of two whose exponent the last bits are.
    ///
    /// # Safety
    /// The processor has the instructions of `Self`.
    unsafe fn power(self) -> Self;
}

/// A stored weight.
pub(super) trait Weight: Copy {
    /// Eight of them, widened.
    ///
    /// # Safety
    /// The processor has AVX and F16C, and eight weights may be read from `from` on, which is
    /// aligned for `Self`.
    unsafe fn load8(from: *const Self) -> __m256;
    /// `count` of them, fewer than eight, and zeros.
    ///
    /// # Safety
    /// The processor has AVX and F16C, and `count` weights, or the first eight of more, may be read
    /// from `from` on, which is aligned for `Self`.
    unsafe fn load_some(from: *const Self, count: usize) -> __m256;
}

/// A window of eight has as many leading ones as the window's start is below 8.
static MASKS: [i32; 16] = [-1, -1, -1, -1, -1, -1, -1, -1, 0, 0, 0, 0, 0, 0, 0, 0];

impl Weight for f32 {
    #[inline(always)]
    unsafe fn load8(from: *const f32) -> __m256 {
        // SAFETY: `Weight::load8` asks for AVX and eight weights at `from`; `vmovups` takes any
        // alignment.
        unsafe { _mm256_loadu_ps(from) }
    }

    #[inline(always)]
    unsafe fn load_some(from: *const f32, count: usize) -> __m256 {
        // SAFETY: `Weight::load_some` asks for AVX and `count` weights at `from`. The window on
        // `MASKS` begins at 0 to 8, so that its eight numbers are inside; lanes where it has zeros
        // are not read.
        unsafe {
            let mask = MASKS.as_ptr().add(8 - count.min(8));
            _mm256_maskload_ps(from, _mm256_loadu_si256(mask.cast()))
        }
    }
}

impl Weight for f16 {
    #[inline(always)]
    unsafe fn load8(from: *const f16) -> __m256 {
        // SAFETY: `Weight::load8` asks for AVX, F16C and eight weights of two bytes at `from`: 16
        // bytes.
        unsafe { _mm256_cvtph_ps(_mm_loadu_si128(from.cast())) }
    }

    #[inline(always)]
    unsafe fn load_some(from: *const f16, count: usize) -> __m256 {
        let mut eight = [f16::ZERO; 8];
        // SAFETY: `Weight::load_some` asks for F16C and `count` weights at `from`, of which `eight`
        // takes at most eight; then `eight` has the eight that `load8` asks for.
        unsafe {
            std::ptr::copy_nonoverlapping(from, eight.as_mut_ptr(), count.min(8));
            f16::load8(eight.as_ptr())
        }
    }
}

// `load8` takes 16 bytes.
const _: () = assert!(size_of::<f16>() == 2);

/// Sums across each of eight registers, in the order of `LANES`.
///
/// # Safety
/// The processor has AVX.
#[inline(always)]
unsafe fn add_across(sums: [__m256; 8]) -> __m256 {
    let [a, b, c, d, e, f, g, h] = sums;
    // SAFETY: AVX by this function's contract; registers alone.
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
///
/// # Safety
/// The processor has AVX and F16C.
#[inline(always)]
pub(super) unsafe fn dot(lhs: &[f32], rhs: &[f32]) -> f32 {
    let length = lhs.len().min(rhs.len());
    // SAFETY: AVX and F16C by this function's contract. `rhs` has `length` numbers, as many as the
    // slice of `lhs`; there is one row, so that its stride of 0 does not matter.
    unsafe {
        let [sum] = dots::<f32, f32, 1>(&lhs[..length], rhs.as_ptr(), 0);
        let sum = _mm_add_ps(_mm256_castps256_ps128(sum), _mm256_extractf128_ps::<1>(sum));
        let sum = _mm_add_ps(sum, _mm_movehl_ps(sum, sum));
        _mm_cvtss_f32(_mm_add_ss(sum, _mm_shuffle_ps::<1>(sum, sum)))
    }
}

/// Lanes of the products of a row with `N` rows as long that begin `stride` apart.
///
/// # Safety
/// The processor has AVX and F16C. For each i less than `N`, `x.len()` weights may be read from
/// `rows + i * stride` on.
#[inline(always)]
unsafe fn dots<X: Weight, W: Weight, const N: usize>(
    x: &[X],
    rows: *const W,
    stride: usize,
) -> [__m256; N] {
    // SAFETY: AVX and F16C by this function's contract. `at + LANES` is at most `whole`, and `whole
    // + rest` is the length of `x`, which is the length of each row by this function's contract.
    unsafe {
        let mut sums = [_mm256_setzero_ps(); N];
        let whole = x.len() / LANES * LANES;
        let mut at = 0;
        while at < whole {
            let x = X::load8(x.as_ptr().add(at));
            for (i, sum) in sums.iter_mut().enumerate() {
                let row = W::load8(rows.add(i * stride + at));
                *sum = _mm256_add_ps(*sum, _mm256_mul_ps(x, row));
            }
            at += LANES;
        }
        let rest = x.len() - whole;
        if rest > 0 {
            // A lane is never -0, so adding 0 x 0 does not change it.
            let x = X::load_some(x.as_ptr().add(whole), rest);
            for (i, sum) in sums.iter_mut().enumerate() {
                let row = W::load_some(rows.add(i * stride + whole), rest);
                *sum = _mm256_add_ps(*sum, _mm256_mul_ps(x, row));
            }
        }
        sums
    }
}

/// Products of `x` with `count` rows that begin `stride` apart, each through `end` and `apart` from the one before in `out`.
///
/// # Safety
/// The processor has AVX and F16C. For each i less than `count`, `x.len()` weights may be read from
/// `rows + i * stride` on, and `out + i * apart` may be written. None of the numbers that are
/// written is one of `x` or of the rows.
#[inline(always)]
unsafe fn dots_each<X: Weight, W: Weight>(
    x: &[X],
    (rows, stride, count): (*const W, usize, usize),
    (out, apart): (*mut f32, usize),
    end: impl Fn(usize, f32) -> f32,
) {
    let mut at = 0;
    while at < count {
        let mut eight = [0.0; 8];
        // SAFETY: AVX and F16C by this function's contract. `from` is row `at`, and `dots` takes no
        // more rows than the `here` that are left of `count`. `eight` has room for a register; `at
        // + i` is less than `count`.
        unsafe {
            let from = rows.add(at * stride);
            let here = count - at;
            let zero = _mm256_setzero_ps();
            let (sums, here) = match here {
                8.. => (dots::<X, W, 8>(x, from, stride), 8),
                4..8 => {
                    let [a, b, c, d] = dots::<X, W, 4>(x, from, stride);
                    ([a, b, c, d, zero, zero, zero, zero], 4)
                }
                2..4 => {
                    let [a, b] = dots::<X, W, 2>(x, from, stride);
                    ([a, b, zero, zero, zero, zero, zero, zero], 2)
                }
                _ => {
                    let [a] = dots::<X, W, 1>(x, from, stride);
                    ([a, zero, zero, zero, zero, zero, zero, zero], 1)
                }
            };
            _mm256_storeu_ps(eight.as_mut_ptr(), add_across(sums));
            for (i, sum) in eight.into_iter().enumerate().take(here) {
                *out.add((at + i) * apart) = end(at + i, sum);
            }
            at += here;
        }
    }
}

/// As `Kernels::scores`.
///
/// # Safety
/// The processor has AVX and F16C.
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
        // The definition allows overlapping rows, for strides shorter than a row.
        for (out, key) in out.iter_mut().zip(keys.chunks(stride)) {
            // SAFETY: AVX and F16C by this function's contract; `dot` reads no further than its
            // slices.
            *out = unsafe { dot(query, key.get(..query.len()).unwrap_or_default()) } * scale;
        }
        return;
    }
    let spare = keys.len().saturating_sub(query.len());
    let whole = if query.len() <= keys.len() { spare / stride + 1 } else { 0 };
    let begun = keys.len().div_ceil(stride).min(out.len());
    let count = whole.min(begun);
    let keys = (keys.as_ptr(), stride, count);
    // SAFETY: AVX and F16C by this function's contract. Key i begins at `i * stride` and has as
    // many numbers as the query: for i less than `whole` they are inside `keys`. `count` is at most
    // `whole` and the length of `out`, which is borrowed mutably, so that no key overlaps it.
    unsafe { dots_each(query, keys, (out.as_mut_ptr(), 1), |_, sum| sum * scale) };
    // The definition counts an incomplete last key as zeros.
    out[count..begun].fill(0.0 * scale);
}

/// As `Kernels::rms_norm`.
///
/// # Safety
/// The processor has AVX and F16C.
#[inline(always)]
pub(super) unsafe fn rms_norm(x: &mut [f32], weight: &[f32], eps: f32) {
    // SAFETY: AVX and F16C by this function's contract; `dot` reads no further than its slices.
    let mean = unsafe { dot(x, x) } / weight.len() as f32;
    // The same number as the core's, for it is rounded correctly; that one's instruction is of SSE, which waits for the upper halves of
    // registers.
    let scale = 1.0 / (mean + eps).sqrt();
    for (x, w) in x.iter_mut().zip(weight) {
        *x = (*x * scale) * w;
    }
}

/// Inputs up to which weights are transposed.
// The buffer for them is on the stack: 128 KiB with AVX-512.
const MAX_COLUMN_INPUTS: usize = 1024;
/// Rows of x of a tile.
// Three rows by two registers of columns leave registers for weights and lanes.
const ROWS: usize = 3;
/// Outputs up to which each is multiplied with all rows.
const MAX_ROW_OUTPUTS: usize = 8;
/// Rows from which transposing the weights pays.
const MIN_COLUMN_ROWS: usize = 4;
/// Room for the columns of two registers.
#[repr(align(64))]
struct Buffer<const NUMBERS: usize>([MaybeUninit<f32>; NUMBERS]);

/// What is multiplied by columns: `rows` rows of `inputs` numbers with `outputs` rows of as many weights.
pub(super) struct Matrices<'m, W> {
    x: &'m [f32],
    weight: &'m [W],
    bias: &'m [f32],
    inputs: usize,
    outputs: usize,
    rows: usize,
    /// Rows of `outputs` numbers, no fewer than `rows`.
    out: &'m mut [f32],
}

/// Multiplies with a buffer of so many numbers on the stack.
///
/// # Safety
/// As for [`by_columns`], with room for `NUMBERS` numbers.
// Apart from its caller, so that a thread needs no more stack than the largest layer of its model.
#[inline(never)]
unsafe fn on_stack<V: Wide, W: Weight, const NUMBERS: usize>(of: Matrices<'_, W>) {
    let mut columns = Buffer([const { MaybeUninit::<f32>::uninit() }; NUMBERS]);
    // SAFETY: this function's contract.
    unsafe { V::columns(columns.0.as_mut_ptr().cast::<f32>(), of) };
}

/// Rows of x, columns of two registers of `V` and where their products go. Rows may be the same, and
/// then their products go to the same place or each to its own.
#[derive(Clone, Copy)]
pub(super) struct Tile {
    /// `inputs` numbers each.
    x: [*const f32; ROWS],
    /// `inputs` times `2 * V::WIDTH` numbers: the columns of an input are side by side.
    columns: *const f32,
    inputs: usize,
    /// `2 * V::WIDTH` numbers.
    bias: *const f32,
    /// Room for `2 * V::WIDTH` numbers each.
    out: [*mut f32; ROWS],
}

/// As `Kernels::linear_f32` and `Kernels::linear_f16`.
///
/// # Safety
/// The processor has the instructions of `V`, and AVX and F16C.
#[inline(always)]
pub(super) unsafe fn linear<V: Wide, W: Weight>(
    x: &[f32],
    weight: &[W],
    bias: &[f32],
    inputs: usize,
    out: &mut [f32],
) {
    // `Buffer`, `biases` and `numbers` have room for 32 numbers, and `to_columns` writes eight at a time.
    const { assert!(2 * V::WIDTH <= 32 && V::WIDTH.is_multiple_of(8)) };
    let inputs = inputs.max(1);
    let outputs = (weight.len() / inputs).max(1);
    let rows = (x.len() / inputs).min(out.len().div_ceil(outputs));
    let bias_of = |n: usize| bias.get(n).copied().unwrap_or(0.0);
    // No whole row of weights: no output is defined.
    if weight.len() < inputs {
        return;
    }
    let available = out.len() / outputs;
    // Few outputs leave most lanes of a column tile empty: rows of x take the part of weights.
    if outputs <= MAX_ROW_OUTPUTS && rows >= outputs && available >= rows {
        for (n, weight) in weight.chunks_exact(inputs).enumerate() {
            let rows = (x.as_ptr(), inputs, rows);
            // SAFETY: AVX and F16C by this function's contract. `x` has `rows` rows of `inputs`
            // numbers, as many as `weight` has here. `out` has `available` rows of `outputs` numbers,
            // no fewer than `rows`, and `n` is less than `outputs`; it is borrowed mutably, so that
            // it overlaps none of them.
            unsafe {
                let out = (out.as_mut_ptr().add(n), outputs);
                dots_each(weight, rows, out, |_, sum| sum + bias_of(n));
            }
        }
        return;
    }
    if rows < MIN_COLUMN_ROWS
        || outputs < V::WIDTH
        || inputs > MAX_COLUMN_INPUTS
        || available < rows
    {
        for (x, out) in x.chunks_exact(inputs).zip(out.chunks_mut(outputs)) {
            let weight = (weight.as_ptr(), inputs, out.len().min(weight.len() / inputs));
            // SAFETY: AVX and F16C by this function's contract. `weight` has as many rows of
            // `inputs` numbers, and `out`, here a row of it, as many numbers; it is borrowed
            // mutably.
            unsafe { dots_each(x, weight, (out.as_mut_ptr(), 1), |n, sum| sum + bias_of(n)) };
        }
        return;
    }
    let numbers = inputs * 2 * V::WIDTH;
    let of = Matrices { x, weight, bias, inputs, outputs, rows, out };
    // SAFETY: The instructions by this function's contract. There are whole rows, as `Matrices` says, by the conditions above, and room
    // for as many numbers as the columns of two registers have: `inputs` is at most `MAX_COLUMN_INPUTS`.
    unsafe {
        match numbers {
            0..=0x800 => on_stack::<V, W, 0x800>(of),
            0x801..=0x1000 => on_stack::<V, W, 0x1000>(of),
            0x1001..=0x2000 => on_stack::<V, W, 0x2000>(of),
            0x2001..=0x4000 => on_stack::<V, W, 0x4000>(of),
            _ => on_stack::<V, W, { MAX_COLUMN_INPUTS * 32 }>(of),
        }
    }
}

/// As [`linear`], with the weights of two registers at a time in columns.
///
/// # Safety
/// The processor has the instructions of `V`. `inputs` times `2 * V::WIDTH` numbers may be written from `columns` on, none of which is
/// one of `of`, which has the rows that it says.
#[inline(always)]
pub(super) unsafe fn by_columns<V: Wide, W: Weight>(columns: *mut f32, of: Matrices<'_, W>) {
    let Matrices { x, weight, bias, inputs, outputs, rows, out } = of;
    let bias_of = |n: usize| bias.get(n).copied().unwrap_or(0.0);
    let width = 2 * V::WIDTH;
    let start = out.as_mut_ptr();
    for first in (0..outputs).step_by(width) {
        let count = width.min(outputs - first);
        let mut biases = [0.0_f32; 32];
        for (n, to) in biases.iter_mut().enumerate().take(count) {
            *to = bias_of(first + n);
        }
        // SAFETY: The instructions by this function's contract. `columns` has room for `inputs` times `width` numbers; `to_columns`
        // writes eight of the
        // `width` numbers of each input, `n + 8` at most being `width`, and reads `available` rows of
        // the `count` that `weight` has from `first` on. These calls fill all columns before the
        // first tile. `at` is less than `rows`, so that `x` has `inputs` numbers there, and `out` a
        // row of `outputs`, of which `count` begin at `first`: `width` of them where `full`, else
        // the tile writes to `numbers`, whose rows have room for 32, as `biases` has 32.
        unsafe {
            let weight = weight.as_ptr().add(first * inputs);
            for n in (0..width).step_by(8) {
                let available = count.saturating_sub(n).min(8);
                to_columns(
                    weight.add(n.min(count - 1) * inputs),
                    available,
                    inputs,
                    columns.add(n),
                    width,
                );
            }
            // A partial tile goes through an array, so that nothing behind the row is written.
            let full = count == width;
            let mut numbers = [[0.0_f32; 32]; ROWS];
            let mut row = 0;
            while row < rows {
                let here = ROWS.min(rows - row);
                // The last row stands in for missing ones.
                let at = |i: usize| row + i.min(here - 1);
                let to = |i: usize| start.add(at(i) * outputs + first);
                let x = |i: usize| x.as_ptr().add(at(i) * inputs);
                let out = if full {
                    [to(0), to(1), to(2)]
                } else {
                    numbers.each_mut().map(|numbers| numbers.as_mut_ptr())
                };
                let x = [x(0), x(1), x(2)];
                V::tile(Tile { x, columns, inputs, bias: biases.as_ptr(), out });
                if !full {
                    for (i, numbers) in numbers.iter().enumerate() {
                        std::ptr::copy_nonoverlapping(numbers.as_ptr(), to(i), count);
                    }
                }
                row += here;
            }
        }
    }
}

/// Puts eight rows of weights, of which `available` are there, in columns that begin `stride` apart.
///
/// # Safety
/// The processor has AVX and F16C. `available` is at most 8; from `weight` on, `available * inputs` weights
/// may be read. For each k less than `inputs`, eight numbers may be written from `to + k * stride`
/// on, none of which is one of the weights.
#[inline(always)]
unsafe fn to_columns<W: Weight>(
    weight: *const W,
    available: usize,
    inputs: usize,
    to: *mut f32,
    stride: usize,
) {
    // SAFETY: AVX and F16C by this function's contract. `here + count` is at most `inputs`, so that
    // a row is read no further than its end, and column `here + i` is one of `inputs`.
    unsafe {
        let mut at = 0;
        while at < inputs {
            // The last eight overlap the ones before, so that only fewer than eight inputs need a partial load.
            let here = at.min(inputs.saturating_sub(8));
            let count = (inputs - here).min(8);
            let mut rows = [_mm256_setzero_ps(); 8];
            for (i, row) in rows.iter_mut().enumerate().take(available) {
                let from = weight.add(i * inputs + here);
                *row = if count == 8 { W::load8(from) } else { W::load_some(from, count) };
            }
            for (i, column) in transpose(rows).into_iter().enumerate().take(count) {
                _mm256_storeu_ps(to.add((here + i) * stride), column);
            }
            at += 8;
        }
    }
}

/// Rows to columns.
///
/// # Safety
/// The processor has AVX.
#[inline(always)]
unsafe fn transpose(rows: [__m256; 8]) -> [__m256; 8] {
    let [a, b, c, d, e, f, g, h] = rows;
    // SAFETY: AVX by this function's contract; registers alone.
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
///
/// # Safety
/// The processor has the instructions of `V`. From each pointer of `tile` on, as many numbers may
/// be read, or written to `out`, as its field says, for this `V`. Nothing that is written overlaps
/// `x`, `columns` or `bias`.
#[inline(always)]
pub(super) unsafe fn tile<V: Wide>(tile: Tile) {
    // SAFETY: `column_products` asks for what the contract of `tile` says of `x`, `columns` and the
    // instructions. `j` is 0 or 1, and `bias` and `out` have two registers' numbers.
    unsafe {
        let sums = column_products::<V>(tile.x, tile.columns, tile.inputs);
        for (sums, out) in sums.into_iter().zip(tile.out) {
            for (j, sum) in sums.into_iter().enumerate() {
                let bias = V::load(tile.bias.add(j * V::WIDTH));
                sum.add(bias).store(out.add(j * V::WIDTH));
            }
        }
    }
}

/// Products of rows with two registers' columns.
///
/// # Safety
/// The processor has the instructions of `V`. From each of `x` on, `inputs` numbers may be read,
/// from `columns` on `inputs * 2 * V::WIDTH`.
#[inline(always)]
unsafe fn column_products<V: Wide>(
    x: [*const f32; ROWS],
    columns: *const f32,
    inputs: usize,
) -> [[V; 2]; ROWS] {
    // SAFETY: `lanes` asks for what this function's contract says, and for lanes below `LANES`,
    // which is 8.
    unsafe {
        // Lanes are formed in the order of the sum, so that few sums wait in registers.
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

/// Sums of both.
///
/// # Safety
/// The processor has the instructions of `V`.
#[inline(always)]
unsafe fn add<V: Wide>(mut a: [[V; 2]; ROWS], b: [[V; 2]; ROWS]) -> [[V; 2]; ROWS] {
    for (a, b) in a.iter_mut().zip(b) {
        for (a, b) in a.iter_mut().zip(b) {
            // SAFETY: the instructions by this function's contract.
            *a = unsafe { a.add(b) };
        }
    }
    a
}

/// Some of the eight lanes of those products.
///
/// # Safety
/// As for [`column_products`]; each of `which` is less than `LANES`.
#[inline(always)]
unsafe fn lanes<V: Wide, const N: usize>(
    which: [usize; N],
    x: [*const f32; ROWS],
    columns: *const f32,
    inputs: usize,
) -> [[[V; 2]; ROWS]; N] {
    // SAFETY: `at + lane` is less than `at + LANES`, which is at most `whole`, and `whole + lane`
    // was tested: an input less than `inputs`, so that `step` finds it in each of `x` and in
    // `columns`. The instructions by this function's contract.
    unsafe {
        let mut sums = [[[V::zero(); 2]; ROWS]; N];
        let whole = inputs / LANES * LANES;
        let mut at = 0;
        while at < whole {
            for (sums, lane) in sums.iter_mut().zip(which) {
                step(sums, x, columns, at + lane);
            }
            at += LANES;
        }
        for (sums, lane) in sums.iter_mut().zip(which) {
            if whole + lane < inputs {
                step(sums, x, columns, whole + lane);
            }
        }
        sums
    }
}

/// One input of them.
///
/// # Safety
/// The processor has the instructions of `V`. Number `k` of each of `x` may be read, and `2 *
/// V::WIDTH` numbers from `columns + k * 2 * V::WIDTH` on.
#[inline(always)]
unsafe fn step<V: Wide>(
    sums: &mut [[V; 2]; ROWS],
    x: [*const f32; ROWS],
    columns: *const f32,
    k: usize,
) {
    // SAFETY: by this function's contract the instructions, two registers' numbers at `from` and
    // number `k` of each of `x`.
    unsafe {
        let from = columns.add(k * 2 * V::WIDTH);
        let weights = [V::load(from), V::load(from.add(V::WIDTH))];
        for (sums, x) in sums.iter_mut().zip(x) {
            let x = V::splat(x.add(k));
            for (sum, weight) in sums.iter_mut().zip(weights) {
                *sum = sum.add(x.mul(weight));
            }
        }
    }
}

/// As `Kernels::mix`.
///
/// # Safety
/// The processor has the instructions of `V`.
#[inline(always)]
pub(super) unsafe fn mix<V: Wide>(weights: &[f32], values: &[f32], stride: usize, out: &mut [f32]) {
    let stride = stride.max(1);
    let count = weights.len().min(values.len().div_ceil(stride));
    let width = out.len();
    let whole = count == 0 || (width <= stride && (count - 1) * stride + width <= values.len());
    let done = if whole { width / V::WIDTH * V::WIDTH } else { 0 };
    let mut at = 0;
    // SAFETY: the instructions by this function's contract. Where `done` is not 0, `whole` holds:
    // value i begins at `i * stride`, and for i less than `count` its `width` numbers are inside
    // `values`; without weights none is read. `at` and as many registers as `mix_columns` takes
    // stay within `done`, which is at most `width`. `out` is borrowed mutably.
    unsafe {
        while at < done {
            let registers = (done - at) / V::WIDTH;
            // Without weights there may be no value at all.
            let (from, to) = (values.as_ptr().wrapping_add(at), out.as_mut_ptr().add(at));
            // Four registers hide the latency of their additions.
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
    if out.is_empty() {
        return;
    }
    out.fill(0.0);
    for (weight, value) in weights.iter().zip(values.chunks(stride)) {
        for (out, value) in out.iter_mut().zip(value.get(done..).unwrap_or_default()) {
            *out += weight * value;
        }
    }
}

/// Mixes `N` registers of columns of all values.
///
/// # Safety
/// The processor has the instructions of `V`. For each i less than `weights.len()`, `N * V::WIDTH`
/// numbers may be read from `values + i * stride` on; as many may be written from `out` on. None of
/// the latter is one of the values or of the weights.
#[inline(always)]
unsafe fn mix_columns<V: Wide, const N: usize>(
    weights: &[f32],
    values: *const f32,
    stride: usize,
    out: *mut f32,
) {
    // SAFETY: by this function's contract the instructions, and `N` registers' numbers at each
    // value and at `out`.
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
///
/// # Safety
/// The processor has the instructions of `V`.
#[inline(always)]
pub(super) unsafe fn weigh<V: Wide>(x: &[f32], weights: &[[f32; ANCHORS]], out: &mut [f32]) {
    let channels = (out.len() / ANCHORS).max(1);
    if out.len() < ANCHORS {
        // Without a whole channel the loop of the definition is exact.
        for (x, weights) in x.iter().zip(weights) {
            for (out, weight) in out.iter_mut().zip(weights) {
                *out += weight * x;
            }
        }
        return;
    }
    let rows = (x.len() / channels).min(weights.len());
    let mut row = 0;
    // SAFETY: the instructions by this function's contract. From `row` on there are as many rows of
    // `channels` numbers in `x` as `weigh_rows` takes, `rows` less `row` being no fewer. `out` has
    // `ANCHORS` rows of `channels` numbers and is borrowed mutably.
    unsafe {
        while row < rows {
            let (from, to) = (x.as_ptr().add(row * channels), out.as_mut_ptr());
            // Rows together share the loads and stores of the sums.
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
///
/// # Safety
/// The processor has the instructions of `V`. `N * channels` numbers may be read from `x` on,
/// `ANCHORS * channels` read and written from `out` on. None of the latter is one of `x` or of the
/// weights.
#[inline(always)]
unsafe fn weigh_rows<V: Wide, const N: usize>(
    x: *const f32,
    weights: &[[f32; ANCHORS]],
    channels: usize,
    out: *mut f32,
) {
    // SAFETY: the instructions by this function's contract. `row` is less than `N`, `anchor` less
    // than `ANCHORS`, and `at` and a register's numbers, or the one, stay within `channels`, so
    // that all places are inside what the contract says of `x` and `out`.
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
