//! Runs the core on a recorded log.

use std::path::PathBuf;

use clap::Args;
use hal_sim::align::{self, Method, Setup};
use hal_sim::log::{Header, LogWarning, UnitStatus};
use hal_sim::outcome::alignment;
use hal_sim::replay;
use hal_sim::report;
use hal_sim::unit::Unit;
use indicatif::ProgressBar;
use nav::aligner::{Event, Restart};
use nav::rotor::RotorConfig;

use super::args::{Base, LogArgs};
use super::input::Input;
use super::output::{Done, command_line, exit, folder, print, print_json, told, warn, words};
use super::table;

pub(super) const HELP: &str = "\
Prints what happens, then heading, pitch and roll (°) with σ, and the biases found. Writes no file but with --report: a page,
and estimates.csv (once a second). A log that cannot be true is refused, with the likely cause: unit, sign, encoder. Exit code 0
where the log's end finds it aligned.

Examples:
  hal-sim replay LOG.csv --latitude-deg 40
  hal-sim replay LOG.csv --latitude-deg 40 --unit UNIT.toml --json
  hal-sim replay LOG.csv --latitude-deg 40 --encoder-unit -deg --report report/LOG
  hal-sim replay LOG.bin                      a recording by `link --record`: it says itself where it stands";

#[derive(Args)]
pub(super) struct ReplayArgs {
    #[command(flatten)]
    input: LogArgs,
    /// Geodetic latitude of the place, degrees, north positive (default: the unit's, which a recording holds)
    #[arg(long, value_name = "L", allow_negative_numbers = true)]
    latitude_deg: Option<f64>,
    /// Height above the ellipsoid, m (default: the recording's, or 0)
    #[arg(long, value_name = "H", allow_negative_numbers = true)]
    height_m: Option<f64>,
    /// The IMU: a part (adis16495-1, -2, -3, icm42688, paper, tactical) or a file with its figures (default: the
    /// recording's, or LOG.unit.toml beside LOG.csv; else white noise as in the log, the rest of an unknown tactical MEMS)
    #[arg(long, value_name = "PART|FILE")]
    unit: Option<String>,
    /// Fine filter
    #[arg(long, value_enum, default_value = "robust")]
    method: Method,
    #[command(flatten)]
    base: Base,
    /// Write a page about it into this folder: attitude, innovations and biases over time
    #[arg(long, value_name = "DIR")]
    report: Option<PathBuf>,
    /// Print the result as JSON
    #[arg(long)]
    json: bool,
}

pub(super) fn run(args: &ReplayArgs, quiet: bool) -> Done {
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

/// Quantisation noise of a log counts where it is more than this multiple of the configured white noise.
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
