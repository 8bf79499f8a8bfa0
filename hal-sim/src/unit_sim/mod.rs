//! The whole unit: the application's tasks on simulated devices, buses and motor, in virtual time.
//!
//! ```text
//!  truth (swing, sway) ──┐                              ┌── plant: motor, friction, cogging, cable ◄── PWM, enable
//!                        ├─► mean over a sample ─► errors ─► ADIS16495 ─ SPI, data-ready ─► app::sampling
//!  plant: rotor angle ───┘                              └─► MT6835 ──── SPI ─────────────► app::motor
//! ```
//!
//! The rotor's angle is the plant's, which the application's motor loop drives; the motion the IMU sees is composed of
//! the truth's swing and that angle. The base's angular acceleration acts back on the rotor by its inertia.
//!
//! | bus | figure |
//! |---|---|
//! | IMU | DEC_RATE 20: 202.4 samples a second; SPI 4 MHz, 20 µs from its end to the task |
//! | encoder | 1000 readings a second; SPI 8 MHz, 20 µs |
//! | PWM | 20 kHz |
//! | serial port | 115200 baud, 1024 bytes ahead of the line |
//! | watchdog | 100 ms |
//!
//! Tasks cost processor time: 40 µs a poll of the motor's loop, 20 µs for sampling, 150 µs for alignment, 10 µs for
//! supervision, 50 µs for the serial port. Not modelled: the 11 ms of a replay step, delays inside the devices but for the IMU's.

pub mod fault;
mod model;
mod record;
mod session;
mod world;

use core::cell::{Cell, RefCell};
use std::rc::Rc;

use app::alignment::{self, AlignmentConfig};
use app::blackbox::BlackBox;
use app::command::ModeName;
use app::console;
use app::fault::{Fault, Task};
use app::hal::{ChangeOver, ClockSource, Edge, EdgeCapture, MagneticEncoder, ResetCause, Supply};
use app::mode::Status;
use app::motor::{self, Drive};
use app::output::{self, Port};
use app::report;
use app::rotor::{self, HomeSwitch, Homing, Rotor};
use app::sampling::{self, SamplingConfig};
use app::settings::{self, HARMONICS, OutputConfig, Settings, Store};
use app::shared::{Navigation, Shared};
use app::supervisor::{self, SupervisorConfig};
use drivers::adis16495;
use drivers::harmonics::{Harmonic, Harmonics};
use drivers::motor::MotorDriver;
use drivers::mt6835;
use embassy_futures::select::{Either, Either3, select, select3};
use embassy_time::{Delay, Duration};
use nav::aligner::{Aligner, AlignerConfig, AlignerError, NotReady};
use nav::fine::FilterConfig;
use nav::increment::Sample;
use nav::mechanization::Radii;
use nav::model::{PAPER, ROBUST};
use nav::navigator::Track;
use serde::Serialize;
use vtime::{Executor, Failure, Level, LocalRawMutex, TaskId, now_ns, sleep_until_ns};

use crate::align::{self, Angles, Method, Reading, Setup};
use crate::bus::{
    DataReady, Input, Line as Wire, Part, PwmSink, SpiFaults, SpiPort, SpiTiming, UartConfig, UartLine, pwm, uart,
};
use crate::config::Violation;
use crate::device;
use crate::scenario::Scenario;
use crate::sensors::{Measured, Stream, stream};
use crate::truth::Truth;

use fault::Breakable;
pub use model::{SensorSampler, UnitModel, motion};
pub use record::Line;
use session::{Outbox, Ram};
pub use session::{RobustSession, Session, Watched};
use world::World;

/// Of the unit's program.
const VERSION: &str = env!("CARGO_PKG_VERSION");
/// Longest start of a unit: when it has not begun to align by then, the run's time begins.
const START_LIMIT_S: f64 = 60.0;
/// The watchdog's time, ns.
const WATCHDOG_NS: u64 = 100_000_000;

const IMU_HZ: u32 = 4_000_000;
const ENCODER_HZ: u32 = 8_000_000;
const DMA_LATENCY_NS: u32 = 20_000;
const PWM_PERIOD_NS: u64 = 50_000;

type Bus = Shared<LocalRawMutex>;

