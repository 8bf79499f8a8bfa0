//! How late the IMU's samples are against the encoder's angles, from the rotor's reversals.
//!
//! A sample that is late by τ tells of the rotor as it was τ before: ∫ω_z dt is then behind the encoder's angle α by `τ α̇`, and
//! where the rotor turns round at ±ω it leaps by `2 τ ω`. A bias of the gyro is a slope there, an error of its scale goes with
//! α, and the base's own yaw ψ is smooth. With D the difference over [`LAG`] and a bar for the mean over it,
//!
//! ```text
//! A = ∫ω_z dt − α = b t + s α + ψ − τ α̇
//! D⁴ Ā = −τ D⁴ α̅̇ + what is left of b, s α and ψ
//! ```
//!
//! and τ is found by least squares over the log. A yaw of the period T comes through the differences with `(2π LAG/T)⁴` of its
//! angle: 0.4 % of it at 5 s. The mean makes a coarse encoder's rate as good as its angles are over [`LAG`]; one of 12 bits
//! still takes an eighth off the result, one of 16 nothing.
//!
//! Not modelled: a scale factor's share, `s D⁴ α̅`, which is odd about a reversal where the rate's is even.

use std::collections::VecDeque;

use frames::math::wrap_pi;
use serde::Serialize;

use super::LogRow;

/// Time over which differences and means are taken, s: a rotor turns round in it, a base hardly changes its rate.
const LAG: f64 = 0.2;
/// Of the means, so often a difference.
const DIFFERENCES: usize = 4;
/// Weights of a difference once more often: of the angles, whose difference the mean rate is.
const WEIGHTS: [f64; DIFFERENCES + 2] = [1.0, -5.0, 10.0, -10.0, 5.0, -1.0];
/// The rotor has turned round where it went either way at this part of its highest rate, at least.
const ROUND: f64 = 0.5;

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
pub struct DelayEstimator {
    /// Rows in [`LAG`].
    lag: usize,
    /// Since the last interruption: α, ∫ω_z dt − α, and its sum over the rows, by the trapezoidal rule.
    angle: f64,
    beyond: f64,
    sum: f64,
    /// Angle and sum of the last rows.
    rows: VecDeque<(f64, f64)>,
    xx: f64,
    xy: f64,
    yy: f64,
    count: f64,
    /// Lowest and highest mean rate of the rotor, rad/s.
    rates: (f64, f64),
}

impl DelayEstimator {
    /// Takes a row and the one before it.
    pub fn push(&mut self, row: &LogRow, previous: &LogRow) {
        if row.gap.is_some() {
            // What is summed over a gap tells nothing.
            self.rows.clear();
            return;
        }
        if self.rows.is_empty() {
            self.lag = ((LAG / row.dt_s).round() as usize).clamp(3, 1000);
            (self.angle, self.beyond, self.sum) = (0.0, 0.0, 0.0);
        }
        let turned = wrap_pi(row.encoder - previous.encoder);
        self.angle += turned;
        let before = self.beyond;
        self.beyond += row.w_is_s.z() * row.dt_s - turned;
        self.sum += 0.5 * (before + self.beyond);
        let wanted = (DIFFERENCES + 1) * self.lag + 1;
        self.rows.push_back((self.angle, self.sum));
        if self.rows.len() < wanted {
            return;
        }
        let (mut angle, mut sum) = (0.0, 0.0);
        for (row, weight) in self.rows.iter().rev().step_by(self.lag).zip(WEIGHTS) {
            angle += weight * row.0;
            sum += weight * row.1;
        }
        let lag = self.lag as f64;
        let rate = (self.angle - self.rows[wanted - 1 - self.lag].0) / (lag * row.dt_s);
        self.rates = (self.rates.0.min(rate), self.rates.1.max(rate));
        let (x, y) = (angle / (lag * row.dt_s), sum / lag);
        self.xx += x * x;
        self.xy += x * y;
        self.yy += y * y;
        self.count += 1.0;
        self.rows.pop_front();
    }

    /// The delay so far; `None` where the rotor never turned round.
    pub fn fit(&self) -> Option<ImuDelay> {
        let (back, forth) = (-self.rates.0, self.rates.1);
        if back.min(forth) <= ROUND * back.max(forth) {
            return None;
        }
        let delay_s = -self.xy / self.xx;
        let left = (self.yy + delay_s * self.xy).max(0.0) / self.count;
        // Neighbours have most of a difference in common.
        let sd_s = (left * 2.0 * self.lag as f64 / self.xx).sqrt();
        (delay_s.is_finite() && sd_s.is_finite()).then_some(ImuDelay { delay_s, sd_s })
    }
}
