//! Turns the log of an IMU at rest as a rotor would.

use std::path::PathBuf;
use std::process::ExitCode;

use clap::Args;
use hal_sim::turn;
use nav::rotor::RotorConfig;

use super::args::{LogArgs, positive};
use super::input::Input;
use super::output::{Done, has_folder, warn, words};

pub(super) const HELP: &str = "\
Writes the CSV and says how many rows it has. A bias of the log cannot be told from Earth's rate: it is turned as well, and
goes into heading as it does at rest. What the rotor's rate does to a gyro is not in it.

Examples:
  hal-sim turn REST.csv -o TURNED.csv
  hal-sim turn REST.csv --rate 10 -o TURNED.csv   then: hal-sim replay TURNED.csv --latitude-deg 40";

#[derive(Args)]
pub(super) struct TurnArgs {
    #[command(flatten)]
    input: LogArgs,
    /// Rate of the rotor, °/s
    #[arg(long, value_name = "DPS", default_value_t = 20.0, value_parser = positive)]
    rate: f64,
    /// Angle from one turning point to the other, degrees
    #[arg(long, value_name = "DEG", default_value_t = 360.0, value_parser = positive)]
    travel: f64,
    /// Acceleration at the turning points, degrees/s²
    #[arg(long, value_name = "A", default_value_t = 200.0, value_parser = positive)]
    acceleration: f64,
    /// CSV to write
    #[arg(long, short, value_name = "FILE")]
    out: PathBuf,
}

pub(super) fn run(args: &TurnArgs, quiet: bool) -> Done {
    has_folder(&args.out)?;
    let radians = frames::units::DEG;
    let rotor = RotorConfig {
        rate: args.rate * radians,
        travel: args.travel * radians,
        acceleration: args.acceleration * radians,
    };
    let input = Input::new(&args.input)?;
    let (mut log, bar) = input.open(quiet)?;
    let rows = turn::turn(&mut log, &input.path, &args.out, &rotor).map_err(words)?;
    bar.finish_and_clear();
    log.warnings().iter().for_each(|warning| warn(&warning.to_string()));
    input.pass_figures_on(log.header(), &args.out, quiet)?;
    if !quiet {
        eprintln!("{rows} rows");
    }
    Ok(ExitCode::SUCCESS)
}
