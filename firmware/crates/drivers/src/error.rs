//! What can go wrong between a driver and its device.

use embedded_hal::{digital, spi};
use frames::wording;

use crate::Channels;

/// Why a driver has no result. One enum for the crate: the supervisor treats all devices alike.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
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

wording!(Error, |self, say| {
    match *self {
        Self::Bus(kind) => say!("SPI error {:?}: check the clock rate and the DMA channel", kind),
        Self::Pin(kind) => say!("pin error {:?}: check the port expander or the board file", kind),
        Self::Silent { level } => say!(
            "every byte reads {:#04x}: check supply, chip select and MISO of the device",
            level
        ),
        Self::WhoAmI { expected, found } => say!(
            "identity {:#06x} where {:#06x} belongs: check the part fitted, the SPI mode and chip select",
            found,
            expected
        ),
        Self::Model { expected, found } => say!(
            "range code {:#06x} where {:#06x} belongs: another model is fitted, use its scale factors",
            found,
            expected
        ),
        Self::Register { address, wrote, read } => say!(
            "register {:#06x} reads {:#06x} after writing {:#06x}: reset the part and configure again",
            address,
            read,
            wrote
        ),
        Self::Config { address, value } => say!(
            "{:#06x} is no setting for register {:#06x}: correct the configuration",
            value,
            address
        ),
        Self::Header { found } => say!(
            "burst begins with {:#06x}: select page 0, keep the stall time, retry once",
            found
        ),
        Self::Crc { computed, received } => say!(
            "CRC {:#x} received, {:#x} computed: drop the sample; if it persists shorten the lines or lower the clock",
            received,
            computed
        ),
        Self::SelfTest { failed } => say!(
            "self-test failed on {}: repeat at rest, replace the part if it persists",
            failed
        ),
        Self::Invalid { channels } => say!("no valid data on {}: wait for the sensor to start", channels),
        Self::Restarted { status } => say!("the part was reset (status {:#06x}): configure it again", status),
        Self::DriverFault => {
            say!("motor driver reports a fault: leave it off, check supply, current and temperature, then reset it")
        }
    }
});

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
