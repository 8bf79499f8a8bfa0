//! Sampling: from the data-ready edge to increments with time, gap and rotor angle.
//!
//! ```text
//! edge (stamped) ─► burst ─► count: lost, repeated ─► SI, once ─► increments ─► α at the end ─► alignment
//! ```
//!
//! The length of a sample is the IMU's own period as the unit's clock sees it: the sample is a mean rate, and the
//! IMU's oscillator may be some percent off, which would be a scale factor on everything. It is measured over
//! windows of 64 samples and judged there.

use core::num::NonZeroU16;

use drivers::sequence::{Arrival, SampleTracker, TrackerConfig};
use drivers::{Channels, Error, Imu, RawSample, SystemFlags};
use embassy_futures::poll_once;
use embassy_futures::select::{Either, select};
use embassy_sync::blocking_mutex::raw::RawMutex;
use embassy_time::{Duration, with_timeout};
use nav::increment::Sample;

use crate::fault::{Fault, Task};
use crate::hal::{Edge, EdgeCapture};
use crate::log::Event;
use crate::mode::Input;
use crate::sample::{ImuFacts, TimedSample};
use crate::shared::Shared;

/// Samples of one measurement of the period.
const WINDOW: u32 = 64;
/// A sample that comes later than this share of a period is not jitter: time is missing before it. A tenth of a
/// millisecond of a swing of 8 °/s is 0.2° of heading.
const SLIP: f32 = 0.02;
/// More than so many in a row is a clock that is off.
const SLIPS: u8 = 4;
/// Longest start of an IMU: reset 350 ms, self-test 62 ms, settings.
const START_TIMEOUT: Duration = Duration::from_secs(3);

/// When a sample is suspect.
///
/// | field | unit | zero means | sane value |
/// |---|---|---|---|
/// | `edge_delay_us` | µs | samples are as late as [`Imu::delay_us`] says | 0, until it has been measured |
/// | `silent_periods` | periods | every edge is late | 5 |
/// | `transfers` | | the first one is a fault | 3 |
/// | `saturated` | samples | the first one is a fault | 5 |
/// | `stuck` | samples | the first one is a fault | 10 |
/// | `hot` | samples | the first one is a fault | 10 |
/// | `limit_c` | °C | nothing above freezing | 85; the ADIS16495 ends at 105 |
/// | `clock_tolerance` | share | every clock is a fault | 0.02; the ICM-42688-P's 0.04 |
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SamplingConfig {
    /// How much later than the part says a sample's edge comes after the end of its interval, µs; negative: less late.
    /// `hal-sim calibrate` measures it.
    pub edge_delay_us: i32,
    /// Periods without an edge that make a silent IMU.
    pub silent_periods: u16,
    /// Failed transfers in a row that make a fault.
    pub transfers: u16,
    /// Saturated samples in a row that make a fault.
    pub saturated: u16,
    /// Equal samples in a row that make a fault.
    pub stuck: u16,
    /// Hot samples in a row that make a fault.
    pub hot: u16,
    /// Temperature from which on a sample is hot, °C.
    pub limit_c: f32,
    /// Deviation of the period of the samples that makes a fault; what the unit's own clock may be off comes on top.
    pub clock_tolerance: f32,
    /// How samples follow each other.
    pub tracker: TrackerConfig,
}

impl Default for SamplingConfig {
    fn default() -> Self {
        Self {
            edge_delay_us: 0,
            silent_periods: 5,
            transfers: 3,
            saturated: 5,
            stuck: 10,
            hot: 10,
            limit_c: 85.0,
            clock_tolerance: 0.02,
            tracker: TrackerConfig::default(),
        }
    }
}

/// The period of the samples by the unit's clock.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Period {
    nominal_us: f32,
    /// The best so far.
    mean_us: f32,
    start: Option<u64>,
    count: u32,
}

impl Period {
    /// Not measured yet.
    pub fn new(nominal_us: f32) -> Self {
        Self {
            nominal_us,
            mean_us: nominal_us,
            start: None,
            count: 0,
        }
    }

