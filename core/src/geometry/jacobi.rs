//! Singular value decomposition of a 3x3 matrix by one-sided Jacobi rotations.

use super::dot;
use super::pose::columns;
use crate::kernels::in_own_environment;
use crate::math;
use nalgebra::{Matrix3, Vector3};

/// Sweeps over the three column pairs. Convergence is quadratic: four reach f32 rounding
/// on every matrix tried, two more are a margin. Fixed, so that the time is.
const SWEEPS: usize = 6;

/// The two leading singular triplets; a rotation's third follows by cross products.
#[derive(Clone, Copy, Debug)]
pub struct Svd {
    /// Singular values in descending order.
    pub values: [f32; 3],
    /// `H v` for the leading two right vectors: `values[i]` times the left vector.
    pub left: [Vector3<f32>; 2],
    /// Right vectors of the leading two values.
    pub right: [Vector3<f32>; 2],
}

/// Leading singular vectors of a matrix with finite entries of moderate size.
pub fn leading_svd(h: &Matrix3<f32>) -> Svd {
    in_own_environment(|| leading_svd_here(h))
}

pub(super) fn leading_svd_here(h: &Matrix3<f32>) -> Svd {
    let [mut a, mut b, mut c] = columns(h);
    let mut x = Vector3::new(1.0, 0.0, 0.0);
    let mut y = Vector3::new(0.0, 1.0, 0.0);
    let mut z = Vector3::new(0.0, 0.0, 1.0);
    for _ in 0..SWEEPS {
        turn(&mut a, &mut b, &mut x, &mut y);
        turn(&mut a, &mut c, &mut x, &mut z);
        turn(&mut b, &mut c, &mut y, &mut z);
    }
    let mut first = (dot(&a, &a), a, x);
    let mut second = (dot(&b, &b), b, y);
    let mut third = (dot(&c, &c), c, z);
    if second.0 > first.0 {
        core::mem::swap(&mut first, &mut second);
    }
    if third.0 > second.0 {
        core::mem::swap(&mut second, &mut third);
    }
    if second.0 > first.0 {
        core::mem::swap(&mut first, &mut second);
    }
    Svd {
        values: [math::sqrt(first.0), math::sqrt(second.0), math::sqrt(third.0)],
        left: [first.1, second.1],
        right: [first.2, second.2],
    }
}

/// Rotates columns p and q so that they become orthogonal, and u and v with them.
fn turn(p: &mut Vector3<f32>, q: &mut Vector3<f32>, u: &mut Vector3<f32>, v: &mut Vector3<f32>) {
    let overlap = dot(p, q);
    if overlap == 0.0 {
        return;
    }
    let zeta = (dot(q, q) - dot(p, p)) / (2.0 * overlap);
    // Beyond this, zeta² overflows and the rotation is nothing to f32.
    if zeta.abs() >= 1e15 {
        return;
    }
    let sign = if zeta < 0.0 { -1.0 } else { 1.0 };
    let t = sign / (zeta.abs() + math::sqrt(1.0 + zeta * zeta));
    let cos = 1.0 / math::sqrt(1.0 + t * t);
    let sin = cos * t;
    for (a, b) in [(p, q), (u, v)] {
        let turned = *a * cos - *b * sin;
        *b = *a * sin + *b * cos;
        *a = turned;
    }
}
