//! What a line of the unit's log says.
//!
//! The wording is the unit's own and stands in one place, [`app::log`]: each kind of line is rendered here as the unit
//! renders it, image and simulator alike, with values that are known, and what is around them is what lines are recognised
//! by. So a text that is changed there is understood here. Of the line that comes once a second the labels count, not what
//! is between them.

use app::blackbox::Start;
use app::command::{Command, ModeName};
use app::fault::Fault;
use app::hal::ResetCause;
use app::log::{Alignment, CalibrationFailure, Event, GyrosCalibrated, NavigationEnd};
use app::selftest::Found;
use drivers::sequence::Tally;
use drivers::{Error, Identity};
use frames::units::DEG;
use serde::Serialize;

/// Labels of the estimate's figures.
const HEADING: &str = "heading";
const SD: &str = "sd";
const PITCH: &str = "pitch";
const ROLL: &str = "roll";
/// Of the line that comes in every second, also where there is no estimate.
const ROTOR: &str = "rotor";

/// Before what of the settings is not as stored.
const SETTINGS: &str = "settings: ";
/// Before what is wrong with the clock.
const CLOCK: &str = "clock: ";
/// Before the version.
const VERSION: &str = "rotary-north ";

/// Attitude as the unit tells it, degrees.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Attitude {
    /// Heading, clockwise from north.
    pub heading_deg: f64,
    /// Its predicted 1σ.
    pub heading_sd_deg: f64,
    /// Nose up.
    pub pitch_deg: f64,
    /// Right side down.
    pub roll_deg: f64,
}

/// An event of the unit's log, as read from one line.
#[derive(Debug, Clone, PartialEq)]
pub enum LogEvent {
    /// The program's version, the first line of a start.
    Version,
    /// The unit has started.
    Started {
        /// By what.
        cause: String,
    },
    /// The unit is in a mode now.
    Mode(ModeName),
    /// The estimate.
    Estimate(Attitude),
    /// Coarse alignment has succeeded.
    Coarse {
        /// Degrees.
        heading_deg: f64,
        /// Its predicted 1σ, degrees.
        sd_deg: f64,
    },
    /// Not aligned any more, for the reason that the line gives.
    NotAligned,
    /// The alignment starts anew, for the reason that the line gives.
    AlignsAnew,
    /// A fault.
    Fault {
        /// Its kind.
        name: String,
        /// Its facts.
        text: String,
    },
    /// The retry after a fault begins.
    Retry {
        /// Which one.
        attempt: u32,
    },
    /// The fault stays until it is reset.
    Latched,
    /// Samples are missing.
    Lost {
        /// In this gap.
        samples: u32,
        /// In all since the start.
        total: u32,
    },
    /// A sample came twice.
    Repeated {
        /// In all since the start.
        total: u32,
    },
    /// A transfer failed.
    Transfer,
    /// The alignment did not keep up.
    Overrun {
        /// Samples dropped since the start.
        total: u32,
    },
    /// Missing data were bridged.
    Bridged {
        /// How long, ms.
        ms: f64,
    },
    /// Something that needs no figures.
    Note,
}

/// What is made of the values in a line.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Kind {
    Started,
    Mode,
    Coarse,
    NotAligned,
    AlignsAnew,
    Fault,
    Retry,
    Latched,
    Lost,
    Repeated,
    Transfer,
    Overrun,
    Bridged,
    Note,
}

/// A part of a line.
#[derive(Debug, Clone, PartialEq, Eq)]
enum Piece {
    /// What stands in each line of its kind.
    Literal(String),
    /// A value, by its place among those asked for; one that nobody asks for has none.
    Value(Option<usize>),
}

/// How lines of one kind look.
#[derive(Debug, Clone, PartialEq, Eq)]
struct Pattern {
    kind: Kind,
    pieces: Vec<Piece>,
}

/// Parses lines of the unit's log, by patterns of all its events.
#[derive(Debug, Clone, PartialEq)]
pub struct LogParser {
    patterns: Vec<Pattern>,
}

impl Default for LogParser {
    fn default() -> Self {
        Self::learn()
    }
}

