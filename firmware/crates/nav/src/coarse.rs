//! Coarse alignment in the inertial frame with rotation modulation (RMT-IFBA).
//!
//! Gravity seen from inertial space moves on a cone about Earth's axis, and its direction at two
//! times tells all of the attitude (\[Xing18\] §4.1):
//!
//! ```text
//! C_s^n(t) = C_i^n(t) C_ib0^i C_s^ib0(t)                                   (7), (18)
//! Ċ_s^ib0 = C_s^ib0 [ω_is^s ×],  C_s^ib0(0) = I                            (11)
//! V^ib0(t) = Σ C_s^ib0 Δv⁰,      V^i(t) = −∫ g^i dt                        (13), (15)
//! C_ib0^i from V^i(t_k) = C_ib0^i V^ib0(t_k) at t_k1 and t_k2              (16), (17)
//! ```
//!
//! (17) is solved with orthonormal triads instead of the printed inverse: the same matrix where the
//! vectors fit, and a rotation in every case.
//!
//! The predicted σ carries the turn-on biases through the actual motion (integrals of `C_s^ib0`, which
//! the rotor makes small) and the random walks in closed form for level axes. Not modelled: the
//! velocity of a base that moves, which on water is the largest error.

use frames::{Inertial, Nav, Real, Rot, RotIntegral, Sensor, SensorStart, Vec3, VecSum, math};
use nalgebra::Matrix3;

use crate::{earth::Earth, increment::Increment, noise::ImuNoise};

/// Why a pair of times gives no attitude.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum CoarseError<T: Real = f32> {
    /// t_k1 and t_k2 must be positive and in this order: gravity must have moved in between.
    Times {
        /// The earlier time, s.
        t1: T,
        /// The later time, s.
        t2: T,
    },
    /// The mean specific force is not gravity: free fall, a wrong unit, or a base that accelerates.
    Gravity {
        /// Its magnitude, m/s².
        found: T,
        /// Gravity at this place, m/s².
        expected: T,
    },
    /// Gravity has moved by less than a tenth, or more than ten times, of what Earth's rotation makes
    /// of it: collect for longer, or let the base come to rest.
    Degenerate {
        /// Angle between the two velocities, rad.
        found: T,
        /// What Earth's rotation makes of it, rad.
        expected: T,
    },
}

impl<T: Real> core::fmt::Display for CoarseError<T> {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.write_str(match self {
            Self::Times { .. } => "coarse alignment needs two different times after its start",
            Self::Gravity { .. } => {
                "mean specific force is not gravity: free fall, wrong units, or an accelerating base"
            }
            Self::Degenerate { .. } => {
                "gravity did not move as Earth turns: collect for longer, or let the base come to rest"
            }
        })
    }
}

impl<T: Real> core::error::Error for CoarseError<T> {}

/// The integrals at one time, enough to solve from any two of them.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CoarsePoint<T: Real = f32> {
    /// Time since the start, s.
    pub t: T,
    /// `V^ib0(t)`, m/s.
    pub v_ib0: Vec3<SensorStart, T>,
    /// `∫ C_s^ib0`, s: what a constant accelerometer bias makes of the velocity.
    bias_once: Matrix3<T>,
    /// `∫∫ C_s^ib0`, s²: what a constant gyro bias makes of it, but for gravity.
    bias_twice: Matrix3<T>,
}

/// The running integrals of coarse alignment.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Coarse<T: Real = f32> {
    t: T,
    c_ib0_s: RotIntegral<SensorStart, Sensor, T>,
    v_ib0: VecSum<SensorStart, T>,
    bias_once: Matrix3<T>,
    bias_twice: Matrix3<T>,
}

/// What two points say.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CoarseSolution<T: Real = f32> {
    /// `C_ib0^i`.
    pub c_i_ib0: Rot<Inertial, SensorStart, T>,
    first: CoarsePoint<T>,
    second: CoarsePoint<T>,
}

