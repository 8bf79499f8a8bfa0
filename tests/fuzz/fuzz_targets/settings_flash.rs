#![no_main]
//! libFuzzer on `fuzz::settings::flash`.

libfuzzer_sys::fuzz_target!(|data: &[u8]| fuzz::settings::flash(data));
