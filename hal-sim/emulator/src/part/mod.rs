//! The part: rigless's STM32F427, with what version 0.4.0 lacks.
//!
//! | | |
//! |---|---|
//! | `exti` | the part has no external interrupts there |
//! | `pwm` | a TIM1 that wakes nobody, in place of one that wakes 160 000 times a second |
//! | [`Part::correct`] | a software update of a stopped timer sets capture flags that it must not set; an HSE without a clock becomes ready |
//! | [`Part::power`] | the part takes no power-on reset there |
//! | `flash` | an array that can be erased and written, where there it is read-only; what it lacks is told there |
//!
//! A board drives the part's pins from outside; the levels outlive a reset, which rebuilds the part.

mod exti;
pub(crate) mod flash;
mod pwm;

use std::collections::BTreeMap;

use rigless::chip::spi;
use rigless::chip::uart;
use rigless::device::{ErasedDevice, Level, ResetCause};
use rigless::emulator::{Access, AccessKind, Memory, Settled};
use rigless::mcu::{Mcu, Operate as _};
use rigless::soc::stm32f427::Stm32f427;
use rigless::soc::stm32f427::generated::{rcc, syscfg, tim1, tim2};
use rigless::soc::stm32f427::peripherals::gpio::Pin as Number;
use rigless::soc::stm32f427::peripherals::spi::Select;
use rigless::soc::{Bus, Error};
use rigless::time::VirtualNanos;

use exti::Exti;
use flash::Interface;
use pwm::QuietTim1;

/// Ports of the part in order; EXTICR numbers them alike.
const PORTS: [&str; 11] = [
    "GPIOA", "GPIOB", "GPIOC", "GPIOD", "GPIOE", "GPIOF", "GPIOG", "GPIOH", "GPIOI", "GPIOJ", "GPIOK",
];
/// Bases of TIM2 to TIM5.
const GENERAL_TIMERS: [u64; 4] = [0x4000_0000, 0x4000_0400, 0x4000_0800, 0x4000_0C00];
/// CR of the RCC.
const RCC_CR: u64 = 0x4002_3800;
/// Offset of EGR in a timer.
const EGR: u64 = 0x14;
/// CC1IF to CC4IF in SR of a timer.
const CAPTURES: u64 = 0x1E;

/// A pin.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub struct Pin {
    port: usize,
    number: Number,
}

impl Pin {
    /// Pin `number` of the port with the letter `port`.
    ///
    /// # Panics
    /// Where the part has no such pin: at compile time in a constant.
    pub const fn new(port: char, number: u8) -> Self {
        let port = port as usize - 'A' as usize;
        assert!(port < PORTS.len(), "no such port");
        match Number::new(number) {
            Some(number) => Self { port, number },
            None => panic!("a port has 16 pins"),
        }
    }

    /// The pin as an active-low chip select.
    pub const fn select(self) -> Select {
        Select {
            port: PORTS[self.port],
            pin: self.number,
            active: Level::Low,
        }
    }

    fn line(self) -> u8 {
        self.number.index() as u8
    }
}

/// What drives the bridge's timer.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum BridgeTimer {
    /// Registers, break input and update flag; no edges on pins. Half the cost of a run.
    #[default]
    Quiet,
    /// rigless's own TIM1.
    Full,
}

/// What the bridge's timer is told to put out.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Drive {
    /// Share of the period that each phase is high, by CCRx and ARR: the preload, up to a period before it acts.
    pub duties: [f32; 3],
    /// Whether the outputs are on.
    pub on: bool,
}

/// The part.
#[derive(Debug)]
pub struct Part {
    inner: Stm32f427,
    exti: Exti,
    exti_slot: usize,
    quiet: Option<QuietTim1>,
    tim1_slot: usize,
    rcc_slot: usize,
    flash: Interface,
    flash_slot: usize,
    driven: BTreeMap<Pin, Level>,
    break_level: Level,
    supply_mv: u32,
}

/// rigless's part with its supply on.
fn powered(hse_hz: u64, supply_mv: u32) -> Result<Stm32f427, Error> {
    let mut inner = Stm32f427::new()?;
    inner.rcc.attach_crystals(hse_hz, 0);
    inner.set_supply(supply_mv);
    Ok(inner)
}

