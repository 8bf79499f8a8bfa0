//! A record of every sample, in frames on the serial line between the sentences: what a replay at a desk needs.
//!
//! ```text
//! frame = 0xFA │ n │ body of n bytes │ CRC-32 of n and body          numbers little-endian, f32 by its bits
//! body  = kind │ …
//!
//! 0x01    header   who the unit is, what its aligner was told; at the start and once a second
//! 0x02    status   mode and fault, when they change
//! 0x80…   sample   increments, time, rotor angle; the flags are in the kind
//! ```
//!
//! Byte by byte it is in `docs/log.md`; `hal-sim replay` reads it. What the decisions rest on:
//!
//! - **Bits, not counts.** What the aligner was given goes out as the f32 it was given, calibration and all. A replay with
//!   the same settings then ends in the same bits; from counts it would have to repeat scale, calibration and
//!   compensation of the version that recorded. It costs nothing either: an ADIS16495 has 32 bits an axis.
//! - **What hardly changes is not repeated.** The interval `dt` is the measured period, another one every 64 samples.
//!   It goes with the temperature into every [`KEY_EVERY`]th sample, and wherever it is not the one before. Where
//!   frames are lost the reader holds the last one, some ppm off, until the next.
//! - **A sync byte and a length, not COBS.** The byte never occurs in ASCII or UTF-8, so text and frames cannot be taken
//!   for each other. A frame that fails its CRC is searched for the next sync byte, so that a byte that is
//!   garbled, lost or added costs the frame it is in and no other.
//! - **CRC-32.** Its code is in the image for the IMU, it passes one of 4e9 damaged frames where 16 bits would pass one of
//!   65536, and a damaged frame that passes is a measurement.
//!
//! # Budget
//!
//! At 202.4 samples a second, 10 bits a byte:
//!
//! | | bytes | a second | bytes a second |
//! |---|---|---|---|
//! | sample | 41 | 202.4 | 8298 |
//! | dt and temperature in it | 8 | 6.4 to 9.5 | 51 to 76 |
//! | header | 144 to 168 | 1 | 168 |
//! | together | | | 8.5 kB, 74 % of 11.52 |
//! | sentences | | | 1.3 kB, 11 % |
//!
//! Pure: frames come out as bytes, the caller writes them whole. [`SampleRecorder`](crate::sample_recorder::SampleRecorder) is where the alignment hands its samples over.

use drivers::crc::crc32;
use drivers::{Identity, Scale};
use frames::{Sensor, Vec3};
use heapless::Vec;
use nav::deviation::Deviation;
use nav::noise::ImuNoise;
use nav::rotor::RotorConfig;

use crate::mode::Status;
use crate::sample::TimedSample;

/// The version of this format. A reader refuses later ones. Version 1 had six figures of the noise less, version 2 no
/// deviation: it is the last before the name of the firmware.
pub const VERSION: u8 = 3;
/// First byte of a frame: in no ASCII and no UTF-8 text, and none that a line at rest or broken gives.
pub const SYNC: u8 = 0xFA;
/// Kind of a header.
pub const HEADER: u8 = 0x01;
/// Kind of a status.
pub const STATUS: u8 = 0x02;
/// Kind of a sample, with flags in the other bits.
pub const SAMPLE: u8 = 0x80;
/// Flag of a sample: the rotor's angle is known and follows.
pub const ANGLE: u8 = 1;
/// Flag of a sample: interval and temperature follow.
pub const KEY: u8 = 1 << 1;
/// Flag of a sample: time was lost before it, and how much follows.
pub const GAP: u8 = 1 << 2;
/// Flag of a sample: sensors are at the end of their range, and which follows.
pub const SATURATED: u8 = 1 << 3;
/// Where the three bits of [`Taken`] are in the kind of a sample.
pub const TAKEN_SHIFT: u8 = 4;
/// Bit of a status: there is a fault, whose name follows after a comma.
pub const FAULT: u8 = 1;
/// Bit of a status: the fault stays.
pub const LATCHED: u8 = 1 << 1;

