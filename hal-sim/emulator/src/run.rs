//! A run of the image in a scenario.
//!
//! ```text
//!            ┌────────────── part (rigless): the ELF, executed ──────────────┐
//!  ADIS16495 ┤ SPI1, EXTI0                                  TIM1, PF15, PE15 ├ bridge ─► plant ─► rotor angle
//!  MT6835    ┤ SPI3                                              PF13, PF14 ├ home switch         │
//!  listener  ┤ USART3                                                        │                     │
//!            └───────────────────────────────────────────────────────────────┘      truth ─► sampler ─► ADIS16495
//! ```
//!
//! The emulator stops every [`STEP_NS`] on a fixed grid, and at the exact instants of samples, edges and faults. At a
//! stop the motor moves on by what the bridge was told at the stop before, and what it is told now holds until the next.
//! The encoder's shaft turns on between two stops.
//!
//! Unit, sensors' errors, motion and faults are those of [`hal_sim::unit_sim`] with the same seed. Different by nature:
//!
//! * the image's parameters: an encoder without an error table, whose zero is the rotor's;
//! * time: each instruction takes its share, so the alignment begins some milliseconds earlier or later;
//! * a hang: a task of an image cannot be stopped from outside, so the core stands still altogether, as in an endless
//!   loop at the highest priority;
//! * a bus that never ends a transfer: the DMA requests of its SPI are taken away.

use core::hash::{Hash as _, Hasher as _};
use core::ops::Range;
use std::collections::VecDeque;
use std::collections::hash_map::DefaultHasher;

use app::fault::Task;
use app::rotor::Side;
use app::settings::{Group, Store};
use drivers::motor::{Duty, ThreePhase as _};
use embassy_futures::block_on;
use hal_sim::align::{self, Angles, Method};
use hal_sim::device::flash::Flash;
use hal_sim::device::{Adis16495, EncoderFaults, ImuFaults, Mt6835, SensorModel as _};
use hal_sim::inspect::parser::{LogEvent, LogParser};
use hal_sim::plant::{Plant, PlantFaults};
use hal_sim::scenario::{Buses, Scenario};
use hal_sim::sensors::{Stream, stream};
use hal_sim::truth::Truth;
use hal_sim::unit_sim::fault::{self, Breakable, Step};
use hal_sim::unit_sim::{ModeAt, SensorSampler, UnitModel, motion};
use nav::rotor::RotorState;
use rand::RngExt as _;
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;
use rigless::device::{Level, ResetCause};
use rigless::emulator::{self, Access, AccessKind, Driver, Host, Settled, Start, Stop};
use rigless::session::Session;
use rigless::soc::Width;
use rigless::time::VirtualNanos;

use crate::board::{self, Board};
use crate::chips::{Encoder, Listener, Wired};
use crate::error::Error;
use crate::image::Image;
use crate::load::Meter;
use crate::log::{Line, Reader};
use crate::nmea::{self, LineEvent, Sentence, Splitter};
use crate::outcome::{Cost, FaultSeen, Gaps, Lamps, Moment, Outcome, ResetSeen, Verdict};
use crate::part::{BridgeTimer, flash};
use crate::stack::Stack;

/// The grid of stops, ns: a tenth of a tick of the motor's loop.
pub const STEP_NS: u64 = 100_000;
/// From one look at the log and the serial line to the next, ns.
const LOOK_NS: u64 = 1_000_000;
/// How long data-ready is high, ns.
const READY_NS: u64 = 50_000;
/// Samples whose ends are kept.
const KEPT: usize = 64;
/// CR2 of the IMU's SPI, with the enables of its DMA requests.
const IMU_SPI_CR2: u64 = 0x4001_3004;
/// RAM of the part: SRAM1 to 3, and CCM.
const RAM: [(u64, u64); 2] = [(0x2000_0000, 192 * 1024), (0x1000_0000, 64 * 1024)];

