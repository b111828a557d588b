//! Where a unit touches ground of varying height: points of its hull on faces, and edges of the ground against the hull.
//!
//! A face pushes along its normal alone, so that what slides over the edge between two level faces is not stopped by it. An edge
//! or a corner pushes where it sticks out, in the directions that are nearest to it.

use super::contacts::{Meeting, meeting, touching};
use super::patch::{self, Patch};
use crate::contact::height_field::{Near, Ridge};
use crate::contact::pieces::Piece;
use crate::geometry::{Hull, Pose, dot, norm, rotate};
use nalgebra::{Matrix3, Point3, Vector3};

/// Touches of a unit that are kept: the deepest.
const TOUCHES: usize = 64;
/// Ways that the ground pushes a unit, at most: floor, wall and wall of a corner.
const WAYS: usize = 3;
/// Cosine of 20 degrees: what pushes within that pushes one way.
const ONE_WAY: f32 = 0.94;
/// Of two unit vectors that are the same, less than 1 by this.
const SAME_WAY: f32 = 1e-6;
/// Touches closer together are one, and gaps that differ by less are the same, in radii.
const SAME_PLACE: f32 = 1e-3;
/// Touches that are no higher than this over the deepest touch now, in what are the same.
const NEAR: f32 = 5.0;
/// Of those, at most, one way.
const TOUCHING: usize = 8;
/// Edges behind which a face falls away by less do not stick out, in radii.
const DIP: f32 = 1e-3;
/// Deeper points are pushed by the face that they are least deep under alone, in radii.
const SHALLOW: f32 = 0.03;

/// A point where a unit touches, or is about to.
#[derive(Clone, Copy)]
struct Touch {
    /// From the unit's centre, in the world's axes.
    point: Vector3<f32>,
    gap: f32,
    /// Out of the ground.
    normal: Vector3<f32>,
}

impl Touch {
    /// As a patch of its own.
    fn alone(&self, act: &mut impl FnMut(&Vector3<f32>, &Patch)) {
        let mut patch = Patch::default();
        let _ = patch.points.push((self.point, self.gap));
        act(&self.normal, &patch);
    }
}

/// A unit over the ground in a substep.
pub(super) struct Visitor<'a> {
    /// As seen from the unit's centre.
    pub(super) ground: Near<'a>,
    pub(super) radius: f32,
    /// How far the unit is from its hull: see [`World::round`](super::bodies::World::round).
    pub(super) round: f32,
    /// How far it goes in the substep.
    pub(super) way: Vector3<f32>,
    /// Gaps that are looked at whichever way it goes.
    pub(super) margin: f32,
    /// What it keeps from edges.
    pub(super) skin: f32,
}

/// Where a unit touches.
pub(super) struct Touches {
    all: heapless::Vec<Touch, TOUCHES>,
    same: f32,
}

impl Touches {
    pub(super) fn new(radius: f32) -> Self {
        Touches { all: heapless::Vec::new(), same: SAME_PLACE * radius }
    }

    /// Keeps a touch, unless there is a deeper one like it, or as many as there is room for.
    fn add(&mut self, touch: Touch) {
        let same = self.same;
        let is_like = |other: &&mut Touch| {
            let apart = other.point - touch.point;
            dot(&apart, &apart) <= same * same && dot(&other.normal, &touch.normal) > ONE_WAY
        };
        if let Some(other) = self.all.iter_mut().find(is_like) {
            if touch.gap < other.gap {
                *other = touch;
            }
        } else if self.all.push(touch).is_err() {
            let mut highest: Option<&mut Touch> = None;
            for other in &mut self.all {
                if highest.as_ref().is_none_or(|highest| other.gap > highest.gap) {
                    highest = Some(other);
                }
            }
            if let Some(highest) = highest.filter(|highest| highest.gap > touch.gap) {
                *highest = touch;
            }
        }
    }

    /// Patches that stand for all, each with the way that it pushes: the deepest way first.
    pub(super) fn each_patch(mut self, mut act: impl FnMut(&Vector3<f32>, &Patch)) {
        for _ in 0..WAYS {
            let deepest = self.all.iter().reduce(|a, b| if b.gap < a.gap { b } else { a });
            let Some(Touch { normal: lead, gap: least, .. }) = deepest.copied() else { return };
            let goes = |touch: &&Touch| dot(&touch.normal, &lead) > ONE_WAY;
            let is_flat = |touch: &Touch| dot(&touch.normal, &lead) >= 1.0 - SAME_WAY;
            if self.all.iter().filter(goes).all(is_flat) {
                // As a plane.
                let group = self.all.iter().filter(goes);
                act(&lead, &patch::choose(group.map(|touch| (touch.point, touch.gap)), &lead));
            } else {
                // What touches comes first, the deepest of it: on uneven ground that is not what is outermost, and what a unit stands
                // on has to be there in each substep.
                let most = least + NEAR * self.same;
                let mut last = f32::NEG_INFINITY;
                let mut room = TOUCHING;
                loop {
                    let next = |touch: &&Touch| touch.gap > last && touch.gap <= most;
                    let gaps = self.all.iter().filter(goes).filter(next).map(|touch| touch.gap);
                    last = gaps.fold(f32::INFINITY, f32::min);
                    let own = self.all.iter().filter(goes).filter(|touch| touch.gap == last);
                    for touch in own.take(room) {
                        touch.alone(&mut act);
                        room -= 1;
                    }
                    if last == f32::INFINITY || room == 0 {
                        break;
                    }
                }
                let group = self.all.iter().filter(goes).filter(|touch| touch.gap > most);
                each_alone(group, &lead, &mut act);
            }
            self.all.retain(|touch| !goes(&touch));
        }
    }
}

