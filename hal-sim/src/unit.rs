//! The unit's noise and bias figures: what a `UNIT.toml` holds, and the `[imu]` table of a scenario.
//!
//! They are 1σ figures of a kind of unit, not the errors of one: the simulator draws errors from them, the aligner
//! weighs its measurements by them.

use std::path::{Path, PathBuf};

use app::parts::{self, Part};
use frames::units::{ARC_MIN, DEG_PER_HOUR, DEG_PER_SQRT_HOUR, MICRO_G, MICRO_G_PER_SQRT_HZ, PPM, STANDARD_GRAVITY};
use nav::noise::ImuNoise;
use serde::de::Error as _;
use serde::{Deserialize, Deserializer};

use crate::config::{self, ConfigError, ConfigProblem, Table, table};

table! {
    /// Noise and bias figures of an IMU, every axis alike.
    ///
    /// The default is the paper's IMU, \[Xing18\] Table 2: 10 °/h, 0.02 °/√h, 100 µg, 10 µg/√Hz. With `part = "NAME"`
    /// keys left out are those of that part, see [`app::parts`].
    pub struct Unit, keys left out by part: NamedPart {
        numbers {
            /// Turn-on bias of the gyros, 1σ, °/h.
            gyro_bias_sd_deg_h: f64 = 10.0, [0.0, 100000.0];
            /// Turn-on bias of the accelerometers, 1σ, µg.
            accel_bias_sd_ug: f64 = 100.0, [0.0, 1000000.0];
            /// Angle random walk, °/√h.
            angle_random_walk_deg_sqrt_h: f64 = 0.02, [0.0, 100.0];
            /// Velocity random walk, µg/√Hz.
            velocity_random_walk_ug_sqrt_hz: f64 = 10.0, [0.0, 100000.0];
            /// Bias instability of the gyros as a first-order Gauss–Markov process, 1σ, °/h. Zero: none.
            gyro_instability_deg_h: f64 = 0.0, [0.0, 10000.0];
            /// Its correlation time, s.
            gyro_instability_tau_s: f64 = 100.0, [0.1, 1000000.0];
            /// Scale factors of the gyros after calibration, 1σ, ppm.
            gyro_scale_factor_sd_ppm: f64 = 0.0, [0.0, 100000.0];
            /// Misalignments of the gyros after calibration, each off-diagonal term, 1σ, arc minutes.
            gyro_misalignment_sd_arcmin: f64 = 0.0, [0.0, 600.0];
            /// Response of the gyros to specific force, each term of the full matrix, 1σ, °/h per g.
            gyro_g_sensitivity_sd_deg_h_g: f64 = 0.0, [0.0, 10000.0];
            /// A gyro error that is constant in the housing, once a turn for the gyros: each level component, 1σ, °/h.
            gyro_housing_sd_deg_h: f64 = 0.0, [0.0, 10000.0];
            /// Scale factors of the accelerometers after calibration, 1σ, ppm.
            accel_scale_factor_sd_ppm: f64 = 0.0, [0.0, 100000.0];
            /// Misalignments of the accelerometers after calibration, each off-diagonal term, 1σ, arc minutes.
            accel_misalignment_sd_arcmin: f64 = 0.0, [0.0, 600.0];
            /// Bias instability of the accelerometers as a first-order Gauss–Markov process, 1σ, µg. Zero: none.
            accel_instability_ug: f64 = 0.0, [0.0, 100000.0];
            /// Its correlation time, s.
            accel_instability_tau_s: f64 = 100.0, [0.1, 1000000.0];
        }
        tables {}
    }
}

/// A part by its name in a file.
struct NamedPart(&'static Part);

impl<'de> Deserialize<'de> for NamedPart {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let name = String::deserialize(deserializer)?;
        parts::find(&name)
            .map(Self)
            .ok_or_else(|| D::Error::custom(format!("no part has the name \"{name}\"; there are {}", names())))
    }
}

impl From<NamedPart> for Unit {
    fn from(NamedPart(part): NamedPart) -> Self {
        Self::of_part(part)
    }
}

/// The names of the parts.
fn names() -> String {
    parts::PARTS.map(|part| part.name).join(", ")
}

