//! The alignment task: samples in, estimates out. It calibrates the gyros and navigates as well, since it has the samples.
//!
//! While the fine filter works through its queue a sample costs a dozen filter steps and a measurement, half a
//! millisecond at 168 MHz; the bounded channel holds what comes in meanwhile.
//!
//! The calibration of the gyros is applied here, to each sample before anything else sees it, but for the calibration
//! itself. What goes into the [`record`](crate::record) is what was taken, after it.

use embassy_futures::select::{Either3, select3};
use embassy_sync::blocking_mutex::raw::RawMutex;
use embassy_time::{Duration, Timer};
use frames::units::DEG;
use frames::{Body, Vec3, math};
use nav::aligner::{self, Align, AlignerConfig, NotReady};
use nav::calibration::{Calibration, CalibrationConfig, CalibrationError, Calibrator, REST_TRAVEL};
use nav::delay::DelayEstimator;
use nav::earth::OMEGA_IE;
use nav::increment::Sample;
use nav::mechanization::{Position, Vertical};
use nav::navigator::{Navigator, NavigatorConfig};
use nav::noise::ImuNoise;
use nav::rotor::RotorConfig;

use crate::fault::Task;
use crate::log::{Alignment, CalibrationFailure, GyrosCalibrated, NavigationEnd};
use crate::mode::{Input, Job};
use crate::nmea_in::Fix;
use crate::record::Taken;
use crate::sample::TimedSample;
use crate::sample_recorder::SampleRecorder;
use crate::selftest::{Inspection, InspectionConfig};
use crate::settings::{Imu, Mounting, Position as Place, Source, Thermal};
use crate::shared::{Navigation, Shared};

/// The task checks in at least this often when no samples come.
const IDLE: Duration = Duration::from_millis(10);
/// Faster than this, m/s, a base is under way: receivers that stand say up to 0.3.
const UNDER_WAY: f32 = 0.5;
/// Consecutive fixes that must agree before they are accepted.
const SURE: u8 = 2;
/// Sentences closer to each other than this are of one instant, µs: RMC and VTG come one after the other.
pub(crate) const INSTANT_US: u64 = 80_000;
/// What a receiver has said holds for so long, µs.
const SAID_US: u64 = 3_000_000;
/// What biases must differ by from those known, to be taken with Earth's rate in them, rad/s: five times that.
const FAR_ABOVE_EARTH: f32 = (5.0 * OMEGA_IE) as f32;
/// The rotor stands once it has not moved by more than a quarter of what a rest allows for so long, s.
const STANDING: f32 = 1.0;

/// What the task does besides aligning; the aligner has its own figures.
///
/// | field | unit | zero means | sane value |
/// |---|---|---|---|
/// | `publish_every` | samples | every sample | 10: 20 a second |
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct AlignmentConfig {
    /// Samples from one estimate put out to the next. An estimate costs about as much as a filter step.
    pub publish_every: u16,
    /// What the first samples are judged by.
    pub inspection: InspectionConfig,
    /// How the gyros are calibrated; Earth's rate is put in where it is known.
    pub calibration: CalibrationConfig,
    /// How the unit navigates.
    pub navigator: NavigatorConfig,
    /// What the aligner takes the IMU for, and the rotor's schedule: for the record.
    pub noise: ImuNoise,
    /// See there.
    pub schedule: RotorConfig,
}

impl AlignmentConfig {
    /// What goes with an aligner and its rotor: calibration by 60 s at rest and by at least as long turning, forth and back
    /// as far (\[Du16\] §3.2); navigation with the height held.
    pub fn for_aligner<const B: usize>(aligner: &AlignerConfig<f32, B>, rotor: &RotorConfig) -> Self {
        let noise = &aligner.filter.noise;
        let calibration = CalibrationConfig::default();
        let pair = 2.0 * rotor.travel;
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "saturates: minutes are meant"
        )]
        let pairs = f32::from((calibration.rest * rotor.rate / pair) as u8) + 1.0;
        Self {
            publish_every: 10,
            inspection: InspectionConfig::for_imu(noise),
            calibration: CalibrationConfig {
                angle_random_walk: noise.angle_random_walk,
                instability: noise.gyro_instability_sd,
                turn: pairs * pair,
                ..calibration
            },
            navigator: NavigatorConfig {
                vertical: Vertical::Held,
                decimate_to: aligner.decimate_to,
                longest_gap: aligner.longest_gap,
                angle_random_walk: noise.angle_random_walk,
            },
            noise: *noise,
            schedule: *rotor,
        }
    }
}

