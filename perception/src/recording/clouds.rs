//! Clouds of a folder.

use std::path::{Path, PathBuf};

use nalgebra::Point3;
use rigidformer_runtime::memory::Budget;

use super::error::{CaptureError, CaptureProblem};
use super::limited::read_limited;
use super::manifest::{KnownCloud, MAX_CAPTURE_SPAN_S};
use super::points::count;
use super::{pcd, ply};
use crate::capture::{Capture, Cloud, View};

/// Bytes of a cloud's file, at most.
const MAX_BYTES: u64 = 512 << 20;

/// Captures that are read one at a time.
pub(super) struct CloudCaptures {
    clouds: Vec<KnownCloud>,
    next: usize,
    captures: usize,
}

impl CloudCaptures {
    /// Looks whether all files are there.
    pub(super) fn new(clouds: Vec<KnownCloud>) -> Result<Self, CaptureError> {
        if let Some(missing) = clouds.iter().find(|cloud| !cloud.path.is_file()) {
            return Err(CaptureError::of(missing.path.as_path(), CaptureProblem::Missing));
        }
        let mut all = CloudCaptures { clouds, next: 0, captures: 0 };
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
        let views = clouds.iter().map(|known| {
            let cloud = read(&known.path, &mut budget)?;
            let sensor = known.sensor.map(Point3::from).or(cloud.sensor);
            Ok(View::Cloud(Cloud { sensor, ..cloud }))
        });
        Some(views.collect::<Result<_, _>>().map(|views| Capture { time_s, views }))
    }
}

/// Whether a file is named as a cloud's.
pub(super) fn is_cloud(path: &Path) -> bool {
    let extension = path.extension().and_then(|extension| extension.to_str());
    extension.is_some_and(|end| end.eq_ignore_ascii_case("ply") || end.eq_ignore_ascii_case("pcd"))
}

/// The clouds of a folder in the order of their names, so many a second from 0 s on.
pub(super) fn by_name(folder: &Path, rate_hz: f64) -> Result<Vec<KnownCloud>, CaptureError> {
    let clouds = names(folder)?.into_iter().enumerate();
    let clouds = clouds.map(|(index, path)| KnownCloud {
        time_s: index as f64 / rate_hz,
        path,
        sensor: None,
    });
    Ok(clouds.collect())
}

/// Files of clouds in a folder, in the order of their names.
pub(super) fn names(folder: &Path) -> Result<Vec<PathBuf>, CaptureError> {
    let unreadable = |error| CaptureError::of(folder, CaptureProblem::Unreadable(error));
    let mut paths = Vec::new();
    for entry in std::fs::read_dir(folder).map_err(unreadable)? {
        let path = entry.map_err(unreadable)?.path();
        if is_cloud(&path) && path.is_file() {
            paths.push(path);
        }
    }
    paths.sort();
    Ok(paths)
}

/// Reads a PLY or PCD file; which one is told from its contents. Its points are counted with those of the capture before.
fn read(path: &Path, budget: &mut Budget) -> Result<Cloud, CaptureError> {
    let fail = |problem| CaptureError::of(path, problem);
    let bytes = read_limited(path, MAX_BYTES.min(budget.left()))?;
    // The file is gone when the next one is read.
    let mut meanwhile = budget.clone();
    meanwhile.take(bytes.len() as u64).map_err(|large| fail(large.into()))?;
    let cloud = if bytes.starts_with(b"ply") {
        ply::read(&bytes, &mut meanwhile)
    } else {
        pcd::read(&bytes, &mut meanwhile)
    };
    let cloud = cloud.map_err(fail)?;
    count(budget, cloud.points.len()).map_err(fail)?;
    Ok(cloud)
}
