#![no_main]
//! libFuzzer on `fuzz::toml::scenario`.

libfuzzer_sys::fuzz_target!(|data: &[u8]| fuzz::toml::scenario(data));
