//! Logs of other makers: which column is what, in which unit, and how the IMU sits on the rotor.
//!
//! A format is a TOML file, or one of [`FORMATS`] by its name. A file that names a `base` changes only what it has itself:
//!
//! ```toml
//! base = "ros-imu"                                   # a built-in format to begin with
//! row = "$VNIMU"                                     # only lines whose first field is this
//! mounting = "y,x,-z"                                # x, y, z of the rotor in axes of the IMU; or three angles, degrees
//! time = { column = "stamp", unit = "us" }           # s, ms, us, ns; samples with rate_hz; clock: HH:MM:SS.sss
//! gyro = { columns = ["gx", "gy", "gz"], unit = "deg/s", scale = 0.0076 }
//! accel = { columns = ["ax", "ay", "az"], unit = "mg" }
//! encoder = { column = 12, unit = "16384/turn", offset_deg = 30 }     # a minus before the unit: reversed
//! temperature = { column = "temp" }
//! ```
//!
//! Columns are names of a header, or numbers from 1. Where all are numbers, there need be no header: lines before the first
//! that has numbers in all of them are skipped. A name in another case is the same, `/` is the same as `.`, and the end of a
//! name after a dot will do: `angular_velocity.x` is `/imu/angular_velocity/x`.
//!
//! Times count from the first row. Units of an increment (`rad`, `m/s`) say that a figure is that of the row's interval.

use std::path::Path;

use frames::units::{ARC_MIN, ARC_SEC, DEG, DEG_PER_HOUR, MICRO_G, STANDARD_GRAVITY};
use nalgebra::{Matrix3, Rotation3, Vector3};
use serde::{Deserialize, Deserializer};

use super::{COLUMNS, TEMPERATURE};
use crate::config::{self, ConfigError, ConfigProblem, Violation};

/// A built-in format.
#[derive(Debug, Clone, Copy)]
pub struct Builtin {
    /// Its name, for `--format`.
    pub name: &'static str,
    /// Whose files it reads.
    pub what: &'static str,
    /// Its TOML.
    pub text: &'static str,
}

