//! Allan deviation of a log at rest, and what it says of the IMU: a `UNIT.toml`.
//!
//! With `x_k` the integral of a gyro or accelerometer after k samples of `dt`, and clusters of `τ = m dt`, the overlapping
//! Allan variance is
//!
//! ```text
//! σ²(τ) = 1/(2 τ² (N − 2m)) Σ (x_{k+2m} − 2 x_{k+m} + x_k)²
//! ```
//!
//! and noise shows in it as (IEEE Std 952, annex C)
//!
//! ```text
//! σ²(τ) = N²/τ  +  B² 2 ln 2/π  +  K² τ/3                 angle random walk, bias instability, rate random walk
//! σ²(τ) = N²/τ  +  s² (2 − (3 − 4e⁻ᵘ + e⁻²ᵘ)/u)/u,  u = τ/T     … with the drift a Gauss–Markov process
//! ```
//!
//! Both are fitted by least squares, no coefficient below zero, to the octaves of τ, each weighted by its own spread,
//! `σ² √(2/ν)`. The first is what data sheets name; the second is what [`Unit`] has, the simulator draws and the aligner
//! weighs by. ν are the equivalent degrees of freedom after Riley, *Handbook of Frequency Stability Analysis* (NIST SP
//! 1065), 5.4, the least of those for white, flicker and random-walk noise. The fit takes octaves as independent; what
//! that makes too small in the σ of drift is put back, a factor measured by Monte Carlo.
//!
//! Left out of the fit are short clusters in which noise is not white yet: many sensors are filtered below half their sample
//! rate. They end where two octaves agree, and what is fitted begins four times beyond. Where the model does not fit, the σ
//! are those of the points about it.
//!
//! Not modelled: quantisation, sinusoidal noise, the first-order ramp of a temperature that drifts.

use std::io::BufRead;
use std::path::Path;

use frames::units::{DEG_PER_HOUR, DEG_PER_SQRT_HOUR, MICRO_G, MICRO_G_PER_SQRT_HZ};
use frames::{Sensor, Vec3};
use nalgebra::{Matrix3, Vector3};
use nav::calibration::REST_TRAVEL;
use serde::Serialize;

use crate::log::{LogError, LogReader, Place};
use crate::plot::chart::{self, Axis, Chart, Curve};
use crate::plot::{PlotError, Width};
use crate::unit::Unit;

/// Samples kept; a longer log is kept at a half, a quarter, … of its rate.
const MAX_SAMPLES: usize = 1 << 22;
/// Least number of samples.
const MIN_SAMPLES: usize = 1000;
/// Cluster times in an octave, for the plot.
const PER_OCTAVE: u32 = 4;
/// Largest cluster as a fraction of the log: beyond, two or three differences are left.
const LARGEST: usize = 5;
/// Share of the rows that may be missing, and how many more of them before the end of the log.
const MAX_MISSING: f64 = 1e-3;
const MORE_MISSING: f64 = 100.0;

/// Two octaves of white noise that differ by more than so many σ are not white: a filter of the sensor's band, a vibration,
/// coarse digits.
const NOT_WHITE: f64 = 3.0;
/// Beyond such clusters, so many times as long, its traces are gone: of a first-order filter a tenth is left of what it takes
/// from the variance.
const BEYOND: f64 = 4.0;
/// Least number of octaves that are fitted.
const OCTAVES: usize = 5;

/// By how much the variances of the coefficients of drift exceed those of independent octaves: neighbouring octaves see
/// the same few long swings. Runs of a random walk have 3 to 4 (the tests hold it); white noise, told by the many short
/// clusters, has none of it.
const CORRELATED: f64 = 3.0;

/// Why there is no result.
#[derive(Debug, Clone, PartialEq)]
pub enum AllanError {
    /// The log itself.
    Log(LogError),
    /// Too few samples.
    TooShort {
        /// Samples there are.
        samples: usize,
    },
    /// The rotor turned: its errors would hide those of the gyros.
    Turning {
        /// Where in the log.
        at: Place,
    },
    /// More than a thousandth of the rows is missing.
    Gaps {
        /// Rows missing.
        missing: u64,
        /// Rows there are.
        rows: u64,
    },
}

impl core::fmt::Display for AllanError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            Self::Log(e) => e.fmt(f),
            Self::TooShort { samples } => write!(
                f,
                "{samples} samples are too few: record some hours at rest, {MIN_SAMPLES} samples are the least"
            ),
            Self::Turning { at } => {
                // A byte says so itself.
                let line = if matches!(at, Place::Line(_)) { "line " } else { "" };
                write!(
                    f,
                    "{line}{at}: the rotor turns: record with the rotor at rest, on a base that does not move"
                )
            }
            Self::Gaps { missing, rows } => {
                write!(f, "{missing} rows are missing beside {rows}: record without gaps")
            }
        }
    }
}

