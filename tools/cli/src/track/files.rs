//! What `rigidformer track` writes.

use std::collections::{BTreeSet, HashSet};
use std::path::{Path, PathBuf};

use nalgebra::{Isometry3, Translation3, Vector3};
use rigidformer_evaluation::scenes::{RecordedScene, RecordedUnit, SceneNotes, Split, scene_file};
use rigidformer_perception::estimate::Estimate;
use rigidformer_perception::tracker::{TrackerOptions, volume_m3};

use super::facts;
use super::followed::Followed;
use super::words::{rest_word, sight_word};
use crate::csv_text::CsvText;
use crate::picture::{Strip, tracks};
use crate::{interrupt, output};

/// The units that were followed as a scene file.
const TRACKED: &str = "tracked.safetensors";
/// Frames of a scene, at most.
const MOST_FRAMES: f64 = 1e6;

/// Files that `--out` may get.
pub(super) const RESULTS: [&str; 3] = ["poses.csv", "strip.png", TRACKED];

/// All files and their bytes.
pub(super) fn made(
    folder: &Path,
    name: &str,
    options: &TrackerOptions,
    followed: &Followed,
) -> anyhow::Result<Vec<(PathBuf, Vec<u8>)>> {
    let instants = followed.shown();
    let strip = Strip {
        title: format!("{name}: {} units followed", followed.shapes.len()),
        planes: &followed.planes,
        shapes: &followed.shapes,
        instants: &instants,
        up: (-options.gravity_m_s2).try_normalize(1e-6).unwrap_or_else(Vector3::z),
        reason: facts::reason(followed),
    };
    let mut files = vec![
        (folder.join("poses.csv"), poses_csv(&followed.estimates)),
        (folder.join("strip.png"), tracks(&strip)?),
    ];
    let tracked = scene(name, options, followed)?;
    match tracked {
        Some((scene, left_out)) => {
            let path = folder.join(TRACKED);
            let notes = SceneNotes {
                dataset: format!("{name} tracked"),
                provenance: format!(
                    "Units that `rigidformer track` followed in {name}. Masses, frictions and restitutions are guesses."
                ),
                licence: "as that of the recording".into(),
            };
            let bytes = scene_file(&path, &scene, &notes)?;
            files.push((path, bytes));
            if left_out > 0 {
                output::note(&format!(
                    "{left_out} units are not in {TRACKED}: they were followed for less of the time than the others"
                ));
            }
        }
        None => output::note(&format!("no {TRACKED}: no unit was followed in two captures")),
    }
    Ok(files)
}

fn poses_csv(estimates: &[Estimate]) -> Vec<u8> {
    let mut csv = CsvText::new([
        "time_s",
        "unit",
        "x",
        "y",
        "z",
        "qw",
        "qx",
        "qy",
        "qz",
        "vx",
        "vy",
        "vz",
        "wx",
        "wy",
        "wz",
        "sd_x",
        "sd_y",
        "sd_z",
        "sd_turn_x",
        "sd_turn_y",
        "sd_turn_z",
        "sd_vx",
        "sd_vy",
        "sd_vz",
        "sd_wx",
        "sd_wy",
        "sd_wz",
        "sight",
        "rest",
    ]);
    for estimate in estimates {
        for unit in &estimate.units {
            let (t, q) = (unit.pose.translation.vector, unit.pose.rotation.quaternion());
            let deviation = |variance: f32| variance.max(0.0).sqrt();
            let numbers = [t.x, t.y, t.z, q.w, q.i, q.j, q.k].into_iter();
            let numbers = numbers.chain(unit.velocity.iter().copied());
            let variances = [unit.covariance.diagonal(), unit.velocity_covariance.diagonal()];
            let numbers = numbers.chain(variances.iter().flatten().copied().map(deviation));
            let words = [sight_word(unit.visibility), rest_word(unit.rest)].map(str::to_owned);
            let head = [format!("{:.6}", estimate.time_s), unit.id.to_string()];
            let row = head.into_iter().chain(numbers.map(|number| number.to_string()));
            csv.row(row.chain(words));
        }
    }
    csv.into_bytes()
}

/// The stretch whose length times the number of spans that cover it is greatest, by first and last moment; of equal ones the first in the
/// order of the spans.
fn stretch(spans: &[(f64, f64)]) -> anyhow::Result<Option<(f64, f64)>> {
    let mut best: Option<(f64, f64, f64)> = None;
    let mut seen = HashSet::new();
    for (first, _) in spans {
        if !seen.insert(first.to_bits()) {
            continue;
        }
        interrupt::check()?;
        // Spans that begin in time, by their ends: those that cover a stretch are the last ones of them.
        let mut ends: Vec<f64> =
            spans.iter().filter(|(from, _)| from <= first).map(|(_, to)| *to).collect();
        ends.sort_by(f64::total_cmp);
        for (_, last) in spans {
            let during = ends.len() - ends.partition_point(|to| to < last);
            let worth = during as f64 * (last - first);
            if worth > 0.0 && best.is_none_or(|(most, ..)| worth > most) {
                best = Some((worth, *first, *last));
            }
        }
    }
    Ok(best.map(|(_, first, last)| (first, last)))
}

