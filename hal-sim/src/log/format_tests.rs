//! The same samples in every format there is, and what formats of one's own may say.

use super::format::FORMATS;
use super::*;

/// A row in axes of the rotor: time, s, gyros, rad/s, accelerometers, m/s², encoder, rad.
type Figures = (f64, [f64; 3], [f64; 3], f64);

const DT: f64 = 0.01;
const ROWS: u32 = 40;

fn samples() -> Vec<Figures> {
    (0..ROWS)
        .map(|k| {
            let x = f64::from(k);
            let w = [0.01 + 0.001 * x, -0.02 + 0.0007 * x, 0.3 + 0.002 * x];
            let f = [0.1 + 0.01 * x, -0.2 + 0.02 * x, 9.7 + 0.001 * x];
            (DT * x, w, f, 0.003 * x)
        })
        .collect()
}

/// Axes front, left, up, of a vector in axes of the rotor, which are right, front, up.
fn front_left_up([x, y, z]: [f64; 3]) -> [f64; 3] {
    [y, -x, z]
}

fn front_right_down([x, y, z]: [f64; 3]) -> [f64; 3] {
    [y, x, -z]
}

fn vector([x, y, z]: [f64; 3]) -> Vec3<Sensor, f64> {
    Vec3::new(x, y, z)
}

fn joined(values: impl IntoIterator<Item = f64>, separator: &str) -> String {
    values
        .into_iter()
        .map(|value| format!("{value:.12}"))
        .collect::<Vec<_>>()
        .join(separator)
}

fn sentence(body: &str) -> String {
    let sum = body.bytes().fold(0, |sum, byte| sum ^ byte);
    format!("${body}*{sum:02X}\r\n")
}

fn text(header: &str, row: impl Fn(usize, Figures) -> String) -> String {
    let rows = samples().into_iter().enumerate().map(|(k, figures)| row(k, figures));
    header.to_owned() + &rows.collect::<String>()
}

fn read(text: &str, format: &Format) -> Vec<Result<LogRow, LogError>> {
    match LogReader::with_format(text.as_bytes(), "f.txt", format) {
        Ok(reader) => reader.collect(),
        Err(error) => vec![Err(error)],
    }
}

fn own(text: &str) -> Format {
    Format::parse(text, "f.toml").unwrap()
}

/// That a text is read as the samples, times from the first row.
fn holds(text: &str, format: &Format, encoder: bool) {
    let rows = read(text, format);
    assert_eq!(rows.len(), ROWS as usize, "{:?}", rows.last());
    for (row, (t_s, w, f, angle)) in rows.into_iter().zip(samples()) {
        let row = row.unwrap();
        assert!((row.t_s - rows_start(format) - t_s).abs() < 1e-9, "{row:?} {t_s}");
        assert!((row.dt_s - DT).abs() < 1e-9, "{row:?}");
        assert!((row.w_is_s - vector(w)).norm() < 1e-9, "{row:?} {w:?}");
        assert!((row.f_is_s - vector(f)).norm() < 1e-8, "{row:?} {f:?}");
        let expected = if encoder { angle } else { 0.0 };
        assert!((row.encoder - expected).abs() < 1e-9, "{row:?}");
    }
}

/// Where rows or intervals are summed up, the first row ends the first of them.
fn rows_start(format: &Format) -> f64 {
    match format.time {
        format::TimeKind::Rows { .. } | format::TimeKind::Interval { .. } => DT,
        _ => 0.0,
    }
}