impl core::error::Error for AllanError {}

impl From<LogError> for AllanError {
    fn from(e: LogError) -> Self {
        Self::Log(e)
    }
}

/// A figure with its 1σ.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Estimate {
    /// The figure; zero where it does not show.
    pub value: f64,
    /// 1σ; where the figure is zero, what it may be at most with that confidence is not told.
    pub sd: f64,
}

impl Estimate {
    /// The root of a variance with its 1σ.
    fn root(variance: f64, sd: f64) -> Self {
        let value = variance.max(0.0).sqrt();
        let sd = if value > 0.0 { sd / (2.0 * value) } else { 0.0 };
        Self { value, sd }
    }

    fn scaled(self, factor: f64) -> Self {
        Self {
            value: self.value * factor,
            sd: self.sd * factor,
        }
    }
}

/// One point of the plot.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Point {
    /// Cluster time, s.
    pub tau_s: f64,
    /// Allan deviation.
    pub deviation: f64,
    /// Its 1σ.
    pub sd: f64,
}

/// What one axis shows. Units are those of its integral's derivative: rad/s or m/s², per √s and so on.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct AxisReport {
    /// The deviations.
    pub points: Vec<Point>,
    /// Mean over the log. Of a gyro, Earth's rate is in it.
    pub mean: f64,
    /// White noise, N, per √s: angle or velocity random walk.
    pub random_walk: Estimate,
    /// Shortest cluster that is fitted, s: below, the noise is not white.
    pub white_from_s: f64,
    /// χ² of the fit over its degrees of freedom: about one, or less, where the model holds.
    pub misfit: f64,
    /// Bias instability: the least deviation that is known to a quarter, over √(2 ln 2/π) = 0.664.
    pub bias_instability: Estimate,
    /// Where the deviation is least, s.
    pub bias_instability_tau_s: f64,
    /// Rate random walk, K, per s√s.
    pub rate_random_walk: Estimate,
    /// Drift as a Gauss–Markov process: 1σ, …
    pub drift: Estimate,
    /// … and its correlation time, s.
    pub drift_tau_s: f64,
}

/// What a log at rest shows.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Report {
    /// Length of the log, s.
    pub seconds: f64,
    /// Interval of the samples kept, s.
    pub dt_s: f64,
    /// Gyros on x, y, z, in rad and s.
    pub gyro: [AxisReport; 3],
    /// Accelerometers on x, y, z, in m and s.
    pub accel: [AxisReport; 3],
}

/// Integrals of six axes at even times, in bounded memory.
#[derive(Debug, Clone)]
struct Recorder {
    phase: [Vec<f64>; 6],
    /// Samples to one that is kept.
    stride: u64,
    sum: [f64; 6],
    samples: u64,
}

impl Recorder {
    fn new() -> Self {
        Self {
            phase: core::array::from_fn(|_| vec![0.0]),
            stride: 1,
            sum: [0.0; 6],
            samples: 0,
        }
    }

    fn push(&mut self, dtheta_s: Vec3<Sensor, f64>, dv_s: Vec3<Sensor, f64>) {
        let increments = dtheta_s.to_array().into_iter().chain(dv_s.to_array());
        for (sum, increment) in self.sum.iter_mut().zip(increments) {
            *sum += increment;
        }
        self.samples += 1;
        if !self.samples.is_multiple_of(self.stride) {
            return;
        }
        for (phase, sum) in self.phase.iter_mut().zip(self.sum) {
            phase.push(sum);
        }
        if self.phase[0].len() > MAX_SAMPLES {
            self.stride *= 2;
            for phase in &mut self.phase {
                let mut k = 0;
                phase.retain(|_| {
                    k += 1;
                    k % 2 == 1
                });
            }
        }
    }
}

/// Overlapping Allan variance of the integral `phase`, sampled every `dt`, for clusters of `m` samples; `None` where there
/// is no difference of them.
pub fn variance(phase: &[f64], dt: f64, m: usize) -> Option<f64> {
    if m == 0 || phase.len() < 2 * m + 1 {
        return None;
    }
    let tau = dt * m as f64;
    let differences = phase.len() - 2 * m;
    let sum: f64 = phase
        .iter()
        .zip(&phase[m..])
        .zip(&phase[2 * m..])
        .map(|((a, b), c)| {
            let d = c - 2.0 * b + a;
            d * d
        })
        .sum();
    Some(sum / (2.0 * tau * tau * differences as f64))
}

