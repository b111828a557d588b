//! AVX-512: registers of 16 numbers, 32 of them.

use std::arch::x86_64::*;

use super::avx2;
use super::int8::{Epilogue, Int8, SERVED};
use super::wide::{self, Matrices, Tile, Weight, Wide};

/// Products of int8 by VPDPBUSD, activations with 128 added. The instructions: AVX-512 F, BW and VNNI, and AVX2. `MATRICES` says
/// that AMX is there, for products that are done sooner by it.
pub(super) struct Vnni<const MATRICES: bool>;

impl<const MATRICES: bool> Int8 for Vnni<MATRICES> {
    const MATRICES: bool = MATRICES;
    const CHANNELS: usize = 16;
    const BYTES: usize = 1;
    const OFFSET: bool = true;
    const ROWS: usize = 13;
    const SUMS: usize = 26;
    const STEP: usize = 64;
    type Sums = __m512i;
    type Weights = __m512i;
    type X = __m512i;
    type Dot = __m512i;

    #[inline(always)]
    unsafe fn magnitudes(most: __m512i, from: *const f32) -> __m512i {
        // SAFETY: `Int8::magnitudes` asks for AVX-512 and `STEP` = 64 numbers at `from`.
        unsafe {
            let sign = _mm512_set1_epi32(i32::MAX);
            let load = |at| _mm512_and_si512(_mm512_loadu_si512(from.add(at).cast()), sign);
            let [a, b, c, d] = [load(0), load(16), load(32), load(48)];
            let (ab, cd) = (_mm512_max_epi32(a, b), _mm512_max_epi32(c, d));
            _mm512_max_epi32(most, _mm512_max_epi32(ab, cd))
        }
    }

    #[inline(always)]
    unsafe fn most(most: __m512i) -> i32 {
        // SAFETY: `Int8::most` asks for AVX-512.
        unsafe { _mm512_reduce_max_epi32(most) }
    }

    #[inline(always)]
    unsafe fn quantise(
        correction: Self::Dot,
        from: *const f32,
        inverse: f32,
        to: *mut i8,
    ) -> Self::Dot {
        // SAFETY: `Int8::quantise` asks for AVX-512 BW, `STEP` = 64 numbers at `from` and room for
        // as many bytes at `to`.
        unsafe {
            let inverse = _mm512_set1_ps(inverse);
            let round =
                |at| _mm512_cvtps_epi32(_mm512_mul_ps(_mm512_loadu_ps(from.add(at)), inverse));
            let (a, b, c, d) = (round(0), round(16), round(32), round(48));
            let bytes = _mm512_packs_epi16(_mm512_packs_epi32(a, b), _mm512_packs_epi32(c, d));
            // Packing works within quarters of 128 bits, and this restores the order.
            let order = _mm512_setr_epi32(0, 4, 8, 12, 1, 5, 9, 13, 2, 6, 10, 14, 3, 7, 11, 15);
            let bytes = _mm512_permutexvar_epi32(order, bytes);
            _mm512_storeu_si512(to.cast(), _mm512_xor_si512(bytes, _mm512_set1_epi8(-128)));
        }
        correction
    }

    #[inline(always)]
    unsafe fn start(from: *const i32, _: i32) -> __m512i {
        // SAFETY: `Int8::start` asks for AVX-512 and `CHANNELS` = 16 numbers at `from`.
        unsafe {
            let offset = _mm512_slli_epi32::<7>(_mm512_loadu_si512(from.cast()));
            _mm512_sub_epi32(_mm512_setzero_si512(), offset)
        }
    }

    #[inline(always)]
    unsafe fn weights(from: *const i8) -> __m512i {
        // SAFETY: `Int8::weights` asks for AVX-512 and 16 x 4 bytes at `from`.
        unsafe { _mm512_loadu_si512(from.cast()) }
    }

    #[inline(always)]
    unsafe fn x(from: *const i8) -> __m512i {
        // SAFETY: `Int8::x` asks for AVX-512 and four bytes at `from`, which need no alignment
        // here.
        unsafe { _mm512_set1_epi32(from.cast::<i32>().read_unaligned()) }
    }

