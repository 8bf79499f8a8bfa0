//! Deviation: the gyro error that is constant in the housing, as an alignment at several headings finds it.
//!
//! At one heading such an error e is not told from Earth's level rate ω_ie cos L, and turns heading by up to e/(ω_ie cos L): 2.5°
//! for 0.5 °/h at 40° of latitude. When the base turns, e turns with it, and north does not. The filter has h and G as states, so
//! it finds e by itself while it runs through other headings, without outside truth. What it has found is kept for the
//! alignments to come, which need not turn.
//!
//! Two terms of the [`model`](crate::model) act as e: h itself, and the g-sensitivity G of the gyros under the level part f of a
//! tilted housing's specific force, of which a rotor that turns about z leaves
//!
//! ```text
//! e = h + ½ (G_xx + G_yy) f + ½ (G_yx − G_xy) z × f
//! ```
//!
//! Only their sum is found while the tilt stays what it is. It is kept as what it is, one measurement of the sum at f: an
//! alignment under the same tilt knows e, one under another tilt knows it as far as G allows.

use frames::{Real, math};
use nalgebra::Vector3;

use crate::{
    constraint::{Row, product},
    covariance::Covariance,
    model::{GX, GY, HB},
};

/// The gyro error of the housing, level components in b. See the [module](self).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Deviation<T: Real = f32> {
    /// e_x and e_y, rad/s.
    pub rate_b: [T; 2],
    /// Level part of the mean specific force that they hold for, m/s².
    pub force_b: [T; 2],
    /// 1σ of each, rad/s.
    pub sd: T,
}

impl<T: Real> Deviation<T> {
    /// Whether every figure is finite, and the σ positive.
    pub fn is_valid(&self) -> bool {
        let Self { rate_b, force_b, sd } = self;
        let finite = rate_b.iter().chain(force_b).all(|x| x.finite());
        finite && sd.finite() && *sd > T::zero()
    }

    /// How e depends on the states.
    fn rows<const B: usize>(force_b: &[T; 2]) -> [[Vector3<T>; B]; 2] {
        let [x, y] = force_b.map(|f| f * T::lit(0.5));
        let (zero, one) = (T::zero(), T::one());
        let row = |of_gx, of_gy, of_h| {
            core::array::from_fn(|block| match block {
                GX => of_gx,
                GY => of_gy,
                HB => of_h,
                _ => Vector3::zeros(),
            })
        };
        [
            row(
                Vector3::new(x, -y, zero),
                Vector3::new(y, x, zero),
                Vector3::new(one, zero, zero),
            ),
            row(
                Vector3::new(y, x, zero),
                Vector3::new(-x, y, zero),
                Vector3::new(zero, one, zero),
            ),
        ]
    }

    /// What `state`, by blocks of the model, with this covariance says of it under the level force `force_b`.
    pub(crate) fn found<const B: usize>(
        state: &[Vector3<T>; B],
        covariance: &Covariance<T, B>,
        force_b: [T; 2],
    ) -> Self {
        let rows = Self::rows(&force_b);
        let [x, y] = rows.each_ref().map(|row| Row::new(covariance, row));
        let [row_x, row_y] = &rows;
        // The longer axis of the ellipse.
        let half = T::lit(0.5);
        let (mean, apart) = (
            (x.predicted_var + y.predicted_var) * half,
            (x.predicted_var - y.predicted_var) * half,
        );
        let var = mean + math::hypot(apart, x.covariance_with(row_y));
        Self {
            rate_b: [product(row_x, state), product(row_y, state)],
            force_b,
            sd: math::sqrt(var),
        }
    }

    /// Takes it as a measurement into a prior; returns the state that goes with it.
    pub(crate) fn measured<const B: usize>(&self, covariance: &mut Covariance<T, B>) -> [Vector3<T>; B] {
        let mut state = [Vector3::zeros(); B];
        for (row, rate) in Self::rows(&self.force_b).iter().zip(self.rate_b) {
            let gain = Row::new(covariance, row).update(covariance, self.sd * self.sd);
            let innovation = rate - product(row, &state);
            for (part, column) in state.iter_mut().zip(&gain.column) {
                *part += column * innovation;
            }
        }
        state
    }
}

#[cfg(test)]
mod tests {
    use frames::units::{DEG, DEG_PER_HOUR};
    use frames::{Body, Rot, Sensor, Vec3};

    use super::*;
    use crate::{fine::FilterConfig, model::ROBUST};

    const FORCE_B: [f64; 2] = [0.8, -0.5];

    /// h and G, the columns of x and y, of a bad gyro.
    fn state() -> [Vector3<f64>; ROBUST] {
        let mut state = [Vector3::zeros(); ROBUST];
        state[HB] = Vector3::new(0.3, -0.4, 0.0) * DEG_PER_HOUR;
        state[GX] = Vector3::new(2.0, -1.2, 3.0) * DEG_PER_HOUR;
        state[GY] = Vector3::new(0.7, 1.1, -2.0) * DEG_PER_HOUR;
        state
    }

