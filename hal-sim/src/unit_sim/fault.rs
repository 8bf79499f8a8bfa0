//! What a fault of a scenario does to a unit, the same at every level that has devices.

use app::fault::Task;
use app::rotor::Side;
use drivers::mt6835::Warnings;
use drivers::{Channels, SystemFlags, adis16495};

use crate::device::{EncoderFaults, ImuFaults, SpiTarget};
use crate::plant::PlantFaults;
use crate::scenario::{FaultAt, FaultKind};

/// DEC_RATE of an IMU that samples 19 % too slowly.
const SLOW_DEC_RATE: u16 = 24;

/// A unit that can be broken.
pub trait Breakable {
    /// Faults of the IMU's model.
    fn imu(&mut self, set: &dyn Fn(&mut ImuFaults));
    /// Faults of the encoder's model.
    fn encoder(&mut self, set: &dyn Fn(&mut EncoderFaults));
    /// Faults of motor, bridge and home switch.
    fn plant(&mut self, set: &dyn Fn(&mut PlantFaults));
    /// Holds the data-ready line low, or lets it go.
    fn cut_data_ready(&mut self, cut: bool);
    /// Lets transfers with the IMU never end, or end again.
    fn stick_imu_bus(&mut self, stuck: bool);
    /// Has [`write_dec_rate`] done to the IMU's model, now.
    fn disturb_dec_rate(&mut self, dec_rate: u16);
    /// Lets a task hang, or go on.
    fn hang(&mut self, task: Task, hangs: bool);
    /// Resets the unit by its pin.
    fn reset(&mut self);
}

/// Breaks something, or mends it.
pub fn inject(unit: &mut impl Breakable, kind: FaultKind, on: bool) {
    let many = if on { u32::MAX } else { 0 };
    match kind {
        FaultKind::ImuEdges => unit.cut_data_ready(on),
        FaultKind::ImuSilent => unit.imu(&|f| f.silent = on.then_some(0xFF)),
        FaultKind::ImuCrc => unit.imu(&|f| f.bad_crc = many),
        FaultKind::ImuSaturated => unit.imu(&|f| f.saturated = if on { Channels::RATE_Z } else { Channels::NONE }),
        FaultKind::ImuStuckData => unit.imu(&|f| f.stuck_data = on),
        FaultKind::ImuStuckCounter => unit.imu(&|f| f.stuck_counter = on),
        FaultKind::ImuFlags => unit.imu(&|f| f.flags = if on { SystemFlags::OVERRUN.bits() } else { 0 }),
        FaultKind::ImuHot => unit.imu(&|f| f.temperature_c = on.then_some(110.0)),
        FaultKind::ImuRate => {
            let sound = adis16495::Config::default().dec_rate;
            unit.disturb_dec_rate(if on { SLOW_DEC_RATE } else { sound });
        }
        FaultKind::ImuBus => unit.stick_imu_bus(on),
        FaultKind::EncoderSilent => unit.encoder(&|f| f.silent = on.then_some(0xFF)),
        FaultKind::EncoderCrc => unit.encoder(&|f| f.bad_crc = many),
        FaultKind::EncoderFrozen => unit.encoder(&|f| f.frozen = on),
        FaultKind::EncoderWeak => unit.encoder(&|f| {
            f.warnings = if on { Warnings::WEAK_FIELD } else { Warnings::NONE };
        }),
        FaultKind::Driver => unit.plant(&|f| f.driver_fault = on),
        FaultKind::Jam => unit.plant(&|f| f.stuck = on),
        FaultKind::HomeBroken => unit.plant(&|f| f.home_broken = on),
        FaultKind::HomeStuck => unit.plant(&|f| f.home_stuck = on.then_some(Side::Above)),
        FaultKind::HangSampling => unit.hang(Task::Sampling, on),
        FaultKind::HangMotor => unit.hang(Task::Motor, on),
        FaultKind::HangAlignment => unit.hang(Task::Alignment, on),
        FaultKind::Reset => {
            if on {
                unit.reset();
            }
        }
    }
}

/// Something breaks, or is mended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Step {
    /// When, ns since power-up.
    pub at_ns: u64,
    /// What.
    pub kind: FaultKind,
    /// Whether it breaks.
    pub on: bool,
}

/// The faults of a scenario in order of time.
pub fn steps(faults: &[FaultAt]) -> Vec<Step> {
    let ns = |s: f64| (s * 1e9) as u64;
    let mut steps = Vec::new();
    for &FaultAt { at_s, for_s, kind } in faults {
        let step = |s, on| Step { at_ns: ns(s), kind, on };
        steps.push(step(at_s, true));
        steps.extend(for_s.map(|length| step(at_s + length, false)));
    }
    steps.sort_by_key(|step| step.at_ns);
    steps
}

/// Writes DEC_RATE behind the driver's back, as a disturbance on the lines might.
pub fn write_dec_rate(model: &mut impl SpiTarget, now_us: u64, dec_rate: u16) {
    let at = adis16495::register::DEC_RATE;
    let page = adis16495::register::PAGE_ID | adis16495::WRITE;
    let [low, high] = dec_rate.to_le_bytes();
    let frames = [
        [page, at.page],
        [at.address | adis16495::WRITE, low],
        [(at.address + 1) | adis16495::WRITE, high],
        [page, 0],
    ];
    // After a burst that may be under way: 80 µs and the stall.
    let mut now_us = now_us + 150;
    for frame in frames {
        model.transfer(now_us, &frame, &mut [0; 2]);
        // Two bytes and the stall.
        now_us += 10;
    }
}