/// Equivalent degrees of freedom of the overlapping variance of `n` points of the integral: the least of those for white
/// noise, flicker noise and random walk of the rate.
fn degrees_of_freedom(n: usize, m: usize) -> f64 {
    let (n, m) = (n as f64, m as f64);
    let white = (3.0 * (n - 1.0) / (2.0 * m) - 2.0 * (n - 2.0) / n) * 4.0 * m * m / (4.0 * m * m + 5.0);
    let flicker = if m < 1.5 {
        2.0 * (n - 2.0).powi(2) / (2.3 * n - 4.9)
    } else {
        5.0 * n * n / (4.0 * m * (n + 3.0 * m))
    };
    let walk = (n - 2.0) / m * ((n - 1.0).powi(2) - 3.0 * m * (n - 1.0) + 4.0 * m * m) / (n - 3.0).powi(2);
    white.min(flicker).min(walk).max(1.0)
}

/// Variance of a Gauss–Markov process of unit variance in an Allan plot, at `u` correlation times.
fn gauss_markov(u: f64) -> f64 {
    if u < 1e-3 {
        // The fractions cancel: their series.
        return u * (2.0 / 3.0 - 0.5 * u);
    }
    (2.0 - (3.0 - 4.0 * (-u).exp() + (-2.0 * u).exp()) / u) / u
}

/// One variance of the fit: cluster time, variance, degrees of freedom.
type Observation = (f64, f64, f64);

/// Coefficients, none below zero, of up to three columns, with their covariance and what is left of χ².
#[derive(Debug, Clone, Copy)]
struct Fit {
    c: Vector3<f64>,
    covariance: Matrix3<f64>,
    chi2: f64,
}

/// Least squares over all subsets of the columns: with three of them the best that has no coefficient below zero is found
/// by looking at all.
fn fit(observations: &[Observation], columns: &dyn Fn(f64) -> Vector3<f64>) -> Fit {
    let mut best = Fit {
        c: Vector3::zeros(),
        covariance: Matrix3::zeros(),
        chi2: f64::INFINITY,
    };
    let mut expected: Vec<f64> = observations.iter().map(|o| o.1).collect();
    // Weights by what is expected, not by what was found: a point that is low by chance would weigh most.
    for _ in 0..4 {
        best.chi2 = f64::INFINITY;
        for subset in 1..8_u8 {
            let chosen = |k: usize| subset >> k & 1 == 1;
            let (mut normal, mut right) = (Matrix3::zeros(), Vector3::zeros());
            let weight = |o: &Observation, e: f64| o.2 / (2.0 * e * e);
            for (o, e) in observations.iter().zip(&expected) {
                let g = columns(o.0);
                let g = Vector3::from_fn(|k, _| if chosen(k) { g[k] } else { 0.0 });
                normal += g * g.transpose() * weight(o, *e);
                right += g * (o.1 * weight(o, *e));
            }
            // Scaled to a unit diagonal: the columns differ by many powers of ten.
            let scale = Vector3::from_fn(|k, _| if chosen(k) { normal[(k, k)].sqrt().recip() } else { 0.0 });
            let scaled = Matrix3::from_fn(|i, j| {
                if i == j {
                    1.0
                } else {
                    normal[(i, j)] * scale[i] * scale[j]
                }
            });
            let Some(inverse) = scaled.try_inverse() else { continue };
            let covariance = Matrix3::from_fn(|i, j| inverse[(i, j)] * scale[i] * scale[j]);
            let c = covariance * right;
            if !c.iter().all(|c| *c >= 0.0) {
                continue;
            }
            let chi2 = observations
                .iter()
                .zip(&expected)
                .map(|(o, e)| (o.1 - columns(o.0).dot(&c)).powi(2) * weight(o, *e))
                .sum();
            if chi2 < best.chi2 {
                best = Fit { c, covariance, chi2 };
            }
        }
        for (e, o) in expected.iter_mut().zip(observations) {
            let model = columns(o.0).dot(&best.c);
            if model > 0.0 {
                *e = model;
            }
        }
    }
    // The spread with all columns free, those at zero as well: which of them are there is found from the same data.
    let mut normal = Matrix3::zeros();
    for (o, e) in observations.iter().zip(&expected) {
        let g = columns(o.0);
        normal += g * g.transpose() * (o.2 / (2.0 * e * e));
    }
    let scale = Vector3::from_fn(|k, _| {
        if normal[(k, k)] > 0.0 {
            normal[(k, k)].sqrt().recip()
        } else {
            0.0
        }
    });
    let scaled = Matrix3::from_fn(|i, j| {
        if i == j {
            1.0
        } else {
            normal[(i, j)] * scale[i] * scale[j]
        }
    });
    if let Some(inverse) = scaled.try_inverse() {
        best.covariance = Matrix3::from_fn(|i, j| inverse[(i, j)] * scale[i] * scale[j]);
        for k in 1..3 {
            best.covariance[(k, k)] *= CORRELATED;
        }
    }
    // χ² under the last weights favours large models; the likelihood's own measure does not.
    best.chi2 = observations
        .iter()
        .map(|o| {
            let ratio = o.1 / columns(o.0).dot(&best.c).max(f64::MIN_POSITIVE);
            o.2 * (ratio - 1.0 - ratio.ln())
        })
        .sum();
    best
}

