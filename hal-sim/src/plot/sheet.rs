//! What all plots share: the sheet they are drawn on, its colours, and how they follow a light or a dark page.

use core::fmt::Write as _;
use std::fs;
use std::path::Path;

use plotters::coord::Shift;
use plotters::prelude::*;

use super::PlotError;

// Okabe and Ito's colours, which the colour-blind can tell.
pub(crate) const BLUE: RGBColor = RGBColor(0, 114, 178);
pub(crate) const VERMILION: RGBColor = RGBColor(213, 94, 0);
pub(crate) const GREEN: RGBColor = RGBColor(0, 158, 115);
pub(crate) const PURPLE: RGBColor = RGBColor(204, 121, 167);
pub(crate) const SKY: RGBColor = RGBColor(86, 180, 233);
pub(crate) const ORANGE: RGBColor = RGBColor(230, 159, 0);
pub(crate) const YELLOW: RGBColor = RGBColor(240, 228, 66);
pub(crate) const GREY: RGBColor = RGBColor(110, 110, 110);
/// Lines of the mesh.
pub(crate) const MESH: RGBColor = RGBColor(225, 225, 225);
/// Letters, axes, single marks.
pub(crate) const INK: RGBColor = RGBColor(0, 0, 0);
/// Behind everything.
pub(crate) const PAPER: RGBColor = RGBColor(255, 255, 255);

/// What the colours are on a dark page: those that are dark themselves become lighter, and sky lighter than blue.
const ON_DARK: [(RGBColor, RGBColor); 11] = [
    (PAPER, RGBColor(20, 23, 26)),
    (INK, RGBColor(232, 232, 232)),
    (MESH, RGBColor(58, 63, 69)),
    (GREY, RGBColor(160, 160, 160)),
    (BLUE, RGBColor(74, 163, 230)),
    (VERMILION, RGBColor(240, 120, 44)),
    (GREEN, RGBColor(24, 184, 140)),
    (PURPLE, PURPLE),
    (SKY, RGBColor(168, 221, 247)),
    (ORANGE, ORANGE),
    (YELLOW, YELLOW),
];

pub(crate) const FONT: &str = "sans-serif";
/// Sizes of the letters of titles, axes and ticks, as the library counts them: a browser's pixels times 1.24.
pub(crate) const TITLE: u32 = 19;
pub(crate) const LABEL: u32 = 17;
pub(crate) const TICK: u32 = 16;

/// Width of a text, pixels, rather more than less: which letters it will have is the reader's affair.
pub(crate) fn text_width(text: &str, size: u32) -> u32 {
    u32::try_from(text.chars().count()).unwrap_or(0) * size * 48 / 100
}

pub(crate) fn hex(RGBColor(red, green, blue): RGBColor) -> String {
    format!("#{red:02X}{green:02X}{blue:02X}")
}

/// Rules that turn the colours of all plots within a document, where the reader prefers a dark page.
pub(crate) fn dark_style() -> String {
    let mut rules = String::from("@media (prefers-color-scheme: dark) {\n");
    for (light, dark) in ON_DARK.map(|(light, dark)| (hex(light), hex(dark))) {
        // Writing to a String does not fail.
        let _ = writeln!(rules, "svg [fill=\"{light}\"] {{ fill: {dark} }}");
        let _ = writeln!(rules, "svg [stroke=\"{light}\"] {{ stroke: {dark} }}");
    }
    rules + "}\n"
}

/// How wide a plot is drawn. What is drawn for a page is illegible on a telephone, and its labels would overlap there.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Width {
    /// Of a page, or a file of its own.
    Page,
    /// Of a telephone.
    Phone,
}

impl Width {
    pub(crate) fn pixels(self) -> u32 {
        match self {
            Self::Page => 900,
            Self::Phone => 388,
        }
    }
}

pub(crate) type Area<'a> = DrawingArea<SVGBackend<'a>, Shift>;

/// A plot, drawn: the element `<svg>`.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Svg(String);

impl Svg {
    /// Draws on a sheet of this width and height.
    pub(crate) fn draw(
        size: (u32, u32),
        what: impl FnOnce(&Area<'_>) -> Result<(), PlotError>,
    ) -> Result<Self, PlotError> {
        let mut text = String::new();
        {
            let sheet = SVGBackend::with_string(&mut text, size).into_drawing_area();
            sheet.fill(&PAPER)?;
            what(&sheet)?;
            sheet.present()?;
        }
        Ok(Self(text))
    }

    /// The element, for a document that has [`dark_style`].
    pub(crate) fn element(&self) -> &str {
        &self.0
    }

    /// Writes a file that follows a dark page by itself.
    ///
    /// # Errors
    /// [`PlotError`] where the file cannot be written.
    pub fn save(&self, path: &Path) -> Result<(), PlotError> {
        let (open, rest) = self.0.split_once(">\n").unwrap_or(("", &self.0));
        let text = format!("{open}>\n<style>\n{}</style>\n{rest}", dark_style());
        fs::write(path, text).map_err(|e| PlotError::new(&e))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Luminance as WCAG has it.
    fn luminance(RGBColor(red, green, blue): RGBColor) -> f64 {
        let linear = |c: u8| {
            let c = f64::from(c) / 255.0;
            if c <= 0.040_45 {
                c / 12.92
            } else {
                ((c + 0.055) / 1.055).powf(2.4)
            }
        };
        0.2126 * linear(red) + 0.7152 * linear(green) + 0.0722 * linear(blue)
    }

    fn contrast(a: RGBColor, b: RGBColor) -> f64 {
        let (a, b) = (luminance(a) + 0.05, luminance(b) + 0.05);
        (a / b).max(b / a)
    }

    #[test]
    fn every_colour_has_contrast_on_a_dark_page_and_letters_on_both() {
        let paper = ON_DARK[0].1;
        for (light, dark) in ON_DARK.iter().skip(1).filter(|(light, _)| *light != MESH) {
            assert!(contrast(*dark, paper) > 4.5, "{light:?}: {}", contrast(*dark, paper));
        }
        for letters in [INK, GREY] {
            assert!(contrast(letters, PAPER) > 4.5, "{letters:?}");
        }
    }

    #[test]
    fn a_file_follows_a_dark_page_and_escapes_its_texts() {
        let dir = tempfile::TempDir::new().unwrap();
        let path = dir.path().join("a.svg");
        let svg = Svg::draw((100, 50), |area| {
            area.draw(&Text::new("<b>&\"", (5, 5), (FONT, TICK).into_text_style(area)))?;
            Ok(())
        });
        svg.unwrap().save(&path).unwrap();
        let text = fs::read_to_string(path).unwrap();
        assert!(
            text.starts_with("<svg ") && text.trim_end().ends_with("</svg>"),
            "{text}"
        );
        assert_eq!(text.matches("<style>").count(), 1);
        assert!(text.contains("svg [fill=\"#FFFFFF\"] { fill: #14171A }"), "{text}");
        assert!(text.contains("&lt;b&gt;&amp;") && !text.contains("<b>"), "{text}");
    }
}
