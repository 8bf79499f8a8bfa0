//! \[Du16\] Du, Sun, Gao, *MEMS IMU Error Mitigation Using Rotation Modulation Technique*, Sensors 2016, 16, 2017.
//!
//! What follows from the paper's models is compared in its digits: Table 1, term by term, by the core's own mechanization
//! with one error at a time; Table 6, by its formulas and by a Monte Carlo of the core's own calibration.
//!
//! The navigation runs (Tables 4, 5, 7 and Figs. 7 to 12) were made with two devices on a turntable. Ours are made with
//! [`Imu`]s of their class, [`MTI_G`] and [`NAV440`], over many seeds: a device is one draw of what we have the spread
//! of, so that these figures can agree in their size only.
//!
//! The turntable: base at rest and level, body axes those of n; 60 s at rest, then turning at a constant rate, 60 s for
//! the calibration and 300 s for the navigation. Increments of the exact motion are in closed form: with `Δα` the turn of
//! an interval, `u` split into its parts along and across the axis,
//!
//! ```text
//! ∫ Rᵀ(α) u dt = (u∥ + sinc(½Δα) Rᵀ(α_middle) u⊥) Δt
//! ```

use frames::units::{DEG, DEG_PER_HOUR, DEG_PER_SQRT_HOUR, PPM};
use frames::{Attitude, Body, Nav, Rot, Sensor, Vec3};
use nalgebra::{Matrix3, Vector3};
use nav::calibration::{self, Calibration, CalibrationConfig, CalibrationError, Calibrator};
use nav::earth::Earth;
use nav::increment::{ConingScullingCorrector, Sample};
use nav::mechanization::{Mechanization, Position, Radii, Vertical};
use rayon::prelude::*;

use super::{Context, Criterion, ReproduceError, Reproduction, Row};
use crate::plot::chart::{self, Axis, Chart, Curve};
use crate::scenario::Scenario;
use crate::sensors::{Imu, run_seed};

/// Table 1.
pub(super) const TABLE_1: Reproduction = Reproduction {
    name: "du16-table1",
    what: "errors after a whole turn about X, Y and Z, by the mechanization, one error at a time",
    run: table_1,
};

/// Tables 6 and 7.
pub(super) const CALIBRATION: Reproduction = Reproduction {
    name: "du16-calibration",
    what: "calibration of 60 s at rest and 60 s turning: predicted σ, Monte Carlo, what it leaves",
    run: calibrations,
};

/// Tables 4 and 5, Figs. 7 to 12.
pub(super) const NAVIGATION: Reproduction = Reproduction {
    name: "du16-navigation",
    what: "conventional and rotary navigation for 300 s at 10 to 100 °/s, partially and fully calibrated",
    run: navigation,
};

/// Latitude of the runs, degrees: the paper names none; two of its authors are at Calgary.
const LATITUDE_DEG: f64 = 51.0;
/// Samples a second, as in the paper.
const RATE_HZ: f64 = 100.0;
/// Time at rest, and of the turning part of the calibration, s.
const REST: f64 = 60.0;
const TURN: f64 = 60.0;
/// Time of the navigation, s.
const NAVIGATE: f64 = 300.0;
/// The rates of the ten tests, °/s.
const RATES_DPS: [f64; 10] = [10.0, 20.0, 30.0, 40.0, 50.0, 60.0, 70.0, 80.0, 90.0, 100.0];

/// The kind of an IMU, as far as these tests excite it.
#[derive(Debug, Clone, Copy)]
struct Class {
    name: &'static str,
    /// Angle random walk, °/√h (Table 3 and §4).
    arw: f64,
    /// Least Allan deviation of the gyros, °/h, at a cluster of [`CLUSTER`] (§4, Fig. 6).
    least_allan: f64,
    /// Turn-on bias of the gyros, 1σ, °/h (Table 3).
    gyro_bias: f64,
    /// Bias of the accelerometers, 1σ, µg. The paper has none; of this size by its height errors, Tables 4 and 5.
    accel_bias: f64,
    /// Velocity random walk, µg/√Hz. The paper has none; usual for the class.
    vrw: f64,
    /// Scale factors, ppm, and misalignments, arc minutes, of the gyros, 1σ. The paper has none; usual for the class.
    scale_ppm: f64,
    misalignment_arcmin: f64,
}

/// Xsens MTi-G.
const MTI_G: Class = Class {
    name: "MTi-G",
    arw: 3.0,
    least_allan: 24.0,
    gyro_bias: 3600.0,
    accel_bias: 1000.0,
    vrw: 200.0,
    scale_ppm: 1000.0,
    misalignment_arcmin: 6.0,
};

/// Crossbow NAV440.
const NAV440: Class = Class {
    name: "NAV440",
    arw: 0.4,
    least_allan: 11.0,
    gyro_bias: 20.0,
    accel_bias: 5000.0,
    vrw: 100.0,
    scale_ppm: 1000.0,
    misalignment_arcmin: 3.0,
};

/// Cluster at which both devices' Allan deviation is least, s, and the correlation time of the drift.
const CLUSTER: f64 = 120.0;

/// Allan variance of a first-order Gauss–Markov process of unit variance and correlation time `tau`, cluster `t`.
fn gauss_markov_allan(t: f64, tau: f64) -> f64 {
    let x = t / tau;
    (2.0 - (3.0 - 4.0 * (-x).exp() + (-2.0 * x).exp()) / x) / x
}

impl Class {
    /// Drift as a Gauss–Markov process, 1σ, °/h: what the least Allan deviation has beyond the angle random walk.
    fn instability(&self) -> f64 {
        let white = self.arw * self.arw / (CLUSTER / 3600.0);
        let rest = (self.least_allan * self.least_allan - white).max(0.0);
        (rest / gauss_markov_allan(CLUSTER, CLUSTER)).sqrt()
    }

    /// A scenario that holds these errors; `drift` and the accelerometers' are left out for white noise alone.
    fn scenario(&self, drift: bool) -> Scenario {
        let mut scenario = Scenario::default();
        scenario.imu.gyro_bias_sd_deg_h = self.gyro_bias;
        scenario.imu.angle_random_walk_deg_sqrt_h = self.arw;
        if drift {
            scenario.imu.accel_bias_sd_ug = self.accel_bias;
            scenario.imu.velocity_random_walk_ug_sqrt_hz = self.vrw;
            scenario.imu.gyro_instability_deg_h = self.instability();
            scenario.imu.gyro_instability_tau_s = CLUSTER;
        }
        set_gyro_matrix(&mut scenario, self.scale_ppm, self.misalignment_arcmin);
        scenario
    }
}

