//! Whether the figures of a log can be true: units, signs, an encoder that turns, sensors that live.
//!
//! What makes every result wrong is an error, what makes it worse is a warning. A verdict falls at the end of a
//! window, so that one odd row decides nothing: accelerometers over [`UNIT_WINDOW`], gyro z against the encoder over
//! each [`ROTOR_WINDOW`] and over the whole.

use frames::math::wrap_pi;
use nalgebra::{Matrix3, Vector3};

use super::delay::{DelayEstimator, ImuDelay};
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
/// Time over which the rows of a window are taken together, s: a coarse encoder has counted by then.
const BLOCK: f64 = 0.2;
/// Blocks in which the rotor turned less than this part of the fastest ones do not tell a ratio.
const SLOW: f64 = 0.2;
/// A step of the encoder so many times the usual one is a wrap, or a reading gone wrong.
const WRAP: f64 = 5.0;
/// Most rows of a window that are kept; at the highest rate they are a part of it.
const MOST_ROWS: usize = 1 << 17;
/// No base turns so fast that gyro z reads so many times the encoder's rate, or that part of it; in one window, and in two.
const GROSS: f64 = 5.0;
const LARGE: f64 = 2.0;
/// The same over the log, and over this time of turning at least, s.
const LOG_RATIO: f64 = 0.15;
const LOG_TURNING: f64 = 30.0;
/// Where the rotor goes to and fro the scale is known far better: no gyro is off by more than this part, which would turn
/// heading by degrees where it is the encoder's. How far it must go, rad; and the time in which a base forgets its yaw, s.
const SCALE: f64 = 0.015;
/// In less time more of the yaw is left, s.
const SCALE_TIME: f64 = 120.0;
const TO_AND_FRO: f64 = 1.0;
const YAW_TIME: f64 = 10.0;
/// Length of the blocks over which tilt by gyros and by accelerometers are compared, s; time it takes at least, s; and RMS of
/// what gravity moves in a block that tells, m/s²: 0.2 degrees.
const TILT_BLOCK: f64 = 0.5;
const TILT_TIME: f64 = 30.0;
const TILT_LEAST: f64 = 0.034;
/// Gravity, m/s².
const GRAVITY_Z: f64 = 9.8;
/// Ratios of two windows that are the same, as a part.
const SAME: f64 = 0.1;
/// Angles that are held may be this far behind on average, rad: a tenth of a degree goes into heading as it is.
const BEHIND: f64 = 1.75e-3;
/// An encoder may be so far behind gyro z, or ahead of it, rad: that goes into heading in full. So many times its 1σ it must be.
const LATE: f64 = 8.7e-3;
const LATE_SIGMAS: f64 = 6.0;
/// No rotor of this kind turns faster, rad/s (460 °/s); in degrees it is 8 °/s.
const FAST: f64 = 8.0;
/// No sensor reads more, rad/s; the aligner takes no more.
const ANY_RATE: f64 = nav::increment::MAX_RATE;
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
/// A value that is among the last rows so many times is one of the few of a coarse sensor: to repeat it for long is
/// quantisation, …
const USUAL: usize = 4;
/// … but for so many rows and so long, s.
const USUAL_ROWS: u32 = 200;
const USUAL_TIME: f64 = 2.0;
/// An axis points up where gravity on it is more than this part of the whole: it leans by less than 60 degrees.
const UPRIGHT: f64 = 0.5;

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
    /// The encoder never turned, and gyro z neither.
    Still,
    /// The stamps are off an even spacing: rows have been spaced anew.
    Jitter {
        /// Rows with such stamps.
        rows: u64,
        /// How far the worst is off, s.
        largest_s: f64,
        /// The interval of the rows, s.
        nominal_s: f64,
    },
    /// The log begins with rows whose times are not those of the rest: they are left out.
    Start {
        /// How many.
        rows: u64,
        /// Their mean interval, s.
        interval_s: f64,
        /// That of the rest, s.
        nominal_s: f64,
    },
    /// NUL bytes between or after the rows.
    Nul {
        /// How many.
        bytes: u64,
    },
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
            WarningKind::Still => f.write_str(
                "encoder_rad never turned: with the rotor at rest gyro biases go into heading in full, and σ says how far",
            ),
            WarningKind::Jitter {
                rows,
                largest_s,
                nominal_s,
            } => write!(
                f,
                "t_s jitters: {rows} {} up to {:.2} ms off an even spacing of {:.4} ms, by which the rows are spaced anew; \
                 the first is here",
                if rows == 1 { "row" } else { "rows" },
                largest_s * 1e3,
                nominal_s * 1e3
            ),
            WarningKind::Start {
                rows,
                interval_s,
                nominal_s,
            } => write!(
                f,
                "t_s begins with {rows} rows {:.3} ms apart where the rest has {:.4} ms: they are left out",
                interval_s * 1e3,
                nominal_s * 1e3
            ),
            WarningKind::Nul { bytes } => write!(
                f,
                "{bytes} NUL bytes from here, as a power cut leaves them: the rows around them are used"
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
    /// The values before, each run of equal ones once.
    recent: [f64; 64],
    rows: usize,
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
            recent: [f64::NAN; 64],
            rows: 0,
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
            self.recent[self.rows % 64] = self.last;
            self.rows += 1;
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
        let usual = self.recent.iter().filter(|recent| **recent == value).count() >= USUAL;
        let sure = self.step > STUCK_STEP * self.least_step
            && (!usual || (self.run >= USUAL_ROWS && t_s - self.run_start_s >= USUAL_TIME));
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
#[derive(Debug, Clone)]
struct RotorWindow {
    start_s: f64,
    at: Place,
    lowest: f64,
    highest: f64,
    /// ∫ω_z dt, and the time, s.
    gyro: f64,
    time: f64,
    /// Of each row: how far the encoder went as it reads, what gyro z turned by, and the interval.
    rows: Vec<(f64, f64, f64)>,
}

/// What gyro z and encoder say of each other.
#[derive(Debug, Clone, Copy, Default)]
struct Turning {
    /// What gyro z turned by in the encoder's direction, and how far that went as it reads.
    along: f64,
    path: f64,
    /// Time of turning, s.
    time: f64,
}

impl Turning {
    fn ratio(&self) -> f64 {
        self.along / self.path
    }
}

impl RotorWindow {
    fn new(row: &LogRow) -> Self {
        Self {
            start_s: row.t_s,
            at: row.at,
            lowest: row.encoder,
            highest: row.encoder,
            gyro: 0.0,
            time: 0.0,
            rows: Vec::new(),
        }
    }

    fn push(&mut self, row: &LogRow, previous: &LogRow) {
        self.lowest = self.lowest.min(row.encoder);
        self.highest = self.highest.max(row.encoder);
        let gyro = row.w_is_s.z() * row.dt_s;
        self.gyro += gyro;
        self.time += row.dt_s;
        if self.rows.len() < MOST_ROWS {
            self.rows.push((row.encoder - previous.encoder, gyro, row.dt_s));
        }
    }

    fn still(&self) -> bool {
        self.highest - self.lowest < STILL
    }

    /// The largest step of the encoder that is no wrap.
    fn largest_step(&self) -> f64 {
        let mut steps: Vec<f64> = self
            .rows
            .iter()
            .map(|row| row.0.abs())
            .filter(|step| *step > 0.0)
            .collect();
        let most = steps.len() * 4 / 5;
        if most > 0 {
            steps.select_nth_unstable_by(most, f64::total_cmp);
        }
        let few = &steps[..most.max(1).min(steps.len())];
        WRAP * few.iter().sum::<f64>() / few.len().max(1) as f64
    }

    /// Gyro z against the encoder where the rotor turns. What the base turns besides averages out.
    fn turning(&self) -> Turning {
        let largest = self.largest_step();
        let mut blocks: Vec<(f64, f64, f64)> = Vec::new();
        let mut block = (0.0, 0.0, 0.0);
        for (step, gyro, dt) in &self.rows {
            if step.abs() > largest {
                continue;
            }
            block = (block.0 + step, block.1 + gyro, block.2 + dt);
            if block.2 >= BLOCK {
                blocks.push(block);
                block = (0.0, 0.0, 0.0);
            }
        }
        let mut speeds: Vec<f64> = blocks.iter().map(|block| block.0.abs() / block.2).collect();
        let fast = speeds.len() * 9 / 10;
        if speeds.is_empty() {
            return Turning::default();
        }
        let fast = *speeds.select_nth_unstable_by(fast, f64::total_cmp).1;
        blocks
            .iter()
            .filter(|block| block.0.abs() / block.2 > SLOW * fast)
            .fold(Turning::default(), |sum, block| Turning {
                along: sum.along + block.1 * block.0.signum(),
                path: sum.path + block.0.abs(),
                time: sum.time + block.2,
            })
    }

    /// For how many rows each angle is held, and how far that leaves it behind on average, rad. An encoder of few counts
    /// repeats itself as well; its steps are a turn over a power of two.
    fn held(&self) -> Option<(f64, f64)> {
        let largest = self.largest_step();
        let mut steps: Vec<f64> = Vec::new();
        // Rows since the encoder went on, and what gyro z turned by: at rest nothing is held.
        let (mut held, mut turned, mut rows) = (0, 0.0, 0);
        for (step, gyro, _) in &self.rows {
            held += 1;
            turned += gyro;
            if *step != 0.0 {
                if step.abs() <= largest && f64::abs(turned) > 0.3 * step.abs() {
                    steps.push(step.abs());
                    rows += held;
                }
                (held, turned) = (0, 0.0);
            }
        }
        if steps.is_empty() {
            return None;
        }
        let (path, changes) = (steps.iter().sum::<f64>(), steps.len() as f64);
        let middle = steps.len() / 2;
        let step = *steps.select_nth_unstable_by(middle, f64::total_cmp).1;
        let bits = (core::f64::consts::TAU / step).log2();
        let count = (bits - bits.round()).abs() < 0.005;
        let rows = f64::from(rows);
        let behind = 0.5 * (path / changes - path / rows);
        (rows > 1.6 * changes && behind > BEHIND && !count).then_some((rows / changes, behind))
    }
}

/// What gyro z turned by, as a constant, a drift, and a part of what the encoder did: by least squares over the log.
#[derive(Debug, Clone, Copy, Default)]
struct Scale {
    t: f64,
    alpha: f64,
    gyro: f64,
    normal: Matrix3<f64>,
    right: Vector3<f64>,
    squares: f64,
}

impl Scale {
    fn push(&mut self, row: &LogRow, previous: &LogRow) {
        self.t += row.dt_s;
        self.alpha += wrap_pi(row.encoder - previous.encoder);
        self.gyro += row.w_is_s.z() * row.dt_s;
        let g = Vector3::new(1.0, self.t, self.alpha);
        self.normal += g * g.transpose();
        self.right += g * self.gyro;
        self.squares += self.gyro * self.gyro;
    }

    /// The part, with its 1σ, or more: what is left is the yaw of the base, which mostly swings and averages out faster.
    /// `None` where the rotor does not go to and fro.
    fn fit(&self) -> Option<(f64, f64)> {
        let rows = self.normal[(0, 0)];
        let inverse = self.normal.try_inverse()?;
        let c = inverse * self.right;
        let left = ((self.squares - c.dot(&self.right)) / rows).max(0.0).sqrt();
        let to_and_fro = (inverse[(2, 2)] * rows).recip().sqrt();
        (to_and_fro > TO_AND_FRO).then(|| (c[2], left / to_and_fro / (self.t / YAW_TIME).max(1.0).sqrt()))
    }
}

/// The turn of the housing by the gyros against that by the accelerometers, which see gravity move: df/dt = −ω × f.
#[derive(Debug, Clone, Copy, Default)]
struct Gravity {
    /// Of this block: time, s, sum of f and rows, and ∫ω, x and y of the housing.
    time: f64,
    rows: f64,
    force: [f64; 2],
    angle: [f64; 2],
    /// Means of f and ∫ω of the blocks before: of the last, …
    before: Option<([f64; 2], [f64; 2])>,
    /// … and over the log: how f moved along what the gyros say, and how far they say it moved, squared; blocks.
    along: f64,
    square: f64,
    blocks: f64,
}

impl Gravity {
    fn push(&mut self, row: &LogRow) {
        let (sin, cos) = row.encoder.sin_cos();
        let level = |[x, y, _]: [f64; 3]| [cos * x - sin * y, sin * x + cos * y];
        let (force, rate) = (level(row.f_is_s.to_array()), level(row.w_is_s.to_array()));
        for k in 0..2 {
            self.force[k] += force[k];
            self.angle[k] += rate[k] * row.dt_s;
        }
        self.time += row.dt_s;
        self.rows += 1.0;
        if self.time < TILT_BLOCK {
            return;
        }
        let (force, angle) = (self.force.map(|f| f / self.rows), self.angle);
        if let Some((force_before, angle_before)) = self.before.filter(|_| self.time < 2.0 * TILT_BLOCK) {
            // Between the middles of the blocks; z of f is gravity's.
            let turned: [f64; 2] = core::array::from_fn(|k| 0.5 * (angle[k] + angle_before[k]));
            let expected = [-turned[1] * GRAVITY_Z, turned[0] * GRAVITY_Z];
            for k in 0..2 {
                self.along += expected[k] * (force[k] - force_before[k]);
                self.square += expected[k] * expected[k];
            }
            self.blocks += 1.0;
        }
        *self = Self {
            before: Some((force, angle)),
            along: self.along,
            square: self.square,
            blocks: self.blocks,
            ..Self::default()
        };
    }

    /// Whether gravity moves the other way than the gyros say, on a base that swings enough to tell.
    fn is_reversed(&self) -> bool {
        let moved = (self.square / self.blocks).sqrt();
        self.blocks * TILT_BLOCK > TILT_TIME && moved > TILT_LEAST && self.along < -0.5 * self.square
    }
}

/// Judges a log as it goes by.
#[derive(Debug, Clone)]
pub struct Checker {
    file: String,
    first: Option<LogRow>,
    previous: Option<LogRow>,
    rows: u64,
    /// Sums of the accelerometers' norms and z; `None` after the verdict.
    norms: Option<(f64, f64, u64)>,
    /// Rows with rates beyond any sensor, and the largest rate.
    beyond: (u64, f64),
    channels: [Channel; 6],
    window: Option<RotorWindow>,
    judged: bool,
    turned: bool,
    /// The ratio of the window before, where it did not fit.
    mismatch: Option<f64>,
    /// Gyro z against the encoder over the log, by the window and by the row.
    turning: Turning,
    scale: Scale,
    delay: DelayEstimator,
    /// Gyros against accelerometers over the log.
    gravity: Gravity,
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
            norms: Some((0.0, 0.0, 0)),
            beyond: (0, 0.0),
            channels: [Channel::new(); 6],
            window: None,
            judged: false,
            turned: false,
            mismatch: None,
            turning: Turning::default(),
            scale: Scale::default(),
            delay: DelayEstimator::default(),
            gravity: Gravity::default(),
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

    /// How late the IMU is against the encoder so far; `None` where the rotor never turned round.
    pub fn imu_delay(&self) -> Option<ImuDelay> {
        self.delay.fit()
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

        if let Some((sum, z, count)) = &mut self.norms {
            *sum += row.f_is_s.norm();
            *z += row.f_is_s.z();
            *count += 1;
        }
        let rate = row.w_is_s.norm();
        if rate > ANY_RATE {
            self.beyond = (self.beyond.0 + 1, self.beyond.1.max(rate));
        }

        let window = self.window.get_or_insert_with(|| RotorWindow::new(row));
        if let Some(previous) = previous
            && row.gap.is_none()
        {
            window.push(row, &previous);
            self.scale.push(row, &previous);
        }
        if let Some(previous) = previous {
            self.delay.push(row, &previous);
        }
        self.gravity.push(row);
        if row.t_s - first.t_s >= UNIT_WINDOW {
            self.judge_units(first.at)?;
        }
        let over = |window: &mut RotorWindow| row.t_s - window.start_s >= ROTOR_WINDOW;
        if let Some(window) = self.window.take_if(over) {
            self.window = Some(RotorWindow::new(row));
            self.judge_rotor(&window)?;
            self.judge_rates(first.at)?;
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
        self.judge_units(first.at)?;
        // A rest of a window tells little; but a short log has nothing else.
        if let Some(window) = self.window.take().filter(|window| !self.judged && window.time >= 1.0) {
            self.judge_rotor(&window)?;
        }
        self.judge_rates(first.at)?;
        self.judge_log(first.at)?;
        if !self.turned {
            self.warnings.push(LogWarning {
                file: self.file,
                at: last.at,
                kind: WarningKind::Still,
            });
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

    /// One odd row is the aligner's matter; most of them are a unit.
    fn judge_rates(&self, at: Place) -> Result<(), LogError> {
        let (beyond, largest) = self.beyond;
        if 2 * beyond > self.rows {
            return Err(self.error(at, LogProblem::GyroUnit(largest)));
        }
        Ok(())
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

    fn judge_units(&mut self, at: Place) -> Result<(), LogError> {
        let Some((sum, z, count)) = self.norms.take() else {
            return Ok(());
        };
        let mean = sum / count as f64;
        if GRAVITY.contains(&mean) {
            let z = z / count as f64;
            return if z < UPRIGHT * mean {
                Err(self.error(at, LogProblem::AccelAxes(z)))
            } else {
                Ok(())
            };
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
        let turning = window.turning();
        let held = window
            .held()
            .map(|(rows, behind)| self.error(at, LogProblem::EncoderHeld { rows, behind }));
        if turning.time < 0.5 * window.time
            && let Some(error) = held
        {
            return Err(error);
        }
        if turning.time < 0.5 * window.time || turning.path <= 0.0 {
            return Ok(());
        }
        let (ratio, rate) = (turning.ratio(), turning.path / turning.time);
        let near = |expected: f64| (ratio / expected - 1.0).abs() < 0.3;
        let fits = |largest: f64| (largest.recip()..=largest).contains(&ratio);
        let mismatch = self.mismatch.take();
        if near(1.0 / DEGREES) || near(-1.0 / DEGREES) || (fits(LARGE) && rate > FAST) {
            return Err(self.error(at, LogProblem::EncoderDegrees(rate)));
        } else if near(DEGREES) || near(-DEGREES) {
            return Err(self.error(at, LogProblem::GyroDegrees(ratio)));
        } else if near(-1.0) {
            return Err(self.error(at, LogProblem::Opposite));
        } else if !fits(GROSS) || mismatch.is_some_and(|before| (ratio / before - 1.0).abs() < SAME) {
            return Err(self.error(at, LogProblem::Mismatch(ratio)));
        }
        if let Some(error) = held {
            return Err(error);
        }
        self.turning.along += turning.along;
        self.turning.path += turning.path;
        self.turning.time += turning.time;
        if !fits(LARGE) {
            self.mismatch = Some(ratio);
            if !self.warnings.iter().any(|w| matches!(w.kind, WarningKind::Mismatch(_))) {
                self.warnings.push(LogWarning {
                    file: self.file.clone(),
                    at,
                    kind: WarningKind::Mismatch(ratio),
                });
            }
        }
        Ok(())
    }

    /// Over the log what a base turns averages out: a ratio that is not one is a scale, or a gear.
    fn judge_log(&self, at: Place) -> Result<(), LogError> {
        let ratio = self.turning.ratio();
        if self.turning.time > LOG_TURNING && (ratio - 1.0).abs() > LOG_RATIO {
            return Err(self.error(at, LogProblem::Mismatch(ratio)));
        }
        if let Some((scale, sd)) = self.scale.fit().filter(|_| self.turning.time > LOG_TURNING)
            && (scale - 1.0).abs() > (SCALE * (SCALE_TIME / self.scale.t).max(1.0)).max(sd)
        {
            return Err(self.error(at, LogProblem::Mismatch(scale)));
        }
        let rate = self.turning.path / self.turning.time;
        if let Some(ImuDelay { delay_s, sd_s }) = self.delay.fit().filter(|_| self.turning.time > LOG_TURNING)
            && (delay_s * rate).abs() > LATE
            && delay_s.abs() > LATE_SIGMAS * sd_s
        {
            let delay = -delay_s;
            return Err(self.error(at, LogProblem::EncoderLate { delay, rate }));
        }
        if self.gravity.is_reversed() {
            return Err(self.error(at, LogProblem::TiltReversed));
        }
        Ok(())
    }
}
