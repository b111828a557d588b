//! A small renderer: planes with a grid and shadows, shaded triangles, dots; a depth buffer decides.

use nalgebra::{Isometry3, Point3, Vector3};
use rigidformer_core::Plane;

use super::camera::{Camera, NEAR_M, Seen};
use super::cut::in_front;
use super::mesh::{Corner, Mesh};
use super::page::Rgb;

/// Samples per pixel and axis.
const SAMPLES: usize = 3;
const SKY: Rgb = [0.955, 0.965, 0.98];
/// Of a level plane in the light; steeper ones are darker.
pub(super) const GROUND: Rgb = [0.86, 0.875, 0.895];
/// What is left of the ground's light on a plane that stands upright.
const UPRIGHT: f32 = 0.88;
const GRID: Rgb = [0.70, 0.72, 0.76];
/// Half the width of a grid line, in parts of the distance between two.
const GRID_HALF: f32 = 0.012;
/// How far in front of its surface a point is drawn, likewise.
const LIFT: f32 = 0.02;
/// What is left of a plane's light in a shadow.
const SHADOW: f32 = 0.66;

/// Half the width of the lines between the triangles of a sheet, samples, and what is left of its light there: without them a
/// smooth sheet hides how it is bent and stretched.
const LINE_HALF: f32 = 0.75;
const LINE: f32 = 0.80;

/// A unit to draw.
pub(super) struct Body<'a> {
    pub(super) mesh: &'a Mesh,
    pub(super) points: &'a [Point3<f32>],
    pub(super) pose: Isometry3<f32>,
    pub(super) colour: Rgb,
    /// Of a surface that is seen from both sides: how far in front of itself it is drawn, metres.
    pub(super) sheet: Option<f32>,
}

struct Canvas {
    width: usize,
    height: usize,
    /// (height, width)
    colour: Vec<Rgb>,
    /// (height, width) distance along the view's axis
    depth: Vec<f32>,
}