/// The samples as the program of each built-in format writes them.
fn written(name: &str) -> String {
    let epoch_ns = 1_790_000_000_123_456_789_i64;
    let covariance = ["0"; 9].join(",");
    match name {
        "ros-imu" => text(
            "%time,field.header.seq,field.header.stamp,field.header.frame_id,field.orientation.x,\
             field.angular_velocity.x,field.angular_velocity.y,field.angular_velocity.z,field.angular_velocity_covariance0,\
             field.linear_acceleration.x,field.linear_acceleration.y,field.linear_acceleration.z\n",
            |k, (_, w, f, _)| {
                let stamp = epoch_ns + 10_000_000 * k as i64;
                let (w, f) = (joined(front_left_up(w), ","), joined(front_left_up(f), ","));
                format!("{},{k},{stamp},imu,0.5,{w},0.1,{f}\n", stamp + 77_000)
            },
        ),
        "ros-imu-bag" | "ros2-imu-bag" => {
            let (seconds, nanoseconds) = if name == "ros-imu-bag" {
                ("secs", "nsecs")
            } else {
                ("sec", "nanosec")
            };
            let dots = name == "ros-imu-bag";
            let header = format!(
                "Time;header.stamp.{seconds};header.stamp.{nanoseconds};orientation.x;angular_velocity.x;angular_velocity.y;\
                 angular_velocity.z;linear_acceleration.x;linear_acceleration.y;linear_acceleration.z\n"
            );
            // Some exporters put the topic before, and slashes between.
            let header = if dots {
                header
            } else {
                header.replace(';', ";/imu/data/").replace('.', "/")
            };
            text(&header, |k, (_, w, f, _)| {
                let stamp = epoch_ns + 10_000_000 * k as i64;
                let (w, f) = (joined(front_left_up(w), ";"), joined(front_left_up(f), ";"));
                let line = format!("{k};{};{};0;{w};{f}\n", stamp / 1_000_000_000, stamp % 1_000_000_000);
                // And a spreadsheet of these parts writes decimal commas.
                if dots { line } else { line.replace('.', ",") }
            })
        }
        "ros2-imu" => text("", |k, (_, w, f, _)| {
            let stamp = epoch_ns + 10_000_000 * k as i64;
            let (w, f) = (joined(front_left_up(w), ","), joined(front_left_up(f), ","));
            format!(
                "{},{},imu_link,0,0,0,1,{covariance},{w},{covariance},{f},{covariance}\n",
                stamp / 1_000_000_000,
                stamp % 1_000_000_000
            )
        }),
        "xsens-mt" => text(
            "// Start Time: Unknown\r\n// Sample rate: 100.0Hz\r\n// Scenario: 1.4\r\n// Firmware Version: 2.5.1\r\n\
             PacketCounter\tSampleTimeFine\tAcc_X\tAcc_Y\tAcc_Z\tGyr_X\tGyr_Y\tGyr_Z\tMag_X\r\n",
            |k, (_, w, f, _)| {
                // The count begins anew on the way.
                let count = (4_294_966_000_u64 + 100 * k as u64) % 4_294_967_296;
                let (w, f) = (joined(front_left_up(w), "\t"), joined(front_left_up(f), "\t"));
                format!("{:05}\t{count}\t{f}\t{w}\t\r\n", k + 65_530)
            },
        ),
        "vectornav-imu" => text("VN-100\r\n$VNYPR,+010.0,+000.1,-000.2*44\r\n", |_, (_, w, f, _)| {
            let (w, f) = (joined(front_right_down(w), ","), joined(front_right_down(f), ","));
            sentence(&format!("VNIMU,-00.1,+00.2,+00.3,{f},{w},+20.7,+101.3")) + "$VNYPR,+010.0,+000.1,-000.2*44\r\n"
        }),
        "vectornav-dtv" => text("", |_, (_, w, f, _)| {
            let (w, f) = (front_right_down(w), front_right_down(f));
            let (angles, speeds) = (w.map(|w| w * DT / frames::units::DEG), f.map(|f| f * DT));
            sentence(&format!("VNDTV,{DT},{},{}", joined(angles, ","), joined(speeds, ",")))
        }),
        "kvh-1750" => text(
            "KVH logging\nserial,1612K001\n\nTime,Seq,X gyro,Y gyro,Z gyro,X acc,Y acc,Z acc,Temp\n",
            |k, (t_s, w, f, _)| {
                let w = w.map(|w| w / frames::units::DEG);
                let f = f.map(|f| f / frames::units::STANDARD_GRAVITY);
                format!("{t_s},{},{},{},31\n", k % 128, joined(w, ","), joined(f, ","))
            },
        ),
        "psins" => text("", |_, (t_s, w, f, _)| {
            format!(
                "  {}  {}  {t_s:.4}\n",
                joined(w.map(|w| w * DT), "   "),
                joined(f.map(|f| f * DT), "   ")
            )
        }),
        "kitti-oxts" => text("", |_, (_, w, f, _)| {
            let (w, f) = (joined(front_left_up(w), " "), joined(front_left_up(f), " "));
            let nothing = |fields: usize| vec!["0.5"; fields].join(" ");
            format!("{} {f} {} {w} {}\n", nothing(11), nothing(3), nothing(10))
        }),
        other => panic!("no writer of {other}"),
    }
}

