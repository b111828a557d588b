//! From a depth image to points with normals. Pixels of no plane form clusters, and each cluster gives a bounded number of points.
//!
//! A depth image has 300,000 pixels. One pass over all of them separates planes from bodies. A few hundred pixels of each cluster become
//! samples. A plane is fitted to the pixels around each, so that the others count too.

use nalgebra::{Matrix3, Point3, Vector3};
use rigidformer_core::Plane;

use super::camera::Camera;
use super::capture::{DepthView, View};
use super::depth_noise::DepthNoise;
use super::planes::{Planes, SmoothError, Tabletop, height_m};
use super::segmentation::{Image, NONE, Segmenter, Tabletops};

/// A measured point of a surface.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sample {
    /// In the world, metres.
    pub point: Point3<f32>,
    /// Unit vector towards the sensor's side, in the world.
    pub normal: Vector3<f32>,
    /// Standard deviation along the normal, metres.
    pub deviation_m: f32,
    /// Number of its cluster in the capture.
    pub cluster: u32,
}

/// Pixels of a cluster, at least.
// Smaller clusters are noise.
const MIN_PIXELS: u32 = 12;
/// Samples of a cluster, about.
// It bounds the time of registration, whatever the size of a body in the image.
const SAMPLES_A_CLUSTER: f32 = 400.0;
/// Change of depth between neighbouring pixels, in footprints of a pixel, from which they are of two surfaces.
// A steeper surface is within 14 degrees of the ray, and hardly visible.
const MAX_SLOPE: f32 = 4.0;
/// Standard deviations that separate two surfaces, or a surface from a plane.
const DEVIATIONS: f32 = 3.0;
/// Least distance from a plane, metres.
// Depths are rounded to millimetres.
const PLANE_M: f32 = 0.003;
/// Half the side of the largest window for a normal, pixels.
// A window has at most 11 x 11 pixels, which bounds the time of a sample.
const MAX_WINDOW: i64 = 5;
/// Deviation of a normal that determines the size of its window, radians.
// Small windows follow curved surfaces, and large ones average noise: the smallest sufficient one is taken.
const NORMAL_DEVIATION_RAD: f32 = 0.06;
/// Deviation from a plane that curvature explains, in footprints of a pixel.
const MAX_CURVATURE: f32 = 0.12;
/// Least cosine between a normal and the ray.
// At grazing incidence a small error of the pixel is a large one of the depth.
const MIN_COSINE: f32 = 0.12;
/// Pixels beside something nearer from which a cluster is occluded, in square roots of its pixels.
// The square root grows as the outline of the cluster does.
const MIN_OCCLUDED: f32 = 0.2;
const UNASSIGNED: u32 = NONE;
/// Share of a tabletop's extent by which a body at its edge reaches over it.
const OVER_EDGE: f32 = 0.3;
/// Share of a smooth error's deviation by which neighbouring pixels differ, at most, in deviations.
// A sensor that measures in steps has them: its smooth error is of their size.
const STEP_DEVIATIONS: f32 = 3.0;

/// What separates bodies.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Segmentation {
    /// Planes, and gaps between clusters of the other pixels.
    #[default]
    Found,
    /// Labels of the capture: 0 is no body. Captures without labels are segmented as with `Found`.
    Given,
}

/// Buffers for an image, which keep their memory.
#[derive(Debug, Default)]
pub(super) struct Sampler {
    /// (height * width) The first pixel of a pixel's cluster.
    parent: Vec<u32>,
    /// (height * width) Depths of all pixels, and of those of no plane; 0 for the others, metres.
    all_m: Vec<f32>,
    depth_m: Vec<f32>,
    pub(super) segmenter: Segmenter,
    /// (height * width) Tabletops that a pixel is above, and those at whose height and in whose extent it is, a bit each.
    above: Vec<u8>,
    level: Vec<u8>,
    /// (clusters) Pixels, and the number that samples have; `UNASSIGNED` for clusters that are left out.
    found: Vec<Count>,
    /// (height * width) Index of a first pixel's cluster in `found`.
    cluster_index: Vec<u32>,
}

