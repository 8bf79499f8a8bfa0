//! The model of the strapdown's errors: which states there are, how they move over an interval, what noise they take.
//!
//! The states come in blocks of three, in an order in which every shorter list is a filter of its own:
//!
//! | blocks | states | what it knows |
//! |---|---|---|
//! | [`PAPER`] = 4 | φ, δV, ε, ∇ | \[Xing18\] (19), (20): zero velocity is measured |
//! | 5 | + δp | zero displacement is measured instead: the base may sway |
//! | 6 | + x | the part of the gyro biases that wanders, as a Gauss–Markov process |
//! | 7 | + m_z | what the rotor's own turning makes of the z column of M: \[Du16\] (14)–(25) |
//! | 9 | + m_x, m_y | all of M: scale factors and misalignments of the gyros |
//! | 10 | + δω | Earth's rate in the strapdown's own level frame: no heading is needed to start from |
//! | 12 | + a_x, a_y | A: scale factors and misalignments of the accelerometers, the columns of the level axes |
//! | 14 | + g_x, g_y | G: response of the gyros to specific force, the columns of the level axes |
//! | [`ROBUST`] = 15 | + h | a gyro error that is constant in the housing: once a turn in s |
//!
//! With `C' = (I − [φ×]) C`, `V' = V + δV`, `p' = p + δp`, and ε, x, M, G, h, ∇, A what the corrections still lack
//! (\[Xing18\] (19), (20); the printed `−g^n×` is `[f^n×]`, g^n pointing down):
//!
//! ```text
//! φ̇  = −ω_ie^n × φ − δω − C_s^n (ε + x + M ω_is^s + G f^s) − C_b^n h    δV̇ = f^n × φ + C_s^n (∇ + A f^s)
//! δṗ = δV    ẋ = −x/τ + noise
//! ```
//!
//! The third columns of A and G have no states of their own. They act by f_z, which is g within 1 % on a base that swings,
//! so they are part of ∇ and ε, whose priors are widened by them (see [`FineFilter`](crate::fine::FineFilter::new)).
//! The same holds for the part of h along the rotor's axis, and for a scale factor of z that differs with the sign of the rate.
//! h cannot be told from Earth's rate while the housing keeps its heading, nor can the isotropic part of G under a constant
//! tilt: both stay in the σ of heading.
//!
//! δω makes the search for north linear. A heading error of any size turns Earth's level rate, and nothing else that
//! matters here, in the frame that the strapdown works in; so the two level components of δω are estimated in place
//! of φ_U, heading is where they point, and their length, ω_ie cos L, is used once the direction is known (see
//! [`FineFilter::close_loop`](crate::fine::FineFilter::close_loop)). After that δω is what a wrong latitude leaves.
//!
//! Over an interval T every error that drives attitude with `D` (C for a bias, C ω_k for column k of M, 1 for δω) acts by
//!
//! ```text
//! φ:  −∫D        δV:  −∫[f^n×]∫D        δp:  −∬[f^n×]∫D
//! ```
//!
//! f^n is `[0 0 g]`, as in the paper, and not what the accelerometers say: a base that is measured to stay
//! where it is does not accelerate in the mean. A level part of the measured force is a tilt not yet found, and to
//! take it for real would let the filter believe that it sees heading (σ of 1.1° with errors of 8° after 60 s).

use frames::{Body, Real, Rot, Sensor, Vec3};
use heapless::Vec;
use nalgebra::{Matrix3, Vector3};

use crate::{
    covariance::{Covariance, TransitionBlock},
    earth::Earth,
    increment::Increment,
    noise::ImuNoise,
};

/// Block of the attitude errors φ_E, φ_N, φ_U, rad.
pub const PHI: usize = 0;
/// Block of the velocity errors δV_E, δV_N, δV_U, m/s.
pub const DV: usize = 1;
/// Block of the gyro bias errors ε_x, ε_y, ε_z in s, rad/s.
pub const BG: usize = 2;
/// Block of the accelerometer bias errors ∇_x, ∇_y, ∇_z in s, m/s².
pub const BA: usize = 3;
/// Block of the displacement errors δp_E, δp_N, δp_U, m.
pub const DP: usize = 4;
/// Block of the Gauss–Markov parts of the gyro biases x_x, x_y, x_z in s, rad/s.
pub const GM: usize = 5;
/// Block of the third column of M: what a rate about z adds to each gyro.
pub const MZ: usize = 6;
/// Block of the first column of M.
pub const MX: usize = 7;
/// Block of the second column of M.
pub const MY: usize = 8;

/// Block of the error of Earth's rate in the strapdown's frame, δω_E, δω_N, δω_U, rad/s.
pub const WE: usize = 9;

