//! Kernels for x86-64: one body for each loop, compiled once for each set of instructions.
//!
//! - `int8`: products of int8 matrices, over the instructions of `avx512`, `avx2` and `bytes`, and those of `amx` for whole matrices
//! - `wide`: products of f32 and f16 matrices and other loops that hold sums in registers
//! - `smooth`: what needs the exponential function
//! - `sweep`: impulses at several contacts
//! - `plain`: loops that the compiler makes vectors of by itself
//!
//! None of them uses fused multiply-add: it rounds once where the definition rounds twice.
#![allow(unsafe_code)]

mod amx;
mod attend;
mod avx2;
mod avx512;
mod bytes;
pub(crate) mod ceiling;
mod int8;
mod plain;
mod smooth;
mod sweep;
mod wide;

use std::arch::x86_64::{__m256, __m512};

use half::f16;
use rigidformer_core::geometry::Index;
use rigidformer_core::kernels::{
    Attention, Block, Goal, Lanes, Motion, Rows, TOGETHER, attend_together,
};
use rigidformer_core::quant::Scratch;
use rigidformer_core::weights::Panels;
use rigidformer_core::{ANCHORS, Kernels};

use crate::columns::Columns;
use crate::host::{HostKernels, Quantised};
use int8::Int8;

/// AVX-512 with VNNI: 64 products of 8-bit numbers an instruction.
#[derive(Clone, Copy, Debug)]
pub struct Avx512Vnni(());

/// AVX-512 with VNNI, and AMX for products that are large enough: 16,384 products of 8-bit numbers an instruction.
#[derive(Clone, Copy, Debug)]
pub struct Amx(());

/// AVX2 with VNNI: 32 products of 8-bit numbers an instruction.
#[derive(Clone, Copy, Debug)]
pub struct AvxVnni(());

/// AVX2: 32 products of 8-bit numbers in four instructions.
#[derive(Clone, Copy, Debug)]
pub struct Avx2(());

/// A kernel type, what it needs and what its products are made of.
macro_rules! kernels {
    ($type:ident, $name:literal, $features:literal, [$($feature:tt),*], $int8:ty, $wide:ty) => {
        impl $type {
            /// A value where this processor has the instructions.
            pub fn detect() -> Option<Self> {
                let found = $(is_x86_feature_detected!($feature))&&*;
                (found && (!<$int8>::MATRICES || amx::is_there())).then_some($type(()))
            }
        }

        impl Kernels for $type {
            const NAME: &'static str = $name;
            const QUERIES: usize = TOGETHER;
            const SWEEPS: bool = true;

            fn attend(self, attention: &Attention<'_>, scratch: &mut [f32], out: &mut [f32]) {
                attend_together(self, attention, scratch, out);
            }

            // Not compiled again: `multiply` is the largest body.
            fn linear_panels(
                self,
                scratch: &mut Scratch<'_>,
                weight: Panels<'_>,
                bias: &[f32],
                inputs: usize,
                out: &mut [f32],
            ) {
                let x = Quantised { values: scratch.values, scales: scratch.scales, inputs };
                self.multiply(x, weight, bias, Columns::new(out, weight.scales.len()));
            }

            kernels!(@ $features
                fn linear_f32(x: &[f32], weight: &[f32], bias: &[f32], inputs: usize, out: &mut [f32])
                    => wide::linear::<$wide, f32>;
                fn linear_f16(x: &[f32], weight: &[f16], bias: &[f32], inputs: usize, out: &mut [f32])
                    => wide::linear::<$wide, f16>;
                fn quantise(x: &[f32], inputs: usize, scratch: &mut Scratch<'_>)
                    => int8::quantise::<$int8>;
                fn linear_i8(scratch: &mut Scratch<'_>, weight: Rows<'_>, bias: &[f32], inputs: usize, out: &mut [f32])
                    => int8::linear::<$int8>;
                fn dot_f32(lhs: &[f32], rhs: &[f32]) -> f32 => wide::dot;
                fn scores(query: &[f32], keys: &[f32], stride: usize, scale: f32, out: &mut [f32])
                    => wide::scores;
                fn mix(weights: &[f32], values: &[f32], stride: usize, out: &mut [f32])
                    => wide::mix::<$wide>;
                fn mix_lanes(queries: &mut [Lanes], scores: &mut [Lanes], keys: &[f32], values: &[f32], stride: usize, scale: f32)
                    -> Lanes => attend::mix_lanes::<$wide>;
                fn exp(x: &mut [f32]) => smooth::exponential::<$wide>;
                fn rms_norm(x: &mut [f32], weight: &[f32], eps: f32) => wide::rms_norm;
                fn rotate(head: &mut [f32], cos: &[f32], sin: &[f32]) => plain::rotate;
                fn gate(x: &mut [f32], share: f32, gate: &[f32]) => smooth::gate::<$wide>;
                fn silu(x: &mut [f32]) => smooth::silu::<$wide>;
                fn normalise(x: &mut [f32], mean: &[f32], scale: &[f32], limit: f32) => plain::normalise;
                fn softmax(scores: &mut [f32]) -> f32 => smooth::softmax::<$wide>;
                fn nearest_of_leaf(index: &Index<'_>, row: usize, answers: &mut [f32]) => plain::nearest_of_leaf;
                fn sweep(blocks: &mut [Block], motions: &mut [Motion], aim: (Goal, bool)) -> bool
                    => sweep::sweep;
                fn pool(x: &[f32], largest: &mut [f32], sum: &mut [f32]) => plain::pool;
                fn weigh(x: &[f32], weights: &[[f32; ANCHORS]], out: &mut [f32]) => wide::weigh::<$wide>;
            );
        }

        impl HostKernels for $type {
            fn row_bytes(self, inputs: usize) -> usize {
                int8::row_bytes::<$int8>(inputs)
            }

            kernels!(@ $features
                fn multiply(x: Quantised<'_>, weight: Panels<'_>, bias: &[f32], out: Columns<'_>)
                    => int8::multiply::<$int8>;
            );
        }
    };
    (@ $features:literal $(
        fn $method:ident($($argument:ident: $kind:ty),*) $(-> $result:ty)? => $body:expr;
    )*) => {$(
        #[inline]
        fn $method(self, $($argument: $kind),*) $(-> $result)? {
            /// # Safety
            /// The processor has these features.
            #[target_feature(enable = $features)]
            fn compiled($($argument: $kind),*) $(-> $result)? {
                // SAFETY: the body asks for no more than instructions, which are among this function's features.
                unsafe { $body($($argument),*) }
            }
            // SAFETY: a value of this type is the proof that the processor has these features.
            unsafe { compiled($($argument),*) }
        }
    )*};
}

kernels!(
    Avx512Vnni,
    "avx512-vnni",
    "avx512f,avx512bw,avx512vl,avx512dq,avx512vnni,avx2,f16c",
    ["avx512f", "avx512bw", "avx512vl", "avx512dq", "avx512vnni", "avx2", "f16c"],
    avx512::Vnni<false>,
    __m512
);
kernels!(
    Amx,
    "amx",
    "avx512f,avx512bw,avx512vl,avx512dq,avx512vnni,avx2,f16c",
    ["avx512f", "avx512bw", "avx512vl", "avx512dq", "avx512vnni", "avx2", "f16c"],
    avx512::Vnni<true>,
    __m512
);
kernels!(AvxVnni, "avx-vnni", "avx2,avxvnni,f16c", ["avx2", "avxvnni", "f16c"], avx2::Vnni, __m256);
kernels!(Avx2, "avx2", "avx2,f16c", ["avx2", "f16c"], bytes::Bytes, __m256);