/// A power cut.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PowerCut {
    /// When, s.
    pub at_s: f64,
    /// For how long, s.
    pub for_s: f64,
}

/// A press of the button.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Press {
    /// When, s.
    pub at_s: f64,
    /// For how long, s.
    pub for_s: f64,
}

/// A line typed to the unit.
#[derive(Debug, Clone, PartialEq)]
pub struct Typed {
    /// When its first character begins, s.
    pub at_s: f64,
    /// The line, without CR LF.
    pub text: String,
}

/// What is run.
#[derive(Debug, Clone, PartialEq)]
pub struct Setup {
    /// The scenario with its faults. Its duration does not count.
    pub scenario: Scenario,
    /// Seed of every chance.
    pub seed: u64,
    /// Virtual length of the run, s.
    pub seconds: f64,
    /// Power cuts.
    pub power_cuts: Vec<PowerCut>,
    /// Lines typed on the serial port.
    pub typed: Vec<Typed>,
    /// Presses of the button.
    pub presses: Vec<Press>,
    /// What is in the settings' sectors, [`board::SETTINGS`], at the beginning; where nothing is said, what
    /// [`hal_sim::unit_sim`]'s unit is told of the scenario: place, rotor and IMU.
    pub flash: Option<Vec<u8>>,
    /// What drives the bridge's timer.
    pub timer: BridgeTimer,
    /// The clock that comes in from the debugger's controller, Hz; zero for none.
    pub clock_hz: u64,
    /// Supply of the part, mV.
    pub supply_mv: u32,
}

impl Setup {
    /// A run without power cuts or lines typed, by a unit that was set up for the scenario.
    pub fn new(scenario: Scenario, seed: u64, seconds: f64) -> Self {
        Self {
            scenario,
            seed,
            seconds,
            power_cuts: Vec::new(),
            typed: Vec::new(),
            presses: Vec::new(),
            flash: None,
            timer: BridgeTimer::default(),
            clock_hz: board::CRYSTAL_HZ,
            supply_mv: board::SUPPLY_MV,
        }
    }
}

/// What a run is told while it goes.
pub trait Observer: Send + 'static {
    /// The unit has written a line, or the emulator has.
    fn line(&mut self, _line: &Line) {}
    /// A sentence has come over the serial line.
    fn sentence(&mut self, _sentence: &Sentence) {}
    /// A byte has come over the serial line.
    fn serial(&mut self, _byte: u8) {}
    /// The unit's log as it is written: frames of defmt, in pieces.
    fn rtt(&mut self, _bytes: &[u8]) {}
    /// Virtual time has come so far, s.
    fn time(&mut self, _t_s: f64) {}
}

/// Nobody looks.
impl Observer for () {}

/// Runs an image.
///
/// # Errors
/// Where scenario or image cannot be used, or the emulator cannot go on.
pub fn run<O: Observer>(image: &Image, setup: &Setup, observer: O) -> Result<(Outcome, O), Error> {
    let stack = Stack::of(image)?;
    let world = World::new(image, setup, stack, observer)?;
    let mut board = Board::on(setup.clock_hz, setup.supply_mv, setup.timer)?;
    world.populate(&mut board);
    let session = Session::new(Box::new(board), 0, VirtualNanos(STEP_NS))?;
    let mut images = vec![image.file.clone(), stack.paint()?];
    images.push(match &setup.flash {
        Some(flash) => stored(flash)?,
        None => stored(&told(&setup.scenario))?,
    });
    let finished = emulator::run(session, &Start::new(&images), world)?;
    Ok(finished.driver.outcome(finished.session, image, setup))
}

/// The settings' sectors of a unit that has been set up for the scenario.
fn told(scenario: &Scenario) -> Vec<u8> {
    let settings = align::Setup::of(scenario, Method::Robust).settings();
    let flash = Flash::new(0);
    let mut store = Store::new(flash.clone());
    for group in [Group::Installation, Group::Motion, Group::Noise] {
        // A scenario beyond the ranges leaves the image its own.
        let _ = block_on(store.save(&settings, group));
    }
    flash.bytes()
}

