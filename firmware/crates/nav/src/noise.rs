//! What an IMU's data sheet and Allan plot say of it, in SI units.

use frames::{Real, Sensor, Vec3, math, units};

/// Noise and bias figures of one IMU, equal on its three axes.
///
/// | field | unit | zero means | \[Xing18\] Table 2 |
/// |---|---|---|---|
/// | `gyro_bias_sd` | rad/s | biases known | 10 °/h |
/// | `accel_bias_sd` | m/s² | biases known | 100 µg |
/// | `angle_random_walk` | rad/√s | refused: no filter works without it | 0.02 °/√h |
/// | `velocity_random_walk` | m/s/√s | none | 10 µg/√Hz |
/// | `gyro_instability_sd` | rad/s | biases constant | – |
/// | `gyro_instability_tau` | s | refused, unless the sd is zero | – (100 s) |
/// | `gyro_scale_factor_sd` | – | scale factors known | – |
/// | `gyro_misalignment_sd` | rad | axes known | – |
/// | `gyro_g_sensitivity_sd` | rad/s per m/s² | no response to force | – |
/// | `gyro_housing_sd` | rad/s | none | – |
/// | `accel_scale_factor_sd` | – | scale factors known | – |
/// | `accel_misalignment_sd` | rad | axes known | – |
/// | `accel_instability_sd` | m/s² | biases constant | – |
/// | `accel_instability_tau` | s | refused, unless the sd is zero | – (100 s) |
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ImuNoise<T: Real = f32> {
    /// 1σ of the turn-on bias of a gyro, rad/s.
    pub gyro_bias_sd: T,
    /// 1σ of the turn-on bias of an accelerometer, m/s².
    pub accel_bias_sd: T,
    /// Angle random walk of a gyro, rad/√s.
    pub angle_random_walk: T,
    /// Velocity random walk of an accelerometer, m/s/√s.
    pub velocity_random_walk: T,
    /// 1σ of the first-order Gauss–Markov part of the gyro bias, rad/s.
    pub gyro_instability_sd: T,
    /// Correlation time of that part, s.
    pub gyro_instability_tau: T,
    /// 1σ of the gyros' scale factors after calibration.
    pub gyro_scale_factor_sd: T,
    /// 1σ of the gyros' misalignments after calibration, rad.
    pub gyro_misalignment_sd: T,
    /// 1σ of each term of the gyros' response to specific force, rad/s per m/s².
    pub gyro_g_sensitivity_sd: T,
    /// 1σ of each level component of a gyro error that is constant in the housing, rad/s.
    pub gyro_housing_sd: T,
    /// 1σ of the accelerometers' scale factors after calibration.
    pub accel_scale_factor_sd: T,
    /// 1σ of the accelerometers' misalignments after calibration, rad.
    pub accel_misalignment_sd: T,
    /// 1σ of the first-order Gauss–Markov part of the accelerometer bias, m/s².
    pub accel_instability_sd: T,
    /// Correlation time of that part, s.
    pub accel_instability_tau: T,
}

impl<T: Real> Default for ImuNoise<T> {
    /// The IMU of \[Xing18\] Table 2.
    fn default() -> Self {
        Self {
            gyro_bias_sd: T::lit(10.0 * units::DEG_PER_HOUR),
            accel_bias_sd: T::lit(100.0 * units::MICRO_G),
            angle_random_walk: T::lit(0.02 * units::DEG_PER_SQRT_HOUR),
            velocity_random_walk: T::lit(10.0 * units::MICRO_G_PER_SQRT_HZ),
            gyro_instability_sd: T::zero(),
            gyro_instability_tau: T::lit(100.0),
            gyro_scale_factor_sd: T::zero(),
            gyro_misalignment_sd: T::zero(),
            gyro_g_sensitivity_sd: T::zero(),
            gyro_housing_sd: T::zero(),
            accel_scale_factor_sd: T::zero(),
            accel_misalignment_sd: T::zero(),
            accel_instability_sd: T::zero(),
            accel_instability_tau: T::lit(100.0),
        }
    }
}

