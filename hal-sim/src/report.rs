//! Report folders: a page to read, JSON, CSV and plots of a run, a Monte Carlo or a bound.

pub mod page;

use std::fs;
use std::io;
use std::path::{Path, PathBuf};

use serde::Serialize;

use crate::align::{Angles, Reading, Setup};
use crate::bound::{self, Bound, BoundConfig, Sigmas};
use crate::config::Violation;
use crate::monte_carlo::{self, MethodReport, Spread, Statistics};
use crate::outcome::{alignment, tagged};
use crate::plot::{self, PlotError};
use crate::replay::{self, Replay};
use crate::scenario::Scenario;
use crate::simulate::{Moment, RunResult};
use page::{Page, Plot, Tone};

/// Why a report could not be written.
#[derive(Debug)]
pub enum ReportError {
    /// A file or folder.
    Io(PathBuf, io::Error),
    /// A plot.
    Plot(PathBuf, PlotError),
    /// The ideal filter has none of this scenario.
    Ideal(Violation),
    /// The scenario cannot be written as TOML.
    Settings(toml::ser::Error),
}

/// Where a report comes from.
#[derive(Debug, Clone, Copy)]
pub struct Origin<'a> {
    /// What was simulated, with all that the command line changed in it.
    pub scenario: &'a Scenario,
    /// The command that makes it again.
    pub command: &'a str,
}

impl core::fmt::Display for ReportError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            Self::Io(path, e) => write!(f, "cannot write {}: {e}", path.display()),
            Self::Plot(path, e) => write!(f, "cannot draw {}: {e}", path.display()),
            Self::Ideal(e) => write!(f, "no ideal filter for the report: {e}"),
            Self::Settings(e) => write!(f, "no settings for the report: {e}"),
        }
    }
}

impl core::error::Error for ReportError {}

fn json(path: PathBuf, value: &impl Serialize) -> Result<(), ReportError> {
    let write = || -> io::Result<()> {
        let mut text = serde_json::to_string_pretty(value)?;
        text.push('\n');
        fs::write(&path, text)
    };
    write().map_err(|e| ReportError::Io(path.clone(), e))
}

/// Draws a plot, into its file and for the page.
fn drawn(
    dir: &Path,
    file: &str,
    caption: &str,
    draw: impl Fn(plot::Width) -> Result<plot::Svg, PlotError>,
) -> Result<Plot, ReportError> {
    let path = dir.join(file);
    let drawn = Plot::draw(file, caption, draw).and_then(|plot| plot.svg().save(&path).map(|()| plot));
    drawn.map_err(|e| ReportError::Plot(path, e))
}

/// Ends the page with where it comes from, and writes it as `report.html`.
fn finished(dir: &Path, mut page: Page, origin: &Origin<'_>) -> Result<(), ReportError> {
    page.section("Made by");
    page.code(origin.command);
    let settings = toml::to_string_pretty(origin.scenario).map_err(ReportError::Settings)?;
    page.folded(
        "The scenario with all its settings, a TOML file for --scenario",
        &settings,
    );
    written(dir, &page)
}

pub(crate) fn written(dir: &Path, page: &Page) -> Result<(), ReportError> {
    let path = dir.join("report.html");
    fs::write(&path, page.html()).map_err(|e| ReportError::Io(path, e))
}

/// A figure as a table has it.
fn fixed(x: f64, decimals: usize) -> String {
    format!("{x:.decimals$}").replace('-', "−")
}

/// The same with its sign: an error.
fn signed(x: f64, decimals: usize) -> String {
    format!("{x:+.decimals$}").replace('-', "−")
}

fn folder(path: &Path) -> Result<(), ReportError> {
    fs::create_dir_all(path).map_err(|e| ReportError::Io(path.to_owned(), e))
}