/// What was stored before the run, as an image beside the firmware's.
fn stored(flash: &[u8]) -> Result<rigless::image::Image, Error> {
    let Range { start, end } = board::SETTINGS;
    let expected = (end - start) as usize;
    if flash.len() != expected {
        let found = flash.len();
        return Err(Error::Flash { expected, found });
    }
    Ok(rigless::image::Image::new(
        "settings".as_ref(),
        flash.to_vec(),
        Some(start),
    )?)
}

/// A power switch that moves.
#[derive(Debug, Clone, Copy)]
struct Supply {
    at_ns: u64,
    on: bool,
}

/// The unit's surroundings.
struct World<O> {
    plant: Plant,
    sampler: SensorSampler,
    truth: Truth,
    harmonics: Vec<(u16, f64, f64)>,
    /// The plant's time, ns.
    at_ns: u64,
    end_ns: u64,

    buses: Buses,
    /// What the IMU is later by than the part is made, µs.
    late_us: i64,
    ready_rng: ChaCha8Rng,
    /// Where the sample under way began, with the rotor then, and when it is planned to end, µs.
    sample_from: (u64, RotorState<f64>),
    sample_planned_us: u64,
    rise_ns: u64,
    fall_ns: u64,
    ready_cut: bool,
    /// Ends of the last samples, ns.
    ends: VecDeque<u64>,
    samples: u64,

    faults: VecDeque<Step>,
    supply: VecDeque<Supply>,
    typed: VecDeque<(u64, String)>,
    /// When the button is closed, ns.
    presses: Vec<Range<u64>>,
    powered: bool,
    bus_stuck: bool,
    hung: bool,
    resets_seen: usize,

    reader: Reader,
    parser: LogParser,
    splitter: Splitter,
    meter: Meter,
    stack: Stack,
    next_look_ns: u64,
    mode: String,
    modes: Vec<ModeAt>,
    seen: Vec<FaultSeen>,
    resets: Vec<ResetSeen>,
    last: Option<Moment>,
    travel: [f64; 2],
    /// Since the last reset nothing was heard of the unit.
    silent: bool,
    driven_after_reset: bool,
    instructions: u64,
    flash: Vec<u8>,
    hash: DefaultHasher,
    observer: O,
}

impl<O: Observer> World<O> {
    fn new(image: &Image, setup: &Setup, stack: Stack, observer: O) -> Result<Self, Error> {
        let scenario = &setup.scenario;
        scenario.check_for_unit()?;
        let truth = Truth::new(scenario, setup.seed)?;
        let mut made = UnitModel::new(scenario, setup.seed);
        // As firmware/src/params.rs has them, until the unit is calibrated.
        made.remount_encoder(0.0);
        let harmonics = made.harmonics(scenario);
        let mut plant = made.build();
        plant.outputs_off();
        plant.set_enabled(false);
        let ns = |s: f64| (s * 1e9) as u64;
        let mut supply: Vec<Supply> = Vec::new();
        for cut in &setup.power_cuts {
            for (at_s, on) in [(cut.at_s, false), (cut.at_s + cut.for_s, true)] {
                supply.push(Supply { at_ns: ns(at_s), on });
            }
        }
        supply.sort_by_key(|switch| switch.at_ns);
        let mut typed: Vec<_> = setup
            .typed
            .iter()
            .map(|line| (ns(line.at_s), line.text.clone()))
            .collect();
        typed.sort_by_key(|(at_ns, _)| *at_ns);
        let angle = plant.angle();
        Ok(Self {
            sampler: SensorSampler::new(scenario, setup.seed, &truth),
            truth,
            harmonics,
            at_ns: 0,
            end_ns: ns(setup.seconds).max(STEP_NS),
            buses: scenario.buses.clone(),
            late_us: scenario.errors.imu_delay_us(),
            ready_rng: stream(setup.seed, Stream::DataReady),
            sample_from: (0, rotor(&plant)),
            sample_planned_us: 0,
            rise_ns: u64::MAX,
            fall_ns: u64::MAX,
            ready_cut: false,
            ends: VecDeque::with_capacity(KEPT),
            samples: 0,
            faults: fault::steps(&scenario.fault).into(),
            supply: supply.into(),
            typed: typed.into(),
            presses: setup
                .presses
                .iter()
                .map(|press| ns(press.at_s)..ns(press.at_s + press.for_s))
                .collect(),
            powered: true,
            bus_stuck: false,
            hung: false,
            resets_seen: 0,
            reader: Reader::new(image)?,
            parser: LogParser::learn(),
            splitter: Splitter::default(),
            meter: Meter::default(),
            stack,
            next_look_ns: LOOK_NS,
            mode: "start".to_owned(),
            modes: Vec::new(),
            seen: Vec::new(),
            resets: Vec::new(),
            last: None,
            travel: [angle; 2],
            silent: true,
            driven_after_reset: false,
            instructions: 0,
            flash: Vec::new(),
            hash: DefaultHasher::new(),
            observer,
            plant,
        })
    }

