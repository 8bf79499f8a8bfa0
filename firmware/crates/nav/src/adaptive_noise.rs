//! Adaptive measurement noise: the variance of the base's displacement, estimated from the innovations.
//!
//! A laboratory floor stays within a tenth of a millimetre, a deck sways by half a metre, and one filter shall do
//! for both. So the variance r of the base's displacement is estimated with the state, by variational Bayes: r has
//! an inverse gamma density with shape a and scale b, and every measurement with innovation ν and predicted
//! variance p adds what is left of it once the state has taken its part (S. Särkkä and A. Nummenmaa, *Recursive noise
//! adaptive Kalman filtering by variational Bayesian approximations*, IEEE Trans. Automatic Control 54 (2009), for one
//! component):
//!
//! ```text
//! a ← ρ a + ½      b ← ρ b + ½ (e² + p⁺)      e = ν r/(p + r)    p⁺ = p r/(p + r)    r = b/a
//! ```
//!
//! where the right-hand side needs r and is iterated. ρ forgets, so that a ship may cast off and moor again.
//!
//! r says how far the base goes, not how fast it forgets where it was: sway of 8 s period measured once a second
//! is no white noise. The filter is therefore given `correlation · r`.
//!
//! The level axes share one estimate, up has its own: ships heave more than they sway, and only level motion is
//! mistaken for tilt.

use frames::Real;
use nalgebra::Vector3;

/// Figures of the base's displacement.
///
/// | field | unit | zero means | sane value |
/// |---|---|---|---|
/// | `least_sd` | m | refused | 0.025 mm |
/// | `start_sd` | m | refused | 0.3 m |
/// | `prior_sd` | m | refused | 1 m |
/// | `prior_velocity_sd` | m/s | refused | 0.5 m/s |
/// | `memory` | – | only the last measurement counts | 0.95 |
/// | `correlation` | – | refused | 4 measurements |
/// | `gate` | σ | refused | 6 |
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct AdaptiveNoiseConfig<T: Real = f32> {
    /// Lower limit of the 1σ of displacement, m.
    pub least_sd: T,
    /// Where the estimate starts, m: a deck. A floor shows in seconds that it is none; a filter that begins with a
    /// floor on a deck has been led astray by then.
    pub start_sd: T,
    /// 1σ of where the base is at the start, from where it is in the mean, m.
    pub prior_sd: T,
    /// 1σ of its velocity at the start, m/s.
    pub prior_velocity_sd: T,
    /// ρ in [0, 1): what is left of the past after a measurement.
    pub memory: T,
    /// Number of measurements that sway is correlated over, ≥ 1.
    pub correlation: T,
    /// Innovations beyond so many of their σ are refused, unless several come in a row.
    pub gate: T,
}

impl<T: Real> Default for AdaptiveNoiseConfig<T> {
    fn default() -> Self {
        Self {
            least_sd: T::lit(2.5e-5),
            start_sd: T::lit(0.3),
            prior_sd: T::one(),
            prior_velocity_sd: T::lit(0.5),
            memory: T::lit(0.95),
            correlation: T::lit(4.0),
            gate: T::lit(6.0),
        }
    }
}

impl<T: Real> AdaptiveNoiseConfig<T> {
    /// Whether the figures are in range.
    pub fn is_valid(&self) -> bool {
        let (zero, one) = (T::zero(), T::one());
        let positive = |x: T| x.finite() && x > zero;
        [
            self.least_sd,
            self.start_sd,
            self.prior_sd,
            self.prior_velocity_sd,
            self.gate,
        ]
        .into_iter()
        .all(positive)
            && self.memory >= zero
            && self.memory < one
            && self.correlation.finite()
            && self.correlation >= one
    }
}

/// Density of one variance.
#[derive(Debug, Clone, Copy, PartialEq)]
struct InverseGamma<T: Real> {
    shape: T,
    scale: T,
    /// Running mean of what the state has left of the measurements: below r, and quick to fall.
    left: T,
    /// Running mean of what is not known of that, p⁺, as far as innovations are as large as predicted. `None` once r has been
    /// taken from measurements.
    explained: Option<T>,
}

/// Rounds of the fixed point; it gains a digit or so a round, and no digit of r matters but the first.
const ROUNDS: usize = 4;

impl<T: Real> InverseGamma<T> {
    fn mean(&self) -> T {
        self.scale / self.shape
    }

    fn forget(&mut self, memory: T) {
        self.shape *= memory;
        self.scale *= memory;
    }

