//! Recorded logs, read as a stream: CSV with one row a sample, or what a unit's serial line carried while it recorded.
//!
//! ```text
//! t_s,gyro_x_rad_s,gyro_y_rad_s,gyro_z_rad_s,accel_x_m_s2,accel_y_m_s2,accel_z_m_s2,encoder_rad[,temperature_c]
//! ```
//!
//! Rates and specific forces are means over the interval that ends at `t_s`, in s; the encoder is read at its end. The
//! first interval is as long as the second. Columns are found by their names, in any order; other columns are ignored.
//! Fields are separated by comma, semicolon, tab, bar or blanks, which the header tells; where it is not a comma, numbers
//! may have decimal commas. Names may be in upper case. Blank lines, comments (`#`), CRLF, a byte order mark and quoted
//! fields are accepted, and NUL bytes at the end, which a power cut leaves.
//!
//! Stamps that jitter, or are wrong at the beginning, are told from rows that are missing: the rows are spaced anew, with a
//! warning.
//!
//! A recording is the frames of [`app::record`] amid sentences and whatever else a line carries; `docs/log.md` has its
//! layout. It holds the unit's own intervals and flags, which a CSV has no columns for.
//!
//! Memory is bounded whatever the file holds: a line is at most [`MAX_LINE`] bytes and rows are not kept.
//!
//! [`LogReader`] refuses what cannot be read. Whether readable figures can be true is for [`Checker`].

mod binary;
mod check;
mod csv;
mod delay;
pub mod format;
#[cfg(test)]
mod format_tests;
#[cfg(test)]
mod tests;
mod time;

use std::fs::File;
use std::io::{self, BufRead, BufReader, BufWriter, Chain, Cursor, Read, Write};
use std::path::{Path, PathBuf};

use app::record::{self, Taken};
use frames::{Sensor, Vec3};
use nav::increment::Sample;

pub use binary::{Header, Loss, Lost, UnitStatus};
pub use check::{Checker, LogWarning, WarningKind};
pub use delay::{DelayEstimator, ImuDelay};
pub use format::Format;

/// The columns every log has, in the order they are written.
pub const COLUMNS: [&str; 8] = [
    "t_s",
    "gyro_x_rad_s",
    "gyro_y_rad_s",
    "gyro_z_rad_s",
    "accel_x_m_s2",
    "accel_y_m_s2",
    "accel_z_m_s2",
    "encoder_rad",
];

/// The column a log may have.
pub const TEMPERATURE: &str = "temperature_c";

/// Longest line accepted, bytes. A row takes about 150.
pub const MAX_LINE: usize = 4096;

/// Largest magnitude accepted, by column: beyond any sensor in any unit one could have taken by mistake, and well
/// within f32.
const LIMITS: [f64; 9] = [1e19, 1e6, 1e6, 1e6, 1e6, 1e6, 1e6, 1e10, 1e6];

/// Longest piece of a file repeated in a message, characters.
const QUOTE: usize = 32;

