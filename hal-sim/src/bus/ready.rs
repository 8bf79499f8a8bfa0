//! Data-ready: the IMU's own clock, with the motion it samples and the edges it gives.

use core::future::{Future, poll_fn};
use core::pin::Pin;

use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;
use vtime::{now_ns, sleep_until_ns};

use super::{Line, Part};
use crate::device::{Motion, SensorModel};

/// How data-ready behaves. The default is an edge at the very instant of the sample.
///
/// | field | unit | zero means | sane value |
/// |---|---|---|---|
/// | `delay_us` | µs | the edge comes with the sample | 3 or more times the jitter, as an edge never comes early; less than a period |
/// | `jitter_sd_us` | µs | as regular as the sample | 1 |
/// | `late_us` | µs | samples are as late as the part is made | 0; 3000 for filters that nobody knows of |
/// | `loss` | share of edges | none is lost | 0; 0.01 for a fault |
/// | `width_us` | µs | the line falls at once | 50, less than a period |
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DataReady {
    /// Mean time from sample to edge.
    pub delay_us: f64,
    /// Its spread, normal, cut at zero delay.
    pub jitter_sd_us: f64,
    /// What the samples are later by than the part is made.
    pub late_us: i64,
    /// Probability of an edge to go unheard. [`Line::lost`] counts them.
    pub loss: f64,
    /// How long the line is high.
    pub width_us: f64,
}

impl Default for DataReady {
    fn default() -> Self {
        Self {
            delay_us: 0.0,
            jitter_sd_us: 0.0,
            late_us: 0,
            loss: 0.0,
            width_us: 50.0,
        }
    }
}

impl DataReady {
    /// Runs an IMU for ever: at each of its sample instants gives it `motion(from_us, to_us)`, the mean
    /// over that interval, lets it latch, and raises the line. To be spawned at
    /// [`Level::World`](vtime::Level::World).
    ///
    /// The interval ends before that instant by the delay of the part ([`SensorModel::delay_us`]) and `late_us`. It begins with the sample before, or where a command began a new series of samples; the
    /// first one after a reset or at power-up includes the time the part took to start.
    ///
    /// The random numbers are the same whatever the settings.
    pub async fn run<T: SensorModel>(
        self,
        part: Part<T>,
        line: Line,
        mut rng: ChaCha8Rng,
        mut motion: impl FnMut(u64, u64) -> Motion,
    ) {
        let mut from_us = now_ns() / 1000;
        let mut next_us = part.with(|model| model.next_ready_us());
        let (mut rise_ns, mut fall_ns) = (u64::MAX, u64::MAX);
        loop {
            poll_fn(|cx| {
                // The next sample moves when the part is commanded so over its bus.
                let planned_us = part.with(|model| model.next_ready_us());
                if planned_us != next_us {
                    next_us = planned_us;
                    from_us = now_ns() / 1000;
                }
                part.on_touch(cx.waker());
                let next_ns = next_us.saturating_mul(1000).min(rise_ns).min(fall_ns);
                Pin::new(&mut sleep_until_ns(next_ns)).poll(cx)
            })
            .await;
            let now_ns = now_ns();
            if fall_ns <= now_ns {
                fall_ns = u64::MAX;
                line.set(false);
            }
            if rise_ns <= now_ns {
                rise_ns = u64::MAX;
                // A cast saturates, and so does a negative or absurd setting.
                fall_ns = now_ns.saturating_add((self.width_us * 1000.0) as u64);
                line.set(true);
            }
            if next_us.saturating_mul(1000) > now_ns {
                continue;
            }
            let delay_us = self
                .late_us
                .saturating_add_unsigned(part.with(|model| model.delay_us()));
            // No part is ahead of the motion.
            let delay_us = delay_us.max(0);
            let before = |us: u64| us.saturating_add_signed(delay_us.saturating_neg());
            let motion = motion(before(from_us.min(next_us)), before(next_us));
            let edges = part.with(|model| {
                model.set_motion(motion);
                model.advance(next_us);
                model.take_data_ready()
            });
            from_us = next_us;
            next_us = part.with(|model| model.next_ready_us());
            let jitter: f64 = rng.sample(StandardNormal);
            let lost = rng.random::<f64>() < self.loss;
            if edges > 0 {
                line.lose_rising(u32::from(lost));
                let delay_us = (self.delay_us + self.jitter_sd_us * jitter).max(0.0);
                rise_ns = now_ns.saturating_add((delay_us * 1000.0) as u64);
            }
        }
    }
}