/// The formats there are by name, with their sources.
///
/// * `ros-imu`: the header is that of `rostopic echo -p` on `sensor_msgs/Imu`; stamps in ns.
/// * `ros-imu-bag`, `ros2-imu-bag`: the message's own field names, as exporters of bags join them by dots or slashes.
/// * `ros2-imu`: the fields of `sensor_msgs/msg/Imu` in their order, covariances between them, no header.
/// * `xsens-mt`: MTw user manual, export of text: Acc in m/s², Gyr in rad/s. `SampleTimeFine` counts at 10 kHz, and begins
///   anew after a day (864 000 000) with the MTi 10 and 100 series, at 2³² with the MTi 1 and 600 series (MT low-level
///   communication protocol, XDI_SampleTimeFine, as the driver xsens-mti 0.6 tells it; not verified against a file).
/// * `vectornav-imu`: VersaSync user manual, VNIMU (register 54): m/s², rad/s, °C. `vectornav-dtv`: VNDTV (register 80): s, °,
///   m/s. Axes x front, y right, z down.
/// * `kvh-1750`: columns as in the logging program's CSV in the repository SMAC-Group/ucimudata; °/s and g.
/// * `psins`: `imu` of the PSINS toolbox: increments in rad and m/s, then the time; axes right, front, up.
/// * `kitti-oxts`: `dataformat.txt` of KITTI's raw data: ax, ay, az are fields 12 to 14, wx, wy, wz 18 to 20; axes front,
///   left, up.
pub const FORMATS: [Builtin; 10] = [
    Builtin {
        name: "ros-imu",
        what: "ROS 1, rostopic echo -p of sensor_msgs/Imu",
        text: r#"
mounting = "-y,x,z"
time = { column = "field.header.stamp", unit = "ns" }
gyro = { columns = ["field.angular_velocity.x", "field.angular_velocity.y", "field.angular_velocity.z"] }
accel = { columns = ["field.linear_acceleration.x", "field.linear_acceleration.y", "field.linear_acceleration.z"] }
"#,
    },
    Builtin {
        name: "ros-imu-bag",
        what: "ROS 1, a bag of sensor_msgs/Imu as CSV",
        text: r#"
mounting = "-y,x,z"
time = { column = "stamp.secs", nanoseconds = "stamp.nsecs" }
gyro = { columns = ["angular_velocity.x", "angular_velocity.y", "angular_velocity.z"] }
accel = { columns = ["linear_acceleration.x", "linear_acceleration.y", "linear_acceleration.z"] }
"#,
    },
    Builtin {
        name: "ros2-imu",
        what: "ROS 2, ros2 topic echo --csv of sensor_msgs/msg/Imu",
        text: r#"
mounting = "-y,x,z"
time = { column = 1, nanoseconds = 2 }
gyro = { columns = [17, 18, 19] }
accel = { columns = [29, 30, 31] }
"#,
    },
    Builtin {
        name: "ros2-imu-bag",
        what: "ROS 2, a bag of sensor_msgs/msg/Imu as CSV",
        text: r#"
mounting = "-y,x,z"
time = { column = "stamp.sec", nanoseconds = "stamp.nanosec" }
gyro = { columns = ["angular_velocity.x", "angular_velocity.y", "angular_velocity.z"] }
accel = { columns = ["linear_acceleration.x", "linear_acceleration.y", "linear_acceleration.z"] }
"#,
    },
    Builtin {
        name: "xsens-mt",
        what: "Xsens MT Manager, text export",
        text: r#"
mounting = "-y,x,z"
time = { column = "SampleTimeFine", unit = "samples", rate_hz = 10000, wrap = [864000000, 4294967296] }
gyro = { columns = ["Gyr_X", "Gyr_Y", "Gyr_Z"] }
accel = { columns = ["Acc_X", "Acc_Y", "Acc_Z"] }
"#,
    },
    Builtin {
        name: "vectornav-imu",
        what: "VectorNav, $VNIMU",
        text: r#"
row = "$VNIMU"
mounting = "y,x,-z"
gyro = { columns = [8, 9, 10] }
accel = { columns = [5, 6, 7] }
temperature = { column = 11 }
"#,
    },
    Builtin {
        name: "vectornav-dtv",
        what: "VectorNav, $VNDTV",
        text: r#"
row = "$VNDTV"
mounting = "y,x,-z"
time = { column = 2, unit = "s", interval = true }
gyro = { columns = [3, 4, 5], unit = "deg" }
accel = { columns = [6, 7, 8], unit = "m/s" }
"#,
    },
    Builtin {
        name: "kvh-1750",
        what: "KVH (EMCORE) 1750 IMU, CSV of its logging program",
        text: r#"
gyro = { columns = [3, 4, 5], unit = "deg/s" }
accel = { columns = [6, 7, 8], unit = "g" }
"#,
    },
    Builtin {
        name: "psins",
        what: "PSINS toolbox, imu as text",
        text: r#"
time = { column = 7 }
gyro = { columns = [1, 2, 3], unit = "rad" }
accel = { columns = [4, 5, 6], unit = "m/s" }
"#,
    },
    Builtin {
        name: "kitti-oxts",
        what: "KITTI raw data, the files of oxts/data one after the other",
        text: r#"
mounting = "-y,x,z"
gyro = { columns = [18, 19, 20] }
accel = { columns = [12, 13, 14] }
"#,
    },
];

/// What stands in a format with the values of a row, beyond time, six sensors, encoder and temperature.
pub(super) const NANOSECONDS: usize = 9;
/// Places of a row in all.
pub(super) const PLACES: usize = 10;

/// A column, by its name in the header or its number from 1.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Column {
    /// Its name.
    Name(String),
    /// Its number, from 1.
    Number(usize),
}

impl core::fmt::Display for Column {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            Self::Name(name) => f.write_str(name),
            Self::Number(number) => write!(f, "column {number}"),
        }
    }
}