/// What is wrong with a log.
#[derive(Debug, Clone, PartialEq)]
pub enum LogProblem {
    /// The file cannot be opened or read; the system's words.
    Read(String),
    /// Nothing in it.
    Empty,
    /// A gzip file.
    Compressed,
    /// Text in UTF-16.
    Utf16,
    /// A recording whose bytes were written as text in UTF-8.
    SavedAsText {
        /// Whether the bytes can be had back.
        whole: bool,
    },
    /// The first line is not a header but numbers.
    NoHeader,
    /// Columns the header lacks.
    MissingColumns(Vec<String>),
    /// A column that appears twice.
    DuplicateColumn(String),
    /// No line has numbers in the columns that a format tells by their numbers: the columns.
    NoNumbers(String),
    /// Rows are to be counted, but their rate is not told.
    NoRate,
    /// A sentence whose check sum is missing or wrong.
    CheckSum,
    /// A format was told for the recording of a unit's line.
    NotByFormat,
    /// A header and nothing after it.
    NoRows,
    /// One row, whose interval is unknown.
    SingleRow,
    /// The row has not as many fields as the header.
    FieldCount {
        /// Fields in the row.
        found: usize,
        /// Fields in the header.
        expected: usize,
    },
    /// The row has not as many fields as the first one.
    RowLength {
        /// Fields in the row.
        found: usize,
        /// Fields in the first.
        expected: usize,
    },
    /// The same as [`Self::FieldCount`], as if numbers had decimal commas where a comma separates.
    DecimalComma {
        /// Fields in the row.
        found: usize,
        /// Fields in the header.
        expected: usize,
    },
    /// Text, nothing, NaN or infinity in the place of a number.
    NotANumber {
        /// The column.
        column: String,
        /// What is there, shortened.
        text: String,
    },
    /// A number beyond any sensor.
    TooLarge {
        /// The column.
        column: String,
        /// What is there.
        value: f64,
    },
    /// Time stands still or goes back.
    Time {
        /// Of the row before, s.
        previous: f64,
        /// Of this row, s.
        now: f64,
    },
    /// The last line ends inside the row.
    Truncated,
    /// A line beyond [`MAX_LINE`].
    LongLine,
    /// Bytes that are not UTF-8: the first of them, from 1.
    NotText(usize),
    /// Rows too far apart or too close to be seconds; the interval as read.
    TimeStep(f64),
    /// What a unit sends, but no frame of a record in it.
    NoRecord {
        /// Whole sentences of NMEA 0183.
        sentences: u64,
    },
    /// Frames of a record, but no header.
    NoRecordHeader {
        /// Frames there are.
        frames: u64,
    },
    /// A record of another version.
    RecordVersion {
        /// Its version.
        found: u8,
    },
    /// A record in which the rotor's angle is never known.
    NoAngle {
        /// Samples there are.
        samples: u64,
    },
    /// The accelerometer's mean norm is not gravity's, but would be in another unit.
    AccelUnit {
        /// Mean norm, as read.
        mean: f64,
        /// The unit it looks like.
        unit: &'static str,
        /// What to multiply by.
        factor: f64,
    },
    /// The accelerometer's mean norm is not gravity's in any unit; as read.
    AccelNorm(f64),
    /// The accelerometers' z axis does not point up: their mean on z, m/s².
    AccelAxes(f64),
    /// Rates beyond any sensor in most rows: the largest, as read.
    GyroUnit(f64),
    /// The gyros are in °/s: gyro z over the encoder's rate.
    GyroDegrees(f64),
    /// The encoder is in degrees: its rate as read.
    EncoderDegrees(f64),
    /// Gyro z and encoder turn in opposite directions.
    Opposite,
    /// Gravity moves on the accelerometers' x and y the other way than the gyros' x and y say.
    TiltReversed,
    /// Gyro z over the encoder's rate, which stays far from one.
    Mismatch(f64),
    /// The encoder is read less often than the gyros: each angle is held.
    EncoderHeld {
        /// Rows that an angle is held for.
        rows: f64,
        /// How far the angles are behind on average, rad.
        behind: f64,
    },
    /// The encoder is late, or early.
    EncoderLate {
        /// By how much, s.
        delay: f64,
        /// Rate of the rotor, rad/s.
        rate: f64,
    },
    /// The encoder rests while gyro z turns.
    EncoderStuck {
        /// Its reading, rad.
        at: f64,
        /// What gyro z turned by, rad.
        turned: f64,
        /// In this time, s.
        seconds: f64,
    },
    /// A gyro repeats one value: saturated where it is the largest seen, else frozen.
    GyroStuck {
        /// The column.
        column: &'static str,
        /// The value, rad/s.
        value: f64,
        /// Whether it is the largest seen.
        saturated: bool,
    },
}