/// The task's job with what belongs to it.
#[expect(
    clippy::large_enum_variant,
    reason = "there is one, in the task's own static, and no heap to put a part of it on"
)]
enum Work {
    Idle,
    Inspect(Inspection),
    Align,
    Calibrate(Calibrating),
    Navigate(Navigator),
}

impl Work {
    /// What takes the sample, and so with the calibration applied.
    fn takes(&self, sample: &TimedSample) -> Taken {
        match self {
            Self::Align if sample.is_usable() => Taken::Aligner,
            Self::Navigate(_) if sample.is_usable() => Taken::Navigator,
            _ => Taken::No,
        }
    }

    /// Whether it can do nothing with a sample that is not usable.
    fn is_choosy(&self) -> bool {
        !matches!(self, Self::Idle | Self::Inspect(_))
    }
}

/// Time of samples that are not usable, s: it is missing like that of lost ones.
#[derive(Default)]
struct Unseen(f32);

impl Unseen {
    /// Keeps the time of a sample that is not usable, and adds what was kept to the gap before one that is.
    fn pass(&mut self, sample: &mut TimedSample) {
        let usable = sample.is_usable();
        let increments = &mut sample.sample;
        if usable {
            increments.gap += core::mem::take(&mut self.0);
        } else {
            self.0 += increments.gap + increments.dt;
        }
    }
}

/// How late the samples are against the rotor's angle, while the rotor goes back and forth.
#[derive(Default)]
struct Lateness {
    estimator: DelayEstimator,
    /// The rotor's angle at the end of the sample before, rad.
    last: Option<f32>,
}

impl Lateness {
    fn take<M: RawMutex>(&mut self, shared: &Shared<M>, sample: &TimedSample) {
        let alpha = sample.alpha.filter(|_| sample.is_usable());
        let last = core::mem::replace(&mut self.last, alpha);
        let increments = &sample.sample;
        match alpha.zip(last) {
            Some((alpha, last)) if increments.gap == 0.0 => {
                let turned = math::wrap_pi(alpha - last);
                if self.estimator.push(increments.dtheta_s.z(), turned, increments.dt) {
                    let delay = self.estimator.fit();
                    shared.measure(|measured| measured.delay = delay);
                }
            }
            _ => self.estimator.interrupt(),
        }
    }
}