    /// Hangs the devices on the board's wires.
    fn populate(&self, board: &mut Board) {
        let part = &mut board.part;
        let at = VirtualNanos(0);
        part.attach_spi(
            board::IMU_SPI,
            Wired::new(Adis16495::new(0, board::IMU_HZ)),
            board::IMU_SELECT,
        );
        part.attach_spi(
            board::ENCODER_SPI,
            Wired::new(Encoder {
                model: self.fresh_encoder(),
                angle: self.plant.angle(),
                at_ns: 0,
                rate: 0.0,
            }),
            board::ENCODER_SELECT,
        );
        part.attach_usart(board::SERIAL, Listener::default());
        part.drive(at, board::MOTOR_FAULT, Level::High);
        part.drive_break(at, Level::High);
    }

    fn fresh_encoder(&self) -> Mt6835 {
        let mut model = Mt6835::new();
        model.set_harmonics(self.harmonics.clone());
        model
    }

    /// The motor moves on, driven by what the bridge was told before.
    fn advance(&mut self, to_ns: u64) {
        if to_ns <= self.at_ns {
            return;
        }
        self.plant.advance((to_ns - self.at_ns) as f64 * 1e-9);
        self.at_ns = to_ns;
        let angle = self.plant.angle();
        self.travel = [self.travel[0].min(angle), self.travel[1].max(angle)];
    }

    /// The wires between board and motor.
    fn wire(&mut self, board: &mut Board, at: VirtualNanos) {
        let part = &mut board.part;
        let drive = part.bridge();
        self.plant
            .set_enabled(self.powered && part.level(board::MOTOR_ENABLE) == Level::High);
        if self.powered && drive.on {
            self.plant.set_duties(drive.duties.map(Duty::new));
        } else {
            self.plant.outputs_off();
        }
        self.driven_after_reset |= self.silent && self.plant.driven();

        let home = self.plant.home();
        part.drive(at, board::HOME_BELOW, level(home == Some(Side::Below)));
        part.drive(at, board::HOME_ABOVE, level(home == Some(Side::Above)));
        let pressed = self.presses.iter().any(|press| press.contains(&at.0));
        part.drive(at, board::BUTTON, level(pressed));
        let sound = level(!self.plant.faults.driver_fault);
        part.drive(at, board::MOTOR_FAULT, sound);
        part.drive_break(at, sound);

        let (angle, rate) = (self.plant.shaft_angle(), self.plant.rate());
        if let Some(wired) = part.spi_chip::<Wired<Encoder>>(board::ENCODER_SPI) {
            let encoder = &mut wired.device;
            (encoder.angle, encoder.rate, encoder.at_ns) = (angle, rate, at.0);
        }
    }

