//! The image on an emulated STM32F427: the unmodified release ELF, executed instruction by instruction, with the
//! simulator's own devices on its buses, its motor and its moving base.
//!
//! The third level of the simulator, see [`hal_sim`]: the core fed with samples, the whole application on simulated
//! buses, and here everything that is compiled into the image: drivers of the chip, interrupts, DMA, priorities, stacks.
//!
//! | module | what is in it |
//! |---|---|
//! | [`run`] | a scenario with the image in it, and how it ended |
//! | [`probe`] | any image on the bare part, its memory read by symbol |
//! | [`part`], [`board`], [`chips`] | the STM32F427 of crate `rigless`, the wires, what hangs on them |
//! | [`image`], [`load`], [`stack`] | what the image costs: flash, RAM, instructions, stack |
//! | [`log`], [`nmea`] | what the unit says |
//!
//! # What it is, and what it is not
//!
//! Every peripheral is a model at its registers, every instruction is executed, single-precision arithmetic is exact to
//! the bit. Time counts instructions, not clocks: see [`board::INSTRUCTIONS_PER_SECOND`]. The flash is
//! erased and written, and keeps what is stored. Where the emulator cannot stand in for the part it says so, see
//! [`outcome::Gaps`].
//!
//! A run is a function of image and setup: the same ones give the same log.

pub mod board;
pub mod chips;
pub mod error;
pub mod image;
pub mod load;
pub mod log;
pub mod nmea;
pub mod outcome;
pub mod part;
pub mod probe;
pub mod report;
pub mod run;
pub mod stack;
