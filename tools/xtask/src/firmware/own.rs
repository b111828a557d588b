//! An image with a model of one's own.

use std::collections::BTreeMap;
use std::fs;
use std::path::Path;

use anyhow::{Context, Result, bail};

use super::boards::Board;
use super::budget::Numbers;
use super::{elf, output, table};
use crate::report::Report;

/// Builds the image `rollout` with a model, runs it, compares its poses with those that this machine `expected`, and says what it takes.
pub(super) fn run(
    boards: &[Board],
    json: bool,
    path: &Path,
    expected: &str,
    report: &mut Report,
) -> Result<()> {
    let shown = path.display();
    let bytes = fs::metadata(path)?.len();
    let mut numbers = Numbers::new();
    let mut faults = Vec::new();
    for board in boards {
        let name = board.name();
        let image = match board.build_own(path)? {
            Ok(image) => image,
            Err(missing) => {
                report.skip_part(name, missing);
                continue;
            }
        };
        let sent = board.run(&image)?;
        let file = fs::read(&image).with_context(|| format!("cannot read {}", image.display()))?;
        let found = output::decode(&file, &sent)?;
        let mut missing = output::missing(expected, &found.stable);
        if found.measured.is_empty() {
            missing.extend(found.stable.lines());
        }
        for line in &missing {
            faults.push(format!("{name}: this machine computes otherwise:\n  {line}"));
        }
        if missing.is_empty() {
            println!("{name}: {shown}: as this machine computes, bit for bit; {}", image.display());
        }
        let sizes = elf::sizes(&file)?;
        let bytes = [("model", bytes), ("rollout.flash", sizes.flash), ("rollout.ram", sizes.ram)];
        let mut measured: BTreeMap<String, f64> =
            bytes.into_iter().map(|(name, bytes)| (name.to_owned(), bytes as f64)).collect();
        measured.extend(
            found.measured.into_iter().map(|(name, number)| (format!("rollout.{name}"), number)),
        );
        numbers.insert(name.into(), measured);
    }
    match json {
        true => println!("{}", serde_json::to_string_pretty(&numbers)?),
        false => println!("{}", table::tables(&numbers)),
    }
    if !faults.is_empty() {
        faults.push(format!(
            "{shown}: the image has room for models of nano's sizes in int8 (firmware-sim/firmware/src/memory.rs); train with --preset nano"
        ));
        bail!("{}", faults.join("\n"));
    }
    Ok(())
}
