//! Observed poses, and the segments of motion that are cut from them.

use std::collections::VecDeque;

use nalgebra::{Isometry3, Matrix6, Translation3, UnitQuaternion, Vector3};

use super::settings::{IdentifyError, PoseNoise};

/// Steps of a segment, at least.
// Fewer say little of velocities.
const MIN_STEPS: usize = 8;
/// Steps of a segment, at most.
// Small errors of the start grow over a longer one.
const MAX_STEPS: usize = 28;
/// Longest time between two frames of a segment, in median intervals.
// Two frames may be lost before interpolation is worthless.
const MAX_GAP: f64 = 2.5;
/// Difference of times, in intervals, up to which a frame counts as that of a step.
// Interpolation would add an error where timestamps have jitter alone.
const TIME_TOLERANCE: f64 = 0.02;
/// Change of velocity over a step that counts as an impact, in gravity's.
const MIN_VELOCITY_JUMP: f64 = 4.0;
/// Impacts in a segment, at most; adjacent ones count once.
// Each impact multiplies the errors of the start.
const MAX_IMPACTS: usize = 1;
/// Steps from an impact beyond which more distance is no better.
// A segment is best cut where no contact is near: its start is then known best.
const FAR_STEPS: usize = 6;

/// An observed pose of a unit.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ObservedPose {
    /// Carries its points to the world.
    pub pose: Isometry3<f32>,
    /// Its noise; `None`: as in the settings, or as estimated from the poses.
    pub noise: Option<PoseNoise>,
}

impl From<Isometry3<f32>> for ObservedPose {
    fn from(pose: Isometry3<f32>) -> Self {
        ObservedPose { pose, noise: None }
    }
}

impl ObservedPose {
    /// A pose whose translation in metres, then rotation in radians have this covariance, such as a tracker's: the noise is the root
    /// mean square of the deviations along the three axes.
    pub fn uncertain(pose: Isometry3<f32>, covariance: &Matrix6<f32>) -> Self {
        let mean = |first: usize| {
            let trace: f32 = (first..first + 3).map(|i| covariance[(i, i)].max(0.0)).sum();
            (trace / 3.0).sqrt()
        };
        let noise = PoseNoise { position_m: mean(0), rotation_rad: mean(3) };
        ObservedPose { pose, noise: Some(noise) }
    }
}

/// A pose at the time of a step.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Sample {
    pub(crate) pose: Isometry3<f32>,
    pub(crate) noise: PoseNoise,
}

/// A segment of motion in even steps.
#[derive(Clone, Debug)]
pub(crate) struct Segment {
    /// Time of its first step, seconds.
    pub(crate) start_s: f64,
    pub(crate) dt_s: f32,
    pub(crate) steps: usize,
    /// (steps + 1, units); none where a unit is not observed.
    pub(crate) samples: Vec<Option<Sample>>,
}

impl Segment {
    /// Appends the next segment, if it begins where this one ends and both have at most `most` steps. Whether it did.
    pub(crate) fn join(&mut self, next: &Segment, most: usize) -> bool {
        let dt = f64::from(self.dt_s);
        let away = next.start_s - (self.start_s + self.steps as f64 * dt);
        let units = self.samples.len() / (self.steps + 1);
        if (f64::from(next.dt_s) / dt - 1.0).abs() > TIME_TOLERANCE / 2.0
            // Steps of the joined segment must stay even: uneven ones would show as changes of velocity.
            || away.abs() > dt / 4.0
            || self.steps + next.steps > most
        {
            return false;
        }
        self.samples.extend(next.samples.iter().skip(units));
        self.steps += next.steps;
        true
    }
}

/// The poses of a recording, or the latest of them.
pub(crate) struct Track {
    /// (units) Whether its poses count for noise and impacts.
    free: Vec<bool>,
    gravity: f64,
    last_s: f64,
    frames: VecDeque<(f64, Vec<Option<ObservedPose>>)>,
}

impl Track {
    pub(crate) fn new(free: Vec<bool>, gravity_m_s2: f64) -> Self {
        Track { free, gravity: gravity_m_s2, last_s: f64::NAN, frames: VecDeque::new() }
    }

