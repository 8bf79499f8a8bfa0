//! The other end of a link: a simulated unit in real time, its serial line on a socket or a pty.
//!
//! The unit runs ahead by a look at a time, [`Served::look_us`], and then waits for the clock: what it sends comes so
//! much later than on a wire, and what is typed takes as long to get to it. Where the machine is too slow the unit is
//! late, and does not hurry afterwards.

use core::str::FromStr;
use std::io::{self, Read as _, Write as _};
use std::net::{TcpListener, TcpStream};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread;
use std::time::{Duration, Instant};

use super::port::address_of;

/// Time from look to look.
const LOOK: Duration = Duration::from_millis(10);
/// Later than this the clock is set anew.
const LATE: Duration = Duration::from_millis(500);
/// How long somebody who does not read may hold up the unit.
const WRITE: Duration = Duration::from_millis(50);
/// Bytes that are typed faster than the unit takes them: a line at its speed has no more in a second.
const TYPED: usize = 11_520;

/// Where a unit is to be found.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Place {
    /// A new pty.
    Pty,
    /// `HOST:PORT`; port 0 is one that is free.
    Tcp(String),
}

impl FromStr for Place {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        match (text, text.strip_prefix("tcp:")) {
            ("pty", _) => Ok(Self::Pty),
            (_, Some(address)) => Ok(Self::Tcp(address_of(address)?)),
            _ => Err(format!(
                "expected pty or tcp:HOST:PORT as tcp:127.0.0.1:4001, not {text}"
            )),
        }
    }
}

/// Who is connected, and what was typed.
#[derive(Default)]
struct Far {
    client: Mutex<Option<TcpStream>>,
    typed: Mutex<Vec<u8>>,
}

impl Far {
    fn type_in(&self, bytes: &[u8]) {
        let mut typed = self.typed.lock().unwrap_or_else(PoisonError::into_inner);
        let room = TYPED.saturating_sub(typed.len());
        typed.extend(bytes.iter().take(room));
    }
}

/// What sends what the unit says.
enum Tx {
    Tcp,
    #[cfg(target_os = "linux")]
    Pty {
        unit: serial2::SerialPort,
        /// The end that others open. Kept, so that the line does not hang up when they close it.
        theirs: serial2::SerialPort,
    },
}

/// The far end of a simulated unit's serial line.
pub struct Served {
    /// What to give `hal-sim link`.
    pub name: String,
    far: Arc<Far>,
    tx: Tx,
    speed: f64,
    /// When the unit would have started, had it run in time; of the first look on.
    origin: Option<Instant>,
}

impl Served {
    /// Opens the far end; `speed` seconds of the unit pass in one.
    ///
    /// # Errors
    /// That of the socket or the pty.
    pub fn open(place: &Place, speed: f64) -> io::Result<Self> {
        let far = Arc::<Far>::default();
        let (name, tx) = match place {
            Place::Tcp(address) => {
                let listener = TcpListener::bind(address)?;
                let name = format!("tcp:{}", listener.local_addr()?);
                let theirs = Arc::clone(&far);
                thread::spawn(move || accept(&listener, &theirs));
                (name, Tx::Tcp)
            }
            Place::Pty => pty(&far)?,
        };
        Ok(Self {
            name,
            far,
            tx,
            speed,
            origin: None,
        })
    }

    /// How much of the unit's time passes from look to look, µs.
    pub fn look_us(&self) -> u64 {
        ((LOOK.as_secs_f64() * self.speed * 1e6) as u64).max(1)
    }

    /// Sends what the unit has sent. Nobody there, or nobody who reads: it is lost, as on a wire.
    pub fn put(&mut self, bytes: &[u8]) {
        match &mut self.tx {
            Tx::Tcp => {
                let mut client = self.far.client.lock().unwrap_or_else(PoisonError::into_inner);
                if client.as_mut().is_some_and(|client| client.write_all(bytes).is_err()) {
                    *client = None;
                }
            }
            #[cfg(target_os = "linux")]
            Tx::Pty { unit, theirs } => {
                if unit.write_all(bytes).is_err() {
                    // It is full of what nobody has read: whoever comes gets what is new.
                    let _ = theirs.discard_input_buffer();
                }
            }
        }
    }

