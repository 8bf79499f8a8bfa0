//! A soak: the whole unit for hours of virtual time, while chance breaks it, types at it and shakes its lines.
//!
//! ```text
//!            ┌──────────────── next, after a while or at once ────────────────┐
//!            ▼                                                                │
//!  something breaks ──► found, in time? ──► mended ──► aligned again, in time? ┘
//!                           │ latched: somebody types `reset`
//! ```
//!
//! | what | how often | what |
//! |---|---|---|
//! | faults | one after the other, at times two at once | each of [`FaultKind`], from 5 ms to 60 s |
//! | boot loops | 1 of 30 | a task that hangs at every start |
//! | failed transfers | once in some minutes | 1 to 8 on a bus |
//! | lines typed | two a minute | words of the console, right and wrong, nonsense, and a receiver's sentences; at times it records |
//! | noise | once in some minutes | wrong bits both ways, garbage, a broken line |
//!
//! # What must hold
//!
//! - The program runs on: no panic, no endless loop ([`UnitError::Program`]).
//! - The motor is off within 2 ms from the instant a fault is found, and stays off while it is on.
//! - A fault that begins while the unit aligns or is aligned, alone, and lasts for longer than its rule allows, is found
//!   within that time, and is in the black box.
//! - No other fault is found: none without a cause.
//! - Once nothing is broken any more and the unit starts again it is aligned within [`LIMIT`] times the time that it
//!   took at first, unless somebody tells it something else meanwhile.
//! - A unit that rests, or took a `stop`, does not turn before somebody tells it to, or supply or reset line start it.
//! - Every line typed on a sound serial line is answered within 2 s; what comes from it has the right check sum.
//! - The cable is never wound past what it bears.
//! - The memory of the process does not grow.

use std::collections::{BTreeMap, VecDeque};

use app::command::ModeName;
use app::fault::{Fault, Task};
use app::hal::ResetCause;
use app::record;
use app::selftest::Failure;
use drivers::Channels;
use drivers::crc::crc32;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde::Serialize;

use crate::align::Method;
use crate::bus::{UartFaults, UartLine};
use crate::nmea;
use crate::scenario::{FaultKind, Scenario};
use crate::unit_sim::{FaultFound, Line, Observer, RobustSession, UnitError, Watched};

/// Longest time to be aligned again, in those of the first start.
pub const LIMIT: f64 = 1.5;
/// Longest time to an answer, µs.
const ANSWER_US: u64 = 2_000_000;
/// From one look to the next, µs.
const STEP_US: u64 = 100_000;
/// Instants as close as this are one, µs: which of two came first cannot be seen from outside.
const AT_ONCE_US: u64 = STEP_US;
/// So long after something was mended a fault may still be of it, µs: the home switch shows at its next passing.
const AFTER_US: u64 = 25_000_000;
/// Longest wait for a retry, µs: that of over-temperature, and the self-test's timeout.
const RETRY_US: u64 = 22_000_000;
/// Longest first start, µs.
const FIRST_US: u64 = 300_000_000;
/// Growth of the process' memory that is taken for noise, kB.
const GROWTH_KB: u64 = 4096;
/// Failures that are kept in words.
const KEPT: usize = 50;
/// Lines of the log that are kept with a failure.
const LINES: usize = 16;

/// All that breaks.
const KINDS: [FaultKind; 22] = {
    use FaultKind as F;
    [
        F::ImuEdges,
        F::ImuSilent,
        F::ImuCrc,
        F::ImuSaturated,
        F::ImuStuckData,
        F::ImuStuckCounter,
        F::ImuFlags,
        F::ImuHot,
        F::ImuRate,
        F::ImuBus,
        F::EncoderSilent,
        F::EncoderCrc,
        F::EncoderFrozen,
        F::EncoderWeak,
        F::Driver,
        F::Jam,
        F::HomeBroken,
        F::HomeStuck,
        F::HangSampling,
        F::HangMotor,
        F::HangAlignment,
        F::Reset,
    ]
};

/// As what a unit that runs finds it, and the longest time its rule allows, ms; `None` for a reset.
fn found_as(kind: FaultKind) -> Option<(&'static str, u32)> {
    use FaultKind as F;
    let (name, like) = match kind {
        F::ImuEdges => ("imu-silent", Fault::ImuSilent { waited_us: 0 }),
        F::ImuSilent | F::ImuCrc => (
            "imu-transfer",
            Fault::ImuTransfer {
                error: drivers::Error::Silent { level: 0 },
                in_row: 0,
            },
        ),
        F::ImuSaturated => (
            "imu-saturated",
            Fault::ImuSaturated {
                channels: Channels::NONE,
                in_row: 0,
            },
        ),
        F::ImuStuckData | F::ImuStuckCounter => ("imu-stuck", Fault::ImuStuck { in_row: 0 }),
        F::ImuFlags => (
            "imu-flags",
            Fault::ImuFlags {
                flags: drivers::SystemFlags::OVERRUN,
            },
        ),
        F::ImuHot => ("over-temperature", Fault::OverTemperature { temperature_c: 0.0 }),
        F::ImuRate => (
            "clock",
            Fault::Clock {
                expected_us: 0.0,
                measured_us: 0.0,
            },
        ),
        F::ImuBus | F::HangSampling | F::HangMotor | F::HangAlignment => (
            "task-overrun",
            Fault::TaskOverrun {
                task: Task::Motor,
                silent_ms: 0,
            },
        ),
        F::EncoderSilent | F::EncoderCrc => ("encoder-invalid", Fault::EncoderInvalid),
        F::EncoderFrozen => ("encoder-frozen", Fault::EncoderFrozen),
        F::EncoderWeak => (
            "encoder-warning",
            Fault::EncoderWarning {
                warnings: drivers::mt6835::Warnings::NONE,
            },
        ),
        F::Driver => ("driver", Fault::Driver),
        F::Jam => (
            "stall",
            Fault::Stall {
                rotor: app::rotor::RotorFault::EncoderFrozen,
            },
        ),
        F::HomeBroken => ("rotor", Fault::Rotor(app::rotor::RotorFault::EncoderFrozen)),
        // Found where the rotor passes the edge, and by no other rule.
        F::HomeStuck => ("rotor", Fault::SelfTest(Failure::NoNoise)),
        F::Reset => return None,
    };
    let within_ms = match kind {
        F::HomeStuck => 20_000,
        _ => like.rule().within_ms,
    };
    Some((name, within_ms))
}

