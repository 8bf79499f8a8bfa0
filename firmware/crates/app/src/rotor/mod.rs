//! The rotor: field-oriented control of its motor, calibration, homing, limits.
//!
//! [`Rotor::tick`] is one period of the motor's loop: readings in, duties out. It is synchronous and pure; it knows no
//! clock and no hardware. [`Rotor::command`] asks for something else between two ticks.
//!
//! ```text
//! Schedule ─► set-point (α_r, ω_r, a_r)
//!                │
//!                ▼                                               known: friction, ripple learned
//! ω_c = ω_r + k_α (α_r − α)      a = a_r + k_ω (ω_c − ω) − d      τ = J a + τ_known(θ, ω_r)
//! v_q = τ R/K_t + 2/3 K_t ω_r,   limited                          θ_e = N (reading + ω·delay) + offset
//! duties(0, v_q, θ_e)            observer: (α, ω, d) ◄─ reading, and a + what the limit took away
//! ```
//!
//! `d`, the acceleration the model does not explain, stands in the place of an integrator. It does not wind up: the
//! observer gets the voltage that was applied, not the requested one.
//!
//! # Which turn is it? The cable and the home switch
//!
//! The encoder is absolute within a turn. A cable's travel is 360° and the margins, so after a reset there are angles
//! that may lie at either end; to turn the wrong way from there tears the cable. The switch must tell, *before*
//! anything turns, on which side of the middle the rotor is, over all of the travel:
//!
//! ```text
//!   α  −15°     −6°  0°                 180°                 360° 366°    375°
//!       ├────────┼───┼────────────────────┼────────────────────┼───┼────────┤
//!     cable    hard        Side::Below    │     Side::Above         hard   cable
//!              limit  search ────────────►│◄──────────── search     limit
//!                                        edge
//! ```
//!
//! A vane on the rotor cannot do that: it reads the same at −10° and at 350°. Assumed is one of
//!
//! ```text
//!      rotor seen from above, at 180°
//!            ╭───────╮
//!            │   ●   │    lever on the housing, held at either side by a spring over its dead centre (or by a magnet);
//!            │       ├─▪  the pin ▪ on the rotor trips it to "Above" on the way up and to "Below" on the way down.
//!            ╰───────╯ ╲  It meets the pin nowhere else, because no end is a full turn away from the edge.
//!                       ╲__ change-over contact: two lines, one always high, the other low
//! ```
//!
//! * such a lever, or
//! * a cam geared down 2 : 1 or more, or a follower in a spiral groove, with a plain switch;
//! * a plain vane only where hard limit to hard limit is less than a turn.
//!
//! So every motion without a known turn starts away from the nearer end: the calibration's sweep and the search. The
//! search stops at the edge and must find it where the encoder expects it, to within `tolerance`; the zero of α itself
//! is the encoder's alone. Once the turn is known, angle and switch watch each other. A reset loses the turn, never the
//! encoder's zero nor (kept in the settings) the electrical offset.
//!
//! A switch that hangs: the side and the encoder together leave one angle, or none, and then nothing moves
//! ([`RotorFault::HomeMismatch`]). The search goes no further than from that angle to the edge. What is left is a switch
//! that hangs on the wrong side while the rotor is in the overlap of the turns, `hard` + `tolerance` about the ends: it
//! can be told from a good one by its wiring only. Therefore the contact should change over, both lines read; equal
//! levels are `None`, and nothing moves.
//!
//! # States
//!
//! ```text
//! Off ── Calibrate ─► Calibrating ─► Off, offset known        any ── Off ─► Off
//!  │ ─── Home ──────► Homing ──────► Off, turn known          any but Off ── fault ─► Fault ── Clear ─► Off
//!  │ ─── Run ───────► Running ── Stop ─► Stopping ─► Off
//!  └ ─── MoveTo ────► Running ─────────► Stopping ─► Off
//! ```
//!
//! Outputs are off in `Off` and `Fault`, and in the very tick a fault is found. The angle is followed in every state,
//! so the turn survives `Off` as long as the encoder answers.
//!
//! After [`RotorFault::Travel`] the way back is `Clear`, `Home`: the search goes inwards, whatever the turn.
//!
//! # Figures and cost
//!
//! `hal-sim/tests/rotor.rs` holds the figures: over 20 units off by up to ±20 %, with a cogging of 2 % of the rated torque
//! and 20 µrad of encoder noise at 1 kHz, the rate's ripple in the legs is 0.9 % RMS at worst in the third cycle and
//! 0.7 % later (2.2 % in the first one, in which the table is learned), the angle within 0.1° of its set-point, a
//! turn-around over in 0.24 s.
//!
//! A tick in a leg takes 930 instructions (thumbv7em, opt-level 3, counted by an emulator): less than 10 µs at 168 MHz.
//!
//! Not modelled: current limits other than by the voltage; field weakening; temperature of the winding; a supply that
//! varies (its ratio is a gain of the loop).

