//! The command line: a file for each command, with its arguments, its help and its work.
//!
//! What commands share is in [`args`], [`input`], [`output`] and [`table`]. Results go to stdout, progress and warnings to stderr.
//! Exit codes: 0 aligned, 1 not aligned, 2 bad input; of `link` 1 where the unit refuses or does not answer.

mod allan;
mod args;
mod bound;
mod calibrate;
mod colour;
mod completions;
mod convert;
mod input;
mod inspect;
mod link;
mod monte_carlo;
mod observability;
mod output;
mod replay;
mod reproduce;
mod run;
mod scenarios;
mod soak;
mod table;
mod turn;
mod unit;

use std::process::ExitCode;

use clap::{Parser, Subcommand};

use colour::Sense;
use output::BAD_INPUT;

/// After the options of `hal-sim --help`.
const HELP: &str = "\
Examples:
  hal-sim                                     a run of five minutes, and a page about it in report/
  hal-sim monte-carlo --runs 200              how good it is, over 200 runs
  hal-sim replay LOG.csv --latitude-deg 40    your own recording
  hal-sim COMMAND --help                      what a command takes, what comes out of it, examples

Results go to stdout, progress, events and warnings to stderr. Both have colours on a terminal, unless NO_COLOR is set.

Exit codes:
  0  aligned; of commands that align nothing: done
  1  not aligned, or not any more; `link`: the unit refuses or does not answer; `soak`: a promise is broken
  2  a file, a scenario or an argument cannot be used; the line after `error:` says which and what can";

/// Simulates a rotary MEMS IMU unit that finds true north on a swinging base, and replays recorded logs.
///
/// Without a command: `run`.
#[derive(Parser)]
#[command(name = "hal-sim", version, propagate_version = true, after_help = HELP)]
struct Cli {
    #[command(subcommand)]
    command: Option<Command>,
    /// Results, warnings and errors only: no progress, no events
    #[arg(long, short, global = true)]
    quiet: bool,
}

#[derive(Subcommand)]
enum Command {
    /// Simulate one run and report it
    #[command(after_help = run::HELP)]
    Run(run::RunArgs),
    /// Simulate many runs and report their statistics
    #[command(after_help = monte_carlo::HELP)]
    MonteCarlo(monte_carlo::MonteCarloArgs),
    /// Compute the least σ that any filter can have: the covariance of the ideal one along the true path
    #[command(after_help = bound::HELP)]
    Bound(bound::BoundArgs),
    /// Run the core on a recorded log
    #[command(after_help = replay::HELP)]
    Replay(replay::ReplayArgs),
    /// Simulate the whole unit: application, devices, buses and motor in virtual time
    #[command(after_help = unit::HELP)]
    Unit(unit::UnitArgs),
    /// Run the whole unit for hours while chance breaks it, types at it and shakes its lines
    #[command(after_help = soak::HELP)]
    Soak(soak::SoakArgs),
    /// Show what a unit sends, live, and send it commands
    #[command(after_help = link::HELP)]
    Link(link::LinkArgs),
    /// Tell which errors of a resting, turning IMU its velocity makes observable
    #[command(after_help = observability::HELP)]
    Observability(observability::ObservabilityArgs),
    /// Allan deviation of a log at rest: the noise and bias figures of an IMU
    #[command(after_help = allan::HELP)]
    Allan(allan::AllanArgs),
    /// Biases, misalignments and scale factor of the gyros from a log of a rest and a turn
    #[command(after_help = calibrate::HELP)]
    Calibrate(calibrate::CalibrateArgs),
    /// Write a log, also the recording of a unit's serial line, as CSV
    #[command(after_help = convert::HELP)]
    Convert(convert::ConvertArgs),
    /// Turn the log of an IMU at rest as a rotor would: what the method would make of a part that has none
    #[command(after_help = turn::HELP)]
    Turn(turn::TurnArgs),
    /// Reproduce the papers' tables and figures: what is published beside ours
    #[command(after_help = reproduce::HELP)]
    Reproduce(reproduce::ReproduceArgs),
    /// Inspect a unit's log: modes, estimates, faults, resets with their times, as table, CSV and chart
    #[command(after_help = inspect::HELP)]
    Inspect(inspect::InspectArgs),
    /// List the built-in scenarios, or print one as a start for your own
    #[command(after_help = scenarios::HELP)]
    Scenarios {
        /// Name of the scenario to print
        name: Option<String>,
    },
    /// Print the completions of commands and options for a shell
    #[command(after_help = completions::HELP)]
    Completions {
        /// The shell
        shell: clap_complete::Shell,
    },
}

