//! Truth: the motion of the unit in closed form, and the exact integrals an IMU would measure.
//!
//! ```text
//! C_b^n = Rz(−heading) Rx(pitch) Ry(roll) B    each angle: centre + Σ A sin(2π t/T + φ)   [Xing18] §5.1
//! C_s^b = P U Rz(α) Uᵀ                         U tilts the rotor's axis; α by Rotation, with ripple
//! P     = Rx(W sin(α + φ_x)) Ry(W sin(α + φ_y))    the axis wobbles once a turn
//! p^n   = sway + C_b^n l                       l: lever arm
//! ω_is^s = C_b^s (ω_nb^b + C_n^b ω_ie^n) + α̇ u
//! f^s    = C_n^s (a + 2 ω_ie × v − g)
//! ```
//!
//! B is how the unit is built into the base that swings ([`RotorAxis`]): one where it stands upright, and b is the base.
//! Swing and sway are sums of sines: one where they are regular, those of [`sea`] besides.
//! What a sum is around an instant comes from its first ten derivatives there: with the steps below the next
//! term is less than `(2π/120)⁹/9! = 8e-18` of the amplitude.
//!
//! Heading takes the turns of the base ([`TurnOfBase`]) besides.
//!
//! Derivatives are analytic throughout. n is a fixed tangent plane on the rotating Earth: no transport rate, uniform
//! gravity (the displacements are metres). The IMU sits on the rotor's axis.
//!
//! Increments are integrated by the Gauss–Legendre rule of 3 nodes, `h⁷ f⁽⁶⁾/2 016 000` off over a step h. With the
//! fastest motion of period T resolved into 60 steps or more the error is below `(2π/60)⁶/2e6 = 6e-13` of the rate per
//! step; at 100 Hz and the papers' swing it is 1e-18 rad, far below rounding. Steps are cut where the rotor's
//! acceleration jumps. Vibration is the IMU's ([`Imu`](crate::sensors::Imu)): it displaces nothing.

use core::f64::consts::TAU;

use frames::units::{ARC_MIN, ARC_SEC, DEG};
use frames::{Attitude, Body, Nav, Rot, Sensor, Vec3};
use nalgebra::{Matrix3, Vector3};
use nav::earth::Earth;
use nav::rotor::RotorState;
use rand::RngExt;

use crate::config::{Angle, Violation};
use crate::rotation::Rotation;
use crate::scenario::{Axis, RotorAxis, Scenario, SeaAngle, SeaSway, SwayAxis, TurnOfBase};
use crate::sea;
use crate::sensors::{Stream, stream};

/// Longest step of the integration, s.
const MAX_STEP: f64 = 0.02;
/// Least number of steps in the shortest period of the motion.
const STEPS_PER_PERIOD: f64 = 60.0;

/// Nodes and weights of the Gauss–Legendre rule on [−1, 1]: 0 and ±√0.6.
const NODE: f64 = 0.774_596_669_241_483_4;
const WEIGHTS: [f64; 3] = [5.0 / 9.0, 8.0 / 9.0, 5.0 / 9.0];

/// Sine and cosine of an angle.
#[derive(Debug, Clone, Copy)]
struct SinCos {
    sin: f64,
    cos: f64,
}

impl SinCos {
    fn of(angle: f64) -> Self {
        let (sin, cos) = angle.sin_cos();
        Self { sin, cos }
    }

    /// Of the angle moved on by `d`. Most moves are tiny and a series of a few terms is exact: below 0.1 rad its error
    /// is d¹¹/11! = 3e-19.
    #[inline]
    fn moved(self, d: f64) -> Self {
        let step = if d.abs() < 0.1 {
            let d2 = d * d;
            Self {
                sin: d * (1.0 + d2 * (-1.0 / 6.0 + d2 * (1.0 / 120.0 + d2 * (-1.0 / 5040.0 + d2 * (1.0 / 362_880.0))))),
                cos: 1.0 + d2 * (-0.5 + d2 * (1.0 / 24.0 + d2 * (-1.0 / 720.0 + d2 * (1.0 / 40_320.0)))),
            }
        } else {
            Self::of(d)
        };
        Self {
            sin: self.sin * step.cos + self.cos * step.sin,
            cos: self.cos * step.cos - self.sin * step.sin,
        }
    }
}

/// A value with its first two derivatives by time.
#[derive(Debug, Clone, Copy)]
struct Motion {
    x: f64,
    dx: f64,
    ddx: f64,
}

/// `amplitude · sin(omega t + phase)`.
#[derive(Debug, Clone, Copy)]
struct Sine {
    amplitude: f64,
    omega: f64,
    phase: f64,
}

/// Derivatives of a [`Wave`] that are kept: those of its second derivative up to the eighth.
const DERIVATIVES: usize = 10;

/// A sum of sines about a centre.
#[derive(Debug, Clone)]
struct Wave {
    centre: f64,
    /// None where it rests.
    sines: Vec<Sine>,
}

impl Wave {
    fn new(centre: f64, sines: impl Iterator<Item = Sine>) -> Self {
        Self {
            centre,
            sines: sines.filter(|sine| sine.amplitude != 0.0).collect(),
        }
    }

    fn at(&self, t: f64) -> Jet {
        let mut derivatives = [0.0; DERIVATIVES + 1];
        for sine in &self.sines {
            let SinCos { sin, cos } = SinCos::of(sine.omega * t + sine.phase);
            let mut power = sine.amplitude;
            for (derivative, direction) in derivatives.iter_mut().zip([sin, cos, -sin, -cos].into_iter().cycle()) {
                *derivative += power * direction;
                power *= sine.omega;
            }
        }
        derivatives[0] += self.centre;
        Jet(derivatives)
    }
}

/// A [`Wave`] and its derivatives by time at one instant.
#[derive(Debug, Clone, Copy)]
struct Jet([f64; DERIVATIVES + 1]);

impl Jet {
    fn value(&self) -> f64 {
        self.0[0]
    }

    /// The motion `dt` later.
    #[inline]
    fn moved(&self, dt: f64) -> Motion {
        let [x, dx, ddx] = core::array::from_fn(|first| {
            let mut sum = 0.0;
            for n in (0..=DERIVATIVES - 2).rev() {
                sum = self.0[first + n] + sum * dt / (n + 1) as f64;
            }
            sum
        });
        Motion { x, dx, ddx }
    }
}

