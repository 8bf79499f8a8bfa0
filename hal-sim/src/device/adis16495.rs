//! ADIS16495-1 at its registers. See [`drivers::adis16495`] for protocol, figures and their sources.
//!
//! Modelled: pages; the reply in the next frame; byte-wise writes that take effect with the high byte;
//! stall between frames; bursts with one or two identifiers by the bus clock; CRC; decimation; DATA_CNT;
//! data-ready; power-up, software reset and self-test in time; flags that clear when read.
//!
//! Not modelled: the FIR filters (the setting is kept, no more), what the sensors' bandwidth does beyond a delay, bias and scale registers, flash.

use drivers::adis16495::{
    BASE_RATE_HZ, BURST_COMMAND, BURST_ID, BURST_MAX_HZ, BURST_WORDS, DELAY_US, FORCE_PER_COUNT, FORCE_RANGE_COUNTS,
    POWER_UP_MS, PRODUCT, RANGE_125_DPS, RATE_PER_COUNT, RATE_RANGE_COUNTS, RESET_MS, Register, SELF_TEST_MS,
    TEMPERATURE_PER_COUNT_C, TEMPERATURE_ZERO_C, TWO_IDS_ABOVE_HZ, WRITE, burst_crc, command, function, register,
};
use drivers::{Channels, SystemFlags};

use super::{ImuFaults, Motion, SampleClock, SensorModel, SpiTarget, quantise};

/// Pause that the part wants between two frames, ns: its own figure, whatever the driver's is.
const STALL_NS: u64 = 5_000;
/// Pages of settings kept; page 3 is the one in use.
const SETTINGS_PAGE: u8 = 3;
/// Serial number of the model.
const SERIAL: u16 = 0x0495;
/// Firmware revision of the model.
const REVISION: u16 = 0x0100;

/// The model.
#[derive(Debug, Clone)]
pub struct Adis16495 {
    /// Faults to inject.
    pub faults: ImuFaults,
    /// DATA_CNT counts base samples, DEC_RATE + 1 for one that is put out, and not those. Which a part does is not known.
    pub counts_base_samples: bool,
    clock_hz: u32,
    page: u8,
    reply: u16,
    low_byte: Option<(u8, u8)>,
    settings: [u16; 64],
    /// End of the last frame, ns. Frames closer than the stall are a fault of the driver.
    frame_end_ns: u64,
    stall_violations: u32,
    ready_from_us: u64,
    self_test_end_us: Option<u64>,
    samples: SampleClock,
    motion: Motion,
    /// The twelve data words of a burst, low first.
    data: [u16; 12],
    temperature: u16,
    counter: u16,
    flags: u16,
    diagnosis: u16,
    edges: u32,
}

impl Adis16495 {
    /// A part that gets its supply at `now_us`, on a bus of `clock_hz`.
    pub fn new(now_us: u64, clock_hz: u32) -> Self {
        let mut part = Self {
            faults: ImuFaults::default(),
            counts_base_samples: false,
            clock_hz: clock_hz.max(1),
            page: 0,
            reply: 0,
            low_byte: None,
            settings: [0; 64],
            frame_end_ns: 0,
            stall_violations: 0,
            ready_from_us: 0,
            self_test_end_us: None,
            samples: SampleClock::new(0, 1, u64::from(BASE_RATE_HZ)),
            motion: Motion::default(),
            data: [0; 12],
            temperature: 0,
            counter: 0,
            flags: 0,
            diagnosis: 0,
            edges: 0,
        };
        part.restart(now_us + u64::from(POWER_UP_MS) * 1000);
        part
    }

    /// Frames that came before the stall was over; the part answered them with nothing.
    pub fn stall_violations(&self) -> u32 {
        self.stall_violations
    }

    /// Power-on values, alive from `ready_us`.
    fn restart(&mut self, ready_us: u64) {
        self.page = 0;
        self.reply = 0;
        self.low_byte = None;
        self.settings = [0; 64];
        *self.setting(register::FNCTIO_CTRL) = 0x000D;
        *self.setting(register::CONFIG) = 0x00C0;
        *self.setting(register::NULL_CNFG) = 0x070A;
        *self.setting(register::RANG_MDL) = RANGE_125_DPS;
        *self.setting(register::FIRM_REV) = REVISION;
        self.ready_from_us = ready_us;
        self.self_test_end_us = None;
        self.samples = SampleClock::new(ready_us, 1, u64::from(BASE_RATE_HZ));
        self.data = [0; 12];
        self.counter = 0;
        self.flags = 0;
        self.diagnosis = 0;
    }

