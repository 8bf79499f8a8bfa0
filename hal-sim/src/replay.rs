//! Replay of recorded logs through the unit's core, in f32 as the firmware runs it.

use std::path::Path;

use nav::aligner::{Aligner, AlignerError, Event};
use nav::increment::Sample;
use nav::model::{PAPER, ROBUST};
use serde::Serialize;

use crate::align::{self, Method, Reading, Setup};
use crate::log::{Checker, LogError, LogReader, LogRow, LogWarning};

/// Why a log cannot be replayed.
#[derive(Debug, Clone, PartialEq)]
pub enum ReplayError {
    /// The log itself.
    Log(LogError),
    /// Latitude, height or a unit's figure is out of range.
    Aligner(AlignerError),
}

impl core::fmt::Display for ReplayError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            Self::Log(e) => e.fmt(f),
            Self::Aligner(e) => e.fmt(f),
        }
    }
}

impl core::error::Error for ReplayError {}

impl From<LogError> for ReplayError {
    fn from(e: LogError) -> Self {
        Self::Log(e)
    }
}

impl From<AlignerError> for ReplayError {
    fn from(e: AlignerError) -> Self {
        Self::Aligner(e)
    }
}

/// The unit's estimate for the body at the last row of a log.
///
/// Where the aligner has no estimate, or does not stand by it (`state` is `inconsistent`), the figures are `null` and
/// `reason` says why.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Replay {
    /// `aligned`, `fine` (σ not yet small), `inconsistent`, or where the aligner stood.
    pub state: &'static str,
    /// Time of the last row, s.
    pub t_s: f64,
    /// Clockwise from true north.
    pub heading_deg: Option<f64>,
    /// Front up positive.
    pub pitch_deg: Option<f64>,
    /// Right side down positive.
    pub roll_deg: Option<f64>,
    /// 1σ of heading.
    pub heading_sd_deg: Option<f64>,
    /// 1σ of pitch.
    pub pitch_sd_deg: Option<f64>,
    /// 1σ of roll.
    pub roll_sd_deg: Option<f64>,
    /// Gyro biases in s.
    pub gyro_bias_deg_h: Option<[f64; 3]>,
    /// Accelerometer biases in s.
    pub accel_bias_ug: Option<[f64; 3]>,
    /// Why it is not aligned.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub reason: Option<String>,
}

/// Receives what a replay meets.
pub trait Observer {
    /// A row has been read.
    fn row(&mut self, _row: &LogRow) {}
    /// The aligner told something at time `t`, s.
    fn event(&mut self, _t: f64, _event: &Event<f32>) {}
    /// The log is usable, but.
    fn warning(&mut self, _warning: &LogWarning) {}
}

/// Nobody looks.
impl Observer for () {}

/// The sample of a row. Across a gap the row's means cover its last interval alone.
fn sample(row: &LogRow) -> Sample<f64> {
    let dt = row.gap.as_ref().map_or(row.dt_s, |gap| gap.nominal_dt_s);
    Sample {
        dtheta_s: row.w_is_s * dt,
        dv_s: row.f_is_s * dt,
        dt,
        gap: row.dt_s - dt,
    }
}

/// Streams a log through the aligner.
///
/// # Errors
/// [`ReplayError`] where the log or a figure is not usable; nothing of a broken log is reported as a result.
pub fn replay(path: &Path, setup: &Setup, observer: &mut impl Observer) -> Result<Replay, ReplayError> {
    match setup.method {
        Method::Kf | Method::Stf => replay_with::<PAPER>(path, setup, observer),
        Method::Robust | Method::RobustKf => replay_with::<ROBUST>(path, setup, observer),
    }
}

fn replay_with<const B: usize>(
    path: &Path,
    setup: &Setup,
    observer: &mut impl Observer,
) -> Result<Replay, ReplayError> {
    let mut aligner: Aligner<f32, B> = setup.aligner()?;
    let reader = LogReader::open(path)?;
    let mut checker = Checker::new(reader.file_name());
    let mut told = 0;
    let mut t_s = 0.0;
    let mut rejected = None;
    for row in reader {
        let row = row?;
        checker.push(&row)?;
        for warning in checker.warnings().iter().skip(told) {
            observer.warning(warning);
        }
        told = checker.warnings().len();
        observer.row(&row);
        t_s = row.t_s;
        #[expect(clippy::cast_possible_truncation, reason = "the core runs in f32")]
        if let Some(event) = aligner.step(&align::cast(&sample(&row)), row.encoder as f32) {
            observer.event(t_s, &event);
            if let Event::Restarted(_) = event {
                rejected = Some(align::describe(&event));
            }
        }
    }
    for warning in checker.finish()?.iter().skip(told) {
        observer.warning(warning);
    }

    let state = align::state_name(&aligner);
    let reading = aligner
        .estimate()
        .filter(|_| state != "inconsistent")
        .map(|e| Reading::from_estimate(&e));
    // Before the fine filter, the reason is how much is missing; if something was rejected, that is why.
    let reason = match (&reading, rejected) {
        (None, Some(why)) if state != "inconsistent" => Some(format!("{} s into the log: {why}", round(t_s))),
        _ => align::reason(&aligner),
    };
    let angle = |of: fn(&Reading) -> f64| reading.as_ref().map(|r| round(of(r)));
    Ok(Replay {
        state,
        t_s: round(t_s),
        heading_deg: angle(|r| r.attitude.heading_deg),
        pitch_deg: angle(|r| r.attitude.pitch_deg),
        roll_deg: angle(|r| r.attitude.roll_deg),
        heading_sd_deg: angle(|r| r.sd.heading_deg),
        pitch_sd_deg: angle(|r| r.sd.pitch_deg),
        roll_sd_deg: angle(|r| r.sd.roll_deg),
        gyro_bias_deg_h: reading.as_ref().map(|r| r.gyro_bias_deg_h.map(round)),
        accel_bias_ug: reading.as_ref().map(|r| r.accel_bias_ug.map(round)),
        reason,
    })
}

/// To a millionth: what is left of an f32 beyond is noise.
fn round(x: f64) -> f64 {
    (x * 1e6).round() / 1e6
}