impl Unit {
    /// Reads a `UNIT.toml`. Keys left out have the paper's figures, or those of the `part` it names.
    ///
    /// # Errors
    /// [`ConfigError`]: one line with file, line and key.
    pub fn load(path: &Path) -> Result<Self, ConfigError> {
        Self::parse(&config::read(path)?, &path.display().to_string())
    }

    /// The same from text; `file_name` is for the error message only.
    ///
    /// # Errors
    /// [`ConfigError`]: one line with file, line and key.
    pub fn parse(text: &str, file_name: &str) -> Result<Self, ConfigError> {
        config::parse(text, file_name, |unit: &Self| unit.check(""))
    }

    /// The figures of a part by its name, see [`app::parts`], or those of a `UNIT.toml`.
    ///
    /// # Errors
    /// [`ConfigError`]: one line, with the names there are where the file does not exist.
    pub fn find(name_or_file: &str) -> Result<Self, ConfigError> {
        if let Some(part) = parts::find(name_or_file) {
            return Ok(Self::of_part(part));
        }
        Self::load(Path::new(name_or_file)).map_err(|error| match error.problem {
            ConfigProblem::Read(why) => ConfigError {
                problem: ConfigProblem::UnknownPart { why, names: names() },
                ..error
            },
            _ => error,
        })
    }

    /// The figures of a part as its data sheet has them.
    pub fn of_part(part: &Part) -> Self {
        // An f32 has six digits, a data sheet two.
        Self::from_noise(&part.noise, |value| {
            let digits = if value > 0.0 {
                6 - value.log10().ceil() as i32
            } else {
                0
            };
            let scale = 10_f64.powi(digits);
            (value * scale).round() / scale
        })
    }

    /// The figures in the units of a data sheet: the inverse of [`align::noise`](crate::align::noise), to the bit.
    pub fn of_noise(noise: &ImuNoise) -> Self {
        Self::from_noise(noise, |value| value)
    }

    fn from_noise(noise: &ImuNoise, value: impl Fn(f64) -> f64) -> Self {
        let in_units = |figure: f32, unit: f64| value(f64::from(figure) / unit);
        let default = Self::default();
        let tau = |sd: f32, tau: f32, default: f64| if sd > 0.0 { tau.into() } else { default };
        Self {
            gyro_bias_sd_deg_h: in_units(noise.gyro_bias_sd, DEG_PER_HOUR),
            accel_bias_sd_ug: in_units(noise.accel_bias_sd, MICRO_G),
            angle_random_walk_deg_sqrt_h: in_units(noise.angle_random_walk, DEG_PER_SQRT_HOUR),
            velocity_random_walk_ug_sqrt_hz: in_units(noise.velocity_random_walk, MICRO_G_PER_SQRT_HZ),
            gyro_instability_deg_h: in_units(noise.gyro_instability_sd, DEG_PER_HOUR),
            gyro_instability_tau_s: tau(
                noise.gyro_instability_sd,
                noise.gyro_instability_tau,
                default.gyro_instability_tau_s,
            ),
            gyro_scale_factor_sd_ppm: in_units(noise.gyro_scale_factor_sd, PPM),
            gyro_misalignment_sd_arcmin: in_units(noise.gyro_misalignment_sd, ARC_MIN),
            gyro_g_sensitivity_sd_deg_h_g: in_units(noise.gyro_g_sensitivity_sd, DEG_PER_HOUR / STANDARD_GRAVITY),
            gyro_housing_sd_deg_h: in_units(noise.gyro_housing_sd, DEG_PER_HOUR),
            accel_scale_factor_sd_ppm: in_units(noise.accel_scale_factor_sd, PPM),
            accel_misalignment_sd_arcmin: in_units(noise.accel_misalignment_sd, ARC_MIN),
            accel_instability_ug: in_units(noise.accel_instability_sd, MICRO_G),
            accel_instability_tau_s: tau(
                noise.accel_instability_sd,
                noise.accel_instability_tau,
                default.accel_instability_tau_s,
            ),
        }
    }

    /// Where the figures of the IMU that wrote a log are: `LOG.unit.toml` beside `LOG.csv`.
    pub fn beside(log: &Path) -> PathBuf {
        log.with_extension("unit.toml")
    }

