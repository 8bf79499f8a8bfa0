//! The rotor's control on its plant: the figures it must reach, and that it never winds the cable too far.
//!
//! Figures over 20 units whose motor and mechanics are off by up to ±20 %, encoder noise included.
#![allow(clippy::unwrap_used, reason = "tests")]

use core::f64::consts::PI;

use app::rotor::{Command, Config, HomeSwitch, Homing, Inputs, Outputs, PhaseOrder, Rotor, RotorFault, State};
use drivers::harmonics::{Harmonic, Harmonics};
use drivers::motor::ThreePhase;
use drivers::mt6835::COUNTS_PER_TURN;
use frames::math::wrap_pi;
use frames::units::DEG;
use hal_sim::plant::{Plant, PlantConfig, PlantFaults};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;

/// Units the figures are taken over.
const UNITS: u64 = 20;
/// How far a unit's figures are off those the control is told.
const SPREAD: f64 = 0.2;
/// From the reading to the new duties, s: transfer, tick, next PWM period.
const TRANSPORT: f64 = 100e-6;

/// Plant and control, one tick at a time.
struct Bench {
    plant: Plant,
    rotor: Rotor,
    table: Harmonics<3>,
    config: Config,
}

impl Bench {
    fn new(plant: PlantConfig, config: Config, angle: f64, seed: u64) -> Self {
        let mut rows = [Harmonic::default(); 3];
        for (row, (order, amplitude, phase)) in rows.iter_mut().zip(&plant.encoder_harmonics) {
            *row = Harmonic {
                order: *order,
                amplitude: *amplitude as f32,
                phase: *phase as f32,
            };
        }
        let config = Config {
            encoder_zero: plant.encoder_zero as f32,
            ..config
        };
        let mut bench = Self {
            plant: Plant::new(plant, angle, seed),
            rotor: Rotor::new(config).unwrap(),
            table: Harmonics::new(rows).unwrap(),
            config,
        };
        for _ in 0..5 {
            bench.tick();
        }
        bench
    }

    /// A unit off the line with its electrical offset in the settings, as a calibration leaves it there.
    fn unit(seed: u64, angle: f64, config: Config) -> Self {
        let plant = PlantConfig::default().varied(seed, SPREAD);
        let mut config = config;
        config.motor.electrical_offset = Some((plant.electrical_offset - 2.0 * DEG) as f32);
        Self::new(plant, config, angle, seed)
    }

    fn tick(&mut self) -> Outputs {
        let inputs = Inputs {
            reading: self.plant.encoder().map(|counts| self.table.correct(counts.radians())),
            home: self.plant.home(),
            driver_fault: self.plant.faults.driver_fault,
        };
        let outputs = self.rotor.tick(&inputs);
        self.plant.advance(TRANSPORT);
        match outputs.drive {
            Some(duties) => self.plant.set_duties(duties),
            None => self.plant.outputs_off(),
        }
        self.plant.advance(f64::from(self.config.dt()) - TRANSPORT);
        outputs
    }

    /// Ticks until the rotor is off or has a fault, at most a minute.
    fn until_off(&mut self, command: Command) -> Result<(), RotorFault> {
        self.rotor.command(command).unwrap();
        for _ in 0..60_000_000 / self.config.dt_us {
            self.tick();
            match *self.rotor.state() {
                State::Off => return Ok(()),
                State::Fault(fault) => return Err(fault),
                _ => {}
            }
        }
        panic!("{command:?} does not end: {:?}", self.rotor.state());
    }

    fn cycles(&mut self, cycles: u32) -> Figures {
        let schedule = self.config.schedule;
        let rate = f64::from(schedule.rate);
        let dt = f64::from(self.config.dt());
        let period = 2.0 * f64::from(schedule.travel / schedule.rate + schedule.rate / schedule.acceleration);
        let mut figures = Figures::default();
        let (mut sum, mut n) = (0.0, 0.0);
        // Since when the rate has been more than 5 % off a leg's.
        let mut left = None;
        for k in 0..(f64::from(cycles) * period / dt) as u32 {
            let (angle, true_rate) = (self.plant.angle(), self.plant.rate());
            let outputs = self.tick();
            let Some(set) = outputs.set_point else {
                panic!("{:?}", self.rotor.state());
            };
            figures.tracking = figures.tracking.max((angle - f64::from(set.angle)).abs() / DEG);
            let leg = set.acceleration == 0.0;
            if leg {
                let off = true_rate / f64::from(set.rate) - 1.0;
                sum += off * off;
                n += 1.0;
            }
            let t = f64::from(k) * dt;
            let arrived = leg && (true_rate / f64::from(set.rate) - 1.0).abs() < 0.05;
            if (true_rate.abs() / rate - 1.0).abs() >= 0.05 {
                left.get_or_insert(t);
            } else if arrived && let Some(since) = left.take() {
                figures.turn_around = figures.turn_around.max(t - since);
            }
        }
        figures.ripple = (sum / n).sqrt();
        figures
    }
}