impl LogParser {
    /// Asks the unit how it says what.
    pub fn learn() -> Self {
        let mut patterns = Vec::new();
        for Example { kind, line, values } in examples() {
            let pieces = pieces(&normal(&line), &values);
            patterns.push(Pattern { kind, pieces });
        }
        // What has no values first, then what says most: a text in full must not be taken for another's values.
        patterns.sort_by_key(|pattern| {
            let literal: usize = pattern.pieces.iter().map(Piece::literal_length).sum();
            (pattern.pieces.len() > 1, core::cmp::Reverse(literal))
        });
        Self { patterns }
    }

    /// What a line's text tells, if anything.
    pub fn read(&self, text: &str) -> Option<LogEvent> {
        let text = normal(text);
        if text.starts_with(VERSION) {
            return Some(LogEvent::Version);
        }
        if text.starts_with(SETTINGS) || text.starts_with(CLOCK) {
            return Some(LogEvent::Note);
        }
        if let Some(attitude) = estimate(&text) {
            return Some(LogEvent::Estimate(attitude));
        }
        if is_report(&text) {
            return Some(LogEvent::Note);
        }
        self.patterns.iter().find_map(|pattern| {
            let values = pattern.values(&text)?;
            told(pattern.kind, &values)
        })
    }
}

/// A mode by its name.
pub(super) fn mode(name: &str) -> Option<ModeName> {
    ModeName::ALL.into_iter().find(|mode| mode.as_str() == name)
}

fn told(kind: Kind, values: &[&str]) -> Option<LogEvent> {
    let value = |k: usize| values.get(k).copied().filter(|value| !value.is_empty());
    let number = |k| value(k)?.parse::<f64>().ok().filter(|x| x.is_finite());
    let count = |k| value(k)?.parse::<u32>().ok();
    Some(match kind {
        Kind::Started => LogEvent::Started {
            cause: value(0)?.to_owned(),
        },
        Kind::Mode => LogEvent::Mode(mode(value(0)?)?),
        Kind::Coarse => LogEvent::Coarse {
            heading_deg: number(0)?,
            sd_deg: number(1)?,
        },
        Kind::NotAligned => LogEvent::NotAligned,
        Kind::AlignsAnew => LogEvent::AlignsAnew,
        Kind::Fault => LogEvent::Fault {
            name: value(0)?.to_owned(),
            text: value(1)?.to_owned(),
        },
        Kind::Retry => LogEvent::Retry { attempt: count(0)? },
        Kind::Latched => LogEvent::Latched,
        Kind::Lost => LogEvent::Lost {
            samples: count(0)?,
            total: count(1)?,
        },
        Kind::Repeated => LogEvent::Repeated { total: count(0)? },
        Kind::Transfer => LogEvent::Transfer,
        Kind::Overrun => LogEvent::Overrun { total: count(0)? },
        Kind::Bridged => LogEvent::Bridged { ms: number(0)? },
        Kind::Note => LogEvent::Note,
    })
}

/// Columns are aligned by spaces, of which there may be any number.
fn normal(text: &str) -> String {
    let words: Vec<&str> = text.split_whitespace().collect();
    words.join(" ")
}

/// A line, and the values that are to be found in it. A number is given without its decimals.
struct Example {
    kind: Kind,
    line: String,
    values: Vec<String>,
}

// Figures that stand in no text: a number in a line that begins with one of them is the value.
const A: u16 = 7101;
const B: u16 = 7202;
const C: u16 = 7303;

/// Lines of each kind.
fn examples() -> Vec<Example> {
    let cause = ResetCause::Watchdog;
    let start = Start {
        cause,
        asked: false,
        before: None,
    };
    let started = Example {
        kind: Kind::Started,
        line: start.to_string(),
        values: vec![cause.to_string()],
    };
    let events = events().into_iter().map(|(kind, event, values)| Example {
        kind,
        line: event.to_string(),
        values,
    });
    events.chain([started]).collect()
}

