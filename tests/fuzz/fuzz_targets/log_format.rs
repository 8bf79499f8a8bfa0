#![no_main]
//! libFuzzer on `fuzz::logs::format`.

libfuzzer_sys::fuzz_target!(|data: &[u8]| fuzz::logs::format(data));
