//! Inspection of logs: text and frames, sound, damaged, of others and of nobody; the command's files and exit codes.
#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    reason = "a test stops at the first surprise"
)]

use std::collections::BTreeMap;
use std::fs;
use std::io::{BufRead as _, BufReader, Write as _};
use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};

use app::blackbox::Start;
use app::command::ModeName;
use app::fault::Fault;
use app::hal::ResetCause;
use app::log::{Event, Report};
use hal_sim::inspect::defmt::Elf;
use hal_sim::inspect::timeline::{Source, Timeline};
use hal_sim::inspect::{InspectError, Reader, chart, of_bytes, report};
use object::write::{Object, Symbol, SymbolSection};
use object::{Architecture, BinaryFormat, Endianness, SectionKind, SymbolFlags, SymbolKind, SymbolScope};
use proptest::prelude::*;
use tempfile::TempDir;

/// Texts of the image that is made here, by level: what is told is put into them.
const TEXTS: [(&str, &str); 4] = [
    ("info", "{}"),
    ("error", "{}"),
    ("warn", "{}"),
    (
        "info",
        "aligned     rotor +12.3 deg, heading {} deg, sd {} deg, pitch {} deg, roll {} deg",
    ),
];
const INFO: usize = 0;
const ERROR: usize = 1;
const WARN: usize = 2;
const ESTIMATE: usize = 3;

/// An image that has nothing but the texts of its log: those of [`TEXTS`], the words that are put into them, and before them
/// as many others as `moved` says.
struct Image {
    path: PathBuf,
    places: BTreeMap<String, u16>,
    texts: Vec<u16>,
}

impl Image {
    fn new(dir: &Path, words: &[&str], moved: u16) -> Self {
        let mut elf = Object::new(BinaryFormat::Elf, Architecture::Arm, Endianness::Little);
        let section = elf.add_section(Vec::new(), b".defmt".to_vec(), SectionKind::Data);
        elf.append_section_data(section, &[0; 512], 1);
        let mut symbol = |name: String, section, value| {
            elf.add_symbol(Symbol {
                name: name.into_bytes(),
                value,
                size: 1,
                kind: SymbolKind::Data,
                scope: SymbolScope::Linkage,
                weak: false,
                section,
                flags: SymbolFlags::None,
            });
        };
        symbol("_defmt_version_ = 4".to_owned(), SymbolSection::Absolute, 0);
        symbol("_defmt_encoding_ = rzcobs".to_owned(), SymbolSection::Absolute, 0);
        let mut text = |tag: &str, text: &str, place: u16| {
            let name = serde_json::json!({
                "package": "p", "tag": format!("defmt_{tag}"), "data": text, "disambiguator": place.to_string(),
                "crate_name": "p"
            });
            symbol(name.to_string(), SymbolSection::Section(section), place.into());
            place
        };
        text("timestamp", "{=u64:us}", 500);
        let mut place = 1..;
        let mut next = || place.next().unwrap();
        for k in 0..moved {
            text("info", &format!("line {k} of another build"), next());
        }
        let texts = TEXTS.iter().map(|(level, line)| text(level, line, next())).collect();
        let mut places = BTreeMap::new();
        for word in ["{=f32}"].iter().chain(words) {
            places.insert((*word).to_owned(), text("derived", word, next()));
        }
        let path = dir.join(format!("image-{moved}"));
        fs::write(&path, elf.write().unwrap()).unwrap();
        Self { path, places, texts }
    }

    fn elf(&self) -> Elf {
        Elf::read(&self.path).unwrap()
    }

    fn frame(&self, t_s: f64, text: usize, arguments: &[u8]) -> Vec<u8> {
        let mut bytes = self.texts[text].to_le_bytes().to_vec();
        bytes.extend_from_slice(&((t_s * 1e6).round() as u64).to_le_bytes());
        bytes.extend_from_slice(arguments);
        let mut frame = rzcobs::encode(&bytes);
        frame.push(0);
        frame
    }

