//! The module for Zephyr: read as west and Kconfig do; its sample is built by its own CMake files and runs under QEMU.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::{Context, Result, bail};

use super::{Place, build, configure};
use crate::process::{line, output, run as run_command};
use crate::report::{Missing, Report};
use crate::{apt, embedded, tools};

const TEST: &str = "bindings/zephyr/test";
const SAMPLE: &str = "bindings/zephyr/samples/push";
/// Of the board that QEMU plays.
const TARGET: &str = "thumbv7em-none-eabihf";
/// Longer than a slow machine takes.
const TIMEOUT_S: &str = "300";

/// A processor as a board selects it.
struct Processor {
    name: &'static str,
    /// Symbols that are `y`.
    selects: &'static [&'static str],
    /// What Kconfig makes of it.
    target: &'static str,
    flags: &'static str,
}

const HAS_FPU: &str = "CPU_HAS_FPU";
const DOUBLE: &str = "CPU_HAS_FPU_DOUBLE_PRECISION";
const HARD: &str = "FPU";

const PROCESSORS: [Processor; 13] = [
    Processor {
        name: "Cortex-M4F",
        selects: &["CPU_CORTEX_M4", HAS_FPU, HARD],
        target: TARGET,
        flags: "-C target-cpu=cortex-m4",
    },
    Processor {
        name: "Cortex-M7",
        selects: &["CPU_CORTEX_M7", DOUBLE, HARD],
        target: TARGET,
        flags: "-C target-cpu=cortex-m7",
    },
    Processor {
        name: "Cortex-M7 with single precision",
        selects: &["CPU_CORTEX_M7", HAS_FPU, HARD],
        target: TARGET,
        flags: "-C target-cpu=cortex-m7 -C target-feature=-fp64",
    },
    Processor {
        name: "Cortex-M33",
        selects: &["CPU_CORTEX_M33", "ARMV8_M_DSP", HAS_FPU, HARD],
        target: "thumbv8m.main-none-eabihf",
        flags: "-C target-cpu=cortex-m33",
    },
    Processor {
        name: "Cortex-M33 without DSP",
        selects: &["CPU_CORTEX_M33", HAS_FPU, HARD],
        target: "thumbv8m.main-none-eabihf",
        flags: "-C target-cpu=cortex-m33 -C target-feature=-dsp",
    },
    Processor {
        name: "Cortex-M55 with Helium",
        selects: &["CPU_CORTEX_M55", "ARMV8_M_DSP", "ARMV8_1_M_MVEF", DOUBLE, HARD],
        target: "thumbv8m.main-none-eabihf",
        flags: "-C target-cpu=cortex-m55 -C no-vectorize-loops -C no-vectorize-slp",
    },
    Processor {
        name: "Cortex-M55 with Helium and single precision",
        selects: &["CPU_CORTEX_M55", "ARMV8_M_DSP", "ARMV8_1_M_MVEF", HAS_FPU, HARD],
        target: "thumbv8m.main-none-eabihf",
        flags: "-C target-cpu=cortex-m55 -C target-feature=-fp64 -C no-vectorize-loops -C no-vectorize-slp",
    },
    Processor {
        name: "Cortex-M55 without Helium",
        selects: &["CPU_CORTEX_M55", "ARMV8_M_DSP", DOUBLE, HARD],
        target: "thumbv8m.main-none-eabihf",
        flags: "-C target-cpu=cortex-m55 -C target-feature=-mve",
    },
    Processor {
        name: "Cortex-M55 without Helium and with single precision",
        selects: &["CPU_CORTEX_M55", "ARMV8_M_DSP", HAS_FPU, HARD],
        target: "thumbv8m.main-none-eabihf",
        flags: "-C target-cpu=cortex-m55 -C target-feature=-mve,-fp64",
    },
    Processor {
        name: "Cortex-M85 with Helium",
        selects: &["CPU_CORTEX_M85", "ARMV8_M_DSP", "ARMV8_1_M_MVEF", DOUBLE, HARD],
        target: "thumbv8m.main-none-eabihf",
        flags: "-C target-cpu=cortex-m85 -C no-vectorize-loops -C no-vectorize-slp",
    },
    Processor {
        name: "Cortex-M85 with Helium and single precision",
        selects: &["CPU_CORTEX_M85", "ARMV8_M_DSP", "ARMV8_1_M_MVEF", HAS_FPU, HARD],
        target: "thumbv8m.main-none-eabihf",
        flags: "-C target-cpu=cortex-m85 -C target-feature=-fp64 -C no-vectorize-loops -C no-vectorize-slp",
    },
    Processor {
        name: "Cortex-M85 without Helium",
        selects: &["CPU_CORTEX_M85", "ARMV8_M_DSP", DOUBLE, HARD],
        target: "thumbv8m.main-none-eabihf",
        flags: "-C target-cpu=cortex-m85 -C target-feature=-mve",
    },
    Processor {
        name: "Cortex-M85 without Helium and with single precision",
        selects: &["CPU_CORTEX_M85", "ARMV8_M_DSP", HAS_FPU, HARD],
        target: "thumbv8m.main-none-eabihf",
        flags: "-C target-cpu=cortex-m85 -C target-feature=-mve,-fp64",
    },
];