    /// Adds a measurement with this innovation squared and predicted variance; r stays above `least`.
    fn learn(&mut self, innovation2: T, predicted: T, least: T) {
        let half = T::lit(0.5);
        let shape = self.shape + half;
        let before = self.mean();
        // From above: where an innovation is far larger than both p and r, what is true is the larger of two solutions.
        let mut r = before.max(half * innovation2 / shape);
        let (mut scale, mut left, mut unknown) = (self.scale, T::zero(), T::zero());
        for _ in 0..ROUNDS {
            let part = r / (predicted + r);
            left = innovation2 * part * part;
            unknown = predicted * part;
            scale = self.scale + half * (left + unknown);
            r = scale / shape;
        }
        let fit = innovation2 / (predicted + r);
        let gain = T::lit(LEFT_GAIN);
        self.left += (left - self.left) * gain;
        let times = T::lit(MOST_OVER_LEFT);
        let mut most = self.left * times;
        if let Some(explained) = &mut self.explained {
            *explained += (unknown * fit.min(fit.recip()) - *explained) * gain;
            most = most.max(before.min((self.left + *explained) * times));
        }
        self.shape = shape;
        self.scale = scale.min(shape * most).max(shape * least);
    }
}

/// Weight of the newest in the running mean of what is left: the last few seconds count.
const LEFT_GAIN: f64 = 0.2;

/// How many times what is left r may be. Where r is far too large the state takes most of what it is given, and r
/// would need ten minutes from a deck to a floor. Sway leaves a fifth of r over half a wave.
///
/// While r is but the guess of the start it does not fall for that where the state explains innovations as large as they
/// are: nothing is measured of r then. Else a deck would look like a floor as long as the gyro biases are not found, and its
/// sway would be taken for them (ICM-42688-P, moored: headings 56° off at a σ of 4°). Innovations smaller than predicted say
/// that p and r are too large both, and larger ones that something has changed, which need not be the base.
const MOST_OVER_LEFT: f64 = 10.0;

/// Consecutive refusals after which the base has begun to move.
const MOST_REFUSED: u8 = 3;

/// The estimated measurement noise of displacement.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct AdaptiveNoise<T: Real = f32> {
    config: AdaptiveNoiseConfig<T>,
    level: InverseGamma<T>,
    up: InverseGamma<T>,
    in_a_row: u8,
}

impl<T: Real> AdaptiveNoise<T> {
    /// A base that may be a deck.
    pub fn new(config: AdaptiveNoiseConfig<T>) -> Self {
        let var = config.start_sd * config.start_sd;
        let start = InverseGamma {
            shape: T::one(),
            scale: var,
            left: var,
            explained: Some(T::zero()),
        };
        Self {
            config,
            level: start,
            up: start,
            in_a_row: 0,
        }
    }

    /// Whether the innovations, each squared over its variance, are to be taken: an outlier is refused, but not many
    /// in a row.
    pub fn accepts(&mut self, largest: T) -> bool {
        if largest <= self.config.gate * self.config.gate || self.in_a_row >= MOST_REFUSED {
            self.in_a_row = 0;
            return true;
        }
        self.in_a_row += 1;
        false
    }

    /// Learns from a measurement: its innovation, m, east, north and up, and the variances predicted for it, m².
    pub fn learn(&mut self, innovation: &Vector3<T>, predicted: &Vector3<T>) {
        self.level.forget(self.config.memory);
        self.up.forget(self.config.memory);
        let least = self.config.least_sd * self.config.least_sd;
        for axis in 0..3 {
            let density = if axis < 2 { &mut self.level } else { &mut self.up };
            density.learn(innovation[axis] * innovation[axis], predicted[axis], least);
        }
    }

    /// Noise variance to weigh a component by, m².
    pub fn variance(&self, axis: usize) -> T {
        let density = if axis < 2 { &self.level } else { &self.up };
        density.mean() * self.config.correlation
    }

    /// Variance of the level displacement of the base as estimated, m².
    pub fn level_var(&self) -> T {
        self.level.mean()
    }

