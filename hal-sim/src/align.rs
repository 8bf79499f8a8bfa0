//! The unit's own aligner on the host: how a scenario's or a user's figures become its configuration,
//! and what it says in degrees.

use app::settings::{Installation, Position, Settings, Source};
use frames::units::{
    ARC_MIN, ARC_SEC, DEG, DEG_PER_HOUR, DEG_PER_SQRT_HOUR, MICRO_G, MICRO_G_PER_SQRT_HZ, PPM, STANDARD_GRAVITY,
};
use frames::{Attitude, AttitudeSd, Real, Sensor, Vec3};
use nav::aligner::{Aligner, AlignerConfig, AlignerError, Estimate, Event, Mode, NotReady, Restart};
use nav::constraint::ConstraintConfig;
use nav::deviation::Deviation;
use nav::fine::{self, EncoderConstraint, FilterConfig};
use nav::increment::Sample;
use nav::model::ROBUST;
use nav::noise::ImuNoise;
use nav::rotor::RotorConfig;
use serde::{Deserialize, Serialize};

use crate::scenario::Scenario;
use crate::unit::Unit;

/// The fine filter.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize, clap::ValueEnum)]
#[serde(rename_all = "kebab-case")]
pub enum Method {
    /// Kalman filter.
    Kf,
    /// Strong-tracking filter.
    Stf,
    /// The unit's own: all the states there are, displacement measured and trusted as the base allows, strong-tracking.
    Robust,
    /// The same without fading: a plain Kalman filter.
    RobustKf,
}

impl Method {
    /// The name used on the command line and in reports.
    pub fn name(self) -> &'static str {
        match self {
            Self::Kf => "kf",
            Self::Stf => "stf",
            Self::Robust => "robust",
            Self::RobustKf => "robust-kf",
        }
    }

    fn policy<T: Real, const B: usize>(self) -> fine::Method<T, B> {
        match self {
            Self::Kf | Self::RobustKf => fine::Method::Kalman,
            Self::Stf | Self::Robust => fine::Method::strong_tracking(),
        }
    }
}

/// Configuration of the aligner.
#[derive(Debug, Clone, PartialEq)]
pub struct Setup {
    /// Geodetic latitude, degrees, north positive.
    pub latitude_deg: f64,
    /// Height above the ellipsoid, m.
    pub height_m: f64,
    /// What the rotor does, rad and s: sets the times of coarse alignment.
    pub rotor: RotorConfig<f64>,
    /// What the IMU is said to be.
    pub unit: Unit,
    /// What is known of the gyro error that is constant in the housing.
    pub deviation: Option<Deviation<f64>>,
    /// The fine filter.
    pub method: Method,
    /// That the base is fixed to Earth, and how well the encoder measures it by that: 1σ of an angle read, arcsec.
    pub encoder_constraint_arcsec: Option<f64>,
}

impl Setup {
    /// What a unit in this scenario would be told: its place, its rotor and its data sheet.
    ///
    /// A perfect IMU is weighed as the paper's: no filter works without noise.
    pub fn of(scenario: &Scenario, method: Method) -> Self {
        let told = scenario.told.as_ref().unwrap_or(&scenario.imu);
        let unit = if told.angle_random_walk_deg_sqrt_h > 0.0 {
            told.clone()
        } else {
            Unit::default()
        };
        Self {
            latitude_deg: scenario.place.latitude_deg,
            height_m: scenario.place.height_m,
            rotor: RotorConfig {
                rate: scenario.rotor.rate_dps * DEG,
                travel: scenario.rotor.travel_deg * DEG,
                acceleration: scenario.rotor.acceleration_dps2 * DEG,
            },
            unit,
            deviation: None,
            method,
            encoder_constraint_arcsec: scenario.encoder.constraint_sd_arcsec,
        }
    }

    /// The aligner's configuration in precision `T`, with `B` blocks of states.
    pub fn config<T: Real, const B: usize>(&self) -> AlignerConfig<T, B> {
        let filter = FilterConfig {
            noise: noise(&self.unit),
            deviation: self.deviation.map(|known| Deviation {
                rate_b: known.rate_b.map(T::lit),
                force_b: known.force_b.map(T::lit),
                sd: T::lit(known.sd),
            }),
            method: self.method.policy(),
            encoder_constraint: self.encoder_constraint_arcsec.and_then(|arcsec| {
                EncoderConstraint::new(ConstraintConfig {
                    encoder_sd: T::lit(arcsec * ARC_SEC),
                    ..ConstraintConfig::default()
                })
            }),
            ..FilterConfig::default()
        };
        let rotor = RotorConfig {
            rate: T::lit(self.rotor.rate),
            travel: T::lit(self.rotor.travel),
            acceleration: T::lit(self.rotor.acceleration),
        };
        AlignerConfig::for_rotor(T::lit(self.latitude_deg * DEG), T::lit(self.height_m), &rotor, filter)
    }

