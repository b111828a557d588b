//! What libFuzzer prints, and what of it is told.

use std::collections::VecDeque;
use std::io::{BufRead, BufReader};
use std::process::{Command, Stdio};

use anyhow::{Context, Result};
use comfy_table::Table;
use comfy_table::presets::ASCII_MARKDOWN;

use crate::process::line;

/// Lines that are shown of a run that failed.
const LAST: usize = 60;

/// Of a run, and its last lines.
#[derive(Default)]
pub(super) struct Said {
    /// Places in the program that count how often they are passed.
    counters: Option<u64>,
    covered: Option<u64>,
    executions: Option<u64>,
    each_second: Option<u64>,
    last: VecDeque<String>,
}

/// Runs a fuzzer, and tells whether it ended well.
pub(super) fn listen(command: &mut Command) -> Result<(bool, Said)> {
    let start = || format!("cannot start `{}`", line(command));
    let mut child = Command::new(command.get_program())
        .args(command.get_args())
        .envs(command.get_envs().filter_map(|(name, value)| Some((name, value?))))
        .stderr(Stdio::piped())
        .spawn()
        .with_context(start)?;
    let mut said = Said::default();
    if let Some(errors) = child.stderr.take() {
        // Inputs that a message shows need not be UTF-8.
        for bytes in BufReader::new(errors).split(b'\n') {
            said.hear(&String::from_utf8_lossy(&bytes?));
        }
    }
    Ok((child.wait()?.success(), said))
}

impl Said {
    fn hear(&mut self, line: &str) {
        let after = |mark: &str| -> Option<u64> {
            let rest = line.split_once(mark)?.1.trim_start();
            let end = rest.find(|c: char| !c.is_ascii_digit()).unwrap_or(rest.len());
            rest.get(..end)?.parse().ok()
        };
        if line.starts_with("INFO: Loaded") && line.contains("inline 8-bit counters") {
            self.counters = self.counters.or(after("("));
        } else if line.starts_with('#') {
            self.covered = after(" cov:").or(self.covered);
        } else if let Some(count) = after("stat::number_of_executed_units:") {
            self.executions = Some(count);
        } else if let Some(count) = after("stat::average_exec_per_sec:") {
            self.each_second = Some(count);
        } else {
            if self.last.len() == LAST {
                self.last.pop_front();
            }
            self.last.push_back(line.to_owned());
        }
    }

    /// The last lines that are no progress.
    pub(super) fn end(&self) -> String {
        self.last.iter().map(String::as_str).collect::<Vec<_>>().join("\n")
    }

    pub(super) fn header() -> Vec<String> {
        ["target", "executions", "a second", "edges reached", "of"].map(String::from).into()
    }

    pub(super) fn row(&self, target: &str) -> Vec<String> {
        let told = |number: Option<u64>| number.map_or("?".into(), |number| number.to_string());
        let numbers = [self.executions, self.each_second, self.covered, self.counters];
        std::iter::once(target.to_owned()).chain(numbers.map(told)).collect()
    }

    /// The header, and a row a target.
    pub(super) fn table(rows: &[Vec<String>]) -> String {
        let mut table = Table::new();
        table.load_style(ASCII_MARKDOWN);
        let mut rows = rows.iter();
        if let Some(header) = rows.next() {
            table.set_header(header);
        }
        table.add_rows(rows);
        table.to_string()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn figures_are_found() {
        let mut said = Said::default();
        for line in [
            "INFO: Loaded 1 modules   (4711 inline 8-bit counters): 4711 [0x1, 0x2), ",
            "#2\tINITED cov: 12 ft: 13 corp: 1/1b exec/s: 0 rss: 30Mb",
            "#90 DONE   cov: 1910 ft: 4953 corp: 1376/1672Kb lim: 4096 exec/s: 180283 rss: 32Mb",
            "stat::number_of_executed_units: 90",
            "stat::average_exec_per_sec:     45",
            "something else",
        ] {
            said.hear(line);
        }
        assert_eq!(said.row("x"), ["x", "90", "45", "1910", "4711"]);
        assert_eq!(said.end(), "something else");
    }
}
