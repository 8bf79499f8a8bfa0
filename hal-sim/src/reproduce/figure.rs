//! Line charts of the papers' kind: several curves, linear or logarithmic axes, a legend.

use std::path::Path;

use plotters::coord::Shift;
use plotters::coord::ranged1d::{AsRangedCoord, ValueFormatter};
use plotters::prelude::*;

use crate::plot::PlotError;

// Okabe and Ito's colours, which the colour-blind can tell.
const COLOURS: [RGBColor; 7] = [
    RGBColor(0, 114, 178),
    RGBColor(213, 94, 0),
    RGBColor(0, 158, 115),
    RGBColor(204, 121, 167),
    RGBColor(110, 110, 110),
    RGBColor(86, 180, 233),
    RGBColor(230, 159, 0),
];
const FONT: &str = "sans-serif";

/// One axis.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Axis<'a> {
    /// Quantity and unit.
    pub label: &'a str,
    /// Logarithmic: only values above zero are shown.
    pub log: bool,
    /// Range; all that is drawn where there is none.
    pub range: Option<(f64, f64)>,
}

impl<'a> Axis<'a> {
    /// Linear, over all values.
    pub fn linear(label: &'a str) -> Self {
        Self {
            label,
            log: false,
            range: None,
        }
    }

    /// Logarithmic, over all values.
    pub fn log(label: &'a str) -> Self {
        Self {
            log: true,
            ..Self::linear(label)
        }
    }

    /// With this range.
    #[must_use]
    pub fn within(self, low: f64, high: f64) -> Self {
        Self {
            range: Some((low, high)),
            ..self
        }
    }

    fn limits(&self, values: impl Iterator<Item = f64>) -> (f64, f64) {
        if let Some(range) = self.range {
            return range;
        }
        let shown = values.filter(|v| v.is_finite() && (!self.log || *v > 0.0));
        let (low, high) = shown.fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), v| (l.min(v), h.max(v)));
        if low > high {
            return if self.log { (0.1, 10.0) } else { (-1.0, 1.0) };
        }
        if self.log {
            if high / low < 1.2 {
                (low / 1.5, high * 1.5)
            } else {
                (low, high)
            }
        } else {
            let margin = 0.05 * (high - low).max(1e-9 * high.abs()).max(1e-12);
            (low - margin, high + margin)
        }
    }
}

/// One curve.
#[derive(Debug, Clone, PartialEq)]
pub struct Curve {
    /// What it is, for the legend; none without.
    pub label: String,
    /// Its points.
    pub points: Vec<(f64, f64)>,
    /// Thin: one of many, as the runs of a Monte Carlo are.
    pub thin: bool,
    /// Which colour: those with equal numbers have the same.
    pub colour: usize,
}

/// One panel.
#[derive(Debug, Clone, PartialEq)]
pub struct Chart<'a> {
    /// Caption.
    pub title: &'a str,
    /// Across.
    pub x: Axis<'a>,
    /// Upward.
    pub y: Axis<'a>,
    /// Curves, each over the ones before.
    pub curves: Vec<Curve>,
}

fn draw(area: &DrawingArea<SVGBackend<'_>, Shift>, chart: &Chart<'_>) -> Result<(), PlotError> {
    let points = || chart.curves.iter().flat_map(|c| c.points.iter());
    let (x0, x1) = chart.x.limits(points().map(|p| p.0));
    let (y0, y1) = chart.y.limits(points().map(|p| p.1));
    // The library has a type of its own for each kind of axis.
    match (chart.x.log, chart.y.log) {
        (false, false) => panel(area, chart, x0..x1, y0..y1),
        (true, false) => panel(area, chart, (x0..x1).log_scale(), y0..y1),
        (false, true) => panel(area, chart, x0..x1, (y0..y1).log_scale()),
        (true, true) => panel(area, chart, (x0..x1).log_scale(), (y0..y1).log_scale()),
    }
}

/// A tick's text: no more digits than it needs.
fn tick(v: f64) -> String {
    if v != 0.0 && !(1e-3..1e5).contains(&v.abs()) {
        format!("{v:.0e}")
    } else {
        let text = format!("{v:.4}");
        let text = text.trim_end_matches('0').trim_end_matches('.');
        if text == "-0" { "0".to_owned() } else { text.to_owned() }
    }
}

fn panel<X, Y>(area: &DrawingArea<SVGBackend<'_>, Shift>, chart: &Chart<'_>, x: X, y: Y) -> Result<(), PlotError>
where
    X: AsRangedCoord<Value = f64>,
    Y: AsRangedCoord<Value = f64>,
    X::CoordDescType: ValueFormatter<f64>,
    Y::CoordDescType: ValueFormatter<f64>,
{
    let mut plane = ChartBuilder::on(area)
        .caption(chart.title, (FONT, 16))
        .margin(8)
        .margin_right(24)
        .x_label_area_size(40)
        .y_label_area_size(78)
        .build_cartesian_2d(x, y)?;
    plane
        .configure_mesh()
        .light_line_style(WHITE)
        .bold_line_style(RGBColor(225, 225, 225))
        .x_desc(chart.x.label)
        .y_desc(chart.y.label)
        .x_label_formatter(&|v| tick(*v))
        .y_label_formatter(&|v| tick(*v))
        .label_style((FONT, 13))
        .axis_desc_style((FONT, 14))
        .draw()?;
    let mut labelled = false;
    for curve in &chart.curves {
        let colour = COLOURS[curve.colour % COLOURS.len()];
        let style = colour.stroke_width(if curve.thin { 1 } else { 2 });
        let shown = curve.points.iter().copied().filter(|(x, y)| {
            x.is_finite() && y.is_finite() && (!chart.y.log || *y > 0.0) && (!chart.x.log || *x > 0.0)
        });
        let series = plane.draw_series(LineSeries::new(shown, style))?;
        if !curve.label.is_empty() {
            labelled = true;
            series
                .label(&curve.label)
                .legend(move |(x, y)| PathElement::new([(x, y), (x + 18, y)], colour.stroke_width(2)));
        }
    }
    if labelled {
        plane
            .configure_series_labels()
            .position(SeriesLabelPosition::UpperRight)
            .border_style(RGBColor(180, 180, 180))
            .background_style(WHITE.mix(0.85))
            .label_font((FONT, 13))
            .draw()?;
    }
    Ok(())
}

/// Draws the panels below each other, as SVG.
///
/// # Errors
/// [`PlotError`] where the file cannot be written.
pub fn figure(path: &Path, charts: &[Chart<'_>]) -> Result<(), PlotError> {
    let count = u32::try_from(charts.len()).unwrap_or(u32::MAX);
    let root = SVGBackend::new(path, (900, 320 * count)).into_drawing_area();
    root.fill(&WHITE)?;
    for (area, chart) in root.split_evenly((charts.len(), 1)).iter().zip(charts) {
        draw(area, chart)?;
    }
    root.present()?;
    Ok(())
}
