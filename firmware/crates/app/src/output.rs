//! The serial line's output task: estimates and status in, sentences of [`nmea`] out.
//!
//! A cycle is THS, HDT, ROT and PASHR in one write, GLL and VTG while the unit navigates, with the status sentence once a
//! second and at every change of mode. It begins with an estimate: of 20 a second every other one starts a cycle, so that a heading is no older than
//! its way through the task, and where the base swings by 10 °/s the 50 ms to the next estimate would be half a degree.
//! Without estimates it begins by the clock.
//!
//! How a calibration of the gyros ended is reported by TXT, before the cycle whose status shows that it has ended: once, and
//! again only where the line did not take it.
//!
//! # When a heading is valid
//!
//! | THS | the unit | its estimate | HDT | PASHR |
//! |---|---|---|---|---|
//! | A | is aligned, or navigates | ready | sent | in full, flag 1 |
//! | E | aligned, navigates, or aligns finely | fits the model; σ above the limit of the aligner, below [`OutputConfig::estimated_sd`] | absent | in full, flag 0 |
//! | V | anything else, also where its [clock](crate::hal::ClockSource) is not exact | absent, ambiguous, inconsistent, or older than [`OutputConfig::fresh_ms`] | absent | empty, flag 0 |
//!
//! HDT has no word for doubt, therefore it comes with A only. M and S are never sent.
//!
//! # Rate of turn
//!
//! ```text
//! r_k = wrap(ψ_k − ψ_k−1)/(t_k − t_k−1)      m_k = median(r_k, r_k−1, r_k−2)
//! y_k = y_k−1 + dt/(τ + dt) (m_k − y_k−1)    τ = 0.5 s
//! ```
//!
//! Of the heading of the housing: its swing is in it. The median takes out the filter's corrections, which come once
//! a second and make one difference of twenty wrong: 0.1° at once would read as 120 °/min. What is left of a gyro's
//! white noise of 0.02 °/√h is 0.02 °/min. It lags by 0.55 s.
//!
//! # Budget
//!
//! Seven sentences of 82 bytes and two for a line's end are 576 bytes, 50 % of the 1152 that 115200 baud carry in
//! 100 ms. In fact it is 120, and 165 once a second; 80 more while the unit navigates, and 80 with a TXT, once.
//!
//! With the record it is 8.5 kB a second more, 74 % of the line: see [`record`].
//!
//! A writer that fails or stalls costs its cycle, and is counted; the task goes on. Nothing waits for it.

use core::sync::atomic::{AtomicBool, AtomicU32, Ordering};

use embassy_futures::select::{Either4, select4};
use embassy_sync::blocking_mutex::raw::RawMutex;
use embassy_sync::channel::Channel;
use embassy_time::{Duration, Instant, Timer, with_timeout};
use embedded_io_async::Write;
use frames::math;
use heapless::Vec;
use nav::aligner::{Estimate, NotReady};
use nav::navigator::Track;

use crate::command::ModeName;
use crate::log::CalibrationEnd;
use crate::mode::Status;
use crate::nmea::{self, HeadingMode, LONGEST, Report, Sentence, SentenceBuilder, Talker, TextKind};
use crate::record;
use crate::settings::OutputConfig;
use crate::shared::{Navigation, Shared};
use crate::utc::Utc;

/// Answers that wait for the line.
pub const ANSWERS: usize = 4;
/// Sentences of a cycle.
const SENTENCES: usize = 7;
/// Ends a line that broke off.
const LINE_END: &[u8] = b"\r\n";
/// Bytes of a cycle at the most.
pub const CYCLE: usize = SENTENCES * LONGEST + LINE_END.len();
/// A difference over more than this is no rate, µs: five estimates at 20 a second.
const RATE_GAP_US: u64 = 250_000;

/// What became of the writes since the start.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct OutputCounts {
    /// Written in full.
    pub written: u32,
    /// The writer reported an error, or took nothing.
    pub failed: u32,
    /// The writer did not come to an end in time.
    pub stalled: u32,
}

/// What the tasks of one serial line share.
pub struct Port<M: RawMutex> {
    answers: Channel<M, Sentence, ANSWERS>,
    /// The status sentence is wanted with the next cycle.
    status: AtomicBool,
    written: AtomicU32,
    failed: AtomicU32,
    stalled: AtomicU32,
}

impl<M: RawMutex> Default for Port<M> {
    fn default() -> Self {
        Self::new()
    }
}