/// Bytes of these buffers for a pixel.
const BYTES_A_PIXEL: usize = 4 * size_of::<u32>() + 2;

#[derive(Clone, Copy, Debug)]
struct Count {
    pixels: u32,
    cluster: u32,
    /// Pixels beside something nearer, or at the border of the image.
    occluded: u32,
}

/// Bounds and numbers of clusters.
#[derive(Clone, Copy, Debug)]
pub(super) struct Bounds {
    /// Clusters of an image, at most: those with the most pixels.
    pub(super) clusters: usize,
    /// Number of the next cluster.
    pub(super) next: u32,
}

/// Result of sampling an image.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct Sampled {
    /// Clusters that gave samples.
    pub(super) clusters: u32,
    /// Clusters beyond the bound.
    pub(super) left_out: u32,
    /// Share of pixels that had a depth.
    pub(super) measured: f32,
    /// Clusters that something nearer or the border of the image occludes in part, ascending.
    pub(super) occluded: Vec<u32>,
}

/// A plane in a camera's frame: signed height of a pixel at depth z is `z * (normal . ray) - offset`.
struct CameraPlane {
    normal: Vector3<f32>,
    offset: f32,
}

impl CameraPlane {
    fn new(plane: &Plane, camera: &Camera) -> Self {
        let pose = camera.pose();
        let normal = pose.rotation.inverse_transform_vector(&plane.normal);
        CameraPlane { normal, offset: -height_m(plane, &pose.translation.vector) }
    }
}

/// A tabletop in a camera's frame.
struct CameraTabletop {
    plane: CameraPlane,
    /// Directions along it, the camera's coordinates along them, and its extent.
    along: [(Vector3<f32>, f32, [f32; 2]); 2],
}

/// Where a point is.
enum Place {
    Above,
    Level,
    Elsewhere,
}

impl CameraTabletop {
    fn new(tabletop: &Tabletop, camera: &Camera) -> Self {
        let pose = camera.pose();
        let along = [0, 1].map(|axis| {
            let (range, axis) = (tabletop.ranges[axis], tabletop.axes[axis]);
            let direction = pose.rotation.inverse_transform_vector(&axis);
            (direction, axis.dot(&pose.translation.vector), range)
        });
        CameraTabletop { plane: CameraPlane::new(&tabletop.plane, camera), along }
    }

    /// Where the point of a pixel is.
    fn place(&self, [x, y]: [f32; 2], z: f32, deviation: f32) -> Place {
        let ray = Vector3::new(x, y, 1.0);
        let along = self.plane.normal.dot(&ray);
        let height = z * along - self.plane.offset;
        let limit = DEVIATIONS * deviation * along.abs() + PLANE_M;
        let is_within = |over: f32| {
            self.along.iter().all(|(axis, origin, [low, high])| {
                let over = over * (high - low);
                (low - over..=high + over).contains(&(z * axis.dot(&ray) + origin))
            })
        };
        match height {
            height if height > limit && is_within(OVER_EDGE) => Place::Above,
            height if height.abs() <= limit && is_within(0.0) => Place::Level,
            _ => Place::Elsewhere,
        }
    }
}

/// So many zeros. New memory has them already, and is not touched.
fn make_zero<T: Clone>(buffer: &mut Vec<T>, zero: T, length: usize) {
    if buffer.capacity() < length {
        *buffer = vec![zero; length];
    } else {
        buffer.clear();
        buffer.resize(length, zero);
    }
}

/// Bytes that a view takes, and what is made of it: buffers of each pixel. Of clouds so many points are looked at.
pub(super) fn bytes_to_sample(view: &View) -> u64 {
    let numbers =
        |labels: &Option<Vec<u16>>| labels.as_ref().map_or(0, Vec::len) * size_of::<u16>();
    let bytes = match view {
        View::Depth(view) => {
            let pixels = view.depth.len();
            pixels * (size_of::<u16>() + Segmenter::bytes_a_pixel(pixels) + BYTES_A_PIXEL)
                + numbers(&view.labels)
        }
        View::Cloud(cloud) => size_of_val(cloud.points.as_slice()) + numbers(&cloud.labels),
    };
    bytes as u64
}

