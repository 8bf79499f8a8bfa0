//! What the unit tells: typed events, and the macros that carry them to defmt on the target and to the
//! `log` crate on a host.
//!
//! Only `{}` and `{:?}` are understood by both.

use core::fmt;

use drivers::sequence::Tally;
use drivers::{Error, Identity};
use frames::units::{ARC_MIN, DEG, DEG_PER_HOUR, PPM};
use nav::aligner;
use nav::calibration::{Calibration, CalibrationError};
use nav::navigator::NavigatorError;

use crate::command::{Command, ModeName};
use crate::fault::Fault;
use crate::selftest::Found;

/// One line of the given level; with neither feature its arguments are only looked at.
macro_rules! line {
    ($level:ident, $($arg:tt)*) => {{
        #[cfg(feature = "defmt")]
        ::defmt::$level!($($arg)*);
        #[cfg(all(feature = "log", not(feature = "defmt")))]
        ::log::$level!($($arg)*);
        #[cfg(not(any(feature = "defmt", feature = "log")))]
        let _ = ::core::format_args!($($arg)*);
    }};
}

/// Something worth a line.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Event {
    /// From one mode to the next.
    Mode {
        /// Left.
        from: ModeName,
        /// Entered.
        to: ModeName,
    },
    /// The IMU is configured.
    Imu(Identity),
    /// The encoder answers.
    Encoder,
    /// The first samples are what they should be.
    Inspected(Found),
    /// The motor is calibrated: the electrical angle at reading zero, rad.
    Calibrated {
        /// For the settings.
        offset: f32,
    },
    /// The turn is known.
    Homed {
        /// Where the rotor is, rad.
        angle: f32,
    },
    /// The aligner has told something.
    Alignment(Alignment),
    /// The gyros are calibrated; samples are corrected from here on.
    GyrosCalibrated(GyrosCalibrated),
    /// They are not; what was known before still holds.
    NotCalibrated(CalibrationFailure),
    /// Navigation cannot go on, and the unit aligns anew.
    NavigationEnded(NavigationEnd),
    /// A fault, and the motor is off.
    Fault(Fault),
    /// The retry after a fault begins.
    Retry {
        /// Which one.
        attempt: u8,
    },
    /// The fault stays until it is reset.
    Latched,
    /// Samples are missing.
    Lost {
        /// How many in this gap.
        samples: u16,
        /// Totals so far.
        tally: Tally,
    },
    /// A sample came again and was left out.
    Repeated {
        /// Totals so far.
        tally: Tally,
    },
    /// A transfer failed; its sample is lost.
    Transfer(Error),
    /// The alignment did not keep up; samples were dropped.
    Overrun {
        /// So many since the start.
        samples: u32,
    },
    /// A command was taken.
    Command(Command),
    /// A command makes no sense in this mode.
    Refused {
        /// The command.
        command: Command,
        /// The mode.
        mode: ModeName,
    },
    /// What the unit does, once a second.
    Report(Report),
}

/// What the unit does, in the units of people.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Report {
    /// Its mode.
    pub mode: ModeName,
    /// Heading, pitch, roll and the heading's 1σ, degrees, where there is an estimate.
    pub attitude_deg: Option<[f32; 4]>,
    /// Angle of the rotor, degrees; `None` while the turn is unknown.
    pub rotor_deg: Option<f32>,
}

impl Report {
    /// Of an estimate, and the rotor's angle, rad.
    pub fn new(mode: ModeName, estimate: Option<&aligner::Estimate>, rotor: Option<f32>) -> Self {
        let deg = |x: f32| x / DEG as f32;
        Self {
            mode,
            attitude_deg: estimate.map(|estimate| {
                let attitude = &estimate.attitude;
                [attitude.heading, attitude.pitch, attitude.roll, estimate.sd.heading].map(deg)
            }),
            rotor_deg: rotor.map(deg),
        }
    }
}

/// A number with so many digits behind the point. defmt has no such format.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Fixed<const DIGITS: u32> {
    negative: bool,
    whole: u16,
    fraction: u16,
}

impl<const DIGITS: u32> Fixed<DIGITS> {
    /// What is no number is told as more than any angle.
    fn new(x: f32) -> Self {
        let scale = 10_u32.pow(DIGITS);
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "saturates; NaN is made the greatest before"
        )]
        let steps = (x.abs().min(999.9) * scale as f32 + 0.5) as u32;
        #[expect(clippy::cast_possible_truncation, reason = "below 1000 both, as DIGITS is at most 3")]
        Self {
            negative: x < 0.0 && steps > 0,
            whole: (steps / scale) as u16,
            fraction: (steps % scale) as u16,
        }
    }

    const fn sign(self) -> &'static str {
        if self.negative { "-" } else { "+" }
    }
}