    /// The period, µs.
    pub fn us(&self) -> f32 {
        self.mean_us
    }

    /// Begins a new window: the next edge does not follow the last one.
    pub fn restart(&mut self) {
        self.start = None;
    }

    /// Takes an edge, `samples` after the one before. What a finished window measured, µs.
    ///
    /// An edge's jitter of 1 µs makes 1.4/64 µs of a window, 5 ppm; the mean over windows 1 ppm.
    pub fn push(&mut self, t_us: u64, samples: u32) -> Option<f32> {
        let Some(start) = self.start else {
            (self.start, self.count) = (Some(t_us), 0);
            return None;
        };
        self.count += samples;
        if self.count < WINDOW {
            return None;
        }
        let measured = t_us.saturating_sub(start) as f32 / self.count as f32;
        (self.start, self.count) = (Some(t_us), 0);
        // The first window counts in full: the nominal period may be percents off.
        let share = if self.mean_us == self.nominal_us { 1.0 } else { 0.1 };
        self.mean_us += share * (measured - self.mean_us);
        Some(measured)
    }
}

/// Where the period of the samples is off by more than this share.
fn clock_fault(expected_us: f32, measured_us: f32, tolerance: f32) -> Option<Fault> {
    let off = (measured_us / expected_us - 1.0).abs();
    (off > tolerance).then_some(Fault::Clock {
        expected_us,
        measured_us,
    })
}

/// What is suspect in a row of samples. Pure.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Monitor {
    config: SamplingConfig,
    failed: u16,
    saturated: u16,
    repeated: u16,
    equal: u16,
    hot: u16,
    last: Option<RawSample>,
}

impl Monitor {
    /// Nothing seen yet.
    pub fn new(config: SamplingConfig) -> Self {
        Self {
            config,
            failed: 0,
            saturated: 0,
            repeated: 0,
            equal: 0,
            hot: 0,
            last: None,
        }
    }

    /// Whether the last sample had the data of the one before: noise never repeats 6 × 32 bits.
    pub fn is_stale(&self) -> bool {
        self.equal > 0
    }

    /// Takes a failed transfer.
    pub fn failed(&mut self, error: Error) -> Option<Fault> {
        self.failed = self.failed.saturating_add(1);
        if let Error::Restarted { .. } = error {
            return Some(Fault::ImuRestarted);
        }
        (self.failed >= self.config.transfers).then_some(Fault::ImuTransfer {
            error,
            in_row: self.failed,
        })
    }

    /// Takes a sample.
    pub fn sample(&mut self, raw: &RawSample, arrival: Arrival, temperature_c: f32) -> Option<Fault> {
        let c = &self.config;
        let count = |counter: &mut u16, suspect: bool| {
            *counter = if suspect { counter.saturating_add(1) } else { 0 };
            *counter
        };
        self.failed = 0;
        let same = |last: &RawSample| (last.rate, last.force) == (raw.rate, raw.force);
        let equal = arrival != Arrival::Repeated && self.last.as_ref().is_some_and(same);
        if arrival != Arrival::Repeated {
            self.last = Some(*raw);
        }
        let saturated = raw.status.saturated;
        let repeated = count(&mut self.repeated, arrival == Arrival::Repeated);
        let equal = count(&mut self.equal, equal);
        let clipped = count(&mut self.saturated, saturated != Channels::NONE);
        let hot = count(&mut self.hot, temperature_c >= c.limit_c);
        // Of the flags, those that say that the data are not what they seem.
        let flags = raw.status.system;
        let grave = [
            SystemFlags::MEMORY,
            SystemFlags::SENSOR,
            SystemFlags::OVERRUN,
            SystemFlags::CLOCK,
            SystemFlags::WATCHDOG,
        ];
        if arrival == Arrival::Restarted {
            Some(Fault::ImuRestarted)
        } else if grave.into_iter().any(|flag| flags.contains(flag)) {
            Some(Fault::ImuFlags { flags })
        } else if repeated >= c.transfers {
            Some(Fault::ImuStuck { in_row: repeated })
        } else if clipped >= c.saturated {
            // Before "stuck": a clipped channel does not move either.
            Some(Fault::ImuSaturated {
                channels: saturated,
                in_row: clipped,
            })
        } else if equal >= c.stuck {
            Some(Fault::ImuStuck { in_row: equal })
        } else if hot >= c.hot {
            Some(Fault::OverTemperature { temperature_c })
        } else {
            None
        }
    }
}

