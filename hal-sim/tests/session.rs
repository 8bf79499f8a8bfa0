//! Sessions with the whole unit: what is typed on its serial line, and what comes of it.
#![allow(clippy::unwrap_used, reason = "the helpers of tests are tests")]

#[path = "common/answer.rs"]
mod answer;

use app::hal::{ClockSource, ResetCause};
use app::nmea::Talker;
use frames::units::{DEG, DEG_PER_HOUR, PPM};
use hal_sim::align::Method;
use hal_sim::bus::UartLine;
use hal_sim::scenario::{FaultAt, FaultKind, Scenario};
use hal_sim::sensors::Imu;
use hal_sim::unit_sim::{self, Line, Observer, RobustSession, Supplied, Typed, UnitResult};

/// Answers of the unit, in order.
#[derive(Default)]
struct Answers(Vec<String>);

impl Observer for Answers {
    fn sentence(&mut self, line: &UartLine) {
        self.0.extend(answer::answer(line));
    }
}

fn session(scenario: &Scenario, seed: u64, seconds: f64, typed: &[&str]) -> (UnitResult, Vec<String>) {
    let mut scenario = scenario.clone();
    scenario.run.duration_s = seconds;
    let typed: Vec<Typed> = typed.iter().map(|text| text.parse().unwrap()).collect();
    let mut answers = Answers::default();
    let result = unit_sim::run_session(&scenario, seed, Method::Robust, &typed, &mut answers).unwrap();
    (result, answers.0)
}

fn modes(result: &UnitResult) -> Vec<&str> {
    result.modes.iter().map(|at| at.mode).collect()
}

/// Gyros as they are bought: 1000 ppm and 3′.
fn as_bought() -> Scenario {
    let mut scenario = Scenario::builtin("static").unwrap();
    scenario.imu.gyro_scale_factor_sd_ppm = 1000.0;
    scenario.imu.gyro_misalignment_sd_arcmin = 3.0;
    scenario
}

/// A minute at rest and 72 s of turns find the z column and the biases to what their 1σ say; to the biases' comes what
/// the heading leaves of Earth's rate, 0.6° of 11.5 °/h.
#[test]
fn an_aligned_unit_calibrates_its_gyros() {
    let scenario = as_bought();
    let (mut column, mut bias, mut count) = (0.0, 0.0, 0.0);
    for seed in 0..8 {
        let (result, answers) = session(&scenario, seed, 300.0, &["160 calibrate"]);
        assert_eq!(answers, ["ok,calibrating: keep the base still for 3 minutes"]);
        assert_eq!(modes(&result)[5..], ["calibrating", "idle"], "{:?}", result.modes);
        let found = result.settings.imu.calibration.unwrap();
        let imu = Imu::new(&scenario, seed);
        let (m, b) = (imu.gyro_matrix(), imu.gyro_bias_s());
        for (found_k, k) in [found.k_xz, found.k_yz, found.s_z].into_iter().zip(m.column(2).iter()) {
            let off = (f64::from(found_k) - k) / f64::from(found.column_sd);
            assert!(off.abs() < 5.0, "seed {seed}: {:.1} ppm, {off:.1} sd", k / PPM);
            column += off * off;
        }
        for (found_b, b) in found.bias_s.to_array().into_iter().zip(b.to_array()) {
            let earth = 0.6 * DEG * 11.5 * DEG_PER_HOUR;
            let off = (f64::from(found_b) - b) / f64::from(found.bias_sd).hypot(earth);
            assert!(
                off.abs() < 4.0,
                "seed {seed}: {:.2} deg/h, {off:.1} sd",
                b / DEG_PER_HOUR
            );
            bias += off * off;
        }
        count += 3.0;
    }
    // The z gyro's slope is also the encoder's, which its 1σ leaves out: 2 ppm of noise on 1440°.
    let (column, bias) = (column / count, bias / count);
    assert!(
        (0.3..3.0).contains(&column) && (0.2..2.0).contains(&bias),
        "{column:.2} {bias:.2}"
    );
}

