//! What may be typed, and what it asks for: pure.
//!
//! Upper and lower case are the same, blanks more or less as well; an empty line, or one that begins with `#`, is
//! nothing. A line that begins with `$` is a sentence of a receiver, see [`nmea_in`](crate::nmea_in): none is answered, and what is of no
//! use is left. [`LineBuffer`] makes lines of bytes: they end with CR or LF, backspace takes one back, and a line longer
//! than [`LONGEST`] or with a byte that is no text is refused as a whole, up to its end, so that no part of it is
//! taken for a command.

use core::fmt;

use frames::units::{
    ARC_MIN, DEG, DEG_PER_HOUR, DEG_PER_SQRT_HOUR, MICRO_G, MICRO_G_PER_SQRT_HZ, PPM, STANDARD_GRAVITY,
};
use heapless::Vec;

use crate::command::Command;
use crate::log::Level;
use crate::nmea::{Sentence, SentenceBuilder, Talker};
use crate::nmea_in::{self, Fix};
use crate::settings::{Group, Invalid, Position, Settings, Source};

/// 1 °/h/g in rad/s per m/s².
const PER_G: f64 = DEG_PER_HOUR / STANDARD_GRAVITY;
/// Longest command without its end, bytes.
pub const LONGEST: usize = 64;
/// What a line asks for.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Request {
    /// What there is.
    Help,
    /// The status sentence.
    Status,
    /// The program's version.
    Version,
    /// What was found of the hardware, and what was expected.
    Hardware,
    /// The settings.
    Show,
    /// A setting, from now on: a number, or the place of a word among those it may be.
    Set(&'static Setting, f32),
    /// To keep the settings.
    Save,
    /// The records of faults.
    Faults,
    /// To forget them.
    ClearFaults,
    /// To keep what the alignment has found of the housing's gyro error.
    Deviation,
    /// To forget it.
    ClearDeviation,
    /// What the log is to tell.
    Log(Level),
    /// Whether every sample is to go out.
    Record(bool),
    /// Nothing: a receiver says where it is.
    Fix(Fix),
    /// Something for the modes.
    Unit(Command),
}

/// A setting that a command changes, by its place in [`Setting::ALL`].
#[derive(Debug, Clone, Copy)]
pub struct Setting {
    /// As it is typed.
    pub name: &'static str,
    /// As it is typed, after the value.
    pub unit: &'static str,
    /// With what it is saved, and checked.
    pub group: Group,
    /// Digits behind the point.
    decimals: usize,
    field: Field,
}

/// What a value is, and where it is kept.
#[derive(Debug, Clone, Copy)]
enum Field {
    /// A number in SI units, typed in another one that is so many of them.
    Scaled(f32, for<'a> fn(&'a mut Settings) -> &'a mut f32),
    Count(for<'a> fn(&'a mut Settings) -> &'a mut u32),
    /// A word, by its place in [`Talker::ALL`].
    Talker,
}

const fn number(
    name: &'static str,
    unit: &'static str,
    group: Group,
    decimals: usize,
    scale: f64,
    at: for<'a> fn(&'a mut Settings) -> &'a mut f32,
) -> Setting {
    Setting {
        name,
        unit,
        group,
        decimals,
        field: Field::Scaled(scale as f32, at),
    }
}

const fn count(
    name: &'static str,
    unit: &'static str,
    group: Group,
    at: for<'a> fn(&'a mut Settings) -> &'a mut u32,
) -> Setting {
    Setting {
        name,
        unit,
        group,
        decimals: 0,
        field: Field::Count(at),
    }
}

/// The place as somebody enters it, one figure after the other: what nobody has entered is the one in force, and with the
/// first figure no receiver's any more.
fn by_hand(settings: &mut Settings) -> &mut Position {
    settings.installation.position = Position {
        source: Source::Operator,
        ..settings.position()
    };
    &mut settings.installation.position
}

impl PartialEq for Setting {
    fn eq(&self, other: &Self) -> bool {
        self.name == other.name
    }
}

