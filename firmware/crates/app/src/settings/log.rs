//! Records in flash, one after the other, sector after sector, round and round.
//!
//! ```text
//! 0      2    3       4         8        12         12 + length
//! magic  key  length  sequence  CRC-32   body       0xFF up to the next 16 bytes
//! ```
//!
//! Of the whole records of a key, the one with the highest sequence number counts. It is *live*; nothing else is, and
//! nothing else is believed: no marks of sectors, no pointers. What a power cut leaves of a record has a wrong check
//! sum, what it leaves of a sector under erasure is rubbish or records that have been outnumbered elsewhere.
//!
//! # The one rule
//!
//! A sector is erased only while nothing live is in it, and always before it is used. So that the next one can be, what
//! is live in it is written anew into the active one as soon as that is begun; a cut in there leaves it to the next save,
//! which begins with it. With a sector of 128 records and at most 16 to move, a hundred cuts in a row would have to hit
//! the few milliseconds of that before there was no room.
//!
//! # Why not `sequential-storage`
//!
//! It is 8 kB of code beside this one's 3 kB. And it tells full, open and erased sectors by their first and last byte,
//! which an interrupted erase leaves to chance: version 8.0.2 came out of 1336 cuts in an erase, simulated bit by bit,
//! with values lost 58 times.
//!
//! Not modelled: a bit that reads right after the cut and wrong later. A save reads back what it has written, so does
//! every start.

use drivers::crc::crc32;
use embedded_storage_async::nor_flash::NorFlash;

/// Records begin at multiples of this, bytes: a multiple of any word the flash may have.
pub(super) const UNIT: usize = 16;
/// Longest record, bytes. Part of the format: a program that knew less would not see, and not keep, a longer one.
pub(super) const BUFFER: usize = 256;
/// Bytes before the body.
pub(super) const HEADER: usize = 12;
/// Keys that are kept, those of later programs as well.
pub(super) const KEYS: usize = 16;
const MAGIC: u16 = 0x5E77;
/// A record that does not read back is written again, further on, so often.
const TRIES: u8 = 3;

/// What the flash does not do.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum LogError {
    /// It reports an error.
    Flash,
    /// No room: see [the rule](self#the-one-rule).
    Full,
    /// It does not hold what was written.
    Worn,
    /// A sector would have to be erased, which is for the start, see [`Log::erase_ahead`].
    NotNow,
}

/// A live record. Sequence 0: there is none.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Live {
    pub(super) sequence: u32,
    pub(super) version: u8,
    length: u8,
    address: u32,
}

impl Live {
    pub(super) fn is_some(&self) -> bool {
        self.sequence != 0
    }
}

/// Size of a record with a body of this length, with what fills it up.
pub(super) const fn size(length: u8) -> u32 {
    (HEADER + length as usize).next_multiple_of(UNIT) as u32
}

/// The first bytes of a record.
#[derive(Debug, Clone, Copy)]
struct Header {
    key: u8,
    length: u8,
    sequence: u32,
}

impl Header {
    fn parse(bytes: &[u8; UNIT]) -> Option<Self> {
        let [m0, m1, key, length, s0, s1, s2, s3, ..] = *bytes;
        let header = Self {
            key,
            length,
            sequence: u32::from_le_bytes([s0, s1, s2, s3]),
        };
        let good = u16::from_le_bytes([m0, m1]) == MAGIC
            && usize::from(key) < KEYS
            && length > 0
            && size(length) <= BUFFER as u32
            && header.sequence > 0;
        good.then_some(header)
    }
}

/// The log.
pub(super) struct Log<F> {
    flash: F,
    /// Whether what follows is what is in flash.
    scanned: bool,
    live: [Live; KEYS],
    /// Highest sequence number of a damaged record, 0 for none.
    doubt: [u32; KEYS],
    /// Stretches that are neither erased nor a record.
    damaged: u16,
    /// Highest sequence number.
    sequence: u32,
    /// The sector written to.
    active: u32,
    /// Where it is free.
    tail: u32,
    /// Nothing is erased any more.
    sealed: bool,
    buffer: [u8; BUFFER],
}

