//! ICM-42688-P at its registers. See [`drivers::icm42688`] for protocol, figures and their sources.
//!
//! Modelled: banks; address that counts up; reset and its event; power modes with the time the sensors
//! take to start; until then the marker of invalid data after a reset, and the last sample after a pause;
//! ranges, which end at −32766 and +32767, rates and quantisation; the data-ready bit that reading clears, and the line with the conditions under which it works; the response to
//! self-test.
//!
//! Not modelled: FIFO, filters but for their delay at the settings of the driver, AFSR, low-power modes.

use drivers::icm42688::{
    DATA_LEN, DATA_READY_ON_INT1, ForceRange, INVALID, LOWEST, READ, Rate, RateRange, Register, SOFT_RESET, START_MS,
    TEMPERATURE_PER_COUNT_C, TEMPERATURE_ZERO_C, WHO_AM_I, event, register,
};
use frames::units::{DEG, STANDARD_GRAVITY};

use super::{ImuFaults, Motion, SampleClock, SensorModel, SpiTarget, quantise};

const BANKS: usize = 5;
/// Reset takes this long, µs.
const RESET_US: u64 = 1000;
/// Accelerometers start in this time, µs.
const FORCE_START_US: u64 = 10_000;
/// Response of a sound gyroscope to self-test, rad/s: twice the least.
const EXCITED_RATE: f64 = 120.0 * DEG;
/// Response of a sound accelerometer to self-test, m/s².
const EXCITED_FORCE: f64 = 0.5 * STANDARD_GRAVITY;
/// Samples a second of the fastest rate offered; the others are whole fractions.
const BASE_HZ: u64 = 1000;
/// INT_CONFIG1: with this bit the INT lines do not work.
const INT_ASYNC_RESET: u8 = 1 << 4;

/// The model.
#[derive(Debug, Clone)]
pub struct Icm42688 {
    /// Faults to inject.
    pub faults: ImuFaults,
    banks: [[u8; 128]; BANKS],
    bank: u8,
    ready_from_us: u64,
    rate_from_us: Option<u64>,
    force_from_us: Option<u64>,
    samples: SampleClock,
    rate: Rate,
    motion: Motion,
    edges: u32,
}

impl Icm42688 {
    /// A part that gets its supply at `now_us`.
    pub fn new(now_us: u64) -> Self {
        let mut part = Self {
            faults: ImuFaults::default(),
            banks: [[0; 128]; BANKS],
            bank: 0,
            ready_from_us: 0,
            rate_from_us: None,
            force_from_us: None,
            samples: SampleClock::new(0, 1, BASE_HZ),
            rate: Rate::Hz1000,
            motion: Motion::default(),
            edges: 0,
        };
        part.restart(now_us);
        part
    }

    /// Resets the part as a dip of its supply would.
    pub fn brown_out(&mut self, now_us: u64) {
        self.restart(now_us);
    }

    fn restart(&mut self, now_us: u64) {
        self.banks = [[0; 128]; BANKS];
        self.bank = 0;
        self.ready_from_us = now_us + RESET_US;
        self.rate_from_us = None;
        self.force_from_us = None;
        self.samples = SampleClock::new(self.ready_from_us, 1, BASE_HZ);
        self.rate = Rate::Hz1000;
        for (register, value) in [
            (register::DRIVE_CONFIG, 0x05),
            (register::INTF_CONFIG0, 0x30),
            (register::INTF_CONFIG1, 0x91),
            (register::GYRO_CONFIG0, 0x06),
            (register::ACCEL_CONFIG0, 0x06),
            (register::GYRO_ACCEL_CONFIG0, 0x11),
            (register::INT_CONFIG1, INT_ASYNC_RESET),
            (register::INT_SOURCE0, 0x10),
            (register::INT_STATUS, event::RESET_DONE),
        ] {
            *self.at(register) = value;
        }
        self.store(&[INVALID; 7]);
    }

    fn at(&mut self, register: Register) -> &mut u8 {
        &mut self.banks[usize::from(register.bank) % BANKS][usize::from(register.address) % 128]
    }

    /// Temperature, accelerometers, gyroscopes.
    fn store(&mut self, words: &[i16; 7]) {
        let first = usize::from(register::TEMP_DATA1.address);
        let registers = &mut self.banks[0][first..first + DATA_LEN];
        for (pair, word) in registers.chunks_exact_mut(2).zip(words) {
            pair.copy_from_slice(&word.to_be_bytes());
        }
    }

    /// What the registers hold, in the order of [`store`](Self::store).
    fn words(&self) -> [i16; 7] {
        let first = usize::from(register::TEMP_DATA1.address);
        core::array::from_fn(|k| {
            let at = first + 2 * k;
            i16::from_be_bytes([self.banks[0][at], self.banks[0][at + 1]])
        })
    }

