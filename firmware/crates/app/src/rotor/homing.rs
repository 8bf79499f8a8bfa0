//! Which turn the rotor is in.
//!
//! The zero of α is the absolute encoder's, to a second of arc; the switch tells only the turn, so a few degrees are
//! good enough for it.

use core::f32::consts::TAU;

use frames::math;
use nav::rotor::RotorState;

use super::Side;
use super::calibration::REST_RATE;
use super::config::{Config, HomeSwitch};
use super::fault::RotorFault;
use super::motion::Ramp;
use super::shaft::Shaft;

/// Equal readings in a row that make a side.
const DEBOUNCE: u8 = 3;
/// Contradictory readings in a row that make a broken switch: a change-over contact is on its way from one side to the other
/// for some milliseconds, in which neither line is high.
const BROKEN: u8 = 20;

/// The home switch behind its bounce.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(super) struct Debounced {
    side: Option<Side>,
    candidate: Option<Side>,
    count: u8,
}

impl Debounced {
    pub(super) fn update(&mut self, side: Option<Side>) {
        if side != self.candidate {
            self.candidate = side;
            self.count = 0;
        }
        self.count = self.count.saturating_add(1);
        let enough = if side.is_some() { DEBOUNCE } else { BROKEN };
        if self.count >= enough {
            self.side = side;
        }
    }

    /// `None`: not settled yet, or contradictory for longer than a change of side takes.
    pub(super) fn side(&self) -> Option<Side> {
        self.side
    }
}

/// Away from the nearer end.
pub(super) fn way(side: Side) -> f32 {
    match side {
        Side::Below => 1.0,
        Side::Above => -1.0,
    }
}

/// The angle on this side of the edge that the encoder's can stand for, rad. `None`: there is none, so that switch and
/// encoder contradict each other.
///
/// With a margin of `tolerance` on top of the hard limit (a rotor that has coasted out must be able to come home) a
/// side is less than a turn, and the angle unique.
pub(super) fn place(angle: f32, side: Side, config: &Config, switch: &HomeSwitch) -> Option<f32> {
    let outside = switch.hard + switch.tolerance;
    let (low, high) = match side {
        Side::Below => (-outside, switch.edge + switch.tolerance),
        Side::Above => (switch.edge - switch.tolerance, config.schedule.travel + outside),
    };
    let middle = 0.5 * (low + high);
    let place = middle + math::wrap_pi(angle - middle);
    (low..=high).contains(&place).then_some(place)
}

#[derive(Debug, Clone, Copy, PartialEq)]
enum Phase {
    /// Bringing a coasting rotor to rest.
    Halt,
    /// Towards the edge.
    Seek { side: Side, origin: f32, reach: f32 },
    /// Past it.
    Brake { edge: f32 },
}

/// A search for the home switch.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Search {
    phase: Phase,
    ramp: Ramp,
}

/// What a search wants of this tick.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Found {
    /// Follow this.
    Not(RotorState),
    /// Over: the angle is to be renamed by so many turns.
    Turns(f32),
}

impl Search {
    pub(super) fn new(shaft: &Shaft) -> Self {
        Self {
            phase: Phase::Halt,
            ramp: Ramp {
                angle: shaft.angle,
                rate: if shaft.rate.abs() < REST_RATE { 0.0 } else { shaft.rate },
            },
        }
    }

    pub(super) fn set_point(&self) -> Ramp {
        self.ramp
    }

    pub(super) fn step(
        &mut self,
        shaft: &Shaft,
        side: Option<Side>,
        config: &Config,
        switch: &HomeSwitch,
    ) -> Result<Found, RotorFault> {
        let side = side.ok_or(RotorFault::HomeInvalid)?;
        if self.phase == Phase::Halt && self.ramp.rate == 0.0 {
            let origin = shaft.angle;
            let Some(place) = place(origin, side, config, switch) else {
                return Err(RotorFault::HomeMismatch { angle: origin });
            };
            // No further than the edge can be: a switch that hangs must not lead past the other end.
            let reach = (switch.edge - place).abs() + switch.tolerance;
            self.phase = Phase::Seek { side, origin, reach };
        }
        let rate = match self.phase {
            Phase::Halt => 0.0,
            Phase::Seek {
                side: from,
                origin,
                reach,
            } => {
                let searched = shaft.angle - origin;
                if side != from {
                    self.phase = Phase::Brake { edge: shaft.angle };
                } else if searched.abs() > reach {
                    return Err(RotorFault::HomeNotFound { searched });
                }
                way(from) * switch.rate
            }
            Phase::Brake { edge } => {
                if self.ramp.rate == 0.0 {
                    let off = math::wrap_pi(edge - switch.edge);
                    if off.abs() > switch.tolerance {
                        return Err(RotorFault::HomeMisplaced { off });
                    }
                    // A whole number but for rounding; the shift keeps the truncation on the positive side.
                    let turns = (switch.edge + off - edge) / TAU;
                    return Ok(Found::Turns((turns + 1000.5) as i32 as f32 - 1000.0));
                }
                0.0
            }
        };
        Ok(Found::Not(self.ramp.step(
            rate,
            config.schedule.acceleration,
            config.dt(),
        )))
    }
}
