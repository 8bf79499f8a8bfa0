//! A digital line: one level, its edges with their times, and who waits for them.

use core::cell::RefCell;
use core::convert::Infallible;
use core::future::poll_fn;
use core::task::Poll;
use std::rc::Rc;

use embassy_time::Instant;
use embedded_hal::digital::{ErrorType, InputPin, OutputPin, StatefulOutputPin};
use embedded_hal_async::digital::Wait;
use vtime::{look, mark, now_ns};

use super::Waiters;

/// Edges of one direction.
#[derive(Debug, Clone, Copy, Default)]
struct Edges {
    heard: u64,
    /// The last one, heard or not.
    last_ns: Option<u64>,
    /// The last one heard.
    stamp_ns: u64,
    lose: u32,
    lost: u64,
}

#[derive(Debug)]
struct State {
    driven: bool,
    forced: Option<bool>,
    level: bool,
    rising: Edges,
    falling: Edges,
    waiters: Waiters,
}

impl State {
    fn update(&mut self) {
        let level = self.forced.unwrap_or(self.driven);
        if level == self.level {
            return;
        }
        self.level = level;
        let now_ns = now_ns();
        let edges = if level { &mut self.rising } else { &mut self.falling };
        edges.last_ns = Some(now_ns);
        if edges.lose > 0 {
            edges.lose -= 1;
            edges.lost += 1;
            return;
        }
        edges.heard += 1;
        edges.stamp_ns = now_ns;
        mark(u64::from(level));
        self.waiters.wake();
    }
}

/// When an edge came.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Stamp {
    /// Its time.
    pub at_ns: u64,
    /// Edges before it that nobody took.
    pub overrun: u64,
}

impl Stamp {
    /// Its time in ticks of the unit's clock, as the interrupt would read it.
    pub fn instant(&self) -> Instant {
        Instant::from_micros(self.at_ns / 1000)
    }
}

/// A line between two ends: data-ready, home switch, fault, enable. Clones are the same line.
#[derive(Debug, Clone)]
pub struct Line(Rc<RefCell<State>>);

impl Line {
    /// A line at rest at `level`.
    pub fn new(level: bool) -> Self {
        Self(Rc::new(RefCell::new(State {
            driven: level,
            forced: None,
            level,
            rising: Edges::default(),
            falling: Edges::default(),
            waiters: Waiters::default(),
        })))
    }

    /// Drives the line.
    pub fn set(&self, level: bool) {
        let mut state = self.0.borrow_mut();
        state.driven = level;
        state.update();
    }

    /// A line that is stuck at a level whoever drives it; `None` lets go.
    pub fn force(&self, level: Option<bool>) {
        let mut state = self.0.borrow_mut();
        state.forced = level;
        state.update();
    }

    /// Its level.
    pub fn level(&self) -> bool {
        self.0.borrow().level
    }

    /// The next `n` rising edges, on top of those still to be lost, are not heard by anyone who waits, as an interrupt
    /// that got lost. The level is as it is.
    pub fn lose_rising(&self, n: u32) {
        self.0.borrow_mut().rising.lose += n;
    }

    /// The same for falling edges.
    pub fn lose_falling(&self, n: u32) {
        self.0.borrow_mut().falling.lose += n;
    }

    /// Edges lost so far, of both directions.
    pub fn lost(&self) -> u64 {
        let state = self.0.borrow();
        state.rising.lost + state.falling.lost
    }

    /// When it last rose, lost edges included.
    pub fn rose_ns(&self) -> Option<u64> {
        self.0.borrow().rising.last_ns
    }

    /// When it last fell, lost edges included.
    pub fn fell_ns(&self) -> Option<u64> {
        self.0.borrow().falling.last_ns
    }

    /// The end that listens.
    pub fn input(&self) -> Input {
        Input {
            line: self.clone(),
            taken: self.0.borrow().rising.heard,
        }
    }

    /// The end that drives.
    pub fn output(&self) -> Output {
        Output { line: self.clone() }
    }
}

/// The listening end of a [`Line`].
///
/// The functions of `Wait` hear edges that come while they wait, as embassy's `ExtiInput` does, and forget
/// the others. [`Input::rising`] remembers.
///
/// Cancellation: all are safe.
#[derive(Debug)]
pub struct Input {
    line: Line,
    /// Rising edges that `rising` has told.
    taken: u64,
}

impl Input {
    /// The next rising edge that was not told yet, with the time at which it came; the last one if there
    /// are several. It is the edge's time also if the task comes late: what the firmware has from a
    /// capture in the interrupt.
    pub async fn rising(&mut self) -> Stamp {
        let Self { line, taken } = self;
        poll_fn(|cx| {
            look();
            let mut state = line.0.borrow_mut();
            let new = state.rising.heard - *taken;
            if new == 0 {
                state.waiters.register(cx.waker());
                return Poll::Pending;
            }
            *taken = state.rising.heard;
            Poll::Ready(Stamp {
                at_ns: state.rising.stamp_ns,
                overrun: new - 1,
            })
        })
        .await
    }

    /// Forgets the edges that `rising` has not told.
    pub fn clear(&mut self) {
        self.taken = self.line.0.borrow().rising.heard;
    }

    async fn wait_for(&self, come: impl Fn(&State) -> bool) {
        poll_fn(|cx| {
            look();
            let mut state = self.line.0.borrow_mut();
            if come(&state) {
                return Poll::Ready(());
            }
            state.waiters.register(cx.waker());
            Poll::Pending
        })
        .await;
    }

    async fn wait_for_more(&self, count: impl Fn(&State) -> u64) {
        let before = count(&self.line.0.borrow());
        self.wait_for(|state| count(state) != before).await;
    }
}

impl ErrorType for Input {
    type Error = Infallible;
}

impl InputPin for Input {
    fn is_high(&mut self) -> Result<bool, Infallible> {
        look();
        Ok(self.line.level())
    }

    fn is_low(&mut self) -> Result<bool, Infallible> {
        self.is_high().map(|high| !high)
    }
}

impl Wait for Input {
    async fn wait_for_high(&mut self) -> Result<(), Infallible> {
        self.wait_for(|state| state.level).await;
        Ok(())
    }

    async fn wait_for_low(&mut self) -> Result<(), Infallible> {
        self.wait_for(|state| !state.level).await;
        Ok(())
    }

    async fn wait_for_rising_edge(&mut self) -> Result<(), Infallible> {
        self.wait_for_more(|state| state.rising.heard).await;
        Ok(())
    }

    async fn wait_for_falling_edge(&mut self) -> Result<(), Infallible> {
        self.wait_for_more(|state| state.falling.heard).await;
        Ok(())
    }

    async fn wait_for_any_edge(&mut self) -> Result<(), Infallible> {
        self.wait_for_more(|state| state.rising.heard + state.falling.heard)
            .await;
        Ok(())
    }
}

/// The driving end of a [`Line`].
#[derive(Debug)]
pub struct Output {
    line: Line,
}

impl ErrorType for Output {
    type Error = Infallible;
}

impl OutputPin for Output {
    fn set_low(&mut self) -> Result<(), Infallible> {
        self.line.set(false);
        Ok(())
    }

    fn set_high(&mut self) -> Result<(), Infallible> {
        self.line.set(true);
        Ok(())
    }
}

impl StatefulOutputPin for Output {
    fn is_set_high(&mut self) -> Result<bool, Infallible> {
        look();
        Ok(self.line.0.borrow().driven)
    }

    fn is_set_low(&mut self) -> Result<bool, Infallible> {
        self.is_set_high().map(|high| !high)
    }
}
