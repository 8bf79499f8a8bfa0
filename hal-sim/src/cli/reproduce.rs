//! Reproduces the papers' tables and figures.

use std::path::PathBuf;
use std::process::ExitCode;

use clap::Args;
use hal_sim::outcome::tagged;
use hal_sim::reproduce;

use super::output::{Done, bar, command_line, folder, print, print_json, words};

pub(super) const HELP: &str = "\
Prints every published figure beside ours, and the verdict. Writes report/reproduce/: report.html, and of each its curves as
CSV and its plots as SVG. --all takes three minutes of processor time.

Examples:
  hal-sim reproduce
  hal-sim reproduce yu15
  hal-sim reproduce du17-observability xing18-allan";

#[derive(Args)]
pub(super) struct ReproduceArgs {
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

pub(super) fn run(args: &ReproduceArgs, quiet: bool) -> Done {
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
