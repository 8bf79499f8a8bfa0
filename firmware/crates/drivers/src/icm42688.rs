//! ICM-42688-P: consumer IMU, for development.
//!
//! # Bus
//!
//! SPI mode 0 or 3, ≤ 24 MHz. The first byte is the address, with bit 7 set for a read; the address counts
//! up by itself. Registers lie in banks, selected by [`register::BANK_SELECT`]. A sample is one
//! transaction of [`BURST_LEN`] bytes from TEMP_DATA1 on: temperature, accelerometers and gyroscopes (14
//! bytes), the FSYNC stamp (2, unused), and INT_STATUS. The status comes last, so its data-ready bit,
//! which reading clears, says whether the data before it are new, and its reset bit whether the part has
//! lost its settings.
//!
//! # Why not the FIFO
//!
//! The 20-bit packets of the FIFO work at ±2000 °/s and ±16 g only, whatever ranges are selected. What
//! they resolve against the data registers:
//!
//! | | FIFO, 20 bit | registers, 16 bit |
//! |---|---|---|
//! | gyroscope | 1/131 °/s (19 bits are real) | 1/1048.6 °/s at ±31.25 °/s |
//! | accelerometer | 1/8192 g (18 bits are real) | 1/16384 g at ±2 g, 1/8192 g at ±4 g |
//!
//! For slow rotation the registers are eight times finer. The price is that the part has no sample
//! counter: lost samples are seen by the edge times, see [`sequence`](crate::sequence).
//!
//! # Why not the `icm426xx` crate
//!
//! Version 0.4 has async SPI and register access, but its only data path is the 20-bit FIFO at ±2000 °/s
//! and ±16 g, for the reason above eight times too coarse. It also reads back none of its settings, has
//! no self-test, and turns counts into floats without a look at the marker of invalid data.
//!
//! # Figures and where they come from
//!
//! | figure | source |
//! |---|---|
//! | addresses, banks, bits, WHO_AM_I, 1 ms after reset, 30 ms to start the gyroscopes | PX4 `InvenSense_ICM42688P_registers.hpp`, `ICM42688P.cpp` |
//! | 132.48 counts/°C from 25 °C, FIFO at ±2000 °/s and ±16 g only | PX4 |
//! | range codes; 16 bits span the range | `kriswiner/ICM42688` and its descendants |
//! | rate codes, anti-alias figures a rate, AFSR off | `icm426xx` 0.4.0 |
//! | with FIFO_HOLD_LAST_DATA_EN off a valid sample is −32766 to +32767, −32768 marks invalid data | data sheet DS-000347, 12.8, as public code quotes it |
//! | slew rates of the outputs, codes of DRIVE_CONFIG | Linux `inv_icm42600.h`, whose SPI code takes the same codes |
//! | clock ±1.5 %, and ±2 % over temperature | data sheet DS-000347, electrical characteristics; not at hand |
//! | delay of the UI filters at each rate, bandwidth and order of the anti-alias filters | data sheet DS-000347 rev. 1.8, 5.5 and 5.3 |
//! | UI filters are of second order after reset, GYRO_CONFIG1 0x16, which is not written here | public drivers |
//! | self-test: ±250 °/s and ±2 g, 60 °/s, 50 to 1200 mg, 200 ms | TDK `Ixm42xxxSelfTest.c` (IIM-42652, same family) |
//!
//! # Not verified
//!
//! Nothing here has run on a part. Open in particular: that one burst never mixes two samples; that
//! INT_STATUS read at the end of the burst behaves as in a read of its own; the delay of the anti-alias filter, which the data
//! sheet does not state: that of a Butterworth filter is taken. The self-test compares with the absolute limits only, not with the factory's
//! stored response.
//!
//! Not used: FIFO, external clock, the motion functions.

use embedded_hal_async::delay::DelayNs;
use embedded_hal_async::spi::{Operation, SpiDevice};
use frames::units::{DEG, STANDARD_GRAVITY};

use crate::{
    Channels, Error, ForceCounts, Identity, Imu, RateCounts, RawSample, Scale, Sequence, Status, SystemFlags,
    TemperatureCounts,
};

