//! Chooses the memory map and the linker scripts.

use std::error::Error;
use std::path::PathBuf;
use std::{env, fs};

fn main() -> Result<(), Box<dyn Error>> {
    // Two boards share a target; the compiler's flags tell their processors apart.
    let flags = env::var("CARGO_ENCODED_RUSTFLAGS").unwrap_or_default();
    let map = match env::var("TARGET")?.starts_with("thumbv8m") {
        true if flags.contains("target-cpu=cortex-m55") => "thumbv8.1m",
        true => "thumbv8m",
        false => "thumbv7em",
    };
    println!("cargo:rustc-check-cfg=cfg(quarter_ticks)");
    if map == "thumbv8.1m" {
        println!("cargo:rustc-cfg=quarter_ticks");
    }
    let out = PathBuf::from(env::var_os("OUT_DIR").ok_or("cargo sets OUT_DIR")?);
    fs::copy(format!("memory/{map}.x"), out.join("memory.x"))?;
    println!("cargo:rustc-link-search={}", out.display());
    println!("cargo:rustc-link-arg-bins=-Tlink.x");
    println!("cargo:rustc-link-arg-bins=-Tdefmt.x");
    // Nothing pages on a microcontroller, so sections need not begin at page boundaries.
    println!("cargo:rustc-link-arg-bins=--nmagic");
    // A model of one's own in the place of nano (`cargo xtask firmware --model`).
    println!("cargo:rustc-check-cfg=cfg(own_model)");
    println!("cargo:rerun-if-env-changed=RIGIDFORMER_MODEL");
    if let Some(model) = env::var_os("RIGIDFORMER_MODEL") {
        let path = fs::canonicalize(&model)?;
        println!("cargo:rerun-if-changed={}", path.display());
        println!("cargo:rustc-env=RIGIDFORMER_MODEL={}", path.display());
        println!("cargo:rustc-cfg=own_model");
    }
    println!("cargo:rerun-if-changed=memory");
    println!("cargo:rerun-if-changed=build.rs");
    Ok(())
}
