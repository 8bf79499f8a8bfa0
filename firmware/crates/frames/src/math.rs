//! The one door to scalar maths.
//!
//! Every transcendental function of the core crates goes through here, so that host and target
//! compute the same bits: nothing here depends on `std`, on the platform's libm or on feature
//! unification. `clippy.toml` refuses the methods of the same names.
//!
//! Errors measured against f64 (largest over 10⁶ arguments, see the tests):
//!
//! | function | range | f32 error |
//! |---|---|---|
//! | [`sin_cos`] | \|x\| ≤ 2π | 1e-7 absolute |
//! | [`sin_cos`] | \|x\| ≤ 1000 | 1.5e-7 absolute |
//! | [`sin_cos`] | beyond | half an ulp of the argument |
//! | [`sqrt`] | x ≥ 0 | correctly rounded |
//! | [`atan2`] | all | 3e-7 rad |
//! | [`exp`] | −80 ≤ x ≤ 80 | 1e-7 of the result |
//! | [`ln`] | 1e-30 ≤ x ≤ 1e30 | 6e-6 absolute, 1e-7 of the result |
//!
//! The approximate functions of `micromath` (sin 1.1e-3, atan2 2.8e-3 rad, sqrt 6 %) are fit for
//! motor commutation and displays and have no place in attitude or filter maths.

use crate::private::Sealed;

/// The scalar of the core: `f32` on the target, `f64` where rounding is measured.
pub trait Real: nalgebra::RealField + Copy + Sealed {
    /// A constant, rounded to this scalar. Folded at compile time.
    fn lit(value: f64) -> Self;
    /// This value as `f64`, exactly.
    fn to_f64(self) -> f64;
    /// Whether the value is neither infinite nor NaN.
    fn finite(self) -> bool;
    #[doc(hidden)]
    fn door_sqrt(self) -> Self;
    #[doc(hidden)]
    fn door_sin_cos(self) -> (Self, Self);
    #[doc(hidden)]
    fn door_atan2(self, x: Self) -> Self;
    #[doc(hidden)]
    fn door_exp(self) -> Self;
    #[doc(hidden)]
    fn door_ln(self) -> Self;
    #[doc(hidden)]
    fn door_round(self) -> Self;
}

impl Sealed for f32 {}
impl Sealed for f64 {}

impl Real for f32 {
    #[inline(always)]
    #[expect(clippy::cast_possible_truncation, reason = "rounding is what is asked for")]
    fn lit(value: f64) -> Self {
        value as f32
    }
    #[inline(always)]
    fn to_f64(self) -> f64 {
        f64::from(self)
    }
    #[inline(always)]
    fn finite(self) -> bool {
        self.is_finite()
    }
    #[inline(always)]
    fn door_sqrt(self) -> Self {
        libm::sqrtf(self)
    }
    #[inline]
    fn door_sin_cos(self) -> (Self, Self) {
        sin_cos_f32(self)
    }
    #[inline]
    fn door_atan2(self, x: Self) -> Self {
        libm::atan2f(self, x)
    }
    #[inline]
    fn door_exp(self) -> Self {
        libm::expf(self)
    }
    #[inline]
    fn door_ln(self) -> Self {
        libm::logf(self)
    }
    #[inline]
    fn door_round(self) -> Self {
        libm::rintf(self)
    }
}

impl Real for f64 {
    #[inline(always)]
    fn lit(value: f64) -> Self {
        value
    }
    #[inline(always)]
    fn to_f64(self) -> f64 {
        self
    }
    #[inline(always)]
    fn finite(self) -> bool {
        self.is_finite()
    }
    #[inline(always)]
    fn door_sqrt(self) -> Self {
        libm::sqrt(self)
    }
    #[inline]
    fn door_sin_cos(self) -> (Self, Self) {
        libm::sincos(self)
    }
    #[inline]
    fn door_atan2(self, x: Self) -> Self {
        libm::atan2(self, x)
    }
    #[inline]
    fn door_exp(self) -> Self {
        libm::exp(self)
    }
    #[inline]
    fn door_ln(self) -> Self {
        libm::log(self)
    }
    #[inline]
    fn door_round(self) -> Self {
        libm::rint(self)
    }
}