/// The first of the octaves from which on noise is white, or hidden by drift. Many sensors are filtered below half their
/// sample rate: in their shortest clusters noise is missing, which the fit would take for all there is.
fn first_white(observations: &[Observation]) -> usize {
    let white = |pair: &[Observation]| {
        let (a, b) = (pair[0], pair[1]);
        let spread = (2.0 / a.2 + 2.0 / b.2).sqrt();
        (b.1 * b.0 / (a.1 * a.0)).ln().abs() <= NOT_WHITE * spread
    };
    let Some(last) = observations.windows(2).take_while(|pair| !white(pair)).last() else {
        return 0;
    };
    let from = observations
        .iter()
        .position(|o| o.0 >= BEYOND * last[1].0 * (1.0 - 1e-9))
        .unwrap_or(observations.len());
    from.min(observations.len().saturating_sub(OCTAVES))
}

/// What the integral `phase`, sampled every `dt`, shows.
fn axis(phase: &[f64], dt: f64) -> AxisReport {
    let n = phase.len();
    let largest = (n / LARGEST).max(1);
    let mut sizes: Vec<usize> = (0..)
        .map(|k: u32| (f64::from(k) / f64::from(PER_OCTAVE)).exp2().round() as usize)
        .take_while(|m| *m <= largest)
        .collect();
    sizes.dedup();
    let mut points = Vec::new();
    let mut observations: Vec<Observation> = Vec::new();
    for m in sizes {
        let Some(variance) = variance(phase, dt, m) else { break };
        let freedom = degrees_of_freedom(n, m);
        let tau_s = dt * m as f64;
        let deviation = variance.sqrt();
        points.push(Point {
            tau_s,
            deviation,
            sd: deviation / (2.0 * freedom).sqrt(),
        });
        if m.is_power_of_two() && variance > 0.0 {
            observations.push((tau_s, variance, freedom));
        }
    }
    observations.drain(..first_white(&observations));
    let white_from_s = observations.first().map_or(dt, |o| o.0);
    let flicker = 2.0 * core::f64::consts::LN_2 / core::f64::consts::PI;
    let ieee = fit(&observations, &|tau| Vector3::new(tau.recip(), flicker, tau / 3.0));
    // The correlation time enters as it will: the best of a fine row of them.
    let longest = dt * n as f64;
    let mut drift = (fit(&observations, &|tau| Vector3::new(tau.recip(), 0.0, 0.0)), longest);
    // Shorter than the clusters it looks like white noise.
    let mut tau_c = (10.0 * dt).max(2.0 * white_from_s);
    while tau_c < longest {
        let with = fit(&observations, &|tau| {
            Vector3::new(tau.recip(), gauss_markov(tau / tau_c), 0.0)
        });
        if with.chi2 < drift.0.chi2 {
            drift = (with, tau_c);
        }
        tau_c *= 1.1;
    }
    // By whichever of the two tells the rest better. Where neither does, the spread is that of the points about it.
    let better = if ieee.chi2 <= drift.0.chi2 { &ieee } else { &drift.0 };
    let misfit = better.chi2 / observations.len().saturating_sub(3).max(1) as f64;
    let root = |f: &Fit, k: usize| Estimate::root(f.c[k], (f.covariance[(k, k)] * misfit.max(1.0)).max(0.0).sqrt());
    let least = points
        .iter()
        .copied()
        // The longest clusters are low by chance as often as not: only those known to a quarter.
        .filter(|p| p.sd <= 0.25 * p.deviation)
        .min_by(|a, b| a.deviation.total_cmp(&b.deviation))
        .unwrap_or(Point {
            tau_s: 0.0,
            deviation: 0.0,
            sd: 0.0,
        });
    AxisReport {
        mean: (phase[n - 1] - phase[0]) / (dt * (n - 1) as f64),
        random_walk: root(better, 0),
        white_from_s,
        misfit,
        bias_instability: Estimate {
            value: least.deviation,
            sd: least.sd,
        }
        .scaled(flicker.sqrt().recip()),
        bias_instability_tau_s: least.tau_s,
        rate_random_walk: root(&ieee, 2),
        drift: root(&drift.0, 1),
        drift_tau_s: drift.1,
        points,
    }
}

/// Reads a log at rest.
///
/// # Errors
/// [`AllanError`] where the log cannot be read, is too short, has gaps, or is not at rest.
pub fn of_log(path: &Path) -> Result<Report, AllanError> {
    of_reader(&mut LogReader::open(path)?)
}