/// The one place that knows where a scenario has these figures.
fn set_gyro_matrix(scenario: &mut Scenario, scale_ppm: f64, misalignment_arcmin: f64) {
    scenario.imu.gyro_scale_factor_sd_ppm = scale_ppm;
    scenario.imu.gyro_misalignment_sd_arcmin = misalignment_arcmin;
}

/// A turntable about one axis, level and aligned with n.
#[derive(Debug, Clone, Copy)]
struct Turntable {
    axis: usize,
    place: Position<f64>,
    w_ie_n: Vector3<f64>,
    g_n: Vector3<f64>,
    alpha: f64,
}

impl Turntable {
    fn new(axis: usize) -> Result<Self, ReproduceError> {
        let place = Position {
            latitude: LATITUDE_DEG * DEG,
            longitude: 0.0,
            height: 0.0,
        };
        let earth = Earth::<f64>::new(place.latitude, place.height).map_err(ReproduceError::failed)?;
        Ok(Self {
            axis,
            place,
            w_ie_n: earth.w_ie_n().vector(),
            g_n: earth.g_n().vector(),
            alpha: 0.0,
        })
    }

    fn unit(&self) -> Vector3<f64> {
        let mut unit = Vector3::zeros();
        unit[self.axis] = 1.0;
        unit
    }

    /// `C_s^b`, and `C_s^n` as well.
    fn c_bs(&self, alpha: f64) -> Rot<Body, Sensor, f64> {
        Rot::<Sensor, Sensor, f64>::exp(Vec3::from_vector(self.unit() * alpha)).relabel()
    }

    /// Turns on at `rate`, rad/s, for `dt`: the exact increments.
    fn turn(&mut self, rate: f64, dt: f64) -> (Vector3<f64>, Vector3<f64>) {
        let half = 0.5 * rate * dt;
        let sinc = if half.abs() < 1e-4 {
            1.0 - half * half / 6.0
        } else {
            half.sin() / half
        };
        let to_s = self.c_bs(self.alpha + half).inverse();
        let axis = self.unit();
        let integral = |u: Vector3<f64>| {
            let along = axis * axis.dot(&u);
            (along + (to_s * Vec3::from_vector(u - along)).vector() * sinc) * dt
        };
        self.alpha += rate * dt;
        (integral(self.w_ie_n) + axis * (rate * dt), integral(-self.g_n))
    }

    fn navigator(&self) -> Result<Mechanization<f64>, ReproduceError> {
        let c_ns = self.c_bs(self.alpha).relabel::<Nav, Sensor>();
        Mechanization::new(self.place, Vec3::zero(), c_ns, Vertical::Free).map_err(ReproduceError::failed)
    }
}

fn sample(dtheta: Vector3<f64>, dv: Vector3<f64>, dt: f64) -> Sample<f64> {
    Sample {
        dtheta_s: Vec3::from_vector(dtheta),
        dv_s: Vec3::from_vector(dv),
        dt,
        gap: 0.0,
    }
}

// ---------------------------------------------------------------------------------------------------------------- Table 1

/// One error of the IMU, of unit size.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Term {
    AccelBias(usize),
    GyroBias(usize),
    /// Scale factor on the diagonal, installation error off it: row, column.
    Gyro(usize, usize),
}

impl Term {
    fn all() -> impl Iterator<Item = Self> {
        let biases = (0..3).map(Self::AccelBias).chain((0..3).map(Self::GyroBias));
        let scales = (0..3).map(|i| Self::Gyro(i, i));
        let installation = (0..9)
            .map(|k| (k / 3, k % 3))
            .filter(|(i, j)| i != j)
            .map(|(i, j)| Self::Gyro(i, j));
        biases.chain(scales).chain(installation)
    }

    fn name(self) -> String {
        let letter = |k: usize| ["x", "y", "z"][k];
        match self {
            Self::AccelBias(k) => format!("b_{}", letter(k)),
            Self::GyroBias(k) => format!("d_{}", letter(k)),
            Self::Gyro(i, j) if i == j => format!("K_g{}", letter(i)),
            Self::Gyro(i, j) => format!("K_g{}{}", letter(i), letter(j)),
        }
    }
}

/// The nonzero entries of Table 1 for the rotation about `axis`, per unit of the error: term, component of n, value.
///
/// For the rotation about X the installation errors are printed without the factor T, here as in (17), which the other
/// two columns have; it is put in.
fn printed_table_1(axis: usize, w_ie: f64, latitude: f64, rate: f64) -> Vec<(Term, usize, f64)> {
    use Term::{AccelBias, Gyro, GyroBias};
    let period = core::f64::consts::TAU / rate;
    let (north, up) = (w_ie * latitude.cos(), w_ie * latitude.sin());
    let half = 0.5 * period;
    let mut entries = vec![(AccelBias(axis), axis, period), (GyroBias(axis), axis, period)];
    entries.extend(match axis {
        0 => vec![
            (Gyro(0, 0), 0, period * rate),
            (Gyro(1, 1), 1, half * north),
            (Gyro(2, 2), 1, half * north),
            (Gyro(1, 1), 2, half * up),
            (Gyro(2, 2), 2, half * up),
            (Gyro(1, 2), 1, half * up),
            (Gyro(2, 1), 1, -half * up),
            (Gyro(1, 2), 2, -half * north),
            (Gyro(2, 1), 2, half * north),
        ],
        1 => vec![
            (Gyro(1, 1), 1, period * (north + rate)),
            (Gyro(0, 0), 2, half * up),
            (Gyro(2, 2), 2, half * up),
            (Gyro(0, 2), 0, half * up),
            (Gyro(2, 0), 0, -half * up),
        ],
        _ => vec![
            (Gyro(0, 0), 1, half * north),
            (Gyro(1, 1), 1, half * north),
            (Gyro(2, 2), 2, period * (up + rate)),
            (Gyro(0, 1), 0, half * north),
            (Gyro(1, 0), 0, -half * north),
        ],
    });
    entries
}

