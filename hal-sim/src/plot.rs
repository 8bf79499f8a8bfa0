//! Plots as one would put them in a paper: SVG, labelled with units, in colours that the colour-blind can tell, for a
//! light page and a dark one.

pub(crate) mod chart;
pub(crate) mod plane;
pub(crate) mod sheet;

use plotters::prelude::*;

use crate::align::Angles;
use crate::bound::Sigmas;
use crate::replay;
use crate::simulate::Moment;
use plane::{Key, Plane, Scale};
use sheet::{BLUE, GREY, VERMILION};
pub use sheet::{Svg, Width};

/// Why a plot could not be drawn: the drawing library's words, or the system's.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct PlotError(String);

impl PlotError {
    fn new(error: &impl core::error::Error) -> Self {
        Self(error.to_string())
    }
}

impl core::fmt::Display for PlotError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.write_str(&self.0)
    }
}

impl core::error::Error for PlotError {}

impl<E: core::error::Error + Send + Sync> From<DrawingAreaErrorKind<E>> for PlotError {
    fn from(e: DrawingAreaErrorKind<E>) -> Self {
        Self::new(&e)
    }
}

/// One panel: lines over time, with a band of ±bound.
struct Panel<'a> {
    title: &'a str,
    unit: &'a str,
    line: Vec<(f64, f64)>,
    reference: Vec<(f64, f64)>,
    /// (t, centre, half width).
    band: Vec<(f64, f64, f64)>,
}

/// What the lines and the band of panels are called.
struct Legend<'a> {
    line: &'a str,
    reference: &'a str,
    band: &'a str,
}