/// The task. Waits for the request to start the IMU, then samples until the next request.
///
/// Every fault is raised once; then the task goes on sampling, for the log and the check-in, until the next start.
pub async fn run<M: RawMutex, I: Imu, E: EdgeCapture>(
    shared: &Shared<M>,
    mut imu: I,
    imu_config: I::Config,
    mut edges: E,
    config: SamplingConfig,
) -> ! {
    let mut sampler = Sampler::new(shared, config);
    shared.with_check_in(Task::Sampling, shared.imu_start.wait()).await;
    loop {
        let started = shared
            .with_check_in(
                Task::Sampling,
                with_timeout(START_TIMEOUT, start(&mut imu, &imu_config)),
            )
            .await;
        // A start that takes too long is an IMU that does not answer.
        let started = started.unwrap_or(Err(Error::Silent { level: 0 }));
        shared.tell(Input::Imu(started));
        let Ok(identity) = started else {
            shared.with_check_in(Task::Sampling, shared.imu_start.wait()).await;
            continue;
        };
        shared.imu_is(ImuFacts {
            identity,
            scale: imu.scale(),
            period: imu.period(),
        });
        sampler.restart(imu.period(), imu.base_samples());
        // An edge from before the settings, if there is one, is none of a sample's that counts.
        let _ = poll_once(edges.edge());
        let silent_us = sampler.nominal_us as u64 * u64::from(config.silent_periods);
        let silent = Duration::from_micros(silent_us);
        loop {
            shared.check_in(Task::Sampling);
            match select(shared.imu_start.wait(), with_timeout(silent, edges.edge())).await {
                Either::First(()) => break,
                Either::Second(Err(_)) => sampler.raise(Fault::ImuSilent {
                    waited_us: silent_us as u32,
                }),
                Either::Second(Ok(edge)) => sampler.take(edge, imu.sample().await, &imu),
            }
        }
    }
}

async fn start<I: Imu>(imu: &mut I, config: &I::Config) -> Result<drivers::Identity, Error> {
    imu.reset().await?;
    let identity = imu.identify().await?;
    imu.self_test().await?;
    imu.configure(config).await?;
    Ok(identity)
}

/// The task's state between edges.
struct Sampler<'a, M: RawMutex> {
    shared: &'a Shared<M>,
    config: SamplingConfig,
    tracker: SampleTracker,
    monitor: Monitor,
    period: Period,
    nominal_us: f32,
    /// End of the last sample that was good.
    last_us: Option<u64>,
    /// Samples in a row that came late.
    late_in_row: u8,
    /// Time that is missing before the next sample, of samples that were good and did not fit.
    owed: f32,
    raised: bool,
}

impl<'a, M: RawMutex> Sampler<'a, M> {
    fn new(shared: &'a Shared<M>, config: SamplingConfig) -> Self {
        Self {
            shared,
            config,
            tracker: SampleTracker::new(config.tracker),
            monitor: Monitor::new(config),
            period: Period::new(0.0),
            nominal_us: 0.0,
            last_us: None,
            late_in_row: 0,
            owed: 0.0,
            raised: false,
        }
    }

    fn restart(&mut self, period: f32, base: NonZeroU16) {
        self.nominal_us = period * 1e6;
        self.tracker.learn(base, self.nominal_us as u32);
        self.monitor = Monitor::new(self.config);
        self.period = Period::new(self.nominal_us);
        self.raised = false;
    }

