//! The application's bodies as tasks of this image: concrete types, statics, and which executor runs what.
//!
//! ```text
//! interrupt, priority 6   motor        1 kHz: encoder, control, duties
//! interrupt, priority 7   sampling     202 Hz: IMU at its data-ready
//! thread                  alignment    half a millisecond a sample while it catches up
//!                         supervisor   200 Hz: modes, faults, watchdog
//!                         output       10 Hz: NMEA 0183 to the serial port
//!                         console      commands from it, settings to flash
//!                         report       1 Hz: what the unit does to the log
//!                         panel        20 Hz: lamps and button
//! ```
//!
//! The sampling must not wait for what runs in the thread: the IMU keeps only its last sample, and the rotor's angle at the
//! edge is known for 8 ms.

use app::alignment::AlignmentConfig;
use app::blackbox::BlackBox;
use app::hal::{ChangeOver, MagneticEncoder};
use app::motor::Drive;
use app::output::Port;
use app::rotor::{self, Rotor};
use app::settings::{HARMONICS, OutputConfig, Settings, Store};
use app::shared::Shared;
use app::{alignment, console, motor, output, panel, report, sampling, supervisor};
use drivers::harmonics::Harmonics;
use drivers::mt6835::Mt6835;
use embassy_executor::Spawner;
use embassy_stm32::gpio::{Flex, Input, Output};
use embassy_sync::blocking_mutex::raw::CriticalSectionRawMutex;
use embassy_time::Delay;
use nav::aligner::{Aligner, AlignerConfig};
use static_cell::StaticCell;

use crate::board::{
    self, BlackBoxRam, Board, Bridge, DataReady, Device, Iwdg, MotorCutoff, SerialRx, SerialTx, SettingsFlash, Vdd,
};
use crate::params;

#[cfg(not(feature = "icm42688"))]
type Imu = drivers::adis16495::Adis16495<Device, Delay>;
#[cfg(feature = "icm42688")]
type Imu = drivers::icm42688::Icm42688<Device, Delay>;

type Encoder = MagneticEncoder<Device>;
type Motor = Drive<Output<'static>, Flex<'static>, Bridge, ChangeOver<Input<'static>, Input<'static>>>;

type Bus = Shared<CriticalSectionRawMutex>;

// Made at the start and not by the linker: a few bytes that are not zero would put all 2.8 kB of it into flash.
static SHARED: StaticCell<Bus> = StaticCell::new();
static PORT: Port<CriticalSectionRawMutex> = Port::new();
static ROTOR: StaticCell<Rotor> = StaticCell::new();
static ALIGNER: StaticCell<Aligner> = StaticCell::new();

/// Starts every task. Panics where the parameters are refused: nothing has moved then.
pub async fn start(spawner: Spawner, mut board: Board, blackbox: BlackBox<BlackBoxRam>) {
    let mut store = Store::new(board.settings);
    let (settings, report) = store.load_over(params::factory()).await;
    app::log::settings(&report);
    app::log::supply(&board.supply);
    board::erase_ahead(&mut store, &mut board.supply).await;
    let shared = shared(settings);
    shared.set_clock(board.clock);
    let aligning = settings.aligner(params::filter());
    let aligner = aligner(aligning);
    let encoder = MagneticEncoder {
        driver: Mt6835::new(board.encoder),
        config: params::ENCODER,
    };
    let drive = Drive {
        driver: board.driver,
        pwm: board.bridge,
        home: board.home,
    };
    let imu = Imu::new(board.imu, Delay);

    let (Ok(motor), Ok(sampling), Ok(alignment), Ok(supervisor), Ok(output), Ok(console), Ok(report), Ok(panel)) = (
        motor(shared, encoder, drive, rotor(&settings), settings.encoder.correction),
        sampling(shared, imu, board.imu_ready),
        alignment(
            shared,
            aligner,
            AlignmentConfig::for_aligner(&aligning, &settings.motion),
        ),
        supervisor(shared, board.watchdog, blackbox),
        output(shared, board.serial_tx, settings.output),
        console(shared, board.serial_rx, store, board.supply),
        self::report(shared),
        panel(shared, board.lamps, board.button),
    ) else {
        defmt::unreachable!("each task is spawned once")
    };
    board::motor_executor().spawn(motor);
    board::sampling_executor().spawn(sampling);
    spawner.spawn(alignment);
    spawner.spawn(supervisor);
    spawner.spawn(output);
    spawner.spawn(console);
    spawner.spawn(report);
    spawner.spawn(panel);
}

#[inline(never)]
fn shared(settings: Settings) -> &'static Bus {
    SHARED.init_with(|| Shared::new(crate::VERSION, settings))
}

fn rotor(settings: &Settings) -> &'static mut Rotor {
    let built = params::rotor();
    let set = settings.rotor(built);
    // What was found of this unit, the encoder's zero above all, holds whatever the motion.
    let as_built = rotor::Config {
        schedule: built.schedule,
        ..set
    };
    ROTOR.init_with(|| match Rotor::new(set).or_else(|_| Rotor::new(as_built)) {
        Ok(rotor) => rotor,
        Err(_) => defmt::panic!("params.rs: the rotor's figures are refused"),
    })
}

fn aligner(config: AlignerConfig) -> &'static mut Aligner {
    match Aligner::place(ALIGNER.uninit(), config) {
        Ok(aligner) => aligner,
        Err(_) => defmt::panic!("params.rs: the aligner's figures are refused"),
    }
}

#[embassy_executor::task]
async fn motor(
    shared: &'static Bus,
    encoder: Encoder,
    drive: Motor,
    rotor: &'static mut Rotor,
    correction: Harmonics<HARMONICS>,
) -> ! {
    motor::run(shared, encoder, drive, rotor, correction).await
}

#[embassy_executor::task]
async fn sampling(shared: &'static Bus, imu: Imu, edges: DataReady) -> ! {
    sampling::run(shared, imu, params::imu(), edges, params::sampling()).await
}

#[embassy_executor::task]
async fn alignment(shared: &'static Bus, aligner: &'static mut Aligner, config: AlignmentConfig) -> ! {
    alignment::run(shared, aligner.as_align(), config).await
}

#[embassy_executor::task]
async fn supervisor(shared: &'static Bus, watchdog: Iwdg, blackbox: BlackBox<BlackBoxRam>) -> ! {
    supervisor::run(shared, MotorCutoff, watchdog, blackbox, params::supervisor()).await
}

#[embassy_executor::task]
async fn output(shared: &'static Bus, tx: SerialTx, config: OutputConfig) -> ! {
    output::run(shared, &PORT, tx, config).await
}

#[embassy_executor::task]
async fn console(shared: &'static Bus, rx: SerialRx, store: Store<SettingsFlash>, supply: Vdd) -> ! {
    console::run(shared, &PORT, rx, store, BlackBoxRam, supply).await
}

#[embassy_executor::task]
async fn report(shared: &'static Bus) -> ! {
    report::run(shared).await
}

#[embassy_executor::task]
async fn panel(shared: &'static Bus, lamps: [Output<'static>; 3], button: Input<'static>) -> ! {
    panel::run(shared, lamps, button).await
}
