//! The least σ that any filter can have: the covariance of the ideal one, along the true path.
//!
//! It is told the place, the base's own motion, the IMU's figures and where it points, so that the linear model about
//! the truth is exact; what is left is the noise. In f64, dense, with the states
//!
//! ```text
//! φ     attitude error in n, C' = (I − [φ×]) C, rad      δV  velocity error in n, m/s
//! ε     turn-on bias of the gyros in s, rad/s            x   their instability, first-order Gauss–Markov, rad/s
//! ∇     bias of the accelerometers in s, m/s²            y   their instability, first-order Gauss–Markov, m/s²
//! M     scale factors and misalignments of the gyros: δω_is^s = M ω_is^s, by columns m_x, m_y, m_z
//! G     response of the gyros to specific force, by columns, rad/s per m/s²
//! h     a gyro error that is constant in the housing, in b, rad/s
//! A     scale factors and misalignments of the accelerometers, by columns
//!
//! φ̇  = −ω_ie^n × φ − C_s^n (ε + x + M ω_is^s + G f^s) − C_b^n h    [Xing18] (19), (20), with the rotor's errors of
//! δV̇ = f^n × φ + C_s^n (∇ + y + A f^s),  f^n = [0 0 g]             [Du16] (14)–(25); z = δV + noise, once a second
//! ```
//!
//! States whose figure is zero in the scenario are left out. Over one step of length h, with C at its middle and ω the
//! mean over it,
//!
//! ```text
//! φ'  = (I − [ω_ie h×] + ½ [ω_ie h×]²) φ + u,    u = −C (ε h + x τ (1 − e^(−h/τ)) + M ω h + G f h) − C_b^n h_b h
//! δV' = δV + [f^n×] (h φ + ½ h u) + C (∇ h + y τ (1 − e^(−h/τ)) + A f h)
//! Q:  q² h I on φ, ½ q² h² [f^n×]ᵀ between φ and δV, ⅓ q² h³ [f^n×][f^n×]ᵀ + r² h I on δV, σ² (1 − e^(−2h/τ)) on x, y
//! ```
//!
//! with q the angle and r the velocity random walk. A step is a twentieth of a second or shorter, and turns by 0.05 rad
//! at most: the mean of C is then right to 0.05²/24 = 1e-4. Of the Gauss–Markov processes the kick within a step acts
//! from the next step on, which delays them by h/2, 2.5e-4 of a τ of 100 s.
//!
//! f^n is `[0 0 g]` and not the true force. What is measured is δV, the base's own motion known; with that motion
//! known so well its accelerations would show heading by themselves, as in a transfer alignment, and no filter here is
//! given that.
//!
//! Not modelled: what no filter is told of either (`[errors]`, `[temperature]`, `[[vibration]]`, wobble), and quantisation,
//! for which [`Limits`] has formulas.

use frames::units::{
    ARC_MIN, DEG, DEG_PER_HOUR, DEG_PER_SQRT_HOUR, MICRO_G, MICRO_G_PER_SQRT_HZ, PPM, STANDARD_GRAVITY,
};
use frames::{AttitudeSd, Nav, Vec3};
use nalgebra::{DMatrix, Matrix3, Matrix6xX, Vector3};
use serde::Serialize;

use crate::align::Angles;
use crate::config::Violation;
use crate::scenario::Scenario;
use crate::truth::Truth;

/// What the ideal filter is given besides the scenario.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BoundConfig {
    /// 1σ of zero velocity, measured once a second, m/s; measured more often it has the same density.
    pub velocity_sd: f64,
    /// Time between measurements, s.
    ///
    /// Where the rotor turns it makes no difference. Where it stands, all there is comes from the swing, and a second
    /// blurs it: 10.08° against 9.86° at 20 Hz.
    pub interval: f64,
    /// 1σ of heading before anything is measured, rad.
    pub heading_sd: f64,
}

impl Default for BoundConfig {
    /// 1 mm/s, white, at 100 Hz, taken together each second; nothing is known of heading.
    fn default() -> Self {
        Self {
            velocity_sd: 1e-4,
            interval: 1.0,
            heading_sd: 90.0 * DEG,
        }
    }
}

impl BoundConfig {
    fn check(&self) -> Result<(), Violation> {
        for (key, value) in [
            ("velocity_sd", self.velocity_sd),
            ("interval", self.interval),
            ("heading_sd", self.heading_sd),
        ] {
            if !(value.is_finite() && value > 0.0) {
                return Err(Violation {
                    key: key.to_owned(),
                    problem: format!("{value} is out of range, it must be positive"),
                });
            }
        }
        Ok(())
    }
}