    fn word(&self, t_s: f64, text: usize, word: &str) -> Vec<u8> {
        self.frame(t_s, text, &self.places[word].to_le_bytes())
    }

    fn estimate(&self, t_s: f64, figures: [f32; 4]) -> Vec<u8> {
        let mut arguments = Vec::new();
        for x in figures {
            arguments.extend_from_slice(&self.places["{=f32}"].to_le_bytes());
            arguments.extend_from_slice(&x.to_le_bytes());
        }
        self.frame(t_s, ESTIMATE, &arguments)
    }
}

/// As the image says it, and the simulator.
const WORDS: [&str; 9] = [
    "started by power on",
    "started by watchdog",
    "mode idle -> self-test",
    "mode self-test -> homing",
    "mode homing -> coarse",
    "mode coarse -> fine",
    "mode fine -> aligned",
    "fault encoder-invalid: the encoder sends no usable angle: check magnet and wiring",
    "starting again, attempt 1",
];

/// As PowerShell's `>` writes what a program prints.
#[test]
fn a_log_in_utf16_is_the_same_log() {
    let text = "[   68.382000] INFO  coarse alignment: heading 335.45 deg, sd 2.59 deg\r\n[   71.807000] INFO  aligned\r\n\
                [   72.039000] INFO  aligned     rotor +104.7 deg, heading 320.13 deg, sd  0.885 deg, pitch  +2.59 deg, \
                roll  -5.19 deg\r\n";
    let expected = report::table(&of_bytes(text.as_bytes(), None).unwrap());
    assert!(expected.contains("320.13"), "{expected}");
    let little: Vec<u8> = text.encode_utf16().flat_map(u16::to_le_bytes).collect();
    let big: Vec<u8> = text.encode_utf16().flat_map(u16::to_be_bytes).collect();
    for wide in [
        [b"\xff\xfe", &little[..]].concat(),
        [b"\xfe\xff", &big[..]].concat(),
        little,
        big,
    ] {
        assert_eq!(report::table(&of_bytes(&wide, None).unwrap()), expected);
    }
}

/// Some printers are told to leave out the time: what the log does not tell is not made up.
#[test]
fn a_log_without_times_is_told_without_them() {
    let with = text();
    let without: String = with
        .lines()
        .map(|line| match line.split_once(' ') {
            Some((time, rest)) if time.parse::<f64>().is_ok() => format!("{}\n", rest.trim_start()),
            _ => format!("{line}\n"),
        })
        .collect();
    let (timed, untimed) = (
        of_bytes(with.as_bytes(), None).unwrap(),
        of_bytes(without.as_bytes(), None).unwrap(),
    );
    let modes = |of: &Timeline| of.modes.iter().map(|span| span.mode).collect::<Vec<_>>();
    assert_eq!(modes(&timed), modes(&untimed));
    assert_eq!((timed.state(), timed.resets), (untimed.state(), untimed.resets));
    assert_eq!(timed.estimates.len(), untimed.estimates.len());
    let table = report::table(&untimed);
    assert!(
        table.contains("without times\n") || table.contains("without times,"),
        "{table}"
    );
    assert!(
        table.contains("\nhoming at the end\n") && table.contains("\nfault: encoder-invalid"),
        "{table}"
    );
    assert!(
        !table.contains(" s: ") && !table.contains("0.0 s") && !table.contains("NaN"),
        "{table}"
    );
    let json = serde_json::to_value(report::summary(&untimed)).unwrap();
    for key in ["from_s", "to_s", "aligned_at_s", "aligning_at_s"] {
        assert!(json[key].is_null(), "{key}");
    }
    let dir = TempDir::new().unwrap();
    let output = hal_sim(dir.path(), &["inspect", "-", "--csv", "e.csv"], without.as_bytes());
    assert_eq!(output.status.code(), Some(1), "{output:?}");
    let csv = fs::read_to_string(dir.path().join("e.csv")).unwrap();
    assert!(csv.lines().nth(1).unwrap().starts_with(",aligned,359.0,"), "{csv}");
    let output = hal_sim(dir.path(), &["inspect", "-", "--svg", "e.svg"], without.as_bytes());
    let error = String::from_utf8(output.stderr).unwrap();
    assert!(
        output.status.code() == Some(2) && error.contains("the log has no times"),
        "{error}"
    );
}