/// What one error makes of attitude (gyros) or velocity (accelerometers) in a whole turn, per unit of it, in n; and what
/// it would make if nothing were modulated.
fn whole_turn(axis: usize, rate: f64, term: Term) -> Result<(Vector3<f64>, f64), ReproduceError> {
    const STEPS: u32 = 720;
    // Small against one, large against rounding.
    const SIZE: f64 = 1e-5;
    let mut table = Turntable::new(axis)?;
    let dt = core::f64::consts::TAU / rate / f64::from(STEPS);
    let (mut matrix, mut gyro_bias, mut accel_bias) = (Matrix3::zeros(), Vector3::zeros(), Vector3::zeros());
    match term {
        Term::AccelBias(k) => accel_bias[k] = SIZE,
        Term::GyroBias(k) => gyro_bias[k] = SIZE,
        Term::Gyro(i, j) => matrix[(i, j)] = SIZE,
    }
    let mut runs = [
        (ConingScullingCorrector::new(), table.navigator()?),
        (ConingScullingCorrector::new(), table.navigator()?),
    ];
    let mut unmodulated = 0.0;
    for _ in 0..STEPS {
        let (dtheta, dv) = table.turn(rate, dt);
        unmodulated += match term {
            Term::Gyro(_, j) => dtheta[j].abs(),
            _ => dt,
        };
        let measured = sample(dtheta + matrix * dtheta + gyro_bias * dt, dv + accel_bias * dt, dt);
        for ((corrector, navigator), sample) in runs.iter_mut().zip([sample(dtheta, dv, dt), measured]) {
            navigator
                .step(&corrector.increment(&sample))
                .map_err(ReproduceError::failed)?;
        }
    }
    let [(_, exact), (_, wrong)] = runs;
    let error = match term {
        Term::AccelBias(_) => wrong.velocity() - exact.velocity(),
        _ => (wrong.c_ns() * exact.c_ns().inverse()).log(),
    };
    Ok((error.vector() / SIZE, unmodulated))
}

fn table_1(context: &mut Context<'_>) -> Result<Vec<Row>, ReproduceError> {
    const RATE_DPS: f64 = 20.0;
    let rate = RATE_DPS * DEG;
    let source = "[Du16] Table 1";
    let mut rows = Vec::new();
    for (axis, letter) in ["X", "Y", "Z"].into_iter().enumerate() {
        context.tell(&format!("rotation about {letter}"));
        let printed = printed_table_1(axis, nav::earth::OMEGA_IE, LATITUDE_DEG * DEG, rate);
        let mut vanishing: f64 = 0.0;
        for term in Term::all() {
            let (error, unmodulated) = whole_turn(axis, rate, term)?;
            for (component, direction) in ["east", "north", "up"].into_iter().enumerate() {
                let ours = error[component];
                let Some((_, _, value)) = printed.iter().find(|(t, c, _)| (*t, *c) == (term, component)) else {
                    vanishing = vanishing.max(ours.abs() / unmodulated);
                    continue;
                };
                let (what, unit) = match term {
                    Term::AccelBias(_) => ("velocity", "m/s per m/s²"),
                    Term::GyroBias(_) => ("attitude", "rad per rad/s"),
                    Term::Gyro(..) => ("attitude", "rad"),
                };
                let row = Row::new(
                    source,
                    format!("about {letter}: {what} {direction} by {}", term.name()),
                    unit,
                    Some(*value),
                    ours,
                    Criterion::Relative(0.01),
                );
                rows.push(if axis == 0 && matches!(term, Term::Gyro(i, j) if i != j) {
                    row.remark("Printed without the factor T, which the columns of Y and Z have: put in.")
                } else {
                    row
                });
            }
        }
        rows.push(
            Row::new(
                source,
                format!("about {letter}: largest of the entries printed as 0, of what it were unmodulated"),
                "",
                Some(0.0),
                vanishing,
                Criterion::Absolute(0.01),
            )
            .remark("At 20 °/s and 51° north; Earth turns on by 0.08° in the meantime, which the table leaves out."),
        );
    }
    Ok(rows)
}

// ----------------------------------------------------------------------------------------------------------- Tables 6 and 7

/// Table 6: rate, °/s, and the σ of scale factor and misalignments, ppm, of MTi-G and NAV440.
const TABLE_6: [(f64, f64, f64); 8] = [
    (10.0, 645.5, 86.1),
    (20.0, 322.7, 43.0),
    (30.0, 215.2, 28.7),
    (40.0, 161.4, 21.5),
    (50.0, 129.1, 17.2),
    (60.0, 107.6, 14.2),
    (70.0, 92.2, 12.3),
    (80.0, 80.7, 10.8),
];
/// Table 6: σ of the biases, °/h, of MTi-G and NAV440.
const TABLE_6_BIAS: [f64; 2] = [23.2, 3.1];

/// Table 7: rate, °/s, and the mean of x, y, z of MTi-G, then of NAV440, °/s.
const TABLE_7: [(f64, [f64; 3], [f64; 3]); 10] = [
    (10.0, [-2.0e-3, 1.0e-2, 10.022], [-2.0e-3, -1.1e-2, 9.990]),
    (20.0, [-7.1e-3, 1.4e-3, 20.020], [9.8e-3, -1.1e-3, 19.990]),
    (30.0, [-1.4e-3, 1.9e-4, 30.024], [7.9e-3, 9.6e-4, 29.996]),
    (40.0, [-5.9e-4, -7.8e-3, 40.008], [8.7e-3, 2.2e-3, 39.999]),
    (50.0, [-4.8e-3, -2.5e-3, 50.001], [2.0e-3, -2.3e-3, 50.011]),
    (60.0, [-1.5e-3, 1.7e-3, 60.008], [4.5e-4, -2.5e-3, 60.005]),
    (70.0, [1.1e-2, 3.8e-3, 69.992], [-2.9e-4, -2.7e-3, 70.004]),
    (80.0, [3.3e-3, -1.6e-3, 79.988], [-1.1e-3, 4.7e-3, 80.002]),
    (90.0, [-8.3e-3, -1.6e-3, 89.998], [-3.3e-3, 5.2e-3, 90.005]),
    (100.0, [9.4e-3, 3.1e-3, 99.993], [-5.6e-3, 3.7e-3, 100.008]),
];

/// How the rotor turns in the calibration.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Turning {
    /// One way throughout, as in the paper.
    OneWay,
    /// As far back as forth.
    ForthAndBack,
}

