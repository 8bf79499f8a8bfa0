//! ADIS16495-1: tactical-grade IMU, the reference of the unit.
//!
//! # Bus
//!
//! SPI mode 3, most significant bit first, 16-bit frames: ≤ 15 MHz for registers, ≤ 6 MHz for
//! bursts. The registers lie on pages, selected by writing the page's number to address 0. The reply
//! to a read comes while the *next* frame is sent:
//!
//! ```text
//! MOSI  0x80pp   0x7E00   0x0000          page pp; read 0x7E; fetch the reply (a read of the page number)
//! MISO   …        …       PROD_ID
//! MOSI  0x8Cll   0x8Dhh                   write ll, then hh, to addresses 0x0C and 0x0D
//! ```
//!
//! Between frames the part needs a stall, [`STALL_NS`] from clock to clock. Each frame here is one
//! SPI transaction of transfer and `DelayNs`, so chip select is high between frames and no two can
//! come closer. (embassy's shared `SpiDevice` supports `DelayNs` only with its `time` feature.)
//!
//! A burst is one transaction of [`BURST_LEN`] bytes without stalls:
//!
//! ```text
//! MOSI  0x7C00  0  …
//! MISO   …     [0xA5A5] 0xA5A5  FLAG TEMP  XG_L XG_H … ZA_L ZA_H  CNT  CRC_L CRC_H
//! ```
//!
//! with one 0xA5A5 below about 3 MHz and two above 3.6 MHz. The parser takes either and leaves
//! the last word of a short reply unread.
//!
//! # Figures and where they come from
//!
//! | figure | value | source |
//! |---|---|---|
//! | product number | 16495 = 0x406F | Linux `adis16480.c` |
//! | range code of the -1 model | 3 | ADI `adi-imu-driver`, PX4 `ADIS16497.cpp` |
//! | gyroscope, upper word | 125/20000 = 1/160 °/s | Linux; ADI |
//! | accelerometer, upper word | 8/32000 g = 0.25 mg | Linux; ADI |
//! | lower words | 1/65536 of the upper | Linux; ADI |
//! | temperature | 1/80 °C, zero at 25 °C | Linux; ADI; PX4 |
//! | base rate, DEC_RATE | 4250 Hz / (DEC_RATE + 1), ≤ 4249 | Linux (4250 allowed there) |
//! | stall | 5 µs | Linux; PX4 gets by with 2 |
//! | time a setting takes | 340, 65, 71, 45 µs | ADI; PX4 |
//! | software reset | 210 ms | Linux |
//! | power-up, self-test | 350, 50 ms | the longer of two published figures each (Linux has 250 and 20) |
//! | flags, self-test bits, command bits | as the constants here | ADI |
//! | CRC | CRC-32/ISO-HDLC over 15 words, low byte first, low word sent first | Linux; PX4 |
//! | FIR banks | 300, 100, 300, 100 Hz | Linux |
//!
//! # Not verified
//!
//! Nothing here has run on a part. Open in particular: whether DATA_CNT counts output samples or base
//! samples, which is therefore [learnt](crate::sequence::SampleTracker::learn) at each start; that reading SYS_E_FLAG, also in a burst, clears it; that the decimation filter is a
//! plain mean; how the part behaves between 3 and 3.6 MHz; the delay of its sensors. Of the ADIS16364, two poles at 404 and
//! 757 Hz, the maker says 0.31 + 0.17 ms; a single pole at 480 Hz would have 0.33 ms. Between them [`DELAY_US`] is taken: 0.1 ms
//! more or less is 0.002° of heading at 20 °/s.
//!
//! Not used: delta-angle registers (not in the burst), external clock, bias correction, and the part's
//! flash.

use core::num::NonZeroU16;

use embedded_hal_async::delay::DelayNs;
use embedded_hal_async::spi::{Operation, SpiDevice};
use frames::units::{DEG, STANDARD_GRAVITY};

use crate::crc::crc32;
use crate::{
    Channels, Error, ForceCounts, Identity, Imu, RateCounts, RawSample, Scale, Sequence, Status, SystemFlags,
    TemperatureCounts,
};

