//! How fast virtual time runs. `cargo run --release -p vtime --example speed`

use embassy_time::{Duration, Instant, Ticker};
use vtime::{Executor, Level};

async fn tick(rate_hz: u64) {
    let mut ticker = Ticker::every(Duration::from_hz(rate_hz));
    loop {
        ticker.next().await;
    }
}

fn main() {
    let seconds = 500;
    let report = |name: &str, rates: &[u64]| {
        let mut unit = Executor::new();
        for rate_hz in rates {
            unit.spawn("tick", Level::Thread, tick(*rate_hz));
        }
        let start = std::time::Instant::now();
        let stop = unit.run_until(Instant::from_secs(seconds));
        let real = start.elapsed().as_secs_f64();
        println!(
            "{name}: {seconds} s in {:.1} ms, {:.0} times real time, {:.0} ns a poll, {stop:?}",
            real * 1e3,
            seconds as f64 / real,
            real * 1e9 / unit.polls() as f64,
        );
    };
    report("1 task at 100 Hz", &[100]);
    report("10 tasks at 1 kHz", &[1000; 10]);
    report("10 tasks at 2 kHz", &[2000; 10]);
    report(
        "10 tasks at 1 to 2 kHz, no two alike",
        &[1000, 1100, 1201, 1309, 1400, 1511, 1603, 1709, 1801, 2000],
    );
    report("20 tasks at 200 Hz", &[200; 20]);
}
