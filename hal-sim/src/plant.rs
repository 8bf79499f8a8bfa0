//! The rotor's mechanics and its motor: what the duties of the three phases turn into.
//!
//! ```text
//! L di_q/dt = v_q − R i_q − N ω L i_d − N ω ψ                      ψ = K_t / 1.5 N
//! L di_d/dt = v_d − R i_d + N ω L i_q
//! J dω/dt   = K_t i_q + cogging(α) + cable(α) + stops(α, ω) + load − b ω − friction(ω)
//! cogging   = T_rated Σ s_k sin(k α + φ_k)                         k = poles, slots, lcm(slots, poles), …
//! cable     = −c (α − rest)
//! friction  ∈ [−T_s, T_s] at rest,  sgn ω (T_c + (T_s − T_c) e^(−(ω/ω_s)²)) in motion
//! ```
//!
//! The currents are the amplitude-invariant ones: `i_q` is the peak of a phase's current. Over a sub-step of at most
//! 500 µs each winding is a first-order lag, solved exactly with the speed held. The mechanics is a leapfrog whose
//! friction is implicit (Moreau's time stepping): a rotor at rest stays there exactly while the rest of the torque is
//! less than its stiction, and nothing chatters about zero.
//!
//! # The home switch
//!
//! Below the edge, or above it, over the *whole* travel, more than a turn included: a lever that stays where a pin on
//! the rotor has tripped it. See `app::rotor` for the mechanics.
//!
//! # The truth for tests
//!
//! [`Plant::wound_past`] is set for good once the rotor has been outside what the cable allows.
//!
//! Not modelled: dead time and ripple of the bridge, braking by the bridge's diodes while it is off, saturation,
//! temperature of the windings, elasticity of the shaft, the encoder's delay.

use core::f64::consts::{FRAC_PI_3, PI, TAU};

use app::rotor::Side;
use drivers::motor::{Duty, ThreePhase};
use drivers::mt6835::{AngleCounts, COUNTS_PER_TURN};
use frames::units::DEG;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;

/// Longest step of the integration, s. The fastest cogging is at 10 Hz, the windings are solved exactly.
const SUB_STEP: f64 = 500e-6;

/// One term of the cogging torque.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Cogging {
    /// Periods in a turn.
    pub order: u16,
    /// Amplitude as a share of the rated torque.
    pub share: f64,
    /// Phase at α = 0, rad.
    pub phase: f64,
}

/// A cable that winds up on the rotor, and the stops that save it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Cable {
    /// Least angle it bears, rad.
    pub low: f64,
    /// Greatest angle it bears, rad.
    pub high: f64,
    /// Angle at which it pulls neither way, rad.
    pub rest: f64,
    /// Its stiffness, Nm/rad.
    pub stiffness: f64,
    /// Stiffness of the mechanical stops at `low` and `high`, Nm/rad; zero: there are none, and a runaway shows.
    pub stop_stiffness: f64,
}

