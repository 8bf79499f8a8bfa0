//! The mathematics of a rotary IMU: synchronous, without heap, logging or clock.
#![no_std]

pub mod earth;
pub mod rotor;