    fn prior() -> Covariance<f64, ROBUST> {
        let square = |sd: f64| Vector3::repeat(sd * sd);
        let mut variances = [square(1.0); ROBUST];
        variances[HB] = square(0.5 * DEG_PER_HOUR);
        variances[GX] = square(2.0 * DEG_PER_HOUR);
        variances[GY] = variances[GX];
        Covariance::diagonal(variances)
    }

    #[test]
    fn it_is_what_a_turn_of_the_rotor_leaves_of_both_terms() {
        let state = state();
        let force_b = Vec3::<Body, f64>::new(FORCE_B[0], FORCE_B[1], 9.8);
        let mut mean = Vec3::<Body, f64>::zero();
        for degree in 0..360 {
            let c_bs = Rot::<Body, Sensor, f64>::about_z(f64::from(degree) * DEG);
            let force_s = c_bs.inverse() * force_b;
            let by_force = state[GX] * force_s.x() + state[GY] * force_s.y();
            mean += (c_bs * Vec3::from_vector(by_force)) / 360.0;
        }
        let mean = mean + Vec3::from_vector(state[HB]);
        let found = Deviation::found(&state, &prior(), FORCE_B);
        for (found, mean) in found.rate_b.iter().zip([mean.x(), mean.y()]) {
            assert!((found - mean).abs() < 1e-9 * DEG_PER_HOUR, "{found} {mean}");
        }
        // h by itself, and two elements of G by half the force for each component of it.
        let by_force = 2.0 * (2.0_f64 * 0.5).powi(2) * (0.8_f64.powi(2) + 0.5_f64.powi(2));
        let sd = math::sqrt(0.5 * 0.5 + by_force) * DEG_PER_HOUR;
        assert!((found.sd / sd - 1.0).abs() < 1e-12, "{found:?} {sd}");
    }

    #[test]
    fn what_was_kept_is_known_under_the_same_tilt_and_by_g_sensitivity_under_another() {
        let kept = Deviation {
            sd: 0.1 * DEG_PER_HOUR,
            ..Deviation::found(&state(), &prior(), FORCE_B)
        };
        let mut covariance = prior();
        let state = kept.measured(&mut covariance);
        assert!(covariance.is_sound());
        let again = Deviation::found(&state, &covariance, FORCE_B);
        // The prior has a share in it.
        let share = (kept.sd / Deviation::found(&state, &prior(), FORCE_B).sd).powi(2);
        for (again, kept) in again.rate_b.iter().zip(kept.rate_b) {
            assert!(
                (again - kept * (1.0 - share)).abs() < 0.01 * DEG_PER_HOUR,
                "{again} {kept}"
            );
        }
        assert!(again.sd < kept.sd && again.sd > 0.9 * kept.sd, "{again:?}");
        let level = Deviation::found(&state, &covariance, [0.0; 2]);
        assert!(level.sd > 0.3 * DEG_PER_HOUR, "{level:?}");
    }

    /// What the first component says of the second is not taken twice.
    #[test]
    fn components_that_are_correlated_come_out_as_they_were_kept() {
        let mut covariance = prior();
        let correlated = 0.8 * (0.5 * DEG_PER_HOUR).powi(2);
        let block = nalgebra::Matrix3::new(0.0, correlated, 0.0, correlated, 0.0, 0.0, 0.0, 0.0, 0.0);
        covariance.add(HB, HB, &block);
        let kept = Deviation {
            rate_b: [0.3, -0.4].map(|rate| rate * DEG_PER_HOUR),
            force_b: [0.0; 2],
            sd: 0.001 * DEG_PER_HOUR,
        };
        let state = kept.measured(&mut covariance);
        let again = Deviation::found(&state, &covariance, [0.0; 2]);
        for (again, kept) in again.rate_b.iter().zip(kept.rate_b) {
            assert!((again - kept).abs() < 0.01 * DEG_PER_HOUR, "{again} {kept}");
        }
    }

    #[test]
    fn one_that_cannot_be_is_refused() {
        let good = Deviation::<f32> {
            rate_b: [1e-6, 0.0],
            force_b: [0.0; 2],
            sd: 1e-7,
        };
        for (deviation, valid) in [
            (good, true),
            (Deviation { sd: 0.0, ..good }, false),
            (
                Deviation {
                    rate_b: [f32::NAN, 0.0],
                    ..good
                },
                false,
            ),
        ] {
            let config = FilterConfig::<f32> {
                deviation: Some(deviation),
                ..FilterConfig::default()
            };
            assert_eq!(config.validate().is_ok(), valid, "{deviation:?}");
        }
    }
}
