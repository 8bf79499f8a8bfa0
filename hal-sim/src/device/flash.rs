//! The four sectors of flash that hold the settings: sectors 12 to 15 of an STM32F42x, 16 kB each, at the start of
//! bank 2.
//!
//! As the part: an erase sets a sector to 0xFF, programming only clears bits (a 1 over a 0 stays 0, without an error,
//! counted in [`Counts::clashes`]), words of 4 bytes, whole sectors. Reading takes no time, the core reads memory.
//!
//! # Power cuts
//!
//! The power goes after a number of [steps](Flash::cut_after): a byte programmed is one, an erase is [`ERASE_STEPS`].
//! In a word under way, bytes before the cut are programmed, of the others any bits that were to be. In a sector under
//! way it is one of these, by lot: each bit erased or not, at a share that grows with the steps done; every bit left
//! to chance (a part programs all bits to 0 before it erases); erased up to an address. From then on everything fails
//! with [`FlashError::NoPower`] until [`Flash::power_up`].
//!
//! # Time
//!
//! Typical figures of the data sheet at PSIZE x32; awaited on the virtual clock with [`Flash::awaited`], summed up in
//! [`Counts::busy_us`] either way.
//!
//! # Sources
//!
//! STM32F427xx/429xx data sheet DS9405, tables *Flash memory programming* and *Flash memory endurance and data
//! retention*; RM0090, *Embedded flash memory interface*.
//!
//! Not modelled: bits that read now one way, now the other after a cut; wear beyond its count; reads of the bank that
//! is busy (they stall the core; the store does none).

use std::cell::RefCell;
use std::rc::Rc;

use embassy_time::Timer;
use embedded_storage_async::nor_flash::{ErrorType, NorFlash, NorFlashError, NorFlashErrorKind, ReadNorFlash};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// Size of a sector, bytes.
pub const SECTOR: usize = 16 * 1024;
/// Sectors of the settings.
pub const SECTORS: usize = 4;
/// Bytes programmed at once.
pub const WORD: usize = 4;
/// Programming a word, µs; 100 at the worst.
pub const PROGRAM_US: u64 = 16;
/// Erasing a sector, µs; 500 000 at the worst.
pub const ERASE_US: u64 = 250_000;
/// Erases that a sector is good for.
pub const ENDURANCE: u32 = 10_000;
/// Steps of an erase, for cuts.
pub const ERASE_STEPS: u64 = 64;

/// Why the flash refuses.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum FlashError {
    /// Not at a word, or not at a sector.
    Unaligned,
    /// Beyond the end.
    Bounds,
    /// The power is off.
    NoPower,
}

impl std::fmt::Display for FlashError {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            Self::Unaligned => "writes are whole words, erases whole sectors",
            Self::Bounds => "beyond the end of the flash",
            Self::NoPower => "the power is off",
        })
    }
}

impl std::error::Error for FlashError {}

impl NorFlashError for FlashError {
    fn kind(&self) -> NorFlashErrorKind {
        match self {
            Self::Unaligned => NorFlashErrorKind::NotAligned,
            Self::Bounds => NorFlashErrorKind::OutOfBounds,
            Self::NoPower => NorFlashErrorKind::Other,
        }
    }
}

/// What was done to the flash.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Counts {
    /// Erases begun, by sector.
    pub erases: [u32; SECTORS],
    /// Words programmed.
    pub words: u64,
    /// Words programmed with a 1 over a 0: the word is not what was written.
    pub clashes: u64,
    /// Time programming and erasing, µs.
    pub busy_us: u64,
    /// Steps, as [`Flash::cut_after`] counts them.
    pub steps: u64,
}

#[derive(Debug)]
struct Part {
    bytes: Vec<u8>,
    counts: Counts,
    /// Steps until the power goes.
    left: Option<u64>,
    powered: bool,
    rng: ChaCha8Rng,
}

impl Part {
    /// Spends steps: how many of them are done before the power goes.
    fn spend(&mut self, steps: u64) -> u64 {
        let done = self.left.map_or(steps, |left| left.min(steps));
        self.counts.steps += done;
        if let Some(left) = &mut self.left {
            *left -= done;
        }
        if done < steps {
            self.powered = false;
        }
        done
    }

    fn range(&self, from: u32, length: usize) -> Result<std::ops::Range<usize>, FlashError> {
        if !self.powered {
            return Err(FlashError::NoPower);
        }
        let from = from as usize;
        let end = from
            .checked_add(length)
            .filter(|end| *end <= self.bytes.len())
            .ok_or(FlashError::Bounds)?;
        Ok(from..end)
    }

