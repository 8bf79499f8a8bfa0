//! Whether the figures of a log can be true: units, signs, an encoder that turns, sensors that live.
//!
//! What makes every result wrong is an error, what makes it worse is a warning. A verdict falls at the end of a
//! window, so that one odd row decides nothing: accelerometers over [`UNIT_WINDOW`], gyro z against the encoder over
//! each [`ROTOR_WINDOW`].

use frames::math::wrap_pi;

use super::{COLUMNS, LogError, LogProblem, LogRow, Lost, Place};

/// Time over which the accelerometers' mean norm is taken, s.
const UNIT_WINDOW: f64 = 2.0;
/// Time over which gyro z and encoder are compared, s.
const ROTOR_WINDOW: f64 = 10.0;
/// Encoders that move less in a window stand still, rad.
const STILL: f64 = 0.05;
/// What gyro z must have turned in a window for a still encoder to be called stuck, rad. A swing of 10° turns by less
/// than 0.35.
const TURNED: f64 = 0.6;
/// Slower than this the rotor rests, rad/s.
const SLOW: f64 = 0.02;
/// No rotor of this kind turns faster, rad/s (460 °/s); in degrees it is 8 °/s.
const FAST: f64 = 8.0;
/// Degrees in a radian.
const DEGREES: f64 = 180.0 / core::f64::consts::PI;

/// Equal values in a row that make a live channel saturated or frozen.
const STUCK_ROWS: u32 = 10;
/// A channel is live where so many of its last rows (of about 64) changed.
const LIVE: f64 = 0.8;
const LIVE_GAIN: f64 = 1.0 / 64.0;
/// The step into a run of equal values must be so many times the smallest ever seen: at the crest of a slow swing a
/// coarse sensor repeats itself too, but enters by one count.
const STUCK_STEP: f64 = 3.0;

/// Ranges of the mean norm of the accelerometers with the unit they betray, and the factor to m/s².
const ACCEL_UNITS: [(f64, f64, &str, f64); 4] = [
    (0.8, 1.2, "g", 9.80665),
    (29.0, 35.0, "ft/s²", 0.3048),
    (900.0, 990.0, "cm/s²", 0.01),
    (990.0, 1100.0, "mg", 0.00980665),
];
/// Gravity lies between these where the base moves as bases do, m/s².
const GRAVITY: core::ops::RangeInclusive<f64> = 8.3..=11.3;

/// What is doubtful in a log.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum WarningKind {
    /// Rows are missing.
    Gaps {
        /// Number of gaps.
        count: u64,
        /// Rows missing in all.
        missing: u64,
        /// The longest interval, s.
        longest_s: f64,
    },
    /// Channels that repeat one value, which need not be wrong for a coarse sensor on a quiet base.
    Stuck {
        /// The column.
        column: &'static str,
        /// The value that was repeated first.
        value: f64,
        /// Times it happened.
        count: u64,
        /// Whether it was the largest seen.
        saturated: bool,
    },
    /// Gyro z does not follow the encoder: their ratio.
    Mismatch(f64),
    /// Of a recording, something is lost or of no use.
    Lost {
        /// What.
        kind: Lost,
        /// How many.
        count: u64,
    },
}

/// One line about a log that can be used: `file:line: what is doubtful`.
#[derive(Debug, Clone, PartialEq)]
pub struct LogWarning {
    /// The file's name as it was given.
    pub file: String,
    /// Where it was first seen.
    pub at: Place,
    /// What is doubtful.
    pub kind: WarningKind,
}

