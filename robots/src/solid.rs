//! Simple solids about the origin: what they weigh, and their triangles.

use std::f64::consts::{PI, TAU};

use nalgebra::{Matrix3, Point3, Vector3};
use rigidformer_runtime::mesh::TriangleMesh;

use crate::inertia::Inertia;

/// Corners of a circle in triangles.
const AROUND: usize = 16;
/// Rows of corners from pole to pole.
const ROWS: usize = 9;
/// Likewise of a capsule's two half balls; even.
const CAPSULE_ROWS: usize = 8;

/// A solid along z, with the origin in its middle, metres.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Solid {
    /// Half of the sides.
    Box([f64; 3]),
    /// Half axes; all three are the radius of a ball.
    Ellipsoid([f64; 3]),
    /// Radius, half of the height.
    Cylinder(f64, f64),
    /// Radius, half of the length of the cylinder between the half balls.
    Capsule(f64, f64),
}

impl Solid {
    fn lengths(&self) -> [f64; 3] {
        match *self {
            Solid::Box(half) | Solid::Ellipsoid(half) => half,
            Solid::Cylinder(radius, half) | Solid::Capsule(radius, half) => [radius, half, half],
        }
    }

    /// Whether a length is not above 0: less than a nanometre is none.
    pub(crate) fn is_flat(&self) -> bool {
        self.lengths().iter().any(|length| *length < 1e-9)
    }

    /// Whether all its lengths are those of a solid: above 0, and none too large for its triangles.
    pub(crate) fn is_sound(&self) -> bool {
        self.lengths().iter().all(|length| (1e-9..=1e6).contains(length))
    }

    pub(crate) fn volume_m3(&self) -> f64 {
        match *self {
            Solid::Box([x, y, z]) => 8.0 * x * y * z,
            Solid::Ellipsoid([x, y, z]) => 4.0 / 3.0 * PI * x * y * z,
            Solid::Cylinder(radius, half) => PI * radius * radius * 2.0 * half,
            Solid::Capsule(radius, half) => {
                PI * radius * radius * (2.0 * half + 4.0 / 3.0 * radius)
            }
        }
    }

    /// As a uniform body of that mass.
    pub(crate) fn inertia(&self, mass_kg: f64) -> Inertia {
        let thirds = |[x, y, z]: [f64; 3], share: f64| {
            let [x, y, z] = [x * x, y * y, z * z];
            Vector3::new(y + z, x + z, x + y) * (share * mass_kg)
        };
        let moments = match *self {
            Solid::Box(half) => thirds(half, 1.0 / 3.0),
            Solid::Ellipsoid(half) => thirds(half, 1.0 / 5.0),
            Solid::Cylinder(radius, half) => {
                let across = mass_kg * (radius * radius / 4.0 + half * half / 3.0);
                Vector3::new(across, across, mass_kg * radius * radius / 2.0)
            }
            Solid::Capsule(radius, half) => {
                let (square, height) = (radius * radius, 2.0 * half);
                let ball = mass_kg * 4.0 * radius / (4.0 * radius + 3.0 * height);
                let middle = mass_kg - ball;
                // Each half ball's centre is 3 / 8 of its radius beyond the cylinder's end.
                let across = middle * (3.0 * square + height * height) / 12.0
                    + ball * (0.4 * square + height * (3.0 * radius + 2.0 * height) / 8.0);
                Vector3::new(across, across, middle * square / 2.0 + ball * 0.4 * square)
            }
        };
        Inertia {
            mass_kg,
            centre_m: Point3::origin(),
            about_centre: Matrix3::from_diagonal(&moments),
        }
    }

    /// Its surface; round ones have corners on the surface.
    pub(crate) fn mesh(&self) -> TriangleMesh {
        match *self {
            Solid::Box(half) => cuboid(half),
            Solid::Ellipsoid([x, y, z]) => {
                turned(|sine, cosine| ([x * sine, y * sine], z * cosine))
            }
            Solid::Cylinder(radius, half) => {
                lathe(&[(0.0, half), (radius, half), (radius, -half), (0.0, -half)])
            }
            Solid::Capsule(radius, half) => {
                // Both half balls have a row where they meet the cylinder.
                let row = |k: usize, shift: f64| {
                    let (sine, cosine) = (PI * k as f64 / CAPSULE_ROWS as f64).sin_cos();
                    (radius * sine.max(0.0), radius * cosine + shift)
                };
                let above = (0..=CAPSULE_ROWS / 2).map(|k| row(k, half));
                let below = (CAPSULE_ROWS / 2..=CAPSULE_ROWS).map(|k| row(k, -half));
                lathe(&above.chain(below).collect::<Vec<_>>())
            }
        }
    }
}

