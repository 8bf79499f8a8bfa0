//! The aligner: from raw samples to attitude and heading with their σ, step by step.
//!
//! ```text
//!            settle            collect t_k2                 queue empty            σ small, innovations fit
//! Settling ─────────► Coarse ────────────────► CatchingUp ─────────────► Fine ◄──────────────────────► Aligned
//!    ▲                  │ degenerate               │                      │                              │
//!    └──────────────────┴──────── restart ◄────────┴──── gap too long ────┴──────────────────────────────┘
//! ```
//!
//! While coarse alignment collects, every increment waits in a queue. Its result is carried back to
//! the start (where s is ib0), and the fine filter takes the queue from there, a few increments a
//! step, so that a step never takes longer than its share. Nothing measured is thrown away.
//!
//! A filter is as good as the attitude it is linearised about, and coarse heading may be tens of
//! degrees off where the rotor's axis is tilted and the z gyro's bias is not modulated away. So what the
//! filter found is carried back as well: its attitude at the end of the queue, taken back to the start
//! with the biases it found, and the filter starts over from there, with its priors as wide as before,
//! until the start moves no more. Then it works off what has come in meanwhile and is live; from there
//! on replay and live run are the same code.
//!
//! The filter with δω needs no heading to begin with. Where gyro biases have moved gravity so far that coarse alignment
//! finds none, it starts level, with any; and where two headings explain the same measurements there is a filter for each,
//! until one of them is refuted. What is reported is the likelier, with the σ of both together.
//!
//! Purely a function of the samples: no clock, no logging, fixed memory. The capacity `N` must hold
//! `t_k2` at [`AlignerConfig::decimate_to`]; [`Aligner::new`] checks it.

use core::mem::MaybeUninit;

use frames::{Attitude, AttitudeSd, Body, Nav, Real, Rot, RotIntegral, Sensor, Vec3, math, units};
use heapless::Deque;

use crate::{
    adaptive_noise::AdaptiveNoise,
    coarse::{Coarse, CoarseError, CoarsePoint, CoarseSolution},
    deviation::Deviation,
    earth::{Earth, EarthError},
    fine::{CERTAIN, FilterConfig, FilterConfigError, FineFilter, Innovation},
    increment::{ConingScullingCorrector, Decimator, Increment, Sample},
    model::{ROBUST, WE},
    noise::{ImuNoise, WalkMeter},
    rotor::RotorConfig,
    strapdown::{Corrections, Strapdown},
};

/// Queue length that holds the default configuration, 54.3 s at 20 Hz, and what comes in while that is
/// replayed: 34 kB in f32.
pub const QUEUE: usize = 1200;

/// Increments filtered from the queue, and carried back, for each second of samples, in whole ones for each sample: at 202
/// samples a second three and seven, and a pass over 54 s takes 2.6 s. With the rest of the unit it is less than a tenth of a
/// Cortex-M4F at 168 MHz.
const FORWARD: f64 = 700.0;
const BACK: f64 = 1500.0;

/// Most times that the fine filter goes over the queue.
const MOST_PASSES: u8 = 6;

/// How far one pass may still have moved the start, rad: the error of linearising about it is half the
/// square, 0.01° for 1°.
const SETTLED: f64 = 1.0 * units::DEG;

/// The same for tilt, where heading is linear: its error takes half the square of gravity, 6e-7 m/s² for 0.02°.
const SETTLED_LEVEL: f64 = 0.02 * units::DEG;

/// Turn by the 1σ of a gyro bias over the queue beyond which there is one pass, rad. What the model leaves out is more then
/// than another pass would gain, and a second one begins with a measurement noise that has no room for it.
const LARGEST_TURN: f64 = 10.0 * units::DEG;

/// 1σ of a heading that may be any, rad: 2π/√12.
const ANY_HEADING_SD: f64 = 1.8138;

/// How much less likely a heading may become, as −2 ln of the ratio, before it is given up: with 15 to spare from where it is
/// not told any more, for what the model leaves out.
const REFUTED: f64 = CERTAIN + 15.0;

/// Figures of the aligner.
///
/// | field | unit | zero means | sane value |
/// |---|---|---|---|
/// | `latitude` | rad | the equator | yours, to 0.1° |
/// | `height` | m | sea level | yours, to 100 m |
/// | `settle` | s | the first sample counts | 0.2 s |
/// | `t_k1`, `t_k2` | s | refused | one and three legs of the rotor |
/// | `decimate_to` | s | refused: the queue could not tell what it must hold | 50 ms |
/// | `longest_gap` | s | no gap is bridged | 0.5 s |
/// | `ready_heading_sd` | rad | never ready | 1° |
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct AlignerConfig<T: Real = f32, const B: usize = ROBUST> {
    /// Geodetic latitude, north positive, rad.
    pub latitude: T,
    /// Height above the ellipsoid, m.
    pub height: T,
    /// Samples of this first time are only looked at, s.
    pub settle: T,
    /// First time of coarse alignment after settling, s (\[Xing18\] (17)).
    pub t_k1: T,
    /// Second time of coarse alignment, s.
    pub t_k2: T,
    /// Length of the increments that the filter takes, s.
    pub decimate_to: T,
    /// Longest time without data that is bridged once the filter runs, s. Longer ones start anew.
    pub longest_gap: T,
    /// Heading 1σ below which the unit calls itself aligned, rad.
    pub ready_heading_sd: T,
    /// Figures of the fine filter.
    pub filter: FilterConfig<T, B>,
}

impl<T: Real, const B: usize> AlignerConfig<T, B> {
    /// Defaults for a place and a rotor: coarse alignment after one and three whole legs, over which
    /// the level biases cancel.
    pub fn for_rotor(latitude: T, height: T, rotor: &RotorConfig<T>, filter: FilterConfig<T, B>) -> Self {
        let leg = if rotor.rate > T::zero() {
            rotor.travel / rotor.rate + rotor.rate / rotor.acceleration
        } else {
            T::lit(18.0)
        };
        // A fast rotor takes more legs, so that gravity has moved; a slow one gets what the queue holds.
        let (least, most) = (T::lit(12.0), T::lit(18.2));
        let legs = if leg < least {
            (T::lit(15.0) / leg).ceil()
        } else {
            T::one()
        };
        let t_k1 = (leg * legs).min(most);
        Self {
            latitude,
            height,
            settle: T::lit(0.2),
            t_k1,
            t_k2: T::lit(3.0) * t_k1,
            decimate_to: T::lit(0.05),
            longest_gap: T::lit(0.5),
            ready_heading_sd: T::lit(1.0 * units::DEG),
            filter,
        }
    }
}

