//! A timeline as a chart: heading with ±σ, σ, pitch and roll over time, the modes behind them, faults and resets on top.

use std::path::Path;

use plotters::coord::ranged1d::{AsRangedCoord, ValueFormatter};
use plotters::prelude::*;

use super::timeline::{EstimateAt, Timeline};
use crate::plot::plane::{log_ticks, tick};
use crate::plot::sheet::{
    Area, BLUE, FONT, GREEN, GREY, INK, LABEL, ORANGE, PURPLE, SKY, TICK, VERMILION, YELLOW, text_width,
};
use crate::plot::{PlotError, Svg};

/// Sizes, pixels.
const WIDTH: u32 = 1040;
const HEIGHTS: [u32; 3] = [330, 250, 250];
const LEGEND: u32 = 250;
const LEGEND_LINE: i32 = 19;
const LABELS: u32 = 74;
/// Faults that the legend names.
const FAULTS: usize = 10;
/// A pause that breaks a curve, s: several estimates are missing.
const PAUSE_S: f64 = 5.0;

type Curve = Vec<(f64, f64)>;

/// Tint of a mode behind the curves. Names stand in the bands where there is room: no two of these need be told by hue.
fn tint(mode: &str) -> RGBAColor {
    match mode {
        "self-test" => PURPLE.mix(0.25),
        "homing" => SKY.mix(0.3),
        "calibrating" => GREY.mix(0.35),
        "coarse" => ORANGE.mix(0.25),
        "fine" => YELLOW.mix(0.35),
        "aligned" => GREEN.mix(0.15),
        "navigating" => BLUE.mix(0.15),
        "fault" => VERMILION.mix(0.4),
        _ => GREY.mix(0.15),
    }
}

/// One panel.
struct Panel<'a> {
    label: &'a str,
    /// Colour and points; several pieces where the estimates pause.
    curves: Vec<(RGBColor, Vec<Curve>)>,
    /// Pieces of (t, low, high).
    bands: Vec<Vec<(f64, f64, f64)>>,
    /// Single results.
    marks: Curve,
    /// Least and greatest value.
    range: (f64, f64),
    /// Angles that go round.
    round: bool,
}

/// What the panels share.
struct Time<'a> {
    timeline: &'a Timeline,
    from_s: f64,
    to_s: f64,
}

/// Ticks of the logarithmic axis: the library's own leave out whole decades.
fn round_values(range: (f64, f64)) -> Vec<f64> {
    let candidates = log_ticks(range);
    candidates
        .into_iter()
        .find(|ticks| ticks.len() <= 8)
        .unwrap_or_default()
}

/// Estimates without pauses; headings go on through north instead of jumping.
fn pieces(timeline: &Timeline) -> Vec<Vec<EstimateAt>> {
    let mut pieces: Vec<Vec<EstimateAt>> = Vec::new();
    let mut last: Option<EstimateAt> = None;
    for estimate in &timeline.estimates {
        let mut estimate = *estimate;
        let heading = &mut estimate.attitude.heading_deg;
        *heading = heading.rem_euclid(360.0);
        if let Some(last) = &last {
            *heading += 360.0 * ((last.attitude.heading_deg - *heading) / 360.0).round();
        }
        let goes_on = last.as_ref().is_some_and(|last| {
            let starts = &timeline.starts;
            estimate.t_s - last.t_s < PAUSE_S && !starts.iter().any(|s| s.t_s > last.t_s && s.t_s <= estimate.t_s)
        });
        last = Some(estimate);
        match pieces.last_mut() {
            Some(piece) if goes_on => piece.push(estimate),
            _ => pieces.push(vec![estimate]),
        }
    }
    pieces
}

fn range(values: impl Iterator<Item = f64>) -> Option<(f64, f64)> {
    let (low, high) = values
        .filter(|v| v.is_finite())
        .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), v| {
            (low.min(v), high.max(v))
        });
    (low <= high).then_some((low, high))
}

