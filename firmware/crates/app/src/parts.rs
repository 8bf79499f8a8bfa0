//! The supported IMUs with their error figures: the configuration of a unit whose own figures have not been measured.
//!
//! The figures are 1σ. Where a data sheet gives a typical value it is taken as that; a term that no sheet gives is set to what
//! parts of the kind have, never to zero, and [`Part::source`] says which those are. Only the paper's IMU has terms that are
//! known to be zero.

use frames::units::{ARC_MIN, DEG_PER_HOUR, DEG_PER_SQRT_HOUR, MICRO_G, MICRO_G_PER_SQRT_HZ, PPM, STANDARD_GRAVITY};
use nav::noise::ImuNoise;

/// A kind of IMU.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Part {
    /// As it is typed.
    pub name: &'static str,
    /// What it is.
    pub title: &'static str,
    /// Where the figures are from.
    pub source: &'static str,
    /// Its figures.
    pub noise: ImuNoise,
}

/// Figures in the units of a data sheet, 1σ.
struct Sheet {
    gyro_bias_deg_h: f64,
    angle_random_walk_deg_sqrt_h: f64,
    /// At the best of the Allan deviation; a Gauss–Markov process has 1.6 times as much.
    gyro_instability_deg_h: f64,
    gyro_scale_factor_ppm: f64,
    gyro_misalignment_arcmin: f64,
    gyro_g_sensitivity_deg_h_g: f64,
    gyro_housing_deg_h: f64,
    accel_bias_ug: f64,
    velocity_random_walk_ug_sqrt_hz: f64,
    accel_instability_ug: f64,
    accel_scale_factor_ppm: f64,
    accel_misalignment_arcmin: f64,
}

/// 1σ of a Gauss–Markov process for the lowest point of its Allan deviation: 0.617 σ, at 1.89 τ.
const OF_ALLAN: f64 = 1.6;

impl Sheet {
    #[expect(clippy::cast_possible_truncation, reason = "figures of two digits")]
    const fn noise(&self) -> ImuNoise {
        ImuNoise {
            gyro_bias_sd: (self.gyro_bias_deg_h * DEG_PER_HOUR) as f32,
            accel_bias_sd: (self.accel_bias_ug * MICRO_G) as f32,
            angle_random_walk: (self.angle_random_walk_deg_sqrt_h * DEG_PER_SQRT_HOUR) as f32,
            velocity_random_walk: (self.velocity_random_walk_ug_sqrt_hz * MICRO_G_PER_SQRT_HZ) as f32,
            gyro_instability_sd: (OF_ALLAN * self.gyro_instability_deg_h * DEG_PER_HOUR) as f32,
            gyro_instability_tau: 100.0,
            gyro_scale_factor_sd: (self.gyro_scale_factor_ppm * PPM) as f32,
            gyro_misalignment_sd: (self.gyro_misalignment_arcmin * ARC_MIN) as f32,
            gyro_g_sensitivity_sd: (self.gyro_g_sensitivity_deg_h_g * DEG_PER_HOUR / STANDARD_GRAVITY) as f32,
            gyro_housing_sd: (self.gyro_housing_deg_h * DEG_PER_HOUR) as f32,
            accel_scale_factor_sd: (self.accel_scale_factor_ppm * PPM) as f32,
            accel_misalignment_sd: (self.accel_misalignment_arcmin * ARC_MIN) as f32,
            accel_instability_sd: (OF_ALLAN * self.accel_instability_ug * MICRO_G) as f32,
            accel_instability_tau: 100.0,
        }
    }
}

/// ADIS16495-1, ±125 °/s. Walk, both instabilities, misalignment of the gyros: data sheet rev. C, first page. The rest is
/// assumed.
const ADIS16495_1_SHEET: Sheet = Sheet {
    gyro_bias_deg_h: 250.0,
    angle_random_walk_deg_sqrt_h: 0.09,
    gyro_instability_deg_h: 0.8,
    gyro_scale_factor_ppm: 1000.0,
    gyro_misalignment_arcmin: 3.0,
    gyro_g_sensitivity_deg_h_g: 20.0,
    gyro_housing_deg_h: 0.1,
    accel_bias_ug: 2000.0,
    velocity_random_walk_ug_sqrt_hz: 13.6,
    accel_instability_ug: 3.2,
    accel_scale_factor_ppm: 500.0,
    accel_misalignment_arcmin: 3.0,
};

const ADIS_SOURCE: &str = "data sheet rev. C, first page: walk and instability of -1, gyro misalignment, accelerometer instability; the rest assumed";

/// What can be bought as a tactical MEMS IMU, none of it known to be better.
const TACTICAL: Sheet = Sheet {
    gyro_bias_deg_h: 250.0,
    angle_random_walk_deg_sqrt_h: 0.2,
    gyro_instability_deg_h: 3.0,
    gyro_scale_factor_ppm: 2000.0,
    gyro_misalignment_arcmin: 6.0,
    gyro_g_sensitivity_deg_h_g: 36.0,
    gyro_housing_deg_h: 0.2,
    accel_bias_ug: 3000.0,
    velocity_random_walk_ug_sqrt_hz: 100.0,
    accel_instability_ug: 30.0,
    accel_scale_factor_ppm: 1000.0,
    accel_misalignment_arcmin: 6.0,
};