impl<F: NorFlash> Log<F> {
    const SECTOR: u32 = {
        assert!(
            UNIT.is_multiple_of(F::WRITE_SIZE)
                && UNIT.is_multiple_of(F::READ_SIZE)
                && HEADER.is_multiple_of(F::READ_SIZE),
            "words of the flash must divide the 16 bytes of a unit"
        );
        assert!(
            F::ERASE_SIZE.is_multiple_of(UNIT) && F::ERASE_SIZE >= 16 * BUFFER,
            "a sector must hold one record of each key"
        );
        F::ERASE_SIZE as u32
    };

    pub(super) const fn new(flash: F) -> Self {
        Self {
            flash,
            scanned: false,
            live: [Live {
                sequence: 0,
                version: 0,
                length: 0,
                address: 0,
            }; KEYS],
            doubt: [0; KEYS],
            damaged: 0,
            sequence: 0,
            active: 0,
            tail: 0,
            sealed: false,
            buffer: [0; BUFFER],
        }
    }

    pub(super) fn live(&self, key: u8) -> Live {
        self.live.get(usize::from(key)).copied().unwrap_or_default()
    }

    /// Whether there is a damaged record of this key, and no live one, or one that is older. A number that cannot be does
    /// not count as newer: half an erase leaves any.
    pub(super) fn doubted(&self, key: u8) -> bool {
        let doubt = self.doubt.get(usize::from(key)).copied().unwrap_or_default();
        let last = self.sequence.saturating_add(u32::from(TRIES));
        let live = self.live(key).sequence;
        doubt > live && (live == 0 || doubt <= last)
    }

    pub(super) fn damaged(&self) -> u16 {
        self.damaged
    }

    /// Room for the body of a record that is to be [appended](Self::append).
    pub(super) fn body(&mut self) -> &mut [u8] {
        &mut self.buffer[HEADER..]
    }

    fn sectors(&self) -> u32 {
        self.flash.capacity() as u32 / Self::SECTOR
    }

    /// Reads all of the flash, unless what is known of it holds.
    pub(super) async fn scan(&mut self) -> Result<(), LogError> {
        if self.scanned {
            return Ok(());
        }
        self.live = [Live::default(); KEYS];
        self.doubt = [0; KEYS];
        (self.damaged, self.sequence) = (0, 0);
        // Nothing is there yet: the first record goes into the first sector, through an erase.
        self.active = self.sectors().saturating_sub(1);
        self.tail = self.sectors() * Self::SECTOR;
        for sector in 0..self.sectors() {
            let (mut at, end) = (sector * Self::SECTOR, (sector + 1) * Self::SECTOR);
            let mut tail = at;
            let mut rubbish = false;
            while at < end {
                let mut first = [0; UNIT];
                self.read(at, &mut first).await?;
                let found = Header::parse(&first).filter(|header| size(header.length) <= end - at);
                let mut whole = false;
                if let Some(header) = found {
                    whole = self.fetch(at, header.length).await?;
                    self.note(header, at, whole);
                }
                let blank = first.iter().all(|byte| *byte == 0xFF);
                if !blank && !whole && !rubbish {
                    self.damaged = self.damaged.saturating_add(1);
                }
                rubbish = !blank && !whole;
                at += found
                    .filter(|_| whole)
                    .map_or(UNIT as u32, |header| size(header.length));
                if !blank {
                    tail = at;
                }
            }
            if self.active == sector && self.sequence > 0 {
                self.tail = tail;
            }
        }
        self.scanned = true;
        Ok(())
    }

    /// Takes notice of a record found at `at`.
    fn note(&mut self, header: Header, at: u32, whole: bool) {
        let key = usize::from(header.key);
        let Header { sequence, length, .. } = header;
        if !whole {
            if let Some(doubt) = self.doubt.get_mut(key) {
                *doubt = sequence.max(*doubt);
            }
            return;
        }
        if sequence > self.sequence {
            self.sequence = sequence;
            self.active = at / Self::SECTOR;
        }
        let version = self.buffer[HEADER];
        if let Some(live) = self.live.get_mut(key).filter(|live| live.sequence < sequence) {
            *live = Live {
                sequence,
                version,
                length,
                address: at,
            };
        }
    }

