//! The strapdown: attitude, velocity and displacement from increments, corrected by what is known of the sensors.
//!
//! ```text
//! δ      = (b_g + x_g + C_b^s h) T + M φ_s + G Δv⁰   what the gyros add to a turn
//! C_s^n ← exp(−ω_ie^n T) C_s^n exp(φ_s − δ)
//! V^n   ← V^n + C_s^n (Δv⁰ − ½ δ × Δv⁰ − b_a T − A Δv⁰) + g^n T
//! p^n   ← p^n + V^n T + ½ ΔV T
//! ```
//!
//! The base stays about where it is: no transport rate, no Coriolis acceleration (2 ω_ie V, below 1e-4 m/s² for
//! the sway of a ship and zero in the mean).

use frames::{Body, Nav, Real, Rot, RotIntegral, Sensor, Vec3};
use nalgebra::{Matrix3, Vector3};

use crate::{
    earth::Earth,
    increment::Increment,
    model::{ACCEL_COLUMNS, BA, BG, DP, DV, GM, GYRO_TERMS, GyroDrive, HB, PHI},
};

/// What is known of the sensors' errors.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Corrections<T: Real> {
    /// Constant part of the gyro biases, rad/s.
    pub gyro_bias_s: Vec3<Sensor, T>,
    /// Gauss–Markov part of the gyro biases, rad/s.
    pub gyro_instability_s: Vec3<Sensor, T>,
    /// M: scale factors on the diagonal, misalignments beside it. A rate ω is measured as (I + M) ω.
    pub gyro_matrix: Matrix3<T>,
    /// G: the gyros' response to specific force, rad/s per m/s².
    pub g_sensitivity: Matrix3<T>,
    /// h: the gyro error that is constant in the housing, rad/s.
    pub housing_b: Vec3<Body, T>,
    /// Accelerometer biases, m/s².
    pub accel_bias_s: Vec3<Sensor, T>,
    /// A: scale factors on the diagonal, misalignments beside it. A specific force f is measured as (I + A) f.
    pub accel_matrix: Matrix3<T>,
}

impl<T: Real> Corrections<T> {
    /// Nothing is known.
    pub fn none() -> Self {
        Self {
            gyro_bias_s: Vec3::zero(),
            gyro_instability_s: Vec3::zero(),
            gyro_matrix: Matrix3::zeros(),
            g_sensitivity: Matrix3::zeros(),
            housing_b: Vec3::zero(),
            accel_bias_s: Vec3::zero(),
            accel_matrix: Matrix3::zeros(),
        }
    }

    /// What the gyros have added to the turn of an increment, rad, with the rotor at the angle `alpha` at its end, rad.
    pub fn gyro_error(&self, increment: &Increment<T>, alpha: T) -> Vec3<Sensor, T> {
        let Increment { phi_s, dv_s, dt } = *increment;
        let half = T::lit(0.5);
        let c_sb = Rot::<Body, Sensor, T>::about_z(alpha - half * phi_s.z()).inverse();
        let bias = (self.gyro_bias_s + self.gyro_instability_s + c_sb * self.housing_b) * dt;
        // In the middle of the interval.
        let force_s = dv_s - (phi_s * half).cross(dv_s);
        // M is below 1e-2: that it acts on the measured turn and not on the true one is M² of it.
        bias + Vec3::from_vector(self.gyro_matrix * phi_s.vector() + self.g_sensitivity * force_s.vector())
    }

    /// The increment as sensors without these errors would have measured it.
    pub fn corrected(&self, increment: &Increment<T>, alpha: T) -> Increment<T> {
        let half = T::lit(0.5);
        let dt = increment.dt;
        let gyro_error = self.gyro_error(increment, alpha);
        let phi_s = increment.phi_s - gyro_error;
        let half_turn = phi_s * half;
        // Bias and A are constant in s while the increment is resolved in s at the start: half a turn back and forth.
        let force_s = increment.dv_s - half_turn.cross(increment.dv_s);
        let error_s = self.accel_bias_s * dt + Vec3::from_vector(self.accel_matrix * force_s.vector());
        let error_s = error_s + half_turn.cross(error_s);
        // The gyro error has turned the samples within the interval as well, by half of it in the mean.
        let dv_s = increment.dv_s - gyro_error.cross(increment.dv_s) * half - error_s;
        Increment { phi_s, dv_s, dt }
    }
}

