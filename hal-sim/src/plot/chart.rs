//! Line charts: several curves in panels below each other, linear or logarithmic axes, a legend beside the plane.

use plotters::prelude::*;

use super::plane::{self, Key, Plane, Scale, Spacing};
use super::sheet::{Area, BLUE, GREEN, GREY, INK, ORANGE, PURPLE, SKY, TICK, VERMILION, text_width};
use super::{PlotError, Svg, Width};

const COLOURS: [RGBColor; 8] = [BLUE, VERMILION, GREEN, PURPLE, GREY, SKY, ORANGE, INK];
/// The legend's first line below the top of the panel and the distance of its lines, pixels.
const LEGEND_TOP: i32 = 42;
const LEGEND_LINE: i32 = 20;

/// One axis.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Axis<'a> {
    /// Quantity and unit.
    pub(crate) label: &'a str,
    /// How values lie on it.
    spacing: Spacing,
    /// Range; all that is drawn where there is none.
    pub(crate) range: Option<(f64, f64)>,
}

impl<'a> Axis<'a> {
    /// Linear, over all values.
    pub(crate) fn linear(label: &'a str) -> Self {
        Self {
            label,
            spacing: Spacing::Linear,
            range: None,
        }
    }

    /// Linear, over all values, which are whole numbers: of runs, for instance.
    pub(crate) fn whole(label: &'a str) -> Self {
        Self {
            spacing: Spacing::Whole,
            ..Self::linear(label)
        }
    }

    /// Logarithmic, over all values.
    pub(crate) fn log(label: &'a str) -> Self {
        Self {
            spacing: Spacing::Log,
            ..Self::linear(label)
        }
    }

    /// With this range.
    #[must_use]
    pub(crate) fn within(self, low: f64, high: f64) -> Self {
        Self {
            range: Some((low, high)),
            ..self
        }
    }

    fn scale(&self, values: impl Iterator<Item = f64>) -> Scale<'a> {
        Scale {
            label: self.label,
            spacing: self.spacing,
            range: self.limits(values),
        }
    }

    fn limits(&self, values: impl Iterator<Item = f64>) -> (f64, f64) {
        if let Some(range) = self.range {
            return range;
        }
        let log = self.spacing == Spacing::Log;
        let shown = values.filter(|v| v.is_finite() && (!log || *v > 0.0));
        let (low, high) = shown.fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), v| (l.min(v), h.max(v)));
        if low > high {
            return if log { (0.1, 10.0) } else { (-1.0, 1.0) };
        }
        if log {
            let margin = if high / low < 1.2 { 1.5 } else { (high / low).powf(0.04) };
            (low / margin, high * margin)
        } else {
            let margin = 0.05 * (high - low).max(1e-9 * high.abs()).max(1e-12);
            (low - margin, high + margin)
        }
    }
}

/// One curve.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Curve {
    /// What it is, for the legend; none without.
    pub(crate) label: String,
    /// Its points.
    pub(crate) points: Vec<(f64, f64)>,
    /// Thin: one of many, as the runs of a Monte Carlo are.
    pub(crate) thin: bool,
    /// Which colour: those with equal numbers have the same.
    pub(crate) colour: usize,
}

/// One panel.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Chart<'a> {
    /// Caption.
    pub(crate) title: &'a str,
    /// Across.
    pub(crate) x: Axis<'a>,
    /// Upward.
    pub(crate) y: Axis<'a>,
    /// Curves, each over the ones before.
    pub(crate) curves: Vec<Curve>,
}

impl Curve {
    fn style(&self) -> ShapeStyle {
        COLOURS[self.colour % COLOURS.len()].stroke_width(if self.thin { 1 } else { 2 })
    }
}

/// The entries of a chart's legend.
fn keys<'a>(chart: &'a Chart<'_>) -> Vec<Key<'a>> {
    let labelled = chart.curves.iter().filter(|c| !c.label.is_empty());
    let key = |curve: &'a Curve| Key {
        text: &curve.label,
        style: curve.style(),
    };
    labelled.map(key).collect()
}

