//! Where a unit is: a serial port, a pty, a socket.

use core::fmt;
use core::str::FromStr;
use std::io::{self, Read, Write};
use std::net::TcpStream;
use std::time::Duration;

use serial2::SerialPort;

/// The unit's.
pub const BAUD: u32 = 115_200;
/// How long a read of a serial port takes when nothing comes, and a write when nobody takes it.
const TIMEOUT: Duration = Duration::from_millis(200);

/// A way to a unit.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Port {
    /// A serial port or a pty by its path, or its name on Windows.
    Serial(String),
    /// `HOST:PORT`.
    Tcp(String),
}

impl FromStr for Port {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        match text.strip_prefix("tcp:") {
            Some(address) => Ok(Self::Tcp(address_of(address)?)),
            None if text.is_empty() => Err("expected a serial port as /dev/ttyACM0, or tcp:HOST:PORT".to_owned()),
            None => Ok(Self::Serial(text.to_owned())),
        }
    }
}

/// Checks `HOST:PORT`; names are looked up when they are used.
pub(super) fn address_of(text: &str) -> Result<String, String> {
    let number = text.rsplit_once(':').filter(|(host, _)| !host.is_empty());
    match number.map(|(_, number)| number.parse::<u16>()) {
        Some(Ok(_)) => Ok(text.to_owned()),
        _ => Err(format!("expected tcp:HOST:PORT as tcp:127.0.0.1:4001, not tcp:{text}")),
    }
}

impl fmt::Display for Port {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Serial(path) => f.write_str(path),
            Self::Tcp(address) => write!(f, "tcp:{address}"),
        }
    }
}

/// Why a port is of no use.
#[derive(Debug)]
pub enum PortError {
    /// It cannot be opened.
    Open(Port, io::Error),
    /// It was there, and is not any more.
    Lost(Port, Option<io::Error>),
}

impl fmt::Display for PortError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let hint = |e: &io::Error| match e.kind() {
            io::ErrorKind::PermissionDenied => ": join the group of the port, often dialout, and log in again",
            io::ErrorKind::NotFound => ": plug the unit in, or look for its port with `ls /dev/tty[AU]*`",
            io::ErrorKind::ConnectionRefused => ": start `hal-sim unit --serve` there, or check the port",
            _ => "",
        };
        match self {
            Self::Open(port, e) => write!(f, "cannot open {port}: {e}{}", hint(e)),
            Self::Lost(port, Some(e)) => write!(f, "{port} is gone: {e}"),
            Self::Lost(port, None) => write!(f, "{port} is gone: the other end has closed it"),
        }
    }
}

impl core::error::Error for PortError {}

/// Both directions of a port.
type Open = (Box<dyn Read + Send>, Box<dyn Write + Send>);

impl Port {
    /// Opens it: 115200 baud, 8 data bits, no parity, one stop bit, where that means something.
    pub(super) fn open(&self) -> Result<Open, PortError> {
        let opened = match self {
            Self::Serial(path) => serial(path),
            Self::Tcp(address) => tcp(address),
        };
        opened.map_err(|e| PortError::Open(self.clone(), e))
    }
}

fn serial(path: &str) -> io::Result<Open> {
    let mut rx = SerialPort::open(path, BAUD)?;
    rx.set_read_timeout(TIMEOUT)?;
    rx.set_write_timeout(TIMEOUT)?;
    let tx = rx.try_clone()?;
    Ok((Box::new(rx), Box::new(tx)))
}

fn tcp(address: &str) -> io::Result<Open> {
    let rx = TcpStream::connect(address)?;
    // A command is a few bytes, and waited for.
    rx.set_nodelay(true)?;
    let tx = rx.try_clone()?;
    Ok((Box::new(rx), Box::new(tx)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ports_by_name() {
        let port = |text: &str| text.parse::<Port>();
        assert_eq!(port("/dev/ttyACM0"), Ok(Port::Serial("/dev/ttyACM0".to_owned())));
        assert_eq!(port("COM3"), Ok(Port::Serial("COM3".to_owned())));
        assert_eq!(port("tcp:unit:4001"), Ok(Port::Tcp("unit:4001".to_owned())));
        assert_eq!(port("tcp:[::1]:1"), Ok(Port::Tcp("[::1]:1".to_owned())));
        for wrong in ["", "tcp:", "tcp:unit", "tcp::1", "tcp:unit:99999", "tcp:unit:"] {
            assert!(port(wrong).unwrap_err().starts_with("expected "), "{wrong}");
        }
    }

    #[test]
    fn what_cannot_be_opened_says_what_to_do() {
        let Err(error) = Port::Serial("/dev/no-such-port".to_owned()).open() else {
            panic!("it opened");
        };
        let text = error.to_string();
        assert!(
            text.contains("/dev/no-such-port") && text.contains("plug the unit in"),
            "{text}"
        );
    }
}
