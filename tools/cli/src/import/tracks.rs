//! Poses of a recording, checked and resampled to a constant rate.

use std::path::PathBuf;

use nalgebra::{Point3, Quaternion, UnitQuaternion, Vector3};
use rigidformer_evaluation::scenes::Velocity;
use rigidformer_runtime::core::Role;
use rigidformer_runtime::files::shown as one_line;
use rigidformer_runtime::memory::Budget;

/// A quaternion's length may be off by so much.
const LENGTH: f64 = 1e-3;
/// A sample that is so near to a frame, in intervals, is that frame: times are rounded to microseconds in text.
const SAME: f64 = 1e-3;
/// A rate so near to a whole number, relatively, is that number, for the same reason.
const WHOLE: f64 = 1e-4;
/// Intervals without a pose, at most, where nothing is said.
const USUAL_GAP: f64 = 5.0;
/// Bytes of a pose and its time, and of a gap while the median is found.
pub(super) const SAMPLE_BYTES: u64 = (size_of::<Pose>() + 2 * size_of::<f64>()) as u64;
/// Bytes of a resampled pose: twice in memory, and twice in the file as it is made and checked.
const FRAME_BYTES: u64 = (size_of::<Pose>() + 4 * 7 * size_of::<f32>()) as u64;
/// Frames of a scene, at least and at most.
const LEAST_FRAMES: usize = 3;
const MOST_FRAMES: f64 = 1e6;

/// A pose of a body frame in the world.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Pose {
    place: Vector3<f64>,
    /// w, x, y, z, of length 1.
    turn: [f64; 4],
}

/// The poses of one unit.
pub(super) struct Track {
    pub(super) name: String,
    pub(super) points: Option<Vec<Point3<f32>>>,
    times_s: Vec<f64>,
    poses: Vec<Pose>,
}

/// One file of poses.
pub(super) struct Recording {
    pub(super) path: PathBuf,
    pub(super) units: Vec<Track>,
    /// Where the file says so itself.
    pub(super) rate_hz: Option<f64>,
}

/// Poses (units, frames) at a constant rate.
pub(super) struct Resampled {
    pub(super) rate_hz: f64,
    pub(super) poses: Vec<Vec<Pose>>,
}

impl Pose {
    pub(super) fn numbers(&self) -> [f32; 7] {
        let [w, x, y, z] = self.turn;
        [self.place.x, self.place.y, self.place.z, w, x, y, z].map(|number| number as f32)
    }

    fn rotation(&self) -> UnitQuaternion<f64> {
        let [w, x, y, z] = self.turn;
        UnitQuaternion::new_unchecked(Quaternion::new(w, x, y, z))
    }

    fn towards(&self, other: &Pose, part: f64) -> Pose {
        let (from, to) = (self.rotation(), other.rotation());
        let turned = from.try_slerp(&to, part, 1e-9).unwrap_or(if part < 0.5 { from } else { to });
        let q = turned.into_inner();
        Pose { place: self.place.lerp(&other.place, part), turn: [q.w, q.i, q.j, q.k] }
    }

    fn flipped(self) -> Pose {
        Pose { turn: self.turn.map(|number| -number), ..self }
    }
}

impl Track {
    pub(super) fn new(name: String, points: Option<Vec<Point3<f32>>>) -> Self {
        Self { name, points, times_s: Vec::new(), poses: Vec::new() }
    }

    /// Adds x, y, z, qw, qx, qy, qz at a time. `place` says where in the file they are.
    pub(super) fn add(
        &mut self,
        place: &str,
        time_s: f64,
        numbers: [f64; 7],
    ) -> Result<(), String> {
        let name = || one_line(&self.name, 80);
        let columns = ["x", "y", "z", "qw", "qx", "qy", "qz"];
        let values = columns.iter().zip(numbers).chain([(&"time", time_s)]);
        for (column, number) in values {
            if !(number as f32).is_finite() {
                return Err(format!(
                    "{place}, {column}: {number} is not a finite number (unit {}); leave out frames in which the unit was not seen",
                    name()
                ));
            }
        }
        let [x, y, z, turn @ ..] = numbers;
        let length = turn.iter().map(|number| number * number).sum::<f64>().sqrt();
        if (length - 1.0).abs() > LENGTH {
            return Err(format!(
                "{place}: the quaternion of unit {} has length {length:.4}, not 1; give qw, qx, qy, qz in this order, normalised",
                name()
            ));
        }
        if let Some(before) = self.times_s.last().filter(|before| **before >= time_s) {
            return Err(format!(
                "{place}: time runs from {before} back to {time_s} s (unit {}); sort the rows by time, one pose a unit and instant",
                name()
            ));
        }
        // What is of length 1 already in f32 keeps its bits.
        let length = if (length - 1.0).abs() < 1e-6 { 1.0 } else { length };
        let pose = Pose { place: Vector3::new(x, y, z), turn: turn.map(|number| number / length) };
        // q and -q are one rotation; the file wants no jumps between them.
        let jumps = self.poses.last().is_some_and(|before| {
            before.turn.iter().zip(&pose.turn).map(|(a, b)| a * b).sum::<f64>() < 0.0
        });
        self.times_s.push(time_s);
        self.poses.push(if jumps { pose.flipped() } else { pose });
        Ok(())
    }

