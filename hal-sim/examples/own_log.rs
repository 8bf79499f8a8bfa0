//! A recording in somebody else's columns and units, brought into a log that `replay` reads, and replayed.
//!
//! Here they are milliseconds, °/s, g and degrees; change [`Theirs`] and [`convert`] to yours. Two things must be right:
//! a row holds *means* over the interval that ends at its time, and the encoder is read at its end. A millisecond between
//! gyro and encoder is 0.02° of heading at 20 °/s, and changes its sign with the rotor's direction.
//!
//! ```text
//! cargo run --release --example own_log -- RECORDING.csv LATITUDE_DEG
//! ```
//!
//! Without arguments it records one from the simulator first.

use std::fs::File;
use std::io::{BufWriter, Write as _};
use std::path::Path;

use frames::Vec3;
use frames::units::{DEG, STANDARD_GRAVITY};
use hal_sim::align::{Method, Setup, describe};
use hal_sim::log::{LogRow, LogWriter};
use hal_sim::replay::{self, Observer};
use hal_sim::scenario::Scenario;
use hal_sim::simulate::Simulation;
use nav::aligner::Event;

/// A row of the recording: time, ms; rates about x, y, z, °/s; specific forces, g; angle of the rotor, degrees.
type Theirs = (f64, [f64; 3], [f64; 3], f64);

/// Into SI and radians, and the columns of `replay`.
fn convert(from: &Path, to: &Path) -> Result<(), Box<dyn core::error::Error>> {
    let mut log = LogWriter::create(to, false)?;
    let mut before = None;
    for row in csv::Reader::from_path(from)?.deserialize() {
        let (time_ms, gyro_dps, accel_g, rotor_deg): Theirs = row?;
        let t_s = time_ms * 1e-3;
        // The first row has no interval; any will do, for the log has rates again.
        let dt_s = t_s - before.replace(t_s).unwrap_or(t_s - 0.01);
        let [wx, wy, wz] = gyro_dps.map(|rate| rate * DEG);
        let [fx, fy, fz] = accel_g.map(|force| force * STANDARD_GRAVITY);
        let (turn, speed) = (Vec3::new(wx, wy, wz) * dt_s, Vec3::new(fx, fy, fz) * dt_s);
        log.write(t_s, dt_s, turn, speed, rotor_deg * DEG, None)?;
    }
    log.finish()?;
    Ok(())
}

/// Prints what the aligner tells.
#[derive(Default)]
struct Printer {
    t_s: f64,
}

impl Observer for Printer {
    fn row(&mut self, row: &LogRow) {
        self.t_s = row.t_s;
    }
    fn event(&mut self, t: f64, event: &Event<f32>) {
        println!("{t:8.2} s  {}", describe(event));
    }
}

fn main() -> Result<(), Box<dyn core::error::Error>> {
    let scenario = Scenario::builtin("paper-sim")?;
    let folder = std::env::temp_dir();
    let mut arguments = std::env::args().skip(1);
    let (recording, latitude_deg) = match (arguments.next(), arguments.next()) {
        (Some(path), Some(latitude)) => (path.into(), latitude.parse()?),
        _ => (record(&scenario, &folder)?, scenario.place.latitude_deg),
    };
    let log = folder.join("own_log-si.csv");
    convert(&recording, &log)?;

    // What the unit is told: the place, the rotor, and the figures of the IMU. The paper's here; yours are in a UNIT.toml.
    let setup = Setup {
        latitude_deg,
        ..Setup::of(&scenario, Method::Robust)
    };
    let mut printer = Printer::default();
    let found = replay::replay(&log, &setup, &mut printer)?;
    println!("{:8.2} s  {}", printer.t_s, found.state);
    match (found.heading_deg, found.heading_sd_deg) {
        (Some(heading), Some(sd)) => println!("heading {heading:.2}°, 1σ {sd:.2}°"),
        _ => println!("no heading: {}", found.reason.unwrap_or_default()),
    }
    Ok(())
}

/// A recording as another unit might make it.
fn record(scenario: &Scenario, folder: &Path) -> Result<std::path::PathBuf, Box<dyn core::error::Error>> {
    let path = folder.join("own_log-recording.csv");
    let mut out = BufWriter::new(File::create(&path)?);
    writeln!(out, "time_ms,gx_dps,gy_dps,gz_dps,ax_g,ay_g,az_g,rotor_deg")?;
    let simulation = Simulation::new(scenario, 1)?;
    println!(
        "true heading at the end {:.2}°",
        simulation.truth().attitude(scenario.run.duration_s).heading / DEG
    );
    for row in simulation {
        let [wx, wy, wz] = (row.sample.dtheta_s / (row.sample.dt * DEG)).to_array();
        let [fx, fy, fz] = (row.sample.dv_s / (row.sample.dt * STANDARD_GRAVITY)).to_array();
        let (t_ms, rotor) = (row.t * 1e3, row.encoder / DEG);
        writeln!(out, "{t_ms},{wx:.9},{wy:.9},{wz:.9},{fx:.9},{fy:.9},{fz:.9},{rotor:.6}")?;
    }
    out.flush()?;
    Ok(path)
}