/// As `defmt-print --json` writes frames: one object a line, the version of its schema first.
#[test]
fn a_log_in_json_is_the_same_log() {
    let (mut json, mut plain) = ("{\"schema_version\":1}\n".to_owned(), String::new());
    for line in text().lines().skip(1) {
        let Some((time, rest)) = line.split_once(' ').filter(|(time, _)| time.parse::<f64>().is_ok()) else {
            continue;
        };
        let (level, data) = rest.split_once(' ').unwrap();
        plain += &format!("{line}\n");
        let object = serde_json::json!({
            "data": data.trim_start(),
            "host_timestamp": 1_700_000_000_000_000_000_i64,
            "level": level,
            "location": { "file": "src/log.rs", "line": 28, "module_path": null },
            "target_timestamp": time,
        });
        json += &format!("{object}\n");
    }
    let timeline = of_bytes(json.as_bytes(), None).unwrap();
    assert_eq!(
        report::table(&timeline),
        report::table(&of_bytes(plain.as_bytes(), None).unwrap())
    );
    assert_story(&timeline);
}

#[test]
fn the_words_are_those_of_the_unit() {
    use ModeName::{Aligned, Coarse, Fine, Homing, Idle, SelfTest};
    let started = [ResetCause::PowerOn, ResetCause::Watchdog].map(|cause| {
        Start {
            cause,
            asked: false,
            before: None,
        }
        .to_string()
    });
    let modes = [Idle, SelfTest, Homing, Coarse, Fine, Aligned];
    let entered = modes.windows(2).map(|pair| Event::Mode {
        from: pair[0],
        to: pair[1],
    });
    let events = entered.chain([Event::Fault(Fault::EncoderInvalid), Event::Retry { attempt: 1 }]);
    let said: Vec<String> = started
        .into_iter()
        .chain(events.map(|event| event.to_string()))
        .collect();
    assert_eq!(said, WORDS);
    let report = Report {
        mode: Aligned,
        attitude_deg: Some([7.25, 0.5, -0.25, 0.9]),
        rotor_deg: Some(12.34),
    };
    assert_eq!(
        report.to_string(),
        "aligned     rotor  +12.3 deg, heading   7.25 deg, sd  0.900 deg, pitch  +0.50 deg, roll  -0.25 deg"
    );
    assert_eq!(
        Report {
            mode: Homing,
            attitude_deg: None,
            rotor_deg: None
        }
        .to_string(),
        "homing      rotor unknown"
    );
}

/// What happens in the log of these tests, by time: which text, and which word.
const STORY: [(f64, usize, usize); 13] = [
    (0.001, INFO, 0),
    (0.002, INFO, 2),
    (1.2, INFO, 3),
    (4.0, ERROR, 7),
    (4.5, WARN, 8),
    (4.6, INFO, 2),
    (5.8, INFO, 3),
    (13.8, INFO, 4),
    (68.3, INFO, 5),
    (69.8, INFO, 6),
    // A clock that begins anew.
    (0.001, INFO, 1),
    (0.002, INFO, 2),
    (1.3, INFO, 3),
];

/// Figures of the estimate number k.
fn figures(k: u16) -> [f32; 4] {
    let k = f32::from(k);
    [(359.0 + 0.1 * k) % 360.0, 0.9 - 0.01 * k, 0.5, -0.25 * k]
}

const ESTIMATES: u16 = 30;

