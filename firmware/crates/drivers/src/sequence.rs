//! Lost and repeated samples: counted, never merged.
//!
//! A pure state machine fed with each sample's [`Sequence`] and edge time. With a counter, the
//! difference modulo 2¹⁶ tells exactly how many samples are missing. Without one (ICM-42688-P) the
//! edge times tell it, to within half a period of jitter.
//!
//! Where it is not known what a counter counts, samples or the part's own faster ones, the first few samples tell: see
//! [`SampleTracker::learn`].
//!
//! Not modelled: a loss of 65,536 samples less a few looks like a short one, and so does a restart
//! whose counter happens to land within `max_lost` of the old one. Either takes minutes or bad luck,
//! and a restart shows in the part's settings as well.

use core::num::NonZeroU16;

use crate::Sequence;

/// How samples should follow each other.
///
/// | field | unit | zero means | sane value |
/// |---|---|---|---|
/// | `step` | counts | not possible | 1; what is learnt takes its place |
/// | `period_us` | µs | edge times are not judged | the part's output period |
/// | `max_lost` | samples | every gap is a restart | 1000 |
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct TrackerConfig {
    /// What the part's counter gains from one sample to the next.
    pub step: NonZeroU16,
    /// Time from one sample to the next, µs. Used only for parts without a counter.
    pub period_us: u32,
    /// The longest gap that is believed to be a loss; a longer one is a restart of the part.
    pub max_lost: u16,
}

impl Default for TrackerConfig {
    fn default() -> Self {
        Self {
            step: NonZeroU16::MIN,
            period_us: 0,
            max_lost: 1000,
        }
    }
}

/// What a sample is in relation to the one before.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Arrival {
    /// The first one: nothing to compare with.
    First,
    /// The next one.
    Next,
    /// The same one again: do not integrate it twice.
    Repeated,
    /// This many are missing before it.
    Lost(u16),
    /// The count makes no sense as a continuation: the part has restarted.
    Restarted,
}

/// Totals since the tracker was made. They stop at their largest value.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Tally {
    /// Samples that were new.
    pub received: u32,
    /// Samples that never came.
    pub lost: u32,
    /// Samples that came again.
    pub repeated: u32,
    /// Restarts of the part.
    pub restarts: u32,
}

/// So many samples in a row must agree on what the counter counts.
const AGREE: u8 = 4;

/// Two things that a counter may count, and what the samples say so far.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Learning {
    base: NonZeroU16,
    period_us: u32,
    /// What the last samples said, and how many in a row.
    said: Option<NonZeroU16>,
    times: u8,
}

/// Follows the samples of one part.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct SampleTracker {
    config: TrackerConfig,
    learning: Option<Learning>,
    last: Option<(Sequence, u64)>,
    tally: Tally,
}

impl SampleTracker {
    /// A tracker that has seen nothing.
    pub fn new(config: TrackerConfig) -> Self {
        Self {
            config,
            learning: None,
            last: None,
            tally: Tally::default(),
        }
    }

    /// Learns what the counter gains from one sample to the next: 1, or `base`, where the part makes a sample of so many
    /// of its own and counts those. Samples come every `period_us`, give or take a third.
    ///
    /// Until four samples in a row agree, and for ever where they never do, samples are judged by their times, as those of
    /// a part without a counter. The last sample is forgotten.
    pub fn learn(&mut self, base: NonZeroU16, period_us: u32) {
        self.last = None;
        self.learning = None;
        self.config.step = NonZeroU16::MIN;
        if base > NonZeroU16::MIN {
            self.learning = Some(Learning {
                base,
                period_us,
                said: None,
                times: 0,
            });
        }
    }

    /// What the counter gains from one sample to the next; `None` while that is not known.
    pub fn step(&self) -> Option<NonZeroU16> {
        self.learning.is_none().then_some(self.config.step)
    }

    /// The totals.
    pub fn tally(&self) -> Tally {
        self.tally
    }

    /// Forgets the last sample, not the totals: after the part was configured anew on purpose.
    pub fn resynchronise(&mut self) {
        self.last = None;
    }