/// What to run.
#[derive(Debug, Clone, PartialEq)]
pub struct SoakConfig {
    /// Virtual time, h.
    pub hours: f64,
    /// Seed of every chance.
    pub seed: u64,
}

/// What became of one kind of fault.
#[derive(Debug, Clone, PartialEq, Default, Serialize)]
pub struct KindReport {
    /// Times it was injected.
    pub injected: u32,
    /// Of those, the times it had to be found.
    pub due: u32,
    /// Of those that had to be, the times it was found in time.
    pub found: u32,
    /// Found all the same: shorter, or in another mode.
    pub found_beside: u32,
    /// Longest time to find it, of those due, ms.
    pub longest_ms: f64,
    /// What its rule allows, ms.
    pub allowed_ms: u32,
}

/// Times, s.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize)]
pub struct Times {
    /// How many.
    pub count: u32,
    /// Their mean.
    pub mean_s: f64,
    /// The longest.
    pub longest_s: f64,
}

impl Times {
    fn push(&mut self, time_s: f64) {
        self.count += 1;
        self.mean_s += (time_s - self.mean_s) / f64::from(self.count);
        self.longest_s = self.longest_s.max(time_s);
    }
}

/// What was typed and said.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize)]
pub struct Serial {
    /// Lines typed.
    pub lines: u32,
    /// Of those, on a sound line and with the unit up until they were due.
    pub due: u32,
    /// Of those, answered.
    pub answered: u32,
    /// Bytes to the unit.
    pub bytes_in: u64,
    /// Bytes from it.
    pub bytes_out: u64,
    /// Sentences from it.
    pub sentences: u64,
    /// Times that its line was noisy or cut.
    pub noises: u32,
    /// Sentences with a wrong check sum while it was.
    pub garbled: u64,
}

/// Heading while the unit said it was aligned.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize)]
pub struct Heading {
    /// Looks, one a second.
    pub looks: u32,
    /// Root mean square of error/σ.
    pub normalised_rms: f64,
    /// Looks with more than 5 σ.
    pub beyond_5_sd: u32,
    /// Largest error, degrees.
    pub largest_deg: f64,
}

/// Starts that ended in a crash again and again.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize)]
pub struct BootLoops {
    /// How many.
    pub made: u32,
    /// Of those, ended with the brake on.
    pub braked: u32,
}

/// Resets.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize)]
pub struct Resets {
    /// By the watchdog.
    pub watchdog: u32,
    /// Of those, by command.
    pub command: u32,
    /// By supply and reset line.
    pub outside: u32,
}

/// Longest silence of each task, ms: that of a hanging one until its reset is in it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize)]
pub struct Silent {
    /// Of [`Task::Sampling`].
    pub sampling: u32,
    /// Of [`Task::Motor`].
    pub motor: u32,
    /// Of [`Task::Alignment`].
    pub alignment: u32,
}

/// The most that waited at once while no task hung.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize)]
pub struct Waiting {
    /// Samples for the alignment.
    pub samples: usize,
    /// Inputs for the supervisor.
    pub inputs: usize,
    /// Commands for it.
    pub commands: usize,
}

/// Samples of the IMU.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize)]
pub struct Samples {
    /// Received.
    pub received: u64,
    /// Of those, dropped because the alignment did not keep up.
    pub dropped: u64,
}

/// Resident memory of the process, kB; zero where the system does not tell.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize)]
pub struct Memory {
    /// After a quarter of an hour.
    pub warm: u64,
    /// At the end.
    pub end: u64,
}

/// What came of a soak.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct SoakReport {
    /// Seed.
    pub seed: u64,
    /// Virtual time, h.
    pub hours: f64,
    /// From power-up to aligned, undisturbed, s.
    pub first_start_s: f64,
    /// What is allowed to be aligned again, s.
    pub limit_s: f64,
    /// By kind of fault.
    pub kinds: BTreeMap<String, KindReport>,
    /// From a start after a fault, with nothing broken any more, to aligned.
    pub recoveries: Times,
    /// The same without a start: from the beginning of an alignment.
    pub realigned: Times,
    /// Starts after a fault that something else broke into: another fault, a command, a reset.
    pub broken_into: u32,
    /// Faults that the unit told.
    pub faults: u32,
    /// Longest time from a fault being found to the motor off, ms.
    pub motor_off_ms: f64,
    /// Boot loops.
    pub boot_loops: BootLoops,
    /// Resets.
    pub resets: Resets,
    /// Rows of failed transfers on the buses.
    pub failed_transfers: u32,
    /// The serial line.
    pub serial: Serial,
    /// The heading.
    pub heading: Heading,
    /// Longest silence of the tasks.
    pub silent_ms: Silent,
    /// The most that waited.
    pub waiting: Waiting,
    /// Samples.
    pub samples: Samples,
    /// Memory of the process.
    pub memory_kb: Memory,
    /// What did not hold, the first ones in words.
    pub failures: Vec<String>,
    /// How much did not hold.
    pub failed: u32,
}

