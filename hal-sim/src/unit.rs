//! The unit's noise and bias figures: what a `UNIT.toml` holds, and the `[imu]` table of a scenario.
//!
//! They are 1σ figures of a kind of unit, not the errors of one: the simulator draws errors from them, the aligner
//! weighs its measurements by them.

use std::path::Path;

use crate::config::{self, ConfigError, Table, table};

table! {
    /// Noise and bias figures of an IMU, every axis alike.
    ///
    /// The default is the paper's IMU, \[Xing18\] Table 2: 10 °/h, 0.02 °/√h, 100 µg, 10 µg/√Hz.
    pub struct Unit {
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

impl Unit {
    /// Reads a `UNIT.toml`. Keys left out have the paper's figures.
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
        assert!(
            message("gyro_bias = 3").starts_with(
                "u.toml:1: gyro_bias: unknown key; known here: `gyro_bias_sd_deg_h`, `accel_bias_sd_ug`, "
            )
        );
        assert!(message("gyro_bias_sd_deg_h = ").starts_with("u.toml:1: not valid TOML: "));
        let missing = Unit::load(Path::new("/nonexistent/u.toml")).unwrap_err().to_string();
        assert!(missing.starts_with("/nonexistent/u.toml: cannot read: "), "{missing}");
    }
}
