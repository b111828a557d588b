//! Poses from MCAP files, where frames may hang in frames that move.

use std::collections::{BTreeMap, HashMap};
use std::path::Path;

use nalgebra::Isometry3;
use rigidformer_perception::recording;
use rigidformer_runtime::memory::Budget;

use super::budget::counted;
use super::named::none_wanted;
use super::tracks::{self, Recording, Track};
use crate::output;

/// Frames from a unit to the world, at most.
const MOST_LINKS: usize = 32;

/// What the file says of one frame.
struct Frame {
    name: String,
    parent: String,
    /// Seconds, and the pose in the parent; in the order of times.
    samples: Vec<(f64, Isometry3<f64>)>,
    /// Whether its pose never changes, however often it is said: then it holds always.
    is_still: bool,
    /// An instant at which it is said to be in two places.
    twice_s: Option<f64>,
}

impl Frame {
    /// Whether it is said once for all, as a sensor's place on a robot is.
    fn is_static(&self) -> bool {
        self.samples.len() == 1
    }

    /// The pose in the parent; of one that moves none before the first sample and after the last.
    fn at(&self, time_s: f64) -> Option<Isometry3<f64>> {
        if self.is_still {
            return self.samples.first().map(|(_, pose)| *pose);
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
pub(super) fn read(
    path: &Path,
    wanted: &[String],
    budget: &mut Budget,
) -> anyhow::Result<Recording> {
    let (frames, places) = frames(path)?;
    let shown = path.display();
    let is_unit = |frame: &Frame| match wanted {
        [] => !frame.is_static(),
        names => names.contains(&frame.name),
    };
    // When something that never moves is where it is: whenever the moving frame with the most poses was seen.
    let moving = frames.iter().max_by_key(|frame| (!frame.is_still, frame.samples.len()));
    let instants: Vec<f64> =
        moving.map_or(Vec::new(), |frame| frame.samples.iter().map(|(time, _)| *time).collect());
    let (mut units, mut worlds) = (Vec::new(), BTreeMap::new());
    for frame in frames.iter().filter(|frame| is_unit(frame)) {
        let mut track = Track::new(frame.name.clone(), None);
        let own = frame.samples.iter().map(|(time, _)| *time).collect();
        let (mut added, mut unknown) = (0, Vec::new());
        for time_s in if frame.is_still { instants.clone() } else { own } {
            let (world, pose) = in_world(path, &frames, &places, frame, time_s)?;
            worlds.entry(world).or_insert(&frame.name);
            let pose = match pose {
                Ok(pose) => pose,
                // Where a frame above is not known, the unit is not either.
                Err(above) => {
                    unknown.push(above);
                    continue;
                }
            };
            counted(path, budget, tracks::SAMPLE_BYTES)?;
            let (v, q) = (pose.translation.vector, pose.rotation);
            track
                .add(&format!("at {time_s:.6} s"), time_s, [v.x, v.y, v.z, q.w, q.i, q.j, q.k])
                .map_err(|text| anyhow::anyhow!("{shown}: {text}"))?;
            added += 1;
        }
        if let Some(above) = unknown.first() {
            let (count, name) = (unknown.len(), &frame.name);
            if added == 0 {
                anyhow::bail!(
                    "{shown}: unit {name}: at none of its {count} instants are all frames between it and the world known; record the transforms of {above} over the same time"
                );
            }
            output::note(&format!(
                "{shown}: unit {name}: {count} of {} poses are left out, at which a frame above it is not known ({above})",
                count + added
            ));
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
    if units.is_empty() {
        if !wanted.is_empty() {
            return Err(none_wanted(path, frames.iter().map(|frame| frame.name.as_str())));
        }
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
            frames.push(Frame {
                name,
                parent,
                samples: Vec::new(),
                is_still: false,
                twice_s: None,
            });
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
        frame.samples.push((sample.time_s, sample.pose));
    }
    for frame in &mut frames {
        frame.samples.sort_by(|a, b| a.0.total_cmp(&b.0));
        // What is said twice; what never moves is said again and again.
        frame.samples.dedup();
        let Some((start, first)) = frame.samples.first().copied() else { continue };
        frame.is_still = frame.samples.iter().all(|(_, pose)| *pose == first);
        if frame.is_still && start < 0.0 {
            frame.samples.truncate(1);
        }
        let mut pairs = frame.samples.iter().zip(frame.samples.iter().skip(1));
        frame.twice_s = pairs.find(|((a, _), (b, _))| a == b).map(|((time_s, _), _)| *time_s);
    }
    Ok((frames, places))
}

/// The frame that hangs in none, and the pose in it; or the first frame between that is not known at that time.
fn in_world<'f>(
    path: &Path,
    frames: &'f [Frame],
    places: &HashMap<String, usize>,
    unit: &'f Frame,
    time_s: f64,
) -> anyhow::Result<(&'f str, Result<Isometry3<f64>, &'f str>)> {
    let (mut pose, mut frame) = (Ok(Isometry3::identity()), unit);
    for _ in 0..MOST_LINKS {
        if let Some(twice_s) = frame.twice_s {
            anyhow::bail!(
                "{}: frame {} has two poses at {twice_s:.6} s; two publishers say where it is, or stamps are 0; record one of them, with stamps",
                path.display(),
                frame.name
            );
        }
        pose = pose.and_then(|pose| Ok(frame.at(time_s).ok_or(frame.name.as_str())? * pose));
        let parent = places.get(&frame.parent).and_then(|place| frames.get(*place));
        let Some(parent) = parent else { return Ok((&frame.parent, pose)) };
        frame = parent;
    }
    anyhow::bail!(
        "{}: unit {} hangs in more than {MOST_LINKS} frames, or in itself; mend the tree of frames",
        path.display(),
        unit.name
    )
}
