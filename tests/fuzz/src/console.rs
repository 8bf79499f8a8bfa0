//! The console: [`app::console`].

use std::f64::consts::{FRAC_PI_2, PI, TAU};

use app::console::{LONGEST, LineBuffer, LineError, Request, WORDS, parse};
use app::nmea::Talker;
use app::nmea_in;
use app::settings::Settings;

use crate::Feed;

/// A line. One that is taken is taken in other letters and with other blanks for the same; a setting that is taken is
/// what the number or the word says, in its range, and comes back from flash. A sentence that ends in a tilde gets its check sum.
pub fn line(data: &[u8]) {
    let found = parse(data);
    if let [b'$' | b'!' | b'\\', body @ ..] = data {
        assert_eq!(found, Ok(nmea_in::parse(data).ok().map(Request::Fix)));
        if let [body @ .., b'~'] = body {
            let sum = body.iter().fold(0, |sum, byte| sum ^ byte);
            sentence(&[b"$", body, format!("*{sum:02X}").as_bytes()].concat());
        }
        return;
    }
    let text = |byte: &u8| matches!(byte, b'\t' | b' '..=b'~');
    assert_eq!(found == Err(LineError::Long), data.len() > LONGEST);
    if data.len() > LONGEST {
        return;
    }
    assert_eq!(found == Err(LineError::Garbled), !data.iter().all(text));
    match found {
        Ok(Some(request)) => {
            let words: Vec<_> = data
                .split(|byte| matches!(byte, b' ' | b'\t'))
                .filter(|word| !word.is_empty())
                .map(|word| String::from_utf8_lossy(word).into_owned())
                .collect();
            assert!(WORDS.iter().any(|word| word.name.eq_ignore_ascii_case(&words[0])));
            assert_eq!(parse(words.join(" ").to_uppercase().as_bytes()), Ok(Some(request)));
            assert_eq!(parse(words.join("\t").to_lowercase().as_bytes()), Ok(Some(request)));
            if let Request::Set(setting, value) = request {
                let typed: f64 = match setting.name {
                    "talker" => {
                        let named = |talker: &Talker| talker.as_str().eq_ignore_ascii_case(&words[2]);
                        Talker::ALL.iter().position(named).unwrap() as f64
                    }
                    _ => words[2].parse().unwrap(),
                };
                // Two roundings, of digits and of the quotient.
                let difference = (f64::from(value) - typed).abs();
                assert!(
                    difference <= 2.0 * f64::from(f32::EPSILON) * typed.abs(),
                    "{value} {typed}"
                );
                put(setting, value);
            }
        }
        Ok(None) => {
            let blank = |byte: &u8| matches!(byte, b' ' | b'\t');
            assert!(data.iter().find(|byte| !blank(byte)).is_none_or(|byte| *byte == b'#'));
        }
        Err(error) => assert!(!error.expected().is_empty()),
    }
}

/// A receiver's sentence with a check sum that is right. What is taken is on Earth.
fn sentence(line: &[u8]) {
    let Ok(nmea_in::Fix { time, place, motion }) = nmea_in::parse(line) else {
        return;
    };
    if let Some(time) = time {
        let (hhmmss, ms) = time.parts();
        assert!(hhmmss <= 235_959 && ms < 1000);
    }
    let within = |x: f32, most: f64| f64::from(x).abs() <= most * (1.0 + f64::from(f32::EPSILON));
    assert!(place.is_none_or(|place| within(place.latitude, FRAC_PI_2) && within(place.longitude, PI)));
    if let Some(motion) = motion {
        assert!(motion.speed >= 0.0 && within(motion.speed, 515.0));
        assert!(motion.course.is_none_or(|course| course >= 0.0 && within(course, TAU)));
        let fast = |[north, east]: [f32; 2]| north.hypot(east) <= motion.speed * 1.000_01;
        assert!(motion.north_east().is_none_or(fast));
    }
}

fn put(setting: &app::console::Setting, value: f32) {
    let Ok(settings) = setting.put(Settings::default(), value) else {
        return;
    };
    assert_eq!(settings.validate(setting.group), Ok(()));
    let mut bytes = [0; 256];
    let length = settings.encode(setting.group, &mut bytes).unwrap();
    let mut back = Settings::default();
    let version = setting.group.version();
    back.decode(setting.group, version, &mut bytes[..length]).unwrap();
    assert_eq!(back, settings);
    // To what the smallest step of the value is, or a whole count.
    let got = setting.get(&settings);
    let step = if matches!(setting.name, "period" | "talker" | "serial") {
        1.0
    } else {
        3.0 * f32::EPSILON * value.abs()
    };
    assert!((got - value).abs() <= step.max(f32::MIN_POSITIVE), "{value} {got}");
}

/// Bytes as they come, against a second [`LineBuffer`] that is plain. A first byte with its lowest bit set garbles
/// lines now and then, as a receiver does that lost something.
pub fn bytes(data: &[u8]) {
    let mut feed = Feed(data);
    let every = usize::from(feed.u8());
    let mut buffer = LineBuffer::new();
    let (mut line, mut refused) = (Vec::new(), None);
    let (mut last, mut binary) = (0, false);
    for (k, byte) in feed.0.iter().enumerate() {
        if every & 1 == 1 && k % every == 0 {
            buffer.garble();
            refused = refused.or(Some(LineError::Garbled));
        }
        let found = buffer.push(*byte);
        binary |= last == 0xB5 && *byte == 0x62;
        last = *byte;
        match byte {
            b'\r' | b'\n' => {
                let sentence = matches!(line.first(), Some(b'$' | b'!' | b'\\'));
                let expected = match refused.take() {
                    Some(_) if sentence => None,
                    Some(error) => Some(Err(error)),
                    None => parse(&line).transpose(),
                };
                let hidden = binary && matches!(expected, Some(Err(_)));
                assert_eq!(found, expected.filter(|_| !hidden));
                binary = hidden;
                line.clear();
                continue;
            }
            b'$' | b'!' => {
                (line, refused, binary) = (vec![*byte], None, false);
            }
            0x08 | 0x7F => drop(line.pop()),
            b'\t' | b' '..=b'~' if line.len() < nmea_in::LONGEST => line.push(*byte),
            b'\t' | b' '..=b'~' => refused = refused.or(Some(LineError::Long)),
            _ => refused = refused.or(Some(LineError::Garbled)),
        }
        assert_eq!(found, None);
    }
}
