//! A scenario in code: a survey boat at a quay, with an IMU of another class, and what it can know at the best.
//!
//! A file says the same (`scenarios paper-sim` prints one to begin with); code is for sweeps, as over the rotor's rate here.
//!
//! ```text
//! cargo run --release --example custom_scenario
//! ```

use hal_sim::align::Method;
use hal_sim::bound::{self, BoundConfig};
use hal_sim::config::Angle;
use hal_sim::monte_carlo;
use hal_sim::scenario::{Axis, Place, Run, Scenario, Sway, SwayAxis, Swing};
use hal_sim::unit::Unit;

fn quay(rate_dps: f64) -> Scenario {
    let swing = |amplitude_deg, period_s| Axis {
        amplitude_deg,
        period_s,
        ..Axis::default()
    };
    let sway = |amplitude_m, period_s| SwayAxis {
        amplitude_m,
        period_s,
        ..SwayAxis::default()
    };
    let mut scenario = Scenario {
        name: format!("quay at {rate_dps} °/s"),
        place: Place {
            latitude_deg: 54.0,
            ..Place::default()
        },
        run: Run {
            duration_s: 600.0,
            ..Run::default()
        },
        swing: Swing {
            pitch: swing(1.0, 4.0),
            roll: swing(3.0, 5.0),
            heading: Axis {
                centre_deg: Angle::Degrees(210.0),
                ..swing(1.5, 20.0)
            },
        },
        sway: Sway {
            east: sway(0.1, 7.0),
            north: sway(0.1, 9.0),
            up: sway(0.05, 4.0),
        },
        lever_arm_m: [0.5, 2.0, 1.0],
        imu: Unit {
            angle_random_walk_deg_sqrt_h: 0.03,
            gyro_instability_deg_h: 0.5,
            gyro_scale_factor_sd_ppm: 200.0,
            gyro_misalignment_sd_arcmin: 1.0,
            ..Unit::default()
        },
        ..Scenario::default()
    };
    scenario.rotor.rate_dps = rate_dps;
    scenario
}

fn main() -> Result<(), Box<dyn core::error::Error>> {
    println!("rotor    ideal filter   heading RMS   predicted σ   (error/σ)²   aligned at the end of 10 min");
    for rate_dps in [5.0, 10.0, 20.0] {
        let scenario = quay(rate_dps);
        scenario.validate()?;
        let ideal = bound::run(&scenario, 1, &BoundConfig::default())?.end.sd.heading_deg;
        let report = monte_carlo::run(&scenario, 16, 1, &[Method::Robust], || ())?;
        let unit = &report.by_method[0];
        let heading = unit.all.as_ref().ok_or("no run came to an estimate")?.heading;
        println!(
            "{rate_dps:2} °/s {ideal:13.3}° {:12.3}° {:12.3}° {:12.2}   {} of {}",
            heading.rms_deg, heading.predicted_sd_deg, heading.nees, unit.aligned, report.runs
        );
    }
    Ok(())
}
