//! How late the IMU's samples are against the encoder's angles, of a log: [`nav::delay`] on its rows.

use frames::math::wrap_pi;
use serde::Serialize;

use super::LogRow;

/// How late the samples are.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct ImuDelay {
    /// The time from the end of a sample's interval to the instant of its angle, s: positive where the IMU is the later one.
    pub delay_s: f64,
    /// 1σ of that by what the fit leaves, s.
    pub sd_s: f64,
}

impl core::fmt::Display for ImuDelay {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        let (delay, sd) = (self.delay_s * 1e3, self.sd_s * 1e3);
        write!(f, "the IMU is later than the encoder by {delay:+.2} ms, sd {sd:.2} ms")
    }
}

/// The estimate as it grows.
#[derive(Debug, Clone, Default)]
pub struct DelayEstimator(nav::delay::DelayEstimator);

impl DelayEstimator {
    /// Takes a row and the one before it.
    pub fn push(&mut self, row: &LogRow, previous: &LogRow) {
        if row.gap.is_some() {
            // What is summed over a gap tells nothing.
            self.0.interrupt();
            return;
        }
        let turned = wrap_pi(row.encoder - previous.encoder);
        let _ = self
            .0
            .push((row.w_is_s.z() * row.dt_s) as f32, turned as f32, row.dt_s as f32);
    }

    /// The delay so far; `None` where the rotor never turned round.
    pub fn fit(&self) -> Option<ImuDelay> {
        self.0.fit().map(|found| ImuDelay {
            delay_s: found.delay.into(),
            sd_s: found.sd.into(),
        })
    }
}
