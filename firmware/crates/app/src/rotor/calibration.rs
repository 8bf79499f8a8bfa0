//! Finding the electrical offset with an open-loop field, without leaving the place by more than the slack.
//!
//! ```text
//! Rest   outputs off until a coasting rotor has stopped
//! Probe  a field turning at 40 Hz, forwards then backwards, just strong enough to make the rotor tremble:
//!        the phase of the trembling tells where the magnets are, to some tens of electrical degrees
//! Align  the field stands there and grows: the rotor slips into it, less than the slack away
//! Sweep  the field turns by one electrical cycle and back, the rotor behind it
//! ```
//!
//! A field switched on anywhere would pull the rotor by up to half an electrical cycle (26° with 7 pole pairs) either
//! way, next to the end of a cable too. Hence the probe. A rotor driven by the torque `sin(ψ)` trembles as
//! `sin(ψ − λ)`, λ between 90° (friction) and 180° (inertia); the error of taking it for 135° has opposite signs in the
//! two directions of turning and drops out of their mean.
//!
//! Trembling, the rotor gives way to a cable's pull, and a rotor that slides may deceive the probe. Where it has strayed
//! by the slack towards the middle of the travel, all begins anew; outwards it is a fault.
//!
//! The offset is the mean of field angle − N · reading over the sweep: friction holds the rotor back by the same angle
//! in both directions, and cogging is over in a cycle. The sweep goes away from the nearer end of the travel and comes
//! back. It shows the direction, the pole pairs, and that the rotor is free.

use core::f32::consts::{FRAC_PI_4, PI, TAU};
use core::ops::ControlFlow;

use frames::math;
use nav::rotor::{RotorConfig, Schedule};

use super::config::Config;
use super::fault::RotorFault;
use super::motion::seconds;
use super::shaft::Shaft;

/// Below this the rotor is at rest, rad/s (1 °/s: five times the noise of the observer's rate).
pub(super) const REST_RATE: f32 = 0.0175;
/// For how long, µs.
const REST_US: u32 = 100_000;
/// Longest wait for it, µs.
const REST_TIMEOUT_US: u32 = 3_000_000;
/// Period of the probing field, µs.
const PROBE_US: u32 = 25_000;
/// Smallest amplitude of the trembling that is accepted, rad: 25 times the noise of the encoder.
const TREMBLE: f32 = 5e-4;
/// Cycles averaged in each direction, after one that is not.
const PROBE_CYCLES: u8 = 3;
/// How often it begins anew.
const TRIES: u8 = 8;
/// Steps of the probe's voltage up to that of the calibration, one a cycle.
const PROBE_STEPS: f32 = 40.0;
/// λ, rad.
const PROBE_LAG: f32 = 3.0 * FRAC_PI_4;
/// Growth of the aligning voltage, µs.
const ALIGN_US: u32 = 500_000;

/// Waits until the rotor has been slow for a while.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
struct Rest {
    still_us: u32,
    waited_us: u32,
}

impl Rest {
    fn over(&mut self, rate: f32, dt_us: u32) -> Result<bool, RotorFault> {
        self.waited_us += dt_us;
        self.still_us = if rate.abs() < REST_RATE {
            self.still_us + dt_us
        } else {
            0
        };
        if self.still_us >= REST_US {
            Ok(true)
        } else if self.waited_us >= REST_TIMEOUT_US {
            Err(RotorFault::Unsettled { rate })
        } else {
            Ok(false)
        }
    }
}

/// The trembling of one direction of turning.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Probe {
    volts: f32,
    sample: u16,
    cycle: u8,
    /// Angle at the start of the probe.
    origin: f32,
    /// Angle at the start of this cycle.
    first: f32,
    /// Sine and cosine parts of this cycle.
    part: [f32; 2],
    /// Of the cycles so far.
    sum: [f32; 2],
    /// What the forward direction said, a unit vector of the electrical angle; `None` while it is under way.
    forward: Option<[f32; 2]>,
}

#[derive(Debug, Clone, Copy, PartialEq)]
enum Phase {
    Rest(Rest),
    Probe(Probe),
    Align {
        field: f32,
        origin: f32,
        t_us: u32,
        rest: Rest,
    },
    Sweep {
        field: f32,
        origin: f32,
        t_us: u32,
        schedule: Schedule,
        first: f32,
        sum: f32,
        ticks: u32,
    },
}

