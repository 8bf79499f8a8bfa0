//! MT6835: 21-bit absolute magnetic encoder of the rotor.
//!
//! # Bus
//!
//! SPI mode 3, most significant bit first, ≤ 16 MHz. A command is four bits of operation and twelve of
//! address. A register is one byte, and a write of it is answered by nothing: it is read back. The part sends
//! 0x55 only for the operations that take no byte, programming of the EEPROM and auto-zero, which are not used
//! here. The angle is read in one burst of six:
//!
//! ```text
//! MOSI  0xA0 0x03   0        0       0           0
//! MISO  …    …      a20…a13  a12…a5  a4…a0 www   CRC       www = under-voltage, weak field, over-speed
//! ```
//!
//! The CRC is CRC-8 with polynomial 0x07 from 0 over the three bytes before it. From 0 means that a line
//! stuck low reads as a faultless angle 0. The part has no identity either. Both are met by a mark:
//! [`Mt6835::identify`] writes [`MARK`] into the user's identification register (RAM only) and reads it
//! back; a frame of nothing but zeros is believed only if the mark is still there. That costs one more
//! transaction on one reading in two million.
//!
//! # Figures and where they come from
//!
//! | figure | source |
//! |---|---|
//! | operations, register addresses, warning bits | SimpleFOC `MT6835.h` |
//! | 0x55 after EEPROM programming (0xC) and auto-zero (0x5) only | SimpleFOC `MT6835.cpp`, `setZeroFromCurrentPosition` and `writeEEPROM`: the only two that look for it |
//! | hysteresis code 7 (0.011°) as delivered, 4 is none | public drivers of the part; data sheet not at hand |
//! | CRC: polynomial, initial value, order of bits | SimpleFOC `MT6835.cpp` |
//! | 16 MHz | the project's design notes; not found in a source at hand |
//!
//! # Not verified
//!
//! Nothing here has run on a part. Open in particular: that a write takes operation 0b0110 (SimpleFOC
//! names it, but sends the operation of a read), and what a byte write shows in its third byte. Nothing depends on
//! the latter: the register is read back.
//!
//! Not used: the part's own calibration and its table (the error is corrected by
//! [`Harmonics`](crate::harmonics::Harmonics), which can be inspected), the incremental outputs, the
//! EEPROM.

use embedded_hal_async::spi::{Operation, SpiDevice};

use crate::Error;
use crate::crc::crc8;

/// Counts in a turn, 2²¹.
pub const COUNTS_PER_TURN: u32 = 1 << 21;
/// What identifies the part once it was written, in [`register::USER_ID`].
pub const MARK: u8 = 0x5A;
/// Bytes of an angle burst.
pub const BURST_LEN: usize = 6;

/// Operations, in the upper four bits of a command.
pub mod operation {
    /// Read a register.
    pub const READ: u8 = 0b0011;
    /// Write a register.
    pub const WRITE: u8 = 0b0110;
    /// Read the angle in one burst.
    pub const ANGLE: u8 = 0b1010;
}

/// The registers in use.
pub mod register {
    /// The user's identification.
    pub const USER_ID: u16 = 0x001;
    /// First byte of the angle.
    pub const ANGLE: u16 = 0x003;
    /// Direction of rotation in bit 3, hysteresis in bits 2 to 0.
    pub const DIRECTION_HYSTERESIS: u16 = 0x00D;
    /// Bandwidth in bits 2 to 0.
    pub const BANDWIDTH: u16 = 0x011;
}

/// The two bytes of a command.
pub const fn command(operation: u8, register: u16) -> [u8; 2] {
    let [high, low] = register.to_be_bytes();
    [(operation << 4) | (high & 0x0F), low]
}

/// An angle as the part sends it: 0 to 2²¹ − 1 counts in a turn.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Default)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct AngleCounts(u32);

impl AngleCounts {
    /// These counts, modulo a turn.
    pub const fn new(counts: u32) -> Self {
        Self(counts & (COUNTS_PER_TURN - 1))
    }

    /// The counts.
    pub const fn get(self) -> u32 {
        self.0
    }

    /// The angle in [0, 2π), rad. Exact to half an ulp: 21 bits fit into f32.
    pub fn radians(self) -> f32 {
        self.0 as f32 * (core::f32::consts::TAU / COUNTS_PER_TURN as f32)
    }

