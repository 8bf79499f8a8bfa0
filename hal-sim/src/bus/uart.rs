//! UART: bytes that take ten bit times each, buffers on the unit's side, and the other end.

use core::cell::RefCell;
use core::fmt;
use core::future::{Future, poll_fn};
use core::pin::Pin;
use core::task::{Context, Poll};
use std::collections::VecDeque;
use std::rc::Rc;

use app::record;
use embedded_io_async::{Error, ErrorKind, ErrorType, Read, Write};
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use vtime::{look, mark, now_ns, sleep_until_ns};

use super::Waiters;

/// Start bit, eight data bits, stop bit.
const BITS: u64 = 10;

/// Line and buffers.
///
/// | field | unit | zero means | sane value |
/// |---|---|---|---|
/// | `baud` | 1/s | one bit a second | 115 200 |
/// | `rx_buffer` | bytes | one byte | as in the firmware: 256 |
/// | `tx_buffer` | bytes | one byte | as in the firmware: 1024 |
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct UartConfig {
    /// Bits a second.
    pub baud: u32,
    /// Bytes that are kept for a reader who is late.
    pub rx_buffer: usize,
    /// Bytes a writer may be ahead of the line.
    pub tx_buffer: usize,
}

impl Default for UartConfig {
    fn default() -> Self {
        Self {
            baud: 115_200,
            rx_buffer: 256,
            tx_buffer: 1024,
        }
    }
}

/// Faults of the line. They act on bytes as they are put on it.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct UartFaults {
    /// Probability of a byte to the unit to get one wrong bit.
    pub flip_to_unit: f64,
    /// Probability of a byte from the unit to get one wrong bit.
    pub flip_to_host: f64,
    /// Bytes to the unit still to get one wrong bit.
    pub bad_to_unit: u32,
    /// Bytes to the unit still to come without a stop bit.
    pub framing_to_unit: u32,
    /// The line is broken, both ways.
    pub cut: bool,
}

/// What the receiver reports.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum UartError {
    /// The buffer was full, and bytes are lost.
    Overrun,
    /// A byte without stop bit.
    Framing,
}

impl fmt::Display for UartError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Overrun => "overrun",
            Self::Framing => "framing error",
        })
    }
}

impl core::error::Error for UartError {}

impl Error for UartError {
    fn kind(&self) -> ErrorKind {
        match self {
            Self::Overrun => ErrorKind::Other,
            Self::Framing => ErrorKind::InvalidData,
        }
    }
}

type Received = Result<u8, UartError>;

#[derive(Debug)]
struct Wire {
    config: UartConfig,
    byte_ns: u64,
    faults: UartFaults,
    rng: ChaCha8Rng,
    /// On the way to the unit, with the time of arrival.
    to_unit: VecDeque<(u64, Received)>,
    to_unit_free_ns: u64,
    /// Arrived in the unit's buffer.
    received: VecDeque<Received>,
    overruns: u64,
    reader: Waiters,
    /// Ends of the bytes in the unit's transmit buffer.
    sending: VecDeque<u64>,
    to_host_free_ns: u64,
    /// On the way to the host, or there, with the time of arrival.
    to_host: VecDeque<(u64, u8)>,
    host: Waiters,
}

impl Wire {
    /// Lets arrive what has arrived. A byte that finds the buffer full is lost, and the loss is reported in
    /// the place of the first of them.
    fn receive(&mut self) {
        let now_ns = now_ns();
        while let Some((_, byte)) = self.to_unit.pop_front_if(|(at_ns, _)| *at_ns <= now_ns) {
            if self.received.len() < self.config.rx_buffer.max(1) {
                self.received.push_back(byte);
            } else {
                self.overruns += 1;
                if self.received.back() != Some(&Err(UartError::Overrun)) {
                    self.received.push_back(Err(UartError::Overrun));
                }
            }
        }
    }

    /// Bytes that still fit the unit's transmit buffer.
    fn room(&mut self) -> usize {
        let now_ns = now_ns();
        while self.sending.pop_front_if(|end_ns| *end_ns <= now_ns).is_some() {}
        self.config.tx_buffer.max(1).saturating_sub(self.sending.len())
    }

