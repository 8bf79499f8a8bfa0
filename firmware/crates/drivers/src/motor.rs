//! Three-phase bridge of the DRV8313 kind: an enable line, a fault line, three duties.
//!
//! The driver owns the two lines; the duties are the timer's, behind [`ThreePhase`], which the
//! firmware implements on TIM1 and the simulator on its plant. Off means off twice: `outputs_off`
//! takes the timer's outputs away, [`MotorDriver::disable`] the bridge.
//!
//! # Sources
//!
//! DRV8313: enables active high, nFAULT open drain and low in fault (it needs a pull-up), thermal
//! shutdown that releases by itself, over-current that stays until the part is reset (nRESET or
//! nSLEEP): from memory of the TI data sheet SLVSBA5, not checked against a copy, not verified on
//! hardware.
//!
//! Not modelled: the separate nSLEEP and nRESET lines. Where the board brings them out they belong to
//! its `board.rs`; a part that sleeps while disabled is awake about 1 ms after `enable`.

use embedded_hal::digital::{InputPin, OutputPin};

use crate::Error;

/// Share of the PWM period for which a phase is high, in [0, 1].
#[derive(Debug, Clone, Copy, PartialEq, PartialOrd, Default)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Duty(f32);

impl Duty {
    /// The phase stays low.
    pub const OFF: Self = Self(0.0);
    /// Half of the supply: with all three phases here the motor sees no voltage.
    pub const HALF: Self = Self(0.5);

    /// The nearest duty to `share`; zero for a NaN.
    pub fn new(share: f32) -> Self {
        if share > 0.0 { Self(share.min(1.0)) } else { Self::OFF }
    }

    /// The share, in [0, 1].
    pub fn share(self) -> f32 {
        self.0
    }

    /// The compare value for a timer that counts to `top`, rounded to the nearest.
    pub fn compare(self, top: u16) -> u16 {
        // In [0, top + 0.5]: the cast truncates and cannot overflow.
        (self.0 * f32::from(top) + 0.5) as u16
    }
}

/// The three PWM outputs.
pub trait ThreePhase {
    /// Sets the duties of phases A, B, C, to take effect together at the next period.
    fn set_duties(&mut self, duties: [Duty; 3]);

    /// Takes all three outputs away at once, without waiting for the period: the motor coasts.
    /// The next `set_duties` brings them back.
    fn outputs_off(&mut self);
}

impl<T: ThreePhase + ?Sized> ThreePhase for &mut T {
    fn set_duties(&mut self, duties: [Duty; 3]) {
        (**self).set_duties(duties);
    }
    fn outputs_off(&mut self) {
        (**self).outputs_off();
    }
}

/// The bridge's enable and fault lines.
#[derive(Debug)]
pub struct MotorDriver<Enable, NFault> {
    enable: Enable,
    n_fault: NFault,
}

impl<Enable: OutputPin, NFault: InputPin> MotorDriver<Enable, NFault> {
    /// Takes the lines and switches the bridge off.
    ///
    /// # Errors
    /// [`Error::Pin`].
    pub fn new(enable: Enable, n_fault: NFault) -> Result<Self, Error> {
        let mut driver = Self { enable, n_fault };
        driver.disable()?;
        Ok(driver)
    }

    /// Switches the bridge on, unless it reports a fault.
    ///
    /// # Errors
    /// [`Error::DriverFault`] or [`Error::Pin`]; the bridge is off then.
    pub fn enable(&mut self) -> Result<(), Error> {
        match self.fault() {
            Ok(false) => self.enable.set_high().map_err(Error::pin),
            Ok(true) => {
                self.disable()?;
                Err(Error::DriverFault)
            }
            Err(error) => {
                self.disable()?;
                Err(error)
            }
        }
    }

    /// Switches the bridge off.
    ///
    /// # Errors
    /// [`Error::Pin`].
    pub fn disable(&mut self) -> Result<(), Error> {
        self.enable.set_low().map_err(Error::pin)
    }

    /// Whether the bridge reports a fault.
    ///
    /// # Errors
    /// [`Error::Pin`]: treat it as a fault.
    pub fn fault(&mut self) -> Result<bool, Error> {
        self.n_fault.is_low().map_err(Error::pin)
    }

    /// Gives the lines back, the bridge switched off if the pin allows.
    pub fn release(mut self) -> (Enable, NFault) {
        // Nothing is left to do where the pin refuses: the caller holds it now.
        let _ = self.disable();
        (self.enable, self.n_fault)
    }
}

#[cfg(test)]
mod tests {
    use embedded_hal::digital::ErrorKind;
    use embedded_hal_mock::eh1::MockError;
    use embedded_hal_mock::eh1::digital::{Mock, State, Transaction};

    use super::*;

    fn driver(enable: &[Transaction], n_fault: &[Transaction]) -> (MotorDriver<Mock, Mock>, Mock, Mock) {
        let (e, f) = (Mock::new(enable), Mock::new(n_fault));
        (MotorDriver::new(e.clone(), f.clone()).unwrap(), e, f)
    }

    #[test]
    fn off_on_off() {
        let (mut d, mut e, mut f) = driver(
            &[
                Transaction::set(State::Low),
                Transaction::set(State::High),
                Transaction::set(State::Low),
            ],
            &[Transaction::get(State::High), Transaction::get(State::High)],
        );
        d.enable().unwrap();
        assert_eq!(d.fault(), Ok(false));
        d.disable().unwrap();
        e.done();
        f.done();
    }

    #[test]
    fn a_fault_keeps_it_off() {
        let (mut d, mut e, mut f) = driver(
            &[Transaction::set(State::Low), Transaction::set(State::Low)],
            &[Transaction::get(State::Low)],
        );
        assert_eq!(d.enable(), Err(Error::DriverFault));
        e.done();
        f.done();
    }

    #[test]
    fn a_dead_fault_pin_keeps_it_off() {
        let broken = MockError::Io(std::io::ErrorKind::Other);
        let (mut d, mut e, mut f) = driver(
            &[Transaction::set(State::Low), Transaction::set(State::Low)],
            &[Transaction::get(State::High).with_error(broken)],
        );
        assert_eq!(d.enable(), Err(Error::Pin(ErrorKind::Other)));
        e.done();
        f.done();
    }

    #[test]
    fn release_switches_off() {
        let (d, mut e, mut f) = driver(&[Transaction::set(State::Low), Transaction::set(State::Low)], &[]);
        let _pins = d.release();
        e.done();
        f.done();
    }

    #[test]
    fn duties_are_clamped() {
        for (share, expected) in [
            (-0.5, 0),
            (0.0, 0),
            (0.25, 250),
            (0.5, 500),
            (1.0, 1000),
            (7.0, 1000),
            (f32::NAN, 0),
            (f32::INFINITY, 1000),
        ] {
            assert_eq!(Duty::new(share).compare(1000), expected, "{share}");
        }
        assert_eq!(Duty::new(1.0).compare(u16::MAX), u16::MAX);
    }
}
