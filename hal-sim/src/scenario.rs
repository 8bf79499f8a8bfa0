//! Scenarios: what moves, how, and how badly it is measured. TOML in, checked figures out.
//!
//! A scenario without a key is a perfect rotary unit at rest at 40° north; every key adds something. Every number has
//! a range, an unknown key is an error, and errors name file, line and key.
//!
//! The files built in are in `hal-sim/scenarios/`. They are the documentation by example.

use std::path::Path;

use frames::units::DEG;
use nalgebra::{Matrix3, Vector3};
use nav::rotor::{RotorConfig, Schedule};
use serde::{Deserialize, Serialize};

use crate::config::{self, Angle, ConfigError, ConfigProblem, Table, Violation, table};
use crate::rotation::Rotation;
use crate::unit::Unit;

table! {
    /// `[place]`: where the unit stands.
    pub struct Place {
        numbers {
            /// Geodetic latitude, degrees, north positive.
            latitude_deg: f64 = 40.0, [-85.0, 85.0];
            /// Height above the WGS-84 ellipsoid, m.
            height_m: f64 = 0.0, [-12000.0, 30000.0];
        }
        tables {}
    }
}

table! {
    /// `[run]`: how long and how fast.
    pub struct Run {
        numbers {
            /// Length of the run, s.
            duration_s: f64 = 300.0, [0.1, 360000.0];
            /// Samples a second.
            rate_hz: f64 = 100.0, [10.0, 10000.0];
            /// First time of the coarse alignment that is reported beside the unit's own (\[Xing18\] (17)), s. Absent:
            /// a sixth of the run.
            coarse_t_k1_s: Option<f64> = None, [0.1, 360000.0];
            /// Second time, s. Absent: five sixths of the run.
            coarse_t_k2_s: Option<f64> = None, [0.1, 360000.0];
            /// Calibration of the gyros before the run (\[Du16\] §3.2), the base at rest and its attitude known: so many
            /// seconds with the rotor at rest, then a cycle of the rotor or as many as take as long. Biases, and what the
            /// gyros take of the rotor's turning, are then out of the samples as far as that finds them. Zero: none. Not
            /// for `unit`.
            calibration_s: f64 = 0.0, [0.0, 3600.0];
        }
        tables {}
    }
}

table! {
    /// One angle of the swing: `centre + amplitude · sin(2π t/period + phase)` (\[Xing18\] §5.1).
    pub struct Axis {
        numbers {
            /// Amplitude, degrees. Zero: the angle rests at its centre.
            amplitude_deg: f64 = 0.0, [0.0, 90.0];
            /// Period, s.
            period_s: f64 = 10.0, [0.5, 3600.0];
            /// Centre, degrees. Of heading: clockwise from true north, or `"random"`: anywhere on the circle, from the
            /// seed. The papers count yaw counter-clockwise, so that their centre of 30° is 330 here.
            centre_deg: Angle = Angle::Degrees(0.0), [-360.0, 360.0];
            /// Phase at t = 0, degrees. Absent: uniform, from the seed.
            phase_deg: Option<f64> = None, [-360.0, 360.0];
        }
        tables {}
    }
}

table! {
    /// `[swing.*]`: the attitude of the base, `C_b^n = Rz(−heading) Rx(pitch) Ry(roll)` where the unit stands upright.
    pub struct Swing {
        numbers {}
        tables {
            /// Pitch: front up is positive.
            pitch: Axis;
            /// Roll: right side down is positive.
            roll: Axis;
            /// Heading: clockwise from true north.
            heading: Axis;
        }
    }
}

table! {
    /// One component of the sway: `amplitude · sin(2π t/period + phase)`.
    pub struct SwayAxis {
        numbers {
            /// Amplitude, m.
            amplitude_m: f64 = 0.0, [0.0, 100.0];
            /// Period, s.
            period_s: f64 = 10.0, [0.5, 3600.0];
            /// Phase at t = 0, degrees. Absent: uniform, from the seed.
            phase_deg: Option<f64> = None, [-360.0, 360.0];
        }
        tables {}
    }
}

table! {
    /// `[sway.*]`: the motion of the housing's reference point in n. Mean position and velocity are zero.
    pub struct Sway {
        numbers {}
        tables {
            /// To the east.
            east: SwayAxis;
            /// To the north.
            north: SwayAxis;
            /// Upwards (heave).
            up: SwayAxis;
        }
    }
}

table! {
    /// Irregular motion of one angle, about the centre that the swing has.
    pub struct SeaAngle {
        numbers {
            /// Significant amplitude, degrees: the mean of the highest third, twice the standard deviation. Zero: none.
            significant_deg: f64 = 0.0, [0.0, 60.0];
            /// Period of the spectrum's peak, s.
            peak_period_s: f64 = 8.0, [1.5, 3600.0];
        }
        tables {}
    }
}