/// A calibration on the turntable, by the core, which knows attitude and latitude. The IMU and the table are left where
/// they are at its end.
fn calibrate(
    table: &mut Turntable,
    imu: &mut Imu,
    class: &Class,
    drift: bool,
    rate: f64,
    turning: Turning,
    rate_hz: f64,
) -> Result<Calibration<f64>, CalibrationError> {
    let config = CalibrationConfig {
        angle_random_walk: class.arw * DEG_PER_SQRT_HOUR,
        instability: if drift { class.instability() * DEG_PER_HOUR } else { 0.0 },
        rest: REST,
        w_ie_b: Some(Vec3::from_vector(table.w_ie_n)),
        ..CalibrationConfig::default()
    };
    let mut calibrator = Calibrator::new(config)?;
    let dt = rate_hz.recip();
    let mut measure = |table: &mut Turntable, rate: f64| {
        let (dtheta, dv) = table.turn(rate, dt);
        let m = imu.measure(Vec3::from_vector(dtheta), Vec3::from_vector(dv), dt);
        (sample(m.dtheta_s.vector(), m.dv_s.vector(), dt), table.alpha)
    };
    // One more at rest: the first sample only says where the rotor stands.
    for _ in 0..=(REST * rate_hz) as u32 {
        let (sample, alpha) = measure(table, 0.0);
        calibrator.rest(&sample, alpha)?;
    }
    let steps = (TURN * rate_hz) as u32;
    for k in 0..steps {
        let back = turning == Turning::ForthAndBack && (4 * k / steps) % 2 == 1;
        let (sample, alpha) = measure(table, if back { -rate } else { rate });
        calibrator.turn(&sample, alpha)?;
    }
    calibrator.finish()
}

/// Errors of a calibration: of the three biases, rad/s, and of K_xz, K_yz, S_z.
fn calibration_errors(c: &Calibration<f64>, imu: &Imu) -> (Vector3<f64>, Vector3<f64>) {
    let column = imu.gyro_matrix().column(2).into_owned();
    (
        (c.bias_s - imu.gyro_bias_s()).vector(),
        Vector3::new(c.k_xz, c.k_yz, c.s_z) - column,
    )
}

fn rms(values: impl IntoIterator<Item = f64>) -> f64 {
    let (mut sum, mut count) = (0.0, 0.0);
    for v in values {
        sum += v * v;
        count += 1.0;
    }
    f64::sqrt(sum / count)
}

/// RMS errors of calibrations with white noise alone, over runs and axes: bias, °/h, and columns, ppm.
fn calibration_spread(
    class: &Class,
    rate_dps: f64,
    turning: Turning,
    runs: u64,
    seed: u64,
) -> Result<(f64, f64), ReproduceError> {
    // White noise has the same sums at any rate of samples.
    const RATE_HZ: f64 = 20.0;
    let scenario = class.scenario(false);
    let errors: Vec<_> = (0..runs)
        .into_par_iter()
        .map(|run| {
            let mut imu = Imu::new(&scenario, run_seed(seed, run));
            let mut table = Turntable::new(2)?;
            let rate = rate_dps * DEG;
            let c = calibrate(&mut table, &mut imu, class, false, rate, turning, RATE_HZ)
                .map_err(ReproduceError::failed)?;
            Ok(calibration_errors(&c, &imu))
        })
        .collect::<Result<_, ReproduceError>>()?;
    Ok((
        rms(errors.iter().flat_map(|e| e.0.iter().copied())) / DEG_PER_HOUR,
        rms(errors.iter().flat_map(|e| e.1.iter().copied())) / PPM,
    ))
}

fn calibrations(context: &mut Context<'_>) -> Result<Vec<Row>, ReproduceError> {
    /// Three axes each: the RMS of 3000 draws is known to 1.3 %.
    const RUNS: u64 = 1000;
    let seed = context.seed;
    let mut rows = Vec::new();
    for (k, class) in [MTI_G, NAV440].iter().enumerate() {
        let arw = class.arw * DEG_PER_SQRT_HOUR;
        let bias = calibration::bias_sd(arw, REST) / DEG_PER_HOUR;
        let name = class.name;
        let published = TABLE_6_BIAS[k];
        let within = Criterion::Relative(0.05);
        rows.push(Row::new(
            "[Du16] Table 6",
            format!("{name}: σ_b by (35)"),
            "°/h",
            Some(published),
            bias,
            within,
        ));
        for (rate_dps, mti_g, nav440) in TABLE_6 {
            context.tell(&format!("{name}, {rate_dps} °/s: {RUNS} calibrations"));
            let published = [mti_g, nav440][k];
            let column = calibration::column_sd(arw, TURN, rate_dps * DEG * TURN) / PPM;
            let what = |how: &str| format!("{name}, {rate_dps} °/s: σ_s {how}");
            rows.push(Row::new(
                "[Du16] Table 6",
                what("by (36)"),
                "ppm",
                Some(published),
                column,
                within,
            ));
            let (_, found) = calibration_spread(
                class,
                rate_dps,
                Turning::ForthAndBack,
                RUNS,
                run_seed(seed, rate_dps as u64),
            )?;
            rows.push(
                Row::new(
                    "[Du16] Table 6",
                    what("by Monte Carlo, turning forth and back"),
                    "ppm",
                    Some(published),
                    found,
                    within,
                )
                .remark("Turning as far back as forth, the bias does not enter the slope: the case (36) holds for."),
            );
        }
        let (found_bias, found) = calibration_spread(class, 20.0, Turning::OneWay, RUNS, run_seed(seed, 1))?;
        rows.push(Row::new(
            "[Du16] Table 6",
            format!("{name}: σ_b by Monte Carlo"),
            "°/h",
            Some(published),
            found_bias,
            within,
        ));
        rows.push(
            Row::new(
                "[Du16] Table 6",
                format!("{name}, 20 °/s: σ_s by Monte Carlo, turning one way"),
                "ppm",
                Some([TABLE_6[1].1, TABLE_6[1].2][k]),
                found,
                within,
            )
            .remark(
                "(36) takes the bias as known. Found in 60 s at rest, it brings as much noise into the slope as the turn \
                 itself has: √2 times (36), and the fit's own σ says so.",
            ),
        );
    }
    rows.extend(table_7(context)?);
    Ok(rows)
}

