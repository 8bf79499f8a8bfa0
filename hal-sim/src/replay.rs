//! Replay of recorded logs through the unit's core, in f32 as the firmware runs it.

use std::io::BufRead;
use std::path::Path;

use app::record::Taken;
use frames::units::{
    ARC_MIN, DEG, DEG_PER_HOUR, DEG_PER_SQRT_HOUR, MICRO_G, MICRO_G_PER_SQRT_HZ, PPM, STANDARD_GRAVITY,
};
use nav::aligner::{Aligner, AlignerError, Event};
use nav::model::{PAPER, ROBUST};
use nav::noise::ImuNoise;
use nav::rotor::RotorConfig;
use serde::Serialize;

use crate::align::{self, Method, Reading, Setup};
use crate::log::{Checker, Header, LogError, LogReader, LogRow, LogWarning, UnitStatus};
use crate::unit::Unit;

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

/// The unit's estimate for the body at the last row of a log; of a recording the last one the unit aligned with.
///
/// Where the aligner has no estimate, or does not stand by it (`state` is `inconsistent`), the figures are `null` and
/// `reason` says why.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Replay {
    /// `aligned`, `fine` (σ not yet small), `inconsistent`, or where the aligner stood.
    pub state: &'static str,
    /// Time of the last row that the aligner was given, s.
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
    /// The unit that recorded was in this mode from here on.
    fn status(&mut self, _status: &UnitStatus) {}
    /// The log is usable, but.
    fn warning(&mut self, _warning: &LogWarning) {}
}

/// Nobody looks.
impl Observer for () {}

/// What the unit's own aligner was told when it recorded, to the bit.
pub fn recorded(header: &Header, method: Method) -> Setup {
    let Header {
        latitude,
        height,
        schedule,
        noise,
        ..
    } = header;
    Setup {
        latitude_deg: f64::from(*latitude) / DEG,
        height_m: f64::from(*height),
        rotor: RotorConfig {
            rate: schedule.rate.into(),
            travel: schedule.travel.into(),
            acceleration: schedule.acceleration.into(),
        },
        unit: data_sheet(noise),
        method,
        encoder_constraint_arcsec: None,
    }
}

/// The inverse of [`align::noise`].
fn data_sheet(noise: &ImuNoise) -> Unit {
    let in_units = |figure: f32, unit: f64| f64::from(figure) / unit;
    let tau = |sd: f32, tau: f32, default: f64| if sd > 0.0 { tau.into() } else { default };
    let default = Unit::default();
    Unit {
        gyro_bias_sd_deg_h: in_units(noise.gyro_bias_sd, DEG_PER_HOUR),
        accel_bias_sd_ug: in_units(noise.accel_bias_sd, MICRO_G),
        angle_random_walk_deg_sqrt_h: in_units(noise.angle_random_walk, DEG_PER_SQRT_HOUR),
        velocity_random_walk_ug_sqrt_hz: in_units(noise.velocity_random_walk, MICRO_G_PER_SQRT_HZ),
        gyro_instability_deg_h: in_units(noise.gyro_instability_sd, DEG_PER_HOUR),
        gyro_instability_tau_s: tau(
            noise.gyro_instability_sd,
            noise.gyro_instability_tau,
            default.gyro_instability_tau_s,
        ),
        gyro_scale_factor_sd_ppm: in_units(noise.gyro_scale_factor_sd, PPM),
        gyro_misalignment_sd_arcmin: in_units(noise.gyro_misalignment_sd, ARC_MIN),
        gyro_g_sensitivity_sd_deg_h_g: in_units(noise.gyro_g_sensitivity_sd, DEG_PER_HOUR / STANDARD_GRAVITY),
        gyro_housing_sd_deg_h: in_units(noise.gyro_housing_sd, DEG_PER_HOUR),
        accel_scale_factor_sd_ppm: in_units(noise.accel_scale_factor_sd, PPM),
        accel_misalignment_sd_arcmin: in_units(noise.accel_misalignment_sd, ARC_MIN),
        accel_instability_ug: in_units(noise.accel_instability_sd, MICRO_G),
        accel_instability_tau_s: tau(
            noise.accel_instability_sd,
            noise.accel_instability_tau,
            default.accel_instability_tau_s,
        ),
    }
}

/// Streams a log through the aligner.
///
/// # Errors
/// [`ReplayError`] where the log or a figure is not usable; nothing of a broken log is reported as a result.
pub fn replay(path: &Path, setup: &Setup, observer: &mut impl Observer) -> Result<Replay, ReplayError> {
    replay_from(LogReader::open(path)?, |_| setup.clone(), observer)
}

/// The same for a log that is open already, whose header has a say in the setup.
///
/// `told` is asked at the beginning, and where a recording says that its unit aligned anew: with the header read last, which
/// the unit sends before that with the settings it then has.
///
/// # Errors
/// As of [`replay`].
pub fn replay_from<R: BufRead>(
    log: LogReader<R>,
    told: impl Fn(Option<&Header>) -> Setup,
    observer: &mut impl Observer,
) -> Result<Replay, ReplayError> {
    match told(log.header()).method {
        Method::Kf | Method::Stf => replay_with::<PAPER, R>(log, &told, observer),
        Method::Robust | Method::RobustKf => replay_with::<ROBUST, R>(log, &told, observer),
    }
}

/// Whether the aligner is given a row: what the unit that recorded used for something else it is not.
fn is_aligned(row: &LogRow) -> bool {
    matches!(row.taken, None | Some(Taken::Aligner | Taken::AlignerAnew))
}

fn replay_with<const B: usize, R: BufRead>(
    mut log: LogReader<R>,
    told: &dyn Fn(Option<&Header>) -> Setup,
    observer: &mut impl Observer,
) -> Result<Replay, ReplayError> {
    let mut setup = told(log.header());
    let mut aligner: Aligner<f32, B> = setup.aligner()?;
    let mut checker = Checker::new(log.file_name());
    let mut warned = 0;
    let mut t_s = 0.0;
    let mut rejected = None;
    while let Some(row) = log.next() {
        let row = row?;
        while let Some(status) = log.next_status() {
            observer.status(&status);
        }
        checker.push(&row)?;
        for warning in checker.warnings().iter().skip(warned) {
            observer.warning(warning);
        }
        warned = checker.warnings().len();
        observer.row(&row);
        if !is_aligned(&row) {
            continue;
        }
        t_s = row.t_s;
        if row.taken == Some(Taken::AlignerAnew) {
            let now = told(log.header());
            if now == setup {
                aligner.start_anew();
            } else {
                aligner = now.aligner()?;
                setup = now;
            }
        }
        #[expect(clippy::cast_possible_truncation, reason = "the core runs in f32")]
        if let Some(event) = aligner.step(&align::cast(&row.sample()), row.encoder as f32) {
            observer.event(t_s, &event);
            if let Event::Restarted(_) = event {
                rejected = Some(align::describe(&event));
            }
        }
    }
    while let Some(status) = log.next_status() {
        observer.status(&status);
    }
    for warning in checker.finish()?.iter().skip(warned).chain(&log.warnings()) {
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