/// A calibration under way.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Calibration {
    phase: Phase,
    /// Which way the sweep goes.
    way: f32,
    /// Times it has begun anew.
    tries: u8,
}

/// What a calibration wants of this tick.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Field {
    /// Nothing: outputs off.
    Off,
    /// A voltage along an electrical angle.
    On { volts: f32, angle: f32 },
    /// It is over: the electrical angle at reading zero.
    Found { offset: f32 },
}

impl Calibration {
    pub(super) fn new(way: f32) -> Self {
        Self {
            phase: Phase::Rest(Rest::default()),
            way,
            tries: 0,
        }
    }

    /// Begins anew where the rotor has strayed to, if that is away from the nearer end and was not too often.
    fn again(&mut self, moved: f32, fault: RotorFault) -> Result<Field, RotorFault> {
        if moved * self.way <= 0.0 || self.tries >= TRIES {
            return Err(fault);
        }
        self.tries += 1;
        self.phase = Phase::Rest(Rest::default());
        Ok(Field::Off)
    }

    pub(super) fn step(&mut self, shaft: &Shaft, config: &Config) -> Result<Field, RotorFault> {
        let c = &config.calibration;
        let pairs = f32::from(config.motor.pole_pairs);
        match &mut self.phase {
            Phase::Rest(rest) => {
                if rest.over(shaft.rate, config.dt_us)? {
                    self.phase = Phase::Probe(Probe::new(shaft.angle, c.voltage / PROBE_STEPS));
                }
                Ok(Field::Off)
            }
            Phase::Probe(probe) if (shaft.angle - probe.origin).abs() > c.slack => {
                let moved = shaft.angle - probe.origin;
                self.again(moved, RotorFault::Following { error: -moved })
            }
            Phase::Probe(probe) => match probe.step(shaft.angle, config)? {
                ControlFlow::Continue(field) => Ok(field),
                ControlFlow::Break(angle) => {
                    self.phase = Phase::Align {
                        field: angle,
                        origin: shaft.angle,
                        t_us: 0,
                        rest: Rest::default(),
                    };
                    Ok(Field::Off)
                }
            },
            Phase::Align {
                field,
                origin,
                t_us,
                rest,
            } => {
                let moved = shaft.angle - *origin;
                // The probe cannot be that wrong, unless what it took for forwards was backwards: then the rotor is
                // at the field's unstable angle and leaves it at a run.
                if moved.abs() > c.slack || shaft.rate.abs() > config.limits.overspeed {
                    return self.again(moved, RotorFault::WrongDirection { moved });
                }
                *t_us += config.dt_us;
                let grown = (seconds(*t_us) / seconds(ALIGN_US)).min(1.0);
                let angle = *field;
                if grown >= 1.0 && rest.over(shaft.rate, config.dt_us)? {
                    self.phase = Self::sweep(angle, shaft, config);
                }
                Ok(Field::On {
                    volts: c.voltage * grown,
                    angle,
                })
            }
            Phase::Sweep {
                field,
                origin,
                t_us,
                schedule,
                first,
                sum,
                ticks,
            } => {
                let t = seconds(*t_us);
                let half = 0.5 * schedule.period();
                let swept = self.way * schedule.at(t).angle;
                let moved = shaft.angle - *origin;
                if (moved - swept).abs() > c.slack {
                    return Err(misled(moved, swept, config.motor.pole_pairs));
                }
                *t_us += config.dt_us;
                // At the far end one more pole pair than configured would show as 1/N less travel.
                let far_end = t < half && seconds(*t_us) >= half;
                if far_end && (moved - swept).abs() * pairs > 0.45 * swept.abs() {
                    return Err(misled(moved, swept, config.motor.pole_pairs));
                }
                let angle = *field + pairs * swept;
                *sum += math::wrap_pi(angle - pairs * shaft.shaft() - *first);
                *ticks += 1;
                if seconds(*t_us) >= 2.0 * half {
                    return Ok(Field::Found {
                        offset: math::wrap_pi(*first + *sum / *ticks as f32),
                    });
                }
                Ok(Field::On {
                    volts: c.voltage,
                    angle,
                })
            }
        }
    }