/// Square root, correctly rounded. NaN for a negative argument.
#[inline(always)]
pub fn sqrt<T: Real>(x: T) -> T {
    x.door_sqrt()
}

/// `(sin x, cos x)`, x in radians.
#[inline]
pub fn sin_cos<T: Real>(x: T) -> (T, T) {
    x.door_sin_cos()
}

/// e to the power of x.
#[inline]
pub fn exp<T: Real>(x: T) -> T {
    x.door_exp()
}

/// Natural logarithm; NaN for a negative argument.
#[inline]
pub fn ln<T: Real>(x: T) -> T {
    x.door_ln()
}

/// The angle of the point (x, y) in (−π, π], radians.
#[inline]
pub fn atan2<T: Real>(y: T, x: T) -> T {
    y.door_atan2(x)
}

/// `√(x² + y²)` for values far from overflow.
#[inline]
pub fn hypot<T: Real>(x: T, y: T) -> T {
    sqrt(x * x + y * y)
}

/// `x` brought into [low, high]; `low` where `x` is not a number.
///
/// The `clamp` of the standard library panics when `low` exceeds `high`, and its message brings the whole
/// printing of floats into an image (24 kB).
#[inline]
pub fn limit<T: Real>(x: T, low: T, high: T) -> T {
    // Comparisons, not `max` and `min`: a NaN falls through to `low`.
    if x >= high {
        high
    } else if x >= low {
        x
    } else {
        low
    }
}

/// The angle brought into [−π, π].
#[inline]
pub fn wrap_pi<T: Real>(angle: T) -> T {
    let turn = T::two_pi();
    angle - turn * (angle / turn).door_round()
}

/// The angle brought into [0, 2π).
#[inline]
pub fn wrap_two_pi<T: Real>(angle: T) -> T {
    let wrapped = wrap_pi(angle);
    let positive = if wrapped < T::zero() {
        wrapped + T::two_pi()
    } else {
        wrapped
    };
    // A tiny negative angle plus 2π rounds to 2π itself.
    if positive >= T::two_pi() { T::zero() } else { positive }
}

