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
/// Steps between two poses, the longest ones elsewhere, that a lost frame at the origin is off at least; and what counts as a step.
const LOST_STEPS: f64 = 5.0;
const LEAST_STEP_M: f64 = 2e-3;
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
    /// What is wrong with the order of its times, and how often.
    disorder: Option<(String, usize)>,
}

/// What becomes of rows that are not later than those before.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Repeats {
    Error,
    KeepFirst,
    KeepLast,
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
        Self { name, points, times_s: Vec::new(), poses: Vec::new(), disorder: None }
    }

    pub(super) fn name(&self) -> &str {
        &self.name
    }

    pub(super) fn is_empty(&self) -> bool {
        self.poses.is_empty()
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
            let (first, count) = self.disorder.take().unwrap_or_else(|| {
                let text = format!(
                    "{place}: time runs from {before} back to {time_s} s (unit {}); sort the rows by time, one pose a unit and instant, or give --repeats keep-first",
                    one_line(&self.name, 80)
                );
                (text, 0)
            });
            self.disorder = Some((first, count + 1));
        }
        // What is of length 1 already in f32 keeps its bits.
        let length = if (length - 1.0).abs() < 1e-6 { 1.0 } else { length };
        let pose = Pose { place: Vector3::new(x, y, z), turn: turn.map(|number| number / length) };
        self.times_s.push(time_s);
        self.poses.push(pose);
        Ok(())
    }

    /// Puts the poses in the order of their times, one an instant. What was out of order is an error, or is counted.
    pub(super) fn order(&mut self, repeats: Repeats) -> Result<usize, String> {
        let Some((first, count)) = self.disorder.take() else { return Ok(0) };
        let mut order: Vec<usize> = (0..self.poses.len()).collect();
        let time = |place: &usize| self.times_s.get(*place).copied().unwrap_or_default();
        match repeats {
            Repeats::Error => return Err(first),
            // Stable sorts: of equal times the first in the order stays.
            Repeats::KeepFirst => {}
            Repeats::KeepLast => order.reverse(),
        }
        order.sort_by(|a, b| time(a).total_cmp(&time(b)));
        order.dedup_by(|next, kept| time(next) <= time(kept));
        self.times_s = order.iter().map(time).collect();
        self.poses = order.iter().filter_map(|place| self.poses.get(*place).copied()).collect();
        Ok(count)
    }

    /// Takes out frames in which the unit was lost: runs of poses at the origin without a turn, which no pose before or after is near.
    /// How many they are, and how far off.
    pub(super) fn drop_lost(&mut self) -> Option<(usize, f64)> {
        let origin = Pose { place: Vector3::zeros(), turn: [1.0, 0.0, 0.0, 0.0] };
        let is_origin = |pose: &Pose| *pose == origin || *pose == origin.flipped();
        let steps = || self.poses.windows(2).filter_map(|pair| Some((pair.first()?, pair.last()?)));
        let (mut usual, mut off) = (0.0_f64, f64::INFINITY);
        let mut moves = 0;
        for (a, b) in steps() {
            let length = (b.place - a.place).norm();
            match (is_origin(a), is_origin(b)) {
                (false, false) => (usual, moves) = (usual.max(length), moves + 1),
                (true, true) => {}
                _ => off = off.min(length),
            }
        }
        // Without two poses elsewhere nothing says how fast the unit is.
        if moves == 0 || !off.is_finite() || off < LOST_STEPS * usual.max(LEAST_STEP_M) {
            return None;
        }
        let keep: Vec<bool> = self.poses.iter().map(|pose| !is_origin(pose)).collect();
        let mut kept = keep.iter().copied();
        self.times_s.retain(|_| kept.next().unwrap_or(true));
        let mut kept = keep.iter().copied();
        self.poses.retain(|_| kept.next().unwrap_or(true));
        Some((keep.iter().filter(|keep| !**keep).count(), off))
    }

    /// Multiplies times, and lengths of poses and points; and turns a world with y up to one with z up.
    pub(super) fn convert(&mut self, time_scale: f64, scale: f64, is_y_up: bool) {
        self.times_s.iter_mut().for_each(|time| *time *= time_scale);
        let up = |[x, y, z]: [f64; 3]| if is_y_up { [x, 0.0 - z, y] } else { [x, y, z] };
        for pose in &mut self.poses {
            pose.place = Vector3::from(up((pose.place * scale).into()));
            let [w, x, y, z] = pose.turn;
            let [x, y, z] = up([x, y, z]);
            pose.turn = [w, x, y, z];
        }
        for point in self.points.iter_mut().flatten() {
            let scaled = point.coords.cast::<f64>() * scale;
            // A scale of 1 keeps the bits: f32 is exact in f64.
            *point = Point3::from(Vector3::from(up(scaled.into())).cast());
        }
    }

    /// Turns each rotation to the sign that is nearer to the one before: q and -q are one rotation, and the file wants no jumps between.
    pub(super) fn unflip(&mut self) {
        let mut before: Option<Pose> = None;
        for pose in &mut self.poses {
            let jumps = before.is_some_and(|before| {
                before.turn.iter().zip(&pose.turn).map(|(a, b)| a * b).sum::<f64>() < 0.0
            });
            *pose = if jumps { pose.flipped() } else { *pose };
            before = Some(*pose);
        }
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
