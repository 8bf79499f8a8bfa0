//! The command as users meet it: results, files, messages, exit codes.
#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    reason = "a test stops at the first surprise"
)]

#[path = "common/command.rs"]
mod command;

use std::fs;
use std::process::{Command, Output};

use serde_json::Value;
use tempfile::TempDir;

use command::hal_sim;

fn json(output: &Output) -> Value {
    serde_json::from_slice(&output.stdout).unwrap_or_else(|e| panic!("{e}: {output:?}"))
}

fn number(value: &Value, pointer: &str) -> f64 {
    value
        .pointer(pointer)
        .and_then(Value::as_f64)
        .unwrap_or_else(|| panic!("{pointer} in {value}"))
}

/// The one line of an error, after `error: `.
fn error_line(output: &Output) -> String {
    assert_eq!(output.status.code(), Some(2), "{output:?}");
    assert!(output.stdout.is_empty(), "a broken input gives no result: {output:?}");
    let text = String::from_utf8(output.stderr.clone()).unwrap();
    let lines: Vec<_> = text.lines().filter(|line| line.starts_with("error: ")).collect();
    assert_eq!(lines.len(), 1, "{text}");
    lines[0].trim_start_matches("error: ").to_owned()
}

#[test]
fn without_arguments_it_runs_the_paper_and_reports() {
    let dir = TempDir::new().unwrap();
    let output = hal_sim(dir.path(), &[]);
    assert_eq!(output.status.code(), Some(0), "{output:?}");
    let table = String::from_utf8(output.stdout).unwrap();
    assert!(table.starts_with("aligned since "), "{table}");
    for row in [
        "heading (°)",
        "pitch (°)",
        "roll (°)",
        "gyro z (°/h)",
        "accel z (µg)",
        "report: ",
    ] {
        assert!(table.contains(row), "{row}: {table}");
    }
    let report = dir.path().join("report/paper-sim-seed1");
    for file in [
        "report.html",
        "result.json",
        "estimates.csv",
        "attitude-error.svg",
        "gyro-bias.svg",
        "rotor.svg",
    ] {
        assert!(fs::metadata(report.join(file)).unwrap().len() > 500, "{file}");
    }
    let phases = String::from_utf8(output.stderr).unwrap();
    assert!(
        phases.contains("coarse alignment: heading") && phases.contains("aligned"),
        "{phases}"
    );
}

#[test]
fn the_same_seed_gives_the_same_bytes() {
    let dir = TempDir::new().unwrap();
    for arguments in [
        &["run", "--seed", "5", "--json", "--seconds", "120"][..],
        &[
            "monte-carlo",
            "--runs",
            "6",
            "--seed",
            "5",
            "--json",
            "--seconds",
            "90",
            "--method",
            "kf,stf",
        ],
    ] {
        let (first, second) = (hal_sim(dir.path(), arguments), hal_sim(dir.path(), arguments));
        assert!(!first.stdout.is_empty(), "{first:?}");
        assert_eq!(first.stdout, second.stdout);
    }
}

