//! The executor: polls tasks, moves the clock.

use core::cell::RefCell;
use core::fmt;
use core::future::Future;
use core::marker::PhantomData;
use core::pin::Pin;
use core::sync::atomic::{AtomicUsize, Ordering};
use core::task::{Context, Poll, Waker};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::rc::Rc;

use embassy_time::{Duration, Instant};

use crate::clock::{CLOCK, Clock, NS_PER_TICK, OWNER_MASK, SLOTS, Spun, TaskId};

/// Polls of one task at one instant that are taken for an endless loop.
const POLLS_MAX: u32 = 10_000;

/// Whose code a task is. See [Preemption](crate#preemption).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Level {
    /// The physics around the unit: first at every instant, at no cost.
    World,
    /// The unit's interrupt executor.
    Interrupt,
    /// The unit's thread executor.
    Thread,
}

impl Level {
    pub(crate) const COUNT: usize = 3;
    const ALL: [Self; Self::COUNT] = [Self::World, Self::Interrupt, Self::Thread];

    pub(crate) const fn index(self) -> usize {
        self as usize
    }
}

/// In which order tasks of one level that are ready at one instant are polled.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Order {
    /// First woken, first polled.
    #[default]
    Fifo,
    /// In random order from this seed, to find tasks that depend on the order. The world keeps its own.
    Shuffled(u64),
}

/// Why a run ended well.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Stop {
    /// The time has come.
    Deadline,
    /// The time has come, and nothing will ever happen any more without a touch from outside. With
    /// `Instant::MAX` as deadline the clock stays at the last event.
    Idle,
    /// Every task has ended. The clock stays at that instant.
    Finished,
    /// A task called [`stop`](crate::stop). The clock stays at that instant.
    Requested,
}

/// Why a run cannot go on.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Failure {
    /// A task was polled over and over while time stood still.
    Stuck {
        /// Its name.
        task: &'static str,
        /// When.
        at_us: u64,
        /// How often.
        polls: u32,
    },
    /// One poll of a task looked at clock, pins or mutexes over and over. The task is gone.
    Spinning {
        /// Its name.
        task: &'static str,
        /// When.
        at_us: u64,
    },
    /// A task panicked. The task is gone.
    Panicked {
        /// Its name.
        task: &'static str,
        /// When.
        at_us: u64,
        /// What the panic said.
        message: String,
    },
    /// [`Executor::block_on`]: nothing is left that could complete the future.
    Deadlock {
        /// When.
        at_us: u64,
    },
    /// [`Executor::block_on`]: the limit has come.
    Timeout {
        /// When.
        at_us: u64,
    },
    /// [`Executor::block_on`]: a task called [`stop`](crate::stop).
    Stopped {
        /// When.
        at_us: u64,
    },
}

impl fmt::Display for Failure {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Stuck { task, at_us, polls } => {
                write!(
                    f,
                    "task {task} was polled {polls} times at {at_us} µs without waiting for time"
                )
            }
            Self::Spinning { task, at_us } => write!(f, "task {task} spins without awaiting at {at_us} µs"),
            Self::Panicked { task, at_us, message } => write!(f, "task {task} panicked at {at_us} µs: {message}"),
            Self::Deadlock { at_us } => write!(f, "nothing can happen any more after {at_us} µs"),
            Self::Timeout { at_us } => write!(f, "not done by {at_us} µs"),
            Self::Stopped { at_us } => write!(f, "stopped at {at_us} µs"),
        }
    }
}

impl core::error::Error for Failure {}

struct Task<'a> {
    name: &'static str,
    future: Pin<Box<dyn Future<Output = ()> + 'a>>,
    waker: Waker,
    /// Polls since the clock last moved.
    polls: u32,
    polled_ns: u64,
}

/// A set of tasks and the thread's clock, which starts at zero with it.
///
/// One at a time on a thread. It stays on its thread. What its tasks borrow is declared before it.
pub struct Executor<'a> {
    tasks: Vec<Option<Task<'a>>>,
    alive: usize,
    /// When the processor is done with what a level has spent.
    free_ns: [u64; Level::COUNT],
    order: Order,
    polls: u64,
    on_this_thread: PhantomData<*mut ()>,
}

impl Default for Executor<'_> {
    fn default() -> Self {
        Self::new()
    }
}

impl fmt::Debug for Executor<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Executor")
            .field("now_ns", &crate::now_ns())
            .field("tasks", &self.alive)
            .field("polls", &self.polls)
            .finish_non_exhaustive()
    }
}

impl Drop for Executor<'_> {
    fn drop(&mut self) {
        // The futures first: dropping them may still look at the clock.
        self.tasks.clear();
        CLOCK.with(|clock| clock.restart(0));
    }
}

