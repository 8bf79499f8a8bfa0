//! Calibration of the gyros by the rotor: a while at rest, then a while turning.
//!
//! What the rotor adds to the gyros' errors is proportional to its rate: a third of a mrad of misalignment makes 24 °/h at
//! 20 °/s. With the base at rest, the gyros' readings less the rotor's rate are (\[Du16\] (32)–(34))
//!
//! ```text
//! ω̃_is^s − [0, 0, ω] = [K_xz, K_yz, S_z] ω + [d_x, d_y, d_z]
//! ```
//!
//! with ω the rotor's rate by the encoder: per axis one slope and one offset, by least squares with the weights of white
//! noise. [`Calibrator`] keeps sums only. Predicted 1σ are in [`bias_sd`] (35) and [`column_sd`] (36); what the fit itself
//! says is in [`Calibration`]. They differ where the rotor turns one way only: the slope is then found against the offset,
//! and its variance is that of (36) times `1 + T_turn/T_rest`, twice it for equal times. Turning forth and back as far,
//! the two part, the slope has (36) and the offset `ARW/√(T_rest + T_turn)`, better than (35).
//!
//! The scale factor of a cheap gyro depends on the rate: turn at the rate to be used.
//!
//! # Earth's rate
//!
//! The paper leaves it out. At rest it then is part of the biases, up to 15 °/h, and in x and y it also reaches the
//! misalignments, by `ω_ie cos L/ω`: 140 ppm at 20 °/s. Where attitude and latitude are known,
//! [`CalibrationConfig::w_ie_b`] takes it out.
//!
//! # What is seen of a base that moves
//!
//! The scatter of the residuals of blocks of one second, against noise; of z, while the rotor turns, against the encoder's
//! error as well, which is far above the gyro's: of two ends, `2 σ²`. It is not in the predicted 1σ: over whole turns it
//! returns, and 0.01° are 7 ppm of four. A base that turns evenly throughout is not told from a bias.
//!
//! Not modelled: the first two columns of the matrix, which Earth's rate alone excites (3e-4 of 11 °/h); drift.

use frames::{Body, Real, Rot, Sensor, Vec3, math};
use nalgebra::Vector3;

use crate::earth::OMEGA_IE;
use crate::increment::Sample;

/// Residuals may have this many times their predicted variance, 3σ of what is expected: more is a base that moves.
pub const MAX_SCATTER: f64 = 9.0;

/// The rotor may move by this much in the rest, rad: a tenth of a degree, above any encoder's noise and play.
pub const REST_TRAVEL: f64 = 1.75e-3;

/// Length of a block, s.
const BLOCK: f64 = 1.0;

/// Why there is no calibration.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum CalibrationError {
    /// A figure of the configuration that cannot be; which.
    Config(&'static str),
    /// A sample or an encoder reading that is not a number or beyond any IMU.
    Sample,
    /// Asked to turn before the rest was long enough.
    RestTooShort {
        /// How long it was, s.
        seconds: f32,
        /// How long it must be, s.
        needed: f32,
    },
    /// Asked to rest after turning, or for the result before turning.
    WrongPhase,
    /// The rotor turned in the rest, by more than [`REST_TRAVEL`].
    RotorMoved {
        /// How far from where it stood, rad.
        by: f32,
    },
    /// The rotor turned too little, or not long enough, in the turning part.
    TooLittleTurn {
        /// All turns added up, whichever the direction, rad.
        turned: f32,
        /// What is needed, rad.
        needed: f32,
    },
    /// The base moved: residuals scatter more than the gyros' noise allows.
    BaseMoved {
        /// Variance of the worst axis over the predicted one.
        scatter: f32,
    },
}

