//! Fine alignment: zero-velocity Kalman filter of the strapdown's errors, plain or strong-tracking.
//!
//! The strapdown integrates attitude and velocity in n from increments that the bias estimates have
//! corrected; the base stays where it is, so the velocity it finds is its own error, measured. With
//! `C' = (I − [φ×]) C`, `V' = V + δV`, and ε, ∇ what the bias estimates still lack (\[Xing18\] (19), (20);
//! the printed `−g^n×` is `[f^n×]`, g^n pointing down):
//!
//! ```text
//! φ̇  = −ω_ie^n × φ − C_s^n ε          δV̇ = f^n × φ + C_s^n ∇          z = δV + noise
//! Φ over one interval T between measurements:
//!      φ                δV   ε                 ∇
//! φ  [ I − [ω_ie T ×]   0   −∫C               0   ]
//! δV [ [f^n T ×]         I   −∫[f^n ×]∫C        ∫C  ]
//! ε, ∇: identity
//! ```
//!
//! f^n is `[0 0 g]`, as in the paper, and not what the accelerometers say: a base that is measured to stand
//! still does not accelerate. A level part of the measured force is a tilt not yet found, and to take it
//! for real would let the filter believe that it sees heading (σ of 1.1° with errors of 8° after 60 s).
//!
//! The integrals are summed with the increments, so that one prediction and one measurement a second
//! lose nothing of the motion in between.
//!
//! The loop is open at first: the error is estimated, linear about the path that the strapdown takes by
//! itself from its start, and stays out of it. A first estimate of heading may be off by tens of degrees
//! for seconds, and to feed it back would linearise all that follows about it (heading RMS 1.4° where
//! 0.45° is possible, in `paper-turntable`). Once [`FineFilter::close_loop`] is called, each estimated
//! error is taken out of the strapdown at once, the state returns to zero, and only P lives on.
//!
//! The *measurement* is one per second and not one per sample by choice: a strong-tracking filter
//! that measures at 20 Hz never sees a bias step in one innovation, and the cost falls by twenty.
//!
//! Not modelled here: motion of the base (see the innovations' consistency), Coriolis acceleration
//! (2 ω_ie V, below 1e-7 m/s² while V is an error), rotor-induced gyro errors.

use frames::{Nav, Real, Rot, RotIntegral, Sensor, Vec3, VecSum, math};
use nalgebra::{Matrix3, Vector3};

use crate::{
    covariance::{Coupling, Covariance},
    earth::Earth,
    fading::{Fading, StrongTracking},
    increment::Increment,
    noise::ImuNoise,
};

/// Block of the attitude errors φ_E, φ_N, φ_U, rad.
pub const PHI: usize = 0;
/// Block of the velocity errors δV_E, δV_N, δV_U, m/s.
pub const DV: usize = 1;
/// Block of the gyro bias errors ε_x, ε_y, ε_z in s, rad/s.
pub const BG: usize = 2;
/// Block of the accelerometer bias errors ∇_x, ∇_y, ∇_z in s, m/s².
pub const BA: usize = 3;
/// Number of blocks: twelve states.
pub const BLOCKS: usize = 4;

/// How the covariance is predicted.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Method<T: Real = f32> {
    /// Kalman filter, \[Xing18\] (21)–(25).
    Kalman,
    /// Strong-tracking filter, \[Xing18\] (26).
    StrongTracking(StrongTracking<T, BLOCKS>),
}

impl<T: Real> Method<T> {
    /// Strong tracking as it was measured to pay: factors on the gyro biases alone.
    pub fn strong_tracking() -> Self {
        let (none, all) = (Vector3::zeros(), Vector3::repeat(T::one()));
        Self::StrongTracking(StrongTracking {
            forgetting: T::lit(0.95),
            softening: T::lit(6.0),
            weights: [none, none, all, none],
            limit: T::lit(100.0),
        })
    }
}

