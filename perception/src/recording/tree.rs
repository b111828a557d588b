//! Frames, and where they are in each other at any time.

use std::collections::{HashMap, VecDeque};
use std::sync::Arc;

use nalgebra::{Isometry3, Translation3, Vector3};

use super::error::CaptureProblem;

/// Frames that a file may have, and bytes of a frame's name, at most.
// They bound memory, whatever a file contains.
const MAX_FRAMES: usize = 1 << 16;
const MAX_NAME_BYTES: usize = 1024;
/// Poses of one frame, and of all, that are kept at once.
const MAX_OF_FRAME: usize = 1 << 12;
const MAX_OF_ALL: usize = 1 << 20;
/// Frames from a sensor to the world, at most.
// Transforms of a hostile file may form a cycle.
const MAX_LINKS: usize = 32;
/// A frame that moved, and has said nothing for this long, is told, nanoseconds.
const SILENT_NS: i128 = 1_000_000_000;

/// A frame's pose in its parent's frame at an instant.
#[derive(Clone, Debug)]
struct Sample {
    time: i128,
    parent: Arc<str>,
    pose: Isometry3<f64>,
}

#[derive(Debug, Default)]
struct Frame {
    /// Does not move: its one pose holds always.
    is_static: bool,
    /// Has had several poses.
    moves: bool,
    /// By time.
    samples: VecDeque<Sample>,
}

/// Where a frame is in the world.
#[derive(Debug)]
pub(super) struct Place {
    pub(super) pose: Isometry3<f64>,
    /// The topmost frame.
    pub(super) world: Arc<str>,
    /// A frame on the way whose transforms ended long before.
    pub(super) ended: Option<String>,
}

/// The known frames.
#[derive(Debug, Default)]
pub(super) struct Tree {
    frames: HashMap<String, Frame>,
    parents: HashMap<Arc<str>, ()>,
    samples: usize,
}

/// Names of frames are the same with and without the slash that ROS 1 wrote before them.
pub(super) fn plain(name: &str) -> &str {
    name.trim_start_matches('/')
}

impl Tree {
    pub(super) fn is_empty(&self) -> bool {
        self.frames.is_empty()
    }

    /// Whether a frame has a pose.
    pub(super) fn has(&self, name: &str) -> bool {
        self.frames.contains_key(plain(name))
    }

    /// Whether a frame is a child or a parent of another.
    pub(super) fn knows(&self, name: &str) -> bool {
        self.frames.contains_key(plain(name)) || self.parents.contains_key(plain(name))
    }

    /// Keeps a pose; one without a time holds always. A frame that stood still and moves, moves from then on.
    pub(super) fn add(
        &mut self,
        child: &str,
        parent: &str,
        time: Option<i128>,
        pose: Isometry3<f64>,
    ) -> Result<(), CaptureProblem> {
        let (child, parent) = (plain(child), plain(parent));
        let is_new = !self.frames.contains_key(child);
        let is_long = child.len() > MAX_NAME_BYTES || parent.len() > MAX_NAME_BYTES;
        if is_long || is_new && self.frames.len() >= MAX_FRAMES {
            return Err(CaptureProblem::TooManyFrames);
        }
        let parent = match self.parents.get_key_value(parent) {
            Some((known, ())) => known.clone(),
            None if self.parents.len() >= MAX_FRAMES => return Err(CaptureProblem::TooManyFrames),
            None => {
                let name: Arc<str> = parent.into();
                self.parents.insert(name.clone(), ());
                name
            }
        };
        if is_new {
            self.frames.insert(child.to_owned(), Frame::default());
        }
        let Some(frame) = self.frames.get_mut(child) else { return Ok(()) };
        let before = frame.samples.len();
        let sample = Sample { time: time.unwrap_or(0), parent, pose };
        if time.is_none() != frame.is_static || time.is_none() {
            frame.samples.clear();
            frame.is_static = time.is_none();
        }
        frame.keep(sample);
        let after = frame.samples.len();
        self.samples = (self.samples + after).saturating_sub(before);
        if self.samples > MAX_OF_ALL {
            self.thin();
        }
        Ok(())
    }

    /// Keeps the last two poses of each frame.
    fn thin(&mut self) {
        for frame in self.frames.values_mut() {
            let more = frame.samples.len().saturating_sub(2);
            frame.samples.drain(..more);
        }
        self.samples = self.frames.values().map(|frame| frame.samples.len()).sum();
    }

    /// Forgets what is of no use for times from this one on, of one frame.
    pub(super) fn forget(&mut self, child: &str, before: i128) {
        let Some(frame) = self.frames.get_mut(plain(child)) else { return };
        while frame.samples.get(1).is_some_and(|second| second.time <= before) {
            frame.samples.pop_front();
            self.samples = self.samples.saturating_sub(1);
        }
    }

    /// Carries a frame to the one that has no parent; none where nothing is known of it.
    pub(super) fn place(&self, name: &str, time: i128) -> Option<Place> {
        let mut pose = Isometry3::identity();
        let (mut world, mut ended) = (None, None);
        let mut at: Arc<str> = plain(name).into();
        for _ in 0..MAX_LINKS {
            let Some(frame) = self.frames.get(&*at) else { break };
            let Some((parent, own)) = frame.pose(time) else { break };
            if frame.is_silent(time) {
                ended = Some(at.to_string());
            }
            pose = own * pose;
            at = parent.clone();
            world = Some(parent);
        }
        world.map(|world| Place { pose, world, ended })
    }
}

