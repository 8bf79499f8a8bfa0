//! Builds the image, runs it in QEMU, and prints what the core costs.
//!
//! Fails where a limit is passed, or where a hash is not what this host makes of the same samples.
#![cfg_attr(target_os = "none", no_std, no_main)]

#[cfg(not(target_os = "none"))]
use std::process::ExitCode;

#[cfg(not(target_os = "none"))]
fn main() -> ExitCode {
    match host::run() {
        Ok(()) => ExitCode::SUCCESS,
        Err(reason) => {
            eprintln!("{reason}");
            ExitCode::FAILURE
        }
    }
}

// Cargo builds every binary it is asked for; this one has nothing to do on the target.
#[cfg(target_os = "none")]
#[panic_handler]
fn panic(_: &core::panic::PanicInfo) -> ! {
    loop {}
}

#[cfg(not(target_os = "none"))]
mod host {
    use std::path::{Path, PathBuf};
    use std::process::{Command, Stdio};
    use std::{env, fs};

    use target_check::bits;

    const TRIPLE: &str = "thumbv7em-none-eabihf";
    /// How far the README's figures may be off before it is said.
    const STALE: f64 = 0.1;

    /// The image, built in the target folder that this program lies in.
    fn build() -> Result<PathBuf, String> {
        let here = env::current_exe().map_err(|e| e.to_string())?;
        let target = here.ancestors().nth(2).ok_or("no target folder")?;
        let built = Command::new("cargo")
            .args([
                "build",
                "--locked",
                "--release",
                "--quiet",
                "--bin",
                "image",
                "--target",
                TRIPLE,
            ])
            .env("CARGO_TARGET_DIR", target)
            .current_dir(env!("CARGO_MANIFEST_DIR"))
            .status()
            .map_err(|e| format!("cargo: {e}"))?;
        if !built.success() {
            return Err("the image does not build".to_owned());
        }
        Ok(target.join(TRIPLE).join("release/image"))
    }

    /// What the image says.
    fn emulate(image: &Path) -> Result<String, String> {
        let output = Command::new("qemu-system-arm")
            .args([
                "-M",
                "mps2-an386",
                "-cpu",
                "cortex-m4",
                "-nographic",
                "-icount",
                "shift=0",
            ])
            .args(["-semihosting-config", "enable=on,target=native", "-kernel"])
            .arg(image)
            .stdin(Stdio::null())
            .output()
            .map_err(|e| format!("qemu-system-arm (in Debian and Ubuntu the package of this name): {e}"))?;
        // Semihosting writes to the standard error.
        let said = String::from_utf8_lossy(&output.stderr).into_owned();
        if !output.status.success() || said.lines().last() != Some("done") {
            return Err(format!("the image did not finish in QEMU:\n{said}"));
        }
        Ok(said)
    }

    /// The README's figure for `name`.
    fn published(readme: &str, name: &str) -> Option<f64> {
        let row = readme.lines().find(|line| line.starts_with(&format!("| {name} |")))?;
        row.split('|').nth(2)?.trim().replace(',', "").parse().ok()
    }

    fn thousands(number: &str) -> String {
        match number.len() {
            ..=3 => number.to_owned(),
            n => format!("{},{}", &number[..n - 3], &number[n - 3..]),
        }
    }

    pub(crate) fn run() -> Result<(), String> {
        let host = bits::outcome().ok_or("the aligner refuses its own configuration")?;
        let hashes = [("samples", host.samples.0), ("estimates", host.estimates.0)];
        let said = emulate(&build()?)?;
        let readme = fs::read_to_string(concat!(env!("CARGO_MANIFEST_DIR"), "/../../README.md")).unwrap_or_default();
        let (mut faults, mut stale) = (Vec::new(), Vec::new());
        println!("| step | instructions | limit |\n|---|---|---|");
        for cost in said.lines().filter_map(|line| line.strip_prefix("cost ")) {
            let mut words = cost.splitn(3, ' ');
            let (Some(taken), Some(limit), Some(name)) = (words.next(), words.next(), words.next()) else {
                return Err(format!("not understood: {cost}"));
            };
            let shown = limit.parse::<u32>().map_or(String::new(), |_| thousands(limit));
            println!("| {name} | {} | {shown} |", thousands(taken));
            let count = taken.parse::<u32>().map_err(|e| e.to_string())?;
            if limit.parse().is_ok_and(|limit: u32| count > limit) {
                faults.push(format!("{name}: {count} instructions, {limit} allowed"));
            }
            if published(&readme, name).is_some_and(|old| (f64::from(count) / old - 1.0).abs() > STALE) {
                stale.push(name.to_owned());
            }
        }
        println!(
            "\n{:.0} s of samples, {} estimates; heading at the end off by {:.2}° with a σ of {:.2}°",
            bits::seconds(),
            host.count,
            host.heading_error_deg,
            host.heading_sd_deg
        );
        for (name, number) in hashes {
            let line = format!("hash {name} {number:016x}");
            if said.lines().any(|said| said == line) {
                println!("{line}: host and Cortex-M4F");
            } else {
                faults.push(format!("{line} on this host, but the image said:\n{said}"));
            }
        }
        if !stale.is_empty() {
            faults.push(format!("the README has other figures for: {}", stale.join("; ")));
        }
        if faults.is_empty() {
            Ok(())
        } else {
            Err(faults.join("\n"))
        }
    }
}
