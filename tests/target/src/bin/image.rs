//! Runs the alignment and counts the steps; on a host, the alignment alone.
//!
//! What it says, a line each: `hash samples NUMBER`, `hash estimates NUMBER`, `cost INSTRUCTIONS LIMIT NAME` (no limit:
//! `-`), `done`.
#![cfg_attr(target_os = "none", no_std, no_main)]

#[cfg(not(target_os = "none"))]
fn main() {
    if let Some(outcome) = target_check::bits::outcome() {
        println!("hash samples {:016x}", outcome.samples.0);
        println!("hash estimates {:016x}", outcome.estimates.0);
    }
}

#[cfg(target_os = "none")]
mod target {
    use core::cell::RefCell;
    use core::panic::PanicInfo;
    use core::sync::atomic::{AtomicU32, Ordering};

    use cortex_m::interrupt::{Mutex, free};
    use target_check::bits::{self, Core};
    use target_check::motion::Motion;

    /// The result, for a debugger: 0, then the halves of both hashes (low first), estimates counted, whether it aligned;
    /// the first word becomes `0x600D` when the rest is valid, `0xBAD` where there is none.
    #[unsafe(no_mangle)]
    static TARGET_CHECK: [AtomicU32; 7] = [const { AtomicU32::new(0) }; 7];

    /// 40 kB, too much for a stack.
    static CORE: Mutex<RefCell<Option<Core>>> = Mutex::new(RefCell::new(None));

    fn leave(words: &[u32]) {
        for (place, word) in TARGET_CHECK.iter().zip(words) {
            place.store(*word, Ordering::Relaxed);
        }
    }

    /// A new aligner in the static, for `work`.
    fn with_core<R>(work: impl FnOnce(&mut Core) -> R) -> Option<R> {
        free(|cs| {
            let mut place = CORE.borrow(cs).borrow_mut();
            *place = Core::new(bits::config()).ok();
            place.as_mut().map(work)
        })
    }

    #[cortex_m_rt::entry]
    fn main() -> ! {
        let outcome = Motion::new().and_then(|mut motion| with_core(|core| bits::run(core, &mut motion)));
        match outcome {
            Some(outcome) => {
                let (samples, estimates) = (outcome.samples.0, outcome.estimates.0);
                leave(&[
                    0,
                    samples as u32,
                    (samples >> 32) as u32,
                    estimates as u32,
                    (estimates >> 32) as u32,
                    outcome.count,
                    u32::from(outcome.aligned),
                ]);
                leave(&[0x600D]);
            }
            None => leave(&[0xBAD]),
        }
        #[cfg(not(feature = "stm32f427"))]
        super::qemu::tell(outcome);
        #[cfg(feature = "stm32f427")]
        loop {
            cortex_m::asm::nop();
        }
    }

    #[cfg(not(feature = "stm32f427"))]
    pub(crate) fn count(
        counter: &mut impl target_check::cost::Counter,
        tell: &mut impl FnMut(target_check::cost::Line),
    ) {
        with_core(|core| target_check::cost::count(counter, core, tell));
    }

    #[panic_handler]
    fn panic(_: &PanicInfo) -> ! {
        leave(&[0xBAD]);
        #[cfg(not(feature = "stm32f427"))]
        super::qemu::exit(false);
        #[cfg(feature = "stm32f427")]
        loop {
            cortex_m::asm::nop();
        }
    }
}

#[cfg(all(target_os = "none", not(feature = "stm32f427")))]
mod qemu {
    use core::arch::asm;
    use core::fmt::{self, Write};

    use cortex_m::peripheral::syst::SystClkSource;
    use cortex_m::peripheral::{Peripherals, SYST};
    use target_check::bits::Outcome;
    use target_check::cost::Counter;

    /// Semihosting: write a string that ends with zero.
    const WRITE0: u32 = 0x04;
    /// Semihosting: end the program.
    const EXIT: u32 = 0x18;
    const EXIT_WELL: u32 = 0x2_0026;
    const EXIT_FAULT: u32 = 0x2_0023;

    /// A request to the debugger, which here is QEMU.
    fn request(operation: u32, argument: u32) {
        // SAFETY: QEMU takes the breakpoint, reads the string of WRITE0, which outlives it, and changes r0 alone.
        unsafe { asm!("bkpt #0xab", inout("r0") operation => _, in("r1") argument) };
    }

    pub(crate) fn exit(well: bool) -> ! {
        request(EXIT, if well { EXIT_WELL } else { EXIT_FAULT });
        loop {
            cortex_m::asm::nop();
        }
    }

    struct Out;

    impl Write for Out {
        fn write_str(&mut self, s: &str) -> fmt::Result {
            for part in s.as_bytes().chunks(63) {
                let mut zero_ended = [0_u8; 64];
                zero_ended[..part.len()].copy_from_slice(part);
                request(WRITE0, zero_ended.as_ptr().addr() as u32);
            }
            Ok(())
        }
    }

    /// SysTick runs on the board's 25 MHz: one count is 40 ns, which are 40 instructions.
    struct SysTick {
        timer: SYST,
        /// Counts of an empty closure's call, and of reading the clock.
        idle: [u32; 2],
    }

    const PER_COUNT: u32 = 40;
    const WRAP: u32 = 0x00FF_FFFF;

    impl SysTick {
        fn new(mut timer: SYST) -> Self {
            timer.set_clock_source(SystClkSource::Core);
            timer.set_reload(WRAP);
            timer.clear_current();
            timer.enable_counter();
            let mut clock = Self { timer, idle: [0; 2] };
            let mut nothing = || core::hint::black_box(());
            clock.idle = [clock.mean(1, &mut nothing), clock.mean(1000, &mut nothing)];
            clock
        }
    }

    impl Counter for SysTick {
        #[inline(never)]
        fn mean(&mut self, calls: u32, body: &mut dyn FnMut()) -> u32 {
            let start = SYST::get_current();
            for _ in 0..calls {
                body();
            }
            let counts = start.wrapping_sub(SYST::get_current()) & WRAP;
            let _ = &self.timer;
            let idle = self.idle[usize::from(calls > 1)];
            (counts * PER_COUNT / calls).saturating_sub(idle)
        }
    }

    pub(crate) fn tell(outcome: Option<Outcome>) -> ! {
        let (Some(outcome), Some(peripherals)) = (outcome, Peripherals::take()) else {
            exit(false)
        };
        let (samples, estimates) = (outcome.samples.0, outcome.estimates.0);
        // Writing to the debugger cannot fail.
        let _ = writeln!(Out, "hash samples {samples:016x}\nhash estimates {estimates:016x}");
        let mut clock = SysTick::new(peripherals.SYST);
        super::target::count(&mut clock, &mut |line| {
            let _ = match line.limit {
                Some(limit) => writeln!(Out, "cost {} {limit} {}", line.instructions, line.name),
                None => writeln!(Out, "cost {} - {}", line.instructions, line.name),
            };
        });
        let _ = writeln!(Out, "done");
        exit(true)
    }
}
