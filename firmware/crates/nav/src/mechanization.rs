//! Rotary inertial navigation: attitude, velocity and position from a turning IMU.
//!
//! [`Mechanization`] takes the [`Increment`]s of the IMU and carries the attitude of s, the velocity and the place:
//!
//! ```text
//! C_s^n(t+h) = exp(−ζ) C_s^n(t) exp(φ)                 ζ = (ω_ie^n + ω_en^n) h
//! v^n(t+h)   = v^n + (I − ½ζ×) C_s^n(t) Δv⁰ + (g^n − (2 ω_ie^n + ω_en^n) × v^n) h
//! L̇ = v_N/(M + H)     λ̇ = v_E/((N + H) cos L)     Ḣ = v_U
//! ω_en^n = [−v_N/(M + H), v_E/(N + H), v_E tan L/(N + H)]
//! M = a (1 − e²)/(1 − e² sin²L)^(3/2)     N = a/√(1 − e² sin²L)            (WGS-84)
//! C_b^n = C_s^n C_b^s
//! ```
//!
//! with rates, velocity and place of the middle of the interval wherever they multiply.
//!
//! \[Du16\] (1)–(2) take the rotor's rate off the gyros and turn what is left to b before integration,
//! `ω_ib^b = C_s^b (ω_is^s − ω_bs^s)`, `f^b = C_s^b f^s`, and integrate b's attitude. Integrating s and taking the
//! rotor's angle off at the end is the same motion (a test integrates both): but the encoder's errors then touch the
//! attitude that is read and never the velocity, and its rate need not be known at all.
//!
//! # Single precision
//!
//! Half an ulp of a latitude of 0.7 rad is 0.2 m in f32, so that the millimetres of a step would vanish. The place is
//! therefore kept as the way from the start, in a compensated sum: [`Mechanization::displacement`] is good to 1e-7 of
//! itself, and [`Mechanization::position`] to the half metre of the scalar. Attitude and velocity are compensated sums
//! as well.
//!
//! # The vertical
//!
//! Gravity that falls with height makes the free vertical channel unstable: an error grows as `cosh(√(2g/R) t)`,
//! threefold in 17 minutes and 300-fold in an hour. [`Vertical::Held`] keeps the height of the start, as on water.
//!
//! Not modelled: the deflection of the vertical and gravity anomalies; a lever arm between IMU and rotor axis.
//!
//! References: \[Du16\] Fig. 2; P. G. Savage, *Strapdown Inertial Navigation Integration Algorithm Design*, J. Guidance
//! 21 (1998), part 2.

use frames::{Attitude, Body, Nav, Real, Rot, RotIntegral, Sensor, Vec3, VecSum, math};

use crate::earth::{Earth, EarthError};
use crate::increment::{Increment, MAX_FORCE, MAX_INTERVAL, MAX_RATE};

/// Semi-major axis of the ellipsoid, m (WGS-84).
const A: f64 = 6_378_137.0;
/// First eccentricity squared of the ellipsoid (WGS-84).
const E2: f64 = 6.694_379_990_14e-3;

/// Fastest velocity accepted, m/s: three times that of sound, far from where the middle of an interval would not do.
pub const MAX_SPEED: f64 = 1000.0;

/// Why a navigator cannot start or go on. After an error in a step the state is that before it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum MechanizationError {
    /// The place cannot be navigated at: too near to a pole, or out of the range of heights.
    Place(EarthError),
    /// The longitude to start at is not a number.
    Longitude,
    /// The velocity is not a number, or faster than [`MAX_SPEED`].
    Velocity,
    /// An interval that is not in (0, [`MAX_INTERVAL`]].
    Interval,
    /// An increment that is not a number, or faster or harder than an IMU can measure.
    Increment,
}

impl core::fmt::Display for MechanizationError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            Self::Place(e) => e.fmt(f),
            Self::Longitude => f.write_str("longitude must be a number"),
            Self::Velocity => f.write_str("velocity must be a number and at most 1000 m/s"),
            Self::Interval => f.write_str("the interval of an increment must be between 0 and 1 s"),
            Self::Increment => f.write_str("an increment must be finite and within the range of an IMU"),
        }
    }
}

impl core::error::Error for MechanizationError {}

impl From<EarthError> for MechanizationError {
    fn from(e: EarthError) -> Self {
        Self::Place(e)
    }
}

/// A place on Earth.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Position<T: Real = f32> {
    /// Geodetic latitude, north positive, rad.
    pub latitude: T,
    /// Longitude, east positive, rad.
    pub longitude: T,
    /// Height above the ellipsoid, m.
    pub height: T,
}

/// What becomes of the vertical channel.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Vertical {
    /// Integrated like the others: unstable without a measurement of height.
    Free,
    /// Height as at the start, no vertical velocity.
    #[default]
    Held,
}

/// Radii of curvature of the ellipsoid at a latitude, m.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Radii<T: Real = f32> {
    /// In the meridian, M.
    pub meridian: T,
    /// In the prime vertical, N.
    pub prime_vertical: T,
}

