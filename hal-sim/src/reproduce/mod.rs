//! The papers' results, reproduced: every published figure beside ours.
//!
//! A [`Reproduction`] is a name and a function. It computes with the library and the core, as anything else does, and
//! returns [`Row`]s; what is published is data beside it and never enters a computation. [`ALL`] lists them;
//! [`run`] runs those that are asked for; [`table`] prints them.
//!
//! ```text
//! name ─► Reproduction::run(&mut Context) ─► Vec<Row> ─► Report ─► table, JSON
//!                             └─► plots and curves in the folder of the report
//! ```
//!
//! Names begin with the paper's short name (`du16`, `du17`, `xing18`, `yu15`), so that the short name alone selects all
//! that belongs to the paper.
//!
//! # Verdicts
//!
//! Each row carries the [`Criterion`] by which it is judged, and a row that differs carries a sentence that says why.
//! An experiment on a device that we do not have can only agree in its size ([`Criterion::Factor`]); what follows from a
//! model must agree in its digits.

mod du16;
mod du17;
mod xing18;
mod yu15;

use std::fs;
use std::io;
use std::path::{Path, PathBuf};
use std::time::Instant;

use serde::{Serialize, Serializer};

use crate::plot::{PlotError, Svg, Width};
use crate::report::page::{Page, Plot, Tone};
use crate::report::{self, ReportError};

/// All reproductions, in the order in which they run and print.
pub const ALL: &[Reproduction] = &[
    du16::TABLE_1,
    du16::CALIBRATION,
    du16::NAVIGATION,
    du17::OBSERVABILITY,
    du17::ZUPT,
    du17::ACCELERATION,
    xing18::SIMULATION,
    xing18::TURNTABLE,
    xing18::ALLAN,
    xing18::IRREGULARITY,
    xing18::CHOICES,
    yu15::CLOSED_FORMS,
    yu15::CURVES,
    yu15::NORTH_FINDING,
];

/// One reproduction: some tables or figures of one paper.
#[derive(Debug, Clone, Copy)]
pub struct Reproduction {
    /// Name on the command line: the paper's short name, then what it is, as in `du17-zupt`.
    pub name: &'static str,
    /// What is reproduced, in one line.
    pub what: &'static str,
    /// Computes it.
    pub run: fn(&mut Context<'_>) -> Result<Vec<Row>, ReproduceError>,
}

/// By what a row is judged.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Criterion {
    /// Equal, as ranks and counts are.
    Exact,
    /// |ours − published| ≤ x |published|.
    Relative(f64),
    /// |ours − published| ≤ x, in the row's unit.
    Absolute(f64),
    /// Of the same size: the ratio lies within [1/x, x].
    Factor(f64),
    /// An error, the smaller the better: ours may exceed what is published by x |published| at most.
    AtMost(f64),
    /// Nothing is published to compare with; or nothing comparable.
    None,
}

impl core::fmt::Display for Criterion {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match *self {
            Self::Exact => write!(f, "equal"),
            Self::Relative(x) => write!(f, "±{} %", 100.0 * x),
            Self::Absolute(x) if x < 1e-3 => write!(f, "±{x:e}"),
            Self::Absolute(x) => write!(f, "±{x}"),
            Self::Factor(x) => write!(f, "factor {x}"),
            Self::AtMost(x) => write!(f, "at most +{} %", 100.0 * x),
            Self::None => write!(f, "-"),
        }
    }
}

impl Serialize for Criterion {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_str(self)
    }
}

/// What the comparison says.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Verdict {
    /// Meets its criterion.
    Agrees,
    /// An error that is smaller than the published one by more than the criterion's margin.
    Better,
    /// Does not meet its criterion; the remark says why.
    Differs,
    /// Nothing published to compare with.
    Ours,
}

impl core::fmt::Display for Verdict {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.pad(match self {
            Self::Agrees => "agrees",
            Self::Better => "better",
            Self::Differs => "DIFFERS",
            Self::Ours => "-",
        })
    }
}

