//! AVX2 without VNNI: products of int8 by VPMADDUBSW, which multiplies bytes without a sign by bytes with one.
//!
//! An activation x is kept as its magnitude |x|, and as s: 0, or -1 where x is negative. w ^ s is w, or -w - 1, so
//! x w = |x| (w ^ s) + |x| for a negative x, and |x| w for others. The magnitudes of a row's negative activations are
//! summed once, for all channels. Nothing saturates: |x| is at most 127, because rows are quantised to that, and w ^ s
//! is within -128 and 127 for any w, so that two products are within 32,512.

use std::arch::x86_64::*;

use super::avx2::{across, finish, magnitude, most, round};
use super::int8::{Epilogue, Int8, SERVED};

/// Products of int8 by VPMADDUBSW. The instructions: AVX2.
pub(super) struct Bytes;

/// Adds the sums of four products each.
///
/// # Safety
/// The processor has AVX2.
#[inline(always)]
unsafe fn add(sums: __m256i, magnitudes: __m256i, weights: __m256i) -> __m256i {
    // SAFETY: AVX2 by this function's contract.
    unsafe {
        let pairs = _mm256_maddubs_epi16(magnitudes, weights);
        _mm256_add_epi32(sums, _mm256_madd_epi16(pairs, _mm256_set1_epi16(1)))
    }
}

impl Int8 for Bytes {
    const CHANNELS: usize = 8;
    /// Four magnitudes, then the signs of these.
    const BYTES: usize = 2;
    /// The sum of a row's negative activations, without its sign.
    const END: usize = 4;
    const OFFSET: bool = false;
    // Ten sums, two units of weights, an activation's two registers, ones and a product: all 16 registers.
    const ROWS: usize = 5;
    const SUMS: usize = 10;
    const STEP: usize = 32;
    type Sums = __m256i;
    type Weights = __m256i;
    /// Magnitudes and signs.
    type X = [__m256i; 2];
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
        correction: __m256i,
        from: *const f32,
        inverse: f32,
        to: *mut i8,
    ) -> __m256i {
        // SAFETY: `Int8::quantise` asks for AVX2, `STEP` = 32 numbers at `from` and room for twice
        // as many bytes at `to`.
        unsafe {
            let (a, b) = (round(from, inverse), round(from.add(8), inverse));
            let (c, d) = (round(from.add(16), inverse), round(from.add(24), inverse));
            let bytes = _mm256_packs_epi16(_mm256_packs_epi32(a, b), _mm256_packs_epi32(c, d));
            // Packing and interleaving work within halves of 128 bits: groups 0 1 4 5 2 3 6 7.
            let order = _mm256_setr_epi32(0, 4, 2, 6, 1, 5, 3, 7);
            let bytes = _mm256_permutevar8x32_epi32(bytes, order);
            let magnitudes = _mm256_abs_epi8(bytes);
            let signs = _mm256_cmpgt_epi8(_mm256_setzero_si256(), bytes);
            _mm256_storeu_si256(to.cast(), _mm256_unpacklo_epi32(magnitudes, signs));
            _mm256_storeu_si256(to.add(32).cast(), _mm256_unpackhi_epi32(magnitudes, signs));
            add(correction, magnitudes, signs)
        }
    }

    #[inline(always)]
    unsafe fn write_correction(correction: __m256i, end: *mut i8) {
        // SAFETY: `Int8::write_correction` asks for AVX2 and room for `END` = 4 bytes at `end`,
        // which need no alignment here.
        unsafe {
            let zero = _mm256_setzero_si256();
            let [sum, ..] = across([correction, zero, zero, zero]);
            // The signs are -1.
            end.cast::<i32>().write_unaligned(sum.wrapping_neg());
        }
    }

    #[inline(always)]
    unsafe fn correction(end: *const i8) -> i32 {
        // SAFETY: `Int8::correction` asks for `END` = 4 bytes at `end`, which need no alignment here.
        unsafe { end.cast::<i32>().read_unaligned() }
    }

    #[inline(always)]
    unsafe fn start(_: *const i32, correction: i32) -> __m256i {
        // SAFETY: `Int8::start` asks for AVX2.
        unsafe { _mm256_set1_epi32(correction) }
    }

    #[inline(always)]
    unsafe fn weights(from: *const i8) -> __m256i {
        // SAFETY: `Int8::weights` asks for AVX2 and 8 x 4 bytes at `from`.
        unsafe { _mm256_loadu_si256(from.cast()) }
    }

    #[inline(always)]
    unsafe fn x(from: *const i8) -> [__m256i; 2] {
        // SAFETY: `Int8::x` asks for AVX2 and four activations of two bytes at `from`, which need
        // no alignment here.
        unsafe {
            let from = from.cast::<i32>();
            let signs = from.add(1).read_unaligned();
            [_mm256_set1_epi32(from.read_unaligned()), _mm256_set1_epi32(signs)]
        }
    }

    #[inline(always)]
    unsafe fn add(sums: __m256i, [magnitudes, signs]: [__m256i; 2], weights: __m256i) -> __m256i {
        // SAFETY: `Int8::add` asks for AVX2.
        unsafe { add(sums, magnitudes, _mm256_xor_si256(weights, signs)) }
    }

    #[inline(always)]
    unsafe fn finish(sums: __m256i, row_scale: f32, end: Epilogue, out: *mut f32) {
        // SAFETY: `Int8::finish` asks for AVX2, `CHANNELS` = 8 numbers at `end.scales` and at
        // `end.bias`, and room for as many at `out`: what `avx2::finish` asks for.
        unsafe { finish(sums, row_scale, end, out) }
    }

    #[inline(always)]
    unsafe fn nothing() -> __m256i {
        // SAFETY: `Int8::nothing` asks for AVX2.
        unsafe { _mm256_setzero_si256() }
    }

    #[inline(always)]
    unsafe fn dot(sums: __m256i, x: *const i8, weights: *const i8) -> __m256i {
        // SAFETY: `Int8::dot` asks for AVX2, 32 x 2 bytes at `x` and 32 at `weights`.
        unsafe {
            let low = _mm256_castsi256_ps(_mm256_loadu_si256(x.cast()));
            let high = _mm256_castsi256_ps(_mm256_loadu_si256(x.add(32).cast()));
            let magnitudes = _mm256_castps_si256(_mm256_shuffle_ps::<0b10_00_10_00>(low, high));
            let signs = _mm256_castps_si256(_mm256_shuffle_ps::<0b11_01_11_01>(low, high));
            // Groups 0 1 4 5 2 3 6 7, as the shuffles leave the activations.
            let weights = _mm256_loadu_si256(weights.cast());
            let weights = _mm256_permute4x64_epi64::<0b11_01_10_00>(weights);
            Self::add(sums, [magnitudes, signs], weights)
        }
    }

    #[inline(always)]
    unsafe fn across(sums: [__m256i; SERVED], _: __m256i) -> [i32; SERVED] {
        // SAFETY: `Int8::across` asks for AVX2.
        unsafe { across(sums) }
    }
}