/// The rotor's axis as it wobbles: `amplitude · sin(α + phase)` about x and about y of the housing.
#[derive(Debug, Clone, Copy)]
struct Wobble {
    amplitude: f64,
    /// Of x and y.
    phases: [SinCos; 2],
}

impl Wobble {
    /// Angles about x and y where the rotor is at `alpha`, and their derivatives by α.
    fn at(&self, alpha: SinCos) -> [(f64, f64); 2] {
        self.phases.map(|phase| {
            (
                self.amplitude * (alpha.sin * phase.cos + alpha.cos * phase.sin),
                self.amplitude * (alpha.cos * phase.cos - alpha.sin * phase.sin),
            )
        })
    }
}

/// P = Rx(x) Ry(y).
fn rx_ry(x: f64, y: f64) -> Matrix3<f64> {
    let (x, y) = (SinCos::of(x), SinCos::of(y));
    Matrix3::new(
        y.cos,
        0.0,
        y.sin,
        x.sin * y.sin,
        x.cos,
        -x.sin * y.cos,
        -x.cos * y.sin,
        x.sin,
        x.cos * y.cos,
    )
}

/// A turn by `by` within `over` from `from` on, `by (u − sin(2πu)/2π)` with u from 0 to 1: rate and acceleration are zero at
/// both ends.
#[derive(Debug, Clone, Copy)]
struct Turn {
    from: f64,
    over: f64,
    by: f64,
}

impl Turn {
    fn at(&self, t: f64) -> Motion {
        let u = ((t - self.from) / self.over).clamp(0.0, 1.0);
        let (sin, cos) = (TAU * u).sin_cos();
        Motion {
            x: self.by * (u - sin / TAU),
            dx: self.by / self.over * (1.0 - cos),
            ddx: self.by / (self.over * self.over) * TAU * sin,
        }
    }
}

/// The rates and specific force of one instant.
struct Instant {
    w_is_s: Vector3<f64>,
    f_is_s: Vector3<f64>,
}

/// The trigonometry of one instant, from which those around it are had cheaply.
struct Base {
    /// Its time, s.
    t: f64,
    /// Yaw, pitch, roll of the swing …
    swing: [Jet; 3],
    /// … themselves with the turns …
    angles: [f64; 3],
    /// … and their sines and cosines.
    euler: [SinCos; 3],
    /// East, north, up; `None` where none moves.
    sway: Option<[Jet; 3]>,
    /// The ideal rotor, without ripple.
    rotor: RotorState<f64>,
    /// True rotor angle …
    alpha: f64,
    /// … its sine and cosine, and those of the ripple's argument.
    alpha_sc: SinCos,
    ripple: SinCos,
}

/// Attitude of the housing, its rate against n and that rate's derivative, in b.
struct Housing {
    c_nb: Matrix3<f64>,
    w_nb_b: Vector3<f64>,
    dw_nb_b: Vector3<f64>,
}

/// The motion of one run.
#[derive(Debug, Clone)]
pub struct Truth {
    /// Yaw (counter-clockwise), pitch, roll of the base, rad.
    swing: [Wave; 3],
    /// What yaw takes besides.
    turns: Vec<Turn>,
    /// East, north, up, m; `None` where none moves.
    sway: Option<[Wave; 3]>,
    lever_arm_b: Vector3<f64>,
    rotation: Rotation,
    /// Amplitude of the ripple in angle, rad, and its harmonic.
    ripple: (f64, f64),
    /// U: from axes with z along the rotor's axis to b; `None` where the axis is z.
    tilt: Option<Matrix3<f64>>,
    /// B: from b to the axes of the base; `None` where they are the same.
    mounting: Option<Matrix3<f64>>,
    wobble: Option<Wobble>,
    tilt_b: Vec3<Body, f64>,
    w_ie_n: Vector3<f64>,
    gravity: f64,
    max_step: f64,
}