    fn program(&mut self, at: usize, word: &[u8]) -> Result<(), FlashError> {
        let done = self.spend(WORD as u64) as usize;
        let cut = done < WORD;
        self.counts.words += 1;
        self.counts.busy_us += PROGRAM_US;
        let old = &mut self.bytes[at..at + WORD];
        self.counts.clashes += u64::from(old.iter().zip(word).any(|(old, new)| !old & new != 0));
        for (i, (old, new)) in old.iter_mut().zip(word).enumerate() {
            // Bits that this cut leaves as they were.
            let spared: u8 = if i < done { 0 } else { self.rng.random() };
            *old &= new | spared;
        }
        if cut { Err(FlashError::NoPower) } else { Ok(()) }
    }

    fn erase(&mut self, sector: usize) -> Result<(), FlashError> {
        let done = self.spend(ERASE_STEPS);
        self.counts.erases[sector] += 1;
        self.counts.busy_us += ERASE_US;
        let bytes = &mut self.bytes[sector * SECTOR..][..SECTOR];
        if done == ERASE_STEPS {
            bytes.fill(0xFF);
            return Ok(());
        }
        let share = done as f64 / ERASE_STEPS as f64;
        match self.rng.random_range(0..3) {
            0 => {
                for byte in bytes {
                    for bit in 0..8 {
                        *byte |= u8::from(self.rng.random_bool(share)) << bit;
                    }
                }
            }
            1 => {
                for byte in bytes {
                    *byte = (0..8).fold(0, |byte, bit| byte | u8::from(self.rng.random_bool(share)) << bit);
                }
            }
            _ => {
                let end = (share * SECTOR as f64) as usize;
                bytes[..end].fill(0xFF);
            }
        }
        Err(FlashError::NoPower)
    }
}

/// A handle of the flash; clones are the same part.
#[derive(Debug, Clone)]
pub struct Flash {
    part: Rc<RefCell<Part>>,
    awaited: bool,
}

impl Flash {
    /// An erased part with its power on. `seed` is for what power cuts leave.
    pub fn new(seed: u64) -> Self {
        Self::with_bytes(&[], seed)
    }

    /// One that holds these bytes, the rest erased.
    pub fn with_bytes(bytes: &[u8], seed: u64) -> Self {
        let mut all = vec![0xFF; SECTOR * SECTORS];
        for (to, from) in all.iter_mut().zip(bytes) {
            *to = *from;
        }
        Self {
            part: Rc::new(RefCell::new(Part {
                bytes: all,
                counts: Counts::default(),
                left: None,
                powered: true,
                rng: ChaCha8Rng::seed_from_u64(seed),
            })),
            awaited: false,
        }
    }

    /// The same part, whose programming and erasing takes its time on the virtual clock.
    #[must_use]
    pub fn awaited(self) -> Self {
        Self { awaited: true, ..self }
    }

    /// The power goes after so many steps from now on. See the [module](self).
    pub fn cut_after(&self, steps: u64) {
        self.part.borrow_mut().left = Some(steps);
    }

    /// The power is on, and stays.
    pub fn power_up(&self) {
        let mut part = self.part.borrow_mut();
        part.powered = true;
        part.left = None;
    }

    /// Whether the power is on.
    pub fn powered(&self) -> bool {
        self.part.borrow().powered
    }

    /// What was done so far.
    pub fn counts(&self) -> Counts {
        self.part.borrow().counts
    }

    /// What it holds.
    pub fn bytes(&self) -> Vec<u8> {
        self.part.borrow().bytes.clone()
    }

    /// Does something to what it holds: corruption, another firmware.
    pub fn with_mut<R>(&self, body: impl FnOnce(&mut [u8]) -> R) -> R {
        body(&mut self.part.borrow_mut().bytes)
    }

    async fn wait(&self, us: u64) {
        if self.awaited {
            Timer::after_micros(us).await;
        }
    }
}

impl ErrorType for Flash {
    type Error = FlashError;
}

impl ReadNorFlash for Flash {
    const READ_SIZE: usize = 1;

    async fn read(&mut self, offset: u32, bytes: &mut [u8]) -> Result<(), FlashError> {
        let part = self.part.borrow();
        let range = part.range(offset, bytes.len())?;
        bytes.copy_from_slice(&part.bytes[range]);
        Ok(())
    }

    fn capacity(&self) -> usize {
        SECTOR * SECTORS
    }
}

impl NorFlash for Flash {
    const WRITE_SIZE: usize = WORD;
    const ERASE_SIZE: usize = SECTOR;

