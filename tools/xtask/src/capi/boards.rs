//! The C firmware on three processors, played by QEMU.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::{Context, Result, bail};

use super::install::copy;
use super::{EMBEDDED, Expected, MODEL, Place, SCENE, Which, compare, roles};
use crate::process::{cargo, line, output, run as run_command};
use crate::report::{Missing, Report};
use crate::{apt, embedded, firmware, tools};

struct Board {
    /// As QEMU and the Makefile name it.
    name: &'static str,
    /// As gcc, QEMU and rustc name it; the folder of its library under the prefix.
    cpu: &'static str,
    target: &'static str,
}

const BOARDS: &[Board] = &[
    Board { name: "an500", cpu: "cortex-m7", target: "thumbv7em-none-eabihf" },
    Board { name: "an386", cpu: "cortex-m4", target: "thumbv7em-none-eabihf" },
    Board { name: "an505", cpu: "cortex-m33", target: "thumbv8m.main-none-eabihf" },
];

/// The board that the example is built for with a memory of its own for the workspace and for the model.
const SECTIONS: &str = "an500";
/// What the example prints about addresses, the memory by its name in `mps2-sections.ld`, its start and its length.
const MEMORIES: [(&str, &str, u64, u64); 2] = [
    ("address of the workspace", "SSRAM 3", 0x2020_0000, 2 << 20),
    ("address of the model", "PSRAM", 0x6000_0000, 16 << 20),
];

/// Longer than the slowest board takes on a slow machine.
const TIMEOUT_S: &str = "900";

/// Builds each board's library and image, runs it, compares what it prints and says what it needs.
pub(super) fn run(
    which: Which,
    place: &Place,
    expected: &Expected,
    report: &mut Report,
) -> Result<()> {
    let boards = match which {
        Which::All => BOARDS,
        // The one whose example has memories of its own.
        Which::OnAChange => &BOARDS[..1],
        Which::Others => &BOARDS[1..],
    };
    let missing = apt::ensure(&[tools::MAKE, tools::ARM_GCC])
        .and_then(|()| apt::ensure(&[tools::QEMU_ARM]))
        .err();
    let mut table = String::new();
    for board in boards {
        if let Err(missing) = library(board, place)? {
            report.skip_part(&format!("{} ({})", board.cpu, board.name), missing);
            continue;
        }
        if let Some(missing) = &missing {
            let part = format!("example on {} ({}); its library is built", board.cpu, board.name);
            report.skip_part(&part, missing.clone());
            continue;
        }
        let image = build(board, place, false)?;
        let printed = emulate(board, &image)?;
        let name = format!("C firmware, {} ({})", board.cpu, board.name);
        compare(&name, &printed, expected)?;
        roles(&name, &printed, expected)?;
        table += &sizes(board, &image, &printed)?;
        symbols(board, &image)?;
        if board.name == SECTIONS {
            sections(board, place, expected)?;
        }
    }
    if !table.is_empty() {
        println!(
            "processor   code  constants  RAM without stack  of it workspace  stack  instructions a step, at most"
        );
        print!("{table}");
    }
    Ok(())
}

/// Builds the static library for a board and installs it, or says why it cannot.
fn library(board: &Board, place: &Place) -> Result<std::result::Result<(), Missing>> {
    // Apart: another processor makes cargo build everything again.
    let folder = place.folder.join(board.cpu);
    let mut build = cargo();
    build.args(["rustc", "--quiet", "--package", "rigidformer-capi", "--lib"]);
    build.args(["--profile", "embedded", "--features", EMBEDDED]);
    build.args(["--crate-type", "staticlib", "--target", board.target, "--target-dir"]);
    build
        .arg(&folder)
        .env("RUSTFLAGS", format!("-C target-cpu={} {}", board.cpu, embedded::SMALL_LIBRARY));
    if let Err(missing) = embedded::prepare(&mut build, board.target, false)? {
        return Ok(Err(missing));
    }
    run_command(&mut build).with_context(|| format!("{} must build", board.cpu))?;
    let built = folder.join(board.target).join("embedded/librigidformer_capi.a");
    copy(&built, &place.prefix.join("lib").join(board.cpu).join("librigidformer.a"))?;
    Ok(Ok(()))
}

