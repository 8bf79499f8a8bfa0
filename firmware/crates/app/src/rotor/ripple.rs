//! What the motor's torque owes to position and direction, learned while it runs.
//!
//! The motion repeats, and so does what disturbs it: cogging and ripple of the torque with the angle, friction with the
//! direction. What the feedback had to add at an angle is put into a table and given in advance the next time
//! (feedback-error learning, a repetitive control indexed by position):
//!
//! ```text
//! T_known(θ, ω) = table(θ) + T_c sat(ω/ω_s) + b ω
//! table(θ) += η w u        T_c += γ sgn ω u dt        u: torque the feedback asked for at θ
//! ```
//!
//! With the feedback's complementary sensitivity T(jω), u is T times what is still unknown, so a pass multiplies it by
//! 1 − ηT: it shrinks while Re T > 0, up to about the bandwidth of the feedback. What is above would grow slowly. So each
//! cell left behind is drawn towards its neighbours by q = η/10 of the second difference, which multiplies order k by
//! 1 − 2q (1 − cos 2πk/1024) in a pass:
//!
//! ```text
//! order          12      84     168     300     512
//! kept, η = 0.5  0.9997  0.987  0.952   0.873   0.800
//! left over      0.1 %   2.6 %  9 %     -       -        (1 − Q)/(1 − Q + η), T = 1
//! ```
//!
//! After four legs η falls as 1/n down to a tenth, so that the encoder's noise is averaged and not copied.
//!
//! # Sources
//!
//! Feedback-error learning: Kawato, Furukawa, Suzuki, *Biol. Cybern.* 57 (1987). Repetitive control in position:
//! Moore, *Iterative Learning Control for Deterministic Systems*, Springer 1993.
//!
//! Not modelled: torque that depends on direction *and* position; the wearing of the brushes of a slip ring.

use core::f32::consts::TAU;

use frames::math;

/// Cells in a turn, 12 in a period of order 84.
pub const CELLS: usize = 1024;

/// Rate at which the friction fed forward has reached its full size, rad/s.
const FRICTION_RATE: f32 = 0.0175;
/// Share of the learning by which a cell is drawn towards its neighbours.
const SMOOTHING: f32 = 0.1;

/// What was learned of one motor. It is a constant of the unit: keep it and give it back after a restart.
#[derive(Debug, Clone, PartialEq)]
pub struct Ripple {
    cells: [f32; CELLS],
    coulomb: f32,
    limit: f32,
    /// The cell written last.
    last: usize,
}

impl Ripple {
    /// Nothing learned yet; the assumed friction, Nm, and the most a cell may hold, Nm.
    pub const fn new(coulomb: f32, limit: f32) -> Self {
        Self {
            cells: [0.0; CELLS],
            coulomb,
            limit,
            last: 0,
        }
    }

    /// Torque learned for each 1/1024 turn of the shaft, Nm.
    pub fn cells(&self) -> &[f32; CELLS] {
        &self.cells
    }

    /// Coulomb friction learned, Nm.
    pub fn coulomb(&self) -> f32 {
        self.coulomb
    }

    /// Takes up what was learned earlier. What is not a number, or too large to be true, is left out.
    pub fn restore(&mut self, cells: &[f32; CELLS], coulomb: f32) {
        for (cell, stored) in self.cells.iter_mut().zip(cells) {
            *cell = if stored.is_finite() {
                math::limit(*stored, -self.limit, self.limit)
            } else {
                0.0
            };
        }
        if coulomb.is_finite() {
            self.coulomb = math::limit(coulomb, 0.0, self.limit);
        }
    }

    /// Torque that depends on position at this angle of the shaft, Nm.
    pub(super) fn at(&self, shaft: f32) -> f32 {
        let (i, j, share) = place(shaft);
        self.cells[i] + share * (self.cells[j] - self.cells[i])
    }

    /// Friction at this rate, without the viscous part, Nm.
    pub(super) fn friction(&self, rate: f32) -> f32 {
        self.coulomb * math::limit(rate * (1.0 / FRICTION_RATE), -1.0, 1.0)
    }

    /// Adds `torque` about this angle of the shaft; `gain` is the share of a pass it is part of.
    pub(super) fn learn(&mut self, shaft: f32, torque: f32, gain: f32) {
        let (i, j, share) = place(shaft);
        if i != self.last {
            let at = self.last;
            let bend = self.cells[(at + CELLS - 1) % CELLS] + self.cells[(at + 1) % CELLS] - 2.0 * self.cells[at];
            self.cells[at] += SMOOTHING * gain * bend;
            self.last = i;
        }
        for (cell, weight) in [(i, 1.0 - share), (j, share)] {
            self.cells[cell] = math::limit(self.cells[cell] + weight * torque, -self.limit, self.limit);
        }
    }

    /// Adds `torque` to the friction.
    pub(super) fn learn_friction(&mut self, torque: f32) {
        self.coulomb = math::limit(self.coulomb + torque, 0.0, self.limit);
    }
}

/// The cells left and right of the angle and the share of the right one.
fn place(shaft: f32) -> (usize, usize, f32) {
    let x = math::wrap_two_pi(shaft) * (CELLS as f32 / TAU);
    let i = x as usize;
    // The angle just below 2π may round to cell 1024.
    (i % CELLS, (i + 1) % CELLS, x - i as f32)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn learns_what_repeats() {
        let mut ripple = Ripple::new(0.0, 1.0);
        let unknown = |shaft: f32| 0.02 * math::sin_cos(84.0 * shaft + 0.3).0 + 0.005;
        // One pass adds half of what is missing; a cell is met CELLS/TAU · step⁻¹ times.
        let step = TAU / 20_000.0;
        for pass in 0..12 {
            let mut worst = 0.0_f32;
            for k in 0..20_000 {
                let shaft = step * k as f32 - 3.0;
                let missing = unknown(shaft) - ripple.at(shaft);
                worst = worst.max(missing.abs());
                ripple.learn(shaft, 0.5 * missing * CELLS as f32 / 20_000.0, 0.5);
            }
            let limit = [0.026, 0.02, 0.013, 0.008][pass.min(3)];
            assert!(worst < limit, "{pass} {worst}");
            if pass == 11 {
                assert!(worst < 1e-3, "{worst}");
            }
        }
    }

    #[test]
    fn continuous_round_the_turn_and_bounded() {
        let mut ripple = Ripple::new(0.0, 0.1);
        ripple.learn(-1e-9, 7.0, 0.5);
        assert_eq!(ripple.at(0.0), 0.1);
        assert!((ripple.at(-1e-4) - ripple.at(1e-4)).abs() < 2e-5);
        assert!((ripple.at(TAU - 1e-6) - ripple.at(1e-6)).abs() < 1e-4);
        ripple.learn_friction(-1.0);
        assert_eq!(ripple.friction(1.0), 0.0);
    }

    #[test]
    fn restores_only_what_can_be_true() {
        let mut stored = [0.01; CELLS];
        (stored[3], stored[4]) = (f32::NAN, 9.0);
        let mut ripple = Ripple::new(0.002, 0.1);
        ripple.restore(&stored, f32::NAN);
        assert_eq!(
            (ripple.cells()[3], ripple.cells()[4], ripple.cells()[5]),
            (0.0, 0.1, 0.01)
        );
        assert_eq!(ripple.coulomb(), 0.002);
    }
}