/// Product number, in PROD_ID.
pub const PRODUCT: u16 = 16495;
/// Range code of the -1 model (±125 °/s), in RANG_MDL.
pub const RANGE_125_DPS: u16 = 0x0003;
/// Time between two frames, clock to clock, ns.
pub const STALL_NS: u32 = 5_000;
/// Fastest clock of a burst, Hz.
pub const BURST_MAX_HZ: u32 = 6_000_000;
/// Above this clock a burst is announced by two identifiers, Hz.
pub const TWO_IDS_ABOVE_HZ: u32 = 3_600_000;
/// From power-up to the first frame, and more than a software reset takes, ms.
pub const POWER_UP_MS: u32 = 350;
/// Software reset, ms.
pub const RESET_MS: u32 = 210;
/// Self-test, ms.
pub const SELF_TEST_MS: u32 = 50;
/// What the sensors and their analogue filters delay beyond the mean over a period, µs. Assumed: see [Not
/// verified](self#not-verified). A FIR filter, which is off by default, would add its own.
pub const DELAY_US: u32 = 400;
/// Samples a second before decimation, Hz.
pub const BASE_RATE_HZ: u32 = 4250;
/// Largest DEC_RATE: one sample a second.
pub const DEC_RATE_MAX: u16 = 4249;

/// Angular rate of one 32-bit count, rad/s: 1/160 °/s in the upper word.
pub const RATE_PER_COUNT: f64 = DEG / 160.0 / 65536.0;
/// Specific force of one 32-bit count, m/s²: 0.25 mg in the upper word.
pub const FORCE_PER_COUNT: f64 = STANDARD_GRAVITY / 4000.0 / 65536.0;
/// Temperature of one count, °C.
pub const TEMPERATURE_PER_COUNT_C: f64 = 1.0 / 80.0;
/// Temperature at count zero, °C.
pub const TEMPERATURE_ZERO_C: f64 = 25.0;
/// End of the gyroscopes' range in 32-bit counts: 125 °/s × 160 × 65536.
pub const RATE_RANGE_COUNTS: i32 = 20_000 << 16;
/// End of the accelerometers' range in 32-bit counts: 8 g × 4000 × 65536.
pub const FORCE_RANGE_COUNTS: i32 = 32_000 << 16;

/// Word that asks for a burst.
pub const BURST_COMMAND: u16 = 0x7C00;
/// Word that announces one.
pub const BURST_ID: u16 = 0xA5A5;
/// Words under the check sum.
pub const BURST_WORDS: usize = 15;
/// Bytes of a burst: command, two identifiers, data, check sum.
pub const BURST_LEN: usize = 2 * (1 + 2 + BURST_WORDS + 2);

/// Bit of the address that makes a frame a write.
pub const WRITE: u8 = 0x80;

/// A register: page and address of its low byte.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Register {
    /// Page.
    pub page: u8,
    /// Address of the low byte; the high byte follows.
    pub address: u8,
}

impl Register {
    /// A register.
    pub const fn new(page: u8, address: u8) -> Self {
        Self { page, address }
    }

    /// Page in the high byte, address in the low one, as in [`Error::Register`].
    pub const fn code(self) -> u16 {
        u16::from_be_bytes([self.page, self.address])
    }
}

/// The registers in use.
pub mod register {
    use super::Register;

    /// Page selection, at the same address on every page.
    pub const PAGE_ID: u8 = 0x00;
    /// Counter of the samples.
    pub const DATA_CNT: Register = Register::new(0, 0x04);
    /// The part's own flags; reading clears them.
    pub const SYS_E_FLAG: Register = Register::new(0, 0x08);
    /// Result of the self-test, a bit a sensor; reading clears it.
    pub const DIAG_STS: Register = Register::new(0, 0x0A);
    /// Temperature.
    pub const TEMP_OUT: Register = Register::new(0, 0x0E);
    /// First of the twelve data words: x, y, z gyroscope, then accelerometer, low word first.
    pub const X_GYRO_LOW: Register = Register::new(0, 0x10);
    /// Product number.
    pub const PROD_ID: Register = Register::new(0, 0x7E);
    /// Commands.
    pub const GLOB_CMD: Register = Register::new(3, 0x02);
    /// Use of the four I/O lines.
    pub const FNCTIO_CTRL: Register = Register::new(3, 0x06);
    /// Compensations.
    pub const CONFIG: Register = Register::new(3, 0x0A);
    /// Decimation.
    pub const DEC_RATE: Register = Register::new(3, 0x0C);
    /// Continuous bias estimation.
    pub const NULL_CNFG: Register = Register::new(3, 0x0E);
    /// Range code.
    pub const RANG_MDL: Register = Register::new(3, 0x12);
    /// FIR filters of five sensors.
    pub const FILTR_BNK_0: Register = Register::new(3, 0x16);
    /// FIR filter of the z accelerometer.
    pub const FILTR_BNK_1: Register = Register::new(3, 0x18);
    /// Firmware revision.
    pub const FIRM_REV: Register = Register::new(3, 0x78);
    /// Serial number.
    pub const SERIAL_NUM: Register = Register::new(4, 0x20);
}

