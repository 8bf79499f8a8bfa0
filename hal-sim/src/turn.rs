//! A virtual rotor: the log of an IMU at rest, turned as the rotor of a unit would have turned it.
//!
//! ```text
//! Δθ' = ∫ Rz(−α) ω dt + Δα z        Δv' = ∫ Rz(−α) f dt        encoder' = encoder + α
//! ```
//!
//! with ω and f constant over the interval of a row, and α the schedule of [`nav::rotor`] from rest at the first row on. What
//! the aligner makes of it tells what it would make of the part: its noise, its quantisation, its drift from minute to
//! minute.
//!
//! Not modelled: what the rotor's own rate does to a gyro, scale factor and misalignment of z. And a bias of the log cannot
//! be told from Earth's rate: it turns with the samples, stays in the housing, and goes into heading as it does at rest, while
//! a rotor would average it away. Errors that are to turn with the sensor have to be taken off before (`hal-sim calibrate`).

use std::io::BufRead;
use std::path::{Path, PathBuf};

use frames::{Sensor, Vec3};
use nav::calibration::REST_TRAVEL;
use nav::rotor::{RotorConfig, RotorError, Schedule};

use crate::log::{ConvertError, LogError, LogReader, LogWriter, Place, not_itself};

/// Why a log cannot be turned.
#[derive(Debug)]
pub enum TurnError {
    /// The log, or the file to be written.
    Convert(ConvertError),
    /// The rotor's figures.
    Rotor(RotorError),
    /// The rotor turned in the log already.
    Turning {
        /// The log.
        file: String,
        /// Where in it.
        at: Place,
    },
}

impl core::fmt::Display for TurnError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            Self::Convert(e) => e.fmt(f),
            Self::Rotor(e) => e.fmt(f),
            Self::Turning { file, at } => {
                write!(
                    f,
                    "{file}:{at}: the rotor turns: only the log of an IMU at rest can be turned"
                )
            }
        }
    }
}

impl core::error::Error for TurnError {}

impl From<ConvertError> for TurnError {
    fn from(e: ConvertError) -> Self {
        Self::Convert(e)
    }
}

impl From<LogError> for TurnError {
    fn from(e: LogError) -> Self {
        Self::Convert(e.into())
    }
}

impl From<RotorError> for TurnError {
    fn from(e: RotorError) -> Self {
        Self::Rotor(e)
    }
}

/// Writes the log `from`, of an IMU at rest and open as `log`, as `to`, turned; the rows that were written.
///
/// # Errors
/// [`TurnError`].
pub fn turn<R: BufRead>(
    log: &mut LogReader<R>,
    from: &Path,
    to: &Path,
    rotor: &RotorConfig<f64>,
) -> Result<u64, TurnError> {
    let schedule = Schedule::new(*rotor)?;
    not_itself(from, to)?;
    let failed = |e| ConvertError::Write(PathBuf::from(to), e);
    let mut out: Option<LogWriter<_>> = None;
    let (mut rows, mut begun, mut stand) = (0, None, None);
    while let Some(row) = log.next() {
        let row = row?;
        let stand = *stand.get_or_insert(row.encoder);
        if (row.encoder - stand).abs() > REST_TRAVEL {
            return Err(TurnError::Turning {
                file: log.file_name().to_owned(),
                at: row.at,
            });
        }
        let sample = row.sample();
        let t = row.t_s - *begun.get_or_insert(row.t_s - sample.dt);
        let (before, now) = (schedule.at(t - sample.dt).angle, schedule.at(t).angle);
        let out = match &mut out {
            Some(out) => out,
            none => none.insert(LogWriter::create(to, row.temperature_c.is_some()).map_err(failed)?),
        };
        out.write(
            row.t_s,
            sample.dt,
            turned(sample.dtheta_s, before, now) + Vec3::new(0.0, 0.0, now - before),
            turned(sample.dv_s, before, now),
            row.encoder + now,
            row.temperature_c,
        )
        .map_err(failed)?;
        rows += 1;
    }
    out.map_or(Ok(()), |out| out.finish().map(drop)).map_err(failed)?;
    Ok(rows)
}

/// An increment at a constant rate as a sensor has it that turns from one angle to another meanwhile.
fn turned(increment: Vec3<Sensor, f64>, from: f64, to: f64) -> Vec3<Sensor, f64> {
    let half = 0.5 * (to - from);
    // The mean of Rz(−α) over the turn is that of its middle, shortened by sin h/h; z stays.
    let short = if half.abs() > 1e-9 { half.sin() / half } else { 1.0 };
    let (sin, cos) = (0.5 * (from + to)).sin_cos();
    let [x, y, z] = increment.to_array();
    Vec3::new(short * (cos * x + sin * y), short * (cos * y - sin * x), z)
}

#[cfg(test)]
mod tests {
    use frames::units::DEG;

    use super::*;
    use crate::scenario::Scenario;
    use crate::truth::Truth;

    /// Δθ, Δv and the rotor's angle of a row.
    type Increments = (Vec3<Sensor, f64>, Vec3<Sensor, f64>, f64);

    fn log_of(scenario: &Scenario, path: &Path) -> Vec<Increments> {
        let truth = Truth::new(scenario, 1).unwrap();
        let mut out = LogWriter::create(path, false).unwrap();
        let rows = (1..=scenario.samples())
            .map(|k| {
                let (t0, t1) = (scenario.time(k - 1), scenario.time(k));
                let (dtheta, dv) = truth.increment(t0, t1);
                let alpha = truth.rotor_angle(t1);
                out.write(t1, t1 - t0, dtheta, dv, alpha, None).unwrap();
                (dtheta, dv, alpha)
            })
            .collect();
        out.finish().unwrap();
        rows
    }

    /// A resting base seen by a rotor that turns, and the same made from the rotor at rest.
    #[test]
    fn a_turned_log_is_that_of_a_rotor() {
        let dir = tempfile::TempDir::new().unwrap();
        let (rest, made) = (dir.path().join("rest.csv"), dir.path().join("turned.csv"));
        let base = "[run]\nduration_s = 45\n[swing.pitch]\ncentre_deg = 2\n[swing.heading]\ncentre_deg = 30\n";
        let turning = Scenario::parse(base, "test").unwrap();
        let mut resting = turning.clone();
        resting.rotor.rate_dps = 0.0;
        let rotor = RotorConfig {
            rate: turning.rotor.rate_dps * DEG,
            travel: turning.rotor.travel_deg * DEG,
            acceleration: turning.rotor.acceleration_dps2 * DEG,
        };
        log_of(&resting, &rest);
        let expected = log_of(&turning, &dir.path().join("expected.csv"));
        let rows = turn(&mut LogReader::open(&rest).unwrap(), &rest, &made, &rotor).unwrap();
        assert_eq!(rows, expected.len() as u64);
        for (row, (dtheta, dv, alpha)) in LogReader::open(&made).unwrap().zip(expected) {
            let row = row.unwrap();
            let sample = row.sample();
            assert!((sample.dtheta_s - dtheta).norm() < 1e-10, "{row:?}");
            assert!((sample.dv_s - dv).norm() < 1e-6, "{row:?}");
            assert!((row.encoder - alpha).abs() < 1e-9, "{row:?}");
        }
        // What turns already is not turned.
        let again = turn(&mut LogReader::open(&made).unwrap(), &made, &rest, &rotor).unwrap_err();
        assert!(again.to_string().contains("only the log of an IMU at rest"), "{again}");
    }
}