/// The one that QEMU plays.
const M7: &[&str] = &["CPU_CORTEX_M7", DOUBLE];

pub(super) fn run(
    place: &Place,
    python: &std::result::Result<(), Missing>,
    report: &mut Report,
) -> Result<()> {
    if let Err(missing) = python {
        report.skip_part("the module for Zephyr", missing.clone());
        return Ok(());
    }
    west(place)?;
    kconfig(place)?;
    refusals(place)?;
    if let Err(missing) =
        apt::ensure(&[tools::ARM_GCC]).and_then(|()| apt::ensure(&[tools::QEMU_ARM]))
    {
        report.skip_part("the sample for Zephyr under QEMU", missing);
        return Ok(());
    }
    let sysroot = output(Command::new("rustc").args(["--print", "sysroot"]))?;
    if !embedded::installed_or_added(Path::new(sysroot.trim_end()), TARGET) {
        let why = format!("the module lets cargo build for {TARGET}, which is not installed");
        let missing = Missing::new(why, format!("rustup target add {TARGET}"));
        report.skip_part("the sample for Zephyr under QEMU", missing);
        return Ok(());
    }
    emulate(place)
}

/// A workspace that has this repository as a project, and the module where Zephyr looks for it: in the root of the project.
fn west(place: &Place) -> Result<()> {
    let top = place.empty("zephyr-workspace")?;
    run_command(
        Command::new("cp")
            .args(["--recursive", &format!("{TEST}/manifest")])
            .arg(top.join("manifest")),
    )?;
    output(place.program("west").args(["init", "--local", "manifest"]).current_dir(&top))?;
    let found = output(place.program("west").arg("topdir").current_dir(top.join("manifest")))?;
    if Path::new(found.trim_end()) != top {
        bail!("west takes {} for the workspace, not {}", found.trim_end(), top.display());
    }
    let mut list = place.program("west");
    let listed = output(list.args(["list", "--format", "{name} {path}"]).current_dir(&top))?;
    if listed != "manifest manifest\nrigidformer modules/lib/rigidformer\n" {
        bail!("west lists\n{listed}where the module is a project of {TEST}/manifest/west.yml");
    }
    fs::create_dir_all(top.join("modules/lib")).context("no folder for the project")?;
    let repository = Path::new(".").canonicalize().context("no repository")?;
    run_command(
        Command::new("ln").arg("-s").arg(repository).arg(top.join("modules/lib/rigidformer")),
    )?;
    let mut list = place.program("west");
    list.args(["list", "--format", "{abspath}", "rigidformer"]).current_dir(&top);
    let project = output(&mut list)?;
    println!("Zephyr: west lists the repository as a project of a workspace");
    let script = Path::new(TEST).join("module.py");
    print!("{}", output(place.program("python").arg(script).arg(project.trim_end()))?);
    Ok(())
}