/// Commands of GLOB_CMD.
pub mod command {
    /// Self-test.
    pub const SELF_TEST: u16 = 1 << 1;
    /// Software reset.
    pub const SOFTWARE_RESET: u16 = 1 << 7;
}

/// Bits of FNCTIO_CTRL.
pub mod function {
    /// Data-ready is put out.
    pub const DATA_READY: u16 = 1 << 3;
    /// Data-ready is high when there are data.
    pub const DATA_READY_HIGH: u16 = 1 << 2;
}

/// Bits of CONFIG.
pub mod compensation {
    /// Removes the gyroscopes' response to linear acceleration.
    pub const LINEAR_G: u16 = 1 << 7;
    /// Refers the accelerometers to one point.
    pub const POINT_OF_PERCUSSION: u16 = 1 << 6;
}

/// The line that carries data-ready.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Line {
    /// DIO1.
    Dio1,
    /// DIO2, the part's default.
    #[default]
    Dio2,
    /// DIO3.
    Dio3,
    /// DIO4.
    Dio4,
}

/// FIR filter of all six sensors, ahead of the decimation.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Fir {
    /// None: the samples are means over the output period, their sum the integral of the motion.
    #[default]
    Off,
    /// Bank A, 300 Hz.
    A,
    /// Bank B, 100 Hz.
    B,
    /// Bank C, 300 Hz.
    C,
    /// Bank D, 100 Hz.
    D,
}

impl Fir {
    /// The words of both filter registers: three bits a sensor, enable and bank.
    pub const fn words(self) -> (u16, u16) {
        let code = match self {
            Self::Off => 0,
            Self::A => 0b100,
            Self::B => 0b101,
            Self::C => 0b110,
            Self::D => 0b111,
        };
        (code * 0b001_001_001_001_001, code)
    }
}

/// Settings.
///
/// | field | unit | zero means | sane value |
/// |---|---|---|---|
/// | `dec_rate` | base samples less one | 4250 samples a second | 20: 202.4 a second |
/// | `fir` | | no filter | `Off`: a filter delays and breaks the mean |
/// | `data_ready` | | DIO1 | DIO2 |
/// | `linear_g` | | not compensated | true |
/// | `point_of_percussion` | | every accelerometer at its own place | true |
///
/// Data-ready is active high. Continuous bias estimation is always switched off: at rest it would learn
/// Earth's rate as a bias and remove what the unit measures.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Config {
    /// DEC_RATE: the mean of `dec_rate + 1` base samples makes one sample.
    pub dec_rate: u16,
    /// FIR filter.
    pub fir: Fir,
    /// Line of data-ready.
    pub data_ready: Line,
    /// Compensate the gyroscopes for linear acceleration.
    pub linear_g: bool,
    /// Refer the accelerometers to one point.
    pub point_of_percussion: bool,
}

impl Default for Config {
    fn default() -> Self {
        Self {
            dec_rate: 20,
            fir: Fir::Off,
            data_ready: Line::Dio2,
            linear_g: true,
            point_of_percussion: true,
        }
    }
}

impl Config {
    /// The settings as register, word and time to take effect in µs, in the order of writing.
    pub const fn words(&self) -> [(Register, u16, u32); 6] {
        let (bank_0, bank_1) = self.fir.words();
        let mut config = 0;
        if self.linear_g {
            config |= compensation::LINEAR_G;
        }
        if self.point_of_percussion {
            config |= compensation::POINT_OF_PERCUSSION;
        }
        let line = self.data_ready as u16;
        [
            (register::CONFIG, config, 45),
            (register::NULL_CNFG, 0, 71),
            (register::FILTR_BNK_0, bank_0, 65),
            (register::FILTR_BNK_1, bank_1, 65),
            (register::DEC_RATE, self.dec_rate, 340),
            (
                register::FNCTIO_CTRL,
                function::DATA_READY | function::DATA_READY_HIGH | line,
                340,
            ),
        ]
    }
}