/// One published figure, and ours.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Row {
    /// Paper and table, figure or equation, as in `[Du17] Table 1`.
    pub source: String,
    /// What it is a figure of.
    pub quantity: String,
    /// Unit of both figures; empty for numbers.
    pub unit: &'static str,
    /// The published figure, where there is one.
    pub published: Option<f64>,
    /// Ours.
    pub ours: f64,
    /// By what they are compared.
    pub criterion: Criterion,
    /// What the comparison says.
    pub verdict: Verdict,
    /// Why they differ, or what else is to be known; may be empty where they agree.
    pub remark: String,
}

impl Row {
    /// A row, judged by `criterion`.
    pub fn new(
        source: impl Into<String>,
        quantity: impl Into<String>,
        unit: &'static str,
        published: Option<f64>,
        ours: f64,
        criterion: Criterion,
    ) -> Self {
        let verdict = published.map_or(Verdict::Ours, |published| judge(published, ours, criterion));
        Self {
            source: source.into(),
            quantity: quantity.into(),
            unit,
            published,
            ours,
            criterion,
            verdict,
            remark: String::new(),
        }
    }

    /// The row with a sentence on it.
    #[must_use]
    pub fn remark(mut self, remark: impl Into<String>) -> Self {
        self.remark = remark.into();
        self
    }

    /// The row with a sentence on it where it differs.
    #[must_use]
    pub fn remark_if_differs(self, remark: impl Into<String>) -> Self {
        if self.verdict == Verdict::Differs {
            self.remark(remark)
        } else {
            self
        }
    }
}

fn judge(published: f64, ours: f64, criterion: Criterion) -> Verdict {
    let agrees = |yes| if yes { Verdict::Agrees } else { Verdict::Differs };
    match criterion {
        Criterion::Exact => agrees(ours.total_cmp(&published).is_eq()),
        Criterion::Relative(x) => agrees((ours - published).abs() <= x * published.abs()),
        Criterion::Absolute(x) => agrees((ours - published).abs() <= x),
        Criterion::Factor(x) => {
            let ratio = ours / published;
            agrees(ratio >= x.recip() && ratio <= x)
        }
        Criterion::AtMost(x) => {
            let margin = x * published.abs();
            if ours.abs() < published.abs() - margin {
                Verdict::Better
            } else {
                agrees(ours.abs() <= published.abs() + margin)
            }
        }
        Criterion::None => Verdict::Ours,
    }
}

/// What a reproduction is given: a seed, a folder for its plots, someone to tell of progress.
pub struct Context<'a> {
    /// Seed of every chance.
    pub seed: u64,
    out: Option<&'a Path>,
    told: &'a (dyn Fn(&str) + Sync),
    files: Vec<PathBuf>,
    plots: Vec<Plot>,
}

impl core::fmt::Debug for Context<'_> {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.debug_struct("Context")
            .field("seed", &self.seed)
            .field("out", &self.out)
            .field("files", &self.files)
            .finish_non_exhaustive()
    }
}

impl<'a> Context<'a> {
    /// Plots go to the folder `out`, which must exist; without one, none are drawn.
    pub fn new(seed: u64, out: Option<&'a Path>, told: &'a (dyn Fn(&str) + Sync)) -> Self {
        Self {
            seed,
            out,
            told,
            files: Vec::new(),
            plots: Vec::new(),
        }
    }

    /// Says what is being done: one short line.
    pub fn tell(&self, what: &str) {
        (self.told)(what);
    }

    /// Draws a plot as `file` in the report's folder, where there is one.
    ///
    /// # Errors
    /// [`ReproduceError::Plot`] where it cannot be drawn.
    pub fn plot(&mut self, file: &str, draw: impl Fn(Width) -> Result<Svg, PlotError>) -> Result<(), ReproduceError> {
        let Some(out) = self.out else { return Ok(()) };
        let path = out.join(file);
        let drawn = Plot::draw(file, "", draw).and_then(|plot| plot.svg().save(&path).map(|()| plot));
        self.plots
            .push(drawn.map_err(|e| ReproduceError::Plot(path.clone(), e))?);
        self.files.push(path);
        Ok(())
    }

