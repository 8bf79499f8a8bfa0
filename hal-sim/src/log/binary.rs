//! The reader of what a unit's serial line carried while it recorded: frames of [`app::record`] between sentences.
//!
//! ```text
//! bytes ─► frames by sync byte, length and CRC ─► times and indices, unwrapped ─► rows
//!            └► sentences, and bytes that are neither: counted
//! ```
//!
//! A row carries what the unit's aligner was given, to the bit: the increments are divided by the interval in f64 and
//! come back in f32 as they were.
//!
//! What was lost between unit and file is time without data before the next row, by the unit's clock, as is a sample
//! without a rotor angle. A unit that restarts begins its clock anew; it goes on from where it was, so that the time it
//! was off is missing from the gap: what is left is at least the start of its IMU, which is more than is bridged.

use std::collections::VecDeque;
use std::io::{self, BufRead};

use app::nmea::LONGEST;
use app::record::{
    ANGLE, CRC, FAULT, FIRMWARE, GAP, HEADER, HEADER_FIXED, KEY, LATCHED, LEAD, LONGEST_BODY, SAMPLE, SATURATED,
    STATUS, SYNC, TAKEN_SHIFT, Taken, VERSION,
};
use drivers::crc::crc32;
use drivers::{Channels, Identity, Scale};
use frames::{Sensor, Vec3};
use nav::deviation::Deviation;
use nav::increment::Sample;
use nav::noise::ImuNoise;
use nav::rotor::RotorConfig;

use crate::nmea;

use super::{Gap, LIMITS, LogError, LogProblem, LogRow, LogWarning, Place, WarningKind};

/// Indices of samples there are.
const INDICES: u64 = 1 << 16;
/// Statuses kept for a reader that does not ask.
const STATUSES: usize = 100;
/// A clock beyond 31 years is none, µs; with the interval below it bounds how many samples a gap can miss.
const CLOCK_US: u64 = 1_000_000_000_000_000;
/// Shortest interval that can be, s.
const SHORTEST: f32 = 1e-5;
/// Largest angle of the rotor that can be, rad.
const ANGLE_LIMIT: f32 = 1e7;
/// Bytes of the six figures of the noise that version 1 of a header lacks, and of the deviation that version 2 lacks as well.
const SINCE_VERSION_2: usize = 24;
const SINCE_VERSION_3: usize = 20;
/// Interval where neither a sample nor the header says it, s.
const INTERVAL: f32 = 0.005;

/// Who recorded: [`app::record::Header`], read.
#[derive(Debug, Clone, PartialEq)]
pub struct Header {
    /// When it was sent, µs of the unit's clock.
    pub t_us: u64,
    /// Index of the next sample, modulo 2¹⁶.
    pub index: u16,
    /// Serial number of the unit.
    pub serial: u32,
    /// The IMU.
    pub imu: Identity,
    /// Nominal time from one sample to the next, s.
    pub period: f32,
    /// What a count of the IMU is.
    pub scale: Scale,
    /// Geodetic latitude that the aligner used, rad.
    pub latitude: f32,
    /// Height above the ellipsoid, m.
    pub height: f32,
    /// The rotor's schedule, rad and s.
    pub schedule: RotorConfig,
    /// What the aligner took the IMU for, SI.
    pub noise: ImuNoise,
    /// What its aligner knew of the gyro error that is constant in the housing.
    pub deviation: Option<Deviation>,
    /// Version of the firmware.
    pub firmware: String,
}

/// Mode and fault of the unit, from when on.
#[derive(Debug, Clone, PartialEq)]
pub struct UnitStatus {
    /// Where it is in the file.
    pub at: Place,
    /// When, s, on the clock of the rows.
    pub t_s: f64,
    /// The mode by name.
    pub mode: String,
    /// The fault by name.
    pub fault: Option<String>,
    /// Whether the fault stays.
    pub latched: bool,
}

impl core::fmt::Display for UnitStatus {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.write_str(&self.mode)?;
        if let Some(fault) = &self.fault {
            write!(f, ": {fault}{}", if self.latched { ", latched" } else { "" })?;
        }
        Ok(())
    }
}