/// Figures of the filter.
///
/// | field | unit | zero means | sane value |
/// |---|---|---|---|
/// | `noise` | SI | see [`ImuNoise`] | the data sheet's |
/// | `velocity_sd` | m/s | refused | 0.1 mm/s on a base that only swings |
/// | `measure_every` | s | every increment is a measurement | 1 s |
/// | `tilt_sd` | rad | refused | 0.2° |
/// | `heading_sd` | rad | refused | 90° |
/// | `method` | – | – | [`Method::Kalman`] |
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FilterConfig<T: Real = f32> {
    /// What the IMU does to the signal.
    pub noise: ImuNoise<T>,
    /// 1σ of the base's velocity about zero at a measurement, each axis, m/s. What counts is
    /// `velocity_sd² · measure_every`: 0.1 mm/s each second says what 1 mm/s at 100 Hz does.
    pub velocity_sd: T,
    /// Time between measurements, s.
    pub measure_every: T,
    /// 1σ of pitch and roll at the start, rad.
    pub tilt_sd: T,
    /// 1σ of heading at the start, rad. Wide on purpose: the coarse result that the filter starts from
    /// comes from the same samples, and is a point to linearise about, not a second opinion.
    pub heading_sd: T,
    /// Kalman or strong tracking.
    pub method: Method<T>,
}

impl<T: Real> Default for FilterConfig<T> {
    fn default() -> Self {
        use frames::units::DEG;
        Self {
            noise: ImuNoise::default(),
            velocity_sd: T::lit(1e-4),
            measure_every: T::one(),
            tilt_sd: T::lit(0.2 * DEG),
            heading_sd: T::lit(90.0 * DEG),
            method: Method::Kalman,
        }
    }
}

/// The figure of a [`FilterConfig`] that is out of range.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum FilterConfigError {
    /// A noise figure is negative or not finite, the angle random walk is zero, or an instability has no
    /// correlation time.
    Noise,
    /// `velocity_sd` must be positive.
    VelocitySd,
    /// `measure_every` must not be negative.
    MeasureEvery,
    /// `tilt_sd` and `heading_sd` must be positive.
    StartSd,
    /// A strong-tracking figure is out of range.
    StrongTracking,
}

impl core::fmt::Display for FilterConfigError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.write_str(match self {
            Self::Noise => "IMU noise figures must be finite and not negative, and the angle random walk positive",
            Self::VelocitySd => "velocity_sd must be positive",
            Self::MeasureEvery => "measure_every must not be negative",
            Self::StartSd => "tilt_sd and heading_sd must be positive",
            Self::StrongTracking => {
                "strong tracking needs 0 <= forgetting <= 1, softening >= 1, weights >= 0, limit >= 1"
            }
        })
    }
}

impl core::error::Error for FilterConfigError {}

impl<T: Real> FilterConfig<T> {
    /// Checks every figure.
    ///
    /// # Errors
    /// [`FilterConfigError`] names the first that is out of range.
    pub fn validate(&self) -> Result<(), FilterConfigError> {
        let positive = |x: T| x.finite() && x > T::zero();
        if !self.noise.is_valid() {
            return Err(FilterConfigError::Noise);
        }
        if !positive(self.velocity_sd) {
            return Err(FilterConfigError::VelocitySd);
        }
        if !(self.measure_every.finite() && self.measure_every >= T::zero()) {
            return Err(FilterConfigError::MeasureEvery);
        }
        if !(positive(self.tilt_sd) && positive(self.heading_sd)) {
            return Err(FilterConfigError::StartSd);
        }
        match &self.method {
            Method::StrongTracking(policy) if !policy.is_valid() => Err(FilterConfigError::StrongTracking),
            _ => Ok(()),
        }
    }
}

/// One zero-velocity measurement, after the fact.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Innovation<T: Real = f32> {
    /// What was measured beyond what was expected, m/s.
    pub velocity: Vec3<Nav, T>,
    /// Sum over the three components of innovation²/variance: 3 in the mean where the model holds.
    pub normalised_squared: T,
    /// Largest fading factor applied, one for the Kalman filter.
    pub fading: T,
}

/// The strapdown: attitude, velocity and the biases that correct its increments.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Strapdown<T: Real> {
    c_ns: RotIntegral<Nav, Sensor, T>,
    v_n: Vec3<Nav, T>,
    gyro_bias_s: Vec3<Sensor, T>,
    accel_bias_s: Vec3<Sensor, T>,
}

