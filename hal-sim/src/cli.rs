//! Commands, their arguments and what they print.
//!
//! Results go to stdout, progress and warnings to stderr. Exit codes: 0 aligned, 1 not aligned, 2 bad input;
//! of `link` 1 where the unit refuses or does not answer.

mod colour;
mod help;

use std::fs::File;
use std::io::{self, BufReader, BufWriter, IsTerminal as _, Read, Write as _};
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::time::Duration;

use clap::{Args, CommandFactory as _, Parser, Subcommand};
use hal_sim::align::{self, Angles, Method, Setup};
use hal_sim::allan::{self, AllanError};
use hal_sim::bound::{self, Bound, BoundConfig};
use hal_sim::bus::UartLine;
use hal_sim::calibrate::{self, CalibrateError, Stand};
use hal_sim::config::ConfigProblem;
use hal_sim::inspect::{self, defmt::Elf, live, live::Tail};
use hal_sim::link::serve::{Place, Served};
use hal_sim::link::{self, Link};
use hal_sim::log::{Header, LogError, LogReader, LogRow, LogWarning, LogWriter, UnitStatus, convert_from, not_itself};
use hal_sim::monte_carlo::{self, MethodReport, READY_SD_DEG, Statistics};
use hal_sim::observability::{self, Attitude, Axis, Segment};
use hal_sim::replay::{self, Replay};
use hal_sim::report::{self, Origin};
use hal_sim::reproduce;
use hal_sim::scenario::Scenario;
use hal_sim::simulate::{self, Moment, Row, RunResult};
use hal_sim::soak::SoakConfig;
use hal_sim::unit::Unit;
use hal_sim::unit_sim::{self, Drift, Line, Typed, UnitResult};
use indicatif::{ProgressBar, ProgressBarIter, ProgressFinish, ProgressStyle};
use nav::aligner::Event;
use nav::rotor::RotorConfig;

use colour::Sense;

/// Not aligned, or a result the unit does not stand by.
const NOT_ALIGNED: u8 = 1;
/// A unit refuses a command, or does not answer.
const REFUSED: u8 = 1;
/// A file, a scenario or an argument that cannot be used.
const BAD_INPUT: u8 = 2;

/// Simulates a rotary MEMS IMU unit that finds true north on a swinging base, and replays recorded logs.
///
/// Without a command: `run`.
#[derive(Parser)]
#[command(name = "hal-sim", version, propagate_version = true, after_help = help::ALL)]
struct Cli {
    #[command(subcommand)]
    command: Option<Command>,
    /// Results, warnings and errors only: no progress, no events
    #[arg(long, short, global = true)]
    quiet: bool,
}

#[derive(Subcommand)]
enum Command {
    /// Simulate one run and report it
    #[command(after_help = help::RUN)]
    Run(RunArgs),
    /// Simulate many runs and report their statistics
    #[command(after_help = help::MONTE_CARLO)]
    MonteCarlo(MonteCarloArgs),
    /// Compute the least σ that any filter can have: the covariance of the ideal one along the true path
    #[command(after_help = help::BOUND)]
    Bound(BoundArgs),
    /// Run the core on a recorded log
    #[command(after_help = help::REPLAY)]
    Replay(ReplayArgs),
    /// Simulate the whole unit: application, devices, buses and motor in virtual time
    #[command(after_help = help::UNIT)]
    Unit(UnitArgs),
    /// Run the whole unit for hours while chance breaks it, types at it and shakes its lines
    #[command(after_help = help::SOAK)]
    Soak(SoakArgs),
    /// Show what a unit sends, live, and send it commands
    #[command(after_help = help::LINK)]
    Link(LinkArgs),
    /// Tell which errors of a resting, turning IMU its velocity makes observable
    #[command(after_help = help::OBSERVABILITY)]
    Observability(ObservabilityArgs),
    /// Allan deviation of a log at rest: the noise and bias figures of an IMU
    #[command(after_help = help::ALLAN)]
    Allan(AllanArgs),
    /// Biases, misalignments and scale factor of the gyros from a log of a rest and a turn
    #[command(after_help = help::CALIBRATE)]
    Calibrate(CalibrateArgs),
    /// Write a log, also the recording of a unit's serial line, as CSV
    #[command(after_help = help::CONVERT)]
    Convert {
        /// Log to read
        log: PathBuf,
        /// CSV to write
        csv: PathBuf,
    },
    /// Reproduce the papers' tables and figures: what is published beside ours
    #[command(after_help = help::REPRODUCE)]
    Reproduce(ReproduceArgs),
    /// Inspect a unit's log: modes, estimates, faults, resets with their times, as table, CSV and chart
    #[command(after_help = help::INSPECT)]
    Inspect(InspectArgs),
    /// List the built-in scenarios, or print one as a start for your own
    #[command(after_help = help::SCENARIOS)]
    Scenarios {
        /// Name of the scenario to print
        name: Option<String>,
    },
    /// Print the completions of commands and options for a shell
    #[command(after_help = help::COMPLETIONS)]
    Completions {
        /// The shell
        shell: clap_complete::Shell,
    },
}

/// What is simulated.
#[derive(Args)]
struct Simulated {
    /// Built-in scenario (`hal-sim scenarios` lists them), or a TOML file
    #[arg(long, short, value_name = "NAME|FILE", default_value = "paper-sim")]
    scenario: String,
    /// Seed of every chance: the same one gives the same run, to the bit
    #[arg(long, value_name = "N", default_value_t = 1)]
    seed: u64,
    /// Length of a run, s (default: the scenario's); of `unit`, from the beginning of its alignment
    #[arg(long, visible_alias = "duration", value_name = "S", allow_negative_numbers = true)]
    seconds: Option<f64>,
}

/// What the unit is told of its base.
#[derive(Args)]
struct Base {
    /// The base is fixed to Earth: measure the z gyro by the encoder, 1σ of an angle read, arcsec (without a number: 10)
    #[arg(long, value_name = "ARCSEC", num_args = 0..=1, require_equals = true, default_missing_value = "10", value_parser = arcsec)]
    encoder_constraint: Option<f64>,
}

/// Zero is an exact encoder.
fn arcsec(text: &str) -> Result<f64, String> {
    text.parse()
        .ok()
        .filter(|sd| (0.0..=3600.0).contains(sd))
        .ok_or_else(|| "expected a number of 0 to 3600".to_owned())
}

