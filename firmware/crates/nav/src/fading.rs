//! Fading factors of the strong-tracking filter.
//!
//! A filter that trusts its model too much stops listening; the strong-tracking filter watches the
//! innovations and, when they are larger than P says, raises the variances of chosen states before
//! the prediction (\[Xing18\] (26); multiple factors after D. H. Zhou and P. M. Frank, *Strong tracking
//! filtering of nonlinear time-varying stochastic systems with coloured noise*, Int. J. Control 65
//! (1996)). With innovation γ, forgetting ρ and softening β:
//!
//! ```text
//! V = γ γᵀ at first, then (ρ V + γ γᵀ)/(1 + ρ)
//! M = H Φ P Φᵀ Hᵀ
//! c from tr V = β tr(c M + H Q Hᵀ + R),    λ_i = max(1, α_i c)
//! P⁻ = Φ D^½ P D^½ Φᵀ + Q,    D = diag(λ)
//! ```
//!
//! D stands inside Φ, as printed: the state that has drifted is faded, and Φ carries what that means
//! to the others. Two things differ from the printed form, each measured:
//!
//! * β softens all that is expected of an innovation, not R alone. Where R is small, a single innovation
//!   exceeds its mean often enough for the printed form to fade for nothing: heading RMS 0.51° for 0.35°
//!   in `paper-sim`.
//! * The printed denominator Σ α_i M_ii sees only states that are measured themselves, and would be zero
//!   for factors on the biases alone. Here c is the one factor that explains the innovations, and α says
//!   which states take it.
//!
//! All λ = 1 leave the Kalman filter bit for bit, because scaling by one is exact.

use frames::Real;
use nalgebra::{Matrix3, Vector3};

/// Figures of the strong-tracking policy.
///
/// | field | unit | zero means | sane value |
/// |---|---|---|---|
/// | `forgetting` | – | only the last innovation counts | 0.95 |
/// | `softening` | – | refused: below one every innovation fades | 6 |
/// | `weights` | – | that state is never faded | 1 on gyro biases, 0 elsewhere |
/// | `limit` | – | refused: below one there is no factor | 100 |
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct StrongTracking<T: Real, const B: usize> {
    /// ρ in [0, 1].
    pub forgetting: T,
    /// β ≥ 1.
    pub softening: T,
    /// α by block of states, ≥ 0.
    pub weights: [Vector3<T>; B],
    /// Largest factor, ≥ 1: one wild innovation must not erase what was learnt.
    pub limit: T,
}

impl<T: Real, const B: usize> StrongTracking<T, B> {
    /// Whether the figures are in range.
    pub fn is_valid(&self) -> bool {
        let (zero, one) = (T::zero(), T::one());
        (zero..=one).contains(&self.forgetting)
            && self.softening.finite()
            && self.softening >= one
            && self.limit.finite()
            && self.limit >= one
            && self.weights.iter().all(|w| w.sum().finite() && w.min() >= zero)
    }
}

/// The running mean of the innovations.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Fading<T: Real> {
    /// Trace of V, `None` before the first innovation.
    trace: Option<T>,
}

impl<T: Real> Default for Fading<T> {
    fn default() -> Self {
        Self::new()
    }
}

impl<T: Real> Fading<T> {
    /// Before the first innovation.
    pub fn new() -> Self {
        Self { trace: None }
    }

    /// The factors for the prediction that led to `innovation`.
    ///
    /// `m` is the block of Φ P Φᵀ that is measured, `q` that of Q, `r` the noise variance of each
    /// component. Only traces enter, so only the trace of V is kept.
    pub fn factors<const B: usize>(
        &mut self,
        policy: &StrongTracking<T, B>,
        innovation: &Vector3<T>,
        m: &Matrix3<T>,
        q: &Matrix3<T>,
        r: T,
    ) -> [Vector3<T>; B] {
        let (one, rho) = (T::one(), policy.forgetting);
        let gamma2 = innovation.norm_squared();
        let v = self.trace.map_or(gamma2, |v| (rho * v + gamma2) / (one + rho));
        self.trace = Some(v);
        let c = (v / policy.softening - q.trace() - T::lit(3.0) * r) / m.trace();
        policy
            .weights
            .map(|weights| weights.map(|alpha| (alpha * c).min(policy.limit).max(one)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn policy() -> StrongTracking<f64, 2> {
        StrongTracking {
            forgetting: 0.5,
            softening: 2.0,
            weights: [Vector3::zeros(), Vector3::new(1.0, 0.5, 0.0)],
            limit: 100.0,
        }
    }

    /// Factors after innovations of these norms, with tr M = 3, tr Q = 1.5 and 3 r = 1.5.
    fn factors(innovations: &[f64]) -> [Vector3<f64>; 2] {
        let mut fading = Fading::new();
        let mut last = [Vector3::zeros(); 2];
        for norm in innovations {
            let innovation = Vector3::new(0.0, *norm, 0.0);
            let (m, q) = (Matrix3::identity(), Matrix3::identity() * 0.5);
            last = fading.factors(&policy(), &innovation, &m, &q, 0.5);
        }
        last
    }

    #[test]
    fn expected_innovations_fade_nothing() {
        let one = Vector3::repeat(1.0);
        assert_eq!(factors(&[0.0]), [one; 2]);
        // γ² = β (M + Q + 3 r) is the most that does not.
        assert_eq!(factors(&[12.0_f64.sqrt()]), [one; 2]);
    }

    #[test]
    fn larger_ones_are_explained_by_the_weighted_states() {
        // V = 24: c = (24/2 − 1.5 − 1.5)/3 = 3.
        let [unweighted, weighted] = factors(&[24.0_f64.sqrt()]);
        assert_eq!(unweighted, Vector3::repeat(1.0));
        assert!((weighted - Vector3::new(3.0, 1.5, 1.0)).amax() < 1e-12, "{weighted}");
        // V = (0.5·24 + 0)/1.5 = 8 a step later: c = 1/3, and no factor is below one.
        assert_eq!(factors(&[24.0_f64.sqrt(), 0.0])[1], Vector3::repeat(1.0));
        assert!((factors(&[1e6])[1].x - 100.0).abs() < 1e-12, "limit");
    }
}
