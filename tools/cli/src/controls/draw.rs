//! Squares and triangles without light, in the colours of the first frame; the nearest is in front.

use nalgebra::Vector3;

use super::colours::{NEAR_M, Palette};
use crate::picture::in_front;

/// A place on a surface.
#[derive(Clone, Copy)]
pub(super) struct Spot {
    /// As the camera has it: right, down, forward, metres.
    pub(super) now: Vector3<f32>,
    /// Likewise in the first frame.
    pub(super) first: Vector3<f32>,
}

impl Spot {
    /// Such a part of the way from one to another.
    fn between(from: &Spot, to: &Spot, part: f32) -> Spot {
        Spot {
            now: from.now + (to.now - from.now) * part,
            first: from.first + (to.first - from.first) * part,
        }
    }
}

/// A picture, black at first.
pub(super) struct Canvas<'p> {
    palette: &'p Palette,
    width: usize,
    height: usize,
    /// (height, width)
    pub(super) pixels: Vec<[u8; 3]>,
    /// (height, width) 1/m; 0: nothing.
    inverse: Vec<f32>,
}

impl<'p> Canvas<'p> {
    pub(super) fn new([width, height]: [u32; 2], palette: &'p Palette) -> Canvas<'p> {
        let [width, height] = [width, height].map(|side| side as usize);
        let (pixels, inverse) = (vec![[0; 3]; width * height], vec![0.0; width * height]);
        Canvas { palette, width, height, pixels, inverse }
    }

    /// Whether anything is in the picture, be it black.
    pub(super) fn is_used(&self) -> bool {
        self.inverse.iter().any(|inverse| *inverse > 0.0)
    }

    /// A point as a square of `side` pixels about it.
    pub(super) fn square(&mut self, spot: &Spot, side: u32) {
        if spot.now.z < NEAR_M {
            return;
        }
        let colour = self.palette.colour(&spot.first);
        let [x, y] = self.palette.place(&spot.now);
        let range = |at: f32, limit: usize| {
            let start = (at - side as f32 / 2.0).round();
            // Conversions saturate, so what lies outside is cut off.
            start as usize..((start + side as f32) as usize).min(limit)
        };
        for row in range(y, self.height) {
            for column in range(x, self.width) {
                self.put(column, row, 1.0 / spot.now.z, |_| colour);
            }
        }
    }

    /// A triangle, each of whose places has the colour of where it was. It counts as so much nearer than it is, metres, which keeps what
    /// lies right under a sheet from showing through it.
    pub(super) fn triangle(&mut self, corners: [Spot; 3], lift_m: f32) {
        for part in in_front(corners, NEAR_M, |spot| spot.now.z, Spot::between) {
            self.part(part, f64::from(lift_m));
        }
    }

    /// A triangle in front of the camera.
    fn part(&mut self, mut corners: [Spot; 3], lift_m: f64) {
        // Where a triangle was cut its depth is rounded.
        corners.iter_mut().for_each(|spot| spot.now.z = spot.now.z.max(NEAR_M));
        // In f64: near to the camera a corner may be many pixels away.
        let places = corners.map(|spot| self.palette.place(&spot.now).map(f64::from));
        let [a, b, c] = places;
        let area = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]);
        if area == 0.0 || !area.is_finite() {
            return;
        }
        let inverse = corners.map(|spot| 1.0 / f64::from(spot.now.z));
        let rows = whole(places.map(|[_, y]| y), self.height);
        let columns = whole(places.map(|[x, _]| x), self.width);
        for row in rows {
            for column in columns.clone() {
                let (x, y) = (column as f64 + 0.5, row as f64 + 0.5);
                let edge = |p: [f64; 2], q: [f64; 2]| {
                    ((q[0] - p[0]) * (y - p[1]) - (q[1] - p[1]) * (x - p[0])) / area
                };
                let weights = [edge(b, c), edge(c, a), edge(a, b)];
                if weights.iter().any(|weight| *weight < 0.0) {
                    continue;
                }
                // Over the picture inverse depth is affine; over the surface places are, so their weights are divided by depth.
                let parts = [0, 1, 2].map(|k| weights[k] * inverse[k]);
                let sum: f64 = parts.iter().sum();
                let nearer = 1.0 / (1.0 / sum - lift_m).max(0.5 / sum);
                self.put(column, row, nearer as f32, |palette| {
                    let [a, b, c] = [0, 1, 2].map(|k| corners[k].first * (parts[k] / sum) as f32);
                    palette.colour(&(a + b + c))
                });
            }
        }
    }

    /// Colours a pixel where nothing is nearer.
    fn put(
        &mut self,
        column: usize,
        row: usize,
        inverse: f32,
        colour: impl FnOnce(&Palette) -> [u8; 3],
    ) {
        let at = row * self.width + column;
        let (Some(pixel), Some(nearest)) = (self.pixels.get_mut(at), self.inverse.get_mut(at))
        else {
            return;
        };
        if inverse > *nearest {
            *nearest = inverse;
            *pixel = colour(self.palette);
        }
    }
}

