//! The unit's record on its serial line: encoded by the unit's code, amid sentences and damage, read and replayed.
#![allow(clippy::unwrap_used, reason = "a test stops at the first surprise")]

#[path = "common/command.rs"]
mod command;
#[path = "common/paper.rs"]
mod paper;
#[path = "common/port.rs"]
mod port;

use std::fmt::Write as _;
use std::fs;
use std::path::Path;
use std::sync::OnceLock;

use app::command::ModeName;
use app::fault::Fault;
use app::mode::Status;
use app::nmea::{self, HeadingMode, Talker};
use app::record::{self, Recorder, Taken};
use app::sample::TimedSample;
use drivers::{Channels, Identity, Scale};
use frames::units::DEG;
use frames::{Sensor, Vec3};
use hal_sim::align::{self, Method, Setup};
use hal_sim::log::{Header, LogError, LogReader, LogRow, LogWriter, Loss, Lost, Place, UnitStatus};
use hal_sim::replay::{self, Observer, Replay};
use hal_sim::scenario::{FaultAt, FaultKind, Scenario};
use hal_sim::simulate::Simulation;
use hal_sim::unit;
use hal_sim::unit_sim;
use nav::aligner::{Aligner, Event};
use nav::deviation::Deviation;
use nav::increment::Sample;
use nav::model::ROBUST;
use proptest::prelude::*;
use tempfile::TempDir;

use command::hal_sim;
use paper::paper;
use port::Port;

/// Samples a second of the unit.
const RATE_HZ: f64 = 202.4;

const FIRMWARE: &str = "0.1.0+5be6f0d";

const DEVIATION: Deviation = Deviation {
    rate_b: [1.7e-6, -2.3e-6],
    force_b: [0.31, -0.07],
    sd: 1.9e-7,
};

/// The figures of a unit in this scenario.
fn header(scenario: &Scenario) -> record::Header<'static> {
    let setup = Setup::of(scenario, Method::Robust);
    record::Header {
        serial: 1042,
        imu: Identity {
            product: 16495,
            revision: 0x0105,
            serial: 321,
        },
        period: (1.0 / RATE_HZ) as f32,
        scale: Scale {
            rate: 1.664_6e-9,
            force: 3.741e-8,
            temperature_c: 0.0125,
            temperature_zero_c: 25.0,
        },
        latitude: (setup.latitude_deg * DEG) as f32,
        height: setup.height_m as f32,
        schedule: nav::rotor::RotorConfig {
            rate: setup.rotor.rate as f32,
            travel: setup.rotor.travel as f32,
            acceleration: setup.rotor.acceleration as f32,
        },
        noise: align::noise(&setup.unit),
        deviation: None,
        firmware: FIRMWARE,
    }
}

fn scenario(name: &str, rate_hz: f64, seconds: f64) -> Scenario {
    let mut scenario = Scenario::builtin(name).unwrap();
    scenario.run.rate_hz = rate_hz;
    scenario.run.duration_s = seconds;
    scenario
}

/// The scenario as the unit has it: by a clock of microseconds with jitter on the edges, in f32, with an interval that
/// is measured anew every 64 samples.
fn samples(scenario: &Scenario) -> Vec<TimedSample> {
    let mut dt = (1.0 / scenario.run.rate_hz) as f32;
    let mut taken = Vec::new();
    for (k, row) in Simulation::new(scenario, 1).unwrap().enumerate() {
        if k % 64 == 63 {
            dt *= 1.0 + 1e-6 * ((k / 64 % 7) as f32 - 3.0);
        }
        let jitter_us = (k * 7919 % 5) as f64 - 2.0;
        taken.push(TimedSample {
            t_us: (2e6 + row.t * 1e6 + jitter_us).round() as u64,
            sample: Sample {
                dt,
                ..align::cast(&row.sample)
            },
            alpha: Some(row.encoder as f32),
            temperature_c: 25.0 + 0.0125 * (k / 2000) as f32,
            saturated: Channels::NONE,
        });
    }
    taken
}

/// A unit from its start, twenty seconds without alignment, and then three minutes with it.
struct Unit {
    scenario: Scenario,
    samples: Vec<(TimedSample, Taken)>,
    header: record::Header<'static>,
}

fn unit() -> &'static Unit {
    static UNIT: OnceLock<Unit> = OnceLock::new();
    UNIT.get_or_init(|| {
        let scenario = scenario("paper-sim", RATE_HZ, 200.0);
        let start = (20.0 * RATE_HZ) as usize;
        let samples = samples(&scenario).into_iter().enumerate().map(|(k, mut sample)| {
            // Before homing the turn is not known.
            if k < start / 2 {
                sample.alpha = None;
            }
            let taken = match k.cmp(&start) {
                std::cmp::Ordering::Less => Taken::No,
                std::cmp::Ordering::Equal => Taken::AlignerAnew,
                std::cmp::Ordering::Greater => Taken::Aligner,
            };
            (sample, taken)
        });
        Unit {
            header: header(&scenario),
            samples: samples.collect(),
            scenario,
        }
    })
}

fn status(mode: ModeName, fault: Option<Fault>) -> Status {
    Status {
        mode,
        since_us: 0,
        fault,
        latched: false,
        attempts: 0,
    }
}

/// A header a second, a frame a sample, and what `between` adds after each.
fn encode(
    header: &record::Header,
    samples: &[(TimedSample, Option<Taken>)],
    mut between: impl FnMut(usize, &mut Vec<u8>),
) -> Vec<u8> {
    let mut recorder = Recorder::new();
    let mut bytes = Vec::new();
    for (k, (sample, taken)) in samples.iter().enumerate() {
        if k % 202 == 0 {
            bytes.extend_from_slice(recorder.header(sample.t_us, header).as_bytes());
        }
        bytes.extend_from_slice(recorder.sample(sample, *taken).as_bytes());
        between(k, &mut bytes);
    }
    bytes
}

fn recording() -> &'static [u8] {
    static BYTES: OnceLock<Vec<u8>> = OnceLock::new();
    BYTES.get_or_init(|| {
        let samples: Vec<_> = unit().samples.iter().map(|(s, t)| (*s, Some(*t))).collect();
        encode(&unit().header, &samples, |_, _| {})
    })
}

