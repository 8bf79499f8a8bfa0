use core::marker::PhantomData;
use core::ops::Mul;

use nalgebra::{Matrix3, Quaternion, Vector3};

use crate::{Body, Frame, Nav, Real, Sensor, Vec3, math};

/// The rotation that maps coordinates in `From` to coordinates in `To`.
///
/// Held as a unit quaternion. Products do not renormalise; whoever integrates for hours calls
/// [`Rot::normalized`] or keeps the norm itself.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Rot<To: Frame, From: Frame, T: Real = f32> {
    pub(crate) q: Quaternion<T>,
    frames: PhantomData<(To, From)>,
}

impl<A: Frame, B: Frame, T: Real> Rot<A, B, T> {
    #[inline]
    pub(crate) fn raw(q: Quaternion<T>) -> Self {
        Self { q, frames: PhantomData }
    }

    /// The rotation that leaves coordinates as they are.
    #[inline]
    pub fn identity() -> Self {
        Self::raw(Quaternion::new(T::one(), T::zero(), T::zero(), T::zero()))
    }

    /// From the quaternion `w + xi + yj + zk` of any positive norm.
    ///
    /// `None` where the norm is zero or not finite.
    pub fn from_quaternion(w: T, x: T, y: T, z: T) -> Option<Self> {
        let q = Quaternion::new(w, x, y, z);
        let n2 = q.norm_squared();
        (n2.finite() && n2 > T::zero()).then(|| Self::raw(q / math::sqrt(n2)))
    }

    /// From a proper orthonormal matrix, by Shepperd's choice of the largest quaternion component.
    ///
    /// The matrix is trusted to be orthonormal within rounding; the result is normalised.
    pub fn from_matrix(m: &Matrix3<T>) -> Self {
        let one = T::one();
        let trace = m[(0, 0)] + m[(1, 1)] + m[(2, 2)];
        let (w, x, y, z) = if trace > T::zero() {
            (
                one + trace,
                m[(2, 1)] - m[(1, 2)],
                m[(0, 2)] - m[(2, 0)],
                m[(1, 0)] - m[(0, 1)],
            )
        } else if m[(0, 0)] >= m[(1, 1)] && m[(0, 0)] >= m[(2, 2)] {
            let t = one + m[(0, 0)] - m[(1, 1)] - m[(2, 2)];
            (m[(2, 1)] - m[(1, 2)], t, m[(0, 1)] + m[(1, 0)], m[(0, 2)] + m[(2, 0)])
        } else if m[(1, 1)] >= m[(2, 2)] {
            let t = one - m[(0, 0)] + m[(1, 1)] - m[(2, 2)];
            (m[(0, 2)] - m[(2, 0)], m[(0, 1)] + m[(1, 0)], t, m[(1, 2)] + m[(2, 1)])
        } else {
            let t = one - m[(0, 0)] - m[(1, 1)] + m[(2, 2)];
            (m[(1, 0)] - m[(0, 1)], m[(0, 2)] + m[(2, 0)], m[(1, 2)] + m[(2, 1)], t)
        };
        Self::from_quaternion(w, x, y, z).unwrap_or_else(Self::identity)
    }

    /// The components (w, x, y, z).
    #[inline]
    pub fn quaternion(&self) -> [T; 4] {
        [self.q.w, self.q.i, self.q.j, self.q.k]
    }

    /// The direction cosine matrix, `v_to = matrix * v_from`.
    #[inline]
    pub fn matrix(&self) -> Matrix3<T> {
        let two = T::lit(2.0);
        let (w, x, y, z) = (self.q.w, self.q.i, self.q.j, self.q.k);
        let (x2, y2, z2) = (two * x, two * y, two * z);
        let (xx, yy, zz) = (x * x2, y * y2, z * z2);
        let (xy, xz, yz) = (x * y2, x * z2, y * z2);
        let (wx, wy, wz) = (w * x2, w * y2, w * z2);
        let one = T::one();
        Matrix3::new(
            one - (yy + zz),
            xy - wz,
            xz + wy,
            xy + wz,
            one - (xx + zz),
            yz - wx,
            xz - wy,
            yz + wx,
            one - (xx + yy),
        )
    }

    /// The same rotation seen from the other side.
    #[inline]
    pub fn inverse(self) -> Rot<B, A, T> {
        Rot::raw(self.q.conjugate())
    }

    /// Brought back to unit norm, for a norm that is off by rounding.
    ///
    /// One Newton step of 1/√n about 1: error (3/8)(n² − 1)², below rounding for |n² − 1| < 1e-4.
    #[inline]
    pub fn normalized(self) -> Self {
        let factor = T::lit(1.5) - T::lit(0.5) * self.q.norm_squared();
        Self::raw(self.q * factor)
    }

