//! The linker map of the image: QEMU's `mps2-an386`, or bank 1 and SRAM of an STM32F427.

use std::path::PathBuf;
use std::{env, error, fs};

const MPS2: &str = "MEMORY {
  FLASH (rx)  : ORIGIN = 0x00000000, LENGTH = 4M
  RAM   (rwx) : ORIGIN = 0x20000000, LENGTH = 4M
}
";
const STM32F427: &str = "MEMORY {
  FLASH (rx)  : ORIGIN = 0x08000000, LENGTH = 1M
  RAM   (rwx) : ORIGIN = 0x20000000, LENGTH = 192K
}
";

fn main() -> Result<(), Box<dyn error::Error>> {
    let out = PathBuf::from(env::var("OUT_DIR")?);
    let stm32 = env::var_os("CARGO_FEATURE_STM32F427").is_some();
    fs::write(out.join("memory.x"), if stm32 { STM32F427 } else { MPS2 })?;
    // The workspace links defmt's sections into every image; nothing here logs.
    fs::write(out.join("defmt.x"), "")?;
    println!("cargo:rustc-link-search={}", out.display());
    println!("cargo:rerun-if-changed=build.rs");
    Ok(())
}
