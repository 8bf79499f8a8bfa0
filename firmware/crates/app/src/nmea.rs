//! Sentences of NMEA 0183: headings, rate of turn, attitude, the unit's own status and its answers.
//!
//! | sentence | what | where it is not valid |
//! |---|---|---|
//! | `$--THS` | true heading and its [`HeadingMode`] | heading empty, mode V |
//! | `$--HDT` | true heading | not sent |
//! | `$--ROT` | rate of turn, °/min, to port negative | rate empty, V |
//! | `$PASHR` | heading, roll, pitch, their σ | all empty but the two flags, as in the layout's source |
//! | `$--GLL` | place by dead reckoning | not sent |
//! | `$--VTG` | course and speed by dead reckoning | not sent |
//! | `$--TXT` | how a calibration of the gyros ended | |
//! | `$PRNST` | the unit's own: mode, σ, fault, rotor | fields empty one by one |
//! | `$PRNSA` | the unit's own: answer to a command | |
//!
//! In place of `--` is the [`Talker`]. Fields in full are in `docs/serial.md`.
//!
//! Pure and without `core::fmt`, which costs 14 kB of code for an `f32`: numbers are rounded to integers of the last
//! digit and written by hand. Rounding is what makes 359.996° 0.00 and −0.004° 0.00; a σ is rounded up, so that none
//! reads zero.
//!
//! Sources: IEC 61162-1:2016 for THS, HDT, ROT, check sum and length; NovAtel's OEM7 manual, log PASHR, for that one.

use frames::units::DEG;
use frames::{Attitude, AttitudeSd, math};
use heapless::Vec;

use crate::command::ModeName;
use crate::fixed_decimal::{hex_digit, seconds};
use crate::utc::TimeOfDay;

/// Longest sentence, `$` and CR LF included, bytes.
pub const LONGEST: usize = 82;
/// The same without check sum and CR LF.
const BODY: usize = LONGEST - 5;

/// A whole sentence, CR LF included.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Sentence(Vec<u8, LONGEST>);

impl Sentence {
    /// What goes over the line: ASCII.
    pub fn as_bytes(&self) -> &[u8] {
        &self.0
    }

    /// The same as text.
    pub fn as_str(&self) -> &str {
        core::str::from_utf8(&self.0).unwrap_or_default()
    }
}

/// What the sender of a sentence is. Readers take sentences by it; which is for whom is in `docs/serial.md`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Talker {
    /// A gyro that seeks north.
    #[default]
    He,
    /// A magnetic compass.
    Hc,
    /// Integrated navigation.
    In,
    /// A receiver of GPS.
    Gp,
}

impl Talker {
    /// All there are, by their numbers in flash: a new one goes to the end.
    pub const ALL: [Self; 4] = [Self::He, Self::Hc, Self::In, Self::Gp];

    /// Its two letters.
    pub const fn as_str(self) -> &'static str {
        match self {
            Self::He => "HE",
            Self::Hc => "HC",
            Self::In => "IN",
            Self::Gp => "GP",
        }
    }
}

/// Mode indicator of THS.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum HeadingMode {
    /// A: measured, and as good as the unit promises.
    Autonomous,
    /// E: estimated; known, but not that well.
    Estimated,
    /// M: set by hand.
    Manual,
    /// S: simulated.
    Simulator,
    /// V: not to be used.
    Invalid,
}

impl HeadingMode {
    /// Its letter.
    pub const fn letter(self) -> u8 {
        match self {
            Self::Autonomous => b'A',
            Self::Estimated => b'E',
            Self::Manual => b'M',
            Self::Simulator => b'S',
            Self::Invalid => b'V',
        }
    }
}

/// True heading and how it was come by. `heading` in rad, any turn; without one, or without a finite one, the mode is
/// V, and with V there is none.
pub fn ths(talker: Talker, heading: Option<f32>, mode: HeadingMode) -> Sentence {
    let heading = heading.and_then(hundredths_of_turn);
    let mut line = SentenceBuilder::of(talker, "THS");
    line.comma();
    match heading {
        Some(heading) if mode != HeadingMode::Invalid => {
            line.fixed(heading, 2, false);
            line.letter(mode.letter());
        }
        _ => line.letter(HeadingMode::Invalid.letter()),
    }
    line.end()
}

