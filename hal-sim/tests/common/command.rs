//! The command, for tests of what it prints.

use std::path::Path;
use std::process::Output;

use assert_cmd::Command;

/// The command, run in a folder to its end.
pub(crate) fn hal_sim(dir: &Path, arguments: &[&str]) -> Output {
    Command::cargo_bin("hal-sim")
        .unwrap()
        .current_dir(dir)
        .args(arguments)
        .output()
        .unwrap()
}
