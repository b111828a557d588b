//! From a depth image to points with normals: what is no plane falls into clusters, and each cluster gives a bounded number of
//! points.
//!
//! A depth image has 300,000 pixels. All of them are looked at once, to tell planes from bodies. A few hundred of each cluster are
//! kept. Each of those is the middle of a plane that is fitted to the pixels around it, so that the others count too.

use nalgebra::{Matrix3, Point3, Vector3};
use rigidformer_core::Plane;

use super::camera::Camera;
use super::capture::DepthView;
use super::depth_noise::DepthNoise;
use super::planes::{Ledge, Planes};

/// A point of a surface that was seen.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sample {
    /// In the world, metres.
    pub point: Point3<f32>,
    /// Unit vector towards the sensor's side, in the world.
    pub normal: Vector3<f32>,
    /// Standard deviation along the normal, metres.
    pub deviation_m: f32,
    /// Which cluster of the capture it is of.
    pub cluster: u32,
}

/// Pixels of a cluster at least, so that noise makes no units.
const LEAST_PIXELS: u32 = 12;
/// Samples of a cluster that are aimed at.
const SAMPLES: f32 = 400.0;
/// A surface that is steeper against the view than this many footprints a pixel is two surfaces.
const STEEPEST: f32 = 4.0;
/// Deviations that tell two surfaces, or a surface from a plane.
const DEVIATIONS: f32 = 3.0;
/// A plane is at least so thick, metres: rounding of depths to millimetres.
const PLANE_M: f32 = 0.003;
/// Half the side of the largest window that a normal is fitted in, pixels.
const LARGEST_WINDOW: i64 = 5;
/// A normal is fitted in the smallest window that makes its deviation smaller than this, radians.
const NORMAL_RAD: f32 = 0.06;
/// How far pixels of a bent surface may be from a plane, in footprints of a pixel.
const BENT: f32 = 0.12;
/// Surfaces that are seen flatter than this tell nothing: the cosine against the ray.
const GRAZING: f32 = 0.12;
/// A cluster is cut by what is nearer from so many pixels on, in square roots of its own.
const CUT: f32 = 0.2;
const NONE: u32 = u32::MAX;

/// What tells bodies from each other.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Segmentation {
    /// Planes, and gaps between what is left.
    #[default]
    Found,
    /// Labels of the capture: 0 is no body. What has no labels is segmented as if `Found`.
    Given,
}

/// Memory for images, used again and again.
#[derive(Debug, Default)]
pub(super) struct Sampler {
    /// (height * width) The pixel above or to the left that a pixel is connected to, in the end the first of its cluster.
    parent: Vec<u32>,
    /// (height * width) Ledges that a pixel is above, a bit each.
    stands: Vec<u8>,
    /// (clusters) First pixel, pixels, and number that samples have; `NONE` for those that are left out.
    found: Vec<Found>,
    /// (height * width) of first pixels: place in `found`.
    place: Vec<u32>,
}

#[derive(Clone, Copy, Debug)]
struct Found {
    pixels: u32,
    cluster: u32,
    /// Pixels beside something nearer, or at the border of the image.
    cut: u32,
}

/// How clusters are counted.
#[derive(Clone, Copy, Debug)]
pub(super) struct Bounds {
    /// Clusters that are kept of an image, at most: those with the most pixels.
    pub(super) clusters: usize,
    /// Number of the next cluster.
    pub(super) next: u32,
}

/// What came of an image.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct Sampled {
    /// Clusters that gave samples.
    pub(super) clusters: u32,
    /// Clusters that were left out, since there were too many.
    pub(super) left_out: u32,
    /// Share of pixels that had a depth.
    pub(super) measured: f32,
    /// Clusters that something nearer or the border of the image hides a part of, ascending.
    pub(super) cut: Vec<u32>,
}

/// A plane in a camera's frame: signed height of a pixel at depth z is `z * (normal . ray) - offset`.
struct PlaneSeen {
    normal: Vector3<f32>,
    offset: f32,
}

impl PlaneSeen {
    fn new(plane: &Plane, camera: &Camera) -> Self {
        let pose = camera.pose();
        let normal = pose.rotation.inverse_transform_vector(&plane.normal);
        PlaneSeen { normal, offset: -plane.height_m(&pose.translation.vector) }
    }
}