impl<T: Real> CoarsePoint<T> {
    /// `C_s^n` at the start of alignment, where s is ib0, from the mean specific force alone: level, with whatever heading.
    pub fn level(&self) -> Rot<Nav, Sensor, T> {
        let up = self.v_ib0 / self.v_ib0.norm();
        let sin = math::hypot(up.x(), up.y());
        let angle = math::atan2(sin, up.z());
        // Upside down any level axis will do.
        let axis = if sin > T::zero() {
            Vec3::new(up.y() / sin, -up.x() / sin, T::zero())
        } else {
            Vec3::new(T::one(), T::zero(), T::zero())
        };
        Rot::<SensorStart, SensorStart, T>::exp(axis * angle).relabel()
    }

    /// Predicted 1σ of its tilt, rad: by the turn-on biases through the actual motion.
    pub fn level_sd(&self, noise: &ImuNoise<T>, earth: &Earth<T>) -> T {
        let by_gyro = noise.gyro_bias_sd * self.bias_twice.norm();
        let by_accel = noise.accel_bias_sd * self.bias_once.norm() / earth.gravity();
        math::hypot(by_gyro, by_accel) / self.t
    }
}

impl<T: Real> Default for Coarse<T> {
    fn default() -> Self {
        Self::new()
    }
}

impl<T: Real> Coarse<T> {
    /// At the start: s and ib0 coincide, nothing has been integrated.
    pub fn new() -> Self {
        Self {
            t: T::zero(),
            c_ib0_s: RotIntegral::new(Rot::identity()),
            v_ib0: VecSum::new(Vec3::zero()),
            bias_once: Matrix3::zeros(),
            bias_twice: Matrix3::zeros(),
        }
    }

    /// Adds one increment ((11), (15)).
    pub fn push(&mut self, increment: &Increment<T>) {
        let dt = increment.dt;
        let c_ib0_s = self.c_ib0_s.get();
        self.v_ib0.add(c_ib0_s * increment.dv_s);
        let turned = c_ib0_s.matrix() * dt;
        self.bias_twice += self.bias_once * dt + turned * (T::lit(0.5) * dt);
        self.bias_once += turned;
        self.c_ib0_s.turn_from(increment.phi_s);
        self.t += dt;
    }

    /// Time since the start, s.
    pub fn t(&self) -> T {
        self.t
    }

    /// `C_s^ib0` now.
    pub fn c_ib0_s(&self) -> Rot<SensorStart, Sensor, T> {
        self.c_ib0_s.get()
    }

    /// The integrals now.
    pub fn point(&self) -> CoarsePoint<T> {
        CoarsePoint {
            t: self.t,
            v_ib0: self.v_ib0.get(),
            bias_once: self.bias_once,
            bias_twice: self.bias_twice,
        }
    }

    /// `C_s^n` now ((18)).
    pub fn c_ns(&self, solution: &CoarseSolution<T>, earth: &Earth<T>) -> Rot<Nav, Sensor, T> {
        (earth.c_ni(self.t) * solution.c_i_ib0 * self.c_ib0_s.get()).normalized()
    }