/// A short log, for what need not align.
fn short(count: usize) -> Vec<u8> {
    let samples: Vec<_> = unit().samples.iter().skip(5000).take(count).collect();
    let samples: Vec<_> = samples.into_iter().map(|(s, t)| (*s, Some(*t))).collect();
    encode(&unit().header, &samples, |_, _| {})
}

/// The sentences of one cycle of the unit.
fn cycle(bytes: &mut Vec<u8>, k: usize) {
    let heading = Some(k as f32 * 1e-3);
    bytes.extend_from_slice(b"\r\n");
    bytes.extend_from_slice(nmea::ths(Talker::He, heading, HeadingMode::Autonomous).as_bytes());
    bytes.extend_from_slice(nmea::rot(Talker::He, Some(0.1)).as_bytes());
    bytes.extend_from_slice(nmea::hdt(Talker::He, 1.0).unwrap().as_bytes());
    bytes.extend_from_slice(nmea::answer(true, "recording").as_bytes());
}

fn read(bytes: &[u8]) -> (Vec<LogRow>, Loss, Option<LogError>) {
    let mut reader = match LogReader::new(bytes, "u.bin") {
        Ok(reader) => reader,
        Err(error) => return (Vec::new(), Loss::default(), Some(error)),
    };
    let mut rows = Vec::new();
    let mut wrong = None;
    for row in &mut reader {
        match row {
            Ok(row) => rows.push(row),
            Err(error) => wrong = Some(error),
        }
    }
    let loss = reader.loss().cloned().unwrap_or_default();
    (rows, loss, wrong)
}

fn message(bytes: &[u8]) -> String {
    read(bytes).2.unwrap().to_string()
}

fn replayed(bytes: &[u8], observer: &mut impl Observer) -> Replay {
    let reader = LogReader::new(bytes, "u.bin").unwrap();
    replay::replay_from(reader, recorded, observer).unwrap()
}

/// As a recording says itself.
fn recorded(header: Option<&Header>) -> Setup {
    replay::recorded(header.unwrap(), Method::Robust)
}

/// The sample of a row, as `replay` has it.
fn sample_of(row: &LogRow) -> Sample {
    align::cast(&row.sample())
}

fn bits(sample: &Sample) -> [u32; 8] {
    let ([a, b, c], [d, e, f]) = (sample.dtheta_s.to_array(), sample.dv_s.to_array());
    [a, b, c, d, e, f, sample.dt, sample.gap].map(f32::to_bits)
}

#[test]
fn every_sample_comes_back_to_the_bit() {
    let (rows, loss, wrong) = read(recording());
    assert_eq!(wrong, None);
    let known: Vec<_> = unit().samples.iter().filter(|(s, _)| s.alpha.is_some()).collect();
    assert_eq!(rows.len(), known.len());
    for (row, (sample, taken)) in rows.iter().zip(&known) {
        assert_eq!(bits(&sample_of(row)), bits(&sample.sample));
        assert_eq!((row.encoder as f32).to_bits(), sample.alpha.unwrap().to_bits());
        assert_eq!((row.taken, row.gap), (Some(*taken), None));
        assert!((row.t_s * 1e6 - sample.t_us as f64).abs() < 1e-3);
        assert!((row.temperature_c.unwrap() - f64::from(sample.temperature_c)).abs() < 0.013);
    }
    let without = unit().samples.len() - known.len();
    assert_eq!(loss.count(Lost::Angles), without as u64);
    for kind in [
        Lost::Bytes,
        Lost::Samples,
        Lost::Times,
        Lost::Impossible,
        Lost::Restarts,
    ] {
        assert_eq!(loss.count(kind), 0, "{kind:?}");
    }
}

/// The last estimate of the unit's aligner in f32, fed as the unit's alignment task feeds it.
fn direct(samples: &[(TimedSample, Option<Taken>)]) -> align::Reading {
    let setup = Setup::of(&unit().scenario, Method::Robust);
    let mut aligner: Aligner<f32, ROBUST> = setup.aligner().unwrap();
    for (sample, taken) in samples {
        match taken.unwrap() {
            Taken::AlignerAnew => aligner.start_anew(),
            Taken::Aligner => {}
            Taken::No | Taken::Navigator => continue,
        }
        aligner.step(&sample.sample, sample.alpha.unwrap());
    }
    align::Reading::from_estimate(&aligner.estimate().unwrap())
}

fn assert_same(replay: &Replay, expected: &align::Reading) {
    let rounded = |x: f64| (x * 1e6).round() / 1e6;
    assert_eq!(replay.state, "aligned");
    for (found, expected) in [
        (replay.heading_deg, expected.attitude.heading_deg),
        (replay.pitch_deg, expected.attitude.pitch_deg),
        (replay.roll_deg, expected.attitude.roll_deg),
        (replay.heading_sd_deg, expected.sd.heading_deg),
    ] {
        assert_eq!(found.unwrap(), rounded(expected));
    }
    assert_eq!(replay.gyro_bias_deg_h.unwrap(), expected.gyro_bias_deg_h.map(rounded));
    assert_eq!(replay.accel_bias_ug.unwrap(), expected.accel_bias_ug.map(rounded));
}

#[test]
fn a_replay_ends_in_what_the_unit_had() {
    let samples: Vec<_> = unit().samples.iter().map(|(s, t)| (*s, Some(*t))).collect();
    assert_same(&replayed(recording(), &mut ()), &direct(&samples));
}

/// A unit that is told to align again while it is aligned, rests a while in between, and navigates in the end.
#[test]
fn a_replay_does_what_the_unit_was_told() {
    let mut samples: Vec<_> = unit().samples.iter().map(|(s, t)| (*s, Some(*t))).collect();
    let at = |seconds: f64| (seconds * RATE_HZ) as usize;
    samples[at(85.0)].1 = Some(Taken::AlignerAnew);
    for (_, taken) in &mut samples[at(87.0)..at(90.0)] {
        *taken = Some(Taken::No);
    }
    samples[at(90.0)].1 = Some(Taken::AlignerAnew);
    for (_, taken) in &mut samples[at(190.0)..] {
        *taken = Some(Taken::Navigator);
    }
    let mut seen = Seen::default();
    let replay = replayed(&encode(&unit().header, &samples, |_, _| {}), &mut seen);
    assert_same(&replay, &direct(&samples));
    // To start anew because it was told to is no trouble.
    assert_eq!((seen.restarted, seen.aligned), (0, 2));
    assert!((replay.t_s - 192.0).abs() < 0.1, "{}", replay.t_s);
}

