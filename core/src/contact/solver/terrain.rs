//! Where a unit touches ground of varying height: points of its hull on faces, and edges of the ground against the hull.
//!
//! A face pushes along its normal alone, so that what slides over the edge between two level faces is not stopped by it. An edge
//! or a corner pushes where it sticks out, in the directions that are nearest to it.

use super::meeting::{Meeting, meeting, touching};
use super::patch::{self, Patch};
use crate::contact::height_field::{Near, Ridge};
use crate::contact::pieces::Piece;
use crate::geometry::{Hull, Pose, dot, norm, rotate};
use nalgebra::{Matrix3, Point3, Vector3};

/// Edges that a piece is compared with, at most: the nearest ones.
const RIDGES: usize = 16;
/// Touches of a unit that are kept: the deepest.
const TOUCHES: usize = 64;
/// Ways that the ground pushes a unit, at most: floor, wall and wall of a corner.
const WAYS: usize = 3;
/// Cosine of 20 degrees: what pushes within that pushes one way.
const ONE_WAY: f32 = 0.94;
/// Of two unit vectors that are the same, less than 1 by this.
const PARALLEL: f32 = 1e-6;
/// Touches closer together are one, and gaps that differ by less are the same, in radii.
const SAME_PLACE: f32 = 1e-3;
/// Touches that are no higher than this over the deepest touch now, in what are the same.
const NEAR: f32 = 5.0;
/// Of those, at most, one way.
const TOUCHING: usize = 4;
/// Contacts one way, at most, as with a plane; and of a unit: others need room too.
const ONE_WAY_ROOM: usize = 5;
const ROOM: usize = 8;
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
    pub(super) terrain: Near<'a>,
    pub(super) radius: f32,
    /// How far the unit is from its hull: see [`World::round`](super::bodies::World::round).
    pub(super) round: f32,
    /// How far it goes in the substep.
    pub(super) way: Vector3<f32>,
    /// Gaps that are looked at whichever way it goes.
    pub(super) margin: f32,
    /// What it keeps from edges.
    pub(super) skin: f32,
    /// Edges behind which a face falls away by less do not stick out.
    pub(super) dip: f32,
}

/// A convex piece of it, and how far that reaches.
struct Reach<'a> {
    hull: Hull<'a>,
    /// Of a ball around the piece.
    middle: Vector3<f32>,
    radius: f32,
    /// How far beyond it something may touch it in the substep.
    far: f32,
    /// Out of the ground below its middle.
    up: Vector3<f32>,
    /// How low it is along that.
    lowest: f32,
}

/// Of an edge the place that is nearest to another, and the middle and the half of what is no farther than this from that place.
fn part_of(ridge: &Ridge, place: &Vector3<f32>, most: f32) -> [Vector3<f32>; 3] {
    let [start, end] = &ridge.ends;
    let (half, centre) = ((end - start) * 0.5, (start + end) * 0.5);
    let length = norm(&half);
    let share = (dot(&(place - centre), &half) / (length * length)).clamp(-1.0, 1.0);
    let part = most / length;
    let (first, last) = ((share - part).max(-1.0), (share + part).min(1.0));
    let middle = centre + half * (0.5 * (first + last));
    [centre + half * share, middle, half * (0.5 * (last - first))]
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
        let mut left = ROOM;
        for _ in 0..WAYS {
            let deepest = self.all.iter().reduce(|a, b| if b.gap < a.gap { b } else { a });
            let Some(Touch { normal: lead, gap: least, .. }) = deepest.copied() else { return };
            let goes = |touch: &&Touch| dot(&touch.normal, &lead) > ONE_WAY;
            let is_flat = |touch: &Touch| dot(&touch.normal, &lead) >= 1.0 - PARALLEL;
            let mut room = left.min(ONE_WAY_ROOM);
            if room == ONE_WAY_ROOM && self.all.iter().filter(goes).all(is_flat) {
                // As a plane.
                let group = self.all.iter().filter(goes);
                let patch = patch::choose(group.map(|touch| (touch.point, touch.gap)), &lead);
                left -= patch.points.len().min(left);
                act(&lead, &patch);
            } else {
                left -= room;
                // What touches comes first, the deepest of it: on uneven ground that is not what is outermost, and what a unit stands
                // on has to be there in each substep.
                let most = least + NEAR * self.same;
                let mut near = room.min(TOUCHING);
                let mut last = f32::NEG_INFINITY;
                while near > 0 {
                    let next = |touch: &&Touch| touch.gap > last && touch.gap <= most;
                    let gaps = self.all.iter().filter(goes).filter(next).map(|touch| touch.gap);
                    last = gaps.fold(f32::INFINITY, f32::min);
                    if last == f32::INFINITY {
                        break;
                    }
                    let own = self.all.iter().filter(goes).filter(|touch| touch.gap == last);
                    for touch in own.take(near) {
                        touch.alone(&mut act);
                        (near, room) = (near - 1, room - 1);
                    }
                }
                let group = self.all.iter().filter(goes).filter(|touch| touch.gap > most);
                left += each_alone(group, (&lead, room), &mut act);
            }
            self.all.retain(|touch| !goes(&touch));
        }
    }
}

