//! How deep the stack has been: start-up code paints all of it (cortex-m-rt's `paint-stack`).

use cortex_m_rt::STACK_PAINT_VALUE;

unsafe extern "C" {
    static mut _stack_start: u32;
    static mut _stack_end: u32;
}

/// Bytes of stack that were used at most, so far.
pub fn high_water() -> usize {
    let start = (&raw const _stack_start).addr();
    let mut at = &raw const _stack_end;
    // SAFETY: the linker script reserves every word from `_stack_end` to `_stack_start`, and nothing but the
    // stack is in it; the words are read as volatile because the compiler does not know who wrote them.
    while at.addr() < start && unsafe { at.read_volatile() } == STACK_PAINT_VALUE {
        at = at.wrapping_add(1);
    }
    start - at.addr()
}

/// Bytes that the stack may have: all RAM that no static takes.
pub fn available() -> usize {
    (&raw const _stack_start).addr() - (&raw const _stack_end).addr()
}