/// The units that were followed over the stretch that has most of them for longest, at a constant rate; and how many others there
/// were. None without a unit in two captures.
fn scene(
    name: &str,
    options: &TrackerOptions,
    followed: &Followed,
) -> anyhow::Result<Option<(RecordedScene, usize)>> {
    let estimates = &followed.estimates;
    let units = followed.units();
    let spans: Vec<(f64, f64)> = units.iter().map(|(_, from, to, _)| (*from, *to)).collect();
    let Some((first, last)) = stretch(&spans)? else { return Ok(None) };
    let ids: BTreeSet<u32> = units
        .iter()
        .filter(|(id, from, to, _)| {
            *from <= first && *to >= last && followed.shapes.get(id).is_some_and(|p| p.len() >= 4)
        })
        .map(|(id, ..)| *id)
        .collect();
    let within: Vec<&Estimate> =
        estimates.iter().filter(|estimate| (first..=last).contains(&estimate.time_s)).collect();
    if ids.is_empty() || within.len() < 2 {
        return Ok(None);
    }
    let mut gaps: Vec<f64> =
        within.windows(2).map(|pair| pair[1].time_s - pair[0].time_s).collect();
    gaps.sort_by(f64::total_cmp);
    let step_s = gaps[gaps.len() / 2];
    let frames = ((last - first) / step_s + 1e-6).floor().min(MOST_FRAMES) as usize + 1;
    let unit = |id: &u32| {
        let poses = (0..frames).map(|frame| pose_at(&within, *id, first + frame as f64 * step_s));
        let poses: Option<Vec<_>> = poses.collect();
        let points = followed.shapes.get(id)?.clone();
        let physics = options.physics_of(volume_m3(&points));
        Some(RecordedUnit::new(format!("track-{id}"), points, physics, poses?))
    };
    let made: Vec<RecordedUnit> = ids.iter().filter_map(unit).collect();
    if made.is_empty() {
        return Ok(None);
    }
    let left_out = units.len() - made.len();
    let (rate_hz, gravity) = ((1.0 / step_s) as f32, options.gravity_m_s2);
    let scene = RecordedScene::new(name, 0, Split::Extra, rate_hz, gravity, made)?;
    Ok(Some((scene.with_planes(followed.planes.clone())?, left_out)))
}

/// A unit's pose at a time, between the captures before and after.
fn pose_at(estimates: &[&Estimate], id: u32, time_s: f64) -> Option<Isometry3<f32>> {
    let of = |estimate: &Estimate| {
        estimate.units.iter().find(|unit| unit.id == id).map(|unit| unit.pose)
    };
    let after = estimates.partition_point(|estimate| estimate.time_s < time_s);
    let later = estimates.get(after).or(estimates.last())?;
    let Some(earlier) = after.checked_sub(1).and_then(|at| estimates.get(at)) else {
        return of(later);
    };
    let (a, b) = (of(earlier)?, of(later)?);
    let part =
        ((time_s - earlier.time_s) / (later.time_s - earlier.time_s).max(1e-9)).clamp(0.0, 1.0);
    let place = a.translation.vector.lerp(&b.translation.vector, part as f32);
    let rotation = a.rotation.try_slerp(&b.rotation, part as f32, 1e-6).unwrap_or(b.rotation);
    Some(Isometry3::from_parts(Translation3::from(place), rotation))
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;

    /// By trying all of them.
    fn tried(spans: &[(f64, f64)]) -> Option<(f64, f64)> {
        let mut best: Option<(f64, f64, f64)> = None;
        for (first, _) in spans {
            for (_, last) in spans {
                let during = spans.iter().filter(|(from, to)| from <= first && to >= last).count();
                let worth = during as f64 * (last - first);
                if worth > 0.0 && best.is_none_or(|(most, ..)| worth > most) {
                    best = Some((worth, *first, *last));
                }
            }
        }
        best.map(|(_, first, last)| (first, last))
    }

    #[test]
    fn the_stretch_is_the_one_that_trying_all_finds() {
        let mut state = 7_u64;
        let mut random = || {
            state = state.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
            (state >> 60) as f64
        };
        for count in 0..40 {
            let spans: Vec<_> = (0..count).map(|_| (random(), random() + 4.0)).collect();
            assert_eq!(stretch(&spans).unwrap(), tried(&spans), "{spans:?}");
        }
        assert_eq!(stretch(&[(1.0, 1.0)]).unwrap(), None);
    }
}
