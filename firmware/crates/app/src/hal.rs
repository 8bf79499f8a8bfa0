//! What the application asks of a board beyond the embedded-hal traits.
//!
//! | trait | on the board | in the simulator |
//! |---|---|---|
//! | [`EdgeCapture`] | data-ready on EXTI, stamped in the interrupt | `bus::Input::rising` |
//! | [`Encoder`] | [`MagneticEncoder`] on SPI | the same |
//! | [`HomeSwitch`] | [`ChangeOver`] of two inputs | the same |
//! | [`Cutoff`] | MOE of TIM1 and the bridge's enable line, by register | the plant's bridge |
//! | [`Watchdog`] | IWDG | a counter |
//! | [`Supply`] | PVD and the option bytes' brown-out level | as told |
//!
//! What its clock goes by, the board tells by [`ClockSource`].
//!
//! The bridge itself is a [`drivers::motor::MotorDriver`] and a [`drivers::motor::ThreePhase`].

use drivers::Error;
use drivers::mt6835::{self, Mt6835, Reading};
use embedded_hal::digital::InputPin;
use embedded_hal_async::spi::SpiDevice;

use crate::rotor::Side;

/// A data-ready edge.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Edge {
    /// When it came, µs of the unit's clock: taken in the interrupt, not when a task was woken.
    pub t_us: u64,
    /// Edges since the one told before that nobody took.
    pub overrun: u32,
}

/// A line whose edges are stamped as they come.
#[allow(
    async_fn_in_trait,
    reason = "one core, one executor a task: no future crosses a thread"
)]
pub trait EdgeCapture {
    /// The next edge that was not told yet; the last one if there are several.
    ///
    /// Cancellation: must be safe. A dropped call loses no edge.
    async fn edge(&mut self) -> Edge;
}

impl<T: EdgeCapture + ?Sized> EdgeCapture for &mut T {
    async fn edge(&mut self) -> Edge {
        (**self).edge().await
    }
}

/// The rotor's absolute encoder.
#[allow(
    async_fn_in_trait,
    reason = "one core, one executor a task: no future crosses a thread"
)]
pub trait Encoder {
    /// Identifies the part and writes its settings.
    ///
    /// # Errors
    /// Those of the driver.
    async fn start(&mut self) -> Result<(), Error>;

    /// Reads the angle.
    ///
    /// # Errors
    /// Those of the driver.
    async fn read(&mut self) -> Result<Reading, Error>;
}

/// An MT6835 with its settings.
#[derive(Debug)]
pub struct MagneticEncoder<SPI> {
    /// The driver.
    pub driver: Mt6835<SPI>,
    /// The settings.
    pub config: mt6835::Config,
}

impl<SPI: SpiDevice> Encoder for MagneticEncoder<SPI> {
    async fn start(&mut self) -> Result<(), Error> {
        self.driver.identify().await?;
        self.driver.configure(&self.config).await
    }

    async fn read(&mut self) -> Result<Reading, Error> {
        self.driver.read().await
    }
}

/// The home switch.
pub trait HomeSwitch {
    /// The side the rotor is on; `None` where the contacts contradict each other or cannot be read.
    fn side(&mut self) -> Option<Side>;
}

/// A change-over contact on two inputs: one is high, the other low.
#[derive(Debug)]
pub struct ChangeOver<Below, Above> {
    /// High below the edge.
    pub below: Below,
    /// High above it.
    pub above: Above,
}

impl<Below: InputPin, Above: InputPin> HomeSwitch for ChangeOver<Below, Above> {
    fn side(&mut self) -> Option<Side> {
        match (self.below.is_high(), self.above.is_high()) {
            (Ok(true), Ok(false)) => Some(Side::Below),
            (Ok(false), Ok(true)) => Some(Side::Above),
            _ => None,
        }
    }
}

/// No switch: for a slip ring.
#[derive(Debug, Clone, Copy, Default)]
pub struct NoSwitch;

impl HomeSwitch for NoSwitch {
    fn side(&mut self) -> Option<Side> {
        None
    }
}

/// Takes the motor's outputs away past the motor task, which may be the one that hangs.
pub trait Cutoff {
    /// Outputs and bridge off, now. The next `set_duties` and `enable` of the motor task undo it; it makes
    /// none while [`Shared::inhibited`](crate::shared::Shared::inhibited).
    fn cut(&mut self);
}

/// The hardware watchdog.
pub trait Watchdog {
    /// Puts the reset off once more.
    fn feed(&mut self);
}

/// The part's supply, in the eyes of who writes its flash.
///
/// Below 2.7 V words of 32 bits are not programmed for sure: they may read as they should at once and not later, which no
/// check sum at the time of the save can see.
pub trait Supply {
    /// Whether it is enough, now.
    fn is_enough(&mut self) -> bool;

    /// Whether a supply that falls while flash is written ends in a reset before it is too low: a save that is cut off
    /// is distinguished from a whole one, see [`Store`](crate::settings::Store).
    fn is_guarded(&self) -> bool;
}

/// What the unit's clock goes by.
///
/// The length of every sample is measured by that clock: gyro angles are wrong by as much as it is. Rates are not, and Earth's
/// rate is found by rates; but the rotor's angle by the encoder is held against the gyros', and 1 % of a turn is 3.6°.
/// The filter takes scale factors for known to some hundred ppm, and what it makes of ten times as much was not measured.
/// So a unit that goes by the chip's own oscillator does all it can but stand by a heading:
///
/// * it is never `aligned`: it stays in `fine`, THS is V, the reason `clock`; it does not navigate;
/// * it does not calibrate its gyros: the scale factor that it would keep were the clock's;
/// * the clocks of IMU and unit may differ by more before that is a fault.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum ClockSource {
    /// A crystal, or what another part makes of one: below 100 ppm.
    #[default]
    Crystal,
    /// The chip's own oscillator, because nothing came in from outside.
    Internal,
}

impl ClockSource {
    /// How far it may be off, as a share. Of the internal one: −8 to +4.5 % as delivered, over −40 to 105 °C; 1 % at 25 °C
    /// (DS9405, HSI characteristics).
    pub const fn tolerance(self) -> f32 {
        match self {
            Self::Crystal => 0.0,
            Self::Internal => 0.08,
        }
    }

    /// Whether a heading may be told that was found by it, see [there](Self).
    pub const fn is_exact(self) -> bool {
        matches!(self, Self::Crystal)
    }
}

/// Why the unit started.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ResetCause {
    /// The supply came.
    PowerOn,
    /// The supply dipped.
    BrownOut,
    /// The watchdog was not fed.
    Watchdog,
    /// The reset line.
    Pin,
    /// The program itself: an update, a panic.
    Software,
    /// The board does not tell.
    Unknown,
}

frames::wording!(ResetCause, |self, say| {
    match self {
        Self::PowerOn => say!("power on"),
        Self::BrownOut => say!("brown-out"),
        Self::Watchdog => say!("watchdog"),
        Self::Pin => say!("reset line"),
        Self::Software => say!("software"),
        Self::Unknown => say!("unknown"),
    }
});
