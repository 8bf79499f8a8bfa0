//! x
#![allow(missing_docs, reason = "skeleton")]

pub mod align;
pub mod device;
pub mod log;
pub mod monte_carlo;
pub mod scenario;
pub mod sensors;
pub mod simulate;
pub mod truth;
pub mod unit;