    /// The IMU's sample and its data-ready, where they are due.
    fn sample(&mut self, board: &mut Board, at: VirtualNanos) {
        let now_us = at.0 / 1000;
        let part = &mut board.part;
        if self.fall_ns <= at.0 {
            self.fall_ns = u64::MAX;
            part.drive(at, board::IMU_READY, Level::Low);
        }
        if self.rise_ns <= at.0 {
            self.rise_ns = u64::MAX;
            self.fall_ns = at.0 + READY_NS;
            part.drive(at, board::IMU_READY, level(!self.ready_cut));
        }
        if !self.powered {
            return;
        }
        let Some(wired) = part.spi_chip::<Wired<Adis16495>>(board::IMU_SPI) else {
            return;
        };
        let model = &mut wired.device;
        if model.next_ready_us() != self.sample_planned_us {
            // A command has begun a new series of samples.
            self.sample_planned_us = model.next_ready_us();
            self.sample_from = (now_us, rotor(&self.plant));
        }
        if self.sample_planned_us > now_us {
            return;
        }
        let (from_us, from) = self.sample_from;
        let to = rotor(&self.plant);
        // The part's filters are behind. The rotor at most 3e-7 rad off, by the acceleration of a reversal over 0.4 ms.
        let behind_us = self.late_us.saturating_add_unsigned(model.delay_us()).max(0);
        let behind = behind_us as f64 * 1e-6;
        let earlier = |us: u64, state: RotorState<f64>| {
            let angle = state.angle - state.rate * behind;
            (us as f64 * 1e-6 - behind, RotorState { angle, ..state })
        };
        let (start, end) = (earlier(from_us.min(now_us - 1), from), earlier(now_us, to));
        let measured = self.sampler.sample(start, end, &mut self.plant);
        model.set_motion(motion(&measured, end.0 - start.0));
        model.advance(now_us);
        let edges = model.take_data_ready();
        self.sample_from = (now_us, to);
        self.sample_planned_us = model.next_ready_us();
        self.samples += 1;
        if self.ends.len() == KEPT {
            self.ends.pop_front();
        }
        self.ends
            .push_back(at.0.saturating_add_signed(behind_us.saturating_mul(-1000)));

        // Drawn whether it is used or not: one sample, one draw.
        let jitter: f64 = self.ready_rng.sample(StandardNormal);
        let lost = self.ready_rng.random::<f64>() < self.buses.edge_loss;
        if edges > 0 && !lost {
            let delay_us = (self.buses.edge_delay_us + self.buses.edge_jitter_us * jitter).max(0.0);
            self.rise_ns = at.0 + (delay_us * 1000.0) as u64;
        }
    }

    /// Switches the supply.
    fn switch(&mut self, session: &mut Session<Board>, host: &mut dyn Host, at: VirtualNanos, on: bool) {
        self.powered = on;
        let board = session.board_mut();
        board.part.power(at, on);
        self.rise_ns = u64::MAX;
        board.part.drive(at, board::IMU_READY, Level::Low);
        if !on {
            return;
        }
        if let Some(wired) = board.part.spi_chip::<Wired<Adis16495>>(board::IMU_SPI) {
            let faults = wired.device.faults;
            wired.device = Adis16495::new(at.0 / 1000, board::IMU_HZ);
            wired.device.faults = faults;
        }
        let mut model = self.fresh_encoder();
        if let Some(wired) = board.part.spi_chip::<Wired<Encoder>>(board::ENCODER_SPI) {
            model.faults = wired.device.model.faults;
            wired.device.model = model;
        }
        // What RAM holds after a while without supply is anybody's guess.
        self.stack.look(host);
        let mut word = at.0 | 1;
        for (begin, length) in RAM {
            for address in (begin..begin + length).step_by(4) {
                word = word.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
                // The two regions are RAM.
                let _ = host.write(address, Width::W32, word >> 32);
            }
        }
        self.stack.repaint(host);
    }

