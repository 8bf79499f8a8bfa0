//! Time of day of a receiver of satellite navigation, carried on by the unit's clock.
//!
//! ```text
//! UTC(t) = UTC of the last fix + (t − when its sentence had come)     modulo a day
//! ```
//!
//! - It is late by what the receiver needs from the instant of a fix to the end of its sentence, some tenths of a second with
//!   most; its manual says how long. Nothing here takes that off.
//! - For [`HOLDS_US`] it goes on without a fix. By a crystal that is off by 100 ppm it is then off by 60 ms.
//! - There is no date, and therefore no leap second: in the one second that is 23:59:60 it says 00:00:00, and with the next
//!   fix it is right again.
//!
//! Pure.

/// A day, ms.
const DAY_MS: u32 = 86_400_000;
/// How long a time is carried on without another fix, µs.
pub const HOLDS_US: u64 = 600_000_000;

/// Time of day, UTC.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct TimeOfDay {
    /// Since midnight, ms, below a day.
    ms: u32,
}

impl TimeOfDay {
    /// `hhmmss` as one decimal number, and ms within the second; `None` where that is no time of a day. Second 60 is none.
    pub fn new(hhmmss: u32, ms: u32) -> Option<Self> {
        let (hours, minutes, seconds) = (hhmmss / 10_000, hhmmss / 100 % 100, hhmmss % 100);
        let is_time = hours < 24 && minutes < 60 && seconds < 60 && ms < 1000;
        is_time.then(|| Self {
            ms: ((hours * 60 + minutes) * 60 + seconds) * 1000 + ms,
        })
    }

    /// `hhmmss` as one decimal number, and ms within the second.
    pub fn parts(self) -> (u32, u32) {
        let seconds = self.ms / 1000;
        let hhmmss = seconds / 3600 * 10_000 + seconds / 60 % 60 * 100 + seconds % 60;
        (hhmmss, self.ms % 1000)
    }
}

/// The last time of day that a receiver has said.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Utc {
    /// What it was.
    pub said: TimeOfDay,
    /// When that had come, µs of the unit's clock.
    pub t_us: u64,
}

impl Utc {
    /// The time of day at `t_us` of the unit's clock, before or after it was said; `None` where that is further off than
    /// [`HOLDS_US`].
    pub fn at(&self, t_us: u64) -> Option<TimeOfDay> {
        let apart_us = t_us.abs_diff(self.t_us);
        // Below 2³², as `HOLDS_US` is.
        let apart_ms = u32::try_from(apart_us / 1000).ok().filter(|_| apart_us <= HOLDS_US)?;
        let ms = if t_us < self.t_us {
            self.said.ms + DAY_MS - apart_ms
        } else {
            self.said.ms + apart_ms
        };
        Some(TimeOfDay { ms: ms % DAY_MS })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn time(hhmmss: u32, ms: u32) -> TimeOfDay {
        TimeOfDay::new(hhmmss, ms).unwrap()
    }

    #[test]
    fn times_of_a_day_and_no_others() {
        for (hhmmss, ms) in [(0, 0), (123_519, 7), (235_959, 999), (90_807, 60)] {
            assert_eq!(time(hhmmss, ms).parts(), (hhmmss, ms));
        }
        for (hhmmss, ms) in [(240_000, 0), (126_000, 0), (235_960, 0), (0, 1000), (u32::MAX, 0)] {
            assert_eq!(TimeOfDay::new(hhmmss, ms), None, "{hhmmss} {ms}");
        }
    }

    #[test]
    fn it_goes_on_over_midnight_and_back_and_ends() {
        let utc = Utc {
            said: time(235_958, 500),
            t_us: 1_000_000_000,
        };
        for (t_us, expected) in [
            (1_000_000_000, Some((235_958, 500))),
            (1_000_000_999, Some((235_958, 500))),
            (1_001_499_000, Some((235_959, 999))),
            (1_001_500_000, Some((0, 0))),
            (1_061_510_000, Some((100, 10))),
            // An estimate may be older than the sentence.
            (999_950_000, Some((235_958, 450))),
            (1_000_000_000 + HOLDS_US, Some((958, 500))),
            (1_000_000_001 + HOLDS_US, None),
            (u64::MAX, None),
        ] {
            assert_eq!(utc.at(t_us).map(TimeOfDay::parts), expected, "{t_us}");
        }
        let early = Utc {
            said: time(0, 10),
            t_us: 100_000,
        };
        assert_eq!(early.at(0).map(TimeOfDay::parts), Some((235_959, 910)));
    }
}
