//! What the tasks share: channels, watches and a few cells, in one value.
//!
//! ```text
//!                 ┌──────────── imu_start, encoder_start, rotor, job, inhibit ───────────┐
//!                 ▼                                                                      │
//!  edge ─► sampling ──samples──► alignment ─navigation,frames► output              supervisor ─► watchdog
//!             ▲                      │                       ▲                        ▲  ▲
//!             │ angle at the edge    │                       └── status, calibration ─┘  │
//!           motor ───────────────────┴──────────────── inputs (and check-ins) ───────────┘
//! ```
//!
//! On the target one `static`; in the simulator a value of the run. Everything is bounded; what does not
//! fit is counted.

use core::cell::{Cell, RefCell};
use core::future::Future;
use core::sync::atomic::{AtomicBool, AtomicU8, AtomicU32, Ordering};

use drivers::sequence::Tally;
use embassy_futures::select::{Either, select};
use embassy_sync::blocking_mutex::Mutex;
use embassy_sync::blocking_mutex::raw::RawMutex;
use embassy_sync::channel::Channel;
use embassy_sync::signal::Signal;
use embassy_sync::watch::Watch;
use embassy_time::{Duration, Instant, Timer};
use nav::aligner;
use nav::delay::Delay;
use nav::deviation::Deviation;
use nav::navigator::Track;

use crate::command::Command;
use crate::fault::{Fault, Task};
use crate::hal::ClockSource;
use crate::log::{CalibrationEnd, Event, Level};
use crate::mode::{Input, Job, Status};
use crate::nmea_in::Fix;
use crate::record::Frame;
use crate::rotor::{self, Side};
use crate::sample::{ImuFacts, TimedSample};
use crate::selftest::Found;
use crate::settings::Settings;
use crate::utc::Utc;

/// Samples that wait for the alignment: 158 ms at 202.4 a second, three times what it may be silent.
pub const SAMPLES: usize = 32;
/// Frames of the record that wait for the line: as long.
pub const FRAMES: usize = 32;
/// Things told to the supervisor that wait for it.
pub const INPUTS: usize = 16;
/// Commands that wait.
pub const COMMANDS: usize = 4;
/// Sentences of a receiver that wait.
const FIXES: usize = 4;
/// Readers of a watch: output, display, log, one spare.
pub const READERS: usize = 4;
/// Readings of the rotor's angle kept: 8 ms at 1 kHz, longer than a transfer from the IMU takes.
const ANGLES: usize = 8;
/// How often a task that waits for something long checks in.
const ATTEND: Duration = Duration::from_millis(10);
/// A reading further from the instant asked for than this tells nothing about it, µs.
const ANGLE_REACH_US: u64 = 5_000;

/// What became of the samples since the start.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct SampleCounts {
    /// By the IMU's own count.
    pub tally: Tally,
    /// Transfers that failed; their samples are among those lost.
    pub transfers: u32,
    /// Edges that came before the one before them was served.
    pub edges: u32,
    /// Samples dropped because the alignment had not taken the ones before.
    pub overruns: u32,
    /// Samples with a sensor at the end of its range.
    pub saturated: u32,
}

/// The estimate as the unit puts it out.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Navigation {
    /// When it holds, µs of the unit's clock.
    pub t_us: u64,
    /// Where the aligner stands.
    pub mode: aligner::Mode,
    /// Attitude of the housing, biases and their 1σ, once there are any; its angles are those of the vehicle, by the
    /// mounting.
    pub estimate: Option<aligner::Estimate>,
    /// The gyro error that is constant in the housing, as far as the alignment has found it.
    pub deviation: Option<Deviation>,
    /// Why it is not to be relied on, if it is not.
    pub not_ready: Option<aligner::NotReady>,
    /// Velocity and place, while the unit navigates.
    pub track: Option<Track>,
}

/// What was measured of the hardware: of each the last since the start, `None` where nothing was.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Measured {
    /// Time from one sample of the IMU to the next by the unit's clock, s.
    pub period: Option<f32>,
    /// Gravity, rate and noise in the self-test.
    pub found: Option<Found>,
    /// How late the IMU is against the encoder, beyond what its driver says.
    pub delay: Option<Delay>,
    /// Whether the encoder took its settings.
    pub encoder: Option<bool>,
    /// The side that the home switch tells; in it `None` where its contacts contradict each other, or there is none.
    pub home: Option<Option<Side>>,
    /// The rotor's angle at which the search for the switch ended, rad.
    pub homed: Option<f32>,
}

