//! A log while it is written: the unit's state on a terminal, or a line for each thing that is new.

use core::fmt::Write as _;
use std::collections::VecDeque;
use std::fs::File;
use std::io::{self, Read, Seek as _, SeekFrom, Write};
use std::path::Path;
use std::thread;
use std::time::Duration;

use log::Level;

use super::defmt::Elf;
use super::report::{count, seconds};
use super::timeline::{EstimateAt, News, Timeline};
use super::{InspectError, Reader};
use crate::dial::dial;

/// From one look at a file that does not grow to the next.
const LOOK: Duration = Duration::from_millis(200);
/// Bytes of one look: of the order of an hour of the log, so that a long file is caught up with few drawings.
const CHUNK: usize = 64 * 1024;
/// Lines of the unit that stay on the screen.
const SAID: usize = 6;
/// Width of the screen, characters: what is longer is cut, for a line that wraps would spoil the next drawing.
const WIDTH: usize = 78;
/// Half the dial's height, lines.
const RADIUS: u8 = 4;

/// The end of a file that grows.
#[derive(Debug)]
pub struct Tail {
    file: File,
    at: u64,
    /// Other files, such as a FIFO, tell by themselves when they end.
    regular: bool,
}

impl Tail {
    /// Begins at the file's beginning.
    ///
    /// # Errors
    /// [`InspectError::Read`] where there is no such file.
    pub fn open(path: &Path) -> Result<Self, InspectError> {
        let open = || {
            let file = File::open(path)?;
            let regular = file.metadata()?.is_file();
            Ok(Self { file, at: 0, regular })
        };
        open().map_err(|e: io::Error| InspectError::Read(path.to_owned(), e.to_string()))
    }
}

impl Read for Tail {
    /// Waits for more; a file that has become shorter was begun anew.
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        loop {
            let read = self.file.read(buffer)?;
            self.at += read as u64;
            if read > 0 || !self.regular {
                return Ok(read);
            }
            if self.file.metadata()?.len() < self.at {
                self.at = self.file.seek(SeekFrom::Start(0))?;
            } else {
                thread::sleep(LOOK);
            }
        }
    }
}

/// Follows a log to its end, or until nobody reads what is written.
///
/// # Errors
/// [`InspectError`] where it cannot be read, or is no log of the unit.
pub fn follow(
    input: &mut dyn Read,
    elf: Option<Elf>,
    terminal: bool,
    output: &mut dyn Write,
) -> Result<Timeline, InspectError> {
    let mut reader = Reader::new(elf);
    let mut screen = Screen::default();
    let mut buffer = vec![0; CHUNK];
    loop {
        let read = match input.read(&mut buffer) {
            Ok(0) => break,
            Ok(read) => read,
            Err(e) if e.kind() == io::ErrorKind::Interrupted => continue,
            Err(e) => return Err(InspectError::Read("the log".into(), e.to_string())),
        };
        let mut text = String::new();
        reader.push(&buffer[..read], &mut |_, news| {
            if terminal {
                screen.note(&news);
            } else {
                text += &plain(&news);
            }
        })?;
        if terminal {
            text = screen.draw(reader.timeline());
        }
        if write(output, &text)? {
            break;
        }
    }
    let mut text = String::new();
    let timeline = reader.finish(&mut |_, news| {
        if !terminal {
            text += &plain(&news);
        }
    })?;
    write(output, &text)?;
    Ok(timeline)
}

/// Tells whether the reader has gone away.
fn write(output: &mut dyn Write, text: &str) -> Result<bool, InspectError> {
    match output.write_all(text.as_bytes()).and_then(|()| output.flush()) {
        Ok(()) => Ok(false),
        Err(e) if e.kind() == io::ErrorKind::BrokenPipe => Ok(true),
        Err(e) => Err(InspectError::Write("the screen".into(), e.to_string())),
    }
}

/// One line for what is new.
pub fn plain(news: &News) -> String {
    match news {
        News::Estimate(estimate) => {
            let a = &estimate.attitude;
            format!(
                "{:>10}  {:<11} heading {:>8.3}°  σ {:>7.4}°  pitch {:>7.3}°  roll {:>7.3}°\n",
                seconds(estimate.t_s),
                estimate.mode.unwrap_or("unknown"),
                a.heading_deg,
                a.heading_sd_deg,
                a.pitch_deg,
                a.roll_deg
            )
        }
        News::Said { t_s, level, text } => {
            let level = level.map_or("host", |level: Level| level.as_str());
            format!("{:>10}  {level:<5} {text}\n", seconds(*t_s))
        }
    }
}