/// From rest Earth's rate is not known: what goes with the rotor's rate is kept, the biases are left.
#[test]
fn a_unit_that_rests_calibrates_the_column_only() {
    let (result, answers) = session(&as_bought(), 3, 220.0, &["1 calibrate", "30 stop", "31 calibrate"]);
    assert!(
        answers[0].starts_with("error,only from rest or once aligned"),
        "{answers:?}"
    );
    assert_eq!(
        answers[1..],
        [
            "ok,the rotor stops",
            "ok,calibrating: keep the base still for 3 minutes"
        ]
    );
    assert_eq!(
        modes(&result)[3..],
        ["idle", "self-test", "calibrating", "idle"],
        "{:?}",
        result.modes
    );
    let found = result.settings.imu.calibration.unwrap();
    assert_eq!(found.bias_s.norm(), 0.0);
    let s_z = Imu::new(&as_bought(), 3).gyro_matrix()[(2, 2)];
    assert!((f64::from(found.s_z) - s_z).abs() < 30.0 * PPM);
}

/// What an aligned unit has found of the biases is better than what rest tells, and stays; the column is the later one.
#[test]
fn biases_once_known_outlive_a_calibration_from_rest() {
    let found = |seconds, typed: &[&str]| {
        let (result, _) = session(&as_bought(), 4, seconds, typed);
        assert_eq!(modes(&result).last(), Some(&"idle"), "{:?}", result.modes);
        result.settings.imu.calibration.unwrap()
    };
    let aligned = found(300.0, &["160 calibrate"]);
    let rest = found(450.0, &["160 calibrate", "300 calibrate"]);
    assert!(aligned.bias_s.norm() > 0.0);
    assert_eq!((rest.bias_s, rest.bias_sd), (aligned.bias_s, aligned.bias_sd));
    assert!(rest.s_z != aligned.s_z, "{rest:?}");
}

/// Gyros with biases of 1800 °/h, in which alignment finds nothing: calibrated at rest Earth's rate is all that is left of
/// them, and told so the unit finds north.
#[test]
fn a_cheap_part_is_calibrated_before_it_finds_north() {
    let mut scenario = Scenario::builtin("static").unwrap();
    scenario.imu.gyro_bias_sd_deg_h = 1800.0;
    let typed = [
        "20 stop",
        "25 calibrate",
        "170 set gyro-bias 20",
        "171 save",
        "172 restart",
    ];
    let mut square = 0.0;
    for seed in 1..=8 {
        let (result, answers) = session(&scenario, seed, 480.0, &typed);
        assert!(answers.iter().all(|answer| answer.starts_with("ok,")), "{answers:?}");
        assert_eq!(modes(&result).last(), Some(&"aligned"), "{:?}", result.modes);
        let last = result.last.unwrap();
        let off = last.error.heading_deg / last.reading.sd.heading_deg;
        println!(
            "seed {seed}: heading off by {:.3} deg, {off:.2} sd",
            last.error.heading_deg
        );
        assert!(off.abs() < 4.0, "seed {seed}: {off}");
        square += off * off / 8.0;
    }
    assert!((0.2..3.0).contains(&square), "{square}");
}

/// On a base that moves there is no calibration, and what was known before still holds.
#[test]
fn a_base_that_moves_is_no_place_to_calibrate() {
    let scenario = Scenario::builtin("paper-turntable").unwrap();
    let (result, _) = session(&scenario, 1, 320.0, &["150 calibrate"]);
    assert!(modes(&result).ends_with(&["calibrating", "idle"]), "{:?}", result.modes);
    assert_eq!(result.settings.imu.calibration, None);
    assert!(result.faults.is_empty());
}

/// Saved settings are there after a restart, others are not; the electrical offset need not be found again.
#[test]
fn what_was_saved_outlives_a_restart() {
    let scenario = Scenario::builtin("static").unwrap();
    let typed = [
        "20 set latitude 40.01",
        "21 set longitude -8.5",
        "22 save",
        "23 set latitude 41",
        "24 restart",
    ];
    let (result, answers) = session(&scenario, 2, 30.0, &typed);
    assert_eq!(answers[2], "ok,saved");
    assert_eq!(answers[4], "ok,restarting");
    assert_eq!(result.resets, 1);
    let place = result.settings.position();
    assert!((f64::from(place.latitude) - 40.01 * DEG).abs() < 1e-6);
    assert!((f64::from(place.longitude) + 8.5 * DEG).abs() < 1e-6);
    let homing: Vec<f64> = result
        .modes
        .windows(2)
        .filter(|pair| pair[0].mode == "homing")
        .map(|pair| pair[1].t_s - pair[0].t_s)
        .collect();
    assert!(homing[1] < homing[0] - 2.0, "{homing:?}");
    assert!(result.settings.encoder.electrical_offset.is_some() && result.faults.is_empty());
}

