#![no_main]
//! libFuzzer on `fuzz::drivers::mt6835_bus`.

libfuzzer_sys::fuzz_target!(|data: &[u8]| fuzz::drivers::mt6835_bus(data));
