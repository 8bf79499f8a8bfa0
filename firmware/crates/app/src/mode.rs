//! The unit's modes: what it does, and what makes it do something else. Pure: [`State::step`] takes a state
//! and an input and gives a state and actions; the supervisor carries them out.
//!
//! ```text
//!  start            imu, encoder, gravity     calibrated, homed                sd small            Navigate
//!  ───────► SelfTest ──────────────► Homing ─────────────► Coarse ─► Fine ◄──────────► Aligned ──────────► Navigating
//!              ▲  │ SelfTest            │                    ▲ ▲        │                 │  │ Calibrate        │
//!              │  ▼                     │ Calibrate          │ └────────┴─── restart ─────┘  │                  │
//!  Idle ───────┘ Idle                   └────────────────────┼──► Calibrating ◄─────────────┘                  │
//!   ▲  ▲  Align, Calibrate, SelfTest                         │        │ done, failed                           │
//!   │  └─────────────────────────────────────────────────────┼────────┘                                        │
//!   │ Stop                                                   └──────────────────────── Align, cannot go on ────┘
//!  any                              any ── fault ─► Fault ── ResetFault, time ─► SelfTest
//! ```
//!
//! Calibrating is a rest, then turns forth and back. From Aligned attitude and heading are known, so that Earth's rate
//! is told from the gyros' biases; from Idle it is not, and only what goes with the rotor's rate is kept.
//!
//! Nobody is to be surprised by a rotor that turns: what rests does so until a command, or a start that somebody wants. A
//! fault or a crash of a unit at rest, or one that Stop was said in, leads over the self-test to rest again.

use drivers::{Error, Identity};

use crate::command::{Command, ModeName};
use crate::fault::{Fault, Response};
use crate::hal::ClockSource;
use crate::log::{Alignment, CalibrationEnd, CalibrationFailure, Event, NavigationEnd};
use crate::rotor;
use crate::selftest::{Failure, Found};

/// Longest self-test, µs: an IMU's reset, self-test and settings take 0.6 s, the inspection 1 s.
pub const SELF_TEST_US: u64 = 10_000_000;
/// Longest calibration and homing, µs: 3 s of rest, 5 s of sweep, half a turn at 15 °/s.
pub const HOMING_US: u64 = 60_000_000;
/// Longest calibration of the gyros, µs: coming to rest, a minute there, four legs of 18 s.
pub const CALIBRATING_US: u64 = 300_000_000;
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
    /// Calibrate the gyros, once the rotor stands.
    Calibrate {
        /// The estimate still holds: Earth's rate in the housing is known.
        aligned: bool,
    },
    /// Go on from what the alignment knows.
    Navigate,
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
    /// The gyros have been watched at rest for long enough.
    Rested,
    /// The gyros are calibrated, or not.
    GyrosCalibrated(CalibrationEnd),
    /// Navigation cannot go on.
    NavigationEnded(NavigationEnd),
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

/// How far the calibration of the gyros is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Calibrating {
    /// The rotor stands.
    Resting,
    /// It turns forth and back.
    Turning,
}

/// What self-test and homing lead to.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Goal {
    /// Alignment.
    #[default]
    Align,
    /// Calibration of the gyros.
    Calibrate,
    /// Nothing, after the self-test.
    Rest,
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
    /// Calibrates the gyros.
    Calibrating(Calibrating),
    /// Coarse alignment.
    Coarse,
    /// Fine alignment.
    Fine,
    /// Heading is good; keeps tracking.
    Aligned,
    /// Dead reckoning from where it was aligned.
    Navigating,
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
            Self::Calibrating(_) => ModeName::Calibrating,
            Self::Coarse => ModeName::Coarse,
            Self::Fine => ModeName::Fine,
            Self::Aligned => ModeName::Aligned,
            Self::Navigating => ModeName::Navigating,
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
    /// What the start is for.
    pub goal: Goal,
    /// Asked to start the program anew.
    pub restarts: bool,
    /// What the unit's clock goes by.
    pub clock: ClockSource,
}

impl Default for State {
    fn default() -> Self {
        Self {
            mode: Mode::Idle,
            since_us: 0,
            attempts: 0,
            goal: Goal::Align,
            restarts: false,
            clock: ClockSource::default(),
        }
    }
}

/// Collects actions; more than fit cannot come about, see the tests.
fn act(actions: &mut Actions, action: Action) {
    let _ = actions.push(action);
}

