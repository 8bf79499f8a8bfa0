//! Fine alignment: Kalman filter of the strapdown's errors, plain or strong-tracking, with as many states as asked for.
//!
//! The strapdown integrates attitude, velocity and displacement in n from increments that the estimated sensor errors
//! have corrected; the base stays where it is, so the velocity (or displacement) it finds is its own error, measured.
//! The states and how they move are those of [`model`](crate::model); the number of blocks `B` says which of them
//! there are, and what is measured:
//!
//! ```text
//! B ≤ 4    z = δV + noise     [Xing18]: the base has no velocity, to `velocity_sd`
//! B > 4    z = δp + noise     the base stays about where it is; how closely is found by [`adaptive_noise`](crate::adaptive_noise)
//! ```
//!
//! The integrals of the model are summed with the increments, so that one prediction and one measurement a second
//! lose nothing of the motion in between.
//!
//! The loop is open at first: the error is estimated, linear about the path that the strapdown takes by
//! itself from its start, and stays out of it. A first estimate of heading may be off by tens of degrees
//! for seconds, and to feed it back would linearise all that follows about it (heading RMS 1.4° where
//! 0.45° is possible, in `paper-turntable`). Once the loop is closed, each estimated error is taken out of the
//! strapdown at once, the state returns to zero, and only P lives on. A filter with δω feeds back all but heading from
//! the start: its model is linear in all that is large, and heading alone may stay open for minutes.
//!
//! Where the rotor's axis is tilted two headings may fit what has been measured, each with a z gyro bias of its own (see
//! [`north`](crate::north)). What follows tells them apart: with the wrong bias the frame turns away from Earth. But each
//! reads that the other way round, and a filter about the wrong one goes on from bad to worse with a small σ. So
//! [`FineFilter::split`] makes one filter of each, and [`Innovation::surprisal`] says which of them the measurements bear
//! out. The caller keeps both until it is known.
//!
//! A split filter knows heading to tens of degrees, and what its errors are correlated with (g-sensitivity under a constant
//! tilt cannot be told from Earth's rate) is fixed to the housing. To turn the frame by each new estimate would turn that
//! against what is already in P, and every turn would pass for information that nobody measured: σ of 3° where 6° is
//! true. The first estimate is therefore kept to be linear about until heading has moved by its own σ (first-estimates
//! Jacobians: G. Huang, A. Mourikis and S. Roumeliotis, *Analysis and Improvement of the Consistency of Extended Kalman
//! Filter based SLAM*, ICRA 2008).
//!
//! The *measurement* is one per second and not one per sample by choice: a strong-tracking filter
//! that measures at 20 Hz never sees a bias step in one innovation, and the cost falls by twenty.
//!
//! Not modelled here: Coriolis acceleration (2 ω_ie V, below 1e-7 m/s² while V is an error).

use frames::{Body, Nav, Real, Rot, Sensor, Vec3, VecSum, math, units};
use nalgebra::{Matrix3, Vector3};

use crate::{
    adaptive_noise::{AdaptiveNoise, AdaptiveNoiseConfig},
    constraint::{self, ConstraintConfig, Row, ScalarInnovation, StationarityDetector},
    covariance::{Covariance, TransitionBlock},
    deviation::Deviation,
    earth::Earth,
    fading::{Fading, StrongTracking},
    increment::Increment,
    model::{ACCEL_COLUMNS, BA, BG, DP, DV, GM, GX, GY, GYRO_TERMS, GyroDrive, HB, Interval, MZ, PHI, ROBUST, WE},
    noise::ImuNoise,
    north::{Direction, North},
    strapdown::{Corrections, Strapdown},
};

/// How the covariance is predicted.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Method<T: Real = f32, const B: usize = ROBUST> {
    /// Kalman filter, \[Xing18\] (21)–(25).
    Kalman,
    /// Strong-tracking filter, \[Xing18\] (26).
    StrongTracking(StrongTracking<T, B>),
}

