//! Twenty minutes of what `hal-sim soak` does for a day.
#![allow(clippy::unwrap_used, reason = "tests")]

use hal_sim::soak::{self, SoakConfig};

#[test]
fn twenty_minutes_of_trouble() {
    for seed in 1..=3 {
        let config = SoakConfig { hours: 1.0 / 3.0, seed };
        let report = soak::run(&config, |_| ()).unwrap();
        println!("{}", report.table());
        assert!(report.is_sound(), "{}", report.table());
        let due: u32 = report.kinds.values().map(|kind| kind.due).sum();
        assert!(due > 0 && report.recoveries.count > 0 && report.serial.answered > 10);
    }
}
