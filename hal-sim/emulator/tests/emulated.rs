//! The release image on the emulated part: boot, homing, coarse alignment; faults, resets, power cuts; one setup, one
//! log; what it costs.
#![allow(clippy::unwrap_used, reason = "tests")]

use std::collections::BTreeSet;

use assert_cmd::Command;
use emulator::error::Error;
use emulator::image::Image;
use emulator::log::Line;
use emulator::nmea::Sentence;
use emulator::outcome::{Lamps, Outcome};
use emulator::part::BridgeTimer;
use emulator::run::{self, Observer, PowerCut, Press, Setup, Typed};
use hal_sim::align::Method;
use hal_sim::inspect::defmt::Elf;
use hal_sim::inspect::timeline::{Source, Timeline};
use hal_sim::inspect::{self, InspectError};
use hal_sim::scenario::{FaultAt, FaultKind, Scenario};
use hal_sim::unit_sim::{self, RobustSession};

/// The release image.
fn image() -> Image {
    let path = Image::release();
    Image::read(&path).unwrap_or_else(|e| panic!("{e}: `cargo fw` builds the image"))
}

/// The paper's scenario.
fn paper() -> Scenario {
    Scenario::builtin("paper-sim").unwrap()
}

/// The same with a fault.
fn broken(kind: FaultKind, at_s: f64, for_s: f64) -> Scenario {
    let mut scenario = paper();
    scenario.fault.push(FaultAt {
        at_s,
        for_s: Some(for_s),
        kind,
    });
    scenario
}

/// Log and serial line.
#[derive(Debug, Default, PartialEq)]
struct Kept {
    /// Lines of the log.
    lines: Vec<String>,
    /// Sentences.
    sentences: Vec<String>,
    /// The log as it was written.
    rtt: Vec<u8>,
}

impl Observer for Kept {
    fn line(&mut self, line: &Line) {
        self.lines.push(line.to_string());
    }

    fn sentence(&mut self, sentence: &Sentence) {
        self.sentences.push(sentence.text.clone());
    }

    fn rtt(&mut self, bytes: &[u8]) {
        self.rtt.extend_from_slice(bytes);
    }
}

/// Runs a setup and keeps what it says. Whatever is run, the emulator has no gaps and the cable is sound.
fn run(setup: &Setup) -> (Outcome, Kept) {
    let (outcome, kept) = run::run(&image(), setup, Kept::default()).unwrap();
    assert!(outcome.gaps.is_empty(), "{:?}", outcome.gaps);
    assert!(!outcome.wound_past, "{:?}", outcome.travel_deg);
    assert!(!outcome.driven_after_reset, "driven after a reset");
    assert_eq!(outcome.stall_violations, 0, "the IMU was not given its pause");
    // What a power cut cuts.
    let cut = setup.power_cuts.len() as u64;
    assert!(outcome.serial.others <= cut, "a line that is no sentence");
    (outcome, kept)
}

fn inspected(bytes: &[u8]) -> Result<Timeline, InspectError> {
    inspect::of_bytes(bytes, Some(Elf::read(&Image::release()).unwrap()))
}

