//! How the rotor may turn: schedules against scenarios, each with what the unit's filter makes of it and the ideal one.
//!
//! Every schedule has the same runs: seeds, noise and phases of the motion. The table of the guide's chapter on tuning is
//! that of 16 runs and seed 1.
//!
//! ```text
//! cargo run --release --example rotor_schedules -- 16 1
//! ```

use hal_sim::align::Method;
use hal_sim::monte_carlo;
use hal_sim::scenario::{Leg, Rotor, Scenario};

/// A cycle of the default schedule, s: there and back over a turn at 20 °/s, reversing at 200 °/s².
const CYCLE_S: f64 = 36.2;

/// A schedule by name.
fn schedules() -> [(&'static str, Rotor); 6] {
    let legs = |legs: &[(f64, f64, f64)]| Rotor {
        legs: legs
            .iter()
            .map(|&(to_deg, rate_dps, dwell_s)| Leg {
                to_deg,
                rate_dps: Some(rate_dps),
                dwell_s,
            })
            .collect(),
        ..Rotor::default()
    };
    [
        ("a turn there and back", Rotor::default()),
        (
            "a turn to either side",
            legs(&[(360.0, 20.0, 0.0), (-360.0, 20.0, 0.0), (0.0, 20.0, 0.0)]),
        ),
        (
            "unequal legs: 1, ½, ½, 1 turn",
            legs(&[
                (360.0, 20.0, 0.0),
                (180.0, 20.0, 0.0),
                (360.0, 20.0, 0.0),
                (0.0, 20.0, 0.0),
            ]),
        ),
        (
            "15 and 25 °/s in turn",
            legs(&[
                (360.0, 15.0, 0.0),
                (0.0, 15.0, 0.0),
                (360.0, 25.0, 0.0),
                (0.0, 25.0, 0.0),
            ]),
        ),
        ("3 s of rest at the ends", legs(&[(360.0, 20.0, 3.0), (0.0, 20.0, 3.0)])),
        (
            "rates drawn within ±25 %",
            Rotor {
                rate_spread: 0.25,
                ..Rotor::default()
            },
        ),
    ]
}

/// The scenarios: `moored` also with a pitch that goes in step with the fifth harmonic of the default schedule.
fn scenarios() -> Result<Vec<Scenario>, Box<dyn core::error::Error>> {
    let mut in_step = Scenario::builtin("moored")?;
    in_step.name = format!("moored, pitch of {} s", CYCLE_S / 5.0);
    in_step.swing.pitch.period_s = CYCLE_S / 5.0;
    Ok(vec![
        Scenario::builtin("paper-sim")?,
        Scenario::builtin("moored")?,
        in_step,
        Scenario::builtin("moored-irregular")?,
    ])
}

fn main() -> Result<(), Box<dyn core::error::Error>> {
    let mut arguments = std::env::args().skip(1);
    let mut argument = |default: u64| arguments.next().map_or(Ok(default), |text| text.parse());
    let (runs, seed) = (argument(16)?, argument(1)?);
    for scenario in scenarios()? {
        println!(
            "{}, {} runs of {} s, seed {}",
            scenario.name, runs, scenario.run.duration_s, seed
        );
        println!("| schedule | heading RMS | predicted σ | (error/σ)² | ideal filter | aligned |");
        println!("|---|---|---|---|---|---|");
        for (name, rotor) in schedules() {
            let scenario = Scenario {
                rotor,
                ..scenario.clone()
            };
            scenario.validate()?;
            let report = monte_carlo::run(&scenario, runs, seed, &[Method::Robust], || ())?;
            let unit = &report.by_method[0];
            let heading = unit.all.as_ref().ok_or("no run came to an estimate")?.heading;
            println!(
                "| {name} | {:.2}° | {:.2}° | {:.2} | {:.2}° | {} |",
                heading.rms_deg, heading.predicted_sd_deg, heading.nees, report.bound_deg, unit.aligned
            );
        }
        println!();
    }
    Ok(())
}
