//! Kernels for aarch64: NEON, which every such processor has, and SDOT and SMMLA, which are found at run time.
//!
//! - `int8`: products of int8 matrices, over the instructions of `neon` and `sdot`, and those of `smmla` for whole matrices
//! - `wide`: products of f32 and f16 matrices and other loops that hold sums in registers
//! - `plain`: loops that the compiler makes vectors of by itself, given a shape that suits it; those that it does well as
//!   they are defined are left to it
//!
//! None of them uses fused multiply-add: it rounds once where the definition rounds twice.
#![allow(unsafe_code)]

mod int8;
mod neon;
mod plain;
mod sdot;
mod smmla;
mod wide;

use std::arch::is_aarch64_feature_detected;

use half::f16;
use rigidformer_core::kernels::Rows;
use rigidformer_core::quant::Scratch;
use rigidformer_core::weights::Panels;
use rigidformer_core::{ANCHORS, Kernels};

use crate::columns::Columns;
use crate::host::{HostKernels, Quantised};

/// NEON: 16 products of 8-bit numbers in three instructions.
#[derive(Clone, Copy, Debug)]
pub struct Neon(());

/// SDOT of Armv8.2: 16 products of 8-bit numbers an instruction.
#[derive(Clone, Copy, Debug)]
pub struct Sdot(());

/// SDOT, and SMMLA of Armv8.6 for products that are large enough: 32 products of 8-bit numbers an instruction.
#[derive(Clone, Copy, Debug)]
pub struct Smmla(());

/// A kernel type, what it needs and what its products are made of.
macro_rules! kernels {
    ($type:ident, $name:literal, $features:literal, [$($feature:tt),*], $int8:ty) => {
        impl $type {
            /// A value where this processor has the instructions.
            pub fn detect() -> Option<Self> {
                let found = $(is_aarch64_feature_detected!($feature))&&*;
                found.then_some($type(()))
            }
        }

        impl Kernels for $type {
            const NAME: &'static str = $name;

            fn gate(self, x: &mut [f32], share: f32, gate: &[f32]) {
                plain::gate(x, share, gate);
            }

            fn silu(self, x: &mut [f32]) {
                plain::silu(x);
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
                    => wide::linear::<f32>;
                fn linear_f16(x: &[f32], weight: &[f16], bias: &[f32], inputs: usize, out: &mut [f32])
                    => wide::linear::<f16>;
                fn quantise(x: &[f32], inputs: usize, scratch: &mut Scratch<'_>) => int8::quantise;
                fn linear_i8(scratch: &mut Scratch<'_>, weight: Rows<'_>, bias: &[f32], inputs: usize, out: &mut [f32])
                    => int8::linear::<$int8>;
                fn dot_f32(lhs: &[f32], rhs: &[f32]) -> f32 => wide::dot;
                fn scores(query: &[f32], keys: &[f32], stride: usize, scale: f32, out: &mut [f32])
                    => wide::scores;
                fn mix(weights: &[f32], values: &[f32], stride: usize, out: &mut [f32]) => wide::mix;
                fn weigh(x: &[f32], weights: &[[f32; ANCHORS]], out: &mut [f32]) => wide::weigh;
            );
        }

        impl HostKernels for $type {
            fn row_bytes(self, inputs: usize) -> usize {
                int8::row_bytes(inputs)
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

kernels!(Neon, "neon", "neon", ["neon"], neon::Pairs);
kernels!(Sdot, "sdot", "neon,dotprod", ["neon", "dotprod"], sdot::Dot<false>);
kernels!(Smmla, "smmla", "neon,dotprod,i8mm", ["neon", "dotprod", "i8mm"], sdot::Dot<true>);
