//! Set-points: ramps, moves, and the way into the schedule from any angle.

use frames::math;
use nav::rotor::{RotorConfig, RotorState, Schedule};

/// Time in whole microseconds, so that hours of ticks add up without loss.
pub(super) fn seconds(t_us: u32) -> f32 {
    t_us as f32 * 1e-6
}

/// A rate brought to another one with limited acceleration.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Ramp {
    pub(super) angle: f32,
    pub(super) rate: f32,
}

impl Ramp {
    /// The set-point of this tick; moves on by `dt` towards `rate`.
    pub(super) fn step(&mut self, rate: f32, acceleration: f32, dt: f32) -> RotorState {
        let change = math::limit(rate - self.rate, -acceleration * dt, acceleration * dt);
        let now = RotorState {
            angle: self.angle,
            rate: self.rate,
            acceleration: change / dt,
        };
        self.angle += (self.rate + 0.5 * change) * dt;
        self.rate += change;
        now
    }
}

/// From rest at one angle to rest at another: the first leg of a schedule of that travel.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Move {
    from: f32,
    to: f32,
    schedule: Option<Schedule>,
    t_us: u32,
}

impl Move {
    pub(super) fn new(from: f32, to: f32, rate: f32, acceleration: f32) -> Self {
        let travel = (to - from).abs();
        // A short move does not reach the full rate: v² = a s, a little less so that rounding does not refuse it.
        let rate = rate.min(math::sqrt(travel * acceleration) * 0.999);
        Self {
            from,
            to,
            schedule: Schedule::new(RotorConfig {
                rate,
                travel,
                acceleration,
            })
            .ok(),
            t_us: 0,
        }
    }

    /// The set-point of this tick; `None` once the move is over.
    pub(super) fn step(&mut self, dt_us: u32) -> Option<RotorState> {
        let schedule = self.schedule?;
        let t = seconds(self.t_us);
        if t >= 0.5 * schedule.period() {
            return None;
        }
        self.t_us += dt_us;
        let way = if self.to < self.from { -1.0 } else { 1.0 };
        let s = schedule.at(t);
        Some(RotorState {
            angle: self.from + way * s.angle,
            rate: way * s.rate,
            acceleration: way * s.acceleration,
        })
    }
}

/// The schedule, entered from rest at any angle of the travel.
///
/// Both the entry ramp and the schedule's own first ramp cost ω/2a against a leg at full rate, so the entry at angle
/// α₀ runs into the upward leg at the schedule's time α₀/ω + τ, τ since the entry; downward, at
/// leg + (travel − α₀)/ω + τ.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Cycle {
    /// Time in the schedule, µs, below its period.
    t_us: u32,
    /// From where, which way and since when, until the entry ramp is over.
    entry: Option<(f32, f32, u32)>,
}

/// The period of a schedule, µs.
pub(super) fn period_us(schedule: &Schedule) -> u32 {
    (schedule.period() * 1e6 + 0.5) as u32
}

impl Cycle {
    /// Upwards from the lower half, downwards from the upper one: there is room for the ramps in both.
    pub(super) fn enter(from: f32, schedule: &Schedule) -> Self {
        let RotorConfig { rate, travel, .. } = *schedule.config();
        let up = from <= 0.5 * travel;
        let t = if up {
            from / rate
        } else {
            0.5 * schedule.period() + (travel - from) / rate
        };
        Self {
            t_us: (t * 1e6) as u32,
            entry: Some((from, if up { 1.0 } else { -1.0 }, 0)),
        }
    }

    /// The set-point of this tick.
    pub(super) fn step(&mut self, schedule: &Schedule, dt_us: u32) -> RotorState {
        let RotorConfig { rate, acceleration, .. } = *schedule.config();
        let ramp = rate / acceleration;
        let now = match &mut self.entry {
            Some((from, way, since_us)) if seconds(*since_us) < ramp => {
                let t = seconds(*since_us);
                *since_us += dt_us;
                RotorState {
                    angle: *from + *way * 0.5 * acceleration * t * t,
                    rate: *way * acceleration * t,
                    acceleration: *way * acceleration,
                }
            }
            _ => {
                self.entry = None;
                schedule.at(seconds(self.t_us))
            }
        };
        self.t_us += dt_us;
        let period = period_us(schedule);
        if self.t_us >= period {
            self.t_us -= period;
        }
        now
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const DEG: f32 = 0.017_453_292;

    /// Checks that each set-point follows from the one before within the acceleration, and returns the last.
    fn smooth(mut next: impl FnMut() -> Option<RotorState>, acceleration: f32) -> RotorState {
        let mut last = next().unwrap();
        // Near the end of the period a time in f32 is good to 4 µs.
        while let Some(now) = next() {
            assert!(
                (now.rate - last.rate).abs() <= acceleration * 1e-3 + 4e-5,
                "{last:?} {now:?}"
            );
            let mean = 0.5 * (now.rate + last.rate) * 1e-3;
            // Corners of the acceleration within a tick, and rounding.
            assert!((now.angle - last.angle - mean).abs() < 3e-6, "{last:?} {now:?}");
            last = now;
        }
        last
    }

    #[test]
    fn moves_arrive_at_rest() {
        let a = 200.0 * DEG;
        for (from, to) in [(0.0, 3.0), (3.0, -0.1), (1.0, 1.0004), (2.0, 1.9)] {
            let mut m = Move::new(from, to, 20.0 * DEG, a);
            let end = smooth(|| m.step(1000), a);
            assert!((end.angle - to).abs() < 2e-5, "{from} {to} {end:?}");
            assert!(end.rate.abs() < 1.1e-3 * a);
        }
        assert_eq!(Move::new(1.0, 1.0, 1.0, 1.0).step(1000), None);
    }

    #[test]
    fn enters_the_schedule_from_any_angle() {
        let schedule = Schedule::<f32>::new(RotorConfig::default()).unwrap();
        let a = schedule.config().acceleration;
        for k in 0..=72 {
            let from = 5.0 * DEG * k as f32;
            let mut cycle = Cycle::enter(from, &schedule);
            let first = cycle.step(&schedule, 1000);
            assert_eq!((first.angle, first.rate), (from, 0.0));
            let mut left = 40_000;
            smooth(
                || {
                    left -= 1;
                    let s = cycle.step(&schedule, 1000);
                    assert!((-1e-5..=360.0 * DEG + 1e-5).contains(&s.angle), "{from} {s:?}");
                    (left > 0).then_some(s)
                },
                a,
            );
            assert!(cycle.entry.is_none());
        }
    }

    #[test]
    fn ramps_stop() {
        let mut ramp = Ramp {
            angle: 1.0,
            rate: -0.35,
        };
        for _ in 0..200 {
            ramp.step(0.0, 3.5, 1e-3);
        }
        assert_eq!(ramp.rate, 0.0);
        assert!((ramp.angle - (1.0 - 0.0175)).abs() < 1e-5);
    }
}