/// Kinds of [`Loss`].
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Lost {
    /// Bytes of no frame and no sentence.
    Bytes,
    /// Samples the unit recorded that are not in the file.
    Samples,
    /// Samples before the first header, or between a restart and the header after it: their time is not known.
    Times,
    /// Samples whose rotor angle the unit did not know.
    Angles,
    /// Samples with a figure that cannot be.
    Impossible,
    /// Frames of a kind that this program does not know.
    Unknown,
    /// Restarts of the unit.
    Restarts,
    /// Headers with other settings than the one before.
    Settings,
}

impl Lost {
    /// All of them, by index.
    const ALL: [Self; 8] = [
        Self::Bytes,
        Self::Samples,
        Self::Times,
        Self::Angles,
        Self::Impossible,
        Self::Unknown,
        Self::Restarts,
        Self::Settings,
    ];

    pub(super) fn describe(self, count: u64, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        let plural = if count == 1 { "" } else { "s" };
        match self {
            Self::Bytes => write!(f, "{count} byte{plural} of no frame and no sentence, skipped"),
            Self::Samples => write!(f, "{count} sample{plural} lost between unit and file"),
            Self::Times => write!(
                f,
                "{count} sample{plural} before a header, left out: their time is not known"
            ),
            Self::Angles => write!(f, "{count} sample{plural} without the rotor's angle, left out"),
            Self::Impossible => write!(f, "{count} sample{plural} with a figure that cannot be, left out"),
            Self::Unknown => write!(f, "{count} frame{plural} of a kind unknown to this program, left out"),
            Self::Restarts => write!(f, "the unit restarted {count} time{plural}"),
            Self::Settings => write!(
                f,
                "the unit's settings changed {count} time{plural}; a replay takes them up where the unit aligns anew"
            ),
        }
    }
}

/// What of a recording was lost, or is of no use.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Loss {
    /// Samples in the file.
    pub samples: u64,
    /// Whole sentences between them.
    pub sentences: u64,
    /// How many of each kind, and where the first is.
    counts: [(u64, u64); Lost::ALL.len()],
}

impl Loss {
    /// How many.
    pub fn count(&self, kind: Lost) -> u64 {
        self.counts[kind as usize].0
    }

    fn add(&mut self, kind: Lost, count: u64, at: u64) {
        let entry = &mut self.counts[kind as usize];
        if entry.0 == 0 {
            entry.1 = at;
        }
        entry.0 = entry.0.saturating_add(count);
    }

    pub(super) fn warnings(&self, file: &str) -> Vec<LogWarning> {
        let some = Lost::ALL
            .into_iter()
            .zip(self.counts)
            .filter(|(_, (count, _))| *count > 0);
        some.map(|(kind, (count, at))| LogWarning {
            file: file.to_owned(),
            at: Place::Byte(at),
            kind: WarningKind::Lost { kind, count },
        })
        .collect()
    }
}

/// What the bytes from one on are.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Found {
    /// A frame of so many bytes.
    Frame(usize),
    /// A sentence of so many bytes.
    Sentence(usize),
    /// The end of a line.
    LineEnd,
    /// Nothing.
    Nothing,
    /// That many bytes are needed to tell.
    More(usize),
}

fn look(bytes: &[u8]) -> Found {
    match bytes.first() {
        Some(&SYNC) => {
            let Some(&length) = bytes.get(1) else {
                return Found::More(LEAD);
            };
            let length = usize::from(length);
            if !(1..=LONGEST_BODY).contains(&length) {
                return Found::Nothing;
            }
            let whole = LEAD + length + CRC;
            let Some((summed, sum)) = bytes.get(1..whole).and_then(|rest| rest.split_last_chunk::<CRC>()) else {
                return Found::More(whole);
            };
            if crc32(summed.iter().copied()) == u32::from_le_bytes(*sum) {
                Found::Frame(whole)
            } else {
                Found::Nothing
            }
        }
        Some(b'$') => match bytes.iter().take(LONGEST).position(|byte| *byte == b'\n') {
            Some(feed) if nmea::whole(&bytes[..=feed]).is_some() => Found::Sentence(feed + 1),
            Some(_) => Found::Nothing,
            None if bytes.len() < LONGEST => Found::More(LONGEST),
            None => Found::Nothing,
        },
        Some(b'\r' | b'\n') => Found::LineEnd,
        Some(_) => Found::Nothing,
        None => Found::More(1),
    }
}

