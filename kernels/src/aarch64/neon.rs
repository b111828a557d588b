//! Products of int8 by SMULL, SMLAL and SADALP: two products fit into 16 bits, 2 x 127 x 127 = 32,258.
#![allow(unsafe_code)]

use std::arch::aarch64::*;
use std::arch::asm;

use super::int8::{GROUP, Int8};

/// Pairs of products in 16 bits. The instructions: NEON.
pub(super) struct Pairs;

/// Four activations in every lane. In assembly, because the compiler, where it knows that the halves are equal, takes SMULL
/// of a half of the weights instead of SMULL2, and moves that half first.
///
/// # Safety
/// The processor has NEON, and four bytes may be read from `from` on.
#[inline(always)]
unsafe fn four_times(from: *const i8) -> int8x16_t {
    let four: int8x16_t;
    // SAFETY: by this function's contract NEON and four bytes at `from`; LD1R takes any address.
    unsafe {
        asm!(
            "ld1r {{{four:v}.4s}}, [{from}]",
            four = out(vreg) four,
            from = in(reg) from,
            options(pure, readonly, nostack, preserves_flags),
        );
    }
    four
}

/// Adds pairs of 16 products to four sums of two channels each, twice.
///
/// # Safety
/// The processor has NEON.
#[inline(always)]
unsafe fn add(sums: &mut [int32x4_t], [low, high]: [int16x8_t; 2]) {
    // SAFETY: NEON by this function's contract; registers alone.
    unsafe {
        if let [a, b] = sums {
            (*a, *b) = (vpadalq_s16(*a, low), vpadalq_s16(*b, high));
        }
    }
}

/// Products of two registers.
///
/// # Safety
/// The processor has NEON.
#[inline(always)]
unsafe fn products(x: int8x16_t, weights: int8x16_t) -> [int16x8_t; 2] {
    // SAFETY: NEON by this function's contract; registers alone.
    unsafe { [vmull_s8(vget_low_s8(weights), vget_low_s8(x)), vmull_high_s8(weights, x)] }
}

impl Int8 for Pairs {
    const ROWS: usize = 2;
    const CHAINED: bool = false;
    const STEP: usize = 2;
    /// Two sums of each of two channels a register.
    type Sums = [int32x4_t; 8];
    /// Four activations in every lane, for each group.
    type X = [int8x16_t; 2];

    #[inline(always)]
    unsafe fn zero() -> [int32x4_t; 8] {
        // SAFETY: `Int8::zero` asks for NEON.
        unsafe { [vdupq_n_s32(0); 8] }
    }

    #[inline(always)]
    unsafe fn x(from: *const i8) -> [int8x16_t; 2] {
        // SAFETY: `Int8::x` asks for NEON and `STEP` x 4 = 8 bytes at `from`.
        unsafe { [four_times(from), four_times(from.add(4))] }
    }

    #[inline(always)]
    unsafe fn x_of_group(from: *const i8) -> [int8x16_t; 2] {
        // SAFETY: `Int8::x_of_group` asks for NEON and four bytes at `from`.
        unsafe { [four_times(from); 2] }
    }

    #[inline(always)]
    unsafe fn step<const ROWS: usize, const CHAINS: usize>(
        sums: &mut [[[int32x4_t; 8]; ROWS]; CHAINS],
        x: [[int8x16_t; 2]; ROWS],
        weights: *const i8,
    ) {
        // SAFETY: `Int8::step` asks for NEON and `STEP` = 2 groups at `weights`, of which 16 bytes
        // are read at each quarter.
        unsafe {
            for quarter in 0..4 {
                let first = vld1q_s8(weights.add(16 * quarter));
                let second = vld1q_s8(weights.add(GROUP + 16 * quarter));
                for (sums, [x, next]) in sums[0].iter_mut().zip(x) {
                    let [low, high] = products(x, first);
                    let low = vmlal_s8(low, vget_low_s8(second), vget_low_s8(next));
                    let high = vmlal_high_s8(high, second, next);
                    add(&mut sums[2 * quarter..2 * quarter + 2], [low, high]);
                }
            }
        }
    }

    #[inline(always)]
    unsafe fn group<const ROWS: usize>(
        sums: &mut [[int32x4_t; 8]; ROWS],
        x: [[int8x16_t; 2]; ROWS],
        weights: *const i8,
    ) {
        // SAFETY: `Int8::group` asks for NEON and a group at `weights`, of which 16 bytes are read
        // at each quarter.
        unsafe {
            for quarter in 0..4 {
                let weights = vld1q_s8(weights.add(16 * quarter));
                for (sums, [x, _]) in sums.iter_mut().zip(x) {
                    add(&mut sums[2 * quarter..2 * quarter + 2], products(x, weights));
                }
            }
        }
    }

    #[inline(always)]
    unsafe fn join(a: [int32x4_t; 8], b: [int32x4_t; 8]) -> [int32x4_t; 8] {
        // SAFETY: `Int8::join` asks for NEON.
        std::array::from_fn(|i| unsafe { vaddq_s32(a[i], b[i]) })
    }

    #[inline(always)]
    unsafe fn finish([a, b, c, d, e, f, g, h]: [int32x4_t; 8]) -> [int32x4_t; 4] {
        // SAFETY: `Int8::finish` asks for NEON.
        unsafe { [vpaddq_s32(a, b), vpaddq_s32(c, d), vpaddq_s32(e, f), vpaddq_s32(g, h)] }
    }

    #[inline(always)]
    unsafe fn dot(sum: int32x4_t, x: int8x16_t, weights: int8x16_t) -> int32x4_t {
        // SAFETY: `Int8::dot` asks for NEON.
        unsafe {
            let products = vmull_s8(vget_low_s8(weights), vget_low_s8(x));
            vpadalq_s16(sum, vmlal_high_s8(products, weights, x))
        }
    }
}