/// Pixels whose middles may lie between these numbers.
fn whole(numbers: [f64; 3], limit: usize) -> std::ops::Range<usize> {
    let low = numbers.into_iter().fold(f64::MAX, f64::min).floor();
    let high = numbers.into_iter().fold(f64::MIN, f64::max).ceil();
    low as usize..(high as usize).min(limit)
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;
    use nalgebra::Isometry3;
    use rigidformer_perception::camera::Camera;

    const SIZE: [u32; 2] = [100, 50];

    /// Blue is 0 at 2 m and 255 at 1 m.
    fn palette() -> Palette {
        let camera = Camera::new(SIZE, [50.0; 2], [49.5, 24.5], Isometry3::identity()).unwrap();
        let at = |z: f32| Vector3::new(0.0, 0.0, z);
        let mut palette = Palette::new(&camera, &[at(1.0), at(2.0)]);
        palette.inverse_m = [0.5, 1.0];
        palette
    }

    fn still(x: f32, y: f32, z: f32) -> Spot {
        let now = Vector3::new(x, y, z);
        Spot { now, first: now }
    }

    fn drawn(canvas: &Canvas<'_>) -> Vec<(usize, usize, [u8; 3])> {
        let pixels = canvas.pixels.iter().enumerate().filter(|(_, pixel)| **pixel != [0; 3]);
        pixels.map(|(at, pixel)| (at % 100, at / 100, *pixel)).collect()
    }

    #[test]
    fn a_point_is_a_square_about_its_place() {
        let palette = palette();
        let mut canvas = Canvas::new(SIZE, &palette);
        // Seen at (60.2, 30.4): the square's middle is at (60, 30).
        let z = 1.5;
        canvas.square(&still(10.2 / 50.0 * z, 5.4 / 50.0 * z, z), 2);
        let places: Vec<_> = drawn(&canvas).iter().map(|(x, y, _)| (*x, *y)).collect();
        assert_eq!(places, [(59, 29), (60, 29), (59, 30), (60, 30)]);
        assert_eq!(drawn(&canvas)[0].2, [154, 155, 85]);
        // One pixel is the one that it falls into; edges cut.
        let mut canvas = Canvas::new(SIZE, &palette);
        canvas.square(&still(10.2 / 50.0, 5.4 / 50.0, 1.0), 1);
        assert_eq!(drawn(&canvas).len(), 1);
        assert_eq!((drawn(&canvas)[0].0, drawn(&canvas)[0].1), (60, 30));
        let mut canvas = Canvas::new(SIZE, &palette);
        canvas.square(&still(1.0, 0.0, 1.0), 4);
        assert_eq!(drawn(&canvas).len(), 2 * 4);
        canvas.square(&still(0.0, 0.0, -1.0), 4);
        assert_eq!(drawn(&canvas).len(), 2 * 4, "behind the camera");
    }

    #[test]
    fn the_nearest_is_in_front_whatever_the_order() {
        let palette = palette();
        let (near, far) = (still(0.0, 0.0, 1.0), still(0.0, 0.0, 2.0));
        for order in [[near, far], [far, near]] {
            let mut canvas = Canvas::new(SIZE, &palette);
            order.iter().for_each(|spot| canvas.square(spot, 2));
            let blues: Vec<u8> = drawn(&canvas).iter().map(|(_, _, [_, _, blue])| *blue).collect();
            assert_eq!(blues, [255; 4]);
        }
        // A wall in front of a point hides it, one behind it does not.
        for (z, blue) in [(0.9, 255), (1.5, 170)] {
            let mut canvas = Canvas::new(SIZE, &palette);
            canvas.square(&still(0.0, 0.0, 1.2), 2);
            canvas.triangle([still(-9.0, -9.0, z), still(9.0, -9.0, z), still(0.0, 18.0, z)], 0.0);
            assert_eq!(canvas.pixels[25 * 100 + 50][2], blue, "{z}");
        }
    }

    #[test]
    fn a_surface_in_the_first_frame_has_the_colours_of_its_pixels() {
        let palette = palette();
        let mut canvas = Canvas::new(SIZE, &palette);
        // A slope that fills the picture, from near on the left to far on the right.
        canvas
            .triangle([still(-3.0, -9.0, 0.8), still(9.0, -9.0, 4.0), still(9.0, 30.0, 4.0)], 0.0);
        canvas
            .triangle([still(-3.0, -9.0, 0.8), still(9.0, 30.0, 4.0), still(-3.0, 30.0, 0.8)], 0.0);
        for (at, pixel) in canvas.pixels.iter().enumerate() {
            let part = |at: usize, side: f32| 255.0 * (at as f32 + 0.5) / side;
            let [red, green, _] = pixel.map(f32::from);
            assert!((red - part(at % 100, 100.0)).abs() < 0.6, "{at}: {pixel:?}");
            assert!((green - part(at / 100, 50.0)).abs() < 0.6, "{at}: {pixel:?}");
        }
        assert!(canvas.pixels[0][2] > canvas.pixels[99][2]);
    }

    #[test]
    fn a_place_on_a_surface_keeps_its_colour_when_it_moves() {
        let palette = palette();
        let corners = [still(-0.5, -0.4, 1.0), still(0.7, -0.2, 1.4), still(0.1, 0.6, 2.0)];
        let middle =
            |of: fn(&Spot) -> Vector3<f32>| corners.iter().map(of).sum::<Vector3<f32>>() / 3.0;
        let expected = palette.colour(&middle(|spot| spot.first));
        let shift = Vector3::new(-0.3, 0.1, 0.7);
        let mut canvas = Canvas::new(SIZE, &palette);
        canvas.triangle(corners.map(|spot| Spot { now: spot.now + shift, ..spot }), 0.0);
        let [x, y] = palette.place(&(middle(|spot| spot.now) + shift)).map(|at| at as usize);
        for (found, expected) in canvas.pixels[y * 100 + x].iter().zip(expected) {
            assert!(found.abs_diff(expected) < 4, "{found} {expected}");
        }
    }

    #[test]
    fn surfaces_that_reach_behind_the_camera_are_cut() {
        let palette = palette();
        let mut canvas = Canvas::new(SIZE, &palette);
        // The ground below the camera: all of the lower half.
        canvas.triangle([still(-1e3, 1.0, -1e3), still(1e3, 1.0, -1e3), still(0.0, 1.0, 1e3)], 0.0);
        let rows: Vec<usize> = drawn(&canvas).iter().map(|(_, row, _)| *row).collect();
        assert_eq!((rows.first(), rows.len()), (Some(&25), 25 * 100));
    }
}
