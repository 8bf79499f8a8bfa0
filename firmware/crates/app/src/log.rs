//! What the unit tells: typed events, carried to defmt on the target and to the `log` crate on a host.
//!
//! One text for both: each type in here, and each that stands in one of its texts, has it from [`frames::wording!`].

use drivers::sequence::Tally;
use drivers::{Error, Identity};
use frames::units::{ARC_MIN, DEG, DEG_PER_HOUR, PPM};
use frames::wording;
use nav::aligner;
use nav::calibration::{Calibration, CalibrationError};
use nav::navigator::NavigatorError;

use crate::blackbox::Start;
use crate::command::{Command, ModeName};
use crate::fault::Fault;
use crate::fixed_decimal::{deg, deg_sqrt_h, fixed_decimal};
use crate::hal::{ClockSource, Supply};
use crate::selftest::Found;
use crate::settings;

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

/// The first lines: of which version the program is, how the unit came up, and where its clock is not what it should be.
pub fn started(version: &str, start: &Start, clock: ClockSource) {
    line!(info, "rotary-north {}", version);
    line!(info, "{}", start);
    if !clock.is_exact() {
        line!(
            warn,
            "clock: nothing came in, the chip's own is off by up to 8 % and no heading is valid: check the clock input, restart"
        );
    }
}

/// A line for each group of settings that is not as it was last saved, and for what says nothing of its group.
pub fn settings(report: &settings::Report) {
    for (group, origin) in report.wanting() {
        line!(warn, "settings: {} {}", group, origin);
    }
    if report.error.is_some() {
        line!(
            error,
            "settings: the flash cannot be read, the defaults hold for the rest: check its supply and its protection"
        );
    } else if report.damaged > 0 {
        line!(
            warn,
            "settings: {} damaged stretches of flash, see what show says: a group whose record was there holds an older value or the default",
            report.damaged
        );
    }
}

/// A line where nothing cuts off a save whose supply falls.
pub fn supply(supply: &impl Supply) {
    if !supply.is_guarded() {
        line!(
            warn,
            "settings: the brown-out level is below 2.7 V, a save while the supply falls may be spoilt: set BOR_LEV, see the wiring"
        );
    }
}

/// Something worth a line.
#[derive(Debug, Clone, Copy, PartialEq)]
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
    /// The gyros' noise is far above what the settings say.
    Noisy(Found),
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
    /// The biases that were found with it.
    GyroBiases(GyrosCalibrated),
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
    /// A sample came late, though none is missing by the count.
    Slipped {
        /// By how much, s.
        late: f32,
    },
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

wording!(Report, |self, say| {
    say!("{}", self.mode.column());
    match self.rotor_deg {
        Some(rotor) => say!(" rotor {} deg", fixed_decimal(rotor, 1).signed().column(3)),
        None => say!(" rotor unknown"),
    }
    if let Some([heading, pitch, roll, sd]) = self.attitude_deg {
        say!(", heading {} deg", fixed_decimal(heading, 2).column(3));
        say!(", sd {} deg", fixed_decimal(sd, 3).column(2));
        say!(", pitch {} deg", fixed_decimal(pitch, 2).signed().column(2));
        say!(", roll {} deg", fixed_decimal(roll, 2).signed().column(2));
    }
});

/// What the calibration of the gyros has found, in the units of people.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct GyrosCalibrated {
    /// Biases, °/h; with Earth's rate in them where that was not known.
    pub bias_deg_h: [f32; 3],
    /// Whether they are taken off: where Earth's rate was known, or is a small part of what they differ by from those known.
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

/// How a calibration of the gyros has ended.
pub type CalibrationEnd = Result<GyrosCalibrated, CalibrationFailure>;

/// Why the gyros are not calibrated.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum CalibrationFailure {
    /// The rotor moved while it should rest.
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

impl CalibrationFailure {
    /// The same without figures and advice, as long as a sentence of NMEA 0183 has room for.
    pub const fn brief(self) -> &'static str {
        match self {
            Self::RotorMoved => "the rotor moved while it should rest",
            Self::BaseMoved { .. } => "the base moves",
            Self::Refused => "samples or figures that cannot be",
            Self::Timeout => "it took too long",
        }
    }
}

wording!(CalibrationFailure, |self, say| {
    say!("{}", self.brief());
    if let Self::BaseMoved { scatter } = *self {
        say!(
            ", residuals have {} times their variance: set the unit on firm ground",
            fixed_decimal(scatter, 1)
        );
    }
});

/// Why navigation ended.
#[derive(Debug, Clone, Copy, PartialEq)]
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

wording!(NavigationEnd, |self, say| {
    match *self {
        Self::NotAligned => say!("there is no estimate to begin from"),
        Self::Gap { length } => say!("{} s without data", fixed_decimal(length, 3)),
        Self::BadSample => say!("an impossible sample"),
        Self::Lost => say!("place or velocity are impossible"),
    }
});

