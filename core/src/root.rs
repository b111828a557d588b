//! The square root instruction of Cortex-M processors with an FPU.
#![allow(unsafe_code)]

/// Square root, correctly rounded.
pub(crate) fn sqrt(x: f32) -> f32 {
    // SAFETY: `vsqrt` computes in registers and has no other effect.
    unsafe { root(x) }
}

/// # Safety
/// The processor has a single-precision FPU: `build.rs` compiles this file for no other.
#[unsafe(naked)]
unsafe extern "C" fn root(x: f32) -> f32 {
    core::arch::naked_asm!(env!("RIGIDFORMER_ASSEMBLE_FOR"), "vsqrt.f32 s0, s0", "bx lr")
}