/// Identity, in [`register::WHO_AM_I`].
pub const WHO_AM_I: u8 = 0x47;
/// Bit of the address that makes an access a read.
pub const READ: u8 = 0x80;
/// A data word that holds nothing: the sensor has not started.
pub const INVALID: i16 = i16::MIN;
/// The lowest count of a sample: a sensor at the negative end of its range.
pub const LOWEST: i16 = -32766;
/// How far the part's clock may be off, as a share: 1.5 % as delivered and 2 % over temperature are 3.53 % together.
pub const CLOCK_TOLERANCE: f32 = 0.04;
/// Software reset, ms: twice the 1 ms the part needs.
pub const RESET_MS: u32 = 2;
/// From power-on of the gyroscopes to data, ms.
pub const START_MS: u32 = 30;
/// For the excitation of the self-test to settle, ms.
pub const SELF_TEST_MS: u32 = 200;
/// Samples averaged in the self-test, with excitation and without.
pub const SELF_TEST_SAMPLES: u8 = 32;
/// Least response of a gyroscope, °/s.
pub const SELF_TEST_RATE_MIN_DPS: i32 = 60;
/// Least response of an accelerometer, mg.
pub const SELF_TEST_FORCE_MIN_MG: i32 = 50;
/// Largest response of an accelerometer, mg.
pub const SELF_TEST_FORCE_MAX_MG: i32 = 1200;
/// Temperature of one count, °C.
pub const TEMPERATURE_PER_COUNT_C: f64 = 1.0 / 132.48;
/// Temperature at count zero, °C.
pub const TEMPERATURE_ZERO_C: f64 = 25.0;
/// Bytes from TEMP_DATA1 to INT_STATUS.
pub const DATA_LEN: usize = 17;
/// Bytes of the transaction that reads a sample.
pub const BURST_LEN: usize = 1 + DATA_LEN;

/// A register: bank and address.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Register {
    /// Bank.
    pub bank: u8,
    /// Address.
    pub address: u8,
}

impl Register {
    /// A register.
    pub const fn new(bank: u8, address: u8) -> Self {
        Self { bank, address }
    }

    /// Bank in the high byte, address in the low one, as in [`Error::Register`].
    pub const fn code(self) -> u16 {
        u16::from_be_bytes([self.bank, self.address])
    }
}

/// The registers in use.
pub mod register {
    use super::Register;

    /// Bank selection, at the same address in every bank.
    pub const BANK_SELECT: u8 = 0x76;
    /// Software reset.
    pub const DEVICE_CONFIG: Register = Register::new(0, 0x11);
    /// Slew rates of the part's outputs.
    pub const DRIVE_CONFIG: Register = Register::new(0, 0x13);
    /// The INT1 line: mode, drive, polarity.
    pub const INT_CONFIG: Register = Register::new(0, 0x14);
    /// First byte of a sample.
    pub const TEMP_DATA1: Register = Register::new(0, 0x1D);
    /// What happened since it was last read; last byte of a sample.
    pub const INT_STATUS: Register = Register::new(0, 0x2D);
    /// Byte order, I²C off.
    pub const INTF_CONFIG0: Register = Register::new(0, 0x4C);
    /// Clock, adaptive full scale.
    pub const INTF_CONFIG1: Register = Register::new(0, 0x4D);
    /// Power of the sensors.
    pub const PWR_MGMT0: Register = Register::new(0, 0x4E);
    /// Range and rate of the gyroscopes.
    pub const GYRO_CONFIG0: Register = Register::new(0, 0x4F);
    /// Range and rate of the accelerometers.
    pub const ACCEL_CONFIG0: Register = Register::new(0, 0x50);
    /// Bandwidth of both UI filters.
    pub const GYRO_ACCEL_CONFIG0: Register = Register::new(0, 0x52);
    /// Asynchronous reset of the interrupt, which must be off.
    pub const INT_CONFIG1: Register = Register::new(0, 0x64);
    /// What INT1 shows.
    pub const INT_SOURCE0: Register = Register::new(0, 0x65);
    /// Excitation of the sensors.
    pub const SELF_TEST_CONFIG: Register = Register::new(0, 0x70);
    /// Identity.
    pub const WHO_AM_I: Register = Register::new(0, 0x75);
    /// Anti-alias filter of the gyroscopes: DELT.
    pub const GYRO_CONFIG_STATIC3: Register = Register::new(1, 0x0C);
    /// Anti-alias filter of the gyroscopes: low byte of DELTSQR.
    pub const GYRO_CONFIG_STATIC4: Register = Register::new(1, 0x0D);
    /// Anti-alias filter of the gyroscopes: BITSHIFT and high bits of DELTSQR.
    pub const GYRO_CONFIG_STATIC5: Register = Register::new(1, 0x0E);
    /// Anti-alias filter of the accelerometers: DELT, and 0 to switch it on.
    pub const ACCEL_CONFIG_STATIC2: Register = Register::new(2, 0x03);
    /// Anti-alias filter of the accelerometers: low byte of DELTSQR.
    pub const ACCEL_CONFIG_STATIC3: Register = Register::new(2, 0x04);
    /// Anti-alias filter of the accelerometers: BITSHIFT and high bits of DELTSQR.
    pub const ACCEL_CONFIG_STATIC4: Register = Register::new(2, 0x05);
}

/// Bits of INT_STATUS.
pub mod event {
    /// A sample became ready.
    pub const DATA_READY: u8 = 1 << 3;
    /// The part has been reset.
    pub const RESET_DONE: u8 = 1 << 4;
}