#[derive(Args)]
struct RunArgs {
    #[command(flatten)]
    simulated: Simulated,
    #[command(flatten)]
    base: Base,
    /// Fine filter
    #[arg(long, value_enum, default_value = "robust")]
    method: Method,
    /// Write the samples as a CSV log that `replay` reads
    #[arg(long, value_name = "FILE")]
    log: Option<PathBuf>,
    /// Folder for the report
    #[arg(long, value_name = "DIR", default_value = "report")]
    report: PathBuf,
    /// Print the result as JSON
    #[arg(long)]
    json: bool,
}

#[derive(Args)]
struct MonteCarloArgs {
    #[command(flatten)]
    simulated: Simulated,
    #[command(flatten)]
    base: Base,
    /// Number of runs
    #[arg(long, short = 'n', value_name = "N", default_value_t = 100, value_parser = clap::value_parser!(u64).range(1..=1_000_000))]
    runs: u64,
    /// Fine filters, each on the same runs; `fine` in the JSON is the first
    #[arg(long, value_enum, value_delimiter = ',', default_value = "robust")]
    method: Vec<Method>,
    /// Folder for the report
    #[arg(long, value_name = "DIR", default_value = "report")]
    report: PathBuf,
    /// Print the result as JSON
    #[arg(long)]
    json: bool,
}

#[derive(Args)]
struct BoundArgs {
    #[command(flatten)]
    simulated: Simulated,
    /// How well zero velocity is known once a second, m/s
    #[arg(long, value_name = "V", allow_negative_numbers = true, default_value_t = BoundConfig::default().velocity_sd)]
    velocity_sd: f64,
    /// Folder for the report
    #[arg(long, visible_alias = "report", value_name = "DIR", default_value = "report")]
    out: PathBuf,
    /// Print the result as JSON
    #[arg(long)]
    json: bool,
}

#[derive(Args)]
struct UnitArgs {
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

#[derive(Args)]
struct LinkArgs {
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

fn hours(text: &str) -> Result<f64, String> {
    let hours = text.parse().ok().filter(|hours| (0.1..=10_000.0).contains(hours));
    hours.ok_or_else(|| "expected hours from 0.1 to 10000".to_owned())
}

fn seconds(text: &str) -> Result<f64, String> {
    let seconds = text.parse().ok().filter(|seconds| (0.001..=1e9).contains(seconds));
    seconds.ok_or_else(|| "expected seconds above 0".to_owned())
}

#[derive(Args)]
struct ReplayArgs {
    /// CSV log: t_s, gyro_x/y/z_rad_s, accel_x/y/z_m_s2, encoder_rad by header, in any order; or the recording of a
    /// unit's serial line
    log: PathBuf,
    /// Geodetic latitude of the place, degrees, north positive (default: the unit's, which a recording holds)
    #[arg(long, value_name = "L", allow_negative_numbers = true)]
    latitude_deg: Option<f64>,
    /// Height above the ellipsoid, m (default: the recording's, or 0)
    #[arg(long, value_name = "H", allow_negative_numbers = true)]
    height_m: Option<f64>,
    /// Noise and bias figures of the IMU (default: the recording's, or those of the main paper, Table 2)
    #[arg(long, value_name = "UNIT.toml")]
    unit: Option<PathBuf>,
    /// Fine filter
    #[arg(long, value_enum, default_value = "robust")]
    method: Method,
    #[command(flatten)]
    base: Base,
    /// Print the result as JSON
    #[arg(long)]
    json: bool,
}

#[derive(Args)]
struct ObservabilityArgs {
    /// Axis of the body that the sensor turns about; several, by comma, one after the other
    #[arg(long, value_enum, value_delimiter = ',', default_value = "z")]
    axis: Vec<Axis>,
    /// Nose up, degrees
    #[arg(long, value_name = "DEG", default_value_t = 0.0, allow_negative_numbers = true)]
    pitch: f64,
    /// Right side down, degrees
    #[arg(long, value_name = "DEG", default_value_t = 0.0, allow_negative_numbers = true)]
    roll: f64,
    /// Clockwise from north, degrees
    #[arg(long, value_name = "DEG", default_value_t = 0.0, allow_negative_numbers = true)]
    heading: f64,
    /// Rate of turning, °/s
    #[arg(long, value_name = "DPS", default_value_t = 10.0, allow_negative_numbers = true)]
    rate_dps: f64,
    /// Time about each axis, s; matters where there are several
    #[arg(long, value_name = "S", default_value_t = 36.0, allow_negative_numbers = true, value_parser = seconds)]
    seconds: f64,
    /// Geodetic latitude, degrees
    #[arg(long, value_name = "L", default_value_t = 40.0, allow_negative_numbers = true)]
    latitude_deg: f64,
    /// Acceleration east, m/s², during the last of the axes
    #[arg(long, value_name = "A", default_value_t = 0.0, allow_negative_numbers = true)]
    accel_east: f64,
    /// Acceleration north, m/s², likewise
    #[arg(long, value_name = "A", default_value_t = 0.0, allow_negative_numbers = true)]
    accel_north: f64,
    /// Print the result as JSON
    #[arg(long)]
    json: bool,
}

#[derive(Args)]
struct AllanArgs {
    /// CSV log of some hours at rest, as for `replay`
    log: PathBuf,
    /// Write the figures as a UNIT.toml for `replay`
    #[arg(long, value_name = "UNIT.toml")]
    unit: Option<PathBuf>,
    /// Write the plot, as SVG
    #[arg(long, value_name = "FILE", default_value = "report/allan.svg")]
    plot: PathBuf,
    /// Print the result as JSON
    #[arg(long)]
    json: bool,
}

#[derive(Args)]
struct CalibrateArgs {
    /// CSV log of a minute at rest and a minute turning, as for `replay`
    log: PathBuf,
    /// Noise figures of the IMU (default: those of the main paper, Table 2)
    #[arg(long, value_name = "UNIT.toml")]
    unit: Option<PathBuf>,
    /// Latitude of the place, degrees: with the heading, takes Earth's rate out of the biases of a level unit
    #[arg(long, value_name = "L", allow_negative_numbers = true, requires = "heading_deg")]
    latitude_deg: Option<f64>,
    /// Heading of the housing, degrees clockwise from north
    #[arg(long, value_name = "H", allow_negative_numbers = true, requires = "latitude_deg")]
    heading_deg: Option<f64>,
    /// Least time at rest, s
    #[arg(long, value_name = "S", default_value_t = 60.0, allow_negative_numbers = true, value_parser = seconds)]
    rest_s: f64,
    /// Write the log with its gyros corrected
    #[arg(long, value_name = "FILE")]
    corrected: Option<PathBuf>,
    /// Print the result as JSON
    #[arg(long)]
    json: bool,
}

#[derive(Args)]
struct SoakArgs {
    /// Virtual time, h
    #[arg(long, value_name = "H", default_value_t = 24.0, allow_negative_numbers = true, value_parser = hours)]
    hours: f64,
    /// Seed of every chance: the same one gives the same run, to the bit
    #[arg(long, value_name = "N", default_value_t = 1)]
    seed: u64,
    /// Print the report as JSON
    #[arg(long)]
    json: bool,
}

#[derive(Args)]
struct ReproduceArgs {
    /// What to reproduce: a name, or a paper's short name for all of the paper (without any: lists them)
    #[arg(value_name = "NAME", conflicts_with = "all")]
    names: Vec<String>,
    /// Everything
    #[arg(long)]
    all: bool,
    /// Seed of every chance: the same one gives the same run, to the bit
    #[arg(long, value_name = "N", default_value_t = 1)]
    seed: u64,
    /// Folder for the page, plots and curves
    #[arg(
        long,
        visible_alias = "report",
        value_name = "DIR",
        default_value = "report/reproduce"
    )]
    out: PathBuf,
    /// Print the results as JSON
    #[arg(long)]
    json: bool,
}

