//! Takes a unit's line apart: sentences, the frames of a recording between them, and what is neither.
//!
//! Pure: bytes and the time of their coming in, the latest of each value and counts out. Whatever comes, memory is
//! bounded: a sentence has [`LONGEST`] bytes at the most, a frame 261.

use std::collections::VecDeque;

use app::nmea::LONGEST;
use app::record;
use drivers::crc::crc32;

use crate::nmea;

/// Time over which sentences are counted for their rate, s.
const RATE_S: f64 = 3.0;
/// Later than this after its coming a value is old, s: ten cycles.
pub const FRESH_S: f64 = 1.0;

/// What a received line was; its values are kept by the monitor.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum LineEvent {
    /// An answer to a command.
    Answer {
        /// Whether the unit obeys.
        ok: bool,
        /// In its words.
        text: String,
    },
    /// A message that nobody has asked for: TXT.
    Text(String),
    /// A status sentence: the end of a cycle.
    Status,
    /// Another sentence.
    Other,
}

/// The status sentence.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Status {
    /// Time since the unit's start, s.
    pub up_s: f64,
    /// Mode by name; empty before the first.
    pub mode: String,
    /// Time in this mode, s.
    pub mode_s: f64,
    /// 1σ of the heading, °.
    pub heading_sd: Option<f64>,
    /// Why the heading is not what it should be.
    pub reason: String,
    /// The fault by name, and whether it stays.
    pub fault: Option<(String, bool)>,
    /// Angle of the rotor, °.
    pub rotor: Option<f64>,
}

/// A place by dead reckoning.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Place {
    /// °, north positive.
    pub latitude: f64,
    /// °, east positive.
    pub longitude: f64,
}

/// Pitch and roll, °.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Level {
    /// Front up positive.
    pub pitch: f64,
    /// Right side down positive.
    pub roll: f64,
}

/// What was heard since the beginning.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Counts {
    /// Bytes, of whatever kind.
    pub bytes: u64,
    /// Sentences whose check sum is right.
    pub sentences: u64,
    /// Whole lines whose check sum is wrong.
    pub checksum: u64,
    /// Lines that began as a sentence and did not end as one.
    pub broken: u64,
    /// Frames of a recording.
    pub frames: u64,
    /// Frames that came damaged.
    pub damaged: u64,
}

/// The latest of something, and when it came.
#[derive(Debug, Clone, Copy)]
struct Latest<T> {
    at_s: f64,
    value: T,
}

/// Where in a line the next byte belongs.
#[derive(Debug, Default)]
enum Within {
    #[default]
    Nothing,
    /// From its `$` on.
    Sentence(Vec<u8>),
    /// From its sync byte on.
    Frame(Vec<u8>),
}

/// See the [module](self).
#[derive(Debug, Default)]
pub struct Monitor {
    within: Within,
    counts: Counts,
    heading: Option<Latest<(Option<f64>, char)>>,
    level: Option<Latest<Option<Level>>>,
    turn: Option<Latest<Option<f64>>>,
    place: Option<Latest<Place>>,
    speed: Option<Latest<f64>>,
    status: Option<Latest<Status>>,
    /// When the latest sentences came, s.
    times: VecDeque<f64>,
}

impl Monitor {
    /// Takes bytes that have come at `now_s`; tells what was whole with them.
    pub fn take(&mut self, bytes: &[u8], now_s: f64, heard: &mut dyn FnMut(LineEvent, &Self)) {
        self.counts.bytes += bytes.len() as u64;
        // What a frame held that turned out to be none is looked at again, before what came after it.
        let mut rest: VecDeque<u8> = bytes.iter().copied().collect();
        while let Some(byte) = rest.pop_front() {
            self.push(byte, &mut rest, now_s, heard);
        }
    }

    fn push(&mut self, byte: u8, rest: &mut VecDeque<u8>, now_s: f64, heard: &mut dyn FnMut(LineEvent, &Self)) {
        match core::mem::take(&mut self.within) {
            Within::Frame(mut frame) => {
                frame.push(byte);
                let body = frame.get(1).copied().map_or(0, usize::from);
                if frame.len() < record::LEAD + body + record::CRC {
                    self.within = Within::Frame(frame);
                } else if is_frame(&frame) {
                    self.counts.frames += 1;
                } else {
                    self.counts.damaged += 1;
                    for byte in frame.into_iter().skip(1).rev() {
                        rest.push_front(byte);
                    }
                }
            }
            within if byte == b'$' => {
                self.counts.broken += u64::from(matches!(within, Within::Sentence(_)));
                self.within = Within::Sentence(vec![byte]);
            }
            within if byte == record::SYNC => {
                self.counts.broken += u64::from(matches!(within, Within::Sentence(_)));
                self.within = Within::Frame(vec![byte]);
            }
            Within::Sentence(mut line) => {
                line.push(byte);
                if byte == b'\n' {
                    self.end(&line, now_s, heard);
                } else if line.len() < LONGEST && (byte == b'\r' || matches!(byte, b' '..=b'~')) {
                    self.within = Within::Sentence(line);
                } else {
                    self.counts.broken += 1;
                }
            }
            Within::Nothing => {}
        }
    }