impl<T: Real, const B: usize> Method<T, B> {
    /// Strong tracking as it was measured to pay: factors on the gyro biases alone.
    pub fn strong_tracking() -> Self {
        let mut weights = [Vector3::zeros(); B];
        weights[BG] = Vector3::repeat(T::one());
        Self::StrongTracking(StrongTracking {
            forgetting: T::lit(0.95),
            softening: T::lit(6.0),
            weights,
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
/// | `adaptive_noise` | – | see [`AdaptiveNoiseConfig`] | its default |
/// | `measure_every` | s | every increment is a measurement | 1 s |
/// | `tilt_sd` | rad | refused | 0.2° |
/// | `heading_sd` | rad | refused | 90° |
/// | `latitude_sd` | rad | latitude known | 0 |
/// | `deviation` | SI | `None`: nothing beyond `noise` | what an alignment at several headings has found |
/// | `method` | – | – | [`Method::Kalman`] |
/// | `encoder_constraint` | – | `None`: the base may yaw | `None` but for a base fixed to Earth |
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FilterConfig<T: Real = f32, const B: usize = ROBUST> {
    /// What the IMU does to the signal.
    pub noise: ImuNoise<T>,
    /// 1σ of the base's velocity about zero at a measurement, each axis, m/s, where velocity is measured. What counts
    /// is `velocity_sd² · measure_every`: 0.1 mm/s each second says what 1 mm/s at 100 Hz does.
    pub velocity_sd: T,
    /// How far the base may be from where it is in the mean, where displacement is measured.
    pub adaptive_noise: AdaptiveNoiseConfig<T>,
    /// Time between measurements, s.
    pub measure_every: T,
    /// 1σ of pitch and roll at the start, rad.
    pub tilt_sd: T,
    /// 1σ of heading at the start, rad. Wide on purpose: the coarse result that the filter starts from
    /// comes from the same samples, and is a point to linearise about, not a second opinion.
    pub heading_sd: T,
    /// 1σ of the configured latitude, rad, where δω is estimated.
    pub latitude_sd: T,
    /// What is known already of the gyro error that is constant in the housing, for a filter with all blocks.
    pub deviation: Option<Deviation<T>>,
    /// Kalman or strong tracking.
    pub method: Method<T, B>,
    /// That the base is fixed to Earth, so that the rotor's encoder measures the z gyro.
    pub encoder_constraint: Option<EncoderConstraint<T, B>>,
}

impl<T: Real, const B: usize> Default for FilterConfig<T, B> {
    fn default() -> Self {
        use frames::units::DEG;
        Self {
            noise: ImuNoise::default(),
            velocity_sd: T::lit(1e-4),
            adaptive_noise: AdaptiveNoiseConfig::default(),
            measure_every: T::one(),
            tilt_sd: T::lit(0.2 * DEG),
            heading_sd: T::lit(90.0 * DEG),
            latitude_sd: T::zero(),
            deviation: None,
            method: Method::Kalman,
            encoder_constraint: None,
        }
    }
}

/// Says that the base is fixed to Earth, and so that the encoder measures the z gyro: see [`constraint`].
///
/// It carries the way to its code, and nothing else does: an image in which none is made is linked without that code.
#[derive(Debug, Clone, Copy)]
pub struct EncoderConstraint<T: Real = f32, const B: usize = ROBUST> {
    config: ConstraintConfig<T>,
    measure_and_feed_back: fn(&mut FineFilter<T, B>, &ConstraintConfig<T>),
}

/// By the figures: there is one measurement for each type.
impl<T: Real, const B: usize> PartialEq for EncoderConstraint<T, B> {
    fn eq(&self, other: &Self) -> bool {
        self.config == other.config
    }
}

impl<T: Real, const B: usize> EncoderConstraint<T, B> {
    /// With these figures; `None` where one is negative or not finite.
    pub fn new(config: ConstraintConfig<T>) -> Option<Self> {
        config.is_valid().then_some(Self {
            config,
            measure_and_feed_back: FineFilter::measure_turn_and_feed_back,
        })
    }

    /// Its figures.
    pub fn config(&self) -> &ConstraintConfig<T> {
        &self.config
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
    /// A figure of `adaptive_noise` is out of range.
    AdaptiveNoise,
    /// `measure_every` must not be negative.
    MeasureEvery,
    /// `tilt_sd` and `heading_sd` must be positive, `latitude_sd` not negative.
    StartSd,
    /// The deviation is not finite, or its σ is not positive.
    Deviation,
    /// A strong-tracking figure is out of range.
    StrongTracking,
}

impl core::fmt::Display for FilterConfigError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.write_str(match self {
            Self::Noise => "IMU noise figures must be finite and not negative, and the angle random walk positive",
            Self::VelocitySd => "velocity_sd must be positive",
            Self::AdaptiveNoise => "adaptive noise needs positive spreads and gate, 0 <= memory < 1, correlation >= 1",
            Self::MeasureEvery => "measure_every must not be negative",
            Self::StartSd => "tilt_sd and heading_sd must be positive, latitude_sd not negative",
            Self::Deviation => "a deviation must be finite, and its 1 sigma positive",
            Self::StrongTracking => {
                "strong tracking needs 0 <= forgetting <= 1, softening >= 1, weights >= 0, limit >= 1"
            }
        })
    }
}

impl core::error::Error for FilterConfigError {}

impl<T: Real, const B: usize> FilterConfig<T, B> {
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
        if !self.adaptive_noise.is_valid() {
            return Err(FilterConfigError::AdaptiveNoise);
        }
        if !(self.measure_every.finite() && self.measure_every >= T::zero()) {
            return Err(FilterConfigError::MeasureEvery);
        }
        let latitude = self.latitude_sd.finite() && self.latitude_sd >= T::zero();
        if !(positive(self.tilt_sd) && positive(self.heading_sd) && latitude) {
            return Err(FilterConfigError::StartSd);
        }
        if !self.deviation.as_ref().is_none_or(Deviation::is_valid) {
            return Err(FilterConfigError::Deviation);
        }
        match &self.method {
            Method::StrongTracking(policy) if !policy.is_valid() => Err(FilterConfigError::StrongTracking),
            _ => Ok(()),
        }
    }
}

/// 1σ of heading at which a filter with δω closes its loop, rad: the error of linearising about it is then 0.01°.
pub const CLOSING_SD: f64 = 1.0 * units::DEG;

/// How much likelier the heading found must be than the other that fits, as the difference of their squared distances
/// in σ, for the loop to close.
pub(crate) const CERTAIN: f64 = 16.0;

/// 1σ up to which fading makes the gyro biases uncertain anew, rad/s. A bias may step while the unit runs, but not as far as
/// from one start to the next: fading up to 250 °/h loses the z bias, and heading with it.
const FADED_BIAS_SD: f64 = 10.0 * units::DEG_PER_HOUR;

/// 1σ of each component of Earth's level rate before anything is measured, in units of its length: wide enough that the
/// heading of the start is no likelier than any other (one would favour it over its opposite by 4 in cost, this by 0.4).
const LEVEL_RATE_SD: f64 = 3.0;

/// Change of the estimated direction of Earth's rate after which the frame is turned to it, rad.
const TURNING: f64 = 0.5 * units::DEG;

/// A thousandth of the walk of one second, rad/s: what this adds to a gyro's error is nothing. Columns of M take it
/// at 1 rad/s, those of G at 10 m/s².
fn negligible_rate<T: Real>(noise: &ImuNoise<T>) -> T {
    noise.angle_random_walk * T::lit(1e-3)
}

/// Innovation of one measurement that the base stands still.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Innovation<T: Real = f32> {
    /// Measured less predicted: velocity, m/s, or displacement, m.
    pub residual: Vec3<Nav, T>,
    /// Normalised innovation squared, over the three components: 3 in the mean where the model holds.
    pub nis: T,
    /// Largest fading factor applied, one for the Kalman filter.
    pub fading: T,
    /// It was too far off to be one, and was not taken.
    pub refused: bool,
    /// −2 ln of its probability density as it was expected, less a constant: what says which of two filters is right.
    pub surprisal: T,
}

/// Φ x.
fn propagated<T: Real, const B: usize>(x: &[Vector3<T>; B], transition: &[TransitionBlock<T>]) -> [Vector3<T>; B] {
    let mut moved = *x;
    for TransitionBlock { row, col, block } in transition {
        if let (Some(sum), Some(x)) = (moved.get_mut(*row), x.get(*col)) {
            *sum += block * x;
        }
    }
    moved
}

/// Measurements of the length of Earth's level rate, each with so many times its variance: one takes no more than its
/// share of what is known already (see [`LARGEST_CUT`](crate::covariance::LARGEST_CUT)).
const PARTS: usize = 3;

/// The filter of fine alignment, with `B` blocks of states.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FineFilter<T: Real = f32, const B: usize = ROBUST> {
    config: FilterConfig<T, B>,
    earth: Earth<T>,
    strapdown: Strapdown<T>,
    covariance: Covariance<T, B>,
    /// Estimated error of the strapdown. Once the loop is closed, and in a filter with δω always, zero but for δω.
    error: [Vector3<T>; B],
    closed: bool,
    /// The loop closes as soon as heading is known well enough.
    closing: bool,
    /// Where north is, while δω says it.
    north: North<T>,
    /// Variances beyond which fading makes no state less known: those at the start, and of the gyro biases
    /// [`FADED_BIAS_SD`] at the most.
    faded: [Vector3<T>; B],
    /// Component x (y) of the rotor's axis in s for one of the accelerometer bias, rad per m/s²: what the misalignment of
    /// the gyros has in the prior of that bias.
    axis_by_bias: T,
    interval: Interval<T, B>,
    fading: Fading<T>,
    adaptive_noise: AdaptiveNoise<T>,
    /// Measurements refused since the start.
    refused: u32,
    /// Whether the base is one to be measured by, where it was said to be.
    stationarity: StationarityDetector<T>,
    /// ∫ of the rotor's axis in n, s, and its time, s.
    axis_n: VecSum<Nav, T>,
    /// ∫ of the specific force in b, m/s.
    force_b: VecSum<Body, T>,
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

impl<T: Real, const B: usize> FineFilter<T, B> {
    /// The block that is measured.
    const MEASURED: usize = if B > DP { DP } else { DV };

