//! What several tests need: the command, the papers' scenario, and an observer of the whole unit's serial port.
#![allow(dead_code, reason = "each test takes what it needs of it")]

use std::path::Path;
use std::process::Output;

use app::shared::Navigation;
use assert_cmd::Command;
use hal_sim::bus::UartLine;
use hal_sim::scenario::Scenario;
use hal_sim::unit_sim::Observer;

/// The command, run in a folder to its end.
pub(crate) fn hal_sim(dir: &Path, arguments: &[&str]) -> Output {
    Command::cargo_bin("hal-sim")
        .unwrap()
        .current_dir(dir)
        .args(arguments)
        .output()
        .unwrap()
}

/// The papers' scenario.
pub(crate) fn paper() -> Scenario {
    Scenario::builtin("paper-sim").unwrap()
}

/// What the unit answers to a command, where a line is that.
pub(crate) fn answer(line: &UartLine) -> Option<String> {
    let text = String::from_utf8_lossy(&line.bytes);
    let answer = text.strip_prefix("$PRNSA,")?;
    Some(answer.split('*').next().unwrap_or_default().to_owned())
}

/// All that comes from the unit's serial port, and the estimates behind it.
#[derive(Default)]
pub(crate) struct Port {
    pub(crate) lines: Vec<UartLine>,
    pub(crate) estimates: Vec<Navigation>,
}

impl Observer for Port {
    fn sentence(&mut self, line: &UartLine) {
        self.lines.push(line.clone());
    }

    fn estimate(&mut self, navigation: &Navigation) {
        self.estimates.push(*navigation);
    }
}

impl Port {
    /// The latest estimate at the first byte of a line.
    pub(crate) fn estimate_at(&self, line: &UartLine) -> Option<&Navigation> {
        let begun_us = line.started_ns / 1000;
        let next = self.estimates.partition_point(|at| at.t_us < begun_us);
        self.estimates.get(next.checked_sub(1)?)
    }
}
