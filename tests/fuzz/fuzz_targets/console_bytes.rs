#![no_main]
//! libFuzzer on `fuzz::console::bytes`.

libfuzzer_sys::fuzz_target!(|data: &[u8]| fuzz::console::bytes(data));
