//! The whole unit in virtual time: alignment, determinism, lost samples, faults.
#![allow(clippy::unwrap_used, reason = "tests")]

#[path = "common/answer.rs"]
mod answer;
#[path = "common/paper.rs"]
mod paper;

use std::collections::BTreeMap;

use app::blackbox::CRASHES;
use app::fault::Task;
use app::hal::ResetCause;
use app::settings::Source;
use hal_sim::align::Method;
use hal_sim::bus::UartLine;
use hal_sim::scenario::{FaultAt, FaultKind, Scenario};
use hal_sim::unit_sim::{self, Line, Observer, RobustSession, UnitResult};
use rayon::prelude::*;

use paper::paper;

fn run(scenario: &Scenario, seed: u64) -> UnitResult {
    unit_sim::run(scenario, seed, Method::Robust, &mut ()).unwrap()
}

fn rms(values: impl IntoIterator<Item = f64>) -> f64 {
    let values: Vec<f64> = values.into_iter().collect();
    (values.iter().map(|x| x * x).sum::<f64>() / values.len() as f64).sqrt()
}

#[derive(Default)]
struct Lines(Vec<String>);

impl Observer for Lines {
    fn line(&mut self, line: &Line) {
        self.0.push(line.to_string());
    }
}

#[test]
fn one_seed_one_log() {
    let mut scenario = paper();
    scenario.run.duration_s = 70.0;
    scenario.buses.edge_loss = 0.01;
    scenario.fault.push(FaultAt {
        at_s: 60.0,
        for_s: Some(0.1),
        kind: FaultKind::ImuCrc,
    });
    let run = || {
        let mut lines = Lines::default();
        let result = unit_sim::run(&scenario, 5, Method::Robust, &mut lines).unwrap();
        (result, lines.0)
    };
    let (a, b) = (run(), run());
    assert!(a.1.len() > 100);
    assert_eq!(a, b);
}

/// Twenty seeds, each beside the core alone on the same motion and sensor errors, and once more with 1 % of the
/// data-ready edges lost. Two sets of independent errors would differ by 1/√20 = 22 % (1σ) by chance alone.
#[test]
fn heading_is_the_cores_and_lost_samples_cost_little() {
    let lossy = {
        let mut scenario = paper();
        scenario.buses.edge_loss = 0.01;
        scenario
    };
    let runs: Vec<(UnitResult, UnitResult)> = (1..=20_u64)
        .into_par_iter()
        .map(|seed| (run(&paper(), seed), run(&lossy, seed)))
        .collect();
    let heading = |moment: &Option<unit_sim::UnitMoment>| moment.as_ref().unwrap().error.heading_deg;
    for (unit, lossy) in &runs {
        assert_eq!((unit.state, lossy.state), ("aligned", "aligned"), "seed {}", unit.seed);
        assert!(unit.faults.is_empty() && lossy.faults.is_empty(), "{:?}", unit.faults);
        assert_eq!(
            (unit.samples.lost, unit.samples.repeated, unit.samples.overruns),
            (0, 0, 0)
        );
        assert_eq!(u64::from(lossy.samples.lost), lossy.samples.edges_lost);
        assert!(lossy.samples.lost > 400);
        assert!(!unit.wound_past);
    }
    let core = rms(runs.iter().map(|(unit, _)| heading(&unit.core)));
    let unit = rms(runs.iter().map(|(unit, _)| heading(&unit.last)));
    let lossy = rms(runs.iter().map(|(_, lossy)| heading(&lossy.last)));
    println!("heading rms: core {core:.4} deg, unit {unit:.4}, with 1 % of samples lost {lossy:.4}");
    assert!((unit / core - 1.0).abs() < 0.1, "{unit} {core}");
    assert!(lossy / unit < 1.1, "{lossy} {unit}");
}

