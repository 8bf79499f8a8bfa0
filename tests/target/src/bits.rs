//! A whole alignment, and a hash over the bits of all it says.

use frames::units::DEG;
use frames::{Attitude, AttitudeSd, Real};
use nav::aligner::{Aligner, AlignerConfig, Event, Mode};
use nav::fine::FilterConfig;
use nav::rotor::RotorConfig;

use crate::motion::{DT, LATITUDE, Motion, Reading};

/// Samples of the run: 120 s. Coarse alignment ends after 54 s, and the filter is live for a minute.
pub const SAMPLES: u32 = 12_000;
/// Samples from one estimate to the next.
const EVERY: u32 = 10;

/// The aligner that is looked at: the unit's own.
pub type Core = Aligner<f32>;

/// Its configuration: the unit's defaults at the place of [`Motion`].
pub fn config() -> AlignerConfig {
    AlignerConfig::for_rotor(
        f32::lit(LATITUDE),
        0.0,
        &RotorConfig::default(),
        FilterConfig::default(),
    )
}

/// FNV-1a over 32-bit words, 64 bits wide.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Hash(pub u64);

impl Hash {
    const fn new() -> Self {
        Self(0xCBF2_9CE4_8422_2325)
    }

    fn push(&mut self, values: &[f32]) {
        for value in values {
            self.0 = (self.0 ^ u64::from(value.to_bits())).wrapping_mul(0x0100_0000_01B3);
        }
    }

    fn attitude(&mut self, attitude: &Attitude, sd: &AttitudeSd) {
        self.push(&[attitude.heading, attitude.pitch, attitude.roll]);
        self.push(&[sd.heading, sd.pitch, sd.roll]);
    }
}

/// What the run came to.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Outcome {
    /// Over the samples that went in.
    pub samples: Hash,
    /// Over all that came out: events, the coarse attitude, each estimate, each innovation.
    pub estimates: Hash,
    /// Estimates among them.
    pub count: u32,
    /// Whether the aligner called itself aligned at the end.
    pub aligned: bool,
    /// Heading less the true one at the end, degrees.
    pub heading_error_deg: f32,
    /// Its σ, degrees.
    pub heading_sd_deg: f32,
}

/// Runs `aligner`, which must be new, from the first sample to the last.
pub fn run(aligner: &mut Core, motion: &mut Motion) -> Outcome {
    let mut outcome = Outcome {
        samples: Hash::new(),
        estimates: Hash::new(),
        count: 0,
        aligned: false,
        heading_error_deg: f32::NAN,
        heading_sd_deg: f32::NAN,
    };
    for k in 1..=SAMPLES {
        let Reading { sample, alpha } = motion.next_reading();
        outcome.samples.push(&sample.dtheta_s.to_array());
        outcome.samples.push(&sample.dv_s.to_array());
        outcome.samples.push(&[alpha]);
        let said = &mut outcome.estimates;
        match aligner.step(&sample, alpha) {
            Some(Event::CoarseDone { attitude, sd }) => said.attitude(&attitude, &sd),
            Some(Event::CaughtUp) => said.push(&[1.0, k as f32]),
            Some(Event::Aligned) => said.push(&[2.0, k as f32]),
            Some(_) => said.push(&[3.0, k as f32]),
            None => {}
        }
        if !k.is_multiple_of(EVERY) {
            continue;
        }
        if let Some((innovation, ratio)) = aligner.innovation() {
            said.push(&innovation.residual.to_array());
            said.push(&[innovation.nis, ratio]);
        }
        let Some(estimate) = aligner.estimate() else { continue };
        said.push(&estimate.c_nb.quaternion());
        said.attitude(&estimate.attitude, &estimate.sd);
        for v in [
            estimate.gyro_bias_s,
            estimate.gyro_bias_sd,
            estimate.accel_bias_s,
            estimate.accel_bias_sd,
        ] {
            said.push(&v.to_array());
        }
        outcome.count += 1;
        if k == SAMPLES {
            let degree = f32::lit(DEG);
            let truth = Attitude::from_rot(&motion.c_nb().cast::<f32>());
            outcome.heading_error_deg = frames::math::wrap_pi(estimate.attitude.heading - truth.heading) / degree;
            outcome.heading_sd_deg = estimate.sd.heading / degree;
        }
    }
    outcome.aligned = aligner.mode() == Mode::Aligned;
    outcome
}

/// Time that the run covers, s.
pub const fn seconds() -> f64 {
    SAMPLES as f64 * DT
}

/// The run from nothing. `None` never: the figures are in range.
pub fn outcome() -> Option<Outcome> {
    Some(run(&mut Core::new(config()).ok()?, &mut Motion::new()?))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// What is hashed is an alignment and not some failure that is the same everywhere.
    #[test]
    fn the_run_ends_aligned_and_right() {
        let outcome = outcome().unwrap();
        assert!(outcome.aligned && outcome.count > 600, "{outcome:?}");
        assert!(
            outcome.heading_error_deg.abs() < 3.0 * outcome.heading_sd_deg,
            "{outcome:?}"
        );
        assert!(outcome.heading_sd_deg < 1.0, "{outcome:?}");
        // The same again: nothing is left over from one run to the next.
        assert_eq!(super::outcome(), Some(outcome));
    }

    #[test]
    fn the_hash_sees_every_bit() {
        let hash = |values: &[f32]| {
            let mut hash = Hash::new();
            hash.push(values);
            hash
        };
        assert_ne!(hash(&[1.0]), hash(&[f32::from_bits(1.0_f32.to_bits() ^ 1)]));
        assert_ne!(hash(&[0.0]), hash(&[-0.0]));
        assert_ne!(hash(&[1.0, 2.0]), hash(&[2.0, 1.0]));
    }
}
