//! What comes over the serial line: sentences of NMEA 0183, cut from the bytes and checked.

use app::nmea::LONGEST;
use app::record;
use hal_sim::align::Angles;
use serde::Serialize;

/// A pause that ends a burst, ns: ten characters at 115200 baud.
const PAUSE_NS: u64 = 870_000;

/// A sentence whose check sum is right.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Sentence {
    /// When the burst that it came with began, ns.
    pub burst_ns: u64,
    /// When it had come in full, ns.
    pub t_ns: u64,
    /// Its text, without CR LF.
    pub text: String,
}

/// A line.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum LineEvent {
    /// A sentence.
    Sentence(Sentence),
    /// Anything else, without CR LF.
    Other(String),
}

/// What came over the line.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize)]
pub struct Received {
    /// Bytes.
    pub bytes: u64,
    /// Sentences whose check sum is right.
    pub sentences: u64,
    /// Frames of the record.
    pub frames: u64,
    /// Lines that are no such sentence.
    pub others: u64,
}

/// Cuts bytes into sentences.
#[derive(Debug, Default)]
pub struct Splitter {
    line: Vec<u8>,
    last_ns: Option<u64>,
    burst_ns: u64,
    received: Received,
}

impl Splitter {
    /// Takes a byte that came at `t_ns`; gives the line that ends with it.
    pub fn push(&mut self, t_ns: u64, byte: u8) -> Option<LineEvent> {
        if self.last_ns.is_none_or(|last| t_ns > last + PAUSE_NS) {
            self.burst_ns = t_ns;
        }
        self.last_ns = Some(t_ns);
        self.received.bytes += 1;
        if let [record::SYNC, rest @ ..] = &self.line[..] {
            let whole = rest.first().map(|body| record::LEAD + usize::from(*body) + record::CRC);
            if whole.is_some_and(|whole| self.line.len() + 1 == whole) {
                self.line.clear();
                self.received.frames += 1;
            } else {
                self.line.push(byte);
            }
            return None;
        }
        if byte != b'\n' {
            self.line.push(byte);
            return None;
        }
        let line = core::mem::take(&mut self.line);
        if line == b"\r" || line.is_empty() {
            return None;
        }
        let Some(text) = checked(&line) else {
            self.received.others += 1;
            let text = String::from_utf8_lossy(&line);
            return Some(LineEvent::Other(text.trim_end_matches('\r').to_owned()));
        };
        self.received.sentences += 1;
        Some(LineEvent::Sentence(Sentence {
            burst_ns: self.burst_ns,
            t_ns,
            text,
        }))
    }

    /// Totals so far.
    pub fn received(&self) -> Received {
        self.received
    }
}

/// The text of a line that is a sentence, its CR included.
fn checked(line: &[u8]) -> Option<String> {
    let text = core::str::from_utf8(line).ok()?.strip_suffix('\r')?;
    (hal_sim::nmea::body(text).is_ok() && line.len() < LONGEST).then(|| text.to_owned())
}

/// Whether a sentence is the answer to a command.
pub fn is_answer(sentence: &str) -> bool {
    sentence.starts_with("$PRNSA,")
}

/// Attitude and its 1σ of a `$PASHR` that has them.
pub fn pashr(sentence: &str) -> Option<(Angles, Angles)> {
    let fields: Vec<&str> = sentence.split(['*', ',']).collect();
    if fields.first() != Some(&"$PASHR") {
        return None;
    }
    let number = |k: usize| fields.get(k)?.parse::<f64>().ok();
    let angles = |heading, pitch, roll| {
        Some(Angles {
            heading_deg: number(heading)?,
            pitch_deg: number(pitch)?,
            roll_deg: number(roll)?,
        })
    };
    Some((angles(2, 5, 4)?, angles(9, 8, 7)?))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn push(splitter: &mut Splitter, from_ns: u64, text: &str) -> Vec<Sentence> {
        let times = (0..).map(|k| from_ns + k * 87_000);
        times
            .zip(text.bytes())
            .filter_map(|(t, byte)| splitter.push(t, byte))
            .filter_map(|heard| match heard {
                LineEvent::Sentence(sentence) => Some(sentence),
                LineEvent::Other(text) => {
                    assert!(!text.contains(['\r', '\n']), "{text:?}");
                    None
                }
            })
            .collect()
    }

    #[test]
    fn sentences_are_cut_and_checked() {
        let mut splitter = Splitter::default();
        let found = push(
            &mut splitter,
            1_000_000_000,
            "noise\r\n$HEHDT,274.07,T*19\r\n$HEHDT,274.08,T*19\r\n",
        );
        assert_eq!(found.len(), 1);
        assert_eq!(
            (found[0].text.as_str(), found[0].burst_ns),
            ("$HEHDT,274.07,T*19", 1_000_000_000)
        );
        let found = push(&mut splitter, 2_000_000_000, "\r\n$HETHS,,V*14\r\n");
        assert_eq!(found[0].burst_ns, 2_000_000_000);
        let received = splitter.received();
        assert_eq!((received.sentences, received.others), (2, 2));
    }

    #[test]
    fn an_attitude_is_read() {
        let text = "$PASHR,,305.30,T,+0.05,-0.13,,0.002,0.001,0.350,0,1*10";
        let angles = |heading_deg, pitch_deg, roll_deg| Angles {
            heading_deg,
            pitch_deg,
            roll_deg,
        };
        assert_eq!(
            pashr(text),
            Some((angles(305.3, -0.13, 0.05), angles(0.35, 0.001, 0.002)))
        );
        assert_eq!(pashr("$PASHR,,,,,,,,,,,0,0*74"), None);
        assert_eq!(pashr("$HETHS,77.52,E*2E"), None);
    }
}