impl<T: Real> Radii<T> {
    /// At the latitude with this sine.
    pub fn new(sin_latitude: T) -> Self {
        let one = T::one();
        let w2 = one - T::lit(E2) * sin_latitude * sin_latitude;
        let prime_vertical = T::lit(A) / math::sqrt(w2);
        Self {
            meridian: prime_vertical * T::lit(1.0 - E2) / w2,
            prime_vertical,
        }
    }
}

/// Earth as seen from one place: what a step needs of it.
#[derive(Debug, Clone, Copy)]
struct Local<T: Real> {
    earth: Earth<T>,
    /// 1/(M + H), 1/m.
    per_north: T,
    /// 1/(N + H), 1/m.
    per_east: T,
    cos_lat: T,
    tan_lat: T,
}

impl<T: Real> Local<T> {
    fn new(latitude: T, height: T) -> Result<Self, EarthError> {
        // Refuses the poles, so that the cosine below is a safe divisor.
        let earth = Earth::new(latitude, height)?;
        let (sin_lat, cos_lat) = math::sin_cos(latitude);
        let radii = Radii::new(sin_lat);
        Ok(Self {
            earth,
            per_north: T::one() / (radii.meridian + height),
            per_east: T::one() / (radii.prime_vertical + height),
            cos_lat,
            tan_lat: sin_lat / cos_lat,
        })
    }

    /// ω_en^n at a velocity, rad/s.
    fn w_en_n(&self, v_n: Vec3<Nav, T>) -> Vec3<Nav, T> {
        let east = v_n.x() * self.per_east;
        Vec3::new(-v_n.y() * self.per_north, east, east * self.tan_lat)
    }

    /// Gravity less Coriolis: the acceleration in n without specific force, m/s².
    fn free_fall(&self, v_n: Vec3<Nav, T>) -> Vec3<Nav, T> {
        self.earth.g_n() - (self.earth.w_ie_n() * T::lit(2.0) + self.w_en_n(v_n)).cross(v_n)
    }
}

/// Attitude, velocity and place, carried on from increment to increment.
///
/// ```
/// use frames::{Body, Rot, Vec3};
/// use nav::increment::Increment;
/// use nav::mechanization::{Mechanization, Position, Vertical};
///
/// let start = Position { latitude: 0.7_f32, longitude: 0.2, height: 0.0 };
/// let mut navigator = Mechanization::new(start, Vec3::zero(), Rot::identity(), Vertical::Held)?;
/// // 20 °/s about z, level, for 10 ms; the rotor has turned as much.
/// let increment = Increment { phi_s: Vec3::new(0.0, 0.0, 3.5e-3), dv_s: Vec3::new(0.0, 0.0, 0.0980), dt: 0.01 };
/// navigator.step(&increment)?;
/// let attitude = navigator.attitude(Rot::<Body, _, f32>::about_z(3.5e-3));
/// assert!(attitude.pitch.abs() < 1e-6 && navigator.velocity().norm() < 1e-3);
/// # Ok::<(), nav::mechanization::MechanizationError>(())
/// ```
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Mechanization<T: Real = f32> {
    start: Position<T>,
    vertical: Vertical,
    c_ns: RotIntegral<Nav, Sensor, T>,
    v_n: VecSum<Nav, T>,
    /// The way from the start: longitude (rad), latitude (rad), height (m), in the order of n.
    moved: VecSum<Nav, T>,
}

impl<T: Real> Mechanization<T> {
    /// A navigator at `start` with velocity `v_n`, m/s, whose IMU has the attitude `c_ns`.
    ///
    /// # Errors
    /// [`MechanizationError`] where place or velocity cannot be.
    pub fn new(
        start: Position<T>,
        v_n: Vec3<Nav, T>,
        c_ns: Rot<Nav, Sensor, T>,
        vertical: Vertical,
    ) -> Result<Self, MechanizationError> {
        Earth::new(start.latitude, start.height)?;
        if !start.longitude.finite() {
            return Err(MechanizationError::Longitude);
        }
        let v_n = match vertical {
            Vertical::Free => v_n,
            Vertical::Held => Vec3::new(v_n.x(), v_n.y(), T::zero()),
        };
        possible(v_n)?;
        Ok(Self {
            start,
            vertical,
            c_ns: RotIntegral::new(c_ns),
            v_n: VecSum::new(v_n),
            moved: VecSum::new(Vec3::zero()),
        })
    }