impl<'de> Deserialize<'de> for Column {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Visitor;
        impl serde::de::Visitor<'_> for Visitor {
            type Value = Column;
            fn expecting(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
                f.write_str("the name of a column or its number from 1")
            }
            fn visit_i64<E: serde::de::Error>(self, value: i64) -> Result<Column, E> {
                match usize::try_from(value) {
                    Ok(number @ 1..=1000) => Ok(Column::Number(number)),
                    _ => Err(E::invalid_value(serde::de::Unexpected::Signed(value), &self)),
                }
            }
            fn visit_str<E: serde::de::Error>(self, value: &str) -> Result<Column, E> {
                Ok(Column::Name(value.to_owned()))
            }
        }
        deserializer.deserialize_any(Visitor)
    }
}

/// What a format's file may have.
#[derive(Debug, Clone, Default, Deserialize)]
#[serde(default, deny_unknown_fields)]
struct FormatFile {
    base: Option<String>,
    row: Option<String>,
    mounting: Option<String>,
    time: TimeFile,
    gyro: VectorFile,
    accel: VectorFile,
    encoder: EncoderFile,
    temperature: TemperatureFile,
}

#[derive(Debug, Clone, Default, Deserialize)]
#[serde(default, deny_unknown_fields)]
struct TimeFile {
    column: Option<Column>,
    nanoseconds: Option<Column>,
    unit: Option<String>,
    interval: Option<bool>,
    rate_hz: Option<f64>,
    wrap: Option<Wrap>,
}

/// Where a count begins anew: at one number, or at either of two.
#[derive(Debug, Clone, Copy, Deserialize)]
#[serde(untagged, expecting = "a number, or two of them")]
enum Wrap {
    One(f64),
    Two([f64; 2]),
}

impl Wrap {
    /// The lower one first.
    fn wraps(self) -> Wraps {
        match self {
            Self::One(wrap) => [Some(wrap), None],
            Self::Two([a, b]) => [Some(a.min(b)), Some(a.max(b))],
        }
    }
}

/// Where a count begins anew, in the file's unit: the lower one first.
pub(super) type Wraps = [Option<f64>; 2];

#[derive(Debug, Clone, Default, Deserialize)]
#[serde(default, deny_unknown_fields)]
struct VectorFile {
    columns: Option<[Column; 3]>,
    unit: Option<String>,
    scale: Option<f64>,
}

#[derive(Debug, Clone, Default, Deserialize)]
#[serde(default, deny_unknown_fields)]
struct EncoderFile {
    column: Option<Column>,
    unit: Option<String>,
    offset_deg: Option<f64>,
}

#[derive(Debug, Clone, Default, Deserialize)]
#[serde(default, deny_unknown_fields)]
struct TemperatureFile {
    column: Option<Column>,
}

impl FormatFile {
    /// With what `base` has where this has nothing.
    fn over(self, base: Self) -> Self {
        let vector = |own: VectorFile, base: VectorFile| VectorFile {
            // Another unit is not in the counts of the base.
            scale: own.scale.or(base.scale.filter(|_| own.unit.is_none())),
            columns: own.columns.or(base.columns),
            unit: own.unit.or(base.unit),
        };
        // Another column or unit is another clock.
        let (own, from) = (self.time, base.time);
        let same_clock = own.column.is_none() && own.unit.is_none();
        let from_base = |value: Option<Column>| value.filter(|_| same_clock);
        Self {
            base: None,
            row: self.row.or(base.row),
            mounting: self.mounting.or(base.mounting),
            time: TimeFile {
                nanoseconds: own.nanoseconds.or(from_base(from.nanoseconds)),
                interval: own.interval.or(from.interval.filter(|_| same_clock)),
                wrap: own.wrap.or(from.wrap.filter(|_| same_clock)),
                rate_hz: own.rate_hz.or(from.rate_hz),
                column: own.column.or(from.column),
                unit: own.unit.or(from.unit),
            },
            gyro: vector(self.gyro, base.gyro),
            accel: vector(self.accel, base.accel),
            encoder: EncoderFile {
                column: self.encoder.column.or(base.encoder.column),
                unit: self.encoder.unit.or(base.encoder.unit),
                offset_deg: self.encoder.offset_deg.or(base.encoder.offset_deg),
            },
            temperature: TemperatureFile {
                column: self.temperature.column.or(base.temperature.column),
            },
        }
    }
}

