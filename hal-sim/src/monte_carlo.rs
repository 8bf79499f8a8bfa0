//! Many runs of one scenario: what the errors are, and whether the unit knows it.

use frames::units::DEG;
use rayon::prelude::*;
use serde::Serialize;

use crate::align::{Angles, Method};
use crate::bound::{self, BoundConfig};
use crate::scenario::Scenario;
use crate::sensors::run_seed;
use crate::simulate::{self, Fix, Moment, Observer, RunResult, SimulationError};

/// Statistics of one angle over the runs.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Spread {
    /// Mean error, degrees.
    pub mean_deg: f64,
    /// Standard deviation about the mean, degrees.
    pub sd_deg: f64,
    /// Root of the mean square error, degrees.
    pub rms_deg: f64,
    /// Largest magnitude, degrees.
    pub worst_deg: f64,
    /// Root of the mean square of the predicted 1σ, degrees.
    pub predicted_sd_deg: f64,
    /// Mean of (error/σ)²: one where σ is honest.
    pub nees: f64,
}

/// Statistics of an attitude over the runs.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Statistics {
    /// Runs counted.
    pub runs: usize,
    /// Of heading.
    pub heading: Spread,
    /// Of pitch.
    pub pitch: Spread,
    /// Of roll.
    pub roll: Spread,
}

impl Statistics {
    /// Of a set of (error, σ); `None` for an empty one.
    pub fn of(pairs: &[(Angles, Angles)]) -> Option<Self> {
        if pairs.is_empty() {
            return None;
        }
        let spread = |angle: fn(&Angles) -> f64| {
            let n = pairs.len() as f64;
            let mean_of =
                |f: &dyn Fn(f64, f64) -> f64| pairs.iter().map(|(e, s)| f(angle(e), angle(s))).sum::<f64>() / n;
            let mean_deg = mean_of(&|e, _| e);
            let about_mean = mean_of(&|e, _| (e - mean_deg).powi(2)) * n / (n - 1.0).max(1.0);
            Spread {
                mean_deg,
                sd_deg: about_mean.sqrt(),
                rms_deg: mean_of(&|e, _| e * e).sqrt(),
                worst_deg: pairs.iter().map(|(e, _)| angle(e).abs()).fold(0.0, f64::max),
                predicted_sd_deg: mean_of(&|_, s| s * s).sqrt(),
                nees: mean_of(&|e, s| (e / s).powi(2)),
            }
        };
        Some(Self {
            runs: pairs.len(),
            heading: spread(|a| a.heading_deg),
            pitch: spread(|a| a.pitch_deg),
            roll: spread(|a| a.roll_deg),
        })
    }
}

/// Results of a Monte Carlo.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Report {
    /// Scenario by name.
    pub scenario: String,
    /// Number of runs.
    pub runs: u64,
    /// Master seed.
    pub seed: u64,
    /// Length of a run, s.
    pub duration_s: f64,
    /// Heading 1σ that the angle random walk alone leaves, all else known: ARW/(ω_ie cos L √T), degrees.
    pub random_walk_limit_deg: f64,
    /// Heading 1σ of the ideal filter at the end, degrees ([`bound`]). Along the motion of the first run: where phases
    /// and heading are random, the others' differ a little.
    pub bound_deg: f64,
    /// Coarse alignment alone over the whole run (\[Xing18\] §4.1).
    pub coarse: Option<Statistics>,
    /// The unit's estimate at the end, by the first method asked for.
    pub fine: Option<Statistics>,
    /// The same by every method asked for, on the same runs.
    pub by_method: Vec<MethodReport>,
}

/// 1σ of heading at which [`Readiness`] is declared, degrees.
pub const READY_SD_DEG: f64 = 0.5;

/// When a unit that is asked for [`READY_SD_DEG`] would call itself ready, and whether it may: looked at once a second.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Readiness {
    /// Runs that came to it.
    pub runs: usize,
    /// When first, in the mean, s.
    pub mean_s: f64,
    /// When first, in the last of them, s.
    pub last_s: f64,
    /// Runs with a heading error beyond 3σ at that moment.
    pub false_at_first: usize,
    /// Seconds in which they were ready, all runs together.
    pub seconds: usize,
    /// Those of them with a heading error beyond 3σ.
    pub false_seconds: usize,
}