    /// Starts from an attitude, at rest, with unknown sensor errors, and what is already known of the base's motion.
    ///
    /// # Errors
    /// [`FilterConfigError`] where a figure is out of range.
    pub fn new(
        config: FilterConfig<T, B>,
        earth: Earth<T>,
        c_ns: Rot<Nav, Sensor, T>,
        adaptive_noise: Option<AdaptiveNoise<T>>,
    ) -> Result<Self, FilterConfigError> {
        const { assert!(B > BA && B <= ROBUST, "the model has 4 to 15 blocks") }
        config.validate()?;
        let square = |x: T| x * x;
        let noise = &config.noise;
        // A state without any variance cannot be in a covariance: what is known is known to that.
        let little = negligible_rate(noise);
        let least = |sd: T, least: T| square(sd.max(least));
        let mut prior = [Vector3::zeros(); B];
        let (tilt, heading) = (square(config.tilt_sd), square(config.heading_sd));
        prior[PHI] = Vector3::new(tilt, tilt, heading);
        // Third columns of G and A act by f_z, which is g: part of the biases.
        let g = earth.gravity();
        let by_gravity = square(noise.gyro_g_sensitivity_sd * g);
        prior[BG] = Vector3::repeat(least(noise.gyro_bias_sd, little) + by_gravity);
        let little_accel = noise.velocity_random_walk.max(T::lit(1e-6)) * T::lit(1e-3);
        let accel_bias = least(noise.accel_bias_sd, little_accel) + square(noise.accel_instability_sd);
        // A rotation common to gyros and accelerometers is not observable. s is the frame of the gyros as they sense the
        // rotor: M_xz = M_yz = 0, z of s is off the rotor's axis, and the accelerometers are misaligned by as much.
        let misaligned = if B > MZ {
            square(noise.gyro_misalignment_sd)
        } else {
            T::zero()
        };
        let level = accel_bias + (square(noise.accel_misalignment_sd) + misaligned) * square(g);
        let axis_by_bias = -misaligned * g / level;
        prior[BA] = Vector3::new(level, level, accel_bias + square(noise.accel_scale_factor_sd * g));
        prior[DV] = Vector3::repeat(square(if B > DP {
            config.adaptive_noise.prior_velocity_sd
        } else {
            config.velocity_sd
        }));
        let mut set = |block: usize, variances: Vector3<T>| {
            // A small filter has none of them.
            if let Some(place) = prior.get_mut(block) {
                *place = variances;
            }
        };
        let column = |axis: usize, scale: T, misalignment: T| {
            Vector3::from_fn(|row, _| if row == axis { scale } else { misalignment })
        };
        set(DP, Vector3::repeat(square(config.adaptive_noise.prior_sd)));
        set(GM, Vector3::repeat(least(noise.gyro_instability_sd, little)));
        let scale = least(noise.gyro_scale_factor_sd, little);
        let misalignment = least(noise.gyro_misalignment_sd, little);
        let by_force = least(noise.gyro_g_sensitivity_sd, little * T::lit(0.1));
        for (block, drive) in GYRO_TERMS {
            match drive {
                GyroDrive::Rate(2) => set(block, Vector3::new(square(little), square(little), scale)),
                GyroDrive::Rate(axis) => {
                    let own = column(axis, scale, misalignment);
                    set(block, own + Vector3::z() * misaligned);
                }
                GyroDrive::Force(_) => set(block, Vector3::repeat(by_force)),
                GyroDrive::Bias | GyroDrive::Earth | GyroDrive::Housing => {}
            }
        }
        let scale = least(noise.accel_scale_factor_sd, little_accel * T::lit(0.1));
        let misalignment = least(noise.accel_misalignment_sd, little_accel * T::lit(0.1));
        for (block, axis) in ACCEL_COLUMNS {
            set(block, column(axis, scale, misalignment) + Vector3::z() * misaligned);
        }
        // Along the rotor's axis it is part of the bias.
        let housing = least(noise.gyro_housing_sd, little);
        set(HB, Vector3::new(housing, housing, square(little)));
        if B > WE {
            let level = square(earth.w_north() * T::lit(LEVEL_RATE_SD) * config.heading_sd.min(T::one()));
            prior[PHI].z = square(little);
            prior[WE] = Vector3::new(level, level, least(earth.w_north() * config.latitude_sd, little));
        }
        let mut faded = prior;
        let most = T::lit(FADED_BIAS_SD * FADED_BIAS_SD);
        faded[BG] = prior[BG].map(|variance| variance.min(most));
        let mut strapdown = Strapdown::new(c_ns);
        let mut covariance = Covariance::diagonal(prior);
        if let Some(deviation) = config.deviation.filter(|_| B > HB) {
            strapdown.correct(&deviation.measured(&mut covariance));
        }
        Ok(Self {
            config,
            earth,
            strapdown,
            covariance,
            error: [Vector3::zeros(); B],
            closed: false,
            closing: false,
            north: North::ahead(),
            faded,
            axis_by_bias,
            interval: Interval::new(),
            fading: Fading::new(),
            adaptive_noise: adaptive_noise.unwrap_or(AdaptiveNoise::new(config.adaptive_noise)),
            refused: 0,
            stationarity: StationarityDetector::new(),
            axis_n: VecSum::new(Vec3::zero()),
            force_b: VecSum::new(Vec3::zero()),
            elapsed: T::zero(),
        })
    }

    /// Centres the prior of the gyro biases on `bias_s`, rad/s, with the 1σ that they have. For a start.
    ///
    /// The model is linear about the biases that the strapdown is corrected by: a z bias that turns it by tens of degrees
    /// before it is found is not.
    #[must_use]
    pub fn about_gyro_bias(mut self, bias_s: Vec3<Sensor, T>) -> Self {
        self.strapdown.corrections.gyro_bias_s = bias_s;
        self
    }

    /// Integrates one increment, at whose end the rotor is at the angle `alpha`, rad, and measures where it is time.
    pub fn step(&mut self, increment: &Increment<T>, alpha: T) -> Option<Innovation<T>> {
        self.integrate(increment, alpha);
        self.is_due(increment).then(|| self.measure(None))
    }

    /// The same beside `leader`, the other filter of a [split](Self::split), which has had the increment and, where it has
    /// measured, `refused` the measurement or not: with its estimate of the base's displacement, for the two can only be
    /// compared by one.
    pub fn step_beside(
        &mut self,
        increment: &Increment<T>,
        alpha: T,
        leader: &Self,
        refused: bool,
    ) -> Option<Innovation<T>> {
        self.integrate(increment, alpha);
        let given = (&leader.adaptive_noise, refused);
        self.is_due(increment).then(|| self.measure(Some(given)))
    }

    fn integrate(&mut self, increment: &Increment<T>, alpha: T) {
        let c_ns = self.strapdown.advance(increment, alpha, &self.earth);
        self.interval.push(increment, alpha, &c_ns, &self.earth);
        self.axis_n.add(Vec3::from_vector(c_ns.column(2) * increment.dt));
        let middle = alpha - increment.phi_s.z() * T::lit(0.5);
        self.force_b
            .add(Rot::<Body, Sensor, T>::about_z(middle) * increment.dv_s);
        self.elapsed += increment.dt;
    }

    /// The gyro error that is constant in the housing, under the housing's mean tilt since the start; `None` for a filter
    /// without a state for it, and before the loop is closed.
    pub fn deviation(&self) -> Option<Deviation<T>> {
        if B <= HB || !self.closed {
            return None;
        }
        let mut state = self.error;
        let Corrections {
            g_sensitivity,
            housing_b,
            ..
        } = &self.strapdown.corrections;
        for (block, found) in [
            (GX, g_sensitivity.column(0).into_owned()),
            (GY, g_sensitivity.column(1).into_owned()),
            (HB, housing_b.vector()),
        ] {
            if let Some(part) = state.get_mut(block) {
                *part += found;
            }
        }
        let force_b = self.force_b.get() / self.elapsed;
        Some(Deviation::found(&state, &self.covariance, [force_b.x(), force_b.y()]))
    }

    /// Whether it is time to measure, to within half an increment.
    fn is_due(&self, increment: &Increment<T>) -> bool {
        self.interval.dt() + increment.dt * T::lit(0.5) >= self.config.measure_every
    }

    /// Says at which angle the rotor is at the end of the next increment, rad; `None` where that is not known. It holds
    /// until it is said again.
    ///
    /// The [encoder constraint](constraint) needs it at each measurement, and nothing else does.
    pub fn rotor_at(&mut self, alpha: Option<T>) {
        self.stationarity.alpha = alpha;
    }

    /// Says that the next increment does not tell all: 1σ of the turn (rad) and of the velocity (m/s)
    /// that it may have missed on each axis.
    pub fn inflate_covariance(&mut self, phi_sd: T, dv_sd: T) {
        self.interval.inflate_covariance(phi_sd, dv_sd);
    }

    /// Velocity or displacement of the strapdown: what is measured.
    fn observed(&self) -> Vector3<T> {
        if B > DP {
            self.strapdown.p_n.vector()
        } else {
            self.strapdown.v_n.vector()
        }
    }

    /// Noise variance of one component of the measurement.
    fn measurement_var(&self, axis: usize) -> T {
        if B > DP {
            self.adaptive_noise.variance(axis)
        } else {
            self.config.velocity_sd * self.config.velocity_sd
        }
    }