    /// From `earlier` to this the short way round, counts in [−2²⁰, 2²⁰).
    pub const fn since(self, earlier: Self) -> i32 {
        // Shifted to the top, the difference wraps where the turn does.
        (self.0.wrapping_sub(earlier.0) << 11).cast_signed() >> 11
    }
}

/// What the part warns of, with every reading.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Warnings(u8);

impl Warnings {
    /// Nothing.
    pub const NONE: Self = Self(0);
    /// The magnet turns faster than the part follows.
    pub const OVER_SPEED: Self = Self(1);
    /// The magnet is too weak or too far: the angle is noisy.
    pub const WEAK_FIELD: Self = Self(1 << 1);
    /// The supply is too low.
    pub const UNDER_VOLTAGE: Self = Self(1 << 2);

    /// From the three bits of a reading; others are dropped.
    pub const fn from_bits(bits: u8) -> Self {
        Self(bits & 0b111)
    }

    /// The three bits.
    pub const fn bits(self) -> u8 {
        self.0
    }

    /// Whether there is nothing to warn of.
    pub const fn is_empty(self) -> bool {
        self.0 == 0
    }

    /// Whether all of `other` are set.
    pub const fn contains(self, other: Self) -> bool {
        self.0 & other.0 == other.0
    }
}

impl core::ops::BitOr for Warnings {
    type Output = Self;
    fn bitor(self, other: Self) -> Self {
        Self(self.0 | other.0)
    }
}

/// One reading.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Reading {
    /// The angle.
    pub angle: AngleCounts,
    /// What the part warns of.
    pub warnings: Warnings,
}

/// Settings.
///
/// | field | unit | zero means | sane value |
/// |---|---|---|---|
/// | `bandwidth` | code 0–7 | the part's code 0 | the part's default, 5 |
/// | `hysteresis` | code 0–7 | the part's code 0, 0.022° | as delivered, 7 (0.011°); 4 is none |
/// | `reversed` | | the angle grows as the part has it | so that α grows counter-clockwise from above |
///
/// What the codes stand for was not found in a source at hand: set them from the data sheet.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Config {
    /// Bandwidth code.
    pub bandwidth: u8,
    /// Hysteresis code.
    pub hysteresis: u8,
    /// Count the other way.
    pub reversed: bool,
}

impl Default for Config {
    fn default() -> Self {
        Self {
            bandwidth: 5,
            hysteresis: 7,
            reversed: false,
        }
    }
}

/// The driver. Give it an SPI device in mode 3.
#[derive(Debug)]
pub struct Mt6835<SPI> {
    spi: SPI,
}

impl<SPI: SpiDevice> Mt6835<SPI> {
    /// A driver that has not spoken to its part yet.
    pub fn new(spi: SPI) -> Self {
        Self { spi }
    }

    /// Gives the bus back.
    pub fn release(self) -> SPI {
        self.spi
    }

    async fn exchange(&mut self, bytes: &mut [u8]) -> Result<(), Error> {
        self.spi
            .transaction(&mut [Operation::TransferInPlace(bytes)])
            .await
            .map_err(Error::bus)
    }

    async fn read_register(&mut self, register: u16) -> Result<u8, Error> {
        let [high, low] = command(operation::READ, register);
        let mut buffer = [high, low, 0];
        self.exchange(&mut buffer).await?;
        Ok(buffer[2])
    }

    async fn write_register(&mut self, register: u16, value: u8) -> Result<(), Error> {
        let [high, low] = command(operation::WRITE, register);
        let mut buffer = [high, low, value];
        self.exchange(&mut buffer).await?;
        let read = self.read_register(register).await?;
        if read != value {
            return Err(Error::Register {
                address: register,
                wrote: u16::from(value),
                read: u16::from(read),
            });
        }
        Ok(())
    }

    /// Marks the part and finds the mark again: proof that something with registers is there. Call it
    /// before the first [`read`](Self::read), and again after the part has lost its supply.
    ///
    /// Cancellation: safe to repeat.
    ///
    /// # Errors
    /// [`Error::Register`], [`Error::Bus`].
    pub async fn identify(&mut self) -> Result<(), Error> {
        self.write_register(register::USER_ID, MARK).await
    }