impl Truth {
    /// The motion of a scenario, with the phases and the random heading the seed gives.
    ///
    /// All phases are drawn in a fixed order whether they are used or not: fixing one leaves the others as they were.
    ///
    /// # Errors
    /// Where the scenario is not valid; one that was read from a file is.
    pub fn new(scenario: &Scenario, seed: u64) -> Result<Self, Violation> {
        scenario.validate()?;
        let violation = |key: &str, problem: String| Violation {
            key: key.to_owned(),
            problem,
        };
        let rotation = Rotation::new(scenario, seed)?;
        let earth = Earth::<f64>::new(scenario.place.latitude_deg * DEG, scenario.place.height_m)
            .map_err(|e| violation("place", e.to_string()))?;

        let mut rng = stream(seed, Stream::Motion);
        let mut draws = [0.0; 7];
        for draw in &mut draws {
            *draw = rng.random::<f64>() * TAU;
        }
        let [heading, pitch, roll, east, north, up, centre] = draws;
        let sea = &scenario.sea;
        let mut sea_rng = stream(seed, Stream::Sea);
        let mut irregular = |significant: f64, peak_period_s: f64| {
            // Drawn whether used or not: a sea more leaves the others as they were.
            let draws: Vec<[f64; 2]> = (0..sea.components).map(|_| sea_rng.random()).collect();
            let components = if significant == 0.0 {
                Vec::new()
            } else {
                sea::components(&draws, peak_period_s, sea.peakedness)
            };
            // Of N sines of the same amplitude: σ² = N A²/2, and the significant amplitude is 2σ.
            let amplitude = significant / f64::from(2 * sea.components).sqrt();
            components.into_iter().map(move |component| Sine {
                amplitude,
                omega: component.omega,
                phase: component.phase,
            })
        };
        let regular = |amplitude: f64, period_s: f64, phase_deg: Option<f64>, random_phase: f64| {
            core::iter::once(Sine {
                amplitude,
                omega: TAU / period_s,
                phase: phase_deg.map_or(random_phase, |phase| phase * DEG),
            })
        };
        // Heading is clockwise, yaw counter-clockwise: `unit` is minus one degree.
        let mut angle = |axis: &Axis, sea: &SeaAngle, random_phase: f64, unit: f64| {
            let centre = match axis.centre_deg {
                Angle::Degrees(value) => value * unit,
                Angle::Random => centre * unit / DEG,
            };
            let swing = regular(axis.amplitude_deg * unit, axis.period_s, axis.phase_deg, random_phase);
            Wave::new(
                centre,
                swing.chain(irregular(sea.significant_deg * unit, sea.peak_period_s)),
            )
        };
        let swing = [
            angle(&scenario.swing.heading, &sea.heading, heading, -DEG),
            angle(&scenario.swing.pitch, &sea.pitch, pitch, DEG),
            angle(&scenario.swing.roll, &sea.roll, roll, DEG),
        ];
        let mut sway = |axis: &SwayAxis, sea: &SeaSway, random_phase: f64| {
            let sway = regular(axis.amplitude_m, axis.period_s, axis.phase_deg, random_phase);
            Wave::new(0.0, sway.chain(irregular(sea.significant_m, sea.peak_period_s)))
        };
        let sway = [
            sway(&scenario.sway.east, &sea.east, east),
            sway(&scenario.sway.north, &sea.north, north),
            sway(&scenario.sway.up, &sea.up, up),
        ];

        let [tilt_x, tilt_y] = scenario.rotor.axis_tilt_arcmin;
        let tilt_b = Vec3::new(tilt_x * ARC_MIN, tilt_y * ARC_MIN, 0.0);
        let mounted = scenario.rotor.axis != RotorAxis::Z;
        let harmonic = f64::from(scenario.rotor.ripple_harmonic);
        let ripple = (scenario.rotor.ripple_fraction / harmonic, harmonic);

        // The fastest line in the motion: swing, sway, the rotor's turning, its ripple.
        let rotor_rate = rotation.fastest();
        let ripple_rate = if ripple.0 > 0.0 { harmonic * rotor_rate } else { 0.0 };
        let fastest = swing
            .iter()
            .chain(&sway)
            .flat_map(|wave| &wave.sines)
            .map(|sine| sine.omega)
            .fold(rotor_rate.max(ripple_rate), f64::max);
        let wobble = scenario.rotor.wobble_arcsec * ARC_SEC;
        let mut wobble_rng = stream(seed, Stream::Wobble);
        let phases = [(); 2].map(|()| SinCos::of(wobble_rng.random::<f64>() * TAU));
        // Clockwise in the scenario, counter-clockwise here.
        let turn = |turn: &TurnOfBase| Turn {
            from: turn.at_s,
            over: turn.over_s,
            by: -turn.by_deg * DEG,
        };
        Ok(Self {
            swing,
            turns: scenario.turn.iter().map(turn).collect(),
            sway: sway.iter().any(|wave| !wave.sines.is_empty()).then_some(sway),
            lever_arm_b: scenario
                .rotor
                .axis
                .mounting()
                .tr_mul(&Vector3::from(scenario.lever_arm_m)),
            rotation,
            ripple,
            tilt: (tilt_b.norm() > 0.0).then(|| Rot::exp(tilt_b).matrix()),
            mounting: mounted.then(|| scenario.rotor.axis.mounting()),
            wobble: (wobble > 0.0).then_some(Wobble {
                amplitude: wobble,
                phases,
            }),
            tilt_b,
            w_ie_n: earth.w_ie_n().vector(),
            gravity: earth.gravity(),
            max_step: MAX_STEP.min(TAU / (fastest * STEPS_PER_PERIOD)),
        })
    }

    /// The rotor's profile, without ripple.
    pub fn rotation(&self) -> &Rotation {
        &self.rotation
    }

    /// Rate of n against i, resolved in n, rad/s.
    pub fn w_ie_n(&self) -> Vec3<Nav, f64> {
        Vec3::from_vector(self.w_ie_n)
    }

    /// Magnitude of gravity, m/s².
    pub fn gravity(&self) -> f64 {
        self.gravity
    }

    /// What all turns have added to yaw.
    fn turned(&self, t: f64) -> Motion {
        let mut sum = Motion {
            x: 0.0,
            dx: 0.0,
            ddx: 0.0,
        };
        for turn in &self.turns {
            let Motion { x, dx, ddx } = turn.at(t);
            sum.x += x;
            sum.dx += dx;
            sum.ddx += ddx;
        }
        sum
    }

    /// Attitude of the housing at `t` ≥ 0, s.
    pub fn c_nb(&self, t: f64) -> Rot<Nav, Body, f64> {
        let [yaw, pitch, roll] = self.swing.each_ref().map(|wave| wave.at(t).value());
        let yaw = yaw + self.turned(t).x;
        let base = Rot::from_yaw_pitch_roll(yaw, pitch, roll);
        match &self.mounting {
            None => base,
            Some(mounting) => Rot::from_matrix(&(base.matrix() * mounting)),
        }
    }

    /// Heading (clockwise, [0, 2π)), pitch and roll of the housing at `t`, rad.
    pub fn attitude(&self, t: f64) -> Attitude<f64> {
        Attitude::from_rot(&self.c_nb(t))
    }

    /// From s to b at `t`: about the rotor's axis by the rotor angle.
    pub fn c_bs(&self, t: f64) -> Rot<Body, Sensor, f64> {
        let alpha = self.rotor_angle(t);
        let tilt_s: Vec3<Sensor, f64> = Vec3::from_vector(self.tilt_b.vector());
        let turned = Rot::exp(self.tilt_b) * Rot::about_z(alpha) * Rot::exp(-tilt_s);
        match &self.wobble {
            None => turned,
            Some(wobble) => {
                let [(x, _), (y, _)] = wobble.at(SinCos::of(alpha));
                Rot::<Body, Body, f64>::from_matrix(&rx_ry(x, y)) * turned
            }
        }
    }

    /// From s to n at `t`.
    pub fn c_ns(&self, t: f64) -> Rot<Nav, Sensor, f64> {
        self.c_nb(t) * self.c_bs(t)
    }

    /// True rotor angle at `t`, with ripple, unwrapped, rad.
    pub fn rotor_angle(&self, t: f64) -> f64 {
        let rotor = self.rotation.at(t);
        rotor.angle + self.ripple.0 * self.ripple_argument(&rotor).sin
    }

    /// Sine and cosine of the ripple's argument.
    fn ripple_argument(&self, rotor: &RotorState<f64>) -> SinCos {
        let (amplitude, harmonic) = self.ripple;
        if amplitude > 0.0 {
            SinCos::of(harmonic * rotor.angle)
        } else {
            SinCos { sin: 0.0, cos: 1.0 }
        }
    }

