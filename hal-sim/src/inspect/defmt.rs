//! A log as the image writes it: defmt's frames over RTT, and the ELF file without which they are numbers.
//!
//! A frame is encoded in reverse zero-compressing COBS and ends with a zero byte, so whatever is lost or damaged costs
//! the frames it is in and no others. It begins with the place of its text in the image. A frame of another image is
//! therefore decoded as another text, or none. That is seen by its length: what the text asks for must be all there is.

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::{Path, PathBuf};

use defmt_decoder::{Encoding, Table};

use super::InspectError;
use super::text::{self, Line};

/// No frame of the unit is as long, bytes; where no end comes for that long, none will.
const LONGEST: usize = 16 * 1024;
/// Zeros that the encoding may add at the end of a frame.
const PADDING: usize = 7;

/// What an image's frames mean.
#[derive(Debug)]
pub struct Elf {
    path: PathBuf,
    table: Table,
}

impl Elf {
    /// Reads it from the image's ELF file.
    ///
    /// # Errors
    /// [`InspectError`] where the file cannot be read, or is no image that logs by defmt.
    pub fn read(path: &Path) -> Result<Self, InspectError> {
        let bytes = std::fs::read(path).map_err(|e| InspectError::Read(path.to_owned(), e.to_string()))?;
        let elf = |problem: String| InspectError::Elf {
            path: path.to_owned(),
            problem,
        };
        // What an ELF file is made of is not the decoder's to trust, but it does in places.
        let table = catch_unwind(|| Table::parse(&bytes))
            .map_err(|_| elf("its table of texts is damaged".to_owned()))?
            .map_err(|e| elf(e.to_string()))?
            .ok_or_else(|| elf("it has no .defmt section, so it is no image that logs".to_owned()))?;
        if table.encoding() != Encoding::Rzcobs {
            return Err(elf(
                "its log is not encoded in rzCOBS; build it without `encoding-raw`".to_owned()
            ));
        }
        Ok(Self {
            path: path.to_owned(),
            table,
        })
    }

    /// Where it was read.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// A frame without the zero that ends it.
    fn line(&self, frame: &[u8]) -> Option<Line> {
        let bytes = rzcobs::decode(frame).ok()?;
        // The decoder is made for sound frames and asserts here and there what damaged ones do not keep.
        catch_unwind(AssertUnwindSafe(|| {
            let (frame, consumed) = self.table.decode(&bytes).ok()?;
            let rest = bytes.get(consumed..)?;
            if rest.len() > PADDING || rest.iter().any(|b| *b != 0) {
                return None;
            }
            let time = frame.display_timestamp().map(|t| t.to_string());
            Some(Line {
                t_s: time.as_deref().and_then(text::time),
                level: frame.level().and_then(|level| level.as_str().parse().ok()),
                text: frame.display_message().to_string(),
            })
        }))
        .ok()
        .flatten()
    }
}

/// Cuts a stream into frames.
#[derive(Debug, Default)]
pub struct Frames {
    rest: Vec<u8>,
}

impl Frames {
    /// Takes bytes as they come. Each frame that ends with them is a line, or none where it is damaged.
    pub fn push(&mut self, bytes: &[u8], elf: &Elf, each: &mut dyn FnMut(Option<Line>)) {
        for part in bytes.split_inclusive(|b| *b == 0) {
            self.rest.extend_from_slice(part);
            if self.rest.last() == Some(&0) {
                self.rest.pop();
                // A zero alone is a frame's end before the first frame.
                if !self.rest.is_empty() {
                    each(elf.line(&self.rest));
                }
                self.rest.clear();
            } else if self.rest.len() > LONGEST {
                each(None);
                self.rest.clear();
            }
        }
    }
}
