//! Commands to the unit and names of its modes, shared by log, modes and wire.

use frames::wording;

/// A command to the unit.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
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

    /// As it is typed.
    pub const fn as_str(self) -> &'static str {
        match self {
            Self::Stop => "stop",
            Self::Align => "align",
            Self::Calibrate => "calibrate",
            Self::Navigate => "navigate",
            Self::SelfTest => "selftest",
            Self::ResetFault => "reset",
            Self::Restart => "restart",
        }
    }
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

    /// Whether the modes take a command in this mode; elsewhere they refuse it. But for a fault that only a reset of the
    /// unit ends: it takes a stop only, and is about to get one.
    pub const fn takes(self, command: Command) -> bool {
        match command {
            Command::ResetFault => matches!(self, Self::Fault),
            Command::Restart | Command::Stop => true,
            Command::Align => !matches!(self, Self::Fault | Self::SelfTest | Self::Homing),
            Command::Calibrate => matches!(self, Self::Idle | Self::Aligned),
            Command::Navigate => matches!(self, Self::Aligned),
            Command::SelfTest => matches!(self, Self::Idle),
        }
    }

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

wording!(ModeName, |self, say| {
    say!("{}", self.as_str());
});

wording!(Command, |self, say| {
    say!("{}", self.as_str());
});

#[cfg(test)]
mod tests {
    use std::string::ToString as _;

    use super::*;
    use crate::console::{self, Request};

    #[test]
    fn a_command_is_told_as_it_is_typed() {
        for command in Command::ALL {
            let typed = command.to_string();
            assert_eq!(
                console::parse(typed.as_bytes()),
                Ok(Some(Request::Unit(command))),
                "{typed}"
            );
        }
    }

    #[test]
    fn columns_are_equal() {
        for mode in ModeName::ALL {
            assert_eq!(mode.column().trim_end(), mode.to_string());
            assert_eq!(mode.column().len(), ModeName::Calibrating.column().len());
        }
    }
}