impl Setting {
    /// All that can be set here. The place is taken up by `align`, the others by `restart`, once saved.
    pub const ALL: [Self; 21] = [
        number("latitude", "deg", Group::Installation, 5, DEG, |s| {
            &mut by_hand(s).latitude
        }),
        number("longitude", "deg", Group::Installation, 5, DEG, |s| {
            &mut by_hand(s).longitude
        }),
        number("height", "m", Group::Installation, 1, 1.0, |s| &mut by_hand(s).height),
        number("mount-heading", "deg", Group::Installation, 3, DEG, |s| {
            &mut s.installation.mounting.heading
        }),
        number("mount-pitch", "deg", Group::Installation, 3, DEG, |s| {
            &mut s.installation.mounting.pitch
        }),
        number("mount-roll", "deg", Group::Installation, 3, DEG, |s| {
            &mut s.installation.mounting.roll
        }),
        number("rotor-rate", "deg/s", Group::Motion, 2, DEG, |s| &mut s.motion.rate),
        number("rotor-travel", "deg", Group::Motion, 1, DEG, |s| &mut s.motion.travel),
        number("encoder-zero", "deg", Group::Encoder, 3, DEG, |s| &mut s.encoder.zero),
        number("gyro-arw", "deg/sqrt(h)", Group::Noise, 3, DEG_PER_SQRT_HOUR, |s| {
            &mut s.noise.angle_random_walk
        }),
        number("gyro-instability", "deg/h", Group::Noise, 2, DEG_PER_HOUR, |s| {
            &mut s.noise.gyro_instability_sd
        }),
        number("gyro-bias", "deg/h", Group::Noise, 1, DEG_PER_HOUR, |s| {
            &mut s.noise.gyro_bias_sd
        }),
        number("gyro-scale", "ppm", Group::Noise, 0, PPM, |s| {
            &mut s.noise.gyro_scale_factor_sd
        }),
        number("gyro-misalignment", "arcmin", Group::Noise, 2, ARC_MIN, |s| {
            &mut s.noise.gyro_misalignment_sd
        }),
        number("gyro-g-sensitivity", "deg/h/g", Group::Noise, 1, PER_G, |s| {
            &mut s.noise.gyro_g_sensitivity_sd
        }),
        number("gyro-housing", "deg/h", Group::Noise, 2, DEG_PER_HOUR, |s| {
            &mut s.noise.gyro_housing_sd
        }),
        number("accel-vrw", "ug/sqrt(Hz)", Group::Noise, 1, MICRO_G_PER_SQRT_HZ, |s| {
            &mut s.noise.velocity_random_walk
        }),
        number("accel-bias", "ug", Group::Noise, 1, MICRO_G, |s| {
            &mut s.noise.accel_bias_sd
        }),
        count("period", "ms", Group::Output, |s| &mut s.output.period_ms),
        Self {
            name: "talker",
            unit: "",
            group: Group::Output,
            decimals: 0,
            field: Field::Talker,
        },
        count("serial", "", Group::Identity, |s| &mut s.identity.serial),
    ];

    /// Its value, in the unit in which it is typed, or its word's place; of the position, the one to align with.
    pub fn get(&self, settings: &Settings) -> f32 {
        let mut copy = *settings;
        match self.field {
            Field::Scaled(unit, at) => *at(&mut copy) / unit,
            // Below 2²⁴, see its range.
            Field::Count(at) => *at(&mut copy) as f32,
            Field::Talker => f32::from(settings.output.talker as u8),
        }
    }

