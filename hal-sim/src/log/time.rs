//! Time of the rows of a CSV: the interval they come at, rows that are missing, and stamps that are not to be trusted.
//!
//! Stamps are taken as they are where each interval is the nominal one, or longer by whole rows that are missing. Where
//! they are not, because a system hands rows over in bursts, rounds their time or stamps them late, the rows are spaced anew
//! along a line through the stamps:
//!
//! ```text
//! t_k ≈ a + D n_k       D the interval, n_k the number of the row, those missing counted
//! ```
//!
//! A row is missing where the stamps stay late from there on: lateness `t_k − D n_k` rises by `D` in its least and in its
//! median value over the rows around. What only jitters comes back.
//!
//! All of it is done over [`WINDOW`] rows at a time, of which the first half is given: memory is bounded.

use core::ops::Range;
use std::collections::VecDeque;

use frames::math::wrap_pi;

use super::{Gap, LogWarning, Place, WarningKind};

/// Rows looked at together.
pub(super) const WINDOW: usize = 1 << 14;
/// An interval this many times the nominal one has rows missing.
const GAP_FACTOR: f64 = 1.5;
/// Intervals this near to the nominal one, as a part of it, are that one.
const EVEN: f64 = 0.1;
/// Rows before and after a long interval by which loss is distinguished from jitter.
const LEAST_AROUND: usize = 256;
const MOST_AROUND: usize = 1024;
/// Intervals this near to each other are not spread by chance.
const TIGHT: f64 = 0.02;
/// So many stamps of a window that stand still or go back are a coarse or unsteady clock; fewer are an error.
const DISORDERED: usize = 5;
/// Gaps longer than this may have any length, intervals.
const ANY_LENGTH: f64 = 5.5;
/// A rate that was changed holds for so many rows, and is not this many times another.
const RATE_ROWS: usize = 100;
const MOST_RATES: f64 = 10.0;
/// Rows by whose median interval a gap is recognised where the rate changes.
const LOCAL: usize = 9;
/// A clock that was set while it recorded leaps by more, s.
const LEAP: f64 = 1000.0;
/// How far such a clock may go back, intervals.
const BACK: f64 = 20.0;
/// So many long intervals are a pattern, which may be that of the clock.
const PATTERN: usize = 8;
/// Share of the rows that must seem missing for stairs to be that of the clock, where no encoder turns.
const STAIRS: f64 = 0.15;
/// A log may begin with at most such a share of badly stamped rows, and more of them than this.
const START_SHARE: usize = 5;
const START_LEAST: usize = 3;

/// The stamp of a row, and what else tells of its time.
#[derive(Debug, Clone, Copy)]
pub(super) struct Stamp {
    pub(super) t_s: f64,
    /// Rotor angle, rad.
    pub(super) encoder: f64,
    /// Whether all else is as in the row before.
    pub(super) repeated: bool,
}

/// When a row is.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct When {
    pub(super) t_s: f64,
    pub(super) dt_s: f64,
    pub(super) gap: Option<Gap>,
}

/// What is made of the rows of a window.
#[derive(Debug)]
pub(super) struct Plan {
    /// Rows that are left out at the beginning.
    pub(super) skip: usize,
    /// Those after them.
    pub(super) rows: Vec<When>,
    /// The row whose stamp does not grow, where that is an error, and the stamp before; no row from there on is planned.
    pub(super) stuck: Option<(usize, f64)>,
}

/// What the stamps of a window are.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Kind {
    /// One interval, or longer ones where rows are missing.
    Even,
    /// The same at a few rates, one after the other.
    Steady,
    /// Off by chance.
    Jitter,
    /// Uneven though no row is missing.
    Pattern,
}

/// A fault of the stamps, and how often.
#[derive(Debug, Clone, Copy, Default)]
struct Jitter {
    at: u64,
    rows: u64,
    largest_s: f64,
}

/// Follows the stamps of a log.
#[derive(Debug, Default)]
pub(super) struct Clock {
    /// The interval, s; `None` before the first window.
    interval: Option<f64>,
    /// Stamps of the rows given last, those before a gap moved up to what is after it.
    past: VecDeque<f64>,
    /// Stamp and time of the row given last.
    stamped: Option<f64>,
    given: Option<f64>,
    /// Since when rows are spaced anew.
    jitter: Option<Jitter>,
    /// Rows left out at the beginning, and their mean interval.
    start: Option<(u64, f64)>,
}

