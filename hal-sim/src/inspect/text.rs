//! A log as text: lines of `probe-rs`, `defmt-print`, `cargo emulate` and `hal-sim unit`.
//!
//! ```text
//! 69.943000 INFO heading 335.67 deg, ...          defmt-print; the next line tells where in the source
//! 69.943000 [INFO ] heading 335.67 deg, ... (app src/log.rs:12)                               probe-rs
//! [   69.943000] INFO  heading 335.67 deg, ...                            cargo emulate, hal-sim unit
//! {"data":"aligned","level":"INFO","target_timestamp":"71.807000",…}                     defmt-print --json
//! $PRNST,184.08,aligned,115,0.468,,,,34.49*09                                 the unit's serial port
//! ```
//!
//! A line is one of the log where it has a level; the number before it is its time. JSON is read by the names of the fields of
//! defmt-json-schema 0.1, `v1::JsonFrame`: what else is in an object does not matter.

use log::Level;
use serde_json::Value;

use super::parser::{self, Attitude};
use crate::nmea;

/// Levels by name. What the emulator says itself has one of its own.
const LEVELS: [(&str, Option<Level>); 6] = [
    ("ERROR", Some(Level::Error)),
    ("WARN", Some(Level::Warn)),
    ("INFO", Some(Level::Info)),
    ("DEBUG", Some(Level::Debug)),
    ("TRACE", Some(Level::Trace)),
    ("HOST", None),
];
/// Where a level is looked for, characters.
const HEAD: usize = 80;

/// A line of the log.
#[derive(Debug, Clone, PartialEq)]
pub struct Line {
    /// The time it gives, s.
    pub t_s: Option<f64>,
    /// Its level; none where a host wrote it.
    pub level: Option<Level>,
    /// Its text.
    pub text: String,
}

/// What the serial port says once a second, and the attitude that came before it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Status {
    /// Time since the start, s.
    pub t_s: f64,
    /// The mode.
    pub mode: Option<app::command::ModeName>,
    /// 1σ of the heading, degrees.
    pub heading_sd_deg: Option<f64>,
}

/// A line of the log, without what stands around it.
pub fn line(raw: &str) -> Option<Line> {
    if raw.starts_with('{') {
        return json(raw);
    }
    let plain = plain(raw);
    let (begin, end, level) = level(&plain)?;
    let time = plain[..begin].split_whitespace().rev().find_map(time);
    let text = plain[end..].trim_start_matches([' ', ']']).trim_end();
    Some(Line {
        t_s: time,
        level,
        text: without_place(text).to_owned(),
    })
}

/// A frame of defmt as JSON; without a level, as `println!` of defmt has none, it is a host's.
fn json(raw: &str) -> Option<Line> {
    let object: Value = serde_json::from_str(raw).ok()?;
    let of = |name: &str| object.get(name)?.as_str();
    Some(Line {
        t_s: of("target_timestamp").and_then(time),
        level: of("level").and_then(|level| level.parse().ok()),
        text: of("data")?.to_owned(),
    })
}

/// The first level that stands alone, or in brackets: from where to where, and which.
fn level(text: &str) -> Option<(usize, usize, Option<Level>)> {
    let head = text.char_indices().nth(HEAD).map_or(text, |(at, _)| &text[..at]);
    let found = LEVELS.iter().filter_map(|(name, level)| {
        let at = head.find(name)?;
        let before = text[..at].chars().next_back();
        let after = text[at + name.len()..].chars().next();
        let apart = |c: Option<char>, bracket| c.is_none_or(|c| c == ' ' || c == bracket);
        (apart(before, '[') && apart(after, ']')).then_some((at, at + name.len(), *level))
    });
    found.min_by_key(|(at, ..)| *at)
}

/// A time in seconds, or in days, hours, minutes and seconds.
pub(super) fn time(word: &str) -> Option<f64> {
    let word = word.trim_matches(['[', ']']);
    if !word.bytes().all(|b| b.is_ascii_digit() || matches!(b, b'.' | b':')) {
        return None;
    }
    let parts: Vec<f64> = word.split(':').map(|part| part.parse().ok()).collect::<Option<_>>()?;
    let (seconds, higher) = parts.split_last()?;
    let minutes = higher.iter().rev().zip([60.0, 3600.0, 86_400.0]);
    let time = seconds + minutes.map(|(n, unit)| n * unit).sum::<f64>();
    (higher.len() <= 3 && time.is_finite()).then_some(time)
}