/// What a board and the caller say, as a file of configuration.
fn fragment(path: &Path, symbols: &[&str], values: &[(&str, &str)]) -> Result<()> {
    let mut text = String::new();
    for symbol in symbols {
        text += &format!("CONFIG_{symbol}=y\n");
    }
    for (name, value) in values {
        text += &format!("CONFIG_{name}=\"{value}\"\n");
    }
    fs::write(path, text).with_context(|| format!("cannot write {}", path.display()))
}

/// The target and the flags that Kconfig finds for each processor, and where the library cannot be chosen.
fn kconfig(place: &Place) -> Result<()> {
    let folder = place.empty("zephyr-kconfig")?;
    let (board, out) = (folder.join("board.conf"), folder.join("out.conf"));
    let configured = |symbols: &[&str]| {
        fragment(&board, symbols, &[])?;
        let mut python = place.program("python");
        python.args([format!("{TEST}/configure.py"), format!("{TEST}/Kconfig")]);
        python.arg(&out).arg(&board).env("MODULE_KCONFIG", "bindings/zephyr/Kconfig");
        Ok::<_, anyhow::Error>(python)
    };
    for processor in &PROCESSORS {
        let symbols = [processor.selects, &["RIGIDFORMER"]].concat();
        output(&mut configured(&symbols)?)
            .with_context(|| format!("Kconfig, {}", processor.name))?;
        let text = fs::read_to_string(&out).context("Kconfig wrote nothing")?;
        for (name, wanted) in
            [("TARGET", processor.target), ("RUSTFLAGS", processor.flags), ("FEATURES", "")]
        {
            let wanted = format!("CONFIG_RIGIDFORMER_{name}=\"{wanted}\"");
            if !text.lines().any(|line| line == wanted) {
                bail!("{}: Kconfig must say {wanted}, and says\n{text}", processor.name);
            }
        }
    }
    for (without, symbols) in [
        ("the hard ABI", &["CPU_CORTEX_M7", HAS_FPU, HARD, "FP_SOFTABI", "RIGIDFORMER"][..]),
        ("an FPU that is switched on", &["CPU_CORTEX_M33", HAS_FPU, "RIGIDFORMER"]),
        ("a processor that it is built for", &[HAS_FPU, HARD, "RIGIDFORMER"]),
    ] {
        let mut command = configured(symbols)?;
        refused(&mut command, "CONFIG_RIGIDFORMER=y was asked for", without)?;
    }
    println!(
        "Zephyr: Kconfig finds Rust's target and flags for {} processors, and no library without an FPU",
        PROCESSORS.len()
    );
    Ok(())
}

/// Configures the sample with stand-ins for Zephyr: for the board, or for this machine.
fn sample(
    place: &Place,
    name: &str,
    symbols: &[&str],
    prebuilt: Option<&Path>,
    on_host: bool,
) -> Result<(Command, PathBuf)> {
    let folder = place.empty(name)?;
    let board = folder.join("board.conf");
    let prebuilt = prebuilt.map(|path| path.display().to_string());
    let values: Vec<(&str, &str)> =
        prebuilt.iter().map(|path| ("RIGIDFORMER_PREBUILT", path.as_str())).collect();
    fragment(&board, symbols, &values)?;
    let package = Path::new(TEST).join("package").canonicalize().context("no stand-ins")?;
    let mut command = configure(Path::new(SAMPLE), &folder);
    command.arg(format!("-DZephyr_DIR={}", package.display()));
    command.arg(format!("-DPYTHON={}", place.venv.join("bin/python").display()));
    command.arg(format!("-DBOARD_CONF={}", board.display()));
    command.arg(format!("-DON_HOST={on_host}"));
    if on_host {
        // Libraries for Linux have larger buffers.
        command.arg("-DCMAKE_C_FLAGS=-DMEMORY_BYTES=2097152");
    }
    Ok((command, folder))
}

