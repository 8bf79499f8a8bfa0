//! What every IMU of the unit gives, whatever the part.

use core::num::NonZeroU16;

use frames::{Sensor, Vec3, wording};

use crate::Error;

/// Angular rate as the part sends it, in counts along its x, y, z.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct RateCounts(pub [i32; 3]);

/// Specific force as the part sends it, in counts along its x, y, z.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct ForceCounts(pub [i32; 3]);

/// Temperature of the part, in counts.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct TemperatureCounts(pub i16);

/// A set of the six inertial sensors.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Channels(u8);

impl Channels {
    /// No sensor.
    pub const NONE: Self = Self(0);
    /// The gyroscope along x.
    pub const RATE_X: Self = Self(1);
    /// The gyroscope along y.
    pub const RATE_Y: Self = Self(1 << 1);
    /// The gyroscope along z.
    pub const RATE_Z: Self = Self(1 << 2);
    /// The accelerometer along x.
    pub const FORCE_X: Self = Self(1 << 3);
    /// The accelerometer along y.
    pub const FORCE_Y: Self = Self(1 << 4);
    /// The accelerometer along z.
    pub const FORCE_Z: Self = Self(1 << 5);
    /// All six.
    pub const ALL: Self = Self(0b11_1111);

    /// From bits: gyroscopes x, y, z in bits 0 to 2, accelerometers in bits 3 to 5; others are dropped.
    pub const fn from_bits(bits: u8) -> Self {
        Self(bits & Self::ALL.0)
    }

    /// The bits, as [`Channels::from_bits`] takes them.
    pub const fn bits(self) -> u8 {
        self.0
    }

    /// Whether no sensor is in the set.
    pub const fn is_empty(self) -> bool {
        self.0 == 0
    }

    /// Whether all of `other` are in the set.
    pub const fn contains(self, other: Self) -> bool {
        self.0 & other.0 == other.0
    }

    /// The sensors for which `test(counts)` holds.
    pub(crate) fn where_counts(
        rate: RateCounts,
        force: ForceCounts,
        rate_test: impl Fn(i32) -> bool,
        force_test: impl Fn(i32) -> bool,
    ) -> Self {
        let mut bits = 0;
        for axis in 0..3 {
            bits |= u8::from(rate_test(rate.0[axis])) << axis;
            bits |= u8::from(force_test(force.0[axis])) << (axis + 3);
        }
        Self(bits)
    }
}

impl core::ops::BitOr for Channels {
    type Output = Self;
    fn bitor(self, other: Self) -> Self {
        Self(self.0 | other.0)
    }
}

wording!(Channels, |self, say| {
    const NAMES: [&str; 6] = [
        "gyro x",
        "gyro y",
        "gyro z",
        "accelerometer x",
        "accelerometer y",
        "accelerometer z",
    ];
    let mut separator = "";
    for (bit, name) in NAMES.iter().enumerate() {
        if self.0 & (1 << bit) != 0 {
            say!("{}{}", separator, name);
            separator = ", ";
        }
    }
    if self.is_empty() {
        say!("no sensor");
    }
});

/// What a part reports of itself along with the data. The bits are those of the ADIS16495's
/// SYS_E_FLAG, the only one of the two parts that has such a register.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct SystemFlags(u16);

impl SystemFlags {
    /// All is well.
    pub const NONE: Self = Self(0);
    /// The part started from its backup memory.
    pub const BOOT_MEMORY: Self = Self(1 << 1);
    /// RAM and flash of the part differ: reset it.
    pub const MEMORY: Self = Self(1 << 2);
    /// A transfer was no multiple of 16 clocks.
    pub const COMMUNICATION: Self = Self(1 << 3);
    /// The self-test failed.
    pub const SENSOR: Self = Self(1 << 5);
    /// The last update of the part's flash failed.
    pub const FLASH_UPDATE: Self = Self(1 << 6);
    /// The part's processor did not keep up: reset it.
    pub const OVERRUN: Self = Self(1 << 7);
    /// The external clock is lost or out of range.
    pub const CLOCK: Self = Self(1 << 8);
    /// The part's watchdog has restarted it.
    pub const WATCHDOG: Self = Self(1 << 15);

