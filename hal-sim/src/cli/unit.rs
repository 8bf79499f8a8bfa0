//! Simulates the whole unit.

use std::fs::File;
use std::io::{BufWriter, Write as _};
use std::path::{Path, PathBuf};

use clap::Args;
use hal_sim::align::Method;
use hal_sim::bus::UartLine;
use hal_sim::link::serve::{Place, Served};
use hal_sim::outcome::alignment;
use hal_sim::unit_sim::{self, Line, Typed};
use indicatif::ProgressBar;

use super::args::{Base, Simulated, scenario_on};
use super::output::{Done, bar, cannot_write, exit, has_folder, print, print_json, words};
use super::table;

pub(super) const HELP: &str = "\
Prints the unit's log as it comes, then its modes, losses and faults, and the estimate beside the truth. Exit code 0 where it
ends aligned or navigating.

Examples:
  hal-sim unit --scenario paper-sim --seed 1
  hal-sim unit --scenario static --seconds 300 --type \"100 calibrate\"
  hal-sim unit --serve tcp:127.0.0.1:7000     then, elsewhere: hal-sim link tcp:127.0.0.1:7000";

#[derive(Args)]
pub(super) struct UnitArgs {
    #[command(flatten)]
    simulated: Simulated,
    #[command(flatten)]
    base: Base,
    /// Fine filter
    #[arg(long, value_enum, default_value = "robust")]
    method: Method,
    /// Least severe level of the unit's log that is printed
    #[arg(long, value_name = "LEVEL", default_value = "info")]
    log_level: log::LevelFilter,
    /// Write what the unit's serial port sends: NMEA 0183
    #[arg(long, value_name = "FILE")]
    nmea: Option<PathBuf>,
    /// The same with every sample in it, for `replay` and `convert`: types `record on` first of all
    #[arg(long, value_name = "FILE", conflicts_with = "nmea")]
    record: Option<PathBuf>,
    /// Type a line to the unit at a time, s since power-up: "200 calibrate"; may be given again
    #[arg(long = "type", value_name = "\"T LINE\"")]
    typed: Vec<Typed>,
    /// Run in real time with the unit's serial line on a socket, tcp:HOST:PORT, or a pty: for `link`, or what else reads
    /// NMEA 0183; until broken off, unless --seconds is given
    #[arg(long, value_name = "WHERE", conflicts_with = "json")]
    serve: Option<Place>,
    /// Seconds of the unit that pass in one second, 0.01 to 1000
    #[arg(long, value_name = "N", default_value_t = 1.0, requires = "serve", value_parser = speed)]
    speed: f64,
    /// Print the result as JSON, and the log to stderr
    #[arg(long)]
    json: bool,
}

/// Within what a sleeping thread can keep and a machine can simulate.
fn speed(text: &str) -> Result<f64, String> {
    let speed = text.parse().ok().filter(|speed| (0.01..=1000.0).contains(speed));
    speed.ok_or_else(|| "expected a number from 0.01 to 1000".to_owned())
}

pub(super) fn run(args: &UnitArgs, quiet: bool) -> Done {
    let mut scenario = scenario_on(&args.base, &args.simulated)?;
    let port = args.record.as_deref().or(args.nmea.as_deref());
    port.map_or(Ok(()), has_folder)?;
    let served = args.serve.as_ref().map(|place| Served::open(place, args.speed));
    let served = served.transpose().map_err(|e| format!("cannot serve: {e}"))?;
    if let Some(served) = &served {
        if args.simulated.seconds.is_none() {
            scenario.run.duration_s = LONGEST_RUN_S;
        }
        // Also with --quiet: without it nobody finds the unit.
        eprintln!("the unit's serial line: hal-sim link {}", served.name);
    }
    let mut typed = args.typed.clone();
    if args.record.is_some() {
        typed.push(Typed {
            at_s: RECORD_S,
            text: "record on".to_owned(),
        });
    }
    let mut observer = UnitObserver {
        bar: bar(scenario.run.duration_s as u64, "s", quiet),
        level: args.log_level,
        quiet,
        json: args.json,
        nmea: port.map(NmeaFile::create).transpose()?,
        served,
        problem: None,
    };
    let begun = std::time::Instant::now();
    let seed = args.simulated.seed;
    let result = unit_sim::run_session(&scenario, seed, args.method, &typed, &mut observer).map_err(words)?;
    observer.bar.finish_and_clear();
    if let Some(problem) = observer.problem {
        return Err(problem);
    }
    observer.nmea.map_or(Ok(()), NmeaFile::finish)?;
    let ratio = result.t_s / begun.elapsed().as_secs_f64().max(1e-9);
    if args.json {
        print_json(&alignment(&result))?;
    } else {
        print(&table::unit(&result))?;
    }
    if !quiet {
        eprintln!("{ratio:.0} times real time");
    }
    Ok(exit(result.state))
}

/// When a record begins, s: the unit listens.
const RECORD_S: f64 = 0.1;

/// Longest run that a scenario may have, s: four days.
const LONGEST_RUN_S: f64 = 360_000.0;

/// Prints the unit's log as it comes.
struct UnitObserver {
    bar: ProgressBar,
    level: log::LevelFilter,
    quiet: bool,
    json: bool,
    nmea: Option<NmeaFile>,
    served: Option<Served>,
    problem: Option<String>,
}

impl unit_sim::Observer for UnitObserver {
    fn sentence(&mut self, line: &UartLine) {
        if let Some(file) = &mut self.nmea {
            self.problem = file.put(&line.bytes).err().or(self.problem.take());
        }
        if let Some(served) = &mut self.served {
            served.put(&line.bytes);
        }
        // Answers to what was typed belong to the log.
        if line.bytes.starts_with(b"$PRNSA,") {
            let text = String::from_utf8_lossy(&line.bytes).trim_end().to_owned();
            unit_sim::Observer::line(
                self,
                &Line {
                    t_us: line.ended_ns / 1000,
                    level: log::Level::Info,
                    text,
                },
            );
        }
    }

    fn line(&mut self, line: &Line) {
        if line.level > self.level {
            return;
        }
        let Self {
            bar,
            quiet,
            json,
            problem,
            ..
        } = self;
        bar.suspend(|| {
            if !*json {
                *problem = print(&format!("{line}\n")).err().or(problem.take());
            } else if !*quiet {
                eprintln!("{line}");
            }
        });
    }

    fn time(&mut self, t_s: f64) {
        self.bar.set_position(t_s as u64);
        if let Some(served) = &mut self.served {
            served.wait(t_s);
        }
    }

    fn look_us(&self) -> u64 {
        self.served.as_ref().map_or(1_000_000, Served::look_us)
    }

    fn typed(&mut self) -> Vec<u8> {
        self.served.as_mut().map(Served::typed).unwrap_or_default()
    }
}

/// Where the serial port's lines go.
struct NmeaFile {
    path: PathBuf,
    file: BufWriter<File>,
}

impl NmeaFile {
    fn create(path: &Path) -> Result<Self, String> {
        let file = File::create(path).map_err(|e| cannot_write(path, &e))?;
        Ok(Self {
            path: path.to_owned(),
            file: BufWriter::new(file),
        })
    }

    fn put(&mut self, bytes: &[u8]) -> Result<(), String> {
        self.file.write_all(bytes).map_err(|e| cannot_write(&self.path, &e))
    }

    fn finish(mut self) -> Result<(), String> {
        self.file.flush().map_err(|e| cannot_write(&self.path, &e))
    }
}
