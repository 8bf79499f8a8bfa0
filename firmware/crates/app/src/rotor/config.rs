//! Figures of the rotor and its control.

use core::f32::consts::TAU;
use core::fmt;

use frames::units::DEG;
use nav::rotor::{RotorConfig, RotorError, Schedule};

use super::commutation::{LINEAR_RANGE, PhaseOrder};

const fn deg(x: f64) -> f32 {
    (x * DEG) as f32
}

/// The motor and its load.
///
/// | field | unit | zero means | sane value |
/// |---|---|---|---|
/// | `pole_pairs` | | refused | 7 |
/// | `phase_order` | | | found by trial on the first unit of a kind |
/// | `supply` | V | refused | 12 |
/// | `resistance` | Ω of a phase | refused | 5.5 |
/// | `torque_constant` | Nm per A of i_q | refused | 0.138 |
/// | `inertia` | kg m² | refused | 3e-4 |
/// | `coulomb` | Nm | learned from nothing | 4e-3 |
/// | `viscous` | Nm s/rad | none | 2e-4 |
/// | `voltage_limit` | V of phase amplitude | refused | rated current × resistance, ≤ 0.95 supply/√3 |
/// | `delay` | s | no phase advance | half a tick and the transport |
/// | `electrical_offset` | rad | phase A's axis is at reading zero; `None`: to be calibrated | from the settings |
///
/// Resistance, torque constant and inertia scale the loop's gain; 20 % off each is borne.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MotorConfig {
    /// Pole pairs N.
    pub pole_pairs: u8,
    /// Sense of the wiring.
    pub phase_order: PhaseOrder,
    /// Supply of the bridge, V.
    pub supply: f32,
    /// Resistance of a phase, Ω.
    pub resistance: f32,
    /// Torque constant, Nm per ampere of i_q. The back-EMF of a phase is 2/3 of it, V s/rad.
    pub torque_constant: f32,
    /// Moment of inertia of all that turns, kg m².
    pub inertia: f32,
    /// Coulomb friction to begin with, Nm.
    pub coulomb: f32,
    /// Viscous friction, Nm s/rad.
    pub viscous: f32,
    /// Greatest amplitude of a phase's voltage, V.
    pub voltage_limit: f32,
    /// From the encoder's reading to the middle of the voltage's effect, s.
    pub delay: f32,
    /// Electrical angle at encoder reading zero, rad.
    pub electrical_offset: Option<f32>,
}

impl Default for MotorConfig {
    /// A 12-slot, 14-pole gimbal motor of the 5208 class.
    fn default() -> Self {
        Self {
            pole_pairs: 7,
            phase_order: PhaseOrder::Abc,
            supply: 12.0,
            resistance: 5.5,
            torque_constant: 0.138,
            inertia: 3e-4,
            coulomb: 4e-3,
            viscous: 2e-4,
            voltage_limit: 5.0,
            delay: 6e-4,
            electrical_offset: None,
        }
    }
}

/// One set of gains of the loops.
///
/// | field | unit | zero means | sane value |
/// |---|---|---|---|
/// | `position` | rad/s | the position loop is open | a quarter of `rate` |
/// | `rate` | rad/s | refused | 240 firm, 100 quiet |
/// | `observer` | rad/s | refused | 1.7 to 2 times `rate` |
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Loops {
    /// Bandwidth of the position loop, rad/s.
    pub position: f32,
    /// Bandwidth of the rate loop, rad/s.
    pub rate: f32,
    /// Poles of the observer, rad/s.
    pub observer: f32,
}

/// The loops, in two sets of gains, and what is learned.
///
/// Bandwidth b makes of the encoder's white noise σ a rate of about σ √(b³ dt): 2 % of 20 °/s at the firm set for 20 µrad
/// at 1 kHz, 0.4 % at the quiet one. Disturbances want the firm set, and it is in force wherever they are not known:
/// outside the schedule, about the turn-arounds (stiction), and in all of the schedule until `legs` legs were learned.
///
/// | field | unit | zero means | sane value |
/// |---|---|---|---|
/// | `firm`, `quiet` | | | see [`Loops`] |
/// | `learning` | share of a pass | nothing is learned | 0.8; below 1 |
/// | `legs` | | quiet from the first leg | 2 |
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ControlConfig {
    /// Gains against disturbances.
    pub firm: Loops,
    /// Gains for the legs once their disturbances are known.
    pub quiet: Loops,
    /// Share of the remaining disturbance learned in one pass.
    pub learning: f32,
    /// Legs to be learned before the quiet set is trusted.
    pub legs: u8,
}

