//! Hands the linker the workspace's `memory.x` and which board it is for, and the program its version.

use std::path::{Path, PathBuf};
use std::process::Command;
use std::{env, error, fs};

fn main() -> Result<(), Box<dyn error::Error>> {
    let out = PathBuf::from(env::var("OUT_DIR")?);
    fs::copy("../memory.x", out.join("memory.x"))?;
    println!("cargo:rustc-link-search={}", out.display());
    println!("cargo:rerun-if-changed=../memory.x");
    println!("cargo:rerun-if-changed=build.rs");
    let f405 = u8::from(env::var_os("CARGO_FEATURE_BOARD_F405").is_some());
    println!("cargo:rustc-link-arg-bins=--defsym=board_f405={f405}");

    let release = env::var("CARGO_PKG_VERSION")?;
    let version = commit().map_or(release.clone(), |commit| format!("{release}+{commit}"));
    println!("cargo:rustc-env=ROTARY_NORTH_VERSION={version}");
    Ok(())
}

/// The commit that is built, where there is a repository; changes on top of it are not told, they have no name.
fn commit() -> Option<String> {
    let git = |arguments: &[&str]| {
        let output = Command::new("git").args(arguments).output().ok()?;
        let text = String::from_utf8(output.stdout).ok()?.trim().to_owned();
        (output.status.success() && !text.is_empty()).then_some(text)
    };
    // Written at every commit and change of branch.
    let log = git(&["rev-parse", "--git-path", "logs/HEAD"])?;
    if Path::new(&log).exists() {
        println!("cargo:rerun-if-changed={log}");
    }
    git(&["rev-parse", "--short=7", "HEAD"])
}
