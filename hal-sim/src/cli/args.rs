//! Arguments that several commands share.

use std::path::{Path, PathBuf};

use clap::Args;
use hal_sim::config::ConfigProblem;
use hal_sim::log::format::{EncoderUnit, Mounting};
use hal_sim::scenario::Scenario;
use hal_sim::unit::Unit;

use super::output::words;

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

pub(super) fn scenario(simulated: &Simulated) -> Result<Scenario, String> {
    let name = simulated.scenario.as_str();
    let builtin = Scenario::builtin_names().any(|builtin| builtin == name);
    let file = Path::new(name);
    let mut scenario = if !builtin && (file.exists() || file.extension().is_some_and(|e| e == "toml")) {
        Scenario::load(file).map_err(|e| match e.problem {
            ConfigProblem::Read(_) => format!("{e}; `hal-sim scenarios paper-sim > {name}` writes one to begin with"),
            _ => e.to_string(),
        })
    } else {
        Scenario::builtin(name).map_err(words)
    }?;
    if let Some(unit) = &simulated.unit {
        scenario.imu = Unit::find(unit).map_err(words)?;
        scenario.told = None;
    }
    if let Some(seconds) = simulated.seconds {
        scenario.run.duration_s = seconds;
        scenario.validate().map_err(|e| format!("--seconds: {e}"))?;
    }
    Ok(scenario)
}

/// The same, with the encoder constraint of the command line.
pub(super) fn scenario_on(base: &Base, simulated: &Simulated) -> Result<Scenario, String> {
    let mut scenario = scenario(simulated)?;
    let told = &mut scenario.encoder.constraint_sd_arcsec;
    *told = base.encoder_constraint.or(*told);
    Ok(scenario)
}

/// Zero is an exact encoder.
fn arcsec(text: &str) -> Result<f64, String> {
    text.parse()
        .ok()
        .filter(|sd| (0.0..=3600.0).contains(sd))
        .ok_or_else(|| "expected a number of 0 to 3600".to_owned())
}

pub(super) fn positive(text: &str) -> Result<f64, String> {
    let number = text.parse().ok().filter(|number| (0.001..=1e6).contains(number));
    number.ok_or_else(|| "expected a number above 0".to_owned())
}

pub(super) fn seconds(text: &str) -> Result<f64, String> {
    let seconds = text.parse().ok().filter(|seconds| (0.001..=1e9).contains(seconds));
    seconds.ok_or_else(|| "expected seconds above 0".to_owned())
}
