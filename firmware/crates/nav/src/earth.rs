//! Earth: its rotation and gravity at one place.
//!
//! ```text
//! ω_ie^n = ω_ie [0, cos L, sin L]
//! g(L, h) = g_e (1 + k sin²L)/√(1 − e² sin²L) · (1 − 2h/a (1 + f + m − 2f sin²L) + 3h²/a²)
//! ```
//!
//! WGS-84 (NIMA TR 8350.2, (4-1) Somigliana, (4-3) height). \[Xing18\] (8), (12), (13) give the
//! inertial frame; the first row of the printed (8) has the sine twice, the second is a cosine.
//!
//! Not modelled: the deflection of the vertical (a few seconds of arc, straight into tilt and, times
//! tan L, into heading) and gravity anomalies (harmless: only the direction of gravity is used).

use frames::{Inertial, Nav, Real, Rot, Vec3, math, units};
use nalgebra::Matrix3;

/// Rate of Earth's rotation, rad/s (WGS-84).
pub const OMEGA_IE: f64 = 7.292_115e-5;

/// Latitudes beyond this are refused, degrees: heading is lost as 1/cos L (eleven times the
/// equator's error here) and n itself turns with every step an observer takes.
pub const MAX_LATITUDE_DEG: f64 = 85.0;

/// Heights outside this range are refused, m: below any sea floor, above any aircraft.
pub const HEIGHT_RANGE_M: (f64, f64) = (-12_000.0, 30_000.0);

/// Why a place cannot be used.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum EarthError {
    /// The latitude is not a number, or beyond ±85°, where north is too weak to find.
    Latitude,
    /// The height is not a number, or outside −12 to 30 km.
    Height,
}

impl core::fmt::Display for EarthError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.write_str(match self {
            Self::Latitude => {
                "latitude must be a number between -85 and 85 degrees: nearer to a pole north cannot be found"
            }
            Self::Height => "height must be a number between -12000 and 30000 m",
        })
    }
}

impl core::error::Error for EarthError {}

/// Earth's rotation and gravity at one place.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Earth<T: Real = f32> {
    sin_lat: T,
    cos_lat: T,
    gravity: T,
}

impl<T: Real> Earth<T> {
    /// Latitude in rad, north positive; height above the ellipsoid in m.
    ///
    /// # Errors
    /// [`EarthError`] where the place is out of range.
    pub fn new(latitude: T, height: T) -> Result<Self, EarthError> {
        if !(latitude.finite() && latitude.abs() <= T::lit(MAX_LATITUDE_DEG * units::DEG * (1.0 + 1e-6))) {
            return Err(EarthError::Latitude);
        }
        let (low, high) = HEIGHT_RANGE_M;
        if !(height.finite() && height >= T::lit(low) && height <= T::lit(high)) {
            return Err(EarthError::Height);
        }
        let (sin_lat, cos_lat) = math::sin_cos(latitude);
        Ok(Self {
            sin_lat,
            cos_lat,
            gravity: somigliana(sin_lat, height),
        })
    }

    /// Rate of n against i, resolved in n, rad/s.
    pub fn w_ie_n(&self) -> Vec3<Nav, T> {
        let w = T::lit(OMEGA_IE);
        Vec3::new(T::zero(), w * self.cos_lat, w * self.sin_lat)
    }

    /// The part of Earth's rate that tells north, ω_ie cos L, rad/s.
    pub fn w_north(&self) -> T {
        T::lit(OMEGA_IE) * self.cos_lat
    }

    /// Magnitude of gravity, m/s².
    pub fn gravity(&self) -> T {
        self.gravity
    }

    /// Gravity resolved in n, m/s²: down.
    pub fn g_n(&self) -> Vec3<Nav, T> {
        Vec3::new(T::zero(), T::zero(), -self.gravity)
    }

    /// `C_i^n` at `t` seconds after the start, \[Xing18\] (8) with the first row corrected.
    pub fn c_ni(&self, t: T) -> Rot<Nav, Inertial, T> {
        let (s, c) = math::sin_cos(T::lit(OMEGA_IE) * t);
        let (sl, cl) = (self.sin_lat, self.cos_lat);
        Rot::from_matrix(&Matrix3::new(
            -s,
            c,
            T::zero(),
            -sl * c,
            -sl * s,
            cl,
            cl * c,
            cl * s,
            sl,
        ))
    }

