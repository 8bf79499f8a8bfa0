//! What happened when, by the lines of a log.

use core::fmt;

use app::command::ModeName;
use log::Level;
use serde::Serialize;

use super::parser::{Attitude, LogEvent, LogParser};
use super::text::{self, Line};

/// A log's clock that goes back by more has begun anew with its unit, s. Less is two tasks' lines that overtook.
const BACK_S: f64 = 0.5;
/// Estimates of the log and of the serial line are of the same instant where they are nearer, s.
const SAME_S: f64 = 0.5;

/// Where a timeline is from.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Source {
    /// Frames of defmt.
    Defmt,
    /// Lines of text.
    Text,
}

impl fmt::Display for Source {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Defmt => "defmt",
            Self::Text => "text",
        })
    }
}

/// A mode from when to when.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Span {
    /// The mode.
    pub mode: &'static str,
    /// Entered, s.
    pub from_s: f64,
    /// Left, s; the end of the log where it was not.
    pub to_s: f64,
}

/// An estimate.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct EstimateAt {
    /// When it was told, s.
    pub t_s: f64,
    /// The mode then.
    pub mode: Option<&'static str>,
    /// What it is.
    #[serde(flatten)]
    pub attitude: Attitude,
}

/// A result of coarse alignment.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct CoarseAt {
    /// When, s.
    pub t_s: f64,
    /// Degrees.
    pub heading_deg: f64,
    /// Its predicted 1σ, degrees.
    pub heading_sd_deg: f64,
}

/// A fault.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct FaultAt {
    /// When, s.
    pub t_s: f64,
    /// Its kind.
    pub name: String,
    /// Its facts.
    pub text: String,
    /// The retry that followed, and when it began, s.
    pub retry: Option<(u32, f64)>,
    /// Whether it stayed.
    pub latched: bool,
}

impl FaultAt {
    /// Its name, and its facts where there are any.
    pub fn words(&self) -> String {
        // A derived format of a fault without facts is its name once more.
        if self.text.bytes().all(|b| b.is_ascii_alphanumeric()) {
            self.name.clone()
        } else {
            format!("{}: {}", self.name, self.text)
        }
    }
}

/// A start of the unit.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct StartAt {
    /// When, s.
    pub t_s: f64,
    /// By what, as the unit has found; none where it did not tell.
    pub cause: Option<String>,
    /// Modes told before it.
    #[serde(skip)]
    pub(super) modes: usize,
}

/// A line that stands for itself.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct SaidAt {
    /// When, s.
    pub t_s: f64,
    /// What.
    pub text: String,
}

/// What became of the samples, as far as the level of the log tells.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize)]
pub struct Samples {
    /// Lost, by the IMU's count.
    pub lost: u64,
    /// In so many gaps.
    pub gaps: u64,
    /// Came twice.
    pub repeated: u64,
    /// Transfers that failed.
    pub transfers: u64,
    /// Dropped because the alignment did not keep up.
    pub overruns: u64,
    /// Gaps that the alignment bridged.
    pub bridged: u64,
    /// Their length, ms.
    pub bridged_ms: f64,
}

/// Something new, for who follows.
#[derive(Debug, Clone, PartialEq)]
pub enum News {
    /// An estimate.
    Estimate(EstimateAt),
    /// A line of the unit.
    Said {
        /// When, s.
        t_s: f64,
        /// How bad it is.
        level: Option<Level>,
        /// What.
        text: String,
    },
}