/// A ledge in a camera's frame.
struct LedgeSeen {
    plane: PlaneSeen,
    /// Directions along it, where their origin is, and how far it reaches.
    along: [(Vector3<f32>, f32, [f32; 2]); 2],
}

impl LedgeSeen {
    fn new(ledge: &Ledge, camera: &Camera) -> Self {
        let pose = camera.pose();
        let along = [0, 1].map(|axis| {
            let ([low, high], axis) = (ledge.ranges[axis], ledge.axes[axis]);
            // What stands at the edge reaches out over it.
            let over = 0.3 * (high - low);
            let direction = pose.rotation.inverse_transform_vector(&axis);
            (direction, axis.dot(&pose.translation.vector), [low - over, high + over])
        });
        LedgeSeen { plane: PlaneSeen::new(&ledge.plane, camera), along }
    }

    /// Whether what a pixel shows is above the ledge.
    fn carries(&self, [x, y]: [f32; 2], z: f32, deviation: f32) -> bool {
        let ray = Vector3::new(x, y, 1.0);
        let along = self.plane.normal.dot(&ray);
        let height = z * along - self.plane.offset;
        height > DEVIATIONS * deviation * along.abs() + PLANE_M
            && self.along.iter().all(|(axis, origin, [low, high])| {
                (*low..=*high).contains(&(z * axis.dot(&ray) + origin))
            })
    }
}

