//! The unit's parameters, all in one place. SI and radians; degrees and the like are converted here.
//!
//! What a unit's calibration finds (electrical offset, encoder zero and table, IMU) belongs into the settings; what
//! stands here is what the unit is built from, and what holds until the settings say otherwise.

use app::alignment::AlignmentConfig;
use app::motor::HARMONICS;
use app::output::OutputConfig;
use app::rotor::{self, CalibrationConfig, ControlConfig, HomeSwitch, Homing, Limits, MotorConfig, PhaseOrder};
use app::sampling::SamplingConfig;
use app::selftest::InspectionConfig;
use app::supervisor::SupervisorConfig;
use drivers::harmonics::Harmonics;
use drivers::mt6835;
use frames::units::{DEG, DEG_PER_HOUR, DEG_PER_SQRT_HOUR, MICRO_G, MICRO_G_PER_SQRT_HZ};
use nav::aligner::AlignerConfig;
use nav::fine::{FilterConfig, Method};
use nav::noise::ImuNoise;
use nav::rotor::RotorConfig;

/// Geodetic latitude, north positive, rad. 0.1° is enough; a wrong one shows as tilt and, at tan φ, in heading.
const LATITUDE: f32 = (40.0 * DEG) as f32;
/// Height above the ellipsoid, m.
const HEIGHT: f32 = 0.0;

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

/// The rotor.
pub fn rotor() -> rotor::Config {
    rotor::Config {
        dt_us: 1000,
        encoder_zero: 0.0, // rad
        schedule: SCHEDULE,
        motor: MOTOR,
        control: ControlConfig::default(),
        // A cable, and a switch in the middle of its travel. `Homing::SlipRing` for a slip ring.
        homing: Homing::HomeSwitch(HomeSwitch::default()),
        limits: Limits::default(),
        calibration: CalibrationConfig::default(),
    }
}

/// The encoder's settings.
pub const ENCODER: mt6835::Config = mt6835::Config {
    bandwidth: 5,
    hysteresis: 4,
    reversed: false,
};

/// The encoder's correction: none until the unit is calibrated.
pub fn correction() -> Harmonics<HARMONICS> {
    Harmonics::default()
}

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
pub fn aligner() -> AlignerConfig {
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
    AlignerConfig::for_rotor(LATITUDE, HEIGHT, &SCHEDULE, filter)
}

/// What the alignment does besides aligning.
pub fn alignment() -> AlignmentConfig {
    AlignmentConfig {
        publish_every: 10, // samples: 20 estimates a second
        inspection: InspectionConfig::default(),
    }
}

/// Supervision.
pub fn supervisor() -> SupervisorConfig {
    SupervisorConfig::default()
}

/// The serial line's output.
pub fn output() -> OutputConfig {
    OutputConfig::default()
}