    fn latch(&mut self, now_us: u64) {
        let rate_unit = RateRange::from_code(*self.at(register::GYRO_CONFIG0) >> 5).per_count();
        let force_unit = ForceRange::from_code(*self.at(register::ACCEL_CONFIG0) >> 5).per_count();
        let excited = *self.at(register::SELF_TEST_CONFIG);
        let failing = self.faults.self_test.bits();
        let saturated = self.faults.saturated.bits();
        let started = |from: Option<u64>| from.is_some_and(|from| from <= now_us);
        if !(started(self.rate_from_us) || started(self.force_from_us)) {
            return;
        }
        if !self.faults.stuck_data {
            let temperature_c = self.faults.temperature_c.unwrap_or(self.motion.temperature_c);
            let limit = i32::from(i16::MAX);
            let mut words = self.words();
            words[0] = quantise(temperature_c - TEMPERATURE_ZERO_C, TEMPERATURE_PER_COUNT_C, limit) as i16;
            for axis in 0..3 {
                let sensors = [
                    (axis, 4, self.motion.rate, rate_unit, EXCITED_RATE, self.rate_from_us),
                    (
                        axis + 3,
                        1,
                        self.motion.force,
                        force_unit,
                        EXCITED_FORCE,
                        self.force_from_us,
                    ),
                ];
                for (channel, first, motion, unit, response, from) in sensors {
                    let bit = 1_u8 << channel;
                    let response = if excited & bit != 0 && failing & bit == 0 {
                        response
                    } else {
                        0.0
                    };
                    // What has not started leaves what is there: the last sample of before, or the marker.
                    if !started(from) {
                        continue;
                    }
                    words[first + axis] = if saturated & bit != 0 {
                        i16::MAX
                    } else {
                        quantise(motion[axis] + response, unit, limit).max(i32::from(LOWEST)) as i16
                    };
                }
            }
            self.store(&words);
        }
        if !self.faults.stuck_counter {
            *self.at(register::INT_STATUS) |= event::DATA_READY;
        }
        let routed = *self.at(register::INT_SOURCE0) & DATA_READY_ON_INT1 != 0
            && *self.at(register::INT_CONFIG1) & INT_ASYNC_RESET == 0;
        if self.faults.missed_edges > 0 {
            self.faults.missed_edges -= 1;
        } else if routed {
            self.edges += 1;
        }
    }

    fn read(&mut self, address: u8) -> u8 {
        let at = Register::new(self.bank, address);
        match at {
            _ if address == register::BANK_SELECT => self.bank,
            register::WHO_AM_I => self.faults.identity.map_or(WHO_AM_I, |id| id.to_le_bytes()[0]),
            register::INT_STATUS => core::mem::take(self.at(at)),
            _ => *self.at(at),
        }
    }

    fn write(&mut self, now_us: u64, address: u8, value: u8) {
        if address == register::BANK_SELECT {
            self.bank = value & 0b111;
            return;
        }
        let at = Register::new(self.bank, address);
        match at {
            register::DEVICE_CONFIG if value & SOFT_RESET != 0 => self.restart(now_us),
            register::WHO_AM_I | register::INT_STATUS => {}
            _ if self.faults.ignores_writes => {}
            register::PWR_MGMT0 => {
                let power = |on: bool, from: Option<u64>, takes: u64| on.then(|| from.unwrap_or(now_us + takes));
                self.rate_from_us = power(value & 0b1100 == 0b1100, self.rate_from_us, u64::from(START_MS) * 1000);
                self.force_from_us = power(value & 0b0011 == 0b0011, self.force_from_us, FORCE_START_US);
                *self.at(at) = value;
                self.restart_clock(now_us);
            }
            register::GYRO_CONFIG0 => {
                *self.at(at) = value;
                self.restart_clock(now_us);
            }
            _ => *self.at(at) = value,
        }
    }

    fn restart_clock(&mut self, now_us: u64) {
        self.rate = Rate::from_code(*self.at(register::GYRO_CONFIG0)).unwrap_or(Rate::Hz1000);
        self.samples = SampleClock::new(now_us, u64::from(self.rate.period_us()) / 1000, BASE_HZ);
    }
}

impl SpiTarget for Icm42688 {
    fn transfer(&mut self, now_us: u64, mosi: &[u8], miso: &mut [u8]) {
        self.advance(now_us);
        miso.fill(0);
        if let ([command, data @ ..], [_, replies @ ..]) = (mosi, &mut *miso)
            && now_us >= self.ready_from_us
        {
            let mut address = command & !READ;
            for (sent, reply) in data.iter().zip(replies) {
                if command & READ != 0 {
                    *reply = self.read(address);
                } else {
                    self.write(now_us, address, *sent);
                }
                address = (address + 1) & !READ;
            }
        }
        if let Some(level) = self.faults.silent {
            miso.fill(level);
        }
    }
}

