//! Points of simple solids.

use std::f32::consts::{PI, TAU};

use nalgebra::Point3;

use crate::usage::Usage;

/// Corners of a cylinder's rims, and points of a sphere.
const ROUND: usize = 24;
const SPHERE: usize = 128;

/// A solid about the origin of its body frame, metres.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Solid {
    Box([f32; 3]),
    Cylinder { radius: f32, height: f32 },
    Sphere { radius: f32 },
}

impl Solid {
    pub(super) fn checked(self, option: &str, text: &str) -> Result<Self, Usage> {
        let lengths = match self {
            Self::Box(sides) => sides.to_vec(),
            Self::Cylinder { radius, height } => vec![radius, height],
            Self::Sphere { radius } => vec![radius],
        };
        match lengths.iter().all(|length| *length > 0.0) {
            true => Ok(self),
            false => Err(Usage(format!("{option} {text}: give lengths above 0, in metres"))),
        }
    }

    pub(super) fn points(&self) -> Vec<Point3<f32>> {
        match *self {
            Self::Box(sides) => box_points(sides),
            Self::Cylinder { radius, height } => cylinder(radius, height),
            Self::Sphere { radius } => sphere(radius),
        }
    }
}

/// 64 points, as the lab has them: the 56 outer points of a 4 x 4 x 4 grid, and the middles of the four edges and of the four faces
/// about z.
fn box_points([a, b, c]: [f32; 3]) -> Vec<Point3<f32>> {
    let point = |x: f64, y: f64, z: f64| {
        let scaled = |unit: f64, side: f32| (unit * f64::from(side) / 2.0) as f32;
        Point3::new(scaled(x, a), scaled(y, b), scaled(z, c))
    };
    let grid = [-1.0, -1.0 / 3.0, 1.0 / 3.0, 1.0];
    let mut points = Vec::new();
    for x in grid {
        for y in grid {
            for z in grid {
                if [x, y, z].iter().any(|v: &f64| v.abs() == 1.0) {
                    points.push(point(x, y, z));
                }
            }
        }
    }
    for x in [-1.0, 0.0, 1.0] {
        for y in [-1.0, 0.0, 1.0] {
            if x != 0.0 || y != 0.0 {
                points.push(point(x, y, 0.0));
            }
        }
    }
    points
}

/// Both rims and a ring half way up, and the middles of the ends.
fn cylinder(radius: f32, height: f32) -> Vec<Point3<f32>> {
    let mut points = Vec::new();
    for z in [-0.5, 0.0, 0.5] {
        for corner in 0..ROUND {
            let angle = TAU * corner as f32 / ROUND as f32;
            points.push(Point3::new(radius * angle.cos(), radius * angle.sin(), z * height));
        }
    }
    points.extend([-0.5, 0.5].map(|z| Point3::new(0.0, 0.0, z * height)));
    points
}

/// A Fibonacci lattice.
fn sphere(radius: f32) -> Vec<Point3<f32>> {
    let golden = PI * (3.0 - 5.0_f32.sqrt());
    let point = |k: usize| {
        let z = 1.0 - (2.0 * k as f32 + 1.0) / SPHERE as f32;
        let (side, angle) = ((1.0 - z * z).max(0.0).sqrt(), golden * k as f32);
        Point3::new(side * angle.cos(), side * angle.sin(), z) * radius
    };
    (0..SPHERE).map(point).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn points_lie_on_the_solids() {
        let box_points = Solid::Box([0.2, 0.4, 0.6]).points();
        assert_eq!(box_points.len(), 64);
        assert!(box_points.contains(&Point3::new(0.1, -0.2, 0.3)));
        assert_eq!(Solid::Cylinder { radius: 0.1, height: 0.2 }.points().len(), 3 * ROUND + 2);
        for point in (Solid::Sphere { radius: 0.5 }).points() {
            assert!((point.coords.norm() - 0.5).abs() < 1e-6);
        }
    }
}