/// At most so many of these touches, and four, each a patch of its own. What room is left.
fn each_alone<'t>(
    group: impl Iterator<Item = &'t Touch> + Clone,
    (lead, mut room): (&Vector3<f32>, usize),
    act: &mut impl FnMut(&Vector3<f32>, &Patch),
) -> usize {
    let chosen = patch::choose(group.clone().map(|touch| (touch.point, touch.gap)), lead);
    for (point, gap) in chosen.points.iter().skip(usize::from(chosen.has_middle)).take(room) {
        // It is one of them, to the bit.
        let is_it = |touch: &&Touch| touch.point == *point && touch.gap == *gap;
        if let Some(touch) = group.clone().find(is_it) {
            touch.alone(act);
            room -= 1;
        }
    }
    room
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
            self.on_faces(&point, touches);
        }
        let (low, high) = self.swept(low, high);
        let Some([rows, columns]) = self.terrain.cells(&low, &high) else { return };
        let middle = rotate(&pose.rotation, &piece.middle);
        let hull = Hull { points: piece.points, rotation: pose.rotation };
        let up = self.terrain.face_below(&middle).map_or_else(Vector3::z, |face| face.normal);
        let reach =
            Reach { hull, middle, radius: piece.radius, far, up, lowest: self.lowest(&hull, &up) };
        let mut nearest = heapless::Vec::<(f32, Ridge), RIDGES>::new();
        for row in rows {
            for column in columns.clone() {
                if self.terrain.top(row, column) < low.z {
                    continue;
                }
                for ridge in self.terrain.ridges(row, column, self.dip) {
                    let Some(least) = self.least_gap(&ridge, &reach) else { continue };
                    if let Err(found) = nearest.push((least, ridge)) {
                        let farthest =
                            nearest.iter_mut().reduce(|a, b| if b.0 > a.0 { b } else { a });
                        if let Some(farthest) = farthest.filter(|farthest| farthest.0 > found.0) {
                            *farthest = found;
                        }
                    }
                }
            }
        }
        for (_, ridge) in &nearest {
            self.on_ridge(ridge, &reach, touches);
        }
    }

    /// How far a hull, grown by what makes the unit round, reaches against a direction.
    fn lowest(&self, hull: &Hull<'_>, up: &Vector3<f32>) -> f32 {
        dot(&hull.support(&-up), up) - self.round
    }

    /// The box that a box goes through in the substep, with all that it may touch.
    fn swept(&self, low: Vector3<f32>, high: Vector3<f32>) -> (Vector3<f32>, Vector3<f32>) {
        let around = Vector3::repeat(self.round + self.margin);
        let none = Vector3::zeros();
        (low + self.way.inf(&none) - around, high + self.way.sup(&none) + around)
    }

    /// Where a point of the hull, or the middle of a ball, is over or under faces.
    fn on_faces(&self, point: &Vector3<f32>, touches: &mut Touches) {
        let (low, high) = self.swept(*point, *point);
        let Some([rows, columns]) = self.terrain.cells(&low, &high) else { return };
        let touch = |normal: &Vector3<f32>, above: f32| Touch {
            point: point - normal * self.round,
            gap: above - self.round,
            normal: *normal,
        };
        // What is deeper has not come from above.
        let deepest = -(self.radius + norm(&self.way));
        let below = self.terrain.face_below(point).filter(|face| {
            let above = face.above(point);
            above < 0.0 && above >= deepest
        });
        // Faces that the point is over, or under: of those it leaves by the one that it is least deep under.
        let each = |act: &mut dyn FnMut(Touch, f32)| {
            for row in rows.clone() {
                for column in columns.clone() {
                    if self.terrain.top(row, column) < low.z {
                        continue;
                    }
                    for face in self.terrain.faces(row, column) {
                        let above = face.above(point);
                        let is_there = above - self.round < self.reach(&face.normal)
                            && above >= deepest
                            && (above >= 0.0 || below.is_some())
                            && face.has_foot_of(point, above);
                        if is_there {
                            act(touch(&face.normal, above), above);
                        }
                    }
                }
            }
        };
        let mut least_deep: Option<Touch> = None;
        if let Some(face) = &below {
            each(&mut |found, above| {
                if above < 0.0 && least_deep.is_none_or(|least| found.gap > least.gap) {
                    least_deep = Some(found);
                }
            });
            // Under a ridge it may be under no face's normal.
            least_deep = least_deep.or_else(|| Some(touch(&face.normal, face.above(point))));
        }
        each(&mut |found, above| {
            // Not out of the other side of a thin wall.
            let is_same_side =
                least_deep.is_none_or(|least| dot(&least.normal, &found.normal) > 0.0);
            if above >= 0.0 || (above >= -SHALLOW * self.radius && is_same_side) {
                touches.add(found);
            }
        });
        if let Some(found) = least_deep {
            touches.add(found);
        }
    }

    /// A gap that an edge has to the hull at least; none where that does not close.
    fn least_gap(&self, ridge: &Ridge, reach: &Reach<'_>) -> Option<f32> {
        let Reach { middle, radius, far, .. } = reach;
        let [nearest, _, _] = part_of(ridge, middle, 0.0);
        let apart = norm(&(nearest - middle)) - self.round;
        if apart > radius + far {
            return None;
        }
        if self.round > 0.0 {
            return Some(apart);
        }
        let [start, end] = &ridge.ends;
        let highest = |up: &Vector3<f32>| dot(up, start).max(dot(up, end));
        let between = ridge.middle_normal();
        let along = self.lowest(&reach.hull, &between) - highest(&between);
        let above = reach.lowest - highest(&reach.up);
        (along <= self.reach(&between) && above <= self.reach(&reach.up)).then(|| along.max(above))
    }

    /// Where an edge that sticks out meets the hull.
    fn on_ridge(&self, ridge: &Ridge, reach: &Reach<'_>, touches: &mut Touches) {
        let Reach { hull, middle, radius, far, .. } = reach;
        // No more of it than a ball around the piece can reach: of long edges f32 would lose digits.
        let [_, centre, half] = part_of(ridge, middle, radius + self.round + far);
        let (length, between) = (norm(&half), ridge.middle_normal());
        let ends = [Point3::from(-half), Point3::from(half)];
        let edge = Hull { points: &ends, rotation: Matrix3::identity() };
        let apart = -centre;
        let hulls = [&edge, hull];
        let sizes = [self.radius, self.radius + length, *far];
        let met: Meeting =
            meeting(hulls, [0.0, self.round], (&apart, &(middle - centre), Some(between)), sizes);
        let (gap, normal) = (met.gap, met.normal);
        if gap > self.reach(&normal) || !self.terrain.sticks_out(ridge, &normal) {
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