/// Why an aligner cannot be made.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum AlignerError {
    /// The place is out of range.
    Earth(EarthError),
    /// A figure of the filter is out of range.
    Filter(FilterConfigError),
    /// A time is negative or not finite, `decimate_to` is zero, or t_k1 and t_k2 are not in order.
    Times,
    /// The queue cannot hold t_k2: raise `decimate_to` or the capacity.
    Queue {
        /// Increments needed.
        needed: u32,
        /// Increments it holds.
        capacity: u32,
    },
}

impl core::fmt::Display for AlignerError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            Self::Earth(e) => e.fmt(f),
            Self::Filter(e) => e.fmt(f),
            Self::Times => {
                f.write_str("aligner times must be finite and not negative, with 0 < t_k1 < t_k2 and decimate_to > 0")
            }
            Self::Queue { needed, capacity } => {
                write!(
                    f,
                    "t_k2 needs {needed} increments, the queue holds {capacity}: raise decimate_to or the capacity"
                )
            }
        }
    }
}

impl core::error::Error for AlignerError {}

/// Where the aligner stands.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Mode {
    /// Looks at the first samples.
    Settling,
    /// Collects for coarse alignment; increments wait in the queue.
    Coarse,
    /// The fine filter works through the queue.
    CatchingUp,
    /// The fine filter is at the present; its result is not good enough yet.
    Fine,
    /// Heading is within its set σ and the innovations fit the model; keeps tracking.
    Aligned,
}

/// Why the aligner is not aligned, or not any more.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum NotReady<T: Real = f32> {
    /// Settling or collecting: this long to go, s.
    Collecting {
        /// Time until coarse alignment, s.
        remaining: T,
    },
    /// Increments still wait in the queue.
    CatchingUp {
        /// How many.
        queued: u32,
    },
    /// Heading is known, but not well enough.
    HeadingSd {
        /// Its 1σ now, rad.
        sd: T,
    },
    /// The rotor's axis is tilted, and another heading with another z gyro bias explains all innovations as well, so far:
    /// wait, level the unit, or align where the axis points elsewhere.
    Ambiguous {
        /// The other heading, as its difference to the one reported, clockwise, rad.
        heading_offset: T,
        /// The z gyro bias that goes with it, rad/s.
        gyro_bias_z: T,
    },
    /// Innovations are larger than the model allows: the base does more than swing and sway, or a sensor has changed.
    /// Attitude and σ must not be trusted.
    Inconsistent {
        /// Mean of innovation²/variance per component; 1 where the model holds.
        ratio: T,
    },
}

/// Why the alignment started anew.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Restart<T: Real = f32> {
    /// Coarse alignment found no attitude.
    Coarse(CoarseError<T>),
    /// No data for longer than `longest_gap`, or any gap while collecting.
    Gap {
        /// How long, s.
        length: T,
    },
    /// A sample that cannot be: see [`Sample::is_valid`].
    BadSample,
    /// The innovations were so far from the model that the filter's figures are no covariance any more.
    Diverged,
}

/// What a step brought about.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Event<T: Real = f32> {
    /// Coarse alignment has succeeded; the fine filter starts from it.
    CoarseDone {
        /// Attitude of the housing by coarse alignment, now.
        attitude: Attitude<T>,
        /// Its predicted 1σ.
        sd: AttitudeSd<T>,
    },
    /// The fine filter has caught up with the present.
    CaughtUp,
    /// Heading is within its set σ.
    Aligned,
    /// It no longer is, or the innovations no longer fit.
    Lost(NotReady<T>),
    /// Data were missing and have been bridged.
    Bridged {
        /// How long, s.
        length: T,
    },
    /// Everything starts anew.
    Restarted(Restart<T>),
}

/// All that is known at one moment.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Estimate<T: Real = f32> {
    /// `C_b^n`.
    pub c_nb: Rot<Nav, Body, T>,
    /// Its angles.
    pub attitude: Attitude<T>,
    /// 1σ of each angle.
    pub sd: AttitudeSd<T>,
    /// Gyro biases, rad/s.
    pub gyro_bias_s: Vec3<Sensor, T>,
    /// 1σ of each.
    pub gyro_bias_sd: Vec3<Sensor, T>,
    /// Accelerometer biases, m/s².
    pub accel_bias_s: Vec3<Sensor, T>,
    /// 1σ of each.
    pub accel_bias_sd: Vec3<Sensor, T>,
}

/// What the alignment knows at its end, for [`Navigator`](crate::navigator::Navigator) to go on from.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct AlignmentResult<T: Real = f32> {
    /// Attitude, its 1σ, the 1σ of the biases.
    pub estimate: Estimate<T>,
    /// Velocity, m/s.
    pub v_n: Vec3<Nav, T>,
    /// What the sensors are corrected by.
    pub corrections: Corrections<T>,
    /// The rotation to s from the frame whose z is the rotor's axis.
    pub rotor_in_s: Rot<Sensor, Sensor, T>,
    /// The rotor's angle at that instant, rad.
    pub alpha: T,
}

/// Running mean of the normalised squared innovations.
///
/// A mean over about 16 measurements of three components has a spread of √(2/48) = 0.2 about one where
/// the model holds; twice the expected is five of those.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Consistency<T: Real> {
    ratio: T,
    last: Option<Innovation<T>>,
}

impl<T: Real> Consistency<T> {
    const MEMORY: f64 = 16.0;
    const LIMIT: f64 = 2.0;

    fn new() -> Self {
        Self {
            ratio: T::one(),
            last: None,
        }
    }

    fn push(&mut self, innovation: Innovation<T>) {
        self.last = Some(innovation);
        // What was not taken says nothing of how well the rest fits.
        if !innovation.refused {
            let ratio = innovation.nis * T::lit(1.0 / 3.0);
            self.ratio += (ratio - self.ratio) * T::lit(1.0 / Self::MEMORY);
        }
    }

    fn holds(&self) -> bool {
        self.ratio <= T::lit(Self::LIMIT)
    }
}

