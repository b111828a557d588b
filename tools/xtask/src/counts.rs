//! Instruction counts: those that a check can rely on, and those of processors that are not here.

use std::collections::BTreeMap;
use std::fmt::Write;
use std::fs;
use std::path::Path;
use std::process::Command;

use anyhow::{Context, Result, bail};

use crate::bench::program::BENCH;
use crate::embedded::{installed_or_added, without};
use crate::process::{cargo, output};
use crate::report::{Missing, Report};
use crate::{apt, rust_src, tables, tools};

/// Instructions by name.
type Counts = BTreeMap<String, f64>;

const FILE: &str = "runtime-std/benches/counts.toml";
const TOLERANCE: f64 = 0.03;
/// What is counted: kernel and workload. Valgrind knows no AVX-512.
const COUNTED: [(&str, &str); 4] = [
    ("portable", "product"),
    ("portable", "edge-step"),
    ("avx2", "product"),
    ("avx2", "edge-step"),
];

/// Counts instructions under Callgrind and compares them with the committed ones: a time would depend on the machine's
/// mood.
pub(crate) fn run(bless: bool, report: &mut Report) -> Result<()> {
    if !cfg!(all(target_arch = "x86_64", target_os = "linux")) {
        report.skip(Missing::new(
            "the committed counts are of x86-64 Linux",
            "run it on an x86-64 Linux machine",
        ));
        return Ok(());
    }
    if let Err(missing) = apt::ensure(&[tools::VALGRIND]) {
        report.skip(missing);
        return Ok(());
    }
    let folder = tempfile::tempdir()?;
    let mut found = Counts::new();
    for (kernel, workload) in COUNTED {
        let out = folder.path().join(format!("{kernel}-{workload}"));
        let mut command = cargo();
        command.args(BENCH).args(["--", "--count", workload]);
        command.env("RIGIDFORMER_KERNEL", kernel);
        command.env(
            "CARGO_TARGET_X86_64_UNKNOWN_LINUX_GNU_RUNNER",
            format!(
                "valgrind --quiet --tool=callgrind --toggle-collect=rigidformer_counted --callgrind-out-file={}",
                out.display()
            ),
        );
        output(&mut command)?;
        let text = fs::read_to_string(&out).context("callgrind wrote nothing")?;
        let total = text.lines().find_map(|line| line.strip_prefix("summary: "));
        let total = total.or_else(|| text.lines().find_map(|line| line.strip_prefix("totals: ")));
        let count: f64 = total.context("callgrind counted nothing")?.trim().parse()?;
        println!("{kernel:<10} {workload:<10} {count:>12} instructions");
        found.insert(format!("{kernel}.{workload}"), count);
    }
    if bless {
        let mut text = String::from(
            "# Written by `cargo xtask counts --bless`: instructions under Callgrind. One that moves by more than 3 %, for the\n\
             # better or the worse, fails the check.\n",
        );
        for (name, count) in &found {
            let _ = writeln!(text, "\"{name}\" = {count:.1}");
        }
        fs::write(FILE, text).with_context(|| format!("cannot write {FILE}"))?;
        return tables::write();
    }
    let text = fs::read_to_string(FILE).with_context(|| format!("cannot read {FILE}"))?;
    let expected: Counts =
        toml::from_str(&text).with_context(|| format!("{FILE} does not parse"))?;
    let mut faults = Vec::new();
    for (name, found) in &found {
        let Some(expected) = expected.get(name) else {
            faults.push(format!("{FILE} has no {name}"));
            continue;
        };
        if (found - expected).abs() > TOLERANCE * expected {
            faults.push(format!(
                "{name}: {found}, {expected} in {FILE}, {:+.1} %",
                100.0 * (found / expected - 1.0)
            ));
        }
    }
    if !faults.is_empty() {
        bail!("{}\n`cargo xtask counts --bless` takes them as they are", faults.join("\n"));
    }
    Ok(())
}

