//! How busy the core is: instructions executed, by the unit's mode.
//!
//! A core that waits for an interrupt executes none. What is counted are instructions, not clocks.

use serde::Serialize;

use crate::board::CORE_HZ;

/// Length of the windows of which the busiest is told, s.
const WINDOW_S: f64 = 0.1;

/// The load in one mode.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ModeLoad {
    /// The unit's mode; `start` before it has told one.
    pub mode: String,
    /// How long it was in it, s.
    pub seconds: f64,
    /// Instructions executed.
    pub instructions: u64,
    /// Instructions a second, as a share of the core's clock.
    pub share: f64,
    /// The same over the busiest tenth of a second.
    pub peak: f64,
}

/// Counts instructions by mode.
#[derive(Debug, Default)]
pub(crate) struct Meter {
    rows: Vec<ModeLoad>,
    at: (f64, u64),
    window: (f64, u64),
}

impl Meter {
    /// The core has executed so many instructions by `t_s`, the last of them in this mode.
    pub(crate) fn count(&mut self, t_s: f64, instructions: u64, mode: &str) {
        let (since_s, since) = core::mem::replace(&mut self.at, (t_s, instructions));
        let index = match self.rows.iter().position(|row| row.mode == mode) {
            Some(index) => index,
            None => {
                self.rows.push(ModeLoad {
                    mode: mode.to_owned(),
                    seconds: 0.0,
                    instructions: 0,
                    share: 0.0,
                    peak: 0.0,
                });
                self.rows.len() - 1
            }
        };
        let row = &mut self.rows[index];
        row.seconds += t_s - since_s;
        row.instructions += instructions - since;
        let share = |instructions: u64, seconds: f64| instructions as f64 / seconds / CORE_HZ as f64;
        row.share = share(row.instructions, row.seconds);
        let (begin_s, begin) = self.window;
        if t_s - begin_s >= WINDOW_S {
            row.peak = row.peak.max(share(instructions - begin, t_s - begin_s));
            self.window = (t_s, instructions);
        }
    }

    /// What was counted, in the order of the modes' first times.
    pub(crate) fn rows(&self) -> Vec<ModeLoad> {
        self.rows.clone()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shares_are_of_the_clock() {
        let mut meter = Meter::default();
        for k in 1..=10_u32 {
            let busy = if k <= 5 { 16_800 } else { 1_680_000 };
            let so_far: u64 = (1..=k).map(|j| if j <= 5 { 16_800 } else { 1_680_000 }).sum();
            meter.count(f64::from(k) * 0.1, so_far, if busy > 20_000 { "busy" } else { "idle" });
        }
        let rows = meter.rows();
        assert_eq!((rows[0].mode.as_str(), rows[1].mode.as_str()), ("idle", "busy"));
        assert!((rows[0].share - 0.001).abs() < 1e-9);
        assert!((rows[1].share - 0.1).abs() < 1e-9 && (rows[1].peak - 0.1).abs() < 2e-2);
    }
}