/// The rotor's angle at one instant.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct AngleAt {
    /// When the encoder was read, µs.
    pub t_us: u64,
    /// α, rad.
    pub angle: f32,
    /// Its rate, rad/s.
    pub rate: f32,
}

/// The latest readings of the rotor's angle.
#[derive(Debug, Clone, Copy, Default)]
struct Angles {
    ring: [AngleAt; ANGLES],
    /// Where the next one goes.
    next: usize,
    count: usize,
}

impl Angles {
    fn push(&mut self, at: AngleAt) {
        if let Some(place) = self.ring.get_mut(self.next) {
            *place = at;
        }
        self.next = (self.next + 1) % ANGLES;
        self.count = (self.count + 1).min(ANGLES);
    }

    /// The angle at `t_us`: linear between the readings around it (off by a·dt²/8, 2.5e-5° at 200 °/s² and
    /// 1 ms), by the rate beyond the last one (a·dt²/2, 1e-4°).
    fn at(&self, t_us: u64) -> Option<f32> {
        let mut after: Option<AngleAt> = None;
        for back in 1..=self.count {
            let here = self.ring[(self.next + ANGLES - back) % ANGLES];
            if here.t_us > t_us {
                after = Some(here);
                continue;
            }
            if t_us - here.t_us > ANGLE_REACH_US {
                return None;
            }
            let since = (t_us - here.t_us) as f32;
            return Some(match after {
                Some(after) => here.angle + (after.angle - here.angle) * since / (after.t_us - here.t_us) as f32,
                None => here.angle + here.rate * since * 1e-6,
            });
        }
        // Before the first reading there is.
        let first = after.filter(|first| first.t_us - t_us <= ANGLE_REACH_US)?;
        Some(first.angle - first.rate * (first.t_us - t_us) as f32 * 1e-6)
    }
}

/// What the tasks share. See the [module](self).
pub struct Shared<M: RawMutex> {
    version: &'static str,
    samples: Channel<M, TimedSample, SAMPLES>,
    frames: Channel<M, Frame, FRAMES>,
    recording: AtomicBool,
    imu: Mutex<M, Cell<Option<ImuFacts>>>,
    /// Of a receiver, for the alignment.
    pub(crate) fixes: Channel<M, Fix, FIXES>,
    /// Time of day by a receiver.
    utc: Mutex<M, Cell<Option<Utc>>>,
    counts: Mutex<M, Cell<SampleCounts>>,
    measured: Mutex<M, Cell<Measured>>,
    settings: Mutex<M, Cell<Settings>>,
    angles: Mutex<M, RefCell<Angles>>,
    pub(crate) inputs: Channel<M, Input, INPUTS>,
    /// Commands to the unit, from the serial line or a button.
    pub commands: Channel<M, Command, COMMANDS>,
    pub(crate) rotor: Channel<M, rotor::Command, COMMANDS>,
    pub(crate) imu_start: Signal<M, ()>,
    pub(crate) encoder_start: Signal<M, ()>,
    pub(crate) job: Signal<M, Job>,
    /// How the last calibration of the gyros ended, for who has not been told of it yet: the serial line.
    pub(crate) calibration: Signal<M, CalibrationEnd>,
    /// Estimates.
    pub navigation: Watch<M, Navigation, READERS>,
    /// Mode and faults.
    pub status: Watch<M, Status, READERS>,
    /// Levels of the log that are told, see [`Level::ALL`].
    log_level: AtomicU8,
    inhibited: AtomicBool,
    /// Since when, µs.
    inhibited_us: Mutex<M, Cell<u64>>,
    /// The clock is the chip's own.
    internal_clock: AtomicBool,
    /// A fault did not fit into `inputs`.
    missed: Mutex<M, Cell<Option<Fault>>>,
    /// When each task last checked in, ms of the unit's clock, modulo 2³².
    check_ins: [AtomicU32; Task::ALL.len()],
}