#[derive(Debug, Clone, Copy, Default)]
struct Figures {
    /// RMS of the true rate's error over the whole legs, as a share of the rate.
    ripple: f64,
    /// Greatest distance of the true angle from the set-point, turn-arounds included, °.
    tracking: f64,
    /// Longest time from 5 % off the old rate to 5 % off the new one, s.
    turn_around: f64,
}

impl Figures {
    fn worst(self, other: Self) -> Self {
        Self {
            ripple: self.ripple.max(other.ripple),
            tracking: self.tracking.max(other.tracking),
            turn_around: self.turn_around.max(other.turn_around),
        }
    }
}

impl core::fmt::Display for Figures {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        write!(
            f,
            "ripple {:.2} %  tracking {:.3}°  turn-around {:.3} s",
            100.0 * self.ripple,
            self.tracking,
            self.turn_around
        )
    }
}

/// A unit's figures in its first cycle, in which it learns, in the third, and after a restart with what it learned.
fn unit_figures(seed: u64) -> [Figures; 3] {
    let mut bench = Bench::unit(seed, 3.0, Config::default());
    bench.until_off(Command::Home).unwrap();
    bench.rotor.command(Command::Run).unwrap();
    let first = bench.cycles(1);
    bench.cycles(1);
    let third = bench.cycles(1);
    let learned = bench.rotor.ripple().clone();
    bench.rotor = Rotor::new(bench.config).unwrap();
    bench.rotor.restore(learned.cells(), learned.coulomb());
    for _ in 0..300 {
        bench.tick();
    }
    bench.until_off(Command::Home).unwrap();
    bench.rotor.command(Command::Run).unwrap();
    [first, third, bench.cycles(1)]
}

#[test]
fn figures_over_units() {
    let all: Vec<[Figures; 3]> = (0..UNITS).into_par_iter().map(unit_figures).collect();
    let mut worst = [Figures::default(); 3];
    for (seed, unit) in all.iter().enumerate() {
        println!("unit {seed:2}: third cycle {}", unit[1]);
        for (w, f) in worst.iter_mut().zip(unit) {
            *w = w.worst(*f);
        }
    }
    for (name, w) in ["first", "third", "restarted"].into_iter().zip(worst) {
        println!("worst of {UNITS}, {name}: {w}");
    }
    // What is asked for: 1 %, 0.2°, 0.5 s.
    for learned in &worst[1..] {
        assert!(learned.ripple < 0.01, "{learned}");
    }
    for any in worst {
        assert!(any.tracking < 0.1, "{any}");
        assert!(any.turn_around < 0.26, "{any}");
    }
    // Unlearned, and with the firm gains that pass the encoder's noise on.
    assert!(worst[0].ripple < 0.03, "{}", worst[0]);
}

/// What was learned must not creep away: the table is a repetitive control with poles of its own.
#[test]
fn figures_after_half_an_hour() {
    let mut bench = Bench::unit(18, 3.0, Config::default());
    bench.until_off(Command::Home).unwrap();
    bench.rotor.command(Command::Run).unwrap();
    bench.cycles(48);
    let figures = bench.cycles(2);
    println!("after 50 cycles: {figures}");
    assert!(figures.ripple < 0.0075 && figures.tracking < 0.05, "{figures}");
}

