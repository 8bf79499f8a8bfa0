//! A bench for one device: the drivers' bus and delay traits over a model, in a virtual time of its own
//! that moves with bus clocks and delays. Nothing ever waits, so any executor runs it to the end in one
//! poll.

use core::cell::{Cell, RefCell};
use core::convert::Infallible;
use std::rc::Rc;

use embedded_hal_async::delay::DelayNs;
use embedded_hal_async::spi::{ErrorType, Operation, SpiDevice};

use super::SpiTarget;
use super::stream::{gather, scatter};

/// Chip select is high this long between two transactions, ns.
const GAP_NS: u64 = 200;

/// A device and its time.
#[derive(Debug)]
pub struct Bench<T> {
    device: Rc<RefCell<T>>,
    now_ns: Rc<Cell<u64>>,
    clock_hz: u32,
}

impl<T: SpiTarget> Bench<T> {
    /// Puts a device on a bus of `clock_hz`, at time 0.
    pub fn new(device: T, clock_hz: u32) -> Self {
        Self {
            device: Rc::new(RefCell::new(device)),
            now_ns: Rc::default(),
            clock_hz: clock_hz.max(1),
        }
    }

    /// The bus, for a driver.
    pub fn spi(&self) -> BenchSpi<T> {
        BenchSpi {
            device: Rc::clone(&self.device),
            now_ns: Rc::clone(&self.now_ns),
            clock_hz: self.clock_hz,
        }
    }

    /// The delay, for a driver.
    pub fn delay(&self) -> BenchDelay {
        BenchDelay {
            now_ns: Rc::clone(&self.now_ns),
        }
    }

    /// The time, µs.
    pub fn now_us(&self) -> u64 {
        self.now_ns.get() / 1000
    }

    /// Lets time pass until `t_us`; never back.
    pub fn advance_to_us(&self, t_us: u64) {
        self.now_ns.set(self.now_ns.get().max(t_us * 1000));
    }

    /// Does something with the device.
    pub fn with<R>(&self, body: impl FnOnce(&mut T) -> R) -> R {
        body(&mut self.device.borrow_mut())
    }
}

/// The bus of a [`Bench`].
#[derive(Debug)]
pub struct BenchSpi<T> {
    device: Rc<RefCell<T>>,
    now_ns: Rc<Cell<u64>>,
    clock_hz: u32,
}

impl<T> ErrorType for BenchSpi<T> {
    type Error = Infallible;
}

impl<T: SpiTarget> SpiDevice for BenchSpi<T> {
    /// The operations are one assertion of chip select: the device sees their bytes as one stream. Delays
    /// count as if they came after the bytes.
    async fn transaction(&mut self, operations: &mut [Operation<'_, u8>]) -> Result<(), Infallible> {
        let mut mosi = Vec::new();
        let delay_ns = GAP_NS + gather(operations, &mut mosi);
        let mut miso = vec![0; mosi.len()];
        self.device
            .borrow_mut()
            .transfer(self.now_ns.get() / 1000, &mosi, &mut miso);
        scatter(&miso, operations);
        let bits_ns = mosi.len() as u64 * 8_000_000_000 / u64::from(self.clock_hz);
        self.now_ns.set(self.now_ns.get() + bits_ns + delay_ns);
        Ok(())
    }
}

/// The delay of a [`Bench`].
#[derive(Debug)]
pub struct BenchDelay {
    now_ns: Rc<Cell<u64>>,
}

impl DelayNs for BenchDelay {
    async fn delay_ns(&mut self, ns: u32) {
        self.now_ns.set(self.now_ns.get() + u64::from(ns));
    }
}

#[cfg(test)]
mod tests {
    use embassy_futures::block_on;

    use super::*;

    /// Answers with the complement of what it hears.
    struct Mirror;

    impl SpiTarget for Mirror {
        fn transfer(&mut self, _: u64, mosi: &[u8], miso: &mut [u8]) {
            for (reply, sent) in miso.iter_mut().zip(mosi) {
                *reply = !sent;
            }
        }
    }

    #[test]
    fn operations_are_one_stream_and_cost_time() {
        let bench = Bench::new(Mirror, 1_000_000);
        let mut read = [0; 2];
        let mut both = [0x0F];
        let mut short = [0];
        block_on(bench.spi().transaction(&mut [
            Operation::Write(&[1, 2]),
            Operation::Read(&mut read),
            Operation::TransferInPlace(&mut both),
            Operation::Transfer(&mut short, &[0xA0, 0xB0]),
            Operation::DelayNs(5_000),
        ]))
        .unwrap();
        assert_eq!((read, both, short), ([0xFF, 0xFF], [0xF0], [0x5F]));
        // Seven bytes at 1 MHz, five microseconds of delay, and the gap.
        assert_eq!(bench.now_us(), 61);
        block_on(bench.delay().delay_us(39));
        assert_eq!(bench.now_us(), 100);
    }
}
