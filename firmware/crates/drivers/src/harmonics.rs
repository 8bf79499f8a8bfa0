//! Correction of an encoder's repeating error.
//!
//! Magnet, mounting and sensor give a magnetic encoder an error that repeats with the turn and is
//! made of a few harmonics:
//!
//! ```text
//! reading = angle + Σ A_k sin(k · reading + φ_k)
//! ```
//!
//! The error goes straight into heading (the rotor angle is subtracted from the azimuth of the IMU),
//! so it is measured once against a reference and stored. The table is a function of the *reading*:
//! the correction is one evaluation, no iteration.
//!
//! Not modelled: change of the error with temperature, load and age.

use frames::math;

/// One harmonic of the error.
///
/// | field | unit | zero means | sane value |
/// |---|---|---|---|
/// | `order` | per turn | a constant offset | 1, 2, 4, pole pairs |
/// | `amplitude` | rad | the harmonic is absent | 1e-5 … 1e-3 |
/// | `phase` | rad | a sine of the reading | any |
#[derive(Debug, Clone, Copy, PartialEq, Default)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Harmonic {
    /// Periods in a turn.
    pub order: u16,
    /// Amplitude, rad.
    pub amplitude: f32,
    /// Phase at reading zero, rad.
    pub phase: f32,
}

/// Why a table is refused.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum HarmonicsError {
    /// An amplitude or phase is not a number, or infinite.
    NotFinite {
        /// Row of the table.
        row: usize,
    },
    /// Σ k·A_k is 1 or more: the corrected angle would run backwards somewhere.
    NotMonotonic,
}

frames::wording!(HarmonicsError, |self, say| {
    match self {
        Self::NotFinite { row } => say!(
            "row {} of the encoder table is not a number: measure the table anew",
            row
        ),
        Self::NotMonotonic => {
            say!("the encoder table is too large to be a correction: check that it is in radians");
        }
    }
});

impl core::error::Error for HarmonicsError {}

/// A checked correction table of `N` harmonics. The default corrects nothing.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Harmonics<const N: usize>([Harmonic; N]);

impl<const N: usize> Default for Harmonics<N> {
    fn default() -> Self {
        Self([Harmonic::default(); N])
    }
}

impl<const N: usize> Harmonics<N> {
    /// Checks a table.
    ///
    /// # Errors
    /// [`HarmonicsError`] where it is not a small, invertible correction.
    pub fn new(rows: [Harmonic; N]) -> Result<Self, HarmonicsError> {
        let mut slope = 0.0;
        for (row, h) in rows.iter().enumerate() {
            if !(h.amplitude.is_finite() && h.phase.is_finite()) {
                return Err(HarmonicsError::NotFinite { row });
            }
            slope += f32::from(h.order) * h.amplitude.abs();
        }
        if slope < 1.0 {
            Ok(Self(rows))
        } else {
            Err(HarmonicsError::NotMonotonic)
        }
    }

    /// The rows.
    pub fn rows(&self) -> &[Harmonic; N] {
        &self.0
    }

    /// The error at this reading, rad.
    pub fn error(&self, reading: f32) -> f32 {
        self.0
            .iter()
            .map(|h| h.amplitude * math::sin_cos(f32::from(h.order) * reading + h.phase).0)
            .sum()
    }

    /// The corrected angle in [0, 2π), rad, for a reading in [0, 2π).
    pub fn correct(&self, reading: f32) -> f32 {
        math::wrap_two_pi(reading - self.error(reading))
    }
}

#[cfg(test)]
mod tests {
    use core::f32::consts::TAU;

    use proptest::prelude::*;

    use super::*;

    const TABLE: [Harmonic; 3] = [
        Harmonic {
            order: 1,
            amplitude: 2e-3,
            phase: 0.4,
        },
        Harmonic {
            order: 2,
            amplitude: 7e-4,
            phase: -1.0,
        },
        Harmonic {
            order: 22,
            amplitude: 1e-5,
            phase: 2.0,
        },
    ];

    /// Find the reading that belongs to an angle by iteration in f64, correct it, compare.
    #[test]
    fn removes_the_error_it_describes() {
        let table = Harmonics::new(TABLE).unwrap();
        for k in 0..1000 {
            let angle = f64::from(k) / 1000.0 * core::f64::consts::TAU;
            let mut reading = angle;
            for _ in 0..20 {
                let error: f64 = TABLE
                    .iter()
                    .map(|h| f64::from(h.amplitude) * (f64::from(h.order) * reading + f64::from(h.phase)).sin())
                    .sum();
                reading = angle + error;
            }
            let corrected = table.correct(reading.rem_euclid(core::f64::consts::TAU) as f32);
            let off = math::wrap_pi(f64::from(corrected) - angle);
            assert!(off.abs() < 1e-6, "{angle} {off:e}");
        }
    }

    #[test]
    fn an_empty_table_changes_nothing() {
        assert_eq!(Harmonics::<4>::default().correct(1.25), 1.25);
        assert_eq!(Harmonics::<0>::default().correct(0.0), 0.0);
    }

    #[test]
    fn impossible_tables_are_refused() {
        let row = |order, amplitude| Harmonic {
            order,
            amplitude,
            phase: 0.0,
        };
        assert_eq!(
            Harmonics::new([row(1, 0.1), row(1, f32::NAN)]),
            Err(HarmonicsError::NotFinite { row: 1 })
        );
        assert_eq!(
            Harmonics::new([row(2, 0.3), row(4, 0.1)]),
            Err(HarmonicsError::NotMonotonic)
        );
    }

    proptest! {
        #[test]
        fn stays_in_the_turn(reading in 0.0_f32..TAU) {
            let angle = Harmonics::new(TABLE).unwrap().correct(reading);
            prop_assert!((0.0..TAU).contains(&angle));
        }
    }
}