table! {
    /// Irregular motion of one component of the sway.
    pub struct SeaSway {
        numbers {
            /// Significant amplitude, m: the mean of the highest third, twice the standard deviation. Zero: none.
            significant_m: f64 = 0.0, [0.0, 100.0];
            /// Period of the spectrum's peak, s.
            peak_period_s: f64 = 8.0, [1.5, 3600.0];
        }
        tables {}
    }
}

table! {
    /// `[sea.*]`: irregular swing and sway, besides the regular ones. Each is a sum of sines with a spectrum as in the
    /// module [`sea`](crate::sea), frequencies and phases from the seed.
    pub struct Sea {
        numbers {
            /// γ of the spectrum: 1 is Bretschneider's, 3.3 the mean JONSWAP, 7 a swell.
            peakedness: f64 = 1.0, [1.0, 10.0];
            /// Sines in each angle and each component of the sway.
            components: u32 = 30, [1.0, 300.0];
        }
        tables {
            /// Pitch: front up is positive.
            pitch: SeaAngle;
            /// Roll: right side down is positive.
            roll: SeaAngle;
            /// Heading: clockwise from true north.
            heading: SeaAngle;
            /// To the east.
            east: SeaSway;
            /// To the north.
            north: SeaSway;
            /// Upwards (heave).
            up: SeaSway;
        }
    }
}

/// How the unit is built into the base: along which of the base's axes its rotor's axis lies (\[Xing18\] §5.1).
///
/// b, the unit's housing, always has its z along the rotor's axis, and what a unit reports is the attitude of b: the
/// core knows no other rotor. The base has the axes that the swing turns, right, front and up.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum RotorAxis {
    /// On its side: z of b to the right of the base, y to its front. Heading and pitch are the base's, roll is 90° more.
    X,
    /// Tipped over: z of b to the front of the base, y to its right. Heading is 90° more than the base's, pitch is the
    /// base's roll with the opposite sign, roll is the base's pitch less 90°.
    Y,
    /// Upright: b is the base.
    #[default]
    Z,
}

impl RotorAxis {
    /// From b to the axes of the base: the axes of b in its columns.
    pub fn mounting(self) -> Matrix3<f64> {
        let (x, y, z) = (Vector3::x(), Vector3::y(), Vector3::z());
        Matrix3::from_columns(&match self {
            Self::X => [-z, y, x],
            Self::Y => [z, x, y],
            Self::Z => [x, y, z],
        })
    }
}

impl Table for RotorAxis {
    fn check(&self, _path: &str) -> Result<(), Violation> {
        Ok(())
    }
}

table! {
    /// One leg of `[rotor] legs`: from the turning point before to this one.
    pub struct Leg {
        numbers {
            /// Where it ends, degrees; the first begins at 0, and the last must end there.
            to_deg: f64 = 0.0, [-3600.0, 3600.0];
            /// Rate, °/s. Absent: the rotor's.
            rate_dps: Option<f64> = None, [0.1, 360.0];
            /// Rest at its end, s.
            dwell_s: f64 = 0.0, [0.0, 3600.0];
        }
        tables {}
    }
}

table! {
    /// `[rotor]`: reciprocating rotation about z; profile of [`nav::rotor`].
    pub struct Rotor {
        numbers {
            /// Rate in the legs, °/s. Zero: the rotor stands still.
            rate_dps: f64 = 20.0, [0.0, 360.0];
            /// From one turning point to the other, degrees.
            travel_deg: f64 = 360.0, [0.0, 3600.0];
            /// At the turning points, °/s².
            acceleration_dps2: f64 = 200.0, [0.0, 100000.0];
            /// Speed ripple as a fraction of the rate, fixed to the rotor's position:
            /// `α = s + (ripple_fraction/k) sin(k s)` with s the ideal angle.
            ripple_fraction: f64 = 0.0, [0.0, 0.5];
            /// Ripples per turn (k); for a motor its pole pairs, or a multiple of them.
            ripple_harmonic: u32 = 7, [1.0, 64.0];
            /// Where the rotor's axis points against z of the housing, arc minutes: small rotation about [x, y]. The
            /// IMU at α = 0 lies as the housing does, so that the axis is off its z by as much.
            axis_tilt_arcmin: [f64; 2] = [0.0; 2], [-600.0, 600.0];
            /// Wobble of the axis: the tilt about x and about y of the housing goes through a sine of this amplitude once
            /// a turn, seconds of arc. Phases from the seed.
            wobble_arcsec: f64 = 0.0, [0.0, 3600.0];
            /// Every leg at a rate of its own, drawn evenly within this part of the rate. Not for `unit`.
            rate_spread: f64 = 0.0, [0.0, 0.9];
        }
        tables {
            /// Legs in place of those over `travel_deg` there and back, see [`rotation`](crate::rotation). Not for `unit`.
            legs: Vec<Leg>;
            /// Along which axis of the base it lies: `"x"`, `"y"` or `"z"`.
            axis: RotorAxis;
        }
    }
}