    /// Predicted covariance of the errors φ of the attitude that [`Coarse::c_ns`] gives now, from the IMU's
    /// figures, rad². Correlation of heading with tilt is left out.
    pub fn phi_covariance(&self, solution: &CoarseSolution<T>, earth: &Earth<T>, noise: &ImuNoise<T>) -> Matrix3<T> {
        let CoarseSolution { first, second, .. } = solution;
        let (t1, t2, t) = (first.t, second.t, self.t);
        let g = earth.gravity();
        let third = T::lit(1.0 / 3.0);
        let square = |x: T| x * x;
        let axes = (earth.c_ni(t) * solution.c_i_ib0).matrix();
        let gyro_bias = square(noise.gyro_bias_sd) + square(noise.gyro_instability_sd);
        let accel_bias = square(noise.accel_bias_sd);

        // φ of a unit gyro bias, mean over [0, t1] and [0, t2], and likewise what an accelerometer bias
        // turns the mean vertical by: up × ∇/g.
        let gyro = |p: &CoarsePoint<T>| axes * p.bias_twice / p.t;
        let up = Matrix3::new(
            T::zero(),
            -T::one(),
            T::zero(),
            T::one(),
            T::zero(),
            T::zero(),
            T::zero(),
            T::zero(),
            T::zero(),
        );
        let accel = |p: &CoarsePoint<T>| up * axes * p.bias_once / (p.t * g);

        // Heading: the tilt about east by which the second mean differs from the first, over the angle by which Earth's
        // rotation makes them differ, ω_ie cos L (t2 − t1)/2; and the drift about the vertical, which turns that angle too:
        // of a steady one 2 (t − (t1 + t2)/3) is left, in n as it is now. A bias does both, and they may cancel: where the
        // axis is upright the tilt is that of Earth's rotation alone, and takes back half of the other.
        let (first_tilt, second_tilt) = (gyro(first), gyro(second));
        let lever = T::lit(0.5) * earth.w_north() * (t2 - t1);
        let about_up = (axes * self.bias_once).row(2) / t;
        let heading_by_bias =
            (second_tilt - first_tilt).row(0) / lever + about_up * (T::lit(2.0) * (t - third * (t1 + t2)));
        let east = accel_bias * (accel(second) - accel(first)).row(0).norm_squared()
            + square(noise.angle_random_walk * (t2 - t1)) * third / t2
            + square(noise.velocity_random_walk / g) * (T::one() / t1 - T::one() / t2);
        let north = east / square(lever);
        let age = t - T::lit(2.0) * third * (t1 + t2);
        let heading = gyro_bias * heading_by_bias.norm_squared() + north + square(noise.angle_random_walk) * age.abs();

        // Tilt: the gyros carry the vertical from its mean over [0, t1] to now. Since then n has turned about north, and with
        // a wrong north about east as well; the same bias does both.
        let turned = earth.w_north() * (t - T::lit(0.5) * t1);
        let mut carried = axes * self.bias_once - first_tilt;
        let about_east = carried.row(0)
            - (heading_by_bias - about_up * t) * turned
            - about_up * (earth.w_north() * t1 * (T::lit(0.5) * t - third * t1));
        carried.set_row(0, &about_east);
        let mean = accel(first);
        let white = square(noise.angle_random_walk) * (t - T::lit(2.0) * third * t1)
            + square(noise.velocity_random_walk / g) / t1;
        let mut p = carried * carried.transpose() * gyro_bias
            + mean * mean.transpose() * accel_bias
            + Matrix3::identity() * white;
        p[(0, 0)] += north * square(turned);
        for axis in 0..2 {
            p[(axis, 2)] = T::zero();
            p[(2, axis)] = T::zero();
        }
        p[(2, 2)] = heading;
        p
    }
}

impl<T: Real> CoarseSolution<T> {
    /// Solves (17) from two points.
    ///
    /// # Errors
    /// [`CoarseError`] where the geometry gives no attitude.
    pub fn solve(first: CoarsePoint<T>, second: CoarsePoint<T>, earth: &Earth<T>) -> Result<Self, CoarseError<T>> {
        let (t1, t2) = (first.t, second.t);
        if !(t1.finite() && t2.finite() && t1 > T::zero() && t2 > t1) {
            return Err(CoarseError::Times { t1, t2 });
        }
        let expected = earth.gravity();
        for point in [&first, &second] {
            let found = point.v_ib0.norm() / point.t;
            let off = (found - expected).abs();
            if !off.finite() || off > T::lit(0.1) * expected {
                return Err(CoarseError::Gravity { found, expected });
            }
        }
        let (v1_i, v2_i) = (earth.velocity_i(t1), earth.velocity_i(t2));
        let angle = |a: T, b: T, cross: T| math::atan2(cross, a * b);
        let expected = angle(v1_i.norm(), v2_i.norm(), v1_i.cross(v2_i).norm());
        let found = angle(
            first.v_ib0.norm(),
            second.v_ib0.norm(),
            first.v_ib0.cross(second.v_ib0).norm(),
        );
        let ten = T::lit(10.0);
        // Rounding of the two velocities must not be what is measured.
        let floor = T::lit(100.0) * T::default_epsilon();
        if !(found > floor && expected > floor && found * ten > expected && found < ten * expected) {
            return Err(CoarseError::Degenerate { found, expected });
        }
        let c = triad(v1_i, v2_i) * triad(first.v_ib0, second.v_ib0).transpose();
        Ok(Self {
            c_i_ib0: Rot::from_matrix(&c),
            first,
            second,
        })
    }