/// True heading, rad, any turn; no sentence for one that is not finite.
pub fn hdt(talker: Talker, heading: f32) -> Option<Sentence> {
    let heading = hundredths_of_turn(heading)?;
    let mut line = SentenceBuilder::of(talker, "HDT");
    line.comma();
    line.fixed(heading, 2, false);
    line.letter(b'T');
    Some(line.end())
}

/// Rate of turn, rad/s, clockwise positive: the bow to starboard.
pub fn rot(talker: Talker, rate: Option<f32>) -> Sentence {
    let tenths = rate.and_then(|rate| rounded(rate / DEG as f32 * 60.0 * 10.0));
    let tenths = tenths.map(|tenths| tenths.clamp(-999_999, 999_999));
    let mut line = SentenceBuilder::of(talker, "ROT");
    line.comma();
    if let Some(tenths) = tenths {
        line.fixed(tenths, 1, false);
    }
    line.letter(if tenths.is_some() { b'A' } else { b'V' });
    line.end()
}

/// Attitude and its 1σ at `time`; `aligned` is the flag of the INS. Without a receiver's time it stays empty: time since the
/// start would be taken for it. So does heave, which is not measured; the quality of GNSS is 0, there is none.
pub fn pashr(time: Option<TimeOfDay>, attitude: Option<(&Attitude, &AttitudeSd)>, aligned: bool) -> Sentence {
    // One of them not finite is a filter that is not: nothing of it is put out.
    let numbers = attitude.and_then(|(attitude, sd)| {
        Some((
            hundredths_of_turn(attitude.heading)?,
            [half_turn(attitude.roll)?, half_turn(attitude.pitch)?],
            [up(sd.roll)?, up(sd.pitch)?, up(sd.heading)?],
        ))
    });
    let mut line = SentenceBuilder::start("$PASHR");
    line.time(time);
    line.comma();
    if let Some((heading, angles, sds)) = numbers {
        line.fixed(heading, 2, false);
        line.letter(b'T');
        for angle in angles {
            line.comma();
            line.fixed(angle, 2, true);
        }
        line.comma(); // heave
        for sd in sds {
            line.comma();
            line.fixed(sd, 3, false);
        }
    } else {
        // T, roll, pitch, heave and three σ.
        for _ in 0..7 {
            line.comma();
        }
    }
    line.letter(b'0');
    line.letter(if numbers.is_some() && aligned { b'1' } else { b'0' });
    line.end()
}

/// The place, rad, by dead reckoning from where the unit was aligned: mode E, and therefore status V. No sentence for a
/// place that is not finite. `time` is that of the place.
///
/// Ten-thousandths of a minute are 0.2 m; an `f32` of 180° is good to eight of them.
pub fn gll(talker: Talker, time: Option<TimeOfDay>, latitude: f32, longitude: f32) -> Option<Sentence> {
    let mut line = SentenceBuilder::of(talker, "GLL");
    for (angle, most, letters) in [(latitude, 90, b"NS"), (longitude, 180, b"EW")] {
        let scaled = rounded(degrees(angle) * 600_000.0)?;
        let size = scaled.unsigned_abs().min(most * 600_000);
        line.comma();
        let whole = size / 600_000;
        if most > 90 {
            line.push(b'0' + (whole / 100) as u8);
        }
        line.push(b'0' + (whole / 10 % 10) as u8);
        line.push(b'0' + (whole % 10) as u8);
        let minutes = size % 600_000;
        if minutes < 100_000 {
            line.push(b'0');
        }
        line.number(minutes, 4);
        line.letter(letters[usize::from(scaled < 0)]);
    }
    line.time(time);
    line.letter(b'V');
    line.letter(b'E');
    Some(line.end())
}

/// Course and speed over ground by dead reckoning, of a velocity to east and north, m/s; no sentence where it is not
/// finite. Below 0.1 m/s there is no course.
pub fn vtg(talker: Talker, east: f32, north: f32) -> Option<Sentence> {
    let speed = Some(math::hypot(east, north)).filter(|speed| speed.is_finite())?;
    let [knots, km_h] = [3600.0 / 1852.0, 3.6].map(|scale| rounded((speed * scale).min(9999.0) * 100.0));
    let course = hundredths_of_turn(math::atan2(east, north))?;
    let mut line = SentenceBuilder::of(talker, "VTG");
    line.comma();
    if speed >= 0.1 {
        line.fixed(course, 2, false);
    }
    line.letter(b'T');
    line.comma();
    line.letter(b'M');
    for (speed, unit) in [(knots?, b'N'), (km_h?, b'K')] {
        line.comma();
        line.fixed(speed, 2, false);
        line.letter(unit);
    }
    line.letter(b'E');
    Some(line.end())
}

