//! Sensor errors, seeded, applied to exact increments.
//!
//! ```text
//! Δθ' = (I + M_g) Δθ + G Δv + (b_g + x_g + C_b^s h) dt + n_g    n_g ~ N(0, ARW² dt)
//! Δv' = (I + M_a) Δv        + (b_a + x_a) dt + n_a              n_a ~ N(0, VRW² dt)
//! ẋ = −x/τ + w,  E x² = σ²                                first-order Gauss–Markov, stationary from the start
//! ```
//!
//! then saturation, then quantisation with the remainder carried to the next sample.
//!
//! # Seeds
//!
//! One 64-bit seed makes a run. It keys ChaCha8, and every source of chance has a [`Stream`] of its own under that key:
//! switching one error on, or scaling it, leaves every other draw as it was. Runs of a Monte Carlo have the seeds
//! [`run_seed`] derives from the one given.
//!
//! Not modelled: temperature, bandwidth, vibration rectification, correlated axes.

use core::f64::consts::TAU;

use frames::units::{
    ARC_MIN, ARC_SEC, DEG, DEG_PER_HOUR, DEG_PER_SQRT_HOUR, MICRO_G, MICRO_G_PER_SQRT_HZ, PPM, STANDARD_GRAVITY,
};
use frames::{Sensor, Vec3};
use nalgebra::{Matrix3, Rotation3, Vector3};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;

use crate::scenario::Scenario;

/// The sources of chance in a run. The number is the stream's and is part of what a seed means: append, never renumber.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(u64)]
pub enum Stream {
    /// Phases and the random heading, drawn by [`Truth`](crate::truth::Truth).
    Motion = 0,
    /// Turn-on bias of the gyros.
    GyroBias = 1,
    /// Turn-on bias of the accelerometers.
    AccelBias = 2,
    /// Bias instability of the gyros.
    GyroInstability = 3,
    /// Bias instability of the accelerometers.
    AccelInstability = 4,
    /// Angle random walk.
    AngleWalk = 5,
    /// Velocity random walk.
    VelocityWalk = 6,
    /// Scale factors of the gyros.
    GyroScale = 7,
    /// Misalignments of the gyros.
    GyroMisalignment = 8,
    /// Scale factors of the accelerometers.
    AccelScale = 9,
    /// Misalignments of the accelerometers.
    AccelMisalignment = 10,
    /// Response of the gyros to specific force.
    GSensitivity = 11,
    /// Where the rotor stands at power-up.
    RotorStart = 12,
    /// The motor as made, and the noise of its encoder.
    Plant = 13,
    /// Jitter and loss of data-ready edges.
    DataReady = 14,
    /// Noise of the serial line.
    Serial = 15,
    /// Gyro error fixed to the housing.
    GyroHousing = 16,
    /// Frequencies and phases of an irregular sea.
    Sea = 17,
    /// Phases of the wobble of the rotor's axis.
    Wobble = 18,
}

/// The generator of one source of chance in the run with this seed.
pub fn stream(seed: u64, stream: Stream) -> ChaCha8Rng {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    rng.set_stream(stream as u64);
    rng
}