/// What makes gyro z so many times the encoder's rate, and what to do.
fn cause(ratio: f64) -> String {
    use core::f64::consts::TAU;
    let near = |expected: f64| (ratio.abs() / expected - 1.0).abs() < 0.12;
    // What the encoder counts in a radian of the rotor, and in a turn.
    let (units, turn) = (ratio.abs().recip(), ratio.abs().recip() * TAU);
    let bits = turn.log2();
    let what = if near(TAU) {
        "encoder_rad looks like turns, --encoder-unit turns".to_owned()
    } else if near(1e3) {
        "the gyros look like mrad/s, multiply by 0.001".to_owned()
    } else if near(57_295.8) {
        "the gyros look like mdeg/s, multiply by 1.745329e-5".to_owned()
    } else if near(206_264.8) {
        "the gyros look like degrees/h, multiply by 4.848137e-6".to_owned()
    } else if ratio.abs() > 1.5 {
        "the gyros look like counts, tell what one is in a --format; or encoder_rad is in another unit, --encoder-unit"
            .to_owned()
    } else if units < 50.0 && (units - units.round()).abs() < 0.12 * units && units.round() >= 2.0 {
        format!(
            "encoder_rad looks like the electrical angle of a motor with about {units:.0} pole pairs, unwrap it and divide \
             by them"
        )
    } else if bits > 7.0 && (bits - bits.round()).abs() < 0.1 {
        format!(
            "encoder_rad looks like counts, 2^{bits:.0} a turn, --encoder-unit {:.0}/turn",
            bits.round().exp2()
        )
    } else if units > 20.0 {
        format!("encoder_rad looks like counts, about {turn:.0} a turn: say how many, as --encoder-unit 16384/turn")
    } else {
        "a wrong scale, times that are wrong, a gear between rotor and encoder, or a base that turns".to_owned()
    };
    if ratio < 0.0 {
        format!("{what}; and one of them is reversed, change its sign")
    } else {
        what
    }
}

/// The unit that rows a time `dt` apart look like, where they have to be 5 to 20000 a second.
fn time_unit(dt: f64) -> Option<(&'static str, &'static str)> {
    let units = [(1e3, "ms", "0.001"), (1e6, "µs", "1e-6"), (1e9, "ns", "1e-9")];
    let from_usual = |factor: f64| (dt / factor / 5e-3).ln().abs();
    units
        .into_iter()
        .filter(|(factor, ..)| (5e-5..=0.2).contains(&(dt / factor)))
        .min_by(|a, b| from_usual(a.0).total_cmp(&from_usual(b.0)))
        .map(|(_, name, factor)| (name, factor))
}

/// The start of a text, for messages.
fn shorten(text: &str) -> String {
    let mut short: String = text.chars().take(QUOTE).collect();
    if short.len() < text.len() {
        short.push('…');
    }
    short.replace(|c: char| c.is_control(), "·")
}