/// What is on the terminal.
#[derive(Debug, Default)]
pub struct Screen {
    said: VecDeque<String>,
    /// Rows that the next drawing goes over.
    rows: usize,
}

impl Screen {
    /// Keeps what stays on the screen for a while.
    pub fn note(&mut self, news: &News) {
        if matches!(news, News::Said { .. }) {
            if self.said.len() == SAID {
                self.said.pop_front();
            }
            self.said.push_back(plain(news));
        }
    }

    /// The screen anew, over the one before.
    pub fn draw(&mut self, timeline: &Timeline) -> String {
        let mut text = String::new();
        if self.rows > 0 {
            // Up, and clear from there on.
            let _ = write!(text, "\u{1b}[{}A\u{1b}[J", self.rows);
        }
        let screen = self.rows(timeline);
        self.rows = screen.len();
        for row in screen {
            text.extend(row.trim_end().chars().take(WIDTH));
            text.push('\n');
        }
        text
    }

    fn rows(&self, timeline: &Timeline) -> Vec<String> {
        let since = timeline.modes.last().map_or(0.0, |span| timeline.to_s - span.from_s);
        let when = if timeline.has_times() {
            format!(" for {since:.0} s, {:.1} s since the start", timeline.to_s)
        } else {
            String::new()
        };
        let mut rows = vec![format!(
            "{}{when}; {}, {}, {} lost",
            timeline.state(),
            count(timeline.faults.len() as u64, "fault"),
            count(timeline.resets, "reset"),
            count(timeline.samples.lost, "sample")
        )];
        let estimate = timeline.estimates.last();
        let figures = figures(estimate, timeline);
        let valid = matches!(timeline.state(), "aligned" | "navigating");
        let attitude = estimate.map(|estimate| estimate.attitude);
        let sd = attitude.map_or(0.0, |attitude| attitude.heading_sd_deg);
        let card = dial(RADIUS, attitude.map(|attitude| attitude.heading_deg), sd, valid);
        for (line, figure) in card.iter().zip(figures) {
            rows.push(format!(" {line}   {figure}"));
        }
        for fault in timeline.faults.iter().rev().take(2) {
            rows.push(format!("fault {:>8} s  {}", seconds(fault.t_s), fault.words()));
        }
        rows.extend(self.said.iter().cloned());
        rows
    }
}

/// What stands beside the dial, as many rows as it has.
fn figures(estimate: Option<&EstimateAt>, timeline: &Timeline) -> Vec<String> {
    let mut rows = vec![String::new()];
    if let Some(EstimateAt { attitude: a, t_s, .. }) = estimate {
        rows.push(format!("heading {:>9.3}°", a.heading_deg));
        rows.push(format!("σ       {:>9.4}°", a.heading_sd_deg));
        rows.push(format!("pitch   {:>9.3}°", a.pitch_deg));
        rows.push(format!("roll    {:>9.3}°", a.roll_deg));
        rows.push(format!("at      {:>9} s", seconds(*t_s)));
    } else if let Some(coarse) = timeline.coarse.last() {
        rows.push(format!("heading {:>9.2}°, coarse", coarse.heading_deg));
        rows.push(format!("σ       {:>9.2}°", coarse.heading_sd_deg));
    } else {
        rows.push("no estimate yet".to_owned());
    }
    rows.resize(2 * usize::from(RADIUS) + 1, String::new());
    rows
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_screen_goes_over_the_one_before_and_does_not_wrap() {
        let log = "1.0 INFO mode idle -> self-test\n\
                   2.0 ERROR fault imu-transfer: 3 transfers from the IMU failed: CRC 0xbeefbeef received, 0xbeefbeee computed\n\
                   3.0 INFO fine rotor +1.0 deg, heading 7.00 deg, sd 1.000 deg, pitch +2.00 deg, roll +3.00 deg\n";
        let mut written = Vec::new();
        let timeline = follow(&mut log.as_bytes(), None, true, &mut written).unwrap();
        let mut screen = Screen::default();
        let first = screen.draw(&timeline);
        let second = screen.draw(&timeline);
        let rows = first.lines().count();
        assert!(!first.contains('\u{1b}') && second.starts_with(&format!("\u{1b}[{rows}A\u{1b}[J")));
        assert!(first.lines().all(|row| row.chars().count() <= WIDTH), "{first}");
        assert!(
            first.contains("imu-transfer") && first.contains("heading     7.000°"),
            "{first}"
        );
    }
}