/// One row a second of a run's estimates.
fn csv(path: PathBuf, moments: &[Moment]) -> Result<(), ReportError> {
    let write = || -> Result<(), csv::Error> {
        let mut out = csv::Writer::from_path(&path)?;
        out.write_record([
            "t_s",
            "rotor_deg",
            "heading_deg",
            "pitch_deg",
            "roll_deg",
            "heading_error_deg",
            "pitch_error_deg",
            "roll_error_deg",
            "heading_sd_deg",
            "pitch_sd_deg",
            "roll_sd_deg",
            "gyro_bias_x_deg_h",
            "gyro_bias_y_deg_h",
            "gyro_bias_z_deg_h",
            "true_gyro_bias_x_deg_h",
            "true_gyro_bias_y_deg_h",
            "true_gyro_bias_z_deg_h",
            "accel_bias_x_ug",
            "accel_bias_y_ug",
            "accel_bias_z_ug",
            "innovation_ratio",
        ])?;
        for m in moments {
            let Moment { reading, error, .. } = m;
            let mut row = vec![m.t_s, m.rotor_deg];
            for angles in [&reading.attitude, error, &reading.sd] {
                row.extend([angles.heading_deg, angles.pitch_deg, angles.roll_deg]);
            }
            row.extend(reading.gyro_bias_deg_h);
            row.extend(m.true_gyro_bias_deg_h);
            row.extend(reading.accel_bias_ug);
            row.push(m.innovation_ratio);
            out.write_record(row.iter().map(|x| format!("{x:.6}")))?;
        }
        out.flush()?;
        Ok(())
    };
    write().map_err(|e| ReportError::Io(path.clone(), e.into()))
}

/// Writes `report.html`, `result.json`, `estimates.csv`, `attitude-error.svg`, `gyro-bias.svg` and `rotor.svg` into
/// `dir`.
///
/// # Errors
/// [`ReportError`] names the file.
pub fn run(
    dir: &Path,
    origin: &Origin<'_>,
    result: &RunResult,
    moments: &[Moment],
    rotor: &[(f64, f64)],
) -> Result<(), ReportError> {
    folder(dir)?;
    json(dir.join("result.json"), &alignment(result))?;
    csv(dir.join("estimates.csv"), moments)?;
    let ideal = bound::run(origin.scenario, result.seed, &BoundConfig::default()).map_err(ReportError::Ideal)?;
    let mut page = Page::new(
        &format!("Alignment in {}, seed {}", result.scenario, result.seed),
        &origin.scenario.description,
    );
    let (tone, word, sentence) = run_verdict(result, &ideal.end);
    page.verdict(tone, word, &sentence);
    page.section("Result");
    if let Some(last) = &result.last {
        page.table(
            &format!(
                "After {} s, by the filter {}; error is estimate − truth",
                last.t_s,
                result.method.name()
            ),
            &["", "estimate", "error", "σ", "ideal σ"],
            &run_rows(last, &ideal.end),
        );
        page.paragraph("Ideal: σ of a filter that is told everything but the noise, and zero velocity once a second.");
    }
    if let Some(coarse) = &result.coarse {
        page.paragraph(&format!(
            "Coarse alignment alone, over the whole run: heading error {}°, σ {}°.",
            signed(coarse.error.heading_deg, 3),
            fixed(coarse.sd.heading_deg, 3)
        ));
    }
    page.paragraph(&format!(
        "{} samples at {} Hz, {} with a sensor at the end of its range.",
        result.samples.received, origin.scenario.run.rate_hz, result.samples.saturated
    ));
    page.section("Course");
    for plot in [
        drawn(
            dir,
            "attitude-error.svg",
            "Attitude errors over time, and what the filter says of them: outside the band in 3 seconds of 1000, where it is right.",
            |width| plot::attitude_error(width, moments),
        ),
        drawn(
            dir,
            "gyro-bias.svg",
            "Gyro biases in the axes of the sensor. A tilted or turning unit sees them; what it has not yet seen, has a wide band.",
            |width| plot::biases(width, moments),
        ),
        drawn(
            dir,
            "rotor.svg",
            "Rotor angle against the housing: it goes back and forth, so that a bias averages out and Earth's rate stays.",
            |width| plot::rotor(width, rotor),
        ),
    ] {
        page.plot(&plot?);
    }
    finished(dir, page, origin)
}

