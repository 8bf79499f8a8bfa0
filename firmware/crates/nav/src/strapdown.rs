//! The strapdown: attitude, velocity and displacement from increments, corrected by what is known of the sensors.
//!
//! ```text
//! δ      = (b_g + x_g) T + M φ_s                what the gyros add to a turn
//! C_s^n ← exp(−ω_ie^n T) C_s^n exp(φ_s − δ)
//! V^n   ← V^n + C_s^n (Δv⁰ − ½ δ × Δv⁰ − b_a T) + g^n T
//! p^n   ← p^n + V^n T + ½ ΔV T
//! ```
//!
//! The base stays about where it is: no transport rate, no Coriolis acceleration (2 ω_ie V, below 1e-4 m/s² for
//! the sway of a ship and zero in the mean).

use frames::{Nav, Real, Rot, RotIntegral, Sensor, Vec3};
use nalgebra::{Matrix3, Vector3};

use crate::{
    earth::Earth,
    increment::Increment,
    model::{BA, BG, COLUMNS, DP, DV, GM, PHI},
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
    /// Accelerometer biases, m/s².
    pub accel_bias_s: Vec3<Sensor, T>,
}

impl<T: Real> Corrections<T> {
    /// Nothing is known.
    pub fn none() -> Self {
        Self {
            gyro_bias_s: Vec3::zero(),
            gyro_instability_s: Vec3::zero(),
            gyro_matrix: Matrix3::zeros(),
            accel_bias_s: Vec3::zero(),
        }
    }

    /// What the gyros have added to a turn measured as `phi_s`, rad, in `dt` seconds.
    pub fn gyro_error(&self, phi_s: Vec3<Sensor, T>, dt: T) -> Vec3<Sensor, T> {
        let bias = (self.gyro_bias_s + self.gyro_instability_s) * dt;
        // M is below 1e-2: that it acts on the measured turn and not on the true one is M² of it.
        bias + Vec3::from_vector(self.gyro_matrix * phi_s.vector())
    }

    /// The increment as sensors without these errors would have measured it.
    pub fn corrected(&self, increment: &Increment<T>) -> Increment<T> {
        let half = T::lit(0.5);
        let dt = increment.dt;
        let gyro_error = self.gyro_error(increment.phi_s, dt);
        let phi_s = increment.phi_s - gyro_error;
        // The bias is constant in s while the increment is resolved in s at the start: half a turn back.
        let bias_s = self.accel_bias_s + (phi_s * half).cross(self.accel_bias_s);
        // The gyro error has turned the samples within the interval as well, by half of it in the mean.
        let dv_s = increment.dv_s - gyro_error.cross(increment.dv_s) * half - bias_s * dt;
        Increment { phi_s, dv_s, dt }
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
    pub fn advance(&mut self, increment: &Increment<T>, earth: &Earth<T>) -> Matrix3<T> {
        let half = T::lit(0.5);
        let Increment { phi_s, dv_s, dt } = self.corrections.corrected(increment);
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
                _ => {}
            }
        }
        for (block, axis) in COLUMNS {
            if let Some(part) = error.get(block) {
                let mut column = self.corrections.gyro_matrix.column_mut(axis);
                column += part;
            }
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