    fn end(&mut self, line: &[u8], now_s: f64, heard: &mut dyn FnMut(LineEvent, &Self)) {
        let text = core::str::from_utf8(line).unwrap_or_default().trim_end();
        let body = match nmea::body(text) {
            Ok(body) => body,
            Err(nmea::Wrong::Frame) => {
                self.counts.broken += 1;
                return;
            }
            Err(nmea::Wrong::CheckSum) => {
                self.counts.checksum += 1;
                return;
            }
        };
        self.counts.sentences += 1;
        self.times.push_back(now_s);
        while self.times.front().is_some_and(|at| now_s - at > RATE_S) {
            self.times.pop_front();
        }
        let told = self.sentence(body, now_s);
        heard(told, self);
    }

    fn sentence(&mut self, body: &str, now_s: f64) -> LineEvent {
        let fields: Vec<&str> = body.split(',').collect();
        let field = |n: usize| fields.get(n).copied().unwrap_or_default();
        let number = |n: usize| field(n).parse().ok().filter(|value: &f64| value.is_finite());
        // A text has no commas: it is the rest.
        let from = |n: usize| {
            let rest = body.splitn(n + 1, ',').nth(n).unwrap_or_default();
            rest.trim_end().to_owned()
        };
        fn at<T>(at_s: f64, value: T) -> Option<Latest<T>> {
            Some(Latest { at_s, value })
        }
        // The talker is not looked at: who speaks on a line is known.
        match field(0) {
            "PRNSA" => {
                return LineEvent::Answer {
                    ok: field(1) == "ok",
                    text: from(2),
                };
            }
            "PRNST" => {
                let fault = Some(field(6)).filter(|name| !name.is_empty());
                let status = Status {
                    up_s: number(1).unwrap_or_default(),
                    mode: field(2).to_owned(),
                    mode_s: number(3).unwrap_or_default(),
                    heading_sd: number(4),
                    reason: field(5).to_owned(),
                    fault: fault.map(|name| (name.to_owned(), field(7) == "L")),
                    rotor: number(8),
                };
                self.status = at(now_s, status);
                return LineEvent::Status;
            }
            "PASHR" => {
                let level = number(5).zip(number(4)).map(|(pitch, roll)| Level { pitch, roll });
                self.level = at(now_s, level);
            }
            address => match address.get(2..) {
                Some("THS") => {
                    let mode = field(2).chars().next().unwrap_or('V');
                    self.heading = at(now_s, (number(1).filter(|_| mode != 'V'), mode));
                }
                Some("ROT") => self.turn = at(now_s, number(1).filter(|_| field(2) == "A")),
                Some("GLL") => {
                    let latitude = degrees(field(1), field(2) == "S");
                    let place = latitude.zip(degrees(field(3), field(4) == "W"));
                    if let Some((latitude, longitude)) = place {
                        self.place = at(now_s, Place { latitude, longitude });
                    }
                }
                Some("VTG") => {
                    if let Some(km_h) = number(7) {
                        self.speed = at(now_s, km_h / 3.6);
                    }
                }
                Some("TXT") => return LineEvent::Text(from(4)),
                _ => {}
            },
        }
        LineEvent::Other
    }

    /// What was heard since the beginning.
    pub const fn counts(&self) -> Counts {
        self.counts
    }

    /// Sentences a second, of late.
    pub fn rate(&self, now_s: f64) -> f64 {
        let recent = self.times.iter().filter(|at| now_s - **at <= RATE_S).count();
        // At the beginning there was less time than that.
        recent as f64 / now_s.clamp(0.1, RATE_S)
    }

    /// Time since the last sentence, s.
    pub fn silent_s(&self, now_s: f64) -> f64 {
        now_s - self.times.back().copied().unwrap_or_default()
    }

