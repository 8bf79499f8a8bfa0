//! Calibration of the gyros from a recorded log: a while at rest, then turning (\[Du16\] §3).
//!
//! The log is that of [`crate::log`]. The rest is the first that is long enough, whatever the rotor did before; it lasts until
//! 0.3 s before the encoder is seen to leave where it stood. All after it is the turn, pauses and reversals included. The
//! mathematics is the unit's own, [`nav::calibration`], in f64.

use std::collections::VecDeque;
use std::io::BufRead;
use std::path::Path;

use frames::units::{ARC_MIN, DEG, DEG_PER_HOUR, DEG_PER_SQRT_HOUR, PPM};
use frames::{Attitude, Body, Vec3};
use nav::calibration::{self, Calibration, CalibrationConfig, CalibrationError, Calibrator, REST_TRAVEL};
use nav::earth::{Earth, EarthError};
use serde::Serialize;

use crate::log::{ConvertError, DelayEstimator, ImuDelay, LogError, LogReader, LogRow, convert_from};
use crate::unit::Unit;

/// How long before the rotor is seen to turn it may have begun, s. It is seen once it has left the travel allowed at rest,
/// which takes this long at 2 °/s². What it turns by until then would be a tenth of a degree of motion at rest; in the
/// turn the encoder accounts for it.
const BEGINNING: f64 = 0.3;

/// Where a level housing stands, for Earth's rate in it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Stand {
    /// Geodetic latitude, degrees, north positive.
    pub latitude_deg: f64,
    /// Heading of the housing, degrees clockwise from true north.
    pub heading_deg: f64,
}

/// How to calibrate.
#[derive(Debug, Clone, PartialEq)]
pub struct Setup {
    /// Noise of the gyros.
    pub unit: Unit,
    /// Where the housing stands; `None`: Earth's rate is left in the biases, as in the paper.
    pub stand: Option<Stand>,
    /// Least time at rest, s.
    pub rest_s: f64,
}

/// Why there is no calibration.
#[derive(Debug)]
pub enum CalibrateError {
    /// The log itself.
    Log(LogError),
    /// The calibration.
    Calibration(CalibrationError),
    /// The place.
    Place(EarthError),
    /// The encoder stood still throughout.
    NoTurn,
}

impl core::fmt::Display for CalibrateError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            Self::Log(e) => e.fmt(f),
            Self::Calibration(e) => e.fmt(f),
            Self::Place(e) => e.fmt(f),
            Self::NoTurn => f.write_str("the rotor never turned: record a rest, then a turn"),
        }
    }
}

impl core::error::Error for CalibrateError {}

impl From<LogError> for CalibrateError {
    fn from(e: LogError) -> Self {
        Self::Log(e)
    }
}

impl From<CalibrationError> for CalibrateError {
    fn from(e: CalibrationError) -> Self {
        Self::Calibration(e)
    }
}

/// A calibration in people's units.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Report {
    /// Time at rest, s.
    pub rest_s: f64,
    /// Time of the turn, s.
    pub turn_s: f64,
    /// All turns added up, degrees.
    pub turned_deg: f64,
    /// Biases on x, y, z; Earth's rate included where it was not known.
    pub bias_deg_h: [f64; 3],
    /// 1σ of each by white noise, of the fit.
    pub bias_sd_deg_h: f64,
    /// The same by \[Du16\] (35).
    pub bias_sd_paper_deg_h: f64,
    /// What the x gyro takes of a turn about z.
    pub k_xz_arcmin: f64,
    /// What the y gyro takes of a turn about z.
    pub k_yz_arcmin: f64,
    /// Scale factor error of the z gyro.
    pub s_z_ppm: f64,
    /// 1σ of the three by white noise, of the fit.
    pub column_sd_ppm: f64,
    /// The same by \[Du16\] (36), the biases being known.
    pub column_sd_paper_ppm: f64,
    /// Mean rate of the turn, °/s.
    pub rate_dps: f64,
    /// What the rotor makes of a gyro at that rate once corrected, 1σ by white noise.
    pub induced_sd_deg_h: f64,
    /// Variance of the worst axis' residuals over the predicted one.
    pub scatter: f64,
    /// How late the IMU's samples are against the encoder: what the unit's `edge_delay_us` is short of. `null` where the rotor
    /// never turned round.
    pub imu_delay: Option<ImuDelay>,
}

