//! The unit's parameters, all in one place. SI and radians; degrees and the like are converted here.
//!
//! What stands here is what the unit is built from, and what holds until the settings say otherwise: see
//! [`app::settings`].

use app::parts::{self, Part};
use app::rotor::{self, CalibrationConfig, ControlConfig, HomeSwitch, Homing, Limits, MotorConfig, PhaseOrder};
use app::sampling::SamplingConfig;
use app::settings::Settings;
use app::supervisor::SupervisorConfig;
use drivers::mt6835;
use frames::units::DEG;
use nav::fine::{FilterConfig, Method};
use nav::rotor::RotorConfig;

/// The reciprocation: \[Xing18\] §3.2.
const SCHEDULE: RotorConfig = RotorConfig {
    rate: (20.0 * DEG) as f32,
    travel: (360.0 * DEG) as f32,
    acceleration: (200.0 * DEG) as f32,
};

/// A 12-slot, 14-pole gimbal motor of the 5208 class at 12 V, with the IMU on it.
const MOTOR: MotorConfig = MotorConfig {
    pole_pairs: 7,
    phase_order: PhaseOrder::Abc,
    supply: 12.0,           // V
    resistance: 5.5,        // Ω of a phase
    torque_constant: 0.138, // Nm/A
    inertia: 3e-4,          // kg m²
    coulomb: 4e-3,          // Nm
    viscous: 2e-4,          // Nm s/rad
    voltage_limit: 5.0,     // V of phase amplitude: 0.9 A at rest
    delay: 6e-4,            // s: half a tick of 1 ms, transfer and PWM
    electrical_offset: None,
};

/// The IMU that is fitted.
#[cfg(not(feature = "icm42688"))]
const PART: Part = parts::ADIS16495_1;
#[cfg(feature = "icm42688")]
const PART: Part = parts::ICM42688;

/// The settings of a unit that nobody has set. The place is only a beginning, `set latitude`, and so are the IMU's
/// figures: an Allan plot of the part fitted is better, `set gyro-arw`.
pub fn factory() -> Settings {
    Settings {
        motion: SCHEDULE,
        noise: PART.noise,
        ..Settings::default()
    }
}

/// The rotor as it is built; the settings have encoder and reciprocation.
pub fn rotor() -> rotor::Config {
    rotor::Config {
        dt_us: 1000,
        schedule: SCHEDULE,
        motor: MOTOR,
        control: ControlConfig::default(),
        // A cable, and a switch in the middle of its travel. `Homing::SlipRing` for a slip ring.
        homing: Homing::HomeSwitch(HomeSwitch::default()),
        limits: Limits::default(),
        calibration: CalibrationConfig::default(),
        ..rotor::Config::default()
    }
}

/// The encoder's settings.
pub const ENCODER: mt6835::Config = mt6835::Config {
    bandwidth: 5,
    hysteresis: 7,
    reversed: false,
};

/// The IMU's settings: 202.4 samples a second, each the mean of 21.
#[cfg(not(feature = "icm42688"))]
pub fn imu() -> drivers::adis16495::Config {
    drivers::adis16495::Config {
        dec_rate: 20,
        ..drivers::adis16495::Config::default()
    }
}

/// The IMU's settings: 200 samples a second, ±31.25 °/s, ±2 g.
#[cfg(feature = "icm42688")]
pub fn imu() -> drivers::icm42688::Config {
    drivers::icm42688::Config::default()
}

/// Sampling.
pub fn sampling() -> SamplingConfig {
    let config = SamplingConfig::default();
    #[cfg(feature = "icm42688")]
    let config = SamplingConfig {
        clock_tolerance: drivers::icm42688::CLOCK_TOLERANCE,
        tracker: drivers::sequence::TrackerConfig {
            // No counter in this part: lost samples are told by the time between edges.
            period_us: imu().rate.period_us(),
            ..config.tracker
        },
        ..config
    };
    config
}

/// The fine filter. Its noise is in the settings.
pub fn filter() -> FilterConfig {
    FilterConfig {
        method: Method::strong_tracking(),
        ..FilterConfig::default()
    }
}

/// Supervision.
pub fn supervisor() -> SupervisorConfig {
    SupervisorConfig::default()
}