    /// As a `UNIT.toml`.
    ///
    /// # Errors
    /// None that can be: every field is a number.
    pub fn to_toml(&self) -> Result<String, toml::ser::Error> {
        toml::to_string(self)
    }

    /// A unit without any error.
    pub fn perfect() -> Self {
        Self {
            gyro_bias_sd_deg_h: 0.0,
            accel_bias_sd_ug: 0.0,
            angle_random_walk_deg_sqrt_h: 0.0,
            velocity_random_walk_ug_sqrt_hz: 0.0,
            ..Self::default()
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn keys_left_out_are_the_papers() {
        assert_eq!(Unit::parse("", "u.toml").unwrap(), Unit::default());
        let unit = Unit::parse("gyro_bias_sd_deg_h = 3\n", "u.toml").unwrap();
        assert_eq!(unit.gyro_bias_sd_deg_h, 3.0);
        assert_eq!(unit.accel_bias_sd_ug, 100.0);
    }

    #[test]
    fn parts_are_found_by_name_and_others_are_files() {
        assert_eq!(Unit::find("paper").unwrap(), Unit::default());
        let adis = Unit::find("adis16495-1").unwrap();
        assert_eq!(
            (adis.angle_random_walk_deg_sqrt_h, adis.gyro_bias_sd_deg_h),
            (0.09, 250.0)
        );
        assert_eq!(
            (adis.accel_misalignment_sd_arcmin, adis.gyro_g_sensitivity_sd_deg_h_g),
            (3.0, 20.0)
        );
        assert_eq!(Unit::parse(&adis.to_toml().unwrap(), "u.toml").unwrap(), adis);
        let unknown = Unit::find("adis16495").unwrap_err().to_string();
        assert!(
            unknown.starts_with("adis16495: neither a part (adis16495-1, adis16495-2, ")
                && unknown.contains("nor a file"),
            "{unknown}"
        );
    }

    #[test]
    fn a_part_gives_what_is_left_out_and_keys_beside_it_go_before() {
        for part in &parts::PARTS {
            let text = format!("part = \"{}\"", part.name);
            assert_eq!(Unit::parse(&text, "u.toml").unwrap(), Unit::of_part(part));
        }
        let adis = Unit::find("adis16495-1").unwrap();
        let read = Unit::parse("accel_bias_sd_ug = 7\npart = \"adis16495-1\"\n", "u.toml").unwrap();
        let expected = Unit {
            accel_bias_sd_ug: 7.0,
            ..adis
        };
        assert_eq!(read, expected);
        assert_eq!(
            Unit::parse("\npart = \"adis\"", "u.toml").unwrap_err().to_string(),
            format!("u.toml:2: part: no part has the name \"adis\"; there are {}", names())
        );
        assert_eq!(
            Unit::parse("part = 3", "u.toml").unwrap_err().to_string(),
            "u.toml:1: part: found integer `3`, expected a string"
        );
    }

    #[test]
    fn errors_name_file_line_and_key() {
        let message = |text: &str| Unit::parse(text, "u.toml").unwrap_err().to_string();
        assert_eq!(
            message("\ngyro_bias_sd_deg_h = -1"),
            "u.toml:2: gyro_bias_sd_deg_h: -1 is out of range, allowed are 0 to 100000"
        );
        assert_eq!(
            message("gyro_instability_tau_s = nan"),
            "u.toml:1: gyro_instability_tau_s: NaN is out of range, allowed are 0.1 to 1000000"
        );
        assert_eq!(
            message("# a\n# b\naccel_bias_sd_ug = \"much\""),
            "u.toml:3: accel_bias_sd_ug: found string \"much\", expected a number"
        );
        assert!(message("gyro_bias = 3").starts_with(
            "u.toml:1: gyro_bias: unknown key; known here: `part`, `gyro_bias_sd_deg_h`, `accel_bias_sd_ug`, "
        ));
        assert!(message("gyro_bias_sd_deg_h = ").starts_with("u.toml:1: not valid TOML: "));
        let missing = Unit::load(Path::new("/nonexistent/u.toml")).unwrap_err().to_string();
        assert!(missing.starts_with("/nonexistent/u.toml: cannot read: "), "{missing}");
    }
}