    /// Declares that `A` and `C` coincide at this instant, as s and ib0 do when alignment starts.
    #[inline]
    pub fn relabel<C: Frame, D: Frame>(self) -> Rot<C, D, T> {
        Rot::raw(self.q)
    }

    /// The same rotation in another precision.
    #[inline]
    pub fn cast<U: Real>(self) -> Rot<A, B, U> {
        Rot::raw(Quaternion::from(self.q.coords.map(|c| U::lit(c.to_f64()))))
    }

    /// The angle of the rotation that leads from `other` to `self`, in [0, π], radians.
    pub fn angle_to(self, other: Self) -> T {
        let d = self.q * other.q.conjugate();
        let v = math::sqrt(d.i * d.i + d.j * d.j + d.k * d.k);
        T::lit(2.0) * math::atan2(v, d.w.abs())
    }
}

impl<A: Frame, T: Real> Rot<A, A, T> {
    /// The rotation by the rotation vector `phi` (radians): from the frame after the turn to the
    /// frame before it.
    ///
    /// Below 0.2 rad by series exact to f64 rounding, above by sine and cosine.
    #[inline]
    pub fn exp(phi: Vec3<A, T>) -> Self {
        let (w_minus_one, v) = exp_minus_one(phi.vector());
        Self::raw(Quaternion::new(T::one() + w_minus_one, v.x, v.y, v.z))
    }

    /// The rotation vector of this rotation, of length in [0, π], radians. Inverse of [`Rot::exp`].
    pub fn log(self) -> Vec3<A, T> {
        // q and −q are the same rotation; the one with w ≥ 0 has the short rotation vector.
        let sign = if self.q.w < T::zero() { -T::one() } else { T::one() };
        let (w, v) = (self.q.w * sign, Vector3::new(self.q.i, self.q.j, self.q.k) * sign);
        let s2 = v.norm_squared();
        let factor = if s2 < T::lit(0.0025) {
            // θ/sin(θ/2) = 2 asin(s)/s in s² = sin²(θ/2), to s⁸.
            let two = T::lit(2.0);
            two + s2
                * (T::lit(1.0 / 3.0)
                    + s2 * (T::lit(3.0 / 20.0) + s2 * (T::lit(5.0 / 56.0) + s2 * T::lit(35.0 / 576.0))))
        } else {
            let s = math::sqrt(s2);
            T::lit(2.0) * math::atan2(s, w) / s
        };
        Vec3::from_vector(v * factor)
    }
}

/// `exp(½φ) − 1` as (scalar part, vector part): the small numbers themselves, so that whoever adds
/// them to a quaternion with compensation loses nothing of a tiny rotation.
#[inline]
pub(crate) fn exp_minus_one<T: Real>(phi: Vector3<T>) -> (T, Vector3<T>) {
    let half = phi * T::lit(0.5);
    let h2 = half.norm_squared();
    if h2 < T::lit(0.01) {
        // sinc and cosine − 1 of the half angle h, in h².
        let sinc = T::one()
            + h2 * (T::lit(-1.0 / 6.0)
                + h2 * (T::lit(1.0 / 120.0) + h2 * (T::lit(-1.0 / 5040.0) + h2 * T::lit(1.0 / 362_880.0))));
        let cos_minus_one =
            h2 * (T::lit(-0.5) + h2 * (T::lit(1.0 / 24.0) + h2 * (T::lit(-1.0 / 720.0) + h2 * T::lit(1.0 / 40_320.0))));
        (cos_minus_one, half * sinc)
    } else {
        let h = math::sqrt(h2);
        let (s, c) = math::sin_cos(h);
        (c - T::one(), half * (s / h))
    }
}

impl<T: Real> Rot<Body, Sensor, T> {
    /// `C_s^b = Rz(α)` for the rotor angle α, radians (\[Xing18\] (1)).
    #[inline]
    pub fn about_z(alpha: T) -> Self {
        let (s, c) = math::sin_cos(alpha * T::lit(0.5));
        Self::raw(Quaternion::new(c, T::zero(), T::zero(), s))
    }
}

impl<T: Real> Rot<Nav, Body, T> {
    /// `C_b^n = Rz(yaw) Rx(pitch) Ry(roll)`, radians, yaw counter-clockwise from north.
    pub fn from_yaw_pitch_roll(yaw: T, pitch: T, roll: T) -> Self {
        let half = T::lit(0.5);
        let zero = T::zero();
        let (sy, cy) = math::sin_cos(yaw * half);
        let (sp, cp) = math::sin_cos(pitch * half);
        let (sr, cr) = math::sin_cos(roll * half);
        let q = Quaternion::new(cy, zero, zero, sy)
            * Quaternion::new(cp, sp, zero, zero)
            * Quaternion::new(cr, zero, sr, zero);
        Self::raw(q)
    }
}

