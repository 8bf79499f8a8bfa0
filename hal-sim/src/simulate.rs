//! One simulated run: truth, sensors, and the unit's core on their samples.

use frames::{Real, Sensor, Vec3};
use nav::aligner::{Aligner, AlignerError, Event};
use nav::coarse::{Coarse, CoarsePoint, CoarseSolution};
use nav::earth::Earth;
use nav::increment::{Compensator, Decimator, Sample};
use nav::model::{PAPER, ROBUST};
use serde::Serialize;

use crate::align::{self, Angles, Method, Reading, Setup};
use crate::config::Violation;
use crate::scenario::Scenario;
use crate::sensors::{Encoder, Imu};
use crate::truth::Truth;

/// Why a simulation cannot run.
#[derive(Debug, Clone, PartialEq)]
pub enum SimulationError {
    /// The scenario has a figure out of range.
    Scenario(Violation),
    /// The aligner refuses its configuration.
    Aligner(AlignerError),
}

impl core::fmt::Display for SimulationError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            Self::Scenario(e) => e.fmt(f),
            Self::Aligner(e) => e.fmt(f),
        }
    }
}

impl core::error::Error for SimulationError {}

impl From<Violation> for SimulationError {
    fn from(e: Violation) -> Self {
        Self::Scenario(e)
    }
}

impl From<AlignerError> for SimulationError {
    fn from(e: AlignerError) -> Self {
        Self::Aligner(e)
    }
}

/// One sample as the unit gets it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Row {
    /// End of the interval, s.
    pub t: f64,
    /// Measured increments.
    pub sample: Sample<f64>,
    /// Measured rotor angle at the end, rad.
    pub encoder: f64,
    /// Whether a sensor was clipped.
    pub saturated: bool,
}

/// The measured samples of one run, in order. An iterator: a run of any length takes no memory.
#[derive(Debug, Clone)]
pub struct Simulation {
    scenario: Scenario,
    truth: Truth,
    imu: Imu,
    encoder: Encoder,
    next: u64,
}

impl Simulation {
    /// The run of this scenario with this seed.
    ///
    /// # Errors
    /// [`Violation`] where a figure of the scenario is out of range.
    pub fn new(scenario: &Scenario, seed: u64) -> Result<Self, Violation> {
        Ok(Self {
            truth: Truth::new(scenario, seed)?,
            imu: Imu::new(scenario, seed),
            encoder: Encoder::new(scenario),
            scenario: scenario.clone(),
            next: 1,
        })
    }

    /// The truth behind the samples.
    pub fn truth(&self) -> &Truth {
        &self.truth
    }

    /// The sensor errors behind the samples, as they are now.
    pub fn imu(&self) -> &Imu {
        &self.imu
    }
}

impl Iterator for Simulation {
    type Item = Row;

    fn next(&mut self) -> Option<Row> {
        let k = self.next;
        if k > self.scenario.samples() {
            return None;
        }
        self.next += 1;
        let (t0, t) = (self.scenario.time(k - 1), self.scenario.time(k));
        let (dtheta_s, dv_s) = self.truth.increment(t0, t);
        let dt = t - t0;
        let measured = self.imu.measure(dtheta_s, dv_s, dt);
        Some(Row {
            t,
            sample: Sample {
                dtheta_s: measured.dtheta_s,
                dv_s: measured.dv_s,
                dt,
                gap: 0.0,
            },
            encoder: self.encoder.measure(self.truth.rotor_angle(t)),
            saturated: measured.saturated,
        })
    }
}

/// Coarse alignment alone as in \[Xing18\] §5.1, beside the unit's own: two times over the whole run, attitude at its
/// end.
#[derive(Debug, Clone)]
struct PaperCoarse<T: Real> {
    t_k1: f64,
    t_k2: f64,
    compensator: Compensator<T>,
    decimator: Decimator<T>,
    coarse: Coarse<T>,
    first: Option<CoarsePoint<T>>,
    second: Option<CoarsePoint<T>>,
}

impl<T: Real> PaperCoarse<T> {
    fn new((t_k1, t_k2): (f64, f64)) -> Self {
        Self {
            t_k1,
            t_k2,
            compensator: Compensator::new(),
            decimator: Decimator::new(T::lit(0.05)),
            coarse: Coarse::new(),
            first: None,
            second: None,
        }
    }

    fn push(&mut self, sample: &Sample<T>) {
        let increment = self.compensator.increment(sample);
        let Some(joined) = self.decimator.push(&increment) else {
            return;
        };
        self.coarse.push(&joined);
        let t = self.coarse.t().to_f64() + 1e-3;
        for (at, point) in [(self.t_k1, &mut self.first), (self.t_k2, &mut self.second)] {
            if point.is_none() && t >= at {
                *point = Some(self.coarse.point());
            }
        }
    }

    /// Attitude of the housing and its predicted σ, where the run was long enough and the geometry allows.
    fn solve(&self, earth: &Earth<T>, unit: &crate::unit::Unit, alpha: f64) -> Option<(Angles, Angles)> {
        let solution = CoarseSolution::solve(self.first?, self.second?, earth).ok()?;
        let mut c_ns = self.coarse.c_ns(&solution, earth);
        if let Some(pending) = self.decimator.pending() {
            c_ns = c_ns * frames::Rot::exp(pending.phi_s);
        }
        let c_nb = c_ns * frames::Rot::about_z(T::lit(alpha)).inverse();
        let p_phi = self.coarse.phi_covariance(&solution, earth, &align::noise(unit));
        let sd = frames::AttitudeSd::from_phi_covariance(&c_nb, &p_phi);
        Some((
            Angles::from_attitude(&frames::Attitude::from_rot(&c_nb)),
            Angles::from_sd(&sd),
        ))
    }
}

