//! The unit's modes: what it does, and what makes it do something else. Pure: [`State::step`] takes a state
//! and an input and gives a state and actions; the supervisor carries them out.
//!
//! ```text
//!  start            imu, encoder, gravity        calibrated, homed                sd small
//!  ───────► SelfTest ───────────────► Homing ───────────────► Coarse ─► Fine ◄──────────► Aligned
//!              ▲                                    ▲           ▲ restart │                  │
//!              │ Align, retry                       │           └─────────┴──────────────────┘
//!  Idle ───────┤                                    │ Align (again)
//!   ▲ Stop     │ ResetFault, time                   any ── fault ─► Fault
//!   any        └──────────────────────────────────────────────────────┘
//! ```
//!
//! `Calibrating` is a place for the calibration of the IMU: the rotor stands, samples flow, nobody aligns.

use drivers::{Error, Identity};

use crate::command::{Command, ModeName};
use crate::fault::{Fault, Response};
use crate::log::{Alignment, Event};
use crate::rotor;
use crate::selftest::{Failure, Found};

/// Longest self-test, µs: an IMU's reset, self-test and settings take 0.6 s, the inspection 1 s.
pub const SELF_TEST_US: u64 = 10_000_000;
/// Longest calibration and homing, µs: 3 s of rest, 5 s of sweep, half a turn at 15 °/s.
pub const HOMING_US: u64 = 60_000_000;
/// Aligned for so long, earlier faults are forgiven, µs.
pub const FORGIVEN_US: u64 = 60_000_000;

/// What the alignment task is to do with the samples.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Job {
    /// Drop them.
    Idle,
    /// Judge the first ones: gravity, rates.
    Inspect,
    /// Align, from the beginning.
    Align,
}

/// Something that happened.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Input {
    /// The unit starts.
    Start,
    /// Time passes.
    Tick,
    /// The IMU is started, or not.
    Imu(Result<Identity, Error>),
    /// The encoder is started, or not; and what the rotor still knows.
    Encoder(Result<RotorKnows, Error>),
    /// The first samples were judged.
    Inspected(Result<Found, Failure>),
    /// The motor is calibrated: electrical offset, rad.
    Calibrated {
        /// For the settings.
        offset: f32,
    },
    /// The turn is known.
    Homed {
        /// Where the rotor is, rad.
        angle: f32,
    },
    /// The aligner told something.
    Alignment(Alignment),
    /// A fault was found.
    Fault(Fault),
    /// A command came.
    Command(Command),
}

/// What the rotor need not find again.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct RotorKnows {
    /// The electrical offset.
    pub calibrated: bool,
    /// The turn.
    pub homed: bool,
}

/// What is to be done.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Action {
    /// Motor off, now and until released.
    Cut,
    /// The motor may be on.
    Release,
    /// To the rotor.
    Rotor(rotor::Command),
    /// Reset, identify, test and configure the IMU.
    StartImu,
    /// Identify and configure the encoder.
    StartEncoder,
    /// To the alignment.
    Job(Job),
    /// To the log.
    Tell(Event),
}

/// Actions of one step, in order.
pub type Actions = heapless::Vec<Action, 8>;

/// What of the self-test is done.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct SelfTest {
    /// The IMU is configured.
    pub imu: bool,
    /// The encoder is, and the rotor still knows this.
    pub encoder: Option<RotorKnows>,
    /// The first samples passed.
    pub inspected: bool,
}

/// How far the rotor's start is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Homing {
    /// Finding the electrical offset: shows the motor's direction, pole pairs and free travel.
    Calibrating {
        /// The turn is known already.
        homed: bool,
    },
    /// Finding the turn.
    Searching,
}

/// A fault with what is known of it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Faulted {
    /// The fault.
    pub fault: Fault,
    /// No retry any more.
    pub latched: bool,
}

/// What the unit does, with what belongs to it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Mode {
    /// Nothing; the rotor stands.
    Idle,
    /// Tests itself.
    SelfTest(SelfTest),
    /// Calibrates the motor and finds the turn.
    Homing(Homing),
    /// Calibrates the IMU.
    Calibrating,
    /// Coarse alignment.
    Coarse,
    /// Fine alignment.
    Fine,
    /// Heading is good; keeps tracking.
    Aligned,
    /// Motor off.
    Fault(Faulted),
}