/// What a run has come to.
fn run_verdict(result: &RunResult, ideal: &Sigmas) -> (Tone, &'static str, String) {
    let (Some(last), Some(aligned_s), None) = (&result.last, result.aligned_at_s, &result.reason) else {
        let reason = result.reason.as_deref().unwrap_or("no estimate");
        return (Tone::Bad, "Not aligned:", format!("{} ({reason}).", result.state));
    };
    let (error, sd) = (last.error.heading_deg, last.reading.sd.heading_deg);
    let ratio = error.abs() / sd;
    let (tone, word) = if ratio <= 3.0 {
        (Tone::Good, "Aligned")
    } else {
        (Tone::Bad, "Aligned, but wrong,")
    };
    let sentence = format!(
        "after {aligned_s:.1} s. After {} s heading is off by {}°: {ratio:.1} times its σ of {sd:.3}°, and the ideal \
         filter's is {:.3}°.",
        last.t_s,
        signed(error, 3),
        ideal.sd.heading_deg
    );
    (tone, word, sentence)
}

fn run_rows(last: &Moment, ideal: &Sigmas) -> Vec<Vec<String>> {
    let Moment { reading, error, .. } = last;
    let mut rows: Vec<Vec<String>> = Vec::new();
    for (name, of) in Angles::NAMED {
        rows.push(vec![
            name.to_owned(),
            fixed(of(&reading.attitude), 4),
            signed(of(error), 4),
            fixed(of(&reading.sd), 4),
            fixed(of(&ideal.sd), 4),
        ]);
    }
    let biases = [
        (
            "gyro",
            "°/h",
            last.true_gyro_bias_deg_h,
            reading.gyro_bias_deg_h,
            reading.gyro_bias_sd_deg_h,
            ideal.gyro_bias_sd_deg_h,
        ),
        (
            "accel",
            "µg",
            last.true_accel_bias_ug,
            reading.accel_bias_ug,
            reading.accel_bias_sd_ug,
            ideal.accel_bias_sd_ug,
        ),
    ];
    for (sensor, unit, truth, found, sd, ideal) in biases {
        for (axis, name) in ["x", "y", "z"].into_iter().enumerate() {
            rows.push(vec![
                format!("{sensor} {name} ({unit})"),
                fixed(found[axis], 2),
                signed(found[axis] - truth[axis], 2),
                fixed(sd[axis], 2),
                fixed(ideal[axis], 2),
            ]);
        }
    }
    rows
}

/// Where the report of a replay comes from.
#[derive(Debug, Clone, Copy)]
pub struct Replayed<'a> {
    /// The log's name.
    pub log: &'a str,
    /// What the aligner was told at the beginning.
    pub setup: &'a Setup,
    /// The command that makes it again.
    pub command: &'a str,
}