    /// The settings with another value.
    ///
    /// # Errors
    /// [`Invalid`], where it is out of range.
    pub fn put(&self, mut settings: Settings, value: f32) -> Result<Settings, Invalid> {
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "saturates, out of its range"
        )]
        let count = if value < 0.0 { u32::MAX } else { value as u32 };
        match self.field {
            Field::Scaled(unit, at) => *at(&mut settings) = value * unit,
            Field::Count(at) => *at(&mut settings) = count,
            Field::Talker => {
                let talker = Talker::ALL.get(count as usize);
                settings.output.talker = *talker.ok_or(Invalid::OutOfRange {
                    name: self.name,
                    low: 0.0,
                    high: (Talker::ALL.len() - 1) as f32,
                })?;
            }
        }
        settings.validate(self.group)?;
        Ok(settings)
    }

    /// Its name, value and unit.
    pub(super) fn tell(&self, settings: &Settings) -> Sentence {
        let mut line = SentenceBuilder::answer(true);
        line.words(self.name);
        line.words(" ");
        match self.field {
            Field::Talker => line.words(settings.output.talker.as_str()),
            _ => line.decimal(self.get(settings), self.decimals),
        }
        line.words(" ");
        line.words(self.unit);
        line.end()
    }

    /// What is typed for it, as a value.
    fn read(&self, typed: &[u8]) -> Result<f32, LineError> {
        match self.field {
            Field::Talker => {
                let place = Talker::ALL.iter().position(|talker| is(talker.as_str(), typed));
                place.map(|place| place as f32).ok_or(LineError::Talker)
            }
            _ => decimal(typed).ok_or(LineError::Number),
        }
    }

    /// What `invalid` would have taken, in the unit in which it is typed.
    pub(super) fn expected(&self, invalid: Invalid) -> Sentence {
        let mut line = SentenceBuilder::answer(false);
        line.words("expected ");
        line.words(self.name);
        if let Invalid::OutOfRange { low, high, .. } = invalid {
            let unit = match self.field {
                Field::Scaled(unit, _) => unit,
                _ => 1.0,
            };
            for (word, limit) in [(" from ", low / unit), (" to ", high / unit)] {
                line.words(word);
                line.decimal(limit, if limit.abs() < 0.1 { self.decimals } else { 1 });
            }
        }
        line.words(" ");
        line.words(self.unit);
        line.end()
    }
}

/// What follows a word.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Rest {
    /// Nothing.
    Nothing(Request),
    /// A setting and its value.
    Setting,
    /// A level.
    Level,
    /// Nothing, or `clear`, and what each asks for.
    Clear(Request, Request),
    /// `on` or `off`.
    Switch,
}

/// A word of the console.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Word {
    /// As it is typed, in lower case.
    pub name: &'static str,
    rest: Rest,
    /// What it does, for `help`.
    pub help: &'static str,
}

const fn word(name: &'static str, request: Request, help: &'static str) -> Word {
    Word {
        name,
        rest: Rest::Nothing(request),
        help,
    }
}

/// All words there are.
pub const WORDS: [Word; 18] = [
    word("help", Request::Help, "this list"),
    word("status", Request::Status, "the status sentence now"),
    word("version", Request::Version, "of the program"),
    word("hardware", Request::Hardware, "what was found, and what was expected"),
    word("align", Request::Unit(Command::Align), "align from the beginning"),
    word(
        "calibrate",
        Request::Unit(Command::Calibrate),
        "the gyros - from rest, better once aligned",
    ),
    Word {
        name: "deviation",
        rest: Rest::Clear(Request::Deviation, Request::ClearDeviation),
        help: "keep the housing's gyro error as found, or clear",
    },
    word(
        "navigate",
        Request::Unit(Command::Navigate),
        "dead reckoning from here - once aligned",
    ),
    word("stop", Request::Unit(Command::Stop), "stop the rotor and rest"),
    word(
        "selftest",
        Request::Unit(Command::SelfTest),
        "test, then rest - from rest only",
    ),
    word(
        "reset",
        Request::Unit(Command::ResetFault),
        "forget the fault and start again",
    ),
    word("restart", Request::Unit(Command::Restart), "start the program anew"),
    word("show", Request::Show, "the settings"),
    Word {
        name: "set",
        rest: Rest::Setting,
        help: "a setting and its value, as show lists them",
    },
    word("save", Request::Save, "keep settings and calibration"),
    Word {
        name: "faults",
        rest: Rest::Clear(Request::Faults, Request::ClearFaults),
        help: "the last faults and crashes, or clear",
    },
    Word {
        name: "log",
        rest: Rest::Level,
        help: "error, warn, info or debug",
    },
    Word {
        name: "record",
        rest: Rest::Switch,
        help: "on or off - every sample between the sentences",
    },
];

