#![no_main]
//! libFuzzer on `fuzz::console::line`.

libfuzzer_sys::fuzz_target!(|data: &[u8]| fuzz::console::line(data));
