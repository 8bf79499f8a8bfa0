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
    /// Calibrate the gyros, a minute at rest and a minute turning: from rest, or once aligned.
    Calibrate,
    /// Navigate from here on: once aligned.
    Navigate,
    /// Test everything, then rest: from rest only.
    SelfTest,
    /// Forget the fault and start again.
    ResetFault,
    /// Start the program anew.
    Restart,
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
    Navigating,
    Fault,
}

impl Command {
    /// All there are.
    pub const ALL: [Self; 7] = [
        Self::Stop,
        Self::Align,
        Self::Calibrate,
        Self::Navigate,
        Self::SelfTest,
        Self::ResetFault,
        Self::Restart,
    ];
}

impl ModeName {
    /// All there are.
    pub const ALL: [Self; 9] = [
        Self::Idle,
        Self::SelfTest,
        Self::Homing,
        Self::Calibrating,
        Self::Coarse,
        Self::Fine,
        Self::Aligned,
        Self::Navigating,
        Self::Fault,
    ];

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
            Self::Navigating => "navigating",
            Self::Fault => "fault",
        }
    }
}

impl ModeName {
    /// [`ModeName::as_str`] with blanks, for a column: the longest has eleven letters.
    pub const fn column(self) -> &'static str {
        match self {
            Self::Idle => "idle       ",
            Self::SelfTest => "self-test  ",
            Self::Homing => "homing     ",
            Self::Calibrating => "calibrating",
            Self::Coarse => "coarse     ",
            Self::Fine => "fine       ",
            Self::Aligned => "aligned    ",
            Self::Navigating => "navigating ",
            Self::Fault => "fault      ",
        }
    }
}

impl fmt::Display for ModeName {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.as_str())
    }
}
