//! How deep the stack was, by painting: its region holds a pattern before the first instruction, and what of it is gone
//! at the end was used.
//!
//! It sees what was written. A frame whose lowest words nobody wrote is deeper than it shows; the margin is for that.

use rigless::emulator::Memory;
use rigless::soc::Width;
use serde::Serialize;

use crate::error::Error;
use crate::image::Image;

/// The paint: no address in this part and no small number.
const PAINT: u32 = 0xC5C5_C5C5;
/// Bytes of a word.
const WORD: u64 = 4;

/// The stack's region, and how much of it was used.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
pub struct Stack {
    /// Lowest address.
    pub low: u64,
    /// Size, bytes.
    pub size: u64,
    /// Bytes that were used at the most.
    pub used: u64,
}

impl Stack {
    /// The stack of an image: from `_stack_end` up to `_stack_start`.
    ///
    /// # Errors
    /// Where the image has no such symbols.
    pub fn of(image: &Image) -> Result<Self, Error> {
        let (low, high) = (image.symbol("_stack_end")?, image.symbol("_stack_start")?);
        Ok(Self {
            low,
            size: high.saturating_sub(low),
            used: 0,
        })
    }

    /// Share of the region that was never used.
    pub fn margin(&self) -> f64 {
        1.0 - self.used as f64 / self.size.max(1) as f64
    }

    /// The paint as an image, to be placed beside the firmware's.
    pub(crate) fn paint(&self) -> Result<rigless::image::Image, Error> {
        let words = (self.size / WORD) as usize;
        let bytes = PAINT.to_le_bytes().repeat(words);
        Ok(rigless::image::Image::new(
            "paint of the stack".as_ref(),
            bytes,
            Some(self.low),
        )?)
    }

    /// Paints it anew.
    pub(crate) fn repaint<M: Memory + ?Sized>(&self, memory: &mut M) {
        for address in (self.low..self.low + self.size).step_by(WORD as usize) {
            // The region is RAM: it was painted before.
            let _ = memory.write(address, Width::W32, u64::from(PAINT));
        }
    }

    /// Looks how much of the paint is gone.
    pub(crate) fn look<M: Memory + ?Sized>(&mut self, memory: &mut M) {
        let top = self.low + self.size;
        let lowest = (self.low..top)
            .step_by(WORD as usize)
            .find(|address| memory.read(*address, Width::W32).ok() != Some(u64::from(PAINT)))
            .unwrap_or(top);
        self.used = self.used.max(top - lowest);
    }
}