/// Builds the image, or with `sections` the one that has the workspace and the model in memories of their own.
fn build(board: &Board, place: &Place, sections: bool) -> Result<PathBuf> {
    let absolute = |path: &str| {
        let path = Path::new(path).canonicalize().with_context(|| format!("no {path}"))?;
        Ok::<_, anyhow::Error>(path.display().to_string())
    };
    let folder = place.folder.join("boards");
    let mut make = Command::new("make");
    make.args(["--silent", "-C", "bindings/c/examples/firmware", &format!("BOARD={}", board.name)]);
    make.arg(format!("PREFIX={}", place.prefix.display()));
    make.arg(format!("MODEL={}", absolute(MODEL)?)).arg(format!("SCENE={}", absolute(SCENE)?));
    make.arg(format!("OUT={}", folder.display()));
    let suffix = if sections {
        make.arg("SECTIONS=1");
        "-sections"
    } else {
        ""
    };
    run_command(&mut make).context("the C firmware must build")?;
    Ok(folder.join(format!("{}{suffix}.elf", board.name)))
}

fn emulate(board: &Board, image: &Path) -> Result<String> {
    let mut command = Command::new("timeout");
    command.arg(TIMEOUT_S).arg(apt::program(tools::QEMU_ARM.name)).args(["-cpu", board.cpu]);
    command.args(["-machine", &format!("mps2-{}", board.name), "-nographic"]);
    command.args(["-monitor", "none", "-serial", "none", "-icount", "shift=0"]);
    command.args(["-semihosting-config", "enable=on,target=native", "-kernel"]).arg(image);
    // QEMU prints what the debugger is told to stderr.
    let done = command.output().with_context(|| format!("cannot start `{}`", line(&command)))?;
    let printed = String::from_utf8_lossy(&done.stdout) + String::from_utf8_lossy(&done.stderr);
    if !done.status.success() {
        bail!("`{}` failed: {}\n{printed}", line(&command), done.status);
    }
    Ok(printed.into_owned())
}

/// Runs the example with named sections: its bits are the plain one's, and things lie where the script puts them.
fn sections(board: &Board, place: &Place, expected: &Expected) -> Result<()> {
    let printed = emulate(board, &build(board, place, true)?)?;
    let name = format!("C firmware with named sections, {} ({})", board.cpu, board.name);
    compare(&name, &printed, expected)?;
    roles(&name, &printed, expected)?;
    for (what, memory, start, bytes) in MEMORIES {
        let address = measured(&printed, what)
            .and_then(|text| u64::from_str_radix(text, 16).ok())
            .with_context(|| format!("{name} prints no {what}:\n{printed}"))?;
        if !(start..start + bytes).contains(&address) {
            bail!(
                "{name}: the {what} is {address:#x}, outside {memory} ({start:#x}): see sections.ld"
            );
        }
        println!("{name}: the {what} is {address:#x}, in {memory}");
    }
    Ok(())
}

/// What the example says that it measured.
fn measured<'a>(printed: &'a str, name: &str) -> Option<&'a str> {
    let start = format!("measured {name} ");
    printed.lines().find_map(|line| line.strip_prefix(&start))
}

/// A line of the table, without the model and the scene.
fn sizes(board: &Board, image: &Path, printed: &str) -> Result<String> {
    let text = output(Command::new("arm-none-eabi-size").arg("-A").arg(image))?;
    let section = |name: &str| {
        let mut lines = text.lines().map(str::split_whitespace);
        let line =
            lines.find_map(|mut words| (words.next()? == name).then(|| words.next()?.parse().ok()));
        line.flatten().unwrap_or(0_u64)
    };
    let measured = |name: &str| measured(printed, name).unwrap_or("?");
    let data = fs::metadata(MODEL)?.len() + fs::metadata(SCENE)?.len();
    Ok(format!(
        "{:<10} {:>5} {:>10} {:>18} {:>16} {:>6} {:>9}\n",
        board.cpu,
        section(".text"),
        section(".rodata").saturating_sub(data),
        section(".data") + section(".bss"),
        measured("workspace"),
        measured("stack"),
        measured("instructions of a step, at most"),
    ))
}

/// Nothing of an allocator may be linked, and nothing that panics.
fn symbols(board: &Board, image: &Path) -> Result<()> {
    let found = firmware::forbidden(&fs::read(image)?, true)?;
    if !found.is_empty() {
        bail!("{} has {}", image.display(), found.join(", "));
    }
    println!("C firmware, {}: no allocator and no panic in it", board.cpu);
    Ok(())
}
