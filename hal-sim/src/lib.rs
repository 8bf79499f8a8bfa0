//! x
#![allow(missing_docs, reason = "skeleton")]

pub mod scenario;
pub mod sensors;
pub mod truth;
pub mod unit;