/// Table 7: what is left in the mean of the turning part after the calibration, and of it what is the rotor's.
fn table_7(context: &mut Context<'_>) -> Result<Vec<Row>, ReproduceError> {
    const RUNS: u64 = 40;
    let mut rows = Vec::new();
    let mut curves = Vec::new();
    for (k, class) in [MTI_G, NAV440].iter().enumerate() {
        context.tell(&format!("{}: means after the calibration", class.name));
        let scenario = class.scenario(true);
        let mut means = Vec::new();
        let mut induced = Vec::new();
        for (index, rate_dps) in RATES_DPS.into_iter().enumerate() {
            let rate = rate_dps * DEG;
            let found: Vec<_> = (0..RUNS)
                .into_par_iter()
                .map(|run| {
                    let seed = run_seed(run_seed(context.seed, 100 + index as u64), run);
                    let mut imu = Imu::new(&scenario, seed);
                    let mut table = Turntable::new(2)?;
                    let c = calibrate(&mut table, &mut imu, class, true, rate, Turning::OneWay, RATE_HZ)
                        .map_err(ReproduceError::failed)?;
                    let dt = RATE_HZ.recip();
                    let mut sum = Vector3::zeros();
                    for _ in 0..(NAVIGATE * RATE_HZ) as u32 {
                        let (dtheta, dv) = table.turn(rate, dt);
                        let m = imu.measure(Vec3::from_vector(dtheta), Vec3::from_vector(dv), dt);
                        sum += c
                            .corrected(&sample(m.dtheta_s.vector(), m.dv_s.vector(), dt))
                            .dtheta_s
                            .vector();
                    }
                    let column = imu.gyro_matrix().column(2).into_owned();
                    let left = column - Vector3::new(c.k_xz, c.k_yz, c.s_z);
                    // Mean, °/s, and what the rotor makes of a gyro before and after, °/h.
                    Ok([
                        sum / NAVIGATE / DEG,
                        column * rate / DEG_PER_HOUR,
                        left * rate / DEG_PER_HOUR,
                    ])
                })
                .collect::<Result<_, ReproduceError>>()?;
            means.extend(found.iter().map(|f| f[0] - Vector3::new(0.0, 0.0, rate_dps)));
            let over_axes = |of: usize| rms(found.iter().flat_map(|f| [f[of].x, f[of].y, f[of].z]));
            induced.push((rate_dps, over_axes(1), over_axes(2)));
        }
        let published = |axis: usize| {
            rms(TABLE_7.iter().map(|(rate, a, b)| {
                let mean = [a, b][k][axis];
                if axis == 2 { mean - rate } else { mean }
            }))
        };
        for (axis, what) in ["x", "y", "z less the rate"].into_iter().enumerate() {
            rows.push(
                Row::new(
                    "[Du16] Table 7",
                    format!("{}: mean of {what} once calibrated, RMS over the rates", class.name),
                    "°/s",
                    Some(published(axis)),
                    rms(means.iter().map(|m| m[axis])),
                    Criterion::Factor(3.0),
                )
                .remark_if_differs("Ten draws of one device; ours is the RMS over 400 draws of its class."),
            );
        }
        let noise =
            core::f64::consts::SQRT_2 * calibration::bias_sd(class.arw * DEG_PER_SQRT_HOUR, TURN) / DEG_PER_HOUR;
        for (rate_dps, before, after) in &induced {
            let what = |how: &str| format!("{}, {rate_dps} °/s: rotation-induced error of a gyro {how}", class.name);
            let ours = |quantity, value| Row::new("[Du16] §3", quantity, "°/h", None, value, Criterion::None);
            // What there is before grows with the rate: both ends say it.
            if *rate_dps == RATES_DPS[0] || *rate_dps == RATES_DPS[9] {
                rows.push(ours(what("uncalibrated"), *before));
            }
            rows.push(ours(what("left by the calibration"), *after).remark(format!(
                "RMS over runs and axes. Noise alone leaves √2 ARW/√T = {noise:.1} °/h at every rate; the rest is drift \
                 between rest and turn."
            )));
        }
        for (colour, (label, of)) in [
            (
                "uncalibrated",
                (|p: &(f64, f64, f64)| (p.0, p.1)) as fn(&(f64, f64, f64)) -> (f64, f64),
            ),
            ("calibrated", |p| (p.0, p.2)),
        ]
        .into_iter()
        .enumerate()
        {
            curves.push(Curve {
                label: format!("{}, {label}", class.name),
                points: induced.iter().map(of).collect(),
                thin: false,
                colour: 2 * k + colour,
            });
        }
    }
    context.plot("induced.svg", |width| {
        chart::figure(
            width,
            &[Chart {
                title: "Gyro error by the rotation, RMS",
                x: Axis::linear("rotation rate (°/s)"),
                y: Axis::log("°/h"),
                curves: curves.clone(),
            }],
        )
    })?;
    Ok(rows)
}

// ------------------------------------------------------------------------------------------ Tables 4 and 5, Figs. 7 to 12

/// RMS errors of a navigation, in the order of the paper's tables: latitude, longitude, height (m), north, east, up (m/s),
/// pitch, roll, azimuth (°).
type Errors = [f64; 9];

const ERROR_NAMES: [(&str, &str); 9] = [
    ("latitude", "m"),
    ("longitude", "m"),
    ("height", "m"),
    ("v_n", "m/s"),
    ("v_e", "m/s"),
    ("v_u", "m/s"),
    ("pitch", "°"),
    ("roll", "°"),
    ("azimuth", "°"),
];

/// Table 4.
const TABLE_4: Errors = [2412.3, 1526.8, 173.8, 33.2, 20.5, 1.2, 1.83, 1.32, 2.31];
/// Table 5.
const TABLE_5: Errors = [829.1, 2820.1, 1033.0, 4.8, 26.7, 9.0, 0.48, 0.60, 0.73];

/// Means over the rates of the RMS of horizontal position, m, and velocity, m/s (§4.2): partially, fully calibrated.
const ROTARY_MTI_G: [[f64; 2]; 2] = [[1525.8, 14.6], [1057.2, 10.4]];
const ROTARY_NAV440: [[f64; 2]; 2] = [[544.8, 4.9], [213.8, 2.2]];

fn horizontal_position(e: &Errors) -> f64 {
    e[0].hypot(e[1])
}

fn horizontal_velocity(e: &Errors) -> f64 {
    e[3].hypot(e[4])
}

