//! Line charts of the papers' kind: several curves, linear or logarithmic axes, a legend beside the plane.

use std::path::Path;

use plotters::coord::Shift;
use plotters::coord::ranged1d::{AsRangedCoord, ValueFormatter};
use plotters::prelude::*;

use crate::plot::PlotError;

// Okabe and Ito's colours, which the colour-blind can tell.
const COLOURS: [RGBColor; 8] = [
    RGBColor(0, 114, 178),
    RGBColor(213, 94, 0),
    RGBColor(0, 158, 115),
    RGBColor(204, 121, 167),
    RGBColor(110, 110, 110),
    RGBColor(86, 180, 233),
    RGBColor(230, 159, 0),
    RGBColor(0, 0, 0),
];
const FONT: &str = "sans-serif";
/// Size of the legend's letters, its first line below the top of the panel and the distance of its lines, pixels.
const LEGEND_FONT: u32 = 13;
const LEGEND_TOP: i32 = 36;
const LEGEND_LINE: i32 = 18;

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
    // Beside the plane, where no curve can be under it.
    let (plane, beside) = area.split_horizontally(area.dim_in_pixel().0.saturating_sub(legend_width(chart)));
    legend(&beside, chart)?;
    // On a logarithmic axis small values are not rounding.
    let spans = [(chart.x.log, x1 - x0), (chart.y.log, y1 - y0)].map(|(log, span)| if log { 0.0 } else { span });
    // The library has a type of its own for each kind of axis.
    match (chart.x.log, chart.y.log) {
        (false, false) => panel(&plane, chart, spans, x0..x1, y0..y1),
        (true, false) => panel(&plane, chart, spans, (x0..x1).log_scale(), y0..y1),
        (false, true) => panel(&plane, chart, spans, x0..x1, (y0..y1).log_scale()),
        (true, true) => panel(&plane, chart, spans, (x0..x1).log_scale(), (y0..y1).log_scale()),
    }
}

/// A tick's text: no more digits than it needs. Where an axis of this `span` crosses zero, the ticks' sum of steps misses
/// it by rounding.
fn tick(v: f64, span: f64) -> String {
    let v = if v.abs() < 1e-9 * span { 0.0 } else { v };
    if v != 0.0 && !(1e-3..1e5).contains(&v.abs()) {
        format!("{v:.0e}")
    } else {
        let text = format!("{v:.4}");
        let text = text.trim_end_matches('0').trim_end_matches('.');
        if text == "-0" { "0".to_owned() } else { text.to_owned() }
    }
}

/// Draws the legend from the top of its area down, and tells nothing where it is full.
fn legend(area: &DrawingArea<SVGBackend<'_>, Shift>, chart: &Chart<'_>) -> Result<(), PlotError> {
    let height = i32::try_from(area.dim_in_pixel().1).unwrap_or(i32::MAX);
    for (line, curve) in (0..).zip(chart.curves.iter().filter(|c| !c.label.is_empty())) {
        let y = LEGEND_TOP + LEGEND_LINE * line;
        if y + LEGEND_LINE > height {
            break;
        }
        let colour = COLOURS[curve.colour % COLOURS.len()];
        let style = colour.stroke_width(if curve.thin { 1 } else { 2 });
        area.draw(&PathElement::new([(0, y + 8), (18, y + 8)], style))?;
        area.draw(&Text::new(curve.label.as_str(), (24, y), (FONT, LEGEND_FONT)))?;
    }
    Ok(())
}

/// Width of the legend, pixels: zero where nothing is labelled. Letters of this font are 0.55 of its size wide.
fn legend_width(chart: &Chart<'_>) -> u32 {
    let longest = chart.curves.iter().map(|c| c.label.chars().count()).max().unwrap_or(0);
    if longest == 0 {
        0
    } else {
        32 + u32::try_from(longest).unwrap_or(0) * LEGEND_FONT * 55 / 100
    }
}

fn panel<X, Y>(
    area: &DrawingArea<SVGBackend<'_>, Shift>,
    chart: &Chart<'_>,
    [x_span, y_span]: [f64; 2],
    x: X,
    y: Y,
) -> Result<(), PlotError>
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
        .x_label_formatter(&|v| tick(*v, x_span))
        .y_label_formatter(&|v| tick(*v, y_span))
        .label_style((FONT, 13))
        .axis_desc_style((FONT, 14))
        .draw()?;
    for curve in &chart.curves {
        let colour = COLOURS[curve.colour % COLOURS.len()];
        let style = colour.stroke_width(if curve.thin { 1 } else { 2 });
        let shown = curve.points.iter().copied().filter(|(x, y)| {
            x.is_finite() && y.is_finite() && (!chart.y.log || *y > 0.0) && (!chart.x.log || *x > 0.0)
        });
        plane.draw_series(LineSeries::new(shown, style))?;
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ticks_are_short_and_zero_is_zero() {
        for (v, span, text) in [
            (-6e-17, 0.4, "0"),
            (6e-17, 0.4, "0"),
            (-0.0, 1.0, "0"),
            (0.05, 0.4, "0.05"),
            (-20.0, 100.0, "-20"),
            (2e-7, 1e-6, "2e-7"),
            (2e-7, 0.0, "2e-7"),
            (3e6, 1e7, "3e6"),
        ] {
            assert_eq!(tick(v, span), text, "{v} of {span}");
        }
    }

    #[test]
    fn the_legend_is_beside_the_plane() {
        let dir = tempfile::TempDir::new().unwrap();
        let path = dir.path().join("f.svg");
        let curve = |label: &str| Curve {
            label: label.to_owned(),
            points: vec![(0.0, 0.0), (10.0, 1.0)],
            thin: false,
            colour: 0,
        };
        let chart = |curves| Chart {
            title: "title",
            x: Axis::linear("x").within(0.0, 10.0),
            y: Axis::linear("y").within(0.0, 1.0),
            curves,
        };
        // The right end of the curve, which goes to the plane's corner: further left by the legend's width.
        let right = |curves: Vec<Curve>| -> f64 {
            let width = legend_width(&chart(curves.clone()));
            figure(&path, &[chart(curves)]).unwrap();
            let text = std::fs::read_to_string(&path).unwrap();
            let numbers = text
                .lines()
                .filter(|line| line.contains("polyline"))
                .filter_map(|line| line.split("points=\"").nth(1))
                .flat_map(|points| {
                    points
                        .split(['"', ' ', ','])
                        .filter_map(|n| n.parse::<f64>().ok())
                        .step_by(2)
                });
            let plane_right = numbers.filter(|x| *x < f64::from(900 - width)).fold(0.0, f64::max);
            assert_eq!(text.contains("a curve of some kind"), width > 0);
            plane_right
        };
        let (without, with) = (right(vec![curve("")]), right(vec![curve("a curve of some kind")]));
        let width = f64::from(legend_width(&chart(vec![curve("a curve of some kind")])));
        assert!(
            width > 100.0 && (without - with - width).abs() < 2.0,
            "{without} {with} {width}"
        );
    }
}