/// What `hal-sim inspect` makes of the log, raw and printed, is what the run was.
fn inspects_to(outcome: &Outcome, kept: &Kept) {
    let raw = inspected(&kept.rtt).unwrap();
    let printed = inspect::of_bytes(kept.lines.join("\n").as_bytes(), None).unwrap();
    assert_eq!((raw.source, printed.source), (Source::Defmt, Source::Text));
    assert_eq!(raw.damaged, 0);
    // The emulator's own lines are not the image's.
    let lines = kept.lines.iter().filter(|line| !line.contains("] HOST"));
    assert_eq!(raw.lines, lines.count() as u64);
    assert_eq!(
        raw.understood, raw.lines,
        "a line of the image that inspect does not understand"
    );

    for timeline in [&raw, &printed] {
        assert_eq!(timeline.modes.len(), outcome.modes.len(), "{:?}", timeline.modes);
        assert_eq!(timeline.resets, outcome.resets.len() as u64, "{:?}", timeline.starts);
        assert_eq!(timeline.faults.len(), outcome.faults.len(), "{:?}", timeline.faults);
        for (found, fault) in timeline.faults.iter().zip(&outcome.faults) {
            assert!(fault.text.contains(&found.text), "{found:?} {fault:?}");
        }
        for (found, mode) in timeline.modes.iter().zip(&outcome.modes) {
            assert_eq!(found.mode, mode.mode);
            // Read within a millisecond of being written. The image's clock begins with the image, and anew after a reset.
            if outcome.resets.is_empty() {
                assert!((found.from_s - mode.t_s).abs() < 2e-3, "{found:?} {mode:?}");
            }
        }
    }
    // The same figures by both ways.
    assert_eq!(raw.estimates.len(), printed.estimates.len());
    for (raw, printed) in raw.estimates.iter().zip(&printed.estimates) {
        assert_eq!((raw.attitude, raw.mode), (printed.attitude, printed.mode));
    }
}

/// What lines say, without their figures.
fn texts<'a>(lines: impl IntoIterator<Item = &'a str>) -> BTreeSet<String> {
    let figure = |word: &str| {
        let digits = word.trim_start_matches(['+', '-']);
        digits.starts_with(|c: char| c.is_ascii_digit())
    };
    let masked = lines.into_iter().map(|line| {
        let words = line.split_whitespace();
        let words: Vec<_> = words.map(|word| if figure(word) { "#" } else { word }).collect();
        words.join(" ")
    });
    // Each has a version of its own, and its seconds where they fall: in the moment between live and aligned, or not.
    masked
        .filter(|line| !line.starts_with("rotary-north") && !line.starts_with("fine rotor"))
        .collect()
}

/// What the simulated unit says until then.
fn simulated(scenario: &Scenario, seconds: f64) -> Vec<String> {
    struct Said(Vec<String>);
    impl unit_sim::Observer for Said {
        fn line(&mut self, line: &unit_sim::Line) {
            if line.level.as_str() != "DEBUG" {
                self.0.push(line.text.clone());
            }
        }
    }
    let mut said = Said(Vec::new());
    let mut session = RobustSession::new(scenario, 1, Method::Robust, &[]).unwrap();
    session.run_until_us((seconds * 1e6) as u64, &mut said).unwrap();
    said.0
}

/// Until 84 s: aligned with a σ below a degree, in time for the gate. Its log is the simulated unit's, but for figures.
#[test]
fn the_image_homes_and_aligns() {
    let (outcome, kept) = run(&Setup::new(paper(), 1, 84.0));
    let modes: Vec<&str> = outcome.modes.iter().map(|at| at.mode).collect();
    assert_eq!(modes, ["self-test", "homing", "coarse", "fine", "aligned"]);
    assert!(
        outcome.faults.is_empty() && outcome.resets.is_empty(),
        "{:?}",
        outcome.faults
    );

    inspects_to(&outcome, &kept);
    let lines = kept.lines.iter().filter_map(|line| line.split_once("] INFO  "));
    let printed = texts(lines.map(|(_, text)| text));
    let simulated = simulated(&paper(), 84.0);
    assert_eq!(printed, texts(simulated.iter().map(String::as_str)));
    assert!(printed.contains("mode fine -> aligned") && printed.contains("homed: rotor at # deg"));

    let timeline = inspected(&kept.rtt).unwrap();
    assert_eq!(timeline.coarse.len(), 1);
    let last = outcome.last.unwrap();
    let told = timeline.estimates.last().unwrap();
    assert!(timeline.estimates.len() > 5 && last.t_s - told.t_s < 1.2, "{told:?}");
    let sd = told.attitude.heading_sd_deg / last.sd.heading_deg;
    assert!((0.95..1.1).contains(&sd), "{told:?} {last:?}");

    assert!(last.t_s > 82.0, "{}", last.t_s);
    assert!(last.sigmas().abs() < 3.0, "{last:?}");
    assert!(last.sd.heading_deg < 1.0, "{last:?}");
    assert!(
        last.error.pitch_deg.abs() < 0.05 && last.error.roll_deg.abs() < 0.05,
        "{last:?}"
    );

    let answers = |head: &str| kept.sentences.iter().filter(|text| text.starts_with(head)).count();
    // Ten times a second.
    assert!((810..=850).contains(&answers("$HETHS,")), "{}", answers("$HETHS,"));
    assert!(
        answers("$HEHDT,") > 50 && answers("$HEHDT,") < 150,
        "{}",
        answers("$HEHDT,")
    );

    let cost = &outcome.cost;
    for row in &cost.load {
        println!(
            "{:<10} {:.2} %, busiest {:.2} %",
            row.mode,
            100.0 * row.share,
            100.0 * row.peak
        );
        // In its first hundredth of a second the unit reads the settings' flash, and has nothing else to do.
        assert!(
            row.share < 0.1 || (row.mode == "start" && row.seconds < 0.05),
            "{row:?}"
        );
        assert!(row.peak < 0.2, "{row:?}");
    }
    println!("stack {} of {} bytes", cost.stack.used, cost.stack.size);
    assert!(cost.stack.used > 1000 && cost.stack.margin() > 0.5, "{:?}", cost.stack);
    assert!(cost.footprint.static_ram <= 96 * 1024, "{}", cost.footprint.static_ram);
}

