//! The encoder constraint: on a base that is fixed to Earth, the z gyro is measured by the rotor's encoder.
//!
//! What the gyros say the IMU turned, less what the encoder says the rotor turned, less what Earth turned, is the turn
//! of the base. Where there is none, it is the strapdown's own error, and mostly the bias of the z gyro: what nothing
//! else tells while the rotor's axis is upright, and what makes a heading once found drift. \[Yu15\] (11)–(16) have it
//! as a rate, `δω_z = ω_N φ_E + ε_z`; here it is the turn about the vertical from one measurement to the next, so that
//! no sample between them is lost:
//!
//! ```text
//! C_b^n = C_s^n C_b^s(α)      z = up · log(C_b^n(k) C_b^n(k−1)ᵀ) = −(φ_U(k) − φ_U(k−1)) = h x + noise
//! h = −up (Φ − I)_φ:  ∫C_s^n on ε and x,  ∫C_s^n ω_k on column k of M,  T on δω,  T up × ω_ie on φ
//! r = q² T + 2 σ_α²           q the angle random walk, σ_α an angle read from the encoder
//! ```
//!
//! A scale factor of the z gyro turns its sign with the rotor and is told from the bias so. That z has the gyro's noise
//! in common with φ is left out: together they would say that φ_U walks no more, 0.006° in five minutes.
//!
//! # Only where it is configured
//!
//! A base that yaws at a constant rate and a gyro with a bias are the same thing to z. No test of z tells one from the
//! other, so that a base is never believed not to yaw because it is quiet: that it is fixed to Earth (a floor, a pillar, a
//! tripod on the ground) is said by configuration, with [`EncoderConstraint`](crate::fine::EncoderConstraint) in
//! [`FilterConfig`](crate::fine::FilterConfig). What is configured is checked as well. The measurement is taken only
//! after [`SETTLE`] in a row in which nothing speaks against it:
//!
//! - the base does not tilt: no faster than `still_rate`. A ship that rolls by 0.2° in 8 s does so by 2.7 mrad/s, and is
//!   found by it however slowly it veers; a raft that moves by less than 0.06 °/s is not;
//! - z is within `gate` σ of what is expected: no faster yaw than the gyro's bias could be, as it is known by then;
//! - so is the mean of z over about 16 measurements: no slow yaw that begins when the bias is known. A step of the bias
//!   looks the same, and likewise ends the constraint until z fits again.
//!
//! While it is not taken the filter is, bit for bit, the one without it.
//!
//! What is left is a base that was said to be fixed and yaws evenly, from the beginning and without tilting, within
//! `gate` σ of the z gyro's bias. That rate is taken for bias, σ does not say so, and the innovations do not either. Of
//! heading after 300 s (scenario `static`, bias 10 °/h 1σ, seed 2026) this makes
//!
//! | yaw | mean error | RMS | (error/σ)² |
//! |---|---|---|---|
//! | none | 0.02° | 0.33° | 0.9 |
//! | 5 °/h | −0.21° | 0.35° | 1.0 |
//! | 15 °/h | −0.60° | 0.66° | 3.5 |
//! | 36 °/h | −1.08° | 1.34° | 14 |
//!
//! where the filter without it has an RMS of 0.50° throughout. It goes on growing while σ falls: at 5 °/h to −0.44° after
//! 900 s and −0.67° after 1800 s, with σ of 0.21° and 0.18°.
//!
//! # When
//!
//! With every measurement of the filter for which the rotor's angle is known. [`Aligner`](crate::aligner::Aligner) tells
//! it live and queues none for its replay: what z says of a constant bias it says in the first minute live as well, and
//! the covariance carries it back to the heading that was found before.
//!
//! References: \[Yu15\] *A Stationary North-Finding Scheme for an Azimuth Rotational IMU Utilizing a Linear State Equality
//! Constraint*, Sensors 2015, 15(2), 4368: section 2.2.

use frames::{Body, Nav, Real, Rot, Sensor, Vec3, math, units};
use nalgebra::Vector3;

use crate::covariance::{Covariance, Gain, LARGEST_CUT};

/// Measurements in a row that must agree with a base at rest before one is taken, and that the mean goes over: 16 s.
pub const SETTLE: u8 = 16;

