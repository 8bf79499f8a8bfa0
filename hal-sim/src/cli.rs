//! What each command does. Its arguments are in [`args`], what it prints of its result in [`table`].
//!
//! Results go to stdout, progress and warnings to stderr. Exit codes: 0 aligned, 1 not aligned, 2 bad input;
//! of `link` 1 where the unit refuses or does not answer.

mod args;
mod colour;
mod help;
mod table;

use std::fs::File;
use std::io::{self, BufReader, BufWriter, IsTerminal as _, Read, Write as _};
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::time::Duration;

use clap::{CommandFactory as _, Parser as _};
use hal_sim::align::{self, Method, Setup};
use hal_sim::allan::{self, AllanError};
use hal_sim::bound::{self, BoundConfig};
use hal_sim::bus::UartLine;
use hal_sim::calibrate::{self, CalibrateError, Stand};
use hal_sim::config::ConfigProblem;
use hal_sim::inspect::{self, defmt::Elf, live, live::Tail};
use hal_sim::link::serve::Served;
use hal_sim::link::{self, Link};
use hal_sim::log::{
    Format, Header, LogError, LogReader, LogRow, LogWarning, LogWriter, UnitStatus, convert_from, not_itself,
};
use hal_sim::monte_carlo;
use hal_sim::observability::{self, Attitude, Segment};
use hal_sim::outcome::{alignment, tagged};
use hal_sim::replay;
use hal_sim::report::{self, Origin};
use hal_sim::reproduce;
use hal_sim::scenario::{Scenario, Temperature};
use hal_sim::simulate::{self, Moment, Row};
use hal_sim::soak::SoakConfig;
use hal_sim::turn;
use hal_sim::unit::Unit;
use hal_sim::unit_sim::{self, Line, Typed};
use indicatif::{ProgressBar, ProgressBarIter, ProgressFinish, ProgressStyle};
use nav::aligner::{Event, Restart};
use nav::rotor::RotorConfig;
use tempfile::NamedTempFile;

use args::{
    AllanArgs, Base, BoundArgs, CalibrateArgs, Cli, Command, ConvertArgs, InspectArgs, LinkArgs, LogArgs,
    MonteCarloArgs, ObservabilityArgs, ReplayArgs, ReproduceArgs, RunArgs, Simulated, SoakArgs, TurnArgs, UnitArgs,
};
use colour::Sense;

/// Not aligned, or a result the unit does not stand by.
const NOT_ALIGNED: u8 = 1;
/// A unit refuses a command, or does not answer.
const REFUSED: u8 = 1;
/// A file, a scenario or an argument that cannot be used.
const BAD_INPUT: u8 = 2;

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
        Command::Convert(args) => convert_log(&args, cli.quiet),
        Command::Turn(args) => turn(&args, cli.quiet),
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

fn run(args: &RunArgs, quiet: bool) -> Done {
    let scenario = scenario_on(&args.base, &args.simulated)?;
    let dir = args
        .report
        .join(format!("{}-seed{}", scenario.name, args.simulated.seed));
    args.log.as_deref().map_or(Ok(()), has_folder)?;
    folder(&dir)?;
    let warms = scenario.temperature != Temperature::default();
    let log = match &args.log {
        None => None,
        Some(path) => Some(LogWriter::create(path, warms).map_err(|e| cannot_write(path, &e))?),
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
        // Later logs of the same name are not replayed with the figures of this one: they write their own.
        let (beside, told) = (Unit::beside(path), scenario.told.as_ref().unwrap_or(&scenario.imu));
        let figures = told.to_toml().map_err(words)?;
        std::fs::write(&beside, figures).map_err(|e| cannot_write(&beside, &e))?;
    }
    let command = command_line();
    let origin = Origin {
        scenario: &scenario,
        command: &command,
    };
    report::run(&dir, &origin, &result, &observer.moments, &observer.rotor).map_err(words)?;
    if args.json {
        print_json(&alignment(&result))?;
    } else {
        print(&table::run(&result))?;
        print(&format!("report: {}\n", dir.join("report.html").display()))?;
    }
    Ok(exit(result.state))
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
            let temperature_c = Some(row.temperature_c);
            self.log_error = log
                .write(row.t, s.dt, s.dtheta_s, s.dv_s, row.encoder, temperature_c)
                .err();
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
        print_json(&tagged("monte-carlo", &result))?;
    } else {
        print(&table::monte_carlo(&result))?;
        print(&format!("report: {}\n", dir.join("report.html").display()))?;
    }
    let aligned = result.by_method.iter().any(|m| m.aligned > 0);
    Ok(exit(if aligned { "aligned" } else { "none" }))
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
        print_json(&tagged("bound", &result))?;
    } else {
        print(&table::bound(&result))?;
        print(&format!("report: {}\n", dir.join("report.html").display()))?;
    }
    Ok(ExitCode::SUCCESS)
}