mod calibration;
pub mod commutation;
mod config;
mod fault;
mod homing;
mod motion;
mod ripple;
mod shaft;
#[cfg(test)]
mod tests;

use core::f32::consts::{PI, TAU};

use drivers::motor::Duty;
use frames::math;
use nav::rotor::{RotorState, Schedule};

pub use calibration::Calibration;
pub use commutation::PhaseOrder;
pub use config::{
    CalibrationConfig, Config, ConfigError, ControlConfig, HomeSwitch, Homing, Limits, Loops, MotorConfig,
};
pub use fault::{Refused, RotorFault};
pub use homing::Search;
pub use ripple::{CELLS, Ripple};

use calibration::{Field, REST_RATE};
use homing::{Debounced, Found};
use motion::{Cycle, Move, Ramp};
use shaft::{SLOW, Sense, Shaft};

/// The most a cell of the ripple table may hold, as a share of the torque at the voltage limit.
const RIPPLE_SHARE: f32 = 0.25;
/// Time in which the friction fed forward follows what is learned, s.
const FRICTION_TIME: f32 = 2.0;
/// How long after a turn-around the firm gains stay, µs: stiction is over after a tenth of a second.
const FIRM_US: u32 = 150_000;
/// How long after a turn-around nothing is learned, µs.
const SETTLE_US: u32 = 30_000;
/// Legs learned at the full gain; after them it falls as 1/n to a tenth.
const FAST_LEGS: f32 = 4.0;
/// How long the set-point is held after a stop before the outputs go off, µs.
const STOP_US: u32 = 100_000;

/// The side of the home switch's edge the rotor is on.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Side {
    /// At an angle less than the edge's.
    Below,
    /// At a greater one.
    Above,
}

/// Inputs of a tick.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Inputs {
    /// Corrected reading of the encoder in [0, 2π), rad. `None` for one that failed.
    pub reading: Option<f32>,
    /// The home switch; `None` where its contacts contradict each other. Without meaning for a slip ring.
    pub home: Option<Side>,
    /// The bridge's fault line.
    pub driver_fault: bool,
}

/// What a tick asks for.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Outputs {
    /// Duties to be set now. `None`: outputs and bridge off.
    pub drive: Option<[Duty; 3]>,
    /// The angle α, rad, once the turn is known.
    pub angle: Option<f32>,
    /// The rate, rad/s.
    pub rate: f32,
    /// What the rotor should be doing, in closed loop.
    pub set_point: Option<RotorState>,
    /// Voltage v_q, V, in closed loop; else zero.
    pub voltage: f32,
}

/// What the rotor is asked to do.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Command {
    /// Find the electrical offset.
    Calibrate,
    /// Find the turn.
    Home,
    /// Follow the schedule, from wherever the rotor is.
    Run,
    /// Go to this angle, rad, and switch off there.
    MoveTo(f32),
    /// Come to rest in a controlled way, then switch off.
    Stop,
    /// Switch off at once; a rotor that turns coasts.
    Off,
    /// Forget the fault.
    Clear,
}

