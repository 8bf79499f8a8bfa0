//! SPI: devices under chip select on buses that take their time.

use core::cell::{Cell, RefCell};
use core::fmt;
use core::task::Waker;
use std::rc::Rc;

use embedded_hal_async::spi::{Error, ErrorKind, ErrorType, Operation, SpiDevice};
use vtime::{mark, now_ns, sleep_until_ns};

use super::{Waiters, digest};
use crate::device::SpiTarget;
use crate::device::stream::{gather, scatter};

/// How long things take on a bus.
///
/// ```text
///          ┌── setup ──┬── bytes and delays ──┬── hold ──┐            ┌─ next
/// CS  ─────┘                                             └── ≥ gap ───┘
///                                                        └─ latency ─→ the task goes on
/// ```
///
/// | field | unit | zero means | sane value |
/// |---|---|---|---|
/// | `clock_hz` | Hz | 1 Hz | what `board.rs` sets: 4 MHz for the ADIS16495, 8 MHz for the MT6835 |
/// | `setup_ns`, `hold_ns`, `gap_ns` | ns | at once | 200 |
/// | `latency_ns` | ns | the task runs at the last clock | 20 000: DMA interrupt and executor |
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct SpiTiming {
    /// Bus clock, Hz.
    pub clock_hz: u32,
    /// From chip select to the first clock.
    pub setup_ns: u32,
    /// From the last clock to the end of chip select.
    pub hold_ns: u32,
    /// Least time between two transactions on the bus.
    pub gap_ns: u32,
    /// From the end of chip select until the task goes on. The bus is free in the meantime.
    pub latency_ns: u32,
}

impl SpiTiming {
    /// A bus of this clock: 200 ns around chip select, no latency.
    pub const fn at(clock_hz: u32) -> Self {
        Self {
            clock_hz,
            setup_ns: 200,
            hold_ns: 200,
            gap_ns: 200,
            latency_ns: 0,
        }
    }

    /// How long so many bytes are clocked.
    pub fn bytes_ns(&self, bytes: usize) -> u64 {
        bytes as u64 * 8_000_000_000 / u64::from(self.clock_hz.max(1))
    }
}

/// Faults of the bus itself. Those of a device are the model's.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct SpiFaults {
    /// Transactions still to end in an overrun, unheard by the device.
    pub errors: u32,
    /// Transactions with this device never end. One that began so never will, also after the fault is
    /// gone: drop it.
    pub stuck: bool,
}

/// What a bus reports.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct SpiError(pub ErrorKind);

impl Error for SpiError {
    fn kind(&self) -> ErrorKind {
        self.0
    }
}

impl fmt::Display for SpiError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.0.fmt(f)
    }
}

impl core::error::Error for SpiError {}

type Before<T> = Box<dyn FnMut(&mut T, u64)>;

struct Shared<T> {
    model: RefCell<T>,
    before: RefCell<Option<Before<T>>>,
    touched: RefCell<Waiters>,
    faults: Cell<SpiFaults>,
}

/// A device in the hands of both its port and the simulator. Clones are the same device.
pub struct Part<T>(Rc<Shared<T>>);

impl<T> Clone for Part<T> {
    fn clone(&self) -> Self {
        Self(Rc::clone(&self.0))
    }
}

impl<T> fmt::Debug for Part<T> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Part")
            .field("faults", &self.0.faults)
            .finish_non_exhaustive()
    }
}

impl<T> Part<T> {
    /// Shares a model.
    pub fn new(model: T) -> Self {
        Self(Rc::new(Shared {
            model: RefCell::new(model),
            before: RefCell::default(),
            touched: RefCell::default(),
            faults: Cell::default(),
        }))
    }

    /// Does something with the model.
    ///
    /// # Panics
    /// Inside itself.
    pub fn with<R>(&self, body: impl FnOnce(&mut T) -> R) -> R {
        body(&mut self.0.model.borrow_mut())
    }

