//! Figures that a TOML file of the repository holds.

use std::collections::BTreeMap;
use std::fs;

use anyhow::{Context, Result, bail};
use serde::Deserialize;

use crate::firmware::{grouped, millions};

/// A row for each section of a file, a column for each of some of its numbers.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Source {
    /// From the repository's root.
    pub(super) file: String,
    /// What a section stands for.
    section: String,
    columns: Vec<Column>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Column {
    title: String,
    key: String,
    unit: Unit,
}

#[derive(Clone, Copy, Deserialize)]
#[serde(rename_all = "lowercase")]
enum Unit {
    One,
    Millions,
}

impl Source {
    pub(super) fn titles(&self) -> Vec<String> {
        let titles = self.columns.iter().map(|column| &column.title);
        [&self.section].into_iter().chain(titles).cloned().collect()
    }

    pub(super) fn rows(&self) -> Result<Vec<Vec<String>>> {
        let file = &self.file;
        let text = fs::read_to_string(file).with_context(|| format!("cannot read {file}"))?;
        self.rows_of(&text).with_context(|| file.clone())
    }

    fn rows_of(&self, text: &str) -> Result<Vec<Vec<String>>> {
        let row = |(section, numbers): (String, BTreeMap<String, f64>)| {
            let cell = |column: &Column| {
                let number = numbers.get(&column.key);
                let number = number.with_context(|| format!("{section} has no {}", column.key))?;
                Ok(match column.unit {
                    Unit::One => grouped(Some(*number)),
                    Unit::Millions => millions(Some(number)),
                })
            };
            let cells: Result<Vec<String>> = self.columns.iter().map(cell).collect();
            Ok([section.clone()].into_iter().chain(cells?).collect())
        };
        sections(text)?.into_iter().map(row).collect()
    }
}

/// Numbers by section and key. A key `a.b` outside of sections is `b` of section `a`.
pub(super) fn sections(text: &str) -> Result<BTreeMap<String, BTreeMap<String, f64>>> {
    let mut sections: BTreeMap<String, BTreeMap<String, f64>> = BTreeMap::new();
    for (name, value) in text.parse::<toml::Table>()? {
        let mut put = |section: &str, key: &str, value: &toml::Value| {
            let number = value.as_float().or(value.as_integer().map(|number| number as f64));
            let number = number.with_context(|| format!("{key} is no number"))?;
            sections.entry(section.to_owned()).or_default().insert(key.to_owned(), number);
            anyhow::Ok(())
        };
        match (&value, name.split_once('.')) {
            (toml::Value::Table(numbers), _) => {
                for (key, value) in numbers {
                    put(&name, key, value)?;
                }
            }
            (_, Some((section, key))) => put(section, key, &value)?,
            _ => bail!("{name} is in no section"),
        }
    }
    Ok(sections)
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;

    #[test]
    fn sections_are_rows() {
        let source: Source = serde_json::from_str(
            r#"{"file": "f", "section": "board", "columns": [{"title": "step", "key": "a.step", "unit": "millions"},
                {"title": "bytes", "key": "bytes", "unit": "one"}]}"#,
        )
        .unwrap();
        assert_eq!(source.titles(), ["board", "step", "bytes"]);
        let text =
            "[m4]\n\"a.step\" = 1234567.0\nbytes = 1024\n[m7]\nbytes = 1\n\"a.step\" = 1e6\n";
        assert_eq!(source.rows_of(text).unwrap(), [["m4", "1.23", "1,024"], ["m7", "1.00", "1"]]);
        let flat = "\"m4.a.step\" = 2e6\n\"m4.bytes\" = 7\n";
        assert_eq!(source.rows_of(flat).unwrap(), [["m4", "2.00", "7"]]);
        let error = source.rows_of("[m4]\nbytes = 1\n").unwrap_err().to_string();
        assert_eq!(error, "m4 has no a.step");
        assert!(source.rows_of("bytes = 1\n").is_err());
    }
}
