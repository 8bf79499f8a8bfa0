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
//! J has one minimum or two. There are two where the rotor's mean axis is tilted: the z gyro's bias, which turning about
//! z does not modulate, then draws the ellipse out along the level part of the axis, and a line meets a circle twice. Both
//! are found; the difference of J says how much likelier the first is.
//!
//! Along the axes of the ellipse, the thin one with the weight A, the long one with B ≤ A, and ω̂ at (p, q) with p, q > 0, the
//! slope of J at (cos θ, sin θ) divided by 2 sin θ cos θ is
//!
//! ```text
//! B − A + A p/cos θ − B q/sin θ
//! ```
//!
//! In the quadrant of ω̂ it grows from −∞ to ∞: there is one minimum, and no point of the circle is nearer, since each has
//! its mirror image there. Mirrored in the thin axis the last term changes its sign: both ends are ∞, the least value is at
//! tan³θ = B q/(A p), and where that is negative there is the other minimum beyond it. In the quadrants left there is none.

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

/// Halvings of a quadrant: to 1e-6 rad.
const HALVINGS: usize = 21;

/// ω̂ is taken to be this far from the axes at least, in units of ω_ie cos L: on an axis both sides of it are as good, and
/// one is enough.
const OFF_AXIS: f64 = 1e-6;

