//! Runs the whole unit for hours under random faults.

use std::process::ExitCode;

use clap::Args;
use hal_sim::outcome::tagged;
use hal_sim::soak::SoakConfig;

use super::output::{Done, bar, print, print_json, words};

pub(super) const HELP: &str = "\
Prints what was broken and how often, what was found and what should have been. A day takes some minutes. Exit code 0 where
every promise holds.

Examples:
  hal-sim soak
  hal-sim soak --hours 2 --seed 7 --json";

#[derive(Args)]
pub(super) struct SoakArgs {
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

fn hours(text: &str) -> Result<f64, String> {
    let hours = text.parse().ok().filter(|hours| (0.1..=10_000.0).contains(hours));
    hours.ok_or_else(|| "expected hours from 0.1 to 10000".to_owned())
}

pub(super) fn run(args: &SoakArgs, quiet: bool) -> Done {
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