#[derive(Args)]
struct InspectArgs {
    /// Raw stream of defmt, or output of probe-rs, defmt-print, `cargo emulate`, `hal-sim unit`; `-` is standard input
    log: PathBuf,
    /// The image that wrote the stream of defmt
    #[arg(long, value_name = "ELF")]
    elf: Option<PathBuf>,
    /// Write the estimates as CSV
    #[arg(long, value_name = "FILE")]
    csv: Option<PathBuf>,
    /// Write the chart, as SVG
    #[arg(long, value_name = "FILE")]
    svg: Option<PathBuf>,
    /// Print the timeline as JSON
    #[arg(long)]
    json: bool,
    /// Show the log while it is written; a file is waited for until this is interrupted
    #[arg(long, conflicts_with = "json")]
    follow: bool,
}

/// Parses the command line and does what it says.
pub(crate) fn main() -> ExitCode {
    let cli = Cli::parse();
    // Without a command: `run` with its own defaults, which stand in one place only.
    let command = cli.command.or_else(|| Cli::parse_from(["hal-sim", "run"]).command);
    let Some(command) = command else {
        return ExitCode::from(BAD_INPUT);
    };
    let done = match command {
        Command::Run(args) => run(&args, cli.quiet),
        Command::MonteCarlo(args) => monte_carlo(&args, cli.quiet),
        Command::Bound(args) => bound(&args),
        Command::Replay(args) => replay(&args, cli.quiet),
        Command::Unit(args) => unit(&args, cli.quiet),
        Command::Soak(args) => soak(&args, cli.quiet),
        Command::Link(args) => talk(&args),
        Command::Observability(args) => observe(&args),
        Command::Allan(args) => allan(&args, cli.quiet),
        Command::Calibrate(args) => calibrate(&args, cli.quiet),
        Command::Convert { log, csv } => convert_log(&log, &csv, cli.quiet),
        Command::Reproduce(args) => reproduce(&args, cli.quiet),
        Command::Inspect(args) => inspect(&args),
        Command::Scenarios { name } => scenarios(name.as_deref()),
        Command::Completions { shell } => completions(shell),
    };
    done.unwrap_or_else(|message| {
        eprintln!("{} {message}", colour::said("error:", Sense::Bad));
        ExitCode::from(BAD_INPUT)
    })
}

type Done = Result<ExitCode, String>;

fn words(error: impl core::fmt::Display) -> String {
    error.to_string()
}

fn warn(what: &str) {
    eprintln!("{} {what}", colour::said("warning:", Sense::Warning));
}

/// How it ended, as the first word of a table.
fn ending(state: &str) -> String {
    let sense = if is_aligned(state) { Sense::Good } else { Sense::Bad };
    colour::result(state, sense)
}

/// Writes to stdout; a reader that has gone away is not an error of ours.
fn print(text: &str) -> Result<(), String> {
    match io::stdout().lock().write_all(text.as_bytes()) {
        Err(e) if e.kind() != io::ErrorKind::BrokenPipe => Err(format!("cannot write to stdout: {e}")),
        _ => Ok(()),
    }
}

fn print_json(value: &impl serde::Serialize) -> Result<(), String> {
    let text = serde_json::to_string_pretty(value).map_err(words)?;
    print(&format!("{text}\n"))
}

/// Makes the folder of a report, before anything is computed for it.
fn folder(dir: &Path) -> Result<(), String> {
    std::fs::create_dir_all(dir).map_err(|e| {
        format!(
            "cannot make the folder {}: {e}: name another with --report DIR",
            dir.display()
        )
    })
}

/// The command as it was given, for a shell.
fn command_line() -> String {
    let quoted = std::env::args_os().skip(1).map(|argument| {
        let argument = argument.to_string_lossy().into_owned();
        let plain = |c: char| c.is_ascii_alphanumeric() || "-_./=,:+".contains(c);
        if !argument.is_empty() && argument.chars().all(plain) {
            argument
        } else {
            format!("'{}'", argument.replace('\'', "'\\''"))
        }
    });
    let words: Vec<String> = core::iter::once("hal-sim".to_owned()).chain(quoted).collect();
    words.join(" ")
}

fn scenario(simulated: &Simulated) -> Result<Scenario, String> {
    let name = simulated.scenario.as_str();
    let builtin = Scenario::builtin_names().any(|builtin| builtin == name);
    let file = Path::new(name);
    let mut scenario = if !builtin && (file.exists() || file.extension().is_some_and(|e| e == "toml")) {
        Scenario::load(file).map_err(|e| match e.problem {
            ConfigProblem::Read(_) => format!("{e}; `hal-sim scenarios paper-sim > {name}` writes one to begin with"),
            _ => e.to_string(),
        })
    } else {
        Scenario::builtin(name).map_err(words)
    }?;
    if let Some(seconds) = simulated.seconds {
        scenario.run.duration_s = seconds;
        scenario.validate().map_err(|e| format!("--seconds: {e}"))?;
    }
    Ok(scenario)
}

/// The same, for a unit that is told of its base.
fn scenario_on(base: &Base, simulated: &Simulated) -> Result<Scenario, String> {
    let mut scenario = scenario(simulated)?;
    let told = &mut scenario.encoder.constraint_sd_arcsec;
    *told = base.encoder_constraint.or(*told);
    Ok(scenario)
}