/// 1σ of tilt before anything is measured, rad.
const PRIOR_TILT: f64 = 0.2 * DEG;
/// 1σ of velocity before anything is measured, m/s: the base rests, or its motion is known.
const PRIOR_VELOCITY: f64 = 1e-4;
/// Least number of steps a second.
const STEPS_PER_SECOND: f64 = 20.0;
/// Greatest turn of the IMU in a step, rad.
const TURN_PER_STEP: f64 = 0.05;

/// Of an irregular angle, 4σ of its rate over the significant amplitude, 2σ, times the peak's ω: twice the root of the
/// spectrum's second moment, which is 1.32 or less ([`sea`](crate::sea)).
const SEA_RATE: f64 = 2.64;

/// Where φ, δV and ε stand; what follows depends on the scenario.
const PHI: usize = 0;
const DV: usize = 3;
const EPS: usize = 6;
/// Rows of φ and δV: all that has dynamics beyond a decay.
const DRIVEN: usize = 6;

/// The σ of the ideal filter at one time.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Sigmas {
    /// Time, s.
    pub t_s: f64,
    /// Of heading, by the angle random walk alone: the simple formula, [`random_walk_limit_deg`].
    pub random_walk_limit_deg: f64,
    /// Of the attitude of the housing.
    pub sd: Angles,
    /// Of velocity (east, north, up), m/s.
    pub velocity_sd_m_s: [f64; 3],
    /// Of the gyros' bias as it is now, turn-on and instability together, °/h.
    pub gyro_bias_sd_deg_h: [f64; 3],
    /// Of the accelerometers' bias as it is now, µg.
    pub accel_bias_sd_ug: [f64; 3],
    /// Of M of the gyros, by rows, ppm; absent where the scenario has none.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub gyro_matrix_sd_ppm: Option<[[f64; 3]; 3]>,
}

/// What a single cause leaves of heading after T seconds, all else known but the tilt at the start; 1σ, degrees.
///
/// Heading is seen by the tilt it makes grow: `φ̇_E = −ω_N φ_U` with `ω_N = ω_ie cos L`, and so
/// `δV_N = g φ_E0 t − ½ g ω_N φ_U t²`. Absent where the cause is.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Limits {
    /// Angle random walk q: the ends of a walk tell its slope to q/√T, which leaves q/(ω_N √T). As in the last row.
    pub angle_random_walk_deg: f64,
    /// Velocity random walk r: the slope of an acceleration in white noise, `√12 r/T^1.5`, over g ω_N.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub velocity_random_walk_deg: Option<f64>,
    /// Velocity noise s, once a second: a parabola in white noise, where it starts known: `8 √5 s/T^2.5`, over g ω_N.
    pub velocity_measurement_deg: f64,
    /// Quantum Δ of the gyros at f samples a second, the remainder carried.
    ///
    /// The remainder is white, Δ/√12, in s. While s turns at ω, the sum of increments resolved in n keeps `ω × remainder`
    /// of each sample: an angle random walk of `ω Δ/√(12 f)`, ω the rms over the run. Besides that the remainder tilts
    /// what gravity is resolved with, a velocity random walk of `g Δ/√(12 f)`. Root of the sum of squares.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub gyro_quantum_deg: Option<f64>,
    /// Quantum Δ of the accelerometers: likewise a velocity random walk of `ω Δ/√(12 f)`, and Δ/√12 of velocity noise f
    /// times a second.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub accel_quantum_deg: Option<f64>,
}

/// The bound of one run.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Bound {
    /// Scenario by name.
    pub scenario: String,
    /// Seed: of the phases of the motion, and of a random heading.
    pub seed: u64,
    /// Length of the run, s.
    pub duration_s: f64,
    /// 1σ of the velocity measured once a second, m/s.
    pub velocity_measurement_sd_m_s: f64,
    /// Number of states.
    pub states: usize,
    /// The simple formulas at the end.
    pub limits: Limits,
    /// At 10, 20, 50, 100, 200, 500 … s and at the end.
    pub rows: Vec<Sigmas>,
    /// At the end.
    pub end: Sigmas,
    /// After each measurement.
    #[serde(skip)]
    pub curve: Vec<Sigmas>,
}

/// Computes the bound of a scenario along the motion that `seed` gives.
///
/// # Errors
/// Where the scenario is not valid, or a figure of `config` is not positive and finite.
pub fn run(scenario: &Scenario, seed: u64, config: &BoundConfig) -> Result<Bound, Violation> {
    run_with_steps(scenario, seed, config, steps_per_second(scenario))
}

