//! The unit's serial port: every sentence of a run read by another's parser, and compared with the estimates.
#![allow(clippy::unwrap_used, reason = "tests")]

#[path = "common/paper.rs"]
mod paper;
#[path = "common/port.rs"]
mod port;

use frames::units::DEG;
use hal_sim::align::Method;
use hal_sim::bus::UartLine;
use hal_sim::scenario::{FaultAt, FaultKind, Scenario};
use hal_sim::truth::Truth;
use hal_sim::unit_sim::{self, UnitResult};
use nmea_kit::NmeaSentence;

use paper::paper;
use port::Port;

/// Bytes a second that 115200 baud carry.
const LINE: f64 = 11_520.0;

fn run(scenario: &Scenario, seed: u64) -> (Port, UnitResult) {
    let mut port = Port::default();
    let result = unit_sim::run(scenario, seed, Method::Robust, &mut port).unwrap();
    (port, result)
}

/// The text of a line that has all that a line must have.
fn text(line: &UartLine) -> &str {
    let text = std::str::from_utf8(&line.bytes).unwrap();
    assert!(text.is_ascii() && text.len() <= 82, "{text:?}");
    let body = text
        .strip_prefix('$')
        .and_then(|text| text.strip_suffix("\r\n"))
        .unwrap();
    let (body, sum) = body.split_once('*').unwrap();
    let expected = body.bytes().fold(0, |sum, byte| sum ^ byte);
    assert_eq!(sum, format!("{expected:02X}"), "{text:?}");
    text
}

/// Modes in the order of their coming.
fn phases<T: PartialEq>(all: impl Iterator<Item = T>) -> Vec<T> {
    let mut phases: Vec<T> = all.collect();
    phases.dedup();
    phases
}

/// Field `n` of the sentences that begin with `head`, each with the time of its first byte, s.
fn fields<'a>(port: &'a Port, head: &str, n: usize) -> Vec<(f64, &'a str)> {
    let lines = port
        .lines
        .iter()
        .map(|line| (line.started_ns as f64 * 1e-9, text(line)));
    lines
        .filter(|(_, text)| text.starts_with(head))
        .filter_map(|(t, text)| Some((t, text.split(['*', ',']).nth(n)?)))
        .collect()
}

#[test]
fn every_sentence_of_a_run_is_read_and_is_the_estimate() {
    let (port, result) = run(&paper(), 1);
    assert_eq!(result.state, "aligned");
    let (mut mode, mut valid_ns) = ('V', 0);
    let mut compared = 0;
    for line in &port.lines {
        let text = text(line);
        let frame = nmea_kit::parse_frame(text).unwrap_or_else(|e| panic!("{text:?}: {e:?}"));
        let navigation = || {
            let navigation = port.estimate_at(line).unwrap();
            // A heading is as fresh as its way to the line: one poll of the task and the first byte.
            let age_us = line.started_ns / 1000 - navigation.t_us;
            assert!(age_us < 30_000, "{text:?} is {age_us} us old");
            navigation.estimate.unwrap()
        };
        let is_heading = |shown: Option<f32>| {
            let off = f64::from(shown.unwrap()) - f64::from(navigation().attitude.heading) / DEG;
            let off = (off + 180.0).rem_euclid(360.0) - 180.0;
            assert!(off.abs() < 0.005_1, "{text:?}: off by {off}");
        };
        let valid = mode != 'V';
        match NmeaSentence::parse(&frame) {
            NmeaSentence::Ths(ths) => {
                if mode == 'V' {
                    valid_ns = line.started_ns;
                }
                mode = ths.mode.unwrap();
                assert_eq!(ths.heading_true.is_some(), mode != 'V');
                if mode != 'V' {
                    let age_us = line.started_ns / 1000 - port.estimate_at(line).unwrap().t_us;
                    assert!(age_us < 1_000, "{age_us}");
                    is_heading(ths.heading_true);
                    compared += 1;
                }
            }
            NmeaSentence::Hdt(hdt) => {
                assert_eq!(mode, 'A', "{text:?}");
                is_heading(hdt.heading_true);
            }
            NmeaSentence::Rot(rot) => {
                assert_eq!(rot.rate_of_turn.is_some(), rot.valid == Some('A'), "{text:?}");
                // A rate takes four headings.
                let known = valid && line.started_ns > valid_ns + 250_000_000;
                assert!(
                    rot.valid == Some('A') && valid || rot.valid == Some('V') && !known,
                    "{text:?}"
                );
            }
            NmeaSentence::Pashr(pashr) => {
                assert_eq!((pashr.time, pashr.heave), (None, None));
                assert_eq!(pashr.imu_alignment, Some(u8::from(mode == 'A')));
                assert_eq!(pashr.gnss_quality, Some(0));
                assert_eq!(pashr.roll.is_some(), valid);
                if valid {
                    is_heading(pashr.heading);
                    let estimate = navigation();
                    for (shown, angle) in [
                        (pashr.roll, estimate.attitude.roll),
                        (pashr.pitch, estimate.attitude.pitch),
                    ] {
                        assert!((f64::from(shown.unwrap()) - f64::from(angle) / DEG).abs() < 0.005_1);
                    }
                    for (shown, sd) in [
                        (pashr.roll_accuracy, estimate.sd.roll),
                        (pashr.pitch_accuracy, estimate.sd.pitch),
                        (pashr.heading_accuracy, estimate.sd.heading),
                    ] {
                        let above = f64::from(shown.unwrap()) - f64::from(sd) / DEG;
                        assert!((-1e-6..0.001_001).contains(&above), "{text:?}: {above}");
                    }
                }
            }
            _ => assert_eq!(text.get(..7), Some("$PRNST,"), "{text:?}"),
        }
    }
    assert!(compared > 2000);

    let modes = phases(fields(&port, "$HETHS", 2).into_iter().map(|(_, mode)| mode));
    assert!(modes == ["V", "A"] || modes == ["V", "E", "A"], "{modes:?}");
    // As soon as the unit calls itself aligned.
    let first = fields(&port, "$HEHDT", 1)[0].0;
    assert!((0.0..0.2).contains(&(first - result.aligned_at_s.unwrap())), "{first}");
    // Every mode is told, also those that last less than the second between two status sentences.
    let told = phases(
        fields(&port, "$PRNST", 2)
            .into_iter()
            .map(|(_, mode)| mode)
            .filter(|mode| !mode.is_empty()),
    );
    let modes: Vec<&str> = result.modes.iter().map(|at| at.mode).collect();
    assert_eq!(told, modes);

    let ths: Vec<f64> = fields(&port, "$HETHS", 0).iter().map(|(t, _)| *t).collect();
    assert!(
        ths.len() as f64 >= 10.0 * result.t_s - 2.0,
        "{} in {} s",
        ths.len(),
        result.t_s
    );
    assert!(ths.windows(2).all(|at| at[1] - at[0] < 0.16));
    let total: usize = port.lines.iter().map(|line| line.bytes.len()).sum();
    let mut seconds = vec![0; result.t_s as usize + 1];
    for line in &port.lines {
        seconds[(line.ended_ns / 1_000_000_000) as usize] += line.bytes.len();
    }
    let most = *seconds.iter().max().unwrap() as f64;
    println!(
        "{} sentences, {:.0} bytes a second, at most {most} in one",
        port.lines.len(),
        total as f64 / result.t_s
    );
    assert!(most < 0.2 * LINE, "{most}");
}