/// Whether the start of a file is what a unit sends: there is a frame or a sentence.
pub(super) fn is_recording(start: &[u8]) -> bool {
    (0..start.len()).any(|at| matches!(look(&start[at..]), Found::Frame(_) | Found::Sentence(_)))
}

/// Whether there is a frame in the start of a file.
pub(super) fn has_frame(start: &[u8]) -> bool {
    (0..start.len()).any(|at| matches!(look(&start[at..]), Found::Frame(_)))
}

/// Finds frames.
#[derive(Debug)]
struct Scanner<R> {
    input: R,
    file: String,
    buffer: Vec<u8>,
    /// Bytes of the buffer that are done with.
    done: usize,
    /// Bytes of the file before the buffer.
    before: u64,
    ended: bool,
    loss: Loss,
}

impl<R: BufRead> Scanner<R> {
    /// Whether there are so many bytes that are not done with.
    fn have(&mut self, count: usize) -> Result<bool, LogError> {
        while self.buffer.len() - self.done < count && !self.ended {
            self.buffer.drain(..self.done);
            self.before += self.done as u64;
            self.done = 0;
            let chunk = match self.input.fill_buf() {
                Ok(chunk) => chunk,
                Err(error) if error.kind() == io::ErrorKind::Interrupted => continue,
                Err(error) => return Err(LogError::cannot_read(&self.file, &error)),
            };
            let taken = chunk.len();
            self.ended = taken == 0;
            self.buffer.extend_from_slice(chunk);
            self.input.consume(taken);
        }
        Ok(self.buffer.len() - self.done >= count)
    }

    /// The next frame: where it is, and its body in the buffer.
    fn frame(&mut self) -> Result<Option<(u64, core::ops::Range<usize>)>, LogError> {
        let mut need = 1;
        while self.have(need)? || need > 1 {
            // What the file ends in is not the beginning of anything.
            let short = self.buffer.len() - self.done < need;
            let at = self.before + self.done as u64;
            need = 1;
            match look(&self.buffer[self.done..]) {
                Found::Frame(length) => {
                    let body = self.done + LEAD..self.done + length - CRC;
                    self.done += length;
                    return Ok(Some((at, body)));
                }
                Found::Sentence(length) => {
                    self.done += length;
                    self.loss.sentences += 1;
                }
                Found::LineEnd => self.done += 1,
                Found::More(more) if !short => need = more,
                Found::Nothing | Found::More(_) => {
                    self.done += 1;
                    self.loss.add(Lost::Bytes, 1, at);
                }
            }
        }
        Ok(None)
    }
}

/// Numbers one after the other.
struct Bytes<'a>(&'a [u8]);

impl Bytes<'_> {
    fn take<const N: usize>(&mut self) -> Option<[u8; N]> {
        let (taken, rest) = self.0.split_first_chunk::<N>()?;
        self.0 = rest;
        Some(*taken)
    }

    fn u8(&mut self) -> Option<u8> {
        self.take::<1>().map(|[byte]| byte)
    }

    fn u16(&mut self) -> Option<u16> {
        self.take().map(u16::from_le_bytes)
    }

    fn u32(&mut self) -> Option<u32> {
        self.take().map(u32::from_le_bytes)
    }

    fn u64(&mut self) -> Option<u64> {
        self.take().map(u64::from_le_bytes)
    }

    fn f32(&mut self) -> Option<f32> {
        self.take().map(f32::from_le_bytes)
    }

    fn vector(&mut self) -> Option<Vec3<Sensor>> {
        Some(Vec3::new(self.f32()?, self.f32()?, self.f32()?))
    }

    /// Where `there`, or nothing.
    fn optional<T>(&mut self, there: bool, take: impl Fn(&mut Self) -> Option<T>) -> Option<Option<T>> {
        if there { take(self).map(Some) } else { Some(None) }
    }

    fn text(&self) -> String {
        let text = String::from_utf8_lossy(self.0);
        text.chars().map(|c| if c.is_control() { '·' } else { c }).collect()
    }
}