/// Why a line is no request. Its text says what was expected.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum LineError {
    /// The first word is none of [`WORDS`].
    Unknown,
    /// There is more on the line than belongs there.
    Excess,
    /// No setting by that name, or none at all.
    Setting,
    /// The value is no number.
    Number,
    /// The value is no [`Talker`].
    Talker,
    /// No such level.
    Level,
    /// Something else than `clear`.
    Clear,
    /// Neither `on` nor `off`.
    Switch,
    /// Longer than [`LONGEST`].
    Long,
    /// With a byte that is no printable ASCII: noise, or another baud rate.
    Garbled,
}

impl LineError {
    /// What was expected, in words that fit an answer.
    pub const fn expected(self) -> &'static str {
        match self {
            Self::Unknown => "expected a command: help lists them",
            Self::Excess => "expected nothing more on the line",
            Self::Setting => "expected the name of a setting and its value: show lists them",
            Self::Number => "expected a number as -12.345",
            Self::Talker => "expected talker HE, HC, IN or GP",
            Self::Level => "expected log error, warn, info or debug",
            Self::Clear => "expected nothing more but clear",
            Self::Switch => "expected record on or record off",
            Self::Long => "expected at most 64 characters on a line",
            Self::Garbled => "expected ASCII at 115200 baud 8N1",
        }
    }
}

impl fmt::Display for LineError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.expected())
    }
}

impl core::error::Error for LineError {}

/// One copy of them: a constant would be one wherever it is used.
pub(super) static SETTINGS: [Setting; 21] = Setting::ALL;

/// What a line without its end asks for; `None` where it is empty or a remark.
///
/// # Errors
/// [`LineError`] says what was expected.
pub fn parse(line: &[u8]) -> Result<Option<Request>, LineError> {
    if is_sentence(line) {
        return Ok(nmea_in::parse(line).ok().map(Request::Fix));
    }
    if line.len() > LONGEST {
        return Err(LineError::Long);
    }
    if !line.iter().all(|byte| is_text(*byte)) {
        return Err(LineError::Garbled);
    }
    let mut words = line.split(|byte| is_blank(*byte)).filter(|word| !word.is_empty());
    let Some(first) = words.next().filter(|word| !word.starts_with(b"#")) else {
        return Ok(None);
    };
    let Some(word) = WORDS.iter().find(|word| is(word.name, first)) else {
        return Err(LineError::Unknown);
    };
    let mut next = || words.next().unwrap_or_default();
    let request = match word.rest {
        Rest::Nothing(request) => request,
        Rest::Setting => {
            let name = next();
            let setting = SETTINGS.iter().find(|setting| is(setting.name, name));
            let setting = setting.ok_or(LineError::Setting)?;
            Request::Set(setting, setting.read(next())?)
        }
        Rest::Level => {
            let name = next();
            let level = Level::ALL.into_iter().find(|level| is(level.name(), name));
            Request::Log(level.ok_or(LineError::Level)?)
        }
        Rest::Clear(plain, cleared) => match next() {
            [] => plain,
            clear if is("clear", clear) => cleared,
            _ => return Err(LineError::Clear),
        },
        Rest::Switch => match next() {
            on if is("on", on) => Request::Record(true),
            off if is("off", off) => Request::Record(false),
            _ => return Err(LineError::Switch),
        },
    };
    if next().is_empty() {
        Ok(Some(request))
    } else {
        Err(LineError::Excess)
    }
}

/// Not from a hand: a sentence, one of AIS, or a TAG block with nothing behind it.
fn is_sentence(line: &[u8]) -> bool {
    matches!(line.first(), Some(b'$' | b'!' | b'\\'))
}

fn is(name: &str, typed: &[u8]) -> bool {
    name.as_bytes().eq_ignore_ascii_case(typed)
}

