//! Recorded logs: CSV with one row a sample, written and read as a stream.
//!
//! ```text
//! t_s,gyro_x_rad_s,gyro_y_rad_s,gyro_z_rad_s,accel_x_m_s2,accel_y_m_s2,accel_z_m_s2,encoder_rad[,temperature_c]
//! ```
//!
//! Rates and specific forces are means over the interval that ends at `t_s`, in s; the encoder is read at its end. The
//! first interval is as long as the second. Columns are found by their names, in any order; other columns are ignored.
//! Blank lines, CRLF, a byte order mark and quoted fields are accepted.
//!
//! Memory is bounded whatever the file holds: a line is at most [`MAX_LINE`] bytes and rows are not kept.
//!
//! [`LogReader`] refuses what cannot be read. Whether readable figures can be true is for [`Checker`].

mod check;
#[cfg(test)]
mod tests;

use std::collections::VecDeque;
use std::fs::File;
use std::io::{self, BufRead, BufReader, BufWriter, Write};
use std::path::Path;

use frames::{Sensor, Vec3};

pub use check::{Checker, LogWarning, WarningKind};

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

/// An interval this many times the nominal one has rows missing.
const GAP_FACTOR: f64 = 1.5;

/// The nominal interval is the median of the intervals between this many rows at the start.
const LOOK_AHEAD: usize = 33;