impl core::fmt::Display for LogWarning {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        write!(f, "{}:{}: ", self.file, self.at)?;
        match self.kind {
            WarningKind::Gaps {
                count,
                missing,
                longest_s,
            } => write!(
                f,
                "{count} {} with {missing} {} missing, the longest {longest_s:.3} s; the first is here",
                if count == 1 { "gap" } else { "gaps" },
                if missing == 1 { "row" } else { "rows" },
            ),
            WarningKind::Stuck {
                column,
                value,
                count,
                saturated,
            } => {
                let what = if saturated { "saturated" } else { "repeats" };
                write!(
                    f,
                    "{column}: {what} at {value}, {count} times in the log; the first is here"
                )
            }
            WarningKind::Lost { kind, count } => {
                kind.describe(count, f)?;
                f.write_str(if count == 1 { ", here" } else { "; the first is here" })
            }
            WarningKind::Mismatch(ratio) => write!(
                f,
                "gyro_z_rad_s is {ratio:.2} times the encoder's rate over {ROTOR_WINDOW} s from here: one of them is \
                 wrong, or the base turned"
            ),
        }
    }
}

/// One of the six inertial channels.
#[derive(Debug, Clone, Copy)]
struct Channel {
    last: f64,
    /// Equal values after the first.
    run: u32,
    run_at: Place,
    run_start_s: f64,
    /// Part of the recent rows that changed, now and before the run.
    live: f64,
    live_before: f64,
    /// The step into the run, and the smallest step seen.
    step: f64,
    least_step: f64,
    largest: f64,
}

impl Channel {
    const fn new() -> Self {
        Self {
            last: f64::NAN,
            run: 0,
            run_at: Place::Line(0),
            run_start_s: 0.0,
            live: 0.0,
            live_before: 0.0,
            step: 0.0,
            least_step: f64::INFINITY,
            largest: 0.0,
        }
    }

    /// Takes a value; says where a run of equal ones has just become suspicious, and whether surely so.
    fn push(&mut self, value: f64, at: Place, t_s: f64) -> Option<bool> {
        let changed = value != self.last;
        let live = self.live;
        self.live += LIVE_GAIN * (f64::from(u8::from(changed)) - live);
        if changed {
            self.step = (value - self.last).abs();
            if self.step > 0.0 {
                self.least_step = self.least_step.min(self.step);
            }
            self.largest = self.largest.max(value.abs());
            self.last = value;
            self.run = 0;
            self.run_at = at;
            self.run_start_s = t_s;
            self.live_before = self.live;
            return None;
        }
        self.run = self.run.saturating_add(1);
        if self.live_before < LIVE {
            return None;
        }
        let sure = self.step > STUCK_STEP * self.least_step;
        // Once a run: the live part is spent with the verdict.
        let verdict = if sure && self.run >= STUCK_ROWS {
            Some(true)
        } else if self.run >= STUCK_ROWS && t_s - self.run_start_s >= 1.0 {
            Some(false)
        } else {
            None
        };
        if verdict.is_some() {
            self.live_before = 0.0;
        }
        verdict
    }

    fn saturated(&self) -> bool {
        self.last.abs() >= self.largest
    }
}

/// Gyro z and encoder over one window.
#[derive(Debug, Clone, Copy)]
struct RotorWindow {
    start_s: f64,
    at: Place,
    lowest: f64,
    highest: f64,
    /// ∫ω_z sign α̇ dt, ∫ω_z dt, ∫|α̇| dt.
    along: f64,
    gyro: f64,
    path: f64,
    /// Time, and the part of it the rotor turned, s.
    time: f64,
    turning: f64,
}

impl RotorWindow {
    fn new(row: &LogRow) -> Self {
        Self {
            start_s: row.t_s,
            at: row.at,
            lowest: row.encoder,
            highest: row.encoder,
            along: 0.0,
            gyro: 0.0,
            path: 0.0,
            time: 0.0,
            turning: 0.0,
        }
    }

    fn push(&mut self, row: &LogRow, previous: &LogRow) {
        self.lowest = self.lowest.min(row.encoder);
        self.highest = self.highest.max(row.encoder);
        // An absolute encoder may wrap; one in degrees goes less than half a turn of radians from row to row.
        let turned = wrap_pi(row.encoder - previous.encoder);
        let (gyro, rate) = (row.w_is_s.z(), turned / row.dt_s);
        self.gyro += gyro * row.dt_s;
        self.path += turned.abs();
        self.time += row.dt_s;
        if rate.abs() > SLOW {
            self.along += gyro * row.dt_s * rate.signum();
            self.turning += row.dt_s;
        }
    }

