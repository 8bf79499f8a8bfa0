//! Replay of recorded logs through the unit's core, in f32 as the firmware runs it.

use std::io::BufRead;
use std::path::Path;

use app::parts;
use app::record::Taken;
use frames::Real as _;
use frames::math::wrap_pi;
use frames::units::{DEG, DEG_PER_SQRT_HOUR, MICRO_G_PER_SQRT_HZ};
use nav::aligner::{Aligner, AlignerError, Event};
use nav::deviation::Deviation;
use nav::increment::Sample;
use nav::model::{PAPER, ROBUST};
use nav::noise::WhiteNoise;
use nav::rotor::RotorConfig;
use serde::Serialize;

use crate::align::{self, Method, Reading, Setup};
use crate::log::{Checker, Header, ImuDelay, LogError, LogReader, LogRow, LogWarning, UnitStatus};
use crate::unit::Unit;

/// Angles of the encoder beyond this are wrapped, rad: up to there an f32 is good to 4e-6 rad.
const UNWRAPPED: f64 = 64.0;

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
/// `reason` says why. In JSON it has the keys of an [`Outcome`](crate::outcome::Outcome) besides.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Replay {
    /// `aligned`, `fine` (σ not yet small), `inconsistent`, or where the aligner stood.
    #[serde(skip)]
    pub state: &'static str,
    /// Time of the last row that the aligner was given, s.
    #[serde(skip)]
    pub t_s: f64,
    /// When it first was aligned, s.
    #[serde(skip)]
    pub aligned_at_s: Option<f64>,
    /// Clockwise from true north.
    #[serde(skip)]
    pub heading_deg: Option<f64>,
    /// Front up positive.
    #[serde(skip)]
    pub pitch_deg: Option<f64>,
    /// Right side down positive.
    #[serde(skip)]
    pub roll_deg: Option<f64>,
    /// 1σ of heading.
    #[serde(skip)]
    pub heading_sd_deg: Option<f64>,
    /// 1σ of pitch.
    #[serde(skip)]
    pub pitch_sd_deg: Option<f64>,
    /// 1σ of roll.
    #[serde(skip)]
    pub roll_sd_deg: Option<f64>,
    /// Gyro biases in s.
    #[serde(skip)]
    pub gyro_bias_deg_h: Option<[f64; 3]>,
    /// Accelerometer biases in s.
    #[serde(skip)]
    pub accel_bias_ug: Option<[f64; 3]>,
    /// How late the IMU's samples are against the encoder: what the unit's `edge_delay_us` is short of. `null` where the rotor
    /// never turned round.
    pub imu_delay: Option<ImuDelay>,
    /// Random walk of the gyros that σ rests on, where it was measured to be clearly more than the figure that was told.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub measured_walk_deg_sqrt_h: Option<f64>,
    /// Why it is not aligned.
    #[serde(skip)]
    pub reason: Option<String>,
}

/// The estimate at one time of a log.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Moment {
    /// Time of the log, s.
    pub t_s: f64,
    /// What the unit says.
    pub reading: Reading,
    /// Rotor angle, degrees.
    pub rotor_deg: f64,
    /// innovation²/variance per component of the last measurement; NaN before the first.
    pub innovation: f64,
    /// Its running mean: one where the model holds.
    pub innovation_ratio: f64,
}

/// Time between two moments, s.
const MOMENT_S: f64 = 1.0;

/// Receives what a replay meets.
pub trait Observer {
    /// A row has been read.
    fn row(&mut self, _row: &LogRow) {}
    /// The aligner told something at time `t`, s.
    fn event(&mut self, _t: f64, _event: &Event<f32>) {}
    /// What the unit says once a second of the log from the first estimate on, and at its end.
    fn moment(&mut self, _moment: &Moment) {}
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
        deviation,
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
        unit: Unit::of_noise(noise),
        deviation: deviation.map(|known| Deviation {
            rate_b: known.rate_b.map(f64::from),
            force_b: known.force_b.map(f64::from),
            sd: known.sd.into(),
        }),
        method,
        encoder_constraint_arcsec: None,
    }
}

/// Rows from which white noise is measured.
const MEASURED_ROWS: usize = 60_000;

/// The figures for a log without a description of its IMU: those of an unknown tactical MEMS IMU, with the white noise of the
/// log's first rows.
///
/// Of the gyros the level ones count: about z the motor turns.
///
/// A log that is broken is measured as far as it can be read: the replay says what is wrong with it.
pub fn measured<R: BufRead>(log: LogReader<R>) -> Unit {
    let (mut gyro, mut accel) = (WhiteNoise::new(), WhiteNoise::new());
    for row in log.take(MEASURED_ROWS).map_while(Result::ok) {
        let Sample { dtheta_s, dv_s, dt, .. } = row.sample();
        if dt > 0.0 {
            gyro.push(dtheta_s, dt, row.gap.is_some());
            accel.push(dv_s, dt, row.gap.is_some());
        }
    }
    let ([wx, wy, _], f) = (gyro.density(), accel.density());
    // Rounded, and never zero: that would say that there is no noise.
    let white = |figure: f64, unit: f64, steps: f64| ((figure / unit * steps).round() / steps).max(1.0 / steps);
    Unit {
        angle_random_walk_deg_sqrt_h: white(0.5 * (wx + wy), DEG_PER_SQRT_HOUR, 1e4),
        velocity_random_walk_ug_sqrt_hz: white(f.into_iter().sum::<f64>() / 3.0, MICRO_G_PER_SQRT_HZ, 1e2),
        ..Unit::of_part(&parts::UNKNOWN)
    }
}