#[derive(Debug, Clone, Copy, PartialEq)]
enum Goal {
    Schedule,
    Angle(f32),
}

#[derive(Debug, Clone, Copy, PartialEq)]
enum Motion {
    /// Bringing a coasting rotor to rest.
    Halt(Ramp),
    Move(Move),
    Cycle(Cycle),
}

/// A motion in closed loop.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Run {
    goal: Goal,
    motion: Motion,
}

impl Run {
    /// Whether the rotor follows the schedule, and not some way to it.
    pub fn on_schedule(&self) -> bool {
        matches!(self.motion, Motion::Cycle(_))
    }
}

/// A controlled stop.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Stop {
    ramp: Ramp,
    held_us: u32,
}

/// What the rotor is doing.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum State {
    /// Outputs off.
    Off,
    /// Finding the electrical offset.
    Calibrating(Calibration),
    /// Finding the turn.
    Homing(Search),
    /// Following the schedule, or on the way to it or to an angle.
    Running(Run),
    /// Coming to rest.
    Stopping(Stop),
    /// Outputs off until cleared.
    Fault(RotorFault),
}

/// The rotor's control. About 4.5 kB, most of it the ripple table: build it in a static.
#[derive(Debug, Clone)]
pub struct Rotor {
    config: Config,
    schedule: Schedule,
    state: State,
    shaft: Shaft,
    home: Debounced,
    offset: Option<f32>,
    homed: bool,
    ripple: Ripple,
    /// Acceleration put in over the last period, as far as the model goes, rad/s².
    push: f32,
    /// Time in this leg, µs.
    leg_us: u32,
    /// Legs learned.
    legs: u8,
    set_point: Option<RotorState>,
    voltage: f32,
    stalled_us: u32,
}

impl Rotor {
    /// A rotor that is off, its turn unknown.
    ///
    /// # Errors
    /// [`ConfigError`].
    pub fn new(config: Config) -> Result<Self, ConfigError> {
        let schedule = config.validate()?;
        let m = &config.motor;
        let most = m.voltage_limit / m.resistance * m.torque_constant;
        Ok(Self {
            schedule,
            state: State::Off,
            shaft: Shaft::new(
                config.encoder_zero,
                config.dt(),
                [config.control.firm.observer, config.control.quiet.observer],
                config.limits.jump,
                config.limits.bad_readings,
            ),
            home: Debounced::default(),
            offset: m.electrical_offset,
            homed: false,
            ripple: Ripple::new(m.coulomb, RIPPLE_SHARE * most),
            push: 0.0,
            leg_us: 0,
            legs: 0,
            set_point: None,
            voltage: 0.0,
            stalled_us: 0,
            config,
        })
    }

    /// What the rotor is doing.
    pub fn state(&self) -> &State {
        &self.state
    }

    /// The figures it was made from.
    pub fn config(&self) -> &Config {
        &self.config
    }

    /// Whether the turn is known.
    pub fn homed(&self) -> bool {
        self.homed
    }

    /// The electrical angle at reading zero, rad, once known: for the settings.
    pub fn electrical_offset(&self) -> Option<f32> {
        self.offset
    }

    /// What was learned of the motor: for the settings.
    pub fn ripple(&self) -> &Ripple {
        &self.ripple
    }

    /// Takes up what was learned before a restart: table and friction of [`Rotor::ripple`]. From
    /// then on little is learned in each leg.
    pub fn restore(&mut self, cells: &[f32; CELLS], coulomb: f32) {
        self.ripple.restore(cells, coulomb);
        self.legs = u8::MAX;
    }

