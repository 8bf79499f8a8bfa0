//! A plane with its axes, title and legend: ticks that are round and do not touch, at any width.

use core::ops::Range;

use plotters::coord::ranged1d::{DefaultFormatting, KeyPointHint, Ranged};
use plotters::prelude::*;
use plotters::style::text_anchor::{HPos, Pos, VPos};

use super::PlotError;
use super::sheet::{Area, FONT, INK, LABEL, MESH, PAPER, TICK, TITLE, text_width};

/// Distance of a legend's lines, pixels.
const LEGEND_LINE: i32 = 20;
/// Where they begin.
const LEGEND_LEFT: i32 = 16;
/// Length of the line that an entry of a legend shows.
const SAMPLE: i32 = 20;
const MARGIN: u32 = 8;

/// How the values of an axis lie on it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Spacing {
    /// Evenly.
    Linear,
    /// Evenly, and only whole numbers mean anything: counts, and numbers of runs.
    Whole,
    /// By their logarithm: only values above zero are shown.
    Log,
}

/// One axis: quantity and unit, range, spacing.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Scale<'a> {
    pub(crate) label: &'a str,
    pub(crate) spacing: Spacing,
    pub(crate) range: (f64, f64),
}

impl<'a> Scale<'a> {
    pub(crate) fn linear(label: &'a str, low: f64, high: f64) -> Self {
        Self {
            label,
            spacing: Spacing::Linear,
            range: (low, high),
        }
    }

    pub(crate) fn whole(label: &'a str, low: f64, high: f64) -> Self {
        Self {
            spacing: Spacing::Whole,
            ..Self::linear(label, low, high)
        }
    }

    pub(crate) fn log(label: &'a str, low: f64, high: f64) -> Self {
        Self {
            spacing: Spacing::Log,
            ..Self::linear(label, low, high)
        }
    }

    fn is_log(&self) -> bool {
        self.spacing == Spacing::Log
    }

    /// Where a value lies on the axis; where it lies nowhere, a logarithm of what is not above zero, nothing.
    fn at(&self, v: f64) -> Option<f64> {
        let at = if self.is_log() { v.log10() } else { v };
        at.is_finite().then_some(at)
    }

    /// A tick's text. On a logarithmic axis small values are not rounding.
    fn text(&self, v: f64) -> String {
        tick(
            v,
            if self.is_log() {
                0.0
            } else {
                self.range.1 - self.range.0
            },
        )
    }

    /// Ticks on an axis of so many pixels, the most that leave the room which `needed` asks of their texts.
    fn ticks(&self, pixels: u32, needed: impl Fn(&[f64]) -> u32) -> Vec<f64> {
        let candidates = match self.spacing {
            Spacing::Linear => linear_ticks(self.range, 0.0),
            Spacing::Whole => linear_ticks(self.range, 1.0),
            Spacing::Log => log_ticks(self.range),
        };
        let position = |v: f64| self.at(v).unwrap_or(0.0);
        let (low, high) = (position(self.range.0), position(self.range.1));
        let fits = |ticks: &Vec<f64>| {
            let room = f64::from(needed(ticks));
            ticks
                .windows(2)
                .all(|pair| (position(pair[1]) - position(pair[0])) / (high - low) * f64::from(pixels) >= room)
        };
        candidates.into_iter().find(fits).unwrap_or_default()
    }
}

/// A tick's text: no more digits than it needs. Those of a linear axis are a fiftieth of its `span` apart or more, rounded
/// to a power of ten; those of a logarithmic one, of no span, have four digits at the most.
pub(crate) fn tick(v: f64, span: f64) -> String {
    // Where the axis crosses zero, the ticks' sum of steps misses it by rounding.
    if v.abs() <= 1e-9 * span {
        return "0".to_owned();
    }
    // A product of powers of ten misses them by rounding as well.
    let power = |v: f64| (v.log10() + 1e-9).floor() as i32;
    let size = power(v.abs());
    let decimals = if span > 0.0 {
        -power(span / 50.0)
    } else {
        3_i32.saturating_sub(size)
    };
    let digits = |n: i32| n.clamp(0, 15) as usize;
    if (-3..5).contains(&size) {
        trimmed(&format!("{v:.0$}", digits(decimals))).to_owned()
    } else {
        let text = format!("{v:.0$e}", digits(decimals.saturating_add(size)));
        let (number, exponent) = text.split_once('e').unwrap_or((&text, "0"));
        format!("{}e{exponent}", trimmed(number))
    }
}

