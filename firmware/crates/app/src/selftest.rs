//! Self-test: what must hold before anything turns, and what was found where it does not.
//!
//! | item | by whom | criterion |
//! |---|---|---|
//! | IMU identity, range, own self-test, settings | sampling | the driver's |
//! | gravity | [`Inspection`] | mean of f within ±`gravity_share` of g |
//! | Earth rate | [`Inspection`] | at rest the mean rate is at most ω_ie and 5σ of the biases; never all zero |
//! | gyro noise | [`Inspection`] | told, and warned of where the settings say less than half of it |
//! | encoder | motor | identity, settings, readings |
//! | motor direction, pole pairs, free travel | the rotor's calibration and search | [`RotorFault`](crate::rotor::RotorFault) |
//!
//! On a base that swings nothing can be said of Earth's rate in a second: it is judged only where the
//! spread of the rate shows rest. Its gyros' noise is measured all the same ([`WhiteNoise`]). Vibration counts as noise
//! there, and filters within the IMU hide some: it is a warning, no more.

use drivers::Error;
use frames::{Sensor, Vec3, math, units, wording};
use nav::earth::OMEGA_IE;
use nav::increment::Sample;
use nav::noise::{ImuNoise, WhiteNoise};

use crate::fixed_decimal::{deg, deg_h, fixed_decimal};

/// What the inspection of the first samples is judged by.
///
/// | field | unit | zero means | sane value |
/// |---|---|---|---|
/// | `samples` | | judged at the first sample | one second's |
/// | `gravity` | m/s² | refused by every sample | 9.8 |
/// | `gravity_share` | | only the exact value passes | 0.2: heave of a ship; a wrong range is off by half |
/// | `rest_rate_sd` | rad/s | never judged to be at rest | 0.05 °/s |
/// | `rest_rate_max` | rad/s | rest never passes | 15 °/h and 5σ of three biases |
/// | `rate_max` | rad/s | nothing passes | 100 °/s |
/// | `angle_random_walk` | rad/√s | always warned | the filter's figure |
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct InspectionConfig {
    /// Samples looked at.
    pub samples: u16,
    /// Gravity at the place, m/s².
    pub gravity: f32,
    /// Greatest deviation from it, as a share.
    pub gravity_share: f32,
    /// Spread of each axis' rate below which the unit is at rest, rad/s.
    pub rest_rate_sd: f32,
    /// Largest mean rate at rest, rad/s.
    pub rest_rate_max: f32,
    /// Largest rate at all, rad/s.
    pub rate_max: f32,
    /// The gyros' noise as the settings say it, rad/√s.
    pub angle_random_walk: f32,
}

impl InspectionConfig {
    /// What an IMU with such figures must pass.
    pub fn for_imu(imu: &ImuNoise) -> Self {
        Self {
            samples: 200,
            gravity: 9.8,
            gravity_share: 0.2,
            rest_rate_sd: (0.05 * units::DEG) as f32,
            // 5σ of three.
            rest_rate_max: (OMEGA_IE + f64::from(imu.gyro_bias_sd) * 8.66) as f32,
            rate_max: (100.0 * units::DEG) as f32,
            angle_random_walk: imu.angle_random_walk,
        }
    }
}

/// What was found in the first samples.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Found {
    /// Magnitude of the mean specific force, m/s².
    pub gravity: f32,
    /// Magnitude of the mean rate, rad/s.
    pub rate: f32,
    /// Largest spread of an axis' rate, rad/s.
    pub rate_sd: f32,
    /// Noise of the noisiest gyro, as an angle random walk, rad/√s; 1σ of this figure is 8 %.
    pub noise: f32,
    /// The same as the settings say it.
    pub noise_told: f32,
}

impl Found {
    /// Whether the settings make far too little of the gyros' noise: heading is then worse than its σ says.
    pub fn is_noisy(&self) -> bool {
        self.noise > 2.0 * self.noise_told
    }
}

