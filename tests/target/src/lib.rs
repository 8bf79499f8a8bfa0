//! What the core computes and costs on a Cortex-M4F.
//!
//! | module | what |
//! |---|---|
//! | [`motion`] | samples of a swinging, rotating IMU, the same bits on every machine |
//! | [`bits`] | a whole alignment on them, and a hash over all it says |
//! | [`cost`] | what is counted: the steps of the core, each as the unit runs it |
//!
//! `image` runs all of it on the target, or on a host; `budget` builds the image, runs it in QEMU and prints the table:
//!
//! ```text
//! cargo budget
//! ```
//!
//! QEMU counts instructions (`-icount shift=0`: one is one virtual nanosecond), not cycles. A Cortex-M4F takes one cycle
//! for most, 14 for a division or a square root, and some for flash: budget 1.3 to 1.6 cycles for an instruction.
#![cfg_attr(not(test), no_std)]

pub mod bits;
pub mod cost;
pub mod motion;
