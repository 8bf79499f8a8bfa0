//! Recorded logs: [`hal_sim::log`].

use app::command::ModeName;
use app::fault::Fault;
use app::mode::Status;
use app::record::{self, Header, Recorder, SYNC, Taken};
use app::sample::TimedSample;
use drivers::{Channels, Identity, Scale};
use frames::Vec3;
use hal_sim::log::{Checker, Format, LogReader, LogRow, LogWriter};
use nav::increment::Sample;
use nav::noise::ImuNoise;
use nav::rotor::RotorConfig;

use crate::{Feed, crc32};

/// Reads to the end, and judges what there is: the rows, whether the end is that of the log, and whether nothing of it was
/// doubtful.
fn read(bytes: &[u8], format: &Format) -> (Vec<LogRow>, bool, bool) {
    let mut rows = Vec::new();
    let mut reader = match LogReader::with_format(bytes, "fuzz.log", format) {
        Ok(reader) => reader,
        Err(error) => {
            one_line(&error.to_string());
            return (rows, false, false);
        }
    };
    let mut whole = true;
    let mut checker = Some(Checker::new("fuzz.log"));
    while let Some(found) = reader.next() {
        while let Some(status) = reader.next_status() {
            // A frame may name no mode at all.
            assert!(!status.to_string().contains('\n'), "{status}");
        }
        match found {
            Ok(row) => {
                check(&row, rows.last());
                if let Some(Err(error)) = checker.as_mut().map(|checker| checker.push(&row)) {
                    one_line(&error.to_string());
                    checker = None;
                }
                rows.push(row);
            }
            Err(error) => {
                one_line(&error.to_string());
                whole = false;
            }
        }
        assert!(whole || reader.next().is_none());
    }
    let warnings = reader.warnings();
    let clean = warnings.is_empty();
    for warning in warnings {
        one_line(&warning.to_string());
    }
    match checker.map(Checker::finish) {
        Some(Ok(warnings)) => warnings.iter().for_each(|warning| one_line(&warning.to_string())),
        Some(Err(error)) => one_line(&error.to_string()),
        None => {}
    }
    (rows, whole, clean)
}

fn one_line(message: &str) {
    assert!(!message.is_empty() && !message.contains('\n'), "{message}");
}

fn check(row: &LogRow, before: Option<&LogRow>) {
    assert!(row.t_s.is_finite() && row.dt_s > 0.0 && row.dt_s.is_finite(), "{row:?}");
    assert!(before.is_none_or(|before| row.t_s >= before.t_s), "{row:?}");
    assert!(
        row.w_is_s.norm().is_finite() && row.f_is_s.norm().is_finite(),
        "{row:?}"
    );
    assert!(row.encoder.abs() <= 1e10, "{row:?}");
    assert!(
        row.gap
            .is_none_or(|gap| gap.nominal_dt_s > 0.0 && gap.nominal_dt_s <= row.dt_s),
        "{row:?}"
    );
}

/// A file of text, as it is. What is read to its end, as it was stamped, can be written and read again.
pub fn csv(data: &[u8]) {
    let (rows, whole, clean) = read(data, &Format::default());
    if !(whole && clean) || rows.is_empty() {
        return;
    }
    let mut writer = LogWriter::new(Vec::new(), true).unwrap();
    for row in &rows {
        let Sample { dtheta_s, dv_s, dt, .. } = row.sample();
        writer
            .write(row.t_s, dt, dtheta_s, dv_s, row.encoder, row.temperature_c)
            .unwrap();
    }
    let text = writer.finish().unwrap();
    let (again, ..) = read(&text, &Format::default());
    if rows.len() == 1 || data.contains(&SYNC) {
        // A recording may have one row, or a time that two have.
        return;
    }
    assert_eq!(again.len(), rows.len(), "{}", String::from_utf8_lossy(&text));
    for (new, old) in again.iter().zip(&rows) {
        assert_eq!(new.t_s, old.t_s);
        let close = |new: f64, old: f64| (new - old).abs() <= 1e-10 * old.abs() + 1e-300;
        assert!(close(new.encoder, old.encoder));
        for (new, old) in new.w_is_s.to_array().into_iter().zip(old.w_is_s.to_array()) {
            assert!(close(new, old), "{new} {old}");
        }
    }
}