impl Sampler {
    /// Bytes that its buffers keep, about.
    pub(super) fn bytes(&self) -> u64 {
        let pixels = self.parent.capacity();
        (pixels * (BYTES_A_PIXEL + Segmenter::bytes_a_pixel(pixels))) as u64
    }

    /// Adds the samples of an image. With labels, a cluster is the pixels of one label, and has its number.
    pub(super) fn sample(
        &mut self,
        view: &DepthView,
        planes: &Planes,
        noise: &DepthNoise,
        segmentation: Segmentation,
        bounds: Bounds,
        samples: &mut Vec<Sample>,
    ) -> Sampled {
        let [width, height] = view.camera.size().map(|side| side as usize);
        let labels = match segmentation {
            Segmentation::Given => view.labels.as_deref(),
            Segmentation::Found => None,
        };
        self.parent.clear();
        self.parent.resize(width * height, UNASSIGNED);
        self.cluster_index.resize(width * height, UNASSIGNED);
        let smooth = planes.smooth_error();
        let measured = match labels {
            Some(labels) => self.mark_labels(view, labels),
            None => self.segment(view, planes, noise),
        };
        let (clusters, left_out) = self.number(labels, bounds);
        self.count_occlusions(view, noise, smooth);
        self.sample_clusters(view, noise, smooth, samples);
        let measured = measured as f32 / (width * height).max(1) as f32;
        let is_occluded = |found: &&Count| {
            found.cluster != UNASSIGNED
                && found.occluded as f32 > MIN_OCCLUDED * (found.pixels as f32).sqrt()
        };
        let mut occluded: Vec<u32> =
            self.found.iter().filter(is_occluded).map(|found| found.cluster).collect();
        occluded.sort_unstable();
        Sampled { clusters, left_out, measured, occluded }
    }

    /// Adds to the numbers of the last image's clusters.
    pub(super) fn add_to_numbers(&mut self, more: u32) {
        let kept = self.found.iter_mut().filter(|found| found.cluster != UNASSIGNED);
        kept.for_each(|found| found.cluster += more);
    }

    /// (height * width) The cluster of each pixel of the last image; none for pixels of no cluster.
    pub(super) fn clusters(&self) -> impl Iterator<Item = Option<u32>> {
        (0..self.parent.len()).map(|at| self.found_at(at).map(|found| found.cluster))
    }