    /// Predicts P over the interval, then measures ((21)–(25), (26)), with the base's displacement, and whether to
    /// refuse, as found or as `given`.
    fn measure(&mut self, given: Option<(&AdaptiveNoise<T>, bool)>) -> Innovation<T> {
        let measured = Self::MEASURED;
        let noise = self.config.noise;
        let transition = self.interval.transition(&noise, &self.earth);
        let mut error = propagated(&self.error, &transition);
        let observed = self.observed();
        let residual = observed - error[measured];

        let mut fading = T::one();
        if let Method::StrongTracking(policy) = &self.config.method {
            let mut predicted = self.covariance;
            predicted.propagate(&transition);
            let m = predicted.block(measured, measured);
            self.interval.add_noise(&mut predicted, &noise, &self.earth);
            let q = predicted.block(measured, measured) - m;
            let r = self.measurement_var(0);
            let mut factors = self.fading.factors(policy, &residual, &m, &q, r);
            for (k, block) in factors.iter_mut().enumerate() {
                let room = self.faded[k].component_div(&self.covariance.variances(k));
                *block = block.zip_map(&room, |f, room| f.min(room).max(T::one()));
            }
            fading = factors.iter().fold(T::one(), |most, f| most.max(f.max()));
            if fading > T::one() {
                self.covariance.fade(&factors);
            }
        }
        self.covariance.propagate(&transition);
        self.interval.add_noise(&mut self.covariance, &noise, &self.earth);
        if B > GM {
            let decay = noise.gyro_instability_decay(self.interval.dt());
            let instability = &mut self.strapdown.corrections.gyro_instability_s;
            *instability = *instability * decay;
        }

        let predicted = self.covariance.variances(measured);
        let refused = match given {
            Some((adaptive_noise, refused)) => {
                self.adaptive_noise = *adaptive_noise;
                refused
            }
            None if B > DP => {
                let normalised =
                    |axis: usize| residual[axis] * residual[axis] / (predicted[axis] + self.measurement_var(axis));
                let largest = (0..3).map(normalised).fold(T::zero(), |most, x| most.max(x));
                !self.adaptive_noise.accepts(largest)
            }
            None => false,
        };
        let (mut nis, mut surprisal) = (T::zero(), T::zero());
        if refused {
            self.refused += 1;
        } else {
            if B > DP && given.is_none() {
                self.adaptive_noise.learn(&residual, &predicted);
            }
            let r = core::array::from_fn(|axis| self.measurement_var(axis));
            for (axis, gain) in self.covariance.update_block(measured, r).iter().enumerate() {
                let residual = observed[axis] - error[measured][axis];
                let normalised = residual * residual / gain.innovation_var;
                nis += normalised;
                surprisal += normalised + math::ln(gain.innovation_var);
                for (part, column) in error.iter_mut().zip(&gain.column) {
                    *part += column * residual;
                }
            }
        }
        self.error = error;
        match self.config.encoder_constraint {
            Some(constraint) => (constraint.measure_and_feed_back)(self, constraint.config()),
            None => self.feed_back(),
        }
        self.interval = Interval::new();
        Innovation {
            residual: Vec3::from_vector(residual),
            nis,
            fading,
            refused,
            surprisal,
        }
    }

    /// The other heading, where it fits nearly as well as the best.
    fn other_heading(&self) -> Option<Direction<T>> {
        let limit = self.north.best.cost + T::lit(CERTAIN);
        self.north.other.filter(|other| other.cost <= limit)
    }

    /// Whether another heading fits as well, and the filter is to be [split](Self::split).
    pub fn is_ambiguous(&self) -> bool {
        B > WE && !self.closed && self.other_heading().is_some()
    }

    /// Makes of an [ambiguous](Self::is_ambiguous) filter and `copy`, a copy of it, one filter about each of two headings:
    /// this one about the likelier. Returns how much less likely the other is, as −2 ln of the ratio.
    ///
    /// Both know the length of Earth's level rate from here on, and heading is one angle.
    pub fn split(&mut self, copy: &mut Self) -> T {
        let best = self.north.best;
        let other = self.other_heading().unwrap_or(best);
        for (filter, direction) in [(&mut *self, best), (&mut *copy, other)] {
            filter.north = North {
                best: direction,
                other: None,
            };
            filter.close();
            filter.apply_correction();
        }
        // The density at its highest, times its width.
        other.cost - best.cost + math::ln(self.heading_var() / copy.heading_var())
    }

    /// Measures that the base has not turned about the vertical (see [`constraint`]), between what is
    /// measured otherwise and feedback.
    pub(crate) fn measure_turn_and_feed_back(&mut self, config: &ConstraintConfig<T>) {
        self.measure_turn(config);
        self.feed_back();
        // What the strapdown is from here on is what the next turn is measured from.
        self.stationarity.mark(self.strapdown.c_ns.get());
    }

    fn measure_turn(&mut self, config: &ConstraintConfig<T>) {
        let Some(turn) = self.stationarity.turn(self.strapdown.c_ns.get()) else {
            return;
        };
        let noise = &self.config.noise;
        let mut walk_var = self.interval.phi_noise(noise)[(2, 2)];
        if B <= MZ {
            // A scale factor that is no state.
            let by_scale = noise.gyro_scale_factor_sd * turn.rotor;
            walk_var += by_scale * by_scale;
        }
        let h = self.interval.turn_row(&self.earth);
        let row = Row::new(&self.covariance, &h);
        let z = ScalarInnovation {
            residual: turn.base.z() - constraint::product(&h, &self.error),
            predicted_var: row.predicted_var,
            walk_var,
        };
        if let Some(r) = self.stationarity.judge(config, &turn, &z, self.interval.dt()) {
            let gain = row.update(&mut self.covariance, r);
            for (part, column) in self.error.iter_mut().zip(&gain.column) {
                *part += column * z.residual;
            }
            self.stationarity
                .took(z.residual * z.predicted_var / gain.innovation_var);
        }
    }

    /// Whether the encoder constraint is in force: the base has been seen to rest.
    pub fn is_constrained(&self) -> bool {
        self.stationarity.holds()
    }

    /// From now on takes each estimated error out of the strapdown at once, or as soon as the model allows.
    ///
    /// Until then the error is only estimated, linear about the path that the strapdown itself takes from
    /// its start: the optimum of the linear problem, whatever the estimate goes through on its way. A filter with δω
    /// waits until it knows heading to [`CLOSING_SD`].
    pub fn close_loop(&mut self) {
        self.closing = true;
        if B <= WE {
            let transition = self.interval.transition(&self.config.noise, &self.earth);
            self.error = propagated(&self.error, &transition);
            self.closed = true;
            self.apply_correction();
            self.stationarity.forget();
        }
    }

    /// Follows a measurement: an estimate leaves the strapdown where the loop is closed, and closes it where it may.
    // Once in an image, though there are two to call it.
    #[inline(never)]
    fn feed_back(&mut self) {
        if B > WE && !self.closed {
            self.find_north();
            let certain = self.other_heading().is_none();
            if self.closing && certain && self.heading_var() < T::lit(CLOSING_SD * CLOSING_SD) {
                self.close();
            } else if self.north.best.angle.abs() > T::lit(TURNING) {
                self.turn_to_north();
            }
        }
        if self.closed || B > WE {
            self.apply_correction();
        }
    }

    /// Variance of the length of Earth's level rate, (rad/s)².
    fn length_var(&self) -> T {
        let by_latitude = self.earth.w_ie_n().z() * self.config.latitude_sd;
        let little = negligible_rate(&self.config.noise);
        by_latitude * by_latitude + little * little
    }

    fn find_north(&mut self) {
        let unit = T::one() / self.earth.w_north();
        let rate = (self.earth.w_ie_n().vector() + self.error[WE]).xy() * unit;
        let covariance = self.covariance.block(WE, WE).fixed_view::<2, 2>(0, 0) * (unit * unit);
        self.north = North::find(&rate, &covariance, self.length_var() * unit * unit);
    }

    /// Turns the frame of everything so that north, as estimated, is ahead.
    ///
    /// The model holds about the direction that Earth's rate is taken to have: φ_U times what δω adds to it is left
    /// out, and would be 0.1° of heading for 0.4° of drift at 15°.
    fn turn_to_north(&mut self) {
        let matrix = self.northward().matrix();
        let w_ie_n = self.earth.w_ie_n().vector();
        for block in [PHI, DV, DP] {
            self.error[block] = matrix * self.error[block];
        }
        self.error[WE] = matrix * (w_ie_n + self.error[WE]) - w_ie_n;
        self.turn_frame();
    }

    /// The same without the estimated error.
    fn turn_frame(&mut self) {
        let turn = self.northward();
        let transition = [PHI, DV, DP, WE].map(|block| TransitionBlock {
            row: block,
            col: block,
            block: turn.matrix() - Matrix3::identity(),
        });
        self.covariance.propagate(&transition);
        self.strapdown.turn(turn);
        let angle = self.north.best.angle;
        self.north.best.angle = T::zero();
        if let Some(other) = &mut self.north.other {
            other.angle -= angle;
        }
    }