    /// Rate of s against i in s at `t`, rad/s.
    pub fn w_is_s(&self, t: f64) -> Vec3<Sensor, f64> {
        Vec3::from_vector(self.instant(&self.base(t), 0.0).w_is_s)
    }

    /// Specific force at the IMU in s at `t`, m/s².
    pub fn f_is_s(&self, t: f64) -> Vec3<Sensor, f64> {
        Vec3::from_vector(self.instant(&self.base(t), 0.0).f_is_s)
    }

    /// Position of the IMU at `t` in n, from the mean position of the housing's reference point, m.
    pub fn position_n(&self, t: f64) -> Vec3<Nav, f64> {
        let base = self.base(t);
        let sway = base
            .sway
            .map_or(Vector3::zeros(), |sway| sway.map(|jet| jet.value()).into());
        Vec3::from_vector(sway + self.housing(&base, 0.0).c_nb * self.lever_arm_b)
    }

    /// Velocity of the IMU over ground at `t` in n, m/s.
    pub fn velocity_n(&self, t: f64) -> Vec3<Nav, f64> {
        let base = self.base(t);
        let (velocity, _) = self.point_motion(&self.housing(&base, 0.0), &base, 0.0);
        Vec3::from_vector(velocity)
    }

    /// What a perfect IMU gives for `t0..t1`, s: `(∫ω_is^s dt, ∫f^s dt)`, rad and m/s.
    ///
    /// The integrals of the rates in the turning frame, not rotation vectors: coning and sculling are left to whoever
    /// uses them.
    pub fn increment(&self, t0: f64, t1: f64) -> (Vec3<Sensor, f64>, Vec3<Sensor, f64>) {
        let (mut dtheta, mut dv) = (Vector3::zeros(), Vector3::zeros());
        let mut start = t0;
        loop {
            let corner = self.rotation.next_corner(start).filter(|corner| *corner < t1);
            let end = corner.unwrap_or(t1);
            self.integrate(start, end, &mut dtheta, &mut dv);
            if corner.is_none() {
                return (Vec3::from_vector(dtheta), Vec3::from_vector(dv));
            }
            start = end;
        }
    }

    /// The same where a motor drives the rotor, and not the schedule: `from` and `to` are the rotor's angle and rate at
    /// `t0` and `t1`, as the plant has them.
    ///
    /// Between them the angle is the cubic through both ends. ∫α̇ dt is then exact; within the sample the angle is off
    /// by `h⁴ α⁗/384`: with ripple of 0.2 °/s at 40 Hz and h = 5 ms by 5e-6°, for a fraction of the sample.
    pub fn increment_driven(
        &self,
        (t0, from): (f64, RotorState<f64>),
        (t1, to): (f64, RotorState<f64>),
    ) -> (Vec3<Sensor, f64>, Vec3<Sensor, f64>) {
        let (mut dtheta, mut dv) = (Vector3::zeros(), Vector3::zeros());
        let length = t1 - t0;
        let steps = (length / self.max_step).ceil().max(1.0);
        let half = 0.5 * length / steps;
        let mut k = 0.0;
        while k < steps {
            let middle = (2.0 * k + 1.0) * half;
            let base = self.base(t0 + middle);
            let (mut w, mut f) = (Vector3::zeros(), Vector3::zeros());
            for (node, weight) in [-NODE, 0.0, NODE].into_iter().zip(WEIGHTS) {
                let (alpha, rate) = hermite(&from, &to, length, middle + node * half);
                let instant = self.instant_at(&base, node * half, SinCos::of(alpha), rate);
                w += instant.w_is_s * weight;
                f += instant.f_is_s * weight;
            }
            dtheta += w * half;
            dv += f * half;
            k += 1.0;
        }
        (Vec3::from_vector(dtheta), Vec3::from_vector(dv))
    }

    /// Adds the integrals over a stretch of constant rotor acceleration.
    fn integrate(&self, start: f64, end: f64, dtheta: &mut Vector3<f64>, dv: &mut Vector3<f64>) {
        let steps = ((end - start) / self.max_step).ceil().max(1.0);
        let half = 0.5 * (end - start) / steps;
        let mut k = 0.0;
        while k < steps {
            let base = self.base(start + (2.0 * k + 1.0) * half);
            let (mut w, mut f) = (Vector3::zeros(), Vector3::zeros());
            for (node, weight) in [-NODE, 0.0, NODE].into_iter().zip(WEIGHTS) {
                let instant = self.instant(&base, node * half);
                w += instant.w_is_s * weight;
                f += instant.f_is_s * weight;
            }
            *dtheta += w * half;
            *dv += f * half;
            k += 1.0;
        }
    }

    fn base(&self, t: f64) -> Base {
        let swing = self.swing.each_ref().map(|wave| wave.at(t));
        let mut angles = swing.map(|jet| jet.value());
        angles[0] += self.turned(t).x;
        let rotor = self.rotation.at(t);
        let ripple = self.ripple_argument(&rotor);
        let alpha = rotor.angle + self.ripple.0 * ripple.sin;
        Base {
            t,
            swing,
            angles,
            euler: angles.map(SinCos::of),
            sway: self.sway.as_ref().map(|sway| sway.each_ref().map(|wave| wave.at(t))),
            rotor,
            alpha,
            alpha_sc: SinCos::of(alpha),
            ripple,
        }
    }

