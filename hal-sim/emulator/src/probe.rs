//! An arbitrary image on the bare part: run it for a while, read back its memory by symbol.
//!
//! For images that measure: no device hangs on any bus, no pin is driven. Linked as the firmware is, flash from
//! 0x0800_0000, they leave what they found in statics.

use std::collections::BTreeMap;

use rigless::emulator::{self, Driver, Host, Settled, Start, Stop};
use rigless::session::Session;
use rigless::soc::Width;
use rigless::time::VirtualNanos;

use crate::board::Board;
use crate::error::Error;
use crate::image::Image;
use crate::part::BridgeTimer;

/// From one look at the image's memory to the next, ns.
const LOOK_NS: u64 = 1_000_000;

/// What is run, and what is read.
#[derive(Debug, Clone, Copy)]
pub struct Probe<'a> {
    /// Longest virtual time, ms.
    pub limit_ms: u64,
    /// A static of 32 bits that ends the run when it is no longer zero.
    pub done: Option<&'a str>,
    /// Statics to read at the end, with their sizes in bytes.
    pub read: &'a [(&'a str, usize)],
}

/// What an image has left.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Readings {
    /// Whether it came to its end, and not to the limit.
    pub done: bool,
    /// Virtual time, ns.
    pub t_ns: u64,
    /// Instructions executed.
    pub instructions: u64,
    /// Contents of the statics that were asked for.
    pub memory: BTreeMap<String, Vec<u8>>,
}

impl Readings {
    /// A static as little-endian word of 32 bits.
    pub fn word(&self, symbol: &str) -> Option<u32> {
        let bytes = self.memory.get(symbol)?.get(..4)?;
        Some(u32::from_le_bytes(bytes.try_into().ok()?))
    }
}

/// Runs an image.
///
/// # Errors
/// Where it lacks a symbol, or the emulator cannot go on.
pub fn probe(image: &Image, probe: &Probe<'_>) -> Result<Readings, Error> {
    let done = probe.done.map(|name| image.symbol(name)).transpose()?;
    let read = probe
        .read
        .iter()
        .map(|(name, size)| Ok(((*name).to_owned(), image.symbol(name)?, *size)))
        .collect::<Result<_, Error>>()?;
    let looker = Looker {
        limit_ns: probe.limit_ms * 1_000_000,
        done,
        read,
        readings: Readings {
            done: false,
            t_ns: 0,
            instructions: 0,
            memory: BTreeMap::new(),
        },
    };
    let board = Board::new(BridgeTimer::default())?;
    let session = Session::new(Box::new(board), 0, VirtualNanos(LOOK_NS))?;
    let images = [image.file.clone()];
    let finished = emulator::run(session, &Start::new(&images), looker)?;
    Ok(finished.driver.readings)
}

struct Looker {
    limit_ns: u64,
    done: Option<u64>,
    read: Vec<(String, u64, usize)>,
    readings: Readings,
}

impl Driver<Board> for Looker {
    fn on_settled(&mut self, session: &mut Session<Board>, host: &mut dyn Host, settled: Settled) {
        session.board_mut().part.correct(&settled, host);
    }

    fn on_stop(&mut self, _: &mut Session<Board>, stop: Stop, host: &mut dyn Host) -> Option<VirtualNanos> {
        let mut word = |address| host.read(address, Width::W32).unwrap_or(0);
        self.readings.done = self.done.is_some_and(|address| word(address) != 0);
        if !self.readings.done && stop.at.0 < self.limit_ns {
            return Some(VirtualNanos((stop.at.0 / LOOK_NS + 1) * LOOK_NS));
        }
        self.readings.t_ns = stop.at.0;
        self.readings.instructions = stop.instruction_count;
        for (name, address, size) in &self.read {
            let bytes = (0..*size as u64)
                .map(|offset| host.read(address + offset, Width::W8).unwrap_or(0) as u8)
                .collect();
            self.readings.memory.insert(name.clone(), bytes);
        }
        None
    }
}