    /// Closes the loop: north, as estimated, is ahead, what is uncertain in the direction of Earth's level rate is heading,
    /// φ_U, and the length of that rate is known.
    fn close(&mut self) {
        self.error = self.closed_error(&self.error);
        self.turn_frame();
        let (mut to_heading, mut gone, mut least) = (Matrix3::zeros(), Matrix3::zeros(), Matrix3::zeros());
        to_heading[(2, 0)] = T::one() / self.earth.w_north();
        gone[(0, 0)] = -T::one();
        let transition = [(PHI, to_heading), (WE, gone)].map(|(row, block)| TransitionBlock { row, col: WE, block });
        self.covariance.propagate(&transition);
        // A state without any variance cannot be in a covariance: known to 1e-5 rad of heading.
        let little = self.earth.w_north() * T::lit(1e-5);
        least[(0, 0)] = little * little;
        self.covariance.add(WE, WE, &least);
        for _ in 0..PARTS {
            self.covariance.update(WE, 1, self.length_var() * T::lit(PARTS as f64));
        }
        self.closed = true;
    }

    /// What [closing the loop](Self::close) makes of an estimated error.
    fn closed_error(&self, error: &[Vector3<T>; B]) -> [Vector3<T>; B] {
        let matrix = self.northward().matrix();
        let w_ie_n = self.earth.w_ie_n().vector();
        let rate = matrix * (w_ie_n + error[WE]) - w_ie_n;
        // The length is measured along `ahead`.
        let ahead = matrix.row(1).transpose();
        let own = self.covariance.block(WE, WE) * ahead;
        let gain = -rate.y / (ahead.dot(&own) + self.length_var());
        let mut closed = core::array::from_fn(|block| error[block] + self.covariance.block(block, WE) * ahead * gain);
        for block in [PHI, DV, DP] {
            closed[block] = matrix * closed[block];
        }
        let rate = rate + matrix * own * gain;
        closed[PHI].z += rate.x / self.earth.w_north();
        closed[WE] = Vector3::new(T::zero(), rate.y, rate.z);
        closed
    }

    /// From the strapdown's frame to the one in which north, as estimated, is ahead.
    fn northward(&self) -> Rot<Nav, Nav, T> {
        // Clockwise by ψ is where north is; counter-clockwise by ψ the frame's content must turn.
        Rot::exp(Vec3::new(T::zero(), T::zero(), self.north.best.angle))
    }

    /// Variance of heading, whichever states hold it, rad².
    fn heading_var(&self) -> T {
        self.phi_now()[(2, 2)]
    }

    /// Covariance of the attitude errors at the last measurement, in n.
    fn phi_now(&self) -> Matrix3<T> {
        if B <= WE || self.closed {
            return self.covariance.block(PHI, PHI);
        }
        // What closing the loop would do, to these two blocks alone: the length is known, `ahead` along Earth's level
        // rate, and what is uncertain across it is heading.
        let (sin, cos) = math::sin_cos(self.north.best.angle);
        let (ahead, across) = (Vector3::new(sin, cos, T::zero()), Vector3::new(cos, -sin, T::zero()));
        let (p_phi_we, p_we) = (self.covariance.block(PHI, WE), self.covariance.block(WE, WE));
        let (phi_ahead, we_ahead) = (p_phi_we * ahead, p_we * ahead);
        let known = T::one() / (ahead.dot(&we_ahead) + self.length_var());
        let by_rate = T::one() / self.earth.w_north();
        let across_ahead = across.dot(&we_ahead) * known;
        let cross = (p_phi_we * across - phi_ahead * across_ahead) * by_rate;
        let own = (across.dot(&(p_we * across)) - across_ahead * across.dot(&we_ahead)) * by_rate * by_rate;
        let mut p = self.covariance.block(PHI, PHI) - phi_ahead * phi_ahead.transpose() * known;
        for k in 0..3 {
            p[(k, 2)] += cross[k];
            p[(2, k)] += cross[k];
        }
        p[(2, 2)] += own;
        let turn = self.northward().matrix();
        turn * p * turn.transpose()
    }

    /// Feedback: the estimated error leaves the strapdown, and is zero. δω stays where it is: it is constant. So does heading
    /// that is not known well and has moved by less than its σ: the model stays linear about one heading, for the frame that
    /// turns with each estimate would turn against errors that are fixed to the housing, and measure them by that.
    fn apply_correction(&mut self) {
        let mut kept = T::zero();
        if B > WE {
            let (heading, var) = (self.error[PHI].z, self.heading_var());
            if var > T::lit(CLOSING_SD * CLOSING_SD) && heading * heading < var {
                kept = heading;
            }
        }
        self.error[PHI].z -= kept;
        self.strapdown.correct(&self.error);
        for (_, part) in self.error.iter_mut().enumerate().filter(|(block, _)| *block != WE) {
            *part = Vector3::zeros();
        }
        self.error[PHI].z = kept;
    }

    /// The strapdown without its estimated error, now.
    pub fn solution(&self) -> Strapdown<T> {
        let mut solution = self.strapdown;
        if self.closed && self.error[PHI].z == T::zero() {
            return solution;
        }
        let mut error = propagated(&self.error, &self.interval.transition(&self.config.noise, &self.earth));
        if B > WE && !self.closed {
            error = self.closed_error(&error);
            solution.turn(self.northward());
        }
        solution.correct(&error);
        solution
    }

    /// 1σ of the gyro biases, both parts together, rad/s.
    pub fn gyro_bias_sd(&self) -> Vec3<Sensor, T> {
        let p = &self.covariance;
        let mut variances = p.variances(BG);
        if B > GM {
            variances += p.variances(GM) + p.block(BG, GM).diagonal() * T::lit(2.0);
        }
        Vec3::from_vector(variances.map(|v| math::sqrt(v.max(T::zero()))))
    }

    /// 1σ of the accelerometer biases, m/s².
    pub fn accel_bias_sd(&self) -> Vec3<Sensor, T> {
        Vec3::from_vector(self.covariance.variances(BA).map(|v| math::sqrt(v.max(T::zero()))))
    }

    /// Whether the filter's figures are numbers, and its covariance is one.
    pub fn is_sound(&self) -> bool {
        self.covariance.is_sound() && self.strapdown.is_finite()
    }

    /// Estimated measurement noise of the base's displacement.
    pub fn adaptive_noise(&self) -> &AdaptiveNoise<T> {
        &self.adaptive_noise
    }

    /// Measurements refused since the start, each too far from what was expected to be one.
    pub fn refused(&self) -> u32 {
        self.refused
    }

    /// The covariance at the last measurement, in the blocks of [`model`](crate::model).
    pub fn covariance(&self) -> &Covariance<T, B> {
        &self.covariance
    }

    /// The rotation to s from the frame whose z is the rotor's axis.
    ///
    /// The gyros are misaligned by M_xz and M_yz against it, and the axis is z + m in s, m = (M_xz, M_yz, 0). Accelerometers
    /// that are aligned with the rotor do not sense g m in s, and the filter finds it in their bias b. By the variances of
    /// the priors, m = −g σ_m² / (σ_b² + g² σ_m²) b.
    pub fn rotor_in_s(&self, solution: &Strapdown<T>) -> Rot<Sensor, Sensor, T> {
        Rot::exp(Vec3::from_vector(
            self.axis_turn() * solution.corrections.accel_bias_s.vector(),
        ))
    }

    /// What the accelerometer bias turns the rotor's axis by in s: θ = z × m.
    fn axis_turn(&self) -> Matrix3<T> {
        let mut turn = Matrix3::zeros();
        turn[(0, 1)] = -self.axis_by_bias;
        turn[(1, 0)] = self.axis_by_bias;
        turn
    }

    /// Covariance of the attitude errors of the frame whose z is the rotor's axis now, rad²: that of the last measurement,
    /// the random walk since, and what is not known of the axis.
    pub fn phi_covariance(&self) -> Matrix3<T> {
        let mut p = self.phi_now() + self.interval.phi_noise(&self.config.noise);
        if B > MZ {
            let by_bias = self.strapdown.c_ns.get().matrix() * self.axis_turn();
            let cross = self.covariance.block(PHI, BA) * by_bias.transpose();
            p += cross + cross.transpose() + by_bias * self.covariance.block(BA, BA) * by_bias.transpose();
            // The part of σ_m² that is independent of the bias.
            let noise = &self.config.noise;
            let misaligned = noise.gyro_misalignment_sd * noise.gyro_misalignment_sd;
            let rest = misaligned * (T::one() + self.earth.gravity() * self.axis_by_bias);
            p[(0, 0)] += rest;
            p[(1, 1)] += rest;
        }
        p
    }