impl core::fmt::Display for CalibrationError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            Self::Config(what) => f.write_str(what),
            Self::Sample => f.write_str("a sample is not finite or beyond the range of an IMU"),
            Self::RestTooShort { seconds, needed } => {
                write!(f, "{seconds:.1} s at rest are too short: {needed:.1} s are needed")
            }
            Self::WrongPhase => f.write_str("a calibration is first a rest, then a turn, then the result"),
            Self::RotorMoved { by } => write!(f, "the rotor moved by {by:.4} rad while it should have rested"),
            Self::TooLittleTurn { turned, needed } => {
                write!(
                    f,
                    "the rotor turned by {turned:.2} rad only: {needed:.2} rad are needed"
                )
            }
            Self::BaseMoved { scatter } => write!(
                f,
                "the base moved, or the gyros are noisier than stated: residuals have {scatter:.1} times their variance"
            ),
        }
    }
}

impl core::error::Error for CalibrationError {}

/// How to calibrate.
///
/// | figure | meaning | zero |
/// |---|---|---|
/// | `angle_random_walk` | white noise of the gyros, rad/√s | refused |
/// | `instability` | drift of the gyros over a minute, 1σ, rad/s | gyros without drift |
/// | `encoder_error` | noise and nonlinearity of the encoder, 1σ, rad | an exact encoder |
/// | `rest` | least time at rest, s | refused |
/// | `turn` | least turn, rad, directions added up | refused |
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CalibrationConfig<T: Real = f32> {
    /// Angle random walk of the gyros, rad/√s.
    pub angle_random_walk: T,
    /// Bias instability of the gyros, 1σ, rad/s: what residuals may scatter beyond the white noise.
    pub instability: T,
    /// Error of the encoder, 1σ, rad: noise, and the nonlinearity that its table leaves.
    pub encoder_error: T,
    /// Least time at rest, s.
    pub rest: T,
    /// Least turn in the turning part, directions added up, rad.
    pub turn: T,
    /// Earth's rate in the housing, rad/s, where attitude and latitude are known. `None`: left in the biases, as in
    /// \[Du16\].
    pub w_ie_b: Option<Vec3<Body, T>>,
}

impl<T: Real> Default for CalibrationConfig<T> {
    /// 60 s at rest as in \[Du16\] §3.2, one turn, an encoder good to 0.01°, and the gyros of \[Xing18\] Table 2, 0.02 °/√h.
    fn default() -> Self {
        Self {
            angle_random_walk: T::lit(0.02 * frames::units::DEG_PER_SQRT_HOUR),
            instability: T::zero(),
            // 0.01°.
            encoder_error: T::lit(1.75e-4),
            rest: T::lit(60.0),
            turn: T::two_pi(),
            w_ie_b: None,
        }
    }
}

impl<T: Real> CalibrationConfig<T> {
    /// Whether every figure can be.
    ///
    /// # Errors
    /// [`CalibrationError::Config`] with the figure.
    pub fn validate(&self) -> Result<(), CalibrationError> {
        let positive = |x: T| x.finite() && x > T::zero();
        let fault = if !positive(self.angle_random_walk) {
            "the angle random walk must be positive"
        } else if !(self.instability.finite() && self.instability >= T::zero()) {
            "the bias instability must not be negative"
        } else if !(self.encoder_error.finite() && self.encoder_error >= T::zero()) {
            "the error of the encoder must not be negative"
        } else if !positive(self.rest) {
            "the time at rest must be positive"
        } else if !positive(self.turn) {
            "the turn must be positive"
        } else if !self.w_ie_b.is_none_or(Vec3::is_finite) {
            "Earth's rate must be finite"
        } else {
            return Ok(());
        };
        Err(CalibrationError::Config(fault))
    }
}

/// Predicted 1σ of a bias found in `rest` seconds at rest, rad/s (\[Du16\] (35)), by white noise alone.
pub fn bias_sd<T: Real>(angle_random_walk: T, rest: T) -> T {
    angle_random_walk / math::sqrt(rest)
}

/// Predicted 1σ of `K_xz`, `K_yz`, `S_z` found in `turn` seconds of turning by `angle` rad, as a fraction (\[Du16\] (36)),
/// by white noise alone and with the bias known.
pub fn column_sd<T: Real>(angle_random_walk: T, turn: T, angle: T) -> T {
    angle_random_walk * math::sqrt(turn) / angle.abs()
}