/// The same for a log that is open already.
///
/// # Errors
/// As of [`of_log`].
pub fn of_reader<R: BufRead>(reader: &mut LogReader<R>) -> Result<Report, AllanError> {
    let mut dt = None;
    let mut recorder = Recorder::new();
    let (mut stand, mut missing, mut rows) = (None, 0, 0);
    while let Some(row) = reader.next() {
        let row = row?;
        // Known once rows have been looked at.
        let dt = *dt.get_or_insert(reader.nominal_dt_s().unwrap_or(row.dt_s));
        if (row.encoder - *stand.get_or_insert(row.encoder)).abs() > REST_TRAVEL {
            return Err(AllanError::Turning { at: row.at });
        }
        // Rows that are missing are put in as their neighbour: a thousandth of them at most.
        let lost = row.gap.as_ref().map_or(0, |gap| gap.missing);
        missing = u64::saturating_add(missing, lost);
        rows += 1;
        if missing as f64 > MAX_MISSING * rows as f64 + MORE_MISSING {
            return Err(AllanError::Gaps { missing, rows });
        }
        for _ in 0..=lost {
            recorder.push(row.w_is_s * dt, row.f_is_s * dt);
        }
    }
    if missing as f64 > MAX_MISSING * rows as f64 + 10.0 {
        return Err(AllanError::Gaps { missing, rows });
    }
    report(&recorder, dt.unwrap_or_default())
}

fn report(recorder: &Recorder, dt: f64) -> Result<Report, AllanError> {
    let samples = recorder.phase[0].len() - 1;
    if samples < MIN_SAMPLES {
        return Err(AllanError::TooShort { samples });
    }
    let kept = dt * recorder.stride as f64;
    let of = |k: usize| axis(&recorder.phase[k], kept);
    Ok(Report {
        seconds: dt * recorder.samples as f64,
        dt_s: kept,
        gyro: core::array::from_fn(of),
        accel: core::array::from_fn(|k| of(3 + k)),
    })
}

impl Report {
    /// The figures of a unit of this kind: the RMS of the axes, drift as a Gauss–Markov process where it is more than 2σ.
    ///
    /// What one log cannot tell, turn-on biases, scale factors and misalignments, is as in `base`.
    pub fn unit(&self, base: &Unit) -> Unit {
        let rms = |axes: &[AxisReport; 3], of: fn(&AxisReport) -> f64| {
            (axes.iter().map(|a| of(a).powi(2)).sum::<f64>() / 3.0).sqrt()
        };
        let seen = |a: &AxisReport| {
            if a.drift.value > 2.0 * a.drift.sd {
                a.drift.value
            } else {
                0.0
            }
        };
        // Times differ by factors: their geometric mean, weighted by who has a drift at all.
        let time = |axes: &[AxisReport; 3], otherwise: f64| {
            let with: Vec<f64> = axes
                .iter()
                .filter(|a| seen(a) > 0.0)
                .map(|a| a.drift_tau_s.ln())
                .collect();
            if with.is_empty() {
                otherwise
            } else {
                (with.iter().sum::<f64>() / with.len() as f64).exp()
            }
        };
        Unit {
            angle_random_walk_deg_sqrt_h: rms(&self.gyro, |a| a.random_walk.value) / DEG_PER_SQRT_HOUR,
            velocity_random_walk_ug_sqrt_hz: rms(&self.accel, |a| a.random_walk.value) / MICRO_G_PER_SQRT_HZ,
            gyro_instability_deg_h: rms(&self.gyro, seen) / DEG_PER_HOUR,
            gyro_instability_tau_s: time(&self.gyro, base.gyro_instability_tau_s),
            accel_instability_ug: rms(&self.accel, seen) / MICRO_G,
            accel_instability_tau_s: time(&self.accel, base.accel_instability_tau_s),
            ..base.clone()
        }
    }

    /// A `UNIT.toml` of what the log tells; the rest is left out.
    pub fn unit_toml(&self) -> String {
        let unit = self.unit(&Unit::default());
        let bias =
            |axes: &[AxisReport; 3], factor: f64| axes.each_ref().map(|a| format!("{:.1}", a.mean / factor)).join(", ");
        format!(
            "# Allan deviation of {:.0} s at rest, x, y and z taken together.\n\
             # Turn-on biases, scale factors and misalignments are not in such a log: add them from the data sheet.\n\
             # Means of this log, Earth's rate (15 degrees/h) included: gyros {} degrees/h.\n\
             angle_random_walk_deg_sqrt_h = {:.4e}\n\
             velocity_random_walk_ug_sqrt_hz = {:.4e}\n\
             gyro_instability_deg_h = {:.4e}\n\
             gyro_instability_tau_s = {:.1}\n\
             accel_instability_ug = {:.4e}\n\
             accel_instability_tau_s = {:.1}\n",
            self.seconds,
            bias(&self.gyro, DEG_PER_HOUR),
            unit.angle_random_walk_deg_sqrt_h,
            unit.velocity_random_walk_ug_sqrt_hz,
            unit.gyro_instability_deg_h,
            unit.gyro_instability_tau_s,
            unit.accel_instability_ug,
            unit.accel_instability_tau_s,
        )
    }

