//! Angle and rate of the shaft from the encoder.
//!
//! An extended-state observer: angle, rate, and the acceleration `d` that the model of the motor does not explain.
//!
//! ```text
//! α⁻ = α + ω T + (u + d) T²/2     ω⁻ = ω + (u + d) T                 u: acceleration put in by the controller
//! e  = wrap(reading − zero − α⁻)
//! α  = α⁻ + g e    ω = ω⁻ + (h/T) e    d += (k/T²) e
//! z = e^(−pT)      g = 1 − z³    h = 3/2 (1 − z)² (1 + z)    k = (1 − z)³
//! ```
//!
//! All three poles are at p. The turn follows from the prediction: the angle is the candidate nearest to it, so it is
//! right while the rotor moves less than half a turn between two readings.
//!
//! A reading that is far from its prediction, and one that repeats to the last bit while the rotor turns, is a bad
//! reading: the observer runs on its model for a tick and takes no notice.
//!
//! # Sources
//!
//! Fading-memory g-h-k filter: Brookner, *Tracking and Kalman Filtering Made Easy*, Wiley 1998, §1.3; extended-state
//! observer: Gao, *Proc. American Control Conference* 2003.

use core::f32::consts::TAU;

use frames::math;

/// Rate above which a healthy encoder does not repeat itself, rad/s (5 °/s, 29 counts of the MT6835 in 1 ms).
pub(super) const SLOW: f32 = 0.0873;
/// Repetitions that make a frozen encoder while the rotor ought to turn, s.
const FROZEN: f32 = 0.02;

/// What became of the encoder.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Sense {
    Good,
    /// Not this one; the prediction stands in.
    Bad,
    /// Too many: the angle, and with it the turn, is unknown.
    Lost {
        frozen: bool,
    },
}

#[derive(Debug, Clone)]
pub(super) struct Shaft {
    /// Unwrapped angle from the configured zero, rad.
    pub(super) angle: f32,
    pub(super) rate: f32,
    /// Acceleration that the model does not explain, rad/s².
    pub(super) disturbance: f32,
    zero: f32,
    dt: f32,
    /// Firm and quiet.
    gains: [[f32; 3]; 2],
    /// Which of the two is in force.
    pub(super) quiet: bool,
    jump: f32,
    bad_limit: u8,
    same_limit: u16,
    known: bool,
    bad: u8,
    same: u16,
    last: f32,
}

impl Shaft {
    /// `poles`: firm and quiet, rad/s.
    pub(super) fn new(zero: f32, dt: f32, poles: [f32; 2], jump: f32, bad_limit: u8) -> Self {
        let gains = poles.map(|pole| {
            let z = exp_minus(pole * dt);
            let y = 1.0 - z;
            [1.0 - z * z * z, 1.5 * y * y * (1.0 + z) / dt, y * y * y / (dt * dt)]
        });
        Self {
            angle: 0.0,
            rate: 0.0,
            disturbance: 0.0,
            zero,
            dt,
            gains,
            quiet: false,
            jump,
            bad_limit,
            same_limit: (FROZEN / dt + 0.5) as u16,
            known: false,
            bad: 0,
            same: 0,
            last: f32::NAN,
        }
    }

    /// Whether there is an angle.
    pub(super) fn known(&self) -> bool {
        self.known
    }

    /// Angle of the shaft as the encoder has it, rad, not wrapped.
    pub(super) fn shaft(&self) -> f32 {
        self.angle + self.zero
    }

    /// Takes the reading of this tick. `acceleration` is what the controller put in since the last one; `moving`
    /// says that the rotor ought to turn faster than [`SLOW`].
    pub(super) fn sense(&mut self, reading: Option<f32>, acceleration: f32, moving: bool) -> Sense {
        let reading = reading.filter(|r| (0.0..TAU).contains(r));
        if !self.known {
            return match reading {
                Some(r) => {
                    self.angle = math::wrap_two_pi(r - self.zero);
                    (self.rate, self.disturbance) = (0.0, 0.0);
                    (self.known, self.bad, self.same, self.last) = (true, 0, 0, r);
                    Sense::Good
                }
                None => Sense::Bad,
            };
        }
        let total = acceleration + self.disturbance;
        self.angle += (self.rate + 0.5 * total * self.dt) * self.dt;
        self.rate += total * self.dt;
        let mut good = None;
        if let Some(r) = reading {
            let repeated = moving && r == self.last;
            self.last = r;
            self.same = if repeated { self.same + 1 } else { 0 };
            let off = math::wrap_pi(r - self.zero - self.angle);
            good = (off.abs() <= self.jump && !(repeated && self.rate.abs() > SLOW)).then_some(off);
        }
        if let Some(off) = good {
            let [g, h, k] = self.gains[usize::from(self.quiet)];
            self.angle += g * off;
            self.rate += h * off;
            self.disturbance += k * off;
            self.bad = 0;
        } else {
            self.bad = self.bad.saturating_add(1);
        }
        if self.bad >= self.bad_limit || self.same >= self.same_limit {
            self.known = false;
            return Sense::Lost { frozen: self.same > 0 };
        }
        if good.is_some() { Sense::Good } else { Sense::Bad }
    }

