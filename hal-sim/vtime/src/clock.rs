//! What a thread has one of: the clock, the deadlines, the queues of ready tasks.
//!
//! Time is kept in nanoseconds, so that bits on a bus add up; the driver shows embassy its ticks.

use core::cell::{Cell, RefCell};
use core::future::Future;
use core::pin::Pin;
use core::task::{Context, Poll, RawWaker, RawWakerVTable, Waker};
use std::collections::VecDeque;

use embassy_time::{Duration, TICK_HZ};
use embassy_time_driver::Driver;

use crate::Level;

/// Nanoseconds in a tick of embassy's clock.
pub(crate) const NS_PER_TICK: u64 = 1_000_000_000 / TICK_HZ;
/// Looks in one poll that are taken for an endless loop. A long poll of real work makes some hundreds.
const LOOKS_MAX: u32 = 1_000_000;
/// Outside polls looks are not counted: saturated, the count never arrives at the limit.
const NOT_COUNTED: u32 = u32::MAX;
/// Low bits of a task's number: its slot. The others: the executor it belongs to.
const SLOT_BITS: u32 = 16;

/// What unwinds a poll that looks at the clock for ever.
pub(crate) struct Spun;

thread_local! {
    pub(crate) static CLOCK: Clock = const { Clock::new() };
}

pub(crate) struct Clock {
    now_ns: Cell<u64>,
    /// The executor alive on this thread, 0 for none. No two in the process are ever the same.
    owner: Cell<usize>,
    tasks: RefCell<Tasks>,
    looks: Cell<u32>,
    spent_ns: Cell<u64>,
    stop: Cell<bool>,
    trace: Cell<u64>,
}

/// By slot.
#[derive(Default)]
struct Tasks {
    /// u64::MAX: none.
    deadline_ns: Vec<u64>,
    state: Vec<State>,
    ready: [VecDeque<usize>; Level::COUNT],
}

#[derive(Clone, Copy)]
struct State {
    level: Level,
    /// In its queue, or to be put there when it thaws.
    woken: bool,
    frozen: bool,
    cost_ns: u64,
    /// Which of the tasks that had this slot.
    serial: u32,
}

impl Tasks {
    fn wake(&mut self, slot: usize) {
        if let Some(state) = self.state.get_mut(slot)
            && !state.woken
        {
            state.woken = true;
            if !state.frozen {
                self.ready[state.level.index()].push_back(slot);
            }
        }
    }
}

impl Clock {
    const fn new() -> Self {
        Self {
            now_ns: Cell::new(0),
            owner: Cell::new(0),
            tasks: RefCell::new(Tasks {
                deadline_ns: Vec::new(),
                state: Vec::new(),
                ready: [const { VecDeque::new() }; Level::COUNT],
            }),
            looks: Cell::new(NOT_COUNTED),
            spent_ns: Cell::new(0),
            stop: Cell::new(false),
            trace: Cell::new(0),
        }
    }

    pub(crate) fn now_ns(&self) -> u64 {
        self.now_ns.get()
    }

    pub(crate) fn set_now_ns(&self, now_ns: u64) {
        self.now_ns.set(now_ns);
    }

    pub(crate) fn is_owned(&self) -> bool {
        self.owner.get() != 0
    }

    /// A new time line, or the end of one.
    pub(crate) fn restart(&self, owner: usize) {
        self.owner.set(owner);
        self.now_ns.set(0);
        self.spent_ns.set(0);
        self.stop.set(false);
        self.trace.set(0);
        *self.tasks.borrow_mut() = Tasks::default();
    }

    /// A task in a free slot, or in the next new one; ready.
    pub(crate) fn add(&self, slot: usize, level: Level) -> TaskId {
        let tasks = &mut *self.tasks.borrow_mut();
        let serial = tasks.state.get(slot).map_or(0, |last| last.serial + 1);
        let state = State {
            level,
            woken: false,
            frozen: false,
            cost_ns: 0,
            serial,
        };
        if slot == tasks.state.len() {
            tasks.deadline_ns.push(u64::MAX);
            tasks.state.push(state);
        } else {
            tasks.state[slot] = state;
        }
        tasks.wake(slot);
        TaskId {
            number: (self.owner.get() << SLOT_BITS) | slot,
            serial,
        }
    }

    pub(crate) fn remove(&self, slot: usize) {
        let tasks = &mut *self.tasks.borrow_mut();
        tasks.deadline_ns[slot] = u64::MAX;
        let state = &mut tasks.state[slot];
        // As if already woken: wakers that are still about find nothing to do.
        state.woken = true;
        state.frozen = false;
        tasks.ready[state.level.index()].retain(|other| *other != slot);
    }