impl fmt::Display for Report {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.mode.column())?;
        if let Some([heading, pitch, roll, sd]) = self.attitude_deg {
            let (h, sd) = (Fixed::<2>::new(heading), Fixed::<3>::new(sd));
            let (p, r) = (Fixed::<2>::new(pitch), Fixed::<2>::new(roll));
            write!(
                f,
                " heading {:03}.{:02} deg, sd {}.{:03}",
                h.whole, h.fraction, sd.whole, sd.fraction
            )?;
            write!(f, ", pitch {}{:02}.{:02}", p.sign(), p.whole, p.fraction)?;
            write!(f, ", roll {}{:02}.{:02}", r.sign(), r.whole, r.fraction)?;
        }
        match self.rotor_deg.map(Fixed::<1>::new) {
            Some(a) => write!(f, " rotor {}{:03}.{}", a.sign(), a.whole, a.fraction),
            None => f.write_str(" rotor unknown"),
        }
    }
}

#[cfg(feature = "defmt")]
impl defmt::Format for Report {
    fn format(&self, f: defmt::Formatter<'_>) {
        defmt::write!(f, "{=str}", self.mode.column());
        if let Some([heading, pitch, roll, sd]) = self.attitude_deg {
            let (h, sd) = (Fixed::<2>::new(heading), Fixed::<3>::new(sd));
            let (p, r) = (Fixed::<2>::new(pitch), Fixed::<2>::new(roll));
            defmt::write!(
                f,
                " heading {=u16:03}.{=u16:02} deg, sd {=u16}.{=u16:03}",
                h.whole,
                h.fraction,
                sd.whole,
                sd.fraction
            );
            defmt::write!(f, ", pitch {=str}{=u16:02}.{=u16:02}", p.sign(), p.whole, p.fraction);
            defmt::write!(f, ", roll {=str}{=u16:02}.{=u16:02}", r.sign(), r.whole, r.fraction);
        }
        match self.rotor_deg.map(Fixed::<1>::new) {
            Some(a) => defmt::write!(f, " rotor {=str}{=u16:03}.{=u16}", a.sign(), a.whole, a.fraction),
            None => defmt::write!(f, " rotor unknown"),
        }
    }
}

/// What the calibration of the gyros has found, in the units of people.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct GyrosCalibrated {
    /// Biases, °/h; with Earth's rate in them, and left where they are, where that was not known.
    pub bias_deg_h: [f32; 3],
    /// Whether Earth's rate was known, so that the biases are taken off.
    pub biases_used: bool,
    /// What x and y take of a turn about z, arc minutes.
    pub misalignment_arcmin: [f32; 2],
    /// Scale factor error of z, ppm.
    pub scale_factor_ppm: f32,
    /// 1σ of each bias, °/h.
    pub bias_sd_deg_h: f32,
    /// 1σ of the other three, ppm.
    pub column_sd_ppm: f32,
}

impl GyrosCalibrated {
    /// Of a calibration.
    pub fn new(found: &Calibration, biases_used: bool) -> Self {
        Self {
            bias_deg_h: (found.bias_s / DEG_PER_HOUR as f32).to_array(),
            biases_used,
            misalignment_arcmin: [found.k_xz, found.k_yz].map(|k| k / ARC_MIN as f32),
            scale_factor_ppm: found.s_z / PPM as f32,
            bias_sd_deg_h: found.bias_sd / DEG_PER_HOUR as f32,
            column_sd_ppm: found.column_sd / PPM as f32,
        }
    }
}

/// Why the gyros are not calibrated.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum CalibrationFailure {
    /// The rotor moved while it should have stood.
    RotorMoved,
    /// The base moves.
    BaseMoved {
        /// Variance of the worst axis' residuals over the predicted one.
        scatter: f32,
    },
    /// Samples that cannot be, or figures that cannot.
    Refused,
    /// It took too long: the rotor does not come to rest, samples are missing.
    Timeout,
}

impl From<CalibrationError> for CalibrationFailure {
    fn from(error: CalibrationError) -> Self {
        match error {
            CalibrationError::RotorMoved { .. } => Self::RotorMoved,
            CalibrationError::BaseMoved { scatter } => Self::BaseMoved { scatter },
            _ => Self::Refused,
        }
    }
}

impl fmt::Display for CalibrationFailure {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::RotorMoved => f.write_str("the rotor moved while it should have stood"),
            Self::BaseMoved { scatter } => write!(
                f,
                "the base moves, residuals have {scatter:.1} times their variance: set the unit on firm ground"
            ),
            Self::Refused => f.write_str("samples or figures that cannot be"),
            Self::Timeout => f.write_str("it took too long"),
        }
    }
}

