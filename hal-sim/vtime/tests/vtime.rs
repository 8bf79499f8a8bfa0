//! The clock, the order of tasks, the levels, and what must not hang.

use std::cell::{Cell, RefCell};
use std::rc::Rc;

use embassy_futures::select::{Either, select};
use embassy_futures::{join::join, yield_now};
use embassy_sync::blocking_mutex::raw::{CriticalSectionRawMutex, NoopRawMutex, RawMutex};
use embassy_sync::channel::Channel;
use embassy_sync::signal::Signal;
use embassy_time::{Delay, Duration, Instant, Ticker, Timer, with_timeout};
use embedded_hal_async::delay::DelayNs;
use vtime::{Executor, Failure, Level, LocalRawMutex, Order, Stop, sleep_until_ns};

/// Names in the order of their writing.
type Log = Rc<RefCell<Vec<(&'static str, u64)>>>;

async fn tick(log: Log, name: &'static str, period: Duration) {
    let mut ticker = Ticker::every(period);
    loop {
        ticker.next().await;
        log.borrow_mut().push((name, Instant::now().as_micros()));
    }
}

#[test]
fn a_ticker_keeps_time() {
    let log = Log::default();
    let mut unit = Executor::new();
    unit.spawn("tick", Level::Thread, tick(log.clone(), "tick", Duration::from_hz(100)));
    let start = std::time::Instant::now();
    assert_eq!(unit.run_until(Instant::from_secs(500)), Ok(Stop::Deadline));
    let real = start.elapsed();
    assert_eq!(unit.now(), Instant::from_secs(500));
    assert_eq!(log.borrow().len(), 50_000);
    assert!(log.borrow().iter().zip(1..).all(|((_, at_us), k)| *at_us == k * 10_000));
    // 2 ms in release, 4 ms in the dev profile; the limit is for a loaded machine.
    assert!(real.as_millis() < 100, "{real:?}");
}

#[test]
fn runs_go_on_where_they_stopped() {
    let mut unit = Executor::new();
    unit.spawn("once", Level::Thread, Timer::after_millis(15));
    unit.spawn("never", Level::Thread, core::future::pending::<()>());
    assert_eq!(unit.run_for(Duration::from_millis(10)), Ok(Stop::Deadline));
    // Due at the deadline itself: still run.
    assert_eq!(unit.run_for(Duration::from_millis(5)), Ok(Stop::Idle));
    assert_eq!(unit.run_until(Instant::from_secs(1)), Ok(Stop::Idle));
    assert_eq!(unit.now(), Instant::from_secs(1));
    // Never back, and not to the end of time.
    assert_eq!(unit.run_until(Instant::from_millis(1)), Ok(Stop::Idle));
    assert_eq!(unit.run_until(Instant::MAX), Ok(Stop::Idle));
    assert_eq!(unit.now(), Instant::from_secs(1));
}

#[test]
fn time_starts_anew_with_every_executor() {
    for _ in 0..2 {
        let mut unit = Executor::new();
        assert_eq!(Instant::now().as_ticks(), 0);
        unit.spawn("t", Level::Thread, Timer::after_secs(3));
        assert_eq!(unit.run_until(Instant::MAX), Ok(Stop::Finished));
        assert_eq!(Instant::now(), Instant::from_secs(3));
    }
    assert_eq!(Instant::now().as_ticks(), 0);
}

#[test]
#[should_panic(expected = "one executor at a time")]
fn two_executors_on_a_thread_are_refused() {
    let _first = Executor::new();
    let _second = Executor::new();
}

#[test]
fn equal_deadlines_in_order_of_spawning() {
    let log = Log::default();
    let mut unit = Executor::new();
    // The deadlines are asked for in another order than the tasks were spawned.
    for (name, first_us) in [("a", 300), ("b", 100), ("c", 200)] {
        let log = log.clone();
        unit.spawn(name, Level::Thread, async move {
            Timer::after_micros(first_us).await;
            for at_us in [1000, 2000] {
                Timer::at(Instant::from_micros(at_us)).await;
                log.borrow_mut().push((name, at_us));
            }
        });
    }
    assert_eq!(unit.run_until(Instant::MAX), Ok(Stop::Finished));
    let expected = [1000, 2000].map(|t| ["a", "b", "c"].map(|name| (name, t))).concat();
    assert_eq!(*log.borrow(), expected);
}

#[test]
fn levels_in_order_at_one_instant() {
    let log = Log::default();
    let signal = Signal::<LocalRawMutex, ()>::new();
    let mut unit = Executor::new();
    for name in ["thread 1", "thread 2"] {
        let (log, signal) = (log.clone(), &signal);
        unit.spawn(name, Level::Thread, async move {
            Timer::after_millis(1).await;
            log.borrow_mut().push((name, 1));
            signal.signal(());
        });
    }
    let (interrupt_log, interrupt) = (log.clone(), &signal);
    unit.spawn("interrupt", Level::Interrupt, async move {
        loop {
            interrupt.wait().await;
            interrupt_log.borrow_mut().push(("interrupt", 1));
        }
    });
    let world = log.clone();
    unit.spawn("world", Level::World, async move {
        Timer::after_millis(1).await;
        world.borrow_mut().push(("world", 1));
    });
    assert_eq!(unit.run_until(Instant::MAX), Ok(Stop::Idle));
    // The interrupt comes between the two threads that were ready before it.
    let names: Vec<_> = log.borrow().iter().map(|(name, _)| *name).collect();
    assert_eq!(names, ["world", "thread 1", "interrupt", "thread 2", "interrupt"]);
}

/// Latest an interrupt task at 2 kHz and a thread task at 1 kHz come to run, µs, with costs of both.
fn lateness(interrupt_cost_us: u64, thread_cost_us: u64) -> (u64, u64) {
    let late = |worst: Rc<Cell<u64>>, period_us: u64| async move {
        let mut ticker = Ticker::every(Duration::from_micros(period_us));
        for k in 1.. {
            ticker.next().await;
            worst.set(worst.get().max(Instant::now().as_micros() - k * period_us));
        }
    };
    let (motor, sampling) = (Rc::new(Cell::new(0)), Rc::new(Cell::new(0)));
    let mut unit = Executor::new();
    // Spawned first, so that it would come first if levels did not count.
    let navigation = unit.spawn("navigation", Level::Thread, async {
        loop {
            Timer::after_millis(5).await;
        }
    });
    unit.spawn("sampling", Level::Thread, late(sampling.clone(), 1000));
    let motor_id = unit.spawn("motor", Level::Interrupt, late(motor.clone(), 500));
    navigation.set_cost(Duration::from_micros(thread_cost_us));
    motor_id.set_cost(Duration::from_micros(interrupt_cost_us));
    assert_eq!(unit.run_until(Instant::from_secs(10)), Ok(Stop::Deadline));
    (motor.get(), sampling.get())
}

#[test]
fn the_interrupt_level_preempts() {
    assert_eq!(lateness(0, 0), (0, 0));
    // The thread's 300 µs delay the other thread and never the motor.
    assert_eq!(lateness(0, 300), (0, 300));
    // The motor's 50 µs at each of its ticks come on top: at the shared instant one, and with 700 µs of
    // work a second one on the way.
    assert_eq!(lateness(50, 300), (0, 350));
    assert_eq!(lateness(50, 700), (0, 800));
}

#[test]
fn time_spent_in_a_poll_delays_its_own_level() {
    let mut unit = Executor::new();
    unit.spawn("busy", Level::Thread, async {
        vtime::spend(Duration::from_micros(250));
        yield_now().await;
        assert_eq!(Instant::now(), Instant::from_micros(250));
    });
    unit.spawn("interrupt", Level::Interrupt, async {
        Timer::after_micros(100).await;
        assert_eq!(Instant::now(), Instant::from_micros(100));
    });
    assert_eq!(unit.run_until(Instant::MAX), Ok(Stop::Finished));
}

#[test]
fn what_embassy_offers_works() {
    let channel = Channel::<LocalRawMutex, u32, 2>::new();
    let mut unit = Executor::new();
    let (sender, receiver) = (channel.sender(), channel.receiver());
    unit.spawn("producer", Level::Thread, async move {
        for k in 0..5 {
            Timer::after_millis(10).await;
            sender.send(k).await;
        }
    });
    let sum = unit.block_on(Duration::from_secs(1), async move {
        let mut sum = 0;
        while let Ok(k) = with_timeout(Duration::from_millis(20), receiver.receive()).await {
            sum += k;
        }
        assert_eq!(Instant::now(), Instant::from_millis(70));
        let (_, either) = join(Delay.delay_us(3), select(Timer::after_secs(9), Delay.delay_ms(1))).await;
        assert!(matches!(either, Either::Second(())));
        sum
    });
    assert_eq!(sum, Ok(10));
    assert_eq!(unit.now(), Instant::from_micros(71_000));
}

#[test]
fn nanoseconds_add_up_below_the_tick() {
    let mut unit = Executor::new();
    let done = unit.block_on(Duration::from_millis(1), async {
        for k in 1..=10 {
            sleep_until_ns(k * 250).await;
            assert_eq!(Instant::now().as_ticks(), k * 250 / 1000);
        }
        vtime::now_ns()
    });
    assert_eq!(done, Ok(2500));
}

#[test]
fn a_reset_drops_the_tasks_and_leaves_the_world() {
    struct Flag(Rc<Cell<u32>>);
    impl Drop for Flag {
        fn drop(&mut self) {
            self.0.set(self.0.get() + 1);
        }
    }
    let (dropped, log) = (Rc::new(Cell::new(0)), Log::default());
    let mut unit = Executor::new();
    unit.spawn(
        "world",
        Level::World,
        tick(log.clone(), "world", Duration::from_millis(1)),
    );
    let mut last = None;
    for boot in 1..=20 {
        let flag = Flag(dropped.clone());
        let app = unit.spawn("app", Level::Thread, async move {
            let _flag = flag;
            Timer::after_micros(7_300).await;
            vtime::stop();
            core::future::pending::<()>().await;
        });
        assert_eq!(unit.run_until(Instant::MAX), Ok(Stop::Requested));
        assert!(unit.is_running(app));
        assert!(unit.cancel(app) && !unit.cancel(app) && !unit.is_running(app));
        assert_eq!(dropped.get(), boot);
        assert_eq!(unit.now(), Instant::from_micros(7_300 * u64::from(boot)));
        // The slot is another task's now: the old name has no power over it.
        if let Some(old) = last.replace(app) {
            assert!(old != app && !unit.cancel(old));
        }
    }
    assert_eq!(log.borrow().len(), 146);
}

#[test]
fn a_frozen_task_hangs_alone() {
    let log = Log::default();
    let mut unit = Executor::new();
    let a = unit.spawn("a", Level::Thread, tick(log.clone(), "a", Duration::from_millis(10)));
    unit.spawn("b", Level::Thread, tick(log.clone(), "b", Duration::from_millis(10)));
    unit.spawn("fault", Level::World, async move {
        Timer::after_millis(25).await;
        a.freeze(true);
        Timer::after_millis(30).await;
        a.freeze(false);
    });
    assert_eq!(unit.run_until(Instant::from_millis(60)), Ok(Stop::Deadline));
    let of = |name| {
        let log = log.borrow();
        log.iter()
            .filter(|entry| entry.0 == name)
            .map(|entry| entry.1 / 1000)
            .collect::<Vec<_>>()
    };
    assert_eq!(of("b"), [10, 20, 30, 40, 50, 60]);
    // The ticker catches up what it missed.
    assert_eq!(of("a"), [10, 20, 55, 55, 55, 60]);
}

/// A run of the body as the task "culprit" beside an innocent one.
fn failure<F: Future>(body: F) -> Result<Stop, Failure> {
    let mut unit = Executor::new();
    unit.spawn(
        "innocent",
        Level::Thread,
        tick(Log::default(), "", Duration::from_millis(1)),
    );
    unit.spawn("culprit", Level::Thread, async {
        Timer::after_micros(2_500).await;
        body.await;
    });
    unit.run_until(Instant::from_secs(1))
}

#[test]
fn a_task_that_yields_for_ever_is_named() {
    let stuck = failure(async {
        loop {
            yield_now().await;
        }
    });
    let expected = Failure::Stuck {
        task: "culprit",
        at_us: 2500,
        polls: 10_000,
    };
    assert_eq!(stuck, Err(expected));
    assert!(failure(async { Timer::after_ticks(0).await }).is_ok());
}

#[test]
fn a_poll_that_never_returns_is_named() {
    let expected = Err(Failure::Spinning {
        task: "culprit",
        at_us: 2500,
    });
    let wait_for_clock = async { embassy_time::block_for(Duration::from_millis(1)) };
    assert_eq!(failure(wait_for_clock), expected);
    let wait_for_channel = async {
        let channel = Channel::<LocalRawMutex, u32, 2>::new();
        while channel.try_receive().is_err() {}
    };
    assert_eq!(failure(wait_for_channel), expected);
}

#[test]
fn a_panic_is_named() {
    let panicked = failure(async { panic!("angle of {} turns", 7) });
    let expected = Failure::Panicked {
        task: "culprit",
        at_us: 2500,
        message: "angle of 7 turns".into(),
    };
    assert_eq!(panicked, Err(expected));
    // The thread is fit for the next run.
    assert_eq!(failure(async {}), Ok(Stop::Deadline));
}

#[test]
fn what_cannot_complete_is_told() {
    let mut unit = Executor::new();
    let forever = || core::future::pending::<()>();
    assert_eq!(
        unit.block_on(Duration::from_secs(9), forever()),
        Err(Failure::Deadlock { at_us: 9_000_000 })
    );
    unit.spawn(
        "tick",
        Level::Thread,
        tick(Log::default(), "", Duration::from_millis(1)),
    );
    assert_eq!(
        unit.block_on(Duration::from_millis(5), forever()),
        Err(Failure::Timeout { at_us: 9_005_000 })
    );
}

#[test]
fn foreign_wakers_are_refused_by_timers() {
    let refused = std::panic::catch_unwind(|| embassy_futures::block_on(Timer::after_millis(1)));
    assert!(refused.is_err());
}

#[test]
fn wakers_outlive_their_executor() {
    let kept = RefCell::new(None);
    let mut unit = Executor::new();
    unit.spawn("keep", Level::Thread, async {
        core::future::poll_fn(|cx| {
            *kept.borrow_mut() = Some(cx.waker().clone());
            core::task::Poll::<()>::Pending
        })
        .await;
    });
    assert_eq!(unit.run_until(Instant::MAX), Ok(Stop::Idle));
    let polls = unit.polls();
    let waker = kept.borrow_mut().take().unwrap();
    // From another thread: heard by nobody.
    std::thread::scope(|scope| {
        scope.spawn(|| waker.wake_by_ref());
    });
    assert_eq!((unit.run_until(Instant::MAX), unit.polls()), (Ok(Stop::Idle), polls));
    waker.wake_by_ref();
    assert_eq!(
        (unit.run_until(Instant::MAX), unit.polls()),
        (Ok(Stop::Idle), polls + 1)
    );
    drop(unit);
    let mut next = Executor::new();
    next.spawn("other", Level::Thread, core::future::pending::<()>());
    assert_eq!(next.run_until(Instant::MAX), Ok(Stop::Idle));
    waker.wake();
    assert_eq!((next.run_until(Instant::MAX), next.polls()), (Ok(Stop::Idle), 1));
}

/// A run of some tasks that talk: its trace, and what they did.
fn scenario<M: RawMutex>(order: Order, seed: u64) -> (u64, Vec<(&'static str, u64)>) {
    let log = Log::default();
    let channel = Channel::<M, u64, 4>::new();
    let mut unit = Executor::with_order(order);
    for (name, period_us) in [("a", 700 + seed), ("b", 700), ("c", 1400)] {
        let (log, sender) = (log.clone(), channel.sender());
        unit.spawn(name, Level::Thread, async move {
            let mut ticker = Ticker::every(Duration::from_micros(period_us));
            loop {
                ticker.next().await;
                log.borrow_mut().push((name, Instant::now().as_micros()));
                sender.send(period_us).await;
            }
        });
    }
    unit.spawn("sink", Level::Interrupt, async {
        loop {
            vtime::mark(channel.receive().await);
        }
    });
    assert_eq!(unit.run_until(Instant::from_secs(2)), Ok(Stop::Deadline));
    let trace = unit.trace();
    drop(unit);
    (trace, log.take())
}

#[test]
fn same_seed_same_trace_on_any_thread() {
    let alone: Vec<_> = (0..8).map(|seed| scenario::<NoopRawMutex>(Order::Fifo, seed)).collect();
    for (k, run) in alone.iter().enumerate() {
        assert!(alone[..k].iter().all(|other| other.0 != run.0));
    }
    // Eight clocks at eight different times, side by side.
    let together: Vec<_> = std::thread::scope(|scope| {
        let threads: Vec<_> = (0..8)
            .map(|seed| scope.spawn(move || scenario::<LocalRawMutex>(Order::Fifo, seed)))
            .collect();
        threads.into_iter().map(|thread| thread.join().unwrap()).collect()
    });
    assert_eq!(alone, together);
}

#[test]
fn shuffled_orders_differ_and_repeat() {
    let run = |seed| scenario::<NoopRawMutex>(Order::Shuffled(seed), 0);
    let (first, again, other) = (run(1), run(1), run(2));
    assert_eq!(first, again);
    assert_ne!(first.0, other.0);
    // What happens at which instant is the same; only the order within it is not.
    let sorted = |mut log: Vec<(&'static str, u64)>| {
        log.sort_by_key(|(name, at_us)| (*at_us, *name));
        log
    };
    assert_eq!(sorted(first.1), sorted(other.1));
}

/// The application's mutex is a type parameter, because this one is a lock over all threads.
#[test]
fn the_targets_mutex_would_compile() {
    fn generic<M: RawMutex>() -> Channel<M, u8, 1> {
        Channel::new()
    }
    let _target: fn() -> Channel<CriticalSectionRawMutex, u8, 1> = generic;
    let _here = generic::<LocalRawMutex>();
}