/// Why a unit cannot be simulated.
#[derive(Debug, Clone, PartialEq)]
pub enum UnitError {
    /// The scenario has a figure out of range.
    Scenario(Violation),
    /// The aligner refuses its configuration.
    Aligner(AlignerError),
    /// The rotor's control refuses the scenario's rotor.
    Rotor(rotor::ConfigError),
    /// The unit's program hangs or panics.
    Program(Failure),
}

impl core::fmt::Display for UnitError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            Self::Scenario(e) => e.fmt(f),
            Self::Aligner(e) => e.fmt(f),
            Self::Rotor(e) => write!(f, "rotor: {e}: `run` simulates the core alone"),
            Self::Program(e) => write!(f, "the unit's program: {e:?}"),
        }
    }
}

impl core::error::Error for UnitError {}

impl From<Violation> for UnitError {
    fn from(e: Violation) -> Self {
        Self::Scenario(e)
    }
}

/// A mode with the time it was entered.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct ModeAt {
    /// Time since power-up, s.
    pub t_s: f64,
    /// The mode.
    pub mode: &'static str,
}

/// A fault as the unit found it.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct FaultFound {
    /// When it was found, s since power-up.
    pub t_s: f64,
    /// Its kind.
    pub name: &'static str,
    /// Its facts.
    pub text: String,
    /// Whether it stays.
    pub latched: bool,
    /// From being found to the motor off, ms; zero where it was off already.
    pub motor_off_ms: f64,
    /// The longest time to find it that its rule allows, ms.
    pub allowed_ms: u32,
}

/// The estimate beside the truth.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct UnitMoment {
    /// Time since power-up, s.
    pub t_s: f64,
    /// What the unit says.
    pub reading: Reading,
    /// True attitude of the housing.
    pub truth: Angles,
    /// `reading − truth`.
    pub error: Angles,
    /// Where it has navigated to.
    pub track: Option<Drift>,
}

/// What navigation has come to on a base that stays about where it is.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Drift {
    /// Speed over ground, m/s.
    pub speed_m_s: f64,
    /// East and north of the place of the alignment, m.
    pub east_m: f64,
    /// See `east_m`.
    pub north_m: f64,
}

/// What became of the samples.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize)]
pub struct Samples {
    /// Received.
    pub received: u32,
    /// Lost, by the IMU's count.
    pub lost: u32,
    /// Repeated, and left out.
    pub repeated: u32,
    /// Transfers that failed.
    pub transfers: u32,
    /// Dropped because the alignment did not keep up.
    pub overruns: u32,
    /// With a sensor at the end of its range.
    pub saturated: u32,
    /// Edges that the simulator lost between the first and the last that the unit got.
    pub edges_lost: u64,
}

/// How a run of the unit ended. In JSON it has the keys of an [`Outcome`](crate::outcome::Outcome) besides.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct UnitResult {
    /// Scenario by name.
    pub scenario: String,
    /// Seed of the run.
    pub seed: u64,
    /// The fine filter.
    pub method: Method,
    /// `aligned`, or the mode.
    #[serde(skip)]
    pub state: &'static str,
    /// Why the last estimate is not to be relied on.
    #[serde(skip)]
    pub not_ready: Option<NotReady>,
    /// Length of the run from power-up, s.
    #[serde(skip)]
    pub t_s: f64,
    /// When the alignment began, s.
    pub aligning_at_s: Option<f64>,
    /// When it first was aligned, s.
    #[serde(skip)]
    pub aligned_at_s: Option<f64>,
    /// Modes in order.
    pub modes: Vec<ModeAt>,
    /// Faults in order.
    pub faults: Vec<FaultFound>,
    /// Resets of the unit.
    pub resets: u32,
    /// Samples since the last reset.
    pub samples: Samples,
    /// Whether the cable was wound past what it bears.
    pub wound_past: bool,
    /// The last estimate.
    #[serde(rename = "final")]
    pub last: Option<UnitMoment>,
    /// The same by the core alone, on the same motion and sensor errors without devices, buses and tasks: exact times,
    /// no sample lost, true rotor angle.
    pub core: Option<UnitMoment>,
    /// The settings it ran on at its end.
    #[serde(skip)]
    pub settings: Settings,
    /// Hash of everything that happened on tasks and wires.
    pub trace: u64,
}