impl<M: RawMutex> Port<M> {
    /// Nothing written yet.
    pub const fn new() -> Self {
        Self {
            answers: Channel::new(),
            status: AtomicBool::new(false),
            written: AtomicU32::new(0),
            failed: AtomicU32::new(0),
            stalled: AtomicU32::new(0),
        }
    }

    /// What became of the writes so far.
    pub fn counts(&self) -> OutputCounts {
        OutputCounts {
            written: self.written.load(Ordering::Relaxed),
            failed: self.failed.load(Ordering::Relaxed),
            stalled: self.stalled.load(Ordering::Relaxed),
        }
    }

    /// Puts the status sentence into the next cycle.
    pub fn status(&self) {
        self.status.store(true, Ordering::Relaxed);
    }

    /// Puts an answer between the cycles. Waits while [`ANSWERS`] are ahead of it.
    ///
    /// Cancellation: safe, the answer is then dropped.
    pub async fn answer(&self, answer: Sentence) {
        self.answers.send(answer).await;
    }
}

/// What the unit stands by at one instant.
fn judge<'a>(
    now_us: u64,
    status: Option<&Status>,
    navigation: Option<&'a Navigation>,
    config: &OutputConfig,
) -> (HeadingMode, Option<&'a Estimate>) {
    let invalid = (HeadingMode::Invalid, None);
    let (Some(status), Some(navigation)) = (status, navigation) else {
        return invalid;
    };
    let Some(estimate) = &navigation.estimate else {
        return invalid;
    };
    if now_us.saturating_sub(navigation.t_us) > u64::from(config.fresh_ms) * 1000 {
        return invalid;
    }
    match (status.mode, &navigation.not_ready) {
        (ModeName::Aligned | ModeName::Navigating, None) => (HeadingMode::Autonomous, Some(estimate)),
        // Either of the two may be told of a change before the other.
        (ModeName::Aligned | ModeName::Navigating | ModeName::Fine, None | Some(NotReady::HeadingSd { .. }))
            if estimate.sd.heading <= config.estimated_sd =>
        {
            (HeadingMode::Estimated, Some(estimate))
        }
        _ => invalid,
    }
}

/// Why there is no heading, or only an estimated one.
const fn reason(not_ready: &NotReady) -> &'static str {
    match not_ready {
        NotReady::Collecting { .. } => "collecting",
        NotReady::CatchingUp { .. } => "catching-up",
        NotReady::HeadingSd { .. } => "heading-sd",
        NotReady::Ambiguous { .. } => "ambiguous",
        NotReady::Inconsistent { .. } => "inconsistent",
    }
}

/// Rate of turn from headings. See the [module](self).
#[derive(Debug)]
struct TurnRate {
    tau: f32,
    /// Time, µs, and heading, rad.
    last: Option<(u64, f32)>,
    /// The latest three, rad/s, oldest first, as far as there are any.
    rates: Vec<f32, 3>,
    smooth: Option<f32>,
}

impl TurnRate {
    const fn new(tau: f32) -> Self {
        Self {
            tau,
            last: None,
            rates: Vec::new(),
            smooth: None,
        }
    }

    /// Takes a heading, rad, at `t_us`.
    fn push(&mut self, t_us: u64, heading: f32) {
        let Some((before_us, before)) = self.last.replace((t_us, heading)) else {
            return;
        };
        let gap_us = t_us.saturating_sub(before_us);
        if gap_us == 0 || gap_us > RATE_GAP_US {
            self.rates.clear();
            self.smooth = None;
            return;
        }
        let dt = gap_us as f32 * 1e-6;
        if self.rates.is_full() {
            self.rates.remove(0);
        }
        let _ = self.rates.push(math::wrap_pi(heading - before) / dt);
        let [a, b, c] = self.rates[..] else { return };
        let median = a.min(b).max(a.max(b).min(c));
        self.smooth = Some(match self.smooth {
            Some(smooth) => smooth + dt / (self.tau + dt) * (median - smooth),
            None => median,
        });
    }

    /// rad/s, clockwise positive; `None` before the fourth heading.
    fn get(&self) -> Option<f32> {
        self.smooth
    }
}

/// The line, and whether it stands in the middle of a sentence.
struct Output<'a, M: RawMutex, W> {
    port: &'a Port<M>,
    tx: W,
    limit: Duration,
    broken: bool,
    /// The status that the record has.
    recorded: Option<Status>,
}