impl Rotor {
    /// Whether it moves by legs and not by the schedule of a unit.
    pub fn has_legs(&self) -> bool {
        !self.legs.is_empty() || self.rate_spread > 0.0
    }

    /// Highest rate in a leg, °/s, without ripple.
    pub fn fastest_dps(&self) -> f64 {
        let legs = self.legs.iter().filter_map(|leg| leg.rate_dps);
        legs.fold(self.rate_dps, f64::max) * (1.0 + self.rate_spread)
    }
}

table! {
    /// `[errors]`: errors of the IMU that the unit's filter is told no figure of. Those it is told are in `[imu]`.
    pub struct Errors {
        numbers {
            /// A known bias of the gyros on x, y, z, added to what is drawn, °/h.
            gyro_bias_deg_h: [f64; 3] = [0.0; 3], [-100000.0, 100000.0];
            /// A known bias of the accelerometers on x, y, z, added to what is drawn, µg.
            accel_bias_ug: [f64; 3] = [0.0; 3], [-1000000.0, 1000000.0];
            /// A known gyro error that is fixed to the housing, on its x, y, z, °/h.
            gyro_housing_deg_h: [f64; 3] = [0.0; 3], [-10000.0, 10000.0];
            /// A step of the gyros' bias on x, y, z, °/h, …
            gyro_step_deg_h: [f64; 3] = [0.0; 3], [-100000.0, 100000.0];
            /// … and when it comes, s.
            gyro_step_at_s: f64 = 0.0, [0.0, 360000.0];
            /// What the samples are later by than the unit is told of its IMU, ms; negative: less late, in `unit` down to no
            /// delay at all.
            imu_delay_ms: f64 = 0.0, [-20.0, 20.0];
            /// Least significant bit of the angle increments, rad. The remainder is carried. Zero: none.
            gyro_quantum: f64 = 0.0, [0.0, 0.01];
            /// Least significant bit of the velocity increments, m/s. The remainder is carried. Zero: none.
            accel_quantum: f64 = 0.0, [0.0, 1.0];
            /// Mean rate over a sample beyond which a gyro saturates, °/s. Absent: never.
            gyro_range_dps: Option<f64> = None, [1.0, 10000.0];
            /// Mean specific force over a sample beyond which an accelerometer saturates, g. Absent: never.
            accel_range_g: Option<f64> = None, [0.1, 1000.0];
            /// A gyro error that goes twice a turn of the rotor, in the IMU's axes: its cosine and its sine on each axis,
            /// 1σ, °/h. Its companion once a turn is `gyro_housing_sd_deg_h` of `[imu]`.
            gyro_twice_a_turn_sd_deg_h: f64 = 0.0, [0.0, 10000.0];
            /// Scale factors of the gyros that differ with the sign of the rate, +k for a positive and −k for a negative
            /// one: k of each axis, 1σ, ppm. Going there and back leaves it, unlike a scale factor.
            gyro_scale_asymmetry_sd_ppm: f64 = 0.0, [0.0, 10000.0];
            /// What vibration makes of the gyros' bias, each axis, 1σ, °/h per g² of mean square.
            gyro_rectification_sd_deg_h_g2: f64 = 0.0, [0.0, 10000.0];
            /// What vibration makes of the accelerometers' bias, each axis, 1σ, µg per g² of mean square.
            accel_rectification_sd_ug_g2: f64 = 0.0, [0.0, 1000000.0];
            /// Bandwidth of gyros and accelerometers, −3 dB, Hz. Absent: unlimited.
            bandwidth_hz: Option<f64> = None, [0.1, 100000.0];
            /// Poles of that low-pass, all alike.
            bandwidth_poles: u32 = 1, [1.0, 2.0];
        }
        tables {}
    }
}

table! {
    /// `[temperature]`: the unit warms up from its start on, and the IMU's biases drift with it.
    ///
    /// The IMU is warmer by `rise_k (1 − e^(−t/tau_s)) + motor_rise_k (1 − e^(−t/motor_tau_s))`.
    pub struct Temperature {
        numbers {
            /// By how much the housing warms up, K.
            rise_k: f64 = 0.0, [-100.0, 100.0];
            /// Its time constant, s.
            tau_s: f64 = 1200.0, [1.0, 100000.0];
            /// By how much the motor warms the IMU up besides, K.
            motor_rise_k: f64 = 0.0, [-100.0, 100.0];
            /// Its time constant, s.
            motor_tau_s: f64 = 120.0, [1.0, 100000.0];
            /// Drift of the gyros' bias, each axis, 1σ, °/h per K.
            gyro_bias_sd_deg_h_k: f64 = 0.0, [0.0, 10000.0];
            /// Drift of the accelerometers' bias, each axis, 1σ, µg per K.
            accel_bias_sd_ug_k: f64 = 0.0, [0.0, 100000.0];
        }
        tables {}
    }
}