    /// Asks for something else from the next tick on.
    ///
    /// # Errors
    /// [`Refused`]; nothing has changed then.
    pub fn command(&mut self, command: Command) -> Result<(), Refused> {
        let next = match (command, self.state) {
            (Command::Clear, State::Fault(_)) | (Command::Off, State::Off) => State::Off,
            (_, State::Fault(_)) => return Err(Refused::Latched),
            (Command::Clear, _) | (Command::Stop, State::Off | State::Stopping(_)) => return Ok(()),
            (Command::Off, _) | (Command::Stop, State::Calibrating(_)) => State::Off,
            (Command::Stop, State::Homing(search)) => State::Stopping(Stop::from(search.set_point())),
            (Command::Stop, State::Running(_)) => State::Stopping(Stop::from(self.last_set_point())),
            (Command::Calibrate, State::Off) => {
                self.angle_known()?;
                match self.way()? {
                    Ok(way) => State::Calibrating(Calibration::new(way)),
                    Err(fault) => State::Fault(fault),
                }
            }
            (Command::Home, State::Off) => self.home()?,
            (Command::Run, State::Off) => self.run(Goal::Schedule)?,
            (Command::MoveTo(angle), State::Off) => {
                if !angle.is_finite() || self.outside(angle, Margin::Soft) {
                    return Err(Refused::OutsideTravel);
                }
                self.run(Goal::Angle(angle))?
            }
            (Command::Calibrate | Command::Home | Command::Run | Command::MoveTo(_), _) => return Err(Refused::Busy),
        };
        self.enter(next);
        Ok(())
    }

    /// One period of the motor's loop.
    pub fn tick(&mut self, inputs: &Inputs) -> Outputs {
        self.home.update(inputs.home);
        let moving = self.set_point.is_some_and(|s| s.rate.abs() > SLOW);
        let sense = self.shaft.sense(inputs.reading, self.push, moving);
        if matches!(sense, Sense::Lost { .. }) {
            self.homed = false;
        }
        let drive = match self.act(inputs, sense) {
            Ok(drive) => drive,
            Err(fault) => {
                self.homed &= !fault.loses_home();
                self.enter(State::Fault(fault));
                None
            }
        };
        Outputs {
            drive,
            angle: self.homed.then_some(self.shaft.angle),
            rate: self.shaft.rate,
            set_point: self.set_point,
            voltage: self.voltage,
        }
    }

    /// The only way into a state: nothing of the last one's control is left over.
    fn enter(&mut self, state: State) {
        let closed = |s: &State| matches!(s, State::Homing(_) | State::Running(_) | State::Stopping(_));
        if !(closed(&state) && closed(&self.state)) {
            self.push = 0.0;
            self.voltage = 0.0;
            self.stalled_us = 0;
            self.leg_us = 0;
            self.shaft.quiet = false;
            self.set_point = None;
            // What disturbed a coasting rotor was its friction.
            self.shaft.disturbance = 0.0;
        }
        self.state = state;
    }