impl SensorModel for Icm42688 {
    fn set_motion(&mut self, motion: Motion) {
        self.motion = motion;
    }

    fn advance(&mut self, now_us: u64) {
        loop {
            let due = self.samples.next_us();
            if !self.samples.tick(now_us) {
                break;
            }
            self.latch(due);
        }
    }

    fn delay_us(&self) -> u64 {
        u64::from(self.rate.delay_us())
    }

    fn next_ready_us(&self) -> u64 {
        self.samples.next_us()
    }

    fn take_data_ready(&mut self) -> u32 {
        core::mem::take(&mut self.edges)
    }

    fn faults(&mut self) -> &mut ImuFaults {
        &mut self.faults
    }
}

#[cfg(test)]
mod tests {
    use drivers::icm42688::{Config, Icm42688 as Driver};
    use drivers::{Channels, Error, Imu, Sequence};
    use embassy_futures::block_on;

    use super::super::{Bench, BenchDelay, BenchSpi};
    use super::*;

    type Pair = (Bench<Icm42688>, Driver<BenchSpi<Icm42688>, BenchDelay>);

    fn pair() -> Pair {
        let bench = Bench::new(Icm42688::new(0), 10_000_000);
        bench.advance_to_us(5_000);
        let driver = Driver::new(bench.spi(), bench.delay());
        (bench, driver)
    }

    fn started(config: &Config) -> Pair {
        let (bench, mut imu) = pair();
        block_on(async {
            imu.reset().await.unwrap();
            imu.identify().await.unwrap();
            imu.self_test().await.unwrap();
            imu.configure(config).await.unwrap();
        });
        (bench, imu)
    }

    fn motion() -> Motion {
        Motion {
            rate: [0.001, -0.02, 20.0 * DEG],
            force: [0.3, -0.4, STANDARD_GRAVITY],
            temperature_c: 31.0,
        }
    }

    fn wait_for_edge(bench: &Bench<Icm42688>) {
        let next = bench.with(|part| part.next_ready_us());
        bench.advance_to_us(next);
        bench.with(|part| part.advance(next));
    }

    #[test]
    fn the_driver_starts_the_part_and_reads_it_true() {
        for rate in [Rate::Hz200, Rate::Hz500, Rate::Hz1000] {
            let config = Config {
                rate,
                ..Config::default()
            };
            let (bench, mut imu) = started(&config);
            bench.with(|part| {
                part.set_motion(motion());
                part.take_data_ready();
            });
            let begin = bench.now_us();
            assert_eq!(bench.with(|part| part.delay_us()), u64::from(imu.delay_us()));
            for _ in 0..100 {
                wait_for_edge(&bench);
                let raw = block_on(imu.sample()).unwrap();
                assert_eq!(raw.sequence, Sequence::Fresh(true));
                assert!(raw.status.is_good());
                let si = imu.scale().si(&raw);
                for axis in 0..3 {
                    // Half a count: 1/2097 °/s, 1/32768 g.
                    assert!((f64::from(si.w_is_s.to_array()[axis]) - motion().rate[axis]).abs() < 8.4e-6);
                    assert!((f64::from(si.f_is_s.to_array()[axis]) - motion().force[axis]).abs() < 3.1e-4);
                }
                assert!((si.temperature_c - 31.0).abs() < 0.01);
                // At once again: the same sample, and it says so.
                assert_eq!(block_on(imu.sample()).unwrap().sequence, Sequence::Fresh(false));
            }
            assert_eq!(bench.with(|part| part.take_data_ready()), 100);
            let took = bench.now_us() - begin;
            let period = u64::from(rate.period_us());
            assert!(took > 99 * period && took <= 101 * period, "{took}");
        }
    }

    #[test]
    fn faults_before_the_first_sample() {
        let (bench, mut imu) = pair();
        bench.with(|part| part.faults.identity = Some(0x44));
        assert_eq!(
            block_on(imu.identify()),
            Err(Error::WhoAmI {
                expected: 0x47,
                found: 0x44
            })
        );
        bench.with(|part| part.faults.self_test = Channels::RATE_X | Channels::FORCE_Z);
        assert_eq!(
            block_on(imu.self_test()),
            Err(Error::SelfTest {
                failed: Channels::RATE_X | Channels::FORCE_Z
            })
        );
        bench.with(|part| {
            part.faults = ImuFaults {
                ignores_writes: true,
                ..ImuFaults::default()
            };
        });
        block_on(imu.reset()).unwrap();
        assert!(matches!(
            block_on(imu.configure(&Config::default())),
            Err(Error::Register { .. })
        ));
    }

