//! Surfaces through a pinhole: triangles and planes into a buffer of inverse depths.
//!
//! Over a flat surface the inverse depth is an affine function of the pixel, so it needs no division a pixel, and the nearest surface
//! has the greatest.

use nalgebra::{Isometry3, Point3, Vector3};
use rigidformer_core::Plane;
use rigidformer_perception::camera::Camera;

/// What is nearer to the camera's plane is not seen, metres.
// A corner at the camera's plane projects to infinity.
const NEAR_M: f64 = 0.01;
/// Corners of a triangle that is cut at [`NEAR_M`].
// A cut through a triangle leaves three or four corners.
const MOST_CORNERS: usize = 4;

/// What is seen at each pixel.
pub(super) struct Canvas {
    camera: Camera,
    /// (height * width) 1/m; 0: nothing.
    pub(super) inverse: Vec<f32>,
    /// (height * width) What was drawn there.
    pub(super) labels: Vec<u16>,
}

/// Affine function of a pixel: value at (0, 0), and what it grows by per column and row.
#[derive(Clone, Copy)]
struct Affine([f64; 3]);

/// Inverse depths of a flat surface, and the greatest that it has: where it is seen edge on, rounding may give any.
#[derive(Clone, Copy)]
struct Flat {
    inverse: Affine,
    most: f64,
}

impl Affine {
    /// Inverse depth of the points x of the camera's frame with `normal . x = offset`.
    fn inverse_depth(camera: &Camera, normal: &Vector3<f64>, offset: f64) -> Affine {
        let ([fx, fy], [cx, cy]) = (camera.focal().map(f64::from), camera.centre().map(f64::from));
        let (right, down) = (normal.x / fx, normal.y / fy);
        Affine([normal.z - right * cx - down * cy, right, down].map(|number| number / offset))
    }

    /// At the first pixel of a row, and the step to the next.
    fn row(self, row: usize) -> (f64, f64) {
        let Affine([first, right, down]) = self;
        (first + down * row as f64, right)
    }
}

impl Canvas {
    pub(super) fn new(camera: &Camera) -> Canvas {
        let [width, height] = camera.size();
        let pixels = width as usize * height as usize;
        Canvas { camera: *camera, inverse: vec![0.0; pixels], labels: vec![0; pixels] }
    }

    /// Draws an infinite plane, seen from its free side alone.
    pub(super) fn plane(&mut self, plane: &Plane, label: u16) {
        let pose = self.camera.pose();
        let below = -f64::from(plane.height_m(&pose.translation.vector));
        // Seen from behind or edge on a plane covers nothing.
        if below >= -NEAR_M {
            return;
        }
        let normal = pose.rotation.inverse() * plane.normal;
        let inverse = Affine::inverse_depth(&self.camera, &normal.cast(), below);
        let flat = Flat { inverse, most: 1.0 / NEAR_M };
        let [width, height] = self.camera.size().map(|side| side as usize);
        for row in 0..height {
            self.span(row, 0..width, flat, label);
        }
    }

    /// Draws triangles of points that a pose carries to the world. Where they are `closed`, they are counter-clockwise seen from
    /// outside, and only those that face the camera are drawn.
    pub(super) fn triangles(
        &mut self,
        points: &[Point3<f32>],
        triangles: &[[usize; 3]],
        pose: &Isometry3<f32>,
        closed: bool,
        label: u16,
    ) {
        // f64 rounds an edge that two triangles share far below a pixel, so that no gap opens.
        let to_camera = self.camera.pose().cast::<f64>().inverse() * pose.cast::<f64>();
        let seen: Vec<Vector3<f64>> =
            points.iter().map(|point| (to_camera * point.cast::<f64>()).coords).collect();
        for [a, b, c] in triangles {
            if let (Some(a), Some(b), Some(c)) = (seen.get(*a), seen.get(*b), seen.get(*c)) {
                self.triangle([*a, *b, *c], closed, label);
            }
        }
    }