    /// Resets since the last stop.
    fn note_resets(&mut self, session: &mut Session<Board>, host: &mut dyn Host) {
        let resets = session.resets();
        let new: Vec<_> = resets.iter().skip(self.resets_seen).copied().collect();
        self.resets_seen = resets.len();
        for reset in new {
            let cause = match reset.cause {
                ResetCause::Core => "software".to_owned(),
                ResetCause::Model(instance) => instance.to_owned(),
                ResetCause::Pin => "pin".to_owned(),
                _ => "power-on".to_owned(),
            };
            self.tell(reset.at.0, format!("-- reset: {cause} --"));
            self.resets.push(ResetSeen {
                t_s: reset.at.0 as f64 * 1e-9,
                cause,
            });
            self.reader.restart();
            self.silent = true;
            if core::mem::take(&mut self.hung) {
                host.hold(false);
            }
        }
    }

    /// A line of the emulator's own.
    fn tell(&mut self, t_ns: u64, text: String) {
        self.line(Line {
            t_ns,
            level: "host",
            text,
        });
    }

    fn line(&mut self, line: Line) {
        line.hash(&mut self.hash);
        let t_s = line.t_ns as f64 * 1e-9;
        let ours = line.level != "host";
        self.silent &= !ours;
        match self.parser.read(&line.text).filter(|_| ours) {
            Some(LogEvent::Mode(mode)) => {
                let mode = mode.as_str();
                self.mode = mode.to_owned();
                self.modes.push(ModeAt { t_s, mode });
            }
            Some(LogEvent::Fault { .. }) => self.seen.push(FaultSeen {
                t_s,
                text: line.text.clone(),
                motor_off: !self.plant.driven(),
            }),
            _ => {}
        }
        self.observer.line(&line);
    }

    fn sentence(&mut self, sentence: &Sentence) {
        (sentence.t_ns, &sentence.text).hash(&mut self.hash);
        if let Some((angles, sd)) = nmea::pashr(&sentence.text) {
            self.estimate(sentence.burst_ns, angles, sd);
        }
        if nmea::is_answer(&sentence.text) {
            self.tell(sentence.t_ns, format!("< {}", sentence.text));
        }
        self.observer.sentence(sentence);
    }

    /// An estimate that the unit began to send at `sent_ns`: it does so as soon as it has one.
    fn estimate(&mut self, sent_ns: u64, reading: Angles, sd: Angles) {
        let end = self.ends.iter().rev().find(|end| **end <= sent_ns);
        let t_s = end.copied().unwrap_or(sent_ns) as f64 * 1e-9;
        let truth = Angles::from_attitude(&self.truth.attitude(t_s));
        self.last = Some(Moment {
            t_s,
            reading,
            sd,
            truth,
            error: reading.minus(&truth),
        });
    }

    /// Log, serial line, load.
    fn look(&mut self, session: &mut Session<Board>, host: &mut dyn Host, stop: Stop) {
        let t_ns = stop.at.0;
        let t_s = t_ns as f64 * 1e-9;
        let bytes = self.reader.read(host);
        if !bytes.is_empty() {
            self.observer.rtt(&bytes);
        }
        for line in self.reader.decode(&bytes, t_ns) {
            self.line(line);
        }
        let heard = session.board_mut().part.usart_peer::<Listener>(board::SERIAL);
        for (t_ns, byte) in heard.map(Listener::take).unwrap_or_default() {
            self.observer.serial(byte);
            match self.splitter.push(t_ns, byte) {
                Some(LineEvent::Sentence(sentence)) => self.sentence(&sentence),
                Some(LineEvent::Other(text)) => self.tell(t_ns, format!("< {text}")),
                None => {}
            }
        }
        self.instructions = stop.instruction_count;
        self.meter.count(t_s, stop.instruction_count, &self.mode);
        if t_ns.is_multiple_of(1_000_000_000) {
            self.observer.time(t_s);
        }
    }

