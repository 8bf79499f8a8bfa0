use frames::units::DEG;
use proptest::prelude::*;

use super::*;
use crate::scenario::Scenario;
use crate::sensors::Imu;
use crate::simulate::Simulation;
use crate::truth::Truth;

const HEADER: &str = "t_s,gyro_x_rad_s,gyro_y_rad_s,gyro_z_rad_s,accel_x_m_s2,accel_y_m_s2,accel_z_m_s2,encoder_rad";

fn rows(text: impl AsRef<[u8]>) -> Vec<Result<LogRow, LogError>> {
    match LogReader::new(text.as_ref(), "l.csv") {
        Ok(reader) => reader.collect(),
        Err(error) => vec![Err(error)],
    }
}

/// The message of the error the log ends with.
fn message(text: impl AsRef<[u8]>) -> String {
    rows(text).pop().unwrap().unwrap_err().to_string()
}

/// `message` of a good header and three good rows followed by `rest`.
fn message_after(rest: &str) -> String {
    message(good(3) + rest)
}

fn good(rows: u32) -> String {
    let mut text = format!("{HEADER}\n");
    for k in 1..=rows {
        text += &format!(
            "{:.2},0.1,0.2,0.349,0.1,0.2,9.8,{:.4}\n",
            f64::from(k) * 0.01,
            f64::from(k) * 0.0035
        );
    }
    text
}

/// A run written as a log.
fn log_of(scenario: &Scenario, seed: u64) -> String {
    let mut log = LogWriter::new(Vec::new(), false).unwrap();
    for row in Simulation::new(scenario, seed).unwrap() {
        let Sample { dtheta_s, dv_s, dt, .. } = row.sample;
        log.write(row.t, dt, dtheta_s, dv_s, row.encoder, None).unwrap();
    }
    String::from_utf8(log.finish().unwrap()).unwrap()
}

fn scenario(name: &str, seconds: f64) -> Scenario {
    let mut scenario = Scenario::builtin(name).unwrap();
    scenario.run.duration_s = seconds;
    scenario
}

/// The log with every row's values changed.
fn changed(text: &str, change: impl Fn(usize, &mut [f64; 8])) -> String {
    let mut out = format!("{HEADER}\n");
    for (k, line) in text.lines().skip(1).enumerate() {
        let mut values = [0.0; 8];
        for (value, field) in values.iter_mut().zip(line.split(',')) {
            *value = field.parse().unwrap();
        }
        change(k, &mut values);
        out += &values.map(|v| format!("{v:e}")).join(",");
        out.push('\n');
    }
    out
}

fn check(text: &str) -> Result<Vec<String>, String> {
    let mut checker = Checker::new("l.csv");
    for row in rows(text) {
        checker.push(&row.unwrap()).map_err(|e| e.to_string())?;
    }
    checker
        .finish()
        .map(|warnings| warnings.iter().map(ToString::to_string).collect())
        .map_err(|e| e.to_string())
}

#[test]
fn what_is_written_is_read_back() {
    let scenario = scenario("moored", 20.0);
    let truth = Truth::new(&scenario, 3).unwrap();
    let mut imu = Imu::new(&scenario, 3);
    let text = log_of(&scenario, 3);
    let mut reader = LogReader::new(text.as_bytes(), "l.csv").unwrap();
    assert_eq!(reader.nominal_dt_s(), None);
    let mut other_ulp = 0;
    for k in 1..=scenario.samples() {
        let (t0, t1) = (scenario.time(k - 1), scenario.time(k));
        let (dtheta, dv) = truth.increment(t0, t1);
        let m = imu.measure(dtheta, dv, t1 - t0);
        let row = reader.next().unwrap().unwrap();
        assert_eq!((row.at, row.t_s, row.gap), (Place::Line(k + 1), t1, None));
        assert!((row.dt_s - (t1 - t0)).abs() < 1e-15);
        let sample = row.sample();
        assert!((sample.dtheta_s - m.dtheta_s).norm() < 1e-11 * m.dtheta_s.norm());
        assert!((sample.dv_s - m.dv_s).norm() < 1e-11 * m.dv_s.norm());
        assert!((row.encoder - truth.rotor_angle(t1)).abs() < 1e-11 * row.encoder.abs());
        other_ulp += u32::from(sample.dtheta_s.cast::<f32>() != m.dtheta_s.cast::<f32>());
    }
    assert!(reader.next().is_none());
    assert!((reader.nominal_dt_s().unwrap() - 0.01).abs() < 1e-12);
    assert!(other_ulp < 5, "{other_ulp}");
}

#[test]
fn columns_in_any_order_with_temperature_and_strangers() {
    let text = "\u{feff}encoder_rad, temperature_c ,\"t_s\",note,gyro_z_rad_s,gyro_y_rad_s,gyro_x_rad_s,accel_z_m_s2,\
                accel_y_m_s2,accel_x_m_s2\r\n\
                8,25.5,0.5,hello,3,2,1,6,5,4\r\n\
                \r\n\
                8.5,26,1.0,,3,2,1,6,\"5\",4\r\n";
    let rows: Vec<_> = rows(text).into_iter().map(Result::unwrap).collect();
    assert_eq!(rows.len(), 2);
    assert_eq!(rows[0].w_is_s.to_array(), [1.0, 2.0, 3.0]);
    assert_eq!(rows[0].f_is_s.to_array(), [4.0, 5.0, 6.0]);
    assert_eq!((rows[0].encoder, rows[0].temperature_c), (8.0, Some(25.5)));
    assert_eq!((rows[0].dt_s, rows[1].dt_s), (0.5, 0.5));
    assert_eq!((rows[0].at, rows[1].at), (Place::Line(2), Place::Line(4)));
}

