//! Three-phase PWM, seen from the motor.

use core::cell::RefCell;
use std::collections::VecDeque;
use std::rc::Rc;

use drivers::motor::{Duty, ThreePhase};
use vtime::{mark, now_ns};

/// The bridge's inputs from an instant on.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PwmChange {
    /// When.
    pub at_ns: u64,
    /// The duties; `None` for outputs off.
    pub duties: Option<[Duty; 3]>,
}

#[derive(Debug)]
struct State {
    period_ns: u64,
    /// In order of time. The last may lie in the future.
    changes: VecDeque<PwmChange>,
    current: PwmChange,
}

impl State {
    /// What lies in the past becomes the current state, where nobody watches.
    fn push(&mut self, change: PwmChange, watched: bool) {
        mark(change.at_ns);
        while self.changes.back().is_some_and(|last| last.at_ns >= change.at_ns) {
            self.changes.pop_back();
        }
        self.changes.push_back(change);
        while !watched && self.changes.len() > 1 {
            self.changes.pop_front();
        }
    }
}

/// A timer with this period, ns, outputs off; and the motor's view of it.
pub fn pwm(period_ns: u64) -> (PwmSink, PwmMonitor) {
    let state = Rc::new(RefCell::new(State {
        period_ns: period_ns.max(1),
        changes: VecDeque::new(),
        current: PwmChange { at_ns: 0, duties: None },
    }));
    (PwmSink(Rc::clone(&state)), PwmMonitor(state))
}

/// The timer.
#[derive(Debug)]
pub struct PwmSink(Rc<RefCell<State>>);

impl PwmSink {
    fn push(&self, change: PwmChange) {
        let watched = Rc::strong_count(&self.0) > 1;
        self.0.borrow_mut().push(change, watched);
    }
}

impl ThreePhase for PwmSink {
    /// Takes effect at the next multiple of the period, as with a timer's preloaded compare registers; of
    /// several calls in one period the last counts.
    fn set_duties(&mut self, duties: [Duty; 3]) {
        let period_ns = self.0.borrow().period_ns;
        self.push(PwmChange {
            at_ns: (now_ns() / period_ns + 1) * period_ns,
            duties: Some(duties),
        });
        for duty in duties {
            mark(u64::from(duty.share().to_bits()));
        }
    }

    fn outputs_off(&mut self) {
        self.push(PwmChange {
            at_ns: now_ns(),
            duties: None,
        });
    }
}

/// The motor's view of the timer. The motor integrates from change to change:
///
/// ```text
/// while let Some(change) = monitor.next_until(to_ns) {
///     motor.integrate_until(change.at_ns);
///     motor.inputs = change.duties;
/// }
/// motor.integrate_until(to_ns);
/// ```
#[derive(Debug)]
pub struct PwmMonitor(Rc<RefCell<State>>);

impl PwmMonitor {
    /// The earliest change at or before `to_ns` that was not told yet.
    pub fn next_until(&mut self, to_ns: u64) -> Option<PwmChange> {
        let mut state = self.0.borrow_mut();
        let due = state.changes.front().is_some_and(|change| change.at_ns <= to_ns);
        if due {
            let change = state.changes.pop_front()?;
            state.current = change;
            return Some(change);
        }
        None
    }

    /// The last change told.
    pub fn current(&self) -> PwmChange {
        self.0.borrow().current
    }
}

#[cfg(test)]
mod tests {
    use vtime::Executor;

    use super::*;

    #[test]
    fn nothing_piles_up_where_nobody_watches() {
        let _unit = Executor::new();
        let (mut timer, monitor) = pwm(10);
        for _ in 0..3 {
            timer.outputs_off();
            timer.set_duties([Duty::HALF; 3]);
        }
        // Both changes, off and the duties of the next period, once.
        assert_eq!(timer.0.borrow().changes.len(), 2);
        drop(monitor);
        timer.outputs_off();
        timer.set_duties([Duty::HALF; 3]);
        assert_eq!(timer.0.borrow().changes.len(), 1);
    }
}
