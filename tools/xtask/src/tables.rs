//! Tables of figures: `docs/tables/<page>/<name>.json` becomes the part of `docs/<PAGE>.md` between
//! `<!-- table: <name> -->` and `<!-- /table -->`.

mod models;
mod source;

use std::collections::BTreeMap;
use std::fs;
use std::path::Path;

use anyhow::{Context, Result, bail};
use clap::Args;
use serde::Deserialize;

use crate::sources::files;
use models::Models;
use source::Source;

const PAGES: &str = "docs";
const FOLDER: &str = "docs/tables";
const START: (&str, &str) = ("<!-- table: ", " -->");
const END: &str = "<!-- /table -->";

/// Of `cargo xtask tables`.
#[derive(Args, Clone, Debug, Default)]
pub(crate) struct Options {
    /// Writes nothing, and fails where a page has another table than its file.
    #[arg(long)]
    check: bool,
}

pub(crate) fn run(options: &Options) -> Result<()> {
    if options.check { check() } else { write() }
}

/// Writes all tables into their pages.
pub(crate) fn write() -> Result<()> {
    for page in pages()? {
        if page.renewed != page.text {
            fs::write(&page.path, &page.renewed)
                .with_context(|| format!("cannot write {}", page.path))?;
            println!("{} is renewed", page.path);
        }
    }
    Ok(())
}

/// Fails where a page is not what its files make of it.
pub(crate) fn check() -> Result<()> {
    let stale = pages()?.into_iter().filter(|page| page.renewed != page.text);
    let faults: Vec<String> = stale
        .map(|page| {
            let mut lines = page.text.lines().zip(page.renewed.lines());
            let same = lines.position(|(old, new)| old != new);
            let at = same.unwrap_or(page.text.lines().count().min(page.renewed.lines().count()));
            format!("{}:{}: not as in {FOLDER}; run `cargo xtask tables`", page.path, at + 1)
        })
        .collect();
    if !faults.is_empty() {
        bail!("{}", faults.join("\n"));
    }
    Ok(())
}

const NEEDED: &str = "either columns, rows, date and commit are needed, or a source, or models";

struct Page {
    path: String,
    text: String,
    renewed: String,
}

/// The pages that have a folder of tables, or a mark.
fn pages() -> Result<Vec<Page>> {
    let mut folders = BTreeMap::new();
    for folder in files(Path::new(FOLDER))? {
        let name = folder.file_name().unwrap_or_default().to_string_lossy().into_owned();
        folders.insert(name, read(&folder)?);
    }
    let mut pages = Vec::new();
    for path in files(Path::new(PAGES))? {
        if path.extension().is_none_or(|end| end != "md") {
            continue;
        }
        let name = path.file_stem().unwrap_or_default().to_string_lossy().to_lowercase();
        let tables = folders.remove(&name).unwrap_or_default();
        let path = path.to_string_lossy().into_owned();
        let text = fs::read_to_string(&path).with_context(|| format!("cannot read {path}"))?;
        let renewed = renew(&text, &tables).with_context(|| path.clone())?;
        pages.push(Page { path, text, renewed });
    }
    if let Some(name) = folders.keys().next() {
        bail!("{FOLDER}/{name} belongs to no page; name it as a page of {PAGES}, in lower case");
    }
    Ok(pages)
}

/// Texts of a page's tables by their names.
fn read(folder: &Path) -> Result<BTreeMap<String, String>> {
    let mut tables = BTreeMap::new();
    for path in files(folder)? {
        let name = path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
        let text = Table::read(&path)?.text();
        tables.insert(name, text.with_context(|| path.display().to_string())?);
    }
    Ok(tables)
}

/// The page with all tables as they should be.
fn renew(page: &str, tables: &BTreeMap<String, String>) -> Result<String> {
    let mut text = String::new();
    let mut open: Option<&str> = None;
    let mut left: Vec<&String> = tables.keys().collect();
    for line in page.lines() {
        let start = line.strip_prefix(START.0).and_then(|line| line.strip_suffix(START.1));
        match (open, start) {
            (Some(name), Some(_)) => bail!("the table {name} has no {END}"),
            (Some(_), None) if line != END => continue,
            (None, None) if line == END => bail!("an {END} without a beginning"),
            _ => {}
        }
        text.push_str(line);
        text.push('\n');
        if let Some(name) = start {
            let table = tables
                .get(name)
                .with_context(|| format!("no file {name}.json in the page's folder of {FOLDER}"))?;
            text.push_str(table);
            left.retain(|known| *known != name);
        }
        open = start;
    }
    if let Some(name) = open {
        bail!("the table {name} has no {END}");
    }
    if let Some(name) = left.first() {
        bail!(
            "{name}.json is shown nowhere: write \"{}{name}{}\" and \"{END}\", or remove it",
            START.0,
            START.1
        );
    }
    Ok(text)
}

/// What a file says.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Table {
    /// What the figures are, and their units.
    title: String,
    #[serde(default)]
    columns: Vec<String>,
    #[serde(default)]
    rows: Vec<Vec<String>>,
    /// Year, month and day.
    date: Option<String>,
    commit: Option<String>,
    /// In place of the four above: another file of the repository, which CI compares with what it measures.
    source: Option<Source>,
    /// Likewise: models that ship, and which of their figures.
    models: Option<Models>,
    /// What prints the figures.
    command: Vec<String>,
    machine: String,
    /// What a reader must know to read the figures.
    notes: Option<String>,
}

impl Table {
    fn read(path: &Path) -> Result<Self> {
        let text = fs::read(path).with_context(|| format!("cannot read {}", path.display()))?;
        serde_json::from_slice(&text).with_context(|| format!("{} is no table", path.display()))
    }