impl Part {
    /// A part with a crystal of `hse_hz`, zero for none, at `supply_mv`.
    ///
    /// # Errors
    /// Where the part does not assemble, which is a mistake in a model.
    pub fn new(hse_hz: u64, supply_mv: u32, timer: BridgeTimer) -> Result<Self, Error> {
        let inner = powered(hse_hz, supply_mv)?;
        let mut part = Self {
            exti: Exti::default(),
            exti_slot: inner.bus().slot("EXTI")?,
            quiet: (timer == BridgeTimer::Quiet).then(QuietTim1::default),
            tim1_slot: inner.bus().slot("TIM1")?,
            rcc_slot: inner.bus().slot("RCC")?,
            flash: Interface::new(supply_mv),
            flash_slot: inner.bus().slot("FLASH")?,
            inner,
            driven: BTreeMap::new(),
            break_level: Level::Low,
            supply_mv,
        };
        part.check()?;
        Ok(part)
    }

    /// Hangs a chip on SPI`number` behind a chip select.
    pub fn attach_spi(&mut self, number: usize, chip: impl spi::Peer, select: Pin) {
        self.inner.spi[number - 1].attach_selected(chip, select.select());
    }

    /// The chip on SPI`number`, if it is of that type.
    pub fn spi_chip<C: spi::Peer>(&mut self, number: usize) -> Option<&mut C> {
        self.inner.spi[number - 1].chip_mut::<C>(0)
    }

    /// Hangs something on the far end of USART`number`.
    pub fn attach_usart(&mut self, number: usize, peer: impl uart::Peer) {
        self.inner.usart[number - 1].attach(peer);
    }

    /// What hangs on USART`number`, if it is of that type.
    pub fn usart_peer<P: uart::Peer>(&mut self, number: usize) -> Option<&mut P> {
        self.inner.usart[number - 1].chip_mut::<P>()
    }

    /// Drives a pin from outside: its level for IDR, its edge for EXTI.
    pub fn drive(&mut self, at: VirtualNanos, pin: Pin, level: Level) {
        let before = self.driven.insert(pin, level);
        if before == Some(level) {
            return;
        }
        self.drive_port(at, pin, level);
        if before.unwrap_or(Level::Low) == level || self.exti_port(pin.line()) != pin.port {
            return;
        }
        let (registers, mut context) = self.inner.bus_mut().drive(at, self.exti_slot);
        self.exti
            .edge(pin.line(), level == Level::High, registers, &mut context);
    }

    fn drive_port(&mut self, at: VirtualNanos, pin: Pin, level: Level) {
        self.inner.drive_port(at, pin.port, |port, registers, context| {
            port.drive(pin.number, Some(level), registers, context);
        });
    }

    /// The port whose pin SYSCFG has chosen for a line.
    fn exti_port(&self, line: u8) -> usize {
        let register = [
            syscfg::Register::Exticr1,
            syscfg::Register::Exticr2,
            syscfg::Register::Exticr3,
            syscfg::Register::Exticr4,
        ][usize::from(line / 4) % 4];
        let chosen = self.inner.bus().registers("SYSCFG").map_or(0, |r| r.get(register));
        (chosen >> (4 * (line % 4))) as usize & 0xF
    }

    /// Drives the break input of TIM1 from outside.
    pub fn drive_break(&mut self, at: VirtualNanos, level: Level) {
        if level != self.break_level {
            self.break_level = level;
            self.apply_break(at);
        }
    }

    fn apply_break(&mut self, at: VirtualNanos) {
        let level = self.break_level;
        if let Some(quiet) = &mut self.quiet {
            let (registers, mut context) = self.inner.bus_mut().drive(at, self.tim1_slot);
            quiet.drive_break(level, registers, &mut context);
        } else {
            self.inner.drive_advanced_timer(at, 0, |timer, registers, context| {
                timer.drive_break(level, registers, context);
            });
        }
    }

    /// What TIM1 is told to put out.
    pub fn bridge(&mut self) -> Drive {
        use tim1::Register as R;
        let (_, registers) = self.inner.advanced_timer(0);
        let top = registers.get(R::Arr) as f32;
        let enabled = registers.get(R::Ccer);
        let runs = registers.get(R::Cr1) & 1 == 1;
        let duty = |channel: u32, compare| {
            let on = enabled >> (4 * channel) & 1 == 1 && top > 0.0;
            if on {
                (registers.get(compare) as f32 / top).min(1.0)
            } else {
                0.0
            }
        };
        Drive {
            duties: [duty(0, R::Ccr1), duty(1, R::Ccr2), duty(2, R::Ccr3)],
            on: runs && registers.get(R::Bdtr) & pwm::MOE != 0,
        }
    }

    /// The level that a wire soldered to a pin sees.
    pub fn level(&mut self, pin: Pin) -> Level {
        let (port, registers) = self.inner.port(pin.port);
        port.level(pin.number, registers)
    }

