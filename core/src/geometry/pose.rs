//! A unit's rotation and centre, and its conversions to nalgebra's isometry.

use super::dot;
use crate::math;
use nalgebra::{Isometry3, Matrix3, Point3, Quaternion, Translation3, UnitQuaternion, Vector3};

/// Numbers of a pose in a row: rotation by columns, then centre.
pub(crate) const POSE: usize = 12;
/// Sines of smaller angles are the angles, radians: an f32 knows no difference.
const SMALL_RAD: f32 = 1e-6;

/// Rotation and centre of a unit: `x = rotation * local + centre`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pose {
    /// Local frame to world.
    pub rotation: Matrix3<f32>,
    /// The unit's centre in the world, metres.
    pub centre: Vector3<f32>,
}

impl Default for Pose {
    fn default() -> Self {
        Pose { rotation: Matrix3::identity(), centre: Vector3::zeros() }
    }
}

impl Pose {
    /// Whether it is another pose to the bit.
    #[cfg(rigidformer_host)]
    pub(crate) fn has_bits_of(&self, other: &Pose) -> bool {
        let numbers = |pose: &Pose| {
            let mut row = [0.0; POSE];
            write_pose(pose, &mut row);
            row.map(f32::to_bits)
        };
        numbers(self) == numbers(other)
    }

    /// World position of a local point.
    pub fn apply(&self, local: &Vector3<f32>) -> Vector3<f32> {
        rotate(&self.rotation, local) + self.centre
    }

    /// How far a local point is from where another pose has it, metres: without the digits
    /// that subtracting two world positions would lose.
    pub fn displacement_from(&self, other: &Pose, local: &Vector3<f32>) -> Vector3<f32> {
        // The operator is a loop where the compiler is after small code; Helium has the flash for less.
        #[cfg(rigidformer_helium)]
        let turned = rotate_here(&difference(&self.rotation, &other.rotation), local);
        #[cfg(not(rigidformer_helium))]
        let turned = rotate(&(self.rotation - other.rotation), local);
        turned + (self.centre - other.centre)
    }

    /// Local coordinates of a world point.
    pub fn local(&self, world: &Vector3<f32>) -> Vector3<f32> {
        rotate_back(&self.rotation, &(world - self.centre))
    }

    /// From an isometry of the reference frame, in which the unit's centre is `offset`.
    pub fn from_isometry(isometry: &Isometry3<f32>, offset: &Point3<f32>) -> Self {
        let rotation = rotation_of(&isometry.rotation.as_ref().coords.into());
        let centre = rotate(&rotation, &offset.coords) + isometry.translation.vector;
        Pose { rotation, centre }
    }

    /// The isometry of the reference frame, in which the unit's centre is `offset`.
    pub fn isometry(&self, offset: &Point3<f32>) -> Isometry3<f32> {
        let translation = self.centre - rotate(&self.rotation, &offset.coords);
        Isometry3::from_parts(Translation3::from(translation), quaternion(&self.rotation))
    }

    /// Whether every number is finite and the centre within `limit` metres of the origin.
    pub fn is_sound(&self, limit: f32) -> bool {
        self.rotation.iter().all(|v| v.is_finite()) && self.centre.iter().all(|v| v.abs() <= limit)
    }
}

/// Writes a pose to the first [`POSE`] numbers of a row.
pub(crate) fn write_pose(pose: &Pose, row: &mut [f32]) {
    let Pose { rotation: r, centre: c } = pose;
    if let Some(row) = row.first_chunk_mut() {
        *row = [r.m11, r.m21, r.m31, r.m12, r.m22, r.m32, r.m13, r.m23, r.m33, c.x, c.y, c.z];
    }
}

/// The rotation of a quaternion x, y, z, w.
pub(crate) fn rotation_of([x, y, z, w]: &[f32; 4]) -> Matrix3<f32> {
    // A quaternion from a file is of unit length to rounding only.
    let s = 2.0 / ((x * x + y * y) + (z * z + w * w));
    Matrix3::new(
        1.0 - s * (y * y + z * z),
        s * (x * y - w * z),
        s * (x * z + w * y),
        s * (x * y + w * z),
        1.0 - s * (x * x + z * z),
        s * (y * z - w * x),
        s * (x * z - w * y),
        s * (y * z + w * x),
        1.0 - s * (x * x + y * y),
    )
}