    /// Whether a task at this level waits to be polled.
    pub(crate) fn is_ready(&self, level: Level) -> bool {
        !self.tasks.borrow().ready[level.index()].is_empty()
    }

    /// Takes the task to be polled, which `choose(n)` picks out of n.
    pub(crate) fn take(&self, level: Level, choose: impl FnOnce(usize) -> usize) -> Option<usize> {
        let tasks = &mut *self.tasks.borrow_mut();
        let ready = &mut tasks.ready[level.index()];
        let slot = match ready.len() {
            0 => None,
            1 => ready.pop_front(),
            n => ready.remove(choose(n)),
        }?;
        tasks.state[slot].woken = false;
        Some(slot)
    }

    /// The next deadline, u64::MAX for none.
    pub(crate) fn next_deadline_ns(&self) -> u64 {
        self.tasks
            .borrow()
            .deadline_ns
            .iter()
            .fold(u64::MAX, |next, deadline| next.min(*deadline))
    }

    /// Wakes the tasks whose deadline has come, in the order of their slots.
    pub(crate) fn wake_due(&self) {
        let now_ns = self.now_ns.get();
        let tasks = &mut *self.tasks.borrow_mut();
        for slot in 0..tasks.deadline_ns.len() {
            if tasks.deadline_ns[slot] <= now_ns {
                tasks.deadline_ns[slot] = u64::MAX;
                tasks.wake(slot);
            }
        }
    }

    /// As embassy's queue does: an earlier deadline replaces a later one, a later one is ignored. The task
    /// asks again when it is polled.
    fn schedule(&self, at_ns: u64, waker: &Waker) {
        assert!(
            core::ptr::eq(waker.vtable(), &raw const VTABLE),
            "a timer was polled with a waker that is not the executor's own; embassy's timer queue refuses it too"
        );
        let id = waker.data().addr();
        if id >> SLOT_BITS == self.owner.get()
            && let Some(deadline) = self.tasks.borrow_mut().deadline_ns.get_mut(id & SLOT_MASK)
        {
            *deadline = (*deadline).min(at_ns);
        }
    }

    fn look(&self) {
        let looks = self.looks.get().saturating_add(1);
        self.looks.set(looks);
        if looks == LOOKS_MAX && !std::thread::panicking() {
            // Not a panic: the hook would print it, and the executor reports it with the task's name.
            std::panic::resume_unwind(Box::new(Spun));
        }
    }

    /// Around a poll: counts looks, gathers what the poll spent.
    pub(crate) fn begin_poll(&self, slot: usize) {
        self.looks.set(0);
        self.spent_ns.set(0);
        self.mark(self.now_ns.get().wrapping_mul(1 << SLOT_BITS) ^ slot as u64);
    }

    pub(crate) fn end_poll(&self, slot: usize) -> u64 {
        self.looks.set(NOT_COUNTED);
        self.spent_ns.take() + self.tasks.borrow().state[slot].cost_ns
    }

    pub(crate) fn take_stop(&self) -> bool {
        self.stop.take()
    }

    fn mark(&self, value: u64) {
        let mixed = (self.trace.get() ^ value).wrapping_mul(0x9E37_79B9_7F4A_7C15);
        self.trace.set(mixed ^ (mixed >> 29));
    }

    pub(crate) fn trace(&self) -> u64 {
        self.trace.get()
    }
}

const SLOT_MASK: usize = (1 << SLOT_BITS) - 1;

/// The largest number of tasks at a time.
pub(crate) const SLOTS: usize = SLOT_MASK + 1;

/// Executors are told apart by the bits above the slot.
pub(crate) const OWNER_MASK: usize = usize::MAX >> SLOT_BITS;

/// A task of the thread's executor.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct TaskId {
    /// Executor and slot: what a waker carries.
    number: usize,
    serial: u32,
}

impl TaskId {
    /// The slot, if the task has it and its executor is alive on this thread.
    pub(crate) fn slot(self) -> Option<usize> {
        self.with(|_, slot| slot)
    }

    fn with<R>(self, body: impl FnOnce(&mut Tasks, usize) -> R) -> Option<R> {
        CLOCK.with(|clock| {
            let slot = self.number & SLOT_MASK;
            let tasks = &mut *clock.tasks.borrow_mut();
            let ours = self.number >> SLOT_BITS == clock.owner.get()
                && tasks.state.get(slot).is_some_and(|state| state.serial == self.serial);
            ours.then(|| body(tasks, slot))
        })
    }

