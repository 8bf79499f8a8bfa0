//! The frames of the three parts, and the drivers on a bus that answers anything: [`drivers`].

use drivers::adis16495::{self, Adis16495};
use drivers::icm42688::{self, Icm42688};
use drivers::mt6835::{self, Mt6835, Reading};
use drivers::{Error, Imu, RawSample, Sequence, SystemFlags};
use embassy_futures::block_on;
use embedded_hal_async::delay::DelayNs;
use embedded_hal_async::spi::{ErrorKind, ErrorType, Operation, SpiDevice};

use crate::{Feed, crc8, crc32};

/// A burst: of two, one or no identifier before its words.
fn burst(feed: &mut Feed<'_>) -> [u8; adis16495::BURST_LEN] {
    let mut bytes = feed.array();
    sound_burst(&mut bytes, feed.u8());
    bytes
}

/// Makes identifiers and check sum right: of no burst, of one with one identifier, of one with two.
fn sound_burst(bytes: &mut [u8; adis16495::BURST_LEN], how: u8) {
    let ids = match how % 4 {
        0 => return,
        1 => 1,
        _ => 2,
    };
    for byte in &mut bytes[2..2 + 2 * ids] {
        *byte = 0xA5;
    }
    let start = 2 + 2 * ids;
    if ids == 1 && bytes[start..start + 2] == [0xA5; 2] {
        // Two identifiers then: the words begin later.
        return;
    }
    let sum = burst_sum(&bytes[start..start + 30]);
    bytes[start + 30..start + 34].copy_from_slice(&sum);
}

/// The check sum of big-endian words: over their low bytes first, its own low word first.
fn burst_sum(words: &[u8]) -> [u8; 4] {
    let swapped: [u8; 30] = core::array::from_fn(|k| words[k ^ 1]);
    let [a, b, c, d] = crc32(&swapped).to_be_bytes();
    [c, d, a, b]
}

/// A burst is taken if and only if an identifier is in its place and the check sum is right; what is taken are its words.
pub fn adis16495_burst(data: &[u8]) {
    check_burst(&burst(&mut Feed(data)));
}

fn check_burst(bytes: &[u8; adis16495::BURST_LEN]) -> Option<RawSample> {
    let start = match bytes {
        [_, _, _, _, 0xA5, 0xA5, ..] => Some(6),
        [_, _, 0xA5, 0xA5, ..] => Some(4),
        _ => None,
    };
    let sound = start.filter(|start| burst_sum(&bytes[*start..start + 30]) == bytes[start + 30..start + 34]);
    let found = adis16495::parse_burst(bytes);
    match (found, sound) {
        (Ok(sample), Some(start)) => {
            let word = |k: usize| u16::from_be_bytes([bytes[start + 2 * k], bytes[start + 2 * k + 1]]);
            let counts = sample.rate.0.iter().chain(&sample.force.0);
            for (k, count) in counts.enumerate() {
                assert_eq!(count.to_be_bytes()[..2], word(3 + 2 * k).to_be_bytes());
                assert_eq!(count.to_be_bytes()[2..], word(2 + 2 * k).to_be_bytes());
            }
            assert_eq!(sample.temperature.0.cast_unsigned(), word(1));
            assert_eq!(sample.sequence, Sequence::Counter(word(14)));
            assert_eq!(sample.status.system, SystemFlags::from_bits(word(0)));
        }
        (Err(Error::Crc { computed, received }), None) => {
            assert!(start.is_some());
            assert_ne!(computed, received);
        }
        (Err(Error::Header { .. }), None) => assert_eq!(start, None),
        (Err(Error::Silent { level }), None) => assert!(bytes[2..].iter().all(|byte| *byte == level)),
        other => panic!("{other:?}"),
    }
    found.ok()
}

/// Data are taken if no axis is marked invalid, the part was not reset and the line is not stuck.
pub fn icm42688_data(data: &[u8]) {
    check_data(&Feed(data).array());
}

fn check_data(data: &[u8; icm42688::DATA_LEN]) {
    let stuck = data.iter().all(|byte| *byte == data[0]) && matches!(data[0], 0 | 0xFF);
    let (words, status) = (&data[2..14], data[14 + 2]);
    let invalid = words.chunks(2).any(|word| word == [0x80, 0]);
    let good = !stuck && status & icm42688::event::RESET_DONE == 0 && !invalid;
    match icm42688::parse_data(data) {
        Ok(sample) => {
            assert!(good);
            for (count, word) in sample.force.0.iter().chain(&sample.rate.0).zip(words.chunks(2)) {
                assert_eq!(count.to_be_bytes()[2..], *word);
                assert!((-0x7FFF..=0x7FFF).contains(count));
            }
            assert_eq!(sample.temperature.0.to_be_bytes(), data[..2]);
        }
        Err(error) => assert!(!good, "{error:?}"),
    }
}

/// A reply is taken if and only if its check sum is right; what is taken makes the same reply.
pub fn mt6835_angle(data: &[u8]) {
    let mut feed = Feed(data);
    let mut reply = feed.array();
    check_angle(reply);
    reply[3] = crc8(&reply[..3]);
    assert!(check_angle(reply).is_some());
}

