//! The boards. What they have in common is here: an STM32F4 at 168 MHz and what the application asks for, as its own
//! traits. Each board has a file of its own, chosen by a feature, with the pins and peripherals that stand behind it.
//!
//! | feature | file | board | wiring |
//! |---|---|---|---|
//! | `board-f429`, the default | `board/nucleo_f429zi.rs` | NUCLEO-F429ZI | `docs/wiring.md` |
//! | `board-f405` | `board/weact_f405rg.rs` | WeAct STM32F405 core board | `docs/wiring-f405.md` |
//!
//! | unit | use | figures |
//! |---|---|---|
//! | clock | HSE, 8 MHz; PLL | 8 MHz / 4 × 168 / 2 = 168 MHz; APB1 42, APB2 84 MHz |
//! | | without it HSI, 16 MHz | 16 MHz / 8 × 168 / 2, up to 8 % off: see [`ClockSource`] |
//! | TIM1 or TIM8 | bridge, centre-aligned | 168 MHz / (2 × 4200) = 20 kHz, 12 bits |
//! | TIM5 | clock of the unit | 1 µs |
//! | IWDG | watchdog, from the first instant on | `WATCHDOG_US` by a clock of 17 to 47 kHz where 32 is meant |
//!
//! # Priorities
//!
//! ```text
//! 0  EXTI0       data-ready: the stamp is late by no more than a critical section
//! 2  DMA, TIM5, USART, FLASH     short; they wake tasks
//! 6  software interrupt: the executor of the motor's loop
//! 7  software interrupt: the executor of the sampling
//!    thread      everything else
//! ```

use core::cell::Cell;
use core::convert::Infallible;
use core::future::poll_fn;
use core::mem::{self, MaybeUninit};
use core::ptr;
use core::task::Poll;

use app::blackbox::{self, Memory, SLOTS, Slot};
use app::hal::{ChangeOver, ClockSource, Cutoff, Edge, EdgeCapture, ResetCause, Supply, Watchdog};
use drivers::motor::{Duty, MotorDriver, ThreePhase};
use embassy_executor::{InterruptExecutor, SendSpawner};
use embassy_stm32::exti::{ExtiInput, TriggerEdge};
use embassy_stm32::gpio::{AfType, Flex, Input, Level, Output, OutputType, Pull, Speed};
use embassy_stm32::interrupt::{InterruptExt, Priority};
use embassy_stm32::mode::{Async, Blocking};
use embassy_stm32::rcc::{APBPrescaler, Hse, HseMode, Pll, PllMul, PllPDiv, PllPreDiv, PllQDiv, PllSource, Sysclk};
use embassy_stm32::spi::mode::Master;
use embassy_stm32::spi::{self, Spi};
use embassy_stm32::time::Hertz;
use embassy_stm32::timer::Channel;
use embassy_stm32::timer::complementary_pwm::{BreakInputPolarity, ComplementaryPwm, Ossi};
use embassy_stm32::timer::low_level::CountingMode;
use embassy_stm32::timer::simple_pwm::PwmPin;
use embassy_stm32::usart::{self, RingBufferedUartRx, Uart, UartTx};
use embassy_stm32::wdg::IndependentWatchdog;
use embassy_stm32::{Config, interrupt, pac, peripherals};
use embassy_sync::blocking_mutex::Mutex;
use embassy_sync::blocking_mutex::raw::CriticalSectionRawMutex;
use embassy_sync::waitqueue::AtomicWaker;
use embassy_time::{Delay, Instant, Timer};
use embedded_hal::delay::DelayNs as _;
use embedded_hal_async::spi::{ErrorType, Operation, SpiBus, SpiDevice};
use static_cell::StaticCell;

#[cfg(all(feature = "board-f405", not(feature = "board-f429")))]
#[path = "board/weact_f405rg.rs"]
mod fitted;
#[cfg(all(feature = "board-f429", not(feature = "board-f405")))]
#[path = "board/nucleo_f429zi.rs"]
mod fitted;
#[cfg(not(any(feature = "board-f429", feature = "board-f405")))]
compile_error!("choose a board: --features board-f429 or board-f405");
#[cfg(all(feature = "board-f429", feature = "board-f405"))]
compile_error!("one board at a time: --no-default-features --features board-f405");

use fitted::{Irqs, pin};
pub use fitted::{SettingsFlash, erase_ahead};