/// Figures of a motor with its load.
///
/// The default is a 12-slot, 14-pole gimbal motor of the 5208 class with an IMU and its board as load. Its cogging and
/// friction are on the bad side of what such motors show; no one motor was measured.
#[derive(Debug, Clone, PartialEq)]
pub struct PlantConfig {
    /// Pole pairs N.
    pub pole_pairs: u8,
    /// Supply of the bridge, V.
    pub supply: f64,
    /// Resistance of a phase, Ω.
    pub resistance: f64,
    /// Inductance of a phase, H.
    pub inductance: f64,
    /// K_t, Nm per ampere of `i_q`.
    pub torque_constant: f64,
    /// Moment of inertia of all that turns, kg m².
    pub inertia: f64,
    /// Viscous friction, Nm s/rad.
    pub viscous: f64,
    /// Coulomb friction, Nm.
    pub coulomb: f64,
    /// Friction at rest, Nm.
    pub stiction: f64,
    /// Rate at which the friction has come down from stiction to Coulomb's, rad/s.
    pub stribeck_rate: f64,
    /// Rated torque, Nm: the measure of the cogging.
    pub rated_torque: f64,
    /// Cogging torque.
    pub cogging: Vec<Cogging>,
    /// `None` for a slip ring.
    pub cable: Option<Cable>,
    /// Angle of the home switch's edge, rad.
    pub home_edge: f64,
    /// Angle between its edges in the two directions, rad.
    pub home_hysteresis: f64,
    /// Electrical angle of phase A's axis at encoder reading zero, rad.
    pub electrical_offset: f64,
    /// Phases B and C are exchanged.
    pub swapped: bool,
    /// The encoder's true angle at α = 0, rad.
    pub encoder_zero: f64,
    /// The encoder's error as (order, amplitude in rad, phase in rad), a function of the reading.
    pub encoder_harmonics: Vec<(u16, f64, f64)>,
    /// White noise of a reading, 1σ, rad. No figure for the MT6835 was found; this is an assumption.
    pub encoder_noise_sd: f64,
    /// Counts of the PWM timer from bottom to top.
    pub pwm_top: u16,
}

impl Default for PlantConfig {
    fn default() -> Self {
        let cogging = |order, share, phase| Cogging { order, share, phase };
        Self {
            pole_pairs: 7,
            supply: 12.0,
            resistance: 5.5,
            inductance: 2.5e-3,
            torque_constant: 0.138,
            inertia: 3e-4,
            viscous: 2e-4,
            coulomb: 4e-3,
            stiction: 5.5e-3,
            stribeck_rate: 0.05,
            rated_torque: 0.12,
            cogging: vec![
                cogging(84, 0.02, 0.3),
                cogging(168, 0.003, 1.0),
                cogging(14, 0.005, -0.7),
                cogging(12, 0.005, 2.0),
            ],
            cable: Some(Cable {
                low: -15.0 * DEG,
                high: 375.0 * DEG,
                rest: PI,
                stiffness: 1e-3,
                stop_stiffness: 0.0,
            }),
            home_edge: PI,
            home_hysteresis: 0.5 * DEG,
            electrical_offset: 1.0,
            swapped: false,
            encoder_zero: 2.0,
            encoder_harmonics: vec![(1, 1.5e-3, 0.4), (2, 6e-4, -1.1), (4, 2e-4, 2.5)],
            encoder_noise_sd: 2e-5,
            pwm_top: 4200,
        }
    }
}

impl PlantConfig {
    /// This unit as made: each figure of motor and mechanics off by up to ±`share`, uniformly, the phases of the
    /// cogging and the mounting of encoder and magnets anyhow. What the firmware is told of the unit (pole pairs,
    /// supply, edge of the switch, encoder zero and table) stays.
    pub fn varied(&self, seed: u64, share: f64) -> Self {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let mut unit = self.clone();
        for figure in [
            &mut unit.resistance,
            &mut unit.inductance,
            &mut unit.torque_constant,
            &mut unit.inertia,
            &mut unit.viscous,
            &mut unit.coulomb,
            &mut unit.stiction,
            &mut unit.stribeck_rate,
            &mut unit.encoder_noise_sd,
        ] {
            *figure *= 1.0 + share * rng.random_range(-1.0..=1.0);
        }
        unit.stiction = unit.stiction.max(unit.coulomb);
        for term in &mut unit.cogging {
            term.share *= 1.0 + share * rng.random_range(-1.0..=1.0);
            term.phase = rng.random_range(-PI..PI);
        }
        if let Some(cable) = &mut unit.cable {
            cable.stiffness *= 1.0 + share * rng.random_range(-1.0..=1.0);
        }
        unit.electrical_offset = rng.random_range(-PI..PI);
        unit
    }
}

