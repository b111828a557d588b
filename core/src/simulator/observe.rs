//! A scene from two frames.

use super::measure::{Census, Time, check_dt};
use super::state::Simulator;
use crate::contact::impacts;
use crate::contact::pieces::Pieces;
use crate::error::ObserveError;
use crate::geometry::index::Parts;
use crate::geometry::{
    Pose, Rank, centre_of_mass_here, extreme_points, farthest_point_order_here, kabsch_f64_here,
    norm, radius_here,
};
use crate::kernels::in_own_environment;
use crate::limits::{ANCHORS, MAX_COORDINATE_M, MAX_PIECES, MIN_EXTENT_M};
use crate::measure::Measure;
use crate::network::anchors;
#[cfg(not(feature = "compliance"))]
use crate::scene::Compliance;
use crate::scene::{Quarantine, Unit, UnitId, UnitSlot};
use crate::slices::slice_at_mut;
use crate::stand_in::{OfCompliance, OfHealth};
use core::borrow::Borrow;
use nalgebra::{Isometry3, Matrix3, Point3, Vector3};

/// A unit seen in two frames: `unit.points` are its points in the previous frame (world, metres).
#[derive(Clone, Copy, Debug)]
pub struct Observed<'a> {
    /// The unit, with its points of the previous frame.
    pub unit: Unit<'a>,
    /// The same points in the same order, in the current frame.
    pub current: &'a [Point3<f32>],
}

/// A unit whose poses are known in two frames: each carries the unit's reference points to the world.
#[derive(Clone, Copy, Debug)]
pub struct Posed<'a> {
    /// The unit, with its points in its own reference frame.
    pub unit: Unit<'a>,
    /// Its pose in the previous frame.
    pub previous: Isometry3<f32>,
    /// Its pose in the current frame.
    pub current: Isometry3<f32>,
}

/// What an accepted observation was like.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Observation {
    /// Largest distance of an observed point from the rigid fit of its unit, metres; 0 where
    /// poses were given. Far above the sensor's noise, a unit was not rigid or its points
    /// were not the same in both frames.
    pub residual_m: f32,
    /// Units whose points left their rotation open (all on a line).
    pub degenerate_units: u32,
}

impl Simulator<'_, '_> {
    /// Starts from two frames of points, `dt_s` seconds apart, which is what every step then takes.
    /// The previous frame becomes the reference frame of [`UnitView::pose`](crate::UnitView::pose), and its axes those of a
    /// unit's moments of inertia, given or of a box, in models with impacts: for long bodies that lie askew [`observe_poses`](Self::observe_poses)
    /// with points in the body's own frame tells more. Planes and gravity stay what they were.
    /// Models that measure scenes in their own length find it here, and keep it until the next observation.
    ///
    /// # Errors
    /// [`ObserveError`] names what is wrong with the input; the scene is what it was.
    pub fn observe<'a, I>(&mut self, dt_s: f32, units: I) -> Result<Observation, ObserveError>
    where
        I: IntoIterator<Item: Borrow<Observed<'a>>, IntoIter: Clone>,
    {
        in_own_environment(|| self.observe_here(dt_s, units))
    }

    fn observe_here<'a, I>(&mut self, dt_s: f32, units: I) -> Result<Observation, ObserveError>
    where
        I: IntoIterator<Item: Borrow<Observed<'a>>, IntoIter: Clone>,
    {
        check_dt(dt_s, self.model.config())?;
        let units = units.into_iter();
        let (mut room, mut census) = (self.room(), Census::default());
        let mut place = None;
        for (number, seen) in units.clone().enumerate() {
            let Observed { unit, current } = seen.borrow();
            room.take(number, unit)?;
            census.take(self.model.config(), unit);
            place = nearer(place, current.first().map(|first| first.coords));
            #[cfg(feature = "deform")]
            crate::structure::soft::check(&self.model.config().elastic, number, unit)?;
            if unit.points.len() != current.len() {
                let (previous, current) = (unit.points.len(), current.len());
                return Err(ObserveError::PointMismatch { unit: number, previous, current });
            }
            check_points(number, current)?;
            check_extent(number, current)?;
        }
        room.taken()?;
        self.begin(self.measured(dt_s, &census, &place.unwrap_or_default())?);
        let mut observation = Observation::default();
        for seen in units {
            let Observed { unit, current } = seen.borrow();
            #[cfg(feature = "deform")]
            if unit.soft.is_some() {
                self.add_soft(unit, current);
                continue;
            }
            let pairs = unit.points.iter().zip(current.iter()).map(|(a, b)| (&a.coords, &b.coords));
            let fit = kabsch_f64_here(pairs.clone(), &Matrix3::identity());
            observation.residual_m = observation.residual_m.max(fit.residual(pairs));
            observation.degenerate_units += u32::from(fit.rank != Rank::Full);
            let offset = self.centre(unit);
            let first = Pose { rotation: Matrix3::identity(), centre: offset.coords };
            // A fit rounds: the same frame twice is rest.
            let fitted = fit.pose_at(&offset.coords);
            let poses = [&first, if unit.points == *current { &first } else { &fitted }];
            let poses = poses.map(|pose| self.scene.measure.inward(pose));
            self.add_checked(unit, &offset, poses);
        }
        self.bind(0);
        Ok(observation)
    }

