//! What a change costs: committed sizes and instructions of now beside those of a commit before.

use std::collections::BTreeMap;
use std::fs;
use std::io::{self, ErrorKind};
use std::process::Command;

use anyhow::{Context, Result, bail};
use comfy_table::Table;
use comfy_table::presets::ASCII_MARKDOWN;

use crate::process::output;
use crate::report::{Missing, Report};

/// Firmware's text, RAM, stack and instructions, and the counts of hosts.
const FILES: [&str; 2] = ["firmware-sim/firmware/budgets.toml", "runtime-std/benches/counts.toml"];

/// Gets the commits that a shallow clone lacks.
const UNSHALLOW: &str = "git fetch --unshallow";
/// Gets git.
const INSTALL: &str = "apt-get install git, in a clone";

/// Numbers by name, such as `m7.rollout.flash`.
type Numbers = BTreeMap<String, f64>;

/// Prints the numbers that differ; `before` is a commit.
pub(crate) fn run(before: &str) -> Result<()> {
    if !is_known(before).context("cannot start git")? {
        bail!(
            "--before {before}: there is no such commit; in a shallow clone, `{UNSHALLOW}` gets it"
        );
    }
    println!("{}", compared(before)?);
    Ok(())
}

/// The same for the checks, which skip it where there is no history: in a shallow clone, or without git.
pub(crate) fn run_if_known(before: &str, report: &mut Report) -> Result<()> {
    let missing = match is_known(before) {
        Ok(true) => {
            println!("{}", compared(before)?);
            return Ok(());
        }
        Ok(false) => {
            Missing::new(format!("there is no commit {before} to compare with"), UNSHALLOW)
        }
        Err(error) if error.kind() == ErrorKind::NotFound => {
            Missing::new("there is no git", INSTALL)
        }
        Err(error) => return Err(error).context("cannot start git"),
    };
    report.skip(missing);
    Ok(())
}

fn is_known(commit: &str) -> io::Result<bool> {
    let found = Command::new("git")
        .args(["rev-parse", "--verify", "--quiet", &format!("{commit}^{{commit}}")])
        .output()?;
    Ok(found.status.success())
}

fn compared(before: &str) -> Result<String> {
    let (mut old, mut new) = (Numbers::new(), Numbers::new());
    for file in FILES {
        let then = output(Command::new("git").args(["show", &format!("{before}:{file}")]))?;
        old.extend(numbers(&then).with_context(|| format!("{file} of {before}"))?);
        let now = fs::read_to_string(file).with_context(|| format!("cannot read {file}"))?;
        new.extend(numbers(&now).with_context(|| file.to_owned())?);
    }
    Ok(table(before, &old, &new))
}

/// All numbers of a file; those of tables have the table's name in front.
fn numbers(text: &str) -> Result<Numbers> {
    fn add(name: &str, value: &toml::Value, all: &mut Numbers) {
        match value {
            toml::Value::Table(table) => {
                for (key, value) in table {
                    let inner = if name.is_empty() { key.clone() } else { format!("{name}.{key}") };
                    add(&inner, value, all);
                }
            }
            toml::Value::Float(number) => drop(all.insert(name.into(), *number)),
            toml::Value::Integer(number) => drop(all.insert(name.into(), *number as f64)),
            _ => {}
        }
    }
    let mut all = Numbers::new();
    add("", &toml::Value::Table(text.parse()?), &mut all);
    Ok(all)
}

/// What the table cannot show: `cargo xtask firmware` and `counts` leave the committed numbers as they are then.
const TOLERATED: &str = "what moved by less than 3 % is not committed";

fn table(before: &str, old: &Numbers, new: &Numbers) -> String {
    let mut table = Table::new();
    table.load_style(ASCII_MARKDOWN);
    table.set_header(["bytes or instructions", before, "now", "change"]);
    let names: std::collections::BTreeSet<&String> = old.keys().chain(new.keys()).collect();
    let mut changed = 0;
    for name in &names {
        let (then, now) = (old.get(*name), new.get(*name));
        if then == now {
            continue;
        }
        changed += 1;
        let shown = |number: Option<&f64>| number.map_or("-".into(), f64::to_string);
        let change = match (then, now) {
            (Some(then), Some(now)) if *then != 0.0 => {
                format!("{:+.2} %", 100.0 * (now / then - 1.0))
            }
            (None, Some(_)) => "new".into(),
            (Some(_), None) => "gone".into(),
            _ => "-".into(),
        };
        table.add_row([name.to_string(), shown(then), shown(now), change]);
    }
    match changed {
        0 => format!(
            "no committed size or count of {} differs from {before}'s; {TOLERATED}",
            names.len()
        ),
        _ => format!(
            "{changed} of {} committed sizes and counts differ from {before}'s; {TOLERATED}\n{table}",
            names.len()
        ),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_changed_is_told_and_nothing_else() -> Result<()> {
        let old = numbers("[m7]\n\"a.flash\" = 100.0\n\"a.ram\" = 7\n\"gone\" = 1.0\n")?;
        let new = numbers("[m7]\n\"a.flash\" = 110.0\n\"a.ram\" = 7\n\"more\" = 2.5\n")?;
        let text = table("HEAD^", &old, &new);
        for part in ["3 of 4", "m7.a.flash", "+10.00 %", "m7.gone", "gone", "m7.more", "new"] {
            assert!(text.contains(part), "{part}: {text}");
        }
        assert!(!text.contains("a.ram"), "{text}");
        let text = table("x", &old, &old);
        assert!(text.starts_with("no committed size or count of 3 differs from x's"), "{text}");
        Ok(())
    }

    #[test]
    fn a_commit_that_is_not_there_is_a_skip() -> Result<()> {
        let mut report = Report::default();
        report.step("costs", |report| run_if_known("no-such-commit", report))?;
        assert_eq!(report.skips(), 1);
        // A machine that was given the sources as an archive may have no git.
        let remedy = if Command::new("git").output().is_ok() { UNSHALLOW } else { INSTALL };
        assert!(report.table().contains(remedy), "{}", report.table());
        Ok(())
    }

    #[test]
    fn the_committed_files_have_numbers() -> Result<()> {
        for file in FILES {
            let path = format!("{}/../../{file}", env!("CARGO_MANIFEST_DIR"));
            assert!(!numbers(&fs::read_to_string(path)?)?.is_empty(), "{file}");
        }
        Ok(())
    }
}
