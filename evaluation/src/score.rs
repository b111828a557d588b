//! How far estimates are from the true scene.
//!
//! **Found.** A unit is *findable* in a capture that shows it with at least [`Settings::findable_pixels`] pixels. A track lies on the
//! unit that at least half of its points are on: each point, carried by the track's pose, counts for the unit whose surface is nearest,
//! if that is within [`Settings::near`] of the unit's radius. Surfaces are those of convex hulls, or of convex pieces where the unit
//! has them. Of several tracks on a unit, the one that held it last is its own, else the one with the lowest number that is no other
//! unit's. A unit is *found* where a track of its own lies on it.
//!
//! **Lost.** A findable unit without a track of its own is *swapped* where the track on it was another unit's, *merged* where at least
//! a tenth of another unit's track lies on it, else *lost*. A track that was seen and lies on no unit is *false*.
//!
//! **Errors.** A track's reference frame is not the unit's body frame. One alignment between the two is fixed for each pair of a track
//! and a unit, as the best over the captures in which the track was found to be the unit's and was seen: the mean of the unit's centre in
//! the track's frame, and the rotation nearest to the mean of the relative rotations. What is constant is no error. The error of a pose
//! is the motion of the body frame that is left. Pairs that were found in one capture alone have no errors: they would be 0.
//!
//! A ball shows no turn, and a body of revolution none about its axis: those do not count into the angle. Which shapes are so is
//! measured from the points. The surface distance is the same for all shapes: how far the unit's points are from its surface after the
//! motion that is left.
//!
//! ```
//! use std::sync::Arc;
//! use nalgebra::{Isometry3, Matrix6, Point3, Vector3, Vector6};
//! use rigidformer_core::Physics;
//! use rigidformer_perception::estimate::{Estimate, Rest, UnitEstimate, Visibility};
//! use rigidformer_evaluation::score::{Settings, score};
//! use rigidformer_evaluation::scenes::{RecordedScene, RecordedUnit, Split};
//!
//! // A cube that slides 1 cm a frame, and a track that is 1 mm too high in one of three captures.
//! let corner = |k: u8, bit: u8| if k & bit == 0 { -0.1 } else { 0.1 };
//! let points: Vec<Point3<f32>> = (0..8).map(|k| Point3::new(corner(k, 1), corner(k, 2), corner(k, 4))).collect();
//! let physics = Physics { mass_kg: 1.0, friction: 0.4, restitution: 0.3 };
//! let poses = (0..3).map(|frame| Isometry3::translation(0.01 * frame as f32, 0.0, 0.1)).collect();
//! let unit = RecordedUnit::new("cube", points.clone(), physics, poses);
//! let scene = RecordedScene::new("slide", 1, Split::Test, 10.0, Vector3::zeros(), vec![unit])?;
//!
//! let track = |frame: u8, height_m: f32| UnitEstimate {
//!     id: 7,
//!     pose: Isometry3::translation(0.01 * f32::from(frame), 0.0, height_m),
//!     covariance: Matrix6::zeros(),
//!     velocity: Vector6::zeros(),
//!     velocity_covariance: Matrix6::zeros(),
//!     points: Arc::from(points.clone()),
//!     visibility: Visibility::Seen,
//!     rest: Rest::Moving,
//! };
//! let estimate = |frame, height_m| Estimate { time_s: f64::from(frame) / 10.0, units: vec![track(frame, height_m)] };
//! let estimates = [estimate(0, 0.1), estimate(1, 0.101), estimate(2, 0.1)];
//! let score = score(&scene, &[], &estimates, &[], &Settings::default())?;
//! assert_eq!((score.found, score.findable), (3, 3));
//! // The mean of what is off is the alignment's.
//! assert!((score.seen.translation_m.max - 0.001 * 2.0 / 3.0).abs() < 1e-6);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod alignment;
mod owners;
mod report;
mod surface;
#[cfg(test)]
mod tests;

use std::collections::{BTreeMap, BTreeSet, HashMap};

