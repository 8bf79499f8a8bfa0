//! Transitions and faults, on a rotor that follows its commands exactly. The real one is in hal-sim.

use super::*;

const DEG: f32 = 0.017_453_292;

/// A unit whose rotor follows perfectly.
struct Ideal {
    rotor: Rotor,
    angle: f32,
    /// Angle of the switch's edge; `None`: broken.
    edge: Option<f32>,
    /// Ticks for which neither contact is closed when the switch changes, and how many of them are left.
    transit: u32,
    left: u32,
    side: Option<Side>,
    reading: Option<f32>,
    driver_fault: bool,
    /// The rotor does not move; the encoder's last bits do.
    blocked: bool,
    ticks: u32,
}

impl Ideal {
    fn new(angle: f32, change: impl FnOnce(&mut Config)) -> Self {
        let mut config = Config {
            encoder_zero: 1.0,
            ..Config::default()
        };
        config.motor.electrical_offset = Some(0.5);
        change(&mut config);
        let mut ideal = Self {
            rotor: Rotor::new(config).unwrap(),
            angle,
            edge: Some(180.0 * DEG),
            transit: 0,
            left: 0,
            side: None,
            reading: None,
            driver_fault: false,
            blocked: false,
            ticks: 0,
        };
        for _ in 0..5 {
            ideal.tick();
        }
        ideal
    }

    /// The same, its turn known.
    fn homed(angle: f32) -> Self {
        let mut ideal = Self::new(angle, |_| ());
        ideal.rotor.shaft.angle = angle;
        ideal.rotor.homed = true;
        ideal.tick();
        ideal
    }

    fn running(angle: f32) -> Self {
        let mut ideal = Self::homed(angle);
        ideal.rotor.command(Command::Run).unwrap();
        for _ in 0..500 {
            ideal.tick();
        }
        assert_eq!(ideal.kind(), Kind::Running);
        ideal
    }

    fn tick(&mut self) -> Outputs {
        let noise = if self.ticks.is_multiple_of(2) { 3e-6 } else { 0.0 };
        self.ticks += 1;
        self.reading = Some(math::wrap_two_pi(self.angle + 1.0 + noise));
        self.tick_with_reading()
    }

    fn tick_with_reading(&mut self) -> Outputs {
        let side = self
            .edge
            .map(|edge| if self.angle < edge { Side::Below } else { Side::Above });
        self.left = if side == self.side {
            self.left.saturating_sub(1)
        } else {
            self.transit
        };
        self.side = side;
        let outputs = self.rotor.tick(&Inputs {
            reading: self.reading,
            home: side.filter(|_| self.left == 0),
            driver_fault: self.driver_fault,
        });
        if let (Some(s), false) = (outputs.set_point, self.blocked) {
            // Before it is homed the rotor's angle may be a turn off.
            let off = self.angle - s.angle;
            let turns = off - math::wrap_pi(off);
            self.angle = s.angle + turns + (s.rate + 0.5 * s.acceleration * 1e-3) * 1e-3;
        }
        outputs
    }

    fn kind(&self) -> Kind {
        Kind::of(self.rotor.state())
    }

    /// Ticks until the state changes; the outputs of the last one.
    fn until_change(&mut self) -> Outputs {
        let kind = self.kind();
        for _ in 0..60_000 {
            let outputs = self.tick();
            if self.kind() != kind {
                return outputs;
            }
        }
        panic!("{kind:?} for ever");
    }

