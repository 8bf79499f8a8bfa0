use nalgebra::Matrix3;

use crate::{Body, Nav, Real, Rot, Vec3, math};

/// The attitude of the housing as people read it, radians.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Attitude<T: Real = f32> {
    /// Clockwise from true north, [0, 2π).
    pub heading: T,
    /// Front up is positive, [−π/2, π/2].
    pub pitch: T,
    /// Right side down is positive, (−π, π].
    pub roll: T,
}

/// One standard deviation of each angle of an [`Attitude`], radians.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct AttitudeSd<T: Real = f32> {
    /// 1σ of heading.
    pub heading: T,
    /// 1σ of pitch.
    pub pitch: T,
    /// 1σ of roll.
    pub roll: T,
}

impl<T: Real> AttitudeSd<T> {
    /// The spreads that go with a covariance of φ, rad², where `C' = (I − [φ×]) C`.
    pub fn from_phi_covariance(c_nb: &Rot<Nav, Body, T>, p_phi: &Matrix3<T>) -> Self {
        let along = |j: Vec3<Nav, T>| math::sqrt((p_phi * j.vector()).dot(&j.vector()).max(T::zero()));
        let [heading, pitch, roll] = Attitude::jacobian(c_nb).map(along);
        Self { heading, pitch, roll }
    }
}

impl<T: Real> Attitude<T> {
    /// The angles of `C_b^n = Rz(−heading) Rx(pitch) Ry(roll)`.
    pub fn from_rot(c_nb: &Rot<Nav, Body, T>) -> Self {
        let m = c_nb.matrix();
        Self {
            heading: math::wrap_two_pi(math::atan2(m[(0, 1)], m[(1, 1)])),
            pitch: math::atan2(m[(2, 1)], math::hypot(m[(0, 1)], m[(1, 1)])),
            roll: math::atan2(-m[(2, 0)], m[(2, 2)]),
        }
    }

    /// The rotation these angles describe.
    pub fn to_rot(&self) -> Rot<Nav, Body, T> {
        Rot::from_yaw_pitch_roll(-self.heading, self.pitch, self.roll)
    }

    /// How the angles move with a small rotation of the navigation frame.
    ///
    /// With `C' = (I − [φ×]) C`, the first-order changes of (heading, pitch, roll) are the inner
    /// products of φ with the three vectors returned. Undefined with the front straight up or down,
    /// where heading itself is.
    pub fn jacobian(c_nb: &Rot<Nav, Body, T>) -> [Vec3<Nav, T>; 3] {
        let m = c_nb.matrix();
        let zero = T::zero();
        // u is the front axis in n; δu = u × φ.
        let (a, b, c) = (m[(0, 1)], m[(1, 1)], m[(2, 1)]);
        let level2 = a * a + b * b;
        let level = math::sqrt(level2);
        // The third row r of C moves by δr = φ_N·(row E) − φ_E·(row N).
        let (r0, r2) = (m[(2, 0)], m[(2, 2)]);
        let d = r0 * r0 + r2 * r2;
        let roll_of = |row: usize| (r0 * m[(row, 2)] - r2 * m[(row, 0)]) / d;
        [
            Vec3::new(-c * a / level2, -c * b / level2, T::one()),
            Vec3::new(-b / level, a / level, zero),
            Vec3::new(-roll_of(1), roll_of(0), zero),
        ]
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    proptest! {
        #[test]
        fn angles_round_trip(heading in 0.0..6.25_f64, pitch in -1.5..1.5_f64, roll in -3.1..3.1_f64) {
            let a = Attitude::from_rot(&Attitude { heading, pitch, roll }.to_rot());
            prop_assert!((a.heading - heading).abs() < 1e-12);
            prop_assert!((a.pitch - pitch).abs() < 1e-12);
            prop_assert!((a.roll - roll).abs() < 1e-12);
        }

        #[test]
        fn jacobian_is_the_finite_difference(
            heading in 0.1..6.1_f64, pitch in -1.2..1.2_f64, roll in -3.0..3.0_f64, axis in 0..3_usize,
        ) {
            let c_nb = Attitude { heading, pitch, roll }.to_rot();
            let step = 1e-6;
            let mut phi = [0.0; 3];
            phi[axis] = step;
            // C' = exp(−φ) C.
            let moved = |s: f64| {
                Attitude::from_rot(&(Rot::exp(Vec3::<Nav, f64>::new(phi[0], phi[1], phi[2]) * -s) * c_nb))
            };
            let (plus, minus) = (moved(1.0), moved(-1.0));
            let j = Attitude::jacobian(&c_nb);
            for (row, (p, m)) in [(plus.heading, minus.heading), (plus.pitch, minus.pitch), (plus.roll, minus.roll)]
                .into_iter()
                .enumerate()
            {
                let difference = (p - m) / (2.0 * step);
                let expected = j[row].to_array()[axis];
                prop_assert!((difference - expected).abs() < 1e-6, "row {row} axis {axis}: {difference} {expected}");
            }
        }
    }
}