    /// Cuts the supply or gives it back. The runtime holds the core meanwhile.
    pub fn power(&mut self, at: VirtualNanos, on: bool) {
        // Any instance's context reaches the supply.
        let (_, mut context) = self.inner.bus_mut().drive(at, self.exti_slot);
        context.request_power(on);
    }

    /// Does what rigless 0.4.0 leaves out or does wrong at an access or a stop; to be called after each.
    ///
    /// A store into the flash is nobody's there, and no model reaches the array. A software update (UG) of a stopped
    /// counter sets CC1IF to CC4IF there where CCRx is zero, and real parts do not: embassy's clock would begin at half
    /// a period, and long sleeps could come late by as much. An HSE with nothing on its pin becomes ready there.
    pub fn correct<M: Memory + ?Sized>(&mut self, settled: &Settled, memory: &mut M) {
        let at = match settled {
            Settled::Access { access, .. } => {
                if access.kind == AccessKind::Write {
                    self.correct_write(access, memory);
                }
                access.virtual_time
            }
            Settled::Stop(stop) => stop.at,
            _ => return,
        };
        self.flash.serve(at, memory);
    }

    fn correct_write<M: Memory + ?Sized>(&mut self, access: &Access, memory: &mut M) {
        if flash::in_array(access.address) {
            let (registers, mut context) = self.inner.bus_mut().drive(access.virtual_time, self.flash_slot);
            self.flash.store(access, memory, registers, &mut context);
            return;
        }
        if access.address == RCC_CR && self.inner.rcc.crystals().0 == 0 {
            // Switched off before it is ready, it never is. What reads back is HSEON cleared, which a part would show set.
            let registers = self.inner.bus_mut().slot_mut(self.rcc_slot).registers_mut();
            let control = registers.get(rcc::Register::Cr);
            registers.set(rcc::Register::Cr, rcc::cr::HSEON.set(control, 0));
            return;
        }
        if access.value & 1 == 0 {
            return;
        }
        let Some(number) = GENERAL_TIMERS.iter().position(|base| access.address == base + EGR) else {
            return;
        };
        let (_, registers) = self.inner.timer(number);
        if registers.get(tim2::Register::Cr1) & 1 == 0 {
            let status = registers.get(tim2::Register::Sr);
            registers.set(tim2::Register::Sr, status & !CAPTURES);
        }
    }

    /// A power-on reset, which rigless 0.4.0 refuses on this part: a new part with the old one's chips on its buses.
    fn power_on(&mut self) {
        let (hse_hz, _) = self.inner.rcc.crystals();
        // What has assembled once does so again.
        let Ok(mut fresh) = powered(hse_hz, self.supply_mv) else {
            return;
        };
        for (fresh, old) in fresh.spi.iter_mut().zip(&mut self.inner.spi) {
            fresh.inherit(old);
        }
        for (fresh, old) in fresh.usart.iter_mut().zip(&mut self.inner.usart) {
            fresh.inherit(old);
        }
        self.inner = fresh;
    }
}

impl Mcu for Part {
    fn bus(&self) -> &Bus {
        self.inner.bus()
    }

    fn bus_mut(&mut self) -> &mut Bus {
        self.inner.bus_mut()
    }

    fn reset(&mut self, at: VirtualNanos, cause: ResetCause) {
        match cause {
            ResetCause::PowerOn => self.power_on(),
            _ => self.inner.reset(at, cause),
        }
        self.exti = Exti::default();
        let registers = self.inner.bus_mut().slot_mut(self.flash_slot).registers_mut();
        self.flash.restart(self.supply_mv, registers);
        if self.quiet.is_some() {
            self.quiet = Some(QuietTim1::default());
        }
        let driven: Vec<_> = self.driven.iter().map(|(pin, level)| (*pin, *level)).collect();
        for (pin, level) in driven {
            self.drive_port(at, pin, level);
        }
        self.apply_break(at);
    }

    fn poll(&mut self, now: VirtualNanos) {
        self.inner.poll(now);
    }

    fn split(&mut self, slot: usize) -> (&mut Bus, Option<&mut dyn ErasedDevice>) {
        if slot == self.exti_slot {
            return (self.inner.bus_mut(), Some(&mut self.exti));
        }
        if slot == self.flash_slot {
            return (self.inner.bus_mut(), Some(&mut self.flash));
        }
        if slot == self.tim1_slot
            && let Some(quiet) = &mut self.quiet
        {
            return (self.inner.bus_mut(), Some(quiet));
        }
        self.inner.split(slot)
    }
}
