//! What a link shows: a picture with a dial on a terminal, lines elsewhere. Pure: text out.

use std::collections::VecDeque;
use std::path::Path;

use super::monitor::{FRESH_S, LineEvent, Monitor};
use crate::dial::dial;

/// About what a calibration takes, s: a minute at rest, four legs of 18 s, and coming to rest.
pub const CALIBRATION_S: f64 = 135.0;
/// Empties a terminal.
pub const CLEAR: &str = "\x1b[2J";
/// Answers that are shown.
const ANSWERS: usize = 5;
/// Half the dial's height, lines.
const RADIUS: u8 = 6;
/// Columns from the dial to the values.
const GAP: &str = "    ";

/// The latest answers and messages.
#[derive(Debug, Default)]
pub struct Answers(VecDeque<String>);

impl Answers {
    /// Keeps it, if it is one.
    pub fn take(&mut self, heard: &LineEvent) {
        let line = match heard {
            LineEvent::Answer { ok, text } => answer(*ok, text),
            LineEvent::Text(text) => text.clone(),
            LineEvent::Status | LineEvent::Other => return,
        };
        if self.0.len() == ANSWERS {
            self.0.pop_front();
        }
        self.0.push_back(line);
    }
}

/// An answer for people.
pub fn answer(ok: bool, text: &str) -> String {
    if ok { text.to_owned() } else { format!("error: {text}") }
}

/// A value with its sign and unit, or a dash.
fn value(value: Option<f64>, decimals: usize, unit: &str) -> String {
    value.map_or("-".to_owned(), |value| format!("{value:+.decimals$}{unit}"))
}

fn grade(letter: char) -> &'static str {
    match letter {
        'A' => "valid",
        'E' => "estimated",
        'M' => "set by hand",
        'S' => "simulated",
        _ => "not valid",
    }
}

/// The values beside the dial.
fn values(monitor: &Monitor, now_s: f64) -> Vec<(&'static str, String)> {
    let (heading, letter) = monitor.heading(now_s);
    let status = monitor.status().cloned().unwrap_or_default();
    let sd = status.heading_sd.map_or(String::new(), |sd| format!("  1σ {sd:.3}°"));
    let level = monitor.level(now_s);
    let heading = heading.map_or("-".to_owned(), |heading| format!("{heading:.2}°"));
    let mut all = vec![
        ("heading", format!("{heading}  {}{sd}", grade(letter))),
        ("pitch", value(level.map(|level| level.pitch), 2, "°")),
        ("roll", value(level.map(|level| level.roll), 2, "°")),
        ("turn", value(monitor.turn(now_s), 1, "°/min")),
        (
            "rotor",
            status.rotor.map_or("-".to_owned(), |rotor| format!("{rotor:.2}°")),
        ),
        ("mode", format!("{} for {:.0} s", status.mode, status.mode_s)),
    ];
    if status.mode == "calibrating" {
        all.push(("", progress(status.mode_s)));
    }
    let dash = |text: &str| if text.is_empty() { "-" } else { text }.to_owned();
    all.push(("reason", dash(&status.reason)));
    let fault = status.fault.map_or("-".to_owned(), |(name, stays)| {
        let stays = if stays {
            "stays until reset"
        } else {
            "the unit tries again"
        };
        format!("{name}: {stays}")
    });
    all.push(("fault", fault));
    if let Some((place, speed)) = monitor.track(now_s) {
        let place = format!("{:+.5}° {:+.5}°, {speed:.2} m/s", place.latitude, place.longitude);
        all.push(("place", place));
    }
    all.push(("up", format!("{:.0} s", status.up_s)));
    all
}

fn progress(seconds: f64) -> String {
    const WIDTH: usize = 20;
    let done = (seconds / CALIBRATION_S).clamp(0.0, 1.0);
    let full = (done * WIDTH as f64) as usize;
    format!(
        "[{}{}] {seconds:.0} of {CALIBRATION_S:.0} s: keep the base still",
        "#".repeat(full),
        ".".repeat(WIDTH - full)
    )
}

/// What the line itself is like.
fn line_state(monitor: &Monitor, now_s: f64) -> String {
    let counts = monitor.counts();
    let mut text = format!(
        "{:.0} sentences/s, {} check sums wrong, {} broken",
        monitor.rate(now_s),
        counts.checksum,
        counts.broken
    );
    if counts.frames + counts.damaged > 0 {
        text += &format!(", {} frames, {} damaged", counts.frames, counts.damaged);
    }
    let silent_s = monitor.silent_s(now_s);
    if silent_s > FRESH_S {
        text += &format!(", SILENT for {silent_s:.0} s");
    }
    text
}

/// The whole picture, line by line, always as many.
pub fn picture(name: &str, monitor: &Monitor, answers: &Answers, record: Option<&Path>, now_s: f64) -> Vec<String> {
    let (heading, letter) = monitor.heading(now_s);
    let sd = monitor
        .status()
        .and_then(|status| status.heading_sd)
        .unwrap_or_default();
    let mut title = format!("{name}: {}", line_state(monitor, now_s));
    if let Some(path) = record {
        title += &format!(", {} kB to {}", monitor.counts().bytes / 1000, path.display());
    }
    let mut picture = vec![title, String::new()];
    let mut values = values(monitor, now_s).into_iter();
    for line in dial(RADIUS, heading, sd, letter == 'A') {
        let beside = values
            .next()
            .map_or(String::new(), |(name, value)| format!("{name:<9}{value}"));
        picture.push(format!("  {line}{GAP}{beside}"));
    }
    picture.push(String::new());
    picture.extend(answers.0.iter().map(|answer| format!("  {answer}")));
    let height = 2 * RADIUS as usize + 1 + 3 + ANSWERS;
    picture.resize(height, String::new());
    picture
}