/// A decimal number of up to nine digits, without an exponent. Not `str::parse`: that is 8 kB of code.
fn decimal(text: &[u8]) -> Option<f32> {
    let (negative, digits) = match text {
        [b'-', rest @ ..] => (true, rest),
        [b'+', rest @ ..] | rest => (false, rest),
    };
    let (mut value, mut scale, mut count, mut point) = (0_u32, 1_u32, 0, false);
    for byte in digits {
        match byte {
            b'0'..=b'9' if count < 9 => {
                value = value * 10 + u32::from(byte - b'0');
                scale *= if point { 10 } else { 1 };
                count += 1;
            }
            b'.' if !point => point = true,
            _ => return None,
        }
    }
    let size = value as f32 / scale as f32;
    (count > 0).then_some(if negative { -size } else { size })
}

const fn is_blank(byte: u8) -> bool {
    matches!(byte, b' ' | b'\t')
}

const fn is_text(byte: u8) -> bool {
    is_blank(byte) || byte.is_ascii_graphic()
}

/// Makes lines of bytes.
#[derive(Debug, Clone, Default)]
pub struct LineBuffer {
    bytes: Vec<u8, { nmea_in::LONGEST }>,
    /// What is wrong with the line so far.
    refused: Option<LineError>,
    /// The byte before: two make the head of a u-blox frame.
    last: u8,
    /// Binary frames of a receiver are under way, whose line ends do not count: no error is answered before the next sentence.
    binary: bool,
}

/// First bytes of a frame in UBX, which receivers mix with sentences.
const UBX: [u8; 2] = [0xB5, 0x62];

impl LineBuffer {
    /// Nothing yet.
    pub const fn new() -> Self {
        Self {
            bytes: Vec::new(),
            refused: None,
            last: 0,
            binary: false,
        }
    }

    /// Takes a byte; at the end of a line what it asks for. The end of an empty line is nothing, so that CR LF
    /// is one end.
    ///
    /// `$` and `!` begin anew wherever they stand, as IEC 61162-1 reserves them for the start of a sentence: before it may be a TAG
    /// block, a binary frame, or the rest of a sentence that was cut off.
    pub fn push(&mut self, byte: u8) -> Option<Result<Request, LineError>> {
        if [self.last, byte] == UBX {
            self.binary = true;
        }
        self.last = byte;
        match byte {
            b'\r' | b'\n' => {
                let found = match self.refused.take() {
                    Some(_) if is_sentence(&self.bytes) => Ok(None),
                    Some(error) => Err(error),
                    None => parse(&self.bytes),
                };
                self.bytes.clear();
                if self.binary && found.is_err() {
                    return None;
                }
                self.binary = false;
                return found.transpose();
            }
            b'$' | b'!' => {
                self.bytes.clear();
                self.refused = None;
                self.binary = false;
                // The buffer is empty: it has room.
                let _ = self.bytes.push(byte);
            }
            // Backspace and delete, of a terminal.
            0x08 | 0x7F => {
                self.bytes.pop();
            }
            _ if !is_text(byte) => self.refuse(LineError::Garbled),
            _ => {
                if self.bytes.push(byte).is_err() {
                    self.refuse(LineError::Long);
                }
            }
        }
        None
    }

    /// Bytes of the line were lost or came wrong: it is refused at its end.
    pub fn garble(&mut self) {
        self.refuse(LineError::Garbled);
    }

    /// The first reason stays.
    fn refuse(&mut self, error: LineError) {
        self.refused.get_or_insert(error);
    }
}

#[cfg(test)]
mod tests {
    use std::borrow::ToOwned;
    use std::format;
    use std::vec::Vec;

    use proptest::prelude::*;

    use super::*;
    use crate::nmea;