/// Among samples that come too late and faults that come and go.
#[test]
fn one_setup_one_log() {
    let setup = || {
        let mut scenario = broken(FaultKind::ImuCrc, 4.0, 0.5);
        scenario.buses.edge_loss = 0.01;
        Setup {
            power_cuts: vec![PowerCut { at_s: 9.0, for_s: 0.3 }],
            ..Setup::new(scenario, 5, 14.0)
        }
    };
    let ((a, said_a), (b, said_b)) = (run(&setup()), run(&setup()));
    assert!(said_a.lines.len() > 10 && said_a.sentences.len() > 200);
    assert_eq!(said_a, said_b);
    assert_eq!(a, b);
    assert_ne!(a.trace, run(&Setup::new(paper(), 6, 14.0)).0.trace);
}

/// The bridge's timer with every edge of its waveforms does what the quiet one does.
#[test]
fn the_full_timer_moves_the_motor_alike() {
    let with = |timer| {
        let setup = Setup {
            timer,
            ..Setup::new(paper(), 1, 12.0)
        };
        run(&setup)
    };
    let ((quiet, _), (full, _)) = (with(BridgeTimer::Quiet), with(BridgeTimer::Full));
    assert_eq!(quiet.state, full.state);
    assert_eq!(quiet.modes, full.modes);
    for (quiet, full) in quiet.travel_deg.iter().zip(full.travel_deg) {
        assert!((quiet - full).abs() < 0.01, "{quiet} {full}");
    }
}

#[test]
fn a_fault_switches_the_motor_off() {
    for (kind, name) in [
        (FaultKind::EncoderSilent, "fault encoder-"),
        (FaultKind::Driver, "fault driver: "),
    ] {
        let (outcome, kept) = run(&Setup::new(broken(kind, 16.0, 0.5), 1, 18.0));
        let fault = outcome
            .faults
            .first()
            .unwrap_or_else(|| panic!("{kind:?}: {:?}", kept.lines));
        assert!(fault.text.contains(name), "{kind:?} was found as {}", fault.text);
        assert!(
            (16.0..16.1).contains(&fault.t_s),
            "{kind:?} was found at {} s",
            fault.t_s
        );
        assert!(fault.motor_off, "{kind:?}");
    }
}

