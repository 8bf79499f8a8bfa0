//! `reproduce` and `observability` as users meet them: tables, JSON, plots, exit codes.
#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    reason = "a test stops at the first surprise"
)]

#[path = "common/command.rs"]
mod command;

use std::process::Output;

use serde_json::Value;
use tempfile::TempDir;

use command::hal_sim;

fn json(output: &Output) -> Value {
    assert_eq!(output.status.code(), Some(0), "{output:?}");
    serde_json::from_slice(&output.stdout).unwrap_or_else(|e| panic!("{e}: {output:?}"))
}

fn text(output: &Output) -> String {
    assert_eq!(output.status.code(), Some(0), "{output:?}");
    String::from_utf8(output.stdout.clone()).unwrap()
}

#[test]
fn ranks_of_the_paper_by_command() {
    let dir = TempDir::new().unwrap();
    for (arguments, rank) in [
        ("--axis none", 8),
        ("--axis x --pitch 20 --heading 30", 10),
        ("--axis x --roll -20 --heading 30", 11),
        ("--axis y", 10),
        ("--axis y --pitch 5 --rate-dps -40", 11),
        ("--axis z", 8),
        ("--axis z --pitch 0.1", 11),
        ("--axis y,y --pitch 5 --accel-north 1", 12),
    ] {
        let mut all = vec!["observability", "--json"];
        all.extend(arguments.split(' '));
        let found = json(&hal_sim(dir.path(), &all));
        assert_eq!(found["rank"], rank, "{arguments}: {found}");
        assert_eq!(found["observable"].as_array().unwrap().len(), rank, "{arguments}");
        assert_eq!(found["singular_values"].as_array().unwrap().len(), 12);
        assert!(found["smallest_counted"].as_f64() > found["largest_neglected"].as_f64().map(|x| 1e6 * x));
    }
    let table = text(&hal_sim(dir.path(), &["observability", "--axis", "y", "--pitch", "20"]));
    assert!(table.starts_with("rank 11 of 12\n"), "{table}");
    assert!(table.contains("  ε_U   unobservable\n"), "{table}");
}

#[test]
fn impossible_observability_is_an_error() {
    let dir = TempDir::new().unwrap();
    for arguments in [
        ["observability", "--latitude-deg", "89"],
        ["observability", "--rate-dps", "0"],
        ["observability", "--seconds", "0"],
    ] {
        let output = hal_sim(dir.path(), &arguments);
        assert_eq!(output.status.code(), Some(2), "{output:?}");
        assert!(output.stdout.is_empty());
    }
}

#[test]
fn one_paper_is_reproduced_with_its_plots() {
    let dir = TempDir::new().unwrap();
    let reports = json(&hal_sim(
        dir.path(),
        &[
            "--quiet",
            "reproduce",
            "du17-observability",
            "yu15-curves",
            "--json",
            "--out",
            "out",
        ],
    ));
    let reports = reports.as_array().unwrap();
    assert_eq!(reports.len(), 2);
    assert_eq!(reports[0]["name"], "du17-observability");
    let rank = &reports[0]["rows"][0];
    assert_eq!(rank["published"], 8.0);
    assert_eq!(rank["ours"], 8.0);
    assert_eq!(rank["verdict"], "agrees");
    for report in reports {
        for file in report["files"].as_array().unwrap() {
            let path = dir.path().join(file.as_str().unwrap());
            assert!(std::fs::metadata(&path).unwrap().len() > 100, "{}", path.display());
        }
    }
    // Figures 2 to 11, each with its numbers.
    assert_eq!(reports[1]["files"].as_array().unwrap().len(), 20);
}

#[test]
fn names_are_listed_and_unknown_ones_refused() {
    let dir = TempDir::new().unwrap();
    let list = text(&hal_sim(dir.path(), &["reproduce"]));
    for name in [
        "du17-observability",
        "du17-zupt",
        "xing18-simulation",
        "xing18-turntable",
        "xing18-allan",
        "xing18-irregularity",
        "xing18-choices",
        "yu15-closed-forms",
        "yu15-north-finding",
    ] {
        assert!(list.lines().any(|line| line.starts_with(name)), "{list}");
    }
    let output = hal_sim(dir.path(), &["reproduce", "nobody99"]);
    assert_eq!(output.status.code(), Some(2));
    let message = String::from_utf8(output.stderr).unwrap();
    assert!(
        message.contains("nobody99") && message.contains("du17-zupt"),
        "{message}"
    );
}