/// Faults of motor, bridge, encoder and switch. The default is a sound unit.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct PlantFaults {
    /// The rotor is jammed: it stands, whatever the torque.
    pub stuck: bool,
    /// The bridge pulls its fault line and its outputs are off.
    pub driver_fault: bool,
    /// The encoder does not answer.
    pub encoder_silent: bool,
    /// The encoder repeats its last reading.
    pub encoder_frozen: bool,
    /// The encoder's readings are off by this many counts: a magnet that slipped.
    pub encoder_slip: u32,
    /// The home switch hangs on this side.
    pub home_stuck: Option<Side>,
    /// The two contacts of the home switch agree: a broken wire.
    pub home_broken: bool,
}

/// A motor with its load, bridge, encoder and home switch.
#[derive(Debug, Clone)]
pub struct Plant {
    config: PlantConfig,
    /// Faults to inject.
    pub faults: PlantFaults,
    /// Torque from outside, Nm: imbalance, the base's own angular acceleration times −J, a hand.
    pub load: f64,
    angle: f64,
    rate: f64,
    current: [f64; 2],
    duties: Option<[f64; 3]>,
    enabled: bool,
    side: Side,
    wound_past: bool,
    sent: AngleCounts,
    rng: ChaCha8Rng,
}

impl Plant {
    /// A rotor at rest at `angle`, the bridge enabled and its outputs off. The seed is that of the encoder's noise.
    pub fn new(config: PlantConfig, angle: f64, seed: u64) -> Self {
        let side = if angle < config.home_edge {
            Side::Below
        } else {
            Side::Above
        };
        Self {
            config,
            faults: PlantFaults::default(),
            load: 0.0,
            angle,
            rate: 0.0,
            current: [0.0; 2],
            duties: None,
            enabled: true,
            side,
            wound_past: false,
            sent: AngleCounts::default(),
            rng: ChaCha8Rng::seed_from_u64(seed),
        }
    }

    /// The figures it was made from.
    pub fn config(&self) -> &PlantConfig {
        &self.config
    }

    /// True angle α, rad, of as many turns as the rotor has made.
    pub fn angle(&self) -> f64 {
        self.angle
    }

    /// True rate, rad/s.
    pub fn rate(&self) -> f64 {
        self.rate
    }

    /// Current `i_q`, A.
    pub fn current(&self) -> f64 {
        self.current[1]
    }

    /// Gives the rotor a rate, rad/s: a coasting rotor at the start of a test.
    pub fn set_rate(&mut self, rate: f64) {
        self.rate = rate;
    }

    /// The bridge's enable line.
    pub fn set_enabled(&mut self, enabled: bool) {
        self.enabled = enabled;
    }

    /// Whether the bridge drives the motor.
    pub fn driven(&self) -> bool {
        self.enabled && !self.faults.driver_fault && self.duties.is_some()
    }

    /// Whether the cable was ever wound past what it bears.
    pub fn wound_past(&self) -> bool {
        self.wound_past
    }

    /// What the home switch reads: `None` where its contacts contradict each other.
    pub fn home(&self) -> Option<Side> {
        (!self.faults.home_broken).then_some(self.faults.home_stuck.unwrap_or(self.side))
    }

    /// The angle at the encoder's magnet, rad, before the encoder's own error: for a model of the encoder that adds
    /// error and resolution itself. Draws the noise.
    pub fn shaft_angle(&mut self) -> f64 {
        let noise: f64 = self.rng.sample(StandardNormal);
        self.angle + self.config.encoder_zero + noise * self.config.encoder_noise_sd
    }

    /// What the encoder reads now, with error, noise and resolution. `None`: no answer.
    pub fn encoder(&mut self) -> Option<AngleCounts> {
        if self.faults.encoder_silent {
            return None;
        }
        if !self.faults.encoder_frozen {
            let angle = self.shaft_angle();
            let mut reading = angle;
            for _ in 0..2 {
                // The slope of the error is about 3e-3: two turns leave 1e-8 rad.
                reading = angle
                    + self
                        .config
                        .encoder_harmonics
                        .iter()
                        .map(|(order, amplitude, phase)| amplitude * (f64::from(*order) * reading + phase).sin())
                        .sum::<f64>();
            }
            let counts = (reading.rem_euclid(TAU) / TAU * f64::from(COUNTS_PER_TURN)).round() as u32;
            self.sent = AngleCounts::new(counts.wrapping_add(self.faults.encoder_slip));
        }
        Some(self.sent)
    }

