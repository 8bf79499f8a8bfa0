//! Sentences of a receiver of satellite navigation: place and motion, where it stands by them.
//!
//! | sentence | what is taken | when it is valid |
//! |---|---|---|
//! | `RMC` | time of day, latitude, longitude, speed, course | status A, and the mode of the next table or none |
//! | `VTG` | speed, course | the mode of the next table |
//!
//! | mode | | taken |
//! |---|---|---|
//! | A, D, F, P, R | autonomous, differential, float, precise, fixed | yes |
//! | E, M, N, S | dead reckoning, by hand, none, simulated | no: the unit must not hear itself |
//!
//! RMC of before NMEA 2.3 has no mode, and its status says it. VTG without one says nothing about its worth, and is not
//! taken. The status of navigation, the last field of RMC since NMEA 4.10, is V with every receiver that does not watch
//! its integrity, and is not looked at. The date is left: nothing here needs it.
//!
//! A sentence counts as a whole or not at all: `$`, a check sum that is right, numbers that are numbers, angles within
//! their range. Any talker is heard but the proprietary ones.
//!
//! Pure: bytes in, numbers out. The [console](crate::console) takes them from its line, for whoever has such a receiver; what
//! becomes of them:
//!
//! - A place is the last good position, kept over resets; the unit aligns with it where nobody has entered one.
//! - A base that is under way cannot be aligned: the alignment waits until it stands.
//! - The navigator takes velocity and place.
//! - The unit's own sentences carry its [time of day](crate::utc).
//!
//! Source: IEC 61162-1:2016, RMC and VTG.

use core::fmt;

use frames::math;
use frames::units::DEG;

use crate::utc::TimeOfDay;

/// Most of what is taken: with `$`, without CR LF. The standard has 80; some receivers write more digits.
pub const LONGEST: usize = 120;
/// As `hhmmss`: a time that a day has only now and then.
const LEAP_SECOND: u32 = 235_960;
/// Knots in a m/s.
const KNOT: f32 = 1852.0 / 3600.0;
/// Slower than this a receiver cannot tell its course and says none, m/s: the base stands, within that.
const SLOWEST: f32 = 0.5;
/// Faster than this it is no vehicle of ours, m/s.
const FASTEST: f32 = 515.0;

/// A place.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Place {
    /// Geodetic, rad, north positive.
    pub latitude: f32,
    /// rad, east positive.
    pub longitude: f32,
}

impl Place {
    /// Whether another is nearer than `angle`, rad, in latitude and in longitude.
    pub fn is_near(&self, other: &Self, angle: f32) -> bool {
        (self.latitude - other.latitude).abs() < angle && math::wrap_pi(self.longitude - other.longitude).abs() < angle
    }

    /// Whether it is 0°, 0° to the last digit: what some receivers say that know none.
    pub fn is_null(&self) -> bool {
        self.latitude == 0.0 && self.longitude == 0.0
    }
}

/// A motion over ground.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Motion {
    /// m/s.
    pub speed: f32,
    /// Clockwise from true north, rad; receivers leave it out where they stand.
    pub course: Option<f32>,
}

/// What a sentence says.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Fix {
    /// Of the fix, of RMC; not all receivers say it, and second 60 is left.
    pub time: Option<TimeOfDay>,
    /// Of RMC.
    pub place: Option<Place>,
    /// Of both.
    pub motion: Option<Motion>,
}

/// Why a sentence is not used.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Refused {
    /// No `$`, no `*` with two hex digits, a byte that is no text, or too long.
    Frame,
    /// The check sum is another.
    CheckSum,
    /// Neither RMC nor VTG.
    Other,
    /// The receiver does not stand by it.
    NotValid,
    /// This field, counted from the address, is missing, no number, or out of range.
    Field(u8),
}

impl Motion {
    /// m/s north and east; zero where it is slow without a course, `None` where it moves and nobody knows whither.
    pub fn north_east(&self) -> Option<[f32; 2]> {
        let Some(course) = self.course else {
            return (self.speed <= SLOWEST).then_some([0.0; 2]);
        };
        let (sin, cos) = math::sin_cos(course);
        Some([self.speed * cos, self.speed * sin])
    }
}