/// Block of the first column of A of the accelerometers: what a specific force along x adds to each.
pub const AX: usize = 10;
/// Block of the second column of A.
pub const AY: usize = 11;
/// Block of the first column of G: what a specific force along x adds to each gyro, rad/s per m/s².
pub const GX: usize = 12;
/// Block of the second column of G.
pub const GY: usize = 13;
/// Block of the gyro error h_x, h_y, h_z that is constant in the housing, in b, rad/s.
pub const HB: usize = 14;

/// Number of blocks of the paper's filter: twelve states.
pub const PAPER: usize = 4;
/// Number of blocks of the filter that needs no tuning between laboratory and deck: 45 states.
pub const ROBUST: usize = 15;

/// What a gyro error is proportional to, and the frame that it is constant in.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum GyroDrive {
    /// Constant in s: D = C_s^n.
    Bias,
    /// Constant in n: D = 1.
    Earth,
    /// Constant in b: D = C_b^n.
    Housing,
    /// One component of the rate of s: D = C_s^n ω_k.
    Rate(usize),
    /// One component of the specific force: D = C_s^n f_k.
    Force(usize),
}

/// The gyro errors of the model by block. ε and x share the first.
pub(crate) const GYRO_TERMS: [(usize, GyroDrive); 8] = [
    (BG, GyroDrive::Bias),
    (MZ, GyroDrive::Rate(2)),
    (MX, GyroDrive::Rate(0)),
    (MY, GyroDrive::Rate(1)),
    (WE, GyroDrive::Earth),
    (GX, GyroDrive::Force(0)),
    (GY, GyroDrive::Force(1)),
    (HB, GyroDrive::Housing),
];

/// The columns of A by block, and the component of the force that each acts by.
pub(crate) const ACCEL_COLUMNS: [(usize, usize); 2] = [(AX, 0), (AY, 1)];

/// Component 0, 1 or 2 of a vector.
fn component<T: Real>(v: Vec3<Sensor, T>, axis: usize) -> T {
    match axis {
        0 => v.x(),
        1 => v.y(),
        _ => v.z(),
    }
}

/// Most blocks of Φ − I that are not zero: nine gyro errors and three of the accelerometers on φ, δV and δp, and their
/// own.
const MOST_BLOCKS: usize = 38;

/// Appends to a list that has room for the full one.
fn add_block<T: Real>(all: &mut Vec<TransitionBlock<T>, MOST_BLOCKS>, row: usize, col: usize, block: Matrix3<T>) {
    let pushed = all.push(TransitionBlock { row, col, block });
    debug_assert!(pushed.is_ok(), "MOST_BLOCKS");
}

/// What a constant error does to the strapdown by the end of the interval.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Response<T: Real> {
    /// To attitude (velocity, for an accelerometer).
    first: Matrix3<T>,
    /// To velocity (displacement).
    second: Matrix3<T>,
    /// To displacement.
    third: Matrix3<T>,
}

impl<T: Real> Response<T> {
    fn new() -> Self {
        Self {
            first: Matrix3::zeros(),
            second: Matrix3::zeros(),
            third: Matrix3::zeros(),
        }
    }
}

/// The parts of Φ and Q that build up between two measurements.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Interval<T: Real, const B: usize> {
    dt: T,
    /// Of each of [`GYRO_TERMS`].
    gyro: [Response<T>; GYRO_TERMS.len()],
    /// Of an accelerometer bias; `third` is not used.
    accel: Response<T>,
    /// Of each of [`ACCEL_COLUMNS`], likewise.
    accel_columns: [Response<T>; ACCEL_COLUMNS.len()],
    /// Variance added to each attitude error by what the samples do not tell (gaps), rad².
    phi_var: T,
    /// Variance added to each velocity error likewise, (m/s)².
    dv_var: T,
}

impl<T: Real, const B: usize> Interval<T, B> {
    pub(crate) fn new() -> Self {
        let zero = T::zero();
        Self {
            dt: zero,
            gyro: [Response::new(); GYRO_TERMS.len()],
            accel: Response::new(),
            accel_columns: [Response::new(); ACCEL_COLUMNS.len()],
            phi_var: zero,
            dv_var: zero,
        }
    }

    /// Time since the last measurement, s.
    pub(crate) fn dt(&self) -> T {
        self.dt
    }

    /// Says that the samples have missed a turn (rad) and a velocity change (m/s) of these 1σ on each axis.
    pub(crate) fn inflate_covariance(&mut self, phi_sd: T, dv_sd: T) {
        self.phi_var += phi_sd * phi_sd;
        self.dv_var += dv_sd * dv_sd;
    }