impl State {
    /// Before the start; one that is to rest goes no further than the self-test.
    pub fn new(rests: bool, clock: ClockSource) -> Self {
        Self {
            goal: if rests { Goal::Rest } else { Goal::Align },
            clock,
            ..Self::default()
        }
    }

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

    /// Whether the unit only waits to be told to go on: then a hanging task is no reason to start it anew.
    pub fn brakes(&self) -> bool {
        matches!(self.mode, Mode::Fault(Faulted { fault, .. }) if fault.brakes())
    }

    /// Whether a fault is latched; `None` in one that ends in a reset: it is as it was before.
    pub fn latched(&self) -> Option<bool> {
        match self.mode {
            Mode::Fault(Faulted { fault, .. }) if fault.rule().response == Response::Reset => None,
            Mode::Fault(Faulted { latched, .. }) => Some(latched),
            _ => Some(false),
        }
    }

    /// Whether the watchdog is to be left to bite.
    pub fn wants_reset(&self) -> bool {
        self.restarts
            || matches!(self.mode, Mode::Fault(Faulted { fault, .. }) if fault.rule().response == Response::Reset)
    }

    /// The state after `input` at `now_us`, and what is to be done. Time of a mode begins when it is entered;
    /// an input that does not concern it changes nothing.
    pub fn step(self, input: &Input, now_us: u64) -> (Self, Actions) {
        let mut actions = Actions::new();
        if self.restarts && !matches!(input, Input::Fault(_)) {
            // The motor is cut until the watchdog bites: neither a command nor the retry of a fault releases it again.
            return (self, actions);
        }
        let a = &mut actions;
        let in_mode_us = now_us.saturating_sub(self.since_us);
        let (mut attempts, mut goal, mut restarts) = (self.attempts, self.goal, self.restarts);
        let mode = match (self.mode, *input) {
            (mode, Input::Fault(fault)) => fault_in(mode, fault, attempts, a),
            (mode, Input::Command(command @ Command::Calibrate)) if !self.clock.is_exact() => {
                act(
                    a,
                    Action::Tell(Event::Refused {
                        command,
                        mode: mode.name(),
                    }),
                );
                mode
            }
            (mode, Input::Command(command)) => match command_in(mode, command, &mut goal, a) {
                Some(mode) => {
                    attempts = 0;
                    restarts |= command == Command::Restart;
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
                tested(SelfTest { imu: true, ..test }, goal, a)
            }
            (Mode::SelfTest(test), Input::Encoder(Ok(knows))) => {
                act(a, Action::Tell(Event::Encoder));
                tested(
                    SelfTest {
                        encoder: Some(knows),
                        ..test
                    },
                    goal,
                    a,
                )
            }
            (Mode::SelfTest(test), Input::Inspected(Ok(found))) => {
                act(a, Action::Tell(Event::Inspected(found)));
                if found.is_noisy() {
                    act(a, Action::Tell(Event::Noisy(found)));
                }
                tested(
                    SelfTest {
                        inspected: true,
                        ..test
                    },
                    goal,
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
                if homed { homed_for(goal, a) } else { search(a) }
            }
            (Mode::Homing(Homing::Searching), Input::Homed { angle }) => {
                act(a, Action::Tell(Event::Homed { angle }));
                homed_for(goal, a)
            }
            (Mode::Homing(_), Input::Tick) if in_mode_us > HOMING_US => {
                fault_in(self.mode, Fault::Rotor(rotor::RotorFault::Endless), attempts, a)
            }

            // Whatever the filter makes of samples of a wrong length: see `ClockSource`.
            (_, Input::Alignment(Alignment::Aligned)) if !self.clock.is_exact() => self.mode,
            (mode @ (Mode::Coarse | Mode::Fine | Mode::Aligned), Input::Alignment(told)) => {
                act(a, Action::Tell(Event::Alignment(told)));
                aligning(mode, told)
            }
            (Mode::Calibrating(Calibrating::Resting), Input::Rested) => {
                act(a, Action::Rotor(rotor::Command::Run));
                Mode::Calibrating(Calibrating::Turning)
            }
            (Mode::Calibrating(Calibrating::Turning), Input::GyrosCalibrated(Ok(found))) => {
                act(a, Action::Tell(Event::GyrosCalibrated(found)));
                act(a, Action::Tell(Event::GyroBiases(found)));
                goal = Goal::Rest;
                rest(a)
            }
            (Mode::Calibrating(_), Input::GyrosCalibrated(Err(failure))) => {
                act(a, Action::Tell(Event::NotCalibrated(failure)));
                goal = Goal::Rest;
                rest(a)
            }
            (Mode::Calibrating(_), Input::Tick) if in_mode_us > CALIBRATING_US => {
                act(a, Action::Tell(Event::NotCalibrated(CalibrationFailure::Timeout)));
                goal = Goal::Rest;
                rest(a)
            }
            (Mode::Navigating, Input::NavigationEnded(why)) => {
                act(a, Action::Tell(Event::NavigationEnded(why)));
                act(a, Action::Job(Job::Align));
                Mode::Coarse
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
                goal,
                restarts,
                clock: self.clock,
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

fn tested(test: SelfTest, goal: Goal, a: &mut Actions) -> Mode {
    let SelfTest {
        imu: true,
        encoder: Some(knows),
        inspected: true,
    } = test
    else {
        return Mode::SelfTest(test);
    };
    match knows {
        _ if goal == Goal::Rest => rest(a),
        RotorKnows {
            calibrated: false,
            homed,
        } => {
            act(a, Action::Rotor(rotor::Command::Calibrate));
            Mode::Homing(Homing::Calibrating { homed })
        }
        RotorKnows { homed: false, .. } => search(a),
        RotorKnows { .. } => homed_for(goal, a),
    }
}

fn rest(a: &mut Actions) -> Mode {
    act(a, Action::Rotor(rotor::Command::Stop));
    act(a, Action::Job(Job::Idle));
    Mode::Idle
}

/// The turn is known: on to what the start was for.
fn homed_for(goal: Goal, a: &mut Actions) -> Mode {
    match goal {
        Goal::Align => running(a),
        Goal::Calibrate => {
            act(a, Action::Job(Job::Calibrate { aligned: false }));
            Mode::Calibrating(Calibrating::Resting)
        }
        Goal::Rest => rest(a),
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
        | Alignment::RestartedDiverged
        | Alignment::UnderWay { .. }
        | Alignment::Elsewhere { .. } => Mode::Coarse,
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
        // Which none is that has led to start after start.
        if !graver || before.fault.brakes() || before.fault.name() == fault.name() {
            return mode;
        }
    }
    act(a, Action::Job(Job::Idle));
    act(a, Action::Tell(Event::Fault(fault)));
    // What ends in a reset waits for no command.
    if latched && response != Response::Reset {
        act(a, Action::Tell(Event::Latched));
    }
    Mode::Fault(Faulted { fault, latched })
}

/// The mode a command leads to; `None` where it makes no sense.
fn command_in(mode: Mode, command: Command, goal: &mut Goal, a: &mut Actions) -> Option<Mode> {
    if !takes(mode, command) {
        let mode = mode.name();
        act(a, Action::Tell(Event::Refused { command, mode }));
        return None;
    }
    act(a, Action::Tell(Event::Command(command)));
    Some(match (mode, command) {
        (_, Command::Restart) => {
            // The motor first: the watchdog takes its time.
            act(a, Action::Cut);
            mode
        }
        (_, Command::Stop) => {
            *goal = Goal::Rest;
            match mode {
                // The motor is off; the self-test that time or a command leads to ends in rest.
                Mode::Fault(_) => mode,
                _ => rest(a),
            }
        }
        (Mode::Aligned, Command::Calibrate) => {
            act(a, Action::Rotor(rotor::Command::Stop));
            act(a, Action::Job(Job::Calibrate { aligned: true }));
            Mode::Calibrating(Calibrating::Resting)
        }
        (_, Command::Navigate) => {
            act(a, Action::Job(Job::Navigate));
            Mode::Navigating
        }
        (Mode::Coarse | Mode::Fine | Mode::Aligned | Mode::Navigating, Command::Align) => {
            act(a, Action::Job(Job::Align));
            Mode::Coarse
        }
        (_, Command::Align | Command::Calibrate | Command::SelfTest | Command::ResetFault) => {
            *goal = match command {
                Command::Calibrate => Goal::Calibrate,
                Command::SelfTest => Goal::Rest,
                _ => Goal::Align,
            };
            self_test(a)
        }
    })
}

/// Whether a command makes sense in a mode.
fn takes(mode: Mode, command: Command) -> bool {
    match mode {
        // The reset that such a fault waits for is about to come; the start after it is to know of a stop.
        Mode::Fault(Faulted { fault, .. }) if fault.rule().response == Response::Reset => command == Command::Stop,
        _ => mode.name().takes(command),
    }
}

#[cfg(test)]
mod tests {
    use drivers::mt6835::Warnings;

    use super::*;
    use crate::log::GyrosCalibrated;

    const IDENTITY: Identity = Identity {
        product: 16495,
        revision: 0,
        serial: 1,
    };
    const FOUND: Found = Found {
        gravity: 9.8,
        rate: 0.0,
        rate_sd: 0.0,
        noise: 1e-5,
        noise_told: 1e-5,
    };

    const GYROS: GyrosCalibrated = GyrosCalibrated {
        bias_deg_h: [1.0, 2.0, 3.0],
        biases_used: true,
        misalignment_arcmin: [0.1, 0.2],
        scale_factor_ppm: 100.0,
        bias_sd_deg_h: 0.1,
        column_sd_ppm: 10.0,
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

    /// Every mode with every command, beside what the modes do.
    #[test]
    fn a_mode_takes_what_its_name_says_it_takes() {
        let fault = Fault::EncoderWarning {
            warnings: Warnings::NONE,
        };
        for mode in [
            Mode::Idle,
            Mode::SelfTest(SelfTest::default()),
            Mode::Homing(Homing::Searching),
            Mode::Calibrating(Calibrating::Resting),
            Mode::Coarse,
            Mode::Fine,
            Mode::Aligned,
            Mode::Navigating,
            Mode::Fault(Faulted { fault, latched: true }),
        ] {
            for command in Command::ALL {
                let state = State {
                    mode,
                    ..State::default()
                };
                let (_, actions) = state.step(&Input::Command(command), 1);
                let refused = actions
                    .iter()
                    .any(|action| matches!(action, Action::Tell(Event::Refused { .. })));
                assert_eq!(mode.name().takes(command), !refused, "{mode:?} {command:?}");
            }
        }
    }

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
    fn by_the_chips_own_clock_nothing_is_aligned_or_calibrated() {
        let to_fine = [
            Input::Start,
            knows(true, true),
            Input::Imu(Ok(IDENTITY)),
            Input::Inspected(Ok(FOUND)),
            Input::Alignment(COARSE),
            Input::Alignment(Alignment::CaughtUp),
        ];
        for (clock, expected) in [
            (ClockSource::Crystal, Mode::Aligned),
            (ClockSource::Internal, Mode::Fine),
        ] {
            let (fine, _) = run(State::new(false, clock), &to_fine);
            assert_eq!(fine.mode, Mode::Fine);
            let (next, actions) = fine.step(&Input::Alignment(Alignment::Aligned), 20_000_000);
            assert_eq!(next.mode, expected);
            // Nor does the log say so.
            assert_eq!(actions.is_empty(), clock == ClockSource::Internal);
            assert_eq!(next.clock, clock);
        }
        let resting = State {
            clock: ClockSource::Internal,
            ..in_mode(Mode::Idle)
        };
        let (next, actions) = resting.step(&Input::Command(Command::Calibrate), 1);
        assert_eq!(next, resting);
        assert!(
            matches!(actions[..], [Action::Tell(Event::Refused { .. })]),
            "{actions:?}"
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
        let looping = Fault::BootLoop { crashes: 3 };
        let overrun = Fault::TaskOverrun {
            task: crate::fault::Task::Motor,
            silent_ms: 10,
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
        let [resting, turning] = [Calibrating::Resting, Calibrating::Turning].map(Mode::Calibrating);
        let moved = CalibrationFailure::RotorMoved;
        use Alignment::{Aligned, Bridged, Inconsistent, RestartedDiverged, RestartedGap};
        for (row, (mode, input, expected)) in [
            (Mode::Idle, Input::Start, test),
            (Mode::Idle, command(Command::Align), test),
            (Mode::Idle, command(Command::Calibrate), test),
            (Mode::Idle, command(Command::SelfTest), test),
            (Mode::Idle, command(Command::Navigate), Mode::Idle),
            (Mode::Idle, command(Command::ResetFault), Mode::Idle),
            (Mode::Idle, Input::Imu(Ok(IDENTITY)), Mode::Idle),
            (resting, command(Command::Stop), Mode::Idle),
            (resting, command(Command::Align), test),
            (resting, Input::Rested, turning),
            (resting, Input::GyrosCalibrated(Ok(GYROS)), resting),
            (resting, Input::GyrosCalibrated(Err(moved)), Mode::Idle),
            (turning, Input::GyrosCalibrated(Ok(GYROS)), Mode::Idle),
            (turning, Input::GyrosCalibrated(Err(moved)), Mode::Idle),
            (turning, Input::Rested, turning),
            (turning, Input::Fault(crc), fault(crc, false)),
            (
                Mode::Navigating,
                Input::NavigationEnded(NavigationEnd::Lost),
                Mode::Coarse,
            ),
            (Mode::Navigating, command(Command::Align), Mode::Coarse),
            (Mode::Navigating, command(Command::Stop), Mode::Idle),
            (Mode::Navigating, command(Command::Navigate), Mode::Navigating),
            (Mode::Navigating, Input::Alignment(Aligned), Mode::Navigating),
            (test, command(Command::Align), test),
            (test, command(Command::Stop), Mode::Idle),
            (fault(crc, false), command(Command::Stop), fault(crc, false)),
            (fault(overrun, true), command(Command::Stop), fault(overrun, true)),
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
            (Mode::Aligned, command(Command::Calibrate), resting),
            (Mode::Fine, command(Command::Calibrate), Mode::Fine),
            (Mode::Aligned, command(Command::Navigate), Mode::Navigating),
            (Mode::Fine, command(Command::Navigate), Mode::Fine),
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
            // After too many crashes nothing starts the unit but the command, whatever else happens.
            (Mode::Idle, Input::Fault(looping), fault(looping, true)),
            (fault(looping, true), Input::Tick, fault(looping, true)),
            (fault(looping, true), Input::Fault(overrun), fault(looping, true)),
            (fault(looping, true), command(Command::Align), fault(looping, true)),
            (fault(looping, true), command(Command::Restart), fault(looping, true)),
            (fault(looping, true), command(Command::ResetFault), test),
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
            Mode::Calibrating(Calibrating::Turning),
            Mode::Coarse,
            Mode::Fine,
            Mode::Aligned,
            Mode::Navigating,
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
    fn who_reads_that_a_fault_is_latched_can_reset_it() {
        let clock = Fault::Clock {
            expected_us: 4940.0,
            measured_us: 5100.0,
        };
        let overrun = Fault::TaskOverrun {
            task: crate::fault::Task::Motor,
            silent_ms: 21,
        };
        for (fault, told) in [(clock, true), (overrun, false), (Fault::Driver, false)] {
            let (_, actions) = in_mode(Mode::Fine).step(&Input::Fault(fault), 5);
            assert_eq!(actions.contains(&Action::Tell(Event::Latched)), told, "{fault}");
        }
    }

    #[test]
    fn a_reset_outranks_a_latched_fault() {
        let latched = in_mode(Mode::Fault(Faulted {
            fault: Fault::Driver,
            latched: true,
        }));
        let overrun = Fault::TaskOverrun {
            task: crate::fault::Task::Motor,
            silent_ms: 21,
        };
        assert_eq!(overrun.rule().response, Response::Reset);
        let (state, actions) = latched.step(&Input::Fault(overrun), 5);
        assert_eq!(state.status().fault, Some(overrun));
        assert!(state.wants_reset() && !latched.wants_reset());
        assert_eq!(actions.first(), Some(&Action::Cut));
        // A fault that only latches does not take the place of another.
        let (state, _) = latched.step(&Input::Fault(Fault::EncoderInvalid), 5);
        assert_eq!(state.status().fault, Some(Fault::Driver));
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
        assert!(matches!(
            state.mode,
            Mode::Fault(Faulted {
                fault: Fault::Rotor(rotor::RotorFault::Endless),
                latched: true,
            })
        ));
    }

    #[test]
    fn a_start_leads_to_what_it_is_for() {
        let tested = [
            knows(true, false),
            Input::Imu(Ok(IDENTITY)),
            Input::Inspected(Ok(FOUND)),
        ];
        let (state, done) = run(in_mode(Mode::Idle), &[Input::Command(Command::SelfTest)]);
        assert!(!done.contains(&Action::Rotor(rotor::Command::Run)));
        let (state, done) = run(state, &tested);
        assert_eq!(state.mode, Mode::Idle);
        assert!(
            !done
                .iter()
                .any(|action| matches!(action, Action::Rotor(command) if *command != rotor::Command::Stop))
        );

        let (state, _) = run(in_mode(Mode::Idle), &[Input::Command(Command::Calibrate)]);
        let (state, _) = run(state, &tested);
        let (state, done) = run(state, &[Input::Homed { angle: 0.0 }, Input::Rested]);
        assert_eq!(state.mode, Mode::Calibrating(Calibrating::Turning));
        assert_eq!(
            done,
            [
                Action::Job(Job::Calibrate { aligned: false }),
                Action::Rotor(rotor::Command::Run)
            ]
        );
        // A fault on the way starts it again; once done, a start leads to alignment.
        let (again, _) = run(state, &[Input::Fault(Fault::Driver), Input::Tick, Input::Tick]);
        assert_eq!((again.mode.name(), again.goal), (ModeName::SelfTest, Goal::Calibrate));
        let (state, done) = run(state, &[Input::GyrosCalibrated(Ok(GYROS))]);
        assert_eq!((state.mode, state.goal), (Mode::Idle, Goal::Rest));
        assert_eq!(done, [Action::Rotor(rotor::Command::Stop), Action::Job(Job::Idle)]);
    }

    #[test]
    fn what_was_stopped_does_not_turn_by_itself() {
        let (fault, stop) = (Input::Fault(Fault::Driver), Input::Command(Command::Stop));
        let tested = [
            Input::Tick,
            Input::Tick,
            knows(true, true),
            Input::Imu(Ok(IDENTITY)),
            Input::Inspected(Ok(FOUND)),
        ];
        // Stopped, then a fault; a fault, then stopped; calibrated, then a fault.
        for inputs in [
            &[stop, fault][..],
            &[fault, stop],
            &[
                Input::Command(Command::Calibrate),
                Input::Rested,
                Input::GyrosCalibrated(Ok(GYROS)),
                fault,
            ],
        ] {
            let (state, done) = run(in_mode(Mode::Aligned), &[inputs, &tested].concat());
            assert_eq!(state.mode, Mode::Idle, "{inputs:?}");
            assert!(done.contains(&Action::StartEncoder));
            assert_eq!(done.last(), Some(&Action::Job(Job::Idle)), "{inputs:?}");
            let (state, _) = run(state, &[&[Input::Command(Command::Align)][..], &tested].concat());
            assert_eq!(state.mode, Mode::Coarse, "{inputs:?}");
        }
    }

    #[test]
    fn a_calibration_that_never_ends_does() {
        let state = in_mode(Mode::Calibrating(Calibrating::Resting));
        assert_eq!(state.step(&Input::Tick, CALIBRATING_US).0.mode, state.mode);
        assert_eq!(state.step(&Input::Tick, CALIBRATING_US + 1).0.mode, Mode::Idle);
    }

    #[test]
    fn a_restart_cuts_the_motor_and_starves_the_watchdog() {
        for mode in [Mode::Idle, Mode::Aligned, Mode::Navigating] {
            let (state, actions) = in_mode(mode).step(&Input::Command(Command::Restart), 1);
            assert!(actions.contains(&Action::Cut) && state.wants_reset());
            assert!(state.step(&Input::Tick, 2).0.wants_reset());
        }
    }

    #[test]
    fn nothing_releases_the_motor_after_a_restart() {
        let faulted = Mode::Fault(Faulted {
            fault: Fault::Driver,
            latched: false,
        });
        for mode in [Mode::Idle, Mode::Aligned, faulted] {
            let (state, _) = in_mode(mode).step(&Input::Command(Command::Restart), 1);
            for input in [Input::Start, Input::Tick, Input::Fault(Fault::Driver)]
                .into_iter()
                .chain(Command::ALL.map(Input::Command))
            {
                let (state, actions) = state.step(&input, HOMING_US);
                assert!(!actions.contains(&Action::Release), "{mode:?} {input:?}");
                assert!(state.wants_reset(), "{mode:?} {input:?}");
            }
        }
    }

    #[test]
    fn a_hanging_task_starves_the_watchdog() {
        let overrun = Fault::TaskOverrun {
            task: crate::fault::Task::Motor,
            silent_ms: 10,
        };
        let (state, _) = in_mode(Mode::Fine).step(&Input::Fault(overrun), 1);
        assert!(state.wants_reset());
        for command in Command::ALL {
            let (state, _) = state.step(&Input::Command(command), 2);
            assert!(state.wants_reset(), "{command}");
            assert_eq!(state.goal == Goal::Rest, command == Command::Stop, "{command}");
        }
    }
}