    /// Writes the numbers of a plot as a CSV `file` in the report's folder, where there is one.
    ///
    /// # Errors
    /// [`ReproduceError::Io`] where it cannot be written.
    pub fn csv<'r>(
        &mut self,
        file: &str,
        header: &[&str],
        rows: impl IntoIterator<Item = &'r [f64]>,
    ) -> Result<(), ReproduceError> {
        let Some(out) = self.out else { return Ok(()) };
        let path = out.join(file);
        let mut text = header.join(",");
        text.push('\n');
        for row in rows {
            let fields: Vec<String> = row.iter().map(|x| format!("{x:.9e}")).collect();
            text += &fields.join(",");
            text.push('\n');
        }
        fs::write(&path, text).map_err(|e| ReproduceError::Io(path.clone(), e))?;
        self.files.push(path);
        Ok(())
    }
}

/// Why nothing was reproduced.
#[derive(Debug)]
pub enum ReproduceError {
    /// No reproduction has this name.
    Unknown(String),
    /// A file or folder.
    Io(PathBuf, io::Error),
    /// A plot.
    Plot(PathBuf, PlotError),
    /// A computation or simulation that should have succeeded.
    Failed(Box<dyn core::error::Error + Send + Sync>),
}

impl ReproduceError {
    /// A computation that failed.
    pub fn failed(error: impl core::error::Error + Send + Sync + 'static) -> Self {
        Self::Failed(Box::new(error))
    }
}

impl core::fmt::Display for ReproduceError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            Self::Unknown(name) => {
                write!(f, "nothing to reproduce is called {name}; there is")?;
                for (k, r) in ALL.iter().enumerate() {
                    write!(f, "{} {}", if k > 0 { "," } else { "" }, r.name)?;
                }
                Ok(())
            }
            Self::Io(path, e) => write!(f, "cannot write {}: {e}", path.display()),
            Self::Plot(path, e) => write!(f, "cannot draw {}: {e}", path.display()),
            Self::Failed(e) => write!(f, "{e}"),
        }
    }
}

impl core::error::Error for ReproduceError {}

/// Results of one reproduction.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Report {
    /// Its name.
    pub name: &'static str,
    /// What is reproduced.
    pub what: &'static str,
    /// Published and ours.
    pub rows: Vec<Row>,
    /// Plots and curves that were written.
    pub files: Vec<PathBuf>,
    /// The plots among them, for a page.
    #[serde(skip)]
    pub plots: Vec<Plot>,
    /// Time it took, s.
    pub seconds: f64,
}

/// The reproductions with this name, or whose names begin with it and a hyphen.
///
/// # Errors
/// [`ReproduceError::Unknown`] where there is none.
pub fn select(name: &str) -> Result<Vec<Reproduction>, ReproduceError> {
    let selected: Vec<_> = ALL
        .iter()
        .filter(|r| r.name == name || r.name.strip_prefix(name).is_some_and(|rest| rest.starts_with('-')))
        .copied()
        .collect();
    if selected.is_empty() {
        return Err(ReproduceError::Unknown(name.to_owned()));
    }
    Ok(selected)
}

/// Runs one reproduction; its plots go to a folder of its name in `out`.
///
/// # Errors
/// [`ReproduceError`] as the reproduction has it.
pub fn run(
    reproduction: &Reproduction,
    seed: u64,
    out: Option<&Path>,
    told: &(dyn Fn(&str) + Sync),
) -> Result<Report, ReproduceError> {
    let begun = Instant::now();
    let folder = out.map(|out| out.join(reproduction.name));
    if let Some(folder) = &folder {
        fs::create_dir_all(folder).map_err(|e| ReproduceError::Io(folder.clone(), e))?;
    }
    let mut context = Context::new(seed, folder.as_deref(), told);
    let rows = (reproduction.run)(&mut context)?;
    Ok(Report {
        name: reproduction.name,
        what: reproduction.what,
        rows,
        files: context.files,
        plots: context.plots,
        seconds: begun.elapsed().as_secs_f64(),
    })
}