/// A number without zeros behind its point.
fn trimmed(number: &str) -> &str {
    if number.contains('.') {
        number.trim_end_matches('0').trim_end_matches('.')
    } else {
        number
    }
}

/// Round values within a range, `least` apart or more, from the densest to a single one.
fn linear_ticks((low, high): (f64, f64), least: f64) -> Vec<Vec<f64>> {
    let first = ((high - low) / 50.0).max(least).log10().floor() as i32;
    (first..first + 4)
        .flat_map(|decade| [1.0, 2.0, 5.0].map(|step| step * 10_f64.powi(decade)))
        .map(|step| {
            let (from, to) = ((low / step).ceil() as i64, (high / step).floor() as i64);
            (from..=to).map(|k| k as f64 * step).collect::<Vec<_>>()
        })
        .filter(|ticks| !ticks.is_empty())
        .collect()
}

/// Round values within a range above zero, from the densest to decades apart. Where the range holds none, it is nearly
/// linear.
pub(crate) fn log_ticks((low, high): (f64, f64)) -> Vec<Vec<f64>> {
    let decades = || low.log10().floor() as i32..=high.log10().ceil() as i32;
    let of = |steps: &[f64], every: i32| -> Vec<f64> {
        decades()
            .filter(|decade| decade.rem_euclid(every) == 0)
            .flat_map(|decade| steps.iter().map(move |step| step * 10_f64.powi(decade)))
            .filter(|value| (low * (1.0 - 1e-9)..=high * (1.0 + 1e-9)).contains(value))
            .collect()
    };
    let all = [
        of(&[1.0, 1.5, 2.0, 3.0, 5.0, 7.0], 1),
        of(&[1.0, 2.0, 5.0], 1),
        of(&[1.0, 3.0], 1),
        of(&[1.0], 1),
        of(&[1.0], 2),
        of(&[1.0], 3),
    ];
    // A single tick tells no scale.
    let round: Vec<_> = all.into_iter().filter(|ticks| ticks.len() > 1).collect();
    if high / low < 3.0 || round.is_empty() {
        linear_ticks((low, high), 0.0)
    } else {
        round
    }
}

/// An entry of a legend.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Key<'a> {
    pub(crate) text: &'a str,
    /// A line, or a patch as high as letters where it is filled.
    pub(crate) style: ShapeStyle,
}

/// Sizes, in letters and pixels, of an entry.
fn key_width(key: &Key<'_>) -> i32 {
    SAMPLE + 6 + i32::try_from(text_width(key.text, TICK)).unwrap_or(0) + 18
}

