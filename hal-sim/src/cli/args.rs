//! The command line: commands and their arguments.

use std::path::PathBuf;

use clap::{Args, Parser, Subcommand};
use hal_sim::align::Method;
use hal_sim::bound::BoundConfig;
use hal_sim::link::{self, serve::Place};
use hal_sim::log::format::{EncoderUnit, Mounting};
use hal_sim::observability::Axis;
use hal_sim::unit_sim::Typed;

use super::help;

/// Simulates a rotary MEMS IMU unit that finds true north on a swinging base, and replays recorded logs.
///
/// Without a command: `run`.
#[derive(Parser)]
#[command(name = "hal-sim", version, propagate_version = true, after_help = help::ALL)]
pub(super) struct Cli {
    #[command(subcommand)]
    pub(super) command: Option<Command>,
    /// Results, warnings and errors only: no progress, no events
    #[arg(long, short, global = true)]
    pub(super) quiet: bool,
}

#[derive(Subcommand)]
pub(super) enum Command {
    /// Simulate one run and report it
    #[command(after_help = help::RUN)]
    Run(RunArgs),
    /// Simulate many runs and report their statistics
    #[command(after_help = help::MONTE_CARLO)]
    MonteCarlo(MonteCarloArgs),
    /// Compute the least σ that any filter can have: the covariance of the ideal one along the true path
    #[command(after_help = help::BOUND)]
    Bound(BoundArgs),
    /// Run the core on a recorded log
    #[command(after_help = help::REPLAY)]
    Replay(ReplayArgs),
    /// Simulate the whole unit: application, devices, buses and motor in virtual time
    #[command(after_help = help::UNIT)]
    Unit(UnitArgs),
    /// Run the whole unit for hours while chance breaks it, types at it and shakes its lines
    #[command(after_help = help::SOAK)]
    Soak(SoakArgs),
    /// Show what a unit sends, live, and send it commands
    #[command(after_help = help::LINK)]
    Link(LinkArgs),
    /// Tell which errors of a resting, turning IMU its velocity makes observable
    #[command(after_help = help::OBSERVABILITY)]
    Observability(ObservabilityArgs),
    /// Allan deviation of a log at rest: the noise and bias figures of an IMU
    #[command(after_help = help::ALLAN)]
    Allan(AllanArgs),
    /// Biases, misalignments and scale factor of the gyros from a log of a rest and a turn
    #[command(after_help = help::CALIBRATE)]
    Calibrate(CalibrateArgs),
    /// Write a log, also the recording of a unit's serial line, as CSV
    #[command(after_help = help::CONVERT)]
    Convert(ConvertArgs),
    /// Turn the log of an IMU at rest as a rotor would: what the method would make of a part that has none
    #[command(after_help = help::TURN)]
    Turn(TurnArgs),
    /// Reproduce the papers' tables and figures: what is published beside ours
    #[command(after_help = help::REPRODUCE)]
    Reproduce(ReproduceArgs),
    /// Inspect a unit's log: modes, estimates, faults, resets with their times, as table, CSV and chart
    #[command(after_help = help::INSPECT)]
    Inspect(InspectArgs),
    /// List the built-in scenarios, or print one as a start for your own
    #[command(after_help = help::SCENARIOS)]
    Scenarios {
        /// Name of the scenario to print
        name: Option<String>,
    },
    /// Print the completions of commands and options for a shell
    #[command(after_help = help::COMPLETIONS)]
    Completions {
        /// The shell
        shell: clap_complete::Shell,
    },
}

/// What is simulated.
#[derive(Args)]
pub(super) struct Simulated {
    /// Built-in scenario (`hal-sim scenarios` lists them), or a TOML file
    #[arg(long, short, value_name = "NAME|FILE", default_value = "paper-sim")]
    pub(super) scenario: String,
    /// Seed of every chance: the same one gives the same run, to the bit
    #[arg(long, value_name = "N", default_value_t = 1)]
    pub(super) seed: u64,
    /// IMU in place of the scenario's: a part (adis16495-1, -2, -3, icm42688, paper, tactical) or a file with its figures.
    /// Errors are drawn from them, and the filter is configured with them
    #[arg(long, value_name = "PART|FILE")]
    pub(super) unit: Option<String>,
    /// Length of a run, s (default: the scenario's); of `unit`, from the beginning of its alignment
    #[arg(long, visible_alias = "duration", value_name = "S", allow_negative_numbers = true)]
    pub(super) seconds: Option<f64>,
}