/// ICM-42688-P. Walks: data sheet rev. 1.7, first page (2.8 m°/s/√Hz, 70 µg/√Hz). The rest is assumed.
const ICM42688_SHEET: Sheet = Sheet {
    gyro_bias_deg_h: 1800.0,
    angle_random_walk_deg_sqrt_h: 0.168,
    gyro_instability_deg_h: 3.0,
    gyro_scale_factor_ppm: 5000.0,
    gyro_misalignment_arcmin: 10.0,
    gyro_g_sensitivity_deg_h_g: 36.0,
    gyro_housing_deg_h: 0.2,
    accel_bias_ug: 20_000.0,
    velocity_random_walk_ug_sqrt_hz: 70.0,
    accel_instability_ug: 30.0,
    accel_scale_factor_ppm: 5000.0,
    accel_misalignment_arcmin: 10.0,
};

/// \[Xing18\] Table 2: what is not in it is zero there.
const PAPER: Sheet = Sheet {
    gyro_bias_deg_h: 10.0,
    angle_random_walk_deg_sqrt_h: 0.02,
    gyro_instability_deg_h: 0.0,
    gyro_scale_factor_ppm: 0.0,
    gyro_misalignment_arcmin: 0.0,
    gyro_g_sensitivity_deg_h_g: 0.0,
    gyro_housing_deg_h: 0.0,
    accel_bias_ug: 100.0,
    velocity_random_walk_ug_sqrt_hz: 10.0,
    accel_instability_ug: 0.0,
    accel_scale_factor_ppm: 0.0,
    accel_misalignment_arcmin: 0.0,
};

/// The reference board's.
pub const ADIS16495_1: Part = Part {
    name: "adis16495-1",
    title: "ADIS16495-1, 125 degrees/s",
    source: ADIS_SOURCE,
    noise: ADIS16495_1_SHEET.noise(),
};

/// The cheap one.
pub const ICM42688: Part = Part {
    name: "icm42688",
    title: "ICM-42688-P",
    source: "data sheet rev. 1.7, first page: walks; the rest assumed",
    noise: ICM42688_SHEET.noise(),
};

/// The part of which nothing is known.
pub const UNKNOWN: Part = Part {
    name: "tactical",
    title: "an unknown tactical MEMS IMU",
    source: "what such parts are sold with",
    noise: TACTICAL.noise(),
};

/// Every part, by name.
pub const PARTS: [Part; 6] = [
    ADIS16495_1,
    Part {
        name: "adis16495-2",
        title: "ADIS16495-2, 450 degrees/s",
        source: ADIS_SOURCE,
        noise: Sheet {
            angle_random_walk_deg_sqrt_h: 0.1,
            gyro_instability_deg_h: 1.6,
            ..ADIS16495_1_SHEET
        }
        .noise(),
    },
    Part {
        name: "adis16495-3",
        title: "ADIS16495-3, 2000 degrees/s",
        source: ADIS_SOURCE,
        noise: Sheet {
            angle_random_walk_deg_sqrt_h: 0.18,
            gyro_instability_deg_h: 3.3,
            ..ADIS16495_1_SHEET
        }
        .noise(),
    },
    ICM42688,
    Part {
        name: "paper",
        title: "the IMU of the main paper, Table 2, without scale factors, misalignments and g-sensitivity",
        source: "[Xing18] Table 2",
        noise: PAPER.noise(),
    },
    UNKNOWN,
];

/// The part of this name.
pub fn find(name: &str) -> Option<&'static Part> {
    PARTS.iter().find(|part| part.name == name)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_part_can_be_told_to_a_filter_and_found_by_its_name() {
        for part in &PARTS {
            assert!(part.noise.is_valid(), "{}", part.name);
            assert_eq!(find(part.name), Some(part));
        }
        assert_eq!(find("mpu6050"), None);
    }

    #[test]
    fn the_papers_is_the_default_and_nobody_else_is_perfect() {
        let [paper, unknown] = ["paper", "tactical"].map(|name| find(name).unwrap().noise);
        let default = ImuNoise::<f32>::default();
        assert!((paper.angle_random_walk / default.angle_random_walk - 1.0).abs() < 1e-6);
        assert_eq!(paper.gyro_scale_factor_sd, default.gyro_scale_factor_sd);
        for part in PARTS.iter().filter(|part| part.name != "paper") {
            let n = &part.noise;
            for (figure, most) in [
                (n.gyro_instability_sd, 2.0 * unknown.gyro_instability_sd),
                (n.gyro_scale_factor_sd, 5e-3),
                (n.gyro_misalignment_sd, 5e-3),
                (n.gyro_g_sensitivity_sd, 1e-4),
                (n.gyro_housing_sd, 1e-5),
                (n.accel_instability_sd, 1e-2),
                (n.accel_scale_factor_sd, 1e-2),
                (n.accel_misalignment_sd, 1e-2),
            ] {
                assert!(figure > 0.0 && figure <= most, "{}: {figure}", part.name);
            }
        }
    }
}
