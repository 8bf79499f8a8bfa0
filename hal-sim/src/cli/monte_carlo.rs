//! Simulates many runs and reports their statistics.

use std::path::PathBuf;

use clap::Args;
use hal_sim::align::Method;
use hal_sim::monte_carlo;
use hal_sim::outcome::tagged;
use hal_sim::report::{self, Origin};

use super::args::{Base, Simulated, scenario_on};
use super::output::{Done, bar, command_line, exit, folder, print, print_json, words};
use super::table;

pub(super) const HELP: &str = "\
Prints mean, scatter, RMS and predicted σ of the errors at the end of the runs, and the RMS over the ideal filter's σ. Writes
report/SCENARIO-monte-carlo/: report.html, result.json, histograms as SVG. Exit code 0 where any run ends aligned.

Examples:
  hal-sim monte-carlo --runs 200 --seed 1
  hal-sim monte-carlo --scenario moored --runs 400 --method robust,kf,stf";

#[derive(Args)]
pub(super) struct MonteCarloArgs {
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

pub(super) fn run(args: &MonteCarloArgs, quiet: bool) -> Done {
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
