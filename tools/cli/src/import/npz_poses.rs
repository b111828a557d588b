//! Poses from npz files.

use std::collections::HashMap;
use std::io::{Cursor, Read};
use std::path::Path;

use nalgebra::Point3;
use rigidformer_runtime::files::read_whole;
use zip::ZipArchive;

use super::npy::{self, Array};
use super::tracks::{Recording, Track};

/// Bytes of an array, at most.
const MOST_BYTES: u64 = 1 << 30;
/// What the points of a unit are called.
const POINTS: &str = "points";
const POINTS_OF: &str = "points_";

/// A recording of poses.
pub(super) fn read(path: &Path) -> anyhow::Result<Recording> {
    let bytes = read_whole(path)?;
    let shown = path.display();
    if bytes.is_empty() {
        anyhow::bail!("{shown}: is empty; write it with numpy.savez");
    }
    let mut archive = ZipArchive::new(Cursor::new(bytes)).map_err(|error| {
        anyhow::anyhow!("{shown}: is no npz file ({error}); write it with numpy.savez")
    })?;
    let (mut arrays, mut order) = (HashMap::new(), Vec::new());
    let mut left = MOST_BYTES;
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
        let mut data = Vec::new();
        // What an archive unpacks to may be a thousand times its size.
        file.take(left + 1).read_to_end(&mut data).map_err(|error| damaged(&error))?;
        left = left.checked_sub(data.len() as u64).ok_or_else(|| {
            anyhow::anyhow!(
                "{shown}: its arrays have more than {MOST_BYTES} bytes with {name}; split the recording"
            )
        })?;
        let array = npy::parse(&data).map_err(|text| anyhow::anyhow!("{shown}: {name} {text}"))?;
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
            order.join(", ")
        );
    }
    let mut tracks = Vec::new();
    for unit in 0..units {
        let name = order.get(unit).cloned().unwrap_or_else(|| unit.to_string());
        let own = format!("{POINTS_OF}{name}");
        let points = match arrays.get(&own) {
            Some(array) => Some(points(path, &own, array)?),
            None => arrays.get(POINTS).map(|array| points(path, POINTS, array)).transpose()?,
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
        tracks.push(track);
    }
    Ok(Recording { path: path.into(), units: tracks, rate_hz })
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
            _ => anyhow::bail!("{shown}: fps is {:?}, not one number above 0", fps.values),
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