    #[inline(always)]
    unsafe fn add(sums: __m512i, x: __m512i, weights: __m512i) -> __m512i {
        // SAFETY: `Int8::add` asks for AVX-512 VNNI.
        unsafe { _mm512_dpbusd_epi32(sums, x, weights) }
    }

    #[inline(always)]
    unsafe fn finish(sums: __m512i, row_scale: f32, end: Epilogue, out: *mut f32) {
        // SAFETY: `Int8::finish` asks for AVX-512, `CHANNELS` = 16 numbers at `end.scales` and at
        // `end.bias`, and room for as many at `out`.
        unsafe {
            let scale = _mm512_mul_ps(_mm512_set1_ps(row_scale), _mm512_loadu_ps(end.scales));
            let x = _mm512_mul_ps(_mm512_cvtepi32_ps(sums), scale);
            _mm512_storeu_ps(out, _mm512_add_ps(x, _mm512_loadu_ps(end.bias)));
        }
    }

    #[inline(always)]
    unsafe fn nothing() -> __m512i {
        // SAFETY: `Int8::nothing` asks for AVX-512.
        unsafe { _mm512_setzero_si512() }
    }

    #[inline(always)]
    unsafe fn dot(sums: __m512i, x: *const i8, weights: *const i8) -> __m512i {
        // SAFETY: `Int8::dot` asks for AVX-512 VNNI, and 64 bytes at `x` and at `weights`.
        unsafe {
            let weights = _mm512_loadu_si512(weights.cast());
            _mm512_dpbusd_epi32(sums, _mm512_loadu_si512(x.cast()), weights)
        }
    }

    #[inline(always)]
    unsafe fn across(sums: [__m512i; SERVED], weights: __m512i) -> [i32; SERVED] {
        // SAFETY: `Int8::across` asks for AVX-512, and AVX2, which `avx2::across` needs.
        unsafe {
            let mut halves = [_mm256_setzero_si256(); SERVED];
            let offset = _mm512_slli_epi32::<7>(weights);
            for (half, sum) in halves.iter_mut().zip(sums) {
                let sum = _mm512_sub_epi32(sum, offset);
                let high = _mm512_extracti64x4_epi64::<1>(sum);
                *half = _mm256_add_epi32(_mm512_castsi512_si256(sum), high);
            }
            avx2::across(halves)
        }
    }
}

/// The instructions: AVX-512 F, DQ and VL, AVX2 and F16C.
impl Wide for __m512 {
    const WIDTH: usize = 16;
    const LANES: usize = 4;
    const WEIGHED: usize = 4;

    unsafe fn tile(it: Tile) {
        /// # Safety
        /// As for [`wide::tile`].
        #[target_feature(enable = "avx512f,avx512dq,avx512vl,f16c")]
        #[inline(never)]
        fn apart(it: Tile) {
            // SAFETY: the tile's pointers by this function's contract; it has the instructions itself.
            unsafe { wide::tile::<__m512>(it) }
        }
        // SAFETY: `Wide::tile` asks for AVX-512 F, DQ and VL and F16C, which are what `apart`
        // needs, and for what `Tile` says.
        unsafe { apart(it) }
    }

    unsafe fn columns<W: Weight>(columns: *mut f32, of: Matrices<'_, W>) {
        /// # Safety
        /// As for [`wide::by_columns`].
        #[target_feature(enable = "avx512f,avx512dq,avx512vl,f16c")]
        #[inline(never)]
        fn apart<W: Weight>(columns: *mut f32, of: Matrices<'_, W>) {
            // SAFETY: `columns` by this function's contract; it has the instructions itself.
            unsafe { wide::by_columns::<__m512, W>(columns, of) }
        }
        // SAFETY: `Wide::columns` asks for AVX-512 F, DQ and VL and F16C, which are what `apart` needs, and for room at
        // `columns`.
        unsafe { apart(columns, of) }
    }