/// One run of the fine filter over the queue.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Pass<T: Real> {
    /// 1 for the first.
    number: u8,
    /// Where it starts.
    start: Rot<Nav, Sensor, T>,
    /// The z gyro bias that it is linear about at first, rad/s.
    gyro_bias_z: T,
    /// 1σ of the tilt of that, rad.
    tilt_sd: T,
    /// Of the gyros, as told or as measured, rad/√s.
    angle_random_walk: T,
    /// Variance of the base's displacement that it starts with, m².
    level_var: T,
    /// How many increments it takes.
    length: usize,
}

/// Where the fine filter is in the queue.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Replay<T: Real> {
    /// Filtering, increment `next` first.
    Forward { pass: Pass<T>, next: usize },
    /// Adding up the turn over the same increments with the sensor errors found, to carry the attitude back.
    Back {
        pass: Pass<T>,
        solution: Strapdown<T>,
        next: usize,
        turn: RotIntegral<Sensor, Sensor, T>,
        t: T,
    },
    /// The start has settled; working off what came in meanwhile.
    Drain,
    /// At the present.
    Live,
}

/// The modes with what each of them holds.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Stage<T: Real, const B: usize> {
    Settling {
        elapsed: T,
    },
    Coarse {
        coarse: Coarse<T>,
        first: Option<CoarsePoint<T>>,
        gyro_bias_z: GyroBiasZ<T>,
        walk: WalkMeter<T>,
    },
    Fine {
        filter: FineFilter<T, B>,
        rival: Option<Rival<T, B>>,
        consistency: Consistency<T>,
        replay: Replay<T>,
        aligned: bool,
    },
}

/// The filter about the other heading, where two explain the same measurements.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Rival<T: Real, const B: usize> {
    filter: FineFilter<T, B>,
    /// How much less likely it is, as −2 ln of the ratio.
    behind: T,
}

impl<T: Real, const B: usize> Rival<T, B> {
    /// Its probability.
    fn share(&self) -> T {
        let odds = math::exp(self.behind * T::lit(-0.5));
        odds / (T::one() + odds)
    }
}

/// Lets a filter have an increment, and its rival beside it.
fn step_both<T: Real, const B: usize>(
    filter: &mut FineFilter<T, B>,
    rival: &mut Option<Rival<T, B>>,
    (increment, alpha): &(Increment<T>, T),
) -> Option<Innovation<T>> {
    let innovation = filter.step(increment, *alpha);
    if let Some(rival) = rival {
        let refused = innovation.is_some_and(|innovation| innovation.refused);
        let other = rival.filter.step_beside(increment, *alpha, filter, refused);
        if let (Some(innovation), Some(other)) = (&innovation, &other) {
            rival.behind += other.surprisal - innovation.surprisal;
        }
    }
    innovation
}

/// After a measurement: a filter that does not know which of two headings is right is split; the likelier of two leads, and
/// a rival that is refuted goes.
fn compare<T: Real, const B: usize>(filter: &mut FineFilter<T, B>, rival: &mut Option<Rival<T, B>>) {
    match rival {
        None if filter.is_ambiguous() => {
            let other = rival.insert(Rival {
                filter: *filter,
                behind: T::zero(),
            });
            other.behind = filter.split(&mut other.filter);
        }
        None => {}
        Some(other) => {
            if other.behind < T::zero() {
                core::mem::swap(filter, &mut other.filter);
                other.behind = -other.behind;
            }
            // Not a number where one of them has come to grief: what leads is looked after elsewhere.
            let stays = other.behind < T::lit(REFUTED) && other.filter.is_sound();
            if !stays {
                *rival = None;
            }
        }
    }
}

/// The z gyro's bias against the encoder while coarse alignment collects: the slope of the gyro's angle against the
/// encoder's, the base's own yaw in the mean zero.
///
/// ```text
/// ε_z = 30/T⁵ ∫ t² (T − t)² (ω_z − α̇) dt − ω_ie sin L
/// ```
///
/// The weight leaves of a yaw of amplitude A and rate w at most 60 A/(w² T³): 9 °/h of 10° and 5 s after 54 s.
///
/// It is no measurement, for the base may turn: only what the filter is linear about at first.
#[derive(Debug, Clone, Copy, PartialEq)]
struct GyroBiasZ<T: Real> {
    sum: T,
    weights: T,
    alpha: Option<T>,
}

impl<T: Real> GyroBiasZ<T> {
    /// Below this, rad/s, a bias is found soon enough for the linear model: it turns the frame by 15° in 15 minutes.
    const SMALL: f64 = 60.0 * units::DEG_PER_HOUR;
    /// A figure beyond so many of the bias's σ is the base's own turning.
    const GATE: f64 = 4.0;

    fn new() -> Self {
        Self {
            sum: T::zero(),
            weights: T::zero(),
            alpha: None,
        }
    }

    /// Adds the increment that ends at `t` of `total` seconds, with the rotor at `alpha`.
    fn push(&mut self, increment: &Increment<T>, alpha: T, t: T, total: T) {
        if let Some(before) = self.alpha.replace(alpha) {
            let turned = math::wrap_pi(increment.phi_s.z() - (alpha - before));
            let share = (t - increment.dt * T::lit(0.5)) / total;
            let weight = share * (T::one() - share);
            let weight = weight * weight;
            self.sum += weight * turned;
            self.weights += weight * increment.dt;
        }
    }

    /// The bias to be linear about, rad/s. Zero where it is small, or where it may as well be the base that turns.
    fn start_from(self, noise: &ImuNoise<T>, earth: &Earth<T>) -> T {
        let (zero, small) = (T::zero(), T::lit(Self::SMALL));
        if self.weights <= zero || noise.gyro_bias_sd <= small {
            return zero;
        }
        let found = self.sum / self.weights - earth.w_ie_n().z();
        let plausible = found.abs() > small && found.abs() < noise.gyro_bias_sd * T::lit(Self::GATE);
        if plausible { found } else { zero }
    }
}

/// What the mean of two rates held over a gap may have missed of their integral, 1σ.
///
/// Rates that changed as steadily as before leave nothing. What does not fit a straight line is either a
/// curve, e·gap/12 at most, or a corner of the rotor's profile in the gap, e·gap/8 at most.
fn bridging_error<T: Real>(
    earlier: Option<Vec3<Sensor, T>>,
    before: Vec3<Sensor, T>,
    after: Vec3<Sensor, T>,
    dt: T,
    gap: T,
) -> T {
    let change = after - before;
    match earlier {
        Some(earlier) => (change - (before - earlier) * ((gap + dt) / dt)).norm() * gap * T::lit(0.125),
        None => change.norm() * gap * T::lit(0.5),
    }
}

