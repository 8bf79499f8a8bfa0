//! Lists the built-in scenarios, or prints one.

use std::process::ExitCode;

use hal_sim::scenario::Scenario;

use super::output::{Done, print, words};

pub(super) const HELP: &str = "\
Prints names and what they are; of one, its TOML.

Examples:
  hal-sim scenarios
  hal-sim scenarios paper-sim > mine.toml     change it, then: hal-sim run --scenario mine.toml";

pub(super) fn run(name: Option<&str>) -> Done {
    match name {
        Some(name) => print(Scenario::builtin_text(name).map_err(words)?)?,
        None => {
            for name in Scenario::builtin_names() {
                let scenario = Scenario::builtin(name).map_err(words)?;
                print(&format!("{name:<22}{}\n", scenario.description))?;
            }
        }
    }
    Ok(ExitCode::SUCCESS)
}