    /// `C_s^n` at the start of alignment, where s is ib0.
    pub fn c_ns_at_start(&self, earth: &Earth<T>) -> Rot<Nav, Sensor, T> {
        (earth.c_ni(T::zero()) * self.c_i_ib0).normalized().relabel()
    }
}

/// The orthonormal triad of two vectors as columns: along the first, along their cross product, and
/// along (a × b) × a.
fn triad<F: frames::Frame, T: Real>(a: Vec3<F, T>, b: Vec3<F, T>) -> Matrix3<T> {
    let first = a / a.norm();
    let second = first.cross(b / b.norm());
    let second = second / second.norm();
    let third = second.cross(first);
    Matrix3::from_columns(&[first.vector(), second.vector(), third.vector()])
}

#[cfg(test)]
mod tests {
    use frames::{Body, units::DEG};

    use super::*;
    use crate::chance::Chance;
    use crate::rotor::{RotorConfig, Schedule};

    /// A still, tilted housing under a turning rotor, without any error; points at every whole second.
    fn points<T: Real>(
        latitude_deg: f64,
        c_nb: Rot<Nav, Body, f64>,
        seconds: u32,
    ) -> (Coarse<T>, [CoarsePoint<T>; 301]) {
        let earth = Earth::<f64>::new(latitude_deg * DEG, 0.0).unwrap();
        let schedule = Schedule::<f64>::new(RotorConfig::default()).unwrap();
        let dt = 0.05;
        let turn_n = earth.w_ie_n() * dt;
        let mut coarse = Coarse::new();
        let mut points = [coarse.point(); 301];
        for k in 0..20 * seconds {
            let c_ns = |k: u32| c_nb * Rot::about_z(schedule.at(f64::from(k) * dt).angle);
            let to_start = c_ns(k).inverse();
            // n turns by half the interval's turn below the force, in the mean.
            let force = -earth.g_n() - turn_n.cross(earth.g_n()) * 0.5;
            coarse.push(&Increment {
                phi_s: (to_start * (Rot::exp(turn_n) * c_ns(k + 1))).log().cast(),
                dv_s: (to_start * force * dt).cast(),
                dt: T::lit(dt),
            });
            if k % 20 == 19 {
                points[k as usize / 20 + 1] = coarse.point();
            }
        }
        (coarse, points)
    }

    /// Largest error over time pairs, rad.
    fn worst<T: Real>(latitude_deg: f64) -> f64 {
        let earth = Earth::<T>::new(T::lit(latitude_deg * DEG), T::zero()).unwrap();
        let c_nb = Rot::from_yaw_pitch_roll(2.1, 0.1, -0.2);
        let (coarse, points) = points(latitude_deg, c_nb, 300);
        let alpha = Schedule::<f64>::new(RotorConfig::default()).unwrap().at(300.0).angle;
        let truth = c_nb * Rot::about_z(alpha);
        let pairs = [(50, 250), (18, 54), (1, 300), (100, 120), (250, 300)];
        let errors = pairs.map(|(first, second)| {
            let solution = CoarseSolution::solve(points[first], points[second], &earth).unwrap();
            coarse.c_ns(&solution, &earth).cast::<f64>().angle_to(truth)
        });
        errors.into_iter().fold(0.0, f64::max)
    }

    #[test]
    fn exact_samples_give_the_attitude_at_any_pair_of_times() {
        for latitude_deg in [-85.0, -35.0, 0.0, 40.0, 85.0] {
            let (double, single) = (worst::<f64>(latitude_deg), worst::<f32>(latitude_deg));
            assert!(double < 1e-10, "{latitude_deg}: {double:e}");
            assert!(single < 1e-3, "{latitude_deg}: {single:e}");
        }
    }

