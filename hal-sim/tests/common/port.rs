//! An observer of the whole unit's serial port.

use app::shared::Navigation;
use hal_sim::bus::UartLine;
use hal_sim::unit_sim::Observer;

/// All that comes from the unit's serial port, and the estimates behind it.
#[derive(Default)]
pub(crate) struct Port {
    pub(crate) lines: Vec<UartLine>,
    pub(crate) estimates: Vec<Navigation>,
}

impl Observer for Port {
    fn sentence(&mut self, line: &UartLine) {
        self.lines.push(line.clone());
    }

    fn estimate(&mut self, navigation: &Navigation) {
        self.estimates.push(*navigation);
    }
}

impl Port {
    /// The latest estimate at the first byte of a line.
    pub(crate) fn estimate_at(&self, line: &UartLine) -> Option<&Navigation> {
        let begun_us = line.started_ns / 1000;
        let next = self.estimates.partition_point(|at| at.t_us < begun_us);
        self.estimates.get(next.checked_sub(1)?)
    }
}