/// Sums of the least squares, per block Δt with the rotor's turn Δα and the rest y of the gyros:
/// `y = K Δα + d Δt + n`, n of variance ARW² Δt.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Sums<T: Real> {
    blocks: T,
    time: T,
    /// Σ Δα, Σ Δα²/Δt.
    turn: T,
    turn2: T,
    /// Σ y, Σ y Δα/Δt, Σ y²/Δt.
    y: Vector3<T>,
    y_turn: Vector3<T>,
    y2: Vector3<T>,
}

impl<T: Real> Sums<T> {
    fn new() -> Self {
        let zero = T::zero();
        Self {
            blocks: zero,
            time: zero,
            turn: zero,
            turn2: zero,
            y: Vector3::zeros(),
            y_turn: Vector3::zeros(),
            y2: Vector3::zeros(),
        }
    }

    fn add(&mut self, block: &Block<T>) {
        let Block { y, turn, time } = *block;
        if time <= T::zero() {
            return;
        }
        self.blocks += T::one();
        self.time += time;
        self.turn += turn;
        self.turn2 += turn * turn / time;
        self.y += y;
        self.y_turn += y * (turn / time);
        self.y2 += y.component_mul(&y) / time;
    }

    /// Offsets d, rad/s, slopes K, and what they leave of Σ y²/Δt. Slopes are zero where nothing turned.
    fn fit(&self) -> (Vector3<T>, Vector3<T>, Vector3<T>) {
        let det = self.determinant();
        let (d, k) = if det > T::zero() {
            (
                (self.y * self.turn2 - self.y_turn * self.turn) / det,
                (self.y_turn * self.time - self.y * self.turn) / det,
            )
        } else {
            (self.y / self.time, Vector3::zeros())
        };
        let left = self.y2 - d.component_mul(&self.y) - k.component_mul(&self.y_turn);
        (d, k, left)
    }

    fn determinant(&self) -> T {
        self.turn2 * self.time - self.turn * self.turn
    }
}

/// Samples of a second.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Block<T: Real> {
    y: Vector3<T>,
    turn: T,
    time: T,
}

impl<T: Real> Block<T> {
    fn new() -> Self {
        Self {
            y: Vector3::zeros(),
            turn: T::zero(),
            time: T::zero(),
        }
    }
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Phase {
    Rest,
    Turn,
}

/// Takes the samples of a rest and of a turn, and gives the calibration.
///
/// ```
/// use frames::Vec3;
/// use nav::calibration::{CalibrationConfig, Calibrator};
/// use nav::increment::Sample;
///
/// let mut calibrator = Calibrator::new(CalibrationConfig::<f32>::default())?;
/// let sample = |z: f32| Sample { dtheta_s: Vec3::new(0.0, 0.0, z), dv_s: Vec3::new(0.0, 0.0, 0.98), dt: 0.1, gap: 0.0 };
/// for _ in 0..=600 {
///     calibrator.rest(&sample(0.0), 0.0)?;
/// }
/// for k in 1..=600 {
///     // The gyro reads 300 ppm more than the encoder.
///     calibrator.turn(&sample(0.035 * 1.0003), 0.035 * k as f32)?;
/// }
/// let calibration = calibrator.finish()?;
/// assert!((calibration.s_z - 3e-4).abs() < 1e-6);
/// # Ok::<(), nav::calibration::CalibrationError>(())
/// ```
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Calibrator<T: Real = f32> {
    config: CalibrationConfig<T>,
    phase: Phase,
    /// The encoder at the end of the last sample, rad.
    encoder: Option<T>,
    /// Where the rotor stood when the rest began, rad.
    stand: T,
    /// Turns of the turning part, directions added up, rad.
    turned: T,
    /// Time of the turning part, s.
    turning: T,
    block: Block<T>,
    rest: Sums<T>,
    sums: Sums<T>,
}

impl<T: Real> Calibrator<T> {
    /// One that waits for the first sample at rest.
    ///
    /// # Errors
    /// [`CalibrationError::Config`].
    pub fn new(config: CalibrationConfig<T>) -> Result<Self, CalibrationError> {
        config.validate()?;
        Ok(Self {
            config,
            phase: Phase::Rest,
            encoder: None,
            stand: T::zero(),
            turned: T::zero(),
            turning: T::zero(),
            block: Block::new(),
            rest: Sums::new(),
            sums: Sums::new(),
        })
    }