/// The value below which a share of the values lies.
fn quantile(values: &mut [f64], share: f64) -> f64 {
    if values.is_empty() {
        return 0.0;
    }
    let k = ((values.len() as f64 * share) as usize).min(values.len() - 1);
    *values.select_nth_unstable_by(k, f64::total_cmp).1
}

fn median(values: &mut [f64]) -> f64 {
    quantile(values, 0.5)
}

/// The line `a + d n` through points, and how far they are from it: below and above.
fn line(points: impl Iterator<Item = (f64, f64)> + Clone) -> (f64, f64, f64, f64) {
    let count = points.clone().count() as f64;
    let Some((n0, t0)) = points.clone().next() else {
        return (0.0, 0.0, 0.0, 0.0);
    };
    // From the first point, so that an epoch keeps its digits.
    let near = points.map(|(n, t)| (n - n0, t - t0));
    let (sn, st) = near.clone().fold((0.0, 0.0), |(sn, st), (n, t)| (sn + n, st + t));
    let (mn, mt) = (sn / count, st / count);
    let (nn, nt) = near.clone().fold((0.0, 0.0), |(nn, nt), (n, t)| {
        (nn + (n - mn) * (n - mn), nt + (n - mn) * (t - mt))
    });
    let d = if nn > 0.0 { nt / nn } else { 0.0 };
    let (low, high) = near.fold((0.0_f64, 0.0_f64), |(low, high), (n, t)| {
        let off = t - mt - d * (n - mn);
        (low.min(off), high.max(off))
    });
    (t0 + mt - d * (mn + n0), d, low, high)
}

/// Whether an interval is the nominal one, or longer by whole rows. What is far longer need not be a multiple: a source
/// that was away begins anew.
fn is_even(interval: f64, nominal: f64) -> bool {
    let rows = interval / nominal;
    rows > ANY_LENGTH || (rows - rows.round()).abs() <= EVEN
}

fn intervals(t: &[f64]) -> Vec<f64> {
    t.windows(2).map(|pair| pair[1] - pair[0]).collect()
}

/// The interval of stamps that jitter: the median slope over long, uneven stretches, in which a pattern averages out.
fn long_slope(t: &[f64]) -> f64 {
    let least = (t.len() / 8).max(1);
    let mut slopes: Vec<f64> = (0..t.len())
        .filter_map(|k| {
            let stretch = least + k.wrapping_mul(7919) % least;
            t.get(k + stretch).map(|end| (end - t[k]) / stretch as f64)
        })
        .collect();
    median(&mut slopes)
}

/// Rows missing before each row, by lateness that stays.
fn missing(t: &[f64], d: f64, from: usize) -> Vec<f64> {
    let mut lost = vec![0.0; t.len()];
    let long = |k: usize| t[k] - t[k - 1] > GAP_FACTOR * d;
    let candidates: Vec<usize> = (from.max(1)..t.len()).filter(|k| long(*k)).collect();
    if candidates.is_empty() {
        return lost;
    }
    let mut apart: Vec<f64> = candidates.windows(2).map(|pair| (pair[1] - pair[0]) as f64).collect();
    let around = (4 * quantile(&mut apart, 0.9) as usize).clamp(LEAST_AROUND, MOST_AROUND);
    // At the end of a log what is late has had no time to come back.
    let end = t.len().saturating_sub(around / 4);
    // Lateness with what was found missing taken off.
    let mut late: Vec<f64> = t.iter().enumerate().map(|(k, t)| t - k as f64 * d).collect();
    let (mut found, mut done) = (0.0, 0);
    let levels = |rows: &[f64]| {
        let mut rows = rows.to_vec();
        (rows.iter().copied().fold(f64::INFINITY, f64::min), median(&mut rows))
    };
    for k in candidates.into_iter().filter(|k| *k < end) {
        late[done..k].iter_mut().for_each(|late| *late -= found * d);
        done = k;
        let (least, middle) = levels(&late[k.saturating_sub(around)..k]);
        let (next_least, next_middle) = levels(&late[k..t.len().min(k + around)]);
        let step = (next_least - least).min(next_middle - middle) / d - found;
        if step >= 0.5 {
            lost[k] = step.round();
            found += lost[k];
        }
    }
    lost
}

/// How far the rotor turns in long intervals over how far in the others; `None` where it rests.
fn encoder_ratio(stamps: &[Stamp], t: &[f64], d: f64) -> Option<f64> {
    let (mut long, mut others) = (Vec::new(), Vec::new());
    for k in 1..stamps.len() {
        let turned = wrap_pi(stamps[k].encoder - stamps[k - 1].encoder).abs();
        if t[k] - t[k - 1] > GAP_FACTOR * d {
            long.push(turned);
        } else {
            others.push(turned);
        }
    }
    let other = median(&mut others);
    (other > 1e-6).then(|| median(&mut long) / other)
}