/// The driver. Give it an SPI device in mode 3 and a delay.
#[derive(Debug)]
pub struct Adis16495<SPI, D> {
    spi: SPI,
    delay: D,
    /// The page the part has selected, as far as known.
    page: Option<u8>,
    dec_rate: u16,
}

impl<SPI: SpiDevice, D: DelayNs> Adis16495<SPI, D> {
    /// A driver that knows nothing of its part yet.
    pub fn new(spi: SPI, delay: D) -> Self {
        Self {
            spi,
            delay,
            page: None,
            dec_rate: 0,
        }
    }

    /// Gives bus and delay back.
    pub fn release(self) -> (SPI, D) {
        (self.spi, self.delay)
    }

    async fn frame(&mut self, word: [u8; 2]) -> Result<u16, Error> {
        let mut buffer = word;
        self.spi
            .transaction(&mut [Operation::TransferInPlace(&mut buffer), Operation::DelayNs(STALL_NS)])
            .await
            .map_err(Error::bus)?;
        Ok(u16::from_be_bytes(buffer))
    }

    async fn select(&mut self, page: u8) -> Result<(), Error> {
        if self.page == Some(page) {
            return Ok(());
        }
        self.page = None;
        self.frame([WRITE | register::PAGE_ID, page]).await?;
        self.page = Some(page);
        Ok(())
    }

    /// Reads a register.
    ///
    /// Cancellation: safe to repeat; the reply of a dropped read is overwritten by the next frame's.
    ///
    /// # Errors
    /// [`Error::Bus`].
    pub async fn read(&mut self, register: Register) -> Result<u16, Error> {
        self.select(register.page).await?;
        self.frame([register.address, 0]).await?;
        self.frame([register::PAGE_ID, 0]).await
    }

    /// Writes a register, low byte first; the part acts on the high byte.
    ///
    /// Cancellation: not safe; a dropped call may have written the low byte only. Write again.
    ///
    /// # Errors
    /// [`Error::Bus`].
    pub async fn write(&mut self, register: Register, value: u16) -> Result<(), Error> {
        self.select(register.page).await?;
        let [high, low] = value.to_be_bytes();
        self.frame([WRITE | register.address, low]).await?;
        self.frame([WRITE | (register.address + 1), high]).await?;
        Ok(())
    }

    /// The part's own flags. Reading clears them; those whose cause lasts come back.
    ///
    /// Cancellation: a dropped call may lose the flags.
    ///
    /// # Errors
    /// [`Error::Bus`].
    pub async fn system_flags(&mut self) -> Result<SystemFlags, Error> {
        self.read(register::SYS_E_FLAG).await.map(SystemFlags::from_bits)
    }
}

impl<SPI: SpiDevice, D: DelayNs> Imu for Adis16495<SPI, D> {
    type Config = Config;

    /// Waits [`POWER_UP_MS`]: long enough for the reset, and for a part that was still starting and
    /// did not hear the command.
    async fn reset(&mut self) -> Result<(), Error> {
        let sent = self.write(register::GLOB_CMD, command::SOFTWARE_RESET).await;
        self.page = None;
        sent?;
        self.delay.delay_ms(POWER_UP_MS).await;
        Ok(())
    }

    async fn identify(&mut self) -> Result<Identity, Error> {
        let product = self.read(register::PROD_ID).await?;
        if product != PRODUCT {
            // Whatever is there, its page is not known.
            self.page = None;
            return Err(Error::WhoAmI {
                expected: PRODUCT,
                found: product,
            });
        }
        let range = self.read(register::RANG_MDL).await?;
        if range != RANGE_125_DPS {
            return Err(Error::Model {
                expected: RANGE_125_DPS,
                found: range,
            });
        }
        Ok(Identity {
            product,
            revision: self.read(register::FIRM_REV).await?,
            serial: self.read(register::SERIAL_NUM).await?,
        })
    }

    async fn self_test(&mut self) -> Result<(), Error> {
        // Flags of the past are not the test's.
        self.read(register::DIAG_STS).await?;
        self.write(register::GLOB_CMD, command::SELF_TEST).await?;
        // A quarter more than the part needs: its clock is its own.
        self.delay.delay_ms(SELF_TEST_MS + SELF_TEST_MS / 4).await;
        let flags = self.system_flags().await?;
        let failed = Channels::from_bits(self.read(register::DIAG_STS).await?.to_le_bytes()[0]);
        if !failed.is_empty() {
            Err(Error::SelfTest { failed })
        } else if flags.contains(SystemFlags::SENSOR) {
            Err(Error::SelfTest { failed: Channels::ALL })
        } else {
            Ok(())
        }
    }