fn panels(timeline: &Timeline) -> [Panel<'static>; 3] {
    let pieces = pieces(timeline);
    let curve = |of: &dyn Fn(&EstimateAt) -> f64| -> Vec<Curve> {
        let piece = |piece: &Vec<EstimateAt>| piece.iter().map(|e| (e.t_s, of(e))).collect();
        pieces.iter().map(piece).collect()
    };
    let heading = curve(&|e| e.attitude.heading_deg);
    let first = heading.first().and_then(|piece| piece.first()).map(|p| p.1);
    // The same turn as the curve.
    let coarse: Curve = timeline
        .coarse
        .iter()
        .map(|c| {
            let turn = first.map_or(0.0, |first| 360.0 * ((first - c.heading_deg) / 360.0).round());
            (c.t_s, c.heading_deg + turn)
        })
        .collect();
    let values = heading.iter().flatten().chain(&coarse).map(|p| p.1);
    let (low, high) = range(values).unwrap_or((0.0, 360.0));
    let mut sds: Vec<f64> = timeline.estimates.iter().map(|e| e.attitude.heading_sd_deg).collect();
    sds.sort_by(f64::total_cmp);
    // Room for a usual σ; the first ones would flatten the rest.
    let usual = sds.get(sds.len() / 2).copied().unwrap_or(1.0);
    let margin = (0.06 * (high - low)).max(1.5 * usual).max(1e-3);
    let (low, high) = (low - margin, high + margin);
    let clip = |y: f64| y.max(low).min(high);
    let bands = pieces.iter().map(|piece| {
        let band = |e: &EstimateAt| {
            let (h, sd) = (e.attitude.heading_deg, e.attitude.heading_sd_deg);
            (e.t_s, clip(h - sd), clip(h + sd))
        };
        piece.iter().map(band).collect()
    });
    let bands = bands.collect();

    // A logarithm has no room for what is not above zero.
    let mut sd = curve(&|e| e.attitude.heading_sd_deg);
    sd.iter_mut().for_each(|piece| piece.retain(|p| p.1 > 0.0));
    let coarse_sd: Curve = timeline
        .coarse
        .iter()
        .map(|c| (c.t_s, c.heading_sd_deg))
        .filter(|p| p.1 > 0.0)
        .collect();
    let sds = range(sd.iter().flatten().chain(&coarse_sd).map(|p| p.1));
    let (sd_low, sd_high) = sds.unwrap_or((0.1, 10.0));

    let (pitch, roll) = (curve(&|e| e.attitude.pitch_deg), curve(&|e| e.attitude.roll_deg));
    let (least, most) = range(pitch.iter().chain(&roll).flatten().map(|p| p.1)).unwrap_or((-1.0, 1.0));
    let room = (0.08 * (most - least)).max(1e-3);
    [
        Panel {
            label: "heading (°)",
            curves: vec![(BLUE, heading)],
            bands,
            marks: coarse,
            range: (low, high),
            round: true,
        },
        Panel {
            label: "σ of heading (°)",
            curves: vec![(BLUE, sd)],
            bands: Vec::new(),
            marks: coarse_sd,
            range: (0.7 * sd_low, 1.4 * sd_high),
            round: false,
        },
        Panel {
            label: "pitch, roll (°)",
            curves: vec![(GREEN, pitch), (PURPLE, roll)],
            bands: Vec::new(),
            marks: Vec::new(),
            range: (least - room, most + room),
            round: false,
        },
    ]
}