    /// The other heading that explains the same measurements for a filter without δω, which cannot be split: the rotor's
    /// mean axis is tilted, and the z gyro bias that it takes within four of its σ.
    ///
    /// What is measured of Earth's rate is its level part, of known size ω_ie cos L, plus the z bias along
    /// the level part `a` of the axis, which turning about z does not modulate. A line along `a` meets the
    /// circle of that size twice, at biases that differ by `δ = 2 ω_ie cos L a_N/|a|²`. Linear theory sees
    /// one of them, and gives it a small σ.
    pub fn other_solution(&self) -> Option<OtherSolution<T>> {
        if B > WE {
            return None;
        }
        let axis = self.axis_n.get();
        let (a_e, a_n) = (axis.x() / self.elapsed, axis.y() / self.elapsed);
        let w = self.earth.w_north();
        let level2 = a_e * a_e + a_n * a_n;
        let most = T::lit(4.0) * self.config.noise.gyro_bias_sd;
        let delta = T::lit(2.0) * w * a_n / level2;
        let gyro_bias_z = self.strapdown.corrections.gyro_bias_s.z() + delta;
        // An axis that is not tilted gives an infinite δ or none at all, and no second solution.
        (gyro_bias_z.abs() <= most).then(|| OtherSolution {
            heading_offset: math::atan2(a_e * delta, w - a_n * delta),
            gyro_bias_z,
        })
    }

    /// The figures it runs on.
    pub fn config(&self) -> &FilterConfig<T, B> {
        &self.config
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{model::PAPER, strapdown::Corrections};
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

    /// Where the rotor is at the end of increment `k`.
    fn alpha(k: u32) -> f64 {
        20.0 * DEG * 0.05 * f64::from(k + 1)
    }

    /// The same turns, with the force of a base that does not accelerate: what the filter's f^n says.
    fn level_increment(k: u32) -> Increment<f64> {
        let earth = Earth::<f64>::new(40.0 * DEG, 0.0).unwrap();
        let mut c_ns = strapdown().c_ns;
        let turn = |k: u32| increment(k).phi_s - strapdown().corrections.gyro_error(&increment(k), alpha(k));
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
            v_n: V::new(0.001, -0.002, 0.003),
            p_n: V::new(0.1, 0.2, -0.1),
            corrections: Corrections {
                gyro_bias_s: V::new(10.0, -5.0, 3.0) * DEG_PER_HOUR,
                gyro_instability_s: V::new(1.0, 2.0, -3.0) * DEG_PER_HOUR,
                gyro_matrix: Matrix3::from_fn(|i, j| 1e-4 * (i as f64 - 2.0 * j as f64)),
                g_sensitivity: Matrix3::from_fn(|i, j| 1e-7 * (i as f64 - 1.5 * j as f64)),
                housing_b: Vec3::new(0.5, -0.3, 0.0) * DEG_PER_HOUR,
                accel_bias_s: V::new(100.0, 50.0, -80.0) * MICRO_G,
                accel_matrix: Matrix3::from_fn(|i, j| 1e-4 * (j as f64 - 2.0 * i as f64)),
            },
            ..Strapdown::new(Rot::from_quaternion(0.8, 0.05, -0.07, 0.6).unwrap())
        }
    }

    /// Error state of `moved` against `reference`, in the filter's definition; δω apart.
    fn error(moved: &Strapdown<f64>, reference: &Strapdown<f64>) -> [Vector3<f64>; ROBUST] {
        let phi = -(moved.c_ns.get() * reference.c_ns.get().inverse()).log();
        let (m, r) = (&moved.corrections, &reference.corrections);
        let matrix = r.gyro_matrix - m.gyro_matrix;
        let mut error = [Vector3::zeros(); ROBUST];
        error[PHI] = phi.vector();
        error[DV] = (moved.v_n - reference.v_n).vector();
        error[DP] = (moved.p_n - reference.p_n).vector();
        error[BG] = (r.gyro_bias_s - m.gyro_bias_s).vector();
        error[BA] = (r.accel_bias_s - m.accel_bias_s).vector();
        error[GM] = (r.gyro_instability_s - m.gyro_instability_s).vector();
        let by_force = r.g_sensitivity - m.g_sensitivity;
        let accel = r.accel_matrix - m.accel_matrix;
        for (block, drive) in GYRO_TERMS {
            match drive {
                GyroDrive::Rate(axis) => error[block] = matrix.column(axis).into(),
                GyroDrive::Force(axis) => error[block] = by_force.column(axis).into(),
                _ => {}
            }
        }
        for (block, axis) in ACCEL_COLUMNS {
            error[block] = accel.column(axis).into();
        }
        error[HB] = (r.housing_b - m.housing_b).vector();
        error
    }

    /// F against central differences of the mechanization over one second, relative to each block's size.
    #[test]
    fn transition_is_the_derivative_of_the_mechanization() {
        let earth = Earth::new(40.0 * DEG, 0.0).unwrap();
        // A strapdown that takes Earth's rate for `slow` less than it is.
        let run = |mut s: Strapdown<f64>, slow: Vector3<f64>| {
            let mut interval = Interval::<f64, ROBUST>::new();
            for k in 0..20 {
                let increment = level_increment(k);
                let half = V::from_vector(slow * 0.025);
                s.c_ns.turn_to(half);
                let c_ns = s.advance(&increment, alpha(k), &earth);
                s.c_ns.turn_to(half);
                interval.push(&increment, alpha(k), &c_ns, &earth);
            }
            (s, interval)
        };
        let none = Vector3::zeros();
        let (_, interval) = run(strapdown(), none);
        let mut phi = [[Matrix3::zeros(); ROBUST]; ROBUST];
        for (k, row) in phi.iter_mut().enumerate() {
            row[k] = Matrix3::identity();
        }
        for c in interval.transition(&ImuNoise::default(), &earth) {
            phi[c.row][c.col] += c.block;
        }
        let sizes = [
            1e-5, 1e-3, 1e-6, 1e-4, 1e-3, 1e-6, 1e-4, 1e-4, 1e-4, 1e-6, 1e-4, 1e-4, 1e-6, 1e-6, 1e-6,
        ];
        for (block, h) in sizes.into_iter().enumerate() {
            for axis in 0..3 {
                let mut one = Vector3::zeros();
                one[axis] = h;
                let (plus, minus) = if block == WE {
                    (run(strapdown(), one).0, run(strapdown(), -one).0)
                } else {
                    let mut error = [none; ROBUST];
                    error[block] = -one;
                    let (mut plus, mut minus) = (strapdown(), strapdown());
                    plus.correct(&error);
                    error[block] = one;
                    minus.correct(&error);
                    (run(plus, none).0, run(minus, none).0)
                };
                for (row, difference) in error(&plus, &minus)
                    .into_iter()
                    .enumerate()
                    .filter(|(row, _)| *row != WE)
                {
                    let numeric = difference / (2.0 * h);
                    let analytic: Vector3<f64> = phi[row][block].column(axis).into();
                    let scale = phi[row][block].amax().max(1e-3);
                    // The swing within one increment is the largest term that Φ leaves out; and for a column of M the
                    // rate that it acts on, 0.35 rad/s, the turn within an increment.
                    assert!(
                        (numeric - analytic).amax() < 3e-3 * scale,
                        "block ({row}, {block}) axis {axis}: {numeric} {analytic}"
                    );
                }
            }
        }
        // The part that tells north is small: check it against its own size.
        let expected = -earth.w_north();
        assert!((phi[PHI][PHI][(0, 2)] - expected).abs() < 1e-9, "φ̇_E = −ω_ie cos L φ_U");
    }