/// A motor loop that stalls for 7 ms is no fault yet, but has no angle for some samples: 0.1° of the rotor's turn each,
/// which would be missing from heading.
#[test]
fn samples_without_an_angle_are_bridged() {
    let mut scenario = paper();
    scenario.run.duration_s = 200.0;
    scenario.fault = (0..30_u8)
        .map(|k| FaultAt {
            at_s: 50.0 + 5.0 * f64::from(k),
            for_s: Some(0.007),
            kind: FaultKind::HangMotor,
        })
        .collect();
    let off = (1..=3).map(|seed| {
        let mut lines = Lines::default();
        let result = unit_sim::run(&scenario, seed, Method::Robust, &mut lines).unwrap();
        assert!(result.faults.is_empty(), "{:?}", result.faults);
        assert_eq!((result.state, result.samples.lost), ("aligned", 0));
        let bridged = lines.0.iter().filter(|line| line.contains("bridged")).count();
        // The angle is known for 5 ms beyond the last reading, and a sample takes 4.94 ms.
        assert!((5..=20).contains(&bridged), "seed {seed}: {bridged}");
        let heading = |moment: &Option<unit_sim::UnitMoment>| moment.as_ref().unwrap().error.heading_deg;
        let off = heading(&result.last) - heading(&result.core);
        println!("seed {seed}: {bridged} bridged, heading off the core's by {off:.4} deg");
        off
    });
    // A stall leaves the rotor to its friction and the swing: not all of it is a straight line to bridge.
    let off = rms(off);
    assert!(off < 0.15, "{off}");
}

/// DEC_RATE is written with what it holds already: the part begins its sample anew and counts on, so that up to a period
/// of the swing is in no sample. On a base that tilts by 8 °/s that is up to 0.04°, and 10° of heading if it is taken for
/// none.
#[test]
fn a_sample_that_slips_is_a_gap() {
    let scenario = paper();
    let heading = |seed, slips: &[u64]| {
        let mut lines = Lines::default();
        let mut session = RobustSession::new(&scenario, seed, Method::Robust, &[]).unwrap();
        for at_us in slips {
            session.run_until_us(*at_us, &mut lines).unwrap();
            session.set_fault(FaultKind::ImuRate, false);
        }
        session.run_until_us(150_000_000, &mut lines).unwrap();
        let slipped = lines.0.iter().filter(|line| line.contains(" ms late")).count();
        let moment = session.moment().unwrap();
        (moment.error.heading_deg, moment.reading.sd.heading_deg, slipped)
    };
    for seed in 1..=4 {
        let slips = [20_001_000, 31_302_000, 42_703_000, 55_104_000, 90_000_500];
        let ((with, sd, slipped), (without, ..)) = (heading(seed, &slips), heading(seed, &[]));
        println!("seed {seed}: {slipped} slipped, heading off by {with:.3} deg, {without:.3} without, sd {sd:.3}");
        assert_eq!(slipped, slips.len());
        assert!((with - without).abs() < 0.3 * sd, "{with} {without} {sd}");
    }
}

/// Too short for a fault, and wrong all the same: 3 samples of the z gyro at the end of its range are 5° of heading, 4 that
/// repeat one datum of a swing some hundredths of a degree of tilt.
#[test]
fn what_is_clipped_or_repeated_is_a_gap() {
    let scenario = paper();
    let heading = |seed, glitch: Option<(FaultKind, u64)>| {
        let mut session = RobustSession::new(&scenario, seed, Method::Robust, &[]).unwrap();
        if let Some((kind, length_us)) = glitch {
            session.run_until_us(90_001_000, &mut ()).unwrap();
            session.set_fault(kind, true);
            session.run_until_us(90_001_000 + length_us, &mut ()).unwrap();
            session.set_fault(kind, false);
        }
        session.run_until_us(150_000_000, &mut ()).unwrap();
        assert!(session.take_faults().is_empty());
        let moment = session.moment().unwrap();
        (moment.error.heading_deg, moment.reading.sd.heading_deg)
    };
    for seed in 1..=3 {
        let (without, _) = heading(seed, None);
        for (kind, length_us) in [(FaultKind::ImuSaturated, 15_000), (FaultKind::ImuStuckData, 25_000)] {
            let (with, sd) = heading(seed, Some((kind, length_us)));
            println!("seed {seed}: {kind:?}: heading off by {with:.3} deg, {without:.3} without, sd {sd:.3}");
            assert!((with - without).abs() < sd, "{kind:?}: {with} {without} {sd}");
        }
    }
}