    /// Moves on by one increment.
    ///
    /// # Errors
    /// [`MechanizationError`] where the increment cannot be, or leads to where one cannot navigate. The state is then
    /// as before.
    pub fn step(&mut self, increment: &Increment<T>) -> Result<(), MechanizationError> {
        let Increment { phi_s, dv_s, dt } = *increment;
        // Comparisons with NaN are false.
        if !(dt > T::zero() && dt <= T::lit(MAX_INTERVAL)) {
            return Err(MechanizationError::Interval);
        }
        if !(phi_s.norm() <= T::lit(MAX_RATE) * dt && dv_s.norm() <= T::lit(MAX_FORCE) * dt) {
            return Err(MechanizationError::Increment);
        }
        let half = T::lit(0.5) * dt;
        let (v_start, moved) = (self.v_n.get(), self.moved.get());
        let level = |v: Vec3<Nav, T>| match self.vertical {
            Vertical::Free => v,
            Vertical::Held => Vec3::new(v.x(), v.y(), T::zero()),
        };

        // Earth at the middle: the place by the velocity of the start, off by the acceleration's ⅛ a h² at most.
        let here = Local::new(self.start.latitude + moved.y(), self.start.height + moved.z())?;
        let middle = Local::new(
            self.start.latitude + (moved.y() + v_start.y() * here.per_north * half),
            self.start.height + (moved.z() + v_start.z() * half),
        )?;

        // Velocity change by specific force, resolved in n as it stands at the middle.
        let dv_n = self.c_ns.get() * dv_s;
        let v_middle = level(v_start + dv_n * T::lit(0.5) + middle.free_fall(v_start) * half);
        let zeta_n = (middle.earth.w_ie_n() + middle.w_en_n(v_middle)) * dt;
        let dv_n = dv_n - zeta_n.cross(dv_n) * T::lit(0.5);

        let mut next = *self;
        // Both large parts of the vertical cancel before they meet the sum.
        next.v_n.add(level(dv_n + middle.free_fall(v_middle) * dt));
        let v_end = next.v_n.get();
        possible(v_end)?;

        // The mean of both ends: exact where the acceleration is constant over the interval.
        let v_mean = (v_start + v_end) * half;
        next.moved.add(Vec3::new(
            v_mean.x() * middle.per_east / middle.cos_lat,
            v_mean.y() * middle.per_north,
            v_mean.z(),
        ));
        next.c_ns.turn_from(phi_s);
        next.c_ns.turn_to(-zeta_n);
        let moved = next.moved.get();
        Earth::new(self.start.latitude + moved.y(), self.start.height + moved.z())?;
        *self = next;
        Ok(())
    }

    /// Puts it to another place with another velocity, m/s; the attitude stays. A height that is held stays as well.
    ///
    /// # Errors
    /// [`MechanizationError`] where place or velocity cannot be. The state is then as before.
    pub fn fix(&mut self, place: Position<T>, v_n: Vec3<Nav, T>) -> Result<(), MechanizationError> {
        let height = match self.vertical {
            Vertical::Free => place.height,
            Vertical::Held => self.position().height,
        };
        let fixed = Self::new(Position { height, ..place }, v_n, self.c_ns.get(), self.vertical)?;
        *self = Self {
            c_ns: self.c_ns,
            ..fixed
        };
        Ok(())
    }

    /// Attitude of the IMU.
    pub fn c_ns(&self) -> Rot<Nav, Sensor, T> {
        self.c_ns.get()
    }

    /// Attitude of the housing, for the rotor's position `c_bs` at the end of the last increment.
    pub fn c_nb(&self, c_bs: Rot<Body, Sensor, T>) -> Rot<Nav, Body, T> {
        self.c_ns.get() * c_bs.inverse()
    }

    /// Heading, pitch and roll of the housing, rad, for the rotor's position `c_bs`.
    pub fn attitude(&self, c_bs: Rot<Body, Sensor, T>) -> Attitude<T> {
        Attitude::from_rot(&self.c_nb(c_bs))
    }

    /// Velocity in n, m/s.
    pub fn velocity(&self) -> Vec3<Nav, T> {
        self.v_n.get()
    }

    /// The place, as well as the scalar can say it; longitude in [−π, π].
    pub fn position(&self) -> Position<T> {
        let moved = self.displacement();
        Position {
            latitude: self.start.latitude + moved.latitude,
            longitude: math::wrap_pi(self.start.longitude + moved.longitude),
            height: self.start.height + moved.height,
        }
    }

    /// Where it started.
    pub fn start(&self) -> Position<T> {
        self.start
    }

    /// The place less that of the start: the longitude does not wrap.
    pub fn displacement(&self) -> Position<T> {
        let moved = self.moved.get();
        Position {
            latitude: moved.y(),
            longitude: moved.x(),
            height: moved.z(),
        }
    }
}

fn possible<T: Real>(v_n: Vec3<Nav, T>) -> Result<(), MechanizationError> {
    if v_n.norm() <= T::lit(MAX_SPEED) {
        Ok(())
    } else {
        Err(MechanizationError::Velocity)
    }
}

#[cfg(test)]
mod tests {
    use core::f64::consts::TAU;

    use frames::units::DEG;
    use nalgebra::{Matrix3, Vector3};

    use super::*;
    use crate::earth::OMEGA_IE;
    use crate::increment::{ConingScullingCorrector, Sample};

    type S = Vec3<Sensor, f64>;
    type N = Vec3<Nav, f64>;

    const EQUATOR: Position<f64> = Position {
        latitude: 0.0,
        longitude: 0.3,
        height: 0.0,
    };

    fn at(latitude_deg: f64) -> Position<f64> {
        Position {
            latitude: latitude_deg * DEG,
            ..EQUATOR
        }
    }

    fn about(axis: usize, angle: f64) -> Rot<Sensor, Sensor, f64> {
        let mut v = [0.0; 3];
        v[axis] = angle;
        Rot::exp(S::new(v[0], v[1], v[2]))
    }