/// The keys of `docs/json.md`, of real results: simulated, of the whole unit, and of the log of the first.
#[test]
fn results_have_the_keys_that_the_docs_tell() {
    let docs = fs::read_to_string(concat!(env!("CARGO_MANIFEST_DIR"), "/../docs/json.md")).unwrap();
    let keys: Vec<&str> = docs
        .lines()
        .filter(|line| line.starts_with("| `"))
        .flat_map(|line| line.split('|').nth(1).unwrap().split('`').skip(1).step_by(2))
        .collect();
    assert!(keys.len() == 13 && keys.contains(&"heading_sd_deg"), "{keys:?}");
    let dir = TempDir::new().unwrap();
    let told = |arguments: &[&str]| json(&hal_sim(dir.path(), arguments));
    let run = told(&["run", "--json", "--log", "run.csv", "--quiet"]);
    let unit = told(&["unit", "--json", "--quiet"]);
    let replay = told(&["replay", "run.csv", "--latitude-deg", "40", "--json", "--quiet"]);
    for (name, found) in [("run", &run), ("unit", &unit), ("replay", &replay)] {
        for key in &keys {
            assert!(found.get(key).is_some(), "{name} has no {key}: {found}");
            assert_eq!(found[key].is_null(), *key == "reason", "{name}: {key}");
        }
        assert_eq!(
            found["schema"],
            serde_json::json!({ "name": "alignment", "version": 1 })
        );
        assert_eq!(found["state"], "aligned");
    }
    // The same run, and the same unit some seconds later: heading, σ and biases are alike, and of one time.
    let aligning_s = number(&unit, "/aligning_at_s");
    for (key, alike) in [
        ("heading_deg", 20.0),
        ("heading_sd_deg", 0.01),
        ("pitch_sd_deg", 1e-4),
        ("t_s", 0.1),
        ("aligned_at_s", 3.0),
    ] {
        let pointer = format!("/{key}");
        let begun = if key.ends_with("_s") { aligning_s } else { 0.0 };
        assert!(
            (number(&replay, &pointer) - number(&run, &pointer)).abs() < 1e-4,
            "{key}"
        );
        assert!(
            (number(&unit, &pointer) - begun - number(&run, &pointer)).abs() < alike,
            "{key}"
        );
    }
    for (key, alike) in [("gyro_bias_deg_h", 1.0), ("accel_bias_ug", 5.0)] {
        for axis in 0..3 {
            let pointer = format!("/{key}/{axis}");
            assert!(
                (number(&replay, &pointer) - number(&run, &pointer)).abs() < 1e-4,
                "{pointer}"
            );
            assert!(
                (number(&unit, &pointer) - number(&run, &pointer)).abs() < alike,
                "{pointer}"
            );
        }
    }
    for (found, name) in [(&run, "heading_deg"), (&unit, "heading_deg")] {
        assert_eq!(found[name], found["final"]["reading"]["attitude"][name]);
    }
    let result = fs::read_to_string(dir.path().join("report/paper-sim-seed1/result.json")).unwrap();
    assert_eq!(serde_json::from_str::<Value>(&result).unwrap(), run);

    // Without an estimate its figures are null, and the reason says why.
    let short = told(&["run", "--json", "--quiet", "--seconds", "20"]);
    let resting = told(&["unit", "--json", "--quiet", "--type", "60 stop"]);
    for found in [&short, &resting] {
        assert!(
            found["heading_deg"].is_null() && found["accel_bias_ug"].is_null(),
            "{found}"
        );
        assert!(found["t_s"].is_number());
    }
    assert_eq!(
        (&short["state"], &resting["state"]),
        (&Value::from("coarse"), &Value::from("idle"))
    );
    assert!(short["reason"].as_str().unwrap().starts_with("coarse alignment needs"));
    for (arguments, name) in [
        (&["bound", "--json", "--quiet"][..], "bound"),
        (&["observability", "--json"], "observability"),
        (
            &["monte-carlo", "--runs", "2", "--seconds", "70", "--json", "--quiet"],
            "monte-carlo",
        ),
    ] {
        let found = told(arguments);
        assert_eq!(found["schema"], serde_json::json!({ "name": name, "version": 1 }));
    }
}

#[test]
fn a_log_replays_to_the_run_it_was_written_by() {
    let dir = TempDir::new().unwrap();
    for method in ["kf", "stf"] {
        let arguments = ["run", "--seed", "3", "--json", "--log", "run.csv", "--method", method];
        let run = json(&hal_sim(dir.path(), &arguments));
        let output = hal_sim(
            dir.path(),
            &[
                "replay",
                "run.csv",
                "--latitude-deg",
                "40",
                "--json",
                "--quiet",
                "--method",
                method,
            ],
        );
        assert_eq!(output.status.code(), Some(0), "{output:?}");
        let replay = json(&output);
        assert_eq!(replay["state"], "aligned");
        for angle in ["heading_deg", "pitch_deg", "roll_deg"] {
            let simulated = number(&run, &format!("/final/reading/attitude/{angle}"));
            // One ulp of an f32 angle of a turn is 2e-5 degrees.
            assert!(
                (number(&replay, &format!("/{angle}")) - simulated).abs() < 1e-4,
                "{angle}"
            );
        }
        for axis in 0..3 {
            let simulated = number(&run, &format!("/final/reading/gyro_bias_deg_h/{axis}"));
            assert!((number(&replay, &format!("/gyro_bias_deg_h/{axis}")) - simulated).abs() < 1e-2);
        }
        assert_eq!(replay["accel_bias_ug"].as_array().map(Vec::len), Some(3));
    }
}