    /// The byte as the line's noise leaves it. Draws the same numbers whatever the faults.
    fn noise(&mut self, byte: u8, probability: f64, certain: bool) -> u8 {
        let (draw, bit) = (self.rng.random::<f64>(), self.rng.random_range(0..8_u8));
        if certain || draw < probability {
            byte ^ (1 << bit)
        } else {
            byte
        }
    }

    fn put_to_unit(&mut self, byte: u8) {
        let bad = self.faults.bad_to_unit > 0;
        let byte = self.noise(byte, self.faults.flip_to_unit, bad);
        self.faults.bad_to_unit -= u32::from(bad);
        self.to_unit_free_ns = self.to_unit_free_ns.max(now_ns()) + self.byte_ns;
        if self.faults.cut {
            return;
        }
        let framing = self.faults.framing_to_unit > 0;
        self.faults.framing_to_unit -= u32::from(framing);
        let byte = if framing { Err(UartError::Framing) } else { Ok(byte) };
        self.to_unit.push_back((self.to_unit_free_ns, byte));
    }

    fn put_to_host(&mut self, byte: u8, heard: bool) {
        mark(u64::from(byte));
        let noisy = self.noise(byte, self.faults.flip_to_host, false);
        self.to_host_free_ns = self.to_host_free_ns.max(now_ns()) + self.byte_ns;
        self.sending.push_back(self.to_host_free_ns);
        if heard && !self.faults.cut {
            self.to_host.push_back((self.to_host_free_ns, noisy));
        }
    }
}

type Shared = Rc<RefCell<Wire>>;

/// A line: the unit's receiver and transmitter, and the other end. `rng` is for the noise.
pub fn uart(config: UartConfig, rng: ChaCha8Rng) -> (UartRx, UartTx, UartHost) {
    let wire = Rc::new(RefCell::new(Wire {
        config,
        byte_ns: BITS * 1_000_000_000 / u64::from(config.baud.max(1)),
        faults: UartFaults::default(),
        rng,
        to_unit: VecDeque::new(),
        to_unit_free_ns: 0,
        received: VecDeque::new(),
        overruns: 0,
        reader: Waiters::default(),
        sending: VecDeque::new(),
        to_host_free_ns: 0,
        to_host: VecDeque::new(),
        host: Waiters::default(),
    }));
    let host = Rc::new(());
    (
        UartRx(Rc::clone(&wire)),
        UartTx {
            wire: Rc::clone(&wire),
            host: Rc::downgrade(&host),
        },
        UartHost {
            wire,
            line: Vec::new(),
            started_ns: 0,
            _alive: host,
        },
    )
}

/// Waits for an instant as part of another future.
fn poll_at(at_ns: u64, cx: &mut Context<'_>) -> Poll<()> {
    Pin::new(&mut sleep_until_ns(at_ns)).poll(cx)
}

/// The unit's receiver.
#[derive(Debug)]
pub struct UartRx(Shared);

impl ErrorType for UartRx {
    type Error = UartError;
}

impl Read for UartRx {
    /// Cancellation: safe, nothing is taken before it is returned.
    async fn read(&mut self, buf: &mut [u8]) -> Result<usize, UartError> {
        if buf.is_empty() {
            return Ok(0);
        }
        poll_fn(|cx| {
            look();
            let wire = &mut *self.0.borrow_mut();
            wire.receive();
            match wire.received.front() {
                None => {
                    wire.reader.register(cx.waker());
                    if let Some((at_ns, _)) = wire.to_unit.front() {
                        // Not due yet, or it would have been received.
                        let _ = poll_at(*at_ns, cx);
                    }
                    Poll::Pending
                }
                Some(Err(error)) => {
                    let error = *error;
                    wire.received.pop_front();
                    Poll::Ready(Err(error))
                }
                Some(Ok(_)) => {
                    let mut n = 0;
                    for to in buf.iter_mut() {
                        let Some(Ok(byte)) = wire.received.pop_front_if(|byte| byte.is_ok()) else {
                            break;
                        };
                        *to = byte;
                        n += 1;
                    }
                    Poll::Ready(Ok(n))
                }
            }
        })
        .await
    }
}

/// The unit's transmitter.
#[derive(Debug)]
pub struct UartTx {
    wire: Shared,
    /// Whether somebody listens: bytes for nobody are not kept.
    host: std::rc::Weak<()>,
}

