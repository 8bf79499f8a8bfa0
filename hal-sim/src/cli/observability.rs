//! Tells which errors of a resting, turning IMU are observable.

use std::process::ExitCode;

use clap::Args;
use hal_sim::observability::{self, Attitude, Axis, Segment};
use hal_sim::outcome::tagged;

use super::args::seconds;
use super::output::{Done, print, print_json, words};
use super::table;

pub(super) const HELP: &str = "\
Prints the rank, the singular values, and which errors or sums of errors are seen. Writes no file.

Examples:
  hal-sim observability --axis z --pitch 5
  hal-sim observability --axis z,x --rate-dps 20 --seconds 18";

#[derive(Args)]
pub(super) struct ObservabilityArgs {
    /// Axis of the body that the sensor turns about; several, by comma, one after the other
    #[arg(long, value_enum, value_delimiter = ',', default_value = "z")]
    axis: Vec<Axis>,
    /// Nose up, degrees
    #[arg(long, value_name = "DEG", default_value_t = 0.0, allow_negative_numbers = true)]
    pitch: f64,
    /// Right side down, degrees
    #[arg(long, value_name = "DEG", default_value_t = 0.0, allow_negative_numbers = true)]
    roll: f64,
    /// Clockwise from north, degrees
    #[arg(long, value_name = "DEG", default_value_t = 0.0, allow_negative_numbers = true)]
    heading: f64,
    /// Rate of turning, °/s
    #[arg(long, value_name = "DPS", default_value_t = 10.0, allow_negative_numbers = true)]
    rate_dps: f64,
    /// Time about each axis, s; matters where there are several
    #[arg(long, value_name = "S", default_value_t = 36.0, allow_negative_numbers = true, value_parser = seconds)]
    seconds: f64,
    /// Geodetic latitude, degrees
    #[arg(long, value_name = "L", default_value_t = 40.0, allow_negative_numbers = true)]
    latitude_deg: f64,
    /// Acceleration east, m/s², during the last of the axes
    #[arg(long, value_name = "A", default_value_t = 0.0, allow_negative_numbers = true)]
    accel_east: f64,
    /// Acceleration north, m/s², likewise
    #[arg(long, value_name = "A", default_value_t = 0.0, allow_negative_numbers = true)]
    accel_north: f64,
    /// Print the result as JSON
    #[arg(long)]
    json: bool,
}

pub(super) fn run(args: &ObservabilityArgs) -> Done {
    let radians = frames::units::DEG;
    let attitude = Attitude {
        heading: args.heading * radians,
        pitch: args.pitch * radians,
        roll: args.roll * radians,
    };
    let last = args.axis.len().saturating_sub(1);
    let segments: Vec<_> = args
        .axis
        .iter()
        .enumerate()
        .map(|(k, axis)| Segment {
            axis: *axis,
            rate: args.rate_dps * radians,
            seconds: args.seconds,
            acceleration: if k == last {
                [args.accel_east, args.accel_north]
            } else {
                [0.0; 2]
            },
        })
        .collect();
    let found = observability::Report::of(&attitude, args.latitude_deg * radians, &segments).map_err(words)?;
    if args.json {
        print_json(&tagged("observability", &found))?;
    } else {
        print(&table::observability(&found))?;
    }
    Ok(ExitCode::SUCCESS)
}
