//! WeAct STM32F405RGT6 core board. Wiring, and where its facts come from, is in `docs/wiring-f405.md`.
//!
//! | unit | use | figures |
//! |---|---|---|
//! | clock | HSE, a crystal of 8 MHz | |
//! | SPI1 | IMU | 84 MHz / 16 = 5.25 MHz: a burst allows 6 |
//! | SPI2 | encoder | 42 MHz / 8 = 5.25 MHz: 9 µs for an angle |
//! | TIM8 | bridge: the board's card detect is on the pin of TIM1's channel 1 | |
//! | USART1 | NMEA out, commands in | 115200 baud |
//! | USART2 | the same on other pins, with the feature `usart2` | 115200 baud |
//! | flash, sectors 1–3 | settings | 3 × 16 kB |
//!
//! # One bank of flash
//!
//! While a sector erases nothing can be read from flash, so the program stops, for 0.25 s and 0.5 s at the worst. An erase is
//! therefore only done at the start, before any task runs ([`erase_ahead`]); the motor is off then. Sectors of 16 kB are the ones
//! that the watchdog bears; they lie behind the vectors, see `memory.x`. A word that is programmed stops the program for 16 µs,
//! and 0.1 ms at the worst, which the motor's loop of 1 ms bears.

use core::ops::Range;

use app::settings::Store;
use embassy_stm32::flash::{self, Bank1Region1, Flash};
use embassy_stm32::interrupt::Interrupt;
use embassy_stm32::pac::flash::vals::Psize;
use embassy_stm32::pac::iwdg::vals::Key;
use embassy_stm32::pac::timer::TimAdv;
use embassy_stm32::rcc::HseMode;
use embassy_stm32::{Peri, Peripherals, bind_interrupts, dma, interrupt, pac, peripherals, usart};
use embedded_storage_async::nor_flash::{ErrorType, NorFlash, ReadNorFlash};

use super::Vdd;

/// Where the 8 MHz come from.
pub(super) const HSE: HseMode = HseMode::Oscillator;
/// Time without being fed until the watchdog resets, µs. 1 s at 32 kHz, at 47 kHz still 0.68: an erase takes 0.5.
pub(super) const WATCHDOG_US: u32 = 1_000_000;
/// The bridge's timer.
pub(super) const MOTOR_TIMER: TimAdv = pac::TIM8;
/// Alternate function of its break input.
pub(super) const MOTOR_FAULT_AF: u8 = 3;
/// The software interrupts of the motor's loop and of the sampling: of units that the board does not use.
pub(super) const EXECUTORS: [Interrupt; 2] = [interrupt::UART4, interrupt::UART5];
/// The interrupts of the serial port.
pub(super) const SERIAL: [Interrupt; 2] = [interrupt::USART1, interrupt::USART2];

// The pin map. `docs/wiring-f405.md` has the same; a test compares them, by the lines of this block.
super::resources! {
    pins {
        imu_select: PA4 = "GPIO out, SPI1 NSS",
        imu_clock: PB3 = "SPI1 SCK",
        imu_miso: PB4 = "SPI1 MISO",
        imu_mosi: PB5 = "SPI1 MOSI",
        imu_ready: PC0 = "EXTI0",
        encoder_select: PB12 = "GPIO out, SPI2 NSS",
        encoder_clock: PB13 = "SPI2 SCK",
        encoder_miso: PB14 = "SPI2 MISO",
        encoder_mosi: PB15 = "SPI2 MOSI",
        motor_a: PC6 = "TIM8 CH1",
        motor_b: PC7 = "TIM8 CH2",
        motor_c: PC8 = "TIM8 CH3",
        motor_fault: PA6 = "TIM8 BKIN",
        motor_enable: PC5 = "GPIO out",
        home_below: PC1 = "GPIO in",
        home_above: PC2 = "GPIO in",
        #[cfg(not(feature = "usart2"))]
        serial_tx: PA9 = "USART1 TX",
        #[cfg(not(feature = "usart2"))]
        serial_rx: PA10 = "USART1 RX",
        #[cfg(feature = "usart2")]
        line_tx: PA2 = "USART2 TX",
        #[cfg(feature = "usart2")]
        line_rx: PA3 = "USART2 RX",
        lamp_green: PB0 = "GPIO out",
        lamp_blue: PB2 = "GPIO out",
        lamp_red: PB1 = "GPIO out",
        button: PC13 = "GPIO in",
    }
    units {
        imu_spi: SPI1,
        imu_tx: DMA2_CH3,
        imu_rx: DMA2_CH0,
        imu_line: EXTI0,
        encoder_spi: SPI2,
        encoder_tx: DMA1_CH4,
        encoder_rx: DMA1_CH3,
        motor_timer: TIM8,
        #[cfg(not(feature = "usart2"))]
        serial: USART1,
        #[cfg(not(feature = "usart2"))]
        serial_dma_tx: DMA2_CH7,
        #[cfg(not(feature = "usart2"))]
        serial_dma_rx: DMA2_CH5,
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
    DMA1_STREAM4 => dma::InterruptHandler<peripherals::DMA1_CH4>;
    DMA1_STREAM3 => dma::InterruptHandler<peripherals::DMA1_CH3>;
    #[cfg(not(feature = "usart2"))]
    DMA2_STREAM7 => dma::InterruptHandler<peripherals::DMA2_CH7>;
    #[cfg(not(feature = "usart2"))]
    DMA2_STREAM5 => dma::InterruptHandler<peripherals::DMA2_CH5>;
    #[cfg(not(feature = "usart2"))]
    USART1 => usart::InterruptHandler<peripherals::USART1>;
    #[cfg(feature = "usart2")]
    DMA1_STREAM6 => dma::InterruptHandler<peripherals::DMA1_CH6>;
    #[cfg(feature = "usart2")]
    DMA1_STREAM5 => dma::InterruptHandler<peripherals::DMA1_CH5>;
    #[cfg(feature = "usart2")]
    USART2 => usart::InterruptHandler<peripherals::USART2>;
    FLASH => flash::InterruptHandler;
});