    fn act(&mut self, inputs: &Inputs, sense: Sense) -> Result<Option<[Duty; 3]>, RotorFault> {
        match self.state {
            State::Fault(_) => return Ok(None),
            State::Off => {
                // Nothing moves, but whoever rests to measure needs the angle; and the turn is lost.
                encoder_speaks(sense)?;
                if self.config.homing == Homing::SlipRing && self.homed {
                    self.centre();
                }
                return Ok(None);
            }
            State::Calibrating(_) | State::Homing(_) | State::Running(_) | State::Stopping(_) => {}
        }
        self.guard(inputs, sense)?;
        match self.state {
            State::Off | State::Fault(_) => Ok(None),
            State::Calibrating(mut calibration) => {
                let field = calibration.step(&self.shaft, &self.config)?;
                self.state = State::Calibrating(calibration);
                match field {
                    Field::Off => Ok(None),
                    Field::On { volts, angle } => Ok(Some(self.duties(volts, 0.0, angle))),
                    Field::Found { offset } => {
                        self.offset = Some(offset);
                        self.enter(State::Off);
                        Ok(None)
                    }
                }
            }
            State::Homing(mut search) => {
                let Homing::HomeSwitch(switch) = self.config.homing else {
                    self.enter(State::Off);
                    return Ok(None);
                };
                let found = search.step(&self.shaft, self.home.side(), &self.config, &switch)?;
                self.state = State::Homing(search);
                match found {
                    Found::Not(set_point) => self.follow(set_point).map(Some),
                    Found::Turns(turns) => {
                        self.shaft.turn(turns);
                        self.homed = true;
                        self.enter(State::Off);
                        Ok(None)
                    }
                }
            }
            State::Running(run) => self.running(run),
            State::Stopping(mut stop) => {
                if stop.held_us >= STOP_US {
                    self.enter(State::Off);
                    return Ok(None);
                }
                let set_point = stop.ramp.step(0.0, self.config.schedule.acceleration, self.config.dt());
                if set_point.rate == 0.0 {
                    stop.held_us += self.config.dt_us;
                }
                self.state = State::Stopping(stop);
                self.follow(set_point).map(Some)
            }
        }
    }

    /// Everything that switches off whatever is going on.
    fn guard(&self, inputs: &Inputs, sense: Sense) -> Result<(), RotorFault> {
        if inputs.driver_fault {
            return Err(RotorFault::Driver);
        }
        encoder_speaks(sense)?;
        // Lost before this state was entered: there is nothing to go by.
        if sense == Sense::Bad && !self.shaft.known() {
            return Err(RotorFault::EncoderInvalid);
        }
        let Shaft { angle, rate, .. } = self.shaft;
        // An aligning rotor that runs away has its own name, see there.
        if rate.abs() > self.config.limits.overspeed && !matches!(self.state, State::Calibrating(_)) {
            return Err(RotorFault::Overspeed { rate });
        }
        if let Homing::HomeSwitch(switch) = self.config.homing
            && self.homed
        {
            if self.outside(angle, Margin::Hard) {
                return Err(RotorFault::Travel { angle });
            }
            let over = angle - switch.edge;
            let mismatch = match self.home.side() {
                Some(Side::Below) => over > switch.tolerance,
                Some(Side::Above) => over < -switch.tolerance,
                None => return Err(RotorFault::HomeInvalid),
            };
            if mismatch {
                return Err(RotorFault::HomeMismatch { angle });
            }
        }
        Ok(())
    }

    fn running(&mut self, mut run: Run) -> Result<Option<[Duty; 3]>, RotorFault> {
        let nav::rotor::RotorConfig {
            rate,
            travel,
            acceleration,
        } = self.config.schedule;
        // A motion that is over hands the same tick to the next one; two hand-overs are the most there are.
        for _ in 0..3 {
            let set_point = match &mut run.motion {
                Motion::Halt(ramp) if ramp.rate != 0.0 => Some(ramp.step(0.0, acceleration, self.config.dt())),
                Motion::Halt(_) => None,
                Motion::Move(step) => step.step(self.config.dt_us),
                Motion::Cycle(cycle) => Some(cycle.step(&self.schedule, self.config.dt_us)),
            };
            if let Some(set_point) = set_point {
                self.state = State::Running(run);
                return self.follow(set_point).map(Some);
            }
            let here = match run.motion {
                Motion::Halt(ramp) => ramp.angle,
                _ => self.last_set_point().angle,
            };
            let inside = math::limit(here, 0.0, travel);
            run.motion = match (run.goal, run.motion) {
                (Goal::Angle(target), Motion::Halt(_)) => Motion::Move(Move::new(here, target, rate, acceleration)),
                (Goal::Schedule, Motion::Halt(_)) if here != inside => {
                    Motion::Move(Move::new(here, inside, rate, acceleration))
                }
                (Goal::Schedule, _) => Motion::Cycle(Cycle::enter(inside, &self.schedule)),
                (Goal::Angle(target), _) => {
                    let ramp = Ramp {
                        angle: target,
                        rate: 0.0,
                    };
                    self.state = State::Stopping(Stop::from(ramp));
                    return self.follow(at_rest(target)).map(Some);
                }
            };
        }
        Err(RotorFault::SetPoint {
            angle: self.last_set_point().angle,
        })
    }

