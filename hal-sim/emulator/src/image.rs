//! An image: its file, its symbols, and the memory it takes.

use std::env;
use std::path::{Path, PathBuf};

use object::{Object as _, ObjectSection as _, SectionFlags, SectionKind, elf};
use rigless::symbols::Symbols;
use serde::Serialize;

use crate::error::Error;

/// First address of RAM.
const RAM: u64 = 0x2000_0000;

/// A section in the part's memory.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Section {
    /// Its name.
    pub name: String,
    /// Its address.
    pub address: u64,
    /// Its size, bytes.
    pub size: u64,
    /// Whether its contents are in the flash, if only as initial values.
    pub loaded: bool,
}

/// What an image takes of the part's memory.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize)]
pub struct Footprint {
    /// Its sections.
    pub sections: Vec<Section>,
    /// Bytes of flash, initial values of `.data` included.
    pub flash: u64,
    /// Bytes of RAM that are static: all but the stack, which has a region of its own.
    pub static_ram: u64,
}

/// An image read from an ELF file.
#[derive(Debug, Clone)]
pub struct Image {
    pub(crate) file: rigless::image::Image,
    symbols: Symbols,
    footprint: Footprint,
}

impl Image {
    /// Reads an ELF file.
    ///
    /// # Errors
    /// Where it cannot be read, or is no image for the part.
    pub fn read(path: &Path) -> Result<Self, Error> {
        let file = rigless::image::Image::read(path, None)?;
        let symbols = Symbols::read(file.bytes(), rigless::cpu::armv7m::code_address)?;
        let footprint = footprint(file.bytes()).map_err(|e| Error::Elf {
            path: path.to_owned(),
            problem: e.to_string(),
        })?;
        Ok(Self {
            file,
            symbols,
            footprint,
        })
    }

    /// Where the workspace's `cargo fw` puts the release image.
    pub fn release() -> PathBuf {
        let built = "thumbv7em-none-eabihf/release/firmware";
        match env::var_os("CARGO_TARGET_DIR") {
            Some(target) => Path::new(&target).join(built),
            None => Path::new(env!("CARGO_MANIFEST_DIR")).join("../../target").join(built),
        }
    }

    /// The address of a symbol.
    ///
    /// # Errors
    /// Where there is none, or more than one.
    pub fn symbol(&self, name: &str) -> Result<u64, Error> {
        Ok(self.symbols.get(name)?)
    }

    /// What it takes of the part's memory.
    pub fn footprint(&self) -> &Footprint {
        &self.footprint
    }
}

fn footprint(bytes: &[u8]) -> Result<Footprint, object::Error> {
    let file = object::File::parse(bytes)?;
    let mut footprint = Footprint::default();
    for section in file.sections() {
        let SectionFlags::Elf { sh_flags } = section.flags() else {
            continue;
        };
        if sh_flags & u64::from(elf::SHF_ALLOC) == 0 || section.size() == 0 {
            continue;
        }
        let loaded = section.kind() != SectionKind::UninitializedData;
        if loaded {
            footprint.flash += section.size();
        }
        if section.address() >= RAM {
            footprint.static_ram += section.size();
        }
        footprint.sections.push(Section {
            name: section.name()?.to_owned(),
            address: section.address(),
            size: section.size(),
            loaded,
        });
    }
    Ok(footprint)
}