#[test]
fn a_base_that_moves_is_refused_by_the_papers_filter() {
    let dir = TempDir::new().unwrap();
    let run = hal_sim(
        dir.path(),
        &[
            "run",
            "--scenario",
            "moored",
            "--method",
            "kf",
            "--log",
            "moored.csv",
            "--quiet",
        ],
    );
    assert_eq!(run.status.code(), Some(1), "{run:?}");
    let output = hal_sim(
        dir.path(),
        &[
            "replay",
            "moored.csv",
            "--latitude-deg",
            "40",
            "--method",
            "kf",
            "--json",
            "--quiet",
        ],
    );
    assert_eq!(output.status.code(), Some(1), "{output:?}");
    let replay = json(&output);
    assert_eq!(replay["state"], "inconsistent");
    assert!(
        replay["heading_deg"].is_null() && replay["heading_sd_deg"].is_null(),
        "{replay}"
    );
    assert!(
        replay["reason"]
            .as_str()
            .is_some_and(|reason| reason.contains("innovations")),
        "{replay}"
    );
}

#[test]
fn a_gap_is_bridged_and_said() {
    let dir = TempDir::new().unwrap();
    hal_sim(dir.path(), &["run", "--log", "whole.csv", "--quiet"]);
    let whole = fs::read_to_string(dir.path().join("whole.csv")).unwrap();
    // 20 rows after 200 s.
    let kept = whole.lines().enumerate().filter(|(k, _)| !(20_001..20_021).contains(k));
    let text: String = kept.map(|(_, line)| format!("{line}\n")).collect();
    fs::write(dir.path().join("gap.csv"), text).unwrap();
    let output = hal_sim(
        dir.path(),
        &["replay", "gap.csv", "--latitude-deg", "40", "--unit", "paper"],
    );
    assert_eq!(output.status.code(), Some(0), "{output:?}");
    let said = String::from_utf8(output.stderr).unwrap();
    assert!(
        said.contains("20 rows missing") && said.contains("warning: bridged 1 gap of 0.200 s"),
        "{said}"
    );
}

/// A log of an IMU as sold by the shortest command: its noise is measured, and no other error is taken for zero.
/// A log whose IMU hangs upside down and whose encoder counts degrees the other way, piped in, is the log as it was.
#[test]
fn a_log_is_read_from_standard_input_in_other_units_and_axes() {
    let dir = TempDir::new().unwrap();
    hal_sim(dir.path(), &["run", "--seconds", "60", "--log", "a.csv", "--quiet"]);
    let piped = |text: &str, arguments: &[&str]| {
        assert_cmd::Command::cargo_bin("hal-sim")
            .unwrap()
            .current_dir(dir.path())
            .args(arguments)
            .write_stdin(text)
            .output()
            .unwrap()
    };
    let log = fs::read_to_string(dir.path().join("a.csv")).unwrap();
    let (header, rows) = log.split_once('\n').unwrap();
    let mut turned = format!("% of another program\n{}\n", header.to_uppercase());
    for row in rows.lines() {
        let mut figures: Vec<f64> = row.split(',').map(|figure| figure.parse().unwrap()).collect();
        for place in [2, 3, 5, 6] {
            figures[place] = -figures[place];
        }
        figures[7] = -figures[7].to_degrees();
        turned += &figures.iter().map(f64::to_string).collect::<Vec<_>>().join(",");
        turned.push('\n');
    }
    let expected = json(&hal_sim(
        dir.path(),
        &["replay", "a.csv", "--latitude-deg", "40", "--json"],
    ));
    let given = ["--mounting", "x,-y,-z", "--encoder-unit", "-deg"];
    let figures = ["--latitude-deg", "40", "--unit", "a.unit.toml", "--json"];
    let heading = |output: &Output| number(&json(output), "/heading_deg");
    let replayed = piped(&turned, &[&["replay", "-"], &given[..], &figures[..]].concat());
    assert!(
        (heading(&replayed) - number(&expected, "/heading_deg")).abs() < 1e-3,
        "{replayed:?}"
    );

    // Without them, the error names standard input and the options.
    let refused = error_line(&piped(&turned, &[&["replay", "-"], &figures[..]].concat()));
    assert!(
        refused.starts_with("standard input:3: accel_z_m_s2 is -9.") && refused.ends_with("--mounting x,-y,-z"),
        "{refused}"
    );
    let refused = error_line(&piped(&turned, &[&["replay", "-"], &given[..2], &figures[..]].concat()));
    assert!(refused.contains("--encoder-unit"), "{refused}");

    // The CSV that is made of it needs neither.
    let converted = piped(&turned, &[&["convert", "-"], &given[..], &["b.csv"]].concat());
    assert_eq!(converted.status.code(), Some(0), "{converted:?}");
    let replayed = hal_sim(dir.path(), &[&["replay", "b.csv"], &figures[..]].concat());
    assert!(
        (heading(&replayed) - number(&expected, "/heading_deg")).abs() < 1e-3,
        "{replayed:?}"
    );

    // The report of a replay: what the result says, one row a second.
    let replayed = hal_sim(
        dir.path(),
        &[&["replay", "a.csv", "--report", "r/a"], &figures[..2]].concat(),
    );
    assert!(
        String::from_utf8_lossy(&replayed.stdout).contains("report: r/a/report.html"),
        "{replayed:?}"
    );
    let file = |name: &str| fs::read_to_string(dir.path().join("r/a").join(name)).unwrap();
    let heading = number(&expected, "/heading_deg");
    let page = file("report.html");
    assert!(
        page.contains("Replay of a.csv") && page.contains(&format!("<td>{heading:.4}</td>")),
        "{page}"
    );
    assert_eq!(
        page.matches("<svg ").count(),
        8,
        "four plots for a page and for a telephone"
    );
    let estimates = file("estimates.csv");
    let mut lines = estimates.lines().map(|line| line.split(',').collect::<Vec<_>>());
    let header = lines.next().unwrap();
    let column = |name: &str| header.iter().position(|column| *column == name).unwrap();
    let rows: Vec<Vec<f64>> = lines
        .map(|line| line.iter().map(|figure| figure.parse().unwrap()).collect())
        .collect();
    assert!((2..=10).contains(&rows.len()), "{}", rows.len());
    let last = rows.last().unwrap();
    assert!(
        (last[column("heading_deg")] - heading).abs() < 1e-5 && last[column("t_s")] > 59.0,
        "{last:?}"
    );
    assert!((0.1..5.0).contains(&last[column("innovation_ratio")]), "{last:?}");

    // Whatever comes of a log with figures beside it has them beside it.
    hal_sim(dir.path(), &["convert", "a.csv", "c.csv"]);
    let [figures, passed] =
        ["a.unit.toml", "c.unit.toml"].map(|name| fs::read_to_string(dir.path().join(name)).unwrap());
    assert_eq!(passed, figures);
}

