//! Every sentence of ten minutes of a unit's life, read by another's parser, and its values beside what was estimated.
//!
//! The life: it starts and aligns, the motor's driver reports a fault and it recovers, it aligns again, navigates, is
//! stopped, and asked to calibrate its gyros on a base that moves; in between somebody types. What gpsd makes of such a
//! run is in `.ci/gpsdecode`.
#![allow(clippy::unwrap_used, reason = "the helpers of tests are tests")]

#[path = "common/paper.rs"]
mod paper;
#[path = "common/port.rs"]
mod port;

use std::collections::{BTreeMap, BTreeSet};

use frames::units::{DEG, PPM};
use hal_sim::align::Method;
use hal_sim::scenario::{FaultAt, FaultKind, Scenario};
use hal_sim::unit_sim::{self, Typed};
use nmea_kit::NmeaSentence;
use nmea_kit::nmea::ddmm_to_decimal;

use paper::paper;
use port::Port;

/// Off by less than half a digit, on a circle of `turn`, or without one.
fn is(shown: Option<impl Into<f64>>, expected: f64, digit: f64, turn: Option<f64>, text: &str) {
    let shown: f64 = shown.unwrap_or_else(|| panic!("{text}: no value")).into();
    let off = match turn {
        Some(turn) => (shown - expected + 0.5 * turn).rem_euclid(turn) - 0.5 * turn,
        None => shown - expected,
    };
    // An f32 of 360 is good to 1.5e-5.
    assert!(off.abs() <= 0.51 * digit + 3e-5, "{text}: {shown} for {expected}");
}

