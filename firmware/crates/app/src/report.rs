//! Once a second what the unit does, for whoever reads the log and not the serial line.
//!
//! It comes with the first estimate of the second, and without estimates by the clock.

use embassy_futures::select::{Either, select};
use embassy_sync::blocking_mutex::raw::RawMutex;
use embassy_time::{Instant, Timer};

use crate::log::{Event, Report};
use crate::shared::Shared;

const SECOND_US: u64 = 1_000_000;
/// How long an estimate is waited for, µs: two of them.
const LATE_US: u64 = 100_000;

/// The task.
pub async fn run<M: RawMutex>(shared: &Shared<M>) -> ! {
    let Some(mut estimates) = shared.navigation.receiver() else {
        // More readers than `READERS`: a log without estimates is seen at once.
        core::future::pending().await
    };
    let mut due_us = SECOND_US;
    loop {
        let late = Timer::at(Instant::from_micros(due_us + LATE_US));
        let estimate = match select(estimates.changed(), late).await {
            Either::First(now) if now.t_us < due_us => continue,
            Either::First(now) => now.estimate,
            Either::Second(()) => None,
        };
        let now_us = Instant::now().as_micros();
        due_us = (now_us / SECOND_US + 1) * SECOND_US;
        if let Some(status) = shared.status.try_get() {
            let rotor = shared.angle_at(now_us);
            shared.log(&Event::Report(Report::new(status.mode, estimate.as_ref(), rotor)));
        }
    }
}