    /// Heading, ° and mode indicator, while it is fresh.
    pub fn heading(&self, now_s: f64) -> (Option<f64>, char) {
        fresh(&self.heading, now_s).copied().unwrap_or((None, 'V'))
    }

    /// Pitch and roll, while they are fresh.
    pub fn level(&self, now_s: f64) -> Option<Level> {
        fresh(&self.level, now_s).copied().flatten()
    }

    /// Rate of turn, °/min, while it is fresh.
    pub fn turn(&self, now_s: f64) -> Option<f64> {
        fresh(&self.turn, now_s).copied().flatten()
    }

    /// Place and speed, m/s, while they are fresh.
    pub fn track(&self, now_s: f64) -> Option<(Place, f64)> {
        fresh(&self.place, now_s)
            .copied()
            .zip(fresh(&self.speed, now_s).copied())
    }

    /// The last status, however old.
    pub fn status(&self) -> Option<&Status> {
        self.status.as_ref().map(|latest| &latest.value)
    }
}

fn fresh<T>(latest: &Option<Latest<T>>, now_s: f64) -> Option<&T> {
    latest
        .as_ref()
        .filter(|latest| now_s - latest.at_s <= FRESH_S)
        .map(|latest| &latest.value)
}

/// Of `dddmm.mmmm`.
fn degrees(text: &str, negative: bool) -> Option<f64> {
    let value: f64 = text.parse().ok().filter(|value: &f64| value.is_finite())?;
    let whole = (value / 100.0).trunc();
    let degrees = whole + (value - 100.0 * whole) / 60.0;
    Some(if negative { -degrees } else { degrees })
}

fn is_frame(frame: &[u8]) -> bool {
    let Some((head, crc)) = frame.split_last_chunk::<{ record::CRC }>() else {
        return false;
    };
    crc32(head.iter().skip(1).copied()) == u32::from_le_bytes(*crc)
}

#[cfg(test)]
mod tests {
    use app::nmea::{self, Talker};
    use proptest::prelude::*;

    use super::*;

    fn heard(monitor: &mut Monitor, bytes: &[u8], now_s: f64) -> Vec<LineEvent> {
        let mut all = Vec::new();
        monitor.take(bytes, now_s, &mut |heard, _| all.push(heard));
        all
    }

    fn frame(body: &[u8]) -> Vec<u8> {
        let mut frame = vec![record::SYNC, body.len() as u8];
        frame.extend_from_slice(body);
        let crc = crc32(frame[1..].iter().copied());
        frame.extend_from_slice(&crc.to_le_bytes());
        frame
    }

    const CYCLE: &[u8] = b"$HETHS,339.02,A*16\r\n$HEHDT,339.02,T*14\r\n$HEROT,464.3,A*2E\r\n\
        $PASHR,,339.02,T,-4.90,-4.99,,0.001,0.001,0.468,0,1*19\r\n\
        $PRNST,184.08,aligned,115,0.468,,,,34.49*09\r\n";

    #[test]
    fn a_cycle_is_all_there() {
        let mut monitor = Monitor::default();
        let all = heard(&mut monitor, CYCLE, 2.0);
        assert_eq!(all.last(), Some(&LineEvent::Status));
        assert_eq!((all.len(), monitor.counts().sentences), (5, 5));
        assert_eq!(monitor.heading(2.5), (Some(339.02), 'A'));
        assert_eq!(
            monitor.level(2.5),
            Some(Level {
                pitch: -4.99,
                roll: -4.9
            })
        );
        assert_eq!(monitor.turn(2.5), Some(464.3));
        let status = monitor.status().unwrap();
        assert_eq!((status.mode.as_str(), status.mode_s), ("aligned", 115.0));
        assert_eq!((status.heading_sd, status.rotor), (Some(0.468), Some(34.49)));
        // What is old is not shown, but for the status with its time.
        assert_eq!(monitor.heading(3.1), (None, 'V'));
        assert_eq!((monitor.level(3.1), monitor.turn(3.1)), (None, None));
        assert!(monitor.status().is_some() && monitor.silent_s(3.1) > 1.0);
    }

    #[test]
    fn places_are_those_of_the_unit() {
        let mut monitor = Monitor::default();
        let [latitude, longitude] = [-33.5_f32, 151.2].map(f32::to_radians);
        let sentences = [
            nmea::gll(Talker::He, None, latitude, longitude).unwrap(),
            nmea::vtg(Talker::In, -3.0, 4.0).unwrap(),
        ];
        for sentence in &sentences {
            heard(&mut monitor, sentence.as_bytes(), 0.0);
        }
        let (place, speed) = monitor.track(0.5).unwrap();
        assert!((place.latitude + 33.5).abs() < 1e-5 && (place.longitude - 151.2).abs() < 1e-5);
        assert!((speed - 5.0).abs() < 0.01);
    }