    /// The housing `dt` after the base.
    fn housing(&self, base: &Base, dt: f64) -> Housing {
        let mut m = base.swing.map(|jet| jet.moved(dt));
        let Motion { x, dx, ddx } = self.turned(base.t + dt);
        m[0].x += x;
        m[0].dx += dx;
        m[0].ddx += ddx;
        let [yaw, pitch, roll] = core::array::from_fn(|i| base.euler[i].moved(m[i].x - base.angles[i]));
        let (sy, cy, sp, cp, sr, cr) = (yaw.sin, yaw.cos, pitch.sin, pitch.cos, roll.sin, roll.cos);
        let c_nb = Matrix3::new(
            cy * cr - sy * sp * sr,
            -sy * cp,
            cy * sr + sy * sp * cr,
            sy * cr + cy * sp * sr,
            cy * cp,
            sy * sr - cy * sp * cr,
            -cp * sr,
            sp,
            cp * cr,
        );
        let [yaw, pitch, roll] = m;
        // Rate before the roll, then through it: ω = Ryᵀ(Rxᵀ ẑ ψ̇ + x̂ θ̇) + ŷ γ̇, and its derivative.
        let u = Vector3::new(pitch.dx, sp * yaw.dx, cp * yaw.dx);
        let du = Vector3::new(
            pitch.ddx,
            sp * yaw.ddx + cp * pitch.dx * yaw.dx,
            cp * yaw.ddx - sp * pitch.dx * yaw.dx,
        );
        let w_nb_b = Vector3::new(cr * u.x - sr * u.z, u.y + roll.dx, sr * u.x + cr * u.z);
        let dw_nb_b = Vector3::new(
            cr * du.x - sr * du.z - roll.dx * (sr * u.x + cr * u.z),
            du.y + roll.ddx,
            sr * du.x + cr * du.z + roll.dx * (cr * u.x - sr * u.z),
        );
        match &self.mounting {
            None => Housing { c_nb, w_nb_b, dw_nb_b },
            Some(mounting) => Housing {
                c_nb: c_nb * mounting,
                w_nb_b: mounting.tr_mul(&w_nb_b),
                dw_nb_b: mounting.tr_mul(&dw_nb_b),
            },
        }
    }

    /// Velocity and acceleration of the IMU in n.
    fn point_motion(&self, housing: &Housing, base: &Base, dt: f64) -> (Vector3<f64>, Vector3<f64>) {
        let (mut velocity, mut acceleration) = (Vector3::zeros(), Vector3::zeros());
        if let Some(sway) = &base.sway {
            let sway = sway.map(|jet| jet.moved(dt));
            velocity += Vector3::from(sway.map(|m| m.dx));
            acceleration += Vector3::from(sway.map(|m| m.ddx));
        }
        if self.lever_arm_b != Vector3::zeros() {
            let w = housing.w_nb_b;
            let turn = w.cross(&self.lever_arm_b);
            velocity += housing.c_nb * turn;
            acceleration += housing.c_nb * (housing.dw_nb_b.cross(&self.lever_arm_b) + w.cross(&turn));
        }
        (velocity, acceleration)
    }

    /// Rates and specific force `dt` after the base, within one stretch of constant rotor acceleration.
    #[inline]
    fn instant(&self, base: &Base, dt: f64) -> Instant {
        let turned = base.rotor.rate * dt + 0.5 * base.rotor.acceleration * dt * dt;
        let rate = base.rotor.rate + base.rotor.acceleration * dt;
        let (amplitude, harmonic) = self.ripple;
        let (alpha, alpha_rate) = if amplitude > 0.0 {
            let ripple = base.ripple.moved(harmonic * turned);
            (
                base.rotor.angle + turned + amplitude * ripple.sin,
                rate * (1.0 + amplitude * harmonic * ripple.cos),
            )
        } else {
            (base.alpha + turned, rate)
        };
        self.instant_at(base, dt, base.alpha_sc.moved(alpha - base.alpha), alpha_rate)
    }

    /// The same with the rotor at an angle and rate given.
    #[inline]
    fn instant_at(&self, base: &Base, dt: f64, alpha: SinCos, alpha_rate: f64) -> Instant {
        let housing = self.housing(base, dt);
        let (velocity, acceleration) = self.point_motion(&housing, base, dt);
        let f_n = acceleration + self.w_ie_n.cross(&velocity) * 2.0 + Vector3::new(0.0, 0.0, self.gravity);
        let mut f_b = housing.c_nb.tr_mul(&f_n);
        let mut w_ib_b = housing.w_nb_b + housing.c_nb.tr_mul(&self.w_ie_n);
        if let Some(wobble) = &self.wobble {
            // Into axes that wobble as the rotor's does: Pᵀ, and the rate Ryᵀ x̂ ẋ + ŷ ẏ.
            let [(x, dx), (y, dy)] = wobble.at(alpha).map(|(angle, by_alpha)| (angle, by_alpha * alpha_rate));
            let p = rx_ry(x, y);
            f_b = p.tr_mul(&f_b);
            let SinCos { sin, cos } = SinCos::of(y);
            w_ib_b = p.tr_mul(&w_ib_b) + Vector3::new(cos * dx, dy, sin * dx);
        }
        // Rz(α)ᵀ, between U and Uᵀ.
        let turn = |v: Vector3<f64>| {
            Vector3::new(
                alpha.cos * v.x + alpha.sin * v.y,
                alpha.cos * v.y - alpha.sin * v.x,
                v.z,
            )
        };
        let (w_is_s, f_is_s) = match &self.tilt {
            None => {
                let mut w = turn(w_ib_b);
                w.z += alpha_rate;
                (w, turn(f_b))
            }
            Some(u) => {
                let mut w = turn(u.tr_mul(&w_ib_b));
                w.z += alpha_rate;
                (u * w, u * turn(u.tr_mul(&f_b)))
            }
        };
        Instant { w_is_s, f_is_s }
    }
}

/// Angle and rate at `t` of the cubic through both ends of an interval of `length`.
fn hermite(from: &RotorState<f64>, to: &RotorState<f64>, length: f64, t: f64) -> (f64, f64) {
    let mean = (to.angle - from.angle) / length;
    // Of the rate: what the ends have beyond the mean.
    let (a, b) = (from.rate - mean, to.rate - mean);
    let s = t / length;
    let bulge = s * (1.0 - s);
    (
        from.angle + mean * t + length * bulge * (a * (1.0 - s) - b * s),
        mean + a * (1.0 - s) * (1.0 - 3.0 * s) + b * s * (3.0 * s - 2.0),
    )
}

#[cfg(test)]
mod tests {
    use frames::Inertial;

    use super::*;