/// What a log tells.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Timeline {
    /// How it was written.
    pub source: Source,
    /// Lines of the unit.
    pub lines: u64,
    /// Of these, lines that this program understands.
    pub understood: u64,
    /// Frames that could not be decoded.
    pub damaged: u64,
    /// Sentences of the serial port.
    pub sentences: u64,
    /// The first time in it, s; no number where the log has no times, as all others then.
    pub from_s: f64,
    /// The last time in it, s; times of a unit that was reset go on from there.
    pub to_s: f64,
    /// Modes in order.
    pub modes: Vec<Span>,
    /// Estimates in order.
    pub estimates: Vec<EstimateAt>,
    /// Coarse alignments in order.
    pub coarse: Vec<CoarseAt>,
    /// Faults in order.
    pub faults: Vec<FaultAt>,
    /// Starts in order; all but a first one at the beginning of the log are resets.
    pub starts: Vec<StartAt>,
    /// Resets.
    pub resets: u64,
    /// Where the alignment was lost or began anew, and why.
    pub setbacks: Vec<SaidAt>,
    /// Errors of the unit that are no faults of its application: panics.
    pub errors: Vec<SaidAt>,
    /// What became of the samples.
    pub samples: Samples,
    #[serde(skip)]
    parser: LogParser,
    /// Added to the times of the log.
    #[serde(skip)]
    offset_s: f64,
    #[serde(skip)]
    clock_s: Option<f64>,
    /// A line has had a time.
    #[serde(skip)]
    timed: bool,
    /// Attitude of the serial line that waits for the time of its second.
    #[serde(skip)]
    attitude: Option<Attitude>,
    /// The line before was the version: the start is told already, its cause follows.
    #[serde(skip)]
    begun: bool,
    /// Whether the log itself tells modes, estimates.
    #[serde(skip)]
    tells: [bool; 2],
}

impl Timeline {
    pub(super) fn new(source: Source) -> Self {
        Self {
            source,
            lines: 0,
            understood: 0,
            damaged: 0,
            sentences: 0,
            from_s: f64::NAN,
            to_s: f64::NAN,
            modes: Vec::new(),
            estimates: Vec::new(),
            coarse: Vec::new(),
            faults: Vec::new(),
            starts: Vec::new(),
            resets: 0,
            setbacks: Vec::new(),
            errors: Vec::new(),
            samples: Samples::default(),
            parser: LogParser::learn(),
            offset_s: 0.0,
            clock_s: None,
            timed: false,
            attitude: None,
            begun: false,
            tells: [false; 2],
        }
    }

    /// Whether anything in it has a time.
    pub fn has_times(&self) -> bool {
        self.clock_s.is_some()
    }