/// Writes `report.html`, `result.json`, `estimates.csv`, `attitude.svg`, `innovations.svg`, `biases.svg` and `rotor.svg` into
/// `dir`.
///
/// # Errors
/// [`ReportError`] names the file.
pub fn replay(
    dir: &Path,
    origin: &Replayed<'_>,
    result: &Replay,
    moments: &[replay::Moment],
) -> Result<(), ReportError> {
    folder(dir)?;
    json(dir.join("result.json"), &alignment(result))?;
    replay_csv(dir.join("estimates.csv"), moments)?;
    let Setup {
        latitude_deg,
        height_m,
        unit,
        method,
        ..
    } = origin.setup;
    let place = format!(
        "At latitude {latitude_deg}°, height {height_m} m, by the filter {}.",
        method.name()
    );
    let mut page = Page::new(&format!("Replay of {}", origin.log), &place);
    match (result.heading_deg.zip(result.heading_sd_deg), &result.reason) {
        (Some((heading, sd)), None) => page.verdict(
            Tone::Good,
            "Aligned.",
            &format!(
                "Heading at {} s: {}°, σ {}°.",
                result.t_s,
                fixed(heading, 3),
                fixed(sd, 3)
            ),
        ),
        (_, reason) => page.verdict(
            Tone::Bad,
            "Not aligned:",
            &format!("{} ({}).", result.state, reason.as_deref().unwrap_or("no estimate")),
        ),
    }
    if let Some(last) = moments.last() {
        page.section("Result");
        page.table(
            &format!("After {} s", fixed(last.t_s, 1)),
            &["", "estimate", "σ"],
            &reading_rows(&last.reading),
        );
        page.section("Course");
        let rotor: Vec<_> = moments.iter().map(|m| (m.t_s, m.rotor_deg)).collect();
        for plot in [
            drawn(
                dir,
                "attitude.svg",
                "Attitude of the housing over time, once a second.",
                |width| plot::attitude(width, moments),
            ),
            drawn(
                dir,
                "innovations.svg",
                "Innovations against what the filter expects of them: one in the mean where its model holds.",
                |width| plot::innovations(width, moments),
            ),
            drawn(
                dir,
                "biases.svg",
                "Biases in the axes of the sensor. What has not yet been seen has a wide band.",
                |width| plot::biases_found(width, moments),
            ),
            drawn(
                dir,
                "rotor.svg",
                "Rotor angle against the housing, once a second.",
                |width| plot::rotor(width, &rotor),
            ),
        ] {
            page.plot(&plot?);
        }
    }
    page.section("Made by");
    page.code(origin.command);
    page.folded(
        "The figures of the IMU, a TOML file for --unit",
        &unit.to_toml().map_err(ReportError::Settings)?,
    );
    written(dir, &page)
}

/// Name, estimate and σ of every figure of a reading.
fn reading_rows(reading: &Reading) -> Vec<Vec<String>> {
    let mut rows: Vec<Vec<String>> = Vec::new();
    for (name, of) in Angles::NAMED {
        rows.push(vec![
            name.to_owned(),
            fixed(of(&reading.attitude), 4),
            fixed(of(&reading.sd), 4),
        ]);
    }
    for (sensor, unit, found, sd) in [
        ("gyro", "°/h", reading.gyro_bias_deg_h, reading.gyro_bias_sd_deg_h),
        ("accel", "µg", reading.accel_bias_ug, reading.accel_bias_sd_ug),
    ] {
        for (axis, name) in ["x", "y", "z"].into_iter().enumerate() {
            rows.push(vec![
                format!("{sensor} {name} ({unit})"),
                fixed(found[axis], 2),
                fixed(sd[axis], 2),
            ]);
        }
    }
    rows
}

/// One row a second of a replay's estimates.
fn replay_csv(path: PathBuf, moments: &[replay::Moment]) -> Result<(), ReportError> {
    let write = || -> Result<(), csv::Error> {
        let mut out = csv::Writer::from_path(&path)?;
        let axes = |name: &'static str, unit: &'static str| ["x", "y", "z"].map(|axis| format!("{name}_{axis}_{unit}"));
        let mut header: Vec<String> = [
            "t_s",
            "rotor_deg",
            "heading_deg",
            "pitch_deg",
            "roll_deg",
            "heading_sd_deg",
            "pitch_sd_deg",
            "roll_sd_deg",
        ]
        .map(str::to_owned)
        .into();
        header.extend(axes("gyro_bias", "deg_h"));
        header.extend(axes("gyro_bias_sd", "deg_h"));
        header.extend(axes("accel_bias", "ug"));
        header.extend(axes("accel_bias_sd", "ug"));
        header.extend(["innovation", "innovation_ratio"].map(str::to_owned));
        out.write_record(&header)?;
        for m in moments {
            let mut row = vec![m.t_s, m.rotor_deg];
            for angles in [&m.reading.attitude, &m.reading.sd] {
                row.extend([angles.heading_deg, angles.pitch_deg, angles.roll_deg]);
            }
            row.extend(m.reading.gyro_bias_deg_h);
            row.extend(m.reading.gyro_bias_sd_deg_h);
            row.extend(m.reading.accel_bias_ug);
            row.extend(m.reading.accel_bias_sd_ug);
            row.extend([m.innovation, m.innovation_ratio]);
            out.write_record(row.iter().map(|x| format!("{x:.6}")))?;
        }
        out.flush()?;
        Ok(())
    };
    write().map_err(|e| ReportError::Io(path.clone(), e.into()))
}