impl<'a> Executor<'a> {
    /// An executor without tasks, at time zero.
    ///
    /// # Panics
    /// If the thread has one already.
    pub fn new() -> Self {
        Self::with_order(Order::default())
    }

    /// An executor that polls in this order.
    ///
    /// # Panics
    /// If the thread has one already.
    pub fn with_order(order: Order) -> Self {
        static NEXT: AtomicUsize = AtomicUsize::new(1);
        let owner = loop {
            let owner = NEXT.fetch_add(1, Ordering::Relaxed) & OWNER_MASK;
            if owner != 0 {
                break owner;
            }
        };
        CLOCK.with(|clock| {
            assert!(!clock.is_owned(), "a thread has one clock: one executor at a time");
            clock.restart(owner);
        });
        Self {
            tasks: Vec::new(),
            alive: 0,
            free_ns: [0; Level::COUNT],
            order,
            polls: 0,
            on_this_thread: PhantomData,
        }
    }

    /// Adds a task; it is polled for the first time in the next run. Its result is dropped.
    ///
    /// # Panics
    /// Beyond 65,536 tasks.
    pub fn spawn<F: Future + 'a>(&mut self, name: &'static str, level: Level, future: F) -> TaskId {
        let slot = self.tasks.iter().position(Option::is_none).unwrap_or(self.tasks.len());
        assert!(slot < SLOTS, "too many tasks");
        let id = CLOCK.with(|clock| clock.add(slot, level));
        let task = Some(Task {
            name,
            future: Box::pin(async move {
                future.await;
            }),
            waker: id.waker(),
            polls: 0,
            polled_ns: 0,
        });
        if slot == self.tasks.len() {
            self.tasks.push(task);
        } else {
            self.tasks[slot] = task;
        }
        self.alive += 1;
        id
    }

    /// Drops a task where it stands, as a reset does. Whether it was still there.
    pub fn cancel(&mut self, id: TaskId) -> bool {
        id.slot().is_some_and(|slot| self.remove(slot))
    }

    /// Whether a task has not ended.
    pub fn is_running(&self, id: TaskId) -> bool {
        id.slot().is_some_and(|slot| self.tasks[slot].is_some())
    }

    /// Polls so far, of all tasks.
    pub fn polls(&self) -> u64 {
        self.polls
    }

    /// A hash of which task was polled when, and of every [`mark`](crate::mark): equal for runs that did
    /// the same.
    pub fn trace(&self) -> u64 {
        CLOCK.with(Clock::trace)
    }

    /// The instant of the clock, to embassy's tick.
    pub fn now(&self) -> Instant {
        Instant::from_ticks(crate::now_ns() / NS_PER_TICK)
    }

    /// Runs everything that is due until `deadline`, that instant included, and leaves the clock there.
    ///
    /// # Errors
    /// [`Failure::Stuck`], [`Failure::Spinning`], [`Failure::Panicked`].
    pub fn run_until(&mut self, deadline: Instant) -> Result<Stop, Failure> {
        self.run(deadline.as_ticks().saturating_mul(NS_PER_TICK), || false)
    }

    /// [`run_until`](Self::run_until), from now.
    ///
    /// # Errors
    /// As there.
    pub fn run_for(&mut self, time: Duration) -> Result<Stop, Failure> {
        self.run_until(self.now().saturating_add(time))
    }

    /// Runs, with all other tasks, until `future` is done, at most for `limit`. The clock stays at the
    /// instant of completion.
    ///
    /// # Errors
    /// Any [`Failure`].
    pub fn block_on<F: Future + 'a>(&mut self, limit: Duration, future: F) -> Result<F::Output, Failure>
    where
        F::Output: 'a,
    {
        let result = Rc::new(RefCell::new(None));
        let slot = Rc::clone(&result);
        let id = self.spawn("block_on", Level::Thread, async move {
            let output = future.await;
            *slot.borrow_mut() = Some(output);
        });
        let end = self.now().saturating_add(limit);
        let stop = self.run(end.as_ticks().saturating_mul(NS_PER_TICK), || result.borrow().is_some());
        self.cancel(id);
        let at_us = self.now().as_micros();
        let output = result.borrow_mut().take();
        match (output, stop?) {
            (Some(output), _) => Ok(output),
            (None, Stop::Deadline) => Err(Failure::Timeout { at_us }),
            (None, Stop::Idle | Stop::Finished) => Err(Failure::Deadlock { at_us }),
            (None, Stop::Requested) => Err(Failure::Stopped { at_us }),
        }
    }

    fn remove(&mut self, slot: usize) -> bool {
        let Some(task) = self.tasks.get_mut(slot).and_then(Option::take) else {
            return false;
        };
        CLOCK.with(|clock| clock.remove(slot));
        self.alive -= 1;
        drop(task);
        true
    }

    fn run(&mut self, end_ns: u64, done: impl Fn() -> bool) -> Result<Stop, Failure> {
        CLOCK.with(|clock| {
            // A stop asked for from outside a run, or by the last poll of a run that failed, is history.
            clock.take_stop();
            loop {
                if let Some((level, slot)) = self.next(clock) {
                    self.poll(clock, level, slot)?;
                    if clock.take_stop() {
                        return Ok(Stop::Requested);
                    }
                    if done() {
                        return Ok(Stop::Finished);
                    }
                    continue;
                }
                if self.alive == 0 {
                    return Ok(Stop::Finished);
                }
                let next_ns = self.next_event_ns(clock).max(clock.now_ns());
                if next_ns > end_ns || next_ns == u64::MAX {
                    if end_ns != u64::MAX {
                        clock.set_now_ns(end_ns.max(clock.now_ns()));
                    }
                    return Ok(if next_ns == u64::MAX {
                        Stop::Idle
                    } else {
                        Stop::Deadline
                    });
                }
                clock.set_now_ns(next_ns);
                clock.wake_due();
            }
        })
    }

    /// The task to poll now, if any.
    fn next(&mut self, clock: &Clock) -> Option<(Level, usize)> {
        let now_ns = clock.now_ns();
        Level::ALL.into_iter().find_map(|level| {
            if self.free_ns[level.index()] > now_ns {
                return None;
            }
            let slot = clock.take(level, |ready| match &mut self.order {
                Order::Shuffled(state) if level != Level::World => shuffle(state, ready),
                _ => 0,
            })?;
            Some((level, slot))
        })
    }

    /// When something may be polled again: a timer comes, or the processor is free for who is ready.
    fn next_event_ns(&self, clock: &Clock) -> u64 {
        Level::ALL
            .into_iter()
            .filter(|level| clock.is_ready(*level))
            .map(|level| self.free_ns[level.index()])
            .fold(clock.next_deadline_ns(), u64::min)
    }

    fn poll(&mut self, clock: &Clock, level: Level, slot: usize) -> Result<(), Failure> {
        let Some(task) = self.tasks[slot].as_mut() else {
            return Ok(());
        };
        let now_ns = clock.now_ns();
        let (name, at_us) = (task.name, now_ns / NS_PER_TICK);
        if task.polled_ns != now_ns {
            task.polled_ns = now_ns;
            task.polls = 0;
        }
        task.polls += 1;
        if task.polls > POLLS_MAX {
            return Err(Failure::Stuck {
                task: name,
                at_us,
                polls: POLLS_MAX,
            });
        }
        self.polls += 1;
        clock.begin_poll(slot);
        let mut context = Context::from_waker(&task.waker);
        // Unwind safe: a task that unwinds is dropped, and what it shares with others is behind cells.
        let polled = catch_unwind(AssertUnwindSafe(|| task.future.as_mut().poll(&mut context)));
        let spent_ns = clock.end_poll(slot);
        if spent_ns > 0 {
            self.spend(level, now_ns, spent_ns);
        }
        match polled {
            Ok(Poll::Pending) => Ok(()),
            Ok(Poll::Ready(())) => {
                self.remove(slot);
                Ok(())
            }
            Err(payload) => {
                self.remove(slot);
                if payload.is::<Spun>() {
                    return Err(Failure::Spinning { task: name, at_us });
                }
                let message = payload
                    .downcast_ref::<&str>()
                    .map(ToString::to_string)
                    .or_else(|| payload.downcast_ref::<String>().cloned())
                    .unwrap_or_default();
                Err(Failure::Panicked {
                    task: name,
                    at_us,
                    message,
                })
            }
        }
    }

    /// See the crate's front page.
    fn spend(&mut self, level: Level, now_ns: u64, spent_ns: u64) {
        let [_, interrupt, thread] = &mut self.free_ns;
        match level {
            Level::World => {}
            Level::Interrupt => {
                *interrupt = now_ns.saturating_add(spent_ns);
                *thread = now_ns.max(*thread).saturating_add(spent_ns);
            }
            Level::Thread => *thread = now_ns.saturating_add(spent_ns),
        }
    }
}

/// A number below `n`, by SplitMix64.
fn shuffle(state: &mut u64, n: usize) -> usize {
    *state = state.wrapping_add(0x9E37_79B9_7F4A_7C15);
    let x = (*state ^ (*state >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
    let x = (x ^ (x >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
    let x = x ^ (x >> 31);
    // The remainder is even enough for the few tasks there are.
    (x % n as u64) as usize
}
