//! Allan deviation of a log at rest.

use std::path::PathBuf;
use std::process::ExitCode;

use clap::Args;
use hal_sim::allan::{self, AllanError};
use hal_sim::log::not_itself;
use hal_sim::outcome::tagged;

use super::args::LogArgs;
use super::input::Input;
use super::output::{Done, cannot_write, has_folder, print, print_json, warn, words};

pub(super) const HELP: &str = "\
Prints random walk (°/√h, µg/√Hz) and bias instability (°/h, µg) of each axis with their uncertainty. Writes the plot, and
with --unit the figures for `replay` and `calibrate`.

Examples:
  hal-sim allan LOG.csv --unit UNIT.toml
  hal-sim allan LOG.csv --plot allan.svg --json";

#[derive(Args)]
pub(super) struct AllanArgs {
    #[command(flatten)]
    input: LogArgs,
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

pub(super) fn run(args: &AllanArgs, quiet: bool) -> Done {
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