/// What the status sentence tells.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Report {
    /// Time since the start, µs.
    pub up_us: u64,
    /// The unit's mode, and since when, µs of the unit's clock.
    pub mode: Option<(ModeName, u64)>,
    /// 1σ of the heading, rad, where there is one.
    pub heading_sd: Option<f32>,
    /// Why the heading is not what it should be, in a word.
    pub reason: &'static str,
    /// The fault by name, and whether it stays.
    pub fault: Option<(&'static str, bool)>,
    /// The rotor's angle, rad, while the turn is known.
    pub rotor: Option<f32>,
}

/// The unit's status.
pub fn status(report: &Report) -> Sentence {
    let mut line = SentenceBuilder::start("$PRNST");
    line.comma();
    line.number(seconds(report.up_us), 0);
    line.push(b'.');
    let hundredths = (report.up_us % 1_000_000) as u32 / 10_000;
    line.push(b'0' + (hundredths / 10) as u8);
    line.push(b'0' + (hundredths % 10) as u8);
    line.comma();
    if let Some((mode, since_us)) = report.mode {
        line.text(mode.as_str());
        line.comma();
        line.number(seconds(report.up_us.saturating_sub(since_us)), 0);
    } else {
        line.comma();
    }
    line.comma();
    if let Some(sd) = report.heading_sd.and_then(up) {
        line.fixed(sd, 3, false);
    }
    line.comma();
    line.text(report.reason);
    line.comma();
    if let Some((fault, latched)) = report.fault {
        line.text(fault);
        line.letter(if latched { b'L' } else { b'R' });
    } else {
        line.comma();
    }
    line.comma();
    if let Some(angle) = report.rotor.and_then(|angle| rounded(degrees(angle) * 100.0)) {
        line.fixed(angle, 2, false);
    }
    line.end()
}

/// What kind of a text TXT has. The numbers are not the standard's, but common: gpsd's and some receivers'.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum TextKind {
    /// 01: something is not as it should be.
    Warning,
    /// 02: good to know.
    Notice,
}

/// Room for the text of TXT, bytes: as much as the standard allows.
pub const TEXT: usize = BODY - "$--TXT,01,01,01,".len();

/// Room for the text of an answer, bytes.
pub const ANSWER: usize = BODY - "$PRNSA,error,".len();

/// An answer to a command. What is reserved in a field becomes a blank, what does not fit is left out.
pub fn answer(ok: bool, text: &str) -> Sentence {
    let mut line = SentenceBuilder::answer(ok);
    line.words(text);
    line.end()
}

fn degrees(angle: f32) -> f32 {
    angle / DEG as f32
}

/// The nearest integer, halves away from zero; `None` where it is not finite.
fn rounded(x: f32) -> Option<i32> {
    #[expect(
        clippy::cast_possible_truncation,
        reason = "the cast saturates: what is shown is then the limit"
    )]
    x.is_finite().then(|| (x + if x < 0.0 { -0.5 } else { 0.5 }) as i32)
}

/// Hundredths of a degree in [0, 36000), of an angle in rad.
fn hundredths_of_turn(angle: f32) -> Option<i32> {
    rounded(degrees(angle) * 100.0).map(|hundredths| hundredths.rem_euclid(36_000))
}

/// Hundredths of a degree, of an angle in rad that is within half a turn.
fn half_turn(angle: f32) -> Option<i32> {
    rounded(degrees(angle) * 100.0).map(|hundredths| hundredths.clamp(-18_000, 18_000))
}

/// Thousandths of a degree, rounded up, of a 1σ in rad; 999.999° stands for all beyond.
fn up(sd: f32) -> Option<i32> {
    let exact = degrees(sd) * 1000.0;
    #[expect(
        clippy::cast_possible_truncation,
        reason = "the cast saturates: what is shown is then the limit"
    )]
    let whole = exact as i32;
    #[expect(clippy::cast_precision_loss, reason = "beyond 2^24 there is no fraction left")]
    let more = exact > whole as f32;
    (exact.is_finite() && exact >= 0.0).then(|| whole.saturating_add(i32::from(more)).min(999_999))
}

