//! The simulator's device models on the emulated part's wires.
//!
//! A model answers a whole transaction, a controller asks byte by byte. So each byte is answered by a copy of the model
//! that has heard the bytes so far, filled up to a length that the device understands; the model itself hears the
//! transaction once, at its end. Nothing of a model is written a second time.

use std::collections::VecDeque;
use std::fmt::Debug;

use drivers::adis16495::BURST_COMMAND;
use hal_sim::device::{Adis16495, Mt6835, SpiTarget};
use rigless::chip::spi::Peer;
use rigless::chip::{Timeline, uart};
use rigless::snapshot::Store;
use rigless::time::VirtualNanos;

/// A device model that a [`Wired`] can stand for.
pub trait Device: SpiTarget + Clone + Debug + Send + 'static {
    /// Length of the transaction that begins with this byte, or of a longer one.
    fn length(first: u8) -> usize;

    /// Chip select falls.
    fn selected(&mut self, _now_ns: u64) {}
}

impl Device for Adis16495 {
    fn length(first: u8) -> usize {
        // Reply to the frame before, two identifiers, 15 words, CRC.
        if first == BURST_COMMAND.to_be_bytes()[0] { 40 } else { 2 }
    }
}

/// The encoder with the shaft that turns it.
#[derive(Debug, Clone)]
pub struct Encoder {
    /// The part.
    pub model: Mt6835,
    /// The shaft's angle, rad, with its noise, at …
    pub angle: f64,
    /// … this time, ns, turning on at …
    pub at_ns: u64,
    /// … this rate, rad/s.
    pub rate: f64,
}

impl SpiTarget for Encoder {
    fn transfer(&mut self, now_us: u64, mosi: &[u8], miso: &mut [u8]) {
        self.model.transfer(now_us, mosi, miso);
    }
}

impl Device for Encoder {
    fn length(_: u8) -> usize {
        // Operation and address, angle and warnings, CRC.
        6
    }

    fn selected(&mut self, now_ns: u64) {
        let since = now_ns.saturating_sub(self.at_ns) as f64 * 1e-9;
        self.model.set_angle(self.angle + self.rate * since);
    }
}

/// A device on an SPI bus of the part.
#[derive(Debug)]
pub struct Wired<D> {
    /// The device.
    pub device: D,
    heard: Vec<u8>,
    since_us: u64,
}

impl<D> Wired<D> {
    /// Puts a device on wires.
    pub fn new(device: D) -> Self {
        Self {
            device,
            heard: Vec::new(),
            since_us: 0,
        }
    }
}

// Nothing here is ever saved.
impl<D> Store for Wired<D> {}

impl<D: Device> Peer for Wired<D> {
    fn select(&mut self, timeline: &mut Timeline<'_, '_>) {
        let now_ns = timeline.now().0;
        self.heard.clear();
        self.since_us = now_ns / 1000;
        self.device.selected(now_ns);
    }

    fn transfer(&mut self, mosi: u32, _bits: u8, _: &mut Timeline<'_, '_>) -> u32 {
        let position = self.heard.len();
        self.heard.push(mosi as u8);
        let mut sent = self.heard.clone();
        // Frames of 16 bits: an odd length would be a fault of the driver.
        sent.resize(D::length(sent[0]).max(sent.len().next_multiple_of(2)), 0);
        let mut reply = vec![0; sent.len()];
        self.device.clone().transfer(self.since_us, &sent, &mut reply);
        u32::from(reply[position])
    }

    fn deselect(&mut self, _: &mut Timeline<'_, '_>) {
        let heard = core::mem::take(&mut self.heard);
        if !heard.is_empty() {
            self.device.transfer(self.since_us, &heard, &mut vec![0; heard.len()]);
        }
    }
}

/// Time of a character, ns: ten bits at 115200 baud.
const CHARACTER_NS: u64 = 10 * 1_000_000_000 / 115_200;
/// How far a character may be off its time, ns. The receiver is looked at between two characters or at a stop; its rate
/// is off by a thousandth, a tenth of a character in a line.
const LATE_NS: u64 = 3 * CHARACTER_NS;

/// Whoever is at the other end of the serial port: listens, and types.
///
/// Not modelled: the rate on this end. The controller times what it hears by its own.
#[derive(Debug, Default)]
pub struct Listener {
    heard: Vec<(u64, u8)>,
    /// What is still to be sent, with its time.
    typed: VecDeque<(u64, u8)>,
    /// When the last of it has been sent.
    free_ns: u64,
}

impl Listener {
    /// Types a line from `at_ns` on, or after what is being typed: one character after the other, then CR LF. It goes
    /// over the wire whether anybody receives it or not.
    pub fn type_line(&mut self, at_ns: u64, line: &str) {
        let mut at_ns = at_ns.max(self.free_ns);
        for byte in line.bytes().chain(*b"\r\n") {
            self.typed.push_back((at_ns, byte));
            at_ns += CHARACTER_NS;
        }
        self.free_ns = at_ns;
    }

    /// Takes what was heard: (ns of the stop bit's end, byte).
    pub fn take(&mut self) -> Vec<(u64, u8)> {
        core::mem::take(&mut self.heard)
    }
}

impl Store for Listener {}

impl uart::Peer for Listener {
    fn receive(&mut self, word: u16, timeline: &mut Timeline<'_, '_>) {
        self.heard.push((timeline.now().0, word as u8));
    }

    fn transmit(&mut self, now: VirtualNanos) -> Option<u16> {
        // Asked by a receiver that is on and free: what should have gone long ago came while it was neither.
        while self.typed.front().is_some_and(|(at_ns, _)| at_ns + LATE_NS < now.0) {
            self.typed.pop_front();
        }
        let due = self.typed.front().is_some_and(|(at_ns, _)| *at_ns < now.0 + LATE_NS);
        let (_, byte) = due.then(|| self.typed.pop_front()).flatten()?;
        Some(byte.into())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_typed_goes_by_its_time() {
        use rigless::chip::uart::Peer as _;
        let mut listener = Listener::default();
        let mut sent = |at_ns| listener.transmit(VirtualNanos(at_ns)).map(|word| word as u8 as char);
        assert_eq!(sent(0), None);
        listener.type_line(1_000_000, "ab");
        listener.type_line(1_000_000, "c");
        let mut sent = |at_ns| listener.transmit(VirtualNanos(at_ns)).map(|word| word as u8 as char);
        assert_eq!(sent(500_000), None);
        // A receiver that is 0.1 % fast.
        let heard: String = (0..5).filter_map(|k| sent(1_000_000 + k * 86_719)).collect();
        assert_eq!(heard, "ab\r\nc");
        // One that was off in between.
        assert_eq!(sent(5_000_000), None);
        assert_eq!(listener.typed.len(), 0);
    }

    #[test]
    fn a_burst_is_shorter_than_the_length_it_is_filled_to() {
        let [first, _] = BURST_COMMAND.to_be_bytes();
        // Reply, two identifiers, the words, and the CRC's two, of two bytes each.
        let longest = 2 * (1 + 2 + drivers::adis16495::BURST_WORDS + 2);
        assert!(<Adis16495 as Device>::length(first) >= longest);
    }
}
