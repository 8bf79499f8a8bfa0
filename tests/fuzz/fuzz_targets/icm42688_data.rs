#![no_main]
//! libFuzzer on `fuzz::drivers::icm42688_data`.

libfuzzer_sys::fuzz_target!(|data: &[u8]| fuzz::drivers::icm42688_data(data));