impl core::fmt::Display for LogProblem {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            Self::Read(what) => write!(f, "cannot read: {what}"),
            Self::Empty => f.write_str("the file is empty: a log starts with a header that names its columns"),
            Self::Compressed => f.write_str("the file is compressed: unpack it first (gunzip)"),
            Self::Utf16 => f.write_str(
                "the file is text in UTF-16, as PowerShell's `>` writes it: save it as UTF-8 (Out-File -Encoding utf8)",
            ),
            Self::SavedAsText { whole: true } => f.write_str(
                "the recording was saved as text in UTF-8, which changes its bytes: `iconv -f UTF-8 -t LATIN1 FILE > LOG.bin` \
                 gives them back",
            ),
            Self::SavedAsText { whole: false } => f.write_str(
                "the recording was saved as text, and the bytes that are none are lost: record again, with `hal-sim link --record` \
                 or a terminal that saves raw bytes",
            ),
            Self::NoHeader => write!(
                f,
                "no header: the first line must name the columns {}",
                COLUMNS.join(",")
            ),
            Self::MissingColumns(names) => {
                let (noun, names) = (if names.len() == 1 { "column" } else { "columns" }, names.join(", "));
                write!(f, "{noun} missing: {names}; the header must name them")
            }
            Self::DuplicateColumn(name) => write!(f, "column {name} appears twice: remove one"),
            Self::NoNumbers(columns) => write!(
                f,
                "no line has numbers in {columns}, where the format has time and sensors: another --format?"
            ),
            Self::NoRate => f.write_str("no column has the time: say how many rows a second there are, --rate-hz 100"),
            Self::CheckSum => f.write_str("the check sum of the sentence is missing or wrong: remove the line"),
            Self::NotByFormat => f.write_str(
                "the recording of a unit's line says itself what it holds: leave out --format, --mounting, --encoder-unit and \
                 --rate-hz",
            ),
            Self::NoRows => f.write_str("no rows after the header: nothing was recorded"),
            Self::SingleRow => f.write_str("a single row: its interval is unknown, two rows are the least"),
            Self::FieldCount { found, expected } => write!(
                f,
                "{found} {} where the header has {expected}: remove the row or repair it",
                if *found == 1 { "field" } else { "fields" }
            ),
            Self::RowLength { found, expected } => write!(
                f,
                "{found} {} where the first row has {expected}: remove the row or repair it",
                if *found == 1 { "field" } else { "fields" }
            ),
            Self::DecimalComma { found, expected } => write!(
                f,
                "{found} fields where the header has {expected}: the numbers seem to have decimal commas; separate fields \
                 by semicolons, or write decimal points"
            ),
            Self::NotANumber { column, text } if text.is_empty() => {
                write!(f, "{column}: empty where a number must be")
            }
            Self::NotANumber { column, text } => write!(f, "{column}: `{text}` is not a finite number"),
            Self::TooLarge { column, value } => write!(f, "{column}: {value:e} is beyond any sensor"),
            Self::Time { previous, now } => {
                write!(f, "t_s goes from {previous} to {now}: it must grow from row to row")
            }
            Self::Truncated => f.write_str("the file ends inside this row: copy the log again, or remove the row"),
            Self::LongLine => write!(f, "the line is longer than {MAX_LINE} bytes: not a log in CSV"),
            Self::NotText(byte) => write!(f, "byte {byte} of the line is not UTF-8 text: not a log in CSV"),
            Self::TimeStep(dt) => {
                write!(
                    f,
                    "t_s grows by {dt:.3e} from row to row: it must be in seconds, with 5 to 20000 rows a second"
                )?;
                match time_unit(*dt) {
                    Some((unit, factor)) => write!(f, "; it looks like {unit}, multiply by {factor}"),
                    None => Ok(()),
                }
            }
            Self::NoRecord { sentences } => write!(
                f,
                "{sentences} sentences, but no record of samples: switch recording on in the unit"
            ),
            Self::NoRecordHeader { frames } => write!(
                f,
                "{frames} frames of a record, but no header, which comes once a second: record for longer"
            ),
            Self::RecordVersion { found } => write!(
                f,
                "a record of version {found} where this program reads {}: use the program that belongs to the unit's \
                 firmware",
                record::VERSION
            ),
            Self::NoAngle { samples } => write!(
                f,
                "the rotor's angle is known in none of {samples} samples: let the unit home, or check its encoder"
            ),
            Self::AccelUnit { mean, unit, factor } => write!(
                f,
                "the accelerometers read {mean:.3} on average where gravity is 9.8 m/s²: they look like {unit}, \
                 multiply by {factor} or name the unit in a --format"
            ),
            Self::AccelNorm(mean) => write!(
                f,
                "the accelerometers read {mean:.3} on average where gravity is 9.8 m/s²: wrong unit or a broken axis"
            ),
            Self::AccelAxes(z) if *z < 0.0 => write!(
                f,
                "accel_z_m_s2 is {z:.2} on average where z is up and gravity reads +9.8: change the signs of all three \
                 accelerometers; or, of an IMU that hangs upside down, --mounting x,-y,-z"
            ),
            Self::AccelAxes(z) => write!(
                f,
                "accel_z_m_s2 is {z:.2} on average where z is up and gravity reads +9.8: exchange the axes so that z is the \
                 rotor's axis, as --mounting y,z,x does, and set that upright"
            ),
            Self::GyroUnit(rate) => write!(
                f,
                "the gyros read up to {rate:.3e} where no sensor reads more than a hundred rad/s: convert them to rad/s \
                 (degrees/s times 0.0174533, mrad/s times 0.001)"
            ),
            Self::GyroDegrees(ratio) => write!(
                f,
                "gyro_z_rad_s is {ratio:.1} times the encoder's rate: the gyros look like °/s, multiply by 0.0174533 or \
                 name the unit in a --format"
            ),
            Self::EncoderDegrees(rate) => write!(
                f,
                "encoder_rad turns at {rate:.1} a second: it looks like degrees, --encoder-unit deg"
            ),
            Self::Opposite => f.write_str(
                "gyro_z_rad_s and encoder_rad turn in opposite directions: both are positive counter-clockwise from \
                 above, change the sign of the wrong one; a minus in --encoder-unit is that of the encoder",
            ),
            Self::Mismatch(ratio) => {
                let digits = if ratio.abs() < 0.1 { 7 } else { 3 };
                write!(
                    f,
                    "gyro_z_rad_s is {ratio:.digits$} times the encoder's rate, which must be 1: {}",
                    cause(*ratio)
                )
            }
            Self::TiltReversed => f.write_str(
                "the base swings, and gravity moves on accel_x and accel_y the other way than gyro_x and gyro_y say: change \
                 the signs of x and y of the gyros, or of the accelerometers",
            ),
            Self::EncoderHeld { rows, behind } => write!(
                f,
                "encoder_rad repeats each angle for {rows:.1} rows while gyro z turns, which leaves it {:.2} degrees behind: \
                 read the encoder with each sample of the IMU, or interpolate its angles between the rows where they change",
                behind / frames::units::DEG
            ),
            Self::EncoderLate { delay, rate } => write!(
                f,
                "encoder_rad is some {:.0} ms {} gyro_z_rad_s, {:.1} degrees of heading: stamp both by one clock, or \
                 shift the angles by as many rows",
                delay.abs() * 1e3,
                if *delay > 0.0 { "behind" } else { "ahead of" },
                (delay * rate).abs() / frames::units::DEG
            ),
            Self::EncoderStuck { at, turned, seconds } => write!(
                f,
                "encoder_rad stands still at {at:.4} while gyro z turned by {turned:.2} rad in {seconds:.0} s: the \
                 encoder is stuck or not connected"
            ),
            Self::GyroStuck {
                column,
                value,
                saturated: true,
            } => write!(f, "{column}: saturated at {value}: angle is lost, use a wider range"),
            Self::GyroStuck { column, value, .. } => {
                write!(
                    f,
                    "{column}: frozen at {value}: angle is lost, the sensor or its bus failed"
                )
            }
        }
    }
}