    async fn read(&mut self, at: u32, bytes: &mut [u8]) -> Result<(), LogError> {
        self.flash.read(at, bytes).await.map_err(|_| LogError::Flash)
    }

    /// Reads a record into the buffer; whether its check sum is right.
    async fn fetch(&mut self, at: u32, length: u8) -> Result<bool, LogError> {
        let Some(bytes) = self.buffer.get_mut(..size(length) as usize) else {
            return Ok(false);
        };
        self.flash.read(at, bytes).await.map_err(|_| LogError::Flash)?;
        let [.., c0, c1, c2, c3] = *self.buffer.first_chunk::<HEADER>().unwrap_or(&[0; HEADER]);
        Ok(u32::from_le_bytes([c0, c1, c2, c3]) == self.sum(length))
    }

    /// Check sum of the record in the buffer.
    fn sum(&self, length: u8) -> u32 {
        let (header, body) = self.buffer.split_at(HEADER);
        crc32(
            header
                .iter()
                .take(8)
                .chain(body.iter().take(usize::from(length)))
                .copied(),
        )
    }

    /// Reads the live record of a key: its version and the rest of its body.
    pub(super) async fn fetch_live(&mut self, key: u8) -> Result<Option<(u8, &mut [u8])>, LogError> {
        let live = self.live(key);
        if !live.is_some() || !self.fetch(live.address, live.length).await? {
            return Ok(None);
        }
        let body = self.buffer.get_mut(HEADER + 1..HEADER + usize::from(live.length));
        Ok(body.map(|body| (live.version, body)))
    }

    /// Whether the live record of a key has the body that is in the buffer.
    pub(super) async fn is_live(&mut self, key: u8, length: u8) -> Result<bool, LogError> {
        let live = self.live(key);
        if !live.is_some() || live.length != length {
            return Ok(false);
        }
        self.holds(live.address, length, HEADER).await
    }

    /// Whether flash holds what is in the buffer, from this byte of the record on.
    async fn holds(&mut self, at: u32, length: u8, from: usize) -> Result<bool, LogError> {
        let mut place = from;
        while place < HEADER + usize::from(length) {
            // To the next unit's begin, so that reads are aligned for any flash.
            let end = (place + 1).next_multiple_of(UNIT);
            let mut bytes = [0; UNIT];
            let bytes = &mut bytes[..end - place];
            self.read(at + place as u32, bytes).await?;
            // What fills the last unit up is compared as well; a body in the buffer has 0xFF there as the record has.
            if self.buffer.get(place..end) != Some(&*bytes) {
                return Ok(false);
            }
            place = end;
        }
        Ok(true)
    }

    /// Whether something live is in a sector.
    fn lives(&self, sector: u32) -> bool {
        let mut live = self.live.iter();
        live.any(|live| live.is_some() && live.address / Self::SECTOR == sector)
    }

    /// The sectors after the active one, in their order.
    fn others(&self) -> impl Iterator<Item = u32> {
        let (active, sectors) = (self.active, self.sectors());
        (1..sectors).map(move |step| (active + step) % sectors)
    }

    fn room(&self, bytes: u32) -> bool {
        self.tail + bytes <= (self.active + 1) * Self::SECTOR
    }