#[test]
fn gaps_are_told_and_kept_out_of_the_first_interval() {
    let mut lines: Vec<_> = good(100).lines().map(str::to_owned).collect();
    lines.drain(50..53);
    lines.remove(2);
    let rows: Vec<_> = rows(lines.join("\n") + "\n").into_iter().map(Result::unwrap).collect();
    assert!((rows[0].dt_s - 0.01).abs() < 1e-12);
    assert_eq!(rows[0].gap, None);
    assert_eq!(rows[1].gap.unwrap().missing, 1);
    assert!((rows[1].dt_s - 0.02).abs() < 1e-12);
    let gaps: Vec<_> = rows.iter().filter_map(|row| row.gap).collect();
    assert_eq!(gaps.len(), 2);
    assert_eq!((gaps[1].missing, gaps[1].after_s), (3, 0.49));
}

#[test]
fn headers_that_cannot_be() {
    assert_eq!(
        message(""),
        "l.csv: the file is empty: a log starts with a header that names its columns"
    );
    assert_eq!(
        message("\n\n"),
        "l.csv: the file is empty: a log starts with a header that names its columns"
    );
    assert_eq!(
        message("t_s,gyro_x_rad_s,gyro_y_rad_s,gyro_z_rad_s,accel_x_m_s2,accel_y_m_s2,accel_z_m_s2\n"),
        "l.csv:1: column missing: encoder_rad; the header must name them"
    );
    assert_eq!(
        message("t_s,gx,gyro_y_rad_s,gyro_z_rad_s,accel_x_m_s2,accel_y_m_s2,accel_z_m_s2,enc\n"),
        "l.csv:1: columns missing: gyro_x_rad_s, encoder_rad; the header must name them"
    );
    assert_eq!(
        message(format!("{HEADER},t_s\n")),
        "l.csv:1: column t_s appears twice: remove one"
    );
    assert_eq!(
        message("0.01,1,2,3,4,5,6,7\n"),
        format!("l.csv:1: no header: the first line must name the columns {HEADER}")
    );
    assert_eq!(
        message(b"\x1f\x8b\x08\x00 and so on"),
        "l.csv:1: the file is compressed: unpack it first (gunzip)"
    );
    assert_eq!(
        message(b"t_s,\xff\n"),
        "l.csv:1: byte 5 of the line is not UTF-8 text: not a log in CSV"
    );
    let missing = LogReader::open(Path::new("/nonexistent/l.csv"))
        .unwrap_err()
        .to_string();
    assert!(missing.starts_with("/nonexistent/l.csv: cannot read: "), "{missing}");
    assert!(!missing.contains('\n'));
}

#[test]
fn logs_too_short() {
    assert_eq!(
        message(HEADER),
        "l.csv:1: no rows after the header: nothing was recorded"
    );
    assert_eq!(
        message(good(0)),
        "l.csv:1: no rows after the header: nothing was recorded"
    );
    assert_eq!(
        message(good(1)),
        "l.csv:2: a single row: its interval is unknown, two rows are the least"
    );
    assert_eq!(rows(good(2)).len(), 2);
}

#[test]
fn rows_that_cannot_be() {
    assert_eq!(
        message_after("0.04,0.1,abc,0.3,0.1,0.2,9.8,0.01\n"),
        "l.csv:5: gyro_y_rad_s: `abc` is not a finite number"
    );
    assert_eq!(
        message_after("0.04,0.1,0.1,0.3,NaN,0.2,9.8,0.01\n"),
        "l.csv:5: accel_x_m_s2: `NaN` is not a finite number"
    );
    assert_eq!(
        message_after("0.04,0.1,0.1,0.3,0.1,0.2,9.8,-inf\n"),
        "l.csv:5: encoder_rad: `-inf` is not a finite number"
    );
    assert_eq!(
        message_after("0.04,0.1,0.1,0.3,0.1,0.2,9.8,\n"),
        "l.csv:5: encoder_rad: empty where a number must be"
    );
    assert_eq!(
        message_after("0.04,1e40,0.1,0.3,0.1,0.2,9.8,0\n"),
        "l.csv:5: gyro_x_rad_s: 1e40 is beyond any sensor"
    );
    assert_eq!(
        message_after("0.02,0.1,0.1,0.3,0.1,0.2,9.8,0.01\n"),
        "l.csv:5: t_s goes from 0.03 to 0.02: it must grow from row to row"
    );
    assert_eq!(
        message_after("0.03,0.1,0.1,0.3,0.1,0.2,9.8,0.01\n"),
        "l.csv:5: t_s goes from 0.03 to 0.03: it must grow from row to row"
    );
    assert_eq!(
        message_after("0.04,0.1,0.1\n"),
        "l.csv:5: 3 fields where the header has 8: remove the row or repair it"
    );
    assert_eq!(
        message_after("oops\n"),
        "l.csv:5: 1 field where the header has 8: remove the row or repair it"
    );
    let long = format!("0.04,{}\n", "1".repeat(100));
    assert_eq!(
        message_after(&format!("{long}0.05\n")),
        "l.csv:5: 2 fields where the header has 8: remove the row or repair it"
    );
    let text = format!("0.04,{},0,0,0,0,0,0\n", "x".repeat(100));
    assert_eq!(
        message_after(&text),
        format!("l.csv:5: gyro_x_rad_s: `{}…` is not a finite number", "x".repeat(32))
    );
    let mut bytes = good(3).into_bytes();
    bytes.extend(b"0.04,0.1,0.1,0.3,0.1,0.2,\xc3\x28,0.01\n");
    assert_eq!(
        message(bytes),
        "l.csv:5: byte 26 of the line is not UTF-8 text: not a log in CSV"
    );
    // The rows before the error are given.
    assert_eq!(rows(good(3) + "oops\n").iter().filter(|row| row.is_ok()).count(), 3);
}

