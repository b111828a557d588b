//! The surface around each pixel: a plane through its neighbours, and where it ends.

use nalgebra::{Point3, Vector3};
use rayon::prelude::*;
use rigidformer_core::kernels::in_own_environment;

use super::image::{Image, NONE};

/// Cosine of the angle between normals from which a concave crease separates bodies: 25 degrees.
// Smooth errors bend a flat side by several degrees, and bodies that touch seldom meet at less than 45.
const CREASE_COSINE: f32 = 0.906;
/// Growth of the gap with the distance from the middle of a window, by pixel.
// A slanted surface is farther off the farther away it is.
const GAP_GROWTH: f32 = 0.3;
/// Pixels of a fit, at least.
// Three unknowns need some redundancy.
const MIN_FITTED: f32 = 6.0;
/// Difference in depth beyond which normals are of two surfaces, in gaps and pixels.
const MAX_GAPS: f32 = 1.5;

/// Planes through the neighbours of each pixel.
#[derive(Debug, Default)]
pub(super) struct Surface {
    /// (height * width) In the camera's frame, metres; z = 0 where there is none.
    pub(super) points: Vec<Point3<f32>>,
    /// (height * width) Towards the camera; 0 where there is none.
    pub(super) normals: Vec<Vector3<f32>>,
}

impl Surface {
    /// Of an image that is too large for one.
    pub(super) fn clear(&mut self) {
        self.points.clear();
        self.normals.clear();
    }

    /// Fits a plane to the pixels of the same component within `reach` pixels.
    pub(super) fn fit(&mut self, image: &Image<'_>, components: &[u32], reach: usize) {
        let (width, pixels) = (image.width.max(1), components.len());
        self.points.clear();
        self.points.resize(pixels, Point3::origin());
        self.normals.clear();
        self.normals.resize(pixels, Vector3::zeros());
        let rows = self.points.par_chunks_mut(width).zip(self.normals.par_chunks_mut(width));
        rows.enumerate().for_each(|(v, (points, normals))| {
            in_own_environment(|| {
                for (u, (point, normal)) in points.iter_mut().zip(normals).enumerate() {
                    if components.get(v * width + u).is_some_and(|root| *root != NONE) {
                        (*point, *normal) = fit(image, components, [u, v], reach);
                    }
                }
            });
        });
    }

    /// Where the surface ends, or meets another one in a concave crease.
    pub(super) fn edges(
        &self,
        image: &Image<'_>,
        components: &[u32],
        reach: usize,
        is_edge: &mut Vec<bool>,
    ) {
        let width = image.width.max(1);
        is_edge.clear();
        is_edge.resize(components.len(), false);
        is_edge.par_chunks_mut(width).enumerate().for_each(|(v, row)| {
            in_own_environment(|| {
                for (u, is_edge) in row.iter_mut().enumerate() {
                    *is_edge = self.is_edge(image, components, [u, v], reach);
                }
            });
        });
    }

    fn is_edge(
        &self,
        image: &Image<'_>,
        components: &[u32],
        [u, v]: [usize; 2],
        reach: usize,
    ) -> bool {
        let width = image.width.max(1);
        let at = v * width + u;
        if components[at] == NONE {
            return false;
        }
        let (point, normal) = (self.points[at], self.normals[at]);
        // What has no normal is at the end of a surface.
        if normal == Vector3::zeros() {
            return true;
        }
        let gap = (image.gap)(point.z);
        let height = components.len() / width;
        let there = |[du, dv]: [i64; 2], steps: i64| {
            let (x, y) = (u as i64 + du * steps, v as i64 + dv * steps);
            let is_inside = x >= 0 && y >= 0 && x < width as i64 && y < height as i64;
            let other = y.max(0) as usize * width + x.max(0) as usize;
            (is_inside && self.normals[other] != Vector3::zeros()).then_some(other)
        };
        let ways = [[1, 0], [-1, 0], [0, 1], [0, -1], [1, 1], [1, -1], [-1, 1], [-1, -1]];
        ways.into_iter().any(|way| {
            let is_off =
                there(way, 1).is_some_and(|at| (self.points[at] - point).dot(&normal).abs() > gap);
            is_off
                || there(way, reach as i64).is_some_and(|at| {
                    let (other, across) = (self.normals[at], self.points[at] - point);
                    across.z.abs() < MAX_GAPS * gap * reach as f32
                        && across.dot(&(other - normal)) < 0.0
                        && other.dot(&normal) < CREASE_COSINE
                })
        })
    }
}

