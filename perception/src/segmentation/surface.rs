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

/// Pixels of a row that are looked at together.
// Vectors of every processor divide it. The sums of a pixel stay in the order of its window, so that its bits are those of a pixel alone.
const LANES: usize = 16;

/// Planes through the neighbours of each pixel.
#[derive(Debug, Default)]
pub(super) struct Surface {
    /// (3, height * width) In the camera's frame, metres; z = 0 where there is none.
    points: [Vec<f32>; 3],
    /// (3, height * width) Towards the camera; 0 where there is none.
    normals: [Vec<f32>; 3],
}

/// Sums over a window: moments of the pixels' places about its middle, how many they are, and the inverse depths beside the middle's.
#[derive(Clone, Copy)]
struct Moments {
    aa: f32,
    ab: f32,
    a1: f32,
    bb: f32,
    b1: f32,
    count: f32,
    sums: [f32; 3],
}

/// The pixels around each, within a reach, as far as they are inside an image.
#[derive(Clone, Copy)]
struct Window<'w> {
    image: &'w Image<'w>,
    components: &'w [u32],
    width: i64,
    height: i64,
    reach: i64,
}

impl Surface {
    /// Of an image that is too large for one.
    pub(super) fn clear(&mut self) {
        self.points.iter_mut().chain(&mut self.normals).for_each(Vec::clear);
    }

    /// Of a pixel, in the camera's frame, metres.
    pub(super) fn point(&self, at: usize) -> Point3<f32> {
        let [x, y, z] = &self.points;
        Point3::new(x[at], y[at], z[at])
    }

    /// Of a pixel, towards the camera; none where there is none, and in images that are too large.
    pub(super) fn normal(&self, at: usize) -> Option<Vector3<f32>> {
        let [x, y, z] = &self.normals;
        let normal = Vector3::new(*x.get(at)?, *y.get(at)?, *z.get(at)?);
        (normal != Vector3::zeros()).then_some(normal)
    }

    /// Whether the image is small enough for one.
    pub(super) fn is_there(&self) -> bool {
        !self.normals[0].is_empty()
    }