/// A line that someone types to the unit.
#[derive(Debug, Clone, PartialEq)]
pub struct Typed {
    /// When, s since power-up.
    pub at_s: f64,
    /// The line without its end.
    pub text: String,
}

impl core::str::FromStr for Typed {
    type Err = String;

    /// Of a time, s, a blank, and the line: `12.5 set latitude 40.1`.
    fn from_str(text: &str) -> Result<Self, String> {
        let typed = || {
            let (at, line) = text.trim().split_once(' ')?;
            let at_s = at.parse().ok().filter(|at| (0.0..1e9).contains(at))?;
            Some(Self {
                at_s,
                text: line.trim().to_owned(),
            })
        };
        typed().ok_or_else(|| format!("expected seconds and a line, as in \"12.5 set latitude 40.1\", not {text:?}"))
    }
}

/// What a run is told while it goes.
pub trait Observer {
    /// The unit has written a line to its log.
    fn line(&mut self, _line: &Line) {}
    /// A line has come from its serial port.
    fn sentence(&mut self, _line: &UartLine) {}
    /// It has put out an estimate.
    fn estimate(&mut self, _navigation: &Navigation) {}
    /// Virtual time has come so far, s.
    fn time(&mut self, _t_s: f64) {}
    /// How much virtual time passes from one look to the next, µs: less for somebody who takes part.
    fn look_us(&self) -> u64 {
        1_000_000
    }
    /// What somebody has typed since the last look: bytes as they come, on top of what is typed at its time.
    fn typed(&mut self) -> Vec<u8> {
        Vec::new()
    }
}

/// Nobody looks.
impl Observer for () {}

/// The core alone, beside the unit.
struct Core<const B: usize> {
    aligner: Aligner<f32, B>,
    last: Option<Navigation>,
}

impl<const B: usize> Core<B> {
    fn new(config: AlignerConfig<f32, B>) -> Result<Self, UnitError> {
        Ok(Self {
            aligner: Aligner::new(config).map_err(UnitError::Aligner)?,
            last: None,
        })
    }

    fn take(&mut self, t_us: u64, measured: &Measured, dt: f64, alpha: f64) {
        let sample = Sample {
            dtheta_s: measured.dtheta_s,
            dv_s: measured.dv_s,
            dt,
            gap: 0.0,
        };
        self.aligner.step(&align::cast(&sample), alpha as f32);
        // An estimate now and then: the last one before the end is compared.
        if t_us.is_multiple_of(16) {
            self.last = Some(Navigation {
                t_us,
                mode: self.aligner.mode(),
                estimate: self.aligner.estimate(),
                deviation: None,
                not_ready: None,
                track: None,
            });
        }
    }
}

/// What is seen of the unit from outside.
#[derive(Default)]
struct Record {
    modes: Vec<ModeAt>,
    faults: Vec<FaultFound>,
    last: Option<Navigation>,
    aligning_at_us: Option<u64>,
    aligned_at_s: Option<f64>,
    lines: Vec<Line>,
    sentences: Vec<UartLine>,
    estimates: Vec<Navigation>,
}

/// The supply of the unit's part. The default is a sound one.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Supplied {
    /// Too low to write flash.
    pub low: bool,
    /// The brown-out level is too low to cut off a save.
    pub unguarded: bool,
}

/// It, in the unit's hands.
struct Rail(Rc<Cell<Supplied>>);

impl Supply for Rail {
    fn is_enough(&mut self) -> bool {
        !self.0.get().low
    }

    fn is_guarded(&self) -> bool {
        !self.0.get().unguarded
    }
}

/// Data-ready with its stamp, as an EXTI interrupt gives it.
struct Ready {
    input: Input,
    line: Wire,
    lost: Rc<Cell<LostEdges>>,
}

/// Edges that the line had lost when the unit was told its first and its last one.
#[derive(Debug, Clone, Copy, Default)]
struct LostEdges {
    first: Option<u64>,
    last: u64,
}