/// The story as frames.
fn frames(image: &Image) -> Vec<u8> {
    // The first byte of an image that starts.
    let mut stream = vec![0];
    for (k, (t_s, text, word)) in STORY.iter().enumerate() {
        if k == 10 {
            for k in 0..ESTIMATES {
                stream.extend(image.estimate(70.0 + f64::from(k), figures(k)));
            }
        }
        stream.extend(image.word(*t_s, *text, WORDS[*word]));
    }
    stream
}

/// The story as defmt-print prints it, a line of its own for the place in the source.
fn text() -> String {
    let mut lines = String::from("Programming... done\n");
    let mut put = |t_s: f64, text: usize, line: &str| {
        let level = TEXTS[text].0.to_uppercase();
        lines += &format!("{t_s:.6} {level:<5} {line}\n└─ app::log @ firmware/crates/app/src/log.rs:28\n");
    };
    for (k, (t_s, text, word)) in STORY.iter().enumerate() {
        if k == 10 {
            for k in 0..ESTIMATES {
                let [heading, sd, pitch, roll] = figures(k);
                let line = format!(
                    "aligned     rotor +12.3 deg, heading {heading} deg, sd {sd} deg, pitch {pitch} deg, roll {roll} deg"
                );
                put(70.0 + f64::from(k), ESTIMATE, &line);
            }
        }
        put(*t_s, *text, WORDS[*word]);
    }
    lines
}

/// Whether a timeline is that of the story.
fn assert_story(timeline: &Timeline) {
    let modes: Vec<_> = timeline.modes.iter().map(|span| span.mode).collect();
    assert_eq!(
        modes,
        [
            "self-test",
            "homing",
            "self-test",
            "homing",
            "coarse",
            "fine",
            "aligned",
            "self-test",
            "homing"
        ]
    );
    let aligned = &timeline.modes[6];
    assert!(
        (aligned.from_s - 69.8).abs() < 1e-9 && (aligned.to_s - 99.0).abs() < 1e-9,
        "{aligned:?}"
    );
    assert_eq!(timeline.state(), "homing");
    assert!((timeline.to_s - 100.3).abs() < 1e-9, "{}", timeline.to_s);
    assert_eq!((timeline.resets, timeline.starts.len()), (1, 2));
    assert_eq!(timeline.starts[1].cause.as_deref(), Some("watchdog"));
    let fault = &timeline.faults[0];
    assert_eq!(
        (fault.name.as_str(), fault.retry, fault.latched),
        ("encoder-invalid", Some((1, 4.5)), false)
    );
    assert_eq!(timeline.estimates.len(), usize::from(ESTIMATES));
    for (k, estimate) in (0..).zip(&timeline.estimates) {
        let a = &estimate.attitude;
        let found = [a.heading_deg, a.heading_sd_deg, a.pitch_deg, a.roll_deg];
        assert!(
            found
                .iter()
                .zip(figures(k))
                .all(|(found, x)| (found - f64::from(x)).abs() < 1e-4),
            "{estimate:?}"
        );
        assert_eq!(estimate.mode, Some("aligned"));
    }
    assert_eq!(timeline.below_s(0.7), Some(91.0));
}

#[test]
fn frames_and_text_tell_the_same() {
    let dir = TempDir::new().unwrap();
    let image = Image::new(dir.path(), &WORDS, 0);
    let stream = frames(&image);
    let whole = of_bytes(&stream, Some(image.elf())).unwrap();
    assert_eq!((whole.source, whole.damaged), (Source::Defmt, 0));
    assert_story(&whole);
    assert_story(&of_bytes(text().as_bytes(), None).unwrap());

    // However the bytes come.
    for piece in [1, 7, 64] {
        for (bytes, elf) in [(&stream[..], Some(image.elf())), (text().as_bytes(), None)] {
            let mut reader = Reader::new(elf);
            let mut news = 0;
            for bytes in bytes.chunks(piece) {
                reader.push(bytes, &mut |_, _| news += 1).unwrap();
            }
            let timeline = reader.finish(&mut |_, _| news += 1).unwrap();
            assert_story(&timeline);
            assert_eq!(news, STORY.len() + usize::from(ESTIMATES));
        }
    }
}