fn add_to_column<T: Real>(matrix: &mut Matrix3<T>, axis: usize, part: Option<&Vector3<T>>) {
    for (row, part) in part.into_iter().flatten().enumerate() {
        if let Some(element) = matrix.get_mut((row, axis)) {
            *element += *part;
        }
    }
}

/// Attitude, velocity and displacement.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Strapdown<T: Real> {
    /// `C_s^n`.
    pub c_ns: RotIntegral<Nav, Sensor, T>,
    /// Velocity, m/s.
    pub v_n: Vec3<Nav, T>,
    /// Displacement since the start, m.
    pub p_n: Vec3<Nav, T>,
    /// What its increments are corrected by.
    pub corrections: Corrections<T>,
}

impl<T: Real> Strapdown<T> {
    /// At rest with this attitude, sensors taken as they are.
    pub fn new(c_ns: Rot<Nav, Sensor, T>) -> Self {
        Self {
            c_ns: RotIntegral::new(c_ns),
            v_n: Vec3::zero(),
            p_n: Vec3::zero(),
            corrections: Corrections::none(),
        }
    }

    /// Integrates one increment; returns `C_s^n` in the middle of it.
    ///
    /// `alpha` is the rotor's angle at its end, rad.
    pub fn advance(&mut self, increment: &Increment<T>, alpha: T, earth: &Earth<T>) -> Matrix3<T> {
        let half = T::lit(0.5);
        let Increment { phi_s, dv_s, dt } = self.corrections.corrected(increment, alpha);
        let earth_turn = earth.w_ie_n() * dt;
        let start = self.c_ns.get();
        let dv_n = start * dv_s;
        // n turns by half the interval's turn, in the mean, below the velocity change.
        let dv_n = dv_n - earth_turn.cross(dv_n) * half + earth.g_n() * dt;
        self.p_n += (self.v_n + dv_n * half) * dt;
        self.v_n += dv_n;
        self.c_ns.turn_from(phi_s);
        self.c_ns.turn_to(-earth_turn);
        (start * Rot::exp(phi_s * half)).matrix()
    }

    /// Takes an estimated error out: blocks of [`model`](crate::model), as many as there are.
    pub(crate) fn correct(&mut self, error: &[Vector3<T>]) {
        for (block, part) in error.iter().enumerate() {
            let (in_n, in_s) = (Vec3::from_vector(*part), Vec3::from_vector(*part));
            match block {
                PHI => self.c_ns.turn_to(in_n),
                DV => self.v_n -= in_n,
                DP => self.p_n -= in_n,
                BG => self.corrections.gyro_bias_s += in_s,
                BA => self.corrections.accel_bias_s += in_s,
                GM => self.corrections.gyro_instability_s += in_s,
                HB => self.corrections.housing_b += Vec3::from_vector(*part),
                _ => {}
            }
        }
        for (block, drive) in GYRO_TERMS {
            let (matrix, axis) = match drive {
                GyroDrive::Rate(axis) => (&mut self.corrections.gyro_matrix, axis),
                GyroDrive::Force(axis) => (&mut self.corrections.g_sensitivity, axis),
                GyroDrive::Bias | GyroDrive::Earth | GyroDrive::Housing => continue,
            };
            add_to_column(matrix, axis, error.get(block));
        }
        for (block, axis) in ACCEL_COLUMNS {
            add_to_column(&mut self.corrections.accel_matrix, axis, error.get(block));
        }
    }

    /// Resolves everything in a frame turned against the one it was in.
    pub(crate) fn turn(&mut self, turn: Rot<Nav, Nav, T>) {
        self.c_ns = RotIntegral::new(turn * self.c_ns.get());
        self.v_n = turn * self.v_n;
        self.p_n = turn * self.p_n;
    }

    /// Whether everything is a number.
    pub fn is_finite(&self) -> bool {
        self.v_n.is_finite() && self.p_n.is_finite() && self.c_ns.get().quaternion().iter().all(|q| q.finite())
    }
}
