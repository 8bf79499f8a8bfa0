//! The core computes the same bits on the emulated part as on this host: the alignment of `tests/target`, hashed.
#![allow(clippy::unwrap_used, reason = "tests")]

use std::path::Path;
use std::process::Command;

use emulator::image::Image;
use emulator::probe::{Probe, probe};
use target_check::bits;

/// Bytes of the image's result, and the word that says it is valid.
const RESULT: (&str, usize) = ("TARGET_CHECK", 28);
const VALID: u32 = 0x600D;

fn built() -> Image {
    let target = env!("CARGO_TARGET_TMPDIR");
    let status = Command::new(env!("CARGO"))
        .args(["build", "--locked", "--release", "--bin", "image"])
        .args(["--features", "stm32f427", "--target", "thumbv7em-none-eabihf"])
        .env("CARGO_TARGET_DIR", target)
        .current_dir(concat!(env!("CARGO_MANIFEST_DIR"), "/../../tests/target"))
        .status()
        .unwrap();
    assert!(status.success());
    Image::read(&Path::new(target).join("thumbv7em-none-eabihf/release/image")).unwrap()
}

#[test]
fn the_core_is_bit_equal_to_the_hosts() {
    let readings = probe(
        &built(),
        &Probe {
            limit_ms: 60_000,
            done: Some(RESULT.0),
            read: &[RESULT],
        },
    )
    .unwrap();
    assert!(readings.done, "not at its end after {} ns", readings.t_ns);
    let words: Vec<u32> = readings.memory[RESULT.0]
        .chunks_exact(4)
        .map(|word| u32::from_le_bytes(word.try_into().unwrap()))
        .collect();
    assert_eq!(words[0], VALID);
    let hash = |low: usize| u64::from(words[low]) | u64::from(words[low + 1]) << 32;
    let host = bits::outcome().unwrap();
    println!("{} instructions, {:016x}", readings.instructions, hash(3));
    assert_eq!((hash(1), hash(3)), (host.samples.0, host.estimates.0));
    assert_eq!((words[5], words[6]), (host.count, u32::from(host.aligned)));
}