/// Clock of the core, Hz.
const CORE_HZ: u32 = 168_000_000;
/// Clock of the core from a reset until the clocks are set up, Hz.
const RESET_HZ: u32 = 16_000_000;
/// How long the clock from outside may take to come, ms: a debugger's controller starts with the same supply as this part.
/// As long as ST's own HAL waits, and well within the watchdog's time.
const CLOCK_WAIT_MS: u32 = 100;
/// From one look for it to the next, µs.
const CLOCK_LOOK_US: u32 = 10;
/// Clock of both SPI buses, Hz.
const SPI_HZ: u32 = 5_250_000;
/// Frequency of the bridge's PWM, Hz: above hearing, and as slow as that allows, for the bridge's losses.
const PWM_HZ: u32 = 20_000;
/// Rate of the serial port.
const BAUD: u32 = 115_200;
/// Delays within a bus transaction up to this length are waited for where they stand, ns: an alarm would take as long.
const SPIN_NS: u32 = 20_000;

/// Bytes that may come while nobody reads: 22 ms, and eight whole commands.
const RECEIVE: usize = 256;
static RECEIVED: StaticCell<[u8; RECEIVE]> = StaticCell::new();

/// The resources of a board: each is named once, in its file, and handed out by type.
macro_rules! resources {
    (
        pins { $($(#[$fitted:meta])? $signal:ident: $pin:ident = $function:literal,)* }
        units { $($(#[$used:meta])? $unit:ident: $peripheral:ident,)* }
    ) => {
        /// The pin of each signal.
        #[allow(non_camel_case_types, dead_code, reason = "named as the signals are; for those that need a pin by type")]
        pub(super) mod pin {
            use embassy_stm32::peripherals;
            $($(#[$fitted])? #[doc = $function] pub type $signal = peripherals::$pin;)*
        }
        pub(super) struct Pins {
            $($(#[$fitted])? #[doc = $function] pub(super) $signal: Peri<'static, pin::$signal>,)*
        }
        /// The type of each peripheral.
        #[allow(non_camel_case_types, dead_code, reason = "named as their uses are; for those that need one by type")]
        pub(super) mod unit {
            use embassy_stm32::peripherals;
            $($(#[$used])? pub type $unit = peripherals::$peripheral;)*
        }
        pub(super) struct Units { $($(#[$used])? pub(super) $unit: Peri<'static, unit::$unit>,)* }

        fn split(p: Peripherals) -> (Pins, Units) {
            (Pins { $($(#[$fitted])? $signal: p.$pin,)* }, Units { $($(#[$used])? $unit: p.$peripheral,)* })
        }
    };
}
use resources;

/// The serial port's transmitter, by DMA.
pub type SerialTx = UartTx<'static, Async>;
/// The serial port's receiver: DMA fills a ring while nobody reads.
pub type SerialRx = RingBufferedUartRx<'static>;

/// A board that is up: clocks run, the motor is off.
pub struct Board {
    /// Why it came up.
    pub reset_cause: ResetCause,
    /// What its clock goes by.
    pub clock: ClockSource,
    /// The IMU's bus.
    pub imu: Device,
    /// The IMU's data-ready.
    pub imu_ready: DataReady,
    /// The encoder's bus.
    pub encoder: Device,
    /// The bridge's three duties.
    pub bridge: Bridge,
    /// The bridge's enable and fault lines.
    pub driver: MotorDriver<Output<'static>, Flex<'static>>,
    /// The home switch: common to 3V3, so that a broken wire reads low on both.
    pub home: ChangeOver<Input<'static>, Input<'static>>,
    /// Lamps: green, blue, red.
    pub lamps: [Output<'static>; 3],
    /// The button, high where pressed.
    pub button: Input<'static>,
    /// The serial port: NMEA 0183 out.
    pub serial_tx: SerialTx,
    /// The serial port: commands in.
    pub serial_rx: SerialRx,
    /// The watchdog, which runs.
    pub watchdog: Iwdg,
    /// The flash of the settings.
    pub settings: SettingsFlash,
    /// What it is written by.
    pub supply: Vdd,
}

impl Board {
    /// Starts watchdog and clocks and takes the board's resources. Once: a second call panics.
    pub fn start() -> Self {
        // First: what hangs from here on ends in a reset.
        let mut watchdog = Iwdg::start();
        let clock = clock_source();
        // The wait is counted in cycles and may take twice as long: the rest of the start has the whole time again.
        watchdog.feed();
        let (pins, units) = fitted::take(embassy_stm32::init(config(clock)));
        if clock == ClockSource::Crystal {
            // A clock that stops later takes the bridge's outputs away, and ends in an interrupt that nothing serves: a
            // reset, and a start by the chip's own.
            pac::RCC.cr().modify(|w| w.set_csson(true));
        }
        fast_flash();
        priorities();

        let mut bus = spi::Config::default();
        bus.mode = spi::MODE_3;
        bus.frequency = Hertz(SPI_HZ);
        let imu_spi = Spi::new(
            units.imu_spi,
            pins.imu_clock,
            pins.imu_mosi,
            pins.imu_miso,
            units.imu_tx,
            units.imu_rx,
            Irqs,
            bus,
        );
        let encoder_spi = Spi::new(
            units.encoder_spi,
            pins.encoder_clock,
            pins.encoder_mosi,
            pins.encoder_miso,
            units.encoder_tx,
            units.encoder_rx,
            Irqs,
            bus,
        );

        let enable = Output::new(pins.motor_enable, Level::Low, Speed::Low);
        let mut fault = Flex::new(pins.motor_fault);
        // As the timer's break input the line switches the outputs off in nanoseconds, without software; its level can still be read.
        fault.set_as_af_unchecked(fitted::MOTOR_FAULT_AF, AfType::input(Pull::Up));
        let phases = (
            PwmPin::new(pins.motor_a, OutputType::PushPull),
            PwmPin::new(pins.motor_b, OutputType::PushPull),
            PwmPin::new(pins.motor_c, OutputType::PushPull),
        );
        let bridge = Bridge::new(ComplementaryPwm::new(
            units.motor_timer,
            Some(phases.0),
            None,
            Some(phases.1),
            None,
            Some(phases.2),
            None,
            None,
            None,
            Hertz(PWM_HZ),
            CountingMode::CenterAlignedBothInterrupts,
        ));
        let Ok(driver) = MotorDriver::new(enable, fault) else {
            defmt::unreachable!("a pin of this chip cannot fail")
        };

        let mut port = usart::Config::default();
        port.baudrate = BAUD;
        // Open, the line would take the PWM beside it for characters.
        port.rx_pull = Pull::Up;
        #[cfg(not(feature = "usart2"))]
        let serial = Uart::new(
            units.serial,
            pins.serial_rx,
            pins.serial_tx,
            units.serial_dma_tx,
            units.serial_dma_rx,
            Irqs,
            port,
        );
        #[cfg(feature = "usart2")]
        let serial = Uart::new(
            units.line,
            pins.line_rx,
            pins.line_tx,
            units.line_dma_tx,
            units.line_dma_rx,
            Irqs,
            port,
        );
        let Ok(serial) = serial else {
            defmt::panic!("{} baud cannot be had from APB1", BAUD)
        };
        let (serial_tx, serial_rx) = serial.split();

        Self {
            reset_cause: reset_cause(),
            clock,
            imu: Device::new(imu_spi, Output::new(pins.imu_select, Level::High, Speed::VeryHigh)),
            imu_ready: DataReady::new(ExtiInput::new_blocking(
                pins.imu_ready,
                units.imu_line,
                Pull::Down,
                TriggerEdge::Rising,
            )),
            encoder: Device::new(
                encoder_spi,
                Output::new(pins.encoder_select, Level::High, Speed::VeryHigh),
            ),
            bridge,
            driver,
            home: ChangeOver {
                below: Input::new(pins.home_below, Pull::Down),
                above: Input::new(pins.home_above, Pull::Down),
            },
            lamps: [
                Output::new(pins.lamp_green, Level::Low, Speed::Low),
                Output::new(pins.lamp_blue, Level::Low, Speed::Low),
                Output::new(pins.lamp_red, Level::Low, Speed::Low),
            ],
            button: Input::new(pins.button, Pull::Down),
            serial_tx,
            serial_rx: serial_rx.into_ring_buffered(RECEIVED.init([0; RECEIVE])),
            watchdog,
            settings: fitted::settings(units.flash),
            supply: Vdd::watched(),
        }
    }
}

/// Waits for the clock from outside, and no longer than [`CLOCK_WAIT_MS`]: the HAL would wait for ever for one that does
/// not come, as that of a debugger that is cut off, or of a crystal that is broken.
fn clock_source() -> ClockSource {
    // The bypass can only be set while the oscillator is off.
    pac::RCC.cr().modify(|w| w.set_hsebyp(fitted::HSE == HseMode::Bypass));
    pac::RCC.cr().modify(|w| w.set_hseon(true));
    for _ in 0..CLOCK_WAIT_MS * 1000 / CLOCK_LOOK_US {
        if pac::RCC.cr().read().hserdy() {
            return ClockSource::Crystal;
        }
        cortex_m::asm::delay(RESET_HZ / 1_000_000 * CLOCK_LOOK_US);
    }
    pac::RCC.cr().modify(|w| w.set_hseon(false));
    ClockSource::Internal
}

fn config(clock: ClockSource) -> Config {
    let mut config = Config::default();
    // 2 MHz into the PLL from either.
    let prediv = match clock {
        ClockSource::Crystal => {
            config.rcc.hse = Some(Hse {
                freq: Hertz(8_000_000),
                mode: fitted::HSE,
            });
            config.rcc.pll_src = PllSource::HSE;
            PllPreDiv::DIV4
        }
        ClockSource::Internal => {
            config.rcc.pll_src = PllSource::HSI;
            PllPreDiv::DIV8
        }
    };
    config.rcc.pll = Some(Pll {
        prediv,
        mul: PllMul::MUL168,
        divp: Some(PllPDiv::DIV2),
        divq: Some(PllQDiv::DIV7),
        divr: None,
    });
    config.rcc.sys = Sysclk::PLL1_P;
    config.rcc.apb1_pre = APBPrescaler::DIV4;
    config.rcc.apb2_pre = APBPrescaler::DIV2;
    config.dma_interrupt_priority = Priority::P2;
    config
}

/// The HAL sets the wait states and leaves the caches off: five wait states on every jump. Prefetch and both caches
/// make up for nearly all of them.
fn fast_flash() {
    pac::FLASH.acr().modify(|w| {
        w.set_prften(true);
        w.set_icen(true);
        w.set_dcen(true);
    });
}

fn priorities() {
    interrupt::EXTI0.set_priority(Priority::P0);
    interrupt::TIM5.set_priority(Priority::P2);
    for serial in fitted::SERIAL {
        serial.set_priority(Priority::P2);
    }
    interrupt::FLASH.set_priority(Priority::P2);
    let [motor, sampling] = fitted::EXECUTORS;
    motor.set_priority(Priority::P6);
    sampling.set_priority(Priority::P7);
}

fn reset_cause() -> ResetCause {
    let csr = pac::RCC.csr().read();
    pac::RCC.csr().modify(|w| w.set_rmvf(true));
    // Every reset pulls the reset line as well, and power-on sets the brown-out flag: from the rarest to the commonest.
    if csr.wdgrstf() || csr.wwdgrstf() {
        ResetCause::Watchdog
    } else if csr.sftrstf() {
        ResetCause::Software
    } else if csr.porrstf() {
        ResetCause::PowerOn
    } else if csr.borrstf() {
        ResetCause::BrownOut
    } else if csr.padrstf() {
        ResetCause::Pin
    } else {
        ResetCause::Unknown
    }
}

/// Ends the program.
pub fn reset() -> ! {
    cortex_m::peripheral::SCB::sys_reset()
}

/// Waits, with interrupts off.
pub fn spin_ms(ms: u32) {
    cortex_m::asm::delay(CORE_HZ / 1000 * ms);
}

// ---------------------------------------------------------------------------------------------- black box

// Not initialised at the start: it outlives every reset but that of power-on. Another image may have it elsewhere, and
// then finds garbage in its place.
#[unsafe(link_section = ".uninit.blackbox")]
static mut BLACK_BOX: MaybeUninit<[Slot; SLOTS]> = MaybeUninit::uninit();

/// The memory of the black box. One core: who interrupts a write, and writes as well, never returns.
#[derive(Clone, Copy)]
pub struct BlackBoxRam;

impl BlackBoxRam {
    fn slot(slot: usize) -> Option<*mut Slot> {
        let first = (&raw mut BLACK_BOX).cast::<Slot>();
        (slot < SLOTS).then(|| first.wrapping_add(slot))
    }
}

impl Memory for BlackBoxRam {
    fn read(&self, slot: usize) -> Slot {
        // SAFETY: in the static, aligned, and any bits are words. Volatile: what the program before has left there is
        // nothing that the compiler knows of.
        Self::slot(slot).map_or([0; blackbox::WORDS], |slot| unsafe { ptr::read_volatile(slot) })
    }

    fn write(&mut self, slot: usize, words: &Slot) {
        if let Some(slot) = Self::slot(slot) {
            // SAFETY: in the static and aligned; nobody holds a reference to it.
            unsafe { ptr::write_volatile(slot, *words) }
        }
    }
}

// ---------------------------------------------------------------------------------------------- motor

/// The bridge's timer.
type MotorTimer = fitted::unit::motor_timer;

/// The bridge's duties, on its timer.
pub struct Bridge(ComplementaryPwm<'static, MotorTimer>);

impl Bridge {
    const PHASES: [Channel; 3] = [Channel::Ch1, Channel::Ch2, Channel::Ch3];

    fn new(mut pwm: ComplementaryPwm<'static, MotorTimer>) -> Self {
        pwm.set_master_output_enable(false);
        // Without MOE the timer goes on driving its pins, all low: no line of the bridge ever floats.
        pwm.set_off_state_selection_idle(Ossi::IDLE_LEVEL);
        // nFAULT. What the break took away only `set_duties` gives back, and not while the line is low.
        pwm.set_automatic_output_enable(false);
        pwm.set_break_polarity(BreakInputPolarity::ACTIVE_LOW);
        pwm.set_break_enable(true);
        for phase in Self::PHASES {
            pwm.set_duty(phase, 0);
            pwm.enable(phase);
        }
        Self(pwm)
    }
}

impl ThreePhase for Bridge {
    fn set_duties(&mut self, duties: [Duty; 3]) {
        let top = self.0.get_max_duty() as u16;
        // No update event between the three, so that one period has all of them.
        fitted::MOTOR_TIMER.cr1().modify(|w| w.set_udis(true));
        for (phase, duty) in Self::PHASES.into_iter().zip(duties) {
            self.0.set_duty(phase, duty.compare(top).into());
        }
        fitted::MOTOR_TIMER.cr1().modify(|w| w.set_udis(false));
        if !self.0.get_master_output_enable() {
            // The duties of before the outputs went off are still at work: replace them first.
            fitted::MOTOR_TIMER.egr().write(|w| w.set_ug(true));
            self.0.set_master_output_enable(true);
        }
    }

    fn outputs_off(&mut self) {
        self.0.set_master_output_enable(false);
    }
}

/// Takes the motor's outputs away by register, whoever owns them.
pub fn motor_off() {
    fitted::MOTOR_TIMER.bdtr().modify(|w| w.set_moe(false));
    // SAFETY: the pin has an owner, who is not asked. The one access is a write to BSRR, which changes no other pin and
    // nothing of the owner's state.
    let mut enable = Flex::new(unsafe { pin::motor_enable::steal() });
    enable.set_low();
    // To drop it would let go of the pin.
    mem::forget(enable);
}

/// [`motor_off`] for the supervisor.
pub struct MotorCutoff;

impl Cutoff for MotorCutoff {
    fn cut(&mut self) {
        // The motor's loop may interrupt between reading and writing BDTR; then its `outputs_off` is what remains, or
        // this is.
        cortex_m::interrupt::free(|_| motor_off());
    }
}

// ---------------------------------------------------------------------------------------------- executors

static MOTOR_EXECUTOR: InterruptExecutor = InterruptExecutor::new();
static SAMPLING_EXECUTOR: InterruptExecutor = InterruptExecutor::new();

/// Starts the executor of the motor's loop: it interrupts all other tasks.
pub fn motor_executor() -> SendSpawner {
    MOTOR_EXECUTOR.start(fitted::EXECUTORS[0])
}

/// Starts the executor of the sampling: it interrupts what runs in the thread.
pub fn sampling_executor() -> SendSpawner {
    SAMPLING_EXECUTOR.start(fitted::EXECUTORS[1])
}

// ---------------------------------------------------------------------------------------------- data-ready

static EDGES: Mutex<CriticalSectionRawMutex, Cell<(u64, u32)>> = Mutex::new(Cell::new((0, 0)));
static EDGE_WAKER: AtomicWaker = AtomicWaker::new();

// The stamp of a sample is taken here: the task that reads it wakes late by all that interrupts it.
#[interrupt]
fn EXTI0() {
    let t_us = Instant::now().as_micros();
    pac::EXTI.pr(0).write(|w| w.set_line(0, true));
    EDGES.lock(|edges| edges.set((t_us, edges.get().1.saturating_add(1))));
    EDGE_WAKER.wake();
}

/// Data-ready of the IMU.
pub struct DataReady {
    _line: ExtiInput<'static, Blocking>,
}

impl DataReady {
    fn new(line: ExtiInput<'static, Blocking>) -> Self {
        interrupt::EXTI0.unpend();
        // SAFETY: all the handler touches is behind critical sections, and static.
        unsafe { interrupt::EXTI0.enable() };
        Self { _line: line }
    }
}

impl EdgeCapture for DataReady {
    async fn edge(&mut self) -> Edge {
        poll_fn(|context| {
            EDGE_WAKER.register(context.waker());
            let (t_us, count) = EDGES.lock(|edges| {
                let (t_us, count) = edges.get();
                edges.set((t_us, 0));
                (t_us, count)
            });
            match count.checked_sub(1) {
                Some(overrun) => Poll::Ready(Edge { t_us, overrun }),
                None => Poll::Pending,
            }
        })
        .await
    }
}

// ---------------------------------------------------------------------------------------------- buses

/// One device alone on its bus.
///
/// Cancellation: a dropped transaction stops the DMA and releases chip select.
pub struct Device {
    bus: Spi<'static, Async, Master>,
    select: Output<'static>,
}

impl Device {
    fn new(bus: Spi<'static, Async, Master>, select: Output<'static>) -> Self {
        Self { bus, select }
    }
}

struct Selected<'a>(&'a mut Output<'static>);

impl<'a> Selected<'a> {
    fn new(select: &'a mut Output<'static>) -> Self {
        select.set_low();
        Self(select)
    }
}

impl Drop for Selected<'_> {
    fn drop(&mut self) {
        self.0.set_high();
    }
}

impl ErrorType for Device {
    type Error = spi::Error;
}

impl SpiDevice for Device {
    async fn transaction(&mut self, operations: &mut [Operation<'_, u8>]) -> Result<(), spi::Error> {
        let _selected = Selected::new(&mut self.select);
        for operation in operations {
            match operation {
                Operation::Read(words) => SpiBus::read(&mut self.bus, words).await?,
                Operation::Write(words) => SpiBus::write(&mut self.bus, words).await?,
                Operation::Transfer(read, write) => SpiBus::transfer(&mut self.bus, read, write).await?,
                Operation::TransferInPlace(words) => SpiBus::transfer_in_place(&mut self.bus, words).await?,
                Operation::DelayNs(ns) if *ns <= SPIN_NS => Delay.delay_ns(*ns),
                Operation::DelayNs(ns) => Timer::after_micros(u64::from(ns.div_ceil(1000))).await,
            }
        }
        Ok(())
    }
}

// ---------------------------------------------------------------------------------------------- watchdog

/// The independent watchdog.
pub struct Iwdg(IndependentWatchdog<'static, peripherals::IWDG>);

impl Iwdg {
    /// Starts it; from here on it is fed or it bites. Before the HAL is up, which may wait without end for a clock.
    fn start() -> Self {
        // A breakpoint is no fault.
        pac::DBGMCU.apb1fzr().modify(|w| w.set_iwdg(true));
        // SAFETY: nobody else names this peripheral, see `resources`; the HAL hands it out later and does not touch it.
        let peripheral = unsafe { peripherals::IWDG::steal() };
        let mut watchdog = IndependentWatchdog::new(peripheral, fitted::WATCHDOG_US);
        watchdog.unleash();
        Self(watchdog)
    }
}

impl Watchdog for Iwdg {
    fn feed(&mut self) {
        self.0.pet();
    }
}

// ---------------------------------------------------------------------------------------------- supply

/// PLS of the voltage detector: it falls at 2.84 V and rises at 2.93, typically.
const DETECT: u8 = 5;
/// BOR_LEV of brown-out level 3, the one above 2.7 V.
const BROWN_OUT_LEVEL_3: u8 = 0;

/// The part's supply, watched by its voltage detector.
///
/// The HAL programs words of 32 bits, which takes 2.7 V at least (RM0090, 3.6.2); it erases by bytes, which takes 1.8.
pub struct Vdd(());

impl Vdd {
    fn watched() -> Self {
        pac::PWR.cr1().modify(|w| {
            w.set_pls(DETECT);
            w.set_pvde(true);
        });
        Self(())
    }
}

impl Supply for Vdd {
    fn is_enough(&mut self) -> bool {
        !pac::PWR.csr1().read().pvdo()
    }

    fn is_guarded(&self) -> bool {
        pac::FLASH.optcr().read().bor_lev() == BROWN_OUT_LEVEL_3
    }
}

const _: () = {
    // The pins cannot fail, which `Board::start` relies on.
    const fn infallible<P: embedded_hal::digital::ErrorType<Error = Infallible>>() {}
    infallible::<Output<'static>>();
    infallible::<Flex<'static>>();
};
