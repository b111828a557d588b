//! AVX2: registers of 8 numbers, 16 of them; products of int8 with VNNI, and what those without share with them.

use std::arch::x86_64::*;

use super::int8::{Epilogue, Int8, SERVED};
use super::wide::{self, Matrices, Tile, Weight, Wide};

/// Products of int8 by VPDPBUSD, activations with 128 added. The instructions: AVX2 and AVX-VNNI.
pub(super) struct Vnni;

/// Eight sums, scaled, with their bias.
///
/// # Safety
/// The processor has AVX2. Eight numbers may be read from `end.scales` and from `end.bias` on, and
/// as many written from `out` on.
#[inline(always)]
pub(super) unsafe fn finish(sums: __m256i, row_scale: f32, end: Epilogue, out: *mut f32) {
    // SAFETY: by this function's contract AVX2 and eight numbers at each pointer.
    unsafe {
        let scale = _mm256_mul_ps(_mm256_set1_ps(row_scale), _mm256_loadu_ps(end.scales));
        let x = _mm256_mul_ps(_mm256_cvtepi32_ps(sums), scale);
        _mm256_storeu_ps(out, _mm256_add_ps(x, _mm256_loadu_ps(end.bias)));
    }
}

/// The bits of eight magnitudes.
///
/// # Safety
/// The processor has AVX2, and eight numbers may be read from `from` on.
#[inline(always)]
pub(super) unsafe fn magnitude(from: *const f32) -> __m256i {
    // SAFETY: by this function's contract AVX2 and eight numbers at `from`.
    unsafe { _mm256_and_si256(_mm256_loadu_si256(from.cast()), _mm256_set1_epi32(i32::MAX)) }
}

/// The largest of eight numbers.
///
/// # Safety
/// The processor has AVX2.
#[inline(always)]
pub(super) unsafe fn most(x: __m256i) -> i32 {
    // SAFETY: AVX2 by this function's contract.
    unsafe {
        let x = _mm_max_epi32(_mm256_castsi256_si128(x), _mm256_extracti128_si256::<1>(x));
        let x = _mm_max_epi32(x, _mm_shuffle_epi32::<0b00_00_11_10>(x));
        _mm_cvtsi128_si32(_mm_max_epi32(x, _mm_shuffle_epi32::<1>(x)))
    }
}

/// Nearest integers of eight products.
///
/// # Safety
/// The processor has AVX2, and eight numbers may be read from `from` on.
#[inline(always)]
pub(super) unsafe fn round(from: *const f32, inverse: f32) -> __m256i {
    // SAFETY: by this function's contract AVX2 and eight numbers at `from`.
    unsafe { _mm256_cvtps_epi32(_mm256_mul_ps(_mm256_loadu_ps(from), _mm256_set1_ps(inverse))) }
}

/// Sums of eight numbers each.
///
/// # Safety
/// The processor has AVX2.
#[inline(always)]
pub(super) unsafe fn across([a, b, c, d]: [__m256i; SERVED]) -> [i32; SERVED] {
    let mut sums = [0; SERVED];
    // SAFETY: AVX2 by this function's contract.
    unsafe {
        let all = _mm256_hadd_epi32(_mm256_hadd_epi32(a, b), _mm256_hadd_epi32(c, d));
        let high = _mm256_extracti128_si256::<1>(all);
        let all = _mm_add_epi32(_mm256_castsi256_si128(all), high);
        _mm_storeu_si128(sums.as_mut_ptr().cast(), all);
    }
    sums
}

impl Int8 for Vnni {
    const CHANNELS: usize = 8;
    const BYTES: usize = 1;
    const OFFSET: bool = true;
    const ROWS: usize = 6;
    const SUMS: usize = 12;
    const STEP: usize = 32;
    type Sums = __m256i;
    type Weights = __m256i;
    type X = __m256i;
    type Dot = __m256i;

    #[inline(always)]
    unsafe fn magnitudes(most: __m256i, from: *const f32) -> __m256i {
        // SAFETY: `Int8::magnitudes` asks for AVX2 and `STEP` = 32 numbers at `from`.
        unsafe {
            let ab = _mm256_max_epi32(magnitude(from), magnitude(from.add(8)));
            let cd = _mm256_max_epi32(magnitude(from.add(16)), magnitude(from.add(24)));
            _mm256_max_epi32(most, _mm256_max_epi32(ab, cd))
        }
    }

    #[inline(always)]
    unsafe fn most(x: __m256i) -> i32 {
        // SAFETY: `Int8::most` asks for AVX2.
        unsafe { most(x) }
    }

