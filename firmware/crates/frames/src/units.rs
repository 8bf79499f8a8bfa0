//! Conversion factors: multiply to get SI and radians, divide to get back.
//!
//! ```
//! use frames::units::{DEG, DEG_PER_HOUR};
//! let rate = 20.0 * DEG;                  // 20 °/s in rad/s
//! let bias_deg_h = 4.85e-5 / DEG_PER_HOUR; // about 10 °/h
//! assert!((bias_deg_h - 10.0).abs() < 0.01 && rate < 0.35);
//! ```

/// One degree in radians.
pub const DEG: f64 = core::f64::consts::PI / 180.0;
/// One minute of arc in radians.
pub const ARC_MIN: f64 = DEG / 60.0;
/// One second of arc in radians.
pub const ARC_SEC: f64 = DEG / 3600.0;
/// One degree an hour in rad/s.
pub const DEG_PER_HOUR: f64 = DEG / 3600.0;
/// One degree per root hour (angle random walk) in rad/√s.
pub const DEG_PER_SQRT_HOUR: f64 = DEG / 60.0;
/// Standard gravity in m/s²: the g of accelerometer data sheets, not the local one.
pub const STANDARD_GRAVITY: f64 = 9.806_65;
/// One micro-g in m/s².
pub const MICRO_G: f64 = STANDARD_GRAVITY * 1e-6;
/// One µg/√Hz (velocity random walk) in m/s/√s.
pub const MICRO_G_PER_SQRT_HZ: f64 = MICRO_G;
/// One part in a million.
pub const PPM: f64 = 1e-6;
