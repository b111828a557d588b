//! What goes to stdout (results) and to stderr (progress and notes). Colours only on a terminal.

use std::collections::HashSet;
use std::fmt::{self, Display, Formatter, Write as _};
use std::io::{self, IsTerminal, Write};
use std::mem;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Mutex, PoisonError};
use std::time::Duration;

use clap::builder::styling::{AnsiColor, Style};
use comfy_table::{Cell, CellAlignment, ContentArrangement, LineStyle, TableStyle};
use indicatif::{ProgressBar, ProgressStyle};
use rigidformer_runtime::files::{self, FileError};

use crate::interrupt;
pub(crate) use crate::printable::name;
use crate::printable::{escaped_json, shown};
use crate::usage::Usage;

/// Whether a file of results, or a state to go on from, was written.
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

/// Whether results went to stdout as a file: what is said goes to stderr then.
static TAKEN: AtomicBool = AtomicBool::new(false);

/// Results that were said and not yet told, see [`tell`].
static SAID: Mutex<String> = Mutex::new(String::new());

/// From here on this process says nothing.
pub(crate) fn silence() {
    SILENT.store(true, Ordering::Relaxed);
}

/// Writes all that [`line`] and its kin said to stdout: at the end of a command, when its files are written and its verdict is known, so
/// that no reader who leaves or waits keeps them from that. A reader who has left is no failure.
///
/// # Errors
/// When stdout cannot be written to, as on a full disk.
pub(crate) fn tell() -> anyhow::Result<()> {
    let said = mem::take(&mut *SAID.lock().unwrap_or_else(PoisonError::into_inner));
    if SILENT.load(Ordering::Relaxed) || said.is_empty() {
        return Ok(());
    }
    let told = match TAKEN.load(Ordering::Relaxed) {
        true => anstream::stderr().write_all(said.as_bytes()),
        false => {
            let mut stdout = anstream::stdout();
            stdout.write_all(said.as_bytes()).and_then(|()| stdout.flush())
        }
    };
    heard(told)
}

/// Whether a result was told, or nobody listens.
pub(crate) fn heard(told: io::Result<()>) -> anyhow::Result<()> {
    match told {
        Err(error) if error.kind() != io::ErrorKind::BrokenPipe => Err(anyhow::anyhow!(
            "standard output cannot be written to ({error}); files of results are written"
        )),
        _ => Ok(()),
    }
}

fn say(text: fmt::Arguments<'_>) -> fmt::Result {
    // Texts are made even in silence: what makes them may fail.
    let mut said = SAID.lock().unwrap_or_else(PoisonError::into_inner);
    writeln!(said, "{text}")
}

/// Says a line of the result. Control characters in it, which come from files, are shown as text, and what is very long is shortened.
///
/// # Errors
/// When `text` cannot be formatted.
pub fn line(text: impl Display) -> anyhow::Result<()> {
    Ok(say(format_args!("{}", shown(&text.to_string())))?)
}

/// Says a table of the result.
///
/// # Errors
/// When the table cannot be formatted.
pub fn table_lines(table: &Table) -> anyhow::Result<()> {
    Ok(say(format_args!("{table}"))?)
}

/// Says a result for other programs as it is: text of this program alone.
///
/// # Errors
/// As [`line`].
#[cfg_attr(not(feature = "pieces"), allow(dead_code))]
pub(crate) fn data(text: &str) -> anyhow::Result<()> {
    Ok(say(format_args!("{text}"))?)
}

/// Says a JSON document.
///
/// # Errors
/// As [`line`].
pub fn json(value: &serde_json::Value) -> anyhow::Result<()> {
    Ok(say(format_args!("{}", escaped_json(&serde_json::to_string_pretty(value)?)))?)
}

/// Says something on stderr. With stderr gone there is nobody to tell.
fn remark(style: Style, kind: &str, text: &str) {
    if !SILENT.load(Ordering::Relaxed) {
        let text = shown(text);
        let _ = writeln!(anstream::stderr(), "{style}{kind}:{style:#} {text}");
    }
}

