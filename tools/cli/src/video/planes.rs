//! Colours of pixels as samples of H.264.

/// Pixels a side of a macroblock.
pub(super) const BLOCK: usize = 16;

/// How a video has colours.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Colours {
    /// Y'CbCr 4:2:0 by BT.601 in limited range: what every player shows. Four pixels share their chroma.
    Shared,
    /// Green, blue and red, 4:4:4: every bit. Decoders of the profile High 4:4:4 Predictive are needed, such as FFmpeg's.
    Exact,
}

/// A place in a picture, macroblocks.
#[derive(Clone, Copy)]
pub(super) struct Place {
    pub(super) column: usize,
    pub(super) row: usize,
}

/// Samples of one kind.
pub(super) struct Plane {
    /// A row.
    width: usize,
    /// A macroblock has `side` x `side` samples.
    side: usize,
    samples: Vec<u8>,
}

/// A picture, filled up to whole macroblocks.
pub(super) struct Planes {
    /// Y', Cb and Cr; or green, blue and red.
    pub(super) all: [Plane; 3],
}

/// How many macroblocks a row and a column have.
pub(super) fn blocks(size: [u32; 2]) -> [usize; 2] {
    size.map(|side| (side as usize).div_ceil(BLOCK))
}

impl Planes {
    pub(super) fn new(pixels: &[[u8; 3]], size: [u32; 2], colours: Colours) -> Planes {
        let [width, height] = size.map(|side| side as usize);
        let [wide, high] = blocks(size).map(|count| count * BLOCK);
        // What nobody sees repeats the edge.
        let pixel = |x: usize, y: usize| {
            let at = y.min(height.saturating_sub(1)) * width + x.min(width.saturating_sub(1));
            pixels.get(at).copied().unwrap_or_default()
        };
        let every = |of: &dyn Fn(usize, usize) -> u8, step: usize| Plane {
            width: wide / step,
            side: BLOCK / step,
            samples: (0..high / step)
                .flat_map(|y| (0..wide / step).map(move |x| (x * step, y * step)))
                .map(|(x, y)| of(x, y))
                .collect(),
        };
        let all = match colours {
            Colours::Exact => [1, 2, 0].map(|k| every(&|x, y| pixel(x, y)[k], 1)),
            Colours::Shared => {
                let mean = |x: usize, y: usize, of: fn([f32; 3]) -> f32| {
                    let four = [(x, y), (x + 1, y), (x, y + 1), (x + 1, y + 1)];
                    let sum: f32 = four.iter().map(|(x, y)| of(parts(pixel(*x, *y)))).sum();
                    (sum / 4.0).round() as u8
                };
                [
                    every(&|x, y| luma(parts(pixel(x, y))).round() as u8, 1),
                    every(&|x, y| mean(x, y, blue_difference), 2),
                    every(&|x, y| mean(x, y, red_difference), 2),
                ]
            }
        };
        Planes { all }
    }
}

/// From 0 to 1.
fn parts(pixel: [u8; 3]) -> [f32; 3] {
    pixel.map(|channel| f32::from(channel) / 255.0)
}

// BT.601 in limited range.
fn luma([red, green, blue]: [f32; 3]) -> f32 {
    16.0 + 65.481 * red + 128.553 * green + 24.966 * blue
}

fn blue_difference([red, green, blue]: [f32; 3]) -> f32 {
    128.0 - 37.797 * red - 74.203 * green + 112.0 * blue
}

fn red_difference([red, green, blue]: [f32; 3]) -> f32 {
    128.0 + 112.0 * red - 93.786 * green - 18.214 * blue
}

impl Plane {
    /// The rows of a macroblock.
    pub(super) fn rows(&self, place: Place) -> impl Iterator<Item = &[u8]> {
        let first = place.row * self.side * self.width + place.column * self.side;
        (0..self.side).map(move |row| {
            let start = first + row * self.width;
            self.samples.get(start..start + self.side).unwrap_or_default()
        })
    }

