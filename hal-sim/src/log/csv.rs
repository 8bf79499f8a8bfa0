//! The reader of CSV.

use std::collections::VecDeque;
use std::io::{self, BufRead};

use frames::Vec3;

use super::format::{Column, Format, NANOSECONDS, PLACES, TimeKind, Wraps, fits};
use super::time::{Clock, Stamp, WINDOW, When};
use super::{COLUMNS, LIMITS, LogError, LogProblem, LogRow, LogWarning, MAX_LINE, Place, WarningKind, shorten};
use crate::nmea;

/// What may stand between the fields, besides blanks.
const SEPARATORS: [char; 4] = [',', ';', '\t', '|'];
/// Words for no value in a column that a log need not have.
const NOTHING: [&str; 6] = ["", "nan", "na", "n/a", "null", "-"];

/// What a comment begins with.
const COMMENTS: [&str; 3] = ["#", "%", "//"];
/// Lines that may stand before the header, or the first row, of a format.
const PREAMBLE: u64 = 1000;
/// Place of the temperature, which a row need not have.
const TEMPERATURE: usize = COLUMNS.len();
/// Length of a day, s.
const DAY: f64 = 86_400.0;

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

/// What is known of the times of a format so far.
#[derive(Debug, Clone, Copy, Default)]
struct Stamps {
    /// Of the first row: the stamp, and the nanoseconds beside it.
    first: [Option<Stamped>; 2],
    /// What was counted before a counter began anew, and its last count, both from the first row.
    turns: f64,
    last: f64,
    /// The sum of intervals, s.
    elapsed: f64,
    rows: u64,
}

/// A stamp of the first row. Whole ones have more digits than an f64.
#[derive(Debug, Clone, Copy)]
struct Stamped {
    value: f64,
    whole: Option<i64>,
}

impl Stamps {
    /// How much a stamp is more than that of the first row; `None` where it is no number.
    fn since(&mut self, part: usize, text: &str, separator: char) -> Option<f64> {
        let now = Stamped {
            value: number(text, separator)?,
            whole: text.parse().ok(),
        };
        let first = *self.first[part].get_or_insert(now);
        Some(match (now.whole, first.whole) {
            (Some(now), Some(first)) => now.checked_sub(first)? as f64,
            _ => now.value - first.value,
        })
    }

    /// As [`Self::since`], of a count that begins anew at one of `wraps`: at the one that lets it go on by the least.
    fn unwrapped(&mut self, count: f64, wraps: Wraps) -> f64 {
        let back = self.last - count;
        let within = |wrap: &f64| back > 0.5 * wrap && back <= *wrap;
        if let Some(wrap) = wraps.iter().flatten().find(|wrap| within(wrap)) {
            self.turns += wrap;
        }
        self.last = count;
        self.turns + count
    }

    /// The next row's time, s from the first row; `None` where it is no number.
    fn next(&mut self, kind: TimeKind, text: &str, separator: char) -> Option<f64> {
        self.rows += 1;
        match kind {
            TimeKind::Own => number(text, separator),
            TimeKind::Stamp { unit, wraps } => {
                let count = self.since(0, text, separator)?;
                Some(self.unwrapped(count, wraps) * unit)
            }
            TimeKind::Interval { unit } => {
                self.elapsed += number(text, separator)? * unit;
                Some(self.elapsed)
            }
            TimeKind::Clock => {
                let now = clock(text)?;
                let first = self.first[0].get_or_insert(Stamped {
                    value: now,
                    whole: None,
                });
                let count = now - first.value;
                Some(self.unwrapped(count, [Some(DAY), None]))
            }
            TimeKind::Rows { interval } => Some(self.rows as f64 * interval),
        }
    }
}

