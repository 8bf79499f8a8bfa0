//! The wires between the unit and its devices, in virtual time: what a board gives the firmware, given to
//! the same drivers and the same application on a host.
//!
//! | here | on the board | trait |
//! |---|---|---|
//! | [`SpiPort`] of a [`SpiBus`] | SPI with DMA and a chip select | `embedded_hal_async::spi::SpiDevice` |
//! | [`Input`], [`Output`] of a [`Line`] | EXTI input, output pin | `Wait`, `InputPin`; `StatefulOutputPin` |
//! | [`Input::rising`] | edge with the time captured in its interrupt | none: the application's own |
//! | [`UartRx`], [`UartTx`] | buffered UART | `embedded_io_async::{Read, Write}` |
//! | [`PwmSink`] | three-phase timer | `drivers::motor::ThreePhase` |
//! | [`Delay`] | the same | `DelayNs` |
//!
//! The devices are the models of [`crate::device`], each in a [`Part`] that its port and the simulator
//! share. Everything here lives on one thread and on the clock of its [`vtime::Executor`].
//!
//! Faults are set through the simulator's handle of each wire and act from that instant on. What passes
//! the wires is mixed into [`vtime::Executor::trace`]: two runs with one trace did the same.
//!
//! Not modelled: what a dropped transfer leaves half done in a device (the device has heard all of it);
//! contention of DMA streams; levels between high and low.

mod line;
mod pwm;
mod ready;
mod spi;
mod uart;

#[cfg(test)]
mod tests;

pub use embassy_time::Delay;
pub use line::{Input, Line, Output, Stamp};
pub use pwm::{PwmChange, PwmMonitor, PwmSink, pwm};
pub use ready::DataReady;
pub use spi::{Part, SpiBus, SpiError, SpiFaults, SpiPort, SpiTiming};
pub use uart::{UartConfig, UartError, UartFaults, UartHost, UartLine, UartRx, UartTx, uart};

use core::task::Waker;

/// The tasks that wait for something to change.
#[derive(Debug, Default)]
struct Waiters(Vec<Waker>);

impl Waiters {
    fn register(&mut self, waker: &Waker) {
        if !self.0.iter().any(|other| other.will_wake(waker)) {
            self.0.push(waker.clone());
        }
    }

    fn wake(&mut self) {
        for waker in self.0.drain(..) {
            waker.wake();
        }
    }
}

/// FNV-1a, for the trace.
fn digest(bytes: &[u8]) -> u64 {
    bytes.iter().fold(0xCBF2_9CE4_8422_2325, |hash, byte| {
        (hash ^ u64::from(*byte)).wrapping_mul(0x0100_0000_01B3)
    })
}