/// Sine and cosine in single precision without a single double-precision operation, which the
/// Cortex-M4F would do in software.
///
/// Cody–Waite reduction by π/2 in three parts, then the minimax polynomials of the Cephes library
/// on [−π/4, π/4]. Beyond 1000 rad, where the three parts no longer cancel exactly, whole turns are taken
/// off first.
fn sin_cos_f32(x: f32) -> (f32, f32) {
    // π/2 = C1 + C2 + C3, C1 and C2 with enough trailing zeros that k·C1 and k·C2 are exact for
    // k < 2^11.
    const C1: f32 = 1.570_312_5;
    const C2: f32 = 4.837_513e-4;
    const C3: f32 = 7.549_79e-8;
    // The remainder is exact; what 2π is off in f32 is 2.8e-8 of x, less than x itself is known to.
    let x = if x.abs() > 1000.0 {
        x % core::f32::consts::TAU
    } else {
        x
    };
    let k = libm::rintf(x * core::f32::consts::FRAC_2_PI);
    let r = ((x - k * C1) - k * C2) - k * C3;
    let r2 = r * r;
    let s = r + r * r2 * (-1.666_665_5e-1 + r2 * (8.332_161e-3 + r2 * -1.951_529_6e-4));
    let c = 1.0 - 0.5 * r2 + r2 * r2 * (4.166_664_6e-2 + r2 * (-1.388_731_6e-3 + r2 * 2.443_315_7e-5));
    #[expect(clippy::cast_possible_truncation, reason = "|k| < 640 by the range check above")]
    match (k as i32) & 3 {
        0 => (s, c),
        1 => (c, -s),
        2 => (-s, -c),
        _ => (-c, s),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Largest absolute error of the f32 sine and cosine over 10⁶ arguments in ±range.
    fn worst_sin_cos(range: f64) -> f64 {
        (0..1_000_000)
            .map(|k| {
                let x = f32::lit((f64::from(k) / 500_000.0 - 1.0) * range);
                let (s, c) = sin_cos(x);
                let (es, ec) = libm::sincos(f64::from(x));
                (f64::from(s) - es).abs().max((f64::from(c) - ec).abs())
            })
            .fold(0.0, f64::max)
    }

    #[test]
    fn sin_cos_error_is_as_documented() {
        let near = worst_sin_cos(core::f64::consts::TAU);
        let far = worst_sin_cos(1000.0);
        assert!(near < 1e-7, "|x| ≤ 2π: {near:e}");
        assert!(far < 1.5e-7, "|x| ≤ 1000: {far:e}");
        for x in [5000.0_f32, -12_345.678, 1e6] {
            let ulp = (x.abs() * f32::EPSILON).max(1e-7);
            assert!((sin_cos(x).0 - libm::sinf(x)).abs() < ulp, "{x}");
        }
        assert!(sin_cos(f32::NAN).0.is_nan());
        assert!(sin_cos(f32::INFINITY).0.is_nan() && sin_cos(f32::NEG_INFINITY).1.is_nan());
    }

    #[test]
    fn atan2_error_is_as_documented() {
        let worst = (0..1_000_000)
            .map(|k| {
                let a = (f64::from(k) / 500_000.0 - 1.0) * core::f64::consts::PI;
                let (y, x) = (f32::lit(libm::sin(a)), f32::lit(libm::cos(a)));
                (f64::from(atan2(y, x)) - libm::atan2(f64::from(y), f64::from(x))).abs()
            })
            .fold(0.0, f64::max);
        assert!(worst < 3e-7, "{worst:e}");
    }

    #[test]
    fn exp_and_ln_errors_are_as_documented() {
        let worst = |relative: fn(f64) -> f64| {
            (0..1_000_000)
                .map(|k| relative(f64::from(k) / 500_000.0 - 1.0))
                .fold(0.0, f64::max)
        };
        let exp_error = worst(|share| {
            let x = f32::lit(80.0 * share);
            (f64::from(exp(x)) / libm::exp(f64::from(x)) - 1.0).abs()
        });
        assert!(exp_error < 1e-7, "{exp_error:e}");
        let ln_error = worst(|share| {
            let x = f32::lit(libm::exp(69.0 * share));
            let exact = libm::log(f64::from(x));
            (f64::from(ln(x)) - exact).abs() / exact.abs().max(1.0)
        });
        assert!(ln_error < 1e-7, "{ln_error:e}");
        assert_eq!((exp(-200.0_f32), exp(200.0_f32)), (0.0, f32::INFINITY));
        assert!(ln(-1.0_f32).is_nan());
    }

    #[test]
    fn limits() {
        assert_eq!(
            [limit(-2.0, -1.0, 1.0), limit(0.5, -1.0, 1.0), limit(2.0, -1.0, 1.0_f32)],
            [-1.0, 0.5, 1.0]
        );
        assert_eq!(limit(f32::NAN, -1.0, 1.0), -1.0);
        // Crossed limits are a mistake of the caller's, but no reason to stop a motor loop.
        assert_eq!(limit(0.0, 1.0, -1.0), -1.0_f32);
    }

    #[test]
    fn wrapping() {
        assert!((wrap_pi(3.5_f64) - (3.5 - core::f64::consts::TAU)).abs() < 1e-15);
        assert_eq!(wrap_two_pi(-1e-12_f32), 0.0);
        assert!((wrap_two_pi(-0.5_f64) - (core::f64::consts::TAU - 0.5)).abs() < 1e-15);
        for k in -100..100 {
            let a = wrap_two_pi(f32::lit(f64::from(k) * 0.37));
            assert!((0.0..core::f32::consts::TAU).contains(&a), "{a}");
        }
    }
}
