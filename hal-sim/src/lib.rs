//! x
#![allow(missing_docs, reason = "skeleton")]

pub mod device;
pub mod log;
pub mod scenario;
pub mod sensors;
pub mod truth;
pub mod unit;