/// What the unit is called on the line, in the order of its coming.
#[derive(Default)]
struct Talkers(Vec<String>);

impl Observer for Talkers {
    fn sentence(&mut self, line: &UartLine) {
        let text = String::from_utf8_lossy(&line.bytes);
        // Those with a P are our own.
        if let Some(talker) = text.get(1..3).filter(|talker| !talker.starts_with('P')) {
            self.0.push(talker.to_owned());
            self.0.dedup();
        }
    }
}

/// Saved and started again, every sentence is the talker's; a word that is none changes nothing.
#[test]
fn the_talker_is_the_one_that_was_set() {
    let mut scenario = Scenario::builtin("static").unwrap();
    scenario.run.duration_s = 30.0;
    let typed = [
        "2 set talker hc",
        "10 save",
        "12 restart",
        "20 SET TALKER XX",
        "21 save",
        "22 restart",
    ];
    let typed: Vec<Typed> = typed.iter().map(|text| text.parse().unwrap()).collect();
    let mut talkers = Talkers::default();
    let result = unit_sim::run_session(&scenario, 1, Method::Robust, &typed, &mut talkers).unwrap();
    assert_eq!((talkers.0, result.resets), (vec!["HE".to_owned(), "HC".to_owned()], 2));
    assert_eq!(result.settings.output.talker, Talker::Hc);

    let typed = [
        "1 set talker In",
        "2 show",
        "3 set talker",
        "4 set talker 2",
        "5 set talker IN now",
    ];
    let (_, answers) = session(&scenario, 1, 7.0, &typed);
    assert_eq!(answers[0], "ok,set - save it then restart");
    assert!(answers.contains(&"ok,talker IN ".to_owned()), "{answers:?}");
    assert_eq!(
        answers[answers.len() - 3..],
        [
            "error,expected talker HE  HC  IN or GP",
            "error,expected talker HE  HC  IN or GP",
            "error,expected nothing more on the line",
        ]
    );
}

/// Ten minutes of dead reckoning: the place goes off as gyros and accelerometers say, the heading is within its 1σ.
#[test]
fn an_aligned_unit_navigates() {
    let scenario = Scenario::builtin("static").unwrap();
    let mut drift = 0.0;
    for seed in 0..6 {
        let (result, answers) = session(&scenario, seed, 700.0, &["50 navigate", "100 navigate"]);
        assert_eq!(answers, ["error,only once aligned", "ok,navigating"]);
        assert_eq!(result.state, "navigating");
        let last = result.last.unwrap();
        let track = last.track.unwrap();
        assert!(
            last.error.heading_deg.abs() < 4.0 * last.reading.sd.heading_deg,
            "{last:?}"
        );
        // Ten minutes on the z gyro's bias, whose 1σ are 9 °/h, and 0.7° to begin with.
        assert!(
            (1.5..2.2).contains(&last.reading.sd.heading_deg),
            "{}",
            last.reading.sd.heading_deg
        );
        assert!(
            last.error.pitch_deg.abs() < 0.1 && last.error.roll_deg.abs() < 0.1,
            "{last:?}"
        );
        drift += track.east_m.powi(2) + track.north_m.powi(2);
    }
    let drift = (drift / 6.0_f64).sqrt();
    assert!((20.0..1000.0).contains(&drift), "{drift:.0} m");
}

/// Whatever is typed is answered, and changes nothing that was not asked for.
#[test]
fn nonsense_is_answered() {
    let scenario = Scenario::builtin("static").unwrap();
    let typed = [
        "20 format c:",
        "21 set latitude north",
        "22 set latitude 95",
        "23 calibrate",
        "24 log everything",
        "25 \u{7f}\u{1}\u{2}",
        "26 aaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaa",
        "27 status",
        "28 version",
    ];
    let (result, answers) = session(&scenario, 2, 30.0, &typed);
    assert_eq!(
        answers,
        [
            "error,expected a command: help lists them",
            "error,expected a number as -12.345",
            "error,expected latitude from -85.0 to 85.0 deg",
            "error,only from rest or once aligned: stop first",
            "error,expected log error  warn  info or debug",
            "error,expected ASCII at 115200 baud 8N1",
            "error,expected at most 64 characters on a line",
            "ok,rotary-north 0.1.0",
        ]
    );
    assert_eq!(result.state, "coarse");
    let (quiet, _) = session(&scenario, 2, 30.0, &[]);
    assert_eq!(result.settings, quiet.settings);
}