impl EdgeCapture for Ready {
    async fn edge(&mut self) -> Edge {
        let stamp = self.input.rising().await;
        let (lost, mut seen) = (self.line.lost(), self.lost.get());
        // Of an edge that waited the stamp is older: it was not served.
        if stamp.at_ns + 1000 > now_ns() {
            seen.first.get_or_insert(lost);
            seen.last = lost;
            self.lost.set(seen);
        }
        Edge {
            t_us: stamp.instant().as_micros(),
            overrun: u32::try_from(stamp.overrun).unwrap_or(u32::MAX),
        }
    }
}

/// Devices, wires and physics: what outlives a reset of the unit.
struct Bench<const B: usize> {
    world: World,
    imu: Part<device::Adis16495>,
    encoder: Part<device::Mt6835>,
    ready: Wire,
    lost: Rc<Cell<LostEdges>>,
    timer: RefCell<Option<PwmSink>>,
    rotor: rotor::Config,
    filter: FilterConfig<f32, B>,
    sampling: SamplingConfig,
    tasks: Rc<RefCell<Vec<TaskId>>>,
    shared: Rc<RefCell<Rc<Bus>>>,
    reset: Rc<Cell<Option<ResetCause>>>,
    record: Rc<RefCell<Record>>,
    flash: device::flash::Flash,
    ram: Ram,
    outbox: Rc<Outbox>,
    /// Hangs from the start on.
    hangs_at_start: Cell<Option<Task>>,
    /// Whether the supply is too low to write flash, and whether a brown-out level would cut off a save.
    supply: Rc<Cell<Supplied>>,
    /// What the board says its clock goes by.
    clock: Cell<ClockSource>,
    /// What the unit was built with: holds where its flash says nothing else.
    factory: Cell<Settings>,
    typed: Vec<Typed>,
    seed: u64,
}

/// The timer in the hands of the unit that runs; it goes back to the bench with a reset.
struct Timer<const B: usize>(Rc<Bench<B>>, Option<PwmSink>);

impl<const B: usize> drivers::motor::ThreePhase for Timer<B> {
    fn set_duties(&mut self, duties: [drivers::motor::Duty; 3]) {
        if let Some(timer) = &mut self.1 {
            timer.set_duties(duties);
        }
    }

    fn outputs_off(&mut self) {
        if let Some(timer) = &mut self.1 {
            timer.outputs_off();
        }
        let world = &self.0.world;
        // The plant learns of it at the next look: now.
        world.now(|physics| physics.note(now_ns()));
    }
}

impl<const B: usize> Drop for Timer<B> {
    fn drop(&mut self) {
        *self.0.timer.borrow_mut() = self.1.take();
    }
}

/// Runs the unit in a scenario until it has aligned for the scenario's duration, resets and retries included.
///
/// # Errors
/// [`UnitError`] where the scenario is no unit's, or the program hangs.
pub fn run(
    scenario: &Scenario,
    seed: u64,
    method: Method,
    observer: &mut dyn Observer,
) -> Result<UnitResult, UnitError> {
    run_session(scenario, seed, method, &[], observer)
}

/// The same while someone types, in any order of lines; one that is typed before the one ahead of it has gone waits.
///
/// # Errors
/// [`UnitError`] where the scenario is no unit's, or the program hangs.
pub fn run_session(
    scenario: &Scenario,
    seed: u64,
    method: Method,
    typed: &[Typed],
    observer: &mut dyn Observer,
) -> Result<UnitResult, UnitError> {
    match method {
        Method::Kf | Method::Stf => run_with::<PAPER>(scenario, seed, method, typed, observer),
        Method::Robust | Method::RobustKf => run_with::<ROBUST>(scenario, seed, method, typed, observer),
    }
}

fn run_with<const B: usize>(
    scenario: &Scenario,
    seed: u64,
    method: Method,
    typed: &[Typed],
    observer: &mut dyn Observer,
) -> Result<UnitResult, UnitError> {
    let mut session = Session::<B>::new(scenario, seed, method, typed)?;
    let duration_us = (scenario.run.duration_s * 1e6) as u64;
    let limit_us = (START_LIMIT_S * 1e6) as u64;
    loop {
        let end_us = session.aligning_at_us().unwrap_or(limit_us).saturating_add(duration_us);
        let now_us = session.now_us();
        if now_us >= end_us {
            return Ok(session.result());
        }
        let look_us = observer.look_us().max(1);
        let next_us = (now_us / look_us + 1) * look_us;
        session.run_until_us(next_us.min(end_us), observer)?;
        let bytes = observer.typed();
        if !bytes.is_empty() {
            session.send(&bytes);
        }
    }
}