impl Mode {
    /// Its name.
    pub const fn name(&self) -> ModeName {
        match self {
            Self::Idle => ModeName::Idle,
            Self::SelfTest(_) => ModeName::SelfTest,
            Self::Homing(_) => ModeName::Homing,
            Self::Calibrating => ModeName::Calibrating,
            Self::Coarse => ModeName::Coarse,
            Self::Fine => ModeName::Fine,
            Self::Aligned => ModeName::Aligned,
            Self::Fault(_) => ModeName::Fault,
        }
    }
}

/// What others see of the mode.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Status {
    /// The mode.
    pub mode: ModeName,
    /// Since when, µs of the unit's clock.
    pub since_us: u64,
    /// The fault, in that mode.
    pub fault: Option<Fault>,
    /// Whether it stays.
    pub latched: bool,
    /// Tries since the last success.
    pub attempts: u8,
}

/// Mode, and what outlives it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct State {
    /// The mode.
    pub mode: Mode,
    /// Since when, µs.
    pub since_us: u64,
    /// Starts after faults since the last that led to something.
    pub attempts: u8,
}

impl Default for State {
    fn default() -> Self {
        Self {
            mode: Mode::Idle,
            since_us: 0,
            attempts: 0,
        }
    }
}

/// Collects actions; more than fit cannot come about, see the tests.
fn act(actions: &mut Actions, action: Action) {
    let _ = actions.push(action);
}

impl State {
    /// What others see.
    pub fn status(&self) -> Status {
        let (fault, latched) = match self.mode {
            Mode::Fault(Faulted { fault, latched }) => (Some(fault), latched),
            _ => (None, false),
        };
        Status {
            mode: self.mode.name(),
            since_us: self.since_us,
            fault,
            latched,
            attempts: self.attempts,
        }
    }

    /// Whether the watchdog is to be left to bite.
    pub fn wants_reset(&self) -> bool {
        matches!(self.mode, Mode::Fault(Faulted { fault, .. }) if fault.rule().response == Response::Reset)
    }