/// One event of each kind, and what of it is asked for.
fn events() -> Vec<(Kind, Event, Vec<String>)> {
    use Alignment as A_;
    let [a, b] = [f32::from(A), f32::from(B)];
    let tally = Tally {
        received: u32::from(A) + 1,
        lost: B.into(),
        repeated: C.into(),
        restarts: u32::from(A) + 2,
    };
    let (fault, error) = (Fault::Driver, Error::DriverFault);
    let (from, to) = (ModeName::Homing, ModeName::Coarse);
    let (command, failure, end) = (
        Command::Calibrate,
        CalibrationFailure::Timeout,
        NavigationEnd::BadSample,
    );
    let none = Vec::new;
    let of = |alignment| Event::Alignment(alignment);
    // What follows from the biases' use is another text.
    let gyros = |biases_used| GyrosCalibrated {
        bias_deg_h: [a; 3],
        biases_used,
        misalignment_arcmin: [a; 2],
        scale_factor_ppm: a,
        bias_sd_deg_h: a,
        column_sd_ppm: a,
    };
    let found = Found {
        gravity: a,
        rate: a,
        rate_sd: a,
        noise: a,
        noise_told: a,
    };
    let identity = Identity {
        product: A,
        revision: A,
        serial: A,
    };
    let texts = |values: &[&dyn ToString]| -> Vec<String> { values.iter().map(|value| value.to_string()).collect() };
    vec![
        (Kind::Mode, Event::Mode { from, to }, texts(&[&to, &from])),
        (Kind::Note, Event::Imu(identity), none()),
        (Kind::Note, Event::Encoder, none()),
        (Kind::Note, Event::Inspected(found), none()),
        (Kind::Note, Event::Noisy(found), none()),
        (Kind::Note, Event::Calibrated { offset: a * DEG as f32 }, none()),
        (Kind::Note, Event::Homed { angle: a * DEG as f32 }, none()),
        (
            Kind::Coarse,
            of(A_::CoarseDone {
                heading_deg: a,
                sd_deg: b,
            }),
            texts(&[&A, &B]),
        ),
        (Kind::Note, of(A_::CaughtUp), none()),
        (Kind::Note, of(A_::Aligned), none()),
        (Kind::NotAligned, of(A_::HeadingSd { sd_deg: a }), none()),
        (Kind::NotAligned, of(A_::Ambiguous { heading_offset_deg: a }), none()),
        (Kind::NotAligned, of(A_::Inconsistent { ratio: a }), none()),
        (Kind::Note, of(A_::Collecting), none()),
        (Kind::Bridged, of(A_::Bridged { ms: a }), texts(&[&A])),
        (Kind::AlignsAnew, of(A_::RestartedCoarse), none()),
        (Kind::AlignsAnew, of(A_::RestartedGap { length: a }), none()),
        (Kind::AlignsAnew, of(A_::RestartedBadSample), none()),
        (Kind::AlignsAnew, of(A_::RestartedDiverged), none()),
        (Kind::AlignsAnew, of(A_::UnderWay { speed: a }), none()),
        (Kind::AlignsAnew, of(A_::Elsewhere { latitude_deg: a }), none()),
        (Kind::Note, Event::GyrosCalibrated(gyros(true)), none()),
        (Kind::Note, Event::GyroBiases(gyros(true)), none()),
        (Kind::Note, Event::GyroBiases(gyros(false)), none()),
        (Kind::Note, Event::NotCalibrated(failure), texts(&[&failure])),
        (Kind::AlignsAnew, Event::NavigationEnded(end), texts(&[&end])),
        (Kind::Fault, Event::Fault(fault), texts(&[&fault.name(), &fault])),
        (Kind::Retry, Event::Retry { attempt: 203 }, texts(&[&203])),
        (Kind::Latched, Event::Latched, none()),
        (Kind::Note, Event::Slipped { late: a * 1e-3 }, none()),
        (Kind::Lost, Event::Lost { samples: A, tally }, texts(&[&A, &B])),
        (Kind::Repeated, Event::Repeated { tally }, texts(&[&C])),
        (Kind::Transfer, Event::Transfer(error), texts(&[&error])),
        (Kind::Overrun, Event::Overrun { samples: A.into() }, texts(&[&A])),
        (Kind::Note, Event::Command(command), texts(&[&command])),
        (
            Kind::Note,
            Event::Refused { command, mode: from },
            texts(&[&command, &from]),
        ),
    ]
}

impl Piece {
    fn literal_length(&self) -> usize {
        match self {
            Self::Literal(text) => text.len(),
            Self::Value(_) => 0,
        }
    }
}