/// A picture as a terminal takes it: in place of the one before, with the cursor where somebody types, below it; what was
/// typed there is taken away when it has been sent.
pub fn painted(picture: &[String], typed: bool, colours: bool) -> String {
    // Save the cursor, home; a line, clear to its end; back.
    let mut text = "\x1b7\x1b[H".to_owned();
    for line in picture {
        let line = if colours { coloured(line) } else { line.clone() };
        text += &format!("{line}\x1b[K\r\n");
    }
    text += "\x1b8";
    if typed {
        text += &format!("\x1b[{};1H\x1b[J> ", picture.len() + 1);
    }
    text
}

/// What must be seen is seen: a heading by its worth, what is wrong in red.
fn coloured(line: &str) -> String {
    let paint = |line: &str, what: &str, colour: u8| line.replace(what, &format!("\x1b[{colour}m{what}\x1b[0m"));
    let mut line = line.to_owned();
    for (what, colour) in [
        ("not valid", 31),
        ("estimated", 33),
        ("SILENT", 31),
        ("error:", 31),
        ("◆", 32),
        ("◇", 33),
    ] {
        line = paint(&line, what, colour);
    }
    if !line.contains("not valid") {
        line = paint(&line, "valid", 32);
    }
    line
}

/// The same on one line, for a file or a pipe.
pub fn line(monitor: &Monitor, now_s: f64) -> String {
    let status = monitor.status().cloned().unwrap_or_default();
    let mut text = format!("{:.2} s  {} {:.0} s", status.up_s, status.mode, status.mode_s);
    let (heading, letter) = monitor.heading(now_s);
    let number = |value: Option<f64>, decimals: usize| value.map_or("-".to_owned(), |v| format!("{v:.decimals$}"));
    text += &format!("  heading {} {letter}", number(heading, 2));
    if let Some(sd) = status.heading_sd {
        text += &format!(" sd {sd:.3}");
    }
    if let Some(level) = monitor.level(now_s) {
        text += &format!("  pitch {:+.2} roll {:+.2}", level.pitch, level.roll);
    }
    if let Some(turn) = monitor.turn(now_s) {
        text += &format!("  turn {turn:+.1}");
    }
    if let Some((place, speed)) = monitor.track(now_s) {
        text += &format!(
            "  place {:+.5} {:+.5} speed {speed:.2}",
            place.latitude, place.longitude
        );
    }
    text += &format!("  rotor {}", number(status.rotor, 2));
    if !status.reason.is_empty() {
        text += &format!("  {}", status.reason);
    }
    if let Some((fault, stays)) = status.fault {
        text += &format!("  fault {fault}{}", if stays { ", stays" } else { "" });
    }
    text + &format!("  ({})", line_state(monitor, now_s))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn monitor() -> Monitor {
        let mut monitor = Monitor::default();
        for line in [
            "$HETHS,90.00,A*10\r\n",
            "$PASHR,,90.00,T,-4.90,-4.99,,0.001,0.001,0.468,0,1*18\r\n",
            "$PRNST,184.08,aligned,115,0.468,,,,34.49*09\r\n",
        ] {
            let bytes = line.as_bytes();
            let body = line.trim_start_matches('$').split('*').next().unwrap();
            let sum = body.bytes().fold(0, |sum, byte| sum ^ byte);
            let line = format!("${body}*{sum:02X}\r\n");
            assert_eq!(line.len(), bytes.len());
            monitor.take(line.as_bytes(), 1.0, &mut |_, _| ());
        }
        monitor
    }

    #[test]
    fn a_picture_keeps_its_size_and_says_what_is_old() {
        let (monitor, mut answers) = (monitor(), Answers::default());
        let height = picture("unit", &monitor, &answers, None, 1.0).len();
        for k in 0..20 {
            answers.take(&LineEvent::Answer {
                ok: k % 2 == 0,
                text: format!("{k}"),
            });
            assert_eq!(picture("unit", &monitor, &answers, None, 1.0).len(), height);
        }
        answers.take(&LineEvent::Text("gyros calibrated".to_owned()));
        let shown = picture("unit", &monitor, &answers, Some(Path::new("run.bin")), 1.1).join("\n");
        for part in [
            "gyros calibrated",
            "90.00°  valid  1σ 0.468°",
            "-4.99°",
            "aligned for 115 s",
            "34.49°",
            "run.bin",
            "error: 19",
        ] {
            assert!(shown.contains(part), "{part}:\n{shown}");
        }
        assert!(!shown.contains("SILENT"), "{shown}");
        let later = picture("unit", &monitor, &answers, None, 9.0).join("\n");
        assert!(
            later.contains("SILENT for 8 s") && later.contains("not valid"),
            "{later}"
        );
        assert!(!later.contains('◆'), "{later}");
    }

    #[test]
    fn a_line_has_all_of_it() {
        let line = line(&monitor(), 1.0);
        assert!(
            line.starts_with("184.08 s  aligned 115 s  heading 90.00 A sd 0.468  pitch -4.99 roll -4.90"),
            "{line}"
        );
    }

    #[test]
    fn a_calibration_shows_how_far_it_is() {
        for (seconds, shown) in [(0.0, "[...."), (67.5, "[##########.....")] {
            assert!(progress(seconds).starts_with(shown));
        }
        assert!(progress(1e9).contains("[####################]"));
    }
}
