//! Poses from npz files.

use std::collections::HashMap;
use std::io::Cursor;
use std::path::Path;

use nalgebra::Point3;
use rigidformer_runtime::files::{read_whole, shown as one_line};
use rigidformer_runtime::memory::Budget;
use zip::ZipArchive;

use super::budget::counted;
use super::named::listed;
use super::npy::{self, Array};
use super::tracks::{self, Recording, Track};

/// Arrays of an archive, at most.
const MOST_ARRAYS: usize = 1 << 16;
/// Begins the archive's entry of an array.
const ENTRY: &[u8] = b"PK\x01\x02";
/// Characters of a name that are shown, at most.
const SHOWN: usize = 80;
/// What the points of a unit are called.
const POINTS: &str = "points";
const POINTS_OF: &str = "points_";

/// A recording of poses.
pub(super) fn read(path: &Path, budget: &mut Budget) -> anyhow::Result<Recording> {
    let bytes = read_whole(path)?;
    let shown = path.display();
    if bytes.is_empty() {
        anyhow::bail!("{shown}: is empty; write it with numpy.savez");
    }
    // An entry takes ten times its length in memory.
    if bytes.windows(ENTRY.len()).filter(|at| *at == ENTRY).count() > MOST_ARRAYS {
        anyhow::bail!("{shown}: has more than {MOST_ARRAYS} arrays; split the recording");
    }
    let file_bytes = bytes.len() as u64;
    counted(path, budget, file_bytes)?;
    let mut archive = ZipArchive::new(Cursor::new(bytes)).map_err(|error| {
        let error = one_line(&error.to_string(), SHOWN);
        anyhow::anyhow!("{shown}: is no npz file ({error}); write it with numpy.savez")
    })?;
    let (mut arrays, mut order) = (HashMap::new(), Vec::new());
    for index in 0..archive.len() {
        let damaged = |error: &dyn std::fmt::Display| {
            anyhow::anyhow!("{shown}: is damaged ({error}); write it again with numpy.savez")
        };
        let file = archive.by_index(index).map_err(|error| damaged(&error))?;
        let name =
            file.name().map_err(|error| damaged(&error))?.trim_end_matches(".npy").to_owned();
        let is_wanted = ["poses", "time", "fps", POINTS].contains(&name.as_str());
        if !is_wanted && !name.starts_with(POINTS_OF) {
            continue;
        }
        counted(path, budget, 2 * (name.len() + size_of::<(String, Array)>()) as u64)?;
        let array = npy::parse(file, budget)
            .map_err(|text| anyhow::anyhow!("{shown}: {} {text}", one_line(&name, SHOWN)))?;
        if let Some(unit) = name.strip_prefix(POINTS_OF) {
            order.push(unit.to_owned());
        }
        arrays.insert(name, array);
    }
    let Some(poses) = arrays.get("poses") else {
        anyhow::bail!("{shown}: has no array poses; save one of shape (frames, units, 7)");
    };
    let &[frames, units, 7] = poses.shape.as_slice() else {
        anyhow::bail!(
            "{shown}: poses has shape {:?}, not (frames, units, 7); each pose is x, y, z, qw, qx, qy, qz",
            poses.shape
        );
    };
    if frames == 0 || units == 0 {
        anyhow::bail!(
            "{shown}: poses has shape {:?}: it is empty; give frames and units",
            poses.shape
        );
    }
    let (times_s, rate_hz) = times(path, &arrays, frames)?;
    if !order.is_empty() && order.len() != units {
        anyhow::bail!(
            "{shown}: has points of {} units ({}), and poses of {units}; give points_NAME for each unit, in the order of poses",
            order.len(),
            listed(order.iter().map(String::as_str))
        );
    }
    // Of all units that have none of their own.
    let shared = arrays.get(POINTS).map(|array| points(path, POINTS, array)).transpose()?;
    counted(path, budget, shared.iter().map(|points| bytes_of(points.len())).sum())?;
    let mut units_read = Vec::new();
    for unit in 0..units {
        let name = order.get(unit).cloned().unwrap_or_else(|| unit.to_string());
        let own = format!("{POINTS_OF}{name}");
        let array = arrays.get(&own);
        let own_points = array
            .map_or(shared.as_ref().map_or(0, Vec::len), |array| array.values.len().div_ceil(3));
        let samples = (frames as u64).saturating_mul(tracks::SAMPLE_BYTES);
        let fixed = (size_of::<Track>() + name.len()) as u64;
        counted(path, budget, bytes_of(own_points).saturating_add(samples).saturating_add(fixed))?;
        let points = match array {
            Some(array) => Some(points(path, &own, array)?),
            None => shared.clone(),
        };
        let mut track = Track::new(name, points);
        for (frame, time_s) in times_s.iter().enumerate() {
            let row = frame * units + unit;
            let numbers =
                poses.values.get(row * 7..row * 7 + 7).and_then(|row| row.try_into().ok());
            let place = format!("poses[{frame}, {unit}]");
            if let Some(numbers) = numbers {
                track
                    .add(&place, *time_s, numbers)
                    .map_err(|text| anyhow::anyhow!("{shown}: {text}"))?;
            }
        }
        units_read.push(track);
    }
    // The file and its arrays are gone when this is done.
    let values: usize = arrays.values().map(|array| array.values.len()).sum();
    budget.give(file_bytes.saturating_add((values as u64).saturating_mul(8)));
    Ok(Recording { path: path.into(), units: units_read, rate_hz })
}

/// What so many points take.
fn bytes_of(points: usize) -> u64 {
    (points as u64).saturating_mul(size_of::<Point3<f32>>() as u64)
}

/// When each frame is, and the rate where the file says it.
fn times(
    path: &Path,
    arrays: &HashMap<String, Array>,
    frames: usize,
) -> anyhow::Result<(Vec<f64>, Option<f64>)> {
    let shown = path.display();
    match (arrays.get("time"), arrays.get("fps")) {
        (Some(time), _) if time.shape == [frames] => Ok((time.values.clone(), None)),
        (Some(time), _) => {
            anyhow::bail!(
                "{shown}: time has shape {:?}, not ({frames},), a number a frame in seconds",
                time.shape
            )
        }
        (None, Some(fps)) => match fps.values[..] {
            [rate] if rate > 0.0 && rate.is_finite() => {
                Ok(((0..frames).map(|frame| frame as f64 / rate).collect(), Some(rate)))
            }
            _ => anyhow::bail!(
                "{shown}: fps is {} numbers, the first {:?}, not one number above 0",
                fps.values.len(),
                fps.values.first()
            ),
        },
        (None, None) => anyhow::bail!(
            "{shown}: has neither time nor fps; save time (frames) in seconds, or fps, one number"
        ),
    }
}

fn points(path: &Path, name: &str, array: &Array) -> anyhow::Result<Vec<Point3<f32>>> {
    let shown = path.display();
    let &[_, 3] = array.shape.as_slice() else {
        anyhow::bail!(
            "{shown}: {name} has shape {:?}, not (points, 3); give metres in the body frame",
            array.shape
        );
    };
    if let Some(place) = array.values.iter().position(|value| !(*value as f32).is_finite()) {
        anyhow::bail!(
            "{shown}: {name}[{}, {}] is not a finite number; leave the point out",
            place / 3,
            place % 3
        );
    }
    let rows = array.values.chunks_exact(3);
    Ok(rows
        .filter_map(|row| <[f64; 3]>::try_from(row).ok())
        .map(|row| Point3::from(row.map(|v| v as f32)))
        .collect())
}