/// DEVICE_CONFIG: reset.
pub const SOFT_RESET: u8 = 1;
/// PWR_MGMT0: all six sensors on, low noise.
pub const POWER_LOW_NOISE: u8 = 0b1111;
/// SELF_TEST_CONFIG: all six sensors excited, and the accelerometers' supply for it.
pub const EXCITE_ALL: u8 = 0b111_1111;
/// DRIVE_CONFIG: SPI and INT edges of 12 to 36 ns. Those of reset, below 2 ns, ring on a cable and couple into its
/// neighbours; half a period of the bus is 95 ns.
const SLEW_12_TO_36_NS: u8 = 0b001;
/// INTF_CONFIG0: big-endian, I²C off.
const BIG_ENDIAN_SPI_ONLY: u8 = 0x33;
/// INTF_CONFIG1: bits 7 and 6. AFSR changes the gyroscopes' range on the fly and stalls the output while
/// it does.
const AFSR_MASK: u8 = 0xC0;
const AFSR_OFF: u8 = 0x40;
/// INT_CONFIG: INT1 as pulse, push-pull, active high. Not latched: one lost transfer would leave the line high, and no
/// edge would come again.
const INT1_PULSE_PUSH_PULL_HIGH: u8 = 0b011;
/// INT_CONFIG1: bit 4 must be cleared for INT1 to work.
const INT_ASYNC_RESET: u8 = 1 << 4;
/// INT_SOURCE0: data ready on INT1.
pub const DATA_READY_ON_INT1: u8 = 1 << 3;

/// Range of the gyroscopes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum RateRange {
    /// ±2000 °/s.
    Dps2000,
    /// ±1000 °/s.
    Dps1000,
    /// ±500 °/s.
    Dps500,
    /// ±250 °/s.
    Dps250,
    /// ±125 °/s.
    Dps125,
    /// ±62.5 °/s: for fast swing.
    Dps62,
    /// ±31.25 °/s: 20 °/s of rotation and some swing.
    #[default]
    Dps31,
    /// ±15.625 °/s: less than the rotation.
    Dps15,
}

impl RateRange {
    /// Code of the range, in bits 7 to 5 of GYRO_CONFIG0.
    pub const fn code(self) -> u8 {
        self as u8
    }

    /// From the code, of which three bits count.
    pub const fn from_code(code: u8) -> Self {
        match code & 0b111 {
            0 => Self::Dps2000,
            1 => Self::Dps1000,
            2 => Self::Dps500,
            3 => Self::Dps250,
            4 => Self::Dps125,
            5 => Self::Dps62,
            6 => Self::Dps31,
            _ => Self::Dps15,
        }
    }

    /// Angular rate of one count, rad/s: half the span over 2¹⁵, halved with every code.
    pub const fn per_count(self) -> f64 {
        2000.0 * DEG / 32768.0 / (1_u32 << self.code()) as f64
    }
}

/// Range of the accelerometers.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum ForceRange {
    /// ±16 g.
    G16,
    /// ±8 g.
    G8,
    /// ±4 g.
    G4,
    /// ±2 g.
    #[default]
    G2,
}

impl ForceRange {
    /// Code of the range, in bits 7 to 5 of ACCEL_CONFIG0.
    pub const fn code(self) -> u8 {
        self as u8
    }

    /// From the code, of which two bits count.
    pub const fn from_code(code: u8) -> Self {
        match code & 0b11 {
            0 => Self::G16,
            1 => Self::G8,
            2 => Self::G4,
            _ => Self::G2,
        }
    }

    /// Specific force of one count, m/s²: half the span over 2¹⁵, halved with every code.
    pub const fn per_count(self) -> f64 {
        16.0 * STANDARD_GRAVITY / 32768.0 / (1_u32 << self.code()) as f64
    }
}

/// Samples a second, with the anti-alias filter that fits.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Rate {
    /// 200 Hz, anti-alias filter at 84 Hz.
    #[default]
    Hz200,
    /// 500 Hz, anti-alias filter at 213 Hz.
    Hz500,
    /// 1000 Hz, anti-alias filter at 488 Hz.
    Hz1000,
}

impl Rate {
    /// Code of the rate, in bits 3 to 0 of both CONFIG0 registers.
    pub const fn code(self) -> u8 {
        match self {
            Self::Hz200 => 0b0111,
            Self::Hz500 => 0b1111,
            Self::Hz1000 => 0b0110,
        }
    }

    /// From the code; `None` for a rate that is not offered here.
    pub const fn from_code(code: u8) -> Option<Self> {
        match code & 0b1111 {
            0b0111 => Some(Self::Hz200),
            0b1111 => Some(Self::Hz500),
            0b0110 => Some(Self::Hz1000),
            _ => None,
        }
    }