/// What the aligner told, in the units of people.
#[derive(Debug, Clone, Copy, PartialEq)]
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
    /// The innovations do not fit a base that stays where it is, swinging and swaying.
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
    /// Starts anew, once the base stands: it is under way, by a receiver's fixes.
    UnderWay {
        /// m/s.
        speed: f32,
    },
    /// Starts anew: the place is another, by a receiver's fixes.
    Elsewhere {
        /// Latitude there, degrees.
        latitude_deg: f32,
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

wording!(Alignment, |self, say| {
    match *self {
        Self::CoarseDone { heading_deg, sd_deg } => say!(
            "coarse alignment: heading {} deg, sd {} deg",
            fixed_decimal(heading_deg, 2),
            fixed_decimal(sd_deg, 2)
        ),
        Self::CaughtUp => say!("fine filter is live"),
        Self::Aligned => say!("aligned"),
        Self::HeadingSd { sd_deg } => say!("no longer aligned: heading sd {} deg", fixed_decimal(sd_deg, 2)),
        Self::Ambiguous { heading_offset_deg } => say!(
            "no longer aligned: a heading {} deg off fits as well",
            fixed_decimal(heading_offset_deg, 1)
        ),
        Self::Inconsistent { ratio } => say!(
            "no longer aligned: innovations are {} times the model's variance; does the base travel?",
            fixed_decimal(ratio, 1)
        ),
        Self::Collecting => say!("collecting"),
        Self::Bridged { ms } => say!("{} ms without data, bridged", fixed_decimal(ms, 1)),
        Self::RestartedCoarse => say!("starting anew: coarse alignment found no attitude"),
        Self::RestartedGap { length } => say!("starting anew: {} s without data", fixed_decimal(length, 3)),
        Self::RestartedBadSample => say!("starting anew: an impossible sample"),
        Self::RestartedDiverged => say!("starting anew: the fine filter diverged"),
        Self::UnderWay { speed } => say!(
            "starting anew once the base stands: it makes {} m/s",
            fixed_decimal(speed, 1)
        ),
        Self::Elsewhere { latitude_deg } => {
            say!(
                "starting anew: by the receiver the unit is at latitude {} deg",
                fixed_decimal(latitude_deg, 1)
            )
        }
    }
});

wording!(Event, |self, say| {
    match self {
        Self::Mode { from, to } => say!("mode {} -> {}", from, to),
        Self::Imu(id) => say!(
            "IMU {} revision {:#06x} serial {} configured",
            id.product,
            id.revision,
            id.serial
        ),
        Self::Encoder => say!("encoder answers"),
        Self::Inspected(found) => say!(
            "at start: force {} m/s2, rate {} deg/s, sd {} deg/s, gyro noise {} deg/sqrt(h)",
            fixed_decimal(found.gravity, 4),
            deg(found.rate, 4),
            deg(found.rate_sd, 4),
            deg_sqrt_h(found.noise)
        ),
        Self::Noisy(found) => say!(
            "gyro noise {} deg/sqrt(h), the settings say {}: heading is worse than its sd, set gyro-arw",
            deg_sqrt_h(found.noise),
            deg_sqrt_h(found.noise_told)
        ),
        Self::Calibrated { offset } => say!("motor calibrated: electrical offset {} deg", deg(*offset, 2)),
        Self::Homed { angle } => say!("homed: rotor at {} deg", deg(*angle, 2)),
        Self::Alignment(told) => say!("{}", told),
        Self::GyrosCalibrated(found) => {
            let [x, y] = found.misalignment_arcmin.map(|angle| fixed_decimal(angle, 2).signed());
            say!(
                "gyros calibrated: z scale factor {} ppm, x and y take {}' and {}' of z, sd {} ppm",
                fixed_decimal(found.scale_factor_ppm, 0).signed(),
                x,
                y,
                fixed_decimal(found.column_sd_ppm, 0)
            );
        }
        Self::GyroBiases(found) => {
            let [x, y, z] = found.bias_deg_h.map(|bias| fixed_decimal(bias, 2).signed());
            say!(
                "gyro biases {}: {} {} {} deg/h, sd {} deg/h",
                if found.biases_used {
                    "taken off"
                } else {
                    "left, Earth's rate in them"
                },
                x,
                y,
                z,
                fixed_decimal(found.bias_sd_deg_h, 2)
            );
        }
        Self::NotCalibrated(failure) => say!("gyros not calibrated: {}", failure),
        Self::NavigationEnded(why) => say!("aligning anew, navigation cannot go on: {}", why),
        Self::Fault(fault) => say!("fault {}: {}", fault.name(), fault),
        Self::Retry { attempt } => say!("starting again, attempt {}", attempt),
        Self::Latched => say!("fault latched: reset it by command"),
        Self::Slipped { late } => say!("a sample came {} ms late", fixed_decimal(late * 1e3, 2)),
        Self::Lost { samples, tally } => say!("{} samples lost, {} in all", samples, tally.lost),
        Self::Repeated { tally } => say!("sample repeated, {} in all", tally.repeated),
        Self::Transfer(error) => say!("sample lost: {}", error),
        Self::Overrun { samples } => say!("alignment does not keep up: {} samples dropped", samples),
        Self::Command(command) => say!("command {}", command),
        Self::Refused { command, mode } => say!("command {} makes no sense in mode {}", command, mode),
        Self::Report(report) => say!("{}", report),
    }
});

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
            | Self::Noisy(_)
            | Self::Slipped { .. }
            | Self::Transfer(_) => Level::Warn,
            Self::Repeated { .. } | Self::Alignment(Alignment::Bridged { .. }) => Level::Debug,
            // Where nothing happens nobody wants to read it.
            Self::Report(report) if matches!(report.mode, ModeName::Idle | ModeName::Fault) => Level::Debug,
            _ => Level::Info,
        }
    }

    /// How a calibration of the gyros has ended, where that is what it tells.
    pub(crate) const fn calibration_end(&self) -> Option<CalibrationEnd> {
        match *self {
            Self::GyrosCalibrated(found) => Some(Ok(found)),
            Self::NotCalibrated(failure) => Some(Err(failure)),
            _ => None,
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
