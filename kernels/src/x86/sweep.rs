//! Sweeps of impulses, as many contacts at a time as a register of AVX has numbers. Larger blocks would have more lanes left over.

use std::arch::x86_64::*;

use rigidformer_core::kernels::{Block, Goal, Lane, Motion, Vector, WIDE};

/// As `Kernels::sweep`.
///
/// # Safety
/// The processor has AVX.
#[inline(always)]
pub(super) unsafe fn sweep(
    blocks: &mut [Block],
    motions: &mut [Motion],
    aim: (Goal, bool),
) -> bool {
    rigidformer_core::kernels::sweep::<Eight>(blocks, motions, aim)
}

/// Numbers in a register. Only [`sweep`] makes them, whose contract is that the processor has AVX.
#[derive(Clone, Copy)]
struct Eight(__m256);

impl Vector for Eight {
    const WIDTH: usize = WIDE;
    type Mask = __m256;

    #[inline(always)]
    fn load(from: &Lane, _: usize) -> Self {
        // SAFETY: the processor has AVX, see the type; a lane has eight numbers, of any alignment.
        Eight(unsafe { _mm256_loadu_ps(from.as_ptr()) })
    }

    #[inline(always)]
    fn store(self, to: &mut Lane, _: usize) {
        // SAFETY: as in `load`.
        unsafe { _mm256_storeu_ps(to.as_mut_ptr(), self.0) }
    }

    #[inline(always)]
    fn splat(x: f32) -> Self {
        // SAFETY: the processor has AVX, see the type.
        Eight(unsafe { _mm256_set1_ps(x) })
    }

    #[inline(always)]
    fn plus(self, other: Self) -> Self {
        // SAFETY: as in `splat`.
        Eight(unsafe { _mm256_add_ps(self.0, other.0) })
    }

    #[inline(always)]
    fn minus(self, other: Self) -> Self {
        // SAFETY: as in `splat`.
        Eight(unsafe { _mm256_sub_ps(self.0, other.0) })
    }

    #[inline(always)]
    fn times(self, other: Self) -> Self {
        // SAFETY: as in `splat`.
        Eight(unsafe { _mm256_mul_ps(self.0, other.0) })
    }

    #[inline(always)]
    fn over(self, other: Self) -> Self {
        // SAFETY: as in `splat`.
        Eight(unsafe { _mm256_div_ps(self.0, other.0) })
    }

    #[inline(always)]
    fn root(self) -> Self {
        // SAFETY: as in `splat`.
        Eight(unsafe { _mm256_sqrt_ps(self.0) })
    }

    #[inline(always)]
    fn above(self, other: Self) -> __m256 {
        // SAFETY: as in `splat`.
        unsafe { _mm256_cmp_ps::<_CMP_GT_OQ>(self.0, other.0) }
    }

    #[inline(always)]
    fn choose(mask: __m256, yes: Self, no: Self) -> Self {
        // SAFETY: as in `splat`.
        Eight(unsafe { _mm256_blendv_ps(no.0, yes.0, mask) })
    }

    #[inline(always)]
    fn any(mask: __m256) -> bool {
        // SAFETY: as in `splat`.
        unsafe { _mm256_movemask_ps(mask) != 0 }
    }
}

const _: () = assert!(WIDE * size_of::<f32>() == size_of::<__m256>(), "a lane is a register");
