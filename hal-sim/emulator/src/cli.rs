//! The command's arguments and what it prints.
//!
//! Log, sentences and result go to stdout, the progress bar to stderr. Exit codes: 0 aligned and within 3σ; 1 not
//! aligned; 2 bad input; 3 beyond 3σ; 4 cable wound past its end; 5 the emulator has gaps.

use std::fs::{File, OpenOptions};
use std::io::{self, BufWriter, IsTerminal as _, Read as _, Seek as _, Write};
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::str::FromStr;
use std::sync::{Arc, Mutex, PoisonError};

use clap::Parser;
use emulator::image::Image;
use emulator::log::Line;
use emulator::nmea::{self, Sentence};
use emulator::outcome::{Outcome, Verdict};
use emulator::part::BridgeTimer;
use emulator::report;
use emulator::run::{self, Observer, PowerCut, Press, Setup, Typed};
use hal_sim::align::{Angles, Method};
use hal_sim::scenario::{FaultAt, FaultKind, Scenario};
use hal_sim::unit_sim;
use indicatif::{ProgressBar, ProgressStyle};
use serde::Serialize;
use serde::de::value::{Error as ValueError, StrDeserializer};
use serde::de::{Deserialize as _, IntoDeserializer as _};

/// A file, a scenario or an argument that cannot be used.
const BAD_INPUT: u8 = 2;
/// How long a power cut lasts where nothing else is said, s.
const CUT_S: f64 = 1.0;
/// Length of a press of the button without a length, s.
const PRESS_S: f64 = 0.3;

/// Runs the release image on an emulated STM32F427, with the simulator's devices, motor and swinging base.
#[derive(Parser)]
#[command(name = "emulator", version)]
struct Cli {
    /// The image; without it the one that `cargo fw` has built
    elf: Option<PathBuf>,
    /// Built-in scenario, or a TOML file
    #[arg(long, short, default_value = "paper-sim")]
    scenario: String,
    /// Seed of every chance
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Virtual time from power-up, s
    #[arg(long, value_name = "S", default_value_t = 330.0)]
    seconds: f64,
    /// Break something: NAME@AT or NAME@AT,FOR in s; names as in a scenario's `[[fault]]`
    #[arg(long, value_name = "FAULT")]
    fault: Vec<Timed<FaultKind>>,
    /// Cut the power: AT or AT,FOR in s
    #[arg(long, value_name = "CUT")]
    power_cut: Vec<Timed<()>>,
    /// Type a line on the serial port: AT in s, a blank, the line
    #[arg(long = "type", value_name = "AT LINE", value_parser = typed)]
    typed: Vec<Typed>,
    /// Press the button: AT or AT,FOR in s. A short press stops the rotor, one of two seconds starts it
    #[arg(long, value_name = "PRESS")]
    press: Vec<Timed<()>>,
    /// The settings' flash, bank 2 sectors 12 to 15: what the file holds, if it is there, and what is left goes into it
    #[arg(long, value_name = "FILE")]
    flash: Option<PathBuf>,
    /// Let rigless's own TIM1 drive the bridge: twice as slow
    #[arg(long)]
    full_timer: bool,
    /// Run the unit on simulated buses with the same seed as well, and tell the difference
    #[arg(long)]
    compare: bool,
    /// Write the sentences of the serial line to a file instead of among the log
    #[arg(long, value_name = "FILE")]
    nmea: Option<PathBuf>,
    /// Write all that comes over the serial line, after `--type "1 record on"` with every sample: for `hal-sim replay`
    #[arg(long, value_name = "FILE")]
    record: Option<PathBuf>,
    /// Write the unit's log as a probe gets it, raw frames of defmt: `hal-sim inspect FILE --elf IMAGE` reads them
    #[arg(long, value_name = "FILE")]
    rtt: Option<PathBuf>,
    /// Write the result as JSON
    #[arg(long, value_name = "FILE")]
    json: Option<PathBuf>,
    /// No log, no sentences, no progress bar
    #[arg(long, short)]
    quiet: bool,
}