fn check_angle(reply: [u8; 4]) -> Option<Reading> {
    let found = mt6835::parse_burst(reply).ok();
    assert_eq!(found.is_some(), crc8(&reply[..3]) == reply[3]);
    if let Some(reading) = found {
        assert!(reading.angle.get() < mt6835::COUNTS_PER_TURN);
        assert!((0.0..core::f32::consts::TAU).contains(&reading.angle.radians()));
        assert_eq!(mt6835::burst(reading), reply);
    }
    found
}

/// A bus that answers with an input and fails where it ends. Long replies are made sound where the input says so: a
/// burst that is right by chance never comes.
struct Bus<'a> {
    feed: Feed<'a>,
    /// The reply last given.
    last: Vec<u8>,
}

impl ErrorType for Bus<'_> {
    type Error = ErrorKind;
}

impl SpiDevice for Bus<'_> {
    async fn transaction(&mut self, operations: &mut [Operation<'_, u8>]) -> Result<(), ErrorKind> {
        if self.feed.is_empty() {
            return Err(ErrorKind::Overrun);
        }
        for operation in operations {
            let bytes: &mut [u8] = match operation {
                Operation::Read(bytes) | Operation::TransferInPlace(bytes) | Operation::Transfer(bytes, _) => bytes,
                Operation::Write(_) | Operation::DelayNs(_) => continue,
            };
            let taken = self.feed.slice(bytes.len());
            bytes.fill(0);
            bytes[..taken.len()].copy_from_slice(taken);
            if let Ok(bytes) = (&mut *bytes).try_into() {
                sound_burst(bytes, self.feed.u8());
            } else if let [_, _, high, middle, low, sum] = bytes
                && self.feed.u8() & 1 == 1
            {
                *sum = crc8(&[*high, *middle, *low]);
            }
            self.last = bytes.to_vec();
        }
        Ok(())
    }
}

struct NoDelay;

impl DelayNs for NoDelay {
    async fn delay_ns(&mut self, _: u32) {}
}

/// What a board does with an IMU, in any order.
fn use_imu<I: Imu>(imu: &mut I, steps: u8, config: &I::Config) -> Option<RawSample> {
    let mut sample = None;
    for step in 0..8 {
        block_on(async {
            if steps >> step & 1 == 0 {
                sample = imu.sample().await.ok();
                return;
            }
            match step % 4 {
                0 => drop(imu.reset().await),
                1 => {
                    if let Ok(identity) = imu.identify().await {
                        assert!(matches!(identity.product, adis16495::PRODUCT | 0x47));
                    }
                }
                2 => drop(imu.configure(config).await),
                _ => drop(imu.self_test().await),
            }
        });
        assert!(imu.period() > 0.0 && imu.period() <= 1.0);
    }
    sample
}

/// The driver, whatever the part answers: a sample is what a sound burst says.
pub fn adis16495_bus(data: &[u8]) {
    let mut feed = Feed(data);
    let (steps, dec_rate) = (feed.u8(), feed.u16() % (adis16495::DEC_RATE_MAX + 2));
    let config = adis16495::Config {
        dec_rate,
        ..adis16495::Config::default()
    };
    let mut imu = Adis16495::new(Bus { feed, last: Vec::new() }, NoDelay);
    let sample = use_imu(&mut imu, steps, &config);
    let (bus, NoDelay) = imu.release();
    if steps >> 7 == 0 && sample.is_some() {
        assert_eq!(check_burst(bus.last[..].try_into().unwrap()), sample);
    }
}

/// The driver, whatever the part answers.
pub fn icm42688_bus(data: &[u8]) {
    let mut feed = Feed(data);
    let (steps, ranges) = (feed.u8(), feed.u8());
    let config = icm42688::Config {
        rate_range: icm42688::RateRange::from_code(ranges),
        force_range: icm42688::ForceRange::from_code(ranges >> 3),
        rate: icm42688::Rate::from_code(ranges >> 4).unwrap_or_default(),
    };
    let mut imu = Icm42688::new(Bus { feed, last: Vec::new() }, NoDelay);
    let _ = use_imu(&mut imu, steps, &config);
}

/// The driver, whatever the part answers: an angle is what a sound reply says, and all zeros are believed with the mark
/// only.
pub fn mt6835_bus(data: &[u8]) {
    let mut feed = Feed(data);
    let [steps, bandwidth, hysteresis] = feed.array();
    let config = mt6835::Config {
        bandwidth: bandwidth % 9,
        hysteresis: hysteresis % 9,
        reversed: steps & 1 == 1,
    };
    let mut encoder = Mt6835::new(Bus { feed, last: Vec::new() });
    if steps & 2 != 0 {
        let _ = block_on(encoder.identify());
    }
    if steps & 4 != 0 {
        let _ = block_on(encoder.configure(&config));
    }
    let found = block_on(encoder.read());
    let bus = encoder.release();
    if let Ok(reading) = found {
        match *bus.last {
            [_, _, a, b, c, d] => {
                assert_eq!(check_angle([a, b, c, d]), Some(reading));
                assert_ne!([a, b, c, d], [0; 4]);
            }
            [_, _, mark] => assert_eq!((mark, reading.angle.get()), (mt6835::MARK, 0)),
            ref other => panic!("{other:?}"),
        }
    }
}
