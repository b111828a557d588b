//! Speed: the workloads of docs/PERFORMANCE.md, their peers, and instruction counts that a check can rely on.

use std::collections::BTreeMap;
use std::fmt::Write;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::{Context, Result, bail};
use serde_json::Value;

use crate::process::{cargo, output, run};
use crate::report::{Missing, Report};
use crate::{apt, tools};

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

const BENCH: [&str; 6] = ["bench", "--quiet", "-p", "rigidformer-runtime", "--bench", "workloads"];

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
pub(crate) fn counts(bless: bool, report: &mut Report) -> Result<()> {
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
        return fs::write(FILE, text).with_context(|| format!("cannot write {FILE}"));
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