    fn by_name(name: &str) -> &'static Setting {
        SETTINGS.iter().find(|setting| setting.name == name).unwrap()
    }

    /// All that comes out of a row of bytes.
    fn feed(bytes: &[u8]) -> Vec<Result<Request, LineError>> {
        let mut buffer = LineBuffer::new();
        bytes.iter().filter_map(|byte| buffer.push(*byte)).collect()
    }

    #[test]
    fn every_word_is_understood_and_none_twice() {
        for word in WORDS {
            match word.rest {
                Rest::Nothing(request) => assert_eq!(parse(word.name.as_bytes()), Ok(Some(request))),
                Rest::Setting => assert_eq!(parse(word.name.as_bytes()), Err(LineError::Setting)),
                Rest::Level => assert_eq!(parse(word.name.as_bytes()), Err(LineError::Level)),
                Rest::Clear(plain, clear) => {
                    assert_eq!(parse(word.name.as_bytes()), Ok(Some(plain)));
                    assert_eq!(parse(format!("{} clear", word.name).as_bytes()), Ok(Some(clear)));
                    assert_eq!(parse(format!("{} clean", word.name).as_bytes()), Err(LineError::Clear));
                }
                Rest::Switch => assert_eq!(parse(word.name.as_bytes()), Err(LineError::Switch)),
            }
            assert_eq!(WORDS.iter().filter(|other| other.name == word.name).count(), 1);
            // With name and hyphen it goes into one answer.
            assert!(word.name.len() + 3 + word.help.len() <= nmea::ANSWER);
        }
        for command in Command::ALL {
            let asks = |word: &Word| word.rest == Rest::Nothing(Request::Unit(command));
            assert!(WORDS.iter().any(asks), "{command:?}");
        }
    }

    #[test]
    fn a_wrong_setting_is_told_its_range() {
        let told = |name, value| {
            let setting = by_name(name);
            let refused = setting.put(Settings::default(), value).unwrap_err();
            setting.expected(refused).as_str().split('*').next().unwrap().to_owned()
        };
        assert_eq!(
            told("latitude", 86.0),
            "$PRNSA,error,expected latitude from -85.0 to 85.0 deg"
        );
        assert_eq!(
            told("height", 1e9),
            "$PRNSA,error,expected height from -12000.0 to 30000.0 m"
        );
        assert_eq!(
            told("period", -1.0),
            "$PRNSA,error,expected period from 50.0 to 10000.0 ms"
        );
        let set = by_name("longitude").put(Settings::default(), -8.5).unwrap();
        assert_eq!(set.position().source, Source::Operator);
        assert!((by_name("longitude").get(&set) + 8.5).abs() < 1e-5);
    }

    #[test]
    fn a_talker_is_a_word() {
        for talker in Talker::ALL {
            let typed = std::format!("set talker {}", talker.as_str());
            let Ok(Some(Request::Set(setting, value))) = parse(typed.as_bytes()) else {
                panic!("{typed}");
            };
            let set = setting.put(Settings::default(), value).unwrap();
            assert_eq!(set.output.talker, talker);
            let told = setting.tell(&set);
            assert!(
                told.as_str()
                    .starts_with(&std::format!("$PRNSA,ok,talker {} *", talker.as_str()))
            );
            assert!(LineError::Talker.expected().contains(talker.as_str()));
        }
    }

    /// A unit that knows its place from a receiver keeps it: whatever is entered, the rest of the place is the receiver's.
    #[test]
    fn what_is_not_entered_stays_as_it_was() {
        let received = Settings {
            last_position: Position {
                latitude: 1.05,
                longitude: 0.2,
                height: 30.0,
                source: Source::Gnss,
            },
            ..Settings::default()
        };
        assert!((by_name("latitude").get(&received) - 1.05 / DEG as f32).abs() < 1e-4);
        let mounted = by_name("mount-heading").put(received, 90.0).unwrap();
        assert_eq!(mounted.position(), received.last_position);
        let higher = by_name("height").put(received, 100.0).unwrap();
        let expected = Position {
            height: 100.0,
            source: Source::Operator,
            ..received.last_position
        };
        assert_eq!(higher.position(), expected);
    }

    #[test]
    fn lines_and_what_they_ask_for() {
        use LineError as E;
        let set = |name, value| Ok(Request::Set(by_name(name), value));
        let (align, stop) = (Ok(Request::Unit(Command::Align)), Ok(Request::Unit(Command::Stop)));
        let long = [&[b'x'; LONGEST + 1][..], b" stop\nalign\n"].concat();
        let full = [&[b' '; LONGEST - 4][..], b"stop\n"].concat();
        let after_long = [
            &[b'x'; nmea_in::LONGEST + 9][..],
            b"$GPVTG,90.0,T,,M,10.0,N,18.5,K,A*39\n",
        ]
        .concat();
        let east = Ok(Request::Fix(Fix {
            time: None,
            place: None,
            motion: Some(nmea_in::Motion {
                speed: 10.0 * (1852.0 / 3600.0),
                course: Some(90.0 * DEG as f32),
            }),
        }));
        for (bytes, expected) in [
            (&b"align\r\n"[..], &[align][..]),
            (b"\r\n\n  \t \n# stop\n#stop\n", &[]),
            (b"  ALIGN \t\rstop\n", &[align, stop]),
            (b"align", &[]),
            (b"alig\nn\n", &[Err(E::Unknown), Err(E::Unknown)]),
            (b"stop now\n", &[Err(E::Excess)]),
            (b"stop # now\n", &[Err(E::Excess)]),
            (b"stopp\nsto\n", &[Err(E::Unknown), Err(E::Unknown)]),
            (b"stpo\x08\x08op\nx\x7f\x7fstop\n", &[stop, stop]),
            (b"st\xFFop\nstop\n", &[Err(E::Garbled), stop]),
            (b"\0stop\nstop\n", &[Err(E::Garbled), stop]),
            (&long, &[Err(E::Long), align]),
            (&full, &[stop]),
            (
                b"set latitude 40.1\nSET Longitude -8.5\nset height +12\n",
                &[set("latitude", 40.1), set("longitude", -8.5), set("height", 12.0)],
            ),
            (
                b"set latitude .5\nset latitude 5.\n",
                &[set("latitude", 0.5), set("latitude", 5.0)],
            ),
            (b"set\nset speed 3\n", &[Err(E::Setting), Err(E::Setting)]),
            (
                b"set height\nset height .\nset height 1.2.3\nset height 1e3\nset height 1234567890\nset height --1\n",
                &[Err(E::Number); 6],
            ),
            (b"set height 1 m\n", &[Err(E::Excess)]),
            (
                b"set talker HC\nSet Talker gp\nset talker he\n",
                &[set("talker", 1.0), set("talker", 3.0), set("talker", 0.0)],
            ),
            (
                b"set talker\nset talker 1\nset talker H\nset talker HCX\nset period HC\nset talker IN HC\n",
                &[
                    Err(E::Talker),
                    Err(E::Talker),
                    Err(E::Talker),
                    Err(E::Talker),
                    Err(E::Number),
                    Err(E::Excess),
                ],
            ),
            (
                b"log warn\nlog\nlog all\n",
                &[Ok(Request::Log(Level::Warn)), Err(E::Level), Err(E::Level)],
            ),
            (
                b"FAULTS clear\nfaults all\nfaults clear now\n",
                &[Ok(Request::ClearFaults), Err(E::Clear), Err(E::Excess)],
            ),
            (
                b"record on\nRecord OFF\nrecord\nrecord on off\n",
                &[
                    Ok(Request::Record(true)),
                    Ok(Request::Record(false)),
                    Err(E::Switch),
                    Err(E::Excess),
                ],
            ),
            // What the unit itself sends, on a line that echoes.
            (b"$HETHS,,V*14\r\n$PRNSA,ok\xFF,x\r\nstatus\n", &[Ok(Request::Status)]),
            // A receiver's behind bytes of other protocols, and AIS, which is silent.
            (
                b"\xB5\x62\x01\x07\n\x00x\n$GPVTG,90.0,T,,M,10.0,N,18.5,K,A*39\r\nstop\n",
                &[east, stop],
            ),
            (b"$$GPVTG,90.0,T,,M,10.0,N,18.5,K,A*39\r\n", &[east]),
            (b"\0$GPVTG,90.0,T,,M,10.0,N,18.5,K,A*39\r\n", &[east]),
            (b" $GPVTG,90.0,T,,M,10.0,N,18.5,K,A*39\r\n", &[east]),
            (b"$GPRMC,,A,47$GPVTG,90.0,T,,M,10.0,N,18.5,K,A*39\r\n", &[east]),
            (
                b"\\s:GP01,c:1700000001*4F\\$GPVTG,90.0,T,,M,10.0,N,18.5,K,A*39\r\n",
                &[east],
            ),
            (&after_long, &[east]),
            (
                b"!AIVDO,1,1,,,B000*00\r\n\\s:GP01*4F\\!AIVDM,1\r\n\\g:1-2-73*1F\\\r\n\xFF!AIVDM\n",
                &[],
            ),
            // A receiver's, and one that has no fix, is cut off, or too long for anybody.
            (
                b"$GPVTG,90.0,T,,M,10.0,N,18.5,K,A*39\r\n$GPRMC,,V,,,,,,,,,,N*53\r\n$GPVTG,90.0,T,,M\r\n",
                &[east],
            ),
        ] {
            assert_eq!(feed(bytes), expected, "{}", bytes.escape_ascii());
        }
    }

    #[test]
    fn lost_bytes_spoil_their_line_only() {
        let mut buffer = LineBuffer::new();
        assert_eq!(b"sto".iter().find_map(|byte| buffer.push(*byte)), None);
        buffer.garble();
        assert_eq!(
            b"p\n".iter().find_map(|byte| buffer.push(*byte)),
            Some(Err(LineError::Garbled))
        );
        assert_eq!(
            b"stop\n".iter().find_map(|byte| buffer.push(*byte)),
            Some(Ok(Request::Unit(Command::Stop)))
        );
    }

    proptest! {
        /// To the last digit of an f32, and nothing else is a number.
        #[test]
        fn numbers_are_those_of_the_library(text in "[-+]?[0-9]{0,5}[.]?[0-9]{0,4}") {
            let expected = text.parse::<f32>().ok();
            let found = decimal(text.as_bytes());
            prop_assert_eq!(found.is_some(), expected.is_some(), "{}", text);
            if let (Some(found), Some(expected)) = (found, expected) {
                prop_assert!((found - expected).abs() <= 2e-7 * expected.abs(), "{} {}", found, expected);
            }
        }

        /// Whatever is set, all settings stay in their ranges, and what is refused is answered within a line.
        #[test]
        fn no_setting_is_impossible(nth in 0..SETTINGS.len(), value in any::<f32>()) {
            let (setting, before) = (&SETTINGS[nth], Settings::default());
            match setting.put(before, value) {
                Ok(after) => {
                    prop_assert!(Group::ALL.iter().all(|group| after.validate(*group).is_ok()));
                    let found = setting.get(&after);
                    prop_assert!((found - value).abs() <= 1e-6 * value.abs() + 1e-30 || found == value.trunc());
                }
                Err(invalid) => {
                    let sentence = setting.expected(invalid);
                    prop_assert!(sentence.as_str().starts_with("$PRNSA,error,expected "));
                }
            }
        }

        #[test]
        fn no_bytes_do_harm(bytes in proptest::collection::vec(any::<u8>(), 0..300)) {
            let ends = bytes.iter().filter(|byte| matches!(byte, b'\r' | b'\n')).count();
            let found = feed(&bytes);
            prop_assert!(found.len() <= ends);
            let _ = parse(&bytes);
            for error in found.into_iter().filter_map(Result::err) {
                prop_assert!(error.expected().len() <= nmea::ANSWER);
            }
        }

        /// Whatever went before, a line on its own is understood.
        #[test]
        fn the_next_line_is_a_new_one(mut bytes in proptest::collection::vec(any::<u8>(), 0..100), nth in 0..WORDS.len()) {
            bytes.push(b'\n');
            bytes.extend_from_slice(WORDS[nth].name.as_bytes());
            bytes.push(b'\n');
            let alone = parse(WORDS[nth].name.as_bytes()).transpose();
            prop_assert_eq!(feed(&bytes).pop(), alone);
        }
    }
}