    /// Renames the angle by whole turns.
    pub(super) fn turn(&mut self, turns: f32) {
        self.angle += turns * TAU;
    }
}

/// e^(−x) for 0 ≤ x ≤ 4 from its series, once at start-up: not worth a function in the door to maths.
fn exp_minus(x: f32) -> f32 {
    let y = x / 16.0;
    let mut e = 1.0 - y * (1.0 - y / 2.0 * (1.0 - y / 3.0 * (1.0 - y / 4.0)));
    for _ in 0..4 {
        e *= e;
    }
    e
}

#[cfg(test)]
mod tests {
    use super::*;

    fn shaft() -> Shaft {
        Shaft::new(1.0, 1e-3, [400.0, 200.0], 0.01, 3)
    }

    fn wrapped(angle: f32) -> Option<f32> {
        Some(math::wrap_two_pi(angle + 1.0))
    }

    #[test]
    fn exponential() {
        for (x, e) in [
            (0.0, 1.0),
            (0.4, 0.670_320_05),
            (1.0, 0.367_879_44),
            (4.0, 0.018_315_64),
        ] {
            assert!((exp_minus(x) - e).abs() < 2e-5, "{x}");
        }
    }

    #[test]
    fn follows_through_turns_without_lag() {
        let mut s = shaft();
        let rate = 3.0;
        for k in 0..10_000 {
            let angle = 0.5 + rate * 1e-3 * k as f32;
            assert_eq!(s.sense(wrapped(angle), 0.0, true), Sense::Good, "{k}");
            if k > 100 {
                assert!((s.angle - angle).abs() < 2e-5, "{k}: {} {angle}", s.angle);
                assert!((s.rate - rate).abs() < 0.02);
            }
        }
        assert!(s.angle > 4.0 * TAU);
    }

    #[test]
    fn the_disturbance_is_what_the_model_leaves() {
        let mut s = shaft();
        // 5 rad/s² really, 3 of them from the motor.
        for k in 0..300 {
            let t = 1e-3 * k as f32;
            s.sense(wrapped(2.5 * t * t), 3.0, true);
        }
        assert!((s.disturbance - 2.0).abs() < 0.2, "{}", s.disturbance);
    }

    #[test]
    fn bad_readings() {
        let mut s = shaft();
        assert_eq!(s.sense(None, 0.0, false), Sense::Bad);
        assert!(!s.known());
        s.sense(wrapped(1.0), 0.0, false);
        for bad in [None, Some(f32::NAN), Some(-1.0), Some(7.0), wrapped(1.2)] {
            assert_eq!(s.sense(bad, 0.0, false), Sense::Bad);
            assert_eq!(s.sense(wrapped(1.0), 0.0, false), Sense::Good);
        }
        s.sense(None, 0.0, false);
        s.sense(wrapped(2.0), 0.0, false);
        assert_eq!(s.sense(None, 0.0, false), Sense::Lost { frozen: false });
        assert!(!s.known());
    }

    #[test]
    fn a_frozen_encoder_is_found_while_turning() {
        let mut s = shaft();
        for k in 0..500 {
            s.sense(wrapped(0.35e-3 * k as f32), 0.0, true);
        }
        let frozen = wrapped(0.35e-3 * 499.0);
        assert_eq!(s.sense(frozen, 0.0, true), Sense::Bad);
        assert_eq!(s.sense(frozen, 0.0, true), Sense::Bad);
        assert_eq!(s.sense(frozen, 0.0, true), Sense::Lost { frozen: true });
        // At rest a repeated reading is no fault, until the rotor ought to turn.
        let mut s = shaft();
        for _ in 0..100 {
            assert_eq!(s.sense(wrapped(1.0), 0.0, false), Sense::Good);
        }
        let lost = (0..100).position(|_| s.sense(wrapped(1.0), 0.0, true) != Sense::Good);
        assert_eq!(lost, Some(19));
    }
}