/// The learning is needed: without it no gains in reach meet the figure, and the test bench sees that.
#[test]
fn without_learning_the_figure_is_missed() {
    let best = [Config::default().control.firm, Config::default().control.quiet]
        .into_par_iter()
        .map(|loops| {
            let mut config = Config::default();
            config.control.learning = 0.0;
            config.control.firm = loops;
            config.control.quiet = loops;
            let mut bench = Bench::unit(14, 3.0, config);
            bench.until_off(Command::Home).unwrap();
            bench.rotor.command(Command::Run).unwrap();
            bench.cycles(1).ripple
        })
        .reduce(|| 1.0, f64::min);
    assert!(best > 0.012, "{best}");
}

#[test]
fn other_rates_and_ticks() {
    // (rate in °/s, travel in °, tick in µs)
    for (rate_dps, travel_deg, dt_us) in [
        (20.0, 360.0, 500),
        (10.0, 360.0, 1000),
        (40.0, 360.0, 1000),
        (20.0, 120.0, 1000),
    ] {
        let mut config = Config {
            dt_us,
            homing: Homing::SlipRing,
            ..Config::default()
        };
        config.schedule.rate = (rate_dps * DEG) as f32;
        config.schedule.travel = (travel_deg * DEG) as f32;
        config.limits.overspeed = 3.0 * config.schedule.rate;
        let mut bench = Bench::unit(5, 1.0, config);
        bench.until_off(Command::Home).unwrap();
        bench.rotor.command(Command::Run).unwrap();
        bench.cycles(3);
        let figures = bench.cycles(1);
        println!("{rate_dps} °/s over {travel_deg}° at {dt_us} µs: {figures}");
        assert!(
            figures.ripple < 0.015 * (20.0 / rate_dps).max(1.0),
            "{rate_dps}: {figures}"
        );
        assert!(figures.tracking < 0.1, "{rate_dps}: {figures}");
    }
}

#[test]
fn calibration_finds_the_offset() {
    let worst = (0..400_u64)
        .into_par_iter()
        .map(|seed| {
            let mut plant = PlantConfig::default().varied(seed, SPREAD);
            if let (Some(cable), 1) = (&mut plant.cable, seed % 2) {
                // At the ends the cable overcomes the friction: the rotor slides, and all the more when it trembles.
                cable.stiffness = 1.1 * plant.coulomb / PI;
            }
            let expected = plant.electrical_offset;
            // From −6°, where the hard limit has switched off, to 366°.
            let start = (-6.0 + 372.0 * (seed % 200) as f64 / 199.0) * DEG;
            let mut bench = Bench::new(plant, Config::default(), start, seed);
            bench.rotor.command(Command::Calibrate).unwrap();
            let outwards = if start < PI { -1.0 } else { 1.0 };
            let mut strayed = 0.0_f64;
            while matches!(bench.rotor.state(), State::Calibrating(_)) {
                bench.tick();
                strayed = strayed.max(outwards * (bench.plant.angle() - start) / DEG);
            }
            assert_eq!(*bench.rotor.state(), State::Off, "{seed}");
            let found = f64::from(bench.rotor.electrical_offset().unwrap());
            (wrap_pi(found - expected).abs() / DEG, strayed)
        })
        .reduce(|| (0.0, 0.0), |a, b| (a.0.max(b.0), a.1.max(b.1)));
    println!(
        "electrical offset to {:.1}°, strayed outwards by {:.1}°",
        worst.0, worst.1
    );
    // 6° cost 0.5 % of torque. The slack bounds the straying.
    assert!(worst.0 < 6.0 && worst.1 < 5.0);
}

