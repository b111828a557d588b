//! The boards that QEMU plays, and how images get onto them.

use std::env;
use std::io::Read;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::thread;
use std::time::{Duration, Instant};

use anyhow::{Context, Result, anyhow, bail};
use clap::ValueEnum;

use crate::process::{cargo, line, run as run_command};
use crate::report::Missing;
use crate::{apt, embedded, tools};

/// The folder of the images, a workspace of its own.
pub(super) const FOLDER: &str = "firmware-sim/firmware";
/// Those that are built together: the models of a robot and of cloth have memory of their own, and they and health take more of the core
/// than the others pay for.
const IMAGES: [&[&str]; 5] = [
    &["--bins"],
    &["--bin", "walk", "--features", "walk"],
    &["--bin", "drape", "--features", "drape"],
    &["--bin", "runtime_soft", "--features", "deform"],
    &["--bin", "health", "--features", "health"],
];
/// An image that runs longer hangs.
const TIMEOUT: Duration = Duration::from_secs(300);

/// A processor.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(crate) enum Board {
    /// Cortex-M7 with double precision (mps2-an500).
    M7,
    /// Cortex-M4F (mps2-an386).
    M4,
    /// Cortex-M33 (mps2-an505).
    M33,
    /// Cortex-M55 with Helium (mps3-an547).
    M55,
}

impl Board {
    pub(super) const ALL: [Board; 4] = [Board::M7, Board::M4, Board::M33, Board::M55];