/// Roll and pitch errors over time, degrees.
type Trace = Vec<(f64, f64, f64)>;

/// What a calibration makes of a sample.
type Correction<'a> = dyn Fn(&Sample<f64>) -> Sample<f64> + 'a;

/// Navigates for 300 s from the true place, velocity and attitude, with the samples as each of `corrections` makes them.
fn navigate<const C: usize>(
    table: &mut Turntable,
    imu: &mut Imu,
    rate: f64,
    corrections: [&Correction<'_>; C],
) -> Result<[(Errors, Trace); C], ReproduceError> {
    const EVERY: u32 = 10;
    let dt = RATE_HZ.recip();
    let steps = (NAVIGATE * RATE_HZ) as u32;
    let radii = Radii::new(table.place.latitude.sin());
    let east = radii.prime_vertical * table.place.latitude.cos();
    let mut runs = [(); C].map(|()| (ConingScullingCorrector::new(), [0.0; 9], Trace::new()));
    let mut navigators = [table.navigator()?; C];
    for k in 1..=steps {
        let (dtheta, dv) = table.turn(rate, dt);
        let m = imu.measure(Vec3::from_vector(dtheta), Vec3::from_vector(dv), dt);
        let measured = sample(m.dtheta_s.vector(), m.dv_s.vector(), dt);
        for c in 0..C {
            let (corrector, squares, trace) = &mut runs[c];
            let increment = corrector.increment(&corrections[c](&measured));
            navigators[c].step(&increment).map_err(ReproduceError::failed)?;
            if k % EVERY == 0 {
                let (moved, v) = (navigators[c].displacement(), navigators[c].velocity());
                let attitude: Attitude<f64> = navigators[c].attitude(table.c_bs(table.alpha));
                let heading = frames::math::wrap_pi(attitude.heading);
                let errors = [
                    moved.latitude * radii.meridian,
                    moved.longitude * east,
                    moved.height,
                    v.y(),
                    v.x(),
                    v.z(),
                    attitude.pitch / DEG,
                    attitude.roll / DEG,
                    heading / DEG,
                ];
                for (square, e) in squares.iter_mut().zip(errors) {
                    *square += e * e;
                }
                trace.push((f64::from(k) * dt, errors[7], errors[6]));
            }
        }
    }
    let count = f64::from(steps / EVERY);
    Ok(runs.map(|(_, squares, trace)| (squares.map(|s| f64::sqrt(s / count)), trace)))
}

/// A run without rotation: biases by the mean of a minute, then 300 s.
fn conventional(scenario: &Scenario, seed: u64) -> Result<Errors, ReproduceError> {
    let mut imu = Imu::new(scenario, seed);
    let mut table = Turntable::new(2)?;
    let dt = RATE_HZ.recip();
    let mut sum = Vector3::zeros();
    for _ in 0..(REST * RATE_HZ) as u32 {
        let (dtheta, dv) = table.turn(0.0, dt);
        let m = imu.measure(Vec3::from_vector(dtheta), Vec3::from_vector(dv), dt);
        sum += m.dtheta_s.vector() - dtheta;
    }
    let bias: Vec3<Sensor, f64> = Vec3::from_vector(sum / REST);
    let unbiased = |s: &Sample<f64>| Sample {
        dtheta_s: s.dtheta_s - bias * s.dt,
        ..*s
    };
    let [(errors, _)] = navigate(&mut table, &mut imu, 0.0, [&unbiased])?;
    Ok(errors)
}

/// A rotary run: calibration, then 300 s, partially and fully calibrated.
fn rotary(
    class: &Class,
    scenario: &Scenario,
    rate_dps: f64,
    seed: u64,
) -> Result<[(Errors, Trace); 2], ReproduceError> {
    let mut imu = Imu::new(scenario, seed);
    let mut table = Turntable::new(2)?;
    let rate = rate_dps * DEG;
    let full =
        calibrate(&mut table, &mut imu, class, true, rate, Turning::OneWay, RATE_HZ).map_err(ReproduceError::failed)?;
    let partial = full.biases_only();
    navigate(
        &mut table,
        &mut imu,
        rate,
        [&|s| partial.corrected(s), &|s| full.corrected(s)],
    )
}

/// The mean over runs of each error: what one run has to be expected to give.
fn mean_errors<'e>(runs: impl Iterator<Item = &'e Errors>) -> Errors {
    let (mut sum, mut count) = ([0.0; 9], 0.0);
    for run in runs {
        for (s, e) in sum.iter_mut().zip(run) {
            *s += e;
        }
        count += 1.0;
    }
    sum.map(|s| s / count)
}

fn navigation(context: &mut Context<'_>) -> Result<Vec<Row>, ReproduceError> {
    let mut rows = Vec::new();
    for (class, table, source, published) in [
        (&MTI_G, &TABLE_4, "[Du16] Table 4", &ROTARY_MTI_G),
        (&NAV440, &TABLE_5, "[Du16] Table 5", &ROTARY_NAV440),
    ] {
        rows.extend(navigate_class(context, class, table, source, published)?);
    }
    Ok(rows)
}

