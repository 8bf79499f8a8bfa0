//! Frames as types, units, and the one door to scalar maths.
//!
//! A vector knows the frame it is resolved in, a rotation knows the two frames it joins, and a
//! product whose inner frames differ does not compile. Everything is generic over the scalar
//! (`f32` on the target, `f64` where rounding is to be measured) through [`math::Real`].
//!
//! # Conventions
//!
//! They hold in every crate of this project and are stated here only.
//!
//! | frame | type | axes |
//! |---|---|---|
//! | i | [`Inertial`] | Earth-centred inertial, z along Earth's axis, x in the meridian plane of the unit at the start of alignment |
//! | n | [`Nav`] | local level: x east, y north, z up |
//! | b | [`Body`] | the housing: x right, y front, z up |
//! | s | [`Sensor`] | the IMU, turned about the housing's z by the rotor angle α |
//! | ib0 | [`SensorStart`] | s frozen in inertial space at the start of alignment |
//!
//! * A rotation `c_nb` maps coordinates in b to coordinates in n: `v_n = c_nb * v_b`. Inner letters
//!   cancel: `c_ns = c_nb * c_bs`. The type reads in the same order: `Rot<Nav, Body>`.
//! * The rotor: `c_bs = Rz(α)`, α counter-clockwise seen from above (\[Xing18\] (1)).
//! * Attitude: `c_nb = Rz(yaw) Rx(pitch) Ry(roll)`, yaw counter-clockwise from north. To people,
//!   *heading* is clockwise from true north in \[0°, 360°): `heading = −yaw mod 360°`. See [`Attitude`].
//! * Vectors carry symbol, pair and frame: `w_ib_b` is the rate of b against i in b, `f_is_s` the
//!   specific force of s against i in s, `dtheta_s` and `dv_s` its integrals over one sample.
//! * SI units and radians inside, unsuffixed. Anything else says so: `rate_dps`, `bias_deg_h`, `t_us`.
//!   Spreads are `_sd` (1σ), `_var`, `_psd` (one-sided density of the noise's variance per second).
//!
//! # The algebra
//!
//! ```
//! use frames::{Body, Nav, Rot, Sensor, Vec3};
//!
//! let c_nb = Rot::<Nav, Body, f32>::from_yaw_pitch_roll(0.3_f32, 0.1, -0.2);
//! let c_bs = Rot::<Body, Sensor>::about_z(1.0);
//! let c_ns = c_nb * c_bs;
//! let f_s = Vec3::<Sensor, f32>::new(0.0, 0.0, 9.8);
//! let f_n: Vec3<Nav> = c_ns * f_s;
//! assert!((f_n.norm() - 9.8).abs() < 1e-5);
//! ```
//!
//! The wrong order does not compile:
//!
//! ```compile_fail
//! use frames::{Body, Nav, Rot, Sensor};
//! let c_nb = Rot::<Nav, Body, f32>::identity();
//! let c_bs = Rot::<Body, Sensor, f32>::identity();
//! let c_ns = c_bs * c_nb;
//! ```
//!
//! nor does a rotation of a vector that is in another frame:
//!
//! ```compile_fail
//! use frames::{Body, Nav, Rot, Sensor, Vec3};
//! let c_nb = Rot::<Nav, Body, f32>::identity();
//! let f_n = c_nb * Vec3::<Sensor, f32>::new(0.0, 0.0, 9.8);
//! ```
//!
//! nor the sum of vectors in two frames:
//!
//! ```compile_fail
//! use frames::{Body, Sensor, Vec3};
//! let w = Vec3::<Sensor, f32>::new(0.0, 0.0, 0.3) + Vec3::<Body, f32>::new(0.0, 0.0, 0.3);
//! ```
//!
//! nor a cross product across frames:
//!
//! ```compile_fail
//! use frames::{Body, Sensor, Vec3};
//! let w = Vec3::<Sensor, f32>::new(0.0, 0.0, 0.3).cross(Vec3::<Body, f32>::new(0.0, 0.0, 0.3));
//! ```
//!
//! nor an inverse taken the wrong way round:
//!
//! ```compile_fail
//! use frames::{Body, Nav, Rot};
//! let c_bn: Rot<Body, Nav> = Rot::<Nav, Body, f32>::identity();
//! ```
//!
//! nor a rotation vector of a rotation between two different frames, whose axis would have no frame:
//!
//! ```compile_fail
//! use frames::{Body, Nav, Rot};
//! let phi = Rot::<Nav, Body, f32>::identity().log();
//! ```
//!
//! # Sources
//!
//! \[Xing18\] Xing et al., *Self-Alignment MEMS IMU Method Based on the Rotation Modulation Technique
//! on a Swing Base*, Sensors 2018, 18, 1178.
#![no_std]

mod attitude;
mod integral;
pub mod math;
mod rot;
pub mod units;
mod vec3;
mod wording;

pub use attitude::{Attitude, AttitudeSd};
pub use integral::{RotIntegral, VecSum};
pub use math::Real;
pub use rot::Rot;
pub use vec3::Vec3;

mod private {
    pub trait Sealed {}
}

/// A coordinate frame: an uninhabited type that only labels vectors and rotations.
pub trait Frame: Copy + core::fmt::Debug + private::Sealed + 'static {}

macro_rules! frame {
    ($(#[$doc:meta])* $name:ident) => {
        $(#[$doc])*
        #[derive(Debug, Clone, Copy, PartialEq, Eq)]
        pub enum $name {}
        impl private::Sealed for $name {}
        impl Frame for $name {}
    };
}

frame! {
    /// i: inertial, z along Earth's axis, x in the unit's meridian plane when alignment starts.
    Inertial
}
frame! {
    /// n: navigation, east-north-up.
    Nav
}
frame! {
    /// b: the housing, right-front-up.
    Body
}
frame! {
    /// s: the IMU, turned about the housing's z by the rotor angle.
    Sensor
}
frame! {
    /// ib0: the sensor frame frozen in inertial space when alignment starts (\[Xing18\] §2).
    SensorStart
}
