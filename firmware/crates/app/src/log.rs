//! What the unit tells: typed events, and the macros that carry them to defmt on the target and to the
//! `log` crate on a host.
//!
//! Only `{}` and `{:?}` are understood by both.

use core::fmt;

use drivers::sequence::Tally;
use drivers::{Error, Identity};
use frames::units::DEG;
use nav::aligner;

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
            Self::Fault(fault) => write!(f, "fault {}: {fault}", fault.name()),
            Self::Retry { attempt } => write!(f, "starting again, attempt {attempt}"),
            Self::Latched => f.write_str("fault latched: reset it by command"),
            Self::Lost { samples, tally } => write!(f, "{samples} samples lost, {} in all", tally.lost),
            Self::Repeated { tally } => write!(f, "sample repeated, {} in all", tally.repeated),
            Self::Transfer(error) => write!(f, "sample lost: {error}"),
            Self::Overrun { samples } => write!(f, "alignment does not keep up: {samples} samples dropped"),
            Self::Command(command) => write!(f, "command {command:?}"),
            Self::Refused { command, mode } => write!(f, "command {command:?} makes no sense in mode {mode}"),
        }
    }
}

impl Event {
    /// Tells it, at the level of its kind.
    pub fn emit(&self) {
        match self {
            Self::Fault(_) | Self::Latched => line!(error, "{}", self),
            Self::Retry { .. } | Self::Overrun { .. } | Self::Refused { .. } | Self::Transfer(_) => {
                line!(warn, "{}", self);
            }
            Self::Lost { .. } | Self::Repeated { .. } | Self::Alignment(Alignment::Bridged { .. }) => {
                line!(debug, "{}", self);
            }
            _ => line!(info, "{}", self),
        }
    }
}
