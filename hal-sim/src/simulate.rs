//! One simulated run: truth, sensors, and the unit's core on their samples.

use frames::units::{DEG, DEG_PER_HOUR, MICRO_G};
use frames::{Real, Sensor, Vec3};
use nav::aligner::{Aligner, AlignerError, Event};
use nav::calibration::{Calibration, CalibrationConfig, CalibrationError, Calibrator};
use nav::coarse::{Coarse, CoarsePoint, CoarseSolution};
use nav::earth::Earth;
use nav::increment::{ConingScullingCorrector, Decimator, Sample};
use nav::model::{PAPER, ROBUST};
use serde::Serialize;

use crate::align::{self, Angles, Method, Reading, Setup};
use crate::config::Violation;
use crate::scenario::{Scenario, Sea, Sway, Swing};
use crate::sensors::{Encoder, Imu};
use crate::truth::Truth;

/// Why a simulation cannot run.
#[derive(Debug, Clone, PartialEq)]
pub enum SimulationError {
    /// The scenario has a figure out of range.
    Scenario(Violation),
    /// The aligner refuses its configuration.
    Aligner(AlignerError),
    /// The gyros could not be calibrated before the run.
    Calibration(CalibrationError),
}

impl core::fmt::Display for SimulationError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            Self::Scenario(e) => e.fmt(f),
            Self::Aligner(e) => e.fmt(f),
            Self::Calibration(e) => write!(f, "calibration before the run: {e}"),
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