    /// Takes the poses of a time, one entry for each unit.
    pub(crate) fn push(
        &mut self,
        time_s: f64,
        poses: &[Option<ObservedPose>],
    ) -> Result<(), IdentifyError> {
        if poses.len() != self.free.len() {
            return Err(IdentifyError::Poses { units: self.free.len(), given: poses.len() });
        }
        // NaN is not above the last time either, which the first condition catches.
        if !time_s.is_finite() || time_s <= self.last_s {
            return Err(IdentifyError::Time { time_s, last_s: self.last_s });
        }
        let is_sound = |observed: &ObservedPose| {
            let (position, turn) =
                (observed.pose.translation.vector, observed.pose.rotation.coords);
            position.iter().all(|v| v.is_finite() && v.abs() < 1e6)
                && turn.iter().all(|v| v.is_finite())
                && observed.noise.is_none_or(|noise| noise.is_sound())
        };
        let unsound = |(unit, observed): (usize, &Option<ObservedPose>)| {
            observed.as_ref().filter(|observed| !is_sound(observed)).map(|_| unit)
        };
        if let Some(unit) = poses.iter().enumerate().find_map(unsound) {
            return Err(IdentifyError::Pose { unit });
        }
        self.last_s = time_s;
        self.frames.push_back((time_s, poses.to_vec()));
        Ok(())
    }

    /// Whether there may be another segment: a cheap test before a search.
    pub(crate) fn is_ready(&self, finished: bool) -> bool {
        finished || self.frames.len() > MIN_STEPS
    }

    /// Median time between frames, seconds.
    fn interval_s(&self) -> Option<f64> {
        let mut gaps: Vec<f64> =
            self.frames.iter().zip(self.frames.iter().skip(1)).map(|(a, b)| b.0 - a.0).collect();
        median(&mut gaps)
    }

    /// Noise of the poses: third differences of white noise have sqrt(20) times its deviation, and those of smooth motion almost none.
    pub(crate) fn noise(&self) -> PoseNoise {
        // Without two frames there is nothing to estimate from.
        let Some(interval) = self.interval_s() else {
            return PoseNoise { position_m: 0.0, rotation_rad: 0.0 };
        };
        let (mut position_differences, mut rotation_differences) = (Vec::new(), Vec::new());
        let frames: Vec<_> = self.frames.iter().collect();
        for four in frames.windows(4) {
            // Differences of uneven intervals are not those of noise alone.
            let even = four.windows(2).all(|two| match two {
                [a, b] => ((b.0 - a.0) / interval - 1.0).abs() < 0.1,
                _ => false,
            });
            for unit in (0..self.free.len()).filter(|unit| even && self.free[*unit]) {
                let pose_at = |at: usize| Some(four.get(at)?.1.get(unit)?.as_ref()?.pose);
                let (Some(a), Some(b), Some(c), Some(d)) =
                    (pose_at(0), pose_at(1), pose_at(2), pose_at(3))
                else {
                    continue;
                };
                let at = |pose: &Isometry3<f32>| pose.translation.vector.cast::<f64>();
                let third = (at(&d) - at(&a)) + (at(&b) - at(&c)) * 3.0;
                position_differences.extend(third.iter().map(|v| v.abs()));
                let [r, s, t] = [(a, b), (b, c), (c, d)].map(|(a, b)| turn_between(&a, &b));
                rotation_differences.extend((r - s * 2.0 + t).iter().map(|v| v.abs()));
            }
        }
        let deviation = |all: &mut Vec<f64>| {
            // .6745 deviations are the median of absolute values; a median ignores impacts.
            (median(all).unwrap_or_default() / (0.6745 * 20.0_f64.sqrt())) as f32
        };
        PoseNoise {
            position_m: deviation(&mut position_differences),
            rotation_rad: deviation(&mut rotation_differences),
        }
    }