/// The seed of run `run` of a Monte Carlo with the seed `master`: SplitMix64, so that neighbouring masters share no
/// runs.
pub fn run_seed(master: u64, run: u64) -> u64 {
    let mix = |x: u64| {
        let x = x.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let x = (x ^ (x >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        let x = (x ^ (x >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        x ^ (x >> 31)
    };
    mix(mix(master) ^ run)
}

fn normals(rng: &mut ChaCha8Rng) -> Vector3<f64> {
    Vector3::from_fn(|_, _| rng.sample(StandardNormal))
}

/// First-order Gauss–Markov bias of three axes.
#[derive(Debug, Clone)]
struct GaussMarkov {
    sd: f64,
    tau: f64,
    value: Vector3<f64>,
    rng: ChaCha8Rng,
}

impl GaussMarkov {
    fn new(sd: f64, tau: f64, mut rng: ChaCha8Rng) -> Self {
        Self {
            sd,
            tau,
            value: normals(&mut rng) * sd,
            rng,
        }
    }

    /// Moves on by `dt` and returns the mean over it.
    ///
    /// The process is exact at the ends. Its mean between them is taken as the mean of the ends; what that leaves out
    /// is `σ √(dt/6τ)`-sized within a sample, white, 1/1000 of the angle random walk for 3 °/h at 100 Hz.
    fn step(&mut self, dt: f64) -> Vector3<f64> {
        if self.sd == 0.0 {
            return self.value;
        }
        let start = self.value;
        let decay = (-dt / self.tau).exp();
        // 1 − e^(−2x) without cancellation.
        let kick = self.sd * (-(-2.0 * dt / self.tau).exp_m1()).sqrt();
        self.value = start * decay + normals(&mut self.rng) * kick;
        (start + self.value) * 0.5
    }
}

/// White noise on increments: a random walk of their sum.
#[derive(Debug, Clone)]
struct Walk {
    /// Per √s.
    density: f64,
    rng: ChaCha8Rng,
}

impl Walk {
    fn step(&mut self, dt: f64) -> Vector3<f64> {
        if self.density == 0.0 {
            return Vector3::zeros();
        }
        normals(&mut self.rng) * (self.density * dt.sqrt())
    }
}

/// Saturation and quantisation of one triad.
#[derive(Debug, Clone)]
struct Output {
    quantum: f64,
    /// Largest mean over a sample.
    range: Option<f64>,
    remainder: Vector3<f64>,
}

impl Output {
    /// The increments as put out, and whether any was clipped.
    fn apply(&mut self, increment: Vector3<f64>, dt: f64) -> (Vector3<f64>, bool) {
        let mut saturated = false;
        let clipped = match self.range {
            None => increment,
            Some(range) => increment.map(|x| {
                saturated |= x.abs() > range * dt;
                x.clamp(-range * dt, range * dt)
            }),
        };
        if self.quantum == 0.0 {
            return (clipped, saturated);
        }
        let sum = clipped + self.remainder;
        let out = sum.map(|x| (x / self.quantum).round() * self.quantum);
        self.remainder = sum - out;
        (out, saturated)
    }
}

/// One sample as the IMU gives it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Measured {
    /// Angle increment, rad.
    pub dtheta_s: Vec3<Sensor, f64>,
    /// Velocity increment, m/s.
    pub dv_s: Vec3<Sensor, f64>,
    /// Whether any axis was clipped at its range.
    pub saturated: bool,
}

/// The errors of one IMU in one run.
#[derive(Debug, Clone)]
pub struct Imu {
    time: f64,
    gyro_bias: Vector3<f64>,
    gyro_step: Vector3<f64>,
    gyro_step_at: f64,
    accel_bias: Vector3<f64>,
    gyro_instability: GaussMarkov,
    accel_instability: GaussMarkov,
    angle_walk: Walk,
    velocity_walk: Walk,
    /// M of the gyros and the accelerometers.
    gyro_matrix: Matrix3<f64>,
    accel_matrix: Matrix3<f64>,
    /// G, rad/s per m/s².
    g_sensitivity: Matrix3<f64>,
    /// h, in b, rad/s.
    housing: Vector3<f64>,
    /// Angle of the rotor in the middle of the next sample, rad.
    rotor: f64,
    gyro_output: Output,
    accel_output: Output,
}

impl Imu {
    /// The IMU the seed gives for a scenario.
    pub fn new(scenario: &Scenario, seed: u64) -> Self {
        let (unit, errors) = (&scenario.imu, &scenario.errors);
        let draw = |source: Stream| -> Vector3<f64> { normals(&mut stream(seed, source)) };
        let matrix = |scale: f64, scale_source, misalignment: f64, misalignment_source| {
            let scales: Vector3<f64> = draw(scale_source) * scale;
            let mut rng = stream(seed, misalignment_source);
            Matrix3::from_fn(|row, column| {
                // Drawn for all nine, so that the stream has the shape of the matrix.
                let off: f64 = rng.sample(StandardNormal);
                if row == column { scales[row] } else { off * misalignment }
            })
        };
        let mut g_rng = stream(seed, Stream::GSensitivity);
        let g_sd = unit.gyro_g_sensitivity_sd_deg_h_g * DEG_PER_HOUR / STANDARD_GRAVITY;
        let housing = draw(Stream::GyroHousing) * (unit.gyro_housing_sd_deg_h * DEG_PER_HOUR);
        Self {
            time: 0.0,
            gyro_bias: draw(Stream::GyroBias) * (unit.gyro_bias_sd_deg_h * DEG_PER_HOUR)
                + Vector3::from(errors.gyro_bias_deg_h) * DEG_PER_HOUR,
            gyro_step: Vector3::from(errors.gyro_step_deg_h) * DEG_PER_HOUR,
            gyro_step_at: errors.gyro_step_at_s,
            accel_bias: draw(Stream::AccelBias) * (unit.accel_bias_sd_ug * MICRO_G)
                + Vector3::from(errors.accel_bias_ug) * MICRO_G,
            gyro_instability: GaussMarkov::new(
                unit.gyro_instability_deg_h * DEG_PER_HOUR,
                unit.gyro_instability_tau_s,
                stream(seed, Stream::GyroInstability),
            ),
            accel_instability: GaussMarkov::new(
                unit.accel_instability_ug * MICRO_G,
                unit.accel_instability_tau_s,
                stream(seed, Stream::AccelInstability),
            ),
            angle_walk: Walk {
                density: unit.angle_random_walk_deg_sqrt_h * DEG_PER_SQRT_HOUR,
                rng: stream(seed, Stream::AngleWalk),
            },
            velocity_walk: Walk {
                density: unit.velocity_random_walk_ug_sqrt_hz * MICRO_G_PER_SQRT_HZ,
                rng: stream(seed, Stream::VelocityWalk),
            },
            gyro_matrix: matrix(
                unit.gyro_scale_factor_sd_ppm * PPM,
                Stream::GyroScale,
                unit.gyro_misalignment_sd_arcmin * ARC_MIN,
                Stream::GyroMisalignment,
            ),
            accel_matrix: matrix(
                unit.accel_scale_factor_sd_ppm * PPM,
                Stream::AccelScale,
                unit.accel_misalignment_sd_arcmin * ARC_MIN,
                Stream::AccelMisalignment,
            ),
            g_sensitivity: Matrix3::from_fn(|_, _| g_rng.sample::<f64, _>(StandardNormal) * g_sd),
            housing: Vector3::new(housing.x, housing.y, 0.0) + Vector3::from(errors.gyro_housing_deg_h) * DEG_PER_HOUR,
            rotor: 0.0,
            gyro_output: Output {
                quantum: errors.gyro_quantum,
                range: errors.gyro_range_dps.map(|range| range * DEG),
                remainder: Vector3::zeros(),
            },
            accel_output: Output {
                quantum: errors.accel_quantum,
                range: errors.accel_range_g.map(|range| range * STANDARD_GRAVITY),
                remainder: Vector3::zeros(),
            },
        }
    }

    /// The angle of the rotor in the middle of the next sample, rad: where the gyro error that is fixed to the housing
    /// acts. Zero until it is set.
    pub fn rotor_at(&mut self, alpha: f64) {
        self.rotor = alpha;
    }

    /// What the IMU makes of the exact increments of the next `dt` seconds (rad, m/s).
    pub fn measure(&mut self, dtheta_s: Vec3<Sensor, f64>, dv_s: Vec3<Sensor, f64>, dt: f64) -> Measured {
        let (angle, velocity) = (dtheta_s.vector(), dv_s.vector());
        let start = self.time;
        self.time += dt;
        // The part of the sample after the step.
        let stepped = (self.time - self.gyro_step_at.max(start)).clamp(0.0, dt);
        let c_sb = Rotation3::from_axis_angle(&Vector3::z_axis(), -self.rotor);
        let gyro_bias = self.gyro_bias + self.gyro_instability.step(dt) + c_sb * self.housing;
        let accel_bias = self.accel_bias + self.accel_instability.step(dt);
        let angle = angle
            + self.gyro_matrix * angle
            + self.g_sensitivity * velocity
            + gyro_bias * dt
            + self.gyro_step * stepped
            + self.angle_walk.step(dt);
        let velocity = velocity + self.accel_matrix * velocity + accel_bias * dt + self.velocity_walk.step(dt);
        let (angle, gyro_saturated) = self.gyro_output.apply(angle, dt);
        let (velocity, accel_saturated) = self.accel_output.apply(velocity, dt);
        Measured {
            dtheta_s: Vec3::from_vector(angle),
            dv_s: Vec3::from_vector(velocity),
            saturated: gyro_saturated || accel_saturated,
        }
    }

    /// Bias of the gyros now: turn-on, instability and step, rad/s.
    pub fn gyro_bias_s(&self) -> Vec3<Sensor, f64> {
        let step = if self.time > self.gyro_step_at {
            self.gyro_step
        } else {
            Vector3::zeros()
        };
        Vec3::from_vector(self.gyro_bias + self.gyro_instability.value + step)
    }

    /// Bias of the accelerometers now: turn-on and instability, m/s².
    pub fn accel_bias_s(&self) -> Vec3<Sensor, f64> {
        Vec3::from_vector(self.accel_bias + self.accel_instability.value)
    }

    /// M of the gyros: scale factors on the diagonal, misalignments (rad) off it; the gyros measure `(I + M) ω`.
    pub fn gyro_matrix(&self) -> Matrix3<f64> {
        self.gyro_matrix
    }

    /// M of the accelerometers; they measure `(I + M) f`.
    pub fn accel_matrix(&self) -> Matrix3<f64> {
        self.accel_matrix
    }

    /// The gyro error that is fixed to the housing, in b, rad/s.
    pub fn gyro_housing_b(&self) -> Vector3<f64> {
        self.housing
    }

    /// Response of the gyros to specific force, rad/s per m/s².
    pub fn g_sensitivity(&self) -> Matrix3<f64> {
        self.g_sensitivity
    }
}

/// The errors of the rotor's encoder: harmonics of a turn, then quantisation. No chance in it.
#[derive(Debug, Clone)]
pub struct Encoder {
    /// Least significant bit, rad; zero where exact.
    quantum: f64,
    /// Order, amplitude (rad), phase (rad).
    harmonics: Vec<(f64, f64, f64)>,
}

impl Encoder {
    /// The encoder of a scenario.
    pub fn new(scenario: &Scenario) -> Self {
        let encoder = &scenario.encoder;
        Self {
            quantum: match encoder.bits {
                0 => 0.0,
                bits => TAU / f64::from(bits).exp2(),
            },
            harmonics: encoder
                .harmonics
                .iter()
                .map(|h| (f64::from(h.order), h.amplitude_arcsec * ARC_SEC, h.phase_deg * DEG))
                .collect(),
        }
    }

    /// Reading for the true rotor angle `alpha`, rad. Turns are counted: the reading does not wrap.
    pub fn measure(&self, alpha: f64) -> f64 {
        let error: f64 = self
            .harmonics
            .iter()
            .map(|(order, amplitude, phase)| amplitude * (order * alpha + phase).sin())
            .sum();
        let reading = alpha + error;
        if self.quantum == 0.0 {
            reading
        } else {
            (reading / self.quantum).round() * self.quantum
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn scenario(text: &str) -> Scenario {
        Scenario::parse(text, "test").unwrap()
    }

    fn zero() -> Vec3<Sensor, f64> {
        Vec3::zero()
    }

    /// Limit on |s²/σ² − 1| for the variance of n normal draws at 5σ.
    fn variance_limit(n: f64) -> f64 {
        5.0 * (2.0 / n).sqrt()
    }

    const QUIET: &str = "[imu]\ngyro_bias_sd_deg_h = 0\naccel_bias_sd_ug = 0\nangle_random_walk_deg_sqrt_h = 0\n\
                         velocity_random_walk_ug_sqrt_hz = 0\n";

    #[test]
    fn a_scenario_without_imu_measures_exactly() {
        let mut imu = Imu::new(&Scenario::default(), 5);
        let (a, v) = (Vec3::new(0.1, -0.2, 0.3), Vec3::new(1.0, 2.0, -3.0));
        let m = imu.measure(a, v, 0.01);
        assert_eq!((m.dtheta_s, m.dv_s, m.saturated), (a, v, false));
    }

    #[test]
    fn turn_on_biases_have_their_spread() {
        let scenario = Scenario::builtin("paper-sim").unwrap();
        let (n, mut gyro, mut accel, mut mean) = (4000_u32, 0.0, 0.0, 0.0);
        for run in 0..n {
            let imu = Imu::new(&scenario, run_seed(1, u64::from(run)));
            let (g, a) = (imu.gyro_bias_s() / DEG_PER_HOUR, imu.accel_bias_s() / MICRO_G);
            gyro += g.dot(g) / 100.0;
            accel += a.dot(a) / 1e4;
            mean += (g.x() + g.y() + g.z()) / 10.0;
        }
        let n = 3.0 * f64::from(n);
        assert!((gyro / n - 1.0).abs() < variance_limit(n), "{}", gyro / n);
        assert!((accel / n - 1.0).abs() < variance_limit(n), "{}", accel / n);
        assert!((mean / n).abs() < 5.0 / n.sqrt(), "{}", mean / n);
    }

    /// The walk's Allan deviation falls as 1/√T at every T: sums over m samples have variance ARW² m dt.
    #[test]
    fn random_walks_grow_as_the_root_of_time() {
        let text = QUIET.replace(
            "angle_random_walk_deg_sqrt_h = 0",
            "angle_random_walk_deg_sqrt_h = 0.02",
        );
        let text = text.replace(
            "velocity_random_walk_ug_sqrt_hz = 0",
            "velocity_random_walk_ug_sqrt_hz = 10",
        );
        for (dt, m) in [(0.01, 1), (0.01, 100), (0.001, 30)] {
            let mut imu = Imu::new(&scenario(&text), 11);
            let blocks = 3000;
            let (mut gyro, mut accel) = (0.0, 0.0);
            for _ in 0..blocks {
                let (mut a, mut v) = (zero(), zero());
                for _ in 0..m {
                    let measured = imu.measure(zero(), zero(), dt);
                    a += measured.dtheta_s;
                    v += measured.dv_s;
                }
                gyro += a.dot(a);
                accel += v.dot(v);
            }
            let n = 3.0 * f64::from(blocks);
            let time = dt * f64::from(m);
            let gyro = gyro / n / time / DEG_PER_SQRT_HOUR.powi(2) / 0.02_f64.powi(2);
            let accel = accel / n / time / MICRO_G.powi(2) / 100.0;
            assert!((gyro - 1.0).abs() < variance_limit(n), "{gyro}");
            assert!((accel - 1.0).abs() < variance_limit(n), "{accel}");
        }
    }

    #[test]
    fn instability_is_stationary_with_its_correlation_time() {
        let text = format!("{QUIET}gyro_instability_deg_h = 3\ngyro_instability_tau_s = 100\n");
        let scenario = scenario(&text);
        let runs = 2000;
        // Value at the start, after 1000 s in one step or many, and its covariance over one and two τ.
        for (dt, steps) in [(100.0, 1), (1.0, 100)] {
            let mut moments = [0.0; 5];
            for run in 0..runs {
                let mut imu = Imu::new(&scenario, run_seed(2, run));
                let mut values = [imu.gyro_bias_s() / (3.0 * DEG_PER_HOUR); 3];
                for value in &mut values[1..] {
                    for _ in 0..steps {
                        imu.measure(zero(), zero(), dt);
                    }
                    *value = imu.gyro_bias_s() / (3.0 * DEG_PER_HOUR);
                }
                for (moment, (i, j)) in moments.iter_mut().zip([(0, 0), (1, 1), (2, 2), (0, 1), (0, 2)]) {
                    *moment += values[i].dot(values[j]) / 3.0 / runs as f64;
                }
            }
            let limit = variance_limit(3.0 * runs as f64);
            let e = (-1.0_f64).exp();
            for (moment, expected) in moments.into_iter().zip([1.0, 1.0, 1.0, e, e * e]) {
                assert!((moment - expected).abs() < limit, "{moments:?}");
            }
        }
    }

    #[test]
    fn matrices_have_their_spread_and_act_as_stated() {
        let text = format!(
            "{QUIET}gyro_scale_factor_sd_ppm = 300\ngyro_misalignment_sd_arcmin = 2\n\
             accel_scale_factor_sd_ppm = 100\naccel_misalignment_sd_arcmin = 1\n\
             gyro_g_sensitivity_sd_deg_h_g = 10"
        );
        let scenario = scenario(&text);
        let runs = 2000;
        let (mut diagonal, mut off, mut g) = (0.0, 0.0, 0.0);
        for run in 0..runs {
            let imu = Imu::new(&scenario, run_seed(3, run));
            let m = imu.gyro_matrix();
            let d = m.diagonal() / (300.0 * PPM);
            diagonal += d.norm_squared();
            off += (m - Matrix3::from_diagonal(&m.diagonal())).norm_squared() / (2.0 * ARC_MIN).powi(2);
            g += imu.g_sensitivity().norm_squared() / (10.0 * DEG_PER_HOUR / STANDARD_GRAVITY).powi(2);
        }
        let n = runs as f64;
        assert!((diagonal / (3.0 * n) - 1.0).abs() < variance_limit(3.0 * n));
        assert!((off / (6.0 * n) - 1.0).abs() < variance_limit(6.0 * n));
        assert!((g / (9.0 * n) - 1.0).abs() < variance_limit(9.0 * n));

        let mut imu = Imu::new(&scenario, 9);
        let (a, v) = (Vec3::new(0.1, -0.2, 0.3), Vec3::new(1.0, 2.0, -3.0));
        let m = imu.measure(a, v, 0.01);
        let expected = a.vector() + imu.gyro_matrix() * a.vector() + imu.g_sensitivity() * v.vector();
        assert!((m.dtheta_s.vector() - expected).norm() < 1e-16);
        assert!((m.dv_s.vector() - v.vector() - imu.accel_matrix() * v.vector()).norm() < 1e-15);
    }

    #[test]
    fn known_bias_and_step_come_when_told() {
        let text = "[errors]\ngyro_bias_deg_h = [1, 2, 3]\naccel_bias_ug = [4, 5, 6]\ngyro_step_deg_h = [5, 0, 0]\n\
                    gyro_step_at_s = 1.005";
        let mut imu = Imu::new(&scenario(text), 1);
        let mut sum = zero();
        for k in 1..=200 {
            let m = imu.measure(zero(), zero(), 0.01);
            sum += m.dtheta_s;
            assert!((m.dv_s / 0.01 - Vec3::new(4.0, 5.0, 6.0) * MICRO_G).norm() < 1e-15);
            let expected = if k > 100 { 6.0 } else { 1.0 };
            assert!((imu.gyro_bias_s().x() / DEG_PER_HOUR - expected).abs() < 1e-9);
        }
        let expected = Vec3::new(1.0 * 2.0 + 5.0 * 0.995, 4.0, 6.0) * DEG_PER_HOUR;
        assert!((sum - expected).norm() < 1e-15);
    }

    #[test]
    fn errors_have_streams_of_their_own() {
        let plain = Scenario::builtin("paper-sim").unwrap();
        let more = Scenario::builtin("moored").unwrap();
        let (mut a, mut b) = (Imu::new(&plain, 42), Imu::new(&more, 42));
        assert_eq!(a.gyro_bias, b.gyro_bias);
        assert_eq!(a.accel_bias, b.accel_bias);
        for _ in 0..100 {
            let (ma, mb) = (a.measure(zero(), zero(), 0.01), b.measure(zero(), zero(), 0.01));
            // The instability moves the gyros; the noise under it and the accelerometers are the same.
            let moved = (mb.dtheta_s - ma.dtheta_s).vector() / 0.01;
            assert!((moved - b.gyro_instability.value).norm() < 0.1 * b.gyro_instability.sd);
            assert_eq!(ma.dv_s, mb.dv_s);
        }
        assert_ne!(run_seed(1, 0), run_seed(0, 1));
    }

    #[test]
    fn quantisation_loses_nothing_in_the_sum() {
        let text = "[errors]\ngyro_quantum = 1e-5\naccel_quantum = 1e-3";
        let mut imu = Imu::new(&scenario(text), 1);
        let step = Vec3::new(3.3e-6, -1.7e-5, 1e-7);
        let mut sum = zero();
        for k in 1..=10_000 {
            let m = imu.measure(step, step, 0.01);
            let counts = m.dtheta_s.vector() / 1e-5;
            assert!((counts - counts.map(f64::round)).norm() < 1e-9);
            sum += m.dtheta_s;
            assert!((sum - step * f64::from(k)).vector().amax() < 0.501e-5);
        }
    }

    #[test]
    fn saturation_clips_and_is_flagged() {
        let text = "[errors]\ngyro_range_dps = 31.25\naccel_range_g = 2";
        let mut imu = Imu::new(&scenario(text), 1);
        let within = imu.measure(Vec3::new(0.3 * DEG, 0.0, -0.3 * DEG), Vec3::new(0.0, 0.19, 0.0), 0.01);
        assert!(!within.saturated);
        let beyond = imu.measure(Vec3::new(0.3 * DEG, 0.0, -0.4 * DEG), Vec3::new(0.0, 0.3, 0.0), 0.01);
        assert!(beyond.saturated);
        assert!((beyond.dtheta_s.z() + 0.3125 * DEG).abs() < 1e-15);
        assert!((beyond.dv_s.y() - 0.02 * STANDARD_GRAVITY).abs() < 1e-15);
    }

    #[test]
    fn encoder_has_harmonics_and_bits() {
        let text = "[encoder]\nbits = 21\nharmonics = [{ order = 1, amplitude_arcsec = 60 }, \
                    { order = 2, amplitude_arcsec = 30, phase_deg = 90 }]";
        let encoder = Encoder::new(&scenario(text));
        let lsb = TAU / f64::from(1 << 21);
        for k in 0..1000 {
            let alpha = f64::from(k) * 0.01;
            let reading = encoder.measure(alpha);
            let counts = reading / lsb;
            assert!((counts - counts.round()).abs() < 1e-9);
            let error = ARC_SEC * (60.0 * alpha.sin() + 30.0 * (2.0 * alpha).cos());
            assert!((reading - alpha - error).abs() <= 0.5000001 * lsb);
        }
        assert_eq!(Encoder::new(&Scenario::default()).measure(1.234), 1.234);
    }
}