#[test]
fn calibration_names_what_is_wrong() {
    let fault = |plant: &dyn Fn(&mut PlantConfig), config: &dyn Fn(&mut Config), stuck: bool| {
        let mut faults: Vec<RotorFault> = (0..20)
            .map(|seed| {
                let mut p = PlantConfig::default().varied(seed, SPREAD);
                plant(&mut p);
                let mut c = Config::default();
                config(&mut c);
                let mut bench = Bench::new(p, c, 1.0 + 0.2 * seed as f64, seed);
                bench.plant.faults.stuck = stuck;
                bench.until_off(Command::Calibrate).unwrap_err()
            })
            .collect();
        faults.dedup_by_key(|fault| core::mem::discriminant(fault));
        faults
    };
    let same = |_: &mut Config| ();
    let faults = fault(&|p| p.swapped = true, &same, false);
    assert!(matches!(faults[..], [RotorFault::WrongDirection { .. }]), "{faults:?}");
    let faults = fault(&|_| (), &same, true);
    assert!(matches!(faults[..], [RotorFault::NoMovement { .. }]), "{faults:?}");
    for (really, told) in [(7, 8), (7, 6), (11, 7), (11, 10), (11, 12)] {
        let faults = fault(&|p| p.pole_pairs = really, &|c| c.motor.pole_pairs = told, false);
        assert!(
            matches!(faults[..], [RotorFault::PolePairs { measured, .. }] if (measured - f32::from(really)).abs() < 1.0),
            "{really} {told} {faults:?}"
        );
    }
    // The other order of phases is a matter of configuration.
    let mut config = Config::default();
    config.motor.phase_order = PhaseOrder::Acb;
    let plant = PlantConfig {
        swapped: true,
        ..PlantConfig::default()
    };
    let mut bench = Bench::new(plant, config, 1.0, 0);
    assert_eq!(bench.until_off(Command::Calibrate), Ok(()));
    assert_eq!(bench.until_off(Command::Home), Ok(()));
}

/// What a run met.
#[derive(Debug, Clone, Copy, Default)]
struct Tally {
    /// Furthest outside the schedule's travel, °.
    outside: f64,
    resets: u32,
    injected: u32,
    faults: u32,
    homed: u32,
    legs: u32,
    /// Ticks from the injection of each kind to the outputs off, longest.
    latency: [u32; KINDS],
}

impl Tally {
    fn with(self, other: Self) -> Self {
        let mut latency = self.latency;
        for (l, o) in latency.iter_mut().zip(other.latency) {
            *l = (*l).max(o);
        }
        Self {
            outside: self.outside.max(other.outside),
            resets: self.resets + other.resets,
            injected: self.injected + other.injected,
            faults: self.faults + other.faults,
            homed: self.homed + other.homed,
            legs: self.legs + other.legs,
            latency,
        }
    }
}

const KINDS: usize = 7;
const NAMES: [&str; KINDS] = [
    "driver fault",
    "rotor stuck",
    "encoder silent",
    "encoder frozen",
    "encoder jumps",
    "switch broken",
    "switch hangs",
];

fn inject(kind: usize, plant: &mut Plant, rng: &mut ChaCha8Rng) {
    let home = plant.home();
    let faults = &mut plant.faults;
    match kind {
        0 => faults.driver_fault = true,
        1 => faults.stuck = true,
        2 => faults.encoder_silent = true,
        3 => faults.encoder_frozen = true,
        4 => faults.encoder_slip = rng.random_range(COUNTS_PER_TURN / 200..COUNTS_PER_TURN / 2),
        5 => faults.home_broken = true,
        // As the reading is now: it hangs unseen until the rotor passes the edge.
        _ => faults.home_stuck = home,
    }
}