impl<M: RawMutex, W: Write> Output<'_, M, W> {
    /// Whether all of it went.
    async fn write(&mut self, bytes: &[u8]) -> bool {
        if self.broken && !self.put(LINE_END).await {
            return false;
        }
        self.broken = !self.put(bytes).await;
        if !self.broken {
            self.port.written.fetch_add(1, Ordering::Relaxed);
        }
        !self.broken
    }

    /// Puts the status into the record, where it is another one.
    async fn record(&mut self, status: Option<Status>) {
        if let Some(now) = status
            && self.recorded != status
        {
            self.recorded = status;
            let frame = record::status(Instant::now().as_micros(), &now);
            self.write(frame.as_bytes()).await;
        }
    }

    /// Whether all of it was written; counts what went wrong.
    async fn put(&mut self, bytes: &[u8]) -> bool {
        let wrong = match with_timeout(self.limit, write_all(&mut self.tx, bytes)).await {
            Ok(true) => return true,
            Ok(false) => &self.port.failed,
            Err(_) => &self.port.stalled,
        };
        wrong.fetch_add(1, Ordering::Relaxed);
        false
    }
}

/// As the trait's own, which panics where nothing is taken.
async fn write_all(tx: &mut impl Write, bytes: &[u8]) -> bool {
    let mut rest = bytes;
    while !rest.is_empty() {
        match tx.write(rest).await {
            Ok(0) | Err(_) => return false,
            Ok(count) => rest = rest.get(count..).unwrap_or_default(),
        }
    }
    true
}

/// The task.
pub async fn run<M: RawMutex, W: Write>(shared: &Shared<M>, port: &Port<M>, tx: W, config: OutputConfig) -> ! {
    let Some(mut estimates) = shared.navigation.receiver() else {
        // More readers than `READERS`: a line that is silent is seen at once.
        core::future::pending().await
    };
    let period = Duration::from_millis(u64::from(config.period_ms));
    let mut output = Output {
        port,
        tx,
        limit: Duration::from_millis(u64::from(config.write_ms)),
        broken: false,
        recorded: None,
    };
    let mut turn = TurnRate::new(config.rate_tau);
    let mut navigation: Option<Navigation> = None;
    let mut shown: Option<ModeName> = None;
    let mut calibration: Option<CalibrationEnd> = None;
    let mut cycles: u32 = 0;
    let mut last = Instant::now();
    loop {
        // While estimates come the next one is waited for a little beyond the period.
        let flows = navigation.is_some_and(|at| last.as_micros().saturating_sub(at.t_us) < period.as_micros());
        let due = last + if flows { period + period / 5 } else { period };
        // Frames of the record last: they are most of what is sent.
        let frame = shared.next_frame();
        match select4(estimates.changed(), port.answers.receive(), Timer::at(due), frame).await {
            Either4::First(now) => {
                if let Some(estimate) = &now.estimate {
                    turn.push(now.t_us, estimate.attitude.heading);
                }
                navigation = Some(now);
                if Instant::now() < last + period - period / 10 {
                    continue;
                }
                last = Instant::now();
            }
            Either4::Second(answer) => {
                output.write(answer.as_bytes()).await;
                continue;
            }
            Either4::Fourth(frame) => {
                output.write(frame.as_bytes()).await;
                // The first of them is a header: before it nothing counts.
                output.record(shared.status.try_get()).await;
                continue;
            }
            // Keeps the period, but never catches up.
            Either4::Third(()) => {
                last = if Instant::now() > due + period {
                    Instant::now()
                } else {
                    due
                }
            }
        }
        calibration = shared.calibration.try_take().or(calibration);
        if let Some(end) = &calibration
            && output.write(calibrated(config.talker, end).as_bytes()).await
        {
            calibration = None;
        }
        let now_us = Instant::now().as_micros();
        let status = shared.status.try_get();
        let mode = status.map(|status| status.mode);
        let due = config.status_every > 0 && cycles.is_multiple_of(config.status_every);
        let with_status = port.status.swap(false, Ordering::Relaxed) || mode != shown || due;
        shown = mode;
        cycles = cycles.wrapping_add(1);

        // An estimate by samples of a wrong length is none, and neither is its σ.
        let told = navigation.as_ref().filter(|_| shared.clock().is_exact());
        let mut bytes = compose(now_us, shared.utc(), status.as_ref(), told, &turn, &config);
        if with_status {
            let sentence = report(shared, now_us, status.as_ref(), told, &config);
            let _ = bytes.extend_from_slice(sentence.as_bytes());
        }
        output.write(&bytes).await;
        if !shared.is_recording() {
            output.recorded = None;
        } else if output.recorded.is_some() {
            output.record(status).await;
        }
    }
}