fn bar(length: u64, unit: &str, quiet: bool) -> ProgressBar {
    if quiet {
        return ProgressBar::hidden();
    }
    let count = match unit {
        "bytes" => "{bytes} of {total_bytes}".to_owned(),
        unit => format!("{{pos}}/{{len}} {unit}"),
    };
    let style = ProgressStyle::with_template(&format!("{{bar:40}} {count}, {{eta}} left"))
        .unwrap_or_else(|_| ProgressStyle::default_bar());
    // Gone also where an error ends the work.
    ProgressBar::new(length)
        .with_style(style)
        .with_finish(ProgressFinish::AndClear)
}

/// Prints what happens in a run, and keeps what its report needs.
struct RunObserver {
    bar: ProgressBar,
    quiet: bool,
    moments: Vec<Moment>,
    rotor: Vec<(f64, f64)>,
    log: Option<LogWriter<BufWriter<File>>>,
    log_error: Option<io::Error>,
    samples: u64,
}

impl simulate::Observer for RunObserver {
    fn sample(&mut self, row: &Row) {
        self.samples += 1;
        if self.samples.is_multiple_of(10) {
            self.rotor.push((row.t, row.encoder / frames::units::DEG));
        }
        if self.samples.is_multiple_of(1000) {
            self.bar.set_position(row.t as u64);
        }
        if let Some(log) = &mut self.log
            && self.log_error.is_none()
        {
            let s = &row.sample;
            self.log_error = log.write(row.t, s.dt, s.dtheta_s, s.dv_s, row.encoder, None).err();
        }
    }

    fn event(&mut self, t: f64, event: &str) {
        told(&self.bar, self.quiet, t, event);
    }

    fn moment(&mut self, moment: &Moment) {
        self.moments.push(*moment);
    }
}

/// One line of what happened when, above the progress bar.
fn told(bar: &ProgressBar, quiet: bool, t: f64, event: &str) {
    if !quiet {
        bar.suspend(|| eprintln!("{t:8.2} s  {event}"));
    }
}

fn run(args: &RunArgs, quiet: bool) -> Done {
    let scenario = scenario_on(&args.base, &args.simulated)?;
    let dir = args
        .report
        .join(format!("{}-seed{}", scenario.name, args.simulated.seed));
    args.log.as_deref().map_or(Ok(()), has_folder)?;
    folder(&dir)?;
    let log = match &args.log {
        None => None,
        Some(path) => Some(LogWriter::create(path, false).map_err(|e| cannot_write(path, &e))?),
    };
    if !quiet {
        eprintln!(
            "{}, seed {}: {}",
            scenario.name, args.simulated.seed, scenario.description
        );
    }
    let mut observer = RunObserver {
        bar: bar(scenario.run.duration_s as u64, "s", quiet),
        quiet,
        moments: Vec::new(),
        rotor: Vec::new(),
        log,
        log_error: None,
        samples: 0,
    };
    let result = simulate::run::<f32>(&scenario, args.simulated.seed, args.method, &mut observer).map_err(words)?;
    observer.bar.finish_and_clear();
    if let (Some(path), Some(log)) = (&args.log, observer.log) {
        let finished = observer.log_error.map_or_else(|| log.finish().map(drop), Err);
        finished.map_err(|e| cannot_write(path, &e))?;
    }
    let command = command_line();
    let origin = Origin {
        scenario: &scenario,
        command: &command,
    };
    report::run(&dir, &origin, &result, &observer.moments, &observer.rotor).map_err(words)?;
    if args.json {
        print_json(&result)?;
    } else {
        print(&run_table(&result))?;
        print(&format!("report: {}\n", dir.join("report.html").display()))?;
    }
    Ok(exit(result.state))
}

fn is_aligned(state: &str) -> bool {
    matches!(state, "aligned" | "navigating")
}

fn exit(state: &str) -> ExitCode {
    if is_aligned(state) {
        ExitCode::SUCCESS
    } else {
        ExitCode::from(NOT_ALIGNED)
    }
}

/// One of three angles.
type AngleOf = fn(&Angles) -> f64;

/// Truth, estimate, error and σ of the three angles.
fn attitude_table(truth: &Angles, estimate: &Angles, error: &Angles, sd: &Angles) -> String {
    let mut text = format!(
        "{:<16}{:>12}{:>12}{:>12}{:>12}\n",
        "", "truth", "estimate", "error", "sd"
    );
    let angles: [(&str, AngleOf); 3] = [
        ("heading (°)", |a| a.heading_deg),
        ("pitch (°)", |a| a.pitch_deg),
        ("roll (°)", |a| a.roll_deg),
    ];
    for (name, of) in angles {
        text += &format!(
            "{name:<16}{:>12.4}{:>12.4}{:>+12.4}{:>12.4}\n",
            of(truth),
            of(estimate),
            of(error),
            of(sd)
        );
    }
    text
}

/// The closing table of a run.
fn run_table(result: &RunResult) -> String {
    let mut text = match (result.aligned_at_s, &result.reason) {
        (Some(t), None) => format!("{} since {t:.1} s ({})\n", ending(result.state), result.method.name()),
        (_, reason) => {
            format!(
                "{} ({}): {}\n",
                ending(result.state),
                result.method.name(),
                reason.as_deref().unwrap_or("no estimate")
            )
        }
    };
    if let Some(coarse) = &result.coarse {
        text += &format!(
            "coarse alignment alone, over the whole run: heading error {:+.3}°, sd {:.3}°\n",
            coarse.error.heading_deg, coarse.sd.heading_deg
        );
    }
    let Some(last) = &result.last else { return text };
    let Moment {
        reading, truth, error, ..
    } = last;
    text += &attitude_table(truth, &reading.attitude, error, &reading.sd);
    let biases = [
        (
            "gyro",
            "°/h",
            last.true_gyro_bias_deg_h,
            reading.gyro_bias_deg_h,
            reading.gyro_bias_sd_deg_h,
        ),
        (
            "accel",
            "µg",
            last.true_accel_bias_ug,
            reading.accel_bias_ug,
            reading.accel_bias_sd_ug,
        ),
    ];
    for (sensor, unit, truth, found, sd) in biases {
        for (axis, name) in ["x", "y", "z"].into_iter().enumerate() {
            text += &format!(
                "{:<16}{:>12.2}{:>12.2}{:>+12.2}{:>12.2}\n",
                format!("{sensor} {name} ({unit})"),
                truth[axis],
                found[axis],
                found[axis] - truth[axis],
                sd[axis]
            );
        }
    }
    text
}

