//! One HTML page that needs nothing else: no file, no network, no script. Light or dark as the reader prefers, and as
//! wide as the window: plots are in it as drawn for a page and as drawn for a telephone.

use core::fmt::Write as _;

use crate::plot::{PlotError, Svg, Width, sheet};

/// A plot in both widths.
#[derive(Debug, Clone, PartialEq)]
pub struct Plot {
    /// Its file beside the page.
    pub file: String,
    /// What is to be seen, in a sentence or two.
    pub caption: String,
    page: Svg,
    phone: Svg,
}

impl Plot {
    /// Draws it.
    ///
    /// # Errors
    /// Those of `draw`.
    pub fn draw(
        file: impl Into<String>,
        caption: impl Into<String>,
        draw: impl Fn(Width) -> Result<Svg, PlotError>,
    ) -> Result<Self, PlotError> {
        Ok(Self {
            file: file.into(),
            caption: caption.into(),
            page: draw(Width::Page)?,
            phone: draw(Width::Phone)?,
        })
    }

    /// The plot as drawn for a page.
    pub fn svg(&self) -> &Svg {
        &self.page
    }
}

/// How a verdict sounds; told by a word beside it, not by colour alone.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Tone {
    /// It did what it should.
    Good,
    /// It did not.
    Bad,
    /// Neither: figures.
    Plain,
}

/// Style of the page. Colours are those of the plots, [`sheet`].
const STYLE: &str = "\
:root { color-scheme: light dark; --paper: #FFFFFF; --ink: #000000; --soft: #55595E; --line: #C9CDD2; --shade: #F3F4F6;
  --good: #00694C; --bad: #A84300; }