    /// The mode at the end; `unknown` where no line told of one.
    pub fn state(&self) -> &'static str {
        self.mode().unwrap_or("unknown")
    }

    /// When the unit first was in a mode, s; none where the log has no time of it.
    pub fn first(&self, mode: ModeName) -> Option<f64> {
        let spans = self.modes.iter();
        spans
            .clone()
            .find(|span| span.mode == mode.as_str())
            .map(|span| span.from_s)
            .filter(|t_s| !t_s.is_nan())
    }

    fn mode(&self) -> Option<&'static str> {
        let last = self.modes.last()?;
        // A unit that has started since is in none yet.
        let started = self.starts.last().is_some_and(|start| start.modes == self.modes.len());
        (!started).then_some(last.mode)
    }

    /// The time of a line. A clock that goes back is that of a unit that was reset.
    fn time(&mut self, clock_s: Option<f64>) -> (f64, bool) {
        let Some(clock_s) = clock_s else {
            return (self.to_s, false);
        };
        let back = self.clock_s.is_some_and(|last| clock_s < last - BACK_S);
        if back {
            self.offset_s = self.to_s;
        }
        let t_s = clock_s + self.offset_s;
        if self.clock_s.is_none() {
            self.from_s = t_s;
            self.to_s = t_s;
        }
        self.clock_s = Some(clock_s);
        self.to_s = self.to_s.max(t_s);
        let count = self.modes.len();
        if let Some(span) = self.modes.last_mut()
            && !back
            && self.starts.last().is_none_or(|start| start.modes < count)
        {
            span.to_s = self.to_s;
        }
        (t_s, back)
    }

    fn start(&mut self, t_s: f64, cause: Option<String>) {
        // The log's first word of the unit is its start, and any later one is a reset.
        self.resets += u64::from(self.lines > 1 || self.sentences > 1);
        self.starts.push(StartAt {
            t_s,
            cause,
            modes: self.modes.len(),
        });
        self.attitude = None;
    }

    fn enter(&mut self, t_s: f64, mode: ModeName) {
        if self.mode() == Some(mode.as_str()) {
            return;
        }
        self.modes.push(Span {
            mode: mode.as_str(),
            from_s: t_s,
            to_s: t_s,
        });
    }

    fn estimate(&mut self, t_s: f64, attitude: Attitude) -> News {
        let estimate = EstimateAt {
            t_s,
            mode: self.mode(),
            attitude,
        };
        self.estimates.push(estimate);
        News::Estimate(estimate)
    }

    /// Takes a line of the log.
    pub(super) fn line(&mut self, line: Line) -> Option<News> {
        // What a host says among it are not the unit's words: echoes of what is typed, for instance.
        let told = line.level.and_then(|_| self.parser.read(&line.text));
        self.lines += 1;
        self.understood += u64::from(told.is_some());
        self.timed |= line.t_s.is_some();
        let (t_s, back) = self.time(line.t_s);
        let begun = core::mem::replace(&mut self.begun, told == Some(LogEvent::Version));
        if back && !matches!(told, Some(LogEvent::Started { .. } | LogEvent::Version)) {
            self.start(t_s, None);
        }
        let said = || SaidAt {
            t_s,
            text: line.text.clone(),
        };
        match told {
            None if line.level == Some(Level::Error) => self.errors.push(said()),
            None | Some(LogEvent::Note) => {}
            Some(LogEvent::Version) => self.start(t_s, None),
            Some(LogEvent::Started { cause }) => match self.starts.last_mut() {
                Some(start) if begun => start.cause = Some(cause),
                _ => self.start(t_s, Some(cause)),
            },
            Some(LogEvent::Mode(mode)) => {
                self.tells[0] = true;
                self.enter(t_s, mode);
            }
            Some(LogEvent::Estimate(attitude)) => {
                self.tells[1] = true;
                return Some(self.estimate(t_s, attitude));
            }
            Some(LogEvent::Coarse { heading_deg, sd_deg }) => self.coarse.push(CoarseAt {
                t_s,
                heading_deg,
                heading_sd_deg: sd_deg,
            }),
            Some(LogEvent::NotAligned | LogEvent::AlignsAnew) => self.setbacks.push(said()),
            Some(LogEvent::Fault { name, text }) => self.faults.push(FaultAt {
                t_s,
                name,
                text,
                retry: None,
                latched: false,
            }),
            Some(LogEvent::Retry { attempt }) => {
                if let Some(fault) = self.faults.last_mut() {
                    fault.retry = Some((attempt, t_s));
                }
            }
            Some(LogEvent::Latched) => {
                if let Some(fault) = self.faults.last_mut() {
                    fault.latched = true;
                }
            }
            Some(LogEvent::Lost { samples, .. }) => {
                self.samples.lost += u64::from(samples);
                self.samples.gaps += 1;
            }
            Some(LogEvent::Repeated { .. }) => self.samples.repeated += 1,
            Some(LogEvent::Transfer) => self.samples.transfers += 1,
            // Each line gives the sum since the start, which is told at most once in a while.
            Some(LogEvent::Overrun { total }) => self.samples.overruns = self.samples.overruns.max(total.into()),
            Some(LogEvent::Bridged { ms }) => {
                self.samples.bridged += 1;
                self.samples.bridged_ms += ms;
            }
        }
        Some(News::Said {
            t_s,
            level: line.level,
            text: line.text,
        })
    }

    /// Takes a sentence of the serial port. The log, where it tells the same, goes before: its lines have their times.
    pub(super) fn sentence(&mut self, fields: &[&str]) -> Option<News> {
        self.sentences += 1;
        if let Some(attitude) = text::pashr(fields) {
            self.attitude = Some(attitude);
            return None;
        }
        let status = text::prnst(fields)?;
        let attitude = self.attitude.take();
        if self.lines > 0 && self.tells == [true; 2] {
            return None;
        }
        // Among lines with times these go on to hold.
        let (t_s, back) = self.time((!self.timed).then_some(status.t_s));
        if back {
            self.start(t_s, None);
        }
        if let Some(mode) = status.mode
            && !self.tells[0]
        {
            self.enter(t_s, mode);
        }
        let since = self.estimates.last().map_or(f64::INFINITY, |last| t_s - last.t_s);
        let attitude = attitude.filter(|_| since > SAME_S && !self.tells[1])?;
        Some(self.estimate(t_s, attitude))
    }

    /// A frame that could not be decoded.
    pub(super) fn damage(&mut self) {
        self.damaged += 1;
    }

    /// Time between estimates that follow one another in one run of the filter, s: median and longest.
    pub fn intervals_s(&self) -> Option<(f64, f64)> {
        let mut intervals: Vec<f64> = self
            .estimates
            .windows(2)
            .filter(|pair| !self.starts.iter().any(|s| (pair[0].t_s..=pair[1].t_s).contains(&s.t_s)))
            .map(|pair| pair[1].t_s - pair[0].t_s)
            .collect();
        if !self.has_times() {
            return None;
        }
        intervals.sort_by(f64::total_cmp);
        Some((*intervals.get(intervals.len() / 2)?, *intervals.last()?))
    }

    /// From when on the heading's σ was below a limit, to the end of the log, s.
    pub fn below_s(&self, sd_deg: f64) -> Option<f64> {
        let kept = self
            .estimates
            .iter()
            .rev()
            .take_while(|estimate| estimate.attitude.heading_sd_deg < sd_deg);
        kept.last().map(|estimate| estimate.t_s).filter(|t_s| !t_s.is_nan())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn timeline(lines: &[(f64, Level, &str)]) -> Timeline {
        let mut timeline = Timeline::new(Source::Text);
        for (t_s, level, text) in lines {
            let _ = timeline.line(Line {
                t_s: Some(*t_s),
                level: Some(*level),
                text: (*text).to_owned(),
            });
        }
        timeline
    }

    /// The image's clock begins anew with a reset, a simulator's goes on: both are one reset.
    #[test]
    fn a_reset_is_one_by_either_clock() {
        use Level::{Error, Info};
        let before = [
            (0.001, Info, "rotary-north 0.1.0"),
            (0.001, Info, "started by power on"),
            (0.002, Info, "mode idle -> self-test"),
            (1.2, Info, "mode self-test -> homing"),
            (9.0, Error, "panic at src/main.rs:12: out of luck"),
        ];
        for (start, mode) in [(0.001, 0.003), (9.1, 9.103)] {
            let mut lines = before.to_vec();
            lines.push((start, Info, "rotary-north 0.1.0"));
            lines.push((start, Info, "started by software"));
            lines.push((mode, Info, "mode idle -> self-test"));
            let found = timeline(&lines);
            assert_eq!(
                (found.resets, found.starts.len(), found.errors.len()),
                (1, 2, 1),
                "{found:?}"
            );
            assert_eq!(found.starts[1].cause.as_deref(), Some("software"));
            assert!((9.0..9.2).contains(&found.starts[1].t_s), "{:?}", found.starts);
            let modes: Vec<_> = found.modes.iter().map(|span| span.mode).collect();
            assert_eq!(modes, ["self-test", "homing", "self-test"]);
            assert!((9.0..=9.1).contains(&found.modes[1].to_s), "{:?}", found.modes);
            assert_eq!(found.state(), "self-test");
        }
        // Where the line of the start is lost the clock still tells.
        let mut lines = before.to_vec();
        lines.push((1.5, Info, "encoder answers"));
        let found = timeline(&lines);
        assert_eq!((found.resets, found.starts[1].cause.as_deref()), (1, None));
        assert_eq!(found.state(), "unknown");
    }

    #[test]
    fn sigma_counts_where_it_stays() {
        let line = |sd: f64| format!("heading 10 deg, sd {sd} deg, pitch 0 deg, roll 0 deg");
        let texts: Vec<String> = [3.0, 0.9, 1.2, 0.8, 0.4].into_iter().map(line).collect();
        let lines: Vec<_> = (0..)
            .map(f64::from)
            .zip(&texts)
            .map(|(t, s)| (t, Level::Info, s.as_str()))
            .collect();
        let found = timeline(&lines);
        assert_eq!((found.below_s(1.0), found.below_s(0.1)), (Some(3.0), None));
        assert_eq!(found.intervals_s(), Some((1.0, 1.0)));
    }
}