    async fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), FlashError> {
        let range = self.part.borrow().range(offset, bytes.len())?;
        if !range.start.is_multiple_of(WORD) || !range.end.is_multiple_of(WORD) {
            return Err(FlashError::Unaligned);
        }
        for (at, word) in range.step_by(WORD).zip(bytes.chunks_exact(WORD)) {
            self.wait(PROGRAM_US).await;
            self.part.borrow_mut().program(at, word)?;
        }
        Ok(())
    }

    async fn erase(&mut self, from: u32, to: u32) -> Result<(), FlashError> {
        let length = to.checked_sub(from).ok_or(FlashError::Bounds)? as usize;
        let range = self.part.borrow().range(from, length)?;
        if !range.start.is_multiple_of(SECTOR) || !range.end.is_multiple_of(SECTOR) {
            return Err(FlashError::Unaligned);
        }
        for sector in range.start / SECTOR..range.end / SECTOR {
            self.wait(ERASE_US).await;
            self.part.borrow_mut().erase(sector)?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use embassy_futures::block_on;
    use embassy_time::{Duration, Instant};

    use super::*;

    #[test]
    fn bits_go_down_one_by_one_and_up_by_sectors() {
        let mut flash = Flash::new(0);
        block_on(flash.write(4, &[0xF0, 0x55, 0, 0xFF])).unwrap();
        assert_eq!(flash.counts().clashes, 0);
        block_on(flash.write(4, &[0x3C, 0xAA, 1, 0xFF])).unwrap();
        assert_eq!(
            (&flash.bytes()[4..8], flash.counts().clashes),
            (&[0x30, 0, 0, 0xFF][..], 1)
        );
        block_on(flash.write(SECTOR as u32, &[0; 4])).unwrap();
        block_on(flash.erase(0, SECTOR as u32)).unwrap();
        assert!(flash.bytes()[..SECTOR].iter().all(|byte| *byte == 0xFF));
        assert_eq!(flash.bytes()[SECTOR], 0);
        assert_eq!(flash.counts().erases, [1, 0, 0, 0]);
    }

    #[test]
    fn what_the_part_refuses() {
        let (mut flash, end) = (Flash::new(0), (SECTOR * SECTORS) as u32);
        for (offset, length, error) in [
            (2, 4, FlashError::Unaligned),
            (4, 3, FlashError::Unaligned),
            (end, 4, FlashError::Bounds),
            (u32::MAX, 4, FlashError::Bounds),
        ] {
            assert_eq!(block_on(flash.write(offset, &[0; 4][..length])), Err(error));
        }
        assert_eq!(block_on(flash.erase(0, 4)), Err(FlashError::Unaligned));
        assert_eq!(block_on(flash.erase(end, 0)), Err(FlashError::Bounds));
        assert_eq!(block_on(flash.read(end - 1, &mut [0; 2])), Err(FlashError::Bounds));
        assert!(flash.bytes().iter().all(|byte| *byte == 0xFF));
    }

    #[test]
    fn a_cut_leaves_a_part_of_the_word_and_nothing_after() {
        for steps in 0..12 {
            let mut flash = Flash::new(steps);
            flash.cut_after(steps);
            assert_eq!(block_on(flash.write(0, &[0; 12])), Err(FlashError::NoPower));
            assert_eq!(block_on(flash.read(0, &mut [0; 4])), Err(FlashError::NoPower));
            let word = (steps as usize / WORD + 1) * WORD;
            let bytes = flash.bytes();
            assert!(bytes[..steps as usize].iter().all(|byte| *byte == 0));
            assert!(bytes[word..].iter().all(|byte| *byte == 0xFF));
            flash.power_up();
            assert_eq!(block_on(flash.write(0, &[0; 12])), Ok(()));
        }
    }

    #[test]
    fn an_interrupted_erase_is_none() {
        let mut others = 0;
        for steps in 1..ERASE_STEPS {
            let mut flash = Flash::with_bytes(&[0x5A; SECTOR * 2], steps);
            flash.cut_after(steps);
            assert_eq!(block_on(flash.erase(0, SECTOR as u32)), Err(FlashError::NoPower));
            let bytes = flash.bytes();
            assert!(bytes[..SECTOR].iter().any(|byte| *byte != 0xFF));
            assert!(bytes[SECTOR..SECTOR * 2].iter().all(|byte| *byte == 0x5A));
            others += u32::from(bytes[..SECTOR].iter().any(|byte| *byte & 0x5A != 0x5A));
        }
        assert!(others > 0, "no erase has cleared a bit");
    }

    #[test]
    fn takes_its_time_on_the_virtual_clock() {
        let flash = Flash::new(0);
        let mut slow = flash.clone().awaited();
        let mut unit = vtime::Executor::new();
        let took = unit.block_on(Duration::from_secs(2), async {
            let start = Instant::now();
            slow.erase(0, SECTOR as u32 * 2).await.unwrap();
            slow.write(0, &[0; 40]).await.unwrap();
            start.elapsed().as_micros()
        });
        assert_eq!(took, Ok(2 * ERASE_US + 10 * PROGRAM_US));
        assert_eq!(flash.counts().busy_us, 2 * ERASE_US + 10 * PROGRAM_US);
    }
}