/// How soon heading stays within what standards for gyrocompasses allow, ±1° sec L: from then on to the run's end.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Settling {
    /// ±1° sec L, degrees.
    pub within_deg: f64,
    /// Runs that settle.
    pub runs: usize,
    /// When, in the mean, s.
    pub mean_s: f64,
    /// When, in 95 of 100 of them, s.
    pub most_s: f64,
    /// Largest heading error from ten minutes on, degrees; zero for shorter runs.
    pub later_worst_deg: f64,
    /// RMS of heading from ten minutes on, degrees.
    pub later_rms_deg: f64,
}

/// What happened in one run, once a second.
#[derive(Debug, Default)]
struct Course(Vec<Moment>);

impl Observer for Course {
    fn moment(&mut self, moment: &Moment) {
        self.0.push(*moment);
    }
}

impl Readiness {
    fn of(courses: &[&Course]) -> Option<Self> {
        let ready = |m: &&Moment| m.state == "aligned" && m.reading.sd.heading_deg <= READY_SD_DEG;
        let false_ready = |m: &&Moment| m.error.heading_deg.abs() > 3.0 * m.reading.sd.heading_deg;
        let first: Vec<&Moment> = courses
            .iter()
            .filter_map(|course| course.0.iter().find(ready))
            .collect();
        let seconds = || courses.iter().flat_map(|course| course.0.iter().filter(ready));
        (!first.is_empty()).then(|| Self {
            runs: first.len(),
            mean_s: first.iter().map(|m| m.t_s).sum::<f64>() / first.len() as f64,
            last_s: first.iter().map(|m| m.t_s).fold(0.0, f64::max),
            false_at_first: first.iter().copied().filter(false_ready).count(),
            seconds: seconds().count(),
            false_seconds: seconds().filter(false_ready).count(),
        })
    }
}

impl Settling {
    fn of(courses: &[&Course], latitude_deg: f64) -> Option<Self> {
        const LATER_S: f64 = 600.0;
        let within_deg = 1.0 / (latitude_deg * DEG).cos();
        let outside = |m: &Moment| m.error.heading_deg.abs() > within_deg;
        let mut times: Vec<f64> = courses
            .iter()
            .filter_map(|course| match course.0.iter().rposition(outside) {
                None => course.0.first(),
                Some(last) => course.0.get(last + 1),
            })
            .map(|m| m.t_s)
            .collect();
        times.sort_by(f64::total_cmp);
        let later: Vec<f64> = courses
            .iter()
            .flat_map(|course| course.0.iter().filter(|m| m.t_s >= LATER_S))
            .map(|m| m.error.heading_deg)
            .collect();
        let most_s = *times.get((times.len() * 95).div_ceil(100).saturating_sub(1))?;
        Some(Self {
            within_deg,
            runs: times.len(),
            mean_s: times.iter().sum::<f64>() / times.len() as f64,
            most_s,
            later_worst_deg: later.iter().fold(0.0, |worst, e| worst.max(e.abs())),
            later_rms_deg: (later.iter().map(|e| e * e).sum::<f64>() / later.len().max(1) as f64).sqrt(),
        })
    }
}

/// Results of one method.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct MethodReport {
    /// The fine filter.
    pub method: Method,
    /// Runs that ended aligned.
    pub aligned: usize,
    /// Runs that ended with innovations that do not fit the model: the unit refuses its own result.
    pub inconsistent: usize,
    /// Mean time to aligned, s.
    pub mean_time_to_aligned_s: Option<f64>,
    /// Errors at the end of those that ended aligned.
    pub fine: Option<Statistics>,
    /// Errors at the end of all that had an estimate, refused by the unit or not.
    pub all: Option<Statistics>,
    /// When the unit would be ready at [`READY_SD_DEG`], if ever.
    pub readiness: Option<Readiness>,
    /// How soon heading settles, if it does.
    pub settling: Option<Settling>,
    /// RMS of their heading errors over that of the ideal filter, [`Report::bound_deg`]; n runs scatter it by 1/√(2n).
    pub heading_rms_over_bound: Option<f64>,
    /// Their heading errors, degrees, in the order of the runs; for plots.
    #[serde(skip)]
    pub heading_errors_deg: Vec<f64>,
}