/// What the steps of a log's figures alone make of white noise, in the units of [`Unit`]: (°/√h, µg/√Hz).
///
/// A step q has the variance q²/12 in each row. A sensor that carries what it rounds off to the next row has less: this is
/// the most. Of a log in full digits it is nothing.
pub fn quantisation<R: BufRead>(log: &mut LogReader<R>) -> (f64, f64) {
    let mut steps = [f64::INFINITY; 6];
    let mut before: Option<[f64; 6]> = None;
    let mut dt_s = 0.0;
    for row in log.by_ref().take(MEASURED_ROWS) {
        let Ok(row) = row else { break };
        let ([a, b, c], [d, e, f]) = (row.w_is_s.to_array(), row.f_is_s.to_array());
        let now = [a, b, c, d, e, f];
        if let Some(before) = before {
            for ((step, now), before) in steps.iter_mut().zip(now).zip(before) {
                let far = (now - before).abs();
                // Half a step apart are the digits of a text.
                if far > 1e-9 {
                    *step = step.min(far);
                }
            }
        }
        before = Some(now);
        dt_s = row.sample().dt;
    }
    let of = |steps: &[f64], unit: f64| {
        let largest = steps
            .iter()
            .copied()
            .filter(|step| step.is_finite())
            .fold(0.0, f64::max);
        largest / 12_f64.sqrt() * dt_s.sqrt() / unit
    };
    (of(&steps[..3], DEG_PER_SQRT_HOUR), of(&steps[3..], MICRO_G_PER_SQRT_HZ))
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

fn moment<const B: usize>(aligner: &Aligner<f32, B>, t_s: f64, rotor_deg: f64) -> Option<Moment> {
    let reading = Reading::from_estimate(&aligner.estimate()?);
    let innovation = aligner.innovation();
    Some(Moment {
        t_s,
        reading,
        rotor_deg,
        innovation: innovation.map_or(f64::NAN, |(last, _)| f64::from(last.nis) / 3.0),
        innovation_ratio: innovation.map_or(f64::NAN, |(_, ratio)| f64::from(ratio)),
    })
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
    let (mut rejected, mut aligned_at_s) = (None, None);
    let (mut next_s, mut rotor_deg) = (f64::NEG_INFINITY, 0.0);
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
        // Turns that were counted from far away leave an f32 no digits for the angle. Near zero the bits stay as they were
        // recorded.
        let encoder = if row.encoder.abs() > UNWRAPPED {
            wrap_pi(row.encoder)
        } else {
            row.encoder
        };
        #[expect(clippy::cast_possible_truncation, reason = "the core runs in f32")]
        if let Some(event) = aligner.step(&align::cast(&row.sample()), encoder as f32) {
            observer.event(t_s, &event);
            if let Event::Aligned = event {
                aligned_at_s.get_or_insert(t_s);
            }
            if let Event::Restarted(_) = event {
                rejected = Some(align::describe(&event));
            }
        }
        rotor_deg = row.encoder / DEG;
        if t_s >= next_s
            && let Some(moment) = moment(&aligner, t_s, rotor_deg)
        {
            next_s = t_s + MOMENT_S;
            observer.moment(&moment);
        }
    }
    // The result's, unless it has just been.
    if t_s > next_s - MOMENT_S
        && let Some(moment) = moment(&aligner, t_s, rotor_deg)
    {
        observer.moment(&moment);
    }
    while let Some(status) = log.next_status() {
        observer.status(&status);
    }
    let imu_delay = checker.imu_delay();
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
        aligned_at_s: aligned_at_s.map(round),
        heading_deg: angle(|r| r.attitude.heading_deg),
        pitch_deg: angle(|r| r.attitude.pitch_deg),
        roll_deg: angle(|r| r.attitude.roll_deg),
        heading_sd_deg: angle(|r| r.sd.heading_deg),
        pitch_sd_deg: angle(|r| r.sd.pitch_deg),
        roll_sd_deg: angle(|r| r.sd.roll_deg),
        gyro_bias_deg_h: reading.as_ref().map(|r| r.gyro_bias_deg_h.map(round)),
        accel_bias_ug: reading.as_ref().map(|r| r.accel_bias_ug.map(round)),
        imu_delay: imu_delay.map(|ImuDelay { delay_s, sd_s }| ImuDelay {
            delay_s: (delay_s * 1e7).round() / 1e7,
            sd_s: (sd_s * 1e7).round() / 1e7,
        }),
        measured_walk_deg_sqrt_h: aligner
            .measured_walk()
            .map(|walk| round(walk.to_f64() / DEG_PER_SQRT_HOUR)),
        reason,
    })
}

/// To a millionth: what is left of an f32 beyond is noise.
fn round(x: f64) -> f64 {
    (x * 1e6).round() / 1e6
}
