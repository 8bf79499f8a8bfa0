//! Rotor schedule: continuous reciprocating rotation about z with limited acceleration.
//!
//! \[Xing18\] §3.2 chooses one axis (z), reciprocation (a scale-factor error cancels over a cycle) and
//! no stops. One cycle, from rest at angle 0:
//!
//! ```text
//! rate  +ω ┤ ╭────────────╮
//!        0 ┼─╯            ╰╮            ╭─ …
//!       −ω ┤               ╰────────────╯
//!          0 ta         leg            2 leg        ta = ω/a,  leg = travel/ω + ω/a
//! ```
//!
//! The whole turn-around is one stretch of constant acceleration, −a at the top and +a at the bottom,
//! so that it takes 2ω/a (0.2 s at 20 °/s and 200 °/s²).
//!
//! Not modelled: limited jerk. The rate loop of the motor smooths the corners.

use frames::{Real, units};

/// What the rotor is asked to do.
///
/// | field | unit | zero means | sane value |
/// |---|---|---|---|
/// | `rate` | rad/s | the rotor stands still | 20 °/s |
/// | `travel` | rad | refused, unless the rate is zero | 360° |
/// | `acceleration` | rad/s² | refused, unless the rate is zero | 200 °/s² |
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RotorConfig<T: Real = f32> {
    /// Rate in the legs, rad/s.
    pub rate: T,
    /// Angle from one turning point to the other, rad.
    pub travel: T,
    /// Acceleration at the turning points, rad/s².
    pub acceleration: T,
}

impl<T: Real> Default for RotorConfig<T> {
    /// \[Xing18\] §3.2: ±20 °/s over one full turn; reversals at 200 °/s².
    fn default() -> Self {
        Self {
            rate: T::lit(20.0 * units::DEG),
            travel: T::lit(360.0 * units::DEG),
            acceleration: T::lit(200.0 * units::DEG),
        }
    }
}

/// Why a schedule cannot be run.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum RotorError {
    /// A figure is negative or not finite, or travel or acceleration is zero while the rate is not.
    NotPositive,
    /// The travel is shorter than the two ramps: lower the rate, or raise travel or acceleration.
    TravelTooShort,
}

impl core::fmt::Display for RotorError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.write_str(match self {
            Self::NotPositive => "rotor rate, travel and acceleration must be positive and finite",
            Self::TravelTooShort => {
                "rotor travel is shorter than its two ramps: lower the rate, or raise travel or acceleration"
            }
        })
    }
}

impl core::error::Error for RotorError {}

/// Where the rotor is and how it moves.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RotorState<T: Real = f32> {
    /// Angle α from b to s, rad, in [0, travel].
    pub angle: T,
    /// Its rate, rad/s.
    pub rate: T,
    /// Its acceleration, rad/s².
    pub acceleration: T,
}

/// A checked schedule.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Schedule<T: Real = f32> {
    config: RotorConfig<T>,
    ramp: T,
    leg: T,
}

impl<T: Real> Schedule<T> {
    /// Checks the figures.
    ///
    /// # Errors
    /// [`RotorError`] where the motion is impossible.
    pub fn new(config: RotorConfig<T>) -> Result<Self, RotorError> {
        let RotorConfig {
            rate,
            travel,
            acceleration,
        } = config;
        let zero = T::zero();
        if rate == zero {
            return Ok(Self {
                config,
                ramp: zero,
                leg: zero,
            });
        }
        let positive = |x: T| x.finite() && x > zero;
        if !(positive(rate) && positive(travel) && positive(acceleration)) {
            return Err(RotorError::NotPositive);
        }
        let ramp = rate / acceleration;
        if travel < rate * ramp {
            return Err(RotorError::TravelTooShort);
        }
        Ok(Self {
            config,
            ramp,
            leg: travel / rate + ramp,
        })
    }

    /// The figures the schedule was made from.
    pub fn config(&self) -> &RotorConfig<T> {
        &self.config
    }

    /// Time of one full cycle, there and back, s. Zero for a rotor that stands still.
    pub fn period(&self) -> T {
        self.leg + self.leg
    }