    /// The next instant at which anything is due.
    fn next(&self, at_ns: u64) -> VirtualNanos {
        let grid = (at_ns / STEP_NS + 1) * STEP_NS;
        let sample = if self.powered {
            self.sample_planned_us.saturating_mul(1000)
        } else {
            u64::MAX
        };
        let fault = self.faults.front().map_or(u64::MAX, |step| step.at_ns);
        let supply = self.supply.front().map_or(u64::MAX, |switch| switch.at_ns);
        let typed = self.typed.front().map_or(u64::MAX, |(at_ns, _)| *at_ns);
        let due = [sample, self.rise_ns, self.fall_ns, fault, supply, typed];
        let due = due.into_iter().filter(|due| *due > at_ns).min().unwrap_or(u64::MAX);
        VirtualNanos(grid.min(due).min(self.end_ns))
    }

    fn outcome(self, session: Session<Board>, image: &Image, setup: &Setup) -> (Outcome, O) {
        let mut session = session;
        let gaps = gaps(&session);
        let part = &mut session.board_mut().part;
        let mut lit = |lamp| part.level(lamp) == Level::High;
        let lamps = Lamps {
            green: lit(board::LAMP_GREEN),
            blue: lit(board::LAMP_BLUE),
            red: lit(board::LAMP_RED),
        };
        let imu = session.board_mut().part.spi_chip::<Wired<Adis16495>>(board::IMU_SPI);
        let mut outcome = Outcome {
            scenario: setup.scenario.name.clone(),
            seed: setup.seed,
            t_s: self.at_ns as f64 * 1e-9,
            verdict: Verdict::NotAligned,
            state: self.mode,
            modes: self.modes,
            faults: self.seen,
            resets: self.resets,
            last: self.last,
            lamps,
            wound_past: self.plant.wound_past(),
            travel_deg: self.travel.map(f64::to_degrees),
            driven_after_reset: self.driven_after_reset,
            samples: self.samples,
            stall_violations: imu.map_or(0, |wired| wired.device.stall_violations()),
            serial: self.splitter.received(),
            gaps,
            cost: Cost {
                load: self.meter.rows(),
                instructions: self.instructions,
                stack: self.stack,
                footprint: image.footprint().clone(),
            },
            flash: self.flash,
            trace: self.hash.finish(),
        };
        outcome.verdict = outcome.judge();
        (outcome, self.observer)
    }
}

impl<O: Observer> Driver<Board> for World<O> {
    fn on_settled(&mut self, session: &mut Session<Board>, host: &mut dyn Host, settled: Settled) {
        session.board_mut().part.correct(&settled, host);
    }

    fn on_stop(&mut self, session: &mut Session<Board>, stop: Stop, host: &mut dyn Host) -> Option<VirtualNanos> {
        let at = stop.at;
        self.advance(at.0);
        self.note_resets(session, host);
        self.wire(session.board_mut(), at);
        self.sample(session.board_mut(), at);
        while self.faults.front().is_some_and(|step| step.at_ns <= at.0) {
            let Some(step) = self.faults.pop_front() else { break };
            let mut unit = Unit {
                world: self,
                session,
                host,
                stop,
            };
            fault::inject(&mut unit, step.kind, step.on);
        }
        while self.supply.front().is_some_and(|switch| switch.at_ns <= at.0) {
            let Some(switch) = self.supply.pop_front() else { break };
            self.tell(at.0, format!("-- power {} --", if switch.on { "on" } else { "off" }));
            self.switch(session, host, at, switch.on);
        }
        while self.typed.front().is_some_and(|(at_ns, _)| *at_ns <= at.0) {
            let Some((at_ns, text)) = self.typed.pop_front() else {
                break;
            };
            if let Some(listener) = session.board_mut().part.usart_peer::<Listener>(board::SERIAL) {
                listener.type_line(at_ns, &text);
            }
            self.tell(at.0, format!("> {text}"));
        }
        if self.bus_stuck {
            let access = Access::new(AccessKind::Write, IMU_SPI_CR2, Width::W32, 0);
            session.access(access.at(stop.instruction_count, at), host);
        }
        if at.0 >= self.next_look_ns {
            self.next_look_ns = (at.0 / LOOK_NS + 1) * LOOK_NS;
            self.look(session, host, stop);
        }
        if at.0 >= self.end_ns {
            self.look(session, host, stop);
            self.stack.look(host);
            let bytes = board::SETTINGS.flat_map(|address| host.read(address, Width::W8));
            self.flash = bytes.map(|byte| byte as u8).collect();
            return None;
        }
        Some(self.next(at.0))
    }
}