/// The task. The aligner is the caller's: it is 40 kB, and belongs into a static.
pub async fn run<M: RawMutex>(shared: &Shared<M>, aligner: &mut dyn Align, config: AlignmentConfig) -> ! {
    let mut work = Work::Idle;
    let mut correction = Correction::default();
    let mut mounting = Mounting::default();
    let mut unseen = Unseen::default();
    let mut lateness = Lateness::default();
    let mut recorder = SampleRecorder::new(config.noise, config.schedule, shared.settings().position());
    let mut ground = Ground::default();
    let mut doubt = Doubt::default();
    let mut since_published = 0;
    loop {
        shared.check_in(Task::Alignment);
        let sample = match select3(shared.job.wait(), shared.next_sample(), Timer::after(IDLE)).await {
            Either3::First(job) => {
                // What waits was measured before.
                shared.forget_samples();
                work = begin(shared, aligner, &mut recorder, job, &config);
                doubt = Doubt::default();
                let settings = shared.settings();
                correction = Correction {
                    imu: settings.imu,
                    thermal: settings.thermal,
                };
                mounting = settings.installation.mounting;
                unseen = Unseen::default();
                lateness.last = None;
                continue;
            }
            Either3::Second(sample) => sample,
            Either3::Third(()) => continue,
        };
        while let Ok(fix) = shared.fixes.try_receive() {
            if let Some(input) = handle_fix(
                &mut work,
                &mut *aligner,
                &mut recorder,
                &mut ground,
                &mut doubt,
                &fix,
                &shared.settings().position(),
                sample.t_us,
            ) {
                shared.tell(input);
            }
        }
        let taken = match work.takes(&sample) {
            Taken::Aligner if ground.moves(sample.t_us) => Taken::No,
            taken => taken,
        };
        let mut sample = sample;
        if work.is_choosy() {
            unseen.pass(&mut sample);
            lateness.take(shared, &sample);
        }
        if taken != Taken::No {
            sample.sample = correction.of(&sample);
        }
        recorder.take(shared, &sample, taken);
        if matches!(work, Work::Inspect(_)) {
            // Judged as it will be taken; recorded as it is.
            sample.sample = correction.of(&sample);
        }
        if let Some(input) = work_on(&mut work, aligner, &sample, taken, shared) {
            if !matches!(input, Input::Alignment(_) | Input::Rested) {
                work = Work::Idle;
            }
            shared.tell(input);
        }
        if !matches!(work, Work::Align | Work::Navigate(_)) {
            continue;
        }
        since_published += 1;
        if since_published >= config.publish_every {
            since_published = 0;
            let mut navigation = navigation(sample.t_us, &work, aligner, doubt.is_in_doubt(sample.t_us));
            if let Some(estimate) = &mut navigation.estimate {
                estimate.attitude = mounting.vehicle(&estimate.c_nb);
            }
            shared.navigation.sender().send(navigation);
        }
    }
}

fn begin<M: RawMutex>(
    shared: &Shared<M>,
    aligner: &mut dyn Align,
    recorder: &mut SampleRecorder,
    job: Job,
    config: &AlignmentConfig,
) -> Work {
    let place = shared.settings().position();
    let Place {
        latitude,
        longitude,
        height,
        ..
    } = place;
    match job {
        Job::Idle => Work::Idle,
        Job::Inspect => Work::Inspect(Inspection::new(config.inspection)),
        Job::Align => {
            let deviation = shared.settings().deviation;
            // Starts anew.
            aligner.set_deviation(deviation);
            // A place that cannot be is refused where it is set; here the one before would stay.
            let set = aligner.set_place(latitude, height);
            recorder.aligns(set.ok().map(|()| place), deviation);
            Work::Align
        }
        Job::Calibrate { aligned } => {
            let c_nb = aligner.estimate().filter(|_| aligned).map(|estimate| estimate.c_nb);
            let w_ie_b = c_nb.map(|c_nb| c_nb.inverse() * aligner.earth().w_ie_n());
            Calibrating::new(config.calibration, w_ie_b).map_or_else(
                |error| {
                    shared.tell(Input::GyrosCalibrated(Err(error.into())));
                    Work::Idle
                },
                Work::Calibrate,
            )
        }
        Job::Navigate => {
            let place = Position {
                latitude,
                longitude,
                height,
            };
            let navigator = aligner
                .alignment_result()
                .ok_or(NavigationEnd::NotAligned)
                .and_then(|from| Navigator::new(config.navigator, place, &from).map_err(|_| NavigationEnd::Lost));
            navigator.map_or_else(
                |why| {
                    shared.tell(Input::NavigationEnded(why));
                    Work::Idle
                },
                Work::Navigate,
            )
        }
    }
}

/// What a receiver of satellite navigation has said of the ground.
#[derive(Default)]
struct Ground {
    /// At how many instants in a row the base was under way.
    moving: u8,
    /// The last of them, µs.
    said_us: u64,
}

impl Ground {
    /// Whether the base has just begun to be under way.
    fn hear(&mut self, speed: f32, t_us: u64) -> bool {
        let was = self.moves(t_us);
        if speed <= UNDER_WAY {
            self.moving = 0;
        } else if self.moving == 0 || t_us.saturating_sub(self.said_us) >= INSTANT_US {
            self.moving = self.moving.saturating_add(1);
            self.said_us = t_us;
        }
        self.moves(t_us) && !was
    }

    fn moves(&self, t_us: u64) -> bool {
        self.moving >= SURE && t_us.saturating_sub(self.said_us) <= SAID_US
    }
}

