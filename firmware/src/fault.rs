//! When the program is lost: the motor goes off first, then it is said why, then the unit starts anew.

use core::arch::naked_asm;
use core::panic::PanicInfo;

use crate::board;

/// Time for the probe to read what was said, ms. The watchdog waits longer.
const SAY_MS: u32 = 50;

#[panic_handler]
fn panic(info: &PanicInfo) -> ! {
    // Or the motor's loop, which interrupts the thread, would switch the motor on again.
    cortex_m::interrupt::disable();
    board::motor_off();
    let (file, line) = info.location().map_or(("?", 0), |l| (l.file(), l.line()));
    // Formatting the arguments would bring in core::fmt; the place says as much.
    match info.message().as_str() {
        Some(message) => defmt::error!("panic at {}:{}: {}", file, line, message),
        None => defmt::error!("panic at {}:{}", file, line),
    }
    board::spin_ms(SAY_MS);
    board::reset()
}

// What defmt's own `panic!` and `unwrap!` end in; they have said why. Without it the message would come twice.
#[defmt::panic_handler]
fn said() -> ! {
    cortex_m::interrupt::disable();
    board::motor_off();
    board::spin_ms(SAY_MS);
    board::reset()
}

/// An overflown stack is one cause of a hard fault, and nothing can run on it: begin with an empty one.
// SAFETY: the name is the vector table's, and its signature. The handler never returns, so what was on the stack is of
// no use to anybody.
#[unsafe(naked)]
#[unsafe(no_mangle)]
unsafe extern "C" fn HardFault() -> ! {
    naked_asm!(
        "ldr r0, =_stack_start",
        "msr msp, r0",
        "b {lost}",
        lost = sym lost,
    )
}

extern "C" fn lost() -> ! {
    board::motor_off();
    // SAFETY: reads of two registers of the core, without effect.
    let (cfsr, address) = unsafe {
        let scb = &*cortex_m::peripheral::SCB::PTR;
        (scb.cfsr.read(), scb.bfar.read())
    };
    defmt::error!("hard fault: CFSR {=u32:#010x}, BFAR {=u32:#010x}", cfsr, address);
    board::spin_ms(SAY_MS);
    board::reset()
}