#[test]
fn truncated_logs() {
    let truncated = "l.csv:5: the file ends inside this row: copy the log again, or remove the row";
    let row = "0.04,0.1,0.2,0.349,0.1,0.2,9.8,0.0140";
    // Wherever it is cut; the last number has four decimals in every row before it.
    for cut in 1..row.len() {
        assert_eq!(message_after(&row[..cut]), truncated, "{cut}");
    }
    // A file whose last line merely lacks its feed is whole …
    assert_eq!(rows(good(3) + row).into_iter().filter(Result::is_ok).count(), 4);
    // … and a wrong number in it is a wrong number.
    assert_eq!(
        message_after("0.04,0.1,abc,0.349,0.1,0.2,9.8,0.0140"),
        "l.csv:5: gyro_y_rad_s: `abc` is not a finite number"
    );
}

/// A file of one endless line, of which no more may be read than a line's limit.
#[derive(Debug)]
struct Endless {
    byte: u8,
    given: usize,
}

impl Read for Endless {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        self.given += buffer.len();
        assert!(self.given < 1 << 20, "slurped");
        buffer.fill(self.byte);
        Ok(buffer.len())
    }
}

#[test]
fn endless_lines_are_not_slurped() {
    for byte in [b'1', b',', b' ', 0, 0xff] {
        let error = LogReader::new(BufReader::new(Endless { byte, given: 0 }), "l.csv").unwrap_err();
        assert_eq!(
            error.to_string(),
            "l.csv:1: the line is longer than 4096 bytes: not a log in CSV"
        );
    }
    let text = good(3) + &"9".repeat(5000);
    assert_eq!(
        message(text),
        "l.csv:5: the line is longer than 4096 bytes: not a log in CSV"
    );
}

#[test]
fn what_people_write_instead_of_a_comma_a_point_and_a_name() {
    let plain = good(5);
    let values = |text: &str| -> Vec<[f64; 8]> {
        rows(text)
            .into_iter()
            .map(|row| {
                let row = row.unwrap();
                let ([a, b, c], [d, e, f]) = (row.w_is_s.to_array(), row.f_is_s.to_array());
                [row.t_s, a, b, c, d, e, f, row.encoder]
            })
            .collect()
    };
    let expected = values(&plain);
    for separator in [";", "\t", "|", " ", "  ", " ; ", ", "] {
        assert_eq!(values(&plain.replace(',', separator)), expected, "{separator:?}");
        if !separator.contains(',') {
            let german = plain.replace(',', separator).replace('.', ",");
            assert_eq!(values(&german), expected, "{separator:?}");
        }
    }
    let quoted: String = plain
        .lines()
        .map(|line| {
            line.split(',')
                .map(|field| format!("\"{}\"", field.replace('.', ",")))
                .collect::<Vec<_>>()
                .join(",")
                + "\r\n"
        })
        .collect();
    assert_eq!(values(&quoted), expected);
    assert_eq!(
        message(plain.replace('.', ",")),
        "l.csv:2: 16 fields where the header has 8: the numbers seem to have decimal commas; separate fields by semicolons, \
         or write decimal points"
    );
    assert_eq!(values(&plain.replace(HEADER, &HEADER.to_uppercase())), expected);
    assert_eq!(values(&format!("# recorded at home\n\n{plain}# the end\n")), expected);
    assert_eq!(values(&format!("# {plain}")), expected);
    assert_eq!(values(&plain.replace('\n', ",\n").replace("rad,\n", "rad\n")), expected);
    assert_eq!(
        message("# a\n# b\n"),
        format!("l.csv:2: no header: the first line must name the columns {HEADER}")
    );
}

#[test]
fn text_in_two_bytes_a_character_is_named() {
    let utf16 = |mark: &[u8]| {
        let wide = good(5).encode_utf16().flat_map(u16::to_le_bytes).collect::<Vec<u8>>();
        message([mark, wide.as_slice()].concat())
    };
    assert!(utf16(b"\xff\xfe").contains("UTF-16") && utf16(b"").contains("save it as UTF-8"));
}

#[test]
fn a_temperature_may_be_missing() {
    let text: String = good(30)
        .lines()
        .enumerate()
        .map(|(k, line)| match k {
            0 => format!("{line},temperature_c\n"),
            k if k % 10 == 1 => format!("{line},31.5\n"),
            k if k % 10 == 2 => format!("{line},NaN\n"),
            _ => format!("{line},\n"),
        })
        .collect();
    let temperatures: Vec<_> = rows(text).into_iter().map(|row| row.unwrap().temperature_c).collect();
    assert_eq!(temperatures.len(), 30);
    assert_eq!(temperatures[..3], [Some(31.5), None, None]);
}