    fn triangle(&mut self, corners: [Vector3<f64>; 3], closed: bool, label: u16) {
        let [a, b, c] = corners;
        let normal = (b - a).cross(&(c - a));
        // The camera is at the origin, and sees the outside of triangles whose offset is below 0.
        let offset = normal.dot(&a);
        if offset == 0.0 || !offset.is_finite() || (closed && offset > 0.0) {
            return;
        }
        let inverse = Affine::inverse_depth(&self.camera, &normal, offset);
        let (corners, count) = in_front(&corners);
        let Some(corners) = corners.get(..count) else { return };
        let nearest_m = corners.iter().fold(f64::MAX, |least, corner| least.min(corner.z));
        // Edge on, the affine function overshoots, and no pixel is nearer than the nearest corner.
        let flat = Flat { inverse, most: 1.0 / nearest_m };
        let ([fx, fy], [cx, cy]) =
            (self.camera.focal().map(f64::from), self.camera.centre().map(f64::from));
        let mut pixels = [[0.0; 2]; MOST_CORNERS];
        for (pixel, corner) in pixels.iter_mut().zip(corners) {
            *pixel = [fx * corner.x / corner.z + cx, fy * corner.y / corner.z + cy];
        }
        let Some(pixels) = pixels.get(..count) else { return };
        let [width, height] = self.camera.size().map(|side| side as usize);
        let rows = pixels.iter().map(|[_, y]| *y);
        for row in
            whole(rows.clone().fold(f64::MAX, f64::min), rows.fold(f64::MIN, f64::max), height)
        {
            let (left, right) = crossed(pixels, row as f64);
            self.span(row, whole(left, right, width), flat, label);
        }
    }

    /// Draws a range of a row where it is nearer than what is there.
    fn span(&mut self, row: usize, columns: std::ops::Range<usize>, flat: Flat, label: u16) {
        let width = self.camera.size()[0] as usize;
        let (first, step) = flat.inverse.row(row);
        let range = row * width + columns.start..row * width + columns.end;
        let (Some(depths), Some(labels)) =
            (self.inverse.get_mut(range.clone()), self.labels.get_mut(range))
        else {
            return;
        };
        for (column, (depth, own)) in columns.zip(depths.iter_mut().zip(labels)) {
            let here = (first + step * column as f64).min(flat.most) as f32;
            // The greater inverse depth is the nearer surface. Of equals the first stays.
            if here > *depth {
                *depth = here;
                *own = label;
            }
        }
    }
}

/// Whole numbers from `low` to `high`, both included, that are below `limit`.
fn whole(low: f64, high: f64, limit: usize) -> std::ops::Range<usize> {
    // Conversions from float to integer saturate, which cuts off what lies outside.
    let start = low.ceil().max(0.0) as usize;
    let end = if high < 0.0 { 0 } else { (high.floor() as usize).saturating_add(1).min(limit) };
    start.min(end)..end
}

/// Where a row enters and leaves a convex polygon. Each edge is looked at from its upper end, so that two polygons that share it agree.
fn crossed(corners: &[[f64; 2]], y: f64) -> (f64, f64) {
    let (mut left, mut right) = (f64::MAX, f64::MIN);
    let next = corners.iter().cycle().skip(1);
    for (a, b) in corners.iter().zip(next) {
        let ([upper_x, upper_y], [lower_x, lower_y]) =
            if (a[1], a[0]) <= (b[1], b[0]) { (*a, *b) } else { (*b, *a) };
        if !(upper_y..=lower_y).contains(&y) {
            continue;
        }
        let high = lower_y - upper_y;
        // A level edge has no single crossing: it is one.
        if high == 0.0 {
            left = left.min(upper_x);
            right = right.max(lower_x);
        } else {
            let x = upper_x + (lower_x - upper_x) * ((y - upper_y) / high);
            left = left.min(x);
            right = right.max(x);
        }
    }
    (left, right)
}

/// The part of a triangle that is far enough in front of the camera: its corners, and how many they are.
fn in_front(corners: &[Vector3<f64>; 3]) -> ([Vector3<f64>; MOST_CORNERS], usize) {
    let (mut kept, mut count) = ([Vector3::zeros(); MOST_CORNERS], 0);
    let mut keep = |corner: Vector3<f64>| {
        if let Some(slot) = kept.get_mut(count) {
            *slot = corner;
            count += 1;
        }
    };
    let next = corners.iter().cycle().skip(1);
    for (a, b) in corners.iter().zip(next) {
        if a.z >= NEAR_M {
            keep(*a);
        }
        if (a.z >= NEAR_M) != (b.z >= NEAR_M) {
            keep(a + (b - a) * ((NEAR_M - a.z) / (b.z - a.z)));
        }
    }
    (kept, count)
}