/// Samples from one with interval and temperature to the next, at the most.
pub const KEY_EVERY: u8 = 32;
/// Bytes before a frame's body.
pub const LEAD: usize = 2;
/// Bytes after it.
pub const CRC: usize = 4;
/// Longest name of a version, bytes.
pub const FIRMWARE: usize = 24;
/// Bytes of a header's body without the name of the version.
pub const HEADER_FIXED: usize = 138;
/// Bytes of a status' body without its text.
pub const STATUS_FIXED: usize = 10;
/// Bytes of a sample's body without what its flags announce.
pub const SAMPLE_FIXED: usize = 31;
/// Longest body: a header's.
pub const LONGEST_BODY: usize = HEADER_FIXED + FIRMWARE;
/// Longest frame, bytes.
pub const LONGEST: usize = LEAD + LONGEST_BODY + CRC;

/// A whole frame.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Frame(Vec<u8, LONGEST>);

impl Frame {
    /// What goes over the line.
    pub fn as_bytes(&self) -> &[u8] {
        &self.0
    }
}

/// Who recorded, and what a replay must know.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Header<'a> {
    /// Serial number of the unit.
    pub serial: u32,
    /// The IMU.
    pub imu: Identity,
    /// Nominal time from one sample to the next, s.
    pub period: f32,
    /// What a count of the IMU is: the steps to be seen in the samples.
    pub scale: Scale,
    /// Geodetic latitude that the aligner uses, north positive, rad.
    pub latitude: f32,
    /// Height above the ellipsoid, m.
    pub height: f32,
    /// The rotor's schedule, rad, rad/s, rad/s².
    pub schedule: RotorConfig,
    /// What the aligner takes the IMU for, SI.
    pub noise: ImuNoise,
    /// What the aligner knows of the gyro error that is constant in the housing; on the line its σ is zero where it is `None`.
    pub deviation: Option<Deviation>,
    /// Version of the firmware, ASCII; beyond [`FIRMWARE`] bytes it is cut off.
    pub firmware: &'a str,
}

/// What took a sample. Its increments are recorded as they were taken: corrected by the calibration for aligner and
/// navigator, else as the IMU gave them.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Taken {
    /// Neither aligner nor navigator: the unit did something else, or the rotor's angle was not known.
    No,
    /// The aligner.
    Aligner,
    /// The aligner, as the first one since it started anew.
    AlignerAnew,
    /// The navigator.
    Navigator,
}

impl Taken {
    /// The three bits, where zero says that nobody knows.
    pub const fn bits(taken: Option<Self>) -> u8 {
        match taken {
            None => 0,
            Some(Self::No) => 1,
            Some(Self::Aligner) => 2,
            Some(Self::AlignerAnew) => 3,
            Some(Self::Navigator) => 4,
        }
    }

    /// As [`Taken::bits`] gives them; `None` for bits that it does not give.
    pub const fn from_bits(bits: u8) -> Option<Option<Self>> {
        Some(match bits {
            0 => None,
            1 => Some(Self::No),
            2 => Some(Self::Aligner),
            3 => Some(Self::AlignerAnew),
            4 => Some(Self::Navigator),
            _ => return None,
        })
    }
}

/// Makes frames of samples.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Recorder {
    /// Of the next sample, modulo 2¹⁶.
    index: u16,
    /// Bits of the last interval that went out.
    dt: u32,
    /// Samples until interval and temperature go out again.
    key_in: u8,
}

impl Default for Recorder {
    fn default() -> Self {
        Self::new()
    }
}

impl Recorder {
    /// Nothing recorded yet.
    pub const fn new() -> Self {
        Self {
            index: 0,
            dt: 0,
            key_in: 0,
        }
    }

