//! Inspects the log of a unit.

use std::io::{self, IsTerminal as _, Read};
use std::path::{Path, PathBuf};

use clap::Args;
use hal_sim::inspect::{self, defmt::Elf, live, live::Tail};
use hal_sim::log::not_itself;
use hal_sim::outcome::tagged;

use super::output::{Done, cannot_write, exit, has_folder, print, print_json, words};

pub(super) const HELP: &str = "\
Prints modes, estimates, faults and resets with their times. Exit code 0 where the log ends aligned or navigating.

Examples:
  hal-sim inspect LOG.txt --svg chart.svg --csv estimates.csv
  hal-sim inspect LOG.bin --elf firmware
  hal-sim inspect - --follow                  what another program prints, while it does";

#[derive(Args)]
pub(super) struct InspectArgs {
    /// Raw stream of defmt, or output of probe-rs, defmt-print (also --json), `cargo emulate`, `hal-sim unit`; `-` is standard input
    log: PathBuf,
    /// The image that wrote the stream of defmt
    #[arg(long, value_name = "ELF")]
    elf: Option<PathBuf>,
    /// Write the estimates as CSV
    #[arg(long, value_name = "FILE")]
    csv: Option<PathBuf>,
    /// Write the chart, as SVG
    #[arg(long, value_name = "FILE")]
    svg: Option<PathBuf>,
    /// Print the timeline as JSON
    #[arg(long)]
    json: bool,
    /// Show the log while it is written; a file is waited for until this is interrupted
    #[arg(long, conflicts_with = "json")]
    follow: bool,
}

pub(super) fn run(args: &InspectArgs) -> Done {
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
