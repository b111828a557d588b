//! The component for ESP-IDF: packed, and built by its own CMake files for the processors of the chips, under QEMU.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::{Context, Result, bail};

use super::{Place, build, configure};
use crate::apt::{self, Tool};
use crate::process::{cargo, line, output, run as run_command};
use crate::report::{Missing, Report};
use crate::{capi, embedded};

const COMPONENT: &str = "bindings/esp-idf/rigidformer";
const TEST: &str = "bindings/esp-idf/test";
const MODEL: &str = "weights/models/nano.rfm";
/// Longer than the slowest processor takes on a slow machine.
const TIMEOUT_S: &str = "300";

/// A processor, and a chip that has it.
struct Processor {
    chip: &'static str,
    target: &'static str,
    /// As QEMU names it.
    cpu: &'static str,
}

const PROCESSORS: [Processor; 3] = [
    Processor {
        chip: "esp32c3",
        target: "riscv32imc-unknown-none-elf",
        // Without atomic instructions and floating point: they would be a fault.
        cpu: "rv32,a=false,f=false,d=false",
    },
    Processor {
        chip: "esp32c6",
        target: "riscv32imac-unknown-none-elf",
        cpu: "rv32,f=false,d=false",
    },
    Processor { chip: "esp32p4", target: "riscv32imafc-unknown-none-elf", cpu: "rv32,d=false" },
];

/// What a packed component has, besides a library for each processor.
const PACKED: [&str; 18] = [
    "CMakeLists.txt",
    "Kconfig",
    "LICENSE-APACHE",
    "LICENSE-MIT",
    "README.md",
    "THIRD-PARTY.txt",
    "examples/fall/CMakeLists.txt",
    "examples/fall/main/CMakeLists.txt",
    "examples/fall/main/app_main.c",
    "examples/fall/main/fall.c",
    "examples/fall/main/fall.h",
    "examples/fall/main/idf_component.yml",
    "examples/fall/nano.rfm",
    "examples/fall/sdkconfig.defaults",
    "idf_component.yml",
    "include/rigidformer.h",
    "project_include.cmake",
    "share/model.S",
];

const SOURCE: &str = "#include <stdint.h>\n\
    void _start(void) { volatile uint64_t a = 9, b = 2; a /= b; }\n";

const RISCV_GCC: Tool = Tool {
    name: "riscv64-unknown-elf-gcc",
    packages: &["gcc-riscv64-unknown-elf", "binutils-riscv64-unknown-elf"],
    movable: false,
    proof: |folder| {
        fs::write(folder.join("proof.c"), SOURCE)?;
        for flags in ["-march=rv32imac -mabi=ilp32", "-march=rv32imafc -mabi=ilp32f"] {
            let mut command = Command::new("riscv64-unknown-elf-gcc");
            command.args(flags.split(' ')).args(["-ffreestanding", "-nostdlib", "proof.c"]);
            output(command.args(["-lgcc", "-o", "proof"]).current_dir(folder))?;
        }
        Ok(())
    },
};

/// `lui t1, 0x100; lui t0, 5; addi t0, t0, 0x555; sw t0, 0(t1); j .`: the test device of QEMU's machine ends it.
const EXITS: [u32; 5] = [0x0010_0337, 0x0000_52b7, 0x5552_8293, 0x0053_2023, 0x0000_006f];

const QEMU: Tool = Tool {
    name: "qemu-system-riscv32",
    packages: &["qemu-system-misc"],
    movable: true,
    proof: |folder| {
        let image = folder.join("proof.bin");
        let bytes: Vec<u8> = EXITS.iter().flat_map(|word| word.to_le_bytes()).collect();
        fs::write(&image, bytes)?;
        for processor in &PROCESSORS {
            let mut command = qemu(processor);
            let image = image.display();
            command.arg("-device").arg(format!("loader,file={image},addr=0x80000000,force-raw=on"));
            output(&mut command).with_context(|| format!("{} does not run", processor.cpu))?;
        }
        Ok(())
    },
};