/// Takes the resources.
pub(super) fn take(p: Peripherals) -> (Pins, Units) {
    split(p)
}

/// Size of a sector, bytes.
const SECTOR: u32 = 16 * 1024;
/// The settings' sectors, as addresses in the region of sectors 0 to 3: sector 0 has the vectors.
const SECTORS: Range<u32> = SECTOR..4 * SECTOR;

/// The flash of the settings: sectors 1 to 3.
pub struct SettingsFlash(Bank1Region1<'static, flash::Async>);

/// Makes room for saves to come, before anything turns: from here on nothing is erased.
pub async fn erase_ahead(store: &mut Store<SettingsFlash>, supply: &mut Vdd) {
    // What fails here fails at `save` as well, which says so.
    let _ = store.erase_ahead(supply).await;
}

pub(super) fn settings(flash: Peri<'static, peripherals::FLASH>) -> SettingsFlash {
    SettingsFlash(Flash::new(flash, Irqs).into_regions().bank1_region1)
}

/// The place of `length` bytes from `offset` on.
fn place(offset: u32, length: usize) -> Result<u32, flash::Error> {
    let length = u32::try_from(length).map_err(|_| flash::Error::Size)?;
    let end = offset.checked_add(length).ok_or(flash::Error::Size)?;
    if end <= SECTORS.end - SECTORS.start {
        Ok(SECTORS.start + offset)
    } else {
        Err(flash::Error::Size)
    }
}

impl ErrorType for SettingsFlash {
    type Error = flash::Error;
}

impl ReadNorFlash for SettingsFlash {
    const READ_SIZE: usize = <Bank1Region1<'static, flash::Async> as ReadNorFlash>::READ_SIZE;

    async fn read(&mut self, offset: u32, bytes: &mut [u8]) -> Result<(), flash::Error> {
        self.0.read(place(offset, bytes.len())?, bytes).await
    }

    fn capacity(&self) -> usize {
        (SECTORS.end - SECTORS.start) as usize
    }
}

impl NorFlash for SettingsFlash {
    const WRITE_SIZE: usize = <Bank1Region1<'static, flash::Async> as NorFlash>::WRITE_SIZE;
    const ERASE_SIZE: usize = SECTOR as usize;

    async fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), flash::Error> {
        self.0.write(place(offset, bytes.len())?, bytes).await
    }

    /// The program stops for as long as it takes: the motor is switched off first, whoever has it, and the watchdog is fed.
    async fn erase(&mut self, from: u32, to: u32) -> Result<(), flash::Error> {
        let length = to.checked_sub(from).ok_or(flash::Error::Size)?;
        let first = place(from, length as usize)?;
        let mut result = Ok(());
        for at in (first..first + length).step_by(SECTOR as usize) {
            super::motor_off();
            pac::IWDG.kr().write(|w| w.set_key(Key::RESET));
            by_words();
            result = result.and(self.0.erase(at, at + SECTOR).await);
        }
        // The HAL does so for parts with two banks only: what was read from there before is still in the cache.
        pac::FLASH.acr().modify(|w| w.set_dcen(false));
        pac::FLASH.acr().modify(|w| w.set_dcrst(true));
        pac::FLASH.acr().modify(|w| w.set_dcrst(false));
        pac::FLASH.acr().modify(|w| w.set_dcen(true));
        result
    }
}

/// Erases 32 bits at once, which the supply must bear as it must for programming. By bytes, as the HAL leaves it, a sector
/// takes up to 0.8 s.
fn by_words() {
    // The HAL unlocks what is locked, and keeps PSIZE in an erase.
    if pac::FLASH.cr().read().lock() {
        pac::FLASH.keyr().write_value(0x4567_0123);
        pac::FLASH.keyr().write_value(0xCDEF_89AB);
    }
    pac::FLASH.cr().modify(|w| w.set_psize(Psize::PSIZE32));
}

#[interrupt]
unsafe fn UART4() {
    // SAFETY: this is the handler of the interrupt the executor was started with, and nobody else calls it.
    unsafe { super::MOTOR_EXECUTOR.on_interrupt() }
}

#[interrupt]
unsafe fn UART5() {
    // SAFETY: as above.
    unsafe { super::SAMPLING_EXECUTOR.on_interrupt() }
}
