//! What goes to the terminal and into folders, for all commands.

use std::io::{self, Write as _};
use std::path::Path;
use std::process::ExitCode;

use indicatif::{ProgressBar, ProgressFinish, ProgressStyle};

use super::colour::{self, Sense};
use super::table;

/// What a command ends with: its exit code, or the message of an error.
pub(super) type Done = Result<ExitCode, String>;

/// Not aligned, or a result the unit does not stand by.
pub(super) const NOT_ALIGNED: u8 = 1;

/// A file, a scenario or an argument that cannot be used.
pub(super) const BAD_INPUT: u8 = 2;

/// One line of what happened when, above the progress bar.
pub(super) fn told(bar: &ProgressBar, quiet: bool, t: f64, event: &str) {
    if !quiet {
        bar.suspend(|| eprintln!("{t:8.2} s  {event}"));
    }
}

pub(super) fn bar(length: u64, unit: &str, quiet: bool) -> ProgressBar {
    if quiet {
        return ProgressBar::hidden();
    }
    let count = match unit {
        "bytes" => "{bytes} of {total_bytes}".to_owned(),
        unit => format!("{{pos}}/{{len}} {unit}"),
    };
    let style = ProgressStyle::with_template(&format!("{{bar:40}} {count}, {{eta}} left"))
        .unwrap_or_else(|_| ProgressStyle::default_bar());
    // Gone also where an error ends the work.
    ProgressBar::new(length)
        .with_style(style)
        .with_finish(ProgressFinish::AndClear)
}

/// The command as it was given, for a shell.
pub(super) fn command_line() -> String {
    let quoted = std::env::args_os().skip(1).map(|argument| {
        let argument = argument.to_string_lossy().into_owned();
        let plain = |c: char| c.is_ascii_alphanumeric() || "-_./=,:+".contains(c);
        if !argument.is_empty() && argument.chars().all(plain) {
            argument
        } else {
            format!("'{}'", argument.replace('\'', "'\\''"))
        }
    });
    let words: Vec<String> = core::iter::once("hal-sim".to_owned()).chain(quoted).collect();
    words.join(" ")
}

/// Makes the folder of a report, before anything is computed for it.
pub(super) fn folder(dir: &Path) -> Result<(), String> {
    std::fs::create_dir_all(dir).map_err(|e| {
        format!(
            "cannot make the folder {}: {e}: name another with --report DIR",
            dir.display()
        )
    })
}

/// That there is a folder for a file, before anything is computed for it.
pub(super) fn has_folder(path: &Path) -> Result<(), String> {
    match path.parent() {
        Some(folder) if folder != Path::new("") && !folder.is_dir() => Err(format!(
            "cannot write {}: there is no folder {}: make it first",
            path.display(),
            folder.display()
        )),
        _ => Ok(()),
    }
}

pub(super) fn cannot_write(path: &Path, error: &impl core::fmt::Display) -> String {
    format!("cannot write {}: {error}", path.display())
}

/// Writes to stdout; a reader that has gone away is not an error of ours.
pub(super) fn print(text: &str) -> Result<(), String> {
    match io::stdout().lock().write_all(text.as_bytes()) {
        Err(e) if e.kind() != io::ErrorKind::BrokenPipe => Err(format!("cannot write to stdout: {e}")),
        _ => Ok(()),
    }
}

pub(super) fn print_json(value: &impl serde::Serialize) -> Result<(), String> {
    let text = serde_json::to_string_pretty(value).map_err(words)?;
    print(&format!("{text}\n"))
}

pub(super) fn exit(state: &str) -> ExitCode {
    if table::is_aligned(state) {
        ExitCode::SUCCESS
    } else {
        ExitCode::from(NOT_ALIGNED)
    }
}

pub(super) fn warn(what: &str) {
    eprintln!("{} {what}", colour::said("warning:", Sense::Warning));
}

pub(super) fn words(error: impl core::fmt::Display) -> String {
    error.to_string()
}