    async fn configure(&mut self, config: &Config) -> Result<(), Error> {
        if config.dec_rate > DEC_RATE_MAX {
            return Err(Error::Config {
                address: register::DEC_RATE.code(),
                value: config.dec_rate,
            });
        }
        for (register, value, settle_us) in config.words() {
            self.write(register, value).await?;
            self.delay.delay_us(settle_us).await;
            let read = self.read(register).await?;
            if read != value {
                return Err(Error::Register {
                    address: register.code(),
                    wrote: value,
                    read,
                });
            }
        }
        self.dec_rate = config.dec_rate;
        // Ready for bursts: the first sample should not pay for the change of page.
        self.select(0).await
    }

    async fn sample(&mut self) -> Result<RawSample, Error> {
        self.select(0).await?;
        let mut buffer = [0; BURST_LEN];
        [buffer[0], buffer[1]] = BURST_COMMAND.to_be_bytes();
        self.spi
            .transaction(&mut [Operation::TransferInPlace(&mut buffer), Operation::DelayNs(STALL_NS)])
            .await
            .map_err(Error::bus)?;
        let sample = parse_burst(&buffer);
        if matches!(sample, Err(Error::Header { .. })) {
            // A part that was reset or answers on another page has no burst: select page 0 anew.
            self.page = None;
        }
        sample
    }

    fn scale(&self) -> Scale {
        Scale {
            rate: RATE_PER_COUNT as f32,
            force: FORCE_PER_COUNT as f32,
            temperature_c: TEMPERATURE_PER_COUNT_C as f32,
            temperature_zero_c: TEMPERATURE_ZERO_C as f32,
        }
    }

    fn period(&self) -> f32 {
        (f32::from(self.dec_rate) + 1.0) / BASE_RATE_HZ as f32
    }

    fn delay_us(&self) -> u32 {
        DELAY_US
    }

    fn base_samples(&self) -> NonZeroU16 {
        NonZeroU16::MIN.saturating_add(self.dec_rate)
    }
}

/// Reads the words of a burst: finds the identifier, checks the check sum, sorts the words.
///
/// # Errors
/// [`Error::Silent`], [`Error::Header`], [`Error::Crc`].
pub fn parse_burst(reply: &[u8; BURST_LEN]) -> Result<RawSample, Error> {
    let mut words = [0_u16; BURST_LEN / 2];
    for (word, bytes) in words.iter_mut().zip(reply.chunks_exact(2)) {
        *word = u16::from_be_bytes([bytes[0], bytes[1]]);
    }
    // Word 0 was clocked while the command went out and means nothing.
    let start = match (words[1], words[2]) {
        (_, BURST_ID) => 3,
        (BURST_ID, _) => 2,
        (found, _) => {
            let level = reply[2];
            return Err(
                if matches!(level, 0 | 0xFF) && reply[2..].iter().all(|byte| *byte == level) {
                    Error::Silent { level }
                } else {
                    Error::Header { found }
                },
            );
        }
    };
    let data = &words[start..start + BURST_WORDS];
    let computed = burst_crc(data);
    let received = long(words[start + BURST_WORDS], words[start + BURST_WORDS + 1]).cast_unsigned();
    if computed != received {
        return Err(Error::Crc { computed, received });
    }
    let rate = RateCounts([long(data[2], data[3]), long(data[4], data[5]), long(data[6], data[7])]);
    let force = ForceCounts([
        long(data[8], data[9]),
        long(data[10], data[11]),
        long(data[12], data[13]),
    ]);
    Ok(RawSample {
        rate,
        force,
        temperature: TemperatureCounts(data[1].cast_signed()),
        sequence: Sequence::Counter(data[14]),
        status: Status {
            saturated: Channels::where_counts(
                rate,
                force,
                |c| c.unsigned_abs() >= RATE_RANGE_COUNTS.unsigned_abs(),
                |c| c.unsigned_abs() >= FORCE_RANGE_COUNTS.unsigned_abs(),
            ),
            system: SystemFlags::from_bits(data[0]),
        },
    })
}