    #[test]
    fn a_driven_rotor_on_schedule_is_the_schedule() {
        let text = ALL.replace("ripple_fraction", "# ripple_fraction");
        let truth = Truth::new(&Scenario::parse(&text, "s").unwrap(), 3).unwrap();
        let state = |t: f64| truth.rotation.at(t);
        let (mut worst_angle, mut worst_velocity) = (0.0_f64, 0.0_f64);
        for k in 0..4000 {
            let (t0, t1) = (f64::from(k) * 0.005, f64::from(k + 1) * 0.005);
            // A jump of the acceleration within the interval is not the cubic's.
            if truth.rotation.next_corner(t0 - 1e-9).is_some_and(|corner| corner < t1) {
                continue;
            }
            let (angle, velocity) = truth.increment(t0, t1);
            let (driven_angle, driven_velocity) = truth.increment_driven((t0, state(t0)), (t1, state(t1)));
            worst_angle = worst_angle.max((angle - driven_angle).norm());
            worst_velocity = worst_velocity.max((velocity - driven_velocity).norm());
        }
        assert!(worst_angle < 1e-14, "{worst_angle:e}");
        assert!(worst_velocity < 1e-13, "{worst_velocity:e}");
    }

    /// Everything moves, at awkward figures.
    const ALL: &str = "
        lever_arm_m = [0.5, -0.3, 0.2]
        [place]
        latitude_deg = -35
        height_m = 120
        [swing.pitch]
        amplitude_deg = 5
        period_s = 6
        centre_deg = 3
        [swing.roll]
        amplitude_deg = 8
        period_s = 7
        centre_deg = -11
        [swing.heading]
        amplitude_deg = 10
        period_s = 5
        centre_deg = 'random'
        [sway.east]
        amplitude_m = 0.2
        period_s = 9
        [sway.north]
        amplitude_m = 0.4
        period_s = 11
        [sway.up]
        amplitude_m = 0.3
        period_s = 4
        [rotor]
        ripple_fraction = 0.05
        ripple_harmonic = 7
        axis_tilt_arcmin = [20, -35]
    ";

    /// [`ALL`] with the rotor along another axis of the base.
    fn mounted(axis: &str) -> String {
        format!("{ALL}\n        axis = '{axis}'\n")
    }

    fn truth(text: &str, seed: u64) -> Truth {
        Truth::new(&Scenario::parse(text, "test").unwrap(), seed).unwrap()
    }

    /// `C_s^i`, i being n at t = 0.
    fn c_is(truth: &Truth, t: f64) -> Rot<Inertial, Sensor, f64> {
        (Rot::exp(truth.w_ie_n() * t) * truth.c_ns(t)).relabel()
    }

    fn builtins_and_all() -> Vec<Truth> {
        Scenario::builtin_names()
            .map(|name| Truth::new(&Scenario::builtin(name).unwrap(), 3).unwrap())
            .chain([truth(ALL, 1), truth(ALL, 2), truth(SEA, 1)])
            .chain(["x", "y"].map(|axis| truth(&mounted(axis), 1)))
            .collect()
    }

    /// Whether a corner of the rotor's profile is within `h` of `t`.
    fn near_corner(truth: &Truth, t: f64, h: f64) -> bool {
        truth.rotation.next_corner((t - h).max(0.0)).is_some_and(|c| c < t + h)
    }

    #[test]
    fn rate_is_the_derivative_of_attitude() {
        let h = 1e-4;
        for truth in builtins_and_all() {
            for k in 0..400 {
                let t = 0.05 + f64::from(k) * 0.137;
                if near_corner(&truth, t, 2.0 * h) {
                    continue;
                }
                // C(t)ᵀ C(t + h) over the symmetric interval: second order.
                let turn = c_is(&truth, t - h).inverse() * c_is(&truth, t + h);
                let error = (turn.log() / (2.0 * h) - truth.w_is_s(t)).norm();
                assert!(error < 3e-8, "{error} at {t}");
            }
        }
    }

    #[test]
    fn specific_force_is_the_second_derivative_of_position_minus_gravity() {
        let h = 1e-3;
        for truth in builtins_and_all() {
            for k in 0..400 {
                let t = 0.05 + f64::from(k) * 0.137;
                let [m, c, p] = [t - h, t, t + h].map(|t| truth.position_n(t));
                let velocity = (p - m) / (2.0 * h);
                assert!((velocity - truth.velocity_n(t)).norm() < 1e-6);
                let acceleration = (p + m - c * 2.0) / (h * h);
                let g_n = Vec3::new(0.0, 0.0, -truth.gravity());
                let f_n = acceleration + truth.w_ie_n().cross(velocity) * 2.0 - g_n;
                let error = (truth.c_ns(t) * truth.f_is_s(t) - f_n).norm();
                assert!(error < 1e-6, "{error} at {t}");
            }
        }
    }

    #[test]
    fn signs_of_a_unit_at_rest() {
        let truth = truth("[swing.heading]\ncentre_deg = 90\n[rotor]\nrate_dps = 0", 0);
        // Heading east: north is to the left.
        let w = truth.w_is_s(10.0);
        let (north, up) = (truth.w_ie_n().y(), truth.w_ie_n().z());
        assert!((w - Vec3::new(-north, 0.0, up)).norm() < 1e-18, "{w:?}");
        assert!(north > 5e-5 && up > 4e-5);
        assert!((truth.f_is_s(10.0) - Vec3::new(0.0, 0.0, truth.gravity())).norm() < 1e-14);
        assert!((truth.attitude(1.0).heading - 90.0 * DEG).abs() < 1e-15);
        // The perfect, still sample of an independent generator at 40° north has this gravity.
        assert!((truth.gravity() - 9.801_696_863).abs() < 1e-9);
    }

    #[test]
    fn signs_of_the_rotor() {
        let truth = truth("", 0);
        assert!((truth.w_is_s(5.0).z() - (20.0 * DEG + truth.w_ie_n().z())).abs() < 1e-15);
        assert!((truth.rotor_angle(1.05) - 20.0 * DEG).abs() < 1e-14);
        // After a quarter turn the IMU's x points where the housing's y does.
        let quarter = 4.55;
        let x = truth.c_bs(quarter) * Vec3::new(1.0, 0.0, 0.0);
        assert!((x - Vec3::new(0.0, 1.0, 0.0)).norm() < 1e-14);
        // North is then along the IMU's x.
        assert!((truth.w_is_s(quarter).x() - truth.w_ie_n().y()).abs() < 1e-18);
    }

