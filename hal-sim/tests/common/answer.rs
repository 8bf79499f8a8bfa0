//! The unit's answers on its serial line.

use hal_sim::bus::UartLine;

/// What the unit answers to a command, where a line is that.
pub(crate) fn answer(line: &UartLine) -> Option<String> {
    let text = String::from_utf8_lossy(&line.bytes);
    let answer = text.strip_prefix("$PRNSA,")?;
    Some(answer.split('*').next().unwrap_or_default().to_owned())
}