/// The check sum of a burst's words.
pub fn burst_crc(words: &[u16]) -> u32 {
    crc32(words.iter().flat_map(|word| word.to_le_bytes()))
}

/// Low word first, as in the burst.
fn long(low: u16, high: u16) -> i32 {
    ((u32::from(high) << 16) | u32::from(low)).cast_signed()
}

#[cfg(test)]
mod tests {
    use std::vec::Vec;

    use embedded_hal_async::spi::ErrorKind;
    use proptest::prelude::*;

    use super::*;
    use crate::testing::{BrokenBus, CheckedDelay, Mock, NoopDelay, Wait, block_on, exchange};

    type Steps = Vec<embedded_hal_mock::eh1::spi::Transaction<u8>>;

    fn frame(sent: u16, received: u16) -> Steps {
        exchange(&sent.to_be_bytes(), &received.to_be_bytes(), 5_000)
    }

    fn page(number: u16) -> Steps {
        frame(0x8000 | number, 0)
    }

    fn read(address: u16, value: u16) -> Steps {
        [frame(address << 8, 0), frame(0, value)].concat()
    }

    fn write(address: u16, value: u16) -> Steps {
        [
            frame(0x8000 | (address << 8) | (value & 0xFF), 0),
            frame(0x8000 | ((address + 1) << 8) | (value >> 8), 0),
        ]
        .concat()
    }

    /// Runs `body` on a driver whose bus expects `steps`, to the last one.
    fn on_bus<T>(steps: &[Steps], body: impl AsyncFnOnce(&mut Adis16495<Mock<u8>, NoopDelay>) -> T) -> T {
        let mut bus = Mock::new(&steps.concat());
        let mut imu = Adis16495::new(bus.clone(), NoopDelay);
        let result = block_on(body(&mut imu));
        bus.done();
        result
    }

    const DATA: [u16; BURST_WORDS] = [
        0x0000, 0x0050, // no flags, 26 °C
        0x8000, 0x0001, // x rate 1.5 upper counts
        0x0000, 0xFFFF, // y rate −1
        0x0000, 0x0C80, // z rate 3200 = 20 °/s
        0x0000, 0x0000, // x force 0
        0x4000, 0xFF9C, // y force −99.75
        0x0000, 0x0FA0, // z force 4000 = 1 g
        0xFFFE, // counter
    ];

    fn burst(ids: usize, data: &[u16; BURST_WORDS]) -> [u8; BURST_LEN] {
        let crc = burst_crc(data);
        let mut words = std::vec![0x1234];
        words.extend(core::iter::repeat_n(BURST_ID, ids));
        words.extend_from_slice(data);
        words.extend([crc as u16, (crc >> 16) as u16]);
        words.resize(BURST_LEN / 2, 0);
        let mut bytes = [0; BURST_LEN];
        for (pair, word) in bytes.chunks_exact_mut(2).zip(words) {
            pair.copy_from_slice(&word.to_be_bytes());
        }
        bytes
    }

    fn burst_request() -> [u8; BURST_LEN] {
        let mut sent = [0; BURST_LEN];
        sent[0] = 0x7C;
        sent
    }

    #[test]
    fn identify_reads_product_range_revision_serial() {
        let steps = [
            page(0),
            read(0x7E, 16495),
            page(3),
            read(0x12, 3),
            read(0x78, 0x0105),
            page(4),
            read(0x20, 77),
        ];
        assert_eq!(
            on_bus(&steps, async |imu| imu.identify().await),
            Ok(Identity {
                product: 0x406F,
                revision: 0x0105,
                serial: 77
            })
        );
    }

    #[test]
    fn another_product_is_refused_and_the_page_forgotten() {
        let steps = [page(0), read(0x7E, 16497), page(0), read(0x7E, 0xFFFF)];
        on_bus(&steps, async |imu| {
            for found in [16497, 0xFFFF] {
                assert_eq!(imu.identify().await, Err(Error::WhoAmI { expected: 16495, found }));
            }
        });
    }

    #[test]
    fn another_range_is_refused() {
        let steps = [page(0), read(0x7E, 16495), page(3), read(0x12, 7)];
        assert_eq!(
            on_bus(&steps, async |imu| imu.identify().await),
            Err(Error::Model { expected: 3, found: 7 })
        );
    }