/// What the unit is told of its base.
#[derive(Args)]
pub(super) struct Base {
    /// The base is fixed to Earth: measure the z gyro by the encoder, 1σ of an angle read, arcsec (without a number: 10)
    #[arg(long, value_name = "ARCSEC", num_args = 0..=1, require_equals = true, default_missing_value = "10", value_parser = arcsec)]
    pub(super) encoder_constraint: Option<f64>,
}

#[derive(Args)]
pub(super) struct RunArgs {
    #[command(flatten)]
    pub(super) simulated: Simulated,
    #[command(flatten)]
    pub(super) base: Base,
    /// Fine filter
    #[arg(long, value_enum, default_value = "robust")]
    pub(super) method: Method,
    /// Write the samples as a CSV log that `replay` reads
    #[arg(long, value_name = "FILE")]
    pub(super) log: Option<PathBuf>,
    /// Folder for the report
    #[arg(long, value_name = "DIR", default_value = "report")]
    pub(super) report: PathBuf,
    /// Print the result as JSON
    #[arg(long)]
    pub(super) json: bool,
}

#[derive(Args)]
pub(super) struct MonteCarloArgs {
    #[command(flatten)]
    pub(super) simulated: Simulated,
    #[command(flatten)]
    pub(super) base: Base,
    /// Number of runs
    #[arg(long, short = 'n', value_name = "N", default_value_t = 100, value_parser = clap::value_parser!(u64).range(1..=1_000_000))]
    pub(super) runs: u64,
    /// Fine filters, each on the same runs; `fine` in the JSON is the first
    #[arg(long, value_enum, value_delimiter = ',', default_value = "robust")]
    pub(super) method: Vec<Method>,
    /// Folder for the report
    #[arg(long, value_name = "DIR", default_value = "report")]
    pub(super) report: PathBuf,
    /// Print the result as JSON
    #[arg(long)]
    pub(super) json: bool,
}

#[derive(Args)]
pub(super) struct BoundArgs {
    #[command(flatten)]
    pub(super) simulated: Simulated,
    /// How well zero velocity is known once a second, m/s
    #[arg(long, value_name = "V", allow_negative_numbers = true, default_value_t = BoundConfig::default().velocity_sd)]
    pub(super) velocity_sd: f64,
    /// Folder for the report
    #[arg(long, visible_alias = "report", value_name = "DIR", default_value = "report")]
    pub(super) out: PathBuf,
    /// Print the result as JSON
    #[arg(long)]
    pub(super) json: bool,
}

/// Which log, and what its columns are.
#[derive(Args)]
pub(super) struct LogArgs {
    /// CSV log: t_s, gyro_x/y/z_rad_s, accel_x/y/z_m_s2, encoder_rad by header, in any order; or the recording of a
    /// unit's serial line; `-` is standard input
    pub(super) log: PathBuf,
    /// What the columns of another program's text are: ros-imu, ros-imu-bag, ros2-imu, ros2-imu-bag, xsens-mt, vectornav-imu,
    /// vectornav-dtv, kvh-1750, psins, kitti-oxts, or a TOML file (docs/log.md)
    #[arg(long, value_name = "NAME|FILE")]
    pub(super) format: Option<String>,
    /// How the IMU sits on the rotor: which of its axes are x, y and z of the rotor (right, front, up), y,x,-z; or three
    /// angles about x, y, z, degrees: 180,0,90
    #[arg(long, value_name = "AXES", allow_hyphen_values = true)]
    pub(super) mounting: Option<Mounting>,
    /// Unit of the encoder: rad, mrad, deg, arcmin, turns, or counts as 16384/turn; -deg where it is reversed
    #[arg(long, value_name = "UNIT", allow_hyphen_values = true)]
    pub(super) encoder_unit: Option<EncoderUnit>,
    /// Rows a second, Hz, where no column has the time
    #[arg(long, value_name = "HZ", value_parser = positive)]
    pub(super) rate_hz: Option<f64>,
}