/// Samples that are missing, by a host's log at level debug.
#[test]
fn samples_are_counted() {
    let log = "[    1.000000] INFO  3 samples lost, 3 in all\n\
               [    2.000000] INFO  4 samples lost, 7 in all\n\
               [    2.000000] DEBUG 20.0 ms without data, bridged\n\
               [    3.000000] DEBUG sample repeated, 1 in all\n\
               [    3.500000] WARN  alignment does not keep up: 2 samples dropped\n\
               [    4.000000] INFO  no longer aligned: heading sd 1.20 deg\n\
               [    5.000000] ERROR panic at src/main.rs:12\n\
               [    6.000000] ERROR fault latched: reset it by command\n";
    let timeline = of_bytes(log.as_bytes(), None).unwrap();
    let s = timeline.samples;
    assert_eq!((s.lost, s.gaps, s.repeated, s.overruns, s.bridged), (7, 2, 1, 2, 1));
    assert!((s.bridged_ms - 20.0).abs() < 1e-9);
    assert_eq!((timeline.setbacks.len(), timeline.errors.len()), (1, 1));
    let table = report::table(&timeline);
    assert!(
        table.contains("7 lost in 2 gaps") && table.contains("panic at src/main.rs:12"),
        "{table}"
    );
}

/// What the simulated unit prints is understood, every line of it, and its result is that of the run.
#[test]
fn the_simulated_unit_is_inspected() {
    let dir = TempDir::new().unwrap();
    let arguments = [
        "unit",
        "--seconds",
        "90",
        "--quiet",
        "--log-level",
        "debug",
        "--nmea",
        "port.nmea",
    ];
    let output = hal_sim(dir.path(), &arguments, b"");
    let timeline = of_bytes(&output.stdout, None).unwrap();
    assert_eq!(timeline.understood, timeline.lines);
    let modes: Vec<_> = timeline.modes.iter().map(|span| span.mode).collect();
    assert_eq!(modes, ["self-test", "homing", "coarse", "fine", "aligned"]);
    let printed = String::from_utf8(output.stdout).unwrap();
    for span in &timeline.modes {
        assert!(
            printed.contains(&format!("{} {:.2} s", span.mode, span.from_s)),
            "{span:?}"
        );
    }
    // What the unit does is told at each second, or with the first estimate after it.
    let seconds = printed
        .lines()
        .filter(|line| line.contains(" rotor ") && !line.contains("homed"));
    for (k, line) in (1..).zip(seconds) {
        let late_s = line[1..13].trim().parse::<f64>().unwrap() - f64::from(k);
        let most_s = if line.contains("heading") { 0.1 } else { 1e-3 };
        assert!((0.0..most_s).contains(&late_s), "{line}");
    }
    // The serial port tells the modes too, and the estimates.
    let port = of_bytes(&fs::read(dir.path().join("port.nmea")).unwrap(), None).unwrap();
    assert_eq!(port.state(), timeline.state());
    assert!(port.estimates.len() > 20, "{}", port.estimates.len());
    for (port, log) in port.modes.iter().zip(&timeline.modes) {
        assert!(
            port.mode == log.mode && (port.from_s - log.from_s).abs() < 0.2,
            "{port:?} {log:?}"
        );
    }
}

/// Answers of the unit stand among the lines of its log where they came: no clock goes back, and nothing looks like a reset.
#[test]
fn answers_stand_in_the_log_at_their_time() {
    let dir = TempDir::new().unwrap();
    let arguments = [
        "unit",
        "--seconds",
        "20",
        "--quiet",
        "--type",
        "0.1 version",
        "--type",
        "20.2 show",
    ];
    let printed = hal_sim(dir.path(), &arguments, b"").stdout;
    let text = String::from_utf8_lossy(&printed);
    let log: Vec<_> = text.lines().filter(|line| line.starts_with('[')).collect();
    assert!(
        log.iter().filter(|line| line.contains("$PRNSA,")).count() > 10,
        "{text}"
    );
    let times = log.iter().map(|line| line[1..13].trim().parse::<f64>().unwrap());
    assert!(times.is_sorted(), "{text}");
    assert_eq!(of_bytes(&printed, None).unwrap().resets, 0);
}