/// Why navigation ended.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum NavigationEnd {
    /// Nothing to begin from.
    NotAligned,
    /// No data for too long.
    Gap {
        /// How long, s.
        length: f32,
    },
    /// A sample that cannot be.
    BadSample,
    /// A place or a velocity that cannot be.
    Lost,
}

impl From<NavigatorError> for NavigationEnd {
    fn from(error: NavigatorError) -> Self {
        match error {
            NavigatorError::Gap { length } => Self::Gap { length },
            NavigatorError::Sample => Self::BadSample,
            NavigatorError::Mechanization(_) => Self::Lost,
        }
    }
}

impl fmt::Display for NavigationEnd {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::NotAligned => f.write_str("there is no estimate to begin from"),
            Self::Gap { length } => write!(f, "{length:.3} s without data"),
            Self::BadSample => f.write_str("an impossible sample"),
            Self::Lost => f.write_str("place or velocity are impossible"),
        }
    }
}

/// What the aligner told, in the units of people.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Alignment {
    /// Coarse alignment has succeeded.
    CoarseDone {
        /// Degrees.
        heading_deg: f32,
        /// Its predicted 1σ, degrees.
        sd_deg: f32,
    },
    /// The fine filter is at the present.
    CaughtUp,
    /// Heading is within its set σ.
    Aligned,
    /// Not any more: the heading's σ is too large.
    HeadingSd {
        /// 1σ, degrees.
        sd_deg: f32,
    },
    /// Another heading would fit as well.
    Ambiguous {
        /// By how much it differs, degrees.
        heading_offset_deg: f32,
    },
    /// The innovations do not fit a base that only swings.
    Inconsistent {
        /// Mean of innovation²/variance.
        ratio: f32,
    },
    /// Still collecting.
    Collecting,
    /// Missing data were bridged.
    Bridged {
        /// How long, ms.
        ms: f32,
    },
    /// Starts anew: no attitude was found.
    RestartedCoarse,
    /// Starts anew: no data for too long.
    RestartedGap {
        /// How long, s.
        length: f32,
    },
    /// Starts anew: a sample that cannot be.
    RestartedBadSample,
    /// Starts anew: the filter diverged.
    RestartedDiverged,
    /// Starts anew, once the base stands: it is under way, by a receiver's word.
    UnderWay {
        /// m/s.
        speed: f32,
    },
}

impl From<&aligner::Event> for Alignment {
    fn from(event: &aligner::Event) -> Self {
        use aligner::{Event, NotReady, Restart};
        let deg = |x: f32| x / DEG as f32;
        match *event {
            Event::CoarseDone { attitude, sd } => Self::CoarseDone {
                heading_deg: deg(attitude.heading),
                sd_deg: deg(sd.heading),
            },
            Event::CaughtUp => Self::CaughtUp,
            Event::Aligned => Self::Aligned,
            Event::Lost(NotReady::HeadingSd { sd }) => Self::HeadingSd { sd_deg: deg(sd) },
            Event::Lost(NotReady::Ambiguous { heading_offset, .. }) => Self::Ambiguous {
                heading_offset_deg: deg(heading_offset),
            },
            Event::Lost(NotReady::Inconsistent { ratio }) => Self::Inconsistent { ratio },
            Event::Lost(NotReady::Collecting { .. } | NotReady::CatchingUp { .. }) => Self::Collecting,
            Event::Bridged { length } => Self::Bridged { ms: 1e3 * length },
            Event::Restarted(Restart::Coarse(_)) => Self::RestartedCoarse,
            Event::Restarted(Restart::Gap { length }) => Self::RestartedGap { length },
            Event::Restarted(Restart::BadSample) => Self::RestartedBadSample,
            Event::Restarted(Restart::Diverged) => Self::RestartedDiverged,
        }
    }
}

impl fmt::Display for Alignment {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match *self {
            Self::CoarseDone { heading_deg, sd_deg } => {
                write!(f, "coarse alignment: heading {heading_deg:.2} deg, sd {sd_deg:.2}")
            }
            Self::CaughtUp => f.write_str("fine filter is live"),
            Self::Aligned => f.write_str("aligned"),
            Self::HeadingSd { sd_deg } => write!(f, "no longer aligned: heading sd {sd_deg:.2} deg"),
            Self::Ambiguous { heading_offset_deg } => {
                write!(
                    f,
                    "no longer aligned: a heading {heading_offset_deg:.1} deg off fits as well"
                )
            }
            Self::Inconsistent { ratio } => write!(
                f,
                "no longer aligned: innovations are {ratio:.1} times the model's variance; does the base move?"
            ),
            Self::Collecting => f.write_str("collecting"),
            Self::Bridged { ms } => write!(f, "{ms:.1} ms without data, bridged"),
            Self::RestartedCoarse => f.write_str("starting anew: coarse alignment found no attitude"),
            Self::RestartedGap { length } => write!(f, "starting anew: {length:.3} s without data"),
            Self::RestartedBadSample => f.write_str("starting anew: an impossible sample"),
            Self::RestartedDiverged => f.write_str("starting anew: the fine filter diverged"),
            Self::UnderWay { speed } => write!(f, "starting anew once the base stands: it makes {speed:.1} m/s"),
        }
    }
}