/// Something that begins at a time and may end.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Timed<T> {
    what: T,
    at_s: f64,
    for_s: Option<f64>,
}

fn times(text: &str) -> Result<(f64, Option<f64>), String> {
    let seconds = |text: &str| match text.parse::<f64>() {
        Ok(s) if s >= 0.0 && s.is_finite() => Ok(s),
        _ => Err(format!("`{text}` is no time in seconds")),
    };
    match text.split_once(',') {
        Some((at, length)) => Ok((seconds(at)?, Some(seconds(length)?))),
        None => Ok((seconds(text)?, None)),
    }
}

fn typed(text: &str) -> Result<Typed, String> {
    let (at, line) = text.split_once(' ').ok_or("AT LINE is expected")?;
    match times(at)? {
        (at_s, None) => Ok(Typed {
            at_s,
            text: line.to_owned(),
        }),
        _ => Err(format!("`{at}` is no time in seconds")),
    }
}

impl FromStr for Timed<FaultKind> {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let (name, rest) = text.split_once('@').ok_or("NAME@AT or NAME@AT,FOR is expected")?;
        let name: StrDeserializer<'_, ValueError> = name.into_deserializer();
        let what = FaultKind::deserialize(name).map_err(|e| e.to_string())?;
        let (at_s, for_s) = times(rest)?;
        Ok(Self { what, at_s, for_s })
    }
}

impl FromStr for Timed<()> {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let (at_s, for_s) = times(text)?;
        Ok(Self { what: (), at_s, for_s })
    }
}

/// The unit on simulated buses at the same instant.
#[derive(Serialize)]
struct Compared {
    t_s: f64,
    error: Angles,
    heading_sd_deg: f64,
    /// Emulated less simulated.
    heading_difference_deg: f64,
    /// Of the core alone on the same samples, without devices, buses and tasks.
    core_heading_error_deg: Option<f64>,
    aligning_at_s: Option<f64>,
}

/// What goes to the JSON file.
#[derive(Serialize)]
struct Report<'a> {
    #[serde(flatten)]
    outcome: &'a Outcome,
    compared: Option<&'a Compared>,
}

/// Prints what happens.
struct Printer {
    bar: ProgressBar,
    quiet: bool,
    nmea: Option<BufWriter<File>>,
    record: Option<BufWriter<File>>,
    rtt: Option<BufWriter<File>>,
    /// The first error of writing sentences or frames.
    failed: Arc<Mutex<Option<io::Error>>>,
}

impl Printer {
    fn keep(&self, written: io::Result<()>) {
        if let Err(e) = written {
            self.failed
                .lock()
                .unwrap_or_else(PoisonError::into_inner)
                .get_or_insert(e);
        }
    }
}

impl Observer for Printer {
    fn line(&mut self, line: &Line) {
        if !self.quiet {
            self.bar.suspend(|| print(&format!("{line}\n")));
        }
    }

    fn sentence(&mut self, sentence: &Sentence) {
        if let Some(file) = &mut self.nmea {
            let written = writeln!(file, "{}\r", sentence.text);
            self.keep(written);
        } else if !self.quiet && !nmea::is_answer(&sentence.text) {
            // An answer is in the log.
            self.bar.suspend(|| print(&format!("{}\n", sentence.text)));
        }
    }

    fn serial(&mut self, byte: u8) {
        if let Some(file) = &mut self.record {
            let written = file.write_all(&[byte]);
            self.keep(written);
        }
    }

    fn rtt(&mut self, bytes: &[u8]) {
        if let Some(file) = &mut self.rtt {
            let written = file.write_all(bytes);
            self.keep(written);
        }
    }

    fn time(&mut self, t_s: f64) {
        self.bar.set_position(t_s as u64);
    }
}

/// Writes to stdout. A reader that has gone away does not end a run: its result is in the exit code.
fn print(text: &str) {
    let _ = io::stdout().lock().write_all(text.as_bytes());
}