impl Default for ControlConfig {
    fn default() -> Self {
        Self {
            firm: Loops {
                position: 60.0,
                rate: 240.0,
                observer: 400.0,
            },
            quiet: Loops {
                position: 25.0,
                rate: 100.0,
                observer: 200.0,
            },
            learning: 0.8,
            legs: 2,
        }
    }
}

/// What limits the rotor and tells it which turn it is in.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Homing {
    /// A cable and a switch. See the [module](super).
    HomeSwitch(HomeSwitch),
    /// No cable, no limit: the absolute encoder says it all.
    SlipRing,
}

/// A cable's travel and the switch in its middle.
///
/// | field | unit | zero means | sane value |
/// |---|---|---|---|
/// | `edge` | rad | refused | half of the travel |
/// | `tolerance` | rad | refused | 10°: hysteresis, play, mounting; far below 180° |
/// | `rate` | rad/s | refused | 15 °/s |
/// | `soft` | rad | set-points keep to the schedule's travel | 3° |
/// | `hard` | rad | refused | 6° |
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct HomeSwitch {
    /// Angle at which the switch changes, rad.
    pub edge: f32,
    /// By how much the edge may be elsewhere, rad.
    pub tolerance: f32,
    /// Rate of the search, rad/s.
    pub rate: f32,
    /// Beyond the schedule's travel by more than this no set-point goes, rad.
    pub soft: f32,
    /// Beyond the schedule's travel by more than this the outputs go off, rad. The cable must bear this, the coasting,
    /// and the slack of the calibration.
    pub hard: f32,
}

impl Default for HomeSwitch {
    fn default() -> Self {
        Self {
            edge: deg(180.0),
            tolerance: deg(10.0),
            rate: deg(15.0),
            soft: deg(3.0),
            hard: deg(6.0),
        }
    }
}

/// When to give up.
///
/// | field | unit | zero means | sane value |
/// |---|---|---|---|
/// | `following` | rad | refused | 2° |
/// | `overspeed` | rad/s | refused | 3 × the schedule's rate |
/// | `stall_us` | µs | a fault at the first tick at the limit | 50 000 |
/// | `jump` | rad | refused | 0.5°: a reading further from its prediction is bad |
/// | `bad_readings` | | refused | 3 |
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Limits {
    /// Greatest distance from the set-point, rad.
    pub following: f32,
    /// Greatest rate, rad/s.
    pub overspeed: f32,
    /// Longest time at the voltage limit without motion, µs.
    pub stall_us: u32,
    /// Greatest distance of a reading from its prediction, rad.
    pub jump: f32,
    /// Bad readings in a row that make a fault.
    pub bad_readings: u8,
}

impl Default for Limits {
    fn default() -> Self {
        Self {
            following: deg(2.0),
            overspeed: deg(60.0),
            stall_us: 50_000,
            jump: deg(0.5),
            bad_readings: 3,
        }
    }
}

/// Finding the electrical offset.
///
/// | field | unit | zero means | sane value |
/// |---|---|---|---|
/// | `voltage` | V | refused | ten times the friction's torque: 2.5 |
/// | `rate` | rad/s | refused | 25 °/s |
/// | `slack` | rad | refused | 8°; below half an electrical cycle |
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CalibrationConfig {
    /// Amplitude of the turning field's voltage, V.
    pub voltage: f32,
    /// Rate of the rotor behind the field, rad/s.
    pub rate: f32,
    /// How far the rotor may be from where the field should hold it, rad.
    pub slack: f32,
}

impl Default for CalibrationConfig {
    fn default() -> Self {
        Self {
            voltage: 2.5,
            rate: deg(25.0),
            slack: deg(8.0),
        }
    }
}

/// Configuration of the rotor's control.
///
/// | field | unit | zero means | sane value |
/// |---|---|---|---|
/// | `dt_us` | µs | refused | 1000, 500 |
/// | `encoder_zero` | rad | α is the reading | from the unit's calibration: it goes straight into heading |
///
/// The rest are tables of their own.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Config {
    /// Period of the ticks, µs.
    pub dt_us: u32,
    /// Corrected reading of the encoder at α = 0, rad.
    pub encoder_zero: f32,
    /// The reciprocation.
    pub schedule: RotorConfig,
    /// Motor and load.
    pub motor: MotorConfig,
    /// The loops.
    pub control: ControlConfig,
    /// Cable or slip ring.
    pub homing: Homing,
    /// When to give up.
    pub limits: Limits,
    /// Finding the electrical offset.
    pub calibration: CalibrationConfig,
}