/// Without the debugger's half of the board: the unit starts all the same, says so, and stands by no heading.
#[test]
fn without_a_clock_from_outside_the_unit_starts_by_its_own() {
    let setup = Setup {
        clock_hz: 0,
        typed: [(14.0, "status"), (24.0, "stop"), (25.0, "calibrate")]
            .map(|(at_s, text)| Typed {
                at_s,
                text: text.to_owned(),
            })
            .to_vec(),
        ..Setup::new(paper(), 1, 26.0)
    };
    let (outcome, kept) = run(&setup);
    // Its own clock begins after the wait, so that the times of log and emulator differ.
    let timeline = inspected(&kept.rtt).unwrap();
    assert_eq!((timeline.understood, timeline.damaged), (timeline.lines, 0));
    assert!(outcome.resets.is_empty() && outcome.faults.is_empty(), "{outcome:?}");
    let modes: Vec<&str> = outcome.modes.iter().map(|at| at.mode).collect();
    assert_eq!(modes, ["self-test", "homing", "coarse", "idle"]);
    // 0.1 s later than with a clock, at the most.
    assert!(outcome.modes[0].t_s < 0.2, "{:?}", outcome.modes);
    let told = kept.lines.iter().filter(|line| line.contains("clock: nothing came in"));
    assert_eq!(told.count(), 1, "{:?}", kept.lines);
    let statuses = kept.sentences.iter().filter(|text| text.starts_with("$PRNST,"));
    assert!(statuses.clone().count() > 20);
    for status in statuses {
        assert_eq!(status.split(',').nth(5), Some("clock"), "{status}");
    }
    assert!(
        kept.sentences
            .iter()
            .any(|text| text.starts_with("$PRNSA,error,not by the chip's own clock*"))
    );

    let (with, kept) = run(&Setup::new(paper(), 1, 1.0));
    assert!(with.modes[0].t_s < 0.05, "{:?}", with.modes);
    assert!(kept.lines.iter().all(|line| !line.contains("clock:")));
}

/// A short press stops the rotor, a long one starts it; the lamps say so. A button that is closed at the start does nothing.
#[test]
fn the_button_stops_and_starts_the_rotor() {
    let pressed = |presses: &[(f64, f64)], seconds| {
        let presses = presses.iter().map(|&(at_s, for_s)| Press { at_s, for_s }).collect();
        let setup = Setup {
            presses,
            ..Setup::new(paper(), 1, seconds)
        };
        let (outcome, _) = run(&setup);
        assert!(outcome.faults.is_empty() && outcome.resets.is_empty(), "{outcome:?}");
        let modes: Vec<String> = outcome.modes.iter().map(|at| at.mode.to_string()).collect();
        (modes, outcome.lamps)
    };
    let begun = ["self-test", "homing", "coarse"];

    let (modes, lamps) = pressed(&[(0.0, 15.0)], 17.0);
    assert_eq!(modes, begun);
    assert!(lamps.blue && !lamps.red);

    let (modes, lamps) = pressed(&[(15.0, 0.3)], 17.0);
    assert_eq!(modes, [&begun[..], &["idle"]].concat());
    assert_eq!(
        lamps,
        Lamps {
            green: false,
            blue: false,
            red: false
        }
    );

    let (modes, lamps) = pressed(&[(15.0, 0.3), (17.0, 2.5)], 20.0);
    assert_eq!(modes[..4], [&begun[..], &["idle"]].concat());
    assert!(
        modes.len() > 4 && modes.last().is_some_and(|mode| mode != "idle"),
        "{modes:?}"
    );
    assert!(lamps.blue && !lamps.red);
}

