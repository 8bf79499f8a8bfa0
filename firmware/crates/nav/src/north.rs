//! Where north is, when Earth's level rate is known as an ellipse and its length as a number.
//!
//! The level part of Earth's rate has a known length, ω_ie cos L, so the two components that the filter estimates
//! must lie on a circle. With their estimate ω̂ and covariance P the heading is the point of the circle that is
//! nearest in P:
//!
//! ```text
//! J(ψ) = (ω(ψ) − ω̂)ᵀ P⁻¹ (ω(ψ) − ω̂),     ω(ψ) = ω_ie cos L [sin ψ, cos ψ]
//! ```
//!
//! J is a trigonometric polynomial of second degree and has one minimum or two. There are two where the rotor's mean
//! axis is tilted: the z gyro's bias, which turning about z does not modulate, then draws the ellipse out along the
//! level part of the axis, and a line meets a circle twice. Both are found; the difference of J says how much likelier
//! the first is.

use frames::{Real, math};
use nalgebra::{Matrix2, Vector2};

/// One minimum of J.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Direction<T: Real> {
    /// ψ: of north in the strapdown's frame, clockwise from its north, rad.
    pub angle: T,
    /// J there.
    pub cost: T,
}

/// The minima of J.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct North<T: Real> {
    /// The lowest.
    pub best: Direction<T>,
    /// The other, if there is one.
    pub other: Option<Direction<T>>,
}

/// Points at which J is looked at first, every 5.6°. Where the ellipse touches the circle, two minima may be nearer to
/// each other than that; one stands for both then, and J hardly differs between them.
const POINTS: usize = 64;

/// Halvings of twice their distance: to 1e-6 rad.
const HALVINGS: usize = 18;

impl<T: Real> North<T> {
    /// The frame's own north, before anything is known.
    pub fn ahead() -> Self {
        Self {
            best: Direction {
                angle: T::zero(),
                cost: T::zero(),
            },
            other: None,
        }
    }

    /// From the estimated level rate and its covariance, east and north, both in units of ω_ie cos L. `length_var` is
    /// the variance of the length in the same unit.
    pub fn find(rate: &Vector2<T>, covariance: &Matrix2<T>, length_var: T) -> Self {
        let p = covariance + Matrix2::identity() * length_var;
        let scale = T::one() / (p[(0, 0)] * p[(1, 1)] - p[(0, 1)] * p[(1, 0)]);
        let weight = Matrix2::new(p[(1, 1)], -p[(0, 1)], -p[(1, 0)], p[(0, 0)]) * scale;
        let at = |angle: T| {
            let (sin, cos) = math::sin_cos(angle);
            (Vector2::new(sin, cos), Vector2::new(cos, -sin))
        };
        let cost = |angle: T| {
            let d = at(angle).0 - rate;
            d.dot(&(weight * d))
        };
        let step = T::two_pi() / T::lit(POINTS as f64);
        let angles: [T; POINTS] = core::array::from_fn(|k| step * T::lit(k as f64));
        let costs = angles.map(cost);
        let (mut best, mut other): (Option<Direction<T>>, Option<Direction<T>>) = (None, None);
        for k in 0..POINTS {
            let (before, after) = (costs[(k + POINTS - 1) % POINTS], costs[(k + 1) % POINTS]);
            if !(costs[k] <= before && costs[k] < after) {
                continue;
            }
            // The minimum is between the neighbours, where the slope changes its sign.
            let (mut low, mut high) = (angles[k] - step, angles[k] + step);
            for _ in 0..HALVINGS {
                let middle = (low + high) * T::lit(0.5);
                let (point, tangent) = at(middle);
                if tangent.dot(&(weight * (point - rate))) < T::zero() {
                    low = middle;
                } else {
                    high = middle;
                }
            }
            let angle = (low + high) * T::lit(0.5);
            let found = Direction {
                angle: math::wrap_pi(angle),
                cost: cost(angle),
            };
            if best.is_none_or(|best| found.cost < best.cost) {
                (best, other) = (Some(found), best);
            } else if other.is_none_or(|other| found.cost < other.cost) {
                other = Some(found);
            }
        }
        best.map_or(Self::ahead(), |best| Self { best, other })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        /// Against a search in steps of a thousandth of a degree.
        #[test]
        fn no_point_of_the_circle_is_nearer(
            e in -2.0..2.0_f64, n in -2.0..2.0_f64, long in -3.0..0.5_f64, thin in -2.5..0.0_f64, turn in 0.0..3.2_f64,
        ) {
            let (long, short) = (10.0_f64.powf(long), 10.0_f64.powf(long + thin));
            let (s, c) = math::sin_cos(turn);
            let axes = Matrix2::new(c, -s, s, c);
            let p = axes * Matrix2::new(long * long, 0.0, 0.0, short * short) * axes.transpose();
            let rate = Vector2::new(e, n);
            let north = North::find(&rate, &p, 0.0);
            let weight = p.try_inverse().unwrap();
            let cost = |angle: f64| {
                let (sin, cos) = math::sin_cos(angle);
                let d = Vector2::new(sin, cos) - rate;
                d.dot(&(weight * d))
            };
            let least = (0..36_000).map(|k| cost(f64::from(k) * core::f64::consts::TAU / 36_000.0)).fold(f64::MAX, f64::min);
            prop_assert!(north.best.cost <= least * 1.001 + 0.05, "{north:?} {least}");
            if let Some(other) = north.other {
                prop_assert!(other.cost >= north.best.cost);
                let slope = (cost(other.angle + 1e-4) - cost(other.angle - 1e-4)) / 2e-4;
                let curve = (cost(other.angle + 1e-4) + cost(other.angle - 1e-4) - 2.0 * cost(other.angle)) / 1e-8;
                prop_assert!(slope.abs() < 0.05 * curve.abs().max(1.0), "{other:?}: {slope} {curve}");
            }
        }
    }

    #[test]
    fn a_line_meets_the_circle_twice() {
        // Drawn out to the north-east, through east: meets the circle at east and at north... seen from [1, 0].
        let along = Vector2::new(-1.0, 1.0).normalize();
        let across = Vector2::new(1.0, 1.0).normalize();
        let p = along * along.transpose() * 4.0 + across * across.transpose() * 1e-4;
        let north = North::find(&Vector2::new(0.9, 0.1), &p, 0.0);
        let other = north.other.unwrap();
        assert!(
            (north.best.angle - core::f64::consts::FRAC_PI_2).abs() < 0.02,
            "{north:?}"
        );
        assert!(other.angle.abs() < 0.02, "{north:?}");
        // 1.27 from the one, 0.14 from the other, in σ of 2.
        assert!((other.cost - north.best.cost - (1.27_f64.powi(2) - 0.14_f64.powi(2)) / 4.0).abs() < 0.02);
    }

    #[test]
    fn a_small_ellipse_is_where_it_points() {
        let p = Matrix2::identity() * 1e-6_f32;
        let north = North::find(&Vector2::new(-0.6_f32, 0.8), &p, 0.0);
        assert!((north.best.angle + 0.643_501_1).abs() < 1e-5 && north.best.cost < 1e-3);
        // The other side is a maximum.
        assert_eq!(north.other, None);
    }
}