fn draw<Y>(area: &Area<'_>, panel: &Panel<'_>, time: &Time<'_>, y: Y, top: bool, bottom: bool) -> Result<(), PlotError>
where
    Y: AsRangedCoord<Value = f64>,
    Y::CoordDescType: ValueFormatter<f64>,
{
    let Time { timeline, from_s, to_s } = *time;
    let (low, high) = panel.range;
    let mut chart = ChartBuilder::on(area)
        .margin_left(8)
        .margin_right(18)
        // Names of the modes, numbers of the faults.
        .margin_top(if top { 40 } else { 10 })
        .margin_bottom(4)
        .x_label_area_size(if bottom { 42 } else { 26 })
        .y_label_area_size(LABELS)
        .build_cartesian_2d(from_s..to_s, y)?;
    let clip = |t: f64| t.max(from_s).min(to_s);
    chart.draw_series(timeline.modes.iter().map(|span| {
        let corners = [(clip(span.from_s), low), (clip(span.to_s), high)];
        Rectangle::new(corners, tint(span.mode).filled())
    }))?;
    let x_span = to_s - from_s;
    chart
        .configure_mesh()
        .light_line_style(TRANSPARENT)
        .bold_line_style(GREY.mix(0.25))
        .x_desc(if bottom { "time (s)" } else { "" })
        .y_desc(panel.label)
        .y_labels(12)
        .x_label_formatter(&|t| tick(*t, x_span))
        .y_label_formatter(&|v| {
            let v = if panel.round { v.rem_euclid(360.0) } else { *v };
            tick(v, high - low)
        })
        .label_style((FONT, TICK).into_font().color(&INK))
        .axis_desc_style((FONT, LABEL).into_font().color(&INK))
        .draw()?;
    for band in &panel.bands {
        let upper = band.iter().map(|(t, _, high)| (*t, *high));
        let lower = band.iter().rev().map(|(t, low, _)| (*t, *low));
        let outline: Vec<_> = upper.chain(lower).collect();
        chart.draw_series(core::iter::once(Polygon::new(outline, BLUE.mix(0.3))))?;
    }
    for (colour, pieces) in &panel.curves {
        for piece in pieces {
            chart.draw_series(LineSeries::new(piece.iter().copied(), colour.stroke_width(2)))?;
            // A single point is no line.
            if let [point] = piece[..] {
                chart.draw_series([Circle::new(point, 2, colour.filled())])?;
            }
        }
    }
    chart.draw_series(panel.marks.iter().map(|p| TriangleMarker::new(*p, 6, INK.filled())))?;
    for start in &timeline.starts {
        let line = vec![(clip(start.t_s), low), (clip(start.t_s), high)];
        chart.draw_series([PathElement::new(line, INK.stroke_width(1))])?;
    }
    for fault in &timeline.faults {
        let line = vec![(clip(fault.t_s), low), (clip(fault.t_s), high)];
        chart.draw_series([PathElement::new(line, VERMILION.stroke_width(2))])?;
    }
    if top {
        let plane = chart.plotting_area();
        let x = |t: f64| plane.map_coordinate(&(clip(t), high)).0;
        let y = plane.map_coordinate(&(from_s, high)).1;
        names(area, timeline, &x, y)?;
    }
    Ok(())
}

/// Names of the modes above their bands, where they fit, and numbers of the faults.
fn names(area: &Area<'_>, timeline: &Timeline, x: &dyn Fn(f64) -> i32, y: i32) -> Result<(), PlotError> {
    let (left, up) = area.get_base_pixel();
    let y = y - up;
    let centred = |text: &str, at: i32, y: i32, colour: &RGBColor| {
        let anchor = plotters::style::text_anchor::Pos::new(
            plotters::style::text_anchor::HPos::Center,
            plotters::style::text_anchor::VPos::Bottom,
        );
        let style = (FONT, TICK).into_text_style(area).color(colour).pos(anchor);
        area.draw(&Text::new(text.to_owned(), (at, y), style))
    };
    for span in &timeline.modes {
        let (from, to) = (x(span.from_s) - left, x(span.to_s) - left);
        if to - from > width(span.mode) + 4 {
            centred(span.mode, i32::midpoint(from, to), y - 3, &INK)?;
        }
    }
    let mut free = i32::MIN;
    for (k, fault) in timeline.faults.iter().enumerate().take(FAULTS) {
        let (text, at) = ((k + 1).to_string(), x(fault.t_s) - left);
        let half = width(&text) / 2 + 2;
        if at - half >= free {
            centred(&text, at, y - 19, &VERMILION)?;
            free = at + half;
        }
    }
    Ok(())
}

/// Width of a text, pixels.
fn width(text: &str) -> i32 {
    i32::try_from(text_width(text, TICK)).unwrap_or(i32::MAX)
}

fn legend(area: &Area<'_>, timeline: &Timeline) -> Result<(), PlotError> {
    let mut row = 0;
    let mut line = |mark: &dyn Fn(&Area<'_>, i32) -> Result<(), PlotError>, text: String| -> Result<(), PlotError> {
        let y = 44 + LEGEND_LINE * row;
        row += 1;
        mark(area, y + 8)?;
        let room = (LEGEND - 34) / text_width("0", TICK);
        let text: String = text.chars().take(room as usize).collect();
        area.draw(&Text::new(text, (28, y), (FONT, TICK).into_font().color(&INK)))?;
        Ok(())
    };
    let stroke = |colour: RGBColor, thick: u32| {
        move |area: &Area<'_>, y: i32| -> Result<(), PlotError> {
            area.draw(&PathElement::new([(2, y), (22, y)], colour.stroke_width(thick)))?;
            Ok(())
        }
    };
    let patch = |colour: RGBAColor| {
        move |area: &Area<'_>, y: i32| -> Result<(), PlotError> {
            area.draw(&Rectangle::new([(2, y - 6), (22, y + 6)], colour.filled()))?;
            area.draw(&Rectangle::new([(2, y - 6), (22, y + 6)], GREY.mix(0.4)))?;
            Ok(())
        }
    };
    line(&stroke(BLUE, 2), "heading and its σ".to_owned())?;
    line(&patch(BLUE.mix(0.3)), "heading ± σ".to_owned())?;
    if !timeline.coarse.is_empty() {
        let triangle = |area: &Area<'_>, y: i32| -> Result<(), PlotError> {
            area.draw(&TriangleMarker::new((12, y), 6, INK.filled()))?;
            Ok(())
        };
        line(&triangle, "coarse alignment".to_owned())?;
    }
    line(&stroke(GREEN, 2), "pitch".to_owned())?;
    line(&stroke(PURPLE, 2), "roll".to_owned())?;
    let mut modes: Vec<&str> = Vec::new();
    for span in &timeline.modes {
        if !modes.contains(&span.mode) {
            modes.push(span.mode);
        }
    }
    for mode in modes {
        line(&patch(tint(mode)), mode.to_owned())?;
    }
    if !timeline.starts.is_empty() {
        line(&stroke(INK, 1), "start (upright)".to_owned())?;
    }
    if !timeline.faults.is_empty() {
        line(&stroke(VERMILION, 2), "fault (upright)".to_owned())?;
    }
    let none = |_: &Area<'_>, _: i32| -> Result<(), PlotError> { Ok(()) };
    for (k, fault) in timeline.faults.iter().enumerate().take(FAULTS) {
        line(&none, format!("{} {}, {:.1} s", k + 1, fault.name, fault.t_s))?;
    }
    if timeline.faults.len() > FAULTS {
        line(&none, format!("and {} more", timeline.faults.len() - FAULTS))?;
    }
    Ok(())
}