/// Writes `report.html`, `result.json` and a heading histogram for each method into `dir`.
///
/// # Errors
/// [`ReportError`] names the file.
pub fn monte_carlo(dir: &Path, origin: &Origin<'_>, report: &monte_carlo::Report) -> Result<(), ReportError> {
    folder(dir)?;
    json(dir.join("result.json"), &tagged("monte-carlo", report))?;
    let mut page = Page::new(
        &format!("{} runs of {}, seed {}", report.runs, report.scenario, report.seed),
        &origin.scenario.description,
    );
    if let Some(first) = report.by_method.first() {
        let (tone, word, sentence) = monte_carlo_verdict(report, first);
        page.verdict(tone, &word, &sentence);
    }
    page.section("Errors after each run");
    if let Some(coarse) = &report.coarse {
        let caption = format!(
            "Coarse alignment alone, {} runs of {} s",
            coarse.runs, report.duration_s
        );
        page.table(&caption, &SPREAD_HEADS, &spread_rows(coarse, None));
    }
    for method in &report.by_method {
        let name = method.method.name();
        let aligned = format!("{name}: {} of {} runs aligned", method.aligned, report.runs);
        let after = method.mean_time_to_aligned_s;
        let caption = after.map_or(aligned.clone(), |t| format!("{aligned}, after {t:.1} s in the mean"));
        match &method.fine {
            Some(fine) => page.table(
                &caption,
                &SPREAD_HEADS,
                &spread_rows(fine, method.heading_rms_over_bound),
            ),
            None => page.paragraph(&format!("{caption}.")),
        }
        if method.inconsistent > 0 {
            page.paragraph(&format!(
                "{} refused: innovations do not fit a base that only swings.",
                method.inconsistent
            ));
        }
    }
    page.paragraph(&format!(
        "Ideal: heading σ of a filter that is told everything but the noise, and zero velocity once a second: {}° along \
         the motion of the first run; angle random walk alone leaves {}°. An RMS of n runs scatters by 1/√(2n).",
        fixed(report.bound_deg, 3),
        fixed(report.random_walk_limit_deg, 3)
    ));
    page.section("Distribution");
    for method in &report.by_method {
        let Some(fine) = &method.fine else { continue };
        let name = method.method.name();
        let title = format!("{}, {name}: heading error of {} runs", report.scenario, fine.runs);
        let caption =
            format!("Heading errors by {name}, beside the normal densities of what is predicted and of what is ideal.");
        page.plot(&drawn(dir, &format!("heading-{name}.svg"), &caption, |width| {
            plot::heading_histogram(
                width,
                &title,
                &method.heading_errors_deg,
                fine.heading.predicted_sd_deg,
                report.bound_deg,
            )
        })?);
    }
    finished(dir, page, origin)
}

/// What the runs have come to by the first of the methods.
fn monte_carlo_verdict(report: &monte_carlo::Report, first: &MethodReport) -> (Tone, String, String) {
    let tone = match first.aligned as u64 {
        0 => Tone::Bad,
        n if n == report.runs => Tone::Good,
        _ => Tone::Plain,
    };
    let word = format!("{} of {} runs aligned", first.aligned, report.runs);
    let sentence = match &first.fine {
        None => format!("by {}.", first.method.name()),
        Some(Statistics { heading, .. }) => format!(
            "by {}: heading {:.3}° RMS where the filter predicts {:.3}°; the ideal filter's σ is {:.3}°.",
            first.method.name(),
            heading.rms_deg,
            heading.predicted_sd_deg,
            report.bound_deg
        ),
    };
    (tone, word, sentence)
}

const SPREAD_HEADS: [&str; 4] = ["", "heading", "pitch", "roll"];

/// A figure of a spread, as a table has it.
type FigureOf = fn(&Spread) -> String;