impl<T: Real> ImuNoise<T> {
    /// Whether every figure is finite and not negative, the random walk positive, and an instability
    /// comes with its correlation time.
    pub fn is_valid(&self) -> bool {
        let zero = T::zero();
        let Self {
            gyro_bias_sd,
            accel_bias_sd,
            angle_random_walk,
            velocity_random_walk,
            gyro_instability_sd,
            gyro_instability_tau,
            gyro_scale_factor_sd,
            gyro_misalignment_sd,
            gyro_g_sensitivity_sd,
            gyro_housing_sd,
            accel_scale_factor_sd,
            accel_misalignment_sd,
            accel_instability_sd,
            accel_instability_tau,
        } = *self;
        [
            gyro_bias_sd,
            accel_bias_sd,
            velocity_random_walk,
            gyro_instability_sd,
            gyro_instability_tau,
            gyro_scale_factor_sd,
            gyro_misalignment_sd,
            gyro_g_sensitivity_sd,
            gyro_housing_sd,
            accel_scale_factor_sd,
            accel_misalignment_sd,
            accel_instability_sd,
            accel_instability_tau,
        ]
        .iter()
        .all(|x| x.finite() && *x >= zero)
            && angle_random_walk.finite()
            && angle_random_walk > zero
            && (gyro_instability_sd == zero || gyro_instability_tau > zero)
            && (accel_instability_sd == zero || accel_instability_tau > zero)
    }

    /// Density of the random walk that stands in for the Gauss–Markov part, (rad/s)²/s.
    ///
    /// 2σ²/τ: the walk grows as the process itself does for times below τ, and faster beyond.
    pub fn gyro_bias_walk_psd(&self) -> T {
        if self.gyro_instability_sd == T::zero() {
            return T::zero();
        }
        T::lit(2.0) * self.gyro_instability_sd * self.gyro_instability_sd / self.gyro_instability_tau
    }

    /// The same for the accelerometers, (m/s²)²/s. They have no state of their own for it.
    pub fn accel_bias_walk_psd(&self) -> T {
        if self.accel_instability_sd == T::zero() {
            return T::zero();
        }
        T::lit(2.0) * self.accel_instability_sd * self.accel_instability_sd / self.accel_instability_tau
    }

    /// What is left of the Gauss–Markov part after `t` seconds: e^(−t/τ) by (1 − x/2)/(1 + x/2), x = t/τ, which is
    /// x³/12 off and never grows; nothing beyond 2 τ.
    pub fn gyro_instability_decay(&self, t: T) -> T {
        if self.gyro_instability_sd == T::zero() {
            return T::one();
        }
        let half = T::lit(0.5) * t / self.gyro_instability_tau;
        ((T::one() - half) / (T::one() + half)).max(T::zero())
    }

    /// Variance that the Gauss–Markov part takes up in `t` seconds, (rad/s)²: what keeps it stationary.
    pub fn gyro_instability_kick_var(&self, t: T) -> T {
        let decay = self.gyro_instability_decay(t);
        self.gyro_instability_sd * self.gyro_instability_sd * (T::one() - decay * decay)
    }
}

/// The angle random walk of the level gyros, measured by samples and by the increments joined of them.
///
/// White noise of the angle itself, as quantisation makes it, adds as much of angle to both, and so the less the longer they are:
/// with w what either tells, `w² = N² + c/dt`, and `N² = (w₂² dt₂ − w₁² dt₁)/(dt₂ − dt₁)`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct WalkMeter<T: Real> {
    pub(crate) samples: Differences<T>,
    pub(crate) joined: Differences<T>,
}

impl<T: Real> WalkMeter<T> {
    /// Figures below this many of the told one are scatter, the rotor's reversals, or a little vibration.
    const MORE: f64 = 1.5;

    /// Of no sample.
    pub(crate) fn new() -> Self {
        Self {
            samples: Differences::new(),
            joined: Differences::new(),
        }
    }