/// Draws the timeline as SVG.
///
/// # Errors
/// [`PlotError`] where the file cannot be written.
pub fn svg(path: &Path, timeline: &Timeline) -> Result<(), PlotError> {
    let time = Time {
        timeline,
        // A log that begins with the unit begins at zero.
        from_s: if timeline.from_s < 1.0 { 0.0 } else { timeline.from_s },
        // A log of one instant has no axis.
        to_s: timeline.to_s.max(timeline.from_s + 1.0),
    };
    let [heading, sd, angles] = panels(timeline);
    let sheet = Svg::draw((WIDTH, HEIGHTS.iter().sum()), |sheet| {
        let (planes, beside) = sheet.split_horizontally(WIDTH - LEGEND);
        legend(&beside, timeline)?;
        let (first, rest) = planes.split_vertically(HEIGHTS[0]);
        let (second, third) = rest.split_vertically(HEIGHTS[1]);
        let linear = |panel: &Panel<'_>| panel.range.0..panel.range.1;
        draw(&first, &heading, &time, linear(&heading), true, false)?;
        let logarithmic = linear(&sd).log_scale().with_key_points(round_values(sd.range));
        draw(&second, &sd, &time, logarithmic, false, false)?;
        draw(&third, &angles, &time, linear(&angles), false, true)
    })?;
    sheet.save(path)
}
