//! The C library within ROS 2, ESP-IDF and Zephyr, as far as it goes without them.

mod esp_idf;
mod ros2;
mod zephyr;

use std::env;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::{Context, Result};

use crate::process::{line, output, run as run_command};
use crate::report::{Missing, Report};
use crate::{apt, capi, tools};

/// What reads packages as the ecosystems do.
const PYTHON: [&str; 5] = [
    "catkin_pkg==1.1.1",
    "idf-component-manager==3.1.2",
    "PyYAML==6.0.3",
    "west==1.5.0",
    "kconfiglib==14.1.0",
];

/// Installs the library, then checks the package for ROS 2 and the component for ESP-IDF and the module for Zephyr.
pub(crate) fn run(report: &mut Report) -> Result<()> {
    if let Err(missing) = apt::ensure(&[tools::CC, tools::CXX, tools::CMAKE_TOOL]) {
        report.skip(missing);
        return Ok(());
    }
    let folder = env::var_os("CARGO_TARGET_DIR").map_or_else(|| "target".into(), PathBuf::from);
    let folder = folder.join("integrations");
    fs::create_dir_all(&folder).context("cannot make a folder")?;
    let folder = folder.canonicalize()?;
    let place = Place { prefix: folder.join("prefix"), venv: folder.join("venv"), folder };
    capi::install(&place.prefix)?;
    let python = place.environment()?;
    zephyr::run(&place, &python, report)?;
    ros2::run(&place, &python, report)?;
    esp_idf::run(&place, &python, report)
}

/// Where things are, absolute.
struct Place {
    folder: PathBuf,
    prefix: PathBuf,
    venv: PathBuf,
}

impl Place {
    /// Makes an environment with the packages of [`PYTHON`], or tells why it cannot be had.
    fn environment(&self) -> Result<std::result::Result<(), Missing>> {
        if let Err(missing) = apt::ensure(&[tools::PYTHON]) {
            return Ok(Err(missing));
        }
        run_command(Command::new("python3").args(["-m", "venv", "--clear"]).arg(&self.venv))?;
        let mut pip = self.program("python");
        pip.args(["-m", "pip", "install", "--quiet", "--disable-pip-version-check"]).args(PYTHON);
        Ok(output(&mut pip).map(drop).map_err(|error| {
            let remedy =
                format!("give pip a network, or wheels by PIP_FIND_LINKS; then {}", line(&pip));
            Missing::new(format!("{error:#}"), remedy)
        }))
    }

    /// A program of the environment.
    fn program(&self, name: &str) -> Command {
        Command::new(self.venv.join("bin").join(name))
    }

    /// An empty folder below ours.
    fn empty(&self, name: &str) -> Result<PathBuf> {
        let folder = self.folder.join(name);
        if folder.exists() {
            fs::remove_dir_all(&folder)
                .with_context(|| format!("cannot remove {}", folder.display()))?;
        }
        fs::create_dir_all(&folder).with_context(|| format!("cannot make {}", folder.display()))?;
        Ok(folder)
    }
}

/// `cmake -S source -B build`.
fn configure(source: &Path, build: &Path) -> Command {
    let mut command = Command::new("cmake");
    command.arg("-S").arg(source).arg("-B").arg(build);
    command
}

fn build(folder: &Path) -> Result<()> {
    output(Command::new("cmake").arg("--build").arg(folder)).map(drop)
}