/// Consecutive fixes that must agree before they are accepted against dead reckoning.
pub(crate) const AGREE: u8 = 3;
/// A fix that contradicts dead reckoning is in doubt for this long where no other follows, µs.
pub(crate) const DOUBT_US: u64 = 10_000_000;
/// How far a fix may be from dead reckoning, m and m/s, far above both σ at the start, …
const PLACE_OFF: f32 = 200.0;
const VELOCITY_OFF: f32 = 5.0;
/// … and by how much more each second since the last fix, m/s²: 1 mg, an attitude error of 1 mrad in level, …
const GROWTH: f32 = 0.01;
/// … for so long, s: 6.8 km and 11 m/s. What is further off has to be said several times, however long none was heard.
const GROWS: f32 = 600.0;
/// A latitude that is wrong by so much moves a heading by less than 0.03°, rad: 1°, see `docs/guide/tuning.md`.
const LATITUDE_OFF: f32 = DEG as f32;
/// Mean radius of Earth, m.
const EARTH: f32 = 6_371_000.0;

/// Where a base is and how it moves over ground: latitude and longitude, rad, where known, and m/s north and east.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Where {
    place: Option<[f32; 2]>,
    north_east: [f32; 2],
}

impl Where {
    /// Whether another is within `metres` and `speed`, m/s, of it; an unknown place contradicts none.
    fn is_near(&self, other: &Self, metres: f32, speed: f32) -> bool {
        let ([north, east], [other_north, other_east]) = (self.north_east, other.north_east);
        let (north, east) = (north - other_north, east - other_east);
        let apart =
            self.place
                .zip(other.place)
                .map_or(0.0, |([latitude, longitude], [other_latitude, other_longitude])| {
                    let north = latitude - other_latitude;
                    let east = math::wrap_pi(longitude - other_longitude) * math::sin_cos(latitude).1;
                    EARTH * math::sqrt(north * north + east * east)
                });
        apart <= metres && math::sqrt(north * north + east * east) <= speed
    }
}

/// Holds what a receiver says against dead reckoning: a jump is taken when several fixes agree.
#[derive(Debug, Default)]
struct Doubt {
    /// The fix that contradicted last, and when, µs.
    held: Option<(Where, u64)>,
    /// How many in a row have agreed with it, itself among them.
    agreed: u8,
    /// When a fix was taken, µs.
    taken_us: Option<u64>,
}

impl Doubt {
    /// Whether a fix at `t_us` is to be taken; `reckoned` is what dead reckoning says, `since` the time it has gone on
    /// without any fix, s.
    fn takes(&mut self, fix: &Where, reckoned: &Where, since: f32, t_us: u64) -> bool {
        let since = self
            .taken_us
            .map_or(since, |taken_us| t_us.saturating_sub(taken_us) as f32 * 1e-6)
            .min(GROWS);
        let velocity = VELOCITY_OFF + GROWTH * since;
        if fix.is_near(reckoned, PLACE_OFF + velocity * since, velocity) {
            // A velocity without a place says nothing of the place that is in doubt.
            if fix.place.is_some() || !self.is_in_doubt(t_us) {
                self.held = None;
            }
        } else {
            match self.held.filter(|(_, at_us)| t_us.saturating_sub(*at_us) <= DOUBT_US) {
                // The other sentence of the same instant.
                Some((_, at_us)) if t_us.saturating_sub(at_us) < INSTANT_US => return false,
                Some((held, at_us)) => {
                    let seconds = t_us.saturating_sub(at_us) as f32 * 1e-6;
                    let [north, east] = held.north_east;
                    let speed = math::sqrt(north * north + east * east) + VELOCITY_OFF;
                    // What a receiver says that knows no place proves none, however often.
                    let agrees =
                        fix.place != Some([0.0; 2]) && fix.is_near(&held, PLACE_OFF + speed * seconds, VELOCITY_OFF);
                    self.agreed = if agrees { self.agreed + 1 } else { 1 };
                }
                None => self.agreed = 1,
            }
            self.held = Some((*fix, t_us));
            if self.agreed < AGREE {
                return false;
            }
            self.held = None;
        }
        self.taken_us = Some(t_us);
        true
    }