/// Cuts a rendered line into what is the same for all of its kind, and values.
fn pieces(line: &str, values: &[String]) -> Vec<Piece> {
    let mut pieces = vec![Piece::Literal(line.to_owned())];
    for (place, value) in values.iter().enumerate() {
        let found = pieces.iter().enumerate().find_map(|(k, piece)| match piece {
            Piece::Literal(text) => Some((k, text.clone(), text.find(value.as_str())?)),
            Piece::Value(_) => None,
        });
        let Some((k, text, begin)) = found else { continue };
        let mut end = begin + value.len();
        if value.bytes().all(|b| b.is_ascii_digit()) {
            end += number_length(&text[end..]);
        }
        pieces.splice(k..=k, cut(&text, begin, end, Some(place)));
    }
    // What else is a number is a value too.
    let mut k = 0;
    while k < pieces.len() {
        if let Piece::Literal(text) = &pieces[k]
            && let Some((begin, end)) = number(text)
        {
            let text = text.clone();
            pieces.splice(k..=k, cut(&text, begin, end, None));
        }
        k += 1;
    }
    pieces
}

/// What is before, the value, and what is after; without what is empty.
fn cut(text: &str, begin: usize, end: usize, place: Option<usize>) -> Vec<Piece> {
    let literal = |text: &str| Piece::Literal(text.to_owned());
    let mut cut = vec![literal(&text[..begin]), Piece::Value(place), literal(&text[end..])];
    cut.retain(|piece| *piece != literal(""));
    cut
}

/// How far a number goes on.
fn number_length(text: &str) -> usize {
    text.bytes().take_while(|b| b.is_ascii_digit() || *b == b'.').count()
}

/// The first number of a text that is a word of its own, with its sign and whatever its base: `m/s2` is none.
fn number(text: &str) -> Option<(usize, usize)> {
    let bytes = text.as_bytes();
    let digit = |k: usize| bytes.get(k).is_some_and(u8::is_ascii_digit);
    let signed = |k: usize| matches!(bytes[k], b'+' | b'-') && digit(k + 1);
    let begins = |k: usize| (digit(k) || signed(k)) && (k == 0 || matches!(bytes[k - 1], b' ' | b'('));
    let begin = (0..bytes.len()).find(|k| begins(*k))?;
    let length = bytes[begin + 1..]
        .iter()
        .take_while(|b| b.is_ascii_alphanumeric() || **b == b'.');
    Some((begin, begin + 1 + length.count()))
}

impl Pattern {
    /// The values of a line, where it is of this kind: empty where one is missing.
    fn values<'a>(&self, mut text: &'a str) -> Option<Vec<&'a str>> {
        let mut values = Vec::new();
        // The place of a value that ends where the next literal begins.
        let mut open: Option<Option<usize>> = None;
        let mut keep = |place: Option<usize>, value: &'a str| {
            if let Some(place) = place {
                if values.len() <= place {
                    values.resize(place + 1, "");
                }
                values[place] = value;
            }
        };
        for (k, piece) in self.pieces.iter().enumerate() {
            match piece {
                Piece::Value(place) => open = Some(*place),
                Piece::Literal(literal) => {
                    let at = match open {
                        None => text.starts_with(literal.as_str()).then_some(0)?,
                        // The last one ends the line.
                        Some(_) if k + 1 == self.pieces.len() => text.strip_suffix(literal.as_str())?.len(),
                        Some(_) => text.find(literal.as_str())?,
                    };
                    if let Some(place) = open.take() {
                        keep(place, &text[..at]);
                    }
                    text = &text[at + literal.len()..];
                }
            }
        }
        match open {
            Some(place) => keep(place, text),
            None if !text.is_empty() => return None,
            None => {}
        }
        Some(values)
    }
}

/// Attitude by its labels.
fn estimate(text: &str) -> Option<Attitude> {
    Some(Attitude {
        heading_deg: labelled(text, HEADING)?,
        heading_sd_deg: labelled(text, SD)?,
        pitch_deg: labelled(text, PITCH)?,
        roll_deg: labelled(text, ROLL)?,
    })
}

/// Whether it is the line of a second without an estimate.
fn is_report(text: &str) -> bool {
    let mut words = text.split(' ');
    words.next().and_then(mode).is_some() && words.next() == Some(ROTOR)
}