impl<T: Real> Strapdown<T> {
    /// Integrates one increment; returns `C_s^n` in the middle of it.
    fn advance(&mut self, increment: &Increment<T>, earth: &Earth<T>) -> Matrix3<T> {
        let half = T::lit(0.5);
        let dt = increment.dt;
        let gyro_bias = self.gyro_bias_s * dt;
        let phi_s = increment.phi_s - gyro_bias;
        // The bias is constant in s while the increment is resolved in s at the start: half a turn back.
        let bias_s = self.accel_bias_s + (phi_s * half).cross(self.accel_bias_s);
        let earth_turn = earth.w_ie_n() * dt;
        let start = self.c_ns.get();
        // The gyro bias has turned the samples within the interval as well, by half of it in the mean.
        let dv_s = increment.dv_s - gyro_bias.cross(increment.dv_s) * half - bias_s * dt;
        let dv_n = start * dv_s;
        // n turns by half the interval's turn, in the mean, below the velocity change.
        let dv_n = dv_n - earth_turn.cross(dv_n) * half;
        self.v_n += dv_n + earth.g_n() * dt;
        self.c_ns.turn_from(phi_s);
        self.c_ns.turn_to(-earth_turn);
        (start * Rot::exp(phi_s * half)).matrix()
    }
}

/// The parts of Φ and Q that build up between two measurements.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Interval<T: Real> {
    dt: T,
    /// ∫C_s^n, s.
    turned: Matrix3<T>,
    /// ∫[f^n ×]∫C_s^n, m/s per rad/s.
    lever: Matrix3<T>,
    /// Variance added to each attitude error by what the samples do not tell (gaps), rad².
    phi_var: T,
    /// Variance added to each velocity error likewise, (m/s)².
    dv_var: T,
}

impl<T: Real> Interval<T> {
    fn new() -> Self {
        let zero = T::zero();
        Self {
            dt: zero,
            turned: Matrix3::zeros(),
            lever: Matrix3::zeros(),
            phi_var: zero,
            dv_var: zero,
        }
    }

    fn push(&mut self, dt: T, c_ns: &Matrix3<T>, earth: &Earth<T>) {
        let turned = c_ns * dt;
        self.lever += (-earth.g_n() * dt).skew() * (self.turned + turned * T::lit(0.5));
        self.turned += turned;
        self.dt += dt;
    }

    /// In the order in which [`Covariance::propagate`] can do without a copy.
    fn couplings(&self, earth: &Earth<T>) -> [Coupling<T>; 5] {
        let earth_turn = earth.w_ie_n() * self.dt;
        [
            Coupling {
                row: DV,
                col: PHI,
                block: (-earth.g_n() * self.dt).skew(),
            },
            Coupling {
                row: DV,
                col: BG,
                block: -self.lever,
            },
            Coupling {
                row: DV,
                col: BA,
                block: self.turned,
            },
            Coupling {
                row: PHI,
                col: PHI,
                block: -earth_turn.skew(),
            },
            Coupling {
                row: PHI,
                col: BG,
                block: -self.turned,
            },
        ]
    }

    /// The blocks of Q that are not zero: (φφ, δVφ, δVδV, εε).
    ///
    /// White noise is the same in s and in n. The angle walk reaches the velocity within the interval
    /// through f^n, taken as constant: its covariance is ½T and its variance ⅓T² of the walk's.
    fn noise(&self, noise: &ImuNoise<T>, earth: &Earth<T>) -> [Matrix3<T>; 4] {
        let identity = Matrix3::identity();
        let walk = noise.angle_random_walk * noise.angle_random_walk * self.dt;
        let f_t = (-earth.g_n() * self.dt).skew();
        let velocity = noise.velocity_random_walk * noise.velocity_random_walk * self.dt;
        [
            identity * (walk + self.phi_var),
            f_t * (walk * T::lit(0.5)),
            identity * (velocity + self.dv_var) - f_t * f_t * (walk * T::lit(1.0 / 3.0)),
            identity * (noise.gyro_bias_walk_psd() * self.dt),
        ]
    }
}

/// Φ x.
fn propagated<T: Real>(x: &[Vector3<T>; BLOCKS], couplings: &[Coupling<T>]) -> [Vector3<T>; BLOCKS] {
    let mut moved = *x;
    for Coupling { row, col, block } in couplings {
        moved[*row] += block * x[*col];
    }
    moved
}