impl fmt::Display for Refused {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Frame => f.write_str("expected $, text, * and two hex digits"),
            Self::CheckSum => f.write_str("expected another check sum: noise on the line"),
            Self::Other => f.write_str("expected RMC or VTG"),
            Self::NotValid => f.write_str("the receiver has no fix"),
            Self::Field(n) => write!(f, "expected a number in its range in field {n}"),
        }
    }
}

impl core::error::Error for Refused {}

/// Reads a sentence, with or without its line end.
///
/// # Errors
/// [`Refused`], and then nothing of it is to be used.
pub fn parse(line: &[u8]) -> Result<Fix, Refused> {
    let body = framed(line)?;
    let mut fields = [&body[..0]; 16];
    let mut count = 0;
    for (to, field) in fields.iter_mut().zip(body.split(|byte| *byte == b',')) {
        *to = field;
        count += 1;
    }
    let field = |n: usize| fields.get(n).copied().unwrap_or_default();
    match field(0) {
        [b'P', ..] => Err(Refused::Other),
        [_, _, b'R', b'M', b'C'] => {
            // Without a mode before NMEA 2.3.
            let mode = count <= 12 || is_valid(field(12));
            if field(2) != b"A" || !mode {
                return Err(Refused::NotValid);
            }
            let time = time(field(1)).ok_or(Refused::Field(1))?;
            let place = Place {
                latitude: angle(field(3), field(4), *b"NS", 90).ok_or(Refused::Field(3))?,
                longitude: angle(field(5), field(6), *b"EW", 180).ok_or(Refused::Field(5))?,
            };
            Ok(Fix {
                time,
                place: Some(place),
                motion: Some(motion(field(7), 7, field(8), 8)?),
            })
        }
        [_, _, b'V', b'T', b'G'] => {
            if !is_valid(field(9)) {
                return Err(Refused::NotValid);
            }
            Ok(Fix {
                time: None,
                place: None,
                motion: Some(motion(field(5), 5, field(1), 1)?),
            })
        }
        _ => Err(Refused::Other),
    }
}

/// What is between `$` and `*`, if the check sum says so.
fn framed(line: &[u8]) -> Result<&[u8], Refused> {
    let line = line.trim_ascii_end();
    let (Some((b'$', rest)), true) = (line.split_first(), line.len() <= LONGEST) else {
        return Err(Refused::Frame);
    };
    let [body @ .., b'*', high, low] = rest else {
        return Err(Refused::Frame);
    };
    let (Some(high), Some(low)) = (hex(*high), hex(*low)) else {
        return Err(Refused::Frame);
    };
    if !body
        .iter()
        .all(|byte| matches!(byte, b' '..=b'~') && !b"$*!".contains(byte))
    {
        return Err(Refused::Frame);
    }
    let sum = body.iter().fold(0, |sum, byte| sum ^ byte);
    if sum == high * 16 + low {
        Ok(body)
    } else {
        Err(Refused::CheckSum)
    }
}

fn hex(digit: u8) -> Option<u8> {
    match digit {
        b'0'..=b'9' => Some(digit - b'0'),
        b'A'..=b'F' => Some(digit - b'A' + 10),
        b'a'..=b'f' => Some(digit - b'a' + 10),
        _ => None,
    }
}

fn is_valid(mode: &[u8]) -> bool {
    matches!(mode, [b'A' | b'D' | b'F' | b'P' | b'R'])
}

/// Knots and degrees, with the numbers of their fields.
fn motion(knots: &[u8], n: u8, degrees: &[u8], m: u8) -> Result<Motion, Refused> {
    let speed = decimal(knots).map(|(whole, fraction)| (whole as f32 + fraction) * KNOT);
    let speed = speed.filter(|speed| *speed <= FASTEST).ok_or(Refused::Field(n))?;
    let course = if degrees.is_empty() {
        None
    } else {
        let course = decimal(degrees).filter(|(whole, fraction)| *whole < 360 || *whole == 360 && *fraction == 0.0);
        let (whole, fraction) = course.ok_or(Refused::Field(m))?;
        Some(((whole % 360) as f32 + fraction) * DEG as f32)
    };
    Ok(Motion { speed, course })
}

/// `hhmmss`, with or without a fraction; nothing in it of an empty field and of a leap second.
fn time(value: &[u8]) -> Option<Option<TimeOfDay>> {
    if value.is_empty() {
        return Some(None);
    }
    let (hhmmss, fraction) = decimal(value)?;
    if hhmmss == LEAP_SECOND {
        return Some(None);
    }
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "a thousand at the most, and not negative"
    )]
    let ms = ((fraction * 1000.0 + 0.5) as u32).min(999);
    TimeOfDay::new(hhmmss, ms).map(Some)
}