fn run_with_steps(scenario: &Scenario, seed: u64, config: &BoundConfig, per_second: f64) -> Result<Bound, Violation> {
    config.check()?;
    let truth = Truth::new(scenario, seed)?;
    let model = Model::new(scenario, &truth);
    let duration = scenario.run.duration_s;
    let mut p = model.prior(config.heading_sd);
    let mut curve = Vec::new();
    let mut turned_squared = 0.0;
    let mut start = 0.0;
    while start < duration {
        // The last interval may be short; times by multiplication, so that an hour ends on its last second.
        let end = (config.interval * (curve.len() + 1) as f64).min(duration);
        let steps = ((end - start) * per_second).ceil().max(1.0);
        let h = (end - start) / steps;
        let mut k = 0.0;
        while k < steps {
            let t = start + k * h;
            let (dtheta_s, _) = truth.increment(t, t + h);
            let w_s = dtheta_s.vector() / h;
            turned_squared += w_s.norm_squared() * h;
            let middle = t + 0.5 * h;
            let frames = [&truth.c_ns(middle).matrix(), &truth.c_nb(middle).matrix()];
            model.predict(&mut p, frames, &w_s, h);
            k += 1.0;
        }
        // The same information a second, however long the interval.
        measure(&mut p, config.velocity_sd.powi(2) / (end - start));
        curve.push(model.sigmas(&p, &truth, end));
        start = end;
    }
    let Some(end) = curve.last().copied() else {
        return Err(Violation {
            key: "run.duration_s".to_owned(),
            problem: format!("{duration} is no length of a run"),
        });
    };
    Ok(Bound {
        scenario: scenario.name.clone(),
        seed,
        duration_s: duration,
        velocity_measurement_sd_m_s: config.velocity_sd,
        states: model.states,
        limits: Limits::at(scenario, &truth, config, (turned_squared / duration).sqrt()),
        rows: curve
            .iter()
            .filter(|s| s.t_s < duration && is_row(s.t_s))
            .chain([&end])
            .copied()
            .collect(),
        end,
        curve,
    })
}

/// 10, 20, 50, 100, 200, 500 and so on.
fn is_row(t: f64) -> bool {
    let decade = 10_f64.powf(t.log10().floor());
    t >= 10.0
        && [1.0, 2.0, 5.0]
            .into_iter()
            .any(|digit| (t / decade - digit).abs() < 1e-9)
}

/// As many as keep the turn in a step small, at the fastest that rotor and swing together can turn.
fn steps_per_second(scenario: &Scenario) -> f64 {
    let (swing, sea) = (&scenario.swing, &scenario.sea);
    let fastest = [&swing.heading, &swing.pitch, &swing.roll]
        .into_iter()
        .map(|axis| axis.amplitude_deg * core::f64::consts::TAU / axis.period_s)
        .sum::<f64>()
        + [&sea.heading, &sea.pitch, &sea.roll]
            .into_iter()
            .map(|sea| SEA_RATE * sea.significant_deg * core::f64::consts::TAU / sea.peak_period_s)
            .sum::<f64>()
        + scenario.rotor.fastest_dps() * (1.0 + scenario.rotor.ripple_fraction);
    (fastest * DEG / TURN_PER_STEP).ceil().max(STEPS_PER_SECOND)
}

/// What three constant states act by.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Drive {
    /// A column of M, by this component of ω_is^s.
    Rate(usize),
    /// A column of G, by this component of f^s.
    Force(usize),
    /// h.
    Housing,
    /// A column of A, by this component of f^s.
    Accel(usize),
}

/// Three constant states besides the biases.
struct Constant {
    at: usize,
    drive: Drive,
    sd: Vector3<f64>,
}

/// A first-order Gauss–Markov process of three axes among the states.
struct Process {
    at: usize,
    sd: f64,
    tau: f64,
}

impl Process {
    /// e^(−h/τ).
    fn decay(&self, h: f64) -> f64 {
        (-h / self.tau).exp()
    }

    /// ∫ e^(−t/τ) dt over a step: what a value at its start adds up to, s.
    fn integral(&self, h: f64) -> f64 {
        -self.tau * (-h / self.tau).exp_m1()
    }

    /// Variance that keeps the process stationary.
    fn kick(&self, h: f64) -> f64 {
        -self.sd * self.sd * (-2.0 * h / self.tau).exp_m1()
    }
}

/// States and figures, SI.
struct Model {
    states: usize,
    gyro_process: Option<Process>,
    nabla: usize,
    accel_process: Option<Process>,
    constants: Vec<Constant>,
    gyro_bias_sd: f64,
    accel_bias_sd: f64,
    angle_psd: f64,
    /// Of [`random_walk_limit_deg`] after a second, degrees.
    random_walk_limit_deg: f64,
    velocity_psd: f64,
    /// [ω_ie^n ×].
    earth: Matrix3<f64>,
    /// f^n, and [f^n ×].
    force_n: Vector3<f64>,
    force: Matrix3<f64>,
}