    /// Time at rest so far, s, blocks that are full.
    pub fn rested(&self) -> T {
        self.rest.time
    }

    /// Turn so far, directions added up, rad.
    pub fn turned(&self) -> T {
        self.turned
    }

    /// A sample at rest, with the encoder's reading at its end, rad. Of the first, only the reading is used.
    ///
    /// # Errors
    /// [`CalibrationError::Sample`], [`RotorMoved`](CalibrationError::RotorMoved), or
    /// [`WrongPhase`](CalibrationError::WrongPhase) after turning. Nothing is taken from a refused sample.
    pub fn rest(&mut self, sample: &Sample<T>, encoder: T) -> Result<(), CalibrationError> {
        if self.phase != Phase::Rest {
            return Err(CalibrationError::WrongPhase);
        }
        check(sample, encoder)?;
        if self.encoder.is_none() {
            self.stand = encoder;
        }
        let by = (encoder - self.stand).abs();
        if by > T::lit(REST_TRAVEL) {
            return Err(CalibrationError::RotorMoved { by: single(by) });
        }
        if let Some(block) = self.take(sample, encoder, true) {
            self.rest.add(&block);
        }
        Ok(())
    }

    /// A sample of the turn, with the encoder's reading at its end, rad. The first ends the rest.
    ///
    /// # Errors
    /// [`CalibrationError::Sample`]; with the first, [`RestTooShort`](CalibrationError::RestTooShort), or
    /// [`BaseMoved`](CalibrationError::BaseMoved) where the rest was none.
    pub fn turn(&mut self, sample: &Sample<T>, encoder: T) -> Result<(), CalibrationError> {
        check(sample, encoder)?;
        if self.phase == Phase::Rest {
            let mut rest = self.rest;
            rest.add(&self.block);
            // A hundredth for the sum's rounding and for the first sample, which only says where the rotor stands.
            if rest.time < self.config.rest * T::lit(0.99) {
                return Err(CalibrationError::RestTooShort {
                    seconds: single(rest.time),
                    needed: single(self.config.rest),
                });
            }
            self.still(&rest, T::one())?;
            self.rest = rest;
            self.sums = rest;
            self.block = Block::new();
            self.phase = Phase::Turn;
        }
        if let Some(block) = self.take(sample, encoder, false) {
            self.sums.add(&block);
        }
        Ok(())
    }

    /// The calibration.
    ///
    /// # Errors
    /// [`CalibrationError::WrongPhase`] before any turn, [`TooLittleTurn`](CalibrationError::TooLittleTurn),
    /// [`BaseMoved`](CalibrationError::BaseMoved).
    pub fn finish(&self) -> Result<Calibration<T>, CalibrationError> {
        if self.phase != Phase::Turn {
            return Err(CalibrationError::WrongPhase);
        }
        let mut sums = self.sums;
        sums.add(&self.block);
        let det = sums.determinant();
        // det/time is Σ (ω − mean ω)² Δt: a crawl that adds up to a turn is not enough for the slopes.
        let enough = self.turned >= self.config.turn * T::lit(0.99) && det > T::lit(1e-4) * sums.time;
        if !enough {
            return Err(CalibrationError::TooLittleTurn {
                turned: single(self.turned),
                needed: single(self.config.turn),
            });
        }
        let two = T::lit(2.0);
        let scatter = self.still(&sums, two)?;
        let (d, k, _) = sums.fit();
        let arw = self.config.angle_random_walk;
        Ok(Calibration {
            bias_s: Vec3::from_vector(d),
            k_xz: k.x,
            k_yz: k.y,
            s_z: k.z,
            bias_sd: arw * math::sqrt(sums.turn2 / det),
            column_sd: arw * math::sqrt(sums.time / det),
            scatter,
            rest: self.rest.time,
            turn: self.turning,
            turned: self.turned,
        })
    }

