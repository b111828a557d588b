//! The tools of the checks: their packages, and a few lines that prove them.

use std::fs;
use std::path::Path;
use std::process::Command;

use anyhow::{Context, Result, bail};

use crate::apt::{self, Tool};
use crate::process::output;

/// Longer than an emulator takes for a few instructions, on any machine.
const TIMEOUT_S: &str = "120";

const SAYS_HELLO: &str = "#include <stdio.h>\n#include <string.h>\n\
    int main(void) { char word[8]; strcpy(word, \"hello\"); return puts(word) < 0; }\n";

const CXX17: &str = "#include <array>\n#include <cstdio>\n#include <string>\n#include <string_view>\n\
    int main() { auto [a, b] = std::array{1, 2}; std::string_view word = \"hello\";\n\
    return a < b ? std::puts(std::string(word).c_str()) < 0 : 1; }\n";

const CMAKE: &str = "cmake_minimum_required(VERSION 3.18)\nproject(proof LANGUAGES C CXX ASM)\n\
    add_executable(proof proof.c)\n";

const PKG_CONFIG: &str = "Name: proof\nDescription: proof\nVersion: 1\nCflags: -DPROOF\n";

/// As the C firmware uses the compiler: headers of the C library, libgcc for hard floats, no start files.
const CORTEX_M: &str = "#include <stdint.h>\n#include <string.h>\n\
    uint64_t copied; void start(uint64_t *from) { memcpy(&copied, from, sizeof copied); copied /= 10; }\n\
    void *memcpy(void *to, const void *from, size_t bytes) {\n\
    for (size_t i = 0; i < bytes; i++) ((char *)to)[i] = ((const char *)from)[i];\n\
    return to; }\n";

/// The machines of QEMU that play the boards, with their processors and the addresses that they start from.
const MACHINES: [(&str, &str, u32); 4] = [
    ("mps2-an500", "cortex-m7", 0),
    ("mps2-an386", "cortex-m4", 0),
    ("mps2-an505", "cortex-m33", 0x1000_0000),
    ("mps3-an547", "cortex-m55", 0),
];

/// An image that ends QEMU: stack, reset vector, then `movs r0, #0x18; ldr r1, =0x20026; bkpt 0xab; nop`, which is
/// the exit of semihosting.
fn exits(start: u32) -> Vec<u8> {
    let mut image = Vec::new();
    image.extend(0x2000_1000_u32.to_le_bytes());
    // The code follows the two words; odd addresses are Thumb code.
    image.extend((start + 9).to_le_bytes());
    for instruction in [0x2018_u16, 0x4901, 0xbeab, 0xbf00] {
        image.extend(instruction.to_le_bytes());
    }
    image.extend(0x0002_0026_u32.to_le_bytes());
    image
}

pub(crate) const CC: Tool = Tool {
    name: "cc",
    packages: &["gcc", "libc6-dev"],
    movable: false,
    proof: |folder| compiles_and_runs(folder, "cc", "proof.c", SAYS_HELLO, "-std=c11"),
};

pub(crate) const CXX: Tool = Tool {
    name: "c++",
    packages: &["g++", "libc6-dev"],
    movable: false,
    proof: |folder| compiles_and_runs(folder, "c++", "proof.cpp", CXX17, "-std=c++17"),
};

pub(crate) const MAKE: Tool = Tool {
    name: "make",
    packages: &["make"],
    movable: false,
    proof: |folder| {
        fs::write(folder.join("Makefile"), "proof:\n\techo hello > $@\n")?;
        output(Command::new("make").current_dir(folder))?;
        says_hello(&fs::read_to_string(folder.join("proof"))?)
    },
};

pub(crate) const CMAKE_TOOL: Tool = Tool {
    name: "cmake",
    packages: &["cmake", "make", "g++", "gcc", "libc6-dev"],
    movable: false,
    proof: |folder| {
        fs::write(folder.join("CMakeLists.txt"), CMAKE)?;
        fs::write(folder.join("proof.c"), SAYS_HELLO)?;
        output(Command::new("cmake").args(["-S", ".", "-B", "build"]).current_dir(folder))?;
        output(Command::new("cmake").args(["--build", "build"]).current_dir(folder))?;
        says_hello(&output(&mut Command::new(folder.join("build/proof")))?)
    },
};