    /// Time from one sample to the next, µs.
    pub const fn period_us(self) -> u32 {
        match self {
            Self::Hz200 => 5000,
            Self::Hz500 => 2000,
            Self::Hz1000 => 1000,
        }
    }

    /// What both filters delay beyond half a period, µs: UI filter of second order, code 0, + anti-alias filter, √2/2πf of a
    /// Butterworth filter of second order, − half a period.
    ///
    /// ```text
    ///  200 Hz   3.3 + 2.68 − 2.5 ms
    ///  500 Hz   1.3 + 1.06 − 1.0
    /// 1000 Hz   0.7 + 0.46 − 0.5
    /// ```
    pub const fn delay_us(self) -> u32 {
        match self {
            Self::Hz200 => 3480,
            Self::Hz500 => 1360,
            Self::Hz1000 => 660,
        }
    }

    /// DELT, DELTSQR and BITSHIFT of the anti-alias filter: the widest below half the rate.
    const fn anti_alias(self) -> (u8, u8, u8) {
        match self {
            Self::Hz200 => (2, 4, 13),
            Self::Hz500 => (5, 25, 10),
            Self::Hz1000 => (11, 122, 8),
        }
    }
}

/// Settings.
///
/// | field | unit | zero means | sane value |
/// |---|---|---|---|
/// | `rate_range` | | ±2000 °/s | ±31.25 °/s; ±62.5 where the swing is fast |
/// | `force_range` | | ±16 g | ±2 g |
/// | `rate` | | 200 Hz | 200 Hz |
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Config {
    /// Range of the gyroscopes.
    pub rate_range: RateRange,
    /// Range of the accelerometers.
    pub force_range: ForceRange,
    /// Samples a second.
    pub rate: Rate,
}

impl Config {
    /// The settings as register, mask of our bits and value, in the order of writing: banks in turn, the
    /// power last, because most settings may change only while the sensors are off.
    pub const fn settings(&self) -> [(Register, u8, u8); 15] {
        use register as r;
        let (delt, deltsqr, shift) = self.rate.anti_alias();
        [
            (r::GYRO_CONFIG_STATIC3, 0x3F, delt),
            (r::GYRO_CONFIG_STATIC4, 0xFF, deltsqr),
            (r::GYRO_CONFIG_STATIC5, 0xFF, shift << 4),
            (r::ACCEL_CONFIG_STATIC2, 0x7F, delt << 1),
            (r::ACCEL_CONFIG_STATIC3, 0xFF, deltsqr),
            (r::ACCEL_CONFIG_STATIC4, 0xFF, shift << 4),
            (r::DRIVE_CONFIG, 0x07, SLEW_12_TO_36_NS),
            (r::INTF_CONFIG0, 0xFF, BIG_ENDIAN_SPI_ONLY),
            (r::INTF_CONFIG1, AFSR_MASK, AFSR_OFF),
            (r::INT_CONFIG, 0x07, INT1_PULSE_PUSH_PULL_HIGH),
            (r::INT_CONFIG1, INT_ASYNC_RESET, 0),
            (r::INT_SOURCE0, 0x7F, DATA_READY_ON_INT1),
            (r::GYRO_CONFIG0, 0xEF, (self.rate_range.code() << 5) | self.rate.code()),
            (
                r::ACCEL_CONFIG0,
                0xEF,
                (self.force_range.code() << 5) | self.rate.code(),
            ),
            // Code 0 of both filters: half the rate, so that the anti-alias filter decides.
            (r::GYRO_ACCEL_CONFIG0, 0xFF, 0x00),
        ]
    }
}

/// The driver. Give it an SPI device in mode 0 or 3 and a delay.
#[derive(Debug)]
pub struct Icm42688<SPI, D> {
    spi: SPI,
    delay: D,
    /// The bank the part has selected, as far as known.
    bank: Option<u8>,
    config: Config,
}

impl<SPI: SpiDevice, D: DelayNs> Icm42688<SPI, D> {
    /// A driver that knows nothing of its part yet.
    pub fn new(spi: SPI, delay: D) -> Self {
        Self {
            spi,
            delay,
            bank: None,
            config: Config::default(),
        }
    }

    /// Gives bus and delay back.
    pub fn release(self) -> (SPI, D) {
        (self.spi, self.delay)
    }

    async fn exchange(&mut self, bytes: &mut [u8]) -> Result<(), Error> {
        self.spi
            .transaction(&mut [Operation::TransferInPlace(bytes)])
            .await
            .map_err(Error::bus)
    }

    async fn select(&mut self, bank: u8) -> Result<(), Error> {
        if self.bank == Some(bank) {
            return Ok(());
        }
        self.bank = None;
        self.exchange(&mut [register::BANK_SELECT, bank]).await?;
        self.bank = Some(bank);
        Ok(())
    }