    /// Whether a fix has contradicted dead reckoning, or the latitude an alignment goes by, and neither is proven.
    fn is_in_doubt(&self, t_us: u64) -> bool {
        self.held
            .is_some_and(|(_, at_us)| t_us.saturating_sub(at_us) <= DOUBT_US)
    }
}

/// What a receiver says is taken by the navigator; an alignment starts anew where the base is under way, and where the place
/// `in_force`, once the receiver's fix has become that, is another than it goes by.
#[expect(
    clippy::too_many_arguments,
    reason = "each belongs to the task, and none with another"
)]
fn handle_fix(
    work: &mut Work,
    aligner: &mut dyn Align,
    recorder: &mut SampleRecorder,
    ground: &mut Ground,
    doubt: &mut Doubt,
    fix: &Fix,
    in_force: &Place,
    t_us: u64,
) -> Option<Input> {
    let motion = fix.motion?;
    let begins = ground.hear(motion.speed, t_us);
    match work {
        Work::Align if begins => {
            aligner.start_anew();
            recorder.anew();
            Some(Input::Alignment(Alignment::UnderWay { speed: motion.speed }))
        }
        Work::Align => {
            let goes_by = recorder.place().latitude;
            let is_off = |latitude: f32| (latitude - goes_by).abs() > LATITUDE_OFF;
            let Place { latitude, height, .. } = *in_force;
            if in_force.source == Source::Gnss && is_off(latitude) && aligner.set_place(latitude, height).is_ok() {
                recorder.moves(*in_force);
                *doubt = Doubt::default();
                let latitude_deg = latitude / DEG as f32;
                return Some(Input::Alignment(Alignment::Elsewhere { latitude_deg }));
            }
            if let Some(place) = fix.place {
                let said = Where {
                    place: Some([place.latitude, place.longitude]),
                    north_east: [0.0; 2],
                };
                doubt.held = is_off(place.latitude).then_some((said, t_us));
            }
            None
        }
        Work::Navigate(navigator) => {
            let place = fix.place.map(|place| [place.latitude, place.longitude]);
            let track = navigator.track();
            let own = [track.v_n.y(), track.v_n.x()];
            let said = Where {
                place,
                // Nobody knows whither: the place alone is taken.
                north_east: motion.north_east().unwrap_or(own),
            };
            let reckoned = Where {
                place: Some([track.position.latitude, track.position.longitude]),
                north_east: own,
            };
            if doubt.takes(&said, &reckoned, navigator.time(), t_us) {
                // A place that cannot be navigated from, near a pole, is not taken; what is known goes on.
                let _ = navigator.fix(said.north_east, place);
            }
            None
        }
        _ => None,
    }
}

/// What is known of the gyros before they are aligned.
#[derive(Default)]
struct Correction {
    imu: Imu,
    thermal: Thermal,
}

impl Correction {
    /// The increments of a sample without it.
    fn of(&self, sample: &TimedSample) -> Sample {
        let mut corrected = sample.sample;
        let mut bias_s = self.thermal.bias_s(sample.temperature_c);
        if let Some(gyros) = &self.imu.calibration {
            corrected = gyros.corrected(&corrected);
            // At the temperature of the calibration its biases say all, where it has any.
            if gyros.bias_s != Vec3::zero() {
                bias_s -= self.thermal.bias_s(self.imu.temperature_c);
            }
        }
        corrected.dtheta_s -= bias_s * corrected.dt;
        corrected
    }
}

