//! The mathematics of a rotary IMU that finds true north and its own attitude on a swinging base.
//!
//! Synchronous, `no_std`, without heap, logging or clock: samples in, estimates out. Generic over the
//! scalar, so that the target's f32 and the host's f64 run the same lines and rounding can be measured.
//!
//! # The way of a sample
//!
//! ```text
//! Sample ──► ConingScullingCorrector ──► Decimator ──┬──► Coarse ──► CoarseSolution
//! (Δθ, Δv)   rotation,       20 Hz       │                    │ attitude at the start
//!            coning,                     └──► queue ──► FineFilter ──► Estimate
//!            sculling                                   replay, then live
//! ```
//!
//! [`aligner::Aligner`] drives all of it; the parts stand alone. What is known at its end [`navigator::Navigator`] carries
//! on, and [`calibration::Calibrator`] finds what the rotor adds to the gyros' errors.
//!
//! ```
//! use frames::Vec3;
//! use nav::{aligner::{Aligner, AlignerConfig}, fine::FilterConfig, increment::Sample, rotor::RotorConfig};
//!
//! let config = AlignerConfig::for_rotor(0.7_f32, 0.0, &RotorConfig::default(), FilterConfig::default());
//! let mut aligner: Aligner = Aligner::new(config)?;
//! let sample = Sample { dtheta_s: Vec3::new(0.0, 0.0, 3.5e-3), dv_s: Vec3::new(0.0, 0.0, 0.098), dt: 0.01, gap: 0.0 };
//! let event = aligner.step(&sample, 3.5e-3);
//! assert!(event.is_none() && aligner.estimate().is_none() && aligner.not_ready().is_some());
//! # Ok::<(), nav::aligner::AlignerError>(())
//! ```
//!
//! # Sources
//!
//! * \[Xing18\] Xing et al., *Self-Alignment MEMS IMU Method Based on the Rotation Modulation Technique
//!   on a Swing Base*, Sensors 2018, 18, 1178: the method.
//! * \[Yu15\] *A Stationary North-Finding Scheme for an Azimuth Rotational IMU Utilizing a Linear State Equality
//!   Constraint*, Sensors 2015, 15(2), 4368: the [encoder constraint](constraint).
//! * \[Du16\] Du, Sun, Gao, *MEMS IMU Error Mitigation Using Rotation Modulation Technique*, Sensors
//!   2016, 16, 2017.
//!
//! Frames, signs and names are those of [`frames`].
#![no_std]

pub mod adaptive_noise;
pub mod aligner;
pub mod calibration;
#[cfg(test)]
mod chance;
pub mod coarse;
pub mod constraint;
pub mod covariance;
pub mod delay;
pub mod deviation;
pub mod earth;
pub mod fading;
pub mod fine;
pub mod increment;
pub mod mechanization;
pub mod model;
pub mod navigator;
pub mod noise;
pub mod north;
pub mod rotor;
pub mod strapdown;