/// A sentence in the making. What does not fit is left out, so that an end always does: the tests show that
/// nothing but an answer's text ever is.
///
/// Not to be inlined: the sentences would be three times as large.
#[derive(Debug)]
pub(crate) struct SentenceBuilder(Vec<u8, LONGEST>);

impl SentenceBuilder {
    /// The beginning of an answer; [`words`](Self::words) and numbers follow.
    pub(crate) fn answer(ok: bool) -> Self {
        let mut line = Self::start("$PRNSA");
        line.comma();
        line.text(if ok { "ok" } else { "error" });
        line.comma();
        line
    }

    /// The beginning of a TXT that is the only one of its message; [`words`](Self::words) and numbers follow.
    pub(crate) fn message(talker: Talker, kind: TextKind) -> Self {
        let mut line = Self::of(talker, "TXT,01,01,");
        line.text(match kind {
            TextKind::Warning => "01,",
            TextKind::Notice => "02,",
        });
        line
    }

    /// Text for people: what is reserved in a field becomes a blank.
    #[inline(never)]
    pub(crate) fn words(&mut self, text: &str) {
        for byte in text.bytes() {
            let reserved = !matches!(byte, b' '..=b'}') || b"!$*,\\^".contains(&byte);
            self.push(if reserved { b' ' } else { byte });
        }
    }

    /// A number with so many decimals, four at the most for a number of four digits before the point.
    pub(crate) fn decimal(&mut self, x: f32, decimals: usize) {
        let scale = (0..decimals).fold(1.0, |scale, _| scale * 10.0);
        if let Some(scaled) = rounded(x * scale) {
            self.fixed(scaled, decimals, false);
        }
    }

    /// A whole number.
    pub(crate) fn count(&mut self, count: u32) {
        self.number(count, 0);
    }

    fn start(head: &str) -> Self {
        let mut line = Self(Vec::new());
        line.text(head);
        line
    }

    /// The beginning of a sentence that is not our own.
    #[inline(never)]
    fn of(talker: Talker, kind: &str) -> Self {
        let mut line = Self::start("$");
        line.text(talker.as_str());
        line.text(kind);
        line
    }

    #[inline(never)]
    fn push(&mut self, byte: u8) {
        if self.0.len() < BODY {
            let _ = self.0.push(byte);
        }
    }

    #[inline(never)]
    fn text(&mut self, text: &str) {
        for byte in text.bytes() {
            self.push(byte);
        }
    }

    /// Begins a field.
    fn comma(&mut self) {
        self.push(b',');
    }

    /// A whole field of one letter.
    #[inline(never)]
    fn letter(&mut self, letter: u8) {
        self.comma();
        self.push(letter);
    }

    /// A whole field of a time of day, `hhmmss.ss`; empty without one.
    #[inline(never)]
    fn time(&mut self, time: Option<TimeOfDay>) {
        self.comma();
        let Some((hhmmss, ms)) = time.map(TimeOfDay::parts) else {
            return;
        };
        // Eight digits, zeros before it as well.
        let mut scale = 10_000_000;
        while scale > 0 {
            self.push(b'0' + ((hhmmss * 100 + ms / 10) / scale % 10) as u8);
            if scale == 100 {
                self.push(b'.');
            }
            scale /= 10;
        }
    }

    /// `scaled`/10^`decimals`.
    #[inline(never)]
    fn fixed(&mut self, scaled: i32, decimals: usize, plus: bool) {
        if scaled < 0 {
            self.push(b'-');
        } else if plus {
            self.push(b'+');
        }
        self.number(scaled.unsigned_abs(), decimals);
    }

    /// The same without a sign. Fewer decimals than ten.
    #[inline(never)]
    fn number(&mut self, scaled: u32, decimals: usize) {
        // The ten digits of 2³², last one first.
        let mut digits = Vec::<u8, 10>::new();
        let mut rest = scaled;
        while rest > 0 || digits.len() <= decimals {
            let _ = digits.push(b'0' + (rest % 10) as u8);
            rest /= 10;
        }
        while let Some(digit) = digits.pop() {
            self.push(digit);
            if digits.len() == decimals && decimals > 0 {
                self.push(b'.');
            }
        }
    }

