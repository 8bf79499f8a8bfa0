#![no_main]
//! libFuzzer on `fuzz::logs::record`.

libfuzzer_sys::fuzz_target!(|data: &[u8]| fuzz::logs::record(data));