/// Parses the command line and does what it says.
pub(crate) fn main() -> ExitCode {
    let cli = Cli::parse();
    match command(&cli) {
        Ok(verdict) => ExitCode::from(match verdict {
            Verdict::Aligned => 0,
            Verdict::NotAligned => 1,
            Verdict::BeyondSigma => 3,
            Verdict::WoundPast => 4,
            Verdict::Gaps => 5,
        }),
        Err(message) => {
            eprintln!("error: {message}");
            ExitCode::from(BAD_INPUT)
        }
    }
}

fn words(error: impl core::fmt::Display) -> String {
    error.to_string()
}

fn command(cli: &Cli) -> Result<Verdict, String> {
    let path = cli.elf.clone().unwrap_or_else(Image::release);
    let image = Image::read(&path).map_err(|e| match &cli.elf {
        Some(_) => words(e),
        None => format!("{e}; `cargo fw` builds the image"),
    })?;
    let mut setup = setup(cli)?;
    let flash = cli
        .flash
        .as_deref()
        .map(|path| open_flash(path, &mut setup))
        .transpose()?;
    let failed = Arc::default();
    let printer = Printer {
        bar: bar(cli),
        quiet: cli.quiet,
        nmea: writer(cli.nmea.as_deref())?,
        record: writer(cli.record.as_deref())?,
        rtt: writer(cli.rtt.as_deref())?,
        failed: Arc::clone(&failed),
    };
    // Before the run: minutes later it would be a pity.
    let json = cli.json.as_deref().map(create).transpose()?;
    let (outcome, printer) = run::run(&image, &setup, printer).map_err(words)?;
    printer.bar.finish_and_clear();
    for file in [printer.nmea, printer.record, printer.rtt].into_iter().flatten() {
        file.into_inner()
            .map_err(|e| format!("cannot write sentences or frames: {e}"))?;
    }
    if let Some(e) = failed.lock().unwrap_or_else(PoisonError::into_inner).take() {
        return Err(format!("cannot write sentences or frames: {e}"));
    }
    if let Some((mut file, path)) = flash.zip(cli.flash.as_deref()) {
        file.rewind()
            .and_then(|()| file.write_all(&outcome.flash))
            .map_err(|e| format!("cannot write {}: {e}", path.display()))?;
    }
    let compared = if cli.compare { compare(&setup, &outcome)? } else { None };
    print(&report::text(&outcome));
    if let Some(compared) = &compared {
        print(&format!(
            "\nthe unit on simulated buses at {:.3} s: heading error {:+.4}°, sd {:.4}°; emulated less simulated \
             {:+.4}°\n",
            compared.t_s, compared.error.heading_deg, compared.heading_sd_deg, compared.heading_difference_deg
        ));
    }
    if let Some(file) = json {
        let report = Report {
            outcome: &outcome,
            compared: compared.as_ref(),
        };
        serde_json::to_writer_pretty(BufWriter::new(file), &report).map_err(|e| format!("cannot write JSON: {e}"))?;
    }
    Ok(outcome.verdict)
}

fn writer(path: Option<&Path>) -> Result<Option<BufWriter<File>>, String> {
    path.map(|path| create(path).map(BufWriter::new)).transpose()
}

fn create(path: &Path) -> Result<File, String> {
    File::create(path).map_err(|e| format!("cannot write {}: {e}", path.display()))
}

/// Opens the file of the flash, for what it holds and for what will be left.
fn open_flash(path: &Path, setup: &mut Setup) -> Result<File, String> {
    let problem = |e| format!("cannot use {}: {e}", path.display());
    let mut options = OpenOptions::new();
    let options = options.read(true).write(true).create(true).truncate(false);
    let mut file = options.open(path).map_err(problem)?;
    let mut bytes = Vec::new();
    file.read_to_end(&mut bytes).map_err(problem)?;
    // A file of no length is one that was not there: the unit is set up for the scenario.
    setup.flash = (!bytes.is_empty()).then_some(bytes);
    Ok(file)
}

