//! Clouds of a folder.

use std::path::{Path, PathBuf};

use nalgebra::Point3;
use rigidformer_runtime::memory::Budget;

use super::error::{CaptureError, CaptureProblem};
use super::limited::read_limited;
use super::manifest::{KnownCloud, MAX_CAPTURE_SPAN_S};
use super::names::{natural, stamps};
use super::notes::{LeftOut, Note, Notes};
use super::points::{Origin, cloud_of, count, drop_no_returns, shortened};
use super::{pcd, ply};
use crate::capture::{Capture, Cloud, View};

/// Bytes of a cloud's file, at most.
const MAX_BYTES: u64 = 512 << 20;

/// Captures that are read one at a time.
pub(super) struct CloudCaptures {
    clouds: Vec<KnownCloud>,
    next: usize,
    captures: usize,
    shared: Shared,
}

impl CloudCaptures {
    /// Looks whether all files are there.
    pub(super) fn new(clouds: Vec<KnownCloud>, notes: Notes) -> Result<Self, CaptureError> {
        if let Some(missing) = clouds.iter().find(|cloud| !cloud.path.is_file()) {
            return Err(CaptureError::of(missing.path.as_path(), CaptureProblem::Missing));
        }
        let shared = Shared { origin: Origin::default(), notes };
        let mut all = CloudCaptures { clouds, next: 0, captures: 0, shared };
        while all.of_next().is_some() {
            all.captures += 1;
        }
        all.next = 0;
        Ok(all)
    }

    /// How many are left.
    pub(super) fn left(&self) -> usize {
        self.captures
    }

    /// What is to be said about those so far.
    pub(super) fn notes(&self) -> &Notes {
        &self.shared.notes
    }

    /// Clouds of the next capture.
    fn of_next(&mut self) -> Option<std::ops::Range<usize>> {
        let start = self.next;
        let first_s = self.clouds.get(start)?.time_s;
        let of_it = |cloud: &&KnownCloud| cloud.time_s - first_s < MAX_CAPTURE_SPAN_S;
        self.next += self.clouds.iter().skip(start).take_while(of_it).count();
        Some(start..self.next)
    }
}

impl Iterator for CloudCaptures {
    type Item = Result<Capture, CaptureError>;

    fn next(&mut self) -> Option<Self::Item> {
        let clouds = self.of_next()?;
        self.captures = self.captures.saturating_sub(1);
        let clouds = self.clouds.get(clouds)?;
        let time_s = clouds.first()?.time_s;
        let mut budget = Budget::default();
        let mut left = LeftOut::default();
        let mut views = Vec::new();
        for known in clouds {
            match read(known, &mut budget, &mut self.shared) {
                Ok(cloud) => views.push(View::Cloud(cloud)),
                Err(error) => left.add(error, &mut self.shared.notes),
            }
        }
        Some(left.of(Capture { time_s, views }, &mut self.shared.notes))
    }
}

/// Whether a file's name has this extension.
pub(super) fn has_end(path: &Path, end: &str) -> bool {
    let extension = path.extension().and_then(|extension| extension.to_str());
    extension.is_some_and(|own| own.eq_ignore_ascii_case(end))
}

/// Whether a file is named as a cloud's.
pub(super) fn is_cloud(path: &Path) -> bool {
    has_end(path, "ply") || has_end(path, "pcd")
}

/// The clouds of a folder in the order of their names, at the times that these are, or so many a second from 0 s on.
pub(super) fn by_name(
    folder: &Path,
    rate_hz: Option<f64>,
    notes: &mut Notes,
) -> Result<Vec<KnownCloud>, CaptureError> {
    let mut paths = names(folder, notes)?;
    let stems = paths.iter().map(|path| path.file_stem().unwrap_or_default().to_string_lossy());
    let times = match stamps(&stems.collect::<Vec<_>>()) {
        Some(stamps) => {
            notes.add(Note::NamedTimes(stamps.kind));
            let mut both: Vec<_> = stamps.nanoseconds.into_iter().zip(paths).collect();
            both.sort();
            let first = both.first().map_or(0, |(time, _)| *time);
            let times = both.iter().map(|(time, _)| (time - first) as f64 / 1e9).collect();
            paths = both.into_iter().map(|(_, path)| path).collect();
            times
        }
        None => {
            let rate_hz =
                rate_hz.ok_or_else(|| CaptureError::of(folder, CaptureProblem::NoRate))?;
            (0..paths.len()).map(|index| index as f64 / rate_hz).collect::<Vec<_>>()
        }
    };
    let clouds = times.into_iter().zip(paths);
    Ok(clouds.map(|(time_s, path)| KnownCloud { time_s, path, sensor: None }).collect())
}

/// Files of clouds in a folder, in the order of their names, with numbers as numbers. Hidden ones are passed over.
pub(super) fn names(folder: &Path, notes: &mut Notes) -> Result<Vec<PathBuf>, CaptureError> {
    files(folder, notes, is_cloud)
}

/// Files of a folder that are wanted, in the order of their names, with numbers as numbers. Hidden ones are passed over.
pub(super) fn files(
    folder: &Path,
    notes: &mut Notes,
    is_wanted: fn(&Path) -> bool,
) -> Result<Vec<PathBuf>, CaptureError> {
    let unreadable = |error| CaptureError::of(folder, CaptureProblem::Unreadable(error));
    let (mut paths, mut hidden) = (Vec::new(), Vec::new());
    for entry in std::fs::read_dir(folder).map_err(unreadable)? {
        let entry = entry.map_err(unreadable)?;
        let (path, name) = (entry.path(), entry.file_name());
        let name = name.to_string_lossy();
        if !is_wanted(Path::new(&*name)) || !path.is_file() {
            continue;
        }
        match name.starts_with('.') {
            // macOS writes one beside each file of a stick: `._00.pcd`.
            true => hidden.push(name.into_owned()),
            false => paths.push((name.into_owned(), path)),
        }
    }
    hidden.sort();
    if let Some(first) = hidden.first() {
        notes.count(Note::Hidden(shortened(first.clone())), hidden.len() as u64);
    }
    paths.sort_by(|(one, _), (other, _)| natural(one, other));
    Ok(paths.into_iter().map(|(_, path)| path).collect())
}

/// What all clouds of a folder share.
#[derive(Default)]
struct Shared {
    origin: Origin,
    notes: Notes,
}

/// Reads a PLY or PCD file; which one is told from its contents. Its points are counted with those of the capture before.
fn read(
    known: &KnownCloud,
    budget: &mut Budget,
    shared: &mut Shared,
) -> Result<Cloud, CaptureError> {
    let fail = |problem| CaptureError::of(known.path.as_path(), problem);
    let bytes = read_limited(&known.path, MAX_BYTES.min(budget.left()))?;
    // The file is gone when the next one is read.
    let mut meanwhile = budget.clone();
    meanwhile.take(bytes.len() as u64).map_err(|large| fail(large.into()))?;
    let read = match bytes.starts_with(b"ply") {
        true => ply::read(&bytes, &mut meanwhile),
        false => pcd::read(&bytes, &mut meanwhile),
    };
    let mut read = read.map_err(fail)?;
    let Shared { origin, notes } = shared;
    drop_no_returns(&mut read.points, notes);
    let cloud = cloud_of(&read.points, read.is_labelled, read.is_single, origin, notes);
    let cloud = cloud.map_err(fail)?;
    count(budget, cloud.points.len()).map_err(fail)?;
    let sensor = known.sensor.map(|place| Point3::from(place.map(f64::from))).or(read.sensor);
    Ok(Cloud { sensor: sensor.map(|place| origin.moved(place)), ..cloud })
}