    fn setting(&mut self, register: Register) -> &mut u16 {
        &mut self.settings[usize::from(register.address / 2) % 64]
    }

    fn latch(&mut self) {
        let saturated = |k: usize, bits: Channels| bits.bits() & (1 << k) != 0;
        if !self.faults.stuck_data {
            for axis in 0..3 {
                let rate = quantise(self.motion.rate[axis], RATE_PER_COUNT, RATE_RANGE_COUNTS);
                let force = quantise(self.motion.force[axis], FORCE_PER_COUNT, FORCE_RANGE_COUNTS);
                let rate = if saturated(axis, self.faults.saturated) {
                    RATE_RANGE_COUNTS
                } else {
                    rate
                };
                let force = if saturated(axis + 3, self.faults.saturated) {
                    FORCE_RANGE_COUNTS
                } else {
                    force
                };
                for (word, counts) in [(2 * axis, rate), (6 + 2 * axis, force)] {
                    self.data[word] = counts as u16;
                    self.data[word + 1] = (counts >> 16) as u16;
                }
            }
            let temperature_c = self.faults.temperature_c.unwrap_or(self.motion.temperature_c);
            self.temperature = quantise(
                temperature_c - TEMPERATURE_ZERO_C,
                TEMPERATURE_PER_COUNT_C,
                i32::from(i16::MAX),
            ) as u16;
        }
        if !self.faults.stuck_counter {
            let gains = if self.counts_base_samples {
                *self.setting(register::DEC_RATE) + 1
            } else {
                1
            };
            self.counter = self.counter.wrapping_add(gains);
        }
        self.flags |= self.faults.flags;
        if self.faults.missed_edges > 0 {
            self.faults.missed_edges -= 1;
        } else if *self.setting(register::FNCTIO_CTRL) & function::DATA_READY != 0 {
            self.edges += 1;
        }
    }

    /// The word at an address of the selected page. Reading the flags clears them.
    fn read(&mut self, address: u8) -> u16 {
        if address == register::PAGE_ID {
            return u16::from(self.page);
        }
        let at = Register::new(self.page, address);
        match at {
            register::DATA_CNT => self.counter,
            register::SYS_E_FLAG => core::mem::take(&mut self.flags),
            register::DIAG_STS => core::mem::take(&mut self.diagnosis),
            register::TEMP_OUT => self.temperature,
            register::PROD_ID => self.faults.identity.unwrap_or(PRODUCT),
            register::SERIAL_NUM => SERIAL,
            Register { page: 0, address } => {
                let first = register::X_GYRO_LOW.address;
                address
                    .checked_sub(first)
                    .and_then(|offset| self.data.get(usize::from(offset / 2)))
                    .copied()
                    .unwrap_or(0)
            }
            Register {
                page: SETTINGS_PAGE, ..
            } => *self.setting(at),
            _ => 0,
        }
    }

    fn write(&mut self, now_us: u64, address: u8, value: u8) {
        if address == register::PAGE_ID {
            self.page = value;
            self.low_byte = None;
            return;
        }
        if self.page != SETTINGS_PAGE {
            return;
        }
        if address.is_multiple_of(2) {
            self.low_byte = Some((address, value));
            return;
        }
        let at = Register::new(SETTINGS_PAGE, address - 1);
        let low = match self.low_byte.take() {
            Some((pending, low)) if pending == at.address => low,
            _ => self.setting(at).to_le_bytes()[0],
        };
        let word = u16::from_le_bytes([low, value]);
        match at {
            register::GLOB_CMD => {
                if word & command::SOFTWARE_RESET != 0 {
                    self.restart(now_us + u64::from(RESET_MS) * 1000);
                } else if word & command::SELF_TEST != 0 {
                    self.self_test_end_us = Some(now_us + u64::from(SELF_TEST_MS) * 1000);
                }
            }
            register::RANG_MDL | register::FIRM_REV => {}
            _ if self.faults.ignores_writes => {}
            register::DEC_RATE => {
                *self.setting(at) = word;
                self.samples = SampleClock::new(now_us, u64::from(word) + 1, u64::from(BASE_RATE_HZ));
            }
            _ => *self.setting(at) = word,
        }
    }

