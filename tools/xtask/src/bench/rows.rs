//! What benchmarks of commits print that know no slices: rows of one workload and stage each.

use std::fs;
use std::path::Path;
use std::process::Command;

use anyhow::{Context, Result};
use serde_json::Value;

use crate::process::output;

/// Whether this benchmark answers line by line.
pub(crate) fn takes_turns(program: &Path) -> Result<bool> {
    Ok(output(Command::new(program).arg("--help"))?.contains("--serve"))
}

/// Runs a group of workloads.
pub(crate) fn of(program: &Path, group: &str, seconds: f64) -> Result<Value> {
    let folder = tempfile::tempdir()?;
    let path = folder.path().join("rows.json");
    let mut command = Command::new(program);
    command.args(["--only", group, "--seconds", &seconds.to_string(), "--json"]).arg(&path);
    output(&mut command)?;
    let text = fs::read_to_string(&path).context("the benchmark wrote nothing")?;
    serde_json::from_str(&text).context("the benchmark wrote no JSON")
}

/// The median of a workload's stage on so many threads, in milliseconds. Commits that took whole steps alone have nothing
/// else that comes.
pub(crate) fn median(document: &Value, workload: &str, stage: &str, threads: u64) -> Option<f64> {
    let stages = match stage {
        "product" => [format!("{threads} thread(s)"), String::new()],
        "step" => [format!("step x{threads}"), String::new()],
        "as it comes" => [format!("as it comes x{threads}"), format!("step x{threads}")],
        _ => [stage.to_owned(), String::new()],
    };
    let rows = document["rows"].as_array()?;
    stages.iter().find_map(|stage| {
        let mut rows = rows.iter();
        let row = rows.find(|row| row["workload"] == workload && row["stage"] == stage.as_str())?;
        row["median_ms"].as_f64()
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn rows_are_found_by_workload_stage_and_threads() {
        let row = |workload: &str, stage: &str, median: f64| json!({"workload": workload, "stage": stage, "median_ms": median});
        let document = json!({"rows": [
            row("gemm 26x256x256", "1 thread(s)", 1.0), row("gemm 26x256x256", "2 thread(s)", 2.0),
            row("W-edge", "Encoder", 9.0), row("W-edge", "step x1", 3.0), row("W-edge", "as it comes x1", 4.0),
            row("W-paper", "step x2", 5.0), row("W-futures, 128 units", "10 steps", 6.0),
        ]});
        let at = |workload: &str, stage: &str, threads| median(&document, workload, stage, threads);
        assert_eq!(at("gemm 26x256x256", "product", 1), Some(1.0));
        assert_eq!(at("gemm 26x256x256", "product", 2), Some(2.0));
        assert_eq!(at("W-edge", "step", 1), Some(3.0));
        assert_eq!(at("W-edge", "step", 2), None);
        assert_eq!(at("W-edge", "as it comes", 1), Some(4.0));
        assert_eq!(at("W-paper", "as it comes", 2), Some(5.0));
        assert_eq!(at("W-futures, 128 units", "10 steps", 2), Some(6.0));
        assert_eq!(median(&json!({}), "W-edge", "step", 1), None);
    }
}