/// At most four of these touches, each a patch of its own.
fn each_alone<'t>(
    group: impl Iterator<Item = &'t Touch> + Clone,
    lead: &Vector3<f32>,
    act: &mut impl FnMut(&Vector3<f32>, &Patch),
) {
    let chosen = patch::choose(group.clone().map(|touch| (touch.point, touch.gap)), lead);
    for (point, gap) in chosen.points.iter().skip(usize::from(chosen.has_middle)) {
        // It is one of them, to the bit.
        let is_it = |touch: &&Touch| touch.point == *point && touch.gap == *gap;
        if let Some(touch) = group.clone().find(is_it) {
            touch.alone(act);
        }
    }
}

impl Visitor<'_> {
    /// Gaps up to this may close in the substep, by the ground's normal.
    fn reach(&self, normal: &Vector3<f32>) -> f32 {
        (-dot(normal, &self.way)).max(0.0) + self.margin
    }

    /// Finds where a convex piece of the unit touches.
    #[cfg_attr(rigidformer_dsp, inline(never))]
    pub(super) fn find(&self, piece: &Piece<'_>, pose: &Pose, touches: &mut Touches) {
        let far = norm(&self.way) + self.margin;
        let (mut low, mut high) =
            (Vector3::repeat(f32::INFINITY), Vector3::repeat(f32::NEG_INFINITY));
        for point in piece.points {
            let point = rotate(&pose.rotation, &point.coords);
            (low, high) = (low.inf(&point), high.sup(&point));
            self.on_faces(&point, far, touches);
        }
        let around = Vector3::repeat(self.round + far);
        let (low, high) = (low - around, high + around);
        let Some([rows, columns]) = self.ground.cells(&low, &high) else { return };
        let middle = rotate(&pose.rotation, &piece.middle);
        let hull = Hull { points: piece.points, rotation: pose.rotation };
        for row in rows {
            for column in columns.clone() {
                if self.ground.top(row, column) < low.z {
                    continue;
                }
                for ridge in self.ground.ridges(row, column, DIP * self.radius) {
                    self.on_ridge(&ridge, (&hull, &middle, piece.radius), far, touches);
                }
            }
        }
    }

    /// Where a point of the hull, or the middle of a ball, is over or under faces.
    fn on_faces(&self, point: &Vector3<f32>, far: f32, touches: &mut Touches) {
        let around = Vector3::repeat(self.round + far);
        let Some([rows, columns]) = self.ground.cells(&(point - around), &(point + around)) else {
            return;
        };
        let touch = |normal: &Vector3<f32>, above: f32| Touch {
            point: point - normal * self.round,
            gap: above - self.round,
            normal: *normal,
        };
        let mut least_deep: Option<Touch> = None;
        let is_below = self.ground.face_below(point).filter(|face| face.above(point) < 0.0);
        for row in rows {
            for column in columns.clone() {
                if self.ground.top(row, column) < point.z - around.z {
                    continue;
                }
                for face in self.ground.faces(row, column) {
                    let above = face.above(point);
                    if above - self.round >= self.reach(&face.normal)
                        || !face.has_foot_of(point, above)
                        || (above < 0.0 && is_below.is_none())
                    {
                        continue;
                    }
                    let found = touch(&face.normal, above);
                    if above >= -SHALLOW * self.radius {
                        touches.add(found);
                    }
                    if above < 0.0 && least_deep.is_none_or(|least| found.gap > least.gap) {
                        least_deep = Some(found);
                    }
                }
            }
        }
        if let Some(face) = is_below {
            // Under a ridge it may be under no face's normal.
            let found = least_deep.unwrap_or_else(|| touch(&face.normal, face.above(point)));
            touches.add(found);
        }
    }

    /// Where an edge that sticks out meets the hull.
    fn on_ridge(
        &self,
        ridge: &Ridge,
        (hull, middle, radius): (&Hull<'_>, &Vector3<f32>, f32),
        far: f32,
        touches: &mut Touches,
    ) {
        let ([start, end], between) = (ridge.ends, ridge.middle_normal());
        let (half, centre) = ((end - start) * 0.5, (start + end) * 0.5);
        let length = norm(&half);
        // The nearest place of the edge to the middle of a ball around the piece.
        let share = (dot(&(middle - centre), &half) / (length * length)).clamp(-1.0, 1.0);
        let nearest = centre + half * share;
        if norm(&(nearest - middle)) > radius + self.round + far {
            return;
        }
        // A plane over the edge, whichever of its ends is higher.
        let along = dot(&between, &start).max(dot(&between, &end));
        let lowest = dot(&hull.support(&-between), &between) - self.round;
        if lowest - along > self.reach(&between) {
            return;
        }
        let ends = [Point3::from(-half), Point3::from(half)];
        let edge = Hull { points: &ends, rotation: Matrix3::identity() };
        let apart = -centre;
        let hulls = [&edge, hull];
        let sizes = [self.radius, self.radius + length, far];
        let met: Meeting =
            meeting(hulls, [0.0, self.round], (&apart, &(middle - centre), Some(between)), sizes);
        let (gap, normal) = (met.gap, met.normal);
        if gap > self.reach(&normal) || !self.ground.sticks_out(ridge, &normal) {
            return;
        }
        if self.round == 0.0
            && let Some(patch) = touching(hulls, [self.radius; 2], &apart, (&met, self.skin))
        {
            let corners = patch.points.iter().skip(usize::from(patch.has_middle));
            for (point, gap) in corners.filter(|(_, gap)| *gap <= self.reach(&normal)) {
                touches.add(Touch { point: point + centre, gap: *gap, normal });
            }
        } else {
            touches.add(Touch { point: met.middle + centre, gap, normal });
        }
    }
}
