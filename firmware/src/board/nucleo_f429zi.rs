//! NUCLEO-F429ZI, as it comes out of the box. Wiring is in `docs/wiring.md`.
//!
//! | unit | use | figures |
//! |---|---|---|
//! | clock | HSE bypassed, 8 MHz from the debugger's MCO | |
//! | SPI1 | IMU | 84 MHz / 16 = 5.25 MHz: a burst allows 6 |
//! | SPI3 | encoder | 42 MHz / 8 = 5.25 MHz: 9 µs for an angle |
//! | TIM1 | bridge | |
//! | USART3 | NMEA out, commands in, by the debugger's USB cable | 115200 baud |
//! | USART2 | the same on pins of its own, with the feature `usart2` | 115200 baud |
//! | flash, bank 2, sectors 12–15 | settings | 4 × 16 kB |

use core::mem;

use app::settings::Store;
use embassy_stm32::flash::{self, Bank2Region1, Flash};
use embassy_stm32::gpio::{Level, Output, Speed};
use embassy_stm32::interrupt::Interrupt;
use embassy_stm32::pac::timer::TimAdv;
use embassy_stm32::rcc::HseMode;
use embassy_stm32::{Peri, Peripherals, bind_interrupts, dma, interrupt, pac, peripherals, usart};

use super::Vdd;

/// Where the 8 MHz come from.
pub(super) const HSE: HseMode = HseMode::Bypass;
/// Time without being fed until the watchdog resets, µs. 0.5 s at 32 kHz, at 47 kHz still 0.34.
pub(super) const WATCHDOG_US: u32 = 500_000;
/// The bridge's timer.
pub(super) const MOTOR_TIMER: TimAdv = pac::TIM1;
/// Alternate function of its break input.
pub(super) const MOTOR_FAULT_AF: u8 = 1;
/// The software interrupts of the motor's loop and of the sampling: of units that the board does not use.
pub(super) const EXECUTORS: [Interrupt; 2] = [interrupt::UART7, interrupt::UART8];
/// The interrupts of the serial port.
pub(super) const SERIAL: [Interrupt; 2] = [interrupt::USART3, interrupt::USART2];

// The pin map. `docs/wiring.md` has the same; a test compares them, by the lines of this block.
super::resources! {
    pins {
        imu_select: PA4 = "GPIO out, SPI1 NSS",
        imu_clock: PA5 = "SPI1 SCK",
        imu_miso: PA6 = "SPI1 MISO",
        imu_mosi: PB5 = "SPI1 MOSI",
        imu_ready: PC0 = "EXTI0",
        encoder_select: PA15 = "GPIO out, SPI3 NSS",
        encoder_clock: PC10 = "SPI3 SCK",
        encoder_miso: PC11 = "SPI3 MISO",
        encoder_mosi: PC12 = "SPI3 MOSI",
        motor_a: PE9 = "TIM1 CH1",
        motor_b: PE11 = "TIM1 CH2",
        motor_c: PE13 = "TIM1 CH3",
        motor_fault: PE15 = "TIM1 BKIN",
        motor_enable: PF15 = "GPIO out",
        home_below: PF13 = "GPIO in",
        home_above: PF14 = "GPIO in",
        #[cfg(not(feature = "usart2"))]
        serial_tx: PD8 = "USART3 TX",
        #[cfg(not(feature = "usart2"))]
        serial_rx: PD9 = "USART3 RX",
        #[cfg(feature = "usart2")]
        line_tx: PD5 = "USART2 TX",
        #[cfg(feature = "usart2")]
        line_rx: PD6 = "USART2 RX",
        lamp_green: PB0 = "GPIO out",
        lamp_blue: PB7 = "GPIO out",
        lamp_red: PB14 = "GPIO out",
        button: PC13 = "GPIO in",
        held_low: PA12 = "GPIO out",
    }
    units {
        imu_spi: SPI1,
        imu_tx: DMA2_CH3,
        imu_rx: DMA2_CH0,
        imu_line: EXTI0,
        encoder_spi: SPI3,
        encoder_tx: DMA1_CH7,
        encoder_rx: DMA1_CH0,
        motor_timer: TIM1,
        #[cfg(not(feature = "usart2"))]
        serial: USART3,
        #[cfg(not(feature = "usart2"))]
        serial_dma_tx: DMA1_CH3,
        #[cfg(not(feature = "usart2"))]
        serial_dma_rx: DMA1_CH1,
        #[cfg(feature = "usart2")]
        line: USART2,
        #[cfg(feature = "usart2")]
        line_dma_tx: DMA1_CH6,
        #[cfg(feature = "usart2")]
        line_dma_rx: DMA1_CH5,
        flash: FLASH,
    }
}

bind_interrupts!(pub(super) struct Irqs {
    DMA2_STREAM3 => dma::InterruptHandler<peripherals::DMA2_CH3>;
    DMA2_STREAM0 => dma::InterruptHandler<peripherals::DMA2_CH0>;
    DMA1_STREAM7 => dma::InterruptHandler<peripherals::DMA1_CH7>;
    DMA1_STREAM0 => dma::InterruptHandler<peripherals::DMA1_CH0>;
    #[cfg(not(feature = "usart2"))]
    DMA1_STREAM3 => dma::InterruptHandler<peripherals::DMA1_CH3>;
    #[cfg(not(feature = "usart2"))]
    DMA1_STREAM1 => dma::InterruptHandler<peripherals::DMA1_CH1>;
    #[cfg(not(feature = "usart2"))]
    USART3 => usart::InterruptHandler<peripherals::USART3>;
    #[cfg(feature = "usart2")]
    DMA1_STREAM6 => dma::InterruptHandler<peripherals::DMA1_CH6>;
    #[cfg(feature = "usart2")]
    DMA1_STREAM5 => dma::InterruptHandler<peripherals::DMA1_CH5>;
    #[cfg(feature = "usart2")]
    USART2 => usart::InterruptHandler<peripherals::USART2>;
    FLASH => flash::InterruptHandler;
});

/// Takes the resources, and holds low what must be before flash is read.
pub(super) fn take(p: Peripherals) -> (Pins, Units) {
    let (mut pins, units) = split(p);
    hold_low(pins.held_low.reborrow());
    (pins, units)
}

/// The flash of the settings.
pub type SettingsFlash = Bank2Region1<'static, flash::Async>;

/// Nothing: the settings are in a bank of their own, and while it erases the program runs.
pub async fn erase_ahead(_: &mut Store<SettingsFlash>, _: &mut Vdd) {}

pub(super) fn settings(flash: Peri<'static, peripherals::FLASH>) -> SettingsFlash {
    Flash::new(flash, Irqs).into_regions().bank2_region1
}

/// Before revision 3 of the part, levels on this pin spoil what is read from bank 2 (erratum 2.2.11): it is held low.
fn hold_low(pin: Peri<'_, pin::held_low>) {
    // The output stays when its owner goes, which is for good.
    mem::forget(Output::new(pin, Level::Low, Speed::Low));
    pac::GPIOA
        .pupdr()
        .modify(|w| w.set_pupdr(12, pac::gpio::vals::Pupdr::PULL_DOWN));
}

#[interrupt]
unsafe fn UART7() {
    // SAFETY: this is the handler of the interrupt the executor was started with, and nobody else calls it.
    unsafe { super::MOTOR_EXECUTOR.on_interrupt() }
}

#[interrupt]
unsafe fn UART8() {
    // SAFETY: as above.
    unsafe { super::SAMPLING_EXECUTOR.on_interrupt() }
}