fn monte_carlo(args: &MonteCarloArgs, quiet: bool) -> Done {
    let scenario = scenario_on(&args.base, &args.simulated)?;
    let mut methods: Vec<Method> = Vec::new();
    for method in &args.method {
        if !methods.contains(method) {
            methods.push(*method);
        }
    }
    let dir = args.report.join(format!("{}-monte-carlo", scenario.name));
    folder(&dir)?;
    let bar = bar(args.runs, "runs", quiet);
    let result = monte_carlo::run(&scenario, args.runs, args.simulated.seed, &methods, || bar.inc(1)).map_err(words)?;
    bar.finish_and_clear();
    let command = command_line();
    let origin = Origin {
        scenario: &scenario,
        command: &command,
    };
    report::monte_carlo(&dir, &origin, &result).map_err(words)?;
    if args.json {
        print_json(&result)?;
    } else {
        print(&monte_carlo_table(&result))?;
        print(&format!("report: {}\n", dir.join("report.html").display()))?;
    }
    let aligned = result.by_method.iter().any(|m| m.aligned > 0);
    Ok(exit(if aligned { "aligned" } else { "none" }))
}

/// The closing table of a Monte Carlo.
fn monte_carlo_table(report: &monte_carlo::Report) -> String {
    let mut text = format!(
        "{}, {} runs of {} s, seed {}; angle random walk alone leaves {:.3}° of heading, the ideal filter {:.3}°\n{:<18}{:>6}{:>10}{:>10}{:>10}{:>12}{:>14}{:>11}\n",
        report.scenario,
        report.runs,
        report.duration_s,
        report.seed,
        report.random_walk_limit_deg,
        report.bound_deg,
        "",
        "runs",
        "mean (°)",
        "sd (°)",
        "rms (°)",
        "predicted",
        "(error/σ)²",
        "rms/ideal"
    );
    let mut rows = |name: &str, s: &Statistics, over_bound: Option<f64>| {
        for (angle, spread) in [("heading", &s.heading), ("pitch", &s.pitch), ("roll", &s.roll)] {
            let over_bound = over_bound
                .filter(|_| angle == "heading")
                .map(|ratio| format!("{ratio:>11.3}"));
            text += &format!(
                "{:<18}{:>6}{:>+10.4}{:>10.4}{:>10.4}{:>12.4}{:>14.2}{}\n",
                format!("{name} {angle}"),
                s.runs,
                spread.mean_deg,
                spread.sd_deg,
                spread.rms_deg,
                spread.predicted_sd_deg,
                spread.normalised_squared,
                over_bound.unwrap_or_default()
            );
        }
    };
    if let Some(coarse) = &report.coarse {
        rows("coarse", coarse, None);
    }
    for method in &report.by_method {
        if let Some(fine) = &method.fine {
            rows(
                &format!("fine {}", method.method.name()),
                fine,
                method.heading_rms_over_bound,
            );
        }
    }
    for method in &report.by_method {
        text += &format!(
            "{}: {} of {} aligned{}{}\n",
            method.method.name(),
            method.aligned,
            report.runs,
            method
                .mean_time_to_aligned_s
                .map(|t| format!(", after {t:.1} s in the mean"))
                .unwrap_or_default(),
            if method.inconsistent > 0 {
                format!(
                    "; {} refused: innovations do not fit a base that only swings",
                    method.inconsistent
                )
            } else {
                String::new()
            }
        );
        text += &course_of(method);
    }
    // Each run has phases of its own.
    text + "rms/ideal: over the ideal filter's σ along the motion of the first run; n runs scatter it by 1/√(2n)\n"
}

/// Readiness, settling, and the errors of those that were refused as well.
fn course_of(method: &MethodReport) -> String {
    let mut text = String::new();
    if let Some(all) = method.all.filter(|all| all.runs > method.aligned) {
        text += &format!(
            "    all {} with an estimate: heading rms {:.4}°\n",
            all.runs, all.heading.rms_deg
        );
    }
    if let Some(ready) = &method.readiness {
        text += &format!(
            "    known to {READY_SD_DEG}°: {} runs, after {:.0} s in the mean, {:.0} s at most; then beyond 3σ: {} runs at \
             first, {} of {} s ({:.2} %)\n",
            ready.runs,
            ready.mean_s,
            ready.last_s,
            ready.false_at_first,
            ready.false_seconds,
            ready.seconds,
            100.0 * ready.false_seconds as f64 / ready.seconds as f64
        );
    }
    if let Some(settling) = &method.settling {
        text += &format!(
            "    within ±{:.2}° to the end: {} runs, from {:.0} s on in the mean, {:.0} s for 95 of 100",
            settling.within_deg, settling.runs, settling.mean_s, settling.most_s
        );
        if settling.later_rms_deg > 0.0 {
            text += &format!(
                "; from 600 s on rms {:.3}°, worst {:.2}°",
                settling.later_rms_deg, settling.later_worst_deg
            );
        }
        text += "\n";
    }
    text
}

fn bound(args: &BoundArgs) -> Done {
    let scenario = scenario(&args.simulated)?;
    let config = BoundConfig {
        velocity_sd: args.velocity_sd,
        ..BoundConfig::default()
    };
    let dir = args
        .out
        .join(format!("{}-bound-seed{}", scenario.name, args.simulated.seed));
    let result = bound::run(&scenario, args.simulated.seed, &config).map_err(words)?;
    folder(&dir)?;
    let command = command_line();
    let origin = Origin {
        scenario: &scenario,
        command: &command,
    };
    report::bound(&dir, &origin, &result).map_err(words)?;
    if args.json {
        print_json(&result)?;
    } else {
        print(&bound_table(&result))?;
        print(&format!("report: {}\n", dir.join("report.html").display()))?;
    }
    Ok(ExitCode::SUCCESS)
}

/// The table of a bound.
fn bound_table(bound: &Bound) -> String {
    let mut text = format!(
        "{}, seed {}: σ of the ideal filter, {} states, zero velocity known to {} m/s each second\n{:>8}{:>12}{:>12}{:>10}{:>10}{:>27}{:>27}\n",
        bound.scenario,
        bound.seed,
        bound.states,
        bound.velocity_measurement_sd_m_s,
        "t (s)",
        "heading (°)",
        "by ARW (°)",
        "pitch (°)",
        "roll (°)",
        "gyros x, y, z (°/h)",
        "accels x, y, z (µg)"
    );
    for row in &bound.rows {
        text += &format!(
            "{:>8}{:>12.3}{:>12.3}{:>10.5}{:>10.5}",
            row.t_s, row.sd.heading_deg, row.random_walk_limit_deg, row.sd.pitch_deg, row.sd.roll_deg
        );
        for sd in row.gyro_bias_sd_deg_h {
            text += &format!("{sd:>9.3}");
        }
        for sd in row.accel_bias_sd_ug {
            text += &format!("{sd:>9.2}");
        }
        text += "\n";
    }
    let limits = &bound.limits;
    text += &format!("what a single cause leaves of heading after {} s:\n", bound.duration_s);
    for (name, limit) in [
        ("angle random walk", Some(limits.angle_random_walk_deg)),
        ("velocity random walk", limits.velocity_random_walk_deg),
        ("velocity measurement", Some(limits.velocity_measurement_deg)),
        ("quantum of the gyros", limits.gyro_quantum_deg),
        ("quantum of the accels", limits.accel_quantum_deg),
    ] {
        if let Some(limit) = limit {
            text += &format!("  {name:<24}{limit:>12.7}°\n");
        }
    }
    text
}