/// See the module.
#[derive(Debug, Clone)]
pub struct Aligner<T: Real = f32, const B: usize = ROBUST, const N: usize = QUEUE> {
    config: AlignerConfig<T, B>,
    earth: Earth<T>,
    corrector: ConingScullingCorrector<T>,
    decimator: Decimator<T>,
    last: Option<Sample<T>>,
    before_last: Option<Sample<T>>,
    /// With the rotor's angle at the end of each, rad.
    queue: Deque<(Increment<T>, T), N>,
    stage: Stage<T, B>,
    /// The rotor's angle at the end of the last sample, rad.
    alpha: T,
}

impl<T: Real, const B: usize, const N: usize> Aligner<T, B, N> {
    /// Checks the figures and waits for the first sample.
    ///
    /// # Errors
    /// [`AlignerError`] says which figure is out of range.
    pub fn new(config: AlignerConfig<T, B>) -> Result<Self, AlignerError> {
        Ok(Self::made(config, Self::check(&config)?))
    }

    /// The same in its place, which it never leaves: most of it is the queue, 34 kB that a stack need not hold.
    ///
    /// # Errors
    /// [`AlignerError`] says which figure is out of range.
    pub fn new_in(place: &mut MaybeUninit<Self>, config: AlignerConfig<T, B>) -> Result<&mut Self, AlignerError> {
        let earth = Self::check(&config)?;
        Ok(place.write(Self::made(config, earth)))
    }

