//! Speed: the workloads of docs/PERFORMANCE.md and their peers.

use std::fmt::Write;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::{Context, Result};
use serde_json::Value;

use crate::process::{cargo, run};

/// What `cargo xtask bench` is told.
#[derive(clap::Args)]
pub(crate) struct Options {
    /// Only workloads whose name contains this, such as W-edge or gemm; may be given more than once
    #[arg(long, value_name = "NAME")]
    only: Vec<String>,
    /// Time for each measurement
    #[arg(long, default_value_t = 3.0)]
    seconds: f64,
    /// Also runs PyTorch and ONNX Runtime, with this Python that has tools/lab[bench] installed, and prints ratios
    #[arg(long, value_name = "PYTHON")]
    peers: Option<PathBuf>,
    /// Also writes all rows as JSON
    #[arg(long, value_name = "FILE")]
    json: Option<PathBuf>,
}

pub(crate) const BENCH: [&str; 6] =
    ["bench", "--quiet", "-p", "rigidformer-runtime", "--bench", "workloads"];

/// Measures, and compares where there are peers.
pub(crate) fn measure(options: &Options) -> Result<()> {
    let folder = tempfile::tempdir()?;
    let ours = folder.path().join("ours.json");
    let mut command = cargo();
    command.args(BENCH).arg("--").args(["--seconds", &options.seconds.to_string(), "--json"]);
    command.arg(&ours);
    for only in &options.only {
        command.args(["--only", only]);
    }
    run(&mut command)?;
    let mut document = read(&ours)?;
    if let Some(python) = &options.peers {
        let theirs = folder.path().join("peers.json");
        let mut command = Command::new(python);
        command.args(["-m", "rigidformer_lab.bench", "--json"]).arg(&theirs);
        command.args(["--seconds", &options.seconds.to_string()]);
        run(&mut command).context("tools/lab/README.md tells how to install the peers")?;
        let theirs = read(&theirs)?;
        ratios(&document, &theirs);
        document["peers"] = theirs;
    }
    if let Some(path) = &options.json {
        fs::write(path, serde_json::to_string_pretty(&document)?)
            .with_context(|| format!("cannot write {}", path.display()))?;
    }
    Ok(())
}

fn read(path: &Path) -> Result<Value> {
    let text =
        fs::read_to_string(path).with_context(|| format!("cannot read {}", path.display()))?;
    Ok(serde_json::from_str(&text)?)
}

/// Median of a row whose stage begins so, the smallest where there are several (one thread or all).
fn median(document: &Value, workload: &str, engine: Option<&str>, stage: &str) -> Option<f64> {
    let rows = document["rows"].as_array()?.iter();
    let fits = |row: &&Value| {
        row["workload"] == workload
            && engine.is_none_or(|engine| row["engine"] == engine)
            && row["stage"].as_str().is_some_and(|found| found.starts_with(stage))
    };
    rows.filter(fits).filter_map(|row| row["median_ms"].as_f64()).reduce(f64::min)
}

fn ratios(ours: &Value, peers: &Value) {
    println!(
        "\nmedian of the peer / median of rigidformer int8, whole steps in one run on one machine"
    );
    let mut engines: Vec<&str> = Vec::new();
    let mut workloads: Vec<&str> = Vec::new();
    for row in peers["rows"].as_array().into_iter().flatten() {
        let (Some(engine), Some(workload)) = (row["engine"].as_str(), row["workload"].as_str())
        else {
            continue;
        };
        if !engines.contains(&engine) {
            engines.push(engine);
        }
        if !workloads.contains(&workload) {
            workloads.push(workload);
        }
    }
    for workload in workloads {
        let stage = if workload.starts_with("gemm") { "" } else { "step" };
        let Some(own) = median(ours, workload, None, stage) else { continue };
        let mut line = format!("{workload:<24} {own:9.3} ms");
        for engine in &engines {
            if let Some(peer) = median(peers, workload, Some(engine), stage) {
                let _ = write!(line, "   {engine} {:6.2}", peer / own);
            }
        }
        println!("{line}");
    }
}