    /// Moves on by `dt` s.
    pub fn advance(&mut self, dt: f64) {
        let steps = (dt / SUB_STEP).ceil().max(1.0);
        for _ in 0..steps as u32 {
            self.step(dt / steps);
        }
    }

    fn step(&mut self, h: f64) {
        if self.faults.stuck {
            self.rate = 0.0;
        }
        let motor = self.motor_torque(h);
        let c = &self.config;
        let middle = self.angle + 0.5 * h * self.rate;
        let mut torque = motor + self.load;
        for term in &c.cogging {
            torque += c.rated_torque * term.share * (f64::from(term.order) * middle + term.phase).sin();
        }
        if let Some(cable) = c.cable {
            torque -= cable.stiffness * (middle - cable.rest);
            let over = middle - middle.clamp(cable.low, cable.high);
            if over != 0.0 {
                // Critically damped: a stop takes the blow up, it does not throw it back.
                let damping = 2.0 * (cable.stop_stiffness * c.inertia).sqrt();
                torque -= cable.stop_stiffness * over + damping * self.rate;
            }
        }
        let stribeck = (-(self.rate / c.stribeck_rate).powi(2)).exp();
        let friction = c.coulomb + (c.stiction - c.coulomb) * stribeck;
        // J (ω' − ω)/h = τ − b ω' − T sgn ω', solved for ω': a soft threshold.
        let free = self.rate + h * torque / c.inertia;
        let held = (free.abs() - h * friction / c.inertia).max(0.0);
        let rate = held.copysign(free) / (1.0 + h * c.viscous / c.inertia);
        if !self.faults.stuck {
            self.angle += 0.5 * h * (self.rate + rate);
            self.rate = rate;
        }
        if let Some(cable) = c.cable {
            self.wound_past |= !(cable.low..=cable.high).contains(&self.angle);
        }
        if self.angle > c.home_edge + 0.5 * c.home_hysteresis {
            self.side = Side::Above;
        } else if self.angle < c.home_edge - 0.5 * c.home_hysteresis {
            self.side = Side::Below;
        }
    }

    /// Mean torque of the motor over the next `h` s; the currents move on.
    fn motor_torque(&mut self, h: f64) -> f64 {
        let Some([a, b, c]) = self.duties.filter(|_| self.enabled && !self.faults.driver_fault) else {
            self.current = [0.0; 2];
            return 0.0;
        };
        let p = &self.config;
        let (b, c) = if p.swapped { (c, b) } else { (b, c) };
        // Clarke: what the three share does not reach the windings of a star.
        let v_alpha = p.supply * (2.0 * a - b - c) / 3.0;
        let v_beta = p.supply * (b - c) / (2.0 * FRAC_PI_3.sin());
        let pairs = f64::from(p.pole_pairs);
        let theta = pairs * (self.angle + p.encoder_zero) + p.electrical_offset;
        let (sin, cos) = theta.sin_cos();
        let v_d = v_alpha * cos + v_beta * sin;
        let v_q = v_beta * cos - v_alpha * sin;
        let speed = pairs * self.rate;
        let [i_d, i_q] = self.current;
        let flux = p.torque_constant / (1.5 * pairs);
        let x = h * p.resistance / p.inductance;
        let fade = -(-x).exp_m1();
        // Each winding towards its final current; the mean over the step drives the rotor.
        let lag = |i: f64, v: f64| {
            let end = v / p.resistance;
            (i + (end - i) * fade, end + (i - end) * fade / x)
        };
        let (d, _) = lag(i_d, v_d + speed * p.inductance * i_q);
        let (q, mean) = lag(i_q, v_q - speed * (p.inductance * i_d + flux));
        self.current = [d, q];
        p.torque_constant * mean
    }
}

