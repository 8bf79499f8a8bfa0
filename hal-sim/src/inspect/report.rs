//! A timeline as table and as CSV.

use core::fmt::Write as _;
use std::path::Path;

use app::command::ModeName;
use serde::Serialize;

use super::InspectError;
use super::timeline::{EstimateAt, Timeline};

/// Estimates in the table, at the most.
const ROWS: usize = 10;
/// Limits of the heading's σ whose times are told, degrees.
const LIMITS_DEG: [f64; 6] = [5.0, 1.0, 0.5, 0.2, 0.1, 0.05];
/// Faults, setbacks and errors that are told one by one.
const EVENTS: usize = 20;

/// A timeline with its result, for JSON.
#[derive(Debug, Serialize)]
pub struct Summary<'a> {
    /// The mode at the end.
    pub state: &'static str,
    /// When the unit began to align, s.
    pub aligning_at_s: Option<f64>,
    /// When it first was aligned, s.
    pub aligned_at_s: Option<f64>,
    /// All of it.
    #[serde(flatten)]
    pub timeline: &'a Timeline,
}

/// The timeline with its result.
pub fn summary(timeline: &Timeline) -> Summary<'_> {
    Summary {
        state: timeline.state(),
        aligning_at_s: timeline.first(ModeName::Coarse),
        aligned_at_s: timeline.first(ModeName::Aligned),
        timeline,
    }
}

/// The timeline in words and tables.
pub fn table(timeline: &Timeline) -> String {
    let mut text = String::new();
    // Writing to a String does not fail.
    let _ = write!(text, "{}: {}, ", timeline.source, count(timeline.lines, "line"));
    let _ = if timeline.has_times() {
        write!(text, "{:.1} to {:.1} s", timeline.from_s, timeline.to_s)
    } else {
        write!(text, "without times")
    };
    let _ = match timeline.source {
        super::Source::Defmt => writeln!(text, ", {} damaged", count(timeline.damaged, "frame")),
        super::Source::Text => writeln!(text, ", {}", count(timeline.sentences, "sentence")),
    };
    let _ = if timeline.has_times() {
        writeln!(
            text,
            "{} at {:.1} s{}",
            timeline.state(),
            timeline.to_s,
            aligning(timeline)
        )
    } else {
        writeln!(text, "{} at the end", timeline.state())
    };
    text += &modes(timeline);
    text += &estimates(timeline);
    text += &events(timeline);
    text
}

pub(super) fn count(n: u64, what: &str) -> String {
    format!("{n} {what}{}", if n == 1 { "" } else { "s" })
}

/// A time in a table, s.
pub(super) fn seconds(t_s: f64) -> String {
    if t_s.is_nan() {
        "-".to_owned()
    } else {
        format!("{t_s:.3}")
    }
}

/// When something was, where that is known.
fn at(t_s: f64) -> String {
    if t_s.is_nan() {
        String::new()
    } else {
        format!(" at {t_s:.3} s")
    }
}

fn aligning(timeline: &Timeline) -> String {
    let Some(begun) = timeline.first(ModeName::Coarse) else {
        return String::new();
    };
    let began = format!("; began to align at {begun:.1} s");
    match timeline.first(ModeName::Aligned) {
        None => began,
        Some(aligned) => format!("{began}, aligned {:.1} s later", aligned - begun),
    }
}

fn modes(timeline: &Timeline) -> String {
    if timeline.modes.is_empty() {
        return String::new();
    }
    let mut text = format!("\n{:<12}{:>10}{:>10}\n", "mode", "from (s)", "for (s)");
    for span in &timeline.modes {
        let _ = writeln!(
            text,
            "{:<12}{:>10}{:>10}{}",
            span.mode,
            seconds(span.from_s),
            seconds(span.to_s - span.from_s),
            // The line of the result comes before the one of the mode that follows, by less than they have digits for.
            timeline
                .coarse
                .iter()
                .find(|c| span.mode == ModeName::Coarse.as_str() && c.t_s >= span.from_s && c.t_s <= span.to_s)
                .map_or_else(String::new, |c| {
                    format!("   heading {:.2}°, σ {:.2}°", c.heading_deg, c.heading_sd_deg)
                })
        );
    }
    text
}

