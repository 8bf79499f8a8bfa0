//! Commands on the serial line: the parser, pure. A line of text in, a [`Request`] or what was expected out.
//!
//! ```text
//! help               what there is
//! status             the status sentence, now
//! version            of the program
//! align              align from the beginning
//! calibrate          calibrate the IMU: from rest only
//! stop               stop the rotor and rest
//! reset              forget the fault and start again
//! ```
//!
//! Upper and lower case are the same, blanks more or less as well; an empty line, or one that begins with `#`, is
//! nothing. [`LineBuffer`] makes lines of bytes: they end with CR or LF, backspace takes one back, and a line longer
//! than [`LONGEST`] or with a byte that is no text is refused as a whole, up to its end, so that no part of it is
//! taken for a command.

use core::fmt;

use heapless::Vec;

use crate::command::{Command, ModeName};

/// Longest line without its end, bytes.
pub const LONGEST: usize = 64;

/// What a line asks for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Request {
    /// What there is.
    Help,
    /// The status sentence.
    Status,
    /// The program's version.
    Version,
    /// Something for the modes.
    Unit(Command),
}

/// A word of the console.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Word {
    /// As it is typed, in lower case.
    pub name: &'static str,
    /// What it asks for.
    pub request: Request,
    /// What it does, for `help`.
    pub help: &'static str,
}

/// All words there are.
pub const WORDS: [Word; 7] = [
    Word {
        name: "help",
        request: Request::Help,
        help: "this list",
    },
    Word {
        name: "status",
        request: Request::Status,
        help: "the status sentence now",
    },
    Word {
        name: "version",
        request: Request::Version,
        help: "of the program",
    },
    Word {
        name: "align",
        request: Request::Unit(Command::Align),
        help: "align from the beginning",
    },
    Word {
        name: "calibrate",
        request: Request::Unit(Command::Calibrate),
        help: "calibrate the IMU - from rest only",
    },
    Word {
        name: "stop",
        request: Request::Unit(Command::Stop),
        help: "stop the rotor and rest",
    },
    Word {
        name: "reset",
        request: Request::Unit(Command::ResetFault),
        help: "forget the fault and start again",
    },
];

/// Why a line is no request. Its text says what was expected.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum LineError {
    /// The first word is none of [`WORDS`].
    Unknown,
    /// There is more on the line than the word.
    Excess {
        /// The word.
        name: &'static str,
    },
    /// Longer than [`LONGEST`].
    Long,
    /// With a byte that is no printable ASCII: noise, or another baud rate.
    Garbled,
}

impl LineError {
    /// What was expected, in words that fit an answer.
    pub const fn expected(self) -> &'static str {
        match self {
            Self::Unknown => "expected help status version align calibrate stop or reset",
            Self::Excess { .. } => "expected nothing after the command",
            Self::Long => "expected at most 64 characters on a line",
            Self::Garbled => "expected ASCII at 115200 baud 8N1",
        }
    }
}

impl fmt::Display for LineError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.expected())
    }
}

impl core::error::Error for LineError {}

/// What a line without its end asks for; `None` where it is empty or a remark.
///
/// # Errors
/// [`LineError`] says what was expected.
pub fn parse(line: &[u8]) -> Result<Option<Request>, LineError> {
    if line.len() > LONGEST {
        return Err(LineError::Long);
    }
    if !line.iter().all(|byte| is_text(*byte)) {
        return Err(LineError::Garbled);
    }
    let mut words = line.split(|byte| is_blank(*byte)).filter(|word| !word.is_empty());
    let Some(first) = words.next().filter(|word| !word.starts_with(b"#")) else {
        return Ok(None);
    };
    let Some(word) = WORDS
        .iter()
        .find(|word| word.name.as_bytes().eq_ignore_ascii_case(first))
    else {
        return Err(LineError::Unknown);
    };
    match words.next() {
        None => Ok(Some(word.request)),
        Some(_) => Err(LineError::Excess { name: word.name }),
    }
}

