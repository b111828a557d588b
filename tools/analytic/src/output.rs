//! What goes to stdout (results) and to stderr (notes).

use std::fmt::Display;
use std::io::Write;

/// Prints a line of the result.
pub(crate) fn line(text: impl Display) -> anyhow::Result<()> {
    // `println!` panics where the reader is gone.
    writeln!(std::io::stdout(), "{text}")?;
    Ok(())
}

/// Prints a JSON document.
pub(crate) fn json(value: &serde_json::Value) -> anyhow::Result<()> {
    line(serde_json::to_string_pretty(value)?)
}

/// Says why the program ends.
pub(crate) fn error(text: impl Display) {
    // Without stderr there is nobody to tell.
    let _ = writeln!(std::io::stderr(), "error: {text}");
}

/// Prints rows of cells as columns: the first to the left, the others to the right.
pub(crate) fn table(rows: &[Vec<String>]) -> anyhow::Result<()> {
    let columns = rows.iter().map(Vec::len).max().unwrap_or(0);
    let width = |column: usize| {
        let cells = rows.iter().filter_map(|row| row.get(column));
        cells.map(|cell| cell.chars().count()).max().unwrap_or(0)
    };
    let widths: Vec<usize> = (0..columns).map(width).collect();
    for row in rows {
        let cells = row.iter().zip(&widths).enumerate().map(|(column, (cell, width))| {
            if column == 0 { format!("{cell:<width$}") } else { format!("{cell:>width$}") }
        });
        line(cells.collect::<Vec<_>>().join("  ").trim_end())?;
    }
    Ok(())
}

/// A row of texts.
pub(crate) fn row<'t>(cells: impl IntoIterator<Item = &'t str>) -> Vec<String> {
    cells.into_iter().map(str::to_owned).collect()
}

/// A number with so many digits after the point, or a dash for none.
pub(crate) fn number(value: Option<f64>, digits: usize) -> String {
    value.map_or("-".into(), |value| format!("{value:.digits$}"))
}

/// A share in percent, or a dash for none.
pub(crate) fn percent(value: Option<f64>) -> String {
    value.map_or("-".into(), |value| format!("{:.2} %", 100.0 * value))
}