    #[test]
    fn reset_waits_and_forgets_the_page() {
        let mut bus = Mock::new(&[page(3), write(0x02, 0x0080), page(3), read(0x0C, 0)].concat());
        let mut delay = CheckedDelay::new(&[Wait::async_delay_ms(350)]);
        let mut imu = Adis16495::new(bus.clone(), delay.clone());
        block_on(imu.reset()).unwrap();
        block_on(imu.read(register::DEC_RATE)).unwrap();
        bus.done();
        delay.done();
    }

    fn self_test_steps(flags: u16, diag: u16) -> [Steps; 6] {
        [
            page(0),
            read(0x0A, 0x003F),
            page(3),
            write(0x02, 0x0002),
            [page(0), read(0x08, flags)].concat(),
            read(0x0A, diag),
        ]
    }

    #[test]
    fn self_test_passes_and_fails_with_its_sensors() {
        for (flags, diag, expected) in [
            (0, 0, Ok(())),
            (
                0x0020,
                0x0014,
                Err(Error::SelfTest {
                    failed: Channels::RATE_Z | Channels::FORCE_Y,
                }),
            ),
            (0x0020, 0, Err(Error::SelfTest { failed: Channels::ALL })),
            (0x0100, 0, Ok(())),
        ] {
            assert_eq!(
                on_bus(&self_test_steps(flags, diag), async |imu| imu.self_test().await),
                expected
            );
        }
    }

    #[test]
    fn self_test_waits() {
        let mut bus = Mock::new(&self_test_steps(0, 0).concat());
        let mut delay = CheckedDelay::new(&[Wait::async_delay_ms(62)]);
        block_on(Adis16495::new(bus.clone(), delay.clone()).self_test()).unwrap();
        bus.done();
        delay.done();
    }

    #[test]
    fn configure_writes_waits_and_reads_back() {
        let steps = [
            page(3),
            write(0x0A, 0x0080),
            read(0x0A, 0x0080),
            write(0x0E, 0),
            read(0x0E, 0),
            write(0x16, 0x5B6D),
            read(0x16, 0x5B6D),
            write(0x18, 0x0005),
            read(0x18, 0x0005),
            write(0x0C, 424),
            read(0x0C, 424),
            write(0x06, 0x000C),
            read(0x06, 0x000C),
            page(0),
        ];
        let mut bus = Mock::new(&steps.concat());
        let mut delay = CheckedDelay::new(&[45, 71, 65, 65, 340, 340].map(Wait::async_delay_us));
        let mut imu = Adis16495::new(bus.clone(), delay.clone());
        let config = Config {
            dec_rate: 424,
            fir: Fir::B,
            data_ready: Line::Dio1,
            linear_g: true,
            point_of_percussion: false,
        };
        block_on(imu.configure(&config)).unwrap();
        assert!((imu.period() - 0.1).abs() < 1e-9);
        bus.done();
        delay.done();
    }

    #[test]
    fn a_setting_that_does_not_take_is_named() {
        let steps = [page(3), write(0x0A, 0x00C0), read(0x0A, 0x0040)];
        assert_eq!(
            on_bus(&steps, async |imu| imu.configure(&Config::default()).await),
            Err(Error::Register {
                address: 0x030A,
                wrote: 0x00C0,
                read: 0x0040
            })
        );
    }

    #[test]
    fn an_impossible_rate_is_refused_before_the_bus() {
        let config = Config {
            dec_rate: 4250,
            ..Config::default()
        };
        assert_eq!(
            on_bus(&[], async |imu| imu.configure(&config).await),
            Err(Error::Config {
                address: 0x030C,
                value: 4250
            })
        );
    }

    #[test]
    fn a_burst_is_one_transaction_and_selects_its_page_once() {
        let burst_step = |ids| exchange(&burst_request(), &burst(ids, &DATA), 5_000);
        let samples = on_bus(&[page(0), burst_step(1), burst_step(2)], async |imu| {
            [imu.sample().await.unwrap(), imu.sample().await.unwrap()]
        });
        assert_eq!(samples[0], samples[1]);
        let raw = samples[0];
        assert_eq!(raw.rate, RateCounts([0x0001_8000, -0x1_0000, 3200 << 16]));
        assert_eq!(raw.force, ForceCounts([0, -0x0063_C000, 4000 << 16]));
        assert_eq!(raw.temperature, TemperatureCounts(80));
        assert_eq!(raw.sequence, Sequence::Counter(0xFFFE));
        assert!(raw.status.is_good());

        let si = Adis16495::new(BrokenBus, NoopDelay).scale().si(&raw);
        let w_dps = si.w_is_s.to_array().map(|w| f64::from(w) / DEG);
        assert!((w_dps[0] - 1.5 / 160.0).abs() < 1e-8, "{w_dps:?}");
        assert!((w_dps[1] + 1.0 / 160.0).abs() < 1e-8, "{w_dps:?}");
        assert!((w_dps[2] - 20.0).abs() < 1e-5, "{w_dps:?}");
        assert!((f64::from(si.f_is_s.z()) - STANDARD_GRAVITY).abs() < 1e-6);
        assert!((si.temperature_c - 26.0).abs() < 1e-6);
    }

