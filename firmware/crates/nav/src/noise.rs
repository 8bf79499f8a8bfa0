//! What an IMU's data sheet and Allan plot say of it, in SI units.

use frames::{Real, units};

/// Noise and bias figures of one IMU, equal on its three axes.
///
/// | field | unit | zero means | \[Xing18\] Table 2 |
/// |---|---|---|---|
/// | `gyro_bias_sd` | rad/s | biases known | 10 °/h |
/// | `accel_bias_sd` | m/s² | biases known | 100 µg |
/// | `angle_random_walk` | rad/√s | refused: no filter works without it | 0.02 °/√h |
/// | `velocity_random_walk` | m/s/√s | none | 10 µg/√Hz |
/// | `gyro_instability_sd` | rad/s | biases constant | – |
/// | `gyro_instability_tau` | s | refused, unless the sd is zero | – |
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
            gyro_instability_tau: T::zero(),
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
        } = *self;
        [
            gyro_bias_sd,
            accel_bias_sd,
            velocity_random_walk,
            gyro_instability_sd,
            gyro_instability_tau,
        ]
        .iter()
        .all(|x| x.finite() && *x >= zero)
            && angle_random_walk.finite()
            && angle_random_walk > zero
            && (gyro_instability_sd == zero || gyro_instability_tau > zero)
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
}