/// Weight of the newest in the running mean.
const MEAN_GAIN: f64 = 1.0 / SETTLE as f64;

/// Figures of the encoder constraint.
///
/// | field | unit | zero means | sane value |
/// |---|---|---|---|
/// | `encoder_sd` | rad | the encoder is exact | 10″ |
/// | `still_rate` | rad/s | never taken | 1 mrad/s |
/// | `gate` | σ | never taken | 3 |
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ConstraintConfig<T: Real = f32> {
    /// 1σ of an angle read from the encoder, errors that repeat with the angle included, rad. They are taken as white,
    /// which is the cautious side: a turn read twice is wrong by the difference of its ends, however long it was.
    pub encoder_sd: T,
    /// Mean rate of tilt from one measurement to the next beyond which the base moves, rad/s. What the rotor makes of a
    /// tilt must stay below: at 20 °/s 0.2 mrad/s of a gyro misaligned by 2′, and 1 mrad/s of an IMU whose z axis is
    /// 0.16° off the rotor's.
    pub still_rate: T,
    /// How many σ are too many.
    pub gate: T,
}

impl<T: Real> Default for ConstraintConfig<T> {
    fn default() -> Self {
        Self {
            encoder_sd: T::lit(10.0 * units::ARC_SEC),
            still_rate: T::lit(1e-3),
            gate: T::lit(3.0),
        }
    }
}

impl<T: Real> ConstraintConfig<T> {
    /// Whether every figure is finite and not negative.
    pub fn is_valid(&self) -> bool {
        [self.encoder_sd, self.still_rate, self.gate]
            .iter()
            .all(|x| x.finite() && *x >= T::zero())
    }
}

/// Where base and rotor were.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Mark<T: Real> {
    c_nb: Rot<Nav, Body, T>,
    alpha: T,
}

impl<T: Real> Mark<T> {
    fn new(c_ns: Rot<Nav, Sensor, T>, alpha: T) -> Self {
        let c_nb = c_ns * Rot::about_z(alpha).inverse();
        Self { c_nb, alpha }
    }
}

/// One turn of the base, as it seems.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Turn<T: Real> {
    /// From one measurement to the next, rad.
    pub(crate) base: Vec3<Nav, T>,
    /// Of the rotor meanwhile, rad.
    pub(crate) rotor: T,
}

/// Innovation of one turn about the vertical, and its variance by parts.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct ScalarInnovation<T: Real> {
    /// Measured less expected, rad.
    pub(crate) residual: T,
    /// Variance of what was expected, rad².
    pub(crate) predicted_var: T,
    /// Of the gyros' noise, rad².
    pub(crate) walk_var: T,
}

/// Stationarity detector: follows the base from measurement to measurement, and says whether the constraint may be applied.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct StationarityDetector<T: Real> {
    /// Angle of the rotor at the end of the increment that is taken next, if it is known, rad.
    pub(crate) alpha: Option<T>,
    before: Option<Mark<T>>,
    /// Measurements in a row that agreed, [`SETTLE`] at most.
    quiet: u8,
    /// Running mean of the innovation, rad, by the state as it is now.
    mean: T,
}

impl<T: Real> StationarityDetector<T> {
    pub(crate) fn new() -> Self {
        Self {
            alpha: None,
            before: None,
            quiet: 0,
            mean: T::zero(),
        }
    }

    /// The strapdown is not where it was: what comes next has no beginning.
    pub(crate) fn forget(&mut self) {
        self.before = None;
    }

    /// Whether the base has been at rest for long enough.
    pub(crate) fn holds(&self) -> bool {
        self.quiet >= SETTLE
    }

    /// What the base has turned since [`StationarityDetector::mark`], if the rotor's angle is known at both ends.
    pub(crate) fn turn(&self, c_ns: Rot<Nav, Sensor, T>) -> Option<Turn<T>> {
        let (before, now) = (self.before?, Mark::new(c_ns, self.alpha?));
        Some(Turn {
            base: (now.c_nb * before.c_nb.inverse()).log(),
            rotor: now.alpha - before.alpha,
        })
    }