    /// The figures as a table.
    pub fn table(&self) -> String {
        let mut text = format!(
            "{:.0} s at rest; value ± 1σ; white from: the shortest cluster that is fitted; misfit: χ² over its degrees of freedom\n\
             {:<8} {:>20} {:>13} {:>7} {:>28} {:>26} {:>28}\n",
            self.seconds,
            "",
            "random walk",
            "white from",
            "misfit",
            "bias instability (at)",
            "rate random walk",
            "drift (correlation time)"
        );
        let kinds = [
            ("gyro", &self.gyro, DEG_PER_SQRT_HOUR, DEG_PER_HOUR, "°/√h", "°/h"),
            ("accel", &self.accel, MICRO_G_PER_SQRT_HZ, MICRO_G, "µg/√Hz", "µg"),
        ];
        // Two digits of the spread, whatever the size.
        let pm = |e: Estimate, factor: f64| {
            let (value, sd) = (e.value / factor, e.sd / factor);
            let digits = if sd > 0.0 {
                (1.0 - sd.log10().floor()).clamp(0.0, 6.0) as usize
            } else {
                3
            };
            format!("{value:.digits$} ± {sd:.digits$}")
        };
        let time = |s: f64| match s {
            s if s < 0.1 => format!("{:.1} ms", s * 1e3),
            s if s < 10.0 => format!("{s:.2} s"),
            s => format!("{s:.0} s"),
        };
        for (name, axes, walk, bias, walk_unit, bias_unit) in kinds {
            for (axis, letter) in axes.iter().zip(["x", "y", "z"]) {
                // Per root of an hour, as data sheets have it.
                let rate_walk = axis.rate_random_walk.scaled(60.0);
                text += &format!(
                    "{:<8} {:>20} {:>13} {:>7.2} {:>28} {:>26} {:>28}\n",
                    format!("{name} {letter}"),
                    format!("{} {walk_unit}", pm(axis.random_walk, walk)),
                    time(axis.white_from_s),
                    axis.misfit,
                    format!(
                        "{} {bias_unit} ({})",
                        pm(axis.bias_instability, bias),
                        time(axis.bias_instability_tau_s)
                    ),
                    format!("{} {bias_unit}/√h", pm(rate_walk, bias)),
                    format!("{} {bias_unit} ({})", pm(axis.drift, bias), time(axis.drift_tau_s)),
                );
            }
        }
        text
    }

    /// Deviations of gyros and accelerometers over the cluster time.
    ///
    /// # Errors
    /// [`PlotError`] where the file cannot be written.
    pub fn plot(&self, path: &Path) -> Result<(), PlotError> {
        let curves = |axes: &[AxisReport; 3], factor: f64| -> Vec<Curve> {
            axes.iter()
                .zip(["x", "y", "z"])
                .enumerate()
                .map(|(colour, (axis, label))| Curve {
                    label: label.to_owned(),
                    points: axis.points.iter().map(|p| (p.tau_s, p.deviation / factor)).collect(),
                    thin: false,
                    colour,
                })
                .collect()
        };
        let chart = |title, label, curves| Chart {
            title,
            x: Axis::log("cluster time (s)"),
            y: Axis::log(label),
            curves,
        };
        let svg = chart::figure(
            Width::Page,
            &[
                chart("Allan deviation of the gyros", "°/h", curves(&self.gyro, DEG_PER_HOUR)),
                chart(
                    "Allan deviation of the accelerometers",
                    "µg",
                    curves(&self.accel, MICRO_G),
                ),
            ],
        )?;
        svg.save(path)
    }
}

#[cfg(test)]
mod tests {
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;
    use rand_distr::StandardNormal;

    use super::*;
    use crate::log::LogWriter;
    use crate::scenario::Scenario;
    use crate::sensors::Imu;

    fn walk(n: usize, seed: u64) -> Vec<f64> {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let mut x = 0.0;
        (0..n)
            .map(|_| {
                x += rng.sample::<f64, _>(StandardNormal);
                x
            })
            .collect()
    }

    /// The crate `allan` takes the integral as phase, in units of its interval.
    #[test]
    fn variance_is_that_of_another_implementation() {
        let phase = walk(5000, 1);
        let mut other = allan::Allan::builder()
            .max_tau(512)
            .style(allan::Style::AllTau)
            .build_allan();
        for x in &phase {
            other.record(*x);
        }
        for m in [1, 2, 3, 7, 64, 100, 512] {
            let expected = other.get(m).unwrap().variance().unwrap();
            let ours = variance(&phase, 1.0, m).unwrap();
            assert!((ours / expected - 1.0).abs() < 1e-9, "{m}: {ours} {expected}");
            // The interval only scales: rates are the integral's derivative.
            let faster = variance(&phase, 0.01, m).unwrap();
            assert!((faster / ours - 1e4).abs() < 1e-6, "{m}");
        }
        assert_eq!(variance(&phase, 1.0, 2500), None);
    }