@media (prefers-color-scheme: dark) { :root { --paper: #14171A; --ink: #E8E8E8; --soft: #A9AFB6; --line: #4A5058;
  --shade: #1F2428; --good: #18B88C; --bad: #F0782C; } }
* { box-sizing: border-box; }
body { margin: 0 auto; padding: 1rem 1rem 3rem; max-width: 932px; background: var(--paper); color: var(--ink);
  font: 16px/1.5 system-ui, sans-serif; overflow-wrap: break-word; }
h1 { font-size: 1.6rem; line-height: 1.25; margin: 0.5rem 0; }
h2 { font-size: 1.2rem; margin: 2rem 0 0.5rem; }
p.lead { margin: 0; color: var(--soft); }
p.verdict { margin: 1rem 0; padding: 0.6rem 0.9rem; border-left: 5px solid var(--line); background: var(--shade);
  font-size: 1.1rem; }
p.good { border-color: var(--good); } p.good b { color: var(--good); }
p.bad { border-color: var(--bad); } p.bad b { color: var(--bad); }
.wide { overflow-x: auto; margin-bottom: 1.2rem; }
table { border-collapse: collapse; min-width: min(100%, 34rem); font-variant-numeric: tabular-nums; }
caption { text-align: left; color: var(--soft); padding-bottom: 0.3rem; }
th, td { padding: 0.2rem 0.9rem 0.2rem 0; text-align: right; border-bottom: 1px solid var(--line); white-space: nowrap; }
th:first-child, td:first-child, .words { text-align: left; }
td.words:nth-child(2) { white-space: normal; min-width: 14rem; }
thead th { border-bottom: 2px solid var(--soft); font-weight: bold; }
figure { margin: 1.5rem 0; }
figure svg { display: block; width: 100%; height: auto; }
figure svg.phone { display: none; }
figcaption { color: var(--soft); font-size: 0.95rem; }
pre { padding: 0.7rem 0.9rem; background: var(--shade); white-space: pre-wrap; overflow-wrap: anywhere;
  font: 0.85rem/1.45 ui-monospace, monospace; }
footer { margin-top: 2.5rem; color: var(--soft); font-size: 0.9rem; }
@media (max-width: 640px) { figure svg.page { display: none; } figure svg.phone { display: block; }
  body { padding: 0.6rem 0.75rem 2rem; } th, td { padding-right: 0.5rem; font-size: 0.88rem; } }
@media print { body { max-width: none; } figure, table { break-inside: avoid; } }
";

/// A page that is being written. Every text is escaped.
#[derive(Debug)]
pub struct Page {
    title: String,
    body: String,
}

/// A text as HTML has it, within elements and within attributes.
fn escaped(text: &str) -> String {
    let mut html = String::with_capacity(text.len());
    for c in text.chars() {
        match c {
            '&' => html += "&amp;",
            '<' => html += "&lt;",
            '>' => html += "&gt;",
            '"' => html += "&quot;",
            '\'' => html += "&#39;",
            _ => html.push(c),
        }
    }
    html
}

// Writing to a String does not fail.
impl Page {
    /// A page with this title, and a line on what it is about.
    pub fn new(title: &str, lead: &str) -> Self {
        let (heading, lead) = (escaped(title), escaped(lead));
        Self {
            title: title.to_owned(),
            body: format!("<h1>{heading}</h1>\n<p class=\"lead\">{lead}</p>\n"),
        }
    }

    /// What came out, in a sentence behind a word.
    pub fn verdict(&mut self, tone: Tone, word: &str, sentence: &str) {
        let class = match tone {
            Tone::Good => "verdict good",
            Tone::Bad => "verdict bad",
            Tone::Plain => "verdict",
        };
        let (word, sentence) = (escaped(word), escaped(sentence));
        let _ = writeln!(self.body, "<p class=\"{class}\"><b>{word}</b> {sentence}</p>");
    }

    /// The title of what follows.
    pub fn section(&mut self, title: &str) {
        let _ = writeln!(self.body, "<h2>{}</h2>", escaped(title));
    }

    /// Some sentences.
    pub fn paragraph(&mut self, text: &str) {
        let _ = writeln!(self.body, "<p>{}</p>", escaped(text));
    }

    /// A table: the first column names the rows; of the others those are words in which a cell begins with a letter.
    pub fn table(&mut self, caption: &str, heads: &[&str], rows: &[Vec<String>]) {
        self.body += "<div class=\"wide\"><table>\n";
        if !caption.is_empty() {
            let _ = writeln!(self.body, "<caption>{}</caption>", escaped(caption));
        }
        let begins = |cell: &String| cell.starts_with(char::is_alphabetic);
        let class = |column: usize| {
            let words = rows.iter().any(|row| row.get(column).is_some_and(begins));
            if words { " class=\"words\"" } else { "" }
        };
        let classes: Vec<_> = (0..heads.len()).map(class).collect();
        self.body += "<thead><tr>";
        for (head, class) in heads.iter().zip(&classes) {
            let _ = write!(self.body, "<th{class}>{}</th>", escaped(head));
        }
        self.body += "</tr></thead>\n<tbody>\n";
        for row in rows {
            self.body += "<tr>";
            for (cell, class) in row.iter().zip(&classes) {
                let _ = write!(self.body, "<td{class}>{}</td>", escaped(cell));
            }
            self.body += "</tr>\n";
        }
        self.body += "</tbody></table></div>\n";
    }

    /// A plot with its caption.
    pub fn plot(&mut self, plot: &Plot) {
        let file = escaped(&plot.file);
        let label = if plot.caption.is_empty() {
            file
        } else {
            format!("{} ({file})", escaped(&plot.caption))
        };
        self.body += "<figure>\n";
        for (class, svg) in [("page", &plot.page), ("phone", &plot.phone)] {
            let element = svg.element();
            let inside = element.strip_prefix("<svg ").unwrap_or(element);
            let _ = write!(
                self.body,
                "<svg class=\"{class}\" role=\"img\" aria-label=\"{label}\" {inside}"
            );
        }
        let _ = writeln!(self.body, "<figcaption>{label}</figcaption>\n</figure>");
    }

    /// Something to be copied: a command, a file.
    pub fn code(&mut self, text: &str) {
        let _ = writeln!(self.body, "<pre>{}</pre>", escaped(text.trim_end()));
    }

    /// The same, folded up under its title.
    pub fn folded(&mut self, title: &str, text: &str) {
        let (title, text) = (escaped(title), escaped(text.trim_end()));
        let _ = writeln!(
            self.body,
            "<details><summary>{title}</summary>\n<pre>{text}</pre></details>"
        );
    }

    /// The whole document.
    pub fn html(&self) -> String {
        format!(
            "<!DOCTYPE html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n\
             <meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\n<title>{}</title>\n\
             <style>\n{STYLE}{}</style>\n</head>\n<body>\n{}<footer>hal-sim {}</footer>\n</body>\n</html>\n",
            escaped(&self.title),
            sheet::dark_style(),
            self.body,
            env!("CARGO_PKG_VERSION")
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_text_is_escaped() {
        let evil = "<script>&\"'";
        let plot = Plot::draw(evil, evil, |width| {
            crate::plot::heading_histogram(width, evil, &[0.1, -0.2], 0.3, 0.3)
        });
        let mut page = Page::new(evil, evil);
        page.verdict(Tone::Bad, evil, evil);
        page.section(evil);
        page.paragraph(evil);
        page.table(evil, &[evil], &[vec![evil.to_owned()]]);
        page.plot(&plot.unwrap());
        page.code(evil);
        page.folded(evil, evil);
        let html = page.html();
        assert!(!html.contains("<script"), "{html}");
        // Title twice, lead, verdict twice, section, paragraph, table thrice, caption and file of a plot thrice, code, folded
        // twice.
        assert_eq!(html.matches("&lt;script&gt;&amp;&quot;&#39;").count(), 19);
    }

    #[test]
    fn the_page_and_the_plots_have_one_paper_and_one_ink() {
        let html = Page::new("", "").html();
        for rule in [
            "svg [fill=\"#FFFFFF\"] { fill: #14171A }",
            "svg [fill=\"#000000\"] { fill: #E8E8E8 }",
            "--paper: #FFFFFF; --ink: #000000",
            "--paper: #14171A; --ink: #E8E8E8",
        ] {
            assert!(html.contains(rule), "{rule}");
        }
    }

    #[test]
    fn columns_of_words_are_to_the_left_and_those_of_figures_to_the_right() {
        let mut page = Page::new("", "");
        let rows =
            [["x (°)", "1.5", "±1", "[1]"], ["y (°)", "−2", "equal", ""]].map(|row| row.map(str::to_owned).to_vec());
        page.table("", &["", "ours", "by", "note"], &rows);
        let html = page.html();
        for part in [
            "<th class=\"words\"></th><th>ours</th><th class=\"words\">by</th><th>note</th>",
            "<td class=\"words\">x (°)</td><td>1.5</td><td class=\"words\">±1</td><td>[1]</td>",
        ] {
            assert!(html.contains(part), "{html}");
        }
    }
}