    /// `V^i(t) = −∫ g^i dt` from 0 to `t`, m/s: what an ideal accelerometer that hangs still on
    /// Earth integrates to in the inertial frame (\[Xing18\] (13)).
    pub fn velocity_i(&self, t: T) -> Vec3<Inertial, T> {
        let w = T::lit(OMEGA_IE);
        let (s, c) = math::sin_cos(T::lit(0.5) * w * t);
        // sin ωt and 1 − cos ωt by the half angle: no cancellation for short times.
        let level = T::lit(2.0) * self.gravity * self.cos_lat * s / w;
        Vec3::new(level * c, level * s, self.gravity * self.sin_lat * t)
    }
}

/// Normal gravity, m/s².
fn somigliana<T: Real>(sin_lat: T, height: T) -> T {
    const A: f64 = 6_378_137.0;
    const F: f64 = 1.0 / 298.257_223_563;
    const G_EQUATOR: f64 = 9.780_325_335_9;
    const K: f64 = 1.931_852_652_41e-3;
    const E2: f64 = 6.694_379_990_14e-3;
    const M: f64 = 3.449_786_506_84e-3;
    let s2 = sin_lat * sin_lat;
    let one = T::one();
    let surface = T::lit(G_EQUATOR) * (one + T::lit(K) * s2) / math::sqrt(one - T::lit(E2) * s2);
    let h = height * T::lit(1.0 / A);
    surface * (one - T::lit(2.0) * h * (T::lit(1.0 + F + M) - T::lit(2.0 * F) * s2) + T::lit(3.0) * h * h)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn earth(latitude_deg: f64) -> Earth<f64> {
        Earth::new(latitude_deg * units::DEG, 0.0).unwrap()
    }

    #[test]
    fn gravity_of_the_standard() {
        // WGS-84: equator and pole (through the formula itself, the pole is refused as a place).
        assert!((earth(0.0).gravity() - 9.780_325_335_9).abs() < 1e-12);
        assert!((somigliana(1.0_f64, 0.0) - 9.832_184_937_8).abs() < 1e-8);
        // 45°: 9.8061977694 m/s²; the same on both sides of the equator.
        assert!((earth(45.0).gravity() - 9.806_197_769_4).abs() < 1e-8);
        assert_eq!(earth(45.0).gravity(), earth(-45.0).gravity());
        // Free-air gradient: −3.086e-6 per second squared.
        let up = Earth::new(0.8_f64, 1000.0).unwrap().gravity() - Earth::new(0.8_f64, 0.0).unwrap().gravity();
        assert!((up / 1000.0 + 3.086e-6).abs() < 2e-9, "{up}");
    }

    #[test]
    fn inertial_frame_turns_with_earth() {
        for latitude_deg in [-70.0, -35.0, 0.0, 40.0, 85.0] {
            let e = earth(latitude_deg);
            let (t, h) = (1234.0, 0.5);
            // Ċ_i^n = −ω_ie^n × C_i^n.
            let difference = (e.c_ni(t + h).matrix() - e.c_ni(t - h).matrix()) / (2.0 * h);
            let expected = -(e.w_ie_n().skew() * e.c_ni(t).matrix());
            assert!((difference - expected).norm() < 1e-12, "{latitude_deg}");
            // V̇^i = −g^i = C_n^i [0 0 g].
            let rate = (e.velocity_i(t + h) - e.velocity_i(t - h)) / (2.0 * h);
            assert!((rate + e.c_ni(t).inverse() * e.g_n()).norm() < 1e-8, "{latitude_deg}");
        }
    }

    #[test]
    fn single_precision_keeps_the_signal() {
        let (e32, e64) = (
            Earth::<f32>::new(0.7, 100.0).unwrap(),
            Earth::<f64>::new(f64::from(0.7_f32), 100.0).unwrap(),
        );
        for k in 1..60 {
            let t = f64::from(k) * 10.0;
            let (v32, v64) = (e32.velocity_i(f32::lit(t)).cast::<f64>(), e64.velocity_i(t));
            assert!((v32 - v64).norm() < 3e-7 * v64.norm());
        }
    }

    #[test]
    fn places_out_of_range_are_refused() {
        let new = |latitude_deg: f64, height| Earth::<f32>::new(f32::lit(latitude_deg * units::DEG), height);
        assert_eq!(new(85.1, 0.0), Err(EarthError::Latitude));
        assert_eq!(new(-90.0, 0.0), Err(EarthError::Latitude));
        assert_eq!(new(f64::NAN, 0.0), Err(EarthError::Latitude));
        assert_eq!(new(10.0, f32::INFINITY), Err(EarthError::Height));
        assert!(new(85.0, 0.0).is_ok() && new(-85.0, 0.0).is_ok());
    }
}
