//! Sensor errors, seeded, applied to exact increments.
//!
//! ```text
//! Δθ' = (I + M_g) Δθ + K |Δθ| + G Δv + (b_g + x_g + C_b^s h + d(2α)) dt + n_g    n_g ~ N(0, ARW² dt)
//! Δv' = (I + M_a) Δv                 + (b_a + x_a) dt + n_a                      n_a ~ N(0, VRW² dt)
//! ẋ = −x/τ + w,  E x² = σ²                    first-order Gauss–Markov, stationary from the start
//! b = b_0 + c ΔT(t) + r a²                    ΔT: warming up, a²: mean square of the vibration
//! ```
//!
//! of increments as the bandwidth leaves them, with the vibration's added; then saturation, then quantisation with
//! the remainder carried to the next sample.
//!
//! # Seeds
//!
//! One 64-bit seed makes a run. It keys ChaCha8, and every source of chance has a [`Stream`] of its own under that key:
//! switching one error on, or scaling it, leaves every other draw as it was. Runs of a Monte Carlo have the seeds
//! [`run_seed`] derives from the one given.
//!
//! Not modelled: scale factors over temperature, correlated axes, what saturates between two samples.

use core::f64::consts::TAU;

use frames::units::{
    ARC_MIN, ARC_SEC, DEG, DEG_PER_HOUR, DEG_PER_SQRT_HOUR, MICRO_G, MICRO_G_PER_SQRT_HZ, PPM, STANDARD_GRAVITY,
};
use frames::{Sensor, Vec3};
use nalgebra::{Matrix3, Rotation3, Vector3, Vector6};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;

use crate::scenario::{Errors, Scenario};

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
    /// Lines of the vibration.
    Vibration = 19,
    /// What vibration makes of the gyros' bias.
    GyroRectification = 20,
    /// What vibration makes of the accelerometers' bias.
    AccelRectification = 21,
    /// Drift of the gyros' bias with temperature.
    GyroThermal = 22,
    /// Drift of the accelerometers' bias with temperature.
    AccelThermal = 23,
    /// Scale factors of the gyros that differ with the sign.
    GyroAsymmetry = 24,
    /// Gyro error twice a turn.
    GyroTwiceATurn = 25,
    /// Rates of the rotor's legs.
    Rotor = 26,
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

/// How the IMU warms up.
#[derive(Debug, Clone)]
struct Warming {
    /// Rise, K, and time constant, s, of housing and motor.
    parts: [(f64, f64); 2],
}

impl Warming {
    /// Mean rise from `start` on over `dt`, K.
    fn mean(&self, start: f64, dt: f64) -> f64 {
        let part = |(rise, tau): (f64, f64)| rise * (1.0 - (-start / tau).exp() * -(-dt / tau).exp_m1() * tau / dt);
        self.parts.into_iter().map(part).sum()
    }

    /// Rise at a time, K.
    fn at(&self, time: f64) -> f64 {
        self.parts
            .into_iter()
            .map(|(rise, tau)| -rise * (-time / tau).exp_m1())
            .sum()
    }
}

/// One line of the vibration: rate and acceleration of the housing are `amplitude · sin(ω t + phase)` on one axis.
#[derive(Debug, Clone)]
struct VibrationLine {
    axis: usize,
    omega: f64,
    phase: f64,
    /// rad/s.
    rate: f64,
    /// m/s².
    acceleration: f64,
}

/// Lines of a band of vibration on each axis.
const LINES_PER_BAND: usize = 16;

/// Low-pass of the increments.
///
/// The rate is taken to be even over a sample. A rate that changes evenly is then delayed by exactly the poles' time
/// constants; of a sine, `(ω dt)²/8` at most is lost besides.
#[derive(Debug, Clone)]
struct Response {
    /// Time constant of a pole, s.
    tau: f64,
    /// What each pole puts out now; `None` before the first sample, in which the motion is taken to have gone on before.
    poles: Vec<Option<Vector6<f64>>>,
}

impl Response {
    /// `None` where the bandwidth is unlimited.
    fn new(errors: &Errors) -> Option<Self> {
        let bandwidth = errors.bandwidth_hz?;
        Some(Self {
            tau: pole_time(bandwidth, errors.bandwidth_poles),
            poles: vec![None; errors.bandwidth_poles as usize],
        })
    }