    /// The loops: the duties that follow this set-point.
    fn follow(&mut self, set_point: RotorState) -> Result<[Duty; 3], RotorFault> {
        let Some(offset) = self.offset else {
            // No command leads here without it.
            return Err(RotorFault::NoMovement { moved: 0.0 });
        };
        let RotorState {
            angle: angle_r,
            rate: rate_r,
            acceleration: acceleration_r,
        } = set_point;
        // Zero lies inside the travel: away from it is outwards, and the way in is allowed.
        let outwards = angle_r * rate_r > 0.0;
        if self.homed && outwards && self.outside(angle_r, Margin::Soft) {
            return Err(RotorFault::SetPoint { angle: angle_r });
        }
        let m = &self.config.motor;
        let dt = self.config.dt();
        let on_schedule = matches!(self.state, State::Running(run) if run.on_schedule());
        let leg = on_schedule && acceleration_r == 0.0;
        if leg {
            self.leg_us += self.config.dt_us;
        } else {
            // Two thirds of a leg and more; the rest of one that was entered in the middle does not count.
            if self.leg_us > motion::period_us(&self.schedule) / 3 {
                self.legs = self.legs.saturating_add(1);
            }
            self.leg_us = 0;
        }
        let c = &self.config.control;
        self.shaft.quiet = self.leg_us > FIRM_US && self.legs >= c.legs;
        let loops = if self.shaft.quiet { c.quiet } else { c.firm };
        let Shaft {
            angle,
            rate,
            disturbance,
            ..
        } = self.shaft;
        let error = angle_r - angle;
        if error.abs() > self.config.limits.following {
            return Err(RotorFault::Following { error });
        }
        let shaft = self.shaft.shaft() + rate * m.delay;
        let known = self.ripple.at(shaft) + self.ripple.friction(rate_r) + m.viscous * rate_r;
        let feedback = loops.rate * (rate_r + loops.position * error - rate) - disturbance;
        let torque = m.inertia * (acceleration_r + feedback) + known;
        let per_torque = m.resistance / m.torque_constant;
        let back_emf = m.torque_constant / 1.5 * rate_r;
        let wanted = torque * per_torque + back_emf;
        let voltage = math::limit(wanted, -m.voltage_limit, m.voltage_limit);
        self.push = ((voltage - back_emf) / per_torque - known) / m.inertia;

        if wanted != voltage && rate.abs() < 0.1 * self.config.schedule.rate {
            self.stalled_us += self.config.dt_us;
            if self.stalled_us > self.config.limits.stall_us {
                return Err(RotorFault::Stall { angle });
            }
        } else {
            self.stalled_us = 0;
        }

        // In the legs only: about a turn-around friction is not what it is in motion.
        if leg && self.leg_us > SETTLE_US && wanted == voltage {
            let missing = m.inertia * feedback;
            // A cell is met for (2π/cells)/(ω dt) ticks in a pass.
            let gain = c.learning * FAST_LEGS / math::limit(f32::from(self.legs), FAST_LEGS, 10.0 * FAST_LEGS);
            let share = gain * rate_r.abs() * dt * (CELLS as f32 / TAU);
            self.ripple.learn(self.shaft.shaft(), share * missing, gain);
            let way = 1.0_f32.copysign(rate_r);
            self.ripple.learn_friction(gain * dt / FRICTION_TIME * way * missing);
        }

        let theta = f32::from(m.pole_pairs) * shaft + offset;
        self.set_point = Some(set_point);
        self.voltage = voltage;
        Ok(self.duties(0.0, voltage, theta))
    }