impl SoakReport {
    /// Whether all held.
    pub fn is_sound(&self) -> bool {
        self.failed == 0
    }

    /// For people.
    pub fn table(&self) -> String {
        let mut text = format!(
            "{:.2} h of virtual time, seed {}\n{:<18} {:>8} {:>6} {:>6} {:>7} {:>9} {:>9}\n",
            self.hours, self.seed, "fault", "injected", "due", "found", "beside", "longest", "allowed"
        );
        for (name, kind) in &self.kinds {
            text += &format!(
                "{name:<18} {:>8} {:>6} {:>6} {:>7} {:>6.1} ms {:>6} ms\n",
                kind.injected, kind.due, kind.found, kind.found_beside, kind.longest_ms, kind.allowed_ms
            );
        }
        let (r, s, h) = (&self.recoveries, &self.serial, &self.heading);
        text += &format!(
            "faults told: {}; motor off after {:.3} ms at the most\n\
             boot loops: {}, braked {}; resets: {} by the watchdog, {} of them by command, {} by supply and reset line\n\
             aligned at first after {:.1} s; started again {} times, aligned after {:.1} s, at the most {:.1} of {:.1} s; \
             broken into {} times; aligned anew {} times, after {:.1} s, at the most {:.1}\n\
             typed: {} lines, {} due, {} answered; {} bytes in, {} out; {} sentences; {} noises, {} sentences garbled\n\
             failed transfers: {} rows; samples {}, dropped {}\n\
             heading: {} looks, error/sd rms {:.2}, beyond 5 sd {}, largest error {:.2} deg\n\
             silent for at the most: sampling {} ms, motor {} ms, alignment {} ms\n\
             waiting at the most: {} of {} samples, {} of {} inputs, {} of {} commands\n\
             memory: {} kB warm, {} kB at the end\n",
            self.faults,
            self.motor_off_ms,
            self.boot_loops.made,
            self.boot_loops.braked,
            self.resets.watchdog,
            self.resets.command,
            self.resets.outside,
            self.first_start_s,
            r.count,
            r.mean_s,
            r.longest_s,
            self.limit_s,
            self.broken_into,
            self.realigned.count,
            self.realigned.mean_s,
            self.realigned.longest_s,
            s.lines,
            s.due,
            s.answered,
            s.bytes_in,
            s.bytes_out,
            s.sentences,
            s.noises,
            s.garbled,
            self.failed_transfers,
            self.samples.received,
            self.samples.dropped,
            h.looks,
            h.normalised_rms,
            h.beyond_5_sd,
            h.largest_deg,
            self.silent_ms.sampling,
            self.silent_ms.motor,
            self.silent_ms.alignment,
            self.waiting.samples,
            app::shared::SAMPLES,
            self.waiting.inputs,
            app::shared::INPUTS,
            self.waiting.commands,
            app::shared::COMMANDS,
            self.memory_kb.warm,
            self.memory_kb.end,
        );
        for failure in &self.failures {
            text += &format!("FAILED {failure}\n");
        }
        text += if self.is_sound() {
            "all held\n"
        } else {
            "not all held\n"
        };
        text
    }
}

/// Something that is broken.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Broken {
    kind: FaultKind,
    at_us: u64,
    until_us: u64,
    /// It has to be found.
    due: bool,
    found: bool,
}

/// What comes from the unit's serial port.
#[derive(Default)]
struct Heard {
    bytes: u64,
    sentences: u64,
    /// Sentences with a wrong check sum, and when the first of them came.
    wrong: Vec<u64>,
    /// Answers: whether they say ok.
    answers: VecDeque<bool>,
    /// Status sentences.
    status: u64,
    /// The last lines of the log.
    log: VecDeque<String>,
}

impl Observer for Heard {
    fn line(&mut self, line: &Line) {
        // What is told every second says nothing of a failure.
        let mode = |mode: ModeName| line.text.strip_prefix(mode.column());
        let report = ModeName::ALL.into_iter().find_map(mode);
        if report.is_some_and(|rest| rest.starts_with(" rotor")) {
            return;
        }
        if self.log.len() == LINES {
            self.log.pop_front();
        }
        self.log.push_back(line.to_string());
    }

    fn sentence(&mut self, line: &UartLine) {
        self.bytes += line.bytes.len() as u64;
        self.sentences += u64::from(!line.bytes.starts_with(&[record::SYNC]));
        if !is_sound(&line.bytes) {
            self.wrong.push(line.started_ns / 1000);
        } else if let Some(rest) = line.bytes.strip_prefix(b"$PRNSA,") {
            self.answers.push_back(rest.starts_with(b"ok"));
        } else if line.bytes.starts_with(b"$PRNST,") {
            self.status += 1;
        }
    }
}

/// Whether a sentence or a frame has the check sum that it says.
fn is_sound(line: &[u8]) -> bool {
    if let [record::SYNC, frame @ ..] = line {
        let parts = frame.split_last_chunk();
        return parts.is_some_and(|(body, crc)| crc32(body.iter().copied()) == u32::from_le_bytes(*crc));
    }
    nmea::whole(line).is_some()
}

