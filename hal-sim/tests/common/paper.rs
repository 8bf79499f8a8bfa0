//! The papers' scenario.

use hal_sim::scenario::Scenario;

/// The papers' scenario.
pub(crate) fn paper() -> Scenario {
    Scenario::builtin("paper-sim").unwrap()
}