    /// Increments of an IMU that turns with the constant rate `w_ns_s` against n at a fixed place, over `dt`: both in
    /// closed form but for a quadrature of 3 nodes per 0.1 rad of turn.
    fn at_rest(place: Position<f64>, c_ns0: Rot<Nav, Sensor, f64>, w_ns_s: S, t: f64, dt: f64) -> Increment<f64> {
        let earth = Earth::new(place.latitude, place.height).unwrap();
        let c_ns = |t: f64| c_ns0 * Rot::exp(w_ns_s * t);
        let c_is = |t: f64| earth.c_ni(t).inverse() * c_ns(t);
        let start = c_is(t).inverse();
        let dv_s = gauss(t, dt, |t| {
            (start * (c_is(t) * (c_ns(t).inverse() * -earth.g_n()))).vector()
        });
        Increment {
            phi_s: (start * c_is(t + dt)).relabel::<Sensor, Sensor>().log(),
            dv_s: Vec3::from_vector(dv_s),
            dt,
        }
    }

    /// ∫ over [t, t + dt] by 5 intervals of the Gauss rule of 3 nodes.
    fn gauss(t: f64, dt: f64, f: impl Fn(f64) -> Vector3<f64>) -> Vector3<f64> {
        let h = dt / 5.0;
        (0..5)
            .map(|k| {
                let middle = t + (f64::from(k) + 0.5) * h;
                let off = 0.5 * h * 0.6_f64.sqrt();
                (f(middle) * 8.0 + (f(middle - off) + f(middle + off)) * 5.0) * (h / 18.0)
            })
            .sum()
    }

    #[test]
    fn radii_of_the_standard() {
        // NIMA TR 8350.2: M at the equator a(1 − e²), both at the pole the polar radius a/√(1 − e²).
        let equator = Radii::new(0.0_f64);
        assert!((equator.meridian - 6_335_439.327).abs() < 1e-3 && equator.prime_vertical == A);
        let pole = Radii::new(1.0_f64);
        assert!((pole.meridian - 6_399_593.626).abs() < 1e-3 && (pole.prime_vertical - pole.meridian).abs() < 1e-6);
        // A meridian quadrant is 10,001,965.729 m.
        let n = 10_000;
        let h = core::f64::consts::FRAC_PI_2 / f64::from(n);
        let quadrant: f64 = (0..n)
            .map(|k| Radii::new(((f64::from(k) + 0.5) * h).sin()).meridian * h)
            .sum();
        assert!((quadrant - 10_001_965.729).abs() < 1e-2, "{quadrant}");
    }

    #[test]
    fn an_hour_at_rest_with_exact_sensors() {
        for (latitude_deg, rate_dps) in [(40.0, 0.0), (-40.0, 20.0), (80.0, 20.0)] {
            let place = at(latitude_deg);
            let c_ns0 = Rot::from_yaw_pitch_roll(0.4, 0.05, -0.1) * Rot::about_z(0.0);
            let w = S::new(0.0, 0.0, rate_dps * DEG);
            let mut navigator = Mechanization::new(place, Vec3::zero(), c_ns0, Vertical::Free).unwrap();
            let dt = 0.1;
            for k in 0..36_000 {
                navigator
                    .step(&at_rest(place, c_ns0, w, f64::from(k) * dt, dt))
                    .unwrap();
            }
            let moved = navigator.displacement();
            let way = (moved.latitude * A).hypot(moved.longitude * A).hypot(moved.height);
            let turned = navigator.c_ns().angle_to(c_ns0 * Rot::exp(w * 3600.0));
            assert!(way < 0.05, "{latitude_deg}: {way} m");
            assert!(
                navigator.velocity().norm() < 1e-4,
                "{latitude_deg}: {:?}",
                navigator.velocity()
            );
            assert!(turned < 1e-8, "{latitude_deg}: {turned:e} rad");
        }
    }

    /// On the equator with n's axes as the IMU's, an error in the latitude alone (the attitude in space being right)
    /// swings as `cos ω_s t`, ω_s² = g/M, and nothing else moves: the north channel is free of Earth's rotation.
    #[test]
    fn schuler_period() {
        let error = 1e-5;
        let start = Position {
            latitude: error,
            ..EQUATOR
        };
        // The true n in the computed one: rotated about east by the error.
        let c_ns = Rot::exp(N::new(error, 0.0, 0.0)) * Rot::from_yaw_pitch_roll(0.0, 0.0, 0.0);
        let mut navigator = Mechanization::new(start, Vec3::zero(), c_ns.relabel(), Vertical::Held).unwrap();
        let omega = (9.780_325_335_9 / Radii::new(0.0_f64).meridian).sqrt();
        assert!((TAU / omega / 60.0 - 84.4).abs() < 0.2);
        let dt = 0.5;
        let (mut crossings, mut before) = ([0.0; 5], error);
        let (mut count, mut worst) = (0, 0.0_f64);
        for k in 0..26_000 {
            let t = f64::from(k) * dt;
            navigator
                .step(&at_rest(
                    EQUATOR,
                    Rot::from_yaw_pitch_roll(0.0, 0.0, 0.0).relabel(),
                    S::zero(),
                    t,
                    dt,
                ))
                .unwrap();
            let latitude = navigator.position().latitude;
            if before > 0.0 && latitude <= 0.0 || before < 0.0 && latitude >= 0.0 {
                crossings[count] = t + dt * before / (before - latitude);
                count += 1;
            }
            before = latitude;
            worst = worst.max((latitude - error * (omega * (t + dt)).cos()).abs());
        }
        assert_eq!(count, 5);
        let period = (crossings[4] - crossings[0]) / 2.0;
        assert!((period * omega / TAU - 1.0).abs() < 1e-3, "{} min", period / 60.0);
        // Phase by a thousandth over two and a half periods would be 0.016.
        assert!(worst < 1e-3 * error, "{}", worst / error);
    }