    #[test]
    fn signs_of_the_mounting() {
        let at = |axis: &str, t: f64| {
            let text = format!(
                "[swing.heading]\ncentre_deg = 20\n[swing.pitch]\ncentre_deg = 5\n[swing.roll]\ncentre_deg = -8\n\
                 [rotor]\naxis = '{axis}'"
            );
            let truth = truth(&text, 0);
            (truth.attitude(t), truth.c_ns(t), truth.w_is_s(t))
        };
        let (base, upright, _) = at("z", 0.0);
        let (side, on_its_side, w) = at("x", 5.0);
        let near = |a: f64, b: f64| (a - b).abs() < 1e-12;
        assert!(near(side.heading, base.heading) && near(side.pitch, base.pitch));
        assert!(near(side.roll, base.roll + 90.0 * DEG));
        // The axis about which the IMU turns is its z, and points where the base's right does.
        let axis = |c: Rot<Nav, Sensor, f64>| c * Vec3::new(0.0, 0.0, 1.0);
        assert!(w.z() > 19.9 * DEG && w.x().hypot(w.y()) < 1e-4);
        assert!((axis(on_its_side) - upright * Vec3::new(1.0, 0.0, 0.0)).norm() < 1e-12);
        let (tipped, over, w) = at("y", 5.0);
        assert!(w.z() > 19.9 * DEG && w.x().hypot(w.y()) < 1e-4);
        assert!((axis(over) - upright * Vec3::new(0.0, 1.0, 0.0)).norm() < 1e-12);
        // To the second order of the tilts.
        assert!((tipped.heading - base.heading - 90.0 * DEG).abs() < 0.013);
        assert!((tipped.pitch + base.roll).abs() < 0.013 && (tipped.roll - base.pitch + 90.0 * DEG).abs() < 0.013);
    }

    #[test]
    fn signs_of_the_swing() {
        let truth = truth(
            "[swing.heading]\namplitude_deg = 10\nphase_deg = 0\n[swing.pitch]\ncentre_deg = 5\n[rotor]\nrate_dps = 0",
            0,
        );
        // At t = 0 the heading grows, clockwise: the rate about the vertical is negative.
        assert!(truth.attitude(0.1).heading > 0.0 && truth.attitude(0.1).heading < 0.2);
        assert!(truth.w_is_s(0.0).z() < -0.1);
        // Front up: gravity's reaction pushes forwards.
        assert!(truth.f_is_s(0.0).y() > 0.8);
    }

    #[test]
    fn increments_are_exact_at_any_rate() {
        let mut worst: f64 = 0.0;
        for truth in builtins_and_all() {
            for (rate, seconds) in [(1000, 8), (400, 20), (100, 40), (50, 40), (37, 40), (10, 40)] {
                for k in 0..rate * seconds {
                    let t0 = f64::from(k) / f64::from(rate);
                    let t2 = f64::from(k + 1) / f64::from(rate);
                    let t1 = 0.5 * (t0 + t2);
                    let (whole, first, second) = (
                        truth.increment(t0, t2),
                        truth.increment(t0, t1),
                        truth.increment(t1, t2),
                    );
                    // Relative to 1 rad/s and g: angles and velocities alike to 1e-14 of a second.
                    let angle = (whole.0 - first.0 - second.0).norm();
                    let velocity = (whole.1 - first.1 - second.1).norm() / truth.gravity();
                    worst = worst.max(angle).max(velocity);
                }
            }
        }
        assert!(worst < 1e-14, "{worst:e}");
    }

    #[test]
    fn halving_the_intervals_keeps_the_sums() {
        for truth in builtins_and_all() {
            // The differences are summed, not the increments: 200 m/s has itself an ulp of 3e-14.
            let (mut angle, mut velocity) = (Vec3::zero(), Vec3::zero());
            for k in 0..20 * 64 {
                let [t0, t1, t2] = [0.0, 0.5, 1.0].map(|part| (f64::from(k) + part) / 64.0);
                let (whole, first, second) = (
                    truth.increment(t0, t2),
                    truth.increment(t0, t1),
                    truth.increment(t1, t2),
                );
                angle += whole.0 - first.0 - second.0;
                velocity += whole.1 - first.1 - second.1;
            }
            assert!(angle.norm() < 1e-13, "{:e}", angle.norm());
            assert!(velocity.norm() < 1e-12, "{:e}", velocity.norm());
        }
    }

    #[test]
    fn the_rule_of_three_is_as_good_as_halving_it_eight_times() {
        let truth = truth(ALL, 4);
        for k in 0..200 {
            let (t0, t1) = (f64::from(k) * 0.1, f64::from(k) * 0.1 + 0.01);
            let whole = truth.increment(t0, t1);
            let mut parts = (Vec3::zero(), Vec3::zero());
            for i in 0..256 {
                let at = |i: u32| t0 + (t1 - t0) * f64::from(i) / 256.0;
                let (a, v) = truth.increment(at(i), at(i + 1));
                parts = (parts.0 + a, parts.1 + v);
            }
            assert!((whole.0 - parts.0).norm() < 1e-15);
            assert!((whole.1 - parts.1).norm() < 1e-14);
        }
    }

    #[test]
    fn fine_rotations_compose_to_the_attitude() {
        // Taking ∫ω dt for the rotation vector is off by coning, (h²/12)|ω × ω̇| a second: 4e-9 rad at 10 kHz here.
        for truth in [
            truth(ALL, 5),
            Truth::new(&Scenario::builtin("paper-sim").unwrap(), 9).unwrap(),
        ] {
            let (rate, seconds) = (10_000, 20);
            let mut c = c_is(&truth, 0.0);
            let mut velocity: Vec3<Inertial, f64> = Vec3::zero();
            for k in 0..rate * seconds {
                let at = |k: u32| f64::from(k) / f64::from(rate);
                let (dtheta, dv) = truth.increment(at(k), at(k + 1));
                velocity += c * (dv + dtheta.cross(dv) * 0.5);
                c = (c * Rot::exp(dtheta)).normalized();
            }
            let end = f64::from(seconds);
            let error = c.angle_to(c_is(&truth, end));
            assert!(error < 2e-8, "{error:e}");
            // In n: Δv = ∫ (f + g) over 20 s, up to Earth's turning (1.5e-3 rad in that time), so a coarse check of
            // scale and sign; the exact one is by differences above.
            let gravity: Vec3<Inertial, f64> = Vec3::new(0.0, 0.0, truth.gravity() * end);
            let gained = (truth.velocity_n(end) - truth.velocity_n(0.0)).vector();
            let error = ((velocity - gravity).vector() - gained).norm();
            assert!(error < 0.5, "{error}");
        }
    }

