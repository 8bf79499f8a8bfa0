//! What the unit is told, and what it calls its modes: the words that log, modes and wire share.

use core::fmt;

/// What the unit is told to do.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Command {
    /// Stop the rotor and rest.
    Stop,
    /// Align from the beginning.
    Align,
    /// Calibrate the IMU: from rest only.
    Calibrate,
    /// Forget the fault and start again.
    ResetFault,
}

/// Names of the modes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[allow(missing_docs, reason = "as in Mode")]
pub enum ModeName {
    Idle,
    SelfTest,
    Homing,
    Calibrating,
    Coarse,
    Fine,
    Aligned,
    Fault,
}

impl ModeName {
    /// For people.
    pub const fn as_str(self) -> &'static str {
        match self {
            Self::Idle => "idle",
            Self::SelfTest => "self-test",
            Self::Homing => "homing",
            Self::Calibrating => "calibrating",
            Self::Coarse => "coarse",
            Self::Fine => "fine",
            Self::Aligned => "aligned",
            Self::Fault => "fault",
        }
    }
}

impl fmt::Display for ModeName {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.as_str())
    }
}
