//! Kabsch: the rigid motion that carries reference points onto targets (paper, eq. 4).

use super::jacobi::leading_svd_here;
use super::pose::{Pose, direction, rotate};
use super::{dot, norm};
use crate::kernels::in_own_environment;
use nalgebra::{Matrix3, Vector3};

/// Second singular value, relative to the first, below which anchors count as collinear:
/// the covariance is only known to f32 rounding.
const COLLINEAR: f32 = 1e-6;

/// What the points determined of the rotation.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Rank {
    /// All of it.
    Full,
    /// One direction: the points are collinear. The rotation about it is the one closest
    /// to the previous rotation.
    Line,
    /// Nothing: the points coincide. The rotation is the previous one.
    Point,
}

/// A fitted pose and how well determined it is.
#[derive(Clone, Copy, Debug)]
pub struct Fit {
    /// Carries reference points onto the targets.
    pub pose: Pose,
    /// What was determined.
    pub rank: Rank,
    /// Mean of the reference points; the rotation is about it.
    pub from: Vector3<f32>,
    /// Mean of the targets.
    pub to: Vector3<f32>,
}

/// Least-squares rigid fit of `target` to `reference` (pairs in order, metres), always a
/// proper rotation. Where the points leave freedom, the answer is the rotation closest to
/// `previous`; mirrored targets give the best proper rotation. Coordinates up to 1e18 never give NaN.
///
/// ```
/// use nalgebra::{Matrix3, Vector3};
/// use rigidformer_core::geometry::{kabsch, Rank};
/// let reference = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]].map(Vector3::from);
/// let target = reference.map(|p| p + Vector3::new(0.0, 0.0, 2.0));
/// let fit = kabsch(&reference, &target, &Matrix3::identity());
/// assert_eq!(fit.rank, Rank::Full);
/// assert!((fit.pose.centre.z - 2.0).abs() < 1e-6);
/// ```
pub fn kabsch(reference: &[Vector3<f32>], target: &[Vector3<f32>], previous: &Matrix3<f32>) -> Fit {
    in_own_environment(|| kabsch_here(reference, target, previous))
}

pub(crate) fn kabsch_here(
    reference: &[Vector3<f32>],
    target: &[Vector3<f32>],
    previous: &Matrix3<f32>,
) -> Fit {
    let from = mean(reference);
    let to = mean(target);
    let from_scale = extent(reference, &from);
    let to_scale = extent(target, &to);
    let mut covariance = Matrix3::zeros();
    if from_scale > 0.0 && to_scale > 0.0 {
        for (r, t) in reference.iter().zip(target) {
            let r = (r - from) / from_scale;
            let t = (t - to) / to_scale;
            covariance += outer(&t, &r);
        }
    }
    finish(&covariance, &from, &to, previous)
}

/// As [`kabsch`] with sums in f64: for whole point sets, where a spin read off two frames
/// 1/240 s apart needs the digits and the order of points should not show.
pub fn kabsch_f64<'p>(
    pairs: impl Iterator<Item = (&'p Vector3<f32>, &'p Vector3<f32>)> + Clone,
    previous: &Matrix3<f32>,
) -> Fit {
    in_own_environment(|| kabsch_f64_here(pairs, previous))
}

pub(crate) fn kabsch_f64_here<'p>(
    pairs: impl Iterator<Item = (&'p Vector3<f32>, &'p Vector3<f32>)> + Clone,
    previous: &Matrix3<f32>,
) -> Fit {
    let mut count = 0.0_f64;
    let mut from = Vector3::<f64>::zeros();
    let mut to = Vector3::<f64>::zeros();
    for (r, t) in pairs.clone() {
        count += 1.0;
        from += r.cast::<f64>();
        to += t.cast::<f64>();
    }
    if count > 0.0 {
        from /= count;
        to /= count;
    }
    let mut sum = Matrix3::<f64>::zeros();
    for (r, t) in pairs {
        let r = r.cast::<f64>() - from;
        let t = t.cast::<f64>() - to;
        sum += t * r.transpose();
    }
    finish(&scaled(&sum), &from.map(|v| v as f32), &to.map(|v| v as f32), previous)
}

/// The turn that fits a sum of targets times references best; none where that leaves it open.
#[cfg(feature = "deform")]
pub(crate) fn turn_that_fits(sum: &Matrix3<f64>) -> Matrix3<f32> {
    nearest_rotation(&scaled(sum), &Matrix3::identity()).0
}

/// A covariance as f32 can hold it, whatever its size.
fn scaled(sum: &Matrix3<f64>) -> Matrix3<f32> {
    let largest = sum.iter().fold(0.0_f64, |a, v| a.max(v.abs()));
    let scale = if largest > 0.0 { 1.0 / largest } else { 0.0 };
    sum.map(|v| (v * scale) as f32)
}

fn finish(
    covariance: &Matrix3<f32>,
    from: &Vector3<f32>,
    to: &Vector3<f32>,
    previous: &Matrix3<f32>,
) -> Fit {
    let (rotation, rank) = nearest_rotation(covariance, previous);
    let pose = Pose { rotation, centre: to - rotate(&rotation, from) };
    Fit { pose, rank, from: *from, to: *to }
}