    /// The state after `input` at `now_us`, and what is to be done. Time of a mode begins when it is entered;
    /// an input that does not concern it changes nothing.
    pub fn step(self, input: &Input, now_us: u64) -> (Self, Actions) {
        let mut actions = Actions::new();
        let a = &mut actions;
        let in_mode_us = now_us.saturating_sub(self.since_us);
        let mut attempts = self.attempts;
        let mode = match (self.mode, *input) {
            (mode, Input::Fault(fault)) => fault_in(mode, fault, attempts, a),
            (mode, Input::Command(command)) => match command_in(mode, command, a) {
                Some(mode) => {
                    attempts = 0;
                    mode
                }
                None => mode,
            },
            (_, Input::Start) => self_test(a),

            (Mode::SelfTest(_), Input::Imu(Err(error))) => self_test_failed(Failure::Imu(error), attempts, a),
            (Mode::SelfTest(_), Input::Encoder(Err(error))) => self_test_failed(Failure::Encoder(error), attempts, a),
            (Mode::SelfTest(_), Input::Inspected(Err(failure))) => self_test_failed(failure, attempts, a),
            (Mode::SelfTest(test), Input::Imu(Ok(identity))) => {
                act(a, Action::Tell(Event::Imu(identity)));
                act(a, Action::Job(Job::Inspect));
                tested(SelfTest { imu: true, ..test }, a)
            }
            (Mode::SelfTest(test), Input::Encoder(Ok(knows))) => {
                act(a, Action::Tell(Event::Encoder));
                tested(
                    SelfTest {
                        encoder: Some(knows),
                        ..test
                    },
                    a,
                )
            }
            (Mode::SelfTest(test), Input::Inspected(Ok(found))) => {
                act(a, Action::Tell(Event::Inspected(found)));
                tested(
                    SelfTest {
                        inspected: true,
                        ..test
                    },
                    a,
                )
            }
            (Mode::SelfTest(test), Input::Tick) if in_mode_us > SELF_TEST_US => self_test_failed(
                Failure::Timeout {
                    imu: test.imu,
                    encoder: test.encoder.is_some(),
                    inspected: test.inspected,
                },
                attempts,
                a,
            ),

            (Mode::Homing(Homing::Calibrating { homed }), Input::Calibrated { offset }) => {
                act(a, Action::Tell(Event::Calibrated { offset }));
                if homed { running(a) } else { search(a) }
            }
            (Mode::Homing(Homing::Searching), Input::Homed { angle }) => {
                act(a, Action::Tell(Event::Homed { angle }));
                running(a)
            }
            (Mode::Homing(_), Input::Tick) if in_mode_us > HOMING_US => {
                fault_in(self.mode, Fault::RotorRefused(rotor::Refused::Busy), attempts, a)
            }

            (mode @ (Mode::Coarse | Mode::Fine | Mode::Aligned), Input::Alignment(told)) => {
                act(a, Action::Tell(Event::Alignment(told)));
                aligning(mode, told)
            }
            (Mode::Aligned, Input::Tick) => {
                if in_mode_us > FORGIVEN_US {
                    attempts = 0;
                }
                Mode::Aligned
            }
            (Mode::Fault(Faulted { fault, latched: false }), Input::Tick) => match fault.rule().response {
                Response::Retry { after_ms, .. } if in_mode_us >= u64::from(after_ms) * 1000 => {
                    attempts = attempts.saturating_add(1);
                    act(a, Action::Tell(Event::Retry { attempt: attempts }));
                    self_test(a)
                }
                _ => self.mode,
            },
            (mode, _) => mode,
        };
        let since_us = if mode.name() == self.mode.name() {
            self.since_us
        } else {
            let (from, to) = (self.mode.name(), mode.name());
            // After what led to it.
            act(a, Action::Tell(Event::Mode { from, to }));
            now_us
        };
        (
            Self {
                mode,
                since_us,
                attempts,
            },
            actions,
        )
    }
}

fn self_test(a: &mut Actions) -> Mode {
    act(a, Action::Job(Job::Idle));
    act(a, Action::Release);
    act(a, Action::Rotor(rotor::Command::Clear));
    act(a, Action::StartImu);
    act(a, Action::StartEncoder);
    Mode::SelfTest(SelfTest::default())
}

fn tested(test: SelfTest, a: &mut Actions) -> Mode {
    let SelfTest {
        imu: true,
        encoder: Some(knows),
        inspected: true,
    } = test
    else {
        return Mode::SelfTest(test);
    };
    match knows {
        RotorKnows {
            calibrated: false,
            homed,
        } => {
            act(a, Action::Rotor(rotor::Command::Calibrate));
            Mode::Homing(Homing::Calibrating { homed })
        }
        RotorKnows { homed: false, .. } => search(a),
        RotorKnows { .. } => running(a),
    }
}

fn search(a: &mut Actions) -> Mode {
    act(a, Action::Rotor(rotor::Command::Home));
    Mode::Homing(Homing::Searching)
}

fn running(a: &mut Actions) -> Mode {
    act(a, Action::Rotor(rotor::Command::Run));
    act(a, Action::Job(Job::Align));
    Mode::Coarse
}

fn aligning(mode: Mode, told: Alignment) -> Mode {
    match told {
        Alignment::CoarseDone { .. } | Alignment::CaughtUp => Mode::Fine,
        Alignment::Aligned => Mode::Aligned,
        Alignment::HeadingSd { .. } | Alignment::Ambiguous { .. } | Alignment::Inconsistent { .. } => Mode::Fine,
        Alignment::Collecting
        | Alignment::RestartedCoarse
        | Alignment::RestartedGap { .. }
        | Alignment::RestartedBadSample
        | Alignment::RestartedDiverged => Mode::Coarse,
        Alignment::Bridged { .. } => mode,
    }
}