    #[test]
    fn gauss_markov_is_continuous() {
        assert!((gauss_markov(0.000_999_9) / gauss_markov(0.001_000_1) - 1.0).abs() < 1e-3);
        // Its largest value, 0.437 σ of the bias at 1.89 correlation times squared twice over (IEEE 952: 0.437 is the
        // deviation over q√T, and q = σ√(2/T)).
        let peak = gauss_markov(1.89).sqrt() / core::f64::consts::SQRT_2;
        assert!((peak - 0.437).abs() < 1e-3, "{peak}");
    }

    fn simulated(unit: &str, seconds: f64, rate_hz: f64, seed: u64) -> Report {
        let quiet = "[imu]\ngyro_bias_sd_deg_h = 0\naccel_bias_sd_ug = 0\n";
        let scenario = Scenario::parse(&format!("{quiet}{unit}"), "test").unwrap();
        let mut imu = Imu::new(&scenario, seed);
        let mut recorder = Recorder::new();
        let dt = rate_hz.recip();
        for _ in 0..(seconds * rate_hz) as u64 {
            let m = imu.measure(Vec3::zero(), Vec3::zero(), dt);
            recorder.push(m.dtheta_s, m.dv_s);
        }
        report(&recorder, dt).unwrap()
    }

    #[test]
    fn finds_the_simulators_own_figures() {
        let text = "angle_random_walk_deg_sqrt_h = 0.1\nvelocity_random_walk_ug_sqrt_hz = 40\n\
                    gyro_instability_deg_h = 5\ngyro_instability_tau_s = 200\n\
                    accel_instability_ug = 30\naccel_instability_tau_s = 100\n";
        let report = simulated(text, 40_000.0, 10.0, 3);
        let unit = report.unit(&Unit::default());
        let close = |found: f64, true_: f64, within: f64| {
            assert!((found / true_ - 1.0).abs() < within, "{found} {true_}");
        };
        close(unit.angle_random_walk_deg_sqrt_h, 0.1, 0.01);
        close(unit.velocity_random_walk_ug_sqrt_hz, 40.0, 0.01);
        // 200 and 400 correlation times, three axes: 6 and 4 % of the spread.
        close(unit.gyro_instability_deg_h, 5.0, 0.2);
        close(unit.accel_instability_ug, 30.0, 0.2);
        assert!(
            (100.0..400.0).contains(&unit.gyro_instability_tau_s),
            "{}",
            unit.gyro_instability_tau_s
        );
        assert!(
            (50.0..200.0).contains(&unit.accel_instability_tau_s),
            "{}",
            unit.accel_instability_tau_s
        );
        // What is written is what is read.
        let read = Unit::parse(&report.unit_toml(), "u.toml").unwrap();
        close(read.gyro_instability_deg_h, unit.gyro_instability_deg_h, 1e-3);
        close(
            read.angle_random_walk_deg_sqrt_h,
            unit.angle_random_walk_deg_sqrt_h,
            1e-3,
        );
        assert_eq!(read.gyro_bias_sd_deg_h, Unit::default().gyro_bias_sd_deg_h);
    }

    #[test]
    fn no_drift_is_seen_where_none_is() {
        let report = simulated("angle_random_walk_deg_sqrt_h = 0.1\n", 10_000.0, 10.0, 5);
        // Of the noise of the whole log, ARW/√T, a drift may be a part that is not seen.
        let unit = report.unit(&Unit::default());
        assert!(unit.gyro_instability_deg_h < 0.2, "{}", unit.gyro_instability_deg_h);
        assert!((unit.angle_random_walk_deg_sqrt_h / 0.1 - 1.0).abs() < 0.01);
    }

    /// White noise and a random walk of the rate, in units of one: errors over their σ.
    #[test]
    fn random_walks_and_their_confidence() {
        let (runs, n) = (40, 20_000);
        let (mut white, mut rate) = (0.0, 0.0);
        let k = 0.02;
        for seed in 0..runs {
            let angle = walk(n, 2 * seed);
            let bias = walk(n, 2 * seed + 1);
            let mut x = 0.0;
            let phase: Vec<f64> = angle
                .iter()
                .zip(&bias)
                .map(|(a, b)| {
                    x += k * b;
                    a + x
                })
                .collect();
            let found = axis(&phase, 1.0);
            let z = |e: Estimate, t: f64| ((e.value - t) / e.sd).powi(2) / runs as f64;
            let ieee_k = found.rate_random_walk;
            rate += z(ieee_k, k);
            white += z(found.random_walk, 1.0);
            assert!((found.random_walk.value - 1.0).abs() < 0.05, "{:?}", found.random_walk);
            assert!((ieee_k.value / k - 1.0).abs() < 0.6, "{ieee_k:?}");
        }
        // One if the σ are right.
        assert!((0.5..2.0).contains(&white), "{white} {rate}");
        assert!((0.5..2.0).contains(&rate), "{white} {rate}");
    }

