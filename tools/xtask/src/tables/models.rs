//! Figures that shipped models hold.

use std::collections::BTreeMap;
use std::fs;

use anyhow::{Context, Result};
use rigidformer_weights::{AlignedBuffer, ModelFile};
use serde::Deserialize;

use super::source::sections;
use crate::firmware::{grouped, millions};

/// Instructions a step by board.
const BUDGETS: &str = "firmware-sim/firmware/budgets.toml";
const BOARD: &str = "m7";
/// What the name of a figure ends with that is of the same motion without the network.
const WITHOUT: &str = ".without_network";

/// Rows of models, one for each of the figures named.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Models {
    /// Folder of the files, from the repository's root.
    folder: String,
    models: Vec<Model>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Model {
    /// Its name in the folder.
    file: String,
    /// What it moves.
    moves: String,
    /// Instructions of a step, as the budgets call them.
    step: Option<String>,
    /// What to show, and the name of the figure in the file.
    figures: Vec<(String, String)>,
}

impl Models {
    pub(super) fn titles() -> Vec<String> {
        let titles =
            ["model", "moves", "bytes", "Cortex-M7", "error", "with", "without the network"];
        titles.map(str::to_owned).to_vec()
    }

    pub(super) fn rows(&self) -> Result<Vec<Vec<String>>> {
        let text = fs::read_to_string(BUDGETS).with_context(|| format!("cannot read {BUDGETS}"))?;
        let budgets = sections(&text).context(BUDGETS)?.remove(BOARD).unwrap_or_default();
        let mut rows = Vec::new();
        for model in &self.models {
            let path = format!("{}/{}", self.folder, model.file);
            let bytes = fs::read(&path).with_context(|| format!("cannot read {path}"))?;
            rows.extend(model.rows(&bytes, &budgets).with_context(|| path)?);
        }
        Ok(rows)
    }
}

impl Model {
    fn rows(&self, bytes: &[u8], budgets: &BTreeMap<String, f64>) -> Result<Vec<Vec<String>>> {
        let bytes = AlignedBuffer::copy_of(bytes);
        let file = ModelFile::parse(&bytes).context("is no model")?;
        let step = match &self.step {
            Some(name) => {
                let step = budgets.get(name).with_context(|| format!("{BUDGETS} has no {name}"))?;
                millions(Some(step))
            }
            None => String::new(),
        };
        let figure = |name: &str| file.metrics().find(|(known, _)| *known == name);
        let rows = self.figures.iter().enumerate().map(|(number, (shown, name))| {
            let (_, with) = figure(name).with_context(|| format!("has no figure {name}"))?;
            let without = figure(&format!("{name}{WITHOUT}"));
            let without = without.map(|(_, value)| rounded(value)).unwrap_or_default();
            let first = |text: &str| if number == 0 { text.to_owned() } else { String::new() };
            Ok(vec![
                first(&self.file),
                first(&self.moves),
                first(&grouped(Some(bytes.len() as f64))),
                first(&step),
                shown.clone(),
                rounded(with),
                without,
            ])
        });
        rows.collect()
    }
}

/// Of lengths in metres four digits, of angles three.
fn rounded(value: f32) -> String {
    if value < 1.0 { format!("{value:.4}") } else { format!("{value:.2}") }
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;

    #[test]
    fn a_row_is_of_the_file() {
        let model = Model {
            file: "nano.rfm".into(),
            moves: "bodies".into(),
            step: Some("a.step".into()),
            figures: vec![("no such".into(), "none".into())],
        };
        let budgets: BTreeMap<String, f64> = [("a.step".to_owned(), 1_234_567.0)].into();
        let root = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
        let bytes = fs::read(root.join("weights/models/nano.rfm")).unwrap();
        let error = model.rows(&bytes, &budgets).unwrap_err();
        assert_eq!(error.to_string(), "has no figure none");
        let buffer = AlignedBuffer::copy_of(&bytes);
        let file = ModelFile::parse(&buffer).unwrap();
        let (name, value) = file.metrics().next().unwrap();
        let model = Model { figures: vec![("shown".into(), name.to_owned())], ..model };
        let rows = model.rows(&bytes, &budgets).unwrap();
        assert_eq!(rows.len(), 1);
        let row = rows.first().unwrap();
        assert_eq!(row.get(..2).unwrap(), ["nano.rfm", "bodies"]);
        assert_eq!(row.get(3..6).unwrap(), ["1.23", "shown", rounded(value).as_str()]);
        assert!(model.rows(&[0; 64], &budgets).is_err());
        assert!(model.rows(&bytes, &BTreeMap::new()).is_err());
    }
}