impl fmt::Display for Event {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let deg = |x: f32| x / DEG as f32;
        match self {
            Self::Mode { from, to } => write!(f, "mode {from} -> {to}"),
            Self::Imu(id) => write!(
                f,
                "IMU {} revision {:#06x} serial {} configured",
                id.product, id.revision, id.serial
            ),
            Self::Encoder => f.write_str("encoder answers"),
            Self::Inspected(found) => write!(
                f,
                "at start: f {:.4} m/s2, rate {:.4} deg/s, sd {:.4}",
                found.gravity,
                deg(found.rate),
                deg(found.rate_sd)
            ),
            Self::Calibrated { offset } => write!(f, "motor calibrated: electrical offset {:.2} deg", deg(*offset)),
            Self::Homed { angle } => write!(f, "homed: rotor at {:.2} deg", deg(*angle)),
            Self::Alignment(told) => told.fmt(f),
            Self::GyrosCalibrated(found) => {
                let ([x, y, z], [kx, ky]) = (found.bias_deg_h, found.misalignment_arcmin);
                write!(
                    f,
                    "gyros calibrated: z scale factor {:.0} ppm, x and y take {kx:.2}' and {ky:.2}' of z, sd {:.0} ppm; \
                     biases {x:.2} {y:.2} {z:.2} deg/h {}, sd {:.2}",
                    found.scale_factor_ppm,
                    found.column_sd_ppm,
                    if found.biases_used {
                        "taken off"
                    } else {
                        "with Earth's rate, left"
                    },
                    found.bias_sd_deg_h
                )
            }
            Self::NotCalibrated(failure) => write!(f, "gyros not calibrated: {failure}"),
            Self::NavigationEnded(why) => write!(f, "aligning anew, navigation cannot go on: {why}"),
            Self::Fault(fault) => write!(f, "fault {}: {fault}", fault.name()),
            Self::Retry { attempt } => write!(f, "starting again, attempt {attempt}"),
            Self::Latched => f.write_str("fault latched: reset it by command"),
            Self::Lost { samples, tally } => write!(f, "{samples} samples lost, {} in all", tally.lost),
            Self::Repeated { tally } => write!(f, "sample repeated, {} in all", tally.repeated),
            Self::Transfer(error) => write!(f, "sample lost: {error}"),
            Self::Overrun { samples } => write!(f, "alignment does not keep up: {samples} samples dropped"),
            Self::Command(command) => write!(f, "command {command:?}"),
            Self::Refused { command, mode } => write!(f, "command {command:?} makes no sense in mode {mode}"),
            Self::Report(report) => report.fmt(f),
        }
    }
}

/// How grave an event is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[allow(missing_docs, reason = "as everywhere")]
pub enum Level {
    Error,
    Warn,
    Info,
    Debug,
}

impl Level {
    /// All there are, the gravest first.
    pub const ALL: [Self; 4] = [Self::Error, Self::Warn, Self::Info, Self::Debug];

    /// As it is typed.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Error => "error",
            Self::Warn => "warn",
            Self::Info => "info",
            Self::Debug => "debug",
        }
    }
}

impl Event {
    /// Its level.
    pub const fn level(&self) -> Level {
        match self {
            Self::Fault(_) | Self::Latched => Level::Error,
            Self::Retry { .. }
            | Self::NotCalibrated(_)
            | Self::NavigationEnded(_)
            | Self::Overrun { .. }
            | Self::Refused { .. }
            | Self::Transfer(_) => Level::Warn,
            Self::Repeated { .. } | Self::Alignment(Alignment::Bridged { .. }) => Level::Debug,
            // Where nothing happens nobody wants to read it.
            Self::Report(report) if matches!(report.mode, ModeName::Idle | ModeName::Fault) => Level::Debug,
            _ => Level::Info,
        }
    }

    /// Tells it, whatever the level.
    pub(crate) fn emit(&self) {
        match self.level() {
            Level::Error => line!(error, "{}", self),
            Level::Warn => line!(warn, "{}", self),
            Level::Info => line!(info, "{}", self),
            Level::Debug => line!(debug, "{}", self),
        }
    }
}