    /// Reads a register.
    ///
    /// Cancellation: safe to repeat, save for INT_STATUS, whose events a dropped read loses.
    ///
    /// # Errors
    /// [`Error::Bus`].
    pub async fn read(&mut self, register: Register) -> Result<u8, Error> {
        self.select(register.bank).await?;
        let mut buffer = [READ | register.address, 0];
        self.exchange(&mut buffer).await?;
        Ok(buffer[1])
    }

    /// Writes a register.
    ///
    /// Cancellation: safe to repeat; a dropped call may or may not have written.
    ///
    /// # Errors
    /// [`Error::Bus`].
    pub async fn write(&mut self, register: Register, value: u8) -> Result<(), Error> {
        self.select(register.bank).await?;
        self.exchange(&mut [register.address, value]).await
    }

    /// Writes the bits under `mask`, keeps the others, and reads back.
    async fn set(&mut self, register: Register, mask: u8, value: u8) -> Result<(), Error> {
        let others = if mask == 0xFF {
            0
        } else {
            self.read(register).await? & !mask
        };
        let wrote = others | value;
        self.write(register, wrote).await?;
        let read = self.read(register).await?;
        if read & mask != value {
            return Err(Error::Register {
                address: register.code(),
                wrote: u16::from(wrote),
                read: u16::from(read),
            });
        }
        Ok(())
    }

    async fn data(&mut self) -> Result<[u8; DATA_LEN], Error> {
        self.select(0).await?;
        let mut buffer = [0; BURST_LEN];
        buffer[0] = READ | register::TEMP_DATA1.address;
        self.exchange(&mut buffer).await?;
        let [_, data @ ..] = buffer;
        Ok(data)
    }

    /// Sums [`SELF_TEST_SAMPLES`] samples, one a millisecond.
    async fn sum(&mut self) -> Result<[i32; 6], Error> {
        let mut sum = [0; 6];
        for _ in 0..SELF_TEST_SAMPLES {
            self.delay.delay_ms(1).await;
            let raw = parse_data(&self.data().await?)?;
            for (total, counts) in sum.iter_mut().zip(raw.rate.0.iter().chain(&raw.force.0)) {
                *total += counts;
            }
        }
        Ok(sum)
    }
}

impl<SPI: SpiDevice, D: DelayNs> Imu for Icm42688<SPI, D> {
    type Config = Config;

    async fn reset(&mut self) -> Result<(), Error> {
        let sent = self.write(register::DEVICE_CONFIG, SOFT_RESET).await;
        self.bank = None;
        sent?;
        self.delay.delay_ms(RESET_MS).await;
        let status = self.read(register::INT_STATUS).await?;
        match status {
            0xFF => Err(Error::Silent { level: 0xFF }),
            _ if status & event::RESET_DONE == 0 => Err(Error::Restarted {
                status: u16::from(status),
            }),
            _ => Ok(()),
        }
    }

    async fn identify(&mut self) -> Result<Identity, Error> {
        let found = self.read(register::WHO_AM_I).await?;
        if found != WHO_AM_I {
            self.bank = None;
            return Err(Error::WhoAmI {
                expected: u16::from(WHO_AM_I),
                found: u16::from(found),
            });
        }
        Ok(Identity {
            product: u16::from(found),
            revision: 0,
            serial: 0,
        })
    }

    /// Takes the part's settings away: `configure` comes after it.
    async fn self_test(&mut self) -> Result<(), Error> {
        self.configure(&Config {
            rate_range: RateRange::Dps250,
            force_range: ForceRange::G2,
            rate: Rate::Hz1000,
        })
        .await?;
        let rest = self.sum().await?;
        self.write(register::SELF_TEST_CONFIG, EXCITE_ALL).await?;
        self.delay.delay_ms(SELF_TEST_MS).await;
        let excited = self.sum().await;
        // Off again whatever came of it.
        self.write(register::SELF_TEST_CONFIG, 0).await?;
        self.write(register::PWR_MGMT0, 0).await?;
        let failed = judge_self_test(&rest, &excited?);
        if failed.is_empty() {
            Ok(())
        } else {
            Err(Error::SelfTest { failed })
        }
    }

    /// Ends with the sensors on and started, one and a half times [`START_MS`] later: until then the registers may
    /// hold samples of before, which nothing marks.
    async fn configure(&mut self, config: &Config) -> Result<(), Error> {
        self.set(register::PWR_MGMT0, 0x3F, 0).await?;
        for (register, mask, value) in config.settings() {
            self.set(register, mask, value).await?;
        }
        self.set(register::PWR_MGMT0, 0x3F, POWER_LOW_NOISE).await?;
        self.config = *config;
        self.delay.delay_ms(START_MS + START_MS / 2).await;
        // What is ready by now is not the first sample after the edge the caller waits for, and the
        // event of an intended reset is no news.
        self.read(register::INT_STATUS).await?;
        Ok(())
    }