#[derive(Args)]
pub(super) struct ConvertArgs {
    #[command(flatten)]
    pub(super) input: LogArgs,
    /// CSV to write
    pub(super) csv: PathBuf,
}

#[derive(Args)]
pub(super) struct ReplayArgs {
    #[command(flatten)]
    pub(super) input: LogArgs,
    /// Geodetic latitude of the place, degrees, north positive (default: the unit's, which a recording holds)
    #[arg(long, value_name = "L", allow_negative_numbers = true)]
    pub(super) latitude_deg: Option<f64>,
    /// Height above the ellipsoid, m (default: the recording's, or 0)
    #[arg(long, value_name = "H", allow_negative_numbers = true)]
    pub(super) height_m: Option<f64>,
    /// The IMU: a part (adis16495-1, -2, -3, icm42688, paper, tactical) or a file with its figures (default: the
    /// recording's, or LOG.unit.toml beside LOG.csv; else white noise as in the log, the rest of an unknown tactical MEMS)
    #[arg(long, value_name = "PART|FILE")]
    pub(super) unit: Option<String>,
    /// Fine filter
    #[arg(long, value_enum, default_value = "robust")]
    pub(super) method: Method,
    #[command(flatten)]
    pub(super) base: Base,
    /// Write a page about it into this folder: attitude, innovations and biases over time
    #[arg(long, value_name = "DIR")]
    pub(super) report: Option<PathBuf>,
    /// Print the result as JSON
    #[arg(long)]
    pub(super) json: bool,
}

#[derive(Args)]
pub(super) struct UnitArgs {
    #[command(flatten)]
    pub(super) simulated: Simulated,
    #[command(flatten)]
    pub(super) base: Base,
    /// Fine filter
    #[arg(long, value_enum, default_value = "robust")]
    pub(super) method: Method,
    /// Least severe level of the unit's log that is printed
    #[arg(long, value_name = "LEVEL", default_value = "info")]
    pub(super) log_level: log::LevelFilter,
    /// Write what the unit's serial port sends: NMEA 0183
    #[arg(long, value_name = "FILE")]
    pub(super) nmea: Option<PathBuf>,
    /// The same with every sample in it, for `replay` and `convert`: types `record on` first of all
    #[arg(long, value_name = "FILE", conflicts_with = "nmea")]
    pub(super) record: Option<PathBuf>,
    /// Type a line to the unit at a time, s since power-up: "200 calibrate"; may be given again
    #[arg(long = "type", value_name = "\"T LINE\"")]
    pub(super) typed: Vec<Typed>,
    /// Run in real time with the unit's serial line on a socket, tcp:HOST:PORT, or a pty: for `link`, or what else reads
    /// NMEA 0183; until broken off, unless --seconds is given
    #[arg(long, value_name = "WHERE", conflicts_with = "json")]
    pub(super) serve: Option<Place>,
    /// Seconds of the unit that pass in one second, 0.01 to 1000
    #[arg(long, value_name = "N", default_value_t = 1.0, requires = "serve", value_parser = speed)]
    pub(super) speed: f64,
    /// Print the result as JSON, and the log to stderr
    #[arg(long)]
    pub(super) json: bool,
}

#[derive(Args)]
pub(super) struct SoakArgs {
    /// Virtual time, h
    #[arg(long, value_name = "H", default_value_t = 24.0, allow_negative_numbers = true, value_parser = hours)]
    pub(super) hours: f64,
    /// Seed of every chance: the same one gives the same run, to the bit
    #[arg(long, value_name = "N", default_value_t = 1)]
    pub(super) seed: u64,
    /// Print the report as JSON
    #[arg(long)]
    pub(super) json: bool,
}