/// What [`write_pose`] wrote.
pub(crate) fn read_pose(row: &[f32]) -> Pose {
    let [a, b, c, d, e, f, g, h, i, x, y, z] = row.first_chunk().copied().unwrap_or_default();
    Pose { rotation: Matrix3::new(a, d, g, b, e, h, c, f, i), centre: Vector3::new(x, y, z) }
}

/// a - b, element by element.
#[cfg(rigidformer_helium)]
#[inline(always)]
fn difference(a: &Matrix3<f32>, b: &Matrix3<f32>) -> Matrix3<f32> {
    Matrix3::new(
        a.m11 - b.m11,
        a.m12 - b.m12,
        a.m13 - b.m13,
        a.m21 - b.m21,
        a.m22 - b.m22,
        a.m23 - b.m23,
        a.m31 - b.m31,
        a.m32 - b.m32,
        a.m33 - b.m33,
    )
}

/// Matrix times vector in one fixed order.
#[cfg_attr(rigidformer_dsp, inline(never))]
pub(crate) fn rotate(r: &Matrix3<f32>, v: &Vector3<f32>) -> Vector3<f32> {
    rotate_here(r, v)
}

/// As [`rotate`], where the call is worth saving.
#[inline(always)]
pub(super) fn rotate_here(r: &Matrix3<f32>, v: &Vector3<f32>) -> Vector3<f32> {
    Vector3::new(
        (r.m11 * v.x + r.m12 * v.y) + r.m13 * v.z,
        (r.m21 * v.x + r.m22 * v.y) + r.m23 * v.z,
        (r.m31 * v.x + r.m32 * v.y) + r.m33 * v.z,
    )
}

/// Transposed matrix times vector in one fixed order.
#[cfg_attr(rigidformer_dsp, inline(never))]
pub(crate) fn rotate_back(r: &Matrix3<f32>, v: &Vector3<f32>) -> Vector3<f32> {
    rotate_back_here(r, v)
}

/// As [`rotate_back`], where the call is worth saving.
#[inline(always)]
pub(super) fn rotate_back_here(r: &Matrix3<f32>, v: &Vector3<f32>) -> Vector3<f32> {
    Vector3::new(
        (r.m11 * v.x + r.m21 * v.y) + r.m31 * v.z,
        (r.m12 * v.x + r.m22 * v.y) + r.m32 * v.z,
        (r.m13 * v.x + r.m23 * v.y) + r.m33 * v.z,
    )
}

/// Columns of a matrix.
pub(crate) fn columns(r: &Matrix3<f32>) -> [Vector3<f32>; 3] {
    [
        Vector3::new(r.m11, r.m21, r.m31),
        Vector3::new(r.m12, r.m22, r.m32),
        Vector3::new(r.m13, r.m23, r.m33),
    ]
}

/// Matrix product in one fixed order.
#[cfg_attr(rigidformer_dsp, inline(never))]
pub(crate) fn product(a: &Matrix3<f32>, b: &Matrix3<f32>) -> Matrix3<f32> {
    let [x, y, z] = columns(b).map(|column| rotate(a, &column));
    Matrix3::new(x.x, y.x, z.x, x.y, y.y, z.y, x.z, y.z, z.z)
}

/// a bᵀ in one fixed order.
pub(crate) fn product_transposed(a: &Matrix3<f32>, b: &Matrix3<f32>) -> Matrix3<f32> {
    product(a, &Matrix3::new(b.m11, b.m21, b.m31, b.m12, b.m22, b.m32, b.m13, b.m23, b.m33))
}

/// Where a motion began that leads to `now` in `share` of the time that it takes from `before`: the same velocity and
/// spin.
pub(crate) fn turned_by(now: &Pose, before: &Pose, share: f32) -> Pose {
    let turn = product_transposed(&now.rotation, &before.rotation);
    let q = quaternion(&turn).as_ref().coords;
    let sine = math::sqrt((q.x * q.x + q.y * q.y) + q.z * q.z);
    // Half of the angle; a turn too small to have an axis is none.
    let (new_sine, new_cosine) = math::sin_cos(libm::atan2f(sine, q.w) * -share);
    let k = if sine > 0.0 { new_sine / sine } else { 0.0 };
    let back = Quaternion::new(new_cosine, q.x * k, q.y * k, q.z * k);
    let back = Isometry3::from_parts(Translation3::identity(), UnitQuaternion::new_unchecked(back));
    let back = Pose::from_isometry(&back, &Point3::origin()).rotation;
    let centre = now.centre - (now.centre - before.centre) * share;
    Pose { rotation: product(&back, &now.rotation), centre }
}

