//! Poses and points from CSV files.

use std::collections::HashMap;
use std::path::Path;

use csv::{Reader, ReaderBuilder, StringRecord, Trim};
use nalgebra::Point3;
use rigidformer_runtime::files::{read_whole, shown};
use rigidformer_runtime::memory::Budget;

use super::budget::counted;
use super::tracks::{self, Recording, Track};

/// Characters of a field that an error shows, at most.
const SHOWN: usize = 80;

/// Columns with a number of a pose.
const POSE: [&str; 8] = ["time_s", "x", "y", "z", "qw", "qx", "qy", "qz"];

/// A CSV file with a header, read row by row.
struct Table<'p> {
    path: &'p Path,
    reader: Reader<std::io::Cursor<Vec<u8>>>,
    header: StringRecord,
    /// Bytes of the file.
    length: u64,
}

impl<'p> Table<'p> {
    fn open(path: &'p Path, budget: &mut Budget) -> anyhow::Result<Self> {
        let bytes = read_whole(path)?;
        let length = bytes.len() as u64;
        counted(path, budget, length)?;
        let shown = path.display();
        if bytes.iter().all(u8::is_ascii_whitespace) {
            anyhow::bail!("{shown}: is empty; give a CSV file with a header and rows");
        }
        let mut reader = ReaderBuilder::new()
            .trim(Trim::All)
            .comment(Some(b'#'))
            .from_reader(std::io::Cursor::new(bytes));
        let header = reader.headers().map_err(|error| broken(path, &error))?.clone();
        Ok(Self { path, reader, header, length })
    }

    fn column(&self, name: &str, all: &str) -> anyhow::Result<usize> {
        let found =
            self.header.iter().position(|column| column.trim_start_matches('\u{feff}') == name);
        found.ok_or_else(|| {
            let (path, header) = (self.path.display(), self.header.iter().collect::<Vec<_>>());
            let header = shown(&header.join(","), SHOWN);
            anyhow::anyhow!(
                "{path}: line 1: has no column {name}, but {header}; name the columns {all}"
            )
        })
    }

    fn columns<const N: usize>(&self, names: [&str; N], all: &str) -> anyhow::Result<[usize; N]> {
        let mut columns = [0; N];
        for (column, name) in columns.iter_mut().zip(names) {
            *column = self.column(name, all)?;
        }
        Ok(columns)
    }

    /// The next row and its line.
    fn row(&mut self) -> anyhow::Result<Option<(u64, StringRecord)>> {
        let mut record = StringRecord::new();
        let more =
            self.reader.read_record(&mut record).map_err(|error| broken(self.path, &error))?;
        let line = record.position().map_or(0, csv::Position::line);
        Ok(more.then_some((line, record)))
    }

    fn number(&self, line: u64, record: &StringRecord, column: usize) -> anyhow::Result<f64> {
        let text = record.get(column).unwrap_or_default();
        text.parse().map_err(|_| {
            let name = shown(self.header.get(column).unwrap_or_default(), SHOWN);
            let (path, text) = (self.path.display(), shown(text, SHOWN));
            anyhow::anyhow!("{path}: line {line}, column {name}: {text:?} is not a number; write it as 0.25 or 2.5e-1")
        })
    }

    fn name(&self, line: u64, record: &StringRecord, column: usize) -> anyhow::Result<String> {
        match record.get(column) {
            Some(name) if !name.is_empty() => Ok(name.to_owned()),
            _ => anyhow::bail!(
                "{}: line {line}, column unit: is empty; give the unit's name or number",
                self.path.display()
            ),
        }
    }
}

fn broken(path: &Path, error: &csv::Error) -> anyhow::Error {
    let line = error.position().map_or(String::new(), |at| format!("line {}: ", at.line()));
    let shown = path.display();
    let what = match error.kind() {
        csv::ErrorKind::UnequalLengths { expected_len, len, .. } => {
            format!("has {len} fields, not the {expected_len} of the header; fill in all of them")
        }
        csv::ErrorKind::Utf8 { .. } => "is not text in UTF-8; export it as such".into(),
        _ => format!(
            "cannot be read ({}); give a CSV file with commas between",
            self::shown(&error.to_string(), SHOWN)
        ),
    };
    anyhow::anyhow!("{shown}: {line}{what}")
}

/// A recording of poses.
pub(super) fn read(path: &Path, budget: &mut Budget) -> anyhow::Result<Recording> {
    let mut table = Table::open(path, budget)?;
    let all = "time_s,unit,x,y,z,qw,qx,qy,qz";
    let unit = table.column("unit", all)?;
    let columns = table.columns(POSE, all)?;
    let mut units: Vec<Track> = Vec::new();
    let mut places: HashMap<String, usize> = HashMap::new();
    while let Some((line, record)) = table.row()? {
        let name = table.name(line, &record, unit)?;
        let mut numbers = [0.0; POSE.len()];
        for (number, column) in numbers.iter_mut().zip(columns) {
            *number = table.number(line, &record, column)?;
        }
        counted(path, budget, tracks::SAMPLE_BYTES)?;
        if !places.contains_key(&name) {
            counted(path, budget, (2 * size_of::<Track>() + 2 * name.len()) as u64)?;
        }
        let place = *places.entry(name.clone()).or_insert_with(|| {
            units.push(Track::new(name, None));
            units.len() - 1
        });
        let [time_s, pose @ ..] = numbers;
        if let Some(track) = units.get_mut(place) {
            track
                .add(&format!("line {line}"), time_s, pose)
                .map_err(|text| anyhow::anyhow!("{}: {text}", path.display()))?;
        }
    }
    if units.is_empty() {
        anyhow::bail!(
            "{}: has a header and no rows; give one row a unit and instant",
            path.display()
        );
    }
    // The file is gone when this is done.
    budget.give(table.length);
    Ok(Recording { path: path.into(), units, rate_hz: None })
}

/// Points of units.
pub(super) fn points(
    path: &Path,
    budget: &mut Budget,
) -> anyhow::Result<HashMap<String, Vec<Point3<f32>>>> {
    let mut table = Table::open(path, budget)?;
    let all = "unit,x,y,z";
    let unit = table.column("unit", all)?;
    let columns = table.columns(["x", "y", "z"], all)?;
    let mut points: HashMap<String, Vec<Point3<f32>>> = HashMap::new();
    while let Some((line, record)) = table.row()? {
        let name = table.name(line, &record, unit)?;
        let mut place = [0.0_f32; 3];
        for (number, column) in place.iter_mut().zip(columns) {
            let read = table.number(line, &record, column)?;
            // Scene files have single precision.
            if !(read as f32).is_finite() {
                let column = table.header.get(column).unwrap_or_default();
                anyhow::bail!(
                    "{}: line {line}, column {column}: {read} is not a finite number; leave the point out",
                    path.display()
                );
            }
            *number = read as f32;
        }
        let new = if points.contains_key(&name) { 0 } else { size_of::<Track>() + name.len() };
        counted(path, budget, (size_of::<Point3<f32>>() + new) as u64)?;
        points.entry(name).or_default().push(Point3::from(place));
    }
    if points.is_empty() {
        anyhow::bail!("{}: has a header and no rows; give one row a point", path.display());
    }
    budget.give(table.length);
    Ok(points)
}