/// `dddmm.mmmm` and a letter, rad.
fn angle(value: &[u8], letter: &[u8], letters: [u8; 2], most: u32) -> Option<f32> {
    let (whole, fraction) = decimal(value)?;
    let (degrees, minutes) = (whole / 100, (whole % 100) as f32 + fraction);
    let inside = minutes < 60.0 && (degrees < most || degrees == most && minutes == 0.0);
    // Minutes apart from degrees: dddmm.mmmm in one f32 would be good to 100 m.
    let size = (degrees as f32 + minutes / 60.0) * DEG as f32;
    match letter {
        _ if !inside => None,
        [letter] if *letter == letters[0] => Some(size),
        [letter] if *letter == letters[1] => Some(-size),
        _ => None,
    }
}

/// A number without a sign and an exponent, of up to six digits before the point: whole and fraction. Digits after
/// the eighth are read and do not count.
fn decimal(text: &[u8]) -> Option<(u32, f32)> {
    let mut parts = text.splitn(2, |byte| *byte == b'.');
    let (whole, fraction) = (parts.next()?, parts.next().unwrap_or_default());
    let digits = |part: &[u8]| part.iter().all(u8::is_ascii_digit);
    if whole.is_empty() || whole.len() > 6 || !digits(whole) || !digits(fraction) {
        return None;
    }
    let number = |digits: &[u8]| digits.iter().fold(0, |n: u32, digit| 10 * n + u32::from(digit - b'0'));
    let short = fraction.get(..8).unwrap_or(fraction);
    let scale = short.iter().fold(1.0_f32, |scale, _| 10.0 * scale);
    // Seven nines and more round to one.
    Some((number(whole), (number(short) as f32 / scale).min(0.999_999_9)))
}

#[cfg(test)]
mod tests {
    use std::format;
    use std::string::String;
    use std::vec::Vec;

    use proptest::prelude::*;

    use super::*;
    use crate::nmea::{self, Talker};

    fn framed(body: &str) -> String {
        let sum = body.bytes().fold(0, |sum, byte| sum ^ byte);
        format!("${body}*{sum:02X}\r\n")
    }

    fn read(body: &str) -> Result<Fix, Refused> {
        parse(framed(body).as_bytes())
    }

    fn close(a: f32, b: f64) -> bool {
        (f64::from(a) - b * DEG).abs() < 4e-7
    }

    #[test]
    fn a_receivers_sentences() {
        // Examples with their check sums from receivers' manuals.
        let fix = parse(b"$GPRMC,083559.00,A,4717.11437,N,00833.91522,E,0.004,77.52,091202,,,A*57").unwrap();
        let (place, motion) = (fix.place.unwrap(), fix.motion.unwrap());
        assert!(close(place.latitude, 47.285_239_5) && close(place.longitude, 8.565_253_7));
        assert!((motion.speed - 0.004 * KNOT).abs() < 1e-9 && close(motion.course.unwrap(), 77.52));
        let fix = parse(b"$GPVTG,77.52,T,,M,0.004,N,0.008,K,A*06\r\n").unwrap();
        assert_eq!((fix.place, fix.motion), (None, Some(motion)));

        let south = read("GNRMC,,A,3330.0,S,15112.6,W,10,,,,,D,V").unwrap();
        let (place, motion) = (south.place.unwrap(), south.motion.unwrap());
        assert!(close(place.latitude, -33.5) && close(place.longitude, -151.21));
        assert_eq!(motion.course, None);
        // Before NMEA 2.3.
        assert!(read("GPRMC,081836,A,3751.65,S,14507.36,E,000.0,360.0,130998,011.3,E").is_ok());
    }