/// The point and the normal of a pixel. On a plane 1 / z is linear in pixels.
fn fit(
    image: &Image<'_>,
    components: &[u32],
    [u, v]: [usize; 2],
    reach: usize,
) -> (Point3<f32>, Vector3<f32>) {
    let (width, [fx, fy], [cx, cy]) = (image.width.max(1), image.focal, image.centre);
    let height = components.len() / width;
    let at = v * width + u;
    let (z, component) = (image.depth_m[at], components[at]);
    let (gap, middle) = ((image.gap)(z), 1.0 / z);
    let ([mut aa, mut ab, mut a1, mut bb, mut b1, mut count], mut sums) =
        ([0.0f32; 6], [0.0f32; 3]);
    // Every second pixel suffices: neighbouring errors are much alike.
    let step = if reach > 3 { 2 } else { 1 };
    for dv in (-(reach as i64)..=reach as i64).step_by(step) {
        let y = v as i64 + dv;
        if y < 0 || y >= height as i64 {
            continue;
        }
        for du in (-(reach as i64)..=reach as i64).step_by(step) {
            let x = u as i64 + du;
            if x < 0 || x >= width as i64 {
                continue;
            }
            let other = y as usize * width + x as usize;
            if components[other] != component {
                continue;
            }
            let far = du.abs().max(dv.abs()) as f32;
            let depth = image.depth_m[other];
            if (depth - z).abs() > gap * (1.0 + GAP_GROWTH * far) {
                continue;
            }
            let (a, b, w) = (du as f32, dv as f32, 1.0 / depth - middle);
            aa += a * a;
            ab += a * b;
            a1 += a;
            bb += b * b;
            b1 += b;
            count += 1.0;
            sums = [sums[0] + a * w, sums[1] + b * w, sums[2] + w];
        }
    }
    let ray = |z: f32| Point3::new((u as f32 - cx) * z / fx, (v as f32 - cy) * z / fy, z);
    let none = (ray(z), Vector3::zeros());
    if count < MIN_FITTED {
        return none;
    }
    // Cofactors of the symmetric matrix of moments.
    let (c00, c01, c02) = (bb * count - b1 * b1, a1 * b1 - ab * count, ab * b1 - a1 * bb);
    let (c11, c12, c22) = (aa * count - a1 * a1, ab * a1 - aa * b1, aa * bb - ab * ab);
    let determinant = aa * c00 + ab * c01 + a1 * c02;
    // Pixels of one line determine no plane.
    if determinant.is_nan() || determinant < 1e-3 * count {
        return none;
    }
    let [s0, s1, s2] = sums.map(|sum| sum / determinant);
    let plane = Vector3::new(
        c00 * s0 + c01 * s1 + c02 * s2,
        c01 * s0 + c11 * s1 + c12 * s2,
        c02 * s0 + c12 * s1 + c22 * s2,
    );
    let w = middle + plane.z;
    // A fit that moves the depth by a factor of 2 is degenerate.
    if w.is_nan() || w < 0.5 * middle || w > 2.0 * middle {
        return none;
    }
    let normal = Vector3::new(
        plane.x * fx,
        plane.y * fy,
        w + plane.x * (cx - u as f32) + plane.y * (cy - v as f32),
    );
    match normal.try_normalize(1e-12) {
        Some(normal) => (ray(1.0 / w), -normal),
        None => none,
    }
}
