//! AVX-512: registers of 16 numbers, 32 of them.

use std::arch::x86_64::*;

use super::int8::{Epilogue, Int8};
use super::wide::Wide;

/// Products of int8 by VPDPBUSD, activations with 128 added.
pub(super) struct Vnni;

impl Int8 for Vnni {
    const CHANNELS: usize = 16;
    const BYTES: usize = 1;
    const OFFSET: i32 = 128;
    const ROWS: usize = 13;
    const SUMS: usize = 26;
    const STEP: usize = 64;
    type Sums = __m512i;
    type Weights = __m512i;
    type X = __m512i;
    type Dot = __m512i;

    #[inline(always)]
    unsafe fn start(from: *const i32) -> __m512i {
        // SAFETY: the caller has AVX-512 and 16 numbers.
        unsafe { _mm512_loadu_si512(from.cast()) }
    }

    #[inline(always)]
    unsafe fn weights(from: *const i8) -> __m512i {
        // SAFETY: the caller has AVX-512 and 64 numbers.
        unsafe { _mm512_loadu_si512(from.cast()) }
    }

    #[inline(always)]
    unsafe fn x(from: *const i8) -> __m512i {
        // SAFETY: the caller has AVX-512 and four numbers.
        unsafe { _mm512_set1_epi32(from.cast::<i32>().read_unaligned()) }
    }

    #[inline(always)]
    unsafe fn add(sums: __m512i, x: __m512i, weights: __m512i) -> __m512i {
        // SAFETY: the caller has AVX-512 VNNI.
        unsafe { _mm512_dpbusd_epi32(sums, x, weights) }
    }

    #[inline(always)]
    unsafe fn finish(sums: __m512i, row_scale: f32, end: Epilogue, out: *mut f32, count: usize) {
        // SAFETY: the caller has AVX-512, 16 numbers of each and `count` of `out`.
        unsafe {
            let scale = _mm512_mul_ps(_mm512_set1_ps(row_scale), _mm512_loadu_ps(end.scales));
            let x = _mm512_mul_ps(_mm512_cvtepi32_ps(sums), scale);
            let x = _mm512_add_ps(x, _mm512_loadu_ps(end.bias));
            if count == 16 {
                _mm512_storeu_ps(out, x);
            } else {
                _mm512_mask_storeu_ps(out, (1 << count) - 1, x);
            }
        }
    }

    #[inline(always)]
    unsafe fn nothing() -> __m512i {
        // SAFETY: the caller has AVX-512.
        unsafe { _mm512_setzero_si512() }
    }

    #[inline(always)]
    unsafe fn dot(sums: __m512i, x: *const i8, weights: *const i8) -> __m512i {
        // SAFETY: the caller has AVX-512 VNNI and 64 numbers of each.
        unsafe {
            let weights = _mm512_loadu_si512(weights.cast());
            _mm512_dpbusd_epi32(sums, _mm512_loadu_si512(x.cast()), weights)
        }
    }

    #[inline(always)]
    unsafe fn across(sums: __m512i) -> i32 {
        // SAFETY: the caller has AVX-512.
        unsafe { _mm512_reduce_add_epi32(sums) }
    }
}

impl Wide for __m512 {
    const WIDTH: usize = 16;
    const LANES: usize = 4;
    const WEIGHED: usize = 4;

    #[inline(always)]
    unsafe fn zero() -> Self {
        // SAFETY: the caller has AVX-512.
        unsafe { _mm512_setzero_ps() }
    }

    #[inline(always)]
    unsafe fn splat(x: *const f32) -> Self {
        // SAFETY: the caller has AVX-512 and a number.
        unsafe { _mm512_set1_ps(*x) }
    }

    #[inline(always)]
    unsafe fn load(from: *const f32) -> Self {
        // SAFETY: the caller has AVX-512 and 16 numbers.
        unsafe { _mm512_loadu_ps(from) }
    }

    #[inline(always)]
    unsafe fn store(self, to: *mut f32) {
        // SAFETY: the caller has AVX-512 and room for 16 numbers.
        unsafe { _mm512_storeu_ps(to, self) }
    }

    #[inline(always)]
    unsafe fn add(self, other: Self) -> Self {
        // SAFETY: the caller has AVX-512.
        unsafe { _mm512_add_ps(self, other) }
    }

    #[inline(always)]
    unsafe fn mul(self, other: Self) -> Self {
        // SAFETY: the caller has AVX-512.
        unsafe { _mm512_mul_ps(self, other) }
    }
}