    /// Adds a sample to the block; gives the block when it is full.
    fn take(&mut self, sample: &Sample<T>, encoder: T, at_rest: bool) -> Option<Block<T>> {
        let previous = self.encoder.replace(encoder)?;
        // At rest the rotor does not turn; what the encoder says there is its noise.
        let turn = if at_rest { T::zero() } else { encoder - previous };
        if sample.gap > T::zero() {
            // The encoder's way is that of sample and gap together: this sample has no turn of its own.
            return None;
        }
        let mut y = sample.dtheta_s.vector();
        y.z -= turn;
        if let Some(w_ie_b) = self.config.w_ie_b {
            let c_bs = Rot::<Body, Sensor, T>::about_z((encoder + previous) * T::lit(0.5));
            y -= (c_bs.inverse() * w_ie_b).vector() * sample.dt;
        }
        if !at_rest {
            self.turned += turn.abs();
            self.turning += sample.dt;
        }
        self.block.y += y;
        self.block.turn += turn;
        self.block.time += sample.dt;
        // As near to its length as whole samples come.
        if self.block.time < T::lit(BLOCK) - T::lit(0.5) * sample.dt {
            return None;
        }
        Some(core::mem::replace(&mut self.block, Block::new()))
    }

    /// The worst axis' scatter: variance of the residuals over the predicted one, `unknowns` having been fitted.
    fn still(&self, sums: &Sums<T>, unknowns: T) -> Result<T, CalibrationError> {
        let free = sums.blocks - unknowns;
        if free < T::one() {
            return Ok(T::zero());
        }
        let square = |x: T| x * x;
        // Drift is the same throughout a block. Earth's rate, where it is left in, turns with the IMU.
        let earth = if self.config.w_ie_b.is_some() {
            T::zero()
        } else {
            T::lit(OMEGA_IE)
        };
        let drift = square(self.config.instability) + square(earth);
        let expected = square(self.config.angle_random_walk) + drift * T::lit(BLOCK);
        let left = sums.fit().2;
        // Where the rotor rests the encoder is not asked.
        let encoder = if self.phase == Phase::Rest {
            T::zero()
        } else {
            self.config.encoder_error
        };
        let expected_z = expected + square(encoder) * T::lit(2.0);
        let scatter = (left.x.max(left.y) / expected).max(left.z / expected_z) / free;
        if scatter <= T::lit(MAX_SCATTER) {
            Ok(scatter.max(T::zero()))
        } else {
            Err(CalibrationError::BaseMoved {
                scatter: single(scatter),
            })
        }
    }
}

fn check<T: Real>(sample: &Sample<T>, encoder: T) -> Result<(), CalibrationError> {
    if sample.is_valid() && encoder.finite() {
        Ok(())
    } else {
        Err(CalibrationError::Sample)
    }
}

#[expect(clippy::cast_possible_truncation, reason = "for a message")]
fn single<T: Real>(x: T) -> f32 {
    x.to_f64() as f32
}

/// What the rotor shows of the gyros, with what is to be expected of it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Calibration<T: Real = f32> {
    /// Biases d, rad/s. With Earth's rate in them where that was not known.
    pub bias_s: Vec3<Sensor, T>,
    /// What the x gyro takes of a turn about z, rad.
    pub k_xz: T,
    /// What the y gyro takes of a turn about z, rad.
    pub k_yz: T,
    /// Scale factor error of the z gyro, a fraction.
    pub s_z: T,
    /// 1σ of each bias by the gyros' white noise, rad/s, by the fit.
    pub bias_sd: T,
    /// 1σ of `k_xz`, `k_yz` and `s_z` by the gyros' white noise, by the fit.
    pub column_sd: T,
    /// Variance of the worst axis' residuals over the predicted one.
    pub scatter: T,
    /// Time at rest, s.
    pub rest: T,
    /// Time turning, s.
    pub turn: T,
    /// Turns of the turning part, directions added up, rad.
    pub turned: T,
}

