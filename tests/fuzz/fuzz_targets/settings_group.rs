#![no_main]
//! libFuzzer on `fuzz::settings::group`.

libfuzzer_sys::fuzz_target!(|data: &[u8]| fuzz::settings::group(data));
