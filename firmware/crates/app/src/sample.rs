//! A sample of the IMU on its way through the unit, and where it comes from.

use drivers::{Channels, Identity, Scale};
use nav::increment::Sample;

/// A sample of the IMU with all that the alignment needs to know of it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TimedSample {
    /// End of its interval, µs of the unit's clock.
    pub t_us: u64,
    /// The increments, and the time lost before them.
    pub sample: Sample,
    /// The rotor's angle α at that instant, rad; `None` while the turn is unknown.
    pub alpha: Option<f32>,
    /// Temperature of the IMU, °C.
    pub temperature_c: f32,
    /// Sensors at the end of their range.
    pub saturated: Channels,
}

impl TimedSample {
    /// Whether attitude can be made of it: the rotor's angle is known, and no sensor was at the end of its range.
    pub fn is_usable(&self) -> bool {
        self.alpha.is_some() && self.saturated == Channels::NONE
    }
}

/// The IMU at work.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ImuFacts {
    /// Who it is.
    pub identity: Identity,
    /// What its counts are.
    pub scale: Scale,
    /// Nominal time from one sample to the next, s.
    pub period: f32,
}
