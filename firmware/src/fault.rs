//! When the program is lost: the motor goes off first, then it is said and noted why, then the unit starts anew.

use core::arch::naked_asm;
use core::panic::PanicInfo;
use core::ptr;

use app::blackbox::{self, Cause};
use embassy_time::Instant;

use crate::board::{self, BlackBoxRam};

/// Time for the probe to read what was said, ms. The watchdog waits longer.
const SAY_MS: u32 = 50;

#[panic_handler]
fn panic(info: &PanicInfo) -> ! {
    // Or the motor's loop, which interrupts the thread, would switch the motor on again.
    cortex_m::interrupt::disable();
    board::motor_off();
    let (file, line) = info.location().map_or(("?", 0), |l| (l.file(), l.line()));
    note(Cause::panic(file, line));
    // Formatting the arguments would bring in core::fmt; the place says as much.
    match info.message().as_str() {
        Some(message) => defmt::error!("panic at {}:{}: {}", file, line, message),
        None => defmt::error!("panic at {}:{}", file, line),
    }
    board::spin_ms(SAY_MS);
    board::reset()
}

// What defmt's own `panic!` and `unwrap!` end in; they have said why. Without it the message would come twice. Where, is
// known to the log alone.
#[defmt::panic_handler]
fn said() -> ! {
    cortex_m::interrupt::disable();
    board::motor_off();
    note(Cause::panic("see the log", 0));
    board::spin_ms(SAY_MS);
    board::reset()
}

/// For the next start, which tells it.
fn note(cause: Cause) {
    blackbox::note(&mut BlackBoxRam, cause, blackbox::seconds(Instant::now().as_micros()));
}

/// An overflown stack is one cause of a hard fault, and nothing can run on it: begin with an empty one.
// SAFETY: the name is the vector table's, and its signature. The handler never returns, so what was on the stack is of
// no use to anybody but as a witness.
#[unsafe(naked)]
#[unsafe(no_mangle)]
unsafe extern "C" fn HardFault() -> ! {
    naked_asm!(
        "mrs r0, msp",
        "ldr r1, =_stack_start",
        "msr msp, r1",
        "b {lost}",
        lost = sym lost,
    )
}

unsafe extern "C" {
    // Of memory.x: the ends of the stack.
    static _stack_start: u32;
    static _stack_end: u32;
}

/// Words that the core puts on the stack when an exception begins; the seventh is where the program was.
const FRAME: usize = 8;
const PROGRAM_COUNTER: usize = 6;

/// Where the program was when `frame` was put on the stack; zero where that is no place on it, as when it overflew.
fn program_counter(frame: *const u32) -> u32 {
    let (start, end) = (&raw const _stack_start, &raw const _stack_end);
    let room = end..=start.wrapping_sub(FRAME);
    if !frame.is_aligned() || !room.contains(&frame) {
        return 0;
    }
    // SAFETY: a word of the stack, which is memory.
    unsafe { ptr::read_volatile(frame.wrapping_add(PROGRAM_COUNTER)) }
}

extern "C" fn lost(frame: *const u32) -> ! {
    cortex_m::interrupt::disable();
    board::motor_off();
    // Before the new stack, which begins where the old one did, has grown over it.
    let at = program_counter(frame);
    // SAFETY: reads of two registers of the core, without effect.
    let (cfsr, address) = unsafe {
        let scb = &*cortex_m::peripheral::SCB::PTR;
        (scb.cfsr.read(), scb.bfar.read())
    };
    note(Cause::HardFault { reasons: cfsr, at });
    defmt::error!(
        "hard fault at {=u32:#010x}: CFSR {=u32:#010x}, BFAR {=u32:#010x}",
        at,
        cfsr,
        address
    );
    board::spin_ms(SAY_MS);
    board::reset()
}

/// An interrupt that nothing serves. Its number is the reference manual's, or below zero for an exception of the core.
// SAFETY: it touches nothing that the code it interrupts relies on, and never returns to it.
#[cortex_m_rt::exception]
unsafe fn DefaultHandler(irqn: i16) -> ! {
    cortex_m::interrupt::disable();
    board::motor_off();
    note(Cause::panic("interrupt", u32::from(irqn.unsigned_abs())));
    defmt::error!("interrupt {=i16} without a handler", irqn);
    board::spin_ms(SAY_MS);
    board::reset()
}