/// Where the unit is some time after a fault that lasts for a second.
fn outcome(result: &UnitResult) -> String {
    let found = &result.faults[0];
    let after: Vec<&str> = result
        .modes
        .iter()
        .filter(|at| at.t_s > found.t_s && at.mode != "fault")
        .map(|at| at.mode)
        .collect();
    if result.resets > 0 {
        format!("reset, then {}", result.state)
    } else if after.is_empty() {
        "latched until reset by command".to_owned()
    } else {
        format!(
            "{} retries, then {}",
            after.iter().filter(|mode| **mode == "self-test").count(),
            result.state
        )
    }
}

#[test]
fn every_fault_is_found_in_time_and_the_motor_is_off() {
    use FaultKind as F;
    let table = [
        (F::ImuEdges, "imu-silent"),
        (F::ImuSilent, "imu-transfer"),
        (F::ImuCrc, "imu-transfer"),
        (F::ImuSaturated, "imu-saturated"),
        (F::ImuStuckData, "imu-stuck"),
        (F::ImuStuckCounter, "imu-stuck"),
        (F::ImuFlags, "imu-flags"),
        (F::ImuHot, "over-temperature"),
        (F::ImuRate, "clock"),
        (F::ImuBus, "task-overrun"),
        (F::EncoderSilent, "encoder-invalid"),
        (F::EncoderCrc, "encoder-invalid"),
        (F::EncoderFrozen, "encoder-frozen"),
        (F::EncoderWeak, "encoder-warning"),
        (F::Driver, "driver"),
        (F::Jam, "stall"),
        (F::HomeBroken, "rotor"),
        (F::HomeStuck, "rotor"),
        (F::HangSampling, "task-overrun"),
        (F::HangMotor, "task-overrun"),
        (F::HangAlignment, "task-overrun"),
    ];
    // In a leg, near a turning point, and while the fine filter replays.
    let instants = [40.0, 80.13, 100.0037, 113.77];
    let rows: Vec<_> = table
        .par_iter()
        .map(|(kind, name)| {
            let (mut found_ms, mut off_ms, mut allowed) = (0.0_f64, 0.0_f64, 0);
            let mut next = String::new();
            for (seed, at_s) in instants.into_iter().enumerate() {
                let mut scenario = paper();
                scenario.run.duration_s = 250.0;
                let for_s = Some(if *kind == F::HomeStuck { 20.0 } else { 1.0 });
                scenario.fault.push(FaultAt {
                    at_s,
                    for_s,
                    kind: *kind,
                });
                let result = run(&scenario, seed as u64);
                let found = result
                    .faults
                    .first()
                    .unwrap_or_else(|| panic!("{kind:?} at {at_s} s was not found"));
                assert_eq!(found.name, *name, "{kind:?} at {at_s}: {}", found.text);
                assert!(!result.wound_past, "{kind:?}");
                found_ms = found_ms.max(1e3 * (found.t_s - at_s));
                off_ms = off_ms.max(found.motor_off_ms);
                allowed = found.allowed_ms;
                next = outcome(&result);
            }
            (kind, name, found_ms, off_ms, allowed, next)
        })
        .collect();
    println!("| injected | found as | found in | allowed | motor off in | what next |\n|---|---|---|---|---|---|");
    for (kind, name, found_ms, off_ms, allowed, next) in &rows {
        println!("| {kind:?} | {name} | {found_ms:.1} ms | {allowed} ms | {off_ms:.3} ms | {next} |");
    }
    for (kind, _, found_ms, off_ms, allowed, _) in &rows {
        assert!(*found_ms <= f64::from(*allowed), "{kind:?}: {found_ms} ms");
        assert!(*off_ms <= 2.0, "{kind:?}: {off_ms} ms");
    }
}