    /// The flags of a SYS_E_FLAG word.
    pub const fn from_bits(bits: u16) -> Self {
        Self(bits)
    }

    /// The SYS_E_FLAG word.
    pub const fn bits(self) -> u16 {
        self.0
    }

    /// Whether nothing is reported.
    pub const fn is_empty(self) -> bool {
        self.0 == 0
    }

    /// Whether all of `other` are set.
    pub const fn contains(self, other: Self) -> bool {
        self.0 & other.0 == other.0
    }
}

impl core::ops::BitOr for SystemFlags {
    type Output = Self;
    fn bitor(self, other: Self) -> Self {
        Self(self.0 | other.0)
    }
}

/// How good a sample is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Status {
    /// Sensors at or beyond the end of their range.
    pub saturated: Channels,
    /// What the part reports of itself.
    pub system: SystemFlags,
}

impl Status {
    /// Whether the sample may be used without reserve.
    pub const fn is_good(&self) -> bool {
        self.saturated.is_empty() && self.system.is_empty()
    }
}

/// By what a part lets the reader see whether a sample is the next one.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Sequence {
    /// A counter of the part's samples, modulo 2¹⁶: shows lost and repeated ones.
    Counter(u16),
    /// Whether the data are new since the last reading: shows repeated ones only.
    Fresh(bool),
}

/// One sample in counts. [`Scale::si`] turns it into SI.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct RawSample {
    /// Angular rate.
    pub rate: RateCounts,
    /// Specific force.
    pub force: ForceCounts,
    /// Temperature of the part.
    pub temperature: TemperatureCounts,
    /// Its place among the samples.
    pub sequence: Sequence,
    /// How good it is.
    pub status: Status,
}

/// One sample in SI, along the part's own axes, which are the sensor frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SiSample {
    /// Mean rate of s against inertial space over the sample, in s, rad/s.
    pub w_is_s: Vec3<Sensor>,
    /// Mean specific force of s over the sample, in s, m/s².
    pub f_is_s: Vec3<Sensor>,
    /// Temperature of the part, °C.
    pub temperature_c: f32,
}

impl SiSample {
    /// The integrals over one sample, `(dtheta_s, dv_s)` in rad and m/s, for a sample of `dt` seconds.
    ///
    /// Exact where the part averages its fast samples over the output period (ADIS16495 with its FIR
    /// filters off). Where it filters and picks (ICM-42688-P) it holds for motion well below half the
    /// output rate.
    pub fn increments(&self, dt: f32) -> (Vec3<Sensor>, Vec3<Sensor>) {
        (self.w_is_s * dt, self.f_is_s * dt)
    }
}

/// Conversion of counts to SI, for one part in one configuration.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Scale {
    /// Angular rate of one count, rad/s.
    pub rate: f32,
    /// Specific force of one count, m/s².
    pub force: f32,
    /// Temperature of one count, °C.
    pub temperature_c: f32,
    /// Temperature at count zero, °C.
    pub temperature_zero_c: f32,
}

impl Scale {
    /// The sample in SI.
    ///
    /// f32 keeps 24 bits of the ADIS16495's 32: at 20 °/s a rounding of 1e-6 °/s, a thousandth of the
    /// gyroscope's noise over one sample.
    pub fn si(&self, raw: &RawSample) -> SiSample {
        let vec = |counts: [i32; 3], unit: f32| {
            Vec3::new(
                counts[0] as f32 * unit,
                counts[1] as f32 * unit,
                counts[2] as f32 * unit,
            )
        };
        SiSample {
            w_is_s: vec(raw.rate.0, self.rate),
            f_is_s: vec(raw.force.0, self.force),
            temperature_c: f32::from(raw.temperature.0) * self.temperature_c + self.temperature_zero_c,
        }
    }
}

/// Which part answered.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Identity {
    /// Product number or WHO_AM_I.
    pub product: u16,
    /// Firmware revision, 0 where the part has none.
    pub revision: u16,
    /// Serial number, 0 where the part has none.
    pub serial: u16,
}

/// An IMU. The order is `reset`, `identify`, `self_test`, `configure`, then `sample` at every
/// data-ready edge.
#[allow(
    async_fn_in_trait,
    reason = "one core, one executor a driver: no future of a driver crosses a thread"
)]
pub trait Imu {
    /// Settings of the part.
    type Config;