/// The filter of fine alignment.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FineFilter<T: Real = f32> {
    config: FilterConfig<T>,
    earth: Earth<T>,
    strapdown: Strapdown<T>,
    covariance: Covariance<T, BLOCKS>,
    /// Estimated error of the strapdown; zero at all times once the loop is closed.
    error: [Vector3<T>; BLOCKS],
    closed: bool,
    /// Variances at the start: fading makes no state less known than that.
    prior: [Vector3<T>; BLOCKS],
    interval: Interval<T>,
    fading: Fading<T>,
    /// ∫ of the rotor's axis in n, s, and its time, s.
    axis_n: VecSum<Nav, T>,
    elapsed: T,
}

/// Another attitude that the measurements do not tell from the one found.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct OtherSolution<T: Real = f32> {
    /// Its heading less the one found, clockwise, rad.
    pub heading_offset: T,
    /// The z gyro bias that goes with it, rad/s.
    pub gyro_bias_z: T,
}

impl<T: Real> FineFilter<T> {
    /// Starts from an attitude, at rest, with unknown biases.
    ///
    /// # Errors
    /// [`FilterConfigError`] where a figure is out of range.
    pub fn new(config: FilterConfig<T>, earth: Earth<T>, c_ns: Rot<Nav, Sensor, T>) -> Result<Self, FilterConfigError> {
        config.validate()?;
        let square = |x: T| x * x;
        let (tilt, heading) = (square(config.tilt_sd), square(config.heading_sd));
        // A state without any variance cannot be in a covariance: known biases are known to a thousandth
        // of the noise of one second.
        let least = |sd: T, walk: T| Vector3::repeat(square(sd.max(walk * T::lit(1e-3))));
        let prior = [
            Vector3::new(tilt, tilt, heading),
            Vector3::repeat(square(config.velocity_sd)),
            least(config.noise.gyro_bias_sd, config.noise.angle_random_walk),
            least(
                config.noise.accel_bias_sd,
                config.noise.velocity_random_walk.max(T::lit(1e-6)),
            ),
        ];
        Ok(Self {
            config,
            earth,
            strapdown: Strapdown {
                c_ns: RotIntegral::new(c_ns),
                v_n: Vec3::zero(),
                gyro_bias_s: Vec3::zero(),
                accel_bias_s: Vec3::zero(),
            },
            covariance: Covariance::diagonal(prior),
            error: [Vector3::zeros(); BLOCKS],
            closed: false,
            prior,
            interval: Interval::new(),
            fading: Fading::new(),
            axis_n: VecSum::new(Vec3::zero()),
            elapsed: T::zero(),
        })
    }

    /// Integrates one increment, and measures where it is time.
    pub fn step(&mut self, increment: &Increment<T>) -> Option<Innovation<T>> {
        let c_ns = self.strapdown.advance(increment, &self.earth);
        self.interval.push(increment.dt, &c_ns, &self.earth);
        self.axis_n.add(Vec3::from_vector(c_ns.column(2) * increment.dt));
        self.elapsed += increment.dt;
        // Within half an increment of its time.
        let due = self.interval.dt + increment.dt * T::lit(0.5) >= self.config.measure_every;
        due.then(|| self.measure())
    }

    /// Says that the next increment does not tell all: 1σ of the turn (rad) and of the velocity (m/s)
    /// that it may have missed on each axis.
    pub fn doubt(&mut self, phi_sd: T, dv_sd: T) {
        self.interval.phi_var += phi_sd * phi_sd;
        self.interval.dv_var += dv_sd * dv_sd;
    }

