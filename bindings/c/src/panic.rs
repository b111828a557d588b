//! What is left of a panic where there is no std. Nothing in the library is known to panic; a panic
//! handler is the language's condition for linking.
#![allow(unsafe_code)]

// A weak symbol, so that the application's own `rf_panic` takes its place. It loops, because a
// panic handler has nowhere to return to.
#[cfg(target_arch = "arm")]
core::arch::global_asm!(
    ".section .text.rf_panic,\"ax\",%progbits",
    ".weak rf_panic",
    ".type rf_panic,%function",
    ".thumb_func",
    "rf_panic:",
    "b rf_panic",
    ".size rf_panic, . - rf_panic",
    ".text",
);

#[cfg(target_arch = "riscv32")]
core::arch::global_asm!(
    ".section .text.rf_panic,\"ax\",@progbits",
    ".weak rf_panic",
    ".type rf_panic,@function",
    "rf_panic:",
    "j rf_panic",
    ".size rf_panic, . - rf_panic",
    ".text",
);

unsafe extern "C" {
    /// Of the application, or the loop above; targets other than Arm and 32-bit RISC-V must define it.
    safe fn rf_panic() -> !;
}

#[panic_handler]
fn panic(_: &core::panic::PanicInfo<'_>) -> ! {
    rf_panic()
}