/// Why the self-test failed.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Failure {
    /// The IMU.
    Imu(Error),
    /// The encoder.
    Encoder(Error),
    /// Specific force is not gravity.
    Gravity {
        /// Its magnitude, m/s².
        found: f32,
        /// What it should be, m/s².
        expected: f32,
    },
    /// More rate at rest than Earth's and the biases'.
    EarthRate {
        /// Its magnitude, rad/s.
        found: f32,
        /// The most it may be, rad/s.
        most: f32,
    },
    /// The unit turns faster than anything it is made for.
    Rate {
        /// How fast, rad/s.
        found: f32,
    },
    /// A gyro gives nothing at all: real ones have noise.
    NoNoise,
    /// A part of the test did not end.
    Timeout {
        /// The IMU answered.
        imu: bool,
        /// The encoder answered.
        encoder: bool,
        /// The samples were inspected.
        inspected: bool,
    },
}

wording!(Failure, |self, say| {
    match *self {
        Self::Imu(error) => say!("IMU: {}", error),
        Self::Encoder(error) => say!("encoder: {}", error),
        Self::Gravity { found, expected } => say!(
            "specific force is {} m/s2, gravity {}: check the accelerometers' range",
            fixed_decimal(found, 3),
            fixed_decimal(expected, 3)
        ),
        Self::EarthRate { found, most } => say!(
            "rate at rest is {} deg/h, at most {} can be: check the gyros",
            deg_h(found),
            deg_h(most)
        ),
        Self::Rate { found } => say!("the unit turns at {} deg/s", deg(found, 0)),
        Self::NoNoise => say!("a gyro gives no signal at all"),
        Self::Timeout { imu: false, .. } => say!("the IMU's start did not end in time"),
        Self::Timeout { encoder: false, .. } => say!("the encoder's start did not end in time"),
        Self::Timeout { .. } => say!("the inspection of the samples did not end in time"),
    }
});

/// Means and spreads of the first samples.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Inspection {
    config: InspectionConfig,
    count: u16,
    /// Mean rate and specific force, running.
    rate: Vec3<Sensor>,
    force: Vec3<Sensor>,
    /// Sums of squares about the running mean (Welford).
    squares: [f32; 3],
    noise: WhiteNoise,
}

impl Inspection {
    /// Nothing seen yet.
    pub fn new(config: InspectionConfig) -> Self {
        Self {
            config,
            count: 0,
            rate: Vec3::zero(),
            force: Vec3::zero(),
            squares: [0.0; 3],
            noise: WhiteNoise::new(),
        }
    }

    /// Takes a sample; the verdict once there are enough.
    pub fn push(&mut self, sample: &Sample) -> Option<Result<Found, Failure>> {
        self.count += 1;
        let n = f32::from(self.count);
        let rate = sample.dtheta_s / sample.dt;
        let before = (rate - self.rate).to_array();
        self.rate = self.rate + (rate - self.rate) / n;
        let after = (rate - self.rate).to_array();
        for (sum, (b, a)) in self.squares.iter_mut().zip(before.into_iter().zip(after)) {
            *sum += b * a;
        }
        self.force = self.force + (sample.dv_s / sample.dt - self.force) / n;
        self.noise.push(sample.dtheta_s, sample.dt, sample.gap > 0.0);
        (self.count >= self.config.samples).then(|| self.verdict())
    }

    fn sds(&self) -> [f32; 3] {
        self.squares.map(|sum| math::sqrt(sum / f32::from(self.count)))
    }

    /// What was found so far, whatever the verdict on it is.
    pub fn found(&self) -> Found {
        Found {
            gravity: self.force.norm(),
            rate: self.rate.norm(),
            rate_sd: self.sds().into_iter().fold(0.0, f32::max),
            noise: self.noise.density().into_iter().fold(0.0, f32::max),
            noise_told: self.config.angle_random_walk,
        }
    }