/// Every sentence as it comes.
#[derive(Default)]
struct Sentences(Vec<String>);

impl Observer for Sentences {
    fn sentence(&mut self, line: &UartLine) {
        self.0.push(String::from_utf8_lossy(&line.bytes).into_owned());
    }
}

/// The scenario aligns in two minutes; by the chip's own clock the filter does as well, and the unit does not stand by it.
#[test]
fn by_the_chips_own_clock_no_heading_is_valid() {
    let scenario = Scenario::builtin("static").unwrap();
    let run = |clock| {
        let mut unit = RobustSession::new(&scenario, 1, Method::Robust, &[]).unwrap();
        let mut heard = Sentences::default();
        unit.set_clock(clock);
        unit.reset(ResetCause::PowerOn, &mut ()).unwrap();
        unit.run_until_us(200_000_000, &mut heard).unwrap();
        (unit.result().state, heard.0)
    };
    let count = |heard: &[String], with: &str| heard.iter().filter(|text| text.contains(with)).count();

    let (state, heard) = run(ClockSource::Crystal);
    assert_eq!(state, "aligned");
    assert!(count(&heard, ",A*") > 100 && count(&heard, ",clock,") == 0);

    let (state, heard) = run(ClockSource::Internal);
    assert_eq!(state, "fine");
    let headings: Vec<_> = heard.iter().filter(|text| text.starts_with("$HETHS,")).collect();
    assert!(headings.len() > 1900);
    assert!(headings.iter().all(|text| text.starts_with("$HETHS,,V*")));
    assert_eq!(count(&heard, "$HEHDT"), 0);
    let statuses = count(&heard, "$PRNST,");
    assert!(statuses > 190 && count(&heard, ",,clock,,,") == statuses, "{statuses}");
}

/// The number behind the first of `words` in the line that begins with it.
fn told(answers: &[String], words: &str) -> f64 {
    let line = answers
        .iter()
        .find_map(|line| line.strip_prefix("ok,")?.strip_prefix(words));
    let line = line.unwrap_or_else(|| panic!("{words} is not told: {answers:#?}"));
    line.split(' ').next().unwrap().parse().unwrap()
}

/// `hardware` tells what self-test, calibration of the motor, homing and sampling have found, and of the rest that it was not measured.
#[test]
fn the_hardware_is_told_fact_by_fact() {
    let scenario = Scenario::builtin("static").unwrap();
    let (_, answers) = session(&scenario, 1, 30.0, &["0.1 hardware", "25 hardware"]);
    let ends: Vec<_> = answers
        .iter()
        .enumerate()
        .filter(|(_, line)| *line == "ok,no more facts")
        .collect();
    let [(first, _), (second, _)] = ends[..] else {
        panic!("{answers:#?}")
    };
    assert_eq!((first, second), (16, 33), "{answers:#?}");
    // Before the self-test has come to anything.
    for words in ["imu", "imu period", "force", "gyro noise", "homed at"] {
        let line = format!("ok,{words} not measured");
        assert!(
            answers[..first].iter().any(|told| told.starts_with(&line)),
            "{line}: {answers:#?}"
        );
    }
    let after = &answers[first + 1..];
    for line in [
        "ok,clock crystal - as expected",
        "ok,supply above 2.8 V - as expected",
        "ok,brown-out level 3 - as expected",
        "ok,imu 16495 - as expected",
        "ok,encoder answers - as expected",
        "ok,encoder eccentricity not measured",
        "ok,motor resistance and torque constant not measured",
    ] {
        assert!(after.iter().any(|told| told == line), "{line}: {after:#?}");
    }
    // 202.38 Hz, by a clock of the IMU that is off by what the scenario says; gravity, and the noise of the paper's gyros.
    assert!((told(after, "imu period ") - 4941.2).abs() < 1.0);
    assert!((told(after, "force ") - 9.80).abs() < 0.01);
    assert!((told(after, "gyro noise ") / 0.02 - 1.0).abs() < 0.25);
    // By the log: the edge of the switch is at 180°.
    assert!((told(after, "homed at ") - 180.0).abs() < 10.0);
    assert!((told(after, "motor offset ") - 46.75).abs() < 1.0);
    assert!(told(after, "rate ") < 100.0);
    assert_eq!(told(after, "samples lost "), 0.0);
    assert!(after.iter().all(|line| line.len() <= 66), "{after:#?}");
}