fn navigate_class(
    context: &mut Context<'_>,
    class: &Class,
    table: &Errors,
    source: &'static str,
    published: &[[f64; 2]; 2],
) -> Result<Vec<Row>, ReproduceError> {
    const CONVENTIONAL_RUNS: u64 = 60;
    const ROTARY_RUNS: u64 = 20;
    const ONE_DRAW: &str = "Published: one run of one device. Ours: the mean of the RMS errors of many runs of devices of \
                            its class, whose accelerometers, scale factors and misalignments the paper does not give.";
    const CHOSEN: &str = "No test of ours: the paper does not give the accelerometers' biases, and their size was chosen by \
                          this error, which nothing else feeds.";
    let (name, scenario, seed) = (class.name, class.scenario(true), context.seed);
    let mut rows = Vec::new();

    context.tell(&format!("{name}: {CONVENTIONAL_RUNS} conventional runs"));
    let still: Vec<Errors> = (0..CONVENTIONAL_RUNS)
        .into_par_iter()
        .map(|run| conventional(&scenario, run_seed(run_seed(seed, 10), run)))
        .collect::<Result<_, _>>()?;
    let still = mean_errors(still.iter());
    for (k, (what, unit)) in ERROR_NAMES.into_iter().enumerate() {
        let what = format!("{name}, conventional: {what}");
        let row = Row::new(source, what, unit, Some(table[k]), still[k], Criterion::Factor(3.0));
        rows.push(row.remark(if k == 2 || k == 5 { CHOSEN } else { ONE_DRAW }));
    }
    rows.push(
        Row::new(
            source,
            format!("{name}, conventional: horizontal position"),
            "m",
            Some(horizontal_position(table)),
            horizontal_position(&still),
            Criterion::Factor(2.0),
        )
        .remark(ONE_DRAW),
    );

    // By rate: partially, fully calibrated.
    let mut by_rate: Vec<(f64, [Errors; 2])> = Vec::new();
    let shown = if name == MTI_G.name { 10.0 } else { 30.0 };
    let mut traces = None;
    for (index, rate_dps) in RATES_DPS.into_iter().enumerate() {
        context.tell(&format!("{name}: {ROTARY_RUNS} rotary runs at {rate_dps} °/s"));
        let mut runs: Vec<[(Errors, Trace); 2]> = (0..ROTARY_RUNS)
            .into_par_iter()
            .map(|run| {
                rotary(
                    class,
                    &scenario,
                    rate_dps,
                    run_seed(run_seed(seed, 20 + index as u64), run),
                )
            })
            .collect::<Result<_, _>>()?;
        by_rate.push((rate_dps, [0, 1].map(|c| mean_errors(runs.iter().map(|r| &r[c].0)))));
        if rate_dps == shown {
            traces = runs.pop().map(|[partial, full]| [partial.1, full.1]);
        }
    }
    let mean_over_rates =
        |c: usize, of: fn(&Errors) -> f64| by_rate.iter().map(|(_, e)| of(&e[c])).sum::<f64>() / by_rate.len() as f64;
    let parts = ["partially calibrated", "fully calibrated"];
    for (c, part) in parts.into_iter().enumerate() {
        for (k, (what, unit, of)) in [
            ("position", "m", horizontal_position as fn(&Errors) -> f64),
            ("velocity", "m/s", horizontal_velocity),
        ]
        .into_iter()
        .enumerate()
        {
            rows.push(
                Row::new(
                    "[Du16] §4.2",
                    format!("{name}, rotary, {part}: horizontal {what}, mean over the rates"),
                    unit,
                    Some(published[c][k]),
                    mean_over_rates(c, of),
                    Criterion::Factor(2.0),
                )
                .remark(ONE_DRAW),
            );
        }
    }
    rows.push(
        Row::new(
            "[Du16] §4",
            format!("{name}: horizontal position, conventional over rotary fully calibrated"),
            "",
            Some(horizontal_position(table) / published[1][0]),
            horizontal_position(&still) / mean_over_rates(1, horizontal_position),
            Criterion::Factor(2.0),
        )
        .remark(ONE_DRAW),
    );
    let (first, last) = (&by_rate[0].1, &by_rate[by_rate.len() - 1].1);
    let ours = |quantity: String, value| Row::new("[Du16] Figs. 9, 12", quantity, "", None, value, Criterion::None);
    rows.push(ours(
        format!("{name}, partially calibrated: azimuth error at 100 °/s over that at 10 °/s"),
        last[0][8] / first[0][8],
    ));
    rows.push(ours(
        format!("{name}, fully calibrated: azimuth error at 100 °/s over that at 10 °/s"),
        last[1][8] / first[1][8],
    ));
    let tilt = mean_over_rates(1, |e| e[6].max(e[7]));
    rows.push(ours(
        format!("{name}, fully calibrated: azimuth error over that of roll or pitch, mean over the rates"),
        mean_over_rates(1, |e| e[8]) / tilt,
    ));
    plots(context, name, &still, &by_rate, traces.as_ref(), shown)?;
    Ok(rows)
}

/// The paper's figures: 8 and 9 (MTi-G), 11 and 12 (NAV440), 7 and 10.
fn plots(
    context: &mut Context<'_>,
    name: &str,
    still: &Errors,
    by_rate: &[(f64, [Errors; 2])],
    traces: Option<&[Trace; 2]>,
    shown: f64,
) -> Result<(), ReproduceError> {
    let numbers = if name == MTI_G.name { [8, 9, 7] } else { [11, 12, 10] };
    let curves = |of: &dyn Fn(&Errors) -> f64| -> Vec<Curve> {
        let line = |label: &str, colour, of: &dyn Fn(&[Errors; 2]) -> f64| Curve {
            label: label.to_owned(),
            points: by_rate.iter().map(|(rate, e)| (*rate, of(e))).collect(),
            thin: false,
            colour,
        };
        vec![
            line("conventional", 4, &|_| of(still)),
            line("partially calibrated", 1, &|e| of(&e[0])),
            line("fully calibrated", 0, &|e| of(&e[1])),
        ]
    };
    let chart = |title, label, of: &dyn Fn(&Errors) -> f64| Chart {
        title,
        x: Axis::linear("rotation rate (°/s)"),
        y: Axis::log(label),
        curves: curves(of),
    };
    context.plot(&format!("fig{}.svg", numbers[0]), |width| {
        chart::figure(
            width,
            &[
                chart("Horizontal position, RMS over 300 s", "m", &horizontal_position),
                chart("Horizontal velocity, RMS over 300 s", "m/s", &horizontal_velocity),
            ],
        )
    })?;
    context.plot(&format!("fig{}.svg", numbers[1]), |width| {
        chart::figure(
            width,
            &[
                chart("Roll, RMS over 300 s", "°", &|e| e[7]),
                chart("Pitch, RMS over 300 s", "°", &|e| e[6]),
                chart("Azimuth, RMS over 300 s", "°", &|e| e[8]),
            ],
        )
    })?;
    if let Some(traces) = traces {
        let title = |angle: &str| format!("{name} at {shown} °/s: {angle} error of one run");
        let titles = [title("roll"), title("pitch")];
        let panel = |k: usize| Chart {
            title: &titles[k],
            x: Axis::linear("time (s)"),
            y: Axis::linear("°"),
            curves: ["partially calibrated", "fully calibrated"]
                .into_iter()
                .zip(traces)
                .enumerate()
                .map(|(c, (label, trace))| Curve {
                    label: label.to_owned(),
                    points: trace.iter().map(|p| (p.0, if k == 0 { p.1 } else { p.2 })).collect(),
                    thin: true,
                    colour: 1 - c,
                })
                .collect(),
        };
        context.plot(&format!("fig{}.svg", numbers[2]), |width| {
            chart::figure(width, &[panel(0), panel(1)])
        })?;
    }
    let rows: Vec<Vec<f64>> = by_rate
        .iter()
        .map(|(rate, e)| core::iter::once(*rate).chain(e[0]).chain(e[1]).collect())
        .collect();
    let mut header = vec!["rate_dps".to_owned()];
    for part in ["partial", "full"] {
        header.extend(ERROR_NAMES.iter().map(|(what, _)| format!("{part}_{what}")));
    }
    let header: Vec<&str> = header.iter().map(String::as_str).collect();
    context.csv(
        &format!("{}.csv", name.to_lowercase()),
        &header,
        rows.iter().map(Vec::as_slice),
    )
}

