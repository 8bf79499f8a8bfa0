//! What stops the rotor, and what it is not ready for.

use core::fmt;

/// Degrees for people.
const IN_DEG: f32 = 57.295_78;

/// Why the outputs are off until [`Command::Clear`](super::Command::Clear). Angles in rad, rates in rad/s.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum RotorFault {
    /// The bridge pulls its fault line.
    Driver,
    /// Too many bad readings in a row: silent, wrong check sum, or an angle the rotor cannot have reached.
    EncoderInvalid,
    /// The encoder repeats itself while the rotor ought to turn. Or the rotor was stopped dead.
    EncoderFrozen,
    /// The rotor is outside its travel. Clear it and home: the search leads back.
    Travel {
        /// Where it is.
        angle: f32,
    },
    /// A set-point that leads out of the travel was about to be followed.
    SetPoint {
        /// The set-point.
        angle: f32,
    },
    /// The rotor does not keep up with its set-point.
    Following {
        /// Set-point minus angle.
        error: f32,
    },
    /// The voltage is at its limit and the rotor stands.
    Stall {
        /// Where it stands.
        angle: f32,
    },
    /// The rotor is faster than anything asked of it.
    Overspeed {
        /// Its rate.
        rate: f32,
    },
    /// The rotor does not come to rest with the outputs off, or swings about an aligned field.
    Unsettled {
        /// Its rate.
        rate: f32,
    },
    /// The field does not move the rotor: a phase is open, the rotor is blocked, or the voltage too small.
    NoMovement {
        /// How far it went.
        moved: f32,
    },
    /// The rotor turns against the field: two phases are exchanged, or the encoder counts the other way.
    WrongDirection {
        /// How far it went.
        moved: f32,
    },
    /// One electrical cycle is another share of a turn than the pole pairs say.
    PolePairs {
        /// As configured.
        expected: u8,
        /// As measured.
        measured: f32,
    },
    /// The contacts of the home switch contradict each other.
    HomeInvalid,
    /// No edge of the home switch where one must be.
    HomeNotFound {
        /// How far it was searched for.
        searched: f32,
    },
    /// The edge is not where the encoder has it: the switch, the encoder's magnet or its zero has moved.
    HomeMisplaced {
        /// By how much.
        off: f32,
    },
    /// The home switch is on the wrong side for this angle: one of the two is wrong, or the cable is a turn off.
    HomeMismatch {
        /// The angle.
        angle: f32,
    },
}

impl RotorFault {
    /// Whether the turn must be found anew after it.
    pub fn loses_home(self) -> bool {
        matches!(
            self,
            Self::EncoderInvalid | Self::EncoderFrozen | Self::HomeMismatch { .. } | Self::HomeMisplaced { .. }
        )
    }
}

impl fmt::Display for RotorFault {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match *self {
            Self::Driver => f.write_str("the motor driver reports a fault: over-current, heat or supply"),
            Self::EncoderInvalid => f.write_str("the encoder sends no usable angle: check magnet and wiring"),
            Self::EncoderFrozen => f.write_str("the encoder repeats one angle while the rotor ought to turn"),
            Self::Travel { angle } => write!(f, "the rotor is at {:.1} deg, outside its travel", angle * IN_DEG),
            Self::SetPoint { angle } => write!(f, "set-point {:.1} deg is outside the travel", angle * IN_DEG),
            Self::Following { error } => write!(f, "the rotor is {:.1} deg off its set-point", error * IN_DEG),
            Self::Stall { angle } => write!(f, "the rotor is blocked at {:.1} deg", angle * IN_DEG),
            Self::Overspeed { rate } => write!(f, "the rotor turns at {:.0} deg/s", rate * IN_DEG),
            Self::Unsettled { rate } => write!(f, "the rotor does not come to rest: {:.1} deg/s", rate * IN_DEG),
            Self::NoMovement { moved } => write!(
                f,
                "the motor does not turn the rotor ({:.1} deg): check phases, supply and free travel",
                moved * IN_DEG
            ),
            Self::WrongDirection { moved } => write!(
                f,
                "the motor turns the rotor the wrong way ({:.1} deg): check phase order and encoder direction",
                moved * IN_DEG
            ),
            Self::PolePairs { expected, measured } => {
                write!(f, "the motor has {measured:.1} pole pairs, configured are {expected}")
            }
            Self::HomeInvalid => f.write_str("the contacts of the home switch contradict each other: check its wiring"),
            Self::HomeNotFound { searched } => {
                write!(f, "no edge of the home switch within {:.0} deg", searched * IN_DEG)
            }
            Self::HomeMisplaced { off } => write!(
                f,
                "home switch and encoder disagree by {:.1} deg: check both, then set the encoder's zero anew",
                off * IN_DEG
            ),
            Self::HomeMismatch { angle } => write!(
                f,
                "at {:.1} deg the home switch is on the other side: check switch and cable before turning the rotor",
                angle * IN_DEG
            ),
        }
    }
}

impl core::error::Error for RotorFault {}

/// Why a command is not carried out. Nothing has changed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Refused {
    /// A fault is latched: clear it first.
    Latched,
    /// Something else is under way: stop it first.
    Busy,
    /// There is no reading of the encoder yet, or none any more.
    NoAngle,
    /// The contacts of the home switch contradict each other, or were not read yet: no direction is safe.
    NoHome,
    /// The electrical offset is unknown: calibrate first.
    NotCalibrated,
    /// The turn is unknown: home first.
    NotHomed,
    /// The angle asked for is outside the travel, or no number.
    OutsideTravel,
}

impl fmt::Display for Refused {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Latched => "the rotor has a fault: clear it first",
            Self::Busy => "the rotor is busy: stop it first",
            Self::NoAngle => "the encoder gives no angle",
            Self::NoHome => "the home switch tells no side: check its wiring",
            Self::NotCalibrated => "the motor is not calibrated: calibrate first",
            Self::NotHomed => "the rotor is not homed: home first",
            Self::OutsideTravel => "the angle is outside the travel",
        })
    }
}

impl core::error::Error for Refused {}
