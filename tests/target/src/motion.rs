//! Samples of a rotating IMU on a base that swings, by formula: nothing is stored, and a hash over them is the same
//! wherever f64 is IEEE's and sine is `libm`'s.
//!
//! Swing, rotor and IMU are those of \[Xing18\], Tables 1 and 2; noise is uniform, from a xorshift. hal-sim's own truth
//! is exact and more; this one is as small as an image wants it. Its increments are good to 1e-9 of a turn (Simpson's
//! rule over gravity).

use core::f64::consts::TAU;

use frames::units::{DEG, DEG_PER_HOUR, DEG_PER_SQRT_HOUR, MICRO_G, MICRO_G_PER_SQRT_HZ};
use frames::{Body, Nav, Real, Rot, Sensor, Vec3, math};
use nav::earth::Earth;
use nav::increment::Sample;
use nav::rotor::{RotorConfig, Schedule};

/// Latitude of the place, rad.
pub const LATITUDE: f64 = 40.0 * DEG;
/// Interval of the samples, s.
pub const DT: f64 = 0.01;

/// A sample, with the rotor's angle at its end, rad.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Reading {
    /// What the IMU measured.
    pub sample: Sample,
    /// What the encoder measured.
    pub alpha: f32,
}

/// The samples, one after the other, without end.
#[derive(Debug, Clone)]
pub struct Motion {
    earth: Earth<f64>,
    schedule: Schedule<f64>,
    random: u32,
    /// Samples given so far.
    count: u32,
    /// `C_s^i` at the end of the last one, i fixed in space and equal to n at the start.
    c_is: Rot<Nav, Sensor, f64>,
    gyro_bias_s: Vec3<Sensor, f64>,
    accel_bias_s: Vec3<Sensor, f64>,
}

impl Motion {
    /// From the start. `None` never: the figures are in range.
    pub fn new() -> Option<Self> {
        let mut motion = Self {
            earth: Earth::new(LATITUDE, 0.0).ok()?,
            schedule: Schedule::new(RotorConfig::default()).ok()?,
            random: 0x2545_F491,
            count: 0,
            c_is: Rot::identity(),
            gyro_bias_s: Vec3::new(8.0, -11.0, 6.0) * DEG_PER_HOUR,
            accel_bias_s: Vec3::new(-90.0, 60.0, 110.0) * MICRO_G,
        };
        motion.c_is = motion.c_is_at(0.0);
        Some(motion)
    }

    /// Attitude of the housing at the end of the last sample.
    pub fn c_nb(&self) -> Rot<Nav, Body, f64> {
        Self::c_nb_at(f64::from(self.count) * DT)
    }

    fn c_nb_at(t: f64) -> Rot<Nav, Body, f64> {
        let wave = |degrees: f64, period: f64, phase: f64| degrees * DEG * math::sin_cos(TAU * t / period + phase).0;
        Rot::from_yaw_pitch_roll(
            30.0 * DEG + wave(10.0, 5.0, 0.3),
            wave(5.0, 6.0, 1.1),
            wave(8.0, 7.0, 2.0),
        )
    }

    /// Earth has turned n by ω_ie t since the start.
    fn c_is_at(&self, t: f64) -> Rot<Nav, Sensor, f64> {
        let c_bs = Rot::about_z(self.schedule.at(t).angle);
        Rot::exp(self.earth.w_ie_n() * t) * Self::c_nb_at(t) * c_bs
    }

    /// The specific force of a base that stands, in s, by the attitude in i.
    fn force(&self, t: f64, c_is: Rot<Nav, Sensor, f64>) -> Vec3<Sensor, f64> {
        let g_i = Rot::exp(self.earth.w_ie_n() * t) * self.earth.g_n();
        c_is.inverse() * -g_i
    }

    /// Uniform with a variance of one, each axis.
    fn noise(&mut self) -> Vec3<Sensor, f64> {
        let mut draw = || {
            self.random ^= self.random << 13;
            self.random ^= self.random >> 17;
            self.random ^= self.random << 5;
            // 1/√12 is the spread of a uniform number in [0, 1).
            (f64::from(self.random) / 4_294_967_296.0 - 0.5) * 3.464_101_615_137_754_6
        };
        Vec3::new(draw(), draw(), draw())
    }

    /// The next sample: rate and force are means over it, as an IMU that integrates gives them.
    pub fn next_reading(&mut self) -> Reading {
        let t0 = f64::from(self.count) * DT;
        self.count += 1;
        let (middle, end) = (t0 + 0.5 * DT, f64::from(self.count) * DT);
        let (from, half, to) = (self.c_is, self.c_is_at(middle), self.c_is_at(end));
        self.c_is = to;
        // The two halves added, with what the first leaves to the second (coning) taken out: ∫ω dt, not the turn.
        let (first, second) = ((from.inverse() * half).log(), (half.inverse() * to).log());
        let turn = first + second - first.cross(second) * (1.0 / 6.0);
        let force = (self.force(t0, from) + self.force(middle, half) * 4.0 + self.force(end, to)) * (1.0 / 6.0);
        // √DT = 0.1.
        let gyro = self.gyro_bias_s * DT + self.noise() * (0.02 * DEG_PER_SQRT_HOUR * 0.1);
        let accel = self.accel_bias_s * DT + self.noise() * (10.0 * MICRO_G_PER_SQRT_HZ * 0.1);
        Reading {
            sample: Sample {
                dtheta_s: (turn + gyro).cast(),
                dv_s: (force * DT + accel).cast(),
                dt: f32::lit(DT),
                gap: 0.0,
            },
            alpha: f32::lit(self.schedule.at(end).angle),
        }
    }
}
