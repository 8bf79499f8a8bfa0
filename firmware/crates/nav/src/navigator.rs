//! Navigation after alignment: the unit's samples in, attitude, velocity and place out, with nothing but the IMU.
//!
//! ```text
//! sample ─► gap bridged ─► increment ─► decimated ─► corrected by the alignment's biases ─► Mechanization ─► estimate
//! ```
//!
//! The [`Mechanization`] of \[Du16\] with what the alignment knew at its end: attitude, velocity, biases. Nothing is
//! estimated any more; the rotor goes on turning, so that the level biases that are left average out and only the z
//! gyro's is added up.
//!
//! # How far it is to be trusted
//!
//! After t seconds, in place of a covariance, with b the 1σ of the biases the alignment has left:
//!
//! ```text
//! heading²  = heading₀² + ARW² t + (b_z t)²
//! tilt²     = tilt₀² + ARW² t + min(b_xy t, b_xy/ω_s)²        ω_s = √(g/R), a turn in 84 minutes
//! ```
//!
//! The first is what it is; the second is above it, since the rotor is taken not to turn. Velocity and place have no 1σ
//! here: they are those of a free-running navigator of MEMS gyros, metres in the first minute and hundreds in the tenth.

use frames::{Attitude, AttitudeSd, Body, Nav, Real, Rot, Sensor, Vec3, math};

use crate::aligner::Estimate;
use crate::increment::{Compensator, Decimator, Sample};
use crate::mechanization::{Mechanization, MechanizationError, Position, Vertical};
use crate::strapdown::Corrections;

/// ω_s, rad/s.
const SCHULER: f64 = 1.241e-3;

/// Figures of the navigator.
///
/// | field | unit | zero means | sane value |
/// |---|---|---|---|
/// | `decimate_to` | s | every sample by itself | 50 ms |
/// | `longest_gap` | s | no gap is bridged | 0.5 s |
/// | `angle_random_walk` | rad/√s | gyros without noise | that of the IMU |
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct NavigatorConfig<T: Real = f32> {
    /// Whether the height is held.
    pub vertical: Vertical,
    /// Length of the increments that are navigated by, s.
    pub decimate_to: T,
    /// Longest time without data that is bridged, s.
    pub longest_gap: T,
    /// Angle random walk of the gyros, for the 1σ of the attitude.
    pub angle_random_walk: T,
}

/// Why navigation ends.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum NavigatorError<T: Real = f32> {
    /// The mechanization cannot go on.
    Mechanization(MechanizationError),
    /// No data for longer than is bridged.
    Gap {
        /// How long, s.
        length: T,
    },
    /// A sample that cannot be: see [`Sample::is_valid`].
    Sample,
}

impl<T: Real> From<MechanizationError> for NavigatorError<T> {
    fn from(error: MechanizationError) -> Self {
        Self::Mechanization(error)
    }
}

impl<T: Real> core::fmt::Display for NavigatorError<T> {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            Self::Mechanization(e) => e.fmt(f),
            Self::Gap { length } => write!(f, "{:.3} s without data: align again", length.to_f64()),
            Self::Sample => f.write_str("a sample is not finite or beyond the range of an IMU: align again"),
        }
    }
}

impl<T: Real> core::error::Error for NavigatorError<T> {}

/// What the alignment knew at its end.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct HandOver<T: Real = f32> {
    /// Attitude, its 1σ, the 1σ of the biases.
    pub estimate: Estimate<T>,
    /// Velocity, m/s.
    pub v_n: Vec3<Nav, T>,
    /// What the sensors are corrected by.
    pub corrections: Corrections<T>,
    /// The rotor's position at that instant.
    pub c_bs: Rot<Body, Sensor, T>,
}

/// Where the unit is and how it moves.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Track<T: Real = f32> {
    /// Velocity in n, m/s.
    pub v_n: Vec3<Nav, T>,
    /// The place, as well as the scalar can say it.
    pub position: Position<T>,
}