    /// Check sum: exclusive or of all between `$` and `*`, in upper-case hex.
    #[inline(never)]
    pub(crate) fn end(mut self) -> Sentence {
        let sum = self.0.iter().skip(1).fold(0, |sum, byte| sum ^ byte);
        let _ = self
            .0
            .extend_from_slice(&[b'*', hex_digit(sum >> 4), hex_digit(sum & 15), b'\r', b'\n']);
        Sentence(self.0)
    }
}

#[cfg(test)]
mod tests {
    use std::string::{String, ToString};
    use std::vec::Vec;

    use proptest::prelude::*;

    use super::*;
    use crate::fault::Fault;

    /// Fields of a sentence after all that holds for each was checked.
    fn fields(sentence: &Sentence) -> Vec<String> {
        let text = sentence.as_str();
        assert!(text.is_ascii() && text.len() <= LONGEST, "{text}");
        let (body, sum) = text
            .strip_prefix('$')
            .and_then(|text| text.strip_suffix("\r\n"))
            .unwrap()
            .split_once('*')
            .unwrap();
        let expected = body.bytes().fold(0, |sum: u8, byte| sum ^ byte);
        assert_eq!(sum, std::format!("{expected:02X}"), "{text}");
        assert!(!body.contains(['\r', '\n', '$', '*', '!']), "{text}");
        body.split(',').map(ToString::to_string).collect()
    }

    fn rad(deg: f64) -> f32 {
        (deg * DEG) as f32
    }

    fn attitude(heading: f64, pitch: f64, roll: f64) -> Attitude {
        Attitude {
            heading: rad(heading),
            pitch: rad(pitch),
            roll: rad(roll),
        }
    }

    const HE: Talker = Talker::He;
    const SD: AttitudeSd = AttitudeSd {
        heading: 0.35 * DEG as f32,
        pitch: 1e-7,
        roll: 2e-5,
    };

    #[test]
    fn known_sentences() {
        // The third is one of gpsd's examples; the check sums of the others were made by another program.
        assert_eq!(
            ths(HE, Some(rad(77.52)), HeadingMode::Estimated).as_str(),
            "$HETHS,77.52,E*2E\r\n"
        );
        assert_eq!(hdt(HE, rad(274.07)).unwrap().as_str(), "$HEHDT,274.07,T*19\r\n");
        assert_eq!(rot(HE, Some(0.0)).as_str(), "$HEROT,0.0,A*2B\r\n");
        assert_eq!(pashr(None, None, true).as_str(), "$PASHR,,,,,,,,,,0,0*74\r\n");
        assert_eq!(
            pashr(None, Some((&attitude(305.3, -0.126, 0.054), &SD)), true).as_str(),
            "$PASHR,,305.30,T,+0.05,-0.13,,0.002,0.001,0.350,0,1*10\r\n"
        );
    }

    #[test]
    fn places_and_speeds() {
        // Check sums by another program.
        assert_eq!(
            gll(HE, None, rad(40.1), rad(-8.500_01)).unwrap().as_str(),
            "$HEGLL,4006.0000,N,00830.0006,W,,V,E*53\r\n"
        );
        assert_eq!(
            gll(HE, None, rad(-0.99), rad(100.5)).unwrap().as_str(),
            "$HEGLL,0059.4000,S,10030.0000,E,,V,E*59\r\n"
        );
        assert_eq!(
            vtg(HE, -3.0, 4.0).unwrap().as_str(),
            "$HEVTG,323.13,T,,M,9.72,N,18.00,K,E*16\r\n"
        );
        assert_eq!(fields(&vtg(HE, 0.05, 0.0).unwrap())[1], "");
        assert_eq!(
            (gll(HE, None, f32::NAN, 0.0), vtg(HE, 0.0, f32::INFINITY)),
            (None, None)
        );
    }