    /// Checks the figures; Earth at the place.
    fn check(config: &AlignerConfig<T, B>) -> Result<Earth<T>, AlignerError> {
        let earth = Earth::new(config.latitude, config.height).map_err(AlignerError::Earth)?;
        config.filter.validate().map_err(AlignerError::Filter)?;
        let zero = T::zero();
        let AlignerConfig {
            settle,
            t_k1,
            t_k2,
            decimate_to,
            longest_gap,
            ready_heading_sd,
            ..
        } = *config;
        let sane = |x: T| x.finite() && x >= zero;
        let times = [settle, t_k1, t_k2, decimate_to, longest_gap, ready_heading_sd];
        if !(times.into_iter().all(sane) && t_k1 > zero && t_k2 > t_k1 && decimate_to > zero) {
            return Err(AlignerError::Times);
        }
        // One for the increment that is over t_k2, one for rounding. What comes in during a replay is
        // looked after there.
        let needed = t_k2 / (decimate_to * T::lit(0.99)) + T::lit(2.0);
        if needed > T::lit(N as f64) {
            #[expect(
                clippy::cast_possible_truncation,
                clippy::cast_sign_loss,
                reason = "only for the message"
            )]
            let needed = needed.to_f64() as u32;
            #[expect(clippy::cast_possible_truncation, reason = "a queue of 2^32 increments is 100 GB")]
            return Err(AlignerError::Queue {
                needed,
                capacity: N as u32,
            });
        }
        Ok(earth)
    }

    #[inline(always)]
    fn made(config: AlignerConfig<T, B>, earth: Earth<T>) -> Self {
        Self {
            config,
            earth,
            corrector: ConingScullingCorrector::new(),
            decimator: Decimator::new(config.decimate_to),
            last: None,
            before_last: None,
            queue: Deque::new(),
            stage: Stage::Settling { elapsed: T::zero() },
            alpha: T::zero(),
        }
    }

    /// Takes one sample and the rotor angle α at its end, rad.
    ///
    /// A step returns at most one event; of two, the one with more information.
    pub fn step(&mut self, sample: &Sample<T>, alpha: T) -> Option<Event<T>> {
        if !(sample.is_valid() && alpha.finite()) {
            return Some(self.restart(Restart::BadSample));
        }
        self.alpha = alpha;
        let mut event = None;
        if sample.gap > T::zero() {
            match self.bridge(sample) {
                Ok(bridged) => event = bridged,
                Err(reason) => return Some(self.restart(reason)),
            }
        }
        self.before_last = self.last.replace(*sample);
        if let Stage::Settling { elapsed } = &mut self.stage {
            *elapsed += sample.dt;
            let settled = *elapsed >= self.config.settle;
            // The last sample of settling is the past that the first increment's coning terms need.
            self.corrector.increment(sample);
            if settled {
                self.stage = Stage::Coarse {
                    coarse: Coarse::new(),
                    first: None,
                    gyro_bias_z: GyroBiasZ::new(),
                    walk: WalkMeter::new(),
                };
            }
            return event;
        }
        if let Stage::Coarse { walk, .. } = &mut self.stage {
            walk.samples.push(sample.dtheta_s, sample.dt, sample.gap > T::zero());
        }
        let increment = self.corrector.increment(sample);
        let joined = self.decimator.push(&increment);
        if let Some(joined) = joined {
            if let Err(reason) = self.take(joined, alpha) {
                return Some(self.restart(reason));
            }
            let told = self.collect();
            event = told.or(event);
        }
        self.process_queue(sample.dt, joined.map(|_| alpha)).or(event)
    }

    /// Bridges the gap before `sample` while the fine filter runs.
    fn bridge(&mut self, sample: &Sample<T>) -> Result<Option<Event<T>>, Restart<T>> {
        let length = sample.gap;
        let refused = Err(Restart::Gap { length });
        let Some(before) = self.last else { return Ok(None) };
        match &mut self.stage {
            Stage::Settling { .. } => return Ok(None),
            _ if length > self.config.longest_gap => return refused,
            Stage::Fine {
                filter,
                rival,
                replay: Replay::Live,
                ..
            } => {
                let missed = |rate: fn(&Sample<T>) -> Vec3<Sensor, T>| {
                    bridging_error(
                        self.before_last.as_ref().map(rate),
                        rate(&before),
                        rate(sample),
                        before.dt,
                        length,
                    )
                };
                let (phi_sd, dv_sd) = (missed(|s| s.dtheta_s / s.dt), missed(|s| s.dv_s / s.dt));
                filter.inflate_covariance(phi_sd, dv_sd);
                if let Some(rival) = rival {
                    rival.filter.inflate_covariance(phi_sd, dv_sd);
                }
            }
            // A missing sample or two is smoothed over. More would bend the attitude that all rests on, and what is queued
            // for a replay carries no doubt.
            _ if length > before.dt * T::lit(3.0) => return refused,
            _ => {}
        }
        let bridge = before.bridge(sample, length);
        let increment = self.corrector.increment(&bridge);
        if let Some(joined) = self.decimator.push(&increment) {
            // To the turn of the housing in one sample.
            self.take(joined, self.alpha - sample.dtheta_s.z())?;
        }
        Ok(Some(Event::Bridged { length }))
    }

    /// Queues a joined increment, at whose end the rotor is at `alpha`, and lets coarse alignment have it.
    fn take(&mut self, joined: Increment<T>, alpha: T) -> Result<(), Restart<T>> {
        if let Stage::Coarse {
            coarse,
            first,
            gyro_bias_z,
            walk,
        } = &mut self.stage
        {
            walk.joined.push(joined.phi_s, joined.dt, false);
            coarse.push(&joined);
            gyro_bias_z.push(&joined, alpha, coarse.t(), self.config.t_k2);
            let half = T::lit(0.5) * joined.dt;
            if first.is_none() && coarse.t() + half >= self.config.t_k1 {
                *first = Some(coarse.point());
            }
        }
        // `new` has made room for all of the default course of things; only bridged gaps of a stalled
        // source could fill it.
        self.queue
            .push_back((joined, alpha))
            .map_err(|(joined, _)| Restart::Gap { length: joined.dt })
    }

    /// Solves for the coarse attitude where it is time.
    fn collect(&mut self) -> Option<Event<T>> {
        let Stage::Coarse {
            coarse,
            first: Some(first),
            gyro_bias_z,
            walk,
        } = &self.stage
        else {
            return None;
        };
        if coarse.t() + T::lit(0.5) * self.config.decimate_to < self.config.t_k2 {
            return None;
        }
        let noise = &self.config.filter.noise;
        let tilt_sd = first.level_sd(noise, &self.earth);
        let (start, c_ns, sd) = match CoarseSolution::solve(*first, coarse.point(), &self.earth) {
            Ok(solution) => {
                let c_ns = coarse.c_ns(&solution, &self.earth);
                let p_phi = coarse.phi_covariance(&solution, &self.earth, noise);
                let sd = AttitudeSd::from_phi_covariance(&(c_ns * self.c_sb()), &p_phi);
                (solution.c_ns_at_start(&self.earth), c_ns, sd)
            }
            Err(CoarseError::Degenerate { .. }) if B > WE => {
                let start = first.level();
                let sd = AttitudeSd {
                    heading: T::lit(ANY_HEADING_SD),
                    pitch: tilt_sd,
                    roll: tilt_sd,
                };
                (start, start * coarse.c_ib0_s().relabel(), sd)
            }
            Err(reason) => return Some(self.restart(Restart::Coarse(reason))),
        };
        let attitude = Attitude::from_rot(&(c_ns * self.c_sb()));
        let pass = Pass {
            number: 1,
            start,
            gyro_bias_z: gyro_bias_z.start_from(noise, &self.earth),
            tilt_sd: math::hypot(self.config.filter.tilt_sd, tilt_sd),
            angle_random_walk: walk.at_least(noise.angle_random_walk),
            level_var: T::zero(),
            length: self.queue.len(),
        };
        self.start_over(pass, None)?;
        Some(Event::CoarseDone { attitude, sd })
    }

    /// Sets the fine filter to the start of the queue, for a pass over it.
    fn start_over(&mut self, mut pass: Pass<T>, adaptive_noise: Option<AdaptiveNoise<T>>) -> Option<()> {
        let zero = T::zero();
        let mut config = self.config.filter;
        if B > WE {
            config.tilt_sd = pass.tilt_sd;
            config.noise.angle_random_walk = pass.angle_random_walk;
        }
        // The figures were checked when the aligner was made.
        let filter = FineFilter::new(config, self.earth, pass.start, adaptive_noise)
            .ok()?
            .about_gyro_bias(Vec3::new(zero, zero, pass.gyro_bias_z));
        pass.level_var = filter.adaptive_noise().level_var();
        let replay = Replay::Forward { pass, next: 0 };
        self.stage = Stage::Fine {
            filter,
            rival: None,
            consistency: Consistency::new(),
            replay,
            aligned: false,
        };
        Some(())
    }

    /// Lets the fine filter have its share of the queue, after a sample of `dt` seconds. `alpha` is the rotor's angle now,
    /// where the last increment in the queue ends now.
    fn process_queue(&mut self, dt: T, alpha: Option<T>) -> Option<Event<T>> {
        let Stage::Fine {
            filter,
            rival,
            consistency,
            replay,
            ..
        } = &mut self.stage
        else {
            return None;
        };
        let share = |per_second: f64| {
            // Not more than a whole number of increments can be: samples are a second long at most.
            let share = (dt * T::lit(per_second)).to_f64() as usize;
            share.max(1)
        };
        // The encoder constraint is for what is live: what it says of the z gyro in its first seconds, the covariance
        // carries back to all that was filtered before.
        let is_next = self.queue.len() == 1 && matches!(replay, Replay::Live);
        let alpha = alpha.filter(|_| is_next);
        filter.rotor_at(alpha);
        if let Some(rival) = rival {
            rival.filter.rotor_at(alpha);
        }
        // Two filters take the time of two.
        let forward = if rival.is_some() { 0.5 * FORWARD } else { FORWARD };
        let mut measured = false;
        let mut filtered = |queued: &(Increment<T>, T)| {
            if let Some(innovation) = step_both(filter, rival, queued) {
                consistency.push(innovation);
                measured = true;
            }
        };
        match replay {
            Replay::Forward { pass, next } => {
                let end = (*next + share(FORWARD)).min(pass.length);
                self.queue.iter().take(end).skip(*next).for_each(filtered);
                *next = end;
                if end == pass.length {
                    *replay = Replay::Back {
                        pass: *pass,
                        solution: filter.solution(),
                        next: 0,
                        turn: RotIntegral::new(Rot::identity()),
                        t: T::zero(),
                    };
                }
            }
            Replay::Back {
                pass,
                solution,
                next,
                turn,
                t,
            } => {
                let end = (*next + share(BACK)).min(pass.length);
                for (increment, alpha) in self.queue.iter().take(end).skip(*next) {
                    let gyro_error = solution.corrections.gyro_error(increment, *alpha);
                    turn.turn_from(increment.phi_s - gyro_error);
                    *t += increment.dt;
                }
                *next = end;
                if end < pass.length {
                    return None;
                }
                // C(t) = exp(−ω_ie t) C(0) Q, Q the turn of s with the biases found.
                let back = Rot::exp(self.earth.w_ie_n() * *t) * solution.c_ns.get() * turn.get().inverse();
                let moved = (back * pass.start.inverse()).log();
                // A filter with δω is linear in heading: only the level part must settle.
                let (moved, limit) = if B > WE {
                    (math::hypot(moved.x(), moved.y()), SETTLED_LEVEL)
                } else {
                    (moved.norm(), SETTLED)
                };
                let adaptive_noise = filter.adaptive_noise().as_prior();
                let (level_var, four) = (adaptive_noise.level_var(), T::lit(4.0));
                let settled =
                    moved <= T::lit(limit) && level_var <= pass.level_var * four && pass.level_var <= level_var * four;
                // Another pass there and back lets these increments in, a fifth more for shares that were rounded off.
                let taken = pass.length as f64 * (1.0 / FORWARD + 1.0 / BACK);
                let linear = filter.config().noise.gyro_bias_sd * *t < T::lit(LARGEST_TURN);
                let room = T::lit((N - self.queue.len()) as f64) * self.config.decimate_to > T::lit(1.2 * taken);
                if !settled && linear && pass.number < MOST_PASSES && room {
                    let next = Pass {
                        number: pass.number + 1,
                        start: back.normalized(),
                        ..*pass
                    };
                    self.start_over(next, Some(adaptive_noise))?;
                    return None;
                }
                for _ in 0..pass.length {
                    self.queue.pop_front();
                }
                filter.close_loop();
                *replay = Replay::Drain;
            }
            Replay::Drain | Replay::Live => {
                for _ in 0..share(forward) {
                    let Some(increment) = self.queue.pop_front() else { break };
                    filtered(&increment);
                }
                if measured {
                    compare(filter, rival);
                }
            }
        }
        // The covariance changes with a measurement only. On each sample the check would cost nearly three times all the rest.
        if measured && !filter.is_sound() {
            return Some(self.restart(Restart::Diverged));
        }
        if matches!(replay, Replay::Drain) && self.queue.is_empty() {
            *replay = Replay::Live;
            return Some(Event::CaughtUp);
        }
        if !measured || !matches!(replay, Replay::Live) {
            return None;
        }
        let not_ready = self.not_ready_fine();
        let Stage::Fine { aligned: was, .. } = &mut self.stage else {
            return None;
        };
        match (*was, not_ready) {
            (false, None) => {
                *was = true;
                Some(Event::Aligned)
            }
            (true, Some(reason)) => {
                *was = false;
                Some(Event::Lost(reason))
            }
            _ => None,
        }
    }

    fn restart(&mut self, reason: Restart<T>) -> Event<T> {
        self.start_anew();
        Event::Restarted(reason)
    }

    /// `C_b^s` now.
    fn c_sb(&self) -> Rot<Sensor, Body, T> {
        Rot::about_z(self.alpha).inverse()
    }

    /// Forgets all samples.
    pub fn start_anew(&mut self) {
        self.corrector = ConingScullingCorrector::new();
        self.decimator = Decimator::new(self.config.decimate_to);
        self.last = None;
        self.before_last = None;
        self.queue.clear();
        self.stage = Stage::Settling { elapsed: T::zero() };
    }

    /// Where the aligner stands.
    pub fn mode(&self) -> Mode {
        match &self.stage {
            Stage::Settling { .. } => Mode::Settling,
            Stage::Coarse { .. } => Mode::Coarse,
            Stage::Fine { replay, .. } if !matches!(replay, Replay::Live) => Mode::CatchingUp,
            Stage::Fine { aligned: false, .. } => Mode::Fine,
            Stage::Fine { .. } => Mode::Aligned,
        }
    }

    /// Why it is not aligned; `None` where it is.
    pub fn not_ready(&self) -> Option<NotReady<T>> {
        match &self.stage {
            Stage::Settling { elapsed } => Some(NotReady::Collecting {
                remaining: self.config.settle - *elapsed + self.config.t_k2,
            }),
            Stage::Coarse { coarse, .. } => Some(NotReady::Collecting {
                remaining: self.config.t_k2 - coarse.t(),
            }),
            #[expect(clippy::cast_possible_truncation, reason = "a queue of 2^32 increments is 100 GB")]
            Stage::Fine { replay, .. } if !matches!(replay, Replay::Live) => Some(NotReady::CatchingUp {
                queued: self.queue.len() as u32,
            }),
            Stage::Fine { .. } => self.not_ready_fine(),
        }
    }

    fn not_ready_fine(&self) -> Option<NotReady<T>> {
        let Stage::Fine {
            filter,
            rival,
            consistency,
            ..
        } = &self.stage
        else {
            return None;
        };
        if !consistency.holds() {
            return Some(NotReady::Inconsistent {
                ratio: consistency.ratio,
            });
        }
        let estimate = self.estimate()?;
        let sd = estimate.sd.heading;
        if let Some(rival) = rival.as_ref().filter(|rival| rival.behind < T::lit(CERTAIN)) {
            return Some(NotReady::Ambiguous {
                heading_offset: self.heading_offset(estimate.attitude.heading, &rival.filter),
                gyro_bias_z: rival.filter.solution().corrections.gyro_bias_s.z(),
            });
        }
        if let Some(other) = filter.other_solution()
            && other.heading_offset.abs() > T::lit(5.0) * sd
        {
            return Some(NotReady::Ambiguous {
                heading_offset: other.heading_offset,
                gyro_bias_z: other.gyro_bias_z,
            });
        }
        (sd > self.config.ready_heading_sd).then_some(NotReady::HeadingSd { sd })
    }

    /// `C_b^n` now, by a filter whose solution this is.
    fn c_nb(&self, filter: &FineFilter<T, B>, solution: &Strapdown<T>) -> Rot<Nav, Body, T> {
        let mut c_ns = solution.c_ns.get();
        if let Some(pending) = self.decimator.pending() {
            let gyro_error = solution.corrections.gyro_error(&pending, self.alpha);
            let turn = Rot::exp(pending.phi_s - gyro_error);
            c_ns = (Rot::exp(-(self.earth.w_ie_n() * pending.dt)) * c_ns * turn).normalized();
        }
        (c_ns * filter.rotor_in_s(solution)).normalized() * self.c_sb()
    }

    /// Heading by `other` less `heading`, clockwise, rad.
    fn heading_offset(&self, heading: T, other: &FineFilter<T, B>) -> T {
        let c_nb = self.c_nb(other, &other.solution());
        math::wrap_pi(Attitude::from_rot(&c_nb).heading - heading)
    }

    /// What is known now; `None` before the fine filter is at the present.
    pub fn estimate(&self) -> Option<Estimate<T>> {
        let Stage::Fine {
            filter,
            rival,
            replay: Replay::Live,
            ..
        } = &self.stage
        else {
            return None;
        };
        let solution = filter.solution();
        let corrections = &solution.corrections;
        let c_nb = self.c_nb(filter, &solution);
        let attitude = Attitude::from_rot(&c_nb);
        let mut p = filter.phi_covariance();
        if let Some(rival) = rival {
            let (share, offset) = (rival.share(), self.heading_offset(attitude.heading, &rival.filter));
            let there = rival.filter.phi_covariance()[(2, 2)] + offset * offset;
            p[(2, 2)] = p[(2, 2)] * (T::one() - share) + there * share;
        }
        Some(Estimate {
            c_nb,
            attitude,
            sd: AttitudeSd::from_phi_covariance(&c_nb, &p),
            gyro_bias_s: corrections.gyro_bias_s + corrections.gyro_instability_s,
            gyro_bias_sd: filter.gyro_bias_sd(),
            accel_bias_s: corrections.accel_bias_s,
            accel_bias_sd: filter.accel_bias_sd(),
        })
    }

    /// What navigation goes on from; `None` before the fine filter is at the present.
    pub fn alignment_result(&self) -> Option<AlignmentResult<T>> {
        let estimate = self.estimate()?;
        let Stage::Fine { filter, .. } = &self.stage else {
            return None;
        };
        let solution = filter.solution();
        Some(AlignmentResult {
            estimate,
            v_n: solution.v_n,
            corrections: solution.corrections,
            rotor_in_s: filter.rotor_in_s(&solution),
            alpha: self.alpha,
        })
    }

    /// Angle random walk of the gyros that the fine filter uses, rad/√s, where it was measured to be clearly more than the
    /// configured one.
    pub fn measured_walk(&self) -> Option<T> {
        let Stage::Fine { filter, .. } = &self.stage else {
            return None;
        };
        let used = filter.config().noise.angle_random_walk;
        (used > self.config.filter.noise.angle_random_walk).then_some(used)
    }

    /// What has been found of the gyro error that is constant in the housing; `None` before the loop is closed, and while the
    /// innovations do not fit or another heading may be the right one.
    pub fn deviation(&self) -> Option<Deviation<T>> {
        match &self.stage {
            Stage::Fine {
                filter,
                rival: None,
                consistency,
                replay: Replay::Live,
                ..
            } if consistency.holds() => filter.deviation(),
            _ => None,
        }
    }

    /// Says what is known of the gyro error that is constant in the housing, and starts anew. What cannot be is not taken.
    pub fn set_deviation(&mut self, deviation: Option<Deviation<T>>) {
        self.config.filter.deviation = deviation.filter(Deviation::is_valid);
        self.start_anew();
    }

    /// Sets the place and starts anew.
    ///
    /// # Errors
    /// [`EarthError`] where it cannot be; nothing has changed then.
    pub fn set_place(&mut self, latitude: T, height: T) -> Result<(), EarthError> {
        self.earth = Earth::new(latitude, height)?;
        self.config.latitude = latitude;
        self.config.height = height;
        self.start_anew();
        Ok(())
    }

    /// The last innovation of the fine filter, and the running mean of innovation²/variance per component.
    pub fn innovation(&self) -> Option<(Innovation<T>, T)> {
        let Stage::Fine { consistency, .. } = &self.stage else {
            return None;
        };
        consistency.last.map(|last| (last, consistency.ratio))
    }

    /// The figures it runs on.
    pub fn config(&self) -> &AlignerConfig<T, B> {
        &self.config
    }

    /// Earth at the configured place.
    pub fn earth(&self) -> &Earth<T> {
        &self.earth
    }
}

