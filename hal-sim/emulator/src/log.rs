//! The unit's log: RTT read from its memory, defmt decoded in process.

use defmt_decoder::{DecodeError, Frame, StreamDecoder, Table};
use rigless::emulator::Memory;
use rigless::soc::Width;
use serde::Serialize;

use crate::error::Error;
use crate::image::Image;

/// First word of an RTT control block that is set up: "SEGG".
const MARK: u64 = u32::from_le_bytes(*b"SEGG") as u64;
/// Offsets in the control block of the first up-channel: buffer, size, write and read offset.
const BUFFER: u64 = 28;
const SIZE: u64 = 32;
const WRITE: u64 = 36;
const READ: u64 = 40;

/// A line of the log.
#[derive(Debug, Clone, PartialEq, Eq, Hash, Serialize)]
pub struct Line {
    /// When it was read, virtual time since power-up, ns: a millisecond or less after it was written.
    pub t_ns: u64,
    /// Its level, `host` where the line is the emulator's own.
    pub level: &'static str,
    /// Its text.
    pub text: String,
}

impl core::fmt::Display for Line {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        let us = self.t_ns / 1000;
        let level = self.level.to_uppercase();
        write!(
            f,
            "[{:>5}.{:06}] {level:<5} {}",
            us / 1_000_000,
            us % 1_000_000,
            self.text
        )
    }
}

/// The log's reader.
pub(crate) struct Reader {
    block: u64,
    /// Leaked: the decoder borrows it, and a process reads one image or a few.
    table: &'static Table,
    decoder: Box<dyn StreamDecoder + Send + Sync>,
}

impl Reader {
    /// A reader for an image.
    pub(crate) fn new(image: &Image) -> Result<Self, Error> {
        let problem = |problem: String| Error::NoLog { problem };
        let table = Table::parse(image.file.bytes())
            .map_err(|e| problem(e.to_string()))?
            .ok_or_else(|| problem("it has no .defmt section".to_owned()))?;
        let table: &'static Table = Box::leak(Box::new(table));
        Ok(Self {
            block: image.symbol("_SEGGER_RTT")?,
            table,
            decoder: table.new_stream_decoder(),
        })
    }

    /// Forgets what was read of a line: the unit has begun anew.
    pub(crate) fn restart(&mut self) {
        self.decoder = self.table.new_stream_decoder();
    }

    /// Reads what is new, as a probe does: from the read offset to the write offset, which is then the read offset.
    pub(crate) fn read<M: Memory + ?Sized>(&mut self, memory: &mut M) -> Vec<u8> {
        let mut word = |offset| memory.read(self.block + offset, Width::W32).unwrap_or(0);
        let (mark, buffer, size, end, mut at) = (word(0), word(BUFFER), word(SIZE), word(WRITE), word(READ));
        if mark != MARK || end >= size || at >= size || at == end {
            return Vec::new();
        }
        let mut bytes = Vec::new();
        while at != end {
            bytes.push(memory.read(buffer + at, Width::W8).unwrap_or(0) as u8);
            at = (at + 1) % size;
        }
        // RAM that has answered is there.
        let _ = memory.write(self.block + READ, Width::W32, end);
        bytes
    }

    /// The lines that end with these bytes.
    pub(crate) fn decode(&mut self, bytes: &[u8], t_ns: u64) -> Vec<Line> {
        self.decoder.received(bytes);
        let mut lines = Vec::new();
        loop {
            let line = match self.decoder.decode() {
                Ok(frame) => line(&frame, t_ns),
                Err(DecodeError::UnexpectedEof) => return lines,
                Err(DecodeError::Malformed) => Line {
                    t_ns,
                    level: "host",
                    text: "a frame of the log is damaged".to_owned(),
                },
            };
            lines.push(line);
        }
    }
}

fn line(frame: &Frame<'_>, t_ns: u64) -> Line {
    Line {
        t_ns,
        level: frame.level().map_or("print", |level| level.as_str()),
        text: frame.display_message().to_string(),
    }
}