impl Report {
    fn new(c: &Calibration<f64>, unit: &Unit, imu_delay: Option<ImuDelay>) -> Self {
        let arw = unit.angle_random_walk_deg_sqrt_h * DEG_PER_SQRT_HOUR;
        let rate = c.turned / c.turn;
        Self {
            rest_s: c.rest,
            turn_s: c.turn,
            turned_deg: c.turned / DEG,
            bias_deg_h: (c.bias_s / DEG_PER_HOUR).to_array(),
            bias_sd_deg_h: c.bias_sd / DEG_PER_HOUR,
            bias_sd_paper_deg_h: calibration::bias_sd(arw, c.rest) / DEG_PER_HOUR,
            k_xz_arcmin: c.k_xz / ARC_MIN,
            k_yz_arcmin: c.k_yz / ARC_MIN,
            s_z_ppm: c.s_z / PPM,
            column_sd_ppm: c.column_sd / PPM,
            column_sd_paper_ppm: calibration::column_sd(arw, c.turn, c.turned) / PPM,
            rate_dps: rate / DEG,
            induced_sd_deg_h: c.induced_sd(rate) / DEG_PER_HOUR,
            scatter: c.scatter,
            imu_delay,
        }
    }

    /// The figures as a table.
    pub fn table(&self) -> String {
        let mut text = format!(
            "{:.1} s at rest, {:.1} s turning by {:.0}° at {:.1} °/s; residuals {:.2} of their predicted variance\n\
             {:<18}{:>14}{:>12}{:>14}\n",
            self.rest_s, self.turn_s, self.turned_deg, self.rate_dps, self.scatter, "", "value", "sd", "[Du16] sd"
        );
        for (axis, bias) in ["x", "y", "z"].into_iter().zip(self.bias_deg_h) {
            text += &format!(
                "{:<18}{bias:>14.2}{:>12.2}{:>14.2}\n",
                format!("bias {axis} (°/h)"),
                self.bias_sd_deg_h,
                self.bias_sd_paper_deg_h
            );
        }
        let (sd, paper) = (
            self.column_sd_ppm * PPM / ARC_MIN,
            self.column_sd_paper_ppm * PPM / ARC_MIN,
        );
        for (name, value, sd, paper) in [
            ("K_xz (′)", self.k_xz_arcmin, sd, paper),
            ("K_yz (′)", self.k_yz_arcmin, sd, paper),
            ("S_z (ppm)", self.s_z_ppm, self.column_sd_ppm, self.column_sd_paper_ppm),
        ] {
            text += &format!("{name:<18}{value:>14.3}{sd:>12.3}{paper:>14.3}\n");
        }
        text += &format!(
            "left of the rotor's turn in a gyro: {:.2} °/h (1σ, by noise)\n",
            self.induced_sd_deg_h
        );
        if let Some(delay) = self.imu_delay {
            text += &format!("{delay}\n");
        }
        text
    }
}

/// Earth's rate in a level housing, rad/s.
fn earth_rate(stand: &Stand) -> Result<Vec3<Body, f64>, EarthError> {
    let earth = Earth::new(stand.latitude_deg * DEG, 0.0)?;
    let level = Attitude {
        heading: stand.heading_deg * DEG,
        pitch: 0.0,
        roll: 0.0,
    };
    Ok(level.to_rot().inverse() * earth.w_ie_n())
}

/// Calibrates from a log.
///
/// # Errors
/// [`CalibrateError`].
pub fn of_log(path: &Path, setup: &Setup) -> Result<(Calibration<f64>, Report), CalibrateError> {
    of_reader(&mut LogReader::open(path)?, setup)
}