/// What the aligner is told is in the header: nothing of it need be known at the desk.
#[test]
fn the_header_gives_the_setup_to_the_bit() {
    let unit = unit();
    let reader = LogReader::new(recording(), "u.bin").unwrap();
    let found = reader.header().unwrap();
    assert_eq!(
        (found.serial, found.imu, found.scale),
        (1042, unit.header.imu, unit.header.scale)
    );
    assert_eq!((found.firmware.as_str(), found.period), (FIRMWARE, unit.header.period));
    let mut own = unit.header;
    own.noise.gyro_instability_sd = 3.3e-6;
    own.noise.gyro_instability_tau = 123.4;
    own.noise.gyro_scale_factor_sd = 1.1e-4;
    own.noise.gyro_misalignment_sd = 2.3e-4;
    own.noise.gyro_g_sensitivity_sd = 4.7e-7;
    own.noise.gyro_housing_sd = 1.9e-6;
    own.noise.accel_scale_factor_sd = 1.3e-4;
    own.noise.accel_misalignment_sd = 2.9e-4;
    own.noise.accel_instability_sd = 3.1e-4;
    own.noise.accel_instability_tau = 71.3;
    own.deviation = Some(DEVIATION);
    own.latitude = -0.123_456_7;
    for header in [unit.header, own] {
        let bytes = Recorder::new().header(0, &header).as_bytes().to_vec();
        let reader = LogReader::new(&bytes[..], "u.bin").unwrap();
        let setup = replay::recorded(reader.header().unwrap(), Method::Robust);
        let config = setup.config::<f32, ROBUST>();
        assert_eq!(config.latitude.to_bits(), header.latitude.to_bits());
        assert_eq!(
            (config.filter.noise, config.filter.deviation),
            (header.noise, header.deviation)
        );
        let rotor = nav::rotor::RotorConfig {
            rate: setup.rotor.rate as f32,
            travel: setup.rotor.travel as f32,
            acceleration: setup.rotor.acceleration as f32,
        };
        assert_eq!(rotor, header.schedule);
    }
}

/// The same samples as CSV. A CSV has no interval of its own, so the clock must tick as the samples come; in full
/// digits it then gives the same result, in the twelve that a log is written with the same to 1e-3 of σ.
#[test]
fn a_recording_and_the_csv_of_it_give_the_same() {
    let scenario = scenario("paper-sim", 100.0, 180.0);
    let samples: Vec<_> = samples(&scenario)
        .into_iter()
        .enumerate()
        .map(|(k, mut sample)| {
            sample.t_us = 10_000 * (k as u64 + 1);
            sample.sample.dt = 0.01;
            (sample, None)
        })
        .collect();
    let mut full =
        String::from("t_s,gyro_x_rad_s,gyro_y_rad_s,gyro_z_rad_s,accel_x_m_s2,accel_y_m_s2,accel_z_m_s2,encoder_rad\n");
    let mut written = LogWriter::new(Vec::new(), false).unwrap();
    let mut before = 0.0;
    for (k, (sample, _)) in samples.iter().enumerate() {
        let t = sample.t_us as f64 * 1e-6;
        // The reader takes the second interval for the first.
        let dt = if k == 0 {
            samples[1].0.t_us as f64 * 1e-6 - t
        } else {
            t - before
        };
        before = t;
        let (dtheta, dv) = (sample.sample.dtheta_s.cast::<f64>(), sample.sample.dv_s.cast::<f64>());
        let ([wx, wy, wz], [fx, fy, fz]) = ((dtheta / dt).to_array(), (dv / dt).to_array());
        let alpha = f64::from(sample.alpha.unwrap());
        writeln!(full, "{t},{wx:e},{wy:e},{wz:e},{fx:e},{fy:e},{fz:e},{alpha:e}").unwrap();
        written.write(t, dt, dtheta, dv, alpha, None).unwrap();
    }
    let binary = encode(&header(&scenario), &samples, |_, _| {});
    let setup = Setup::of(&scenario, Method::Robust);
    let replay = |bytes: &[u8]| {
        let reader = LogReader::new(bytes, "l").unwrap();
        replay::replay_from(reader, |_| setup.clone(), &mut ()).unwrap()
    };
    let recorded = replay(&binary);
    assert_eq!(recorded.state, "aligned");
    assert_eq!(recorded, replay(full.as_bytes()));
    let twelve = replay(&written.finish().unwrap());
    let off = |a: Option<f64>, b: Option<f64>, sd: Option<f64>| (a.unwrap() - b.unwrap()).abs() / sd.unwrap();
    assert!(
        off(recorded.heading_deg, twelve.heading_deg, recorded.heading_sd_deg) < 1e-3,
        "{recorded:?} {twelve:?}"
    );
}

#[derive(Default)]
struct Seen {
    bridged: u64,
    restarted: u64,
    aligned: u64,
    statuses: Vec<UnitStatus>,
    warnings: Vec<String>,
}

impl Observer for Seen {
    fn event(&mut self, _t: f64, event: &Event<f32>) {
        match event {
            Event::Bridged { .. } => self.bridged += 1,
            Event::Restarted(_) => self.restarted += 1,
            Event::Aligned => self.aligned += 1,
            _ => {}
        }
    }

    fn status(&mut self, status: &UnitStatus) {
        self.statuses.push(status.clone());
    }

    fn warning(&mut self, warning: &hal_sim::log::LogWarning) {
        self.warnings.push(warning.to_string());
    }
}

#[test]
fn sentences_and_statuses_amid_frames_change_nothing() {
    let unit = unit();
    let samples: Vec<_> = unit.samples.iter().map(|(s, t)| (*s, Some(*t))).collect();
    let changes = [
        (100, status(ModeName::SelfTest, None)),
        (5000, status(ModeName::Fine, None)),
        (30_000, status(ModeName::Fault, Some(Fault::ImuRestarted))),
    ];
    let mut cycles = 0;
    let mixed = encode(&unit.header, &samples, |k, bytes| {
        if k % 20 == 7 {
            cycle(bytes, k);
            cycles += 1;
        }
        if let Some((_, status)) = changes.iter().find(|(at, _)| *at == k) {
            bytes.extend_from_slice(record::status(samples[k].0.t_us, status).as_bytes());
        }
    });
    let (rows, loss, wrong) = read(&mixed);
    assert_eq!(wrong, None);
    assert_eq!((loss.count(Lost::Bytes), loss.count(Lost::Samples)), (0, 0));
    assert_eq!(loss.sentences, 4 * cycles);
    let plain = read(recording()).0;
    assert!(rows.iter().zip(&plain).all(|(a, b)| LogRow { at: b.at, ..*a } == *b));
    let mut seen = Seen::default();
    assert_eq!(replayed(&mixed, &mut seen), replayed(recording(), &mut ()));
    let told: Vec<_> = seen.statuses.iter().map(ToString::to_string).collect();
    assert_eq!(told, ["self-test", "fine", "fault: imu-restarted"]);
    assert!((seen.statuses[1].t_s - samples[5000].0.t_us as f64 * 1e-6).abs() < 1e-9);
}