    #[test]
    fn a_wrong_check_sum_carries_both() {
        let mut reply = burst(2, &DATA);
        reply[20] ^= 0x10;
        let steps = [page(0), exchange(&burst_request(), &reply, 5_000)];
        let Err(Error::Crc { computed, received }) = on_bus(&steps, async |imu| imu.sample().await) else {
            panic!("accepted");
        };
        assert_eq!(received, burst_crc(&DATA));
        assert_ne!(computed, received);
    }

    #[test]
    fn silence_and_nonsense_select_the_page_again() {
        let steps = |reply: [u8; BURST_LEN]| exchange(&burst_request(), &reply, 5_000);
        on_bus(
            &[page(0), steps([0xFF; BURST_LEN]), steps([0; BURST_LEN])],
            async |imu| {
                for level in [0xFF, 0] {
                    assert_eq!(imu.sample().await, Err(Error::Silent { level }));
                }
            },
        );
        let nonsense = core::array::from_fn(|k| k as u8);
        on_bus(
            &[page(0), steps(nonsense), page(0), steps(burst(2, &DATA))],
            async |imu| {
                assert_eq!(imu.sample().await, Err(Error::Header { found: 0x0203 }));
                assert!(imu.sample().await.is_ok());
            },
        );
    }

    #[test]
    fn flags_and_saturation_come_with_the_sample() {
        let mut data = DATA;
        data[0] = 0x8080;
        data[7] = 20_000;
        data[9] = (-32_000_i16).cast_unsigned();
        let status = parse_burst(&burst(1, &data)).unwrap().status;
        assert!(!status.is_good());
        assert_eq!(status.system, SystemFlags::WATCHDOG | SystemFlags::OVERRUN);
        assert_eq!(status.saturated, Channels::RATE_Z | Channels::FORCE_X);
    }

    #[test]
    fn bus_errors_keep_their_kind() {
        let mut imu = Adis16495::new(BrokenBus, NoopDelay);
        let expected = Error::Bus(ErrorKind::Overrun);
        assert_eq!(block_on(imu.identify()), Err(expected));
        assert_eq!(block_on(imu.reset()), Err(expected));
        assert_eq!(block_on(imu.self_test()), Err(expected));
        assert_eq!(block_on(imu.configure(&Config::default())), Err(expected));
        assert_eq!(block_on(imu.sample()), Err(expected));
        assert_eq!(imu.page, None);
    }

    proptest! {
        #[test]
        fn any_bytes_are_parsed(reply in proptest::collection::vec(any::<u8>(), BURST_LEN)) {
            let _ = parse_burst(&reply.try_into().unwrap());
        }

        /// A flipped bit is detected, or was outside the data and changes nothing.
        #[test]
        fn one_flipped_bit_never_alters_a_sample(
            data in any::<[u16; BURST_WORDS]>(),
            ids in 1..=2_usize,
            bit in 0..BURST_LEN * 8,
        ) {
            prop_assume!(data[0] != BURST_ID);
            let good = burst(ids, &data);
            let expected = parse_burst(&good).unwrap();
            let mut flipped = good;
            flipped[bit / 8] ^= 1 << (bit % 8);
            let word = bit / 16;
            match parse_burst(&flipped) {
                Ok(sample) => {
                    prop_assert!(word <= ids || word > ids + BURST_WORDS + 2, "word {word} accepted");
                    prop_assert_eq!(sample, expected);
                }
                Err(error) => {
                    let known = matches!(error, Error::Crc { .. } | Error::Header { .. });
                    prop_assert!(known, "{:?}", error);
                }
            }
        }
    }
}