/// A sample as it is on the line.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Recorded {
    index: u16,
    /// The lower half of the unit's clock, µs.
    t_us: u32,
    dtheta_s: Vec3<Sensor>,
    dv_s: Vec3<Sensor>,
    alpha: Option<f32>,
    /// Interval, s, and temperature, °C.
    key: Option<(f32, f32)>,
    gap: f32,
    saturated: Channels,
    taken: Option<Taken>,
}

#[derive(Debug, Clone, PartialEq)]
enum Frame {
    Header(Box<Header>),
    Status {
        t_us: u64,
        flags: u8,
        text: String,
    },
    Sample(Recorded),
    /// A header of another version.
    Version(u8),
}

/// The content of a frame; `None` where it is none that this version knows.
fn decode(body: &[u8]) -> Option<Frame> {
    let mut bytes = Bytes(body);
    match bytes.u8()? {
        HEADER => {
            let version = bytes.u8()?;
            let fixed = match version {
                1 => HEADER_FIXED - SINCE_VERSION_2 - SINCE_VERSION_3,
                2 => HEADER_FIXED - SINCE_VERSION_3,
                VERSION => HEADER_FIXED,
                _ => return Some(Frame::Version(version)),
            };
            (fixed..=fixed + FIRMWARE).contains(&body.len()).then_some(())?;
            let header = header(bytes, version).filter(|header| header.t_us <= CLOCK_US)?;
            Some(Frame::Header(Box::new(header)))
        }
        STATUS => Some(Frame::Status {
            t_us: bytes.u64()?,
            flags: bytes.u8()?,
            text: bytes.text(),
        }),
        kind if kind & SAMPLE != 0 => {
            let sample = Recorded {
                index: bytes.u16()?,
                t_us: bytes.u32()?,
                dtheta_s: bytes.vector()?,
                dv_s: bytes.vector()?,
                alpha: bytes.optional(kind & ANGLE != 0, Bytes::f32)?,
                key: bytes.optional(kind & KEY != 0, |bytes| Some((bytes.f32()?, bytes.f32()?)))?,
                gap: bytes.optional(kind & GAP != 0, Bytes::f32)?.unwrap_or_default(),
                saturated: Channels::from_bits(bytes.optional(kind & SATURATED != 0, Bytes::u8)?.unwrap_or_default()),
                taken: Taken::from_bits((kind & !SAMPLE) >> TAKEN_SHIFT)?,
            };
            bytes.0.is_empty().then_some(Frame::Sample(sample))
        }
        _ => None,
    }
}