    /// Row h of the encoder constraint against central differences of the mechanization on a base fixed to Earth, tilted,
    /// over one second in which the rotor reverses.
    #[test]
    fn turn_row_is_the_derivative_of_the_mechanization() {
        let earth = Earth::<f64>::new(40.0 * DEG, 0.0).unwrap();
        let c_nb = Rot::<Nav, Body, f64>::from_yaw_pitch_roll(0.7, 0.2, -0.15);
        // Two thirds of a second one way, one third back.
        let alpha = |k: u32| 0.35 * 0.05 * (13.0 - (13.0 - f64::from(k)).abs());
        let c_ns = |k: u32| c_nb * Rot::about_z(alpha(k));
        let start = Strapdown::new(c_ns(0));
        let run = |mut s: Strapdown<f64>, slow: Vector3<f64>| {
            let mut interval = Interval::<f64, ROBUST>::new();
            let mut stationarity = StationarityDetector::new();
            stationarity.alpha = Some(alpha(0));
            stationarity.mark(s.c_ns.get());
            for k in 0..20 {
                let phi_s = (c_ns(k).inverse() * Rot::exp(earth.w_ie_n() * 0.05) * c_ns(k + 1)).log();
                let dv_s = c_ns(k).inverse() * earth.g_n() * -0.05;
                let half = V::from_vector(slow * 0.025);
                s.c_ns.turn_to(half);
                let increment = Increment { phi_s, dv_s, dt: 0.05 };
                let middle = s.advance(&increment, alpha(k + 1), &earth);
                s.c_ns.turn_to(half);
                interval.push(&increment, alpha(k + 1), &middle, &earth);
            }
            stationarity.alpha = Some(alpha(20));
            (stationarity.turn(s.c_ns.get()).unwrap().base.vector(), interval)
        };
        let none = Vector3::zeros();
        let (at_rest, interval) = run(start, none);
        assert!(at_rest.amax() < 1e-12, "{at_rest}");
        let row = interval.turn_row(&earth);
        let sizes = [
            1e-3, 1e-3, 1e-6, 1e-4, 1e-3, 1e-6, 1e-5, 1e-5, 1e-5, 1e-6, 1e-4, 1e-4, 1e-6, 1e-6, 1e-6,
        ];
        for (block, h) in sizes.into_iter().enumerate() {
            for axis in 0..3 {
                let mut one = none;
                one[axis] = h;
                let (plus, minus) = if block == WE {
                    (run(start, one).0, run(start, -one).0)
                } else {
                    let mut error = [none; ROBUST];
                    error[block] = -one;
                    let (mut plus, mut minus) = (start, start);
                    plus.correct(&error);
                    error[block] = one;
                    minus.correct(&error);
                    (run(plus, none).0, run(minus, none).0)
                };
                let numeric = (plus.z - minus.z) / (2.0 * h);
                let analytic = row[block][axis];
                // What acts within an increment is taken at its middle; what tells heading is small, and must be right
                // by its own size.
                let scale = row[block].amax().max(1e-6);
                assert!(
                    (numeric - analytic).abs() < 3e-3 * scale,
                    "block {block} axis {axis}: {numeric:e} {analytic:e}"
                );
            }
        }
        // \[Yu15\] (16): ω_N φ_E + ε_z, of a rotor that is upright.
        assert!((row[PHI].x + earth.w_north()).abs() < 1e-15);
        assert!((row[BG].z - c_nb.matrix()[(2, 2)]).abs() < 1e-6);
    }

    fn filter<const B: usize>(method: Method<f32, B>) -> FineFilter<f32, B> {
        let earth = Earth::new(f32::lit(40.0 * DEG), 0.0).unwrap();
        let config = FilterConfig {
            method,
            ..FilterConfig::default()
        };
        FineFilter::new(config, earth, strapdown().c_ns.get().cast(), None).unwrap()
    }

    fn increment_f32(k: u32) -> Increment<f32> {
        let Increment { phi_s, dv_s, .. } = increment(k);
        Increment {
            phi_s: phi_s.cast(),
            dv_s: dv_s.cast(),
            dt: 0.05,
        }
    }

    fn factors_of_one<const B: usize>() {
        let none = Vector3::zeros();
        let Method::StrongTracking(policy) = Method::strong_tracking() else {
            unreachable!("by construction")
        };
        let mut kalman = filter(Method::Kalman);
        let mut ones = filter(Method::StrongTracking(StrongTracking {
            weights: [none; B],
            ..policy
        }));
        let mut fading = filter::<B>(Method::StrongTracking(policy));
        let mut faded = false;
        for k in 0..2000 {
            let (a, b) = (kalman.step(&increment_f32(k), 0.0), ones.step(&increment_f32(k), 0.0));
            assert_eq!(a, b);
            faded |= fading.step(&increment_f32(k), 0.0).is_some_and(|i| i.fading > 1.0);
        }
        assert_eq!(kalman.strapdown, ones.strapdown);
        assert_eq!(kalman.covariance, ones.covariance);
        // This motion does not fit the paper's model: a policy that may fade does.
        assert!(B > DP || faded && fading.covariance != kalman.covariance);
        assert!(fading.covariance.is_sound());
    }

    #[test]
    fn strong_tracking_with_factors_of_one_is_the_kalman_filter() {
        factors_of_one::<PAPER>();
        factors_of_one::<ROBUST>();
    }

    /// A base at rest under a turning rotor, exactly: what the filter's model says, for hours. The heading that it
    /// starts from is `off` wrong, rad.
    fn ten_hours<const B: usize>(method: Method<f32, B>, off: f64) {
        let earth = Earth::<f32>::new(f32::lit(40.0 * DEG), 0.0).unwrap();
        let c_nb = Rot::from_yaw_pitch_roll(0.4_f32, 0.05, -0.08);
        let schedule = crate::rotor::Schedule::<f64>::new(crate::rotor::RotorConfig::default()).unwrap();
        let noise = ImuNoise {
            gyro_instability_sd: f32::lit(3.0 * DEG_PER_HOUR),
            gyro_instability_tau: 100.0,
            gyro_scale_factor_sd: 3e-4,
            gyro_misalignment_sd: 6e-4,
            ..ImuNoise::default()
        };
        let config = FilterConfig {
            method,
            noise,
            ..FilterConfig::default()
        };
        let start = Rot::exp(Vec3::new(0.0, 0.0, f32::lit(off))) * c_nb * Rot::about_z(0.0);
        let mut filter = FineFilter::new(config, earth, start, None).unwrap();
        filter.close_loop();
        let mut var = f32::INFINITY;
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
            if filter.step(&increment, f32::lit(to)).is_some() {
                assert!(filter.is_sound(), "{t} s");
            }
            if k == 24_000 {
                var = filter.heading_var();
            }
        }
        // With drifting biases heading settles; it neither vanishes nor grows.
        let end = filter.heading_var();
        assert!(end < 1.5 * var && end > 0.05 * var, "{var:e} {end:e}");
        let truth = c_nb * Rot::about_z(f32::lit(schedule.at(36_000.0).angle));
        let off = filter.solution().c_ns.get().angle_to(truth);
        assert!(off < f32::lit(0.3 * DEG), "{off}");
        // A motionless base is weighed by a twentieth of a millimetre, and rounding may now and then be more.
        assert!(filter.refused() < 36, "{}", filter.refused());
    }

    #[test]
    fn covariance_stays_sound_for_ten_hours_in_single_precision() {
        ten_hours::<PAPER>(Method::Kalman, 0.0);
        ten_hours::<PAPER>(Method::strong_tracking(), 0.0);
        for off in [0.0, 3.0] {
            ten_hours::<ROBUST>(Method::Kalman, off);
        }
    }

    /// The error that closing leaves is the one that the same steps give which its covariance takes.
    fn closes_by_its_covariance(filter: &FineFilter<f32>) {
        let mut filter = *filter;
        // A length that is off, so that it says something of every state.
        filter.error[WE].y += 0.1 * filter.earth.w_north();
        let found = filter.closed_error(&filter.error);
        filter.turn_to_north();
        let mut to_heading = Matrix3::zeros();
        to_heading[(2, 0)] = 1.0 / filter.earth.w_north();
        let mut gone = Matrix3::zeros();
        gone[(0, 0)] = -1.0;
        let transition = [(PHI, to_heading), (WE, gone)].map(|(row, block)| TransitionBlock { row, col: WE, block });
        filter.covariance.propagate(&transition);
        let mut expected = propagated(&filter.error, &transition);
        let residual = -expected[WE].y;
        let gain = filter.covariance.update(WE, 1, filter.length_var());
        for (part, column) in expected.iter_mut().zip(&gain.column) {
            *part += column * residual;
        }
        assert!(residual.abs() > 0.05 * filter.earth.w_north());
        for (block, (found, expected)) in found.iter().zip(&expected).enumerate() {
            let most = 1e-3 * expected.amax().max((gain.column[block] * residual).amax());
            assert!((found - expected).amax() <= most, "{block}: {found} {expected}");
        }
    }

