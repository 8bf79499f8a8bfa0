//! A unit at the other end of a serial line, real or simulated: what it sends, what it is told.
//!
//! ```text
//! port ─ bytes ─► monitor ─ sentences ─► screen, plain lines, answers to what was sent
//!    └──────────► record
//! ```
//!
//! [`Port`] is a serial port, a pty or a socket; [`monitor`] takes the line apart, pure; [`screen`] draws, pure; [`serve`]
//! is the other end, a simulated unit in real time. [`watch`] and [`send`] are the two things to do with a line.

pub mod monitor;
pub mod port;
pub mod screen;
pub mod serve;

use std::fs::File;
use std::io::{self, BufWriter, IsTerminal as _, Write as _};
use std::path::{Path, PathBuf};
use std::sync::mpsc::{self, Receiver, RecvTimeoutError, Sender};
use std::thread;
use std::time::{Duration, Instant};

use app::console::{self, Request};

use monitor::{LineEvent, Monitor};
pub use port::{Port, PortError};

/// Time between two paintings of the screen.
const PAINT: Duration = Duration::from_millis(100);
/// Where a command has several answers: after so long without another they have all come.
const QUIET: Duration = Duration::from_secs(1);
/// The same after the last one that this program knows: a later unit may have more of them.
const QUIET_AFTER_LAST: Duration = Duration::from_millis(100);
/// How long what the line still held is thrown away before the first command.
const FLUSH: Duration = Duration::from_millis(100);
/// From `calibrate` to the first turn: the rotor stops, the unit tests itself and rests.
const CALIBRATION_BEGINS: Duration = Duration::from_secs(30);
/// Longest calibration there is, with some room.
const CALIBRATION: Duration = Duration::from_secs(300);
/// How the unit's message begins where a calibration has succeeded, and where it has failed.
const CALIBRATED: [&str; 2] = ["gyros calibrated", "gyros not calibrated"];

/// Why a link ended.
#[derive(Debug)]
pub enum LinkError {
    /// The port cannot be used.
    Port(PortError),
    /// The recording cannot be written.
    Record(PathBuf, io::Error),
    /// Nothing came.
    NoAnswer {
        /// To what.
        line: String,
        /// For how long.
        waited: Duration,
        /// Sentences that came in the meantime.
        sentences: u64,
    },
    /// The unit refuses a command.
    Refused {
        /// Which.
        line: String,
        /// Why, in its words.
        text: String,
    },
    /// The gyros were not calibrated.
    NotCalibrated(String),
}

impl LinkError {
    /// Whether it is the unit's answer, or that there is none, and not a port or a file.
    pub const fn is_answer(&self) -> bool {
        matches!(
            self,
            Self::NoAnswer { .. } | Self::Refused { .. } | Self::NotCalibrated(_)
        )
    }
}

impl core::fmt::Display for LinkError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            Self::Port(e) => e.fmt(f),
            Self::Record(path, e) => write!(f, "cannot write {}: {e}", path.display()),
            Self::NoAnswer {
                line,
                waited,
                sentences: 0,
            } => write!(
                f,
                "{line}: nothing came in {:.1} s: check that this is the unit's port, its power and the cable",
                waited.as_secs_f64()
            ),
            Self::NoAnswer { line, waited, .. } => write!(
                f,
                "{line}: no answer in {:.1} s, though the unit sends: check the wire to its receiver, or wait longer \
                 with --timeout",
                waited.as_secs_f64()
            ),
            Self::Refused { line, text } => write!(f, "{line}: {text}"),
            Self::NotCalibrated(text) => write!(f, "calibrate: {text}: keep the base still and try again"),
        }
    }
}

impl core::error::Error for LinkError {}

impl From<PortError> for LinkError {
    fn from(e: PortError) -> Self {
        Self::Port(e)
    }
}

/// What comes to a link.
enum Event {
    Bytes(Vec<u8>),
    /// The other end is gone.
    Closed(Option<io::Error>),
    /// Somebody has typed a line.
    Line(String),
}

/// A line that is open.
pub struct Link {
    port: Port,
    tx: Box<dyn io::Write + Send>,
    events: Receiver<Event>,
    sender: Sender<Event>,
    record: Option<(PathBuf, BufWriter<File>)>,
    monitor: Monitor,
    begun: Instant,
}