/// Whether rows come at a few rates one after the other, each for long, with gaps at the most between: then the stamps
/// are right, and the rate was changed.
fn is_steady(steps: &[f64]) -> bool {
    let mut runs: Vec<(f64, usize)> = Vec::new();
    for step in steps {
        match runs.last_mut() {
            Some((usual, rows)) if (step / *usual - 1.0).abs() <= EVEN => *rows += 1,
            _ => runs.push((*step, 1)),
        }
        if runs.len() > 2 * PATTERN {
            return false;
        }
    }
    let rates = || runs.iter().filter(|run| run.1 > 1);
    let fastest = rates().map(|run| run.0).fold(f64::INFINITY, f64::min);
    let slowest = rates().map(|run| run.0).fold(0.0, f64::max);
    rates().all(|run| run.1 >= RATE_ROWS)
        && fastest * MOST_RATES > slowest
        && steps.iter().all(|step| *step >= 0.9 * fastest)
}

impl Clock {
    /// The interval of the rows, s; `None` before there were any.
    pub(super) fn interval(&self) -> Option<f64> {
        self.interval
    }

    /// What is wrong with the stamps so far.
    pub(super) fn warnings(&self, file: &str) -> Vec<LogWarning> {
        let warning = |line, kind| LogWarning {
            file: file.to_owned(),
            at: Place::Line(line),
            kind,
        };
        let nominal_s = self.interval.unwrap_or_default();
        let start = self.start.map(|(rows, interval_s)| {
            warning(
                2,
                WarningKind::Start {
                    rows,
                    interval_s,
                    nominal_s,
                },
            )
        });
        let jitter = self.jitter.filter(|jitter| jitter.rows > 0).map(|jitter| {
            warning(
                jitter.at,
                WarningKind::Jitter {
                    rows: jitter.rows,
                    largest_s: jitter.largest_s,
                    nominal_s,
                },
            )
        });
        start.into_iter().chain(jitter).collect()
    }

    /// Says when the next rows are, of which `lines` are in the file; of a log that has not `ended`, of the first half.
    pub(super) fn plan(&mut self, stamps: &[Stamp], lines: &[u64], ended: bool) -> Plan {
        let mut plan = Plan {
            skip: 0,
            rows: Vec::new(),
            stuck: None,
        };
        let mut t: Vec<f64> = stamps.iter().map(|stamp| stamp.t_s).collect();
        if let Some(stuck) = self.stuck(stamps, &t) {
            let before = stuck.checked_sub(1).map(|k| t[k]).or(self.stamped);
            plan.stuck = Some((stuck, before.unwrap_or_default()));
            t.truncate(stuck);
        }
        let give = if ended || plan.stuck.is_some() {
            t.len()
        } else {
            t.len() / 2
        };
        if self.interval.is_none() && self.jitter.is_none() {
            plan.skip = self.wrong_start(&t);
        }
        let (t, stamps, lines) = (&t[plan.skip..], &stamps[plan.skip..], &lines[plan.skip..]);
        let give = give.saturating_sub(plan.skip);
        if t.is_empty() || (t.len() < 2 && self.interval.is_none()) {
            return plan;
        }
        // Once in doubt, always: to go back to the stamps would be a step.
        let kind = match self.kind(&stamps[..t.len()], t) {
            Kind::Even | Kind::Steady if self.jitter.is_some() => Kind::Jitter,
            kind => kind,
        };
        plan.rows = match kind {
            Kind::Even => self.as_stamped(t, give, false),
            Kind::Steady => self.as_stamped(t, give, true),
            Kind::Jitter | Kind::Pattern => self.spaced_anew(t, &lines[..t.len()], give, kind == Kind::Pattern),
        };
        for (when, t) in plan.rows.iter().zip(t) {
            if let Some(gap) = when.gap {
                let length = when.dt_s - gap.nominal_dt_s;
                self.past.iter_mut().for_each(|before| *before += length);
            }
            if self.past.len() == MOST_AROUND {
                self.past.pop_front();
            }
            self.past.push_back(*t);
            self.stamped = Some(*t);
        }
        plan
    }