    /// From here on.
    pub(crate) fn mark(&mut self, c_ns: Rot<Nav, Sensor, T>) {
        self.before = self.alpha.map(|alpha| Mark::new(c_ns, alpha));
    }

    /// The noise variance to take a turn of `dt` seconds with, rad², if it is to be taken.
    pub(crate) fn judge(
        &mut self,
        config: &ConstraintConfig<T>,
        turn: &Turn<T>,
        z: &ScalarInnovation<T>,
        dt: T,
    ) -> Option<T> {
        let zero = T::zero();
        let gate2 = config.gate * config.gate;
        let gain = T::lit(MEAN_GAIN);
        let angle_var = config.encoder_sd * config.encoder_sd;
        let r = z.walk_var + angle_var * T::lit(2.0);
        // Comparisons with NaN are false.
        let tilt = math::hypot(turn.base.x(), turn.base.y());
        let still = tilt < config.still_rate * dt && z.residual * z.residual < gate2 * (z.predicted_var + r);
        self.mean = if still {
            self.mean + (z.residual - self.mean) * gain
        } else {
            zero
        };
        // Of white noise a running mean leaves g/(2 − g); of readings of the encoder, each of them in two turns with
        // opposite signs, 2 g²/(2 − g) of what one has.
        let left = gain / (T::lit(2.0) - gain);
        let mean_var = z.predicted_var + (z.walk_var + angle_var * T::lit(2.0) * gain) * left;
        self.quiet = if still && self.mean * self.mean < gate2 * mean_var {
            (self.quiet + 1).min(SETTLE)
        } else {
            0
        };
        self.holds().then_some(r)
    }

    /// The state's correction has accounted for `taken` of the innovation, rad.
    pub(crate) fn took(&mut self, taken: T) {
        self.mean -= taken;
    }
}

/// A measurement of `row` · x, and the variance that was expected of it.
pub(crate) struct Row<T: Real, const B: usize> {
    /// P hᵀ.
    p_h: [Vector3<T>; B],
    /// h P hᵀ.
    pub(crate) predicted_var: T,
}

impl<T: Real, const B: usize> Row<T, B> {
    pub(crate) fn new(covariance: &Covariance<T, B>, row: &[Vector3<T>; B]) -> Self {
        let mut p_h = [Vector3::zeros(); B];
        let measured = |(_, h): &(usize, &Vector3<T>)| **h != Vector3::zeros();
        for (j, h) in row.iter().enumerate().filter(measured) {
            for (i, sum) in p_h.iter_mut().enumerate() {
                *sum += covariance.block(i, j) * h;
            }
        }
        let predicted_var = product(row, &p_h).max(T::zero());
        Self { p_h, predicted_var }
    }

    /// h P gᵀ with another row g.
    pub(crate) fn covariance_with(&self, other: &[Vector3<T>; B]) -> T {
        product(other, &self.p_h)
    }

    /// Takes it with noise variance `r` > 0, raised to what [`LARGEST_CUT`] asks for: s = h P hᵀ + r, K = P hᵀ/s,
    /// P ← P − K (P hᵀ)ᵀ.
    pub(crate) fn update(&self, covariance: &mut Covariance<T, B>, r: T) -> Gain<T, B> {
        let innovation_var = self.predicted_var + r.max(self.predicted_var * T::lit(1.0 / LARGEST_CUT));
        let inverse = T::one() / innovation_var;
        let column = self.p_h.map(|part| part * inverse);
        for (i, gain) in column.iter().enumerate() {
            for (j, part) in self.p_h.iter().enumerate().skip(i) {
                covariance.add(i, j, &(-(gain * part.transpose())));
            }
        }
        Gain { column, innovation_var }
    }
}