fn spread_rows(statistics: &Statistics, over_bound: Option<f64>) -> Vec<Vec<String>> {
    let rows: [(&str, FigureOf); 6] = [
        ("RMS error (°)", |s| fixed(s.rms_deg, 4)),
        ("mean error (°)", |s| signed(s.mean_deg, 4)),
        ("scatter, 1σ (°)", |s| fixed(s.sd_deg, 4)),
        ("largest error (°)", |s| fixed(s.worst_deg, 4)),
        ("predicted σ (°)", |s| fixed(s.predicted_sd_deg, 4)),
        ("mean of (error/σ)²", |s| fixed(s.nees, 2)),
    ];
    let angles = [&statistics.heading, &statistics.pitch, &statistics.roll];
    let mut rows: Vec<Vec<String>> = rows
        .into_iter()
        .map(|(name, of)| [name.to_owned()].into_iter().chain(angles.map(of)).collect())
        .collect();
    if let Some(ratio) = over_bound {
        let row = [
            "RMS / ideal σ".to_owned(),
            fixed(ratio, 3),
            String::new(),
            String::new(),
        ];
        rows.push(row.to_vec());
    }
    rows
}

/// σ of every state, one row for each measurement.
fn sigma_csv(path: PathBuf, curve: &[Sigmas]) -> Result<(), ReportError> {
    let write = || -> Result<(), csv::Error> {
        let mut out = csv::Writer::from_path(&path)?;
        let mut header: Vec<String> = [
            "t_s",
            "heading_sd_deg",
            "pitch_sd_deg",
            "roll_sd_deg",
            "velocity_east_sd_m_s",
            "velocity_north_sd_m_s",
            "velocity_up_sd_m_s",
            "gyro_bias_x_sd_deg_h",
            "gyro_bias_y_sd_deg_h",
            "gyro_bias_z_sd_deg_h",
            "accel_bias_x_sd_ug",
            "accel_bias_y_sd_ug",
            "accel_bias_z_sd_ug",
        ]
        .map(str::to_owned)
        .into();
        if curve.iter().any(|s| s.gyro_matrix_sd_ppm.is_some()) {
            for row in ["x", "y", "z"] {
                header.extend(["x", "y", "z"].map(|column| format!("gyro_matrix_{row}{column}_sd_ppm")));
            }
        }
        out.write_record(&header)?;
        for s in curve {
            let mut row = vec![s.t_s, s.sd.heading_deg, s.sd.pitch_deg, s.sd.roll_deg];
            row.extend(s.velocity_sd_m_s);
            row.extend(s.gyro_bias_sd_deg_h);
            row.extend(s.accel_bias_sd_ug);
            row.extend(s.gyro_matrix_sd_ppm.iter().flatten().flatten());
            out.write_record(row.iter().map(|x| format!("{x:.7}")))?;
        }
        out.flush()?;
        Ok(())
    };
    write().map_err(|e| ReportError::Io(path.clone(), e.into()))
}

