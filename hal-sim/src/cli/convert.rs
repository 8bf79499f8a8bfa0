//! Writes a log as CSV.

use std::path::PathBuf;
use std::process::ExitCode;

use clap::Args;
use hal_sim::log::{LogRow, convert_from};

use super::args::LogArgs;
use super::input::Input;
use super::output::{Done, has_folder, warn, words};

pub(super) const HELP: &str = "\
Writes the CSV and says how many rows it has.

Examples:
  hal-sim convert LOG.bin LOG.csv
  hal-sim convert imu.csv LOG.csv --format ros-imu
  hal-sim convert - LOG.csv --format kitti-oxts --rate-hz 100";

#[derive(Args)]
pub(super) struct ConvertArgs {
    #[command(flatten)]
    input: LogArgs,
    /// CSV to write
    csv: PathBuf,
}

pub(super) fn run(args: &ConvertArgs, quiet: bool) -> Done {
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