/// The turn that leads from one rotation to another: radians, along its axis, at most half a turn.
pub(crate) fn turn_between(before: &Matrix3<f32>, now: &Matrix3<f32>) -> Vector3<f32> {
    let q = quaternion(&product_transposed(now, before)).as_ref().coords;
    let sine = math::sqrt((q.x * q.x + q.y * q.y) + q.z * q.z);
    // A turn too small to have an axis is none.
    let k = if sine > 0.0 { 2.0 * libm::atan2f(sine, q.w) / sine } else { 0.0 };
    Vector3::new(q.x * k, q.y * k, q.z * k)
}

/// A rotation turned by radians along an axis (Rodrigues).
pub(crate) fn turned(rotation: &Matrix3<f32>, turn: &Vector3<f32>) -> Matrix3<f32> {
    let (once, twice) = shares(turn);
    let [x, y, z] = columns(rotation).map(|v| {
        let across = turn.cross(&v);
        v + (across * once + turn.cross(&across) * twice)
    });
    Matrix3::new(x.x, y.x, z.x, x.y, y.y, z.y, x.z, y.z, z.z)
}

/// How far a turn takes the point at a lever, metres.
pub(crate) fn swing(turn: &Vector3<f32>, lever: &Vector3<f32>) -> Vector3<f32> {
    let (once, twice) = shares(turn);
    let across = turn.cross(lever);
    across * once + turn.cross(&across) * twice
}

/// How much of a turn once and twice across a vector is how far it takes that.
#[cfg_attr(rigidformer_dsp, inline(never))]
pub(super) fn shares(turn: &Vector3<f32>) -> (f32, f32) {
    let angle = math::sqrt(dot(turn, turn));
    let is_small = angle < SMALL_RAD;
    // By half of the angle: 1 - cos has no digits left where the turn is small.
    let (sine, cosine) = math::sin_cos(0.5 * angle);
    // The compiler may divide before it chooses, and 0 / 0 is not to be computed.
    let share = sine / if is_small { 1.0 } else { angle };
    if is_small { (1.0, 0.5) } else { (2.0 * share * cosine, 2.0 * share * share) }
}

/// Quaternion of a rotation matrix by its largest component, w not negative.
#[cfg_attr(rigidformer_dsp, inline(never))]
fn quaternion(r: &Matrix3<f32>) -> UnitQuaternion<f32> {
    let (a, b, c) = (r.m11, r.m22, r.m33);
    let squares = [1.0 + a + b + c, 1.0 + a - b - c, 1.0 - a + b - c, 1.0 - a - b + c];
    let [w2, x2, y2, z2] = squares;
    let (w, x, y, z) = if w2 >= x2 && w2 >= y2 && w2 >= z2 {
        (w2, r.m32 - r.m23, r.m13 - r.m31, r.m21 - r.m12)
    } else if x2 >= y2 && x2 >= z2 {
        (r.m32 - r.m23, x2, r.m21 + r.m12, r.m13 + r.m31)
    } else if y2 >= z2 {
        (r.m13 - r.m31, r.m21 + r.m12, y2, r.m32 + r.m23)
    } else {
        (r.m21 - r.m12, r.m13 + r.m31, r.m32 + r.m23, z2)
    };
    let sign = if w < 0.0 { -1.0 } else { 1.0 };
    let length = math::sqrt((w * w + x * x) + (y * y + z * z));
    let scale = if length > 0.0 { sign / length } else { 0.0 };
    let q = Quaternion::new(w * scale, x * scale, y * scale, z * scale);
    UnitQuaternion::new_unchecked(q)
}

/// Unit vector along v, or `None` when v is too short to have a direction.
pub(crate) fn direction(v: &Vector3<f32>) -> Option<Vector3<f32>> {
    let length2 = dot(v, v);
    (length2 > f32::MIN_POSITIVE && length2.is_finite()).then(|| v * (1.0 / math::sqrt(length2)))
}