fn self_test_failed(failure: Failure, attempts: u8, a: &mut Actions) -> Mode {
    fault_in(
        Mode::SelfTest(SelfTest::default()),
        Fault::SelfTest(failure),
        attempts,
        a,
    )
}

fn fault_in(mode: Mode, fault: Fault, attempts: u8, a: &mut Actions) -> Mode {
    act(a, Action::Cut);
    let response = fault.rule().response;
    let latched = match response {
        Response::Retry { times, .. } => attempts >= times,
        Response::Latch | Response::Reset => true,
    };
    if let Mode::Fault(before) = mode {
        // One fault brings others with it; only a graver one takes its place.
        let graver = latched && !before.latched || response == Response::Reset;
        if !graver || before.fault.name() == fault.name() {
            return mode;
        }
    }
    act(a, Action::Job(Job::Idle));
    act(a, Action::Tell(Event::Fault(fault)));
    if latched {
        act(a, Action::Tell(Event::Latched));
    }
    Mode::Fault(Faulted { fault, latched })
}

/// The mode a command leads to; `None` where it makes no sense.
fn command_in(mode: Mode, command: Command, a: &mut Actions) -> Option<Mode> {
    let next = match (mode, command) {
        (Mode::Fault(Faulted { fault, .. }), Command::ResetFault) if fault.rule().response != Response::Reset => {
            act(a, Action::Tell(Event::Command(command)));
            self_test(a)
        }
        (Mode::Fault(_), _) | (_, Command::ResetFault) => {
            let mode = mode.name();
            act(a, Action::Tell(Event::Refused { command, mode }));
            return None;
        }
        (_, Command::Stop) => {
            act(a, Action::Tell(Event::Command(command)));
            act(a, Action::Rotor(rotor::Command::Stop));
            act(a, Action::Job(Job::Idle));
            Mode::Idle
        }
        (Mode::Idle | Mode::Calibrating, Command::Align) => {
            act(a, Action::Tell(Event::Command(command)));
            self_test(a)
        }
        (Mode::Coarse | Mode::Fine | Mode::Aligned, Command::Align) => {
            act(a, Action::Tell(Event::Command(command)));
            act(a, Action::Job(Job::Align));
            Mode::Coarse
        }
        (Mode::Idle, Command::Calibrate) => {
            act(a, Action::Tell(Event::Command(command)));
            Mode::Calibrating
        }
        (Mode::SelfTest(_) | Mode::Homing(_), Command::Align) | (_, Command::Calibrate) => {
            let mode = mode.name();
            act(a, Action::Tell(Event::Refused { command, mode }));
            return None;
        }
    };
    Some(next)
}

#[cfg(test)]
mod tests {
    use super::*;

    const IDENTITY: Identity = Identity {
        product: 16495,
        revision: 0,
        serial: 1,
    };
    const FOUND: Found = Found {
        gravity: 9.8,
        rate: 0.0,
        rate_sd: 0.0,
    };

    fn knows(calibrated: bool, homed: bool) -> Input {
        Input::Encoder(Ok(RotorKnows { calibrated, homed }))
    }

    /// The modes and what was done, for a row of inputs a second apart.
    fn run(start: State, inputs: &[Input]) -> (State, std::vec::Vec<Action>) {
        let (mut state, mut done) = (start, std::vec::Vec::new());
        for (k, input) in inputs.iter().enumerate() {
            let (next, actions) = state.step(input, 1_000_000 * (k as u64 + 1));
            assert!(actions.len() < actions.capacity(), "{input:?}");
            state = next;
            done.extend(actions.into_iter().filter(|action| !matches!(action, Action::Tell(_))));
        }
        (state, done)
    }

    fn in_mode(mode: Mode) -> State {
        State {
            mode,
            ..State::default()
        }
    }

    const COARSE: Alignment = Alignment::CoarseDone {
        heading_deg: 1.0,
        sd_deg: 1.0,
    };