    /// Cuts the next segment off the front, in steps of about `step_s`, from the end of the last one. None until there are enough frames; with
    /// `finished` the rest is the last segment, if it is long enough.
    pub(crate) fn cut(&mut self, step_s: f64, noise: PoseNoise, finished: bool) -> Option<Segment> {
        let interval = self.interval_s()?;
        // Whole numbers of frames, so that steps coincide with frames and need no interpolation.
        let stride = (step_s / interval).round().max(1.0);
        let dt = stride * interval;
        loop {
            let start = self.frames.front()?.0;
            // Up to the first gap, or the end.
            let whole = self.frames.iter().zip(self.frames.iter().skip(1));
            let unbroken = whole.take_while(|(a, b)| b.0 - a.0 <= MAX_GAP * interval).count();
            let is_broken = unbroken + 1 < self.frames.len();
            let end = self.frames.get(unbroken)?.0;
            let steps = ((end - start) / dt + TIME_TOLERANCE) as usize;
            // More frames may come, and a segment that is cut now would leave too few for the next.
            if steps < MAX_STEPS + MIN_STEPS && !is_broken && !finished {
                return None;
            }
            // Too short a rest says little of velocities, and is dropped.
            if steps < MIN_STEPS {
                self.frames.drain(..=unbroken);
                continue;
            }
            let samples = |steps: usize| -> Vec<Option<Sample>> {
                let times = (0..=steps).map(|step| start + step as f64 * dt);
                times.flat_map(|time| self.samples_at(time, interval, noise)).collect()
            };
            let all = samples(steps.min(MAX_STEPS));
            let taken = self.segment_end(&all, steps, dt);
            let segment = Segment {
                start_s: start,
                dt_s: dt as f32,
                steps: taken,
                samples: all.into_iter().take((taken + 1) * self.free.len()).collect(),
            };
            // The last pose of a segment is the first one of the next.
            let until = start + (taken as f64 - TIME_TOLERANCE) * dt;
            let passed = self.frames.iter().take_while(|(time, _)| *time < until).count();
            let rest = passed.max(1);
            self.frames.drain(..rest.min(self.frames.len()));
            return Some(segment);
        }
    }

    /// Steps after which a segment ends best: far from any impact, and late.
    fn segment_end(&self, samples: &[Option<Sample>], steps: usize, dt: f64) -> usize {
        let units = self.free.len();
        let position = |step: usize, unit: usize| {
            let sample = samples.get(step * units + unit)?.as_ref()?;
            Some((sample.pose.translation.vector.cast::<f64>(), f64::from(sample.noise.position_m)))
        };
        let has_jump = |step: usize| {
            (0..units).filter(|unit| self.free[*unit]).any(|unit| {
                // A second difference needs poses on both sides.
                let Some(before) = step.checked_sub(1).and_then(|step| position(step, unit)) else {
                    return false;
                };
                let (Some(here), Some(after)) = (position(step, unit), position(step + 1, unit))
                else {
                    return false;
                };
                // Eight deviations: the second difference of noise has sqrt(6) of them, and a false impact cuts a segment.
                let bend = (after.0 - here.0 * 2.0 + before.0).norm();
                bend > MIN_VELOCITY_JUMP * self.gravity * dt * dt + 8.0 * here.1
            })
        };
        let jumps: Vec<usize> = (0..MAX_STEPS.min(steps)).filter(|step| has_jump(*step)).collect();
        // The whole rest, if it is short enough.
        if steps <= MAX_STEPS && events(&jumps).count() <= MAX_IMPACTS {
            return steps;
        }
        let far = |step: usize| {
            let nearest = jumps.iter().map(|jump| jump.abs_diff(step)).min();
            nearest.unwrap_or(FAR_STEPS).min(FAR_STEPS)
        };
        // Errors grow from impact to impact. The rest must suffice for another segment.
        let next = events(&jumps).nth(MAX_IMPACTS).unwrap_or(MAX_STEPS);
        let last = MAX_STEPS.min(next).min(steps.saturating_sub(MIN_STEPS)).max(MIN_STEPS);
        (MIN_STEPS..=last).max_by_key(|step| (far(*step), *step)).unwrap_or(last)
    }

