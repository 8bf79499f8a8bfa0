#![no_main]
//! libFuzzer on `fuzz::toml::unit`.

libfuzzer_sys::fuzz_target!(|data: &[u8]| fuzz::toml::unit(data));