fn moment(navigation: &Navigation, truth: &Truth, start: &settings::Position) -> Option<UnitMoment> {
    let reading = Reading::from_estimate(navigation.estimate.as_ref()?);
    let t_s = navigation.t_us as f64 * 1e-6;
    let truth = Angles::from_attitude(&truth.attitude(t_s));
    Some(UnitMoment {
        t_s,
        reading,
        truth,
        error: reading.attitude.minus(&truth),
        track: navigation.track.map(|track| drift(&track, start)),
    })
}

fn drift(track: &Track, start: &settings::Position) -> Drift {
    let (sin, cos) = f64::from(start.latitude).sin_cos();
    let radii = Radii::<f64>::new(sin);
    let way = |to: f32, from: f32| f64::from(to) - f64::from(from);
    let (east, north) = (f64::from(track.v_n.x()), f64::from(track.v_n.y()));
    Drift {
        speed_m_s: east.hypot(north),
        east_m: way(track.position.longitude, start.longitude) * cos * radii.prime_vertical,
        north_m: way(track.position.latitude, start.latitude) * radii.meridian,
    }
}

/// What a unit in this scenario is made of and told.
fn bench<const B: usize>(
    scenario: &Scenario,
    seed: u64,
    method: Method,
    typed: &[Typed],
) -> Result<Bench<B>, UnitError> {
    scenario.check_for_unit()?;
    let made = UnitModel::new(scenario, seed);
    let (plant, edge) = (&made.plant, made.plant.home_edge);
    let setup = Setup::of(scenario, method);
    let told = setup.settings();
    let rotor = rotor::Config {
        encoder_zero: plant.encoder_zero as f32,
        schedule: told.motion,
        homing: Homing::HomeSwitch(HomeSwitch {
            edge: edge as f32,
            ..HomeSwitch::default()
        }),
        ..rotor::Config::default()
    };
    rotor.validate().map_err(UnitError::Rotor)?;

    let mut rows = [Harmonic::default(); HARMONICS];
    for (row, (order, amplitude, phase)) in rows.iter_mut().zip(&plant.encoder_harmonics) {
        *row = Harmonic {
            order: *order,
            amplitude: *amplitude as f32,
            phase: *phase as f32,
        };
    }
    // What the scenario adds is not in the unit's table: it is what the calibration has left.
    let harmonics = made.harmonics(scenario);
    let (timer, monitor) = pwm(PWM_PERIOD_NS);
    let world = World::new(made.build(), monitor);

    let imu = Part::new(device::Adis16495::new(0, IMU_HZ));
    let mut model = device::Mt6835::new();
    model.set_harmonics(harmonics);
    let encoder = Part::new(model);
    let physics = world.clone();
    encoder.before(move |model: &mut device::Mt6835, ns| {
        model.set_angle(physics.at(ns, |physics| physics.plant.shaft_angle()));
    });
    let aligner = setup.config::<f32, B>();
    Aligner::<f32, B>::new(aligner).map_err(UnitError::Aligner)?;
    let factory = Settings {
        encoder: settings::Encoder {
            zero: rotor.encoder_zero,
            electrical_offset: None,
            correction: Harmonics::new(rows).unwrap_or_default(),
        },
        ..told
    };
    let mut typed = typed.to_vec();
    typed.sort_by(|a, b| a.at_s.total_cmp(&b.at_s));
    Ok(Bench {
        world,
        imu,
        encoder,
        ready: Wire::new(false),
        lost: Rc::default(),
        timer: RefCell::new(Some(timer)),
        rotor,
        filter: aligner.filter,
        sampling: SamplingConfig {
            edge_delay_us: scenario.buses.edge_delay_us.round() as i32,
            ..SamplingConfig::default()
        },
        tasks: Rc::default(),
        shared: Rc::new(RefCell::new(Rc::new(Bus::new(VERSION, factory)))),
        flash: device::flash::Flash::new(seed).awaited(),
        ram: Ram::garbage(seed),
        outbox: Rc::default(),
        hangs_at_start: Cell::default(),
        supply: Rc::default(),
        clock: Cell::default(),
        factory: Cell::new(factory),
        typed,
        reset: Rc::default(),
        record: Rc::default(),
        seed,
    })
}