/// What the stream takes of 115200 baud at 10 bits a byte: alone three quarters, with the sentences all but a tenth.
#[test]
fn the_stream_fits_the_line() {
    let seconds = unit().scenario.run.duration_s;
    let of = |bytes: usize| bytes as f64 / seconds;
    let alone = of(recording().len());
    // A sample is a quarter shorter where the angle is not known, which is the first twentieth.
    assert!((8000.0..0.75 * 11_520.0).contains(&alone), "{alone}");
    assert!(alone + 1300.0 < 11_500.0, "{alone}");
    println!("{alone:.0} bytes a second");
}

/// The recording with one byte of `every` on the average changed, from a byte on.
fn corrupted(bytes: &[u8], every: u64, from: usize) -> (Vec<u8>, u64) {
    let mut state = 0x9E37_79B9_7F4A_7C15_u64;
    let mut chance = || {
        state ^= state << 13;
        state ^= state >> 7;
        state ^= state << 17;
        state >> 16
    };
    let mut damaged = bytes.to_vec();
    let mut count = 0;
    for byte in &mut damaged[from..] {
        if chance().is_multiple_of(every) {
            *byte ^= (chance() % 255 + 1) as u8;
            count += 1;
        }
    }
    (damaged, count)
}

/// Of every hundred bytes one is wrong: a third of the frames is lost, each of them is known, none that is wrong is
/// taken, and the replay goes to the end.
#[test]
fn one_byte_in_a_hundred_is_wrong() {
    let (damaged, count) = corrupted(recording(), 100, 0);
    assert!(count > 10_000, "{count}");
    let (rows, loss, wrong) = read(&damaged);
    assert_eq!(wrong, None);
    let times: std::collections::HashMap<_, _> = unit().samples.iter().map(|(s, _)| (s.t_us, s)).collect();
    for row in &rows {
        // What passes is what was sent; the interval may be the one before until the next that is sent.
        let sent = times[&((row.t_s * 1e6).round() as u64)];
        let mut found = sample_of(row);
        assert!((found.dt / sent.sample.dt - 1.0).abs() < 1e-4);
        (found.dt, found.gap) = (sent.sample.dt, sent.sample.gap);
        assert_eq!(bits(&found), bits(&sent.sample));
    }
    // All are accounted for from the first header on that came through, of which two thirds do not.
    let total = unit().samples.len() as u64;
    let known = loss.samples - loss.count(Lost::Times) + loss.count(Lost::Samples);
    let before = total - known;
    let through = loss.count(Lost::Times) as f64 / 0.99_f64.powi(41);
    assert!((before as f64 - through).abs() < 100.0, "{known} of {total}, {through}");
    let share = loss.count(Lost::Samples) as f64 / known as f64;
    assert!((share - (1.0 - 0.99_f64.powi(41))).abs() < 0.02, "{share}");
    let missing: u64 = rows.iter().filter_map(|row| row.gap).map(|gap| gap.missing).sum();
    let without = loss.count(Lost::Samples) + loss.count(Lost::Angles);
    assert!(
        missing <= without && missing + 3000 > loss.count(Lost::Samples),
        "{missing} {without}"
    );

    // Coarse alignment cannot do with that; the replay says so and stays at it.
    let mut seen = Seen::default();
    let replay = replayed(&damaged, &mut seen);
    assert!(
        replay.t_s > 200.0 && seen.restarted > 10,
        "{replay:?} {}",
        seen.restarted
    );
    assert!(
        seen.warnings
            .iter()
            .any(|w| w.contains("samples lost between unit and file")),
        "{:?}",
        seen.warnings
    );
    assert!(
        seen.warnings.iter().any(|w| w.starts_with("u.bin:byte ")),
        "{:?}",
        seen.warnings
    );
}

/// The same once the fine filter runs: gaps of some samples are bridged, and heading stays.
#[test]
fn a_bad_line_after_coarse_alignment_costs_little() {
    let whole = replayed(recording(), &mut ());
    let (damaged, _) = corrupted(recording(), 100, recording().len() / 2);
    let mut seen = Seen::default();
    let replay = replayed(&damaged, &mut seen);
    assert_eq!((replay.state, seen.restarted), ("aligned", 0));
    assert!(seen.bridged > 3000, "{}", seen.bridged);
    let off = (replay.heading_deg.unwrap() - whole.heading_deg.unwrap()).abs();
    assert!(off < replay.heading_sd_deg.unwrap(), "{off} {replay:?}");
}

/// A lost byte, and an added one, cost the frame they are in.
#[test]
fn bytes_lost_and_added_cost_one_frame() {
    let good = short(400);
    let all = read(&good).0.len();
    // Behind the header and the first sample.
    for at in 220..good.len() - 100 {
        if at % 7 != 0 {
            continue;
        }
        let mut dropped = good.clone();
        dropped.remove(at);
        let mut added = good.clone();
        added.insert(at, record::SYNC);
        for bytes in [dropped, added] {
            let (rows, loss, wrong) = read(&bytes);
            assert_eq!(wrong, None);
            assert!(rows.len() + 1 >= all, "{at}");
            assert_eq!(rows.len() as u64 + loss.count(Lost::Samples), all as u64, "{at}");
            assert!(
                (1..=record::LONGEST as u64 + 1).contains(&loss.count(Lost::Bytes)),
                "{at}"
            );
        }
    }
}