fn draw(area: &Area<'_>, width: Width, chart: &Chart<'_>) -> Result<(), PlotError> {
    let points = || chart.curves.iter().flat_map(|c| c.points.iter());
    let x = chart.x.scale(points().map(|p| p.0));
    let y = chart.y.scale(points().map(|p| p.1));
    let keys = keys(chart);
    // Beside the plane where there is room, else above it: no curve is under it.
    let mut plane = match width {
        Width::Page => {
            let (left, beside) = area.split_horizontally(area.dim_in_pixel().0.saturating_sub(legend_width(&keys)));
            for (line, key) in (0..).zip(&keys) {
                plane::draw_key(&beside, key, (0, LEGEND_TOP + LEGEND_LINE * line))?;
            }
            Plane::new(&left, chart.title, &[], x, y)?
        }
        Width::Phone => Plane::new(area, chart.title, &keys, x, y)?,
    };
    for curve in &chart.curves {
        plane.line(curve.points.iter().copied(), curve.style())?;
    }
    Ok(())
}

/// Width of the legend, pixels: zero where nothing is labelled.
fn legend_width(keys: &[Key<'_>]) -> u32 {
    keys.iter()
        .map(|key| 36 + text_width(key.text, TICK))
        .max()
        .unwrap_or(0)
}

/// Draws the panels below each other.
///
/// # Errors
/// [`PlotError`] where the drawing library fails.
pub(crate) fn figure(width: Width, charts: &[Chart<'_>]) -> Result<Svg, PlotError> {
    let count = u32::try_from(charts.len()).unwrap_or(u32::MAX);
    // A legend above takes nothing from the plane.
    let above = |chart: &Chart<'_>| match width {
        Width::Page => 0,
        Width::Phone => plane::legend_height(&keys(chart), width.pixels()),
    };
    let height = 320 + charts.iter().map(above).max().unwrap_or(0);
    Svg::draw((width.pixels(), height * count), |sheet| {
        let areas = sheet.split_evenly((charts.len(), 1));
        areas
            .iter()
            .zip(charts)
            .try_for_each(|(area, chart)| draw(area, width, chart))
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The largest x of the curves.
    fn right(width: Width, label: &str) -> f64 {
        let chart = Chart {
            title: "title",
            x: Axis::linear("x").within(0.0, 10.0),
            y: Axis::linear("y").within(0.0, 1.0),
            curves: vec![Curve {
                label: label.to_owned(),
                points: vec![(0.0, 0.0), (10.0, 1.0)],
                thin: false,
                colour: 0,
            }],
        };
        let svg = figure(width, &[chart]).unwrap();
        assert_eq!(svg.element().contains("a curve of some kind"), !label.is_empty());
        let curves = svg
            .element()
            .lines()
            .filter(|line| line.contains("polyline") && line.contains("#0072B2"));
        let points = curves.filter_map(|line| line.split("points=\"").nth(1));
        let xs = points.flat_map(|points| points.split(' ').filter_map(|p| p.split(',').next()?.parse().ok()));
        // A legend's own line has two points at one height, and is not wider than it.
        xs.filter(|x: &f64| label.is_empty() || *x < 700.0).fold(0.0, f64::max)
    }

    /// Height of the sheet of a chart with so many curves.
    fn height(width: Width, curves: usize) -> u32 {
        let curve = |k: usize| Curve {
            label: format!("curve {k} of a chart that has many"),
            points: vec![(0.0, 0.0), (1.0, 1.0)],
            thin: false,
            colour: k,
        };
        let chart = Chart {
            title: "title",
            x: Axis::linear("x"),
            y: Axis::linear("y"),
            curves: (0..curves).map(curve).collect(),
        };
        let svg = figure(width, &[chart]).unwrap();
        let height = svg.element().split("height=\"").nth(1).unwrap();
        height.split('"').next().unwrap().parse().unwrap()
    }

    #[test]
    fn a_long_legend_does_not_squash_the_plane() {
        assert_eq!(height(Width::Page, 1), height(Width::Page, 8));
        assert_eq!(height(Width::Phone, 8) - height(Width::Phone, 1), 7 * 20);
    }

    #[test]
    fn the_legend_is_beside_the_plane_of_a_page_and_above_that_of_a_telephone() {
        let label = "a curve of some kind";
        let keys = [Key {
            text: label,
            style: INK.stroke_width(1),
        }];
        let legend = f64::from(legend_width(&keys));
        let (without, with) = (right(Width::Page, ""), right(Width::Page, label));
        assert!(
            legend > 100.0 && (without - with - legend).abs() < 2.0,
            "{without} {with} {legend}"
        );
        assert_eq!(right(Width::Phone, ""), right(Width::Phone, label));
    }
}