    #[test]
    fn what_is_not_valid_is_not_used() {
        use Refused as R;
        for (body, refused) in [
            ("GPRMC,,V,4717.1,N,00833.9,E,0.0,,,,,N", R::NotValid),
            ("GPRMC,,A,4717.1,N,00833.9,E,0.0,,,,,E", R::NotValid),
            ("GPRMC,,A,4717.1,N,00833.9,E,0.0,,,,,", R::NotValid),
            ("GPRMC,,V,,,,,,,,,,N", R::NotValid),
            ("GPRMC", R::NotValid),
            ("GPRMC,,A,,,,,,,,,,A", R::Field(3)),
            ("GPRMC,,A,4760.0,N,00833.9,E,0.0,,,,,A", R::Field(3)),
            ("GPRMC,,A,9000.1,N,00833.9,E,0.0,,,,,A", R::Field(3)),
            ("GPRMC,,A,4717.1,E,00833.9,E,0.0,,,,,A", R::Field(3)),
            ("GPRMC,,A,-4717.1,N,00833.9,E,0.0,,,,,A", R::Field(3)),
            ("GPRMC,,A,4717.1,N,18000.1,E,0.0,,,,,A", R::Field(5)),
            ("GPRMC,,A,4717.1,N,00833.9,E,,,,,,A", R::Field(7)),
            ("GPRMC,,A,4717.1,N,00833.9,E,1e3,,,,,A", R::Field(7)),
            ("GPRMC,,A,4717.1,N,00833.9,E,1002,,,,,A", R::Field(7)),
            ("GPRMC,,A,4717.1,N,00833.9,E,0.0,360.1,,,,A", R::Field(8)),
            ("GPVTG,77.52,T,,M,0.004,N,0.008,K", R::NotValid),
            ("GPVTG,,T,,M,,N,,K,N", R::NotValid),
            ("GPVTG,,T,,M,,N,,K,A", R::Field(5)),
            ("GPGGA,,,,,,0,,,,,,,,", R::Other),
            ("PRRMC,,A", R::Other),
            ("", R::Other),
        ] {
            assert_eq!(read(body), Err(refused), "{body}");
        }
        for (line, refused) in [
            (&b"$GPVTG,77.52,T,,M,0.004,N,0.008,K,A*07"[..], R::CheckSum),
            (b"GPVTG,77.52,T,,M,0.004,N,0.008,K,A*06", R::Frame),
            (b"$GPVTG,77.52,T,,M,0.004,N,0.008,K,A", R::Frame),
            (b"$GPVTG,77.52,T,,M,0.004,N,0.008,K,A*0", R::Frame),
            (b"$*00$GPVTG,77.52,T,,M,0.004,N,0.008,K,A*06", R::Frame),
            (b"", R::Frame),
            (&[b'$'; LONGEST + 1], R::Frame),
        ] {
            assert_eq!(parse(line), Err(refused), "{}", line.escape_ascii());
        }
    }

    #[test]
    fn times_are_those_of_the_fix() {
        let of = |time: &str| read(&format!("GPRMC,{time},A,4717.1,N,00833.9,E,0.0,,,,,A")).map(|fix| fix.time);
        let time = |hhmmss, ms| Ok(Some(TimeOfDay::new(hhmmss, ms).unwrap()));
        assert_eq!(of("083559.00"), time(83_559, 0));
        assert_eq!(of("235959.999"), time(235_959, 999));
        assert_eq!(of("000000.0499"), time(0, 50));
        assert_eq!(of("235959.99999"), time(235_959, 999));
        assert_eq!(of("120000"), time(120_000, 0));
        for none in ["", "235960", "235960.50"] {
            assert_eq!(of(none), Ok(None), "{none}");
        }
        for bad in ["240000", "126000", "120060", "-1", "12:00:00", "1200000"] {
            assert_eq!(of(bad), Err(Refused::Field(1)), "{bad}");
        }
        let vtg = parse(b"$GPVTG,77.52,T,,M,0.004,N,0.008,K,A*06").unwrap();
        assert_eq!(vtg.time, None);
    }

    #[test]
    fn places_are_near_over_the_date_line_and_null_to_the_last_digit() {
        let place = |latitude: f32, longitude: f32| Place {
            latitude: latitude.to_radians(),
            longitude: longitude.to_radians(),
        };
        assert!(place(10.0, 179.996).is_near(&place(10.0, -179.996), 0.01_f32.to_radians()));
        assert!(!place(10.0, 179.99).is_near(&place(10.0, -179.99), 0.01_f32.to_radians()));
        assert!(!place(10.0, 0.0).is_near(&place(10.02, 0.0), 0.01_f32.to_radians()));
        assert!(place(0.0, -0.0).is_null() && !place(0.0, 1e-6).is_null());
    }