#[test]
fn a_lost_stretch_is_a_gap_by_the_clock() {
    let samples: Vec<_> = unit()
        .samples
        .iter()
        .skip(5000)
        .step_by(1)
        .take(20_000)
        .map(|(s, _)| (*s, None))
        .collect();
    // More samples than the index counts: 100 s at a ninth of them, as many seconds as if all were there.
    for lost in [1_usize, 5, 300, 15_000] {
        let mut recorder = Recorder::new();
        let mut bytes = recorder.header(samples[0].0.t_us, &unit().header).as_bytes().to_vec();
        for (k, (sample, taken)) in samples.iter().enumerate() {
            let frame = recorder.sample(sample, *taken);
            if !(1000..1000 + lost).contains(&k) {
                bytes.extend_from_slice(frame.as_bytes());
            }
        }
        let (rows, loss, _) = read(&bytes);
        assert_eq!(loss.count(Lost::Samples), lost as u64);
        let gap = rows[1000].gap.unwrap();
        assert_eq!(gap.missing, lost as u64);
        assert!((rows[1000].dt_s - (lost as f64 + 1.0) / RATE_HZ).abs() < 1e-3 + 1e-4 * lost as f64);
        assert!(rows.iter().enumerate().all(|(k, row)| (k == 1000) == row.gap.is_some()));
    }
}

/// A stretch longer than the index counts: the clock says how often it went round.
#[test]
fn the_index_goes_round() {
    let (first, _) = unit().samples[6000];
    let samples: Vec<_> = (0..200_u64)
        .map(|k| {
            // Ten minutes, 121440 samples, after the first hundred.
            let pause = if k >= 100 { 121_440 } else { 0 };
            let t_us = first.t_us + ((k + pause) as f64 * 1e6 / RATE_HZ).round() as u64;
            (TimedSample { t_us, ..first }, pause)
        })
        .collect();
    let mut recorder = Recorder::new();
    let mut bytes = recorder.header(first.t_us, &unit().header).as_bytes().to_vec();
    for (k, (sample, pause)) in samples.iter().enumerate() {
        if k == 100 {
            recorder.skip((pause % 65_536) as u16);
        }
        bytes.extend_from_slice(recorder.sample(sample, None).as_bytes());
    }
    assert_eq!(read(&bytes).1.count(Lost::Samples), 121_440);
}

/// Time that the unit itself lost before a sample comes as the unit had it; it is nobody's loss on the line.
#[test]
fn gaps_of_the_unit_are_its_own() {
    let mut samples: Vec<_> = unit()
        .samples
        .iter()
        .skip(5000)
        .take(500)
        .map(|(s, _)| (*s, None))
        .collect();
    let dt = samples[300].0.sample.dt;
    for (sample, _) in &mut samples[300..] {
        sample.t_us += (2e6 * f64::from(dt)) as u64;
    }
    samples[300].0.sample.gap = 2.0 * dt;
    samples[300].0.saturated = Channels::RATE_Z;
    let (rows, loss, _) = read(&encode(&unit().header, &samples, |_, _| {}));
    assert_eq!(loss.count(Lost::Samples), 0);
    assert_eq!(bits(&sample_of(&rows[300])), bits(&samples[300].0.sample));
    assert_eq!(rows[300].gap.unwrap().missing, 2);
}

#[test]
fn a_unit_that_restarts_goes_on_from_where_it_was() {
    let samples: Vec<_> = unit()
        .samples
        .iter()
        .skip(5000)
        .take(1000)
        .map(|(s, t)| (*s, Some(*t)))
        .collect();
    let mut again = samples.clone();
    for (k, (sample, _)) in again.iter_mut().enumerate() {
        sample.t_us = 900_000 + (k as f64 * 1e6 / RATE_HZ) as u64;
    }
    let first = encode(&unit().header, &samples, |_, _| {});
    let second = encode(&unit().header, &again, |_, _| {});
    for lost in [0, 5] {
        let mut bytes = first.clone();
        // Without its header the new clock is not known: until the next one.
        bytes.extend_from_slice(&second[lost..]);
        let (rows, loss, wrong) = read(&bytes);
        assert_eq!(wrong, None);
        assert_eq!(loss.count(Lost::Restarts), 1);
        assert_eq!(loss.count(Lost::Times), if lost == 0 { 0 } else { 202 });
        assert!(rows.windows(2).all(|pair| pair[0].t_s < pair[1].t_s));
        let gap = rows[1000].gap.unwrap();
        assert!(rows[1000].dt_s > 0.85 && gap.missing > 150, "{gap:?}");
    }
}

/// Who joins in gets what follows the next header.
#[test]
fn a_recording_that_begins_anywhere() {
    let good = short(1000);
    for from in [1, 60, 133, 2000] {
        let (rows, loss, wrong) = read(&good[from..]);
        assert_eq!(wrong, None);
        assert_eq!(rows.len(), 1000 - 202, "{from}");
        assert!(loss.count(Lost::Times) <= 202);
        assert!(rows.iter().all(|row| row.gap.is_none()));
    }
    // An alignment that began in what is lost is none that goes on.
    let mut samples: Vec<_> = unit()
        .samples
        .iter()
        .skip(5000)
        .take(100)
        .map(|(s, _)| (*s, Some(Taken::No)))
        .collect();
    for (k, (_, taken)) in samples.iter_mut().enumerate().skip(50) {
        *taken = Some(if k == 50 { Taken::AlignerAnew } else { Taken::Aligner });
    }
    let mut recorder = Recorder::new();
    let mut bytes = recorder.header(samples[0].0.t_us, &unit().header).as_bytes().to_vec();
    for (k, (sample, taken)) in samples.iter().enumerate() {
        let frame = recorder.sample(sample, *taken);
        if k != 50 {
            bytes.extend_from_slice(frame.as_bytes());
        }
    }
    assert_eq!(read(&bytes).0[50].taken, Some(Taken::AlignerAnew));
}

