//! The aligner as a library: `nav` and `frames` are all that it takes.
//!
//! The ten lines of `main` are what a program of your own needs. `hal_sim` only stands in for the IMU and the encoder.
//!
//! ```text
//! cargo run --release --example aligner
//! ```

use frames::units::DEG;
use nav::aligner::{Aligner, AlignerConfig};
use nav::fine::FilterConfig;
use nav::increment::Sample;
use nav::rotor::RotorConfig;

fn main() -> Result<(), Box<dyn core::error::Error>> {
    // Latitude and height of the place, what the rotor does, what the IMU is like: here the main paper's.
    let latitude = (40.0 * DEG) as f32;
    let config = AlignerConfig::for_rotor(latitude, 0.0, &RotorConfig::default(), FilterConfig::default());
    let mut aligner: Aligner = Aligner::new(config)?;
    for (sample, rotor_angle) in samples()? {
        if let Some(event) = aligner.step(&sample, rotor_angle) {
            println!("{event:?}");
        }
    }
    let estimate = aligner.estimate().ok_or("no estimate yet")?;
    let (heading, sd) = (estimate.attitude.heading, estimate.sd.heading);
    println!("heading {:.2}°, 1σ {:.2}°", heading / DEG as f32, sd / DEG as f32);
    Ok(())
}

/// Five minutes on a swinging base: what the IMU turned and gained in speed over each 10 ms, and the rotor's angle at
/// their end.
fn samples() -> Result<impl Iterator<Item = (Sample, f32)>, Box<dyn core::error::Error>> {
    let scenario = hal_sim::scenario::Scenario::builtin("paper-sim")?;
    let simulation = hal_sim::simulate::Simulation::new(&scenario, 1)?;
    let end = simulation.truth().attitude(scenario.run.duration_s);
    println!("true heading at the end {:.2}°", end.heading / DEG);
    Ok(simulation.map(|row| (hal_sim::align::cast(&row.sample), row.encoder as f32)))
}