impl Link {
    /// Opens a port and writes down what comes, byte by byte, where `record` says so.
    ///
    /// # Errors
    /// [`LinkError`], where the port or the file cannot be opened.
    pub fn open(port: Port, record: Option<&Path>) -> Result<Self, LinkError> {
        // First of all: without a port a recording of before stays.
        let (mut rx, tx) = port.open()?;
        let record = match record {
            None => None,
            Some(path) => {
                let file = File::create(path).map_err(|e| LinkError::Record(path.to_owned(), e))?;
                Some((path.to_owned(), BufWriter::new(file)))
            }
        };
        let (sender, events) = mpsc::channel();
        let link = Self {
            port,
            tx,
            events,
            sender: sender.clone(),
            record,
            monitor: Monitor::default(),
            begun: Instant::now(),
        };
        // It ends with the program: a read cannot be called off on every kind of port.
        thread::spawn(move || {
            let mut bytes = [0; 1024];
            loop {
                let event = match rx.read(&mut bytes) {
                    Ok(0) => Event::Closed(None),
                    Ok(count) => Event::Bytes(bytes.get(..count).unwrap_or_default().to_vec()),
                    Err(e) if is_a_pause(&e) => continue,
                    Err(e) => Event::Closed(Some(e)),
                };
                let last = matches!(event, Event::Closed(_));
                if sender.send(event).is_err() || last {
                    return;
                }
            }
        });
        Ok(link)
    }

    fn now_s(&self) -> f64 {
        self.begun.elapsed().as_secs_f64()
    }

    fn write_line(&mut self, line: &str) -> Result<(), LinkError> {
        let written = self
            .tx
            .write_all(format!("{line}\r\n").as_bytes())
            .and_then(|()| self.tx.flush());
        written.map_err(|e| LinkError::Port(PortError::Lost(self.port.clone(), Some(e))))
    }

    /// Waits for what comes until `until`; what was typed is sent. What came is given to `heard` one by one, first
    /// the monitor takes it.
    fn listen(&mut self, until: Instant, heard: &mut dyn FnMut(LineEvent, &Monitor)) -> Result<Listened, LinkError> {
        let wait = until.saturating_duration_since(Instant::now());
        match self.events.recv_timeout(wait) {
            Ok(Event::Bytes(bytes)) => {
                if let Some((path, file)) = &mut self.record {
                    file.write_all(&bytes)
                        .and_then(|()| file.flush())
                        .map_err(|e| LinkError::Record(path.clone(), e))?;
                }
                let now_s = self.now_s();
                self.monitor.take(&bytes, now_s, heard);
                Ok(Listened::More)
            }
            Ok(Event::Line(line)) => {
                self.write_line(&line)?;
                Ok(Listened::Typed)
            }
            Ok(Event::Closed(e)) => Err(LinkError::Port(PortError::Lost(self.port.clone(), e))),
            // The reader is there while this is: it has the other end.
            Err(RecvTimeoutError::Timeout | RecvTimeoutError::Disconnected) => Ok(Listened::Nothing),
        }
    }

    /// All that comes until `until`.
    fn listen_on(&mut self, until: Instant, heard: &mut dyn FnMut(LineEvent, &Monitor)) -> Result<(), LinkError> {
        while Instant::now() < until {
            self.listen(until, heard)?;
        }
        Ok(())
    }
}

/// Nothing has come yet, and nothing is wrong.
fn is_a_pause(error: &io::Error) -> bool {
    matches!(
        error.kind(),
        io::ErrorKind::TimedOut | io::ErrorKind::WouldBlock | io::ErrorKind::Interrupted
    )
}

/// What listening brought.
#[derive(PartialEq)]
enum Listened {
    Nothing,
    More,
    Typed,
}

/// Shows what a unit sends, on a terminal as a picture, else a line for each status sentence, and sends what is typed on
/// a terminal; for `length`, or until it is broken off.
///
/// # Errors
/// [`LinkError`], where the line breaks.
pub fn watch(link: &mut Link, length: Option<Duration>) -> Result<(), LinkError> {
    let end = length.map(|length| Instant::now() + length);
    if io::stdout().is_terminal() {
        paint(link, end)
    } else {
        tell(link, end)
    }
}

