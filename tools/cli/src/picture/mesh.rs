//! A unit's looks: the convex hull of its points, smooth where it is round.

use nalgebra::{Point3, Vector3};
use rigidformer_runtime::hull::ConvexHull;

/// Faces that meet at less than this angle look round: its cosine.
const SMOOTH_COSINE: f32 = 0.80;

/// A corner of a triangle.
#[derive(Clone, Copy)]
pub(super) struct Corner {
    pub(super) point: Point3<f32>,
    pub(super) normal: Vector3<f32>,
}

impl Corner {
    /// Such a part of the way from one to another.
    pub(super) fn between(from: &Corner, to: &Corner, part: f32) -> Corner {
        Corner {
            point: from.point + (to.point - from.point) * part,
            normal: from.normal + (to.normal - from.normal) * part,
        }
    }
}

/// Triangles in the body frame; none for points without volume.
pub(super) struct Mesh {
    pub(super) triangles: Vec<[Corner; 3]>,
}

impl Mesh {
    /// Of triangles as they are: each is flat.
    pub(super) fn flat(triangles: impl Iterator<Item = [Point3<f32>; 3]>) -> Mesh {
        let triangles = triangles.map(|triangle @ [a, b, c]| {
            let normal = (b - a).cross(&(c - a)).try_normalize(1e-12).unwrap_or_else(Vector3::z);
            triangle.map(|point| Corner { point, normal })
        });
        Mesh { triangles: triangles.collect() }
    }

    pub(super) fn new(points: &[Point3<f32>]) -> Mesh {
        let Some(hull) = ConvexHull::new(points) else { return Mesh { triangles: Vec::new() } };
        // Twice the area times the normal, so that large faces count more.
        let weighted: Vec<Vector3<f32>> = hull
            .faces()
            .iter()
            .map(|face| {
                let [a, b, c] = face.map(|corner| points[corner]);
                (b - a).cross(&(c - a))
            })
            .collect();
        let mut around: Vec<Vec<usize>> = vec![Vec::new(); points.len()];
        for (index, face) in hull.faces().iter().enumerate() {
            for corner in face {
                around[*corner].push(index);
            }
        }
        let triangles = hull.faces().iter().enumerate().map(|(index, face)| {
            let own = weighted[index].normalize();
            face.map(|corner| {
                let near = around[corner].iter().map(|other| weighted[*other]);
                let sum: Vector3<f32> =
                    near.filter(|other| other.normalize().dot(&own) > SMOOTH_COSINE).sum();
                Corner { point: points[corner], normal: sum.try_normalize(1e-12).unwrap_or(own) }
            })
        });
        Mesh { triangles: triangles.collect() }
    }
}