    /// One frame: gives the reply to the one before, takes the next command.
    fn frame(&mut self, now_us: u64, word: [u8; 2]) -> u16 {
        let reply = core::mem::take(&mut self.reply);
        let [address, value] = word;
        if address & WRITE != 0 {
            self.write(now_us, address & !WRITE, value);
        } else {
            self.reply = self.read(address & !1);
        }
        reply
    }

    fn burst(&mut self, miso: &mut [u8]) {
        let mut words = [0_u16; BURST_WORDS];
        words[0] = core::mem::take(&mut self.flags);
        words[1] = self.temperature;
        words[2..14].copy_from_slice(&self.data);
        words[14] = self.counter;
        let mut crc = burst_crc(&words);
        if self.faults.bad_crc > 0 {
            self.faults.bad_crc -= 1;
            crc = !crc;
        }
        let ids = if self.clock_hz > TWO_IDS_ABOVE_HZ { 2 } else { 1 };
        let stream = core::iter::once(core::mem::take(&mut self.reply))
            .chain(core::iter::repeat_n(BURST_ID, ids))
            .chain(words)
            .chain([crc as u16, (crc >> 16) as u16])
            .chain(core::iter::repeat(0));
        for (pair, word) in miso.chunks_exact_mut(2).zip(stream) {
            pair.copy_from_slice(&word.to_be_bytes());
        }
    }
}

impl SpiTarget for Adis16495 {
    fn transfer(&mut self, now_us: u64, mosi: &[u8], miso: &mut [u8]) {
        self.advance(now_us);
        miso.fill(0);
        let start_ns = now_us * 1000;
        // The caller's clock is cut to whole microseconds: give it one.
        let early = start_ns + 1000 < self.frame_end_ns + STALL_NS;
        self.frame_end_ns = start_ns + mosi.len() as u64 * 8_000_000_000 / u64::from(self.clock_hz);
        if now_us < self.ready_from_us {
            // Not alive yet: hears nothing.
        } else if early {
            self.stall_violations += 1;
        } else if !mosi.len().is_multiple_of(2) {
            self.flags |= SystemFlags::COMMUNICATION.bits();
        } else if self.page == 0 && mosi.len() > 2 && mosi.starts_with(&BURST_COMMAND.to_be_bytes()) {
            // Above its limit the part does not keep up: the reply is empty, not merely late.
            if self.clock_hz <= BURST_MAX_HZ {
                self.burst(miso);
            }
        } else {
            for (k, (sent, reply)) in mosi.chunks_exact(2).zip(miso.chunks_exact_mut(2)).enumerate() {
                if k > 0 {
                    // Frames under one chip select have no stall between them.
                    self.stall_violations += 1;
                    break;
                }
                let word = self.frame(now_us, [sent[0], sent[1]]);
                reply.copy_from_slice(&word.to_be_bytes());
            }
        }
        if let Some(level) = self.faults.silent {
            miso.fill(level);
        }
    }
}

impl SensorModel for Adis16495 {
    fn set_motion(&mut self, motion: Motion) {
        self.motion = motion;
    }

    fn advance(&mut self, now_us: u64) {
        if self.self_test_end_us.is_some_and(|end| end <= now_us) {
            self.self_test_end_us = None;
            self.diagnosis = u16::from(self.faults.self_test.bits());
            if self.diagnosis != 0 {
                self.flags |= SystemFlags::SENSOR.bits();
            }
        }
        while self.samples.tick(now_us) {
            self.latch();
        }
    }

