//! Drivers over embedded-hal-async traits.
#![no_std]
