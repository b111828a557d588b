//! Rigid bodies of OptiTrack's Motive: its CSV export, format versions 1.2 and later.

use std::fs::File;
use std::io::Read;
use std::path::Path;

use csv::{ReaderBuilder, StringRecord, Trim};
use rigidformer_runtime::files::{read_whole, shown};
use rigidformer_runtime::memory::Budget;

use super::budget::counted;
use super::tracks::{self, Recording, Track};
use crate::output;

/// How such a file begins.
const BEGIN: &str = "Format Version";
/// Rows before that of `Frame`, at most.
const MOST_HEADER: usize = 16;
/// Characters of a cell that an error shows, at most.
const SHOWN: usize = 80;

/// Whether a CSV file is an export of Motive.
pub(super) fn is_one(path: &Path) -> bool {
    let mut bytes = Vec::new();
    let read = File::open(path).and_then(|file| file.take(64).read_to_end(&mut bytes));
    let text = String::from_utf8_lossy(&bytes);
    read.is_ok() && text.trim_start_matches('\u{feff}').starts_with(BEGIN)
}

/// What is above the poses.
#[derive(Default)]
struct Header {
    /// `Export Frame Rate`
    rate_hz: Option<f64>,
    /// Metres of a length of 1.
    scale: f64,
    kinds: StringRecord,
    names: StringRecord,
    ids: StringRecord,
    /// Rotation or Position.
    what: StringRecord,
    axes: StringRecord,
}

/// A rigid body: columns of x, y, z, qw, qx, qy, qz.
struct Body {
    track: Track,
    columns: [usize; 7],
    lost: usize,
}

pub(super) fn read(path: &Path, budget: &mut Budget) -> anyhow::Result<Recording> {
    let bytes = read_whole(path)?;
    let length = bytes.len() as u64;
    counted(path, budget, length)?;
    let mut reader = ReaderBuilder::new()
        .trim(Trim::All)
        .flexible(true)
        .has_headers(false)
        .from_reader(std::io::Cursor::new(bytes));
    let mut rows = reader.records();
    let header = header(path, &mut rows)?;
    let mut bodies = bodies(path, &header, budget)?;
    for row in rows {
        let row = row.map_err(|error| broken(path, &error))?;
        let line = row.position().map_or(0, csv::Position::line);
        let number = |column: usize| number(path, line, &row, column);
        let Some(time_s) = number(1)? else { continue };
        for body in &mut bodies {
            let mut pose = [0.0; 7];
            let mut is_lost = false;
            for (value, column) in pose.iter_mut().zip(body.columns) {
                match number(column)? {
                    Some(found) => *value = found,
                    None => is_lost = true,
                }
            }
            if is_lost {
                body.lost += 1;
                continue;
            }
            counted(path, budget, tracks::SAMPLE_BYTES)?;
            pose[..3].iter_mut().for_each(|number| *number *= header.scale);
            let added = body.track.add(&format!("line {line}"), time_s, pose);
            added.map_err(|text| anyhow::anyhow!("{}: {text}", path.display()))?;
        }
    }
    told(path, &bodies);
    budget.give(length);
    let units = bodies.into_iter().map(|body| body.track).filter(|track| !track.is_empty());
    let units: Vec<Track> = units.collect();
    anyhow::ensure!(
        !units.is_empty(),
        "{}: no rigid body was seen in any frame; export a take in which they are tracked",
        path.display()
    );
    Ok(Recording { path: path.into(), units, rate_hz: header.rate_hz })
}

fn told(path: &Path, bodies: &[Body]) {
    for body in bodies.iter().filter(|body| body.lost > 0) {
        let (name, lost) = (shown(body.track.name(), SHOWN), body.lost);
        output::note(&format!("{}: unit {name} is not seen in {lost} frames", path.display()));
    }
}

fn header(
    path: &Path,
    rows: &mut impl Iterator<Item = csv::Result<StringRecord>>,
) -> anyhow::Result<Header> {
    let shown = path.display();
    let mut header = Header { scale: 1.0, ..Header::default() };
    let mut before = StringRecord::new();
    for row in rows.by_ref().take(MOST_HEADER) {
        let row = row.map_err(|error| broken(path, &error))?;
        let first = row.get(0).unwrap_or_default().trim_start_matches('\u{feff}');
        match (first, row.get(1).unwrap_or_default()) {
            (BEGIN, _) => said(path, &row, &mut header)?,
            ("Frame", _) => {
                (header.what, header.axes) = (before, row);
                return Ok(header);
            }
            (_, "Type") => header.kinds = row.clone(),
            (_, "Name") => header.names = row.clone(),
            (_, "ID") => header.ids = row.clone(),
            _ => {}
        }
        before = row;
    }
    anyhow::bail!(
        "{shown}: begins as a CSV export of Motive, and has no row Frame,Time; export the take again"
    )
}