#[cfg(test)]
mod tests {
    use super::super::Verdict;
    use super::*;
    use crate::truth::Truth;

    fn context() -> Context<'static> {
        Context::new(1, None, &|_| ())
    }

    #[test]
    fn every_entry_of_table_1() {
        let rows = table_1(&mut context()).unwrap();
        // 11, 7 and 7 entries that do not vanish, and one row each for those that do.
        assert_eq!(rows.len(), 28);
        for row in rows {
            assert_eq!(
                row.verdict,
                Verdict::Agrees,
                "{}: {:?} {}",
                row.quantity,
                row.published,
                row.ours
            );
        }
    }

    /// The increments of the turntable are those the simulator's own truth integrates, where that can: about z.
    #[test]
    fn turntable_is_the_truth() {
        let text = "[place]\nlatitude_deg = 51\n[rotor]\nrate_dps = 20\ntravel_deg = 3600\nacceleration_dps2 = 100000\n\
                    [run]\nduration_s = 10\n";
        let truth = Truth::new(&Scenario::parse(text, "test").unwrap(), 1).unwrap();
        let mut table = Turntable::new(2).unwrap();
        for k in 100..1000 {
            let (start, end) = (f64::from(k) * 0.01, f64::from(k + 1) * 0.01);
            table.alpha = truth.rotor_angle(start);
            let (dtheta, dv) = table.turn(20.0 * DEG, 0.01);
            let (exact_dtheta, exact_dv) = truth.increment(start, end);
            let off = (dtheta - exact_dtheta.vector()).norm();
            assert!(off < 1e-14, "{k}: {off:e}");
            let off = (dv - exact_dv.vector()).norm();
            assert!(off < 1e-13, "{k}: {off:e}");
        }
    }

    /// Limits are four standard errors of the RMS of 900 draws: 10 %.
    #[test]
    fn calibrations_scatter_as_predicted() {
        for (class, rate_dps) in [(&MTI_G, 10.0), (&NAV440, 60.0)] {
            let arw = class.arw * DEG_PER_SQRT_HOUR;
            let bias = calibration::bias_sd(arw, REST) / DEG_PER_HOUR;
            let column = calibration::column_sd(arw, TURN, rate_dps * DEG * TURN) / PPM;
            for (turning, bias, column) in [
                (Turning::OneWay, bias, column * 2.0_f64.sqrt()),
                (Turning::ForthAndBack, bias * 0.5_f64.sqrt(), column),
            ] {
                let (found_bias, found_column) = calibration_spread(class, rate_dps, turning, 300, 5).unwrap();
                assert!((found_bias / bias - 1.0).abs() < 0.1, "{found_bias} {bias}");
                assert!((found_column / column - 1.0).abs() < 0.1, "{found_column} {column}");
            }
        }
    }

    /// Errors that are not there leave none; drift between rest and turn does, and is not in the σ of the noise.
    #[test]
    fn exact_sensors_navigate_exactly() {
        let scenario = Scenario::default();
        let mut imu = Imu::new(&scenario, 1);
        let mut table = Turntable::new(2).unwrap();
        let same = |s: &Sample<f64>| *s;
        let [(errors, _)] = navigate(&mut table, &mut imu, 100.0 * DEG, [&same]).unwrap();
        assert!(horizontal_position(&errors) < 1e-3 && errors[2] < 1e-3, "{errors:?}");
        assert!(errors[6..].iter().all(|angle| *angle < 1e-7), "{errors:?}");
    }

    #[test]
    fn rotation_and_calibration_pay() {
        let scenario = NAV440.scenario(true);
        let runs = 4;
        let mean = |runs: Vec<Errors>| horizontal_position(&mean_errors(runs.iter()));
        let still = mean((0..runs).map(|seed| conventional(&scenario, seed).unwrap()).collect());
        let rotary: Vec<_> = (0..runs)
            .map(|seed| rotary(&NAV440, &scenario, 50.0, seed).unwrap())
            .collect();
        let partial = mean(rotary.iter().map(|r| r[0].0).collect());
        let full = mean(rotary.iter().map(|r| r[1].0).collect());
        assert!(still > 2.0 * partial && partial > full, "{still} {partial} {full}");
        let azimuth = |c: usize| mean_errors(rotary.iter().map(|r| &r[c].0))[8];
        assert!(azimuth(0) > 2.0 * azimuth(1), "{} {}", azimuth(0), azimuth(1));
    }

    /// The drift of a class gives the Allan deviation it was chosen for.
    #[test]
    fn drift_has_the_published_allan_deviation() {
        for class in [MTI_G, NAV440] {
            let mut scenario = class.scenario(true);
            scenario.imu.gyro_bias_sd_deg_h = 0.0;
            let (dt, per_cluster, clusters) = (1.0, 120, 4000);
            let mut imu = Imu::new(&scenario, 3);
            let mut means = Vec::new();
            for _ in 0..clusters {
                let mut sum = Vector3::zeros();
                for _ in 0..per_cluster {
                    sum += imu.measure(Vec3::zero(), Vec3::zero(), dt).dtheta_s.vector();
                }
                means.push(sum / (f64::from(per_cluster) * dt) / DEG_PER_HOUR);
            }
            let variance: f64 =
                means.windows(2).map(|w| (w[1] - w[0]).norm_squared()).sum::<f64>() / (6.0 * (means.len() - 1) as f64);
            assert!(
                (variance.sqrt() / class.least_allan - 1.0).abs() < 0.03,
                "{}",
                variance.sqrt()
            );
        }
    }
}