/// What a unit says and answers.
#[derive(Default)]
struct Said {
    lines: Vec<String>,
    answers: Vec<String>,
    /// The last sentence of each kind, its fields.
    sentences: BTreeMap<String, Vec<String>>,
}

impl Observer for Said {
    fn line(&mut self, line: &Line) {
        self.lines.push(line.text.clone());
    }

    fn sentence(&mut self, line: &UartLine) {
        self.answers.extend(answer::answer(line));
        let text = String::from_utf8_lossy(&line.bytes);
        let fields: Vec<_> = text.split(['*', ',']).map(str::to_owned).collect();
        self.sentences.insert(fields[0].clone(), fields);
    }
}

/// A unit in somebody's hands.
struct Unit {
    session: RobustSession,
    said: Said,
}

impl Unit {
    fn new(seed: u64) -> Self {
        let session = RobustSession::new(&paper(), seed, Method::Robust, &[]).unwrap();
        Self {
            session,
            said: Said::default(),
        }
    }

    /// Runs for so long; the resets on the way.
    fn run(&mut self, seconds: f64) -> Vec<ResetCause> {
        let end_us = self.session.now_us() + (seconds * 1e6) as u64;
        let mut resets = Vec::new();
        while self.session.now_us() < end_us {
            resets.extend(self.session.run_until_us(end_us, &mut self.said).unwrap());
        }
        resets
    }

    /// What is answered to a line.
    fn asked(&mut self, line: &str) -> Vec<String> {
        self.said.answers.clear();
        self.session.send(format!("{line}\r\n").as_bytes());
        self.run(1.0);
        core::mem::take(&mut self.said.answers)
    }

    /// A receiver says it every second for so long.
    fn hears(&mut self, body: &str, seconds: u32) {
        let sum = body.bytes().fold(0, |sum, byte| sum ^ byte);
        for _ in 0..seconds {
            self.session.send(format!("${body}*{sum:02X}\r\n").as_bytes());
            self.run(1.0);
        }
    }

    /// Speed by the unit's VTG, km/h.
    fn speed(&self) -> f64 {
        self.said.sentences["$HEVTG"][7].parse().unwrap()
    }

    fn mode(&self) -> (&'static str, Option<&'static str>) {
        let status = self.session.status().unwrap();
        (status.mode.as_str(), status.fault.map(|fault| fault.name()))
    }
}

/// A fault that ends in a reset is told by the log of the next start and on the serial line; others are on record as
/// well. What a reset keeps is gone with the supply.
#[test]
fn what_was_wrong_outlives_a_reset() {
    let mut unit = Unit::new(3);
    assert_eq!(unit.run(30.0), []);
    assert_eq!(unit.said.lines[1], "started by power on");
    assert_eq!(unit.asked("faults"), ["ok,no more faults"]);
    unit.session.set_fault(FaultKind::EncoderSilent, true);
    unit.run(0.1);
    unit.session.set_fault(FaultKind::EncoderSilent, false);
    unit.run(49.0);
    unit.session.set_fault(FaultKind::HangMotor, true);
    assert_eq!(unit.run(1.0), [ResetCause::Watchdog]);
    let started = "started by watchdog; before: fault task-overrun motor in mode coarse after 80 s";
    assert!(
        unit.said.lines.iter().any(|line| line == started),
        "{:?}",
        unit.said.lines
    );
    let answers = [
        "ok,start 1 31 s encoder-invalid in coarse",
        "ok,start 1 80 s task-overrun motor in coarse",
        "ok,no more faults",
    ];
    assert_eq!(unit.asked("faults"), answers);
    // By the reset line and by command nothing is lost either, and none of it is a crash.
    unit.session.reset(ResetCause::Pin, &mut unit.said).unwrap();
    unit.run(1.0);
    assert_eq!(unit.asked("restart"), ["ok,restarting"]);
    let started = "started by watchdog, as asked";
    assert!(
        unit.said.lines.iter().any(|line| line == started),
        "{:?}",
        unit.said.lines
    );
    assert_eq!(unit.asked("faults"), answers);
    assert_eq!(unit.asked("faults clear"), ["ok,forgotten"]);
    assert_eq!(unit.asked("faults"), ["ok,no more faults"]);
    unit.session.set_fault(FaultKind::Driver, true);
    unit.run(30.0);
    assert_eq!(unit.session.records().len(), 1);
    unit.said.lines.clear();
    unit.session.reset(ResetCause::PowerOn, &mut unit.said).unwrap();
    assert_eq!(unit.session.records(), []);
    unit.run(1.0);
    assert_eq!(unit.said.lines[2], "started by power on");
}