/// The number after a label; between them may be signs.
fn labelled(text: &str, label: &str) -> Option<f64> {
    let word = |c: char| c.is_ascii_alphanumeric() || c == '_';
    let after = text.match_indices(label).find_map(|(at, _)| {
        let before = text[..at].chars().next_back();
        (!before.is_some_and(word)).then(|| &text[at + label.len()..])
    })?;
    let value = after.trim_start_matches([' ', ':', '=']);
    let end = value
        .find(|c: char| !(c.is_ascii_digit() || matches!(c, '+' | '-' | '.' | 'e' | 'E')))
        .unwrap_or(value.len());
    value[..end].parse().ok().filter(|x: &f64| x.is_finite())
}

#[cfg(test)]
mod tests {
    use app::fault::Task;
    use app::log::Report;
    use app::rotor::{Refused, RotorFault};
    use app::selftest::Failure;
    use drivers::mt6835::Warnings;
    use drivers::{Channels, SystemFlags};
    use proptest::prelude::*;

    use super::*;

    /// What a line of an event must be read as. Exhaustive on purpose: who adds an event adds an example above.
    fn expected(event: &Event) -> LogEvent {
        match *event {
            Event::Mode { to, .. } => LogEvent::Mode(to),
            Event::Imu(_)
            | Event::Encoder
            | Event::Inspected(_)
            | Event::Noisy(_)
            | Event::Calibrated { .. }
            | Event::Homed { .. }
            | Event::Slipped { .. } => LogEvent::Note,
            Event::Alignment(told) => match told {
                Alignment::CoarseDone { heading_deg, sd_deg } => LogEvent::Coarse {
                    heading_deg: heading_deg.into(),
                    sd_deg: sd_deg.into(),
                },
                Alignment::CaughtUp | Alignment::Aligned | Alignment::Collecting => LogEvent::Note,
                Alignment::HeadingSd { .. } | Alignment::Ambiguous { .. } | Alignment::Inconsistent { .. } => {
                    LogEvent::NotAligned
                }
                Alignment::Bridged { ms } => LogEvent::Bridged { ms: ms.into() },
                Alignment::RestartedCoarse
                | Alignment::RestartedGap { .. }
                | Alignment::RestartedBadSample
                | Alignment::RestartedDiverged
                | Alignment::UnderWay { .. }
                | Alignment::Elsewhere { .. } => LogEvent::AlignsAnew,
            },
            Event::GyrosCalibrated(_) | Event::GyroBiases(_) | Event::NotCalibrated(_) => LogEvent::Note,
            Event::NavigationEnded(_) => LogEvent::AlignsAnew,
            Event::Fault(fault) => LogEvent::Fault {
                name: fault.name().to_owned(),
                text: String::new(),
            },
            Event::Retry { attempt } => LogEvent::Retry {
                attempt: attempt.into(),
            },
            Event::Latched => LogEvent::Latched,
            Event::Lost { samples, tally } => LogEvent::Lost {
                samples: samples.into(),
                total: tally.lost,
            },
            Event::Repeated { tally } => LogEvent::Repeated { total: tally.repeated },
            Event::Transfer(_) => LogEvent::Transfer,
            Event::Overrun { samples } => LogEvent::Overrun { total: samples },
            Event::Command(_) | Event::Refused { .. } | Event::Report(Report { attitude_deg: None, .. }) => {
                LogEvent::Note
            }
            Event::Report(Report {
                attitude_deg: Some([heading, pitch, roll, sd]),
                ..
            }) => LogEvent::Estimate(Attitude {
                heading_deg: heading.into(),
                heading_sd_deg: sd.into(),
                pitch_deg: pitch.into(),
                roll_deg: roll.into(),
            }),
        }
    }