/// THS, HDT, ROT, PASHR, GLL, VTG.
#[inline(never)]
fn compose(
    now_us: u64,
    utc: Option<Utc>,
    status: Option<&Status>,
    navigation: Option<&Navigation>,
    turn: &TurnRate,
    config: &OutputConfig,
) -> Vec<u8, CYCLE> {
    let (mode, estimate) = judge(now_us, status, navigation, config);
    let heading = estimate.map(|estimate| estimate.attitude.heading);
    let good = mode == HeadingMode::Autonomous;
    // Of the estimate where there is one, not of the cycle.
    let at_us = estimate.and(navigation).map_or(now_us, |navigation| navigation.t_us);
    let time = utc.and_then(|utc| utc.at(at_us));
    let mut bytes = Vec::new();
    let mut put = |sentence: &Sentence| {
        // There is room for all of them, see `CYCLE`.
        let _ = bytes.extend_from_slice(sentence.as_bytes());
    };
    let talker = config.talker;
    put(&nmea::ths(talker, heading, mode));
    if let Some(hdt) = heading.filter(|_| good).and_then(|heading| nmea::hdt(talker, heading)) {
        put(&hdt);
    }
    put(&nmea::rot(talker, estimate.and_then(|_| turn.get())));
    put(&nmea::pashr(
        time,
        estimate.map(|estimate| (&estimate.attitude, &estimate.sd)),
        good,
    ));
    let track = navigation
        .and_then(|at| at.track)
        .filter(|_| mode != HeadingMode::Invalid);
    if let Some(Track { v_n, position }) = track {
        let place = nmea::gll(talker, time, position.latitude, position.longitude);
        let motion = nmea::vtg(talker, v_n.x(), v_n.y());
        place.iter().chain(&motion).for_each(put);
    }
    bytes
}

/// How a calibration of the gyros ended.
#[inline(never)]
fn calibrated(talker: Talker, end: &CalibrationEnd) -> Sentence {
    match end {
        Ok(found) => {
            let mut line = SentenceBuilder::message(talker, TextKind::Notice);
            line.words("gyros calibrated: z scale ");
            line.decimal(found.scale_factor_ppm, 0);
            line.words(" sd ");
            line.decimal(found.column_sd_ppm, 0);
            line.words(" ppm - biases ");
            line.words(if found.biases_used { "used" } else { "not used" });
            line.end()
        }
        Err(failure) => {
            let mut line = SentenceBuilder::message(talker, TextKind::Warning);
            line.words("gyros not calibrated: ");
            line.words(failure.brief());
            line.end()
        }
    }
}

/// The status sentence. Its σ and its reason are the aligner's, whatever THS makes of them, while the unit aligns.
fn report<M: RawMutex>(
    shared: &Shared<M>,
    now_us: u64,
    status: Option<&Status>,
    navigation: Option<&Navigation>,
    config: &OutputConfig,
) -> Sentence {
    let aligns = status.is_some_and(|status| {
        matches!(
            status.mode,
            ModeName::Coarse | ModeName::Fine | ModeName::Aligned | ModeName::Navigating
        )
    });
    let navigation =
        navigation.filter(|at| aligns && now_us.saturating_sub(at.t_us) <= u64::from(config.fresh_ms) * 1000);
    let not_ready = navigation.and_then(|at| at.not_ready.as_ref());
    nmea::status(&Report {
        up_us: now_us,
        mode: status.map(|status| (status.mode, status.since_us)),
        heading_sd: navigation
            .and_then(|at| at.estimate.as_ref())
            .map(|estimate| estimate.sd.heading),
        reason: if shared.clock().is_exact() {
            not_ready.map_or("", reason)
        } else {
            "clock"
        },
        fault: status.and_then(|status| Some((status.fault?.name(), status.latched))),
        rotor: shared.angle_at(now_us),
    })
}

#[cfg(test)]
mod tests {
    use std::cell::RefCell;
    use std::rc::Rc;
    use std::string::{String, ToString};

    use embedded_io_async::{ErrorKind, ErrorType};
    use frames::units::DEG;
    use frames::{Attitude, AttitudeSd, Rot, Vec3};
    use nav::aligner;
    use vtime::{Executor, Level, LocalRawMutex, Stop};

    use super::*;
    use crate::fault::Fault;
    use crate::hal::ClockSource;
    use crate::log::{CalibrationFailure, GyrosCalibrated};
    use crate::settings::Settings;
    use crate::utc::TimeOfDay;

    const D: f32 = DEG as f32;