use nalgebra::{Isometry3, Matrix3, Vector3};
use rigidformer_perception::estimate::{Estimate, UnitEstimate, Visibility};

use crate::scenes::RecordedScene;

use alignment::{Alignment, Pairs, PoseError};
use owners::{Owners, owners_of};
use surface::Surface;

pub use report::{
    Losses, PoseErrors, Prediction, PredictionScore, Score, ScoreError, Seen, Settings, Spread,
    UnitScore,
};

/// Times that differ by less than this are one, seconds.
// Stamps of one capture are rounded in several ways, and captures are many milliseconds apart.
const SAME_S: f64 = 1e-3;
/// Below it are 95 % of chi-squared of three degrees of freedom.
const CHI_SQUARED_95: f64 = 7.815;

/// Scores estimates, and predictions of the tracks' poses, against the scene that was seen. Times count from the scene's first frame;
/// what lies outside of the record is left out. `seen` has the captures whose pixels were counted, with rising times; in a capture
/// without counts every unit is findable. Soft units are not scored. A track's number stands for one unit in predictions: the one
/// that it was found on most often.
///
/// # Errors
/// [`ScoreError`] for settings out of range, times that do not rise, estimates that all lie outside of the record, and poses that are
/// not finite.
pub fn score(
    scene: &RecordedScene,
    seen: &[Seen],
    estimates: &[Estimate],
    predictions: &[Prediction],
    settings: &Settings,
) -> Result<Score, ScoreError> {
    check(seen, estimates, predictions, settings)?;
    let truth = Truth::new(scene);
    let mut run = Run::new(&truth, settings);
    let mut counts = seen.iter().peekable();
    for estimate in estimates {
        let Some(poses) = truth.poses_at(estimate.time_s) else { continue };
        // Both lists rise, so one pass over the counts is enough.
        while counts.next_if(|seen| seen.time_s < estimate.time_s - SAME_S).is_some() {}
        let of_now = counts.peek().filter(|seen| seen.time_s <= estimate.time_s + SAME_S);
        run.capture(estimate, &poses, of_now.map(|seen| seen.pixels.as_slice()));
    }
    // Most likely the two clocks start at different instants.
    if run.captures.is_empty() {
        return Err(ScoreError::NoneWithin { duration_s: scene.duration_s() });
    }
    Ok(run.score(predictions))
}

fn check(
    seen: &[Seen],
    estimates: &[Estimate],
    predictions: &[Prediction],
    settings: &Settings,
) -> Result<(), ScoreError> {
    if settings.findable_pixels == 0 {
        return Err(ScoreError::Settings { what: "findable_pixels must be at least 1" });
    }
    if !(settings.near > 0.0 && settings.near <= 1.0) {
        return Err(ScoreError::Settings { what: "near must be above 0 and at most 1" });
    }
    rising("estimates", estimates.iter().map(|estimate| estimate.time_s))?;
    rising("counts of pixels", seen.iter().map(|seen| seen.time_s))?;
    let of_tracks = estimates.iter().flat_map(|estimate| {
        estimate.units.iter().map(|track| (estimate.time_s, track.id, &track.pose))
    });
    let ahead = predictions.iter().flat_map(|prediction| {
        prediction.poses.iter().map(|(id, pose)| (prediction.time_s, *id, pose))
    });
    for (time_s, id, pose) in of_tracks.chain(ahead) {
        if !pose.to_homogeneous().iter().all(|number| number.is_finite()) {
            return Err(ScoreError::Pose { id, time_s });
        }
    }
    Ok(())
}

fn rising(what: &'static str, times: impl Iterator<Item = f64>) -> Result<(), ScoreError> {
    let mut before = f64::NEG_INFINITY;
    for time_s in times {
        // NaN is not greater than any time, so it is refused as well.
        if time_s.partial_cmp(&before) != Some(std::cmp::Ordering::Greater) {
            return Err(ScoreError::Order { what, time_s });
        }
        before = time_s;
    }
    Ok(())
}

