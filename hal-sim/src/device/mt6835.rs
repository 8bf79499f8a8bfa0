//! MT6835 at its registers. See [`drivers::mt6835`] for protocol, figures and their sources.
//!
//! Modelled: register reads, writes that are answered by nothing, the angle burst with warnings and CRC, direction of
//! rotation, an error made of harmonics.
//!
//! Not modelled: bandwidth and delay of the part, noise (the simulator puts it into the angle), the
//! EEPROM, the part's own calibration.

use core::f64::consts::TAU;

use drivers::mt6835::{AngleCounts, COUNTS_PER_TURN, Reading, Warnings, burst, operation, register};

use super::SpiTarget;

/// Faults of the encoder. The default is a sound part.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct EncoderFaults {
    /// Every byte reads this: 0xFF or 0x00 for a broken line. The part still hears.
    pub silent: Option<u8>,
    /// Angle bursts still to come with a wrong check sum.
    pub bad_crc: u32,
    /// The angle stays where it was last read.
    pub frozen: bool,
    /// Warnings sent with every angle.
    pub warnings: Warnings,
    /// Writes are lost.
    pub ignores_writes: bool,
}

/// The model.
#[derive(Debug, Clone)]
pub struct Mt6835 {
    /// Faults to inject.
    pub faults: EncoderFaults,
    registers: [u8; 0x120],
    angle: f64,
    harmonics: Vec<(u16, f64, f64)>,
    sent: AngleCounts,
}

impl Default for Mt6835 {
    fn default() -> Self {
        Self::new()
    }
}

impl Mt6835 {
    /// A part with its supply on, at angle 0.
    pub fn new() -> Self {
        let mut registers = [0; 0x120];
        registers[usize::from(register::DIRECTION_HYSTERESIS)] = 7;
        registers[usize::from(register::BANDWIDTH)] = 5;
        Self {
            faults: EncoderFaults::default(),
            registers,
            angle: 0.0,
            harmonics: Vec::new(),
            sent: AngleCounts::default(),
        }
    }

    /// The shaft's true angle, rad, of any number of turns.
    pub fn set_angle(&mut self, angle: f64) {
        self.angle = angle;
    }

    /// The part's error as (order, amplitude in rad, phase in rad), a function of the reading as in
    /// [`drivers::harmonics`].
    pub fn set_harmonics(&mut self, harmonics: Vec<(u16, f64, f64)>) {
        self.harmonics = harmonics;
    }

    fn reading(&self) -> AngleCounts {
        let reversed = self.registers[usize::from(register::DIRECTION_HYSTERESIS)] & (1 << 3) != 0;
        let angle = if reversed { -self.angle } else { self.angle };
        // reading = angle + error(reading), solved by iteration: the error's slope is about 1e-2.
        let mut reading = angle;
        for _ in 0..6 {
            let error: f64 = self
                .harmonics
                .iter()
                .map(|(order, amplitude, phase)| amplitude * (f64::from(*order) * reading + phase).sin())
                .sum();
            reading = angle + error;
        }
        let counts = (reading.rem_euclid(TAU) / TAU * f64::from(COUNTS_PER_TURN)).round() as u32;
        AngleCounts::new(counts)
    }

    fn angle_burst(&mut self) -> [u8; 4] {
        if !self.faults.frozen {
            self.sent = self.reading();
        }
        let mut reply = burst(Reading {
            angle: self.sent,
            warnings: self.faults.warnings,
        });
        if self.faults.bad_crc > 0 {
            self.faults.bad_crc -= 1;
            reply[3] = !reply[3];
        }
        reply
    }
}

impl SpiTarget for Mt6835 {
    fn transfer(&mut self, _now_us: u64, mosi: &[u8], miso: &mut [u8]) {
        miso.fill(0);
        if let [high, low, data @ ..] = mosi {
            let address = usize::from(u16::from_be_bytes([high & 0x0F, *low]));
            let reply = miso.get_mut(2..).unwrap_or_default();
            match high >> 4 {
                operation::ANGLE if address == usize::from(register::ANGLE) => {
                    for (to, from) in reply.iter_mut().zip(self.angle_burst()) {
                        *to = from;
                    }
                }
                operation::READ => {
                    if let (Some(to), Some(from)) = (reply.first_mut(), self.registers.get(address)) {
                        *to = *from;
                    }
                }
                operation::WRITE => {
                    if let (Some(register), Some(value)) = (self.registers.get_mut(address), data.first())
                        && !self.faults.ignores_writes
                    {
                        *register = *value;
                    }
                }
                _ => {}
            }
        }
        if let Some(level) = self.faults.silent {
            miso.fill(level);
        }
    }
}

#[cfg(test)]
mod tests {
    use drivers::Error;
    use drivers::harmonics::{Harmonic, Harmonics};
    use drivers::mt6835::{Config, MARK, Mt6835 as Driver};
    use embassy_futures::block_on;
    use frames::math::wrap_pi;