impl ThreePhase for Plant {
    fn set_duties(&mut self, duties: [Duty; 3]) {
        let top = self.config.pwm_top;
        self.duties = Some(duties.map(|duty| f64::from(duty.compare(top)) / f64::from(top)));
    }

    fn outputs_off(&mut self) {
        self.duties = None;
    }
}

#[cfg(test)]
mod tests {
    use app::rotor::commutation::{PhaseOrder, duties};

    use super::*;

    /// A plant without friction, cogging and cable.
    fn bare(change: impl FnOnce(&mut PlantConfig)) -> Plant {
        let mut config = PlantConfig {
            viscous: 0.0,
            coulomb: 0.0,
            stiction: 0.0,
            cogging: Vec::new(),
            cable: None,
            pwm_top: u16::MAX,
            ..PlantConfig::default()
        };
        change(&mut config);
        Plant::new(config, 1.0, 0)
    }

    /// Puts (v_d, v_q) on the motor for `ms` milliseconds.
    fn drive(plant: &mut Plant, v_d: f32, v_q: f32, ms: u32) {
        for _ in 0..ms {
            let c = plant.config();
            let theta = f64::from(c.pole_pairs) * (plant.angle() + c.encoder_zero) + c.electrical_offset;
            let d = duties(v_d, v_q, theta as f32, c.supply as f32, PhaseOrder::Abc);
            plant.set_duties(d);
            plant.advance(1e-3);
        }
    }

    #[test]
    fn runs_up_to_the_back_emf() {
        let mut plant = bare(|_| ());
        drive(&mut plant, 0.0, 1.0, 3000);
        // ω = v_q/(N ψ) = 1.5 v_q/K_t, with time constant J R/(K_t N ψ) = 0.13 s. At 76 rad/s of electrical rate the
        // commutation is 38 mrad behind on the mean of a tick, and i_d bends the rest.
        let expected = 1.5 / 0.138;
        assert!(
            (plant.rate() / expected - 1.0).abs() < 5e-3,
            "{} {expected}",
            plant.rate()
        );
        assert!(plant.current().abs() < 0.01);
    }

    #[test]
    fn torque_against_a_load() {
        let mut plant = bare(|c| c.inertia = 1e9);
        drive(&mut plant, 0.0, 2.0, 20);
        assert!((plant.current() - 2.0 / 5.5).abs() < 1e-4);
        assert!((plant.rate() * 1e9 / (0.138 * 2.0 / 5.5) - (0.020 - 2.5e-3 / 5.5)).abs() < 1e-5);
    }

    /// Coulomb friction stops a coasting rotor after J ω/T and ω² J/2T, and holds it there.
    #[test]
    fn friction_stops_and_holds() {
        let mut plant = bare(|c| (c.coulomb, c.stiction) = (4e-3, 4e-3));
        plant.set_rate(2.0);
        let stop = 3e-4 * 2.0 / 4e-3;
        plant.advance(stop - 2e-3);
        assert!(plant.rate() > 0.0);
        plant.advance(4e-3);
        assert_eq!(plant.rate(), 0.0);
        assert!((plant.angle() - 1.0 - stop).abs() < 1e-3);
        let held = plant.angle();
        plant.load = 3.99e-3;
        plant.advance(0.1);
        assert_eq!(plant.angle(), held);
        plant.load = 4.2e-3;
        plant.advance(0.1);
        assert!((plant.angle() - held - 0.5 * 0.2e-3 / 3e-4 * 0.01).abs() < 1e-4);
    }

    /// Without losses energy is kept: a rotor swings in a well of the cogging for ever.
    #[test]
    fn cogging_keeps_energy() {
        let mut plant = bare(|c| {
            c.cogging = vec![Cogging {
                order: 84,
                share: 0.02,
                phase: PI - 84.0,
            }];
        });
        plant.angle += 0.2 / 84.0;
        let mut greatest = [0.0_f64; 2];
        for late in [0, 1] {
            for _ in 0..20_000 {
                plant.advance(250e-6);
                greatest[late] = greatest[late].max((plant.angle() - 1.0).abs());
            }
        }
        let [early, late] = greatest;
        assert!((late / early - 1.0).abs() < 1e-3, "{greatest:?}");
        assert!((early * 84.0 - 0.2).abs() < 1e-3);
    }

