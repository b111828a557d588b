//! Tells the crate which Cortex-M instructions it may use: stable Rust has no cfg for them.
//!
//! - `rigidformer_dsp`: SMLAD and its kin, and a single-precision FPU.
//! - `rigidformer_fpv5`: that FPU has VMAXNM and VMINNM.
//! - `rigidformer_helium`: besides, Helium for integers and floats, unless `-C target-feature` says `-mve` or `-mve.fp`.
//! - `rigidformer_fcsr`: RISC-V with an FPU.
//! - `rigidformer_host`: the feature `host`, which the kernels of those processors cannot serve.
//!
//! Other targets get none of the first three, whatever their flags.

use std::env;

fn main() {
    println!("cargo:rerun-if-changed=build.rs");
    println!("cargo:rustc-check-cfg=cfg(rigidformer_dsp, rigidformer_fpv5, rigidformer_host)");
    println!("cargo:rustc-check-cfg=cfg(rigidformer_helium, rigidformer_fcsr)");
    let target = env::var("TARGET").unwrap_or_default();
    if ["riscv64gc", "riscv32gc", "riscv32imafc"].iter().any(|start| target.starts_with(start)) {
        println!("cargo:rustc-cfg=rigidformer_fcsr");
    }
    let flags = env::var("CARGO_ENCODED_RUSTFLAGS").unwrap_or_default();
    let given = |name: &'static str| {
        flags.split('\x1f').filter_map(move |flag| flag.split_once(name).map(|(_, value)| value))
    };
    let cpu = given("target-cpu=").next_back().unwrap_or_default();
    // The last word counts, of all options together.
    let mut features = given("target-feature=").flat_map(|list| list.split(','));
    let asked = features.rfind(|f| ["+dsp", "-dsp"].contains(f)).map(|f| f == "+dsp");
    let newer = ["cortex-m33", "cortex-m35p", "cortex-m55", "cortex-m85"].contains(&cpu);
    let dsp = match target.as_str() {
        "thumbv7em-none-eabihf" => true,
        // There the extension is optional.
        "thumbv8m.main-none-eabihf" => asked.unwrap_or(newer),
        _ => false,
    };
    // These processors may be made without it.
    let mut features = given("target-feature=").flat_map(|list| list.split(','));
    let lacks_it = features.any(|f| ["-mve", "-mve.fp"].contains(&f));
    let helium = dsp
        && !lacks_it
        && target.starts_with("thumbv8m")
        && ["cortex-m55", "cortex-m85"].contains(&cpu);
    if helium {
        println!("cargo:rustc-cfg=rigidformer_helium");
        // `-C name` and `-Cname`, without a value or with one that says yes.
        let is_set = |name: &str| {
            let mut words = flags.split('\x1f').map(|flag| flag.trim_start_matches("-C").trim());
            words.any(|word| word == name || word == format!("{name}=yes"))
        };
        if !["no-vectorize-loops", "no-vectorize-slp"].into_iter().all(is_set) {
            println!(
                "cargo::error=add -C no-vectorize-loops -C no-vectorize-slp to the flags (or -C target-feature=-mve): without them the \
                 compiler computes with Helium, which takes subnormal numbers for zeros, and results differ from those of other processors"
            );
        }
    }
    if !dsp && env::var_os("CARGO_FEATURE_HOST").is_some() {
        println!("cargo:rustc-cfg=rigidformer_host");
    }
    if dsp {
        println!("cargo:rustc-cfg=rigidformer_dsp");
        // Whole functions in assembly are assembled apart from the flags of the crate.
        let directive = match (target.starts_with("thumbv8m"), cpu) {
            _ if helium => ".cpu cortex-m55",
            (true, _) => ".cpu cortex-m33",
            (_, "cortex-m7") => ".fpu fpv5-sp-d16",
            _ => ".fpu fpv4-sp-d16",
        };
        println!("cargo:rustc-env=RIGIDFORMER_ASSEMBLE_FOR={directive}");
        if target.starts_with("thumbv8m") || cpu == "cortex-m7" {
            println!("cargo:rustc-cfg=rigidformer_fpv5");
        }
    }
}