    /// Makes room for a record of this [size]. Uses the buffer. Whether a sector was erased for it.
    ///
    /// Cancellation: safe; so is the end of power. What is live stays so, or is written anew.
    pub(super) async fn prepare(&mut self, bytes: u32) -> Result<bool, LogError> {
        self.scan().await?;
        self.scanned = false;
        self.tidy().await?;
        let wanting = !self.room(bytes);
        if wanting {
            if self.sealed {
                return Err(LogError::NotNow);
            }
            // The next one, but for flash that was damaged.
            let sector = self
                .others()
                .find(|sector| !self.lives(*sector))
                .ok_or(LogError::Full)?;
            let from = sector * Self::SECTOR;
            // Even where it reads as erased: a cut may have ended the erase too early for it to last.
            self.flash
                .erase(from, from + Self::SECTOR)
                .await
                .map_err(|_| LogError::Flash)?;
            (self.active, self.tail) = (sector, from);
            self.tidy().await?;
        }
        self.scanned = true;
        Ok(wanting)
    }

    /// Erases nothing from here on, but before that, if `may`, the next sector where less than half of the active one is free.
    ///
    /// Cancellation: as [`prepare`](Self::prepare).
    pub(super) async fn erase_ahead(&mut self, may: bool) -> Result<(), LogError> {
        if may && self.prepare(Self::SECTOR / 2).await? {
            // A record says which sector is the active one; without it the next start would erase again.
            let first = (0..KEYS as u8).find(|key| self.live(*key).is_some());
            if let Some(key) = first {
                let length = self.live(key).length;
                if self.fetch(self.live(key).address, length).await? {
                    self.append(key, length).await?;
                }
            }
        }
        self.sealed = true;
        Ok(())
    }

    /// Sees to it that the next sector may be erased, as far as there is room.
    async fn tidy(&mut self) -> Result<(), LogError> {
        let next = self.others().next();
        for key in 0..KEYS as u8 {
            let live = self.live(key);
            if !live.is_some() || Some(live.address / Self::SECTOR) != next || !self.room(size(live.length)) {
                continue;
            }
            if self.fetch(live.address, live.length).await? {
                self.write(key, live.length).await?;
            } else if let Some(live) = self.live.get_mut(usize::from(key)) {
                // Damaged since it was found: it must not stand in the way for ever.
                *live = Live::default();
            }
        }
        Ok(())
    }

    /// Writes the body in the buffer as a record, `length` bytes with the version in front, and reads it back. Room has
    /// been [made](Self::prepare).
    ///
    /// Cancellation: safe; so is the end of power. The live record is then the old or the new one.
    pub(super) async fn append(&mut self, key: u8, length: u8) -> Result<(), LogError> {
        self.scanned = false;
        self.write(key, length).await?;
        self.scanned = true;
        Ok(())
    }

    async fn write(&mut self, key: u8, length: u8) -> Result<(), LogError> {
        let whole = size(length);
        self.fill(length);
        for _ in 0..TRIES {
            if !self.room(whole) {
                return Err(LogError::Full);
            }
            self.sequence = self.sequence.checked_add(1).ok_or(LogError::Full)?;
            let [m0, m1] = MAGIC.to_le_bytes();
            self.buffer[..4].copy_from_slice(&[m0, m1, key, length]);
            self.buffer[4..8].copy_from_slice(&self.sequence.to_le_bytes());
            let sum = self.sum(length);
            self.buffer[8..HEADER].copy_from_slice(&sum.to_le_bytes());
            let at = self.tail;
            let bytes = self.buffer.get(..whole as usize).ok_or(LogError::Full)?;
            self.flash.write(at, bytes).await.map_err(|_| LogError::Flash)?;
            self.tail += whole;
            if self.holds(at, length, 0).await? {
                let header = Header {
                    key,
                    length,
                    sequence: self.sequence,
                };
                self.note(header, at, true);
                return Ok(());
            }
        }
        Err(LogError::Worn)
    }

    /// Fills the buffer up after a body.
    pub(super) fn fill(&mut self, length: u8) {
        if let Some(rest) = self.buffer.get_mut(HEADER + usize::from(length)..) {
            rest.fill(0xFF);
        }
    }

    /// Erases everything.
    pub(super) async fn format(&mut self) -> Result<(), LogError> {
        self.scanned = false;
        let end = self.sectors() * Self::SECTOR;
        self.flash.erase(0, end).await.map_err(|_| LogError::Flash)
    }
}