impl<A: Frame, B: Frame, C: Frame, T: Real> Mul<Rot<B, C, T>> for Rot<A, B, T> {
    type Output = Rot<A, C, T>;
    #[inline]
    fn mul(self, other: Rot<B, C, T>) -> Rot<A, C, T> {
        Rot::raw(self.q * other.q)
    }
}

impl<A: Frame, B: Frame, T: Real> Mul<Vec3<B, T>> for Rot<A, B, T> {
    type Output = Vec3<A, T>;
    /// `v + 2 q⃗ × (q⃗ × v + w v)`: 30 operations, and the tiny rotation of a vector keeps its bits.
    #[inline]
    fn mul(self, v: Vec3<B, T>) -> Vec3<A, T> {
        let u = Vector3::new(self.q.i, self.q.j, self.q.k);
        let v = v.vector();
        let t = u.cross(&v) * T::lit(2.0);
        Vec3::from_vector(v + t * self.q.w + u.cross(&t))
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn rot() -> impl Strategy<Value = Rot<Nav, Nav, f64>> {
        [-1.0..1.0, -1.0..1.0, -1.0..1.0_f64].prop_map(|[x, y, z]| Rot::exp(Vec3::new(x, y, z) * 3.0))
    }

    fn vector() -> impl Strategy<Value = Vec3<Nav, f64>> {
        [-10.0..10.0, -10.0..10.0, -10.0..10.0_f64].prop_map(|[x, y, z]| Vec3::new(x, y, z))
    }

    proptest! {
        #[test]
        fn product_is_composition(a in rot(), b in rot(), v in vector()) {
            prop_assert!((((a * b) * v) - (a * (b * v))).norm() < 1e-12);
        }

        #[test]
        fn inverse_undoes(a in rot(), v in vector()) {
            prop_assert!(((a.inverse() * (a * v)) - v).norm() < 1e-12);
        }

        #[test]
        fn rotation_keeps_products(a in rot(), u in vector(), v in vector()) {
            prop_assert!(((a * u).dot(a * v) - u.dot(v)).abs() < 1e-11);
            prop_assert!(((a * u).cross(a * v) - a * u.cross(v)).norm() < 1e-11);
        }

        #[test]
        fn matrix_agrees_with_quaternion(a in rot(), v in vector()) {
            prop_assert!((a.matrix() * v.vector() - (a * v).vector()).norm() < 1e-12);
            prop_assert!(Rot::<Nav, Nav, f64>::from_matrix(&a.matrix()).angle_to(a) < 1e-7);
        }

        #[test]
        fn log_inverts_exp(x in -1.0..1.0_f64, y in -1.0..1.0_f64, z in -1.0..1.0_f64, scale in 0.0..1.7_f64) {
            let phi = Vec3::<Nav, f64>::new(x, y, z) * scale;
            prop_assert!((Rot::exp(phi).log() - phi).norm() < 1e-9);
            let phi = phi.cast::<f32>();
            prop_assert!((Rot::exp(phi).log() - phi).norm() <= 4e-7 * phi.norm().max(1e-3));
        }

        #[test]
        fn exp_is_the_matrix_exponential(x in -1.0..1.0_f64, y in -1.0..1.0_f64, z in -1.0..1.0_f64) {
            let phi = Vec3::<Nav, f64>::new(x, y, z);
            let (mut term, mut sum) = (Matrix3::identity(), Matrix3::identity());
            for k in 1..30 {
                term = term * phi.skew() / f64::from(k);
                sum += term;
            }
            prop_assert!((Rot::exp(phi).matrix() - sum).norm() < 1e-8);
        }
    }

    #[test]
    fn rotor_and_attitude_signs() {
        let x = Vec3::<Sensor, f64>::new(1.0, 0.0, 0.0);
        let y_b = Rot::about_z(core::f64::consts::FRAC_PI_2) * x;
        assert!((y_b - Vec3::new(0.0, 1.0, 0.0)).norm() < 1e-15);
        // Pitch up lifts the front, roll lifts the left side, yaw turns the front to the west.
        let front = Vec3::<Body, f64>::new(0.0, 1.0, 0.0);
        let right = Vec3::<Body, f64>::new(1.0, 0.0, 0.0);
        assert!((Rot::from_yaw_pitch_roll(0.0, 0.1, 0.0) * front).z() > 0.0);
        assert!((Rot::from_yaw_pitch_roll(0.0, 0.0, 0.1) * right).z() < 0.0);
        assert!((Rot::from_yaw_pitch_roll(0.1, 0.0, 0.0) * front).x() < 0.0);
    }
}