/// The scene's rigid units.
struct Truth<'s> {
    scene: &'s RecordedScene,
    /// (units) Their numbers in the scene.
    numbers: Vec<usize>,
    /// (units)
    surfaces: Vec<Surface>,
}

impl<'s> Truth<'s> {
    fn new(scene: &'s RecordedScene) -> Self {
        let rigid = scene.units().iter().enumerate().filter(|(_, unit)| unit.soft.is_none());
        let (numbers, surfaces) = rigid.map(|(number, unit)| (number, Surface::new(unit))).unzip();
        Truth { scene, numbers, surfaces }
    }

    /// (units) None outside of the record.
    fn poses_at(&self, time_s: f64) -> Option<Vec<Isometry3<f32>>> {
        let numbers = self.numbers.iter();
        numbers.map(|number| self.scene.pose_at(time_s, *number)).collect()
    }
}

/// What one capture's estimate was found to be.
struct Scored {
    /// (units) True poses.
    poses: Vec<Isometry3<f32>>,
    /// (units) The track that found it.
    found: Vec<Option<u32>>,
    tracks: Vec<Tracked>,
}

/// A track in a capture.
struct Tracked {
    id: u32,
    pose: Isometry3<f32>,
    is_seen: bool,
    /// The unit that is its own so far.
    owner: Option<usize>,
    /// Of its centre, square metres.
    covariance: Matrix3<f64>,
}

impl Tracked {
    /// Whether an offset of the centre is within 95 % of what the covariance says.
    fn expects(&self, offset_m: &Vector3<f64>) -> bool {
        let factors = self.covariance.cholesky();
        factors.is_some_and(|factors| offset_m.dot(&factors.solve(offset_m)) <= CHI_SQUARED_95)
    }
}

struct Run<'t> {
    truth: &'t Truth<'t>,
    settings: &'t Settings,
    losses: Losses,
    findable: Vec<usize>,
    found: Vec<usize>,
    /// (units) Tracks that found it, in that order.
    finders: Vec<Vec<u32>>,
    /// The unit that a track is.
    owner: HashMap<u32, usize>,
    pairs: BTreeMap<(u32, usize), (Pairs, usize)>,
    captures: Vec<Scored>,
}

impl<'t> Run<'t> {
    fn new(truth: &'t Truth<'t>, settings: &'t Settings) -> Self {
        let units = truth.surfaces.len();
        Run {
            truth,
            settings,
            losses: Losses::default(),
            findable: vec![0; units],
            found: vec![0; units],
            finders: vec![Vec::new(); units],
            owner: HashMap::new(),
            pairs: BTreeMap::new(),
            captures: Vec::new(),
        }
    }

    fn capture(&mut self, estimate: &Estimate, poses: &[Isometry3<f32>], pixels: Option<&[u32]>) {
        let surfaces = &self.truth.surfaces;
        let near = self.settings.near;
        let mut tracks: Vec<(&UnitEstimate, Owners)> = estimate
            .units
            .iter()
            .map(|track| (track, owners_of(track, surfaces, poses, near)))
            .collect();
        // The order of the tracker's list must not decide which of two tracks a unit gets.
        tracks.sort_by_key(|(track, _)| track.id);

        let units = 0..surfaces.len();
        let found: Vec<_> = units.map(|unit| self.find_track(unit, &tracks, pixels)).collect();
        for (track, owners) in &tracks {
            let is_own = found.contains(&Some(track.id));
            match owners.on {
                None if track.visibility == Visibility::Seen => self.losses.false_tracks += 1,
                // A track of another unit counts as swapped where the unit is left without its own.
                Some(unit) if !is_own && found.get(unit).is_some_and(Option::is_some) => {
                    self.losses.split += 1;
                }
                _ => {}
            }
        }
        self.add_pairs(&tracks, &found, poses);
        let owner = &self.owner;
        let tracks = tracks.iter().map(|(track, _)| Tracked {
            id: track.id,
            pose: track.pose,
            is_seen: track.visibility == Visibility::Seen,
            owner: owner.get(&track.id).copied(),
            covariance: track.covariance.fixed_view::<3, 3>(0, 0).into_owned().cast(),
        });
        let tracks = tracks.collect();
        self.captures.push(Scored { poses: poses.to_vec(), found, tracks });
    }