    /// Segments the pixels of no plane. Returns how many pixels have a depth.
    fn segment(&mut self, view: &DepthView, planes: &Planes, noise: &DepthNoise) -> usize {
        let camera = &view.camera;
        let width = camera.size()[0] as usize;
        let (focal, centre) = (camera.focal(), camera.centre());
        let ([fx, fy], [cx, cy]) = (focal, centre);
        let smooth = planes.smooth_error();
        let up = camera.pose().rotation.inverse_transform_vector(&planes.up());
        let tabletops: Vec<CameraTabletop> = planes
            .tabletops()
            .iter()
            .map(|tabletop| CameraTabletop::new(tabletop, camera))
            .collect();
        let planes: Vec<CameraPlane> =
            planes.all().iter().map(|plane| CameraPlane::new(plane, camera)).collect();
        for depths in [&mut self.all_m, &mut self.depth_m] {
            make_zero(depths, 0.0, view.depth.len());
        }
        for bits in [&mut self.above, &mut self.level] {
            make_zero(bits, 0, view.depth.len());
        }
        let mut measured = 0;
        for (v, depths) in view.depth.chunks_exact(width.max(1)).enumerate() {
            let y = (v as f32 - cy) / fy;
            for (u, steps) in depths.iter().enumerate() {
                // Sensors write u16::MAX where a surface is out of their range.
                if *steps == 0 || *steps == u16::MAX {
                    continue;
                }
                measured += 1;
                let at = v * width + u;
                let z = f32::from(*steps) * view.scale_m;
                self.all_m[at] = z;
                let x = (u as f32 - cx) / fx;
                let height = |plane: &CameraPlane| {
                    let along = plane.normal.x * x + plane.normal.y * y + plane.normal.z;
                    (along, z * along - plane.offset)
                };
                // Most pixels are this near, whatever their deviation is.
                if planes.iter().any(|plane| height(plane).1 < PLANE_M) {
                    continue;
                }
                let deviation = total_m(noise.deviation_m(*steps), smooth, z);
                let is_plane = planes.iter().any(|plane| {
                    let (along, height) = height(plane);
                    // Points behind a plane are no body either: they are mirror images, or noise of distant ground.
                    height < DEVIATIONS * deviation * along.abs() + PLANE_M
                });
                if is_plane {
                    continue;
                }
                self.depth_m[at] = z;
                for (number, tabletop) in tabletops.iter().enumerate() {
                    match tabletop.place([x, y], z, deviation) {
                        Place::Above => self.above[at] |= 1 << number,
                        Place::Level => self.level[at] |= 1 << number,
                        Place::Elsewhere => {}
                    }
                }
            }
        }
        // A covered lens costs no more than a look at each pixel.
        if measured == 0 {
            return measured;
        }
        let image = Image {
            width,
            focal,
            centre,
            depth_m: &self.depth_m,
            tabletops: Tabletops { up, above: &self.above, level: &self.level },
            all_m: &self.all_m,
            gap: &|z_m| gap_m(view, noise, smooth, z_m),
        };
        self.segmenter.segment(&image, &mut self.parent);
        measured
    }

    /// Makes the first pixel with a label the parent of all others with it.
    fn mark_labels(&mut self, view: &DepthView, labels: &[u16]) -> usize {
        let mut first = vec![UNASSIGNED; usize::from(u16::MAX) + 1];
        let mut measured = 0;
        for (at, (steps, label)) in view.depth.iter().zip(labels).enumerate() {
            if *steps == 0 || *steps == u16::MAX {
                continue;
            }
            measured += 1;
            if *label > 0 {
                let first = &mut first[usize::from(*label)];
                if *first == UNASSIGNED {
                    *first = at as u32;
                }
                self.parent[at] = *first;
            }
        }
        measured
    }

    /// Counts the pixels of clusters, and numbers those that are kept.
    fn number(&mut self, labels: Option<&[u16]>, bounds: Bounds) -> (u32, u32) {
        self.found.clear();
        for at in 0..self.parent.len() {
            if self.parent[at] == UNASSIGNED {
                continue;
            }
            let root = self.parent[at] as usize;
            if root == at {
                self.cluster_index[at] = self.found.len() as u32;
                self.found.push(Count { pixels: 0, cluster: UNASSIGNED, occluded: 0 });
            }
            let cluster_index = self.cluster_index[root] as usize;
            self.found[cluster_index].pixels += 1;
        }
        let mut kept: Vec<u32> = (0..self.found.len() as u32)
            .filter(|cluster_index| self.found[*cluster_index as usize].pixels >= MIN_PIXELS)
            .collect();
        let all = kept.len();
        if all > bounds.clusters {
            // The sort is stable: equal clusters keep the order of their first pixels.
            kept.sort_by_key(|cluster_index| {
                std::cmp::Reverse(self.found[*cluster_index as usize].pixels)
            });
            kept.truncate(bounds.clusters);
            // Numbers follow the image's order again, as without a bound.
            kept.sort_unstable();
        }
        let mut next = bounds.next;
        if let Some(labels) = labels {
            let marked = self.parent.iter().enumerate();
            for (at, _) in marked.filter(|(at, parent)| **parent == *at as u32) {
                let cluster_index = self.cluster_index[at];
                if kept.binary_search(&cluster_index).is_ok() {
                    self.found[cluster_index as usize].cluster = u32::from(labels[at]);
                }
            }
        } else {
            for cluster_index in &kept {
                self.found[*cluster_index as usize].cluster = next;
                next += 1;
            }
        }
        (kept.len() as u32, (all - kept.len()) as u32)
    }