    /// The increments of angle and velocity that come out during the next `dt`.
    fn apply(&mut self, angle: Vector3<f64>, velocity: Vector3<f64>, dt: f64) -> (Vector3<f64>, Vector3<f64>) {
        let mut rate = Vector6::from_fn(|i, _| if i < 3 { angle[i] } else { velocity[i - 3] }) / dt;
        let part = -(-dt / self.tau).exp_m1();
        for pole in &mut self.poles {
            let from = pole.unwrap_or(rate) - rate;
            *pole = Some(rate + from * (1.0 - part));
            rate += from * (part * self.tau / dt);
        }
        (
            rate.fixed_rows::<3>(0).into_owned() * dt,
            rate.fixed_rows::<3>(3).into_owned() * dt,
        )
    }
}

/// Time constant of each of so many like poles that together are 3 dB down at `bandwidth_hz`, s.
fn pole_time(bandwidth_hz: f64, poles: u32) -> f64 {
    (2_f64.powf(1.0 / f64::from(poles)) - 1.0).sqrt() / (TAU * bandwidth_hz)
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
    /// Temperature of the IMU at the end of the sample, °C: 25 at the start, and what it has warmed up.
    pub temperature_c: f64,
}

/// Temperature of the IMU at the start, °C.
const START_C: f64 = 25.0;

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
    /// Cosine and sine of the error that goes twice a turn, in s, rad/s.
    twice_a_turn: [Vector3<f64>; 2],
    /// Diagonal of K.
    asymmetry: Vector3<f64>,
    warming: Warming,
    /// Drift of the gyros' bias, rad/s per K, and of the accelerometers', m/s² per K.
    gyro_thermal: Vector3<f64>,
    accel_thermal: Vector3<f64>,
    vibration: Vec<VibrationLine>,
    response: Option<Response>,
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
        let mut twice_rng = stream(seed, Stream::GyroTwiceATurn);
        let twice_a_turn =
            [(); 2].map(|()| normals(&mut twice_rng) * (errors.gyro_twice_a_turn_sd_deg_h * DEG_PER_HOUR));
        // Of one axis, g².
        let mean_square = scenario
            .vibration
            .iter()
            .map(|band| (band.accel_rms_m_s2 / STANDARD_GRAVITY).powi(2))
            .sum::<f64>();
        let rectified = |source, unit: f64| draw(source) * (unit * mean_square);
        let temperature = &scenario.temperature;
        Self {
            time: 0.0,
            gyro_bias: draw(Stream::GyroBias) * (unit.gyro_bias_sd_deg_h * DEG_PER_HOUR)
                + Vector3::from(errors.gyro_bias_deg_h) * DEG_PER_HOUR
                + rectified(
                    Stream::GyroRectification,
                    errors.gyro_rectification_sd_deg_h_g2 * DEG_PER_HOUR,
                ),
            gyro_step: Vector3::from(errors.gyro_step_deg_h) * DEG_PER_HOUR,
            gyro_step_at: errors.gyro_step_at_s,
            accel_bias: draw(Stream::AccelBias) * (unit.accel_bias_sd_ug * MICRO_G)
                + Vector3::from(errors.accel_bias_ug) * MICRO_G
                + rectified(
                    Stream::AccelRectification,
                    errors.accel_rectification_sd_ug_g2 * MICRO_G,
                ),
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
            twice_a_turn,
            asymmetry: draw(Stream::GyroAsymmetry) * (errors.gyro_scale_asymmetry_sd_ppm * PPM),
            warming: Warming {
                parts: [
                    (temperature.rise_k, temperature.tau_s),
                    (temperature.motor_rise_k, temperature.motor_tau_s),
                ],
            },
            gyro_thermal: draw(Stream::GyroThermal) * (temperature.gyro_bias_sd_deg_h_k * DEG_PER_HOUR),
            accel_thermal: draw(Stream::AccelThermal) * (temperature.accel_bias_sd_ug_k * MICRO_G),
            vibration: vibration(scenario, seed),
            response: Response::new(errors),
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
        let (mut angle, mut velocity) = (dtheta_s.vector(), dv_s.vector());
        if let Some(response) = &mut self.response {
            (angle, velocity) = response.apply(angle, velocity, dt);
        }
        let start = self.time;
        self.time += dt;
        // The part of the sample after the step.
        let stepped = (self.time - self.gyro_step_at.max(start)).clamp(0.0, dt);
        let c_sb = Rotation3::from_axis_angle(&Vector3::z_axis(), -self.rotor);
        if !self.vibration.is_empty() {
            let (turned, gained) = self.vibrated(start, dt);
            angle += c_sb * turned;
            velocity += c_sb * gained;
        }
        let warmer = self.warming.mean(start, dt);
        let (sin, cos) = (2.0 * self.rotor).sin_cos();
        let [by_cos, by_sin] = self.twice_a_turn;
        let gyro_bias = self.gyro_bias
            + self.gyro_instability.step(dt)
            + c_sb * self.housing
            + self.gyro_thermal * warmer
            + by_cos * cos
            + by_sin * sin;
        let accel_bias = self.accel_bias + self.accel_instability.step(dt) + self.accel_thermal * warmer;
        let angle = angle
            + self.gyro_matrix * angle
            + self.asymmetry.component_mul(&angle.abs())
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
            temperature_c: START_C + self.warming.at(self.time),
        }
    }

    /// What the vibration adds to the increments from `start` on over `dt`, in b.
    fn vibrated(&self, start: f64, dt: f64) -> (Vector3<f64>, Vector3<f64>) {
        let (mut angle, mut velocity) = (Vector3::zeros(), Vector3::zeros());
        for line in &self.vibration {
            // ∫ sin(ω t + φ) dt, its middle and half its length.
            let middle = line.omega * (start + 0.5 * dt) + line.phase;
            let integral = middle.sin() * (0.5 * line.omega * dt).sin() * 2.0 / line.omega;
            angle[line.axis] += line.rate * integral;
            velocity[line.axis] += line.acceleration * integral;
        }
        (angle, velocity)
    }

    /// Bias of the gyros now: turn-on with rectification, instability, temperature and step, rad/s.
    pub fn gyro_bias_s(&self) -> Vec3<Sensor, f64> {
        let step = if self.time > self.gyro_step_at {
            self.gyro_step
        } else {
            Vector3::zeros()
        };
        let thermal = self.gyro_thermal * self.warming.at(self.time);
        Vec3::from_vector(self.gyro_bias + self.gyro_instability.value + thermal + step)
    }

    /// Bias of the accelerometers now: turn-on with rectification, instability and temperature, m/s².
    pub fn accel_bias_s(&self) -> Vec3<Sensor, f64> {
        let thermal = self.accel_thermal * self.warming.at(self.time);
        Vec3::from_vector(self.accel_bias + self.accel_instability.value + thermal)
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

/// The lines of the vibration, as the bandwidth leaves them.
fn vibration(scenario: &Scenario, seed: u64) -> Vec<VibrationLine> {
    let mut rng = stream(seed, Stream::Vibration);
    let errors = &scenario.errors;
    // Of N sines of the same amplitude: the mean square is N A²/2.
    let share = (2.0 / LINES_PER_BAND as f64).sqrt();
    let mut lines = Vec::new();
    for band in &scenario.vibration {
        for axis in 0..3 {
            for _ in 0..LINES_PER_BAND {
                let [within, turn]: [f64; 2] = rng.random();
                let omega = TAU * (band.low_hz + (band.high_hz - band.low_hz) * within);
                let (gain, lag) = errors.bandwidth_hz.map_or((1.0, 0.0), |bandwidth| {
                    let ratio = omega * pole_time(bandwidth, errors.bandwidth_poles);
                    let poles = f64::from(errors.bandwidth_poles);
                    ((1.0 + ratio * ratio).powf(-0.5 * poles), ratio.atan() * poles)
                });
                lines.push(VibrationLine {
                    axis,
                    omega,
                    phase: turn * TAU - lag,
                    rate: band.rate_rms_rad_s * share * gain,
                    acceleration: band.accel_rms_m_s2 * share * gain,
                });
            }
        }
    }
    lines
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
    fn vibration_has_its_spread_and_moves_nothing() {
        let text = "[[vibration]]\nlow_hz = 20\nhigh_hz = 60\naccel_rms_m_s2 = 0.5\n[[vibration]]\nlow_hz = 100\n\
                    high_hz = 200\naccel_rms_m_s2 = 1.2\nrate_rms_rad_s = 0.01\n";
        // A pole at 10 Hz takes the bands' mean square down to the mean of 1/(1 + (f/10)²) over each.
        for (bandwidth, low, high) in [("", 1.0, 1.0), ("[errors]\nbandwidth_hz = 10", 0.0744, 0.00496)] {
            let mut imu = Imu::new(&scenario(&format!("{text}{bandwidth}")), 3);
            imu.rotor_at(1.0);
            let (rate, n) = (5000, 50_000);
            let (mut rates, mut forces, mut angle) = (0.0, 0.0, zero());
            for _ in 0..n {
                let m = imu.measure(zero(), zero(), 1.0 / f64::from(rate));
                angle += m.dtheta_s;
                rates += (m.dtheta_s * f64::from(rate)).vector().norm_squared();
                forces += (m.dv_s * f64::from(rate)).vector().norm_squared();
                assert!(angle.norm() < 4.0 * 0.01 / (TAU * 100.0) * 3.0, "{angle:?}");
            }
            let n = 3.0 * f64::from(n);
            // Where the 16 lines of an axis lie in a band scatters what a filter leaves of them.
            let limit = if bandwidth.is_empty() { 0.01 } else { 0.25 };
            let square = rates / n / (1e-4 * high);
            assert!((square - 1.0).abs() < limit, "{square}");
            let square = forces / n / (0.25 * low + 1.44 * high);
            assert!((square - 1.0).abs() < limit, "{square}");
        }
    }

    #[test]
    fn vibration_is_rectified_by_its_mean_square() {
        let text = "[[vibration]]\naccel_rms_m_s2 = 9.80665\n[[vibration]]\naccel_rms_m_s2 = 19.6133\n[errors]\n\
                    gyro_rectification_sd_deg_h_g2 = 2\naccel_rectification_sd_ug_g2 = 30\n";
        let (runs, scenario) = (1000, scenario(text));
        let (mut gyro, mut accel) = (0.0, 0.0);
        for run in 0..runs {
            let imu = Imu::new(&scenario, run_seed(5, run));
            // 1 g² and 4 g².
            gyro += (imu.gyro_bias_s() / (10.0 * DEG_PER_HOUR)).vector().norm_squared();
            accel += (imu.accel_bias_s() / (150.0 * MICRO_G)).vector().norm_squared();
        }
        let n = 3.0 * runs as f64;
        assert!((gyro / n - 1.0).abs() < variance_limit(n), "{}", gyro / n);
        assert!((accel / n - 1.0).abs() < variance_limit(n), "{}", accel / n);
    }

    #[test]
    fn biases_drift_as_the_unit_warms_up() {
        let text = "[temperature]\nrise_k = 10\ntau_s = 600\nmotor_rise_k = 4\nmotor_tau_s = 60\n\
                    gyro_bias_sd_deg_h_k = 3\naccel_bias_sd_ug_k = 20\n";
        let (runs, scenario) = (1000, scenario(text));
        let (mut gyro, mut accel) = (0.0, 0.0);
        for run in 0..runs {
            let mut imu = Imu::new(&scenario, run_seed(6, run));
            assert_eq!(imu.gyro_bias_s(), zero());
            let m = imu.measure(zero(), zero(), 600.0);
            // 10 K (1 − 1/e) and 4 K (1 − e⁻¹⁰) at the end; 10 K/e and 4 K (1 − (1 − e⁻¹⁰)/10) in the mean.
            let (end, mean) = (6.321_206 + 3.999_818, 3.678_794 + 3.600_018);
            assert!((m.temperature_c - 25.0 - end).abs() < 1e-5, "{}", m.temperature_c);
            let part = (m.dtheta_s / 600.0).vector() * end - imu.gyro_bias_s().vector() * mean;
            assert!(part.norm() < 1e-6 * imu.gyro_bias_s().norm() * mean, "{part:?}");
            gyro += (imu.gyro_bias_s() / (3.0 * end * DEG_PER_HOUR)).vector().norm_squared();
            accel += (imu.accel_bias_s() / (20.0 * end * MICRO_G)).vector().norm_squared();
        }
        let n = 3.0 * runs as f64;
        assert!((gyro / n - 1.0).abs() < variance_limit(n), "{}", gyro / n);
        assert!((accel / n - 1.0).abs() < variance_limit(n), "{}", accel / n);
    }

    #[test]
    fn bandwidth_is_as_told() {
        // One pole of 8 Hz is 1/(2π 8 Hz) behind, two of 8 Hz together each √(√2 − 1) of that.
        let pole = 1.0 / (TAU * 8.0);
        let two = 2.0 * (2_f64.sqrt() - 1.0).sqrt() * pole;
        for (text, behind) in [
            ("bandwidth_hz = 8", pole),
            ("bandwidth_hz = 8\nbandwidth_poles = 2", two),
        ] {
            let scenario = scenario(&format!("[errors]\n{text}"));
            // A rate and a force that grow evenly, in samples that are not all alike.
            let (mut imu, mut t) = (Imu::new(&scenario, 1), 0.0);
            for k in 0..400 {
                let dt = if k % 3 == 0 { 0.012 } else { 0.009 };
                let middle = t + 0.5 * dt;
                t += dt;
                let ramp = |at: f64| Vec3::<Sensor, f64>::new(0.1, -0.2, 0.3) * (at * dt);
                let m = imu.measure(ramp(middle), ramp(middle) * 5.0, dt);
                if t > 1.0 {
                    let expected = ramp(middle - behind);
                    // Uneven samples move the poles' own delay by their difference.
                    assert!((m.dtheta_s - expected).norm() < 2e-3 * dt, "{text}: {:?}", m.dtheta_s);
                    assert!((m.dv_s - expected * 5.0).norm() < 1e-2 * dt);
                }
            }
            // A constant goes through from the first sample on.
            let mut imu = Imu::new(&scenario, 1);
            let still = Vec3::new(0.0, 0.0, 0.098);
            for _ in 0..5 {
                assert!((imu.measure(zero(), still, 0.01).dv_s - still).norm() < 1e-15);
            }
        }
        // Half of the power is left at the bandwidth.
        for poles in [1, 2] {
            let text = format!("[errors]\nbandwidth_hz = 8\nbandwidth_poles = {poles}");
            let (mut imu, mut square) = (Imu::new(&scenario(&text), 1), 0.0);
            for k in 0..40_000_u32 {
                let rate = (TAU * 8.0 * f64::from(k) * 1e-4).sin();
                let out = imu.measure(Vec3::new(rate * 1e-4, 0.0, 0.0), zero(), 1e-4).dtheta_s.x() * 1e4;
                // Whole periods, after the start.
                if k >= 20_000 {
                    square += 2.0 * out * out / 20_000.0;
                }
            }
            assert!((square - 0.5).abs() < 1e-3, "{poles}: {square}");
        }
    }

    #[test]
    fn an_asymmetric_scale_factor_is_left_by_turning_there_and_back() {
        let scenario = scenario("[errors]\ngyro_scale_asymmetry_sd_ppm = 20");
        let (runs, mut square) = (1000, 0.0);
        let turn = Vec3::new(0.01, -0.02, 0.03);
        for run in 0..runs {
            let mut imu = Imu::new(&scenario, run_seed(7, run));
            let left = imu.measure(turn, zero(), 0.01).dtheta_s + imu.measure(-turn, zero(), 0.01).dtheta_s;
            square += left
                .vector()
                .component_div(&(turn.vector() * (2.0 * 20.0 * PPM)))
                .norm_squared();
        }
        let n = 3.0 * runs as f64;
        assert!((square / n - 1.0).abs() < variance_limit(n), "{}", square / n);
    }

    #[test]
    fn an_error_twice_a_turn_is_the_same_half_a_turn_on() {
        let scenario = scenario("[errors]\ngyro_twice_a_turn_sd_deg_h = 4");
        let (runs, mut square) = (1000, 0.0);
        for run in 0..runs {
            let mut imu = Imu::new(&scenario, run_seed(8, run));
            let mut at = |alpha: f64| {
                imu.rotor_at(alpha);
                imu.measure(zero(), zero(), 0.01).dtheta_s / (0.01 * DEG_PER_HOUR)
            };
            let [here, quarter, half] = [0.3, 0.3 + 0.25 * TAU, 0.3 + 0.5 * TAU].map(&mut at);
            assert!((here + quarter).norm() < 1e-12 && (here - half).norm() < 1e-12);
            square += (here / 4.0).vector().norm_squared();
        }
        let n = 3.0 * runs as f64;
        assert!((square / n - 1.0).abs() < variance_limit(n), "{}", square / n);
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