    /// The track that finds a unit in a capture; counts it, or why there is none.
    fn find_track(
        &mut self,
        unit: usize,
        tracks: &[(&UnitEstimate, Owners)],
        pixels: Option<&[u32]>,
    ) -> Option<u32> {
        let own = |id: u32| self.owner.get(&id).is_none_or(|owned| *owned == unit);
        let on = || tracks.iter().filter(|(_, owners)| owners.on == Some(unit)).map(|(t, _)| t.id);
        let last = self.finders[unit].last().copied();
        // The last track comes first, so that a second track on a unit does not renew it.
        let finder =
            last.filter(|last| on().any(|id| id == *last)).or_else(|| on().find(|id| own(*id)));

        let number = self.truth.numbers[unit];
        let enough = |pixels: &[u32]| {
            pixels.get(number).is_some_and(|count| *count >= self.settings.findable_pixels)
        };
        // What hardly any pixel shows is no loss of the tracker.
        if !pixels.is_none_or(enough) {
            self.losses.unseen += 1;
        } else {
            self.findable[unit] += 1;
            let shares = |(track, owners): &(&UnitEstimate, Owners)| {
                owners.on != Some(unit)
                    && owners.shares.contains(&unit)
                    && track.visibility == Visibility::Seen
            };
            match finder {
                Some(_) => self.found[unit] += 1,
                None if on().next().is_some() => self.losses.swapped += 1,
                None if tracks.iter().any(shares) => self.losses.merged += 1,
                None => self.losses.lost += 1,
            }
        }
        let finder = finder?;
        if last != Some(finder) {
            self.losses.renewed += usize::from(last.is_some());
            self.finders[unit].push(finder);
        }
        self.owner.insert(finder, unit);
        Some(finder)
    }

    fn add_pairs(
        &mut self,
        tracks: &[(&UnitEstimate, Owners)],
        found: &[Option<u32>],
        poses: &[Isometry3<f32>],
    ) {
        for (unit, (id, pose)) in found.iter().zip(poses).enumerate() {
            let Some(id) = id else { continue };
            let Some((track, _)) = tracks.iter().find(|(track, _)| track.id == *id) else {
                continue;
            };
            // A hidden track is predicted: its error must not bend the alignment.
            if track.visibility == Visibility::Seen {
                let (pairs, count) = self.pairs.entry((*id, unit)).or_default();
                pairs.add(&track.pose, pose, &self.truth.surfaces[unit].centre);
                *count += 1;
            }
        }
    }

