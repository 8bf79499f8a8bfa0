#![no_main]
//! libFuzzer on `fuzz::drivers::icm42688_bus`.

libfuzzer_sys::fuzz_target!(|data: &[u8]| fuzz::drivers::icm42688_bus(data));
