//! The driver of the ICM-42688-P against rigless's model of that part, which nobody of this project wrote: it was made
//! from the datasheet, for other firmware. The host's driver is the target's, byte for byte on the bus.
//!
//! That model has no interrupt pin, no excitation for a self-test, no trimmed offsets and no noise; it measures in
//! steps of 0.001 °/s and 1 µg, where the driver's finest range resolves 0.00095 °/s and 61 µg.
#![allow(clippy::unwrap_used, reason = "tests")]

use drivers::icm42688::{Config, ForceRange, Icm42688 as Driver, Rate, RateRange, WHO_AM_I};
use drivers::{Error, Imu as _, Sequence};
use embassy_futures::block_on;
use frames::units::{DEG, STANDARD_GRAVITY};
use hal_sim::device::{Bench, BenchDelay, BenchSpi, SpiTarget};
use rigless::chip::Timeline;
use rigless::chip::icm42688p::Icm42688p;
use rigless::chip::spi::Peer as _;
use rigless::mcu::Mcu as _;
use rigless::soc::stm32f427::Stm32f427;
use rigless::time::VirtualNanos;

/// The chip on a bench. A chip of rigless is called with the time line of a controller; the one of a part that does
/// nothing else lends it.
struct Chip {
    chip: Icm42688p,
    part: Stm32f427,
    slot: usize,
}

impl Chip {
    fn new() -> Self {
        let part = Stm32f427::new().unwrap();
        let slot = part.bus().slot("SPI1").unwrap();
        Self {
            chip: Icm42688p::new(),
            part,
            slot,
        }
    }
}

impl SpiTarget for Chip {
    fn transfer(&mut self, now_us: u64, mosi: &[u8], miso: &mut [u8]) {
        let (_, mut context) = self.part.bus_mut().drive(VirtualNanos(now_us * 1000), self.slot);
        let mut timeline = Timeline::new(&mut context);
        self.chip.select(&mut timeline);
        for (sent, reply) in mosi.iter().zip(miso) {
            *reply = self.chip.transfer(u32::from(*sent), 8, &mut timeline) as u8;
        }
        self.chip.deselect(&mut timeline);
    }
}

type Pair = (Bench<Chip>, Driver<BenchSpi<Chip>, BenchDelay>);

fn started(config: &Config) -> Pair {
    let bench = Bench::new(Chip::new(), 5_250_000);
    let mut imu = Driver::new(bench.spi(), bench.delay());
    // A part that has got its supply a while ago.
    bench.advance_to_us(10_000);
    block_on(async {
        imu.reset().await.unwrap();
        let identity = imu.identify().await.unwrap();
        assert_eq!(identity.product, u16::from(WHO_AM_I));
        imu.configure(config).await.unwrap();
    });
    (bench, imu)
}

#[test]
fn samples_are_what_the_chip_measures() {
    let ranges = [
        (RateRange::Dps31, ForceRange::G2),
        (RateRange::Dps62, ForceRange::G4),
        (RateRange::Dps250, ForceRange::G8),
        (RateRange::Dps2000, ForceRange::G16),
    ];
    for (rate_range, force_range) in ranges {
        let config = Config {
            rate_range,
            force_range,
            ..Config::default()
        };
        let (bench, mut imu) = started(&config);
        for (rate, force) in [
            ([20_000, -4_178, 15], [0, 0, 1_000_000]),
            ([-20_000, 9_000, -1], [-150_000, 700_000, -980_665]),
        ] {
            bench.with(|chip| {
                chip.chip.set_rate(rate[0], rate[1], rate[2]);
                chip.chip.set_acceleration(force[0], force[1], force[2]);
                chip.chip.set_temperature(3_150);
            });
            bench.advance_to_us(bench.now_us() + 50_000);
            let si = imu.scale().si(&block_on(imu.sample()).unwrap());
            for axis in 0..3 {
                let (w, f) = (
                    f64::from(si.w_is_s.to_array()[axis]),
                    f64::from(si.f_is_s.to_array()[axis]),
                );
                let (w_true, f_true) = (
                    f64::from(rate[axis]) * 1e-3 * DEG,
                    f64::from(force[axis]) * 1e-6 * STANDARD_GRAVITY,
                );
                // Half a count of the driver's range, and what single precision leaves.
                let (half_w, half_f) = (0.5 * rate_range.per_count(), 0.5 * force_range.per_count());
                assert!(
                    (w - w_true).abs() <= half_w * 1.001,
                    "{rate_range:?} {axis}: {w} {w_true}"
                );
                assert!(
                    (f - f_true).abs() <= half_f * 1.001,
                    "{force_range:?} {axis}: {f} {f_true}"
                );
            }
            assert!((f64::from(si.temperature_c) - 31.5).abs() < 0.01);
        }
    }
}

#[test]
fn samples_come_at_the_rate_and_tell_whether_they_are_new() {
    for rate in [Rate::Hz200, Rate::Hz500, Rate::Hz1000] {
        let config = Config {
            rate,
            ..Config::default()
        };
        let (bench, mut imu) = started(&config);
        let period = u64::from(rate.period_us());
        bench.advance_to_us(bench.now_us() + 100_000);
        block_on(imu.sample()).unwrap();
        // Looked at four times a period: one look in four finds a new sample.
        let mut fresh = 0;
        for _ in 0..400 {
            bench.advance_to_us(bench.now_us() + period / 4 - 30);
            let before = bench.now_us();
            if block_on(imu.sample()).unwrap().sequence == Sequence::Fresh(true) {
                fresh += 1;
            }
            // What the transfer took is part of the quarter.
            bench.advance_to_us(before + 30);
        }
        assert!((99..=101).contains(&fresh), "{rate:?}: {fresh}");
    }
}

/// INT_STATUS comes with each sample: a part that has lost its settings is seen at once.
#[test]
fn a_reset_behind_the_drivers_back_is_seen() {
    let (bench, mut imu) = started(&Config::default());
    bench.advance_to_us(bench.now_us() + 50_000);
    let raw = block_on(imu.sample()).unwrap();
    assert!(raw.status.is_good(), "{:?}", raw.status);
    bench.with(|chip| chip.chip = Icm42688p::new());
    bench.advance_to_us(bench.now_us() + 50_000);
    let found = block_on(imu.sample());
    assert!(found.map_or(true, |raw| !raw.status.is_good()), "{found:?}");
}

/// The model answers no excitation: the driver must not take that for a sound part.
#[test]
fn a_part_that_does_not_answer_its_self_test_fails_it() {
    let (_bench, mut imu) = started(&Config::default());
    assert!(matches!(block_on(imu.self_test()), Err(Error::SelfTest { .. })));
}