/// One unit for some seconds: it calibrates (where the settings have no offset), homes, runs; meanwhile its controller
/// is reset, faults come and go, and commands are given, all at random instants.
fn campaign(seed: u64) -> Tally {
    let mut rng = ChaCha8Rng::seed_from_u64(seed ^ 0x5eed);
    let mut plant = PlantConfig::default().varied(seed, SPREAD);
    plant.home_edge += rng.random_range(-5.0..5.0) * DEG;
    let mut config = Config::default();
    if let Homing::HomeSwitch(switch) = &mut config.homing {
        // Not to spend the run on it.
        switch.rate = (40.0 * DEG) as f32;
    }
    if rng.random_bool(0.8) {
        let error = rng.random_range(-5.0..5.0) * DEG;
        config.motor.electrical_offset = Some((plant.electrical_offset + error) as f32);
    }
    // Half of them start near an end, where it matters.
    let start = match seed % 4 {
        0 => rng.random_range(-3.0..12.0),
        1 => rng.random_range(348.0..363.0),
        _ => rng.random_range(-3.0..363.0),
    };
    let mut bench = Bench::new(plant, config, start * DEG, seed);
    let travel = f64::from(config.schedule.travel);
    let mut tally = Tally::default();
    // Since when a fault is in the plant, and which.
    let mut broken: Option<(u32, usize)> = None;
    let mut down_since: Option<u32> = None;
    // Whether the loops have been closed ever since.
    let mut closed = false;
    for k in 0..7_500_u32 {
        if rng.random_bool(1.0 / 4000.0) {
            bench.rotor = Rotor::new(bench.config).unwrap();
            // A reset takes the outputs away.
            bench.plant.outputs_off();
            tally.resets += 1;
            down_since = None;
            closed = false;
        }
        if broken.is_none() && rng.random_bool(1.0 / 4000.0) {
            let kind = rng.random_range(0..KINDS);
            inject(kind, &mut bench.plant, &mut rng);
            broken = Some((k, kind));
            tally.injected += 1;
            closed = true;
        }
        closed &= matches!(
            bench.rotor.state(),
            State::Homing(_) | State::Running(_) | State::Stopping(_)
        );
        let outputs = bench.tick();
        let off = outputs.drive.is_none();
        tally.outside = tally
            .outside
            .max(-bench.plant.angle() / DEG)
            .max((bench.plant.angle() - travel) / DEG);
        assert!(
            !bench.plant.wound_past(),
            "seed {seed} tick {k} {:?}",
            bench.rotor.state()
        );
        match *bench.rotor.state() {
            State::Fault(_) => {
                assert!(off, "seed {seed} tick {k}");
                assert!(!bench.plant.driven());
                if down_since.is_none() {
                    down_since = Some(k);
                    tally.faults += 1;
                    if let Some((since, kind)) = broken.filter(|_| closed) {
                        tally.latency[kind] = tally.latency[kind].max(k - since + 1);
                    }
                }
                // Someone repairs it and clears the fault.
                if down_since.is_some_and(|since| k - since > 100) {
                    bench.plant.faults = PlantFaults::default();
                    broken = None;
                    down_since = None;
                    bench.rotor.command(Command::Clear).unwrap();
                }
            }
            State::Off => {
                // A hanging switch in the overlap of the turns cannot be told from a good one at rest: see the
                // rotor's documentation. It is repaired before the unit starts again.
                bench.plant.faults.home_stuck = None;
                if broken.is_some_and(|(since, kind)| kind == 6 || k - since > 300) {
                    bench.plant.faults = PlantFaults::default();
                    broken = None;
                }
                let command = if bench.rotor.electrical_offset().is_none() {
                    Command::Calibrate
                } else if !bench.rotor.homed() {
                    Command::Home
                } else if rng.random_bool(0.3) {
                    Command::MoveTo((rng.random_range(0.0..360.0) * DEG) as f32)
                } else {
                    Command::Run
                };
                // Refused while angle or switch are not there.
                let _ = bench.rotor.command(command);
            }
            State::Running(run) => {
                tally.legs += u32::from(run.on_schedule());
                tally.homed += 1;
                if rng.random_bool(1.0 / 5000.0) {
                    let command = if rng.random_bool(0.5) {
                        Command::Stop
                    } else {
                        Command::Off
                    };
                    bench.rotor.command(command).unwrap();
                }
            }
            _ => {}
        }
    }
    tally
}

#[test]
fn a_thousand_runs_with_resets_and_faults() {
    let tally = (0..1000_u64)
        .into_par_iter()
        .map(campaign)
        .reduce(Tally::default, Tally::with);
    println!("{tally:?}");
    for (name, ticks) in NAMES.into_iter().zip(tally.latency) {
        println!("{name}: outputs off after {ticks} ms at most");
    }
    // In closed loop, ticks of 1 ms: detection, and the outputs off in the same tick.
    let [driver, stuck, silent, frozen, jumps, broken, _] = tally.latency;
    assert_eq!(driver, 1);
    assert!(silent.max(jumps) <= 3, "{tally:?}");
    // A contact that changes over has neither line high for some milliseconds.
    assert!(broken <= 20, "{tally:?}");
    // Next to a turn-around, where standing still is no fault yet.
    assert!(stuck <= 300 && frozen <= 150, "{tally:?}");
    // The runs must have met what they are for.
    assert!(
        tally.resets > 1500 && tally.injected > 1500 && tally.faults > 1000,
        "{tally:?}"
    );
    assert!(tally.legs > 1_000_000, "{tally:?}");
    let HomeSwitch { hard, .. } = HomeSwitch::default();
    println!(
        "furthest outside the travel: {:.2}°, hard limit {:.0}°",
        tally.outside,
        f64::from(hard) / DEG
    );
}