/// Whether the modes take a command in this mode; elsewhere they refuse it. As [`State::step`], which decides; this is
/// for the answer.
///
/// [`State::step`]: crate::mode::State::step
pub const fn taken(mode: ModeName, command: Command) -> bool {
    use ModeName as M;
    match command {
        // A fault that only a reset of the unit ends refuses this as well; it is about to get one.
        Command::ResetFault => matches!(mode, M::Fault),
        Command::Stop => !matches!(mode, M::Fault),
        Command::Align => !matches!(mode, M::Fault | M::SelfTest | M::Homing),
        Command::Calibrate => matches!(mode, M::Idle),
    }
}

const fn is_blank(byte: u8) -> bool {
    matches!(byte, b' ' | b'\t')
}

const fn is_text(byte: u8) -> bool {
    is_blank(byte) || byte.is_ascii_graphic()
}

/// Makes lines of bytes.
#[derive(Debug, Clone, Default)]
pub struct LineBuffer {
    bytes: Vec<u8, LONGEST>,
    /// What is wrong with the line so far.
    refused: Option<LineError>,
}

impl LineBuffer {
    /// Nothing yet.
    pub const fn new() -> Self {
        Self {
            bytes: Vec::new(),
            refused: None,
        }
    }

    /// Takes a byte; at the end of a line what it asks for. The end of an empty line is nothing, so that CR LF
    /// is one end.
    pub fn push(&mut self, byte: u8) -> Option<Result<Request, LineError>> {
        match byte {
            b'\r' | b'\n' => {
                let found = match self.refused.take() {
                    Some(error) => Err(error),
                    None => parse(&self.bytes),
                };
                self.bytes.clear();
                return found.transpose();
            }
            // Backspace and delete, of a terminal.
            0x08 | 0x7F => {
                self.bytes.pop();
            }
            _ if !is_text(byte) => self.refuse(LineError::Garbled),
            _ => {
                if self.bytes.push(byte).is_err() {
                    self.refuse(LineError::Long);
                }
            }
        }
        None
    }

    /// Bytes of the line were lost or came wrong: it is refused at its end.
    pub fn garble(&mut self) {
        self.refuse(LineError::Garbled);
    }

    /// The first reason stays.
    fn refuse(&mut self, error: LineError) {
        self.refused.get_or_insert(error);
    }
}

#[cfg(test)]
mod tests {
    use std::vec::Vec;

    use drivers::mt6835::Warnings;
    use proptest::prelude::*;

    use super::*;
    use crate::fault::Fault;
    use crate::mode::{Action, Faulted, Homing, Input, Mode, SelfTest, State};
    use crate::nmea;

    /// All that comes out of a row of bytes.
    fn feed(bytes: &[u8]) -> Vec<Result<Request, LineError>> {
        let mut buffer = LineBuffer::new();
        bytes.iter().filter_map(|byte| buffer.push(*byte)).collect()
    }

    #[test]
    fn every_word_is_understood_and_none_twice() {
        for word in WORDS {
            assert_eq!(parse(word.name.as_bytes()), Ok(Some(word.request)));
            assert_eq!(WORDS.iter().filter(|other| other.name == word.name).count(), 1);
            assert!(LineError::Unknown.expected().contains(word.name), "{}", word.name);
            // With name and hyphen it goes into one answer.
            assert!(word.name.len() + 3 + word.help.len() <= nmea::ANSWER);
        }
        for command in [Command::Stop, Command::Align, Command::Calibrate, Command::ResetFault] {
            assert!(WORDS.iter().any(|word| word.request == Request::Unit(command)));
        }
    }