    /// The header, first of all and then about once a second: a reader that joins in waits for one. `t_us` is the
    /// unit's clock, not before that of any sample recorded already.
    pub fn header(&mut self, t_us: u64, header: &Header) -> Frame {
        // Who joins in here needs the interval.
        self.key_in = 0;
        let mut body = Body::start(HEADER);
        body.put(&[VERSION]);
        body.put(&t_us.to_le_bytes());
        body.put(&self.index.to_le_bytes());
        body.put(&header.serial.to_le_bytes());
        for word in [header.imu.product, header.imu.revision, header.imu.serial] {
            body.put(&word.to_le_bytes());
        }
        let (scale, schedule, noise) = (&header.scale, &header.schedule, &header.noise);
        for figure in [
            header.period,
            scale.rate,
            scale.force,
            scale.temperature_c,
            scale.temperature_zero_c,
            header.latitude,
            header.height,
            schedule.rate,
            schedule.travel,
            schedule.acceleration,
            noise.gyro_bias_sd,
            noise.accel_bias_sd,
            noise.angle_random_walk,
            noise.velocity_random_walk,
            noise.gyro_instability_sd,
            noise.gyro_instability_tau,
            noise.gyro_scale_factor_sd,
            noise.gyro_misalignment_sd,
            noise.gyro_g_sensitivity_sd,
            noise.gyro_housing_sd,
            noise.accel_scale_factor_sd,
            noise.accel_misalignment_sd,
            noise.accel_instability_sd,
            noise.accel_instability_tau,
        ] {
            body.float(figure);
        }
        let deviation = header.deviation.unwrap_or(Deviation {
            rate_b: [0.0; 2],
            force_b: [0.0; 2],
            sd: 0.0,
        });
        let Deviation { rate_b, force_b, sd } = deviation;
        for figure in rate_b.into_iter().chain(force_b).chain([sd]) {
            body.float(figure);
        }
        for byte in header.firmware.bytes().take(FIRMWARE) {
            body.put(&[byte]);
        }
        body.end()
    }

    /// A sample, in the order they were made, and what took it, as far as that is known. Its increments are to be those
    /// that were taken, see [`Taken`].
    pub fn sample(&mut self, sample: &TimedSample, taken: Option<Taken>) -> Frame {
        let increments = &sample.sample;
        let key = self.key_in == 0 || increments.dt.to_bits() != self.dt;
        let saturated = sample.saturated.bits();
        // −0 and NaN are sent as well: nothing is changed here.
        let gap = increments.gap.to_bits() != 0;
        let flag = |on: bool, flag: u8| if on { flag } else { 0 };
        let kind = SAMPLE
            | flag(sample.alpha.is_some(), ANGLE)
            | flag(key, KEY)
            | flag(gap, GAP)
            | flag(saturated != 0, SATURATED)
            | Taken::bits(taken) << TAKEN_SHIFT;
        let mut body = Body::start(kind);
        body.put(&self.index.to_le_bytes());
        #[expect(
            clippy::cast_possible_truncation,
            reason = "the header has the rest: it wraps after 71 min"
        )]
        body.put(&(sample.t_us as u32).to_le_bytes());
        body.vector(&increments.dtheta_s);
        body.vector(&increments.dv_s);
        if let Some(alpha) = sample.alpha {
            body.float(alpha);
        }
        if key {
            body.float(increments.dt);
            body.float(sample.temperature_c);
            self.dt = increments.dt.to_bits();
            self.key_in = KEY_EVERY;
        }
        if gap {
            body.float(increments.gap);
        }
        if saturated != 0 {
            body.put(&[saturated]);
        }
        self.key_in -= 1;
        self.index = self.index.wrapping_add(1);
        body.end()
    }

    /// Samples that are not recorded, because the line has no room for them: the reader then knows how many. Without
    /// it the reader knows by the clock.
    pub fn skip(&mut self, samples: u16) {
        self.index = self.index.wrapping_add(samples);
        self.key_in = 0;
    }
}

/// The unit's mode and fault, when either changes.
pub fn status(t_us: u64, status: &Status) -> Frame {
    let mut body = Body::start(STATUS);
    let mut flags = 0;
    if status.fault.is_some() {
        flags |= FAULT;
    }
    if status.latched {
        flags |= LATCHED;
    }
    body.put(&t_us.to_le_bytes());
    body.put(&[flags]);
    // Names and not numbers: nobody has to keep them in order, and they come seldom.
    body.put(status.mode.as_str().as_bytes());
    if let Some(fault) = &status.fault {
        body.put(b",");
        body.put(fault.name().as_bytes());
    }
    body.end()
}