#[test]
fn what_cannot_be_read_is_said() {
    let sentence = nmea::hdt(Talker::He, 1.0).unwrap();
    assert_eq!(
        message(sentence.as_bytes()),
        "u.bin: 1 sentences, but no record of samples: switch recording on in the unit"
    );
    let header_length = 2 + usize::from(short(1)[1]) + 4;
    assert_eq!(
        message(&short(5)[header_length..]),
        "u.bin: 5 frames of a record, but no header, which comes once a second: record for longer"
    );
    assert_eq!(
        message(&short(5)[..header_length]),
        "u.bin: no rows after the header: nothing was recorded"
    );
    let blind: Vec<_> = unit().samples.iter().take(10).map(|(s, _)| (*s, None)).collect();
    assert_eq!(
        message(&encode(&unit().header, &blind, |_, _| {})),
        "u.bin: the rotor's angle is known in none of 10 samples: let the unit home, or check its encoder"
    );
    let mut other = short(5);
    other[3] = 9;
    let sum = drivers::crc::crc32(other[1..header_length - 4].iter().copied());
    other[header_length - 4..header_length].copy_from_slice(&sum.to_le_bytes());
    assert_eq!(
        message(&[sentence.as_bytes(), &other].concat()),
        "u.bin:byte 19: a record of version 9 where this program reads 3: use the program that belongs to the unit's \
         firmware"
    );
    // A figure that cannot be is left out, and its time is a gap.
    let mut samples: Vec<_> = unit()
        .samples
        .iter()
        .skip(5000)
        .take(20)
        .map(|(s, _)| (*s, None))
        .collect();
    samples[7].0.sample.dtheta_s = Vec3::<Sensor>::new(f32::NAN, 0.0, 0.0);
    let (rows, loss, _) = read(&encode(&unit().header, &samples, |_, _| {}));
    assert_eq!((rows.len(), loss.count(Lost::Impossible)), (19, 1));
    assert_eq!(rows[7].gap.unwrap().missing, 1);
}

proptest! {
    #[test]
    fn arbitrary_bytes_never_panic(bytes in prop::collection::vec(any::<u8>(), 0..2000), at in 0..1000_usize) {
        let mut mixed = short(20);
        let at = at % mixed.len();
        mixed.splice(at..at, bytes.iter().copied());
        for bytes in [bytes, mixed] {
            let (rows, _, wrong) = read(&bytes);
            prop_assert!(rows.windows(2).all(|pair| pair[0].t_s < pair[1].t_s && pair[1].dt_s > 0.0));
            prop_assert!(wrong.is_none_or(|error| !error.to_string().contains('\n')));
        }
    }

    /// Whatever frames say that are whole: the CRC is right, the content is not.
    #[test]
    fn arbitrary_bodies_never_panic(
        bodies in prop::collection::vec((any::<u8>(), prop::collection::vec(any::<u8>(), 0..117)), 0..60),
    ) {
        let mut bytes = short(3);
        for (kind, body) in bodies {
            // Mostly samples of the right length.
            let kind = if kind % 4 == 0 { kind } else { kind | record::SAMPLE };
            let mut frame = vec![record::SYNC, 0, kind];
            frame.extend_from_slice(&body);
            if kind & record::SAMPLE != 0 {
                let extra = [(record::ANGLE, 4), (record::KEY, 8), (record::GAP, 4), (record::SATURATED, 1)];
                let more: usize = extra.iter().filter(|(flag, _)| kind & flag != 0).map(|(_, length)| length).sum();
                frame.resize(2 + record::SAMPLE_FIXED + more, 0x3F);
            }
            frame[1] = (frame.len() - 2) as u8;
            let sum = drivers::crc::crc32(frame[1..].iter().copied());
            frame.extend_from_slice(&sum.to_le_bytes());
            bytes.extend_from_slice(&frame);
        }
        let (rows, _, _) = read(&bytes);
        prop_assert!(rows.windows(2).all(|pair| pair[0].t_s < pair[1].t_s && pair[1].dt_s > 0.0));
        prop_assert!(rows.iter().all(|row| row.w_is_s.norm().is_finite() && row.encoder.is_finite()));
        // Nor what comes after.
        let reader = LogReader::new(&bytes[..], "u.bin").unwrap();
        let _ = replay::replay_from(reader, recorded, &mut ());
    }

    #[test]
    fn flipped_dropped_and_cut_never_panic(
        edits in prop::collection::vec((any::<usize>(), 0..8_u8, any::<bool>()), 0..30), cut in any::<usize>(),
    ) {
        let mut bytes = short(200);
        let sent = read(&bytes).0;
        for (at, bit, drop) in edits {
            let at = at % bytes.len();
            if drop {
                bytes.remove(at);
            } else {
                bytes[at] ^= 1 << bit;
            }
        }
        bytes.truncate(cut % bytes.len() + 1);
        let (rows, _, _) = read(&bytes);
        // What comes through is what was sent, in order.
        let mut sent = sent.iter();
        for row in &rows {
            prop_assert!(sent.any(|s| s.t_s == row.t_s && s.encoder == row.encoder));
        }
    }

    #[test]
    fn any_sample_comes_back_to_the_bit(
        rate in prop::array::uniform3(-30.0..30.0_f32), force in prop::array::uniform3(-500.0..500.0_f32),
        dt in 1e-4..0.9_f32, lost in 0_u8..50, alpha in -1e3..1e3_f32,
    ) {
        let first = unit().samples[5000].0;
        let gap = f32::from(lost) * dt;
        let next = TimedSample {
            t_us: first.t_us + ((dt + gap) * 1e6) as u64,
            sample: Sample {
                dtheta_s: Vec3::new(rate[0] * dt, rate[1] * dt, rate[2] * dt),
                dv_s: Vec3::new(force[0] * dt, force[1] * dt, force[2] * dt),
                dt,
                gap,
            },
            alpha: Some(alpha),
            ..first
        };
        let (rows, _, _) = read(&encode(&unit().header, &[(first, None), (next, None)], |_, _| {}));
        prop_assert_eq!(bits(&sample_of(&rows[1])), bits(&next.sample));
        prop_assert_eq!((rows[1].encoder as f32).to_bits(), alpha.to_bits());
    }
}

/// Version 1 of a header lacks six figures of the noise, version 2 the deviation: they are those of an IMU without such errors.
#[test]
fn headers_of_earlier_versions_read() {
    let mut sent = unit().header;
    sent.noise.gyro_misalignment_sd = 2.3e-4;
    sent.noise.accel_instability_sd = 3.1e-4;
    sent.noise.accel_instability_tau = 71.3;
    sent.deviation = Some(DEVIATION);
    let before = nav::noise::ImuNoise {
        accel_instability_sd: 0.0,
        accel_instability_tau: 100.0,
        ..sent.noise
    };
    for (version, from, noise) in [(1, 94, before), (2, 118, sent.noise)] {
        let mut bytes = Recorder::new().header(0, &sent).as_bytes().to_vec();
        bytes.truncate(bytes.len() - record::CRC);
        bytes.drain(record::LEAD + from..record::LEAD + 138);
        bytes[record::LEAD + 1] = version;
        bytes[1] = u8::try_from(bytes.len() - record::LEAD).unwrap();
        let crc = drivers::crc::crc32(bytes[1..].iter().copied());
        bytes.extend_from_slice(&crc.to_le_bytes());
        let reader = LogReader::new(&bytes[..], "u.bin").unwrap();
        let found = reader.header().unwrap();
        assert_eq!((found.noise, found.deviation), (noise, None), "version {version}");
        assert_eq!(found.firmware, FIRMWARE);
    }
}