/// While the rotor rests to calibrate the gyros nothing turns, but no angle means no sample: a fault, and not five minutes of
/// waiting.
#[test]
fn an_encoder_that_falls_silent_at_rest_is_found() {
    let mut unit = Unit::new(4);
    unit.run(16.0);
    assert_eq!(unit.asked("stop"), ["ok,the rotor stops"]);
    unit.run(1.0);
    assert_eq!(
        unit.asked("calibrate"),
        ["ok,calibrating: keep the base still for 3 minutes"]
    );
    unit.run(20.0);
    assert_eq!(unit.mode(), ("calibrating", None));
    unit.session.set_fault(FaultKind::EncoderSilent, true);
    unit.run(0.03);
    assert_eq!(unit.mode(), ("fault", Some("encoder-invalid")));
    unit.session.set_fault(FaultKind::EncoderSilent, false);
    // It begins again, from the self-test on.
    unit.run(20.0);
    assert_eq!(unit.mode(), ("calibrating", None));
}

/// Whatever happens to a unit that was told to stop, its rotor stands until somebody says otherwise.
#[test]
fn what_was_stopped_stays_so_over_faults_and_crashes() {
    let mut unit = Unit::new(5);
    unit.run(30.0);
    assert_eq!(unit.asked("stop"), ["ok,the rotor stops"]);
    unit.run(2.0);
    for kind in [FaultKind::EncoderSilent, FaultKind::ImuSilent, FaultKind::ImuStuckData] {
        unit.session.set_fault(kind, true);
        unit.run(0.1);
        assert_eq!(unit.mode().0, "fault", "{kind:?}");
        unit.session.set_fault(kind, false);
        unit.run(5.0);
        assert_eq!(
            (unit.mode(), unit.session.driven()),
            (("idle", None), false),
            "{kind:?}"
        );
    }
    // Told in the fault, it holds as well.
    assert_eq!(unit.asked("align"), ["ok,aligning"]);
    unit.run(20.0);
    assert_eq!(unit.mode().0, "coarse");
    unit.session.set_fault(FaultKind::Driver, true);
    unit.run(0.1);
    assert_eq!(unit.mode(), ("fault", Some("driver")));
    assert_eq!(unit.asked("stop"), ["ok,the rotor stops"]);
    unit.session.set_fault(FaultKind::Driver, false);
    unit.run(20.0);
    assert_eq!((unit.mode(), unit.session.driven()), (("idle", None), false));
    // A crash is no start that somebody wants; a restart is.
    unit.session.set_fault(FaultKind::HangMotor, true);
    assert_eq!(unit.run(1.0), [ResetCause::Watchdog]);
    unit.session.set_fault(FaultKind::HangMotor, false);
    unit.run(20.0);
    assert_eq!((unit.mode(), unit.session.driven()), (("idle", None), false));
    assert_eq!(unit.asked("restart"), ["ok,restarting"]);
    unit.run(20.0);
    assert_eq!(unit.mode().0, "coarse");
}

/// A home switch that hangs is found as soon as the rotor is told to move by it, or where the edge should have been.
#[test]
fn a_home_switch_that_hangs_is_found_at_the_start() {
    for seed in 0..6 {
        let mut unit = Unit::new(seed);
        unit.session.set_fault(FaultKind::HomeStuck, true);
        unit.run(40.0);
        assert_eq!(unit.mode(), ("fault", Some("rotor")), "seed {seed}");
        assert!(!unit.session.wound_past());
    }
}