/// QEMU's machine with a processor.
fn qemu(processor: &Processor) -> Command {
    let mut command = Command::new("timeout");
    command.arg(TIMEOUT_S).arg(apt::program(QEMU.name)).args(["-machine", "virt", "-bios", "none"]);
    command.args(["-cpu", processor.cpu, "-display", "none", "-monitor", "none"]);
    command.args(["-serial", "stdio"]);
    command
}

pub(super) fn run(
    place: &Place,
    python: &std::result::Result<(), Missing>,
    report: &mut Report,
) -> Result<()> {
    let stage = stage(place)?;
    refusals(place)?;
    let mut built = Vec::new();
    for processor in &PROCESSORS {
        match library(processor, place, &stage)? {
            Ok(()) => built.push(processor),
            Err(missing) => {
                report.skip_part(&format!("{} for ESP-IDF", processor.target), missing);
            }
        }
    }
    // From here on the component is what a user has: unpacked, without the repository around it.
    let component = match python {
        Ok(()) => pack(place, &stage, &built)?,
        Err(missing) => {
            report.skip_part("packing the component for ESP-IDF", missing.clone());
            stage
        }
    };
    match apt::ensure(&[RISCV_GCC]).and_then(|()| apt::ensure(&[QEMU])) {
        Ok(()) => emulate(place, &component, &built),
        Err(missing) => {
            report.skip_part("the component for ESP-IDF under QEMU", missing);
            Ok(())
        }
    }
}

/// Copies what a component has: its own files, header, model and licences.
fn stage(place: &Place) -> Result<PathBuf> {
    let folder = place.empty("stage")?.join("rigidformer");
    run_command(Command::new("cp").args(["--recursive", COMPONENT]).arg(&folder))?;
    for (from, to) in [
        ("bindings/c/include/rigidformer.h", "include/rigidformer.h"),
        ("bindings/c/share/model.S", "share/model.S"),
        (MODEL, "examples/fall/nano.rfm"),
    ] {
        copy(Path::new(from), &folder.join(to))?;
    }
    let targets: Vec<&str> = PROCESSORS.iter().map(|processor| processor.target).collect();
    capi::licences(&folder, capi::EMBEDDED, &targets)?;
    Ok(folder)
}

/// Builds the library for a processor and puts it into the component, or says why it cannot.
fn library(
    processor: &Processor,
    place: &Place,
    stage: &Path,
) -> Result<std::result::Result<(), Missing>> {
    let folder = place.folder.join("cargo");
    let mut command = cargo();
    command.args(["rustc", "--quiet", "--package", "rigidformer-capi", "--lib"]);
    command.args(["--profile", "embedded", "--features", capi::EMBEDDED]);
    command.args(["--crate-type", "staticlib", "--target", processor.target, "--target-dir"]);
    command.arg(&folder).env("RUSTFLAGS", embedded::SMALL_LIBRARY);
    if let Err(missing) = embedded::prepare(&mut command, processor.target, false)? {
        return Ok(Err(missing));
    }
    run_command(&mut command).with_context(|| format!("{} must build", processor.target))?;
    let built = folder.join(processor.target).join("embedded/librigidformer_capi.a");
    let to = stage.join("lib").join(processor.target).join("librigidformer.a");
    copy(&built, &to)?;
    println!(
        "ESP-IDF: {} for {}, {} bytes",
        processor.target,
        processor.chip,
        fs::metadata(to)?.len()
    );
    Ok(Ok(()))
}

