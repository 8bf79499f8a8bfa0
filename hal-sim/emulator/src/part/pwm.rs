//! A TIM1 that keeps what it is told and wakes nobody.
//!
//! Modelled: the registers; the break input, which takes MOE away and holds it; the update flag by UG, and at the
//! repetition rate while its interrupt is enabled. Not modelled: the counter, the outputs' edges, dead time, captures.
//! What drives the motor is read off the registers, see [`Part::bridge`](super::Part::bridge).

use rigless::device::{Device, DeviceContext, Level, RegisterFile};
use rigless::soc::stm32f427::generated::tim1::Register;
use rigless::time::{EventId, VirtualNanos};

/// BDTR: the outputs are on.
pub(super) const MOE: u64 = 1 << 15;
/// BDTR: the break input is active high.
const BREAK_HIGH: u64 = 1 << 13;
/// BDTR: the break input counts.
const BREAK_ENABLE: u64 = 1 << 12;
/// SR and DIER: break.
const BREAK: u64 = 1 << 7;
/// SR, DIER and EGR: update.
const UPDATE: u64 = 1;
/// CR1: update requests of the overflow alone.
const UPDATE_BY_OVERFLOW: u64 = 1 << 2;
/// Clock of the timer after a reset, Hz.
const RESET_HZ: u64 = 16_000_000;
/// Shortest period of updates, ns.
const SHORTEST_NS: u64 = 1000;

/// The timer.
#[derive(Debug)]
pub(super) struct QuietTim1 {
    hz: u64,
    broken: Level,
    due: Option<(EventId, VirtualNanos)>,
    /// Levels of the break and update interrupts, the first two of the part's table.
    high: [bool; 2],
}

impl Default for QuietTim1 {
    fn default() -> Self {
        Self {
            hz: RESET_HZ,
            broken: Level::Low,
            due: None,
            high: [false; 2],
        }
    }
}

impl QuietTim1 {
    /// The level at the break input.
    pub(super) fn drive_break(&mut self, level: Level, registers: &mut RegisterFile, context: &mut DeviceContext<'_>) {
        self.broken = level;
        self.update(registers, context);
    }

    fn period_ns(&self, registers: &RegisterFile) -> u64 {
        let centred = registers.get(Register::Cr1) >> 5 & 3 != 0;
        let ticks = (registers.get(Register::Arr) + u64::from(!centred))
            * (registers.get(Register::Psc) + 1)
            * (registers.get(Register::Rcr) + 1);
        (ticks * 1_000_000_000 / self.hz.max(1)).max(SHORTEST_NS)
    }

    fn update(&mut self, registers: &mut RegisterFile, context: &mut DeviceContext<'_>) {
        let bdtr = registers.get(Register::Bdtr);
        let active = if bdtr & BREAK_HIGH != 0 {
            Level::High
        } else {
            Level::Low
        };
        if bdtr & BREAK_ENABLE != 0 && self.broken == active {
            registers.set(Register::Bdtr, bdtr & !MOE);
            registers.set(Register::Sr, registers.get(Register::Sr) | BREAK);
        }
        let shown = registers.get(Register::Sr) & registers.get(Register::Dier);
        for (position, flag) in [BREAK, UPDATE].into_iter().enumerate() {
            let wanted = shown & flag != 0;
            if wanted != self.high[position] {
                self.high[position] = wanted;
                if wanted {
                    context.raise(position);
                } else {
                    context.lower(position);
                }
            }
        }
        let runs = registers.get(Register::Cr1) & 1 == 1;
        if !runs || registers.get(Register::Dier) & UPDATE == 0 {
            self.due = None;
        } else if self.due.is_none() {
            let at = VirtualNanos(context.now().0 + self.period_ns(registers));
            self.due = Some((context.schedule(at), at));
        }
    }
}

impl Device for QuietTim1 {
    type Register = Register;

    fn write(&mut self, register: Register, value: u64, registers: &mut RegisterFile, context: &mut DeviceContext<'_>) {
        if register == Register::Egr {
            if value & UPDATE != 0 && registers.get(Register::Cr1) & UPDATE_BY_OVERFLOW == 0 {
                registers.set(Register::Sr, registers.get(Register::Sr) | UPDATE);
            }
            registers.set(Register::Egr, 0);
        }
        self.update(registers, context);
    }

    fn on_event(&mut self, event: EventId, registers: &mut RegisterFile, context: &mut DeviceContext<'_>) {
        let Some((_, at)) = self.due.filter(|(id, _)| *id == event) else {
            return;
        };
        registers.set(Register::Sr, registers.get(Register::Sr) | UPDATE);
        let next = VirtualNanos(at.0 + self.period_ns(registers));
        self.due = Some((context.schedule(next), next));
        self.update(registers, context);
    }

    fn on_clock(&mut self, hz: u64, _: &mut RegisterFile, _: &mut DeviceContext<'_>) {
        self.hz = hz;
    }

    fn reset(&mut self) {
        // The level at the pin is the board's.
        *self = Self {
            broken: self.broken,
            ..Self::default()
        };
    }
}