    async fn sample(&mut self) -> Result<RawSample, Error> {
        let data = self.data().await?;
        let sample = parse_data(&data);
        if matches!(sample, Err(Error::Silent { .. } | Error::Restarted { .. })) {
            self.bank = None;
        }
        sample
    }

    fn scale(&self) -> Scale {
        Scale {
            rate: self.config.rate_range.per_count() as f32,
            force: self.config.force_range.per_count() as f32,
            temperature_c: TEMPERATURE_PER_COUNT_C as f32,
            temperature_zero_c: TEMPERATURE_ZERO_C as f32,
        }
    }

    fn period(&self) -> f32 {
        self.config.rate.period_us() as f32 * 1e-6
    }

    fn delay_us(&self) -> u32 {
        self.config.rate.delay_us()
    }
}

/// The sensors whose response to excitation is outside the limits, from sums over
/// [`SELF_TEST_SAMPLES`] samples at ±250 °/s and ±2 g: gyroscopes x, y, z, then accelerometers.
pub fn judge_self_test(rest: &[i32; 6], excited: &[i32; 6]) -> Channels {
    // At ±250 °/s a degree per second is 32768/250 counts, at ±2 g a g is 16384.
    const COUNTS_250_DPS: u32 = 32_768;
    const COUNTS_1_G: u32 = 16_384;
    let n = u32::from(SELF_TEST_SAMPLES);
    let rate_min = SELF_TEST_RATE_MIN_DPS.unsigned_abs() * COUNTS_250_DPS * n / 250;
    let force_min = SELF_TEST_FORCE_MIN_MG.unsigned_abs() * COUNTS_1_G * n / 1000;
    let force_max = SELF_TEST_FORCE_MAX_MG.unsigned_abs() * COUNTS_1_G * n / 1000;
    let mut failed = 0;
    for (k, (a, b)) in rest.iter().zip(excited).enumerate() {
        let response = a.abs_diff(*b);
        let good = if k < 3 {
            response >= rate_min
        } else {
            (force_min..=force_max).contains(&response)
        };
        failed |= u8::from(!good) << k;
    }
    Channels::from_bits(failed)
}

/// Reads the bytes from TEMP_DATA1 to INT_STATUS.
///
/// A count at either end of the range is saturation; the lowest value the part can send is the marker
/// of invalid data.
///
/// # Errors
/// [`Error::Silent`], [`Error::Restarted`], [`Error::Invalid`].
pub fn parse_data(data: &[u8; DATA_LEN]) -> Result<RawSample, Error> {
    let level = data[0];
    if matches!(level, 0 | 0xFF) && data.iter().all(|byte| *byte == level) {
        return Err(Error::Silent { level });
    }
    let status = data[DATA_LEN - 1];
    if status & event::RESET_DONE != 0 {
        return Err(Error::Restarted {
            status: u16::from(status),
        });
    }
    let word = |k: usize| i16::from_be_bytes([data[2 * k], data[2 * k + 1]]);
    let force = ForceCounts([1, 2, 3].map(|k| i32::from(word(k))));
    let rate = RateCounts([4, 5, 6].map(|k| i32::from(word(k))));
    let invalid = |c: i32| c == i32::from(INVALID);
    let channels = Channels::where_counts(rate, force, invalid, invalid);
    if !channels.is_empty() {
        return Err(Error::Invalid { channels });
    }
    let at_end = |c: i32| c <= i32::from(LOWEST) || c >= i32::from(i16::MAX);
    Ok(RawSample {
        rate,
        force,
        temperature: TemperatureCounts(word(0)),
        sequence: Sequence::Fresh(status & event::DATA_READY != 0),
        status: Status {
            saturated: Channels::where_counts(rate, force, at_end, at_end),
            system: SystemFlags::NONE,
        },
    })
}

#[cfg(test)]
mod tests {
    use std::vec::Vec;

    use embedded_hal_async::spi::ErrorKind;
    use proptest::prelude::*;

    use super::*;
    use crate::testing::{BrokenBus, CheckedDelay, Mock, NoopDelay, Wait, block_on, exchange};

    type Steps = Vec<embedded_hal_mock::eh1::spi::Transaction<u8>>;

    fn write(address: u8, value: u8) -> Steps {
        exchange(&[address, value], &[0, 0], 0)
    }

    fn read(address: u8, value: u8) -> Steps {
        exchange(&[0x80 | address, 0], &[0, value], 0)
    }

    fn bank(number: u8) -> Steps {
        write(0x76, number)
    }

    fn on_bus<T>(steps: &[Steps], body: impl AsyncFnOnce(&mut Icm42688<Mock<u8>, NoopDelay>) -> T) -> T {
        let mut bus = Mock::new(&steps.concat());
        let mut imu = Icm42688::new(bus.clone(), NoopDelay);
        let result = block_on(body(&mut imu));
        bus.done();
        result
    }