    /// A heading error ψ on the equator stays fixed in space, so that n turns it into a tilt about east at Earth's rate,
    /// and Schuler follows: `δL = ψ/(1 − Ω²/ω²) (sin Ωt − Ω/ω sin ωt)`. Both periods over a day.
    #[test]
    fn earth_rate_period() {
        let psi = 1e-5;
        let c_true = Rot::from_yaw_pitch_roll(0.0, 0.0, 0.0).relabel::<Nav, Sensor>();
        let c_ns = Rot::exp(N::new(0.0, 0.0, psi)) * c_true;
        let mut navigator = Mechanization::new(EQUATOR, Vec3::zero(), c_ns, Vertical::Held).unwrap();
        let omega = (9.780_325_335_9 / Radii::new(0.0_f64).meridian).sqrt();
        let ratio = OMEGA_IE / omega;
        let dt = 1.0;
        let (mut worst, mut largest) = (0.0_f64, 0.0_f64);
        for k in 0..86_164 {
            let t = f64::from(k) * dt;
            navigator.step(&at_rest(EQUATOR, c_true, S::zero(), t, dt)).unwrap();
            let t = t + dt;
            let expected = psi / (1.0 - ratio * ratio) * ((OMEGA_IE * t).sin() - ratio * (omega * t).sin());
            let latitude = navigator.position().latitude;
            largest = largest.max(latitude.abs());
            worst = worst.max((latitude.abs() - expected.abs()).abs());
        }
        assert!(largest > psi);
        // A thousandth of either period would show as 0.006.
        assert!(worst < 1e-3 * psi, "{}", worst / psi);
    }

    /// Geodetic from Earth-fixed coordinates, to rounding.
    fn geodetic(r: Vector3<f64>) -> Position<f64> {
        let p = r.x.hypot(r.y);
        let mut latitude = r.z.atan2(p * (1.0 - E2));
        for _ in 0..8 {
            let n = Radii::new(latitude.sin()).prime_vertical;
            latitude = (r.z + E2 * n * latitude.sin()).atan2(p);
        }
        let n = Radii::new(latitude.sin()).prime_vertical;
        Position {
            latitude,
            longitude: r.y.atan2(r.x),
            height: p / latitude.cos() - n,
        }
    }

    fn c_ne(place: Position<f64>) -> Matrix3<f64> {
        let (sl, cl) = place.latitude.sin_cos();
        let (so, co) = place.longitude.sin_cos();
        Matrix3::new(-so, co, 0.0, -sl * co, -sl * so, cl, cl * co, cl * so, sl)
    }