    /// Brings the part into its power-on state and waits until it answers.
    ///
    /// Cancellation: safe to repeat. A dropped call may leave the part restarting.
    ///
    /// # Errors
    /// [`Error::Bus`], [`Error::Restarted`] where the part shows that it did not come out of reset.
    async fn reset(&mut self) -> Result<(), Error>;

    /// Checks that the part fitted is the one this driver serves.
    ///
    /// Cancellation: safe to repeat; reads only.
    ///
    /// # Errors
    /// [`Error::WhoAmI`], [`Error::Model`], [`Error::Bus`].
    async fn identify(&mut self) -> Result<Identity, Error>;

    /// Lets the part excite its sensors and judges their response. The unit should stand still;
    /// samples meanwhile are worthless.
    ///
    /// Cancellation: not safe. A dropped call may leave the part in its self-test: `reset` it.
    ///
    /// # Errors
    /// [`Error::SelfTest`] with the sensors that failed, [`Error::Bus`].
    async fn self_test(&mut self) -> Result<(), Error>;

    /// Writes the settings and reads every one of them back.
    ///
    /// Cancellation: not safe. A dropped call leaves some settings written: call it again.
    ///
    /// # Errors
    /// [`Error::Config`] before anything is written, [`Error::Register`] at the first setting that did
    /// not take, [`Error::Bus`].
    async fn configure(&mut self, config: &Self::Config) -> Result<(), Error>;

    /// Reads the latest sample in one transaction. The time of the sample is that of the data-ready
    /// edge, which the caller takes.
    ///
    /// Cancellation: a dropped call loses the sample and its status flags, nothing else.
    ///
    /// # Errors
    /// [`Error::Header`], [`Error::Crc`], [`Error::Silent`], [`Error::Invalid`], [`Error::Restarted`],
    /// [`Error::Bus`]. Saturation and the part's own flags are no errors: they come with the sample.
    async fn sample(&mut self) -> Result<RawSample, Error>;

    /// Counts to SI in the present configuration.
    fn scale(&self) -> Scale;

    /// Nominal time from one sample to the next in the present configuration, s.
    fn period(&self) -> f32;

    /// How long before its data-ready edge the interval ended that a sample is the mean of, in the present configuration,
    /// µs: what the part's filters delay beyond the half period of that mean.
    fn delay_us(&self) -> u32;

    /// Samples of the part's own that make one that it puts out, in the present configuration, where its counter may
    /// count either: see [`learn`](crate::sequence::SampleTracker::learn). One where that is no question.
    fn base_samples(&self) -> NonZeroU16 {
        NonZeroU16::MIN
    }
}

#[cfg(test)]
mod tests {
    use std::string::ToString;

    use super::*;

    #[test]
    fn channels_name_themselves() {
        assert_eq!(Channels::NONE.to_string(), "no sensor");
        assert_eq!(
            (Channels::RATE_Z | Channels::FORCE_X).to_string(),
            "gyro z, accelerometer x"
        );
        assert_eq!(Channels::from_bits(0xFF), Channels::ALL);
    }

    #[test]
    fn counts_become_si() {
        let raw = RawSample {
            rate: RateCounts([1, -2, 3]),
            force: ForceCounts([-4, 5, 6]),
            temperature: TemperatureCounts(-8),
            sequence: Sequence::Fresh(true),
            status: Status::default(),
        };
        let scale = Scale {
            rate: 0.5,
            force: 0.25,
            temperature_c: 0.125,
            temperature_zero_c: 25.0,
        };
        let si = scale.si(&raw);
        assert_eq!(si.w_is_s.to_array(), [0.5, -1.0, 1.5]);
        assert_eq!(si.f_is_s.to_array(), [-1.0, 1.25, 1.5]);
        assert_eq!(si.temperature_c, 24.0);
        let (dtheta_s, dv_s) = si.increments(0.5);
        assert_eq!(dtheta_s.to_array(), [0.25, -0.5, 0.75]);
        assert_eq!(dv_s.to_array(), [-0.5, 0.625, 0.75]);
    }
}