/// What a row's time is made from.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum TimeKind {
    /// As it is, s: of a log of our own.
    Own,
    /// A stamp, or a count that begins anew at one of `wraps`: s in one of it.
    Stamp {
        /// s.
        unit: f64,
        /// Where the count begins anew.
        wraps: Wraps,
    },
    /// The row's own interval: s in one of it.
    Interval {
        /// s.
        unit: f64,
    },
    /// HH:MM:SS.sss, which begins anew at midnight.
    Clock,
    /// The number of the row.
    Rows {
        /// s from row to row; zero: not told.
        interval: f64,
    },
}

/// Three figures of a row: what they are multiplied by, and whether they are increments.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Scale {
    /// To rad/s and m/s², or to rad and m/s.
    pub(super) factor: f64,
    /// Increments over the row's interval.
    pub(super) increments: bool,
}

/// Unit of an encoder: `rad`, `deg`, `turns`, `arcmin` or `16384/turn`; a minus before it: reversed.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct EncoderUnit(f64);

impl core::str::FromStr for EncoderUnit {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let (sign, unit) = match text.trim().strip_prefix('-') {
            Some(unit) => (-1.0, unit),
            None => (1.0, text.trim()),
        };
        let turn = core::f64::consts::TAU;
        let factor = match unit {
            "rad" => 1.0,
            "mrad" => 1e-3,
            "deg" | "°" => DEG,
            "arcmin" => ARC_MIN,
            "turn" | "turns" => turn,
            other => other
                .strip_suffix("/turn")
                .and_then(|counts| counts.trim().parse::<f64>().ok())
                .filter(|counts| (1.0..=1e12).contains(counts))
                .map(|counts| turn / counts)
                .ok_or("expected rad, mrad, deg, arcmin, turns, or counts in a turn as 16384/turn; a minus before it reverses")?,
        };
        Ok(Self(sign * factor))
    }
}

/// How the IMU sits on the rotor: what turns its axes into those of the rotor, x right, y front, z up at encoder zero.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Mounting(Matrix3<f64>);

impl core::str::FromStr for Mounting {
    type Err = String;

    /// Three axes of the IMU with signs, `y,x,-z`: which of them are x, y and z of the rotor. Or three angles, degrees: the
    /// axes of the IMU are those of the rotor turned by the first about x, then the second about y, the third about z, each
    /// as turned before.
    fn from_str(text: &str) -> Result<Self, String> {
        let wrong = || {
            "expected three axes of the IMU for x, y and z, as y,x,-z, or three angles in degrees, as 180,0,90"
                .to_owned()
        };
        let parts: Vec<&str> = text.split(',').map(str::trim).collect();
        let parts: [&str; 3] = parts.try_into().map_err(|_| wrong())?;
        if let Some(angles) = parts.iter().map(|part| part.parse().ok()).collect::<Option<Vec<f64>>>() {
            if angles.iter().any(|angle| !(-360.0..=360.0).contains(angle)) {
                return Err("expected angles from -360 to 360 degrees".to_owned());
            }
            let about = |axis, angle: f64| Rotation3::from_axis_angle(&axis, angle * DEG);
            let turned = about(Vector3::x_axis(), angles[0])
                * about(Vector3::y_axis(), angles[1])
                * about(Vector3::z_axis(), angles[2]);
            return Ok(Self(turned.into_inner()));
        }
        let mut matrix = Matrix3::zeros();
        for (row, part) in parts.iter().enumerate() {
            let (sign, axis) = match part.strip_prefix('-') {
                Some(axis) => (-1.0, axis),
                None => (1.0, part.strip_prefix('+').unwrap_or(part)),
            };
            let column = ["x", "y", "z"]
                .iter()
                .position(|name| axis.eq_ignore_ascii_case(name))
                .ok_or_else(wrong)?;
            matrix[(row, column)] = sign;
        }
        let determinant: f64 = matrix.determinant();
        if determinant > 0.0 {
            Ok(Self(matrix))
        } else if determinant < 0.0 {
            Err("these axes are a mirror image: change one sign, or exchange two axes".to_owned())
        } else {
            Err("each axis must be there once".to_owned())
        }
    }
}

