//! Inspection of a recorded log of the unit: modes, estimates, faults, samples, resets, each with its time.
//!
//! ```text
//! defmt over RTT ─► Frames ─┐ (with the image's ELF file)
//!                           ├─► Line ─► LogParser ─► Timeline ─► table, CSV, chart, live view
//! text ─► text::line ───────┘
//! ```
//!
//! | module | what is in it |
//! |---|---|
//! | [`defmt`], [`text`] | bytes to lines |
//! | [`parser`] | parses a line of the log, by the texts of [`app::log`] |
//! | [`timeline`] | what happened when |
//! | [`report`], [`chart`], [`live`] | for people |
//!
//! Which of the two a log is, is seen by its contents. A log may begin and end anywhere, and have holes and damage: what is
//! sound in it is told, what is not is counted.
//!
//! Times are the unit's, s since it started; after a reset they go on from the last time before it, for how long a unit
//! was off its log does not tell. Figures are those of the lines; what the log's level leaves out (what was bridged is told
//! at `debug`) is not in it.

pub mod chart;
pub mod defmt;
pub mod live;
pub mod parser;
pub mod report;
pub mod text;
pub mod timeline;

use core::fmt;
use std::fs::File;
use std::io::{self, Read};
use std::path::{Path, PathBuf};

use defmt::{Elf, Frames};
pub use timeline::Source;
use timeline::{News, Timeline};

use crate::log::is_utf16;

/// No line of text is as long, bytes: what is longer is cut.
const LONGEST_LINE: usize = 16 * 1024;
/// A first line that is shorter proves nothing about the rest.
const TELLING: usize = 8;

/// Why a log cannot be inspected.
#[derive(Debug, Clone, PartialEq, Eq)]
#[non_exhaustive]
pub enum InspectError {
    /// A file cannot be read.
    Read(PathBuf, String),
    /// A file cannot be written.
    Write(PathBuf, String),
    /// There is nothing in the log.
    Empty,
    /// The log is defmt's, and there is no ELF file.
    NeedsElf,
    /// The ELF file is of no use.
    Elf {
        /// The file.
        path: PathBuf,
        /// Why.
        problem: String,
    },
    /// The log is another image's, or none.
    WrongElf {
        /// The ELF file.
        elf: PathBuf,
        /// Frames in the log.
        frames: u64,
        /// Of these, frames that are words of the unit with this ELF file.
        understood: u64,
    },
    /// Nothing in the log is the unit's.
    NotOurs,
    /// The bytes of a binary stream were written as text in UTF-8.
    SavedAsText,
    /// A chart is wanted of a log without times.
    NoTimes,
}

impl fmt::Display for InspectError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Read(path, problem) => write!(f, "cannot read {}: {problem}", path.display()),
            Self::Write(path, problem) => write!(f, "cannot write {}: {problem}", path.display()),
            Self::Empty => f.write_str("the log is empty"),
            Self::NeedsElf => f.write_str(
                "the log is a stream of defmt: give the image that wrote it with --elf, for instance \
                 target/thumbv7em-none-eabihf/release/firmware",
            ),
            Self::Elf { path, problem } => write!(f, "{}: {problem}", path.display()),
            Self::WrongElf {
                elf,
                frames,
                understood,
            } => write!(
                f,
                "only {understood} of {frames} frames make sense with {}: the log is of another build, or none; --elf \
                 must be the very file that was flashed, of the same commit, features and profile",
                elf.display()
            ),
            Self::NotOurs => f.write_str(
                "no line of the unit's log in it: expected are a raw stream of defmt, or the output of probe-rs, \
                 defmt-print, `cargo emulate` or `hal-sim unit`; samples in CSV are for `replay`",
            ),
            Self::SavedAsText => f.write_str(
                "the log is a binary stream that was saved as text in UTF-8, which changes its bytes: save the bytes as they come, \
                 or the text that probe-rs or defmt-print makes of them",
            ),
            Self::NoTimes => f.write_str(
                "the log has no times, and a chart needs them: leave out --svg, or let the printer of the log show the time of a line",
            ),
        }
    }
}

impl core::error::Error for InspectError {}