/// Seconds of a day: `HH:MM:SS.sss`, also after a date and a `T` or a blank, and before a `Z`.
fn clock(text: &str) -> Option<f64> {
    let time = text.rsplit(['T', ' ']).next()?.trim_end_matches('Z');
    let mut parts = time.splitn(3, ':');
    let mut part = |most: f64| {
        let value: f64 = parts.next()?.replacen(',', ".", 1).parse().ok()?;
        (0.0..most).contains(&value).then_some(value)
    };
    Some(3600.0 * part(24.0)? + 60.0 * part(60.0)? + part(61.0)?)
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
    /// What the columns are.
    format: Format,
    stamps: Stamps,
    /// For each field of a row, its place in the format; `None` for columns that are ignored.
    fields: Vec<Option<usize>>,
    /// How the line in the buffer ended, where it is yet to be read as a row.
    held: Option<Line>,
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
    pub(super) fn new(input: R, file_name: &str, format: &Format) -> Result<Self, LogError> {
        let mut reader = Self {
            input,
            file: file_name.to_owned(),
            line: 0,
            buffer: Vec::with_capacity(256),
            format: format.clone(),
            stamps: Stamps::default(),
            fields: Vec::new(),
            held: None,
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
        if format.time == (TimeKind::Rows { interval: 0.0 }) {
            return Err(reader.error(LogProblem::NoRate));
        }
        if format.is_by_number() {
            reader.first_row()?;
        } else {
            reader.header()?;
        }
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
        self.fields.contains(&Some(TEMPERATURE))
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
            let text = self.buffer.trim_ascii_start();
            let comment = COMMENTS.iter().any(|comment| text.starts_with(comment.as_bytes()));
            if ended == Line::End || !(text.is_empty() || (comment && !self.fields.is_empty())) {
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
        // Of the line of a format that lacks the fewest columns.
        let mut nearest: Option<LogError> = None;
        let mut fewest = usize::MAX;
        loop {
            if matches!(self.read_line()?, Line::End) || self.line > PREAMBLE {
                if let Some(nearest) = nearest {
                    return Err(nearest);
                }
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
            let comment = COMMENTS
                .iter()
                .find_map(|comment| text.trim_start().strip_prefix(comment));
            let (separator, fields) = columns(comment.unwrap_or(text), &self.format);
            let count = |place| fields.iter().filter(|found| **found == Some(place)).count();
            let missing: Vec<_> = self.required().filter(|place| count(*place) == 0).collect();
            if comment.is_some() && !missing.is_empty() {
                comments = true;
                continue;
            }
            let own = self.format.time == TimeKind::Own;
            let begins_with_number = split(text, separator)
                .first()
                .is_some_and(|first| number(first, separator).is_some());
            if own && begins_with_number {
                return Err(self.error(LogProblem::NoHeader));
            }
            if let Some(place) = (0..PLACES).find(|place| count(*place) > 1) {
                return Err(self.error(LogProblem::DuplicateColumn(self.format.name(place))));
            }
            if !missing.is_empty() {
                let lacking = missing.len();
                let names = missing.into_iter().map(|place| self.format.name(place)).collect();
                let error = self.error(LogProblem::MissingColumns(names));
                // Other programs write more than one line before their rows.
                if own {
                    return Err(error);
                }
                if lacking < fewest {
                    (nearest, fewest) = (Some(error), lacking);
                }
                continue;
            }
            self.separator = separator;
            self.fields = fields;
            return Ok(());
        }
    }

    /// The places that each row must have.
    fn required(&self) -> impl Iterator<Item = usize> {
        let columns = &self.format.columns;
        (0..PLACES).filter(|place| *place != TEMPERATURE && columns[*place].is_some())
    }

    /// Goes to the first line that has numbers in all columns of a format that tells them by number.
    fn first_row(&mut self) -> Result<(), LogError> {
        loop {
            let line = self.read_line()?;
            if line == Line::End || self.line > PREAMBLE {
                let names: Vec<_> = self.required().map(|place| self.format.name(place)).collect();
                let problem = if self.line == 0 {
                    LogProblem::Empty
                } else {
                    LogProblem::NoNumbers(names.join(", "))
                };
                self.line = 0;
                return Err(self.error(problem));
            }
            let text = match self.row_text() {
                Ok(Some(text)) => text,
                Ok(None) => continue,
                // Where rows are sentences, the first of them counts.
                Err(error) if self.format.row.is_some() => return Err(error),
                Err(_) => continue,
            };
            let of_number = |fields: usize| -> Vec<Option<usize>> {
                let places = (0..fields).map(|field| {
                    let is = |column: &Option<Column>| *column == Some(Column::Number(field + 1));
                    self.format.columns.iter().position(is)
                });
                places.collect()
            };
            // By whatever separates the most fields, all of them numbers that have to be.
            let candidates = SEPARATORS.into_iter().chain([' ']).filter_map(|separator| {
                let texts = split(text, separator);
                let fields = of_number(texts.len());
                let is_number = |place: &usize| match (place, self.format.time) {
                    (0, TimeKind::Clock) => texts
                        .iter()
                        .zip(&fields)
                        .any(|(text, at)| *at == Some(0) && clock(text).is_some()),
                    _ => texts
                        .iter()
                        .zip(&fields)
                        .any(|(text, at)| *at == Some(*place) && number(text, separator).is_some()),
                };
                self.required()
                    .all(|place| is_number(&place))
                    .then_some((separator, fields))
            });
            // The first of those that are as good.
            let best = candidates.reduce(|best, next| if next.1.len() > best.1.len() { next } else { best });
            if let Some((separator, fields)) = best {
                self.separator = separator;
                self.fields = fields;
                self.held = Some(line);
                return Ok(());
            }
        }
    }

    /// The line as a row; `None` where it is another one than those the format tells.
    fn row_text(&self) -> Result<Option<&str>, LogError> {
        let text = self.text()?;
        let Some(wanted) = &self.format.row else {
            return Ok(Some(text));
        };
        let is_wanted = |text: &str| {
            let rest = text.strip_prefix(wanted.as_str());
            rest.is_some_and(|rest| !rest.starts_with(|c: char| c.is_alphanumeric()))
        };
        if !is_wanted(text.trim_start()) {
            return Ok(None);
        }
        if !wanted.starts_with('$') {
            return Ok(Some(text));
        }
        nmea::body(text.trim())
            .map(Some)
            .map_err(|_| self.error(LogProblem::CheckSum))
    }

    fn read_row(&mut self) -> Option<Result<RawRow, LogError>> {
        loop {
            let line = match self.held.take().map_or_else(|| self.read_line(), Ok) {
                Ok(Line::End) => return None,
                Ok(line) => line,
                Err(error) => return Some(Err(error)),
            };
            let whole = line == Line::Complete;
            let parsed = match self.parse_row() {
                Ok(None) => continue,
                Ok(Some((.., last))) if !whole && !self.spelling.allows(last) => Err(self.error(LogProblem::Truncated)),
                Err(error) if !whole && self.is_cut(&error.problem) => Err(self.error(LogProblem::Truncated)),
                Ok(Some(parsed)) => Ok(parsed),
                Err(error) => Err(error),
            };
            match parsed {
                // The row that was being written when the power went is no loss.
                Err(_) if line == Line::Cut => {}
                Err(error) => return Some(Err(error)),
                Ok((mut row, stamps, last)) => {
                    self.stamps = stamps;
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
            LogProblem::FieldCount { found, expected } | LogProblem::RowLength { found, expected } => found < expected,
            LogProblem::CheckSum => true,
            LogProblem::NotText(byte) => *byte + 3 >= self.buffer.len(),
            LogProblem::NotANumber { column, text } => {
                let last = self.fields.last().copied().flatten();
                last.is_some_and(|place| self.format.name(place) == *column) && text.parse::<f64>().is_err()
            }
            _ => false,
        }
    }

    /// The row, what is then known of the times, and how its last number is written; `None` where it is no row.
    fn parse_row(&self) -> Result<Option<(RawRow, Stamps, Spelling)>, LogError> {
        let Some(text) = self.row_text()? else {
            return Ok(None);
        };
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
            let problem = if self.format.is_by_number() {
                LogProblem::RowLength { found, expected }
            } else if self.separator == ',' && commas.contains(&found) {
                LogProblem::DecimalComma { found, expected }
            } else {
                LogProblem::FieldCount { found, expected }
            };
            return Err(self.error(problem));
        }
        let mut stamps = self.stamps;
        let mut values = [0.0; 9];
        values[TEMPERATURE] = f64::NAN;
        if let TimeKind::Rows { .. } = self.format.time {
            values[0] = stamps.next(self.format.time, "", self.separator).unwrap_or_default();
        }
        let mut beside = 0.0;
        for (text, place) in texts.iter().zip(&self.fields) {
            let Some(place) = *place else { continue };
            if place == TEMPERATURE && NOTHING.iter().any(|nothing| text.eq_ignore_ascii_case(nothing)) {
                continue;
            }
            let value = match place {
                0 => stamps.next(self.format.time, text, self.separator),
                NANOSECONDS => stamps.since(1, text, self.separator).map(|count| count * 1e-9),
                _ => number(text, self.separator),
            };
            let value = value.ok_or_else(|| {
                self.error(LogProblem::NotANumber {
                    column: self.format.name(place),
                    text: shorten(text),
                })
            })?;
            match values.get_mut(place) {
                Some(at) => *at = value,
                None => beside = value,
            }
        }
        values[0] += beside;
        let values = self.format.converted(values);
        self.within_limits(&values).map_err(|problem| self.error(problem))?;
        let row = RawRow {
            line: self.line,
            values,
            repeated: false,
        };
        Ok(Some((
            row,
            stamps,
            Spelling::of(texts.last().copied().unwrap_or_default()),
        )))
    }

    /// That no figure is beyond any sensor. No temperature is not a number.
    fn within_limits(&self, values: &[f64; 9]) -> Result<(), LogProblem> {
        let beyond = |place: usize| {
            let none = place == TEMPERATURE && values[place].is_nan();
            !none && !(0.0..=LIMITS[place]).contains(&values[place].abs())
        };
        (0..values.len()).find(|place| beyond(*place)).map_or(Ok(()), |place| {
            Err(LogProblem::TooLarge {
                column: self.format.name(place),
                value: values[place],
            })
        })
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

    fn row(&self, row: &RawRow, when: When) -> Result<LogRow, LogError> {
        let mut values = row.values;
        // Increments are those of the row's own interval.
        let dt_s = when.gap.map_or(when.dt_s, |gap| gap.nominal_dt_s);
        for (scale, places) in [(self.format.gyro, 1..4), (self.format.accel, 4..7)] {
            if scale.increments {
                values[places].iter_mut().for_each(|value| *value /= dt_s);
            }
        }
        let at = Place::Line(row.line);
        self.within_limits(&values).map_err(|problem| LogError {
            file: self.file.clone(),
            at: Some(at),
            problem,
        })?;
        let [_, wx, wy, wz, fx, fy, fz, encoder, temperature] = values;
        Ok(LogRow {
            at,
            t_s: when.t_s,
            dt_s: when.dt_s,
            w_is_s: Vec3::new(wx, wy, wz),
            f_is_s: Vec3::new(fx, fy, fz),
            encoder,
            temperature_c: Some(temperature).filter(|t| t.is_finite()),
            gap: when.gap,
            taken: None,
        })
    }
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
fn columns(text: &str, format: &Format) -> (char, Vec<Option<usize>>) {
    let least = if format.time == TimeKind::Own { 2 } else { 1 };
    let places = |separator| -> Vec<Option<usize>> {
        let names = split(text, separator);
        let mut places = vec![None; names.len()];
        for (place, column) in format.columns.iter().enumerate() {
            match column {
                Some(Column::Name(wanted)) => {
                    let best = names
                        .iter()
                        .map(|name| fits(wanted, name))
                        .max()
                        .unwrap_or(0)
                        .max(least);
                    for (at, name) in places.iter_mut().zip(&names) {
                        if fits(wanted, name) == best {
                            *at = Some(place);
                        }
                    }
                }
                Some(Column::Number(number)) => {
                    if let Some(at) = places.get_mut(number - 1) {
                        *at = Some(place);
                    }
                }
                None => {}
            }
        }
        places
    };
    let known = |separator: &char| places(*separator).iter().flatten().count();
    let blank = known(&' ');
    // The first of those that are as good.
    let best = SEPARATORS.into_iter().rev().max_by_key(known).unwrap_or(',');
    let separator = if blank > known(&best) { ' ' } else { best };
    (separator, places(separator))
}

impl<R: BufRead> Iterator for Reader<R> {
    type Item = Result<LogRow, LogError>;

    fn next(&mut self) -> Option<Self::Item> {
        while self.times.is_empty() && !(self.ended && self.ahead.is_empty()) {
            self.look_ahead();
        }
        match (self.times.pop_front(), self.ahead.pop_front()) {
            (Some(when), Some(row)) => {
                let row = self.row(&row, when);
                if row.is_err() {
                    self.ended = true;
                    self.ahead.clear();
                    self.times.clear();
                    self.failed = None;
                }
                Some(row)
            }
            _ => self.failed.take().map(Err),
        }
    }
}
