//! The settings: [`app::settings`], their bytes and their store on a flash that holds anything.

use app::nmea::Talker;
use app::settings::{Group, NAME, Settings, Store};
use embassy_futures::block_on;
use embedded_storage_async::nor_flash::{ErrorType, NorFlash, NorFlashErrorKind, ReadNorFlash};
use nav::deviation::Deviation;

use crate::{Feed, crc32};

/// Longest body of a record without its version.
const FIELDS: usize = 243;

fn group_of(byte: u8) -> Group {
    Group::ALL[usize::from(byte) % Group::ALL.len()]
}

fn encoded(settings: &Settings, group: Group) -> Vec<u8> {
    let mut bytes = [0; FIELDS];
    let length = settings.encode(group, &mut bytes).unwrap();
    bytes[..length].to_vec()
}

fn assert_others_equal(settings: &Settings, before: &Settings, group: Group) {
    for other in Group::ALL.into_iter().filter(|other| *other != group) {
        assert_eq!(
            encoded(settings, other),
            encoded(before, other),
            "another group than {group}"
        );
    }
}

/// A group's bytes. What is taken can be, leaves the other groups alone and comes back; what is refused changes nothing.
pub fn group(data: &[u8]) {
    let mut feed = Feed(data);
    let (group, version) = (group_of(feed.u8()), feed.u8());
    let version = if version < 8 { version } else { group.version() };
    let before = Settings::default();
    let mut found = before;
    let mut bytes = [0; FIELDS];
    let given = feed.slice(FIELDS);
    bytes[..given.len()].copy_from_slice(given);
    if found.decode(group, version, &mut bytes[..given.len()]).is_err() {
        assert_eq!(found, before);
        return;
    }
    assert_eq!(bytes[..given.len()], *given);
    assert_eq!(found.validate(group), Ok(()));
    assert_others_equal(&found, &before, group);
    let length = found.encode(group, &mut bytes).unwrap();
    let mut back = before;
    back.decode(group, group.version(), &mut bytes[..length]).unwrap();
    assert_eq!(back, found);
}

const SECTOR: usize = 4096;
const UNIT: usize = 16;
/// Words that could be written in the time of an erase.
const ERASE_STEPS: u32 = 32;

/// Two to four small sectors, whose power goes after some steps.
struct Flash<'a> {
    bytes: &'a mut [u8],
    /// Words until the power goes.
    left: u32,
}

impl Flash<'_> {
    fn spend(&mut self, steps: u32) -> Result<(), NorFlashErrorKind> {
        let enough = self.left >= steps;
        self.left = if enough { self.left - steps } else { 0 };
        if enough { Ok(()) } else { Err(NorFlashErrorKind::Other) }
    }

    fn range(&mut self, from: u32, length: usize, unit: usize) -> Result<&mut [u8], NorFlashErrorKind> {
        let from = from as usize;
        assert!(
            from.is_multiple_of(unit) && length.is_multiple_of(unit),
            "{from} {length}"
        );
        self.bytes
            .get_mut(from..from + length)
            .ok_or(NorFlashErrorKind::OutOfBounds)
    }
}

impl ErrorType for Flash<'_> {
    type Error = NorFlashErrorKind;
}

impl ReadNorFlash for Flash<'_> {
    const READ_SIZE: usize = 1;

    async fn read(&mut self, offset: u32, bytes: &mut [u8]) -> Result<(), NorFlashErrorKind> {
        bytes.copy_from_slice(self.range(offset, bytes.len(), 1)?);
        Ok(())
    }

    fn capacity(&self) -> usize {
        self.bytes.len()
    }
}

impl NorFlash for Flash<'_> {
    const WRITE_SIZE: usize = 4;
    const ERASE_SIZE: usize = SECTOR;

    async fn erase(&mut self, from: u32, to: u32) -> Result<(), NorFlashErrorKind> {
        let left = self.left;
        let whole = self.spend(ERASE_STEPS);
        let bytes = self.range(from, (to - from) as usize, SECTOR)?;
        let erased = if whole.is_ok() {
            bytes.len()
        } else {
            bytes.len() * left as usize / ERASE_STEPS as usize
        };
        bytes[..erased].fill(0xFF);
        whole
    }

    async fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), NorFlashErrorKind> {
        for (k, word) in bytes.chunks(4).enumerate() {
            self.spend(1)?;
            for (old, new) in self.range(offset + 4 * k as u32, 4, 4)?.iter_mut().zip(word) {
                *old &= new;
            }
        }
        Ok(())
    }
}

/// A record with the right check sum.
fn record(to: &mut [u8], key: u8, sequence: u32, body: &[u8]) -> usize {
    let [s0, s1, s2, s3] = sequence.to_le_bytes();
    let mut bytes = vec![0x77, 0x5E, key, body.len() as u8, s0, s1, s2, s3];
    bytes.extend_from_slice(body);
    let sum = crc32(&bytes).to_le_bytes();
    bytes.splice(8..8, sum);
    bytes.resize(bytes.len().next_multiple_of(UNIT), 0xFF);
    let taken = bytes.len().min(to.len());
    to[..taken].copy_from_slice(&bytes[..taken]);
    taken
}