    /// The figure to go by, rad/√s: the one told, or what has been measured where that is clearly more.
    pub(crate) fn at_least(&self, told: T) -> T {
        let (Some((w1, dt1)), Some((w2, dt2))) = (self.samples.walk(), self.joined.walk()) else {
            return told;
        };
        if dt2 < dt1 * T::lit(1.5) {
            return told;
        }
        let square = (w2 * w2 * dt2 - w1 * w1 * dt1) / (dt2 - dt1);
        let least = told * T::lit(Self::MORE);
        if square > least * least {
            math::sqrt(square)
        } else {
            told
        }
    }
}

/// Sixth differences of turns in a row: white noise of a rate has 924 times its variance there, and what a base does within seven
/// samples is not in it. About z the motor turns.
///
/// Third differences would do at 100 Hz. At 10 Hz they take a swing of 10° and 5 s for 24 times the noise of 0.02 °/√h.
///
/// By the mean absolute value, and of no difference more than four times that: a knock, or a reversal of the rotor, is one sample
/// in hundreds.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Differences<T: Real> {
    /// The last turns over √dt, the newest first, and how many of them there are.
    before: [Vec3<Sensor, T>; 6],
    held: u8,
    sum: T,
    count: T,
    /// Sum of the intervals, s.
    time: T,
}

impl<T: Real> Differences<T> {
    /// E|x| of the sixth difference of a normal variable of unit variance: √(924 · 2/π).
    const MEAN: f64 = 24.253_8;
    /// Differences below which nothing is said. In 54 s there are as many from 19 Hz on; where samples are longer the
    /// rotor's reversals are too many of them.
    const ENOUGH: f64 = 2000.0;
    /// One is cut to so many times the mean, once there is a mean of so many.
    const LARGEST: f64 = 4.0;
    const SETTLED: f64 = 200.0;

    fn new() -> Self {
        Self {
            before: [Vec3::zero(); 6],
            held: 0,
            sum: T::zero(),
            count: T::zero(),
            time: T::zero(),
        }
    }

    /// Adds a turn, rad, in `dt` seconds. Differences begin anew `behind_gap`.
    pub(crate) fn push(&mut self, turn: Vec3<Sensor, T>, dt: T, behind_gap: bool) {
        let now = turn / math::sqrt(dt);
        if behind_gap {
            self.held = 0;
        }
        let [a, b, c, d, e, f] = self.before;
        if self.held == 6 {
            let difference = now + f - (a + e) * T::lit(6.0) + (b + d) * T::lit(15.0) - c * T::lit(20.0);
            for size in [difference.x().abs(), difference.y().abs()] {
                let settled = self.count >= T::lit(Self::SETTLED);
                let most = self.sum / self.count * T::lit(Self::LARGEST);
                self.sum += if settled { size.min(most) } else { size };
                self.count += T::one();
            }
            self.time += dt + dt;
        } else {
            self.held += 1;
        }
        self.before = [now, a, b, c, d, e];
    }

