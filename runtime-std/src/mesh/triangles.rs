//! Triangles, and what they enclose.

use std::collections::HashMap;

use nalgebra::{Point3, Vector3};

use rigidformer_core::kernels::in_own_environment;

use super::orient::turned;
use crate::hull::ConvexHull;

/// A mesh whose hull is larger by no more than this is convex.
const CONVEX: f64 = 1.01;
/// Distance of points that are one, relative to the mesh's size, where equal points alone leave it open.
// Text of six digits has such errors.
const SAME: f32 = 2e-6;

/// A part of a mesh's file that has a name.
#[derive(Clone, Debug, PartialEq)]
pub struct Group {
    /// As in the file; it may be empty.
    pub name: String,
    /// Its faces.
    pub mesh: TriangleMesh,
}

/// A mesh of triangles.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct TriangleMesh {
    /// Corners of the triangles; readers leave the points of several faces apart.
    pub points: Vec<Point3<f32>>,
    /// (triangles) Indices of the points, counter-clockwise seen from outside.
    pub triangles: Vec<[u32; 3]>,
}

impl TriangleMesh {
    /// Whether all points are finite, and all corners are there.
    pub fn is_sound(&self) -> bool {
        let number = self.points.len();
        self.triangles.iter().flatten().all(|corner| (*corner as usize) < number)
            && self.points.iter().flat_map(|point| point.iter()).all(|v| v.is_finite())
    }

    /// One mesh of all.
    pub fn joined(meshes: impl IntoIterator<Item = TriangleMesh>) -> Self {
        let mut all = TriangleMesh::default();
        for mesh in meshes {
            let first = all.points.len() as u32;
            all.points.extend(mesh.points);
            let moved = |face: &[u32; 3]| face.map(|corner| corner.saturating_add(first));
            all.triangles.extend(mesh.triangles.iter().map(moved));
        }
        all
    }

    /// The same mesh with all lengths multiplied.
    pub fn scaled(mut self, scale: f32) -> Self {
        in_own_environment(|| self.points.iter_mut().for_each(|point| *point *= scale));
        self
    }

    /// Length of the diagonal of its axis-aligned bounding box.
    pub fn size_m(&self) -> f32 {
        let Some(first) = self.points.first() else { return 0.0 };
        let bounds = self
            .points
            .iter()
            .fold((*first, *first), |(low, high), point| (low.inf(point), high.sup(point)));
        (bounds.1 - bounds.0).norm()
    }

    /// The same mesh with one point for all corners in the same place, without faces that are an edge or a point. Where that leaves
    /// it open, points nearer than two millionths of its size are one, and faces are turned to look the same way as their neighbours.
    pub fn welded(&self) -> Self {
        in_own_environment(|| self.welded_here())
    }

    fn welded_here(&self) -> Self {
        // 0 and -0 are equal, and 0 is added to make them one.
        let exact = self.welded_by(|v| i64::from((v + 0.0).to_bits()));
        let cell = SAME * self.size_m();
        if exact.is_closed() || cell.is_nan() || cell <= 0.0 {
            return exact;
        }
        let near = self.welded_by(|v| (v / cell).round() as i64);
        let mended = [near.clone(), exact.alike(), near.alike()];
        mended.into_iter().find(TriangleMesh::is_closed).unwrap_or(exact)
    }

    /// The same mesh with faces that look the same way as their neighbours, where there is such a way.
    fn alike(&self) -> Self {
        let triangles = turned(&self.triangles).unwrap_or_else(|| self.triangles.clone());
        TriangleMesh { points: self.points.clone(), triangles }
    }

    fn welded_by(&self, key: impl Fn(f32) -> i64) -> Self {
        let mut places: HashMap<[i64; 3], u32> = HashMap::new();
        let mut points = Vec::new();
        let mut index = Vec::with_capacity(self.points.len());
        for point in &self.points {
            let place = places.entry([point.x, point.y, point.z].map(&key)).or_insert_with(|| {
                points.push(*point);
                points.len() as u32 - 1
            });
            index.push(*place);
        }
        let corner = |corner: u32| index.get(corner as usize).copied().unwrap_or_default();
        let triangles = self.triangles.iter().map(|face| face.map(corner));
        let has_area = |[a, b, c]: &[u32; 3]| a != b && b != c && c != a;
        TriangleMesh { triangles: triangles.filter(has_area).collect(), points }
    }

