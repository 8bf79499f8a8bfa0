//! The mathematics of a rotary IMU: synchronous, without heap, logging or clock.
#![no_std]

pub mod aligner;
pub mod coarse;
pub mod covariance;
pub mod earth;
pub mod fading;
pub mod fine;
pub mod increment;
pub mod noise;
pub mod rotor;
