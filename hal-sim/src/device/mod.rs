//! The devices on the unit's buses, modelled at their registers.
//!
//! Each model is the other end of the wire: it sees the bytes a driver sends and answers with the bytes
//! the part would send, from the same register constants as the driver. It keeps its own time line
//! (power-up, reset, output period, self-test), fed by `now_us` with every call, and is told the physical
//! world by the simulator.
//!
//! An IMU model latches one sample a period. The simulator asks [`SensorModel::next_ready_us`], puts the
//! mean rate and specific force over a period that ended [`SensorModel::delay_us`] earlier into [`SensorModel::set_motion`],
//! errors of the sensors included, calls [`SensorModel::advance`], and raises the data-ready edges it takes from
//! [`SensorModel::take_data_ready`]. What a part averages or filters inside its period is thereby in the
//! simulator's hands, exact and cheap; the models add what lies between sensor and wire: ranges,
//! quantisation, counters, flags, check sums.
//!
//! Faults are public fields. Set one at any instant; it lasts until it is taken back, or for the number
//! of bursts or samples it names.
//!
//! Not modelled: electrical timing below a microsecond, setup and hold times, what a part does when
//! chip select rises inside a byte.

mod adis16495;
mod bench;
pub mod flash;
mod icm42688;
mod mt6835;
pub(crate) mod stream;

pub use adis16495::Adis16495;
pub use bench::{Bench, BenchDelay, BenchSpi};
pub use icm42688::Icm42688;
pub use mt6835::{EncoderFaults, Mt6835};

use drivers::Channels;

/// A device on an SPI bus.
pub trait SpiTarget {
    /// One assertion of chip select that begins at `now_us`: the device sees `mosi` and fills `miso`, of
    /// the same length.
    fn transfer(&mut self, now_us: u64, mosi: &[u8], miso: &mut [u8]);
}

/// What an IMU is exposed to, as mean over one output period, along the part's axes.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Motion {
    /// Angular rate against inertial space, rad/s.
    pub rate: [f64; 3],
    /// Specific force, m/s².
    pub force: [f64; 3],
    /// Temperature of the part, °C.
    pub temperature_c: f64,
}

/// A device that samples motion.
pub trait SensorModel: SpiTarget {
    /// The motion of the samples latched from now on.
    fn set_motion(&mut self, motion: Motion);

    /// Latches every sample due until `now_us`.
    fn advance(&mut self, now_us: u64);

    /// How long before it is latched the interval ended that a sample is the mean of, µs: the delay of the part's filters.
    fn delay_us(&self) -> u64;

    /// When the next sample will be latched, µs.
    fn next_ready_us(&self) -> u64;

    /// The number of data-ready edges since the last call.
    fn take_data_ready(&mut self) -> u32;

    /// Faults to inject.
    fn faults(&mut self) -> &mut ImuFaults;
}

/// Faults of an IMU. The default is a sound part.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct ImuFaults {
    /// Every byte reads this: 0xFF or 0x00 for a broken line. The part still hears.
    pub silent: Option<u8>,
    /// Bursts still to come with a wrong check sum. ADIS16495 only.
    pub bad_crc: u32,
    /// The data stay as they are while samples go on.
    pub stuck_data: bool,
    /// The sample counter, or the data-ready bit, stays as it is.
    pub stuck_counter: bool,
    /// Data-ready edges still to be left out. The samples themselves go on.
    pub missed_edges: u32,
    /// Sensors driven to the positive end of their range.
    pub saturated: Channels,
    /// Bits held in SYS_E_FLAG. ADIS16495 only.
    pub flags: u16,
    /// Another identity: PROD_ID or WHO_AM_I.
    pub identity: Option<u16>,
    /// Sensors that fail the self-test.
    pub self_test: Channels,
    /// Another temperature, °C.
    pub temperature_c: Option<f64>,
    /// Writes to settings are lost.
    pub ignores_writes: bool,
}

/// A clock of samples: a period that is no whole number of microseconds must not drift.
#[derive(Debug, Clone, Copy, PartialEq)]
struct SampleClock {
    start_us: u64,
    taken: u64,
    /// Base periods in a sample, and base periods a second.
    divider: u64,
    base_hz: u64,
}

impl SampleClock {
    fn new(start_us: u64, divider: u64, base_hz: u64) -> Self {
        Self {
            start_us,
            taken: 0,
            divider,
            base_hz,
        }
    }

    fn next_us(&self) -> u64 {
        self.start_us + ((self.taken + 1) * self.divider * 1_000_000).div_ceil(self.base_hz)
    }

    /// Whether a sample is due; counts it if so.
    fn tick(&mut self, now_us: u64) -> bool {
        let due = self.next_us() <= now_us;
        self.taken += u64::from(due);
        due
    }
}

/// The count nearest to `value` in units of `unit`, within ±`limit`; 0 for a NaN.
fn quantise(value: f64, unit: f64, limit: i32) -> i32 {
    (value / unit).round().clamp(-f64::from(limit), f64::from(limit)) as i32
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_clock_does_not_drift() {
        let mut clock = SampleClock::new(1000, 21, 4250);
        let mut last = 1000;
        // 21 × 850 base periods are 4.2 s.
        for _ in 0..850 {
            let next = clock.next_us();
            assert!((4941..=4942).contains(&(next - last)));
            assert!(!clock.tick(next - 1) && clock.tick(next));
            last = next;
        }
        assert_eq!(last, 1000 + 4_200_000);
    }

    #[test]
    fn counts_are_clamped() {
        assert_eq!(quantise(1.26, 0.5, 10), 3);
        assert_eq!(quantise(-99.0, 0.5, 10), -10);
        assert_eq!(quantise(f64::INFINITY, 0.5, 10), 10);
        assert_eq!(quantise(f64::NAN, 0.5, 10), 0);
    }
}