#[test]
fn what_a_power_cut_leaves_is_no_row() {
    let whole = good(40);
    let read = |text: &[u8]| {
        let mut reader = LogReader::new(text, "l.csv").unwrap();
        let rows = reader.by_ref().map(Result::unwrap).count();
        (
            rows,
            reader.warnings().iter().map(ToString::to_string).collect::<Vec<_>>(),
        )
    };
    let told = |line, bytes| {
        vec![format!(
            "l.csv:{line}: {bytes} NUL bytes from here, as a power cut leaves them: the rows around them are used"
        )]
    };
    let nul = vec![0; 70_000];
    assert_eq!(read(&[whole.as_bytes(), &nul].concat()), (40, told(42, 70_000)));
    // In the middle of the last row, of which nothing is kept.
    let cut = whole.len() - 12;
    assert_eq!(read(&[&whole.as_bytes()[..cut], &nul].concat()), (39, told(41, 70_000)));
    // And it went on recording.
    let (before, after) = whole.as_bytes().split_at(whole.find("0.21,").unwrap());
    assert_eq!(read(&[before, &[0; 9], after].concat()), (40, told(22, 9)));
}

/// Rows of a rotor at 20 °/s as a log, stamped as `stamp` says; `keep` says which there are.
fn stamped(rows: u32, rate_hz: f64, stamp: impl Fn(u32) -> f64, keep: impl Fn(u32) -> bool) -> String {
    let mut text = format!("{HEADER}\n");
    for k in (0..rows).filter(|k| keep(*k)) {
        let alpha = f64::from(k) / rate_hz * 0.349;
        let noise = f64::from(k.wrapping_mul(2_654_435_761) >> 16) * 1e-9;
        text += &format!("{:.6},{noise},{noise},0.349,0.1,{noise},9.8,{alpha}\n", stamp(k));
    }
    text
}

/// Times, gaps and warnings that a log is read with.
fn timed(text: &str) -> (Vec<LogRow>, Vec<String>, f64) {
    let mut reader = LogReader::new(text.as_bytes(), "l.csv").unwrap();
    let rows: Vec<_> = reader.by_ref().map(Result::unwrap).collect();
    let warnings = reader.warnings().iter().map(ToString::to_string).collect();
    (rows, warnings, reader.nominal_dt_s().unwrap())
}

/// That stamps which are wrong without a loss are told so, once, and that rows come at an even rate.
fn assert_jitter(name: &str, rate_hz: f64, stamp: impl Fn(u32) -> f64) {
    let (rows, warnings, dt) = timed(&stamped(40_000, rate_hz, stamp, |_| true));
    assert_eq!(warnings.len(), 1, "{name}: {warnings:?}");
    assert!(warnings[0].contains("t_s jitters: "), "{name}: {warnings:?}");
    assert_eq!(rows.len(), 40_000, "{name}");
    assert!(rows.iter().all(|row| row.gap.is_none()), "{name}");
    assert!((dt * rate_hz - 1.0).abs() < 2e-3, "{name}: {dt}");
    let worst = rows
        .iter()
        .map(|row| (row.dt_s * rate_hz - 1.0).abs())
        .fold(0.0, f64::max);
    assert!(worst < 5e-3, "{name}: {worst}");
    let length = rows[rows.len() - 1].t_s - rows[0].t_s;
    assert!((length * rate_hz / 39_999.0 - 1.0).abs() < 1e-3, "{name}: {length}");
}

#[test]
fn stamps_that_jitter_are_no_loss() {
    let steps = |pattern: &'static [f64]| {
        let whole: f64 = pattern.iter().sum();
        move |k: u32| {
            let k = k as usize;
            (k / pattern.len()) as f64 * whole + pattern[..k % pattern.len()].iter().sum::<f64>()
        }
    };
    assert_jitter(
        "stairs",
        100.0,
        steps(&[0.005, 0.005, 0.005, 0.005, 0.005, 0.005, 0.04]),
    );
    assert_jitter("two by two", 100.0, steps(&[0.005, 0.015]));
    assert_jitter("bursts", 100.0, steps(&[0.03985, 0.00005, 0.00005, 0.00005]));
    // As they come in packets, of any size.
    for packet in [2, 10, 50, 200] {
        assert_jitter("packets", 200.0, |k| {
            f64::from(k / packet * packet + packet) / 200.0 + f64::from(k % packet) * 2e-5
        });
    }
    // Stamps of a coarse clock, from a second number of the epoch on; some are equal.
    for (rate_hz, digits) in [(400.0, 1e3), (800.0, 1e3), (99.7, 1e2), (100.3, 1e2), (250.0, 1e2)] {
        assert_jitter("rounded", rate_hz, |k| {
            ((1.7e9 + f64::from(k) / rate_hz) * digits).round() / digits
        });
    }
    // Late by anything up to two intervals.
    for late in [0.3, 0.9, 2.0] {
        assert_jitter("late", 100.0, |k| {
            f64::from(k) / 100.0 + late * 0.01 * f64::from(k.wrapping_mul(2_654_435_761) >> 16) / 65_536.0
        });
    }
    // A system that stood still now and then.
    assert_jitter("stalls", 100.0, |k| {
        let late = if k % 3000 > 2950 {
            2950 + k / 3000 * 3000 + 50
        } else {
            0
        };
        f64::from(k.max(late)) / 100.0 + f64::from(k % 3000) * 1e-6
    });
}

/// The stamp of a row by its number.
type StampOf = fn(u32) -> f64;

