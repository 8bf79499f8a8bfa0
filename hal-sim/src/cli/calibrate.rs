//! Calibrates the gyros from a log of a rest and a turn.

use std::path::PathBuf;
use std::process::ExitCode;

use clap::Args;
use hal_sim::calibrate::{self, CalibrateError, Stand};
use hal_sim::log::not_itself;
use hal_sim::outcome::tagged;
use hal_sim::unit::Unit;

use super::args::{LogArgs, seconds};
use super::input::Input;
use super::output::{Done, has_folder, print, print_json, warn, words};

pub(super) const HELP: &str = "\
Prints biases (°/h), scale factor (ppm) and misalignments (arcmin) of the gyros with σ. With --corrected it writes the log
again, without them.

Examples:
  hal-sim calibrate LOG.csv
  hal-sim calibrate LOG.csv --latitude-deg 40 --heading-deg 90 --corrected CORRECTED.csv";

#[derive(Args)]
pub(super) struct CalibrateArgs {
    #[command(flatten)]
    input: LogArgs,
    /// The IMU: a part or a file with its figures, as for `replay` (default: that of the main paper, Table 2)
    #[arg(long, value_name = "PART|FILE")]
    unit: Option<String>,
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

pub(super) fn run(args: &CalibrateArgs, quiet: bool) -> Done {
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