impl<T: Real> Calibration<T> {
    /// The biases alone: \[Du16\]'s partial calibration.
    #[must_use]
    pub fn biases_only(&self) -> Self {
        let zero = T::zero();
        Self {
            k_xz: zero,
            k_yz: zero,
            s_z: zero,
            ..*self
        }
    }

    /// What goes with the rotor's rate, with the biases of the one before, or none: for biases that have Earth's rate in
    /// them.
    #[must_use]
    pub fn with_biases_of(&self, before: Option<&Self>) -> Self {
        let (bias_s, bias_sd) = before.map_or((Vec3::zero(), self.bias_sd), |before| (before.bias_s, before.bias_sd));
        Self {
            bias_s,
            bias_sd,
            ..*self
        }
    }

    /// The sample without biases and without what the gyros take of the turn about z.
    pub fn corrected(&self, sample: &Sample<T>) -> Sample<T> {
        let w = sample.dtheta_s - self.bias_s * sample.dt;
        let z = w.z() / (T::one() + self.s_z);
        Sample {
            dtheta_s: Vec3::new(w.x() - self.k_xz * z, w.y() - self.k_yz * z, z),
            ..*sample
        }
    }

    /// What a gyro takes of a rotor at `rate`, rad/s, once corrected, 1σ, rad/s: `σ_K ω` of the fit, beside the bias.
    pub fn induced_sd(&self, rate: T) -> T {
        self.column_sd * rate.abs()
    }
}

#[cfg(test)]
mod tests {
    use frames::units::DEG;
    use proptest::prelude::*;

    use super::*;

    const D: [f64; 3] = [3e-4, -2e-4, 1e-4];
    const K: [f64; 3] = [2e-3, -1e-3, 5e-4];

    /// A gyro triad without noise, its rotor, and Earth below.
    struct Bench {
        alpha: f64,
        w_ie_b: Vec3<Body, f64>,
    }

    impl Bench {
        fn sample(&mut self, rate: f64, dt: f64) -> (Sample<f64>, f64) {
            let w_ie_s = Rot::<Body, Sensor, f64>::about_z(self.alpha + 0.5 * rate * dt).inverse() * self.w_ie_b;
            self.alpha += rate * dt;
            let z = rate + w_ie_s.z();
            let w = w_ie_s.vector() + Vector3::new(0.0, 0.0, rate) + Vector3::from(K) * z + Vector3::from(D);
            let sample = Sample {
                dtheta_s: Vec3::from_vector(w * dt),
                dv_s: Vec3::new(0.0, 0.0, 9.8 * dt),
                dt,
                gap: 0.0,
            };
            (sample, self.alpha)
        }
    }

    fn config(w_ie_b: Option<Vec3<Body, f64>>) -> CalibrationConfig<f64> {
        CalibrationConfig {
            w_ie_b,
            ..CalibrationConfig::default()
        }
    }

    fn calibrate(bench: &mut Bench, config: CalibrationConfig<f64>, rate: impl Fn(f64) -> f64) -> Calibration<f64> {
        let mut calibrator = Calibrator::new(config).unwrap();
        for _ in 0..=6000 {
            let (sample, alpha) = bench.sample(0.0, 0.01);
            calibrator.rest(&sample, alpha).unwrap();
        }
        for k in 0..6000 {
            let (sample, alpha) = bench.sample(rate(f64::from(k) * 0.01), 0.01);
            calibrator.turn(&sample, alpha).unwrap();
        }
        calibrator.finish().unwrap()
    }

    fn bench(w_ie_b: Vec3<Body, f64>) -> Bench {
        Bench { alpha: 0.4, w_ie_b }
    }