#[test]
fn loss_is_told_from_jitter() {
    let lost = |k: u32| !(k % 1000 == 700 || (20_000..20_030).contains(&k) || (30_500..30_502).contains(&k));
    let stamps: [(&str, StampOf); 3] = [
        ("even", |k| f64::from(k) / 100.0),
        ("late", |k| {
            f64::from(k) / 100.0 + 4e-3 * f64::from(k.wrapping_mul(2_654_435_761) >> 16) / 65_536.0
        }),
        ("stairs", |k| f64::from(k / 4 * 4 + 3) / 100.0 + f64::from(k % 4) * 1e-3),
    ];
    for (name, stamp) in stamps {
        let (rows, warnings, dt) = timed(&stamped(40_000, 100.0, stamp, lost));
        assert!((dt - 0.01).abs() < 1e-5, "{name}: {dt}");
        let missing: u64 = rows.iter().filter_map(|row| row.gap).map(|gap| gap.missing).sum();
        assert_eq!(missing, 40 + 30 + 2, "{name}: {warnings:?}");
        assert_eq!(warnings.len(), usize::from(name != "even"), "{name}: {warnings:?}");
        for row in rows.iter().filter(|row| row.gap.is_none()).skip(1) {
            assert!((row.dt_s - 0.01).abs() < 1e-4, "{name}: {row:?}");
        }
    }
}

#[test]
fn a_wrong_beginning_is_left_out() {
    let cases: [(&str, StampOf, usize); 4] = [
        (
            "too close",
            |k| f64::from(k.max(20)) / 100.0 - 1e-3 * f64::from(20 - k.min(20)),
            20,
        ),
        ("too far", |k| f64::from(k + k.min(40)) / 100.0, 40),
        (
            "from zero",
            |k| if k == 0 { 0.0 } else { 1.7e9 + f64::from(k) / 100.0 },
            1,
        ),
        (
            "from zero on",
            |k| f64::from(k) / 100.0 + if k < 150 { 0.0 } else { 1.7e9 },
            150,
        ),
    ];
    for (name, stamp, rows_out) in cases {
        let (rows, warnings, dt) = timed(&stamped(20_000, 100.0, stamp, |_| true));
        assert_eq!(rows.len(), 20_000 - rows_out, "{name}: {warnings:?}");
        assert!(
            warnings.len() == 1 && warnings[0].contains("t_s begins with "),
            "{name}: {warnings:?}"
        );
        assert!(
            (dt - 0.01).abs() < 1e-6 && rows.iter().all(|row| row.gap.is_none()),
            "{name}: {dt}"
        );
    }
}

#[test]
fn built_in_scenarios_pass_without_a_warning() {
    for name in Scenario::builtin_names() {
        for seed in 0..3 {
            assert_eq!(check(&log_of(&scenario(name, 45.0), seed)), Ok(vec![]), "{name} {seed}");
        }
    }
    // So do a perfect unit at rest, whose accelerometers never change, and a short log.
    let mut still = Scenario::default();
    still.run.duration_s = 40.0;
    assert_eq!(check(&log_of(&still, 0)), Ok(vec![]));
    assert_eq!(check(&log_of(&scenario("paper-sim", 5.0), 1)), Ok(vec![]));
}

#[test]
fn a_coarse_sensor_is_not_a_frozen_one() {
    let mut scenario = scenario("paper-sim", 60.0);
    // 16 bit at ±2000 °/s and ±16 g.
    scenario.errors.gyro_quantum = 1.065e-5;
    scenario.errors.accel_quantum = 4.79e-5;
    let text = changed(&log_of(&scenario, 1), |_, v| {
        for (v, lsb) in v[1..7].iter_mut().zip([1.065e-3; 3].into_iter().chain([4.79e-3; 3])) {
            *v = (*v / lsb).round() * lsb;
        }
    });
    assert_eq!(check(&text), Ok(vec![]));
}

#[test]
fn units_of_the_accelerometers() {
    let text = log_of(&scenario("paper-sim", 15.0), 1);
    let scaled = |factor: f64| check(&changed(&text, |_, v| v[4..7].iter_mut().for_each(|v| *v *= factor)));
    assert_eq!(
        scaled(1.0 / 9.80665).unwrap_err(),
        "l.csv:2: the accelerometers read 0.999 on average where gravity is 9.8 m/s²: they look like g, multiply by \
         9.80665 or name the unit in a --format"
    );
    assert_eq!(
        scaled(1000.0 / 9.80665).unwrap_err(),
        "l.csv:2: the accelerometers read 999.474 on average where gravity is 9.8 m/s²: they look like mg, multiply \
         by 0.00980665 or name the unit in a --format"
    );
    assert!(scaled(100.0).unwrap_err().contains("look like cm/s², multiply by 0.01"));
    assert!(
        scaled(1.0 / 0.3048)
            .unwrap_err()
            .contains("look like ft/s², multiply by 0.3048")
    );
    assert_eq!(
        scaled(0.0).unwrap_err(),
        "l.csv:2: the accelerometers read 0.000 on average where gravity is 9.8 m/s²: wrong unit or a broken axis"
    );
    // Also where the log is shorter than the window.
    let short: String = text.lines().take(100).map(|line| format!("{line}\n")).collect();
    assert!(
        check(&changed(&short, |_, v| v[6] *= 2.0))
            .unwrap_err()
            .contains("wrong unit or a broken axis")
    );
}

