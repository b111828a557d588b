//! Beginning and end of an image: the logger, faults, panics, the exit code.

use core::panic::PanicInfo;

use cortex_m::peripheral::Peripherals;
use defmt_semihosting as _;
use semihosting::process::ExitCode;

use crate::counter::Counter;
use crate::stack;

/// Runs an image and ends the emulator: with code 0 where `case` succeeds.
pub fn run(case: fn(Counter) -> Result<(), &'static str>) -> ! {
    let Some(peripherals) = Peripherals::take() else { exit(false) };
    let counter = Counter::start(peripherals.SYST);
    defmt::info!("measured clock {=u32}", counter.per_tick());
    let result = case(counter);
    // After the case, so that its deepest call is in the mark.
    defmt::info!("measured stack {=usize}", stack::high_water());
    match result {
        Ok(()) => defmt::info!("done"),
        Err(why) => defmt::error!("failed: {=str}", why),
    }
    exit(result.is_ok())
}

fn exit(well: bool) -> ! {
    if well { ExitCode::SUCCESS.exit_process() } else { ExitCode::FAILURE.exit_process() }
}

#[panic_handler]
fn panic(info: &PanicInfo<'_>) -> ! {
    defmt::error!("{}", defmt::Display2Format(info));
    exit(false)
}

/// # Safety
/// The runtime alone calls it, as the processor's handler of hard faults.
#[cortex_m_rt::exception]
unsafe fn HardFault(frame: &cortex_m_rt::ExceptionFrame) -> ! {
    defmt::error!("hard fault at {=u32:#010x}", frame.pc());
    exit(false)
}
