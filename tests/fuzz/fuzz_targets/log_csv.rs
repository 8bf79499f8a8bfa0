#![no_main]
//! libFuzzer on `fuzz::logs::csv`.

libfuzzer_sys::fuzz_target!(|data: &[u8]| fuzz::logs::csv(data));