fn header(mut bytes: Bytes<'_>, version: u8) -> Option<Header> {
    let mut header = Header {
        t_us: bytes.u64()?,
        index: bytes.u16()?,
        serial: bytes.u32()?,
        imu: Identity {
            product: bytes.u16()?,
            revision: bytes.u16()?,
            serial: bytes.u16()?,
        },
        period: bytes.f32()?,
        scale: Scale {
            rate: bytes.f32()?,
            force: bytes.f32()?,
            temperature_c: bytes.f32()?,
            temperature_zero_c: bytes.f32()?,
        },
        latitude: bytes.f32()?,
        height: bytes.f32()?,
        schedule: RotorConfig {
            rate: bytes.f32()?,
            travel: bytes.f32()?,
            acceleration: bytes.f32()?,
        },
        noise: ImuNoise {
            gyro_bias_sd: bytes.f32()?,
            accel_bias_sd: bytes.f32()?,
            angle_random_walk: bytes.f32()?,
            velocity_random_walk: bytes.f32()?,
            gyro_instability_sd: bytes.f32()?,
            gyro_instability_tau: bytes.f32()?,
            gyro_scale_factor_sd: bytes.f32()?,
            gyro_misalignment_sd: bytes.f32()?,
            ..ImuNoise::default()
        },
        deviation: None,
        firmware: String::new(),
    };
    if version >= 2 {
        header.noise = ImuNoise {
            gyro_g_sensitivity_sd: bytes.f32()?,
            gyro_housing_sd: bytes.f32()?,
            accel_scale_factor_sd: bytes.f32()?,
            accel_misalignment_sd: bytes.f32()?,
            accel_instability_sd: bytes.f32()?,
            accel_instability_tau: bytes.f32()?,
            ..header.noise
        };
    }
    if version >= 3 {
        let deviation = Deviation {
            rate_b: [bytes.f32()?, bytes.f32()?],
            force_b: [bytes.f32()?, bytes.f32()?],
            sd: bytes.f32()?,
        };
        header.deviation = Some(deviation).filter(Deviation::is_valid);
    }
    header.firmware = bytes.text();
    Some(header)
}

/// The sample before.
#[derive(Debug, Clone, Copy)]
struct Before {
    /// µs of the unit's clock.
    t_us: u64,
    index: u16,
    taken: Option<Taken>,
}

/// Reads a recording as an iterator of rows. The first error ends it.
#[derive(Debug)]
pub(super) struct Reader<R> {
    scanner: Scanner<R>,
    header: Header,
    /// The latest time known, µs of the unit's clock.
    clock_us: u64,
    /// Clocks of the unit before it restarted, µs.
    restarted_us: u64,
    before: Option<Before>,
    /// The interval that holds, s, and the temperature, °C.
    dt: f32,
    temperature_c: Option<f32>,
    nominal: Option<f64>,
    /// Time of the row given last, µs since the first start.
    given_us: Option<u64>,
    statuses: VecDeque<UnitStatus>,
    done: bool,
}

impl<R: BufRead> Reader<R> {
    /// Reads up to the first header.
    ///
    /// # Errors
    /// [`LogError`] where there is none.
    pub(super) fn new(input: R, file: &str) -> Result<Self, LogError> {
        let mut scanner = Scanner {
            input,
            file: file.to_owned(),
            buffer: Vec::new(),
            done: 0,
            before: 0,
            ended: false,
            loss: Loss::default(),
        };
        let mut frames = 0;
        loop {
            let Some((at, body)) = scanner.frame()? else {
                let sentences = scanner.loss.sentences;
                return Err(LogError {
                    file: scanner.file,
                    at: None,
                    problem: if frames == 0 {
                        LogProblem::NoRecord { sentences }
                    } else {
                        LogProblem::NoRecordHeader { frames }
                    },
                });
            };
            frames += 1;
            match decode(&scanner.buffer[body]) {
                Some(Frame::Header(header)) => {
                    let mut reader = Self {
                        scanner,
                        clock_us: header.t_us,
                        restarted_us: 0,
                        before: None,
                        dt: INTERVAL,
                        temperature_c: None,
                        nominal: None,
                        given_us: None,
                        statuses: VecDeque::new(),
                        done: false,
                        header: *header.clone(),
                    };
                    reader.take_header(*header, at);
                    return Ok(reader);
                }
                Some(Frame::Version(found)) => {
                    return Err(LogError {
                        file: scanner.file,
                        at: Some(Place::Byte(at)),
                        problem: LogProblem::RecordVersion { found },
                    });
                }
                Some(Frame::Sample(_)) => {
                    scanner.loss.samples += 1;
                    scanner.loss.add(Lost::Times, 1, at);
                }
                // A status may come before the header that it is sent with.
                Some(Frame::Status { .. }) => {}
                None => scanner.loss.add(Lost::Unknown, 1, at),
            }
        }
    }