/// Parses the command line and does what it says.
pub(crate) fn main() -> ExitCode {
    let cli = Cli::parse();
    // Without a command: `run` with its own defaults, which stand in one place only.
    let command = cli.command.or_else(|| Cli::parse_from(["hal-sim", "run"]).command);
    let Some(command) = command else {
        return ExitCode::from(BAD_INPUT);
    };
    let done = match command {
        Command::Run(args) => run::run(&args, cli.quiet),
        Command::MonteCarlo(args) => monte_carlo::run(&args, cli.quiet),
        Command::Bound(args) => bound::run(&args),
        Command::Replay(args) => replay::run(&args, cli.quiet),
        Command::Unit(args) => unit::run(&args, cli.quiet),
        Command::Soak(args) => soak::run(&args, cli.quiet),
        Command::Link(args) => link::run(&args),
        Command::Observability(args) => observability::run(&args),
        Command::Allan(args) => allan::run(&args, cli.quiet),
        Command::Calibrate(args) => calibrate::run(&args, cli.quiet),
        Command::Convert(args) => convert::run(&args, cli.quiet),
        Command::Turn(args) => turn::run(&args, cli.quiet),
        Command::Reproduce(args) => reproduce::run(&args, cli.quiet),
        Command::Inspect(args) => inspect::run(&args),
        Command::Scenarios { name } => scenarios::run(name.as_deref()),
        Command::Completions { shell } => completions::run(shell),
    };
    done.unwrap_or_else(|message| {
        eprintln!("{} {message}", colour::said("error:", Sense::Bad));
        ExitCode::from(BAD_INPUT)
    })
}

#[cfg(test)]
mod tests {
    use clap::CommandFactory as _;
    use hal_sim::log::format::FORMATS;

    use super::*;

    /// Words of a line as a shell takes them, up to what is beside it: two blanks, or where output goes.
    fn words_of(line: &str) -> Vec<String> {
        let line = line
            .split("  ")
            .next()
            .unwrap_or(line)
            .split('>')
            .next()
            .unwrap_or(line);
        let quoted = line.split('"').enumerate();
        quoted
            .flat_map(|(k, part)| match k % 2 {
                0 => part.split_whitespace().map(str::to_owned).collect::<Vec<_>>(),
                _ => vec![part.to_owned()],
            })
            .collect()
    }

    #[test]
    fn every_command_says_what_comes_out_with_examples_that_can_be_typed() {
        Cli::command().debug_assert();
        for command in Cli::command().get_subcommands() {
            let name = command.get_name();
            let help = command.get_after_help().map(ToString::to_string).unwrap_or_default();
            let (out, examples) = help.split_once("\n\nExamples:\n").expect(name);
            assert!(out.contains("Prints ") || out.contains("Writes "), "{name}: {out}");
            for line in examples.lines() {
                let words = words_of(line.trim_start());
                assert_eq!(words[..2], ["hal-sim", name], "{line}");
                assert!(Cli::try_parse_from(&words).is_ok(), "{line}");
            }
        }
        for line in HELP
            .lines()
            .filter(|line| line.starts_with("  hal-sim") && !line.contains("COMMAND"))
        {
            assert!(Cli::try_parse_from(words_of(line.trim_start())).is_ok(), "{line}");
        }
    }

    #[test]
    fn every_built_in_format_is_in_the_help() {
        for command in ["replay", "convert", "allan", "calibrate", "turn"] {
            let cli = Cli::command();
            let arguments = cli.find_subcommand(command).expect(command).get_arguments();
            let format = arguments.filter(|option| option.get_id() == "format");
            let help: String = format
                .filter_map(|option| option.get_help())
                .map(ToString::to_string)
                .collect();
            for builtin in FORMATS {
                assert!(
                    help.contains(&format!("{}, ", builtin.name)),
                    "{command}: {} in {help}",
                    builtin.name
                );
            }
        }
    }

    #[test]
    fn every_number_has_its_unit_or_is_a_count() {
        let counts = ["runs", "seed", "speed"];
        let units = [", s", ", h", "m/s", "°/s", "m/s²", "degrees", "arcsec", ", m "];
        for command in Cli::command().get_subcommands() {
            for option in command.get_arguments() {
                let help = option.get_help().map(ToString::to_string).unwrap_or_default();
                let (name, negative) = (option.get_id().as_str(), option.is_allow_negative_numbers_set());
                assert!(!help.is_empty(), "{name}");
                let told = units.iter().any(|unit| help.contains(unit));
                assert!(!negative || counts.contains(&name) || told, "{name}: {help}");
            }
        }
    }
}