    /// Called with the model and the time in ns before each transaction: the place to move the physics up
    /// to the instant at which the device looks at it. It has the model already: [`Part::with`] panics
    /// there.
    pub fn before(&self, hook: impl FnMut(&mut T, u64) + 'static) {
        *self.0.before.borrow_mut() = Some(Box::new(hook));
    }

    /// Faults of its bus from now on.
    pub fn set_faults(&self, faults: SpiFaults) {
        self.0.faults.set(faults);
    }

    /// Faults still to come.
    pub fn faults(&self) -> SpiFaults {
        self.0.faults.get()
    }

    /// Wakes `waker` once the device has been spoken to.
    pub(super) fn on_touch(&self, waker: &Waker) {
        self.0.touched.borrow_mut().register(waker);
    }
}

/// A bus. Its transactions come one at a time, in the order of asking. Clones are the same bus.
#[derive(Debug, Clone, Default)]
pub struct SpiBus {
    /// When the next transaction may begin, ns. Everyone who asks moves it on by what he needs.
    free_ns: Rc<Cell<u64>>,
}

impl SpiBus {
    /// A bus without devices.
    pub fn new() -> Self {
        Self::default()
    }

    /// A driver's access to a device on this bus.
    pub fn port<T: SpiTarget>(&self, part: &Part<T>, timing: SpiTiming) -> SpiPort<T> {
        SpiPort {
            bus: self.clone(),
            part: part.clone(),
            timing,
            mosi: Vec::new(),
            miso: Vec::new(),
        }
    }
}

/// A device as its driver sees it.
#[derive(Debug)]
pub struct SpiPort<T> {
    bus: SpiBus,
    part: Part<T>,
    timing: SpiTiming,
    mosi: Vec<u8>,
    miso: Vec<u8>,
}

impl<T: SpiTarget> SpiPort<T> {
    /// A device on a bus of its own.
    pub fn alone(part: &Part<T>, timing: SpiTiming) -> Self {
        SpiBus::new().port(part, timing)
    }

    /// What the device hears and says, at the first clock.
    fn exchange(&mut self, at_ns: u64) {
        if let Some(before) = self.part.0.before.borrow_mut().as_mut() {
            before(&mut self.part.0.model.borrow_mut(), at_ns);
        }
        self.part
            .0
            .model
            .borrow_mut()
            .transfer(at_ns / 1000, &self.mosi, &mut self.miso);
        mark(digest(&self.mosi) ^ digest(&self.miso).rotate_left(1));
        self.part.0.touched.borrow_mut().wake();
    }
}

impl<T> ErrorType for SpiPort<T> {
    type Error = SpiError;
}

impl<T: SpiTarget> SpiDevice for SpiPort<T> {
    /// One assertion of chip select. The device hears all of it at the first clock and the buffers are
    /// filled at the end.
    ///
    /// Cancellation: a transaction that is dropped keeps its time on the bus. Once begun, the device has
    /// heard everything; the buffers are as they were.
    async fn transaction(&mut self, operations: &mut [Operation<'_, u8>]) -> Result<(), SpiError> {
        let delay_ns = gather(operations, &mut self.mosi);
        self.miso.clear();
        self.miso.resize(self.mosi.len(), 0);
        let SpiTiming {
            setup_ns,
            hold_ns,
            gap_ns,
            latency_ns,
            ..
        } = self.timing;
        let begin_ns = self.bus.free_ns.get().max(now_ns());
        let first_ns = begin_ns + u64::from(setup_ns);
        let end_ns = first_ns + self.timing.bytes_ns(self.mosi.len()) + delay_ns + u64::from(hold_ns);
        self.bus.free_ns.set(end_ns + u64::from(gap_ns));
        sleep_until_ns(first_ns).await;
        let mut faults = self.part.faults();
        if faults.stuck {
            core::future::pending::<()>().await;
        }
        if faults.errors > 0 {
            faults.errors -= 1;
            self.part.set_faults(faults);
            sleep_until_ns(end_ns).await;
            return Err(SpiError(ErrorKind::Overrun));
        }
        self.exchange(first_ns);
        sleep_until_ns(end_ns + u64::from(latency_ns)).await;
        scatter(&self.miso, operations);
        Ok(())
    }
}
