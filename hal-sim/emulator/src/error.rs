//! What can go wrong before and in a run.

use std::path::PathBuf;

use hal_sim::config::Violation;

/// Why an image cannot be run.
#[derive(Debug)]
#[non_exhaustive]
pub enum Error {
    /// The image cannot be read or placed.
    Image(rigless::image::Error),
    /// The image has no such symbol.
    Symbol(rigless::symbols::Error),
    /// The file is no ELF file.
    Elf {
        /// The file.
        path: PathBuf,
        /// What is wrong with it.
        problem: String,
    },
    /// The image has no table of its log's texts.
    NoLog {
        /// What is wrong.
        problem: String,
    },
    /// The scenario has a figure out of range.
    Scenario(Violation),
    /// The flash to start from has another length than the settings' sectors.
    Flash {
        /// Bytes of the sectors.
        expected: usize,
        /// Bytes found.
        found: usize,
    },
    /// The part does not assemble.
    Part(rigless::soc::Error),
    /// The emulator cannot go on.
    Run(rigless::emulator::Error),
}

impl core::fmt::Display for Error {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            Self::Image(e) => e.fmt(f),
            Self::Symbol(e) => e.fmt(f),
            Self::Elf { path, problem } => write!(f, "{}: {problem}", path.display()),
            Self::NoLog { problem } => write!(f, "the image's log cannot be read: {problem}"),
            Self::Scenario(e) => e.fmt(f),
            Self::Flash { expected, found } => {
                write!(f, "flash of {found} bytes, where the settings have {expected}")
            }
            Self::Part(e) => e.fmt(f),
            Self::Run(e) => write!(f, "emulator: {e}"),
        }
    }
}

impl core::error::Error for Error {}

impl From<rigless::image::Error> for Error {
    fn from(e: rigless::image::Error) -> Self {
        Self::Image(e)
    }
}

impl From<rigless::symbols::Error> for Error {
    fn from(e: rigless::symbols::Error) -> Self {
        Self::Symbol(e)
    }
}

impl From<Violation> for Error {
    fn from(e: Violation) -> Self {
        Self::Scenario(e)
    }
}

impl From<rigless::soc::Error> for Error {
    fn from(e: rigless::soc::Error) -> Self {
        Self::Part(e)
    }
}

impl From<rigless::emulator::Error> for Error {
    fn from(e: rigless::emulator::Error) -> Self {
        Self::Run(e)
    }
}
