//! The floating-point environment: rounding, subnormal numbers and traps, as the caller's thread has them set.
//!
//! All arithmetic here is to nearest, with subnormal numbers and without traps, as Rust defines it. A caller in C may
//! have set something else, and a thread begins with what its creator had.
#![allow(unsafe_code)]

use registers::{Registers, own, read, write};

/// Runs `body` to nearest, with subnormal numbers and without traps, whatever the thread has set. Then the thread has
/// its settings and flags again, also where `body` unwinds.
///
/// It covers x86-64, aarch64, Arm and RISC-V with an FPU; other targets run `body` as it is.
///
/// ```
/// use rigidformer_core::kernels::in_own_environment;
/// assert_eq!(in_own_environment(|| 1.0_f32 / 3.0), 0.333_333_34);
/// ```
pub fn in_own_environment<R>(body: impl FnOnce() -> R) -> R {
    let _restored = Restored::enter();
    apart(body)
}

/// A function of its own: the compiler may move arithmetic across the instructions that change the environment, but not out of a call.
#[inline(never)]
fn apart<R>(body: impl FnOnce() -> R) -> R {
    body()
}

/// What the thread had set, which it has again when this is dropped.
struct Restored(Registers);

impl Restored {
    #[inline(always)]
    fn enter() -> Self {
        let theirs = read();
        // SAFETY: these are the settings that Rust's arithmetic needs.
        unsafe { write(own(theirs)) };
        Restored(theirs)
    }
}

impl Drop for Restored {
    #[inline(always)]
    fn drop(&mut self) {
        // SAFETY: what the thread had before, for the code that had it.
        unsafe { write(self.0) };
    }
}

/// MXCSR.
#[cfg(all(target_arch = "x86_64", not(miri)))]
mod registers {
    use core::arch::asm;

    pub(super) type Registers = u32;
    /// To nearest, all exceptions masked, no flag raised.
    pub(super) fn own(_: Registers) -> Registers {
        0x1f80
    }

    #[inline(always)]
    pub(super) fn read() -> Registers {
        let mut word = 0;
        // SAFETY: every x86-64 has the instruction; it writes the four bytes of `word`.
        unsafe { asm!("stmxcsr [{}]", in(reg) &raw mut word, options(nostack, preserves_flags)) };
        word
    }

    /// # Safety
    /// A word that [`read`] gave, or [`own`]; the code up to the next such call expects it.
    #[inline(always)]
    pub(super) unsafe fn write(word: Registers) {
        // SAFETY: every x86-64 has the instruction; no reserved bit is set by this function's contract.
        unsafe { asm!("ldmxcsr [{}]", in(reg) &raw const word, options(nostack, preserves_flags)) };
    }
}

/// FPCR and FPSR.
#[cfg(all(target_arch = "aarch64", not(miri)))]
mod registers {
    use core::arch::asm;

    pub(super) type Registers = [u64; 2];
    /// To nearest, with subnormal numbers, nothing trapped.
    pub(super) fn own([_, flags]: Registers) -> Registers {
        [0, flags]
    }

    #[inline(always)]
    pub(super) fn read() -> Registers {
        let (control, flags);
        // SAFETY: every aarch64 of this ABI has both registers; reading them changes nothing.
        unsafe {
            asm!("mrs {}, fpcr", "mrs {}, fpsr", out(reg) control, out(reg) flags, options(nostack, preserves_flags));
        }
        [control, flags]
    }

    /// # Safety
    /// Words that [`read`] gave, or [`own`]; the code up to the next such call expects them.
    #[inline(always)]
    pub(super) unsafe fn write([control, flags]: Registers) {
        // SAFETY: every aarch64 of this ABI has both registers; no reserved bit is set by this function's contract.
        unsafe {
            asm!("msr fpcr, {}", "msr fpsr, {}", in(reg) control, in(reg) flags, options(nostack, preserves_flags));
        }
    }
}

/// FPSCR, of processors whose calls pass floats in registers, so that they have an FPU.
#[cfg(all(target_arch = "arm", target_abi = "eabihf", not(miri)))]
mod registers {
    use core::arch::asm;

    pub(super) type Registers = u32;
    /// Other half precision, default NaN, flush to zero, rounding, flush to zero of halves, and traps.
    const SETTINGS: u32 = 1 << 26 | 1 << 25 | 1 << 24 | 3 << 22 | 1 << 19 | 0x9f00;
    /// The rest stays: Helium's loops need the length that it has there.
    pub(super) fn own(word: Registers) -> Registers {
        word & !SETTINGS
    }

    #[inline(always)]
    pub(super) fn read() -> Registers {
        let word;
        // SAFETY: the ABI says that there is an FPU; reading the register changes nothing.
        unsafe { asm!("vmrs {}, fpscr", out(reg) word, options(nostack, preserves_flags)) };
        word
    }

    /// # Safety
    /// A word that [`read`] gave, or [`own`]; the code up to the next such call expects it.
    #[inline(always)]
    pub(super) unsafe fn write(word: Registers) {
        // SAFETY: the ABI says that there is an FPU; no reserved bit is set by this function's contract.
        unsafe { asm!("vmsr fpscr, {}", in(reg) word, options(nostack)) };
    }
}

/// fcsr.
#[cfg(all(rigidformer_fcsr, not(miri)))]
mod registers {
    use core::arch::asm;

    pub(super) type Registers = usize;
    /// To nearest, ties to even, no flag raised. RISC-V has neither traps nor a flush to zero.
    pub(super) fn own(_: Registers) -> Registers {
        0
    }

    #[inline(always)]
    pub(super) fn read() -> Registers {
        let word;
        // SAFETY: `build.rs` sets this cfg for targets with an FPU; reading the register changes nothing.
        unsafe { asm!("frcsr {}", out(reg) word, options(nostack)) };
        word
    }

    /// # Safety
    /// A word that [`read`] gave, or [`own`]; the code up to the next such call expects it.
    #[inline(always)]
    pub(super) unsafe fn write(word: Registers) {
        // SAFETY: `build.rs` sets this cfg for targets with an FPU; no reserved bit is set by this function's contract.
        unsafe { asm!("fscsr {}", in(reg) word, options(nostack)) };
    }
}

/// Without an FPU there is nothing to set, and Miri has no assembly.
#[cfg(any(
    miri,
    not(any(
        target_arch = "x86_64",
        target_arch = "aarch64",
        all(target_arch = "arm", target_abi = "eabihf"),
        rigidformer_fcsr
    ))
))]
mod registers {
    pub(super) type Registers = ();
    pub(super) fn own((): Registers) -> Registers {
        ()
    }

    #[inline(always)]
    pub(super) fn read() -> Registers {}

    /// # Safety
    /// The caller has no obligation.
    #[inline(always)]
    pub(super) unsafe fn write((): Registers) {}
}
