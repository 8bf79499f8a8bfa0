//! Once a second what the unit does, for whoever reads the log and not the serial line.
//!
//! It comes with the first estimate of the second where there are any, and at the second where there are none.

use embassy_futures::select::{Either, select};
use embassy_sync::blocking_mutex::raw::RawMutex;
use embassy_time::{Instant, Timer};

use crate::log::{Event, Report};
use crate::shared::Shared;

const SECOND_US: u64 = 1_000_000;
/// How long an estimate is waited for, µs: two of them.
const LATE_US: u64 = 200_000;

/// The task.
pub async fn run<M: RawMutex>(shared: &Shared<M>) -> ! {
    let Some(mut estimates) = shared.navigation.receiver() else {
        // More readers than `READERS`: a log without estimates is seen at once.
        core::future::pending().await
    };
    let mut due_us = SECOND_US;
    loop {
        Timer::at(Instant::from_micros(due_us)).await;
        let they_come = estimates
            .try_get()
            .is_some_and(|last| last.estimate.is_some() && last.t_us + LATE_US > due_us);
        let estimate = if they_come {
            let late = Timer::at(Instant::from_micros(due_us + LATE_US));
            match select(estimates.changed(), late).await {
                Either::First(now) => now.estimate,
                Either::Second(()) => None,
            }
        } else {
            None
        };
        let now_us = Instant::now().as_micros();
        due_us = (now_us / SECOND_US + 1) * SECOND_US;
        if let Some(status) = shared.status.try_get() {
            let rotor = shared.angle_at(now_us);
            shared.log(&Event::Report(Report::new(status.mode, estimate.as_ref(), rotor)));
        }
    }
}
