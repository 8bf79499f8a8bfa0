//! What an IMU's data sheet and Allan plot say of it, in SI units.

use frames::{Real, Sensor, Vec3, math, units};

use crate::increment::Sample;

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

/// The angle random walk of the level gyros, measured by the sixth differences of samples in a row: white noise has 924 times
/// its variance there, and what a base does within seven samples is not in it. About z the motor turns.
///
/// Third differences would do at 100 Hz. At 10 Hz they take a swing of 10° and 5 s for 24 times the noise of 0.02 °/√h.
///
/// By the mean absolute value, and of no difference more than four times that: a knock, or a reversal of the rotor, is one sample
/// in hundreds.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct WalkMeter<T: Real> {
    /// The last turns over √dt, the newest first, and how many of them there are.
    before: [Vec3<Sensor, T>; 6],
    held: u8,
    sum: T,
    count: T,
}

impl<T: Real> WalkMeter<T> {
    /// E|x| of the sixth difference of a normal variable of unit variance: √(924 · 2/π).
    const MEAN: f64 = 24.253_8;
    /// Figures below this many of the told one are its own scatter, the digits of a sensor, or a little vibration.
    const MORE: f64 = 1.2;
    /// Differences below which nothing is said. In 54 s there are as many from 19 Hz on; where samples are longer the
    /// rotor's reversals are too many of them.
    const ENOUGH: f64 = 2000.0;
    /// One is cut to so many times the mean, once there is a mean of so many.
    const LARGEST: f64 = 4.0;
    const SETTLED: f64 = 200.0;

    /// Of no sample.
    pub(crate) fn new() -> Self {
        Self {
            before: [Vec3::zero(); 6],
            held: 0,
            sum: T::zero(),
            count: T::zero(),
        }
    }

    /// Adds a sample. Differences begin anew behind a gap.
    pub(crate) fn push(&mut self, sample: &Sample<T>) {
        let now = sample.dtheta_s / math::sqrt(sample.dt);
        if sample.gap > T::zero() {
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
        } else {
            self.held += 1;
        }
        self.before = [now, a, b, c, d, e];
    }

    /// The figure to go by, rad/√s: the one told, or what has been measured where that is clearly more.
    pub(crate) fn at_least(&self, told: T) -> T {
        let measured = self.sum / (self.count * T::lit(Self::MEAN));
        let more = self.count >= T::lit(Self::ENOUGH) && measured > told * T::lit(Self::MORE);
        if more { measured } else { told }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Samples of white noise of `walk` for a minute, on a swing of 10° and 5 s, seen from a turning rotor, told a tenth of it.
    fn measured(walk: f64, rate_hz: u32, knocks: bool) -> f64 {
        let (dt, mut seed) = (1.0 / f64::from(rate_hz), 1_u64);
        let mut uniform = || {
            seed = seed
                .wrapping_mul(6_364_136_223_846_793_005)
                .wrapping_add(1_442_695_040_888_963_407);
            (seed >> 11) as f64 / (1_u64 << 53) as f64 - 0.5
        };
        let mut normal = || (0..12).map(|_| uniform()).sum::<f64>();
        let mut meter = WalkMeter::new();
        for k in 0..60 * rate_hz {
            let t = f64::from(k) * dt;
            let knock = if knocks && k % 1000 == 999 { 0.1 * dt } else { 0.0 };
            let rate = 10.0 * units::DEG * 1.26 * math::sin_cos(1.26 * t).0;
            let (sin, cos) = math::sin_cos(0.35 * t);
            let noise = walk * math::sqrt(dt);
            meter.push(&Sample {
                dtheta_s: Vec3::new(
                    rate * cos * dt + noise * normal() + knock,
                    noise * normal() - rate * sin * dt,
                    0.3 * dt,
                ),
                dv_s: Vec3::zero(),
                dt,
                gap: if k % 777 == 0 { dt } else { 0.0 },
            });
        }
        meter.at_least(0.1 * walk) / walk
    }

    #[test]
    fn a_walk_is_measured_on_a_swinging_base() {
        let walk = 0.02 * units::DEG_PER_SQRT_HOUR;
        for rate_hz in [20, 50, 200, 1000] {
            let found = measured(walk, rate_hz, false);
            assert!((found - 1.0).abs() < 0.08, "{rate_hz}: {found}");
        }
        // Of long samples nothing is said.
        assert!((measured(walk, 10, false) - 0.1).abs() < 1e-9);
        // Ten knocks of 6 °/s, a thousand times the noise.
        let found = measured(walk, 200, true);
        assert!((found - 1.0).abs() < 0.1, "{found}");
    }

    #[test]
    fn the_figure_told_stands_until_more_is_measured() {
        let mut meter = WalkMeter::<f64>::new();
        let sample = |k: u32| Sample {
            dtheta_s: Vec3::new(if k.is_multiple_of(2) { 1e-5 } else { -1e-5 }, 0.0, 0.0),
            dv_s: Vec3::zero(),
            dt: 0.01,
            gap: 0.0,
        };
        (0..1000).for_each(|k| meter.push(&sample(k)));
        assert_eq!(meter.at_least(1e-6), 1e-6, "too few");
        (1000..4000).for_each(|k| meter.push(&sample(k)));
        assert!(meter.at_least(1e-6) > 1e-5);
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
