//! What Helium tells of subnormal numbers.
//!
//! Helium takes subnormal numbers for zeros, whatever FPSCR says, and raises a flag where it does (IDC for an operand,
//! UFC for a result). Kernels whose results could differ for that look at the flags: where one is raised they leave
//! what they read as it was, and the portable arithmetic does the work. Flags are sticky, and scalar instructions raise
//! UFC too, so the kernel runs once more first, with its flags lowered.

use core::arch::naked_asm;

/// Flags of FPSCR: a subnormal operand (IDC) or result (UFC) was taken for zero.
pub(super) const FLUSHED: u32 = 1 << 7 | 1 << 3;
/// Flag of FPSCR: an operand was no number where a number was needed (IOC).
pub(super) const INVALID: u32 = 1;

/// The result in the low half of what a kernel returns, FPSCR being the high one; none where subnormal numbers were
/// taken for zeros. The kernel leaves what it reads as it was in that case.
#[inline(always)]
pub(super) fn watched(run: impl Fn() -> u64) -> Option<u32> {
    let flushed = |both: u64| (both >> 32) as u32 & FLUSHED != 0;
    let mut both = run();
    if flushed(both) {
        lower();
        both = run();
        if flushed(both) {
            lower();
            return None;
        }
    }
    Some(both as u32)
}

/// Lowers the flags of FPSCR.
#[allow(unsafe_code)]
#[cold]
#[inline(never)]
pub(super) fn lower() {
    // SAFETY: clears the cumulative flags of FPSCR, which belong to nobody across calls, and nothing else.
    unsafe { lower_flags() }
}

/// # Safety
/// The processor has an FPU: `build.rs` compiles this file for no other.
#[allow(unsafe_code)]
#[unsafe(naked)]
unsafe extern "C" fn lower_flags() {
    naked_asm!(target!(), "vmrs r0, fpscr", "bic r0, r0, #0x9f", "vmsr fpscr, r0", "bx lr")
}
