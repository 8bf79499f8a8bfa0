//! What can go wrong between a driver and its device.

use core::fmt;

use embedded_hal::{digital, spi};

use crate::Channels;

/// Why a driver has no result. One enum for the crate: the supervisor treats all devices alike.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Error {
    /// The SPI peripheral reported an error.
    Bus(spi::ErrorKind),
    /// A pin could not be read or driven.
    Pin(digital::ErrorKind),
    /// The line is stuck: every byte of the reply is `level`.
    Silent {
        /// The byte repeated, 0x00 or 0xFF.
        level: u8,
    },
    /// Another part answers, or none.
    WhoAmI {
        /// The identity this driver serves.
        expected: u16,
        /// The identity read.
        found: u16,
    },
    /// The right part with another measuring range: all scale factors would be wrong.
    Model {
        /// The range code this driver serves.
        expected: u16,
        /// The range code read.
        found: u16,
    },
    /// A setting did not take.
    Register {
        /// Page or bank in the high byte, address in the low one.
        address: u16,
        /// The value written.
        wrote: u16,
        /// The value read back.
        read: u16,
    },
    /// A figure of the configuration is outside what the part can do; nothing was written.
    Config {
        /// Page or bank in the high byte, address in the low one.
        address: u16,
        /// The value refused.
        value: u16,
    },
    /// A write was not acknowledged.
    Acknowledge {
        /// The byte that acknowledges.
        expected: u8,
        /// The byte read.
        found: u8,
    },
    /// A burst does not begin as it must.
    Header {
        /// The word in the place of the burst's identifier.
        found: u16,
    },
    /// The check sum does not fit the data.
    Crc {
        /// Over the data received.
        computed: u32,
        /// As received.
        received: u32,
    },
    /// The self-test found sensors that do not respond as they should.
    SelfTest {
        /// The sensors that failed.
        failed: Channels,
    },
    /// The part marks data as not valid.
    Invalid {
        /// The sensors marked.
        channels: Channels,
    },
    /// The part did not come out of reset, or did one of its own accord and lost its settings.
    Restarted {
        /// The status register that shows it.
        status: u16,
    },
    /// The motor driver holds its fault line low.
    DriverFault,
}

impl Error {
    /// Of an SPI device's error, the kind.
    pub(crate) fn bus<E: spi::Error>(error: E) -> Self {
        Self::Bus(error.kind())
    }

    /// Of a pin's error, the kind.
    pub(crate) fn pin<E: digital::Error>(error: E) -> Self {
        Self::Pin(error.kind())
    }
}

impl fmt::Display for Error {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match *self {
            Self::Bus(kind) => write!(f, "SPI error {kind:?}: check the clock rate and the DMA channel"),
            Self::Pin(kind) => write!(f, "pin error {kind:?}: check the port expander or the board file"),
            Self::Silent { level } => write!(
                f,
                "every byte reads {level:#04x}: check supply, chip select and MISO of the device"
            ),
            Self::WhoAmI { expected, found } => write!(
                f,
                "identity {found:#06x} where {expected:#06x} belongs: check the part fitted, the SPI mode and chip select"
            ),
            Self::Model { expected, found } => write!(
                f,
                "range code {found:#06x} where {expected:#06x} belongs: another model is fitted, use its scale factors"
            ),
            Self::Register { address, wrote, read } => write!(
                f,
                "register {address:#06x} reads {read:#06x} after writing {wrote:#06x}: reset the part and configure again"
            ),
            Self::Config { address, value } => write!(
                f,
                "{value:#06x} is no setting for register {address:#06x}: correct the configuration"
            ),
            Self::Acknowledge { expected, found } => write!(
                f,
                "write acknowledged with {found:#04x} instead of {expected:#04x}: check MOSI and the SPI mode, then retry"
            ),
            Self::Header { found } => write!(
                f,
                "burst begins with {found:#06x}: select page 0, keep the stall time, retry once"
            ),
            Self::Crc { computed, received } => write!(
                f,
                "CRC {received:#x} received, {computed:#x} computed: drop the sample; if it persists shorten the lines or lower the clock"
            ),
            Self::SelfTest { failed } => write!(
                f,
                "self-test failed on {failed}: repeat at rest, replace the part if it persists"
            ),
            Self::Invalid { channels } => write!(f, "no valid data on {channels}: wait for the sensor to start"),
            Self::Restarted { status } => {
                write!(f, "the part was reset (status {status:#06x}): configure it again")
            }
            Self::DriverFault => f.write_str(
                "motor driver reports a fault: leave it off, check supply, current and temperature, then reset it",
            ),
        }
    }
}

impl core::error::Error for Error {}

#[cfg(test)]
mod tests {
    use std::string::ToString;

    use super::*;

    #[test]
    fn messages_carry_the_facts() {
        let text = Error::WhoAmI {
            expected: 0x406F,
            found: 0xFFFF,
        }
        .to_string();
        assert!(text.contains("0x406f") && text.contains("0xffff"), "{text}");
        let text = Error::SelfTest {
            failed: Channels::RATE_X | Channels::FORCE_Z,
        }
        .to_string();
        assert!(text.contains("gyro x, accelerometer z"), "{text}");
    }
}