/// a · b.
pub(crate) fn product<T: Real, const B: usize>(a: &[Vector3<T>; B], b: &[Vector3<T>; B]) -> T {
    a.iter().zip(b).fold(T::zero(), |sum, (a, b)| sum + a.dot(b))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        aligner::{Aligner, AlignerConfig, Mode},
        earth::Earth,
        fine::{EncoderConstraint, FilterConfig, FineFilter, Method},
        increment::{Increment, Sample},
        model::{BG, PAPER, PHI, ROBUST},
        noise::ImuNoise,
        rotor::{RotorConfig, Schedule},
    };
    use frames::units::{ARC_SEC, DEG, DEG_PER_HOUR};

    const DT: f64 = 0.05;

    fn earth<T: Real>() -> Earth<T> {
        Earth::new(T::lit(40.0 * DEG), T::zero()).unwrap()
    }

    fn constrained<T: Real, const B: usize>(config: ConstraintConfig<T>) -> FilterConfig<T, B> {
        FilterConfig {
            method: Method::strong_tracking(),
            encoder_constraint: EncoderConstraint::new(config),
            ..FilterConfig::default()
        }
    }

    /// A base, level but for what `attitude` says of it (yaw, pitch, roll at a time), under a turning rotor; a z gyro
    /// with an error of `bias` and `scale`. Nothing else is wrong.
    struct Bench<T: Real, const B: usize> {
        filter: FineFilter<T, B>,
        schedule: Schedule<f64>,
        attitude: fn(f64) -> [f64; 3],
        bias: f64,
        scale: f64,
        k: u32,
    }

    impl<T: Real, const B: usize> Bench<T, B> {
        fn new(config: FilterConfig<T, B>, attitude: fn(f64) -> [f64; 3]) -> Self {
            let mut bench = Self::open(config, attitude);
            bench.filter.close_loop();
            bench
        }

        fn open(config: FilterConfig<T, B>, attitude: fn(f64) -> [f64; 3]) -> Self {
            let [yaw, pitch, roll] = attitude(0.0).map(T::lit);
            let start = Rot::from_yaw_pitch_roll(yaw, pitch, roll) * Rot::about_z(T::zero());
            Self {
                filter: FineFilter::new(config, earth(), start, None).unwrap(),
                schedule: Schedule::new(RotorConfig::default()).unwrap(),
                attitude,
                bias: 0.0,
                scale: 0.0,
                k: 0,
            }
        }

        fn run(&mut self, seconds: f64) -> &FineFilter<T, B> {
            let earth = earth::<f64>();
            let c_nb = |t: f64| {
                let [yaw, pitch, roll] = (self.attitude)(t);
                Rot::<Nav, Body, f64>::from_yaw_pitch_roll(yaw, pitch, roll)
            };
            let c_ns = |t: f64| c_nb(t) * Rot::about_z(self.schedule.at(t).angle);
            let end = f64::from(self.k) * DT + seconds;
            while f64::from(self.k) * DT < end - 0.5 * DT {
                let t = f64::from(self.k) * DT;
                self.k += 1;
                let phi_s = (c_ns(t).inverse() * Rot::exp(earth.w_ie_n() * DT) * c_ns(t + DT)).log();
                let gyro_error = Vec3::new(0.0, 0.0, self.bias * DT + self.scale * phi_s.z());
                let dv_s = c_ns(t).inverse() * earth.g_n() * -DT;
                let increment = Increment {
                    phi_s: (phi_s + gyro_error).cast(),
                    dv_s: dv_s.cast(),
                    dt: T::lit(DT),
                };
                let alpha = T::lit(self.schedule.at(t + DT).angle);
                self.filter.rotor_at(Some(alpha));
                self.filter.step(&increment, alpha);
            }
            &self.filter
        }

        /// Estimate and σ of the z bias, °/h.
        fn z_bias(&self) -> [f64; 2] {
            let estimate = self.filter.solution().corrections.gyro_bias_s.z();
            [estimate, self.filter.gyro_bias_sd().z()].map(|x| x.to_f64() / DEG_PER_HOUR)
        }
    }

    fn at_rest(_: f64) -> [f64; 3] {
        [0.4, 0.0, 0.0]
    }

    fn bias_is_found<T: Real, const B: usize>() {
        let alone = FilterConfig {
            encoder_constraint: None,
            ..constrained::<T, B>(ConstraintConfig::default())
        };
        let mut bench = Bench::new(alone, at_rest);
        bench.bias = 8.0 * DEG_PER_HOUR;
        bench.run(120.0);
        assert!(bench.z_bias()[1] > 9.0, "not seen without: {:?}", bench.z_bias());

        let mut bench = Bench::new(constrained::<T, B>(ConstraintConfig::default()), at_rest);
        bench.bias = 8.0 * DEG_PER_HOUR;
        assert!(!bench.run(15.0).is_constrained());
        assert!(bench.run(105.0).is_constrained());
        let [z, sd] = bench.z_bias();
        // 10″ at either end and the walk, of 103 seconds: √(2·10² + 1.2²)/√103 = 1.4 °/h.
        assert!((z - 8.0).abs() < 0.3 && (1.3..1.5).contains(&sd), "{z} {sd}");
        assert!(bench.filter.is_sound());
    }

    #[test]
    fn bias_of_the_z_gyro_is_found_at_rest() {
        bias_is_found::<f64, PAPER>();
        bias_is_found::<f32, PAPER>();
        bias_is_found::<f64, ROBUST>();
        bias_is_found::<f32, ROBUST>();
    }

    /// With an exact encoder a scale factor is 30 times the noise; the rotor's reversals tell it from a bias.
    #[test]
    fn scale_factor_is_told_from_bias() {
        let exact = ConstraintConfig {
            encoder_sd: 0.0,
            ..ConstraintConfig::default()
        };
        let mut config = constrained::<f64, ROBUST>(exact);
        config.noise.gyro_scale_factor_sd = 3e-4;
        let mut bench = Bench::new(config, at_rest);
        (bench.bias, bench.scale) = (-8.0 * DEG_PER_HOUR, 4e-4);
        bench.run(120.0);
        let [z, sd] = bench.z_bias();
        let scale = bench.filter.solution().corrections.gyro_matrix[(2, 2)];
        assert!((z + 8.0).abs() < 0.1 && sd < 0.15, "{z} {sd}");
        assert!((scale - 4e-4).abs() < 1e-6, "{scale:e}");
        // Without a state for it the scale factor is noise, and the bias is found by the way.
        let mut config = constrained::<f64, PAPER>(exact);
        config.noise.gyro_scale_factor_sd = 3e-4;
        let mut bench = Bench::new(config, at_rest);
        (bench.bias, bench.scale) = (-8.0 * DEG_PER_HOUR, 4e-4);
        // Whole cycles from the first measurement that is taken on.
        bench.run(17.0 + 4.0 * 36.2);
        let [z, sd] = bench.z_bias();
        assert!((z + 8.0).abs() < 2.0 * sd && sd < 3.0, "{z} {sd}");
    }

    fn harmless<const B: usize>(attitude: fn(f64) -> [f64; 3]) {
        let with = constrained::<f32, B>(ConstraintConfig::default());
        let without = FilterConfig {
            encoder_constraint: None,
            ..with
        };
        let (mut a, mut b) = (Bench::new(with, attitude), Bench::new(without, attitude));
        for _ in 0..120 {
            let (a, b) = (a.run(1.0), b.run(1.0));
            assert!(!a.is_constrained());
            assert_eq!((a.solution(), a.covariance()), (b.solution(), b.covariance()));
        }
    }

    /// Whatever floats or turns is found, and leaves no bit of what the filter is without the constraint.
    #[test]
    fn a_base_that_moves_is_not_measured_by() {
        fn swing(t: f64) -> [f64; 3] {
            [0.4 + 0.17 * math::sin_cos(core::f64::consts::TAU * t / 5.0).0, 0.0, 0.0]
        }
        fn veering_ship(t: f64) -> [f64; 3] {
            let roll = 0.2 * DEG * math::sin_cos(core::f64::consts::TAU * t / 8.0).0;
            [0.4 + 0.01 * DEG * t, 0.0, roll]
        }
        fn turntable(t: f64) -> [f64; 3] {
            [0.4 + 0.02 * DEG * t, 0.0, 0.0]
        }
        for attitude in [swing, veering_ship, turntable] {
            harmless::<PAPER>(attitude);
            harmless::<ROBUST>(attitude);
        }
    }

    /// At rest for three minutes, then turning at 0.01 °/s, or at 12 °/h: the bias stays what it was found to be, and
    /// heading is followed.
    #[test]
    fn a_base_that_begins_to_yaw_is_found() {
        fn fast(t: f64) -> [f64; 3] {
            [0.4 + 0.01 * DEG * (t - 180.0).max(0.0), 0.0, 0.0]
        }
        fn slow(t: f64) -> [f64; 3] {
            [0.4 + 12.0 * DEG_PER_HOUR * (t - 180.0).max(0.0), 0.0, 0.0]
        }
        for (attitude, moved) in [(fast as fn(f64) -> [f64; 3], 0.4), (slow, 1.5)] {
            let mut bench = Bench::new(constrained::<f64, ROBUST>(ConstraintConfig::default()), attitude);
            bench.bias = 8.0 * DEG_PER_HOUR;
            assert!(bench.run(180.0).is_constrained());
            let [before, _] = bench.z_bias();
            assert!(!bench.run(60.0).is_constrained());
            let [after, _] = bench.z_bias();
            // They have been measured by for as long as the mean took to show them: two seconds, and ten.
            assert!((after - before).abs() < moved, "{before} {after}");
        }
    }

    /// What no test can find: a base that was said to be fixed and has always yawed, no faster than the gyro's bias may
    /// be. Its rate is taken for bias, with a σ that says nothing of it, and heading lags by what was not seen.
    #[test]
    fn an_even_yaw_from_the_beginning_is_taken_for_bias() {
        fn yaws(t: f64) -> [f64; 3] {
            [0.4 + 5.0 * DEG_PER_HOUR * t, 0.0, 0.0]
        }
        let mut bench = Bench::new(constrained::<f64, ROBUST>(ConstraintConfig::default()), yaws);
        assert!(bench.run(300.0).is_constrained());
        let [z, sd] = bench.z_bias();
        assert!((z - 5.0).abs() < 0.2 && sd < 1.0, "{z} {sd}");
    }

    /// Knocked once, the base has to be at rest for as long as at the start.
    #[test]
    fn a_knock_ends_it_for_a_while() {
        fn knocked(t: f64) -> [f64; 3] {
            [if t < 60.5 { 0.4 } else { 0.401 }, 0.0, 0.0]
        }
        let mut bench = Bench::new(constrained::<f64, ROBUST>(ConstraintConfig::default()), knocked);
        assert!(bench.run(60.0).is_constrained());
        let before = bench.z_bias();
        assert!(!bench.run(1.0).is_constrained());
        assert!(!bench.run(15.0).is_constrained());
        assert!(bench.run(2.0).is_constrained());
        assert!((bench.z_bias()[0] - before[0]).abs() < 0.1);
    }

    /// The strapdown jumps when the loop closes, the base does not.
    #[test]
    fn closing_the_loop_is_no_turn_of_the_base() {
        let mut bench = Bench::open(constrained::<f64, PAPER>(ConstraintConfig::default()), at_rest);
        bench.bias = 8.0 * DEG_PER_HOUR;
        assert!(bench.run(60.5).is_constrained());
        let before = bench.filter.solution().c_ns.get();
        bench.filter.close_loop();
        assert!(bench.filter.solution().c_ns.get().angle_to(before) < 1e-6);
        assert!(bench.run(2.0).is_constrained());
        assert!((bench.z_bias()[0] - 8.0).abs() < 0.5);
    }

    /// An hour in single precision, by the tightest encoder there is.
    #[test]
    fn covariance_stays_sound_in_single_precision() {
        let exact = ConstraintConfig {
            encoder_sd: 0.0,
            ..ConstraintConfig::default()
        };
        let mut config = constrained::<f32, ROBUST>(exact);
        config.noise = ImuNoise {
            gyro_instability_sd: f32::lit(3.0 * DEG_PER_HOUR),
            gyro_instability_tau: 100.0,
            gyro_scale_factor_sd: 3e-4,
            gyro_misalignment_sd: 6e-4,
            ..config.noise
        };
        let mut bench = Bench::new(config, at_rest);
        bench.bias = 8.0 * DEG_PER_HOUR;
        let mut taken = 0;
        for _ in 0..3600 {
            let filter = bench.run(1.0);
            assert!(filter.is_sound());
            taken += u32::from(filter.is_constrained());
        }
        assert!(taken > 3500, "{taken}");
    }

    /// A row of one component is the update of that component.
    #[test]
    fn a_row_is_an_update() {
        let mut p = Covariance::<f64, PAPER>::diagonal([Vector3::new(4.0, 1.0, 2.0); PAPER]);
        p.add(
            PHI,
            BG,
            &nalgebra::Matrix3::from_fn(|i, j| 0.1 * (i as f64 - 2.0 * j as f64)),
        );
        let mut by_row = p;
        let mut h = [Vector3::zeros(); PAPER];
        h[BG].z = 1.0;
        let expected = p.update(BG, 2, 0.3);
        let gain = Row::new(&by_row, &h).update(&mut by_row, 0.3);
        assert!((gain.innovation_var - expected.innovation_var).abs() < 1e-15);
        for (a, b) in gain.column.iter().zip(&expected.column) {
            assert!((a - b).amax() < 1e-15);
        }
        for (i, j) in (0..PAPER).flat_map(|i| (i..PAPER).map(move |j| (i, j))) {
            assert!((p.block(i, j) - by_row.block(i, j)).amax() < 1e-15, "({i}, {j})");
        }
        assert!(by_row.is_sound());
    }

    #[test]
    fn figures_out_of_range_make_none() {
        let good = ConstraintConfig::<f32>::default();
        assert_eq!(EncoderConstraint::<f32>::new(good).map(|c| *c.config()), Some(good));
        for bad in [
            ConstraintConfig {
                encoder_sd: -1.0,
                ..good
            },
            ConstraintConfig {
                still_rate: f32::NAN,
                ..good
            },
            ConstraintConfig {
                gate: f32::INFINITY,
                ..good
            },
        ] {
            assert_eq!(EncoderConstraint::<f32>::new(bad), None);
        }
    }

    /// The whole way, from samples with the encoder's angle: through queue, replay and a gap, the bias is found live.
    #[test]
    fn aligner_is_constrained_when_it_is_live() {
        let (earth, c_nb) = (
            earth::<f64>(),
            Rot::<Nav, Body, f64>::from_yaw_pitch_roll(0.4, 0.01, -0.02),
        );
        let schedule = Schedule::<f64>::new(RotorConfig::default()).unwrap();
        let exact = ConstraintConfig {
            encoder_sd: f32::lit(ARC_SEC),
            ..ConstraintConfig::default()
        };
        let run = |filter: FilterConfig<f32>| {
            let config = AlignerConfig::for_rotor(f32::lit(40.0 * DEG), 0.0, &RotorConfig::default(), filter);
            let mut aligner = Aligner::<f32>::new(config).unwrap();
            let mut t = 0.0;
            for k in 0..12_000_u32 {
                // 30 ms are missing about once a second, so that increments of all kinds end with a bridge.
                let gap = if k % 41 == 40 { 0.03 } else { 0.0 };
                t += gap;
                let dt = 0.01;
                let (from, to) = (schedule.at(t).angle, schedule.at(t + dt).angle);
                let c_ns = c_nb * Rot::about_z(0.5 * (from + to));
                let earth_turn = c_ns.inverse() * earth.w_ie_n() * dt;
                let dtheta_s = Vec3::new(0.0, 0.0, to - from + 8.0 * DEG_PER_HOUR * dt) + earth_turn;
                let sample = Sample {
                    dtheta_s: dtheta_s.cast(),
                    dv_s: (c_ns.inverse() * earth.g_n() * -dt).cast(),
                    dt: f32::lit(dt),
                    gap: f32::lit(gap),
                };
                aligner.step(&sample, f32::lit(to));
                t += dt;
            }
            assert!(matches!(aligner.mode(), Mode::Fine | Mode::Aligned));
            let estimate = aligner.estimate().unwrap();
            [estimate.gyro_bias_s.z(), estimate.gyro_bias_sd.z()].map(|x| x.to_f64() / DEG_PER_HOUR)
        };
        let config = constrained::<f32, ROBUST>(exact);
        let [_, sd] = run(FilterConfig {
            encoder_constraint: None,
            ..config
        });
        assert!(sd > 5.0, "{sd}");
        let [z, sd] = run(config);
        assert!((z - 8.0).abs() < 0.5 && sd < 0.5, "{z} {sd}");
    }
}
