//! A unit that runs as long as somebody wants it to, and what can be done to it meanwhile.

use core::cell::{Cell, RefCell};
use std::collections::VecDeque;
use std::rc::Rc;

use app::blackbox::{self, Entry, Memory, SLOTS, Slot};
use app::fault::Task;
use app::hal::{ClockSource, Cutoff as _, ResetCause};
use app::mode::Status;
use app::settings::Position;
use app::shared::SampleCounts;
use embassy_sync::signal::Signal;
use embassy_time::Instant;
use nav::model::ROBUST;
use rand::RngExt;
use vtime::{Executor, Level, LocalRawMutex, now_ns, sleep_until_ns};

use super::record::Recording;
use super::{
    Bench, Core, Line, Observer, Samples, Supplied, Typed, UnitError, UnitMoment, UnitResult, bench, boot, fault,
    moment, spawn_world,
};
use crate::align::Method;
use crate::bus::{SpiFaults, UartFaults};
use crate::scenario::{FaultKind, Scenario};
use crate::sensors::{Stream, stream};
use crate::truth::Truth;

/// From one look of [`Session::watch`] to the next, ns: no multiple of the IMU's or the supervisor's period.
const LOOK_NS: u64 = 4_700_000;
/// A task that is silent for longer hangs, ms.
const HANGS_MS: u32 = 50;
/// Longest time from the inhibition to the motor off, ns: the motor's loop runs at 1 kHz, the supervisor at once.
const OBEY_NS: u64 = 2_000_000;

/// RAM that no start initialises. After power-on it is anybody's guess.
#[derive(Clone)]
pub(super) struct Ram(Rc<RefCell<[Slot; SLOTS]>>);

impl Ram {
    pub(super) fn garbage(seed: u64) -> Self {
        let mut rng = stream(seed, Stream::Serial);
        let slots = core::array::from_fn(|_| core::array::from_fn(|_| rng.random()));
        Self(Rc::new(RefCell::new(slots)))
    }
}

impl Memory for Ram {
    fn read(&self, slot: usize) -> Slot {
        self.0.borrow()[slot]
    }

    fn write(&mut self, slot: usize, words: &Slot) {
        self.0.borrow_mut()[slot] = *words;
    }
}

/// What goes to the unit's serial port beside what is typed at set times.
#[derive(Default)]
pub(super) struct Outbox {
    pub(super) bytes: RefCell<VecDeque<Vec<u8>>>,
    pub(super) faults: Cell<UartFaults>,
    /// There is something new.
    pub(super) changed: Signal<LocalRawMutex, ()>,
    /// Bytes the unit lost because it did not read in time, since its last start.
    pub(super) overruns: Cell<u64>,
}

/// What [`Session::watch`] has seen.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Watched {
    /// Looks so far.
    pub looks: u64,
    /// Looks that found the motor driven though it had been inhibited for longer than 2 ms.
    pub driven: u64,
    /// The first of them, s since power-up.
    pub driven_at_s: Option<f64>,
    /// Longest silence of each task that the unit has not reset itself for, ms.
    pub silent_ms: [u32; Task::ALL.len()],
    /// Most samples, inputs and commands that waited while no task hung.
    pub waiting: [usize; 3],
}

/// A [`Session`] with the unit's own filter.
pub type RobustSession = Session<ROBUST>;

/// A unit that runs. [`super::run`] is one that nobody disturbs.
pub struct Session<const B: usize> {
    executor: Executor<'static>,
    bench: Rc<Bench<B>>,
    truth: Rc<Truth>,
    core: Rc<RefCell<Core<B>>>,
    scenario: String,
    seed: u64,
    method: Method,
    resets: u32,
    asked: bool,
    watched: Rc<Cell<Watched>>,
    _recording: Recording,
}

impl<const B: usize> Session<B> {
    /// Power-up. `scenario.fault` and `typed` come as told there.
    ///
    /// # Errors
    /// [`UnitError`] where the scenario is no unit's.
    ///
    /// # Panics
    /// If the thread runs another one.
    pub fn new(scenario: &Scenario, seed: u64, method: Method, typed: &[Typed]) -> Result<Self, UnitError> {
        let truth = Rc::new(Truth::new(scenario, seed)?);
        let bench = Rc::new(bench::<B>(scenario, seed, method, typed)?);
        let lines = Rc::clone(&bench.record);
        let recording = Recording::to(Box::new(move |line| lines.borrow_mut().lines.push(line)));
        let core = Rc::new(RefCell::new(Core::new(bench.factory.get().aligner(bench.filter))?));
        let mut executor = Executor::new();
        spawn_world(&mut executor, &bench, &truth, &core, scenario, seed);
        boot(&mut executor, &bench, ResetCause::PowerOn)?;
        Ok(Self {
            executor,
            bench,
            truth,
            core,
            scenario: scenario.name.clone(),
            seed,
            method,
            resets: 0,
            asked: false,
            watched: Rc::default(),
            _recording: recording,
        })
    }