/// The proper rotation R that maximises tr(Rᵀ H), and among equals is closest to `previous`.
fn nearest_rotation(h: &Matrix3<f32>, previous: &Matrix3<f32>) -> (Matrix3<f32>, Rank) {
    let svd = leading_svd_here(h);
    let [first, second, _] = svd.values;
    let [left, left_second] = svd.left;
    let [right, right_second] = svd.right;
    let (Some(u), Some(v)) = (direction(&left), direction(&right)) else {
        return (*previous, Rank::Point);
    };
    if second > first * COLLINEAR {
        // Made orthogonal again: rounding tilts the second pair when it is much shorter.
        let u2 = direction(&(left_second - u * dot(&u, &left_second)));
        let v2 = direction(&(right_second - v * dot(&v, &right_second)));
        if let (Some(u2), Some(v2)) = (u2, v2) {
            // Third vectors by cross product make the determinant +1 by construction,
            // which is diag(1, 1, det(V Uᵀ)) without computing it.
            let rotation = outer(&u, &v) + outer(&u2, &v2) + outer(&u.cross(&u2), &v.cross(&v2));
            return (rotation, Rank::Full);
        }
    }
    let axis = rotate(previous, &v);
    let swing = shortest_turn(&direction(&axis).unwrap_or(u), &u);
    (orthonormal(&super::pose::product(&swing, previous)), Rank::Line)
}

/// Takes the rounding out of a product of rotations, which would otherwise add up over
/// steps, by Gram and Schmidt.
pub(crate) fn orthonormal(r: &Matrix3<f32>) -> Matrix3<f32> {
    let [x, y, _] = super::pose::columns(r);
    let Some(x) = direction(&x) else { return *r };
    let Some(y) = direction(&(y - x * dot(&x, &y))) else { return *r };
    let z = x.cross(&y);
    Matrix3::new(x.x, y.x, z.x, x.y, y.y, z.y, x.z, y.z, z.z)
}

/// The rotation of least angle that carries unit vector a onto unit vector b.
fn shortest_turn(a: &Vector3<f32>, b: &Vector3<f32>) -> Matrix3<f32> {
    if dot(a, b) >= 0.0 {
        return quarter_turn(a, b);
    }
    // The formula for small angles loses its digits towards opposite vectors: half a turn
    // first, about the same axis. Where they are opposite, any perpendicular axis does.
    let across = a.cross(b);
    let axis = direction(&(across - a * dot(a, &across)))
        .unwrap_or_else(|| direction(&a.cross(&least_aligned(a))).unwrap_or(*a));
    let half = outer(&axis, &axis) * 2.0 - Matrix3::identity();
    super::pose::product(&quarter_turn(&-a, b), &half)
}

/// As [`shortest_turn`], for vectors at most a right angle apart.
fn quarter_turn(a: &Vector3<f32>, b: &Vector3<f32>) -> Matrix3<f32> {
    let cos = dot(a, b);
    let axis = a.cross(b);
    let k = 1.0 / (1.0 + cos);
    Matrix3::new(
        cos + axis.x * axis.x * k,
        axis.x * axis.y * k - axis.z,
        axis.x * axis.z * k + axis.y,
        axis.y * axis.x * k + axis.z,
        cos + axis.y * axis.y * k,
        axis.y * axis.z * k - axis.x,
        axis.z * axis.x * k - axis.y,
        axis.z * axis.y * k + axis.x,
        cos + axis.z * axis.z * k,
    )
}

/// The coordinate axis that a leans on least.
fn least_aligned(a: &Vector3<f32>) -> Vector3<f32> {
    if a.x.abs() <= a.y.abs() && a.x.abs() <= a.z.abs() {
        Vector3::new(1.0, 0.0, 0.0)
    } else if a.y.abs() <= a.z.abs() {
        Vector3::new(0.0, 1.0, 0.0)
    } else {
        Vector3::new(0.0, 0.0, 1.0)
    }
}

fn outer(a: &Vector3<f32>, b: &Vector3<f32>) -> Matrix3<f32> {
    Matrix3::new(
        a.x * b.x,
        a.x * b.y,
        a.x * b.z,
        a.y * b.x,
        a.y * b.y,
        a.y * b.z,
        a.z * b.x,
        a.z * b.y,
        a.z * b.z,
    )
}

fn mean(points: &[Vector3<f32>]) -> Vector3<f32> {
    let share = 1.0 / points.len().max(1) as f32;
    points.iter().fold(Vector3::zeros(), |sum, p| sum + p * share)
}

/// Largest coordinate of any point relative to the mean, so that squares neither overflow
/// nor vanish.
fn extent(points: &[Vector3<f32>], mean: &Vector3<f32>) -> f32 {
    points.iter().fold(0.0_f32, |largest, p| {
        let d = p - mean;
        largest.max(d.x.abs()).max(d.y.abs()).max(d.z.abs())
    })
}

impl Fit {
    /// The pose of a frame whose origin lies at `offset` in the reference: by way of the
    /// means, which are near it, where going by the world's origin would cost digits.
    pub fn pose_at(&self, offset: &Vector3<f32>) -> Pose {
        in_own_environment(|| {
            let rotation = self.pose.rotation;
            Pose { rotation, centre: self.to + rotate(&rotation, &(offset - self.from)) }
        })
    }

    /// Largest distance between a carried reference point and its target, metres.
    pub fn residual<'p>(
        &self,
        pairs: impl Iterator<Item = (&'p Vector3<f32>, &'p Vector3<f32>)>,
    ) -> f32 {
        in_own_environment(|| {
            pairs.fold(0.0_f32, |worst, (r, t)| worst.max(norm(&(self.pose.apply(r) - t))))
        })
    }
}