/// What a line that was typed must bring about.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Answer {
    /// Any answer.
    Any,
    /// An error.
    Error,
    /// The status sentence.
    Status,
}

/// A way to being aligned.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Starting {
    from_us: u64,
    /// From the self-test on.
    whole: bool,
}

/// A line on its way.
#[derive(Debug, Clone)]
struct Asked {
    text: String,
    at_us: u64,
    expected: Answer,
    /// Status sentences before.
    status: u64,
}

struct Soak {
    session: RobustSession,
    rng: ChaCha8Rng,
    heard: Heard,
    report: SoakReport,
    broken: Vec<Broken>,
    /// The last thing that was done to the unit or ended, µs: a fault may be of it for a while.
    disturbed_us: u64,
    /// Since when the unit starts again, with nothing broken, or aligns again.
    starting: Option<Starting>,
    was: Option<(ModeName, u64)>,
    /// When somebody last told it to turn, or supply or reset line did.
    told_us: u64,
    /// Since when it rests, or has taken a `stop`.
    rests_us: Option<u64>,
    next_fault_us: Option<u64>,
    next_line_us: u64,
    next_noise_us: u64,
    next_transfers_us: u64,
    noisy_until_us: Option<u64>,
    /// Before it a garbled sentence may come out of the noise.
    quiet_us: u64,
    asked: Option<Asked>,
    /// What somebody types to get the unit going again, and when.
    help: Option<(u64, &'static str)>,
    looping: Option<(Task, u64)>,
    braked: bool,
    last_fault: Option<(u64, &'static str)>,
    next_look_us: u64,
    /// The cable was wound past what it bears, and that has been told.
    wound: bool,
    /// The heading is wrong, and that has been told.
    wrong: bool,
    received: u32,
    limit_us: u64,
}

/// Runs one, telling how far it is, s. The report says whether all held.
///
/// # Errors
/// [`UnitError`] where the program hangs or panics.
pub fn run(config: &SoakConfig, mut progress: impl FnMut(f64)) -> Result<SoakReport, UnitError> {
    let scenario = Scenario {
        name: "soak".to_owned(),
        ..Scenario::builtin("paper-sim").unwrap_or_default()
    };
    let mut soak = Soak::new(&scenario, config)?;
    soak.first_start()?;
    let end_us = (config.hours * 3.6e9) as u64;
    while soak.session.now_us() < end_us {
        soak.step(end_us)?;
        progress(soak.session.now_us() as f64 * 1e-6);
    }
    Ok(soak.finish())
}

impl Soak {
    fn new(scenario: &Scenario, config: &SoakConfig) -> Result<Self, UnitError> {
        let mut session = RobustSession::new(scenario, config.seed, Method::Robust, &[])?;
        session.watch();
        let mut report = SoakReport {
            seed: config.seed,
            hours: config.hours,
            first_start_s: 0.0,
            limit_s: 0.0,
            kinds: BTreeMap::new(),
            recoveries: Times::default(),
            realigned: Times::default(),
            broken_into: 0,
            faults: 0,
            motor_off_ms: 0.0,
            boot_loops: BootLoops::default(),
            resets: Resets::default(),
            failed_transfers: 0,
            serial: Serial::default(),
            heading: Heading::default(),
            silent_ms: Silent::default(),
            waiting: Waiting::default(),
            samples: Samples::default(),
            memory_kb: Memory::default(),
            failures: Vec::new(),
            failed: 0,
        };
        for kind in KINDS {
            report.kinds.insert(
                name(kind),
                KindReport {
                    allowed_ms: found_as(kind).map_or(0, |(_, within_ms)| within_ms),
                    ..KindReport::default()
                },
            );
        }
        Ok(Self {
            session,
            rng: ChaCha8Rng::seed_from_u64(config.seed ^ 0x50AC),
            heard: Heard::default(),
            report,
            broken: Vec::new(),
            disturbed_us: 0,
            starting: None,
            was: None,
            told_us: 0,
            rests_us: None,
            next_fault_us: None,
            next_line_us: 0,
            next_noise_us: 0,
            next_transfers_us: 0,
            noisy_until_us: None,
            quiet_us: 0,
            asked: None,
            help: None,
            looping: None,
            braked: false,
            last_fault: None,
            next_look_us: 0,
            wound: false,
            wrong: false,
            received: 0,
            limit_us: FIRST_US,
        })
    }

    fn fail(&mut self, what: String) {
        self.report.failed += 1;
        if self.report.failures.len() < KEPT {
            let mut text = format!("at {:.3} s: {what}", self.session.now_us() as f64 * 1e-6);
            for line in &self.heard.log {
                text += &format!("\n    {line}");
            }
            self.report.failures.push(text);
        }
    }

    /// Undisturbed, until aligned: what later starts are measured by.
    fn first_start(&mut self) -> Result<(), UnitError> {
        while self.session.now_us() < FIRST_US {
            self.session
                .run_until_us(self.session.now_us() + STEP_US, &mut self.heard)?;
            if let Some(status) = self.session.status()
                && status.mode == ModeName::Aligned
            {
                let now_us = self.session.now_us();
                self.report.first_start_s = status.since_us as f64 * 1e-6;
                self.limit_us = (LIMIT * status.since_us as f64) as u64;
                self.next_line_us = now_us;
                self.next_noise_us = now_us + self.micros(10.0, 300.0);
                self.next_transfers_us = now_us + self.micros(10.0, 300.0);
                self.next_fault_us = Some(now_us + self.micros(0.5, 60.0));
                break;
            }
        }
        self.report.limit_s = self.limit_us as f64 * 1e-6;
        if self.report.first_start_s == 0.0 {
            self.fail("was not aligned at first".to_owned());
        }
        Ok(())
    }

    /// Evenly, given in s.
    fn micros(&mut self, from_s: f64, to_s: f64) -> u64 {
        (1e6 * self.rng.random_range(from_s..to_s)) as u64
    }

    fn chance(&mut self, probability: f64) -> bool {
        self.rng.random::<f64>() < probability
    }

    fn step(&mut self, end_us: u64) -> Result<(), UnitError> {
        let now_us = self.session.now_us();
        let mut until_us = (now_us + STEP_US).min(end_us);
        for due in self
            .broken
            .iter()
            .map(|broken| broken.until_us)
            .chain(self.next_fault_us)
        {
            until_us = until_us.min(due.max(now_us + 1));
        }
        if let Some(cause) = self.session.run_until_us(until_us, &mut self.heard)? {
            self.was_reset(cause);
        }
        self.see_faults();
        self.see_mode();
        self.see_answers();
        self.mend();
        self.disturb()?;
        self.look();
        Ok(())
    }

    fn was_reset(&mut self, cause: ResetCause) {
        let now_us = self.session.now_us();
        if matches!(cause, ResetCause::PowerOn | ResetCause::Pin) {
            self.told_us = now_us;
        }
        self.received = 0;
        self.asked = None;
        self.help = None;
        self.was = None;
        self.starting = None;
        self.quiet_us = self.quiet_us.max(now_us + 100_000);
        if cause != ResetCause::Watchdog || self.session.asked() {
            self.overtake();
        }
        // Of the unit's own clock nothing is left, of the simulator's all: modes and faults keep its time.
        match cause {
            ResetCause::Watchdog => {
                self.report.resets.watchdog += 1;
                if self.session.asked() {
                    self.report.resets.command += 1;
                } else if self.quiet_since(now_us) {
                    self.fail("the watchdog bit, and nothing was wrong".to_owned());
                }
            }
            _ => self.report.resets.outside += 1,
        }
    }

    /// Whether nothing has been done to the unit for so long that no fault can be of it.
    fn quiet_since(&self, now_us: u64) -> bool {
        self.broken.is_empty() && self.looping.is_none() && now_us > self.disturbed_us + AFTER_US
    }

    fn see_faults(&mut self) {
        for found in self.session.take_faults() {
            let FaultFound {
                t_s,
                name,
                text,
                motor_off_ms,
                ..
            } = found;
            let at_us = (t_s * 1e6).round() as u64;
            if self.last_fault == Some((at_us, name)) {
                continue;
            }
            self.last_fault = Some((at_us, name));
            self.report.faults += 1;
            self.report.motor_off_ms = self.report.motor_off_ms.max(motor_off_ms);
            if motor_off_ms > 2.0 {
                self.fail(format!("{name}: the motor went off after {motor_off_ms} ms"));
            }
            if !self.session.records().iter().any(|entry| entry.cause.name() == name) {
                self.fail(format!("{name} is not in the black box"));
            }
            if name == "boot-loop" || name == "held" {
                self.braked = true;
                continue;
            }
            if self.quiet_since(at_us) {
                self.fail(format!("{name} without a cause: {text}"));
            }
            for k in 0..self.broken.len() {
                let broken = self.broken[k];
                let Some((expected, within_ms)) = found_as(broken.kind) else {
                    continue;
                };
                if broken.found || at_us < broken.at_us {
                    continue;
                }
                if broken.kind == FaultKind::HomeStuck && name != expected {
                    // It shows at the rotor's next passing: something else came first, and then all is started anew.
                    self.broken[k].due = false;
                    continue;
                }
                self.broken[k].found = true;
                if !broken.due {
                    self.kind(broken.kind).found_beside += 1;
                    continue;
                }
                let took_ms = (at_us - broken.at_us) as f64 * 1e-3;
                let report = self.kind(broken.kind);
                report.found += 1;
                report.longest_ms = report.longest_ms.max(took_ms);
                if name != expected && !(broken.kind == FaultKind::Jam && name == "encoder-frozen") {
                    self.fail(format!("{:?} was found as {name}", broken.kind));
                }
                if took_ms > f64::from(within_ms) {
                    self.fail(format!("{:?} was found after {took_ms} ms", broken.kind));
                }
            }
        }
    }

    /// Something else happens: what has not been found by now need not be found first, nor in time.
    fn overtake(&mut self) {
        let mut overtaken = Vec::new();
        for broken in self.broken.iter_mut().filter(|broken| broken.due && !broken.found) {
            broken.due = false;
            overtaken.push(broken.kind);
        }
        for kind in overtaken {
            self.kind(kind).due -= 1;
        }
    }

    fn kind(&mut self, kind: FaultKind) -> &mut KindReport {
        self.report.kinds.entry(name(kind)).or_default()
    }

    /// Follows the unit from mode to mode: starts, being aligned, and when it needs somebody.
    fn see_mode(&mut self) {
        let Some(status) = self.session.status() else { return };
        let now_us = self.session.now_us();
        let mode = status.mode;
        if self.was != Some((mode, status.since_us)) {
            self.was = Some((mode, status.since_us));
            self.entered(mode, status.since_us);
        }
        if let Some(Starting { from_us, .. }) = self.starting
            && now_us > from_us + self.limit_us
        {
            self.starting = None;
            self.fail(format!("not aligned in time but in mode {mode}"));
        }
        let needs_help = match mode {
            ModeName::Fault if status.latched => Some("reset"),
            ModeName::Fault if now_us > status.since_us.max(self.disturbed_us) + RETRY_US => {
                if self.help.is_none() {
                    self.fail("a fault that is not latched, and no retry".to_owned());
                }
                Some("reset")
            }
            ModeName::Idle | ModeName::Navigating => Some("align"),
            _ => None,
        };
        match needs_help {
            None => self.help = None,
            Some(line) if self.help.is_none() && self.looping.is_none() => {
                self.help = Some((now_us + self.micros(1.0, 20.0), line));
            }
            Some(_) => {}
        }
    }

    fn entered(&mut self, mode: ModeName, since_us: u64) {
        let sound = self.broken.is_empty() && self.looping.is_none();
        let from_us = since_us.max(self.disturbed_us);
        match (mode, self.rests_us) {
            (ModeName::Idle, _) => self.rests_us = Some(since_us),
            (ModeName::Homing | ModeName::Coarse | ModeName::Calibrating, Some(rests_us)) => {
                if self.told_us + AT_ONCE_US < rests_us && since_us > rests_us + AT_ONCE_US {
                    self.fail(format!("it rested, and is in mode {mode} without having been told"));
                }
                self.rests_us = None;
            }
            _ => {}
        }
        match mode {
            ModeName::SelfTest => {
                self.starting = sound.then_some(Starting { from_us, whole: true });
                self.report.broken_into += u32::from(!sound);
            }
            ModeName::Coarse if sound && self.starting.is_none() => {
                self.starting = Some(Starting { from_us, whole: false });
            }
            ModeName::Fault | ModeName::Idle | ModeName::Calibrating => self.starting = None,
            ModeName::Aligned => {
                if let Some(Starting { from_us, whole }) = self.starting.take() {
                    let report = &mut self.report;
                    let times = if whole {
                        &mut report.recoveries
                    } else {
                        &mut report.realigned
                    };
                    times.push((since_us - from_us) as f64 * 1e-6);
                }
                if self.next_fault_us.is_none() {
                    self.next_fault_us = Some(self.session.now_us() + self.micros(0.5, 120.0));
                }
            }
            _ => {}
        }
    }

    /// Whoever disturbs the unit: a start under way does not count any more.
    fn disturbed(&mut self) {
        self.disturbed_us = self.session.now_us();
        if self.starting.take().is_some() {
            self.report.broken_into += 1;
        }
    }

    fn see_answers(&mut self) {
        let now_us = self.session.now_us();
        for at_us in core::mem::take(&mut self.heard.wrong) {
            if self.noisy_until_us.is_some() || at_us < self.quiet_us {
                self.report.serial.garbled += 1;
            } else {
                self.fail("a sentence with a wrong check sum on a sound line".to_owned());
            }
        }
        let Some(asked) = &self.asked else {
            self.heard.answers.clear();
            return;
        };
        let answer = match asked.expected {
            Answer::Status => (self.heard.status > asked.status).then_some(true),
            Answer::Any | Answer::Error => self.heard.answers.pop_front(),
        };
        let Asked {
            text, at_us, expected, ..
        } = asked.clone();
        match answer {
            None if now_us < at_us + ANSWER_US => return,
            None => {
                self.report.serial.due += 1;
                self.fail(format!("{text:?} was not answered"));
            }
            Some(taken) => {
                self.report.serial.due += 1;
                self.report.serial.answered += 1;
                if text == "stop" && taken {
                    self.rests_us = Some(at_us);
                }
                if taken && expected == Answer::Error {
                    self.fail(format!("{text:?} was taken"));
                }
            }
        }
        self.asked = None;
        self.heard.answers.clear();
    }

    fn mend(&mut self) {
        let now_us = self.session.now_us();
        let (over, still): (Vec<Broken>, Vec<Broken>) = self
            .broken
            .iter()
            .copied()
            .partition(|broken| now_us >= broken.until_us);
        self.broken = still;
        for broken in over {
            self.session.set_fault(broken.kind, false);
            self.disturbed_us = now_us;
            if broken.due && !broken.found {
                self.fail(format!("{:?} was not found", broken.kind));
            }
            if self.next_fault_us.is_none() && self.chance(0.4) {
                // Into the start, or into the retries.
                self.next_fault_us = Some(now_us + self.micros(0.0, 60.0));
            }
            // A start that began before it was mended may have been spoilt by it.
            self.starting = None;
            if matches!(self.was, Some((ModeName::SelfTest, _))) && self.broken.is_empty() {
                self.starting = Some(Starting {
                    from_us: now_us,
                    whole: true,
                });
            }
        }
        if let Some((task, until_us)) = self.looping
            && now_us >= until_us
        {
            self.looping = None;
            self.session.hang_at_start(None);
            self.session.set_fault(hang(task), false);
            self.disturbed_us = now_us;
            // One that hangs while a fault is latched ends in that.
            let fault = self.session.status().and_then(|status| status.fault);
            if self.braked || fault.is_some_and(|fault| fault.brakes()) {
                self.report.boot_loops.braked += 1;
            } else {
                self.fail(format!("{task:?} hung at every start, and no brake was on"));
            }
        }
    }

    /// What is due of all that is done to the unit.
    fn disturb(&mut self) -> Result<(), UnitError> {
        let now_us = self.session.now_us();
        if self.next_fault_us.is_some_and(|at_us| now_us >= at_us) {
            self.next_fault_us = None;
            self.break_something()?;
        }
        if now_us >= self.next_transfers_us {
            self.next_transfers_us = now_us + self.micros(60.0, 900.0);
            // The same switch as that of a bus that hangs.
            if self.broken.iter().all(|broken| broken.kind != FaultKind::ImuBus) {
                let (imu, count) = (self.chance(0.5), self.rng.random_range(1..9_u32));
                self.disturbed();
                self.report.failed_transfers += 1;
                self.overtake();
                let (imu, encoder) = if imu { (count, 0) } else { (0, count) };
                self.session.fail_transfers(imu, encoder);
            }
        }
        self.make_noise(now_us);
        if self.asked.is_some() || now_us < self.next_line_us {
            return Ok(());
        }
        if let Some((at_us, line)) = self.help
            && now_us >= at_us
            && self.noisy_until_us.is_none()
        {
            self.help = None;
            self.disturbed();
            self.type_line(line, Answer::Any);
            return Ok(());
        }
        self.next_line_us = now_us + self.micros(3.0, 57.0);
        self.type_something();
        Ok(())
    }

    fn break_something(&mut self) -> Result<(), UnitError> {
        let now_us = self.session.now_us();
        if self.looping.is_some() {
            return Ok(());
        }
        if self.chance(1.0 / 30.0) && self.broken.is_empty() {
            let task = Task::ALL[self.rng.random_range(0..Task::ALL.len())];
            self.disturbed();
            self.braked = false;
            self.report.boot_loops.made += 1;
            self.session.hang_at_start(Some(task));
            self.session.set_fault(hang(task), true);
            // Three resets of 0.2 s each.
            self.looping = Some((task, now_us + self.micros(5.0, 60.0)));
            return Ok(());
        }
        let kind = KINDS[self.rng.random_range(0..KINDS.len())];
        if self.broken.iter().any(|broken| broken.kind == kind) {
            return Ok(());
        }
        if kind == FaultKind::Reset {
            let causes = [ResetCause::Pin, ResetCause::PowerOn, ResetCause::BrownOut];
            let cause = causes[self.rng.random_range(0..causes.len())];
            self.disturbed();
            self.kind(kind).injected += 1;
            self.session.reset(cause, &mut self.heard)?;
            self.was_reset(cause);
            return Ok(());
        }
        let length_us = (5e3 * 12_000_f64.powf(self.rng.random())) as u64;
        let sound = matches!(
            self.session.status().map(|status| status.mode),
            Some(ModeName::Coarse | ModeName::Fine | ModeName::Aligned | ModeName::Navigating)
        );
        let within_us = found_as(kind).map(|(_, within_ms)| u64::from(within_ms) * 1000);
        let due = sound
            && self.broken.is_empty()
            && now_us > self.disturbed_us + 1_000_000
            && within_us.is_some_and(|within_us| length_us > within_us + 10_000);
        self.disturbed();
        self.overtake();
        let report = self.kind(kind);
        report.injected += 1;
        report.due += u32::from(due);
        self.session.set_fault(kind, true);
        self.broken.push(Broken {
            kind,
            at_us: now_us,
            until_us: now_us + length_us,
            due,
            found: false,
        });
        if self.chance(0.15) {
            self.next_fault_us = Some(now_us + self.micros(0.0, 20.0));
        }
        Ok(())
    }

    fn make_noise(&mut self, now_us: u64) {
        match self.noisy_until_us {
            Some(until_us) if now_us >= until_us => {
                self.noisy_until_us = None;
                // What was on the line then has come by now.
                self.quiet_us = now_us + 500_000;
                self.next_line_us = self.next_line_us.max(now_us + 500_000);
                self.session.set_line_faults(UartFaults::default());
                // Ends whatever line has begun.
                self.send(b"\r\n");
                self.next_noise_us = now_us + self.micros(30.0, 600.0);
            }
            Some(_) => self.send_garbage(),
            None if now_us >= self.next_noise_us && self.asked.is_none() => {
                self.report.serial.noises += 1;
                self.noisy_until_us = Some(now_us + self.micros(0.1, 20.0));
                let faults = UartFaults {
                    flip_to_unit: 10_f64.powf(self.rng.random_range(-4.0..-1.0)),
                    flip_to_host: 10_f64.powf(self.rng.random_range(-4.0..-1.0)),
                    cut: self.chance(0.2),
                    ..UartFaults::default()
                };
                self.session.set_line_faults(faults);
            }
            _ => {}
        }
    }

    /// One step of ten.
    fn send_garbage(&mut self) {
        if self.chance(0.1) {
            let length = self.rng.random_range(1..200);
            let garbage: Vec<u8> = (0..length).map(|_| self.rng.random()).collect();
            self.send(&garbage);
        }
    }

    fn send(&mut self, bytes: &[u8]) {
        self.report.serial.bytes_in += bytes.len() as u64;
        self.session.send(bytes);
    }

    fn type_line(&mut self, text: &str, expected: Answer) {
        self.report.serial.lines += 1;
        self.heard.answers.clear();
        if ["align", "calibrate", "reset", "restart"].contains(&text) {
            self.told_us = self.session.now_us();
        }
        self.send(text.as_bytes());
        self.send(b"\r\n");
        if self.noisy_until_us.is_none() {
            self.asked = Some(Asked {
                text: text.to_owned(),
                at_us: self.session.now_us(),
                expected,
                status: self.heard.status,
            });
        }
    }

    fn type_something(&mut self) {
        const HARMLESS: [(&str, Answer); 20] = [
            ("status", Answer::Status),
            ("version", Answer::Any),
            ("help", Answer::Any),
            ("show", Answer::Any),
            ("faults", Answer::Any),
            ("faults clear", Answer::Any),
            ("log info", Answer::Any),
            ("log debug", Answer::Any),
            ("record on", Answer::Any),
            ("record off", Answer::Any),
            ("set height 12.5", Answer::Any),
            ("set longitude 116.3", Answer::Any),
            ("set serial 77", Answer::Any),
            ("save", Answer::Any),
            ("set latitude 95", Answer::Error),
            ("set latitude north", Answer::Error),
            ("set rotor-rate 1000", Answer::Error),
            ("log everything", Answer::Error),
            ("format c:", Answer::Error),
            ("reset reset", Answer::Error),
        ];
        const DISTURBING: [&str; 7] = ["align", "calibrate", "navigate", "stop", "selftest", "reset", "restart"];
        if self.noisy_until_us.is_none() && self.looping.is_none() && self.chance(0.15) {
            let line = DISTURBING[self.rng.random_range(0..DISTURBING.len())];
            self.disturbed();
            self.type_line(line, Answer::Any);
        } else if self.chance(0.1) {
            // A receiver's, which is not answered: the base stands.
            self.send(b"$GPRMC,120000,A,4000.0,N,11618.0,E,0.0,,231126,,,A*53\r\n");
        } else if self.chance(0.2) {
            let length = self.rng.random_range(1..100);
            // Neither the end of a line, nor what begins another, nor what makes it a remark, nor a word that there is.
            let mut text: String = (0..length)
                .map(|_| char::from(self.rng.random_range(b' '..=b'~')))
                .filter(|c| !"$!".contains(*c))
                .collect();
            text.insert_str(0, "zz");
            self.type_line(&text, Answer::Error);
        } else {
            let (line, expected) = HARMLESS[self.rng.random_range(0..HARMLESS.len())];
            self.type_line(line, expected);
        }
    }

    /// Once a second: the heading, the samples; and the memory, once things have settled.
    fn look(&mut self) {
        let now_us = self.session.now_us();
        if now_us < self.next_look_us {
            return;
        }
        self.next_look_us = now_us + 1_000_000;
        if self.session.wound_past() && !self.wound {
            self.wound = true;
            self.fail("the cable was wound past what it bears".to_owned());
        }
        let counts = self.session.samples();
        self.report.samples.received += u64::from(counts.tally.received.saturating_sub(self.received));
        self.received = counts.tally.received;
        self.report.samples.dropped = self.report.samples.dropped.max(u64::from(counts.overruns));
        if self.report.memory_kb.warm == 0 && now_us > 900_000_000 {
            self.report.memory_kb.warm = memory_kb();
        }
        if matches!(self.was, Some((ModeName::Aligned, _)))
            && let Some(moment) = self.session.moment()
            && moment.t_s * 1e6 > now_us as f64 - 1e6
        {
            let heading = &mut self.report.heading;
            let normalised = moment.error.heading_deg / moment.reading.sd.heading_deg;
            heading.looks += 1;
            let mean_square = heading.normalised_rms.powi(2);
            heading.normalised_rms = (mean_square + (normalised * normalised - mean_square) / f64::from(heading.looks))
                .max(0.0)
                .sqrt();
            heading.largest_deg = heading.largest_deg.max(moment.error.heading_deg.abs());
            let wrong = normalised.abs() > 5.0;
            heading.beyond_5_sd += u32::from(wrong);
            if wrong && !core::mem::replace(&mut self.wrong, wrong) {
                let (error, sd) = (moment.error.heading_deg, moment.reading.sd.heading_deg);
                self.fail(format!(
                    "heading is said to be valid, with an error of {error:.2} deg and sd {sd:.2}"
                ));
            } else {
                self.wrong = wrong;
            }
        }
    }

    fn finish(mut self) -> SoakReport {
        let Watched {
            driven,
            driven_at_s,
            silent_ms,
            waiting,
            ..
        } = self.session.watched();
        if driven > 0 {
            self.fail(format!(
                "the motor was driven while inhibited, {driven} times, first at {} s",
                driven_at_s.unwrap_or_default()
            ));
        }
        let (warm, end) = (self.report.memory_kb.warm, memory_kb());
        self.report.memory_kb = Memory {
            warm: if warm == 0 { end } else { warm },
            end,
        };
        if warm > 0 && end > warm + GROWTH_KB {
            self.fail(format!("memory grew from {warm} to {end} kB"));
        }
        let report = &mut self.report;
        let [sampling, motor, alignment] = silent_ms;
        report.silent_ms = Silent {
            sampling,
            motor,
            alignment,
        };
        let [samples, inputs, commands] = waiting;
        report.waiting = Waiting {
            samples,
            inputs,
            commands,
        };
        report.serial.bytes_out = self.heard.bytes;
        report.serial.sentences = self.heard.sentences;
        self.report
    }
}

const fn hang(task: Task) -> FaultKind {
    match task {
        Task::Sampling => FaultKind::HangSampling,
        Task::Motor => FaultKind::HangMotor,
        Task::Alignment => FaultKind::HangAlignment,
    }
}

/// As a scenario has it.
fn name(kind: FaultKind) -> String {
    serde_json::to_value(kind).map_or_else(
        |_| format!("{kind:?}"),
        |name| name.as_str().unwrap_or_default().to_owned(),
    )
}

/// Resident memory of this process, kB; zero where the system does not tell.
fn memory_kb() -> u64 {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let line = status.lines().find_map(|line| line.strip_prefix("VmRSS:"));
    line.and_then(|line| line.split_whitespace().next()?.parse().ok())
        .unwrap_or(0)
}