/// Prints what happens in a replay.
struct ReplayObserver {
    bar: ProgressBar,
    quiet: bool,
    bridged: u64,
    bridged_s: f64,
}

impl replay::Observer for ReplayObserver {
    fn event(&mut self, t: f64, event: &Event<f32>) {
        match event {
            // One line for all of them, at the end: a log may have thousands.
            Event::Bridged { length } => {
                self.bridged += 1;
                self.bridged_s += f64::from(*length);
            }
            Event::Restarted(_) => self
                .bar
                .suspend(|| warn(&format!("at {t:.2} s {}", align::describe(event)))),
            _ => told(&self.bar, self.quiet, t, &align::describe(event)),
        }
    }

    fn status(&mut self, status: &UnitStatus) {
        told(&self.bar, self.quiet, status.t_s, &format!("unit: {status}"));
    }

    fn warning(&mut self, warning: &LogWarning) {
        self.bar.suspend(|| warn(&warning.to_string()));
    }
}

/// A log, and a bar that goes on as it is read.
type OpenLog = LogReader<BufReader<ProgressBarIter<File>>>;

fn open_log(path: &Path, quiet: bool) -> Result<(OpenLog, ProgressBar), String> {
    let name = path.display().to_string();
    let opened = File::open(path).and_then(|file| Ok((file.metadata()?.len(), file)));
    let (length, file) = opened.map_err(|e| LogError::cannot_read(&name, &e).to_string())?;
    let bar = bar(length, "bytes", quiet);
    let input = BufReader::with_capacity(1 << 16, bar.wrap_read(file));
    Ok((LogReader::new(input, &name).map_err(words)?, bar))
}

fn replay(args: &ReplayArgs, quiet: bool) -> Done {
    let (log, bar) = open_log(&args.log, quiet)?;
    if log.header().is_none() && args.latitude_deg.is_none() {
        return Err("a CSV log does not say where it was recorded: add --latitude-deg L".to_owned());
    }
    let unit = args.unit.as_deref().map(Unit::load).transpose().map_err(words)?;
    // What is said here goes before what a recording says, all along.
    let told = |header: Option<&Header>| {
        let recorded = match header {
            Some(header) => replay::recorded(header, args.method),
            None => Setup {
                latitude_deg: 0.0,
                height_m: 0.0,
                rotor: RotorConfig::default(),
                unit: Unit::default(),
                method: args.method,
                encoder_constraint_arcsec: None,
            },
        };
        Setup {
            latitude_deg: args.latitude_deg.unwrap_or(recorded.latitude_deg),
            height_m: args.height_m.unwrap_or(recorded.height_m),
            unit: unit.clone().unwrap_or(recorded.unit),
            encoder_constraint_arcsec: args.base.encoder_constraint,
            ..recorded
        }
    };
    let mut observer = ReplayObserver {
        bar,
        quiet,
        bridged: 0,
        bridged_s: 0.0,
    };
    if let Some(header) = log.header().filter(|_| !quiet) {
        eprintln!(
            "recorded by unit {}, firmware {}, IMU {} serial {}",
            header.serial, header.firmware, header.imu.product, header.imu.serial
        );
    }
    let result = replay::replay_from(log, told, &mut observer).map_err(words)?;
    observer.bar.finish_and_clear();
    if observer.bridged > 0 {
        let gaps = format!(
            "bridged {} of {:.3} s in all, by the mean of the rates before and after",
            if observer.bridged == 1 {
                "1 gap".to_owned()
            } else {
                format!("{} gaps", observer.bridged)
            },
            observer.bridged_s
        );
        warn(&gaps);
    }
    if args.json {
        print_json(&result)?;
    } else {
        print(&replay_table(&result))?;
    }
    Ok(exit(result.state))
}

fn convert_log(from: &Path, to: &Path, quiet: bool) -> Done {
    has_folder(to)?;
    let (mut reader, bar) = open_log(from, quiet)?;
    let rows = convert_from(&mut reader, from, to, LogRow::sample).map_err(words)?;
    bar.finish_and_clear();
    for warning in reader.warnings() {
        warn(&warning.to_string());
    }
    if !quiet {
        eprintln!("{rows} rows");
    }
    Ok(ExitCode::SUCCESS)
}

fn replay_table(result: &Replay) -> String {
    let mut text = format!("{} at {} s", ending(result.state), result.t_s);
    match &result.reason {
        Some(reason) => text += &format!(": {reason}\n"),
        None => text += "\n",
    }
    let rows = [
        ("heading", result.heading_deg, result.heading_sd_deg),
        ("pitch", result.pitch_deg, result.pitch_sd_deg),
        ("roll", result.roll_deg, result.roll_sd_deg),
    ];
    for (name, value, sd) in rows {
        if let (Some(value), Some(sd)) = (value, sd) {
            text += &format!("{name:<10}{value:>10.3}°  sd {sd:.4}°\n");
        }
    }
    if let (Some([gx, gy, gz]), Some([ax, ay, az])) = (result.gyro_bias_deg_h, result.accel_bias_ug) {
        text += &format!("gyro bias  {gx:8.2} {gy:8.2} {gz:8.2} °/h\naccel bias {ax:8.1} {ay:8.1} {az:8.1} µg\n");
    }
    text
}

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

fn cannot_write(path: &Path, error: &io::Error) -> String {
    format!("cannot write {}: {error}", path.display())
}

/// That there is a folder for a file, before anything is computed for it.
fn has_folder(path: &Path) -> Result<(), String> {
    match path.parent() {
        Some(folder) if folder != Path::new("") && !folder.is_dir() => Err(format!(
            "cannot write {}: there is no folder {}: make it first",
            path.display(),
            folder.display()
        )),
        _ => Ok(()),
    }
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

/// When a record begins, s: the unit listens.
const RECORD_S: f64 = 0.1;
/// Longest run that a scenario may have, s: four days.
const LONGEST_RUN_S: f64 = 360_000.0;

fn unit(args: &UnitArgs, quiet: bool) -> Done {
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
        print_json(&result)?;
    } else {
        print(&unit_table(&result))?;
    }
    if !quiet {
        eprintln!("{ratio:.0} times real time");
    }
    Ok(exit(result.state))
}

