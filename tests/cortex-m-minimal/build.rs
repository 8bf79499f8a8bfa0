//! The linker map of QEMU's `mps2-an386`: for another part, its own flash and RAM.

use std::path::PathBuf;
use std::{env, error, fs};

const MEMORY: &str = "MEMORY {
  FLASH (rx)  : ORIGIN = 0x00000000, LENGTH = 4M
  RAM   (rwx) : ORIGIN = 0x20000000, LENGTH = 128K
}
";

fn main() -> Result<(), Box<dyn error::Error>> {
    let out = PathBuf::from(env::var("OUT_DIR")?);
    fs::write(out.join("memory.x"), MEMORY)?;
    // The folder above links defmt's sections into every image; nothing here logs.
    fs::write(out.join("defmt.x"), "")?;
    println!("cargo:rustc-link-search={}", out.display());
    println!("cargo:rerun-if-changed=build.rs");
    Ok(())
}