#[test]
fn what_is_no_log_is_refused_in_words() {
    let dir = TempDir::new().unwrap();
    let image = Image::new(dir.path(), &WORDS, 0);
    let stream = frames(&image);
    assert_eq!(of_bytes(b"", None), Err(InspectError::Empty));
    assert_eq!(of_bytes(&stream, None), Err(InspectError::NeedsElf));
    assert!(matches!(
        of_bytes(b"lorem ipsum dolor\nsit amet\n", None),
        Err(InspectError::NotOurs)
    ));
    // A build with a line more, and with some.
    for moved in [1, 4] {
        let other = Image::new(dir.path(), &WORDS, moved);
        let Err(InspectError::WrongElf { understood, frames, .. }) = of_bytes(&stream, Some(other.elf())) else {
            panic!("another build's log is taken for this one's");
        };
        assert!(2 * understood < frames, "{understood} of {frames}");
    }
    let junk: Vec<u8> = (0..5000_u32)
        .map(|k| (k.wrapping_mul(2_654_435_761) >> 24) as u8)
        .collect();
    assert!(matches!(
        of_bytes(&junk, Some(image.elf())),
        Err(InspectError::WrongElf { .. })
    ));

    // A terminal that saves text: each byte beyond ASCII a character, or a mark.
    let latin: String = stream.iter().map(|byte| char::from(*byte)).collect();
    for text in [latin, String::from_utf8_lossy(&stream).into_owned()] {
        assert_eq!(of_bytes(text.as_bytes(), None), Err(InspectError::SavedAsText));
        assert_eq!(
            of_bytes(text.as_bytes(), Some(image.elf())),
            Err(InspectError::SavedAsText)
        );
    }

    let no_elf = dir.path().join("no.elf");
    fs::write(&no_elf, b"neither").unwrap();
    assert!(matches!(Elf::read(&no_elf), Err(InspectError::Elf { .. })));
    assert!(matches!(
        Elf::read(&dir.path().join("none")),
        Err(InspectError::Read(..))
    ));
    // An executable that does not log by defmt.
    let host = std::env::current_exe().unwrap();
    let Err(InspectError::Elf { problem, .. }) = Elf::read(&host) else {
        panic!("the test has a log of its own");
    };
    assert!(problem.contains("defmt"), "{problem}");
}

fn hal_sim(dir: &Path, arguments: &[&str], input: &[u8]) -> Output {
    let mut child = Command::new(env!("CARGO_BIN_EXE_hal-sim"))
        .current_dir(dir)
        .args(arguments)
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    // The command may have ended before it has read all.
    let _ = child.stdin.take().unwrap().write_all(input);
    child.wait_with_output().unwrap()
}