    pub(super) fn file_name(&self) -> &str {
        &self.scanner.file
    }

    pub(super) fn nominal_dt_s(&self) -> Option<f64> {
        self.nominal
    }

    pub(super) fn header(&self) -> &Header {
        &self.header
    }

    pub(super) fn loss(&self) -> &Loss {
        &self.scanner.loss
    }

    pub(super) fn next_status(&mut self) -> Option<UnitStatus> {
        self.statuses.pop_front()
    }

    fn error(&self, at: Option<u64>, problem: LogProblem) -> LogError {
        LogError {
            file: self.scanner.file.clone(),
            at: at.map(Place::Byte),
            problem,
        }
    }

    fn take_header(&mut self, header: Header, at: u64) {
        let restarted = self.before.filter(|before| header.t_us < before.t_us);
        if let Some(before) = restarted {
            self.scanner.loss.add(Lost::Restarts, 1, at);
            self.restarted_us = self.restarted_us.saturating_add(before.t_us);
            self.before = None;
        }
        // The first sample after a header has its interval; this is for where it is lost.
        if (restarted.is_some() || self.given_us.is_none()) && header.period > 0.0 && header.period <= 1.0 {
            self.dt = header.period;
        }
        let settings = |header: &Header| Header {
            t_us: 0,
            index: 0,
            ..header.clone()
        };
        if settings(&header) != settings(&self.header) {
            self.scanner.loss.add(Lost::Settings, 1, at);
        }
        self.clock_us = header.t_us;
        self.header = header;
    }

    fn take_status(&mut self, at: u64, t_us: u64, flags: u8, text: &str) {
        let (mode, fault) = match text.split_once(',') {
            Some((mode, fault)) if flags & FAULT != 0 => (mode, Some(fault.to_owned())),
            _ => (text, None),
        };
        if self.statuses.len() == STATUSES {
            self.statuses.pop_front();
        }
        self.statuses.push_back(UnitStatus {
            at: Place::Byte(at),
            t_s: seconds(self.restarted_us.saturating_add(t_us)),
            mode: mode.to_owned(),
            fault,
            latched: flags & LATCHED != 0,
        });
    }

    /// The row of a sample, unless it is of no use.
    fn take_sample(&mut self, at: u64, sample: &Recorded) -> Option<LogRow> {
        self.scanner.loss.samples += 1;
        // Nearest to the latest time known: half a turn of the lower half is 36 min.
        #[expect(clippy::cast_possible_truncation, clippy::cast_possible_wrap, reason = "modulo 2^32")]
        let ahead = sample.t_us.wrapping_sub(self.clock_us as u32) as i32;
        let t_us = self.clock_us.saturating_add_signed(ahead.into());
        if self.before.is_some_and(|before| t_us <= before.t_us) {
            // The unit restarted, and its header is lost.
            self.scanner.loss.add(Lost::Times, 1, at);
            return None;
        }
        if let Some((dt, temperature_c)) = sample.key {
            self.dt = dt;
            self.temperature_c = Some(temperature_c).filter(|t| f64::from(t.abs()) <= LIMITS[8]);
        }
        let before = self.before.replace(Before {
            t_us,
            index: sample.index,
            taken: sample.taken,
        });
        self.clock_us = t_us;
        let lost = before.map_or(0, |before| lost(&before, t_us, sample, self.dt));
        if lost > 0 {
            self.scanner.loss.add(Lost::Samples, lost, at);
        }
        let Some(alpha) = sample.alpha else {
            self.scanner.loss.add(Lost::Angles, 1, at);
            return None;
        };
        let increments = Sample {
            dtheta_s: sample.dtheta_s,
            dv_s: sample.dv_s,
            dt: self.dt,
            gap: sample.gap,
        };
        if !(increments.is_valid() && increments.dt >= SHORTEST && alpha.abs() <= ANGLE_LIMIT) {
            self.scanner.loss.add(Lost::Impossible, 1, at);
            return None;
        }
        // The alignment began anew in what is lost.
        let aligning =
            before.is_none_or(|before| matches!(before.taken, None | Some(Taken::Aligner | Taken::AlignerAnew)));
        let taken = match sample.taken {
            Some(Taken::Aligner) if lost > 0 && !aligning => Some(Taken::AlignerAnew),
            taken => taken,
        };
        Some(self.row(at, self.restarted_us.saturating_add(t_us), &increments, alpha, taken))
    }