/// What the columns of a log are.
#[derive(Debug, Clone, PartialEq)]
pub struct Format {
    /// Columns by place in a row.
    pub(super) columns: [Option<Column>; PLACES],
    /// Lines that count begin with this field.
    pub(super) row: Option<String>,
    pub(super) time: TimeKind,
    pub(super) gyro: Scale,
    pub(super) accel: Scale,
    encoder: EncoderUnit,
    offset: f64,
    mounting: Option<Mounting>,
}

impl Default for Format {
    /// That of our own logs.
    fn default() -> Self {
        let as_it_is = Scale {
            factor: 1.0,
            increments: false,
        };
        Self {
            columns: core::array::from_fn(|place| match place {
                NANOSECONDS => None,
                place => Some(Column::Name(
                    COLUMNS.get(place).copied().unwrap_or(TEMPERATURE).to_owned(),
                )),
            }),
            row: None,
            time: TimeKind::Own,
            gyro: as_it_is,
            accel: as_it_is,
            encoder: EncoderUnit(1.0),
            offset: 0.0,
            mounting: None,
        }
    }
}

/// A unit as it may be typed, in the one spelling of the tables here.
fn plain(unit: &str) -> String {
    let spelt = [
        ("°", "deg"),
        ("degrees", "deg"),
        ("²", "2"),
        ("^", ""),
        ("µ", "u"),
        ("μ", "u"),
        (" ", ""),
    ];
    let lower = unit.to_lowercase();
    spelt.iter().fold(lower, |unit, (from, to)| unit.replace(from, to))
}

/// Name, factor to SI, and whether it is an increment.
type Units = &'static [(&'static str, f64, bool)];

const GYRO_UNITS: Units = &[
    ("rad/s", 1.0, false),
    ("mrad/s", 1e-3, false),
    ("deg/s", DEG, false),
    ("mdeg/s", 1e-3 * DEG, false),
    ("deg/h", DEG_PER_HOUR, false),
    ("rad", 1.0, true),
    ("mrad", 1e-3, true),
    ("urad", 1e-6, true),
    ("deg", DEG, true),
    ("arcsec", ARC_SEC, true),
];
const ACCEL_UNITS: Units = &[
    ("m/s2", 1.0, false),
    ("g", STANDARD_GRAVITY, false),
    ("mg", 1e3 * MICRO_G, false),
    ("ug", MICRO_G, false),
    ("ft/s2", 0.3048, false),
    ("m/s", 1.0, true),
    ("mm/s", 1e-3, true),
];
const TIME_UNITS: [(&str, f64); 4] = [("s", 1.0), ("ms", 1e-3), ("us", 1e-6), ("ns", 1e-9)];

fn violation(key: &str, problem: String) -> Violation {
    Violation {
        key: key.to_owned(),
        problem,
    }
}

/// A number of a format that has to be in a range, where there is one.
fn within(key: &str, value: Option<f64>, low: f64, high: f64) -> Result<(), Violation> {
    match value {
        Some(value) if !(low..=high).contains(&value) => Err(violation(
            key,
            format!("{value} is out of range, allowed are {low} to {high}"),
        )),
        _ => Ok(()),
    }
}

fn scale(table: &str, vector: &VectorFile, units: Units) -> Result<Scale, Violation> {
    let unit = plain(vector.unit.as_deref().unwrap_or(units[0].0));
    let unit = match (unit.as_str(), table) {
        ("dps", "gyro") => "deg/s",
        ("mdps", "gyro") => "mdeg/s",
        (unit, _) => unit,
    };
    let found = units.iter().find(|(name, ..)| *name == unit);
    let Some((_, factor, increments)) = found else {
        let names: Vec<_> = units.iter().map(|unit| unit.0).collect();
        return Err(violation(
            &format!("{table}.unit"),
            format!(
                "no unit `{}` here: expected one of {}; counts have a scale besides",
                unit.escape_debug(),
                names.join(", ")
            ),
        ));
    };
    let times = vector.scale.unwrap_or(1.0);
    if !(1e-15..=1e15).contains(&times.abs()) {
        return Err(violation(
            &format!("{table}.scale"),
            format!("{times} is out of range: expected what one count is in the unit"),
        ));
    }
    Ok(Scale {
        factor: factor * times,
        increments: *increments,
    })
}

