//! Computes the covariance of the ideal filter along the true path.

use std::path::PathBuf;
use std::process::ExitCode;

use clap::Args;
use hal_sim::bound::{self, BoundConfig};
use hal_sim::outcome::tagged;
use hal_sim::report::{self, Origin};

use super::args::{Simulated, scenario};
use super::output::{Done, command_line, folder, print, print_json, words};
use super::table;

pub(super) const HELP: &str = "\
Prints σ of attitude and biases against time, and what a single cause alone leaves of heading. Writes
report/SCENARIO-bound-seedN/: report.html, result.json, sigma.csv, the plot of heading as SVG. Takes a second.

Examples:
  hal-sim bound --scenario moored
  hal-sim bound --seconds 3600 --velocity-sd 0.001";

#[derive(Args)]
pub(super) struct BoundArgs {
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

pub(super) fn run(args: &BoundArgs) -> Done {
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