    use super::super::{Bench, BenchSpi};
    use super::*;

    fn started() -> (Bench<Mt6835>, Driver<BenchSpi<Mt6835>>) {
        let bench = Bench::new(Mt6835::new(), 8_000_000);
        let mut encoder = Driver::new(bench.spi());
        block_on(encoder.identify()).unwrap();
        block_on(encoder.configure(&Config::default())).unwrap();
        (bench, encoder)
    }

    #[test]
    fn angles_over_two_turns_and_back() {
        let (bench, mut encoder) = started();
        for k in -1000..1000 {
            let angle = f64::from(k) * 0.0117;
            bench.with(|part| part.set_angle(angle));
            let reading = block_on(encoder.read()).unwrap();
            assert!(reading.warnings.is_empty());
            let off = wrap_pi(f64::from(reading.angle.radians()) - angle);
            // Half a count, and the rounding to f32.
            assert!(off.abs() < 1.9e-6, "{angle} {off:e}");
        }
    }

    #[test]
    fn direction_is_configured() {
        let (bench, mut encoder) = started();
        bench.with(|part| part.set_angle(1.0));
        let config = Config {
            reversed: true,
            ..Config::default()
        };
        block_on(encoder.configure(&config)).unwrap();
        let reading = block_on(encoder.read()).unwrap();
        assert!((f64::from(reading.angle.radians()) - (TAU - 1.0)).abs() < 1.9e-6);
    }

    #[test]
    fn the_table_removes_the_harmonics() {
        let rows = [(1, 1.5e-3, 0.4), (2, 6e-4, -1.1), (4, 2e-4, 2.5)];
        let table = Harmonics::new(rows.map(|(order, amplitude, phase)| Harmonic {
            order,
            amplitude: amplitude as f32,
            phase: phase as f32,
        }))
        .unwrap();
        let (bench, mut encoder) = started();
        bench.with(|part| part.set_harmonics(rows.to_vec()));
        let (mut worst_raw, mut worst) = (0.0_f64, 0.0_f64);
        for k in 0..2000 {
            let angle = f64::from(k) / 2000.0 * TAU;
            bench.with(|part| part.set_angle(angle));
            let reading = block_on(encoder.read()).unwrap().angle.radians();
            worst_raw = worst_raw.max(wrap_pi(f64::from(reading) - angle).abs());
            worst = worst.max(wrap_pi(f64::from(table.correct(reading)) - angle).abs());
        }
        assert!(worst_raw > 1e-3, "{worst_raw:e}");
        assert!(worst < 2.2e-6, "{worst:e}");
    }

    #[test]
    fn faults() {
        let (bench, mut encoder) = started();
        bench.with(|part| part.set_angle(2.0));
        let mut next = |fault: &dyn Fn(&mut EncoderFaults)| {
            bench.with(|part| fault(&mut part.faults));
            block_on(encoder.read())
        };
        let good = next(&|_| {}).unwrap();
        for level in [0xFF, 0x00] {
            assert_eq!(next(&|f| f.silent = Some(level)), Err(Error::Silent { level }));
        }
        assert!(matches!(
            next(&|f| (f.silent, f.bad_crc) = (None, 1)),
            Err(Error::Crc { .. })
        ));
        let warned = next(&|f| f.warnings = Warnings::WEAK_FIELD).unwrap();
        assert_eq!((warned.angle, warned.warnings), (good.angle, Warnings::WEAK_FIELD));
        next(&|f| f.frozen = true).unwrap();
        bench.with(|part| part.set_angle(2.5));
        assert_eq!(next(&|_| {}).unwrap().angle, good.angle);
        assert_ne!(next(&|f| f.frozen = false).unwrap().angle, good.angle);
    }

    #[test]
    fn zero_is_a_good_angle_on_a_live_part() {
        let (_bench, mut encoder) = started();
        assert_eq!(block_on(encoder.read()).unwrap().angle.get(), 0);
    }

    #[test]
    fn a_byte_write_is_answered_by_nothing() {
        let mut part = Mt6835::new();
        let mut reply = [0xFF; 3];
        part.transfer(0, &[0x60, 0x01, MARK], &mut reply);
        assert_eq!(reply, [0; 3]);
        part.transfer(0, &[0x30, 0x01, 0], &mut reply);
        assert_eq!(reply, [0, 0, MARK]);
        // As delivered: hysteresis 7, which the default of the driver leaves alone.
        part.transfer(0, &[0x30, 0x0D, 0], &mut reply);
        assert_eq!((reply[2] & 0b111, Config::default().hysteresis), (7, 7));
    }

    #[test]
    fn a_part_that_loses_writes_is_not_identified() {
        let bench = Bench::new(Mt6835::new(), 8_000_000);
        bench.with(|part| part.faults.ignores_writes = true);
        assert_eq!(
            block_on(Driver::new(bench.spi()).identify()),
            Err(Error::Register {
                address: register::USER_ID,
                wrote: u16::from(MARK),
                read: 0
            })
        );
    }
}