    fn navigation(t_us: u64, heading: f32, sd: f32, not_ready: Option<NotReady>) -> Navigation {
        Navigation {
            deviation: None,
            t_us,
            mode: aligner::Mode::Fine,
            estimate: Some(Estimate {
                c_nb: Rot::identity(),
                attitude: Attitude {
                    heading,
                    pitch: 0.01,
                    roll: -0.02,
                },
                sd: AttitudeSd {
                    heading: sd,
                    pitch: 1e-5,
                    roll: 1e-5,
                },
                gyro_bias_s: Vec3::zero(),
                gyro_bias_sd: Vec3::zero(),
                accel_bias_s: Vec3::zero(),
                accel_bias_sd: Vec3::zero(),
            }),
            not_ready,
            track: None,
        }
    }

    fn status(mode: ModeName) -> Status {
        Status {
            mode,
            since_us: 0,
            fault: (mode == ModeName::Fault).then_some(Fault::Driver),
            latched: false,
            attempts: 0,
        }
    }

    #[test]
    fn what_a_heading_is_called() {
        use HeadingMode::{Autonomous as A, Estimated as E, Invalid as V};
        use ModeName as M;
        let config = OutputConfig::default();
        let good = navigation(1_000_000, 1.0, 0.3 * D, None);
        let wide = |sd| navigation(1_000_000, 1.0, sd, Some(NotReady::HeadingSd { sd }));
        let doubted = |why| navigation(1_000_000, 1.0, 0.3 * D, Some(why));
        let none = Navigation {
            estimate: None,
            not_ready: Some(NotReady::CatchingUp { queued: 3 }),
            ..good
        };
        let ambiguous = doubted(NotReady::Ambiguous {
            heading_offset: 1.0,
            gyro_bias_z: 0.0,
        });
        let inconsistent = doubted(NotReady::Inconsistent { ratio: 3.0 });
        let now = 1_010_000;
        for (now_us, mode, navigation, expected) in [
            (now, Some(M::Aligned), Some(good), A),
            (1_150_000, Some(M::Aligned), Some(good), A),
            (1_150_001, Some(M::Aligned), Some(good), V),
            (now, Some(M::Fine), Some(good), E),
            (now, Some(M::Fine), Some(wide(2.0 * D)), E),
            (now, Some(M::Aligned), Some(wide(1.1 * D)), E),
            (now, Some(M::Fine), Some(wide(10.1 * D)), V),
            (now, Some(M::Fine), Some(wide(f32::NAN)), V),
            (now, Some(M::Aligned), Some(ambiguous), V),
            (now, Some(M::Fine), Some(ambiguous), V),
            (now, Some(M::Aligned), Some(inconsistent), V),
            (now, Some(M::Fine), Some(inconsistent), V),
            (now, Some(M::Fine), Some(none), V),
            (now, Some(M::Coarse), Some(good), V),
            (now, Some(M::Homing), Some(good), V),
            (now, Some(M::Idle), Some(good), V),
            (now, Some(M::Fault), Some(good), V),
            (now, Some(M::Aligned), None, V),
            (now, None, Some(good), V),
        ] {
            let status = mode.map(status);
            let (found, estimate) = judge(now_us, status.as_ref(), navigation.as_ref(), &config);
            assert_eq!(found, expected, "{mode:?} {navigation:?}");
            assert_eq!(estimate.is_some(), expected != V);
            let bytes = compose(
                now_us,
                None,
                status.as_ref(),
                navigation.as_ref(),
                &TurnRate::new(0.5),
                &config,
            );
            let text: std::vec::Vec<&str> = core::str::from_utf8(&bytes).unwrap().lines().collect();
            assert_eq!(text.len(), if expected == A { 4 } else { 3 });
            assert_eq!(text[0].contains("57.30"), expected != V, "{text:?}");
            assert_eq!(
                text.iter().any(|text| text.starts_with("$HEHDT,57.30,T*")),
                expected == A
            );
            let pashr = text.last().unwrap();
            assert_eq!(pashr.contains(",0,1*"), expected == A);
            assert_eq!(pashr.contains(",57.30,T,-1.15,+0.57,,"), expected != V);
        }
    }

