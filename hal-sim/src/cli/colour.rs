//! Colours on a terminal, where one looks and nobody has asked for none.

use std::io::{self, IsTerminal as _};

use clap::builder::styling::{AnsiColor, Style};

/// What a word means.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Sense {
    Good,
    Warning,
    Bad,
}

/// The word for stdout.
pub(super) fn result(word: &str, sense: Sense) -> String {
    painted(word, sense, wanted(io::stdout().is_terminal()))
}

/// The word for stderr.
pub(super) fn said(word: &str, sense: Sense) -> String {
    painted(word, sense, wanted(io::stderr().is_terminal()))
}

/// As <https://no-color.org> has it.
fn wanted(terminal: bool) -> bool {
    let set = |name| std::env::var_os(name).unwrap_or_default();
    terminal && set("NO_COLOR").is_empty() && set("TERM") != "dumb"
}

fn painted(word: &str, sense: Sense, wanted: bool) -> String {
    if !wanted {
        return word.to_owned();
    }
    let colour = match sense {
        Sense::Good => AnsiColor::Green,
        Sense::Warning => AnsiColor::Yellow,
        Sense::Bad => AnsiColor::Red,
    };
    let style = Style::new().bold().fg_color(Some(colour.into()));
    format!("{style}{word}{style:#}")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_word_is_painted_only_where_it_is_wanted() {
        assert_eq!(painted("aligned", Sense::Good, false), "aligned");
        assert_eq!(painted("aligned", Sense::Good, true), "\x1b[1m\x1b[32maligned\x1b[0m");
        assert_ne!(painted("x", Sense::Bad, true), painted("x", Sense::Warning, true));
        assert!(!wanted(false));
    }
}