/// Where in a log something is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Place {
    /// Line of a CSV, from 1 for the header.
    Line(u64),
    /// Bytes before it in a recording of a unit's line.
    Byte(u64),
}

impl core::fmt::Display for Place {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            Self::Line(line) => line.fmt(f),
            Self::Byte(byte) => write!(f, "byte {byte}"),
        }
    }
}

/// One line about a log: `file:line: what is wrong and what to do`.
#[derive(Debug, Clone, PartialEq)]
pub struct LogError {
    /// The file's name as it was given.
    pub file: String,
    /// Where; `None` where the trouble is the file.
    pub at: Option<Place>,
    /// What is wrong.
    pub problem: LogProblem,
}

impl core::fmt::Display for LogError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.write_str(&self.file)?;
        if let Some(at) = self.at {
            write!(f, ":{at}")?;
        }
        write!(f, ": {}", self.problem)
    }
}

impl core::error::Error for LogError {}

/// Rows missing before a row.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Gap {
    /// Time of the last row before it, s.
    pub after_s: f64,
    /// The interval a row should have, s.
    pub nominal_dt_s: f64,
    /// Rows missing, by the nominal interval.
    pub missing: u64,
}

/// One sample of a log.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LogRow {
    /// Where it is in the file.
    pub at: Place,
    /// End of the interval, s.
    pub t_s: f64,
    /// From the end of the row before, s. After a gap all of it.
    pub dt_s: f64,
    /// Mean rate of s against i, rad/s.
    pub w_is_s: Vec3<Sensor, f64>,
    /// Mean specific force, m/s².
    pub f_is_s: Vec3<Sensor, f64>,
    /// Rotor angle at `t_s`, rad.
    pub encoder: f64,
    /// Temperature of the IMU, °C, where recorded.
    pub temperature_c: Option<f64>,
    /// Where rows are missing before this one: the means of the row are then those of its own nominal interval, the
    /// last part of `dt_s`.
    pub gap: Option<Gap>,
    /// What the unit's alignment made of it, where the unit recorded that.
    pub taken: Option<Taken>,
}

