//! Shows what a unit sends, and sends it commands.

use std::path::PathBuf;
use std::process::ExitCode;
use std::time::Duration;

use clap::Args;
use hal_sim::link::{self, Link};

use super::args::seconds;
use super::colour::{self, Sense};
use super::output::{Done, has_folder, words};

pub(super) const HELP: &str = "\
Prints the unit's state, live, and its answers; on a terminal, type commands below (docs/serial.md).

Examples:
  hal-sim link /dev/ttyACM0
  hal-sim link /dev/ttyACM0 --send \"set latitude 40.1\" --send save
  hal-sim link tcp:127.0.0.1:7000 --record LOG.bin --seconds 600";

#[derive(Args)]
pub(super) struct LinkArgs {
    /// Serial port, as /dev/ttyACM0, a pty, or tcp:HOST:PORT
    port: link::Port,
    /// Send a line, wait for the answer and print it: "set latitude 40.1"; may be given again. Exit code 1 where one is
    /// refused or not answered; the next are then not sent. `calibrate` is followed to its end
    #[arg(long, value_name = "LINE")]
    send: Vec<String>,
    /// How long an answer may take, s
    #[arg(long, value_name = "S", default_value_t = 2.0, requires = "send", allow_negative_numbers = true, value_parser = seconds)]
    timeout: f64,
    /// Write what comes from the unit, byte by byte
    #[arg(long, value_name = "FILE")]
    record: Option<PathBuf>,
    /// End after so long, s (default: when broken off)
    #[arg(long, value_name = "S", conflicts_with = "send", allow_negative_numbers = true, value_parser = seconds)]
    seconds: Option<f64>,
}

/// A unit refuses a command, or does not answer.
const REFUSED: u8 = 1;

pub(super) fn run(args: &LinkArgs) -> Done {
    args.record.as_deref().map_or(Ok(()), has_folder)?;
    let mut open = Link::open(args.port.clone(), args.record.as_deref()).map_err(words)?;
    let done = if args.send.is_empty() {
        link::watch(&mut open, args.seconds.map(Duration::from_secs_f64))
    } else {
        link::send(&mut open, &args.send, Duration::from_secs_f64(args.timeout))
    };
    match done {
        Ok(()) => Ok(ExitCode::SUCCESS),
        Err(e) if e.is_answer() => {
            eprintln!("{} {e}", colour::said("error:", Sense::Bad));
            Ok(ExitCode::from(REFUSED))
        }
        Err(e) => Err(e.to_string()),
    }
}