/// The same for a log that is open already.
///
/// # Errors
/// As of [`of_log`].
pub fn of_reader<R: BufRead>(
    log: &mut LogReader<R>,
    setup: &Setup,
) -> Result<(Calibration<f64>, Report), CalibrateError> {
    let w_ie_b = setup
        .stand
        .as_ref()
        .map(earth_rate)
        .transpose()
        .map_err(CalibrateError::Place)?;
    let config = CalibrationConfig {
        angle_random_walk: setup.unit.angle_random_walk_deg_sqrt_h * DEG_PER_SQRT_HOUR,
        instability: setup.unit.gyro_instability_deg_h * DEG_PER_HOUR,
        rest: setup.rest_s,
        w_ie_b,
        ..CalibrationConfig::default()
    };
    let mut calibrator = Calibrator::new(config)?;
    let (mut stand, mut turning) = (None, false);
    let (mut latest, mut length) = (VecDeque::new(), 0.0);
    let (mut delay, mut previous) = (DelayEstimator::default(), None);
    // Why the best of the rests so far is none.
    let mut refused: Option<CalibrationError> = None;
    for row in log {
        let row = row?;
        if let Some(previous) = previous.replace(row) {
            delay.push(&row, &previous);
        }
        let sample = (row.sample(), row.encoder);
        if turning {
            calibrator.turn(&sample.0, sample.1)?;
            continue;
        }
        if (row.encoder - *stand.get_or_insert(row.encoder)).abs() > REST_TRAVEL {
            latest.push_back(sample);
            match latest
                .iter()
                .try_for_each(|(sample, encoder)| calibrator.turn(sample, *encoder))
            {
                Ok(()) => turning = true,
                Err(why @ (CalibrationError::RestTooShort { .. } | CalibrationError::BaseMoved { .. })) => {
                    refused = Some(refused.map_or(why, |before| better(before, why)));
                    calibrator = Calibrator::new(config)?;
                    (stand, length) = (Some(row.encoder), 0.0);
                }
                Err(why) => return Err(why.into()),
            }
            latest.clear();
            continue;
        }
        length += row.dt_s;
        latest.push_back(sample);
        while length > BEGINNING
            && let Some((sample, encoder)) = latest.pop_front()
        {
            length -= sample.dt + sample.gap;
            calibrator.rest(&sample, encoder)?;
        }
    }
    if !turning {
        let rested = calibrator.rested() >= setup.rest_s;
        return Err(refused
            .filter(|_| !rested)
            .map_or(CalibrateError::NoTurn, CalibrateError::Calibration));
    }
    let calibration = calibrator.finish()?;
    Ok((calibration, Report::new(&calibration, &setup.unit, delay.fit())))
}

/// Of two rests that are none, what to tell: that the base moved, or that the longer one was too short.
fn better(a: CalibrationError, b: CalibrationError) -> CalibrationError {
    let rested = |why: CalibrationError| match why {
        CalibrationError::RestTooShort { seconds, .. } => seconds,
        _ => f32::INFINITY,
    };
    if rested(a) > rested(b) { a } else { b }
}

/// Writes the log `from`, open as `log`, as `to`, its gyros corrected.
///
/// # Errors
/// [`ConvertError`].
pub fn correct_log<R: BufRead>(
    log: &mut LogReader<R>,
    from: &Path,
    to: &Path,
    calibration: &Calibration<f64>,
) -> Result<(), ConvertError> {
    let corrected = |row: &LogRow| calibration.corrected(&row.sample());
    convert_from(log, from, to, corrected).map(drop)
}

#[cfg(test)]
mod tests {
    use nalgebra::Vector3;

    use super::*;
    use crate::log::LogWriter;
    use crate::scenario::Scenario;
    use crate::sensors::Imu;

    const RATE_HZ: f64 = 50.0;