    fn duties(&self, v_d: f32, v_q: f32, theta: f32) -> [Duty; 3] {
        let m = &self.config.motor;
        commutation::duties(v_d, v_q, theta, m.supply, m.phase_order)
    }

    fn last_set_point(&self) -> Ramp {
        let s = self.set_point.unwrap_or(at_rest(self.shaft.angle));
        Ramp {
            angle: s.angle,
            rate: s.rate,
        }
    }

    fn angle_known(&self) -> Result<(), Refused> {
        if self.shaft.known() {
            Ok(())
        } else {
            Err(Refused::NoAngle)
        }
    }

    fn calibrated(&self) -> Result<(), Refused> {
        self.offset.map(drop).ok_or(Refused::NotCalibrated)
    }

    /// Which way it is safe to go without knowing the turn.
    fn way(&self) -> Result<Result<f32, RotorFault>, Refused> {
        let Homing::HomeSwitch(switch) = self.config.homing else {
            return Ok(Ok(1.0));
        };
        let side = self.home.side().ok_or(Refused::NoHome)?;
        let angle = self.shaft.angle;
        let place = homing::place(angle, side, &self.config, &switch);
        Ok(place
            .map(|_| homing::way(side))
            .ok_or(RotorFault::HomeMismatch { angle }))
    }

    fn home(&mut self) -> Result<State, Refused> {
        self.angle_known()?;
        match self.config.homing {
            Homing::SlipRing => {
                self.homed = true;
                self.centre();
                Ok(State::Off)
            }
            Homing::HomeSwitch(_) => {
                self.calibrated()?;
                let way = self.way()?;
                self.homed = false;
                Ok(match way {
                    Ok(_) => State::Homing(Search::new(&self.shaft)),
                    Err(fault) => State::Fault(fault),
                })
            }
        }
    }

    fn run(&self, goal: Goal) -> Result<State, Refused> {
        self.angle_known()?;
        self.calibrated()?;
        if !self.homed {
            return Err(Refused::NotHomed);
        }
        let Shaft { angle, rate, .. } = self.shaft;
        let rate = if rate.abs() < REST_RATE { 0.0 } else { rate };
        Ok(State::Running(Run {
            goal,
            motion: Motion::Halt(Ramp { angle, rate }),
        }))
    }

    /// Of the angles that a slip ring cannot tell apart, the one nearest to the middle of the travel.
    fn centre(&mut self) {
        let middle = 0.5 * self.config.schedule.travel;
        let off = self.shaft.angle - middle;
        if off.abs() > PI {
            self.shaft.angle = middle + math::wrap_pi(off);
        }
    }

    fn outside(&self, angle: f32, margin: Margin) -> bool {
        let Homing::HomeSwitch(switch) = self.config.homing else {
            return false;
        };
        let margin = match margin {
            Margin::Soft => switch.soft,
            Margin::Hard => switch.hard,
        };
        !(-margin..=self.config.schedule.travel + margin).contains(&angle)
    }
}

#[derive(Debug, Clone, Copy, PartialEq)]
enum Margin {
    Soft,
    Hard,
}

impl From<Ramp> for Stop {
    fn from(ramp: Ramp) -> Self {
        Self { ramp, held_us: 0 }
    }
}

/// The encoder has been lost in this very tick, or not.
const fn encoder_speaks(sense: Sense) -> Result<(), RotorFault> {
    match sense {
        Sense::Lost { frozen: true } => Err(RotorFault::EncoderFrozen),
        Sense::Lost { frozen: false } => Err(RotorFault::EncoderInvalid),
        Sense::Good | Sense::Bad => Ok(()),
    }
}

fn at_rest(angle: f32) -> RotorState {
    RotorState {
        angle,
        rate: 0.0,
        acceleration: 0.0,
    }
}