/// Settings that differ from `settings` in one group.
fn changed(settings: &Settings, group: Group, by: u8) -> Settings {
    let mut new = *settings;
    let step = f32::from(by) / 256.0;
    match group {
        Group::Identity => {
            new.identity.serial = u32::from(by);
            new.identity.name = [b'a' + by % 26; NAME];
        }
        Group::Installation => new.installation.position.latitude = step,
        Group::LastPosition => new.last_position.height = f32::from(by),
        Group::Motion => new.motion.rate = 0.2 + step / 4.0,
        Group::Output => {
            new.output.period_ms = 50 + u32::from(by);
            new.output.talker = Talker::ALL[usize::from(by) % Talker::ALL.len()];
        }
        Group::Imu => new.imu.temperature_c = step,
        Group::Thermal => new.thermal.used = 0,
        Group::Encoder => new.encoder.zero = step,
        Group::Noise => new.noise.velocity_random_walk = step / 16.0,
        Group::Deviation => {
            new.deviation = Some(Deviation {
                rate_b: [step / 16.0; 2],
                force_b: [step; 2],
                sd: 1e-6,
            });
        }
    }
    new
}

/// Lays records, sound and damaged, and rubbish into flash.
fn fill(bytes: &mut [u8], feed: &mut Feed<'_>) {
    let units = bytes.len() / UNIT;
    let mut at = 0;
    while !feed.is_empty() {
        let op = feed.u8();
        let to = &mut bytes[at..];
        at += match op % 8 {
            0 => {
                let length = usize::from(feed.u8());
                let raw = feed.slice(length.min(to.len()));
                to[..raw.len()].copy_from_slice(raw);
                raw.len().next_multiple_of(UNIT)
            }
            1 => {
                let (key, sequence) = (feed.u8() % 20, feed.u32());
                let length = usize::from(feed.u8());
                record(to, key, sequence, feed.slice(length.min(244)))
            }
            2..5 => {
                let (group, by, sequence) = (group_of(feed.u8()), feed.u8(), feed.u16());
                let mut body = [0; 256];
                let length = changed(&Settings::default(), group, by)
                    .encode(group, &mut body[1..])
                    .unwrap();
                body[0] = group.version();
                if op & 0x80 != 0 {
                    body[usize::from(feed.u8()) % length] ^= feed.u8();
                }
                let size = record(to, group.key(), u32::from(sequence), &body[..=length]);
                if op & 0x40 != 0 {
                    // Cut off in the middle, or a bit turned later.
                    to[usize::from(feed.u8()) % size] ^= feed.u8();
                }
                size
            }
            5 => UNIT,
            _ => {
                let place = usize::from(feed.u16()) % units;
                at = place * UNIT;
                0
            }
        };
        at = if at < bytes.len() { at } else { 0 };
    }
}

fn load(bytes: &mut [u8]) -> Settings {
    let flash = Flash { bytes, left: 0 };
    let (settings, report) = block_on(Store::new(flash).load());
    assert_eq!(report.error, None);
    for group in Group::ALL {
        assert_eq!(settings.validate(group), Ok(()));
    }
    settings
}

/// Flash that holds anything. There are always settings that can be; a save that the power is cut off in leaves its group
/// as it was or as it was to be, and the others as they were.
pub fn flash(data: &[u8]) {
    let mut feed = Feed(data);
    let [size, group, by, again] = feed.array();
    let cut = u32::from(feed.u8());
    let mut memory = [0xFF; 4 * SECTOR];
    let bytes = &mut memory[..(2 + usize::from(size) % 3) * SECTOR];
    fill(bytes, &mut feed);

    let before = load(bytes);
    let group = group_of(group);
    let first = changed(&before, group, by);
    let mut store = Store::new(Flash {
        bytes: &mut *bytes,
        left: if cut == 0 { u32::MAX } else { cut },
    });
    let mut saved = block_on(store.save(&first, group)).is_ok();
    let mut last = (before, group, first);
    if again & 1 == 1 && saved {
        // A second one, of what the store knows by now.
        let other = group_of(again >> 1);
        let second = changed(&first, other, by.wrapping_add(7));
        saved = block_on(store.save(&second, other)).is_ok();
        last = (first, other, second);
    }
    let (before, group, wanted) = last;
    old_or_new(bytes, &before, group, &wanted, saved);
}

fn old_or_new(bytes: &mut [u8], before: &Settings, group: Group, wanted: &Settings, saved: bool) {
    let after = load(bytes);
    assert_others_equal(&after, before, group);
    if saved {
        assert_eq!(after, *wanted, "{group}");
    } else {
        assert!(after == *before || after == *wanted, "{group}: {after:?}");
    }
}
