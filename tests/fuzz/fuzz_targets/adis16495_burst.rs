#![no_main]
//! libFuzzer on `fuzz::drivers::adis16495_burst`.

libfuzzer_sys::fuzz_target!(|data: &[u8]| fuzz::drivers::adis16495_burst(data));