    /// Headings of a base that swings by 5° in 8 s, 20 a second, with corrections once a second.
    #[test]
    fn the_rate_of_turn_follows_a_swing_and_not_the_corrections() {
        let mut turn = TurnRate::new(0.5);
        let omega = std::f32::consts::TAU / 8.0;
        let mut worst = 0.0_f32;
        for k in 0..800_u64 {
            let t_us = 49_400 * k;
            let t = t_us as f32 * 1e-6;
            let corrected = 0.1 * D * t.floor();
            // Through north, where the heading wraps.
            let heading = math::wrap_two_pi(5.0 * D * math::sin_cos(omega * t).0 + corrected);
            turn.push(t_us, heading);
            assert_eq!(turn.get().is_some(), k >= 3);
            if t > 5.0 {
                // The middle of the median's three is 1.5 intervals old; then a first-order lag of τ.
                let lag = math::atan2(omega * 0.5, 1.0);
                let cos = |angle| math::sin_cos(angle).1;
                let expected = 5.0 * D * omega * cos(lag) * cos(omega * (t - 1.5 * 0.0494) - lag);
                worst = worst.max((turn.get().unwrap() - expected).abs());
            }
        }
        // 5° of a swing is 235 °/min at the most; a correction let through would be 120·dt/(τ+dt) = 11.
        assert!(worst / D * 60.0 < 3.0, "{} deg/min", worst / D * 60.0);
    }

    #[test]
    fn a_gap_begins_the_rate_anew() {
        let mut turn = TurnRate::new(0.5);
        for k in 0..10_u64 {
            turn.push(50_000 * k, 0.01 * k as f32);
        }
        assert!((turn.get().unwrap() - 0.2).abs() < 1e-4);
        turn.push(450_000 + RATE_GAP_US + 1, 3.0);
        assert_eq!(turn.get(), None);
        for k in 1..=3_u64 {
            turn.push(700_001 + 50_000 * k, 3.0);
        }
        assert_eq!(turn.get(), Some(0.0));
    }

    #[derive(Debug, Clone, Copy, PartialEq)]
    enum Now {
        Works,
        Fails,
        TakesNothing,
        Hangs,
    }

    /// A writer that does as told, five bytes at a time.
    #[derive(Clone)]
    struct Line(Rc<RefCell<(String, std::vec::Vec<u64>, Now)>>);