impl<M: RawMutex> Shared<M> {
    /// Nothing told yet; the motor inhibited. `version` is the program's.
    pub const fn new(version: &'static str, settings: Settings) -> Self {
        Self {
            version,
            samples: Channel::new(),
            frames: Channel::new(),
            recording: AtomicBool::new(false),
            imu: Mutex::new(Cell::new(None)),
            fixes: Channel::new(),
            utc: Mutex::new(Cell::new(None)),
            counts: Mutex::new(Cell::new(SampleCounts {
                tally: Tally {
                    received: 0,
                    lost: 0,
                    repeated: 0,
                    restarts: 0,
                },
                transfers: 0,
                edges: 0,
                overruns: 0,
                saturated: 0,
            })),
            measured: Mutex::new(Cell::new(Measured {
                period: None,
                found: None,
                delay: None,
                encoder: None,
                home: None,
                homed: None,
            })),
            settings: Mutex::new(Cell::new(settings)),
            angles: Mutex::new(RefCell::new(Angles {
                ring: [AngleAt {
                    t_us: 0,
                    angle: 0.0,
                    rate: 0.0,
                }; ANGLES],
                next: 0,
                count: 0,
            })),
            inputs: Channel::new(),
            commands: Channel::new(),
            rotor: Channel::new(),
            imu_start: Signal::new(),
            encoder_start: Signal::new(),
            job: Signal::new(),
            calibration: Signal::new(),
            navigation: Watch::new(),
            status: Watch::new(),
            log_level: AtomicU8::new(Level::Debug as u8),
            inhibited: AtomicBool::new(true),
            inhibited_us: Mutex::new(Cell::new(0)),
            internal_clock: AtomicBool::new(false),
            missed: Mutex::new(Cell::new(None)),
            check_ins: [const { AtomicU32::new(0) }; Task::ALL.len()],
        }
    }

