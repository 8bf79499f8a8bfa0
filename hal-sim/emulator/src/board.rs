//! The board: the part, its crystal, and what hangs on its wires. The same as `firmware/src/board.rs`, seen from the
//! other side; a test of the whole image tells when they part.

use core::ops::Range;
use std::num::{NonZeroU32, NonZeroU64};

use rigless::cpu;
use rigless::machine::{self, Target, armv7m};
use rigless::mcu::{Mcu, Operate as _};
use rigless::snapshot::Store;
use rigless::soc::Error;

use crate::part::flash::MemoryMap;
use crate::part::{BridgeTimer, Part, Pin};

/// The core's clock in its registers' eyes, Hz.
pub const CORE_HZ: u64 = 168_000_000;
/// Instructions in a second of virtual time. Each takes the same time, waiting states, branches and divisions included:
/// on average one in 1.5 clocks, which is on the slow side for code that runs from flash with its cache.
pub const INSTRUCTIONS_PER_SECOND: u64 = 110_000_000;
/// Crystal, or the clock that the debugger's controller puts in its place, Hz.
pub const CRYSTAL_HZ: u64 = 8_000_000;
/// Supply of the part, mV.
pub const SUPPLY_MV: u32 = 3300;
/// Clock of the IMU's bus, Hz.
pub const IMU_HZ: u32 = 5_250_000;

/// The sectors of the settings: `SETTINGS` in `memory.x`.
pub const SETTINGS: Range<u64> = 0x0810_0000..0x0811_0000;

/// The IMU's SPI.
pub(crate) const IMU_SPI: usize = 1;
/// The encoder's SPI.
pub(crate) const ENCODER_SPI: usize = 3;
/// The serial port's USART.
pub(crate) const SERIAL: usize = 3;
pub(crate) const IMU_SELECT: Pin = Pin::new('A', 4);
pub(crate) const ENCODER_SELECT: Pin = Pin::new('A', 15);
pub(crate) const IMU_READY: Pin = Pin::new('C', 0);
pub(crate) const MOTOR_FAULT: Pin = Pin::new('E', 15);
pub(crate) const MOTOR_ENABLE: Pin = Pin::new('F', 15);
pub(crate) const HOME_BELOW: Pin = Pin::new('F', 13);
pub(crate) const HOME_ABOVE: Pin = Pin::new('F', 14);
pub(crate) const BUTTON: Pin = Pin::new('C', 13);
pub(crate) const LAMP_GREEN: Pin = Pin::new('B', 0);
pub(crate) const LAMP_BLUE: Pin = Pin::new('B', 7);
pub(crate) const LAMP_RED: Pin = Pin::new('B', 14);

/// The board.
#[derive(Debug)]
pub struct Board {
    /// Its part.
    pub part: Part,
    map: MemoryMap,
}

impl Board {
    /// A board with nothing on its buses.
    ///
    /// # Errors
    /// Where the part does not assemble.
    pub fn new(timer: BridgeTimer) -> Result<Self, Error> {
        Self::on(CRYSTAL_HZ, SUPPLY_MV, timer)
    }

    /// The same with another clock input, Hz, zero for one that stands still, and another supply, mV.
    ///
    /// # Errors
    /// Where the part does not assemble.
    pub fn on(hse_hz: u64, supply_mv: u32, timer: BridgeTimer) -> Result<Self, Error> {
        let part = Part::new(hse_hz, supply_mv, timer)?;
        let map = MemoryMap::of(part.bus())?;
        Ok(Self { part, map })
    }
}

// Nothing here is ever saved.
impl Store for Board {}

impl machine::Board for Board {
    fn name(&self) -> &'static str {
        "rotary-north"
    }

    fn target_names(&self) -> Vec<&'static str> {
        vec!["stm32f427"]
    }

    fn mcu(&mut self, target: usize) -> Option<&mut dyn Mcu> {
        (target == 0).then_some(&mut self.part)
    }

    fn targets(&mut self) -> Vec<Target<'_>> {
        const fn rate(hz: u64) -> NonZeroU64 {
            match NonZeroU64::new(hz) {
                Some(hz) => hz,
                None => panic!("a clock that stands"),
            }
        }
        const REFERENCE_DIVIDER: NonZeroU32 = match NonZeroU32::new(8) {
            Some(divider) => divider,
            None => NonZeroU32::MIN,
        };
        let lines = NonZeroU32::new(u32::from(self.part.cpu().interrupt_lines)).unwrap_or(NonZeroU32::MIN);
        let core = armv7m::Core {
            variant: armv7m::Variant::M4,
            clock_hz: const { rate(CORE_HZ) },
            interrupt_lines: lines,
            priority_bits: 4,
            refclk_divider: REFERENCE_DIVIDER,
            instructions_per_second: const { rate(INSTRUCTIONS_PER_SECOND) },
            boot: "flash",
        }
        .spec_with_parts(
            &cpu::armv7m::windows(self.part.bus()),
            armv7m::Fpu::FpV4Sp,
            armv7m::MpuRegions::Eight,
        );
        vec![Target::new("stm32f427", &mut self.map, core)]
    }
}