#[test]
fn every_built_in_format_holds_what_its_program_wrote() {
    for builtin in FORMATS {
        let mut format = Format::find(builtin.name).unwrap();
        if format.time == (format::TimeKind::Rows { interval: 0.0 }) {
            let error = read(&written(builtin.name), &format).pop().unwrap().unwrap_err();
            assert!(error.to_string().contains("--rate-hz 100"), "{error}");
            format = format.with_rate(100.0);
        }
        holds(&written(builtin.name), &format, false);
    }
}

#[test]
fn every_built_in_format_is_in_the_documentation() {
    let page = include_str!("../../../docs/log.md");
    for builtin in FORMATS {
        let row = format!("| `{}` | {} |", builtin.name, builtin.what);
        assert!(page.contains(&row), "{row}");
    }
}

#[test]
fn a_format_of_ones_own_has_columns_units_signs_and_mounting() {
    // Counts, mg, a counter of 8 bits, an encoder of 4096 that counts the other way, an IMU upside down.
    let format = own("mounting = 'x,-y,-z'\n\
                      time = { column = 'n', unit = 'samples', rate_hz = 100, wrap = 256 }\n\
                      gyro = { columns = ['P', 'q', 'r'], unit = 'mdps', scale = 0.5 }\n\
                      accel = { columns = [6, 7, 5], unit = 'mg' }\n\
                      encoder = { column = 'enc', unit = '-4096/turn', offset_deg = 30 }\n\
                      temperature = { column = 'T' }\n");
    let turn = core::f64::consts::TAU;
    let rows = text(
        "# a comment\nn p Q r 5 6 7 enc t\n% another\n",
        |k, (_, [wx, wy, wz], [fx, fy, fz], angle)| {
            let w = [wx, -wy, -wz].map(|w| w / frames::units::DEG * 2000.0);
            let f = [-fz, fx, -fy].map(|f| f / frames::units::STANDARD_GRAVITY * 1000.0);
            let encoder = (30.0 * frames::units::DEG - angle) / turn * 4096.0;
            format!(
                "{} {} {} {encoder:.9} 21,5\n// more\n",
                (k + 240) % 256,
                joined(w, " "),
                joined(f, " ")
            )
        },
    );
    holds(&rows, &format, true);
    assert_eq!(read(&rows, &format)[0].as_ref().unwrap().temperature_c, Some(21.5));
}

#[test]
fn the_time_of_day_goes_on_after_midnight() {
    let format = own("time = { column = 1, unit = 'clock' }\n\
                      gyro = { columns = [2, 3, 4], unit = 'deg/h' }\naccel = { columns = [5, 6, 7] }\n");
    let rows = text("", |_, (t_s, w, f, _)| {
        let t = (86_399.8 + t_s) % 86_400.0;
        let (hour, minute, second) = ((t / 3600.0).floor(), (t / 60.0).floor() % 60.0, t % 60.0);
        let w = w.map(|w| w / frames::units::DEG_PER_HOUR);
        format!(
            "2026-11-30T{hour:02}:{minute:02}:{second:07.4}Z|{}|{}\n",
            joined(w, "|"),
            joined(f, "|")
        )
    });
    holds(&rows, &format, false);
}