    fn still(&self) -> bool {
        self.highest - self.lowest < STILL
    }
}

/// Judges a log as it goes by.
#[derive(Debug, Clone)]
pub struct Checker {
    file: String,
    first: Option<LogRow>,
    previous: Option<LogRow>,
    rows: u64,
    /// Sum of the accelerometers' norms; `None` after the verdict.
    norms: Option<(f64, u64)>,
    channels: [Channel; 6],
    window: Option<RotorWindow>,
    judged: bool,
    turned: bool,
    warnings: Vec<LogWarning>,
}

impl Checker {
    /// For the file of this name.
    pub fn new(file_name: &str) -> Self {
        Self {
            file: file_name.to_owned(),
            first: None,
            previous: None,
            rows: 0,
            norms: Some((0.0, 0)),
            channels: [Channel::new(); 6],
            window: None,
            judged: false,
            turned: false,
            warnings: Vec::new(),
        }
    }

    /// What is doubtful so far.
    pub fn warnings(&self) -> &[LogWarning] {
        &self.warnings
    }

    fn error(&self, at: Place, problem: LogProblem) -> LogError {
        LogError {
            file: self.file.clone(),
            at: Some(at),
            problem,
        }
    }

    /// Takes the next row.
    ///
    /// # Errors
    /// [`LogError`] where no result from this log could be right.
    pub fn push(&mut self, row: &LogRow) -> Result<(), LogError> {
        self.rows += 1;
        let first = *self.first.get_or_insert(*row);
        let previous = self.previous.replace(*row);
        if self.rows == 1 && !(5e-5..=0.2).contains(&row.dt_s) {
            return Err(self.error(row.at, LogProblem::TimeStep(row.dt_s)));
        }
        self.note_gap(row);
        self.judge_channels(row)?;

        if let Some((sum, count)) = &mut self.norms {
            *sum += row.f_is_s.norm();
            *count += 1;
        }
        if row.t_s - first.t_s >= UNIT_WINDOW {
            self.judge_accelerometers(first.at)?;
        }

        let window = self.window.get_or_insert_with(|| RotorWindow::new(row));
        if let Some(previous) = previous
            && row.gap.is_none()
        {
            window.push(row, &previous);
        }
        if row.t_s - window.start_s >= ROTOR_WINDOW {
            let window = *window;
            self.window = Some(RotorWindow::new(row));
            self.judge_rotor(&window)?;
        }
        Ok(())
    }

    /// Ends the log.
    ///
    /// # Errors
    /// [`LogError`] where no result from this log could be right.
    pub fn finish(mut self) -> Result<Vec<LogWarning>, LogError> {
        let (Some(first), Some(last)) = (self.first, self.previous) else {
            return Err(LogError {
                file: self.file,
                at: None,
                problem: LogProblem::NoRows,
            });
        };
        self.judge_accelerometers(first.at)?;
        // A rest of a window tells little; but a short log has nothing else.
        if let Some(window) = self.window.filter(|window| !self.judged && window.time >= 1.0) {
            self.judge_rotor(&window)?;
        }
        if !self.turned {
            return Err(self.error(last.at, LogProblem::NoRotation));
        }
        Ok(self.warnings)
    }

    fn note_gap(&mut self, row: &LogRow) {
        let Some(gap) = row.gap else { return };
        for warning in &mut self.warnings {
            if let WarningKind::Gaps {
                count,
                missing,
                longest_s,
            } = &mut warning.kind
            {
                *count += 1;
                // A clock that leaps makes gaps of any length.
                *missing = missing.saturating_add(gap.missing);
                *longest_s = longest_s.max(row.dt_s);
                return;
            }
        }
        self.warnings.push(LogWarning {
            file: self.file.clone(),
            at: row.at,
            kind: WarningKind::Gaps {
                count: 1,
                missing: gap.missing,
                longest_s: row.dt_s,
            },
        });
    }