/// An aligner of any size in the target's precision, for those who only run it.
pub trait Align {
    /// [`Aligner::step`].
    fn step(&mut self, sample: &Sample, alpha: f32) -> Option<Event>;
    /// [`Aligner::mode`].
    fn mode(&self) -> Mode;
    /// [`Aligner::estimate`].
    fn estimate(&self) -> Option<Estimate>;
    /// [`Aligner::not_ready`].
    fn not_ready(&self) -> Option<NotReady>;
    /// [`Aligner::alignment_result`].
    fn alignment_result(&self) -> Option<AlignmentResult>;
    /// [`Aligner::start_anew`].
    fn start_anew(&mut self);
    /// [`Aligner::deviation`].
    fn deviation(&self) -> Option<Deviation>;
    /// [`Aligner::set_deviation`].
    fn set_deviation(&mut self, deviation: Option<Deviation>);
    /// [`Aligner::set_place`].
    ///
    /// # Errors
    /// [`EarthError`].
    fn set_place(&mut self, latitude: f32, height: f32) -> Result<(), EarthError>;
    /// [`Aligner::earth`].
    fn earth(&self) -> &Earth;
    /// Heading 1σ below which the unit calls itself aligned, rad.
    fn ready_heading_sd(&self) -> f32;
}

impl<const B: usize, const N: usize> Align for Aligner<f32, B, N> {
    fn step(&mut self, sample: &Sample, alpha: f32) -> Option<Event> {
        self.step(sample, alpha)
    }

