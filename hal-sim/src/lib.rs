//! x
#![allow(missing_docs, reason = "skeleton")]

pub mod scenario;
pub mod unit;