fn soak(args: &SoakArgs, quiet: bool) -> Done {
    let config = SoakConfig {
        hours: args.hours,
        seed: args.seed,
    };
    let bar = bar((3600.0 * args.hours) as u64, "s", quiet);
    let begun = std::time::Instant::now();
    let report = hal_sim::soak::run(&config, |t_s| bar.set_position(t_s as u64)).map_err(words)?;
    bar.finish_and_clear();
    if args.json {
        print_json(&report)?;
    } else {
        print(&report.table())?;
    }
    if !quiet {
        let ratio = 3600.0 * args.hours / begun.elapsed().as_secs_f64().max(1e-9);
        eprintln!("{ratio:.0} times real time");
    }
    Ok(if report.is_sound() {
        ExitCode::SUCCESS
    } else {
        ExitCode::FAILURE
    })
}

/// The closing table of a run of the unit.
fn unit_table(result: &UnitResult) -> String {
    let when = |t: Option<f64>, then: &str, never: &str| t.map_or(never.to_owned(), |t| format!("{then} at {t:.1} s"));
    let mut text = format!(
        "{}, seed {}, {}: {} at {:.1} s; {}, {}\n",
        result.scenario,
        result.seed,
        result.method.name(),
        ending(result.state),
        result.t_s,
        when(result.aligning_at_s, "began to align", "never began to align"),
        when(result.aligned_at_s, "first aligned", "never aligned")
    );
    text += "modes:";
    for at in &result.modes {
        text += &format!(" {} {:.2} s,", at.mode, at.t_s);
    }
    text.truncate(text.trim_end_matches(',').len());
    let s = &result.samples;
    text += &format!(
        "\nsamples: {} received, {} lost ({} edges lost by the simulator), {} repeated, {} failed transfers, {} overruns, {} saturated\n",
        s.received, s.lost, s.edges_lost, s.repeated, s.transfers, s.overruns, s.saturated
    );
    if result.resets > 0 {
        text += &format!("resets: {}\n", result.resets);
    }
    for fault in &result.faults {
        text += &format!(
            "fault at {:.4} s: {}, motor off after {:.3} ms{}: {}\n",
            fault.t_s,
            fault.name,
            fault.motor_off_ms,
            if fault.latched { ", latched" } else { "" },
            fault.text
        );
    }
    let Some(last) = &result.last else { return text };
    text += &attitude_table(&last.truth, &last.reading.attitude, &last.error, &last.reading.sd);
    if let Some(Drift {
        speed_m_s,
        east_m,
        north_m,
    }) = last.track
    {
        text += &format!("navigated to {east_m:+.1} m east, {north_m:+.1} m north, at {speed_m_s:.2} m/s\n");
    }
    text
}