/// Without the colours of a terminal.
fn plain(text: &str) -> String {
    let mut plain = String::with_capacity(text.len());
    let mut chars = text.chars();
    while let Some(c) = chars.next() {
        match c {
            // ESC [ parameters, and one letter.
            '\u{1b}' => {
                if chars.next() == Some('[') {
                    let _ = chars.find(|c| ('@'..='~').contains(c));
                }
            }
            '\t' => plain.push(' '),
            c if c.is_control() => {}
            c => plain.push(c),
        }
    }
    plain
}

/// Without the place in the source that probe-rs puts at the end: ` (crate path.rs:12)`.
fn without_place(text: &str) -> &str {
    let place = || {
        let (text, place) = text.strip_suffix(')')?.rsplit_once(" (")?;
        let (file, line) = place.rsplit_once(':')?;
        (file.ends_with(".rs") && line.bytes().all(|b| b.is_ascii_digit())).then_some(text)
    };
    place().unwrap_or(text)
}

/// The fields of a sentence of NMEA 0183 whose check sum is right, its name first.
pub fn sentence(raw: &str) -> Option<Vec<&str>> {
    Some(nmea::body(raw.trim()).ok()?.split(',').collect())
}

fn number(fields: &[&str], k: usize) -> Option<f64> {
    fields.get(k)?.parse().ok().filter(|x: &f64| x.is_finite())
}

/// `$PASHR` with an attitude in it.
pub fn pashr(fields: &[&str]) -> Option<Attitude> {
    if fields.first() != Some(&"PASHR") {
        return None;
    }
    Some(Attitude {
        heading_deg: number(fields, 2)?,
        roll_deg: number(fields, 4)?,
        pitch_deg: number(fields, 5)?,
        heading_sd_deg: number(fields, 9)?,
    })
}

/// `$PRNST`.
pub fn prnst(fields: &[&str]) -> Option<Status> {
    if fields.first() != Some(&"PRNST") {
        return None;
    }
    Some(Status {
        t_s: number(fields, 1)?,
        mode: fields.get(2).and_then(|name| parser::mode(name)),
        heading_sd_deg: number(fields, 4),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_of_each_kind_are_cut() {
        let text = "aligned     rotor +129.7 deg, heading 323.54 deg, sd  0.363 deg, pitch  +5.00 deg, roll  -4.72 deg";
        for (raw, t_s) in [
            (format!("69.943000 INFO  {text}"), Some(69.943)),
            (
                format!("69.943000 [INFO ] {text} (firmware firmware/src/tasks.rs:143)"),
                Some(69.943),
            ),
            (format!("[   69.943000] INFO  {text}\r"), Some(69.943)),
            (
                format!("\u{1b}[2m69.943000\u{1b}[0m \u{1b}[32mINFO\u{1b}[0m {text}"),
                Some(69.943),
            ),
            (format!("00:01:09.943 INFO {text}"), Some(69.943)),
            (format!("INFO {text}"), None),
            (format!("noise of a tool 69.943 [INFO] {text}"), Some(69.943)),
        ] {
            let found = line(&raw).unwrap();
            assert_eq!((found.level, found.text.as_str()), (Some(Level::Info), text), "{raw}");
            assert!(
                found.t_s.zip(t_s).is_none_or(|(a, b)| (a - b).abs() < 1e-9),
                "{raw}: {found:?}"
            );
            assert_eq!(found.t_s.is_some(), t_s.is_some());
        }
        assert_eq!(line("[    9.300000] HOST  -- power on --").unwrap().level, None);
        for none in [
            "",
            "└─ firmware::tasks @ firmware/src/tasks.rs:143",
            "   Compiling hal-sim v0.1.0",
            "$HETHS,,V*14",
            "INFORMATION",
        ] {
            assert_eq!(line(none), None, "{none}");
        }
    }

    #[test]
    fn sentences_are_read() {
        let fields = sentence("$PASHR,,305.30,T,+0.05,-0.13,,0.002,0.001,0.350,0,1*10\r").unwrap();
        let attitude = pashr(&fields).unwrap();
        assert_eq!((attitude.heading_deg, attitude.heading_sd_deg), (305.3, 0.35));
        assert_eq!((attitude.pitch_deg, attitude.roll_deg), (-0.13, 0.05));
        let fields = sentence("$PRNST,184.08,aligned,115,0.468,,,,34.49*09").unwrap();
        let status = prnst(&fields).unwrap();
        assert_eq!((status.t_s, status.heading_sd_deg), (184.08, Some(0.468)));
        assert_eq!(status.mode, Some(app::command::ModeName::Aligned));
        assert_eq!(sentence("$PRNST,184.08,aligned,115,0.468,,,,34.49*08"), None);
        assert_eq!(pashr(&sentence("$PASHR,,,,,,,,,,,0,0*58").unwrap()), None);
    }
}