    fn judge_channels(&mut self, row: &LogRow) -> Result<(), LogError> {
        let values = row.w_is_s.to_array().into_iter().chain(row.f_is_s.to_array());
        for (i, value) in values.enumerate() {
            let Some(sure) = self.channels[i].push(value, row.at, row.t_s) else {
                continue;
            };
            let (channel, column) = (self.channels[i], COLUMNS[i + 1]);
            let saturated = channel.saturated();
            if sure && i < 3 {
                return Err(self.error(
                    channel.run_at,
                    LogProblem::GyroStuck {
                        column,
                        value,
                        saturated,
                    },
                ));
            }
            let known = self.warnings.iter_mut().find_map(|warning| match &mut warning.kind {
                WarningKind::Stuck { column: c, count, .. } if *c == column => Some(count),
                _ => None,
            });
            match known {
                Some(count) => *count += 1,
                None => self.warnings.push(LogWarning {
                    file: self.file.clone(),
                    at: channel.run_at,
                    kind: WarningKind::Stuck {
                        column,
                        value,
                        count: 1,
                        saturated: sure && saturated,
                    },
                }),
            }
        }
        Ok(())
    }

    fn judge_accelerometers(&mut self, at: Place) -> Result<(), LogError> {
        let Some((sum, count)) = self.norms.take() else {
            return Ok(());
        };
        let mean = sum / count as f64;
        if GRAVITY.contains(&mean) {
            return Ok(());
        }
        let unit = ACCEL_UNITS.iter().find(|(low, high, ..)| (*low..*high).contains(&mean));
        Err(self.error(
            at,
            match unit {
                Some((_, _, unit, factor)) => LogProblem::AccelUnit {
                    mean,
                    unit,
                    factor: *factor,
                },
                None => LogProblem::AccelNorm(mean),
            },
        ))
    }

    fn judge_rotor(&mut self, window: &RotorWindow) -> Result<(), LogError> {
        self.judged = true;
        if window.time <= 0.0 {
            return Ok(());
        }
        let at = window.at;
        if window.still() {
            // At rest with the rotor at rest: a unit may start so.
            if window.gyro.abs() > TURNED {
                return Err(self.error(
                    at,
                    LogProblem::EncoderStuck {
                        at: window.highest,
                        turned: window.gyro,
                        seconds: window.time,
                    },
                ));
            }
            return Ok(());
        }
        self.turned = true;
        let rate = window.path / window.time;
        if rate > FAST {
            return Err(self.error(at, LogProblem::EncoderDegrees(rate)));
        }
        if window.turning < 0.5 * window.time {
            return Ok(());
        }
        // What the base turns besides averages out, and one glitch of the encoder counts for no more than its size.
        let ratio = window.along / window.path;
        let near = |expected: f64| (ratio / expected - 1.0).abs() < 0.3;
        if near(DEGREES) || near(-DEGREES) {
            Err(self.error(at, LogProblem::GyroDegrees(ratio)))
        } else if near(1.0 / DEGREES) || near(-1.0 / DEGREES) {
            Err(self.error(at, LogProblem::EncoderDegrees(rate)))
        } else if near(-1.0) {
            Err(self.error(at, LogProblem::Opposite))
        } else {
            let noted = self.warnings.iter().any(|w| matches!(w.kind, WarningKind::Mismatch(_)));
            if !(0.5..=2.0).contains(&ratio) && !noted {
                self.warnings.push(LogWarning {
                    file: self.file.clone(),
                    at,
                    kind: WarningKind::Mismatch(ratio),
                });
            }
            Ok(())
        }
    }
}