    /// A log of a rest and a turn that gathers speed at 200 °/s² until it has 20 °/s, at 40° north and heading 30°, with
    /// the errors of the seed and this angle random walk, °/√h.
    fn recorded_with(angle_random_walk: f64, path: &Path, rest_s: f64, turn_s: f64, seed: u64) -> Imu {
        let text = format!(
            "[imu]\ngyro_bias_sd_deg_h = 100\nangle_random_walk_deg_sqrt_h = {angle_random_walk}\n\
             accel_bias_sd_ug = 0\ngyro_scale_factor_sd_ppm = 1000\ngyro_misalignment_sd_arcmin = 6\n"
        );
        let mut imu = Imu::new(&Scenario::parse(&text, "test").unwrap(), seed);
        let stand = Stand {
            latitude_deg: 40.0,
            heading_deg: 30.0,
        };
        let w_ie_b = earth_rate(&stand).unwrap();
        let mut out = LogWriter::create(path, false).unwrap();
        let (dt, mut alpha) = (RATE_HZ.recip(), 0.3);
        for k in 1..=((rest_s + turn_s) * RATE_HZ) as u32 {
            let t = f64::from(k) * dt;
            let rate = (200.0 * (t - rest_s - 0.5 * dt)).clamp(0.0, 20.0) * DEG;
            // At 50 Hz the middle of the interval will do.
            let w_ie_s = frames::Rot::about_z(alpha + 0.5 * rate * dt).inverse() * w_ie_b;
            alpha += rate * dt;
            let dtheta = w_ie_s.vector() * dt + Vector3::new(0.0, 0.0, rate * dt);
            let m = imu.measure(Vec3::from_vector(dtheta), Vec3::new(0.0, 0.0, 9.8 * dt), dt);
            out.write(t, dt, m.dtheta_s, m.dv_s, alpha, None).unwrap();
        }
        out.finish().unwrap();
        imu
    }

    fn recorded(path: &Path, rest_s: f64, turn_s: f64, seed: u64) -> Imu {
        recorded_with(0.1, path, rest_s, turn_s, seed)
    }

    fn setup(stand: Option<Stand>) -> Setup {
        Setup {
            unit: Unit {
                angle_random_walk_deg_sqrt_h: 0.1,
                ..Unit::default()
            },
            stand,
            rest_s: 60.0,
        }
    }

    const STAND: Stand = Stand {
        latitude_deg: 40.0,
        heading_deg: 30.0,
    };

    #[test]
    fn a_log_is_calibrated_and_corrected() {
        let dir = tempfile::TempDir::new().unwrap();
        let (log, corrected) = (dir.path().join("a.csv"), dir.path().join("b.csv"));
        let imu = recorded(&log, 61.0, 72.0, 3);
        let (c, report) = of_log(&log, &setup(Some(STAND))).unwrap();
        let column = imu.gyro_matrix().column(2).into_owned() / PPM;
        let found = Vector3::new(
            report.k_xz_arcmin * ARC_MIN / PPM,
            report.k_yz_arcmin * ARC_MIN / PPM,
            report.s_z_ppm,
        );
        for axis in 0..3 {
            let bias = report.bias_deg_h[axis] - imu.gyro_bias_s().to_array()[axis] / DEG_PER_HOUR;
            assert!(bias.abs() < 4.0 * report.bias_sd_deg_h, "{bias} {report:?}");
            let off = (found - column)[axis];
            assert!(off.abs() < 4.0 * report.column_sd_ppm, "{off} {report:?}");
        }
        assert!(
            (report.rate_dps - 20.0).abs() < 0.1 && (0.5..1.6).contains(&report.scatter),
            "{report:?}"
        );
        assert!((report.induced_sd_deg_h / (report.column_sd_ppm * PPM * 20.0 * 3600.0) - 1.0).abs() < 0.01);

        // What is corrected needs no correction, but for a thousandth of Earth's rate that was taken for bias.
        correct_log(&mut LogReader::open(&log).unwrap(), &log, &corrected, &c).unwrap();
        let (_, again) = of_log(&corrected, &setup(Some(STAND))).unwrap();
        assert!(again.bias_deg_h.iter().all(|b| b.abs() < 0.05), "{again:?}");
        assert!(again.k_xz_arcmin.abs() < 1e-3 && again.s_z_ppm.abs() < 0.1, "{again:?}");

        // In its own place it would be gone.
        let whole = std::fs::read(&log).unwrap();
        assert!(matches!(
            correct_log(&mut LogReader::open(&log).unwrap(), &log, &log, &c),
            Err(ConvertError::Itself(_))
        ));
        assert_eq!(std::fs::read(&log).unwrap(), whole);
    }