/// A number of a table: four significant digits, powers of ten where it is very small or large.
fn number(x: f64) -> String {
    let size = x.abs();
    if x.fract() == 0.0 && size < 1e6 {
        format!("{x}")
    } else if !(1e-3..1e6).contains(&size) {
        format!("{x:.3e}")
    } else {
        let decimals = (3.0 - size.log10().floor()).clamp(0.0, 6.0) as usize;
        format!("{x:.decimals$}")
    }
}

/// Heads of a table.
const HEADS: [&str; 7] = [
    "source",
    "quantity",
    "unit",
    "published",
    "ours",
    "criterion",
    "verdict",
];

/// The lines of a table below [`HEADS`], and the remarks that they count; equal ones once.
fn compared(report: &Report) -> (Vec<[String; 7]>, Vec<&str>) {
    let mut notes: Vec<&str> = Vec::new();
    let lines = report.rows.iter().map(|row| {
        let note = if row.remark.is_empty() {
            String::new()
        } else {
            let at = notes.iter().position(|n| *n == row.remark).unwrap_or_else(|| {
                notes.push(&row.remark);
                notes.len() - 1
            });
            format!(" [{}]", at + 1)
        };
        [
            row.source.clone(),
            row.quantity.clone(),
            row.unit.to_owned(),
            row.published.map_or("-".to_owned(), number),
            number(row.ours),
            row.criterion.to_string(),
            format!("{}{note}", row.verdict),
        ]
    });
    (lines.collect(), notes)
}

/// The table of one report, with its remarks below.
pub fn table(report: &Report) -> String {
    // Columns as wide as their widest entry, counted in characters: units and Greek letters are not ASCII.
    let (mut lines, notes) = compared(report);
    lines.insert(0, HEADS.map(str::to_owned));
    let width: [usize; 7] = core::array::from_fn(|k| lines.iter().map(|l| l[k].chars().count()).max().unwrap_or(0));
    let mut text = format!("{}: {}\n", report.name, report.what);
    for line in &lines {
        for (k, field) in line.iter().enumerate() {
            let w = width[k];
            match k {
                3 | 4 => text += &format!("{field:>w$}  "),
                6 => text += field,
                _ => text += &format!("{field:<w$}  "),
            }
        }
        text.truncate(text.trim_end().len());
        text.push('\n');
    }
    for (k, note) in notes.iter().enumerate() {
        text += &format!("[{}] {note}\n", k + 1);
    }
    text
}

/// Writes all of it as one page, `report.html` in `out`; `command` makes it again.
///
/// # Errors
/// [`ReportError`] names the file.
pub fn page(out: &Path, reports: &[Report], command: &str) -> Result<(), ReportError> {
    let mut page = Page::new("The papers, reproduced", "Published figures beside ours");
    let differs = reports
        .iter()
        .flat_map(|r| &r.rows)
        .any(|row| row.verdict == Verdict::Differs);
    let tone = if differs { Tone::Plain } else { Tone::Good };
    page.verdict(tone, "Compared:", summary(reports).trim_end());
    for report in reports {
        page.section(&format!("{}: {}", report.name, report.what));
        let (lines, notes) = compared(report);
        page.table("", &HEADS, &lines.into_iter().map(Vec::from).collect::<Vec<_>>());
        for (k, note) in notes.iter().enumerate() {
            page.paragraph(&format!("[{}] {note}", k + 1));
        }
        report.plots.iter().for_each(|plot| page.plot(plot));
    }
    page.section("Made by");
    page.code(command);
    report::written(out, &page)
}