/// A fault that is latched stays so over every reset but that of power-on: what hangs still does, and the rotor does not know
/// its turn any more.
#[test]
fn what_is_latched_stays_latched_over_a_reset() {
    let mut unit = Unit::new(2);
    unit.session.set_fault(FaultKind::HomeStuck, true);
    unit.run(40.0);
    assert_eq!(unit.mode(), ("fault", Some("rotor")));
    let held = ("fault", Some("held"));
    unit.session.set_fault(FaultKind::HangMotor, true);
    assert_eq!(unit.run(1.0), [ResetCause::Watchdog]);
    unit.session.set_fault(FaultKind::HangMotor, false);
    for cause in [ResetCause::Pin, ResetCause::BrownOut] {
        unit.run(30.0);
        assert_eq!((unit.mode(), unit.session.driven()), (held, false));
        unit.session.reset(cause, &mut unit.said).unwrap();
    }
    assert_eq!(unit.asked("restart"), ["ok,restarting"]);
    unit.run(30.0);
    assert_eq!((unit.mode(), unit.session.driven()), (held, false));
    assert!(!unit.session.wound_past());
    let faults = unit.asked("faults");
    assert!(faults.iter().any(|line| line.contains(" rotor in ")), "{faults:?}");
    unit.session.set_fault(FaultKind::HomeStuck, false);
    assert_eq!(unit.asked("reset"), ["ok,starting again"]);
    unit.run(100.0);
    assert_eq!(unit.mode(), ("aligned", None));
    // Of a fault that is over nothing is left.
    unit.session.reset(ResetCause::Pin, &mut unit.said).unwrap();
    unit.run(100.0);
    assert_eq!(unit.mode(), ("aligned", None));
}

/// Whatever task hangs at every start: after three of them the motor stays off and the unit stays up to say so. Neither
/// a restart nor the reset line let it go on, only the command does.
#[test]
fn a_boot_loop_ends_with_the_motor_off() {
    for (seed, task) in Task::ALL.into_iter().enumerate() {
        let mut unit = Unit::new(seed as u64);
        unit.run(2.0);
        unit.session.set_fault(
            match task {
                Task::Sampling => FaultKind::HangSampling,
                Task::Motor => FaultKind::HangMotor,
                Task::Alignment => FaultKind::HangAlignment,
            },
            true,
        );
        unit.session.hang_at_start(Some(task));
        assert_eq!(unit.run(100.0).len(), CRASHES as usize, "{task:?}");
        let loops = ("fault", Some("boot-loop"));
        assert_eq!((unit.mode(), unit.session.driven()), (loops, false));
        let answers = unit.asked("align");
        assert_eq!(answers, ["error,not now: wait  or reset the fault"]);
        assert_eq!(unit.asked("faults").len(), 4, "{task:?}");
        unit.session.reset(ResetCause::Pin, &mut unit.said).unwrap();
        unit.run(100.0);
        assert_eq!((unit.mode(), unit.session.driven()), (loops, false));
        // Let go while the task still hangs, it crashes again.
        assert_eq!(unit.asked("reset"), ["ok,starting again"]);
        unit.run(100.0);
        assert_eq!((unit.mode(), unit.session.driven()), (loops, false));

        unit.session.hang_at_start(None);
        assert_eq!(unit.asked("restart"), ["ok,restarting"]);
        unit.run(10.0);
        assert_eq!((unit.mode(), unit.session.driven()), (loops, false));
        assert_eq!(unit.asked("reset"), ["ok,starting again"]);
        unit.run(100.0);
        assert_eq!(unit.mode(), ("aligned", None), "{task:?}");
    }
}

