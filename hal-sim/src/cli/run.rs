//! Simulates one run and reports it.

use std::fs::File;
use std::io::{self, BufWriter};
use std::path::PathBuf;

use clap::Args;
use hal_sim::align::Method;
use hal_sim::log::LogWriter;
use hal_sim::outcome::alignment;
use hal_sim::report::{self, Origin};
use hal_sim::scenario::Temperature;
use hal_sim::simulate::{self, Moment, Row};
use hal_sim::unit::Unit;
use indicatif::ProgressBar;

use super::args::{Base, Simulated, scenario_on};
use super::output::{Done, bar, cannot_write, command_line, exit, folder, has_folder, print, print_json, told, words};
use super::table;

pub(super) const HELP: &str = "\
Prints what happens, then truth, estimate, error and σ of attitude and biases. Writes report/SCENARIO-seedN/: report.html to
look at, result.json, estimates.csv (once a second), plots as SVG. Exit code 0 where it ends aligned.

Examples:
  hal-sim run --scenario moored --seed 7
  hal-sim run --seconds 600 --log LOG.csv     writes what `replay` reads
  hal-sim run --method stf --json --quiet     the paper's filter; the result alone, for a program";

#[derive(Args)]
pub(super) struct RunArgs {
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

pub(super) fn run(args: &RunArgs, quiet: bool) -> Done {
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
