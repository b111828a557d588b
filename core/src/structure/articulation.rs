//! Inertia of what hangs together: motions and momenta of six numbers, and the inertia of a unit with all that hangs from it
//! (Featherstone's articulated body, here between units that keep poses of their own).
//!
//! In f64: a thin link under a heavy end turns about itself a million times easier than across, and differences of f32 would leave
//! nothing of it.

use crate::structure::link::Way;
use nalgebra::{Matrix3, Vector3};

/// Numbers of a [`Six`].
pub(crate) const SIX: usize = 6;
/// Numbers of an [`Inertia`].
pub(crate) const INERTIA: usize = 21;

/// A motion of a unit's centre and its turn, or an impulse there and an angular one.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Six {
    pub(crate) way: Vector3<f64>,
    pub(crate) turn: Vector3<f64>,
}

impl Six {
    pub(crate) const ZERO: Six =
        Six { way: Vector3::new(0.0, 0.0, 0.0), turn: Vector3::new(0.0, 0.0, 0.0) };

    pub(crate) fn read(row: &[f64; SIX]) -> Self {
        let [a, b, c, d, e, f] = *row;
        Six { way: Vector3::new(a, b, c), turn: Vector3::new(d, e, f) }
    }

    pub(crate) fn row(&self) -> [f64; SIX] {
        let Six { way: v, turn: w } = self;
        [v.x, v.y, v.z, w.x, w.y, w.z]
    }

    pub(crate) fn plus(&self, other: &Six) -> Six {
        Six { way: self.way + other.way, turn: self.turn + other.turn }
    }

    pub(crate) fn minus(&self, other: &Six) -> Six {
        Six { way: self.way - other.way, turn: self.turn - other.turn }
    }

    pub(crate) fn times(&self, factor: f64) -> Six {
        Six { way: self.way * factor, turn: self.turn * factor }
    }

    /// Work of an impulse in a motion.
    pub(crate) fn dot(&self, other: &Six) -> f64 {
        dot(&self.way, &other.way) + dot(&self.turn, &other.turn)
    }

    /// A motion at the end of a lever.
    pub(crate) fn at(&self, lever: &Vector3<f64>) -> Six {
        Six { way: self.way + self.turn.cross(lever), turn: self.turn }
    }

    /// An impulse at the end of a lever, at its start.
    pub(crate) fn from(&self, lever: &Vector3<f64>) -> Six {
        Six { way: self.way, turn: self.turn + lever.cross(&self.way) }
    }
}

/// Impulse for a change of motion, both at a centre: symmetric.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Inertia {
    /// Of the way by the way.
    pub(crate) ways: Matrix3<f64>,
    /// Of the way by the turn.
    pub(crate) mixed: Matrix3<f64>,
    /// Of the turn by the turn.
    pub(crate) turns: Matrix3<f64>,
}

impl Inertia {
    /// Of a unit alone: its mass, and moments along the columns of its rotation.
    pub(crate) fn of(mass: f64, moments: &Vector3<f64>, rotation: &Matrix3<f64>) -> Self {
        let column = |axis: Vector3<f64>| {
            rotate(rotation, &rotate_back(rotation, &axis).component_mul(moments))
        };
        let [x, y, z] = [Vector3::x(), Vector3::y(), Vector3::z()].map(column);
        Inertia {
            ways: Matrix3::new(mass, 0.0, 0.0, 0.0, mass, 0.0, 0.0, 0.0, mass),
            mixed: Matrix3::zeros(),
            turns: symmetric([x.x, y.y, z.z, y.x, z.x, z.y]),
        }
    }

    /// Of what nothing moves, at its pivot: so many kg against what a joint does not leave open, and as many at a radius against
    /// turns. `open` is an axis that is not locked.
    pub(crate) fn held(way: Way, open: Option<Vector3<f64>>, (mass, radius): (f64, f64)) -> Self {
        let whole = Matrix3::identity();
        let across = open.map_or(whole, |axis| whole - outer(&axis, &axis));
        let (ways, turns) = match way {
            Way::Ball => (whole, Matrix3::zeros()),
            Way::Turns => (whole, across),
            Way::Slides => (across, whole),
            Way::Fixed => (whole, whole),
        };
        let moment = mass * (radius * radius);
        Inertia { ways: ways * mass, mixed: Matrix3::zeros(), turns: turns * moment }
    }