    /// Fits a plane to the pixels of the same component within `reach` pixels.
    pub(super) fn fit(&mut self, image: &Image<'_>, components: &[u32], reach: usize) {
        let window = Window::new(image, components, reach);
        let width = image.width.max(1);
        self.clear();
        self.points.iter_mut().chain(&mut self.normals).for_each(|each| {
            each.resize(components.len(), 0.0);
        });
        let [px, py, pz] = &mut self.points;
        let [nx, ny, nz] = &mut self.normals;
        let rows = px.par_chunks_mut(width).zip(py.par_chunks_mut(width)).zip(
            pz.par_chunks_mut(width)
                .zip(nx.par_chunks_mut(width))
                .zip(ny.par_chunks_mut(width).zip(nz.par_chunks_mut(width))),
        );
        rows.enumerate().for_each(|(v, ((px, py), ((pz, nx), (ny, nz))))| {
            in_own_environment(|| {
                window.blocks(v, |u, number| {
                    let mut moments = [Moments::NONE; LANES];
                    match window.is_inside(u, number) {
                        true => moments = window.moments_of_block([u, v]),
                        false => {
                            for (k, moments) in moments.iter_mut().take(number).enumerate() {
                                *moments = window.moments([u + k, v]);
                            }
                        }
                    }
                    for (k, moments) in moments.iter().take(number).enumerate() {
                        let u = u + k;
                        if components[v * width + u] == NONE {
                            continue;
                        }
                        let (point, normal) = window.plane([u, v], moments);
                        [px[u], py[u], pz[u]] = point.into();
                        [nx[u], ny[u], nz[u]] = normal.into();
                    }
                });
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
        let window = Window::new(image, components, reach);
        let width = image.width.max(1);
        is_edge.clear();
        is_edge.resize(components.len(), false);
        is_edge.par_chunks_mut(width).enumerate().for_each(|(v, row)| {
            in_own_environment(|| {
                window.blocks(v, |u, number| {
                    let row = &mut row[u..u + number];
                    if window.is_inside(u, number) {
                        row.copy_from_slice(&self.edges_of_block(&window, [u, v]));
                        return;
                    }
                    for (k, is_edge) in row.iter_mut().enumerate() {
                        *is_edge = self.is_edge(&window, [u + k, v]);
                    }
                });
            });
        });
    }

    fn is_edge(&self, window: &Window<'_>, [u, v]: [usize; 2]) -> bool {
        let at = v * window.image.width + u;
        if window.components[at] == NONE {
            return false;
        }
        // What has no normal is at the end of a surface.
        let Some(normal) = self.normal(at) else { return true };
        let point = self.point(at);
        let gap = (window.image.gap)(point.z);
        let there = |[du, dv]: [i64; 2], steps: i64| {
            let (x, y) = (u as i64 + du * steps, v as i64 + dv * steps);
            let is_inside = x >= 0 && y >= 0 && x < window.width && y < window.height;
            let other = y.max(0) as usize * window.image.width + x.max(0) as usize;
            if is_inside { self.normal(other).map(|normal| (other, normal)) } else { None }
        };
        WAYS.into_iter().any(|way| {
            let is_off = there(way, 1)
                .is_some_and(|(at, _)| (self.point(at) - point).dot(&normal).abs() > gap);
            is_off
                || there(way, window.reach).is_some_and(|(at, other)| {
                    let across = self.point(at) - point;
                    across.z.abs() < MAX_GAPS * gap * window.reach as f32
                        && across.dot(&(other - normal)) < 0.0
                        && other.dot(&normal) < CREASE_COSINE
                })
        })
    }

    /// The same of the pixels of a block.
    fn edges_of_block(&self, window: &Window<'_>, [u, v]: [usize; 2]) -> [bool; LANES] {
        let start = v * window.image.width + u;
        let [[px, py, pz], [nx, ny, nz]] = [&self.points, &self.normals]
            .map(|each| each.each_ref().map(|each| lanes(each, start)));
        let gap = pz.map(|z| (window.image.gap)(z));
        let mut is_edge = [false; LANES];
        for way in WAYS {
            for (steps, is_far) in [(1, false), (window.reach, true)] {
                let y = v as i64 + way[1] * steps;
                if y < 0 || y >= window.height {
                    continue;
                }
                let start =
                    (start as i64 + way[1] * steps * window.width + way[0] * steps) as usize;
                let [[qx, qy, qz], [mx, my, mz]] = [&self.points, &self.normals]
                    .map(|each| each.each_ref().map(|each| lanes(each, start)));
                for k in 0..LANES {
                    let is_there = (mx[k] != 0.0) | (my[k] != 0.0) | (mz[k] != 0.0);
                    let (x, y, z) = (qx[k] - px[k], qy[k] - py[k], qz[k] - pz[k]);
                    is_edge[k] |= is_there
                        & if is_far {
                            let turn =
                                x * (mx[k] - nx[k]) + y * (my[k] - ny[k]) + z * (mz[k] - nz[k]);
                            let cosine = mx[k] * nx[k] + my[k] * ny[k] + mz[k] * nz[k];
                            (z.abs() < MAX_GAPS * gap[k] * window.reach as f32)
                                & (turn < 0.0)
                                & (cosine < CREASE_COSINE)
                        } else {
                            (x * nx[k] + y * ny[k] + z * nz[k]).abs() > gap[k]
                        };
                }
            }
        }
        for (k, is_edge) in is_edge.iter_mut().enumerate() {
            let is_there = window.components.get(start + k).is_some_and(|root| *root != NONE);
            let has_normal = nx[k] != 0.0 || ny[k] != 0.0 || nz[k] != 0.0;
            *is_edge = is_there && (!has_normal || *is_edge);
        }
        is_edge
    }
}

/// Ways to the pixels around one.
const WAYS: [[i64; 2]; 8] = [[1, 0], [-1, 0], [0, 1], [0, -1], [1, 1], [1, -1], [-1, 1], [-1, -1]];

/// The numbers of a block that begins here; 0 beyond the end, which no block inside an image reaches.
#[inline]
fn lanes<T: Copy + Default>(numbers: &[T], start: usize) -> [T; LANES] {
    numbers
        .get(start..start + LANES)
        .and_then(|lanes| lanes.try_into().ok())
        .unwrap_or([T::default(); LANES])
}

impl Moments {
    const NONE: Moments =
        Moments { aa: 0.0, ab: 0.0, a1: 0.0, bb: 0.0, b1: 0.0, count: 0.0, sums: [0.0; 3] };
}

impl<'w> Window<'w> {
    fn new(image: &'w Image<'w>, components: &'w [u32], reach: usize) -> Self {
        let width = image.width.max(1);
        let height = (components.len() / width) as i64;
        Window { image, components, width: width as i64, height, reach: reach as i64 }
    }

    /// Calls for each block of a row that has a pixel of a component: where it begins, and how many pixels it has.
    fn blocks(&self, v: usize, mut each: impl FnMut(usize, usize)) {
        let width = self.width as usize;
        let Some(row) = self.components.get(v * width..(v + 1) * width) else { return };
        for (number, block) in row.chunks(LANES).enumerate() {
            if block.iter().any(|root| *root != NONE) {
                each(number * LANES, block.len());
            }
        }
    }

    /// Whether the windows of all pixels of a block have all their columns.
    fn is_inside(&self, u: usize, number: usize) -> bool {
        let (first, reach) = (u as i64, self.reach);
        number == LANES && first >= reach && first + LANES as i64 + reach <= self.width
    }

    /// Pixels of a window that count, by row and by column.
    fn steps(&self) -> impl Iterator<Item = i64> + Clone + use<> {
        // Every second pixel suffices: neighbouring errors are much alike.
        let step = if self.reach > 3 { 2 } else { 1 };
        (-self.reach..=self.reach).step_by(step)
    }

    /// Those of one pixel.
    fn moments(&self, [u, v]: [usize; 2]) -> Moments {
        let mut moments = Moments::NONE;
        let at = v * self.width as usize + u;
        let (z, component) = (self.image.depth_m[at], self.components[at]);
        if component == NONE {
            return moments;
        }
        let (gap, middle) = ((self.image.gap)(z), 1.0 / z);
        for dv in self.steps() {
            let y = v as i64 + dv;
            if y < 0 || y >= self.height {
                continue;
            }
            for du in self.steps() {
                let x = u as i64 + du;
                if x < 0 || x >= self.width {
                    continue;
                }
                let other = y as usize * self.width as usize + x as usize;
                let depth = self.image.depth_m[other];
                let far = du.abs().max(dv.abs()) as f32;
                if self.components[other] == component
                    && (depth - z).abs() <= gap * (1.0 + GAP_GROWTH * far)
                {
                    let (a, b, w) = (du as f32, dv as f32, 1.0 / depth - middle);
                    moments.aa += a * a;
                    moments.ab += a * b;
                    moments.a1 += a;
                    moments.bb += b * b;
                    moments.b1 += b;
                    moments.count += 1.0;
                    moments.sums =
                        [moments.sums[0] + a * w, moments.sums[1] + b * w, moments.sums[2] + w];
                }
            }
        }
        moments
    }

    /// Those of the pixels of a block that [is inside](Self::is_inside).
    fn moments_of_block(&self, [u, v]: [usize; 2]) -> [Moments; LANES] {
        let start = v * self.width as usize + u;
        let z: [f32; LANES] = lanes(self.image.depth_m, start);
        let component: [u32; LANES] = lanes(self.components, start);
        let is_there = component.map(|root| root != NONE);
        let mut gap = [-1.0f32; LANES];
        let mut middle = [0.0f32; LANES];
        for k in (0..LANES).filter(|k| is_there[*k]) {
            (gap[k], middle[k]) = ((self.image.gap)(z[k]), 1.0 / z[k]);
        }
        let [mut aa, mut ab, mut a1, mut bb, mut b1, mut count] = [[0.0f32; LANES]; 6];
        let mut sums = [[0.0f32; LANES]; 3];
        for dv in self.steps() {
            let y = v as i64 + dv;
            if y < 0 || y >= self.height {
                continue;
            }
            for du in self.steps() {
                let start = (y * self.width + u as i64 + du) as usize;
                let depth: [f32; LANES] = lanes(self.image.depth_m, start);
                let other: [u32; LANES] = lanes(self.components, start);
                let (a, b) = (du as f32, dv as f32);
                let growth = 1.0 + GAP_GROWTH * du.abs().max(dv.abs()) as f32;
                for k in 0..LANES {
                    let counts =
                        (other[k] == component[k]) & ((depth[k] - z[k]).abs() <= gap[k] * growth);
                    // What does not count has no depth, perhaps, and is not divided by.
                    let one = if counts { 1.0 } else { 0.0 };
                    let w = 1.0 / if counts { depth[k] } else { 1.0 } - middle[k];
                    let w = if counts { w } else { 0.0 };
                    aa[k] += a * a * one;
                    ab[k] += a * b * one;
                    a1[k] += a * one;
                    bb[k] += b * b * one;
                    b1[k] += b * one;
                    count[k] += one;
                    sums[0][k] += a * w;
                    sums[1][k] += b * w;
                    sums[2][k] += w;
                }
            }
        }
        std::array::from_fn(|k| Moments {
            aa: aa[k],
            ab: ab[k],
            a1: a1[k],
            bb: bb[k],
            b1: b1[k],
            count: count[k],
            sums: sums.map(|sum| sum[k]),
        })
    }

    /// The point and the normal of a pixel. On a plane 1 / z is linear in pixels.
    fn plane(&self, [u, v]: [usize; 2], moments: &Moments) -> (Point3<f32>, Vector3<f32>) {
        let Moments { aa, ab, a1, bb, b1, count, sums } = *moments;
        let ([fx, fy], [cx, cy]) = (self.image.focal, self.image.centre);
        let z = self.image.depth_m[v * self.width as usize + u];
        let middle = 1.0 / z;
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
}

#[cfg(test)]
mod tests {
    use rigidformer_runtime::noise::Noise;

    use super::*;
    use crate::segmentation::image::Tabletops;

    #[test]
    fn pixels_of_a_block_have_the_bits_of_each_alone() {
        let (width, height) = (75, 21);
        let mut noise = Noise::new(5, 0);
        // A step between two sides, and pixels that were not measured.
        let depth_m: Vec<f32> = (0..width * height)
            .map(|at| {
                let (u, v) = ((at % width) as f32, (at / width) as f32);
                let side = if u > 40.0 + 0.3 * v { 0.004 * (u - 40.0) } else { 0.2 };
                if at % 37 == 5 { 0.0 } else { 1.0 + side + 0.01 * v + 0.002 * noise.normal() }
            })
            .collect();
        let components: Vec<u32> = (0..width * height)
            .map(|at| match depth_m[at] {
                0.0 => NONE,
                _ => u32::from(at / width > 9),
            })
            .collect();
        let gap = |z: f32| 0.02 * z;
        let image = Image {
            width,
            focal: [500.0, 510.0],
            centre: [37.2, 9.8],
            depth_m: &depth_m,
            tabletops: Tabletops { up: Vector3::y(), above: &[], level: &[] },
            all_m: &depth_m,
            gap: &gap,
        };
        for reach in [2, 3, 6] {
            let mut surface = Surface::default();
            surface.fit(&image, &components, reach);
            let window = Window::new(&image, &components, reach);
            let mut is_edge = Vec::new();
            surface.edges(&image, &components, reach, &mut is_edge);
            let mut blocks = 0;
            for v in 0..height {
                window.blocks(v, |u, number| blocks += usize::from(window.is_inside(u, number)));
            }
            assert!(blocks >= 2 * height, "of {reach}: {blocks}");
            let mut fitted = 0;
            for at in 0..width * height {
                let [u, v] = [at % width, at / width];
                assert_eq!(is_edge[at], surface.is_edge(&window, [u, v]), "{reach}: {u} {v}");
                if components[at] == NONE {
                    assert_eq!(surface.normal(at), None);
                    continue;
                }
                let (point, normal) = window.plane([u, v], &window.moments([u, v]));
                assert_eq!(surface.point(at), point, "{reach}: {u} {v}");
                assert_eq!(surface.normal(at).unwrap_or_default(), normal, "{reach}: {u} {v}");
                fitted += usize::from(normal != Vector3::zeros());
            }
            assert!(fitted > width * height / 2, "{fitted}");
            assert!(is_edge.iter().any(|edge| *edge) && is_edge.iter().any(|edge| !edge));
        }
    }
}
