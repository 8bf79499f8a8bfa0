//! The simulator's device models on the emulated part's wires.
//!
//! A model answers a whole transaction, a controller asks byte by byte. So each byte is answered by a copy of the model
//! that has heard the bytes so far, filled up to a length that the device understands; the model itself hears the
//! transaction once, at its end. Nothing of a model is written a second time.

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

/// Whoever listens on the serial port.
#[derive(Debug, Default)]
pub struct Listener {
    heard: Vec<(u64, u8)>,
}

impl Listener {
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

    fn transmit(&mut self, _: VirtualNanos) -> Option<u16> {
        None
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_burst_is_shorter_than_the_length_it_is_filled_to() {
        let [first, _] = BURST_COMMAND.to_be_bytes();
        // Reply, two identifiers, the words, and the CRC's two, of two bytes each.
        let longest = 2 * (1 + 2 + drivers::adis16495::BURST_WORDS + 2);
        assert!(<Adis16495 as Device>::length(first) >= longest);
    }
}