/// A frame in the making. What does not fit is left out, so that an end always does: the tests show that nothing ever
/// is.
///
/// Not to be inlined: the frames would be three times as large.
struct Body(Vec<u8, LONGEST>);

impl Body {
    fn start(kind: u8) -> Self {
        let mut body = Self(Vec::new());
        body.put(&[SYNC, 0, kind]);
        body
    }

    #[inline(never)]
    fn put(&mut self, bytes: &[u8]) {
        if self.0.len() + bytes.len() <= LONGEST - CRC {
            let _ = self.0.extend_from_slice(bytes);
        }
    }

    #[inline(never)]
    fn float(&mut self, figure: f32) {
        self.put(&figure.to_le_bytes());
    }

    #[inline(never)]
    fn vector(&mut self, vector: &Vec3<Sensor>) {
        for figure in vector.to_array() {
            self.float(figure);
        }
    }

    #[inline(never)]
    fn end(mut self) -> Frame {
        let length = self.0.len().saturating_sub(LEAD);
        if let Some(place) = self.0.get_mut(1) {
            *place = u8::try_from(length).unwrap_or_default();
        }
        let sum = crc32(self.0.iter().skip(1).copied());
        let _ = self.0.extend_from_slice(&sum.to_le_bytes());
        Frame(self.0)
    }
}

#[cfg(test)]
mod tests {
    use drivers::Channels;
    use nav::increment::Sample;
    use proptest::prelude::*;

    use super::*;
    use crate::command::ModeName;
    use crate::fault::{Fault, Task};

    /// The body of a frame after all that holds for each was checked.
    fn body(frame: &Frame) -> std::vec::Vec<u8> {
        let bytes = frame.as_bytes();
        assert_eq!(bytes[0], SYNC);
        let (body, sum) = bytes[LEAD..].split_at(usize::from(bytes[1]));
        assert!(body.len() <= LONGEST_BODY);
        assert_eq!(
            sum,
            crc32(bytes[1..].iter().take(1 + body.len()).copied()).to_le_bytes()
        );
        body.to_vec()
    }