    #[test]
    fn times_of_day() {
        let time = TimeOfDay::new(12_345, 67);
        // Check sums by another program.
        assert_eq!(pashr(time, None, true).as_str(), "$PASHR,012345.06,,,,,,,,,0,0*5D\r\n");
        assert_eq!(
            gll(HE, TimeOfDay::new(0, 0), rad(40.1), rad(-8.500_01))
                .unwrap()
                .as_str(),
            "$HEGLL,4006.0000,N,00830.0006,W,000000.00,V,E*7D\r\n"
        );
        let of = |hhmmss, ms| fields(&pashr(TimeOfDay::new(hhmmss, ms), None, true))[1].clone();
        assert_eq!(
            (of(235_959, 999), of(100_000, 9)),
            ("235959.99".into(), "100000.00".into())
        );
    }

    #[test]
    fn each_talker_says_who_it_is() {
        for (place, talker) in Talker::ALL.into_iter().enumerate() {
            // Its number in flash.
            assert_eq!(talker as usize, place);
            let addresses = [
                (ths(talker, None, HeadingMode::Invalid), "THS"),
                (hdt(talker, 1.0).unwrap(), "HDT"),
                (rot(talker, None), "ROT"),
                (gll(talker, None, 0.1, 0.1).unwrap(), "GLL"),
                (vtg(talker, 1.0, 1.0).unwrap(), "VTG"),
            ];
            for (sentence, kind) in addresses {
                assert_eq!(fields(&sentence)[0], std::format!("{}{kind}", talker.as_str()));
            }
        }
        // The check sum by another program.
        assert_eq!(hdt(Talker::Hc, rad(274.07)).unwrap().as_str(), "$HCHDT,274.07,T*1F\r\n");
    }

    #[test]
    fn a_message_keeps_out_what_is_reserved() {
        let of = |kind, text: &str| {
            let mut line = SentenceBuilder::message(Talker::Hc, kind);
            line.words(text);
            fields(&line.end())
        };
        assert_eq!(
            of(TextKind::Notice, "a,b\r\n$c"),
            ["HCTXT", "01", "01", "02", "a b   c"]
        );
        let long = of(TextKind::Warning, &"x".repeat(100));
        assert_eq!((long[3].as_str(), long[4].len()), ("01", TEXT));
        // IEC 61162-1.
        assert_eq!(TEXT, 61);
    }

    #[test]
    fn headings_stay_within_a_turn_after_rounding() {
        let of = |deg: f64| fields(&ths(HE, Some(rad(deg)), HeadingMode::Autonomous))[1].clone();
        for (deg, text) in [
            (359.996, "0.00"),
            (359.99, "359.99"),
            (-0.004, "0.00"),
            (-0.006, "359.99"),
            (360.0, "0.00"),
            (0.005_1, "0.01"),
            (90.0, "90.00"),
            (-90.0, "270.00"),
        ] {
            assert_eq!(of(deg), text, "{deg}");
            assert_eq!(fields(&hdt(HE, rad(deg)).unwrap())[1], text);
            assert_eq!(
                fields(&pashr(None, Some((&attitude(deg, 0.0, 0.0), &SD)), true))[2],
                text
            );
        }
    }

    #[test]
    fn nothing_invalid_carries_a_heading() {
        let invalid = "$HETHS,,V*14\r\n";
        assert_eq!(ths(HE, None, HeadingMode::Autonomous).as_str(), invalid);
        assert_eq!(ths(HE, Some(1.0), HeadingMode::Invalid).as_str(), invalid);
        assert_eq!(ths(HE, Some(f32::NAN), HeadingMode::Autonomous).as_str(), invalid);
        assert_eq!(hdt(HE, f32::INFINITY), None);
        assert_eq!(rot(HE, None).as_str(), "$HEROT,,V*12\r\n");
        assert_eq!(rot(HE, Some(f32::NAN)), rot(HE, None));
        let broken = AttitudeSd { pitch: f32::NAN, ..SD };
        assert_eq!(
            pashr(None, Some((&attitude(1.0, 2.0, 3.0), &broken)), true),
            pashr(None, None, false)
        );
    }

    #[test]
    fn port_is_negative() {
        assert_eq!(fields(&rot(HE, Some(rad(-7.3 / 60.0))))[1], "-7.3");
        assert_eq!(fields(&rot(HE, Some(rad(-0.04 / 60.0))))[1], "0.0");
    }