/// Packs the component as its registry would get it, compares the list of files and unpacks it.
fn pack(place: &Place, stage: &Path, built: &[&Processor]) -> Result<PathBuf> {
    let archives = place.empty("archives")?;
    let mut command = place.program("compote");
    command.args(["component", "pack", "--name", "rigidformer", "--project-dir"]).arg(stage);
    command.arg("--dest-dir").arg(&archives);
    // Packing needs no network.
    command.env("IDF_COMPONENT_CHECK_NEW_VERSION", "0").env("IDF_TOOLS_PATH", &place.folder);
    output(&mut command)?;
    let archive = archives.join(concat!("rigidformer_", env!("CARGO_PKG_VERSION"), ".tgz"));
    let listed = output(Command::new("tar").arg("--list").arg("--file").arg(&archive))
        .context("the version in idf_component.yml must be the workspace's")?;
    let mut found: Vec<&str> = listed
        .lines()
        .filter_map(|name| name.strip_prefix("./"))
        .filter(|name| !name.is_empty() && !name.ends_with('/'))
        .collect();
    found.sort_unstable();
    let libraries =
        built.iter().map(|processor| format!("lib/{}/librigidformer.a", processor.target));
    let mut wanted: Vec<String> =
        PACKED.iter().map(|&name| name.to_owned()).chain(libraries).collect();
    wanted.sort_unstable();
    if found != wanted {
        bail!("the packed component has\n{}\nexpected\n{}", found.join("\n"), wanted.join("\n"));
    }
    println!("ESP-IDF: compote packs the component, {} files", found.len());
    let component = place.empty("component")?.join("rigidformer");
    fs::create_dir_all(&component)?;
    run_command(
        Command::new("tar").arg("--extract").arg("--file").arg(&archive).arg("-C").arg(&component),
    )?;
    Ok(component)
}

/// Configures the component for a chip.
fn component(folder: &Path, component: &Path, chip: &str) -> Result<Command> {
    let component = component.canonicalize().context("no component")?;
    let mut command = configure(Path::new(TEST), folder);
    command.arg(format!("-DCOMPONENT={}", component.display()));
    command.arg(format!("-DIDF_TARGET={chip}"));
    Ok(command)
}

/// What the component's CMake files say where they cannot go on.
fn refusals(place: &Place) -> Result<()> {
    let component_folder = Path::new(COMPONENT);
    // As it lies in the repository, but nowhere near it.
    let lonely = place.empty("lonely")?.join("rigidformer");
    run_command(Command::new("cp").args(["--recursive", COMPONENT]).arg(&lonely))?;
    copy(Path::new("bindings/c/include/rigidformer.h"), &lonely.join("include/rigidformer.h"))?;
    let none = "-DCONFIG_RIGIDFORMER_LIBRARY=/no/such.a";
    let cargo = "-DRIGIDFORMER_CARGO=RIGIDFORMER_CARGO-NOTFOUND";
    for (chip, folder, option, said) in [
        ("esp32s3", component_folder, None, "esp32s3 has an Xtensa core"),
        ("esp32", component_folder, None, "idf.py set-target esp32p4"),
        ("esp32c61", component_folder, None, "there is no library for esp32c61 yet"),
        (
            "esp32c6",
            component_folder,
            Some(none),
            "there is no /no/such.a. Correct RIGIDFORMER_LIBRARY",
        ),
        ("esp32c6", &lonely, None, "Take a packed component"),
        ("esp32c6", component_folder, Some(cargo), "Install Rust"),
    ] {
        // There, no search path hides a cargo.
        if option == Some(cargo) && cargo_at_large() {
            continue;
        }
        let mut command = component(&place.empty("refused")?, folder, chip)?;
        command.args(option);
        if option == Some(cargo) {
            command.env("PATH", "/usr/local/bin:/usr/bin:/bin");
            command.env("HOME", "/nonexistent").env("CARGO_HOME", "/nonexistent");
        }
        let done =
            command.output().with_context(|| format!("cannot start `{}`", line(&command)))?;
        // CMake breaks lines where it likes.
        let printed = String::from_utf8_lossy(&done.stderr);
        let words = printed.split_whitespace().collect::<Vec<_>>().join(" ");
        if done.status.success() || !words.contains(said) {
            bail!(
                "the component for {chip} must be refused with `{said}`, and CMake says:\n{printed}"
            );
        }
    }
    // ESP-IDF reads requirements before it knows a configuration.
    let mut early = Command::new("cmake");
    early.arg(format!("-DCOMPONENT={COMPONENT}/examples/fall/main")).arg("-P");
    let printed = output(early.arg(Path::new(TEST).join("idf.cmake")))?;
    if !printed.contains("requires: rigidformer, for itself: esp_timer") {
        bail!("the example's requirements are read as {printed:?}");
    }
    let mut early = Command::new("cmake");
    early.arg(format!("-DCOMPONENT={COMPONENT}")).arg("-P");
    output(early.arg(Path::new(TEST).join("idf.cmake")))?;
    println!("ESP-IDF: refusals say what to do; requirements are read without a configuration");
    Ok(())
}