    /// The fault that ends this state, with the outputs off in the same tick.
    fn fault(&mut self) -> RotorFault {
        assert_eq!(self.until_change().drive, None);
        match *self.rotor.state() {
            State::Fault(fault) => fault,
            other => panic!("{other:?}"),
        }
    }
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Kind {
    Off,
    Calibrating,
    Homing,
    Running,
    Stopping,
    Fault,
}

impl Kind {
    fn of(state: &State) -> Self {
        match state {
            State::Off => Self::Off,
            State::Calibrating(_) => Self::Calibrating,
            State::Homing(_) => Self::Homing,
            State::Running(_) => Self::Running,
            State::Stopping(_) => Self::Stopping,
            State::Fault(_) => Self::Fault,
        }
    }
}

const KINDS: [Kind; 6] = [
    Kind::Off,
    Kind::Calibrating,
    Kind::Homing,
    Kind::Running,
    Kind::Stopping,
    Kind::Fault,
];

/// A homed unit in this state.
fn in_state(kind: Kind) -> Ideal {
    let mut ideal = Ideal::homed(1.0);
    let command = match kind {
        Kind::Off => Command::Off,
        Kind::Calibrating => Command::Calibrate,
        Kind::Homing => Command::Home,
        Kind::Running | Kind::Stopping | Kind::Fault => Command::Run,
    };
    ideal.rotor.command(command).unwrap();
    for _ in 0..300 {
        ideal.tick();
    }
    match kind {
        Kind::Stopping => ideal.rotor.command(Command::Stop).unwrap(),
        Kind::Fault => {
            ideal.driver_fault = true;
            ideal.tick();
            ideal.driver_fault = false;
        }
        _ => {}
    }
    ideal.tick();
    assert_eq!(ideal.kind(), kind);
    ideal
}

#[test]
fn commands_in_every_state() {
    use Command::{Calibrate, Clear, Home, MoveTo, Off, Run, Stop};
    use Refused::{Busy, Latched};
    type Row = (Command, [Result<Kind, Refused>; 6]);
    let busy = Err(Busy);
    let (off, stopping) = (Ok(Kind::Off), Ok(Kind::Stopping));
    let latched = Err(Latched);
    // In the order of `KINDS`.
    #[rustfmt::skip]
    let table: [Row; 7] = [
        //          Off                     Calibrating            Homing            Running            Stopping  Fault
        (Calibrate, [Ok(Kind::Calibrating), busy,                  busy,             busy,              busy,     latched]),
        (Home,      [Ok(Kind::Homing),      busy,                  busy,             busy,              busy,     latched]),
        (Run,       [Ok(Kind::Running),     busy,                  busy,             busy,              busy,     latched]),
        (MoveTo(2.0), [Ok(Kind::Running),   busy,                  busy,             busy,              busy,     latched]),
        (Stop,      [off,                   off,                   stopping,         stopping,          stopping, latched]),
        (Off,       [off,                   off,                   off,              off,               off,      latched]),
        (Clear,     [off,                   Ok(Kind::Calibrating), Ok(Kind::Homing), Ok(Kind::Running), stopping, off]),
    ];
    for (command, row) in table {
        for (kind, expected) in KINDS.into_iter().zip(row) {
            let mut ideal = in_state(kind);
            let before = *ideal.rotor.state();
            let found = ideal.rotor.command(command).map(|()| ideal.kind());
            assert_eq!(found, expected, "{command:?} in {kind:?}");
            if found.is_err() {
                assert_eq!(*ideal.rotor.state(), before);
            }
            let out = ideal.tick();
            if matches!(ideal.kind(), Kind::Off | Kind::Fault) {
                assert_eq!(
                    (out.drive, out.set_point, out.voltage),
                    (None, None, 0.0),
                    "{command:?} in {kind:?}"
                );
            }
        }
    }
}

#[test]
fn what_must_be_known_first() {
    use Command::{Calibrate, Clear, Home, MoveTo, Run};
    let refused = |ideal: &mut Ideal, command| ideal.rotor.command(command).unwrap_err();
    let mut fresh = Ideal::new(1.0, |c| c.motor.electrical_offset = None);
    assert_eq!(refused(&mut fresh, Run), Refused::NotCalibrated);
    assert_eq!(refused(&mut fresh, Home), Refused::NotCalibrated);
    fresh.edge = None;
    for _ in 0..20 {
        fresh.tick();
    }
    assert_eq!(refused(&mut fresh, Calibrate), Refused::NoHome);
    let mut calibrated = Ideal::new(1.0, |_| ());
    assert_eq!(refused(&mut calibrated, Run), Refused::NotHomed);
    assert_eq!(refused(&mut calibrated, MoveTo(1.0)), Refused::NotHomed);
    let mut blind = Ideal::new(1.0, |_| ());
    blind.reading = None;
    for _ in 0..3 {
        blind.tick_with_reading();
    }
    blind.rotor.command(Clear).unwrap();
    for command in [Calibrate, Home, Run] {
        assert_eq!(refused(&mut blind, command), Refused::NoAngle);
    }
    let mut homed = Ideal::homed(1.0);
    for angle in [-3.5 * DEG, 363.5 * DEG, f32::NAN, f32::INFINITY] {
        assert_eq!(refused(&mut homed, MoveTo(angle)), Refused::OutsideTravel);
    }
}

/// A fault of the bridge ends every motion in the tick in which it is there; an encoder that falls silent does so with its
/// third reading, and at rest as well.
#[test]
fn faults_from_outside_in_every_state() {
    for kind in KINDS {
        let quiet = matches!(kind, Kind::Off | Kind::Fault);
        let mut ideal = in_state(kind);
        ideal.driver_fault = true;
        let out = ideal.tick();
        assert_eq!(ideal.kind(), if quiet { kind } else { Kind::Fault });
        if !quiet {
            assert_eq!(*ideal.rotor.state(), State::Fault(RotorFault::Driver));
            assert_eq!(out.drive, None);
            assert!(kind == Kind::Homing || ideal.rotor.homed());
        }

        let mut ideal = in_state(kind);
        ideal.reading = None;
        for bad in 1..=3 {
            let out = ideal.tick_with_reading();
            let over = bad == 3;
            assert_eq!(ideal.kind(), if over { Kind::Fault } else { kind }, "{bad}");
            assert!(!over || out.drive.is_none());
        }
        assert!(!ideal.rotor.homed());
        if kind != Kind::Fault {
            assert_eq!(*ideal.rotor.state(), State::Fault(RotorFault::EncoderInvalid));
            // Latched until cleared; then the turn is to be found anew.
            for _ in 0..100 {
                assert_eq!(ideal.tick().drive, None);
            }
            assert_eq!(ideal.rotor.command(Command::Run), Err(Refused::Latched));
            ideal.rotor.command(Command::Clear).unwrap();
            assert_eq!(ideal.rotor.command(Command::Run), Err(Refused::NotHomed));
        }
    }
}

#[test]
fn encoder_repeats_itself() {
    let mut ideal = Ideal::running(1.0);
    for bad in 1..=3 {
        let out = ideal.tick_with_reading();
        assert_eq!(out.drive.is_none(), bad == 3);
    }
    assert_eq!(*ideal.rotor.state(), State::Fault(RotorFault::EncoderFrozen));
}

#[test]
fn blocked_rotor() {
    let mut ideal = Ideal::running(1.0);
    ideal.blocked = true;
    let fault = ideal.fault();
    assert!(matches!(fault, RotorFault::Stall { .. }), "{fault:?}");
    assert!(ideal.rotor.homed());
    // With more patience for the voltage, the distance tells.
    let mut ideal = Ideal::running(1.0);
    ideal.rotor.config.limits.stall_us = 1_000_000;
    ideal.blocked = true;
    let fault = ideal.fault();
    assert!(
        matches!(fault, RotorFault::Following { error } if error > 2.0 * DEG),
        "{fault:?}"
    );
}

/// Held fast, the rotor gets all of the limit and no more: beyond it the motor burns.
#[test]
fn the_voltage_ends_at_its_limit() {
    for limit in [2.0, 5.0] {
        let mut ideal = Ideal::running(1.0);
        ideal.rotor.config.motor.voltage_limit = limit;
        ideal.rotor.config.limits.stall_us = 1_000_000;
        ideal.blocked = true;
        let mut most = 0.0_f32;
        while ideal.kind() == Kind::Running {
            most = most.max(ideal.tick().voltage.abs());
        }
        assert!((most - limit).abs() < 1e-6, "{most} of {limit} V");
    }
}

#[test]
fn outside_the_travel() {
    for angle in [-6.5, 366.5] {
        let angle = angle * DEG;
        let mut ideal = Ideal::homed(angle);
        ideal.rotor.command(Command::Run).unwrap();
        assert!(matches!(ideal.fault(), RotorFault::Travel { angle: found } if (found - angle).abs() < 1e-4));
        assert_eq!(ideal.ticks, 7, "at once");
        // The search leads back.
        ideal.rotor.command(Command::Clear).unwrap();
        ideal.rotor.command(Command::Home).unwrap();
        ideal.until_change();
        assert_eq!(ideal.kind(), Kind::Off);
        assert!((ideal.angle - 180.0 * DEG).abs() < DEG);
    }
    // Between the limits the way in is open, the way out is not.
    for (angle, rate) in [(-5.5, 0.0), (365.5, 0.0), (-2.8, -20.0), (362.8, 20.0)] {
        let mut ideal = Ideal::homed(angle * DEG);
        for _ in 0..100 {
            ideal.angle += rate * 1e-3 * DEG;
            ideal.tick();
        }
        ideal.rotor.command(Command::Run).unwrap();
        if rate == 0.0 {
            for _ in 0..2000 {
                ideal.tick();
            }
            assert!(
                matches!(ideal.rotor.state(), State::Running(run) if run.on_schedule()),
                "{angle}"
            );
        } else {
            assert!(matches!(ideal.fault(), RotorFault::SetPoint { .. }), "{angle}");
        }
    }
}

#[test]
fn too_fast() {
    let mut ideal = Ideal::running(1.0);
    ideal.rotor.shaft.rate = 90.0 * DEG;
    assert_eq!(ideal.tick().drive, None);
    assert!(matches!(
        ideal.rotor.state(),
        State::Fault(RotorFault::Overspeed { .. })
    ));
}

#[test]
fn a_switch_may_bounce() {
    let mut ideal = Ideal::running(1.0);
    for (edge, most) in [(None, 20), (Some(0.0), 3)] {
        for (ticks, fault) in [(most - 1, false), (most, true)] {
            let mut ideal = Ideal {
                rotor: ideal.rotor.clone(),
                ..ideal
            };
            ideal.edge = edge;
            for _ in 0..ticks {
                ideal.tick();
            }
            assert_eq!(ideal.kind() == Kind::Fault, fault, "{edge:?} {ticks}");
        }
    }
    assert!(ideal.tick().drive.is_some());
    // As the documentation says.
    assert!((4200..4800).contains(&size_of::<Rotor>()), "{}", size_of::<Rotor>());
}

#[test]
fn switch_against_angle() {
    // Broken wire.
    let mut ideal = Ideal::running(1.0);
    ideal.edge = None;
    assert_eq!(ideal.fault(), RotorFault::HomeInvalid);
    // Within the tolerance of the edge they may disagree, beyond it they may not.
    let mut ideal = Ideal::running(170.5 * DEG);
    ideal.edge = Some(2.0 * 180.0 * DEG);
    assert!(matches!(ideal.fault(), RotorFault::HomeMismatch { angle } if (angle - 190.0 * DEG).abs() < DEG));
    assert!(!ideal.rotor.homed());
    let mut ideal = Ideal::running(4.0);
    ideal.edge = Some(7.0);
    assert!(matches!(ideal.fault(), RotorFault::HomeMismatch { .. }));
}

/// For ten milliseconds neither contact is closed, in the search and at each pass of the edge.
#[test]
fn a_contact_on_its_way_is_not_broken() {
    let mut ideal = Ideal::new(170.0 * DEG, |_| ());
    ideal.transit = 10;
    ideal.rotor.command(Command::Home).unwrap();
    ideal.until_change();
    assert!(ideal.rotor.homed(), "{:?}", ideal.rotor.state());
    ideal.rotor.command(Command::Run).unwrap();
    for _ in 0..40_000 {
        ideal.tick();
        assert_eq!(ideal.kind(), Kind::Running, "{:?}", ideal.rotor.state());
    }
}

#[test]
fn search_finds_the_turn_from_everywhere() {
    for k in -1..=73 {
        let angle = (5 * k) as f32 * DEG;
        let mut ideal = Ideal::new(angle, |_| ());
        ideal.rotor.command(Command::Home).unwrap();
        let (mut low, mut high) = (angle, angle);
        while ideal.kind() == Kind::Homing {
            ideal.tick();
            (low, high) = (low.min(ideal.angle), high.max(ideal.angle));
        }
        assert_eq!(ideal.kind(), Kind::Off, "{:?}", ideal.rotor.state());
        let found = ideal.tick().angle.unwrap();
        assert!((found - ideal.angle).abs() < 1e-4, "{angle} {found}");
        assert!(ideal.rotor.homed());
        // Never away from the edge, and not far past it.
        let edge = 180.0 * DEG;
        assert!(low >= angle.min(edge - DEG) - 1e-6 && high <= angle.max(edge + DEG) + 1e-6);
    }
}

#[test]
fn search_that_fails() {
    // The switch never changes: no further than to the edge and the tolerance.
    let mut ideal = Ideal::new(10.0 * DEG, |_| ());
    ideal.edge = Some(9.0);
    ideal.rotor.command(Command::Home).unwrap();
    let expected = 180.0 * DEG;
    assert!(matches!(ideal.fault(), RotorFault::HomeNotFound { searched } if (searched - expected).abs() < DEG));
    assert!(!ideal.rotor.homed());
    // It changes 15° too early.
    let mut ideal = Ideal::new(10.0 * DEG, |_| ());
    ideal.edge = Some(165.0 * DEG);
    ideal.rotor.command(Command::Home).unwrap();
    assert!(matches!(ideal.fault(), RotorFault::HomeMisplaced { off } if (off + 15.0 * DEG).abs() < DEG));
    // Its wire breaks on the way.
    let mut ideal = Ideal::new(10.0 * DEG, |_| ());
    ideal.rotor.command(Command::Home).unwrap();
    ideal.tick();
    ideal.edge = None;
    assert_eq!(ideal.fault(), RotorFault::HomeInvalid);
}

/// A switch that hangs is found before anything moves, save in the overlap of the turns.
#[test]
fn switch_that_hangs() {
    for command in [Command::Calibrate, Command::Home] {
        for k in -15..375 {
            let in_deg = k as f32 + 0.5;
            let angle = in_deg * DEG;
            let truly = in_deg < 180.0;
            let mut ideal = Ideal::new(angle, |_| ());
            // Below becomes Above and the other way round.
            ideal.edge = Some(if truly { -9.0 } else { 9.0 });
            for _ in 0..3 {
                ideal.tick();
            }
            ideal.rotor.command(command).unwrap();
            let out = ideal.tick();
            let overlap = !(16.0..344.0).contains(&in_deg) || (170.0..190.0).contains(&in_deg);
            assert_eq!(
                out.drive.is_none() && ideal.kind() == Kind::Fault,
                !overlap,
                "{k} {:?}",
                ideal.rotor.state()
            );
        }
    }
}

#[test]
fn slip_ring_is_homed_at_once() {
    let mut ideal = Ideal::new(350.0 * DEG, |c| c.homing = Homing::SlipRing);
    ideal.edge = None;
    ideal.rotor.command(Command::Home).unwrap();
    assert_eq!(ideal.kind(), Kind::Off);
    assert!((ideal.tick().angle.unwrap() - 350.0 * DEG).abs() < 1e-5);
    // Turned by hand through zero, the angle stays about the travel, and running again needs no switch.
    for _ in 0..1000 {
        ideal.angle += 0.1 * DEG;
        ideal.tick();
    }
    assert!((ideal.tick().angle.unwrap() - 90.0 * DEG).abs() < 0.1 * DEG);
    ideal.rotor.command(Command::Run).unwrap();
    ideal.tick();
    assert_eq!(ideal.kind(), Kind::Running);
}

#[test]
fn stops_on_the_spot_and_goes_on() {
    for after in [30, 700, 17_990, 18_100, 18_190, 25_000] {
        let mut ideal = Ideal::homed(0.0);
        ideal.rotor.command(Command::Run).unwrap();
        let mut last = ideal.tick();
        for _ in 0..after {
            last = ideal.tick();
        }
        let begun = last.set_point.unwrap();
        ideal.rotor.command(Command::Stop).unwrap();
        let mut worst = 0.0_f32;
        let mut rate = begun.rate;
        while ideal.kind() == Kind::Stopping {
            let out = ideal.tick();
            if let Some(s) = out.set_point {
                worst = worst.max((s.rate - rate).abs());
                rate = s.rate;
            }
        }
        assert_eq!(ideal.kind(), Kind::Off, "{:?}", ideal.rotor.state());
        // 20 °/s off 200 °/s² are 1°; the rate never jumps.
        assert!((ideal.angle - begun.angle).abs() < 1.05 * DEG);
        assert!(worst < 1.01 * 0.2 * DEG && rate == 0.0, "{after} {worst}");
        assert!((-1e-4..360.0 * DEG + 1e-4).contains(&ideal.angle));
        ideal.rotor.command(Command::Run).unwrap();
        for _ in 0..40_000 {
            ideal.tick();
            assert_eq!(ideal.kind(), Kind::Running, "{:?}", ideal.rotor.state());
        }
    }
}

#[test]
fn moves_end_off() {
    let mut ideal = Ideal::homed(1.0);
    ideal.rotor.command(Command::MoveTo(2.5)).unwrap();
    ideal.until_change();
    assert_eq!(ideal.kind(), Kind::Stopping);
    assert_eq!(ideal.until_change().drive, None);
    assert_eq!(ideal.kind(), Kind::Off);
    assert!((ideal.angle - 2.5).abs() < 1e-3);
}

#[test]
fn a_coasting_rotor_is_caught() {
    let mut ideal = Ideal::homed(1.0);
    for _ in 0..200 {
        ideal.angle += 20e-3 * DEG;
        ideal.tick();
    }
    ideal.rotor.command(Command::Run).unwrap();
    let first = ideal.tick().set_point.unwrap();
    assert!((first.rate - 20.0 * DEG).abs() < DEG);
    for _ in 0..2000 {
        ideal.tick();
    }
    assert!(matches!(ideal.rotor.state(), State::Running(run) if run.on_schedule()));
}

#[test]
fn calibration_without_motion() {
    let mut ideal = Ideal::homed(1.0);
    ideal.rotor.command(Command::Calibrate).unwrap();
    assert!(matches!(ideal.fault(), RotorFault::NoMovement { moved } if moved < 1e-4));
    // A rotor that does not come to rest is not touched.
    let mut ideal = Ideal::homed(1.0);
    ideal.rotor.command(Command::Calibrate).unwrap();
    while ideal.kind() == Kind::Calibrating {
        ideal.angle += 5e-3 * DEG;
        assert_eq!(ideal.tick().drive, None);
    }
    assert!(matches!(
        ideal.rotor.state(),
        State::Fault(RotorFault::Unsettled { .. })
    ));
}

/// With nothing left to the feedback the voltage is the model's.
#[test]
fn feeds_the_model_forward() {
    let mut ideal = Ideal::homed(1.0);
    ideal.rotor.command(Command::Run).unwrap();
    // 60 ms into the ramp. Later the integrator notices that this rotor does not follow it.
    let out = (0..60).map(|_| ideal.tick()).last().unwrap();
    let s = out.set_point.unwrap();
    let m = ideal.rotor.config().motor;
    let torque = m.inertia * s.acceleration + m.coulomb + m.viscous * s.rate;
    let expected = torque * m.resistance / m.torque_constant + m.torque_constant / 1.5 * s.rate;
    // The acceleration is a fifth of it, the back-EMF a tenth, the friction the rest.
    assert!(
        (out.voltage / expected - 1.0).abs() < 0.02,
        "{} {expected}",
        out.voltage
    );
}