    /// What was typed since the last call.
    pub fn typed(&mut self) -> Vec<u8> {
        core::mem::take(&mut *self.far.typed.lock().unwrap_or_else(PoisonError::into_inner))
    }

    /// Waits until it is as late as the unit thinks, s since its power-up.
    pub fn wait(&mut self, t_s: f64) {
        let due = Duration::from_secs_f64((t_s / self.speed).max(0.0));
        let now = Instant::now();
        let origin = *self.origin.get_or_insert(now);
        let ahead = (origin + due).saturating_duration_since(now);
        thread::sleep(ahead);
        if now > origin + due + LATE {
            self.origin = now.checked_sub(due);
        }
    }
}

/// One at a time, as on a wire; the next one waits until the one before has gone.
fn accept(listener: &TcpListener, far: &Far) {
    for client in listener.incoming() {
        let Ok(mut rx) = client else { continue };
        let prepared = rx
            .set_nodelay(true)
            .and_then(|()| rx.set_write_timeout(Some(WRITE)))
            .and_then(|()| rx.try_clone());
        let Ok(tx) = prepared else { continue };
        *far.client.lock().unwrap_or_else(PoisonError::into_inner) = Some(tx);
        let mut bytes = [0; 256];
        while let Ok(count @ 1..) = rx.read(&mut bytes) {
            far.type_in(bytes.get(..count).unwrap_or_default());
        }
        *far.client.lock().unwrap_or_else(PoisonError::into_inner) = None;
    }
}

#[cfg(target_os = "linux")]
fn pty(far: &Arc<Far>) -> io::Result<(String, Tx)> {
    use std::os::fd::AsRawFd as _;

    let (mut unit, theirs) = serial2::SerialPort::pair()?;
    unit.set_read_timeout(Duration::from_secs(1))?;
    unit.set_write_timeout(WRITE)?;
    let name = std::fs::read_link(format!("/proc/self/fd/{}", theirs.as_raw_fd()))?;
    let (rx, typing) = (unit.try_clone()?, Arc::clone(far));
    thread::spawn(move || {
        let mut bytes = [0; 256];
        loop {
            match rx.read(&mut bytes) {
                Ok(count) => typing.type_in(bytes.get(..count).unwrap_or_default()),
                Err(e) if super::is_a_pause(&e) => {}
                Err(_) => return,
            }
        }
    });
    Ok((name.display().to_string(), Tx::Pty { unit, theirs }))
}

#[cfg(not(target_os = "linux"))]
fn pty(_: &Arc<Far>) -> io::Result<(String, Tx)> {
    let text = "ptys are served on Linux only: use tcp:127.0.0.1:4001";
    Err(io::Error::new(io::ErrorKind::Unsupported, text))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn places_by_name() {
        assert_eq!("pty".parse(), Ok(Place::Pty));
        assert_eq!("tcp:127.0.0.1:0".parse(), Ok(Place::Tcp("127.0.0.1:0".to_owned())));
        for wrong in ["", "tty", "tcp:4001", "/dev/pts/3"] {
            assert!(wrong.parse::<Place>().unwrap_err().starts_with("expected "), "{wrong}");
        }
    }

    #[test]
    fn the_unit_waits_for_the_clock_and_does_not_hurry() {
        let mut served = Served::open(&Place::Tcp("127.0.0.1:0".to_owned()), 10.0).unwrap();
        assert_eq!(served.look_us(), 100_000);
        served.wait(0.0);
        let begun = Instant::now();
        served.wait(1.0);
        assert!(begun.elapsed() >= Duration::from_millis(95), "{:?}", begun.elapsed());
        let origin = served.origin.unwrap();
        // Half a minute late.
        served.origin = origin.checked_sub(Duration::from_secs(30));
        served.wait(1.1);
        assert!(served.origin.unwrap() > origin.checked_sub(Duration::from_secs(1)).unwrap());
    }
}