/// Says something that is no result.
pub fn note(text: &str) {
    remark(NOTE, "note", text);
}

/// Says why the program ends.
pub(crate) fn error(text: impl Display) {
    remark(ERROR, "error", &text.to_string());
}

/// Refuses to write over what is read.
pub(crate) fn apart<'p>(
    option: &str,
    out: &Path,
    inputs: impl IntoIterator<Item = &'p Path>,
) -> Result<(), Usage> {
    let Ok(place) = out.canonicalize() else { return Ok(()) };
    // A device is no file that could be lost.
    if !place.is_file() {
        return Ok(());
    }
    let is_same = |input: &Path| input.canonicalize().is_ok_and(|other| other == place);
    match inputs.into_iter().any(is_same) {
        true => Err(Usage(format!(
            "{option} {}: is what this command reads; give another name",
            out.display()
        ))),
        false => Ok(()),
    }
}

/// Refuses two results of one name, by whatever links and folders it is said.
pub(crate) fn distinct<'p>(
    outputs: impl IntoIterator<Item = (&'static str, &'p Path)>,
) -> Result<(), Usage> {
    let mut places = HashSet::new();
    for (option, path) in outputs {
        if !places.insert(destination(path)) {
            let shown = path.display();
            return Err(Usage(format!(
                "{option} {shown}: two options name this file; give two names"
            )));
        }
    }
    Ok(())
}

/// Where a file goes, also in folders that are not there yet.
fn destination(path: &Path) -> PathBuf {
    if let Ok(place) = files::destination(path) {
        return place;
    }
    match (path.parent(), path.file_name()) {
        (Some(folder), Some(name)) if folder.as_os_str().is_empty() => {
            Path::new(".").canonicalize().unwrap_or_default().join(name)
        }
        (Some(folder), Some(name)) => {
            folder.canonicalize().unwrap_or_else(|_| destination(folder)).join(name)
        }
        _ => path.into(),
    }
}

/// Writes a file of results, whole or not at all.
///
/// # Errors
/// When the file cannot be written, and once Ctrl-C was pressed.
pub fn write_whole(path: &Path, bytes: &[u8]) -> anyhow::Result<()> {
    write_all(&[(path, bytes)])
}

/// Writes files of results, all or none.
///
/// # Errors
/// When one of them cannot be written, and once Ctrl-C was pressed.
pub(crate) fn write_all(results: &[(&Path, &[u8])]) -> anyhow::Result<()> {
    interrupt::check()?;
    if results.iter().any(|(path, _)| files::is_stdout(path)) {
        TAKEN.store(true, Ordering::Relaxed);
    }
    files::write_all(results)?;
    if !results.is_empty() {
        WROTE.store(true, Ordering::Relaxed);
    }
    Ok(())
}

/// Writes a state to go on from, whole or not at all: also once Ctrl-C was pressed, which is what it is for.
///
/// # Errors
/// When it cannot be written: the one before is then as it was.
#[cfg(feature = "calibrate")]
pub(crate) fn write_state(path: &Path, bytes: &[u8]) -> Result<(), FileError> {
    files::write_whole(path, bytes)?;
    WROTE.store(true, Ordering::Relaxed);
    Ok(())
}

/// Writes files of results, all or none, and says so: in notes where stdout is for JSON.
///
/// # Errors
/// As [`write_all`].
pub(crate) fn write_results(results: &[(PathBuf, Vec<u8>)], quiet: bool) -> anyhow::Result<()> {
    let all: Vec<(&Path, &[u8])> =
        results.iter().map(|(path, bytes)| (path.as_path(), bytes.as_slice())).collect();
    write_all(&all)?;
    for (path, _) in results {
        let done = format!("wrote {}", path.display());
        match quiet {
            true => note(&done),
            false => line(done)?,
        }
    }
    Ok(())
}

/// Says on stderr what has its own beginning.
pub(crate) fn plain(text: &str) {
    let _ = writeln!(anstream::stderr(), "{}", shown(text.trim_end()));
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
    let bar = ProgressBar::new(steps).with_message(name(what));
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
    Cell::new(name(text)).set_alignment(alignment)
}