    fn score(self, predictions: &[Prediction]) -> Score {
        let surfaces = &self.truth.surfaces;
        // A single pose is aligned with itself, so its error would be 0.
        let several = self.pairs.iter().filter(|(_, (_, count))| *count > 1);
        let alignments: BTreeMap<(u32, usize), Alignment> = several
            .filter_map(|((id, unit), (pairs, _))| {
                Some(((*id, *unit), pairs.best(&surfaces[*unit].centre)?))
            })
            .collect();
        let (mut seen, mut unseen) = (Errors::default(), Errors::default());
        let mut by_unit: Vec<Errors> = surfaces.iter().map(|_| Errors::default()).collect();
        let (mut expected, mut scored) = (0, 0);
        for capture in &self.captures {
            for track in &capture.tracks {
                let Tracked { id, pose, is_seen, owner, .. } = track;
                // A hidden track may be anywhere and stays the unit's that it was.
                let finds = |unit: &usize| !is_seen || capture.found[*unit] == Some(*id);
                let Some(unit) = owner.filter(finds) else { continue };
                let Some(alignment) = alignments.get(&(*id, unit)) else { continue };
                let error = alignment.error(pose, &capture.poses[unit], &surfaces[unit]);
                scored += 1;
                expected += usize::from(track.expects(&error.offset_m));
                if *is_seen {
                    seen.add(error);
                    by_unit[unit].add(error);
                } else {
                    unseen.add(error);
                }
            }
        }
        let predictions = self.predicted(predictions, &alignments);
        let (findable, found): (usize, usize) =
            (self.findable.iter().sum(), self.found.iter().sum());
        let units = by_unit.into_iter().zip(self.finders).enumerate();
        let by_unit = units.map(|(unit, (errors, tracks))| {
            let number = self.truth.numbers[unit];
            let shape = self.truth.scene.units().get(number).map(|unit| unit.shape.clone());
            UnitScore {
                unit: number,
                shape: shape.unwrap_or_default(),
                findable: self.findable[unit],
                found: self.found[unit],
                tracks,
                seen: errors.spread(),
            }
        });
        Score {
            captures: self.captures.len(),
            units: surfaces.len(),
            findable,
            found,
            found_share: (findable > 0).then(|| found as f64 / findable as f64),
            losses: self.losses,
            seen: seen.spread(),
            unseen: unseen.spread(),
            expected_share: (scored > 0).then(|| expected as f64 / scored as f64),
            by_unit: by_unit.collect(),
            predictions,
        }
    }

    fn predicted(
        &self,
        predictions: &[Prediction],
        alignments: &BTreeMap<(u32, usize), Alignment>,
    ) -> Vec<PredictionScore> {
        let ids: BTreeSet<u32> = alignments.keys().map(|(id, _)| *id).collect();
        let most = |id: &u32| {
            let of_it = alignments.keys().filter(|(other, _)| other == id);
            let count = |key: &(u32, usize)| self.pairs.get(key).map_or(0, |(_, count)| *count);
            // A track that was swapped is the unit's that it was most often.
            of_it.max_by_key(|key| count(key)).map(|(_, unit)| (*id, *unit))
        };
        let unit_of: HashMap<u32, usize> = ids.iter().filter_map(most).collect();
        let mut by_ahead: BTreeMap<i64, (Errors, usize)> = BTreeMap::new();
        for prediction in predictions {
            let Some(truths) = self.truth.poses_at(prediction.time_s) else { continue };
            // Whole milliseconds group predictions of one horizon, whose difference of times
            // rounds.
            let ahead_ms = ((prediction.time_s - prediction.made_at_s) * 1e3).round() as i64;
            let (errors, unknown) = by_ahead.entry(ahead_ms).or_default();
            for (id, pose) in &prediction.poses {
                let unit = unit_of.get(id).copied();
                let scored = unit.and_then(|unit| {
                    let alignment = alignments.get(&(*id, unit))?;
                    Some(alignment.error(pose, truths.get(unit)?, self.truth.surfaces.get(unit)?))
                });
                match scored {
                    Some(error) => errors.add(error),
                    // A track that no unit owns has no true pose to compare with.
                    None => *unknown += 1,
                }
            }
        }
        let scores = by_ahead.into_iter().map(|(ahead_ms, (errors, unknown))| PredictionScore {
            ahead_s: ahead_ms as f64 / 1e3,
            unknown,
            errors: errors.spread(),
        });
        scores.collect()
    }
}

/// Errors that are gathered.
#[derive(Default)]
struct Errors {
    translation_m: Vec<f64>,
    rotation_deg: Vec<f64>,
    surface_m: Vec<f64>,
}

impl Errors {
    fn add(&mut self, error: PoseError) {
        self.translation_m.push(error.translation_m);
        self.rotation_deg.extend(error.rotation_deg);
        self.surface_m.push(error.surface_m);
    }

    fn spread(self) -> PoseErrors {
        PoseErrors {
            translation_m: Spread::of(self.translation_m),
            rotation_deg: Spread::of(self.rotation_deg),
            surface_m: Spread::of(self.surface_m),
        }
    }
}