    fn verdict(&self) -> Result<Found, Failure> {
        let c = &self.config;
        let (sds, found) = (self.sds(), self.found());
        if (found.gravity - c.gravity).abs() > c.gravity_share * c.gravity {
            return Err(Failure::Gravity {
                found: found.gravity,
                expected: c.gravity,
            });
        }
        if found.rate > c.rate_max {
            return Err(Failure::Rate { found: found.rate });
        }
        if self
            .rate
            .to_array()
            .into_iter()
            .zip(sds)
            .any(|(rate, sd)| rate == 0.0 && sd == 0.0)
        {
            return Err(Failure::NoNoise);
        }
        if found.rate_sd < c.rest_rate_sd && found.rate > c.rest_rate_max {
            return Err(Failure::EarthRate {
                found: found.rate,
                most: c.rest_rate_max,
            });
        }
        Ok(found)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::chance::normal;

    fn inspect(rate: impl Fn(u16) -> [f32; 3], force: f32) -> Result<Found, Failure> {
        inspected(rate, force).1
    }

    fn inspected(rate: impl Fn(u16) -> [f32; 3], force: f32) -> (Found, Result<Found, Failure>) {
        let mut inspection = Inspection::new(InspectionConfig::for_imu(&ImuNoise::default()));
        for k in 0.. {
            let [x, y, z] = rate(k);
            let sample = Sample {
                dtheta_s: Vec3::new(x, y, z) * 0.005,
                dv_s: Vec3::new(0.0, 0.0, force * 0.005),
                dt: 0.005,
                gap: 0.0,
            };
            if let Some(verdict) = inspection.push(&sample) {
                return (inspection.found(), verdict);
            }
        }
        panic!("no verdict")
    }

    fn noise(k: u16) -> f32 {
        if k.is_multiple_of(2) { 1e-4 } else { -1e-4 }
    }

    #[test]
    fn rest_at_earth_rate_passes() {
        let found = inspect(|k| [noise(k), 5e-5 + noise(k), 5e-5 + noise(k)], 9.8).unwrap();
        assert!((found.gravity - 9.8).abs() < 1e-3 && (found.rate - 7.07e-5).abs() < 1e-6);
    }

    /// A ship that heaves by 0.15 g is at no fault.
    #[test]
    fn heave_passes() {
        for force in [8.3, 11.3] {
            let found = inspect(|k| [noise(k), 5e-5 + noise(k), noise(k)], force).unwrap();
            assert!((found.gravity - force).abs() < 1e-3, "{found:?}");
        }
    }

    #[test]
    fn what_is_wrong_is_named() {
        type Case = (fn(u16) -> [f32; 3], f32, fn(&Failure) -> bool);
        let table: [Case; 5] = [
            (|k| [noise(k); 3], 4.9, |f| matches!(f, Failure::Gravity { .. })),
            (|k| [noise(k); 3], 12.0, |f| matches!(f, Failure::Gravity { .. })),
            (
                |k| [noise(k) + 1e-3; 3],
                9.8,
                |f| matches!(f, Failure::EarthRate { .. }),
            ),
            (|k| [noise(k), 0.0, noise(k)], 9.8, |f| *f == Failure::NoNoise),
            (
                |k| [noise(k), 3.0, noise(k)],
                9.8,
                |f| matches!(f, Failure::Rate { .. }),
            ),
        ];
        for (rate, force, expected) in table {
            let (found, verdict) = inspected(rate, force);
            let failure = verdict.unwrap_err();
            assert!(expected(&failure), "{failure}");
            // It is known all the same.
            assert!((found.gravity - force).abs() < 1e-3, "{found:?}");
        }
    }

    /// White noise of 1σ `sd`, on a swing of 8 °/s with a period of 2 s.
    fn noisy_swing(sd: f32) -> impl Fn(u16) -> [f32; 3] {
        move |k| {
            let swing = 0.14 * math::sin_cos(0.0157 * f32::from(k)).0;
            core::array::from_fn(|axis| {
                let mut state = (u64::from(k) * 3 + axis as u64 + 1) << 32;
                swing + sd * normal(&mut state)
            })
        }
    }

    #[test]
    fn the_gyros_noise_is_found_on_a_swing() {
        // 0.02 and 0.09 °/√h at 200 samples a second.
        for walk in [5.8e-6_f32, 2.6e-5] {
            let sd = walk / math::sqrt(0.005);
            let found = inspect(noisy_swing(sd), 9.8).unwrap();
            assert!(
                (0.85..1.25).contains(&(found.noise / walk)),
                "{} of {walk}",
                found.noise
            );
            assert_eq!(found.is_noisy(), walk > 1e-5);
        }
        // Without noise, what the swing leaves: 0.0003 °/√h.
        let found = inspect(noisy_swing(0.0), 9.8).unwrap();
        assert!(found.noise < 1e-7, "{}", found.noise);
    }

    #[test]
    fn a_swinging_base_is_not_judged_by_earth_rate() {
        assert!(
            inspect(
                |k| [0.2 * math::sin_cos(0.006 * f32::from(k)).0, noise(k), noise(k)],
                9.8
            )
            .is_ok()
        );
    }
}
