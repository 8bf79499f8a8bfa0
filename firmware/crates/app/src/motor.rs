//! The motor's loop: encoder, rotor control, bridge, at the period of the rotor's configuration.
//!
//! One tick: read, correct, control, put out. The outputs are off before anything is reported; they go on only in a tick
//! that has looked at [`Shared::inhibited`] after its reading, and waits for nothing from there on.

use drivers::harmonics::Harmonics;
use drivers::motor::{MotorDriver, ThreePhase};
use drivers::mt6835::Warnings;
use embassy_futures::select::{Either, select};
use embassy_sync::blocking_mutex::raw::RawMutex;
use embassy_time::{Duration, Instant, Ticker};
use embedded_hal::digital::{InputPin, OutputPin};

use crate::fault::{Fault, Task};
use crate::hal::{Encoder, HomeSwitch};
use crate::mode::{Input, RotorKnows};
use crate::rotor::{Command, Inputs, Rotor, State};
use crate::settings::HARMONICS;
use crate::shared::{AngleAt, Shared};

/// Readings with warnings in a row that make a fault.
const WARNINGS: u16 = 20;

/// Bridge, timer, switch: what the loop acts on.
#[derive(Debug)]
pub struct Drive<Enable, NFault, Pwm, Home> {
    /// Enable and fault lines.
    pub driver: MotorDriver<Enable, NFault>,
    /// The three outputs.
    pub pwm: Pwm,
    /// The home switch.
    pub home: Home,
}

impl<Enable: OutputPin, NFault: InputPin, Pwm: ThreePhase, Home> Drive<Enable, NFault, Pwm, Home> {
    fn off(&mut self) {
        self.pwm.outputs_off();
        // Where the pin refuses, the outputs are off all the same.
        let _ = self.driver.disable();
    }
}

/// The task. The rotor is the caller's: it is large, and its learned table belongs into the settings.
pub async fn run<M, Enc, Enable, NFault, Pwm, Home>(
    shared: &Shared<M>,
    mut encoder: Enc,
    mut drive: Drive<Enable, NFault, Pwm, Home>,
    rotor: &mut Rotor,
    correction: Harmonics<HARMONICS>,
) -> !
where
    M: RawMutex,
    Enc: Encoder,
    Enable: OutputPin,
    NFault: InputPin,
    Pwm: ThreePhase,
    Home: HomeSwitch,
{
    drive.off();
    let mut started = false;
    let mut on = false;
    let mut warned = 0_u16;
    let mut side = None;
    let mut ticker = Ticker::every(Duration::from_micros(u64::from(rotor.config().dt_us)));
    loop {
        if let Either::Second(()) = select(ticker.next(), shared.encoder_start.wait()).await {
            // Talks to the encoder for some ticks: not while the motor runs.
            if on {
                drive.off();
                on = false;
            }
            let _ = rotor.command(Command::Off);
            // Warnings that last are found again after each start.
            warned = 0;
            let answer = shared.with_check_in(Task::Motor, encoder.start()).await;
            shared.measure(|measured| measured.encoder = Some(answer.is_ok()));
            started = match answer {
                Ok(()) => {
                    shared.tell(Input::Encoder(Ok(RotorKnows {
                        calibrated: rotor.electrical_offset().is_some(),
                        homed: rotor.homed(),
                    })));
                    true
                }
                Err(error) => {
                    shared.tell(Input::Encoder(Err(error)));
                    false
                }
            };
            ticker.reset();
            continue;
        }
        shared.check_in(Task::Motor);
        if !started {
            continue;
        }
        let t_us = Instant::now().as_micros();
        let reading = encoder.read().await.ok();
        warned = match reading {
            Some(reading) if !reading.warnings.is_empty() => warned.saturating_add(1),
            _ => 0,
        };
        let inputs = Inputs {
            reading: reading.map(|reading| correction.correct(reading.angle.radians())),
            home: drive.home.side(),
            // A line that cannot be read is a fault.
            driver_fault: drive.driver.fault().unwrap_or(true),
        };
        if side.replace(inputs.home) != Some(inputs.home) {
            shared.measure(|measured| measured.home = side);
        }

        if shared.inhibited() {
            if on {
                drive.off();
                on = false;
            }
            // In a fault of its own the rotor is off already and refuses; that is as good.
            let _ = rotor.command(Command::Off);
        } else {
            execute(shared, rotor);
        }
        let before = Activity::of(rotor.state());
        let outputs = rotor.tick(&inputs);
        let mut fault = None;
        match outputs.drive {
            Some(duties) => {
                drive.pwm.set_duties(duties);
                if !on {
                    on = drive.driver.enable().is_ok();
                    if !on {
                        fault = Some(Fault::Driver);
                    }
                }
            }
            None if on => {
                drive.off();
                on = false;
            }
            None => {}
        }
        shared.publish_angle(outputs.angle.map(|angle| AngleAt {
            t_us,
            angle,
            rate: outputs.rate,
        }));
        match (before, Activity::of(rotor.state())) {
            (Activity::Calibrating, Activity::Off) => {
                if let Some(offset) = rotor.electrical_offset() {
                    shared.change(|settings| settings.encoder.electrical_offset = Some(offset));
                    shared.tell(Input::Calibrated { offset });
                }
            }
            (Activity::Homing, Activity::Off) => {
                if let Some(angle) = outputs.angle {
                    shared.measure(|measured| measured.homed = Some(angle));
                    shared.tell(Input::Homed { angle });
                }
            }
            (Activity::Fault, _) => {}
            (_, Activity::Fault) => {
                if let State::Fault(found) = *rotor.state() {
                    fault = Some(Fault::from(found));
                }
            }
            _ => {}
        }
        if warned == WARNINGS {
            let warnings = reading.map_or(Warnings::NONE, |reading| reading.warnings);
            fault = fault.or(Some(Fault::EncoderWarning { warnings }));
        }
        if let Some(fault) = fault {
            if core::mem::replace(&mut on, false) {
                drive.off();
            }
            shared.raise(fault);
        }
    }
}