impl Model {
    fn new(scenario: &Scenario, truth: &Truth) -> Self {
        let imu = &scenario.imu;
        let mut states = EPS + 3;
        let mut take = |count: usize| {
            let at = states;
            states += count;
            at
        };
        let mut process = |sd: f64, tau: f64| (sd > 0.0).then(|| Process { at: take(3), sd, tau });
        let gyro_process = process(imu.gyro_instability_deg_h * DEG_PER_HOUR, imu.gyro_instability_tau_s);
        let accel_process = process(imu.accel_instability_ug * MICRO_G, imu.accel_instability_tau_s);
        let nabla = take(3);
        let mut constants = Vec::new();
        let mut constant = |drive, sd: Vector3<f64>| {
            constants.push(Constant { at: take(3), drive, sd });
        };
        let mut columns = |drive: fn(usize) -> Drive, scale: f64, misalignment: f64| {
            if scale > 0.0 || misalignment > 0.0 {
                for column in 0..3 {
                    let sd = Vector3::from_fn(|row, _| if row == column { scale } else { misalignment });
                    constant(drive(column), sd);
                }
            }
        };
        columns(
            Drive::Rate,
            imu.gyro_scale_factor_sd_ppm * PPM,
            imu.gyro_misalignment_sd_arcmin * ARC_MIN,
        );
        let by_force = imu.gyro_g_sensitivity_sd_deg_h_g * DEG_PER_HOUR / STANDARD_GRAVITY;
        columns(Drive::Force, by_force, by_force);
        columns(
            Drive::Accel,
            imu.accel_scale_factor_sd_ppm * PPM,
            imu.accel_misalignment_sd_arcmin * ARC_MIN,
        );
        let housing = imu.gyro_housing_sd_deg_h * DEG_PER_HOUR;
        if housing > 0.0 {
            // Along the rotor's axis it is part of the bias.
            constant(Drive::Housing, Vector3::new(housing, housing, 0.0));
        }
        let f_n: Vec3<Nav, f64> = Vec3::new(0.0, 0.0, truth.gravity());
        Self {
            states,
            gyro_process,
            nabla,
            accel_process,
            constants,
            gyro_bias_sd: imu.gyro_bias_sd_deg_h * DEG_PER_HOUR,
            accel_bias_sd: imu.accel_bias_sd_ug * MICRO_G,
            angle_psd: (imu.angle_random_walk_deg_sqrt_h * DEG_PER_SQRT_HOUR).powi(2),
            random_walk_limit_deg: random_walk_limit_deg(scenario, 1.0),
            velocity_psd: (imu.velocity_random_walk_ug_sqrt_hz * MICRO_G_PER_SQRT_HZ).powi(2),
            earth: truth.w_ie_n().skew(),
            force_n: f_n.vector(),
            force: f_n.skew(),
        }
    }

    /// P before anything is measured.
    fn prior(&self, heading_sd: f64) -> DMatrix<f64> {
        let mut p = DMatrix::zeros(self.states, self.states);
        let mut set = |at: usize, sd: f64| p[(at, at)] = sd * sd;
        for axis in 0..3 {
            set(PHI + axis, if axis == 2 { heading_sd } else { PRIOR_TILT });
            set(DV + axis, PRIOR_VELOCITY);
            set(EPS + axis, self.gyro_bias_sd);
            set(self.nabla + axis, self.accel_bias_sd);
            for process in self.processes() {
                set(process.at + axis, process.sd);
            }
            for constant in &self.constants {
                set(constant.at + axis, constant.sd[axis]);
            }
        }
        p
    }

    fn processes(&self) -> impl Iterator<Item = &Process> {
        self.gyro_process.iter().chain(&self.accel_process)
    }