#[test]
fn the_command_writes_table_csv_chart_and_json() {
    let dir = TempDir::new().unwrap();
    let image = Image::new(dir.path(), &WORDS, 0);
    fs::write(dir.path().join("run.rtt"), frames(&image)).unwrap();
    let arguments = [
        "inspect", "run.rtt", "--elf", "image-0", "--csv", "e.csv", "--svg", "e.svg",
    ];
    let output = hal_sim(dir.path(), &arguments, b"");
    // Homing at the end.
    assert_eq!(output.status.code(), Some(1), "{output:?}");
    let table = String::from_utf8(output.stdout).unwrap();
    for part in [
        "defmt: 43 lines",
        "began to align at 13.8 s, aligned 56.0 s later",
        "30 estimates, every 1.00 s",
        "fault at 4.000 s: encoder-invalid",
        "attempt 1 at 4.500 s",
        "by watchdog",
        "1 fault, 1 reset",
    ] {
        assert!(table.contains(part), "{part}: {table}");
    }
    let csv = fs::read_to_string(dir.path().join("e.csv")).unwrap();
    let rows: Vec<_> = csv.lines().collect();
    assert_eq!(rows.len(), 1 + usize::from(ESTIMATES));
    assert_eq!(rows[0], "t_s,mode,heading_deg,heading_sd_deg,pitch_deg,roll_deg");
    assert!(rows[1].starts_with("70.0,aligned,359.0,"), "{}", rows[1]);
    let svg = fs::read_to_string(dir.path().join("e.svg")).unwrap();
    for part in [
        "heading (°)",
        "σ of heading (°)",
        "time (s)",
        "1 encoder-invalid, 4.0 s",
        "aligned",
    ] {
        assert!(svg.contains(part), "{part}");
    }
    // 359 to 360 and on: the axis goes round.
    let has = |tick: &str| svg.lines().any(|line| line.trim() == tick);
    assert!(has("359") && has("0") && has("1") && !has("360") && !has("361"));

    let output = hal_sim(dir.path(), &["inspect", "-", "--json"], text().as_bytes());
    let json: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(json["state"], "homing");
    assert_eq!(json["estimates"].as_array().unwrap().len(), usize::from(ESTIMATES));
    assert_eq!(json["faults"][0]["name"], "encoder-invalid");

    // Aligned where the log ends before the reset.
    let text = text();
    let before = &text[..text.find("started by watchdog").unwrap() - 20];
    assert_eq!(
        hal_sim(dir.path(), &["inspect", "-"], before.as_bytes()).status.code(),
        Some(0)
    );
    for (arguments, part) in [
        (&["inspect", "none"][..], "cannot read none"),
        (&["inspect", "run.rtt"], "--elf"),
        (&["inspect", "e.csv"], "no line of the unit's log"),
        (&["inspect", "run.rtt", "--elf", "e.svg"], "e.svg"),
        (&["inspect", "-"], "empty"),
        (
            &["inspect", "run.rtt", "--elf", "image-0", "--csv", "no/such/dir.csv"],
            "cannot write no/such/dir.csv",
        ),
    ] {
        let output = hal_sim(dir.path(), arguments, b"");
        let error = String::from_utf8(output.stderr).unwrap();
        assert_eq!(output.status.code(), Some(2), "{arguments:?}: {error}");
        assert!(
            error.starts_with("error: ") && error.contains(part),
            "{arguments:?}: {error}"
        );
    }
}

/// Without a terminal: a line for each thing that is new, and the table at the end.
#[test]
fn a_pipe_is_followed_to_its_end() {
    let dir = TempDir::new().unwrap();
    let output = hal_sim(dir.path(), &["inspect", "--follow", "-"], text().as_bytes());
    let lines = String::from_utf8(output.stdout).unwrap();
    assert!(!lines.contains('\u{1b}'), "{lines}");
    assert!(
        lines.contains("     4.000  ERROR fault encoder-invalid: the encoder sends no usable angle"),
        "{lines}"
    );
    assert!(lines.contains("aligned     heading  359.000°  σ  0.9000°"), "{lines}");
    assert!(lines.contains("30 estimates, every 1.00 s"), "{lines}");
    assert_eq!(
        hal_sim(dir.path(), &["inspect", "--follow", "-"], b"").status.code(),
        Some(2)
    );
}

