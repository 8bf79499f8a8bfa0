//! The README shows what the program prints today.
#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    reason = "a test stops at the first surprise"
)]

use hal_sim::align::Method;
use hal_sim::bound::{self, BoundConfig};
use hal_sim::monte_carlo::{self, Statistics};
use hal_sim::scenario::Scenario;

/// The cells of the table row that starts with `name`, as the README has them.
fn row(name: &str) -> Vec<String> {
    let readme = include_str!("../../README.md");
    let line = readme
        .lines()
        .find(|line| line.starts_with(&format!("| {name} |")))
        .expect(name);
    line.trim_matches('|')
        .split('|')
        .skip(1)
        .map(|cell| cell.trim().to_owned())
        .collect()
}

#[test]
fn the_table_is_what_the_command_prints() {
    let scenario = Scenario::builtin("paper-sim").unwrap();
    let report = monte_carlo::run(&scenario, 200, 1, &[Method::Robust], || ()).unwrap();
    let cells = |s: &Statistics| {
        vec![
            format!("{:.3}°", s.heading.rms_deg),
            format!("{:.3}°", s.heading.mean_deg),
            format!("{:.3}°", s.heading.predicted_sd_deg),
            format!("{:.2}", s.heading.nees),
            format!("{:.4}°", s.pitch.rms_deg),
            format!("{:.4}°", s.roll.rms_deg),
        ]
    };
    assert_eq!(row("coarse alignment alone"), cells(&report.coarse.unwrap()));
    assert_eq!(row("fine alignment"), cells(&report.fine.unwrap()));
}

#[test]
fn the_ideal_filter_is_what_bound_prints() {
    let scenario = Scenario::builtin("paper-sim").unwrap();
    let bound = bound::run(&scenario, 1, &BoundConfig::default()).unwrap();
    let said = format!("has a σ of {:.3}° in this scenario", bound.end.sd.heading_deg);
    assert!(include_str!("../../README.md").contains(&said), "{said}");
}