    /// Φ P Φᵀ + Q over a step of `h` seconds with C_s^n and C_b^n at its middle and ω_is^s over it, rad/s.
    fn predict(&self, p: &mut DMatrix<f64>, [c_ns, c_nb]: [&Matrix3<f64>; 2], w_s: &Vector3<f64>, h: f64) {
        let f_s = c_ns.transpose() * self.force_n;
        // The six rows of Φ that are not a decay alone.
        let mut f = Matrix6xX::zeros(self.states);
        let mut set = |row: usize, column: usize, block: &Matrix3<f64>| {
            f.fixed_view_mut::<3, 3>(row, column).copy_from(block);
        };
        let turn = self.earth * h;
        set(PHI, PHI, &(Matrix3::identity() - turn + turn * turn * 0.5));
        set(DV, PHI, &(self.force * h));
        set(DV, DV, &Matrix3::identity());
        let mut gyro_in = |frame: &Matrix3<f64>, column: usize, by: f64| {
            let block = frame * -by;
            set(PHI, column, &block);
            // What attitude gains evenly over the step acts on velocity for half of it.
            set(DV, column, &(self.force * block * (0.5 * h)));
        };
        gyro_in(c_ns, EPS, h);
        if let Some(process) = &self.gyro_process {
            gyro_in(c_ns, process.at, process.integral(h));
        }
        for constant in &self.constants {
            match constant.drive {
                Drive::Rate(axis) => gyro_in(c_ns, constant.at, w_s[axis] * h),
                Drive::Force(axis) => gyro_in(c_ns, constant.at, f_s[axis] * h),
                Drive::Housing => gyro_in(c_nb, constant.at, h),
                Drive::Accel(_) => {}
            }
        }
        for constant in &self.constants {
            if let Drive::Accel(axis) = constant.drive {
                set(DV, constant.at, &(c_ns * (f_s[axis] * h)));
            }
        }
        set(DV, self.nabla, &(c_ns * h));
        if let Some(process) = &self.accel_process {
            set(DV, process.at, &(c_ns * process.integral(h)));
        }

        let mut driven = &f * &*p;
        let square = &driven * f.transpose();
        for process in self.processes() {
            let decay = process.decay(h);
            driven.columns_mut(process.at, 3).scale_mut(decay);
            p.rows_mut(process.at, 3).scale_mut(decay);
            p.columns_mut(process.at, 3).scale_mut(decay);
            for at in process.at..process.at + 3 {
                p[(at, at)] += process.kick(h);
            }
        }
        p.rows_mut(0, DRIVEN).copy_from(&driven);
        p.columns_mut(0, DRIVEN).copy_from(&driven.transpose());
        p.view_mut((0, 0), (DRIVEN, DRIVEN)).copy_from(&square);

        let mut add = |row: usize, column: usize, block: &Matrix3<f64>| {
            let mut view = p.fixed_view_mut::<3, 3>(row, column);
            view += block;
        };
        let (q, identity) = (self.angle_psd, Matrix3::identity());
        let cross = self.force * (0.5 * q * h * h);
        add(PHI, PHI, &(identity * (q * h)));
        add(DV, PHI, &cross);
        add(PHI, DV, &cross.transpose());
        add(
            DV,
            DV,
            &(self.force * self.force.transpose() * (q * h.powi(3) / 3.0) + identity * (self.velocity_psd * h)),
        );
    }

    fn of(&self, drive: Drive) -> Option<&Constant> {
        self.constants.iter().find(|constant| constant.drive == drive)
    }

    fn sigmas(&self, p: &DMatrix<f64>, truth: &Truth, t: f64) -> Sigmas {
        let phi = p.fixed_view::<3, 3>(PHI, PHI).into_owned();
        let sd = |at: usize| p[(at, at)].max(0.0).sqrt();
        // Of a constant and a process together.
        let sum = |constant: usize, process: Option<&Process>| -> [f64; 3] {
            core::array::from_fn(|axis| {
                let a = constant + axis;
                let variance = process.map_or(p[(a, a)], |process| {
                    let b = process.at + axis;
                    p[(a, a)] + 2.0 * p[(a, b)] + p[(b, b)]
                });
                variance.max(0.0).sqrt()
            })
        };
        Sigmas {
            t_s: t,
            random_walk_limit_deg: self.random_walk_limit_deg / t.sqrt(),
            sd: Angles::from_sd(&AttitudeSd::from_phi_covariance(&truth.c_nb(t), &phi)),
            velocity_sd_m_s: core::array::from_fn(|axis| sd(DV + axis)),
            gyro_bias_sd_deg_h: sum(EPS, self.gyro_process.as_ref()).map(|sd| sd / DEG_PER_HOUR),
            accel_bias_sd_ug: sum(self.nabla, self.accel_process.as_ref()).map(|sd| sd / MICRO_G),
            gyro_matrix_sd_ppm: self.of(Drive::Rate(0)).map(|matrix| {
                core::array::from_fn(|row| core::array::from_fn(|column| sd(matrix.at + 3 * column + row) / PPM))
            }),
        }
    }
}

/// Measures δV with variance `variance`, m²/s², one component after the other.
fn measure(p: &mut DMatrix<f64>, variance: f64) {
    for at in DV..DV + 3 {
        let column = p.column(at).into_owned();
        let innovation = column[at] + variance;
        p.ger(-1.0 / innovation, &column, &column, 1.0);
    }
}