/// What a receiver of satellite navigation is good for: it says whether the base stands, and where; the navigator goes by it.
/// What it does not stand by changes nothing.
#[test]
fn a_receiver_says_whether_the_base_stands_and_where() {
    let mut unit = Unit::new(5);
    unit.run(80.0);
    assert_eq!(unit.mode().0, "aligned");
    // Without a fix, by its own dead reckoning, once by mistake.
    unit.hears("GPVTG,90.0,T,,M,10.0,N,18.5,K,N", 5);
    unit.hears("GPRMC,120000,V,4000.6,N,00500.0,W,10.0,90.0,010126,,,N", 5);
    unit.hears("GPVTG,90.0,T,,M,10.0,N,18.5,K,A", 1);
    unit.hears("GPVTG,,T,,M,0.1,N,0.2,K,A", 5);
    assert_eq!(unit.mode().0, "aligned");
    assert_eq!(unit.session.result().settings.last_position.source, Source::Default);

    // Under way: there is nothing to align, however long it lasts.
    unit.hears("GPVTG,90.0,T,,M,10.0,N,18.5,K,A", 2);
    assert_eq!(unit.mode().0, "coarse");
    unit.hears("GPVTG,90.0,T,,M,10.0,N,18.5,K,A", 100);
    assert_eq!(unit.mode().0, "coarse");
    assert_eq!(unit.said.sentences["$HETHS"][1..3], ["", "V"]);
    let told = |line: &&String| line.as_str() == "starting anew once the base stands: it makes 5.1 m/s";
    assert_eq!(unit.said.lines.iter().filter(told).count(), 1);
    unit.hears("GPRMC,120000,A,4000.6,N,00500.0,W,0.0,,010126,,,A", 65);
    assert_eq!(unit.mode().0, "aligned");
    // Where it was is known after power-on.
    unit.session.reset(ResetCause::PowerOn, &mut unit.said).unwrap();
    unit.run(90.0);
    let place = unit.session.result().settings.last_position;
    assert_eq!(place.source, Source::Gnss);
    assert!((place.latitude.to_degrees() - 40.01).abs() < 1e-5 && (place.longitude.to_degrees() + 5.0).abs() < 1e-5);

    // Dead reckoning drifts; with the receiver's word it does not.
    assert_eq!(unit.asked("navigate"), ["ok,navigating"]);
    unit.run(120.0);
    let alone = unit.speed();
    unit.hears("GPRMC,120000,A,4030.0,N,00500.0,W,0.0,,010126,,,A", 20);
    let aided = unit.speed();
    println!("speed {alone} and {aided} km/h");
    assert!(alone > 10.0 * aided && aided < 0.05, "{alone} {aided}");
    let place = &unit.said.sentences["$HEGLL"];
    assert!(place[1].starts_with("4030.00"), "{place:?}");
    let error = unit.session.result().last.unwrap().error.heading_deg;
    assert!(error.abs() < 2.0, "{error}");
}

/// The time of day of a receiver goes into the unit's sentences, over midnight and on without the receiver.
#[test]
fn a_receivers_time_goes_into_the_sentences() {
    let mut unit = Unit::new(6);
    unit.run(80.0);
    assert_eq!(unit.said.sentences["$PASHR"][1], "");
    assert_eq!(unit.asked("navigate"), ["ok,navigating"]);
    for second in 0..5 {
        let time = (86_397 + second) % 86_400;
        let hhmmss = format!("{:02}{:02}{:02}.00", time / 3600, time / 60 % 60, time % 60);
        unit.hears(&format!("GPRMC,{hhmmss},A,4000.0,N,00000.0,E,0.0,,010126,,,A"), 1);
    }
    // The last was of 00:00:01, a second ago.
    let of = |unit: &Unit, sentence: &str, field: usize| unit.said.sentences[sentence][field].parse::<f64>().unwrap();
    let is = |found: f64, expected: f64| assert!(found <= expected && found > expected - 0.25, "{found} {expected}");
    is(of(&unit, "$PASHR", 1), 2.0);
    is(of(&unit, "$HEGLL", 5), 2.0);
    unit.run(65.0);
    is(of(&unit, "$PASHR", 1), 107.0);
    is(of(&unit, "$HEGLL", 5), 107.0);
    // What the receiver does not stand by changes nothing.
    unit.hears("GPRMC,120000,V,4000.0,N,00000.0,E,0.0,,010126,,,N", 2);
    is(of(&unit, "$PASHR", 1), 109.0);
}

