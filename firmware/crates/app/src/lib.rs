//! The application of a rotary IMU unit, generic over its hardware.
//!
//! Everything that runs in the unit apart from the board: the same bodies run as embassy tasks on the STM32 and
//! in virtual time in the simulator. No heap, no statics, no clock but `embassy_time`, no panics.
//!
//! | module | what |
//! |---|---|
//! | [`hal`] | what a board must give |
//! | [`shared`] | what the tasks share: one [`Shared`](shared::Shared) |
//! | [`sample`] | a sample on its way |
//! | [`sampling`] | IMU at its data-ready edge → increments with time, gap and rotor angle |
//! | [`motor`] | encoder → [`rotor`] control → bridge, 1 kHz |
//! | [`alignment`] | samples → estimates |
//! | [`supervisor`] | modes, faults, check-ins, watchdog |
//! | [`blackbox`] | what a reset must not wipe out, pure |
//! | [`command`] | commands to the unit, and its modes' names |
//! | [`mode`] | the modes' step function, pure |
//! | [`fault`] | faults and the rule for each |
//! | [`selftest`] | what must hold before anything turns |
//! | [`log`] | typed events |
//! | [`nmea`] | sentences of NMEA 0183, pure |
//! | [`output`] | estimates and status → sentences on a serial line |
//! | [`record`] | samples and status → frames of a binary log, pure |
//! | [`sample_recorder`] | where samples leave for the record |
//! | [`panel`] | lamps and a button |
//! | [`report`] | what the unit does → a line of the log, once a second |
//! | [`settings`] | the unit's settings, and their store in flash |
//! | [`nmea_in`] | sentences of a receiver, pure |
//! | [`utc`] | the receiver's time of day, carried on |
//! | [`console`] | commands on a serial line, their grammar, and what they do |
//! | [`rotor`] | the motor's control, pure |
//!
//! # The tasks
//!
//! Eight bodies, each a plain `async fn(…) -> !` generic over its hardware and the raw mutex. A board wraps each into
//! an `#[embassy_executor::task]`: [`motor::run`] and, below it, [`sampling::run`] at interrupt level; at thread level
//! [`alignment::run`], [`supervisor::run`], [`output::run`], [`console::run`], [`report::run`] and [`panel::run`].
//!
//! A fault takes three ways at once, so that the motor is off whatever hangs: whoever finds it inhibits the motor
//! (the motor's loop executes it at its next tick), the supervisor cuts the outputs past the loop, and a supervisor that
//! does not run no longer feeds the watchdog.
#![no_std]

#[cfg(test)]
extern crate std;

pub mod alignment;
pub mod blackbox;
#[cfg(test)]
mod chance;
pub mod command;
pub mod console;
pub mod fault;
mod fixed_decimal;
pub mod hal;
pub mod log;
pub mod mode;
pub mod motor;
pub mod nmea;
pub mod nmea_in;
pub mod output;
pub mod panel;
pub mod parts;
pub mod record;
pub mod report;
pub mod rotor;
pub mod sample;
pub mod sample_recorder;
pub mod sampling;
pub mod selftest;
pub mod settings;
pub mod shared;
pub mod supervisor;
pub mod utc;