    #[test]
    fn one_seed_one_motion_and_fixing_one_phase_leaves_the_others() {
        let (a, b) = (truth(ALL, 7), truth(ALL, 7));
        assert_eq!(a.increment(3.0, 3.01), b.increment(3.0, 3.01));
        assert_ne!(a.increment(3.0, 3.01), truth(ALL, 8).increment(3.0, 3.01));
        let mut scenario = Scenario::parse(ALL, "test").unwrap();
        scenario.swing.pitch.phase_deg = Some(0.0);
        let c = Truth::new(&scenario, 7).unwrap();
        let phase = |wave: &Wave| wave.sines[0].phase;
        let up = |truth: &Truth| phase(&truth.sway.as_ref().unwrap()[2]);
        assert_eq!(phase(&a.swing[0]), phase(&c.swing[0]));
        assert_eq!(up(&a), up(&c));
        assert_eq!(phase(&c.swing[1]), 0.0);
    }

    /// A sea in every component, no swing and no sway besides.
    const SEA: &str = "
        lever_arm_m = [0.5, -0.3, 0.2]
        [sea]
        peakedness = 3.3
        [sea.pitch]
        significant_deg = 7
        peak_period_s = 6
        [sea.roll]
        significant_deg = 11
        peak_period_s = 7
        [sea.heading]
        significant_deg = 14
        peak_period_s = 5
        [sea.east]
        significant_m = 0.3
        peak_period_s = 9
        [sea.north]
        significant_m = 0.4
        peak_period_s = 11
        [sea.up]
        significant_m = 0.5
        peak_period_s = 8
        [rotor]
        wobble_arcsec = 300
        axis_tilt_arcmin = [20, -35]
    ";

    /// Mean square of a motion, and its spectrum at so many times the peak's frequency, from samples of an hour.
    fn observed(truth: &Truth, value: impl Fn(&Truth, f64) -> f64, peak_period_s: f64) -> (f64, Vec<(f64, f64)>) {
        let (seconds, step) = (3600.0, 0.25);
        let samples: Vec<f64> = (0..(seconds / step) as u32)
            .map(|k| value(truth, f64::from(k) * step))
            .collect();
        let n = samples.len() as f64;
        let mean = samples.iter().sum::<f64>() / n;
        let square = samples.iter().map(|x| (x - mean).powi(2)).sum::<f64>() / n;
        let energy = |x: f64| {
            // Of a band of a tenth of the peak's frequency: the lines in it are far apart against 1/3600 s.
            let lines = (0.1 * seconds / peak_period_s) as u32;
            (0..lines)
                .map(|k| {
                    let f = (x - 0.05) / peak_period_s + f64::from(k) / seconds;
                    let (mut c, mut s) = (0.0, 0.0);
                    for (j, sample) in samples.iter().enumerate() {
                        let (sin, cos) = (TAU * f * step * j as f64).sin_cos();
                        c += (sample - mean) * cos;
                        s += (sample - mean) * sin;
                    }
                    2.0 * (c * c + s * s) / (n * n)
                })
                .sum::<f64>()
        };
        (square, [0.6, 0.8, 1.0, 1.2, 1.5].map(|x| (x, energy(x))).to_vec())
    }

    #[test]
    fn a_sea_has_the_spread_and_the_peak_asked_for() {
        let truth = truth(SEA, 11);
        type Value = fn(&Truth, f64) -> f64;
        let motions: [(Value, f64, f64); 3] = [
            (|truth, t| truth.attitude(t).pitch, 7.0 * DEG, 6.0),
            (|truth, t| truth.attitude(t).roll, 11.0 * DEG, 7.0),
            (|truth, t| truth.base(t).sway.unwrap()[1].value(), 0.4, 11.0),
        ];
        for (value, significant, peak_period_s) in motions {
            let (square, spectrum) = observed(&truth, value, peak_period_s);
            // Thirty lines over an hour: what their differences leave of the mean square is a few percent.
            let part = 2.0 * square.sqrt() / significant;
            assert!((part - 1.0).abs() < 0.05, "{part}");
            let most = spectrum.iter().max_by(|a, b| a.1.total_cmp(&b.1)).unwrap();
            assert_eq!(most.0, 1.0, "{spectrum:?}");
        }
    }

    #[test]
    fn one_seed_one_sea_and_a_sea_more_leaves_the_others() {
        let (a, b) = (truth(SEA, 7), truth(SEA, 7));
        assert_eq!(a.increment(3.0, 3.01), b.increment(3.0, 3.01));
        assert_ne!(a.increment(3.0, 3.01), truth(SEA, 8).increment(3.0, 3.01));
        let calm = truth(&SEA.replace("significant_deg = 7", "significant_deg = 0"), 7);
        assert!(calm.swing[1].sines.is_empty());
        for t in [1.0, 50.0] {
            assert_eq!(calm.swing[2].at(t).value(), a.swing[2].at(t).value());
            assert_eq!(calm.swing[0].at(t).value(), a.swing[0].at(t).value());
        }
    }

    #[test]
    fn a_rotor_wobbles_once_a_turn() {
        let truth = truth("[rotor]\nwobble_arcsec = 30", 1);
        let (mut largest, mut after_a_turn) = (0.0_f64, 0.0_f64);
        for k in 0..170 {
            let t = 0.5 + f64::from(k) * 0.1;
            let axis = |t: f64| truth.c_bs(t) * Vec3::new(0.0, 0.0, 1.0);
            largest = largest.max(axis(t).x().abs()).max(axis(t).y().abs());
            // On the way back it is the same at the same angle.
            after_a_turn = after_a_turn.max((axis(t) - axis(36.2 - t)).norm());
        }
        assert!((largest / (30.0 * ARC_SEC) - 1.0).abs() < 0.01, "{largest}");
        assert!(after_a_turn < 1e-12, "{after_a_turn:e}");
    }

    #[test]
    fn an_invalid_scenario_is_refused() {
        let mut scenario = Scenario::default();
        scenario.place.latitude_deg = f64::NAN;
        assert_eq!(
            Truth::new(&scenario, 0).unwrap_err().to_string(),
            "place.latitude_deg: NaN is out of range, allowed are -85 to 85"
        );
    }
}