fn cuboid([x, y, z]: [f64; 3]) -> TriangleMesh {
    let sign = |k: usize, bit: usize| if k & bit == 0 { -1.0 } else { 1.0 };
    let corner = |k: usize| Point3::new(sign(k, 1) * x, sign(k, 2) * y, sign(k, 4) * z).cast();
    let quads =
        [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]];
    TriangleMesh {
        points: (0..8).map(corner).collect(),
        triangles: quads.iter().flat_map(|[a, b, c, d]| [[*a, *b, *c], [*a, *c, *d]]).collect(),
    }
}

/// Rows from pole to pole, of the sine and cosine of the angle from the pole.
fn turned(row: impl Fn(f64, f64) -> ([f64; 2], f64)) -> TriangleMesh {
    let rows: Vec<([f64; 2], f64)> = (0..=ROWS)
        .map(|k| {
            let (sine, cosine) = (PI * k as f64 / ROWS as f64).sin_cos();
            row(sine.max(0.0), cosine)
        })
        .collect();
    wound(&rows)
}

/// Rows of radius and height, from above to below.
fn lathe(rows: &[(f64, f64)]) -> TriangleMesh {
    wound(&rows.iter().map(|(radius, z)| ([*radius, *radius], *z)).collect::<Vec<_>>())
}

/// Rings of corners, of which the first and the last are poles.
fn wound(rows: &[([f64; 2], f64)]) -> TriangleMesh {
    let mut points = Vec::new();
    let mut triangles = Vec::new();
    let last = rows.len().saturating_sub(1);
    for (number, ([x, y], z)) in rows.iter().enumerate() {
        let is_pole = number == 0 || number == last;
        for k in 0..if is_pole { 1 } else { AROUND } {
            let (sine, cosine) = (TAU * k as f64 / AROUND as f64).sin_cos();
            let (x, y) = if is_pole { (0.0, 0.0) } else { (x * cosine, y * sine) };
            points.push(Point3::new(x, y, *z).cast());
        }
    }
    let corner = |row: usize, k: usize| -> u32 {
        let at = match row {
            0 => 0,
            row if row == last => 1 + (last - 1) * AROUND,
            row => 1 + (row - 1) * AROUND + k % AROUND,
        };
        at as u32
    };
    for row in 0..last {
        for k in 0..AROUND {
            let [a, b] = [corner(row, k), corner(row, k + 1)];
            let [c, d] = [corner(row + 1, k), corner(row + 1, k + 1)];
            if row > 0 {
                triangles.push([a, d, b]);
            }
            if row + 1 < last {
                triangles.push([a, c, d]);
            } else {
                triangles.push([a, c, b]);
            }
        }
    }
    // The row below the first pole and the one above the last have one triangle a corner.
    triangles.retain(|[a, b, c]| a != b && b != c && c != a);
    triangles.sort_unstable();
    triangles.dedup();
    TriangleMesh { points, triangles }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn triangles_are_closed_and_hold_what_the_formulae_say() {
        let solids = [
            (Solid::Box([0.1, 0.2, 0.3]), 1e-6),
            (Solid::Ellipsoid([0.1, 0.2, 0.3]), 0.1),
            (Solid::Cylinder(0.1, 0.3), 0.04),
            (Solid::Capsule(0.1, 0.3), 0.08),
        ];
        for (solid, off) in solids {
            let mesh = solid.mesh();
            assert!(mesh.is_closed(), "{solid:?}");
            let own = mesh.mass_properties().unwrap();
            let (volume, inertia) = (solid.volume_m3(), solid.inertia(solid.volume_m3()));
            assert!(
                mesh.volume_m3() > 0.0 && (own.volume_m3 / volume - 1.0).abs() < off,
                "{solid:?}"
            );
            let moments = own.inertia_m5.diagonal().component_div(&inertia.about_centre.diagonal());
            assert!(
                moments.iter().all(|share| (share - 1.0).abs() < 2.0 * off),
                "{solid:?} {moments}"
            );
            assert!(mesh.is_convex(), "{solid:?}");
        }
    }
}