impl LogRow {
    /// The row as the core takes it: increments over the row's own interval, with the time before it that has no data.
    pub fn sample(&self) -> Sample<f64> {
        let dt = self.gap.map_or(self.dt_s, |gap| gap.nominal_dt_s);
        Sample {
            dtheta_s: self.w_is_s * dt,
            dv_s: self.f_is_s * dt,
            dt,
            gap: self.dt_s - dt,
        }
    }
}

/// Writes a log row by row.
#[derive(Debug)]
pub struct LogWriter<W: Write> {
    out: W,
    temperature: bool,
}

impl LogWriter<BufWriter<File>> {
    /// Creates the file and writes the header; `temperature` says whether there is such a column.
    ///
    /// # Errors
    /// Where the file cannot be written.
    pub fn create(path: &Path, temperature: bool) -> io::Result<Self> {
        Self::new(BufWriter::new(File::create(path)?), temperature)
    }
}

impl<W: Write> LogWriter<W> {
    /// Writes the header; `out` should be buffered.
    ///
    /// # Errors
    /// Those of `out`.
    pub fn new(mut out: W, temperature: bool) -> io::Result<Self> {
        write!(out, "{}", COLUMNS.join(","))?;
        if temperature {
            write!(out, ",{TEMPERATURE}")?;
        }
        writeln!(out)?;
        Ok(Self { out, temperature })
    }

    /// Writes one sample: increments (rad, m/s) over the `dt_s` that ends at `t_s`, the encoder at its end (rad).
    ///
    /// Twelve digits: 1e-12 relative is far below half an ulp of f32 (6e-8), so that a replay differs from the run by
    /// an ulp in one row of 10⁴. The time is written in full.
    ///
    /// # Errors
    /// Those of `out`.
    pub fn write(
        &mut self,
        t_s: f64,
        dt_s: f64,
        dtheta_s: Vec3<Sensor, f64>,
        dv_s: Vec3<Sensor, f64>,
        encoder: f64,
        temperature_c: Option<f64>,
    ) -> io::Result<()> {
        let [wx, wy, wz] = (dtheta_s / dt_s).to_array();
        let [fx, fy, fz] = (dv_s / dt_s).to_array();
        write!(
            self.out,
            "{t_s},{wx:.11e},{wy:.11e},{wz:.11e},{fx:.11e},{fy:.11e},{fz:.11e},{encoder:.11e}"
        )?;
        if self.temperature {
            match temperature_c {
                Some(temperature_c) => write!(self.out, ",{temperature_c:.3}")?,
                None => write!(self.out, ",")?,
            }
        }
        writeln!(self.out)
    }

    /// Writes out what is buffered. A log that is not finished may lack its last rows.
    ///
    /// # Errors
    /// Those of `out`.
    pub fn finish(mut self) -> io::Result<W> {
        self.out.flush()?;
        Ok(self.out)
    }
}

/// Bytes at the start of a file by which it is told what it is: two seconds of a recording.
const LOOK: usize = 1 << 14;

/// The start of a file that has been looked at, and the rest.
type Whole<R> = Chain<Cursor<Vec<u8>>, R>;

#[derive(Debug)]
enum Source<R: BufRead> {
    Csv(Box<csv::Reader<Whole<R>>>),
    Binary(Box<binary::Reader<Whole<R>>>),
}

/// Reads a log as an iterator of rows, in constant memory. The first error ends it.
///
/// What it is, CSV or the recording of a unit's line, is told by its content.
#[derive(Debug)]
pub struct LogReader<R: BufRead>(Source<R>);

impl LogReader<BufReader<File>> {
    /// Opens a file and reads its header.
    ///
    /// # Errors
    /// [`LogError`] where the file cannot be read or its header lacks something.
    pub fn open(path: &Path) -> Result<Self, LogError> {
        let name = path.display().to_string();
        match File::open(path) {
            Ok(file) => Self::new(BufReader::with_capacity(1 << 16, file), &name),
            Err(error) => Err(LogError::cannot_read(&name, &error)),
        }
    }
}

impl LogError {
    /// A file that the system does not give.
    pub fn cannot_read(file: &str, error: &io::Error) -> Self {
        Self {
            file: file.to_owned(),
            at: None,
            problem: LogProblem::Read(error.to_string()),
        }
    }
}