#[derive(Args)]
pub(super) struct LinkArgs {
    /// Serial port, as /dev/ttyACM0, a pty, or tcp:HOST:PORT
    pub(super) port: link::Port,
    /// Send a line, wait for the answer and print it: "set latitude 40.1"; may be given again. Exit code 1 where one is
    /// refused or not answered; the next are then not sent. `calibrate` is followed to its end
    #[arg(long, value_name = "LINE")]
    pub(super) send: Vec<String>,
    /// How long an answer may take, s
    #[arg(long, value_name = "S", default_value_t = 2.0, requires = "send", allow_negative_numbers = true, value_parser = seconds)]
    pub(super) timeout: f64,
    /// Write what comes from the unit, byte by byte
    #[arg(long, value_name = "FILE")]
    pub(super) record: Option<PathBuf>,
    /// End after so long, s (default: when broken off)
    #[arg(long, value_name = "S", conflicts_with = "send", allow_negative_numbers = true, value_parser = seconds)]
    pub(super) seconds: Option<f64>,
}

#[derive(Args)]
pub(super) struct ObservabilityArgs {
    /// Axis of the body that the sensor turns about; several, by comma, one after the other
    #[arg(long, value_enum, value_delimiter = ',', default_value = "z")]
    pub(super) axis: Vec<Axis>,
    /// Nose up, degrees
    #[arg(long, value_name = "DEG", default_value_t = 0.0, allow_negative_numbers = true)]
    pub(super) pitch: f64,
    /// Right side down, degrees
    #[arg(long, value_name = "DEG", default_value_t = 0.0, allow_negative_numbers = true)]
    pub(super) roll: f64,
    /// Clockwise from north, degrees
    #[arg(long, value_name = "DEG", default_value_t = 0.0, allow_negative_numbers = true)]
    pub(super) heading: f64,
    /// Rate of turning, °/s
    #[arg(long, value_name = "DPS", default_value_t = 10.0, allow_negative_numbers = true)]
    pub(super) rate_dps: f64,
    /// Time about each axis, s; matters where there are several
    #[arg(long, value_name = "S", default_value_t = 36.0, allow_negative_numbers = true, value_parser = seconds)]
    pub(super) seconds: f64,
    /// Geodetic latitude, degrees
    #[arg(long, value_name = "L", default_value_t = 40.0, allow_negative_numbers = true)]
    pub(super) latitude_deg: f64,
    /// Acceleration east, m/s², during the last of the axes
    #[arg(long, value_name = "A", default_value_t = 0.0, allow_negative_numbers = true)]
    pub(super) accel_east: f64,
    /// Acceleration north, m/s², likewise
    #[arg(long, value_name = "A", default_value_t = 0.0, allow_negative_numbers = true)]
    pub(super) accel_north: f64,
    /// Print the result as JSON
    #[arg(long)]
    pub(super) json: bool,
}

#[derive(Args)]
pub(super) struct AllanArgs {
    #[command(flatten)]
    pub(super) input: LogArgs,
    /// Write the figures as a UNIT.toml for `replay`
    #[arg(long, value_name = "UNIT.toml")]
    pub(super) unit: Option<PathBuf>,
    /// Write the plot, as SVG
    #[arg(long, value_name = "FILE", default_value = "report/allan.svg")]
    pub(super) plot: PathBuf,
    /// Print the result as JSON
    #[arg(long)]
    pub(super) json: bool,
}

#[derive(Args)]
pub(super) struct CalibrateArgs {
    #[command(flatten)]
    pub(super) input: LogArgs,
    /// The IMU: a part or a file with its figures, as for `replay` (default: that of the main paper, Table 2)
    #[arg(long, value_name = "PART|FILE")]
    pub(super) unit: Option<String>,
    /// Latitude of the place, degrees: with the heading, takes Earth's rate out of the biases of a level unit
    #[arg(long, value_name = "L", allow_negative_numbers = true, requires = "heading_deg")]
    pub(super) latitude_deg: Option<f64>,
    /// Heading of the housing, degrees clockwise from north
    #[arg(long, value_name = "H", allow_negative_numbers = true, requires = "latitude_deg")]
    pub(super) heading_deg: Option<f64>,
    /// Least time at rest, s
    #[arg(long, value_name = "S", default_value_t = 60.0, allow_negative_numbers = true, value_parser = seconds)]
    pub(super) rest_s: f64,
    /// Write the log with its gyros corrected
    #[arg(long, value_name = "FILE")]
    pub(super) corrected: Option<PathBuf>,
    /// Print the result as JSON
    #[arg(long)]
    pub(super) json: bool,
}

