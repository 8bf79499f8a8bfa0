//! All that the unit costs, one table after the other: instructions of each step, from QEMU; load, stack and memory of
//! the release image, from the emulated part.
//!
//! `cargo budget-all`, at the top of the sources: builds what it needs, some minutes at first.

use std::process::{Command, ExitCode};

use emulator::image::Image;
use emulator::report;
use emulator::run::{self, Setup};
use hal_sim::scenario::Scenario;

/// Boot, homing, coarse alignment, replay, and some seconds aligned, s.
const SECONDS: f64 = 90.0;

fn main() -> ExitCode {
    match budget() {
        Ok(()) => ExitCode::SUCCESS,
        Err(reason) => {
            eprintln!("error: {reason}");
            ExitCode::FAILURE
        }
    }
}

fn cargo(arguments: &[&str]) -> Result<(), String> {
    let status = Command::new("cargo")
        .args(arguments)
        .current_dir(concat!(env!("CARGO_MANIFEST_DIR"), "/../.."))
        .status()
        .map_err(|e| format!("cargo: {e}"))?;
    if status.success() {
        Ok(())
    } else {
        Err(format!("cargo {} failed", arguments.join(" ")))
    }
}

fn words(error: impl core::fmt::Display) -> String {
    error.to_string()
}

fn budget() -> Result<(), String> {
    cargo(&["budget"])?;
    cargo(&["fw", "--locked", "--quiet"])?;
    let image = Image::read(&Image::release()).map_err(words)?;
    let scenario = Scenario::builtin("paper-sim").map_err(words)?;
    let (outcome, ()) = run::run(&image, &Setup::new(scenario, 1, SECONDS), ()).map_err(words)?;
    print!("{}", report::cost(&outcome.cost));
    Ok(())
}