fn estimates(timeline: &Timeline) -> String {
    let all = &timeline.estimates;
    let Some(last) = all.last() else {
        return "\nno estimate\n".to_owned();
    };
    let mut text = format!(
        "\n{:<12}{:>10}{:>14}{:>12}{:>12}{:>12}\n",
        "estimate", "at (s)", "heading (°)", "σ (°)", "pitch (°)", "roll (°)"
    );
    let mut row = |estimate: &EstimateAt| {
        let attitude = &estimate.attitude;
        let _ = writeln!(
            text,
            "{:<12}{:>10}{:>14.3}{:>12.4}{:>12.3}{:>12.3}",
            estimate.mode.unwrap_or("unknown"),
            seconds(estimate.t_s),
            attitude.heading_deg,
            attitude.heading_sd_deg,
            attitude.pitch_deg,
            attitude.roll_deg
        );
    };
    // The last one always: it is the result.
    let step = all.len().div_ceil(ROWS).max(1);
    all[..all.len() - 1].iter().step_by(step).for_each(&mut row);
    row(last);
    let _ = write!(text, "{}", count(all.len() as u64, "estimate"));
    if let Some((median, longest)) = timeline.intervals_s() {
        let _ = write!(text, ", every {median:.2} s, longest pause {longest:.2} s");
    }
    let limits: Vec<String> = LIMITS_DEG
        .iter()
        .filter_map(|limit| Some(format!("{limit}° from {:.1} s", timeline.below_s(*limit)?)))
        .collect();
    if !limits.is_empty() {
        let _ = write!(text, "\nσ of heading below {} on", limits.join(", "));
    }
    text + "\n"
}

fn events(timeline: &Timeline) -> String {
    let mut text = String::from("\n");
    for fault in timeline.faults.iter().take(EVENTS) {
        let _ = writeln!(
            text,
            "fault{}: {}{}",
            at(fault.t_s),
            fault.words(),
            match (fault.retry, fault.latched) {
                (Some((attempt, t_s)), _) => format!("; attempt {attempt}{}", at(t_s)),
                (None, true) => "; latched".to_owned(),
                (None, false) => String::new(),
            }
        );
    }
    for (what, said) in [("error", &timeline.errors), ("alignment", &timeline.setbacks)] {
        for said in said.iter().take(EVENTS) {
            let _ = writeln!(text, "{what}{}: {}", at(said.t_s), said.text);
        }
    }
    for start in &timeline.starts {
        let cause = start.cause.as_deref().unwrap_or("a cause that the log does not tell");
        let _ = writeln!(text, "start{} by {cause}", at(start.t_s));
    }
    let s = &timeline.samples;
    let _ = writeln!(
        text,
        "{}, {}; samples: {} lost in {}, {} repeated, {}, {} overrun, {} bridged ({:.1} ms)",
        count(timeline.faults.len() as u64, "fault"),
        count(timeline.resets, "reset"),
        s.lost,
        count(s.gaps, "gap"),
        s.repeated,
        count(s.transfers, "failed transfer"),
        s.overruns,
        count(s.bridged, "gap"),
        s.bridged_ms
    );
    text
}

/// Writes the estimates as CSV.
///
/// # Errors
/// [`InspectError::Write`] where the file cannot be written.
pub fn csv(path: &Path, timeline: &Timeline) -> Result<(), InspectError> {
    let write = || -> Result<(), csv::Error> {
        let mut writer = csv::Writer::from_path(path)?;
        writer.write_record(["t_s", "mode", "heading_deg", "heading_sd_deg", "pitch_deg", "roll_deg"])?;
        for estimate in &timeline.estimates {
            let a = &estimate.attitude;
            writer.serialize((
                Some(estimate.t_s).filter(|t_s| !t_s.is_nan()),
                estimate.mode.unwrap_or("unknown"),
                a.heading_deg,
                a.heading_sd_deg,
                a.pitch_deg,
                a.roll_deg,
            ))?;
        }
        writer.flush()?;
        Ok(())
    };
    write().map_err(|e| InspectError::Write(path.to_owned(), e.to_string()))
}