/// Whether a cargo lies where every search looks.
pub(super) fn cargo_at_large() -> bool {
    ["/usr/local/bin", "/usr/bin", "/bin"]
        .iter()
        .any(|folder| Path::new(folder).join("cargo").exists())
}

/// Runs the example on the processors and compares the bits of its poses with this machine's.
fn emulate(place: &Place, packed: &Path, built: &[&Processor]) -> Result<()> {
    let host = place.folder.join("esp-host");
    let library = place.prefix.join("lib/librigidformer.a");
    let mut command = component(&host, packed, "esp32c6")?;
    output(command.arg(format!("-DCONFIG_RIGIDFORMER_LIBRARY={}", library.display())))?;
    build(&host)?;
    let expected = output(&mut Command::new(host.join("run")))?;
    if expected.lines().count() < 12 {
        bail!("the example prints here:\n{expected}");
    }
    let toolchain = Path::new(TEST).join("riscv.cmake").canonicalize()?;
    let image = |name: &str, folder: &Path, chip: &str| {
        let build_folder = place.empty(name)?;
        let mut command = component(&build_folder, folder, chip)?;
        command.arg(format!("-DCMAKE_TOOLCHAIN_FILE={}", toolchain.display()));
        // What Kconfig says where nobody said anything else.
        command.args(["-DCONFIG_RIGIDFORMER_FEATURES="]);
        output(&mut command)?;
        build(&build_folder)?;
        Ok::<_, anyhow::Error>(build_folder.join("run"))
    };
    for processor in built {
        weak(&packed.join("lib").join(processor.target).join("librigidformer.a"))?;
        let image = image(processor.chip, packed, processor.chip)?;
        compare(processor, &image, &expected, "packed")?;
    }
    // The repository's own component has no library: its CMake files let cargo build one.
    if let Some(processor) = built.iter().find(|processor| processor.chip == "esp32c6") {
        let image = image("esp-by-cargo", Path::new(COMPONENT), processor.chip)?;
        compare(processor, &image, &expected, "built by cargo")?;
    }
    Ok(())
}

/// An application may leave `rf_panic` out, and may have its own: the library's must be weak.
fn weak(library: &Path) -> Result<()> {
    let symbols = output(Command::new("riscv64-unknown-elf-nm").arg(library))?;
    if !symbols.lines().any(|symbol| symbol.ends_with(" W rf_panic")) {
        bail!("{} has no weak rf_panic", library.display());
    }
    Ok(())
}

fn compare(processor: &Processor, image: &Path, expected: &str, which: &str) -> Result<()> {
    let printed = output(qemu(processor).arg("-kernel").arg(image))
        .with_context(|| format!("the example must run on {}", processor.target))?;
    if printed != expected {
        bail!("{} prints\n{printed}expected\n{expected}", processor.target);
    }
    println!(
        "ESP-IDF: {} ({}, {which}): the example's poses have the bits of this machine",
        processor.target, processor.chip
    );
    Ok(())
}

/// Copies a file, making folders.
fn copy(from: &Path, to: &Path) -> Result<()> {
    if let Some(folder) = to.parent() {
        fs::create_dir_all(folder).with_context(|| format!("cannot make {}", folder.display()))?;
    }
    fs::copy(from, to)
        .with_context(|| format!("cannot copy {} to {}", from.display(), to.display()))?;
    Ok(())
}