fn talk(args: &LinkArgs) -> Done {
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

fn observe(args: &ObservabilityArgs) -> Done {
    let radians = frames::units::DEG;
    let attitude = Attitude {
        heading: args.heading * radians,
        pitch: args.pitch * radians,
        roll: args.roll * radians,
    };
    let last = args.axis.len().saturating_sub(1);
    let segments: Vec<_> = args
        .axis
        .iter()
        .enumerate()
        .map(|(k, axis)| Segment {
            axis: *axis,
            rate: args.rate_dps * radians,
            seconds: args.seconds,
            acceleration: if k == last {
                [args.accel_east, args.accel_north]
            } else {
                [0.0; 2]
            },
        })
        .collect();
    let found = observability::Report::of(&attitude, args.latitude_deg * radians, &segments).map_err(words)?;
    if args.json {
        print_json(&found)?;
    } else {
        print(&observability_table(&found))?;
    }
    Ok(ExitCode::SUCCESS)
}

/// Rank, singular values, and what they mean for each error.
fn observability_table(found: &observability::Report) -> String {
    let mut text = format!("rank {} of {}\nsingular values:", found.rank, found.states);
    for value in found.singular_values {
        text += &format!(" {value:.2e}");
    }
    text += &format!(
        "\nof the largest, the smallest that counts is {:.1e}, the next {:.1e}\nobservable:\n",
        found.smallest_counted, found.largest_neglected
    );
    for combination in &found.observable {
        text += &format!("  {combination}\n");
    }
    for (frame, states) in [
        ("each error, in east, north, up:", &found.by_state),
        ("biases along the body's axes, at the start:", &found.by_body_axis),
    ] {
        text += &format!("{frame}\n");
        for state in states {
            text += &format!("  {:<6}{}\n", state.name, state.seen);
        }
    }
    text
}

fn allan(args: &AllanArgs, quiet: bool) -> Done {
    args.unit.as_deref().map_or(Ok(()), has_folder)?;
    let mut written = args.unit.iter().chain([&args.plot]);
    written
        .try_for_each(|path| not_itself(&args.log, path))
        .map_err(words)?;
    let named = |e| format!("{}: {e}", args.log.display());
    let (log, bar) = open_log(&args.log, quiet)?;
    let report = allan::of_reader(log).map_err(|e| match e {
        // A log's own errors begin with its name.
        AllanError::Log(e) => e.to_string(),
        other => named(other),
    })?;
    bar.finish_and_clear();
    let cannot = |path: &Path, e: &dyn core::fmt::Display| format!("cannot write {}: {e}", path.display());
    if let Some(folder) = args.plot.parent() {
        std::fs::create_dir_all(folder).map_err(|e| cannot(folder, &e))?;
    }
    report.plot(&args.plot).map_err(|e| cannot(&args.plot, &e))?;
    if let Some(unit) = &args.unit {
        std::fs::write(unit, report.unit_toml()).map_err(|e| cannot(unit, &e))?;
    }
    if args.json {
        print_json(&report)?;
    } else {
        print(&report.table())?;
        print(&format!("plot: {}\n", args.plot.display()))?;
    }
    Ok(ExitCode::SUCCESS)
}

fn calibrate(args: &CalibrateArgs, quiet: bool) -> Done {
    if let Some(path) = &args.corrected {
        has_folder(path)?;
        not_itself(&args.log, path).map_err(words)?;
    }
    let unit = args.unit.as_deref().map(Unit::load).transpose().map_err(words)?;
    let setup = calibrate::Setup {
        unit: unit.unwrap_or_default(),
        stand: args
            .latitude_deg
            .zip(args.heading_deg)
            .map(|(latitude_deg, heading_deg)| Stand {
                latitude_deg,
                heading_deg,
            }),
        rest_s: args.rest_s,
    };
    let named = |e: CalibrateError| match e {
        CalibrateError::Log(_) => e.to_string(),
        other => format!("{}: {other}", args.log.display()),
    };
    let (log, bar) = open_log(&args.log, quiet)?;
    let (calibration, report) = calibrate::of_reader(log, &setup).map_err(named)?;
    bar.finish_and_clear();
    if let Some(corrected) = &args.corrected {
        calibrate::correct_log(&args.log, corrected, &calibration).map_err(words)?;
    }
    if args.json {
        print_json(&report)?;
    } else {
        print(&report.table())?;
    }
    Ok(ExitCode::SUCCESS)
}

fn reproduce(args: &ReproduceArgs, quiet: bool) -> Done {
    let mut selected = Vec::new();
    if args.all {
        selected.extend_from_slice(reproduce::ALL);
    } else if args.names.is_empty() {
        for reproduction in reproduce::ALL {
            print(&format!("{:<22}{}\n", reproduction.name, reproduction.what))?;
        }
        return Ok(ExitCode::SUCCESS);
    }
    for name in &args.names {
        selected.extend(reproduce::select(name).map_err(words)?);
    }
    folder(&args.out)?;
    let bar = bar(selected.len() as u64, "done", quiet);
    let mut reports = Vec::new();
    for reproduction in &selected {
        let told = |what: &str| {
            if !quiet {
                bar.suspend(|| eprintln!("{}: {what}", reproduction.name));
            }
        };
        let report = reproduce::run(reproduction, args.seed, Some(&args.out), &told).map_err(words)?;
        if !args.json {
            bar.suspend(|| print(&format!("{}\n", reproduce::table(&report))))?;
        }
        bar.inc(1);
        reports.push(report);
    }
    bar.finish_and_clear();
    reproduce::page(&args.out, &reports, &command_line()).map_err(words)?;
    if args.json {
        print_json(&reports)?;
    } else {
        print(&reproduce::summary(&reports))?;
        print(&format!("report: {}\n", args.out.join("report.html").display()))?;
    }
    Ok(ExitCode::SUCCESS)
}

fn inspect(args: &InspectArgs) -> Done {
    for path in args.csv.iter().chain(&args.svg) {
        has_folder(path)?;
        not_itself(&args.log, path).map_err(words)?;
    }
    let elf = args.elf.as_deref().map(Elf::read).transpose().map_err(words)?;
    // A log's own errors do not begin with its name, those of files do.
    let named = |e: inspect::InspectError| match e {
        inspect::InspectError::Empty | inspect::InspectError::NeedsElf | inspect::InspectError::NotOurs => {
            format!("{}: {e}", args.log.display())
        }
        other => other.to_string(),
    };
    let timeline = if args.follow {
        let mut input: Box<dyn Read> = if args.log == Path::new("-") {
            Box::new(io::stdin())
        } else {
            Box::new(Tail::open(&args.log).map_err(words)?)
        };
        let stdout = io::stdout();
        live::follow(&mut input, elf, stdout.is_terminal(), &mut stdout.lock())
    } else {
        inspect::of_file(&args.log, elf)
    };
    let timeline = timeline.map_err(named)?;
    if let Some(path) = &args.csv {
        inspect::report::csv(path, &timeline).map_err(words)?;
    }
    if let Some(path) = &args.svg {
        inspect::chart::svg(path, &timeline).map_err(|e| format!("cannot write {}: {e}", path.display()))?;
    }
    if args.json {
        print_json(&inspect::report::summary(&timeline))?;
    } else {
        print(&inspect::report::table(&timeline))?;
    }
    Ok(exit(timeline.state()))
}

fn scenarios(name: Option<&str>) -> Done {
    match name {
        Some(name) => print(Scenario::builtin_text(name).map_err(words)?)?,
        None => {
            for name in Scenario::builtin_names() {
                let scenario = Scenario::builtin(name).map_err(words)?;
                print(&format!("{name:<22}{}\n", scenario.description))?;
            }
        }
    }
    Ok(ExitCode::SUCCESS)
}

fn completions(shell: clap_complete::Shell) -> Done {
    let mut script = Vec::new();
    clap_complete::generate(shell, &mut Cli::command(), "hal-sim", &mut script);
    print(&String::from_utf8_lossy(&script))?;
    Ok(ExitCode::SUCCESS)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Words of a line as a shell takes them, up to what is beside it: two blanks, or where output goes.
    fn words_of(line: &str) -> Vec<String> {
        let line = line
            .split("  ")
            .next()
            .unwrap_or(line)
            .split('>')
            .next()
            .unwrap_or(line);
        let quoted = line.split('"').enumerate();
        quoted
            .flat_map(|(k, part)| match k % 2 {
                0 => part.split_whitespace().map(str::to_owned).collect::<Vec<_>>(),
                _ => vec![part.to_owned()],
            })
            .collect()
    }

    #[test]
    fn every_command_says_what_comes_out_with_examples_that_can_be_typed() {
        Cli::command().debug_assert();
        for command in Cli::command().get_subcommands() {
            let name = command.get_name();
            let help = command.get_after_help().map(ToString::to_string).unwrap_or_default();
            let (out, examples) = help.split_once("\n\nExamples:\n").expect(name);
            assert!(out.contains("Prints ") || out.contains("Writes "), "{name}: {out}");
            for line in examples.lines() {
                let words = words_of(line.trim_start());
                assert_eq!(words[..2], ["hal-sim", name], "{line}");
                assert!(Cli::try_parse_from(&words).is_ok(), "{line}");
            }
        }
        for line in help::ALL
            .lines()
            .filter(|line| line.starts_with("  hal-sim") && !line.contains("COMMAND"))
        {
            assert!(Cli::try_parse_from(words_of(line.trim_start())).is_ok(), "{line}");
        }
    }

    #[test]
    fn every_number_has_its_unit_or_is_a_count() {
        let counts = ["runs", "seed", "speed"];
        let units = [", s", ", h", "m/s", "°/s", "m/s²", "degrees", "arcsec", ", m "];
        for command in Cli::command().get_subcommands() {
            for option in command.get_arguments() {
                let help = option.get_help().map(ToString::to_string).unwrap_or_default();
                let (name, negative) = (option.get_id().as_str(), option.is_allow_negative_numbers_set());
                assert!(!help.is_empty(), "{name}");
                let told = units.iter().any(|unit| help.contains(unit));
                assert!(!negative || counts.contains(&name) || told, "{name}: {help}");
            }
        }
    }
}