    fn data(words: [i16; 7], status: u8) -> [u8; DATA_LEN] {
        let mut bytes = [0; DATA_LEN];
        for (pair, word) in bytes.chunks_exact_mut(2).zip(words) {
            pair.copy_from_slice(&word.to_be_bytes());
        }
        bytes[DATA_LEN - 1] = status;
        bytes
    }

    fn burst(reply: [u8; DATA_LEN]) -> Steps {
        let mut sent = [0; BURST_LEN];
        sent[0] = 0x9D;
        exchange(&sent, &[&[0xAA], &reply[..]].concat(), 0)
    }

    const WORDS: [i16; 7] = [1325, -100, 200, 16384, -300, 400, 20972];

    #[test]
    fn reset_waits_for_the_event() {
        let mut bus = Mock::new(&[bank(0), write(0x11, 0x01), bank(0), read(0x2D, 0x10)].concat());
        let mut delay = CheckedDelay::new(&[Wait::async_delay_ms(2)]);
        block_on(Icm42688::new(bus.clone(), delay.clone()).reset()).unwrap();
        bus.done();
        delay.done();
        for (status, expected) in [
            (0x08, Error::Restarted { status: 8 }),
            (0xFF, Error::Silent { level: 0xFF }),
        ] {
            let steps = [bank(0), write(0x11, 0x01), bank(0), read(0x2D, status)];
            assert_eq!(on_bus(&steps, async |imu| imu.reset().await), Err(expected));
        }
    }

    #[test]
    fn identity() {
        let steps = [bank(0), read(0x75, 0x47), read(0x75, 0x44), bank(0), read(0x75, 0xFF)];
        on_bus(&steps, async |imu| {
            assert_eq!(imu.identify().await.unwrap().product, 0x47);
            for found in [0x44, 0xFF] {
                assert_eq!(imu.identify().await, Err(Error::WhoAmI { expected: 0x47, found }));
            }
        });
    }

    /// Read, write, read back; a register that is all ours is not read first.
    fn set(address: u8, before: u8, value: u8) -> Steps {
        [read(address, before), write(address, value), read(address, value)].concat()
    }

    fn set_all(address: u8, value: u8) -> Steps {
        [write(address, value), read(address, value)].concat()
    }

    #[test]
    fn configure_step_by_step() {
        let steps = [
            bank(0),
            set(0x4E, 0x0F, 0x00),
            bank(1),
            set(0x0C, 0x8D, 0x82),
            set_all(0x0D, 4),
            set_all(0x0E, 0xD0),
            bank(2),
            set(0x03, 0x80, 0x84),
            set_all(0x04, 4),
            set_all(0x05, 0xD0),
            bank(0),
            set(0x13, 0x05, 0x01),
            set_all(0x4C, 0x33),
            set(0x4D, 0x91, 0x51),
            set(0x14, 0x38, 0x3B),
            set(0x64, 0x10, 0x00),
            set(0x65, 0x10, 0x08),
            set(0x4F, 0x06, 0xC7),
            set(0x50, 0x06, 0x67),
            set_all(0x52, 0x00),
            set(0x4E, 0x00, 0x0F),
            read(0x2D, 0x18),
        ];
        let mut bus = Mock::new(&steps.concat());
        let mut delay = CheckedDelay::new(&[Wait::async_delay_ms(45)]);
        let mut imu = Icm42688::new(bus.clone(), delay.clone());
        block_on(imu.configure(&Config::default())).unwrap();
        assert_eq!(imu.period(), 0.005);
        bus.done();
        delay.done();
    }

    #[test]
    fn a_setting_that_does_not_take_is_named() {
        let steps = [
            bank(0),
            set(0x4E, 0x00, 0x00),
            bank(1),
            read(0x0C, 0x0D),
            write(0x0C, 0x02),
            read(0x0C, 0x0D),
        ];
        assert_eq!(
            on_bus(&steps, async |imu| imu.configure(&Config::default()).await),
            Err(Error::Register {
                address: 0x010C,
                wrote: 0x02,
                read: 0x0D
            })
        );
    }

    #[test]
    fn a_sample_is_one_transaction() {
        let steps = [bank(0), burst(data(WORDS, 0x08)), burst(data(WORDS, 0x00))];
        let (raw, again, scale) = on_bus(&steps, async |imu| {
            (imu.sample().await.unwrap(), imu.sample().await.unwrap(), imu.scale())
        });
        assert_eq!(raw.force, ForceCounts([-100, 200, 16384]));
        assert_eq!(raw.rate, RateCounts([-300, 400, 20972]));
        assert_eq!(raw.sequence, Sequence::Fresh(true));
        assert_eq!(again.sequence, Sequence::Fresh(false));
        assert!(raw.status.is_good());
        let si = scale.si(&raw);
        // 20972 × 31.25/32768 = 20.0005 °/s; 16384 × 2/32768 = 1 g; 1325/132.48 = 10.0 °C.
        assert!((f64::from(si.w_is_s.z()) / DEG - 20.0005).abs() < 1e-4);
        assert!((f64::from(si.f_is_s.z()) - STANDARD_GRAVITY).abs() < 1e-5);
        assert!((si.temperature_c - 35.0).abs() < 0.01);
    }