    /// What to begin with when the same measurements are taken again: r as what was left of them says, with the weight
    /// of a few. Where r was far too large, r itself would take minutes to fall.
    pub fn as_prior(&self) -> Self {
        let few = |density: &InverseGamma<T>| {
            let shape = T::lit(2.0);
            let var = density.left.max(self.config.least_sd * self.config.least_sd);
            InverseGamma {
                shape,
                scale: var * shape,
                left: var,
                explained: None,
            }
        };
        Self {
            config: self.config,
            level: few(&self.level),
            up: few(&self.up),
            in_a_row: 0,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn learnt(sd: f64, predicted: f64, from: f64) -> AdaptiveNoise<f64> {
        let mut adaptive_noise = AdaptiveNoise::new(AdaptiveNoiseConfig {
            start_sd: from,
            ..AdaptiveNoiseConfig::default()
        });
        // What a Gaussian would give, without chance: innovations of one size.
        let innovation = Vector3::repeat((sd * sd + predicted).sqrt());
        for _ in 0..400 {
            adaptive_noise.learn(&innovation, &Vector3::repeat(predicted));
        }
        adaptive_noise
    }

    #[test]
    fn the_variance_is_found_from_either_side() {
        for (sd, predicted) in [(0.3, 1e-4), (0.02, 1e-6), (1e-3, 1e-8)] {
            for from in [10.0 * sd, 0.1 * sd] {
                let found = learnt(sd, predicted, from).level_var() / (sd * sd);
                assert!((found - 1.0).abs() < 0.05, "{sd} from {from}: {found}");
            }
        }
    }

    #[test]
    fn what_the_state_explains_is_not_laid_upon_the_base() {
        // Innovations as large as predicted, and no more.
        let found = learnt(0.0, 1e-2, 0.1);
        assert!(found.level_var() < 0.3 * 1e-2, "{}", found.level_var());
    }

    #[test]
    fn level_and_up_are_apart_and_weighed_by_their_correlation() {
        let mut adaptive_noise = AdaptiveNoise::<f64>::new(AdaptiveNoiseConfig::default());
        for _ in 0..400 {
            adaptive_noise.learn(&Vector3::new(0.1, 0.1, 1e-3), &Vector3::repeat(1e-9));
        }
        assert!((adaptive_noise.variance(0) / 0.04 - 1.0).abs() < 0.05);
        assert_eq!(adaptive_noise.variance(0), adaptive_noise.variance(1));
        assert!(
            (adaptive_noise.variance(2) / 4e-6 - 1.0).abs() < 0.1,
            "{}",
            adaptive_noise.variance(2)
        );
        // Never below the floor.
        for _ in 0..2000 {
            adaptive_noise.learn(&Vector3::zeros(), &Vector3::zeros());
        }
        assert!((adaptive_noise.variance(2) / (5e-5 * 5e-5) - 1.0).abs() < 1e-9);
    }

    #[test]
    fn a_floor_shows_within_a_minute() {
        // Seen with r far too large, and what the state knows of displacement in proportion.
        let mut adaptive_noise = AdaptiveNoise::<f64>::new(AdaptiveNoiseConfig::default());
        for _ in 0..54 {
            let predicted = 0.1 * adaptive_noise.level_var();
            adaptive_noise.learn(&Vector3::repeat(1e-4), &Vector3::repeat(predicted));
        }
        assert!(adaptive_noise.level_var() < 2e-7, "{:e}", adaptive_noise.level_var());
        // Taken again it begins with what was left.
        assert!(adaptive_noise.as_prior().level_var() < 2e-8);
    }

    #[test]
    fn r_stays_where_the_state_explains_what_is_seen() {
        let start = AdaptiveNoiseConfig::<f64>::default().start_sd.powi(2);
        let (predicted, steps) = (Vector3::repeat(100.0 * start), 54);
        let after = |innovation: f64| {
            let mut adaptive_noise = AdaptiveNoise::<f64>::new(AdaptiveNoiseConfig::default());
            for _ in 0..steps {
                adaptive_noise.learn(&Vector3::repeat(innovation), &predicted);
            }
            adaptive_noise.level_var() / start
        };
        let (fits, far_smaller) = (after((101.0 * start).sqrt()), after((1e-4 * start).sqrt()));
        assert!((0.5..2.0).contains(&fits), "{fits}");
        assert!(far_smaller < 0.1, "{far_smaller}");
    }

    #[test]
    fn a_few_outliers_are_refused_and_no_more() {
        let mut adaptive_noise = AdaptiveNoise::<f64>::new(AdaptiveNoiseConfig::default());
        let taken: [bool; 6] = core::array::from_fn(|_| adaptive_noise.accepts(37.0));
        assert_eq!(taken, [false, false, false, true, false, false]);
        assert!(adaptive_noise.accepts(35.0));
    }
}