    #[test]
    fn geometry_without_an_attitude_is_refused() {
        let earth = Earth::<f64>::new(40.0 * DEG, 0.0).unwrap();
        let (_, points) = points(40.0, Rot::identity(), 100);
        let solve = |first, second| CoarseSolution::solve(first, second, &earth).map(|s| s.c_i_ib0);
        let (early, late) = (points[50], points[100]);
        assert_eq!(
            solve(early, early),
            Err(CoarseError::Times {
                t1: early.t,
                t2: early.t
            })
        );
        assert_eq!(
            solve(late, early),
            Err(CoarseError::Times {
                t1: late.t,
                t2: early.t
            })
        );
        assert_eq!(solve(points[0], late), Err(CoarseError::Times { t1: 0.0, t2: late.t }));
        let fallen = CoarsePoint {
            v_ib0: Vec3::zero(),
            ..late
        };
        assert!(matches!(
            solve(early, fallen),
            Err(CoarseError::Gravity { found: 0.0, .. })
        ));
        let unknown = CoarsePoint {
            v_ib0: late.v_ib0 * f64::NAN,
            ..late
        };
        assert!(matches!(solve(early, unknown), Err(CoarseError::Gravity { .. })));
        // Gravity that has not moved in inertial space is not Earth's.
        let still = CoarsePoint {
            v_ib0: early.v_ib0 * 2.0,
            ..late
        };
        assert!(matches!(solve(early, still), Err(CoarseError::Degenerate { .. })));
    }

    #[test]
    fn a_level_start_puts_up_where_the_force_points() {
        let up = Vec3::<Nav, f64>::new(0.0, 0.0, 1.0);
        for (pitch, roll) in [
            (0.0, 0.0),
            (5.0, -3.0),
            (-40.0, 70.0),
            (0.0, 180.0),
            (20.0, 178.0),
            (89.0, 0.0),
        ] {
            let c_nb = Rot::from_yaw_pitch_roll(2.1, pitch * DEG, roll * DEG);
            let (_, points) = points::<f64>(40.0, c_nb, 20);
            let c_ns = points[18].level();
            let matrix = c_ns.matrix();
            assert!(
                (matrix * matrix.transpose() - Matrix3::identity()).amax() < 1e-14,
                "{pitch} {roll}"
            );
            // The rotor turns s, and Earth turns gravity by 0.04° in 9 s.
            let (found, true_up) = ((c_ns.inverse() * up).vector(), (c_nb.inverse() * up).vector());
            let tilt = found.cross(&true_up).norm();
            assert!(tilt < 0.05 * DEG, "{pitch} {roll}: {tilt}");
        }
        let upside_down = CoarsePoint {
            v_ib0: Vec3::new(0.0, 0.0, -1.0),
            ..Coarse::<f64>::new().point()
        };
        assert!((upside_down.level().inverse() * up).z() < -1.0 + 1e-12);
    }

    #[test]
    fn a_level_start_is_as_uncertain_as_the_biases_make_it() {
        let earth = Earth::<f64>::new(40.0 * DEG, 0.0).unwrap();
        let (_, points) = points::<f64>(40.0, Rot::identity(), 60);
        let sd = |gyro_bias_sd, accel_bias_sd| {
            let noise = ImuNoise {
                gyro_bias_sd,
                accel_bias_sd,
                ..ImuNoise::default()
            };
            points[54].level_sd(&noise, &earth)
        };
        // After whole turns the level biases have gone round; that of z tilts nothing but counts as one that does: half of
        // 54 s of it, and the accelerometers' z likewise.
        let (by_gyro, by_accel) = (sd(1e-3, 0.0), sd(0.0, 0.1));
        assert!((by_gyro - 27e-3).abs() < 0.5e-3, "{by_gyro}");
        assert!((by_accel - 0.1 / earth.gravity()).abs() < 0.05 * by_accel, "{by_accel}");
        assert!((sd(1e-3, 0.1) - math::hypot(by_gyro, by_accel)).abs() < 1e-12);
    }