/// The range of a panel's values: without the first eighth of the line and the first quarter of the band, which would
/// flatten the rest.
fn range(panel: &Panel<'_>) -> (f64, f64) {
    let line = panel.line.iter().skip(panel.line.len() / 8);
    let band = panel.band.iter().skip(panel.band.len() / 4);
    let values = line
        .chain(&panel.reference)
        .map(|(_, y)| *y)
        .chain(band.flat_map(|(_, c, h)| [c - h, c + h]));
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

fn draw(area: &sheet::Area<'_>, panel: &Panel<'_>, keys: &[Key<'_>], x_label: &str) -> Result<(), PlotError> {
    let start = panel.line.first().map_or(0.0, |p| p.0);
    let end = panel.line.last().map_or(1.0, |p| p.0).max(start + 1e-3);
    let (low, high) = range(panel);
    let time = Scale::linear(x_label, start, end);
    let mut plane = Plane::new(area, panel.title, keys, time, Scale::linear(panel.unit, low, high))?;
    if !panel.band.is_empty() {
        let band: Vec<_> = panel.band.iter().map(|(t, c, h)| (*t, c - h, c + h)).collect();
        plane.band(&band, BLUE.mix(0.22).filled())?;
    }
    if !panel.reference.is_empty() {
        plane.line(panel.reference.iter().copied(), VERMILION.stroke_width(2))?;
    }
    plane.line(panel.line.iter().copied(), BLUE.stroke_width(2))
}

/// Panels below each other; the legend stands over the first.
fn figure(width: Width, panels: &[Panel<'_>], legend: &Legend<'_>) -> Result<Svg, PlotError> {
    let all = [
        (legend.line, BLUE.stroke_width(2)),
        (legend.band, BLUE.mix(0.22).filled()),
        (legend.reference, VERMILION.stroke_width(2)),
    ];
    let keys: Vec<_> = all
        .into_iter()
        .filter(|(text, _)| !text.is_empty())
        .map(|(text, style)| Key { text, style })
        .collect();
    let count = u32::try_from(panels.len()).unwrap_or(u32::MAX);
    Svg::draw((width.pixels(), 40 + 230 * count), |sheet| {
        for (k, (area, panel)) in sheet.split_evenly((panels.len(), 1)).iter().zip(panels).enumerate() {
            let last = k + 1 == panels.len();
            let keys = if k == 0 { keys.as_slice() } else { &[] };
            draw(area, panel, keys, if last { "time (s)" } else { "" })?;
        }
        Ok(())
    })
}

/// Attitude errors with ±3σ.
///
/// # Errors
/// [`PlotError`] where the drawing library fails.
pub fn attitude_error(width: Width, moments: &[Moment]) -> Result<Svg, PlotError> {
    let panel = |title, of: fn(&Angles) -> f64| Panel {
        title,
        unit: "error (°)",
        line: moments.iter().map(|m| (m.t_s, of(&m.error))).collect(),
        reference: Vec::new(),
        band: moments.iter().map(|m| (m.t_s, 0.0, 3.0 * of(&m.reading.sd))).collect(),
    };
    figure(
        width,
        &[
            panel("heading", |a| a.heading_deg),
            panel("pitch", |a| a.pitch_deg),
            panel("roll", |a| a.roll_deg),
        ],
        &Legend {
            line: "estimate − truth",
            band: "±3σ, as the filter predicts",
            reference: "",
        },
    )
}

/// A line of (time, value, σ) with so many σ about it.
fn estimated<'a>(
    title: &'a str,
    unit: &'a str,
    values: impl Iterator<Item = (f64, f64, f64)> + Clone,
    sigmas: f64,
) -> Panel<'a> {
    Panel {
        title,
        unit,
        line: values.clone().map(|(t, value, _)| (t, value)).collect(),
        reference: Vec::new(),
        band: values.map(|(t, value, sd)| (t, value, sigmas * sd)).collect(),
    }
}

/// Gyro biases found, with ±1σ, and true.
///
/// # Errors
/// [`PlotError`] where the drawing library fails.
pub fn biases(width: Width, moments: &[Moment]) -> Result<Svg, PlotError> {
    let panel = |title, axis: usize| {
        let found = moments.iter().map(|m| {
            let (bias, sd) = (m.reading.gyro_bias_deg_h, m.reading.gyro_bias_sd_deg_h);
            (m.t_s, bias[axis], sd[axis])
        });
        Panel {
            reference: moments.iter().map(|m| (m.t_s, m.true_gyro_bias_deg_h[axis])).collect(),
            ..estimated(title, "bias (°/h)", found, 1.0)
        }
    };
    figure(
        width,
        &[panel("gyro x", 0), panel("gyro y", 1), panel("gyro z", 2)],
        &Legend {
            line: "found",
            band: "±1σ",
            reference: "true",
        },
    )
}

/// Heading, pitch and roll of a replay with ±3σ. Heading goes on beyond 0° and 360°.
///
/// # Errors
/// [`PlotError`] where the drawing library fails.
pub fn attitude(width: Width, moments: &[replay::Moment]) -> Result<Svg, PlotError> {
    let panel = |title, of: fn(&Angles) -> f64| {
        let mut before: Option<f64> = None;
        let angles = moments.iter().map(move |m| {
            let angle = of(&m.reading.attitude);
            let near = before.map_or(angle, |before| angle + 360.0 * ((before - angle) / 360.0).round());
            before = Some(near);
            (m.t_s, near, of(&m.reading.sd))
        });
        estimated(title, "angle (°)", angles, 3.0)
    };
    figure(
        width,
        &[
            panel("heading", |a| a.heading_deg),
            panel("pitch", |a| a.pitch_deg),
            panel("roll", |a| a.roll_deg),
        ],
        &Legend {
            line: "estimate",
            band: "±3σ",
            reference: "",
        },
    )
}

/// Biases that a replay has found, with ±1σ: of the gyros in °/h, of the accelerometers in µg.
///
/// # Errors
/// [`PlotError`] where the drawing library fails.
pub fn biases_found(width: Width, moments: &[replay::Moment]) -> Result<Svg, PlotError> {
    let gyro = |title, axis: usize| {
        let found = moments.iter().map(move |m| {
            let (bias, sd) = (m.reading.gyro_bias_deg_h, m.reading.gyro_bias_sd_deg_h);
            (m.t_s, bias[axis], sd[axis])
        });
        estimated(title, "bias (°/h)", found, 1.0)
    };
    let accel = |title, axis: usize| {
        let found = moments.iter().map(move |m| {
            let (bias, sd) = (m.reading.accel_bias_ug, m.reading.accel_bias_sd_ug);
            (m.t_s, bias[axis], sd[axis])
        });
        estimated(title, "bias (µg)", found, 1.0)
    };
    figure(
        width,
        &[
            gyro("gyro x", 0),
            gyro("gyro y", 1),
            gyro("gyro z", 2),
            accel("accelerometer x", 0),
            accel("accelerometer y", 1),
            accel("accelerometer z", 2),
        ],
        &Legend {
            line: "found",
            band: "±1σ",
            reference: "",
        },
    )
}

/// Innovations of a replay over what the filter expects of them.
///
/// # Errors
/// [`PlotError`] where the drawing library fails.
pub fn innovations(width: Width, moments: &[replay::Moment]) -> Result<Svg, PlotError> {
    let known = || moments.iter().filter(|m| m.innovation.is_finite());
    figure(
        width,
        &[Panel {
            title: "innovation²/variance, per component",
            unit: "ratio",
            line: known().map(|m| (m.t_s, m.innovation)).collect(),
            reference: known().map(|m| (m.t_s, m.innovation_ratio)).collect(),
            band: Vec::new(),
        }],
        &Legend {
            line: "each second",
            band: "",
            reference: "running mean",
        },
    )
}

/// Rotor angle, of (time s, angle degrees).
///
/// # Errors
/// [`PlotError`] where the drawing library fails.
pub fn rotor(width: Width, angle: &[(f64, f64)]) -> Result<Svg, PlotError> {
    figure(
        width,
        &[Panel {
            title: "rotor, by its encoder",
            unit: "angle (°)",
            line: angle.to_vec(),
            reference: Vec::new(),
            band: Vec::new(),
        }],
        &Legend {
            line: "",
            band: "",
            reference: "",
        },
    )
}

/// Heading σ of the ideal filter over time, beside what the angle random walk alone leaves.
///
/// The scale of σ is logarithmic: it begins with a quarter of a circle and ends with a fraction of a degree.
///
/// # Errors
/// [`PlotError`] where the drawing library fails.
pub fn heading_bound(width: Width, title: &str, curve: &[Sigmas]) -> Result<Svg, PlotError> {
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
    let lines = [
        (
            simple,
            VERMILION.stroke_width(2),
            "angle random walk alone, ARW/(ω_ie cos L √T)",
        ),
        (sd, BLUE.stroke_width(2), "ideal filter"),
    ];
    let keys = lines.each_ref().map(|(_, style, text)| Key { text, style: *style });
    Svg::draw((width.pixels(), 520), |sheet| {
        let (time, sigma) = (
            Scale::linear("time (s)", 0.0, end),
            Scale::log("heading σ (°)", low, high),
        );
        let mut plane = Plane::new(sheet, title, &keys, time, sigma)?;
        lines
            .iter()
            .try_for_each(|(line, style, _)| plane.line(line.iter().copied(), *style))
    })
}

/// Histogram of heading errors in degrees, with the normal densities of the predicted σ and of the ideal filter's.
///
/// # Errors
/// [`PlotError`] where the drawing library fails.
pub fn heading_histogram(
    page: Width,
    title: &str,
    errors_deg: &[f64],
    predicted_sd_deg: f64,
    bound_deg: f64,
) -> Result<Svg, PlotError> {
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
        (predicted_sd_deg, VERMILION.stroke_width(2), "predicted"),
    ]
    .into_iter()
    .filter(|(sd, ..)| *sd > 0.3 * width)
    .map(|(sd, style, whose)| (sd, style, format!("normal, {whose} σ = {sd:.3}°")))
    .collect();
    let top = counts
        .iter()
        .map(|c| *c as f64)
        .chain(curves.iter().map(|(sd, ..)| density(0.0, *sd)))
        .fold(0.0, f64::max)
        * 1.1;
    let bars = BLUE.mix(0.45).filled();
    let mut keys = vec![Key {
        text: "runs",
        style: bars,
    }];
    keys.extend(curves.iter().map(|(_, style, text)| Key { text, style: *style }));
    Svg::draw((page.pixels(), 480), |sheet| {
        let (x, y) = (
            Scale::linear("heading error (°)", -reach, reach),
            Scale::whole("runs", 0.0, top.max(1.0)),
        );
        let mut plane = Plane::new(sheet, title, &keys, x, y)?;
        for (k, count) in counts.iter().enumerate() {
            // The ends of the outermost are the axis' own, whatever the sum of widths rounds to.
            let side = |k: usize| {
                if k == BINS { reach } else { k as f64 * width - reach }
            };
            let (left, right, height) = (side(k), side(k + 1), *count as f64);
            plane.fill([(left, 0.0), (left, height), (right, height), (right, 0.0)], bars)?;
        }
        for (sd, style, _) in &curves {
            let points = (0..=200).map(|k| reach * (f64::from(k) / 100.0 - 1.0));
            plane.line(points.map(|x| (x, density(x, *sd))), *style)?;
        }
        Ok(())
    })
}