    #[test]
    fn a_rotor_that_gathers_speed_has_left_its_rest() {
        let dir = tempfile::TempDir::new().unwrap();
        let log = dir.path().join("a.csv");
        let imu = recorded_with(0.0, &log, 60.0, 72.0, 3);
        let (c, report) = of_log(&log, &setup(Some(STAND))).unwrap();
        assert!(report.scatter < 0.01, "{report:?}");
        assert!((report.rest_s - (60.0 - BEGINNING)).abs() < 0.05, "{report:?}");
        let column = imu.gyro_matrix().column(2).into_owned();
        let off = Vector3::new(c.k_xz, c.k_yz, c.s_z) - column;
        // What is not modelled: 1000 ppm of Earth's rate, which is 2e-4 of the rotor's.
        assert!(off.amax() < 1.0 * PPM, "{off}");
    }

    #[test]
    fn earth_rate_is_in_the_biases_where_nothing_is_known_of_it() {
        let dir = tempfile::TempDir::new().unwrap();
        let log = dir.path().join("a.csv");
        recorded(&log, 61.0, 72.0, 3);
        let known = of_log(&log, &setup(Some(STAND))).unwrap().1;
        let left_in = of_log(&log, &setup(None)).unwrap().1;
        let z = left_in.bias_deg_h[2] - known.bias_deg_h[2];
        assert!((z - 15.041 * (40.0 * DEG).sin()).abs() < 0.05, "{z}");
    }

    /// A unit that turned, and rested for too short, before it was calibrated.
    #[test]
    fn the_rest_is_found_after_something_else() {
        let dir = tempfile::TempDir::new().unwrap();
        let (plain, log) = (dir.path().join("a.csv"), dir.path().join("b.csv"));
        recorded(&plain, 61.0, 72.0, 3);
        let rows: Vec<LogRow> = LogReader::open(&plain).unwrap().map(Result::unwrap).collect();
        let mut out = LogWriter::create(&log, false).unwrap();
        let turned = rows.iter().skip(100 * 50).take(20 * 50);
        let rested = rows.iter().take(30 * 50);
        for (k, row) in turned.clone().chain(rested).chain(turned).chain(&rows).enumerate() {
            let sample = row.sample();
            let t_s = (k + 1) as f64 / RATE_HZ;
            out.write(t_s, sample.dt, sample.dtheta_s, sample.dv_s, row.encoder, None)
                .unwrap();
        }
        out.finish().unwrap();
        let (expected, _) = of_log(&plain, &setup(Some(STAND))).unwrap();
        let (found, report) = of_log(&log, &setup(Some(STAND))).unwrap();
        assert!((report.rest_s - 60.7).abs() < 0.1, "{report:?}");
        for (a, b) in [
            (found.k_xz, expected.k_xz),
            (found.k_yz, expected.k_yz),
            (found.s_z, expected.s_z),
        ] {
            assert!((a - b).abs() < 0.5 * PPM, "{a} {b}");
        }
    }

    #[test]
    fn errors_are_typed() {
        let dir = tempfile::TempDir::new().unwrap();
        let log = dir.path().join("a.csv");
        recorded(&log, 20.0, 30.0, 1);
        let error = of_log(&log, &setup(None)).unwrap_err();
        assert!(
            matches!(
                error,
                CalibrateError::Calibration(CalibrationError::RestTooShort { .. })
            ),
            "{error}"
        );
        recorded(&log, 65.0, 0.0, 1);
        assert!(matches!(of_log(&log, &setup(None)), Err(CalibrateError::NoTurn)));
        recorded(&log, 65.0, 5.0, 1);
        let error = of_log(&log, &setup(None)).unwrap_err();
        assert!(
            matches!(
                error,
                CalibrateError::Calibration(CalibrationError::TooLittleTurn { .. })
            ),
            "{error}"
        );
        let nowhere = Stand {
            latitude_deg: 89.0,
            ..STAND
        };
        assert!(matches!(
            of_log(&log, &setup(Some(nowhere))),
            Err(CalibrateError::Place(_))
        ));
    }
}