fn is_over(end: Option<Instant>) -> bool {
    end.is_some_and(|end| Instant::now() >= end)
}

fn paint(link: &mut Link, end: Option<Instant>) -> Result<(), LinkError> {
    if io::stdin().is_terminal() {
        let sender = link.sender.clone();
        thread::spawn(move || {
            for line in io::stdin().lines().map_while(Result::ok) {
                if sender.send(Event::Line(line)).is_err() {
                    return;
                }
            }
        });
    }
    let (name, colours) = (link.port.to_string(), std::env::var_os("NO_COLOR").is_none());
    let mut answers = screen::Answers::default();
    let mut typed = true;
    print!("{}", screen::CLEAR);
    while !is_over(end) {
        let recorded = link.record.as_ref().map(|(path, _)| path.as_path());
        let picture = screen::picture(&name, &link.monitor, &answers, recorded, link.now_s());
        print!("{}", screen::painted(&picture, typed, colours));
        // A terminal that is gone shows nothing: the next read or the next signal ends it.
        let _ = io::stdout().flush();
        typed = false;
        let next = Instant::now() + PAINT;
        while Instant::now() < next {
            let found = link.listen(next, &mut |heard, _| answers.take(&heard))?;
            typed |= found == Listened::Typed;
        }
    }
    println!();
    Ok(())
}

fn tell(link: &mut Link, end: Option<Instant>) -> Result<(), LinkError> {
    let mut broken = false;
    while !is_over(end) && !broken {
        let (begun, next) = (link.begun, Instant::now() + PAINT);
        link.listen(next, &mut |heard, monitor| {
            let line = match heard {
                LineEvent::Status => screen::line(monitor, begun.elapsed().as_secs_f64()),
                LineEvent::Answer { ok, text } => screen::answer(ok, &text),
                LineEvent::Text(text) => text,
                LineEvent::Other => return,
            };
            // Whoever read it has gone: enough.
            broken |= writeln!(io::stdout(), "{line}").is_err();
        })?;
    }
    Ok(())
}

/// Sends lines one after the other, each when the one before it has been answered, and prints the answers. Goes on after
/// `calibrate` when the gyros are calibrated.
///
/// # Errors
/// [`LinkError`] where one is refused or not answered; those after it are not sent.
pub fn send(link: &mut Link, lines: &[String], timeout: Duration) -> Result<(), LinkError> {
    // What was typed before and has no end, and the noise of plugging in, must not become part of the first command;
    // what the unit says to it is no answer to us.
    link.write_line("")?;
    link.listen_on(Instant::now() + FLUSH, &mut |_, _| ())?;
    for line in lines {
        let request = console::parse(line.trim().as_bytes());
        let several = match &request {
            Ok(None) => continue,
            Ok(Some(Request::Help)) => Several::Words,
            Ok(Some(Request::Show)) => Several::Settings,
            Ok(Some(Request::Faults)) => Several::Faults,
            // What this program does not know a later unit may.
            Ok(Some(_)) | Err(_) => Several::No,
        };
        let answers = if matches!(request, Ok(Some(Request::Status))) {
            vec![status(link, line, timeout)?]
        } else {
            asked(link, line, several, timeout)?
        };
        for answer in answers {
            // A reader that has gone needs no answers, but the commands were to be sent.
            let _ = writeln!(io::stdout(), "{answer}");
        }
        if matches!(request, Ok(Some(Request::Unit(app::command::Command::Calibrate)))) {
            let text = calibration(link)?;
            let _ = writeln!(io::stdout(), "{text}");
        }
    }
    Ok(())
}

/// Whether a command has more than one answer.
#[derive(Clone, Copy, PartialEq)]
enum Several {
    No,
    /// Those of `help`.
    Words,
    /// Those of `show`.
    Settings,
    /// Those of `faults`.
    Faults,
}

impl Several {
    /// Whether it is the last one, as far as is known here.
    fn ends_with(self, answer: &str) -> bool {
        match self {
            Self::No => true,
            Self::Words => console::WORDS
                .last()
                .is_some_and(|word| answer.split(' ').next() == Some(word.name)),
            Self::Settings => answer.starts_with("gyros "),
            Self::Faults => answer == "no more faults",
        }
    }
}