impl Frame {
    /// In the order of times; one of the same time replaces the other.
    fn keep(&mut self, sample: Sample) {
        let at = self.samples.partition_point(|known| known.time < sample.time);
        match self.samples.get_mut(at) {
            Some(known) if known.time == sample.time => *known = sample,
            _ => {
                self.moves |= !self.samples.is_empty();
                self.samples.insert(at, sample);
            }
        }
        if self.samples.len() > MAX_OF_FRAME {
            self.samples.pop_front();
        }
    }

    /// Between two poses; the first one before its time, and the last one behind it.
    fn pose(&self, time: i128) -> Option<(Arc<str>, Isometry3<f64>)> {
        let after = self.samples.partition_point(|known| known.time <= time);
        let last = self.samples.get(after.saturating_sub(1))?;
        let next =
            self.samples.get(after).filter(|next| next.time > last.time && last.time <= time);
        let Some(next) = next.filter(|next| next.parent == last.parent) else {
            return Some((last.parent.clone(), last.pose));
        };
        let share = (time - last.time) as f64 / (next.time - last.time) as f64;
        Some((last.parent.clone(), between(&last.pose, &next.pose, share)))
    }

    fn is_silent(&self, time: i128) -> bool {
        let last = self.samples.back();
        self.moves
            && !self.is_static
            && last.is_some_and(|last| time.saturating_sub(last.time) > SILENT_NS)
    }
}

/// Straight for the place, and by the shortest turn.
fn between(one: &Isometry3<f64>, other: &Isometry3<f64>, share: f64) -> Isometry3<f64> {
    let place: Vector3<f64> = one.translation.vector.lerp(&other.translation.vector, share);
    // Opposite turns have no shortest way: the nearer one holds.
    let turn = one.rotation.try_slerp(&other.rotation, share, 1e-9);
    let nearer = if share < 0.5 { one.rotation } else { other.rotation };
    Isometry3::from_parts(Translation3::from(place), turn.unwrap_or(nearer))
}

#[cfg(test)]
mod tests {
    use nalgebra::{Point3, UnitQuaternion};

    use super::*;

    const SECOND: i128 = 1_000_000_000;

    fn at(x: f64, angle: f64) -> Isometry3<f64> {
        Isometry3::from_parts(
            Translation3::new(x, 0.0, 0.0),
            UnitQuaternion::from_axis_angle(&Vector3::z_axis(), angle),
        )
    }

    #[test]
    fn poses_between_two_times_are_between_two_poses() {
        let mut tree = Tree::default();
        tree.add("base", "map", Some(0), at(0.0, 0.0)).unwrap();
        tree.add("base", "map", Some(SECOND), at(2.0, 1.0)).unwrap();
        tree.add("/lidar", "/base", None, at(1.0, 0.0)).unwrap();
        for (time, x, angle) in [
            (-5 * SECOND, 0.0, 0.0),
            (0, 0.0, 0.0),
            (SECOND / 4, 0.5, 0.25),
            (SECOND / 2, 1.0, 0.5),
            (SECOND, 2.0, 1.0),
            (9 * SECOND, 2.0, 1.0),
        ] {
            let place = tree.place("lidar", time).unwrap();
            let origin = place.pose * Point3::origin();
            let wanted = Point3::new(x + f64::cos(angle), f64::sin(angle), 0.0);
            assert!((origin - wanted).norm() < 1e-12, "{time}: {origin}");
            assert_eq!((&*place.world, place.ended.is_some()), ("map", time > 2 * SECOND));
        }
        assert_eq!(tree.place("base", i128::MIN).unwrap().pose.translation.x, 0.0);
        assert!(tree.place("map", 0).is_none() && tree.knows("/map") && !tree.knows("odom"));
    }

    #[test]
    fn any_order_gives_the_same_places_and_cycles_end() {
        let mut tree = Tree::default();
        for time in [3, 1, 4, 0, 2, 2] {
            tree.add("base", "map", Some(time * SECOND), at(time as f64, 0.0)).unwrap();
        }
        for tenths in 0..40 {
            let place = tree.place("base", tenths * SECOND / 10).unwrap();
            assert!((place.pose.translation.x - tenths as f64 / 10.0).abs() < 1e-12);
        }
        tree.forget("base", 3 * SECOND);
        assert!(
            (tree.place("base", 7 * SECOND / 2).unwrap().pose.translation.x - 3.5).abs() < 1e-12
        );
        tree.add("map", "base", Some(0), at(0.0, 0.0)).unwrap();
        assert!(tree.place("base", 0).is_some());
    }

    #[test]
    fn memory_does_not_grow_with_time() {
        let mut tree = Tree::default();
        for step in 0..100_000_i128 {
            tree.add("base", "map", Some(step * SECOND / 1000), at(step as f64, 0.0)).unwrap();
        }
        assert!(tree.samples <= MAX_OF_FRAME);
        let place = tree.place("base", 99_999 * SECOND / 1000).unwrap();
        assert_eq!(place.pose.translation.x, 99_999.0, "it does not stand still");
        for frame in 0..3000 {
            for step in 0..500 {
                tree.add(&format!("f{frame}"), "map", Some(step), at(0.0, 0.0)).unwrap();
            }
        }
        assert!(tree.samples <= MAX_OF_ALL);
    }
}