/// Hands the rotor what the supervisor asks of it.
fn execute<M: RawMutex>(shared: &Shared<M>, rotor: &mut Rotor) {
    while let Ok(command) = shared.rotor.try_receive() {
        match rotor.command(command) {
            Ok(()) => {
                // Switch and encoder may forbid it at once: the tick that follows finds the rotor in fault already.
                if let State::Fault(found) = *rotor.state() {
                    shared.raise(Fault::from(found));
                }
                // A slip ring needs no search: the turn is known at once.
                if command == Command::Home && rotor.homed() && *rotor.state() == State::Off {
                    shared.tell(Input::Homed { angle: 0.0 });
                }
            }
            Err(refused) => shared.raise(Fault::RotorRefused(refused)),
        }
    }
}

/// The rotor's states without what is in them.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Activity {
    Off,
    Calibrating,
    Homing,
    Other,
    Fault,
}

impl Activity {
    fn of(state: &State) -> Self {
        match state {
            State::Off => Self::Off,
            State::Calibrating(_) => Self::Calibrating,
            State::Homing(_) => Self::Homing,
            State::Running(_) | State::Stopping(_) => Self::Other,
            State::Fault(_) => Self::Fault,
        }
    }
}

#[cfg(test)]
mod tests {
    use std::rc::Rc;
    use std::vec::Vec;

    use drivers::Error;
    use drivers::motor::Duty;
    use drivers::mt6835::{AngleCounts, Reading};
    use embassy_time::Timer;
    use embedded_hal::digital::ErrorType;
    use std::convert::Infallible;
    use vtime::{Executor, Level, LocalRawMutex, Stop};

    use super::*;
    use crate::hal::NoSwitch;
    use crate::rotor::Config;
    use crate::settings::Settings;

    /// An encoder whose magnet is too weak, for good.
    struct Weak;

    impl Encoder for Weak {
        async fn start(&mut self) -> Result<(), Error> {
            Timer::after_millis(3).await;
            Ok(())
        }

        async fn read(&mut self) -> Result<Reading, Error> {
            Ok(Reading {
                angle: AngleCounts::new(77),
                warnings: Warnings::WEAK_FIELD,
            })
        }
    }

    struct Pin;

    impl ErrorType for Pin {
        type Error = Infallible;
    }

    impl OutputPin for Pin {
        fn set_low(&mut self) -> Result<(), Infallible> {
            Ok(())
        }

        fn set_high(&mut self) -> Result<(), Infallible> {
            Ok(())
        }
    }

    impl InputPin for Pin {
        fn is_high(&mut self) -> Result<bool, Infallible> {
            Ok(true)
        }

        fn is_low(&mut self) -> Result<bool, Infallible> {
            Ok(false)
        }
    }

    struct NoBridge;

    impl ThreePhase for NoBridge {
        fn set_duties(&mut self, _: [Duty; 3]) {}

        fn outputs_off(&mut self) {}
    }

    #[test]
    fn warnings_that_last_are_found_after_every_start() {
        let mut unit = Executor::new();
        let shared = Rc::new(Shared::<LocalRawMutex>::new("0.0.0", Settings::default()));
        let s = Rc::clone(&shared);
        unit.spawn("motor", Level::Interrupt, async move {
            let mut rotor = Rotor::new(Config::default()).unwrap();
            let drive = Drive {
                driver: MotorDriver::new(Pin, Pin).unwrap(),
                pwm: NoBridge,
                home: NoSwitch,
            };
            run(&s, Weak, drive, &mut rotor, Harmonics::default()).await
        });
        for start in 1..=3_u64 {
            shared.release();
            shared.encoder_start.signal(());
            let end = Instant::from_millis(500 * start);
            assert_eq!(unit.run_until(end), Ok(Stop::Deadline));
            let told: Vec<Input> = core::iter::from_fn(|| shared.inputs.try_receive().ok()).collect();
            let warnings = Warnings::WEAK_FIELD;
            assert!(
                matches!(
                    told[..],
                    [Input::Encoder(Ok(_)), Input::Fault(Fault::EncoderWarning { warnings: found })] if found == warnings
                ),
                "start {start}: {told:?}"
            );
            assert!(shared.inhibited());
        }
    }
}