    #[test]
    fn faults_of_samples() {
        let (bench, mut imu) = started(&Config::default());
        bench.with(|part| part.set_motion(motion()));
        let mut next = |fault: &dyn Fn(&mut ImuFaults)| {
            bench.with(|part| fault(&mut part.faults));
            wait_for_edge(&bench);
            block_on(imu.sample())
        };
        let good = next(&|_| {}).unwrap();
        for level in [0xFF, 0x00] {
            assert_eq!(next(&|f| f.silent = Some(level)), Err(Error::Silent { level }));
        }
        next(&|f| f.silent = None).unwrap();
        assert_eq!(
            next(&|f| f.stuck_counter = true).unwrap().sequence,
            Sequence::Fresh(false)
        );
        bench.with(|part| part.set_motion(Motion::default()));
        let stuck = next(&|f| (f.stuck_counter, f.stuck_data) = (false, true)).unwrap();
        assert_eq!((stuck.rate, stuck.sequence), (good.rate, Sequence::Fresh(true)));
        let raw = next(&|f| (f.stuck_data, f.saturated) = (false, Channels::RATE_Y)).unwrap();
        assert_eq!(raw.status.saturated, Channels::RATE_Y);
        let raw = next(&|f| f.temperature_c = Some(90.0)).unwrap();
        assert!((Driver::new(bench.spi(), bench.delay()).scale().si(&raw).temperature_c - 90.0).abs() < 0.01);
    }

    #[test]
    fn a_brown_out_is_seen_and_survived() {
        let (bench, mut imu) = started(&Config::default());
        wait_for_edge(&bench);
        block_on(imu.sample()).unwrap();
        let now = bench.now_us();
        bench.with(|part| part.brown_out(now));
        bench.advance_to_us(now + 5_000);
        assert_eq!(block_on(imu.sample()), Err(Error::Restarted { status: 0x10 }));
        assert_eq!(
            block_on(imu.sample()),
            Err(Error::Invalid {
                channels: Channels::ALL
            })
        );
        block_on(imu.configure(&Config::default())).unwrap();
        wait_for_edge(&bench);
        block_on(imu.sample()).unwrap();
    }

    #[test]
    fn clipping_is_seen_at_both_ends() {
        let (bench, mut imu) = started(&Config::default());
        for sign in [1.0, -1.0] {
            bench.with(|part| {
                part.set_motion(Motion {
                    rate: [0.0, 0.0, sign * 40.0 * DEG],
                    force: [0.0, sign * 3.0 * STANDARD_GRAVITY, 0.0],
                    temperature_c: 25.0,
                });
            });
            wait_for_edge(&bench);
            let raw = block_on(imu.sample()).unwrap();
            assert_eq!(raw.status.saturated, Channels::RATE_Z | Channels::FORCE_Y);
            assert_eq!(raw.rate.0[2], if sign > 0.0 { 32767 } else { -32766 });
        }
    }

    #[test]
    fn after_a_pause_the_registers_hold_what_was() {
        let (bench, mut imu) = started(&Config::default());
        bench.with(|part| part.set_motion(motion()));
        wait_for_edge(&bench);
        let before = block_on(imu.sample()).unwrap();
        bench.with(|part| part.set_motion(Motion::default()));
        block_on(imu.write(register::PWR_MGMT0, 0)).unwrap();
        block_on(imu.write(register::PWR_MGMT0, 0x0F)).unwrap();
        bench.advance_to_us(bench.now_us() + 20_000);
        // Nothing marks it.
        assert_eq!(block_on(imu.sample()).unwrap().rate, before.rate);
        // The driver waits for longer than the part takes.
        block_on(imu.configure(&Config::default())).unwrap();
        wait_for_edge(&bench);
        assert_eq!(block_on(imu.sample()).unwrap().rate.0, [0; 3]);
    }

    #[test]
    fn data_before_the_gyroscopes_have_started_are_marked() {
        let (bench, mut imu) = pair();
        block_on(imu.reset()).unwrap();
        block_on(imu.write(register::PWR_MGMT0, 0x0F)).unwrap();
        bench.advance_to_us(bench.now_us() + 15_000);
        assert_eq!(
            block_on(imu.sample()),
            Err(Error::Invalid {
                channels: Channels::RATE_X | Channels::RATE_Y | Channels::RATE_Z
            })
        );
        bench.advance_to_us(bench.now_us() + 20_000);
        assert!(block_on(imu.sample()).is_ok());
    }
}
