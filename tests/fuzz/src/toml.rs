//! Scenarios and `UNIT.toml`: [`hal_sim::scenario`], [`hal_sim::unit`].

use core::fmt::Debug;

use hal_sim::config::ConfigError;
use hal_sim::scenario::Scenario;
use hal_sim::truth::Truth;
use hal_sim::unit::Unit;

/// What is refused is refused in one line.
fn taken<T>(found: Result<T, ConfigError>) -> Option<T> {
    found
        .inspect_err(|error| {
            let message = error.to_string();
            assert!(
                message.starts_with("fuzz.toml: ") || message.starts_with("fuzz.toml:"),
                "{message}"
            );
            assert!(!message.contains('\n'), "{message}");
        })
        .ok()
}

fn comes_back<T: PartialEq + Debug>(value: &T, text: &str, parse: fn(&str, &str) -> Result<T, ConfigError>) {
    assert_eq!(parse(text, "fuzz.toml").as_ref(), Ok(value), "{text}");
}

/// A scenario that is taken is in its ranges, comes back from its own text, and either begins or says why not.
pub fn scenario(data: &[u8]) {
    let Some(scenario) = text(data).and_then(|text| taken(Scenario::parse(text, "fuzz.toml"))) else {
        return;
    };
    assert_eq!(scenario.validate(), Ok(()));
    comes_back(&scenario, &::toml::to_string(&scenario).unwrap(), Scenario::parse);
    if let Ok(truth) = Truth::new(&scenario, 1) {
        let (dtheta_s, dv_s) = truth.increment(0.0, scenario.time(1));
        assert!(dtheta_s.norm().is_finite() && dv_s.norm().is_finite());
    }
}

/// The same for a unit's figures.
pub fn unit(data: &[u8]) {
    let Some(unit) = text(data).and_then(|text| taken(Unit::parse(text, "fuzz.toml"))) else {
        return;
    };
    comes_back(&unit, &::toml::to_string(&unit).unwrap(), Unit::parse);
}

fn text(data: &[u8]) -> Option<&str> {
    core::str::from_utf8(data).ok()
}