/// Renders bodies between planes into (height, width) pixels. A plane is seen from its free side only.
pub(super) fn render(
    bodies: &[Body<'_>],
    planes: &[Plane],
    camera: &Camera,
    width: usize,
    height: usize,
) -> Vec<Rgb> {
    let (wide, high) = (width * SAMPLES, height * SAMPLES);
    let mut canvas = Canvas {
        width: wide,
        height: high,
        colour: vec![SKY; wide * high],
        depth: vec![f32::INFINITY; wide * high],
    };
    let light = light(camera);
    for plane in planes {
        canvas.plane(plane, camera, &shadow_mask(bodies, plane, camera, &light, wide, high));
    }
    // What goes through a plane is seen all the same: that a prediction does so must not be hidden.
    canvas.depth.fill(f32::INFINITY);
    for body in bodies {
        for triangle in &body.mesh.triangles {
            let mut placed = triangle.map(|corner| Corner {
                point: body.pose * corner.point,
                normal: body.pose * corner.normal,
            });
            if body.sheet.is_some() {
                turn_to(&mut placed, &camera.eye());
            }
            // A line along a cut would be none between two triangles.
            let is_whole = placed.iter().all(|corner| camera.depth_m(&corner.point) >= NEAR_M);
            let has_lines = is_whole && body.sheet.is_some();
            let lift_m = body.sheet.unwrap_or(0.0);
            let depth_m = |corner: &Corner| camera.depth_m(&corner.point);
            for placed in in_front(placed, NEAR_M, depth_m, Corner::between) {
                let seen = |corner: &Corner| {
                    let seen = sample(camera.see_cut(&corner.point)?);
                    Some(Seen { depth: (seen.depth - lift_m).max(0.5 * seen.depth), ..seen })
                };
                let [a, b, c] = placed.each_ref().map(seen);
                let (Some(a), Some(b), Some(c)) = (a, b, c) else { continue };
                let heights = has_lines.then(|| heights(&[a, b, c]));
                let shades =
                    placed.map(|corner| shade(&corner.point, &corner.normal, &light, camera));
                canvas.triangle([a, b, c], |weights, at, canvas| {
                    let [diffuse, gloss] = [0, 1].map(|k| {
                        weights
                            .iter()
                            .zip(&shades)
                            .map(|(weight, shade): (&f32, &[f32; 2])| weight * shade[k])
                            .sum::<f32>()
                    });
                    let left = heights.map_or(1.0, |heights| line(&weights, &heights));
                    canvas.colour[at] = body
                        .colour
                        .map(|channel| (left * (channel * diffuse + gloss)).clamp(0.0, 1.0));
                });
            }
        }
    }
    for body in bodies {
        let dark = body.colour.map(|channel| channel * 0.45);
        for point in body.points {
            if let Some(seen) = camera.see(&(body.pose * point)) {
                canvas.dot(sample(seen), LIFT * camera.grid_m(), dark);
            }
        }
    }
    canvas.averaged(width)
}

/// Of a triangle on the picture, how far each corner is from the side opposite, samples.
fn heights(corners: &[Seen; 3]) -> [f32; 3] {
    let [a, b, c] = corners;
    let area = ((b.x - a.x) * (c.y - a.y) - (b.y - a.y) * (c.x - a.x)).abs();
    let side = |p: &Seen, q: &Seen| (p.x - q.x).hypot(p.y - q.y).max(1e-6);
    [area / side(b, c), area / side(c, a), area / side(a, b)]
}

/// What is left of the light where a sample of a triangle, given by its corners' weights, lies on a line between two triangles.
fn line(weights: &[f32; 3], heights: &[f32; 3]) -> f32 {
    let apart = weights.iter().zip(heights).map(|(weight, height)| weight * height);
    if apart.fold(f32::INFINITY, f32::min) < LINE_HALF { LINE } else { 1.0 }
}

/// Makes a triangle's normals point to the side that is seen.
fn turn_to(corners: &mut [Corner; 3], eye: &Point3<f32>) {
    let [a, b, c] = corners.map(|corner| corner.point);
    let facing = (b - a).cross(&(c - a)).dot(&(eye - a));
    for corner in corners.iter_mut() {
        // By the triangle's winding, whose side its smooth normals are on.
        if facing < 0.0 {
            corner.normal = -corner.normal;
        }
    }
}

/// Towards the light: high, from behind the viewer's left shoulder.
fn light(camera: &Camera) -> Vector3<f32> {
    (Vector3::new(0.0, 0.0, 1.0) - camera.right() * 0.45 - camera.forward() * 0.25).normalize()
}

/// Where a place of the picture is among the samples.
fn sample(seen: Seen) -> Seen {
    Seen { x: seen.x * SAMPLES as f32, y: seen.y * SAMPLES as f32, ..seen }
}

/// Factor of the surface's own colour, and white added to it.
fn shade(
    point: &Point3<f32>,
    normal: &Vector3<f32>,
    light: &Vector3<f32>,
    camera: &Camera,
) -> [f32; 2] {
    let sky = 0.5 + 0.5 * normal.z;
    let direct = normal.dot(light).max(0.0);
    let half = (light + (camera.eye() - point).normalize()).normalize();
    let fill = normal.dot(&(camera.eye() - point).normalize()).max(0.0);
    [0.44 + 0.20 * sky + 0.36 * direct + 0.12 * fill, 0.14 * normal.dot(&half).max(0.0).powi(24)]
}

/// (height, width) how much of each sample of a plane lies in shadow, with soft edges.
fn shadow_mask(
    bodies: &[Body<'_>],
    plane: &Plane,
    camera: &Camera,
    light: &Vector3<f32>,
    wide: usize,
    high: usize,
) -> Vec<f32> {
    let mut canvas = Canvas {
        width: wide,
        height: high,
        colour: vec![[0.0; 3]; wide * high],
        depth: vec![f32::INFINITY; wide * high],
    };
    let fall = plane.normal.dot(light);
    // Light that comes flat or from behind casts no shadow.
    let lit = if fall > 0.05 { bodies } else { &[] };
    for body in lit {
        for triangle in &body.mesh.triangles {
            let fallen = triangle.map(|corner| {
                let point = body.pose * corner.point;
                point - light * (plane.height_m(&point.coords).max(0.0) / fall)
            });
            let between = |a: &Point3<f32>, b: &Point3<f32>, part: f32| a + (b - a) * part;
            for part in in_front(fallen, NEAR_M, |point| camera.depth_m(point), between) {
                let [a, b, c] = part.map(|point| camera.see_cut(&point).map(sample));
                if let (Some(a), Some(b), Some(c)) = (a, b, c) {
                    canvas.triangle([a, b, c], |_, at, canvas| canvas.colour[at] = [1.0; 3]);
                }
            }
        }
    }
    let mut mask: Vec<f32> = canvas.colour.iter().map(|[shadow, ..]| *shadow).collect();
    for _ in 0..2 {
        mask = blurred_rows(&mask, wide, 2 * SAMPLES);
        mask = transposed(&blurred_rows(&transposed(&mask, wide), high, 2 * SAMPLES), high);
    }
    mask
}

/// Every value replaced by the mean of its row within `radius`.
fn blurred_rows(values: &[f32], width: usize, radius: usize) -> Vec<f32> {
    let mut out = Vec::with_capacity(values.len());
    for row in values.chunks_exact(width) {
        let mut sum: f32 = row.iter().take(radius).sum();
        for x in 0..width {
            sum += row.get(x + radius).copied().unwrap_or(0.0);
            out.push(sum / (2 * radius + 1) as f32);
            sum -= x.checked_sub(radius).map_or(0.0, |left| row[left]);
        }
    }
    out
}

fn transposed(values: &[f32], width: usize) -> Vec<f32> {
    let height = values.len() / width.max(1);
    (0..values.len()).map(|at| values[(at % height) * width + at / height]).collect()
}

impl Canvas {
    /// A plane with a grid that fades with distance, darkened by the mask.
    fn plane(&mut self, plane: &Plane, camera: &Camera, shadow: &[f32]) {
        // Directions of the grid: x and y of a level plane.
        let axis = if plane.normal.x.abs() < 0.9 { Vector3::x() } else { Vector3::y() };
        let along = (axis - plane.normal * plane.normal.dot(&axis)).normalize();
        let across = plane.normal.cross(&along);
        let height = plane.height_m(&camera.eye().coords).max(camera.grid_m());
        let tone = UPRIGHT + (1.0 - UPRIGHT) * plane.normal.z.abs();
        for (at, shadow) in shadow.iter().enumerate() {
            let (x, y) = ((at % self.width) as f32 + 0.5, (at / self.width) as f32 + 0.5);
            let pixel = (x / SAMPLES as f32, y / SAMPLES as f32);
            let Some((point, depth)) = camera.meet(pixel, plane) else { continue };
            if depth >= self.depth[at] {
                continue;
            }
            let to_line = |v: f32| (v / camera.grid_m() - (v / camera.grid_m()).round()).abs();
            let on_line = |axis: &Vector3<f32>| to_line(point.coords.dot(axis));
            let on_grid = on_line(&along).min(on_line(&across)) < GRID_HALF;
            let fade = (-(depth / height / 7.0).powi(2)).exp();
            let lit = mix(GROUND, GRID, if on_grid { fade } else { 0.0 });
            let left = tone * (1.0 - (1.0 - SHADOW) * shadow);
            self.colour[at] = mix(SKY, lit.map(|channel| channel * left), fade);
            self.depth[at] = depth;
        }
    }

    /// Calls `paint` with the corners' weights for every sample of a triangle that nothing is in front of.
    fn triangle(&mut self, corners: [Seen; 3], paint: impl Fn([f32; 3], usize, &mut Canvas)) {
        let [a, b, c] = corners;
        let area = (b.x - a.x) * (c.y - a.y) - (b.y - a.y) * (c.x - a.x);
        if area.abs() < 1e-9 {
            return;
        }
        let range = |values: [f32; 3], limit: usize| {
            let low = values.into_iter().fold(f32::MAX, f32::min).floor().clamp(0.0, limit as f32)
                as usize;
            let high = values.into_iter().fold(f32::MIN, f32::max).ceil().clamp(0.0, limit as f32)
                as usize;
            low..high
        };
        for y in range(corners.map(|corner| corner.y), self.height) {
            for x in range(corners.map(|corner| corner.x), self.width) {
                let (px, py) = (x as f32 + 0.5, y as f32 + 0.5);
                let edge =
                    |p: Seen, q: Seen| ((q.x - p.x) * (py - p.y) - (q.y - p.y) * (px - p.x)) / area;
                let weights = [edge(b, c), edge(c, a), edge(a, b)];
                if weights.iter().any(|weight| *weight < 0.0) {
                    continue;
                }
                let depth =
                    1.0 / (weights[0] / a.depth + weights[1] / b.depth + weights[2] / c.depth);
                let at = y * self.width + x;
                if depth < self.depth[at] {
                    self.depth[at] = depth;
                    paint(weights, at, self);
                }
            }
        }
    }

    fn dot(&mut self, seen: Seen, lift_m: f32, colour: Rgb) {
        let radius = SAMPLES as f32 * 1.15;
        // In front of the surface that it lies on, not of others.
        let depth = seen.depth - lift_m;
        let reach = radius.ceil() as i64;
        for dy in -reach..=reach {
            for dx in -reach..=reach {
                let (x, y) = (seen.x.round() as i64 + dx, seen.y.round() as i64 + dy);
                let inside =
                    (0..self.width as i64).contains(&x) && (0..self.height as i64).contains(&y);
                if !inside || ((dx * dx + dy * dy) as f32) > radius * radius {
                    continue;
                }
                let at = y as usize * self.width + x as usize;
                if depth < self.depth[at] {
                    self.colour[at] = mix(self.colour[at], colour, 0.75);
                }
            }
        }
    }

    /// Means of `SAMPLES` x `SAMPLES` samples.
    fn averaged(&self, width: usize) -> Vec<Rgb> {
        let height = self.height / SAMPLES;
        let count = (SAMPLES * SAMPLES) as f32;
        let mut out = Vec::with_capacity(width * height);
        for at in 0..width * height {
            let (x, y) = (at % width * SAMPLES, at / width * SAMPLES);
            let mut sum = [0.0; 3];
            for dy in 0..SAMPLES {
                for sample in &self.colour[(y + dy) * self.width + x..][..SAMPLES] {
                    sum = [0, 1, 2].map(|k| sum[k] + sample[k]);
                }
            }
            out.push(sum.map(|channel| channel / count));
        }
        out
    }
}

fn mix(under: Rgb, over: Rgb, part: f32) -> Rgb {
    [0, 1, 2].map(|k| under[k] + (over[k] - under[k]) * part)
}