/// Sends a line; its answers.
fn asked(link: &mut Link, line: &str, several: Several, timeout: Duration) -> Result<Vec<String>, LinkError> {
    let before = link.monitor.counts().sentences;
    link.write_line(line)?;
    let mut answers: Vec<(bool, String)> = Vec::new();
    let mut until = Instant::now() + timeout;
    while Instant::now() < until && (several != Several::No || answers.is_empty()) {
        let had = answers.len();
        link.listen(until, &mut |heard, _| {
            if let LineEvent::Answer { ok, text } = heard {
                answers.push((ok, text));
            }
        })?;
        match answers.get(had..).and_then(<[_]>::last) {
            // An error is the only answer.
            Some((false, _)) => break,
            Some((true, text)) if several.ends_with(text) => until = Instant::now() + QUIET_AFTER_LAST,
            Some(_) => until = Instant::now() + QUIET,
            None => {}
        }
    }
    if let Some((_, text)) = answers.iter().find(|(ok, _)| !ok) {
        return Err(LinkError::Refused {
            line: line.to_owned(),
            text: text.clone(),
        });
    }
    if answers.is_empty() {
        return Err(no_answer(link, line, timeout, before));
    }
    Ok(answers.into_iter().map(|(_, text)| text).collect())
}

fn no_answer(link: &Link, line: &str, waited: Duration, before: u64) -> LinkError {
    LinkError::NoAnswer {
        line: line.to_owned(),
        waited,
        sentences: link.monitor.counts().sentences.saturating_sub(before),
    }
}

/// Asks for the status sentence, which is the answer.
fn status(link: &mut Link, line: &str, timeout: Duration) -> Result<String, LinkError> {
    let before = link.monitor.counts().sentences;
    link.write_line(line)?;
    let (begun, until) = (link.begun, Instant::now() + timeout);
    let mut told = None;
    while told.is_none() && Instant::now() < until {
        link.listen(until, &mut |heard, monitor| {
            if heard == LineEvent::Status {
                told = Some(screen::line(monitor, begun.elapsed().as_secs_f64()));
            }
        })?;
    }
    told.ok_or_else(|| no_answer(link, line, timeout, before))
}

/// Follows a calibration to its end; what the unit says has come of it.
fn calibration(link: &mut Link) -> Result<String, LinkError> {
    let shown = indicatif::ProgressBar::new(screen::CALIBRATION_S as u64);
    if let Ok(style) = indicatif::ProgressStyle::with_template("{bar:40} {pos}/{len} s, {msg}") {
        shown.set_style(style);
    }
    let (mut until, mut begun) = (Instant::now() + CALIBRATION_BEGINS, false);
    let mut ended = None;
    let end = loop {
        if let Some(end) = ended.take() {
            break end;
        }
        if Instant::now() >= until {
            let why = if begun { "it does not end" } else { "it does not begin" };
            return Err(LinkError::NotCalibrated(why.to_owned()));
        }
        let [good, bad] = CALIBRATED;
        link.listen(until, &mut |heard, monitor| match (heard, monitor.status()) {
            (LineEvent::Text(text), _) if text.starts_with(good) => {
                ended.get_or_insert(Ok(text));
            }
            (LineEvent::Text(text), _) if text.starts_with(bad) => {
                ended.get_or_insert(Err(text));
            }
            (LineEvent::Status, Some(status)) => {
                if status.mode == "calibrating" {
                    if !begun {
                        until = Instant::now() + CALIBRATION;
                    }
                    begun = true;
                    shown.set_position(status.mode_s as u64);
                } else if begun {
                    // The text comes before the mode.
                    ended.get_or_insert_with(|| {
                        Err(match status.mode.as_str() {
                            "fault" => "the unit found a fault".to_owned(),
                            mode => format!("it ended without a word, the unit is in mode {mode}"),
                        })
                    });
                }
                shown.set_message(status.mode.clone());
            }
            _ => {}
        })?;
    };
    shown.finish_and_clear();
    end.map_err(LinkError::NotCalibrated)
}