    #[inline(always)]
    unsafe fn quantise(
        correction: Self::Dot,
        from: *const f32,
        inverse: f32,
        to: *mut i8,
    ) -> Self::Dot {
        // SAFETY: `Int8::quantise` asks for AVX2, `STEP` = 32 numbers at `from` and room for as
        // many bytes at `to`.
        unsafe {
            let (a, b) = (round(from, inverse), round(from.add(8), inverse));
            let (c, d) = (round(from.add(16), inverse), round(from.add(24), inverse));
            let bytes = _mm256_packs_epi16(_mm256_packs_epi32(a, b), _mm256_packs_epi32(c, d));
            // Packing works within halves of 128 bits, and this restores the order.
            let order = _mm256_setr_epi32(0, 4, 1, 5, 2, 6, 3, 7);
            let bytes = _mm256_permutevar8x32_epi32(bytes, order);
            _mm256_storeu_si256(to.cast(), _mm256_xor_si256(bytes, _mm256_set1_epi8(-128)));
        }
        correction
    }

    #[inline(always)]
    unsafe fn start(from: *const i32, _: i32) -> __m256i {
        // SAFETY: `Int8::start` asks for AVX2 and `CHANNELS` = 8 numbers at `from`.
        unsafe {
            let offset = _mm256_slli_epi32::<7>(_mm256_loadu_si256(from.cast()));
            _mm256_sub_epi32(_mm256_setzero_si256(), offset)
        }
    }

    #[inline(always)]
    unsafe fn weights(from: *const i8) -> __m256i {
        // SAFETY: `Int8::weights` asks for AVX2 and 8 x 4 bytes at `from`.
        unsafe { _mm256_loadu_si256(from.cast()) }
    }

    #[inline(always)]
    unsafe fn x(from: *const i8) -> __m256i {
        // SAFETY: `Int8::x` asks for AVX2 and four bytes at `from`, which need no alignment here.
        unsafe { _mm256_set1_epi32(from.cast::<i32>().read_unaligned()) }
    }

    #[inline(always)]
    unsafe fn add(sums: __m256i, x: __m256i, weights: __m256i) -> __m256i {
        // SAFETY: `Int8::add` asks for the instructions of `Vnni`, AVX-VNNI among them.
        unsafe { _mm256_dpbusd_avx_epi32(sums, x, weights) }
    }

    #[inline(always)]
    unsafe fn finish(sums: __m256i, row_scale: f32, end: Epilogue, out: *mut f32) {
        // SAFETY: `Int8::finish` asks for AVX2, `CHANNELS` = 8 numbers at `end.scales` and at
        // `end.bias`, and room for as many at `out`: what this module's `finish` asks for.
        unsafe { finish(sums, row_scale, end, out) }
    }

    #[inline(always)]
    unsafe fn nothing() -> __m256i {
        // SAFETY: `Int8::nothing` asks for AVX2.
        unsafe { _mm256_setzero_si256() }
    }

    #[inline(always)]
    unsafe fn dot(sums: __m256i, x: *const i8, weights: *const i8) -> __m256i {
        // SAFETY: `Int8::dot` asks for the instructions of `Vnni`, AVX-VNNI among them, and 32
        // bytes at `x` and at `weights`.
        unsafe {
            let weights = _mm256_loadu_si256(weights.cast());
            _mm256_dpbusd_avx_epi32(sums, _mm256_loadu_si256(x.cast()), weights)
        }
    }

    #[inline(always)]
    unsafe fn across(sums: [__m256i; SERVED], weights: __m256i) -> [i32; SERVED] {
        // SAFETY: `Int8::across` asks for AVX2.
        unsafe {
            let offset = _mm256_slli_epi32::<7>(weights);
            let mut sums = sums;
            for sum in &mut sums {
                *sum = _mm256_sub_epi32(*sum, offset);
            }
            across(sums)
        }
    }
}

/// The instructions: AVX2 and F16C.
impl Wide for __m256 {
    const WIDTH: usize = 8;
    const LANES: usize = 2;
    const WEIGHED: usize = 2;

    unsafe fn tile(it: Tile) {
        /// # Safety
        /// As for [`wide::tile`].
        #[target_feature(enable = "avx2,f16c")]
        #[inline(never)]
        fn apart(it: Tile) {
            // SAFETY: the tile's pointers by this function's contract; it has the instructions itself.
            unsafe { wide::tile::<__m256>(it) }
        }
        // SAFETY: `Wide::tile` asks for AVX2 and F16C, which are what `apart` needs, and for what
        // `Tile` says.
        unsafe { apart(it) }
    }

    unsafe fn columns<W: Weight>(columns: *mut f32, of: Matrices<'_, W>) {
        /// # Safety
        /// As for [`wide::by_columns`].
        #[target_feature(enable = "avx2,f16c")]
        #[inline(never)]
        fn apart<W: Weight>(columns: *mut f32, of: Matrices<'_, W>) {
            // SAFETY: `columns` by this function's contract; it has the instructions itself.
            unsafe { wide::by_columns::<__m256, W>(columns, of) }
        }
        // SAFETY: `Wide::columns` asks for AVX2 and F16C, which are what `apart` needs, and for room at
        // `columns`.
        unsafe { apart(columns, of) }
    }

