//! The lab's tests that need PyTorch beside the wheel, or many processes, in the environment that `tools/lab/setup.sh` makes.

use std::path::Path;
use std::process::Command;

use anyhow::{Context, Result};

use crate::process::{line, output, run as run_command};
use crate::python::{COMPLETE, program};
use crate::report::{Missing, Report};

const FOLDER: &str = "tools/lab";
/// Of many processes and machines.
const SHARED_OUT: [&str; 2] = ["tests/test_ranks.py", "tests/test_far.py"];
/// Of the trainers whose inputs the runtime works out.
const BY_THE_RUNTIME: [&str; 5] = [
    "tests/test_windows.py",
    "tests/test_adapt.py",
    "tests/test_clouds.py",
    "tests/test_bound.py",
    "tests/research/test_ahead.py",
];

/// Trains in two processes that torchrun starts, shares scenes and an evaluation out to workers of Dask, and trains on windows of
/// the wheel.
pub(crate) fn run(report: &mut Report) -> Result<()> {
    let python = Path::new(FOLDER).join(".venv/bin/python");
    let remedy = "tools/lab/setup.sh && tools/lab/.venv/bin/python -m pip install -e 'tools/lab[dask,test]' bindings/python";
    let asked = output(
        Command::new(&python).args(["-c", "import dask, distributed, pytest, rigidformer, torch"]),
    );
    if let Err(error) = asked {
        report.skip(Missing::new(
            format!(
                "the lab has no environment with PyTorch, Dask and the runtime's wheel: {error:#}"
            ),
            remedy,
        ));
        return Ok(());
    }
    // Not resolved: a link tells Python which environment it is.
    let python = std::env::current_dir().context("no current folder")?.join(python);
    let program = program()?;
    let folders = std::env::var_os("PATH").unwrap_or_default();
    let beside = program.parent().map(Path::to_path_buf);
    let folders = std::env::join_paths(beside.into_iter().chain(std::env::split_paths(&folders)))
        .context("the program's folder cannot be on the PATH")?;
    let mut tests = Command::new(python);
    tests.args(["-m", "pytest", "-q"]).args(SHARED_OUT).args(BY_THE_RUNTIME).current_dir(FOLDER);
    tests.env(COMPLETE, "1").env("PATH", folders);
    // Kernels of one process each: two processes share two cores.
    tests.env("OMP_NUM_THREADS", "1");
    println!("{}", line(&tests));
    run_command(&mut tests)
}