fn time_kind(time: &TimeFile) -> Result<TimeKind, Violation> {
    within("time.rate_hz", time.rate_hz, 1e-3, 1e9)?;
    let wraps = time.wrap.map(Wrap::wraps).unwrap_or_default();
    for wrap in wraps {
        within("time.wrap", wrap, 2.0, 1e19)?;
    }
    if time.column.is_none() {
        return Ok(TimeKind::Rows {
            interval: time.rate_hz.map_or(0.0, f64::recip),
        });
    }
    let name = plain(time.unit.as_deref().unwrap_or("s"));
    if name == "clock" {
        return Ok(TimeKind::Clock);
    }
    let unit = match (TIME_UNITS.iter().find(|(unit, _)| *unit == name), time.rate_hz) {
        (Some((_, unit)), _) => *unit,
        (None, Some(rate_hz)) if name == "samples" => rate_hz.recip(),
        (None, None) if name == "samples" => {
            let problem = "a counter needs its rate: add time.rate_hz".to_owned();
            return Err(violation("time.unit", problem));
        }
        _ => {
            let problem = format!(
                "no unit `{}` of time: expected s, ms, us, ns, samples or clock",
                name.escape_debug()
            );
            return Err(violation("time.unit", problem));
        }
    };
    Ok(match time.interval {
        Some(true) => TimeKind::Interval { unit },
        _ => TimeKind::Stamp { unit, wraps },
    })
}

impl Format {
    /// Whether it is our own, and nothing else is said.
    pub(super) fn is_default(&self) -> bool {
        *self == Self::default()
    }

    /// Whether the columns are told by numbers alone.
    pub(super) fn is_by_number(&self) -> bool {
        self.columns
            .iter()
            .flatten()
            .all(|column| matches!(column, Column::Number(_)))
    }

    /// A built-in format by its name, or one from a file.
    ///
    /// # Errors
    /// [`ConfigError`]: one line, with the names there are where the file does not exist.
    pub fn find(name_or_file: &str) -> Result<Self, ConfigError> {
        if let Some(builtin) = FORMATS.iter().find(|builtin| builtin.name == name_or_file) {
            return Self::parse(builtin.text, builtin.name);
        }
        let text = config::read(Path::new(name_or_file)).map_err(|error| match error.problem {
            ConfigProblem::Read(why) => ConfigError {
                problem: ConfigProblem::UnknownFormat {
                    why,
                    names: FORMATS.map(|builtin| builtin.name).join(", "),
                },
                ..error
            },
            _ => error,
        })?;
        Self::parse(&text, name_or_file)
    }

    /// The same from the text of a file; `file_name` is for messages.
    ///
    /// # Errors
    /// [`ConfigError`]: one line with file, line and key.
    pub fn parse(text: &str, file_name: &str) -> Result<Self, ConfigError> {
        let resolved = |file: &FormatFile| Self::resolve(file.clone());
        let file: FormatFile = config::parse(text, file_name, |file| resolved(file).map(drop))?;
        // Checked before, so that errors have their line.
        resolved(&file).map_err(|Violation { key, problem }| ConfigError {
            file: file_name.to_owned(),
            line: None,
            key: Some(key),
            problem: ConfigProblem::Value(problem),
        })
    }