const AARCH64: &str = "aarch64-unknown-linux-gnu";
/// What QEMU calls to count.
const PLUGIN: &str = include_str!("counts/instructions.c");
/// Products, row quantisation among them, as rows x inputs x outputs.
const SHAPES: [&str; 8] = [
    "1x768x768",
    "4x768x768",
    "10x768x768",
    "26x768x768",
    "26x256x256",
    "10x128x128",
    "14x64x64",
    "64x3072x768",
];
/// Kernels of aarch64, but for the portable ones, which take a minute.
const KERNELS: [&str; 3] = ["neon", "sdot", "smmla"];

/// Prints instructions a multiply-accumulate of aarch64's kernels, as qemu-user executes them. They are no times: a processor takes
/// some of them longer than others, and several at once.
pub(crate) fn aarch64(report: &mut Report) -> Result<()> {
    if let Err(missing) = apt::ensure(&tools::AARCH64) {
        report.skip(missing);
        return Ok(());
    }
    let sysroot = output(Command::new("rustc").args(["--print", "sysroot"]))?;
    let sysroot = Path::new(sysroot.trim_end());
    let from_source = !installed_or_added(sysroot, AARCH64);
    if from_source && let Err(missing) = rust_src::ensure(sysroot) {
        report.skip(without(AARCH64, missing));
        return Ok(());
    }
    let folder = tempfile::tempdir()?;
    let (source, plugin) = (folder.path().join("count.c"), folder.path().join("count.so"));
    fs::write(&source, PLUGIN)?;
    let mut compiler = Command::new("cc");
    compiler.args(["-O2", "-shared", "-fPIC", "-o"]).arg(&plugin).arg(&source);
    output(&mut compiler)?;
    println!(
        "instructions a multiply-accumulate, under qemu-user\n{:<14}{}",
        "",
        KERNELS.map(|name| format!("{name:>8}")).concat()
    );
    for shape in SHAPES {
        let macs: f64 = shape.split('x').filter_map(|n| n.parse::<f64>().ok()).product();
        let mut line = format!("{shape:<14}");
        for kernel in KERNELS {
            // The process has other things to do: what more products take is theirs.
            let few = executed(&plugin, from_source, kernel, shape, 1)?;
            let many = executed(&plugin, from_source, kernel, shape, 1 + MORE)?;
            let each = (many as f64 - few as f64) / f64::from(MORE);
            let _ = write!(line, "{:>8.4}", each / macs);
        }
        println!("{line}");
    }
    Ok(())
}

/// Products between the one run and the other.
const MORE: u32 = 20;

/// Instructions of a process that multiplies so many times.
fn executed(
    plugin: &Path,
    from_source: bool,
    kernel: &str,
    shape: &str,
    times: u32,
) -> Result<u64> {
    let mut command = cargo();
    command.args(BENCH).args(["--target", AARCH64]);
    if from_source {
        command.arg("-Zbuild-std=std,panic_abort").env("RUSTC_BOOTSTRAP", "1");
    }
    command.args(["--", "--count", "product", "--shape", shape, "--times", &times.to_string()]);
    command.env("RIGIDFORMER_KERNEL", kernel);
    // Threads that wait for work would be counted.
    command.env("RAYON_NUM_THREADS", "1");
    command.env("CARGO_TARGET_AARCH64_UNKNOWN_LINUX_GNU_LINKER", "aarch64-linux-gnu-gcc");
    command.env(
        "CARGO_TARGET_AARCH64_UNKNOWN_LINUX_GNU_RUNNER",
        format!("qemu-aarch64 -cpu max -L /usr/aarch64-linux-gnu -plugin {}", plugin.display()),
    );
    let text = output(&mut command)?;
    let count = text.lines().find_map(|line| line.strip_prefix("instructions: "));
    count
        .context("QEMU counted nothing: has it plugins?")?
        .trim()
        .parse()
        .context("no number of instructions")
}