    /// Counts the pixels of clusters beside something nearer, or at the border of the image.
    fn count_occlusions(&mut self, view: &DepthView, noise: &DepthNoise, smooth: SmoothError) {
        let [width, height] = view.camera.size().map(|side| side as usize);
        for at in 0..self.parent.len() {
            let parent = self.parent[at];
            if parent == UNASSIGNED {
                continue;
            }
            let (u, v) = (at % width, at / width);
            let z = f32::from(view.depth[at]) * view.scale_m;
            let gap = gap_m(view, noise, smooth, z);
            let is_nearer = |other: usize| {
                let steps = view.depth[other];
                steps > 0 && z - f32::from(steps) * view.scale_m > gap
            };
            let is_occluded = u == 0
                || v == 0
                || u + 1 == width
                || v + 1 == height
                || [at - 1, at + 1, at - width, at + width].into_iter().any(is_nearer);
            if is_occluded {
                let cluster_index = self.cluster_index[parent as usize] as usize;
                self.found[cluster_index].occluded += 1;
            }
        }
    }

    /// The cluster of a pixel; none where it is left out.
    fn found_at(&self, at: usize) -> Option<Count> {
        let parent = *self.parent.get(at)?;
        if parent == UNASSIGNED {
            return None;
        }
        let found = *self.found.get(self.cluster_index[parent as usize] as usize)?;
        (found.cluster != UNASSIGNED).then_some(found)
    }

    /// Samples each cluster on a grid of its own, and fits planes around the pixels.
    fn sample_clusters(
        &self,
        view: &DepthView,
        noise: &DepthNoise,
        smooth: SmoothError,
        samples: &mut Vec<Sample>,
    ) {
        let [width, height] = view.camera.size().map(|side| side as usize);
        for v in 0..height {
            for u in 0..width {
                let Some(found) = self.found_at(v * width + u) else { continue };
                let stride =
                    ((found.pixels as f32 / SAMPLES_A_CLUSTER).sqrt().round() as usize).max(1);
                // A grid in image coordinates: the same pixels are sampled in each capture.
                if u % stride != 0 || v % stride != 0 {
                    continue;
                }
                if let Some(fit) = self.fit(view, (noise, smooth), (u, v), stride, found) {
                    samples.push(fit);
                }
            }
        }
    }