/// What is added to a file is told when it is there.
#[test]
fn a_file_is_followed_while_it_grows() {
    let dir = TempDir::new().unwrap();
    let image = Image::new(dir.path(), &WORDS, 0);
    let path = dir.path().join("run.rtt");
    fs::write(&path, image.word(0.001, INFO, WORDS[0])).unwrap();
    let mut child = Command::new(env!("CARGO_BIN_EXE_hal-sim"))
        .current_dir(dir.path())
        .args(["inspect", "--follow", "run.rtt", "--elf", "image-0"])
        .stdout(Stdio::piped())
        .spawn()
        .unwrap();
    let mut lines = BufReader::new(child.stdout.take().unwrap()).lines();
    assert_eq!(
        lines.next().unwrap().unwrap().trim(),
        "0.001  INFO  started by power on"
    );
    let mut file = fs::OpenOptions::new().append(true).open(&path).unwrap();
    let frame = image.estimate(2.0, figures(3));
    file.write_all(&frame[..5]).unwrap();
    file.write_all(&frame[5..]).unwrap();
    let line = lines.next().unwrap().unwrap();
    assert!(line.contains("heading  359.300°"), "{line}");
    // Begun anew.
    fs::write(&path, image.word(0.001, INFO, WORDS[1])).unwrap();
    assert!(lines.next().unwrap().unwrap().ends_with("started by watchdog"));
    child.kill().unwrap();
    let _ = child.wait().unwrap();
}

/// Whatever it is: read or refused, and what is read can be printed and drawn.
fn survives(bytes: &[u8], elf: Option<Elf>, dir: &Path) {
    if let Ok(timeline) = of_bytes(bytes, elf) {
        let _ = report::table(&timeline);
        chart::svg(&dir.join("any.svg"), &timeline).unwrap();
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(200))]

    #[test]
    fn any_bytes_are_survived(bytes in proptest::collection::vec(any::<u8>(), 0..600)) {
        let dir = TempDir::new().unwrap();
        let image = Image::new(dir.path(), &WORDS, 0);
        survives(&bytes, Some(image.elf()), dir.path());
        survives(&bytes, None, dir.path());
        // After a beginning that is sound.
        let mut stream = frames(&image);
        stream.extend_from_slice(&bytes);
        survives(&stream, Some(image.elf()), dir.path());
    }

    #[test]
    fn a_damaged_log_tells_what_is_sound(
        cut in 0..2000_usize,
        hits in proptest::collection::vec((0..2000_usize, any::<u8>()), 0..8),
    ) {
        let dir = TempDir::new().unwrap();
        let image = Image::new(dir.path(), &WORDS, 0);
        for (whole, elf) in [(frames(&image), Some(image.elf())), (text().into_bytes(), None)] {
            let raw = elf.is_some();
            let mut bytes = whole[cut.min(whole.len())..].to_vec();
            for (at, value) in &hits {
                if let Some(byte) = bytes.get_mut(*at) {
                    *byte = *value;
                }
            }
            survives(&bytes, elf, dir.path());
            if raw && let Ok(timeline) = of_bytes(&bytes, Some(image.elf())) {
                // Each hit damages one frame, or cuts it in two, or joins it with the next.
                prop_assert!(timeline.damaged <= 1 + 2 * hits.len() as u64, "{timeline:?}");
            }
        }
    }

    #[test]
    fn any_text_is_survived(text in "([0-9.:]{0,9} ?(INFO|ERROR|WARN) (heading|sd|pitch|roll|mode|fault|->|[ -~]|[0-9.e-]{1,4}| ){0,12}\n){0,20}") {
        let dir = TempDir::new().unwrap();
        survives(text.as_bytes(), None, dir.path());
    }

    /// Figures that a float can have and an axis cannot.
    #[test]
    fn any_figures_are_drawn(figures in proptest::collection::vec((any::<f32>(), any::<[f32; 4]>()), 1..12)) {
        let dir = TempDir::new().unwrap();
        let image = Image::new(dir.path(), &WORDS, 0);
        let mut stream = Vec::new();
        for (t, figures) in figures {
            let t_s = f64::from(t.abs().min(1e9));
            stream.extend(image.estimate(if t_s.is_finite() { t_s } else { 0.0 }, figures));
        }
        survives(&stream, Some(image.elf()), dir.path());
    }
}