/// A format as TOML, a line `---`, and a log that is read by it.
pub fn format(data: &[u8]) {
    let Some(at) = data.windows(5).position(|bytes| bytes == b"\n---\n") else {
        return;
    };
    let Ok(toml) = core::str::from_utf8(&data[..at]) else {
        return;
    };
    match Format::parse(toml, "fuzz.toml") {
        Ok(format) => {
            read(&data[at + 5..], &format);
        }
        Err(error) => one_line(&error.to_string()),
    }
}

/// What a recording unit's line carries: sound frames of anything, samples, sentences, noise. Where nothing but headers
/// and samples was laid on it, every sample that can be is a row, its increments to the bit.
pub fn record(data: &[u8]) {
    let mut feed = Feed(data);
    let mut line = Line::default();
    while !feed.is_empty() && line.bytes.len() < 1 << 15 {
        line.lay(&mut feed);
    }
    let (rows, whole, _) = read(&line.bytes, &Format::default());
    if line.plain && !line.samples.is_empty() {
        assert!(whole);
        assert_eq!(rows.len(), line.samples.len());
        for (row, sample) in rows.iter().zip(&line.samples) {
            let found = row.sample();
            assert_eq!(found.dtheta_s.cast::<f32>(), sample.sample.dtheta_s);
            assert_eq!(found.dv_s.cast::<f32>(), sample.sample.dv_s);
        }
    }
}

struct Line {
    bytes: Vec<u8>,
    recorder: Recorder,
    t_us: u64,
    /// Where the last frame begins.
    last: usize,
    /// Headers and samples only, the first a header, the clock going on.
    plain: bool,
    /// Those that can be a row.
    samples: Vec<TimedSample>,
}

impl Default for Line {
    fn default() -> Self {
        Self {
            bytes: Vec::new(),
            recorder: Recorder::new(),
            t_us: 0,
            last: 0,
            plain: true,
            samples: Vec::new(),
        }
    }
}

impl Line {
    fn lay(&mut self, feed: &mut Feed<'_>) {
        let op = feed.u8();
        let begun = !self.bytes.is_empty();
        match op % 8 {
            0 | 1 => {
                self.tick(feed, op);
                self.plain &= begun;
                let sample = self.sample(feed, op);
                let taken = (op & 8 != 0).then_some(Taken::No);
                self.last = self.bytes.len();
                self.bytes.extend(self.recorder.sample(&sample, taken).as_bytes());
                let possible = sample.sample.is_valid() && sample.sample.dt >= 1e-5;
                if possible && sample.alpha.is_some_and(|alpha| alpha.abs() <= 1e7) {
                    self.samples.push(sample);
                }
            }
            2 => {
                self.tick(feed, op);
                let firmware = String::from_utf8_lossy(feed.slice(usize::from(op >> 4))).into_owned();
                let header = header(feed, &firmware);
                self.last = self.bytes.len();
                self.bytes.extend(self.recorder.header(self.t_us, &header).as_bytes());
            }
            3 => {
                self.plain = false;
                // The last frame once more with a byte changed, or anything.
                let body = match self.bytes.get(self.last..) {
                    Some([SYNC, length, rest @ ..]) if op & 8 != 0 && rest.len() >= usize::from(*length) => {
                        let mut body = rest[..usize::from(*length)].to_vec();
                        let place = usize::from(feed.u8()) % body.len().max(1);
                        body.iter_mut().skip(place).take(1).for_each(|byte| *byte ^= feed.u8());
                        body
                    }
                    _ => {
                        let length = usize::from(feed.u8());
                        feed.slice(length).to_vec()
                    }
                };
                self.frame(&body);
            }
            4 => {
                self.plain = false;
                let length = usize::from(feed.u8());
                let text: Vec<u8> = feed.slice(length % 90).iter().map(|byte| byte & 0x7F).collect();
                let sum = text.iter().fold(0, |sum, byte| sum ^ byte);
                self.bytes.push(b'$');
                self.bytes.extend(&text);
                self.bytes.extend(format!("*{sum:02X}\r\n").bytes());
            }
            5 => {
                self.plain = false;
                self.tick(feed, op);
                let status = Status {
                    mode: ModeName::ALL[usize::from(op >> 4) % ModeName::ALL.len()],
                    since_us: 0,
                    fault: (op & 8 != 0).then(|| Fault::OverTemperature {
                        temperature_c: feed.f32(),
                    }),
                    latched: op & 0x10 != 0,
                    attempts: 0,
                };
                self.bytes.extend(record::status(self.t_us, &status).as_bytes());
            }
            6 => {
                self.plain = false;
                let length = usize::from(feed.u8());
                self.bytes.extend(feed.slice(length));
            }
            _ => {
                self.plain = false;
                match op >> 3 {
                    // Another unit, or the same after a restart.
                    0 => self.recorder = Recorder::new(),
                    1 => self.recorder.skip(feed.u16()),
                    2 => self.t_us = u64::from_le_bytes(feed.array()),
                    3 => drop(self.bytes.pop()),
                    _ => {
                        if let Some(byte) = self.bytes.last_mut() {
                            *byte ^= feed.u8();
                        }
                    }
                }
            }
        }
    }

