//! The application of a rotary IMU unit, generic over its hardware.
#![no_std]

pub mod rotor;