    #[test]
    fn off_is_off() {
        for cut in 0..3 {
            let mut plant = bare(|_| ());
            drive(&mut plant, 0.0, 3.0, 50);
            match cut {
                0 => plant.outputs_off(),
                1 => plant.set_enabled(false),
                _ => plant.faults.driver_fault = true,
            }
            assert!(!plant.driven());
            let rate = plant.rate();
            plant.advance(0.1);
            assert_eq!((plant.rate(), plant.current()), (rate, 0.0));
        }
    }

    #[test]
    fn cable_switch_and_stops() {
        let mut plant = Plant::new(PlantConfig::default(), 1.0, 0);
        assert_eq!(plant.home(), Some(Side::Below));
        let to = |plant: &mut Plant, angle: f64| {
            plant.angle = angle * DEG;
            plant.rate = 0.0;
            plant.advance(1e-3);
            (plant.home(), plant.wound_past())
        };
        assert_eq!(to(&mut plant, 180.2), (Some(Side::Below), false));
        assert_eq!(to(&mut plant, 180.3), (Some(Side::Above), false));
        assert_eq!(to(&mut plant, 179.8), (Some(Side::Above), false));
        assert_eq!(to(&mut plant, 374.9), (Some(Side::Above), false));
        assert_eq!(to(&mut plant, 375.1), (Some(Side::Above), true));
        assert_eq!(to(&mut plant, 100.0), (Some(Side::Below), true));
        plant.faults.home_stuck = Some(Side::Above);
        assert_eq!(plant.home(), Some(Side::Above));
        plant.faults.home_broken = true;
        assert_eq!(plant.home(), None);

        let mut plant = Plant::new(PlantConfig::default(), 374.0 * DEG, 0);
        if let Some(cable) = &mut plant.config.cable {
            cable.stop_stiffness = 50.0;
        }
        plant.load = 0.1;
        plant.advance(1.0);
        // 0.1 Nm less the cable's 3 mNm and the friction against 50 Nm/rad: 2 mrad.
        assert!(
            (375.0..375.12).contains(&(plant.angle() / DEG)),
            "{}",
            plant.angle() / DEG
        );
    }

    #[test]
    fn encoder_faults() {
        let mut plant = Plant::new(PlantConfig::default(), 1.0, 0);
        let before = plant.encoder().unwrap();
        plant.angle += 1.0;
        plant.faults.encoder_frozen = true;
        assert_eq!(plant.encoder(), Some(before));
        plant.faults = PlantFaults {
            encoder_slip: 1000,
            ..PlantFaults::default()
        };
        let moved = plant.encoder().unwrap().since(before);
        // 1 rad, the slip, the harmonics' 2 mrad, the noise.
        assert!((moved - 333_772 - 1000).abs() < 900, "{moved}");
        plant.faults.encoder_silent = true;
        assert_eq!(plant.encoder(), None);
    }

    #[test]
    fn a_seed_is_a_unit() {
        let config = PlantConfig::default();
        assert_eq!(config.varied(7, 0.2), config.varied(7, 0.2));
        assert_ne!(config.varied(7, 0.2), config.varied(8, 0.2));
        let unit = config.varied(9, 0.2);
        assert!((unit.inertia / config.inertia - 1.0).abs() <= 0.2);
        assert!(unit.stiction >= unit.coulomb);
        let run = || {
            let mut plant = Plant::new(unit.clone(), 0.5, 3);
            (0..50)
                .map(|_| (plant.advance(1e-3), plant.encoder()))
                .collect::<Vec<_>>()
        };
        assert_eq!(run(), run());
    }
}