impl Limits {
    /// At the end of a run with the IMU turning at `rate_rms`, rad/s.
    fn at(scenario: &Scenario, truth: &Truth, config: &BoundConfig, rate_rms: f64) -> Self {
        let duration = scenario.run.duration_s;
        let north = truth.w_ie_n().y();
        let tilt = truth.gravity() * north;
        let walk = |q: f64| q / (north * duration.sqrt());
        let acceleration = |r: f64| 12_f64.sqrt() * r / (tilt * duration.powf(1.5));
        let velocity = |s: f64| 8.0 * 5_f64.sqrt() * s / (tilt * duration.powf(2.5));
        let (imu, errors) = (&scenario.imu, &scenario.errors);
        // White noise of one quantum, uniform, as a density.
        let density = |quantum: f64| quantum / (12.0 * scenario.run.rate_hz).sqrt();
        let given = |figure: f64, limit: f64| (figure > 0.0).then_some(limit / DEG);
        let (gyro, accel) = (density(errors.gyro_quantum), density(errors.accel_quantum));
        Self {
            angle_random_walk_deg: random_walk_limit_deg(scenario, duration),
            velocity_random_walk_deg: given(
                imu.velocity_random_walk_ug_sqrt_hz,
                acceleration(imu.velocity_random_walk_ug_sqrt_hz * MICRO_G_PER_SQRT_HZ),
            ),
            velocity_measurement_deg: velocity(config.velocity_sd) / DEG,
            gyro_quantum_deg: given(gyro, walk(rate_rms * gyro).hypot(acceleration(truth.gravity() * gyro))),
            accel_quantum_deg: given(accel, acceleration(rate_rms * accel).hypot(velocity(accel))),
        }
    }
}