/// The counter of the older series of Xsens begins anew after a day; that of `written` with 32 bits.
#[test]
fn a_counter_may_begin_anew_at_either_of_two() {
    let format = Format::find("xsens-mt").unwrap();
    let header = "PacketCounter\tSampleTimeFine\tAcc_X\tAcc_Y\tAcc_Z\tGyr_X\tGyr_Y\tGyr_Z\n";
    let rows = text(header, |k, (_, w, f, _)| {
        let count = (863_999_000 + 100 * k) % 864_000_000;
        let (w, f) = (joined(front_left_up(w), "\t"), joined(front_left_up(f), "\t"));
        format!("{k}\t{count}\t{f}\t{w}\n")
    });
    holds(&rows, &format, false);
    // A newer one passes a day by, and goes on.
    let on = text(header, |k, (_, w, f, _)| {
        let (w, f) = (joined(front_left_up(w), "\t"), joined(front_left_up(f), "\t"));
        format!("{k}\t{}\t{f}\t{w}\n", 863_999_000 + 100 * k)
    });
    holds(&on, &format, false);
}

#[test]
fn a_base_is_changed_in_what_a_file_says() {
    let format = own("base = 'kitti-oxts'\nmounting = 'x,y,z'\n[time]\nrate_hz = 100\n[gyro]\nunit = 'deg/s'\n");
    let rows = read(&written("kitti-oxts"), &format);
    let (_, w, ..) = samples()[3];
    let expected = vector(front_left_up(w)) * frames::units::DEG;
    assert!((rows[3].as_ref().unwrap().w_is_s - expected).norm() < 1e-12);
}

#[test]
fn a_mounting_is_axes_or_angles() {
    let turned = |mounting: &str| {
        let format = Format::default().with_mounting(mounting.parse().unwrap());
        let row = "0,1,2,3,4,5,6,0\n0.01,1,2,3,4,5,6,0\n";
        let row = *read(&format!("{}\n{row}", COLUMNS.join(",")), &format)[0]
            .as_ref()
            .unwrap();
        (row.w_is_s.to_array(), row.f_is_s.to_array())
    };
    assert_eq!(turned("z,x,y"), ([3.0, 1.0, 2.0], [6.0, 4.0, 5.0]));
    assert_eq!(turned("Y, +x, -z"), ([2.0, 1.0, -3.0], [5.0, 4.0, -6.0]));
    // About x first, then about the y that was turned: x of the IMU is then down, y is up... as the matrix has it.
    for (angles, axes) in [
        ("180,0,0", "x,-y,-z"),
        ("0,0,90", "-y,x,z"),
        ("0,90,0", "z,y,-x"),
        ("90,0,90", "-y,-z,x"),
    ] {
        let (by_angles, by_axes) = (turned(angles), turned(axes));
        for (a, b) in by_angles
            .0
            .iter()
            .chain(&by_angles.1)
            .zip(by_axes.0.iter().chain(&by_axes.1))
        {
            assert!((a - b).abs() < 1e-12, "{angles} {by_angles:?}");
        }
    }
    for (wrong, why) in [
        ("x,y,-z", "mirror"),
        ("x,x,z", "each axis must be there once"),
        ("x,y", "expected three axes"),
        ("a,b,c", "expected three axes"),
        ("0,0,nan", "expected angles"),
    ] {
        let error = wrong.parse::<format::Mounting>().unwrap_err();
        assert!(error.contains(why), "{error}");
    }
    for wrong in ["", "radians", "0/turn", "x/turn", "--rad"] {
        assert!(wrong.parse::<format::EncoderUnit>().is_err(), "{wrong}");
    }
}