    fn at(&self, time_s: f64, interval_s: f64) -> Option<Pose> {
        let after = self.times_s.partition_point(|time| *time < time_s);
        let near = [after.checked_sub(1), Some(after)].into_iter().flatten().find(|sample| {
            let time = self.times_s.get(*sample);
            time.is_some_and(|time| (time - time_s).abs() < SAME * interval_s)
        });
        if let Some(sample) = near {
            return self.poses.get(sample).copied();
        }
        let before = after.checked_sub(1)?;
        let (from, to) = (self.poses.get(before)?, self.poses.get(after)?);
        let (start, end) = (self.times_s.get(before)?, self.times_s.get(after)?);
        Some(from.towards(to, (time_s - start) / (end - start)))
    }

    /// The median time between two poses.
    fn interval_s(&self) -> Option<f64> {
        let mut gaps: Vec<f64> = self.gaps().map(|(_, gap)| gap).collect();
        gaps.sort_by(f64::total_cmp);
        gaps.get(gaps.len() / 2).copied()
    }

    /// When each interval begins, and how long it is.
    fn gaps(&self) -> impl Iterator<Item = (f64, f64)> {
        self.times_s.iter().zip(self.times_s.iter().skip(1)).map(|(a, b)| (*a, b - a))
    }
}

/// Refuses what is too large for a file.
pub(super) fn fits(units: usize, longest: usize, budget: &Budget) -> anyhow::Result<()> {
    let room = (units as u64).saturating_mul(longest as u64).saturating_mul(FRAME_BYTES);
    budget.clone().take(room).map_err(|large| {
        anyhow::anyhow!(
            "{units} units of up to {longest} frames: {large}; a file gives all scenes as many frames as its longest has: cut the longest recording, import it apart, or allow more with --memory"
        )
    })
}

/// All units at a constant rate, over the time in which all of them are seen.
pub(super) fn resample(
    recording: &Recording,
    rate_hz: Option<f64>,
    gap_s: Option<f64>,
    budget: &Budget,
) -> anyhow::Result<Resampled> {
    let shown = recording.path.display();
    let (mut start, mut end, mut interval) = (f64::NEG_INFINITY, f64::INFINITY, f64::INFINITY);
    for track in &recording.units {
        let name = one_line(&track.name, 80);
        let (Some(first), Some(last), Some(own)) =
            (track.times_s.first(), track.times_s.last(), track.interval_s())
        else {
            anyhow::bail!("{shown}: unit {name} has a single pose; give at least {LEAST_FRAMES}");
        };
        let most = gap_s.unwrap_or(USUAL_GAP * own);
        if let Some((from, gap)) = track.gaps().find(|(_, gap)| *gap > most) {
            anyhow::bail!(
                "{shown}: unit {name} has a gap of {gap:.4} s at {from} s, longer than {most:.4} s; cut the recording there into two files, or allow it with --gap {gap:.4}"
            );
        }
        (start, end, interval) = (start.max(*first), end.min(*last), interval.min(own));
    }
    let rate_hz = rate_hz.or(recording.rate_hz).unwrap_or_else(|| {
        let (rate, whole) = (1.0 / interval, (1.0 / interval).round());
        if (rate - whole).abs() < WHOLE * rate { whole } else { rate }
    });
    let count = ((end - start) * rate_hz + SAME).floor();
    if count.is_nan() || count + 1.0 < LEAST_FRAMES as f64 {
        anyhow::bail!(
            "{shown}: its units are seen together for {:.4} s, which is fewer than {LEAST_FRAMES} frames at {rate_hz} Hz; give a longer recording or a higher --fps",
            (end - start).max(0.0)
        );
    }
    if count > MOST_FRAMES {
        anyhow::bail!(
            "{shown}: has {count} frames at {rate_hz} Hz, more than a million; give a lower --fps"
        );
    }
    let frames = count as usize + 1;
    // Before there are any: a rate that was mistyped may ask for more than the memory.
    fits(recording.units.len(), frames, budget)?;
    let poses = recording.units.iter().map(|track| {
        let pose = |frame: usize| {
            let time_s = (start + frame as f64 / rate_hz).min(end);
            track.at(time_s, 1.0 / rate_hz).or(track.poses.last().copied())
        };
        (0..frames).filter_map(pose).collect()
    });
    Ok(Resampled { rate_hz, poses: poses.collect() })
}

/// Velocity at frame 0. The way to frame 1 is that of half a frame later, so a free unit has half a frame of gravity less.
pub(super) fn velocity(
    poses: &[Pose],
    rate_hz: f64,
    gravity_m_s2: Vector3<f32>,
    role: Role,
) -> Velocity {
    let [first, second, ..] = poses else { return Velocity::default() };
    if role == Role::Fixed {
        return Velocity::default();
    }
    let fall = match role {
        Role::Free => gravity_m_s2.cast::<f64>() / (2.0 * rate_hz),
        _ => Vector3::zeros(),
    };
    let linear = (second.place - first.place) * rate_hz - fall;
    let angular = (second.rotation() * first.rotation().inverse()).scaled_axis() * rate_hz;
    Velocity { linear_m_s: linear.cast(), angular_rad_s: angular.cast() }
}