/// ARW/(ω_ie cos L √T), degrees: what the angle random walk alone leaves of heading after `seconds`, all else known.
pub fn random_walk_limit_deg(scenario: &Scenario, seconds: f64) -> f64 {
    let north = nav::earth::OMEGA_IE * (scenario.place.latitude_deg * DEG).cos();
    scenario.imu.angle_random_walk_deg_sqrt_h * DEG_PER_SQRT_HOUR / (north * seconds.sqrt()) / DEG
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sensors::Imu;

    fn builtin(name: &str) -> Scenario {
        Scenario::builtin(name).unwrap()
    }

    fn bound(scenario: &Scenario, seed: u64) -> Bound {
        run(scenario, seed, &BoundConfig::default()).unwrap()
    }

    /// Heading σ after `t` whole seconds, degrees.
    fn heading(bound: &Bound, t: usize) -> f64 {
        assert_eq!(bound.curve[t - 1].t_s, t as f64);
        bound.curve[t - 1].sd.heading_deg
    }

    fn near(value: f64, expected: f64, part: f64) {
        assert!((value / expected - 1.0).abs() < part, "{value}, expected {expected}");
    }

    /// Expected: an independent program's figures.
    #[test]
    fn paper_sim() {
        for seed in [1, 2, 3] {
            let bound = bound(&builtin("paper-sim"), seed);
            assert_eq!(bound.states, 12);
            for (t, expected) in [(50, 0.90), (100, 0.62), (200, 0.43), (300, 0.352)] {
                near(heading(&bound, t), expected, 0.01);
            }
            near(bound.limits.angle_random_walk_deg, 0.345, 0.005);
        }
    }

    /// The same program's.
    #[test]
    fn paper_turntable_with_and_without_instability() {
        let mut scenario = builtin("paper-turntable");
        let with = bound(&scenario, 1);
        assert_eq!(with.states, 15);
        near(with.end.sd.heading_deg, 0.445, 0.01);
        scenario.imu.gyro_instability_deg_h = 0.0;
        let without = bound(&scenario, 1);
        assert_eq!(without.states, 12);
        near(without.end.sd.heading_deg, 0.285, 0.01);
    }

    /// A second program's, with phases of its own: they matter while scale factors and misalignments are being found.
    #[test]
    fn moored_with_its_rotor_errors() {
        let bounds = [1, 2, 3, 4].map(|seed| bound(&builtin("moored"), seed));
        assert!(bounds.iter().all(|bound| bound.states == 24));
        for (t, expected, part) in [
            (54, 1.594, 0.2),
            (100, 1.076, 0.1),
            (180, 0.720, 0.02),
            (300, 0.554, 0.01),
        ] {
            for bound in &bounds {
                near(heading(bound, t), expected, part);
            }
        }
        // All of M is found but what the turning about z hides: m_zx and m_zy, 2' = 582 ppm before.
        let matrix = bounds[0].end.gyro_matrix_sd_ppm.unwrap();
        assert!(
            matrix[0].iter().chain(&matrix[1]).all(|sd| *sd < 12.0) && matrix[2][2] < 25.0,
            "{matrix:?}"
        );
        assert!(matrix[2][0] > 100.0 && matrix[2][1] > 100.0, "{matrix:?}");
    }

    /// The independent program's 8.9°, which began with a heading known to 20° and measured at 20 Hz. By default nothing
    /// is known of heading and a second is measured at once.
    #[test]
    fn without_rotation_there_is_no_heading() {
        let mut scenario = builtin("paper-sim");
        scenario.rotor.rate_dps = 0.0;
        let config = BoundConfig {
            interval: 0.05,
            heading_sd: 20.0 * DEG,
            ..BoundConfig::default()
        };
        near(run(&scenario, 1, &config).unwrap().end.sd.heading_deg, 8.9, 0.01);
        near(bound(&scenario, 1).end.sd.heading_deg, 10.08, 0.01);
    }

    #[test]
    fn finer_steps_change_nothing() {
        for name in ["paper-sim", "moored"] {
            let mut scenario = builtin(name);
            scenario.run.duration_s = 100.0;
            let config = BoundConfig::default();
            let fine = run_with_steps(&scenario, 1, &config, 200.0).unwrap();
            near(bound(&scenario, 1).end.sd.heading_deg, fine.end.sd.heading_deg, 1e-3);
        }
    }

    /// What the turning cannot tell from Earth's rate goes into heading in full: an error fixed to the housing, and under a
    /// constant tilt the isotropic part of G, and its antisymmetric one.
    #[test]
    fn what_does_not_turn_stays() {
        let north = nav::earth::OMEGA_IE * (40.0 * DEG).cos();
        let mut scenario = builtin("static");
        scenario.imu = crate::unit::Unit::default();
        let before = bound(&scenario, 1).end.sd.heading_deg;
        scenario.imu.gyro_housing_sd_deg_h = 0.5;
        let housed = bound(&scenario, 1);
        assert_eq!(housed.states, 15);
        near(
            housed.end.sd.heading_deg,
            before.hypot(0.5 * DEG_PER_HOUR / north / DEG),
            0.01,
        );
        scenario.imu.gyro_housing_sd_deg_h = 0.0;
        scenario.imu.gyro_g_sensitivity_sd_deg_h_g = 10.0;
        assert_eq!(bound(&scenario, 1).states, 21);
        // With and without G, whose third column is a bias of its own.
        let pair = |scenario: &Scenario| {
            let mut without = scenario.clone();
            without.imu.gyro_g_sensitivity_sd_deg_h_g = 0.0;
            without.imu.gyro_bias_sd_deg_h = 10.0_f64.hypot(10.0);
            [scenario, &without].map(|scenario| bound(scenario, 1).end.sd.heading_deg)
        };
        let [with, without] = pair(&scenario);
        near(with, without, 0.001);
        scenario.swing.roll.centre_deg = crate::config::Angle::Degrees(4.0);
        let [with, without] = pair(&scenario);
        // Half of the sum of two terms of G, of a tilt of 4°.
        let stays = 10.0 * DEG_PER_HOUR * (4.0 * DEG).sin() / 2.0_f64.sqrt() / north / DEG;
        near(with, without.hypot(stays), 0.02);
    }

    /// Accelerometer errors turn with the rotor, and cost hardly anything.
    #[test]
    fn accelerometer_errors_are_found() {
        let mut scenario = builtin("paper-sim");
        let before = bound(&scenario, 1).end.sd.heading_deg;
        scenario.imu.accel_scale_factor_sd_ppm = 500.0;
        scenario.imu.accel_misalignment_sd_arcmin = 3.0;
        let with = bound(&scenario, 1);
        assert_eq!(with.states, 21);
        assert!(with.end.sd.heading_deg >= before);
        near(with.end.sd.heading_deg, before, 0.02);
        // With the rotor at rest a misalignment of 3' tilts the vertical by as much, what is known of it at first left out.
        let mut scenario = builtin("static");
        scenario.rotor.rate_dps = 0.0;
        scenario.imu.accel_misalignment_sd_arcmin = 3.0;
        let tilt = bound(&scenario, 1).end.sd.pitch_deg;
        near(tilt, (0.05_f64.powi(-2) + 0.2_f64.powi(-2)).powf(-0.5), 0.02);
    }

    /// The bias that the table shows is the sum that a filter is judged by: at the start both parts' priors.
    #[test]
    fn biases_are_turn_on_and_instability_together() {
        let mut scenario = builtin("paper-turntable");
        scenario.run.duration_s = 0.1;
        scenario.imu.accel_instability_ug = 300.0;
        let bound = bound(&scenario, 1);
        assert_eq!(bound.states, 18);
        // Along z a tenth of a second tells nothing of the gyro.
        near(bound.end.gyro_bias_sd_deg_h[2], 10.0_f64.hypot(3.0), 1e-3);
        // Along x a tilt of 0.2° = 3500 µg hides it.
        near(bound.end.accel_bias_sd_ug[0], 500.0_f64.hypot(300.0), 0.02);
    }

    /// With all but one cause taken away the ideal filter meets that cause's formula.
    #[test]
    fn formulas_meet_the_covariance() {
        let mut scenario = builtin("paper-sim");
        scenario.imu = crate::unit::Unit::perfect();
        // Velocity random walk: what is measured must be better than it.
        scenario.imu.velocity_random_walk_ug_sqrt_hz = 1000.0;
        let walk = bound(&scenario, 1);
        near(
            walk.end.sd.heading_deg,
            walk.limits.velocity_random_walk_deg.unwrap(),
            0.05,
        );
        // Measurement alone, as coarse as makes it the larger.
        scenario.imu.velocity_random_walk_ug_sqrt_hz = 0.0;
        let config = BoundConfig {
            velocity_sd: 0.1,
            ..BoundConfig::default()
        };
        let measured = run(&scenario, 1, &config).unwrap();
        near(
            measured.end.sd.heading_deg,
            measured.limits.velocity_measurement_deg,
            0.05,
        );
        assert_eq!(measured.limits.velocity_random_walk_deg, None);
        // Angle random walk alone.
        scenario.imu.angle_random_walk_deg_sqrt_h = 0.02;
        let angle = bound(&scenario, 1);
        near(angle.end.sd.heading_deg, angle.limits.angle_random_walk_deg, 0.02);
    }

    /// The gyros' remainder, resolved in n, walks as its formula says; in s, where nothing turns it, it would not.
    #[test]
    fn quantisation_walks_while_the_imu_turns() {
        let mut scenario = builtin("paper-sim");
        scenario.imu = crate::unit::Unit::perfect();
        scenario.errors.gyro_quantum = 1e-5;
        let (rate, seconds) = (20.0, 500.0);
        scenario.run.rate_hz = rate;
        scenario.run.duration_s = seconds;
        let limits = bound(&scenario, 1).limits;
        assert_eq!(limits.accel_quantum_deg, None);
        let (mut squares, seeds) = (0.0, 60);
        for seed in 0..seeds {
            let truth = Truth::new(&scenario, seed).unwrap();
            let mut imu = Imu::new(&scenario, seed);
            let mut sum = Vector3::zeros();
            for k in 0..(rate * seconds) as u32 {
                let t = f64::from(k) / rate;
                let (dtheta_s, dv_s) = truth.increment(t, t + 1.0 / rate);
                let error = imu.measure(dtheta_s, dv_s, 1.0 / rate).dtheta_s - dtheta_s;
                sum += (truth.c_ns(t + 0.5 / rate) * error).vector();
            }
            squares += sum.x * sum.x + sum.y * sum.y;
        }
        // Each level component has made a walk of q √T, and with it q/√T of rate: over ω_N, heading. The last remainder
        // is besides it, and does not grow.
        let remainder = scenario.errors.gyro_quantum.powi(2) / 12.0;
        let walk = (squares / f64::from(2 * seeds as u32) - remainder).sqrt();
        let north = nav::earth::OMEGA_IE * (40.0 * DEG).cos();
        near(limits.gyro_quantum_deg.unwrap(), walk / (seconds * north) / DEG, 0.15);
    }

    #[test]
    fn what_cannot_be_used_is_refused() {
        let mut scenario = builtin("static");
        for velocity_sd in [0.0, -1.0, f64::NAN, f64::INFINITY] {
            let config = BoundConfig {
                velocity_sd,
                ..BoundConfig::default()
            };
            let message = run(&scenario, 1, &config).unwrap_err().to_string();
            assert!(message.starts_with("velocity_sd: "), "{message}");
        }
        scenario.place.latitude_deg = 90.0;
        assert!(run(&scenario, 1, &BoundConfig::default()).is_err());
    }

    #[test]
    fn rows_are_one_two_five() {
        let bound = bound(&builtin("gyrocompass-standard"), 1);
        let times: Vec<_> = bound.rows.iter().map(|row| row.t_s).collect();
        assert_eq!(times, [10.0, 20.0, 50.0, 100.0, 200.0, 500.0, 1000.0, 1800.0]);
        assert_eq!(bound.curve.len(), 1800);
    }
}