    /// The clock goes on; by a minute at the most, so that its lower half tells.
    fn tick(&mut self, feed: &mut Feed<'_>, op: u8) {
        let step = if op & 0x10 == 0 {
            4941
        } else {
            1 + feed.u32() % 60_000_000
        };
        self.t_us = self.t_us.saturating_add(step.into());
        self.plain &= self.t_us < 1 << 40;
    }

    /// A frame of the right check sum with any body.
    fn frame(&mut self, body: &[u8]) {
        let length = body.len() as u8;
        let summed = [&[length], body].concat();
        self.bytes.push(SYNC);
        self.bytes.extend(&summed);
        self.bytes.extend(crc32(&summed).to_le_bytes());
    }

    fn sample(&self, feed: &mut Feed<'_>, op: u8) -> TimedSample {
        // Of any bits, or of what a sensor could say.
        let mut figure = |scale: f32| {
            if op & 1 == 0 {
                f32::from(feed.u16().cast_signed()) * scale
            } else {
                feed.f32()
            }
        };
        let dtheta_s = Vec3::new(figure(1e-6), figure(1e-6), figure(1e-6));
        let dv_s = Vec3::new(figure(1e-4), figure(1e-4), figure(1e-4));
        let dt = if op & 1 == 0 { 0.004_941_f32 } else { figure(1.0) };
        let gap = if op & 0x20 == 0 { 0.0 } else { figure(1e-3) };
        TimedSample {
            t_us: self.t_us,
            sample: Sample {
                dtheta_s,
                dv_s,
                dt,
                gap,
            },
            alpha: (op & 0x40 == 0).then(|| figure(1e-3)),
            temperature_c: figure(1.0),
            saturated: Channels::from_bits(feed.u8()),
        }
    }
}

fn header<'a>(feed: &mut Feed<'_>, firmware: &'a str) -> Header<'a> {
    let figures: [f32; 8] = core::array::from_fn(|_| feed.f32());
    let [period, latitude, height, rate, a, b, c, d] = figures;
    Header {
        serial: feed.u32(),
        imu: Identity {
            product: feed.u16(),
            revision: feed.u16(),
            serial: feed.u16(),
        },
        period,
        scale: Scale {
            rate,
            force: a,
            temperature_c: b,
            temperature_zero_c: c,
        },
        latitude,
        height,
        schedule: RotorConfig {
            rate: d,
            travel: a,
            acceleration: b,
        },
        noise: ImuNoise {
            gyro_bias_sd: c,
            ..ImuNoise::default()
        },
        deviation: None,
        firmware,
    }
}