/// Runs `runs` seeds of `scenario` with each method, all cores, the core in f32. `done` is told each finished run.
///
/// The runs are independent and their order does not matter: the result depends on scenario, seed and methods alone.
///
/// # Errors
/// [`SimulationError`] where a figure is out of range.
pub fn run(
    scenario: &Scenario,
    runs: u64,
    seed: u64,
    methods: &[Method],
    done: impl Fn() + Sync,
) -> Result<Report, SimulationError> {
    let results: Vec<Vec<(RunResult, Course)>> = (0..runs)
        .into_par_iter()
        .map(|k| {
            let results = methods
                .iter()
                .map(|method| {
                    let mut course = Course::default();
                    let result = simulate::run::<f32>(scenario, run_seed(seed, k), *method, &mut course)?;
                    Ok((result, course))
                })
                .collect::<Result<Vec<_>, SimulationError>>();
            done();
            results
        })
        .collect::<Result<_, _>>()?;

    let bound = bound::run(scenario, run_seed(seed, 0), &BoundConfig::default())?;
    let bound_deg = bound.end.sd.heading_deg;

    let of_method = |m: usize| {
        results
            .iter()
            .filter_map(move |run| run.get(m))
            .map(|(result, _)| result)
    };
    let courses_of =
        |m: usize| -> Vec<&Course> { results.iter().filter_map(|run| run.get(m)).map(|(_, c)| c).collect() };
    let pair = |fix: &Fix| (fix.error, fix.sd);
    let coarse: Vec<_> = of_method(0).filter_map(|run| run.coarse.as_ref().map(pair)).collect();
    let by_method: Vec<MethodReport> = methods
        .iter()
        .enumerate()
        .map(|(m, method)| {
            let aligned: Vec<_> = of_method(m)
                .filter(|run| run.state == "aligned")
                .filter_map(|run| run.last)
                .collect();
            let times: Vec<f64> = of_method(m).filter_map(|run| run.aligned_at_s).collect();
            let pairs: Vec<_> = aligned.iter().map(|moment| (moment.error, moment.reading.sd)).collect();
            let fine = Statistics::of(&pairs);
            let all: Vec<_> = of_method(m)
                .filter_map(|run| run.last)
                .map(|moment| (moment.error, moment.reading.sd))
                .collect();
            let courses = courses_of(m);
            MethodReport {
                method: *method,
                aligned: aligned.len(),
                inconsistent: of_method(m).filter(|run| run.state == "inconsistent").count(),
                mean_time_to_aligned_s: (!times.is_empty()).then(|| times.iter().sum::<f64>() / times.len() as f64),
                fine,
                all: Statistics::of(&all),
                readiness: Readiness::of(&courses),
                settling: Settling::of(&courses, scenario.place.latitude_deg),
                heading_rms_over_bound: fine
                    .filter(|_| bound_deg > 0.0)
                    .map(|fine| fine.heading.rms_deg / bound_deg),
                heading_errors_deg: aligned.iter().map(|moment| moment.error.heading_deg).collect(),
            }
        })
        .collect();
    Ok(Report {
        scenario: scenario.name.clone(),
        runs,
        seed,
        duration_s: scenario.run.duration_s,
        random_walk_limit_deg: random_walk_limit_deg(scenario),
        bound_deg,
        coarse: Statistics::of(&coarse),
        fine: by_method.first().and_then(|m| m.fine),
        by_method,
    })
}

/// ARW/(ω_ie cos L √T), degrees: what no filter can do better than, however well all else is known.
pub fn random_walk_limit_deg(scenario: &Scenario) -> f64 {
    bound::random_walk_limit_deg(scenario, scenario.run.duration_s)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_report_carries_the_ideal_filter() {
        let scenario = Scenario::builtin("paper-sim").unwrap();
        let report = run(&scenario, 24, 5, &[Method::Kf, Method::Stf], || ()).unwrap();
        assert!((report.bound_deg / 0.352 - 1.0).abs() < 0.01, "{}", report.bound_deg);
        assert!(report.random_walk_limit_deg < report.bound_deg);
        for method in &report.by_method {
            let ratio = method.heading_rms_over_bound.unwrap();
            assert_eq!(ratio, method.fine.unwrap().heading.rms_deg / report.bound_deg);
            // Both filters are ideal here, and 24 runs scatter their RMS by 14 %.
            assert!((0.65..1.35).contains(&ratio), "{ratio}");
        }
        // Nothing aligned, nothing to compare.
        let mut short = scenario;
        short.run.duration_s = 20.0;
        let report = run(&short, 2, 5, &[Method::Kf], || ()).unwrap();
        assert!(report.bound_deg > 1.0);
        assert_eq!(report.by_method[0].heading_rms_over_bound, None);
    }
}
