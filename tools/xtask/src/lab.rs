//! The lab's tests of many processes and machines, in the environment that `tools/lab/setup.sh` makes.

use std::path::Path;
use std::process::Command;

use anyhow::{Context, Result};

use crate::process::{line, output, run as run_command};
use crate::python::COMPLETE;
use crate::report::{Missing, Report};

const FOLDER: &str = "tools/lab";
const TESTS: [&str; 2] = ["tests/test_ranks.py", "tests/test_far.py"];

/// Trains in two processes that torchrun starts, and shares scenes and an evaluation out to workers of Dask.
pub(crate) fn run(report: &mut Report) -> Result<()> {
    let python = Path::new(FOLDER).join(".venv/bin/python");
    let remedy = "tools/lab/setup.sh && tools/lab/.venv/bin/python -m pip install -e 'tools/lab[dask]' pytest";
    let asked =
        output(Command::new(&python).args(["-c", "import dask, distributed, pytest, torch"]));
    if let Err(error) = asked {
        report.skip(Missing::new(
            format!("the lab has no environment with PyTorch and Dask: {error:#}"),
            remedy,
        ));
        return Ok(());
    }
    // Not resolved: a link tells Python which environment it is.
    let python = std::env::current_dir().context("no current folder")?.join(python);
    let mut tests = Command::new(python);
    tests.args(["-m", "pytest", "-q"]).args(TESTS).current_dir(FOLDER);
    tests.env(COMPLETE, "1");
    // Kernels of one process each: two processes share two cores.
    tests.env("OMP_NUM_THREADS", "1");
    println!("{}", line(&tests));
    run_command(&mut tests)
}