/// Largest magnitude accepted, by column: beyond any sensor in any unit one could have taken by mistake, and well
/// within f32.
const LIMITS: [f64; 9] = [1e12, 1e6, 1e6, 1e6, 1e6, 1e6, 1e6, 1e7, 1e6];

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
    /// The first line is not a header but numbers.
    NoHeader,
    /// Columns the header lacks.
    MissingColumns(Vec<&'static str>),
    /// A column that appears twice.
    DuplicateColumn(&'static str),
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
    /// Text, nothing, NaN or infinity in the place of a number.
    NotANumber {
        /// The column.
        column: &'static str,
        /// What is there, shortened.
        text: String,
    },
    /// A number beyond any sensor.
    TooLarge {
        /// The column.
        column: &'static str,
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
    /// The gyros are in °/s: gyro z over the encoder's rate.
    GyroDegrees(f64),
    /// The encoder is in degrees: its rate as read.
    EncoderDegrees(f64),
    /// Gyro z and encoder turn in opposite directions.
    Opposite,
    /// The encoder rests while gyro z turns.
    EncoderStuck {
        /// Its reading, rad.
        at: f64,
        /// What gyro z turned by, rad.
        turned: f64,
        /// In this time, s.
        seconds: f64,
    },
    /// The encoder never turned, and gyro z neither.
    NoRotation,
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
            Self::NoRows => f.write_str("no rows after the header: nothing was recorded"),
            Self::SingleRow => f.write_str("a single row: its interval is unknown, two rows are the least"),
            Self::FieldCount { found, expected } => write!(
                f,
                "{found} {} where the header has {expected}: remove the row or repair it",
                if *found == 1 { "field" } else { "fields" }
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
            Self::TimeStep(dt) => write!(
                f,
                "t_s grows by {dt:.3e} from row to row: it must be in seconds, with 5 to 20000 rows a second"
            ),
            Self::AccelUnit { mean, unit, factor } => write!(
                f,
                "the accelerometers read {mean:.3} on average where gravity is 9.8 m/s²: they look like {unit}, \
                 multiply by {factor}"
            ),
            Self::AccelNorm(mean) => write!(
                f,
                "the accelerometers read {mean:.3} on average where gravity is 9.8 m/s²: wrong unit or a broken axis"
            ),
            Self::GyroDegrees(ratio) => write!(
                f,
                "gyro_z_rad_s is {ratio:.1} times the encoder's rate: the gyros look like °/s, multiply by 0.0174533"
            ),
            Self::EncoderDegrees(rate) => write!(
                f,
                "encoder_rad turns at {rate:.1} a second: it looks like degrees, multiply by 0.0174533"
            ),
            Self::Opposite => f.write_str(
                "gyro_z_rad_s and encoder_rad turn in opposite directions: both are positive counter-clockwise from \
                 above, change the sign of the wrong one",
            ),
            Self::EncoderStuck { at, turned, seconds } => write!(
                f,
                "encoder_rad stands still at {at:.4} while gyro z turned by {turned:.2} rad in {seconds:.0} s: the \
                 encoder is stuck or not connected"
            ),
            Self::NoRotation => {
                f.write_str("encoder_rad never turned: the rotor stood still, or the encoder was not connected")
            }
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

/// One line about a log: `file:line: what is wrong and what to do`.
#[derive(Debug, Clone, PartialEq)]
pub struct LogError {
    /// The file's name as it was given.
    pub file: String,
    /// The line, from 1 for the header; `None` where the trouble is the file.
    pub line: Option<u64>,
    /// What is wrong.
    pub problem: LogProblem,
}

impl core::fmt::Display for LogError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.write_str(&self.file)?;
        if let Some(line) = self.line {
            write!(f, ":{line}")?;
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
    /// Line in the file, from 1 for the header.
    pub line: u64,
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
}

impl LogRow {
    /// Angle increment over `dt_s`, rad. After a gap it takes the row's mean for all of it.
    pub fn dtheta_s(&self) -> Vec3<Sensor, f64> {
        self.w_is_s * self.dt_s
    }

    /// Velocity increment over `dt_s`, m/s. After a gap it takes the row's mean for all of it.
    pub fn dv_s(&self) -> Vec3<Sensor, f64> {
        self.f_is_s * self.dt_s
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
            write!(self.out, ",{:.3}", temperature_c.unwrap_or_default())?;
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

/// How a line ended.
enum Line {
    /// By a line feed.
    Complete,
    /// By the end of the file.
    Unterminated,
    /// There was none.
    End,
}

/// A row before its interval is known.
#[derive(Debug, Clone, Copy)]
struct RawRow {
    line: u64,
    /// [`COLUMNS`], then temperature.
    values: [f64; 9],
}

impl RawRow {
    fn t_s(&self) -> f64 {
        self.values[0]
    }
}

/// How the numbers of the last column are written: decimals, and whether an exponent follows. A last line that has no
/// line feed is complete only if its last number looks like all before it.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Spelling {
    Unknown,
    Always(usize, bool),
    Varies,
}

impl Spelling {
    fn of(number: &str) -> Self {
        let decimals = number
            .split_once('.')
            .map_or(0, |(_, rest)| rest.bytes().take_while(u8::is_ascii_digit).count());
        Self::Always(decimals, number.contains(['e', 'E']))
    }

    fn learn(&mut self, next: Self) {
        *self = match *self {
            Self::Unknown => next,
            known if known == next => known,
            _ => Self::Varies,
        };
    }

    fn allows(self, next: Self) -> bool {
        matches!(self, Self::Unknown | Self::Varies) || self == next
    }
}

/// Reads a log as an iterator of rows, in constant memory. The first error ends it.
#[derive(Debug)]
pub struct LogReader<R: BufRead> {
    input: R,
    file: String,
    line: u64,
    buffer: Vec<u8>,
    /// For each field of a row, its place in [`RawRow::values`]; `None` for columns that are ignored.
    fields: Vec<Option<usize>>,
    has_temperature: bool,
    spelling: Spelling,
    previous_t: Option<f64>,
    /// Rows read ahead to find the nominal interval.
    ahead: VecDeque<Result<RawRow, LogError>>,
    nominal: Option<f64>,
    /// Time of the row given last.
    given_t: Option<f64>,
    done: bool,
}

impl LogReader<BufReader<File>> {
    /// Opens a file and reads its header.
    ///
    /// # Errors
    /// [`LogError`] where the file cannot be read or its header lacks something.
    pub fn open(path: &Path) -> Result<Self, LogError> {
        let name = path.display().to_string();
        match File::open(path) {
            Ok(file) => Self::new(BufReader::with_capacity(1 << 16, file), &name),
            Err(error) => Err(LogError {
                file: name,
                line: None,
                problem: LogProblem::Read(error.to_string()),
            }),
        }
    }
}

impl<R: BufRead> LogReader<R> {
    /// Reads the header from `input`; `file_name` is for messages.
    ///
    /// # Errors
    /// [`LogError`] where there is no header or it lacks something.
    pub fn new(input: R, file_name: &str) -> Result<Self, LogError> {
        let mut reader = Self {
            input,
            file: file_name.to_owned(),
            line: 0,
            buffer: Vec::with_capacity(256),
            fields: Vec::new(),
            has_temperature: false,
            spelling: Spelling::Unknown,
            previous_t: None,
            ahead: VecDeque::with_capacity(LOOK_AHEAD),
            nominal: None,
            given_t: None,
            done: false,
        };
        reader.header()?;
        Ok(reader)
    }

    /// The file's name as it was given.
    pub fn file_name(&self) -> &str {
        &self.file
    }

    /// The median interval at the start of the log, s; `None` before the first row was asked for.
    pub fn nominal_dt_s(&self) -> Option<f64> {
        self.nominal
    }

    fn error(&self, problem: LogProblem) -> LogError {
        LogError {
            file: self.file.clone(),
            line: (self.line > 0).then_some(self.line),
            problem,
        }
    }

    /// Reads the next line that is not blank into the buffer, without its end.
    fn read_line(&mut self) -> Result<Line, LogError> {
        loop {
            self.buffer.clear();
            let mut ended = Line::End;
            loop {
                let chunk = match self.input.fill_buf() {
                    Ok(chunk) => chunk,
                    Err(error) if error.kind() == io::ErrorKind::Interrupted => continue,
                    Err(error) => return Err(self.error(LogProblem::Read(error.to_string()))),
                };
                if chunk.is_empty() {
                    break;
                }
                if matches!(ended, Line::End) {
                    self.line += 1;
                    ended = Line::Unterminated;
                }
                let feed = chunk.iter().position(|byte| *byte == b'\n');
                let take = feed.unwrap_or(chunk.len());
                if self.buffer.len() + take > MAX_LINE {
                    // A compressed file has no lines either, and deserves the better message.
                    self.buffer.extend(chunk.iter().take(2));
                    return Err(self.error(self.not_csv(LogProblem::LongLine)));
                }
                self.buffer.extend_from_slice(&chunk[..take]);
                self.input.consume(take + usize::from(feed.is_some()));
                if feed.is_some() {
                    ended = Line::Complete;
                    break;
                }
            }
            if self.line == 1 && self.buffer.starts_with(b"\xef\xbb\xbf") {
                self.buffer.drain(..3);
            }
            if matches!(ended, Line::End) || !self.buffer.iter().all(u8::is_ascii_whitespace) {
                return Ok(ended);
            }
        }
    }

    /// The problem, unless the file is a gzip one.
    fn not_csv(&self, problem: LogProblem) -> LogProblem {
        if self.line == 1 && self.buffer.starts_with(b"\x1f\x8b") {
            LogProblem::Compressed
        } else {
            problem
        }
    }

    fn text(&self) -> Result<&str, LogError> {
        core::str::from_utf8(&self.buffer)
            .map_err(|e| self.error(self.not_csv(LogProblem::NotText(e.valid_up_to() + 1))))
    }

    fn header(&mut self) -> Result<(), LogError> {
        if matches!(self.read_line()?, Line::End) {
            self.line = 0;
            return Err(self.error(LogProblem::Empty));
        }
        let text = self.text()?;
        if field(text.split(',').next().unwrap_or_default()).parse::<f64>().is_ok() {
            return Err(self.error(LogProblem::NoHeader));
        }
        let names = || COLUMNS.into_iter().chain([TEMPERATURE]);
        let fields: Vec<_> = text
            .split(',')
            .map(|name| names().position(|known| known == field(name)))
            .collect();
        let count = |place| fields.iter().filter(|found| **found == Some(place)).count();
        if let Some((_, name)) = names().enumerate().find(|(place, _)| count(*place) > 1) {
            return Err(self.error(LogProblem::DuplicateColumn(name)));
        }
        let missing: Vec<_> = COLUMNS
            .into_iter()
            .enumerate()
            .filter(|(place, _)| count(*place) == 0)
            .map(|(_, name)| name)
            .collect();
        if !missing.is_empty() {
            return Err(self.error(LogProblem::MissingColumns(missing)));
        }
        self.has_temperature = count(COLUMNS.len()) > 0;
        self.fields = fields;
        Ok(())
    }

    fn read_row(&mut self) -> Option<Result<RawRow, LogError>> {
        let line = match self.read_line() {
            Ok(line) => line,
            Err(error) => return Some(Err(error)),
        };
        let whole = match line {
            Line::End => return None,
            Line::Complete => true,
            Line::Unterminated => false,
        };
        Some(match self.parse_row() {
            Ok((_, last)) if !whole && !self.spelling.allows(last) => Err(self.error(LogProblem::Truncated)),
            Ok((row, last)) => {
                self.spelling.learn(last);
                self.in_time(row)
            }
            Err(error) if !whole && self.is_cut(&error.problem) => Err(self.error(LogProblem::Truncated)),
            Err(error) => Err(error),
        })
    }

    /// Whether a problem of the last line is that its end is missing.
    fn is_cut(&self, problem: &LogProblem) -> bool {
        match problem {
            LogProblem::FieldCount { found, expected } => found < expected,
            LogProblem::NotText(byte) => *byte + 3 >= self.buffer.len(),
            LogProblem::NotANumber { column, text } => {
                let last = self.fields.last().copied().flatten();
                last.is_some_and(|place| name_of(place) == *column) && text.parse::<f64>().is_err()
            }
            _ => false,
        }
    }

    /// The row, and how its last number is written.
    fn parse_row(&self) -> Result<(RawRow, Spelling), LogError> {
        let text = self.text()?;
        let found = text.split(',').count();
        if found != self.fields.len() {
            return Err(self.error(LogProblem::FieldCount {
                found,
                expected: self.fields.len(),
            }));
        }
        let mut values = [0.0; 9];
        for (text, place) in text.split(',').zip(&self.fields) {
            let Some(place) = *place else { continue };
            let column = name_of(place);
            let text = field(text);
            let value = text
                .parse::<f64>()
                .ok()
                .filter(|value| value.is_finite())
                .ok_or_else(|| {
                    self.error(LogProblem::NotANumber {
                        column,
                        text: shorten(text),
                    })
                })?;
            if value.abs() > LIMITS[place] {
                return Err(self.error(LogProblem::TooLarge { column, value }));
            }
            values[place] = value;
        }
        let last = Spelling::of(text.rsplit(',').next().map(field).unwrap_or_default());
        Ok((
            RawRow {
                line: self.line,
                values,
            },
            last,
        ))
    }

    fn in_time(&mut self, row: RawRow) -> Result<RawRow, LogError> {
        let now = row.t_s();
        if let Some(previous) = self.previous_t.filter(|previous| *previous >= now) {
            return Err(self.error(LogProblem::Time { previous, now }));
        }
        self.previous_t = Some(now);
        Ok(row)
    }

    /// Reads the first rows and takes their median interval for the nominal one.
    fn look_ahead(&mut self) -> Option<LogError> {
        while self.ahead.len() < LOOK_AHEAD {
            match self.read_row() {
                None => break,
                Some(row) => {
                    let failed = row.is_err();
                    self.ahead.push_back(row);
                    if failed {
                        break;
                    }
                }
            }
        }
        let times: Vec<_> = self.ahead.iter().flatten().map(RawRow::t_s).collect();
        let mut intervals: Vec<_> = times.windows(2).map(|pair| pair[1] - pair[0]).collect();
        intervals.sort_by(f64::total_cmp);
        self.nominal = intervals.get(intervals.len() / 2).copied();
        if self.nominal.is_some() {
            return None;
        }
        match self.ahead.pop_back() {
            Some(Err(error)) => Some(error),
            Some(Ok(_)) => Some(self.error(LogProblem::SingleRow)),
            None => Some(self.error(LogProblem::NoRows)),
        }
    }

    fn finish_row(&mut self, row: RawRow, nominal: f64) -> LogRow {
        let t_s = row.t_s();
        let limit = GAP_FACTOR * nominal;
        let (dt_s, gap) = match self.given_t {
            Some(previous) => {
                let dt_s = t_s - previous;
                let gap = (dt_s > limit).then(|| Gap {
                    after_s: previous,
                    nominal_dt_s: nominal,
                    missing: (dt_s / nominal).round() as u64 - 1,
                });
                (dt_s, gap)
            }
            None => {
                let second = self
                    .ahead
                    .front()
                    .and_then(|next| next.as_ref().ok())
                    .map(|next| next.t_s() - t_s);
                (second.filter(|dt_s| *dt_s <= limit).unwrap_or(nominal), None)
            }
        };
        self.given_t = Some(t_s);
        let [_, wx, wy, wz, fx, fy, fz, encoder, temperature] = row.values;
        LogRow {
            line: row.line,
            t_s,
            dt_s,
            w_is_s: Vec3::new(wx, wy, wz),
            f_is_s: Vec3::new(fx, fy, fz),
            encoder,
            temperature_c: self.has_temperature.then_some(temperature),
            gap,
        }
    }
}

/// The column at a place in [`RawRow::values`].
fn name_of(place: usize) -> &'static str {
    COLUMNS.get(place).copied().unwrap_or(TEMPERATURE)
}

/// A field without blanks and quotes around it.
fn field(text: &str) -> &str {
    text.trim().trim_matches('"').trim()
}

impl<R: BufRead> Iterator for LogReader<R> {
    type Item = Result<LogRow, LogError>;

    fn next(&mut self) -> Option<Self::Item> {
        if self.done {
            return None;
        }
        if self.nominal.is_none()
            && let Some(error) = self.look_ahead()
        {
            self.done = true;
            return Some(Err(error));
        }
        let row = match self.ahead.pop_front() {
            Some(row) => Some(row),
            None => self.read_row(),
        };
        match (row, self.nominal) {
            (Some(Ok(row)), Some(nominal)) => Some(Ok(self.finish_row(row, nominal))),
            (Some(Err(error)), _) => {
                self.done = true;
                Some(Err(error))
            }
            _ => {
                self.done = true;
                None
            }
        }
    }
}