#[test]
fn units_and_signs_of_gyro_and_encoder() {
    for seed in 0..10 {
        let text = log_of(&scenario("paper-sim", 25.0), seed);
        let with = |gyro: f64, encoder: f64| {
            check(&changed(&text, |_, v| {
                v[1..4].iter_mut().for_each(|v| *v *= gyro);
                v[7] *= encoder;
            }))
        };
        assert_eq!(with(1.0, 1.0), Ok(vec![]));
        let gyro = with(1.0 / DEG, 1.0).unwrap_err();
        assert!(
            gyro.starts_with("l.csv:2: gyro_z_rad_s is 5")
                && gyro.ends_with(" times the encoder's rate: the gyros look like °/s, multiply by 0.0174533 or name the unit in a --format"),
            "{gyro}"
        );
        let encoder = with(1.0, 1.0 / DEG).unwrap_err();
        assert!(
            encoder.starts_with("l.csv:2: encoder_rad turns at 19.")
                && encoder.ends_with(" a second: it looks like degrees, --encoder-unit deg"),
            "{encoder}"
        );
        assert_eq!(with(1.0 / DEG, 1.0 / DEG).unwrap_err(), encoder);
        assert_eq!(
            with(1.0, -1.0).unwrap_err(),
            "l.csv:2: gyro_z_rad_s and encoder_rad turn in opposite directions: both are positive counter-clockwise \
             from above, change the sign of the wrong one; a minus in --encoder-unit is that of the encoder"
        );
    }
}

#[test]
fn other_units_of_gyro_and_encoder() {
    use core::f64::consts::TAU;
    let text = log_of(&scenario("paper-sim", 45.0), 1);
    let with = |gyro: f64, encoder: &dyn Fn(f64) -> f64| {
        check(&changed(&text, |_, v| {
            v[1..4].iter_mut().for_each(|v| *v *= gyro);
            v[7] = encoder(v[7]);
        }))
        .unwrap_err()
    };
    for (gyro, unit) in [
        (1e3, "the gyros look like mrad/s, multiply by 0.001"),
        (1e3 / DEG, "the gyros look like mdeg/s, multiply by 1.745329e-5"),
        (3600.0 / DEG, "the gyros look like degrees/h, multiply by 4.848137e-6"),
        (3.0, "the gyros look like counts"),
        (0.8, "a wrong scale"),
        (1.1, "a wrong scale"),
    ] {
        let told = with(gyro, &|alpha| alpha);
        assert!(
            told.contains("times the encoder's rate, which must be 1: ") && told.contains(unit),
            "{told}"
        );
    }
    let turns = "encoder_rad looks like turns, --encoder-unit turns";
    assert!(with(1.0, &|alpha| alpha / TAU).contains(turns));
    assert!(with(1.0, &|alpha| (alpha / TAU).rem_euclid(1.0)).contains(turns));
    assert!(with(1.0, &|alpha| -alpha / TAU).contains("one of them is reversed"));
    for pairs in [2.0, 3.0, 7.0, 11.0, 21.0] {
        let told = with(1.0, &|alpha| (pairs * alpha).rem_euclid(TAU));
        let about = pairs < 10.0 && !told.contains(&format!("about {pairs} pole pairs"));
        assert!(
            told.contains(" pole pairs, unwrap it and divide by them") && !about,
            "{told}"
        );
    }
    for bits in [12.0_f64, 14.0, 21.0] {
        let told = with(1.0, &|alpha| {
            (alpha / TAU * bits.exp2()).floor().rem_euclid(bits.exp2())
        });
        assert!(
            told.contains(&format!(
                "encoder_rad looks like counts, 2^{bits} a turn, --encoder-unit {}/turn",
                bits.exp2()
            )),
            "{told}"
        );
    }
    let told = with(1.0, &|alpha| (alpha / TAU * 36_000.0).round());
    assert!(
        told.contains("a turn: say how many, as --encoder-unit 16384/turn"),
        "{told}"
    );
}

#[test]
fn axes_of_the_accelerometers() {
    let text = log_of(&scenario("paper-sim", 5.0), 1);
    let told = check(&changed(&text, |_, v| v[4..7].iter_mut().for_each(|f| *f = -*f))).unwrap_err();
    assert!(
        told.starts_with("l.csv:2: accel_z_m_s2 is -9.") && told.contains("change the signs of all three"),
        "{told}"
    );
    let told = check(&changed(&text, |_, v| v.swap(4, 6))).unwrap_err();
    assert!(told.contains("exchange the axes"), "{told}");
}

#[test]
fn gyros_and_accelerometers_that_do_not_belong_together() {
    for name in ["paper-sim", "moored"] {
        let text = log_of(&scenario(name, 45.0), 1);
        for axes in [1..3, 4..6] {
            let told = check(&changed(&text, |_, v| {
                v[axes.clone()].iter_mut().for_each(|v| *v = -*v)
            }));
            assert!(
                told.clone().unwrap_err().contains("change the signs of x and y"),
                "{name}: {told:?}"
            );
        }
    }
}

#[test]
fn encoders_that_are_held() {
    let text = log_of(&scenario("paper-sim", 45.0), 1);
    let angles: Vec<f64> = text
        .lines()
        .skip(1)
        .map(|line| line.rsplit(',').next().unwrap().parse().unwrap())
        .collect();
    for rows in [4, 5, 10, 20, 50, 100] {
        let told = check(&changed(&text, |k, v| v[7] = angles[k / rows * rows])).unwrap_err();
        assert!(
            told.contains("encoder_rad repeats each angle for") && told.contains("degrees behind"),
            "{told}"
        );
    }
    // A coarse encoder is none.
    for bits in [9, 10, 12, 14] {
        let count = core::f64::consts::TAU / f64::from(1 << bits);
        let coarse = changed(&text, |_, v| v[7] = (v[7] / count).floor() * count);
        assert_eq!(check(&coarse), Ok(vec![]), "{bits}");
    }
}