/// See the module.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Navigator<T: Real = f32> {
    config: NavigatorConfig<T>,
    mechanization: Mechanization<T>,
    from: HandOver<T>,
    compensator: Compensator<T>,
    decimator: Decimator<T>,
    last: Option<Sample<T>>,
    c_sb: Rot<Sensor, Body, T>,
    /// Since the alignment's end, s.
    t: T,
}

impl<T: Real> Navigator<T> {
    /// Goes on at `start` from what the alignment knew after its last sample.
    ///
    /// # Errors
    /// [`MechanizationError`] where place or velocity cannot be.
    pub fn new(config: NavigatorConfig<T>, start: Position<T>, from: &HandOver<T>) -> Result<Self, MechanizationError> {
        Ok(Self {
            mechanization: Mechanization::new(start, from.v_n, from.estimate.c_nb * from.c_bs, config.vertical)?,
            from: *from,
            compensator: Compensator::new(),
            decimator: Decimator::new(config.decimate_to),
            last: None,
            c_sb: from.c_bs.inverse(),
            t: T::zero(),
            config,
        })
    }

    /// Takes one sample and the rotor's angle at its end, rad.
    ///
    /// # Errors
    /// [`NavigatorError`]: navigation is over, what is known stays as it was.
    pub fn step(&mut self, sample: &Sample<T>, alpha: T) -> Result<(), NavigatorError<T>> {
        if !(sample.is_valid() && alpha.finite()) {
            return Err(NavigatorError::Sample);
        }
        if sample.gap > T::zero() {
            let length = sample.gap;
            if length > self.config.longest_gap {
                return Err(NavigatorError::Gap { length });
            }
            let before = self.last.unwrap_or(*sample);
            self.advance(&before.bridge(sample, length))?;
        }
        self.advance(sample)?;
        self.last = Some(*sample);
        self.c_sb = Rot::about_z(alpha).inverse();
        Ok(())
    }

    fn advance(&mut self, sample: &Sample<T>) -> Result<(), NavigatorError<T>> {
        let increment = self.compensator.increment(sample);
        self.t += sample.dt;
        if let Some(joined) = self.decimator.push(&increment) {
            self.mechanization.step(&self.from.corrections.corrected(&joined))?;
        }
        Ok(())
    }

    /// Time since the alignment's end, s.
    pub fn time(&self) -> T {
        self.t
    }

    /// Attitude with its 1σ, now; the biases are those of the alignment.
    pub fn estimate(&self) -> Estimate<T> {
        let mut c_ns = self.mechanization.c_ns();
        if let Some(pending) = self.decimator.pending() {
            // Earth turns by 4e-6 rad in a whole increment.
            c_ns = c_ns * Rot::exp(self.from.corrections.corrected(&pending).phi_s);
        }
        let c_nb = (c_ns * self.c_sb).normalized();
        Estimate {
            c_nb,
            attitude: Attitude::from_rot(&c_nb),
            sd: self.sd(),
            ..self.from.estimate
        }
    }

    /// Velocity and place at the end of the last increment.
    pub fn track(&self) -> Track<T> {
        Track {
            v_n: self.mechanization.velocity(),
            position: self.mechanization.position(),
        }
    }

    fn sd(&self) -> AttitudeSd<T> {
        let square = |x: T| x * x;
        let (t, before, bias) = (self.t, &self.from.estimate.sd, &self.from.estimate.gyro_bias_sd);
        let walk = square(self.config.angle_random_walk) * t;
        let level = bias.x().max(bias.y());
        let level = walk + square((level * t).min(level / T::lit(SCHULER)));
        AttitudeSd {
            heading: math::sqrt(square(before.heading) + walk + square(bias.z() * t)),
            pitch: math::sqrt(square(before.pitch) + level),
            roll: math::sqrt(square(before.roll) + level),
        }
    }
}
