//! The rotor's motion in a scenario: the unit's own schedule, or legs of a study.
//!
//! A leg goes from one turning point to the next: evenly accelerated to its rate, at its rate, evenly decelerated to rest,
//! then a dwell. Legs follow each other in a cycle. With a spread each leg of the run has a rate of its own, drawn from the
//! seed.
//!
//! Only the core alone is simulated with legs: a unit's motor follows the schedule of [`nav::rotor`].

use frames::units::DEG;
use nav::rotor::{RotorError, RotorState, Schedule};
use rand::RngExt;

use crate::config::Violation;
use crate::scenario::{Leg, Scenario};
use crate::sensors::{Stream, stream};

/// How the rotor moves.
#[derive(Debug, Clone)]
pub enum Rotation {
    /// As a unit drives it.
    Schedule(Schedule<f64>),
    /// By legs.
    Legs(Stretches),
}

/// Stretches of even acceleration, over and over.
#[derive(Debug, Clone)]
pub struct Stretches {
    /// Start, s, and the motion there; in order of time.
    starts: Vec<(f64, RotorState<f64>)>,
    /// All of them together, s.
    length: f64,
    /// A cycle of the legs without spread, s.
    cycle: f64,
    /// Longest leg, rad.
    travel: f64,
    /// Fastest leg, rad/s.
    fastest: f64,
}

impl Rotation {
    /// The motion of a scenario's rotor with the rates that the seed gives.
    ///
    /// # Errors
    /// [`Violation`] where a leg is impossible.
    pub fn new(scenario: &Scenario, seed: u64) -> Result<Self, Violation> {
        let rotor = &scenario.rotor;
        if rotor.rate_dps == 0.0 || !rotor.has_legs() {
            let schedule = scenario.schedule().map_err(|e| impossible("rotor", e))?;
            return Ok(Self::Schedule(schedule));
        }
        let there_and_back = [rotor.travel_deg, 0.0].map(|to_deg| Leg {
            to_deg,
            ..Leg::default()
        });
        let legs = if rotor.legs.is_empty() {
            &there_and_back[..]
        } else {
            &rotor.legs
        };
        if legs.last().is_some_and(|leg| leg.to_deg != 0.0) {
            return Err(Violation {
                key: format!("rotor.legs[{}].to_deg", legs.len() - 1),
                problem: "the last leg must end where the first begins, at 0".to_owned(),
            });
        }
        let mut rng = stream(seed, Stream::Rotor);
        let mut made = Stretches {
            starts: Vec::new(),
            length: 0.0,
            cycle: 0.0,
            travel: 0.0,
            fastest: 0.0,
        };
        let acceleration = rotor.acceleration_dps2 * DEG;
        // One cycle is enough where each is like the first.
        while made.starts.is_empty() || (rotor.rate_spread > 0.0 && made.length < scenario.run.duration_s) {
            let mut from = 0.0;
            let first = made.starts.is_empty();
            for (k, leg) in legs.iter().enumerate() {
                let rate = leg.rate_dps.unwrap_or(rotor.rate_dps) * DEG;
                let way = leg.to_deg * DEG - from;
                let fastest = rate * (1.0 + rotor.rate_spread);
                if fastest * fastest > way.abs() * acceleration {
                    let key = if rotor.legs.is_empty() {
                        "rotor".to_owned()
                    } else {
                        format!("rotor.legs[{k}]")
                    };
                    return Err(impossible(&key, RotorError::TravelTooShort));
                }
                if first {
                    made.cycle += way.abs() / rate + rate / acceleration + leg.dwell_s;
                    made.travel = made.travel.max(way.abs());
                    made.fastest = made.fastest.max(fastest);
                }
                let drawn: f64 = rng.random_range(-1.0..=1.0);
                made.leg(from, way, rate * (1.0 + rotor.rate_spread * drawn), acceleration);
                if leg.dwell_s > 0.0 {
                    made.push(leg.to_deg * DEG, 0.0, 0.0, leg.dwell_s);
                }
                from = leg.to_deg * DEG;
            }
        }
        Ok(Self::Legs(made))
    }