/// What the bytes are, as far as is known.
#[derive(Debug)]
enum Input {
    /// Nothing yet that tells.
    Unknown(Vec<u8>),
    /// A stream of defmt.
    Frames(Frames),
    /// Text, and its last line as far as it has come.
    Text(Vec<u8>),
}

/// Reads a log as it comes.
#[derive(Debug)]
pub struct Reader {
    elf: Option<Elf>,
    input: Input,
    timeline: Timeline,
}

impl Reader {
    /// A reader; a stream of defmt needs the image.
    pub fn new(elf: Option<Elf>) -> Self {
        Self {
            elf,
            input: Input::Unknown(Vec::new()),
            timeline: Timeline::new(Source::Text),
        }
    }

    /// What was read so far.
    pub fn timeline(&self) -> &Timeline {
        &self.timeline
    }

    /// Takes bytes; `each` gets what is new with them.
    ///
    /// # Errors
    /// [`InspectError::NeedsElf`] where the bytes are defmt's and there is no ELF file.
    pub fn push(&mut self, bytes: &[u8], each: &mut dyn FnMut(&Timeline, News)) -> Result<(), InspectError> {
        if let Input::Unknown(begun) = &mut self.input {
            begun.extend_from_slice(bytes);
            let Some(source) = source(begun) else { return Ok(()) };
            let begun = core::mem::take(begun);
            self.decide(source)?;
            return self.push(&begun, each);
        }
        let Self { elf, input, timeline } = self;
        match input {
            Input::Unknown(_) => {}
            Input::Frames(frames) => {
                let Some(elf) = elf else {
                    return Err(InspectError::NeedsElf);
                };
                frames.push(bytes, elf, &mut |line| match line {
                    None => timeline.damage(),
                    Some(line) => {
                        if let Some(news) = timeline.line(line) {
                            each(timeline, news);
                        }
                    }
                });
            }
            Input::Text(rest) => {
                for part in bytes.split_inclusive(|b| *b == b'\n') {
                    let room = LONGEST_LINE.saturating_sub(rest.len());
                    rest.extend_from_slice(part.get(..room).unwrap_or(part));
                    if part.last() == Some(&b'\n') {
                        take(timeline, rest, each);
                    }
                }
            }
        }
        Ok(())
    }

    /// The log has ended.
    ///
    /// # Errors
    /// [`InspectError`] where nothing in it is the unit's.
    pub fn finish(mut self, each: &mut dyn FnMut(&Timeline, News)) -> Result<Timeline, InspectError> {
        if let Input::Unknown(begun) = &self.input {
            if begun.is_empty() {
                return Err(InspectError::Empty);
            }
            let begun = begun.clone();
            self.decide(if begun.contains(&0) {
                Source::Defmt
            } else {
                Source::Text
            })?;
            self.push(&begun, each)?;
        }
        let Self {
            elf,
            input,
            mut timeline,
        } = self;
        match (input, elf) {
            (Input::Text(mut rest), _) if !rest.is_empty() => take(&mut timeline, &mut rest, each),
            (Input::Frames(_), Some(elf)) => {
                let frames = timeline.lines + timeline.damaged;
                // Texts of another build fit some frames by chance, but then they make no sense.
                let senseless = 10 * timeline.damaged > frames && 2 * timeline.understood < frames;
                if timeline.understood == 0 || timeline.damaged > timeline.lines || senseless {
                    return Err(InspectError::WrongElf {
                        elf: elf.path().to_owned(),
                        frames,
                        understood: timeline.understood,
                    });
                }
            }
            _ => {}
        }
        if timeline.understood == 0 && timeline.sentences == 0 {
            return Err(InspectError::NotOurs);
        }
        Ok(timeline)
    }

    fn decide(&mut self, source: Source) -> Result<(), InspectError> {
        self.timeline.source = source;
        self.input = match source {
            Source::Defmt if self.elf.is_none() => return Err(InspectError::NeedsElf),
            Source::Defmt => Input::Frames(Frames::default()),
            Source::Text => Input::Text(Vec::new()),
        };
        Ok(())
    }
}