#[test]
fn figures_of_an_imu_that_are_broken_are_an_error() {
    let dir = TempDir::new().unwrap();
    fs::write(
        dir.path().join("a.csv"),
        "t_s,gyro_x_rad_s,gyro_y_rad_s,gyro_z_rad_s,accel_x_m_s2,accel_y_m_s2,accel_z_m_s2,encoder_rad\n",
    )
    .unwrap();
    fs::write(dir.path().join("a.unit.toml"), "\ngyro_bias_sd_deg_h = 'much'\n").unwrap();
    let error = error_line(&hal_sim(dir.path(), &["replay", "a.csv", "--latitude-deg", "40"]));
    assert_eq!(
        error,
        "a.unit.toml:2: gyro_bias_sd_deg_h: found string \"much\", expected a number"
    );
}

#[test]
fn an_imu_that_nobody_described_is_not_the_papers() {
    let dir = TempDir::new().unwrap();
    let run = hal_sim(
        dir.path(),
        &["run", "--unit", "adis16495-3", "--log", "sold.csv", "--json", "--quiet"],
    );
    let truth = json(&run)["final"]["truth"]["heading_deg"].as_f64().unwrap();
    let replay = || {
        let output = hal_sim(dir.path(), &["replay", "sold.csv", "--latitude-deg", "40", "--json"]);
        let said = String::from_utf8(output.stderr.clone()).unwrap();
        (output.status.code(), json(&output), said)
    };
    let (_, told, said) = replay();
    assert!(said.contains("IMU: the figures in sold.unit.toml"), "{said}");
    fs::remove_file(dir.path().join("sold.unit.toml")).unwrap();
    let (code, measured, said) = replay();
    assert!(said.contains("gyros 0.17") || said.contains("gyros 0.18"), "{said}");
    assert!(said.contains("accelerometers 13."), "{said}");
    assert_eq!(
        (code, measured["state"].as_str()),
        (Some(1), Some("fine")),
        "{measured}"
    );
    for result in [told, measured] {
        let of = |key: &str| result[key].as_f64().unwrap();
        let off = (of("heading_deg") - truth + 540.0).rem_euclid(360.0) - 180.0;
        assert!(off.abs() < 4.0 * of("heading_sd_deg"), "{off} {result}");
    }
}