    /// The parts that share no point, in the order of their first faces. A point has to be one point: see [`welded`](Self::welded).
    pub fn parts(&self) -> Vec<TriangleMesh> {
        let mut above: Vec<u32> = (0..self.points.len() as u32).collect();
        for [a, b, c] in &self.triangles {
            let first = root(&mut above, *a);
            for other in [*b, *c] {
                let other = root(&mut above, other);
                if let Some(slot) = above.get_mut(other as usize) {
                    *slot = first;
                }
            }
        }
        let mut number: HashMap<u32, usize> = HashMap::new();
        let mut parts: Vec<TriangleMesh> = Vec::new();
        // (points) Its place in its part.
        let mut places: Vec<Option<u32>> = vec![None; self.points.len()];
        for face in &self.triangles {
            let of = *number.entry(root(&mut above, face[0])).or_insert_with(|| {
                parts.push(TriangleMesh::default());
                parts.len() - 1
            });
            let Some(part) = parts.get_mut(of) else { continue };
            let corners = face.map(|corner| {
                let place = places.get_mut(corner as usize)?;
                let point = self.points.get(corner as usize)?;
                Some(*place.get_or_insert_with(|| {
                    part.points.push(*point);
                    part.points.len() as u32 - 1
                }))
            });
            if let [Some(a), Some(b), Some(c)] = corners {
                part.triangles.push([a, b, c]);
            }
        }
        parts
    }

    /// Whether each edge has as many faces that run along it one way as the other. A point has to be one point: see
    /// [`welded`](Self::welded).
    pub fn is_closed(&self) -> bool {
        let mut edges: HashMap<(u32, u32), i32> = HashMap::new();
        for [a, b, c] in &self.triangles {
            for (from, to) in [(a, b), (b, c), (c, a)] {
                let (edge, way) = if from < to { ((*from, *to), 1) } else { ((*to, *from), -1) };
                *edges.entry(edge).or_default() += way;
            }
        }
        !edges.is_empty() && edges.values().all(|balance| *balance == 0)
    }

    /// Volume within a closed mesh, below 0 where its faces look inwards.
    pub fn volume_m3(&self) -> f64 {
        let Some(first) = self.points.first() else { return 0.0 };
        in_own_environment(|| {
            let first = first.coords.cast::<f64>();
            self.corners()
                .map(|[a, b, c]| (a - first).dot(&(b - first).cross(&(c - first))) / 6.0)
                .sum()
        })
    }

    /// The hull of points; none where they lie in one plane.
    pub fn hull(points: &[Point3<f32>]) -> Option<Self> {
        let hull = ConvexHull::new(points)?;
        let faces = hull.faces().iter().map(|face| face.map(|corner| corner as u32));
        Some(TriangleMesh { points: points.to_vec(), triangles: faces.collect() })
    }

    /// Volume of its hull; 0 where its points lie in one plane.
    pub fn hull_volume_m3(&self) -> f64 {
        TriangleMesh::hull(&self.points).map_or(0.0, |hull| hull.volume_m3())
    }

    /// Whether it is closed, and its hull is larger by no more than a hundredth. A point has to be one point: see
    /// [`welded`](Self::welded).
    pub fn is_convex(&self) -> bool {
        let hull = self.hull_volume_m3();
        hull > 0.0 && self.is_closed() && hull < CONVEX * self.volume_m3().abs()
    }

    /// Corners of the triangles.
    pub(super) fn corners(&self) -> impl Iterator<Item = [Vector3<f64>; 3]> {
        let corner = |corner: u32| {
            let point = self.points.get(corner as usize).copied().unwrap_or_default();
            point.coords.cast::<f64>()
        };
        self.triangles.iter().map(move |face| face.map(corner))
    }

    /// The same mesh seen from inside.
    pub(super) fn flipped(mut self) -> Self {
        self.triangles.iter_mut().for_each(|face| face.swap(1, 2));
        self
    }
}

/// The first of a point's connected points, with the way to it halved.
fn root(above: &mut [u32], of: u32) -> u32 {
    let mut at = of;
    while let Some(next) = above.get(at as usize).copied().filter(|next| *next != at) {
        let beyond = above.get(next as usize).copied().unwrap_or(next);
        if let Some(slot) = above.get_mut(at as usize) {
            *slot = beyond;
        }
        at = beyond;
    }
    at
}
