//! Plots as one would put them in a paper: SVG, labelled with units, in colours that the colour-blind can tell.

use std::path::Path;

use plotters::coord::Shift;
use plotters::prelude::*;

use crate::bound::Sigmas;
use crate::simulate::Moment;

/// Why a plot could not be drawn: the drawing library's words.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct PlotError(String);

impl core::fmt::Display for PlotError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.write_str(&self.0)
    }
}

impl core::error::Error for PlotError {}

impl<E: core::error::Error + Send + Sync> From<DrawingAreaErrorKind<E>> for PlotError {
    fn from(e: DrawingAreaErrorKind<E>) -> Self {
        Self(e.to_string())
    }
}

// Okabe and Ito's colours.
const BLUE: RGBColor = RGBColor(0, 114, 178);
const ORANGE: RGBColor = RGBColor(213, 94, 0);
const GREY: RGBColor = RGBColor(110, 110, 110);
const FONT: &str = "sans-serif";

type Area<'a> = DrawingArea<SVGBackend<'a>, Shift>;

/// One panel: lines over time, with a band of ±bound.
struct Panel<'a> {
    title: &'a str,
    unit: &'a str,
    line: Vec<(f64, f64)>,
    reference: Vec<(f64, f64)>,
    /// (t, centre, half width).
    band: Vec<(f64, f64, f64)>,
}

/// The range of a panel's values: all of the line, and the band of its later half, so that the first seconds do not
/// flatten the rest.
fn range(panel: &Panel<'_>) -> (f64, f64) {
    let late = panel.band.len() / 4;
    let values = panel
        .line
        .iter()
        .skip(panel.line.len() / 8)
        .chain(panel.reference.iter())
        .map(|(_, y)| *y)
        .chain(panel.band.iter().skip(late).flat_map(|(_, c, h)| [c - h, c + h]));
    let (low, high) = values
        .filter(|y| y.is_finite())
        .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), y| {
            (low.min(y), high.max(y))
        });
    if low > high {
        return (-1.0, 1.0);
    }
    let margin = 0.08 * (high - low).max(1e-6);
    (low - margin, high + margin)
}

fn draw(area: &Area<'_>, panel: &Panel<'_>, x_label: &str) -> Result<(), PlotError> {
    let start = panel.line.first().map_or(0.0, |p| p.0);
    let end = panel.line.last().map_or(1.0, |p| p.0).max(start + 1e-3);
    let (low, high) = range(panel);
    let mut chart = ChartBuilder::on(area)
        .caption(panel.title, (FONT, 16))
        .margin(8)
        .margin_right(24)
        .x_label_area_size(if x_label.is_empty() { 22 } else { 38 })
        .y_label_area_size(70)
        .build_cartesian_2d(start..end, low..high)?;
    chart
        .configure_mesh()
        .light_line_style(WHITE)
        .bold_line_style(RGBColor(225, 225, 225))
        .x_desc(x_label)
        .y_desc(panel.unit)
        .x_label_formatter(&|t| format!("{t:.0}"))
        .label_style((FONT, 13))
        .axis_desc_style((FONT, 14))
        .draw()?;
    if !panel.band.is_empty() {
        let clip = |y: f64| y.clamp(low, high);
        let upper = panel.band.iter().map(|(t, c, h)| (*t, clip(c + h)));
        let lower = panel.band.iter().rev().map(|(t, c, h)| (*t, clip(c - h)));
        chart.draw_series(std::iter::once(Polygon::new(
            upper.chain(lower).collect::<Vec<_>>(),
            BLUE.mix(0.18),
        )))?;
    }
    if !panel.reference.is_empty() {
        chart.draw_series(LineSeries::new(panel.reference.iter().copied(), ORANGE.stroke_width(2)))?;
    }
    let visible = panel.line.iter().copied().map(|(t, y)| (t, y.clamp(low, high)));
    chart.draw_series(LineSeries::new(visible, BLUE.stroke_width(2)))?;
    Ok(())
}

