#![no_main]
//! libFuzzer on `fuzz::drivers::adis16495_bus`.

libfuzzer_sys::fuzz_target!(|data: &[u8]| fuzz::drivers::adis16495_bus(data));