    fn assert_found(c: &Calibration<f64>, bias: f64, column: f64) {
        assert!(
            (c.bias_s - Vec3::from_vector(Vector3::from(D))).norm() <= bias,
            "{:?}",
            c.bias_s
        );
        for (found, k) in [c.k_xz, c.k_yz, c.s_z].into_iter().zip(K) {
            assert!((found - k).abs() <= column, "{found} {k}");
        }
    }

    #[test]
    fn finds_what_is_there() {
        for rate_dps in [10.0, -20.0, 100.0] {
            let c = calibrate(&mut bench(Vec3::zero()), config(None), |_| rate_dps * DEG);
            assert_found(&c, 1e-12, 1e-12);
            assert!(c.scatter < 1e-6 && (c.turned - 60.0 * rate_dps.abs() * DEG).abs() < 1e-9);
        }
    }

    #[test]
    fn earth_rate_known_or_left_in() {
        // Three whole turns: what turns with the IMU has no mean.
        let earth = Vec3::new(1e-5, 5.5e-5, 4.5e-5);
        // Known: what is left is K times Earth's rate about z, which the paper's (32) has not.
        let c = calibrate(&mut bench(earth), config(Some(earth)), |_| 18.0 * DEG);
        assert_found(&c, 2e-7, 1e-6);
        // Left in: the biases are off by it, the misalignments by its level part over the rate.
        let c = calibrate(&mut bench(earth), config(None), |_| 18.0 * DEG);
        let level = Rot::<Body, Sensor, f64>::about_z(0.4).inverse() * earth;
        assert!((c.bias_s - Vec3::from_vector(Vector3::from(D)) - level).norm() < 3e-7);
        assert!((c.k_xz - K[0] + level.x() / (18.0 * DEG)).abs() < 2e-6);
    }

    #[test]
    fn predicted_sd_are_those_of_the_paper() {
        let arw = 1e-3;
        let one_way = calibrate(
            &mut bench(Vec3::zero()),
            CalibrationConfig {
                angle_random_walk: arw,
                ..config(None)
            },
            |_| 0.35,
        );
        let (bias, column) = (bias_sd(arw, 60.0), column_sd(arw, 60.0, 60.0 * 0.35));
        assert!((one_way.bias_sd / bias - 1.0).abs() < 1e-3);
        assert!((one_way.column_sd / column - 2.0_f64.sqrt()).abs() < 1e-3);
        let both_ways = calibrate(
            &mut bench(Vec3::zero()),
            CalibrationConfig {
                angle_random_walk: arw,
                ..config(None)
            },
            |t| {
                if ((t / 15.0) as u32).is_multiple_of(2) {
                    0.35
                } else {
                    -0.35
                }
            },
        );
        assert!((both_ways.bias_sd / bias - 0.5_f64.sqrt()).abs() < 1e-3);
        assert!((both_ways.column_sd / column - 1.0).abs() < 1e-3);
        assert_found(&both_ways, 1e-9, 1e-9);
    }

    #[test]
    fn single_precision_is_enough() {
        let mut bench = bench(Vec3::zero());
        let mut calibrator = Calibrator::new(CalibrationConfig::<f32>::default()).unwrap();
        let cast = |s: &Sample<f64>| Sample {
            dtheta_s: s.dtheta_s.cast::<f32>(),
            dv_s: s.dv_s.cast(),
            dt: s.dt as f32,
            gap: 0.0,
        };
        for k in 0..=12_000 {
            let (sample, alpha) = bench.sample(if k > 6000 { 0.35 } else { 0.0 }, 0.01);
            if k > 6000 {
                calibrator.turn(&cast(&sample), alpha as f32).unwrap();
            } else {
                calibrator.rest(&cast(&sample), alpha as f32).unwrap();
            }
        }
        let c = calibrator.finish().unwrap();
        // A tenth of the noise of the best gyros meant, 0.02 °/√h: 7.5e-7 rad/s and 3e-6.
        assert!(
            (c.bias_s.cast::<f64>() - Vec3::from_vector(Vector3::from(D))).norm() < 7e-8,
            "{:?}",
            c.bias_s
        );
        assert!(
            (f64::from(c.s_z) - K[2]).abs() < 3e-7 && (f64::from(c.k_xz) - K[0]).abs() < 3e-7,
            "{c:?}"
        );
        assert!(c.scatter < 0.1, "{}", c.scatter);
    }