/// One sample, as [`Work::takes`] says; what the supervisor is to know of it.
fn work_on<M: RawMutex>(
    work: &mut Work,
    aligner: &mut dyn Align,
    sample: &TimedSample,
    taken: Taken,
    shared: &Shared<M>,
) -> Option<Input> {
    let increments = &sample.sample;
    match work {
        Work::Idle => None,
        Work::Inspect(inspection) => {
            let verdict = inspection.push(increments)?;
            let found = inspection.found();
            shared.measure(|measured| measured.found = Some(found));
            Some(Input::Inspected(verdict))
        }
        Work::Align if taken == Taken::No => None,
        Work::Align => {
            let event = aligner.step(increments, sample.alpha?)?;
            Some(Input::Alignment(Alignment::from(&event)))
        }
        Work::Calibrate(_) | Work::Navigate(_) if !sample.is_usable() => None,
        Work::Calibrate(calibrating) => match calibrating.step(increments, sample.alpha?) {
            Ok(Progress::None) => None,
            Ok(Progress::Rested) => Some(Input::Rested),
            Ok(Progress::Done(found)) => {
                // From rest Earth's rate is in them: far better than nothing for a cheap part, and worse for a good one.
                let found = if calibrating.earth_known {
                    found
                } else {
                    Calibration {
                        bias_sd: OMEGA_IE as f32,
                        ..found
                    }
                };
                let before = shared.settings().imu;
                let known = before.calibration.map_or(Vec3::zero(), |gyros| gyros.bias_s);
                let biases_used = calibrating.earth_known || (found.bias_s - known).norm() > FAR_ABOVE_EARTH;
                let imu = if biases_used {
                    Imu {
                        calibration: Some(found),
                        temperature_c: sample.temperature_c,
                    }
                } else {
                    // The temperature is that of the biases.
                    Imu {
                        calibration: Some(found.with_biases_of(before.calibration.as_ref())),
                        temperature_c: before.temperature_c,
                    }
                };
                shared.change(|settings| settings.imu = imu);
                Some(Input::GyrosCalibrated(Ok(GyrosCalibrated::new(&found, biases_used))))
            }
            Err(error) => Some(Input::GyrosCalibrated(Err(CalibrationFailure::from(error)))),
        },
        Work::Navigate(navigator) => {
            let stepped = navigator.step(increments, sample.alpha?);
            stepped.err().map(|error| Input::NavigationEnded(error.into()))
        }
    }
}

#[inline(never)]
fn navigation(t_us: u64, work: &Work, aligner: &dyn Align, in_doubt: bool) -> Navigation {
    let Work::Navigate(navigator) = work else {
        let estimate = aligner.estimate();
        let (mode, not_ready) = (aligner.mode(), aligner.not_ready());
        // Earth's rate stands on latitude.
        let doubted = estimate
            .filter(|_| in_doubt && not_ready.is_none())
            .map(|estimate| NotReady::HeadingSd {
                sd: estimate.sd.heading,
            });
        return Navigation {
            t_us,
            mode: doubted.map_or(mode, |_| aligner::Mode::Fine),
            estimate,
            deviation: aligner.deviation(),
            not_ready: not_ready.or(doubted),
            track: None,
        };
    };
    let estimate = navigator.estimate();
    let sd = estimate.sd.heading;
    // Attitude stands on place and velocity: what they are worth is not known while they are in doubt.
    let good = sd <= aligner.ready_heading_sd() && !in_doubt;
    Navigation {
        t_us,
        mode: if good {
            aligner::Mode::Aligned
        } else {
            aligner::Mode::Fine
        },
        estimate: Some(estimate),
        deviation: None,
        not_ready: (!good).then_some(NotReady::HeadingSd { sd }),
        track: Some(navigator.track()),
    }
}

enum Progress {
    None,
    Rested,
    Done(Calibration),
}

/// The calibration of the gyros: waits until the rotor stands, then rests, then turns.
struct Calibrating {
    calibrator: Calibrator,
    /// Time at rest that is wanted, and the turn, s and rad.
    rest: f32,
    turn: f32,
    earth_known: bool,
    phase: Phase,
}

enum Phase {
    /// The rotor comes to rest: where it was last seen to move to, rad, and for how long it has been there, s.
    Stopping {
        stand: Option<f32>,
        elapsed: f32,
    },
    Resting,
    Turning,
}

impl Calibrating {
    fn new(config: CalibrationConfig, w_ie_b: Option<Vec3<Body>>) -> Result<Self, CalibrationError> {
        Ok(Self {
            calibrator: Calibrator::new(CalibrationConfig { w_ie_b, ..config })?,
            rest: config.rest,
            turn: config.turn,
            earth_known: w_ie_b.is_some(),
            phase: Phase::Stopping {
                stand: None,
                elapsed: 0.0,
            },
        })
    }

