//! Report folders: JSON, CSV and plots of a run, a Monte Carlo or a bound.

use std::fs;
use std::io;
use std::path::{Path, PathBuf};

use serde::Serialize;

use crate::bound::{Bound, Sigmas};
use crate::monte_carlo;
use crate::plot::{self, PlotError};
use crate::simulate::{Moment, RunResult};

/// Why a report could not be written.
#[derive(Debug)]
pub enum ReportError {
    /// A file or folder.
    Io(PathBuf, io::Error),
    /// A plot.
    Plot(PathBuf, PlotError),
}

impl core::fmt::Display for ReportError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            Self::Io(path, e) => write!(f, "cannot write {}: {e}", path.display()),
            Self::Plot(path, e) => write!(f, "cannot draw {}: {e}", path.display()),
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

fn drawn(path: PathBuf, draw: impl FnOnce(&Path) -> Result<(), PlotError>) -> Result<(), ReportError> {
    draw(&path).map_err(|e| ReportError::Plot(path.clone(), e))
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

/// Writes `result.json`, `estimates.csv`, `attitude-error.svg`, `gyro-bias.svg` and `rotor.svg` into `dir`.
///
/// # Errors
/// [`ReportError`] names the file.
pub fn run(dir: &Path, result: &RunResult, moments: &[Moment], rotor: &[(f64, f64)]) -> Result<(), ReportError> {
    folder(dir)?;
    json(dir.join("result.json"), result)?;
    csv(dir.join("estimates.csv"), moments)?;
    drawn(dir.join("attitude-error.svg"), |path| {
        plot::attitude_error(path, moments)
    })?;
    drawn(dir.join("gyro-bias.svg"), |path| plot::biases(path, moments))?;
    drawn(dir.join("rotor.svg"), |path| plot::rotor(path, rotor))
}

/// Writes `result.json` and a heading histogram for each method into `dir`.
///
/// # Errors
/// [`ReportError`] names the file.
pub fn monte_carlo(dir: &Path, report: &monte_carlo::Report) -> Result<(), ReportError> {
    folder(dir)?;
    json(dir.join("result.json"), report)?;
    for method in &report.by_method {
        let Some(fine) = &method.fine else { continue };
        let name = method.method.name();
        let title = format!("{}, {}: heading error of {} runs", report.scenario, name, fine.runs);
        drawn(dir.join(format!("heading-{name}.svg")), |path| {
            plot::heading_histogram(
                path,
                &title,
                &method.heading_errors_deg,
                fine.heading.predicted_sd_deg,
                report.bound_deg,
            )
        })?;
    }
    Ok(())
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

/// Writes `result.json`, `sigma.csv` and `heading.svg` into `dir`.
///
/// # Errors
/// [`ReportError`] names the file.
pub fn bound(dir: &Path, bound: &Bound) -> Result<(), ReportError> {
    folder(dir)?;
    json(dir.join("result.json"), bound)?;
    sigma_csv(dir.join("sigma.csv"), &bound.curve)?;
    let title = format!("{}: heading σ of the ideal filter", bound.scenario);
    drawn(dir.join("heading.svg"), |path| {
        plot::heading_bound(path, &title, &bound.curve)
    })
}