/// Writes `report.html`, `result.json`, `sigma.csv` and `heading.svg` into `dir`.
///
/// # Errors
/// [`ReportError`] names the file.
pub fn bound(dir: &Path, origin: &Origin<'_>, bound: &Bound) -> Result<(), ReportError> {
    folder(dir)?;
    json(dir.join("result.json"), &tagged("bound", bound))?;
    sigma_csv(dir.join("sigma.csv"), &bound.curve)?;
    let mut page = Page::new(
        &format!("What no filter can beat in {}, seed {}", bound.scenario, bound.seed),
        &origin.scenario.description,
    );
    page.verdict(
        Tone::Plain,
        "Ideal filter:",
        &format!(
            "heading to {:.3}° (1σ) after {} s; angle random walk alone leaves {:.3}°.",
            bound.end.sd.heading_deg, bound.duration_s, bound.end.random_walk_limit_deg
        ),
    );
    page.section("σ over time");
    let rows: Vec<Vec<String>> = bound
        .rows
        .iter()
        .map(|row| {
            vec![
                row.t_s.to_string(),
                fixed(row.sd.heading_deg, 3),
                fixed(row.random_walk_limit_deg, 3),
                fixed(row.sd.pitch_deg, 5),
                fixed(row.sd.roll_deg, 5),
            ]
        })
        .collect();
    page.table(
        &format!(
            "1σ of the ideal filter, {} states, zero velocity known to {} m/s each second",
            bound.states, bound.velocity_measurement_sd_m_s
        ),
        &["t (s)", "heading (°)", "by ARW (°)", "pitch (°)", "roll (°)"],
        &rows,
    );
    let title = format!("{}: heading σ of the ideal filter", bound.scenario);
    let caption = "Heading σ over time; what the angle random walk alone leaves, no filter can do better than.";
    page.plot(&drawn(dir, "heading.svg", caption, |width| {
        plot::heading_bound(width, &title, &bound.curve)
    })?);
    page.section("Biases at the end");
    let axes = |name: &str, sd: [f64; 3]| {
        let figures = sd.map(|x| fixed(x, 3));
        [name.to_owned()].into_iter().chain(figures).collect::<Vec<_>>()
    };
    page.table(
        "1σ, in the axes of the sensor",
        &["", "x", "y", "z"],
        &[
            axes("gyros (°/h)", bound.end.gyro_bias_sd_deg_h),
            axes("accelerometers (µg)", bound.end.accel_bias_sd_ug),
        ],
    );
    finished(dir, page, origin)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::align::Method;
    use crate::simulate;

    #[derive(Default)]
    struct Kept(Vec<Moment>);

    impl simulate::Observer for Kept {
        fn moment(&mut self, moment: &Moment) {
            self.0.push(*moment);
        }
    }

    fn page_of(seconds: f64, command: &str) -> (String, RunResult) {
        let mut scenario = Scenario::builtin("paper-sim").unwrap();
        scenario.run.duration_s = seconds;
        scenario.name = "<sea> & \"swell\"".to_owned();
        let mut kept = Kept::default();
        let result = simulate::run::<f32>(&scenario, 1, Method::Robust, &mut kept).unwrap();
        let dir = tempfile::TempDir::new().unwrap();
        let origin = Origin {
            scenario: &scenario,
            command,
        };
        run(dir.path(), &origin, &result, &kept.0, &[(0.0, 0.0), (1.0, 20.0)]).unwrap();
        (fs::read_to_string(dir.path().join("report.html")).unwrap(), result)
    }

    #[test]
    fn a_page_tells_what_came_out_and_needs_nothing_else() {
        let (html, result) = page_of(120.0, "hal-sim run --scenario '<sea>'");
        let last = result.last.unwrap();
        for text in [
            "Alignment in &lt;sea&gt; &amp; &quot;swell&quot;, seed 1".to_owned(),
            "<b>Aligned</b> after ".to_owned(),
            signed(last.error.heading_deg, 3),
            fixed(last.reading.sd.heading_deg, 4),
            "<td class=\"words\">gyro z (°/h)</td>".to_owned(),
            "<th>ideal σ</th>".to_owned(),
            "hal-sim run --scenario &#39;&lt;sea&gt;&#39;".to_owned(),
            "duration_s = 120.0".to_owned(),
            "(prefers-color-scheme: dark)".to_owned(),
        ] {
            assert!(html.contains(&text), "{text}");
        }
        assert_eq!(
            html.matches("<svg ").count(),
            6,
            "three plots for a page and for a telephone"
        );
        for outside in ["<script", "src=", "href=", "url(", "@import", "<sea>"] {
            assert!(!html.contains(outside), "{outside}");
        }
        // The settings are a scenario.
        let settings = html
            .split("<summary>")
            .nth(1)
            .and_then(|s| s.split("<pre>").nth(1))
            .unwrap();
        let settings = settings.split("</pre>").next().unwrap().replace("&quot;", "\"");
        let again = Scenario::parse(&settings, "again").unwrap();
        assert_eq!(again.run.duration_s, 120.0);
    }

    #[test]
    fn a_page_says_why_there_is_no_heading() {
        let (html, result) = page_of(20.0, "hal-sim run --seconds 20");
        assert!(result.aligned_at_s.is_none());
        assert!(html.contains("<p class=\"verdict bad\"><b>Not aligned:</b> "), "{html}");
    }
}