/// At 2.75 V the part runs, but is not written: words of 32 bits take 2.7, and the supply may fall on the way.
#[test]
fn flash_is_not_written_on_a_low_supply() {
    let stored = vec![0xFF; 64 * 1024];
    let run_on = |supply_mv| {
        let setup = Setup {
            supply_mv,
            flash: Some(stored.clone()),
            typed: [(0.5, "set latitude 41"), (0.7, "save")]
                .map(|(at_s, text)| Typed {
                    at_s,
                    text: text.to_owned(),
                })
                .to_vec(),
            ..Setup::new(paper(), 1, 2.0)
        };
        let (outcome, kept) = run(&setup);
        let mut answers = kept.sentences.iter().filter(|text| text.starts_with("$PRNSA,"));
        // Option bytes as delivered: brown-out off.
        let told = kept
            .lines
            .iter()
            .filter(|line| line.contains("settings: the brown-out level"));
        assert_eq!(told.count(), 1, "{:?}", kept.lines);
        (
            outcome.flash == stored,
            answers.next_back().cloned().unwrap_or_default(),
        )
    };
    let (untouched, answer) = run_on(2750);
    assert!(
        answer.starts_with("$PRNSA,error,not saved: the supply is below 2.8 V*"),
        "{answer}"
    );
    assert!(untouched);
    let (untouched, answer) = run_on(3300);
    assert!(answer.starts_with("$PRNSA,ok,saved*"), "{answer}");
    assert!(!untouched);
}

/// A core that stands still is reset by the watchdog, and the unit comes up again.
#[test]
fn a_hang_ends_with_the_watchdog() {
    let (outcome, kept) = run(&Setup::new(broken(FaultKind::HangMotor, 16.0, 30.0), 1, 30.0));
    assert_eq!(outcome.resets.len(), 1, "{:?}", outcome.resets);
    let reset = &outcome.resets[0];
    assert_eq!(reset.cause, "IWDG");
    // 0.5 s from the last feeding, by a clock that is off by a few per cent.
    assert!((16.3..16.6).contains(&reset.t_s), "{}", reset.t_s);
    assert!(
        // The core stood still: nobody could note anything.
        kept.lines
            .iter()
            .any(|line| line.contains("started by watchdog; before: hang")),
        "{:?}",
        kept.lines
    );
    assert_eq!(outcome.state, "coarse");
}

/// In mid-turn, near the end of the travel, while homing: the unit finds its turn again and the cable bears it.
#[test]
fn power_cuts_at_any_instant() {
    for at_s in [3.3, 10.7, 20.15, 22.9] {
        let setup = Setup {
            power_cuts: vec![PowerCut { at_s, for_s: 0.7 }],
            ..Setup::new(paper(), 1, at_s + 28.0)
        };
        let (outcome, _) = run(&setup);
        assert_eq!(outcome.resets.len(), 1, "{:?}", outcome.resets);
        assert_eq!(outcome.state, "coarse", "cut at {at_s} s: {:?}", outcome.modes);
        assert!(outcome.travel_deg[0] > -15.0 && outcome.travel_deg[1] < 375.0);
    }
}

/// What is stored at the beginning is there for the unit, and at the end, whatever happens to its supply.
#[test]
fn the_flash_outlives_a_power_cut() {
    let stored: Vec<u8> = (0..64 * 1024_u32).map(|k| (k * 7 % 251) as u8).collect();
    let setup = |flash: Vec<u8>| Setup {
        power_cuts: vec![PowerCut { at_s: 1.0, for_s: 0.2 }],
        typed: vec![Typed {
            at_s: 0.5,
            text: "status".to_owned(),
        }],
        flash: Some(flash),
        ..Setup::new(paper(), 1, 2.0)
    };
    let (outcome, kept) = run(&setup(stored.clone()));
    assert_eq!(outcome.resets.len(), 1, "{:?}", outcome.resets);
    assert!(outcome.flash == stored);
    assert!(
        kept.lines.iter().any(|line| line.ends_with("HOST  > status")),
        "{:?}",
        kept.lines
    );

    let erased = vec![0xFF; stored.len()];
    let setup_erased = Setup {
        flash: Some(erased.clone()),
        ..Setup::new(paper(), 1, 0.1)
    };
    assert!(run(&setup_erased).0.flash == erased);
    // Where nothing is said the unit is told of the scenario, and writes nothing.
    let told = run(&Setup::new(paper(), 1, 0.1)).0.flash;
    assert!(told.len() == stored.len() && told != erased);
    assert!(matches!(
        run::run(&image(), &setup(vec![0; 3]), ()),
        Err(Error::Flash { found: 3, .. })
    ));
}