    /// The settings of such a unit.
    pub fn settings(&self) -> Settings {
        let config = self.config::<f32, ROBUST>();
        Settings {
            installation: Installation {
                position: Position {
                    latitude: config.latitude,
                    height: config.height,
                    longitude: 0.0,
                    source: Source::Operator,
                },
                ..Installation::default()
            },
            motion: RotorConfig {
                rate: self.rotor.rate as f32,
                travel: self.rotor.travel as f32,
                acceleration: self.rotor.acceleration as f32,
            },
            noise: config.filter.noise,
            ..Settings::default()
        }
    }

    /// The aligner itself, as the firmware has it.
    ///
    /// # Errors
    /// [`AlignerError`] where a figure is out of range.
    pub fn aligner<T: Real, const B: usize>(&self) -> Result<Aligner<T, B>, AlignerError> {
        Aligner::new(self.config())
    }
}

/// The filter's noise figures, SI, of a unit's data sheet.
pub fn noise<T: Real>(unit: &Unit) -> ImuNoise<T> {
    ImuNoise {
        gyro_bias_sd: T::lit(unit.gyro_bias_sd_deg_h * DEG_PER_HOUR),
        accel_bias_sd: T::lit(unit.accel_bias_sd_ug * MICRO_G),
        angle_random_walk: T::lit(unit.angle_random_walk_deg_sqrt_h * DEG_PER_SQRT_HOUR),
        velocity_random_walk: T::lit(unit.velocity_random_walk_ug_sqrt_hz * MICRO_G_PER_SQRT_HZ),
        gyro_instability_sd: T::lit(unit.gyro_instability_deg_h * DEG_PER_HOUR),
        gyro_instability_tau: T::lit(unit.gyro_instability_tau_s),
        gyro_scale_factor_sd: T::lit(unit.gyro_scale_factor_sd_ppm * PPM),
        gyro_misalignment_sd: T::lit(unit.gyro_misalignment_sd_arcmin * ARC_MIN),
        gyro_g_sensitivity_sd: T::lit(unit.gyro_g_sensitivity_sd_deg_h_g * DEG_PER_HOUR / STANDARD_GRAVITY),
        gyro_housing_sd: T::lit(unit.gyro_housing_sd_deg_h * DEG_PER_HOUR),
        accel_scale_factor_sd: T::lit(unit.accel_scale_factor_sd_ppm * PPM),
        accel_misalignment_sd: T::lit(unit.accel_misalignment_sd_arcmin * ARC_MIN),
        accel_instability_sd: T::lit(unit.accel_instability_ug * MICRO_G),
        accel_instability_tau: T::lit(unit.accel_instability_tau_s),
    }
}

/// A sample in the precision of the core.
pub fn cast<T: Real>(sample: &Sample<f64>) -> Sample<T> {
    Sample {
        dtheta_s: sample.dtheta_s.cast(),
        dv_s: sample.dv_s.cast(),
        dt: T::lit(sample.dt),
        gap: T::lit(sample.gap),
    }
}

/// Heading, pitch and roll in degrees.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Angles {
    /// Heading, clockwise from true north.
    pub heading_deg: f64,
    /// Pitch, front up positive.
    pub pitch_deg: f64,
    /// Roll, right side down positive.
    pub roll_deg: f64,
}

/// One of three angles.
pub type AngleOf = fn(&Angles) -> f64;

impl Angles {
    /// The three with their names and units, as tables have them.
    pub const NAMED: [(&'static str, AngleOf); 3] = [
        ("heading (°)", |a| a.heading_deg),
        ("pitch (°)", |a| a.pitch_deg),
        ("roll (°)", |a| a.roll_deg),
    ];

    /// From the core's radians.
    pub fn from_attitude<T: Real>(a: &Attitude<T>) -> Self {
        Self {
            heading_deg: deg(a.heading),
            pitch_deg: deg(a.pitch),
            roll_deg: deg(a.roll),
        }
    }

    /// From the core's spreads.
    pub fn from_sd<T: Real>(sd: &AttitudeSd<T>) -> Self {
        Self {
            heading_deg: deg(sd.heading),
            pitch_deg: deg(sd.pitch),
            roll_deg: deg(sd.roll),
        }
    }

    /// `self − truth`, heading the short way round.
    pub fn minus(&self, truth: &Self) -> Self {
        let turn = self.heading_deg - truth.heading_deg;
        Self {
            heading_deg: turn - 360.0 * (turn / 360.0).round(),
            pitch_deg: self.pitch_deg - truth.pitch_deg,
            roll_deg: self.roll_deg - truth.roll_deg,
        }
    }
}

fn deg<T: Real>(angle: T) -> f64 {
    angle.to_f64() / DEG
}

fn per_axis<T: Real>(v: &Vec3<Sensor, T>, unit: f64) -> [f64; 3] {
    v.to_array().map(|x| x.to_f64() / unit)
}

/// An [`Estimate`] in the units of reports.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Reading {
    /// Attitude of the housing.
    pub attitude: Angles,
    /// 1σ of each angle.
    pub sd: Angles,
    /// Gyro biases in s, °/h.
    pub gyro_bias_deg_h: [f64; 3],
    /// 1σ of each.
    pub gyro_bias_sd_deg_h: [f64; 3],
    /// Accelerometer biases in s, µg.
    pub accel_bias_ug: [f64; 3],
    /// 1σ of each.
    pub accel_bias_sd_ug: [f64; 3],
}