    /// A fault of each kind.
    fn faults(x: f32, n: u16) -> Vec<Fault> {
        let rotor = RotorFault::Stall { angle: x };
        vec![
            Fault::ImuSilent { waited_us: n.into() },
            Fault::ImuTransfer {
                error: Error::Crc {
                    computed: n.into(),
                    received: 5,
                },
                in_row: n,
            },
            Fault::ImuSaturated {
                channels: Channels::from_bits(5),
                in_row: n,
            },
            Fault::ImuStuck { in_row: n },
            Fault::ImuRestarted,
            Fault::ImuFlags {
                flags: SystemFlags::from_bits(n),
            },
            Fault::OverTemperature { temperature_c: x },
            Fault::Clock {
                expected_us: x,
                measured_us: x,
            },
            Fault::EncoderInvalid,
            Fault::EncoderFrozen,
            Fault::EncoderWarning {
                warnings: Warnings::from_bits(3),
            },
            Fault::Driver,
            Fault::Stall { rotor },
            Fault::Rotor(RotorFault::HomeInvalid),
            Fault::RotorRefused(Refused::NoHome),
            Fault::TaskOverrun {
                task: Task::Motor,
                silent_ms: n.into(),
            },
            Fault::SelfTest(Failure::Rate { found: x }),
        ]
    }

    /// Events of every kind.
    fn events(x: f32, y: f32, n: u16, m: u16) -> Vec<Event> {
        let tally = Tally {
            received: n.into(),
            lost: m.into(),
            repeated: u32::from(n) + 1,
            restarts: 3,
        };
        let of = Event::Alignment;
        let mut events = vec![
            Event::Imu(Identity {
                product: n,
                revision: m,
                serial: n,
            }),
            Event::Encoder,
            Event::Inspected(Found {
                gravity: x,
                rate: y,
                rate_sd: x,
                noise: y,
                noise_told: x,
            }),
            Event::Noisy(Found {
                gravity: x,
                rate: y,
                rate_sd: x,
                noise: y,
                noise_told: x,
            }),
            Event::Calibrated { offset: x },
            Event::Homed { angle: y },
            of(Alignment::CoarseDone {
                heading_deg: x,
                sd_deg: y,
            }),
            of(Alignment::CaughtUp),
            of(Alignment::Aligned),
            of(Alignment::HeadingSd { sd_deg: x }),
            of(Alignment::Ambiguous { heading_offset_deg: x }),
            of(Alignment::Inconsistent { ratio: x }),
            of(Alignment::Collecting),
            of(Alignment::Bridged { ms: y }),
            of(Alignment::RestartedCoarse),
            of(Alignment::RestartedGap { length: x }),
            of(Alignment::RestartedBadSample),
            of(Alignment::RestartedDiverged),
            of(Alignment::UnderWay { speed: x }),
            of(Alignment::Elsewhere { latitude_deg: x }),
            Event::Retry { attempt: n as u8 },
            Event::Latched,
            Event::Slipped { late: x },
            Event::Lost { samples: n, tally },
            Event::Repeated { tally },
            Event::Transfer(Error::Header { found: n }),
            Event::Overrun { samples: m.into() },
        ];
        for to in ModeName::ALL {
            events.push(Event::Mode {
                from: ModeName::Fine,
                to,
            });
        }
        for command in Command::ALL {
            events.push(Event::Command(command));
            events.push(Event::Refused {
                command,
                mode: ModeName::SelfTest,
            });
        }
        for biases_used in [true, false] {
            let found = GyrosCalibrated {
                bias_deg_h: [x, y, -x],
                biases_used,
                misalignment_arcmin: [y, x],
                scale_factor_ppm: -y,
                bias_sd_deg_h: x,
                column_sd_ppm: y,
            };
            events.push(Event::GyrosCalibrated(found));
            events.push(Event::GyroBiases(found));
        }
        for failure in [
            CalibrationFailure::RotorMoved,
            CalibrationFailure::BaseMoved { scatter: x },
            CalibrationFailure::Refused,
            CalibrationFailure::Timeout,
        ] {
            events.push(Event::NotCalibrated(failure));
        }
        for end in [
            NavigationEnd::NotAligned,
            NavigationEnd::Gap { length: x },
            NavigationEnd::BadSample,
            NavigationEnd::Lost,
        ] {
            events.push(Event::NavigationEnded(end));
        }
        events.extend(faults(x, n).into_iter().map(Event::Fault));
        events
    }

