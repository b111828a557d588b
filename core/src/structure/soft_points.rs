//! State and scratch of soft bodies: below the scene, which holds them.

use crate::limits::ANCHORS;
use crate::slices::{copy_slice, rows_mut, slice_at_mut};
use nalgebra::{Point3, Vector3};

/// Directions in which the hull of a rigid unit is felt for.
pub(crate) const FELT: usize = 258;
/// Changes of motion by springs and contact that the network is told, m/s.
const CHANGE_CLAMP_M_S: f32 = 10.0;
/// Points of all copies: an f32 counts them.
pub(crate) const MAX_ROWS: usize = 1 << 24;
/// Numbers of a mass, a spring, a rigid unit, and a unit's blend.
pub(crate) const MASS: usize = 4;
pub(crate) const SPRING: usize = 4;
pub(crate) const RIGID: usize = 9;
pub(crate) const BLEND: usize = 9 + ANCHORS * 3;
/// Numbers of a point beside its springs.
const POINT: usize = 3 + 6 + 9 + 2 + MASS;

/// Numbers that so many units and points take.
pub(crate) const fn numbers(units: usize, points: usize, neighbours: usize) -> usize {
    if neighbours == 0 {
        return 0;
    }
    let point = POINT + SPRING * neighbours;
    points.saturating_mul(point).saturating_add(units.saturating_mul(FELT + RIGID + BLEND))
}

/// State and scratch of a scene's soft bodies, rows by the number of a point through all copies. Of rigid units' points they are not
/// used.
pub(crate) struct SoftPoints<'s> {
    /// (points, 3) at rest.
    pub(crate) rest: &'s mut [f32],
    /// (points, way in the last step and place)
    pub(crate) state: &'s mut [f32],
    /// (points, 3) where the step under way takes points.
    pub(crate) after: &'s mut [f32],
    /// (points, 3) their velocities then, m/s.
    pub(crate) velocity: &'s mut [f32],
    /// (points, 3) where masses were before a sub-step; scratch.
    pub(crate) before: &'s mut [f32],
    /// (points) the first point that is the same mass.
    pub(crate) owner: &'s mut [f32],
    /// (points) its number among the points as its owner gave them.
    pub(crate) given: &'s mut [f32],
    /// (points) of masses: 1 / kg, friction, how many points they are, spacing of their body in metres. The first is 0 where another point stands for the mass.
    pub(crate) masses: &'s mut [f32],
    /// (springs) two masses, length, compliance m/N.
    pub(crate) springs: &'s mut [f32],
    /// (units, felt) how far rigid units reach in each felt direction, metres.
    pub(crate) supports: &'s mut [f32],
    /// (units) of rigid ones: centre, velocity, centre before a sub-step.
    pub(crate) rigid: &'s mut [f32],
    /// (units) rotation of a patch by the network, and of its anchors the rest of the way.
    pub(crate) blends: &'s mut [f32],
    /// Springs of a copy.
    pub(crate) count: usize,
    /// Mean radius of the soft units at rest, metres.
    pub(crate) size_m: f32,
}

pub(crate) fn vector(matrix: &[f32], row: usize) -> Vector3<f32> {
    match matrix.get(row * 3..row * 3 + 3) {
        Some([x, y, z]) => Vector3::new(*x, *y, *z),
        _ => Vector3::zeros(),
    }
}

pub(crate) fn set(matrix: &mut [f32], row: usize, v: &Vector3<f32>) {
    if let Some(slots) = matrix.get_mut(row * 3..row * 3 + 3) {
        slots.copy_from_slice(&[v.x, v.y, v.z]);
    }
}

pub(crate) fn number(list: &[f32], at: usize) -> f32 {
    list.get(at).copied().unwrap_or_default()
}

pub(crate) fn put(list: &mut [f32], at: usize, value: f32) {
    if let Some(slot) = list.get_mut(at) {
        *slot = value;
    }
}

/// Copies a part of a list over another one of the same length, by their numbers.
pub(crate) fn repeat(list: &mut [f32], length: usize, from: usize, to: usize) {
    let (low, high) = (from.min(to), from.max(to));
    let (left, right) = list.split_at_mut((high * length).min(list.len()));
    let (low, high) = (slice_at_mut(left, low * length, length), slice_at_mut(right, 0, length));
    if from < to { copy_slice(low, high) } else { copy_slice(high, low) }
}