    /// The processor's time for each poll of the task from now on. Zero at first. Of no effect at
    /// [`Level::World`].
    pub fn set_cost(self, cost: Duration) {
        self.with(|tasks, slot| tasks.state[slot].cost_ns = cost.as_ticks().saturating_mul(NS_PER_TICK));
    }

    /// A task that hangs without hanging the others: it is not polled until it thaws, and then is if
    /// anything woke it.
    pub fn freeze(self, frozen: bool) {
        self.with(|tasks, slot| {
            let state = &mut tasks.state[slot];
            if state.frozen == frozen {
                return;
            }
            state.frozen = frozen;
            let ready = &mut tasks.ready[state.level.index()];
            if frozen {
                ready.retain(|other| *other != slot);
            } else if state.woken {
                ready.push_back(slot);
            }
        });
    }

    #[allow(
        unsafe_code,
        reason = "a waker that is a number needs no allocation and no reference count"
    )]
    pub(crate) fn waker(self) -> Waker {
        // SAFETY: the data is a number and never dereferenced, so that every function of the table is safe
        // for any value, on any thread, at any time.
        unsafe { Waker::new(core::ptr::without_provenance(self.number), &VTABLE) }
    }
}

static VTABLE: RawWakerVTable = RawWakerVTable::new(clone_waker, wake, wake, |_| {});

fn clone_waker(id: *const ()) -> RawWaker {
    RawWaker::new(id, &VTABLE)
}

/// A waker of an executor that is gone, or lives on another thread, wakes nobody.
fn wake(id: *const ()) {
    let id = id.addr();
    // Fails only while the thread ends, when there is nobody left to wake.
    let _ = CLOCK.try_with(|clock| {
        if id >> SLOT_BITS == clock.owner.get() {
            clock.tasks.borrow_mut().wake(id & SLOT_MASK);
        }
    });
}

struct ThreadDriver;

impl Driver for ThreadDriver {
    fn now(&self) -> u64 {
        // A driver must always answer; while a thread ends there is no time any more.
        CLOCK
            .try_with(|clock| {
                clock.look();
                clock.now_ns.get() / NS_PER_TICK
            })
            .unwrap_or(0)
    }

    fn schedule_wake(&self, at: u64, waker: &Waker) {
        CLOCK.with(|clock| clock.schedule(at.saturating_mul(NS_PER_TICK), waker));
    }
}

#[allow(unsafe_code, reason = "embassy-time finds its driver by linkage")]
mod linkage {
    embassy_time_driver::time_driver_impl!(static DRIVER: super::ThreadDriver = super::ThreadDriver);
}

/// The thread's virtual time, ns. Only the simulator sees time this fine; the unit has embassy's ticks.
pub fn now_ns() -> u64 {
    CLOCK.with(Clock::now_ns)
}

/// Waits until `at_ns`.
///
/// Cancellation: safe.
pub fn sleep_until_ns(at_ns: u64) -> Sleep {
    Sleep { at_ns }
}

/// Future of [`sleep_until_ns`].
#[derive(Debug)]
#[must_use = "futures do nothing unless awaited"]
pub struct Sleep {
    at_ns: u64,
}

impl Future for Sleep {
    type Output = ();

    fn poll(self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<()> {
        CLOCK.with(|clock| {
            if clock.now_ns() >= self.at_ns {
                return Poll::Ready(());
            }
            clock.schedule(self.at_ns, cx.waker());
            Poll::Pending
        })
    }
}

/// To be called by whatever a program can poll in a loop: a pin, a flag. The millionth look in one poll
/// ends the run with [`Failure::Spinning`](crate::Failure::Spinning).
pub fn look() {
    CLOCK.with(Clock::look);
}

/// The task being polled keeps the processor for this long; see [Preemption](crate#preemption).
pub fn spend(time: Duration) {
    CLOCK.with(|clock| {
        let ns = time.as_ticks().saturating_mul(NS_PER_TICK);
        clock.spent_ns.set(clock.spent_ns.get().saturating_add(ns));
    });
}

/// Ends the run after the present poll, with [`Stop::Requested`](crate::Stop::Requested): a reset of the
/// unit, the end of a scenario. The run can go on afterwards.
pub fn stop() {
    CLOCK.with(|clock| clock.stop.set(true));
}

/// Mixes a value into the run's trace, [`Executor::trace`](crate::Executor::trace).
pub fn mark(value: u64) {
    CLOCK.with(|clock| clock.mark(value));
}