/// An estimate beside the truth at one time.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Moment {
    /// Time, s.
    pub t_s: f64,
    /// What the unit says.
    pub reading: Reading,
    /// True attitude of the housing.
    pub truth: Angles,
    /// `reading − truth`.
    pub error: Angles,
    /// True gyro biases in s, °/h.
    pub true_gyro_bias_deg_h: [f64; 3],
    /// True accelerometer biases in s, µg.
    pub true_accel_bias_ug: [f64; 3],
    /// Rotor angle, degrees.
    pub rotor_deg: f64,
    /// Running mean of innovation²/variance per component: one where the model holds.
    pub innovation_ratio: f64,
    /// `aligned`, or where the aligner stands.
    pub state: &'static str,
}

/// An attitude, its σ and its error.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Fix {
    /// Attitude of the housing.
    pub attitude: Angles,
    /// Predicted 1σ.
    pub sd: Angles,
    /// Against the truth.
    pub error: Angles,
}

/// How a run ended.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct RunResult {
    /// Scenario by name.
    pub scenario: String,
    /// Seed of the run.
    pub seed: u64,
    /// The fine filter.
    pub method: Method,
    /// `aligned`, or where the aligner stood.
    pub state: &'static str,
    /// Why it is not aligned.
    pub reason: Option<String>,
    /// When it first was, s.
    pub aligned_at_s: Option<f64>,
    /// Samples taken.
    pub samples: u64,
    /// Samples in which a sensor was clipped.
    pub saturated: u64,
    /// Coarse alignment alone over the whole run (\[Xing18\] (7)–(18)), at the run's end.
    pub coarse: Option<Fix>,
    /// The unit's estimate at the run's end.
    #[serde(rename = "final")]
    pub last: Option<Moment>,
}

/// Receives what happens during a run.
pub trait Observer {
    /// A sample has been taken at time `t`.
    fn sample(&mut self, _reading: &Row) {}
    /// The aligner told something at time `t`, s; in words.
    fn event(&mut self, _t: f64, _event: &str) {}
    /// Once a second, from the first estimate on.
    fn moment(&mut self, _moment: &Moment) {}
}

/// Nobody looks.
impl Observer for () {}

/// Runs one scenario with the core in precision `T`.
///
/// # Errors
/// [`SimulationError`] where a figure is out of range.
pub fn run<T: Real>(
    scenario: &Scenario,
    seed: u64,
    method: Method,
    observer: &mut impl Observer,
) -> Result<RunResult, SimulationError> {
    match method {
        Method::Kf | Method::Stf => run_with::<T, PAPER>(scenario, seed, method, observer),
        Method::Robust | Method::RobustKf => run_with::<T, ROBUST>(scenario, seed, method, observer),
    }
}

fn run_with<T: Real, const B: usize>(
    scenario: &Scenario,
    seed: u64,
    method: Method,
    observer: &mut impl Observer,
) -> Result<RunResult, SimulationError> {
    let mut simulation = Simulation::new(scenario, seed)?;
    let setup = Setup::of(scenario, method);
    let mut aligner: Aligner<T, B> = setup.aligner()?;
    let mut paper = PaperCoarse::<T>::new(scenario.coarse_times());
    let (mut samples, mut saturated, mut aligned_at_s) = (0, 0, None);
    let mut last_reading = None;
    let per_second = scenario.run.rate_hz.round().max(1.0) as u64;
    while let Some(reading) = simulation.next() {
        samples += 1;
        saturated += u64::from(reading.saturated);
        observer.sample(&reading);
        let sample = align::cast(&reading.sample);
        paper.push(&sample);
        if let Some(event) = aligner.step(&sample, T::lit(reading.encoder)) {
            if matches!(event, Event::Aligned) && aligned_at_s.is_none() {
                aligned_at_s = Some(reading.t);
            }
            observer.event(reading.t, &align::describe(&event));
        }
        if samples % per_second == 0
            && let Some(moment) = moment(&aligner, &simulation, reading.t)
        {
            observer.moment(&moment);
        }
        last_reading = Some(reading);
    }
    let coarse = last_reading.and_then(|reading| {
        let (attitude, sd) = paper.solve(aligner.earth(), &setup.unit, reading.encoder)?;
        let error = attitude.minus(&Angles::from_attitude(&simulation.truth().attitude(reading.t)));
        Some(Fix { attitude, sd, error })
    });
    Ok(RunResult {
        scenario: scenario.name.clone(),
        seed,
        method,
        state: align::state_name(&aligner),
        reason: align::reason(&aligner),
        aligned_at_s,
        samples,
        saturated,
        coarse,
        last: last_reading.and_then(|reading| moment(&aligner, &simulation, reading.t)),
    })
}

fn moment<T: Real, const B: usize>(aligner: &Aligner<T, B>, simulation: &Simulation, t: f64) -> Option<Moment> {
    use frames::units::{DEG, DEG_PER_HOUR, MICRO_G};
    let reading = Reading::from_estimate(&aligner.estimate()?);
    let truth = Angles::from_attitude(&simulation.truth().attitude(t));
    let per_axis = |v: Vec3<Sensor, f64>, unit: f64| v.to_array().map(|x| x / unit);
    Some(Moment {
        t_s: t,
        reading,
        truth,
        error: reading.attitude.minus(&truth),
        true_gyro_bias_deg_h: per_axis(simulation.imu().gyro_bias_s(), DEG_PER_HOUR),
        true_accel_bias_ug: per_axis(simulation.imu().accel_bias_s(), MICRO_G),
        rotor_deg: simulation.truth().rotor_angle(t) / DEG,
        innovation_ratio: aligner.innovation().map_or(f64::NAN, |(_, ratio)| ratio.to_f64()),
        state: align::state_name(aligner),
    })
}