/// The unit finds by its rotor's reversals how late its IMU is beyond what it takes off, aligning as well as calibrating.
#[test]
fn the_delay_of_the_imu_is_found_by_the_unit() {
    // No sample is ahead of the motion: less late than the part says it can be by the part's own 0.39 ms at most.
    for (name, delay_ms) in [("static", -0.39), ("static", 0.0), ("static", 3.0), ("paper-sim", 3.0)] {
        let mut scenario = Scenario::builtin(name).unwrap();
        scenario.errors.imu_delay_ms = delay_ms;
        let (_, answers) = session(&scenario, 1, 150.0, &["20 hardware", "155 hardware"]);
        // The rotor has not turned round yet.
        assert!(
            answers.iter().any(|line| line == "ok,imu delay not measured"),
            "{answers:#?}"
        );
        let after = answers.iter().position(|line| line == "ok,no more facts").unwrap();
        let found = told(&answers[after..], "imu delay ");
        let most = if name == "static" { 0.05 } else { 0.3 };
        assert!((found - delay_ms).abs() < most, "{name}: {found} of {delay_ms} ms");
    }
}

/// What is wrong is told beside what was expected: the supply, the clock, and an encoder that is not there.
#[test]
fn the_hardware_tells_what_is_wrong() {
    let mut scenario = Scenario::builtin("static").unwrap();
    scenario.fault.push(FaultAt {
        at_s: 0.0,
        for_s: None,
        kind: FaultKind::EncoderSilent,
    });
    let mut unit = RobustSession::new(&scenario, 2, Method::Robust, &[]).unwrap();
    let mut answers = Answers::default();
    unit.set_clock(ClockSource::Internal);
    unit.reset(ResetCause::PowerOn, &mut ()).unwrap();
    unit.set_supply(Supplied {
        low: true,
        unguarded: true,
    });
    unit.run_until_us(3_000_000, &mut answers).unwrap();
    unit.send(b"hardware\r\n");
    unit.run_until_us(6_000_000, &mut answers).unwrap();
    for line in [
        "ok,clock the chip's own - expected a crystal",
        "ok,supply below 2.8 V - expected above",
        "ok,brown-out level below 3 - expected 3",
        "ok,encoder does not answer - expected an answer",
        "ok,homed at not measured",
    ] {
        assert!(answers.0.iter().any(|told| told == line), "{line}: {:#?}", answers.0);
    }
}

/// What is not saved on a low supply is saved once it is there.
#[test]
fn nothing_is_saved_on_a_low_supply() {
    let scenario = Scenario::builtin("static").unwrap();
    let mut unit = RobustSession::new(&scenario, 1, Method::Robust, &[]).unwrap();
    let mut answers = Answers::default();
    let low = Supplied {
        low: true,
        unguarded: true,
    };
    for (at_s, supply, line) in [
        (2, low, "set latitude 41"),
        (3, low, "save"),
        (4, Supplied::default(), "save"),
    ] {
        unit.run_until_us(at_s * 1_000_000, &mut answers).unwrap();
        unit.set_supply(supply);
        unit.send(format!("{line}\r\n").as_bytes());
    }
    unit.run_until_us(6_000_000, &mut answers).unwrap();
    assert_eq!(
        answers.0,
        [
            "ok,set - align takes it up and save keeps it",
            "error,not saved: the supply is below 2.8 V",
            "ok,saved",
        ]
    );
}

