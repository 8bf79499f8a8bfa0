//! One walk over the fields of a group does all three: checks them, writes them, reads them. So a range cannot be
//! checked on one way and forgotten on another.
//!
//! Numbers are little-endian and as wide as in memory, one after the other: what `postcard` makes of the same fields
//! with `fixint::le`. It is not used here: its derived readers of these groups take more flash than all of this module.

use core::fmt;

/// Why a value is refused. Its text says what would be taken; on the target write it from the fields, for formatting an
/// f32 takes 14 kB of flash.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Invalid {
    /// Not a number, or out of range.
    OutOfRange {
        /// The field.
        name: &'static str,
        /// The least that is taken, in the field's unit.
        low: f32,
        /// The most.
        high: f32,
    },
    /// A text with a character that is not printable ASCII, or that ends fields of NMEA 0183.
    Text {
        /// The field.
        name: &'static str,
    },
    /// The record is shorter or longer than its fields.
    Length,
}

impl fmt::Display for Invalid {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::OutOfRange { name, low, high } => write!(f, "{name} must be between {low} and {high}"),
            Self::Text { name } => write!(f, "{name} must be printable ASCII without $ * , ! and \\"),
            Self::Length => f.write_str("the record has another length than its fields: save the group again"),
        }
    }
}

impl core::error::Error for Invalid {}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Way {
    Check,
    Write,
    Read,
}

/// The walker.
pub(super) struct Codec<'a> {
    way: Way,
    bytes: &'a mut [u8],
    at: usize,
    /// The first thing wrong.
    wrong: Option<Invalid>,
}

impl<'a> Codec<'a> {
    pub(super) fn check() -> Self {
        Self::new(Way::Check, &mut [])
    }

    pub(super) fn write(bytes: &'a mut [u8]) -> Self {
        Self::new(Way::Write, bytes)
    }

    pub(super) fn read(bytes: &'a mut [u8]) -> Self {
        Self::new(Way::Read, bytes)
    }

    fn new(way: Way, bytes: &'a mut [u8]) -> Self {
        Self {
            way,
            bytes,
            at: 0,
            wrong: None,
        }
    }

    /// How many bytes the walk took.
    ///
    /// # Errors
    /// The first value that is refused; [`Invalid::Length`] where not all that was to be read was read.
    pub(super) fn end(self) -> Result<usize, Invalid> {
        match self.wrong {
            Some(wrong) => Err(wrong),
            None if self.way == Way::Read && self.at != self.bytes.len() => Err(Invalid::Length),
            None => Ok(self.at),
        }
    }

    /// Notes what is wrong, unless something was before.
    pub(super) fn refuse(&mut self, wrong: Invalid) {
        self.wrong.get_or_insert(wrong);
    }

    /// Moves `N` bytes one way or the other.
    fn raw<const N: usize>(&mut self, value: &mut [u8; N]) {
        let from = self.at;
        self.at += N;
        if self.way == Way::Check {
            return;
        }
        match self.bytes.get_mut(from..self.at) {
            Some(bytes) if self.way == Way::Write => bytes.copy_from_slice(value),
            Some(bytes) => value.copy_from_slice(bytes),
            None => self.refuse(Invalid::Length),
        }
    }

    /// A number in [low, high].
    pub(super) fn number(&mut self, name: &'static str, value: &mut f32, low: f32, high: f32) {
        let mut bytes = value.to_le_bytes();
        self.raw(&mut bytes);
        *value = f32::from_le_bytes(bytes);
        // A NaN is in no range.
        if !(low..=high).contains(value) {
            self.refuse(Invalid::OutOfRange { name, low, high });
        }
    }

    /// Numbers in [−most, most].
    pub(super) fn numbers(&mut self, name: &'static str, values: &mut [f32], most: f32) {
        for value in values {
            self.number(name, value, -most, most);
        }
    }

    /// A whole number in [low, high], high below 2²⁴, where the error still tells it exactly.
    pub(super) fn count(&mut self, name: &'static str, value: &mut u32, low: u32, high: u32) {
        let mut bytes = value.to_le_bytes();
        self.raw(&mut bytes);
        *value = u32::from_le_bytes(bytes);
        if !(low..=high).contains(value) {
            self.refuse(Invalid::OutOfRange {
                name,
                low: low as f32,
                high: high as f32,
            });
        }
    }

    /// A small whole number in [0, high].
    pub(super) fn byte(&mut self, name: &'static str, value: &mut u8, high: u8) {
        let mut bytes = [*value];
        self.raw(&mut bytes);
        [*value] = bytes;
        if *value > high {
            self.refuse(Invalid::OutOfRange {
                name,
                low: 0.0,
                high: f32::from(high),
            });
        }
    }

    /// A text, filled up with zeros.
    pub(super) fn text<const N: usize>(&mut self, name: &'static str, value: &mut [u8; N]) {
        self.raw(value);
        let good = |byte: &&u8| matches!(byte, b' '..=b'~') && !b"$*,!\\".contains(byte);
        let mut fill = value.iter().skip_while(good);
        if fill.any(|byte| *byte != 0) {
            self.refuse(Invalid::Text { name });
        }
    }
}