    /// Starts from known poses, `dt_s` seconds apart. Nothing is fitted, so the report is all zeros.
    ///
    /// # Errors
    /// [`ObserveError`] names what is wrong with the input; the scene is what it was.
    pub fn observe_poses<'a, I>(&mut self, dt_s: f32, units: I) -> Result<Observation, ObserveError>
    where
        I: IntoIterator<Item: Borrow<Posed<'a>>, IntoIter: Clone>,
    {
        in_own_environment(|| self.observe_poses_here(dt_s, units))
    }

    fn observe_poses_here<'a, I>(
        &mut self,
        dt_s: f32,
        units: I,
    ) -> Result<Observation, ObserveError>
    where
        I: IntoIterator<Item: Borrow<Posed<'a>>, IntoIter: Clone>,
    {
        check_dt(dt_s, self.model.config())?;
        let units = units.into_iter();
        let (mut room, mut census) = (self.room(), Census::default());
        let mut place = None;
        for (number, seen) in units.clone().enumerate() {
            let Posed { unit, previous, current } = seen.borrow();
            place = nearer(place, Some(place_of(unit, current)));
            #[cfg(feature = "deform")]
            if unit.soft.is_some() {
                return Err(ObserveError::SoftPose { unit: number });
            }
            room.take(number, unit)?;
            census.take(self.model.config(), unit);
            check_pose(number, previous)?;
            check_pose(number, current)?;
        }
        room.taken()?;
        self.begin(self.measured(dt_s, &census, &place.unwrap_or_default())?);
        for seen in units {
            let Posed { unit, previous, current } = seen.borrow();
            self.add_posed(unit, previous, current);
        }
        self.bind(0);
        Ok(Observation::default())
    }

    /// Joins the soft units of a copy by springs, once all units are there.
    pub(super) fn bind(&mut self, copy: usize) {
        let _ = copy;
        #[cfg(feature = "deform")]
        if self.sizes.is_soft() {
            let Self { scene, model, .. } = self;
            crate::structure::soft::bind(scene, &model.config().elastic, copy);
            crate::structure::soft::mark_balls(scene);
            let first = copy * scene.per_copy;
            for number in first..first + scene.per_copy {
                crate::structure::soft::refresh(scene, number);
            }
            self.weigh_soft(copy);
        }
    }

    /// Fills the weights of anchor-vertex pooling of a copy's soft units, whose points have moved.
    pub(super) fn weigh_soft(&mut self, copy: usize) {
        if !self.sizes.is_soft() {
            return;
        }
        let first = copy * self.scene.per_copy;
        for number in first..first + self.scene.per_copy {
            if let Some(unit) = self.scene.units().get(number).copied().filter(UnitSlot::is_soft) {
                self.weigh(&unit);
            }
        }
    }

    /// Puts a soft unit that was checked behind the others.
    #[cfg(feature = "deform")]
    fn add_soft(&mut self, unit: &Unit<'_>, current: &[Point3<f32>]) {
        let Some(soft) = unit.soft else { return };
        let at_rest = Unit { points: soft.rest, ..*unit };
        let offset = self.centre(&at_rest);
        let start = self.scene.points_per_copy();
        let rows = (start, unit.points.len());
        crate::structure::soft::add_patch(
            &mut self.scene,
            rows,
            soft.rest,
            &offset,
            [unit.points, current],
        );
        let pose = Pose::default();
        let pose = self.scene.measure.inward(&pose);
        self.add_checked(&at_rest, &offset, [pose; 2]);
        let number = self.scene.per_copy.saturating_sub(1);
        if let Some(slot) = self.scene.units_mut().get_mut(number) {
            slot.is_patch = true;
            slot.ln_young = crate::math::ln(soft.young_pa);
        }
    }

    /// Room for a whole scene.
    fn room(&self) -> Room {
        Room { units: self.limits.units, points: self.limits.points, given: 0, given_points: 0 }
    }

    /// Room beside the units that are there.
    pub(super) fn room_left(&self) -> Room {
        let given_points = self.scene.points_per_copy().max(self.scene.hull_rows_per_copy());
        let given = self.scene.per_copy;
        Room { given, given_points, ..self.room() }
    }

    /// From here on an observation cannot fail.
    fn begin(&mut self, (measure, time): (Measure, Time)) {
        self.scene.count = 0;
        self.scene.per_copy = 0;
        #[cfg(feature = "deform")]
        self.bonds.clear();
        self.set_measure(measure);
        self.set_time(time);
    }

    /// Measures the units by another measure: [`set_measure`](Self::set_measure) comes next.
    pub(super) fn rescale(&mut self, measure: &Measure) {
        let share = self.scene.measure.length() / measure.length();
        for number in 0..self.scene.count {
            let Some(mut unit) = self.scene.units().get(number).copied() else { return };
            let stays = unit.target == unit.current;
            for pose in [&mut unit.first, &mut unit.target] {
                pose.centre *= share;
            }
            unit.set_centre(&(unit.centre() * f64::from(share)));
            if stays {
                unit.target = unit.current;
            }
            let course = &mut unit.course;
            (course.way, course.way_low) = (course.way * share, course.way_low * share);
            self.scene.rescale(&unit, share);
            unit.radius *= share;
            unit.inertia_m2 = impacts::no_less(unit.inertia_m2 * (share * share));
            unit.set_physics(unit.physics, measure);
            self.weigh(&unit);
            if let Some(slot) = self.scene.units_mut().get_mut(number) {
                *slot = unit;
            }
        }
        self.index_from(0);
    }

    /// Counts the units' places from another measure's origin: [`set_measure`](Self::set_measure) comes next.
    #[cfg_attr(rigidformer_dsp, inline(never))]
    pub(super) fn move_origin(&mut self, measure: &Measure) {
        let [old, new] = [&self.scene.measure, measure].map(|measure| measure.origin().cast());
        let way: Vector3<f64> = (old - new) / f64::from(measure.length());
        for unit in self.scene.units_mut() {
            let stays = unit.target == unit.current;
            for pose in [&mut unit.first, &mut unit.target] {
                pose.centre = (pose.centre.cast::<f64>() + way).map(|v| v as f32);
            }
            unit.set_centre(&(unit.centre() + way));
            if stays {
                unit.target = unit.current;
            }
        }
        self.index_from(0);
    }

    /// Moves the origin to about a place that is nearer to the world's, metres.
    #[cfg_attr(rigidformer_dsp, inline(never))]
    pub(super) fn come_nearer(&mut self, place: &Vector3<f32>) {
        if place.amax() < self.scene.measure.origin().amax() {
            let measure = self.about(&self.scene.measure, place);
            self.move_origin(&measure);
            self.set_measure(measure);
        }
    }

    /// Something besides steps has changed: no unit is certain to stay as it is.
    #[inline]
    pub(super) fn forget_still(&mut self) {
        #[cfg(rigidformer_host)]
        self.scene.units_mut().iter_mut().for_each(|unit| unit.still = 0);
    }

    /// Fills a unit's weights of anchor-vertex pooling.
    pub(super) fn weigh(&mut self, unit: &UnitSlot) {
        let weights =
            slice_at_mut(self.lasting.avp_weights, unit.start * ANCHORS, unit.count * ANCHORS);
        anchors::pooling_weights(&self.scene, unit, self.model.anchors.sigma_m, weights);
    }

    /// As [`add_checked`](Self::add_checked), of a unit whose poses are known.
    #[cfg_attr(rigidformer_dsp, inline(never))]
    pub(super) fn add_posed(
        &mut self,
        unit: &Unit<'_>,
        previous: &Isometry3<f32>,
        current: &Isometry3<f32>,
    ) -> UnitId {
        let offset = self.centre(unit);
        let pose = |isometry| self.scene.measure.inward_isometry(isometry, &offset);
        let poses = [pose(previous), pose(current)];
        self.add_checked(unit, &offset, poses)
    }

    /// Puts the points of a unit that was checked behind the others' for their centre, from which they count from then
    /// on, in the scene's measure; the centre is in the caller's. [`add_checked`](Self::add_checked) comes next.
    #[cfg_attr(rigidformer_dsp, inline(never))]
    fn centre(&mut self, unit: &Unit<'_>) -> Point3<f32> {
        let start = self.scene.points_per_copy();
        let count = unit.points.len();
        let slab = self.scene.points.get_mut(start..start + count).unwrap_or_default();
        copy_points(unit.points, slab);
        let offset = centre_of_mass_here(slab);
        let offset = unit.pieces.centre().unwrap_or(offset);
        // Not the index behind it: the order fills all that it gets.
        let scratch = slice_at_mut(self.lasting.distance, 0, count);
        farthest_point_order_here(slab, &offset, scratch);
        for point in slab.iter_mut() {
            *point = Point3::from((*point - offset) / self.scene.measure.length());
        }
        offset
    }

    /// Puts a unit behind the others, whose points have their [`centre`](Self::centre) at `offset` in the reference
    /// frame, metres. The poses in the first and the current frame are those of the centre, in the scene's measure.
    #[cfg_attr(rigidformer_dsp, inline(never))]
    fn add_checked(
        &mut self,
        unit: &Unit<'_>,
        offset: &Point3<f32>,
        [first, current]: [Pose; 2],
    ) -> UnitId {
        let start = self.scene.points_per_copy();
        let count = unit.points.len();
        let number = self.scene.per_copy;
        let hull_start = self.scene.hull_rows_per_copy();
        let id = UnitId::from_bits(self.next_id);
        let points = self.scene.points.get(start..start + count).unwrap_or_default();
        let measure = self.scene.measure;
        let course = self.course_between(unit.role, &first, &current);
        let Some(slot) = self.scene.slots.get_mut(number) else { return id };
        self.next_id = self.next_id.wrapping_add(1);
        let mut reach = radius_here(points);
        let mut pieces = 0;
        let rows = if unit.pieces.is_empty() { count } else { unit.pieces.room() };
        let (hull, is_ball) = match self.scene.hulls.get_mut(hull_start..hull_start + rows) {
            // The weights' place is free as scratch: they are filled below.
            Some(hull) if unit.pieces.is_empty() => {
                let marks = slice_at_mut(self.lasting.avp_weights, start * ANCHORS, count);
                extreme_points(points, marks, hull)
            }
            Some(hull) => {
                let marks = slice_at_mut(self.lasting.avp_weights, start * ANCHORS, rows);
                let kept = unit.pieces.store((offset, measure.length()), marks, hull);
                reach = reach.max(radius_here(hull.get(..kept).unwrap_or_default()));
                // No more than `MAX_PIECES`.
                pieces = unit.pieces.counts().len() as u8;
                (kept, false)
            }
            None => (0, false),
        };
        let mut placed = UnitSlot {
            id,
            start,
            count,
            physics: unit.physics,
            #[cfg(feature = "compliance")]
            compliance: OfCompliance::new(unit.compliance),
            #[cfg(not(feature = "compliance"))]
            compliance: OfCompliance::new(Compliance::RIGID),
            role: unit.role,
            quarantine: OfHealth::new(Quarantine::None),
            is_ball,
            pieces,
            body: unit.body.map_or(0, |body| u32::from(body) + 1),
            #[cfg(feature = "robot")]
            link: crate::structure::link::Link::NONE,
            #[cfg(feature = "deform")]
            member: crate::structure::member::Member::ALONE,
            #[cfg(feature = "deform")]
            is_patch: false,
            #[cfg(feature = "deform")]
            ln_young: 0.0,
            mass: 0.0,
            ln_mass: 0.0,
            radius: reach,
            offset: *offset,
            hull,
            hull_start,
            inertia_m2: impacts::inertia(unit, points, is_ball, &measure),
            first,
            current,
            course,
            target: current,
            #[cfg(rigidformer_host)]
            still: 0,
            #[cfg(rigidformer_host)]
            still_substeps: 0,
        };
        placed.set_physics(unit.physics, &measure);
        *slot = placed;
        self.scene.per_copy += 1;
        self.scene.count = self.scene.per_copy;
        self.forget_still();
        self.weigh(&placed);
        self.index_from(number);
        id
    }

    /// Builds the index of the points of units from a number on, where there is one.
    pub(super) fn index_from(&mut self, number: usize) {
        if cfg!(rigidformer_host) && self.sizes.layout.index {
            let mut index = Parts::new(self.lasting.distance, &self.sizes.room());
            // Copies have the points of the first.
            let first = self.scene.units().iter().take(self.scene.per_copy);
            for (number, unit) in first.enumerate().skip(number) {
                index.add(number, unit.start, self.scene.points_of(unit));
            }
        }
    }
}