    #[test]
    fn silence_restart_and_invalid_data() {
        let mut no_gyro = WORDS;
        no_gyro[4..].fill(INVALID);
        let steps = [
            bank(0),
            burst([0xFF; DATA_LEN]),
            bank(0),
            burst([0; DATA_LEN]),
            bank(0),
            burst(data(WORDS, 0x18)),
            bank(0),
            burst(data(no_gyro, 0x08)),
            burst(data(WORDS, 0x08)),
        ];
        on_bus(&steps, async |imu| {
            assert_eq!(imu.sample().await, Err(Error::Silent { level: 0xFF }));
            assert_eq!(imu.sample().await, Err(Error::Silent { level: 0 }));
            assert_eq!(imu.sample().await, Err(Error::Restarted { status: 0x18 }));
            let gyros = Channels::RATE_X | Channels::RATE_Y | Channels::RATE_Z;
            assert_eq!(imu.sample().await, Err(Error::Invalid { channels: gyros }));
            assert!(imu.sample().await.is_ok());
        });
    }

    #[test]
    fn saturation_comes_with_the_sample() {
        let words = [0, 32767, -32765, -32766, -32767, 32766, -32766];
        let raw = parse_data(&data(words, 0x08)).unwrap();
        let ends = Channels::FORCE_X | Channels::FORCE_Z | Channels::RATE_X | Channels::RATE_Z;
        assert_eq!(raw.status.saturated, ends);
    }

    #[test]
    fn a_sound_clock_is_within_its_tolerance() {
        for share in [1.015 * 1.02, 0.985 * 0.98] {
            assert!((share - 1.0_f32).abs() < CLOCK_TOLERANCE);
        }
    }

    #[test]
    fn self_test_limits() {
        let n = i32::from(SELF_TEST_SAMPLES);
        // 60 °/s at ±250 °/s are 7864.3 counts, 50 and 1200 mg at ±2 g 819.2 and 19660.8.
        let judge = |rate: i32, force: i32| {
            judge_self_test(
                &[1000 * n; 6],
                &[rate, rate, rate, force, force, force].map(|c| (1000 + c) * n),
            )
        };
        let rates = Channels::RATE_X | Channels::RATE_Y | Channels::RATE_Z;
        let forces = Channels::FORCE_X | Channels::FORCE_Y | Channels::FORCE_Z;
        for (rate, force, expected) in [
            (7865, 820, Channels::NONE),
            (-7865, -19660, Channels::NONE),
            (7864, 820, rates),
            (20000, 819, forces),
            (0, 19661, Channels::ALL),
        ] {
            assert_eq!(judge(rate, force), expected, "{rate} {force}");
        }
    }

    #[test]
    fn bus_errors_keep_their_kind() {
        let mut imu = Icm42688::new(BrokenBus, NoopDelay);
        let expected = Error::Bus(ErrorKind::Overrun);
        assert_eq!(block_on(imu.reset()), Err(expected));
        assert_eq!(block_on(imu.identify()), Err(expected));
        assert_eq!(block_on(imu.self_test()), Err(expected));
        assert_eq!(block_on(imu.configure(&Config::default())), Err(expected));
        assert_eq!(block_on(imu.sample()), Err(expected));
        assert_eq!(imu.bank, None);
    }

    #[test]
    fn codes_return() {
        for code in 0..8 {
            assert_eq!(RateRange::from_code(code).code(), code);
        }
        for code in 0..4 {
            assert_eq!(ForceRange::from_code(code).code(), code);
        }
        for rate in [Rate::Hz200, Rate::Hz500, Rate::Hz1000] {
            assert_eq!(Rate::from_code(rate.code()), Some(rate));
        }
        assert!((RateRange::Dps31.per_count() / DEG * 32768.0 - 31.25).abs() < 1e-12);
        assert!((ForceRange::G2.per_count() / STANDARD_GRAVITY * 32768.0 - 2.0).abs() < 1e-12);
    }

    proptest! {
        #[test]
        fn any_bytes_are_parsed(bytes in any::<[u8; DATA_LEN]>()) {
            if let Ok(raw) = parse_data(&bytes) {
                prop_assert!(raw.rate.0.iter().chain(&raw.force.0).all(|c| c.abs() <= 32767));
            }
        }
    }
}