/// The angle between `low` and the end of the quadrant up to which `is_below` holds, a function of sine and cosine.
fn halve<T: Real>(mut low: T, is_below: impl Fn((T, T)) -> bool) -> T {
    let half = T::lit(0.5);
    let mut high = T::frac_pi_2();
    for _ in 0..HALVINGS {
        let middle = (low + high) * half;
        if is_below(math::sin_cos(middle)) {
            low = middle;
        } else {
            high = middle;
        }
    }
    (low + high) * half
}

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
        let zero = T::zero();
        let cov = covariance + Matrix2::identity() * length_var;
        let half = T::lit(0.5);
        let (mean, difference, cross) = (
            (cov[(0, 0)] + cov[(1, 1)]) * half,
            (cov[(0, 0)] - cov[(1, 1)]) * half,
            cov[(0, 1)],
        );
        let most = mean + math::hypot(difference, cross);
        if !(most.finite() && rate.x.finite() && rate.y.finite()) {
            return Self::ahead();
        }
        // The determinant may be lost in rounding.
        let least = (cov[(0, 0)] * cov[(1, 1)] - cross * cross) / most;
        let least = least.max(most * T::default_epsilon());
        let (sin, cos) = math::sin_cos(math::atan2(cross, difference) * half);
        // The axes with the sense that gives both components of the rate their sign.
        let along = |axis: Vector2<T>| {
            let at = axis.dot(rate);
            let sense = if at < zero { -T::one() } else { T::one() };
            (axis * sense, (at * sense).max(T::lit(OFF_AXIS)))
        };
        let ((thin, p), (long, q)) = (along(Vector2::new(-sin, cos)), along(Vector2::new(cos, sin)));
        let (a, b) = (least.recip(), most.recip());

        // Half the slope of J on this side of the thin axis, that of the rate or the other.
        let slope = |(sin, cos): (T, T), side: T| (b - a) * sin * cos + a * p * sin - side * b * q * cos;
        let minimum = |from: T, side: T| {
            let (sin, cos) = math::sin_cos(halve(from, |at| slope(at, side) < zero));
            let point = thin * cos + long * (side * sin);
            let (off_thin, off_long) = (cos - p, side * sin - q);
            Direction {
                angle: math::atan2(point.x, point.y),
                cost: a * off_thin * off_thin + b * off_long * off_long,
            }
        };
        let best = minimum(zero, T::one());
        let other_side = -T::one();
        let least_slope = halve(zero, |(sin, cos)| a * p * sin * sin * sin < b * q * cos * cos * cos);
        let is_there = slope(math::sin_cos(least_slope), other_side) < zero;
        Self {
            best,
            other: is_there.then(|| minimum(least_slope, other_side)),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// A rate, east and north, with the axes of its ellipse, powers of ten, and the direction of the long one.
    #[derive(Debug, Clone, Copy)]
    struct Case {
        rate: [f64; 2],
        long: f64,
        thin: f64,
        turn: f64,
    }

    /// Against a search in steps of a hundredth of a degree: the lowest point, and how many minima there are.
    fn check(case: Case) {
        let (long, short) = (10.0_f64.powf(case.long), 10.0_f64.powf(case.long + case.thin));
        let (s, c) = math::sin_cos(case.turn);
        let axes = Matrix2::new(c, -s, s, c);
        let p = axes * Matrix2::new(long * long, 0.0, 0.0, short * short) * axes.transpose();
        let rate = Vector2::from(case.rate);
        let north = North::find(&rate, &p, 0.0);
        let weight = p.try_inverse().unwrap();
        let cost = |angle: f64| {
            let (sin, cos) = math::sin_cos(angle);
            let d = Vector2::new(sin, cos) - rate;
            d.dot(&(weight * d))
        };
        let found = [Some(north.best), north.other];
        for Direction { angle, cost: told } in found.into_iter().flatten() {
            let there = cost(angle);
            // A step of the bisection where J is steepest, and the distance kept from the axes.
            let slack = 4e-12 / (short * short) + 4e-6 * there;
            assert!((told - there).abs() < slack, "{case:?}: {north:?}, {there}");
            let beside = cost(angle - 2e-5).min(cost(angle + 2e-5));
            assert!(beside > there - slack, "{case:?}: {north:?}, {beside}");
        }
        let step = core::f64::consts::TAU / 36_000.0;
        let costs: [f64; 36_000] = core::array::from_fn(|k| cost(k as f64 * step));
        let lowest = costs.iter().copied().fold(f64::MAX, f64::min);
        assert!(
            north.best.cost <= lowest + 1e-12 / (short * short) + 1e-6 * lowest,
            "{case:?}: {north:?}, {lowest}"
        );
        assert!(
            north.other.is_none_or(|other| other.cost >= north.best.cost),
            "{case:?}: {north:?}"
        );
        let minima = (0..36_000).filter(|k| {
            let (before, after) = (costs[(k + 35_999) % 36_000], costs[(k + 1) % 36_000]);
            costs[*k] <= before && costs[*k] < after
        });
        for k in minima {
            let off = |at: Direction<f64>| math::wrap_pi(at.angle - k as f64 * step).abs();
            let nearest = found.into_iter().flatten().map(off).fold(f64::MAX, f64::min);
            assert!(nearest < 1.1 * step, "{case:?}: {north:?}, {}", k as f64 * step);
        }
    }

    proptest! {
        #[test]
        fn no_point_of_the_circle_is_nearer(
            e in -2.0..2.0_f64, n in -2.0..2.0_f64, long in -3.0..0.5_f64, thin in -2.5..0.0_f64, turn in 0.0..3.2_f64,
        ) {
            check(Case { rate: [e, n], long, thin, turn });
        }
    }

    #[test]
    fn two_minima_may_be_five_degrees_apart() {
        // Where the long axis touches the circle: at 223.2° with J of 0.25, and at 228.7° with 0.16.
        check(Case {
            rate: [-1.032_266_888_293_579_5, -0.371_536_600_239_140_1],
            long: 0.0,
            thin: -2.382_389_139_840_259,
            turn: 2.342_869_912_132_910_4,
        });
    }

    #[test]
    fn rates_on_an_axis_or_without_a_direction() {
        for rate in [
            [0.0, 0.0],
            [0.0, 1.0],
            [1.0, 0.0],
            [-0.5, 0.0],
            [0.0, -1.5],
            [1e-9, -1e-9],
        ] {
            for turn in [0.0, core::f64::consts::FRAC_PI_2] {
                for thin in [-2.5, -1.0, -0.1] {
                    check(Case {
                        rate,
                        long: -0.5,
                        thin,
                        turn,
                    });
                }
            }
        }
        let north = North::find(&Vector2::new(0.0_f32, 1.0), &(Matrix2::identity() * 1e-4), 0.0);
        assert!(north.best.angle.abs() < 3e-6 && north.other.is_none(), "{north:?}");
    }

    #[test]
    fn other_than_numbers_say_nothing() {
        let one = Matrix2::<f32>::identity();
        assert_eq!(North::find(&Vector2::new(f32::NAN, 1.0), &one, 0.0), North::ahead());
        assert_eq!(
            North::find(&Vector2::new(0.0, 1.0), &(one * f32::NAN), 0.0),
            North::ahead()
        );
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