table! {
    /// `[[vibration]]`: a band in which the housing vibrates, along and about each of its axes alike. The lines in it are
    /// drawn from the seed. It moves nothing on the whole: the true attitude is without it.
    pub struct Vibration {
        numbers {
            /// Lower end of the band, Hz.
            low_hz: f64 = 20.0, [0.1, 100000.0];
            /// Upper end, Hz.
            high_hz: f64 = 200.0, [0.1, 100000.0];
            /// Acceleration along each axis, RMS, m/s².
            accel_rms_m_s2: f64 = 0.0, [0.0, 1000.0];
            /// Angular rate about each axis, RMS, rad/s.
            rate_rms_rad_s: f64 = 0.0, [0.0, 10.0];
        }
        tables {}
    }
}

table! {
    /// One harmonic of the encoder's error: `amplitude · sin(order · α + phase)`.
    pub struct Harmonic {
        numbers {
            /// Periods per turn: 1 for eccentricity, 2 for an oval magnet.
            order: u32 = 1, [1.0, 1024.0];
            /// Amplitude, seconds of arc.
            amplitude_arcsec: f64 = 0.0, [0.0, 36000.0];
            /// Phase, degrees.
            phase_deg: f64 = 0.0, [-360.0, 360.0];
        }
        tables {}
    }
}

table! {
    /// `[encoder]`: errors of the rotor's encoder.
    pub struct EncoderErrors {
        numbers {
            /// Bits a turn. Zero: exact.
            bits: u32 = 0, [0.0, 32.0];
            /// That the unit is told its base to be fixed to Earth, so that it measures the z gyro by the encoder
            /// ([`nav::constraint`]), and the 1σ of an angle read that it is told, arcsec. Absent: the base may yaw.
            constraint_sd_arcsec: Option<f64> = None, [0.0, 3600.0];
        }
        tables {
            /// Nonlinearity, by harmonics of a turn.
            harmonics: Vec<Harmonic>;
        }
    }
}

table! {
    /// `[buses]`: the unit's data-ready line. Only for `unit`.
    pub struct Buses {
        numbers {
            /// Share of the data-ready edges that go unheard.
            edge_loss: f64 = 0.0, [0.0, 1.0];
            /// Mean time from the end of a sample to its edge, µs; the unit is told.
            edge_delay_us: f64 = 5.0, [0.0, 1000.0];
            /// Its spread, 1σ, µs.
            edge_jitter_us: f64 = 1.0, [0.0, 300.0];
        }
        tables {}
    }
}

/// What breaks.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum FaultKind {
    /// The data-ready line stays low.
    #[default]
    ImuEdges,
    /// The IMU answers 0xFF to everything.
    ImuSilent,
    /// Bursts of the IMU come with a wrong check sum.
    ImuCrc,
    /// The gyro on z is at the end of its range.
    ImuSaturated,
    /// The IMU's data stay as they are; the count goes on.
    ImuStuckData,
    /// The IMU's count stays as it is.
    ImuStuckCounter,
    /// The IMU reports that its processor does not keep up.
    ImuFlags,
    /// The IMU is at 110 °C.
    ImuHot,
    /// The IMU loses its decimation and samples 19 % too slowly.
    ImuRate,
    /// Transfers with the IMU never end.
    ImuBus,
    /// The encoder answers 0xFF to everything.
    EncoderSilent,
    /// The encoder's readings come with a wrong check sum.
    EncoderCrc,
    /// The encoder repeats its last reading.
    EncoderFrozen,
    /// The encoder warns of a weak field.
    EncoderWeak,
    /// The bridge pulls its fault line and is off.
    Driver,
    /// The rotor is jammed.
    Jam,
    /// The contacts of the home switch agree.
    HomeBroken,
    /// The home switch hangs above its edge.
    HomeStuck,
    /// The sampling task hangs.
    HangSampling,
    /// The motor's loop hangs.
    HangMotor,
    /// The alignment task hangs.
    HangAlignment,
    /// The unit resets, in mid-turn.
    Reset,
}

impl Table for FaultKind {
    fn check(&self, _path: &str) -> Result<(), Violation> {
        Ok(())
    }
}

table! {
    /// `[[fault]]`: something that breaks. Only for `unit`.
    pub struct FaultAt {
        numbers {
            /// When, s from power-up.
            at_s: f64 = 0.0, [0.0, 360000.0];
            /// For how long, s. Absent: for good.
            for_s: Option<f64> = None, [0.0, 360000.0];
        }
        tables {
            /// What.
            kind: FaultKind;
        }
    }
}