#[test]
fn another_parser_reads_every_sentence_of_a_units_life() {
    let mut scenario = paper();
    scenario.place.latitude_deg = -40.0;
    scenario.run.duration_s = 630.0;
    scenario.fault.push(FaultAt {
        at_s: 200.0,
        for_s: Some(1.0),
        kind: FaultKind::Driver,
    });
    let typed: Vec<Typed> = [
        "1 help",
        "2 show",
        "3 nonsense",
        "4 set longitude -8.5",
        "5 set latitude 99",
        "380 navigate",
        "560 stop",
        "562 calibrate",
    ]
    .into_iter()
    .map(|text| text.parse().unwrap())
    .collect();
    let mut port = Port::default();
    let result = unit_sim::run_session(&scenario, 1, Method::Robust, &typed, &mut port).unwrap();
    assert_eq!((result.state, result.faults.len()), ("idle", 1));

    let mut counts = BTreeMap::<String, u32>::new();
    let mut modes = BTreeSet::new();
    let (mut indicator, mut previous) = ('V', 0.0);
    let mut texts = Vec::new();
    let (mut indicators, mut answers) = (BTreeSet::new(), [0, 0]);
    for line in &port.lines {
        let text = core::str::from_utf8(&line.bytes).unwrap();
        assert!(
            text.ends_with("\r\n") && text.contains('*') && text.len() <= 82,
            "{text:?}"
        );
        let frame = nmea_kit::parse_frame(text).unwrap_or_else(|e| panic!("{text:?}: {e:?}"));
        assert!(frame.talker == "HE" || frame.sentence_type.starts_with('P'), "{text:?}");
        *counts.entry(frame.sentence_type.to_owned()).or_default() += 1;
        let navigation = port.estimate_at(line);
        let estimate = || navigation.unwrap().estimate.unwrap();
        let deg = |rad: f32| f64::from(rad) / DEG;
        match NmeaSentence::parse(&frame) {
            NmeaSentence::Ths(ths) => {
                indicator = ths.mode.unwrap();
                indicators.insert(indicator);
                if indicator == 'V' {
                    assert_eq!(ths.heading_true, None, "{text}");
                } else {
                    is(
                        ths.heading_true,
                        deg(estimate().attitude.heading),
                        0.01,
                        Some(360.0),
                        text,
                    );
                }
            }
            NmeaSentence::Hdt(hdt) => {
                assert_eq!(indicator, 'A', "{text}");
                is(
                    hdt.heading_true,
                    deg(estimate().attitude.heading),
                    0.01,
                    Some(360.0),
                    text,
                );
            }
            NmeaSentence::Rot(rot) => {
                assert_eq!(rot.rate_of_turn.is_some(), rot.valid == Some('A'), "{text}");
                // 10 degrees of swing in 5 s.
                assert!(rot.rate_of_turn.is_none_or(|rate| rate.abs() < 900.0), "{text}");
            }
            NmeaSentence::Pashr(pashr) => {
                assert_eq!(
                    (pashr.time, pashr.heave, pashr.gnss_quality),
                    (None, None, Some(0)),
                    "{text}"
                );
                assert_eq!(pashr.imu_alignment, Some(u8::from(indicator == 'A')), "{text}");
                let all = [
                    pashr.heading,
                    pashr.roll,
                    pashr.pitch,
                    pashr.roll_accuracy,
                    pashr.pitch_accuracy,
                    pashr.heading_accuracy,
                ];
                if indicator == 'V' {
                    assert_eq!(all, [None; 6], "{text}");
                    continue;
                }
                let (attitude, sd) = (estimate().attitude, estimate().sd);
                is(pashr.heading, deg(attitude.heading), 0.01, Some(360.0), text);
                is(pashr.roll, deg(attitude.roll), 0.01, None, text);
                is(pashr.pitch, deg(attitude.pitch), 0.01, None, text);
                // Rounded up.
                is(pashr.roll_accuracy, deg(sd.roll) + 5e-4, 1e-3, None, text);
                is(pashr.pitch_accuracy, deg(sd.pitch) + 5e-4, 1e-3, None, text);
                is(pashr.heading_accuracy, deg(sd.heading) + 5e-4, 1e-3, None, text);
            }
            NmeaSentence::Gll(gll) => {
                let position = navigation.unwrap().track.unwrap().position;
                assert_eq!((gll.status, gll.mode, gll.time), (Some('V'), Some('E'), None), "{text}");
                assert_eq!((gll.ns, gll.ew), (Some('S'), Some('W')), "{text}");
                let digit = 1e-4 / 60.0;
                is(gll.lat.map(ddmm_to_decimal), -deg(position.latitude), digit, None, text);
                is(
                    gll.lon.map(ddmm_to_decimal),
                    -deg(position.longitude),
                    digit,
                    None,
                    text,
                );
            }
            NmeaSentence::Vtg(vtg) => {
                let v_n = navigation.unwrap().track.unwrap().v_n;
                let (east, north) = (f64::from(v_n.x()), f64::from(v_n.y()));
                let speed = east.hypot(north);
                is(vtg.speed_kmh, 3.6 * speed, 0.01, None, text);
                is(vtg.speed_kts, speed / 1852.0 * 3600.0, 0.01, None, text);
                assert_eq!((vtg.mode, vtg.course_mag), (Some('E'), None), "{text}");
                assert_eq!(vtg.course_true.is_some(), speed >= 0.1, "{text}: {speed}");
                if vtg.course_true.is_some() {
                    is(vtg.course_true, east.atan2(north) / DEG, 0.01, Some(360.0), text);
                }
            }
            NmeaSentence::Txt(txt) => {
                assert_eq!((txt.num_msg, txt.msg_num), (Some(1), Some(1)), "{text}");
                texts.push((txt.msg_type, txt.text));
            }
            NmeaSentence::Unknown { sentence_type, fields } if sentence_type == "PRNST" => {
                assert_eq!(fields.len(), 8, "{text}");
                let up: f64 = fields[0].parse().unwrap();
                assert!(
                    (up - line.started_ns as f64 * 1e-9).abs() < 0.1 && up >= previous,
                    "{text}"
                );
                previous = up;
                modes.insert(fields[1].clone());
                assert_eq!(!fields[5].is_empty(), fields[1] == "fault", "{text}");
                assert!(fields[7].is_empty() || fields[7].parse::<f64>().is_ok(), "{text}");
            }
            NmeaSentence::Unknown { sentence_type, fields } if sentence_type == "PRNSA" => {
                // An answer's text has no commas.
                assert_eq!(fields.len(), 2, "{text}");
                answers[usize::from(fields[0] == "ok")] += 1;
            }
            other => panic!("{text}: {other:?}"),
        }
    }
    println!("{counts:?}, answers {answers:?}, {indicators:?}");
    let all = [
        "",
        "self-test",
        "homing",
        "coarse",
        "fine",
        "aligned",
        "fault",
        "navigating",
        "idle",
        "calibrating",
    ];
    assert!(modes.iter().all(|mode| all.contains(&mode.as_str())), "{modes:?}");
    for mode in all.iter().skip(1) {
        assert!(modes.contains(*mode), "{mode} in {modes:?}");
    }
    assert!(indicators.contains(&'A') && indicators.contains(&'V'), "{indicators:?}");
    // Help, the settings with their last line, three that are set or done, and what was no command or out of range.
    let (words, settings) = (app::console::WORDS.len(), app::console::Setting::ALL.len());
    assert_eq!(answers, [2, words + settings + 1 + 4]);
    let failed = "gyros not calibrated: the base moves".to_owned();
    assert_eq!(texts, [(Some(1), Some(failed))]);
    let count = |name: &str| counts.get(name).copied().unwrap_or_default();
    assert_eq!((count("THS"), count("THS")), (count("ROT"), count("PASHR")));
    assert!(
        count("THS") > 6000 && count("HDT") > 4000 && count("PRNST") > 600,
        "{counts:?}"
    );
    // 180 s of navigation.
    assert!(count("GLL") > 1800 && count("GLL") == count("VTG"), "{counts:?}");
}

