//! CSV files of what is predicted and followed.

/// Rows of numbers and of words without commas, which need no quotes.
pub(crate) struct CsvText(String);

impl CsvText {
    /// A file that begins with the names of its columns.
    pub(crate) fn new<'n>(names: impl IntoIterator<Item = &'n str>) -> CsvText {
        let mut text = CsvText(String::new());
        text.row(names.into_iter().map(str::to_owned));
        text
    }

    pub(crate) fn row(&mut self, cells: impl IntoIterator<Item = String>) {
        for (column, cell) in cells.into_iter().enumerate() {
            if column > 0 {
                self.0.push(',');
            }
            self.0.push_str(&cell);
        }
        self.0.push('\n');
    }

    pub(crate) fn into_bytes(self) -> Vec<u8> {
        self.0.into_bytes()
    }
}