    /// A circle about Earth's centre that crosses the equator and reaches 55°, at 300 m/s, on a turning IMU; the height
    /// above the ellipsoid changes by 14 km on the way. Kinematics in Earth-fixed and inertial coordinates, gravity
    /// along the ellipsoid's normal.
    ///
    /// What goes in is rounded to the scalar `I`, what is computed to `T`. A `dither`, rad, on the angle increments
    /// stands for the noise of an IMU: increments that are all equal are all rounded to the same side.
    fn great_circle<I: Real, T: Real>(
        seconds: u32,
        dt: f64,
        dither: f64,
    ) -> (Mechanization<T>, Position<f64>, N, Rot<Nav, Sensor, f64>) {
        let rounded = |x: f64| T::lit(I::lit(x).to_f64());
        let radius = A + 2000.0;
        let (sin_i, cos_i) = (55.0 * DEG).sin_cos();
        let node = Vector3::new((0.2_f64).cos(), (0.2_f64).sin(), 0.0);
        let other = Vector3::new(-cos_i * (0.2_f64).sin(), cos_i * (0.2_f64).cos(), sin_i);
        let rate = 300.0 / radius;
        let argument = |t: f64| 0.3 + rate * t;
        let r = |t: f64| (node * argument(t).cos() + other * argument(t).sin()) * radius;
        let v = |t: f64| (other * argument(t).cos() - node * argument(t).sin()) * (radius * rate);
        let c_ie = |t: f64| *nalgebra::Rotation3::from_axis_angle(&Vector3::z_axis(), OMEGA_IE * t).matrix();
        // The IMU turns evenly in space.
        let w_is_s = S::new(0.02, -0.01, 20.0 * DEG);
        let c_is = |t: f64| Rot::exp(S::new(0.3, -0.2, 0.5)).matrix() * Rot::exp(w_is_s * t).matrix();
        let earth_axis = Vector3::new(0.0, 0.0, OMEGA_IE);
        let force_s = |t: f64| {
            let place = geodetic(r(t));
            let g_n = Earth::new(place.latitude, place.height).unwrap().g_n().vector();
            // Gravity has the centrifugal part in it: Coriolis and the acceleration in e are left.
            let f_e = -r(t) * (rate * rate) + earth_axis.cross(&v(t)) * 2.0 - c_ne(place).transpose() * g_n;
            c_is(t).transpose() * c_ie(t) * f_e
        };
        let state = |t: f64| {
            let place = geodetic(r(t));
            let c_ns = Rot::from_matrix(&(c_ne(place) * c_ie(t).transpose() * c_is(t)));
            (place, N::from_vector(c_ne(place) * v(t)), c_ns)
        };
        let (place, v_n, c_ns) = state(0.0);
        let start = Position {
            latitude: rounded(place.latitude),
            longitude: rounded(place.longitude),
            height: rounded(place.height),
        };
        let (v_start, c_start) = (v_n.cast::<I>().cast(), c_ns.cast::<I>().cast());
        let mut navigator = Mechanization::new(start, v_start, c_start, Vertical::Free).unwrap();
        let steps = (f64::from(seconds) / dt).round();
        let mut k = 0.0;
        while k < steps {
            let t = k * dt;
            let to_start = |u: f64| Rot::exp(w_is_s * (u - t)).matrix() * force_s(u);
            let dv_s = S::from_vector(gauss(t, dt, to_start));
            let increment = Increment {
                phi_s: (w_is_s * dt + S::new(1.0, 1.0, 1.0) * (dither * (1.7 * k).sin()))
                    .cast::<I>()
                    .cast(),
                dv_s: dv_s.cast::<I>().cast(),
                dt: rounded(dt),
            };
            navigator.step(&increment).unwrap();
            k += 1.0;
        }
        let (place, v_n, c_ns) = state(steps * dt);
        (navigator, place, v_n, c_ns)
    }

    /// Horizontal and vertical distance, m.
    fn distance(a: Position<f64>, b: Position<f64>) -> (f64, f64) {
        let north = (a.latitude - b.latitude) * A;
        let east = math::wrap_pi(a.longitude - b.longitude) * A * a.latitude.cos();
        (north.hypot(east), (a.height - b.height).abs())
    }

    #[test]
    fn great_circle_track() {
        let errors = |dt: f64| {
            let (navigator, place, v_n, c_ns) = great_circle::<f64, f64>(3600, dt, 0.0);
            let (level, height) = distance(navigator.position(), place);
            (
                (navigator.velocity() - v_n).norm(),
                level,
                height,
                navigator.c_ns().angle_to(c_ns),
            )
        };
        let fine = errors(0.1);
        assert!(
            fine.0 < 1e-3 && fine.1 < 1.0 && fine.2 < 1.0 && fine.3 < 1e-7,
            "{fine:?}"
        );
        // Of second order: four times the step, sixteen times the error.
        let coarse = errors(0.4);
        assert!(
            coarse.1 / fine.1 > 10.0 && coarse.1 / fine.1 < 22.0,
            "{coarse:?} {fine:?}"
        );
    }

    #[test]
    fn single_precision_keeps_the_track() {
        let (single, _, _, _) = great_circle::<f32, f32>(600, 0.05, 3e-4);
        let (double, _, _, _) = great_circle::<f32, f64>(600, 0.05, 3e-4);
        let (a, b) = (single.displacement(), double.displacement());
        let north = (f64::from(a.latitude) - b.latitude) * A;
        let east = (f64::from(a.longitude) - b.longitude) * A;
        // Of a way of 180 km.
        assert!(north.hypot(east) < 1.0, "{north} {east}");
        assert!(
            (f64::from(a.height) - b.height).abs() < 1.0,
            "{} {}",
            a.height,
            b.height
        );
    }

    /// Ten minutes of 1 mm/s from 0.7 rad: a plain f32 sum of latitude would not move at all.
    #[test]
    fn small_steps_of_latitude_are_not_lost() {
        let place = Position {
            latitude: 0.7_f32,
            longitude: 3.0,
            height: 0.0,
        };
        let c_ns = Rot::from_yaw_pitch_roll(0.0, 0.0, 0.0).relabel::<Nav, Sensor>();
        let mut navigator = Mechanization::new(place, Vec3::new(1e-3, 1e-3, 0.0), c_ns, Vertical::Held).unwrap();
        let earth = Earth::new(0.7_f32, 0.0).unwrap();
        for _ in 0..6_000 {
            let increment = Increment {
                // The IMU stays in n.
                phi_s: Vec3::from_vector((earth.w_ie_n() * 0.01).vector()),
                dv_s: Vec3::new(0.0, 0.0, earth.gravity() * 0.01),
                dt: 0.01,
            };
            navigator.step(&increment).unwrap();
        }
        let north = f64::from(navigator.displacement().latitude) * Radii::new(0.7_f64.sin()).meridian;
        assert!((north - 0.06).abs() < 1e-3, "{north}");
    }