#[derive(Args)]
pub(super) struct TurnArgs {
    #[command(flatten)]
    pub(super) input: LogArgs,
    /// Rate of the rotor, °/s
    #[arg(long, value_name = "DPS", default_value_t = 20.0, value_parser = positive)]
    pub(super) rate: f64,
    /// Angle from one turning point to the other, degrees
    #[arg(long, value_name = "DEG", default_value_t = 360.0, value_parser = positive)]
    pub(super) travel: f64,
    /// Acceleration at the turning points, degrees/s²
    #[arg(long, value_name = "A", default_value_t = 200.0, value_parser = positive)]
    pub(super) acceleration: f64,
    /// CSV to write
    #[arg(long, short, value_name = "FILE")]
    pub(super) out: PathBuf,
}

#[derive(Args)]
pub(super) struct ReproduceArgs {
    /// What to reproduce: a name, or a paper's short name for all of the paper (without any: lists them)
    #[arg(value_name = "NAME", conflicts_with = "all")]
    pub(super) names: Vec<String>,
    /// Everything
    #[arg(long)]
    pub(super) all: bool,
    /// Seed of every chance: the same one gives the same run, to the bit
    #[arg(long, value_name = "N", default_value_t = 1)]
    pub(super) seed: u64,
    /// Folder for the page, plots and curves
    #[arg(
        long,
        visible_alias = "report",
        value_name = "DIR",
        default_value = "report/reproduce"
    )]
    pub(super) out: PathBuf,
    /// Print the results as JSON
    #[arg(long)]
    pub(super) json: bool,
}

#[derive(Args)]
pub(super) struct InspectArgs {
    /// Raw stream of defmt, or output of probe-rs, defmt-print (also --json), `cargo emulate`, `hal-sim unit`; `-` is standard input
    pub(super) log: PathBuf,
    /// The image that wrote the stream of defmt
    #[arg(long, value_name = "ELF")]
    pub(super) elf: Option<PathBuf>,
    /// Write the estimates as CSV
    #[arg(long, value_name = "FILE")]
    pub(super) csv: Option<PathBuf>,
    /// Write the chart, as SVG
    #[arg(long, value_name = "FILE")]
    pub(super) svg: Option<PathBuf>,
    /// Print the timeline as JSON
    #[arg(long)]
    pub(super) json: bool,
    /// Show the log while it is written; a file is waited for until this is interrupted
    #[arg(long, conflicts_with = "json")]
    pub(super) follow: bool,
}

/// Zero is an exact encoder.
fn arcsec(text: &str) -> Result<f64, String> {
    text.parse()
        .ok()
        .filter(|sd| (0.0..=3600.0).contains(sd))
        .ok_or_else(|| "expected a number of 0 to 3600".to_owned())
}

/// Within what a sleeping thread can keep and a machine can simulate.
fn speed(text: &str) -> Result<f64, String> {
    let speed = text.parse().ok().filter(|speed| (0.01..=1000.0).contains(speed));
    speed.ok_or_else(|| "expected a number from 0.01 to 1000".to_owned())
}

fn hours(text: &str) -> Result<f64, String> {
    let hours = text.parse().ok().filter(|hours| (0.1..=10_000.0).contains(hours));
    hours.ok_or_else(|| "expected hours from 0.1 to 10000".to_owned())
}

fn positive(text: &str) -> Result<f64, String> {
    let number = text.parse().ok().filter(|number| (0.001..=1e6).contains(number));
    number.ok_or_else(|| "expected a number above 0".to_owned())
}

fn seconds(text: &str) -> Result<f64, String> {
    let seconds = text.parse().ok().filter(|seconds| (0.001..=1e9).contains(seconds));
    seconds.ok_or_else(|| "expected seconds above 0".to_owned())
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
        for line in help::ALL
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