    fn step(&mut self, sample: &Sample, alpha: f32) -> Result<Progress, CalibrationError> {
        match &mut self.phase {
            Phase::Stopping { stand, elapsed } => {
                let moved = stand.is_none_or(|stand| (alpha - stand).abs() > 0.25 * REST_TRAVEL as f32);
                if moved {
                    *stand = Some(alpha);
                    *elapsed = 0.0;
                }
                *elapsed += sample.dt + sample.gap;
                if *elapsed >= STANDING {
                    self.phase = Phase::Resting;
                }
            }
            Phase::Resting => {
                self.calibrator.rest(sample, alpha)?;
                if self.calibrator.rested() >= self.rest {
                    self.phase = Phase::Turning;
                    return Ok(Progress::Rested);
                }
            }
            Phase::Turning => {
                self.calibrator.turn(sample, alpha)?;
                if self.calibrator.turned() >= self.turn {
                    return self.calibrator.finish().map(Progress::Done);
                }
            }
        }
        Ok(Progress::None)
    }
}

#[cfg(test)]
mod tests {
    use drivers::Channels;

    use super::*;
    use crate::chance::normal;
    use crate::settings::ThermalRow;

    #[test]
    fn a_base_is_under_way_at_the_second_instant_of_a_receiver() {
        let mut ground = Ground::default();
        // RMC and VTG of a bad instant, and of a good one.
        let said = [
            (1_000_000, 2.0),
            (1_010_000, 2.0),
            (2_000_000, 0.1),
            (2_010_000, 0.1),
            (3_000_000, 2.0),
            (3_010_000, 2.0),
            (4_000_000, 2.0),
            (4_010_000, 2.0),
        ];
        let begins = said.map(|(t_us, speed)| ground.hear(speed, t_us));
        assert_eq!(begins, [false, false, false, false, false, false, true, false]);
        assert!(ground.moves(4_000_000 + SAID_US) && !ground.moves(4_000_001 + SAID_US));
    }

    #[test]
    fn a_fix_that_contradicts_dead_reckoning_is_held_until_three_agree() {
        let at = |latitude, longitude, north_east| Where {
            place: Some([latitude, longitude]),
            north_east,
        };
        let own = at(0.698, 0.0, [0.0; 2]);
        let jumped = at(0.698, 1.0, [0.0; 2]);
        for wrong in [at(0.0, 0.1, [0.0; 2]), at(0.698, 0.0, [404.0, 245.0])] {
            let mut doubt = Doubt::default();
            assert!(doubt.takes(&own, &own, 60.0, 1_000_000) && !doubt.is_in_doubt(1_000_000));
            assert!(!doubt.takes(&wrong, &own, 60.0, 2_000_000) && doubt.is_in_doubt(2_000_000));
            // A good one ends the doubt.
            assert!(doubt.takes(&own, &own, 60.0, 3_000_000) && !doubt.is_in_doubt(3_000_000));
            // So does time, where no other follows.
            assert!(!doubt.takes(&wrong, &own, 60.0, 4_000_000));
            assert!(doubt.is_in_doubt(4_000_000 + DOUBT_US) && !doubt.is_in_doubt(4_000_001 + DOUBT_US));
            // Two wrong ones that do not agree are no two.
            assert!(!doubt.takes(&jumped, &own, 60.0, 5_000_000));
            assert!(!doubt.takes(&jumped, &own, 60.0, 6_000_000));
            // The other sentence of the same instant is no third.
            assert!(!doubt.takes(&jumped, &own, 60.0, 6_010_000));
            assert!(doubt.takes(&jumped, &own, 60.0, 7_000_000) && !doubt.is_in_doubt(7_000_000));
        }
        // Null is none, however often it is said.
        let mut doubt = Doubt::default();
        let null = at(0.0, 0.0, [0.0; 2]);
        assert!((1..60).all(|s| !doubt.takes(&null, &own, 60.0, s * 1_000_000) && doubt.is_in_doubt(s * 1_000_000)));
        // A day without a fix is worth no more than ten minutes: the first one does not move it to anywhere.
        assert!(!Doubt::default().takes(&null, &own, 86_400.0, 1_000_000));
        assert!(!Doubt::default().takes(&jumped, &own, 86_400.0, 1_000_000));
        // Ten minutes without a fix are worth kilometres.
        let drifted = at(0.698 + 4_000.0 / EARTH, 0.0, [0.0; 2]);
        assert!(Doubt::default().takes(&drifted, &own, 600.0, 1_000_000));
        assert!(!Doubt::default().takes(&drifted, &own, 10.0, 1_000_000));
        // Over the date line it is near.
        let east = core::f32::consts::PI - 600.0 / EARTH;
        assert!(at(0.0, east, [0.0; 2]).is_near(&at(0.0, -east, [0.0; 2]), 1_300.0, 1.0));
    }