    fn mode(&self) -> Mode {
        self.mode()
    }

    fn estimate(&self) -> Option<Estimate> {
        self.estimate()
    }

    fn not_ready(&self) -> Option<NotReady> {
        self.not_ready()
    }

    fn alignment_result(&self) -> Option<AlignmentResult> {
        self.alignment_result()
    }

    fn start_anew(&mut self) {
        self.start_anew();
    }

    fn deviation(&self) -> Option<Deviation> {
        self.deviation()
    }

    fn set_deviation(&mut self, deviation: Option<Deviation>) {
        self.set_deviation(deviation);
    }

    fn set_place(&mut self, latitude: f32, height: f32) -> Result<(), EarthError> {
        self.set_place(latitude, height)
    }

    fn earth(&self) -> &Earth {
        self.earth()
    }

    fn ready_heading_sd(&self) -> f32 {
        self.config.ready_heading_sd
    }
}

impl Aligner {
    /// [`Aligner::new_in`]; not generic, see [`as_align`](Self::as_align).
    ///
    /// # Errors
    /// [`AlignerError`] says which figure is out of range.
    #[inline(never)]
    pub fn place(place: &mut MaybeUninit<Self>, config: AlignerConfig) -> Result<&mut Self, AlignerError> {
        Self::new_in(place, config)
    }