    /// Writes the settings into the part's RAM and reads them back. Bits that are not ours stay.
    ///
    /// Cancellation: not safe. A dropped call leaves some settings written: call it again.
    ///
    /// # Errors
    /// [`Error::Config`] before anything is written, [`Error::Register`], [`Error::Bus`].
    pub async fn configure(&mut self, config: &Config) -> Result<(), Error> {
        let direction = (u8::from(config.reversed) << 3) | (config.hysteresis & 0b111);
        let settings = [
            (register::DIRECTION_HYSTERESIS, config.hysteresis, 0b1111, direction),
            (register::BANDWIDTH, config.bandwidth, 0b111, config.bandwidth & 0b111),
        ];
        for (address, code, _, _) in settings {
            if code > 0b111 {
                return Err(Error::Config {
                    address,
                    value: u16::from(code),
                });
            }
        }
        for (address, _, mask, value) in settings {
            let others = self.read_register(address).await? & !mask;
            self.write_register(address, others | value).await?;
        }
        Ok(())
    }

    /// Reads the angle.
    ///
    /// Cancellation: safe; a dropped call loses the reading.
    ///
    /// # Errors
    /// [`Error::Crc`], [`Error::Silent`], [`Error::Bus`]. Warnings are no error: they come with the
    /// reading.
    pub async fn read(&mut self) -> Result<Reading, Error> {
        let mut buffer = [0; BURST_LEN];
        [buffer[0], buffer[1]] = command(operation::ANGLE, register::ANGLE);
        self.exchange(&mut buffer).await?;
        let [_, _, reply @ ..] = buffer;
        let reading = parse_burst(reply)?;
        if reply == [0; 4] && self.read_register(register::USER_ID).await? != MARK {
            return Err(Error::Silent { level: 0 });
        }
        Ok(reading)
    }
}

/// Reads the four bytes of an angle burst. All zeros are angle 0: whether to believe it is the caller's
/// affair.
///
/// # Errors
/// [`Error::Silent`] where the line is stuck high, [`Error::Crc`].
pub fn parse_burst(reply: [u8; 4]) -> Result<Reading, Error> {
    let [high, middle, low, received] = reply;
    let computed = crc8([high, middle, low]);
    if computed != received {
        return Err(if reply == [0xFF; 4] {
            Error::Silent { level: 0xFF }
        } else {
            Error::Crc {
                computed: u32::from(computed),
                received: u32::from(received),
            }
        });
    }
    Ok(Reading {
        angle: AngleCounts(u32::from_be_bytes([0, high, middle, low]) >> 3),
        warnings: Warnings::from_bits(low),
    })
}

/// The four bytes of an angle burst, as the part sends them. For models of it.
pub fn burst(reading: Reading) -> [u8; 4] {
    let [_, high, middle, low] = ((reading.angle.0 << 3) | u32::from(reading.warnings.0)).to_be_bytes();
    [high, middle, low, crc8([high, middle, low])]
}

#[cfg(test)]
mod tests {
    use embedded_hal_async::spi::ErrorKind;
    use proptest::prelude::*;

    use super::*;
    use crate::testing::{BrokenBus, Mock, block_on, exchange};

    type Step = std::vec::Vec<embedded_hal_mock::eh1::spi::Transaction<u8>>;

    fn on_bus<T>(steps: &[Step], body: impl AsyncFnOnce(&mut Mt6835<Mock<u8>>) -> T) -> T {
        let mut bus = Mock::new(&steps.concat());
        let result = block_on(body(&mut Mt6835::new(bus.clone())));
        bus.done();
        result
    }

    fn read_register(address: u8, value: u8) -> Step {
        exchange(&[0x30, address, 0], &[0, 0, value], 0)
    }

    fn write_register(address: u8, value: u8, reply: u8) -> Step {
        exchange(&[0x60, address, value], &[0, 0, reply], 0)
    }

    fn angle(reply: [u8; 4]) -> Step {
        let [a, b, c, d] = reply;
        exchange(&[0xA0, 0x03, 0, 0, 0, 0], &[0xFF, 0xFF, a, b, c, d], 0)
    }

    #[test]
    fn angle_burst() {
        // 0x123456 = 1193046 counts; 0x123456 << 3 = 0x91A2B0; weak field and over-speed.
        let reply = [0x91, 0xA2, 0xB3, crc8([0x91, 0xA2, 0xB3])];
        let reading = on_bus(&[angle(reply)], async |e| e.read().await).unwrap();
        assert_eq!(reading.angle.get(), 0x12_3456);
        assert_eq!(reading.warnings, Warnings::WEAK_FIELD | Warnings::OVER_SPEED);
        let turns = f64::from(reading.angle.radians()) / core::f64::consts::TAU;
        assert!((turns - 1_193_046.0 / 2_097_152.0).abs() < 1e-7);
        assert_eq!(burst(reading), reply);
    }