    /// A calibration without biases leaves those of the thermal table what they are.
    #[test]
    fn biases_are_those_of_the_calibration_or_of_the_thermal_table() {
        let row = |temperature_c, bias| ThermalRow {
            temperature_c,
            bias_s: [bias; 3],
        };
        let mut thermal = Thermal {
            used: 2,
            ..Thermal::default()
        };
        thermal.rows[..2].copy_from_slice(&[row(0.0, 1e-4), row(40.0, 3e-4)]);
        let found = |bias_s| Calibration {
            bias_s,
            k_xz: 0.0,
            k_yz: 0.0,
            s_z: 0.0,
            bias_sd: 0.0,
            column_sd: 0.0,
            scatter: 0.0,
            rest: 0.0,
            turn: 0.0,
            turned: 0.0,
        };
        let sample = TimedSample {
            t_us: 0,
            sample: Sample {
                dtheta_s: Vec3::zero(),
                dv_s: Vec3::zero(),
                dt: 0.005,
                gap: 0.0,
            },
            alpha: Some(0.0),
            temperature_c: 40.0,
            saturated: Channels::NONE,
        };
        for (calibration, bias) in [
            (None, 3e-4),
            (Some(found(Vec3::zero())), 3e-4),
            // Found at 20 °C, where the table has 2e-4.
            (Some(found(Vec3::new(5e-4, 5e-4, 5e-4))), 6e-4),
        ] {
            let imu = Imu {
                calibration,
                temperature_c: 20.0,
            };
            let corrected = Correction { imu, thermal }.of(&sample);
            assert!((corrected.dtheta_s.x() / 0.005 + bias).abs() < 1e-9, "{calibration:?}");
        }
    }

    /// Gyros with `times` the configured noise, on a base at rest. Their variance is known to 18 % from 60 blocks of a
    /// second, and the worst of three axes counts.
    fn rests(times: f32, seed: u64) -> Result<(), CalibrationError> {
        let config = CalibrationConfig::<f32> {
            w_ie_b: Some(Vec3::zero()),
            ..CalibrationConfig::default()
        };
        let dt = 0.02;
        let sd = times * config.angle_random_walk * math::sqrt(dt);
        let mut calibrator = Calibrator::new(config).unwrap();
        let mut state = seed;
        let mut noise = || sd * normal(&mut state);
        let mut sample = || Sample {
            dtheta_s: Vec3::new(noise(), noise(), noise()),
            dv_s: Vec3::new(0.0, 0.0, 9.8 * dt),
            dt,
            gap: 0.0,
        };
        for _ in 0..=3000 {
            calibrator.rest(&sample(), 0.0)?;
        }
        // The first of the turn ends the rest, and judges it.
        calibrator.turn(&sample(), 0.0)
    }

    /// Three times the noise, nine times its variance, is where the base is said to move.
    #[test]
    fn a_base_moves_from_three_times_the_noise_on() {
        for seed in 1..=20 {
            assert_eq!(rests(1.0, seed), Ok(()));
            assert_eq!(rests(2.0, seed), Ok(()));
            let Err(CalibrationError::BaseMoved { scatter }) = rests(4.0, seed) else {
                panic!("seed {seed}: no matter that it moves");
            };
            assert!((9.0..30.0).contains(&scatter), "{scatter}");
        }
    }
}