/// A level that cuts off no save is told at the start.
#[test]
fn a_brown_out_level_that_is_too_low_is_told() {
    struct Lines(Vec<String>);
    impl Observer for Lines {
        fn line(&mut self, line: &Line) {
            self.0.push(line.text.clone());
        }
    }
    for unguarded in [false, true] {
        let mut unit = RobustSession::new(&Scenario::builtin("static").unwrap(), 1, Method::Robust, &[]).unwrap();
        unit.set_supply(Supplied { low: false, unguarded });
        let mut lines = Lines(Vec::new());
        unit.run_until_us(100_000, &mut lines).unwrap();
        lines.0.clear();
        unit.reset(ResetCause::PowerOn, &mut lines).unwrap();
        unit.run_until_us(200_000, &mut lines).unwrap();
        let told = lines
            .0
            .iter()
            .any(|line| line.starts_with("settings: the brown-out level is below 2.7 V"));
        assert_eq!(told, unguarded, "{:?}", lines.0);
    }
}

/// Whatever DATA_CNT counts, lost samples are known by their number, and no fault comes of it.
#[test]
fn either_count_of_the_imu_tells_what_is_lost() {
    let mut scenario = Scenario::builtin("static").unwrap();
    scenario.buses.edge_loss = 0.02;
    let lost = [false, true].map(|base_samples| {
        let mut unit = RobustSession::new(&scenario, 4, Method::Robust, &[]).unwrap();
        if base_samples {
            unit.count_base_samples();
        }
        unit.run_until_us(90_000_000, &mut ()).unwrap();
        let result = unit.result();
        assert!(result.faults.is_empty(), "{:?}", result.faults);
        assert_ne!(result.state, "coarse");
        assert_eq!(u64::from(result.samples.lost), result.samples.edges_lost);
        assert!(
            result.samples.lost > 200 && result.samples.repeated == 0,
            "{:?}",
            result.samples
        );
        result.samples
    });
    assert_eq!(lost[0], lost[1]);
}

/// A gyro error of 0.5 °/h in the housing is found by a unit that is turned through four headings, kept by `deviation`, and
/// known to the next alignment.
#[test]
fn a_unit_turned_through_four_headings_keeps_its_deviation() {
    let mut scenario = Scenario::builtin("four-headings").unwrap();
    // Two minutes at each heading; the unit takes a quarter of one to begin.
    for (turn, at_s) in scenario.turn.iter_mut().zip([135.0, 265.0, 395.0]) {
        turn.at_s = at_s;
    }
    let heading = |result: &UnitResult| {
        let last = result.last.as_ref().unwrap();
        (last.error.heading_deg, last.reading.sd.heading_deg)
    };
    let typed = [
        "100 deviation",
        "525 deviation",
        "526 deviation clear",
        "526.1 deviation",
    ];
    let (found, answers) = session(&scenario, 11, 530.0, &typed);
    let [early, what, taken, clear, again, taken_again] = &answers[..] else {
        panic!("{answers:?}")
    };
    assert_eq!(
        early,
        "error,nothing found: align then turn the base through four headings"
    );
    assert_eq!((taken_again, clear), (taken, taken), "{answers:?}");
    assert!(
        [what, again]
            .iter()
            .all(|told| told.starts_with("ok,deviation 0.4") || told.starts_with("ok,deviation 0.3")),
        "{answers:?}"
    );
    assert_eq!(taken, "ok,set - align takes it up and save keeps it");
    let deviation = found.settings.deviation.unwrap();
    let sd = f64::from(deviation.sd) / DEG_PER_HOUR;
    assert!(sd < 0.1, "{sd}");
    for (found, truth) in deviation.rate_b.iter().zip([0.3, -0.4]) {
        assert!(
            (f64::from(*found) / DEG_PER_HOUR - truth).abs() < 3.0 * sd,
            "{deviation:?}"
        );
    }
    let (off, sd) = heading(&found);
    assert!(off.abs() < 3.0 * sd && sd < 0.4, "{off} {sd}");

    // Aligned anew at the last heading, with it and without it.
    let align = |typed: &[&str]| session(&scenario, 11, 660.0, typed).0;
    let (off, sd) = heading(&align(&["525 deviation", "526 align"]));
    assert!(off.abs() < 3.0 * sd && sd < 0.9, "{off} {sd}");
    let (_, sd) = heading(&align(&["526 align"]));
    assert!(sd > 2.0, "{sd}");
}