/// A command that must fail and say something.
fn refused(command: &mut Command, said: &str, what: &str) -> Result<()> {
    let done = command.output().with_context(|| format!("cannot start `{}`", line(command)))?;
    // CMake breaks lines where it likes.
    let printed = String::from_utf8_lossy(&done.stderr);
    let words = printed.split_whitespace().collect::<Vec<_>>().join(" ");
    if done.status.success() || !words.contains(said) {
        bail!("Zephyr, {what}: must be refused with `{said}`, and it says:\n{printed}");
    }
    Ok(())
}

/// What the module's CMake file says where it cannot go on.
fn refusals(place: &Place) -> Result<()> {
    let none = Some(Path::new("/no/such.a"));
    let (mut command, _) = sample(place, "zephyr-refused", M7, none, true)?;
    refused(
        &mut command,
        "there is no /no/such.a. Correct CONFIG_RIGIDFORMER_PREBUILT",
        "a library that is not there",
    )?;
    let (mut command, _) = sample(place, "zephyr-refused", M7, None, true)?;
    command.arg("-DRIGIDFORMER_CARGO=RIGIDFORMER_CARGO-NOTFOUND");
    command.env("PATH", "/usr/local/bin:/usr/bin:/bin");
    command.env("HOME", "/nonexistent").env("CARGO_HOME", "/nonexistent");
    if !super::esp_idf::cargo_at_large() {
        refused(&mut command, "rustup target add thumbv7em-none-eabihf", "no cargo")?;
    }
    // It prints its arguments, which are no folder.
    let (mut command, _) = sample(place, "zephyr-refused", M7, None, true)?;
    command.args(["-DRIGIDFORMER_CARGO=/bin/echo", "-DRIGIDFORMER_RUSTC=/bin/echo"]);
    refused(
        &mut command,
        "has no libraries for thumbv7em-none-eabihf. `rustup target add thumbv7em-none-eabihf`",
        "a target that is not there",
    )?;
    println!("Zephyr: refusals say what to do");
    Ok(())
}

/// Runs the sample on the Cortex-M7 and compares what it prints with this machine.
fn emulate(place: &Place) -> Result<()> {
    let library = place.prefix.join("lib/librigidformer.a");
    let (mut command, host) = sample(place, "zephyr-host", M7, Some(&library), true)?;
    output(&mut command)?;
    build(&host)?;
    let expected = output(&mut Command::new(host.join("zephyr_final")))?;
    if !expected.starts_with("roles: 20 steps, poses ") {
        bail!("the sample for Zephyr prints here:\n{expected}");
    }
    // First by cargo, through the module; then the library that this made, as one that is there.
    let (mut command, by_cargo) = sample(place, "zephyr-cargo", M7, None, false)?;
    output(&mut command)?;
    build(&by_cargo)?;
    compare(&by_cargo, &expected, "built by cargo")?;
    let made = by_cargo
        .join("modules/rigidformer/cargo")
        .join(TARGET)
        .join("embedded/librigidformer_capi.a");
    let (mut command, prebuilt) = sample(place, "zephyr-prebuilt", M7, Some(&made), false)?;
    output(&mut command)?;
    build(&prebuilt)?;
    compare(&prebuilt, &expected, "prebuilt")
}

fn compare(folder: &Path, expected: &str, which: &str) -> Result<()> {
    let mut command = Command::new("timeout");
    command.arg(TIMEOUT_S).arg(apt::program(tools::QEMU_ARM.name)).args(["-cpu", "cortex-m7"]);
    command.args(["-machine", "mps2-an500", "-nographic", "-monitor", "none", "-serial", "none"]);
    command.args(["-semihosting-config", "enable=on,target=native", "-kernel"]);
    command.arg(folder.join("zephyr_final"));
    // QEMU prints what the debugger is told to stderr.
    let done = command.output().with_context(|| format!("cannot start `{}`", line(&command)))?;
    let printed = String::from_utf8_lossy(&done.stdout) + String::from_utf8_lossy(&done.stderr);
    if !done.status.success() || printed != expected {
        bail!("the sample for Zephyr ({which}) prints\n{printed}expected\n{expected}");
    }
    println!(
        "Zephyr: Cortex-M7 (mps2-an500, {which}): the sample's poses have the bits of this machine"
    );
    Ok(())
}