#[test]
fn broken_logs_are_one_line_with_the_place() {
    let dir = TempDir::new().unwrap();
    hal_sim(dir.path(), &["run", "--log", "good.csv", "--quiet", "--seconds", "30"]);
    let good = fs::read_to_string(dir.path().join("good.csv")).unwrap();
    let broken = |change: &dyn Fn(usize, &str) -> String| -> String {
        let text: String = good
            .lines()
            .enumerate()
            .map(|(k, line)| change(k, line) + "\n")
            .collect();
        fs::write(dir.path().join("bad.csv"), text).unwrap();
        error_line(&hal_sim(
            dir.path(),
            &["replay", "bad.csv", "--latitude-deg", "40", "--json"],
        ))
    };
    let in_row_100 = |from: usize, to: &'static str| {
        move |k: usize, line: &str| {
            let mut fields: Vec<_> = line.split(',').collect();
            if k == 100 {
                fields[from] = to;
            }
            fields.join(",")
        }
    };
    for (message, mentions) in [
        (broken(&in_row_100(2, "NaN")), ["bad.csv:101", "gyro_y_rad_s"]),
        (broken(&in_row_100(4, "abc")), ["bad.csv:101", "accel_x_m_s2"]),
        (broken(&in_row_100(0, "0.5")), ["bad.csv:101", "t_s"]),
        (
            broken(&|k, line| {
                if k == 0 {
                    line.replace("encoder_rad", "angle")
                } else {
                    line.to_owned()
                }
            }),
            ["bad.csv:1", "encoder_rad"],
        ),
    ] {
        for mention in mentions {
            assert!(message.contains(mention), "{mention}: {message}");
        }
    }
    fs::write(dir.path().join("empty.csv"), "").unwrap();
    assert!(error_line(&hal_sim(dir.path(), &["replay", "empty.csv", "--latitude-deg", "40"])).contains("empty"));
    assert!(error_line(&hal_sim(dir.path(), &["replay", "none.csv", "--latitude-deg", "40"])).contains("none.csv"));
}

#[test]
fn impossible_arguments_are_refused() {
    let dir = TempDir::new().unwrap();
    hal_sim(dir.path(), &["run", "--log", "good.csv", "--quiet", "--seconds", "30"]);
    let latitude = error_line(&hal_sim(dir.path(), &["replay", "good.csv", "--latitude-deg", "-89"]));
    assert!(latitude.contains("between -85 and 85"), "{latitude}");
    let unknown = error_line(&hal_sim(dir.path(), &["run", "--scenario", "paper-simm"]));
    assert!(unknown.contains("paper-sim, paper-turntable"), "{unknown}");
    fs::write(
        dir.path().join("own.toml"),
        "[place]\nlatitude_deg = 40.0\nlongitude_deg = 3.0\n",
    )
    .unwrap();
    let key = error_line(&hal_sim(dir.path(), &["run", "--scenario", "own.toml"]));
    assert!(key.starts_with("own.toml:3: place.longitude_deg: "), "{key}");
    let seconds = error_line(&hal_sim(dir.path(), &["run", "--seconds", "0"]));
    assert!(seconds.contains("duration_s"), "{seconds}");
}

/// A short log has no result, and says how much is missing.
#[test]
fn a_short_log_is_not_aligned() {
    let dir = TempDir::new().unwrap();
    hal_sim(dir.path(), &["run", "--log", "short.csv", "--quiet", "--seconds", "30"]);
    let output = hal_sim(dir.path(), &["replay", "short.csv", "--latitude-deg", "40", "--json"]);
    assert_eq!(output.status.code(), Some(1), "{output:?}");
    let replay = json(&output);
    assert_eq!(replay["state"], "coarse");
    assert!(replay["heading_deg"].is_null());
    assert!(
        replay["reason"]
            .as_str()
            .is_some_and(|reason| reason.contains("s more")),
        "{replay}"
    );
}