impl Default for Config {
    fn default() -> Self {
        Self {
            dt_us: 1000,
            encoder_zero: 0.0,
            schedule: RotorConfig::default(),
            motor: MotorConfig::default(),
            control: ControlConfig::default(),
            homing: Homing::HomeSwitch(HomeSwitch::default()),
            limits: Limits::default(),
            calibration: CalibrationConfig::default(),
        }
    }
}

/// Why figures are refused.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum ConfigError {
    /// The schedule is impossible.
    Schedule(RotorError),
    /// The schedule stands still, or lasts longer than an hour, or its travel is too short to enter it from any angle:
    /// twice rate²/acceleration are needed.
    NoMotion,
    /// A figure of this name is negative, not finite, or zero where that is refused.
    NotPositive(&'static str),
    /// A voltage is above what the supply gives, or the calibration's above the limit.
    Voltage,
    /// The loops are too fast for the tick or for each other: observer × dt must be below 1, rate below the observer,
    /// position below the rate.
    TooFast,
    /// The calibration's slack is half an electrical cycle or more: a wrong direction would go unseen.
    Slack,
    /// Edge, margins and travel of the home switch do not fit: the edge must be inside, nowhere a full turn or more
    /// from an end, with room for an electrical cycle on both sides; soft must be below hard.
    HomeSwitch,
}

impl fmt::Display for ConfigError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Schedule(error) => error.fmt(f),
            Self::NoMotion => f.write_str("the schedule has no motion, or no room for its ramps"),
            Self::NotPositive(name) => write!(f, "{name} must be positive and finite"),
            Self::Voltage => f.write_str("voltage limit, calibration voltage and supply do not fit"),
            Self::TooFast => f.write_str("the control is too fast for the tick: lower rate and observer"),
            Self::Slack => f.write_str("calibration slack must be below half an electrical cycle"),
            Self::HomeSwitch => f.write_str("edge, margins and travel of the home switch do not fit"),
        }
    }
}

impl core::error::Error for ConfigError {}

impl Config {
    /// Checks the figures.
    ///
    /// # Errors
    /// [`ConfigError`]: the first that is wrong.
    pub fn validate(&self) -> Result<Schedule, ConfigError> {
        let schedule = Schedule::new(self.schedule).map_err(ConfigError::Schedule)?;
        let RotorConfig {
            rate,
            travel,
            acceleration,
        } = self.schedule;
        // An hour of microseconds fits into u32 with room for the sum of two.
        if rate == 0.0 || schedule.period() > 3600.0 || travel < 2.0 * rate * rate / acceleration {
            return Err(ConfigError::NoMotion);
        }
        let (m, c, l, k) = (&self.motor, &self.control, &self.limits, &self.calibration);
        let positive = |x: f32| x.is_finite() && x > 0.0;
        let not_negative = |x: f32| x.is_finite() && x >= 0.0;
        for (good, name) in [
            (self.dt_us > 0 && self.dt_us <= 10_000, "dt_us"),
            (self.encoder_zero.is_finite(), "encoder_zero"),
            (m.pole_pairs > 0, "pole_pairs"),
            (positive(m.supply), "supply"),
            (positive(m.resistance), "resistance"),
            (positive(m.torque_constant), "torque_constant"),
            (positive(m.inertia), "inertia"),
            (not_negative(m.coulomb), "coulomb"),
            (not_negative(m.viscous), "viscous"),
            (positive(m.voltage_limit), "voltage_limit"),
            (not_negative(m.delay), "delay"),
            (m.electrical_offset.is_none_or(f32::is_finite), "electrical_offset"),
            (not_negative(c.firm.position.min(c.quiet.position)), "position"),
            (positive(c.firm.rate.min(c.quiet.rate)), "rate"),
            (positive(c.firm.observer.min(c.quiet.observer)), "observer"),
            (not_negative(c.learning) && c.learning < 1.0, "learning"),
            (positive(l.following), "following"),
            (positive(l.overspeed), "overspeed"),
            (positive(l.jump), "jump"),
            (l.bad_readings > 0, "bad_readings"),
            (positive(k.voltage), "calibration voltage"),
            (positive(k.rate), "calibration rate"),
            (positive(k.slack), "slack"),
        ] {
            if !good {
                return Err(ConfigError::NotPositive(name));
            }
        }
        if m.voltage_limit > 0.95 * LINEAR_RANGE * m.supply || k.voltage > m.voltage_limit {
            return Err(ConfigError::Voltage);
        }
        for loops in [c.firm, c.quiet] {
            if loops.observer * self.dt() >= 1.0 || loops.rate >= loops.observer || loops.position > loops.rate {
                return Err(ConfigError::TooFast);
            }
        }
        let cycle = TAU / f32::from(m.pole_pairs);
        if k.slack >= 0.5 * cycle {
            return Err(ConfigError::Slack);
        }
        if let Homing::HomeSwitch(h) = self.homing {
            let all = [h.edge, h.tolerance, h.rate, h.hard];
            let (below, above) = (h.edge + h.hard, travel - h.edge + h.hard);
            let room = cycle + k.slack;
            if !(all.into_iter().all(positive) && not_negative(h.soft))
                || h.soft >= h.hard
                || h.tolerance >= 0.25 * TAU
                || !(room + h.tolerance..TAU).contains(&below)
                || !(room + h.tolerance..TAU).contains(&above)
            {
                return Err(ConfigError::HomeSwitch);
            }
        }
        Ok(schedule)
    }

