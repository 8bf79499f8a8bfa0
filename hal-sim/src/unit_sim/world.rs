//! The physics around the unit: the motor with its load, moved up to the instant at which anybody looks.

use core::cell::RefCell;
use core::convert::Infallible;
use std::collections::VecDeque;
use std::rc::Rc;

use app::hal::{Cutoff, Watchdog};
use app::rotor::Side;
use drivers::motor::ThreePhase as _;
use embedded_hal::digital::{ErrorType, InputPin, OutputPin};
use nav::rotor::RotorState;
use vtime::now_ns;

use crate::bus::PwmMonitor;
use crate::plant::Plant;

/// Rotor states kept, for the intervals of the IMU's samples.
const KEPT: usize = 64;

/// The plant on the clock.
pub(super) struct Physics {
    pub(super) plant: Plant,
    monitor: PwmMonitor,
    at_ns: u64,
    /// (ns, angle, rate), in order of time.
    past: VecDeque<(u64, f64, f64)>,
    driven: bool,
    /// When the bridge last stopped driving the motor.
    pub(super) off_ns: u64,
    pub(super) fed_ns: u64,
}

impl Physics {
    pub(super) fn advance(&mut self, to_ns: u64) {
        while let Some(change) = self.monitor.next_until(to_ns) {
            self.integrate(change.at_ns);
            match change.duties {
                Some(duties) => self.plant.set_duties(duties),
                None => self.plant.outputs_off(),
            }
            self.note(change.at_ns);
        }
        self.integrate(to_ns);
    }

    fn integrate(&mut self, to_ns: u64) {
        if to_ns <= self.at_ns {
            return;
        }
        self.plant.advance((to_ns - self.at_ns) as f64 * 1e-9);
        self.at_ns = to_ns;
        if self.past.len() == KEPT {
            self.past.pop_front();
        }
        self.past.push_back((to_ns, self.plant.angle(), self.plant.rate()));
    }

    /// Looks whether the motor is driven.
    pub(super) fn note(&mut self, now_ns: u64) {
        let driven = self.plant.driven();
        if self.driven && !driven {
            self.off_ns = now_ns;
        }
        self.driven = driven;
    }

    /// Whether the bridge drives the motor.
    pub(super) fn driven(&self) -> bool {
        self.driven
    }

    /// The rotor at an instant of the last milliseconds; the oldest known where it is longer ago.
    pub(super) fn rotor_at(&self, ns: u64) -> RotorState<f64> {
        let state = |angle, rate| RotorState {
            angle,
            rate,
            acceleration: 0.0,
        };
        let mut after = None;
        for &(t, angle, rate) in self.past.iter().rev() {
            if t > ns {
                after = Some((t, angle, rate));
                continue;
            }
            let since = (ns - t) as f64 * 1e-9;
            return match after {
                // Neighbours are a millisecond apart or less: a line between the rates, the angle its integral.
                Some((later, _, rate_later)) => {
                    let slope = (rate_later - rate) / ((later - t) as f64 * 1e-9);
                    state(angle + (rate + 0.5 * slope * since) * since, rate + slope * since)
                }
                None => state(angle + rate * since, rate),
            };
        }
        let (_, angle, rate) = after.unwrap_or((0, self.plant.angle(), self.plant.rate()));
        state(angle, rate)
    }
}

/// The physics, shared by all that touches them.
#[derive(Clone)]
pub(super) struct World(Rc<RefCell<Physics>>);

impl World {
    pub(super) fn new(mut plant: Plant, monitor: PwmMonitor) -> Self {
        plant.outputs_off();
        plant.set_enabled(false);
        Self(Rc::new(RefCell::new(Physics {
            plant,
            monitor,
            at_ns: 0,
            past: VecDeque::with_capacity(KEPT),
            driven: false,
            off_ns: 0,
            fed_ns: 0,
        })))
    }

    /// The physics, moved up to `ns`.
    pub(super) fn at<R>(&self, ns: u64, look: impl FnOnce(&mut Physics) -> R) -> R {
        let mut physics = self.0.borrow_mut();
        physics.advance(ns);
        look(&mut physics)
    }

    /// The physics now.
    pub(super) fn now<R>(&self, look: impl FnOnce(&mut Physics) -> R) -> R {
        self.at(now_ns(), look)
    }

    pub(super) fn pins(&self) -> (EnablePin, FaultPin, HomePin, HomePin) {
        let home = |side| HomePin {
            world: self.clone(),
            side,
        };
        (
            EnablePin(self.clone()),
            FaultPin(self.clone()),
            home(Side::Below),
            home(Side::Above),
        )
    }
}

/// The bridge's enable line.
pub(super) struct EnablePin(World);

impl ErrorType for EnablePin {
    type Error = Infallible;
}

impl EnablePin {
    fn set(&self, level: bool) {
        self.0.now(|physics| {
            physics.plant.set_enabled(level);
            physics.note(now_ns());
        });
    }
}

impl OutputPin for EnablePin {
    fn set_low(&mut self) -> Result<(), Infallible> {
        self.set(false);
        Ok(())
    }

    fn set_high(&mut self) -> Result<(), Infallible> {
        self.set(true);
        Ok(())
    }
}

/// The bridge's fault line, low in fault.
pub(super) struct FaultPin(World);

impl ErrorType for FaultPin {
    type Error = Infallible;
}

impl InputPin for FaultPin {
    fn is_high(&mut self) -> Result<bool, Infallible> {
        Ok(self.0.now(|physics| !physics.plant.faults.driver_fault))
    }

    fn is_low(&mut self) -> Result<bool, Infallible> {
        self.is_high().map(|high| !high)
    }
}

/// One contact of the home switch.
pub(super) struct HomePin {
    world: World,
    side: Side,
}

impl ErrorType for HomePin {
    type Error = Infallible;
}

impl InputPin for HomePin {
    fn is_high(&mut self) -> Result<bool, Infallible> {
        Ok(self.world.now(|physics| physics.plant.home()) == Some(self.side))
    }

    fn is_low(&mut self) -> Result<bool, Infallible> {
        self.is_high().map(|high| !high)
    }
}

/// The registers that take the outputs away past the motor's loop.
impl Cutoff for World {
    fn cut(&mut self) {
        self.now(|physics| {
            physics.plant.outputs_off();
            physics.plant.set_enabled(false);
            physics.note(now_ns());
        });
    }
}

impl Watchdog for World {
    fn feed(&mut self) {
        self.0.borrow_mut().fed_ns = now_ns();
    }
}
