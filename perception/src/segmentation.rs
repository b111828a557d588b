//! Bodies in a depth image: pixels of one surface, cut at jumps of depth and at concave creases.
//!
//! 1. Pixels of no plane that are neighbours at about the same depth form *components*.
//! 2. A plane is fitted to the pixels around each pixel. It gives a smoothed depth and a normal.
//! 3. A pixel is an *edge* where the surface beside it is elsewhere, or where it turns towards the sensor: bodies that touch meet in a
//!    concave crease, and a convex body has none (Tateno, Tombari and Navab, *Real-time and scalable incremental segmentation*, 2015).
//! 4. Connected pixels that are no edges are *cores*. Small ones are noise. Cores grow back over the rest of their component.
//! 5. [`parting`] parts what stands on a tabletop from the body that the tabletop is of.
//! 6. [`joining`] joins the inside of a hollow body to its outside, and what an occluder cuts in two.
//!
//! Lengths follow the noise of the sensor and the footprint of a pixel, so that one set of constants serves all sensors and distances.

mod image;
mod joining;
mod parting;
mod surface;

use std::ops::Range;

pub(super) use image::{Image, NONE, Tabletops};
use surface::Surface;

/// Half the side of a normal's window, and the distance of the normals that are compared, radians.
// A window of half a degree has 11 x 11 pixels of a Kinect: fewer do not average its steps, and more round off small bodies.
const REACH_RAD: f32 = 5.0 / 525.0;
const REACH_PIXELS: [usize; 2] = [2, 6];
/// Pixels of an image whose surface is fitted, at most. Bodies of larger images end at jumps of depth alone.
// It bounds time and memory: a pixel takes some 40 bytes, and a plane of 36 others. Depth cameras have 1 to 2 million.
const MAX_FITTED_PIXELS: usize = 4 << 20;
/// Pixels of a core, at least: this share of its component, between these bounds.
// Smaller cores are islands between edges of noise. What is small in itself is its whole component.
const MIN_CORE: [u32; 2] = [30, 400];
const MIN_CORE_SHARE: f32 = 0.1;

/// Of each row, the pixels from the first to the last of no plane.
// Bodies fill a part of an image, and most steps look at nothing else.
#[derive(Debug, Default)]
struct Pixels(Vec<Range<usize>>);

impl Pixels {
    fn find(&mut self, image: &Image<'_>) {
        let width = image.width.max(1);
        self.0.clear();
        let rows = image.depth_m.chunks(width).enumerate();
        self.0.extend(rows.filter_map(|(v, row)| {
            let first = row.iter().position(|depth_m| *depth_m > 0.0)?;
            let last = row.iter().rposition(|depth_m| *depth_m > 0.0)?;
            Some(v * width + first..v * width + last + 1)
        }));
    }

    /// Ascending.
    fn iter(&self) -> impl Iterator<Item = usize> {
        self.0.iter().cloned().flatten()
    }
}

/// Buffers that keep their memory from image to image.
#[derive(Debug, Default)]
pub(super) struct Segmenter {
    pixels: Pixels,
    /// (height * width) Union-find forest of components.
    components: Vec<u32>,
    /// (height * width) Union-find forest of cores.
    cores: Vec<u32>,
    /// (height * width) Pixels of a tree, at its root.
    sizes: Vec<u32>,
    surface: Surface,
    /// (height * width)
    is_edge: Vec<bool>,
}

impl Segmenter {
    /// Bytes that an image of so many pixels takes for each, with what is only there meanwhile.
    pub(super) fn bytes_a_pixel(pixels: usize) -> usize {
        // Components, sizes, what is above a tabletop; then cores, their sizes, edges, points, normals and lists of pixels.
        if pixels <= MAX_FITTED_PIXELS { 9 + 41 } else { 9 }
    }

    /// The segment of each pixel, as the number of its first pixel; [`NONE`] for pixels of no body.
    pub(super) fn segment(&mut self, image: &Image<'_>, segments: &mut Vec<u32>) {
        let is_fitted = image.depth_m.len() <= MAX_FITTED_PIXELS;
        self.pixels.find(image);
        self.connect_components(image, |_, _| true);
        if is_fitted {
            let reach = (REACH_RAD * image.focal[0].min(image.focal[1])).round() as usize;
            let reach = reach.clamp(REACH_PIXELS[0], REACH_PIXELS[1]);
            self.surface.fit(image, &self.components, reach);
            self.surface.edges(image, &self.components, reach, &mut self.is_edge);
        } else {
            self.surface.clear();
            self.is_edge.clear();
        }
        self.segment_components(image, segments);
        if let Some(above) = parting::above(image, &self.surface, segments) {
            self.connect_components(image, |a, b| above[a] == above[b]);
            self.segment_components(image, segments);
        }
        if is_fitted {
            joining::join(image, &self.surface, segments);
        }
        self.number_by_first_pixel(segments);
    }

    /// Connects the pixels of no plane that may be of one body.
    fn connect_components(&mut self, image: &Image<'_>, is_one: impl Fn(usize, usize) -> bool) {
        self.components.clear();
        self.components.resize(image.depth_m.len(), NONE);
        for at in self.pixels.iter().filter(|at| image.depth_m[*at] > 0.0) {
            self.components[at] = at as u32;
        }
        connect(image, &self.pixels, &mut self.components, 1, is_one);
    }

    /// Cuts components at edges, where these are known.
    fn segment_components(&mut self, image: &Image<'_>, segments: &mut Vec<u32>) {
        segments.clear();
        if self.is_edge.is_empty() {
            segments.extend_from_slice(&self.components);
            return;
        }
        self.find_cores(image);
        segments.extend_from_slice(&self.cores);
        grow(image, &self.pixels, &self.components, segments);
        // What has no core is one body.
        for at in self.pixels.iter() {
            if segments[at] == NONE {
                segments[at] = self.components[at];
            }
        }
    }