    /// One increment of a rotor at 0.35 rad/s on a base at rest, level but for 0.01 and 0.02 rad, with this heading.
    fn step_at_rest(filter: &mut FineFilter<f32>, heading: f32, k: &mut u32) -> Option<Innovation<f32>> {
        let dt = 0.05;
        let earth = filter.earth;
        let c_nb = Rot::<Nav, Body, f32>::from_yaw_pitch_roll(heading, 0.01, -0.02);
        let c_ns = c_nb * Rot::about_z(0.35 * f32::lit(f64::from(*k) * dt));
        *k += 1;
        let increment = Increment {
            phi_s: Vec3::new(0.0, 0.0, f32::lit(0.35 * dt)) + c_ns.inverse() * earth.w_ie_n() * f32::lit(dt),
            dv_s: c_ns.inverse() * earth.g_n() * f32::lit(-dt),
            dt: f32::lit(dt),
        };
        filter.step(&increment, 0.35 * f32::lit(f64::from(*k) * dt))
    }

    /// The same heading and σ of it, to the loop's closing and beyond.
    #[test]
    fn closing_the_loop_changes_no_estimate() {
        let mut filter = filter::<ROBUST>(Method::Kalman);
        let mut k = 0;
        let mut step = |filter: &mut FineFilter<f32>| step_at_rest(filter, 1.3, &mut k);
        while filter.heading_var() > f32::lit(CLOSING_SD * CLOSING_SD) {
            step(&mut filter);
        }
        let (before, sd) = (filter.solution(), filter.phi_covariance());
        closes_by_its_covariance(&filter);
        filter.closing = true;
        filter.feed_back();
        let (after, sd_after) = (filter.solution(), filter.phi_covariance());
        assert!(filter.closed);
        // That the length of Earth's level rate is known says a little about heading, and more about nothing.
        let moved = before.c_ns.get().angle_to(after.c_ns.get());
        assert!(moved < 0.3 * math::sqrt(sd[(2, 2)]), "{moved}");
        assert!(
            sd_after[(2, 2)] <= 1.01 * sd[(2, 2)] && sd_after[(2, 2)] > 0.9 * sd[(2, 2)],
            "{sd} {sd_after}"
        );
        assert!((sd_after[(0, 0)] / sd[(0, 0)] - 1.0).abs() < 0.05);
        for _ in 0..2000 {
            step(&mut filter);
        }
        assert!(filter.is_sound() && filter.heading_var() < sd_after[(2, 2)]);
    }

    /// The model holds about the direction that Earth's rate is taken to have: half a degree is the most that the estimate may
    /// be off it, however far off the start was.
    #[test]
    fn the_frame_follows_the_direction_of_earths_rate() {
        let heading = 1.3;
        let c_nb = Rot::<Nav, Body, f32>::from_yaw_pitch_roll(heading, 0.01, -0.02);
        let start = filter::<ROBUST>(Method::Kalman);
        for off in [0.6_f32, -1.5] {
            let c_ns = Rot::exp(Vec3::new(0.0, 0.0, off)) * c_nb * Rot::about_z(0.0);
            let mut filter = FineFilter::new(start.config, start.earth, c_ns, None).unwrap();
            let (mut k, mut measured) = (0, 0);
            while k < 3000 {
                if step_at_rest(&mut filter, heading, &mut k).is_none() {
                    continue;
                }
                measured += 1;
                filter.find_north();
                let angle = filter.north.best.angle;
                assert!(angle.abs() < f32::lit(0.501 * DEG), "{k}: {angle}");
            }
            assert!(measured > 20, "{measured}");
            let frame = filter.strapdown.c_ns.get() * Rot::about_z(0.35 * f32::lit(f64::from(k) * 0.05)).inverse();
            let left = frame.angle_to(c_nb);
            assert!(left < 3.0 * math::sqrt(filter.heading_var()) + 0.02, "{left}");
        }
    }

    /// Another heading counts up to 4σ behind the best: one at 3σ holds the loop open, one at 5σ does not.
    #[test]
    fn another_heading_keeps_the_loop_open_until_it_is_four_sigma_behind() {
        let mut filter = filter::<ROBUST>(Method::Kalman);
        let mut k = 0;
        while filter.heading_var() > f32::lit(CLOSING_SD * CLOSING_SD) {
            step_at_rest(&mut filter, 1.3, &mut k);
        }
        let best = filter.north.best;
        let mut with_other = |sigmas: f32| {
            filter.north.other = Some(Direction {
                angle: best.angle + 1.0,
                cost: best.cost + sigmas * sigmas,
            });
            filter
        };
        assert!(!with_other(5.0).is_ambiguous());
        let mut first = with_other(3.0);
        assert!(first.is_ambiguous());
        let mut second = first;
        let behind = first.split(&mut second);
        assert!((behind - 9.0).abs() < 0.5, "{behind}");
    }

    /// A knock that is gone a second later is refused and counted; a base that begins to sway is soon followed.
    #[test]
    fn knocks_are_refused_and_sway_is_learnt() {
        let mut filter = filter::<ROBUST>(Method::Kalman);
        let c_ns = strapdown().c_ns.get().cast::<f32>();
        let earth = filter.earth;
        let dt = 0.05_f32;
        let feed = |filter: &mut FineFilter<f32>, velocity: f32| {
            let level = Vec3::new(velocity, 0.0, 0.0) - earth.g_n() * dt;
            let increment = Increment {
                phi_s: c_ns.inverse() * earth.w_ie_n() * dt,
                dv_s: c_ns.inverse() * level,
                dt,
            };
            filter.step(&increment, 0.0)
        };
        for _ in 0..20 * 300 {
            feed(&mut filter, 0.0);
        }
        assert_eq!(filter.refused(), 0);
        let quiet = filter.adaptive_noise().level_var();
        assert!(quiet < 1e-6, "{quiet:e}");
        // 1 cm there and back about a measurement.
        for velocity in [0.05_f32, -0.05] {
            for k in 0..20 {
                feed(&mut filter, if (8..12).contains(&k) { velocity } else { 0.0 });
            }
        }
        assert!(filter.refused() >= 1, "{}", filter.refused());
        assert!(filter.adaptive_noise().level_var() < 4.0 * quiet.max(1e-8));
        let refused = filter.refused();
        // Sway of 0.2 m and 8 s.
        for k in 0..20 * 60_u32 {
            let rate = core::f32::consts::TAU / 8.0;
            let phase = rate * 0.05 * f32::lit(f64::from(k % 160));
            feed(&mut filter, 0.2 * rate * rate * math::sin_cos(phase).1 * dt);
        }
        assert!(filter.refused() - refused <= 12, "{}", filter.refused());
        let sway = filter.adaptive_noise().level_var();
        assert!((0.001..0.2).contains(&sway), "{sway}");
    }

    #[test]
    fn tilt_is_less_certain_between_measurements() {
        let mut filter = filter::<PAPER>(Method::Kalman);
        for k in 0..200 {
            filter.step(&increment_f32(k), 0.0);
        }
        let at_measurement = filter.phi_covariance()[(0, 0)];
        assert_eq!(at_measurement, filter.covariance.block(PHI, PHI)[(0, 0)]);
        for k in 200..210 {
            filter.step(&increment_f32(k), 0.0);
        }
        // Half a second of angle random walk, and a doubted gap on top.
        let walk = filter.config.noise.angle_random_walk.powi(2) * 0.5;
        assert!((filter.phi_covariance()[(0, 0)] - at_measurement - walk).abs() < 0.01 * walk);
        filter.inflate_covariance(1e-3, 0.0);
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
        let adaptive_noise = AdaptiveNoiseConfig {
            memory: 1.0,
            ..good.adaptive_noise
        };
        assert_eq!(
            FilterConfig { adaptive_noise, ..good }.validate(),
            Err(FilterConfigError::AdaptiveNoise)
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
