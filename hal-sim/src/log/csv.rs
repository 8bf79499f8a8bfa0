//! The reader of CSV.

use std::collections::VecDeque;
use std::io::{self, BufRead};

use frames::Vec3;

use super::time::{Clock, Stamp, WINDOW, When};
use super::{
    COLUMNS, LIMITS, LogError, LogProblem, LogRow, LogWarning, MAX_LINE, Place, TEMPERATURE, WarningKind, shorten,
};

/// What may stand between the fields, besides blanks.
const SEPARATORS: [char; 4] = [',', ';', '\t', '|'];
/// Words for no value in a column that a log need not have.
const NOTHING: [&str; 6] = ["", "nan", "na", "n/a", "null", "-"];

/// How a line ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Line {
    /// By a line feed.
    Complete,
    /// By the end of the file.
    Unterminated,
    /// By NUL bytes, which a system that lost its power leaves where it had not written yet.
    Cut,
    /// There was none.
    End,
}

/// A row before its interval is known.
#[derive(Debug, Clone, Copy)]
struct RawRow {
    line: u64,
    /// [`COLUMNS`], then temperature, NaN where there is none.
    values: [f64; 9],
    /// Whether all but the time is as in the row before.
    repeated: bool,
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
            .split_once(['.', ','])
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
    /// What stands between fields; a blank: any number of them.
    separator: char,
    spelling: Spelling,
    previous: Option<[f64; 9]>,
    /// Rows read ahead to find their times, …
    ahead: VecDeque<RawRow>,
    /// … the times of the first of them, …
    times: VecDeque<When>,
    /// … and what comes after the last.
    failed: Option<LogError>,
    clock: Clock,
    ended: bool,
    /// NUL bytes, and the line of the first.
    nul: Option<(u64, u64)>,
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
            separator: ',',
            spelling: Spelling::Unknown,
            previous: None,
            ahead: VecDeque::new(),
            times: VecDeque::new(),
            failed: None,
            clock: Clock::default(),
            ended: false,
            nul: None,
        };
        reader.header()?;
        Ok(reader)
    }

    /// The file's name as it was given.
    pub(super) fn file_name(&self) -> &str {
        &self.file
    }

    /// The interval of the rows, s; `None` before the first row was asked for.
    pub(super) fn nominal_dt_s(&self) -> Option<f64> {
        self.clock.interval()
    }

    /// Whether there is a column for the temperature.
    pub(super) fn has_temperature(&self) -> bool {
        self.fields.contains(&Some(COLUMNS.len()))
    }

    /// What was doubtful so far.
    pub(super) fn warnings(&self) -> Vec<LogWarning> {
        let nul = self.nul.map(|(bytes, line)| LogWarning {
            file: self.file.clone(),
            at: Place::Line(line),
            kind: WarningKind::Nul { bytes },
        });
        let mut warnings = self.clock.warnings(&self.file);
        warnings.extend(nul);
        warnings
    }

    fn error(&self, problem: LogProblem) -> LogError {
        LogError {
            file: self.file.clone(),
            at: (self.line > 0).then_some(Place::Line(self.line)),
            problem,
        }
    }

    /// Reads the next line that is neither blank nor a comment into the buffer, without its end. In the header nothing is
    /// a comment: some write it as one.
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
                // Before there is a header, NUL is what no text has.
                let in_rows = !self.fields.is_empty();
                let end = |byte: &u8| *byte == b'\n' || (in_rows && *byte == 0);
                let feed = chunk.iter().position(end);
                let take = feed.unwrap_or(chunk.len());
                let cut = feed.is_some_and(|at| chunk[at] == 0);
                if self.buffer.len() + take > MAX_LINE {
                    // A compressed file has no lines either, and deserves the better message.
                    self.buffer.extend(chunk.iter().take(2));
                    return Err(self.error(self.not_csv(LogProblem::LongLine)));
                }
                self.buffer.extend_from_slice(&chunk[..take]);
                self.input.consume(take + usize::from(feed.is_some()));
                if cut {
                    let line = self.line;
                    self.nul.get_or_insert((0, line)).0 += 1;
                    // More of them end nothing, and are no lines.
                    if self.buffer.is_empty() {
                        self.line -= 1;
                        ended = Line::End;
                        continue;
                    }
                    ended = Line::Cut;
                    break;
                }
                if feed.is_some() {
                    ended = Line::Complete;
                    break;
                }
            }
            if self.line == 1 && self.buffer.starts_with(b"\xef\xbb\xbf") {
                self.buffer.drain(..3);
            }
            let first = self.buffer.iter().find(|byte| !byte.is_ascii_whitespace());
            let comment = first == Some(&b'#') && !self.fields.is_empty();
            if ended == Line::End || !(first.is_none() || comment) {
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
        let mut comments = false;
        loop {
            if matches!(self.read_line()?, Line::End) {
                if !comments {
                    self.line = 0;
                }
                return Err(self.error(if comments {
                    LogProblem::NoHeader
                } else {
                    LogProblem::Empty
                }));
            }
            let text = self.text()?;
            let comment = text.trim_start().strip_prefix('#');
            let (separator, fields) = columns(comment.unwrap_or(text));
            let count = |place| fields.iter().filter(|found| **found == Some(place)).count();
            if comment.is_some() && (0..COLUMNS.len()).any(|place| count(place) == 0) {
                comments = true;
                continue;
            }
            if split(text, separator)
                .first()
                .is_some_and(|first| number(first, separator).is_some())
            {
                return Err(self.error(LogProblem::NoHeader));
            }
            if let Some(place) = (0..=COLUMNS.len()).find(|place| count(*place) > 1) {
                return Err(self.error(LogProblem::DuplicateColumn(name_of(place))));
            }
            let missing: Vec<_> = (0..COLUMNS.len())
                .filter(|place| count(*place) == 0)
                .map(name_of)
                .collect();
            if !missing.is_empty() {
                return Err(self.error(LogProblem::MissingColumns(missing)));
            }
            self.separator = separator;
            self.fields = fields;
            return Ok(());
        }
    }

    fn read_row(&mut self) -> Option<Result<RawRow, LogError>> {
        loop {
            let line = match self.read_line() {
                Ok(Line::End) => return None,
                Ok(line) => line,
                Err(error) => return Some(Err(error)),
            };
            let whole = line == Line::Complete;
            let parsed = match self.parse_row() {
                Ok((_, last)) if !whole && !self.spelling.allows(last) => Err(self.error(LogProblem::Truncated)),
                Err(error) if !whole && self.is_cut(&error.problem) => Err(self.error(LogProblem::Truncated)),
                parsed => parsed,
            };
            match parsed {
                // The row that was being written when the power went is no loss.
                Err(_) if line == Line::Cut => {}
                Err(error) => return Some(Err(error)),
                Ok((mut row, last)) => {
                    self.spelling.learn(last);
                    let before = self.previous.replace(row.values);
                    row.repeated = before.is_some_and(|before| before[1..8] == row.values[1..8]);
                    return Some(Ok(row));
                }
            }
        }
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
        let mut texts = split(text, self.separator);
        let expected = self.fields.len();
        // A separator after the last field is no field.
        if texts.len() == expected + 1 && texts.last().is_some_and(|last| last.is_empty()) {
            texts.pop();
        }
        let found = texts.len();
        if found != expected {
            let places = self.fields.iter().flatten().count();
            // A whole number has none.
            let commas = expected + places / 2..=expected + places;
            let problem = if self.separator == ',' && commas.contains(&found) {
                LogProblem::DecimalComma { found, expected }
            } else {
                LogProblem::FieldCount { found, expected }
            };
            return Err(self.error(problem));
        }
        let mut values = [0.0; 9];
        values[COLUMNS.len()] = f64::NAN;
        for (text, place) in texts.iter().zip(&self.fields) {
            let Some(place) = *place else { continue };
            let column = name_of(place);
            if place == COLUMNS.len() && NOTHING.iter().any(|nothing| text.eq_ignore_ascii_case(nothing)) {
                continue;
            }
            let value = number(text, self.separator).ok_or_else(|| {
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
        Ok((
            RawRow {
                line: self.line,
                values,
                repeated: false,
            },
            Spelling::of(texts.last().copied().unwrap_or_default()),
        ))
    }

    /// Reads rows ahead, and finds the times of the first of them.
    fn look_ahead(&mut self) {
        while !self.ended && self.ahead.len() < WINDOW {
            match self.read_row() {
                None => self.ended = true,
                Some(Ok(row)) => self.ahead.push_back(row),
                Some(Err(error)) => {
                    self.ended = true;
                    self.failed = Some(error);
                }
            }
        }
        let first = self.clock.interval().is_none();
        let (lines, stamps): (Vec<_>, Vec<_>) = self
            .ahead
            .iter()
            .map(|row| {
                let stamp = Stamp {
                    t_s: row.values[0],
                    encoder: row.values[7],
                    repeated: row.repeated,
                };
                (row.line, stamp)
            })
            .unzip();
        let plan = self.clock.plan(&stamps, &lines, self.ended);
        if let Some((stuck, previous)) = plan.stuck {
            self.ended = true;
            self.failed = Some(LogError {
                file: self.file.clone(),
                at: Some(Place::Line(lines[stuck])),
                problem: LogProblem::Time {
                    previous,
                    now: stamps[stuck].t_s,
                },
            });
            self.ahead.truncate(stuck);
        }
        self.ahead.drain(..plan.skip);
        self.times.extend(plan.rows);
        if self.ended && self.times.is_empty() {
            let problem = if self.ahead.is_empty() {
                LogProblem::NoRows
            } else {
                LogProblem::SingleRow
            };
            if first && self.failed.is_none() {
                self.failed = Some(self.error(problem));
            }
            self.ahead.clear();
        }
    }

    fn row(row: &RawRow, when: When) -> LogRow {
        let [_, wx, wy, wz, fx, fy, fz, encoder, temperature] = row.values;
        LogRow {
            at: Place::Line(row.line),
            t_s: when.t_s,
            dt_s: when.dt_s,
            w_is_s: Vec3::new(wx, wy, wz),
            f_is_s: Vec3::new(fx, fy, fz),
            encoder,
            temperature_c: Some(temperature).filter(|t| t.is_finite()),
            gap: when.gap,
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

/// The fields of a line. Between quotes a separator is text; a blank separates in any number.
fn split(text: &str, separator: char) -> Vec<&str> {
    let mut quoted = false;
    let blank = separator == ' ';
    let ends = |c: char| {
        quoted ^= c == '"';
        !quoted && (c == separator || (blank && c.is_whitespace()))
    };
    let fields = text.split(ends).map(field);
    if blank {
        fields.filter(|field| !field.is_empty()).collect()
    } else {
        fields.collect()
    }
}

/// A finite number; with a decimal comma where that is not what separates.
fn number(text: &str, separator: char) -> Option<f64> {
    let plain = text.parse::<f64>().ok();
    let value = plain.or_else(|| {
        let comma = separator != ',' || text.matches(',').count() == 1;
        (comma && !text.contains('.')).then(|| text.replacen(',', ".", 1).parse().ok())?
    });
    value.filter(|value| value.is_finite())
}

/// What separates the fields of a header, and which columns they are: by whichever the most are known.
fn columns(text: &str) -> (char, Vec<Option<usize>>) {
    let names = |separator| -> Vec<Option<usize>> {
        split(text, separator)
            .iter()
            .map(|name| (0..=COLUMNS.len()).find(|place| name_of(*place).eq_ignore_ascii_case(name)))
            .collect()
    };
    let known = |separator: &char| names(*separator).iter().flatten().count();
    let blank = known(&' ');
    // The first of those that are as good.
    let best = SEPARATORS.into_iter().rev().max_by_key(known).unwrap_or(',');
    let separator = if blank > known(&best) { ' ' } else { best };
    (separator, names(separator))
}

impl<R: BufRead> Iterator for Reader<R> {
    type Item = Result<LogRow, LogError>;

    fn next(&mut self) -> Option<Self::Item> {
        while self.times.is_empty() && !(self.ended && self.ahead.is_empty()) {
            self.look_ahead();
        }
        match (self.times.pop_front(), self.ahead.pop_front()) {
            (Some(when), Some(row)) => Some(Ok(Self::row(&row, when))),
            _ => self.failed.take().map(Err),
        }
    }
}