#[test]
fn encoders_that_are_late_or_early() {
    for name in ["paper-sim", "moored", "static"] {
        let text = log_of(&scenario(name, 120.0), 2);
        let angles: Vec<f64> = text
            .lines()
            .skip(1)
            .map(|line| line.rsplit(',').next().unwrap().parse().unwrap())
            .collect();
        let shifted = |rows: i64| {
            let at = |k: usize| (k as i64 - rows).clamp(0, angles.len() as i64 - 1) as usize;
            check(&changed(&text, |k, v| v[7] = angles[at(k)]))
        };
        // Half a degree of heading is two rows and a half of 10 ms at 20 °/s.
        for rows in [-2, -1, 0, 1, 2] {
            assert_eq!(shifted(rows), Ok(vec![]), "{name} {rows}");
        }
        for (rows, side) in [
            (4, "behind"),
            (10, "behind"),
            (20, "behind"),
            (-4, "ahead of"),
            (-10, "ahead of"),
        ] {
            let told = shifted(rows).unwrap_err();
            assert!(
                told.contains(side) && told.contains("degrees of heading"),
                "{name} {rows}: {told}"
            );
        }
        let told = shifted(6).unwrap_err();
        assert!(["some 5", "some 6"].iter().any(|ms| told.contains(ms)), "{told}");
    }
}

fn imu_delay(scenario: &Scenario) -> Option<ImuDelay> {
    let mut checker = Checker::new("l.csv");
    for row in rows(log_of(scenario, 4)) {
        checker.push(&row.unwrap()).unwrap();
    }
    checker.imu_delay()
}

#[test]
fn an_imus_delay_is_found_where_the_rotor_turns_round() {
    let part = crate::unit::Unit::find("icm42688").unwrap();
    for (name, seconds) in [("static", 60.0), ("paper-sim", 300.0), ("lively-floor", 120.0)] {
        for delay_ms in [-3.0, -0.4, 0.0, 3.0] {
            let mut scenario = scenario(name, seconds);
            // With a scale factor of half a percent, misalignments, and an encoder of the unit's kind.
            scenario.imu = part.clone();
            scenario.encoder.bits = 21;
            scenario.errors.imu_delay_ms = delay_ms;
            let found = imu_delay(&scenario).unwrap();
            let (found_ms, sd_ms) = (found.delay_s * 1e3, found.sd_s * 1e3);
            let off = (found_ms - delay_ms).abs();
            assert!(
                off < 0.3 && off < 3.0 * sd_ms + 0.02,
                "{name} {delay_ms}: {found_ms} ± {sd_ms}"
            );
            assert!(sd_ms < 0.3, "{name}: {sd_ms}");
        }
    }
    // Gaps cost what lies around them and no more.
    let mut scenario = scenario("static", 60.0);
    scenario.errors.imu_delay_ms = 3.0;
    let text = log_of(&scenario, 4);
    let gaps: String = text
        .lines()
        .enumerate()
        .filter(|(k, _)| k % 700 >= 20 || *k == 0)
        .flat_map(|(_, line)| [line, "\n"])
        .collect();
    let mut checker = Checker::new("l.csv");
    rows(gaps)
        .into_iter()
        .for_each(|row| checker.push(&row.unwrap()).unwrap());
    let found = checker.imu_delay().unwrap();
    assert!((found.delay_s - 3e-3).abs() < 1e-4, "{found:?}");
}

#[test]
fn a_rotor_that_never_turns_round_tells_no_delay() {
    // The first turning point comes after 18 s.
    assert_eq!(imu_delay(&scenario("static", 15.0)), None);
    let mut resting = scenario("paper-sim", 60.0);
    resting.rotor.rate_dps = 0.0;
    resting.encoder.bits = 12;
    assert_eq!(imu_delay(&resting), None);
}

#[test]
fn encoders_that_wrap_are_welcome() {
    let mut scenario = scenario("paper-sim", 60.0);
    scenario.rotor.travel_deg = 720.0;
    let text = log_of(&scenario, 1);
    assert_eq!(
        check(&changed(&text, |_, v| v[7] %= core::f64::consts::TAU)),
        Ok(vec![])
    );
}

#[test]
fn encoders_that_do_not_turn() {
    let text = log_of(&scenario("paper-sim", 30.0), 1);
    let message = check(&changed(&text, |_, v| v[7] = 1.25)).unwrap_err();
    assert!(
        message.starts_with("l.csv:2: encoder_rad stands still at 1.2500 while gyro z turned by 3."),
        "{message}"
    );
    // It may also stop later.
    let message = check(&changed(&text, |k, v| {
        if k > 500 {
            v[7] = 1.25;
        }
    }))
    .unwrap_err();
    assert!(
        message.starts_with("l.csv:1002: encoder_rad stands still at 1.2500"),
        "{message}"
    );
    // Nothing turns at all: a good gyro finds north at rest.
    let mut still = scenario("paper-sim", 30.0);
    still.rotor.rate_dps = 0.0;
    assert_eq!(
        check(&log_of(&still, 1)).unwrap(),
        [
            "l.csv:3001: encoder_rad never turned: with the rotor at rest gyro biases go into heading in full, and σ says \
             how far"
        ]
    );
}

#[test]
fn a_rotor_may_start_late() {
    // 20 s at rest, then the rotor's first turn.
    let mut still = scenario("paper-sim", 20.0);
    still.rotor.rate_dps = 0.0;
    let mut text = log_of(&still, 1);
    for line in log_of(&scenario("paper-sim", 20.0), 1).lines().skip(1) {
        let (t, rest) = line.split_once(',').unwrap();
        text += &format!("{},{rest}\n", t.parse::<f64>().unwrap() + 20.0);
    }
    assert_eq!(check(&text), Ok(vec![]));
}