    fn sweep(field: f32, shaft: &Shaft, config: &Config) -> Phase {
        let pairs = f32::from(config.motor.pole_pairs);
        let rate = config.calibration.rate;
        let travel = TAU / pairs;
        // A quarter of the way to speed up, a quarter to slow down.
        let schedule = Schedule::new(RotorConfig {
            rate,
            travel,
            acceleration: 2.0 * rate * rate / travel,
        });
        match schedule {
            Ok(schedule) => Phase::Sweep {
                field,
                origin: shaft.angle,
                t_us: 0,
                schedule,
                first: math::wrap_pi(field - pairs * shaft.shaft()),
                sum: 0.0,
                ticks: 0,
            },
            // Checked figures cannot come here; waiting runs into its timeout.
            Err(_) => Phase::Rest(Rest::default()),
        }
    }
}

/// The fault of a rotor that has not followed the field.
fn misled(moved: f32, swept: f32, expected: u8) -> RotorFault {
    let ratio = moved / swept;
    // Gone at a run as soon as the field turned: friction had held the rotor at the field's unstable angle.
    if !(-0.25..=3.0).contains(&ratio) {
        RotorFault::WrongDirection { moved }
    } else if ratio < 0.25 {
        RotorFault::NoMovement { moved }
    } else {
        RotorFault::PolePairs {
            expected,
            measured: f32::from(expected) / ratio,
        }
    }
}

impl Probe {
    fn new(angle: f32, volts: f32) -> Self {
        Self {
            volts,
            sample: 0,
            cycle: 0,
            origin: angle,
            first: angle,
            part: [0.0; 2],
            sum: [0.0; 2],
            forward: None,
        }
    }

    /// The field of this tick; breaks with the rotor's electrical angle once it is known.
    fn step(&mut self, angle: f32, config: &Config) -> Result<ControlFlow<f32, Field>, RotorFault> {
        let samples = (PROBE_US / config.dt_us).max(8) as u16;
        let voltage = config.calibration.voltage;
        if self.sample == samples {
            let drift = angle - self.first;
            // Fourier parts; a steady drift over the cycle has the sine part −drift/π.
            let scale = 2.0 / f32::from(samples);
            let [sin, cos] = [self.part[0] * scale + drift / PI, self.part[1] * scale];
            if math::hypot(sin, cos) < TREMBLE {
                self.volts += voltage / PROBE_STEPS;
                (self.cycle, self.sum) = (0, [0.0; 2]);
            } else {
                if self.cycle > 0 {
                    self.sum = [self.sum[0] + sin, self.sum[1] + cos];
                }
                self.cycle += 1;
            }
            if self.cycle > PROBE_CYCLES {
                let [sin, cos] = self.sum;
                // Forwards sin(Ωt − θ − λ), backwards sin(Ωt + θ + 180° − λ).
                let found = match self.forward {
                    None => math::atan2(-cos, sin) - PROBE_LAG,
                    Some(_) => math::atan2(cos, sin) - PI + PROBE_LAG,
                };
                let (sin, cos) = math::sin_cos(found);
                if let Some([x, y]) = self.forward {
                    return Ok(ControlFlow::Break(math::atan2(y + sin, x + cos)));
                }
                *self = Self {
                    origin: self.origin,
                    forward: Some([cos, sin]),
                    ..Self::new(angle, voltage / PROBE_STEPS)
                };
            }
            if self.volts > voltage {
                return Err(RotorFault::NoMovement {
                    moved: math::hypot(sin, cos),
                });
            }
            self.sample = 0;
            self.first = angle;
            self.part = [0.0; 2];
        }
        let phase = TAU * f32::from(self.sample) / f32::from(samples);
        let (sin, cos) = math::sin_cos(phase);
        let off = angle - self.first;
        self.part = [self.part[0] + off * sin, self.part[1] + off * cos];
        self.sample += 1;
        Ok(ControlFlow::Continue(Field::On {
            volts: self.volts,
            angle: if self.forward.is_some() { -phase } else { phase },
        }))
    }
}