/// A fault, its retry, a reset: from the log as from the run. A log that is damaged tells what is sound in it, and that of
/// another image is refused.
#[test]
fn a_log_is_inspected() {
    let mut scenario = broken(FaultKind::EncoderSilent, 9.0, 0.5);
    scenario.fault.push(FaultAt {
        at_s: 16.0,
        for_s: Some(1.0),
        kind: FaultKind::HangMotor,
    });
    let (outcome, kept) = run(&Setup::new(scenario, 1, 24.0));
    assert_eq!((outcome.faults.len(), outcome.resets.len()), (1, 1));
    inspects_to(&outcome, &kept);
    let whole = inspected(&kept.rtt).unwrap();
    assert_eq!(whole.faults[0].name, "encoder-invalid");
    assert_eq!(whole.faults[0].retry.map(|(attempt, _)| attempt), Some(1));
    let cause = whole.starts[1].cause.as_deref().unwrap();
    assert!(cause.starts_with("watchdog; before: hang in mode "), "{cause}");
    assert_eq!(whole.state(), outcome.state);

    let mut damaged = kept.rtt.clone();
    damaged[200] ^= 0x55;
    let damaged = inspected(&damaged[7..]).unwrap();
    assert!((1..=3).contains(&damaged.damaged), "{damaged:?}");
    assert!(damaged.lines + 4 >= whole.lines && damaged.state() == whole.state());

    // The places of the texts moved by some, as in a build with lines more: of the line's, and of what is put into it.
    let other: Vec<u8> = kept
        .rtt
        .split(|b| *b == 0)
        .filter(|frame| !frame.is_empty())
        .flat_map(|frame| {
            let mut frame = rzcobs::decode(frame).unwrap();
            for k in [0, 10] {
                frame[k] = frame[k].wrapping_add(3);
            }
            rzcobs::encode(&frame).into_iter().chain([0])
        })
        .collect();
    let refused = inspected(&other).unwrap_err();
    assert!(matches!(refused, InspectError::WrongElf { .. }), "{refused}");
}

#[test]
fn memory_by_section_is_what_the_linker_says() {
    let image = image();
    let footprint = image.footprint();
    let text = footprint
        .sections
        .iter()
        .find(|section| section.name == ".text")
        .unwrap();
    assert!(text.loaded && text.size > 50_000);
    let bss = footprint
        .sections
        .iter()
        .find(|section| section.name == ".bss")
        .unwrap();
    assert!(!bss.loaded && bss.address >= 0x2000_0000);
    assert!(footprint.flash > text.size && footprint.static_ram > bss.size);
}

#[test]
fn the_command_tells_by_its_exit_code() {
    let command = |args: &[&str]| {
        let mut command = Command::new(env!("CARGO_BIN_EXE_emulator"));
        let output = command.args(args).output().unwrap();
        (output.status.code(), String::from_utf8(output.stdout).unwrap())
    };
    let rtt = std::env::temp_dir().join(format!("emulated-{}.rtt", std::process::id()));
    let (code, text) = command(&["--seconds", "2", "--rtt", &rtt.display().to_string()]);
    let bytes = std::fs::read(&rtt).unwrap();
    std::fs::remove_file(&rtt).unwrap();
    assert_eq!(inspected(&bytes).unwrap().state(), "homing");
    assert_eq!(code, Some(1), "{text}");
    assert!(text.contains("started by") && text.contains("not aligned") && text.contains("$HETHS,,V*14"));
    assert_eq!(command(&["no such image"]).0, Some(2));
    assert_eq!(command(&["--fault", "hunger@3"]).0, Some(2));
    assert_eq!(command(&["--seconds", "-1"]).0, Some(2));
    assert_eq!(command(&["--type", "status"]).0, Some(2));
}