/// A calibration that succeeds is told once, as the talker that was set, in the figures that the unit goes on with, and
/// before the status says that it has ended.
#[test]
fn another_parser_reads_what_a_calibration_found() {
    for (typed, used) in [
        (&["2 set talker IN", "3 save", "4 restart", "150 calibrate"][..], "used"),
        (
            &["2 set talker IN", "3 save", "4 restart", "8 stop", "9 calibrate"],
            "not used",
        ),
    ] {
        let mut scenario = Scenario::builtin("static").unwrap();
        scenario.imu.gyro_scale_factor_sd_ppm = 1000.0;
        scenario.run.duration_s = 300.0;
        let typed: Vec<Typed> = typed.iter().map(|text| text.parse().unwrap()).collect();
        let mut port = Port::default();
        let result = unit_sim::run_session(&scenario, 2, Method::Robust, &typed, &mut port).unwrap();
        assert_eq!(result.state, "idle");
        let found = result.settings.imu.calibration.unwrap();
        let (mut texts, mut modes) = (Vec::new(), Vec::new());
        for line in &port.lines {
            let frame = nmea_kit::parse_frame(core::str::from_utf8(&line.bytes).unwrap()).unwrap();
            match NmeaSentence::parse(&frame) {
                NmeaSentence::Txt(txt) => {
                    assert_eq!((frame.talker, modes.last()), ("IN", Some(&"calibrating".to_owned())));
                    texts.push((txt.msg_type, txt.text.unwrap()));
                }
                NmeaSentence::Unknown { sentence_type, fields } if sentence_type == "PRNST" => {
                    modes.push(fields[1].clone());
                }
                _ => {}
            }
        }
        assert_eq!(modes.last().map(String::as_str), Some("idle"));
        let [scale, sd] = [found.s_z, found.column_sd].map(|x| f64::from(x) / PPM);
        assert!(scale.abs() > 100.0 && sd < 100.0, "{scale} {sd}");
        let expected = format!("gyros calibrated: z scale {scale:.0} sd {sd:.0} ppm - biases {used}");
        assert_eq!(texts, [(Some(2), expected)]);
    }
}