#[test]
fn errors_of_a_format_name_its_line_and_what_is_expected() {
    let message = |text: &str| Format::parse(text, "f.toml").unwrap_err().to_string();
    let sensors = "gyro = { columns = [2, 3, 4] }\naccel = { columns = [5, 6, 7] }\n";
    for (text, expected) in [
        (
            "",
            "f.toml: gyro.columns: missing: name the columns of x, y and z".to_owned(),
        ),
        (
            "\ngyro = { columns = [1, 2, 3], unit = 'rpm' }",
            "f.toml:2: gyro.unit: no unit `rpm` here: expected one of rad/s, mrad/s, deg/s, ".to_owned(),
        ),
        ("gyro = { columns = [1, 2] }", "f.toml:1: gyro.columns: ".to_owned()),
        ("gyro = { columns = [0, 1, 2] }", "f.toml:1: gyro.columns: ".to_owned()),
        ("columns = 1", "f.toml:1: columns: unknown key; known here: ".to_owned()),
        // A name of several lines does not break the message.
        (
            "base = \"i\\nmu\"",
            "f.toml:1: base: no format `i\\nmu`: expected one of ".to_owned(),
        ),
        (
            "gyro = { columns = [1, 2, 3], unit = \"r\\npm\" }",
            "f.toml:1: gyro.unit: no unit `r\\npm` here: ".to_owned(),
        ),
        (
            "base = 'imu'",
            "f.toml:1: base: no format `imu`: expected one of ros-imu, ".to_owned(),
        ),
        (
            &format!("{sensors}time = {{ column = 1, unit = 'samples' }}"),
            "f.toml:3: time.unit: a counter needs its rate".to_owned(),
        ),
        (
            &format!("{sensors}time = {{ column = 2 }}"),
            "f.toml:1: gyro.columns: column 2 is two things at once".to_owned(),
        ),
        (
            &format!("{sensors}mounting = 'x,y,-z'"),
            "f.toml:3: mounting: these axes are a mirror image".to_owned(),
        ),
        (
            &format!("{sensors}[encoder]\nunit = 'gon'"),
            "f.toml:4: encoder.unit: expected rad, ".to_owned(),
        ),
        (
            &format!("{sensors}[encoder]\noffset_deg = 400"),
            "f.toml:4: encoder.offset_deg: 400 is out of range".to_owned(),
        ),
    ] {
        let message = message(text);
        assert!(message.starts_with(&expected), "{message}");
    }
    let unknown = Format::find("vectornav").unwrap_err().to_string();
    assert!(
        unknown.starts_with("vectornav: neither a format (ros-imu, "),
        "{unknown}"
    );
}

#[test]
fn bad_lines_are_told_by_their_number() {
    let psins = Format::find("psins").unwrap();
    let spoilt = |name: &str, line: usize, change: &dyn Fn(&str) -> String| {
        let lines = written(name);
        let lines = lines
            .lines()
            .enumerate()
            .map(|(k, text)| if k + 1 == line { change(text) } else { text.to_owned() });
        let format = Format::find(name).unwrap();
        let format = if name == "psins" {
            format
        } else {
            format.with_rate(100.0)
        };
        let text = lines.collect::<Vec<_>>().join("\n") + "\n";
        read(&text, &format).pop().unwrap().unwrap_err().to_string()
    };
    assert_eq!(
        spoilt("psins", 5, &|line| format!("{line} 7")),
        "f.txt:5: 8 fields where the first row has 7: remove the row or repair it"
    );
    assert_eq!(
        spoilt("psins", 6, &|line| line.replacen("0.", "?.", 1)),
        "f.txt:6: column 1: `?.000150000000` is not a finite number"
    );
    assert_eq!(
        spoilt("vectornav-imu", 7, &|line| line.replacen("VNIMU,-", "VNIMU,+", 1)),
        "f.txt:7: the check sum of the sentence is missing or wrong: remove the line"
    );
    let none = read("a,b\n1,2\n", &psins).pop().unwrap().unwrap_err().to_string();
    assert_eq!(
        none,
        "f.txt: no line has numbers in column 7, column 1, column 2, column 3, column 4, column 5, column 6, where the format \
         has time and sensors: another --format?"
    );
    assert!(
        read("", &psins)[0]
            .as_ref()
            .unwrap_err()
            .to_string()
            .contains("the file is empty")
    );
    let xsens = Format::find("xsens-mt").unwrap();
    let lacking = written("xsens-mt").replace("Gyr_Z", "Gyr_W");
    let lacking = read(&lacking, &xsens).pop().unwrap().unwrap_err().to_string();
    assert_eq!(lacking, "f.txt:5: column missing: Gyr_Z; the header must name them");
    let twice = written("xsens-mt").replace("Mag_X", "Gyr_X");
    let twice = read(&twice, &xsens).pop().unwrap().unwrap_err().to_string();
    assert_eq!(twice, "f.txt:5: column Gyr_X appears twice: remove one");
}