    /// Period of the ticks, s.
    pub fn dt(&self) -> f32 {
        self.dt_us as f32 * 1e-6
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn refused(change: impl FnOnce(&mut Config)) -> ConfigError {
        let mut config = Config::default();
        change(&mut config);
        config.validate().unwrap_err()
    }

    #[test]
    fn the_default_is_sane() {
        assert!(Config::default().validate().is_ok());
        let slip_ring = Config {
            homing: Homing::SlipRing,
            ..Config::default()
        };
        assert!(slip_ring.validate().is_ok());
    }

    #[test]
    fn wrong_figures_are_named() {
        use ConfigError::{NoMotion, NotPositive, Schedule, Slack, TooFast, Voltage};
        assert_eq!(refused(|c| c.schedule.rate = 0.0), NoMotion);
        assert_eq!(refused(|c| c.schedule.rate = -1.0), Schedule(RotorError::NotPositive));
        assert_eq!(refused(|c| c.schedule.travel = deg(3.0)), NoMotion);
        assert_eq!(refused(|c| c.schedule.rate = deg(0.05)), NoMotion);
        assert_eq!(refused(|c| c.dt_us = 0), NotPositive("dt_us"));
        assert_eq!(refused(|c| c.motor.inertia = f32::NAN), NotPositive("inertia"));
        assert_eq!(
            refused(|c| c.motor.electrical_offset = Some(f32::NAN)),
            NotPositive("electrical_offset")
        );
        assert_eq!(refused(|c| c.motor.voltage_limit = 6.8), Voltage);
        assert_eq!(refused(|c| c.calibration.voltage = 5.1), Voltage);
        assert_eq!(refused(|c| c.control.firm.observer = 1000.0), TooFast);
        assert_eq!(refused(|c| c.control.quiet.rate = 400.0), TooFast);
        assert_eq!(refused(|c| c.calibration.slack = deg(26.0)), Slack);
        let switch = |f: &dyn Fn(&mut HomeSwitch)| {
            refused(|c| {
                let mut h = HomeSwitch::default();
                f(&mut h);
                c.homing = Homing::HomeSwitch(h);
            })
        };
        assert_eq!(switch(&|h| h.edge = deg(30.0)), ConfigError::HomeSwitch);
        assert_eq!(switch(&|h| h.edge = deg(359.0)), ConfigError::HomeSwitch);
        assert_eq!(switch(&|h| h.soft = h.hard), ConfigError::HomeSwitch);
        assert_eq!(switch(&|h| h.tolerance = deg(90.0)), ConfigError::HomeSwitch);
        assert_eq!(switch(&|h| h.rate = 0.0), ConfigError::HomeSwitch);
        assert_eq!(
            refused(|c| {
                c.schedule.travel = deg(720.0);
                c.homing = Homing::HomeSwitch(HomeSwitch {
                    edge: deg(360.0),
                    ..HomeSwitch::default()
                });
            }),
            ConfigError::HomeSwitch
        );
    }
}
