//! `allan` and `calibrate` as users meet them.
#![allow(clippy::unwrap_used, reason = "a test stops at the first surprise")]

#[path = "common/command.rs"]
mod command;

use std::fs;

use hal_sim::unit::Unit;
use tempfile::TempDir;

use command::hal_sim;

/// A unit at rest for 20 minutes is simulated, logged and analysed: its own figures come back in a UNIT.toml.
#[test]
fn a_unit_at_rest_shows_its_noise() {
    let dir = TempDir::new().unwrap();
    let scenario = "[run]\nduration_s = 1200\nrate_hz = 20\n[rotor]\nrate_dps = 0\n[imu]\n\
                    angle_random_walk_deg_sqrt_h = 0.3\nvelocity_random_walk_ug_sqrt_hz = 50\n";
    fs::write(dir.path().join("rest.toml"), scenario).unwrap();
    hal_sim(dir.path(), &["-q", "run", "-s", "rest.toml", "--log", "rest.csv"]);
    let output = hal_sim(
        dir.path(),
        &["allan", "rest.csv", "--unit", "UNIT.toml", "--plot", "allan.svg"],
    );
    assert_eq!(output.status.code(), Some(0), "{output:?}");
    assert!(String::from_utf8(output.stdout).unwrap().contains("gyro x"));
    let unit = Unit::load(&dir.path().join("UNIT.toml")).unwrap();
    assert!((unit.angle_random_walk_deg_sqrt_h / 0.3 - 1.0).abs() < 0.03, "{unit:?}");
    assert!(
        (unit.velocity_random_walk_ug_sqrt_hz / 50.0 - 1.0).abs() < 0.03,
        "{unit:?}"
    );
    assert!(
        fs::read_to_string(dir.path().join("allan.svg"))
            .unwrap()
            .contains("<svg")
    );

    let output = hal_sim(dir.path(), &["calibrate", "rest.csv"]);
    assert_eq!(output.status.code(), Some(2));
    let message = String::from_utf8(output.stderr).unwrap();
    assert!(
        message.starts_with("error: rest.csv: the rotor never turned"),
        "{message}"
    );
}