    /// (units) Poses at a time, interpolated between frames.
    fn samples_at(&self, time: f64, interval: f64, noise: PoseNoise) -> Vec<Option<Sample>> {
        let after = self.frames.partition_point(|(at, _)| *at < time);
        let near = [after.checked_sub(1), Some(after)].into_iter().flatten().find(|index| {
            let frame = self.frames.get(*index);
            frame.is_some_and(|(at, _)| (at - time).abs() <= TIME_TOLERANCE * interval)
        });
        let sample = |observed: ObservedPose| Sample {
            pose: observed.pose,
            noise: observed.noise.unwrap_or(noise),
        };
        let observed = |index: usize, unit: usize| *self.frames.get(index)?.1.get(unit)?;
        if let Some(index) = near {
            return (0..self.free.len()).map(|unit| observed(index, unit).map(sample)).collect();
        }
        let between = |unit: usize| {
            let before = after.checked_sub(1)?;
            let (start, end) = (self.frames.get(before)?.0, self.frames.get(after)?.0);
            // Over a longer gap an impact may be missed.
            if end - start > MAX_GAP * interval {
                return None;
            }
            let fraction = (time - start) / (end - start);
            let (a, b) = (sample(observed(before, unit)?), sample(observed(after, unit)?));
            let share = fraction as f32;
            let position = a.pose.translation.vector.lerp(&b.pose.translation.vector, share);
            let turn = turn_between(&a.pose, &b.pose);
            let rotation =
                UnitQuaternion::from_scaled_axis((turn * fraction).cast::<f32>()) * a.pose.rotation;
            // Linear interpolation of a curved path is off by up to an eighth of its second difference.
            let bend = |middle: usize| {
                let [one, two, three] =
                    [middle.checked_sub(1)?, middle, middle + 1].map(|at| observed(at, unit));
                let (one, two, three) = (one?.pose, two?.pose, three?.pose);
                let position = one.translation.vector - two.translation.vector * 2.0
                    + three.translation.vector;
                let turn = turn_between(&two, &three) - turn_between(&one, &two);
                Some([f64::from(position.norm()), turn.norm()])
            };
            let bends = [bend(before), bend(after)].into_iter().flatten();
            let [far, turned] =
                bends.fold([0.0_f64; 2], |most, bend| [most[0].max(bend[0]), most[1].max(bend[1])]);
            let unsure = |noise: f32, bend: f64| {
                noise.hypot((bend * 0.5 * fraction * (1.0 - fraction)) as f32)
            };
            let noise = PoseNoise {
                position_m: unsure(a.noise.position_m.max(b.noise.position_m), far),
                rotation_rad: unsure(a.noise.rotation_rad.max(b.noise.rotation_rad), turned),
            };
            let pose = Isometry3::from_parts(Translation3::from(position), rotation);
            Some(Sample { pose, noise })
        };
        (0..self.free.len()).map(between).collect()
    }
}

/// The rotation from one pose to the other, in the world's axes, radians.
pub(crate) fn turn_between(from: &Isometry3<f32>, to: &Isometry3<f32>) -> Vector3<f64> {
    let turn = to.rotation.cast::<f64>() * from.rotation.cast::<f64>().inverse();
    // q and -q are one rotation: the shorter one counts. `scaled_axis` loses small angles to rounding.
    let (w, v) = (turn.w, turn.imag());
    let (w, v) = if w < 0.0 { (-w, -v) } else { (w, v) };
    let sin = v.norm();
    if sin < 1e-9 { v * 2.0 } else { v * (2.0 * sin.atan2(w) / sin) }
}

/// Steps at which impacts begin.
fn events(jumps: &[usize]) -> impl Iterator<Item = usize> {
    let before = std::iter::once(None).chain(jumps.iter().map(|jump| Some(*jump)));
    let pairs = before.zip(jumps.iter().copied());
    pairs
        // An impact within a step changes two second differences, so adjacent jumps are one.
        .filter(|(before, jump)| before.is_none_or(|before| jump - before > 2))
        .map(|(_, jump)| jump)
}

fn median(values: &mut [f64]) -> Option<f64> {
    let middle = values.len() / 2;
    if values.is_empty() {
        return None;
    }
    let (_, value, _) = values.select_nth_unstable_by(middle, f64::total_cmp);
    Some(*value)
}

#[cfg(test)]
mod tests {
    use super::*;
    use rigidformer_runtime::noise::Noise;

    fn still(x: f32) -> Vec<Option<ObservedPose>> {
        vec![Some(Isometry3::translation(x, 0.0, 1.0).into())]
    }