    pub(super) fn name(self) -> &'static str {
        match self {
            Board::M7 => "m7",
            Board::M4 => "m4",
            Board::M33 => "m33",
            Board::M55 => "m55",
        }
    }

    /// As both the compiler and QEMU call it.
    pub(super) fn cpu(self) -> &'static str {
        match self {
            Board::M7 => "cortex-m7",
            Board::M4 => "cortex-m4",
            Board::M33 => "cortex-m33",
            Board::M55 => "cortex-m55",
        }
    }

    pub(super) fn machine(self) -> &'static str {
        match self {
            Board::M7 => "mps2-an500",
            Board::M4 => "mps2-an386",
            Board::M33 => "mps2-an505",
            Board::M55 => "mps3-an547",
        }
    }

    pub(super) fn target(self) -> &'static str {
        match self {
            Board::M7 | Board::M4 => "thumbv7em-none-eabihf",
            Board::M33 | Board::M55 => "thumbv8m.main-none-eabihf",
        }
    }

    /// The name of the kernels that are made for the processor.
    pub(super) fn kernels(self) -> &'static str {
        match self {
            Board::M7 | Board::M4 | Board::M33 => "cortex-m",
            Board::M55 => "helium",
        }
    }

    /// What the compiler is told besides the processor's name. Helium takes subnormal floats for zeros, so the compiler
    /// must not compute with it; kernels do where they can tell (docs/CORTEX-M.md). Copying by Helium is safe.
    fn flags(self) -> &'static str {
        match self {
            Board::M7 | Board::M4 | Board::M33 => "",
            Board::M55 => {
                " -C no-vectorize-loops -C no-vectorize-slp -C llvm-args=-arm-memtransfer-tploop=force-enabled"
            }
        }
    }

    /// By how much the instructions of a step may depend on what is in the scene. Impulses and impacts do, which are
    /// scalar code; where the network takes fewer instructions they are more of the whole.
    pub(super) fn dependence(self) -> f64 {
        match self {
            Board::M7 | Board::M4 | Board::M33 => 0.05,
            Board::M55 => 0.15,
        }
    }

    fn target_folder(self) -> PathBuf {
        let target = env::var_os("CARGO_TARGET_DIR").unwrap_or_else(|| "target".into());
        Path::new(&target).join("firmware").join(self.name())
    }

    /// Where an image lies after [`build`](Self::build).
    pub(super) fn image(self, name: &str) -> PathBuf {
        self.target_folder().join(self.target()).join("release").join(name)
    }

    /// Builds all images, or tells why this machine cannot.
    pub(super) fn build(self) -> Result<std::result::Result<(), Missing>> {
        for images in IMAGES {
            let mut command = match self.command("build", images)? {
                Ok(command) => command,
                Err(missing) => return Ok(Err(missing)),
            };
            run_command(&mut command).with_context(|| {
                format!(
                    "{}: the images must build; where `the_runtime_must_not_be_able_to_panic` is undefined, something \
                     in core can panic (docs/FIRMWARE.md tells how to find it)",
                    self.name()
                )
            })?;
        }
        Ok(Ok(()))
    }

    /// Builds the image `rollout` with another model in the place of nano; the image, or why this machine cannot.
    pub(super) fn build_own(self, model: &Path) -> Result<std::result::Result<PathBuf, Missing>> {
        let mut command = match self.command("build", &["--bin", "rollout"])? {
            Ok(command) => command,
            Err(missing) => return Ok(Err(missing)),
        };
        command.env("RIGIDFORMER_MODEL", model);
        run_command(&mut command)
            .with_context(|| format!("{}: the image must build", self.name()))?;
        Ok(Ok(self.image("rollout")))
    }

    /// Lints all images, where they can be built.
    pub(super) fn lint(self) -> Result<()> {
        for images in IMAGES {
            if let Ok(mut command) = self.command("clippy", images)? {
                run_command(command.args(["--", "--deny", "warnings"]))?;
            }
        }
        Ok(())
    }

    /// A cargo command on images, or why this machine cannot build them.
    fn command(self, verb: &str, images: &[&str]) -> Result<std::result::Result<Command, Missing>> {
        let mut command = cargo();
        command.args([verb, "--quiet", "--release", "--locked"]).args(images);
        command.arg("--manifest-path");
        command.arg(Path::new(FOLDER).join("Cargo.toml")).args(["--target", self.target()]);
        command.arg("--target-dir").arg(self.target_folder());
        if let Err(missing) = embedded::prepare(&mut command, self.target(), false)? {
            return Ok(Err(missing));
        }
        let target = self.target().to_uppercase().replace(['-', '.'], "_");
        command.env_remove("RIGIDFORMER_MODEL");
        command.env_remove("RUSTFLAGS").env_remove("CARGO_ENCODED_RUSTFLAGS");
        command.env(
            format!("CARGO_TARGET_{target}_RUSTFLAGS"),
            format!("-C target-cpu={} {}{}", self.cpu(), embedded::SMALL, self.flags()),
        );
        command.env("DEFMT_LOG", "info");
        Ok(Ok(command))
    }

    /// Runs an image to its end for what it sends, still encoded.
    pub(super) fn run(self, image: &Path) -> Result<Vec<u8>> {
        let mut command = Command::new(apt::program(tools::QEMU_ARM.name));
        command.args(["-machine", self.machine(), "-cpu", self.cpu()]);
        // One instruction takes a nanosecond: the images count instructions with a timer.
        command.args(["-icount", "shift=0", "-display", "none", "-monitor", "none"]);
        command.args(["-serial", "none", "-semihosting-config", "enable=on,target=native"]);
        command.arg("-kernel").arg(image);
        let mut child = command
            .stdin(Stdio::null())
            .stdout(Stdio::piped())
            .spawn()
            .with_context(|| format!("cannot start `{}`", line(&command)))?;
        let mut pipe = child.stdout.take().context("no output of QEMU")?;
        let reader = thread::spawn(move || {
            let mut sent = Vec::new();
            pipe.read_to_end(&mut sent).map(|_| sent)
        });
        let start = Instant::now();
        let status = loop {
            if let Some(status) = child.try_wait()? {
                break Some(status);
            }
            if start.elapsed() > TIMEOUT {
                child.kill()?;
                child.wait()?;
                break None;
            }
            thread::sleep(Duration::from_millis(20));
        };
        let sent = reader.join().map_err(|_| anyhow!("the reader of QEMU's output died"))??;
        match status {
            None => bail!("`{}` was still running after {TIMEOUT:?}", line(&command)),
            // What it sent tells more than the code.
            Some(_) => Ok(sent),
        }
    }
}
