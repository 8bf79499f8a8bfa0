//! The application's bodies as tasks of this image: concrete types, statics, and which executor runs what.
//!
//! ```text
//! interrupt, priority 6   motor        1 kHz: encoder, control, duties
//! interrupt, priority 7   sampling     202 Hz: IMU at its data-ready
//! thread                  alignment    up to 11 ms a step while it catches up
//!                         supervisor   200 Hz: modes, faults, watchdog
//!                         output       10 Hz: NMEA 0183 to the serial port
//!                         report       1 Hz: the estimate to the log
//! ```
//!
//! The sampling must not wait for the alignment: 11 ms are two samples, and the IMU keeps only the last one.

use app::hal::{ChangeOver, MagneticEncoder};
use app::motor::Drive;
use app::output::Port;
use app::rotor::Rotor;
use app::shared::Shared;
use app::{alignment, motor, output, sampling, supervisor};
use drivers::mt6835::Mt6835;
use embassy_executor::Spawner;
use embassy_stm32::gpio::{Flex, Input, Output};
use embassy_sync::blocking_mutex::raw::CriticalSectionRawMutex;
use embassy_time::Delay;
use frames::units::DEG;
use nav::aligner::Aligner;
use static_cell::StaticCell;

use crate::board::{self, Board, Bridge, DataReady, Device, Iwdg, MotorCutoff, SerialTx};
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
pub fn start(spawner: Spawner, mut board: Board) {
    let (shared, rotor, aligner) = (shared(), rotor(), aligner());
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

    board.watchdog.start();
    let (Ok(motor), Ok(sampling), Ok(alignment), Ok(supervisor), Ok(output), Ok(report)) = (
        motor(shared, encoder, drive, rotor),
        sampling(shared, imu, board.imu_ready),
        alignment(shared, aligner),
        supervisor(shared, board.watchdog),
        output(shared, board.serial_tx),
        report(shared),
    ) else {
        defmt::unreachable!("each task is spawned once")
    };
    board::motor_executor().spawn(motor);
    board::sampling_executor().spawn(sampling);
    spawner.spawn(alignment);
    spawner.spawn(supervisor);
    spawner.spawn(output);
    spawner.spawn(report);
}

#[inline(never)]
fn shared() -> &'static Bus {
    SHARED.init_with(Shared::new)
}

fn rotor() -> &'static mut Rotor {
    ROTOR.init_with(|| match Rotor::new(params::rotor()) {
        Ok(rotor) => rotor,
        Err(_) => defmt::panic!("params.rs: the rotor's figures are refused"),
    })
}

// Alone, because it needs up to twice the aligner's 34 kB of stack where the compiler does not build it in place.
#[inline(never)]
fn aligner() -> &'static mut Aligner {
    ALIGNER.init_with(|| match Aligner::new(params::aligner()) {
        Ok(aligner) => aligner,
        Err(_) => defmt::panic!("params.rs: the aligner's figures are refused"),
    })
}

#[embassy_executor::task]
async fn motor(shared: &'static Bus, encoder: Encoder, drive: Motor, rotor: &'static mut Rotor) -> ! {
    motor::run(shared, encoder, drive, rotor, params::correction()).await
}

#[embassy_executor::task]
async fn sampling(shared: &'static Bus, imu: Imu, edges: DataReady) -> ! {
    sampling::run(shared, imu, params::imu(), edges, params::sampling()).await
}

#[embassy_executor::task]
async fn alignment(shared: &'static Bus, aligner: &'static mut Aligner) -> ! {
    alignment::run(shared, aligner.as_align(), params::alignment()).await
}

#[embassy_executor::task]
async fn supervisor(shared: &'static Bus, watchdog: Iwdg) -> ! {
    supervisor::run(shared, MotorCutoff, watchdog, params::supervisor()).await
}

#[embassy_executor::task]
async fn output(shared: &'static Bus, tx: SerialTx) -> ! {
    output::run(shared, &PORT, tx, params::output()).await
}

/// The estimate, once a second, for whoever reads the log and not the serial port.
#[embassy_executor::task]
async fn report(shared: &'static Bus) {
    let Some(mut navigation) = shared.navigation.receiver() else {
        defmt::unreachable!("a watch has room for its first reader")
    };
    let deg = |x: f32| x / DEG as f32;
    let mut next_us = 0;
    loop {
        let now = navigation.changed().await;
        if now.t_us < next_us {
            continue;
        }
        next_us = now.t_us + 1_000_000;
        if let Some(estimate) = now.estimate {
            let (attitude, sd) = (estimate.attitude, estimate.sd);
            defmt::info!(
                "heading {} deg, sd {}; pitch {}, roll {}",
                deg(attitude.heading),
                deg(sd.heading),
                deg(attitude.pitch),
                deg(attitude.roll)
            );
        }
    }
}