/// The bytes that `docs/log.md` shows are those of the encoder.
#[test]
fn the_example_of_the_manual() {
    let manual = fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join("../docs/log.md")).unwrap();
    let dump = manual.split("```hex\n").nth(1).unwrap().split("```").next().unwrap();
    let shown: Vec<u8> = dump
        .lines()
        .flat_map(|line| line.split('|').next().unwrap().split_whitespace())
        .map(|byte| u8::from_str_radix(byte, 16).unwrap())
        .collect();
    let header = record::Header {
        latitude: 0.698_131_7,
        height: 12.5,
        schedule: nav::rotor::RotorConfig::default(),
        noise: nav::noise::ImuNoise::default(),
        ..unit().header
    };
    let mut sample = TimedSample {
        t_us: 2_004_941,
        sample: Sample {
            dtheta_s: Vec3::new(1e-6, -2e-6, 1.724e-3),
            dv_s: Vec3::new(0.001, -0.002, 0.04845),
            dt: 0.004_940_7,
            gap: 0.0,
        },
        alpha: Some(0.25),
        temperature_c: 31.5,
        saturated: Channels::NONE,
    };
    let mut recorder = Recorder::new();
    let mut bytes = recorder.header(2_000_000, &header).as_bytes().to_vec();
    bytes.extend_from_slice(record::status(2_000_100, &status(ModeName::Coarse, None)).as_bytes());
    bytes.extend_from_slice(recorder.sample(&sample, Some(Taken::AlignerAnew)).as_bytes());
    sample.t_us += 4941;
    bytes.extend_from_slice(recorder.sample(&sample, Some(Taken::Aligner)).as_bytes());
    let hex: Vec<_> = bytes
        .chunks(16)
        .map(|row| row.iter().map(|b| format!("{b:02x}")).collect::<Vec<_>>().join(" "))
        .collect();
    assert_eq!(shown, bytes, "the encoder's bytes are\n{}", hex.join("\n"));
    let (rows, loss, _) = read(&bytes);
    assert_eq!((rows.len(), loss.count(Lost::Bytes)), (2, 0));
}

/// Terminals that save what they show, each byte as a character.
#[test]
fn a_recording_that_was_saved_as_text_is_named() {
    let message = |text: &str| LogReader::new(text.as_bytes(), "u.txt").unwrap_err().to_string();
    let latin: String = recording().iter().copied().map(char::from).collect();
    let told = message(&latin);
    assert!(
        told.starts_with("u.txt: the recording was saved as text in UTF-8") && told.contains("iconv"),
        "{told}"
    );
    let lossy = message(&String::from_utf8_lossy(recording()));
    assert!(lossy.contains("are lost: record again"), "{lossy}");
}

/// The commands that read logs read recordings as well.
#[test]
fn commands_read_recordings() {
    let dir = TempDir::new().unwrap();
    fs::write(dir.path().join("u.bin"), recording()).unwrap();
    let output = hal_sim(dir.path(), &["replay", "u.bin", "--json"]);
    assert_eq!(output.status.code(), Some(0), "{output:?}");
    let said = String::from_utf8(output.stderr).unwrap();
    assert!(said.contains("recorded by unit 1042, firmware 0.1.0+5be6f0d"), "{said}");
    assert!(said.contains("without the rotor's angle, left out"), "{said}");
    let found: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(
        found["heading_deg"],
        replayed(recording(), &mut ()).heading_deg.unwrap()
    );

    let output = hal_sim(dir.path(), &["convert", "u.bin", "u.csv"]);
    assert_eq!(output.status.code(), Some(0), "{output:?}");
    // With the figures of the IMU that the unit was told.
    let figures = unit::Unit::load(&dir.path().join("u.unit.toml")).unwrap();
    assert_eq!(
        figures,
        unit::Unit::of_noise(&LogReader::new(recording(), "u.bin").unwrap().header().unwrap().noise)
    );
    let output = hal_sim(dir.path(), &["replay", "u.bin", "--format", "psins"]);
    assert_eq!(output.status.code(), Some(2), "{output:?}");
    assert!(String::from_utf8(output.stderr).unwrap().contains("leave out --format"));
    let output = hal_sim(dir.path(), &["replay", "u.csv"]);
    assert_eq!(output.status.code(), Some(2), "{output:?}");
    assert!(String::from_utf8(output.stderr).unwrap().contains("add --latitude-deg"));
    let output = hal_sim(dir.path(), &["replay", "u.csv", "--latitude-deg", "40", "--json", "-q"]);
    let csv: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    // Not the same: it does not know when the alignment began, nor the intervals.
    let heading = |value: &serde_json::Value| value["heading_deg"].as_f64().unwrap();
    let sd = found["heading_sd_deg"].as_f64().unwrap();
    assert!((heading(&csv) - heading(&found)).abs() < 3.0 * sd, "{csv} {found}");
    let output = hal_sim(dir.path(), &["convert", "u.bin", "u.bin"]);
    assert_eq!(output.status.code(), Some(2), "{output:?}");
    assert_eq!(fs::read(dir.path().join("u.bin")).unwrap(), recording());

    let output = hal_sim(dir.path(), &["allan", "u.bin"]);
    let said = String::from_utf8(output.stderr).unwrap();
    assert!(said.contains("byte ") && said.contains("the rotor turns"), "{said}");
}