    /// The motion at time `t` ≥ 0 from the start, s.
    ///
    /// In f32 a time of hours has lost its milliseconds: reduce it by [`Schedule::period`] first.
    pub fn at(&self, t: T) -> RotorState<T> {
        let zero = T::zero();
        let RotorConfig {
            rate,
            travel,
            acceleration,
        } = self.config;
        if rate == zero {
            return RotorState {
                angle: zero,
                rate: zero,
                acceleration: zero,
            };
        }
        let in_cycle = t % self.period();
        let back = in_cycle >= self.leg;
        let t = if back { in_cycle - self.leg } else { in_cycle };
        let half = T::lit(0.5);
        let up = if t < self.ramp {
            RotorState {
                angle: half * acceleration * t * t,
                rate: acceleration * t,
                acceleration,
            }
        } else if t > self.leg - self.ramp {
            let left = self.leg - t;
            RotorState {
                angle: travel - half * acceleration * left * left,
                rate: acceleration * left,
                acceleration: -acceleration,
            }
        } else {
            RotorState {
                angle: rate * (t - half * self.ramp),
                rate,
                acceleration: zero,
            }
        };
        if back {
            RotorState {
                angle: travel - up.angle,
                rate: -up.rate,
                acceleration: -up.acceleration,
            }
        } else {
            up
        }
    }

    /// The next instant after `t` at which the acceleration jumps, s; `None` for a rotor that stands still.
    ///
    /// Whoever integrates along the motion splits the interval there.
    pub fn next_corner(&self, t: T) -> Option<T> {
        if self.config.rate == T::zero() {
            return None;
        }
        let in_leg = t % self.leg;
        let start = t - in_leg;
        // Corners closer than rounding are passed already.
        let after = in_leg + self.leg * T::lit(1e-12).max(T::default_epsilon());
        [self.ramp, self.leg - self.ramp, self.leg, self.leg + self.ramp]
            .into_iter()
            .find(|corner| *corner > after)
            .map(|corner| start + corner)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn schedule(rate_dps: f64, travel_deg: f64, acceleration_dps2: f64) -> Result<Schedule<f64>, RotorError> {
        Schedule::new(RotorConfig {
            rate: rate_dps * units::DEG,
            travel: travel_deg * units::DEG,
            acceleration: acceleration_dps2 * units::DEG,
        })
    }

    #[test]
    fn default_cycle() {
        let s = Schedule::<f64>::new(RotorConfig::default()).unwrap();
        assert!((s.period() - 36.2).abs() < 1e-12);
        let deg = |t: f64| s.at(t).angle / units::DEG;
        assert!((deg(0.01) - 0.01).abs() < 1e-12);
        assert!((deg(1.05) - 20.0).abs() < 1e-12);
        assert!((deg(18.1) - 360.0).abs() < 1e-9);
        assert!((deg(18.1 + 1.05) - 340.0).abs() < 1e-9);
        assert!(deg(36.2 - 1e-9).abs() < 1e-9);
        assert!((s.at(36.2 * 7.0 + 5.0).rate / units::DEG - 20.0).abs() < 1e-9);
        assert!((s.at(18.1 * 3.0 + 5.0).rate / units::DEG + 20.0).abs() < 1e-9);
    }

    #[test]
    fn rate_and_acceleration_are_the_derivatives() {
        let s = schedule(37.0, 190.0, 150.0).unwrap();
        let h = 1e-5;
        for k in 0..2000 {
            let t = 0.003 + f64::from(k) * 0.0117;
            let corner = s.next_corner(t - 2.0 * h).unwrap();
            if corner < t + 2.0 * h {
                continue;
            }
            let (m, c, p) = (s.at(t - h), s.at(t), s.at(t + h));
            assert!(((p.angle - m.angle) / (2.0 * h) - c.rate).abs() < 1e-8);
            assert!(((p.rate - m.rate) / (2.0 * h) - c.acceleration).abs() < 1e-8);
            assert!((0.0..=s.config().travel).contains(&c.angle));
        }
    }

    #[test]
    fn corners_in_order() {
        let s = Schedule::<f64>::new(RotorConfig::default()).unwrap();
        let mut t = 0.0;
        for expected in [0.1, 18.0, 18.1, 18.2, 36.1, 36.2, 36.3] {
            t = s.next_corner(t).unwrap();
            assert!((t - expected).abs() < 1e-9, "{t} {expected}");
        }
    }

    #[test]
    fn impossible_schedules_are_refused() {
        assert_eq!(schedule(20.0, 1.0, 200.0), Err(RotorError::TravelTooShort));
        assert_eq!(schedule(-20.0, 360.0, 200.0), Err(RotorError::NotPositive));
        assert_eq!(schedule(20.0, 0.0, 200.0), Err(RotorError::NotPositive));
        assert_eq!(schedule(20.0, f64::NAN, 200.0), Err(RotorError::NotPositive));
        assert_eq!(schedule(0.0, 0.0, 0.0).unwrap().at(12.0).angle, 0.0);
    }
}