    #[test]
    fn without_a_course_it_stands_or_nobody_knows_whither() {
        let velocity = |speed, course| Motion { speed, course }.north_east();
        assert_eq!(velocity(0.027 * KNOT, None), Some([0.0; 2]));
        assert_eq!(velocity(SLOWEST, None), Some([0.0; 2]));
        assert_eq!(velocity(1.001 * SLOWEST, None), None);
        assert_eq!(velocity(0.1, Some(0.0)), Some([0.1, 0.0]));
    }

    /// What the unit says of itself is by dead reckoning, also where the line echoes.
    #[test]
    fn the_unit_does_not_hear_itself() {
        let own = nmea::vtg(Talker::Gp, -3.0, 4.0).unwrap();
        assert_eq!(parse(own.as_bytes()), Err(Refused::NotValid));
        let own = nmea::gll(Talker::Gp, None, 0.7, 0.1).unwrap();
        assert_eq!(parse(own.as_bytes()), Err(Refused::Other));
    }

    proptest! {
        #[test]
        fn no_bytes_do_harm(bytes in proptest::collection::vec(any::<u8>(), 0..150)) {
            let _ = parse(&bytes);
        }

        /// Whatever fields there are, what comes out is finite and in range.
        #[test]
        fn what_is_read_is_in_range(
            fields in proptest::collection::vec("[-+]?[0-9]{0,7}[.]?[0-9]{0,10}|[ANSEWDV]", 0..16), rmc in any::<bool>(),
        ) {
            let head = if rmc { "GNRMC,," } else { "GNVTG," };
            if let Ok(fix) = read(&format!("{head}{}", fields.join(","))) {
                if let Some(place) = fix.place {
                    prop_assert!(place.latitude.abs() <= 90.01 * DEG as f32);
                    prop_assert!(place.longitude.abs() <= 180.01 * DEG as f32);
                }
                let motion = fix.motion.unwrap();
                prop_assert!((0.0..=FASTEST).contains(&motion.speed));
                prop_assert!(motion.course.is_none_or(|course| (0.0..=360.01 * DEG as f32).contains(&course)));
            }
        }

        #[test]
        fn places_and_motions_are_what_was_written(
            latitude in -90.0..90.0_f64, longitude in -180.0..180.0_f64, knots in 0.0..1000.0_f64, course in 0.0..359.9_f64,
            digits in 2..8_usize,
        ) {
            let ddmm = |value: f64, width: usize| {
                let (degrees, minutes) = (value.abs().trunc(), value.abs().fract() * 60.0);
                format!("{degrees:0width$.0}{minutes:0w$.digits$}", w = digits + 3)
            };
            let (ns, ew) = (if latitude < 0.0 { 'S' } else { 'N' }, if longitude < 0.0 { 'W' } else { 'E' });
            let (latitude_text, longitude_text) = (ddmm(latitude, 2), ddmm(longitude, 3));
            // Rounded to a whole degree it has 60 minutes: receivers do not.
            prop_assume!(!latitude_text.contains("60.") && !longitude_text.contains("60."));
            let body = format!("GPRMC,,A,{latitude_text},{ns},{longitude_text},{ew},{knots:.3},{course:.2},,,,A");
            let fix = read(&body).unwrap();
            let (place, motion) = (fix.place.unwrap(), fix.motion.unwrap());
            // Half a digit of minutes, and the single precision of half a turn.
            let most = 0.5 * 10.0_f64.powi(-(digits as i32)) / 60.0 * DEG + 5e-7;
            prop_assert!((f64::from(place.latitude) - latitude * DEG).abs() < most, "{}", body);
            prop_assert!((f64::from(place.longitude) - longitude * DEG).abs() < most, "{}", body);
            prop_assert!((f64::from(motion.speed / KNOT) - knots).abs() < 1e-3, "{}", body);
            prop_assert!((f64::from(motion.course.unwrap()) - course * DEG).abs() < 1e-4, "{}", body);
        }

        /// No single byte that is changed goes unnoticed.
        #[test]
        fn a_changed_byte_is_refused(at in 0..70_usize, flip in 1..=255_u8) {
            let mut line: Vec<u8> = framed("GPRMC,083559.00,A,4717.11437,N,00833.91522,E,0.004,77.52,091202,,,A").into();
            let whole = parse(&line).unwrap();
            line[at] ^= flip;
            // An `a` for an `A` in the check sum is the same number; blanks at its end are not.
            prop_assert!(parse(&line).is_err() || parse(&line) == Ok(whole), "{}", line.escape_ascii());
        }
    }
}