    /// Judges a sample that became ready at `t_us`.
    pub fn arrive(&mut self, sequence: Sequence, t_us: u64) -> Arrival {
        let arrival = match (self.last, sequence) {
            (_, Sequence::Fresh(false)) => Arrival::Repeated,
            (Some((Sequence::Counter(old), old_us)), Sequence::Counter(new)) => {
                self.by_counter(new.wrapping_sub(old), t_us.saturating_sub(old_us))
            }
            (Some((Sequence::Fresh(_), old_us)), Sequence::Fresh(true)) => match self.config.period_us {
                0 => Arrival::Next,
                period_us => self.gap(periods(t_us.saturating_sub(old_us), period_us)),
            },
            _ => Arrival::First,
        };
        let tally = &mut self.tally;
        match arrival {
            Arrival::Repeated => {
                tally.repeated = tally.repeated.saturating_add(1);
                return arrival;
            }
            Arrival::Lost(missing) => tally.lost = tally.lost.saturating_add(u32::from(missing)),
            Arrival::Restarted => tally.restarts = tally.restarts.saturating_add(1),
            Arrival::First | Arrival::Next => {}
        }
        tally.received = tally.received.saturating_add(1);
        self.last = Some((sequence, t_us));
        arrival
    }

    fn by_counter(&mut self, delta: u16, passed_us: u64) -> Arrival {
        if delta == 0 {
            return Arrival::Repeated;
        }
        if let Some(learning) = &mut self.learning {
            let samples = periods(passed_us, learning.period_us);
            let [one, base] =
                [NonZeroU16::MIN, learning.base].map(|step| u64::from(delta) == samples * u64::from(step.get()));
            let said = match (one, base) {
                (true, _) => Some(NonZeroU16::MIN),
                (_, true) => Some(learning.base),
                _ => None,
            };
            learning.times = if said.is_some() && said == learning.said {
                learning.times + 1
            } else {
                u8::from(said.is_some())
            };
            learning.said = said;
            if let Some(step) = said
                && learning.times >= AGREE
            {
                self.config.step = step;
                self.learning = None;
            }
            return self.gap(samples);
        }
        if !delta.is_multiple_of(self.config.step.get()) {
            return Arrival::Restarted;
        }
        self.gap(u64::from(delta / self.config.step))
    }

    fn gap(&self, samples: u64) -> Arrival {
        match u16::try_from(samples - 1) {
            Ok(0) => Arrival::Next,
            Ok(missing) if missing <= self.config.max_lost => Arrival::Lost(missing),
            _ => Arrival::Restarted,
        }
    }
}