    #[test]
    fn wrong_check_sum() {
        let good = burst(Reading {
            angle: AngleCounts::new(77),
            warnings: Warnings::NONE,
        });
        let mut bad = good;
        bad[3] ^= 1;
        assert_eq!(
            on_bus(&[angle(bad)], async |e| e.read().await),
            Err(Error::Crc {
                computed: u32::from(good[3]),
                received: u32::from(bad[3])
            })
        );
    }

    #[test]
    fn stuck_high() {
        assert_eq!(
            on_bus(&[angle([0xFF; 4])], async |e| e.read().await),
            Err(Error::Silent { level: 0xFF })
        );
    }

    #[test]
    fn zero_is_believed_with_the_mark_only() {
        let steps = |mark| [angle([0; 4]), read_register(0x01, mark)];
        let reading = on_bus(&steps(MARK), async |e| e.read().await).unwrap();
        assert_eq!(reading.angle, AngleCounts::new(0));
        assert_eq!(
            on_bus(&steps(0), async |e| e.read().await),
            Err(Error::Silent { level: 0 })
        );
    }

    #[test]
    fn identify_marks_and_finds_the_mark() {
        // Whatever the line shows during a byte write is no answer.
        for shown in [0x00, 0x55, 0xFF] {
            let steps = [write_register(0x01, 0x5A, shown), read_register(0x01, 0x5A)];
            assert_eq!(on_bus(&steps, async |e| e.identify().await), Ok(()));
        }
        let steps = [write_register(0x01, 0x5A, 0x55), read_register(0x01, 0x00)];
        assert_eq!(
            on_bus(&steps, async |e| e.identify().await),
            Err(Error::Register {
                address: 1,
                wrote: 0x5A,
                read: 0
            })
        );
    }

    #[test]
    fn configure_keeps_foreign_bits() {
        let steps = [
            read_register(0x0D, 0xA5),
            write_register(0x0D, 0xAA, 0),
            read_register(0x0D, 0xAA),
            read_register(0x11, 0xF8),
            write_register(0x11, 0xFF, 0),
            read_register(0x11, 0xFF),
        ];
        let config = Config {
            bandwidth: 7,
            hysteresis: 2,
            reversed: true,
        };
        on_bus(&steps, async |e| e.configure(&config).await).unwrap();
    }

    #[test]
    fn impossible_codes_are_refused_before_the_bus() {
        let config = Config {
            bandwidth: 8,
            ..Config::default()
        };
        assert_eq!(
            on_bus(&[], async |e| e.configure(&config).await),
            Err(Error::Config {
                address: 0x011,
                value: 8
            })
        );
    }

    #[test]
    fn bus_errors_keep_their_kind() {
        let expected = Err(Error::Bus(ErrorKind::Overrun));
        let mut encoder = Mt6835::new(BrokenBus);
        assert_eq!(block_on(encoder.identify()), expected);
        assert_eq!(block_on(encoder.configure(&Config::default())), expected);
        assert_eq!(block_on(encoder.read()).map(drop), expected);
    }

    #[test]
    fn differences_wrap_with_the_turn() {
        let at = AngleCounts::new;
        for (now, then, expected) in [
            (5, 3, 2),
            (3, 5, -2),
            (1, COUNTS_PER_TURN - 1, 2),
            (COUNTS_PER_TURN - 1, 1, -2),
            (1 << 20, 0, -(1 << 20)),
            ((1 << 20) - 1, 0, (1 << 20) - 1),
        ] {
            assert_eq!(at(now).since(at(then)), expected, "{now} {then}");
        }
        assert!(at(COUNTS_PER_TURN - 1).radians() < core::f32::consts::TAU);
    }

    proptest! {
        #[test]
        fn any_bytes_are_parsed(reply in any::<[u8; 4]>()) {
            let _ = parse_burst(reply);
        }

        #[test]
        fn one_flipped_bit_is_detected(counts in 0..COUNTS_PER_TURN, warnings in 0_u8..8, bit in 0..32_usize) {
            let reading = Reading { angle: AngleCounts::new(counts), warnings: Warnings::from_bits(warnings) };
            let good = burst(reading);
            prop_assert_eq!(parse_burst(good), Ok(reading));
            let mut bad = good;
            bad[bit / 8] ^= 1 << (bit % 8);
            prop_assert!(parse_burst(bad).is_err());
        }
    }
}