    /// The first row whose stamp does not grow, unless the clock is of a kind that does so all the time.
    fn stuck(&self, stamps: &[Stamp], t: &[f64]) -> Option<usize> {
        let before = self.stamped;
        let step = |k: usize| match k {
            0 => before.map_or(f64::INFINITY, |before| t[0] - before),
            k => t[k] - t[k - 1],
        };
        let bad: Vec<usize> = (0..t.len()).filter(|k| step(*k) <= 0.0).collect();
        let first = *bad.first()?;
        let interval = self.interval.unwrap_or_else(|| long_slope(t));
        let tolerable = |k: &usize| !stamps[*k].repeated && step(*k) >= -BACK * interval;
        if bad.len() >= DISORDERED || self.jitter.is_some() {
            return bad.iter().copied().find(|k| !tolerable(k));
        }
        Some(first)
    }

    /// Rows at the beginning that are stamped otherwise than the rest.
    fn wrong_start(&mut self, t: &[f64]) -> usize {
        let steps = intervals(t);
        let nominal = median(&mut steps.clone());
        let bad = |step: f64| (step / nominal - 1.0).abs() > EVEN;
        let most = steps.len() / START_SHARE;
        let (mut count, mut rows) = (0, 0);
        for (k, step) in steps.iter().enumerate().take(most) {
            if bad(*step) {
                count += 1;
                // More than half of the rows up to here; or a clock that was set.
                if (2 * count > k && count > START_LEAST) || *step > LEAP {
                    rows = k + 1;
                }
            }
        }
        // The rest has to be what the beginning is not.
        let rest = &steps[rows..];
        if rows == 0 || rest.iter().filter(|step| bad(**step)).count() * 20 > rest.len() {
            return 0;
        }
        self.start = Some((rows as u64, (t[rows] - t[0]) / rows as f64));
        rows
    }

    /// What the stamps of a window are; sets the interval if they can be taken as they are.
    fn kind(&mut self, stamps: &[Stamp], t: &[f64]) -> Kind {
        let steps = intervals(t);
        let Some(nominal) = (!steps.is_empty()).then(|| median(&mut steps.clone())) else {
            return Kind::Even;
        };
        let usual: Vec<f64> = steps
            .iter()
            .copied()
            .filter(|step| (step / nominal - 1.0).abs() <= EVEN)
            .collect();
        let first = usual.iter().sum::<f64>() / usual.len() as f64;
        let long = steps.iter().filter(|step| **step > GAP_FACTOR * nominal).count();
        let uneven = steps.iter().filter(|step| !is_even(**step, nominal)).count();
        let short = nominal <= 0.0 || steps.iter().any(|step| *step < (1.0 - EVEN) * nominal);
        let kind = if (short || long >= RATE_ROWS || uneven >= PATTERN) && is_steady(&steps) {
            Kind::Steady
        } else if long >= PATTERN && self.is_of_clock(stamps, t, nominal, uneven >= PATTERN) {
            Kind::Pattern
        } else if short || uneven >= PATTERN {
            Kind::Jitter
        } else {
            Kind::Even
        };
        if self.interval.is_none() && matches!(kind, Kind::Even | Kind::Steady) {
            self.interval = Some(if first > 0.0 { first } else { nominal });
        }
        kind
    }

    /// Whether long intervals, of which there are many, are how the clock goes, and not rows that are missing.
    fn is_of_clock(&self, stamps: &[Stamp], t: &[f64], nominal: f64, uneven: bool) -> bool {
        // In twice the time a rotor turns twice as far.
        if let Some(ratio) = encoder_ratio(stamps, t, nominal) {
            return ratio < 1.3;
        }
        let steps = intervals(t);
        let lost: f64 = steps.iter().map(|step| (step / nominal).round() - 1.0).sum();
        let largest = steps.iter().copied().fold(0.0, f64::max);
        let (_, _, low, high) = line(t.iter().enumerate().map(|(k, t)| (k as f64, *t)));
        let tight = |step: &&f64| **step > GAP_FACTOR * nominal || (**step / nominal - 1.0).abs() < TIGHT;
        // Rounded to a multiple of the least interval; or more stairs than rows could be missing, or such as no row has.
        high - low <= 1.1 * nominal
            || (lost > STAIRS * (lost + steps.len() as f64) && high - low <= 1.5 * largest)
            || (uneven && steps.iter().filter(tight).count() * 10 > steps.len() * 9)
    }