table! {
    /// `[[turn]]`: the base turns to another heading, about the vertical and besides its swing: `by_deg (u − sin(2πu)/2π)` with u
    /// from 0 to 1.
    pub struct TurnOfBase {
        numbers {
            /// When it begins, s.
            at_s: f64 = 0.0, [0.0, 360000.0];
            /// By how much, clockwise, degrees.
            by_deg: f64 = 90.0, [-3600.0, 3600.0];
            /// How long it takes, s.
            over_s: f64 = 10.0, [0.1, 360000.0];
        }
        tables {}
    }
}

/// What moves, how, and how badly it is measured.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Scenario {
    /// The name of the built-in scenario, or of the file without its ending. Not a key.
    #[serde(skip)]
    pub name: String,
    /// One line for people.
    pub description: String,
    /// From the base's reference point, which sways, to the IMU, in the base's axes (right, front, up), m. Range −100 to
    /// 100.
    pub lever_arm_m: [f64; 3],
    /// Where.
    pub place: Place,
    /// How long and how fast.
    pub run: Run,
    /// The attitude of the housing.
    pub swing: Swing,
    /// Its position.
    pub sway: Sway,
    /// Its turns to other headings.
    pub turn: Vec<TurnOfBase>,
    /// Irregular motion of both.
    pub sea: Sea,
    /// The motion of the IMU in the housing.
    pub rotor: Rotor,
    /// The figures of the IMU, as in a `UNIT.toml`: gyros measure `(I + M) ω + G f + b + C_b^s h`, accelerometers
    /// `(I + A) f + b`, each term drawn with its 1σ. Without this table the IMU is perfect; with it, even
    /// empty, keys left out are the paper's, or those of a part: `part = "adis16495-1"`.
    pub imu: Unit,
    /// The figures that the unit's filter is configured with, where they are not those of `[imu]`: a data sheet that is
    /// wrong about its part.
    pub told: Option<Unit>,
    /// Its other errors.
    pub errors: Errors,
    /// How it warms up.
    pub temperature: Temperature,
    /// How the housing vibrates.
    pub vibration: Vec<Vibration>,
    /// The errors of the encoder.
    pub encoder: EncoderErrors,
    /// The lines between devices and unit.
    pub buses: Buses,
    /// What breaks, and when.
    pub fault: Vec<FaultAt>,
}

impl Default for Scenario {
    /// A perfect unit at rest, heading north.
    fn default() -> Self {
        Self {
            name: String::new(),
            description: String::new(),
            lever_arm_m: [0.0; 3],
            place: Place::default(),
            run: Run::default(),
            swing: Swing::default(),
            sway: Sway::default(),
            turn: Vec::new(),
            sea: Sea::default(),
            rotor: Rotor::default(),
            imu: Unit::perfect(),
            told: None,
            errors: Errors::default(),
            temperature: Temperature::default(),
            vibration: Vec::new(),
            encoder: EncoderErrors::default(),
            buses: Buses::default(),
            fault: Vec::new(),
        }
    }
}

impl Errors {
    /// [`imu_delay_ms`](Self::imu_delay_ms) in microseconds.
    pub fn imu_delay_us(&self) -> i64 {
        (self.imu_delay_ms * 1e3).round() as i64
    }
}

const BUILTIN: [(&str, &str); 12] = [
    ("static", include_str!("../scenarios/static.toml")),
    ("paper-sim", include_str!("../scenarios/paper-sim.toml")),
    ("paper-turntable", include_str!("../scenarios/paper-turntable.toml")),
    ("moored", include_str!("../scenarios/moored.toml")),
    ("moored-irregular", include_str!("../scenarios/moored-irregular.toml")),
    ("as-built", include_str!("../scenarios/as-built.toml")),
    (
        "gyrocompass-standard",
        include_str!("../scenarios/gyrocompass-standard.toml"),
    ),
    ("bias-step", include_str!("../scenarios/bias-step.toml")),
    ("lively-floor", include_str!("../scenarios/lively-floor.toml")),
    ("tilted-5", include_str!("../scenarios/tilted-5.toml")),
    ("tilted-15", include_str!("../scenarios/tilted-15.toml")),
    ("four-headings", include_str!("../scenarios/four-headings.toml")),
];