    /// An IMU that moves about a place: attitude `c_ns(t)` by its rotation vector rate `w_ns_s`, velocity and
    /// acceleration in n. Samples as an IMU gives them, increments by the corrector.
    struct Shaker<'a> {
        c_ns: &'a dyn Fn(f64) -> Rot<Nav, Sensor, f64>,
        w_ns_s: &'a dyn Fn(f64) -> Vector3<f64>,
        v_n: &'a dyn Fn(f64) -> N,
        a_n: &'a dyn Fn(f64) -> N,
    }

    impl Shaker<'_> {
        /// The navigator after `seconds`, by compensated or by bare samples.
        fn run(&self, seconds: f64, dt: f64, compensated: bool) -> Mechanization<f64> {
            let place = at(40.0);
            let local = Local::new(place.latitude, 0.0).unwrap();
            let sample = |t: f64| Sample {
                dtheta_s: S::from_vector(gauss(t, dt, |t| {
                    let w_in_n = local.earth.w_ie_n() + local.w_en_n((self.v_n)(t));
                    (self.w_ns_s)(t) + ((self.c_ns)(t).inverse() * w_in_n).vector()
                })),
                dv_s: S::from_vector(gauss(t, dt, |t| {
                    ((self.c_ns)(t).inverse() * ((self.a_n)(t) - local.free_fall((self.v_n)(t)))).vector()
                })),
                dt,
                gap: 0.0,
            };
            let mut navigator = Mechanization::new(place, (self.v_n)(0.0), (self.c_ns)(0.0), Vertical::Free).unwrap();
            let mut corrector = ConingScullingCorrector::new();
            corrector.increment(&sample(-dt));
            let mut k = 0.0;
            while k * dt < seconds - 0.5 * dt {
                let sample = sample(k * dt);
                let whole = corrector.increment(&sample);
                let bare = Increment {
                    phi_s: sample.dtheta_s,
                    dv_s: sample.dv_s,
                    dt,
                };
                navigator.step(if compensated { &whole } else { &bare }).unwrap();
                k += 1.0;
            }
            navigator
        }
    }

    /// Coning of half angle 1° at 5 Hz: z drifts by `Ω (1 − cos a)` on bare angle increments, less what the interval
    /// itself follows, `sin(Ωh)/(Ωh)` of it.
    #[test]
    fn coning() {
        let (a, omega) = (DEG, TAU * 5.0);
        let (sin_a, cos_a) = a.sin_cos();
        let c_ns = |t: f64| Rot::exp(N::new(a * (omega * t).cos(), a * (omega * t).sin(), 0.0)).relabel();
        let w = |t: f64| Vector3::new(-sin_a * (omega * t).sin(), sin_a * (omega * t).cos(), cos_a - 1.0) * omega;
        let rest = |_: f64| N::zero();
        // The closed form is the attitude's own derivative.
        let (t, h) = (0.123, 1e-5);
        let by_difference = (c_ns(t - h).inverse() * c_ns(t + h)).log().vector() / (2.0 * h);
        assert!((by_difference - w(t)).norm() < 1e-7);

        let shaker = Shaker {
            c_ns: &c_ns,
            w_ns_s: &w,
            v_n: &rest,
            a_n: &rest,
        };
        let drift = |compensated| {
            let (seconds, dt) = (20.0, 0.01);
            let navigator = shaker.run(seconds, dt, compensated);
            (navigator.c_ns() * c_ns(seconds).inverse()).log().z() / seconds
        };
        let (x, bare) = (omega * 0.01, drift(false));
        let expected = omega * 0.5 * sin_a * sin_a * (1.0 - x.sin() / x);
        assert!((bare.abs() / expected - 1.0).abs() < 0.02, "{bare:e} {expected:e}");
        assert!(drift(true).abs() < 0.02 * expected, "{:e} {expected:e}", drift(true));
    }

    /// Sculling of 1° about x with 0.5 g along y at 5 Hz, in phase: on bare increments z has a mean acceleration of
    /// `½ A a (1 − sinc Ωh)` and of gravity's own turn.
    #[test]
    fn sculling() {
        let (angle, force, omega) = (DEG, 5.0, TAU * 5.0);
        let c_ns = |t: f64| Rot::exp(N::new(angle * (omega * t).sin(), 0.0, 0.0)).relabel();
        let w = |t: f64| Vector3::new(angle * omega * (omega * t).cos(), 0.0, 0.0);
        let a_n = |t: f64| N::new(0.0, force * (omega * t).sin(), 0.0);
        let v_n = |t: f64| N::new(0.0, -force / omega * (omega * t).cos(), 0.0);
        let shaker = Shaker {
            c_ns: &c_ns,
            w_ns_s: &w,
            v_n: &v_n,
            a_n: &a_n,
        };
        let error = |compensated| {
            let (seconds, dt) = (10.0, 0.01);
            let navigator = shaker.run(seconds, dt, compensated);
            (navigator.velocity() - v_n(seconds)).z() / seconds
        };
        let bare = error(false);
        assert!(bare.abs() > 1e-4, "{bare:e}");
        assert!(error(true).abs() < 0.02 * bare.abs(), "{:e} {bare:e}", error(true));
    }

    /// (1)–(2) of the paper, integrated in b, on a tumbling housing with the rotor turning about x, y or z: the same
    /// attitude, velocity and place.
    #[test]
    fn integrating_the_housing_is_the_same() {
        let place = at(40.0);
        for axis in 0..3 {
            let (dt, rate) = (0.01, 50.0 * DEG);
            let c_nb0 = Rot::from_yaw_pitch_roll(0.4, 0.1, -0.1);
            let w_nb_b = Vector3::new(0.05, -0.03, 0.1);
            let c_nb = |t: f64| c_nb0 * Rot::exp(Vec3::from_vector(w_nb_b * t));
            let c_bs = |t: f64| about(axis, rate * t).relabel::<Body, Sensor>();
            let earth = Earth::new(place.latitude, 0.0).unwrap();
            let c_is = |t: f64| earth.c_ni(t).inverse() * (c_nb(t) * c_bs(t));
            let c_ib = |t: f64| earth.c_ni(t).inverse() * c_nb(t);
            let mut rotary = Mechanization::new(place, Vec3::zero(), c_nb0 * c_bs(0.0), Vertical::Free).unwrap();
            let mut housing = Mechanization::new(place, Vec3::zero(), c_nb0.relabel(), Vertical::Free).unwrap();
            for k in 0..6000 {
                let t = f64::from(k) * dt;
                let to_s = c_is(t).inverse();
                let force_i = |u: f64| earth.c_ni(u).inverse() * -earth.g_n();
                let dv_i = gauss(t, dt, |u| force_i(u).vector());
                rotary
                    .step(&Increment {
                        phi_s: (to_s * c_is(t + dt)).log(),
                        dv_s: to_s * Vec3::from_vector(dv_i),
                        dt,
                    })
                    .unwrap();
                // The housing's own motion is what is left of the IMU's once the rotor's is taken off.
                let phi_b = (c_bs(t) * (to_s * c_is(t + dt)) * c_bs(t + dt).inverse()).log();
                assert!((phi_b - (c_ib(t).inverse() * c_ib(t + dt)).log()).norm() < 1e-12);
                housing
                    .step(&Increment {
                        phi_s: Vec3::from_vector(phi_b.vector()),
                        dv_s: Vec3::from_vector((c_bs(t) * (to_s * Vec3::from_vector(dv_i))).vector()),
                        dt,
                    })
                    .unwrap();
            }
            let end = c_bs(60.0);
            let apart = rotary.c_nb(end).angle_to(housing.c_ns().relabel());
            assert!(apart < 1e-10, "{axis}: {apart:e}");
            assert!(rotary.c_nb(end).angle_to(c_nb(60.0)) < 1e-9);
            assert!((rotary.velocity() - housing.velocity()).norm() < 1e-8 && rotary.velocity().norm() < 1e-6);
            let attitude = rotary.attitude(end);
            assert!((attitude.to_rot().angle_to(c_nb(60.0))) < 1e-9);
        }
    }

    #[test]
    fn what_cannot_be_is_refused() {
        let new = |place, v_n| {
            Mechanization::<f64>::new(
                place,
                v_n,
                Rot::from_yaw_pitch_roll(0.0, 0.0, 0.0).relabel(),
                Vertical::Free,
            )
        };
        let still = Vec3::zero();
        assert_eq!(
            new(at(86.0), still),
            Err(MechanizationError::Place(EarthError::Latitude))
        );
        assert_eq!(
            new(
                Position {
                    longitude: f64::NAN,
                    ..EQUATOR
                },
                still
            ),
            Err(MechanizationError::Longitude)
        );
        assert_eq!(
            new(EQUATOR, Vec3::new(f64::NAN, 0.0, 0.0)),
            Err(MechanizationError::Velocity)
        );
        assert_eq!(
            new(EQUATOR, Vec3::new(2000.0, 0.0, 0.0)),
            Err(MechanizationError::Velocity)
        );

        // Northwards into the pole: the refusal, not a division by its cosine; and the state stays.
        let mut navigator = new(at(84.999), Vec3::new(0.0, 500.0, 0.0)).unwrap();
        let fly = Increment {
            phi_s: S::zero(),
            dv_s: S::new(0.0, 0.0, 9.83 * 0.1),
            dt: 0.1,
        };
        let refused = (0..100).find_map(|_| navigator.step(&fly).err());
        assert_eq!(refused, Some(MechanizationError::Place(EarthError::Latitude)));
        assert!(navigator.position().latitude <= 85.000_1 * DEG);

        let mut navigator = new(EQUATOR, still).unwrap();
        let before = navigator;
        for (bad, error) in [
            (Increment { dt: 0.0, ..fly }, MechanizationError::Interval),
            (Increment { dt: f64::NAN, ..fly }, MechanizationError::Interval),
            (
                Increment {
                    phi_s: S::new(f64::NAN, 0.0, 0.0),
                    ..fly
                },
                MechanizationError::Increment,
            ),
            (
                Increment {
                    dv_s: S::new(0.0, 1e6, 0.0),
                    ..fly
                },
                MechanizationError::Increment,
            ),
        ] {
            assert_eq!(navigator.step(&bad), Err(error));
            assert_eq!(navigator, before);
        }
    }
}