impl ErrorType for UartTx {
    type Error = UartError;
}

impl Write for UartTx {
    /// Returns once bytes are in the buffer. Cancellation: safe.
    async fn write(&mut self, buf: &[u8]) -> Result<usize, UartError> {
        if buf.is_empty() {
            return Ok(0);
        }
        poll_fn(|cx| {
            look();
            let wire = &mut *self.wire.borrow_mut();
            let n = wire.room().min(buf.len());
            if n == 0 {
                if let Some(end_ns) = wire.sending.front() {
                    let _ = poll_at(*end_ns, cx);
                }
                return Poll::Pending;
            }
            let heard = self.host.strong_count() > 0;
            for byte in &buf[..n] {
                wire.put_to_host(*byte, heard);
            }
            wire.host.wake();
            Poll::Ready(Ok(n))
        })
        .await
    }

    /// Returns with the last stop bit.
    async fn flush(&mut self) -> Result<(), UartError> {
        let end_ns = self.wire.borrow().to_host_free_ns;
        sleep_until_ns(end_ns).await;
        Ok(())
    }
}

/// A line of text from the unit, or a frame of its record.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct UartLine {
    /// End of its first byte.
    pub started_ns: u64,
    /// End of its last byte.
    pub ended_ns: u64,
    /// The bytes, to the line feed or the end of the frame.
    pub bytes: Vec<u8>,
}

/// The other end of the line.
#[derive(Debug)]
pub struct UartHost {
    wire: Shared,
    /// What [`UartHost::line`] has so far.
    line: Vec<u8>,
    started_ns: u64,
    _alive: Rc<()>,
}

impl UartHost {
    /// Sends bytes to the unit, after those already on the way.
    pub fn send(&self, bytes: &[u8]) {
        let wire = &mut *self.wire.borrow_mut();
        for byte in bytes {
            wire.put_to_unit(*byte);
        }
        wire.reader.wake();
    }

    /// The bytes that have come from the unit, each with the time of its end, ns.
    pub fn received(&mut self) -> Vec<(u64, u8)> {
        let wire = &mut *self.wire.borrow_mut();
        let now_ns = now_ns();
        core::iter::from_fn(|| wire.to_host.pop_front_if(|(at_ns, _)| *at_ns <= now_ns)).collect()
    }

    /// The next whole line from the unit, or the next frame.
    ///
    /// Cancellation: safe; what has come of the line is kept for the next call.
    pub async fn line(&mut self) -> UartLine {
        poll_fn(|cx| {
            let wire = &mut *self.wire.borrow_mut();
            let now_ns = now_ns();
            while let Some((at_ns, byte)) = wire.to_host.pop_front_if(|(at_ns, _)| *at_ns <= now_ns) {
                if self.line.is_empty() {
                    self.started_ns = at_ns;
                }
                self.line.push(byte);
                if self.ends(byte, self.line.len()) {
                    return Poll::Ready(UartLine {
                        started_ns: self.started_ns,
                        ended_ns: at_ns,
                        bytes: core::mem::take(&mut self.line),
                    });
                }
            }
            wire.host.register(cx.waker());
            // To be woken once for a line, not for each byte: at its end, as far as it is on the way.
            let mut count = self.line.len();
            let end = wire.to_host.iter().find(|(_, byte)| {
                count += 1;
                self.ends(*byte, count)
            });
            if let Some((end_ns, _)) = end {
                let _ = poll_at(*end_ns, cx);
            }
            Poll::Pending
        })
        .await
    }

    /// Whether the line is whole with this byte, which is the `count`th.
    fn ends(&self, byte: u8, count: usize) -> bool {
        match self.line[..] {
            [record::SYNC, body, ..] => count >= record::LEAD + usize::from(body) + record::CRC,
            [record::SYNC] => false,
            _ => byte == b'\n',
        }
    }

    /// Faults of the line from now on.
    pub fn set_faults(&self, faults: UartFaults) {
        self.wire.borrow_mut().faults = faults;
    }

    /// Faults still to come.
    pub fn faults(&self) -> UartFaults {
        self.wire.borrow().faults
    }

    /// Bytes the unit lost because it did not read in time.
    pub fn overruns(&self) -> u64 {
        self.wire.borrow().overruns
    }
}