    #[test]
    fn the_course_of_things() {
        let (state, done) = run(
            State::default(),
            &[
                Input::Start,
                knows(false, false),
                Input::Imu(Ok(IDENTITY)),
                Input::Inspected(Ok(FOUND)),
                Input::Calibrated { offset: 1.0 },
                Input::Homed { angle: 3.0 },
                Input::Alignment(COARSE),
                Input::Alignment(Alignment::CaughtUp),
                Input::Alignment(Alignment::Aligned),
            ],
        );
        assert_eq!(state.mode, Mode::Aligned);
        assert_eq!(
            done,
            [
                Action::Job(Job::Idle),
                Action::Release,
                Action::Rotor(rotor::Command::Clear),
                Action::StartImu,
                Action::StartEncoder,
                Action::Job(Job::Inspect),
                Action::Rotor(rotor::Command::Calibrate),
                Action::Rotor(rotor::Command::Home),
                Action::Rotor(rotor::Command::Run),
                Action::Job(Job::Align),
            ]
        );
    }

    #[test]
    fn every_mode_and_what_leads_out_of_it() {
        let crc = Fault::ImuTransfer {
            error: Error::Header { found: 0 },
            in_row: 3,
        };
        let clock = Fault::Clock {
            expected_us: 1.0,
            measured_us: 2.0,
        };
        let fault = |fault, latched| Mode::Fault(Faulted { fault, latched });
        let test = Mode::SelfTest(SelfTest::default());
        let nearly = |calibrated, homed| {
            Mode::SelfTest(SelfTest {
                imu: true,
                encoder: Some(RotorKnows { calibrated, homed }),
                inspected: false,
            })
        };
        let searching = Mode::Homing(Homing::Searching);
        let calibrating = |homed| Mode::Homing(Homing::Calibrating { homed });
        let command = Input::Command;
        use Alignment::{Aligned, Bridged, Inconsistent, RestartedDiverged, RestartedGap};
        for (row, (mode, input, expected)) in [
            (Mode::Idle, Input::Start, test),
            (Mode::Idle, command(Command::Align), test),
            (Mode::Idle, command(Command::Calibrate), Mode::Calibrating),
            (Mode::Idle, command(Command::ResetFault), Mode::Idle),
            (Mode::Idle, Input::Imu(Ok(IDENTITY)), Mode::Idle),
            (Mode::Calibrating, command(Command::Stop), Mode::Idle),
            (Mode::Calibrating, command(Command::Align), test),
            (test, command(Command::Align), test),
            (test, command(Command::Stop), Mode::Idle),
            (nearly(false, false), Input::Inspected(Ok(FOUND)), calibrating(false)),
            (nearly(false, true), Input::Inspected(Ok(FOUND)), calibrating(true)),
            (nearly(true, false), Input::Inspected(Ok(FOUND)), searching),
            (nearly(true, true), Input::Inspected(Ok(FOUND)), Mode::Coarse),
            (
                nearly(true, true),
                Input::Inspected(Err(Failure::NoNoise)),
                fault(Fault::SelfTest(Failure::NoNoise), false),
            ),
            (calibrating(true), Input::Calibrated { offset: 0.0 }, Mode::Coarse),
            (calibrating(false), Input::Calibrated { offset: 0.0 }, searching),
            (calibrating(false), Input::Homed { angle: 0.0 }, calibrating(false)),
            (searching, Input::Homed { angle: 0.0 }, Mode::Coarse),
            (searching, command(Command::Stop), Mode::Idle),
            (Mode::Coarse, Input::Alignment(COARSE), Mode::Fine),
            (Mode::Coarse, Input::Alignment(Bridged { ms: 5.0 }), Mode::Coarse),
            (Mode::Fine, Input::Alignment(Aligned), Mode::Aligned),
            (Mode::Fine, Input::Alignment(RestartedDiverged), Mode::Coarse),
            (Mode::Fine, Input::Alignment(Bridged { ms: 5.0 }), Mode::Fine),
            (Mode::Aligned, Input::Alignment(Inconsistent { ratio: 3.0 }), Mode::Fine),
            (
                Mode::Aligned,
                Input::Alignment(RestartedGap { length: 1.0 }),
                Mode::Coarse,
            ),
            (Mode::Aligned, command(Command::Align), Mode::Coarse),
            (Mode::Aligned, command(Command::Stop), Mode::Idle),
            (Mode::Aligned, command(Command::Calibrate), Mode::Aligned),
            (Mode::Idle, Input::Alignment(Aligned), Mode::Idle),
            (Mode::Aligned, Input::Fault(crc), fault(crc, false)),
            (Mode::Aligned, Input::Fault(clock), fault(clock, true)),
            (fault(crc, false), Input::Fault(Fault::Driver), fault(crc, false)),
            (fault(crc, false), Input::Fault(clock), fault(clock, true)),
            (fault(clock, true), Input::Fault(crc), fault(clock, true)),
            (fault(crc, false), Input::Tick, test),
            (fault(crc, true), Input::Tick, fault(crc, true)),
            (fault(clock, true), Input::Tick, fault(clock, true)),
            (fault(clock, true), command(Command::ResetFault), test),
            (fault(clock, true), command(Command::Align), fault(clock, true)),
        ]
        .into_iter()
        .enumerate()
        {
            let (state, _) = in_mode(mode).step(&input, 2_000_000);
            assert_eq!(state.mode, expected, "row {row}");
        }
    }