    fn flight(frames: usize, rate_hz: f64, noise_m: f32) -> Track {
        let mut track = Track::new(vec![true], 9.81);
        let mut noise = Noise::new(1, 0);
        for frame in 0..frames {
            let t = frame as f64 / rate_hz;
            let z = (1.0 + 3.0 * t - 4.905 * t * t) as f32;
            let mut off = || noise_m * noise.normal();
            let position = Vector3::new(off() + t as f32, off(), off() + z);
            let turn = Vector3::new(off() * 10.0, off() * 10.0, off() * 10.0 + 4.0 * t as f32);
            let pose = Isometry3::new(position, turn);
            track.push(t, &[Some(pose.into())]).unwrap();
        }
        track
    }

    #[test]
    fn noise_is_separated_from_motion() {
        let noise = flight(200, 240.0, 5e-4).noise();
        assert!((noise.position_m / 5e-4 - 1.0).abs() < 0.15, "{noise:?}");
        assert!((noise.rotation_rad / 5e-3 - 1.0).abs() < 0.2, "{noise:?}");
        let exact = flight(200, 240.0, 0.0).noise();
        assert!(exact.position_m < 1e-6 && exact.rotation_rad < 1e-5, "{exact:?}");
    }

    #[test]
    fn segments_follow_each_other() {
        let mut track = flight(240, 240.0, 0.0);
        let noise = track.noise();
        let (mut segments, mut steps) = (0, 0);
        while let Some(segment) = track.cut(1.0 / 75.0, noise, true) {
            assert!((MIN_STEPS..=MAX_STEPS).contains(&segment.steps));
            assert_eq!(segment.samples.len(), segment.steps + 1);
            assert!((segment.dt_s - 3.0 / 240.0).abs() < 1e-6);
            let first = segment.samples[0].unwrap().pose.translation.x;
            assert!((first - (steps * 3) as f32 / 240.0).abs() < 1e-5, "{first}");
            (segments, steps) = (segments + 1, steps + segment.steps);
        }
        assert!(segments >= 3 && steps >= 70, "{segments} {steps}");
    }

    #[test]
    fn a_gap_ends_a_segment_and_odd_times_are_less_sure() {
        let mut track = Track::new(vec![true], 9.81);
        for frame in 0..40 {
            let late = if frame > 20 { 1.0 } else { 0.0 };
            track.push(f64::from(frame) / 30.0 + late, &still(0.1)).unwrap();
        }
        let noise = PoseNoise { position_m: 1e-3, rotation_rad: 1e-3 };
        let first = track.cut(1.0 / 75.0, noise, true).unwrap();
        assert_eq!(first.steps, 20);
        let second = track.cut(1.0 / 75.0, noise, true).unwrap();
        assert_eq!(second.steps, 18);
        assert!(track.cut(1.0 / 75.0, noise, true).is_none());

        let mut track = Track::new(vec![true], 9.81);
        for frame in 0..40 {
            let t = f64::from(frame) / 30.0 + if frame % 2 == 1 { 0.01 } else { 0.0 };
            track.push(t, &still((t * t) as f32)).unwrap();
        }
        let segment = track.cut(1.0 / 75.0, noise, true).unwrap();
        let unsure = segment.samples.iter().flatten().any(|s| s.noise.position_m > 1e-3);
        assert!(unsure);
    }

    #[test]
    fn what_cannot_be_is_refused() {
        let mut track = Track::new(vec![true], 9.81);
        track.push(0.0, &still(0.0)).unwrap();
        let refused = |track: &mut Track, time, poses: &[Option<ObservedPose>]| {
            track.push(time, poses).unwrap_err().to_string()
        };
        assert!(refused(&mut track, 0.0, &still(0.0)).contains("not after"));
        assert!(refused(&mut track, f64::NAN, &still(0.0)).contains("not after"));
        assert!(refused(&mut track, 1.0, &[]).contains("0 poses for 1 units"));
        assert!(refused(&mut track, 1.0, &still(f32::NAN)).contains("pose of unit 0"));
        assert_eq!(track.frames.len(), 1);
        assert!(track.cut(0.01, track.noise(), true).is_none());
    }
}
