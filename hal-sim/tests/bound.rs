//! `bound` as users meet it: table, files, JSON, what is refused.
#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    reason = "a test stops at the first surprise"
)]

#[path = "common/command.rs"]
mod command;

use std::fs;

use serde_json::Value;
use tempfile::TempDir;

use command::hal_sim;

#[test]
fn the_table_its_limits_and_its_files() {
    let dir = TempDir::new().unwrap();
    fs::write(
        dir.path().join("own.toml"),
        "[imu]\ngyro_scale_factor_sd_ppm = 300\n[errors]\ngyro_quantum = 1e-7\n",
    )
    .unwrap();
    let arguments = [
        "bound",
        "--scenario",
        "own.toml",
        "--seed",
        "4",
        "--duration",
        "60",
        "--out",
        "here",
    ];
    let output = hal_sim(dir.path(), &arguments);
    assert_eq!(output.status.code(), Some(0), "{output:?}");
    let table = String::from_utf8(output.stdout).unwrap();
    assert!(
        table.starts_with("own, seed 4: σ of the ideal filter, 21 states"),
        "{table}"
    );
    let times: Vec<_> = table
        .lines()
        .skip(2)
        .map_while(|line| line.split_whitespace().next()?.parse::<f64>().ok())
        .collect();
    assert_eq!(times, [10.0, 20.0, 50.0, 60.0]);
    assert!(table.contains("quantum of the gyros"), "{table}");
    assert!(
        !table.contains("quantum of the accels"),
        "what there is not is left out: {table}"
    );
    let report = dir.path().join("here/own-bound-seed4");
    let csv = fs::read_to_string(report.join("sigma.csv")).unwrap();
    assert_eq!(csv.lines().count(), 61);
    assert!(csv.lines().next().unwrap().ends_with(",gyro_matrix_zz_sd_ppm"), "{csv}");
    let widths: Vec<_> = csv.lines().map(|line| line.split(',').count()).collect();
    assert!(widths.iter().all(|width| *width == 22), "{widths:?}");
    let plot = fs::read_to_string(report.join("heading.svg")).unwrap();
    assert!(
        plot.contains("ideal filter") && plot.contains("angle random walk alone"),
        "{plot}"
    );
    assert!(report.join("result.json").exists());
}

#[test]
fn json_has_the_paper_simulations_bound() {
    let dir = TempDir::new().unwrap();
    let output = hal_sim(dir.path(), &["bound", "--json"]);
    let json: Value = serde_json::from_slice(&output.stdout).unwrap();
    let heading = json.pointer("/end/sd/heading_deg").and_then(Value::as_f64).unwrap();
    assert!((heading / 0.352 - 1.0).abs() < 0.01, "{heading}");
    assert_eq!(json["rows"].as_array().unwrap().last(), Some(&json["end"]));
    // A base known to rest ten times less well costs a fifth.
    let output = hal_sim(dir.path(), &["bound", "--json", "--velocity-sd", "1e-3"]);
    let json: Value = serde_json::from_slice(&output.stdout).unwrap();
    let loose = json.pointer("/end/sd/heading_deg").and_then(Value::as_f64).unwrap();
    assert!(loose > 1.15 * heading && loose < 1.25 * heading, "{loose}");
}

#[test]
fn a_perfect_unit_has_a_bound_and_a_plot() {
    let dir = TempDir::new().unwrap();
    fs::write(dir.path().join("perfect.toml"), "").unwrap();
    let output = hal_sim(dir.path(), &["bound", "--scenario", "perfect.toml", "--seconds", "30"]);
    assert_eq!(output.status.code(), Some(0), "{output:?}");
    let table = String::from_utf8(output.stdout).unwrap();
    assert!(
        !table.contains("NaN") && !table.contains("velocity random walk"),
        "{table}"
    );
}

#[test]
fn what_is_not_positive_is_refused() {
    let dir = TempDir::new().unwrap();
    for value in ["-0.1", "0", "nan"] {
        let output = hal_sim(dir.path(), &["bound", "--velocity-sd", value]);
        assert_eq!(output.status.code(), Some(2), "{output:?}");
        let said = String::from_utf8(output.stderr).unwrap();
        assert!(
            said.starts_with("error: velocity_sd: ") && said.contains("must be positive"),
            "{said}"
        );
        assert!(output.stdout.is_empty() && !dir.path().join("report").exists());
    }
}
