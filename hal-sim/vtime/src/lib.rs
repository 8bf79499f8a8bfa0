//! Virtual time for embassy on a host: one clock and one executor a thread.
//!
//! This crate *is* the embassy time driver of whatever it is linked into: `embassy_time::Instant`,
//! `Timer`, `Ticker`, `with_timeout` and `Delay` then run on the thread's virtual clock. Nothing ever
//! sleeps: when no task is ready the clock jumps to the next deadline. Every thread has its own clock, so
//! scenarios run side by side and know nothing of each other.
//!
//! ```
//! use embassy_time::{Duration, Instant, Timer};
//!
//! let mut unit = vtime::Executor::new();
//! unit.spawn("blink", vtime::Level::Thread, async {
//!     loop {
//!         Timer::after_millis(500).await;
//!     }
//! });
//! assert_eq!(unit.run_until(Instant::from_secs(3600)), Ok(vtime::Stop::Deadline));
//! assert_eq!(unit.polls(), 7201);
//! ```
//!
//! # Why not embassy's executor
//!
//! `raw::Executor` takes only tasks from static pools, made by `#[task]`, which refuses generics. A
//! simulator would need one concrete task for every combination of models, could not drop a task (a reset
//! of the unit in mid-turn), and would share the pools between threads. Here a task is any future, of any
//! lifetime. What the application sees is kept as on the target: its bodies are plain `async fn`s, and as
//! with embassy's integrated queue a task has *one* timer entry, the earliest it asked for, and timers
//! take no foreign wakers (`FuturesUnordered` and the like are refused with a panic).
//!
//! # Order
//!
//! At one instant: the [`Level`]s in order; inside a level, first woken, first polled
//! ([`Order::Fifo`]); timers due at one instant wake their tasks in the order of spawning. embassy
//! promises no order among tasks of one executor (it happens to pop each batch last in, first out), so
//! the application must not depend on any: [`Order::Shuffled`] polls in a seeded random order to show
//! that.
//!
//! # Preemption
//!
//! Code takes no virtual time by itself. A poll is therefore never interrupted, and it does not need to
//! be: after *every* poll the higher levels are looked at first, so a task at [`Level::Interrupt`] is
//! never later than its deadline on account of a task at [`Level::Thread`].
//!
//! Where the time of the processor matters, tasks are given a cost ([`TaskId::set_cost`], a time for each
//! poll) or their surroundings call [`spend`]. A level that has spent time polls nothing until it is
//! over; what an interrupt spends is added to what the thread level still owes, as preemption does:
//!
//! ```text
//! poll at t costing c    interrupt:  free_i = t + c,  free_t = max(free_t, t) + c
//!                        thread:     free_t = t + c
//! ```
//!
//! What differs from a preempted processor: the effects of a poll (a signal, a pin, a transfer begun)
//! come at its beginning and not spread over its cost, and `Instant::now()` stands still in it.
//! [`Level::World`] is not code of the unit at all but the physics around it; it comes first and costs
//! nothing.
//!
//! # What cannot hang
//!
//! | fault | found by | reported as |
//! |---|---|---|
//! | tasks that wake themselves or each other without time passing | polls of one task at one instant | [`Failure::Stuck`] |
//! | `while pin.is_low() {}`, `block_for`, `while channel.try_receive().is_err() {}` | looks at clock, [`LocalRawMutex`] or anything that calls [`look`], in one poll | [`Failure::Spinning`] |
//! | a panic in a task | unwinding | [`Failure::Panicked`] |
//! | everyone waits for everyone | no timer, nothing ready | [`Stop::Idle`], [`Failure::Deadlock`] |
//!
//! each with the name of the task. Not found: a loop that looks at nothing.
//!
//! # Cost
//!
//! The next deadline is found by a scan over all tasks, which for the 20 or so of a unit is faster than
//! a heap. `cargo run --release -p vtime --example speed` prints the figures.

mod clock;
mod executor;
mod mutex;

pub use clock::{Sleep, TaskId, look, mark, now_ns, sleep_until_ns, spend, stop};
pub use executor::{Executor, Failure, Level, Order, Stop};
pub use mutex::LocalRawMutex;