pub(crate) const PKG_CONFIG_TOOL: Tool = Tool {
    name: "pkg-config",
    packages: &["pkg-config"],
    movable: false,
    proof: |folder| {
        fs::write(folder.join("proof.pc"), PKG_CONFIG)?;
        let mut command = Command::new("pkg-config");
        command.args(["--cflags", "proof"]).env("PKG_CONFIG_PATH", folder);
        let flags = output(&mut command)?;
        if flags.trim() != "-DPROOF" {
            bail!("`pkg-config --cflags` prints {flags:?} for -DPROOF");
        }
        Ok(())
    },
};

pub(crate) const ARM_GCC: Tool = Tool {
    name: "arm-none-eabi-gcc",
    packages: &["gcc-arm-none-eabi", "binutils-arm-none-eabi", "libnewlib-arm-none-eabi"],
    movable: false,
    proof: |folder| {
        fs::write(folder.join("proof.c"), CORTEX_M)?;
        for processor in [
            "cortex-m7 -mfpu=fpv5-d16",
            "cortex-m4 -mfpu=fpv4-sp-d16",
            "cortex-m33 -mfpu=fpv5-sp-d16",
        ] {
            let mut command = Command::new("arm-none-eabi-gcc");
            command.args(format!("-mcpu={processor}").split(' '));
            command.args([
                "-mthumb",
                "-mfloat-abi=hard",
                "-std=c11",
                "-ffreestanding",
                "-nostdlib",
            ]);
            command.args(["-Wl,-e,start", "proof.c", "-lgcc", "-o", "proof"]);
            output(command.current_dir(folder))?;
        }
        output(Command::new("arm-none-eabi-size").args(["-A", "proof"]).current_dir(folder))?;
        Ok(())
    },
};

pub(crate) const QEMU_ARM: Tool = Tool {
    name: "qemu-system-arm",
    packages: &["qemu-system-arm"],
    movable: true,
    proof: |folder| {
        let image = folder.join("proof.bin");
        for (machine, cpu, start) in MACHINES {
            fs::write(&image, exits(start))?;
            let mut command = Command::new("timeout");
            command.arg(TIMEOUT_S).arg(apt::program(QEMU_ARM.name));
            command
                .args(["-machine", machine, "-cpu", cpu, "-display", "none", "-monitor", "none"]);
            command.args(["-serial", "none", "-icount", "shift=0"]);
            command.args(["-semihosting-config", "enable=on,target=native", "-device"]);
            let image = image.display();
            command.arg(format!("loader,file={image},addr={start:#x},force-raw=on"));
            output(&mut command).with_context(|| format!("{machine} does not run an image"))?;
        }
        Ok(())
    },
};

pub(crate) const AARCH64: [Tool; 2] = [
    Tool {
        name: "aarch64-linux-gnu-gcc",
        packages: &["gcc-aarch64-linux-gnu", "libc6-dev-arm64-cross"],
        movable: false,
        proof: |folder| {
            compiles(folder, "aarch64-linux-gnu-gcc", "proof.c", SAYS_HELLO, "-std=c11")
        },
    },
    Tool {
        name: "qemu-aarch64",
        packages: &["qemu-user", "gcc-aarch64-linux-gnu", "libc6-dev-arm64-cross"],
        movable: false,
        proof: |folder| crosses(folder, "aarch64-linux-gnu", "qemu-aarch64"),
    },
];