impl<'s> SoftPoints<'s> {
    /// Makes a copy of the scene, of so many units and points, what another one is.
    pub(crate) fn replicate(&mut self, (units, points): (usize, usize), from: usize, to: usize) {
        let SoftPoints { rest, state, owner, given, masses, springs, supports, count, .. } = self;
        repeat(rest, points * 3, from, to);
        repeat(state, points * 6, from, to);
        repeat(owner, points, from, to);
        repeat(given, points, from, to);
        repeat(masses, points * MASS, from, to);
        repeat(springs, *count * SPRING, from, to);
        repeat(supports, units * FELT, from, to);
        // Rows are counted through all copies. An f32 holds each: see `MAX_ROWS`.
        let shift = to as f32 * points as f32 - from as f32 * points as f32;
        slice_at_mut(owner, to * points, points).iter_mut().for_each(|row| *row += shift);
        let length = *count * SPRING;
        for spring in rows_mut(slice_at_mut(springs, to * length, length), SPRING) {
            spring.iter_mut().take(2).for_each(|row| *row += shift);
        }
    }

    /// Carves everything off a buffer of [`numbers`].
    pub(crate) fn carve(
        buffer: &'s mut [f32],
        units: usize,
        points: usize,
        neighbours: usize,
    ) -> Self {
        let (units, points) = if neighbours == 0 { (0, 0) } else { (units, points) };
        let mut rest = buffer;
        let mut take = |length: usize| {
            let slab = core::mem::take(&mut rest);
            let (head, tail) = slab.split_at_mut(length.min(slab.len()));
            rest = tail;
            head
        };
        SoftPoints {
            rest: take(points * 3),
            state: take(points * 6),
            after: take(points * 3),
            velocity: take(points * 3),
            before: take(points * 3),
            owner: take(points),
            given: take(points),
            masses: take(points * MASS),
            springs: take(points * neighbours * SPRING),
            supports: take(units * FELT),
            rigid: take(units * RIGID),
            blends: take(units * BLEND),
            count: 0,
            size_m: 0.0,
        }
    }

    pub(crate) fn current(&self, row: usize) -> Vector3<f32> {
        vector(self.state, row * 2 + 1)
    }

    /// The way of a point in the last step, metres.
    pub(crate) fn increment(&self, row: usize) -> Vector3<f32> {
        vector(self.state, row * 2)
    }

    /// Where a point is at rest.
    pub(crate) fn rest(&self, row: usize) -> Vector3<f32> {
        vector(self.rest, row)
    }

    /// Says where a point is at rest, and which one its owner gave it as.
    pub(crate) fn set_rest(&mut self, row: usize, rest: &Vector3<f32>, given: usize) {
        set(self.rest, row, rest);
        put(self.given, row, given as f32);
    }

    /// Says how far a point came in the last step, and where it is.
    pub(crate) fn set_state(&mut self, row: usize, way: &Vector3<f32>, current: &Vector3<f32>) {
        set(self.state, row * 2, way);
        set(self.state, row * 2 + 1, current);
    }

    /// Of a point: its number among those that its owner gave, and where it is, metres.
    pub(crate) fn numbered_point(&self, row: usize) -> (usize, Point3<f32>) {
        (number(self.given, row) as usize, Point3::from(self.current(row)))
    }

    pub(crate) fn owner(&self, row: usize) -> usize {
        number(self.owner, row) as usize
    }

    pub(crate) fn lightness(&self, row: usize) -> f32 {
        number(self.masses, row * MASS)
    }

    pub(crate) fn friction(&self, row: usize) -> f32 {
        number(self.masses, row * MASS + 1)
    }

    /// What springs and contact change of a point's way in a step of so many seconds under gravity, as a velocity, and of its
    /// velocity, m/s.
    pub(crate) fn changes(&self, dt: f32, gravity: &Vector3<f32>, row: usize) -> [Vector3<f32>; 2] {
        let fall = gravity * dt;
        let increment = self.increment(row);
        let way = (vector(self.after, row) - ((self.current(row) + increment) + fall * dt)) / dt;
        let rate = vector(self.velocity, row) - (increment / dt + fall * 1.5);
        [way, rate].map(|change| change.map(|v| v.clamp(-CHANGE_CLAMP_M_S, CHANGE_CLAMP_M_S)))
    }
}