/// On a base that is fixed to Earth the encoder tells the z gyro's bias: a better heading, and a smaller 1σ that holds.
/// On one that is not it is refused, to the bit.
#[test]
fn the_encoder_constraint_helps_where_it_is_true() {
    let dir = TempDir::new().unwrap();
    let run = |scenario: &str, more: &[&str]| {
        let arguments = [
            "run",
            "--scenario",
            scenario,
            "--seconds",
            "240",
            "--seed",
            "5",
            "--json",
        ];
        json(&hal_sim(dir.path(), &[&arguments[..], more].concat()))
    };
    let (off, on) = (run("static", &[]), run("static", &["--encoder-constraint"]));
    let sd = |result: &Value| number(result, "/final/reading/sd/heading_deg");
    assert!(sd(&on) < 0.85 * sd(&off), "{} {}", sd(&on), sd(&off));
    let error = number(&on, "/final/error/heading_deg");
    assert!(error.abs() < 4.0 * sd(&on), "{error}");
    let [off, on] = [run("paper-sim", &[]), run("paper-sim", &["--encoder-constraint=10"])];
    assert_eq!(off.pointer("/final"), on.pointer("/final"));
}

#[test]
fn mistakes_are_told_before_the_work_with_what_to_do_next() {
    let dir = TempDir::new().unwrap();
    fs::write(dir.path().join("file"), "").unwrap();
    fs::write(dir.path().join("typo.toml"), "[imu]\ngyro_bias_sd = 3\n").unwrap();
    for (arguments, next) in [
        (&["run", "--scenario", "papersim"][..], "there are static, paper-sim,"),
        (
            &["run", "--scenario", "mine.toml"],
            "`hal-sim scenarios paper-sim > mine.toml` writes one",
        ),
        (
            &["run", "--scenario", "typo.toml"],
            "known here: `part`, `gyro_bias_sd_deg_h`",
        ),
        (&["run", "--seconds", "-5"], "allowed are 0.1 to 360000"),
        (&["run", "--report", "file"], "name another with --report DIR"),
        (&["monte-carlo", "--report", "file"], "name another with --report DIR"),
        (
            &["reproduce", "--all", "--out", "file"],
            "name another with --report DIR",
        ),
        (
            &["run", "--log", "none/a.csv"],
            "there is no folder none: make it first",
        ),
        (
            &["convert", "file", "none/a.csv"],
            "there is no folder none: make it first",
        ),
        (&["replay", "none.csv", "--latitude-deg", "40"], "none.csv: cannot read"),
        (
            &["unit", "--record", "none/a.bin"],
            "there is no folder none: make it first",
        ),
        (&["unit", "--type", "5"], "expected seconds and a line"),
        (&["soak", "--hours", "-1"], "expected hours from 0.1 to 10000"),
        (&["observability", "--seconds", "-1"], "expected seconds above 0"),
        (&["reproduce", "du18"], "there is du16-table1"),
        (&["allan", "file"], "a log starts with a header"),
    ] {
        let message = error_line(&hal_sim(dir.path(), arguments));
        assert!(message.contains(next), "{arguments:?}: {message}");
    }
    assert!(!dir.path().join("report").exists(), "nothing is written for a mistake");
}

/// What is made of a log does not go over it, and a port that is not there costs no recording.
#[test]
fn a_log_is_not_written_over() {
    let dir = TempDir::new().unwrap();
    fs::write(dir.path().join("a"), "kept").unwrap();
    for arguments in [
        &["convert", "a", "a"][..],
        &["calibrate", "a", "--corrected", "./a"],
        &["allan", "a", "--unit", "a"],
        &["allan", "a", "--plot", "a"],
        &["inspect", "a", "--csv", "a"],
        &["inspect", "a", "--svg", "a"],
        &["link", "/dev/no-such-port", "--record", "a"],
    ] {
        let output = hal_sim(dir.path(), arguments);
        assert_eq!(output.status.code(), Some(2), "{arguments:?}: {output:?}");
        assert_eq!(
            fs::read_to_string(dir.path().join("a")).unwrap(),
            "kept",
            "{arguments:?}"
        );
    }
}

#[test]
fn completions_are_a_script_that_the_shell_reads() {
    let dir = TempDir::new().unwrap();
    let output = hal_sim(dir.path(), &["completions", "bash"]);
    assert_eq!(output.status.code(), Some(0), "{output:?}");
    let script = String::from_utf8(output.stdout).unwrap();
    for word in ["monte-carlo", "--scenario", "complete -F _hal"] {
        assert!(script.contains(word), "{word}");
    }
    fs::write(dir.path().join("hal-sim.bash"), script).unwrap();
    let read = Command::new("bash")
        .current_dir(dir.path())
        .args(["-n", "hal-sim.bash"])
        .output()
        .unwrap();
    assert!(read.status.success(), "{read:?}");
}