impl Scenario {
    /// The names of the built-in scenarios.
    pub fn builtin_names() -> impl Iterator<Item = &'static str> {
        BUILTIN.iter().map(|(name, _)| *name)
    }

    /// A built-in scenario.
    ///
    /// # Errors
    /// [`ConfigProblem::UnknownScenario`] with the names there are.
    pub fn builtin(name: &str) -> Result<Self, ConfigError> {
        Self::parse(Self::builtin_text(name)?, name)
    }

    /// The TOML of a built-in scenario.
    ///
    /// # Errors
    /// [`ConfigProblem::UnknownScenario`] with the names there are.
    pub fn builtin_text(name: &str) -> Result<&'static str, ConfigError> {
        BUILTIN
            .iter()
            .find(|(builtin, _)| *builtin == name)
            .map(|(_, text)| *text)
            .ok_or_else(|| ConfigError {
                file: name.to_owned(),
                line: None,
                key: None,
                problem: ConfigProblem::UnknownScenario(Self::builtin_names().collect::<Vec<_>>().join(", ")),
            })
    }

    /// Reads a scenario file.
    ///
    /// # Errors
    /// [`ConfigError`]: one line with file, line and key.
    pub fn load(path: &Path) -> Result<Self, ConfigError> {
        let scenario = Self::parse(&config::read(path)?, &path.display().to_string())?;
        Ok(Self {
            name: path
                .file_stem()
                .map(|stem| stem.to_string_lossy().into_owned())
                .unwrap_or_default(),
            ..scenario
        })
    }

    /// The same from text; `file_name` becomes the scenario's name and is in error messages.
    ///
    /// # Errors
    /// [`ConfigError`]: one line with file, line and key.
    pub fn parse(text: &str, file_name: &str) -> Result<Self, ConfigError> {
        let scenario = config::parse(text, file_name, Self::validate)?;
        Ok(Self {
            name: file_name.to_owned(),
            ..scenario
        })
    }

    /// Checks every range, and what the keys must be to each other. Reading does it; whoever sets fields in code and
    /// hands the scenario to [`Truth`](crate::truth::Truth) has it done there.
    ///
    /// # Errors
    /// The first [`Violation`].
    pub fn validate(&self) -> Result<(), Violation> {
        use config::Ranged;
        let violation = |key: &str, problem: String| {
            Err(Violation {
                key: key.to_owned(),
                problem,
            })
        };
        if let Some(value) = self.lever_arm_m.outside(-100.0, 100.0) {
            return violation(
                "lever_arm_m",
                format!("{value} is out of range, allowed are -100 to 100"),
            );
        }
        self.place.check("place")?;
        self.run.check("run")?;
        self.swing.check("swing")?;
        self.sway.check("sway")?;
        self.turn.check("turn")?;
        self.sea.check("sea")?;
        self.rotor.check("rotor")?;
        self.imu.check("imu")?;
        if let Some(told) = &self.told {
            told.check("told")?;
        }
        self.errors.check("errors")?;
        self.temperature.check("temperature")?;
        self.vibration.check("vibration")?;
        if let Some(k) = self.vibration.iter().position(|band| band.low_hz >= band.high_hz) {
            return violation(&format!("vibration[{k}].low_hz"), "must be below high_hz".to_owned());
        }
        self.encoder.check("encoder")?;
        self.buses.check("buses")?;
        self.fault.check("fault")?;

        let Swing { pitch, roll, .. } = &self.swing;
        // A unit that is tipped over pitches as the base rolls.
        let roll_limit = if self.rotor.axis == RotorAxis::Y { 85.0 } else { 180.0 };
        let Sea {
            pitch: sea_pitch,
            roll: sea_roll,
            components,
            ..
        } = &self.sea;
        // All sines at their crest: √2N σ.
        let crest = |sea: &SeaAngle| sea.significant_deg * (0.5 * f64::from(*components)).sqrt();
        for (key, axis, sea, limit) in [
            ("swing.pitch", pitch, sea_pitch, 85.0),
            ("swing.roll", roll, sea_roll, roll_limit),
        ] {
            match axis.centre_deg {
                Angle::Random => {
                    return violation(
                        &config::join(key, "centre_deg"),
                        "only the heading's centre may be random".to_owned(),
                    );
                }
                Angle::Degrees(centre) if centre.abs() + axis.amplitude_deg > limit => {
                    return violation(
                        key,
                        format!("reaches beyond {limit} degrees: lower centre or amplitude"),
                    );
                }
                Angle::Degrees(centre) if centre.abs() + axis.amplitude_deg + crest(sea) > limit => {
                    return violation(
                        &key.replace("swing", "sea"),
                        format!(
                            "reaches beyond {limit} degrees where all components meet: lower significant_deg or components"
                        ),
                    );
                }
                Angle::Degrees(_) => {}
            }
        }
        Rotation::new(self, 0)?;
        if self.run.calibration_s > 0.0 && self.rotor.rate_dps == 0.0 {
            return violation("run.calibration_s", "a calibration needs a rotor that turns".to_owned());
        }
        Ok(())
    }

    /// The rotor's schedule as a unit is told it, without legs and ripple.
    ///
    /// # Errors
    /// Where the rotor's figures are impossible together.
    pub fn schedule(&self) -> Result<Schedule<f64>, nav::rotor::RotorError> {
        Schedule::new(RotorConfig {
            rate: self.rotor.rate_dps * DEG,
            travel: self.rotor.travel_deg * DEG,
            acceleration: self.rotor.acceleration_dps2 * DEG,
        })
    }

    /// That a whole unit can be simulated in it.
    ///
    /// # Errors
    /// [`Violation`] where its rotor moves by legs: the motor follows a schedule.
    pub fn check_for_unit(&self) -> Result<(), Violation> {
        if self.rotor.has_legs() {
            return Err(Violation {
                key: "rotor".to_owned(),
                problem: "a unit's motor knows neither legs nor rate_spread: `run` simulates the core alone".to_owned(),
            });
        }
        Ok(())
    }

    /// The two times of the coarse alignment over the whole run, s.
    pub fn coarse_times(&self) -> (f64, f64) {
        let sixth = self.run.duration_s / 6.0;
        (
            self.run.coarse_t_k1_s.unwrap_or(sixth),
            self.run.coarse_t_k2_s.unwrap_or(5.0 * sixth),
        )
    }

    /// Number of samples in the run.
    pub fn samples(&self) -> u64 {
        // In range by `validate`: at most 3.6e9.
        (self.run.duration_s * self.run.rate_hz).round() as u64
    }

    /// End of sample `k`, counted from 1, s. Sample `k` spans `time(k − 1)..time(k)`.
    pub fn time(&self, k: u64) -> f64 {
        k as f64 / self.run.rate_hz
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn message(text: &str) -> String {
        Scenario::parse(text, "s.toml").unwrap_err().to_string()
    }

    #[test]
    fn builtin_scenarios_are_as_stated() {
        for name in Scenario::builtin_names() {
            let scenario = Scenario::builtin(name).unwrap();
            assert_eq!(scenario.name, name);
            assert!(!scenario.description.is_empty());
            // Through TOML and JSON and back.
            let text = toml::to_string(&scenario).unwrap();
            assert_eq!(Scenario::parse(&text, name).unwrap(), scenario);
            let json = serde_json::to_value(&scenario).unwrap();
            let read: Scenario = serde_json::from_value(json).unwrap();
            assert_eq!(
                Scenario {
                    name: name.to_owned(),
                    ..read
                },
                scenario
            );
        }
        let paper = Scenario::builtin("paper-sim").unwrap();
        assert_eq!(paper.imu, Unit::default());
        assert_eq!(paper.swing.heading.centre_deg, Angle::Degrees(330.0));
        assert_eq!(paper.samples(), 30_000);
        assert_eq!(
            Scenario::builtin("paper-simm").unwrap_err().to_string(),
            "paper-simm: no built-in scenario of this name; there are static, paper-sim, paper-turntable, moored, \
             moored-irregular, as-built, gyrocompass-standard, bias-step, lively-floor, tilted-5, tilted-15, four-headings, \
             or a TOML file of your own"
        );
    }

    #[test]
    fn gyrocompass_standard_accelerates_as_the_standard_says() {
        let s = Scenario::builtin("gyrocompass-standard").unwrap();
        let acceleration = |axis: &SwayAxis| axis.amplitude_m * (core::f64::consts::TAU / axis.period_s).powi(2);
        let level = acceleration(&s.sway.east).hypot(acceleration(&s.sway.north));
        assert!((level - 0.22).abs() < 1e-3, "{level}");
    }

    #[test]
    fn the_irregular_berth_moves_as_much_as_the_regular_one() {
        let (regular, irregular) = (
            Scenario::builtin("moored").unwrap(),
            Scenario::builtin("moored-irregular").unwrap(),
        );
        let (swing, sway, sea) = (&regular.swing, &regular.sway, &irregular.sea);
        for (axis, sea) in [
            (&swing.pitch, &sea.pitch),
            (&swing.roll, &sea.roll),
            (&swing.heading, &sea.heading),
        ] {
            // 2σ = √2 A.
            let part = sea.significant_deg / (2_f64.sqrt() * axis.amplitude_deg);
            assert!(
                (part - 1.0).abs() < 1e-3 && sea.peak_period_s == axis.period_s,
                "{part}"
            );
        }
        for (axis, sea) in [(&sway.east, &sea.east), (&sway.north, &sea.north), (&sway.up, &sea.up)] {
            let part = sea.significant_m / (2_f64.sqrt() * axis.amplitude_m);
            assert!(
                (part - 1.0).abs() < 2e-3 && sea.peak_period_s == axis.period_s,
                "{part}"
            );
        }
        let Scenario { imu, rotor, .. } = &irregular;
        assert_eq!((imu, rotor), (&regular.imu, &regular.rotor));
        // The same sea.
        assert_eq!(Scenario::builtin("as-built").unwrap().sea, irregular.sea);
    }

    #[test]
    fn an_empty_scenario_is_perfect_and_at_rest() {
        let scenario = Scenario::parse("", "s.toml").unwrap();
        assert_eq!(scenario.imu, Unit::perfect());
        assert_eq!(scenario.swing, Swing::default());
        assert_eq!(Scenario::parse("[imu]\n", "s.toml").unwrap().imu, Unit::default());
    }

    #[test]
    fn imu_and_told_take_a_part_by_name() {
        let text = "[imu]\npart = \"icm42688\"\ngyro_bias_sd_deg_h = 0\n[told]\npart = \"tactical\"\n";
        let scenario = Scenario::parse(text, "s.toml").unwrap();
        let icm = Unit::find("icm42688").unwrap();
        assert_eq!(scenario.imu.gyro_bias_sd_deg_h, 0.0);
        assert_eq!(scenario.imu.accel_bias_sd_ug, icm.accel_bias_sd_ug);
        assert_eq!(scenario.told, Some(Unit::find("tactical").unwrap()));
        let wrong = message("[imu]\npart = \"icm\"");
        assert!(
            wrong.starts_with("s.toml:2: imu.part: no part has the name \"icm\"; there are adis16495-1, "),
            "{wrong}"
        );
    }

    #[test]
    fn unknown_keys_name_file_line_key_and_the_known_ones() {
        assert_eq!(
            message("[place]\nlatitude_deg = 40\nlongitude_deg = 3\n"),
            "s.toml:3: place.longitude_deg: unknown key; known here: `latitude_deg`, `height_m`"
        );
        assert_eq!(
            message("[swing.pitch]\namplitude = 3\n"),
            "s.toml:2: swing.pitch.amplitude: unknown key; known here: `amplitude_deg`, `period_s`, `centre_deg`, \
             `phase_deg`"
        );
        assert_eq!(
            message("[encoder]\nbits = 21\nharmonics = [{ order = 1, size = 3.0 }]\n"),
            "s.toml:3: encoder.harmonics[0].size: unknown key; known here: `order`, `amplitude_arcsec`, `phase_deg`"
        );
        assert_eq!(
            message("name = \"x\"").split("; ").next().unwrap(),
            "s.toml:1: name: unknown key"
        );
    }

    #[test]
    fn wrong_types_say_what_is_expected() {
        assert_eq!(
            message("[run]\n\nrate_hz = \"fast\""),
            "s.toml:3: run.rate_hz: found string \"fast\", expected a number"
        );
        assert_eq!(
            message("[swing.heading]\ncentre_deg = \"north\""),
            "s.toml:2: swing.heading.centre_deg: found string \"north\", expected a number of degrees or \"random\""
        );
        assert_eq!(
            message("[encoder]\nbits = 2.5"),
            "s.toml:2: encoder.bits: found `2.5`, expected a whole number"
        );
        assert_eq!(
            message("rotor = 3"),
            "s.toml:1: rotor: found integer `3`, expected a table"
        );
        assert_eq!(
            message("lever_arm_m = [1, 2]"),
            "s.toml:1: lever_arm_m: invalid length 2, expected an array of length 3"
        );
    }

    #[test]
    fn values_out_of_range_say_what_is_allowed() {
        assert_eq!(
            message("[place]\nheight_m = 1\nlatitude_deg = 86"),
            "s.toml:3: place.latitude_deg: 86 is out of range, allowed are -85 to 85"
        );
        assert_eq!(
            message("[[encoder.harmonics]]\norder = 1\n\n[[encoder.harmonics]]\norder = 0\n"),
            "s.toml:5: encoder.harmonics[1].order: 0 is out of range, allowed are 1 to 1024"
        );
        assert_eq!(
            message("encoder = { bits = 99 }"),
            "s.toml:1: encoder.bits: 99 is out of range, allowed are 0 to 32"
        );
        assert_eq!(
            message("\nlever_arm_m = [1, 2, inf]"),
            "s.toml:2: lever_arm_m: inf is out of range, allowed are -100 to 100"
        );
        assert_eq!(
            message("[swing.pitch]\ncentre_deg = 80\namplitude_deg = 10"),
            "s.toml:1: swing.pitch: reaches beyond 85 degrees: lower centre or amplitude"
        );
        assert_eq!(
            message("\n[sea.roll]\nsignificant_deg = 50"),
            "s.toml:2: sea.roll: reaches beyond 180 degrees where all components meet: lower significant_deg or components"
        );
        assert_eq!(
            message("[[vibration]]\nhigh_hz = 9\nlow_hz = 9"),
            "s.toml:3: vibration[0].low_hz: must be below high_hz"
        );
        assert_eq!(
            message("[swing.roll]\ncentre_deg = \"random\""),
            "s.toml:2: swing.roll.centre_deg: only the heading's centre may be random"
        );
        assert_eq!(
            message("\n[rotor]\ntravel_deg = 1"),
            "s.toml:2: rotor: rotor travel is shorter than its two ramps: lower the rate, or raise travel or acceleration"
        );
        assert_eq!(message("\n\n[place\n").split(": ").next().unwrap(), "s.toml:3");
    }
}