    /// The motion at `t` ≥ 0, s.
    pub fn at(&self, t: f64) -> RotorState<f64> {
        match self {
            Self::Schedule(schedule) => schedule.at(t),
            Self::Legs(legs) => legs.at(t),
        }
    }

    /// The next instant after `t` at which the acceleration jumps, s; `None` for a rotor that stands still.
    pub fn next_corner(&self, t: f64) -> Option<f64> {
        match self {
            Self::Schedule(schedule) => schedule.next_corner(t),
            Self::Legs(legs) => Some(legs.next_corner(t)),
        }
    }

    /// Time of a cycle, s; of one without spread where legs have one. Zero for a rotor that stands still.
    pub fn period(&self) -> f64 {
        match self {
            Self::Schedule(schedule) => schedule.period(),
            Self::Legs(legs) => legs.cycle,
        }
    }

    /// Longest way between two turning points, rad.
    pub fn travel(&self) -> f64 {
        match self {
            Self::Schedule(schedule) => schedule.config().travel,
            Self::Legs(legs) => legs.travel,
        }
    }

    /// Highest rate that there may be, rad/s.
    pub fn fastest(&self) -> f64 {
        match self {
            Self::Schedule(schedule) => schedule.config().rate,
            Self::Legs(legs) => legs.fastest,
        }
    }
}

fn impossible(key: &str, error: RotorError) -> Violation {
    Violation {
        key: key.to_owned(),
        problem: error.to_string(),
    }
}

impl Stretches {
    fn push(&mut self, angle: f64, rate: f64, acceleration: f64, length: f64) {
        let state = RotorState {
            angle,
            rate,
            acceleration,
        };
        self.starts.push((self.length, state));
        self.length += length;
    }

    /// From rest to rest.
    fn leg(&mut self, from: f64, way: f64, rate: f64, acceleration: f64) {
        let ramp = rate / acceleration;
        let (rate, acceleration) = (rate.copysign(way), acceleration.copysign(way));
        let ramped = 0.5 * rate * ramp;
        self.push(from, 0.0, acceleration, ramp);
        self.push(from + ramped, rate, 0.0, way / rate - ramp);
        self.push(from + way - ramped, rate, -acceleration, ramp);
    }

    fn at(&self, t: f64) -> RotorState<f64> {
        let t = t % self.length;
        let after = self.starts.partition_point(|(start, _)| *start <= t);
        let (start, state) = self.starts[after.saturating_sub(1)];
        let dt = t - start;
        RotorState {
            angle: state.angle + (state.rate + 0.5 * state.acceleration * dt) * dt,
            rate: state.rate + state.acceleration * dt,
            acceleration: state.acceleration,
        }
    }