pub(crate) const RISCV64: [Tool; 2] = [
    Tool {
        name: "riscv64-linux-gnu-gcc",
        packages: &["gcc-riscv64-linux-gnu", "libc6-dev-riscv64-cross"],
        movable: false,
        proof: |folder| {
            compiles(folder, "riscv64-linux-gnu-gcc", "proof.c", SAYS_HELLO, "-std=c11")
        },
    },
    Tool {
        name: "qemu-riscv64",
        packages: &["qemu-user", "gcc-riscv64-linux-gnu", "libc6-dev-riscv64-cross"],
        movable: false,
        proof: |folder| crosses(folder, "riscv64-linux-gnu", "qemu-riscv64"),
    },
];

pub(crate) const VALGRIND: Tool = Tool {
    name: "valgrind",
    packages: &["valgrind", "libc6-dbg"],
    movable: false,
    proof: |folder| {
        let counts = folder.join("counts");
        let mut command = Command::new("valgrind");
        command.args(["--quiet", "--tool=callgrind"]);
        output(command.arg(format!("--callgrind-out-file={}", counts.display())).arg("true"))?;
        if !fs::read_to_string(&counts)?.contains("\nfn=") {
            bail!("callgrind counted nothing");
        }
        Ok(())
    },
};

pub(crate) const DEBOOTSTRAP: Tool = Tool {
    name: "debootstrap",
    packages: &["debootstrap"],
    movable: false,
    proof: |_| output(Command::new("debootstrap").arg("--version")).map(drop),
};

pub(crate) const PYTHON: Tool = Tool {
    name: "python3",
    packages: &["python3", "python3-venv"],
    movable: false,
    // Debian's Python may be there without what an environment takes.
    proof: |folder| {
        let venv = folder.join("venv");
        output(Command::new("python3").args(["-m", "venv"]).arg(&venv))?;
        let python = venv.join("bin/python");
        let least =
            "import sys; assert sys.version_info >= (3, 9), 'Python 3.9 or newer is needed'";
        output(Command::new(&python).args(["-c", least]))?;
        output(Command::new(&python).args(["-m", "pip", "--version"])).map(drop)
    },
};

/// Compiles a source into `proof`.
fn compiles(folder: &Path, compiler: &str, file: &str, source: &str, standard: &str) -> Result<()> {
    fs::write(folder.join(file), source)?;
    let mut command = Command::new(compiler);
    command.args([standard, "-Wall", file, "-o", "proof"]);
    output(command.current_dir(folder)).map(drop)
}

fn compiles_and_runs(
    folder: &Path,
    compiler: &str,
    file: &str,
    source: &str,
    standard: &str,
) -> Result<()> {
    compiles(folder, compiler, file, source, standard)?;
    says_hello(&output(&mut Command::new(folder.join("proof")))?)
}

/// Compiles for another processor and runs under an emulator.
fn crosses(folder: &Path, gnu: &str, emulator: &str) -> Result<()> {
    compiles(folder, &format!("{gnu}-gcc"), "proof.c", SAYS_HELLO, "-std=c11")?;
    let mut command = Command::new("timeout");
    command.args([TIMEOUT_S, emulator, "-L", &format!("/usr/{gnu}")]).arg(folder.join("proof"));
    says_hello(&output(&mut command)?)
}

fn says_hello(printed: &str) -> Result<()> {
    if printed != "hello\n" {
        bail!("the proof prints {printed:?}");
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_image_for_qemu_has_its_constant_where_the_code_looks() {
        let image = exits(0x1000_0000);
        // `ldr r1, [pc, #4]` at 10: the program counter is 14, rounded down to 12.
        assert_eq!(image.get(12 + 4..), Some(&[0x26, 0x00, 0x02, 0x00][..]));
        assert_eq!(image.get(4..8), Some(&[0x09, 0x00, 0x00, 0x10][..]));
    }

    #[test]
    fn a_compiler_without_headers_fails_its_proof() -> Result<()> {
        let folder = tempfile::tempdir()?;
        let source = "#include <no_such_header.h>\nint main(void) { return 0; }\n";
        let error = compiles(folder.path(), "cc", "proof.c", source, "-std=c11");
        assert!(error.is_err_and(|error| error.to_string().contains("no_such_header.h")));
        (CC.proof)(folder.path())
    }
}