    fn row(&mut self, at: u64, t_us: u64, increments: &Sample, alpha: f32, taken: Option<Taken>) -> LogRow {
        let (dt, gap) = (f64::from(increments.dt), f64::from(increments.gap));
        let nominal = *self.nominal.get_or_insert(dt);
        let mut dt_s = dt;
        let mut missing = None;
        if let Some(given_us) = self.given_us {
            // To the bit where nothing is lost: the unit knows the time of a sample to a microsecond only.
            let by_clock = seconds(t_us.saturating_sub(given_us));
            dt_s = if by_clock - (dt + gap) > 0.5 * nominal {
                by_clock
            } else {
                dt + gap
            };
            missing = (dt_s > dt).then(|| Gap {
                after_s: seconds(given_us),
                nominal_dt_s: dt,
                missing: ((dt_s - dt) / dt).round() as u64,
            });
        }
        self.given_us = Some(t_us);
        LogRow {
            at: Place::Byte(at),
            t_s: seconds(t_us),
            dt_s,
            w_is_s: increments.dtheta_s.cast::<f64>() / dt,
            f_is_s: increments.dv_s.cast::<f64>() / dt,
            encoder: alpha.into(),
            temperature_c: self.temperature_c.map(f64::from),
            gap: missing,
            taken,
        }
    }

    fn next_row(&mut self) -> Result<Option<LogRow>, LogError> {
        while let Some((at, body)) = self.scanner.frame()? {
            match decode(&self.scanner.buffer[body]) {
                Some(Frame::Header(header)) => self.take_header(*header, at),
                Some(Frame::Status { t_us, flags, text }) => self.take_status(at, t_us, flags, &text),
                Some(Frame::Sample(sample)) => {
                    if let Some(row) = self.take_sample(at, &sample) {
                        return Ok(Some(row));
                    }
                }
                Some(Frame::Version(found)) => {
                    return Err(self.error(Some(at), LogProblem::RecordVersion { found }));
                }
                None => self.scanner.loss.add(Lost::Unknown, 1, at),
            }
        }
        if self.given_us.is_some() {
            return Ok(None);
        }
        let samples = self.scanner.loss.count(Lost::Angles);
        Err(self.error(
            None,
            if samples > 0 {
                LogProblem::NoAngle { samples }
            } else {
                LogProblem::NoRows
            },
        ))
    }
}

impl<R: BufRead> Iterator for Reader<R> {
    type Item = Result<LogRow, LogError>;

    fn next(&mut self) -> Option<Self::Item> {
        if self.done {
            return None;
        }
        let row = self.next_row().transpose();
        self.done = !matches!(row, Some(Ok(_)));
        row
    }
}

fn seconds(us: u64) -> f64 {
    us as f64 * 1e-6
}

/// Samples lost before one: the index says how many modulo 2¹⁶, the clock how many times that.
fn lost(before: &Before, t_us: u64, sample: &Recorded, dt: f32) -> u64 {
    let by_index = u64::from(sample.index.wrapping_sub(before.index).wrapping_sub(1));
    let free = seconds(t_us.saturating_sub(before.t_us)) - f64::from(sample.gap.max(0.0)) - f64::from(dt);
    // The cast saturates, and makes zero of what is negative or no number.
    let by_clock = (free / f64::from(dt)).round() as u64;
    // More than had the time to be: an index that starts anew.
    if by_index > by_clock.saturating_add(by_clock / 16 + 2) {
        return by_clock;
    }
    let turns = by_clock.saturating_sub(by_index).saturating_add(INDICES / 2) / INDICES;
    by_index.saturating_add(turns * INDICES)
}