    /// What they tell of the walk, rad/√s, and the mean interval, s; `None` of too few.
    fn walk(&self) -> Option<(T, T)> {
        let enough = self.count >= T::lit(Self::ENOUGH);
        enough.then(|| (self.sum / (self.count * T::lit(Self::MEAN)), self.time / self.count))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A minute of white noise of `walk`, on a swing of 10° and 5 s seen from a turning rotor, told a tenth of it. The angle has
    /// white noise of `angle_sd` as well, rad.
    fn measured(walk: f64, angle_sd: f64, rate_hz: u32, knocks: bool) -> f64 {
        let (dt, mut seed) = (1.0 / f64::from(rate_hz), 1_u64);
        let mut uniform = || {
            seed = seed
                .wrapping_mul(6_364_136_223_846_793_005)
                .wrapping_add(1_442_695_040_888_963_407);
            (seed >> 11) as f64 / (1_u64 << 53) as f64 - 0.5
        };
        let mut normal = || (0..12).map(|_| uniform()).sum::<f64>();
        let mut meter = WalkMeter::new();
        let (joined_of, mut joined) = (rate_hz.div_ceil(20), Vec3::zero());
        let mut before = [0.0; 2];
        for k in 0..60 * rate_hz {
            let t = f64::from(k) * dt;
            let knock = if knocks && k % 4000 == 3999 { 0.1 * dt } else { 0.0 };
            let rate = 10.0 * units::DEG * 1.26 * math::sin_cos(1.26 * t).0;
            let (sin, cos) = math::sin_cos(0.35 * t);
            let noise = walk * math::sqrt(dt);
            let angle = [angle_sd * normal(), angle_sd * normal()];
            let turn = Vec3::new(
                rate * cos * dt + noise * normal() + angle[0] - before[0] + knock,
                noise * normal() - rate * sin * dt + angle[1] - before[1],
                0.3 * dt,
            );
            before = angle;
            meter.samples.push(turn, dt, k % 777 == 0);
            joined += turn;
            if k % joined_of == joined_of - 1 {
                meter.joined.push(joined, dt * f64::from(joined_of), false);
                joined = Vec3::zero();
            }
        }
        meter.at_least(0.1 * walk) / walk
    }

    #[test]
    fn a_walk_is_measured_on_a_swinging_base() {
        let walk = 0.02 * units::DEG_PER_SQRT_HOUR;
        for rate_hz in [40, 100, 200, 1000] {
            let found = measured(walk, 0.0, rate_hz, false);
            assert!((found - 1.0).abs() < 0.2, "{rate_hz}: {found}");
            // Of an angle that is quantised as much is there, and no walk.
            let found = measured(walk, 3.0 * walk * 0.1, rate_hz, false);
            assert!((found - 1.0).abs() < 0.35, "{rate_hz}: {found}");
        }
        // Of long samples nothing is said.
        assert!((measured(walk, 0.0, 10, false) - 0.1).abs() < 1e-9);
        // A knock of 6 °/s every 20 s, a thousand times the noise.
        let found = measured(walk, 0.0, 200, true);
        assert!((found - 1.0).abs() < 0.35, "{found}");
    }

    #[test]
    fn the_figure_told_stands_until_more_is_measured() {
        let mut meter = WalkMeter::<f64>::new();
        let turn = |k: u32| Vec3::new(if k.is_multiple_of(2) { 1e-5 } else { -1e-5 }, 0.0, 0.0);
        let mut push = |from: u32, to: u32| {
            for k in from..to {
                meter.samples.push(turn(k), 0.01, false);
                meter.joined.push(turn(k), 0.05, false);
            }
            meter
        };
        assert_eq!(push(0, 1000).at_least(1e-6), 1e-6, "too few");
        let meter = push(1000, 4000);
        // As much of angle in long increments as in short ones is none of a walk.
        assert_eq!(meter.at_least(1e-6), 1e-6);
        assert_eq!(meter.at_least(1e-3), 1e-3);
    }

    #[test]
    fn gauss_markov_part_decays_and_stays_stationary() {
        let noise = ImuNoise::<f64> {
            gyro_instability_sd: 2.0,
            gyro_instability_tau: 100.0,
            ..ImuNoise::default()
        };
        // e^(−0.1)
        assert!((noise.gyro_instability_decay(10.0) - 0.904_837_418).abs() < 1e-4);
        assert_eq!(noise.gyro_instability_decay(1000.0), 0.0);
        let mut var = 4.0;
        for t in [1.0, 10.0, 50.0] {
            let decay = noise.gyro_instability_decay(t);
            var = var * decay * decay + noise.gyro_instability_kick_var(t);
            assert!((var - 4.0).abs() < 1e-12);
        }
        let constant = ImuNoise::<f64>::default();
        assert_eq!(
            (
                constant.gyro_instability_decay(10.0),
                constant.gyro_instability_kick_var(10.0)
            ),
            (1.0, 0.0)
        );
    }
}