    fn as_stamped(&mut self, t: &[f64], give: usize, rates: bool) -> Vec<When> {
        let mut nominal = self.interval.unwrap_or_default();
        let mut rows = Vec::with_capacity(give);
        for (k, now) in t[..give].iter().enumerate() {
            if rates {
                // Of the rows up to here and of those from here on, the slower: between them the rate may have changed.
                let here = k.saturating_sub(1);
                let usual = |rows: Range<usize>| median(&mut intervals(&t[rows]));
                nominal = usual(k.saturating_sub(LOCAL)..k + 1).max(usual(here..t.len().min(k + LOCAL)));
            }
            let (dt_s, gap) = match self.given {
                Some(before) => {
                    let dt_s = now - before;
                    let gap = (dt_s > GAP_FACTOR * nominal).then(|| Gap {
                        after_s: before,
                        nominal_dt_s: nominal,
                        missing: (dt_s / nominal).round() as u64 - 1,
                    });
                    (dt_s, gap)
                }
                // As long as the second, unless there are rows missing before that.
                None => {
                    let second = t.get(k + 1).map(|next| next - now);
                    (
                        second.filter(|dt_s| *dt_s <= GAP_FACTOR * nominal).unwrap_or(nominal),
                        None,
                    )
                }
            };
            self.given = Some(*now);
            rows.push(When { t_s: *now, dt_s, gap });
        }
        rows
    }

    fn spaced_anew(&mut self, t: &[f64], lines: &[u64], give: usize, pattern: bool) -> Vec<When> {
        // With the rows before them, by which loss is recognised.
        let before = self.past.len();
        let all: Vec<f64> = self.past.iter().chain(t).copied().collect();
        let steps = intervals(&all);
        let usual = median(&mut steps.clone());
        let near: Vec<f64> = steps
            .iter()
            .copied()
            .filter(|step| (step / usual - 1.0).abs() <= 0.5)
            .collect();
        // Where most intervals are much alike, their mean; a row that is missing now and then is not in it.
        let mut d = if !pattern && near.len() * 10 > steps.len() * 9 {
            near.iter().sum::<f64>() / near.len() as f64
        } else {
            long_slope(t)
        };
        if d <= 0.0 {
            d = self
                .interval
                .unwrap_or_else(|| steps.iter().copied().fold(f64::MIN_POSITIVE, f64::max));
        }
        let mut numbers = vec![0.0; t.len()];
        let mut lost = Vec::new();
        let mut fitted = (t[0], d, 0.0, 0.0);
        for _ in 0..3 {
            lost = missing(&all, d, before)[before..].to_vec();
            let mut number = -1.0;
            for (n, lost) in numbers.iter_mut().zip(&lost) {
                number += 1.0 + lost;
                *n = number;
            }
            fitted = line(numbers.iter().copied().zip(t.iter().copied()));
            if !fitted.1.is_finite() || fitted.1 <= 0.0 {
                fitted = (t[0], d, 0.0, 0.0);
                break;
            }
            d = fitted.1;
        }
        let (a, d, ..) = fitted;
        self.interval = Some(d);
        self.note(t, lines, &numbers, give, a, d);
        self.along(&numbers, &lost, 0..give, a, d)
    }

    /// Counts rows whose stamps are off the line.
    fn note(&mut self, t: &[f64], lines: &[u64], numbers: &[f64], give: usize, a: f64, d: f64) {
        let jitter = self.jitter.get_or_insert_default();
        for k in 0..give {
            let off = (t[k] - a - d * numbers[k]).abs();
            if off > EVEN * d {
                if jitter.rows == 0 {
                    jitter.at = lines[k];
                }
                jitter.rows += 1;
                jitter.largest_s = jitter.largest_s.max(off);
            }
        }
    }

    /// Rows along the line, from where the last one was.
    fn along(&mut self, numbers: &[f64], lost: &[f64], rows: Range<usize>, a: f64, d: f64) -> Vec<When> {
        let Some(last) = rows.clone().last() else {
            return Vec::new();
        };
        // The first row of all is on the line; later the line is met at the end of the window.
        let (start, step) = match self.given {
            None => (a - d, d),
            Some(before) => {
                let step = (a + d * numbers[last] - before) / (numbers[last] + 1.0);
                (before, if (0.5 * d..2.0 * d).contains(&step) { step } else { d })
            }
        };
        rows.map(|k| {
            let t_s = start + step * (numbers[k] + 1.0);
            let gap = self.given.filter(|_| lost[k] > 0.0).map(|after_s| Gap {
                after_s,
                nominal_dt_s: step,
                missing: lost[k] as u64,
            });
            self.given = Some(t_s);
            let dt_s = step * (1.0 + lost[k]);
            When { t_s, dt_s, gap }
        })
        .collect()
    }
}