/// Whole periods in a time. Two edges closer than half of one are jitter: the data are fresh, so it is the next one.
fn periods(passed_us: u64, period_us: u32) -> u64 {
    let period = u64::from(period_us.max(1));
    ((passed_us + period / 2) / period).max(1)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn run(config: TrackerConfig, table: &[(Sequence, u64, Arrival)]) -> Tally {
        let mut tracker = SampleTracker::new(config);
        for (row, &(sequence, t_us, expected)) in table.iter().enumerate() {
            assert_eq!(tracker.arrive(sequence, t_us), expected, "row {row}");
        }
        tracker.tally()
    }

    #[test]
    fn counter_table() {
        use Arrival::{First, Lost, Next, Repeated, Restarted};
        let c = Sequence::Counter;
        let tally = run(
            TrackerConfig::default(),
            &[
                (c(65533), 0, First),
                (c(65534), 0, Next),
                (c(65534), 0, Repeated),
                (c(65534), 0, Repeated),
                (c(65535), 0, Next),
                (c(0), 0, Next),
                (c(1), 0, Next),
                (c(3), 0, Lost(1)),
                (c(65535), 0, Restarted),
                (c(2), 0, Lost(2)),
                (c(1003), 0, Lost(1000)),
                (c(2005), 0, Restarted),
                (c(2006), 0, Next),
            ],
        );
        assert_eq!(
            tally,
            Tally {
                received: 11,
                lost: 1003,
                repeated: 2,
                restarts: 2
            }
        );
    }

    #[test]
    fn counter_of_base_samples() {
        use Arrival::{First, Lost, Next, Restarted};
        let c = Sequence::Counter;
        let config = TrackerConfig {
            step: NonZeroU16::new(21).unwrap(),
            ..TrackerConfig::default()
        };
        run(
            config,
            &[
                (c(65520), 0, First),
                (c(5), 0, Next),
                (c(68), 0, Lost(2)),
                (c(69), 0, Restarted),
                (c(90), 0, Next),
            ],
        );
    }

    /// A counter that gains `gains` a sample, of which the 11th and 12th are lost; among those by which it is learnt one more
    /// may be, and the clocks may differ by `clock`.
    fn learnt(gains: u16, clock: f64, lost_early: bool) -> (Option<NonZeroU16>, Tally) {
        let mut tracker = SampleTracker::new(TrackerConfig::default());
        tracker.learn(NonZeroU16::new(21).unwrap(), 4941);
        for k in 0..40_u16 {
            if [11, 12].contains(&k) || lost_early && k == 3 {
                continue;
            }
            let t_us = (4941.2 * clock * f64::from(k)) as u64;
            let count = 65_000_u16.wrapping_add(gains.wrapping_mul(k));
            tracker.arrive(Sequence::Counter(count), t_us);
        }
        (tracker.step(), tracker.tally())
    }

    #[test]
    fn what_a_counter_counts_is_learnt() {
        for gains in [1, 21] {
            for clock in [0.9, 1.0, 1.1] {
                for lost_early in [false, true] {
                    let (step, tally) = learnt(gains, clock, lost_early);
                    assert_eq!(step, NonZeroU16::new(gains), "{clock} {lost_early}");
                    let lost = 2 + u32::from(lost_early);
                    assert_eq!((tally.lost, tally.received), (lost, 40 - lost), "{gains} {clock}");
                    assert_eq!((tally.restarts, tally.repeated), (0, 0));
                }
            }
        }
        // Neither of the two: by the times of the edges.
        let (step, tally) = learnt(7, 1.0, false);
        assert_eq!((step, tally.lost, tally.restarts), (None, 2, 0));
    }

    #[test]
    fn a_restart_is_seen_once_it_is_learnt() {
        let mut tracker = SampleTracker::new(TrackerConfig::default());
        let base = NonZeroU16::new(21).unwrap();
        tracker.learn(base, 4941);
        let mut at = |count, k: u64| tracker.arrive(Sequence::Counter(count), 4941 * k);
        for k in 0..6 {
            at(21 * k as u16, k);
        }
        assert_eq!(at(105, 6), Arrival::Repeated);
        assert_eq!(at(147, 7), Arrival::Lost(1));
        assert_eq!(at(1, 8), Arrival::Restarted);
        // A part with nothing to learn counts by ones at once.
        tracker.learn(NonZeroU16::MIN, 4941);
        assert_eq!(tracker.step(), Some(NonZeroU16::MIN));
    }

    #[test]
    fn time_table() {
        use Arrival::{First, Lost, Next, Repeated, Restarted};
        let f = Sequence::Fresh;
        let config = TrackerConfig {
            period_us: 5000,
            ..TrackerConfig::default()
        };
        let tally = run(
            config,
            &[
                (f(true), 10_000, First),
                (f(true), 15_400, Next),
                (f(false), 20_000, Repeated),
                (f(true), 20_100, Next),
                (f(true), 35_000, Lost(2)),
                (f(true), 35_010, Next),
                (f(true), 8_000_000, Restarted),
                (f(true), 7_000_000, Next),
            ],
        );
        assert_eq!(
            (tally.received, tally.lost, tally.repeated, tally.restarts),
            (7, 2, 1, 1)
        );
    }

    #[test]
    fn drops_are_counted_exactly() {
        let mut tracker = SampleTracker::new(TrackerConfig::default());
        let mut dropped = 0;
        for k in 0..200_000_u32 {
            // A fixed scramble drops about one in a hundred; what is lost before the first sample or
            // after the last one cannot be seen.
            if k.wrapping_mul(2_654_435_761) >> 16 < 655 && k != 0 && k != 199_999 {
                dropped += 1;
                continue;
            }
            tracker.arrive(Sequence::Counter(k as u16), 0);
        }
        assert!(dropped > 1500);
        let tally = tracker.tally();
        assert_eq!((tally.lost, tally.received), (dropped, 200_000 - dropped));
        assert_eq!((tally.repeated, tally.restarts), (0, 0));
    }
}