    /// White noise through a filter of the sensor, a fifth of the sample rate wide: what is white is found beyond it.
    #[test]
    fn a_band_limit_is_no_small_random_walk() {
        let (runs, n, share) = (20, 60_000, 0.5);
        let mut z2 = 0.0;
        for seed in 0..runs {
            let white = walk(n, 100 + seed);
            let (mut rate, mut x) = (0.0, 0.0);
            let phase: Vec<f64> = white
                .windows(2)
                .map(|pair| {
                    rate += share * (pair[1] - pair[0] - rate);
                    x += rate;
                    x
                })
                .collect();
            let found = axis(&phase, 0.01);
            // The integral is per sample: a step of 1 in 0.01 s.
            let walk = found.random_walk;
            assert!((walk.value / 10.0 - 1.0).abs() < 0.05, "{walk:?}");
            assert!(found.white_from_s > 0.03 && found.misfit < 3.0, "{found:?}");
            z2 += ((walk.value - 10.0) / walk.sd).powi(2) / runs as f64;
        }
        assert!((0.3..2.5).contains(&z2), "{z2}");
    }

    fn logged(path: &Path, rate_hz: f64, mut encoder: impl FnMut(u32) -> f64, keep: impl Fn(u32) -> bool) {
        let text = "[imu]\nangle_random_walk_deg_sqrt_h = 0.3\nvelocity_random_walk_ug_sqrt_hz = 50\n";
        let mut imu = Imu::new(&Scenario::parse(text, "test").unwrap(), 1);
        let mut out = LogWriter::create(path, false).unwrap();
        let dt = rate_hz.recip();
        for k in 1..20_000_u32 {
            let m = imu.measure(Vec3::zero(), Vec3::new(0.0, 0.0, 9.8 * dt), dt);
            if keep(k) {
                out.write(f64::from(k) * dt, dt, m.dtheta_s, m.dv_s, encoder(k), None)
                    .unwrap();
            }
        }
        out.finish().unwrap();
    }

    #[test]
    fn logs_of_any_rate() {
        let dir = tempfile::TempDir::new().unwrap();
        let log = dir.path().join("a.csv");
        for rate_hz in [20.0, 100.0] {
            // A few rows lost, as on any bus.
            logged(&log, rate_hz, |_| 0.2, |k| k % 4000 != 17);
            let report = of_log(&log).unwrap();
            let unit = report.unit(&Unit::default());
            assert!((report.seconds - 20_000.0 / rate_hz).abs() < 1.0, "{}", report.seconds);
            assert!((unit.angle_random_walk_deg_sqrt_h / 0.3 - 1.0).abs() < 0.02, "{unit:?}");
            assert!(
                (unit.velocity_random_walk_ug_sqrt_hz / 50.0 - 1.0).abs() < 0.02,
                "{unit:?}"
            );
            assert!((report.accel[2].mean - 9.8).abs() < 0.01);
        }
    }

    #[test]
    fn what_is_no_log_at_rest_is_refused() {
        let dir = tempfile::TempDir::new().unwrap();
        let log = dir.path().join("a.csv");
        logged(&log, 100.0, |k| if k > 500 { 0.01 } else { 0.0 }, |_| true);
        assert_eq!(of_log(&log), Err(AllanError::Turning { at: Place::Line(502) }));
        logged(&log, 100.0, |_| 0.0, |k| k < 500);
        assert_eq!(of_log(&log), Err(AllanError::TooShort { samples: 499 }));
        logged(&log, 100.0, |_| 0.0, |k| k % 100 > 10);
        assert!(matches!(of_log(&log), Err(AllanError::Gaps { .. })));
        assert!(matches!(of_log(&dir.path().join("none.csv")), Err(AllanError::Log(_))));
    }

    #[test]
    fn long_logs_take_bounded_memory() {
        let mut recorder = Recorder::new();
        let step = Vec3::new(1.0, 0.0, 0.0);
        for _ in 0..(MAX_SAMPLES + MAX_SAMPLES / 2) {
            recorder.push(step, Vec3::zero());
        }
        assert_eq!(recorder.stride, 2);
        assert!(recorder.phase[0].len() <= MAX_SAMPLES);
        assert!(recorder.phase[0].windows(2).all(|w| w[1] - w[0] == 2.0));
    }
}
