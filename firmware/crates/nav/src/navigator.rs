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

use frames::{Attitude, AttitudeSd, Nav, Real, Rot, Vec3, math};

use crate::aligner::{AlignmentResult, Estimate};
use crate::increment::{ConingScullingCorrector, Decimator, Sample};
use crate::mechanization::{Mechanization, MechanizationError, Position, Vertical};

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
    from: AlignmentResult<T>,
    corrector: ConingScullingCorrector<T>,
    decimator: Decimator<T>,
    last: Option<Sample<T>>,
    /// The rotor's angle at the end of the last sample, rad.
    alpha: T,
    /// Since the alignment's end, s.
    t: T,
}

impl<T: Real> Navigator<T> {
    /// Goes on at `start` from what the alignment knew after its last sample.
    ///
    /// # Errors
    /// [`MechanizationError`] where place or velocity cannot be.
    pub fn new(
        config: NavigatorConfig<T>,
        start: Position<T>,
        from: &AlignmentResult<T>,
    ) -> Result<Self, MechanizationError> {
        Ok(Self {
            mechanization: Mechanization::new(
                start,
                from.v_n,
                from.estimate.c_nb * Rot::about_z(from.alpha) * from.rotor_in_s.inverse(),
                config.vertical,
            )?,
            from: *from,
            corrector: ConingScullingCorrector::new(),
            decimator: Decimator::new(config.decimate_to),
            last: None,
            alpha: from.alpha,
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
            // Where the rotor was at the end of the gap, to the turn of the housing in one sample.
            self.advance(&before.bridge(sample, length), alpha - sample.dtheta_s.z())?;
        }
        self.advance(sample, alpha)?;
        self.last = Some(*sample);
        self.alpha = alpha;
        Ok(())
    }

    fn advance(&mut self, sample: &Sample<T>, alpha: T) -> Result<(), NavigatorError<T>> {
        let increment = self.corrector.increment(sample);
        self.t += sample.dt;
        if let Some(joined) = self.decimator.push(&increment) {
            self.mechanization
                .step(&self.from.corrections.corrected(&joined, alpha))?;
        }
        Ok(())
    }

    /// Takes velocity and place from somebody who knows them better, such as a receiver of satellite navigation: the
    /// horizontal velocity, m/s north and east, and latitude and longitude, rad, where they are known. Attitude and
    /// height stay as they are.
    ///
    /// # Errors
    /// [`MechanizationError`] where they cannot be; nothing is taken then.
    pub fn fix(&mut self, north_east: [T; 2], place: Option<[T; 2]>) -> Result<(), MechanizationError> {
        let Track { v_n, position } = self.track();
        let [north, east] = north_east;
        let position = place.map_or(position, |[latitude, longitude]| Position {
            latitude,
            longitude,
            ..position
        });
        self.mechanization.fix(position, Vec3::new(east, north, v_n.z()))
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
            c_ns = c_ns * Rot::exp(self.from.corrections.corrected(&pending, self.alpha).phi_s);
        }
        let c_nb = (c_ns * self.from.rotor_in_s * Rot::about_z(self.alpha).inverse()).normalized();
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

#[cfg(test)]
mod tests {
    use frames::units::{DEG, DEG_PER_HOUR, MICRO_G};
    use frames::{Body, Sensor};

    use super::*;
    use crate::earth::Earth;
    use crate::strapdown::Corrections;

    const DT: f64 = 0.01;
    const RATE: f64 = 20.0 * DEG;
    const PLACE: Position<f64> = Position {
        latitude: 40.0 * DEG,
        longitude: 0.1,
        height: 0.0,
    };
    const CONFIG: NavigatorConfig<f64> = NavigatorConfig {
        vertical: Vertical::Held,
        decimate_to: 0.05,
        longest_gap: 0.5,
        angle_random_walk: 1e-5,
    };

    fn gyro_bias() -> Vec3<Sensor, f64> {
        Vec3::new(5.0, -3.0, 8.0) * DEG_PER_HOUR
    }

    fn accel_bias() -> Vec3<Sensor, f64> {
        Vec3::new(80.0, -50.0, 100.0) * MICRO_G
    }

    fn c_nb() -> Rot<Nav, Body, f64> {
        Rot::from_yaw_pitch_roll(0.7, 0.02, -0.03)
    }

    fn alignment_result(gyro: Vec3<Sensor, f64>, accel: Vec3<Sensor, f64>) -> AlignmentResult<f64> {
        let sd = AttitudeSd {
            heading: 5e-3,
            pitch: 1e-4,
            roll: 2e-4,
        };
        AlignmentResult {
            estimate: Estimate {
                c_nb: c_nb(),
                attitude: Attitude::from_rot(&c_nb()),
                sd,
                gyro_bias_s: gyro,
                gyro_bias_sd: Vec3::new(1e-7, 2e-7, 3e-5),
                accel_bias_s: accel,
                accel_bias_sd: Vec3::zero(),
            },
            v_n: Vec3::zero(),
            corrections: Corrections {
                gyro_bias_s: gyro,
                accel_bias_s: accel,
                ..Corrections::none()
            },
            rotor_in_s: Rot::identity(),
            alpha: 0.0,
        }
    }

    /// The sample of (k DT, (k + 1) DT) of the turning IMU on a base at rest, by its middle; and α at its end.
    fn sample(k: u32) -> (Sample<f64>, f64) {
        let earth = Earth::new(PLACE.latitude, PLACE.height).unwrap();
        let (middle, end) = (RATE * DT * (f64::from(k) + 0.5), RATE * DT * (f64::from(k) + 1.0));
        let c_sn = (c_nb() * Rot::about_z(middle)).inverse();
        let rate = c_sn * earth.w_ie_n() + Vec3::new(0.0, 0.0, RATE) + gyro_bias();
        // The mean of a force over a turn of 3.5 mrad is shorter by 5e-7 of it.
        let force = c_sn * -earth.g_n() + accel_bias();
        let sample = Sample {
            dtheta_s: rate * DT,
            dv_s: force * DT,
            dt: DT,
            gap: 0.0,
        };
        (sample, end)
    }

    fn run(navigator: &mut Navigator<f64>, samples: core::ops::Range<u32>) {
        for k in samples {
            let (sample, alpha) = sample(k);
            navigator.step(&sample, alpha).unwrap();
        }
    }

    #[test]
    fn goes_on_with_what_the_alignment_knew() {
        let mut navigator = Navigator::new(CONFIG, PLACE, &alignment_result(gyro_bias(), accel_bias())).unwrap();
        // Ends between two increments: what is pending counts.
        run(&mut navigator, 0..30_003);
        let off = navigator.estimate().c_nb.angle_to(c_nb());
        assert!(off < 2e-5, "{off:e} rad");
        let Track { v_n, position } = navigator.track();
        assert!(v_n.norm() < 0.03, "{v_n:?}");
        let way = 6.37e6 * (position.latitude - PLACE.latitude).hypot(position.longitude - PLACE.longitude);
        assert!(way < 5.0, "{way} m");
        assert!((navigator.time() - 300.03).abs() < 1e-9);
    }

    /// The IMU sits askew on the rotor by 3 mrad, which the alignment has found: the housing stays where it is while the
    /// rotor turns.
    #[test]
    fn the_rotors_axis_is_where_the_alignment_found_it() {
        let rotor_in_s = Rot::exp(Vec3::<Sensor, f64>::new(3e-3, -2e-3, 0.0));
        let from = AlignmentResult {
            rotor_in_s,
            ..alignment_result(gyro_bias(), accel_bias())
        };
        let mut navigator = Navigator::new(CONFIG, PLACE, &from).unwrap();
        // Half a turn: the axis taken for z of s would be off by twice that.
        for k in 0..900 {
            let (straight, alpha) = sample(k);
            let askew =
                |sensed: Vec3<Sensor, f64>, bias: Vec3<Sensor, f64>| rotor_in_s * (sensed - bias * DT) + bias * DT;
            let sample = Sample {
                dtheta_s: askew(straight.dtheta_s, gyro_bias()),
                dv_s: askew(straight.dv_s, accel_bias()),
                ..straight
            };
            navigator.step(&sample, alpha).unwrap();
        }
        let off = navigator.estimate().c_nb.angle_to(c_nb());
        assert!(off < 2e-5, "{off:e} rad");
    }

    /// A z bias that is left is all heading; those of x and y go round with the rotor.
    #[test]
    fn what_is_left_of_a_bias() {
        let known = Vec3::new(0.0, 0.0, 0.0);
        let mut navigator = Navigator::new(CONFIG, PLACE, &alignment_result(known, accel_bias())).unwrap();
        // Ten turns.
        run(&mut navigator, 0..18_000);
        let error = (navigator.estimate().c_nb * c_nb().inverse()).log();
        let turned = 8.0 * DEG_PER_HOUR * 180.0;
        assert!((error.norm() - turned).abs() < 0.02 * turned, "{error:?} {turned:e}");
        assert!(error.x().hypot(error.y()) < 0.1 * turned, "{error:?}");
    }

    #[test]
    fn the_sd_grows_as_documented() {
        let mut navigator = Navigator::new(CONFIG, PLACE, &alignment_result(gyro_bias(), accel_bias())).unwrap();
        run(&mut navigator, 0..30_000);
        let AttitudeSd { heading, pitch, roll } = navigator.estimate().sd;
        let squares = |parts: [f64; 3]| parts.iter().map(|x| x * x).sum::<f64>().sqrt();
        let walk = 1e-5 * 300.0_f64.sqrt();
        assert!((heading - squares([5e-3, walk, 3e-5 * 300.0])).abs() < 1e-9);
        assert!((pitch - squares([1e-4, walk, 2e-7 * 300.0])).abs() < 1e-9);
        assert!((roll - squares([2e-4, walk, 2e-7 * 300.0])).abs() < 1e-9);
        // After a quarter of an hour the level part stays.
        run(&mut navigator, 30_000..120_000);
        let walk = 1e-5 * 1200.0_f64.sqrt();
        let pitch = navigator.estimate().sd.pitch;
        assert!(
            (pitch - squares([1e-4, walk, 2e-7 / SCHULER])).abs() < 1e-9,
            "{pitch:e}"
        );
    }

    #[test]
    fn short_gaps_are_bridged_and_long_ones_end_it() {
        let mut navigator = Navigator::new(CONFIG, PLACE, &alignment_result(gyro_bias(), accel_bias())).unwrap();
        run(&mut navigator, 0..100);
        let (mut late, alpha) = sample(110);
        late.gap = 10.0 * DT;
        navigator.step(&late, alpha).unwrap();
        let off = navigator.estimate().c_nb.angle_to(c_nb());
        assert!(off < 1e-5, "{off:e} rad");

        let before = navigator;
        let (mut lost, alpha) = sample(200);
        lost.gap = 0.6;
        assert_eq!(navigator.step(&lost, alpha), Err(NavigatorError::Gap { length: 0.6 }));
        lost.gap = 0.0;
        lost.dtheta_s = Vec3::new(f64::NAN, 0.0, 0.0);
        assert_eq!(navigator.step(&lost, alpha), Err(NavigatorError::Sample));
        assert_eq!(
            navigator.step(&sample(201).0, f64::INFINITY),
            Err(NavigatorError::Sample)
        );
        assert_eq!(navigator, before);
    }

    #[test]
    fn a_fix_leaves_attitude_and_height() {
        let start = Position { height: 7.0, ..PLACE };
        let mut navigator = Navigator::new(CONFIG, start, &alignment_result(gyro_bias(), accel_bias())).unwrap();
        run(&mut navigator, 0..1003);
        let before = navigator.estimate().c_nb;
        navigator.fix([3.0, -4.0], Some([0.5, -3.0])).unwrap();
        let Track { v_n, position } = navigator.track();
        assert_eq!(v_n, Vec3::new(-4.0, 3.0, 0.0));
        let there = Position {
            latitude: 0.5,
            longitude: -3.0,
            height: 7.0,
        };
        assert_eq!((position, navigator.estimate().c_nb), (there, before));
        navigator.fix([0.0, 0.0], None).unwrap();
        assert_eq!(navigator.track().position, there);
        // What cannot be is not taken.
        let good = navigator;
        assert!(navigator.fix([0.0, 0.0], Some([1.7, 0.0])).is_err());
        assert!(navigator.fix([f64::NAN, 0.0], None).is_err());
        assert_eq!(navigator, good);
    }

    #[test]
    fn no_navigation_from_an_impossible_place() {
        let nowhere = Position { latitude: 2.0, ..PLACE };
        assert!(Navigator::new(CONFIG, nowhere, &alignment_result(gyro_bias(), accel_bias())).is_err());
    }
}
