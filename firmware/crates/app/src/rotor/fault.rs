//! What stops the rotor, and what it is not ready for.

use frames::wording;

use crate::fixed_decimal::{deg, fixed_decimal};

/// Why the outputs are off until [`Command::Clear`](super::Command::Clear). Angles in rad, rates in rad/s.
#[derive(Debug, Clone, Copy, PartialEq)]
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
    /// Calibration or search have not ended in the time that they have for it.
    Endless,
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

wording!(RotorFault, |self, say| {
    match *self {
        Self::Driver => say!("the motor driver reports a fault: over-current, heat or supply"),
        Self::EncoderInvalid => say!("the encoder sends no usable angle: check magnet and wiring"),
        Self::EncoderFrozen => say!("the encoder repeats one angle while the rotor ought to turn"),
        Self::Travel { angle } => say!("the rotor is at {} deg, outside its travel", deg(angle, 1)),
        Self::SetPoint { angle } => say!("set-point {} deg is outside the travel", deg(angle, 1)),
        Self::Following { error } => say!("the rotor is {} deg off its set-point", deg(error, 1)),
        Self::Stall { angle } => say!("the rotor is blocked at {} deg", deg(angle, 1)),
        Self::Overspeed { rate } => say!("the rotor turns at {} deg/s", deg(rate, 0)),
        Self::Unsettled { rate } => say!("the rotor does not come to rest: {} deg/s", deg(rate, 1)),
        Self::NoMovement { moved } => say!(
            "the motor does not turn the rotor ({} deg): check phases, supply and free travel",
            deg(moved, 1)
        ),
        Self::WrongDirection { moved } => say!(
            "the motor turns the rotor the wrong way ({} deg): check phase order and encoder direction",
            deg(moved, 1)
        ),
        Self::PolePairs { expected, measured } => say!(
            "the motor has {} pole pairs, configured are {}",
            fixed_decimal(measured, 1),
            expected
        ),
        Self::Endless => say!("calibration and search do not end: check free travel, friction and a base that moves"),
        Self::HomeInvalid => say!("the contacts of the home switch contradict each other: check its wiring"),
        Self::HomeNotFound { searched } => {
            say!("no edge of the home switch within {} deg", deg(searched, 0));
        }
        Self::HomeMisplaced { off } => say!(
            "home switch and encoder disagree by {} deg: check both, then set the encoder's zero anew",
            deg(off, 1)
        ),
        Self::HomeMismatch { angle } => say!(
            "at {} deg the home switch is on the other side: check switch and cable before turning the rotor",
            deg(angle, 1)
        ),
    }
});

impl core::error::Error for RotorFault {}

/// Why a command is not carried out. Nothing has changed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
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

wording!(Refused, |self, say| {
    match self {
        Self::Latched => say!("the rotor has a fault: clear it first"),
        Self::Busy => say!("the rotor is busy: stop it first"),
        Self::NoAngle => say!("the encoder gives no angle"),
        Self::NoHome => say!("the home switch tells no side: check its wiring"),
        Self::NotCalibrated => say!("the motor is not calibrated: calibrate first"),
        Self::NotHomed => say!("the rotor is not homed: home first"),
        Self::OutsideTravel => say!("the angle is outside the travel"),
    }
});

impl core::error::Error for Refused {}