    /// Adds an increment with the attitude `c_ns` in its middle, and the rotor at the angle `alpha` at its end, rad.
    pub(crate) fn push(&mut self, increment: &Increment<T>, alpha: T, c_ns: &Matrix3<T>, earth: &Earth<T>) {
        let half = T::lit(0.5);
        let g = earth.gravity();
        let dt = increment.dt;
        // [f^n ×] of f^n = [0 0 g]: rows (−g·north, g·east, 0).
        let lever = |m: &Matrix3<T>, dt: T| {
            let k = g * dt;
            Matrix3::from_fn(|row, col| match row {
                0 => -m[(1, col)] * k,
                1 => m[(0, col)] * k,
                _ => T::zero(),
            })
        };
        // The velocity change is resolved in s at the start; the drive is one in the middle.
        let force_s = if B > AX {
            increment.dv_s - (increment.phi_s * half).cross(increment.dv_s)
        } else {
            Vec3::zero()
        };
        for ((block, drive), response) in GYRO_TERMS.iter().zip(&mut self.gyro) {
            if B <= *block {
                continue;
            }
            let drive = match drive {
                GyroDrive::Bias => c_ns * dt,
                GyroDrive::Earth => Matrix3::identity() * dt,
                GyroDrive::Housing => {
                    let c_bs = Rot::<Body, Sensor, T>::about_z(alpha - half * increment.phi_s.z());
                    c_ns * c_bs.matrix().transpose() * dt
                }
                GyroDrive::Rate(axis) => c_ns * component(increment.phi_s, *axis),
                GyroDrive::Force(axis) => c_ns * component(force_s, *axis),
            };
            let second = response.second + lever(&(response.first + drive * half), dt);
            if B > DP {
                response.third += (response.second + second) * (half * dt);
            }
            response.second = second;
            response.first += drive;
        }
        let add = |response: &mut Response<T>, drive: Matrix3<T>| {
            if B > DP {
                response.second += (response.first + drive * half) * dt;
            }
            response.first += drive;
        };
        add(&mut self.accel, c_ns * dt);
        for ((block, axis), response) in ACCEL_COLUMNS.iter().zip(&mut self.accel_columns) {
            if B > *block {
                add(response, c_ns * component(force_s, *axis));
            }
        }
        self.dt += dt;
    }

    /// Φ − I.
    pub(crate) fn transition(&self, noise: &ImuNoise<T>, earth: &Earth<T>) -> Vec<TransitionBlock<T>, MOST_BLOCKS> {
        let mut all = Vec::new();
        let mut couple = |row, col, block| add_block(&mut all, row, col, block);
        let t = self.dt;
        let half = T::lit(0.5) * t;
        let identity = Matrix3::identity();
        let f_t = (-earth.g_n() * t).skew();
        // In the order in which `Covariance::propagate` can do without a copy: what reads before what is read.
        if B > DP {
            couple(DP, DV, identity * t);
            couple(DP, PHI, f_t * half);
            self.accel_errors(|col, response| couple(DP, col, response.second));
            self.gyro_errors(|col, response| couple(DP, col, -response.third));
        }
        couple(DV, PHI, f_t);
        self.accel_errors(|col, response| couple(DV, col, response.first));
        self.gyro_errors(|col, response| couple(DV, col, -response.second));
        couple(PHI, PHI, -(earth.w_ie_n() * t).skew());
        self.gyro_errors(|col, response| couple(PHI, col, -response.first));
        if B > GM {
            couple(GM, GM, identity * (noise.gyro_instability_decay(t) - T::one()));
        }
        all
    }

    /// Row h of the turn about the vertical that an error is taken for: z = h x = −(φ_U at the end − φ_U at the start).
    ///
    /// \[Yu15\] (16), over the interval: −up (Φ − I)_φ, with up (ω_ie^n × φ) T = T (up × ω_ie^n) φ of attitude itself.
    pub(crate) fn turn_row(&self, earth: &Earth<T>) -> [Vector3<T>; B] {
        let up = Vector3::z();
        let mut row = [Vector3::zeros(); B];
        row[PHI] = up.cross(&earth.w_ie_n().vector()) * self.dt;
        self.gyro_errors(|col, response| row[col] = response.first.tr_mul(&up));
        row
    }

    /// Every block that drives attitude as a gyro error does, and how.
    fn gyro_errors(&self, mut each: impl FnMut(usize, &Response<T>)) {
        for ((block, drive), response) in GYRO_TERMS.iter().zip(&self.gyro) {
            if B > *block {
                each(*block, response);
            }
            if B > GM && *drive == GyroDrive::Bias {
                each(GM, response);
            }
        }
    }

