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
    pub fn gyro_instability_driving_noise_var(&self, t: T) -> T {
        let decay = self.gyro_instability_decay(t);
        self.gyro_instability_sd * self.gyro_instability_sd * (T::one() - decay * decay)
    }
}

/// The angle random walk of the level gyros, measured by samples and by the increments joined of them.
///
/// White noise of the angle itself, as quantisation makes it, adds as much of angle to both, and so the less the longer they are:
/// with w what either shows, `w² = N² + c/dt`, and `N² = (w₂² dt₂ − w₁² dt₁)/(dt₂ − dt₁)`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct WalkMeter<T: Real> {
    pub(crate) samples: WhiteNoise<T>,
    pub(crate) joined: WhiteNoise<T>,
}

impl<T: Real> WalkMeter<T> {
    /// Figures below this many of the configured one are scatter, the rotor's reversals, or a little vibration.
    const MORE: f64 = 1.5;
    /// Differences below which nothing is concluded. In 54 s there are as many from 19 Hz on; where samples are longer, the
    /// rotor's reversals are too many of them.
    const ENOUGH: f64 = 1000.0;

    /// Of no sample.
    pub(crate) fn new() -> Self {
        Self {
            samples: WhiteNoise::new(),
            joined: WhiteNoise::new(),
        }
    }

    /// The figure to use, rad/√s: the configured one, or what has been measured where that is clearly more.
    pub(crate) fn at_least(&self, configured: T) -> T {
        let [(w1, dt1), (w2, dt2)] = [&self.samples, &self.joined].map(|noise| {
            // About z the motor turns.
            let [x, y, _] = noise.density();
            ((x + y) * T::lit(0.5), noise.interval())
        });
        let few = self.samples.count.min(self.joined.count) < T::lit(Self::ENOUGH);
        if few || dt2 < dt1 * T::lit(1.5) {
            return configured;
        }
        let square = (w2 * w2 * dt2 - w1 * w1 * dt1) / (dt2 - dt1);
        let least = configured * T::lit(Self::MORE);
        if square > least * least {
            math::sqrt(square)
        } else {
            configured
        }
    }
}

/// White noise of a sensor, by the sixth differences of its increments in a row: they have 924 times its variance, and what a
/// base does within seven samples is not in them.
///
/// Third differences have enough of that at 10 Hz to make three times the σ of heading: 1.07° instead of 0.35° with 0.02 °/√h and
/// a swing of 10° and 5 s.
///
/// By the mean absolute value, and of no difference more than four times that: a knock, or a reversal of the rotor, is one sample
/// in hundreds.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct WhiteNoise<T: Real = f32> {
    /// The last increments over √dt, the newest first, and how many of them there are.
    before: [Vec3<Sensor, T>; 6],
    held: u8,
    /// Sums of the sizes of the differences, by axis, and their number.
    sums: [T; 3],
    count: T,
    /// Sum of the intervals, s.
    time: T,
}

impl<T: Real> Default for WhiteNoise<T> {
    fn default() -> Self {
        Self::new()
    }
}

impl<T: Real> WhiteNoise<T> {
    /// E|x| of the sixth difference of a normal variable of unit variance: √(924 · 2/π).
    const MEAN: f64 = 24.253_6;
    /// A difference is limited to this many times the mean …
    const LARGEST: f64 = 4.0;
    /// … of so many before it.
    const SETTLED: f64 = 100.0;

    /// Of no increment.
    pub fn new() -> Self {
        Self {
            before: [Vec3::zero(); 6],
            held: 0,
            sums: [T::zero(); 3],
            count: T::zero(),
            time: T::zero(),
        }
    }

    /// Adds an increment of `dt` seconds: a turn, rad, or a velocity, m/s. Differences begin anew `behind_gap`.
    // Once in an image, though there are three to call it.
    #[inline(never)]
    pub fn push(&mut self, increment: Vec3<Sensor, T>, dt: T, behind_gap: bool) {
        let now = increment / math::sqrt(dt);
        if behind_gap {
            self.held = 0;
        }
        let [a, b, c, d, e, f] = self.before;
        if self.held == 6 {
            let difference = now + f - (a + e) * T::lit(6.0) + (b + d) * T::lit(15.0) - c * T::lit(20.0);
            let settled = self.count >= T::lit(Self::SETTLED);
            for (sum, x) in self.sums.iter_mut().zip(difference.to_array()) {
                let size = x.abs();
                let most = *sum / self.count * T::lit(Self::LARGEST);
                *sum += if settled { size.min(most) } else { size };
            }
            self.count += T::one();
            self.time += dt;
        } else {
            self.held += 1;
        }
        self.before = [now, a, b, c, d, e];
    }