fn replay(args: &ReplayArgs, quiet: bool) -> Done {
    let input = Input::new(&args.input)?;
    let (log, bar) = input.open(quiet)?;
    if log.header().is_none() && args.latitude_deg.is_none() {
        return Err("a CSV log does not say where it was recorded: add --latitude-deg L".to_owned());
    }
    let unit = match &args.unit {
        Some(name) => Some(Unit::find(name).map_err(words)?),
        None if log.header().is_some() => None,
        None => Some(unit_of_log(&input, quiet)?),
    };
    let unit = match unit {
        Some(unit) if log.header().is_none() => Some(with_quantisation(&input, unit, quiet)?),
        unit => unit,
    };
    // What is said here goes before what a recording says, all along.
    let told = |header: Option<&Header>| {
        let recorded = match header {
            Some(header) => replay::recorded(header, args.method),
            None => Setup {
                latitude_deg: 0.0,
                height_m: 0.0,
                rotor: RotorConfig::default(),
                unit: Unit::default(),
                deviation: None,
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
    args.report.as_deref().map_or(Ok(()), folder)?;
    let setup = told(log.header());
    let mut observer = ReplayObserver {
        bar,
        moments: args.report.is_some().then(Vec::new),
        quiet,
        bridged: 0,
        bridged_s: 0.0,
        restarted: 0,
        bad: 0,
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
    if observer.bad > 0 {
        warn(&format!(
            "{} samples beyond any sensor's range: the alignment began anew after each",
            observer.bad
        ));
    }
    if observer.restarted > RESTARTS_TOLD {
        warn(&format!(
            "started anew {} times more",
            observer.restarted - RESTARTS_TOLD
        ));
    }
    if let (Some(dir), Some(moments)) = (&args.report, &observer.moments) {
        let origin = report::Replayed {
            log: &input.name,
            setup: &setup,
            command: &command_line(),
        };
        report::replay(dir, &origin, &result, moments).map_err(words)?;
    }
    if args.json {
        print_json(&alignment(&result))?;
    } else {
        print(&table::replay(&result))?;
        if let Some(dir) = &args.report {
            print(&format!("report: {}\n", dir.join("report.html").display()))?;
        }
    }
    Ok(exit(result.state))
}

/// The figures of the IMU of a CSV log: those beside it, or those that it shows and says on the way.
fn unit_of_log(input: &Input, quiet: bool) -> Result<Unit, String> {
    if let Some(beside) = input.figures() {
        if !quiet {
            eprintln!("IMU: the figures in {}", beside.display());
        }
        return Unit::load(&beside).map_err(words);
    }
    let (reader, _) = input.open(true)?;
    let unit = replay::measured(reader);
    if !quiet {
        eprintln!(
            "IMU: no --unit. White noise as in the log: gyros {} degrees/√h, accelerometers {} µg/√Hz; the rest of an unknown \
             tactical MEMS: bias {} degrees/h, scale factors {} ppm, g-sensitivity {} degrees/h/g",
            unit.angle_random_walk_deg_sqrt_h,
            unit.velocity_random_walk_ug_sqrt_hz,
            unit.gyro_bias_sd_deg_h,
            unit.gyro_scale_factor_sd_ppm,
            unit.gyro_g_sensitivity_sd_deg_h_g
        );
    }
    Ok(unit)
}

/// The figures of the IMU, its white noise no less than the steps of the log make it where they are far above.
fn with_quantisation(input: &Input, unit: Unit, quiet: bool) -> Result<Unit, String> {
    let (mut reader, _) = input.open(true)?;
    let (gyro, accel) = replay::quantisation(&mut reader);
    let coarse = |steps: f64, told: f64| steps > COARSE * told;
    let mut with = unit;
    let (mut named, told) = (
        Vec::new(),
        (with.angle_random_walk_deg_sqrt_h, with.velocity_random_walk_ug_sqrt_hz),
    );
    if coarse(gyro, told.0) {
        with.angle_random_walk_deg_sqrt_h = gyro;
        named.push(format!("gyros {gyro:.4} degrees/√h instead of {}", told.0));
    }
    if coarse(accel, told.1) {
        with.velocity_random_walk_ug_sqrt_hz = accel;
        named.push(format!("accelerometers {accel:.0} µg/√Hz instead of {}", told.1));
    }
    if !quiet && !named.is_empty() {
        eprintln!("IMU: white noise as the steps of the log make it: {}", named.join(", "));
    }
    Ok(with)
}

/// Steps of a log that make so many times the white noise that was told are taken into account.
const COARSE: f64 = 3.0;

/// So many restarts of a replay are told one by one.
const RESTARTS_TOLD: u64 = 5;

/// Prints what happens in a replay.
struct ReplayObserver {
    bar: ProgressBar,
    quiet: bool,
    /// What a report shows, where there is to be one.
    moments: Option<Vec<replay::Moment>>,
    bridged: u64,
    bridged_s: f64,
    restarted: u64,
    bad: u64,
}

impl replay::Observer for ReplayObserver {
    fn event(&mut self, t: f64, event: &Event<f32>) {
        match event {
            // One line for all of them, at the end: a log may have thousands.
            Event::Bridged { length } => {
                self.bridged += 1;
                self.bridged_s += f64::from(*length);
            }
            // So here: most samples of a log in other units are such.
            Event::Restarted(Restart::BadSample) => self.bad += 1,
            Event::Restarted(_) => {
                self.restarted += 1;
                if self.restarted <= RESTARTS_TOLD {
                    self.bar
                        .suspend(|| warn(&format!("at {t:.2} s {}", align::describe(event))));
                }
            }
            _ => told(&self.bar, self.quiet, t, &align::describe(event)),
        }
    }

    fn moment(&mut self, moment: &replay::Moment) {
        if let Some(moments) = &mut self.moments {
            moments.push(*moment);
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

/// A log that is to be read, also more than once.
struct Input {
    path: PathBuf,
    name: String,
    format: Format,
    /// Standard input as a file, which can be read more than once.
    kept: Option<NamedTempFile>,
}

impl Input {
    fn new(args: &LogArgs) -> Result<Self, String> {
        let mut format = args
            .format
            .as_deref()
            .map_or(Ok(Format::default()), Format::find)
            .map_err(words)?;
        if let Some(mounting) = args.mounting {
            format = format.with_mounting(mounting);
        }
        if let Some(unit) = args.encoder_unit {
            format = format.with_encoder_unit(unit);
        }
        if let Some(rate_hz) = args.rate_hz {
            format = format.with_rate(rate_hz);
        }
        let mut input = Self {
            path: args.log.clone(),
            name: args.log.display().to_string(),
            format,
            kept: None,
        };
        if args.log == Path::new("-") {
            "standard input".clone_into(&mut input.name);
            let mut kept = NamedTempFile::new().map_err(|e| input.cannot_read(&e))?;
            io::copy(&mut io::stdin().lock(), &mut kept).map_err(|e| input.cannot_read(&e))?;
            input.kept = Some(kept);
        }
        Ok(input)
    }

    fn cannot_read(&self, error: &io::Error) -> String {
        LogError::cannot_read(&self.name, error).to_string()
    }

    fn file(&self) -> io::Result<(u64, File)> {
        let file = match &self.kept {
            Some(kept) => kept.reopen()?,
            None => File::open(&self.path)?,
        };
        Ok((file.metadata()?.len(), file))
    }

    fn open(&self, quiet: bool) -> Result<(OpenLog, ProgressBar), String> {
        let (length, file) = self.file().map_err(|e| self.cannot_read(&e))?;
        let bar = bar(length, "bytes", quiet);
        let input = BufReader::with_capacity(1 << 16, bar.wrap_read(file));
        let log = LogReader::with_format(input, &self.name, &self.format).map_err(words)?;
        Ok((log, bar))
    }

    /// The file with the figures of the IMU that is beside the log, where there is one.
    fn figures(&self) -> Option<PathBuf> {
        let beside = self.kept.is_none().then(|| Unit::beside(&self.path));
        beside.filter(|beside| beside.exists())
    }

    /// Writes the figures of the log's IMU beside the log that was made of it, so that `replay` finds them there.
    fn pass_figures_on(&self, header: Option<&Header>, to: &Path, quiet: bool) -> Result<(), String> {
        let unit = match (header, self.figures()) {
            (Some(header), _) => Unit::of_noise(&header.noise),
            (None, Some(beside)) => Unit::load(&beside).map_err(words)?,
            (None, None) => return Ok(()),
        };
        let beside = Unit::beside(to);
        std::fs::write(&beside, unit.to_toml().map_err(words)?).map_err(|e| cannot_write(&beside, &e))?;
        if !quiet {
            eprintln!("IMU: its figures in {}", beside.display());
        }
        Ok(())
    }
}

fn convert_log(args: &ConvertArgs, quiet: bool) -> Done {
    has_folder(&args.csv)?;
    let input = Input::new(&args.input)?;
    let (mut reader, bar) = input.open(quiet)?;
    let rows = convert_from(&mut reader, &input.path, &args.csv, LogRow::sample).map_err(words)?;
    bar.finish_and_clear();
    reader.warnings().iter().for_each(|warning| warn(&warning.to_string()));
    input.pass_figures_on(reader.header(), &args.csv, quiet)?;
    if !quiet {
        eprintln!("{rows} rows");
    }
    Ok(ExitCode::SUCCESS)
}

fn turn(args: &TurnArgs, quiet: bool) -> Done {
    has_folder(&args.out)?;
    let radians = frames::units::DEG;
    let rotor = RotorConfig {
        rate: args.rate * radians,
        travel: args.travel * radians,
        acceleration: args.acceleration * radians,
    };
    let input = Input::new(&args.input)?;
    let (mut log, bar) = input.open(quiet)?;
    let rows = turn::turn(&mut log, &input.path, &args.out, &rotor).map_err(words)?;
    bar.finish_and_clear();
    log.warnings().iter().for_each(|warning| warn(&warning.to_string()));
    input.pass_figures_on(log.header(), &args.out, quiet)?;
    if !quiet {
        eprintln!("{rows} rows");
    }
    Ok(ExitCode::SUCCESS)
}

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
        print_json(&tagged("soak", &report))?;
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
        print_json(&tagged("observability", &found))?;
    } else {
        print(&table::observability(&found))?;
    }
    Ok(ExitCode::SUCCESS)
}

fn allan(args: &AllanArgs, quiet: bool) -> Done {
    args.unit.as_deref().map_or(Ok(()), has_folder)?;
    let mut written = args.unit.iter().chain([&args.plot]);
    written
        .try_for_each(|path| not_itself(&args.input.log, path))
        .map_err(words)?;
    let input = Input::new(&args.input)?;
    let named = |e| format!("{}: {e}", input.name);
    let (mut log, bar) = input.open(quiet)?;
    let report = allan::of_reader(&mut log).map_err(|e| match e {
        // A log's own errors begin with its name.
        AllanError::Log(e) => e.to_string(),
        other => named(other),
    })?;
    bar.finish_and_clear();
    log.warnings().iter().for_each(|warning| warn(&warning.to_string()));
    if let Some(folder) = args.plot.parent() {
        std::fs::create_dir_all(folder).map_err(|e| cannot_write(folder, &e))?;
    }
    report.plot(&args.plot).map_err(|e| cannot_write(&args.plot, &e))?;
    if let Some(unit) = &args.unit {
        std::fs::write(unit, report.unit_toml()).map_err(|e| cannot_write(unit, &e))?;
    }
    if args.json {
        print_json(&tagged("allan", &report))?;
    } else {
        print(&report.table())?;
        print(&format!("plot: {}\n", args.plot.display()))?;
    }
    Ok(ExitCode::SUCCESS)
}

fn calibrate(args: &CalibrateArgs, quiet: bool) -> Done {
    if let Some(path) = &args.corrected {
        has_folder(path)?;
        not_itself(&args.input.log, path).map_err(words)?;
    }
    let input = Input::new(&args.input)?;
    let unit = args.unit.as_deref().map(Unit::find).transpose().map_err(words)?;
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
        other => format!("{}: {other}", input.name),
    };
    let (mut log, bar) = input.open(quiet)?;
    let (calibration, report) = calibrate::of_reader(&mut log, &setup).map_err(named)?;
    bar.finish_and_clear();
    log.warnings().iter().for_each(|warning| warn(&warning.to_string()));
    if let Some(corrected) = &args.corrected {
        let (mut log, _) = input.open(true)?;
        calibrate::correct_log(&mut log, &input.path, corrected, &calibration).map_err(words)?;
    }
    if args.json {
        print_json(&tagged("calibrate", &report))?;
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
        let tagged: Vec<_> = reports.iter().map(|report| tagged("reproduce", report)).collect();
        print_json(&tagged)?;
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
        inspect::InspectError::Empty
        | inspect::InspectError::NeedsElf
        | inspect::InspectError::NotOurs
        | inspect::InspectError::SavedAsText
        | inspect::InspectError::NoTimes => {
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
        if !timeline.has_times() {
            return Err(named(inspect::InspectError::NoTimes));
        }
        inspect::chart::svg(path, &timeline).map_err(|e| cannot_write(path, &e))?;
    }
    if args.json {
        print_json(&tagged("inspect", &inspect::report::summary(&timeline)))?;
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
    if let Some(unit) = &simulated.unit {
        scenario.imu = Unit::find(unit).map_err(words)?;
        scenario.told = None;
    }
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

/// Makes the folder of a report, before anything is computed for it.
fn folder(dir: &Path) -> Result<(), String> {
    std::fs::create_dir_all(dir).map_err(|e| {
        format!(
            "cannot make the folder {}: {e}: name another with --report DIR",
            dir.display()
        )
    })
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

fn cannot_write(path: &Path, error: &impl core::fmt::Display) -> String {
    format!("cannot write {}: {error}", path.display())
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

fn exit(state: &str) -> ExitCode {
    if table::is_aligned(state) {
        ExitCode::SUCCESS
    } else {
        ExitCode::from(NOT_ALIGNED)
    }
}

fn warn(what: &str) {
    eprintln!("{} {what}", colour::said("warning:", Sense::Warning));
}

fn words(error: impl core::fmt::Display) -> String {
    error.to_string()
}
