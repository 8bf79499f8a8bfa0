//! Three lamps and a button: mode and fault at a glance, and a stop within reach.
//!
//! | lamp | dark | blinks, every 0.8 s | steady |
//! |---|---|---|---|
//! | green | no heading is sought | on the way to one | aligned, navigating |
//! | blue | the motor is off: idle, or cut off | | the motor may turn the rotor |
//! | red | no fault | a fault from which the unit starts again by itself | a fault that stays until it is reset |
//!
//! A press of the button is `stop`. Held for two seconds it is a start: `reset` where a fault is shown, otherwise `align`. A button that
//! is closed when the unit starts, by a short or a finger, does nothing until it has been open.

use embassy_sync::blocking_mutex::raw::RawMutex;
use embassy_time::{Duration, Timer};
use embedded_hal::digital::{InputPin, OutputPin};

use crate::command::{Command, ModeName};
use crate::mode::Status;
use crate::shared::Shared;

/// From one look at the button to the next: longer than any contact bounces.
const TICK: Duration = Duration::from_millis(50);
/// Looks that make a press: a spike from the motor is over by the second one.
const PRESS: u8 = 2;
/// Looks that make a start.
const HOLD: u8 = 40;
/// Bit of the count of looks that blinks: eight on, eight off.
const BLINK: u8 = 1 << 3;

/// What is lit.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Lamps {
    /// Heading.
    pub green: bool,
    /// Motor.
    pub blue: bool,
    /// Fault.
    pub red: bool,
}

/// Button and lamps between two looks. Pure.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Panel {
    /// Looks at which the button was closed, in a row, up to 255.
    held: u8,
    /// Looks.
    looks: u8,
}

impl Default for Panel {
    /// As if the button had been held for long: until it has been open it asks for nothing.
    fn default() -> Self {
        Self {
            held: u8::MAX,
            looks: 0,
        }
    }
}

impl Panel {
    /// One look: what is lit from here on, and what the button asks for.
    pub fn look(&mut self, pressed: bool, status: Option<&Status>, driven: bool) -> (Lamps, Option<Command>) {
        self.looks = self.looks.wrapping_add(1);
        let blinking = self.looks & BLINK != 0;
        let mode = status.map(|status| status.mode);
        let green = match mode {
            None | Some(ModeName::Idle | ModeName::Fault) => false,
            Some(ModeName::Aligned | ModeName::Navigating) => true,
            Some(_) => blinking,
        };
        let red = mode == Some(ModeName::Fault) && (blinking || status.is_some_and(|status| status.latched));
        self.held = if pressed { self.held.saturating_add(1) } else { 0 };
        let command = match self.held {
            PRESS => Some(Command::Stop),
            HOLD if mode == Some(ModeName::Fault) => Some(Command::ResetFault),
            HOLD => Some(Command::Align),
            _ => None,
        };
        (
            Lamps {
                green,
                blue: driven && mode != Some(ModeName::Idle),
                red,
            },
            command,
        )
    }
}

/// The task. Lamps green, blue, red, high where lit; the button high where pressed. A pin that fails is as if it were not there.
pub async fn run<M: RawMutex, L: OutputPin, B: InputPin>(shared: &Shared<M>, mut lamps: [L; 3], mut button: B) -> ! {
    let (mut panel, mut waiting) = (Panel::default(), None);
    loop {
        Timer::after(TICK).await;
        let pressed = button.is_high().unwrap_or(false);
        let status = shared.status.try_get();
        let (Lamps { green, blue, red }, command) = panel.look(pressed, status.as_ref(), !shared.inhibited());
        for (lamp, lit) in lamps.iter_mut().zip([green, blue, red]) {
            let _ = lamp.set_state(lit.into());
        }
        // Where commands pile up it waits for its turn: a stop is not lost.
        waiting = command.or(waiting);
        if let Some(command) = waiting
            && shared.commands.try_send(command).is_ok()
        {
            waiting = None;
        }
    }
}

#[cfg(test)]
mod tests {
    use core::cell::Cell;
    use core::convert::Infallible;

    use embassy_time::Instant;
    use embedded_hal::digital::ErrorType;
    use std::rc::Rc;
    use std::vec::Vec;
    use vtime::{Executor, Level, LocalRawMutex, Stop};

    use super::*;
    use crate::settings::Settings;

    fn status(mode: ModeName, latched: bool) -> Status {
        Status {
            mode,
            since_us: 0,
            fault: None,
            latched,
            attempts: 0,
        }
    }

