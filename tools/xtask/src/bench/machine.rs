//! What is measured on.

use std::env::consts::ARCH;
use std::fs;
use std::process::Command;
use std::thread;

use serde_json::{Value, json};

use crate::process::output;

/// Instructions that kernels are chosen by, and those that peers use, as Linux names them.
const FEATURES: [&str; 16] = [
    "avx2",
    "avx_vnni",
    "avx512f",
    "avx512bw",
    "avx512_vnni",
    "avx512_bf16",
    "amx_int8",
    "amx_bf16",
    "amx_tile",
    "asimd",
    "asimddp",
    "i8mm",
    "bf16",
    "sve",
    "sve2",
    "sme",
];

/// This machine: its name, its cores and what matters of its instructions.
pub(crate) fn machine() -> Value {
    let text = output(Command::new("lscpu").env("LC_ALL", "C")).unwrap_or_default();
    let (name, features) = read(&text);
    let cores = thread::available_parallelism().map_or(1, usize::from);
    let load = fs::read_to_string("/proc/loadavg").unwrap_or_default();
    let load: Option<f64> = load.split(' ').next().and_then(|load| load.parse().ok());
    json!({"name": name.unwrap_or_else(|| ARCH.into()), "cores": cores, "features": features, "load": load})
}

/// Name and features in what lscpu prints.
fn read(text: &str) -> (Option<String>, Vec<String>) {
    let value = |key: &str| {
        let mut lines = text.lines().filter_map(|line| line.trim_start().split_once(':'));
        lines.find(|(found, _)| *found == key).map(|(_, value)| value.trim())
    };
    let all = value("Flags").unwrap_or_default();
    let features = all.split(' ').filter(|feature| FEATURES.contains(feature)).map(Into::into);
    (value("Model name").map(Into::into), features.collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lscpu_is_read() {
        let text = "Architecture:  x86_64\n  Model name:   Some CPU @ 2:1\n    Flags:    fpu avx2 sse2 amx_int8\n";
        let (name, features) = read(text);
        assert_eq!(name.as_deref(), Some("Some CPU @ 2:1"));
        assert_eq!(features, ["avx2", "amx_int8"]);
        assert_eq!(read(""), (None, vec![]));
    }
}
