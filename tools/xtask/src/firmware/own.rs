//! An image with a model of one's own.

use std::collections::BTreeMap;
use std::fs;
use std::path::Path;

use anyhow::{Context, Result, bail};

use super::boards::Board;
use super::budget::Numbers;
use super::{Options, elf, host_of, output, read, table};
use crate::report::Report;

/// Builds the image `rollout` with a model, runs it, compares its poses with this machine's, and says what it takes.
pub(super) fn run(options: &Options, model: &Path, report: &mut Report) -> Result<()> {
    let shown = model.display();
    let path = fs::canonicalize(model).with_context(|| {
        format!("cannot read {shown}; give a packed model, as `rigidformer pack` writes it")
    })?;
    let bytes = fs::metadata(&path)?.len();
    let expected = host_of(&path, "rollout")?;
    let mut numbers = Numbers::new();
    let mut faults = Vec::new();
    for board in options.board.map_or(Board::ALL.to_vec(), |board| vec![board]) {
        let name = board.name();
        let image = match board.build_own(&path)? {
            Ok(image) => image,
            Err(missing) => {
                report.skip_part(name, missing);
                continue;
            }
        };
        let sent = board.run(&image)?;
        let file = read(image.clone())?;
        let found = output::decode(&file, &sent)?;
        let mut missing = output::missing(&expected, &found.stable);
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
    match options.json {
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