    /// RMS of φ east, north and up over the predicted one, of 400 runs of a rotor in a still housing at this pitch and roll.
    fn scatter(pitch: f64, roll: f64, [t1, t2, t]: [usize; 3], noise: &ImuNoise<f64>, seed: u64) -> [f64; 3] {
        const RUNS: u32 = 400;
        const RATE: usize = 10;
        let earth = Earth::<f64>::new(40.0 * DEG, 0.0).unwrap();
        let schedule = Schedule::<f64>::new(RotorConfig::default()).unwrap();
        let dt = (RATE as f64).recip();
        let turn_n = earth.w_ie_n() * dt;
        let c_nb: Rot<Nav, Body, f64> = Rot::from_yaw_pitch_roll(2.1, pitch, roll);
        let c_ns = |k: usize| c_nb * Rot::about_z(schedule.at(k as f64 * dt).angle);
        let exact: [_; 300 * RATE] = core::array::from_fn(|k| {
            let to_start = c_ns(k).inverse();
            let force = -earth.g_n() - turn_n.cross(earth.g_n()) * 0.5;
            (
                (to_start * (Rot::exp(turn_n) * c_ns(k + 1))).log(),
                to_start * force * dt,
            )
        });
        let mut chance = Chance(seed);
        let (mut squares, mut predicted) = ([0.0; 3], [0.0; 3]);
        for _ in 0..RUNS {
            let (gyro, accel) = (
                chance.normals() * noise.gyro_bias_sd,
                chance.normals() * noise.accel_bias_sd,
            );
            let mut coarse = Coarse::new();
            let (mut first, mut second) = (coarse.point(), coarse.point());
            for (k, (phi_s, dv_s)) in (1..=RATE * t).zip(&exact) {
                let walk = math::sqrt(dt);
                coarse.push(&Increment {
                    phi_s: *phi_s + gyro * dt + chance.normals() * (noise.angle_random_walk * walk),
                    dv_s: *dv_s + accel * dt + chance.normals() * (noise.velocity_random_walk * walk),
                    dt,
                });
                if k == RATE * t1 {
                    first = coarse.point();
                }
                if k == RATE * t2 {
                    second = coarse.point();
                }
            }
            let solution = CoarseSolution::solve(first, second, &earth).unwrap();
            let phi = (coarse.c_ns(&solution, &earth) * c_ns(RATE * t).inverse()).log();
            let p = coarse.phi_covariance(&solution, &earth, noise);
            for (axis, phi) in phi.to_array().into_iter().enumerate() {
                squares[axis] += phi * phi;
                predicted[axis] += p[(axis, axis)];
            }
        }
        core::array::from_fn(|axis| math::sqrt(squares[axis] / predicted[axis]))
    }

    /// 400 runs scatter an RMS by 3.5 %.
    #[test]
    fn predicted_sd_is_that_of_many_runs() {
        let all = ImuNoise::default();
        let biases = ImuNoise {
            angle_random_walk: 0.0,
            velocity_random_walk: 0.0,
            accel_bias_sd: 0.0,
            ..all
        };
        for (pitch, roll) in [(0.0, 0.0), (0.01, -0.01), (0.035, -0.05), (-0.03, 0.02)] {
            for times in [[50, 250, 300], [18, 54, 54], [100, 200, 300]] {
                for (name, noise) in [("biases", &biases), ("all", &all)] {
                    let [east, north, up] = scatter(pitch, roll, times, noise, 2);
                    let ratios = [east, north, up];
                    assert!((0.9..1.1).contains(&up), "{pitch} {roll} {times:?} {name}: {ratios:?}");
                    assert!(
                        (0.9..1.1).contains(&north),
                        "{pitch} {roll} {times:?} {name}: {ratios:?}"
                    );
                    // The walk's tilt and what it makes of north are taken to have nothing to do with each other.
                    assert!(
                        (0.75..1.1).contains(&east),
                        "{pitch} {roll} {times:?} {name}: {ratios:?}"
                    );
                }
            }
        }
    }
}
