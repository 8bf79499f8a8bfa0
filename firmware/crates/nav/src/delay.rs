//! How late the IMU's samples are against the encoder's angles, from the rotor's reversals.
//!
//! A sample that is late by τ measures the rotor as it was τ before: ∫ω_z dt is then behind the encoder's angle α by `τ α̇`, and
//! where the rotor turns round at ±ω it leaps by `2 τ ω`. A bias of the gyro is a slope there, an error of its scale goes with
//! α, and the base's own yaw ψ is smooth. With D the difference over 0.2 s and a bar for the mean over it,
//!
//! ```text
//! A = ∫ω_z dt − α = b t + s α + ψ − τ α̇
//! D⁴ Ā = −τ D⁴ α̅̇ + what is left of b, s α and ψ
//! ```
//!
//! and τ is found by least squares. A yaw of the period T comes through the differences with `(2π 0.2 s/T)⁴` of its
//! angle: 0.4 % of it at 5 s. The mean makes a coarse encoder's rate as good as its angles are over 0.2 s; one of 12 bits
//! still takes an eighth off the result, one of 16 nothing.
//!
//! The angles are summed in whole units of 2 nrad: a sum of some minutes in `f32` has no digits left for the differences. Neighbouring
//! samples have most of a difference in common, so that some sixty sums of every few samples tell as much as all of them.
//!
//! Not modelled: a scale factor's share, `s D⁴ α̅`, which is odd about a reversal where the rate's is even.

use frames::math;

/// Time over which differences and means are taken, s: a rotor turns round in it, a base hardly changes its rate.
const LAG: f32 = 0.2;
/// Weights of a difference of the means, of the angles: one more than the fourth.
const WEIGHTS: [i64; 6] = [1, -5, 10, -10, 5, -1];
/// Rows kept: of five lags, each of at most twelve.
const ROWS: usize = 64;
const LAG_ROWS: u16 = 12;
/// What is counted, rad.
const UNIT: f32 = 2e-9;
/// The rotor has turned round where it went either way at this part of its highest rate, at least.
const ROUND: f32 = 0.5;

/// How late the samples are.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Delay {
    /// The time from the end of a sample's interval to the instant of its angle, s: positive where the IMU is the later one.
    pub delay: f32,
    /// 1σ of that by what the fit leaves, s.
    pub sd: f32,
}

/// The estimate as it grows.
#[derive(Debug, Clone)]
pub struct DelayEstimator {
    /// Samples from row to row, rows in a lag, and their time, s.
    stride: u16,
    lag: u16,
    lag_s: f32,
    /// Samples since the last row.
    since: u16,
    /// Since the last interruption: α, ∫ω_z dt − α, and twice its sum over the samples, by the trapezoidal rule.
    angle: i64,
    beyond: i64,
    sum: i64,
    /// Angle and sum of the last rows, and how many there have been.
    rows: [(i64, i64); ROWS],
    kept: usize,
    xx: f32,
    xy: f32,
    yy: f32,
    count: u32,
    /// Lowest and highest mean rate of the rotor, rad/s.
    rates: (f32, f32),
}

impl Default for DelayEstimator {
    fn default() -> Self {
        Self {
            stride: 1,
            lag: 1,
            lag_s: 1.0,
            since: 0,
            angle: 0,
            beyond: 0,
            sum: 0,
            rows: [(0, 0); ROWS],
            kept: 0,
            xx: 0.0,
            xy: 0.0,
            yy: 0.0,
            count: 0,
            rates: (0.0, 0.0),
        }
    }
}

#[expect(
    clippy::cast_possible_truncation,
    reason = "saturates beyond 4 rad, and a sample turns by less than half a turn"
)]
fn units(angle: f32) -> i64 {
    i64::from((angle / UNIT) as i32)
}

impl DelayEstimator {
    /// What comes next does not follow what came before.
    pub fn interrupt(&mut self) {
        self.kept = 0;
    }

    /// Takes what the gyro's z axis and the encoder have turned by over a sample of `dt`, rad and s. Whether the fit has changed.
    pub fn push(&mut self, gyro: f32, encoder: f32, dt: f32) -> bool {
        if self.kept == 0 {
            let samples = math::limit(LAG / dt, 3.0, 1000.0) + 0.5;
            #[expect(
                clippy::cast_possible_truncation,
                clippy::cast_sign_loss,
                reason = "clamped to 3 and 1000"
            )]
            let samples = samples as u16;
            self.stride = samples.div_ceil(LAG_ROWS).max(1);
            self.lag = samples / self.stride;
            self.lag_s = f32::from(self.stride * self.lag) * dt;
            (self.angle, self.beyond, self.sum, self.since) = (0, 0, 0, 0);
        }
        let turned = units(encoder);
        self.angle += turned;
        let before = self.beyond;
        self.beyond += units(gyro) - turned;
        self.sum += before + self.beyond;
        self.since += 1;
        if self.since < self.stride && self.kept > 0 {
            return false;
        }
        self.since = 0;
        self.rows[self.kept % ROWS] = (self.angle, self.sum);
        self.kept += 1;
        let lag = usize::from(self.lag);
        let Some(newest) = (self.kept - 1)
            .checked_sub(lag * (WEIGHTS.len() - 1))
            .map(|_| self.kept - 1)
        else {
            return false;
        };
        let (mut angle, mut sum) = (0, 0);
        for (back, weight) in WEIGHTS.into_iter().enumerate() {
            let row = self.rows[(newest - back * lag) % ROWS];
            angle += weight * row.0;
            sum += weight * row.1;
        }
        let then = self.rows[(newest - lag) % ROWS];
        #[expect(clippy::cast_precision_loss, reason = "of differences, which are small")]
        let [rate, x, y] = [self.angle - then.0, angle, sum].map(|units| units as f32 * UNIT);
        let rate = rate / self.lag_s;
        self.rates = (self.rates.0.min(rate), self.rates.1.max(rate));
        let samples = f32::from(self.stride * self.lag);
        let (x, y) = (x / self.lag_s, 0.5 * y / samples);
        self.xx += x * x;
        self.xy += x * y;
        self.yy += y * y;
        self.count = self.count.saturating_add(1);
        true
    }

    /// The delay so far; `None` where the rotor never turned round.
    pub fn fit(&self) -> Option<Delay> {
        let (back, forth) = (-self.rates.0, self.rates.1);
        if back.min(forth) <= ROUND * back.max(forth) {
            return None;
        }
        let delay = -self.xy / self.xx;
        #[expect(clippy::cast_precision_loss, reason = "a count of rows")]
        let left = (self.yy + delay * self.xy).max(0.0) / self.count as f32;
        // Neighbours have most of a difference in common.
        let sd = math::sqrt(left * 2.0 * f32::from(self.lag) / self.xx);
        (delay.is_finite() && sd.is_finite()).then_some(Delay { delay, sd })
    }
}