    #[test]
    fn every_fault_cuts_the_motor_first_in_every_mode() {
        for mode in [
            Mode::Idle,
            Mode::SelfTest(SelfTest::default()),
            Mode::Homing(Homing::Searching),
            Mode::Calibrating,
            Mode::Coarse,
            Mode::Fine,
            Mode::Aligned,
            Mode::Fault(Faulted {
                fault: Fault::Driver,
                latched: true,
            }),
        ] {
            let (state, actions) = in_mode(mode).step(&Input::Fault(Fault::EncoderInvalid), 5);
            assert_eq!(actions.first(), Some(&Action::Cut));
            assert!(matches!(state.mode, Mode::Fault(_)));
        }
    }

    #[test]
    fn tries_are_counted_latched_and_forgiven() {
        let fault = Input::Fault(Fault::Driver);
        let (state, _) = run(
            in_mode(Mode::Aligned),
            &[fault, Input::Tick, Input::Tick, fault, Input::Tick, fault, Input::Tick],
        );
        assert_eq!((state.mode.name(), state.attempts), (ModeName::SelfTest, 3));
        let (state, _) = state.step(&fault, 9_000_000);
        assert!(matches!(state.mode, Mode::Fault(Faulted { latched: true, .. })));
        let (state, _) = state.step(&Input::Tick, 90_000_000);
        assert!(matches!(state.mode, Mode::Fault(_)));
        let (state, _) = state.step(&Input::Command(Command::ResetFault), 90_000_000);
        assert_eq!((state.mode.name(), state.attempts), (ModeName::SelfTest, 0));
        let aligned = State {
            attempts: 2,
            ..in_mode(Mode::Aligned)
        };
        assert_eq!(aligned.step(&Input::Tick, FORGIVEN_US).0.attempts, 2);
        assert_eq!(aligned.step(&Input::Tick, FORGIVEN_US + 1).0.attempts, 0);
    }

    #[test]
    fn what_takes_too_long_is_a_fault() {
        let (state, _) = in_mode(Mode::SelfTest(SelfTest::default())).step(&Input::Tick, SELF_TEST_US + 1);
        assert!(matches!(
            state.mode,
            Mode::Fault(Faulted {
                fault: Fault::SelfTest(Failure::Timeout { imu: false, .. }),
                ..
            })
        ));
        let (state, _) = in_mode(Mode::Homing(Homing::Searching)).step(&Input::Tick, HOMING_US + 1);
        assert_eq!(state.mode.name(), ModeName::Fault);
    }

    #[test]
    fn a_hanging_task_starves_the_watchdog() {
        let overrun = Fault::TaskOverrun {
            task: crate::fault::Task::Motor,
            silent_ms: 10,
        };
        let (state, _) = in_mode(Mode::Fine).step(&Input::Fault(overrun), 1);
        assert!(state.wants_reset());
        let (state, _) = state.step(&Input::Command(Command::ResetFault), 2);
        assert!(state.wants_reset());
    }
}