impl From<CalibrationError> for SimulationError {
    fn from(e: CalibrationError) -> Self {
        Self::Calibration(e)
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
    /// Temperature of the IMU at the end, °C.
    pub temperature_c: f64,
}

/// The measured samples of one run, in order. An iterator: a run of any length takes no memory.
#[derive(Debug, Clone)]
pub struct Simulation {
    scenario: Scenario,
    truth: Truth,
    imu: Imu,
    encoder: Encoder,
    calibration: Option<Calibration<f64>>,
    next: u64,
}

impl Simulation {
    /// The run of this scenario with this seed; calibrated, where the scenario says so.
    ///
    /// # Errors
    /// [`SimulationError::Scenario`] where a figure of the scenario is out of range,
    /// [`SimulationError::Calibration`] where the gyros cannot be calibrated.
    pub fn new(scenario: &Scenario, seed: u64) -> Result<Self, SimulationError> {
        let truth = Truth::new(scenario, seed)?;
        let encoder = Encoder::new(scenario);
        let (imu, calibration) = if scenario.run.calibration_s > 0.0 {
            let (imu, calibration) = calibrated(scenario, &encoder, seed)?;
            (imu, Some(calibration))
        } else {
            (Imu::new(scenario, seed), None)
        };
        Ok(Self {
            truth,
            imu,
            encoder,
            calibration,
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

    /// What has been calibrated before the run.
    pub fn calibration(&self) -> Option<&Calibration<f64>> {
        self.calibration.as_ref()
    }

    /// Bias of the gyros as it is in the samples now, rad/s: without what has been calibrated.
    pub fn gyro_bias_s(&self) -> Vec3<Sensor, f64> {
        let found = self.calibration.map_or(Vec3::zero(), |calibration| calibration.bias_s);
        self.imu.gyro_bias_s() - found
    }
}

/// The scenario's IMU after a calibration on a base at rest, its attitude known; the run's noise goes on from there.
fn calibrated(scenario: &Scenario, encoder: &Encoder, seed: u64) -> Result<(Imu, Calibration<f64>), SimulationError> {
    let mut resting = scenario.clone();
    resting.run.calibration_s = 0.0;
    let Swing { pitch, roll, heading } = &mut resting.swing;
    for axis in [pitch, roll, heading] {
        axis.amplitude_deg = 0.0;
    }
    resting.sway = Sway::default();
    resting.sea = Sea::default();
    let turning = Truth::new(&resting, seed)?;
    let period = turning.rotation().period();
    resting.rotor.rate_dps = 0.0;
    let resting = Truth::new(&resting, seed)?;

    let rate_hz = scenario.run.rate_hz;
    let count = |seconds: f64| (seconds * rate_hz).ceil() as u64;
    let rest = count(scenario.run.calibration_s);
    let turn = count((scenario.run.calibration_s / period).ceil() * period);
    // Steps of the bias are timed from the run's start.
    let mut delayed = scenario.clone();
    delayed.errors.gyro_step_at_s += (rest + 1 + turn) as f64 / rate_hz;
    let mut imu = Imu::new(&delayed, seed);

    let noise = align::noise::<f64>(&Setup::of(scenario, Method::Kf).unit);
    let mut calibrator = Calibrator::new(CalibrationConfig {
        angle_random_walk: noise.angle_random_walk,
        instability: noise.gyro_instability_sd,
        rest: scenario.run.calibration_s,
        turn: core::f64::consts::TAU.min(turning.rotation().travel()),
        w_ie_b: Some(resting.c_nb(0.0).inverse() * resting.w_ie_n()),
        ..CalibrationConfig::default()
    })?;
    let late = scenario.errors.imu_delay_ms * 1e-3;
    let mut measure = |truth: &Truth, k: u64| {
        let (t0, t) = (scenario.time(k - 1), scenario.time(k));
        let dt = t - t0;
        let (dtheta_s, dv_s) = exact(truth, &mut imu, t0 - late, t - late);
        let measured = imu.measure(dtheta_s, dv_s, dt);
        let sample = Sample {
            dtheta_s: measured.dtheta_s,
            dv_s: measured.dv_s,
            dt,
            gap: 0.0,
        };
        (sample, encoder.measure(truth.rotor_angle(t)))
    };
    // Of the first sample only the reading is used.
    for k in 1..=rest + 1 {
        let (sample, reading) = measure(&resting, k);
        calibrator.rest(&sample, reading)?;
    }
    for k in 1..=turn {
        let (sample, reading) = measure(&turning, k);
        calibrator.turn(&sample, reading)?;
    }
    let calibration = calibrator.finish()?;
    Ok((imu, calibration))
}

/// The exact increments from `t0` to `t1`, s, with the IMU told where the rotor is in between.
fn exact(truth: &Truth, imu: &mut Imu, t0: f64, t1: f64) -> (Vec3<Sensor, f64>, Vec3<Sensor, f64>) {
    imu.rotor_at(truth.rotor_angle(0.5 * (t0 + t1)));
    truth.increment(t0, t1)
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
        let dt = t - t0;
        let late = self.scenario.errors.imu_delay_ms * 1e-3;
        let (dtheta_s, dv_s) = exact(&self.truth, &mut self.imu, t0 - late, t - late);
        let measured = self.imu.measure(dtheta_s, dv_s, dt);
        let sample = Sample {
            dtheta_s: measured.dtheta_s,
            dv_s: measured.dv_s,
            dt,
            gap: 0.0,
        };
        Some(Row {
            t,
            sample: self
                .calibration
                .map_or(sample, |calibration| calibration.corrected(&sample)),
            encoder: self.encoder.measure(self.truth.rotor_angle(t)),
            saturated: measured.saturated,
            temperature_c: measured.temperature_c,
        })
    }
}

/// Coarse alignment alone as in \[Xing18\] §5.1, beside the unit's own: pairs of times over the whole run, attitude at
/// its end.
#[derive(Debug, Clone)]
struct PaperCoarse<T: Real> {
    corrector: ConingScullingCorrector<T>,
    decimator: Decimator<T>,
    coarse: Coarse<T>,
    /// The times asked for, s, and the integrals at each.
    points: Vec<(f64, Option<CoarsePoint<T>>)>,
}

impl<T: Real> PaperCoarse<T> {
    fn new(times: impl IntoIterator<Item = f64>) -> Self {
        Self {
            corrector: ConingScullingCorrector::new(),
            decimator: Decimator::new(T::lit(0.05)),
            coarse: Coarse::new(),
            points: times.into_iter().map(|t| (t, None)).collect(),
        }
    }

    fn push(&mut self, sample: &Sample<T>) {
        let increment = self.corrector.increment(sample);
        let Some(joined) = self.decimator.push(&increment) else {
            return;
        };
        self.coarse.push(&joined);
        let t = self.coarse.t().to_f64() + 1e-3;
        for (at, point) in &mut self.points {
            if point.is_none() && t >= *at {
                *point = Some(self.coarse.point());
            }
        }
    }

    /// Attitude of the housing and its predicted σ, by two of the times asked for; `None` where the run was too short or
    /// the geometry does not allow it.
    fn solve(
        &self,
        (first, second): (usize, usize),
        earth: &Earth<T>,
        unit: &crate::unit::Unit,
        alpha: f64,
    ) -> Option<(Angles, Angles)> {
        let point = |k: usize| self.points.get(k).and_then(|(_, point)| *point);
        let solution = CoarseSolution::solve(point(first)?, point(second)?, earth).ok()?;
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

/// Coarse alignment alone (\[Xing18\] (7)–(18)) over one run, by several pairs of times t_k1, t_k2 (s): the attitude at
/// the run's end by each, `None` where there is none.
///
/// # Errors
/// [`SimulationError`] where a figure is out of range.
pub fn coarse<T: Real>(
    scenario: &Scenario,
    seed: u64,
    pairs: &[(f64, f64)],
) -> Result<Vec<Option<Fix>>, SimulationError> {
    let mut simulation = Simulation::new(scenario, seed)?;
    let setup = Setup::of(scenario, Method::Kf);
    let earth = Earth::new(T::lit(setup.latitude_deg * DEG), T::lit(setup.height_m)).map_err(AlignerError::Earth)?;
    let mut paper = PaperCoarse::<T>::new(pairs.iter().flat_map(|(first, second)| [*first, *second]));
    let mut end = None;
    for reading in simulation.by_ref() {
        paper.push(&align::cast(&reading.sample));
        end = Some((reading.t, reading.encoder));
    }
    let Some((t, encoder)) = end else {
        return Ok(vec![None; pairs.len()]);
    };
    let truth = Angles::from_attitude(&simulation.truth().attitude(t));
    let fix = |k: usize| {
        let (attitude, sd) = paper.solve((2 * k, 2 * k + 1), &earth, &setup.unit, encoder)?;
        let error = attitude.minus(&truth);
        Some(Fix { attitude, sd, error })
    };
    Ok((0..pairs.len()).map(fix).collect())
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

/// What became of the samples of a run.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
pub struct Samples {
    /// Taken.
    pub received: u64,
    /// With a sensor at the end of its range.
    pub saturated: u64,
}

/// How a run ended. In JSON it has the keys of an [`Outcome`](crate::outcome::Outcome) besides.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct RunResult {
    /// Scenario by name.
    pub scenario: String,
    /// Seed of the run.
    pub seed: u64,
    /// The fine filter.
    pub method: Method,
    /// `aligned`, or where the aligner stood.
    #[serde(skip)]
    pub state: &'static str,
    /// Why it is not aligned.
    #[serde(skip)]
    pub reason: Option<String>,
    /// Time of the last sample, s.
    #[serde(skip)]
    pub t_s: Option<f64>,
    /// When it first was, s.
    #[serde(skip)]
    pub aligned_at_s: Option<f64>,
    /// What became of the samples.
    pub samples: Samples,
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
    let mut paper = PaperCoarse::<T>::new(<[f64; 2]>::from(scenario.coarse_times()));
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
        let (attitude, sd) = paper.solve((0, 1), aligner.earth(), &setup.unit, reading.encoder)?;
        let error = attitude.minus(&Angles::from_attitude(&simulation.truth().attitude(reading.t)));
        Some(Fix { attitude, sd, error })
    });
    Ok(RunResult {
        scenario: scenario.name.clone(),
        seed,
        method,
        state: align::state_name(&aligner),
        reason: align::reason(&aligner),
        t_s: last_reading.map(|reading| reading.t),
        aligned_at_s,
        samples: Samples {
            received: samples,
            saturated,
        },
        coarse,
        last: last_reading.and_then(|reading| moment(&aligner, &simulation, reading.t)),
    })
}

fn moment<T: Real, const B: usize>(aligner: &Aligner<T, B>, simulation: &Simulation, t: f64) -> Option<Moment> {
    let reading = Reading::from_estimate(&aligner.estimate()?);
    let truth = Angles::from_attitude(&simulation.truth().attitude(t));
    let per_axis = |v: Vec3<Sensor, f64>, unit: f64| v.to_array().map(|x| x / unit);
    Some(Moment {
        t_s: t,
        reading,
        truth,
        error: reading.attitude.minus(&truth),
        true_gyro_bias_deg_h: per_axis(simulation.gyro_bias_s(), DEG_PER_HOUR),
        true_accel_bias_ug: per_axis(simulation.imu().accel_bias_s(), MICRO_G),
        rotor_deg: simulation.truth().rotor_angle(t) / DEG,
        innovation_ratio: aligner.innovation().map_or(f64::NAN, |(_, ratio)| ratio.to_f64()),
        state: align::state_name(aligner),
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scenario::RotorAxis;

    fn paper(toml: &str) -> Scenario {
        let text = format!("{}\n{toml}", Scenario::builtin_text("paper-sim").unwrap());
        Scenario::parse(&text, "test").unwrap()
    }

    #[test]
    fn coarse_alone_is_that_of_a_run() {
        let scenario = paper("");
        let of_run = run::<f32>(&scenario, 3, Method::Kf, &mut ()).unwrap().coarse.unwrap();
        let alone = coarse::<f32>(&scenario, 3, &[(20.0, 299.0), (50.0, 250.0), (50.0, 301.0)]).unwrap();
        assert_eq!(alone[1], Some(of_run));
        assert!(alone[0].is_some_and(|fix| fix != of_run));
        assert_eq!(alone[2], None, "the run has 300 s");
    }

    #[test]
    fn every_scenario_draws_the_errors_of_every_part() {
        for name in Scenario::builtin_names() {
            for part in &app::parts::PARTS {
                let mut scenario = Scenario::builtin(name).unwrap();
                scenario.imu = crate::unit::Unit::of_part(part);
                scenario.told = None;
                // Known errors are not the part's.
                scenario.errors = crate::scenario::Errors::default();
                scenario.run.duration_s = 0.5;
                assert_eq!(Setup::of(&scenario, Method::Robust).unit, scenario.imu);
                let mut simulation = Simulation::new(&scenario, 1).unwrap();
                assert!(simulation.by_ref().all(|row| row.sample.dtheta_s.norm().is_finite()));
                let (imu, unit) = (simulation.imu(), &scenario.imu);
                for (drawn, told) in [
                    (imu.gyro_matrix().diagonal().norm(), unit.gyro_scale_factor_sd_ppm),
                    (imu.gyro_matrix()[(0, 2)].abs(), unit.gyro_misalignment_sd_arcmin),
                    (imu.accel_matrix().diagonal().norm(), unit.accel_scale_factor_sd_ppm),
                    (imu.accel_matrix()[(0, 2)].abs(), unit.accel_misalignment_sd_arcmin),
                    (imu.g_sensitivity().norm(), unit.gyro_g_sensitivity_sd_deg_h_g),
                    (imu.gyro_housing_b().norm(), unit.gyro_housing_sd_deg_h),
                    (imu.gyro_bias_s().norm(), unit.gyro_bias_sd_deg_h),
                    (imu.accel_bias_s().norm(), unit.accel_bias_sd_ug),
                ] {
                    assert_eq!(drawn > 0.0, told > 0.0, "{name}, {}", part.name);
                }
            }
        }
    }

    #[test]
    fn a_rotor_along_any_axis_finds_north_without_errors() {
        for axis in [RotorAxis::X, RotorAxis::Y, RotorAxis::Z] {
            let mut scenario = paper("");
            scenario.imu = crate::unit::Unit::perfect();
            scenario.rotor.axis = axis;
            let fix = coarse::<f64>(&scenario, 1, &[(50.0, 250.0)]).unwrap()[0].unwrap();
            // Coning of 100 Hz samples is left.
            let Angles {
                heading_deg,
                pitch_deg,
                roll_deg,
            } = fix.error;
            assert!(heading_deg.abs() < 0.01, "{axis:?}: {heading_deg}");
            assert!(
                pitch_deg.abs().max(roll_deg.abs()) < 1e-3,
                "{axis:?}: {pitch_deg} {roll_deg}"
            );
        }
    }

    #[test]
    fn calibration_takes_out_biases_and_what_the_rotor_adds() {
        let mut scenario = paper("[errors]\ngyro_step_deg_h = [50, 0, 0]\ngyro_step_at_s = 1.0\n");
        scenario.imu.gyro_misalignment_sd_arcmin = 3.0;
        scenario.imu.gyro_scale_factor_sd_ppm = 500.0;
        scenario.run.calibration_s = 60.0;
        let (mut biases, mut column) = (0.0, 0.0);
        for seed in 0..20 {
            let mut simulation = Simulation::new(&scenario, seed).unwrap();
            let calibration = *simulation.calibration().unwrap();
            biases += (simulation.gyro_bias_s() / DEG_PER_HOUR).vector().norm_squared() / 60.0;
            let m = simulation.imu().gyro_matrix();
            let left = [
                calibration.k_xz - m[(0, 2)],
                calibration.k_yz - m[(1, 2)],
                calibration.s_z - m[(2, 2)],
            ];
            column += left.iter().map(|x| x * x).sum::<f64>() / 60.0;
            // The step is counted from the run's start.
            let bias = |simulation: &Simulation| simulation.gyro_bias_s().x() / DEG_PER_HOUR;
            let before = bias(&simulation);
            assert!(simulation.nth(98).is_some());
            assert!((bias(&simulation) - before).abs() < 1e-9);
            assert!(simulation.nth(1).is_some());
            assert!((bias(&simulation) - before - 50.0).abs() < 1e-9);
        }
        // ARW/√(60 s + 72.4 s) is 0.10 °/h; ARW √72.4 s / 1440° is 2.0 ppm ([Du16] (36)), and misalignments of 3' on
        // Earth's 15 °/h leave 0.01 °/h. 60 draws scatter their RMS by 9 %.
        assert!((0.07..0.14).contains(&biases.sqrt()), "{}", biases.sqrt());
        assert!((1.3e-6..3e-6).contains(&column.sqrt()), "{:e}", column.sqrt());
    }

    #[test]
    fn calibration_without_a_rotor_is_refused() {
        let text = "[run]\ncalibration_s = 60\n[rotor]\nrate_dps = 0";
        assert_eq!(
            Scenario::parse(text, "s.toml").unwrap_err().to_string(),
            "s.toml:2: run.calibration_s: a calibration needs a rotor that turns"
        );
    }
}
