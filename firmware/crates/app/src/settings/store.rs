//! Settings out of flash and into it.

use core::fmt;

use embedded_storage_async::nor_flash::NorFlash;
use frames::wording;

use super::log::{Log, LogError, size};
use super::{GROUPS, Group, Invalid, Position, Settings};
use crate::hal::Supply;

/// Where the values of a group come from.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Origin {
    /// Never saved: the defaults.
    Default,
    /// As they were last saved.
    Stored,
    /// Saved by an earlier program, whose record still stands; the next save writes one of now.
    Migrated {
        /// Its version.
        from: u8,
    },
    /// The save before the last: the last one did not come to its end, or its record is damaged.
    Older,
    /// The only records are damaged: the defaults. Enter the values anew.
    Lost,
    /// Saved by a later program: left alone, the defaults hold.
    Newer {
        /// Its version.
        version: u8,
    },
    /// The record is whole, but this program does not take its values: the defaults.
    Refused(Invalid),
}

wording!(Origin, |self, say| {
    match self {
        Self::Default => say!("never saved, the defaults hold"),
        Self::Stored => say!("as last saved"),
        Self::Migrated { from } => say!("as last saved, in version {}", from),
        Self::Older => say!("older, the last save is damaged"),
        Self::Lost => say!("lost, the defaults hold: enter them anew"),
        Self::Newer { version } => say!("of version {}, saved by a later program: the defaults hold", version),
        Self::Refused(Invalid::OutOfRange { name, .. }) => say!("{} is out of range: the defaults hold", name),
        Self::Refused(Invalid::Text { name }) => say!("{} is no text: the defaults hold", name),
        Self::Refused(Invalid::Length) => say!("of another length: the defaults hold"),
    }
});

/// What became of the settings at the start.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Report {
    /// One for each of [`Group::ALL`].
    pub origins: [Origin; GROUPS],
    /// Stretches of flash that are neither erased nor a record: what power cuts have left, or damage. A record whose
    /// head is damaged is only seen here.
    pub damaged: u16,
    /// The flash could not be read: everything after is at its default.
    pub error: Option<StoreError>,
}

impl Report {
    /// Groups that are not what was last saved.
    pub fn wanting(&self) -> impl Iterator<Item = (Group, Origin)> {
        let all = Group::ALL.into_iter().zip(self.origins);
        all.filter(|(_, origin)| !matches!(origin, Origin::Default | Origin::Stored | Origin::Migrated { .. }))
    }
}

/// What a save did.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Saved {
    /// Wrote the group, and read it back.
    Written,
    /// Nothing: it was there already.
    Unchanged,
}

/// Why nothing was saved. What was there before is still there.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum StoreError {
    /// A value that cannot be.
    Invalid(Invalid),
    /// The group was saved by a later program.
    Newer {
        /// The group.
        group: Group,
        /// Version of its record.
        version: u8,
    },
    /// The flash reports an error.
    Flash,
    /// No room.
    Full,
    /// The flash does not hold what is written.
    Worn,
    /// The supply is too low to write.
    Supply,
    /// No room before the next start, which makes some: see [`Store::erase_ahead`].
    NotNow,
}

impl fmt::Display for StoreError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Invalid(invalid) => invalid.fmt(f),
            Self::Newer { group, version } => write!(
                f,
                "{group} is of version {version}, saved by a later program: load that, or erase the settings"
            ),
            Self::Flash => f.write_str("the settings' flash reports an error: check its supply and its protection"),
            Self::Full => f.write_str("no room for settings: erase them and enter them anew"),
            Self::Worn => f.write_str("the settings' flash does not hold what is written: replace the part"),
            Self::Supply => f.write_str("the supply is below 2.8 V, flash needs more: check it, then save again"),
            Self::NotNow => f.write_str("no room for settings until the next start: restart, set and save them again"),
        }
    }
}

impl core::error::Error for StoreError {}

impl From<LogError> for StoreError {
    fn from(error: LogError) -> Self {
        match error {
            LogError::Flash => Self::Flash,
            LogError::Full => Self::Full,
            LogError::Worn => Self::Worn,
            LogError::NotNow => Self::NotNow,
        }
    }
}

impl From<Invalid> for StoreError {
    fn from(invalid: Invalid) -> Self {
        Self::Invalid(invalid)
    }
}