/// What is left of the limits while units are checked.
pub(super) struct Room {
    units: usize,
    points: usize,
    given: usize,
    given_points: usize,
}

impl Room {
    /// Checks a unit by itself, and counts it.
    pub(super) fn take(&mut self, number: usize, unit: &Unit<'_>) -> Result<(), ObserveError> {
        if unit.points.len() < ANCHORS {
            return Err(ObserveError::TooFewPoints { unit: number, found: unit.points.len() });
        }
        check_points(number, unit.points)?;
        check_extent(number, unit.points)?;
        if !unit.physics.is_sound() {
            return Err(ObserveError::BadPhysics { unit: number });
        }
        #[cfg(feature = "compliance")]
        if !unit.compliance.is_sound() {
            return Err(ObserveError::BadCompliance { unit: number });
        }
        if !unit.has_sound_inertia() {
            return Err(ObserveError::BadInertia { unit: number });
        }
        check_pieces(number, &unit.pieces)?;
        self.given = self.given.saturating_add(1);
        self.given_points = self.given_points.saturating_add(unit.room());
        Ok(())
    }

    /// Whether there are units, and all have room.
    pub(super) fn taken(&self) -> Result<(), ObserveError> {
        let Room { units, points, given, given_points } = *self;
        if given == 0 {
            return Err(ObserveError::NoUnits);
        }
        if given > units {
            return Err(ObserveError::TooManyUnits { found: given, limit: units });
        }
        if given_points > points {
            return Err(ObserveError::TooManyPoints { found: given_points, limit: points });
        }
        Ok(())
    }
}