    /// Time since power-up, µs.
    pub fn now_us(&self) -> u64 {
        self.executor.now().as_micros()
    }

    /// When the alignment first began, µs.
    pub(super) fn aligning_at_us(&self) -> Option<u64> {
        self.bench.record.borrow().aligning_at_us
    }

    /// Runs until then, or until the unit has been reset and is up again: then says why.
    ///
    /// # Errors
    /// [`UnitError`] where the program hangs or panics.
    pub fn run_until_us(
        &mut self,
        until_us: u64,
        observer: &mut dyn Observer,
    ) -> Result<Option<ResetCause>, UnitError> {
        let stop = self
            .executor
            .run_until(Instant::from_micros(until_us))
            .map_err(UnitError::Program)?;
        self.tell(observer);
        let cause = if stop == vtime::Stop::Requested {
            self.bench.reset.take()
        } else {
            None
        };
        if let Some(cause) = cause {
            self.restart(cause, observer)?;
        }
        Ok(cause)
    }

    fn tell(&self, observer: &mut dyn Observer) {
        let mut record = self.bench.record.borrow_mut();
        let (lines, sentences) = (record.lines.split_off(0), record.sentences.split_off(0));
        let estimates = record.estimates.split_off(0);
        drop(record);
        // In the order of time: a log whose clock goes back is that of a unit that was reset.
        let mut sentences = sentences.into_iter().peekable();
        for line in lines {
            while let Some(sentence) = sentences.next_if(|sentence| sentence.ended_ns < line.t_us * 1000) {
                observer.sentence(&sentence);
            }
            observer.line(&line);
        }
        for sentence in sentences {
            observer.sentence(&sentence);
        }
        for navigation in estimates {
            observer.estimate(&navigation);
        }
        observer.time(self.now_us() as f64 * 1e-6);
    }

    fn restart(&mut self, cause: ResetCause, observer: &mut dyn Observer) -> Result<(), UnitError> {
        self.resets += 1;
        observer.line(&Line {
            t_us: self.now_us(),
            level: log::Level::Warn,
            text: format!("-- reset: {cause} --"),
        });
        for task in self.bench.tasks.borrow_mut().drain(..) {
            self.executor.cancel(task);
        }
        self.bench.world.clone().cut();
        self.asked = cause == ResetCause::Watchdog && blackbox::is_asked(&self.bench.ram);
        boot(&mut self.executor, &self.bench, cause)
    }

    /// Resets the unit: by its supply, what RAM held is lost.
    ///
    /// # Errors
    /// [`UnitError`] where the settings in flash make no unit.
    pub fn reset(&mut self, cause: ResetCause, observer: &mut dyn Observer) -> Result<(), UnitError> {
        if cause == ResetCause::PowerOn {
            let mut ram = self.bench.ram.clone();
            let garbage = Ram::garbage(self.seed ^ self.now_us());
            for slot in 0..SLOTS {
                ram.write(slot, &garbage.read(slot));
            }
        }
        self.restart(cause, observer)
    }

    /// Breaks something, or mends it. Not [`FaultKind::Reset`]: that is [`Session::reset`].
    pub fn set_fault(&mut self, kind: FaultKind, on: bool) {
        if kind != FaultKind::Reset {
            fault::inject(&mut self.bench, kind, on);
        }
    }

    /// Lets a task hang from every start on, or none.
    pub fn hang_at_start(&mut self, task: Option<Task>) {
        self.bench.hangs_at_start.set(task);
    }

    /// What the unit is told that its clock goes by, from the next start on. The clock itself stays as it is.
    pub fn set_clock(&mut self, clock: ClockSource) {
        self.bench.clock.set(clock);
    }

    /// From the next start on the unit is one that nobody has told its place.
    pub fn forget_place(&self) {
        let mut factory = self.bench.factory.get();
        factory.installation.position = Position::default();
        self.bench.factory.set(factory);
    }

    /// Changes the supply of the unit's part. The log tells of a level that guards nothing at the next start.
    pub fn set_supply(&mut self, supply: Supplied) {
        self.bench.supply.set(supply);
    }

    /// Lets the IMU's counter count its base samples from now on, see
    /// [`counts_base_samples`](crate::device::Adis16495::counts_base_samples).
    pub fn count_base_samples(&mut self) {
        self.bench.imu.with(|model| model.counts_base_samples = true);
    }

    /// So many transfers with the IMU and the encoder end in a bus error.
    pub fn fail_transfers(&mut self, imu: u32, encoder: u32) {
        let errors = |errors| SpiFaults {
            errors,
            ..SpiFaults::default()
        };
        self.bench.imu.set_faults(errors(imu));
        self.bench.encoder.set_faults(errors(encoder));
    }

    /// Sends bytes to the serial port.
    pub fn send(&self, bytes: &[u8]) {
        let outbox = &self.bench.outbox;
        outbox.bytes.borrow_mut().push_back(bytes.to_vec());
        outbox.changed.signal(());
    }

