//! Drivers of the unit's devices over the embedded-hal traits: two IMUs, an absolute encoder, a
//! three-phase bridge.
//!
//! No heap, no clock, no logging, no panic on data: what a device sends is either a checked value
//! or an [`Error`] with the facts in it. Registers and command words are public constants, because
//! the device models of the simulator answer to the same ones.
//!
//! | module | device | bus |
//! |---|---|---|
//! | [`adis16495`] | ADIS16495-1, the reference IMU | SPI mode 3, ≤ 6 MHz in bursts, 16-bit frames |
//! | [`icm42688`] | ICM-42688-P, the development IMU | SPI mode 0 or 3, ≤ 24 MHz, bytes |
//! | [`mt6835`] | MT6835, 21-bit encoder | SPI mode 3, ≤ 16 MHz, bytes |
//! | [`motor`] | three half-bridges of the DRV8313 kind | pins and PWM |
//! | [`sequence`] | lost and repeated samples | none |
//! | [`harmonics`] | an encoder's correction table | none |
//!
//! # From counts to SI
//!
//! Counts are newtypes ([`RateCounts`], [`ForceCounts`], [`TemperatureCounts`],
//! [`mt6835::AngleCounts`]). They become SI once, through [`Scale::si`] or
//! [`mt6835::AngleCounts::radians`], and never travel on as bare integers.
//!
//! # Cancellation
//!
//! One rule holds for every async function here. *The driver's own state survives*: what it believes
//! about a device (the selected page or bank) is forgotten before a transaction that changes it and
//! learnt only when that has ended well. *The bus does not*: whether dropping a transaction in flight
//! releases chip select is the affair of the `SpiDevice`. Let a transfer finish; put the timeout around
//! the wait for data-ready, not around the transfer. Every function says on top of this what a
//! dropped call leaves behind in the device.
//!
//! # Features
//!
//! `defmt`: `defmt::Format` on errors and small data types, for the target.
#![no_std]

pub mod adis16495;
pub mod crc;
mod error;
pub mod harmonics;
pub mod icm42688;
mod imu;
pub mod motor;
pub mod mt6835;
pub mod sequence;

#[cfg(test)]
extern crate std;
#[cfg(test)]
mod testing;

pub use error::Error;
pub use imu::{
    Channels, ForceCounts, Identity, Imu, RateCounts, RawSample, Scale, Sequence, SiSample, Status, SystemFlags,
    TemperatureCounts,
};
