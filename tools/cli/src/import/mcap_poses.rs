//! Poses from MCAP files, where frames may hang in frames that move.

use std::collections::{BTreeMap, HashMap};
use std::path::Path;

use nalgebra::Isometry3;
use rigidformer_runtime::perception::recording;

use super::tracks::{Recording, Track};

/// Frames from a unit to the world, at most.
const MOST_LINKS: usize = 32;

/// What the file says of one frame.
struct Frame {
    name: String,
    parent: String,
    /// Seconds, and the pose in the parent; in the order of times. A single one holds always.
    samples: Vec<(f64, Isometry3<f64>)>,
}

impl Frame {
    fn is_static(&self) -> bool {
        self.samples.len() == 1
    }

    /// The pose in the parent, none before the first sample and after the last.
    fn at(&self, time_s: f64) -> Option<Isometry3<f64>> {
        if let ([(_, pose)], true) = (self.samples.as_slice(), self.is_static()) {
            return Some(*pose);
        }
        let after = self.samples.partition_point(|(time, _)| *time < time_s);
        let (end, to) = self.samples.get(after)?;
        if *end == time_s {
            return Some(*to);
        }
        let (start, from) = self.samples.get(after.checked_sub(1)?)?;
        let part = (time_s - start) / (end - start);
        Some(from.try_lerp_slerp(to, part, 1e-9).unwrap_or(*from))
    }
}

/// A recording of poses. `wanted` are the units to take; none: every frame that moves.
pub(super) fn read(path: &Path, wanted: &[String]) -> anyhow::Result<Recording> {
    let (frames, places) = frames(path)?;
    let shown = path.display();
    let is_unit = |frame: &Frame| match wanted {
        [] => !frame.is_static(),
        names => names.contains(&frame.name),
    };
    // When something that never moves is where it is: whenever the frame with the most poses was seen.
    let moving = frames.iter().max_by_key(|frame| frame.samples.len());
    let instants: Vec<f64> =
        moving.map_or(Vec::new(), |frame| frame.samples.iter().map(|(time, _)| *time).collect());
    let (mut units, mut worlds) = (Vec::new(), BTreeMap::new());
    for frame in frames.iter().filter(|frame| is_unit(frame)) {
        let mut track = Track::new(frame.name.clone(), None);
        let own = frame.samples.iter().map(|(time, _)| *time).collect();
        for time_s in if frame.is_static() { instants.clone() } else { own } {
            let (world, pose) = in_world(path, &frames, &places, frame, time_s)?;
            worlds.entry(world).or_insert(&frame.name);
            // Where a parent is not known, the unit is not either.
            let Some(pose) = pose else { continue };
            let (v, q) = (pose.translation.vector, pose.rotation);
            track
                .add(&format!("at {time_s:.6} s"), time_s, [v.x, v.y, v.z, q.w, q.i, q.j, q.k])
                .map_err(|text| anyhow::anyhow!("{shown}: {text}"))?;
        }
        units.push(track);
    }
    if let (Some((one, a)), Some((two, b))) = (worlds.first_key_value(), worlds.last_key_value())
        && one != two
    {
        anyhow::bail!(
            "{shown}: unit {a} is in the frame {one:?} and unit {b} in {two:?}, and nothing says where these are to each other; take units of one of them with --unit"
        );
    }
    if units.is_empty() && wanted.is_empty() {
        anyhow::bail!(
            "{shown}: has a single pose of each frame, so nothing moves; give a recording of motion"
        );
    }
    Ok(Recording { path: path.into(), units, rate_hz: None })
}

/// All frames of a file, in the order in which they are first seen, and which is where.
fn frames(path: &Path) -> anyhow::Result<(Vec<Frame>, HashMap<String, usize>)> {
    let mut frames: Vec<Frame> = Vec::new();
    let mut places: HashMap<String, usize> = HashMap::new();
    for sample in recording::poses(path)? {
        let place = *places.entry(sample.frame.clone()).or_insert_with(|| {
            let (name, parent) = (sample.frame.clone(), sample.parent.clone());
            frames.push(Frame { name, parent, samples: Vec::new() });
            frames.len() - 1
        });
        let Some(frame) = frames.get_mut(place) else { continue };
        if frame.parent != sample.parent {
            anyhow::bail!(
                "{}: frame {} is in {:?}, and at {:.6} s in {:?}; cut the recording there into two files",
                path.display(),
                frame.name,
                frame.parent,
                sample.time_s,
                sample.parent
            );
        }
        frame.samples.push((sample.time_s, sample.pose.cast()));
    }
    for frame in &mut frames {
        frame.samples.sort_by(|a, b| a.0.total_cmp(&b.0));
        // What is said twice; what never moves is said again and again.
        frame.samples.dedup();
        if frame.samples.iter().all(|(_, pose)| Some(pose) == frame.samples.first().map(|s| &s.1))
            && frame.samples.first().is_some_and(|(time, _)| *time < 0.0)
        {
            frame.samples.truncate(1);
        }
    }
    Ok((frames, places))
}

/// The frame that hangs in none, and the pose in it where all frames between are known at that time.
fn in_world<'f>(
    path: &Path,
    frames: &'f [Frame],
    places: &HashMap<String, usize>,
    unit: &'f Frame,
    time_s: f64,
) -> anyhow::Result<(&'f str, Option<Isometry3<f64>>)> {
    let (mut pose, mut frame) = (unit.at(time_s), unit);
    for _ in 0..MOST_LINKS {
        let parent = places.get(&frame.parent).and_then(|place| frames.get(*place));
        let Some(parent) = parent else { return Ok((&frame.parent, pose)) };
        pose = pose.and_then(|pose| Some(parent.at(time_s)? * pose));
        frame = parent;
    }
    anyhow::bail!(
        "{}: unit {} hangs in more than {MOST_LINKS} frames, or in itself; mend the tree of frames",
        path.display(),
        unit.name
    )
}