    fn delay_us(&self) -> u64 {
        u64::from(DELAY_US)
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
    use drivers::adis16495::{Adis16495 as Driver, Config};
    use drivers::{Error, Imu, Sequence};
    use embassy_futures::block_on;
    use frames::units::{DEG, STANDARD_GRAVITY};

    use super::super::{Bench, BenchDelay, BenchSpi};
    use super::*;

    type Pair = (Bench<Adis16495>, Driver<BenchSpi<Adis16495>, BenchDelay>);

    fn pair(clock_hz: u32) -> Pair {
        let bench = Bench::new(Adis16495::new(0, clock_hz), clock_hz);
        let driver = Driver::new(bench.spi(), bench.delay());
        (bench, driver)
    }

    /// Started as the application starts it.
    fn started(clock_hz: u32) -> Pair {
        let (bench, mut imu) = pair(clock_hz);
        block_on(async {
            imu.reset().await.unwrap();
            imu.identify().await.unwrap();
            imu.self_test().await.unwrap();
            imu.configure(&Config::default()).await.unwrap();
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

    fn wait_for_edge(bench: &Bench<Adis16495>) {
        let next = bench.with(|part| part.next_ready_us());
        bench.advance_to_us(next);
        bench.with(|part| part.advance(next));
    }

    #[test]
    fn the_driver_starts_the_part_and_reads_it_true() {
        for clock_hz in [2_000_000, 5_000_000] {
            let (bench, mut imu) = started(clock_hz);
            bench.with(|part| part.set_motion(motion()));
            wait_for_edge(&bench);
            let mut last = None;
            for _ in 0..500 {
                wait_for_edge(&bench);
                let raw = block_on(imu.sample()).unwrap();
                let Sequence::Counter(now) = raw.sequence else {
                    panic!("no counter");
                };
                assert_eq!(now, last.map_or(now, |c: u16| c.wrapping_add(1)));
                last = Some(now);
                assert!(raw.status.is_good());
                let si = imu.scale().si(&raw);
                for axis in 0..3 {
                    assert!((f64::from(si.w_is_s.to_array()[axis]) - motion().rate[axis]).abs() < 3e-8);
                    assert!((f64::from(si.f_is_s.to_array()[axis]) - motion().force[axis]).abs() < 1e-6);
                }
                assert!((si.temperature_c - 31.0).abs() < 0.01);
            }
            bench.with(|part| assert_eq!(part.stall_violations(), 0));
        }
    }

    #[test]
    fn samples_come_at_the_configured_rate() {
        let (bench, imu) = started(4_000_000);
        let begin = bench.with(|part| {
            part.take_data_ready();
            part.next_ready_us()
        });
        let end = begin + 21 * 1_000_000;
        bench.advance_to_us(end);
        bench.with(|part| part.advance(end));
        // 21 s hold 4250 samples of 21 base periods, and the one at the beginning.
        assert_eq!(bench.with(|part| part.take_data_ready()), 4251);
        assert!((imu.period() - 21.0 / 4250.0).abs() < 1e-9);
    }

    #[test]
    fn a_part_still_starting_is_not_there() {
        let (bench, mut imu) = pair(4_000_000);
        assert_eq!(
            block_on(imu.identify()),
            Err(Error::WhoAmI {
                expected: PRODUCT,
                found: 0
            })
        );
        bench.advance_to_us(u64::from(POWER_UP_MS) * 1000);
        assert!(block_on(imu.identify()).is_ok());
    }

    #[test]
    fn faults_before_the_first_sample() {
        let (bench, mut imu) = pair(4_000_000);
        block_on(imu.reset()).unwrap();
        bench.with(|part| part.faults.identity = Some(16497));
        assert_eq!(
            block_on(imu.identify()),
            Err(Error::WhoAmI {
                expected: PRODUCT,
                found: 16497
            })
        );
        bench.with(|part| part.faults.self_test = Channels::RATE_Y);
        assert_eq!(
            block_on(imu.self_test()),
            Err(Error::SelfTest {
                failed: Channels::RATE_Y
            })
        );
        bench.with(|part| {
            part.faults = ImuFaults {
                ignores_writes: true,
                ..ImuFaults::default()
            };
        });
        assert!(block_on(imu.self_test()).is_ok());
        let config = Config {
            linear_g: false,
            ..Config::default()
        };
        assert_eq!(
            block_on(imu.configure(&config)),
            Err(Error::Register {
                address: register::CONFIG.code(),
                wrote: 0x0040,
                read: 0x00C0
            })
        );
    }

    #[test]
    fn faults_of_samples() {
        let (bench, mut imu) = started(4_000_000);
        bench.with(|part| part.set_motion(motion()));
        let mut next = |fault: &dyn Fn(&mut ImuFaults)| {
            bench.with(|part| fault(&mut part.faults));
            wait_for_edge(&bench);
            block_on(imu.sample())
        };
        next(&|_| {}).unwrap();

        for level in [0xFF, 0x00] {
            assert_eq!(next(&|f| f.silent = Some(level)), Err(Error::Silent { level }));
        }
        next(&|f| f.silent = None).unwrap();

        assert!(matches!(next(&|f| f.bad_crc = 2), Err(Error::Crc { .. })));
        assert!(matches!(next(&|_| {}), Err(Error::Crc { .. })));
        next(&|_| {}).unwrap();

        let before = next(&|f| f.stuck_counter = true).unwrap();
        assert_eq!(next(&|_| {}).unwrap().sequence, before.sequence);
        let before = next(&|f| (f.stuck_counter, f.stuck_data) = (false, true)).unwrap();
        bench.with(|part| part.set_motion(Motion::default()));
        let stuck = next(&|_| {}).unwrap();
        assert_eq!(stuck.rate, before.rate);
        assert_ne!(stuck.sequence, before.sequence);
        assert_ne!(next(&|f| f.stuck_data = false).unwrap().rate, before.rate);

        let raw = next(&|f| f.saturated = Channels::RATE_Z | Channels::FORCE_X).unwrap();
        assert_eq!(raw.status.saturated, Channels::RATE_Z | Channels::FORCE_X);
        let raw = next(&|f| (f.saturated, f.flags) = (Channels::NONE, SystemFlags::OVERRUN.bits())).unwrap();
        assert_eq!(raw.status.system, SystemFlags::OVERRUN);
        // A flag whose cause is gone is gone with the reading.
        assert!(next(&|f| f.flags = 0).unwrap().status.is_good());

        let raw = next(&|f| f.temperature_c = Some(110.0)).unwrap();
        assert!((Driver::new(bench.spi(), bench.delay()).scale().si(&raw).temperature_c - 110.0).abs() < 0.01);
    }

    #[test]
    fn missed_edges_leave_gaps_in_the_count() {
        let (bench, mut imu) = started(4_000_000);
        wait_for_edge(&bench);
        let count = |raw: drivers::RawSample| match raw.sequence {
            Sequence::Counter(c) => c,
            Sequence::Fresh(_) => 0,
        };
        let before = count(block_on(imu.sample()).unwrap());
        bench.with(|part| {
            part.take_data_ready();
            part.faults.missed_edges = 3;
        });
        for _ in 0..4 {
            wait_for_edge(&bench);
        }
        assert_eq!(bench.with(|part| part.take_data_ready()), 1);
        assert_eq!(count(block_on(imu.sample()).unwrap()), before + 4);
    }

    #[test]
    fn range_ends_clamp() {
        let (bench, mut imu) = started(4_000_000);
        bench.with(|part| {
            part.set_motion(Motion {
                rate: [-130.0 * DEG, 0.0, 124.9 * DEG],
                force: [100.0, 0.0, 0.0],
                temperature_c: 25.0,
            });
        });
        wait_for_edge(&bench);
        let raw = block_on(imu.sample()).unwrap();
        assert_eq!(raw.rate.0[0], -RATE_RANGE_COUNTS);
        assert_eq!(raw.status.saturated, Channels::RATE_X | Channels::FORCE_X);
    }

    #[test]
    fn frames_without_stall_are_not_answered() {
        let mut part = Adis16495::new(0, 4_000_000);
        let mut reply = [0; 2];
        let (read, fetch) = ([register::PROD_ID.address, 0], [0, 0]);
        part.transfer(400_000, &read, &mut reply);
        part.transfer(400_005, &fetch, &mut reply);
        assert_eq!((reply, part.stall_violations()), ([0, 0], 1));
        part.transfer(400_100, &read, &mut reply);
        part.transfer(400_109, &fetch, &mut reply);
        assert_eq!((u16::from_be_bytes(reply), part.stall_violations()), (PRODUCT, 1));
    }

    #[test]
    fn a_burst_on_a_bus_too_fast_is_empty() {
        let (bench, mut imu) = started(BURST_MAX_HZ + 1);
        wait_for_edge(&bench);
        assert_eq!(block_on(imu.sample()), Err(Error::Silent { level: 0 }));
    }

    #[test]
    fn a_cut_frame_raises_the_flag() {
        let (bench, mut imu) = started(4_000_000);
        let now = bench.now_us() + 100;
        bench.advance_to_us(now);
        bench.with(|part| part.transfer(now, &[0x7E], &mut [0]));
        bench.advance_to_us(now + 100);
        assert_eq!(block_on(imu.system_flags()), Ok(SystemFlags::COMMUNICATION));
        assert_eq!(block_on(imu.system_flags()), Ok(SystemFlags::NONE));
    }
}