/// The unit in the hands of a fault.
struct Unit<'a, O> {
    world: &'a mut World<O>,
    session: &'a mut Session<Board>,
    host: &'a mut dyn Host,
    stop: Stop,
}

impl<O> Unit<'_, O> {
    fn chip<D: crate::chips::Device>(&mut self, number: usize) -> Option<&mut D> {
        let part = &mut self.session.board_mut().part;
        part.spi_chip::<Wired<D>>(number).map(|wired| &mut wired.device)
    }
}

impl<O> Breakable for Unit<'_, O> {
    fn imu(&mut self, set: &dyn Fn(&mut ImuFaults)) {
        if let Some(model) = self.chip::<Adis16495>(board::IMU_SPI) {
            set(&mut model.faults);
        }
    }

    fn encoder(&mut self, set: &dyn Fn(&mut EncoderFaults)) {
        if let Some(encoder) = self.chip::<Encoder>(board::ENCODER_SPI) {
            set(&mut encoder.model.faults);
        }
    }

    fn plant(&mut self, set: &dyn Fn(&mut PlantFaults)) {
        set(&mut self.world.plant.faults);
    }

    fn cut_data_ready(&mut self, cut: bool) {
        self.world.ready_cut = cut;
    }

    fn stick_imu_bus(&mut self, stuck: bool) {
        self.world.bus_stuck = stuck;
    }

    fn disturb_dec_rate(&mut self, dec_rate: u16) {
        let now_us = self.stop.at.0 / 1000;
        if let Some(model) = self.chip::<Adis16495>(board::IMU_SPI) {
            fault::write_dec_rate(model, now_us, dec_rate);
        }
    }

    fn hang(&mut self, _: Task, hangs: bool) {
        self.world.hung = hangs;
        self.host.hold(hangs);
    }

    fn reset(&mut self) {
        let Stop {
            at, instruction_count, ..
        } = self.stop;
        self.session.reset_by_pin(at, instruction_count, self.host);
    }
}

fn rotor(plant: &Plant) -> RotorState<f64> {
    RotorState {
        angle: plant.angle(),
        rate: plant.rate(),
        acceleration: 0.0,
    }
}

fn level(high: bool) -> Level {
    if high { Level::High } else { Level::Low }
}

/// What the session has noted of the emulator's gaps.
fn gaps(session: &Session<Board>) -> Gaps {
    let exticr = |u: &&rigless::session::Unimplemented| u.instance == "SYSCFG" && u.register.starts_with("EXTICR");
    Gaps {
        unmapped: session
            .unmapped()
            .iter()
            .filter(|u| !flash::in_array(u.address))
            .map(ToString::to_string)
            .collect(),
        refused: session.refused().values().map(ToString::to_string).collect(),
        unrouted: session
            .unrouted()
            .iter()
            .map(|(instance, interrupt)| format!("{instance} {interrupt}"))
            .collect(),
        told: session
            .told()
            .map(|told| format!("{}.{}: {}", told.instance, told.register, told.reason))
            .collect(),
        unimplemented: session
            .unimplemented()
            .values()
            .filter(|u| !exticr(u))
            .map(|u| format!("{}.{}", u.instance, u.register))
            .collect(),
    }
}