    fn next_corner(&self, t: f64) -> f64 {
        let within = t % self.length;
        // Corners closer than rounding are passed already.
        let passed = within + 1e-12 * self.length;
        let in_cycle = |from: f64| {
            let next = self.starts.partition_point(|(start, _)| *start <= from);
            self.starts.get(next).map(|(start, _)| *start)
        };
        let corner = match in_cycle(passed) {
            Some(corner) => corner,
            None if passed < self.length => self.length,
            // At the end already, but for rounding: the first corner of the next cycle, not this end again.
            None => self.length + in_cycle(0.0).unwrap_or(self.length),
        };
        t - within + corner
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn rotation(rotor: &str, seed: u64) -> Rotation {
        let scenario = Scenario::parse(&format!("[rotor]\n{rotor}"), "s.toml").unwrap();
        Rotation::new(&scenario, seed).unwrap()
    }

    #[test]
    fn legs_there_and_back_are_the_schedule() {
        let (schedule, legs) = (
            rotation("", 1),
            rotation("legs = [{ to_deg = 360 }, { to_deg = 0 }]", 1),
        );
        assert!((schedule.period() - legs.period()).abs() < 1e-12);
        assert!((schedule.travel() - legs.travel()).abs() < 1e-12);
        assert!((schedule.fastest() - legs.fastest()).abs() < 1e-12);
        for k in 0..3000 {
            let t = 0.003 + f64::from(k) * 0.05;
            let (a, b) = (schedule.at(t), legs.at(t));
            assert!(
                (a.angle - b.angle).abs() < 1e-11 && (a.rate - b.rate).abs() < 1e-11,
                "{t}"
            );
        }
    }

    #[test]
    fn rate_and_acceleration_are_the_derivatives_and_corners_are_where_they_jump() {
        let text = "legs = [{ to_deg = 360, rate_dps = 30, dwell_s = 2 }, { to_deg = 90 }, { to_deg = 270 }, { to_deg = 0 }]\n\
                    rate_spread = 0.2";
        let (h, rotation) = (1e-5, rotation(text, 3));
        let mut corners = 0;
        for k in 0..9000 {
            let t = 0.003 + f64::from(k) * 0.03;
            if rotation.next_corner(t - 2.0 * h).unwrap() < t + 2.0 * h {
                corners += 1;
                continue;
            }
            let (m, c, p) = (rotation.at(t - h), rotation.at(t), rotation.at(t + h));
            assert!(((p.angle - m.angle) / (2.0 * h) - c.rate).abs() < 1e-8, "{t}");
            assert!(((p.rate - m.rate) / (2.0 * h) - c.acceleration).abs() < 1e-8, "{t}");
            assert!((-1e-9..=360.0 * DEG + 1e-9).contains(&c.angle));
            assert!(c.rate.abs() <= rotation.fastest());
        }
        assert!(corners < 20, "{corners}");
        // 2 s at rest at the top, after 12 s of way and 0.15 s of ramps at the rate as told.
        let top = (0..2000).filter(|k| rotation.at(f64::from(*k) * 0.01).angle > 359.999 * DEG);
        assert!((195..=210).contains(&top.count()));
    }

    #[test]
    fn corners_go_on_over_many_cycles() {
        for text in [
            "legs = [{ to_deg = 360 }, { to_deg = -360 }, { to_deg = 0 }]",
            "rate_spread = 0.25",
        ] {
            let (rotation, mut t) = (rotation(text, 1), 0.0);
            for _ in 0..2000 {
                let next = rotation.next_corner(t).unwrap();
                assert!(next > t + 1e-3, "{text}: {next} after {t}");
                t = next;
            }
        }
    }

    #[test]
    fn rates_are_spread_by_the_seed() {
        let text = "rate_spread = 0.25";
        let (a, b, c) = (rotation(text, 1), rotation(text, 1), rotation(text, 2));
        assert_eq!(a.at(200.0), b.at(200.0));
        assert_ne!(a.at(200.0), c.at(200.0));
        let rates: Vec<f64> = (0..3000)
            .map(|k| rotation(text, k).at(1.0).rate / (20.0 * DEG) - 1.0)
            .collect();
        let n = rates.len() as f64;
        let mean = rates.iter().sum::<f64>() / n;
        let square = rates.iter().map(|x| x * x).sum::<f64>() / n;
        // Even in ±0.25: the variance is 0.25²/3.
        assert!(mean.abs() < 5.0 * 0.1443 / n.sqrt(), "{mean}");
        assert!((square / 0.020_833 - 1.0).abs() < 5.0 * (0.8 / n).sqrt(), "{square}");
    }

    #[test]
    fn impossible_legs_are_refused() {
        let message = |text: &str| {
            Scenario::parse(&format!("[rotor]\n{text}"), "s.toml")
                .unwrap_err()
                .to_string()
        };
        assert_eq!(
            message("legs = [{ to_deg = 90 }]"),
            "s.toml:2: rotor.legs[0].to_deg: the last leg must end where the first begins, at 0"
        );
        let short = "rotor travel is shorter than its two ramps: lower the rate, or raise travel or acceleration";
        assert_eq!(
            message("legs = [{ to_deg = 1 }, { to_deg = 0 }]"),
            format!("s.toml:2: rotor.legs[0]: {short}")
        );
        assert_eq!(
            message("travel_deg = 2.5\nrate_spread = 0.5"),
            format!("s.toml:1: rotor: {short}")
        );
    }
}
