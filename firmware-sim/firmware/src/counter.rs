//! Counts instructions. QEMU has no model of cycles: with `-icount shift=0` every instruction takes one
//! nanosecond of its clock, which SysTick divides by some tens. On a real board this would count time.

use core::arch::asm;

use cortex_m::peripheral::SYST;
use cortex_m::peripheral::syst::SystClkSource;

/// SysTick has 24 bits.
const MASK: u32 = 0x00ff_ffff;
/// Rounds of the loop that calibrates; two instructions each.
// Two million instructions are some 50,000 ticks, so that rounding to a tick is nothing.
const ROUNDS: u32 = 1 << 20;
/// In which fractions of an instruction a tick is measured: AN547's clock of 32 MHz makes a tick 31.25 instructions.
const FRACTIONS: u32 = if cfg!(quarter_ticks) { 4 } else { 1 };

/// SysTick on the processor's clock, which counts down.
#[derive(Clone, Copy, Debug)]
pub struct Counter {
    /// [`FRACTIONS`] of instructions.
    per_tick: u32,
}

/// A moment, in ticks.
#[derive(Clone, Copy, Debug)]
pub struct Moment(u32);

impl Counter {
    /// Starts SysTick and finds out how many instructions a tick is.
    pub fn start(mut syst: SYST) -> Counter {
        syst.set_clock_source(SystClkSource::Core);
        syst.set_reload(MASK);
        syst.clear_current();
        syst.enable_counter();
        let ticks = Counter { per_tick: FRACTIONS };
        let start = ticks.now();
        // SAFETY: counts a register down and touches nothing else.
        unsafe {
            asm!("2: subs {0}, #1", "bne 2b", inout(reg) ROUNDS => _, options(nomem, nostack));
        }
        // A clock that stands must not end in a division by 0.
        let found = ticks.since(start).max(1);
        // Half of the divisor rounds to the nearest.
        Counter { per_tick: (2 * FRACTIONS * ROUNDS + found / 2) / found }
    }

    /// Whole instructions in a tick: about what the counter can tell apart.
    pub fn per_tick(self) -> u32 {
        self.per_tick / FRACTIONS
    }

    /// Now.
    #[inline]
    pub fn now(self) -> Moment {
        Moment(SYST::get_current())
    }

    /// Instructions since then, if they were fewer than 16 million ticks. What lies between two
    /// moments is rounded to ticks, but sums of neighbouring intervals are not rounded again.
    #[inline]
    pub fn since(self, start: Moment) -> u32 {
        // The counter counts down and wraps at 24 bits.
        (start.0.wrapping_sub(SYST::get_current()) & MASK) * self.per_tick / FRACTIONS
    }

    /// Instructions from one moment to another, as [`since`](Self::since).
    #[inline]
    pub fn between(self, start: Moment, end: Moment) -> u32 {
        (start.0.wrapping_sub(end.0) & MASK) * self.per_tick / FRACTIONS
    }
}