/// Physics, IMU clock, watchdog and faults.
fn spawn_world<const B: usize>(
    executor: &mut Executor<'_>,
    bench: &Rc<Bench<B>>,
    truth: &Rc<Truth>,
    core: &Rc<RefCell<Core<B>>>,
    scenario: &Scenario,
    seed: u64,
) {
    let ready = DataReady {
        delay_us: scenario.buses.edge_delay_us,
        jitter_sd_us: scenario.buses.edge_jitter_us,
        late_us: scenario.errors.imu_delay_us(),
        loss: scenario.buses.edge_loss,
        ..DataReady::default()
    };
    let world = bench.world.clone();
    let mut sampler = SensorSampler::new(scenario, seed, truth);
    let (core, record) = (Rc::clone(core), Rc::clone(&bench.record));
    let exposed = move |from_us: u64, to_us: u64| {
        let (from_us, to_us) = (from_us.min(to_us.saturating_sub(1)), to_us);
        let (t0, t1) = (from_us as f64 * 1e-6, to_us as f64 * 1e-6);
        let dt = t1 - t0;
        world.now(|physics| {
            let (from, to) = (physics.rotor_at(from_us * 1000), physics.rotor_at(to_us * 1000));
            let measured = sampler.sample((t0, from), (t1, to), &mut physics.plant);
            if record.borrow().aligning_at_us.is_some() {
                core.borrow_mut().take(to_us, &measured, dt, to.angle);
            }
            motion(&measured, dt)
        })
    };
    executor.spawn(
        "IMU",
        Level::World,
        ready.run(
            bench.imu.clone(),
            bench.ready.clone(),
            stream(seed, Stream::DataReady),
            exposed,
        ),
    );

    let dog = Rc::clone(bench);
    executor.spawn("watchdog", Level::World, async move {
        loop {
            sleep_until_ns(now_ns() + WATCHDOG_NS / 10).await;
            // It runs from its first feeding on.
            let fed_ns = dog.world.now(|physics| physics.fed_ns);
            if fed_ns > 0 && now_ns() - fed_ns > WATCHDOG_NS {
                dog.world.now(|physics| physics.fed_ns = 0);
                dog.reset.set(Some(ResetCause::Watchdog));
                vtime::stop();
            }
        }
    });

    let steps = fault::steps(&scenario.fault);
    let mut breakable = Rc::clone(bench);
    executor.spawn("faults", Level::World, async move {
        for step in steps {
            sleep_until_ns(step.at_ns).await;
            fault::inject(&mut breakable, step.kind, step.on);
        }
    });
}

impl<const B: usize> Breakable for Rc<Bench<B>> {
    fn imu(&mut self, set: &dyn Fn(&mut device::ImuFaults)) {
        self.imu.with(|model| set(&mut model.faults));
    }

    fn encoder(&mut self, set: &dyn Fn(&mut device::EncoderFaults)) {
        self.encoder.with(|model| set(&mut model.faults));
    }

    fn plant(&mut self, set: &dyn Fn(&mut crate::plant::PlantFaults)) {
        self.world.now(|physics| {
            set(&mut physics.plant.faults);
            physics.note(now_ns());
        });
    }

    fn cut_data_ready(&mut self, cut: bool) {
        self.ready.force(cut.then_some(false));
    }

    fn stick_imu_bus(&mut self, stuck: bool) {
        self.imu.set_faults(SpiFaults {
            stuck,
            ..SpiFaults::default()
        });
    }

    fn disturb_dec_rate(&mut self, dec_rate: u16) {
        self.imu
            .with(|model| fault::write_dec_rate(model, now_ns() / 1000, dec_rate));
    }

    fn hang(&mut self, task: Task, hangs: bool) {
        if let Some(id) = self.tasks.borrow().get(task.index()) {
            id.freeze(hangs);
        }
    }

    fn reset(&mut self) {
        self.reset.set(Some(ResetCause::Pin));
        vtime::stop();
    }
}