    #[derive(Debug)]
    struct Broken;
    impl core::fmt::Display for Broken {
        fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
            f.write_str("broken")
        }
    }
    impl core::error::Error for Broken {}
    impl embedded_io_async::Error for Broken {
        fn kind(&self) -> ErrorKind {
            ErrorKind::Other
        }
    }
    impl ErrorType for Line {
        type Error = Broken;
    }
    impl Write for Line {
        async fn write(&mut self, buf: &[u8]) -> Result<usize, Broken> {
            let now = self.0.borrow().2;
            match now {
                Now::Fails => return Err(Broken),
                Now::TakesNothing => return Ok(0),
                Now::Hangs if buf.len() < 60 => core::future::pending().await,
                Now::Works | Now::Hangs => {}
            }
            let count = buf.len().min(5);
            let mut line = self.0.borrow_mut();
            if buf.starts_with(b"$HETHS") {
                line.1.push(Instant::now().as_micros());
            }
            line.0.push_str(core::str::from_utf8(&buf[..count]).unwrap());
            Ok(count)
        }
        async fn flush(&mut self) -> Result<(), Broken> {
            Ok(())
        }
    }

    type Bench = (
        Rc<Shared<LocalRawMutex>>,
        Rc<Port<LocalRawMutex>>,
        Line,
        Executor<'static>,
    );

    /// A unit that is aligned, its estimates every `every_us`, at 0.1 rad/s; the output at work.
    fn bench(every_us: u64) -> Bench {
        let mut unit = Executor::new();
        let shared = Rc::new(Shared::new("0.0.0", Settings::default()));
        let port = Rc::new(Port::new());
        let line = Line(Rc::new(RefCell::new((String::new(), std::vec::Vec::new(), Now::Works))));
        shared.status.sender().send(status(ModeName::Aligned));
        let s = Rc::clone(&shared);
        unit.spawn("estimates", Level::World, async move {
            let every_us = if every_us == 0 { u64::MAX / 2 } else { every_us };
            loop {
                Timer::after_micros(every_us).await;
                let t_us = Instant::now().as_micros();
                let heading = math::wrap_two_pi(1e-7 * t_us as f32);
                s.navigation.sender().send(navigation(t_us, heading, 0.01, None));
            }
        });
        let (s, p, tx) = (Rc::clone(&shared), Rc::clone(&port), line.clone());
        unit.spawn("output", Level::Thread, async move {
            run(&s, &p, tx, OutputConfig::default()).await
        });
        (shared, port, line, unit)
    }

    fn run_to(unit: &mut Executor<'_>, ms: u64) {
        assert_eq!(unit.run_until(Instant::from_millis(ms)), Ok(Stop::Deadline));
    }

    #[test]
    fn ten_cycles_a_second_with_and_without_estimates() {
        for every_us in [0, 49_400, 50_000, 51_000, 5_000, 80_000, 100_000, 1_000_000] {
            let (_, port, line, mut unit) = bench(every_us);
            run_to(&mut unit, 20_000);
            let line = line.0.borrow();
            let steps = line.1.windows(2).map(|at| at[1] - at[0]);
            let (least, most) = steps.fold((u64::MAX, 0), |(l, m), step| (l.min(step), m.max(step)));
            assert!(least >= 80_000 && most <= 160_000, "{every_us}: {least} {most}");
            // Estimates that are slower than the cycles, or do not fit them, cost some.
            let expected = match every_us {
                51_000 => 195,
                80_000 => 150,
                1_000_000 => 190,
                _ => 199,
            };
            assert!(line.1.len() >= expected, "{every_us}: {}", line.1.len());
            // Every tenth cycle, of 160 to 230; the first has it as well.
            let reports = line.0.matches("$PRNST").count();
            assert!((14..=24).contains(&reports), "{every_us}: {reports}");
            let bytes_s = line.0.len() as f64 / 20.0;
            assert!(bytes_s < 0.6 * 11_520.0, "{bytes_s}");
            assert_eq!(port.counts().stalled + port.counts().failed, 0);
            if [49_400, 50_000, 51_000].contains(&every_us) {
                // At the instant of the estimate: 0.1 rad/s in 50 ms would be 0.29°.
                assert!(line.1.iter().skip(2).all(|at_us| at_us % every_us == 0), "{every_us}");
                assert!(line.0.contains("$HEROT,343.8,A"));
            }
        }
    }

    /// Of the estimate in it, for ten minutes, not by the chip's own clock.
    #[test]
    fn a_receivers_time_is_carried_on() {
        let (shared, _, line, mut unit) = bench(49_400);
        let last = |line: &Line| {
            let text = line.0.borrow().0.clone();
            let pashr = text.lines().rfind(|line| line.starts_with("$PASHR,")).unwrap();
            pashr.split(',').nth(1).unwrap().to_string()
        };
        run_to(&mut unit, 2_000);
        assert_eq!(last(&line), "");
        shared.utc_is(Utc {
            said: TimeOfDay::new(235_959, 0).unwrap(),
            t_us: 2_000_000,
        });
        // Cycles begin with every other estimate: the last before is that of 2 * 49.4 * 30 ms, and so on.
        for (ms, time) in [(3_000, "235959.96"), (3_100, "000000.06"), (600_000, "000956.91")] {
            run_to(&mut unit, ms);
            assert_eq!(last(&line), time, "{ms}");
        }
        shared.set_clock(ClockSource::Internal);
        run_to(&mut unit, 600_200);
        assert_eq!(last(&line), "");
        shared.set_clock(ClockSource::Crystal);
        // Also where no estimate is sent.
        shared.status.sender().send(status(ModeName::Idle));
        run_to(&mut unit, 600_400);
        assert_eq!(last(&line), "000957.30");
        run_to(&mut unit, 602_400);
        assert_eq!(last(&line), "");
    }

    #[test]
    fn a_change_of_mode_is_told_at_once() {
        let (shared, _, line, mut unit) = bench(49_400);
        run_to(&mut unit, 1_430);
        let before = line.0.borrow().0.len();
        shared.status.sender().send(status(ModeName::Fault));
        run_to(&mut unit, 1_600);
        let text = line.0.borrow().0[before..].to_string();
        assert!(
            text.starts_with("$HETHS,,V*14\r\n$HEROT,,V*12\r\n$PASHR,,,,,,,,,,0,0*74\r\n$PRNST,"),
            "{text}"
        );
        assert!(text.contains(",fault,1,,,driver,R,*"), "{text}");
    }

    const FOUND: GyrosCalibrated = GyrosCalibrated {
        bias_deg_h: [1.0, 2.0, 3.0],
        biases_used: false,
        misalignment_arcmin: [0.1, 0.2],
        scale_factor_ppm: -12_345.4,
        bias_sd_deg_h: 0.1,
        column_sd_ppm: 12.6,
    };

    #[test]
    fn the_end_of_a_calibration_is_told_once() {
        const CALIBRATED: &str = "$HETXT,01,01,02,gyros calibrated: z scale -12345 sd 13 ppm - biases not used*";
        const MOVED: &str = "$HETXT,01,01,01,gyros not calibrated: the rotor moved while it should rest*";
        let (shared, _, line, mut unit) = bench(49_400);
        shared.status.sender().send(status(ModeName::Calibrating));
        run_to(&mut unit, 1_020);
        shared.calibration.signal(Err(CalibrationFailure::RotorMoved));
        shared.status.sender().send(status(ModeName::Idle));
        run_to(&mut unit, 5_000);
        let text = line.0.borrow().0.clone();
        assert_eq!(text.matches("TXT").count(), 1);
        // Before the mode that says that there is no more to come.
        let (told, idle) = (text.find(MOVED), text.find(",idle,"));
        assert!(told.is_some() && told < idle, "{text}");

        // A line that takes nothing just then takes it later.
        for now in [Now::Fails, Now::TakesNothing, Now::Hangs] {
            line.0.borrow_mut().2 = now;
            line.0.borrow_mut().0.clear();
            shared.calibration.signal(Ok(FOUND));
            let at_ms = unit.now().as_millis();
            run_to(&mut unit, at_ms + 1_000);
            assert!(!line.0.borrow().0.contains('*'), "{now:?}");
            line.0.borrow_mut().2 = Now::Works;
            run_to(&mut unit, at_ms + 3_000);
            let text = line.0.borrow().0.clone();
            assert_eq!(
                (text.matches(CALIBRATED).count(), text.matches('T').count() > 20),
                (1, true),
                "{text}"
            );
            assert_eq!(text.matches("*").count(), text.matches("\r\n$").count(), "{text}");
        }
    }

    /// With nothing left out, and of each failure what the log says of it.
    #[test]
    fn every_end_of_a_calibration_fits_a_sentence() {
        let text = |end| {
            let sentence = calibrated(Talker::Gp, &end);
            let body = sentence.as_str().split('*').next().unwrap_or_default().to_string();
            let (head, text) = body.split_at(16);
            assert!(text.len() <= nmea::TEXT);
            (head.to_string(), text.to_string())
        };
        for failure in [
            CalibrationFailure::RotorMoved,
            CalibrationFailure::BaseMoved { scatter: 12.0 },
            CalibrationFailure::Refused,
            CalibrationFailure::Timeout,
        ] {
            let (head, text) = text(Err(failure));
            assert_eq!(head, "$GPTXT,01,01,01,");
            let reason = text.strip_prefix("gyros not calibrated: ").unwrap();
            assert!(failure.to_string().starts_with(reason), "{text}");
        }
        let worst = GyrosCalibrated {
            column_sd_ppm: 999.0,
            scale_factor_ppm: -50_000.0,
            ..FOUND
        };
        let (head, text) = text(Ok(worst));
        assert_eq!(head, "$GPTXT,01,01,02,");
        assert_eq!(text, "gyros calibrated: z scale -50000 sd 999 ppm - biases not used");
    }

    #[test]
    fn a_broken_line_is_counted_and_left_to_itself() {
        for (now, failed, stalled) in [(Now::Fails, 10, 0), (Now::TakesNothing, 10, 0), (Now::Hangs, 0, 10)] {
            let (_, port, line, mut unit) = bench(49_400);
            run_to(&mut unit, 5_000);
            let good = port.counts();
            assert_eq!((good.failed, good.stalled), (0, 0));
            line.0.borrow_mut().2 = now;
            run_to(&mut unit, 6_000);
            let counts = port.counts();
            let near = |count: u32, expected: u32| count.abs_diff(expected) <= 3 && (count > 0) == (expected > 0);
            assert!(
                near(counts.failed, failed) && near(counts.stalled, stalled),
                "{now:?} {counts:?}"
            );
            let before = line.0.borrow().0.len();
            line.0.borrow_mut().2 = Now::Works;
            run_to(&mut unit, 7_000);
            let text = line.0.borrow().0[before..].to_string();
            // What broke off is ended first: the next sentence is a line of its own.
            assert!(text.starts_with("\r\n$HETHS,"), "{now:?} {text:?}");
            assert!(port.counts().written >= good.written + 9, "{now:?}");
            assert!(port.counts().failed + port.counts().stalled <= counts.failed + counts.stalled + 1);
        }
    }

    #[test]
    fn answers_go_between_the_cycles() {
        let (_, port, line, mut unit) = bench(49_400);
        run_to(&mut unit, 1_020);
        let p = Rc::clone(&port);
        unit.spawn("console", Level::Thread, async move {
            for _ in 0..3 * ANSWERS {
                p.answer(nmea::answer(true, "x")).await;
            }
        });
        run_to(&mut unit, 1_300);
        let line = line.0.borrow();
        assert_eq!(line.0.matches("$PRNSA,ok,x*").count(), 3 * ANSWERS);
        assert!(
            line.0
                .lines()
                .all(|line| line.starts_with('$') && line.matches('$').count() == 1)
        );
    }
}