/// A rest and a turn as a unit records them, without alignment: the gyros' errors are those of the CSV of it.
#[test]
fn a_recording_calibrates() {
    let mut rest = scenario("static", 100.0, 70.0);
    rest.rotor.rate_dps = 0.0;
    let turning = scenario("static", 100.0, 40.0);
    let mut samples = samples(&rest);
    let (last, angle) = (samples.last().unwrap().t_us, samples.last().unwrap().alpha.unwrap());
    // A rotor that jumps into its turn: what it takes to come to its rate would count as rest.
    let turn = self::samples(&turning).into_iter().skip(4);
    samples.extend(turn.map(|sample| TimedSample {
        t_us: sample.t_us - 2_040_000 + last,
        alpha: sample.alpha.map(|alpha| alpha + angle),
        ..sample
    }));
    let samples: Vec<_> = samples.into_iter().map(|sample| (sample, Some(Taken::No))).collect();
    let dir = TempDir::new().unwrap();
    fs::write(dir.path().join("u.bin"), encode(&header(&turning), &samples, |_, _| {})).unwrap();
    hal_sim(dir.path(), &["convert", "u.bin", "u.csv"]);
    let of = |file| {
        let output = hal_sim(dir.path(), &["calibrate", file, "--json"]);
        assert_eq!(output.status.code(), Some(0), "{output:?}");
        serde_json::from_slice::<serde_json::Value>(&output.stdout).unwrap()
    };
    let (binary, csv) = (of("u.bin"), of("u.csv"));
    let numbers = |value: &serde_json::Value| {
        let mut found = Vec::new();
        let mut left = vec![value];
        while let Some(value) = left.pop() {
            match value {
                serde_json::Value::Array(values) => left.extend(values),
                serde_json::Value::Object(values) => left.extend(values.values()),
                _ => found.extend(value.as_f64()),
            }
        }
        found
    };
    let (binary, csv) = (numbers(&binary), numbers(&csv));
    assert!(binary.len() > 6 && binary.len() == csv.len(), "{binary:?} {csv:?}");
    // The intervals of the CSV are the clock's, with its jitter: 5 ppm of the scale factor's 190.
    let close = |(a, b): (&f64, &f64)| (a - b).abs() <= 0.03 * a.abs().max(1.0);
    assert!(binary.iter().zip(&csv).all(close), "{binary:?} {csv:?}");
}

/// An IMU whose filters delay by 3 ms more than the unit is told is found out by the unit's recording, and one that is as told
/// is not suspected.
#[test]
fn a_recording_tells_the_delay_of_its_imu() {
    for delay_ms in [0.0, 3.0] {
        let mut scenario = scenario("paper-sim", RATE_HZ, 110.0);
        scenario.errors.imu_delay_ms = delay_ms;
        let typed = ["0.1 record on".parse().unwrap()];
        let mut port = Port::default();
        unit_sim::run_session(&scenario, 5, Method::Robust, &typed, &mut port).unwrap();
        let line: Vec<u8> = port.lines.iter().flat_map(|line| &line.bytes).copied().collect();
        let found = replayed(&line, &mut Seen::default()).imu_delay.unwrap();
        assert!((found.delay_s * 1e3 - delay_ms).abs() < 0.3, "{delay_ms}: {found}");
    }
}

/// The unit in virtual time is told to record, and in the midst of its first alignment to align again at another place; its
/// motor's loop stalls now and then, so that samples have no angle.
#[test]
fn a_whole_unit_records_itself() {
    let scenario = Scenario {
        run: hal_sim::scenario::Run {
            duration_s: 150.0,
            ..paper().run
        },
        fault: [70.0, 90.0, 110.001, 130.002]
            .map(|at_s| FaultAt {
                at_s,
                for_s: Some(0.007),
                kind: FaultKind::HangMotor,
            })
            .to_vec(),
        ..paper()
    };
    let typed = ["0.1 record on", "50 set latitude 40.001", "50.5 align"].map(|line| line.parse().unwrap());
    let mut port = Port::default();
    let result = unit_sim::run_session(&scenario, 3, Method::Robust, &typed, &mut port).unwrap();
    let line: Vec<u8> = port.lines.iter().flat_map(|line| &line.bytes).copied().collect();
    assert_eq!((result.state, result.samples.overruns), ("aligned", 0));

    let reader = LogReader::new(&line[..], "u.bin").unwrap();
    let header = reader.header().unwrap();
    assert_eq!(
        (header.firmware.as_str(), header.imu.product),
        (env!("CARGO_PKG_VERSION"), 16495)
    );
    let (rows, loss, wrong) = read(&line);
    assert_eq!(wrong, None);
    for kind in [
        Lost::Bytes,
        Lost::Samples,
        Lost::Times,
        Lost::Impossible,
        Lost::Restarts,
    ] {
        assert_eq!(loss.count(kind), 0, "{kind:?}");
    }
    // Ten cycles a second of three sentences at the least: the line has room for them.
    assert!(loss.sentences as f64 > 0.95 * 30.0 * result.t_s, "{}", loss.sentences);
    assert!(line.len() as f64 / result.t_s < 0.9 * 11_520.0);

    let unseen = rows
        .windows(2)
        .filter(|rows| rows[1].t_s > 70.0 && rows[1].t_s - rows[0].t_s > 0.006);
    assert!(unseen.count() >= 2);

    // Up to the unit's last estimate, and of that no bit is lost.
    let unit = port.estimate_at(port.lines.last().unwrap()).unwrap();
    let later = |row: &&LogRow| row.t_s * 1e6 > unit.t_us as f64 + 0.5;
    let end = rows.iter().find(later).map_or(line.len(), |row| match row.at {
        Place::Byte(at) => at as usize,
        Place::Line(_) => panic!("{row:?}"),
    });
    let mut seen = Seen::default();
    let replay = replayed(&line[..end], &mut seen);
    assert_same(&replay, &align::Reading::from_estimate(&unit.estimate.unwrap()));
    let anew = rows.iter().filter(|row| row.taken == Some(Taken::AlignerAnew));
    assert_eq!(anew.count(), 2);
    assert!(
        seen.warnings
            .iter()
            .any(|warning| warning.contains("settings changed 1 time;"))
    );
    // At the first place all along it would be another heading.
    let reader = LogReader::new(&line[..end], "u.bin").unwrap();
    let elsewhere = replay::replay_from(reader, |_| Setup::of(&scenario, Method::Robust), &mut ()).unwrap();
    assert_ne!(elsewhere.heading_deg, replay.heading_deg);
    let told: Vec<_> = seen.statuses.iter().map(ToString::to_string).collect();
    assert_eq!(told, ["self-test", "homing", "coarse", "fine", "aligned"]);
}