/// What a log that begins so is: text has lines without control characters, frames end with a zero.
fn source(begun: &[u8]) -> Option<Source> {
    let end = begun.iter().position(|b| *b == b'\n').filter(|end| *end >= TELLING);
    let plain = |text: &str| text.chars().all(|c| !c.is_control() || "\t\r\u{1b}".contains(c));
    match end.map(|end| core::str::from_utf8(&begun[..end])) {
        Some(Ok(text)) if plain(text) => Some(Source::Text),
        _ if begun.contains(&0) => Some(Source::Defmt),
        // Frames of the unit are shorter: it will not come to a zero.
        _ if begun.len() > LONGEST_LINE => Some(Source::Text),
        _ => None,
    }
}

/// Takes a line of text, which is empty after.
fn take(timeline: &mut Timeline, line: &mut Vec<u8>, each: &mut dyn FnMut(&Timeline, News)) {
    let raw = String::from_utf8_lossy(line);
    let news = match (text::sentence(&raw), text::line(&raw)) {
        (Some(fields), _) => timeline.sentence(&fields),
        (None, Some(line)) => timeline.line(line),
        (None, None) => None,
    };
    if let Some(news) = news {
        each(timeline, news);
    }
    line.clear();
}

/// Characters beyond ASCII that a stream does not have by chance in a row of UTF-8.
const WIDE: usize = 8;

/// Whether a stream of bytes went through a terminal that saves text: UTF-8 with zeros, and many characters beyond ASCII.
fn is_saved_as_text(bytes: &[u8]) -> bool {
    let text = bytes.utf8_chunks().next().map_or("", |chunk| chunk.valid());
    // The last character may be cut off.
    bytes.len() - text.len() < 4 && text.contains('\0') && text.chars().filter(|c| !c.is_ascii()).count() >= WIDE
}

/// Text in UTF-16, by its mark or little-endian without one, as UTF-8.
fn of_utf16(bytes: &[u8]) -> String {
    let big = bytes.starts_with(b"\xfe\xff") || (bytes.first() == Some(&0) && !bytes.starts_with(b"\xff\xfe"));
    let unit = if big { u16::from_be_bytes } else { u16::from_le_bytes };
    let units: Vec<u16> = bytes.chunks_exact(2).map(|pair| unit([pair[0], pair[1]])).collect();
    String::from_utf16_lossy(units.strip_prefix(&[0xFEFF]).unwrap_or(&units))
}

/// Reads a whole log, also one in UTF-16, as PowerShell's `>` writes it.
///
/// # Errors
/// [`InspectError`] where it cannot be read, or is no log of the unit.
pub fn of_bytes(bytes: &[u8], elf: Option<Elf>) -> Result<Timeline, InspectError> {
    let mut reader = Reader::new(elf);
    let read = if is_utf16(bytes) {
        reader.push(of_utf16(bytes).as_bytes(), &mut |_, _| {})
    } else {
        reader.push(bytes, &mut |_, _| {})
    };
    match read.and_then(|()| reader.finish(&mut |_, _| {})) {
        Err(InspectError::NeedsElf | InspectError::WrongElf { .. } | InspectError::NotOurs)
            if is_saved_as_text(bytes) =>
        {
            Err(InspectError::SavedAsText)
        }
        read => read,
    }
}

/// Opens a log; `-` is standard input.
///
/// # Errors
/// [`InspectError::Read`] where there is no such file.
pub fn open(path: &Path) -> Result<Box<dyn Read>, InspectError> {
    if path == Path::new("-") {
        return Ok(Box::new(io::stdin()));
    }
    match File::open(path) {
        Ok(file) => Ok(Box::new(file)),
        Err(e) => Err(InspectError::Read(path.to_owned(), e.to_string())),
    }
}

/// Reads a log from a file, or from standard input where its name is `-`.
///
/// # Errors
/// [`InspectError`] where it cannot be read, or is no log of the unit.
pub fn of_file(path: &Path, elf: Option<Elf>) -> Result<Timeline, InspectError> {
    let mut bytes = Vec::new();
    open(path)?
        .read_to_end(&mut bytes)
        .map_err(|e| InspectError::Read(path.to_owned(), e.to_string()))?;
    of_bytes(&bytes, elf)
}