    /// The same but for a fault's text, and for the digits that are not printed.
    fn alike(found: &LogEvent, expected: &LogEvent) -> bool {
        let near = |a: f64, b: f64| (a - b).abs() <= 0.051 + 1e-6 * b.abs();
        match (found, expected) {
            (LogEvent::Fault { name, text }, LogEvent::Fault { name: expected, .. }) => {
                name == expected && !text.is_empty()
            }
            (
                LogEvent::Coarse { heading_deg, sd_deg },
                LogEvent::Coarse {
                    heading_deg: heading,
                    sd_deg: sd,
                },
            ) => near(*heading_deg, *heading) && near(*sd_deg, *sd),
            (LogEvent::Bridged { ms }, LogEvent::Bridged { ms: expected }) => near(*ms, *expected),
            _ => found == expected,
        }
    }

    proptest! {
        #[test]
        fn what_the_unit_says_is_understood(
            x in -1e6_f32..1e6,
            y in -400.0_f32..400.0,
            n in any::<u16>(),
            m in any::<u16>(),
        ) {
            let parser = LogParser::learn();
            for event in events(x, y, n, m) {
                let line = event.to_string();
                let found = parser.read(&line);
                prop_assert!(
                    found.as_ref().is_some_and(|found| alike(found, &expected(&event))),
                    "{line}: {found:?}"
                );
            }
        }

        #[test]
        fn any_text_is_read_or_not(text in any::<String>()) {
            let _ = LogParser::learn().read(&text);
        }
    }

    #[test]
    fn each_kind_has_its_example() {
        for event in events(1.0, 2.0, 3, 4) {
            let same = |other: &Event| match (&event, other) {
                (Event::Alignment(a), Event::Alignment(b)) => core::mem::discriminant(a) == core::mem::discriminant(b),
                _ => core::mem::discriminant(&event) == core::mem::discriminant(other),
            };
            assert!(super::events().iter().any(|(_, example, _)| same(example)), "{event:?}");
        }
    }

    /// The lines that are no events.
    #[test]
    fn the_first_lines_are_understood() {
        let parser = LogParser::learn();
        for cause in [ResetCause::PowerOn, ResetCause::BrownOut, ResetCause::Pin] {
            for asked in [false, true] {
                let line = Start {
                    cause,
                    asked,
                    before: None,
                }
                .to_string();
                assert!(
                    matches!(parser.read(&line), Some(LogEvent::Started { cause: told }) if told.starts_with(&cause.to_string())),
                    "{line}"
                );
            }
        }
        // As they are in `app::log`.
        let source = include_str!("../../../firmware/crates/app/src/log.rs");
        for (text, told) in [
            (format!("{VERSION}{{}}"), LogEvent::Version),
            (format!("{SETTINGS}{{}} {{}}"), LogEvent::Note),
        ] {
            assert!(source.contains(&format!("\"{text}\"")), "{text}");
            assert_eq!(parser.read(&text.replace("{}", "x")), Some(told), "{text}");
        }
    }

    #[test]
    fn the_line_of_a_second_is_read_back() {
        let parser = LogParser::learn();
        let report = |attitude_deg| {
            let report = Report {
                mode: ModeName::Navigating,
                attitude_deg,
                rotor_deg: Some(-12.34),
            };
            parser.read(&Event::Report(report).to_string())
        };
        let attitude = Attitude {
            heading_deg: 5.68,
            heading_sd_deg: 0.35,
            pitch_deg: -0.06,
            roll_deg: 12.0,
        };
        assert_eq!(
            report(Some([5.678, -0.061, 11.996, 0.349_7])),
            Some(LogEvent::Estimate(attitude))
        );
        assert_eq!(report(None), Some(LogEvent::Note));
    }

    #[test]
    fn columns_may_change() {
        let parser = LogParser::learn();
        let attitude = Attitude {
            heading_deg: 5.5,
            heading_sd_deg: 0.25,
            pitch_deg: -1.0,
            roll_deg: 2.0,
        };
        for line in [
            "heading   5.50 deg  sd 0.250 deg  pitch  -1.00 deg  roll   2.00 deg",
            "aligned  heading=5.5 sd=0.25 pitch=-1 roll=2e0",
        ] {
            assert_eq!(parser.read(line), Some(LogEvent::Estimate(attitude)), "{line}");
        }
        assert_eq!(parser.read("heading inf deg, sd 1; pitch 0, roll 0"), None);
        assert_eq!(
            parser.read("mode   fine     ->   aligned"),
            Some(LogEvent::Mode(ModeName::Aligned))
        );
        assert_eq!(parser.read("mode fine -> lunch"), None);
    }
}