    /// Faults of the serial line, also after a reset; those that are counted begin anew with every call of
    /// [`Session::send`].
    pub fn set_line_faults(&self, faults: UartFaults) {
        let outbox = &self.bench.outbox;
        outbox.faults.set(faults);
        outbox.changed.signal(());
    }

    /// The unit's mode; `None` before it has told any.
    pub fn status(&self) -> Option<Status> {
        self.bench.shared.borrow().status.try_get()
    }

    /// What its black box holds, the oldest first.
    pub fn records(&self) -> Vec<Entry> {
        blackbox::entries(&self.bench.ram).collect()
    }

    /// Whether the last reset was one by the unit's own command.
    pub fn asked(&self) -> bool {
        self.asked
    }

    /// Whether the bridge drives the motor.
    pub fn driven(&self) -> bool {
        self.bench.world.at(self.now_us() * 1000, |physics| physics.driven())
    }

    /// The last estimate beside the truth.
    pub fn moment(&self) -> Option<UnitMoment> {
        let start = self.bench.shared.borrow().settings().position();
        let last = self.bench.record.borrow().last?;
        moment(&last, &self.truth, &start)
    }

    /// Takes what was recorded of modes and faults: they are not in the result then.
    pub fn take_faults(&mut self) -> Vec<super::FaultFound> {
        let mut record = self.bench.record.borrow_mut();
        record.modes.clear();
        core::mem::take(&mut record.faults)
    }

    /// What became of the samples since the last start.
    pub fn samples(&self) -> SampleCounts {
        self.bench.shared.borrow().sample_counts()
    }

    /// Whether the cable was wound past what it bears.
    pub fn wound_past(&self) -> bool {
        self.bench
            .world
            .at(self.now_us() * 1000, |physics| physics.plant.wound_past())
    }

    /// Bytes to the unit that found its buffer full, since its last start.
    pub fn serial_overruns(&self) -> u64 {
        self.bench.outbox.overruns.get()
    }

    /// Looks at motor, tasks and queues every 4.7 ms from now on.
    pub fn watch(&mut self) {
        let (bench, watched) = (Rc::clone(&self.bench), Rc::clone(&self.watched));
        self.executor.spawn("watch", Level::World, async move {
            loop {
                sleep_until_ns(now_ns() + LOOK_NS).await;
                let mut seen = watched.get();
                look(&bench, &mut seen);
                watched.set(seen);
            }
        });
    }

    /// What [`Session::watch`] has seen so far.
    pub fn watched(&self) -> Watched {
        self.watched.get()
    }

    /// How it ended.
    pub fn result(&self) -> UnitResult {
        let counts = self.samples();
        let edges = self.bench.lost.get();
        let record = self.bench.record.borrow();
        let start = self.bench.shared.borrow().settings().position();
        let beside = |navigation| moment(navigation, &self.truth, &start);
        UnitResult {
            scenario: self.scenario.clone(),
            seed: self.seed,
            method: self.method,
            state: record.modes.last().map_or("idle", |at| at.mode),
            not_ready: record.last.as_ref().and_then(|last| last.not_ready),
            t_s: self.now_us() as f64 * 1e-6,
            aligning_at_s: record.aligning_at_us.map(|us| us as f64 * 1e-6),
            aligned_at_s: record.aligned_at_s,
            modes: record.modes.clone(),
            faults: record.faults.clone(),
            resets: self.resets,
            samples: Samples {
                received: counts.tally.received,
                lost: counts.tally.lost,
                repeated: counts.tally.repeated,
                transfers: counts.transfers,
                overruns: counts.overruns,
                saturated: counts.saturated,
                edges_lost: edges.last - edges.first.unwrap_or(edges.last),
            },
            wound_past: self.wound_past(),
            last: record.last.as_ref().and_then(beside),
            core: self.core.borrow().last.as_ref().and_then(beside),
            settings: self.bench.shared.borrow().settings(),
            trace: self.executor.trace(),
        }
    }
}

fn look<const B: usize>(bench: &Bench<B>, seen: &mut Watched) {
    let shared = Rc::clone(&bench.shared.borrow());
    seen.looks += 1;
    let since_ns = now_ns().saturating_sub(1000 * shared.inhibited_since_us());
    // Before the first fault of a run there is no instant, and the motor was cut with the reset.
    if shared.inhibited() && since_ns > OBEY_NS && bench.world.now(|physics| physics.driven()) {
        seen.driven += 1;
        seen.driven_at_s.get_or_insert(now_ns() as f64 * 1e-9);
    }
    // Before the supervisor's first word nobody has checked in.
    if shared.status.try_get().is_none() {
        return;
    }
    let silent_ms = Task::ALL.map(|task| shared.silent_ms(task));
    for (longest, silent_ms) in seen.silent_ms.iter_mut().zip(silent_ms) {
        *longest = (*longest).max(silent_ms);
    }
    if silent_ms.iter().any(|ms| *ms > HANGS_MS) {
        return;
    }
    for (most, waits) in seen.waiting.iter_mut().zip(shared.waiting()) {
        *most = (*most).max(waits);
    }
}
