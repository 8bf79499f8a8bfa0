//! Plots as one would put them in a paper: SVG, labelled with units, in colours that the colour-blind can tell.

use std::path::Path;

use plotters::coord::Shift;
use plotters::prelude::*;

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

/// Histogram of heading errors in degrees, with the normal density of the predicted σ.
///
/// # Errors
/// [`PlotError`] where the file cannot be written.
pub fn heading_histogram(path: &Path, title: &str, errors_deg: &[f64], predicted_sd_deg: f64) -> Result<(), PlotError> {
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
    let density = |x: f64| {
        let scaled = x / predicted_sd_deg;
        errors_deg.len() as f64 * width * (-0.5 * scaled * scaled).exp()
            / (predicted_sd_deg * core::f64::consts::TAU.sqrt())
    };
    let top = counts.iter().map(|c| *c as f64).fold(density(0.0), f64::max) * 1.1;
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
    chart
        .draw_series(LineSeries::new(
            (0..=200).map(|k| {
                let x = reach * (f64::from(k) / 100.0 - 1.0);
                (x, density(x))
            }),
            ORANGE.stroke_width(2),
        ))?
        .label(format!("normal, predicted σ = {predicted_sd_deg:.3}°"))
        .legend(|(x, y)| PathElement::new([(x, y), (x + 18, y)], ORANGE.stroke_width(2)));
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