    fn header(firmware: &str) -> Header<'_> {
        Header {
            serial: 7,
            imu: Identity {
                product: 16495,
                revision: 0x0105,
                serial: 321,
            },
            period: 21.0 / 4250.0,
            scale: Scale {
                rate: 1.664_6e-9,
                force: 3.7e-8,
                temperature_c: 0.0125,
                temperature_zero_c: 25.0,
            },
            latitude: 0.7,
            height: 10.0,
            schedule: RotorConfig::default(),
            noise: ImuNoise::default(),
            deviation: None,
            firmware,
        }
    }

    fn sample() -> TimedSample {
        TimedSample {
            t_us: 0x1_0203_0405,
            sample: Sample {
                dtheta_s: Vec3::new(1.0, 2.0, 3.0),
                dv_s: Vec3::new(4.0, 5.0, 6.0),
                dt: 0.005,
                gap: 0.0,
            },
            alpha: Some(0.5),
            temperature_c: 25.0,
            saturated: Channels::NONE,
        }
    }

    #[test]
    fn sizes_of_the_budget() {
        let mut recorder = Recorder::new();
        let mut bytes = 0;
        let mut keys = 0;
        // Ten seconds, with another interval every 64 samples.
        for k in 0..2024_u16 {
            if k.is_multiple_of(202) {
                let frame = recorder.header(0, &header("0.1.0+0123456789abcdefgh"));
                assert_eq!(frame.as_bytes().len(), 168);
                bytes += frame.as_bytes().len();
            }
            let mut sample = sample();
            sample.sample.dt += f32::from(k / 64) * 1e-6;
            let frame = recorder.sample(&sample, Some(Taken::Aligner));
            let size = frame.as_bytes().len();
            assert!(size == 41 || size == 49, "{size}");
            keys += usize::from(size == 49);
            bytes += size;
        }
        let rate = bytes as f64 / 10.0;
        assert!(rate < 0.75 * 11_520.0, "{rate}");
        assert!((64..96).contains(&keys), "{keys}");
    }

    #[test]
    fn the_longest_of_each_kind_is_whole() {
        let long = "x".repeat(100);
        let mut recorder = Recorder::new();
        assert_eq!(body(&recorder.header(u64::MAX, &header(&long))).len(), LONGEST_BODY);
        assert_eq!(body(&recorder.header(0, &header(""))).len(), HEADER_FIXED);
        let full = TimedSample {
            sample: Sample {
                gap: -0.0,
                ..sample().sample
            },
            saturated: Channels::ALL,
            ..sample()
        };
        assert_eq!(body(&recorder.sample(&full, None)).len(), SAMPLE_FIXED + 4 + 8 + 4 + 1);
        let fault = Fault::OverTemperature { temperature_c: 90.0 };
        let worst = Status {
            mode: ModeName::Calibrating,
            since_us: 1,
            fault: Some(fault),
            latched: true,
            attempts: 0,
        };
        let text = b"calibrating,over-temperature";
        assert_eq!(body(&status(1, &worst))[STATUS_FIXED..], *text);
        let overrun = Fault::TaskOverrun {
            task: Task::Motor,
            silent_ms: 9,
        };
        assert!(overrun.name().len() <= fault.name().len());
    }

    #[test]
    fn an_interval_goes_out_where_it_changes_and_now_and_then() {
        let mut recorder = Recorder::new();
        let mut keys = std::vec::Vec::new();
        for k in 0..100_u16 {
            let mut sample = sample();
            if k >= 50 {
                sample.sample.dt = 0.006;
            }
            match k {
                // Who joins in at a header needs it, and so does who lost something.
                70 => drop(recorder.header(0, &header(""))),
                75 => recorder.skip(3),
                _ => {}
            }
            let body = body(&recorder.sample(&sample, None));
            let index = u16::from_le_bytes([body[1], body[2]]);
            assert_eq!(index, if k < 75 { k } else { k + 3 });
            if body[0] & KEY != 0 {
                keys.push(k);
            }
        }
        assert_eq!(keys, [0, 32, 50, 70, 75]);
    }

    #[test]
    fn the_bits_of_taken() {
        let known = [Taken::No, Taken::Aligner, Taken::AlignerAnew, Taken::Navigator];
        for taken in known.map(Some).into_iter().chain([None]) {
            assert_eq!(Taken::from_bits(Taken::bits(taken)), Some(taken));
            let body = body(&Recorder::new().sample(&sample(), taken));
            assert_eq!(Taken::from_bits((body[0] & !SAMPLE) >> TAKEN_SHIFT), Some(taken));
        }
        assert_eq!((5..=u8::MAX).find_map(Taken::from_bits), None);
    }

    proptest! {
        #[test]
        fn whatever_comes_the_frame_is_sound(
            bits in prop::array::uniform9(any::<u32>()), t_us in any::<u64>(), angle in any::<bool>(), channels in any::<u8>(),
        ) {
            let f = |k: usize| f32::from_bits(bits[k]);
            let sample = TimedSample {
                t_us,
                sample: Sample {
                    dtheta_s: Vec3::new(f(0), f(1), f(2)),
                    dv_s: Vec3::new(f(3), f(4), f(5)),
                    dt: f(6),
                    gap: f(7),
                },
                alpha: angle.then(|| f(8)),
                temperature_c: f(0),
                saturated: Channels::from_bits(channels),
            };
            let body = body(&Recorder::new().sample(&sample, None));
            prop_assert_eq!(&body[7..11], &bits[0].to_le_bytes()[..]);
            prop_assert_eq!(&body[27..31], &bits[5].to_le_bytes()[..]);
            prop_assert_eq!(body[0] & !0xF, SAMPLE);
        }
    }
}
