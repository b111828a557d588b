//! Products of int8 by SDOT, in assembly: the intrinsics are not stable.
#![allow(unsafe_code)]

use std::arch::aarch64::*;
use std::arch::asm;

use super::int8::{GROUP, Int8};

/// Four products of each of four channels an instruction. The instructions: NEON and the dot product instructions, and SMMLA where
/// `MATRICES` says so.
pub(super) struct Dot<const MATRICES: bool>;

/// Adds the products of four channels' weights and the activations of a lane.
///
/// # Safety
/// The processor has the dot product instructions.
#[inline(always)]
unsafe fn sdot_lane<const LANE: usize>(
    mut sums: int32x4_t,
    weights: int8x16_t,
    x: int8x16_t,
) -> int32x4_t {
    // SAFETY: the instruction by this function's contract; it works on registers alone.
    unsafe {
        asm!(
            "sdot {sums:v}.4s, {weights:v}.16b, {x:v}.4b[{lane}]",
            sums = inout(vreg) sums,
            weights = in(vreg) weights,
            x = in(vreg) x,
            lane = const LANE,
            options(pure, nomem, nostack, preserves_flags),
        );
    }
    sums
}

/// Adds the products of a group, whose activations are in a lane.
///
/// # Safety
/// The processor has NEON and the dot product instructions, and [`GROUP`] bytes may be read from
/// `weights` on.
#[inline(always)]
unsafe fn add_group<const LANE: usize, const ROWS: usize>(
    sums: &mut [[int32x4_t; 4]; ROWS],
    x: [int8x16_t; ROWS],
    weights: *const i8,
) {
    // SAFETY: the instructions by this function's contract; 16 bytes are read at each quarter of
    // the group.
    unsafe {
        for quarter in 0..4 {
            let weights = vld1q_s8(weights.add(16 * quarter));
            for (sums, x) in sums.iter_mut().zip(x) {
                sums[quarter] = sdot_lane::<LANE>(sums[quarter], weights, x);
            }
        }
    }
}

impl<const M: bool> Int8 for Dot<M> {
    const MATRICES: bool = M;
    const ROWS: usize = 6;
    const CHAINED: bool = true;
    const STEP: usize = 4;
    /// Four channels a register.
    type Sums = [int32x4_t; 4];
    /// A group a lane.
    type X = int8x16_t;

    #[inline(always)]
    unsafe fn zero() -> [int32x4_t; 4] {
        // SAFETY: `Int8::zero` asks for NEON.
        unsafe { [vdupq_n_s32(0); 4] }
    }

    #[inline(always)]
    unsafe fn x(from: *const i8) -> int8x16_t {
        // SAFETY: `Int8::x` asks for NEON and `STEP` x 4 = 16 bytes at `from`.
        unsafe { vld1q_s8(from) }
    }

    #[inline(always)]
    unsafe fn x_of_group(from: *const i8) -> int8x16_t {
        // SAFETY: `Int8::x_of_group` asks for NEON and four bytes at `from`, which need no
        // alignment here.
        unsafe { vreinterpretq_s8_s32(vdupq_n_s32(from.cast::<i32>().read_unaligned())) }
    }

    #[inline(always)]
    unsafe fn step<const ROWS: usize, const CHAINS: usize>(
        sums: &mut [[[int32x4_t; 4]; ROWS]; CHAINS],
        x: [int8x16_t; ROWS],
        weights: *const i8,
    ) {
        // SAFETY: `Int8::step` asks for the instructions of `Dot` and `STEP` = 4 groups at
        // `weights`.
        unsafe {
            add_group::<0, ROWS>(&mut sums[0], x, weights);
            add_group::<1, ROWS>(&mut sums[1 % CHAINS], x, weights.add(GROUP));
            add_group::<2, ROWS>(&mut sums[2 % CHAINS], x, weights.add(2 * GROUP));
            add_group::<3, ROWS>(&mut sums[3 % CHAINS], x, weights.add(3 * GROUP));
        }
    }

    #[inline(always)]
    unsafe fn group<const ROWS: usize>(
        sums: &mut [[int32x4_t; 4]; ROWS],
        x: [int8x16_t; ROWS],
        weights: *const i8,
    ) {
        // SAFETY: `Int8::group` asks for the instructions of `Dot` and a group at `weights`.
        unsafe { add_group::<0, ROWS>(sums, x, weights) }
    }

    #[inline(always)]
    unsafe fn join(a: [int32x4_t; 4], b: [int32x4_t; 4]) -> [int32x4_t; 4] {
        // SAFETY: `Int8::join` asks for NEON.
        std::array::from_fn(|i| unsafe { vaddq_s32(a[i], b[i]) })
    }

    #[inline(always)]
    unsafe fn finish(sums: [int32x4_t; 4]) -> [int32x4_t; 4] {
        sums
    }

    #[inline(always)]
    unsafe fn dot(mut sum: int32x4_t, x: int8x16_t, weights: int8x16_t) -> int32x4_t {
        // SAFETY: `Int8::dot` asks for the instructions of `Dot`; this one works on registers alone.
        unsafe {
            asm!(
                "sdot {sum:v}.4s, {weights:v}.16b, {x:v}.16b",
                sum = inout(vreg) sum,
                weights = in(vreg) weights,
                x = in(vreg) x,
                options(pure, nomem, nostack, preserves_flags),
            );
        }
        sum
    }
}