    pub(crate) fn read(row: &[f64; INERTIA]) -> Self {
        let [a, b, c, d, e, f, g, h, i, j, k, l, m, n, o, p, q, r, s, t, u] = *row;
        Inertia {
            ways: symmetric([a, b, c, d, e, f]),
            mixed: Matrix3::new(g, h, i, j, k, l, m, n, o),
            turns: symmetric([p, q, r, s, t, u]),
        }
    }

    pub(crate) fn row(&self) -> [f64; INERTIA] {
        let Inertia { ways: a, mixed: b, turns: c } = self;
        #[rustfmt::skip]
        let row = [a.m11, a.m22, a.m33, a.m12, a.m13, a.m23,
            b.m11, b.m12, b.m13, b.m21, b.m22, b.m23, b.m31, b.m32, b.m33,
            c.m11, c.m22, c.m33, c.m12, c.m13, c.m23];
        row
    }

    pub(crate) fn plus(&self, other: &Inertia) -> Self {
        Inertia {
            ways: self.ways + other.ways,
            mixed: self.mixed + other.mixed,
            turns: self.turns + other.turns,
        }
    }

    /// The impulse for a change of motion.
    pub(crate) fn times(&self, motion: &Six) -> Six {
        Six {
            way: rotate(&self.ways, &motion.way) + rotate(&self.mixed, &motion.turn),
            turn: rotate_back(&self.mixed, &motion.way) + rotate(&self.turns, &motion.turn),
        }
    }

    /// What is left of it where motions with these impulses are free: less sum u_i w_ij u_j.
    pub(crate) fn without(&self, gains: &[Six; 3], weights: &[f64; SIX]) -> Self {
        let weights = symmetric(*weights);
        let mut left = *self;
        for (row, one) in gains.iter().enumerate() {
            let Some(weight) = weights.as_slice().get(row * 3..row * 3 + 3) else { continue };
            let sum = gains.iter().zip(weight).fold(Six::ZERO, |sum, (gain, weight)| {
                if *weight == 0.0 { sum } else { sum.plus(&gain.times(*weight)) }
            });
            if sum == Six::ZERO {
                continue;
            }
            left.ways -= outer(&one.way, &sum.way);
            left.mixed -= outer(&one.way, &sum.turn);
            left.turns -= outer(&one.turn, &sum.turn);
        }
        left
    }

    /// As felt at the start of a lever at whose end it is.
    pub(crate) fn from(&self, lever: &Vector3<f64>) -> Self {
        let across =
            Matrix3::new(0.0, -lever.z, lever.y, lever.z, 0.0, -lever.x, -lever.y, lever.x, 0.0);
        let mixed = self.mixed - product(&self.ways, &across);
        let turned = product(&across, &mixed);
        let other = product(&across, &self.mixed);
        Inertia { ways: self.ways, mixed, turns: self.turns + turned + other.transpose() }
    }

    /// In place of what it is, what [`solve`] takes.
    pub(crate) fn inverted(&self) -> Self {
        let ways = inverse(&[
            self.ways.m11,
            self.ways.m22,
            self.ways.m33,
            self.ways.m12,
            self.ways.m13,
            self.ways.m23,
        ]);
        let ways = symmetric(ways);
        let [x, y, z] =
            columns(&self.mixed).map(|column| rotate_back(&self.mixed, &rotate(&ways, &column)));
        let c = &self.turns;
        let turns = inverse(&[
            c.m11 - x.x,
            c.m22 - y.y,
            c.m33 - z.z,
            c.m12 - y.x,
            c.m13 - z.x,
            c.m23 - z.y,
        ]);
        Inertia { ways, mixed: self.mixed, turns: symmetric(turns) }
    }

    /// The change of motion by an impulse, of an [inverted](Self::inverted) one.
    pub(crate) fn solve(&self, impulse: &Six) -> Six {
        let alone = rotate(&self.ways, &impulse.way);
        let turn = rotate(&self.turns, &(impulse.turn - rotate_back(&self.mixed, &alone)));
        let way = alone - rotate(&self.ways, &rotate(&self.mixed, &turn));
        Six { way, turn }
    }
}

/// A symmetric matrix: xx, yy, zz, xy, xz, yz.
pub(crate) fn symmetric([xx, yy, zz, xy, xz, yz]: [f64; SIX]) -> Matrix3<f64> {
    Matrix3::new(xx, xy, xz, xy, yy, yz, xz, yz, zz)
}