/// The closing line over all reports: how many rows there are of each verdict.
pub fn summary(reports: &[Report]) -> String {
    let count = |verdict| {
        reports
            .iter()
            .flat_map(|r| &r.rows)
            .filter(|row| row.verdict == verdict)
            .count()
    };
    let [agrees, better, differs, ours] =
        [Verdict::Agrees, Verdict::Better, Verdict::Differs, Verdict::Ours].map(count);
    format!(
        "{} figures: {agrees} agree, {better} better than published, {differs} differ, {ours} not published; {:.1} s\n",
        agrees + better + differs + ours,
        reports.iter().map(|r| r.seconds).sum::<f64>()
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn verdicts() {
        let verdict = |published, ours, criterion| Row::new("", "", "", Some(published), ours, criterion).verdict;
        assert_eq!(verdict(8.0, 8.0, Criterion::Exact), Verdict::Agrees);
        assert_eq!(verdict(8.0, 9.0, Criterion::Exact), Verdict::Differs);
        assert_eq!(verdict(-100.0, -101.0, Criterion::Relative(0.01)), Verdict::Agrees);
        assert_eq!(verdict(-100.0, -101.1, Criterion::Relative(0.01)), Verdict::Differs);
        assert_eq!(verdict(0.0, 0.2, Criterion::Absolute(0.1)), Verdict::Differs);
        assert_eq!(verdict(2.0, 1.1, Criterion::Factor(2.0)), Verdict::Agrees);
        assert_eq!(verdict(2.0, -2.0, Criterion::Factor(2.0)), Verdict::Differs);
        assert_eq!(verdict(2.0, 4.1, Criterion::Factor(2.0)), Verdict::Differs);
        assert_eq!(verdict(1.0, 0.5, Criterion::AtMost(0.1)), Verdict::Better);
        assert_eq!(verdict(1.0, 0.95, Criterion::AtMost(0.1)), Verdict::Agrees);
        assert_eq!(verdict(1.0, 1.2, Criterion::AtMost(0.1)), Verdict::Differs);
        assert_eq!(verdict(1.0, f64::NAN, Criterion::Factor(2.0)), Verdict::Differs);
        assert_eq!(verdict(1.0, f64::NAN, Criterion::AtMost(0.1)), Verdict::Differs);
        assert_eq!(Row::new("", "", "", None, 1.0, Criterion::Exact).verdict, Verdict::Ours);
    }

    #[test]
    fn equal_remarks_are_printed_once() {
        let row = |ours, remark: &str| Row::new("[A] 1", "q", "°", Some(1.0), ours, Criterion::Exact).remark(remark);
        let report = Report {
            name: "a-b",
            what: "what",
            rows: vec![
                row(2.0, "Because."),
                row(3.0, "Because."),
                row(4.0, "Else."),
                row(1.0, ""),
            ],
            files: Vec::new(),
            plots: Vec::new(),
            seconds: 1.0,
        };
        let text = table(&report);
        assert_eq!(text.matches("Because.").count(), 1);
        assert_eq!(text.matches("DIFFERS [1]").count(), 2);
        assert_eq!(text.matches("DIFFERS [2]").count(), 1);
        assert!(summary(&[report]).starts_with("4 figures: 1 agree, 0 better than published, 3 differ"));
    }

    #[test]
    fn names_select_by_paper() {
        let mut names: Vec<_> = ALL.iter().map(|r| r.name).collect();
        for name in &names {
            assert!(select(name).is_ok_and(|s| s.iter().any(|r| r.name == *name)));
        }
        names.sort_unstable();
        names.dedup();
        assert_eq!(names.len(), ALL.len(), "two reproductions of one name");
        assert!(matches!(select("nothing"), Err(ReproduceError::Unknown(_))));
    }

    #[test]
    fn what_differs_says_why() {
        for reproduction in select("du17").unwrap().iter().chain(&select("yu15").unwrap()) {
            let report = run(reproduction, 1, None, &|_| ()).unwrap();
            assert!(!report.rows.is_empty() && report.files.is_empty());
            for row in &report.rows {
                assert!(row.ours.is_finite(), "{row:?}");
                assert!(row.verdict != Verdict::Differs || !row.remark.is_empty(), "{row:?}");
            }
        }
    }

    #[test]
    fn numbers_keep_four_digits() {
        assert_eq!(number(8.0), "8");
        assert_eq!(number(-1786.7), "-1787");
        assert_eq!(number(0.0891), "0.08910");
        assert_eq!(number(3.17e-5), "3.170e-5");
    }
}