    /// Of the program, ASCII.
    pub fn version(&self) -> &'static str {
        self.version
    }

    /// The IMU, once it has been configured.
    pub fn imu(&self) -> Option<ImuFacts> {
        self.imu.lock(Cell::get)
    }

    pub(crate) fn imu_is(&self, facts: ImuFacts) {
        self.imu.lock(|cell| cell.set(Some(facts)));
    }

    /// What the unit's clock goes by: a crystal, unless the board has said otherwise.
    pub fn clock(&self) -> ClockSource {
        if self.internal_clock.load(Ordering::Relaxed) {
            ClockSource::Internal
        } else {
            ClockSource::Crystal
        }
    }

    /// Says so, before the tasks start.
    pub fn set_clock(&self, clock: ClockSource) {
        self.internal_clock.store(!clock.is_exact(), Ordering::Relaxed);
    }

    /// Time of day by a receiver, once it has said one; none by the chip's own clock, which cannot carry it on.
    pub fn utc(&self) -> Option<Utc> {
        self.utc.lock(Cell::get).filter(|_| self.clock().is_exact())
    }

    pub(crate) fn utc_is(&self, utc: Utc) {
        self.utc.lock(|cell| cell.set(Some(utc)));
    }

    /// Whether every sample is to go out on the serial line, see [`crate::record`].
    pub fn set_recording(&self, on: bool) {
        self.recording.store(on, Ordering::Relaxed);
    }

    /// See [`Shared::set_recording`].
    pub fn is_recording(&self) -> bool {
        self.recording.load(Ordering::Relaxed)
    }

    pub(crate) fn room_for_frames(&self) -> usize {
        self.frames.free_capacity()
    }

    pub(crate) fn send_frame(&self, frame: Frame) {
        // Who sends has looked for room.
        let _ = self.frames.try_send(frame);
    }

    /// Cancellation: safe.
    pub(crate) async fn next_frame(&self) -> Frame {
        self.frames.receive().await
    }

    /// The settings as they are now; what is kept over a reset may be older.
    pub fn settings(&self) -> Settings {
        self.settings.lock(Cell::get)
    }

    /// Changes them. The alignment takes up place and calibration with its next job, the rest is taken up at the start.
    pub fn change(&self, change: impl FnOnce(&mut Settings)) {
        self.settings.lock(|cell| {
            let mut settings = cell.get();
            change(&mut settings);
            cell.set(settings);
        });
    }

    /// What became of the samples so far.
    pub fn sample_counts(&self) -> SampleCounts {
        self.counts.lock(Cell::get)
    }

    pub(crate) fn count(&self, change: impl FnOnce(&mut SampleCounts)) {
        self.counts.lock(|cell| {
            let mut counts = cell.get();
            change(&mut counts);
            cell.set(counts);
        });
    }

    /// What was measured of the hardware so far.
    pub fn measured(&self) -> Measured {
        self.measured.lock(Cell::get)
    }

    pub(crate) fn measure(&self, change: impl FnOnce(&mut Measured)) {
        self.measured.lock(|cell| {
            let mut measured = cell.get();
            change(&mut measured);
            cell.set(measured);
        });
    }

    /// Gives a sample to the alignment, or counts it as dropped. Whether it went.
    pub(crate) fn forward(&self, sample: TimedSample) -> bool {
        let went = self.samples.try_send(sample).is_ok();
        if !went {
            self.count(|counts| counts.overruns += 1);
        }
        went
    }

    /// Cancellation: safe.
    pub(crate) async fn next_sample(&self) -> TimedSample {
        self.samples.receive().await
    }

    pub(crate) fn forget_samples(&self) {
        self.samples.clear();
    }

    /// The rotor's angle at an instant of the last milliseconds, rad; `None` while the turn is unknown.
    pub fn angle_at(&self, t_us: u64) -> Option<f32> {
        self.angles.lock(|angles| angles.try_borrow().ok()?.at(t_us))
    }

    pub(crate) fn publish_angle(&self, at: Option<AngleAt>) {
        self.angles.lock(|angles| {
            // Nobody holds it: every borrow ends within its lock.
            let Ok(mut angles) = angles.try_borrow_mut() else {
                return;
            };
            match at {
                Some(at) => angles.push(at),
                None => *angles = Angles::default(),
            }
        });
    }

    /// Samples, inputs of the supervisor and commands that wait.
    pub fn waiting(&self) -> [usize; 3] {
        [self.samples.len(), self.inputs.len(), self.commands.len()]
    }

    /// Tells the supervisor something.
    pub(crate) fn tell(&self, input: Input) {
        if let Err(embassy_sync::channel::TrySendError::Full(Input::Fault(fault))) = self.inputs.try_send(input) {
            self.missed.lock(|missed| missed.set(Some(fault)));
        }
    }

    pub(crate) fn take_missed(&self) -> Option<Fault> {
        self.missed.lock(Cell::take)
    }

    /// Tells the log, where the event is grave enough for it.
    pub(crate) fn log(&self, event: &Event) {
        if event.level() as u8 <= self.log_level.load(Ordering::Relaxed) {
            event.emit();
        }
    }

    /// What the log tells from here on. On the target `DEFMT_LOG` of the build is a limit to it.
    pub fn set_log_level(&self, level: Level) {
        self.log_level.store(level as u8, Ordering::Relaxed);
    }

    /// Raises a fault from wherever it is found: the motor is inhibited before anything else happens. Also
    /// from an interrupt, where the raw mutex allows it.
    pub fn raise(&self, fault: Fault) {
        self.inhibit();
        self.tell(Input::Fault(fault));
    }

    /// Whether the motor must be off.
    pub fn inhibited(&self) -> bool {
        self.inhibited.load(Ordering::Acquire)
    }

    /// Since when it must be, µs of the unit's clock: when the fault was found.
    pub fn inhibited_since_us(&self) -> u64 {
        self.inhibited_us.lock(Cell::get)
    }

    pub(crate) fn inhibit(&self) {
        if !self.inhibited.swap(true, Ordering::AcqRel) {
            self.inhibited_us.lock(|since| since.set(Instant::now().as_micros()));
        }
    }

    pub(crate) fn release(&self) {
        self.inhibited.store(false, Ordering::Release);
    }

    /// A task is alive.
    pub(crate) fn check_in(&self, task: Task) {
        self.check_ins[task.index()].store(now_ms(), Ordering::Relaxed);
    }

    /// Awaits something that takes long, checking in meanwhile.
    pub(crate) async fn with_check_in<F: Future>(&self, task: Task, work: F) -> F::Output {
        let mut work = core::pin::pin!(work);
        loop {
            self.check_in(task);
            match select(work.as_mut(), Timer::after(ATTEND)).await {
                Either::First(done) => return done,
                Either::Second(()) => {}
            }
        }
    }

    /// For how long a task has not checked in, ms.
    pub fn silent_ms(&self, task: Task) -> u32 {
        now_ms().wrapping_sub(self.check_ins[task.index()].load(Ordering::Relaxed))
    }
}

/// Wraps after 49 days, which differences do not mind.
fn now_ms() -> u32 {
    Instant::now().as_millis() as u32
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn angles_between_before_and_beyond() {
        let mut angles = Angles::default();
        assert_eq!(angles.at(0), None);
        for k in 0..20_u64 {
            angles.push(AngleAt {
                t_us: 1000 * k,
                angle: 0.35e-3 * k as f32,
                rate: 0.35,
            });
        }
        for t_us in [11_800, 12_000, 15_250, 19_000, 19_700, 23_000] {
            let angle = angles.at(t_us).unwrap();
            assert!((angle - 0.35e-6 * t_us as f32).abs() < 1e-8, "{t_us} {angle}");
        }
        assert_eq!((angles.at(24_001), angles.at(6_000)), (None, None));
    }
}