fn setup(cli: &Cli) -> Result<Setup, String> {
    let name = cli.scenario.as_str();
    let builtin = Scenario::builtin_names().any(|builtin| builtin == name);
    let mut scenario = if builtin || !Path::new(name).exists() {
        Scenario::builtin(name)
    } else {
        Scenario::load(Path::new(name))
    }
    .map_err(words)?;
    for fault in &cli.fault {
        scenario.fault.push(FaultAt {
            at_s: fault.at_s,
            for_s: fault.for_s,
            kind: fault.what,
        });
    }
    scenario.validate().map_err(words)?;
    if !(cli.seconds > 0.0 && cli.seconds <= 36_000.0) {
        return Err("--seconds: 0 to 36000 are allowed".to_owned());
    }
    let power_cuts = cli.power_cut.iter().map(|cut| PowerCut {
        at_s: cut.at_s,
        for_s: cut.for_s.unwrap_or(CUT_S),
    });
    let presses = cli.press.iter().map(|press| Press {
        at_s: press.at_s,
        for_s: press.for_s.unwrap_or(PRESS_S),
    });
    Ok(Setup {
        power_cuts: power_cuts.collect(),
        typed: cli.typed.clone(),
        presses: presses.collect(),
        timer: if cli.full_timer {
            BridgeTimer::Full
        } else {
            BridgeTimer::Quiet
        },
        ..Setup::new(scenario, cli.seed, cli.seconds)
    })
}

fn bar(cli: &Cli) -> ProgressBar {
    if cli.quiet || !io::stderr().is_terminal() {
        return ProgressBar::hidden();
    }
    let style = ProgressStyle::with_template("{bar:40} {pos}/{len} s, {eta} left")
        .unwrap_or_else(|_| ProgressStyle::default_bar());
    ProgressBar::new(cli.seconds as u64).with_style(style)
}

/// The unit on simulated buses until the instant of the emulated one's last estimate.
fn compare(setup: &Setup, outcome: &Outcome) -> Result<Option<Compared>, String> {
    let (Some(last), Some(aligning_s)) = (&outcome.last, outcome.first("coarse")) else {
        return Ok(None);
    };
    let mut scenario = setup.scenario.clone();
    scenario.run.duration_s = last.t_s - aligning_s;
    let result = unit_sim::run(&scenario, setup.seed, Method::Robust, &mut ()).map_err(words)?;
    Ok(result.last.map(|simulated| Compared {
        t_s: simulated.t_s,
        error: simulated.error,
        heading_sd_deg: simulated.reading.sd.heading_deg,
        heading_difference_deg: last.error.heading_deg - simulated.error.heading_deg,
        core_heading_error_deg: result.core.map(|core| core.error.heading_deg),
        aligning_at_s: result.aligning_at_s,
    }))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_typed_has_its_time() {
        let line = typed("12.5 set latitude 40.1").unwrap();
        assert_eq!((line.at_s, line.text.as_str()), (12.5, "set latitude 40.1"));
        assert!(typed("12.5").is_err() && typed("12.5,3 x").is_err() && typed("soon x").is_err());
    }

    #[test]
    fn faults_have_names_and_times() {
        let fault: Timed<FaultKind> = "imu-crc@40,1.5".parse().unwrap();
        assert_eq!(
            (fault.what, fault.at_s, fault.for_s),
            (FaultKind::ImuCrc, 40.0, Some(1.5))
        );
        assert_eq!("jam@3".parse::<Timed<FaultKind>>().unwrap().for_s, None);
        for wrong in ["jam", "jam@", "jam@-1", "jam@nan", "hunger@3", "jam@1,2,3"] {
            assert!(wrong.parse::<Timed<FaultKind>>().is_err(), "{wrong}");
        }
    }

    #[test]
    fn arguments_are_consistent() {
        use clap::CommandFactory as _;
        Cli::command().debug_assert();
    }
}