    /// Share of four periods in which each lamp is lit.
    fn lit(mode: Option<ModeName>, latched: bool) -> [f32; 3] {
        let (mut panel, mut sums) = (Panel::default(), [0.0; 3]);
        for _ in 0..64 {
            let status = mode.map(|mode| status(mode, latched));
            let (lamps, command) = panel.look(false, status.as_ref(), true);
            assert_eq!(command, None);
            for (sum, lit) in sums.iter_mut().zip([lamps.green, lamps.blue, lamps.red]) {
                *sum += f32::from(u8::from(lit)) / 64.0;
            }
        }
        sums
    }

    #[test]
    fn lamps_tell_mode_and_fault() {
        for (mode, expected) in [
            (None, [0.0, 1.0, 0.0]),
            (Some(ModeName::Idle), [0.0, 0.0, 0.0]),
            (Some(ModeName::SelfTest), [0.5, 1.0, 0.0]),
            (Some(ModeName::Homing), [0.5, 1.0, 0.0]),
            (Some(ModeName::Coarse), [0.5, 1.0, 0.0]),
            (Some(ModeName::Fine), [0.5, 1.0, 0.0]),
            (Some(ModeName::Aligned), [1.0, 1.0, 0.0]),
            (Some(ModeName::Navigating), [1.0, 1.0, 0.0]),
            (Some(ModeName::Fault), [0.0, 1.0, 0.5]),
        ] {
            let found = lit(mode, false);
            assert!(
                found.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-3),
                "{mode:?}: {found:?}"
            );
        }
        assert!((lit(Some(ModeName::Fault), true)[2] - 1.0).abs() < 1e-3);
    }

    /// A pin and what it was set to, or what it is driven to.
    #[derive(Clone, Default)]
    struct Pin(Rc<Cell<bool>>);

    impl ErrorType for Pin {
        type Error = Infallible;
    }

    impl OutputPin for Pin {
        fn set_low(&mut self) -> Result<(), Infallible> {
            self.0.set(false);
            Ok(())
        }

        fn set_high(&mut self) -> Result<(), Infallible> {
            self.0.set(true);
            Ok(())
        }
    }

    impl InputPin for Pin {
        fn is_high(&mut self) -> Result<bool, Infallible> {
            Ok(self.0.get())
        }

        fn is_low(&mut self) -> Result<bool, Infallible> {
            Ok(!self.0.get())
        }
    }

    /// What the button asks for that is closed from and to these times, ms; and the lamps after 10 s.
    fn asked(mode: ModeName, presses: &'static [(u64, u64)]) -> (Vec<Command>, [bool; 3]) {
        let shared = Rc::new(Shared::<LocalRawMutex>::new("0", Settings::default()));
        shared.status.sender().send(status(mode, true));
        let (lamps, button): ([Pin; 3], Pin) = Default::default();
        let mut unit = Executor::new();
        let (s, l, b) = (Rc::clone(&shared), lamps.clone(), button.clone());
        unit.spawn("panel", Level::Thread, async move { run(&s, l, b).await });
        unit.spawn("finger", Level::World, async move {
            for (from, to) in presses {
                Timer::at(Instant::from_millis(*from)).await;
                button.0.set(true);
                Timer::at(Instant::from_millis(*to)).await;
                button.0.set(false);
            }
        });
        assert_eq!(unit.run_until(Instant::from_secs(10)), Ok(Stop::Deadline));
        let commands = core::iter::from_fn(|| shared.commands.try_receive().ok()).collect();
        (commands, lamps.map(|lamp| lamp.0.get()))
    }

    #[test]
    fn a_press_stops_and_holding_starts() {
        use Command::{Align, ResetFault, Stop};
        type Case = (ModeName, &'static [(u64, u64)], &'static [Command]);
        let cases: [Case; 9] = [
            (ModeName::Aligned, &[(1000, 1020)], &[]),
            (ModeName::Aligned, &[(1000, 1300)], &[Stop]),
            (ModeName::Aligned, &[(1000, 1300), (2000, 2200)], &[Stop, Stop]),
            (ModeName::Idle, &[(1000, 2900)], &[Stop]),
            (ModeName::Idle, &[(1000, 3100)], &[Stop, Align]),
            // However long: one start.
            (ModeName::Idle, &[(1000, 9000)], &[Stop, Align]),
            (ModeName::Fault, &[(1000, 3100)], &[Stop, ResetFault]),
            // Closed from the start on.
            (ModeName::Idle, &[(0, 5000)], &[]),
            (ModeName::Idle, &[(0, 5000), (6000, 8100)], &[Stop, Align]),
        ];
        for (mode, presses, expected) in cases {
            assert_eq!(asked(mode, presses).0, expected, "{mode:?} {presses:?}");
        }
        // Nothing has released the motor, and the fault stays.
        assert_eq!(asked(ModeName::Fault, &[]).1, [false, false, true]);
        assert_eq!(asked(ModeName::Aligned, &[]).1, [true, false, false]);
    }
}