impl Reading {
    /// Converts.
    pub fn from_estimate<T: Real>(e: &Estimate<T>) -> Self {
        Self {
            attitude: Angles::from_attitude(&e.attitude),
            sd: Angles::from_sd(&e.sd),
            gyro_bias_deg_h: per_axis(&e.gyro_bias_s, DEG_PER_HOUR),
            gyro_bias_sd_deg_h: per_axis(&e.gyro_bias_sd, DEG_PER_HOUR),
            accel_bias_ug: per_axis(&e.accel_bias_s, MICRO_G),
            accel_bias_sd_ug: per_axis(&e.accel_bias_sd, MICRO_G),
        }
    }
}

/// Where the aligner stands, as reports name it.
pub fn state_name<T: Real, const B: usize>(aligner: &Aligner<T, B>) -> &'static str {
    let mode = match aligner.mode() {
        Mode::Settling => "settling",
        Mode::Coarse => "coarse",
        Mode::CatchingUp => "catching-up",
        Mode::Fine => "fine",
        Mode::Aligned => "aligned",
    };
    aligner.not_ready().as_ref().and_then(doubted).unwrap_or(mode)
}

/// Why the aligner is not aligned, for people; `None` where it is.
pub fn reason<T: Real, const B: usize>(aligner: &Aligner<T, B>) -> Option<String> {
    aligner.not_ready().map(|reason| describe_not_ready(&reason))
}

/// How reports name the state in which the innovations do not fit the model.
pub const INCONSISTENT: &str = "inconsistent";

/// The state by why the aligner does not stand by its estimate, if that is why.
pub fn doubted<T: Real>(not_ready: &NotReady<T>) -> Option<&'static str> {
    match not_ready {
        NotReady::Inconsistent { .. } => Some(INCONSISTENT),
        NotReady::Ambiguous { .. } => Some("ambiguous"),
        _ => None,
    }
}

/// Why an estimate is not to be relied on, for people.
pub fn describe_not_ready<T: Real>(reason: &NotReady<T>) -> String {
    match reason {
        NotReady::Collecting { remaining } => format!("coarse alignment needs {:.1} s more", remaining.to_f64()),
        NotReady::CatchingUp { queued } => format!("{queued} increments wait for the fine filter"),
        NotReady::HeadingSd { sd } => format!("heading sd of {:.2}° is above the one set for aligned", deg(*sd)),
        NotReady::Ambiguous {
            heading_offset,
            gyro_bias_z,
        } => format!(
            "the rotor's axis is tilted, and a heading {:+.1}° off with a z gyro bias of {:.1} °/h fits as well",
            deg(*heading_offset),
            gyro_bias_z.to_f64() / DEG_PER_HOUR
        ),
        NotReady::Inconsistent { ratio } => format!(
            "innovations are {:.1} times what a base that only swings allows: it moves, or a sensor has changed",
            ratio.to_f64().sqrt()
        ),
    }
}

/// What the aligner told, for people.
pub fn describe<T: Real>(event: &Event<T>) -> String {
    match event {
        Event::CoarseDone { attitude, sd } => {
            let (a, sd) = (Angles::from_attitude(attitude), Angles::from_sd(sd));
            format!(
                "coarse alignment: heading {:.2}° (sd {:.2}°), pitch {:.3}°, roll {:.3}°",
                a.heading_deg, sd.heading_deg, a.pitch_deg, a.roll_deg
            )
        }
        Event::CaughtUp => "fine filter has replayed the collected increments and is live".to_owned(),
        Event::Aligned => "aligned".to_owned(),
        Event::Lost(reason) => format!("no longer aligned: {}", describe_not_ready(reason)),
        Event::Bridged { length } => format!("{:.0} ms without data, bridged by the mean rate", length.to_f64() * 1e3),
        Event::Restarted(reason) => format!("starting anew: {}", describe_restart(reason)),
    }
}

fn describe_restart<T: Real>(reason: &Restart<T>) -> String {
    match reason {
        Restart::Coarse(e) => e.to_string(),
        Restart::Gap { length } => format!("{:.3} s without data", length.to_f64()),
        Restart::BadSample => "a sample is not a number, or beyond any sensor's range".to_owned(),
        Restart::Diverged => "the fine filter diverged: the motion is nothing like a base that only swings".to_owned(),
    }
}