    /// Growth and joins leave segments whose number is not their first pixel.
    fn number_by_first_pixel(&mut self, segments: &mut [u32]) {
        let first = &mut self.sizes;
        first.clear();
        first.resize(segments.len(), NONE);
        for at in self.pixels.iter() {
            let segment = &mut segments[at];
            if let Some(first) = first.get_mut(*segment as usize) {
                *first = (*first).min(at as u32);
                *segment = *first;
            }
        }
    }

    /// Leaves the root of its core at each pixel that has one.
    fn find_cores(&mut self, image: &Image<'_>) {
        self.cores.clear();
        self.cores.resize(self.components.len(), NONE);
        for at in self.pixels.iter() {
            if self.components[at] != NONE && !self.is_edge[at] {
                self.cores[at] = at as u32;
            }
        }
        // A step of two bridges a pixel that was not measured.
        let components = &self.components;
        connect(image, &self.pixels, &mut self.cores, 2, |a, b| components[a] == components[b]);
        self.sizes.clear();
        self.sizes.resize(self.cores.len(), 0);
        let mut whole = vec![0u32; self.cores.len()];
        for at in self.pixels.iter() {
            if let Some(size) = self.sizes.get_mut(self.cores[at] as usize) {
                *size += 1;
            }
            if let Some(size) = whole.get_mut(self.components[at] as usize) {
                *size += 1;
            }
        }
        for at in self.pixels.iter() {
            let of = |sizes: &[u32], root: u32| sizes.get(root as usize).copied().unwrap_or(0);
            let share = MIN_CORE_SHARE * of(&whole, self.components[at]) as f32;
            let needed = (share as u32).clamp(MIN_CORE[0], MIN_CORE[1]);
            if of(&self.sizes, self.cores[at]) < needed {
                self.cores[at] = NONE;
            }
        }
    }
}

/// The root of a pixel's tree.
fn root(forest: &mut [u32], mut at: u32) -> u32 {
    loop {
        let up = forest[at as usize];
        if up == at {
            return at;
        }
        // Path halving: the next search is shorter.
        let over = forest[up as usize];
        forest[at as usize] = over;
        at = over;
    }
}

/// Connects the marked pixels of a forest with those to the left and above, up to so many pixels away, at about the same depth, where
/// both may be of one body. In the end each has its root, which is the first pixel.
fn connect(
    image: &Image<'_>,
    pixels: &Pixels,
    forest: &mut [u32],
    steps: usize,
    is_one: impl Fn(usize, usize) -> bool,
) {
    let width = image.width.max(1);
    for at in pixels.iter() {
        if forest[at] == NONE {
            continue;
        }
        let (u, z) = (at % width, image.depth_m[at]);
        let gap = (image.gap)(z);
        for (is_inside, stride) in [(u, 1), (at / width, width)] {
            for step in 1..=steps.min(is_inside) {
                let beside = at - step * stride;
                if forest[beside] == NONE {
                    // What is of a plane, or far in front or behind, is between two bodies.
                    let is_apart =
                        image.all_m[beside] > 0.0 && (z - image.depth_m[beside]).abs() > gap;
                    if is_apart {
                        break;
                    }
                    continue;
                }
                if (z - image.depth_m[beside]).abs() < gap && is_one(at, beside) {
                    let (a, b) = (root(forest, at as u32), root(forest, beside as u32));
                    // The first pixel becomes the root, so that the result does not depend on the order of unions.
                    forest[a.max(b) as usize] = a.min(b);
                }
                break;
            }
        }
    }
    for at in pixels.iter() {
        if forest[at] != NONE {
            forest[at] = root(forest, at as u32);
        }
    }
}

/// Segments grow over the pixels of their components that have none, layer by layer.
fn grow(image: &Image<'_>, pixels: &Pixels, components: &[u32], segments: &mut [u32]) {
    let (width, end) = (image.width.max(1), segments.len());
    let beside = |at: usize| {
        let u = at % width;
        let left = (u > 0).then(|| at.wrapping_sub(1));
        let right = (u + 1 < width).then_some(at + 1);
        let below = Some(at + width).filter(|at| *at < end);
        [left, right, at.checked_sub(width), below].into_iter().flatten()
    };
    let is_open = |segments: &[u32], at: usize| segments[at] == NONE && components[at] != NONE;
    let is_front =
        |at: &usize| is_open(segments, *at) && beside(*at).any(|other| segments[other] != NONE);
    let mut front: Vec<u32> = pixels.iter().filter(is_front).map(|at| at as u32).collect();
    let mut taken = Vec::new();
    while !front.is_empty() {
        taken.clear();
        for at in &front {
            let at = *at as usize;
            let z = image.depth_m[at];
            let known = beside(at)
                .filter(|other| segments[*other] != NONE && components[*other] == components[at]);
            let nearest = known.min_by(|a, b| {
                let off = |at: usize| (image.depth_m[at] - z).abs();
                off(*a).total_cmp(&off(*b))
            });
            if let Some(nearest) = nearest {
                taken.push((at as u32, segments[nearest]));
            }
        }
        // A layer is whole before the next one begins, so that no direction is preferred.
        for (at, segment) in &taken {
            segments[*at as usize] = *segment;
        }
        front.clear();
        for (at, _) in &taken {
            front.extend(
                beside(*at as usize).filter(|at| is_open(segments, *at)).map(|at| at as u32),
            );
        }
        front.sort_unstable();
        front.dedup();
    }
}
