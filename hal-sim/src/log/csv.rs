//! The reader of CSV.

use std::collections::VecDeque;
use std::io::{self, BufRead};

use frames::Vec3;

use super::{COLUMNS, Gap, LIMITS, LogError, LogProblem, LogRow, MAX_LINE, Place, TEMPERATURE, shorten};

/// An interval this many times the nominal one has rows missing.
const GAP_FACTOR: f64 = 1.5;

/// The nominal interval is the median of the intervals between this many rows at the start.
const LOOK_AHEAD: usize = 33;

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

/// Reads CSV as an iterator of rows. The first error ends it.
#[derive(Debug)]
pub(super) struct Reader<R: BufRead> {
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

impl<R: BufRead> Reader<R> {
    /// Reads the header from `input`; `file_name` is for messages.
    ///
    /// # Errors
    /// [`LogError`] where there is no header or it lacks something.
    pub(super) fn new(input: R, file_name: &str) -> Result<Self, LogError> {
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
    pub(super) fn file_name(&self) -> &str {
        &self.file
    }

    /// The median interval at the start of the log, s; `None` before the first row was asked for.
    pub(super) fn nominal_dt_s(&self) -> Option<f64> {
        self.nominal
    }

    fn error(&self, problem: LogProblem) -> LogError {
        LogError {
            file: self.file.clone(),
            at: (self.line > 0).then_some(Place::Line(self.line)),
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
            at: Place::Line(row.line),
            t_s,
            dt_s,
            w_is_s: Vec3::new(wx, wy, wz),
            f_is_s: Vec3::new(fx, fy, fz),
            encoder,
            temperature_c: self.has_temperature.then_some(temperature),
            gap,
            taken: None,
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

impl<R: BufRead> Iterator for Reader<R> {
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