/// Starts the unit's program.
fn boot<const B: usize>(executor: &mut Executor<'_>, bench: &Rc<Bench<B>>, cause: ResetCause) -> Result<(), UnitError> {
    let blackbox = BlackBox::start(bench.ram.clone(), cause, now_ns() / 1000);
    // As the image's main does.
    app::log::started(VERSION, blackbox.started(), bench.clock.get());
    let mut store = Store::new(bench.flash.clone());
    // Reading takes the part no time.
    let (settings, report) = embassy_futures::block_on(store.load_over(bench.factory.get()));
    app::log::settings(&report);
    app::log::supply(&Rail(Rc::clone(&bench.supply)));
    let shared = Rc::new(Bus::new(VERSION, settings));
    shared.set_clock(bench.clock.get());
    *bench.shared.borrow_mut() = Rc::clone(&shared);
    let timing = |hz| SpiTiming {
        latency_ns: DMA_LATENCY_NS,
        ..SpiTiming::at(hz)
    };

    let imu = adis16495::Adis16495::new(SpiPort::alone(&bench.imu, timing(IMU_HZ)), Delay);
    bench.lost.set(LostEdges::default());
    let edges = Ready {
        input: bench.ready.input(),
        line: bench.ready.clone(),
        lost: Rc::clone(&bench.lost),
    };
    let (config, s) = (bench.sampling, Rc::clone(&shared));
    let sampling = executor.spawn("sampling", Level::Thread, async move {
        sampling::run(&s, imu, adis16495::Config::default(), edges, config).await
    });
    sampling.set_cost(Duration::from_micros(20));

    let encoder = MagneticEncoder {
        driver: mt6835::Mt6835::new(SpiPort::alone(&bench.encoder, timing(ENCODER_HZ))),
        config: mt6835::Config::default(),
    };
    let (enable, n_fault, below, above) = bench.world.pins();
    let mut control = Box::new(Rotor::new(settings.rotor(bench.rotor)).map_err(UnitError::Rotor)?);
    let timer = bench.timer.borrow_mut().take();
    let pwm = Timer(Rc::clone(bench), timer);
    let (correction, s) = (settings.encoder.correction, Rc::clone(&shared));
    let motor = executor.spawn("motor", Level::Interrupt, async move {
        // The pins of the simulator cannot fail.
        if let Ok(driver) = MotorDriver::new(enable, n_fault) {
            let home = ChangeOver { below, above };
            let drive = Drive { driver, pwm, home };
            motor::run(&s, encoder, drive, &mut control, correction).await;
        }
    });
    motor.set_cost(Duration::from_micros(40));

    let aligner = settings.aligner(bench.filter);
    let config = AlignmentConfig::for_aligner(&aligner, &settings.motion);
    let mut aligner = Box::new(Aligner::<f32, B>::new(aligner).map_err(UnitError::Aligner)?);
    let s = Rc::clone(&shared);
    let alignment = executor.spawn("alignment", Level::Thread, async move {
        alignment::run(&s, &mut *aligner, config).await
    });
    alignment.set_cost(Duration::from_micros(150));

    let (world, s) = (bench.world.clone(), Rc::clone(&shared));
    let supervisor = executor.spawn("supervisor", Level::Thread, async move {
        supervisor::run(&s, world.clone(), world, blackbox, SupervisorConfig::default()).await
    });
    supervisor.set_cost(Duration::from_micros(10));

    let s = Rc::clone(&shared);
    let report = executor.spawn("report", Level::Thread, async move { report::run(&s).await });
    report.set_cost(Duration::from_micros(50));

    let (world, record) = (bench.world.clone(), Rc::clone(&bench.record));
    let recorder = executor.spawn("recorder", Level::World, async move {
        let (Some(mut status), Some(mut navigation)) = (shared.status.receiver(), shared.navigation.receiver()) else {
            return;
        };
        loop {
            match select(status.changed(), navigation.changed()).await {
                Either::First(status) => see(&mut record.borrow_mut(), &status, &shared, &world),
                Either::Second(navigation) => {
                    let mut record = record.borrow_mut();
                    record.last = Some(navigation);
                    record.estimates.push(navigation);
                }
            }
        }
    });
    // By the index of the task, then the others.
    let mut tasks = vec![sampling, motor, alignment, supervisor, report, recorder];
    if let Some(task) = bench.hangs_at_start.get() {
        tasks[task.index()].freeze(true);
    }
    tasks.extend(serial(executor, bench, store, settings.output));
    *bench.tasks.borrow_mut() = tasks;
    Ok(())
}