/// Whether text begins in two bytes a character: by its mark, or by every second byte of it.
pub(crate) fn is_utf16(start: &[u8]) -> bool {
    let wide = |zero: usize| {
        let first = start.first_chunk::<8>();
        first.is_some_and(|first| {
            first
                .iter()
                .enumerate()
                .all(|(k, byte)| (k % 2 == zero) == (*byte == 0))
        })
    };
    start.starts_with(b"\xff\xfe") || start.starts_with(b"\xfe\xff") || wide(0) || wide(1)
}

/// What a terminal that saves text makes of a recording's bytes: each one beyond ASCII becomes a character of Latin-1, or
/// the mark for what is none.
fn saved_as_text(start: &[u8]) -> Option<LogProblem> {
    let whole = start.utf8_chunks().next()?.valid();
    if whole.is_ascii() {
        return None;
    }
    let bytes: Option<Vec<u8>> = whole.chars().map(|c| u8::try_from(c).ok()).collect();
    if bytes.is_some_and(|bytes| binary::has_frame(&bytes)) {
        return Some(LogProblem::SavedAsText { whole: true });
    }
    // Text has no control characters, and marks are rare in it.
    let count = |is: fn(char) -> bool| whole.chars().filter(|c| is(*c)).count();
    let (marks, controls) = (
        count(|c| c == char::REPLACEMENT_CHARACTER),
        count(|c| c.is_ascii_control() && !c.is_ascii_whitespace() && c != '\0'),
    );
    (marks >= LOST_BYTES && controls >= LOST_BYTES).then_some(LogProblem::SavedAsText { whole: false })
}

/// So many marks of lost bytes, and so many control characters, are no text.
const LOST_BYTES: usize = 8;

impl<R: BufRead> LogReader<R> {
    /// Reads the header from `input`; `file_name` is for messages.
    ///
    /// # Errors
    /// [`LogError`] where there is no header or it lacks something.
    pub fn new(input: R, file_name: &str) -> Result<Self, LogError> {
        Self::with_format(input, file_name, &Format::default())
    }

    /// The same for text whose columns are those of `format`.
    ///
    /// # Errors
    /// As of [`Self::new`].
    pub fn with_format(mut input: R, file_name: &str, format: &Format) -> Result<Self, LogError> {
        let mut start = Vec::with_capacity(LOOK);
        let looked = (&mut input).take(LOOK as u64).read_to_end(&mut start);
        looked.map_err(|error| LogError::cannot_read(file_name, &error))?;
        let refused = |problem| LogError {
            file: file_name.to_owned(),
            at: None,
            problem,
        };
        let binary = if format.is_default() {
            binary::is_recording(&start)
        } else if binary::has_frame(&start) {
            return Err(refused(LogProblem::NotByFormat));
        } else {
            // Others send sentences as well.
            false
        };
        if let Some(problem) = saved_as_text(&start).filter(|_| !binary::has_frame(&start)) {
            return Err(refused(problem));
        }
        if !binary && is_utf16(&start) {
            return Err(refused(LogProblem::Utf16));
        }
        let whole = Cursor::new(start).chain(input);
        Ok(Self(if binary {
            Source::Binary(Box::new(binary::Reader::new(whole, file_name)?))
        } else {
            Source::Csv(Box::new(csv::Reader::new(whole, file_name, format)?))
        }))
    }

    /// The file's name as it was given.
    pub fn file_name(&self) -> &str {
        match &self.0 {
            Source::Csv(reader) => reader.file_name(),
            Source::Binary(reader) => reader.file_name(),
        }
    }

    /// The interval that rows should have, s: of a CSV by the rows against the time they take, the first of a recording;
    /// `None` before the first row was asked for.
    pub fn nominal_dt_s(&self) -> Option<f64> {
        match &self.0 {
            Source::Csv(reader) => reader.nominal_dt_s(),
            Source::Binary(reader) => reader.nominal_dt_s(),
        }
    }

    /// What a recording says of the unit: the header read last. A CSV says nothing.
    pub fn header(&self) -> Option<&Header> {
        match &self.0 {
            Source::Csv(_) => None,
            Source::Binary(reader) => Some(reader.header()),
        }
    }