#[test]
fn times_that_are_not_seconds() {
    let text = log_of(&scenario("paper-sim", 5.0), 1);
    assert_eq!(
        check(&changed(&text, |_, v| v[0] *= 1e3)).unwrap_err(),
        "l.csv:2: t_s grows by 1.000e1 from row to row: it must be in seconds, with 5 to 20000 rows a second; it looks like \
         ms, multiply by 0.001"
    );
    for (factor, unit) in [(1e6, "µs, multiply by 1e-6"), (1e9, "ns, multiply by 1e-9")] {
        let told = check(&changed(&text, |_, v| v[0] *= factor)).unwrap_err();
        assert!(told.ends_with(unit), "{told}");
    }
}

#[test]
fn saturation_and_frozen_channels() {
    let clipped = |range: Option<f64>, accel: Option<f64>| {
        let mut scenario = scenario("paper-sim", 30.0);
        scenario.errors.gyro_range_dps = range;
        scenario.errors.accel_range_g = accel;
        check(&log_of(&scenario, 1))
    };
    assert_eq!(clipped(Some(60.0), Some(2.0)), Ok(vec![]));
    let gyro = clipped(Some(30.0), None).unwrap_err();
    assert!(
        gyro.contains(": gyro_z_rad_s: saturated at 0.5235987755")
            && gyro.ends_with(": angle is lost, use a wider range"),
        "{gyro}"
    );
    let accel = clipped(None, Some(0.995)).unwrap();
    assert_eq!(accel.len(), 1);
    assert!(
        accel[0].contains(": accel_z_m_s2: saturated at 9.757616")
            && accel[0].ends_with(" times in the log; the first is here"),
        "{accel:?}"
    );
    let text = log_of(&scenario("paper-sim", 30.0), 1);
    let frozen = check(&changed(&text, |k, v| {
        if (1000..1050).contains(&k) {
            v[1] = 0.01;
        }
    }));
    assert_eq!(
        frozen.unwrap_err(),
        "l.csv:1002: gyro_x_rad_s: frozen at 0.01: angle is lost, the sensor or its bus failed"
    );
    let frozen = check(&changed(&text, |k, v| {
        if (1000..1050).contains(&k) || (2000..2020).contains(&k) {
            v[4] = 0.01;
        }
    }));
    assert_eq!(
        frozen.unwrap(),
        ["l.csv:1002: accel_x_m_s2: repeats at 0.01, 2 times in the log; the first is here"]
    );
}

#[test]
fn gaps_are_counted() {
    let text = log_of(&scenario("paper-sim", 30.0), 1);
    let keep = |k: usize| k != 100 && !(1000..1020).contains(&k);
    let text: String = text
        .lines()
        .enumerate()
        .filter(|(k, _)| keep(*k))
        .map(|(_, line)| format!("{line}\n"))
        .collect();
    assert_eq!(
        check(&text).unwrap(),
        ["l.csv:101: 2 gaps with 21 rows missing, the longest 0.210 s; the first is here"]
    );
}

#[test]
fn nothing_to_check() {
    assert_eq!(
        Checker::new("l.csv").finish().unwrap_err().to_string(),
        "l.csv: no rows after the header: nothing was recorded"
    );
}

/// Reads and checks whatever it is; says whether all errors were one line.
fn survives(bytes: &[u8]) -> bool {
    let mut checker = Checker::new("l.csv");
    let Ok(reader) = LogReader::new(bytes, "l.csv").map_err(|e| assert!(!e.to_string().contains('\n'))) else {
        return true;
    };
    for row in reader {
        match row {
            Ok(row) => {
                if let Err(error) = checker.push(&row) {
                    return !error.to_string().contains('\n');
                }
            }
            Err(error) => return !error.to_string().contains('\n'),
        }
    }
    match checker.finish() {
        Ok(warnings) => warnings.iter().all(|warning| !warning.to_string().contains('\n')),
        Err(error) => !error.to_string().contains('\n'),
    }
}

proptest! {
    #[test]
    fn arbitrary_bytes_never_panic(bytes in prop::collection::vec(any::<u8>(), 0..2000)) {
        prop_assert!(survives(&bytes));
    }

    #[test]
    fn arbitrary_bytes_after_a_header_never_panic(bytes in prop::collection::vec(any::<u8>(), 0..2000)) {
        let mut text = good(2).into_bytes();
        text.extend(&bytes);
        prop_assert!(survives(&text));
    }

    #[test]
    fn arbitrary_edits_never_panic(
        edits in prop::collection::vec((0..3000_usize, prop::sample::select(b"0123456789.,-+eE\n\r naif\"".to_vec())), 0..20),
    ) {
        let mut text = good(60).into_bytes();
        for (at, byte) in edits {
            let at = at % text.len();
            text[at] = byte;
        }
        prop_assert!(survives(&text));
    }

    #[test]
    fn arbitrary_numbers_never_panic(values in prop::collection::vec(prop::array::uniform8(-1e6..1e6_f64), 2..50)) {
        let mut text = format!("{HEADER}\n");
        let mut t = 0.0;
        for mut row in values {
            t += row[0].abs() * 1e-6 + 1e-9;
            row[0] = t;
            text += &row.map(|v| format!("{v:e}")).join(",");
            text.push('\n');
        }
        prop_assert!(survives(text.as_bytes()));
    }
}