    #[test]
    fn lines_and_what_they_ask_for() {
        use LineError as E;
        let (align, stop) = (Ok(Request::Unit(Command::Align)), Ok(Request::Unit(Command::Stop)));
        let long = [&[b'x'; LONGEST + 1][..], b" stop\nalign\n"].concat();
        let full = [&[b' '; LONGEST - 4][..], b"stop\n"].concat();
        for (bytes, expected) in [
            (&b"align\r\n"[..], &[align][..]),
            (b"\r\n\n  \t \n# stop\n#stop\n", &[]),
            (b"  ALIGN \t\rstop\n", &[align, stop]),
            (b"align", &[]),
            (b"alig\nn\n", &[Err(E::Unknown), Err(E::Unknown)]),
            (b"stop now\n", &[Err(E::Excess { name: "stop" })]),
            (b"stop # now\n", &[Err(E::Excess { name: "stop" })]),
            (b"stopp\nsto\n", &[Err(E::Unknown), Err(E::Unknown)]),
            (b"stpo\x08\x08op\nx\x7f\x7fstop\n", &[stop, stop]),
            (b"st\xFFop\nstop\n", &[Err(E::Garbled), stop]),
            (b"\0stop\nstop\n", &[Err(E::Garbled), stop]),
            (&long, &[Err(E::Long), align]),
            (&full, &[stop]),
            // What the unit itself sends, on a line that echoes.
            (b"$HETHS,,V*14\r\n", &[Err(E::Unknown)]),
        ] {
            assert_eq!(feed(bytes), expected, "{}", bytes.escape_ascii());
        }
    }

    #[test]
    fn lost_bytes_spoil_their_line_only() {
        let mut buffer = LineBuffer::new();
        assert_eq!(b"sto".iter().find_map(|byte| buffer.push(*byte)), None);
        buffer.garble();
        assert_eq!(
            b"p\n".iter().find_map(|byte| buffer.push(*byte)),
            Some(Err(LineError::Garbled))
        );
        assert_eq!(
            b"stop\n".iter().find_map(|byte| buffer.push(*byte)),
            Some(Ok(Request::Unit(Command::Stop)))
        );
    }

    /// Every mode with every command, beside what the modes do.
    #[test]
    fn what_is_taken_is_what_the_modes_take() {
        let fault = Fault::EncoderWarning {
            warnings: Warnings::NONE,
        };
        for mode in [
            Mode::Idle,
            Mode::SelfTest(SelfTest::default()),
            Mode::Homing(Homing::Searching),
            Mode::Calibrating,
            Mode::Coarse,
            Mode::Fine,
            Mode::Aligned,
            Mode::Fault(Faulted { fault, latched: true }),
        ] {
            for command in [Command::Stop, Command::Align, Command::Calibrate, Command::ResetFault] {
                let state = State {
                    mode,
                    ..State::default()
                };
                let (_, actions) = state.step(&Input::Command(command), 1);
                let refused = actions
                    .iter()
                    .any(|action| matches!(action, Action::Tell(crate::log::Event::Refused { .. })));
                assert_eq!(taken(mode.name(), command), !refused, "{mode:?} {command:?}");
            }
        }
    }

    proptest! {
        #[test]
        fn no_bytes_do_harm(bytes in proptest::collection::vec(any::<u8>(), 0..300)) {
            let ends = bytes.iter().filter(|byte| matches!(byte, b'\r' | b'\n')).count();
            let found = feed(&bytes);
            prop_assert!(found.len() <= ends);
            let _ = parse(&bytes);
            for error in found.into_iter().filter_map(Result::err) {
                prop_assert!(error.expected().len() <= nmea::ANSWER);
            }
        }

        /// Whatever went before, a line on its own is understood.
        #[test]
        fn the_next_line_is_a_new_one(mut bytes in proptest::collection::vec(any::<u8>(), 0..100), nth in 0..WORDS.len()) {
            bytes.push(b'\n');
            bytes.extend_from_slice(WORDS[nth].name.as_bytes());
            bytes.push(b'\n');
            prop_assert_eq!(feed(&bytes).pop(), Some(Ok(WORDS[nth].request)));
        }
    }
}