/// The first row: pairs of a name and its value.
fn said(path: &Path, row: &StringRecord, header: &mut Header) -> anyhow::Result<()> {
    let path = path.display();
    let value = |name: &str| {
        let at = row.iter().position(|cell| cell.trim_start_matches('\u{feff}') == name)?;
        row.get(at + 1)
    };
    header.rate_hz = value("Export Frame Rate")
        .and_then(|rate| rate.parse().ok())
        .filter(|rate: &f64| rate.is_finite() && *rate > 0.0);
    header.scale = match value("Length Units").map(str::to_ascii_lowercase).as_deref() {
        None | Some("meters") => 1.0,
        Some("centimeters") => 1e-2,
        Some("millimeters") => 1e-3,
        Some("feet") => 0.3048,
        Some("inches") => 0.0254,
        Some(other) => anyhow::bail!(
            "{path}: Length Units {:?} are not known; export in meters",
            shown(other, SHOWN)
        ),
    };
    match value("Rotation Type") {
        None | Some("Quaternion") => {}
        Some(other) => anyhow::bail!(
            "{path}: Rotation Type {:?} is not read; export with quaternions",
            shown(other, SHOWN)
        ),
    }
    if let Some(space) = value("Coordinate Space").filter(|space| *space != "Global") {
        anyhow::bail!(
            "{path}: Coordinate Space {:?} says nothing of the world; export in Global",
            shown(space, SHOWN)
        );
    }
    Ok(())
}

/// The rigid bodies; markers are passed over.
fn bodies(path: &Path, header: &Header, budget: &mut Budget) -> anyhow::Result<Vec<Body>> {
    // Position x, y, z, then rotation w, x, y, z, as a pose has them.
    let place = |what: &str, axis: &str| match (what, axis) {
        ("Position", "X") => Some(0),
        ("Position", "Y") => Some(1),
        ("Position", "Z") => Some(2),
        ("Rotation", "W") => Some(3),
        ("Rotation", "X") => Some(4),
        ("Rotation", "Y") => Some(5),
        ("Rotation", "Z") => Some(6),
        _ => None,
    };
    let mut bodies: Vec<(String, Body)> = Vec::new();
    for (column, axis) in header.axes.iter().enumerate().skip(2) {
        let cell = |row: &StringRecord| row.get(column).unwrap_or_default().to_owned();
        if cell(&header.kinds) != "Rigid Body" {
            continue;
        }
        let Some(place) = place(&cell(&header.what), axis) else { continue };
        let (name, id) = (cell(&header.names), cell(&header.ids));
        // Columns of a body stand together.
        let is_last =
            bodies.last().is_some_and(|(last, body)| *last == id && body.track.name() == name);
        if !is_last {
            counted(path, budget, (2 * size_of::<Body>() + 2 * (name.len() + id.len())) as u64)?;
            let body = Body { track: Track::new(name, None), columns: [0; 7], lost: 0 };
            bodies.push((id, body));
        }
        if let Some((_, body)) = bodies.last_mut()
            && let Some(slot) = body.columns.get_mut(place)
        {
            *slot = column;
        }
    }
    let path = path.display();
    anyhow::ensure!(
        !bodies.is_empty(),
        "{path}: has no rigid bodies; make some of its markers in Motive, and export them"
    );
    if let Some((_, body)) = bodies.iter().find(|(_, body)| body.columns.contains(&0)) {
        let name = shown(body.track.name(), SHOWN);
        anyhow::bail!(
            "{path}: rigid body {name} lacks a column of its rotation (X, Y, Z, W) or position (X, Y, Z)"
        );
    }
    Ok(bodies.into_iter().map(|(_, body)| body).collect())
}

/// A number; none where the cell is blank or not there.
fn number(
    path: &Path,
    line: u64,
    row: &StringRecord,
    column: usize,
) -> anyhow::Result<Option<f64>> {
    let Some(text) = row.get(column).filter(|text| !text.is_empty()) else { return Ok(None) };
    let number = text.parse().map_err(|_| {
        let (path, text) = (path.display(), shown(text, SHOWN));
        anyhow::anyhow!("{path}: line {line}, column {}: {text:?} is not a number", column + 1)
    })?;
    Ok(Some(number))
}

fn broken(path: &Path, error: &csv::Error) -> anyhow::Error {
    let (path, error) = (path.display(), shown(&error.to_string(), SHOWN));
    anyhow::anyhow!("{path}: cannot be read ({error}); export the take as CSV in UTF-8")
}