    /// The unit's aligner, as one that is run. Not generic, and so compiled with this crate: an image that is built for
    /// size still has its mathematics built for speed.
    #[inline(never)]
    pub fn as_align(&mut self) -> &mut dyn Align {
        self
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rotor::Schedule;

    /// A covariance that leaves the range of `f32` is found at the first measurement, and nothing of it is reported.
    #[test]
    fn an_unsound_covariance_starts_anew() {
        let rotor = RotorConfig::<f32>::default();
        let mut filter = FilterConfig::<f32>::default();
        filter.noise.angle_random_walk = 1e19;
        let config = AlignerConfig::<f32>::for_rotor(0.7, 0.0, &rotor, filter);
        let mut aligner = Aligner::<f32>::new(config).unwrap();
        let sample = Sample {
            dtheta_s: Vec3::new(0.0, 0.0, 0.0035),
            dv_s: Vec3::new(0.0, 0.0, 0.098),
            dt: 0.01,
            gap: 0.0,
        };
        let mut begun = false;
        let restarted = (0..8_000).find_map(|k| {
            let event = aligner.step(&sample, 0.0035 * k as f32);
            begun |= matches!(event, Some(Event::CoarseDone { .. }));
            assert!(!matches!(event, Some(Event::CaughtUp | Event::Aligned)));
            event.filter(|event| matches!(event, Event::Restarted(_)))
        });
        assert_eq!(restarted, Some(Event::Restarted(Restart::Diverged)));
        assert!(begun && aligner.estimate().is_none());
    }

    #[test]
    fn a_refused_measurement_does_not_look_like_a_good_one() {
        let innovation = |nis, refused| Innovation {
            residual: Vec3::zero(),
            nis,
            fading: 1.0,
            refused,
            surprisal: 0.0,
        };
        let mut consistency = Consistency::<f64>::new();
        consistency.push(innovation(30.0, false));
        let ratio = consistency.ratio;
        consistency.push(innovation(0.0, true));
        assert_eq!(consistency.ratio, ratio);
        assert!(consistency.last.is_some_and(|last| last.refused));
    }

    fn rate(x: f64) -> Vec3<Sensor, f64> {
        Vec3::new(x, 0.0, 0.0)
    }

    #[test]
    fn a_bridge_misses_what_is_not_a_straight_line() {
        // 1 rad/s², samples of 10 ms about −5, and after a gap of 20 ms about 25 ms.
        assert!(bridging_error(Some(rate(-0.015)), rate(-0.005), rate(0.025), 0.01, 0.02) < 1e-15);
        // The acceleration turns round in the gap: e = 0.06 rad/s, missed by an eighth of that for 20 ms.
        let corner = bridging_error(Some(rate(-0.015)), rate(-0.005), rate(-0.035), 0.01, 0.02);
        assert!((corner - 0.06 * 0.02 / 8.0).abs() < 1e-15, "{corner}");
        // With no past, half of the change.
        assert!((bridging_error(None, rate(0.0), rate(0.1), 0.01, 0.02) - 0.001).abs() < 1e-15);
    }

    /// A long gap while the filter goes over its queue: it would be taken for none there. Short ones are bridged.
    #[test]
    fn what_waits_for_the_replay_has_no_long_gaps() {
        let (dt, earth) = (0.01, Earth::new(0.7, 0.0).unwrap());
        let c_nb = Rot::<Nav, Body, f64>::from_yaw_pitch_roll(0.4, 0.01, -0.02);
        let schedule = Schedule::new(RotorConfig::default()).unwrap();
        let config = AlignerConfig::for_rotor(0.7, 0.0, &RotorConfig::default(), FilterConfig::default());
        for (gap, bridged) in [(0.03, true), (0.04, false)] {
            let mut aligner = Aligner::<f64>::new(config).unwrap();
            let mut t = 0.0;
            let mut step = |aligner: &mut Aligner<f64>, gap| {
                t += gap + dt;
                let (from, to) = (schedule.at(t - dt).angle, schedule.at(t).angle);
                let c_sn = (c_nb * Rot::about_z(0.5 * (from + to))).inverse();
                let sample = Sample {
                    dtheta_s: Vec3::new(0.0, 0.0, to - from) + c_sn * earth.w_ie_n() * dt,
                    dv_s: c_sn * earth.g_n() * -dt,
                    dt,
                    gap,
                };
                aligner.step(&sample, to)
            };
            while aligner.mode() != Mode::CatchingUp {
                step(&mut aligner, 0.0);
            }
            let event = step(&mut aligner, gap);
            let restarted = matches!(event, Some(Event::Restarted(Restart::Gap { .. })));
            assert_eq!(restarted, !bridged, "{gap}: {event:?}");
        }
    }

    #[test]
    fn config_errors_name_the_figure() {
        let good = AlignerConfig::for_rotor(0.7_f32, 0.0, &RotorConfig::default(), FilterConfig::default());
        let refused = |config| Aligner::<f32>::new(config).err();
        assert_eq!(refused(good), None);
        assert_eq!(
            refused(AlignerConfig { latitude: 1.56, ..good }),
            Some(AlignerError::Earth(EarthError::Latitude))
        );
        assert_eq!(
            refused(AlignerConfig {
                t_k2: good.t_k1,
                ..good
            }),
            Some(AlignerError::Times)
        );
        assert_eq!(
            refused(AlignerConfig {
                decimate_to: 0.0,
                ..good
            }),
            Some(AlignerError::Times)
        );
        assert_eq!(
            refused(AlignerConfig {
                settle: f32::NAN,
                ..good
            }),
            Some(AlignerError::Times)
        );
        let queue = refused(AlignerConfig {
            decimate_to: 0.02,
            ..good
        });
        assert!(
            matches!(
                queue,
                Some(AlignerError::Queue {
                    needed: 2700..2800,
                    capacity: 1200
                })
            ),
            "{queue:?}"
        );
    }
}