impl Sampler {
    /// Adds the samples of an image. With `labels` clusters are what has a label, and their numbers are the labels.
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
        self.parent.resize(width * height, NONE);
        self.place.resize(width * height, NONE);
        let measured = match labels {
            Some(labels) => self.mark_labels(view, labels),
            None => self.connect(view, planes, noise),
        };
        let (clusters, left_out) = self.number(labels, bounds);
        self.count_cuts(view, noise);
        self.pick(view, noise, samples);
        let measured = measured as f32 / (width * height).max(1) as f32;
        let is_cut = |found: &&Found| {
            found.cluster != NONE && found.cut as f32 > CUT * (found.pixels as f32).sqrt()
        };
        let mut cut: Vec<u32> =
            self.found.iter().filter(is_cut).map(|found| found.cluster).collect();
        cut.sort_unstable();
        Sampled { clusters, left_out, measured, cut }
    }

    /// Connects the pixels of no plane with those beside them at about the same depth. Gives how many pixels have a depth.
    fn connect(&mut self, view: &DepthView, planes: &Planes, noise: &DepthNoise) -> usize {
        let camera = &view.camera;
        let width = camera.size()[0] as usize;
        let ([fx, fy], [cx, cy]) = (camera.focal(), camera.centre());
        let footprint = STEEPEST / fx.min(fy);
        let ledges: Vec<LedgeSeen> =
            planes.ledges().iter().map(|ledge| LedgeSeen::new(ledge, camera)).collect();
        let planes: Vec<PlaneSeen> =
            planes.all().iter().map(|plane| PlaneSeen::new(plane, camera)).collect();
        self.stands.resize(view.depth.len(), 0);
        let mut measured = 0;
        for (v, depths) in view.depth.chunks_exact(width.max(1)).enumerate() {
            let y = (v as f32 - cy) / fy;
            for (u, steps) in depths.iter().enumerate() {
                // Depths of u16::MAX are what sensors say of what is too far or too near.
                if *steps == 0 || *steps == u16::MAX {
                    continue;
                }
                measured += 1;
                let z = f32::from(*steps) * view.scale_m;
                let deviation = noise.deviation_m(*steps);
                let x = (u as f32 - cx) / fx;
                let is_plane = planes.iter().any(|plane| {
                    let along = plane.normal.x * x + plane.normal.y * y + plane.normal.z;
                    let height = z * along - plane.offset;
                    // What is behind a plane is no body either: mirrors, and what noise makes of far ground.
                    height < DEVIATIONS * deviation * along.abs() + PLANE_M
                });
                if is_plane {
                    continue;
                }
                let at = v * width + u;
                let gap = footprint * z + 2.0 * DEVIATIONS * deviation;
                self.parent[at] = at as u32;
                let stands = ledges
                    .iter()
                    .enumerate()
                    .filter(|(_, ledge)| ledge.carries([x, y], z, deviation));
                let stands = stands.fold(0u8, |bits, (number, _)| bits | 1 << number);
                self.stands[at] = stands;
                for (there, beside) in
                    [(u > 0, at.wrapping_sub(1)), (v > 0, at.wrapping_sub(width))]
                {
                    // What stands on a ledge is another body than the ledge.
                    if !there || self.parent[beside] == NONE || self.stands[beside] != stands {
                        continue;
                    }
                    let other = f32::from(view.depth[beside]) * view.scale_m;
                    if (z - other).abs() < gap {
                        self.join(at as u32, beside as u32);
                    }
                }
            }
        }
        measured
    }

    /// Makes the first pixel with a label the parent of all others with it.
    fn mark_labels(&mut self, view: &DepthView, labels: &[u16]) -> usize {
        let mut first = vec![NONE; usize::from(u16::MAX) + 1];
        let mut measured = 0;
        for (at, (steps, label)) in view.depth.iter().zip(labels).enumerate() {
            if *steps == 0 || *steps == u16::MAX {
                continue;
            }
            measured += 1;
            if *label > 0 {
                let first = &mut first[usize::from(*label)];
                if *first == NONE {
                    *first = at as u32;
                }
                self.parent[at] = *first;
            }
        }
        measured
    }

    fn root(&mut self, mut at: u32) -> u32 {
        loop {
            let up = self.parent[at as usize];
            if up == at {
                return at;
            }
            // Halves the way for the next one.
            let over = self.parent[up as usize];
            self.parent[at as usize] = over;
            at = over;
        }
    }

    fn join(&mut self, a: u32, b: u32) {
        let (a, b) = (self.root(a), self.root(b));
        // The first pixel of a cluster is its root, whatever the order.
        let (low, high) = if a < b { (a, b) } else { (b, a) };
        self.parent[high as usize] = low;
    }

    /// Counts clusters, and gives numbers to those that are kept.
    fn number(&mut self, labels: Option<&[u16]>, bounds: Bounds) -> (u32, u32) {
        self.found.clear();
        for at in 0..self.parent.len() {
            if self.parent[at] == NONE {
                continue;
            }
            let root = self.root(at as u32) as usize;
            self.parent[at] = root as u32;
            if root == at {
                self.place[at] = self.found.len() as u32;
                self.found.push(Found { pixels: 0, cluster: NONE, cut: 0 });
            }
            let place = self.place[root] as usize;
            self.found[place].pixels += 1;
        }
        let mut kept: Vec<u32> = (0..self.found.len() as u32)
            .filter(|place| self.found[*place as usize].pixels >= LEAST_PIXELS)
            .collect();
        let all = kept.len();
        if all > bounds.clusters {
            // The order of those with as many pixels is that of their first pixels.
            kept.sort_by_key(|place| std::cmp::Reverse(self.found[*place as usize].pixels));
            kept.truncate(bounds.clusters);
            kept.sort_unstable();
        }
        let mut next = bounds.next;
        if let Some(labels) = labels {
            let marked = self.parent.iter().enumerate();
            for (at, _) in marked.filter(|(at, parent)| **parent == *at as u32) {
                let place = self.place[at];
                if kept.binary_search(&place).is_ok() {
                    self.found[place as usize].cluster = u32::from(labels[at]);
                }
            }
        } else {
            for place in &kept {
                self.found[*place as usize].cluster = next;
                next += 1;
            }
        }
        (kept.len() as u32, (all - kept.len()) as u32)
    }

    /// Counts the pixels of clusters that are beside something nearer, or at the border.
    fn count_cuts(&mut self, view: &DepthView, noise: &DepthNoise) {
        let [width, height] = view.camera.size().map(|side| side as usize);
        let [fx, fy] = view.camera.focal();
        let footprint = STEEPEST / fx.min(fy);
        for at in 0..self.parent.len() {
            let parent = self.parent[at];
            if parent == NONE {
                continue;
            }
            let (u, v) = (at % width, at / width);
            let z = f32::from(view.depth[at]) * view.scale_m;
            let gap = footprint * z + 2.0 * DEVIATIONS * noise.deviation_m(view.depth[at]);
            let is_nearer = |other: usize| {
                let steps = view.depth[other];
                steps > 0 && z - f32::from(steps) * view.scale_m > gap
            };
            let is_cut = u == 0
                || v == 0
                || u + 1 == width
                || v + 1 == height
                || [at - 1, at + 1, at - width, at + width].into_iter().any(is_nearer);
            if is_cut {
                let place = self.place[parent as usize] as usize;
                self.found[place].cut += 1;
            }
        }
    }

    /// The cluster of a pixel, and how many pixels that has.
    fn found_at(&self, at: usize) -> Option<Found> {
        let parent = *self.parent.get(at)?;
        if parent == NONE {
            return None;
        }
        let found = *self.found.get(self.place[parent as usize] as usize)?;
        (found.cluster != NONE).then_some(found)
    }

    /// Picks pixels of each cluster on a grid of its own, and fits planes around them.
    fn pick(&self, view: &DepthView, noise: &DepthNoise, samples: &mut Vec<Sample>) {
        let [width, height] = view.camera.size().map(|side| side as usize);
        for v in 0..height {
            for u in 0..width {
                let Some(found) = self.found_at(v * width + u) else { continue };
                let stride = ((found.pixels as f32 / SAMPLES).sqrt().round() as usize).max(1);
                if u % stride != 0 || v % stride != 0 {
                    continue;
                }
                if let Some(fit) = self.fit(view, noise, (u, v), stride, found) {
                    samples.push(fit);
                }
            }
        }
    }

    /// Fits a plane to the pixels of the same cluster around one. 1 / z of a plane is linear in pixels.
    fn fit(
        &self,
        view: &DepthView,
        noise: &DepthNoise,
        (u, v): (usize, usize),
        stride: usize,
        found: Found,
    ) -> Option<Sample> {
        let camera = &view.camera;
        let [width, height] = camera.size().map(|side| side as usize);
        let at = v * width + u;
        let root = self.parent[at];
        let steps = view.depth[at];
        let z = f32::from(steps) * view.scale_m;
        let deviation = noise.deviation_m(steps);
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
                if self.parent[other] != root {
                    continue;
                }
                let w = 1.0 / (f32::from(view.depth[other]) * view.scale_m) - middle;
                let (a, b) = (du as f32, dv as f32);
                let products = [a * a, a * b, a, b * b, b, 1.0];
                moments.iter_mut().zip(products).for_each(|(moment, product)| *moment += product);
                sums.iter_mut().zip([a * w, b * w, w]).for_each(|(sum, part)| *sum += part);
                squares += w * w;
            }
        }
        let [aa, ab, a, bb, b, count] = moments;
        if count < 6.0 {
            return None;
        }
        let inverse = Matrix3::new(aa, ab, a, ab, bb, b, a, b, count).try_inverse()?;
        let plane = inverse * Vector3::from(sums);
        // A window over an edge has a plane that no surface has. Round surfaces differ from their planes by less.
        let residual =
            (squares - plane.dot(&Vector3::from(sums))).max(0.0) / (count - 3.0).max(1.0);
        if residual.sqrt() * z * z > 2.5 * deviation + BENT * z / fx.min(fy) {
            return None;
        }
        // Where each pixel is a sample there is nothing to gain from its neighbours but the normal.
        let w = if stride == 1 { middle } else { middle + plane.z };
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
        if cosine < GRAZING {
            return None;
        }
        // Windows overlap: a sample has the pixels around it for its own that are nearer to it than to the next.
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

/// Half the side of a window for a normal, given the noise in footprints of a pixel.
fn window(noise: f32, stride: usize, pixels: u32) -> i64 {
    let covers = (stride / 2) as i64;
    let most = ((pixels as f32).sqrt() / 6.0) as i64;
    let most = most.clamp(1, LARGEST_WINDOW);
    let deviation = |reach: i64| {
        let side = (2 * reach + 1) as f32;
        noise / (side * side * (reach * (reach + 1)) as f32 / 3.0).sqrt()
    };
    let needed = (1..most).find(|reach| deviation(*reach) < NORMAL_RAD).unwrap_or(most);
    needed.max(covers).min(LARGEST_WINDOW.max(covers))
}