/// Where each entry goes, left and line, and how many lines there are.
fn flow(keys: &[Key<'_>], width: i32) -> (Vec<(i32, i32)>, i32) {
    let (mut x, mut line) = (0, 0);
    let places = keys
        .iter()
        .map(|key| {
            if x > 0 && x + key_width(key) > width {
                (x, line) = (0, line + 1);
            }
            let place = (x, line);
            x += key_width(key);
            place
        })
        .collect();
    (places, if keys.is_empty() { 0 } else { line + 1 })
}

/// Height of a legend above a plane so wide, pixels.
pub(crate) fn legend_height(keys: &[Key<'_>], width: u32) -> u32 {
    let (_, lines) = flow(keys, i32::try_from(width).unwrap_or(0) - LEGEND_LEFT);
    pixels(lines * LEGEND_LINE)
}

/// Draws an entry with its upper left corner there.
pub(crate) fn draw_key(area: &Area<'_>, key: &Key<'_>, (x, y): (i32, i32)) -> Result<(), PlotError> {
    if key.style.filled {
        area.draw(&Rectangle::new([(x, y + 3), (x + SAMPLE, y + 15)], key.style))?;
    } else {
        area.draw(&PathElement::new([(x, y + 9), (x + SAMPLE, y + 9)], key.style))?;
    }
    let style = (FONT, TICK)
        .into_text_style(area)
        .color(&INK)
        .pos(Pos::new(HPos::Left, VPos::Center));
    area.draw(&Text::new(key.text.to_owned(), (x + SAMPLE + 6, y + 9), style))?;
    Ok(())
}

/// A title in lines that fit.
fn wrapped(title: &str, width: u32) -> Vec<String> {
    let mut lines: Vec<String> = Vec::new();
    for word in title.split_whitespace() {
        match lines.last_mut() {
            Some(line) if text_width(line, TITLE) + text_width(word, TITLE) + TITLE / 2 <= width => {
                line.push(' ');
                line.push_str(word);
            }
            _ => lines.push(word.to_owned()),
        }
    }
    lines
}

/// A line of places with ticks of our own, all of them and no lighter ones between.
struct Ticked {
    from: f64,
    to: f64,
    ticks: Vec<f64>,
}

impl Ranged for Ticked {
    type FormatOption = DefaultFormatting;
    type ValueType = f64;

    fn map(&self, at: &f64, (first, last): (i32, i32)) -> i32 {
        let part = (at - self.from) / (self.to - self.from);
        first + (part * f64::from(last - first)).round() as i32
    }

    fn key_points<Hint: KeyPointHint>(&self, hint: Hint) -> Vec<f64> {
        if hint.weight().allow_light_points() {
            Vec::new()
        } else {
            self.ticks.clone()
        }
    }

    fn range(&self) -> Range<f64> {
        self.from..self.to
    }
}

type Coordinates = Cartesian2d<Ticked, Ticked>;

/// A plane to draw on.
pub(crate) struct Plane<'a, 'b> {
    chart: ChartContext<'a, SVGBackend<'b>, Coordinates>,
    x: Scale<'a>,
    y: Scale<'a>,
}

fn pixels(n: i32) -> u32 {
    u32::try_from(n).unwrap_or(0)
}

impl<'a, 'b> Plane<'a, 'b> {
    /// Title, legend below it, axes; the plane takes what is left of the area.
    pub(crate) fn new(
        area: &Area<'b>,
        title: &str,
        keys: &[Key<'_>],
        x: Scale<'a>,
        y: Scale<'a>,
    ) -> Result<Self, PlotError> {
        let (width, height) = area.dim_in_pixel();
        let title = wrapped(title, width - 2 * MARGIN);
        let line = i32::try_from(TITLE).unwrap_or(0) + 3;
        let heading = 14 + line * i32::try_from(title.len()).unwrap_or(0);
        let (places, lines) = flow(keys, i32::try_from(width).unwrap_or(0) - LEGEND_LEFT);
        let head = heading + lines * LEGEND_LINE + 2;

        let (above, below) = area.split_vertically(head);
        let centre = i32::try_from(width / 2).unwrap_or(0);
        let style = (FONT, TITLE)
            .into_text_style(area)
            .color(&INK)
            .pos(Pos::new(HPos::Center, VPos::Top));
        for (k, text) in (0..).zip(title) {
            above.draw(&Text::new(text, (centre, 12 + line * k), style.clone()))?;
        }
        for (key, (at, line)) in keys.iter().zip(places) {
            draw_key(&above, key, (LEGEND_LEFT + at, heading + LEGEND_LINE * line))?;
        }

        // First upward: how wide its texts are decides how wide the plane is.
        let below_plane = if x.label.is_empty() { 26 } else { 48 };
        let upward = height.saturating_sub(pixels(head) + MARGIN + below_plane);
        let y_ticks = y.ticks(upward, |_| 28);
        let widest = |scale: &Scale<'_>, ticks: &[f64]| {
            let widths = ticks.iter().map(|v| text_width(&scale.text(*v), TICK));
            widths.max().unwrap_or(0)
        };
        // Planes below each other begin below each other, if their numbers are of the usual length.
        let beside = 34 + widest(&y, &y_ticks).max(text_width("-0.002", TICK));
        let across = width.saturating_sub(beside + 4 * MARGIN);
        let x_ticks = x.ticks(across, |ticks| widest(&x, ticks) + 14);
        // Half of the last one goes beyond the plane.
        let right = (widest(&x, &x_ticks) / 2 + 4).max(2 * MARGIN);

        let on = |scale: &Scale<'_>, ticks: &[f64]| -> Ticked {
            let at = |v: f64| scale.at(v).unwrap_or(0.0);
            Ticked {
                from: at(scale.range.0),
                to: at(scale.range.1),
                ticks: ticks.iter().map(|v| at(*v)).collect(),
            }
        };
        let mut chart = ChartBuilder::on(&below)
            .margin(MARGIN)
            .margin_top(2)
            .margin_right(right)
            .x_label_area_size(below_plane)
            .y_label_area_size(beside)
            .build_cartesian_2d(on(&x, &x_ticks), on(&y, &y_ticks))?;
        let text = |scale: Scale<'a>| move |at: &f64| scale.text(if scale.is_log() { 10_f64.powf(*at) } else { *at });
        chart
            .configure_mesh()
            .light_line_style(PAPER.mix(0.0))
            .bold_line_style(MESH)
            .axis_style(INK)
            .x_desc(x.label)
            .y_desc(y.label)
            .x_label_formatter(&text(x))
            .y_label_formatter(&text(y))
            .label_style((FONT, TICK).into_font().color(&INK))
            .axis_desc_style((FONT, LABEL).into_font().color(&INK))
            .draw()?;
        Ok(Self { chart, x, y })
    }

    /// The place of a point, kept within the plane's height; what is beside the plane has none.
    fn place(&self, (x, y): (f64, f64)) -> Option<(f64, f64)> {
        let (left, right) = self.x.range;
        let (low, high) = self.y.range;
        let within = (left..=right).contains(&x);
        let y = self.y.at(y)?.clamp(self.y.at(low)?, self.y.at(high)?);
        within.then_some((self.x.at(x)?, y))
    }

    /// The places of a line, as many as are seen.
    fn places(&self, points: impl IntoIterator<Item = (f64, f64)>) -> Vec<(f64, f64)> {
        let points = points.into_iter().filter_map(|p| self.place(p)).collect();
        let across = self.chart.plotting_area().dim_in_pixel().0;
        let ends = self.x.at(self.x.range.0).zip(self.x.at(self.x.range.1));
        let column = ends.map_or(1.0, |(start, end)| (end - start) / f64::from(across.max(1)));
        thinned(points, column)
    }

    /// What lies between two lines, of (x, low, high).
    pub(crate) fn band(&mut self, band: &[(f64, f64, f64)], style: ShapeStyle) -> Result<(), PlotError> {
        let mut outline = self.places(band.iter().map(|(x, _, high)| (*x, *high)));
        let below = self.places(band.iter().map(|(x, low, _)| (*x, *low)));
        outline.extend(below.into_iter().rev());
        self.chart.draw_series([Polygon::new(outline, style)])?;
        Ok(())
    }

    pub(crate) fn line(
        &mut self,
        points: impl IntoIterator<Item = (f64, f64)>,
        style: ShapeStyle,
    ) -> Result<(), PlotError> {
        let points = self.places(points);
        self.chart.draw_series(LineSeries::new(points, style))?;
        Ok(())
    }

    /// An area between lines.
    pub(crate) fn fill(
        &mut self,
        outline: impl IntoIterator<Item = (f64, f64)>,
        style: impl Into<ShapeStyle>,
    ) -> Result<(), PlotError> {
        let outline: Vec<_> = outline.into_iter().filter_map(|p| self.place(p)).collect();
        self.chart.draw_series([Polygon::new(outline, style.into())])?;
        Ok(())
    }
}

/// A line of thousands of points as it looks: of those in one column of pixels the first, the last and the extremes.
fn thinned(points: Vec<(f64, f64)>, column: f64) -> Vec<(f64, f64)> {
    let of = |p: &(f64, f64)| (p.0 / column).floor();
    points
        .chunk_by(|a, b| of(a).total_cmp(&of(b)).is_eq())
        .flat_map(|chunk| {
            let extreme =
                |sign: f64| (0..chunk.len()).max_by(|a, b| (sign * chunk[*a].1).total_cmp(&(sign * chunk[*b].1)));
            let mut kept = [Some(0), extreme(1.0), extreme(-1.0), chunk.len().checked_sub(1)];
            kept.sort_unstable();
            let mut kept: Vec<usize> = kept.into_iter().flatten().collect();
            kept.dedup();
            kept.into_iter().map(|k| chunk[k])
        })
        .collect()
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
            // Neighbours are told apart.
            (1.5e5, 2e5, "1.5e5"),
            (1.5e-4, 3e-4, "1.5e-4"),
            (1.5e-4, 0.0, "1.5e-4"),
            (359.999_93, 6e-5, "359.99993"),
            (100.0, 100.0, "100"),
            // As a power of ten comes out.
            (10_f64.powf(0.05_f64.log10()), 0.0, "0.05"),
            (10_f64.powf(5.0 - 1e-16), 0.0, "1e5"),
        ] {
            assert_eq!(tick(v, span), text, "{v} of {span}");
        }
    }

    #[test]
    fn ticks_are_within_the_range_and_leave_room() {
        for (scale, pixels, room) in [
            (Scale::linear("", 0.0, 300.0), 330, 40),
            (Scale::linear("", -1.23, 0.97), 100, 28),
            (Scale::linear("", 359.9991, 359.9997), 200, 60),
            (Scale::log("", 0.3, 88.0), 200, 28),
            (Scale::log("", 1e-3, 2e4), 300, 45),
            (Scale::log("", 90.0, 101.0), 300, 40),
            (Scale::log("", 1.0, 100.0), 800, 40),
        ] {
            let ticks = scale.ticks(pixels, |_| room);
            let (low, high) = scale.range;
            assert!(ticks.len() > 1, "{scale:?}: {ticks:?}");
            assert!(
                ticks.iter().all(|t| *t >= low && *t <= high * (1.0 + 1e-9)),
                "{ticks:?}"
            );
            let at = |v: f64| scale.at(v).unwrap();
            for pair in ticks.windows(2) {
                let apart = (at(pair[1]) - at(pair[0])) / (at(high) - at(low)) * f64::from(pixels);
                assert!(apart >= f64::from(room), "{scale:?}: {ticks:?}");
            }
        }
    }

    #[test]
    fn there_is_no_half_of_a_run() {
        for (low, high, expected) in [
            (0.5, 2.5, &[1.0, 2.0][..]),
            (0.0, 1.1, &[0.0, 1.0]),
            (1.0 - 1e-9, 1.0 + 1e-9, &[1.0]),
            (1.0, 50.0, &[10.0, 20.0, 30.0, 40.0, 50.0]),
        ] {
            assert_eq!(Scale::whole("", low, high).ticks(300, |_| 40), expected, "{low} {high}");
        }
    }

    #[test]
    fn a_thinned_line_keeps_its_ends_and_extremes() {
        let wave = |k: i32| (f64::from(k) * 1e-3, (f64::from(k) * 0.7).sin());
        let points: Vec<_> = (0..100_000).map(wave).collect();
        let line = thinned(points.clone(), 0.1);
        assert!(line.len() <= 4 * 1001, "{}", line.len());
        assert_eq!((line[0], line[line.len() - 1]), (points[0], points[99_999]));
        assert!(line.is_sorted_by(|a, b| a.0 < b.0));
        let most = |line: &[(f64, f64)]| line.iter().map(|p| p.1).fold(0.0, f64::max);
        assert_eq!(most(&line), most(&points));
        // What is not dense stays as it is.
        let few: Vec<_> = (0..50).map(wave).collect();
        assert_eq!(thinned(few.clone(), 1e-3), few);
    }

    #[test]
    fn titles_and_legends_go_on_in_the_next_line() {
        assert_eq!(wrapped("one two three", 1000), ["one two three"]);
        let narrow = wrapped("heading error of a hundred runs, robust", 200);
        assert!(
            narrow.len() > 1 && narrow.iter().all(|line| text_width(line, TITLE) <= 200),
            "{narrow:?}"
        );
        assert_eq!(narrow.join(" "), "heading error of a hundred runs, robust");
        let key = |text| Key {
            text,
            style: INK.stroke_width(1),
        };
        let keys = [key("ideal filter"), key("predicted"), key("found")];
        assert_eq!(flow(&keys, 2000).1, 1);
        let (places, lines) = flow(&keys, 150);
        assert_eq!(lines, 3);
        assert!(places.iter().all(|(x, _)| *x == 0), "{places:?}");
        assert_eq!(flow(&[], 100).1, 0);
    }
}
