//! What commands tell in JSON: the name of the shape first, and of `run`, `unit` and `replay` the same keys for the same things.
//!
//! `docs/json.md` lists them. A key that changes its meaning, its unit or its type, or that goes, makes a new version; one that is
//! added does not.

use serde::Serialize;

use crate::align::{self, Reading};
use crate::replay::Replay;
use crate::simulate::RunResult;
use crate::unit_sim::UnitResult;

/// Which shape an object has.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
pub struct Schema {
    /// Of the command: `run`, `unit` and `replay` have one in common, `alignment`.
    pub name: &'static str,
    /// Counts changes that readers must know of.
    pub version: u32,
}

/// An object with its schema.
#[derive(Debug, Serialize)]
pub struct Tagged<'a, T> {
    schema: Schema,
    #[serde(flatten)]
    value: &'a T,
}

/// The result of a command, under a name of its own.
pub const fn tagged<'a, T: Serialize>(name: &'static str, value: &'a T) -> Tagged<'a, T> {
    Tagged {
        schema: Schema { name, version: 1 },
        value,
    }
}

/// What `run`, `unit` and `replay` have in common. Without an estimate, or where the aligner does not stand by it (`state` is
/// `inconsistent`), its figures are `null`.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Outcome {
    /// `aligned`, another state of the aligner, or a mode of the unit.
    pub state: &'static str,
    /// Why it is not aligned, in words.
    pub reason: Option<String>,
    /// Time at the end, s: of a run since its start, of a unit since power-up, of a log that of its last row.
    pub t_s: Option<f64>,
    /// When it first was aligned, s of the same time.
    pub aligned_at_s: Option<f64>,
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
    /// Gyro biases in s, °/h.
    pub gyro_bias_deg_h: Option<[f64; 3]>,
    /// Accelerometer biases in s, µg.
    pub accel_bias_ug: Option<[f64; 3]>,
}

impl Outcome {
    fn new(
        (state, reason): (&'static str, Option<String>),
        (t_s, aligned_at_s): (Option<f64>, Option<f64>),
        reading: Option<&Reading>,
    ) -> Self {
        let reading = reading.filter(|_| state != align::INCONSISTENT);
        let of = |figure: fn(&Reading) -> f64| reading.map(figure);
        Self {
            state,
            reason,
            t_s,
            aligned_at_s,
            heading_deg: of(|r| r.attitude.heading_deg),
            pitch_deg: of(|r| r.attitude.pitch_deg),
            roll_deg: of(|r| r.attitude.roll_deg),
            heading_sd_deg: of(|r| r.sd.heading_deg),
            pitch_sd_deg: of(|r| r.sd.pitch_deg),
            roll_sd_deg: of(|r| r.sd.roll_deg),
            gyro_bias_deg_h: reading.map(|r| r.gyro_bias_deg_h),
            accel_bias_ug: reading.map(|r| r.accel_bias_ug),
        }
    }
}

impl From<&RunResult> for Outcome {
    fn from(run: &RunResult) -> Self {
        Self::new(
            (run.state, run.reason.clone()),
            (run.t_s, run.aligned_at_s),
            run.last.as_ref().map(|moment| &moment.reading),
        )
    }
}

impl From<&UnitResult> for Outcome {
    fn from(unit: &UnitResult) -> Self {
        // Of a unit that rests, or has a fault, the last estimate is an old one.
        let aligns = ["coarse", "fine", "aligned", "navigating"].contains(&unit.state);
        let not_ready = unit.not_ready.as_ref().filter(|_| aligns);
        let state = not_ready.and_then(align::doubted).unwrap_or(unit.state);
        let fault = unit.faults.last().filter(|_| unit.state == "fault");
        let reason = fault.map(|fault| format!("{}: {}", fault.name, fault.text));
        Self::new(
            (state, reason.or_else(|| not_ready.map(align::describe_not_ready))),
            (Some(unit.t_s), unit.aligned_at_s),
            unit.last.as_ref().filter(|_| aligns).map(|moment| &moment.reading),
        )
    }
}

impl From<&Replay> for Outcome {
    fn from(replay: &Replay) -> Self {
        Self {
            state: replay.state,
            reason: replay.reason.clone(),
            t_s: Some(replay.t_s),
            aligned_at_s: replay.aligned_at_s,
            heading_deg: replay.heading_deg,
            pitch_deg: replay.pitch_deg,
            roll_deg: replay.roll_deg,
            heading_sd_deg: replay.heading_sd_deg,
            pitch_sd_deg: replay.pitch_sd_deg,
            roll_sd_deg: replay.roll_sd_deg,
            gyro_bias_deg_h: replay.gyro_bias_deg_h,
            accel_bias_ug: replay.accel_bias_ug,
        }
    }
}

/// The result of `run`, `unit` or `replay`: what they have in common, and what is their own.
#[derive(Debug, Serialize)]
pub struct Alignment<'a, T> {
    schema: Schema,
    #[serde(flatten)]
    outcome: Outcome,
    #[serde(flatten)]
    own: &'a T,
}

/// It, of such a result.
pub fn alignment<'a, T>(result: &'a T) -> Alignment<'a, T>
where
    Outcome: From<&'a T>,
{
    Alignment {
        schema: Schema {
            name: "alignment",
            version: 1,
        },
        outcome: result.into(),
        own: result,
    }
}
