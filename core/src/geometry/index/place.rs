//! Moves units and the boxes around them to where they are now, once a step.

use super::layout::{Boxes, Head, WIDTH, bits};
use super::parts::Parts;
use crate::geometry::pose::{columns, rotate};
use crate::geometry::{Pose, dot};
use nalgebra::Vector3;

/// What is added to each side of a unit's box, as a share of its radius and of its centre's
/// coordinates: `search` says how much it takes.
const OF_RADIUS: f32 = 1e-4;
const OF_CENTRE: f32 = 1e-6;
/// How far the products of a rotation's columns may be from those of axes, for a box to be
/// trusted.
const SKEW: f32 = 1e-5;

const EMPTY: Boxes = {
    let (low, high) = ([f32::INFINITY; WIDTH], [f32::NEG_INFINITY; WIDTH]);
    [low, low, low, high, high, high]
};

impl Parts<'_> {
    /// Places the units of all copies, copy after copy, given their poses, radii and bodies. Units of the same body, other
    /// than 0, are not looked at for each other.
    pub(crate) fn place<'p>(
        &mut self,
        per_copy: usize,
        units: impl Iterator<Item = (&'p Pose, f32, u32)>,
    ) {
        let per_copy = per_copy.max(1);
        for (i, ((pose, radius, body), frame)) in units.zip(self.frames.iter_mut()).enumerate() {
            let (r, c) = (&pose.rotation, &pose.centre);
            #[rustfmt::skip]
            let numbers = [r.m11, r.m12, r.m13, r.m21, r.m22, r.m23, r.m31, r.m32, r.m33, c.x, c.y, c.z,
                bits(body as usize)];
            *frame = numbers;
            let unit = i % per_copy;
            let group = i / per_copy * per_copy.div_ceil(WIDTH) + unit / WIDTH;
            let (Some(group), Some(head)) = (self.groups.get_mut(group), self.heads.get(unit))
            else {
                return;
            };
            if unit.is_multiple_of(WIDTH) {
                *group = EMPTY;
            }
            for (line, side) in group.iter_mut().zip(around(head, pose, radius)) {
                if let Some(slot) = line.get_mut(unit % WIDTH) {
                    *slot = side;
                }
            }
        }
    }
}

/// A box in the world around a unit's local box, and within one around its sphere.
fn around([lx, ly, lz, hx, hy, hz, ..]: &Head, pose: &Pose, radius: f32) -> [f32; 6] {
    if !is_straight(pose) {
        let everywhere = [f32::INFINITY; 3];
        return join(everywhere.map(|side| -side), everywhere);
    }
    let (low, high) = (Vector3::new(*lx, *ly, *lz), Vector3::new(*hx, *hy, *hz));
    let middle = rotate(&pose.rotation, &((low + high) * 0.5)) + pose.centre;
    let half = rotate(&pose.rotation.map(f32::abs), &((high - low) * 0.5));
    let largest = pose.centre.iter().fold(0.0_f32, |most, v| most.max(v.abs()));
    let spare = OF_RADIUS * radius + OF_CENTRE * (largest + radius);
    let side = |sign: f32, inner: fn(f32, f32) -> f32| -> [f32; 3] {
        let (of_box, of_sphere) = (middle + half * sign, pose.centre.add_scalar(sign * radius));
        of_box.zip_map(&of_sphere, inner).add_scalar(sign * spare).into()
    };
    join(side(-1.0, f32::max), side(1.0, f32::min))
}

fn join([a, b, c]: [f32; 3], [d, e, f]: [f32; 3]) -> [f32; 6] {
    [a, b, c, d, e, f]
}

/// Whether a pose keeps lengths and angles. Rotations do to rounding, but for those of units whose
/// points are on a line: theirs are turned on from step to step, and errors with them.
fn is_straight(pose: &Pose) -> bool {
    let [x, y, z] = columns(&pose.rotation);
    let ones = [&x, &y, &z].map(|v| dot(v, v) - 1.0);
    let zeros = [dot(&x, &y), dot(&y, &z), dot(&z, &x)];
    ones.iter().chain(&zeros).all(|v| v.abs() <= SKEW)
}