    proptest! {
        #[test]
        fn correction_undoes_the_model(x in -1.0..1.0_f64, y in -1.0..1.0_f64, z in -1.0..1.0_f64) {
            let mut b = bench(Vec3::zero());
            let c = calibrate(&mut b, config(None), |_| 0.35);
            let dt = 0.01;
            let measured = Vector3::new(x, y, z) + Vector3::from(K) * z + Vector3::from(D);
            let sample = Sample { dtheta_s: Vec3::from_vector(measured * dt), dv_s: Vec3::zero(), dt, gap: 0.0 };
            let left = (c.corrected(&sample).dtheta_s / dt).vector() - Vector3::new(x, y, z);
            prop_assert!(left.norm() < 1e-11);
            let biases = c.biases_only().corrected(&sample).dtheta_s / dt;
            prop_assert!((biases.vector() - measured + Vector3::from(D)).norm() < 1e-11);
        }
    }

    #[test]
    fn errors_say_what_is_wrong() {
        let new = || Calibrator::new(config(None)).unwrap();
        let mut b = bench(Vec3::zero());
        let (still, alpha) = b.sample(0.0, 0.01);

        let mut c = new();
        assert_eq!(c.finish(), Err(CalibrationError::WrongPhase));
        for _ in 0..100 {
            c.rest(&still, alpha).unwrap();
        }
        assert!(matches!(c.turn(&still, alpha), Err(CalibrationError::RestTooShort { seconds, .. }) if seconds < 1.0));
        assert!(matches!(
            c.rest(&still, alpha + 0.01),
            Err(CalibrationError::RotorMoved { .. })
        ));
        assert_eq!(c.rest(&still, f64::NAN), Err(CalibrationError::Sample));
        assert_eq!(
            c.rest(&Sample { dt: -1.0, ..still }, alpha),
            Err(CalibrationError::Sample)
        );
        // Refused samples have left nothing behind.
        for _ in 0..6000 {
            c.rest(&still, alpha).unwrap();
        }
        c.turn(&still, alpha).unwrap();
        assert_eq!(c.rest(&still, alpha), Err(CalibrationError::WrongPhase));
        assert!(matches!(c.finish(), Err(CalibrationError::TooLittleTurn { turned, .. }) if turned == 0.0));

        // A base that swings by 0.1° every 6 s, in the rest and in the turn.
        let swung = |k: i32, s: &Sample<f64>| Sample {
            dtheta_s: s.dtheta_s + Vec3::new(0.1 * DEG * (f64::from(k) * 0.01047).cos() * 0.01047, 0.0, 0.0),
            ..*s
        };
        let mut c = new();
        for k in 0..6001 {
            c.rest(&swung(k, &still), alpha).unwrap();
        }
        assert!(matches!(c.turn(&still, alpha), Err(CalibrationError::BaseMoved { .. })));
        let mut c = new();
        for _ in 0..6001 {
            c.rest(&still, alpha).unwrap();
        }
        for k in 0..6000 {
            let (sample, alpha) = b.sample(0.35, 0.01);
            c.turn(&swung(k, &sample), alpha).unwrap();
        }
        assert!(matches!(c.finish(), Err(CalibrationError::BaseMoved { .. })));

        for bad in [
            CalibrationConfig {
                angle_random_walk: 0.0,
                ..config(None)
            },
            CalibrationConfig {
                instability: f64::NAN,
                ..config(None)
            },
            CalibrationConfig {
                rest: 0.0,
                ..config(None)
            },
            CalibrationConfig {
                turn: -1.0,
                ..config(None)
            },
            config(Some(Vec3::new(f64::NAN, 0.0, 0.0))),
        ] {
            assert!(matches!(Calibrator::new(bad), Err(CalibrationError::Config(_))));
        }
    }
}