    /// Every block that drives velocity as an accelerometer error does, and how.
    fn accel_errors(&self, mut each: impl FnMut(usize, &Response<T>)) {
        each(BA, &self.accel);
        for ((block, _), response) in ACCEL_COLUMNS.iter().zip(&self.accel_columns) {
            if B > *block {
                each(*block, response);
            }
        }
    }

    /// Adds the noise of the interval: Q.
    ///
    /// White noise is the same in s and in n. The angle walk, density q, reaches velocity and displacement through
    /// f^n, taken as constant: `∫∫` of its chain gives T, T²/2, T³/6; T³/3, T⁴/8; T⁵/20. The velocity walk likewise
    /// with one integral less.
    pub(crate) fn add_noise(&self, p: &mut Covariance<T, B>, noise: &ImuNoise<T>, earth: &Earth<T>) {
        let t = self.dt;
        let over = |divisor: f64| T::lit(1.0 / divisor);
        let identity = Matrix3::identity();
        let walk = noise.angle_random_walk * noise.angle_random_walk * t;
        let velocity = noise.velocity_random_walk * noise.velocity_random_walk * t;
        let f_t = (-earth.g_n() * t).skew();
        // f^n × f^n ×, the level components alone.
        let f2 = -(f_t * f_t);
        p.add(PHI, PHI, &(identity * (walk + self.phi_var)));
        p.add(PHI, DV, &(f_t.transpose() * (walk * over(2.0))));
        p.add(DV, DV, &(identity * (velocity + self.dv_var) + f2 * (walk * over(3.0))));
        if B > DP {
            p.add(PHI, DP, &(f_t.transpose() * (walk * t * over(6.0))));
            let cross = identity * ((velocity * over(2.0) + self.dv_var) * t) + f2 * (walk * t * over(8.0));
            p.add(DV, DP, &cross);
            let displacement = identity * ((velocity * over(3.0) + self.dv_var) * t * t);
            p.add(DP, DP, &(displacement + f2 * (walk * t * t * over(20.0))));
        }
        if noise.accel_instability_sd > T::zero() {
            p.add(BA, BA, &(identity * (noise.accel_bias_walk_psd() * t)));
        }
        if B > GM {
            p.add(GM, GM, &(identity * noise.gyro_instability_driving_noise_var(t)));
        } else {
            p.add(BG, BG, &(identity * (noise.gyro_bias_walk_psd() * t)));
        }
    }

    /// What the walk adds to the attitude errors since the last measurement, and what was missed, rad².
    pub(crate) fn phi_noise(&self, noise: &ImuNoise<T>) -> Matrix3<T> {
        Matrix3::identity() * (noise.angle_random_walk * noise.angle_random_walk * self.dt + self.phi_var)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use frames::units::{DEG, DEG_PER_HOUR};

    fn predicted(intervals: u32, seconds: f64) -> Covariance<f64, ROBUST> {
        let earth = Earth::new(40.0 * DEG, 0.0).unwrap();
        let noise = ImuNoise {
            gyro_instability_sd: 3.0 * DEG_PER_HOUR,
            gyro_instability_tau: 100.0,
            ..ImuNoise::default()
        };
        let mut prior = [Vector3::repeat(1e-20); ROBUST];
        prior[GM] = Vector3::repeat(noise.gyro_instability_sd * noise.gyro_instability_sd);
        let mut p = Covariance::diagonal(prior);
        for _ in 0..intervals {
            let mut interval = Interval::<f64, ROBUST>::new();
            for _ in 0..100 {
                let still = Increment {
                    phi_s: Vec3::zero(),
                    dv_s: Vec3::zero(),
                    dt: seconds / 100.0,
                };
                interval.push(&still, 0.0, &Matrix3::identity(), &earth);
            }
            p.propagate(&interval.transition(&noise, &earth));
            interval.add_noise(&mut p, &noise, &earth);
        }
        p
    }

    /// One second at once, or in tenths: the chain of integrals of the white noises is the same.
    #[test]
    fn noise_over_an_interval_is_that_of_its_parts() {
        let (once, parts) = (predicted(1, 1.0), predicted(10, 0.1));
        for (i, j) in [(PHI, PHI), (PHI, DV), (PHI, DP), (DV, DV), (DV, DP), (DP, DP), (GM, GM)] {
            let (a, b) = (once.block(i, j), parts.block(i, j));
            assert!((a - b).amax() < 0.01 * b.amax(), "({i}, {j}): {a} {b}");
            assert!(b.amax() > 0.0);
        }
    }

    /// The wandering part of the biases neither dies out nor grows.
    #[test]
    fn instability_is_stationary() {
        let sd = 3.0 * DEG_PER_HOUR;
        for var in predicted(1000, 1.0).variances(GM).iter() {
            assert!((var / (sd * sd) - 1.0).abs() < 1e-9, "{var:e}");
        }
    }
}