    fn resolve(mut file: FormatFile) -> Result<Self, Violation> {
        if let Some(name) = file.base.take() {
            let base = FORMATS.iter().find(|builtin| builtin.name == name).ok_or_else(|| {
                let names = FORMATS.map(|builtin| builtin.name).join(", ");
                violation(
                    "base",
                    format!("no format `{}`: expected one of {names}", name.escape_debug()),
                )
            })?;
            let base: FormatFile = toml::from_str(base.text).map_err(|e| violation("base", e.message().to_owned()))?;
            file = file.over(base);
        }
        let FormatFile {
            time,
            gyro,
            accel,
            encoder,
            temperature,
            row,
            mounting,
            ..
        } = file;
        let missing = |table: &str| {
            violation(
                &format!("{table}.columns"),
                "missing: name the columns of x, y and z".to_owned(),
            )
        };
        let (time_kind, gyro_scale, accel_scale) = (
            time_kind(&time)?,
            scale("gyro", &gyro, GYRO_UNITS)?,
            scale("accel", &accel, ACCEL_UNITS)?,
        );
        within("encoder.offset_deg", encoder.offset_deg, -360.0, 360.0)?;
        let [wx, wy, wz] = gyro.columns.ok_or_else(|| missing("gyro"))?;
        let [fx, fy, fz] = accel.columns.ok_or_else(|| missing("accel"))?;
        let columns = [
            time.column,
            Some(wx),
            Some(wy),
            Some(wz),
            Some(fx),
            Some(fy),
            Some(fz),
            encoder.column,
            temperature.column,
            time.nanoseconds,
        ];
        let twice = (0..PLACES).find(|place| columns[*place].is_some() && columns[..*place].contains(&columns[*place]));
        if let Some((place, column)) = twice.and_then(|place| Some((place, columns[place].as_ref()?))) {
            let key = match place {
                1..=3 => "gyro.columns",
                4..=6 => "accel.columns",
                7 => "encoder.column",
                8 => "temperature.column",
                _ => "time.nanoseconds",
            };
            let problem = format!("{column} is two things at once: name each column once");
            return Err(violation(key, problem));
        }
        let of_text = |key: &str, problem: String| violation(key, problem);
        Ok(Self {
            columns,
            row,
            time: time_kind,
            gyro: gyro_scale,
            accel: accel_scale,
            encoder: encoder
                .unit
                .as_deref()
                .unwrap_or("rad")
                .parse()
                .map_err(|e| of_text("encoder.unit", e))?,
            offset: encoder.offset_deg.unwrap_or(0.0) * DEG,
            mounting: mounting
                .map(|text| text.parse())
                .transpose()
                .map_err(|e| of_text("mounting", e))?,
        })
    }

    /// The same for an IMU that sits otherwise.
    #[must_use]
    pub fn with_mounting(self, mounting: Mounting) -> Self {
        Self {
            mounting: Some(mounting),
            ..self
        }
    }

    /// The same for an encoder in another unit.
    #[must_use]
    pub fn with_encoder_unit(self, encoder: EncoderUnit) -> Self {
        Self { encoder, ..self }
    }

    /// The same for rows without times, which come at this rate, Hz.
    #[must_use]
    pub fn with_rate(mut self, rate_hz: f64) -> Self {
        self.time = TimeKind::Rows {
            interval: rate_hz.recip(),
        };
        self.columns[0] = None;
        self.columns[NANOSECONDS] = None;
        self
    }

    /// What a row's figures are in our units and axes: nine as in [`super::COLUMNS`], then the temperature. Increments stay
    /// increments.
    pub(super) fn converted(&self, mut values: [f64; 9]) -> [f64; 9] {
        for (k, value) in values[1..7].iter_mut().enumerate() {
            *value *= if k < 3 { self.gyro.factor } else { self.accel.factor };
        }
        if let Some(Mounting(matrix)) = &self.mounting {
            for at in [1, 4] {
                let turned = matrix * Vector3::new(values[at], values[at + 1], values[at + 2]);
                values[at..at + 3].copy_from_slice(turned.as_slice());
            }
        }
        values[7] = values[7] * self.encoder.0 + self.offset;
        values
    }

    /// The name of a place, for messages.
    pub(super) fn name(&self, place: usize) -> String {
        let column = self.columns.get(place).and_then(Option::as_ref);
        column.map(ToString::to_string).unwrap_or_default()
    }
}

/// Whether a column of a header is the one that a format names; how well: 2 by the whole name, 1 by its end.
pub(super) fn fits(wanted: &str, found: &str) -> u8 {
    let plain = |name: &str| name.to_lowercase().replace('/', ".");
    let (wanted, found) = (plain(wanted), plain(found));
    let found = found.trim_start_matches('.');
    if found == wanted {
        2
    } else {
        u8::from(
            found
                .strip_suffix(wanted.as_str())
                .is_some_and(|front| front.ends_with('.')),
        )
    }
}
