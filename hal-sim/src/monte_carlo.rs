//! Many runs of one scenario: what the errors are, and whether the unit knows it.

use rayon::prelude::*;
use serde::Serialize;

use crate::align::{Angles, Method};
use crate::bound::{self, BoundConfig};
use crate::scenario::Scenario;
use crate::sensors::run_seed;
use crate::simulate::{self, Fix, RunResult, SimulationError};

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
    pub normalised_squared: f64,
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
                normalised_squared: mean_of(&|e, s| (e / s).powi(2)),
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
    let results: Vec<Vec<RunResult>> = (0..runs)
        .into_par_iter()
        .map(|k| {
            let results = methods
                .iter()
                .map(|method| simulate::run::<f32>(scenario, run_seed(seed, k), *method, &mut ()))
                .collect::<Result<Vec<_>, _>>();
            done();
            results
        })
        .collect::<Result<_, _>>()?;

    let bound = bound::run(scenario, run_seed(seed, 0), &BoundConfig::default())?;
    let bound_deg = bound.end.sd.heading_deg;

    let of_method = |m: usize| results.iter().filter_map(move |run| run.get(m));
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
            MethodReport {
                method: *method,
                aligned: aligned.len(),
                inconsistent: of_method(m).filter(|run| run.state == "inconsistent").count(),
                mean_time_to_aligned_s: (!times.is_empty()).then(|| times.iter().sum::<f64>() / times.len() as f64),
                fine,
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