    #[test]
    fn spreads_are_rounded_up() {
        for (deg, text) in [
            (0.0, "0.000"),
            (1e-9, "0.001"),
            (0.3501, "0.351"),
            (0.25, "0.250"),
            (12.0, "12.000"),
        ] {
            let sd = AttitudeSd {
                heading: rad(deg),
                ..SD
            };
            assert_eq!(
                fields(&pashr(None, Some((&attitude(0.0, 0.0, 0.0), &sd)), true))[9],
                text,
                "{deg}"
            );
        }
    }

    #[test]
    fn status_in_full_and_empty() {
        let report = Report {
            up_us: 312_345_678,
            mode: Some((ModeName::Aligned, 189_000_000)),
            heading_sd: Some(rad(0.300_1)),
            reason: "",
            fault: None,
            rotor: Some(rad(123.456)),
        };
        assert_eq!(
            fields(&status(&report)),
            ["PRNST", "312.34", "aligned", "123", "0.301", "", "", "", "123.46"]
        );
        let empty = Report {
            up_us: 40_000,
            mode: None,
            heading_sd: None,
            reason: "",
            fault: None,
            rotor: None,
        };
        assert_eq!(status(&empty).as_str(), "$PRNST,0.04,,,,,,,*51\r\n");
    }

    /// The longest of each field there can be: mode and fault exclude each other, a century of running.
    #[test]
    fn the_longest_status_keeps_all_its_fields() {
        let century_us = 100 * 366 * 86_400 * 1_000_000;
        let rotor = Some(rad(-359.99));
        let longest = |mode, reason, fault| {
            let report = Report {
                up_us: century_us,
                mode: Some((mode, 0)),
                heading_sd: fault_none(fault, rad(179.9994)),
                reason,
                fault,
                rotor,
            };
            let fields = fields(&status(&report));
            assert_eq!((fields.len(), fields[8].as_str()), (9, "-359.99"), "{fields:?}");
        };
        fn fault_none(fault: Option<(&'static str, bool)>, sd: f32) -> Option<f32> {
            fault.is_none().then_some(sd)
        }
        longest(ModeName::Calibrating, "inconsistent", None);
        let hot = Fault::OverTemperature { temperature_c: 110.0 };
        longest(ModeName::Fault, "", Some((hot.name(), true)));
    }

    #[test]
    fn answers_keep_out_what_is_reserved() {
        assert_eq!(
            fields(&answer(true, "a,b$c*d\r\n\u{e9}")),
            ["PRNSA", "ok", "a b c d    "]
        );
        let long = "x".repeat(200);
        assert_eq!(fields(&answer(false, &long))[2].len(), ANSWER);
    }

    fn any_f32() -> impl Strategy<Value = f32> {
        prop_oneof![any::<u32>().prop_map(f32::from_bits), -10.0..10.0_f32]
    }

    proptest! {
        #[test]
        fn whatever_comes_the_sentence_is_sound(
            heading in any_f32(), pitch in any_f32(), roll in any_f32(), sd in any_f32(), up_us in any::<u64>(),
            text in any::<String>(),
        ) {
            for mode in [HeadingMode::Autonomous, HeadingMode::Invalid] {
                prop_assert_eq!(fields(&ths(HE, Some(heading), mode)).len(), 3);
            }
            prop_assert_eq!(fields(&rot(HE, Some(heading))).len(), 3);
            let sds = AttitudeSd { heading: sd, pitch: sd, roll: sd };
            prop_assert_eq!(fields(&pashr(None, Some((&Attitude { heading, pitch, roll }, &sds)), true)).len(), 12);
            fields(&answer(true, &text));
            fields(&status(&Report {
                up_us,
                mode: Some((ModeName::SelfTest, 0)),
                heading_sd: Some(sd),
                reason: "catching-up",
                fault: Some(("rotor", true)),
                rotor: Some(roll),
            }));
        }

        #[test]
        fn headings_are_right_to_half_a_digit(deg in -720.0..720.0_f64) {
            let shown: f64 = fields(&ths(HE, Some(rad(deg)), HeadingMode::Autonomous))[1].parse().unwrap();
            prop_assert!((0.0..360.0).contains(&shown));
            let off = (shown - deg + 180.0).rem_euclid(360.0) - 180.0;
            // Half a digit, and the single precision of 720°.
            prop_assert!(off.abs() < 0.005_1, "{deg} {shown}");
        }
    }
}