fn figure(path: &Path, panels: &[Panel<'_>]) -> Result<(), PlotError> {
    let count = u32::try_from(panels.len()).unwrap_or(u32::MAX);
    let root = SVGBackend::new(path, (900, 40 + 230 * count)).into_drawing_area();
    root.fill(&WHITE)?;
    for (k, (area, panel)) in root.split_evenly((panels.len(), 1)).iter().zip(panels).enumerate() {
        draw(area, panel, if k + 1 == panels.len() { "time (s)" } else { "" })?;
    }
    root.present()?;
    Ok(())
}

/// Attitude errors with ±3σ.
///
/// # Errors
/// [`PlotError`] where the file cannot be written.
pub fn attitude_error(path: &Path, moments: &[Moment]) -> Result<(), PlotError> {
    let panel = |title, of: fn(&crate::align::Angles) -> f64| Panel {
        title,
        unit: "degrees",
        line: moments.iter().map(|m| (m.t_s, of(&m.error))).collect(),
        reference: Vec::new(),
        band: moments.iter().map(|m| (m.t_s, 0.0, 3.0 * of(&m.reading.sd))).collect(),
    };
    figure(
        path,
        &[
            panel("heading error and ±3σ", |a| a.heading_deg),
            panel("pitch error and ±3σ", |a| a.pitch_deg),
            panel("roll error and ±3σ", |a| a.roll_deg),
        ],
    )
}

/// Gyro biases found, with ±1σ, and true.
///
/// # Errors
/// [`PlotError`] where the file cannot be written.
pub fn biases(path: &Path, moments: &[Moment]) -> Result<(), PlotError> {
    let panel = |title, axis: usize| Panel {
        title,
        unit: "°/h",
        line: moments
            .iter()
            .map(|m| (m.t_s, m.reading.gyro_bias_deg_h[axis]))
            .collect(),
        reference: moments.iter().map(|m| (m.t_s, m.true_gyro_bias_deg_h[axis])).collect(),
        band: moments
            .iter()
            .map(|m| {
                (
                    m.t_s,
                    m.reading.gyro_bias_deg_h[axis],
                    m.reading.gyro_bias_sd_deg_h[axis],
                )
            })
            .collect(),
    };
    figure(
        path,
        &[
            panel("gyro bias x: found with ±1σ (blue), true (orange)", 0),
            panel("gyro bias y", 1),
            panel("gyro bias z", 2),
        ],
    )
}

/// Rotor angle, of (time s, angle degrees).
///
/// # Errors
/// [`PlotError`] where the file cannot be written.
pub fn rotor(path: &Path, angle: &[(f64, f64)]) -> Result<(), PlotError> {
    figure(
        path,
        &[Panel {
            title: "rotor angle",
            unit: "degrees",
            line: angle.to_vec(),
            reference: Vec::new(),
            band: Vec::new(),
        }],
    )
}

/// Heading σ of the ideal filter over time, beside what the angle random walk alone leaves.
///
/// The scale of σ is logarithmic: it begins with a quarter of a circle and ends with a fraction of a degree.
///
/// # Errors
/// [`PlotError`] where the file cannot be written.
pub fn heading_bound(path: &Path, title: &str, curve: &[Sigmas]) -> Result<(), PlotError> {
    let end = curve.last().map_or(1.0, |s| s.t_s);
    let line = |of: fn(&Sigmas) -> f64| -> Vec<(f64, f64)> {
        let points = curve.iter().map(|s| (s.t_s, of(s)));
        points.filter(|(_, y)| *y > 0.0 && y.is_finite()).collect()
    };
    let (sd, simple) = (line(|s| s.sd.heading_deg), line(|s| s.random_walk_limit_deg));
    let (low, high) = sd
        .iter()
        .chain(&simple)
        .fold((f64::INFINITY, 0.0_f64), |(low, high), (_, y)| {
            (low.min(*y), high.max(*y))
        });
    // A scenario without any error has no σ to draw.
    let (low, high) = if low < high {
        (0.7 * low, 1.4 * high)
    } else {
        (0.1, 100.0)
    };
    let root = SVGBackend::new(path, (900, 520)).into_drawing_area();
    root.fill(&WHITE)?;
    let mut chart = ChartBuilder::on(&root)
        .caption(title, (FONT, 18))
        .margin(10)
        .margin_right(24)
        .x_label_area_size(42)
        .y_label_area_size(70)
        .build_cartesian_2d(0.0..end, (low..high).log_scale())?;
    chart
        .configure_mesh()
        .light_line_style(WHITE)
        .bold_line_style(RGBColor(225, 225, 225))
        .x_desc("time (s)")
        .y_desc("heading σ (degrees)")
        .x_label_formatter(&|t| format!("{t:.0}"))
        .y_label_formatter(&|y| format!("{y}"))
        .label_style((FONT, 13))
        .axis_desc_style((FONT, 14))
        .draw()?;
    for (line, colour, name) in [
        (simple, ORANGE, "angle random walk alone, ARW/(ω_ie cos L √T)"),
        (sd, BLUE, "ideal filter"),
    ] {
        chart
            .draw_series(LineSeries::new(line, colour.stroke_width(2)))?
            .label(name)
            .legend(move |(x, y)| PathElement::new([(x, y), (x + 18, y)], colour.stroke_width(2)));
    }
    chart
        .configure_series_labels()
        .position(SeriesLabelPosition::UpperRight)
        .border_style(GREY)
        .background_style(WHITE)
        .label_font((FONT, 13))
        .draw()?;
    root.present()?;
    Ok(())
}

/// Histogram of heading errors in degrees, with the normal densities of the predicted σ and of the ideal filter's.
///
/// # Errors
/// [`PlotError`] where the file cannot be written.
pub fn heading_histogram(
    path: &Path,
    title: &str,
    errors_deg: &[f64],
    predicted_sd_deg: f64,
    bound_deg: f64,
) -> Result<(), PlotError> {
    const BINS: usize = 24;
    let reach = errors_deg
        .iter()
        .fold(3.0 * predicted_sd_deg, |most, e| most.max(e.abs()))
        * 1.05;
    let width = 2.0 * reach / BINS as f64;
    let mut counts = [0_usize; BINS];
    for e in errors_deg {
        let bin = ((e + reach) / width).floor().clamp(0.0, (BINS - 1) as f64);
        counts[bin as usize] += 1;
    }
    let density = |x: f64, sd: f64| {
        let scaled = x / sd;
        errors_deg.len() as f64 * width * (-0.5 * scaled * scaled).exp() / (sd * core::f64::consts::TAU.sqrt())
    };
    // A σ far below the width of the bins is a spike that would flatten all the rest.
    let curves: Vec<_> = [
        // The wider line first: where the filter is ideal the other lies on it.
        (bound_deg, GREY.stroke_width(5), "ideal filter"),
        (predicted_sd_deg, ORANGE.stroke_width(2), "predicted"),
    ]
    .into_iter()
    .filter(|(sd, ..)| *sd > 0.3 * width)
    .collect();
    let top = counts
        .iter()
        .map(|c| *c as f64)
        .chain(curves.iter().map(|(sd, ..)| density(0.0, *sd)))
        .fold(0.0, f64::max)
        * 1.1;
    let root = SVGBackend::new(path, (800, 480)).into_drawing_area();
    root.fill(&WHITE)?;
    let mut chart = ChartBuilder::on(&root)
        .caption(title, (FONT, 18))
        .margin(10)
        .x_label_area_size(42)
        .y_label_area_size(60)
        .build_cartesian_2d(-reach..reach, 0.0..top.max(1.0))?;
    chart
        .configure_mesh()
        .disable_x_mesh()
        .light_line_style(WHITE)
        .bold_line_style(RGBColor(225, 225, 225))
        .x_desc("heading error (degrees)")
        .y_desc("runs")
        .y_label_formatter(&|n| format!("{n:.0}"))
        .label_style((FONT, 13))
        .axis_desc_style((FONT, 14))
        .draw()?;
    chart.draw_series(counts.iter().enumerate().map(|(k, count)| {
        let left = -reach + k as f64 * width;
        Rectangle::new([(left, 0.0), (left + width, *count as f64)], BLUE.mix(0.45).filled())
    }))?;
    for (sd, style, whose) in curves {
        chart
            .draw_series(LineSeries::new(
                (0..=200).map(|k| {
                    let x = reach * (f64::from(k) / 100.0 - 1.0);
                    (x, density(x, sd))
                }),
                style,
            ))?
            .label(format!("normal, {whose} σ = {sd:.3}°"))
            .legend(move |(x, y)| PathElement::new([(x, y), (x + 18, y)], style));
    }
    chart
        .configure_series_labels()
        .position(SeriesLabelPosition::UpperRight)
        .border_style(GREY)
        .background_style(WHITE)
        .label_font((FONT, 13))
        .draw()?;
    root.present()?;
    Ok(())
}