    /// Its density by axis: rad/√s of turns, m/s/√s of velocities. Zero where there were less than seven increments.
    pub fn density(&self) -> [T; 3] {
        let count = self.count.max(T::one());
        self.sums.map(|sum| sum / (count * T::lit(Self::MEAN)))
    }

    /// Mean interval, s.
    fn interval(&self) -> T {
        self.time / self.count.max(T::one())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::chance::Chance;

    /// A minute of white noise of `walk`, on a swing of 10° and 5 s seen from a turning rotor, with a tenth of it configured. The
    /// angle has white noise of `angle_sd` as well, rad.
    fn measured(walk: f64, angle_sd: f64, rate_hz: u32, knocks: bool) -> f64 {
        let (dt, mut chance) = (1.0 / f64::from(rate_hz), Chance(1));
        let mut meter = WalkMeter::new();
        let (joined_of, mut joined) = (rate_hz.div_ceil(20), Vec3::zero());
        let mut before = Vec3::zero();
        for k in 0..60 * rate_hz {
            let t = f64::from(k) * dt;
            let knock = if knocks && k % 4000 == 3999 { 0.1 * dt } else { 0.0 };
            let rate = 10.0 * units::DEG * 1.26 * math::sin_cos(1.26 * t).0;
            let (sin, cos) = math::sin_cos(0.35 * t);
            let base = Vec3::new(rate * cos * dt + knock, -rate * sin * dt, 0.3 * dt);
            let angle = chance.normals() * angle_sd;
            let turn = base + chance.normals() * (walk * math::sqrt(dt)) + angle - before;
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
        }
        // An angle that is quantised: short increments show 4 to 12 times the walk.
        for rate_hz in [100, 200, 1000] {
            let found = measured(walk, 0.2 * walk, rate_hz, false);
            assert!((found - 1.0).abs() < 0.35, "{rate_hz}: {found}");
        }
        // Of long samples nothing is said.
        assert!((measured(walk, 0.0, 10, false) - 0.1).abs() < 1e-9);
        // A knock of 6 °/s every 20 s, a thousand times the noise.
        let found = measured(walk, 0.0, 200, true);
        assert!((found - 1.0).abs() < 0.35, "{found}");
    }

    #[test]
    fn the_configured_walk_stands_until_more_is_measured() {
        let mut meter = WalkMeter::<f64>::new();
        let mut chance = Chance(2);
        let mut push = |count: u32| {
            for _ in 0..count {
                meter.samples.push(chance.normals() * 0.1, 0.01, false);
                meter.joined.push(chance.normals() * math::sqrt(0.05), 0.05, false);
            }
            meter
        };
        assert_eq!(push(900).at_least(0.1), 0.1, "too few");
        let meter = push(3000);
        assert!((meter.at_least(0.1) - 1.0).abs() < 0.1);
        assert_eq!(meter.at_least(0.8), 0.8);
        // As much of angle in long increments as in short ones is none of a walk.
        let same = WalkMeter {
            samples: WhiteNoise {
                time: meter.joined.time * 0.2,
                sums: meter.joined.sums.map(|sum| sum * math::sqrt(5.0)),
                ..meter.joined
            },
            ..meter
        };
        assert_eq!(same.at_least(0.1), 0.1);
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
            var = var * decay * decay + noise.gyro_instability_driving_noise_var(t);
            assert!((var - 4.0).abs() < 1e-12);
        }
        let constant = ImuNoise::<f64>::default();
        assert_eq!(
            (
                constant.gyro_instability_decay(10.0),
                constant.gyro_instability_driving_noise_var(10.0)
            ),
            (1.0, 0.0)
        );
    }
}
