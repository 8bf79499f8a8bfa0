//! The unit's parameters, all in one place. SI and radians; degrees and the like are converted here.
//!
//! What stands here is what the unit is built from, and what holds until the settings say otherwise: see
//! [`app::settings`].

use app::alignment::AlignmentConfig;
use app::rotor::{self, CalibrationConfig, ControlConfig, HomeSwitch, Homing, Limits, MotorConfig, PhaseOrder};
use app::sampling::SamplingConfig;
use app::selftest::InspectionConfig;
use app::settings::{Position, Settings};
use app::supervisor::SupervisorConfig;
use drivers::mt6835;
use frames::units::{DEG, DEG_PER_HOUR, DEG_PER_SQRT_HOUR, MICRO_G, MICRO_G_PER_SQRT_HZ};
use nav::aligner::AlignerConfig;
use nav::fine::{FilterConfig, Method};
use nav::noise::ImuNoise;
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

/// The settings of a unit that nobody has set. The place is only a beginning: `set latitude`.
pub fn factory() -> Settings {
    Settings {
        motion: SCHEDULE,
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
    hysteresis: 4,
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
        tracker: drivers::sequence::TrackerConfig {
            // No counter in this part: lost samples are told by the time between edges.
            period_us: imu().rate.period_us(),
            ..config.tracker
        },
        ..config
    };
    config
}

/// The aligner. The IMU's figures are those of \[Xing18\] Table 2; an Allan plot of the part fitted is better.
pub fn aligner(settings: &Settings) -> AlignerConfig {
    let filter = FilterConfig {
        noise: ImuNoise {
            gyro_bias_sd: (10.0 * DEG_PER_HOUR) as f32,
            accel_bias_sd: (100.0 * MICRO_G) as f32,
            angle_random_walk: (0.02 * DEG_PER_SQRT_HOUR) as f32,
            velocity_random_walk: (10.0 * MICRO_G_PER_SQRT_HZ) as f32,
            gyro_instability_sd: 0.0,
            gyro_instability_tau: 0.0,
            gyro_scale_factor_sd: 0.0,
            gyro_misalignment_sd: 0.0,
        },
        method: Method::strong_tracking(),
        ..FilterConfig::default()
    };
    let Position { latitude, height, .. } = settings.position();
    AlignerConfig::for_rotor(latitude, height, &settings.motion, filter)
}

/// What the alignment does besides aligning: 20 estimates a second, calibration, navigation.
pub fn alignment(settings: &Settings) -> AlignmentConfig {
    AlignmentConfig::for_aligner(&aligner(settings), &settings.motion, InspectionConfig::default())
}

/// Supervision.
pub fn supervisor() -> SupervisorConfig {
    SupervisorConfig::default()
}
