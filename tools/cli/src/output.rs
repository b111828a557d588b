//! What goes to stdout (results) and to stderr (progress and notes). Colours only on a terminal.

use std::fmt::{self, Display, Formatter};
use std::io::{self, IsTerminal, Write};
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use clap::builder::styling::{AnsiColor, Style};
use comfy_table::{Cell, CellAlignment, ContentArrangement, LineStyle, TableStyle};
use indicatif::{ProgressBar, ProgressStyle};
use rigidformer_runtime::files::{self, FileError};

use crate::usage::Usage;

/// Whether a file of results was written.
static WROTE: AtomicBool = AtomicBool::new(false);

const ERROR: Style = AnsiColor::Red.on_default().bold();
const NOTE: Style = AnsiColor::Cyan.on_default();
const HEADER: Style = Style::new().bold();

const RULE: LineStyle = LineStyle::none().fill('─').junction('─');
/// Rules above and below the header, and at the end.
const RULED: TableStyle =
    TableStyle::new().top_border(RULE).header_separator(RULE).bottom_border(RULE);

/// Whether nothing is to be said.
static SILENT: AtomicBool = AtomicBool::new(false);

/// From here on this process says nothing.
pub(crate) fn silence() {
    SILENT.store(true, Ordering::Relaxed);
}

fn say(stream: &mut dyn Write, text: fmt::Arguments<'_>) -> io::Result<()> {
    // Texts are still made: what makes them may fail.
    let mut nobody = io::sink();
    let stream: &mut dyn Write = if SILENT.load(Ordering::Relaxed) { &mut nobody } else { stream };
    writeln!(stream, "{text}")
}

/// Prints a line of the result.
///
/// # Errors
/// When stdout cannot be written to.
pub fn line(text: impl Display) -> anyhow::Result<()> {
    Ok(say(&mut anstream::stdout(), format_args!("{text}"))?)
}

/// Prints a JSON document.
///
/// # Errors
/// As [`line`].
pub fn json(value: &serde_json::Value) -> anyhow::Result<()> {
    line(serde_json::to_string_pretty(value)?)
}

/// Says something that is no result.
pub fn note(text: &str) {
    // With stderr gone there is nobody to tell.
    let _ = say(&mut anstream::stderr(), format_args!("{NOTE}note:{NOTE:#} {text}"));
}

/// Says why the program ends.
pub(crate) fn error(text: impl Display) {
    let _ = say(&mut anstream::stderr(), format_args!("{ERROR}error:{ERROR:#} {text}"));
}

/// Refuses to write over what is read.
pub(crate) fn apart<'p>(
    option: &str,
    out: &Path,
    inputs: impl IntoIterator<Item = &'p Path>,
) -> Result<(), Usage> {
    let Ok(place) = out.canonicalize() else { return Ok(()) };
    let is_same = |input: &Path| input.canonicalize().is_ok_and(|other| other == place);
    match inputs.into_iter().any(is_same) {
        true => Err(Usage(format!(
            "{option} {}: is what this command reads; give another name",
            out.display()
        ))),
        false => Ok(()),
    }
}

/// Writes a file of results, whole or not at all.
///
/// # Errors
/// When the file cannot be written.
pub fn write_whole(path: &Path, bytes: &[u8]) -> Result<(), FileError> {
    files::write_whole(path, bytes)?;
    WROTE.store(true, Ordering::Relaxed);
    Ok(())
}

/// Says that Ctrl-C ended the program, and what it leaves.
pub(crate) fn interrupted() {
    note(match WROTE.load(Ordering::Relaxed) {
        true => "interrupted; files that were written before are whole",
        false => "interrupted; nothing was written",
    });
}

/// Makes a folder for results where there is none.
///
/// # Errors
/// When it cannot be made.
pub fn folder(path: &Path) -> Result<(), FileError> {
    std::fs::create_dir_all(path).map_err(|source| FileError {
        path: path.into(),
        action: "cannot be made",
        remedy: "give another folder with --out",
        source,
    })
}

/// A progress bar on stderr where that is a terminal, else nothing.
pub fn progress(steps: u64, what: &str) -> ProgressBar {
    if SILENT.load(Ordering::Relaxed) || !std::io::stderr().is_terminal() {
        return ProgressBar::hidden();
    }
    let style = ProgressStyle::with_template("{msg} {wide_bar} {percent:>3} %  {eta} left");
    let bar = ProgressBar::new(steps).with_message(what.to_owned());
    bar.enable_steady_tick(Duration::from_millis(200));
    match style {
        Ok(style) => bar.with_style(style),
        Err(_) => bar,
    }
}

/// A table of results, with a bold header on terminals.
pub struct Table(comfy_table::Table);

impl Display for Table {
    fn fmt(&self, f: &mut Formatter<'_>) -> fmt::Result {
        let text = self.0.to_string();
        // The header is below the first rule. The crate's own styles need a library of terminals.
        for (number, line) in text.lines().enumerate() {
            match number {
                0 => write!(f, "{line}")?,
                1 if io::stdout().is_terminal() => write!(f, "\n{HEADER}{line}{HEADER:#}")?,
                _ => write!(f, "\n{line}")?,
            }
        }
        Ok(())
    }
}

/// A table whose first column is text and whose others are numbers.
pub fn table<'t>(header: impl IntoIterator<Item = &'t str>) -> Table {
    let mut table = comfy_table::Table::new();
    table.load_style(RULED).set_content_arrangement(ContentArrangement::Disabled);
    let cells = header.into_iter().enumerate().map(|(column, text)| number_cell(column, text));
    table.set_header(cells.collect::<Vec<_>>());
    Table(table)
}

/// Adds a row to a table made by [`table`].
pub fn row(table: &mut Table, cells: impl IntoIterator<Item = String>) {
    table.0.add_row(
        cells
            .into_iter()
            .enumerate()
            .map(|(column, text)| number_cell(column, &text))
            .collect::<Vec<_>>(),
    );
}

fn number_cell(column: usize, text: &str) -> Cell {
    let alignment = if column == 0 { CellAlignment::Left } else { CellAlignment::Right };
    Cell::new(text).set_alignment(alignment)
}