    /// Fits a plane to the pixels of the same cluster around one. On a plane 1 / z is linear in pixels.
    fn fit(
        &self,
        view: &DepthView,
        (noise, smooth): (&DepthNoise, SmoothError),
        (u, v): (usize, usize),
        stride: usize,
        found: Count,
    ) -> Option<Sample> {
        let camera = &view.camera;
        let [width, height] = camera.size().map(|side| side as usize);
        let at = v * width + u;
        let root = self.parent[at];
        let steps = view.depth[at];
        let z = f32::from(steps) * view.scale_m;
        let deviation = total_m(noise.deviation_m(steps), smooth, z);
        let ([fx, fy], [cx, cy]) = (camera.focal(), camera.centre());
        let reach = window(deviation * fx / z, stride, found.pixels);
        let (middle, mut moments, mut sums) = (1.0 / z, [0.0f32; 6], [0.0f32; 3]);
        let mut squares = 0.0;
        for dv in -reach..=reach {
            for du in -reach..=reach {
                let (x, y) = (u as i64 + du, v as i64 + dv);
                if x < 0 || y < 0 || x >= width as i64 || y >= height as i64 {
                    continue;
                }
                let other = y as usize * width + x as usize;
                // Pixels of other clusters are beyond an edge.
                if self.parent[other] != root {
                    continue;
                }
                let w = 1.0 / (f32::from(view.depth[other]) * view.scale_m) - middle;
                let (a, b) = (du as f32, dv as f32);
                let products = [a * a, a * b, a, b * b, b, 1.0];
                moments.iter_mut().zip(products).for_each(|(moment, product)| *moment += product);
                sums.iter_mut().zip([a * w, b * w, w]).for_each(|(sum, product)| *sum += product);
                squares += w * w;
            }
        }
        let [aa, ab, a, bb, b, count] = moments;
        // Three unknowns need some redundancy for a residual.
        if count < 6.0 {
            return None;
        }
        let inverse = Matrix3::new(aa, ab, a, ab, bb, b, a, b, count).try_inverse()?;
        let plane = inverse * Vector3::from(sums);
        // The plane of a window across an edge is that of no surface. Curved surfaces deviate less from their planes.
        let residual =
            (squares - plane.dot(&Vector3::from(sums))).max(0.0) / (count - 3.0).max(1.0);
        if residual.sqrt() * z * z > 2.5 * deviation + MAX_CURVATURE * z / fx.min(fy) {
            return None;
        }
        // With a stride of 1 each neighbour is a sample too: the fit gives the normal alone, so that samples stay independent.
        let w = if stride == 1 { middle } else { middle + plane.z };
        // A fit that moves the depth by a factor of 5 is degenerate.
        if w.is_nan() || w <= 0.2 * middle || w > 5.0 * middle {
            return None;
        }
        let z = 1.0 / w;
        let normal = Vector3::new(
            plane.x * fx,
            plane.y * fy,
            w + plane.x * (cx - u as f32) + plane.y * (cy - v as f32),
        );
        let ray = Vector3::new((u as f32 - cx) / fx, (v as f32 - cy) / fy, 1.0);
        // Towards the camera.
        let normal = -normal.try_normalize(1e-12)?;
        let cosine = -normal.dot(&ray) / ray.norm();
        if cosine < MIN_COSINE {
            return None;
        }
        // Windows overlap: only the pixels nearer to this sample than to the next ones count as its own.
        let own = (count).min((stride * stride) as f32).max(1.0);
        let point = camera.pose() * Point3::from(ray * z);
        Some(Sample {
            point,
            normal: camera.pose().rotation * normal,
            deviation_m: deviation * -normal.dot(&ray) / own.sqrt(),
            cluster: found.cluster,
        })
    }
}

/// Standard deviation of a depth with both kinds of errors, metres.
fn total_m(noise_m: f32, smooth: SmoothError, z_m: f32) -> f32 {
    let smooth_m = smooth.deviation_m(z_m);
    (noise_m * noise_m + smooth_m * smooth_m).sqrt()
}

/// Change of depth between neighbouring pixels from which they are of two surfaces, metres.
fn gap_m(view: &DepthView, noise: &DepthNoise, smooth: SmoothError, z_m: f32) -> f32 {
    let [fx, fy] = view.camera.focal();
    let steps = (z_m / view.scale_m).clamp(0.0, f32::from(u16::MAX)) as u16;
    // The difference of two depths has the noise of both.
    let noise_m = 2.0 * DEVIATIONS * noise.deviation_m(steps);
    MAX_SLOPE * z_m / fx.min(fy) + noise_m + STEP_DEVIATIONS * smooth.deviation_m(z_m)
}

/// Half the side of the window for a normal, given the noise of the depth in footprints of a pixel.
fn window(noise: f32, stride: usize, pixels: u32) -> i64 {
    // Windows cover at least their cell of the grid, so that all pixels count.
    let covers = (stride / 2) as i64;
    // A window of a third of the cluster's width stays clear of most of its edges.
    let most = ((pixels as f32).sqrt() / 6.0) as i64;
    let most = most.clamp(1, MAX_WINDOW);
    let deviation = |reach: i64| {
        let side = (2 * reach + 1) as f32;
        noise / (side * side * (reach * (reach + 1)) as f32 / 3.0).sqrt()
    };
    let needed = (1..most).find(|reach| deviation(*reach) < NORMAL_DEVIATION_RAD).unwrap_or(most);
    needed.max(covers).min(MAX_WINDOW.max(covers))
}