    #[inline(always)]
    unsafe fn zero() -> Self {
        // SAFETY: `Wide::zero` asks for AVX2.
        unsafe { _mm256_setzero_ps() }
    }

    #[inline(always)]
    unsafe fn splat(x: *const f32) -> Self {
        // SAFETY: `Wide::splat` asks for AVX2 and a number at `x`.
        unsafe { _mm256_set1_ps(*x) }
    }

    #[inline(always)]
    unsafe fn load(from: *const f32) -> Self {
        // SAFETY: `Wide::load` asks for AVX2 and `WIDTH` = 8 numbers at `from`.
        unsafe { _mm256_loadu_ps(from) }
    }

    #[inline(always)]
    unsafe fn store(self, to: *mut f32) {
        // SAFETY: `Wide::store` asks for AVX2 and room for `WIDTH` = 8 numbers at `to`.
        unsafe { _mm256_storeu_ps(to, self) }
    }

    #[inline(always)]
    unsafe fn add(self, other: Self) -> Self {
        // SAFETY: `Wide::add` asks for AVX2.
        unsafe { _mm256_add_ps(self, other) }
    }

    #[inline(always)]
    unsafe fn mul(self, other: Self) -> Self {
        // SAFETY: `Wide::mul` asks for AVX2.
        unsafe { _mm256_mul_ps(self, other) }
    }

    #[inline(always)]
    unsafe fn load_some(from: *const f32, count: usize, fill: Self) -> Self {
        let mut eight = [0.0_f32; 8];
        // SAFETY: `Wide::load_some` asks for AVX2 and `count` numbers at `from`, fewer than the
        // eight of the array.
        unsafe {
            _mm256_storeu_ps(eight.as_mut_ptr(), fill);
            for (i, to) in eight.iter_mut().enumerate().take(count) {
                *to = *from.add(i);
            }
            _mm256_loadu_ps(eight.as_ptr())
        }
    }

    #[inline(always)]
    unsafe fn store_some(self, to: *mut f32, count: usize) {
        let mut eight = [0.0_f32; 8];
        // SAFETY: `Wide::store_some` asks for AVX2 and room for `count` numbers at `to`, fewer than
        // the eight of the array.
        unsafe {
            _mm256_storeu_ps(eight.as_mut_ptr(), self);
            for (i, from) in eight.iter().enumerate().take(count) {
                *to.add(i) = *from;
            }
        }
    }

    #[inline(always)]
    unsafe fn sub(self, other: Self) -> Self {
        // SAFETY: `Wide::sub` asks for AVX2.
        unsafe { _mm256_sub_ps(self, other) }
    }

    #[inline(always)]
    unsafe fn div(self, other: Self) -> Self {
        // SAFETY: `Wide::div` asks for AVX2.
        unsafe { _mm256_div_ps(self, other) }
    }

    #[inline(always)]
    unsafe fn negative(self) -> Self {
        // SAFETY: `Wide::negative` asks for AVX2.
        unsafe { _mm256_xor_ps(self, _mm256_set1_ps(-0.0)) }
    }

    #[inline(always)]
    unsafe fn most(self, other: Self) -> Self {
        // SAFETY: `Wide::most` asks for AVX2. The instruction answers with its second operand.
        unsafe { _mm256_max_ps(other, self) }
    }

    #[inline(always)]
    unsafe fn least(self, other: Self) -> Self {
        // SAFETY: `Wide::least` asks for AVX2. The instruction answers with its second operand.
        unsafe { _mm256_min_ps(other, self) }
    }

    #[inline(always)]
    unsafe fn largest(self) -> f32 {
        // SAFETY: `Wide::largest` asks for AVX2.
        unsafe {
            let x = _mm_max_ps(_mm256_castps256_ps128(self), _mm256_extractf128_ps::<1>(self));
            let x = _mm_max_ps(x, _mm_movehl_ps(x, x));
            _mm_cvtss_f32(_mm_max_ss(x, _mm_shuffle_ps::<1>(x, x)))
        }
    }

    #[inline(always)]
    unsafe fn power(self) -> Self {
        // SAFETY: `Wide::power` asks for AVX2.
        unsafe {
            let exponent = _mm256_slli_epi32::<23>(_mm256_castps_si256(self));
            let one = _mm256_castps_si256(_mm256_set1_ps(1.0));
            _mm256_castsi256_ps(_mm256_add_epi32(exponent, one))
        }
    }
}