/// The rate of turn of the true heading, as late as the smoothing makes it.
#[test]
fn the_rate_of_turn_is_the_housings() {
    let scenario = paper();
    let (port, _) = run(&scenario, 2);
    let truth = Truth::new(&scenario, 2).unwrap();
    let rate = |t: f64| {
        let change = truth.attitude(t + 0.05).heading - truth.attitude(t - 0.05).heading;
        frames::math::wrap_pi(change) / 0.1 / DEG * 60.0
    };
    // Through the same first-order lag, in steps of 10 ms; the median is 75 ms late.
    let mut lagged = vec![0.0];
    for k in 1..36_000 {
        let before = lagged[k - 1];
        lagged.push(before + 0.01 / 0.51 * (rate(0.01 * k as f64 - 0.075) - before));
    }
    let shown = fields(&port, "$HEROT", 1);
    let (mut off, mut all, mut count) = (0.0, 0.0, 0.0);
    for (t, shown) in shown {
        if let Ok(shown) = shown.parse::<f64>()
            && t > 120.0
        {
            let expected = lagged[(t * 100.0) as usize];
            off += (shown - expected).powi(2);
            all += expected * expected;
            count += 1.0_f64;
        }
    }
    let (off, all) = ((off / count).sqrt(), (all / count).sqrt());
    println!("rate of turn: rms {all:.1} deg/min, off by {off:.2}");
    assert!(count > 1500.0 && all > 60.0 && off < 0.03 * all, "{count} {all} {off}");
}

#[test]
fn a_fault_takes_the_heading_back_at_once() {
    let mut scenario = paper();
    scenario.run.duration_s = 150.0;
    scenario.fault.push(FaultAt {
        at_s: 140.0,
        for_s: Some(1.0),
        kind: FaultKind::Driver,
    });
    let (port, result) = run(&scenario, 1);
    assert_eq!(result.faults[0].name, "driver");
    let after = |t: f64| (140.12..).contains(&t);
    let before = fields(&port, "$HETHS", 2)
        .into_iter()
        .rfind(|(t, _)| *t < 140.0)
        .unwrap();
    assert_ne!(before.1, "V");
    assert!(
        fields(&port, "$HETHS", 2)
            .iter()
            .filter(|(t, _)| after(*t))
            .all(|(_, mode)| *mode == "V")
    );
    assert!(fields(&port, "$HEHDT", 1).iter().all(|(t, _)| !after(*t)));
    let faults: Vec<_> = fields(&port, "$PRNST", 6)
        .into_iter()
        .filter(|(_, fault)| *fault == "driver")
        .collect();
    assert!((140.0..140.12).contains(&faults[0].0), "{faults:?}");
}
