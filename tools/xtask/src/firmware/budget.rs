//! The budget file: every number that is measured, and how far it may move.

use std::collections::BTreeMap;
use std::fmt::Write;
use std::fs;

use anyhow::{Context, Result};

/// The committed file.
pub(super) const FILE: &str = "firmware-sim/firmware/budgets.toml";
/// How far a number may move, either way.
const TOLERANCE: f64 = 0.03;

/// Numbers by board and name.
pub(super) type Numbers = BTreeMap<String, BTreeMap<String, f64>>;

/// A number's name and what it may be at most, on every board.
pub(super) type Ceiling = (&'static str, f64);
/// Bytes.
pub(super) const CEILINGS: &[Ceiling] = &[
    ("model", 512.0 * 1024.0),
    // 16 KiB of 512 are spare.
    ("rollout.flash", 496.0 * 1024.0),
    ("rollout.ram", 256.0 * 1024.0),
    ("rollout.workspace", 256.0 * 1024.0),
    ("rollout.stack", 26.0 * 1024.0),
    ("hostile.stack", 26.0 * 1024.0),
    ("robot.stack", 26.0 * 1024.0),
    ("walk.ram", 512.0 * 1024.0),
    ("walk.workspace", 512.0 * 1024.0),
    ("walk.stack", 26.0 * 1024.0),
    ("drape.ram", 512.0 * 1024.0),
    ("drape.workspace", 512.0 * 1024.0),
    ("drape.stack", 26.0 * 1024.0),
    // 20 of them for hulls and impacts, 35 for contact by impulses and for scenes in their own length, 6 for motion that is exact at any
    // step and place (docs/FIRMWARE.md).
    ("runtime.text", 140.0 * 1024.0),
];
/// The same for kernels that are made for the processor.
pub(super) const NATIVE_CEILINGS: &[Ceiling] = &[
    ("rollout.contact.step", 20e6),
    ("rollout.flight.step", 20e6),
    ("walk.walk.step", 70e6),
    ("drape.drape.step", 45e6),
    // Instructions a multiply-accumulate, and an element.
    ("kernels.product.26x64x64", 1.05),
    ("kernels.product.64x64x160", 1.05),
    ("kernels.product.26x256x256", 0.95),
    ("kernels.softmax.26", 60.0),
];

/// Reads the file.
pub(super) fn read() -> Result<Numbers> {
    let text = fs::read_to_string(FILE).with_context(|| format!("cannot read {FILE}"))?;
    toml::from_str(&text).with_context(|| format!("{FILE} does not parse"))
}

/// Replaces the sections of the boards that were measured.
pub(super) fn write(measured: &Numbers) -> Result<()> {
    let mut all = read().unwrap_or_default();
    all.extend(measured.clone());
    fs::write(FILE, format(&all)).with_context(|| format!("cannot write {FILE}"))
}

fn format(numbers: &Numbers) -> String {
    let mut text = String::from(
        "# Written by `cargo xtask firmware --bless`; docs/FIRMWARE.md explains. A number that moves by more than 3 %,\n\
         # for the better or the worse, fails the check. Bytes, and instructions a step.\n",
    );
    for (board, numbers) in numbers {
        let _ = writeln!(text, "\n[{board}]");
        for (name, number) in numbers {
            let _ = writeln!(text, "\"{name}\" = {number}");
        }
    }
    // TOML tells integers from floats; a map of floats wants the latter.
    let float = |line: &str| match line.rsplit_once(" = ") {
        Some((_, number)) if !number.contains('.') => format!("{line}.0\n"),
        _ => format!("{line}\n"),
    };
    text.lines().map(float).collect()
}

/// Every number that moved too far, is new or is gone, as a sentence.
pub(super) fn faults(budget: &Numbers, measured: &Numbers) -> Vec<String> {
    let mut faults = Vec::new();
    for (board, measured) in measured {
        let empty = BTreeMap::new();
        let budget = budget.get(board).unwrap_or(&empty);
        for (name, found) in measured {
            match budget.get(name) {
                None => faults.push(format!("{board}: {FILE} has no {name} ({found})")),
                Some(expected) if (found - expected).abs() > TOLERANCE * expected.abs() => {
                    let percent = 100.0 * (found / expected - 1.0);
                    let verdict = if found > expected { "worse" } else { "better" };
                    faults.push(format!(
                        "{board}: {name} is {found}, {expected} in the budget: {percent:+.1} %, {verdict}"
                    ));
                }
                Some(_) => {}
            }
        }
        for name in budget.keys().filter(|name| !measured.contains_key(*name)) {
            faults.push(format!("{board}: {name} is in {FILE} and was not measured"));
        }
    }
    faults
}

/// Every number above its ceiling, as a sentence.
pub(super) fn above(ceilings: &[Ceiling], measured: &Numbers) -> Vec<String> {
    let mut faults = Vec::new();
    for (board, measured) in measured {
        for (name, ceiling) in ceilings {
            let found = measured.get(*name).copied();
            if found.is_some_and(|found| found > *ceiling) {
                let found = found.unwrap_or_default();
                faults.push(format!("{board}: {name} is {found}, at most {ceiling} is allowed"));
            }
        }
    }
    faults
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;

    fn numbers(text: f64) -> Numbers {
        let of_board = [("text".to_owned(), text), ("ratio".to_owned(), 1.5)];
        [("m7".to_owned(), of_board.into_iter().collect())].into_iter().collect()
    }

    #[test]
    fn the_file_is_what_is_read() {
        let text = format(&numbers(1000.0));
        assert!(text.ends_with("[m7]\n\"ratio\" = 1.5\n\"text\" = 1000.0\n"), "{text}");
        assert_eq!(toml::from_str::<Numbers>(&text).unwrap(), numbers(1000.0));
    }

    #[test]
    fn both_directions_fail() {
        let budget = numbers(1000.0);
        assert_eq!(faults(&budget, &numbers(1029.0)), [""; 0]);
        assert!(faults(&budget, &numbers(1031.0))[0].ends_with("+3.1 %, worse"));
        assert!(faults(&budget, &numbers(969.0))[0].ends_with("-3.1 %, better"));
        let mut more = numbers(1000.0);
        more.get_mut("m7").unwrap().insert("new".into(), 1.0);
        assert_eq!(faults(&budget, &more).len(), 1);
        assert_eq!(faults(&more, &budget).len(), 1);
        assert_eq!(above(&[("text", 999.0), ("ratio", 1.5)], &budget).len(), 1);
    }
}
