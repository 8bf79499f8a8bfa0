//! Simulator of a rotary MEMS IMU unit.
//!
//! ```text
//! scenario ─► truth ─► sensors ─┬─► nav::aligner ─► simulate ─► monte_carlo, plot, report
//!                │              └─► log ─► replay ─► nav::aligner
//!                └─► plant ─► device ─► bus ─► app ─► unit_sim          (in virtual time)
//! ```
//!
//! Three levels, each slower and more real than the one before: the core fed with samples ([`simulate`]), the whole
//! application on simulated buses ([`unit_sim`]), and the image on an emulated chip, in `emulator`, a crate of its own.
//!
//! Truth is closed-form in f64 and its increments are exact; errors are drawn from one seed; the core is
//! the firmware's own, in f32. Frames, signs and names are those of [`frames`].

pub mod align;
pub mod allan;
pub mod bound;
pub mod bus;
pub mod calibrate;
pub mod config;
pub mod device;
mod dial;
pub mod inspect;
pub mod link;
pub mod log;
pub mod monte_carlo;
pub mod nmea;
pub mod observability;
pub mod outcome;
pub mod plant;
pub mod plot;
pub mod replay;
pub mod report;
pub mod reproduce;
pub mod rotation;
pub mod scenario;
pub mod sea;
pub mod sensors;
pub mod simulate;
pub mod soak;
pub mod truth;
pub mod turn;
pub mod unit;
pub mod unit_sim;