/// A receiver that has just been switched on may say 0°, 0°, or anything once. What it goes on saying is believed, also where
/// the unit has been carried far while it was off.
#[test]
fn a_place_far_from_the_last_is_believed_once_fixes_agree() {
    const HERE: &str = "GPRMC,120000,A,4000.6,N,00500.0,W,0.0,,010126,,,A";
    const NULL: &str = "GPRMC,120000,A,0000.0,N,00000.0,E,0.0,,010126,,,A";
    const AWAY: &str = "GPRMC,120000,A,6000.0,N,00500.0,W,0.0,,010126,,,A";
    const AWAY_EAST: &str = "GPRMC,120000,A,6000.0,N,00500.0,E,0.0,,010126,,,A";
    let latitude = |unit: &Unit| unit.session.result().settings.position().latitude.to_degrees();
    let mut unit = Unit::new(5);
    unit.session.forget_place();
    unit.session.reset(ResetCause::PowerOn, &mut unit.said).unwrap();
    // Of a unit that was never told a place one fix is not enough.
    unit.hears(HERE, 2);
    assert_eq!(unit.session.result().settings.last_position.source, Source::Default);
    unit.hears(HERE, 1);
    assert_eq!(unit.session.result().settings.last_position.source, Source::Gnss);

    // The first that is kept is written once a sector is erased.
    unit.run(5.0);
    unit.session.reset(ResetCause::PowerOn, &mut unit.said).unwrap();
    unit.hears(NULL, 1);
    unit.hears(AWAY, 2);
    unit.hears(AWAY_EAST, 1);
    unit.hears(AWAY, 1);
    unit.run(1.0);
    assert!((latitude(&unit) - 40.01).abs() < 1e-5, "{}", latitude(&unit));
    assert_eq!(unit.said.sentences["$PASHR"][1], "");
    // Not even said over and over: the place is in doubt, and so is the heading.
    unit.hears(NULL, 85);
    assert!((latitude(&unit) - 40.01).abs() < 1e-5, "{}", latitude(&unit));
    assert_eq!(
        (unit.mode().0, unit.said.sentences["$HETHS"][2].as_str()),
        ("aligned", "E")
    );
    // Until the receiver knows better, or is silent.
    unit.hears(HERE, 1);
    assert_eq!(unit.said.sentences["$HETHS"][2], "A");
    unit.hears(NULL, 1);
    assert_eq!(unit.said.sentences["$HETHS"][2], "E");
    unit.run(11.0);
    assert_eq!(unit.said.sentences["$HETHS"][2], "A");

    // Carried away: believed, and the alignment starts anew by it.
    unit.hears(AWAY, 2);
    assert_eq!(unit.said.sentences["$HETHS"][2], "E");
    unit.hears(AWAY, 1);
    assert!((latitude(&unit) - 60.0).abs() < 1e-4);
    let told = "starting anew: by the receiver the unit is at latitude 60.0 deg";
    assert_eq!(unit.said.lines.iter().filter(|line| line.as_str() == told).count(), 1);
    assert_eq!(unit.mode().0, "coarse");

    // A place that somebody has set stays, but not unquestioned.
    unit.hears(HERE, 3);
    assert_eq!(unit.asked("set latitude 40.01").len(), 1);
    unit.run(80.0);
    assert_eq!(unit.asked("align"), ["ok,aligning"]);
    unit.run(80.0);
    assert_eq!(unit.said.sentences["$HETHS"][2], "A");
    unit.hears(AWAY, 5);
    assert!((latitude(&unit) - 40.01).abs() < 1e-5, "{}", latitude(&unit));
    assert_eq!(
        (unit.mode().0, unit.said.sentences["$HETHS"][2].as_str()),
        ("aligned", "E")
    );
}

#[test]
fn a_rotor_by_legs_is_not_for_a_motor() {
    let mut scenario = paper();
    scenario.rotor.rate_spread = 0.2;
    let refused = unit_sim::run(&scenario, 1, Method::Robust, &mut ()).unwrap_err();
    assert_eq!(
        refused.to_string(),
        "rotor: a unit's motor knows neither legs nor rate_spread: `run` simulates the core alone"
    );
}