/// The settings' place in flash: all of `F`, which is theirs alone.
///
/// Any flash of whole sectors of 4 kB or more, at least two of them, written in words of 1 to 16 bytes that are written
/// once. It keeps about 540 bytes of RAM, the buffer of a record in them.
///
/// # Power cuts and cancellation
///
/// Whenever the power goes, and wherever a future of [`save`](Self::save) is dropped, the group's value is afterwards
/// the old or the new one, and the others' are as they were. After a drop or an error the next call reads all of the
/// flash again.
///
/// On an STM32F4 do not drop it all the same: the core stalls at the driver's next access of a register until the flash
/// is done, half a second if it erases (RM0090, FLASH_CR), and the motor's loop with it. Awaited, it stalls nobody where the
/// settings are in the other bank; on a part with one bank only [`erase_ahead`](Self::erase_ahead) may erase.
///
/// # Time
///
/// A save takes 16 µs a word of 4 bytes, 0.13 ms for the smallest group and 0.5 ms for the largest, and reads it back; once
/// in 128 saves of the largest, or 450 of the smallest, 0.25 s more, 0.5 s at the worst, and a few ms to move what is left
/// behind. [`load`](Self::load) reads all of the flash.
pub struct Store<F> {
    log: Log<F>,
}

impl<F: NorFlash> Store<F> {
    /// Nothing is read yet.
    pub const fn new(flash: F) -> Self {
        Self { log: Log::new(flash) }
    }

    /// What is saved, over the defaults. As [`load_over`](Self::load_over).
    pub async fn load(&mut self) -> (Settings, Report) {
        self.load_over(Settings::default()).await
    }

    /// What is saved, over `settings` that hold for what is not. Whatever the flash holds, there are settings, every
    /// value in its range if those were; the report says where they come from.
    ///
    /// Writes nothing. Cancellation: safe.
    pub async fn load_over(&mut self, mut settings: Settings) -> (Settings, Report) {
        let mut report = Report {
            origins: [Origin::Default; GROUPS],
            damaged: 0,
            error: None,
        };
        report.error = self.fill(&mut settings, &mut report).await.err().map(StoreError::from);
        (settings, report)
    }

    async fn fill(&mut self, settings: &mut Settings, report: &mut Report) -> Result<(), LogError> {
        self.log.scan().await?;
        report.damaged = self.log.damaged();
        for (group, origin) in Group::ALL.into_iter().zip(&mut report.origins) {
            let (key, known) = (group.key(), group.version());
            let doubted = self.log.doubted(key);
            *origin = match self.log.fetch_live(key).await? {
                Some((version, _)) if version > known => Origin::Newer { version },
                Some((version, body)) => match settings.decode(group, version, body) {
                    Err(invalid) => Origin::Refused(invalid),
                    Ok(()) if doubted => Origin::Older,
                    Ok(()) if version < known => Origin::Migrated { from: version },
                    Ok(()) => Origin::Stored,
                },
                None if doubted => Origin::Lost,
                None => Origin::Default,
            };
        }
        Ok(())
    }

    /// Saves one group of the settings, and reads it back. Nothing is written where nothing has changed.
    ///
    /// Cancellation: safe, but see [there](Self#power-cuts-and-cancellation).
    ///
    /// # Errors
    /// [`StoreError`]; the group's record is then as before.
    pub async fn save(&mut self, settings: &Settings, group: Group) -> Result<Saved, StoreError> {
        self.log.scan().await?;
        let (key, known) = (group.key(), group.version());
        let version = self.log.live(key).version;
        if version > known {
            return Err(StoreError::Newer { group, version });
        }
        let length = self.encode(settings, group)?;
        if self.log.is_live(key, length).await? {
            return Ok(Saved::Unchanged);
        }
        self.log.prepare(size(length)).await?;
        // The buffer was needed in between.
        self.encode(settings, group)?;
        self.log.append(key, length).await?;
        Ok(Saved::Written)
    }

    /// Saves the last good position.
    ///
    /// Good for 20 million times: once a minute for 38 years.
    ///
    /// # Errors
    /// As [`save`](Self::save).
    pub async fn save_position(&mut self, position: &Position) -> Result<Saved, StoreError> {
        let settings = Settings {
            last_position: *position,
            ..Settings::default()
        };
        self.save(&settings, Group::LastPosition).await
    }

    /// For a flash whose erase stops the program: erases nothing from here on. Before that it makes room, where less than half a
    /// sector is free and `supply` is enough: 60 saves of the largest record, 250 of a position. To be called at the start, while
    /// nothing turns.
    ///
    /// # Errors
    /// As [`save`](Self::save); it may still erase then.
    pub async fn erase_ahead(&mut self, supply: &mut impl Supply) -> Result<(), StoreError> {
        Ok(self.log.erase_ahead(supply.is_enough()).await?)
    }

    /// Erases all settings, those of later programs as well. A power cut in it may leave some.
    ///
    /// # Errors
    /// [`StoreError::Flash`].
    pub async fn erase(&mut self) -> Result<(), StoreError> {
        Ok(self.log.format().await?)
    }

    /// Puts a group's body, its version first, into the buffer.
    fn encode(&mut self, settings: &Settings, group: Group) -> Result<u8, Invalid> {
        let Some((version, fields)) = self.log.body().split_first_mut() else {
            return Err(Invalid::Length);
        };
        *version = group.version();
        let length = settings.encode(group, fields)? + 1;
        let length = u8::try_from(length).map_err(|_| Invalid::Length)?;
        self.log.fill(length);
        Ok(length)
    }
}