/// Copies as much as fits. A function of its own, so that the compiler sees two slices that do not overlap: where they
/// may, a copy takes another kilobyte and a half of flash.
#[cfg_attr(rigidformer_dsp, inline(never))]
fn copy_points(from: &[Point3<f32>], to: &mut [Point3<f32>]) {
    for (to, from) in to.iter_mut().zip(from) {
        *to = *from;
    }
}

/// About where a unit is, in the caller's metres.
pub(super) fn place_of(unit: &Unit<'_>, current: &Isometry3<f32>) -> Vector3<f32> {
    unit.points.first().map_or(current.translation.vector, |point| (current * point).coords)
}

/// The place that is nearer to the world's origin: a scene counts places from about that of its nearest unit, so that no unit
/// far away takes digits from the others.
fn nearer(place: Option<Vector3<f32>>, other: Option<Vector3<f32>>) -> Option<Vector3<f32>> {
    match (place, other) {
        (Some(place), Some(other)) if other.amax() < place.amax() => Some(other),
        (place, other) => place.or(other),
    }
}

/// Whether a pose is a rotation and a place.
#[cfg_attr(rigidformer_dsp, inline(never))]
pub(super) fn check_pose(unit: usize, pose: &Isometry3<f32>) -> Result<(), ObserveError> {
    let q = pose.rotation.as_ref().coords;
    let length = (q.x * q.x + q.y * q.y) + (q.z * q.z + q.w * q.w);
    let sound = Pose::from_isometry(pose, &Point3::origin()).is_sound(MAX_COORDINATE_M);
    match sound && (length - 1.0).abs() <= 1e-3 {
        true => Ok(()),
        false => Err(ObserveError::BadPose { unit }),
    }
}