    /// The next mode or fault that a recording tells of, up to the row given last; beyond the latest hundred they are
    /// forgotten.
    pub fn next_status(&mut self) -> Option<UnitStatus> {
        match &mut self.0 {
            Source::Csv(_) => None,
            Source::Binary(reader) => reader.next_status(),
        }
    }

    /// What of a recording was lost or is of no use so far.
    pub fn loss(&self) -> Option<&Loss> {
        match &self.0 {
            Source::Csv(_) => None,
            Source::Binary(reader) => Some(reader.loss()),
        }
    }

    /// The same as warnings; of a CSV, what was doubtful about its times and bytes so far.
    pub fn warnings(&self) -> Vec<LogWarning> {
        match &self.0 {
            Source::Csv(reader) => reader.warnings(),
            Source::Binary(reader) => reader.loss().warnings(reader.file_name()),
        }
    }

    /// Whether a CSV has a column for the temperature, filled or not.
    fn has_temperature(&self) -> bool {
        matches!(&self.0, Source::Csv(reader) if reader.has_temperature())
    }
}

impl<R: BufRead> Iterator for LogReader<R> {
    type Item = Result<LogRow, LogError>;

    fn next(&mut self) -> Option<Self::Item> {
        match &mut self.0 {
            Source::Csv(reader) => reader.next(),
            Source::Binary(reader) => reader.next(),
        }
    }
}

/// Why a log cannot be written again.
#[derive(Debug)]
pub enum ConvertError {
    /// The log that is read.
    Log(LogError),
    /// The file to be written.
    Write(PathBuf, io::Error),
    /// It is the log itself.
    Itself(PathBuf),
}

impl core::fmt::Display for ConvertError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            Self::Log(e) => e.fmt(f),
            Self::Write(path, e) => write!(f, "cannot write {}: {e}", path.display()),
            Self::Itself(path) => write!(
                f,
                "{}: the log itself cannot be written: name another file",
                path.display()
            ),
        }
    }
}

impl core::error::Error for ConvertError {}

impl From<LogError> for ConvertError {
    fn from(e: LogError) -> Self {
        Self::Log(e)
    }
}

/// That what is made of the log `from` does not go over it: created before it is read, it would be empty.
///
/// # Errors
/// [`ConvertError::Itself`].
pub fn not_itself(from: &Path, to: &Path) -> Result<(), ConvertError> {
    let same = from.canonicalize().and_then(|from| Ok(from == to.canonicalize()?));
    if same.unwrap_or(false) {
        return Err(ConvertError::Itself(to.to_owned()));
    }
    Ok(())
}

/// Writes a log, whatever it is, as CSV; the rows that were written.
///
/// # Errors
/// [`ConvertError`].
pub fn convert(from: &Path, to: &Path) -> Result<(u64, Vec<LogWarning>), ConvertError> {
    let mut reader = LogReader::open(from)?;
    let rows = convert_from(&mut reader, from, to, LogRow::sample)?;
    Ok((rows, reader.warnings()))
}

/// The same for the log `from` that is open already, each row as `sample` has it.
///
/// # Errors
/// [`ConvertError`].
pub fn convert_from<R: BufRead>(
    reader: &mut LogReader<R>,
    from: &Path,
    to: &Path,
    sample: impl Fn(&LogRow) -> Sample<f64>,
) -> Result<u64, ConvertError> {
    let failed = |e| ConvertError::Write(to.to_owned(), e);
    not_itself(from, to)?;
    let mut out: Option<LogWriter<_>> = None;
    let mut rows = 0;
    while let Some(row) = reader.next() {
        let row = row?;
        let out = match &mut out {
            Some(out) => out,
            none => {
                let temperature = row.temperature_c.is_some() || reader.has_temperature();
                none.insert(LogWriter::create(to, temperature).map_err(failed)?)
            }
        };
        let Sample { dtheta_s, dv_s, dt, .. } = sample(&row);
        out.write(row.t_s, dt, dtheta_s, dv_s, row.encoder, row.temperature_c)
            .map_err(failed)?;
        rows += 1;
    }
    out.map_or(Ok(()), |out| out.finish().map(drop).map_err(failed))?;
    Ok(rows)
}