    /// Whether a macroblock is that of another picture.
    pub(super) fn is_like(&self, other: &Plane, place: Place) -> bool {
        self.rows(place).eq(other.rows(place))
    }

    /// Whether every row of a macroblock repeats the sample on its left.
    pub(super) fn repeats_left(&self, place: Place) -> bool {
        let first = place.row * self.side * self.width + place.column * self.side;
        place.column > 0
            && self.rows(place).enumerate().all(|(row, samples)| {
                let left = self.samples.get(first + row * self.width - 1);
                left.is_some_and(|left| samples.iter().all(|sample| sample == left))
            })
    }

    /// Whether every row of a macroblock repeats the row above it.
    pub(super) fn repeats_above(&self, place: Place) -> bool {
        let Some(row) = (place.row * self.side).checked_sub(1) else { return false };
        let start = row * self.width + place.column * self.side;
        let above = self.samples.get(start..start + self.side);
        self.rows(place).all(|samples| Some(samples) == above)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The samples of a pixel that fills its picture.
    fn of(pixel: [u8; 3], colours: Colours) -> [u8; 3] {
        let planes = Planes::new(&[pixel; 4], [2, 2], colours);
        planes.all.map(|plane| {
            assert!(plane.samples.iter().all(|sample| *sample == plane.samples[0]));
            plane.samples[0]
        })
    }

    #[test]
    fn colours_are_those_of_bt_601() {
        let shared = |pixel| of(pixel, Colours::Shared);
        assert_eq!(shared([0, 0, 0]), [16, 128, 128]);
        assert_eq!(shared([255, 255, 255]), [235, 128, 128]);
        assert_eq!(shared([255, 0, 0]), [81, 90, 240]);
        assert_eq!(shared([0, 255, 0]), [145, 54, 34]);
        assert_eq!(shared([0, 0, 255]), [41, 240, 110]);
        assert_eq!(of([1, 2, 3], Colours::Exact), [2, 3, 1]);
    }

    #[test]
    fn the_way_back_is_within_three_levels() {
        for red in (0..=255).step_by(15) {
            for (green, blue) in (0..=255).step_by(15).zip((0..=255).rev().step_by(17)) {
                let [y, cb, cr] = of([red, green, blue], Colours::Shared).map(f32::from);
                let y = 255.0 / 219.0 * (y - 16.0);
                let (cb, cr) = (255.0 / 224.0 * (cb - 128.0), 255.0 / 224.0 * (cr - 128.0));
                let back = [y + 1.402 * cr, y - 0.344_14 * cb - 0.714_14 * cr, y + 1.772 * cb];
                for (back, given) in back.iter().zip([red, green, blue]) {
                    assert!(
                        (back - f32::from(given)).abs() < 2.5,
                        "{red} {green} {blue}: {back:?}"
                    );
                }
            }
        }
    }

    #[test]
    fn blocks_that_repeat_their_neighbours_are_found() {
        // 32 x 32 pixels: black, but for a white column at 15 and a white row at 15.
        let pixel = |at: usize| match (at % 32, at / 32) {
            (15, _) | (_, 15) => [255; 3],
            _ => [0; 3],
        };
        let pixels: Vec<_> = (0..32 * 32).map(pixel).collect();
        let planes = Planes::new(&pixels, [32, 32], Colours::Exact);
        let [plane, ..] = &planes.all;
        let at = |column, row| Place { column, row };
        // To the right of the column all is white in the samples on the left, and black in the block.
        assert!(!plane.repeats_left(at(1, 1)) && !plane.repeats_above(at(1, 1)));
        assert!(!plane.repeats_left(at(0, 0)) && !plane.repeats_above(at(0, 0)));
        let black = Planes::new(&[[0; 3]; 32 * 32], [32, 32], Colours::Exact);
        let [black, ..] = &black.all;
        assert!(black.repeats_left(at(1, 0)) && black.repeats_above(at(0, 1)));
        assert!(plane.is_like(black, at(1, 1)) && !plane.is_like(black, at(0, 0)));
    }
}