    fn raise(&mut self, fault: Fault) {
        self.period.restart();
        if !core::mem::replace(&mut self.raised, true) {
            self.shared.raise(fault);
        }
    }

    /// Time that passed before a sample beyond what its part counts, µs: a part that loses its pace for once does not
    /// count it, nor does one that starts anew. Where each sample is late it is the clock that is off.
    fn late(&mut self, arrival: Arrival, lost: f32, t_us: u64) -> f32 {
        let period_us = self.period.us();
        let passed_us = self.last_us.map_or(0.0, |last| t_us.saturating_sub(last) as f32);
        let late_us = passed_us - (lost + 1.0) * period_us;
        let late = late_us > SLIP * period_us;
        self.late_in_row = if late { self.late_in_row.saturating_add(1) } else { 0 };
        let counted = matches!(arrival, Arrival::Next | Arrival::Lost(_));
        if !late || counted && self.late_in_row > SLIPS {
            return 0.0;
        }
        self.period.restart();
        if counted {
            self.shared.log(&Event::Slipped { late: late_us * 1e-6 });
        }
        late_us
    }

    fn take<I: Imu>(&mut self, edge: Edge, read: Result<RawSample, Error>, imu: &I) {
        let shared = self.shared;
        if edge.overrun > 0 {
            shared.count(|counts| counts.edges = counts.edges.saturating_add(edge.overrun));
        }
        let raw = match read {
            Ok(raw) => raw,
            Err(error) => {
                shared.count(|counts| counts.transfers = counts.transfers.saturating_add(1));
                if !self.raised {
                    shared.log(&Event::Transfer(error));
                }
                if let Some(fault) = self.monitor.failed(error) {
                    self.raise(fault);
                }
                return;
            }
        };
        let delay_us = i64::from(imu.delay_us()) + i64::from(self.config.edge_delay_us);
        let t_us = edge.t_us.saturating_add_signed(-delay_us);
        let arrival = self.tracker.arrive(raw.sequence, edge.t_us);
        let tally = self.tracker.tally();
        shared.count(|counts| {
            counts.tally = tally;
            if raw.status.saturated != Channels::NONE {
                counts.saturated = counts.saturated.saturating_add(1);
            }
        });
        let si = imu.scale().si(&raw);
        if let Some(fault) = self.monitor.sample(&raw, arrival, si.temperature_c) {
            self.raise(fault);
        }
        let lost = match arrival {
            Arrival::Repeated => {
                if !self.raised {
                    shared.log(&Event::Repeated { tally });
                }
                return;
            }
            Arrival::Lost(samples) => {
                shared.log(&Event::Lost { samples, tally });
                samples
            }
            Arrival::First | Arrival::Next | Arrival::Restarted => 0,
        };
        let late_us = self.late(arrival, f32::from(lost), t_us);
        if let Some(measured_us) = self.period.push(edge.t_us, u32::from(lost) + 1) {
            let period = self.period.us() * 1e-6;
            shared.measure(|measured| measured.period = Some(period));
            let tolerance = self.config.clock_tolerance + shared.clock().tolerance();
            if let Some(fault) = clock_fault(self.nominal_us, measured_us, tolerance) {
                self.raise(fault);
            }
        }
        let dt = self.period.us() * 1e-6;
        let gap = f32::from(lost) * dt + late_us * 1e-6;
        self.last_us = Some(t_us);
        let (dtheta_s, dv_s) = si.increments(dt);
        let timed = TimedSample {
            t_us,
            sample: Sample {
                dtheta_s,
                dv_s,
                dt,
                gap: gap + self.owed,
            },
            alpha: shared.angle_at(t_us),
            temperature_c: si.temperature_c,
            saturated: raw.status.saturated,
        };
        // What repeats the one before tells nothing of its time.
        let stale = self.monitor.is_stale();
        let went = !stale && shared.forward(timed);
        if went {
            self.owed = 0.0;
        } else {
            self.owed += gap + dt;
            if !stale {
                shared.log(&Event::Overrun {
                    samples: shared.sample_counts().overruns,
                });
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use drivers::{ForceCounts, RateCounts, Sequence, Status, TemperatureCounts};

    use super::*;
    use crate::hal::ClockSource;

    fn raw(k: i32) -> RawSample {
        RawSample {
            rate: RateCounts([k, 2, 3]),
            force: ForceCounts([4, 5, 6]),
            temperature: TemperatureCounts(0),
            sequence: Sequence::Counter(k as u16),
            status: Status::default(),
        }
    }

    /// After how many samples of a kind the monitor finds what.
    fn found(make: impl Fn(i32) -> (RawSample, Arrival, f32)) -> Option<(i32, Fault)> {
        let mut monitor = Monitor::new(SamplingConfig::default());
        (0..30).find_map(|k| {
            let (raw, arrival, temperature_c) = make(k);
            monitor.sample(&raw, arrival, temperature_c).map(|fault| (k + 1, fault))
        })
    }

    #[test]
    fn what_is_suspect_and_when() {
        assert_eq!(found(|k| (raw(k), Arrival::Next, 25.0)), None);
        assert_eq!(
            found(|_| (raw(7), Arrival::Next, 25.0)),
            Some((11, Fault::ImuStuck { in_row: 10 }))
        );
        assert_eq!(
            found(|_| (raw(7), Arrival::Repeated, 25.0)),
            Some((3, Fault::ImuStuck { in_row: 3 }))
        );
        let channels = Channels::RATE_Z;
        let clipped = |k| {
            let mut raw = raw(k);
            raw.status.saturated = channels;
            (raw, Arrival::Next, 25.0)
        };
        assert_eq!(found(clipped), Some((5, Fault::ImuSaturated { channels, in_row: 5 })));
        let hot = Fault::OverTemperature { temperature_c: 90.0 };
        assert_eq!(found(|k| (raw(k), Arrival::Next, 90.0)), Some((10, hot)));
        assert_eq!(
            found(|k| (raw(k), Arrival::Restarted, 25.0)),
            Some((1, Fault::ImuRestarted))
        );
        let mut monitor = Monitor::new(SamplingConfig::default());
        let error = Error::Header { found: 1 };
        assert_eq!((monitor.failed(error), monitor.failed(error)), (None, None));
        assert_eq!(monitor.failed(error), Some(Fault::ImuTransfer { error, in_row: 3 }));
        // A good one in between begins the row anew.
        assert_eq!(monitor.sample(&raw(1), Arrival::Next, 25.0), None);
        assert_eq!(monitor.failed(error), None);
    }

    /// 2 % of the IMU's oscillator, and what the chip's own may be off: 8 % slow or 4.5 % fast by DS9405.
    #[test]
    fn the_chips_own_clock_is_no_fault_and_a_wrong_rate_is() {
        for (clock, off, is_fault) in [
            (ClockSource::Crystal, 0.019, false),
            (ClockSource::Crystal, -0.021, true),
            (ClockSource::Internal, 0.06, false),
            (ClockSource::Internal, -0.099, false),
            // The next step of DEC_RATE but one.
            (ClockSource::Internal, 2.0 / 19.0, true),
            (ClockSource::Internal, -0.5, true),
        ] {
            let tolerance = SamplingConfig::default().clock_tolerance + clock.tolerance();
            let fault = clock_fault(4941.0, 4941.0 * (1.0 + off), tolerance);
            assert_eq!(fault.is_some(), is_fault, "{clock:?} {off}");
        }
    }

    #[test]
    fn the_period_follows_the_imu_and_skips_what_is_lost() {
        let mut period = Period::new(5000.0);
        let mut windows = 0;
        for k in (0..2000_u64).filter(|k| !k.is_multiple_of(10)) {
            let samples = if k % 10 == 1 { 2 } else { 1 };
            windows += u32::from(period.push(5050 * k, samples).is_some());
        }
        assert!(windows >= 30, "{windows}");
        assert!((period.us() - 5050.0).abs() < 0.01, "{}", period.us());
    }
}