#[cfg_attr(rigidformer_dsp, inline(never))]
fn check_points(unit: usize, points: &[Point3<f32>]) -> Result<(), ObserveError> {
    // A NaN compares as not within the limit.
    let bad = |p: &Point3<f32>| !p.iter().all(|v| v.abs() <= MAX_COORDINATE_M);
    match points.iter().position(bad) {
        Some(point) => Err(ObserveError::BadPoint { unit, point }),
        None => Ok(()),
    }
}

#[cfg_attr(rigidformer_dsp, inline(never))]
fn check_pieces(unit: usize, pieces: &Pieces<'_>) -> Result<(), ObserveError> {
    let (found, limit) = (pieces.counts().len(), MAX_PIECES);
    if found > limit {
        return Err(ObserveError::TooManyPieces { unit, found, limit });
    }
    let bad = pieces.first_bad(|point| point.iter().all(|v| v.abs() <= MAX_COORDINATE_M));
    bad.map_or(Ok(()), |piece| Err(ObserveError::BadPiece { unit, piece }))
}

#[cfg_attr(rigidformer_dsp, inline(never))]
fn check_extent(unit: usize, points: &[Point3<f32>]) -> Result<(), ObserveError> {
    let first = points.first().copied().unwrap_or_else(Point3::origin);
    if points.iter().all(|p| norm(&(p - first)) < MIN_EXTENT_M) {
        return Err(ObserveError::Coincident { unit });
    }
    Ok(())
}