fn outer(a: &Vector3<f64>, b: &Vector3<f64>) -> Matrix3<f64> {
    let [x, y, z] = [a * b.x, a * b.y, a * b.z];
    Matrix3::new(x.x, y.x, z.x, x.y, y.y, z.y, x.z, y.z, z.z)
}

/// Inverse of a symmetric matrix of no negative direction; a direction without weight stays one without.
pub(crate) fn inverse(matrix: &[f64; SIX]) -> [f64; SIX] {
    // Factors L D Lᵀ: scales of axes that differ by millions cost no digits.
    let [xx, yy, zz, xy, xz, yz] = *matrix;
    let over = |pivot: f64, whole: f64| if pivot > 1e-12 * whole { 1.0 / pivot } else { 0.0 };
    let a = over(xx, 0.0);
    let (l, m) = (xy * a, xz * a);
    let b = over(yy - l * xy, yy);
    let mixed = yz - l * xz;
    let n = mixed * b;
    let c = over((zz - m * xz) - n * mixed, zz);
    // Of L the inverse is lower too: -l, l n - m, -n.
    let p = l * n - m;
    [a + (l * l * b + p * p * c), b + n * n * c, c, -(l * b) - p * n * c, p * c, -(n * c)]
}

/// Dot product in one fixed order.
fn dot(a: &Vector3<f64>, b: &Vector3<f64>) -> f64 {
    (a.x * b.x + a.y * b.y) + a.z * b.z
}

/// Matrix times vector in one fixed order.
fn rotate(r: &Matrix3<f64>, v: &Vector3<f64>) -> Vector3<f64> {
    Vector3::new(
        (r.m11 * v.x + r.m12 * v.y) + r.m13 * v.z,
        (r.m21 * v.x + r.m22 * v.y) + r.m23 * v.z,
        (r.m31 * v.x + r.m32 * v.y) + r.m33 * v.z,
    )
}

/// Transposed matrix times vector in one fixed order.
fn rotate_back(r: &Matrix3<f64>, v: &Vector3<f64>) -> Vector3<f64> {
    Vector3::new(
        (r.m11 * v.x + r.m21 * v.y) + r.m31 * v.z,
        (r.m12 * v.x + r.m22 * v.y) + r.m32 * v.z,
        (r.m13 * v.x + r.m23 * v.y) + r.m33 * v.z,
    )
}

fn columns(r: &Matrix3<f64>) -> [Vector3<f64>; 3] {
    [
        Vector3::new(r.m11, r.m21, r.m31),
        Vector3::new(r.m12, r.m22, r.m32),
        Vector3::new(r.m13, r.m23, r.m33),
    ]
}

/// Matrix product in one fixed order.
fn product(a: &Matrix3<f64>, b: &Matrix3<f64>) -> Matrix3<f64> {
    let [x, y, z] = columns(b).map(|column| rotate(a, &column));
    Matrix3::new(x.x, y.x, z.x, x.y, y.y, z.y, x.z, y.z, z.z)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn inverses() {
        let matrix = [4.0, 3.0, 2.0, 1.0, -0.5, 0.3];
        let one = symmetric(matrix) * symmetric(inverse(&matrix));
        assert!((one - Matrix3::identity()).norm() < 1e-6, "{one}");
        assert_eq!(inverse(&[2.0, 0.0, 4.0, 0.0, 0.0, 0.0]), [0.5, 0.0, 0.25, 0.0, 0.0, 0.0]);
    }

    #[test]
    fn an_inertia_at_a_lever_resists_as_it_does_there() {
        let rotation = *nalgebra::Rotation3::from_euler_angles(0.3, -0.4, 0.9).matrix();
        let own = Inertia::of(2.0, &Vector3::new(0.1, 0.2, 0.25), &rotation);
        let lever = Vector3::new(0.3, -0.2, 0.5);
        let motion = Six { way: Vector3::new(1.0, 2.0, 3.0), turn: Vector3::new(-1.0, 0.5, 0.2) };
        let there = own.times(&motion.at(&lever)).from(&lever);
        let here = own.from(&lever).times(&motion);
        let error = there.minus(&here);
        assert!(error.dot(&error) < 1e-10, "{error:?}");
        // And its inverse.
        let back = own.from(&lever).inverted().solve(&here).minus(&motion);
        assert!(back.dot(&back) < 1e-9, "{back:?}");
        let row = Inertia::read(&own.from(&lever).row()).times(&motion).minus(&here);
        assert!(row.dot(&row) < 1e-10, "{row:?}");
    }
}