    #[test]
    fn answers_and_faults() {
        let mut monitor = Monitor::default();
        let ok = nmea::answer(true, "set - save it then restart");
        let no = nmea::answer(false, "only once aligned");
        let all = heard(&mut monitor, &[ok.as_bytes(), no.as_bytes()].concat(), 0.0);
        assert_eq!(
            all,
            [
                LineEvent::Answer {
                    ok: true,
                    text: "set - save it then restart".to_owned()
                },
                LineEvent::Answer {
                    ok: false,
                    text: "only once aligned".to_owned()
                },
            ]
        );
        // What the unit says by itself is no answer.
        let told = heard(&mut monitor, b"$HCTXT,01,01,02,gyros calibrated - or so*0E\r\n", 0.0);
        assert_eq!(told, [LineEvent::Text("gyros calibrated - or so".to_owned())]);
        heard(&mut monitor, b"$PRNST,9.00,fault,3,,,driver,R,*49\r\n", 0.0);
        let found = monitor.counts();
        assert_eq!((found.sentences, found.checksum), (4, 0), "{found:?}");
        assert_eq!(monitor.status().unwrap().fault, Some(("driver".to_owned(), false)));
    }

    #[test]
    fn what_is_wrong_is_counted_and_costs_itself_only() {
        let mut monitor = Monitor::default();
        for (bytes, checksum, broken, sentences) in [
            (&b"$HETHS,339.03,A*16\r\n"[..], 1, 0, 0),
            (b"$HETHS,339\r\n", 1, 1, 0),
            (b"$HETHS,33$HETHS,,V*14\r\n", 1, 2, 1),
            (b"$HETHS,\x80,V*14\r\n", 1, 3, 1),
            (b"$HETHS,,V*1\r\n", 1, 4, 1),
            (b"noise\r\n\r\n$HETHS,,V*14\r\n", 1, 4, 2),
            (&[&b"$"[..], &[b'x'; 100], b"\r\n$HETHS,,V*14\r\n"].concat(), 1, 5, 3),
        ] {
            heard(&mut monitor, bytes, 0.0);
            let counts = monitor.counts();
            assert_eq!(
                (counts.checksum, counts.broken, counts.sentences),
                (checksum, broken, sentences),
                "{}",
                bytes.escape_ascii()
            );
        }
    }

    #[test]
    fn a_recording_between_the_sentences_is_no_error() {
        let mut monitor = Monitor::default();
        let body: Vec<u8> = (0..40).map(|k| b"$*\n\xFA"[k % 4]).collect();
        let mut bytes = Vec::new();
        for _ in 0..5 {
            bytes.extend(frame(&body));
            bytes.extend_from_slice(CYCLE);
        }
        heard(&mut monitor, &bytes, 0.0);
        let counts = monitor.counts();
        assert_eq!((counts.frames, counts.sentences), (5, 25), "{counts:?}");
        assert_eq!(
            (counts.broken, counts.damaged, counts.checksum),
            (0, 0, 0),
            "{counts:?}"
        );
        // A damaged one hides nothing that comes after it.
        let mut damaged = frame(&[7; 30]);
        damaged[9] ^= 1;
        heard(&mut monitor, &[&damaged, CYCLE].concat(), 0.0);
        let counts = monitor.counts();
        assert_eq!((counts.damaged, counts.sentences), (1, 30), "{counts:?}");
    }

    proptest! {
        #[test]
        fn no_bytes_do_harm_and_how_they_are_cut_does_not_matter(
            bytes in proptest::collection::vec(
                prop_oneof![any::<u8>(), Just(b'$'), Just(record::SYNC), Just(b'\n'), Just(b',')], 0..600),
            cut in 1..50_usize,
        ) {
            let (mut whole, mut parts) = (Monitor::default(), Monitor::default());
            let bytes = [&bytes[..], CYCLE].concat();
            let at_once = heard(&mut whole, &bytes, 0.0);
            let in_parts: Vec<LineEvent> = bytes.chunks(cut).flat_map(|part| heard(&mut parts, part, 0.0)).collect();
            prop_assert_eq!(at_once, in_parts);
            prop_assert_eq!(whole.counts(), parts.counts());
        }
    }
}