    #[inline(always)]
    unsafe fn zero() -> Self {
        // SAFETY: `Wide::zero` asks for AVX-512.
        unsafe { _mm512_setzero_ps() }
    }

    #[inline(always)]
    unsafe fn splat(x: *const f32) -> Self {
        // SAFETY: `Wide::splat` asks for AVX-512 and a number at `x`.
        unsafe { _mm512_set1_ps(*x) }
    }

    #[inline(always)]
    unsafe fn load(from: *const f32) -> Self {
        // SAFETY: `Wide::load` asks for AVX-512 and `WIDTH` = 16 numbers at `from`.
        unsafe { _mm512_loadu_ps(from) }
    }

    #[inline(always)]
    unsafe fn store(self, to: *mut f32) {
        // SAFETY: `Wide::store` asks for AVX-512 and room for `WIDTH` = 16 numbers at `to`.
        unsafe { _mm512_storeu_ps(to, self) }
    }

    #[inline(always)]
    unsafe fn add(self, other: Self) -> Self {
        // SAFETY: `Wide::add` asks for AVX-512.
        unsafe { _mm512_add_ps(self, other) }
    }

    #[inline(always)]
    unsafe fn mul(self, other: Self) -> Self {
        // SAFETY: `Wide::mul` asks for AVX-512.
        unsafe { _mm512_mul_ps(self, other) }
    }

    #[inline(always)]
    unsafe fn load_some(from: *const f32, count: usize, fill: Self) -> Self {
        // SAFETY: `Wide::load_some` asks for AVX-512 and `count` numbers at `from`, fewer than 16;
        // others are not read.
        unsafe { _mm512_mask_loadu_ps(fill, (1 << count) - 1, from) }
    }

    #[inline(always)]
    unsafe fn store_some(self, to: *mut f32, count: usize) {
        // SAFETY: `Wide::store_some` asks for AVX-512 and room for `count` numbers at `to`, fewer
        // than 16; others are not written.
        unsafe { _mm512_mask_storeu_ps(to, (1 << count) - 1, self) }
    }

    #[inline(always)]
    unsafe fn sub(self, other: Self) -> Self {
        // SAFETY: `Wide::sub` asks for AVX-512.
        unsafe { _mm512_sub_ps(self, other) }
    }

    #[inline(always)]
    unsafe fn div(self, other: Self) -> Self {
        // SAFETY: `Wide::div` asks for AVX-512.
        unsafe { _mm512_div_ps(self, other) }
    }

    #[inline(always)]
    unsafe fn negative(self) -> Self {
        // SAFETY: `Wide::negative` asks for AVX-512 DQ.
        unsafe { _mm512_xor_ps(self, _mm512_set1_ps(-0.0)) }
    }

    #[inline(always)]
    unsafe fn most(self, other: Self) -> Self {
        // SAFETY: `Wide::most` asks for AVX-512. The instruction answers with its second operand.
        unsafe { _mm512_max_ps(other, self) }
    }

    #[inline(always)]
    unsafe fn least(self, other: Self) -> Self {
        // SAFETY: `Wide::least` asks for AVX-512. The instruction answers with its second operand.
        unsafe { _mm512_min_ps(other, self) }
    }

    #[inline(always)]
    unsafe fn largest(self) -> f32 {
        // SAFETY: `Wide::largest` asks for AVX-512 DQ, and AVX2 and F16C, which `__m256` names.
        unsafe {
            _mm256_max_ps(_mm512_castps512_ps256(self), _mm512_extractf32x8_ps::<1>(self)).largest()
        }
    }

    #[inline(always)]
    unsafe fn power(self) -> Self {
        // SAFETY: `Wide::power` asks for AVX-512.
        unsafe {
            let exponent = _mm512_slli_epi32::<23>(_mm512_castps_si512(self));
            let one = _mm512_castps_si512(_mm512_set1_ps(1.0));
            _mm512_castsi512_ps(_mm512_add_epi32(exponent, one))
        }
    }
}