/// Starts the unit's serial port and the other end of its line. What is on the way at a reset is lost.
fn serial<const B: usize>(
    executor: &mut Executor<'_>,
    bench: &Rc<Bench<B>>,
    store: Store<device::flash::Flash>,
    config: OutputConfig,
) -> [TaskId; 3] {
    let shared = Rc::clone(&bench.shared.borrow());
    let port = Rc::new(Port::new());
    let (rx, tx, mut host) = uart(UartConfig::default(), stream(bench.seed, Stream::Serial));
    let (s, p) = (Rc::clone(&shared), Rc::clone(&port));
    let output = executor.spawn(
        "output",
        Level::Thread,
        async move { output::run(&s, &p, tx, config).await },
    );
    output.set_cost(Duration::from_micros(50));
    let (ram, rail) = (bench.ram.clone(), Rail(Rc::clone(&bench.supply)));
    let console = executor.spawn("console", Level::Thread, async move {
        console::run(&shared, &port, rx, store, ram, rail).await
    });
    console.set_cost(Duration::from_micros(20));

    let now_s = now_ns() as f64 * 1e-9;
    let typed: Vec<Typed> = bench
        .typed
        .iter()
        .filter(|typed| typed.at_s >= now_s)
        .cloned()
        .collect();
    let (record, outbox) = (Rc::clone(&bench.record), Rc::clone(&bench.outbox));
    // What was on its way in at a reset is lost.
    outbox.bytes.borrow_mut().clear();
    let host = executor.spawn("host", Level::World, async move {
        let mut typed = typed.into_iter().peekable();
        host.set_faults(outbox.faults.get());
        loop {
            let due = async {
                match typed.peek() {
                    Some(next) => sleep_until_ns((next.at_s * 1e9) as u64).await,
                    None => core::future::pending().await,
                }
            };
            match select3(host.line(), due, outbox.changed.wait()).await {
                Either3::First(line) => {
                    outbox.overruns.set(host.overruns());
                    record.borrow_mut().sentences.push(line);
                }
                Either3::Third(()) => {
                    if outbox.faults.get() != host.faults() {
                        host.set_faults(outbox.faults.get());
                    }
                    for bytes in outbox.bytes.borrow_mut().drain(..) {
                        host.send(&bytes);
                    }
                }
                Either3::Second(()) => {
                    if let Some(Typed { text, .. }) = typed.next() {
                        host.send(text.as_bytes());
                        host.send(b"\r\n");
                    }
                }
            }
        }
    });
    [output, console, host]
}

/// Notes what the unit shows of its mode.
fn see(record: &mut Record, status: &Status, shared: &Bus, world: &World) {
    let t_s = status.since_us as f64 * 1e-6;
    let mode = status.mode.as_str();
    if record.modes.last().is_none_or(|last| last.mode != mode) {
        record.modes.push(ModeAt { t_s, mode });
    }
    match status.mode {
        ModeName::Coarse => {
            record.aligning_at_us.get_or_insert(status.since_us);
        }
        ModeName::Aligned => {
            record.aligned_at_s.get_or_insert(t_s);
        }
        _ => {}
    }
    let Some(fault) = status.fault else { return };
    // Of a fault at the very start there is no such instant: the motor is not released yet.
    let found_us = match shared.inhibited_since_us() {
        0 => status.since_us,
        us => us,
    };
    let motor_off_ms = world.now(|physics| {
        let off_ns = if physics.driven() { u64::MAX } else { physics.off_ns };
        off_ns.saturating_sub(found_us * 1000) as f64 * 1e-6
    });
    record.faults.push(FaultFound {
        t_s: found_us as f64 * 1e-6,
        name: fault.name(),
        text: Fault::to_string(&fault),
        latched: status.latched,
        motor_off_ms,
        allowed_ms: fault.rule().within_ms,
    });
}