    /// Predicts P over the interval, then takes the zero velocity ((21)–(25), (26)).
    fn measure(&mut self) -> Innovation<T> {
        let r = self.config.velocity_sd * self.config.velocity_sd;
        let couplings = self.interval.couplings(&self.earth);
        let expected = propagated(&self.error, &couplings);
        let velocity = self.strapdown.v_n - Vec3::from_vector(expected[DV]);
        let [q_phi, q_cross, q_dv, q_bg] = self.interval.noise(&self.config.noise, &self.earth);

        let mut fading = T::one();
        if let Method::StrongTracking(policy) = &self.config.method {
            let mut unfaded = self.covariance;
            unfaded.propagate(&couplings);
            let m = unfaded.block(DV, DV);
            let mut factors = self.fading.factors(policy, &velocity.vector(), &m, &q_dv, r);
            for (k, block) in factors.iter_mut().enumerate() {
                let room = self.prior[k].component_div(&self.covariance.variances(k));
                *block = block.zip_map(&room, |f, room| f.min(room).max(T::one()));
            }
            fading = factors.iter().fold(T::one(), |most, f| most.max(f.max()));
            if fading > T::one() {
                self.covariance.fade(&factors);
            }
        }
        self.covariance.propagate(&couplings);
        self.covariance.add(PHI, PHI, &q_phi);
        self.covariance.add(PHI, DV, &q_cross.transpose());
        self.covariance.add(DV, DV, &q_dv);
        self.covariance.add(BG, BG, &q_bg);

        let mut normalised_squared = T::zero();
        let mut error = expected;
        let gains = self.covariance.update_block(DV, r);
        for (axis, gain) in gains.iter().enumerate() {
            let residual = self.strapdown.v_n.vector()[axis] - error[DV][axis];
            normalised_squared += residual * residual / gain.innovation_var;
            for (part, column) in error.iter_mut().zip(&gain.column) {
                *part += column * residual;
            }
        }
        self.interval = Interval::new();
        self.error = error;
        if self.closed {
            self.take_out();
        }
        Innovation {
            velocity,
            normalised_squared,
            fading,
        }
    }

    /// From now on takes each estimated error out of the strapdown at once.
    ///
    /// Until then the error is only estimated, linear about the path that the strapdown itself takes from
    /// its start: the optimum of the linear problem, whatever the estimate goes through on its way.
    pub fn close_loop(&mut self) {
        self.error = propagated(&self.error, &self.interval.couplings(&self.earth));
        self.closed = true;
        self.take_out();
    }

    /// Feedback: the estimated error leaves the strapdown, and is zero.
    fn take_out(&mut self) {
        let [phi, dv, bg, ba] = core::mem::replace(&mut self.error, [Vector3::zeros(); BLOCKS]);
        self.strapdown.c_ns.turn_to(Vec3::from_vector(phi));
        self.strapdown.v_n -= Vec3::from_vector(dv);
        self.strapdown.gyro_bias_s += Vec3::from_vector(bg);
        self.strapdown.accel_bias_s += Vec3::from_vector(ba);
    }

    /// `C_s^n` now.
    pub fn c_ns(&self) -> Rot<Nav, Sensor, T> {
        self.strapdown.c_ns.get()
    }

    /// Velocity error not yet taken out, m/s.
    pub fn v_n(&self) -> Vec3<Nav, T> {
        self.strapdown.v_n
    }

    /// Gyro biases found, rad/s.
    pub fn gyro_bias_s(&self) -> Vec3<Sensor, T> {
        self.strapdown.gyro_bias_s
    }

    /// Accelerometer biases found, m/s².
    pub fn accel_bias_s(&self) -> Vec3<Sensor, T> {
        self.strapdown.accel_bias_s
    }

    /// The covariance at the last measurement: blocks [`PHI`], [`DV`], [`BG`], [`BA`].
    pub fn covariance(&self) -> &Covariance<T, BLOCKS> {
        &self.covariance
    }

    /// Covariance of the attitude errors now, rad²: that of the last measurement and the random walk since.
    pub fn phi_covariance(&self) -> Matrix3<T> {
        let [walk, ..] = self.interval.noise(&self.config.noise, &self.earth);
        self.covariance.block(PHI, PHI) + walk
    }

    /// The other heading that explains the same measurements, where the rotor's mean axis is tilted and the
    /// z gyro bias that it takes is within four of its σ.
    ///
    /// What is measured of Earth's rate is its level part, of known size ω_ie cos L, plus the z bias along
    /// the level part `a` of the axis, which turning about z does not modulate. A line along `a` meets the
    /// circle of that size twice, at biases that differ by `δ = 2 ω_ie cos L a_N/|a|²`. Linear theory sees
    /// one of them, and gives it a small σ.
    pub fn other_solution(&self) -> Option<OtherSolution<T>> {
        let axis = self.axis_n.get();
        let (a_e, a_n) = (axis.x() / self.elapsed, axis.y() / self.elapsed);
        let w = self.earth.w_north();
        let level2 = a_e * a_e + a_n * a_n;
        let most = T::lit(4.0) * self.config.noise.gyro_bias_sd;
        let delta = T::lit(2.0) * w * a_n / level2;
        let gyro_bias_z = self.strapdown.gyro_bias_s.z() + delta;
        // An axis that is not tilted gives an infinite δ or none at all, and no second solution.
        (gyro_bias_z.abs() <= most).then(|| OtherSolution {
            heading_offset: math::atan2(a_e * delta, w - a_n * delta),
            gyro_bias_z,
        })
    }