    /// What stands between the marks.
    fn text(&self) -> Result<String> {
        let Table { title, command, machine, .. } = self;
        if title.trim().is_empty() || machine.trim().is_empty() || command.is_empty() {
            bail!("title, machine and command are needed");
        }
        // Of several origins all but one would be passed over.
        if self.models.is_some() && (self.source.is_some() || self.date.is_some()) {
            bail!(NEEDED);
        }
        let (columns, rows, when) = match (&self.source, &self.date, &self.commit) {
            (None, Some(date), Some(commit)) => {
                (self.columns.clone(), self.rows.clone(), when(date, commit)?)
            }
            (Some(source), None, None) if self.columns.is_empty() && self.rows.is_empty() => {
                let when = format!("`{}` at this commit", source.file);
                (source.titles(), source.rows()?, when)
            }
            (None, None, None) if self.columns.is_empty() && self.rows.is_empty() => {
                let models = self.models.as_ref().context(NEEDED)?;
                (Models::titles(), models.rows()?, "the files at this commit".to_owned())
            }
            _ => bail!(NEEDED),
        };
        if let Some(row) = rows.iter().find(|row| row.len() != columns.len()) {
            bail!("{} columns, and a row of {}: {row:?}", columns.len(), row.len());
        }
        let line = |cells: &[String]| format!("|{}|\n", cells.join("|"));
        let rule = format!("{}|\n", "|---".repeat(columns.len()));
        let body: String = rows.iter().map(|row| line(row)).collect();
        let notes = self.notes.as_ref().map(|notes| format!("{notes}\n\n")).unwrap_or_default();
        let (header, command) = (line(&columns), command.join("\n"));
        Ok(format!(
            "**{title}**\n\n{header}{rule}{body}\n{notes}```sh\n{command}\n```\n\n{machine}; {when}.\n"
        ))
    }
}

fn when(date: &str, commit: &str) -> Result<String> {
    let is_number = |text: &str| text.bytes().all(|digit| digit.is_ascii_digit());
    let lengths: Vec<usize> = date.split('-').map(str::len).collect();
    if lengths != [4, 2, 2] || !date.split('-').all(is_number) {
        bail!("the date {date} is not of the form 2026-01-31");
    }
    let is_hash = commit.bytes().all(|digit| matches!(digit, b'0'..=b'9' | b'a'..=b'f'));
    if commit.len() < 7 || !is_hash {
        bail!("the commit {commit} is not of seven or more hexadecimal digits");
    }
    Ok(format!("{date}; commit {commit}"))
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;

    const FILE: &str = r#"{"title": "Errors, m", "columns": ["", "A"], "rows": [["edge", "1"]],
        "command": ["a", "b"], "machine": "M", "date": "2026-11-24", "commit": "0611fdf"}"#;
    const TEXT: &str = "**Errors, m**\n\n||A|\n|---|---|\n|edge|1|\n\n```sh\na\nb\n```\n\nM; 2026-11-24; commit 0611fdf.\n";

    fn table(file: &str) -> Result<String> {
        serde_json::from_str::<Table>(file)?.text()
    }

    #[test]
    fn a_table_names_its_machine_date_commit_and_command() {
        assert_eq!(table(FILE).unwrap(), TEXT);
        for (good, bad) in [
            ("2026-11-24", "24 November"),
            ("0611fdf", "main"),
            ("\"a\", \"b\"", ""),
            ("\"M\"", "\" \""),
            ("[\"edge\", \"1\"]", "[\"edge\"]"),
            ("\"commit\"", "\"comit\""),
        ] {
            assert!(table(&FILE.replace(good, bad)).is_err(), "{bad}");
        }
        let (models, source) = (
            r#""models": {"folder": "f", "models": []}"#,
            r#""source": {"file": "f", "section": "s", "columns": []}"#,
        );
        for file in [
            FILE.replace("\"machine\"", &format!("{models}, \"machine\"")),
            format!(r#"{{"title": "T", {models}, {source}, "command": ["a"], "machine": "M"}}"#),
        ] {
            assert_eq!(table(&file).unwrap_err().to_string(), NEEDED);
        }
    }

    #[test]
    fn a_page_is_renewed_between_the_marks_alone() {
        let tables: BTreeMap<String, String> = [("a".to_owned(), "new\n".to_owned())].into();
        let page = "x\n<!-- table: a -->\nold\n<!-- /table -->\ny\n";
        let renewed = renew(page, &tables).unwrap();
        assert_eq!(renewed, page.replace("old", "new"));
        assert_eq!(renew(&renewed, &tables).unwrap(), renewed);
        let error = |page: &str| renew(page, &tables).unwrap_err().to_string();
        assert!(error("x\n").contains("a.json is shown nowhere"));
        assert!(error("<!-- table: a -->\n").contains("has no <!-- /table -->"));
        assert!(error("<!-- table: a -->\n<!-- table: a -->\n").contains("has no"));
        assert!(error("<!-- /table -->\n").contains("without a beginning"));
        assert!(error("<!-- table: b -->\n<!-- /table -->\n").contains("no file b.json"));
    }

    #[test]
    fn commands_of_this_program_are_some() -> Result<()> {
        use clap::Parser;
        for folder in files(&Path::new(env!("CARGO_MANIFEST_DIR")).join("../..").join(FOLDER))? {
            for path in files(&folder)? {
                for command in Table::read(&path)?.command {
                    let command = command.split(" #").next().unwrap_or_default();
                    let Some(words) = command.strip_prefix("cargo xtask ") else { continue };
                    let parsed = crate::Command::try_parse_from(
                        ["xtask"].into_iter().chain(words.split_whitespace()),
                    );
                    assert!(parsed.is_ok(), "{}: {command}", path.display());
                }
            }
        }
        Ok(())
    }
}