    /// The figures it runs on.
    pub fn config(&self) -> &FilterConfig<T> {
        &self.config
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use frames::units::{DEG, DEG_PER_HOUR, MICRO_G};

    type V<F> = Vec3<F, f64>;

    /// A rotor at 20 °/s on a swinging base under gravity, 20 increments a second.
    fn increment(k: u32) -> Increment<f64> {
        let t = f64::from(k) * 0.05;
        let wave = |period: f64| math::sin_cos(core::f64::consts::TAU * t / period).0;
        Increment {
            phi_s: V::new(
                0.002 * wave(6.0),
                0.003 * wave(7.0),
                20.0 * DEG * 0.05 + 0.004 * wave(5.0),
            ),
            dv_s: V::new(0.02 * wave(3.0), -0.03 * wave(4.0), 9.8 * 0.05),
            dt: 0.05,
        }
    }

    /// The same turns, with the force of a base that does not accelerate: what the filter's f^n says.
    fn level_increment(k: u32) -> Increment<f64> {
        let earth = Earth::<f64>::new(40.0 * DEG, 0.0).unwrap();
        let mut c_ns = strapdown().c_ns;
        let turn = |k: u32| increment(k).phi_s - strapdown().gyro_bias_s * 0.05;
        for past in 0..k {
            c_ns.turn_from(turn(past));
        }
        let middle = c_ns.get() * Rot::exp(turn(k) * 0.5);
        Increment {
            dv_s: middle.inverse() * earth.g_n() * -0.05,
            ..increment(k)
        }
    }

    fn strapdown() -> Strapdown<f64> {
        Strapdown {
            c_ns: RotIntegral::new(Rot::from_quaternion(0.8, 0.05, -0.07, 0.6).unwrap()),
            v_n: V::new(0.001, -0.002, 0.003),
            gyro_bias_s: V::new(10.0, -5.0, 3.0) * DEG_PER_HOUR,
            accel_bias_s: V::new(100.0, 50.0, -80.0) * MICRO_G,
        }
    }

    /// Error state of `moved` against `reference`, in the filter's definition.
    fn error(moved: &Strapdown<f64>, reference: &Strapdown<f64>) -> [V<Nav>; BLOCKS] {
        let phi = -(moved.c_ns.get() * reference.c_ns.get().inverse()).log();
        let unlabelled = |v: V<Sensor>| V::from_vector(v.vector());
        [
            phi,
            moved.v_n - reference.v_n,
            -unlabelled(moved.gyro_bias_s - reference.gyro_bias_s),
            -unlabelled(moved.accel_bias_s - reference.accel_bias_s),
        ]
    }

    /// `reference` with component `axis` of error block `block` raised by `h`.
    fn perturbed(reference: &Strapdown<f64>, block: usize, axis: usize, h: f64) -> Strapdown<f64> {
        let mut unit = [0.0; 3];
        unit[axis] = h;
        let [x, y, z] = unit;
        let mut moved = *reference;
        match block {
            PHI => moved.c_ns.turn_to(-V::new(x, y, z)),
            DV => moved.v_n += V::new(x, y, z),
            BG => moved.gyro_bias_s -= V::new(x, y, z),
            _ => moved.accel_bias_s -= V::new(x, y, z),
        }
        moved
    }

    /// F against central differences of the mechanization over one second, relative to each block's size.
    #[test]
    fn transition_is_the_derivative_of_the_mechanization() {
        let earth = Earth::new(40.0 * DEG, 0.0).unwrap();
        let run = |mut s: Strapdown<f64>| {
            let mut interval = Interval::new();
            for k in 0..20 {
                let c_ns = s.advance(&level_increment(k), &earth);
                interval.push(0.05, &c_ns, &earth);
            }
            (s, interval)
        };
        let (_, interval) = run(strapdown());
        let mut phi = [[Matrix3::zeros(); BLOCKS]; BLOCKS];
        for (k, row) in phi.iter_mut().enumerate() {
            row[k] = Matrix3::identity();
        }
        for c in interval.couplings(&earth) {
            phi[c.row][c.col] += c.block;
        }
        for block in 0..BLOCKS {
            let h = [1e-5, 1e-3, 1e-6, 1e-4][block];
            for axis in 0..3 {
                let (plus, _) = run(perturbed(&strapdown(), block, axis, h));
                let (minus, _) = run(perturbed(&strapdown(), block, axis, -h));
                for (row, difference) in error(&plus, &minus).into_iter().enumerate() {
                    let numeric = difference.vector() / (2.0 * h);
                    let analytic: Vector3<f64> = phi[row][block].column(axis).into();
                    let scale = 1.0_f64.max(phi[row][block].amax());
                    // The swing within one increment is the largest term that Φ leaves out.
                    assert!(
                        (numeric - analytic).amax() < 2e-3 * scale,
                        "block ({row}, {block}) axis {axis}: {numeric} {analytic}"
                    );
                }
            }
        }
        // The parts that tell north are small: check them against their own size.
        let (plus, _) = run(perturbed(&strapdown(), PHI, 2, 1e-3));
        let (minus, _) = run(perturbed(&strapdown(), PHI, 2, -1e-3));
        let numeric = error(&plus, &minus)[PHI].x() / 2e-3;
        let expected = -earth.w_north();
        assert!(
            (numeric - phi[PHI][PHI][(0, 2)]).abs() < 1e-3 * expected.abs(),
            "{numeric} {expected}"
        );
        assert!(
            (numeric - expected).abs() < 1e-3 * expected.abs(),
            "φ̇_E = −ω_ie cos L φ_U"
        );
    }

    /// H against the mechanization: what is measured is V itself, and V moves one to one with δV alone.
    #[test]
    fn measurement_is_the_velocity_error() {
        for block in 0..BLOCKS {
            let h = 1e-4;
            let moved = perturbed(&strapdown(), block, 1, h);
            let z = (moved.v_n - strapdown().v_n) / h;
            let expected = if block == DV { V::new(0.0, 1.0, 0.0) } else { V::zero() };
            assert!((z - expected).norm() < 1e-9, "block {block}");
        }
    }

    fn filter(method: Method<f32>) -> FineFilter<f32> {
        let earth = Earth::new(f32::lit(40.0 * DEG), 0.0).unwrap();
        let config = FilterConfig {
            method,
            ..FilterConfig::default()
        };
        FineFilter::new(config, earth, strapdown().c_ns.get().cast()).unwrap()
    }

    fn increment_f32(k: u32) -> Increment<f32> {
        let Increment { phi_s, dv_s, .. } = increment(k);
        Increment {
            phi_s: phi_s.cast(),
            dv_s: dv_s.cast(),
            dt: 0.05,
        }
    }

    #[test]
    fn strong_tracking_with_factors_of_one_is_the_kalman_filter() {
        let none = Vector3::zeros();
        let Method::StrongTracking(policy) = Method::strong_tracking() else {
            unreachable!("by construction")
        };
        let mut kalman = filter(Method::Kalman);
        let mut ones = filter(Method::StrongTracking(StrongTracking {
            weights: [none; BLOCKS],
            ..policy
        }));
        let mut fading = filter(Method::StrongTracking(policy));
        let mut faded = false;
        for k in 0..2000 {
            let (a, b) = (kalman.step(&increment_f32(k)), ones.step(&increment_f32(k)));
            assert_eq!(a, b);
            faded |= fading.step(&increment_f32(k)).is_some_and(|i| i.fading > 1.0);
        }
        assert_eq!(kalman.strapdown, ones.strapdown);
        assert_eq!(kalman.covariance, ones.covariance);
        // This motion does not fit the model: a policy that may fade does.
        assert!(faded && fading.covariance != kalman.covariance);
        assert!(fading.covariance.is_sound());
    }

    /// A base at rest under a turning rotor, exactly: what the filter's model says, for hours.
    #[test]
    fn covariance_stays_sound_for_ten_hours_in_single_precision() {
        let earth = Earth::<f32>::new(f32::lit(40.0 * DEG), 0.0).unwrap();
        let c_nb = Rot::from_yaw_pitch_roll(0.4_f32, 0.05, -0.08);
        let schedule = crate::rotor::Schedule::<f64>::new(crate::rotor::RotorConfig::default()).unwrap();
        for method in [Method::Kalman, Method::strong_tracking()] {
            let noise = ImuNoise {
                gyro_instability_sd: f32::lit(3.0 * DEG_PER_HOUR),
                gyro_instability_tau: 100.0,
                ..ImuNoise::default()
            };
            let config = FilterConfig {
                method,
                noise,
                ..FilterConfig::default()
            };
            let mut filter = FineFilter::new(config, earth, c_nb * Rot::about_z(0.0)).unwrap();
            let mut sd = f32::INFINITY;
            for k in 0..720_000_u32 {
                let (t, dt) = (f64::from(k) * 0.05, 0.05);
                let (from, to) = (schedule.at(t).angle, schedule.at(t + dt).angle);
                let c_ns = c_nb * Rot::about_z(f32::lit(from));
                let earth_turn = c_ns.inverse() * earth.w_ie_n() * f32::lit(dt);
                let increment = Increment {
                    phi_s: Vec3::new(0.0, 0.0, f32::lit(to - from)) + earth_turn,
                    dv_s: c_ns.inverse() * earth.g_n() * f32::lit(-dt),
                    dt: f32::lit(dt),
                };
                if filter.step(&increment).is_some() {
                    assert!(filter.covariance.is_sound(), "{t} s");
                    assert!(filter.c_ns().quaternion().iter().all(|q| q.is_finite()));
                }
                if k == 12_000 {
                    sd = filter.covariance.variances(PHI).z;
                }
            }
            // With drifting biases heading settles; it neither vanishes nor grows.
            let end = filter.covariance.variances(PHI).z;
            assert!(end < 1.5 * sd && end > 0.1 * sd, "{sd:e} {end:e}");
            let truth = c_nb * Rot::about_z(f32::lit(schedule.at(36_000.0).angle));
            let off = filter.c_ns().angle_to(truth);
            assert!(off < f32::lit(0.3 * DEG), "{off}");
        }
    }

    #[test]
    fn tilt_is_less_certain_between_measurements() {
        let mut filter = filter(Method::Kalman);
        for k in 0..200 {
            filter.step(&increment_f32(k));
        }
        let at_measurement = filter.phi_covariance()[(0, 0)];
        assert_eq!(at_measurement, filter.covariance.block(PHI, PHI)[(0, 0)]);
        for k in 200..210 {
            filter.step(&increment_f32(k));
        }
        // Half a second of angle random walk, and a doubted gap on top.
        let walk = filter.config.noise.angle_random_walk.powi(2) * 0.5;
        assert!((filter.phi_covariance()[(0, 0)] - at_measurement - walk).abs() < 0.01 * walk);
        filter.doubt(1e-3, 0.0);
        assert!((filter.phi_covariance()[(2, 2)] - filter.covariance.block(PHI, PHI)[(2, 2)]).abs() > 0.99e-6);
    }

    #[test]
    fn config_errors_name_the_figure() {
        let good = FilterConfig::<f32>::default();
        assert_eq!(good.validate(), Ok(()));
        let noise = ImuNoise {
            angle_random_walk: 0.0,
            ..good.noise
        };
        assert_eq!(FilterConfig { noise, ..good }.validate(), Err(FilterConfigError::Noise));
        assert_eq!(
            FilterConfig {
                velocity_sd: -1.0,
                ..good
            }
            .validate(),
            Err(FilterConfigError::VelocitySd)
        );
        assert_eq!(
            FilterConfig {
                measure_every: f32::NAN,
                ..good
            }
            .validate(),
            Err(FilterConfigError::MeasureEvery)
        );
        assert_eq!(
            FilterConfig {
                heading_sd: 0.0,
                ..good
            }
            .validate(),
            Err(FilterConfigError::StartSd)
        );
        let Method::StrongTracking(policy) = Method::strong_tracking() else {
            unreachable!("by construction")
        };
        let method = Method::StrongTracking(StrongTracking {
            softening: 0.5,
            ..policy
        });
        assert_eq!(
            FilterConfig { method, ..good }.validate(),
            Err(FilterConfigError::StrongTracking)
        );
    }
}
